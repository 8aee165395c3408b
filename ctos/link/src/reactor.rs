//! The reactor of a chassis: whoever has nothing else to do reads what comes over the links.
//!
//! A processor that runs out of work does not just sleep, it waits at the links, and handles what it
//! reads there itself. So a message from another process costs one wake-up and no second thread.
//! Only one thread at a time waits there, the leader; while all processors are busy a thread that has
//! nothing else to do, the standby, leads, `TICK` to two of them late.
//!
//! Knows links as [`Source`]s of a file descriptor each; what they bring is not its business.

use std::{
    collections::BTreeMap,
    io,
    os::fd::{AsRawFd, BorrowedFd, OwnedFd},
    sync::{
        Arc, Mutex, MutexGuard, OnceLock, PoisonError, RwLock, TryLockError,
        atomic::{AtomicBool, AtomicU64, Ordering, fence},
    },
    thread::Thread,
    time::Duration,
};

use mio::{Events, Interest, Poll, Registry, Token, Waker, unix::SourceFd};
use rustix::{
    event::Timespec,
    time::{
        Itimerspec, TimerfdClockId, TimerfdFlags, TimerfdTimerFlags, timerfd_create,
        timerfd_settime,
    },
};

use crate::{
    lock::lock,
    park::{Glance, Park, ThreadParker},
    time::{Clock, Instant},
};

/// How often the standby looks whether anybody leads, while there is traffic.
const TICK: Duration = Duration::from_millis(1);

/// How many events are taken at a time.
const EVENTS: usize = 32;

/// How often a thread may find work in shared memory before it looks at the sockets.
const LOOKS_PER_WAIT: u32 = 16;

/// Looks at the shared memory between two looks at the clock.
const LOOKS_PER_CLOCK: u32 = 16;

/// What wakes the leader.
const WAKER: Token = Token(0);

/// What ends its sleep in time.
const TIMER: Token = Token(1);

/// The longest time for which the timer is set.
const LONGEST: Duration = Duration::from_secs(3600);

/// What a source had.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Seen {
    /// Nothing for a task.
    Nothing,
    /// Frames, which were handed on.
    Frames,
    /// It is over and need not be looked at again.
    End,
}

/// What has happened to a source. It is told once: a source reads until nothing is left, or asks to be told
/// again ([`Reactor::tell`]).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Happened {
    /// Something may have come.
    pub came: bool,
    /// The other end has closed: behind what has come stands the end.
    pub closed: bool,
    /// There may be room for what waits to be written.
    pub room: bool,
}

/// One end of a link, as the reactor sees it.
pub trait Source: Send + Sync {
    /// Reads what there is and hands it on; writes what waited for room.
    fn serve(&self, happened: Happened) -> Seen;

    /// What says that something has happened.
    fn fd(&self) -> BorrowedFd<'_>;

    /// The other side, if it can be seen without asking the system whether something has come.
    fn visible(&self) -> Option<&dyn Visible> {
        None
    }
}

/// A source in shared memory.
pub trait Visible {
    /// Whether something has come.
    fn has_come(&self) -> bool;

    /// From now on its file descriptor must say when something comes, or need no longer.
    fn set_asleep(&self, asleep: bool);
}

type Sources = BTreeMap<usize, Arc<dyn Source>>;

/// What the leader works with.
struct Leader {
    poll: Poll,
    events: Events,
    /// How often in a row it was enough to look at the memory.
    looked: u32,
    /// When the timer rings, if it is set.
    rings_at: Option<Instant>,
    /// The sources in shared memory, so that looking at them takes no lock, and of which version they are.
    visible: Vec<(usize, Arc<dyn Source>)>,
    version: u64,
    /// There are other sources, of which the system must be asked.
    has_sockets: bool,
}

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

