//! The first step of a stop: all tasks come to rest, while every device still answers. The boot names tasks
//! that are late, and the stop goes on.

use std::{cell::RefCell, collections::BTreeSet, pin::pin, time::Duration};

use futures_util::future::{Either, join_all, pending, select};

use crate::bootstrap::{
    BootEvent, End, StopStep,
    board::Board,
    explain::{TIMEOUT, explained},
};
use ctos_core::{
    context::TaskRef,
    phase::{Phase, StopReason},
    system::{NotQuiet, Quiesce},
};
use ctos_message::fault::Fault;

/// When a person is told whom the step waits for.
const TELL_AFTER: Duration = Duration::from_secs(1);

impl Board {
    /// Lets all tasks come to rest, for `app.stop_timeout_s` at most; a further interrupt ends the step. Only
    /// tasks of chassis whose tasks have all begun to run are asked: the others have nothing to end.
    pub(super) async fn quiesce(&self, reason: &StopReason) {
        let tasks = self.running_tasks();
        if tasks.is_empty() {
            return;
        }
        let (began, step) = (self.cx.now(), StopStep::Quiesce);
        self.event(&BootEvent::StopStep { step });
        let names = tasks.iter().map(|task| task.name().to_owned());
        let awaited: RefCell<BTreeSet<String>> = RefCell::new(names.collect());
        let late = RefCell::new(0);
        let not_quiet = |task: &str, reason: String| {
            *late.borrow_mut() += 1;
            let task = task.to_owned();
            self.event(&BootEvent::NotQuiet { task, reason });
        };
        let asked = tasks.iter().map(|task| async {
            let quiet = self.is_quiet(task, reason).await;
            awaited.borrow_mut().remove(task.name());
            if let Err(why) = quiet {
                not_quiet(task.name(), why);
            }
        });
        let all = pin!(join_all(asked));
        let told = pin!(async {
            self.cx.sleep(TELL_AFTER).await;
            let tasks = awaited.borrow().iter().cloned().collect();
            self.event(&BootEvent::QuietAwaited { tasks });
            pending::<()>().await;
        });
        let interrupted = pin!(self.interrupted());
        if let Either::Right((why, _)) = select(select(all, told), interrupted).await {
            let skipped = std::mem::take(&mut *awaited.borrow_mut());
            for task in skipped {
                not_quiet(&task, why.to_owned());
            }
        }
        let late = *late.borrow();
        self.event(&BootEvent::Quiet {
            tasks: tasks.len().saturating_sub(late),
            of: tasks.len(),
            took: self.cx.now().since(began),
        });
    }

    /// Ends when the person asks once more; returns what the boot says of a task for which it no longer waits.
    pub(super) async fn interrupted(&self) -> &'static str {
        loop {
            match self.next_end().await {
                End::Interrupted => return "skipped at a second interrupt",
                End::Stopped => return "skipped at a second order to stop",
                _ => {}
            }
        }
    }

    fn running_tasks(&self) -> Vec<TaskRef> {
        let running = self.members.iter();
        let running = running.filter(|member| member.reached.get() == Some(Phase::Run));
        let tasks = running.flat_map(|member| member.tasks());
        tasks
            .filter(|task| self.cx.chassis().is_linked(self.place_of(task)))
            .collect()
    }

    /// Lets one task come to rest.
    async fn is_quiet(&self, task: &TaskRef, reason: &StopReason) -> Result<(), String> {
        let reason = reason.clone();
        let timeout = self.cx.app().stop_timeout;
        let asked = self.cx.call(task, Quiesce { reason });
        let error = match asked.deadline(timeout).await {
            Ok(()) => return Ok(()),
            // A task that is not there was shut down before.
            Err(error) if error.fault == Fault::UnknownTask => return Ok(()),
            Err(error) => error,
        };
        let Fault::Deadline { after } = error.fault else {
            return Err(error.reason());
        };
        let why = self.cx.call(task, NotQuiet {}).deadline(TIMEOUT);
        match why.await {
            Ok(Some(waits)) => Err(format!("not within {:.3} s: {waits}", after.as_secs_f64())),
            Ok(None) => Ok(()),
            Err(_) => Err(explained(&self.cx, task, "come to rest", error).await),
        }
    }
}
