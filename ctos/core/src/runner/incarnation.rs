//! The end of a handler and the beginning of its next one, as `supervise.rs` rules.

use std::{panic::AssertUnwindSafe, pin::pin};

use futures_util::{
    FutureExt,
    future::{Either, select},
};

use super::{Next, Runner, build_contained, drop_handler, dynamic::Notice};
use crate::{
    contain::{contained, panic_text},
    context::{Context, TaskRef},
    envelope::Message,
    handled::Handled,
    phase::{Phase, StopReason},
    supervise::{Ending, Event, State, Verdict},
    system::{Broke, Change, RestartTask, Shutdown, TaskChanged},
};

/// What came of building a handler anew.
enum Rebuilt {
    Yes,
    No(String),
    StopWaits,
}

impl Runner {
    /// A child or a synchronous function of this task panicked.
    pub(super) async fn broke(&mut self, message: Message) -> Next {
        match message.open::<Broke>() {
            Ok((broke, _)) if broke.incarnation == self.cx.incarnation() => {
                tracing::error!(task = %self.cx.name(), reason = %broke.reason, "a part of it broke");
                self.supervise(Ending::Failure, broke.reason).await
            }
            _ => Next::Take,
        }
    }

    /// A person wants the handler built anew, whatever the policy says.
    pub(super) async fn restart(&mut self, message: Message) -> Next {
        let Ok((RestartTask {}, reply)) = message.open::<RestartTask>() else {
            return Next::Take;
        };
        // Below, a reply cannot fail.
        if self.state == State::Stopped {
            let _ = reply.fail("it is being stopped");
            return Next::Take;
        }
        let why = "it is restarted by order".to_owned();
        self.end_incarnation(Ending::Order).await;
        self.tell(Change::Down { reason: why });
        self.record.statistics.activity().restarted();
        match self.rebuild_or_stop().await {
            Rebuilt::Yes => {
                self.tell(Change::Up);
                tracing::warn!(task = %self.cx.name(), "restarted by order");
                let _ = reply.ok(());
                Next::Take
            }
            Rebuilt::StopWaits => {
                let _ = reply.fail("it is being stopped");
                Next::Take
            }
            Rebuilt::No(broken) => {
                let why = format!("it could not be restarted: {broken}");
                let _ = reply.fail(&why);
                self.kept = None;
                self.supervise(Ending::Failure, why).await
            }
        }
    }

    /// Comes to an orderly stop by itself.
    pub(super) async fn shut_down(&mut self, message: Message) -> Next {
        let Ok((Shutdown {}, reply)) = message.open::<Shutdown>() else {
            return Next::Take;
        };
        let deadline = self.cx.app().stop_timeout;
        let cx = self.cx.clone();
        let mut why = "it was told to shut down".to_owned();
        if let Some(handler) = &mut self.handler {
            let stopping = AssertUnwindSafe(handler.tell(&cx, Notice::Stop(&StopReason::Shutdown)));
            match cx.timeout(deadline, stopping.catch_unwind()).await {
                Ok(Ok(Ok(()))) => {}
                Ok(Ok(Err(error))) => why = format!("it was told to shut down and said: {error}"),
                Ok(Err(panic)) => {
                    let text = panic_text(panic.as_ref());
                    why = format!("it panicked while it shut down: {text}");
                }
                Err(elapsed) => why = format!("it was told to shut down: {elapsed}"),
            }
        }
        let next = self.supervise(Ending::Order, why).await;
        // Never an error: a reply cannot fail.
        let _ = reply.ok(());
        next
    }

    /// What happens after an end: what the restart policy rules.
    pub(super) async fn supervise(&mut self, ending: Ending, why: String) -> Next {
        self.cx.processor().leave();
        let (mut ending, mut why) = (ending, why);
        loop {
            self.end_incarnation(ending).await;
            let verdict = if self.state == State::Stopped {
                Verdict::StayDown
            } else {
                let now = self.cx.now();
                self.restarts().judge(ending, now)
            };
            let Verdict::RestartAfter(backoff) = verdict else {
                self.give_up(ending, &why, verdict).await;
                return Next::End;
            };
            self.step(Event::RestartAllowed);
            self.tell(Change::Down {
                reason: why.clone(),
            });
            if !self.backs_off(backoff).await {
                return Next::Take;
            }
            self.step(Event::BackoffOver);
            self.record.statistics.activity().restarted();
            match self.rebuild_or_stop().await {
                Rebuilt::Yes => {
                    self.step(Event::Rebuilt);
                    self.tell(Change::Up);
                    tracing::warn!(task = %self.cx.name(), reason = %why, "restarted");
                    return Next::Take;
                }
                // Half rebuilt, but what can be stopped of it is stopped next.
                Rebuilt::StopWaits => return Next::Take,
                Rebuilt::No(broken) => {
                    // What may have broken it is not tried twice.
                    self.kept = None;
                    ending = Ending::Failure;
                    why = format!("it could not be restarted: {broken}");
                }
            }
        }
    }

