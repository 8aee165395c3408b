mod wrist;

use ctos::diagnostic::Source;
use mcs::driver::{ChannelDriver, Power, SlotReading};

use super::*;
use crate::driver::SimArm;

const PERIOD: Duration = Duration::from_micros(4500);
const STEP: Duration = Duration::from_micros(1500);

/// Two PUMAs, 2 m apart.
fn pair() -> Cell {
    let arm = |name: &str, y: f64| {
        format!(
            "[[arm]]\nname = '{name}'\nmodel = 'puma560'\nbase = {{ xyz = [0.0, {y:?}, 0.0] }}\nstart = [0.0, 45.0, -90.0, 0.0, 45.0, 0.0]\n"
        )
    };
    let text = arm("left", -1.0) + &arm("right", 1.0);
    Cell::parse(&Source::new("cell.toml", text)).unwrap()
}

struct Rig {
    cell: Cell,
    port: Arc<Port>,
    simulation: Simulation,
}

impl Rig {
    fn new() -> Self {
        let cell = pair();
        let port = Arc::new(Port::new(&cell));
        let simulation = Simulation::new(&cell, Arc::clone(&port));
        Self {
            cell,
            port,
            simulation,
        }
    }

    fn driver(
        &self,
        name: &str,
        arm: usize,
        joints: &[usize],
    ) -> Result<SimArm, crate::port::Taken> {
        SimArm::new(name, ("world", &self.port, &self.cell), arm, joints)
    }

    fn step(&mut self) {
        self.simulation.tick(STEP, 0, Duration::ZERO).unwrap();
    }
}

/// Speed of the first joint of a driver.
fn speed(arm: &mut SimArm) -> f64 {
    let mut readings = vec![SlotReading::default(); arm.slots()];
    arm.read(&mut readings).unwrap();
    readings[0].velocity
}

fn turn(arm: &mut SimArm) {
    // Joint 1 stands upright: gravity takes no part. The others fall within what the test lasts.
    let mut torques = vec![0.0; arm.slots()];
    torques[0] = 20.0;
    arm.write(&torques, Power::Released, PERIOD).unwrap();
}

#[test]
fn a_driver_that_falls_silent_for_three_periods_brakes_its_own_joints_only() {
    let mut rig = Rig::new();
    let mut left = rig.driver("left", 0, &[0]).unwrap();
    let mut right = rig.driver("right", 1, &[0]).unwrap();
    for _ in 0..20 {
        turn(&mut left);
        turn(&mut right);
        (0..3).for_each(|_| rig.step());
    }
    let before = speed(&mut left);
    assert!(before > 0.2, "{before}");
    // Silent, but not yet for so long.
    for _ in 0..6 {
        rig.step();
    }
    assert!(speed(&mut left) > before);
    for _ in 0..60 {
        turn(&mut right);
        (0..3).for_each(|_| rig.step());
    }
    assert_eq!(speed(&mut left), 0.0);
    assert!(speed(&mut right) > before);
    // It comes back.
    for _ in 0..20 {
        turn(&mut left);
        (0..3).for_each(|_| rig.step());
    }
    assert!(speed(&mut left) > 0.2);
}

#[test]
fn a_joint_has_one_driver_and_the_refusal_names_it() {
    let rig = Rig::new();
    let wrist = rig.driver("wrist", 0, &[3, 4, 5]).unwrap();
    let _shoulder = rig.driver("shoulder", 0, &[0, 1, 2]).unwrap();
    let _right = rig.driver("right", 1, &[0, 1, 2, 3, 4, 5]).unwrap();
    let error = rig.driver("second", 0, &[4, 3]).unwrap_err().to_string();
    assert!(
        error.contains("joint 4 of arm `left` is driven by task `wrist`"),
        "{error}"
    );
    drop(wrist);
    rig.driver("second", 0, &[3, 4]).unwrap();
}

#[test]
fn a_task_that_is_started_again_takes_its_joints_over_from_what_it_left_behind() {
    let mut rig = Rig::new();
    let old = rig.driver("servo", 0, &[0]).unwrap();
    let mut new = rig.driver("servo", 0, &[0]).unwrap();
    drop(old);
    for _ in 0..20 {
        turn(&mut new);
        (0..3).for_each(|_| rig.step());
    }
    assert!(speed(&mut new) > 0.2);
}

#[test]
fn joints_whose_driver_is_gone_brake() {
    let mut rig = Rig::new();
    let mut left = rig.driver("left", 0, &[0]).unwrap();
    for _ in 0..20 {
        turn(&mut left);
        (0..3).for_each(|_| rig.step());
    }
    drop(left);
    for _ in 0..60 {
        rig.step();
    }
    let mut next = rig.driver("next", 0, &[0]).unwrap();
    assert_eq!(speed(&mut next), 0.0);
}

