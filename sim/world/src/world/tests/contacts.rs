//! What touches an arm, and what an arm touches.

use mcs_model::DynamicsOptions;

use super::*;

/// The arm stretched out flat, rad.
const FLAT: [f64; 6] = [0.0, 0.0, -std::f64::consts::FRAC_PI_2, 0.0, 0.0, 0.0];

fn position(world: &mut World, body: &str) -> Vector3<f64> {
    world.scene().body(body).unwrap().pose.translation.vector
}

/// Drives the joints of `driven`, the others braked.
fn drive_some(world: &mut World, driven: &[usize], torques: &[f64]) {
    for (joint, torque) in torques.iter().enumerate() {
        let torque = driven.contains(&joint).then_some(*torque);
        world.command(0, joint, torque).unwrap();
    }
    world.advance(PERIOD).unwrap();
}

#[test]
fn an_arm_that_presses_on_a_table_feels_it_and_stands() {
    let wrist = position(&mut puma(FLAT, ""), "puma.link6");
    // Link 4, a capsule of 42 mm and 60 mm along the forearm, is lowest there.
    let top = wrist.z - 0.042 - 0.02;
    let table = format!(
        "[[furniture]]\ncentre = [{:?}, {:?}, {:?}]\nsize = [0.05, 0.2, 0.1]\ngrey = 40\n",
        wrist.x + 0.025,
        wrist.y,
        top - 0.05
    );
    let run = |table: &str| {
        let mut world = puma(FLAT, table);
        // Joint 2 alone is free, held against gravity where it starts, and pushed down by 20 N m besides.
        let mut torques = puma::hold(&FLAT);
        torques[1] -= 20.0;
        for _ in 0..444 {
            drive_some(&mut world, &[1], torques.as_slice());
        }
        world
    };
    let free = position(&mut run(""), "puma.link6").z;
    assert!(free < top - 0.1, "nothing is in its way: {free}");
    let mut world = run(&table);
    // The lower end of its axis is 30 mm ahead of the wrist.
    let wrist = world.scene().body("puma.link4").unwrap().pose;
    let [one, other] = [-0.03, 0.03].map(|y| (wrist * Point3::new(0.0, y, 0.0)).z);
    let depth = top - (one.min(other) - 0.042);
    assert!(
        (-1e-5..5e-4).contains(&depth),
        "{depth} m deep in the table"
    );
    let speed = world.velocities(0)[1];
    assert!(speed.abs() < 1e-4, "{speed} rad/s");
}

#[test]
fn an_arm_that_carries_a_box_feels_its_weight() {
    // A flat box across the upper arm, which is a capsule of 62 mm 0.235 m beside the shoulder, 0.2 m from joint 2.
    let z = 0.67183 + 0.062 + 0.025;
    let load = format!(
        "[[object]]\nname = 'load'\nshape = 'box'\nsize = [0.2, 0.2, 0.05]\nmass = 2.0\nfriction = 0.9\ngrey = 90\nposition = [0.2, -0.235, {z}]\n"
    );
    let mut world = puma(FLAT, &load);
    let hold = puma::hold(&FLAT)[1];
    let (mut least, mut most) = (f64::INFINITY, f64::NEG_INFINITY);
    for period in 0..444 {
        let (q, v) = (world.positions(0)[1], world.velocities(0)[1]);
        let torque = hold - 4000.0 * q - 300.0 * v;
        let mut torques = [0.0; 6];
        torques[1] = torque;
        drive_some(&mut world, &[1], &torques);
        if period > 222 {
            least = least.min(torque - hold);
            most = most.max(torque - hold);
        }
    }
    let load = position(&mut world, "load");
    let expected = 2.0 * GRAVITY * load.x;
    assert!(
        (load.x - 0.2).abs() < 5e-3 && (load.z - z).abs() < 5e-3,
        "{load}"
    );
    for torque in [least, most] {
        assert!(
            (torque - expected).abs() < 0.01 * expected,
            "{least} to {most} N m, weight {expected}"
        );
    }
}

