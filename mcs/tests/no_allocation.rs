//! The servo's tick must never allocate: neither at rest nor while it plans, follows, brakes or fails.

#![allow(clippy::unwrap_used, reason = "a test that cannot be set up fails")]

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use mcs::Joints;
use mcs::control::{ComputedTorque, ControlLaw, LawRegistry, LawSettings, PidGravity};
use mcs::driver::{ChannelDriver, DriverError, Power, SlotReading};
use mcs::guard::speed::Speed;
use mcs::guard::workspace::{Region, Workspace};
use mcs::guard::{Guard, GuardSet, Mounted, Reaction};
use mcs::model::inverse::{Preferences, Search};
use mcs::model::{Data, DynamicsOptions, Model, built_in, file::Inertias};
use mcs::servo::{
    Following, MotionPhase, Newest, Servo, ServoCommand, ServoConfig, ServoPort, Source, Stream,
    StreamKind,
};
use mcs::trajectory::{CartesianLimits, Pace, Planner, Setpoint, Solver};
use nalgebra::Translation3;

const START: [f64; 6] = [0.1, 0.8, -2.6, 0.2, 0.7, 0.1];
const GOAL: [f64; 6] = [-0.2, 1.0, -2.7, 0.0, 0.5, 0.4];
const ARMS: [&str; 3] = ["puma560", "testbed9", "testbed18"];

fn model(name: &str) -> Model {
    built_in::model(name, Inertias::Engine).unwrap().unwrap()
}

/// Joint positions of an arm, or of arms on carts.
fn joints(name: &str, cart: [f64; 3], arm: [f64; 6]) -> Joints {
    let on_cart = [&cart[..], &arm].concat();
    let all = match name {
        "puma560" => arm.to_vec(),
        "testbed9" => on_cart,
        _ => on_cart.repeat(2),
    };
    Joints::try_from(&all[..]).unwrap()
}

/// Forward dynamics in one step per period: near enough to be controlled.
struct Arm {
    model: Model,
    data: Data,
    q: Joints,
    qd: Joints,
}

impl ChannelDriver for Arm {
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
        let options = DynamicsOptions::WITH_ROTORS;
        let (model, data) = (&self.model, &mut self.data);
        let qdd = model.forward_dynamics(data, &self.q, &self.qd, torques, options);
        for (index, qdd) in qdd.unwrap().iter().enumerate() {
            self.qd[index] += period.as_secs_f64() * qdd;
            self.q[index] += period.as_secs_f64() * self.qd[index];
        }
        Ok(())
    }
}

fn rig(name: &str, law: Box<dyn ControlLaw>, limit_jerk: bool) -> (Servo, ServoPort, Planner) {
    let arm = Arm {
        model: model(name),
        data: model(name).data(),
        q: joints(name, [0.0, 0.1, 0.0], START),
        qd: Joints::zeros(model(name).dof()),
    };
    let model = Arc::new(model(name));
    let config = ServoConfig {
        limit_jerk,
        ..ServoConfig::default()
    };
    let (servo, port) = Servo::new(Arc::clone(&model), Box::new(arm), law, config).unwrap();
    let planner = Planner::new(model, CartesianLimits::default(), 0.018).unwrap();
    (servo, port, planner.limiting_jerk(limit_jerk))
}

/// Ticks until the motion is over (or 3000 times) and counts what was allocated in the ticks alone.
fn allocations(servo: &mut Servo, port: &ServoPort, stop_after: Option<u32>) -> u64 {
    let mut count = 0;
    for tick in 0..3000 {
        if stop_after == Some(tick) {
            port.order(ServoCommand::Stop).unwrap();
        }
        count += allocation_counter::measure(|| servo.tick(0)).count_total;
        if tick > 1 && port.status().motion.phase.is_over() {
            break;
        }
    }
    count
}

/// Neither the goal nor the start.
fn aside(name: &str) -> Joints {
    joints(name, [-0.3, 0.4, -0.2], [0.6, 0.4, -2.0, 0.6, 0.2, -0.6])
}

fn laws(name: &str) -> [Box<dyn ControlLaw>; 2] {
    let model = Arc::new(model(name));
    let options = DynamicsOptions::WITH_ROTORS;
    [
        Box::new(PidGravity::new(Arc::clone(&model), 6.0, 1.0)),
        Box::new(ComputedTorque::new(model, 6.0, 1.0, options)),
    ]
}

