//! The lookout of a chassis: whoever has nothing else to do reads what comes over the links.
//!
//! A processor that runs out of work does not just sleep, it waits at the links, and handles what it
//! reads there itself. So a message from another process costs one wake-up and no second thread.
//! Only one thread at a time has the turn at the links; while all of them are busy a thread that has
//! nothing else to do, the relief, takes it, [`TICK`] to two of them late.
//!
//! Knows links as [`Source`]s of a file descriptor each; what they bring is not its business.

mod parker;

use std::{
    collections::BTreeMap,
    io,
    mem::MaybeUninit,
    os::fd::{BorrowedFd, OwnedFd},
    sync::{
        Arc, Mutex, MutexGuard, OnceLock, PoisonError, RwLock, TryLockError, Weak,
        atomic::{AtomicBool, AtomicU64, Ordering, fence},
    },
    thread::Thread,
    time::Duration,
};

use rustix::{
    event::{EventfdFlags, Timespec, epoll, eventfd},
    io::Errno,
    time::{
        Itimerspec, TimerfdClockId, TimerfdFlags, TimerfdTimerFlags, timerfd_create,
        timerfd_settime,
    },
};

pub(crate) use self::parker::Parker;
use crate::{
    lock::lock,
    time::{Clock, Instant},
};

/// How often the relief looks whether anybody is at the links, while there is traffic.
const TICK: Duration = Duration::from_millis(1);

/// How many events are taken at a time.
const EVENTS: usize = 32;

/// How often a thread may find work in shared memory before it looks at the sockets.
const LOOKS_PER_WAIT: u32 = 16;

/// Looks at the shared memory between two looks at the clock.
const LOOKS_PER_CLOCK: u32 = 16;

/// The number of the nudge among the sources.
const NUDGE: u64 = 0;

/// The number of the timer among the sources.
const TIMER: u64 = u64::MAX;

/// What a source had.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Seen {
    /// Nothing for a task.
    Nothing,
    /// Frames, which were handed on.
    Frames,
    /// It is over and need not be looked at again.
    End,
}

/// What has happened to a source.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Happened {
    /// Something may have come.
    pub(crate) came: bool,
    /// There may be room for what waits to be written.
    pub(crate) room: bool,
}

/// How a thread that is awake looks at the links.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Glance {
    /// At shared memory only, which costs next to nothing.
    AtMemory,
    /// At the sockets as well, of which the system is asked.
    Everywhere,
}

/// One end of a link, as the lookout sees it.
pub(crate) trait Source: Send + Sync {
    /// Reads what there is and hands it on; writes what waited for room.
    fn serve(&self, happened: Happened) -> Seen;

    /// Whether something has come, where that can be seen without asking the system.
    fn has_come(&self) -> bool;

    /// Whether [`Self::has_come`] can ever say so.
    fn is_visible(&self) -> bool;

    /// What says that something has happened.
    fn fd(&self) -> BorrowedFd<'_>;

    /// From now on its file descriptor must say when something comes, or need no longer.
    fn set_asleep(&self, asleep: bool);
}

type Sources = BTreeMap<u64, Arc<dyn Source>>;

/// The turn, with what the one who has it works with.
#[derive(Default)]
struct Turn {
    /// How often in a row it was enough to look at the memory.
    looked: u32,
    /// When the timer rings, if it is set.
    rings_at: Option<Instant>,
    known: Known,
}

/// The sources as whoever has the turn knows them, so that looking at them takes no lock.
#[derive(Default)]
struct Known {
    /// Which state of them it is; there are none in the first, 0.
    version: u64,
    visible: Vec<(u64, Arc<dyn Source>)>,
    /// The others. Not kept alive here: the other end sees that a socket is closed, and shall see it at once.
    hidden: BTreeMap<u64, Weak<dyn Source>>,
}

/// How a wait at the links ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Waited {
    /// There is something to do, or the time is over.
    Awake,
    /// What came was for others, one of whom shall have the turn next.
    HandedOn,
    /// Somebody else has the turn.
    Elsewhere,
}

