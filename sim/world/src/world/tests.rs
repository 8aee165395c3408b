mod contacts;
mod grasp;
mod hand;
mod pads;
mod puma;
mod wrist;

use ctos_config::diagnostic::Source;
use nalgebra::Vector6;

use super::*;

const PERIOD: Duration = Duration::from_micros(4500);
const BENT: [f64; 6] = [0.5, -0.5, 0.5, -0.5, 0.5, -0.5];

fn cell(text: &str) -> Cell {
    Cell::parse(&Source::new("cell.toml", text)).unwrap_or_else(|found| panic!("{found}"))
}

/// One PUMA that starts at `start`, rad.
fn puma(start: [f64; 6], more: &str) -> World {
    let start = start.map(f64::to_degrees);
    let text = format!("[[arm]]\nname = 'puma'\nmodel = 'puma560'\nstart = {start:?}\n{more}");
    World::new(&cell(&text))
}

fn drive(world: &mut World, torques: &[f64]) {
    for (joint, torque) in torques.iter().enumerate() {
        world.command(0, joint, Some(*torque)).unwrap();
    }
    world.advance(PERIOD).unwrap();
}

fn brake(world: &mut World, joints: usize) {
    for joint in 0..joints {
        world.command(0, joint, None).unwrap();
    }
    world.advance(PERIOD).unwrap();
}

/// Torques that make every joint swing, each at its own rate.
fn swing(t: f64) -> Vector6<f64> {
    let amplitude = Vector6::new(12.0, 16.0, 6.0, 1.2, 1.0, 1.0);
    let rate = Vector6::new(3.0, 4.0, 5.0, 6.0, 7.0, 8.0);
    Vector6::from_fn(|i, _| amplitude[i] * (rate[i] * t).cos())
}

/// Torques that hold the arm still, then swing it.
fn sway(t: f64) -> Vector6<f64> {
    puma::hold(&BENT) + swing(t)
}

#[test]
fn the_bodies_stand_where_the_published_kinematics_say() {
    for start in [[0.0; 6], BENT, [-2.0, 1.2, -2.5, 2.0, -1.5, 2.4]] {
        let scene = puma(start, "").scene();
        for (index, expected) in puma::link_poses(&start).iter().enumerate() {
            // Link 5 has no form.
            let Some(body) = scene.body(&format!("puma.link{}", index + 1)) else {
                continue;
            };
            let apart = body.pose.inverse() * expected;
            assert!(apart.translation.vector.norm() < 1e-9);
            assert!(apart.rotation.angle() < 1e-7);
        }
    }
}

#[test]
fn the_published_gravity_torques_hold_the_arm() {
    let mut world = puma(BENT, "");
    let hold = [0.0, 33.404608849, 0.237041794, 0.0, -0.013545114, 0.0];
    for _ in 0..45 {
        drive(&mut world, &hold);
    }
    for (q, start) in world.positions(0).iter().zip(BENT) {
        assert!((q - start).abs() < 1e-8, "moved by {}", q - start);
    }
}

/// Known torques, open loop: the largest difference of a joint in 2 s, rad.
#[test]
fn a_driven_swing_stays_within_a_microradian_of_an_independent_integration_for_2_seconds() {
    let start = [0.5, 0.8, -1.5, 0.5, -0.5, 0.5];
    let mut world = puma(start, "");
    let (mut q, mut qd) = (start, Vector6::zeros());
    let mut worst: f64 = 0.0;
    let mut travel: f64 = 0.0;
    for period in 0..444 {
        // Gravity and a little damping of the reference's own state keep it off the joint limits.
        let tau = puma::hold(&q) + swing(f64::from(period) * 4.5e-3) - qd;
        drive(&mut world, tau.as_slice());
        for _ in 0..9 {
            puma::runge_kutta(&mut q, &mut qd, &tau, 0.5e-3);
        }
        for i in 0..6 {
            worst = worst.max((world.positions(0)[i] - q[i]).abs());
            travel = travel.max((q[i] - start[i]).abs());
            let [low, high] = puma::LIMITS[i].map(f64::to_radians);
            assert!((low..high).contains(&q[i]), "the reference knows no limits");
        }
    }
    assert!(travel > 0.5, "the swing must move the arm: {travel}");
    assert!(worst < 1e-6, "{worst}");
}

#[test]
fn a_rerun_is_bit_identical() {
    let run = || {
        let ball = "friction = true\n[[object]]\nname = 'ball'\nshape = 'sphere'\nradius = 0.1\nmass = 1.0\ngrey = 100\nposition = [0.6, 0.3, 0.9]\n";
        let mut world = puma(BENT, ball);
        for period in 0..200 {
            let tau = sway(f64::from(period) * 4.5e-3);
            drive(&mut world, tau.as_slice());
        }
        brake(&mut world, 6);
        let numbers = [world.positions(0), world.velocities(0)].concat();
        let ball = world.scene().body("ball").unwrap().pose;
        let bits: Vec<u64> = numbers.iter().map(|number| number.to_bits()).collect();
        (bits, ball)
    };
    assert_eq!(run(), run());
}

#[test]
fn brakes_hold_the_arm_without_creep() {
    let start = [0.3, 0.1, -0.2, 0.4, 0.5, 0.6];
    let mut world = puma(start, "");
    let before = world.positions(0).to_vec();
    for _ in 0..444 {
        brake(&mut world, 6);
    }
    assert_eq!(before, world.positions(0));
    assert_eq!([0.0; 6], world.velocities(0));
}

