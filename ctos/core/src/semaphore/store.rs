//! The semaphores and barriers that a chassis keeps, and the tickets that give back what a task has of them.

use std::{
    collections::BTreeMap,
    sync::{
        Arc, Mutex,
        atomic::{AtomicBool, AtomicU64, Ordering},
    },
};

use tokio::sync::oneshot;

use super::{
    Late, Passage, Scope, SemaphoreView,
    gathering::Gathering,
    ledger::{Claim, Hold, Ledger},
    server::{ReleaseTicket, Shared},
};
use crate::{
    chassis::{Chassis, Extension},
    context::Context,
    system,
};
use ctos_message::Tid;
use ctos_time::{Clock, Instant, lock::lock};

/// All that a chassis keeps.
#[derive(Debug)]
pub(crate) struct Store {
    semaphores: Mutex<BTreeMap<String, Arc<LocalSemaphore>>>,
    barriers: Mutex<BTreeMap<String, Arc<LocalBarrier>>>,
    next: AtomicU64,
    /// What tasks of this chassis have, or want, of what the server keeps.
    elsewhere: Mutex<BTreeMap<Hold, Tid>>,
    /// What the server keeps, on the chassis that boots.
    pub(super) shared: Mutex<Shared>,
    clock: Clock,
}

impl Store {
    pub(super) fn next_hold(&self, chassis: u8) -> Hold {
        let number = self.next.fetch_add(1, Ordering::Relaxed);
        Hold { chassis, number }
    }

    /// The semaphore called `name`, made with `permits` if it is new.
    pub(super) fn semaphore(&self, name: &str, permits: u32) -> Arc<LocalSemaphore> {
        let mut semaphores = lock(&self.semaphores);
        if let Some(known) = semaphores.get(name) {
            return known.clone();
        }
        let new = Arc::new(LocalSemaphore {
            ledger: Mutex::new(Ledger::new(permits)),
            clock: self.clock.clone(),
        });
        semaphores.insert(name.to_owned(), new.clone());
        new
    }

    /// The barrier called `name`, made for `parties` if it is new.
    pub(super) fn barrier(&self, name: &str, parties: u32) -> Arc<LocalBarrier> {
        let mut barriers = lock(&self.barriers);
        if let Some(known) = barriers.get(name) {
            return known.clone();
        }
        let new = Arc::new(LocalBarrier(Mutex::new(Gathering::new(parties))));
        barriers.insert(name.to_owned(), new.clone());
        new
    }

    /// What is kept here: the chassis's own, and, on the chassis that boots, the app's.
    pub(crate) fn views(&self) -> Vec<SemaphoreView> {
        let own: Vec<_> = lock(&self.semaphores)
            .iter()
            .map(|(name, semaphore)| view(name, Scope::Chassis, &lock(&semaphore.ledger)))
            .collect();
        let mut views = lock(&self.shared).views();
        views.extend(own);
        views
    }
}

impl Extension for Store {
    fn new(chassis: &Chassis) -> Self {
        Self {
            semaphores: Mutex::default(),
            barriers: Mutex::default(),
            next: AtomicU64::new(0),
            elsewhere: Mutex::default(),
            shared: Mutex::default(),
            clock: chassis.clock.clone(),
        }
    }

    // Whatever the task had, or waited for, is given back, also what it left to others.
    fn task_ended(&self, chassis: &Arc<Chassis>, tid: Tid) {
        let semaphores: Vec<_> = lock(&self.semaphores).values().cloned().collect();
        for semaphore in semaphores {
            semaphore.end(|claim| claim.tid == tid);
        }
        let barriers: Vec<_> = lock(&self.barriers).values().cloned().collect();
        for barrier in barriers {
            barrier.leave(|claim| claim.tid == tid);
        }
        let holds: Vec<Hold> = {
            let mut elsewhere = lock(&self.elsewhere);
            let mut holds = Vec::new();
            elsewhere.retain(|hold, owner| {
                if *owner == tid {
                    holds.push(*hold);
                }
                *owner != tid
            });
            holds
        };
        for hold in holds {
            release_elsewhere(chassis, hold);
        }
    }

    fn closed(&self) {
        let semaphores = std::mem::take(&mut *lock(&self.semaphores));
        let barriers = std::mem::take(&mut *lock(&self.barriers));
        let shared = std::mem::take(&mut *lock(&self.shared));
        for semaphore in semaphores.into_values() {
            let waiting = lock(&semaphore.ledger).close();
            drop(waiting);
        }
        for barrier in barriers.into_values() {
            let waiting = lock(&barrier.0).close();
            drop(waiting);
        }
        drop(shared);
    }
}

impl Chassis {
    /// Its semaphores and barriers.
    pub(super) fn blocking(&self) -> Arc<Store> {
        self.extension()
    }

    /// The semaphores that are kept here, who holds them and who waits: those of the chassis and, on the
    /// one that boots, those of the app.
    #[must_use]
    pub fn semaphores(&self) -> Vec<SemaphoreView> {
        self.blocking().views()
    }
}

