//! The world with its port: one tick takes what the drivers said last, goes on, and shows where the arms are.
//!
//! Knows no task. Ticks of a driver and of its world that fall on the same moment may come in either order: in the loop of
//! both, a torque counts from the state that it was computed from, as long as the order stays the same.

use std::{sync::Arc, time::Duration};

use nalgebra::{Isometry3, Point3, Vector3};

use crate::{
    cell::{Cell, LaserSpec, Mount, PlateSpec},
    hold::Hold,
    port::{Claim, Port},
    scene::{self, CameraFault, LaserOrder, SceneBeam, SceneState},
    world::{World, WorldError},
    wrist::Wrist,
};

/// A driver that has said nothing for so many of its periods is silent, and its joints brake.
const SILENCE: f64 = 3.0;

/// No tick makes up for more: drivers have given a world up that stood still for longer.
const LONGEST: Duration = Duration::from_millis(100);

/// What furniture feels is low-passed with this time constant, s, before it cuts the power.
const FEELS: f64 = 0.005;

/// Power that was cut cannot be had again for so long, s.
const CUT: f64 = 0.5;

/// A driver, as the world sees it.
#[derive(Debug)]
struct Driver {
    claim: Arc<Claim>,
    /// How often it has spoken.
    count: u64,
    /// For how long it has not, s of the world's time.
    silent: f64,
    brakes: bool,
    scratch: Vec<f64>,
}

/// A world that goes on by itself.
#[derive(Debug)]
pub struct Simulation {
    world: World,
    port: Arc<Port>,
    changes: u64,
    drivers: Vec<Driver>,
    lamps: Vec<bool>,
    /// How light it is in the room; 1 is as the cell has it.
    light: f64,
    camera_faults: Vec<Option<CameraFault>>,
    lasers: Vec<(LaserSpec, LaserOrder)>,
    wrists: Vec<Wrist>,
    /// Furniture that feels, and what it felt of late, N.
    plates: Vec<(PlateSpec, Vector3<f64>)>,
    /// Which of it has cut the power, with how much force, N, and how long ago, s.
    cut: Option<(usize, f64, f64)>,
    /// Whether nothing moves by itself.
    still: bool,
    tick: u64,
    stamp: Duration,
}

impl Simulation {
    /// The world of `cell` at its start, shown at `port`.
    #[must_use]
    pub fn new(cell: &Cell, port: Arc<Port>) -> Self {
        let mut simulation = Self {
            world: World::new(cell),
            port,
            changes: 0,
            drivers: Vec::new(),
            lamps: cell.lamps.iter().map(|lamp| lamp.on).collect(),
            light: 1.0,
            camera_faults: vec![None; cell.cameras.len()],
            lasers: cell
                .lasers
                .iter()
                .map(|laser| (laser.clone(), LaserOrder::Off))
                .collect(),
            wrists: cell
                .sensors
                .iter()
                .map(|sensor| Wrist::new(sensor.electronics.clone()))
                .collect(),
            plates: cell
                .plates
                .iter()
                .map(|plate| (plate.clone(), Vector3::zeros()))
                .collect(),
            cut: None,
            still: false,
            tick: 0,
            stamp: Duration::ZERO,
        };
        simulation.port.set_failure(None);
        simulation.port.show_cut(None);
        simulation.show();
        // What is still is felt before the first tick.
        if simulation.world.advance(Duration::ZERO).is_ok() {
            simulation.feel(Duration::ZERO);
        }
        simulation
    }

    /// The same world, in which nothing moves by itself if `still`: objects stay where they are put.
    #[must_use]
    pub fn still(mut self, still: bool) -> Self {
        self.still = still;
        self
    }

    /// What there is to see since the last tick. Lamps count at once, also while the world stands still.
    #[must_use]
    pub fn scene(&mut self) -> SceneState {
        let mut scene = self.world.scene();
        for (lamp, on) in scene.lamps.iter_mut().zip(&self.lamps) {
            lamp.on = *on;
        }
        SceneState {
            camera_faults: self.camera_faults.clone(),
            beams: self.beams(),
            stamp: self.stamp,
            tick: self.tick,
            light: self.light,
            ..scene
        }
    }

