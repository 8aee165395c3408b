//! Names of tasks whose chassis is being restarted. A task that asks for one waits until the new tasks
//! have passed all phases, or until the service knows that they never will.

use std::collections::BTreeMap;

use super::{Names, TidServer, broadcast, lines::Lines};
use crate::{
    context::Context,
    envelope::Replier,
    handled::Handled,
    system::{BOOTSTRAP, ChassisWanted, FindTid, Missing, News},
};
use ctos_config::ChassisRestart;
use ctos_message::{ChassisNumber, Tid};

/// Chassis that are not as they should be, by number.
#[derive(Default)]
pub(super) struct Presence {
    /// Those that may be started again, until their tasks have passed all phases; and those that are not, with why.
    absent: BTreeMap<ChassisNumber, Option<String>>,
    /// Whether the app has been up. Before, tasks find each other as soon as they exist.
    up: bool,
    stopping: bool,
    /// Tasks that wait for others to be back.
    waiting: Lines<(FindTid, Replier<FindTid>)>,
}

impl Presence {
    /// A chassis is not linked any more.
    pub(super) fn lost(&mut self, cx: &Context, index: ChassisNumber) {
        let config = cx.chassis().config_of(index);
        let may_return =
            config.is_some_and(|it| it.supervision.restart.when != ChassisRestart::Never);
        let why = "is not started again, because its `restart` is \"never\"";
        let why = (!may_return).then(|| why.to_owned());
        self.absent.entry(index).or_insert(why);
    }

    fn is_away(&self, index: ChassisNumber) -> bool {
        self.absent.get(&index) == Some(&None)
    }
}

impl Names {
    pub(super) fn asked(
        &mut self,
        cx: &Context,
        request: FindTid,
        reply: Replier<FindTid>,
    ) -> Handled {
        let found = self.find(cx, reply.asker(), &request);
        if matches!(found, Err(Missing::Away { .. })) {
            want(cx, &request.name, self.name_of(reply.asker()));
        }
        match found {
            Err(Missing::Away { .. }) if request.waits => {
                let name = request.name.clone();
                let waiting = &mut self.presence.waiting;
                waiting.push(name, (request, reply), |(_, reply)| reply.is_abandoned());
                Ok(())
            }
            found => reply.ok(found),
        }
    }

    /// Answers those who wait for what is known now.
    pub(super) fn answer_waiting(&mut self, cx: &Context) {
        let waiting = self.presence.waiting.take_all();
        self.answer(cx, waiting);
    }

    /// Answers those who wait for `name`, if anything is known now.
    pub(super) fn answer_waiting_for(&mut self, cx: &Context, name: &str) {
        let waiting = self.presence.waiting.take(name);
        self.answer(cx, waiting);
    }

    fn answer(&mut self, cx: &Context, waiting: Vec<(FindTid, Replier<FindTid>)>) {
        for (request, reply) in waiting {
            // A reply cannot fail.
            let _ = self.asked(cx, request, reply);
        }
    }

    /// The task with this id.
    pub(super) fn name_of(&self, tid: Tid) -> Option<String> {
        let name = self.used.get(&tid)?;
        (self.names.get(name) == Some(&tid)).then(|| name.clone())
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
        let numbered = here.number_of(&config.chassis);
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
            // All others of the configuration will be there, unless their chassis is seen to be gone.
            None if self.ended.contains(name) && !presence.absent.contains_key(&index) => {
                return Err(unknown());
            }
            _ => {}
        }
        if let Some(Some(why)) = presence.absent.get(&index) {
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

/// Has the chassis of a task started for `by`, if it starts on demand.
pub(super) fn want(cx: &Context, name: &str, by: Option<String>) {
    let here = cx.chassis();
    let task = cx.app().task(name);
    let home = task.and_then(|task| here.number_of(&task.chassis));
    if let Some(chassis) = home.filter(|index| here.starts_on_demand(*index)) {
        let wanted = ChassisWanted {
            chassis,
            task: name.to_owned(),
            by,
        };
        here.post_system(BOOTSTRAP, wanted);
    }
}

impl TidServer {
    /// Something has become of a chassis, or of the app.
    pub(super) fn heard(&self, cx: &Context, news: News) {
        let mut state = self.state.borrow_mut();
        let presence = &mut state.presence;
        match news {
            News::AppUp => presence.up = true,
            News::Away(index) => {
                presence.absent.insert(index, None);
                // Who has found its tasks before asks again, and waits.
                for task in state.tasks_on(index) {
                    broadcast(cx, task.name(), task.tid(), None);
                }
            }
            News::Back(index) => {
                presence.absent.remove(&index);
            }
            News::Gone(index, why) => {
                presence.absent.insert(index, Some(why));
            }
            News::Stopping => presence.stopping = true,
        }
        state.answer_waiting(cx);
    }
}
