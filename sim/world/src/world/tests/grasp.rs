//! What a gripper holds by friction, and what slips out of it.

use std::sync::Arc;

use mcs_hand::grip::GripLaw;
use mcs_servo::{
    control::{ControlLaw as _, PidGravity},
    driver::SlotReading,
    model::{built_in, file::Inertias},
    trajectory::Setpoint,
};

use super::*;
use crate::wrist::{Electronics, Wrist};

/// The gripper straight down, some 0.75 m before the arm, degrees.
const DOWN: [f64; 6] = [0.0, 30.0, -150.0, 0.0, -60.0, 0.0];
/// How far joint 2 turns to lift what is held, rad; joint 5 turns back by as much. Some 90 mm.
const LIFT: f64 = 0.12;
/// The box between the pads, m.
const SIZE: [f64; 3] = [0.05, 0.04, 0.06];

/// An arm with a gripper, and the laws that move both.
struct Cell {
    world: World,
    arm: PidGravity,
    jaws: GripLaw,
    /// Where all joints shall be.
    to: Vec<f64>,
}

impl Cell {
    /// A box of so much (kg) stands on a table between the open pads, which press with `force` (N).
    fn new(mass: f64, force: f64) -> Self {
        let start = DOWN.map(|angle| format!("{angle:?}")).join(", ");
        let arm = format!(
            "[[arm]]\nname = 'puma'\nmodel = 'puma560_gripper'\nsurface = 0.8\nstart = [{start}, 0.04, 0.04]\n"
        );
        let mut bare = World::new(&cell(&arm));
        let model = bare.arms[0].model().clone();
        let grasp = bare.arms[0].pose(model.frame("gripper.grasp").unwrap());
        let down = grasp.rotation * Vector3::z();
        assert!((down + Vector3::z()).norm() < 1e-9, "{down}");
        let [x, y, z] = grasp.translation.vector.into();
        let table = z - SIZE[2] / 2.0;
        let text = format!(
            "{arm}\
             [[object]]\nname = 'box'\nshape = 'box'\nsize = {SIZE:?}\nmass = {mass:?}\nfriction = 0.8\ngrey = 90\nposition = [{x:?}, {y:?}, {z:?}]\n\
             [[furniture]]\ncentre = [{x:?}, {y:?}, {:?}]\nsize = [0.2, 0.2, 0.1]\ngrey = 40\n\
             [[force_torque]]\nname = 'wrist'\narm = 'puma'\nlink = 'arm.flange'\ncompensates_hand = true\n",
            table - 0.05
        );
        let gripper = built_in::model("gripper", Inertias::Engine);
        let gripper = Arc::new(gripper.unwrap().unwrap());
        let jaws = GripLaw::new(&gripper, 8.0, 1.0).unwrap().coupled();
        jaws.grip().set_force(&[force; 2]).unwrap();
        let world = World::new(&cell(&text));
        Self {
            to: world.positions(0).to_vec(),
            world,
            arm: PidGravity::new(Arc::new(model), 8.0, 1.0),
            jaws,
        }
    }

    fn tick(&mut self) {
        let (q, v) = (self.world.positions(0), self.world.velocities(0));
        let readings = q.iter().zip(v).map(|(position, velocity)| SlotReading {
            position: *position,
            velocity: *velocity,
        });
        let readings: Vec<SlotReading> = readings.collect();
        let mut torques = [0.0; 8];
        let whole = Setpoint::at_rest(self.to.as_slice().try_into().unwrap());
        self.arm.torques(&whole, &readings, PERIOD, &mut torques);
        let jaws = Setpoint::at_rest(self.to[6..].try_into().unwrap());
        self.jaws
            .torques(&jaws, &readings[6..], PERIOD, &mut torques[6..]);
        drive(&mut self.world, &torques);
    }

    /// Moves setpoints on by so much (rad or m) in so many seconds, gently.
    fn go(&mut self, by: [f64; 8], seconds: f64) {
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
        self.go([0.0; 8], seconds);
    }

    fn close(&mut self) {
        self.go([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, -0.04, -0.04], 0.8);
        self.wait(0.3);
    }

    fn lift(&mut self) {
        self.go([0.0, LIFT, 0.0, 0.0, -LIFT, 0.0, 0.0, 0.0], 1.0);
        self.wait(0.5);
    }

    /// How far the pads are apart, m.
    fn opening(&self) -> f64 {
        self.world.positions(0)[6..].iter().sum()
    }

    fn box_in_world(&mut self) -> Isometry3<f64> {
        self.world.scene().body("box").unwrap().pose
    }

    fn box_in_gripper(&mut self) -> Isometry3<f64> {
        let scene = self.world.scene();
        let pose = |name: &str| scene.body(name).unwrap().pose;
        pose("puma.gripper.housing").inverse() * pose("box")
    }