    /// What shines: scanners as they were told, and pointers of arms as their drivers light them. A driver that is silent lights
    /// nothing.
    fn beams(&mut self) -> Vec<SceneBeam> {
        let mut beams = Vec::new();
        for (index, (spec, order)) in self.lasers.iter().enumerate() {
            let Some(mount) = spec.mount else {
                beams.extend(scene::beams(*order, spec));
                continue;
            };
            let mut drivers = self.drivers.iter();
            let silent = drivers.any(|driver| driver.brakes && driver.claim.arm == mount.arm);
            if self.port.shines(index) && !silent {
                let mut there = spec.clone();
                let scanner = &mut there.scanner;
                scanner.world_t_scanner = self.world.link(mount) * scanner.world_t_scanner;
                beams.extend(scene::beams(LaserOrder::Spot([0.0; 2]), &there));
            }
        }
        beams
    }

    /// What pressed on the links of an arm in the last tick: the names of their frames, and the forces, N, in their axes.
    /// Links that nothing touched are left out.
    pub fn touches(&mut self, arm: usize) -> Vec<(String, Vector3<f64>)> {
        self.world.touches(arm)
    }

    /// Switches the lamp called `name`; every lamp when there is no name. False when there is none to switch.
    pub fn switch(&mut self, name: Option<&str>, on: bool, cell: &Cell) -> bool {
        let mut any = false;
        for (lamp, spec) in self.lamps.iter_mut().zip(&cell.lamps) {
            if name.is_none_or(|name| name == spec.name) {
                *lamp = on;
                any = true;
            }
        }
        any
    }

    /// From now on it is so light in the room; 1 is as the cell has it.
    pub fn lighten(&mut self, share: f64) {
        self.light = share;
    }

    /// Puts an object elsewhere, at rest. False when there is no such object.
    pub fn place(&mut self, name: &str, at: &Isometry3<f64>) -> bool {
        self.world.place(name, at)
    }

    /// From now on a hand holds a link of an arm.
    pub fn hold(&mut self, arm: usize, hold: Hold) {
        self.world.hold(arm, Some(hold));
    }

    /// From now on no hand holds the arm.
    pub fn let_go(&mut self, arm: usize) {
        self.world.hold(arm, None);
    }

    /// Where a frame of an arm is, m in the world.
    pub fn place_of(&mut self, mount: Mount) -> Point3<f64> {
        self.world.link(mount).translation.vector.into()
    }

    /// From now on a laser does that. False when there is no such laser in the room.
    pub fn order_laser(&mut self, name: &str, order: LaserOrder) -> bool {
        let mut lasers = self.lasers.iter_mut();
        let found = lasers.find(|(spec, _)| spec.name == name && spec.mount.is_none());
        found.map(|(_, own)| *own = order).is_some()
    }

    /// From now on a camera has that fault, or none. False when there is no such camera.
    pub fn fail_camera(&mut self, name: &str, fault: Option<CameraFault>, cell: &Cell) -> bool {
        let mut cameras = self.camera_faults.iter_mut().zip(&cell.cameras);
        let found = cameras.find(|(_, spec)| spec.truth.name == name);
        found.map(|(own, _)| *own = fault).is_some()
    }

    /// Goes on by `period`, and makes up for the ticks that were `missed` before it as far as a driver has spoken
    /// meanwhile: a world that stood still together with its drivers goes on with them. It is `now` by the app's clock.
    ///
    /// # Errors
    /// The world cannot go on; its drivers are told, too.
    pub fn tick(&mut self, period: Duration, missed: u64, now: Duration) -> Result<(), WorldError> {
        let gone_on = self.listen(period).and_then(|heard| {
            if self.still {
                return Ok(());
            }
            let missed = period * u32::try_from(missed).unwrap_or(u32::MAX);
            let made_up = missed.min(heard.saturating_sub(period)).min(LONGEST);
            self.world.advance(period + made_up)
        });
        if let Err(error) = gone_on {
            self.port.set_failure(Some(error.to_string()));
            return Err(error);
        }
        self.tick += 1;
        self.stamp = now;
        self.feel(period);
        self.show();
        Ok(())
    }

