//! The reactor of a chassis: a processor with nothing else to do reads what comes over the links.
//!
//! A processor that runs out of work does not just sleep, it waits at the links, and handles what it
//! reads there itself. So a message from another process costs one wake-up and no second thread. Only
//! one thread at a time waits there, the leader. While all processors are busy, a thread that has
//! nothing else to do, the standby, leads, `TICK` to two of them late.
//!
//! Here is which thread leads, and how long it spins and sleeps; the links themselves are in `sources.rs`.

mod sources;

use std::{
    io,
    sync::{
        Arc, Mutex, MutexGuard, OnceLock, TryLockError,
        atomic::{AtomicBool, AtomicU64, Ordering, fence},
    },
    thread::Thread,
    time::Duration,
};

pub use self::sources::{Happened, Seen, Source, Visible};
use self::sources::{LOOKS_PER_POLL, Poller, Sources};
use crate::{
    lock::lock,
    park::{Glance, Park, ThreadParker},
    time::{Clock, Instant},
};

/// How often the standby looks whether anybody leads, while there is traffic.
const TICK: Duration = Duration::from_millis(1);

/// Looks at the shared memory between two looks at the clock.
const LOOKS_PER_CLOCK: u32 = 16;

/// How a wait at the links ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Waited {
    /// There is something to do, or the time is over.
    Awake,
    /// What came was for others, one of whom shall lead next.
    HandedOn,
    /// Somebody else leads.
    Elsewhere,
}

/// Under which key a chassis shares its reactor: handlers that read what no link is add sources of their own.
pub const SHARED: &str = "ctos.reactor";

/// The links of one chassis, and who waits for them.
pub struct Reactor {
    clock: Clock,
    /// How long to look at shared memory before sleeping; zero where that would keep others from their core.
    spin: Duration,
    sources: Sources,
    /// The leader polls.
    leader: Mutex<Poller>,
    /// Somebody leads.
    is_led: AtomicBool,
    /// How often somebody began to lead.
    leads: AtomicU64,
    standby: Standby,
}

/// The thread that leads while nobody else does.
#[derive(Default)]
struct Standby {
    thread: OnceLock<Thread>,
    parker: Nudges,
    /// It wants to be woken when nobody leads any more.
    asleep: AtomicBool,
    /// It leads.
    leads: AtomicBool,
    /// A processor wants to lead, and which.
    wanted: AtomicBool,
    wanted_by: Mutex<Option<Thread>>,
    stop: AtomicBool,
}

/// Wake-ups of a thread that may sleep as the leader.
#[derive(Default)]
struct Nudges {
    thread: ThreadParker,
    /// It sleeps as the leader, where only the waker wakes it.
    at_links: AtomicBool,
}

impl Nudges {
    /// Wakes the thread if it sleeps as the leader; whether it does not.
    fn wake_leader(&self, reactor: &Reactor) -> bool {
        self.thread.nudge();
        if !self.at_links.load(Ordering::SeqCst) {
            return false;
        }
        if self.at_links.swap(false, Ordering::SeqCst) {
            reactor.sources.wake();
        }
        true
    }

    /// What becomes of the lead: when all that came was for others, one of them shall have it.
    fn after(&self, seen: Seen) -> Waited {
        if seen == Seen::Frames && !self.thread.is_nudged() {
            Waited::HandedOn
        } else {
            Waited::Awake
        }
    }
}

/// Where the thread of a processor sleeps that leads when it can.
pub struct LinkParker {
    nudges: Nudges,
    /// What came last was for others: they shall lead next. For the thread alone.
    aside: AtomicBool,
    reactor: Arc<Reactor>,
}

impl LinkParker {
    /// A place at these links.
    pub fn new(reactor: Arc<Reactor>) -> Self {
        Self {
            nudges: Nudges::default(),
            aside: AtomicBool::new(false),
            reactor,
        }
    }
}

impl Park for LinkParker {
    fn sit_down(&self) {
        self.nudges.thread.sit_down();
    }

    fn unpark(&self) {
        if !self.nudges.wake_leader(&self.reactor) {
            self.nudges.thread.shake();
        }
    }

    fn park(&self, now: Instant, deadline: Option<Instant>) {
        if self.nudges.thread.take_nudge() {
            return;
        }
        if !self.aside.swap(false, Ordering::Relaxed) {
            let waited = self.reactor.wait(&self.nudges, deadline);
            let aside = waited == Waited::HandedOn;
            self.aside.store(aside, Ordering::Relaxed);
            if waited != Waited::Elsewhere {
                self.nudges.thread.take_nudge();
                return;
            }
        }
        self.nudges.thread.park(now, deadline);
    }

    fn glance(&self, glance: Glance) -> bool {
        self.reactor.glance(glance) == Seen::Frames
    }