#[test]
fn brakes_stop_a_moving_arm_and_then_hold_it() {
    let mut world = puma([0.3, 0.1, -0.2, 0.4, 0.5, 0.6], "");
    for _ in 0..40 {
        drive(&mut world, &[20.0, 0.0, 0.0, 1.0, 1.0, 1.0]);
    }
    assert!(world.velocities(0)[0] > 0.3);
    let mut periods = 0;
    while world.velocities(0) != [0.0; 6] {
        brake(&mut world, 6);
        periods += 1;
        assert!(periods < 100, "{:?}", world.velocities(0));
    }
    let held = world.positions(0).to_vec();
    for _ in 0..200 {
        brake(&mut world, 6);
    }
    assert_eq!(held, world.positions(0));
}

#[test]
fn a_braked_joint_stands_to_the_bit_while_the_others_move() {
    let mut world = puma(BENT, "");
    let mut torques = puma::hold(&BENT);
    torques[0] = 30.0;
    for _ in 0..100 {
        for joint in 0..6 {
            // The brakes of joints 2 and 3 hold, whatever the others do to them.
            let torque = (joint != 1 && joint != 2).then_some(torques[joint]);
            world.command(0, joint, torque).unwrap();
        }
        world.advance(PERIOD).unwrap();
    }
    assert!(world.positions(0)[0] > BENT[0] + 0.1);
    for joint in [1, 2] {
        assert!((world.positions(0)[joint] - BENT[joint]).abs() < 1e-12);
        assert_eq!(world.velocities(0)[joint], 0.0);
    }
}

#[test]
fn released_brakes_let_the_arm_fall() {
    let mut world = puma([0.0; 6], "");
    brake(&mut world, 6);
    for _ in 0..60 {
        drive(&mut world, &[0.0; 6]);
    }
    assert!(world.positions(0)[1] < -0.1, "{:?}", world.positions(0));
}

#[test]
fn friction_holds_a_torque_below_the_coulomb_limit_and_yields_above_it() {
    // Joint 1 is vertical: no gravity. Its Coulomb friction is 62.6111 * 0.395 = 24.7 N m upwards,
    // 62.6111 * 0.435 = 27.2 N m downwards. Gravity of the others is held by the balance.
    let hold = puma::hold(&[0.0; 6]);
    let travel = |torque: f64| {
        let mut world = puma([0.0; 6], "friction = true");
        let mut tau = hold;
        tau[0] = torque;
        for _ in 0..222 {
            drive(&mut world, tau.as_slice());
        }
        world.positions(0)[0]
    };
    assert_eq!(travel(24.0), 0.0);
    assert_eq!(travel(-26.5), 0.0);
    assert!(travel(25.5) > 1e-2);
    assert!(travel(-28.0) < -1e-2);
}

#[test]
fn a_joint_stops_at_its_limit() {
    let mut world = puma([2.7, 0.0, 0.0, 0.0, 0.0, 0.0], "");
    let mut tau = puma::hold(&[2.7, 0.0, 0.0, 0.0, 0.0, 0.0]);
    tau[0] = 30.0;
    for _ in 0..444 {
        drive(&mut world, tau.as_slice());
    }
    let high = puma::LIMITS[0][1].to_radians();
    assert!((world.positions(0)[0] - high).abs() < 1e-9);
    // And leaves it again.
    tau[0] = -30.0;
    for _ in 0..44 {
        drive(&mut world, tau.as_slice());
    }
    assert!(world.positions(0)[0] < high - 0.05);
}

#[test]
fn a_torque_that_is_no_number_is_refused_by_name_and_moves_nothing() {
    let mut world = puma([0.0; 6], "");
    let error = world.command(0, 1, Some(f64::INFINITY)).unwrap_err();
    assert!(matches!(error, WorldError::Torque { joint: 2, .. }));
    world.advance(PERIOD).unwrap();
    assert_eq!([0.0; 6], world.positions(0));
}

/// A cart that slides along the track: force over mass, and gravity on nothing.
#[test]
fn a_joint_that_slides_is_driven_in_newton() {
    let text = "[[arm]]\nname = 'cart'\nmodel = 'transporter'\nstart = [0.0, 0.0, 0.0]\n";
    let mut world = World::new(&cell(text));
    for _ in 0..100 {
        world.command(0, 0, Some(50.0)).unwrap();
        world.advance(PERIOD).unwrap();
    }
    // 250 kg in all, the other joints braked: x = F t^2 / 2m.
    let expected = 50.0 * 0.45_f64.powi(2) / (2.0 * 250.0);
    let slid = world.positions(0)[0];
    assert!(
        (slid - expected).abs() < 1e-4 * expected,
        "{slid} {expected}"
    );
    assert_eq!(world.positions(0)[1..], [0.0, 0.0]);
}

#[test]
fn a_heavier_arm_than_its_model_sinks_under_the_torques_that_hold_the_model() {
    let sunk = |more: &str| {
        let mut world = puma(BENT, more);
        for _ in 0..45 {
            drive(&mut world, puma::hold(&BENT).as_slice());
        }
        world.positions(0)[1] - BENT[1]
    };
    assert!(sunk("").abs() < 1e-8);
    assert!(sunk("mass_factor = 1.1") < -1e-3);
}

#[test]
fn an_arm_that_is_lost_is_named_and_says_so_at_once() {
    // The track's drive has no limit.
    let text = "[[arm]]\nname = 'cart'\nmodel = 'transporter'\nstart = [0.0, 0.0, 0.0]\n";
    let mut world = World::new(&cell(text));
    world.command(0, 0, Some(f64::MAX)).unwrap();
    let error = world.advance(PERIOD).unwrap_err();
    assert_eq!(
        error.to_string(),
        "arm `cart` is lost: its state is not finite"
    );
    assert_eq!(world.positions(0), [0.0; 3]);
}
