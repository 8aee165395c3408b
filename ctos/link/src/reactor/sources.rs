//! The links of a chassis as the reactor polls them: which there are, and what the system says of them.
//! Also what they say of themselves in shared memory.
//!
//! Knows links as [`Source`]s of a file descriptor each, and no thread: who polls is decided above.

use std::{
    collections::BTreeMap,
    io,
    os::fd::{AsRawFd, BorrowedFd, OwnedFd},
    sync::{
        Arc, PoisonError, RwLock, RwLockReadGuard, RwLockWriteGuard,
        atomic::{AtomicU64, AtomicUsize, Ordering},
    },
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

use crate::time::{Clock, Instant};

/// How many events are taken at a time.
const EVENTS: usize = 32;

/// How often a thread may find work in shared memory before it looks at the sockets.
pub(super) const LOOKS_PER_POLL: u32 = 16;

/// What wakes the leader.
pub(super) const WAKER: Token = Token(0);

/// What ends its sleep in time.
pub(super) const TIMER: Token = Token(1);

/// The longest time for which the timer is set.
const LONGEST: Duration = Duration::from_secs(3600);

/// What a source had.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Seen {
    /// Nothing for a task.
    Nothing,
    /// Frames, which were handed on.
    Frames,
    /// The same, and there may be more: it is to be told again.
    More,
    /// It is over, and the reactor need not look at it again.
    End,
}

/// What has happened to a source. It is told once: a source reads until nothing is left, or says
/// that there may be more.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Happened {
    /// It may be readable.
    pub readable: bool,
    /// The other end has closed: behind what has come stands the end.
    pub closed: bool,
    /// It may be writable again.
    pub writable: bool,
}

/// One end of a link, as the reactor sees it.
pub trait Source: Send + Sync {
    /// Reads what there is and hands it on; writes what had to wait.
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

type Map = BTreeMap<usize, Arc<dyn Source>>;

/// The sources of a reactor, known to the system.
pub(super) struct Sources {
    clock: Clock,
    registry: Registry,
    waker: Waker,
    timer: OwnedFd,
    next: AtomicUsize,
    map: RwLock<Map>,
    /// Counts the changes of the map.
    version: AtomicU64,
}

/// What polls them: for one thread at a time.
pub(super) struct Poller {
    poll: Poll,
    pub(super) events: Events,
    /// How often in a row it was enough to look at the memory.
    pub(super) looked: u32,
    /// When the timer rings, if it is set.
    rings_at: Option<Instant>,
    /// The sources in shared memory, so that looking at them takes no lock, and of which version they are.
    pub(super) visible: Vec<(usize, Arc<dyn Source>)>,
    version: u64,
    /// There are other sources, of which the system must be asked.
    pub(super) has_sockets: bool,
}

impl Sources {
    /// No sources yet, and what polls them.
    ///
    /// # Errors
    /// What the system says.
    pub(super) fn new(clock: Clock) -> io::Result<(Self, Poller)> {
        let poll = Poll::new()?;
        let registry = poll.registry().try_clone()?;
        let waker = Waker::new(&registry, WAKER)?;
        let timer_flags = TimerfdFlags::CLOEXEC | TimerfdFlags::NONBLOCK;
        let timer = timerfd_create(TimerfdClockId::Monotonic, timer_flags)?;
        registry.register(&mut SourceFd(&timer.as_raw_fd()), TIMER, Interest::READABLE)?;
        let sources = Self {
            clock,
            registry,
            waker,
            timer,
            next: AtomicUsize::new(TIMER.0 + 1),
            map: RwLock::default(),
            version: AtomicU64::new(0),
        };
        let poller = Poller {
            poll,
            events: Events::with_capacity(EVENTS),
            looked: 0,
            rings_at: None,
            visible: Vec::new(),
            version: 0,
            has_sockets: false,
        };
        Ok((sources, poller))
    }

    /// Polls a source; its number.
    ///
    /// # Errors
    /// What the system says.
    pub(super) fn add(&self, source: Arc<dyn Source>) -> io::Result<usize> {
        let id = self.next.fetch_add(1, Ordering::Relaxed);
        self.write().insert(id, source.clone());
        self.version.fetch_add(1, Ordering::Release);
        let (fd, interest) = (source.fd().as_raw_fd(), interest(&*source));
        let registered = self
            .registry
            .register(&mut SourceFd(&fd), Token(id), interest);
        if registered.is_err() {
            self.remove(id);
        }
        // A leader that looks at the memory already must see this one too.
        self.wake();
        registered.map(|()| id)
    }

