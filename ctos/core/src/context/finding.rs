//! Other tasks by their names.

use std::{
    future::{IntoFuture, Ready, ready},
    sync::Arc,
    time::Duration,
};

use futures_util::future::{Either, LocalBoxFuture};

use super::core::Context;
use crate::{
    system::{self, AwaitTid, FindTid, Missing, Monitor, NamesOf},
    task_ref::TaskRef,
};
use ctos_message::{
    Tid,
    fault::{CallError, Fault},
};

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
    /// The chassis of the task is being restarted, and the caller has waited for it.
    #[error("chassis `{chassis}` is being restarted; it was not back within {:.3} s (`{from}` waits for `{name}`)", .after.as_secs_f64())]
    NotBack {
        /// The waiting task.
        from: String,
        /// The name.
        name: String,
        /// The chassis.
        chassis: String,
        /// How long the caller waited for it.
        after: Duration,
    },
    /// The chassis of the task is gone for good.
    #[error("`{name}`, asked for by `{from}`, is on chassis `{chassis}`, which {why}")]
    Gone {
        /// The asking task.
        from: String,
        /// The name.
        name: String,
        /// The chassis.
        chassis: String,
        /// Why it is not started again.
        why: String,
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

impl NameError {
    /// Whether the task may come back all the same: its chassis is still being restarted, or somebody may
    /// still start it. A caller that asks again waits again. False when that is known not to happen.
    #[must_use]
    pub fn may_come_back(&self) -> bool {
        match self {
            Self::NotBack { .. } | Self::NotYet { .. } => true,
            Self::Unknown { .. } | Self::Gone { .. } | Self::Circle { .. } => false,
            Self::Service(error) => matches!(error.fault, Fault::Deadline { .. }),
        }
    }
}

/// A search for a task by its name, made by [`Context::task`]; awaited, it ends with the task or an error.
#[must_use = "nothing is looked for before it is awaited"]
pub struct Find<'c> {
    cx: &'c Context,
    name: &'c str,
    deadline: Duration,
}

impl Find<'_> {
    /// Waits for so long at most while the task's chassis is being restarted; with zero, not at all.
    pub fn deadline(mut self, deadline: Duration) -> Self {
        self.deadline = deadline;
        self
    }
}

impl<'c> IntoFuture for Find<'c> {
    type Output = Result<TaskRef, NameError>;
    type IntoFuture = Either<Ready<Self::Output>, LocalBoxFuture<'c, Self::Output>>;

    fn into_future(self) -> Self::IntoFuture {
        let Self { cx, name, deadline } = self;
        match cx.known(name) {
            Some((name, tid, true)) => Either::Left(ready(Ok(TaskRef::new(name, tid)))),
            gone => {
                let gone = gone.map(|(_, tid, _)| tid);
                Either::Right(Box::pin(cx.find(name, gone, deadline)))
            }
        }
    }
}

impl Context {
    /// Finds a task by its symbolic name. Found once, a name is remembered by the chassis.
    ///
    /// It waits for a task of the configuration whose chassis is being restarted. That wait lasts from the notice of
    /// the death until its tasks have passed their phases. It waits as long as a call of this task does, unless
    /// [`Find::deadline`] says otherwise. It also waits for a task that the boot has not created yet. The answer
    /// comes at once when the chassis is not started again, or the app is being stopped. It also does when the task
    /// has come to its end, and when no task has the name and none is configured by it. A task that alone is being
    /// restarted keeps its name and its queue: it is found, and calls wait there.
    ///
    /// # Errors
    /// [`NameError`] when no task has the name, it is not back in time, or the service cannot be reached.
    pub fn task<'c>(&'c self, name: &'c str) -> Find<'c> {
        Find {
            cx: self,
            name,
            deadline: self.inner.call_deadline(),
        }
    }

