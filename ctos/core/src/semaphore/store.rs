//! The semaphores and barriers that a chassis keeps, and the tickets of those who use them. Those of the app are kept in
//! the same way, on the chassis that boots.

use std::{
    collections::BTreeMap,
    sync::{
        Arc, Mutex,
        atomic::{AtomicU64, Ordering},
    },
    time::Duration,
};

use serde::{Deserialize, Serialize};
use tokio::sync::oneshot;

use super::{
    Passage, Scope, SemaphoreView,
    ledger::{Claim, Hold, Kind, Late, Ledger},
    server::{HasPermit, ReleaseTicket},
};
use crate::{
    chassis::{Chassis, Extension},
    context::Context,
    system,
};
use ctos_message::{Tid, fault::CallError};
use ctos_time::{Clock, Instant, lock::lock};

/// What came of a wait.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub enum Answer {
    /// The task has a permit, or has passed.
    Served(Passage),
    /// Its time was over before.
    Late(Late),
    /// There is one for another number.
    Disagree { has: u32 },
}

/// All that a chassis keeps.
#[derive(Debug)]
pub(crate) struct Store {
    kept: Mutex<BTreeMap<(Kind, Scope, String), Arc<Kept>>>,
    next: AtomicU64,
    /// What tasks of this chassis have, or want, of what the server keeps.
    elsewhere: Mutex<BTreeMap<Hold, Tid>>,
    clock: Clock,
}

impl Store {
    /// The semaphore or barrier called `name`, made with `count` permits or parties if it is new.
    pub(super) fn find(&self, kind: Kind, scope: Scope, name: &str, count: u32) -> Arc<Kept> {
        let mut kept = lock(&self.kept);
        let there = kept.entry((kind, scope, name.to_owned()));
        let new = || {
            Arc::new(Kept {
                ledger: Mutex::new(Ledger::new(kind, count)),
                clock: self.clock.clone(),
            })
        };
        there.or_insert_with(new).clone()
    }

    /// Whether somebody has a permit, of whatever is kept here.
    pub(super) fn has(&self, hold: Hold) -> bool {
        let kept = lock(&self.kept);
        kept.values().any(|kept| lock(&kept.ledger).has(hold))
    }

    /// Ends every wait and hold that `gone` names.
    pub(super) fn end(&self, gone: impl Fn(&Claim) -> bool) {
        let all: Vec<_> = lock(&self.kept).values().cloned().collect();
        for kept in all {
            kept.end(&gone);
        }
    }

    /// The semaphores that are kept here: the chassis's own, and, on the chassis that boots, the app's.
    pub(super) fn views(&self) -> Vec<SemaphoreView> {
        let kept = lock(&self.kept);
        let semaphores = kept
            .iter()
            .filter(|((kind, ..), _)| *kind == Kind::Semaphore);
        semaphores
            .map(|((_, scope, name), kept)| {
                let ledger = lock(&kept.ledger);
                SemaphoreView {
                    name: name.clone(),
                    scope: *scope,
                    permits: ledger.count(),
                    holders: ledger.holders(),
                    waiting: ledger.waiting(),
                }
            })
            .collect()
    }
}

impl Extension for Store {
    fn new(chassis: &Chassis) -> Self {
        Self {
            kept: Mutex::default(),
            next: AtomicU64::new(0),
            elsewhere: Mutex::default(),
            clock: chassis.clock.clone(),
        }
    }

    // Whatever the task had, or waited for, is given back, also what it left to others.
    fn task_ended(&self, chassis: &Arc<Chassis>, tid: Tid) {
        self.end(|claim| claim.tid == tid);
        let of_task = |_: &Hold, owner: &mut Tid| *owner == tid;
        let holds: Vec<Hold> = lock(&self.elsewhere)
            .extract_if(.., of_task)
            .map(|(hold, _)| hold)
            .collect();
        for hold in holds {
            release_elsewhere(chassis, hold);
        }
    }

    fn closed(&self) {
        for kept in std::mem::take(&mut *lock(&self.kept)).into_values() {
            lock(&kept.ledger).close();
        }
    }
}

impl Chassis {
    /// Its semaphores and barriers.
    pub(super) fn blocking(&self) -> Arc<Store> {
        self.extension()
    }

    /// The semaphores that are kept here, who holds them and who waits. They are those of the chassis
    /// and, on the one that boots, those of the app.
    #[must_use]
    pub fn semaphores(&self) -> Vec<SemaphoreView> {
        self.blocking().views()
    }
}

fn release_elsewhere(chassis: &Arc<Chassis>, hold: Hold) {
    let release = ReleaseTicket { hold: hold.number };
    chassis.post_system(system::SEMAPHORE_SERVER, release);
}

/// A semaphore or barrier.
#[derive(Debug)]
pub(super) struct Kept {
    ledger: Mutex<Ledger>,
    clock: Clock,
}

impl Kept {
    /// Permits or parties.
    pub(super) fn count(&self) -> u32 {
        lock(&self.ledger).count()
    }

    /// [`Ledger::enter`], now.
    pub(super) fn enter(&self, claim: Claim, high: bool) -> oneshot::Receiver<Passage> {
        lock(&self.ledger).enter(claim, high, self.now())
    }

    /// Waits to be served; `None` when the wait was ended by others.
    pub(super) async fn wait(
        &self,
        cx: &Context,
        hold: Hold,
        served: oneshot::Receiver<Passage>,
        patience: Duration,
    ) -> Option<Answer> {
        match cx.timeout(patience, served).await {
            Ok(passage) => passage.ok().map(Answer::Served),
            Err(_) => Some(Answer::Late(lock(&self.ledger).late(hold, self.now()))),
        }
    }

    /// [`Ledger::end`], now.
    pub(super) fn end(&self, gone: impl Fn(&Claim) -> bool) {
        lock(&self.ledger).end(gone, self.now());
    }

    fn now(&self) -> Instant {
        self.clock.now()
    }
}

/// Stands for one hold, from before it is asked for. Dropped, it ends the wait or gives the permit back, whichever
/// of the two it has come to.
#[derive(Debug)]
pub(super) struct Ticket {
    chassis: Arc<Chassis>,
    /// What it is for; `None` when the server keeps that.
    kept: Option<Arc<Kept>>,
    pub(super) hold: Hold,
}

impl Ticket {
    pub(super) fn new(cx: &Context, kept: Option<Arc<Kept>>) -> Self {
        let chassis = cx.chassis().clone();
        let store = chassis.blocking();
        let hold = Hold {
            chassis: chassis.index(),
            number: store.next.fetch_add(1, Ordering::Relaxed),
        };
        if kept.is_none() {
            lock(&store.elsewhere).insert(hold, cx.tid());
        }
        Self {
            chassis,
            kept,
            hold,
        }
    }

    /// Whether it still stands for a permit, as the keeper of the semaphore says.
    pub(super) async fn is_good(&self, cx: &Context) -> Result<bool, CallError> {
        if self.kept.is_some() {
            return Ok(self.chassis.blocking().has(self.hold));
        }
        let hold = self.hold.number;
        cx.call(&super::server(), HasPermit { hold }).await
    }

    /// The server has nothing to be given back. Whether it had.
    pub(super) fn settle(&self) -> bool {
        let store = self.chassis.blocking();
        let there = lock(&store.elsewhere).remove(&self.hold);
        there.is_some()
    }
}

impl Drop for Ticket {
    fn drop(&mut self) {
        match &self.kept {
            Some(kept) => kept.end(|claim| claim.hold == self.hold),
            None if self.settle() => release_elsewhere(&self.chassis, self.hold),
            None => {}
        }
    }
}
