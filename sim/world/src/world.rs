//! The physics of the whole cell: arms, objects and the room.
//!
//! Arms are integrated by their own dynamics (`arm`), all else by Rapier. A driven swing of 2 s ends 1.3 mrad off with
//! Rapier's multibodies, and 1e-10 rad off here. They took 6 times as long for 6 joints, and 10 times for 2 x 9.
//!
//! A link that has a form stands in the engine as a free body of its own, which begins each step where the link is, and as
//! fast. It weighs no more than the arm resists there, so that nothing is stopped too hard. What the step does to its motion,
//! the arm feels as an impulse at its joints. World frame: z up, m, rad, s, N m.
//!
//! A link weighs less in the engine than in truth, and would be dragged along by what hangs on it: what a gripper holds would
//! creep out of it. So a step begins with what the steps before did to a link. The arm has felt it already, and the engine
//! presses the link by as much the other way. Only what changes is left to the link's weight.

mod pads;

use std::time::Duration;

pub use crate::engine::GRAVITY;

use nalgebra::{Isometry3, Point3, Rotation3, Vector3};
use rapier3d_f64::{
    dynamics::{MassProperties, RigidBody, RigidBodyBuilder, RigidBodyHandle},
    geometry::{
        Collider, ColliderBuilder, ColliderHandle, Group, InteractionGroups, InteractionTestMode,
    },
    math::Vector,
    pipeline::PhysicsWorld,
};

use pads::Still;

use crate::{
    arm::{Arm, Lost, Touch},
    cell::{Cell, Mount, Origin},
    engine::{self, isometry, ours, pose, vector},
    hold::Hold,
    scene::SceneState,
    shapes::Shape,
    wrist::{Load, Wrench},
};

/// The longest time step, s; a period of the world is divided into equal steps.
const MAX_STEP: f64 = 1.5e-3;

/// Substeps of the engine per step.
const SUBSTEPS: usize = 4;

/// Natural frequency with which the engine takes solids out of each other, Hz. A link gives way while it is pressed on
/// something: by 1 mm or so under some ten N.
const CONTACT_HZ: f64 = 120.0;

/// Part of what the arm resists with that its link weighs in the engine: half, for a blow off the centre of a link meets
/// the resistance to turning besides.
const SHARE: f64 = 0.5;

/// Sweeps over all contacts in a substep while something hangs on an arm. With one alone, what two jaws hold creeps by
/// 0.15 mm a second; otherwise one is enough.
const HOLDING: usize = 6;

/// Part that the latest step has in what a link is expected to be given by contact.
const LATEST: f64 = 0.5;

/// No link weighs more in the engine, kg and kg m^2.
const HEAVIEST: f64 = 1000.0;

/// Why the world cannot be built or cannot go on.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum WorldError {
    /// A torque is not a finite number.
    #[error("the torque of joint {joint} is {torque}, not a finite number")]
    Torque {
        /// Joint number from 1.
        joint: usize,
        /// The torque, N m or N.
        torque: f64,
    },
    /// The state of an arm is no longer finite.
    #[error("arm `{arm}` is lost: its state is not finite")]
    Arm {
        /// Its name in the cell.
        arm: String,
    },
    /// The state of an object is no longer finite.
    #[error("object `{object}` is lost: its state is not finite")]
    Object {
        /// Its name in the cell.
        object: String,
    },
}

/// A link in the engine.
struct Link {
    mount: Mount,
    body: RigidBodyHandle,
    colliders: Vec<ColliderHandle>,
    /// Its centre of mass there, in the link's frame.
    centre: Point3<f64>,
    /// Mass and inertia that it has now, kg and kg m^2.
    weight: [f64; 2],
    /// How the step began: where the centre was, and how fast it and the link.
    began: (Point3<f64>, Spatial),
    /// What the last step gave it by contact, N s and N m s at its centre; `None` when nothing touched it.
    felt: Option<Spatial>,
    /// What it is expected to be given in this step: the mean of the steps before, the later ones counting more. A blow is
    /// over when the next step begins, so of a contact the first step does not count.
    expected: Spatial,
    /// What contact has given it since the world's last period began, N s.
    pressed: Vector3<f64>,
}

