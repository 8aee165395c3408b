//! The net's task at its end of the stream. It puts events into the record, and answers those who follow,
//! in its own time and never in the net's. Neither sees an event before the change that it tells of is
//! stored.

use std::rc::Rc;

use ctos::{
    message::Replier,
    survey::AtReport,
    task::{Context, Handled},
    time::Instant,
};
use std::time::Duration;

use super::engine::{Core, Engine};
use crate::stream::{Follow, Happened, NetView, State};

/// How often the task looks whose patience has ended among those who follow.
const WATCH: Duration = Duration::from_millis(500);

/// A net as it stands in a record as a whole.
#[derive(serde::Serialize)]
struct Whole {
    view: NetView,
    state: State,
}

impl Engine {
    /// Notes what happened, and publishes it once the change that it came with is stored. The code that
    /// changes something counts the change first.
    pub(super) fn note(self: &Rc<Self>, core: &mut Core, cx: &Context, what: Happened) {
        let Core {
            journal, execution, ..
        } = core;
        journal.stream.note(cx.now(), cx.trace(), what, execution);
        self.published(core, cx);
    }

    /// Something new is in the stream: it goes into the record, and to those who follow.
    pub(super) fn published(self: &Rc<Self>, core: &mut Core, cx: &Context) {
        if cx.is_recording() {
            self.record(core, cx);
        }
        self.say_at(core);
        if self.is_settled(core) {
            core.journal.stream.show_all();
            self.call_followers(core);
        }
    }

    /// Says whether the net is paused, or else which requests to other nets it waits for.
    fn say_at(&self, core: &mut Core) {
        let at = match core.manual.paused() {
            Some(why) => Some(format!("paused: {why}")),
            None => core.requests.pending(core.execution.marking()),
        };
        if at != core.at {
            core.at.clone_from(&at);
            self.cx.is_at(at.map(|text| AtReport { text, until: None }));
        }
    }

    /// Puts the latest event into the record, and the net as a whole where the record lacks it.
    fn record(self: &Rc<Self>, core: &mut Core, cx: &Context) {
        let name = core.execution.net().name().to_owned();
        let whole = core.journal.lacks_whole(cx.recorders()).then(|| Whole {
            view: self.view.borrow().clone(),
            state: core.journal.stream.state(cx.now(), &core.execution),
        });
        let event = core.journal.stream.last();
        let cx = cx.clone();
        self.when_change_stored(core.changes, move |_| {
            if let Some(whole) = whole {
                cx.record(&format!("/net/{name}"), &whole);
            }
            if let Some(event) = event {
                cx.record(&format!("/firing/{name}"), &event);
            }
        });
    }

    /// Sees to it that those who follow are answered, if there is something for them.
    pub(super) fn call_followers(self: &Rc<Self>, core: &mut Core) {
        if let Some(at) = core.journal.stream.call(|| self.cx.now()) {
            self.answer_at(at);
        }
    }

    /// One more follows.
    pub(super) fn follow(self: &Rc<Self>, request: &Follow, reply: Replier<Follow>) -> Handled {
        let now = self.cx.now();
        let mut core = self.core.borrow_mut();
        if let Err(full) = core.journal.stream.may_be_followed() {
            return reply.fail(full.to_string());
        }
        core.journal.stream.follow(now, request, reply);
        if core.journal.stream.watch() {
            let engine = Rc::clone(self);
            self.cx.spawn(async move { engine.watch_patience().await });
        }
        self.call_followers(&mut core);
        Ok(())
    }

    /// Answers those who follow at `at`: events until then go along.
    fn answer_at(self: &Rc<Self>, at: Instant) {
        let engine = Rc::clone(self);
        self.cx.spawn(async move {
            let cx = &engine.cx;
            cx.sleep(at.since(cx.now())).await;
            let mut core = engine.core.borrow_mut();
            let settled = engine.is_settled(&core);
            let Core {
                execution, journal, ..
            } = &mut *core;
            journal.stream.answer(cx.now(), execution, settled);
        });
    }

    async fn watch_patience(self: Rc<Self>) {
        loop {
            self.cx.sleep(WATCH).await;
            let mut core = self.core.borrow_mut();
            if !core.journal.stream.expire(self.cx.now()) {
                return;
            }
        }
    }
}
