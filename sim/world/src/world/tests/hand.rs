//! What three fingertips hold by friction.

use std::sync::Arc;

use mcs_hand::{fingers::Fingers, grip::GripLaw};
use mcs_servo::{
    Joints,
    control::{ControlLaw as _, PidGravity},
    driver::SlotReading,
    model::{Data, Model, built_in, file::Inertias},
    trajectory::Setpoint,
};

use super::*;

/// The hand straight down, degrees.
const DOWN: [f64; 6] = [0.0, 30.0, -150.0, 0.0, -60.0, 0.0];
/// The fingers around the piece, degrees: spread, near and far of each.
const AROUND: [f64; 3] = [0.0, -20.0, 45.0];
/// How far joint 2 turns to lift what is held, rad; joint 5 turns back by as much. Some 90 mm.
const LIFT: f64 = 0.12;
/// Of the round piece, m.
const RADIUS: f64 = 0.02;
const HEIGHT: f64 = 0.05;
/// Springs of the joints of the fingers, N m/rad.
const SPRING: f64 = 3.0;

/// An arm with a hand, and the laws that move both.
struct Cell {
    world: World,
    model: Model,
    data: Data,
    arm: PidGravity,
    fingers: GripLaw,
    tips: Fingers,
    /// Where all joints shall be.
    to: Vec<f64>,
}

impl Cell {
    /// A piece of so much (kg) stands on a table between the fingertips.
    fn new(mass: f64, surface: f64) -> Self {
        let degrees = DOWN.iter().chain(AROUND.iter().cycle().take(9));
        let start: Vec<String> = degrees.map(|angle| format!("{angle:?}")).collect();
        let arm = format!(
            "[[arm]]\nname = 'puma'\nmodel = 'puma560_hand'\nsurface = {surface:?}\nstart = [{}]\n",
            start.join(", ")
        );
        let mut bare = World::new(&cell(&arm));
        let model = bare.arms[0].model().clone();
        let grasp = bare.arms[0].pose(model.frame("hand.grasp").unwrap());
        let down = grasp.rotation * Vector3::z();
        assert!((down + Vector3::z()).norm() < 1e-9, "{down}");
        let [x, y, z] = grasp.translation.vector.into();
        let table = z - HEIGHT / 2.0;
        let text = format!(
            "{arm}\
             [[object]]\nname = 'piece'\nshape = 'cylinder'\nradius = {RADIUS:?}\nheight = {HEIGHT:?}\nmass = {mass:?}\nfriction = {surface:?}\ngrey = 90\nposition = [{x:?}, {y:?}, {z:?}]\n\
             [[furniture]]\ncentre = [{x:?}, {y:?}, {:?}]\nsize = [0.2, 0.2, 0.1]\ngrey = 40\n",
            table - 0.05
        );
        let hand = Arc::new(built_in::model("hand", Inertias::Engine).unwrap().unwrap());
        let world = World::new(&cell(&text));
        let fingers = GripLaw::new(&hand, 8.0, 1.0).unwrap();
        fingers.grip().set_stiffness(&[SPRING; 9]).unwrap();
        Self {
            to: world.positions(0).to_vec(),
            world,
            data: model.data(),
            arm: PidGravity::new(Arc::new(model.clone()), 8.0, 1.0),
            model,
            fingers,
            tips: Fingers::new(hand).unwrap(),
        }
    }

    fn tick(&mut self) {
        let (q, v) = (self.world.positions(0), self.world.velocities(0));
        let readings = q.iter().zip(v).map(|(position, velocity)| SlotReading {
            position: *position,
            velocity: *velocity,
        });
        let readings: Vec<SlotReading> = readings.collect();
        let mut torques = [0.0; 15];
        let whole = Setpoint::at_rest(self.to.as_slice().try_into().unwrap());
        self.arm.torques(&whole, &readings, PERIOD, &mut torques);
        let fingers = Setpoint::at_rest(self.to[6..].try_into().unwrap());
        self.fingers
            .torques(&fingers, &readings[6..], PERIOD, &mut torques[6..]);
        let weight = self
            .model
            .gravity_torques(&mut self.data, self.world.positions(0));
        for (torque, weight) in torques.iter_mut().zip(weight).skip(6) {
            *torque += weight;
        }
        drive(&mut self.world, &torques);
    }

    /// Moves setpoints on by so much (rad) in so many seconds, gently.
    fn go(&mut self, by: &[f64], seconds: f64) {
        let from = self.to.clone();
        let ticks = (seconds / PERIOD.as_secs_f64()).round();
        for tick in 1..=ticks as usize {
            let t = tick as f64 / ticks;
            let share = t * t * t * (10.0 - 15.0 * t + 6.0 * t * t);
            for (to, (from, by)) in self.to.iter_mut().zip(from.iter().zip(by)) {
                *to = from + share * by;
            }
            self.tick();
        }
    }