    /// The id that this chassis knows of task `name`, and whether there is a way to its chassis.
    fn known(&self, name: &str) -> Option<(Arc<str>, Tid, bool)> {
        let mut shared = None;
        let known = self.outside(format_args!("the id of {name}"), || {
            let (name, tid) = self.inner.chassis.directory.known(name)?;
            shared = Some(name);
            Some((tid, self.is_near(tid)))
        });
        let (tid, near) = known?;
        Some((shared.unwrap_or_else(|| name.into()), tid, near))
    }

    fn is_near(&self, tid: Tid) -> bool {
        let chassis = &self.inner.chassis;
        tid.chassis() == chassis.index() || chassis.reach(tid.chassis())
    }

    /// Whether there is a way to the chassis of a task.
    fn reaches(&self, tid: Tid) -> bool {
        self.outside(format_args!("the way to {tid}"), || self.is_near(tid))
    }

    /// Asks the service for a task; `gone` is an id of it to which there is no way.
    async fn find(
        &self,
        name: &str,
        mut gone: Option<Tid>,
        deadline: Duration,
    ) -> Result<TaskRef, NameError> {
        let directory = &self.inner.chassis.directory;
        let until = self.now() + deadline;
        let mut away: Option<String> = None;
        loop {
            let waits = away.is_some();
            let request = FindTid {
                name: name.to_owned(),
                gone,
                waits,
            };
            let mut call = self.call(&Self::server(), request);
            if waits {
                call = call.deadline(until.since(self.now()));
            }
            let (from, name) = (self.name().to_owned(), name.to_owned());
            match (call.await, away.take()) {
                (Ok(Ok(tid)), _) if !self.reaches(tid) && gone != Some(tid) => {
                    // The service has not noticed yet what this chassis has.
                    gone = Some(tid);
                }
                (Ok(Ok(tid)), _) => {
                    let tid = directory.learn(&name, tid);
                    return Ok(TaskRef::new(name, tid));
                }
                (Ok(Err(Missing::Away { chassis })), _) => away = Some(chassis),
                (Ok(Err(Missing::Gone { chassis, why })), _) => {
                    return Err(NameError::Gone {
                        from,
                        name,
                        chassis,
                        why,
                    });
                }
                (Ok(Err(Missing::Unknown(known))), _) => {
                    return Err(NameError::Unknown { from, name, known });
                }
                (Err(error), Some(chassis)) if matches!(error.fault, Fault::Deadline { .. }) => {
                    return Err(NameError::NotBack {
                        from,
                        name,
                        chassis,
                        after: deadline,
                    });
                }
                (Err(error), _) => return Err(error.into()),
            }
        }
    }

    /// Finds a task by its symbolic name, and waits for the name if it is not there yet. Another task
    /// may be about to [start](Self::start) it, or its chassis is just being started again.
    ///
    /// # Errors
    /// [`NameError::NotYet`] after `deadline`, with who waits for whom. [`NameError::Circle`] at once, when
    /// the task that would start it waits, directly or not, for a name that only this task can start.
    pub async fn wait_for_task(
        &self,
        name: &str,
        deadline: Duration,
    ) -> Result<TaskRef, NameError> {
        let directory = &self.inner.chassis.directory;
        if let Some((name, tid, _)) = self.known(name) {
            return Ok(TaskRef::new(name, tid));
        }
        let request = AwaitTid {
            name: name.to_owned(),
            waiter: self.name().to_owned(),
        };
        match self.call(&Self::server(), request).deadline(deadline).await {
            Ok(Ok(tid)) => {
                // Who holds a name is told when its chassis goes.
                self.is_near(tid);
                Ok(TaskRef::new(name, directory.learn(name, tid)))
            }
            Ok(Err(circle)) => Err(NameError::Circle { circle }),
            Err(error) if matches!(error.fault, Fault::Deadline { .. }) => {
                let query = system::WhoWaits {
                    name: name.to_owned(),
                };
                Err(NameError::NotYet {
                    from: self.name().to_owned(),
                    name: name.to_owned(),
                    after: deadline,
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
                task: task.clone(),
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

#[doc(hidden)]
impl Context {
    /// The task identification service.
    pub fn server() -> TaskRef {
        TaskRef::new("tidsvr", system::TID_SERVER)
    }
}
