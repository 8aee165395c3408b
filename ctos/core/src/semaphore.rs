//! The inter-processor blocking service: named counting semaphores and barriers (CIRSSE report 108,
//! section 3).
//!
//! One of *chassis* scope is shared by the processors of a chassis and costs no message. One of *app* scope is
//! shared by all chassis of the app; a task of the runtime, on the chassis that boots, keeps it. Both serve
//! waiters first come, first served, high priority before normal. A released permit goes straight to the next,
//! so nobody can slip in between. A [`Permit`] is released when it is dropped, and when its chassis dies. It
//! is also released when the task that holds it ends or is built anew after a panic. Waiting ends with the
//! permit or an error that names the holders, always.
//!
//! A synchronous function must not use them: they take a lock, and their waiters are woken.

mod error;
mod ledger;
#[doc(hidden)]
pub mod server;
mod store;

use std::{future::IntoFuture, sync::Arc, time::Duration};

use futures_util::future::LocalBoxFuture;
use serde::{Deserialize, Serialize};

use crate::{
    context::{Context, TaskRef},
    system,
};
pub use ctos_config::Scope;
use ctos_message::{Tid, fault::CallError};
use ctos_time::Instant;
pub use error::SemaphoreError;
use ledger::{Claim, Kind};
use server::{AwaitTurn, ListSemaphores};
use store::{Answer, Kept, Ticket};

/// How much longer than the wait itself the answer of another chassis may take.
const GRACE: Duration = Duration::from_secs(2);

/// Names that begin so are of app scope, unless the configuration says otherwise.
const APP_PREFIX: &str = "app/";

/// Somebody who holds a permit, or has arrived at a barrier.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Holder {
    /// The task.
    pub task: String,
    /// Its id.
    pub tid: Tid,
    /// Since when, by the clock of the chassis that keeps the semaphore.
    pub since: Instant,
}

/// A semaphore as others see it.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct SemaphoreView {
    /// Its name.
    pub name: String,
    /// Who shares it.
    pub scope: Scope,
    /// How many permits it has.
    pub permits: u32,
    /// Who holds one, the longest first.
    pub holders: Vec<Holder>,
    /// The tasks that wait, in the order in which they will be served.
    pub waiting: Vec<String>,
}

fn server() -> TaskRef {
    TaskRef::new("semsvr", system::SEMAPHORE_SERVER)
}

/// A semaphore or barrier as one task knows it.
#[derive(Debug, Clone)]
struct Named {
    cx: Context,
    kind: Kind,
    name: Arc<str>,
    /// Permits or parties.
    count: u32,
    /// `None` when the server keeps it.
    kept: Option<Arc<Kept>>,
}

impl Named {
    /// With `count`, unless the configuration says how many.
    fn find(cx: &Context, kind: Kind, name: &str, count: u32) -> Result<Self, SemaphoreError> {
        let app = cx.app();
        let kinds = match kind {
            Kind::Semaphore => &app.semaphores,
            Kind::Barrier => &app.barriers,
        };
        let declared = kinds.iter().find(|one| one.name == name);
        let declared = declared.map(|one| (one.count, one.scope));
        let (declared, scope) = declared.unwrap_or_default();
        let count = declared.unwrap_or(count);
        if count == 0 {
            return Err(SemaphoreError::Nobody {
                name: name.to_owned(),
                task: cx.name().to_owned(),
            });
        }
        let by_name = || match name.starts_with(APP_PREFIX) {
            true => Scope::App,
            false => Scope::Chassis,
        };
        let here = scope.unwrap_or_else(by_name) == Scope::Chassis;
        let store = cx.chassis().blocking();
        let named = Self {
            cx: cx.clone(),
            kind,
            name: name.into(),
            count,
            kept: here.then(|| store.find(kind, Scope::Chassis, name, count)),
        };
        match named.kept.as_ref().map(|kept| kept.count()) {
            Some(has) if has != count => Err(named.disagree(has)),
            _ => Ok(named),
        }
    }

