//! Ways of a PUMA around a post and under a beam, driven by a servo on ideal drives that the collision guard watches: it ends
//! none of them. `CTOS_WAYS=200` drives two hundred.

#![allow(
    clippy::unwrap_used,
    clippy::panic,
    reason = "a test that cannot be set up fails"
)]

use std::sync::Arc;
use std::time::Duration;

use ctos::config::Node;
use ctos::diagnostic::{Findings, Source};
use ctos::registry::Registry;
use ctos::task::HandlerError;
use mcs::Joints;
use mcs::control::ControlLaw;
use mcs::driver::{ChannelDriver, DriverError, Power, SlotReading};
use mcs::guard::{Around, GuardRegistry, GuardSettings, Mounted, Neighbour, Reaction};
use mcs::model::{Model, built_in, file::Inertias};
use mcs::servo::{MotionPhase, QUEUE, Servo, ServoCommand, ServoConfig, ServoPort};
use mcs::trajectory::{Blend, CartesianLimits, Pace, Planner, Setpoint};
use mcs_collision::guard::Surroundings;
use mcs_path::{Options, Search, Space, Way};

/// The room of `configs/around.toml`.
const ROOM: &str = r#"
margin = 0.02
[[room]]
name = "floor"
shapes = [{ box = [20.0, 20.0, 1.0], at = { xyz = [0.0, 0.0, -0.5] } }]
[[room]]
name = "post"
shapes = [{ box = [0.08, 0.08, 1.0], at = { xyz = [0.55, 0.15, 0.5] } }]
[[room]]
name = "beam"
shapes = [{ box = [0.08, 0.8, 0.08], at = { xyz = [0.55, 0.0, 1.25] } }]
"#;
/// Its places, degrees.
const PLACES: [[f64; 6]; 2] = [
    [-40.0, 35.0, -149.0, 0.0, 23.0, 0.0],
    [50.0, 35.0, -149.0, 0.0, 23.0, 0.0],
];

fn ways() -> u64 {
    let asked = std::env::var("CTOS_WAYS").ok();
    asked.and_then(|count| count.parse().ok()).unwrap_or(8)
}

fn puma() -> Arc<Model> {
    let model = built_in::model("puma560", Inertias::Engine).unwrap();
    Arc::new(model.unwrap())
}

fn room() -> Node {
    Node::from_toml(&Source::new("room", ROOM), &mut Findings::new())
}

/// Drives that are always where they are told to be.
struct Ideal(Joints);

impl ChannelDriver for Ideal {
    fn slots(&self) -> usize {
        self.0.len()
    }

    fn read(&mut self, readings: &mut [SlotReading]) -> Result<(), DriverError> {
        for (reading, position) in readings.iter_mut().zip(&self.0) {
            reading.position = *position;
        }
        Ok(())
    }

    fn write(&mut self, told: &[f64], power: Power, _: Duration) -> Result<(), DriverError> {
        if power == Power::Released {
            self.0 = Joints::try_from(told).unwrap();
        }
        Ok(())
    }
}

struct Follow;

impl ControlLaw for Follow {
    fn reset(&mut self, _: &[SlotReading]) {}

    fn torques(&mut self, setpoint: &Setpoint, _: &[SlotReading], _: Duration, out: &mut [f64]) {
        out.copy_from_slice(&setpoint.position);
    }
}

struct Alone;

impl Around for Alone {
    fn neighbour(&self, _: &str) -> Result<Neighbour, HandlerError> {
        Err("nobody is here".into())
    }
}

fn watched(start: &Joints, limit_jerk: bool) -> (Servo, ServoPort) {
    let config = ServoConfig {
        limit_jerk,
        ..ServoConfig::default()
    };
    let driver = Box::new(Ideal(*start));
    let (mut servo, port) = Servo::new(puma(), driver, Box::new(Follow), config).unwrap();
    let mut guards = GuardRegistry::new();
    mcs_collision::register(&mut Registry::new(), &mut guards);
    let settings = GuardSettings {
        model: &puma(),
        period: config.period,
        servo: "servo",
        around: &Alone,
        cx: None,
        args: &room(),
    };
    let guard = guards.build("collision", &settings).unwrap().unwrap();
    let guard = Mounted::new("collision", Reaction::Stop, true, guard);
    port.mount(0, Some(guard)).unwrap();
    for command in [ServoCommand::PowerOn, ServoCommand::ReleaseBrakes] {
        port.order(command).unwrap();
        servo.tick(0);
    }
    (servo, port)
}

/// Drives a way as the Path-planning Coordinator does; how many of its points were passed without a stop.
fn drive(way: &Way, speed: f64, limit_jerk: bool) -> usize {
    let mut planner = Planner::new(puma(), CartesianLimits::default(), 0.018)
        .unwrap()
        .limiting_jerk(limit_jerk);
    let (mut servo, port) = watched(&way.points[0], limit_jerk);
    let (pace, mut before, mut bridges) = (Pace::from(speed), None, 0);
    let mut orders = Vec::new();
    for (number, part) in way.points.windows(2).enumerate() {
        let segment = planner.direct(&part[0], &part[1], pace).unwrap();
        let bridge = before.and_then(|before| {
            let blend = Blend::Joints(way.leeway[number]);
            planner.bridge((&before, &segment), pace, blend)
        });
        bridges += usize::from(bridge.is_some());
        let id = number as u64 + 1;
        orders.push(match bridge {
            Some(bridge) => ServoCommand::MoveOver {
                id,
                segment,
                bridge,
            },
            None => ServoCommand::Move { id, segment },
        });
        before = Some(segment);
    }
    let (last, mut given) = (orders.len() as u64, 0);
    let mut orders = orders.into_iter();
    for _ in 0..20_000 {
        while given - port.status().ended.newest() < QUEUE as u64
            && let Some(order) = orders.next()
        {
            port.order(order).unwrap();
            given += 1;
        }
        servo.tick(0);
        if let Some(motion) = port.status().ended.of(last) {
            let guard = port.status().guard;
            assert_eq!(motion.phase, MotionPhase::Done, "{guard:?}");
            return bridges;
        }
    }
    panic!("it never ends");
}

#[test]
fn no_planned_way_is_ended_by_the_guard_while_nothing_else_moves() {
    let places = PLACES.map(|place| Joints::from(place.map(f64::to_radians)));
    let around = Surroundings::read(&room()).unwrap();
    let mut bridges = 0;
    for seed in 0..ways() {
        let (from, to) = (seed as usize % 2, 1 - seed as usize % 2);
        // The room that is kept besides the guard's margin.
        let space = Space::new(
            puma(),
            Vec::new(),
            around.room.clone(),
            around.margin + 0.02,
        );
        let options = Options {
            seed,
            ..Options::default()
        };
        let search = Search::new(space, &places[from], &[places[to]], options);
        let way = search.unwrap().run().unwrap();
        for (speed, limit_jerk) in [(0.5, false), (1.0, false), (1.0, true)] {
            bridges += drive(&way, speed, limit_jerk);
        }
    }
    assert!(bridges > 0);
}
