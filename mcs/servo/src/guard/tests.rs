//! Guards in the servo, on an arm that obeys the equations of motion.

use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use ctos::config::Node;
use ctos::diagnostic::{Findings, Source};
use ctos::task::HandlerError;
use nalgebra::{Translation3, Vector3};

use super::*;
use crate::control::PidGravity;
use crate::driver::test_arm::{Knobs, START, TestArm, built_in_arm};
use crate::driver::{ChannelDriver, DriverError, Power, Sensor, SensorKind};
use crate::guard::force::Force;
use crate::guard::workspace::{Region, Workspace};
use crate::servo::{MotionPhase, Servo, ServoCommand, ServoConfig, ServoPort, ServoStatus};
use crate::trajectory::{CartesianLimits, Planner, Segment};

fn arm() -> TestArm {
    let knobs = Arc::new(Knobs::default());
    TestArm::new(built_in_arm("puma560"), &START, false, &knobs)
}

/// An arm with a force-torque sensor that reads a force along z, N.
struct Touched {
    arm: TestArm,
    sensors: [Sensor; 1],
    force: Arc<AtomicU64>,
}

impl Touched {
    fn by(force: &Arc<AtomicU64>) -> Self {
        let kind = SensorKind::ForceTorque;
        let name = "wrist".to_owned();
        Self {
            arm: arm(),
            sensors: [Sensor { name, kind }],
            force: Arc::clone(force),
        }
    }
}

impl ChannelDriver for Touched {
    fn slots(&self) -> usize {
        self.arm.slots()
    }

    fn read(&mut self, readings: &mut [SlotReading]) -> Result<(), DriverError> {
        self.arm.read(readings)
    }

    fn sensors(&self) -> &[Sensor] {
        &self.sensors
    }

    fn sense(&mut self, numbers: &mut [f64]) -> Result<(), DriverError> {
        numbers[2] = self.force.load(Ordering::Relaxed) as f64;
        Ok(())
    }

    fn write(
        &mut self,
        torques: &[f64],
        power: Power,
        period: Duration,
    ) -> Result<(), DriverError> {
        self.arm.write(torques, power, period)
    }
}

/// No other arm.
struct Nobody;

impl Around for Nobody {
    fn neighbour(&self, servo: &str) -> Result<Neighbour, HandlerError> {
        Err(format!("there is no servo `{servo}`").into())
    }
}

struct Rig {
    servo: Servo,
    port: ServoPort,
    planner: Planner,
}

impl Rig {
    fn new() -> Self {
        Self::driving(arm())
    }

    fn driving(driver: impl ChannelDriver + 'static) -> Self {
        let model = Arc::new(built_in_arm("puma560"));
        let law = Box::new(PidGravity::new(Arc::clone(&model), 8.0, 1.0));
        let config = ServoConfig::default();
        let (servo, port) = Servo::new(Arc::clone(&model), Box::new(driver), law, config).unwrap();
        let planner = Planner::new(model, CartesianLimits::default(), 0.018).unwrap();
        let mut rig = Self {
            servo,
            port,
            planner,
        };
        for command in [ServoCommand::PowerOn, ServoCommand::ReleaseBrakes] {
            rig.port.order(command).unwrap();
            rig.servo.tick(0);
        }
        rig
    }

    fn mount(
        &self,
        slot: usize,
        name: &str,
        reaction: Reaction,
        always: bool,
        guard: impl Guard + 'static,
    ) {
        let mounted = Mounted::new(name, reaction, always, Box::new(guard));
        self.port.mount(slot, Some(mounted)).unwrap();
    }

    fn tool(&mut self) -> Vector3<f64> {
        let status = self.port.status();
        self.planner.tool_pose(&status.setpoint).translation.vector
    }

    /// A line by so much, m.
    fn line(&mut self, by: [f64; 3]) -> Segment {
        let start = self.port.status().setpoint;
        let [x, y, z] = by;
        let goal = Translation3::new(x, y, z) * self.planner.tool_pose(&start);
        self.planner.line(&start, &goal, 0.8).unwrap()
    }

    /// Moves to the end, and hands back the status and the deepest z that the tool came to.
    fn go(&mut self, segment: Segment) -> (ServoStatus, f64) {
        let id = self.port.status().motion.id + 1;
        self.port.order(ServoCommand::Move { id, segment }).unwrap();
        let mut lowest = f64::INFINITY;
        for _ in 0..5000 {
            self.servo.tick(0);
            lowest = lowest.min(self.tool().z);
            let status = self.port.status();
            if status.motion.id == id && status.motion.phase.is_over() {
                return (status, lowest);
            }
        }
        panic!("the motion never ended");
    }
}

