//! The inter-processor blocking service: named counting semaphores and barriers (CIRSSE report 108,
//! section 3).
//!
//! One of *chassis* scope is shared by the processors of a chassis and costs no message. One of *app* scope is
//! shared by all chassis of the app; a task of the runtime, on the chassis that boots, keeps it. Both
//! serve those who wait first come, first served, high priority before normal, and hand a released permit
//! straight on, so nobody can slip in between. A [`Permit`] is released when it is dropped, when the task that
//! holds it ends or is built anew after a panic, and when its chassis dies. Waiting ends with the permit or an
//! error that names the holders, always.
//!
//! A synchronous function must not use them: they take a lock, and their waiters are woken.

mod error;
mod gathering;
mod ledger;
#[doc(hidden)]
pub mod server;
mod store;

use std::{future::IntoFuture, sync::Arc, time::Duration};

use futures_util::future::LocalBoxFuture;
use serde::{Deserialize, Serialize};
use tokio::sync::oneshot;

use crate::{
    context::{Context, DEFAULT_DEADLINE, TaskRef},
    system,
};
pub use ctos_config::Scope;
use ctos_message::{Tid, fault::CallError};
use ctos_time::Instant;
pub use error::SemaphoreError;
use ledger::{Claim, Hold};
use server::{AcquireSemaphore, Acquired, ArriveBarrier, Arrived};
use store::{LocalBarrier, LocalSemaphore, Ticket};

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

/// Where a semaphore or barrier is kept.
#[derive(Debug, Clone)]
enum Kept<L> {
    Here(L),
    ByServer { count: u32 },
}

/// A counting semaphore, found by name with [`Context::semaphore`].
#[derive(Debug, Clone)]
pub struct Semaphore {
    cx: Context,
    name: Arc<str>,
    kept: Kept<Arc<LocalSemaphore>>,
}

impl Semaphore {
    /// The semaphore called `name`; with `permits`, unless the configuration says how many.
    pub(crate) fn find(cx: &Context, name: &str, permits: u32) -> Result<Self, SemaphoreError> {
        let declared = cx.app().semaphores.iter().find(|one| one.name == name);
        let permits = declared.and_then(|one| one.count).unwrap_or(permits);
        let scope = declared.and_then(|one| one.scope);
        if permits == 0 {
            return Err(nobody(cx, name));
        }
        let kept = match scope.unwrap_or_else(|| scope_of(name)) {
            Scope::App => Kept::ByServer { count: permits },
            Scope::Chassis => {
                let local = cx.chassis().blocking().semaphore(name, permits);
                agree(cx, name, local.permits(), permits)?;
                Kept::Here(local)
            }
        };
        Ok(Self {
            cx: cx.clone(),
            name: name.into(),
            kept,
        })
    }

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
        &self.name
    }

    /// Waits for a permit: `.await` it. 10 s, or the task's `call_deadline_s`, at the most, unless
    /// [`Acquire::deadline`] says otherwise.
    pub fn acquire(&self) -> Acquire {
        Acquire {
            semaphore: self.clone(),
            deadline: patience(&self.cx),
            high: false,
        }
    }
}

/// How long a task waits unless it says otherwise.
fn patience(cx: &Context) -> Duration {
    let configured = cx.config().and_then(|config| config.call_deadline);
    configured.unwrap_or(DEFAULT_DEADLINE)
}

fn scope_of(name: &str) -> Scope {
    if name.starts_with(APP_PREFIX) {
        Scope::App
    } else {
        Scope::Chassis
    }
}

fn nobody(cx: &Context, name: &str) -> SemaphoreError {
    SemaphoreError::Nobody {
        name: name.to_owned(),
        task: cx.name().to_owned(),
    }
}

fn agree(cx: &Context, name: &str, has: u32, asked: u32) -> Result<(), SemaphoreError> {
    if has == asked {
        return Ok(());
    }
    Err(SemaphoreError::Disagree {
        name: name.to_owned(),
        task: cx.name().to_owned(),
        has,
        asked,
    })
}

fn server() -> TaskRef {
    TaskRef::new("semsvr", system::SEMAPHORE_SERVER)
}

