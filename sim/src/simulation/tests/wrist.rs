//! What a force-torque sensor reads of known weights while a servo's law holds the arm.

use mcs::{
    Joints,
    control::{ControlLaw, PidGravity},
    model::{built_in, file::Inertias},
    trajectory::Setpoint,
};

use super::*;

/// m/s^2.
const GRAVITY: f64 = 9.81;

/// The simulation of a cell with one PUMA at `start` (rad), held by a servo's law, and what its sensor reads on the mean
/// over a second after `settled` s.
fn held(start: [f64; 6], more: &str, settled: f64) -> [f64; 6] {
    let degrees = start.map(f64::to_degrees);
    let text = format!("[[arm]]\nname = 'puma'\nmodel = 'puma560'\nstart = {degrees:?}\n{more}");
    let cell = Cell::parse(&Source::new("cell.toml", text)).unwrap();
    let port = Arc::new(Port::new(&cell));
    let mut simulation = Simulation::new(&cell, Arc::clone(&port));
    let arm = SimArm::new("servo", ("world", &port, &cell), 0, &[0, 1, 2, 3, 4, 5]).unwrap();
    let mut arm = arm.sensing(&cell, &[0]);
    let model = built_in::model("puma560", Inertias::Engine)
        .unwrap()
        .unwrap();
    let mut law = PidGravity::new(Arc::new(model), 8.0, 1.0);
    let setpoint = Setpoint::at_rest(Joints::from(start));
    let mut readings = [SlotReading::default(); 6];
    let (mut sum, mut count) = ([0.0; 6], 0.0);
    let ticks = |seconds: f64| (seconds / PERIOD.as_secs_f64()) as u32;
    for tick in 0..ticks(settled + 1.0) {
        arm.read(&mut readings).unwrap();
        let mut sensed = [0.0; 6];
        arm.sense(&mut sensed).unwrap();
        if tick >= ticks(settled) {
            count += 1.0;
            for (sum, number) in sum.iter_mut().zip(sensed) {
                *sum += number;
            }
        }
        let mut torques = [0.0; 6];
        law.torques(&setpoint, &readings, PERIOD, &mut torques);
        arm.write(&torques, Power::Released, PERIOD).unwrap();
        simulation.tick(PERIOD, 0, Duration::ZERO).unwrap();
    }
    sum.map(|sum| sum / count)
}

#[test]
fn what_hangs_on_a_held_arm_reads_as_its_weight_within_a_hundredth() {
    // 2 kg, 0.1 m before the sensor, of which 1.5 kg are known.
    let sensor = "[[force_torque]]\nname = 'wrist'\narm = 'puma'\nlink = 'link6'\nload = { mass = 2.0, centre = [0.0, 0.0, 0.1] }\n\
                  compensates = { mass = 1.5, centre = [0.0, 0.0, 0.1] }\nnoise = [0.1, 0.005]\nfilter_hz = 20.0\n";
    let weight = 0.5 * GRAVITY;
    let read = held([0.0; 6], sensor, 2.0);
    // Frame 6 stands as the world does.
    assert!((read[2] + weight).abs() < 0.01 * weight, "{read:?}");
    assert!(read[0].abs() < 0.05 && read[1].abs() < 0.05, "{read:?}");
    // Turned over by a quarter: the weight is across, and turns at 0.1 m.
    let read = held(
        [0.0, 0.0, 0.0, 0.0, std::f64::consts::FRAC_PI_2, 0.0],
        sensor,
        2.0,
    );
    let across = read[0].hypot(read[1]);
    assert!((across - weight).abs() < 0.01 * weight, "{read:?}");
    let moment = read[3].hypot(read[4]);
    assert!(
        (moment - 0.1 * weight).abs() < 0.02 * 0.1 * weight,
        "{read:?}"
    );
}

#[test]
fn a_box_on_a_tray_reads_as_its_weight_within_a_hundredth() {
    let tray = "[[arm.capsule]]\nlink = 'link6'\nfrom = [-0.1, 0.06, 0.12]\nto = [0.1, 0.06, 0.12]\nradius = 0.02\ngrey = 50\n\
                [[arm.capsule]]\nlink = 'link6'\nfrom = [-0.1, -0.06, 0.12]\nto = [0.1, -0.06, 0.12]\nradius = 0.02\ngrey = 50\n\
                [[force_torque]]\nname = 'wrist'\narm = 'puma'\n\
                [[object]]\nname = 'box'\nshape = 'box'\nsize = [0.16, 0.2, 0.05]\nmass = 1.5\ngrey = 90\n\
                position = [0.4521, -0.15005, 1.26963]\n";
    let read = held([0.0; 6], tray, 3.0);
    let weight = 1.5 * GRAVITY;
    assert!(
        (read[2] + weight).abs() < 0.01 * weight,
        "{read:?} {weight}"
    );
    assert!(
        read[0].abs() < 0.01 * weight && read[1].abs() < 0.01 * weight,
        "{read:?}"
    );
}