#[test]
fn the_order_of_driver_and_world_within_a_moment_changes_nothing_in_their_loop() {
    let run = |world_first: bool| {
        let mut rig = Rig::new();
        let mut arm = rig.driver("servo", 0, &[0, 1, 2, 3, 4, 5]).unwrap();
        let mut seen = Vec::new();
        let mut readings = [SlotReading::default(); 6];
        for moment in 0..50 {
            // At the very first moment the world has nothing to do yet.
            if world_first && moment > 0 {
                rig.simulation.tick(PERIOD, 0, Duration::ZERO).unwrap();
            }
            arm.read(&mut readings).unwrap();
            let torques: Vec<f64> = readings
                .iter()
                .map(|r| 30.0 - 50.0 * r.position - 5.0 * r.velocity)
                .collect();
            arm.write(&torques, Power::Released, PERIOD).unwrap();
            seen.push(readings);
            if !world_first {
                rig.simulation.tick(PERIOD, 0, Duration::ZERO).unwrap();
            }
        }
        seen
    };
    assert_eq!(run(true), run(false));
}

#[test]
fn a_late_world_makes_up_for_what_its_drivers_lived_through_and_no_more() {
    let mut rig = Rig::new();
    let mut arm = rig.driver("servo", 0, &[0]).unwrap();
    let mut gone_on = |rig: &mut Rig, spoken: u32, missed: u64| {
        (0..spoken).for_each(|_| turn(&mut arm));
        let before = rig.simulation.world.elapsed();
        rig.simulation.tick(STEP, missed, Duration::ZERO).unwrap();
        rig.simulation.world.elapsed() - before
    };
    assert_eq!(gone_on(&mut rig, 1, 0), STEP);
    // The world alone was late: by less, and by more, than its driver spoke for.
    assert_eq!(gone_on(&mut rig, 3, 8), 9 * STEP);
    assert_eq!(gone_on(&mut rig, 3, 20), 9 * STEP);
    // Both were.
    assert_eq!(gone_on(&mut rig, 1, 100), 3 * STEP);
    assert_eq!(gone_on(&mut rig, 0, 100), STEP);
}

#[test]
fn a_pointer_shines_along_its_link_while_its_driver_lights_it_and_is_dark_when_that_falls_silent_or_ends()
 {
    let text = "[[arm]]\nname = 'left'\nmodel = 'puma560'\nstart = [0.0, 45.0, -90.0, 0.0, 45.0, 0.0]\n\
        [[laser]]\nname = 'pointer'\narm = 'left'\nlink = 'flange'\nposition = [0.05, 0.0, 0.0]\n\
        look_at = [0.05, 0.0, 1.0]\nup = [1.0, 0.0, 0.0]\nradius = 0.003\nbrightness = 200.0\n";
    let cell = Cell::parse(&Source::new("cell.toml", text)).unwrap();
    let port = Arc::new(Port::new(&cell));
    let mut rig = Rig {
        simulation: Simulation::new(&cell, Arc::clone(&port)),
        cell,
        port,
    };
    let mut arm = rig.driver("arm", 0, &[0, 1, 2, 3, 4, 5]).unwrap();
    arm = arm.lighting(&rig.cell, &[0]);
    let mut drive = |rig: &mut Rig, lit: f64| {
        arm.actuate(&[lit]).unwrap();
        arm.write(&[0.0; 6], Power::Braked, PERIOD).unwrap();
        rig.step();
        rig.simulation.scene().beams
    };
    assert!(drive(&mut rig, 0.0).is_empty());
    let [shines] = &drive(&mut rig, 1.0)[..] else {
        panic!("it is dark");
    };
    let mount = rig.cell.lasers[0].mount.unwrap();
    let flange = rig.simulation.world.link(mount);
    let leaves = flange * nalgebra::Point3::new(0.05, 0.0, 0.0);
    assert!((shines.beam.origin - leaves).norm() < 1e-12);
    assert!((shines.beam.direction.into_inner() - flange * Vector3::z()).norm() < 1e-12);
    // Nobody else orders it.
    assert!(!rig.simulation.order_laser("pointer", LaserOrder::Off));
    for _ in 0..12 {
        rig.step();
    }
    assert!(rig.simulation.scene().beams.is_empty(), "nobody drives it");
    assert_eq!(drive(&mut rig, 1.0).len(), 1);
    drop(arm);
    rig.step();
    assert!(
        rig.simulation.scene().beams.is_empty(),
        "its driver is gone"
    );
}