/// A linear and an angular part.
type Spatial = [Vector3<f64>; 2];

const NOTHING: Spatial = [Vector3::new(0.0, 0.0, 0.0); 2];

/// Adds what is at a point to what is about the origin.
fn add_at(sum: &mut Spatial, point: &Point3<f64>, [linear, angular]: Spatial) {
    sum[0] += linear;
    sum[1] += angular + point.coords.cross(&linear);
}

/// What acts on a force-torque sensor.
#[derive(Debug, Clone)]
struct Sensing {
    /// Momentum of what hangs on it, about the world's origin, at the end of the last step.
    momentum: Spatial,
    /// The sum over the steps of the present advance, sensor's frame, and how many there were.
    sum: Wrench,
    steps: u32,
    world: Rotation3<f64>,
    /// What it knows of what hangs on it, sensor's frame.
    known: Load,
}

/// An impulse that the step gave a link: at which point, N s and N m s; world.
struct Blow {
    mount: Mount,
    at: Point3<f64>,
    impulse: Spatial,
}

/// Everything that moves, and what it moves among.
pub struct World {
    cell: Cell,
    arms: Vec<Arm>,
    physics: PhysicsWorld,
    links: Vec<Link>,
    objects: Vec<RigidBodyHandle>,
    /// What never moves, as pads meet it.
    still: Vec<Still>,
    /// Each piece of furniture in the engine, and with what it was pressed since the last period began, N s.
    furniture: Vec<ColliderHandle>,
    pieces: Vec<Vector3<f64>>,
    sensing: Vec<Sensing>,
    /// The hand that holds each arm.
    holds: Vec<Option<Hold>>,
    elapsed: Duration,
    /// How much of it the last period was.
    lasted: Duration,
}

impl std::fmt::Debug for World {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("World")
            .field("elapsed", &self.elapsed)
            .field("arms", &self.arms)
            .finish_non_exhaustive()
    }
}

impl World {
    /// Builds the world with the arms at rest, brakes on.
    #[must_use]
    pub fn new(cell: &Cell) -> Self {
        let mut physics = PhysicsWorld::new();
        physics.gravity = Vector::new(0.0, 0.0, -GRAVITY);
        let parameters = &mut physics.integration_parameters;
        parameters.num_solver_iterations = SUBSTEPS;
        parameters.contact_softness.natural_frequency = CONTACT_HZ;
        parameters.static_contact_softness.natural_frequency = CONTACT_HZ;
        // The engine would keep where two solids touch, and which way, until they have moved by 50 mm: a fingertip then
        // presses on a piece as it stood to it 50 mm before.
        parameters.contact_recycling = false;
        let arms = cell
            .arms
            .iter()
            .map(|arm| Arm::new(arm.model.clone(), &arm.start, arm.friction))
            .collect();
        let mut world = Self {
            cell: cell.clone(),
            arms,
            physics,
            links: Vec::new(),
            objects: Vec::new(),
            holds: vec![None; cell.arms.len()],
            still: Still::all(&cell.room),
            furniture: Vec::new(),
            pieces: vec![Vector3::zeros(); cell.room.len()],
            sensing: vec![
                Sensing {
                    momentum: NOTHING,
                    sum: [0.0; 6],
                    steps: 0,
                    world: Rotation3::identity(),
                    known: Load::default(),
                };
                cell.sensors.len()
            ],
            elapsed: Duration::ZERO,
            lasted: Duration::ZERO,
        };
        world.fill();
        world
    }

    /// The arms, in the cell's order.
    #[must_use]
    pub fn arms(&self) -> usize {
        self.arms.len()
    }

    /// Joint positions of an arm, rad or m; nothing of one that is not there.
    #[must_use]
    pub fn positions(&self, arm: usize) -> &[f64] {
        self.arms.get(arm).map_or(&[], Arm::positions)
    }

    /// Joint speeds of an arm, rad/s or m/s.
    #[must_use]
    pub fn velocities(&self, arm: usize) -> &[f64] {
        self.arms.get(arm).map_or(&[], Arm::velocities)
    }

    /// Simulated time since the beginning.
    #[must_use]
    pub fn elapsed(&self) -> Duration {
        self.elapsed
    }

