//! Soft forms around links, and furniture that feels.

use super::*;

/// The arm stretched out flat, rad.
const FLAT: [f64; 6] = [0.0, 0.0, -std::f64::consts::FRAC_PI_2, 0.0, 0.0, 0.0];

/// A ball of foam about the wrist, and a table 20 mm under it.
fn over_a_table() -> (World, f64) {
    let wrist = puma(FLAT, "").scene();
    let wrist = wrist.body("puma.link6").unwrap().pose.translation.vector;
    let top = wrist.z - 0.1 - 0.02;
    let more = format!(
        "[[arm.pad]]\nlink = 'link6'\nfrom = [0, 0, 0]\nto = [0, 0, 0]\nradius = 0.1\nstiffness = 2000\ndamping = 60\n\
         [[furniture]]\ncentre = [{:?}, {:?}, {:?}]\nsize = [0.1, 0.1, 0.1]\ngrey = 40\nfeels = {{ name = 'table' }}\n",
        wrist.x,
        wrist.y,
        top - 0.05
    );
    (puma(FLAT, &more), top)
}

#[test]
fn a_pad_pushes_back_as_a_spring_and_the_table_feels_the_same_force() {
    let (mut world, top) = over_a_table();
    // Joint 2 alone is free, held against gravity where it starts, and pushed down by 20 N m besides.
    let mut torques = puma::hold(&FLAT);
    torques[1] -= 20.0;
    for _ in 0..600 {
        for (joint, torque) in torques.iter().enumerate() {
            world
                .command(0, joint, (joint == 1).then_some(*torque))
                .unwrap();
        }
        world.advance(PERIOD).unwrap();
    }
    assert!(world.velocities(0)[1].abs() < 1e-3, "it stands");
    let wrist = world
        .scene()
        .body("puma.link6")
        .unwrap()
        .pose
        .translation
        .vector;
    // Of the lever about the shoulder, and of the spring.
    let (lever, spring) = (20.0 / wrist.x, 2000.0 * (top - (wrist.z - 0.1)));
    assert!(
        (spring / lever - 1.0).abs() < 0.03,
        "{spring} N and {lever} N"
    );
    let felt = world.piece(0);
    assert!((felt.z + spring).abs() < 0.02 * spring, "{felt}");
    let touched = world.touches(0);
    let [(link, force)] = &touched[..] else {
        panic!("{touched:?}");
    };
    assert!(link == "link6" && (force.norm() - spring).abs() < 0.02 * spring);
}

#[test]
fn a_pad_that_touches_nothing_changes_nothing() {
    let more = "[[arm.pad]]\nlink = 'link6'\nfrom = [0, 0, 0]\nto = [0, 0, 0.05]\nradius = 0.1\nstiffness = 2000\ndamping = 60\n";
    let [mut with, mut without] = [more, ""].map(|more| puma(BENT, more));
    for step in 0..200 {
        let torques = sway(f64::from(step) * 0.0045);
        drive(&mut with, torques.as_slice());
        drive(&mut without, torques.as_slice());
    }
    assert_eq!(with.positions(0), without.positions(0));
}