/// A permit that has not been waited for yet; `.await` waits.
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

    async fn run(self) -> Result<Permit, SemaphoreError> {
        match &self.semaphore.kept {
            Kept::Here(local) => self.run_here(local).await,
            Kept::ByServer { count } => self.run_by_server(*count).await,
        }
    }

    fn claim(&self, hold: Hold) -> Claim {
        Claim {
            hold,
            task: self.semaphore.cx.name_shared(),
            tid: self.semaphore.cx.tid(),
        }
    }

    async fn run_here(&self, local: &Arc<LocalSemaphore>) -> Result<Permit, SemaphoreError> {
        let cx = &self.semaphore.cx;
        let store = cx.chassis().blocking();
        let claim = self.claim(store.next_hold(cx.chassis().index()));
        // From here on, whatever happens, the ticket gives back what it stands for.
        let permit = Permit {
            ticket: Ticket::at_semaphore(local, claim.hold),
        };
        if local.try_acquire(&claim, cx.now()) {
            return Ok(permit);
        }
        if self.deadline.is_zero() {
            return Err(self.late(local.late(claim.hold, cx.now())));
        }
        let (sender, granted) = oneshot::channel();
        local.wait(claim.clone(), self.high, sender, cx.now());
        match cx.timeout(self.deadline, granted).await {
            Ok(Ok(())) => Ok(permit),
            Ok(Err(_)) => Err(SemaphoreError::Ending {
                name: self.semaphore.name.to_string(),
                task: cx.name().to_owned(),
            }),
            Err(_) => Err(self.late(local.late(claim.hold, cx.now()))),
        }
    }

    async fn run_by_server(&self, permits: u32) -> Result<Permit, SemaphoreError> {
        let cx = &self.semaphore.cx;
        let permit = Permit {
            ticket: Ticket::at_server(cx),
        };
        let request = AcquireSemaphore {
            name: self.semaphore.name.to_string(),
            permits,
            hold: permit.ticket.hold().number,
            task: cx.name().to_owned(),
            wait: self.deadline,
            high: self.high,
        };
        let patience = self.deadline.saturating_add(GRACE);
        let acquired = cx.call(&server(), request).deadline(patience).await?;
        match acquired {
            Acquired::Granted => Ok(permit),
            Acquired::Late(late) => {
                permit.ticket.settle();
                Err(self.late(late))
            }
            Acquired::Disagree { has } => {
                permit.ticket.settle();
                agree(cx, &self.semaphore.name, has, permits)?;
                Err(nobody(cx, &self.semaphore.name))
            }
        }
    }

    fn late(&self, late: Late) -> SemaphoreError {
        SemaphoreError::Deadline {
            name: self.semaphore.name.to_string(),
            task: self.semaphore.cx.name().to_owned(),
            after: self.deadline,
            holders: late.holders,
            before: late.before,
        }
    }
}

impl IntoFuture for Acquire {
    type Output = Result<Permit, SemaphoreError>;
    type IntoFuture = LocalBoxFuture<'static, Self::Output>;

    fn into_future(self) -> Self::IntoFuture {
        Box::pin(self.run())
    }
}

/// Why a permit could not be had in time: who holds one, for how long, and how many wait before.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Late {
    pub(crate) holders: Vec<(String, Duration)>,
    pub(crate) before: usize,
}

/// One of a semaphore's permits. Dropped, it goes to whoever waits first.
#[must_use = "a permit that is dropped is given back at once"]
#[derive(Debug)]
pub struct Permit {
    ticket: Ticket,
}

impl Permit {
    /// Gives it back.
    pub fn release(self) {
        drop(self);
    }
}

/// A barrier, found by name with [`Context::barrier`].
#[derive(Debug, Clone)]
pub struct Barrier {
    cx: Context,
    name: Arc<str>,
    kept: Kept<Arc<LocalBarrier>>,
    deadline: Duration,
}

/// What became of a wait at a barrier.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Passage {
    /// Counts how often everybody has passed, from 1 on.
    pub generation: u64,
    /// Whether the task was the last to arrive: one of each generation is.
    pub last: bool,
}

impl Barrier {
    /// The barrier called `name`; for `parties`, unless the configuration says for how many.
    pub(crate) fn find(cx: &Context, name: &str, parties: u32) -> Result<Self, SemaphoreError> {
        let declared = cx.app().barriers.iter().find(|one| one.name == name);
        let parties = declared.and_then(|one| one.count).unwrap_or(parties);
        let scope = declared.and_then(|one| one.scope);
        if parties == 0 {
            return Err(nobody(cx, name));
        }
        let kept = match scope.unwrap_or_else(|| scope_of(name)) {
            Scope::App => Kept::ByServer { count: parties },
            Scope::Chassis => {
                let local = cx.chassis().blocking().barrier(name, parties);
                agree(cx, name, local.parties(), parties)?;
                Kept::Here(local)
            }
        };
        Ok(Self {
            cx: cx.clone(),
            name: name.into(),
            kept,
            deadline: patience(cx),
        })
    }

