use ctos::diagnostic::Source;

use super::*;
use crate::simulation::Simulation;

const PERIOD: Duration = Duration::from_micros(4500);

fn cell() -> Cell {
    let text = include_str!("../../../configs/cell.toml");
    Cell::parse(&Source::new("cell.toml", text)).unwrap()
}

fn rig(cell: &Cell) -> (SimArm, Simulation) {
    let port = Arc::new(Port::new(cell));
    let simulation = Simulation::new(cell, Arc::clone(&port));
    let all: Vec<usize> = (0..6).collect();
    let arm = SimArm::new("servo", ("world", &port, cell), 0, &all).unwrap();
    (arm, simulation)
}

fn tick(simulation: &mut Simulation) {
    simulation.tick(PERIOD, 0, Duration::ZERO).unwrap();
}

fn read(arm: &mut SimArm) -> [f64; 6] {
    let mut readings = [SlotReading::default(); 6];
    arm.read(&mut readings).unwrap();
    readings.map(|reading| reading.position)
}

#[test]
fn positions_are_read_back_to_the_nearest_encoder_count() {
    let cell = cell();
    let (mut arm, _simulation) = rig(&cell);
    for (position, start) in read(&mut arm).iter().zip(&cell.arms[0].start) {
        assert!((position - start).abs() <= 0.5 * TAU / COUNTS_PER_TURN);
        let counts = position / TAU * COUNTS_PER_TURN;
        assert!((counts - counts.round()).abs() < 1e-6);
    }
}

#[test]
fn only_released_brakes_let_torques_move_the_arm() {
    let cell = cell();
    let (mut arm, mut simulation) = rig(&cell);
    let start = read(&mut arm);
    let torques = [90.0, 0.0, 0.0, 0.0, 0.0, 0.0];
    for power in [Power::Off, Power::Braked] {
        for _ in 0..20 {
            arm.write(&torques, power, PERIOD).unwrap();
            tick(&mut simulation);
        }
        assert_eq!(read(&mut arm), start);
    }
    let before = simulation.scene();
    for _ in 0..20 {
        arm.write(&torques, Power::Released, PERIOD).unwrap();
        tick(&mut simulation);
    }
    assert!(read(&mut arm)[0] > start[0] + 0.01);
    assert_eq!(arm.tick(), 60);
    let after = simulation.scene();
    assert!((after.lamps[0].centre - before.lamps[0].centre).norm() > 1e-3);
    assert_eq!((before.tick, after.tick), (40, 60));
}

#[test]
fn the_scene_shows_the_lamp_where_the_kinematics_put_it() {
    let cell = cell();
    let (mut arm, mut simulation) = rig(&cell);
    for _ in 0..30 {
        arm.write(&[20.0, 0.0, 5.0, 1.0, 1.0, 1.0], Power::Released, PERIOD)
            .unwrap();
        tick(&mut simulation);
    }
    let expected = cell.scene(&[&read(&mut arm)]);
    let seen = simulation.scene().lamps[0].centre;
    // Read to one count of the encoders, 1e-4 rad, at a reach below 1 m.
    assert!((seen - expected.lamps[0].centre).norm() < 3e-4);
}

#[test]
fn a_torque_that_is_no_number_or_a_wrong_count_is_a_fault_that_names_the_driver() {
    let cell = cell();
    let (mut arm, _simulation) = rig(&cell);
    let error = arm
        .write(&[f64::NAN; 6], Power::Released, PERIOD)
        .unwrap_err();
    assert_eq!(
        error.to_string(),
        "channel driver `servo`: the torque of slot 1 is NaN, not a finite number"
    );
    let error = arm.write(&[0.0; 5], Power::Released, PERIOD).unwrap_err();
    assert!(error.to_string().contains("5 torques for 6 slots"));
    assert!(arm.read(&mut []).is_err());
}

#[test]
fn a_world_that_stands_still_or_begins_again_is_a_fault() {
    let cell = cell();
    let (mut arm, mut simulation) = rig(&cell);
    let mut readings = [SlotReading::default(); 6];
    let step = |arm: &mut SimArm, readings: &mut [SlotReading; 6]| {
        let read = arm.read(readings);
        arm.write(&[0.0; 6], Power::Braked, PERIOD).unwrap();
        read
    };
    // Before its first tick a world may take its time.
    for _ in 0..100 {
        step(&mut arm, &mut readings).unwrap();
    }
    tick(&mut simulation);
    let steps = (0..100)
        .take_while(|_| step(&mut arm, &mut readings).is_ok())
        .count();
    assert!((20..30).contains(&steps), "{steps}");
    let error = step(&mut arm, &mut readings).unwrap_err().to_string();
    assert!(error.contains("world `world` stands still"), "{error}");
    for _ in 0..3 {
        tick(&mut simulation);
    }
    step(&mut arm, &mut readings).unwrap();
    let mut again = Simulation::new(&cell, Arc::clone(&arm.port));
    let error = step(&mut arm, &mut readings).unwrap_err().to_string();
    assert!(error.contains("began again"), "{error}");
    tick(&mut again);
    step(&mut arm, &mut readings).unwrap();
}

#[test]
fn a_world_that_is_lost_tells_its_drivers_why() {
    let text = "[[arm]]\nname = 'cart'\nmodel = 'transporter'\nstart = [0.0, 0.0, 0.0]\n";
    let cell = Cell::parse(&Source::new("cell.toml", text)).unwrap();
    let port = Arc::new(Port::new(&cell));
    let mut simulation = Simulation::new(&cell, Arc::clone(&port));
    let mut arm = SimArm::new("servo", ("world", &port, &cell), 0, &[0, 1, 2]).unwrap();
    tick(&mut simulation);
    arm.write(&[f64::MAX, 0.0, 0.0], Power::Released, PERIOD)
        .unwrap();
    simulation.tick(PERIOD, 0, Duration::ZERO).unwrap_err();
    let mut readings = [SlotReading::default(); 3];
    let error = (0..100).find_map(|_| {
        arm.write(&[0.0; 3], Power::Off, PERIOD).unwrap();
        arm.read(&mut readings).err()
    });
    let error = error.unwrap().to_string();
    assert!(error.contains("arm `cart` is lost"), "{error}");
}
