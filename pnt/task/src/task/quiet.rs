//! A net whose app is about to be stopped. It ends what it has begun, and then fires no more.
//!
//! Its tape takes no new commands, and it begins nothing by itself. The firings of the net bring to their end
//! a command that was read, and a request of another net. They give devices back and answer waiting callers. A
//! durable net needs none of that: it keeps what is in work for the next boot.

use std::{collections::BTreeSet, future::poll_fn, rc::Rc, task::Poll, time::Duration};

use ctos::task::{Context, HandlerError};

use super::{
    acting::Ended,
    engine::{Asker, Core, Engine},
    load::runs_net,
    messages::RequestId,
    requests::BEING_STOPPED,
};

impl Engine {
    /// The app is about to be stopped.
    pub(super) fn quiesce(self: &Rc<Self>, cx: &Context) {
        self.stopping.set(true);
        self.library.stopping();
        if !self.durable.is_kept() {
            self.refuse_waiting();
        }
        let (resting, asked) = (Rc::clone(self), Rc::clone(self));
        let limit = cx.app().stop_timeout.mul_f64(0.9);
        self.cx.quiet_after(move || asked.unrest(), async move {
            let in_time = resting.cx.timeout(limit, resting.is_quiet_at_last());
            if in_time.await.is_err() {
                resting.cancel_actions(limit);
                resting.is_quiet_at_last().await;
            }
            Ok(())
        });
        self.advance(cx);
    }

    /// Whether a new command is refused: one of another net may belong to what that brings to its end.
    pub(super) fn refuses(&self, asker: &Asker) -> bool {
        self.stopping.get()
            && match asker {
                Asker::Plain(_) => true,
                Asker::Once(_, request) => self.durable.is_kept() || !self.is_of_net(request),
            }
    }

    /// Whether the net leaves an asker unanswered instead of refusing: the next process of a durable net takes the
    /// repeated command.
    pub(super) fn leaves_unanswered(&self, asker: &Asker) -> bool {
        self.stopping.get() && self.durable.is_kept() && matches!(asker, Asker::Once(..))
    }

    fn is_of_net(&self, request: &RequestId) -> bool {
        let name = request.from.split(' ').next().unwrap_or_default();
        let task = self.cx.app().task(name);
        name != request.from && task.is_some_and(|task| runs_net(task, &self.cx.registry()))
    }

    /// Refuses commands that nobody has read, but for those of nets.
    fn refuse_waiting(&self) {
        let refused = {
            let mut core = self.core.borrow_mut();
            let waiting = core.execution.tape().waiting();
            let waiting: Vec<u64> = waiting.map(|on_tape| on_tape.number).collect();
            let refused: BTreeSet<u64> = waiting
                .into_iter()
                .filter(|number| {
                    let asker = core.waiting.get(number);
                    asker.is_none_or(|asker| self.refuses(asker))
                })
                .collect();
            if refused.is_empty() {
                return;
            }
            core.execution
                .retain_waiting(|number| !refused.contains(&number));
            core.changed();
            let (net, commands) = (&*self.name, refused.len());
            tracing::warn!(target: "pnt::net", net, commands, "commands on the tape are not begun: the app is being stopped");
            let askers = refused.iter().filter_map(|number| {
                core.commands.remove(number);
                core.once.forget(*number);
                core.waiting.remove(number)
            });
            askers.collect::<Vec<Asker>>()
        };
        let text = format!("net `{}` did not begin it: {BEING_STOPPED}", self.name);
        for asker in refused {
            // Answering never fails; a caller that is gone needs no answer.
            let _ = asker.fail(&text);
        }
    }

    /// Whether something is in work that the net is to bring to its end.
    fn is_in_work(&self, core: &Core) -> bool {
        let tape = core.execution.tape();
        let asked = tape.current().is_some() || !tape.is_empty() || core.requests.open > 0;
        asked && !self.durable.is_kept() && core.manual.paused().is_none()
    }

    /// Whether the net fires nothing, because the app is being stopped.
    #[inline]
    pub(super) fn is_silent(&self, core: &Core) -> bool {
        self.stopping.get() && !self.is_in_work(core)
    }

    fn is_quiet(&self, core: &Core) -> bool {
        let idle = core.halted.is_some() || !self.is_in_work(core);
        let sent = self.durable.is_kept() || core.transfers.waiting().next().is_none();
        let acts = core.execution.running().next().is_some();
        idle && !acts && self.is_settled(core) && (sent || core.halted.is_some())
    }

    async fn is_quiet_at_last(&self) {
        poll_fn(|poll| {
            let mut core = self.core.borrow_mut();
            if self.is_quiet(&core) {
                return Poll::Ready(());
            }
            core.requests.waits = Some(poll.waker().clone());
            Poll::Pending
        })
        .await;
    }

    /// What the net waits for before it is quiet.
    fn unrest(&self) -> String {
        let core = self.core.borrow();
        let net = core.execution.net();
        let mut words = Vec::new();
        if let Some(on_tape) = core.execution.tape().current() {
            words.push(format!(
                "command `{}` is in work",
                net[on_tape.command].symbol
            ));
        }
        if core.requests.open > 0 {
            let of: Vec<&str> = net.serves().iter().map(|side| side.net.as_str()).collect();
            words.push(format!("a request of net `{}` is in work", of.join("`, `")));
        }
        for (_, id) in core.execution.running() {
            words.push(format!("transition `{}` is in action", core.name_of(id)));
        }
        for (to, _) in core.transfers.waiting() {
            words.push(format!("net `{to}` does not take its tokens"));
        }
        if !self.is_settled(&core) {
            words.push("its state is not stored yet".to_owned());
        }
        words.join(", ")
    }

    /// Cancels actions that have not ended in time. Those of a durable net go on until it is stopped: its next
    /// boot asks again, or says that they are in doubt.
    fn cancel_actions(&self, after: Duration) {
        if self.durable.is_kept() {
            return;
        }
        let core = &mut *self.core.borrow_mut();
        let net = core.execution.net();
        for (firing, id) in core.execution.running() {
            let transition = net[id].name.as_str();
            let after_s = after.as_secs_f64();
            tracing::warn!(target: "pnt::net", net = net.name(), transition, after_s, "action cancelled: it did not end while the app was being stopped");
            if let Some(acting) = core.acting.get_mut(&firing) {
                acting.end(Ended::TooLate);
            }
        }
    }

    /// An action without failure branch has failed, and would begin again.
    pub(super) fn tries_no_more(self: &Rc<Self>, transition: &str, error: &HandlerError) {
        let why = format!(
            "transition `{transition}` failed and is not tried again, because {BEING_STOPPED}: {error}"
        );
        tracing::warn!(target: "pnt::net", net = &*self.name, why, "net stopped");
        if !self.durable.is_kept() {
            self.stop(&why);
        }
    }

    /// Tells which actions end with the net.
    pub(super) fn tell_unfinished(&self) {
        let core = self.core.borrow();
        for (_, id) in core.execution.running() {
            let transition = core.name_of(id);
            tracing::warn!(target: "pnt::net", net = &*self.name, transition, "still in action when the net was stopped");
        }
    }
}