    /// What a joint (by index from 0) does from now on: its drive gives `torque` (N m or N) within what it can, or, when
    /// there is none, its brake brings it to rest and holds it.
    ///
    /// # Errors
    /// A torque that is not finite; the joint goes on as before.
    pub fn command(
        &mut self,
        arm: usize,
        joint: usize,
        torque: Option<f64>,
    ) -> Result<(), WorldError> {
        if let Some(torque) = torque.filter(|torque| !torque.is_finite()) {
            let joint = joint + 1;
            return Err(WorldError::Torque { joint, torque });
        }
        if let Some(arm) = self.arms.get_mut(arm) {
            arm.command(joint, torque);
        }
        Ok(())
    }

    /// From now on a hand holds a link of an arm, or none does.
    pub fn hold(&mut self, arm: usize, hold: Option<Hold>) {
        if let (Some(own), Some(arm)) = (self.holds.get_mut(arm), self.arms.get_mut(arm)) {
            *own = hold;
            arm.pull(vec![0.0; arm.model().dof()]);
        }
    }

    /// Goes on by `period`.
    ///
    /// # Errors
    /// A state that is no longer finite.
    pub fn advance(&mut self, period: Duration) -> Result<(), WorldError> {
        self.elapsed += period;
        self.lasted = period;
        for link in &mut self.links {
            link.pressed = Vector3::zeros();
        }
        self.pieces.fill(Vector3::zeros());
        // Held arms among still things are a world that stands still.
        let holds = self.holds.iter().any(Option::is_some);
        let still = !holds && self.objects.is_empty() && self.arms.iter().all(Arm::is_held);
        let seconds = period.as_secs_f64();
        for sensing in &mut self.sensing {
            (sensing.sum, sensing.steps) = ([0.0; 6], 0);
        }
        if still || seconds <= 0.0 {
            self.sense(None, &[]);
            return Ok(());
        }
        // The small allowance keeps 4.5 ms at three steps of 1.5 ms whatever the rounding.
        let steps = (seconds / MAX_STEP - 1e-6).ceil().max(1.0);
        for _ in 0..steps as u64 {
            self.step(seconds / steps)?;
        }
        Ok(())
    }

    /// The mean of what acted on a sensor in the last advance, how it stands in the world, and what it knows to hang on
    /// it; forces and places in its frame. Nothing acts on one that is not there.
    #[must_use]
    pub fn wrench(&self, sensor: usize) -> (Wrench, Rotation3<f64>, Load) {
        let Some(sensing) = self.sensing.get(sensor) else {
            return ([0.0; 6], Rotation3::identity(), Load::default());
        };
        let steps = f64::from(sensing.steps.max(1));
        let mean = sensing.sum.map(|sum| sum / steps);
        (mean, sensing.world, sensing.known)
    }

    /// What there is to see; stamp and tick are its caller's.
    #[must_use]
    pub fn scene(&mut self) -> SceneState {
        let (arms, physics, objects) = (&mut self.arms, &self.physics, &self.objects);
        let cell = &self.cell;
        SceneState::of(cell, |origin| match origin {
            Origin::Link(mount) => link_pose(cell, arms, *mount),
            Origin::Object(index) => objects
                .get(*index)
                .and_then(|handle| physics.bodies.get(*handle))
                .map_or_else(Isometry3::identity, |body| isometry(body.position())),
        })
    }

    /// Where a frame of an arm is that carries something, in the world.
    pub fn link(&mut self, mount: Mount) -> Isometry3<f64> {
        link_pose(&self.cell, &mut self.arms, mount)
    }

    /// Puts an object elsewhere, where it is at rest; false when there is none of that name.
    pub fn place(&mut self, name: &str, at: &Isometry3<f64>) -> bool {
        let mut named = self.objects.iter().zip(&self.cell.objects);
        let found = named.find(|(_, spec)| spec.name == name);
        let Some(body) = found.and_then(|(handle, _)| self.physics.bodies.get_mut(*handle)) else {
            return false;
        };
        body.set_position(pose(at), true);
        body.set_linvel(Vector::ZERO, true);
        body.set_angvel(Vector::ZERO, true);
        true
    }

