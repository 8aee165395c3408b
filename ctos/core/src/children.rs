//! Tasks that a task starts while it runs: event handlers of their own, which run concurrently and end with it.
//!
//! A child is named after its parent (`PARENT.NAME`). So the name shows to whom it belongs, and a task
//! that waits for the name waits for the parent. It fails into its parent: what its own restart policy
//! does not mend counts as a failure of the parent's handler.

use crate::{
    context::{Context, TaskRef},
    handled::HandlerError,
    phase::{Phase, StopReason},
    runner::{Origin, TaskSpec, start_at},
    supervise::Policy,
    system::{Quiesce, RegisterTid, Shutdown},
};
use ctos_config::{Node, is_name};
use ctos_message::{Tid, fault::CallError};

/// Why a task could not be started by another one.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum StartError {
    /// Its name is none, nobody registered its handler, its processor has no place for it, or its handler could not be
    /// built.
    #[error("`{task}` cannot be started: {reason}")]
    Refused {
        /// The task.
        task: String,
        /// Why.
        reason: String,
    },
    /// Its name could not be had, or it did not enter its phases.
    #[error("`{task}` cannot be started: {}", .error.reason())]
    Call {
        /// The task.
        task: String,
        /// What went wrong.
        error: CallError,
    },
}

impl Context {
    /// Starts the event handler `handler` as a task of its own, called `THIS_TASK.name`, on the same
    /// processor; `args` are its arguments. It passes the three startup phases before this returns, can
    /// be found by everybody, and is shut down when this task's handler ends. When it fails, this task's
    /// handler has failed with it.
    ///
    /// # Errors
    /// [`StartError`]; nothing is left running then.
    pub async fn start(
        &self,
        name: &str,
        handler: &str,
        args: Node,
    ) -> Result<TaskRef, StartError> {
        let task = format!("{}.{name}", self.name());
        let began = self
            .child_spec(name, &task, handler, args)
            .and_then(|spec| {
                let tid = spec.record.tid;
                let origin = Origin::StartedBy(Box::new(self.when_broken()));
                start_at(self.chassis(), &self.inner.processor, spec, origin)?;
                Ok(tid)
            });
        let tid = match began {
            Ok(tid) => tid,
            Err(error) => {
                let reason = error.to_string();
                return Err(StartError::Refused { task, reason });
            }
        };
        let reference = TaskRef::new(task.as_str(), tid);
        self.inner.family().started.push(reference.clone());
        match self.bring_up(&reference).await {
            Ok(()) => Ok(reference),
            Err(error) => {
                self.end_started(&reference).await;
                let mut family = self.inner.family();
                family.started.retain(|one| *one != reference);
                Err(StartError::Call { task, error })
            }
        }
    }
}

#[doc(hidden)]
impl Context {
    fn child_spec(
        &self,
        name: &str,
        task: &str,
        handler: &str,
        args: Node,
    ) -> Result<TaskSpec, HandlerError> {
        if !is_name(name) || !is_name(task) {
            return Err("its name needs 1 to 64 letters, digits, `_`, `-` or `.`".into());
        }
        let registry = self.registry();
        let kind = registry.kind(handler).ok_or_else(|| {
            HandlerError::new(format!("nobody registered the event handler `{handler}`"))
        })?;
        let processor = self.tid().processor();
        let slot = self.chassis().directory.free_slot(processor);
        let slot = slot.ok_or("its processor has had 16777216 tasks in this run")?;
        let tid = Tid::new(self.chassis().index(), processor, slot);
        let config = self.config().cloned();
        let mut config = config.ok_or("a task of the runtime starts no others")?;
        config.name = task.to_owned();
        config.handler = handler.to_owned();
        config.restart = Policy::default();
        config.args = args;
        let handle = &self.inner.processor.handle;
        let recipe = kind.recipe_of(&config, self.app(), &registry);
        Ok(TaskSpec::new(task, tid, Some(config), recipe, handle))
    }

    async fn bring_up(&self, child: &TaskRef) -> Result<(), CallError> {
        let task = child.clone();
        self.call(&Self::server(), RegisterTid { task }).await?;
        let deadline = self.app().phase_timeout;
        for phase in Phase::ALL {
            let enter = crate::system::EnterPhase { phase };
            self.call(child, enter).deadline(deadline).await?;
        }
        Ok(())
    }

    /// Lets the tasks that this one has started come to rest, all at the same time.
    pub(crate) fn quiet_after_started(&self, reason: &StopReason) {
        let family = self.inner.any_family();
        let started = family.map_or_else(Vec::new, |family| family.started.clone());
        for task in started {
            let (cx, reason) = (self.clone(), reason.clone());
            let name = format!("its task `{}`", task.name());
            self.quiet_after(move || name.clone(), async move {
                let deadline = cx.app().stop_timeout;
                match cx.call(&task, Quiesce { reason }).deadline(deadline).await {
                    Err(error) if !error.is_gone() => Err(error.into()),
                    _ => Ok(()),
                }
            });
        }
    }

    /// Shuts down the tasks that this one has started, the latest first.
    pub(crate) async fn end_all_started(&self) {
        loop {
            let family = self.inner.any_family();
            let last = family.and_then(|mut family| family.started.pop());
            let Some(child) = last else { return };
            self.end_started(&child).await;
        }
    }

    async fn end_started(&self, child: &TaskRef) {
        let deadline = self.app().stop_timeout;
        if let Err(error) = self.call(child, Shutdown {}).deadline(deadline).await
            && !error.is_gone()
        {
            tracing::warn!(task = child.name(), error = %error, "did not shut down");
        }
        // Whatever it still does, it does not do as a task of this app any more.
        self.chassis().remove_task(child.tid());
    }
}