/// The links of one chassis, and who looks at them.
pub(crate) struct Lookout {
    clock: Clock,
    /// How long to look at shared memory before sleeping.
    spin: Duration,
    epoll: OwnedFd,
    nudge: OwnedFd,
    timer: OwnedFd,
    next: AtomicU64,
    sources: RwLock<Sources>,
    /// Those that can be looked at without asking the system.
    visible: RwLock<Sources>,
    /// Counts the changes of both.
    version: AtomicU64,
    turn: Mutex<Turn>,
    /// Somebody is at the links.
    manned: AtomicBool,
    /// How often somebody came to the links.
    turns: AtomicU64,
    relief: Relief,
}

/// The thread that looks at the links while nobody else does.
#[derive(Default)]
struct Relief {
    thread: OnceLock<Thread>,
    parker: Parker,
    /// It wants to be woken when the links are left.
    asleep: AtomicBool,
    /// It has the turn.
    has_turn: AtomicBool,
    /// A processor wants the turn, and which.
    wanted: AtomicBool,
    wanted_by: Mutex<Option<Thread>>,
    stop: AtomicBool,
}

impl Lookout {
    /// A lookout without links. `spin` is how long it looks at shared memory before it sleeps.
    ///
    /// # Errors
    /// What the system says.
    pub(crate) fn new(name: &str, clock: Clock, spin: Duration) -> io::Result<Arc<Self>> {
        let nudge = bell()?;
        let epoll = epoll::create(epoll::CreateFlags::CLOEXEC)?;
        let flags = epoll::EventFlags::IN | epoll::EventFlags::ET;
        epoll::add(&epoll, &nudge, epoll::EventData::new_u64(NUDGE), flags)?;
        let timer_flags = TimerfdFlags::CLOEXEC | TimerfdFlags::NONBLOCK;
        let timer = timerfd_create(TimerfdClockId::Monotonic, timer_flags)?;
        epoll::add(&epoll, &timer, epoll::EventData::new_u64(TIMER), flags)?;
        let lookout = Arc::new(Self {
            clock,
            spin,
            epoll,
            nudge,
            timer,
            next: AtomicU64::new(NUDGE + 1),
            sources: RwLock::default(),
            visible: RwLock::default(),
            version: AtomicU64::new(0),
            turn: Mutex::default(),
            manned: AtomicBool::new(false),
            turns: AtomicU64::new(0),
            relief: Relief::default(),
        });
        let home = lookout.clone();
        std::thread::Builder::new()
            .name(format!("{name} links"))
            .spawn(move || home.relieve())?;
        Ok(lookout)
    }

    /// Looks at a source from now on, until what is returned is dropped.
    ///
    /// # Errors
    /// What the system says.
    pub(crate) fn add(
        self: &Arc<Self>,
        make: impl FnOnce(u64) -> Arc<dyn Source>,
    ) -> io::Result<Watched> {
        let id = self.next.fetch_add(1, Ordering::Relaxed);
        let source = make(id);
        write(&self.sources).insert(id, source.clone());
        let flags = if source.is_visible() {
            write(&self.visible).insert(id, source.clone());
            // A bell: each ring is an event, and nobody need read it.
            epoll::EventFlags::IN | epoll::EventFlags::ET
        } else {
            // The first of them writes what was posted before.
            epoll::EventFlags::IN | epoll::EventFlags::OUT
        };
        self.version.fetch_add(1, Ordering::Release);
        let watched = Watched {
            lookout: self.clone(),
            source,
            id,
        };
        let data = epoll::EventData::new_u64(id);
        epoll::add(&self.epoll, watched.source.fd(), data, flags)?;
        // A thread that looks at the memory already must see this one too.
        self.nudge();
        Ok(watched)
    }

    /// Asks to be told when there is room in a source's socket, or no longer.
    pub(crate) fn wants_room(&self, fd: BorrowedFd<'_>, id: u64, wants: bool) {
        let flags = if wants {
            epoll::EventFlags::IN | epoll::EventFlags::OUT
        } else {
            epoll::EventFlags::IN
        };
        // One that is no longer looked at needs no room.
        let _ = epoll::modify(&self.epoll, fd, epoll::EventData::new_u64(id), flags);
    }

    fn remove(&self, id: u64) {
        write(&self.visible).remove(&id);
        let removed = write(&self.sources).remove(&id);
        if let Some(source) = removed {
            self.version.fetch_add(1, Ordering::Release);
            // It fails when it could not be added.
            let _ = epoll::delete(&self.epoll, source.fd());
            // Whoever sleeps there keeps it no longer.
            self.nudge();
        }
    }