    /// What presses on the links of an arm: the names of their frames, and the mean forces of the last period, N, in the axes
    /// of these frames. Links that nothing touches are left out. An arm that its brakes hold feels nothing.
    pub fn touches(&mut self, arm: usize) -> Vec<(String, Vector3<f64>)> {
        let seconds = self.lasted.as_secs_f64();
        let mut all = Vec::new();
        for link in self.links.iter().filter(|link| link.mount.arm == arm) {
            let pose = link_pose(&self.cell, &mut self.arms, link.mount);
            let force = pose.rotation.inverse() * (link.pressed / seconds);
            if let Some(spec) = self.cell.arms.get(arm)
                && link.pressed != Vector3::zeros()
            {
                all.push((spec.model.at(link.mount.frame).name.clone(), force));
            }
        }
        all
    }

    /// Where the objects are, in the order of the cell's file.
    pub fn objects(&self) -> impl Iterator<Item = Isometry3<f64>> {
        let bodies = self
            .objects
            .iter()
            .map(|handle| self.physics.bodies.get(*handle));
        bodies.map(|body| body.map_or_else(Isometry3::identity, |body| isometry(body.position())))
    }

    /// What touches each link of [`Cell::touchable`]: the middle of the points, m, and the mean force on the link in the last
    /// period, N; world. `None` where nothing does. Of an arm that its brakes hold the force is 0.
    pub fn contacts(&self) -> impl Iterator<Item = Option<(Point3<f64>, Vector3<f64>)>> {
        let seconds = self.lasted.as_secs_f64().max(f64::MIN_POSITIVE);
        self.links.iter().map(move |link| {
            let middle = link.touched_at(&self.physics)?;
            Some((middle, link.pressed / seconds))
        })
    }

    fn step(&mut self, h: f64) -> Result<(), WorldError> {
        let mut blows = self.pull(h);
        let pads = self.press_pads(h, &mut blows);
        let expected = self.expect(h);
        for (index, arm) in self.arms.iter_mut().enumerate() {
            let expected = expected.get(index).and_then(Option::as_ref);
            let pad = pads.get(index).and_then(Option::as_ref);
            let both = match (expected, pad) {
                (Some(expected), Some(pad)) => Some(expected.with(pad)),
                (one, other) => one.or(other).cloned(),
            };
            if arm.predict(h, both.as_ref()).is_err() {
                return Err(self.lost(index));
            }
        }
        self.place_links(h);
        let holds = expected.iter().any(Option::is_some);
        let sweeps = if holds { HOLDING } else { 1 };
        let parameters = &mut self.physics.integration_parameters;
        parameters.num_internal_pgs_iterations = sweeps;
        parameters.num_internal_stabilization_iterations = sweeps;
        parameters.dt = h;
        self.physics.step();
        for (index, (expected, pad)) in expected.iter().zip(&pads).enumerate() {
            let (hangs, pad) = (expected.is_some(), pad.as_ref());
            if self.feel(index, h, hangs, pad, &mut blows).is_err() {
                return Err(self.lost(index));
            }
        }
        self.each_arm(Arm::accept)?;
        self.sense(Some(h), &blows);
        let mut objects = self.objects.iter().zip(&self.cell.objects);
        let lost = objects.find(|(handle, _)| {
            let body = self.physics.bodies.get(**handle);
            !body.is_some_and(|body| body.translation().is_finite() && body.linvel().is_finite())
        });
        match lost {
            Some((_, spec)) => Err(WorldError::Object {
                object: spec.name.clone(),
            }),
            None => Ok(()),
        }
    }