/// All below a height, m.
fn table(height: f64) -> Workspace {
    let (low, high) = ([-2.0; 3], [2.0, 2.0, height]);
    Workspace {
        keep_out: vec![Region { low, high }],
        ..Workspace::default()
    }
}

#[test]
fn a_motion_into_a_keep_out_box_ends_above_it_and_only_ways_out_are_left() {
    let mut rig = Rig::new();
    let height = rig.tool().z - 0.1;
    rig.mount(3, "table", Reaction::Stop, true, table(height));
    let down = rig.line([0.0, 0.05, -0.25]);
    let (status, lowest) = rig.go(down);
    assert_eq!(status.motion.phase, MotionPhase::Stopped);
    assert!(status.fault.is_none() && !status.stopped);
    let found = status.ended_by_guard(1).unwrap();
    assert_eq!(found.guard.as_str(), "table");
    assert!(
        found
            .measured
            .as_str()
            .contains("would come into keep-out box 1"),
        "{found:?}"
    );
    assert!(lowest > height, "{lowest} {height}");
    // It came to rest no farther from the box than it moves in two ticks.
    assert!(lowest < height + 0.005, "{lowest} {height}");
    for _ in 0..5 {
        let down = rig.line([0.0, 0.0, -0.05]);
        let (status, deeper) = rig.go(down);
        assert_eq!(status.motion.phase, MotionPhase::Stopped);
        assert!(status.ended_by_guard(status.motion.id).is_some());
        assert!(deeper > height, "{deeper} {height}");
    }
    let up = rig.line([0.0, 0.0, 0.05]);
    let (status, _) = rig.go(up);
    assert_eq!(status.motion.phase, MotionPhase::Done, "{:?}", status.guard);
}

#[test]
fn out_of_a_keep_out_box_that_was_put_about_the_tool_it_may_move_and_no_deeper() {
    let mut rig = Rig::new();
    let height = rig.tool().z + 0.02;
    rig.mount(0, "table", Reaction::Stop, true, table(height));
    let start = rig.tool().z;
    let down = rig.line([0.0, 0.0, -0.1]);
    let (status, lowest) = rig.go(down);
    assert_eq!(status.motion.phase, MotionPhase::Stopped);
    assert!(start - lowest < 1e-6, "{start} {lowest}");
    let up = rig.line([0.0, 0.0, 0.06]);
    assert_eq!(rig.go(up).0.motion.phase, MotionPhase::Done);
    let down = rig.line([0.0, 0.0, -0.1]);
    assert!(rig.go(down).1 > height);
}

#[test]
fn a_guard_that_does_not_always_watch_does_so_for_the_motions_that_name_it() {
    let mut rig = Rig::new();
    let height = rig.tool().z - 0.02;
    rig.mount(5, "table", Reaction::Stop, false, table(height));
    let down = rig.line([0.0, 0.0, -0.05]);
    let (status, lowest) = rig.go(down);
    assert_eq!(status.motion.phase, MotionPhase::Done);
    assert!(lowest < height);
    let up = rig.line([0.0, 0.0, 0.05]);
    rig.go(up);
    let guards = GuardSet::default().with(5);
    rig.port.order(ServoCommand::Name { guards }).unwrap();
    let down = rig.line([0.0, 0.0, -0.05]);
    let (status, lowest) = rig.go(down);
    assert_eq!(status.motion.phase, MotionPhase::Stopped);
    assert!(lowest > height);
}

#[test]
fn a_guard_that_is_changed_in_the_middle_of_a_motion_watches_it_as_it_is_then() {
    let mut rig = Rig::new();
    let start = rig.tool().z;
    rig.mount(0, "table", Reaction::Stop, true, table(start - 1.0));
    let segment = rig.line([0.0, 0.0, -0.25]);
    rig.port
        .order(ServoCommand::Move { id: 1, segment })
        .unwrap();
    for _ in 0..20 {
        rig.servo.tick(0);
    }
    assert_eq!(rig.port.status().motion.phase, MotionPhase::Moving);
    rig.mount(0, "table", Reaction::Stop, true, table(start - 0.15));
    while !rig.port.status().motion.phase.is_over() {
        rig.servo.tick(0);
    }
    assert!(rig.port.status().ended_by_guard(1).is_some());
    assert!(rig.tool().z > start - 0.15);
    rig.port.mount(0, None).unwrap();
    let down = rig.line([0.0, 0.0, -0.1]);
    assert_eq!(rig.go(down).0.motion.phase, MotionPhase::Done);
}