    fn had_work(&self) {
        self.aside.store(false, Ordering::Relaxed);
    }
}

impl Reactor {
    /// A reactor without links. `spin` is how long it looks at shared memory before it sleeps.
    ///
    /// # Errors
    /// What the system says.
    pub fn new(name: &str, clock: Clock, spin: Duration) -> io::Result<Arc<Self>> {
        let (sources, poller) = Sources::new(clock.clone())?;
        let reactor = Arc::new(Self {
            clock,
            spin,
            sources,
            leader: Mutex::new(poller),
            is_led: AtomicBool::new(false),
            leads: AtomicU64::new(0),
            standby: Standby::default(),
        });
        let home = reactor.clone();
        std::thread::Builder::new()
            .name(format!("{name} links"))
            .spawn(move || home.stand_by())?;
        Ok(reactor)
    }

    /// Looks at a source from now on, until what is returned is dropped.
    ///
    /// # Errors
    /// What the system says.
    pub fn add(self: &Arc<Self>, source: Arc<dyn Source>) -> io::Result<Watched> {
        let id = self.sources.add(source.clone())?;
        Ok(Watched {
            reactor: self.clone(),
            source,
            id,
        })
    }

    /// Ends the standby; nobody looks at the links any more.
    pub fn close(&self) {
        self.standby.stop.store(true, Ordering::SeqCst);
        self.standby.parker.wake_leader(self);
        if let Some(thread) = self.standby.thread.get() {
            thread.unpark();
        }
    }

    /// Waits at the links for `nudges` until there is one or `deadline` is there, and hands on what comes.
    fn wait(&self, nudges: &Nudges, deadline: Option<Instant>) -> Waited {
        let Some(mut leader) = self.lead() else {
            return Waited::Elsewhere;
        };
        // Seen late, it leads the standby to try for a lead that it does not get.
        self.is_led.store(true, Ordering::Release);
        let waited = self.look(&mut leader, nudges, deadline);
        drop(leader);
        self.is_led.store(false, Ordering::SeqCst);
        // Mostly it is not, and a look costs less than a change.
        if self.standby.asleep.load(Ordering::SeqCst)
            && self.standby.asleep.swap(false, Ordering::SeqCst)
            && let Some(thread) = self.standby.thread.get()
        {
            thread.unpark();
        }
        waited
    }