    /// Looks which sources there are, if that has changed.
    fn refresh(&self, known: &mut Known) {
        let version = self.version.load(Ordering::Acquire);
        if known.version == version {
            return;
        }
        // What changes meanwhile makes another version.
        let visible = read(&self.visible).clone();
        let hidden = read(&self.sources);
        let hidden = hidden.iter().filter(|(id, _)| !visible.contains_key(id));
        *known = Known {
            version,
            hidden: hidden
                .map(|(id, source)| (*id, Arc::downgrade(source)))
                .collect(),
            visible: visible.into_iter().collect(),
        };
    }

    /// Ends the relief; nobody looks at the links any more.
    pub(crate) fn close(&self) {
        self.relief.stop.store(true, Ordering::SeqCst);
        self.relief.parker.unpark_at(self);
        if let Some(thread) = self.relief.thread.get() {
            thread.unpark();
        }
    }

    fn nudge(&self) {
        // It can only fail when it was rung 2^64 times.
        let _ = rustix::io::write(&self.nudge, &1_u64.to_ne_bytes());
    }

    /// Waits at the links for `parker` until it is nudged or `end` is there, and hands on what comes.
    fn wait(&self, parker: &Parker, end: Option<Instant>) -> Waited {
        let Some(mut turn) = self.take_turn() else {
            return Waited::Elsewhere;
        };
        self.count_turn(&mut turn);
        // Seen late, it leads the relief to a turn that it does not get.
        self.manned.store(true, Ordering::Release);
        let waited = self.look(&mut turn, parker, end);
        drop(turn);
        self.manned.store(false, Ordering::SeqCst);
        // Mostly it is not, and a look costs less than a change.
        if self.relief.asleep.load(Ordering::SeqCst)
            && self.relief.asleep.swap(false, Ordering::SeqCst)
            && let Some(thread) = self.relief.thread.get()
        {
            thread.unpark();
        }
        waited
    }

    /// Somebody has come to the links, and has the turn: nobody else counts.
    fn count_turn(&self, _: &mut Turn) {
        let turns = self.turns.load(Ordering::Relaxed);
        self.turns.store(turns.wrapping_add(1), Ordering::Relaxed);
    }

