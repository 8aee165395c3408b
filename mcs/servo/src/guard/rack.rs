//! The guards of one servo: who is asked in a tick, and how guards get in and out of it without the tick's allocating.

use std::collections::VecDeque;
use std::fmt;
use std::sync::Arc;

use crossbeam_queue::ArrayQueue;

use super::{Guard, GuardReport, Reaction, Seen, Stopping, Words};
use crate::driver::SlotReading;
use crate::joints::Joints;
use crate::model::{Data, Model, Placement};
use crate::trajectory::Setpoint;

/// No servo has more guards than this.
pub const MAX_GUARDS: usize = 32;
/// Changes that may wait for the next tick.
const CHANGES: usize = MAX_GUARDS;
/// After a touch the arm may go back to where it was so long before, s, at the last of so many places at most: there it had
/// not touched anything yet, unless that gave way for as long.
const BEFORE_TOUCH: f64 = 0.25;
const PLACES: usize = 64;

/// Some of the guards of a servo, by slot.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct GuardSet(u32);

impl GuardSet {
    /// The guard in `slot`, below [`MAX_GUARDS`], and those of `self`.
    #[must_use]
    pub fn with(self, slot: usize) -> Self {
        Self(self.0 | 1_u32.checked_shl(slot as u32).unwrap_or_default())
    }

    fn has(self, slot: usize) -> bool {
        self.0.checked_shr(slot as u32).unwrap_or_default() & 1 == 1
    }
}

/// A guard with its recipe's name and what happens when it finds something.
pub struct Mounted {
    name: Words,
    reaction: Reaction,
    always: bool,
    guard: Box<dyn Guard>,
    /// It knows of the motion that is under way.
    begun: bool,
    /// It has found something in this motion.
    told: bool,
}

impl Mounted {
    /// A guard; `always` says whether it watches motions that do not name it.
    #[must_use]
    pub fn new(name: &str, reaction: Reaction, always: bool, guard: Box<dyn Guard>) -> Self {
        Self {
            name: name.into(),
            reaction,
            always,
            guard,
            begun: false,
            told: false,
        }
    }
}

impl fmt::Debug for Mounted {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "guard {}", self.name)
    }
}

/// What is to stand in a slot from the next tick on.
type Change = (usize, Option<Mounted>);

/// The way in and out.
#[derive(Debug, Clone)]
pub(crate) struct RackPort {
    incoming: Arc<ArrayQueue<Change>>,
    /// What was in the way: dropped by whoever mounts the next one, as the tick must not.
    outgoing: Arc<ArrayQueue<Mounted>>,
}

impl RackPort {
    /// Puts a guard into a slot, or takes one out; whether there was room for the order.
    pub fn mount(&self, slot: usize, guard: Option<Mounted>) -> bool {
        // A change puts out one guard at most, and no more changes wait than there is room for what they put out.
        while self.outgoing.pop().is_some() {}
        slot < MAX_GUARDS && self.incoming.push((slot, guard)).is_ok()
    }
}

/// What the servo knows in a tick.
pub(crate) struct Now<'a> {
    pub motion: u64,
    pub setpoint: &'a Setpoint,
    pub readings: &'a [SlotReading],
    pub stopping: &'a Stopping,
    /// Where this is known better than from the joints.
    pub tool_at_rest: Option<Placement>,
    pub force: Option<[f64; 6]>,
    pub period: f64,
}

/// The guards of one servo.
pub(crate) struct Rack {
    model: Arc<Model>,
    /// At the setpoint, and at rest.
    data: [Data; 2],
    slots: [Option<Mounted>; MAX_GUARDS],
    /// Those that motions ordered from now on name,
    named: GuardSet,
    /// and those that the motion under way does.
    holding: GuardSet,
    allowed: Joints,
    /// Where the arm was measured in the latest ticks of the motion, the oldest first.
    measured: VecDeque<Joints>,
    port: RackPort,
}