    /// Adds what acts on each sensor at the end of a step of `h` seconds, or in no time: weight and contact of all that
    /// hangs on it, less what becomes its momentum.
    fn sense(&mut self, h: Option<f64>, blows: &[Blow]) {
        let gravity = Vector3::new(0.0, 0.0, -GRAVITY);
        for (sensing, spec) in self.sensing.iter_mut().zip(&self.cell.sensors) {
            let mount = spec.mount;
            let pose = link_pose(&self.cell, &mut self.arms, mount);
            // About the world's origin, of what hangs there and of what touches it.
            let (mut momentum, mut acts) = (NOTHING, NOTHING);
            for (frame, body) in &spec.hanging {
                let mount = Mount {
                    frame: *frame,
                    ..mount
                };
                let pose = link_pose(&self.cell, &mut self.arms, mount);
                let (Some(arm), true) = (self.arms.get_mut(mount.arm), body.mass > 0.0) else {
                    continue;
                };
                let centre = pose * Point3::from(body.centre);
                let [speed, turning] = arm.velocity(*frame, &centre);
                let spin = pose.rotation * (body.inertia * (pose.rotation.inverse() * turning));
                add_at(&mut momentum, &centre, [speed * body.mass, spin]);
                add_at(&mut acts, &centre, [gravity * body.mass, Vector3::zeros()]);
            }
            for blow in blows.iter().filter(|blow| spec.feels(blow.mount)) {
                let force = blow.impulse.map(|part| part / h.unwrap_or(f64::INFINITY));
                add_at(&mut acts, &blow.at, force);
            }
            if let Some(h) = h {
                let gained = momentum.iter().zip(sensing.momentum);
                for (acts, (now, before)) in acts.iter_mut().zip(gained) {
                    *acts -= (now - before) / h;
                }
            }
            sensing.momentum = momentum;
            let [force, moment] = acts;
            let moment = moment - pose.translation.vector.cross(&force);
            let own = [force, moment].map(|part| pose.rotation.inverse() * part);
            let own = own.iter().flat_map(|part| part.iter());
            for (sum, number) in sensing.sum.iter_mut().zip(own) {
                *sum += number;
            }
            (sensing.steps, sensing.world) =
                (sensing.steps + 1, pose.rotation.to_rotation_matrix());
            let known = spec.known.iter().map(|(frame, body)| {
                let mount = Mount {
                    frame: *frame,
                    ..mount
                };
                let there = link_pose(&self.cell, &mut self.arms, mount);
                let centre = pose.inverse() * there * Point3::from(body.centre);
                (body.mass, centre.coords * body.mass)
            });
            let sum = known.fold((0.0, Vector3::zeros()), |sum, own| {
                (sum.0 + own.0, sum.1 + own.1)
            });
            let (mass, moment): (f64, Vector3<f64>) = sum;
            sensing.known = Load {
                mass,
                centre: if mass > 0.0 { moment / mass } else { moment },
            };
        }
    }

    fn each_arm(
        &mut self,
        mut what: impl FnMut(&mut Arm) -> Result<(), Lost>,
    ) -> Result<(), WorldError> {
        let lost = self.arms.iter_mut().position(|arm| what(arm).is_err());
        lost.map_or(Ok(()), |index| Err(self.lost(index)))
    }

    fn lost(&self, arm: usize) -> WorldError {
        let arm = self.cell.arms.get(arm);
        WorldError::Arm {
            arm: arm.map_or_else(String::new, |arm| arm.name.clone()),
        }
    }

    /// What the hands that hold links do to them in a step.
    fn pull(&mut self, h: f64) -> Vec<Blow> {
        let mut blows = Vec::new();
        for index in 0..self.holds.len() {
            let hold = self.holds.get(index).copied().flatten();
            if hold.is_some_and(|hold| hold.is_over()) {
                self.hold(index, None);
            }
        }
        for (index, hold) in self.holds.iter_mut().enumerate() {
            let Some(hold) = hold else { continue };
            let mount = Mount {
                arm: index,
                frame: hold.frame,
            };
            let at = Point3::from(
                link_pose(&self.cell, &mut self.arms, mount)
                    .translation
                    .vector,
            );
            let Some(arm) = self.arms.get_mut(index) else {
                continue;
            };
            let [speed, _] = arm.velocity(hold.frame, &at);
            let force = hold.force(&at, &speed);
            let mut pulled = vec![0.0; arm.model().dof()];
            arm.at_joints(hold.frame, &at, [force, Vector3::zeros()], &mut pulled);
            arm.pull(pulled);
            hold.pass(h);
            let impulse = [force * h, Vector3::zeros()];
            blows.push(Blow { mount, at, impulse });
        }
        blows
    }

