//! Coming to rest before the app is stopped: what a task was told, and what its acknowledgement waits for.

use std::{collections::BTreeMap, future::Future};

use super::core::Context;
use crate::{envelope::Replier, handled::Handled, phase::StopReason, system::Quiesce};

/// Says what the task waits for, in words.
type Words = Box<dyn Fn() -> String>;

/// What a task knows of the end of its app.
pub(crate) struct Quiet {
    reason: StopReason,
    /// Who hears that it is at rest.
    reply: Option<Replier<Quiesce>>,
    /// Whether its handler has said that it is, but for what still runs concurrently.
    said: bool,
    waits: BTreeMap<u64, Words>,
    /// The number of the next of them.
    next: u64,
    /// Why it did not come to rest.
    failed: Option<String>,
}

impl Quiet {
    /// What ran concurrently with the handler has ended with it.
    pub(super) fn forget(&mut self) -> impl Sized + use<> {
        self.said = false;
        std::mem::take(&mut self.waits)
    }
}

impl Context {
    /// What is known of the end of the app, once that has begun.
    fn quiet<T>(&self, look: impl FnOnce(&mut Quiet) -> T) -> Option<T> {
        let mut family = self.inner.any_family()?;
        family.quiet.as_deref_mut().map(look)
    }

    /// Runs `rests` as a child of this task, and lets the acknowledgement of
    /// [`quiesce`](crate::handler::EventHandler::quiesce) wait for its end; the task takes messages meanwhile.
    /// Should it be late, `waits_for` tells the person what for. It is dropped when the task is stopped,
    /// which is `app.stop_timeout_s` after the beginning of the stop at the latest. An error is shown.
    pub fn quiet_after(
        &self,
        waits_for: impl Fn() -> String + 'static,
        rests: impl Future<Output = Handled> + 'static,
    ) {
        let number = self.quiet(|quiet| {
            let number = quiet.next;
            quiet.next += 1;
            quiet.waits.insert(number, Box::new(waits_for));
            number
        });
        let cx = self.clone();
        self.spawn(async move {
            let ended = rests.await;
            if let Some(number) = number {
                cx.rests(number, ended);
            }
        });
    }

    fn rests(&self, number: u64, ended: Handled) {
        let words = self.quiet(|quiet| {
            if let Err(error) = ended {
                quiet.failed.get_or_insert(error.to_string());
            }
            quiet.waits.remove(&number)
        });
        drop(words);
        self.settle();
    }

    /// The app is about to be stopped. Tasks that wait for this one to be at rest are told later.
    pub(crate) fn begin_stop(&self, reason: &StopReason, reply: Option<Replier<Quiesce>>) {
        let mut family = self.inner.family();
        let quiet = family.quiet.get_or_insert_with(|| {
            Box::new(Quiet {
                reason: reason.clone(),
                reply: None,
                said: false,
                waits: BTreeMap::new(),
                next: 0,
                failed: None,
            })
        });
        let before = std::mem::replace(&mut quiet.reply, reply);
        // Not held while the waiting task is told.
        drop(family);
        drop(before);
    }

    /// Why the app is being stopped, if it is.
    pub(crate) fn stop_reason(&self) -> Option<StopReason> {
        self.quiet(|quiet| quiet.reason.clone())
    }

    /// The handler is at rest, but for what still runs concurrently.
    pub(crate) fn said_quiet(&self) {
        self.quiet(|quiet| quiet.said = true);
        self.settle();
    }

    /// Tells that the task is at rest, if it is.
    fn settle(&self) {
        let settled = self.quiet(|quiet| {
            if !quiet.said || !quiet.waits.is_empty() {
                return None;
            }
            Some((quiet.reply.take()?, quiet.failed.take()))
        });
        // A reply cannot fail.
        let _ = match settled.flatten() {
            Some((reply, None)) => reply.ok(()),
            Some((reply, Some(why))) => reply.fail(why),
            None => Ok(()),
        };
    }

    /// What this task still waits for before it is at rest, in words.
    pub(crate) fn not_quiet(&self) -> Option<String> {
        // Not held while they are called: they may reach the task.
        let waits = self.quiet(|quiet| std::mem::take(&mut quiet.waits))?;
        let words: Vec<String> = waits.values().map(|words| words()).collect();
        self.quiet(|quiet| quiet.waits.extend(waits));
        (!words.is_empty()).then(|| words.join("; "))
    }

    /// Whether the app is being stopped, as far as this task was told: from the call of its handler's
    /// [`quiesce`](crate::handler::EventHandler::quiesce) on. Begin only what must be begun then.
    #[must_use]
    pub fn is_stopping(&self) -> bool {
        self.quiet(|_| ()).is_some()
    }
}