    /// Waits at most this long.
    #[must_use]
    pub fn deadline(mut self, deadline: Duration) -> Self {
        self.deadline = deadline;
        self
    }

    /// Waits until everybody has arrived. Who gives up, or dies, before that has not arrived.
    ///
    /// # Errors
    /// [`SemaphoreError::Missing`] names those who have arrived.
    pub async fn wait(&self) -> Result<Passage, SemaphoreError> {
        match &self.kept {
            Kept::Here(local) => self.wait_here(local).await,
            Kept::ByServer { count } => self.wait_at_server(*count).await,
        }
    }

    fn missing(&self, arrived: Vec<String>, parties: u32) -> SemaphoreError {
        SemaphoreError::Missing {
            name: self.name.to_string(),
            task: self.cx.name().to_owned(),
            after: self.deadline,
            arrived,
            parties,
        }
    }

    async fn wait_here(&self, local: &Arc<LocalBarrier>) -> Result<Passage, SemaphoreError> {
        let cx = &self.cx;
        let claim = Claim {
            hold: cx.chassis().blocking().next_hold(cx.chassis().index()),
            task: cx.name_shared(),
            tid: cx.tid(),
        };
        let _ticket = Ticket::at_barrier(local, claim.hold);
        let (sender, passed) = oneshot::channel();
        local.arrive(claim, sender);
        match cx.timeout(self.deadline, passed).await {
            Ok(Ok(passage)) => Ok(passage),
            Ok(Err(_)) => Err(SemaphoreError::Ending {
                name: self.name.to_string(),
                task: cx.name().to_owned(),
            }),
            Err(_) => Err(self.missing(local.arrived(), local.parties())),
        }
    }

    async fn wait_at_server(&self, parties: u32) -> Result<Passage, SemaphoreError> {
        let cx = &self.cx;
        let ticket = Ticket::at_server(cx);
        let request = ArriveBarrier {
            name: self.name.to_string(),
            parties,
            hold: ticket.hold().number,
            task: cx.name().to_owned(),
            wait: self.deadline,
        };
        let patience = self.deadline.saturating_add(GRACE);
        let arrived = cx.call(&server(), request).deadline(patience).await?;
        ticket.settle();
        match arrived {
            Arrived::Passed(passage) => Ok(passage),
            Arrived::Late(arrived) => Err(self.missing(arrived, parties)),
            Arrived::Disagree { has } => {
                agree(cx, &self.name, has, parties)?;
                Err(nobody(cx, &self.name))
            }
        }
    }

    /// Its name.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.name
    }
}

/// The app-wide semaphores, asked from any chassis.
pub(crate) async fn of_app(cx: &Context) -> Result<Vec<SemaphoreView>, CallError> {
    cx.call(&server(), server::ListSemaphores {}).await
}
impl Context {
    /// The semaphores that this task could use, who holds them and who waits: those of this chassis and
    /// those of the app.
    ///
    /// # Errors
    /// When the task that keeps those of the app cannot be asked.
    pub async fn semaphores(&self) -> Result<Vec<SemaphoreView>, CallError> {
        let mut views = of_app(self).await?;
        let here = self.chassis().semaphores().into_iter();
        views.extend(here.filter(|view| view.scope == Scope::Chassis));
        Ok(views)
    }

    /// The counting semaphore called `name`, with `permits` unless `[semaphore.NAME]` of the configuration
    /// says how many. It is shared by the tasks of this chassis; by those of the whole app, if the
    /// configuration says so or its name begins with `app/`.
    ///
    /// # Errors
    /// [`SemaphoreError`]: no permits at all, or another number than others use.
    pub fn semaphore(&self, name: &str, permits: u32) -> Result<Semaphore, SemaphoreError> {
        Semaphore::find(self, name, permits)
    }

    /// The barrier called `name`, for `parties` unless `[barrier.NAME]` of the configuration says for how many.
    /// Shared as [`Self::semaphore`] says.
    ///
    /// # Errors
    /// [`SemaphoreError`]: nobody to wait for, or another number than others use.
    pub fn barrier(&self, name: &str, parties: u32) -> Result<Barrier, SemaphoreError> {
        Barrier::find(self, name, parties)
    }
}