/// The links of one chassis, and who waits for them.
pub struct Reactor {
    clock: Clock,
    /// How long to look at shared memory before sleeping; zero where that would keep others from their core.
    spin: Duration,
    registry: Registry,
    waker: Waker,
    timer: OwnedFd,
    next: AtomicU64,
    sources: RwLock<Sources>,
    /// Counts the changes of the sources.
    version: AtomicU64,
    leader: Mutex<Leader>,
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
            reactor.wake();
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
        let poll = Poll::new()?;
        let registry = poll.registry().try_clone()?;
        let waker = Waker::new(&registry, WAKER)?;
        let timer_flags = TimerfdFlags::CLOEXEC | TimerfdFlags::NONBLOCK;
        let timer = timerfd_create(TimerfdClockId::Monotonic, timer_flags)?;
        registry.register(&mut SourceFd(&timer.as_raw_fd()), TIMER, Interest::READABLE)?;
        let reactor = Arc::new(Self {
            clock,
            spin,
            registry,
            waker,
            timer,
            next: AtomicU64::new(2),
            sources: RwLock::default(),
            version: AtomicU64::new(0),
            leader: Mutex::new(Leader {
                poll,
                events: Events::with_capacity(EVENTS),
                looked: 0,
                rings_at: None,
                visible: Vec::new(),
                version: 0,
                has_sockets: false,
            }),
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
    pub fn add(
        self: &Arc<Self>,
        make: impl FnOnce(Token) -> Arc<dyn Source>,
    ) -> io::Result<Watched> {
        let id = usize::try_from(self.next.fetch_add(1, Ordering::Relaxed));
        let id = id.map_err(io::Error::other)?;
        let source = make(Token(id));
        write(&self.sources).insert(id, source.clone());
        self.version.fetch_add(1, Ordering::Release);
        let watched = Watched {
            reactor: self.clone(),
            source,
            id,
        };
        let interest = match watched.source.visible() {
            Some(_) => Interest::READABLE,
            // The first event writes what was posted before.
            None => Interest::READABLE | Interest::WRITABLE,
        };
        let fd = watched.source.fd().as_raw_fd();
        self.registry
            .register(&mut SourceFd(&fd), Token(id), interest)?;
        // A leader that looks at the memory already must see this one too.
        self.wake();
        Ok(watched)
    }

    /// Tells a source anew what has happened to it, and from now on also when there is room, or no longer.
    pub fn tell(&self, fd: BorrowedFd<'_>, token: Token, room: bool) {
        let interest = if room {
            Interest::READABLE | Interest::WRITABLE
        } else {
            Interest::READABLE
        };
        // One that is no longer looked at needs to be told nothing.
        let _ = self
            .registry
            .reregister(&mut SourceFd(&fd.as_raw_fd()), token, interest);
    }

    fn remove(&self, id: usize) {
        let removed = write(&self.sources).remove(&id);
        if let Some(source) = removed {
            self.version.fetch_add(1, Ordering::Release);
            // It fails when it could not be added.
            let _ = self
                .registry
                .deregister(&mut SourceFd(&source.fd().as_raw_fd()));
            // A leader that sleeps keeps it no longer.
            self.wake();
        }
    }

    /// Ends the standby; nobody looks at the links any more.
    pub fn close(&self) {
        self.standby.stop.store(true, Ordering::SeqCst);
        self.standby.parker.wake_leader(self);
        if let Some(thread) = self.standby.thread.get() {
            thread.unpark();
        }
    }

    fn wake(&self) {
        // It can only fail when the system is out of memory for it.
        let _ = self.waker.wake();
    }

    /// Waits at the links for `nudges` until there is one or `end` is there, and hands on what comes.
    fn wait(&self, nudges: &Nudges, end: Option<Instant>) -> Waited {
        let Some(mut leader) = self.lead() else {
            return Waited::Elsewhere;
        };
        // Seen late, it leads the standby to try for a lead that it does not get.
        self.is_led.store(true, Ordering::Release);
        let waited = self.look(&mut leader, nudges, end);
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
    fn lead(&self) -> Option<MutexGuard<'_, Leader>> {
        let leader = match self.leader.try_lock() {
            Ok(leader) => leader,
            Err(TryLockError::Poisoned(leader)) => leader.into_inner(),
            Err(TryLockError::WouldBlock) => {
                if self.standby.leads.load(Ordering::SeqCst) {
                    // Not waited for here, where nobody could wake this thread: the standby wakes it when
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
        let come = read(&self.sources).values().any(has_come);
        if !come && glance == Glance::AtMemory {
            return Seen::Nothing;
        }
        // Whoever leads sees it, too.
        let Some(mut leader) = self.lead() else {
            return Seen::Nothing;
        };
        self.refresh(&mut leader);
        let mut seen = Seen::Nothing;
        if come {
            leader.looked += 1;
            seen = self.serve_visible(&leader);
        }
        let due = glance == Glance::Everywhere || leader.looked >= LOOKS_PER_WAIT;
        if due && leader.has_sockets {
            leader.looked = 0;
            // Should it fail, whoever sleeps there next says so.
            if let Ok(()) = self.poll(&mut leader, true, None) {
                seen = self.serve_events(&mut leader, seen);
            }
        }
        seen
    }

    fn look(&self, leader: &mut Leader, nudges: &Nudges, end: Option<Instant>) -> Waited {
        if !self.spin.is_zero() && leader.looked < LOOKS_PER_WAIT {
            let until = self.clock.now() + self.spin;
            let until = end.map_or(until, |end| end.min(until));
            if let Some(seen) = self.spin(leader, nudges, until) {
                leader.looked += 1;
                return nudges.after(seen);
            }
        }
        loop {
            match self.sleep(leader, nudges, end) {
                Some(seen) if nudges.thread.is_nudged() || seen == Seen::Frames => {
                    return nudges.after(seen);
                }
                Some(_) if end.is_some_and(|end| end <= self.clock.now()) => return Waited::Awake,
                Some(_) => {}
                None => return Waited::Awake,
            }
        }
    }

    /// Looks at the shared memory until something has come, the thread is nudged or the time is over.
    fn spin(&self, leader: &mut Leader, nudges: &Nudges, until: Instant) -> Option<Seen> {
        loop {
            self.refresh(leader);
            if leader.visible.is_empty() {
                return None;
            }
            for _ in 0..LOOKS_PER_CLOCK {
                if nudges.thread.is_nudged() {
                    return Some(Seen::Nothing);
                }
                if leader.has_come() {
                    return Some(self.serve_visible(leader));
                }
                std::hint::spin_loop();
            }
            if self.clock.now() >= until {
                return None;
            }
        }
    }

    /// Looks which sources there are, if that has changed.
    fn refresh(&self, leader: &mut Leader) {
        let version = self.version.load(Ordering::Acquire);
        if leader.version == version {
            return;
        }
        // What changes meanwhile makes another version.
        leader.version = version;
        let sources = read(&self.sources);
        let visible = sources
            .iter()
            .filter(|(_, source)| source.visible().is_some());
        leader.visible = visible.map(|(id, source)| (*id, source.clone())).collect();
        leader.has_sockets = leader.visible.len() < sources.len();
    }

    fn serve_visible(&self, leader: &Leader) -> Seen {
        let mut seen = Seen::Nothing;
        let happened = Happened {
            came: true,
            closed: false,
            room: false,
        };
        for (id, source) in leader.visible.iter().filter(|(_, source)| has_come(source)) {
            seen = self.served(*id, source.serve(happened), seen);
        }
        seen
    }

    /// What `id` had, beside what others had.
    fn served(&self, id: usize, seen: Seen, before: Seen) -> Seen {
        match seen {
            Seen::Nothing => before,
            Seen::Frames => Seen::Frames,
            Seen::End => {
                self.remove(id);
                before
            }
        }
    }

    /// Sleeps until something happens, at most until `end`, and hands on what has come. It may end before
    /// for no reason. `None` when the system does not let it.
    fn sleep(&self, leader: &mut Leader, nudges: &Nudges, end: Option<Instant>) -> Option<Seen> {
        self.refresh(leader);
        nudges.at_links.store(true, Ordering::Relaxed);
        leader.set_asleep(true);
        // Pairs with the fence of whoever writes into the memory, and with the nudge: either they see the
        // sleeper, or the sleeper sees what was written.
        fence(Ordering::SeqCst);
        let work = leader.has_come();
        let polled = if work && leader.looked < LOOKS_PER_WAIT {
            // The sockets can wait for a few rounds.
            leader.looked += 1;
            leader.events.clear();
            Ok(())
        } else {
            leader.looked = 0;
            let at_once = work || nudges.thread.is_nudged();
            self.poll(leader, at_once, end)
        };
        nudges.at_links.store(false, Ordering::SeqCst);
        leader.set_asleep(false);
        if let Err(error) = polled {
            tracing::error!(error = %error, "the links cannot be waited for");
            return None;
        }
        let mut seen = self.serve_events(leader, Seen::Nothing);
        if work && self.serve_visible(leader) == Seen::Frames {
            seen = Seen::Frames;
        }
        Some(seen)
    }

    /// Hands on what has come where something has happened; what that was, beside what there was before.
    fn serve_events(&self, leader: &mut Leader, before: Seen) -> Seen {
        let mut seen = before;
        for event in &leader.events {
            match event.token() {
                WAKER => {}
                TIMER => leader.rings_at = None,
                Token(id) => {
                    let happened = Happened {
                        came: event.is_readable() || event.is_read_closed() || event.is_error(),
                        closed: event.is_read_closed() || event.is_error(),
                        room: event.is_writable(),
                    };
                    let source = read(&self.sources).get(&id).cloned();
                    if let Some(source) = source {
                        seen = self.served(id, source.serve(happened), seen);
                    }
                }
            }
        }
        seen
    }

    /// Waits for what happens, at most until `end`.
    fn poll(&self, leader: &mut Leader, at_once: bool, end: Option<Instant>) -> io::Result<()> {
        if !at_once && let Some(end) = end {
            self.ring_by(leader, end)?;
        }
        let Leader { poll, events, .. } = leader;
        match poll.poll(events, at_once.then_some(Duration::ZERO)) {
            Err(error) if error.kind() == io::ErrorKind::Interrupted => {
                events.clear();
                Ok(())
            }
            polled => polled,
        }
    }

    /// Sees to it that the timer rings at `end`, or before: a time-out of the poll itself is a whole number of
    /// milliseconds. One that rings sooner is left alone: calls have deadlines, each a little later than that of
    /// the call before, and setting the timer for each of them costs more than that it rings once in vain.
    fn ring_by(&self, leader: &mut Leader, end: Instant) -> io::Result<()> {
        if leader.rings_at.is_some_and(|at| at <= end) {
            return Ok(());
        }
        // Zero would switch it off.
        let left = end.since(self.clock.now());
        let left = left.clamp(Duration::from_nanos(1), LONGEST);
        let once = Itimerspec {
            it_interval: Timespec {
                tv_sec: 0,
                tv_nsec: 0,
            },
            it_value: Timespec::try_from(left).map_err(io::Error::other)?,
        };
        timerfd_settime(&self.timer, TimerfdTimerFlags::empty(), &once)?;
        leader.rings_at = Some(end);
        Ok(())
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
                // Before it is asked for what: a nudge after that ends the sleep at once.
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

impl Leader {
    /// Whether anything has come that can be seen without asking the system.
    fn has_come(&self) -> bool {
        self.visible.iter().any(|(_, source)| has_come(source))
    }

    fn set_asleep(&self, asleep: bool) {
        for visible in self
            .visible
            .iter()
            .filter_map(|(_, source)| source.visible())
        {
            visible.set_asleep(asleep);
        }
    }
}

fn has_come(source: &Arc<dyn Source>) -> bool {
    source.visible().is_some_and(Visible::has_come)
}

fn read(sources: &RwLock<Sources>) -> std::sync::RwLockReadGuard<'_, Sources> {
    sources.read().unwrap_or_else(PoisonError::into_inner)
}

fn write(sources: &RwLock<Sources>) -> std::sync::RwLockWriteGuard<'_, Sources> {
    sources.write().unwrap_or_else(PoisonError::into_inner)
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
            came: true,
            closed: true,
            room: true,
        };
        let seen = self.source.serve(happened);
        self.reactor.served(self.id, seen, Seen::Nothing);
    }
}

impl Drop for Watched {
    fn drop(&mut self) {
        self.reactor.remove(self.id);
    }
}

#[cfg(test)]
mod tests;