    fn wait(&mut self, seconds: f64) {
        self.go(&[0.0; 15], seconds);
    }

    /// Fingertips go inwards until each touches, and then on until its springs press with `force` (N).
    fn close(&mut self, force: f64) {
        let at = Joints::try_from(&self.to[6..]).unwrap();
        let tips = self.tips.tips(&at);
        let mut to = at;
        for finger in 1..=3 {
            let tip = tips[finger - 1];
            let out = Vector3::new(tip.x, tip.y, 0.0).normalize();
            let touching = Point3::new(0.0, 0.0, 0.145) + out * (RADIUS + 0.009);
            to = self.tips.reach(finger, &touching, &to).unwrap();
            let torques = self.tips.torques(finger, &(out * force), &to).unwrap();
            let joints = self.tips.joints(finger).unwrap().to_vec();
            for (joint, torque) in joints.into_iter().zip(torques) {
                to[joint] += torque / SPRING;
            }
        }
        let mut by = vec![0.0; 6];
        by.extend(to.iter().zip(&self.to[6..]).map(|(to, now)| to - now));
        self.go(&by, 0.8);
        self.wait(0.3);
    }

    fn lift(&mut self, sign: f64) {
        let mut by = [0.0; 15];
        (by[1], by[4]) = (sign * LIFT, -sign * LIFT);
        self.go(&by, 1.0);
        self.wait(0.5);
    }

    fn piece(&mut self) -> Isometry3<f64> {
        self.world.scene().body("piece").unwrap().pose
    }

    fn piece_in_hand(&mut self) -> Isometry3<f64> {
        let scene = self.world.scene();
        let pose = |name: &str| scene.body(name).unwrap().pose;
        pose("puma.hand.prism").inverse() * pose("piece")
    }

    /// What presses on each fingertip: across the direction of approach, and along it, N.
    fn felt(&mut self) -> [[f64; 2]; 3] {
        let touches = self.world.touches(0);
        let model = self.model.clone();
        [1, 2, 3].map(|finger| {
            let name = format!("hand.tip{finger}");
            let found = touches.iter().find(|(link, _)| *link == name);
            let force = found.map_or_else(Vector3::zeros, |(_, force)| *force);
            let pose = self.world.arms[0].pose(model.frame(&name).unwrap());
            let force = pose.rotation * force;
            [force.xy().norm(), force.z]
        })
    }
}

#[test]
fn three_fingertips_lift_a_round_piece_and_hold_it_for_seconds() {
    let mut cell = Cell::new(0.1, 0.8);
    let start = cell.piece().translation.vector;
    cell.close(2.0);
    for [across, along] in cell.felt() {
        // Nothing but the sides of the piece is touched: it is pressed inwards, and friction bears a little along it.
        assert!((across - 2.0).abs() < 0.2, "{across} N");
        assert!(along.abs() < 0.5, "{along} N");
    }
    let grasped = cell.piece_in_hand();
    cell.lift(1.0);
    let lifted = cell.piece_in_hand();
    let settled = (lifted.translation.vector - grasped.translation.vector).norm();
    assert!(settled < 1e-3, "{settled} m while it was lifted");
    let high = cell.piece().translation.vector.z - start.z;
    assert!(high > 0.05, "{high}");
    cell.wait(5.0);
    let held = cell.piece_in_hand();
    let slipped = (held.translation.vector - lifted.translation.vector).norm();
    assert!(slipped < 5e-4, "{slipped} m in 5 s");
}

#[test]
fn what_three_fingertips_hold_weighs_on_them() {
    for mass in [0.05, 0.1, 0.2] {
        let mut cell = Cell::new(mass, 0.8);
        cell.close(2.0);
        cell.lift(1.0);
        cell.wait(1.0);
        let felt: f64 = cell.felt().iter().map(|[_, along]| along).sum();
        let expected = -mass * GRAVITY;
        assert!(
            (felt - expected).abs() < 0.02 * mass * GRAVITY,
            "{felt} N of {expected}"
        );
    }
}

#[test]
fn a_piece_that_is_too_heavy_slips_out_of_three_fingertips() {
    // Friction carries 3 x 0.3 x 2 N, which is 0.18 kg.
    let mut cell = Cell::new(0.3, 0.3);
    let start = cell.piece().translation.vector;
    cell.close(2.0);
    cell.lift(1.0);
    let high = cell.piece().translation.vector.z - start.z;
    assert!(high < 5e-3, "{high}");
}
