//! What a force-torque sensor reads of known weights.

use std::sync::Arc;

use mcs_servo::{
    Joints,
    control::{ControlLaw, PidGravity},
    driver::SlotReading,
    trajectory::Setpoint,
};

use super::*;
use crate::wrist::{Electronics, Wrist};

#[test]
fn a_braked_arm_with_nothing_on_it_reads_its_load_from_the_start() {
    let sensor = "[[force_torque]]\nname = 'wrist'\narm = 'puma'\nload = { mass = 3.0, centre = [0.0, 0.0, 0.0] }\n";
    let mut world = puma([0.0; 6], sensor);
    brake(&mut world, 6);
    let (wrench, ..) = world.wrench(0);
    assert!((wrench[2] + 3.0 * GRAVITY).abs() < 1e-9, "{wrench:?}");
    assert_eq!(world.wrench(1).0, [0.0; 6]);
}

/// A PUMA with the three-fingered hand and a sensor between them; its joints at the start, rad.
fn with_hand(start: [f64; 15], more: &str) -> World {
    let degrees = start.map(f64::to_degrees);
    World::new(&cell(&format!(
        "[[arm]]\nname = 'puma'\nmodel = 'puma560_hand'\nsurface = 0.8\nstart = {degrees:?}\n\
         [[force_torque]]\nname = 'wrist'\narm = 'puma'\nlink = 'arm.flange'\n{more}"
    )))
}

/// Six joints of the arm, then the fingers straight.
fn straight(arm: [f64; 6]) -> [f64; 15] {
    std::array::from_fn(|joint| arm.get(joint).copied().unwrap_or(0.0))
}

fn vectors([fx, fy, fz, mx, my, mz]: [f64; 6]) -> [Vector3<f64>; 2] {
    [Vector3::new(fx, fy, fz), Vector3::new(mx, my, mz)]
}

#[test]
fn a_hand_weighs_on_the_wrist_in_every_pose_and_is_taken_off_where_it_is_known() {
    // The hand as one body, as `puma560_carrying_hand.toml` has it: 0.9 kg and three fingers of 0.09 kg.
    let mass = 1.17;
    let middle = Vector3::new(0.0, 0.0, 0.05418 / mass);
    // Finger 1 bent inwards by a quarter turn where it begins: its two parts lie across.
    let parts = [(0.04, 0.03), (0.03, 0.082)];
    let lies = parts.map(|(mass, way)| Vector3::new(-way, 0.0, -way) * mass);
    let bent = middle + (lies[0] + lies[1]) / mass;
    for arm in [
        [0.0; 6],
        BENT,
        [0.4, -0.3, 0.2, 1.0, 1.3, -0.7],
        [0.0, 0.5, -2.6, 0.0, -1.0, 2.0],
    ] {
        for (near, centre) in [(0.0, middle), (std::f64::consts::FRAC_PI_2, bent)] {
            let mut start = straight(arm);
            start[7] = near;
            let mut world = with_hand(start, "compensates_hand = true\n");
            brake(&mut world, 15);
            let (wrench, stands, known) = world.wrench(0);
            let down = stands.inverse() * Vector3::new(0.0, 0.0, -mass * GRAVITY);
            let [force, moment] = vectors(wrench);
            assert!((force - down).norm() < 1e-9, "{force} of {down}");
            let expected = centre.cross(&down);
            assert!((moment - expected).norm() < 1e-9, "{moment} of {expected}");
            let mut wrist = Wrist::new(Electronics::default());
            let read = wrist.sample(&wrench, &stands, &known, PERIOD);
            assert!(read.iter().all(|number| number.abs() < 1e-9), "{read:?}");
        }
    }
}