    /// What each arm is expected to feel in a step: what its links are.
    fn expect(&mut self, h: f64) -> Vec<Option<Touch>> {
        let mut all: Vec<Option<Touch>> = vec![None; self.arms.len()];
        for link in &mut self.links {
            if link.expected == NOTHING {
                continue;
            }
            let pose = link_pose(&self.cell, &mut self.arms, link.mount);
            let index = link.mount.arm;
            if let (Some(arm), Some(touch)) = (self.arms.get_mut(index), all.get_mut(index)) {
                let touch = touch.get_or_insert_with(|| Touch::none(arm.model().dof()));
                link.add_expected(&(pose * link.centre), h, arm, touch);
            }
        }
        all
    }

    /// Gives an arm what the step did to its links besides what presses on its pads, and adds that to `blows`.
    fn feel(
        &mut self,
        index: usize,
        h: f64,
        expected: bool,
        pad: Option<&Touch>,
        blows: &mut Vec<Blow>,
    ) -> Result<(), Lost> {
        let Some(arm) = self.arms.get_mut(index) else {
            return Ok(());
        };
        let none = Touch::none(arm.model().dof());
        let mut touch = pad.map_or(none, Touch::clone);
        // What hangs on an arm is no wall that stops it.
        touch.by_still = !expected && pad.is_none();
        let mut touched = false;
        for link in self.links.iter_mut().filter(|link| link.mount.arm == index) {
            let before = link.felt.take();
            let by = link.touched_by(&self.physics);
            let (Some(by_still), Some(body)) = (by, self.physics.bodies.get(link.body)) else {
                link.expected = NOTHING;
                continue;
            };
            touched = true;
            touch.by_still &= by_still;
            let felt = link.gained(body, h, arm, &mut touch);
            link.felt = Some(felt);
            for (expected, felt) in link.expected.iter_mut().zip(felt) {
                *expected = match before {
                    Some(_) => *expected + (felt - *expected) * LATEST,
                    None => Vector3::zeros(),
                };
            }
        }
        if !touched && !expected {
            return Ok(());
        }
        let (held, taken) = (arm.is_held(), arm.push(h, &mut touch)?);
        for link in self.links.iter_mut().filter(|link| link.mount.arm == index) {
            let felt = link
                .felt
                .map_or_else(Vector3::zeros, |[force, _]| force * taken);
            link.pressed += felt;
            for (piece, pressed) in self.furniture.iter().zip(&mut self.pieces) {
                if felt != Vector3::zeros() && link.touches(*piece, &self.physics) {
                    *pressed -= felt;
                }
            }
            blows.extend(link.felt.map(|felt| Blow {
                mount: link.mount,
                at: link.began.0,
                impulse: felt.map(|part| part * taken),
            }));
            // A wall does not hang on the arm, nor does anything move one that is held.
            if touch.by_still || held {
                link.felt = None;
                link.expected = NOTHING;
            }
        }
        Ok(())
    }

    /// Puts every link where it is at the beginning of a step, as fast as it is at its end if it is touched as expected.
    fn place_links(&mut self, h: f64) {
        for link in &mut self.links {
            let mount = link.mount;
            let pose = link_pose(&self.cell, &mut self.arms, mount);
            let (Some(arm), Some(body)) = (
                self.arms.get_mut(mount.arm),
                self.physics.bodies.get_mut(link.body),
            ) else {
                continue;
            };
            let centre = pose * link.centre;
            let [linear, angular] = arm.velocity(mount.frame, &centre);
            link.began = (centre, [linear, angular]);
            body.set_position(engine::pose(&pose), true);
            body.set_linvel(vector(&linear), true);
            body.set_angvel(vector(&angular), true);
            // Contact is expected to give this back.
            body.reset_forces(true);
            body.reset_torques(true);
            if !arm.is_held() {
                body.add_force(vector(&(link.expected[0] / -h)), true);
                body.add_torque(vector(&(link.expected[1] / -h)), true);
            }
            // Nothing moves an arm that its brakes hold.
            body.set_dominance_group(i8::from(arm.is_held()));
            let near = link.colliders.iter().any(|collider| {
                let mut pairs = self.physics.narrow_phase.contact_pairs_with(*collider);
                pairs.next().is_some()
            });
            if near && let Some(resistance) = arm.resistance(mount.frame, &centre) {
                link.weigh(resistance, body);
            }
        }
    }