    /// Waits to be served; what the ticket stands for is given back with it.
    async fn wait(&self, high: bool, wait: Duration) -> Result<(Ticket, Passage), SemaphoreError> {
        let cx = &self.cx;
        // From here on, whatever happens, the ticket gives back what it stands for.
        let ticket = Ticket::new(cx, self.kept.clone());
        let answer = match &self.kept {
            Some(kept) => {
                let claim = Claim {
                    hold: ticket.hold,
                    task: cx.inner.record.name.clone(),
                    tid: cx.tid(),
                };
                let served = kept.enter(claim, high);
                kept.wait(cx, ticket.hold, served, wait).await
            }
            None => {
                let request = AwaitTurn {
                    kind: self.kind,
                    name: self.name.to_string(),
                    count: self.count,
                    hold: ticket.hold.number,
                    task: cx.name().to_owned(),
                    wait,
                    high,
                };
                let patience = wait.saturating_add(GRACE);
                let answer = cx.call(&server(), request).deadline(patience).await?;
                if self.kind == Kind::Barrier || !matches!(answer, Answer::Served(_)) {
                    ticket.settle();
                }
                Some(answer)
            }
        };
        let (name, task) = (self.name.to_string(), cx.name().to_owned());
        match (answer, self.kind) {
            (Some(Answer::Served(passage)), _) => Ok((ticket, passage)),
            (Some(Answer::Late(late)), Kind::Semaphore) => Err(SemaphoreError::Deadline {
                name,
                task,
                after: wait,
                holders: late.holders,
                before: late.before,
            }),
            (Some(Answer::Late(late)), Kind::Barrier) => Err(SemaphoreError::Missing {
                name,
                task,
                after: wait,
                arrived: late.waiting,
                parties: self.count,
            }),
            (Some(Answer::Disagree { has }), _) => Err(self.disagree(has)),
            (None, _) => Err(SemaphoreError::Ending { name, task }),
        }
    }

    fn disagree(&self, has: u32) -> SemaphoreError {
        SemaphoreError::Disagree {
            name: self.name.to_string(),
            task: self.cx.name().to_owned(),
            has,
            asked: self.count,
        }
    }
}

/// A counting semaphore, found by name with [`Context::semaphore`].
#[derive(Debug, Clone)]
pub struct Semaphore(Named);

impl Semaphore {
    /// A permit if there is one now.
    ///
    /// # Errors
    /// When the task that keeps the semaphore cannot be asked, or knows it with another number of permits.
    pub async fn try_acquire(&self) -> Result<Option<Permit>, SemaphoreError> {
        match self.acquire().deadline(Duration::ZERO).await {
            Ok(permit) => Ok(Some(permit)),
            Err(SemaphoreError::Deadline { .. }) => Ok(None),
            Err(error) => Err(error),
        }
    }

    /// Its name.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.0.name
    }

    /// Waits for a permit: `.await` it. 10 s, or the task's `call_deadline_s`, at the most, unless
    /// [`Acquire::deadline`] says otherwise.
    pub fn acquire(&self) -> Acquire {
        Acquire {
            semaphore: self.clone(),
            deadline: self.0.cx.inner.call_deadline(),
            high: false,
        }
    }
}

/// A permit for which nobody has waited yet; `.await` waits.
#[must_use = "a permit is waited for when this is awaited"]
#[derive(Debug)]
pub struct Acquire {
    semaphore: Semaphore,
    deadline: Duration,
    high: bool,
}

impl Acquire {
    /// Waits at most this long.
    pub fn deadline(mut self, deadline: Duration) -> Self {
        self.deadline = deadline;
        self
    }

    /// Is served before those of normal priority.
    pub fn high_priority(mut self) -> Self {
        self.high = true;
        self
    }
}

impl IntoFuture for Acquire {
    type Output = Result<Permit, SemaphoreError>;
    type IntoFuture = LocalBoxFuture<'static, Self::Output>;

    fn into_future(self) -> Self::IntoFuture {
        Box::pin(async move {
            let named = self.semaphore.0;
            let (ticket, passage) = named.wait(self.high, self.deadline).await?;
            Ok(Permit {
                semaphore: named.name,
                ticket,
                number: passage.generation,
            })
        })
    }
}

/// One of a semaphore's permits. Dropped, it goes to the first that waits.
///
/// A permit of app scope is a promise with a limit of time. A chassis that gives no sign of life for `peer_timeout_s`
/// is given up, and its permits go to those who wait. Should it only have been frozen, its tasks go on, and the
/// permit that they have is [no longer good](Self::confirm). So every request to the owner of what the semaphore
/// protects brings the [number](Self::number) of the permit. The owner refuses older ones with a [`Fence`].
#[must_use = "a permit that is dropped is given back at once"]
#[derive(Debug)]
pub struct Permit {
    semaphore: Arc<str>,
    ticket: Ticket,
    number: u64,
}

