//! Where channel drivers and their world meet: who drives which joints, and the latest values each way.
//!
//! Both sides find the port by the world's name, whichever is there first. To claim joints takes a lock; to exchange
//! values takes none.

use std::{
    sync::{
        Arc, Mutex, PoisonError,
        atomic::{AtomicU64, Ordering},
    },
    time::Duration,
};

use ctos::Context;
use mcs::driver::Power;

use mcs::latest::Latest;

use crate::{cell::Cell, watched::Watched, wrist::Wrench};

/// The joints that somebody asked for are not to be had.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("joint {} of arm `{arm}` is driven by task `{holder}`; let one of the two drive it", joint + 1)]
pub struct Taken {
    arm: String,
    joint: usize,
    holder: String,
}

/// The port of one world. A chassis holds it, so that it outlives drivers and worlds that are started again.
#[derive(Debug)]
pub struct Port {
    arms: Vec<ArmPort>,
    /// What each sensor reads: at wrists, then of furniture that feels.
    sensors: Vec<Latest>,
    /// Which piece of furniture has cut the power, by number from 1, and with how much force, N; 0 for none.
    cut: Latest,
    /// Whether each laser is lit that an arm carries, 0 or 1.
    lasers: Vec<Latest>,
    /// What those who look on see besides.
    pub(crate) watched: Watched,
    claims: Mutex<Vec<Arc<Claim>>>,
    /// Counts the changes of the claims.
    changes: AtomicU64,
    /// Why the world stands still for good.
    failure: Mutex<Option<String>>,
}

/// One arm, as its world shows it.
#[derive(Debug)]
struct ArmPort {
    name: String,
    joints: usize,
    /// The world's tick, then positions, then speeds.
    state: Latest,
}

/// The joints of one driver.
#[derive(Debug)]
pub struct Claim {
    /// The task that drives them.
    pub driver: String,
    /// The arm, by index in the cell.
    pub arm: usize,
    /// Joints, by index from 0.
    pub joints: Vec<usize>,
    /// Whether torques count (1) or brakes hold (0), the driver's period in s, then the torques.
    command: Latest,
}

impl Port {
    /// The port of the world of task `world`, which holds `cell`, on this chassis.
    #[must_use]
    pub fn of(cx: &Context, world: &str, cell: &Cell) -> Arc<Self> {
        // Of two tasks on two processors, one makes it and the other one finds it.
        static ONE: Mutex<()> = Mutex::new(());
        let _one = ONE.lock().unwrap_or_else(PoisonError::into_inner);
        let key = format!("sim.world.{world}");
        cx.shared(&key).unwrap_or_else(|| {
            let port = Arc::new(Self::new(cell));
            cx.share(&key, Arc::clone(&port));
            port
        })
    }

    /// The port of the world of `cell`: its arms stand at their starts, and nobody drives them.
    #[must_use]
    pub fn new(cell: &Cell) -> Self {
        let arms = cell.arms.iter().map(|arm| ArmPort {
            name: arm.name.clone(),
            joints: arm.start.len(),
            state: Latest::new(
                &[&[0.0], arm.start.as_slice(), &vec![0.0; arm.start.len()]].concat(),
            ),
        });
        Self {
            arms: arms.collect(),
            sensors: (0..cell.sensors.len() + cell.plates.len())
                .map(|_| Latest::new(&[0.0; 6]))
                .collect(),
            cut: Latest::new(&[0.0; 2]),
            lasers: cell.lasers.iter().map(|_| Latest::new(&[0.0])).collect(),
            watched: Watched::new(cell),
            claims: Mutex::new(Vec::new()),
            changes: AtomicU64::new(0),
            failure: Mutex::new(None),
        }
    }

    /// Gives joints of an arm to the task `driver`, whose own earlier claims on them end.
    ///
    /// # Errors
    /// Another task drives one of them.
    pub fn claim(&self, driver: &str, arm: usize, joints: &[usize]) -> Result<Arc<Claim>, Taken> {
        let mut claims = self.claims.lock().unwrap_or_else(PoisonError::into_inner);
        let shares = |claim: &Claim| {
            let mut shared = claim.joints.iter().filter(|joint| joints.contains(joint));
            (claim.arm == arm).then(|| shared.next().copied()).flatten()
        };
        let others = claims.iter().filter(|claim| claim.driver != driver);
        let mut taken = others.filter_map(|claim| Some((shares(claim)?, claim)));
        if let Some((joint, claim)) = taken.next() {
            return Err(Taken {
                arm: self
                    .arms
                    .get(arm)
                    .map_or_else(String::new, |arm| arm.name.clone()),
                joint,
                holder: claim.driver.clone(),
            });
        }
        // A task that is restarted comes back before what it left behind is gone.
        claims.retain(|claim| shares(claim).is_none());
        let claim = Arc::new(Claim {
            driver: driver.to_owned(),
            arm,
            joints: joints.to_vec(),
            command: Latest::new(&vec![0.0; joints.len() + 2]),
        });
        claims.push(Arc::clone(&claim));
        self.changes.fetch_add(1, Ordering::Release);
        Ok(claim)
    }