    /// Polls it no longer.
    pub(super) fn remove(&self, id: usize) {
        let removed = self.write().remove(&id);
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

    /// Wakes the polling thread.
    pub(super) fn wake(&self) {
        // It can only fail when the system is out of memory for it.
        let _ = self.waker.wake();
    }

    /// Whether anything has come that can be seen without asking the system.
    pub(super) fn has_come(&self) -> bool {
        self.read().values().any(has_come)
    }

    /// Looks which sources there are, if that has changed.
    pub(super) fn refresh(&self, poller: &mut Poller) {
        let version = self.version.load(Ordering::Acquire);
        if poller.version == version {
            return;
        }
        // What changes meanwhile makes another version.
        poller.version = version;
        let sources = self.read();
        let visible = sources
            .iter()
            .filter(|(_, source)| source.visible().is_some());
        poller.visible = visible.map(|(id, source)| (*id, source.clone())).collect();
        poller.has_sockets = poller.visible.len() < sources.len();
    }

    /// Hands on what has come through shared memory.
    pub(super) fn serve_visible(&self, poller: &Poller) -> Seen {
        let mut seen = Seen::Nothing;
        let happened = Happened {
            readable: true,
            closed: false,
            writable: false,
        };
        for (id, source) in poller.visible.iter().filter(|(_, source)| has_come(source)) {
            seen = self.served(*id, source.serve(happened), seen);
        }
        seen
    }

    /// What `id` had, together with what others had.
    pub(super) fn served(&self, id: usize, seen: Seen, before: Seen) -> Seen {
        match seen {
            Seen::Nothing => before,
            Seen::Frames => Seen::Frames,
            Seen::More => {
                if let Some(source) = self.read().get(&id) {
                    let (fd, interest) = (source.fd().as_raw_fd(), interest(&**source));
                    let (mut fd, registry) = (SourceFd(&fd), &self.registry);
                    // What is there already happens once more.
                    if let Err(error) = registry.reregister(&mut fd, Token(id), interest) {
                        tracing::error!(%error, "a link is no longer read");
                    }
                }
                Seen::Frames
            }
            Seen::End => {
                self.remove(id);
                before
            }
        }
    }

    /// Hands on what has come where something has happened; what that was, together with `before`.
    pub(super) fn serve_events(&self, poller: &mut Poller, before: Seen) -> Seen {
        let mut seen = before;
        for event in &poller.events {
            match event.token() {
                WAKER => {}
                TIMER => poller.rings_at = None,
                Token(id) => {
                    let happened = Happened {
                        readable: event.is_readable() || event.is_read_closed() || event.is_error(),
                        closed: event.is_read_closed() || event.is_error(),
                        writable: event.is_writable(),
                    };
                    let source = self.read().get(&id).cloned();
                    if let Some(source) = source {
                        seen = self.served(id, source.serve(happened), seen);
                    }
                }
            }
        }
        seen
    }

    /// Waits for what happens, at most until `deadline`.
    pub(super) fn poll(
        &self,
        poller: &mut Poller,
        at_once: bool,
        deadline: Option<Instant>,
    ) -> io::Result<()> {
        if !at_once && let Some(deadline) = deadline {
            self.ring_by(poller, deadline)?;
        }
        let Poller { poll, events, .. } = poller;
        match poll.poll(events, at_once.then_some(Duration::ZERO)) {
            Err(error) if error.kind() == io::ErrorKind::Interrupted => {
                events.clear();
                Ok(())
            }
            polled => polled,
        }
    }

    /// Lets the timer ring at `deadline`, or before: a time-out of the poll itself is a whole number of
    /// milliseconds. A timer that rings sooner is left alone. Each call has a deadline a little later than the
    /// call before it. To set the timer for each would cost more than one ring in vain.
    fn ring_by(&self, poller: &mut Poller, deadline: Instant) -> io::Result<()> {
        if poller.rings_at.is_some_and(|at| at <= deadline) {
            return Ok(());
        }
        // Zero would switch it off.
        let left = deadline.since(self.clock.now());
        let left = left.clamp(Duration::from_nanos(1), LONGEST);
        let once = Itimerspec {
            it_interval: Timespec {
                tv_sec: 0,
                tv_nsec: 0,
            },
            it_value: Timespec::try_from(left).map_err(io::Error::other)?,
        };
        timerfd_settime(&self.timer, TimerfdTimerFlags::empty(), &once)?;
        poller.rings_at = Some(deadline);
        Ok(())
    }

    fn read(&self) -> RwLockReadGuard<'_, Map> {
        self.map.read().unwrap_or_else(PoisonError::into_inner)
    }

    fn write(&self) -> RwLockWriteGuard<'_, Map> {
        self.map.write().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Poller {
    /// Whether anything has come that can be seen without asking the system.
    pub(super) fn has_come(&self) -> bool {
        self.visible.iter().any(|(_, source)| has_come(source))
    }

    /// Whether their file descriptors must say when something comes.
    pub(super) fn set_asleep(&self, asleep: bool) {
        let sources = self.visible.iter();
        for visible in sources.filter_map(|(_, source)| source.visible()) {
            visible.set_asleep(asleep);
        }
    }
}

/// The events that the system reports of a source. A bell only rings. The first event of a socket, that it is
/// writable, makes it write what was posted before.
fn interest(source: &dyn Source) -> Interest {
    match source.visible() {
        Some(_) => Interest::READABLE,
        None => Interest::READABLE | Interest::WRITABLE,
    }
}

fn has_come(source: &Arc<dyn Source>) -> bool {
    source.visible().is_some_and(Visible::has_come)
}