impl Rack {
    pub fn new(model: Arc<Model>) -> Self {
        let queue = |room| ArrayQueue::new(room);
        Self {
            data: [model.data(), model.data()],
            slots: [const { None }; MAX_GUARDS],
            named: GuardSet::default(),
            holding: GuardSet::default(),
            allowed: Joints::zeros(model.dof()),
            measured: VecDeque::with_capacity(PLACES),
            port: RackPort {
                incoming: Arc::new(queue(CHANGES)),
                outgoing: Arc::new(ArrayQueue::new(2 * CHANGES)),
            },
            model,
        }
    }

    pub fn port(&self) -> RackPort {
        self.port.clone()
    }

    /// Takes the changes that wait.
    pub fn take_in(&mut self) {
        while let Some((slot, guard)) = self.port.incoming.pop() {
            let Some(place) = self.slots.get_mut(slot) else {
                continue;
            };
            if let Some(old) = std::mem::replace(place, guard) {
                // There is room: see `RackPort::mount`.
                let _ = self.port.outgoing.push(old);
            }
        }
    }

    /// Motions ordered from now on name these, besides those that always hold. One that is under way keeps its own.
    pub fn name(&mut self, guards: GuardSet) {
        self.named = guards;
    }

    /// What motions ordered now name.
    pub fn named(&self) -> GuardSet {
        self.named
    }

    /// A motion that named these begins at `start`.
    pub fn begin(&mut self, start: &Joints, guards: GuardSet) {
        self.allowed = *start;
        self.measured.clear();
        self.holding = guards;
        for mounted in self.slots.iter_mut().flatten() {
            mounted.begun = false;
            mounted.told = false;
        }
    }

    /// Keeps where the arm was measured in this tick; the place from which it came `BEFORE_TOUCH` before.
    fn remember(&mut self, now: &Now<'_>) -> Joints {
        let places = ((BEFORE_TOUCH / now.period) as usize).clamp(1, PLACES);
        while self.measured.len() >= places {
            self.measured.pop_front();
        }
        let here = Joints::from_fn(now.readings.len(), |slot| now.readings[slot].position);
        self.measured.push_back(here);
        self.measured.front().copied().unwrap_or(here)
    }

    /// What a guard has found in this tick, and whether it feels a touch; of several the first one that ends the motion. Of a
    /// motion that `settles` only guards that feel a touch are asked.
    pub fn check(&mut self, now: &Now<'_>, settles: bool) -> Option<(GuardReport, bool)> {
        let before = self.remember(now);
        let holding = self.holding;
        let asked = |(slot, mounted): &(usize, &mut Mounted)| {
            let watches = mounted.always || holding.has(*slot);
            watches && !mounted.told && (!settles || mounted.guard.feels())
        };
        let all = self.slots.iter_mut().enumerate();
        let mut all = all
            .filter_map(|(slot, place)| Some((slot, place.as_mut()?)))
            .filter(asked)
            .peekable();
        if all.peek().is_none() {
            self.allowed = now.setpoint.position;
            return None;
        }
        let [data, rest] = &mut self.data;
        let tip = self.model.tip();
        let at_rest = now.stopping.at_rest();
        let seen = Seen {
            model: &self.model,
            tool: self.model.placement(data, &now.setpoint.position, tip),
            tool_at_rest: match now.tool_at_rest {
                Some(there) => there,
                None => self.model.placement(rest, at_rest, tip),
            },
            data,
            setpoint: now.setpoint,
            readings: now.readings,
            stopping: now.stopping,
            force: now.force,
            period: now.period,
        };
        let mut found = None;
        for (_, mounted) in all {
            if !std::mem::replace(&mut mounted.begun, true) {
                mounted.guard.begin(&seen);
            }
            let Some(measured) = mounted.guard.check(&seen) else {
                continue;
            };
            mounted.told = true;
            let feels = mounted.guard.feels();
            let report = GuardReport {
                motion: now.motion,
                guard: mounted.name,
                measured,
                reaction: mounted.reaction,
                // The setpoint is ahead of an arm that touches something, and inside that.
                allowed: if feels { before } else { self.allowed },
            };
            found = Some((report, feels));
            if mounted.reaction != Reaction::Report {
                return found;
            }
        }
        self.allowed = now.setpoint.position;
        found
    }
}