#[test]
fn a_guard_that_only_reports_tells_once_and_the_motion_goes_on() {
    let mut rig = Rig::new();
    let height = rig.tool().z - 0.02;
    rig.mount(0, "table", Reaction::Report, true, table(height));
    let down = rig.line([0.0, 0.0, -0.05]);
    let (status, _) = rig.go(down);
    assert_eq!(status.motion.phase, MotionPhase::Done);
    assert_eq!(status.ended_by_guard(1), None);
    assert_eq!(status.guard.unwrap().guard.as_str(), "table");
}

/// Looks how well the way to rest is foretold, and stops the arm at once.
struct Foretold(Arc<std::sync::Mutex<Option<Vector3<f64>>>>, u32);

impl Guard for Foretold {
    fn check(&mut self, seen: &Seen<'_>) -> Option<Words> {
        self.1 += 1;
        if self.1 == 40 {
            *self.0.lock().unwrap() = Some(seen.tool_at_rest.origin);
        }
        // The braking begins with the next tick's setpoint.
        (self.1 > 40).then(|| "enough".into())
    }
}

#[test]
fn where_a_motion_comes_to_rest_is_foretold_within_a_hundredth_of_its_way() {
    for speed in [0.3, 1.0] {
        let mut rig = Rig::new();
        let rest = Arc::default();
        rig.mount(
            0,
            "enough",
            Reaction::Stop,
            true,
            Foretold(Arc::clone(&rest), 0),
        );
        let start = rig.port.status().setpoint;
        let goal = [-0.6, 1.4, -2.9, -0.4, 0.2, 1.1].into();
        let segment = rig.planner.joint(&start, &goal, speed).unwrap();
        rig.port
            .order(ServoCommand::Move { id: 1, segment })
            .unwrap();
        let mut from = rig.tool();
        rig.servo.tick(0);
        while !rig.port.status().motion.phase.is_over() {
            if rest.lock().unwrap().is_none() {
                rig.servo.tick(0);
                from = rig.tool();
                continue;
            }
            rig.servo.tick(0);
        }
        let (found, foretold) = (rig.tool(), rest.lock().unwrap().unwrap());
        let way = (found - from).norm();
        assert!(way > 0.01, "{way}");
        assert!(
            (found - foretold).norm() < 0.01 * way,
            "{found} {foretold} {way}"
        );
    }
}

#[test]
fn a_tool_that_moves_more_quickly_than_allowed_is_stopped_and_told_with_its_speed() {
    let mut rig = Rig::new();
    let guard = speed::Speed {
        tool: Some(0.1),
        ..speed::Speed::default()
    };
    rig.mount(0, "slow", Reaction::Stop, true, guard);
    let segment = rig.line([0.0, 0.2, 0.0]);
    let (status, _) = rig.go(segment);
    let found = status.ended_by_guard(1).unwrap();
    let text = found.measured.as_str();
    assert!(
        text.starts_with("the tool moves at 0.10") && text.ends_with("the limit is 0.100 m/s"),
        "{text}"
    );
    let start = rig.port.status().setpoint;
    let goal = Translation3::new(0.0, 0.05, 0.0) * rig.planner.tool_pose(&start);
    let slowly = rig.planner.line(&start, &goal, 0.05).unwrap();
    assert_eq!(rig.go(slowly).0.motion.phase, MotionPhase::Done);
}

#[test]
fn the_speed_of_the_tool_is_that_of_the_jacobian() {
    let model = built_in_arm("testbed9");
    let q = [0.3, -0.4, 0.2, 0.5, 0.8, -1.2, 0.4, 0.9, -0.6];
    let qd = [0.2, 0.1, -0.3, 0.5, -0.6, 0.2, 0.9, -0.1, 0.4];
    let mut data = model.data();
    let wanted =
        model.jacobian(&mut data, &q, model.tip()) * nalgebra::DVector::from_row_slice(&qd);
    let tool = model.placement(&mut data, &q, model.tip());
    let seen = Seen {
        model: &model,
        data: &data,
        tool,
        tool_at_rest: tool,
        setpoint: &Setpoint::at_rest(q.into()),
        readings: &[],
        stopping: &Stopping::default(),
        force: None,
        period: 0.0045,
    };
    let (linear, angular) = seen.tool_velocity(|index| qd[index]);
    for axis in 0..3 {
        assert!((linear[axis] - wanted[axis]).abs() < 1e-12);
        assert!((angular[axis] - wanted[3 + axis]).abs() < 1e-12);
    }
}