    /// Puts the room, the links and the objects into the engine.
    fn fill(&mut self) {
        let cell = self.cell.clone();
        self.insert_still(&engine::FLOOR, &Isometry3::identity(), ROOM);
        for Shape { solid, .. } in &cell.room {
            let piece = self.insert_still(solid, &Isometry3::identity(), ROOM);
            self.furniture.push(piece);
        }
        for body in &cell.bodies {
            match body.origin {
                Origin::Link(mount) => {
                    let pose = link_pose(&cell, &mut self.arms, mount);
                    let groups = of_arm(mount.arm);
                    if body.still {
                        for Shape { solid, .. } in &body.shapes {
                            self.insert_still(solid, &pose, groups);
                        }
                    } else if body.is_touchable() {
                        self.insert_link(mount, &pose, &body.shapes, groups);
                    }
                }
                Origin::Object(index) => {
                    let Some(object) = cell.objects.get(index) else {
                        continue;
                    };
                    let body = match object.held {
                        // What stands on a kinematic one would be awake with all else that stands there.
                        true => RigidBodyBuilder::fixed(),
                        false => RigidBodyBuilder::dynamic(),
                    };
                    let handle = self.physics.insert_body(body.pose(pose(&object.start)));
                    let collider = collider(&object.shape.solid, ROOM);
                    let collider = collider.mass(object.mass).friction(object.friction);
                    self.physics.insert_collider(collider, Some(handle));
                    self.objects.push(handle);
                }
            }
        }
    }

    fn insert_still(
        &mut self,
        solid: &crate::shapes::Solid,
        at: &Isometry3<f64>,
        groups: InteractionGroups,
    ) -> ColliderHandle {
        let (shape, within) = engine::shape(solid);
        let collider = ColliderBuilder::new(shape)
            .position(pose(&(at * within)))
            .collision_groups(groups);
        self.physics.insert_collider(collider, None)
    }

    fn insert_link(
        &mut self,
        mount: Mount,
        at: &Isometry3<f64>,
        shapes: &[Shape],
        groups: InteractionGroups,
    ) {
        let body = RigidBodyBuilder::dynamic()
            .pose(pose(at))
            .gravity_scale(0.0)
            .can_sleep(false);
        let body = self.physics.insert_body(body);
        let surface = self.cell.arms.get(mount.arm).map_or(0.0, |arm| arm.surface);
        let mut colliders = Vec::new();
        let mut middle = Vector3::zeros();
        for Shape { solid, .. } in shapes {
            let (shape, within) = engine::shape(solid);
            middle += (within * Point3::from(ours(shape.compute_local_aabb().center()))).coords;
            let collider = collider(solid, groups).density(0.0).friction(surface);
            colliders.push(self.physics.insert_collider(collider, Some(body)));
        }
        let centre = Point3::from(middle / shapes.len() as f64);
        let mut link = Link {
            mount,
            body,
            colliders,
            centre,
            weight: [1.0; 2],
            began: (centre, NOTHING),
            felt: None,
            expected: NOTHING,
            pressed: Vector3::zeros(),
        };
        if let (Some(arm), Some(body)) = (
            self.arms.get_mut(mount.arm),
            self.physics.bodies.get_mut(body),
        ) && let Some(resistance) = arm.resistance(mount.frame, &(at * centre))
        {
            link.weigh(resistance, body);
        }
        self.links.push(link);
    }
}

impl Link {
    /// Whether a solid touches it.
    fn touches(&self, other: ColliderHandle, physics: &PhysicsWorld) -> bool {
        self.colliders.iter().any(|own| {
            let pair = physics.narrow_phase.contact_pair(*own, other);
            pair.is_some_and(|pair| pair.has_any_active_contact())
        })
    }

    /// Whether something touches it, and nothing that moves does.
    fn touched_by(&self, physics: &PhysicsWorld) -> Option<bool> {
        let mut still = None;
        for own in &self.colliders {
            for pair in physics.narrow_phase.contact_pairs_with(*own) {
                if pair.has_any_active_contact() {
                    let other = if pair.collider1 == *own {
                        pair.collider2
                    } else {
                        pair.collider1
                    };
                    let parent = physics.colliders.get(other).and_then(Collider::parent);
                    let body = parent.and_then(|body| physics.bodies.get(body));
                    // A held arm has the upper hand.
                    let moves = body.is_some_and(|body| body.dominance_group() == 0);
                    still = Some(still.unwrap_or(true) && !moves);
                }
            }
        }
        still
    }