#[test]
fn no_tick_of_any_arm_allocates_in_any_state() {
    // One of the laws with limits of jerk.
    let each = |name| laws(name).into_iter().zip([(name, false), (name, true)]);
    for (law, (name, limit_jerk)) in ARMS.into_iter().flat_map(each) {
        let (mut servo, port, mut planner) = rig(name, law, limit_jerk);
        let mut count = 0;
        for command in [ServoCommand::PowerOn, ServoCommand::ReleaseBrakes] {
            port.order(command).unwrap();
            count += allocation_counter::measure(|| servo.tick(0)).count_total;
        }
        let tune = ServoCommand::Tune {
            bandwidth: 7.0,
            damping: 1.0,
        };
        port.order(tune).unwrap();
        count += allocation_counter::measure(|| servo.tick(0)).count_total;
        let goal = joints(name, [0.2, 0.0, 0.1], GOAL);
        let segment = planner.joint(&port.status().setpoint, &goal, 0.5).unwrap();
        port.order(ServoCommand::Move { id: 1, segment }).unwrap();
        count += allocations(&mut servo, &port, None);
        assert_eq!(port.status().motion.phase, MotionPhase::Done, "{name}");
        // On to a third position over a bridge.
        let (from, third) = (goal, joints(name, [0.1, 0.1, 0.0], START));
        let back = planner.joint(&from, &aside(name), 0.5).unwrap();
        let on = planner.joint(&aside(name), &third, 0.5).unwrap();
        let bridge = planner.bridge((&back, &on), Pace::from(0.5), 1.0).unwrap();
        let orders = [
            ServoCommand::Move {
                id: 2,
                segment: back,
            },
            ServoCommand::MoveOver {
                id: 3,
                segment: on,
                bridge,
            },
        ];
        for order in orders {
            port.order(order).unwrap();
            count += allocation_counter::measure(|| servo.tick(0)).count_total;
        }
        while port.status().ended.of(3).is_none() {
            count += allocation_counter::measure(|| servo.tick(0)).count_total;
        }
        assert_eq!(port.status().motion.phase, MotionPhase::Done, "{name}");
        let start = port.status().setpoint;
        let goal = Translation3::new(0.02, 0.1, -0.05) * planner.tool_pose(&start);
        let segment = planner.line(&start, &goal, 0.5).unwrap();
        port.order(ServoCommand::Move { id: 4, segment }).unwrap();
        count += allocations(&mut servo, &port, Some(50));
        assert_eq!(port.status().motion.phase, MotionPhase::Stopped, "{name}");
        port.emergency_stop();
        count += allocation_counter::measure(|| servo.tick(0)).count_total;
        assert!(port.status().fault.is_some());
        assert_eq!(count, 0, "{name}");
    }
}

#[test]
fn no_tick_allocates_while_guards_watch_are_changed_and_end_a_motion() {
    for name in ARMS {
        let law = laws(name).into_iter().next().unwrap();
        let (mut servo, port, mut planner) = rig(name, law, true);
        for command in [ServoCommand::PowerOn, ServoCommand::ReleaseBrakes] {
            port.order(command).unwrap();
            servo.tick(0);
        }
        let start = port.status().setpoint;
        let tool = planner.tool_pose(&start).translation.vector;
        let mount = |slot, guard: Box<dyn Guard>| {
            let mounted = Mounted::new("guard", Reaction::Stop, slot == 0, guard);
            port.mount(slot, Some(mounted)).unwrap();
        };
        let below = |depth: f64| Workspace {
            keep_out: vec![Region {
                low: [-9.0; 3],
                high: [9.0, 9.0, tool.z - depth],
            }],
            ..Workspace::default()
        };
        mount(0, Box::new(below(0.5)));
        let slow = Speed {
            tool: Some(50.0),
            joints: vec![50.0; start.len()],
            ..Speed::default()
        };
        mount(1, Box::new(slow));
        let guards = GuardSet::default().with(1);
        port.order(ServoCommand::Name { guards }).unwrap();
        let goal = Translation3::new(0.02, 0.05, -0.15) * planner.tool_pose(&start);
        let segment = planner.line(&start, &goal, 0.5).unwrap();
        port.order(ServoCommand::Move { id: 1, segment }).unwrap();
        let mut count = 0;
        for _ in 0..20 {
            count += allocation_counter::measure(|| servo.tick(0)).count_total;
        }
        mount(0, Box::new(below(0.08)));
        count += allocations(&mut servo, &port, None);
        assert!(port.status().ended_by_guard(1).is_some(), "{name}");
        assert_eq!(count, 0, "{name}");
    }
}

#[test]
fn no_law_allocates_when_it_computes_or_is_tuned() {
    let (registry, args) = (LawRegistry::new(), ctos::config::Node::table());
    let period = Duration::from_micros(4500);
    for (arm, name) in ARMS
        .into_iter()
        .flat_map(|arm| registry.names().map(move |name| (arm, name)))
    {
        let model = Arc::new(model(arm));
        let settings = LawSettings {
            model: &model,
            bandwidth_hz: 6.0,
            damping: 1.0,
            period,
            cx: None,
            args: &args,
        };
        let mut law = registry.build(name, &settings).unwrap().unwrap();
        let q = joints(arm, [0.0, 0.1, 0.0], START);
        let setpoint = Setpoint::at_rest(q);
        let readings = vec![SlotReading::default(); q.len()];
        let mut torques = Joints::zeros(q.len());
        let info = allocation_counter::measure(|| {
            law.reset(&readings);
            law.tune(5.0, 0.9);
            law.sense(&[0.1; 6]);
            law.torques(&setpoint, &readings, period, &mut torques);
        });
        assert_eq!(info.count_total, 0, "{arm} {name}");
        assert!(
            torques.iter().all(|torque| torque.is_finite()),
            "{arm} {name}"
        );
    }
}

