//! Other tasks by their names.

use std::{sync::Arc, time::Duration};

use super::Context;
use crate::{
    call::{CallError, Fault},
    message::Tid,
    system::{self, AwaitTid, Monitor, NamesOf, QueryTid},
};

/// A task that was found by name.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct TaskRef {
    pub(super) name: Arc<str>,
    pub(super) tid: Tid,
}

impl TaskRef {
    pub(crate) fn new(name: impl Into<Arc<str>>, tid: Tid) -> Self {
        Self {
            name: name.into(),
            tid,
        }
    }

    /// Its symbolic name.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Its id.
    #[must_use]
    pub fn tid(&self) -> Tid {
        self.tid
    }
}

/// A symbolic name that leads to no task.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum NameError {
    /// The task identification service knows no such name.
    #[error("no task is called `{name}` (asked by `{from}`); there are: {}", .known.join(", "))]
    Unknown {
        /// The asking task.
        from: String,
        /// The name.
        name: String,
        /// The names there are.
        known: Vec<String>,
    },
    /// A task waits for a name that does not appear.
    #[error("`{from}` waited {:.3} s for a task called `{name}`: {why}", .after.as_secs_f64())]
    NotYet {
        /// The waiting task.
        from: String,
        /// The name.
        name: String,
        /// How long it waited.
        after: Duration,
        /// Who waits for whom.
        why: String,
    },
    /// Tasks wait for one another in a circle, so that none of the names can ever appear.
    #[error("nobody can go on: {circle}")]
    Circle {
        /// The circle in words.
        circle: String,
    },
    /// The service itself could not be asked.
    #[error(transparent)]
    Service(#[from] CallError),
}

impl Context {
    /// Finds a task by its symbolic name. Found once, a name is remembered by the chassis.
    ///
    /// # Errors
    /// [`NameError`] when no task has the name or the service cannot be reached.
    pub async fn task(&self, name: &str) -> Result<TaskRef, NameError> {
        let directory = &self.inner.chassis.directory;
        if let Some((name, tid)) = directory.known(name) {
            return Ok(TaskRef::new(name, tid));
        }
        let query = QueryTid {
            name: name.to_owned(),
        };
        match self.call(&Self::server(), query).await? {
            Ok(tid) => Ok(TaskRef::new(name, directory.learn(name, tid))),
            Err(known) => Err(NameError::Unknown {
                from: self.name().to_owned(),
                name: name.to_owned(),
                known,
            }),
        }
    }

    /// The task identification service.
    pub(crate) fn server() -> TaskRef {
        TaskRef::new("tidsvr", system::TID_SERVER)
    }

    /// Finds a task by its symbolic name, and waits for the name to appear if there is none yet: another
    /// task may be about to [start](Self::start) it, or its chassis is just being started again.
    ///
    /// # Errors
    /// [`NameError::NotYet`] after `limit`, with who waits for whom; [`NameError::Circle`] at once, when
    /// the task that would start it waits, directly or not, for a name that only this task can start.
    pub async fn wait_for_task(&self, name: &str, limit: Duration) -> Result<TaskRef, NameError> {
        let directory = &self.inner.chassis.directory;
        if let Some((name, tid)) = directory.known(name) {
            return Ok(TaskRef::new(name, tid));
        }
        let request = AwaitTid {
            name: name.to_owned(),
            waiter: self.name().to_owned(),
        };
        match self.call(&Self::server(), request).deadline(limit).await {
            Ok(Ok(tid)) => Ok(TaskRef::new(name, directory.learn(name, tid))),
            Ok(Err(circle)) => Err(NameError::Circle { circle }),
            Err(error) if matches!(error.fault, Fault::Deadline { .. }) => {
                let query = system::WhoWaits {
                    name: name.to_owned(),
                };
                Err(NameError::NotYet {
                    from: self.name().to_owned(),
                    name: name.to_owned(),
                    after: limit,
                    why: self.call(&Self::server(), query).await?,
                })
            }
            Err(error) => Err(error.into()),
        }
    }

    /// From now on the handler's `task_down` and `task_up` are called when `task` goes down and comes
    /// up again. When it is down already, `task_down` is called at once.
    ///
    /// # Errors
    /// When the task identification service cannot be asked.
    pub async fn monitor(&self, task: &TaskRef) -> Result<(), CallError> {
        let name = task.name().to_owned();
        let up = self.call(&Self::server(), Monitor { name }).await?;
        if !up {
            let changed = system::TaskChanged {
                task: system::TaskName {
                    name: task.name().to_owned(),
                    tid: task.tid(),
                },
                change: system::Change::Down {
                    reason: "it was not there when it began to be monitored".to_owned(),
                },
            };
            self.inner.chassis.post_system(self.tid(), changed);
        }
        Ok(())
    }

    /// The symbolic name of the task with this id, also of one that is gone: an id is never given twice.
    ///
    /// # Errors
    /// When the task identification service cannot be asked.
    pub async fn name_of(&self, tid: Tid) -> Result<Option<String>, CallError> {
        let asked = self.call(&Self::server(), NamesOf { tids: vec![tid] });
        Ok(asked.await?.pop().flatten())
    }
}