    /// The middle of the points at which something touches it, m, world.
    fn touched_at(&self, physics: &PhysicsWorld) -> Option<Point3<f64>> {
        let (mut sum, mut count) = (Vector3::zeros(), 0.0);
        for own in &self.colliders {
            let pairs = physics.narrow_phase.contact_pairs_with(*own);
            for pair in pairs.filter(|pair| pair.has_any_active_contact()) {
                let Some(first) = physics.colliders.get(pair.collider1) else {
                    continue;
                };
                let at = isometry(first.position());
                for point in pair
                    .manifolds()
                    .iter()
                    .flat_map(|manifold| &manifold.points)
                {
                    sum += (at * Point3::from(ours(point.local_p1))).coords;
                    count += 1.0;
                }
            }
        }
        (count > 0.0).then(|| Point3::from(sum / count))
    }

    /// Adds what the step gave the link, and how far it moved it beyond its speed; what contact gave it in all.
    fn gained(&self, body: &RigidBody, h: f64, arm: &mut Arm, touch: &mut Touch) -> Spatial {
        let (began, [linear, angular]) = self.began;
        let [mass, inertia] = self.weight;
        let faster = ours(body.linvel()) - linear;
        let turned = ours(body.angvel()) - angular;
        let moved = isometry(body.position()) * self.centre - began - linear * h;
        let more = [faster * mass, turned * inertia];
        touch.work += more[0].dot(&faster) + more[1].dot(&turned);
        let shift = [moved * mass, Vector3::zeros()];
        arm.at_joints(self.mount.frame, &began, more, &mut touch.impulse);
        arm.at_joints(self.mount.frame, &began, shift, &mut touch.shift);
        self.add_expected(&began, h, arm, touch);
        [more[0] + self.expected[0], more[1] + self.expected[1]]
    }

    /// Adds what it is expected to feel; it acts all through the step.
    fn add_expected(&self, centre: &Point3<f64>, h: f64, arm: &mut Arm, touch: &mut Touch) {
        let frame = self.mount.frame;
        let shift = [self.expected[0] * (h / 2.0), Vector3::zeros()];
        arm.at_joints(frame, centre, self.expected, &mut touch.impulse);
        arm.at_joints(frame, centre, shift, &mut touch.shift);
    }

    /// Gives it the weight with which the arm resists at its centre.
    fn weigh(&mut self, resistance: [f64; 2], body: &mut RigidBody) {
        self.weight = resistance.map(|resistance| (SHARE * resistance).min(HEAVIEST));
        let [mass, inertia] = self.weight;
        let properties = MassProperties::new(
            vector(&self.centre.coords),
            mass,
            Vector::new(inertia, inertia, inertia),
        );
        body.set_additional_mass_properties(properties, true);
    }
}

/// Where a frame of an arm stands in the world.
fn link_pose(cell: &Cell, arms: &mut [Arm], mount: Mount) -> Isometry3<f64> {
    match (cell.arms.get(mount.arm), arms.get_mut(mount.arm)) {
        (Some(spec), Some(arm)) => spec.truly(mount.frame, arm.pose(mount.frame)),
        _ => Isometry3::identity(),
    }
}

fn collider(solid: &crate::shapes::Solid, groups: InteractionGroups) -> ColliderBuilder {
    let (shape, within) = engine::shape(solid);
    ColliderBuilder::new(shape)
        .position(pose(&within))
        .collision_groups(groups)
}

/// The room and the objects touch everything.
const ROOM: InteractionGroups =
    InteractionGroups::new(Group::GROUP_32, Group::ALL, InteractionTestMode::And);

/// An arm touches everything but itself; of very many arms, some do not touch each other.
fn of_arm(arm: usize) -> InteractionGroups {
    let own = Group::from_bits_truncate(1 << (arm % 31));
    InteractionGroups::new(own, Group::ALL.difference(own), InteractionTestMode::And)
}

#[cfg(test)]
mod tests;
