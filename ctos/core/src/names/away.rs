//! Names of tasks whose chassis is being restarted: who asks for one waits until its tasks have passed all
//! phases, or until it is known that they never will.

use std::collections::{BTreeMap, BTreeSet};

use super::{Names, TidServer, broadcast};
use crate::{
    context::Context,
    envelope::Replier,
    handled::Handled,
    system::{FindTid, Missing, News},
};
use ctos_config::ChassisRestart;
use ctos_message::Tid;

/// Chassis that are not as they should be, by number.
#[derive(Default)]
pub(super) struct Presence {
    /// Those that may be started again, until their tasks have passed all phases.
    away: BTreeSet<u8>,
    /// Those that are not started again, with why.
    gone: BTreeMap<u8, String>,
    /// Whether the app has been up. Before, tasks find each other as soon as they exist.
    up: bool,
    stopping: bool,
    waiting: Vec<Waiting>,
}

/// A task that waits for another one to be back.
struct Waiting {
    from: Tid,
    request: FindTid,
    reply: Replier<FindTid>,
}

impl Presence {
    /// A chassis is not linked any more.
    pub(super) fn lost(&mut self, cx: &Context, index: u8) {
        let config = cx.chassis().config_of(index);
        let may_return = config.is_some_and(|it| it.supervision.restart != ChassisRestart::Never);
        if may_return {
            self.away.insert(index);
        } else if !self.away.contains(&index) {
            let why = "is not started again, because its `restart` is \"never\"".to_owned();
            self.gone.entry(index).or_insert(why);
        }
    }

    fn is_away(&self, index: u8) -> bool {
        self.away.contains(&index)
    }
}

impl Names {
    pub(super) fn asked(
        &mut self,
        cx: &Context,
        from: Tid,
        request: FindTid,
        reply: Replier<FindTid>,
    ) -> Handled {
        match self.find(cx, from, &request) {
            Err(Missing::Away { .. }) if request.waits => {
                let waiting = &mut self.presence.waiting;
                waiting.retain(|waiting| !waiting.reply.is_abandoned());
                waiting.push(Waiting {
                    from,
                    request,
                    reply,
                });
                Ok(())
            }
            found => reply.ok(found),
        }
    }

    /// Answers those who wait for what is known now.
    pub(super) fn answer_waiting(&mut self, cx: &Context) {
        for waiting in std::mem::take(&mut self.presence.waiting) {
            let Waiting {
                from,
                request,
                reply,
            } = waiting;
            // A reply cannot fail.
            let _ = self.asked(cx, from, request, reply);
        }
    }

    fn find(&self, cx: &Context, from: Tid, request: &FindTid) -> Result<Tid, Missing> {
        let FindTid { name, gone, .. } = request;
        let presence = &self.presence;
        let found = self.seen_from(from.chassis(), name);
        let unknown = || Missing::Unknown(self.names.keys().cloned().collect());
        let Some(config) = cx.app().task(name) else {
            return found.ok_or_else(unknown);
        };
        let here = cx.chassis();
        let numbered = here
            .others()
            .find(|index| here.name_of(*index) == config.chassis);
        let home = self.homes.get(name).map(|place| place.chassis);
        let Some(index) = found.map(Tid::chassis).or(home).or(numbered) else {
            return found.ok_or_else(unknown);
        };
        // Tasks that are passing the phases themselves find each other as soon as they exist.
        let hidden = presence.is_away(index) && presence.up && !presence.is_away(from.chassis());
        let lost = found.is_some() && found == *gone;
        let chassis = here.name_of(index).to_owned();
        match found {
            Some(tid) if !hidden && !lost => return Ok(tid),
            // It exists, and nobody can say any more when it has passed its phases.
            Some(tid) if presence.stopping && !lost => return Ok(tid),
            None if !presence.is_away(index) && !presence.gone.contains_key(&index) => {
                return Err(unknown());
            }
            _ => {}
        }
        if let Some(why) = presence.gone.get(&index) {
            let why = why.clone();
            return Err(Missing::Gone { chassis, why });
        }
        if presence.stopping {
            let why = "is not started again, because the app is being stopped".to_owned();
            return Err(Missing::Gone { chassis, why });
        }
        Err(Missing::Away { chassis })
    }
}

impl TidServer {
    /// Something has become of a chassis, or of the app.
    pub(super) fn heard(&self, cx: &Context, news: News) {
        let mut state = self.state.borrow_mut();
        let Names {
            presence, names, ..
        } = &mut *state;
        match news {
            News::AppUp => presence.up = true,
            News::Away(index) => {
                presence.away.insert(index);
                presence.gone.remove(&index);
                // Who has found its tasks before asks again, and waits.
                for (name, tid) in names.iter().filter(|(_, tid)| tid.chassis() == index) {
                    broadcast(cx, name, *tid, None);
                }
            }
            News::Back(index) => {
                presence.away.remove(&index);
                presence.gone.remove(&index);
            }
            News::Gone(index, why) => {
                presence.away.remove(&index);
                presence.gone.insert(index, why);
            }
            News::Stopping => presence.stopping = true,
        }
        state.answer_waiting(cx);
    }
}