/// A semaphore as it is now.
pub(super) fn view<W>(name: &str, scope: Scope, ledger: &Ledger<W>) -> SemaphoreView {
    SemaphoreView {
        name: name.to_owned(),
        scope,
        permits: ledger.permits(),
        holders: ledger.holders(),
        waiting: ledger.waiting(),
    }
}

fn release_elsewhere(chassis: &Arc<Chassis>, hold: Hold) {
    let release = ReleaseTicket { hold: hold.number };
    chassis.post_system(system::SEMAPHORE_SERVER, release);
}

/// A semaphore of chassis scope.
#[derive(Debug)]
pub(super) struct LocalSemaphore {
    ledger: Mutex<Ledger<oneshot::Sender<()>>>,
    clock: Clock,
}

impl LocalSemaphore {
    pub(super) fn permits(&self) -> u32 {
        lock(&self.ledger).permits()
    }

    pub(super) fn try_acquire(&self, claim: &Claim, now: Instant) -> bool {
        lock(&self.ledger).try_acquire(claim, now)
    }

    pub(super) fn wait(&self, claim: Claim, high: bool, waiter: oneshot::Sender<()>, now: Instant) {
        // It may have become free since it was tried.
        let granted = lock(&self.ledger).acquire(claim, high, waiter, now);
        if let Some(waiter) = granted {
            let _ = waiter.send(());
        }
    }

    pub(super) fn late(&self, hold: Hold, now: Instant) -> Late {
        lock(&self.ledger).late(hold, now)
    }

    fn end(&self, gone: impl Fn(&Claim) -> bool) {
        let (granted, withdrawn) = lock(&self.ledger).end(gone, self.clock.now());
        for (_, waiter) in granted {
            // Whoever waits no longer gives it back with its ticket.
            let _ = waiter.send(());
        }
        drop(withdrawn);
    }
}

/// A barrier of chassis scope.
#[derive(Debug)]
pub(super) struct LocalBarrier(Mutex<Gathering<oneshot::Sender<Passage>>>);

impl LocalBarrier {
    pub(super) fn parties(&self) -> u32 {
        lock(&self.0).parties()
    }

    pub(super) fn arrived(&self) -> Vec<String> {
        lock(&self.0).arrived()
    }

    pub fn arrive(&self, claim: Claim, waiter: oneshot::Sender<Passage>) {
        let passing = lock(&self.0).arrive(claim, waiter);
        for (_, waiter, passage) in passing {
            // Who gave up at this moment has passed all the same.
            let _ = waiter.send(passage);
        }
    }

    fn leave(&self, gone: impl Fn(&Claim) -> bool) {
        let left = lock(&self.0).leave(gone);
        drop(left);
    }
}

#[derive(Debug)]
enum Place {
    Semaphore(Arc<LocalSemaphore>),
    Barrier(Arc<LocalBarrier>),
    Server(Arc<Chassis>),
}

/// Stands for one hold, from before it is asked for. Dropped, it ends the wait or gives the permit back, whichever
/// of the two it has come to.
#[derive(Debug)]
pub(super) struct Ticket {
    place: Place,
    hold: Hold,
    settled: AtomicBool,
}

impl Ticket {
    fn new(place: Place, hold: Hold) -> Self {
        Self {
            place,
            hold,
            settled: AtomicBool::new(false),
        }
    }

    pub(super) fn at_semaphore(semaphore: &Arc<LocalSemaphore>, hold: Hold) -> Self {
        Self::new(Place::Semaphore(semaphore.clone()), hold)
    }

    pub(super) fn at_barrier(barrier: &Arc<LocalBarrier>, hold: Hold) -> Self {
        Self::new(Place::Barrier(barrier.clone()), hold)
    }

    pub(super) fn at_server(cx: &Context) -> Self {
        let chassis = cx.chassis();
        let hold = chassis.blocking().next_hold(chassis.index());
        lock(&chassis.blocking().elsewhere).insert(hold, cx.tid());
        Self::new(Place::Server(chassis.clone()), hold)
    }

    pub(super) fn hold(&self) -> Hold {
        self.hold
    }

    /// There is nothing to give back any more.
    pub(super) fn settle(&self) {
        self.settled.store(true, Ordering::Relaxed);
    }
}

impl Drop for Ticket {
    fn drop(&mut self) {
        let settled = self.settled.load(Ordering::Relaxed);
        match &self.place {
            Place::Semaphore(semaphore) if !settled => {
                semaphore.end(|claim| claim.hold == self.hold);
            }
            Place::Barrier(barrier) if !settled => barrier.leave(|claim| claim.hold == self.hold),
            Place::Semaphore(_) | Place::Barrier(_) => {}
            Place::Server(chassis) => {
                let there = lock(&chassis.blocking().elsewhere)
                    .remove(&self.hold)
                    .is_some();
                if there && !settled {
                    release_elsewhere(chassis, self.hold);
                }
            }
        }
    }
}