    /// Takes the lead, if nobody has it. The standby is told that it is wanted.
    fn lead(&self) -> Option<MutexGuard<'_, Poller>> {
        let leader = match self.leader.try_lock() {
            Ok(leader) => leader,
            Err(TryLockError::Poisoned(leader)) => leader.into_inner(),
            Err(TryLockError::WouldBlock) => {
                if self.standby.leads.load(Ordering::SeqCst) {
                    // The thread does not wait here, where nobody could wake it: the standby wakes it when
                    // it may try again.
                    *lock(&self.standby.wanted_by) = Some(std::thread::current());
                    self.standby.wanted.store(true, Ordering::SeqCst);
                    self.standby.parker.wake_leader(self);
                }
                return None;
            }
        };
        // Nobody else counts: there is one leader.
        let leads = self.leads.load(Ordering::Relaxed);
        self.leads.store(leads.wrapping_add(1), Ordering::Relaxed);
        Some(leader)
    }

    /// Wakes the processor that wanted to lead.
    fn hand_over(&self) {
        self.standby.wanted.store(false, Ordering::SeqCst);
        let wanted_by = lock(&self.standby.wanted_by).take();
        if let Some(thread) = wanted_by {
            thread.unpark();
        }
    }

    /// Looks once, without sleeping, and hands on what has come.
    fn glance(&self, glance: Glance) -> Seen {
        let come = self.sources.has_come();
        if !come && glance == Glance::AtMemory {
            return Seen::Nothing;
        }
        // The leader sees it, too.
        let Some(mut poller) = self.lead() else {
            return Seen::Nothing;
        };
        self.sources.refresh(&mut poller);
        let mut seen = Seen::Nothing;
        if come {
            poller.looked += 1;
            seen = self.sources.serve_visible(&poller);
        }
        let due = glance == Glance::Everywhere || poller.looked >= LOOKS_PER_POLL;
        if due && poller.has_sockets {
            poller.looked = 0;
            // Should it fail, the next sleeper there reports it.
            if let Ok(()) = self.sources.poll(&mut poller, true, None) {
                seen = self.sources.serve_events(&mut poller, seen);
            }
        }
        seen
    }

    fn look(&self, poller: &mut Poller, nudges: &Nudges, deadline: Option<Instant>) -> Waited {
        if !self.spin.is_zero() && poller.looked < LOOKS_PER_POLL {
            let until = self.clock.now() + self.spin;
            let until = deadline.map_or(until, |deadline| deadline.min(until));
            if let Some(seen) = self.spin(poller, nudges, until) {
                poller.looked += 1;
                return nudges.after(seen);
            }
        }
        loop {
            match self.sleep(poller, nudges, deadline) {
                Some(seen) if nudges.thread.is_nudged() || seen == Seen::Frames => {
                    return nudges.after(seen);
                }
                Some(_) if deadline.is_some_and(|deadline| deadline <= self.clock.now()) => {
                    return Waited::Awake;
                }
                Some(_) => {}
                None => return Waited::Awake,
            }
        }
    }

    /// Looks at the shared memory until something has come, the thread is nudged or the time is over.
    fn spin(&self, poller: &mut Poller, nudges: &Nudges, until: Instant) -> Option<Seen> {
        loop {
            self.sources.refresh(poller);
            if poller.visible.is_empty() {
                return None;
            }
            for _ in 0..LOOKS_PER_CLOCK {
                if nudges.thread.is_nudged() {
                    return Some(Seen::Nothing);
                }
                if poller.has_come() {
                    return Some(self.sources.serve_visible(poller));
                }
                std::hint::spin_loop();
            }
            if self.clock.now() >= until {
                return None;
            }
        }
    }

    /// Sleeps until something happens, at most until `deadline`, and hands on what has come. It may end before
    /// for no reason. `None` when the system does not let it.
    fn sleep(
        &self,
        poller: &mut Poller,
        nudges: &Nudges,
        deadline: Option<Instant>,
    ) -> Option<Seen> {
        self.sources.refresh(poller);
        nudges.at_links.store(true, Ordering::Relaxed);
        poller.set_asleep(true);
        // Pairs with the fence of the writer to the memory, and with the nudge. Either they see the
        // sleeper, or the sleeper sees what was written.
        fence(Ordering::SeqCst);
        let work = poller.has_come();
        let polled = if work && poller.looked < LOOKS_PER_POLL {
            // The sockets can wait for a few rounds.
            poller.looked += 1;
            poller.events.clear();
            Ok(())
        } else {
            poller.looked = 0;
            let at_once = work || nudges.thread.is_nudged();
            self.sources.poll(poller, at_once, deadline)
        };
        nudges.at_links.store(false, Ordering::SeqCst);
        poller.set_asleep(false);
        if let Err(error) = polled {
            tracing::error!(error = %error, "the links cannot be waited for");
            return None;
        }
        let mut seen = self.sources.serve_events(poller, Seen::Nothing);
        if work && self.sources.serve_visible(poller) == Seen::Frames {
            seen = Seen::Frames;
        }
        Some(seen)
    }

    /// The standby's thread: leads when nobody has for a tick, until somebody wants to.
    fn stand_by(&self) {
        let standby = &self.standby;
        let _ = standby.thread.set(std::thread::current());
        while !standby.stop.load(Ordering::SeqCst) {
            let before = self.leads.load(Ordering::Relaxed);
            std::thread::park_timeout(TICK);
            if self.leads.load(Ordering::Relaxed) != before {
                continue;
            }
            if self.is_led.load(Ordering::SeqCst) {
                // Somebody waits there quietly: nothing to do before it leaves.
                standby.asleep.store(true, Ordering::SeqCst);
                while standby.asleep.load(Ordering::SeqCst)
                    && self.is_led.load(Ordering::SeqCst)
                    && !standby.stop.load(Ordering::SeqCst)
                {
                    std::thread::park();
                }
                standby.asleep.store(false, Ordering::SeqCst);
                continue;
            }
            if standby.wanted.load(Ordering::SeqCst) {
                self.hand_over();
                continue;
            }
            let Ok(mut leader) = self.leader.try_lock() else {
                continue;
            };
            standby.leads.store(true, Ordering::SeqCst);
            loop {
                // Before the standby reads what the nudge is for: a nudge after that ends the sleep at once.
                standby.parker.thread.take_nudge();
                if standby.wanted.load(Ordering::SeqCst)
                    || standby.stop.load(Ordering::SeqCst)
                    || self.sleep(&mut leader, &standby.parker, None).is_none()
                {
                    break;
                }
            }
            standby.leads.store(false, Ordering::SeqCst);
            drop(leader);
            self.hand_over();
        }
    }
}

/// A source that is looked at, until this is dropped.
pub struct Watched {
    reactor: Arc<Reactor>,
    source: Arc<dyn Source>,
    id: usize,
}

impl Watched {
    /// Serves the source now, whatever its file descriptor says.
    pub fn serve(&self) {
        let happened = Happened {
            readable: true,
            closed: true,
            writable: true,
        };
        let seen = self.source.serve(happened);
        self.reactor.sources.served(self.id, seen, Seen::Nothing);
    }
}

impl Drop for Watched {
    fn drop(&mut self) {
        self.reactor.sources.remove(self.id);
    }
}

#[cfg(test)]
mod tests;
