//! Every law that is registered goes over to every other one, on three arms that are heavier than the laws think.

#![allow(clippy::unwrap_used, reason = "a test that cannot be set up fails")]

use std::{sync::Arc, time::Duration};

use ctos::{
    config::Node,
    diagnostic::{Findings, Source},
    registry::Registry,
};
use mcs::{
    Joints,
    control::{
        ControlLaw, LawRegistry, LawSettings, SplitTorque,
        split_torque::{Exchange, Half, SPLIT_TORQUE},
    },
    driver::{ChannelDriver, DriverError, Power, SlotReading},
    joints::Distances,
    model::{Data, DynamicsOptions, Model, built_in, file::Inertias},
    servo::{Servo, ServoCommand, ServoConfig, ServoPort},
    trajectory::Setpoint,
};

/// So much heavier the arms are: each law holds them with torques of its own.
const HEAVIER: f64 = 1.03;
/// The most that a torque changes from one tick to the next, as a part of what the drive can. A stiff law changes it by 0.0113
/// when it takes over an arm that a soft one lets sag; all others by less.
const STEP: f64 = 0.012;
/// From one law to the next, ticks: the difference dies out in 67.
const APART: usize = 120;
const SUBSTEPS: u32 = 4;

const ARM: [f64; 6] = [0.1, 0.8, -2.6, 0.2, 0.7, 0.1];
const CART: [f64; 3] = [0.2, 0.1, 0.05];

fn model(name: &str) -> Model {
    built_in::model(name, Inertias::Engine).unwrap().unwrap()
}

/// An arm that obeys the equations of motion.
struct Heavy {
    model: Model,
    data: Data,
    q: Vec<f64>,
    qd: Vec<f64>,
}

impl ChannelDriver for Heavy {
    fn slots(&self) -> usize {
        self.q.len()
    }

    fn read(&mut self, readings: &mut [SlotReading]) -> Result<(), DriverError> {
        for (index, reading) in readings.iter_mut().enumerate() {
            reading.position = self.q[index];
            reading.velocity = self.qd[index];
        }
        Ok(())
    }

    fn write(
        &mut self,
        torques: &[f64],
        power: Power,
        period: Duration,
    ) -> Result<(), DriverError> {
        if power != Power::Released {
            self.qd.fill(0.0);
            return Ok(());
        }
        let h = period.as_secs_f64() / f64::from(SUBSTEPS);
        for _ in 0..SUBSTEPS {
            let options = DynamicsOptions::WITH_ROTORS;
            let (model, data) = (&self.model, &mut self.data);
            let rates = model.forward_dynamics(data, &self.q, &self.qd, torques, options);
            for (joint, rate) in rates.unwrap().iter().enumerate() {
                self.qd[joint] += h * rate;
                self.q[joint] += h * self.qd[joint];
            }
        }
        Ok(())
    }
}

/// A servo that holds its arm with `pid`, all laws, and the other half of `split_torque`.
struct Rig {
    model: Arc<Model>,
    servo: Servo,
    port: ServoPort,
    laws: LawRegistry,
    exchange: Arc<Exchange>,
    half: Half,
}

impl Rig {
    fn new(name: &str, start: &[f64]) -> Self {
        let model = Arc::new(self::model(name));
        let heavy = self::model(name).falsified(|body, _| body.mass *= HEAVIER);
        let arm = Heavy {
            data: heavy.data(),
            model: heavy,
            q: start.to_vec(),
            qd: vec![0.0; start.len()],
        };
        let mut laws = LawRegistry::new();
        mcs_hand::register(&mut Registry::new(), &mut laws);
        // Soft laws let the weight that they do not know pull the arm away.
        let wide = Distances {
            turning: 1.0,
            sliding: 1.0,
        };
        let config = ServoConfig {
            following_error: wide,
            following_window: wide,
            ..ServoConfig::default()
        };
        let exchange = Exchange::new(model.dof());
        let first = law(&laws, "pid", &model, &exchange);
        let (servo, port) = Servo::new(Arc::clone(&model), Box::new(arm), first, config).unwrap();
        port.order(ServoCommand::PowerOn).unwrap();
        port.order(ServoCommand::ReleaseBrakes).unwrap();
        Self {
            half: Half::new(Arc::clone(&model), Arc::clone(&exchange)),
            model,
            servo,
            port,
            laws,
            exchange,
        }
    }

    fn tick(&mut self) -> Joints {
        self.servo.tick(0);
        self.half.tick();
        self.port.status().torque
    }
}

/// A law by its name, with the arguments that it needs.
fn law(
    laws: &LawRegistry,
    name: &str,
    model: &Arc<Model>,
    exchange: &Arc<Exchange>,
) -> Box<dyn ControlLaw> {
    law_that_presses(laws, name, (model, exchange), "")
}