#[test]
fn what_an_arm_gives_a_ball_it_loses_itself() {
    let wrist = position(&mut puma(FLAT, ""), "puma.link6");
    let (mass, radius) = (1.0, 0.05);
    let ball = format!(
        "[[object]]\nname = 'ball'\nshape = 'sphere'\nradius = {radius}\nmass = {mass}\ngrey = 90\nposition = [{}, {}, {}]\n",
        wrist.x + 0.09,
        wrist.y + 0.07,
        wrist.z
    );
    let mut world = puma(FLAT, &ball);
    let mut torques = puma::hold(&FLAT);
    torques[0] = 90.0;
    let (mut given, mut before) = (0.0, position(&mut world, "ball"));
    let mut ball_speed = Vector3::zeros();
    for _ in 0..30 {
        drive_some(&mut world, &[0], torques.as_slice());
        given += torques[0] * 4.5e-3;
        let now = position(&mut world, "ball");
        (ball_speed, before) = ((now - before) / 4.5e-3, now);
    }
    // Angular momentum about the axis of joint 1: nothing else turns it.
    let mut model_data = world.arms[0].model().data();
    let q = world.positions(0).to_vec();
    let options = DynamicsOptions::WITH_ROTORS;
    let inertia = world.arms[0]
        .model()
        .mass_matrix(&mut model_data, &q, options)[(0, 0)];
    let arm = inertia * world.velocities(0)[0];
    let ball = mass * before.cross(&ball_speed).z;
    assert!(ball > 0.03 * given, "the ball was hit: {ball} of {given}");
    assert!(
        (arm + ball - given).abs() < 0.02 * given,
        "{arm} + {ball} of {given} N m s"
    );
}

#[test]
fn two_arms_that_meet_stop_each_other() {
    let arm = |name: &str, x: f64, y: f64, yaw: f64| {
        format!(
            "[[arm]]\nname = '{name}'\nmodel = 'puma560'\nbase = {{ xyz = [{x:?}, {y:?}, 0.0], rpy = [0.0, 0.0, {yaw:?}] }}\nstart = [0.0, 0.0, -90.0, 0.0, 0.0, 0.0]\n"
        )
    };
    // Stretched out towards each other, their wrists side by side; links 4, of 42 mm, meet after 16 mm or so.
    let one = arm("one", 0.0, 0.0, 0.0);
    let wrist = position(&mut World::new(&cell(&one)), "one.link6");
    let text = one + &arm("other", 2.0 * wrist.x, 2.0 * wrist.y + 0.1, 180.0);
    let mut world = World::new(&cell(&text));
    let push = |world: &mut World, torque: f64| {
        for joint in 0..6 {
            world
                .command(0, joint, (joint == 0).then_some(torque))
                .unwrap();
        }
        world.advance(PERIOD).unwrap();
    };
    for _ in 0..222 {
        push(&mut world, 30.0);
    }
    // The other arm's brakes hold: the first cannot pass.
    assert_eq!(world.positions(1)[0], 0.0);
    let turned = world.positions(0)[0];
    assert!((0.01..0.03).contains(&turned), "{turned} rad");
    assert!(world.velocities(0)[0].abs() < 1e-3);
}

#[test]
fn an_object_comes_to_rest_on_a_table() {
    let text = "[[object]]\nname = 'box'\nshape = 'box'\nsize = [0.1, 0.1, 0.1]\nmass = 2.0\ngrey = 90\nposition = [0.5, 1.0, 0.5]\n\
                [[furniture]]\ncentre = [0.5, 1.0, 0.2]\nsize = [0.4, 0.4, 0.4]\ngrey = 40\n";
    let mut world = puma([0.0; 6], text);
    for _ in 0..444 {
        brake(&mut world, 6);
    }
    let z = position(&mut world, "box").z;
    assert!((z - 0.45).abs() < 1e-3, "{z}");
    assert_eq!(world.positions(0), [0.0; 6]);
}