    /// Takes a claim back: its joints brake.
    pub fn release(&self, claim: &Arc<Claim>) {
        let mut claims = self.claims.lock().unwrap_or_else(PoisonError::into_inner);
        claims.retain(|other| !Arc::ptr_eq(other, claim));
        self.changes.fetch_add(1, Ordering::Release);
    }

    /// All claims, if they have changed since `seen`, and nobody is changing them.
    pub(crate) fn changed_claims(&self, seen: &mut u64) -> Option<Vec<Arc<Claim>>> {
        let changes = self.changes.load(Ordering::Acquire);
        if changes == *seen {
            return None;
        }
        let claims = self.claims.try_lock().ok()?;
        *seen = changes;
        Some(claims.clone())
    }

    /// How many joints an arm has.
    #[must_use]
    pub fn joints(&self, arm: usize) -> usize {
        self.arms.get(arm).map_or(0, |arm| arm.joints)
    }

    /// The world's tick and an arm's positions and speeds, into as many numbers as [`Self::state_length`].
    pub(crate) fn read(&self, arm: usize, state: &mut [f64]) {
        if let Some(arm) = self.arms.get(arm) {
            arm.state.read(state);
        }
    }

    /// Length of an arm's state.
    pub(crate) fn state_length(&self, arm: usize) -> usize {
        1 + 2 * self.joints(arm)
    }

    /// Shows where an arm is after a tick.
    pub(crate) fn show(&self, arm: usize, tick: u64, positions: &[f64], velocities: &[f64]) {
        if let Some(arm) = self.arms.get(arm) {
            let numbers = positions.iter().chain(velocities).copied();
            arm.state.write(std::iter::once(tick as f64).chain(numbers));
        }
    }

    /// What a sensor reads, into six numbers.
    pub(crate) fn sensed(&self, sensor: usize, numbers: &mut [f64]) {
        if let Some(sensor) = self.sensors.get(sensor) {
            sensor.read(numbers);
        }
    }

    /// Shows what a sensor reads after a tick.
    pub(crate) fn show_sensed(&self, sensor: usize, numbers: Wrench) {
        if let Some(sensor) = self.sensors.get(sensor) {
            sensor.write(numbers);
        }
    }

    /// Which plate has cut the power of all arms, by index, and with how much force, N.
    pub(crate) fn cut(&self) -> Option<(usize, f64)> {
        let mut cut = [0.0; 2];
        self.cut.read(&mut cut);
        let [number, force] = cut;
        (number > 0.0).then(|| (number as usize - 1, force))
    }

    /// A plate has cut the power, or it can be had again.
    pub(crate) fn show_cut(&self, cut: Option<(usize, f64)>) {
        let cut = cut.map_or([0.0; 2], |(plate, force)| [plate as f64 + 1.0, force]);
        self.cut.write(cut);
    }

    /// Lights a laser that an arm carries, or puts it out.
    pub(crate) fn shine(&self, laser: usize, lit: f64) {
        if let Some(laser) = self.lasers.get(laser) {
            laser.write([lit]);
        }
    }

    /// Whether a laser that an arm carries is lit.
    pub(crate) fn shines(&self, laser: usize) -> bool {
        let mut lit = [0.0];
        if let Some(laser) = self.lasers.get(laser) {
            laser.read(&mut lit);
        }
        lit[0] > 0.5
    }

    /// The world has failed, and why; or it has begun again.
    pub(crate) fn set_failure(&self, reason: Option<String>) {
        *self.failure.lock().unwrap_or_else(PoisonError::into_inner) = reason;
    }

    /// Why the world has failed.
    pub(crate) fn failure(&self) -> Option<String> {
        let failure = self.failure.lock();
        failure.unwrap_or_else(PoisonError::into_inner).clone()
    }
}

impl Claim {
    /// Says what the joints do from the world's next tick on.
    pub(crate) fn order(&self, torques: &[f64], power: Power, period: Duration) {
        let released = f64::from(u8::from(power == Power::Released));
        let head = [released, period.as_secs_f64()];
        self.command
            .write(head.into_iter().chain(torques.iter().copied()));
    }

    /// What was said last, into `scratch`; its count, whether torques count, and the period, s.
    pub(crate) fn look(&self, scratch: &mut [f64]) -> (u64, bool, f64) {
        let count = self.command.read(scratch);
        match scratch {
            [released, period, ..] => (count, *released == 1.0, *period),
            _ => (count, false, 0.0),
        }
    }
}