#[test]
fn what_hangs_on_the_wrist_resists_when_the_arm_speeds_up() {
    // Stretched out to the side; only joint 1 is free, which stands upright.
    let arm = [0.0, 0.3, -1.2, 0.4, 0.9, 0.2];
    let mut world = with_hand(straight(arm), "");
    let mass = 1.17;
    let inertia = Vector3::new(2.79e-3, 2.79e-3, 1.86e-3);
    for _ in 0..40 {
        let before = world.velocities(0)[0];
        for joint in 0..15 {
            world
                .command(0, joint, (joint == 0).then_some(40.0))
                .unwrap();
        }
        world.advance(PERIOD).unwrap();
        let rate = (world.velocities(0)[0] - before) / PERIOD.as_secs_f64();
        let speed = 0.5 * (world.velocities(0)[0] + before);
        let (wrench, stands, _) = world.wrench(0);
        let frame = world.arms[0].model().frame("arm.flange").unwrap();
        let flange = world.arms[0].pose(frame).translation.vector;
        let [force, moment] = vectors(wrench).map(|part| stands * part);
        let up = Vector3::z();
        let way = stands * Vector3::new(0.0, 0.0, 0.05418 / mass);
        let centre = flange + way;
        let gained =
            up.cross(&centre) * rate - Vector3::new(centre.x, centre.y, 0.0) * (speed * speed);
        let expected = (up * -GRAVITY - gained) * mass;
        let off = (force - expected).norm();
        assert!(off < 0.01 * expected.norm(), "{force} of {expected}");
        let resists =
            |about: Vector3<f64>| stands * inertia.component_mul(&(stands.inverse() * about));
        let turned = resists(up * rate) + (up * speed).cross(&resists(up * speed));
        let expected = way.cross(&expected) - turned;
        let off = (moment - expected).norm();
        assert!(off < 0.01 * expected.norm(), "{moment} of {expected}");
    }
    assert!(world.velocities(0)[0] > 0.5);
}

#[test]
fn a_plate_that_lies_on_fingertips_pushes_on_the_wrist_as_it_weighs_and_where_it_lies() {
    // The hand upright, its fingertips 40 mm from its axis; the middle of the plate is not above it.
    let mass = 0.3;
    let bare = with_hand(straight([0.0; 6]), "").scene();
    let tip = bare.body("puma.hand.tip1").unwrap().pose.translation.vector;
    let (x, y, z) = (tip.x - 0.04 + 0.008, tip.y - 0.005, tip.z + 0.009 + 0.005);
    let plate = format!(
        "compensates_hand = true\n[[object]]\nname = 'plate'\nshape = 'box'\nsize = [0.14, 0.14, 0.01]\nmass = {mass:?}\nfriction = 0.8\ngrey = 90\nposition = [{x:?}, {y:?}, {z:?}]\n"
    );
    let mut world = with_hand(straight([0.0; 6]), &plate);
    let model = world.arms[0].model().clone();
    let mut law = PidGravity::new(Arc::new(model.clone()), 8.0, 1.0);
    let to = Setpoint::at_rest(Joints::from(straight([0.0; 6])));
    let mut wrist = Wrist::new(Electronics::default());
    let mut sum = [0.0; 6];
    for tick in 0..666 {
        let (q, v) = (world.positions(0), world.velocities(0));
        let readings = q.iter().zip(v).map(|(position, velocity)| SlotReading {
            position: *position,
            velocity: *velocity,
        });
        let readings: Vec<SlotReading> = readings.collect();
        let mut torques = [0.0; 15];
        law.torques(&to, &readings, PERIOD, &mut torques);
        drive(&mut world, &torques);
        let (wrench, stands, known) = world.wrench(0);
        let read = wrist.sample(&wrench, &stands, &known, PERIOD);
        if tick >= 444 {
            for (sum, number) in sum.iter_mut().zip(read) {
                *sum += number / 222.0;
            }
        }
    }
    let flange = world.arms[0].pose(model.frame("arm.flange").unwrap());
    let [force, moment] = vectors(sum).map(|part| flange.rotation * part);
    let weight = Vector3::new(0.0, 0.0, -mass * GRAVITY);
    let off = (force - weight).norm();
    assert!(off < 0.01 * weight.norm(), "{force} of {weight}");
    let plate = world.scene().body("plate").unwrap().pose.translation.vector;
    let way = plate - flange.translation.vector;
    let expected = way.cross(&weight);
    let off = (moment - expected).norm();
    assert!(expected.norm() > 0.02, "{expected}");
    assert!(off < 0.02 * expected.norm(), "{moment} of {expected}");
}