    /// Waits before a restart; false when an order to stop came meanwhile.
    async fn backs_off(&self, backoff: std::time::Duration) -> bool {
        let sleep = pin!(self.cx.sleep(backoff));
        let stop = pin!(self.queue.stop_waits());
        matches!(select(sleep, stop).await, Either::Left(_))
    }

    async fn rebuild_or_stop(&mut self) -> Rebuilt {
        let (cx, queue) = (self.cx.clone(), self.queue.clone());
        let deadline = cx.app().phase_timeout;
        let rebuilt = AssertUnwindSafe(cx.timeout(deadline, self.rebuild())).catch_unwind();
        match select(pin!(rebuilt), pin!(queue.stop_waits())).await {
            Either::Left((Ok(Ok(Ok(()))), _)) => Rebuilt::Yes,
            Either::Left((Ok(Ok(Err(error))), _)) => Rebuilt::No(error.to_string()),
            Either::Left((Ok(Err(elapsed)), _)) => Rebuilt::No(elapsed.to_string()),
            Either::Left((Err(panic), _)) => {
                Rebuilt::No(format!("it panicked again: {}", panic_text(panic.as_ref())))
            }
            Either::Right(_) => Rebuilt::StopWaits,
        }
    }

    /// The old incarnation is finished before a new one begins. Its state is kept where that is allowed.
    /// Its children, its tasks and its unanswered requests end now.
    pub(crate) async fn end_incarnation(&mut self, ending: Ending) {
        self.cx.next_incarnation();
        self.cx.cancel_children();
        self.queue.forget_broken();
        if let Some(mut handler) = self.handler.take() {
            if self.cx.inner.kept.is_some() {
                // What was stored last is all that anybody has seen.
                self.kept = self.cx.load_state().await.ok().flatten();
            } else if ending == Ending::Order || handler.survives_panic() {
                match contained(|| handler.hand_over()) {
                    Ok(Some(Ok(state))) => self.kept = Some(state),
                    Ok(Some(Err(error))) => {
                        tracing::warn!(task = %self.cx.name(), error = %error, "no state is kept");
                    }
                    Ok(None) | Err(_) => {}
                }
            }
            drop_handler(&self.cx, handler);
        }
        self.cx.end_all_started().await;
    }

    /// It is not restarted: its starter or its chassis is told, and its name is free.
    async fn give_up(&mut self, ending: Ending, why: &str, verdict: Verdict) {
        let tried = match verdict {
            Verdict::GiveUp { restarts } => format!(" (after {restarts} restarts)"),
            _ => String::new(),
        };
        let reason = format!("{why}{tried}");
        match ending {
            Ending::Order if self.state == State::Running => self.step(Event::ShutDown),
            Ending::Order => {}
            Ending::Failure => {
                self.step(Event::RestartRefused);
                match &self.parent {
                    Some(parent) => parent(&format!("`{}`: {reason}", self.cx.name())),
                    None => self.cx.fail(&reason),
                }
            }
        }
        // Whatever is still in its queue is answered before the name can be anybody else's.
        self.cx.chassis().remove_task(self.cx.tid());
        let ended = Change::Ended { reason };
        if self.cx.chassis().is_stopping() {
            // Nobody takes the name any more, so nobody need wait until it is free.
            return self.tell(ended);
        }
        let told = self.cx.call(&Context::server(), self.changed(ended));
        if let Err(error) = told.deadline(self.cx.app().stop_timeout).await {
            tracing::debug!(task = %self.cx.name(), error = %error, "its name is not free");
        }
    }

    fn changed(&self, change: Change) -> TaskChanged {
        TaskChanged {
            task: TaskRef::new(self.record.name.clone(), self.record.tid),
            change,
        }
    }

    fn tell(&self, change: Change) {
        let changed = self.changed(change);
        let chassis = self.cx.chassis();
        chassis.post_system(crate::system::TID_SERVER, changed);
    }

    /// A move came to nothing after the state had been given away.
    pub(super) async fn rebuilt_after_failed_move(&mut self) -> Next {
        match self.rebuild_or_stop().await {
            Rebuilt::Yes | Rebuilt::StopWaits => Next::Take,
            Rebuilt::No(why) => {
                let why = format!("it could not go on after a move that failed: {why}");
                self.supervise(Ending::Failure, why).await
            }
        }
    }

    /// Builds the handler anew and brings it to the phase that the old one had reached. Messages
    /// that wait in the queue stay there.
    async fn rebuild(&mut self) -> Handled {
        let mut handler = build_contained(&self.recipe, &self.cx)?;
        if let Some(state) = &self.kept {
            handler.take_over(&self.cx, state)?;
        }
        let handler = self.handler.insert(handler);
        let reached = self.phase;
        for phase in Phase::ALL {
            if reached.is_some_and(|reached| phase <= reached) {
                handler.tell(&self.cx, Notice::Phase(phase)).await?;
            }
        }
        self.kept = None;
        let cx = self.cx.clone();
        self.come_to_rest(&cx).await
    }
}