    /// The turn, if nobody has it. The relief is told that it is wanted.
    fn take_turn(&self) -> Option<MutexGuard<'_, Turn>> {
        match self.turn.try_lock() {
            Ok(turn) => return Some(turn),
            Err(TryLockError::Poisoned(turn)) => return Some(turn.into_inner()),
            Err(TryLockError::WouldBlock) => {}
        }
        if !self.relief.has_turn.load(Ordering::SeqCst) {
            return None;
        }
        // Not waited for here, where nobody could wake this thread: the relief wakes it when it may try
        // again.
        *lock(&self.relief.wanted_by) = Some(std::thread::current());
        self.relief.wanted.store(true, Ordering::SeqCst);
        self.relief.parker.unpark_at(self);
        None
    }

    /// Wakes the processor that wanted the turn.
    fn hand_over(&self) {
        self.relief.wanted.store(false, Ordering::SeqCst);
        let wanted_by = lock(&self.relief.wanted_by).take();
        if let Some(thread) = wanted_by {
            thread.unpark();
        }
    }

    /// Looks once, without sleeping, and hands on what has come.
    pub(crate) fn glance(&self, glance: Glance) -> Seen {
        let come = read(&self.visible).values().any(|source| source.has_come());
        if !come && glance == Glance::AtMemory {
            return Seen::Nothing;
        }
        // Whoever has the turn sees it, too.
        let Some(mut turn) = self.take_turn() else {
            return Seen::Nothing;
        };
        self.count_turn(&mut turn);
        self.refresh(&mut turn.known);
        let mut seen = if come {
            turn.looked += 1;
            self.serve_visible(&turn.known)
        } else {
            Seen::Nothing
        };
        let due = glance == Glance::Everywhere || turn.looked >= LOOKS_PER_WAIT;
        if due && !turn.known.hidden.is_empty() {
            turn.looked = 0;
            let mut space = [MaybeUninit::uninit(); EVENTS];
            // Should it fail, whoever sleeps there next says so.
            if let Ok(events) = self.wait_for_events(&mut turn, &mut space, true, None) {
                seen = self.serve_events(&mut turn, events, seen);
            }
        }
        seen
    }

    fn look(&self, turn: &mut Turn, parker: &Parker, end: Option<Instant>) -> Waited {
        if !self.spin.is_zero() && turn.looked < LOOKS_PER_WAIT {
            let until = self.clock.now() + self.spin;
            let until = end.map_or(until, |end| end.min(until));
            if let Some(seen) = self.spin(&mut turn.known, parker, until) {
                turn.looked += 1;
                return parker.after(seen);
            }
        }
        loop {
            match self.sleep(turn, parker, end) {
                Some(seen) if parker.is_nudged() || seen == Seen::Frames => {
                    return parker.after(seen);
                }
                Some(_) if end.is_some_and(|end| end <= self.clock.now()) => return Waited::Awake,
                Some(_) => {}
                None => return Waited::Awake,
            }
        }
    }

    /// Looks at the shared memory until something has come, the thread is nudged or the time is over.
    fn spin(&self, known: &mut Known, parker: &Parker, until: Instant) -> Option<Seen> {
        loop {
            self.refresh(known);
            if known.visible.is_empty() {
                return None;
            }
            for _ in 0..LOOKS_PER_CLOCK {
                if parker.is_nudged() {
                    return Some(Seen::Nothing);
                }
                if known.has_come() {
                    return Some(self.serve_visible(known));
                }
                std::hint::spin_loop();
            }
            if self.clock.now() >= until {
                return None;
            }
        }
    }

    fn serve_visible(&self, known: &Known) -> Seen {
        let mut seen = Seen::Nothing;
        let happened = Happened {
            came: true,
            room: false,
        };
        for (id, source) in known.visible.iter().filter(|(_, source)| source.has_come()) {
            seen = self.served(*id, source.serve(happened), seen);
        }
        seen
    }

    /// What `id` had, beside what others had.
    fn served(&self, id: u64, seen: Seen, before: Seen) -> Seen {
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
    fn sleep(&self, turn: &mut Turn, parker: &Parker, end: Option<Instant>) -> Option<Seen> {
        self.refresh(&mut turn.known);
        parker.set_at_links(true);
        for (_, source) in &turn.known.visible {
            source.set_asleep(true);
        }
        // Pairs with the fence of whoever writes into the memory, and with the nudge: either they see the
        // sleeper, or the sleeper sees what was written.
        fence(Ordering::SeqCst);
        let work = turn.known.has_come();
        let mut space = [MaybeUninit::uninit(); EVENTS];
        let waited = if work && turn.looked < LOOKS_PER_WAIT {
            // The sockets can wait for a few rounds.
            turn.looked += 1;
            Ok(&[][..])
        } else {
            turn.looked = 0;
            let at_once = work || parker.is_nudged();
            self.wait_for_events(turn, &mut space, at_once, end)
        };
        parker.set_at_links(false);
        for (_, source) in &turn.known.visible {
            source.set_asleep(false);
        }
        let events = match waited {
            Ok(events) => events,
            Err(error) => {
                tracing::error!(error = %error, "the links cannot be waited for");
                return None;
            }
        };
        let mut seen = self.serve_events(turn, events, Seen::Nothing);
        if work && self.serve_visible(&turn.known) == Seen::Frames {
            seen = Seen::Frames;
        }
        Some(seen)
    }

    /// Hands on what has come where something has happened; what that was, beside what there was before.
    fn serve_events(&self, turn: &mut Turn, events: &[epoll::Event], before: Seen) -> Seen {
        let mut seen = before;
        for event in events {
            let id = event.data.u64();
            let flags = event.flags;
            if id == TIMER {
                turn.rings_at = None;
                continue;
            }
            let happened = Happened {
                came: flags.intersects(!epoll::EventFlags::OUT),
                room: flags.contains(epoll::EventFlags::OUT),
            };
            let known = &turn.known;
            let served = match known.visible.iter().find(|(known, _)| *known == id) {
                Some((_, source)) => source.serve(happened),
                None => match self.hidden(known, id) {
                    Some(source) => source.serve(happened),
                    None => continue,
                },
            };
            seen = self.served(id, served, seen);
        }
        seen
    }

    /// A source that cannot be looked at without asking the system, or one that has just come.
    fn hidden(&self, known: &Known, id: u64) -> Option<Arc<dyn Source>> {
        let hidden = known.hidden.get(&id).and_then(Weak::upgrade);
        hidden.or_else(|| read(&self.sources).get(&id).cloned())
    }

    /// Waits for what happens, at most until `end`.
    fn wait_for_events<'s>(
        &self,
        turn: &mut Turn,
        space: &'s mut [MaybeUninit<epoll::Event>],
        at_once: bool,
        end: Option<Instant>,
    ) -> io::Result<&'s [epoll::Event]> {
        if !at_once && let Some(end) = end {
            self.ring_by(turn, end)?;
        }
        let timeout = at_once.then_some(Timespec {
            tv_sec: 0,
            tv_nsec: 0,
        });
        match epoll::wait(&self.epoll, space, timeout.as_ref()) {
            Ok((events, _)) => Ok(events),
            Err(Errno::INTR) => Ok(&[]),
            Err(error) => Err(error.into()),
        }
    }

    /// Sees to it that the timer rings at `end`, or before. One that is set already and rings sooner is left
    /// alone: calls have deadlines, each a little later than that of the call before, and setting the timer
    /// for each of them costs more than that it rings once in vain.
    fn ring_by(&self, turn: &mut Turn, end: Instant) -> io::Result<()> {
        if turn.rings_at.is_some_and(|at| at <= end) {
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
        turn.rings_at = Some(end);
        Ok(())
    }

    /// The relief's thread: takes the turn when nobody has had it for a tick, until somebody wants it.
    fn relieve(&self) {
        let relief = &self.relief;
        let _ = relief.thread.set(std::thread::current());
        while !relief.stop.load(Ordering::SeqCst) {
            let before = self.turns.load(Ordering::Relaxed);
            std::thread::park_timeout(TICK);
            if self.turns.load(Ordering::Relaxed) != before {
                continue;
            }
            if self.manned.load(Ordering::SeqCst) {
                // Somebody waits there quietly: nothing to do before it leaves.
                relief.asleep.store(true, Ordering::SeqCst);
                while relief.asleep.load(Ordering::SeqCst)
                    && self.manned.load(Ordering::SeqCst)
                    && !relief.stop.load(Ordering::SeqCst)
                {
                    std::thread::park();
                }
                relief.asleep.store(false, Ordering::SeqCst);
                continue;
            }
            if relief.wanted.load(Ordering::SeqCst) {
                self.hand_over();
                continue;
            }
            let Ok(mut turn) = self.turn.try_lock() else {
                continue;
            };
            relief.has_turn.store(true, Ordering::SeqCst);
            loop {
                // Before it is asked for what: a nudge after that ends the sleep at once.
                relief.parker.take_nudge();
                if relief.wanted.load(Ordering::SeqCst)
                    || relief.stop.load(Ordering::SeqCst)
                    || self.sleep(&mut turn, &relief.parker, None).is_none()
                {
                    break;
                }
            }
            relief.has_turn.store(false, Ordering::SeqCst);
            drop(turn);
            self.hand_over();
        }
    }
}