    /// What the sensor between flange and gripper reads of what is held, on the mean over a tenth of a second.
    fn sensed(&mut self) -> [f64; 6] {
        let mut wrist = Wrist::new(Electronics::default());
        let mut sum = [0.0; 6];
        for _ in 0..22 {
            self.tick();
            let (wrench, world, known) = self.world.wrench(0);
            let read = wrist.sample(&wrench, &world, &known, PERIOD);
            for (sum, number) in sum.iter_mut().zip(read) {
                *sum += number / 22.0;
            }
        }
        sum
    }

    /// Forces on the pads along the axis of the jaws, N.
    fn pressed(&mut self) -> [f64; 2] {
        let touches = self.world.touches(0);
        ["left", "right"].map(|side| {
            let name = format!("gripper.jaw_{side}");
            touches.iter().find(|(link, _)| *link == name).unwrap().1.y
        })
    }
}

#[test]
fn a_box_of_half_a_kilogram_is_lifted_slips_by_less_than_a_tenth_of_a_millimetre_in_5_seconds_and_falls_when_let_go()
 {
    let mut cell = Cell::new(0.5, 15.0);
    let start = cell.box_in_world().translation.vector;
    cell.close();
    assert!(
        (cell.opening() - SIZE[1]).abs() < 1e-3,
        "{}",
        cell.opening()
    );
    let [left, right] = cell.pressed();
    for force in [left, -right] {
        assert!((force - 15.0).abs() < 0.03 * 15.0, "{force} N");
    }
    let grasped = cell.box_in_gripper();
    cell.lift();
    let lifted = cell.box_in_gripper();
    let settled = (lifted.translation.vector - grasped.translation.vector).norm();
    cell.wait(5.0);
    let held = cell.box_in_gripper();
    let slipped = (held.translation.vector - lifted.translation.vector).norm();
    let turned = (held.rotation.inverse() * lifted.rotation).angle();
    assert!(settled < 1e-3, "{settled} m while it was lifted");
    assert!(slipped < 1e-4, "{slipped} m in 5 s");
    assert!(turned < 1e-3, "{turned} rad in 5 s");
    let high = cell.box_in_world().translation.vector.z - start.z;
    assert!(high > 0.05, "{high}");
    cell.go([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.04, 0.04], 0.8);
    cell.wait(0.5);
    let rests = cell.box_in_world().translation.vector.z - start.z;
    // It lies on the table again, upright or on a side.
    assert!((-0.011..2e-3).contains(&rests), "{rests}");
}

#[test]
fn a_box_that_is_too_heavy_slips_out_and_the_jaws_close_behind_it() {
    // Friction carries 2 x 0.8 x 15 N, which is 2.4 kg.
    let mut cell = Cell::new(3.5, 15.0);
    let start = cell.box_in_world().translation.vector;
    cell.close();
    assert!(
        (cell.opening() - SIZE[1]).abs() < 1e-3,
        "{}",
        cell.opening()
    );
    cell.lift();
    let high = cell.box_in_world().translation.vector.z - start.z;
    assert!(high < 5e-3, "{high}");
    assert!(cell.opening() < 1e-3, "{}", cell.opening());
}

#[test]
fn what_a_gripper_holds_weighs_on_the_arm() {
    let weigh = |mass: f64| {
        let mut cell = Cell::new(mass, 30.0);
        cell.close();
        cell.lift();
        cell.wait(1.0);
        let torques = cell.pressed();
        let touches = cell.world.touches(0);
        let down: f64 = touches
            .iter()
            .filter(|(link, _)| link.starts_with("gripper.jaw"))
            .map(|(_, force)| force.z)
            .sum();
        assert!(torques[0] > 25.0, "{torques:?}");
        down
    };
    for mass in [0.2, 0.5, 1.5] {
        let found = weigh(mass);
        let expected = mass * GRAVITY;
        assert!(
            (found - expected).abs() < 0.02 * expected,
            "{found} N of {expected}"
        );
    }
}

#[test]
fn the_wrist_feels_the_weight_of_what_jaws_hold_and_how_far_it_is_from_the_sensor() {
    for mass in [0.2, 0.5, 1.5] {
        let mut cell = Cell::new(mass, 30.0);
        cell.close();
        cell.lift();
        // Straight down, and tilted.
        for tilt in [0.0, 0.6] {
            cell.go([0.0, 0.0, 0.0, 0.0, tilt, 0.0, 0.0, 0.0], 1.0);
            cell.wait(1.0);
            let read = cell.sensed();
            let frame = cell.world.arms[0].model().frame("arm.flange").unwrap();
            let flange = cell.world.arms[0].pose(frame);
            let weight = Vector3::new(0.0, 0.0, -mass * GRAVITY);
            let force = flange.rotation * Vector3::new(read[0], read[1], read[2]);
            let off = (force - weight).norm();
            assert!(off < 0.01 * weight.norm(), "{force} of {weight}");
            let way = cell.box_in_world().translation.vector - flange.translation.vector;
            let moment = flange.rotation * Vector3::new(read[3], read[4], read[5]);
            let expected = way.cross(&weight);
            let off = (moment - expected).norm();
            assert!(
                off < 0.01 * way.norm() * weight.norm(),
                "{moment} of {expected}"
            );
        }
    }
}