#[test]
fn the_kinematics_of_a_tip_do_not_allocate() {
    for name in ARMS {
        let mut solver = Solver::new(Arc::new(model(name))).unwrap();
        let near = joints(name, [0.0, 0.1, 0.0], START);
        let branch = solver.branch_of(&near);
        let info = allocation_counter::measure(|| {
            let pose = Translation3::new(0.01, 0.0, 0.0) * solver.pose(&near);
            std::hint::black_box(solver.nearest(&pose, &near, None)).unwrap();
            std::hint::black_box(solver.follow(&pose, branch, &near)).unwrap();
        });
        assert_eq!(info.count_total, 0, "{name}");
    }
}

#[test]
fn the_general_model_does_not_allocate_per_evaluation() {
    let model = model("testbed18");
    let (tip, mut data) = (model.tip(), model.data());
    let (q, qd) = ([0.2; 18], [0.1; 18]);
    let goal = model.placement(&mut data, &q, tip);
    let mut search = Search::new(&model, tip, true, Preferences::default());
    let info = allocation_counter::measure(|| {
        let options = DynamicsOptions::FULL;
        std::hint::black_box(model.jacobian(&mut data, &q, tip));
        std::hint::black_box(model.gravity_torques(&mut data, &q));
        std::hint::black_box(model.inverse_dynamics(&mut data, &q, &qd, &qd, options));
        std::hint::black_box(model.mass_matrix(&mut data, &q, options));
        std::hint::black_box(model.forward_dynamics(&mut data, &q, &qd, &qd, options)).unwrap();
        std::hint::black_box(search.solve(&model, &goal, &[0.0; 18])).unwrap();
    });
    assert_eq!(info.count_total, 0);
}

#[test]
fn the_counter_counts() {
    let info = allocation_counter::measure(|| drop(std::hint::black_box(vec![0_u8; 64])));
    assert_eq!(info.count_total, 1);
}

/// A value for as long as the flag is not raised, then one that is too old.
struct Fed {
    numbers: Vec<f64>,
    count: u64,
    silent: Arc<AtomicBool>,
}

impl Source for Fed {
    fn newest(&mut self) -> Option<Newest<'_>> {
        self.count += 1;
        Some(Newest {
            count: self.count,
            stamp: 0.018 * self.count as f64,
            age: match self.silent.load(Ordering::Relaxed) {
                true => 9.0,
                false => 0.0,
            },
            numbers: &self.numbers,
        })
    }
}

#[test]
fn no_tick_allocates_while_a_stream_is_followed_and_ends() {
    for (name, limit_jerk) in ARMS
        .into_iter()
        .flat_map(|name| [(name, false), (name, true)])
    {
        let law = laws(name).into_iter().next().unwrap();
        let (mut servo, port, planner) = rig(name, law, limit_jerk);
        for command in [ServoCommand::PowerOn, ServoCommand::ReleaseBrakes] {
            port.order(command).unwrap();
            servo.tick(0);
        }
        let n = planner.model().dof();
        let goal = joints(name, [0.1, 0.1, 0.0], START);
        let with_speeds = [&goal[..], &vec![0.0; n]].concat();
        let gravity = StreamKind::Torques { gravity: true };
        let streams = [
            (StreamKind::Joints, goal.to_vec()),
            (StreamKind::Joints, with_speeds),
            (StreamKind::Tool, vec![0.01, 0.02, -0.01, 0.0, 0.0, 0.1]),
            (gravity, vec![0.0; n]),
            (StreamKind::Joints, vec![f64::NAN; n]),
        ];
        let mut count = 0;
        for (serial, (kind, numbers)) in streams.into_iter().enumerate() {
            let silent = Arc::new(AtomicBool::new(false));
            let source = Fed {
                numbers,
                count: 0,
                silent: Arc::clone(&silent),
            };
            let how = Following {
                serial: serial as u64 + 1,
                kind,
                max_age: 0.1,
                pace: (0.5, 0.5),
                guards: GuardSet::default(),
            };
            let stream = Stream::new(how, Box::new(source), planner.model());
            port.stream(Box::new(stream)).unwrap();
            for _ in 0..60 {
                count += allocation_counter::measure(|| servo.tick(0)).count_total;
            }
            let status = port.status();
            assert_eq!(
                status.stream.serial,
                serial as u64 + 1,
                "{name}: {status:?}"
            );
            silent.store(true, Ordering::Relaxed);
            for _ in 0..2000 {
                count += allocation_counter::measure(|| servo.tick(0)).count_total;
                if port.status().motion.phase.is_over() {
                    break;
                }
            }
            let status = port.status();
            assert_eq!(
                status.motion.phase,
                MotionPhase::Stopped,
                "{name}: {status:?}"
            );
            assert!(status.stream.end.is_some());
        }
        assert_eq!(count, 0, "{name}");
    }
}
