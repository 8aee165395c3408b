//! Slots that are no joints: inputs that grow too old, outputs that are set.

use std::sync::Mutex;

use super::*;
use crate::driver::{Sensor, SensorKind};
use crate::servo::stream::{Following, Newest, Source, Stream, StreamKind};

/// Ages of a switch and of a space mouse, whether that reads no number, and what a lamp and a laser were set to.
#[derive(Default)]
struct Bench {
    ages: [f64; 2],
    no_number: bool,
    set: Vec<f64>,
}

struct Beside(TestArm, Vec<Sensor>, Arc<Mutex<Bench>>);

impl ChannelDriver for Beside {
    fn slots(&self) -> usize {
        self.0.slots()
    }

    fn read(&mut self, readings: &mut [SlotReading]) -> Result<(), DriverError> {
        self.0.read(readings)
    }

    fn sensors(&self) -> &[Sensor] {
        &self.1
    }

    fn sense(&mut self, numbers: &mut [f64]) -> Result<(), DriverError> {
        numbers.copy_from_slice(&[1.0, 9.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 9.0]);
        if self.2.lock().unwrap().no_number {
            numbers[5] = f64::NAN;
        }
        Ok(())
    }

    fn ages(&mut self, ages: &mut [f64]) {
        let [switch, mouse] = self.2.lock().unwrap().ages;
        // Of outputs it does not matter.
        ages.copy_from_slice(&[switch, 99.0, mouse, f64::NAN]);
    }

    fn actuate(&mut self, numbers: &[f64]) -> Result<(), DriverError> {
        self.2.lock().unwrap().set = numbers.to_vec();
        Ok(())
    }

    fn write(
        &mut self,
        torques: &[f64],
        power: Power,
        period: Duration,
    ) -> Result<(), DriverError> {
        self.0.write(torques, power, period)
    }
}

fn rig() -> (Rig, Arc<Mutex<Bench>>) {
    let model = Arc::new(built_in_arm("puma560"));
    let (knobs, bench) = (Arc::new(Knobs::default()), Arc::<Mutex<Bench>>::default());
    let arm = TestArm::new(built_in_arm("puma560"), &START, false, &knobs);
    let kinds = [
        ("door", SensorKind::DigitalInput),
        ("lamp", SensorKind::Lamp),
        ("mouse", SensorKind::SpaceMouse),
        ("pointer", SensorKind::Laser),
    ];
    let named = kinds.map(|(name, kind)| Sensor {
        name: name.to_owned(),
        kind,
    });
    let driver = Beside(arm, named.to_vec(), Arc::clone(&bench));
    let config = ServoConfig::default();
    let (servo, port) = Servo::new(
        Arc::clone(&model),
        Box::new(driver),
        Box::new(pid()),
        config,
    )
    .unwrap();
    let planner = Planner::new(model, CartesianLimits::default(), 0.018).unwrap();
    let rig = Rig {
        servo,
        port,
        planner,
        knobs,
    };
    (rig, bench)
}

#[test]
fn outputs_are_set_while_there_is_power_and_read_as_they_are_set() {
    let (mut rig, bench) = rig();
    rig.order(ServoCommand::SetOutput {
        number: 1,
        value: 0.5,
    });
    assert_eq!(bench.lock().unwrap().set, [0.0; 9], "without power");
    rig.order(ServoCommand::PowerOn);
    rig.order(ServoCommand::SetOutput {
        number: 1,
        value: 0.5,
    });
    rig.order(ServoCommand::SetOutput {
        number: 8,
        value: 1.0,
    });
    // The switch is no output, and there is no tenth number.
    rig.order(ServoCommand::SetOutput {
        number: 0,
        value: 7.0,
    });
    rig.order(ServoCommand::SetOutput {
        number: 9,
        value: 7.0,
    });
    let expected = [0.0, 0.5, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0];
    assert_eq!(bench.lock().unwrap().set, expected);
    rig.servo.tick(0);
    let read = rig.port.status().sensors;
    assert_eq!(read, [1.0, 0.5, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 1.0]);
    rig.order(ServoCommand::EmergencyStop);
    assert_eq!(bench.lock().unwrap().set, [0.0; 9]);
    rig.order(ServoCommand::Reset);
    rig.order(ServoCommand::PowerOn);
    assert_eq!(bench.lock().unwrap().set, [0.0; 9], "they stay off");
}

