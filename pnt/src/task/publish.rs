//! The net's task at its end of the stream: puts events into the record, and answers those who follow, in
//! its own time and never in the net's.

use std::rc::Rc;

use ctos::{
    message::Replier,
    task::{Context, Handled},
    time::Instant,
};
use std::time::Duration;

use super::engine::{Core, Engine};
use crate::stream::{Follow, Happened, NetView, State};

/// How often the patience of those who follow is looked at.
const WATCH: Duration = Duration::from_millis(500);

/// A net as it stands in a record as a whole.
#[derive(serde::Serialize)]
struct Whole<'w> {
    view: &'w NetView,
    state: State,
}

impl<S: 'static> Engine<S> {
    /// Notes what happened, and publishes it.
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
            if core.journal.lacks_whole(cx.recorders()) {
                let state = core.journal.stream.state(cx.now(), &core.execution);
                let whole = Whole {
                    view: &self.view,
                    state,
                };
                cx.record(&format!("/net/{}", self.net.name()), &whole);
            }
            if let Some(event) = core.journal.stream.last() {
                cx.record(&format!("/firing/{}", self.net.name()), &event);
            }
        }
        if let Some(at) = core.journal.stream.call(cx.now()) {
            self.answer_at(at);
        }
    }

    /// One more follows.
    pub(super) fn follow(self: &Rc<Self>, request: &Follow, reply: Replier<Follow>) -> Handled {
        let now = self.cx.now();
        let mut core = self.core.borrow_mut();
        core.journal.stream.follow(now, request, reply)?;
        if core.journal.stream.watch() {
            let engine = Rc::clone(self);
            self.cx.spawn(async move { engine.watch_patience().await });
        }
        if let Some(at) = core.journal.stream.call(now) {
            self.answer_at(at);
        }
        Ok(())
    }

    /// Answers those who follow at `at`: events until then go along.
    fn answer_at(self: &Rc<Self>, at: Instant) {
        let engine = Rc::clone(self);
        self.cx.spawn(async move {
            let cx = &engine.cx;
            cx.sleep(at.since(cx.now())).await;
            let mut core = engine.core.borrow_mut();
            let Core {
                execution, journal, ..
            } = &mut *core;
            journal.stream.answer(cx.now(), execution);
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