impl Known {
    /// Whether anything has come that can be seen without asking the system.
    fn has_come(&self) -> bool {
        self.visible.iter().any(|(_, source)| source.has_come())
    }
}

/// The longest time for which the timer is set.
const LONGEST: Duration = Duration::from_secs(3600);

/// Something that wakes whoever waits at the links: each write to it is an event.
///
/// # Errors
/// What the system says.
pub(crate) fn bell() -> io::Result<OwnedFd> {
    Ok(eventfd(0, EventfdFlags::CLOEXEC | EventfdFlags::NONBLOCK)?)
}

fn read(sources: &RwLock<Sources>) -> std::sync::RwLockReadGuard<'_, Sources> {
    sources.read().unwrap_or_else(PoisonError::into_inner)
}

fn write(sources: &RwLock<Sources>) -> std::sync::RwLockWriteGuard<'_, Sources> {
    sources.write().unwrap_or_else(PoisonError::into_inner)
}

/// A source that is looked at, until this is dropped.
pub(crate) struct Watched {
    lookout: Arc<Lookout>,
    source: Arc<dyn Source>,
    id: u64,
}

impl Watched {
    /// Serves the source now, whatever its file descriptor says.
    pub(crate) fn serve(&self) {
        let happened = Happened {
            came: true,
            room: true,
        };
        let seen = self.source.serve(happened);
        self.lookout.served(self.id, seen, Seen::Nothing);
    }
}

impl Drop for Watched {
    fn drop(&mut self) {
        self.lookout.remove(self.id);
    }
}

#[cfg(test)]
mod tests;