impl Permit {
    /// Gives it back.
    pub fn release(self) {
        drop(self.ticket);
    }

    /// The fencing number: each permit of a semaphore has a greater one than all before it, in one run of the app.
    #[must_use]
    pub fn number(&self) -> u64 {
        self.number
    }

    /// Asks the keeper of the semaphore whether the permit is still good: before something that no [`Fence`]
    /// protects. It was good when that was answered; a freeze may come between that and what follows.
    ///
    /// # Errors
    /// [`SemaphoreError::Lost`]; or nobody can be asked, and the permit may be somebody else's.
    pub async fn confirm(&self, cx: &Context) -> Result<(), SemaphoreError> {
        if self.ticket.is_good(cx).await? {
            return Ok(());
        }
        Err(SemaphoreError::Lost {
            name: self.semaphore.to_string(),
            task: cx.name().to_owned(),
        })
    }
}

/// What an owner has seen of the permits of a semaphore with one permit: it lets newer ones in and shuts older ones out.
/// Serializable, so that a durable task keeps it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct Fence(u64);

impl Fence {
    /// Lets a request pass that brings the [number](Permit::number) of its permit.
    ///
    /// # Errors
    /// [`SemaphoreError::Outdated`]: a later permit has passed before.
    pub fn pass(&mut self, number: u64) -> Result<(), SemaphoreError> {
        if number < self.0 {
            let passed = self.0;
            return Err(SemaphoreError::Outdated { number, passed });
        }
        self.0 = number;
        Ok(())
    }
}

/// A barrier, found by name with [`Context::barrier`].
#[derive(Debug, Clone)]
pub struct Barrier {
    named: Named,
    deadline: Duration,
}

/// What became of a wait at a barrier.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct Passage {
    /// Counts how often everybody has passed, from 1 on.
    pub generation: u64,
    /// Whether the task was the last to arrive: one of each generation is.
    pub last: bool,
}

impl Barrier {
    /// Waits at most this long.
    #[must_use]
    pub fn deadline(mut self, deadline: Duration) -> Self {
        self.deadline = deadline;
        self
    }

    /// Waits until everybody has arrived. A task that gives up, or dies, before that has not
    /// arrived.
    ///
    /// # Errors
    /// [`SemaphoreError::Missing`] names those who have arrived.
    pub async fn wait(&self) -> Result<Passage, SemaphoreError> {
        let (_, passage) = self.named.wait(false, self.deadline).await?;
        Ok(passage)
    }

    /// Its name.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.named.name
    }
}

impl Context {
    /// The semaphores that this task could use, who holds them and who waits: those of this chassis and
    /// those of the app.
    ///
    /// # Errors
    /// When the task that keeps those of the app cannot be asked.
    pub async fn semaphores(&self) -> Result<Vec<SemaphoreView>, CallError> {
        let mut views = self.call(&server(), ListSemaphores {}).await?;
        let here = self.chassis().semaphores().into_iter();
        views.extend(here.filter(|view| view.scope == Scope::Chassis));
        Ok(views)
    }

    /// The counting semaphore called `name`, with `permits` unless `[semaphore.NAME]` of the configuration
    /// says how many. The tasks of this chassis share it. Those of the whole app do if the configuration
    /// says so or its name begins with `app/`.
    ///
    /// # Errors
    /// [`SemaphoreError`]: no permits at all, or another number than others use.
    pub fn semaphore(&self, name: &str, permits: u32) -> Result<Semaphore, SemaphoreError> {
        Named::find(self, Kind::Semaphore, name, permits).map(Semaphore)
    }

    /// The barrier called `name`, for `parties` unless `[barrier.NAME]` of the configuration says for how many.
    /// Shared as [`Self::semaphore`] says.
    ///
    /// # Errors
    /// [`SemaphoreError`]: nobody to wait for, or another number than others use.
    pub fn barrier(&self, name: &str, parties: u32) -> Result<Barrier, SemaphoreError> {
        let named = Named::find(self, Kind::Barrier, name, parties)?;
        let deadline = self.inner.call_deadline();
        Ok(Barrier { named, deadline })
    }
}