    /// Takes what the drivers said last; for how long one of them has spoken since the tick before.
    fn listen(&mut self, period: Duration) -> Result<Duration, WorldError> {
        if let Some(claims) = self.port.changed_claims(&mut self.changes) {
            self.attach(claims)?;
        }
        let (mut heard, mut wanted): (f64, bool) = (0.0, false);
        for driver in &mut self.drivers {
            let claim = &driver.claim;
            let (count, released, own_period) = claim.look(&mut driver.scratch);
            heard = heard.max(count.saturating_sub(driver.count) as f64 * own_period);
            if count == driver.count {
                driver.silent += period.as_secs_f64();
            } else {
                (driver.count, driver.silent) = (count, 0.0);
            }
            let silent = driver.silent > SILENCE * own_period;
            if silent && released && !driver.brakes {
                tracing::warn!(driver = %claim.driver, "silent for three periods: its joints brake");
            }
            driver.brakes = silent;
            wanted |= released;
            let released = released && self.cut.is_none();
            let torques = driver.scratch.iter().skip(2);
            for (joint, torque) in claim.joints.iter().zip(torques) {
                let torque = (released && !silent).then_some(*torque);
                self.world.command(claim.arm, *joint, torque)?;
            }
        }
        // As with a contactor: power comes back to those who had let go of it.
        if let Some((plate, _, since)) = &mut self.cut {
            *since += period.as_secs_f64();
            let felt = self.plates.get(*plate);
            let presses = felt.is_some_and(|(spec, felt)| felt.norm() > spec.cuts_n);
            if *since > CUT && !wanted && !presses {
                self.cut = None;
            }
        }
        // A driver that was here before its world has spoken for long: no tick was missed then.
        Ok(Duration::try_from_secs_f64(heard).unwrap_or(Duration::ZERO))
    }

    /// Joints that nobody drives any more brake; whoever drove before still does, and is as silent as it was.
    fn attach(&mut self, claims: Vec<Arc<Claim>>) -> Result<(), WorldError> {
        for arm in 0..self.world.arms() {
            for joint in 0..self.port.joints(arm) {
                self.world.command(arm, joint, None)?;
            }
        }
        let mut before = std::mem::take(&mut self.drivers);
        for claim in claims {
            let known = before
                .iter()
                .position(|driver| Arc::ptr_eq(&driver.claim, &claim));
            self.drivers.push(match known {
                Some(known) => before.swap_remove(known),
                None => Driver {
                    scratch: vec![0.0; claim.joints.len() + 2],
                    claim,
                    count: 0,
                    silent: 0.0,
                    brakes: false,
                },
            });
        }
        Ok(())
    }

    /// Samples the sensors, `period` after the time before.
    fn feel(&mut self, period: Duration) {
        for (sensor, wrist) in self.wrists.iter_mut().enumerate() {
            let (wrench, world, known) = self.world.wrench(sensor);
            let read = wrist.sample(&wrench, &world, &known, period);
            self.port.show_sensed(sensor, read);
        }
        let share = 1.0 - (-period.as_secs_f64() / FEELS).exp();
        for (plate, (spec, felt)) in self.plates.iter_mut().enumerate() {
            let pressed = self.world.piece(spec.piece);
            *felt += (pressed - *felt) * share;
            if felt.norm() > spec.cuts_n && self.cut.is_none() {
                tracing::warn!(plate = %spec.name, force = felt.norm(), "it cuts the power of all arms");
                self.cut = Some((plate, felt.norm(), 0.0));
            }
            let [x, y, z] = (*felt).into();
            let sensor = self.wrists.len() + plate;
            self.port.show_sensed(sensor, [x, y, z, 0.0, 0.0, 0.0]);
        }
        let cut = self.cut.map(|(plate, force, _)| (plate, force));
        self.port.show_cut(cut);
    }

    fn show(&self) {
        for arm in 0..self.world.arms() {
            let (positions, velocities) = (self.world.positions(arm), self.world.velocities(arm));
            self.port.show(arm, self.tick, positions, velocities);
        }
        self.port.watched.show(self.tick, &self.world);
    }
}

#[cfg(test)]
mod tests;