/// The same; `carry` presses on what is between the tips where that is asked for.
fn law_that_presses(
    laws: &LawRegistry,
    name: &str,
    (model, exchange): (&Arc<Model>, &Arc<Exchange>),
    press: &str,
) -> Box<dyn ControlLaw> {
    let config = ServoConfig::default();
    let (bandwidth_hz, damping) = (8.0, 1.0);
    if name == SPLIT_TORQUE {
        // A task would find its other half by the name of the servo.
        let (model, exchange) = (Arc::clone(model), Arc::clone(exchange));
        return Box::new(SplitTorque::new(model, bandwidth_hz, damping, exchange));
    }
    let tips = match model.frame("left") {
        Some(_) => {
            "tips = [\"left\", \"right\"]\nsensors = [\"left_arm.flange\", \"right_arm.flange\"]"
        }
        None => "tips = [\"TIP\", \"BASE\"]\nsensors = [\"TIP\", \"BASE\"]",
    };
    let tip = model.at(model.tip()).name.as_str();
    let base = tip.replace('6', "2");
    let args = match name {
        "grip" => "gravity = [0.0, 0.0, -9.81]".to_owned(),
        "carry" => tips.replace("TIP", tip).replace("BASE", &base) + press,
        _ => String::new(),
    };
    let args = Node::from_toml(&Source::new("args", args), &mut Findings::new());
    let settings = LawSettings {
        model,
        bandwidth_hz,
        damping,
        period: config.period,
        cx: None,
        args: &args,
    };
    laws.build(name, &settings).unwrap().unwrap()
}

/// A walk from law to law that goes from each to each other one.
fn walk(names: &[String]) -> Vec<&str> {
    let mut walk = Vec::new();
    for (index, one) in names.iter().enumerate() {
        walk.push(one.as_str());
        for other in &names[index + 1..] {
            walk.extend([other.as_str(), one.as_str()]);
        }
    }
    walk
}

#[test]
fn the_walk_goes_from_each_law_to_each_other_one() {
    let names = ["a", "b", "c", "d"].map(str::to_owned);
    let walk = walk(&names);
    for (one, other) in [("a", "b"), ("b", "a"), ("c", "a"), ("b", "d"), ("d", "c")] {
        assert!(walk.windows(2).any(|pair| pair == [one, other]), "{walk:?}");
    }
}

#[test]
fn between_any_two_registered_laws_no_torque_makes_a_step() {
    let on_cart = [&CART[..], &ARM].concat();
    let both = [&on_cart[..], &on_cart].concat();
    for (name, start) in [
        ("puma560", &ARM[..]),
        ("testbed9", &on_cart),
        ("testbed18", &both),
    ] {
        let mut rig = Rig::new(name, start);
        let names: Vec<String> = rig.laws.names().map(str::to_owned).collect();
        for own in [
            "cartesian_impedance",
            "carry",
            "computed_torque",
            "grip",
            "joint_impedance",
            "pid",
            "split_torque",
        ] {
            assert!(names.iter().any(|name| name == own), "{names:?}");
        }
        let mut before = Joints::zeros(rig.model.dof());
        // Until the integral carries what is not in the model.
        for _ in 0..600 {
            before = rig.tick();
        }
        let (mut from, mut worst) = ("pid", (0.0, String::new()));
        for to in walk(&names) {
            let next = law(&rig.laws, to, &rig.model, &rig.exchange);
            rig.port.change_law(next).unwrap();
            for tick in 0..APART {
                let now = rig.tick();
                for (joint, spec) in rig.model.joints().iter().enumerate() {
                    let step = (now[joint] - before[joint]).abs() / spec.limits.torque;
                    if step > worst.0 {
                        let what = format!("{from} to {to}, tick {tick}, {}", spec.name);
                        worst = (step, what);
                    }
                }
                before = now;
            }
            assert_eq!(rig.port.status().fault, None, "{name}: {from} to {to}");
            from = to;
        }
        assert!(worst.0 < STEP, "{name}: {worst:?} of what the drive can");
    }
}

#[test]
fn no_law_allocates_in_a_tick_also_where_two_tips_press_on_a_thing() {
    let on_cart = [&CART[..], &ARM].concat();
    let mut rig = Rig::new("testbed18", &[&on_cart[..], &on_cart].concat());
    let names: Vec<String> = rig.laws.names().map(str::to_owned).collect();
    for name in &names {
        let shared = (&rig.model, &rig.exchange);
        let mut next = law_that_presses(&rig.laws, name, shared, "\nforce_n = 5.0");
        let status = rig.port.status();
        let readings: Vec<SlotReading> = (0..rig.model.dof())
            .map(|joint| SlotReading {
                position: status.position[joint],
                velocity: 0.1,
            })
            .collect();
        let (setpoint, mut out) = (Setpoint::at_rest(status.position), [0.0; 18]);
        next.reset(&readings);
        let count = allocation_counter::measure(|| {
            for _ in 0..3 {
                next.sense(&[1.0; 12]);
                next.torques(
                    &setpoint,
                    &readings,
                    ServoConfig::default().period,
                    &mut out,
                );
            }
        });
        assert_eq!(count.count_total, 0, "{name}");
        rig.tick();
    }
}
