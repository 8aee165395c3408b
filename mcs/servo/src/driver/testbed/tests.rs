//! Joints, sensors and faults of several drivers that are one.

use super::*;
use crate::driver::SensorKind;

/// Joints that read as `at` and sensors whose numbers count up from `at`; it may be broken.
struct Part {
    at: f64,
    joints: usize,
    sensors: Vec<Sensor>,
    broken: bool,
    silent: Duration,
    written: std::sync::Arc<std::sync::Mutex<Vec<f64>>>,
}

impl Part {
    fn new(at: f64, joints: usize, sensors: &[(&str, SensorKind)]) -> Self {
        let named = |(name, kind): &(&str, SensorKind)| Sensor {
            name: (*name).to_owned(),
            kind: *kind,
        };
        Self {
            at,
            joints,
            sensors: sensors.iter().map(named).collect(),
            broken: false,
            silent: Duration::ZERO,
            written: std::sync::Arc::default(),
        }
    }

    fn broken(mut self) -> Self {
        self.broken = true;
        self
    }

    fn failure(&self) -> DriverError {
        DriverError::Fault {
            driver: format!("part {}", self.at),
            reason: "cable out".to_owned(),
        }
    }

    fn outcome(&self) -> Result<(), DriverError> {
        match self.broken {
            true => Err(self.failure()),
            false => Ok(()),
        }
    }
}

impl ChannelDriver for Part {
    fn slots(&self) -> usize {
        self.joints
    }

    fn read(&mut self, readings: &mut [SlotReading]) -> Result<(), DriverError> {
        assert_eq!(readings.len(), self.joints);
        readings.fill(SlotReading {
            position: self.at,
            velocity: -self.at,
        });
        self.outcome()
    }

    fn silence(&self, slot: usize) -> Option<(Duration, DriverError)> {
        assert!(slot < self.joints);
        (!self.silent.is_zero()).then(|| (self.silent, self.failure()))
    }

    fn sensors(&self) -> &[Sensor] {
        &self.sensors
    }

    fn sense(&mut self, numbers: &mut [f64]) -> Result<(), DriverError> {
        let width: usize = self.sensors.iter().map(|one| one.kind.width()).sum();
        assert_eq!(numbers.len(), width);
        for (index, number) in numbers.iter_mut().enumerate() {
            *number = self.at + index as f64;
        }
        self.outcome()
    }

    fn write(&mut self, torques: &[f64], _: Power, _: Duration) -> Result<(), DriverError> {
        *self.written.lock().unwrap() = torques.to_vec();
        self.outcome()
    }
}

fn testbed(parts: Vec<Part>) -> Testbed {
    let boxed = parts
        .into_iter()
        .map(|part| Box::new(part) as Box<dyn ChannelDriver>);
    Testbed::new(boxed.collect())
}

/// An arm with a wrist sensor and a switch, a lamp's switch without joints, and a cart with a sensor of its own.
fn parts() -> Vec<Part> {
    vec![
        Part::new(
            100.0,
            2,
            &[
                ("wrist", SensorKind::ForceTorque),
                ("limit", SensorKind::DigitalInput),
            ],
        ),
        Part::new(200.0, 0, &[("door", SensorKind::DigitalInput)]),
        Part::new(300.0, 1, &[]),
        Part::new(400.0, 3, &[("second", SensorKind::ForceTorque)]),
    ]
}

#[test]
fn the_sensors_of_several_drivers_stand_one_after_the_other_each_with_its_own_numbers() {
    let mut testbed = testbed(parts());
    let names: Vec<_> = testbed
        .sensors()
        .iter()
        .map(|sensor| sensor.name.as_str())
        .collect();
    assert_eq!(names, ["wrist", "limit", "door", "second"]);
    let mut numbers = [0.0; 14];
    testbed.sense(&mut numbers).unwrap();
    let expected = [
        100.0, 101.0, 102.0, 103.0, 104.0, 105.0, 106.0, 200.0, 400.0, 401.0, 402.0, 403.0, 404.0,
        405.0,
    ];
    assert_eq!(numbers, expected);
    assert_eq!(testbed.slots(), 6);
    let mut readings = [SlotReading::default(); 6];
    testbed.read(&mut readings).unwrap();
    let positions = readings.map(|reading| reading.position);
    assert_eq!(positions, [100.0, 100.0, 300.0, 400.0, 400.0, 400.0]);
    assert!(
        readings
            .iter()
            .all(|reading| reading.velocity == -reading.position)
    );
}

#[test]
fn one_driver_that_fails_is_named_and_the_others_are_read_and_written_all_the_same() {
    let mut parts = parts();
    parts[0] = Part::new(
        100.0,
        2,
        &[
            ("wrist", SensorKind::ForceTorque),
            ("limit", SensorKind::DigitalInput),
        ],
    )
    .broken();
    let written: Vec<_> = parts.iter().map(|part| part.written.clone()).collect();
    let mut testbed = testbed(parts);
    let mut numbers = [0.0; 14];
    let failed = testbed.sense(&mut numbers).unwrap_err();
    assert_eq!(failed.to_string(), "channel driver `part 100`: cable out");
    assert_eq!((numbers[7], numbers[13]), (200.0, 405.0));
    let mut readings = [SlotReading::default(); 6];
    assert!(testbed.read(&mut readings).is_err());
    assert_eq!(readings[5].position, 400.0);
    let period = Duration::from_millis(4);
    let torques = [1.0, 2.0, 3.0, 4.0, 5.0, 6.0];
    assert!(testbed.write(&torques, Power::Off, period).is_err());
    let written: Vec<_> = written
        .iter()
        .map(|one| one.lock().unwrap().clone())
        .collect();
    assert_eq!(
        written,
        [vec![1.0, 2.0], vec![], vec![3.0], vec![4.0, 5.0, 6.0]]
    );
    let wrong = testbed
        .write(&torques[..5], Power::Off, period)
        .unwrap_err();
    assert!(
        wrong.to_string().contains("5 commands for 6 slots"),
        "{wrong}"
    );
}

#[test]
fn whose_silence_keeps_a_joint_from_being_read_is_asked_of_that_joints_own_driver() {
    let mut quiet = Part::new(20.0, 3, &[]);
    quiet.silent = Duration::from_millis(50);
    let testbed = testbed(vec![
        Part::new(10.0, 2, &[]),
        quiet,
        Part::new(30.0, 1, &[]),
    ]);
    for slot in 0..7 {
        let expected = (2..5).contains(&slot);
        match testbed.silence(slot) {
            Some((silent, error)) => {
                assert!(expected && silent == Duration::from_millis(50), "{slot}");
                assert!(error.to_string().contains("part 20"), "{error}");
            }
            None => assert!(!expected, "{slot}"),
        }
    }
}