/// A guard that allows 20 N.
fn fragile(reaction: Reaction) -> Mounted {
    let args = Source::new("recipe", "force = 20.0");
    let args = Node::from_toml(&args, &mut Findings::new());
    let settings = GuardSettings {
        args: &args,
        model: &Arc::new(built_in_arm("puma560")),
        period: Duration::from_micros(4500),
        servo: "servo",
        around: &Nobody,
        cx: None,
    };
    let guard = Force::from_args(&settings).unwrap();
    Mounted::new("fragile", reaction, true, guard)
}

/// An arm with a sensor, which that guard watches, on its way down.
fn touched(force: &Arc<AtomicU64>, reaction: Reaction) -> Rig {
    let mut rig = Rig::driving(Touched::by(force));
    rig.port.mount(0, Some(fragile(reaction))).unwrap();
    let segment = rig.line([0.0, 0.1, -0.2]);
    rig.port
        .order(ServoCommand::Move { id: 1, segment })
        .unwrap();
    rig
}

#[test]
fn two_ticks_after_a_contact_at_most_the_torques_are_other_ones() {
    for contact in [40, 90, 150] {
        let forces = [Arc::default(), Arc::<AtomicU64>::default()];
        let mut rigs = forces
            .each_ref()
            .map(|force| touched(force, Reaction::Stop));
        let mut torques = || {
            rigs.each_mut().map(|rig| {
                rig.servo.tick(0);
                rig.port.status().torque
            })
        };
        for tick in 0..contact {
            let [touched, free] = torques();
            assert_eq!(touched, free, "tick {tick}");
        }
        forces[0].store(30, Ordering::Relaxed);
        let changed = (1..=2).find(|_| {
            let [touched, free] = torques();
            touched != free
        });
        assert!(changed.is_some(), "contact in tick {contact}");
        let found = rigs[0].port.status().guard.unwrap();
        assert_eq!(found.guard.as_str(), "fragile");
    }
}

#[test]
fn a_retreat_from_a_touch_leads_back_to_where_the_arm_was_and_not_to_its_setpoint() {
    for contact in [30, 60, 120] {
        let force = Arc::<AtomicU64>::default();
        let mut rig = touched(&force, Reaction::Retreat);
        let mut measured = Vec::new();
        for _ in 0..contact {
            rig.servo.tick(0);
            measured.push(rig.port.status().position);
        }
        force.store(30, Ordering::Relaxed);
        rig.servo.tick(0);
        let found = rig.port.status().guard.unwrap();
        // A quarter of a second before, in which there are 54 whole ticks; or where the motion began.
        let before = measured[contact.max(54) - 54];
        assert_eq!(found.allowed, before, "contact in tick {contact}");
        assert_ne!(found.allowed, rig.port.status().setpoint);
    }
}

#[test]
fn a_force_that_grows_while_a_motion_settles_ends_it_and_the_setpoint_gives_way() {
    let force = Arc::<AtomicU64>::default();
    let mut rig = touched(&force, Reaction::Stop);
    while rig.port.status().motion.phase != MotionPhase::Settling {
        rig.servo.tick(0);
    }
    let end = rig.port.status().setpoint;
    force.store(30, Ordering::Relaxed);
    rig.servo.tick(0);
    let here = rig.port.status().position;
    assert_ne!(here, end);
    while !rig.port.status().motion.phase.is_over() {
        rig.servo.tick(0);
    }
    let status = rig.port.status();
    assert_eq!(status.motion.phase, MotionPhase::Stopped);
    assert_eq!(status.fault, None);
    let found = status.ended_by_guard(1).unwrap();
    assert!(found.measured.as_str().starts_with("the force is 30.00 N"));
    for (setpoint, here) in status.setpoint.iter().zip(&here) {
        assert!((setpoint - here).abs() < 1e-6);
    }
}
