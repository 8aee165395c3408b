//! A servo of both arms on their carts, 18 joints, with guards of every kind, in the middle of a motion; without hardware.

use std::hint::black_box;
use std::sync::Arc;
use std::time::Duration;

use ctos::config::Node;
use ctos::diagnostic::{Findings, Source};
use ctos::registry::Registry;
use ctos::task::HandlerError;
use mcs::Joints;
use mcs::control::PidGravity;
use mcs::driver::{ChannelDriver, DriverError, Power, Sensor, SensorKind, SlotReading};
use mcs::guard::{Around, GuardRegistry, GuardSettings, Mounted, Neighbour, Reaction};
use mcs::joints::Distances;
use mcs::model::{Model, built_in, file::Inertias};
use mcs::servo::{Servo, ServoCommand, ServoConfig, ServoPort};
use mcs::trajectory::{CartesianLimits, Planner};

const START: [f64; 9] = [0.2, 0.1, -0.1, 0.1, 0.8, -2.6, 0.2, 0.7, 0.1];
const GOAL: [f64; 9] = [0.0, 0.2, 0.0, -0.6, 1.4, -2.9, -0.4, 0.3, 1.1];

/// The recipes, by kind; the last one is collision detection.
pub const RECIPES: [(&str, &str); 4] = [
    (
        "workspace",
        "keep_out = [{ low = [-3, -3, -1], high = [3, 3, 0.1] }]\nradius = 0.05",
    ),
    ("speed", "tool = 10.0"),
    ("force", "force = 20.0\nrise = 10.0"),
    (
        "collision",
        "room = [{ name = \"floor\", shapes = [{ box = [20, 20, 1], at = { xyz = [0, 0, -0.5] } }] }]",
    ),
];

/// Arms that are always where they were, with a sensor that feels little, and cost nothing.
struct Statue(Joints, [Sensor; 1]);

impl ChannelDriver for Statue {
    fn slots(&self) -> usize {
        self.0.len()
    }

    fn read(&mut self, readings: &mut [SlotReading]) -> Result<(), DriverError> {
        for (reading, position) in readings.iter_mut().zip(&self.0) {
            reading.position = *position;
        }
        Ok(())
    }

    fn sensors(&self) -> &[Sensor] {
        &self.1
    }

    fn sense(&mut self, numbers: &mut [f64]) -> Result<(), DriverError> {
        numbers.fill(0.5);
        Ok(())
    }

    fn write(&mut self, torques: &[f64], _: Power, _: Duration) -> Result<(), DriverError> {
        black_box(torques);
        Ok(())
    }
}

struct Alone;

impl Around for Alone {
    fn neighbour(&self, _: &str) -> Result<Neighbour, HandlerError> {
        Err("nobody is here".into())
    }
}

fn both(arm: [f64; 9]) -> Joints {
    Joints::try_from(&arm.repeat(2)[..]).unwrap()
}

/// A servo with so many of the recipes, in the first ticks of a motion; whether limits of jerk count.
pub fn servo(recipes: usize, limit_jerk: bool) -> (Servo, ServoPort) {
    let model: Arc<Model> = Arc::new(
        built_in::model("testbed18", Inertias::Engine)
            .unwrap()
            .unwrap(),
    );
    let law = PidGravity::new(Arc::clone(&model), 6.0, 1.0);
    // The statue never follows: that must be no emergency here.
    let far = Distances {
        turning: 100.0,
        sliding: 100.0,
    };
    let config = ServoConfig {
        following_error: far,
        following_window: far,
        limit_jerk,
        ..ServoConfig::default()
    };
    let sensor = Sensor {
        name: "wrist".to_owned(),
        kind: SensorKind::ForceTorque,
    };
    let driver = Box::new(Statue(both(START), [sensor]));
    let (mut servo, port) = Servo::new(Arc::clone(&model), driver, Box::new(law), config).unwrap();
    servo.show_on(Neighbour::new(Arc::clone(&model)));
    let mut guards = GuardRegistry::new();
    mcs_collision::register(&mut Registry::new(), &mut guards);
    for (slot, (kind, text)) in RECIPES.iter().take(recipes).enumerate() {
        let args = Node::from_toml(&Source::new("guard", *text), &mut Findings::new());
        let settings = GuardSettings {
            model: &model,
            period: config.period,
            servo: "servo",
            around: &Alone,
            cx: None,
            args: &args,
        };
        let guard = guards.build(kind, &settings).unwrap().unwrap();
        let mounted = Mounted::new(kind, Reaction::Stop, true, guard);
        port.mount(slot, Some(mounted)).unwrap();
    }
    let planner = Planner::new(model, CartesianLimits::default(), 0.018).unwrap();
    let planner = planner.limiting_jerk(limit_jerk);
    let segment = planner.joint(&both(START), &both(GOAL), 0.2).unwrap();
    for command in [
        ServoCommand::PowerOn,
        ServoCommand::ReleaseBrakes,
        ServoCommand::Move { id: 1, segment },
    ] {
        port.order(command).unwrap();
        servo.tick(0);
    }
    (servo, port)
}