#[test]
fn a_sensor_that_reads_no_number_is_a_fault_with_its_name_and_which_of_its_numbers() {
    let (mut rig, bench) = rig();
    rig.release();
    bench.lock().unwrap().no_number = true;
    rig.servo.tick(0);
    let status = rig.port.status();
    assert_eq!(status.power, Power::Off);
    let told = status.fault.unwrap().to_string();
    assert_eq!(told, "number 4 of slot `mouse` is no finite number");
}

#[test]
fn a_stale_slot_is_marked_ends_the_motion_by_name_and_lets_none_begin() {
    for (index, ages, expected) in [
        (
            0,
            [0.2, 0.0],
            "what slot `door` reads is 0.200 s old, the limit is 0.100 s",
        ),
        (2, [0.0, f64::INFINITY], "slot `mouse` has read nothing yet"),
        (2, [0.0, f64::NAN], "slot `mouse` has read nothing yet"),
    ] {
        let (mut rig, bench) = rig();
        bench.lock().unwrap().ages = [0.1, 0.0];
        rig.release();
        let segment = rig.plan(1.0);
        rig.start(segment);
        (0..60).for_each(|_| rig.servo.tick(0));
        assert_eq!(rig.port.status().stale, 0);
        bench.lock().unwrap().ages = ages;
        let motion = rig.run_to_end();
        assert_eq!(motion.phase, MotionPhase::Stopped);
        let status = rig.port.status();
        assert_eq!((status.stale, status.power), (1 << index, Power::Released));
        let found = status.ended_by_guard(motion.id).unwrap();
        assert_eq!(
            (found.guard.as_str(), found.measured.as_str()),
            ("slots", expected)
        );
        rig.start(rig.plan(0.5));
        let rejected = rig.port.status().rejected;
        assert_eq!(rejected, Some((motion.id + 1, Rejection::StaleSlot)));
        bench.lock().unwrap().ages = [0.0; 2];
        rig.servo.tick(0);
        rig.start(rig.plan(0.5));
        assert_eq!(rig.run_to_end().phase, MotionPhase::Done);
    }
}

#[test]
fn a_stale_slot_ends_a_stream_too() {
    struct Still;
    impl Source for Still {
        fn newest(&mut self) -> Option<Newest<'_>> {
            Some(Newest {
                count: 1,
                stamp: 0.0,
                age: 0.0,
                numbers: &[0.0, 0.8, -2.6, 0.2, 0.7, 0.1],
            })
        }
    }
    let (mut rig, bench) = rig();
    rig.release();
    let how = Following {
        serial: 1,
        kind: StreamKind::Joints,
        max_age: 0.1,
        pace: (1.0, 1.0),
        guards: GuardSet::default(),
    };
    let stream = |rig: &Rig, serial| {
        let how = Following { serial, ..how };
        let stream = Stream::new(how, Box::new(Still), rig.planner.model());
        rig.port.stream(Box::new(stream)).unwrap();
    };
    stream(&rig, 1);
    (0..5).for_each(|_| rig.servo.tick(0));
    bench.lock().unwrap().ages = [0.0, 1.0];
    let motion = rig.run_to_end();
    assert_eq!(motion.phase, MotionPhase::Stopped);
    let end = rig.port.status().stream.end.unwrap().to_string();
    assert!(
        end.starts_with("guard `slots`: what slot `mouse` reads is 1.000 s old"),
        "{end}"
    );
    stream(&rig, 2);
    rig.servo.tick(0);
    let rejected = rig.port.status().stream_rejected;
    assert_eq!(rejected, Some((2, Rejection::StaleSlot)));
}
