//! The servo on an arm that obeys the equations of motion.

mod drivers;
mod estop;
mod modes;
mod slots;
mod split;
mod stream;
mod switch;

use std::sync::atomic::Ordering;

use super::*;
use crate::control::{ComputedTorque, PidGravity};
use crate::driver::test_arm::{Knobs, START, TestArm, built_in_arm};
use crate::model::DynamicsOptions;
use crate::trajectory::{CartesianLimits, Planner, Segment};
use nalgebra::Translation3;

const GOAL: [f64; 6] = [-0.6, 1.4, -2.9, -0.4, 0.2, 1.1];
struct Rig {
    servo: Servo,
    port: ServoPort,
    planner: Planner,
    knobs: Arc<Knobs>,
}

impl Rig {
    fn new(true_arm: Model, friction: bool, law: impl ControlLaw + 'static) -> Self {
        let model = Arc::new(built_in_arm("puma560"));
        Self::at((true_arm, model), &START, friction, Box::new(law))
    }

    /// An arm at `start`, and the model that servo and planner have of it.
    fn at(
        (true_arm, model): (Model, Arc<Model>),
        start: &[f64],
        friction: bool,
        law: Box<dyn ControlLaw>,
    ) -> Self {
        let knobs = Arc::new(Knobs::default());
        let arm = TestArm::new(true_arm, start, friction, &knobs);
        let config = ServoConfig::default();
        let (servo, port) = Servo::new(Arc::clone(&model), Box::new(arm), law, config).unwrap();
        let planner = Planner::new(model, CartesianLimits::default(), 0.018).unwrap();
        Self {
            servo,
            port,
            planner,
            knobs,
        }
    }

    fn pid() -> Self {
        Self::new(built_in_arm("puma560"), false, pid())
    }

    fn order(&mut self, command: ServoCommand) {
        self.port.order(command).unwrap();
        self.servo.tick(0);
    }

    fn release(&mut self) {
        self.order(ServoCommand::PowerOn);
        self.order(ServoCommand::ReleaseBrakes);
        assert_eq!(self.port.status().power, Power::Released);
    }

    fn start(&mut self, segment: Segment) {
        let id = self.port.status().motion.id + 1;
        self.order(ServoCommand::Move { id, segment });
    }

    fn plan(&self, speed: f64) -> Segment {
        let start = self.port.status().setpoint;
        self.planner.joint(&start, &GOAL.into(), speed).unwrap()
    }

    /// Largest distance of a joint from its setpoint so many ticks later, rad or m.
    fn off_after(&mut self, ticks: u32) -> f64 {
        (0..ticks).for_each(|_| self.servo.tick(0));
        let status = self.port.status();
        distance(&status.setpoint, &status.position)
    }

    fn run_to_end(&mut self) -> MotionStatus {
        for _ in 0..10_000 {
            self.servo.tick(0);
            let motion = self.port.status().motion;
            if motion.phase.is_over() {
                return motion;
            }
        }
        panic!("the motion never ended");
    }
}

fn pid() -> PidGravity {
    PidGravity::new(Arc::new(built_in_arm("puma560")), 8.0, 1.0)
}

#[test]
fn pid_with_gravity_compensation_tracks_within_the_anchors_four_milliradians() {
    let mut rig = Rig::pid();
    rig.release();
    let segment = rig.plan(0.5);
    let duration = segment.duration();
    rig.start(segment);
    let motion = rig.run_to_end();
    assert_eq!(motion.phase, MotionPhase::Done);
    assert!(motion.max_tracking_error.turning < 4e-3, "{motion:?}");
    assert!(motion.error.turning < 5e-4, "{motion:?}");
    assert_eq!(rig.port.status().setpoint, GOAL);
    let elapsed = motion.elapsed_ticks as f64 * 0.0045;
    assert!(elapsed > duration && elapsed < duration + 1.5);
}

/// Where carts stand, and where they go: m, rad, rad.
const CARTS: [([f64; 3], [f64; 3]); 2] = [
    ([-0.6, 0.1, 0.05], [0.3, -0.5, -0.15]),
    ([0.8, -0.2, 0.0], [0.1, 0.4, 0.1]),
];

/// Largest tracking errors of an arm, or of arms on carts that go or stand, on the way from start to goal at full speed.
fn tracking(
    (name, carts_go): (&str, bool),
    law: fn(Arc<Model>) -> Box<dyn ControlLaw>,
) -> Distances {
    let model = Arc::new(built_in_arm(name));
    let (mut start, mut goal) = (Vec::new(), Vec::new());
    if name == "puma560" {
        (start, goal) = (START.to_vec(), GOAL.to_vec());
    }
    for (from, to) in CARTS.iter().take(model.dof() / 9) {
        start.extend(from.iter().chain(&START));
        goal.extend(if carts_go { to } else { from }.iter().chain(&GOAL));
    }
    let arms = (built_in_arm(name), Arc::clone(&model));
    let mut rig = Rig::at(arms, &start, false, law(Arc::clone(&model)));
    rig.release();
    let from = rig.port.status().setpoint;
    let to = Joints::try_from(&goal[..]).unwrap();
    rig.start(rig.planner.joint(&from, &to, 1.0).unwrap());
    let motion = rig.run_to_end();
    assert_eq!(motion.phase, MotionPhase::Done, "{:?}", rig.port.status());
    assert!(motion.error.largest().1 <= Settling::default().error);
    let status = rig.port.status();
    for (torque, joint) in status.torque.iter().zip(model.joints()) {
        assert!(torque.abs() <= joint.limits.torque);
    }
    // A moment later it is there to 0.05 mrad, and to 0.05 mm.
    assert!(rig.off_after(222) < 5e-5);
    motion.max_tracking_error
}

#[test]
fn any_arm_tracks_within_four_milliradians_and_ten_times_better_with_computed_torque() {
    let with_carts = ["testbed9", "testbed18"];
    let cases = with_carts.map(|name| [(name, false), (name, true)]);
    for case in [("puma560", true)].iter().chain(cases.iter().flatten()) {
        let pid = tracking(*case, |model| Box::new(PidGravity::new(model, 8.0, 1.0)));
        let computed = tracking(*case, |model| {
            let options = DynamicsOptions::WITH_ROTORS;
            Box::new(ComputedTorque::new(model, 8.0, 1.0, options).with_integral())
        });
        assert!(pid.turning < 4e-3, "{case:?}: {pid:?}");
        assert!(pid.sliding < 1e-3, "{case:?}: {pid:?}");
        // A heavy cart is hardly moved by its arm: some micrometres, of which the torque's being held is a share.
        let slides = computed.sliding <= 0.2 * pid.sliding;
        assert!(
            computed.turning < 0.1 * pid.turning && slides,
            "{case:?}: {computed:?} and by PID {pid:?}"
        );
    }
}

#[test]
fn an_arm_on_a_cart_follows_a_straight_line_of_its_tip_and_stops_on_it() {
    let model = Arc::new(built_in_arm("testbed9"));
    let start = [&CARTS[0].0[..], &START].concat();
    let law = Box::new(PidGravity::new(Arc::clone(&model), 8.0, 1.0));
    let mut rig = Rig::at((built_in_arm("testbed9"), model), &start, false, law);
    rig.release();
    let from = rig.port.status().setpoint;
    let first = rig.planner.tool_pose(&from).translation.vector;
    let goal = Translation3::new(0.3, 0.25, -0.1) * rig.planner.tool_pose(&from);
    let along = goal.translation.vector - first;
    for stop_after in [Some(90), None] {
        let from = rig.port.status().setpoint;
        let segment = rig.planner.line(&from, &goal, 0.8).unwrap();
        rig.start(segment);
        let mut before = from;
        for tick in 0..3000 {
            if Some(tick) == stop_after {
                rig.port.order(ServoCommand::Cancel).unwrap();
            }
            rig.servo.tick(0);
            let status = rig.port.status();
            let way = rig.planner.tool_pose(&status.setpoint).translation.vector - first;
            // Between two setpoints the joints follow cubics, which leave the line by a hair.
            let off = (way - along * (way.dot(&along) / along.norm_squared())).norm();
            assert!(off < 1e-4, "tick {tick}: {off} m");
            for (joint, (now, before)) in status.setpoint.iter().zip(&before).enumerate() {
                let limit = rig.planner.model().joints()[joint].limits.velocity;
                assert!(
                    (now - before).abs() <= 1.01 * limit * 0.0045,
                    "joint {joint}"
                );
            }
            before = status.setpoint;
            if status.motion.phase.is_over() {
                break;
            }
        }
        let expected = match stop_after {
            Some(_) => MotionPhase::Stopped,
            None => MotionPhase::Done,
        };
        assert_eq!(rig.port.status().motion.phase, expected);
    }
    let reached = rig.planner.tool_pose(&rig.port.status().position);
    assert!((reached.translation.vector - goal.translation.vector).norm() < 1e-3);
    assert!(reached.rotation.angle_to(&goal.rotation) < 1e-3);
}

#[test]
fn a_joint_that_slides_has_limits_in_metres_of_its_own() {
    let model = Arc::new(built_in_arm("testbed9"));
    let start = [&CARTS[0].0[..], &START].concat();
    let law = Box::new(PidGravity::new(Arc::clone(&model), 8.0, 1.0));
    let mut rig = Rig::at((built_in_arm("testbed9"), model), &start, false, law);
    rig.servo.config.following_error = Distances {
        turning: 3.0,
        sliding: 0.02,
    };
    rig.release();
    let from = rig.port.status().setpoint;
    let mut to = from;
    to[0] += 0.5;
    rig.start(rig.planner.joint(&from, &to, 1.0).unwrap());
    // The track is joint 1.
    rig.knobs.fault.store(4, Ordering::Relaxed);
    assert_eq!(rig.run_to_end().phase, MotionPhase::Failed);
    let fault = rig.port.status().fault.unwrap();
    let text = fault.to_string();
    assert!(
        text.starts_with("joint 1 was 0.02")
            && text.ends_with("m from its setpoint, the limit is 0.0200 m"),
        "{text}"
    );
}

#[test]
fn with_a_tenth_more_mass_and_dry_friction_an_arm_still_settles_through_the_integral_of_its_law() {
    let model = Arc::new(built_in_arm("puma560"));
    let pid: fn(Arc<Model>) -> Box<dyn ControlLaw> =
        |model| Box::new(PidGravity::new(model, 8.0, 1.0));
    let computed: fn(Arc<Model>) -> Box<dyn ControlLaw> = |model| {
        let law = ComputedTorque::new(model, 8.0, 1.0, DynamicsOptions::WITH_ROTORS);
        Box::new(law.with_integral())
    };
    let cases = [(pid, 0.5), (pid, 1.0), (computed, 0.5), (computed, 1.0)];
    let found = cases.map(|(law, speed)| {
        let heavy = built_in_arm("puma560").with_joints(|_, joint| {
            joint.body.mass *= 1.1;
            joint.body.inertia *= 1.1;
        });
        let law = law(Arc::clone(&model));
        let mut rig = Rig::at((heavy, Arc::clone(&model)), &START, true, law);
        rig.release();
        let segment = rig.plan(speed);
        rig.start(segment);
        let motion = rig.run_to_end();
        let status = rig.port.status();
        assert_eq!(motion.phase, MotionPhase::Done, "{motion:?} {status:?}");
        // A joint that sticks is let go by the integral now and then, a little too far.
        [motion.max_tracking_error.turning, rig.off_after(222)]
    });
    // As `docs/mcs-states.md` says, rad.
    let within = |[moving, later]: &[f64; 2]| *moving < 1e-2 && *later < 1e-3;
    assert!(found.iter().all(within), "{found:?}");
}

#[test]
fn a_straight_line_is_followed_to_its_end() {
    let mut rig = Rig::pid();
    rig.release();
    let goal = Translation3::new(0.05, 0.25, -0.1) * rig.planner.tool_pose(&START);
    let from = rig.port.status().setpoint;
    let segment = rig.planner.line(&from, &goal, 0.8).unwrap();
    rig.start(segment);
    let motion = rig.run_to_end();
    assert_eq!(motion.phase, MotionPhase::Done);
    let reached = rig.planner.tool_pose(&rig.port.status().position);
    assert!((reached.translation.vector - goal.translation.vector).norm() < 1e-3);
}

/// Runs `ticks` of a motion and then `then`, and checks every setpoint on the way to rest.
fn stop_within_limits(ticks: u32, then: ServoCommand) -> (Rig, Segment, f64) {
    let mut rig = Rig::pid();
    rig.release();
    let segment = rig.plan(1.0);
    rig.start(segment);
    for _ in 0..ticks {
        rig.servo.tick(0);
    }
    let mut then = Some(then);
    let mut history = Vec::new();
    for _ in 0..1500 {
        if let Some(command) = then.take() {
            rig.port.order(command).unwrap();
        }
        rig.servo.tick(0);
        history.push(rig.port.status().setpoint);
        if rig.port.status().at_rest {
            break;
        }
    }
    let mut still_after = 0.0;
    for (index, triple) in history.windows(3).enumerate() {
        for (joint, own) in rig.planner.model().joints().iter().enumerate() {
            let limit = &own.limits;
            let [a, b, c] = [0, 1, 2].map(|at: usize| triple[at][joint]);
            assert!((c - b).abs() / 0.0045 <= limit.velocity * (1.0 + 1e-9) + 1e-9);
            let acceleration = (c - 2.0 * b + a) / (0.0045 * 0.0045);
            assert!(
                acceleration.abs() <= limit.acceleration * (1.0 + 1e-9) + 1e-6,
                "joint {joint}: {acceleration}"
            );
            if c != b {
                still_after = index as f64 * 0.0045;
            }
        }
    }
    (rig, segment, still_after)
}

#[test]
fn a_protective_stop_brakes_on_the_path_within_limits_and_then_holds() {
    for ticks in [1, 30, 57, 90, 130] {
        let (mut rig, segment, braking) = stop_within_limits(ticks, ServoCommand::Stop);
        let status = rig.port.status();
        assert!(status.at_rest);
        assert_eq!(status.power, Power::Released);
        assert_eq!(status.motion.phase, MotionPhase::Stopped);
        // Closed form: top speed over acceleration of the joint that brakes longest, and what gains speed at first. And no
        // longer than the motion had still to go.
        assert!(braking <= 1.5 / 12.0 + 0.2 + 0.036, "{braking}");
        let left = segment.duration() - f64::from(ticks) * 0.0045;
        assert!(braking <= left.max(0.0) + 0.009, "{braking} {left}");
        // At rest it is on the path: where joint 1 is at some time, all others are too.
        let mut solver = Solver::new(Arc::clone(rig.planner.model())).unwrap();
        let mut at = |t: f64| segment.at(&mut solver, t, &START).unwrap().position;
        let (mut low, mut high) = (0.0, segment.duration());
        for _ in 0..60 {
            let middle = 0.5 * (low + high);
            let gone = (at(middle)[0] - START[0]) / (status.setpoint[0] - START[0]);
            (low, high) = if gone < 1.0 {
                (middle, high)
            } else {
                (low, middle)
            };
        }
        let there = at(low);
        let pairs = there.iter().zip(&status.setpoint);
        assert!(
            pairs.clone().all(|(a, b)| (a - b).abs() < 1e-6),
            "{there:?} {status:?}"
        );
        let held = status.setpoint;
        rig.servo.tick(0);
        assert_eq!(rig.port.status().setpoint, held);
    }
}

#[test]
fn power_off_in_a_motion_stops_first_then_brakes_then_cuts_the_power() {
    let (rig, ..) = stop_within_limits(60, ServoCommand::PowerOff);
    let status = rig.port.status();
    assert_eq!(status.power, Power::Off);
    assert!(status.at_rest);
    assert_eq!(status.motion.phase, MotionPhase::Stopped);
}

#[test]
fn a_controlled_stop_keeps_the_power_until_the_arm_rests_and_then_latches_it_off() {
    for ticks in [1, 30, 57, 90, 130] {
        let (mut rig, ..) = stop_within_limits(ticks, ServoCommand::ControlledStop);
        let status = rig.port.status();
        assert_eq!(status.power, Power::Off);
        assert_eq!(status.fault, Some(Fault::ControlledStop));
        assert!(status.velocity.iter().all(|speed| speed.abs() < 5e-3));
        let error = status.motion.error.turning;
        assert!(error < 5e-4, "power went off {error} rad from the setpoint");
        rig.order(ServoCommand::PowerOn);
        assert_eq!(rig.port.status().power, Power::Off);
        rig.order(ServoCommand::Reset);
        rig.release();
    }
}

#[test]
fn a_controlled_stop_that_cannot_brake_ends_as_an_emergency() {
    let mut rig = Rig::pid();
    rig.release();
    let segment = rig.plan(1.0);
    rig.start(segment);
    for _ in 0..60 {
        rig.servo.tick(0);
    }
    rig.order(ServoCommand::ControlledStop);
    assert_eq!(rig.port.status().power, Power::Released);
    rig.knobs.fault.store(1, Ordering::Relaxed);
    rig.servo.tick(0);
    let status = rig.port.status();
    assert_eq!(
        (status.power, status.fault),
        (Power::Off, Some(Fault::Driver))
    );
}

#[test]
fn a_driver_fault_cuts_power_in_the_same_tick_and_stays_until_reset() {
    for (knob, expected) in [
        (1, Fault::Driver),
        (2, Fault::Driver),
        (3, Fault::Reading { joint: 5 }),
    ] {
        let mut rig = Rig::pid();
        rig.release();
        let segment = rig.plan(1.0);
        rig.start(segment);
        for _ in 0..50 {
            rig.servo.tick(0);
        }
        rig.knobs.fault.store(knob, Ordering::Relaxed);
        rig.servo.tick(0);
        let status = rig.port.status();
        assert_eq!(status.power, Power::Off);
        assert_eq!(status.fault, Some(expected));
        assert_eq!(status.motion.phase, MotionPhase::Failed);
        if expected == Fault::Driver {
            assert!(
                rig.port
                    .driver_error()
                    .unwrap()
                    .to_string()
                    .contains("cable out")
            );
        }
        rig.knobs.fault.store(0, Ordering::Relaxed);
        let writes = rig.knobs.writes_under_power.load(Ordering::Relaxed);
        rig.order(ServoCommand::PowerOn);
        rig.order(ServoCommand::ReleaseBrakes);
        assert_eq!(rig.port.status().power, Power::Off);
        rig.order(ServoCommand::Reset);
        assert_eq!(rig.port.status().power, Power::Off);
        assert_eq!(rig.knobs.writes_under_power.load(Ordering::Relaxed), writes);
        // After the reset the arm is held where it is, not where it was once sent.
        rig.release();
        let status = rig.port.status();
        let pairs = status.setpoint.iter().zip(&status.position);
        assert!(pairs.clone().all(|(a, b)| (a - b).abs() < 1e-9));
    }
}

#[test]
fn a_blocked_joint_is_an_emergency_that_names_joint_error_and_limit() {
    let mut rig = Rig::pid();
    rig.release();
    let segment = rig.plan(1.0);
    rig.start(segment);
    rig.knobs.fault.store(4, Ordering::Relaxed);
    let motion = rig.run_to_end();
    assert_eq!(motion.phase, MotionPhase::Failed);
    let fault = rig.port.status().fault.unwrap();
    assert!(
        matches!(fault, Fault::FollowingError { joint: 1, .. }),
        "{fault}"
    );
}

#[test]
fn a_joint_outside_its_window_for_too_long_does_not_follow_and_power_goes_off() {
    let mut rig = Rig::pid();
    rig.release();
    // So slow that the limit for an emergency is reached long after the time-out.
    let segment = rig.plan(0.02);
    rig.start(segment);
    rig.knobs.fault.store(4, Ordering::Relaxed);
    let mut away = 0;
    let motion = loop {
        rig.servo.tick(0);
        let status = rig.port.status();
        let error = (status.setpoint[0] - status.position[0]).abs();
        away += u32::from(error > 0.03);
        assert!(error < 0.1, "the emergency limit came first");
        if status.motion.phase.is_over() {
            break status.motion;
        }
    };
    assert_eq!(motion.phase, MotionPhase::Failed);
    let status = rig.port.status();
    assert_eq!(status.power, Power::Off);
    assert_eq!(status.torque, [0.0; 6]);
    let fault = status.fault.unwrap();
    assert!(
        matches!(fault, Fault::NotFollowing { joint: 1, .. }),
        "{fault}"
    );
    // 100 ms in periods of 4.5 ms, and the tick that finds it over.
    assert_eq!(away, 23);
}

#[test]
fn an_arm_that_does_not_settle_is_a_fault_and_not_pressed_against_its_target() {
    let mut rig = Rig::pid();
    rig.servo.config.following_timeout = Duration::from_secs(100);
    rig.servo.patience = u32::MAX;
    rig.release();
    let mut near = Joints::from(START);
    near[0] += 0.02;
    let segment = rig
        .planner
        .joint(&rig.port.status().setpoint, &near, 0.5)
        .unwrap();
    rig.knobs.fault.store(4, Ordering::Relaxed);
    rig.start(segment);
    assert_eq!(rig.run_to_end().phase, MotionPhase::Failed);
    let status = rig.port.status();
    assert_eq!(status.power, Power::Off);
    assert!(
        matches!(status.fault, Some(Fault::NotSettled { .. })),
        "{:?}",
        status.fault
    );
}

#[test]
fn no_segment_is_taken_while_a_protective_stop_holds() {
    let (mut rig, ..) = stop_within_limits(60, ServoCommand::Stop);
    assert!(rig.port.status().stopped);
    let segment = rig.plan(0.5);
    rig.order(ServoCommand::Move { id: 9, segment });
    assert_eq!(rig.port.status().rejected, Some((9, Rejection::Stopped)));
    rig.order(ServoCommand::Resume);
    rig.order(ServoCommand::Move { id: 10, segment });
    assert_eq!(rig.run_to_end().phase, MotionPhase::Done);
}

#[test]
fn an_emergency_stop_gets_through_a_full_queue() {
    let mut rig = Rig::pid();
    rig.release();
    while rig.port.order(ServoCommand::Stop).is_ok() {}
    rig.port.emergency_stop();
    rig.servo.tick(0);
    let status = rig.port.status();
    assert_eq!(
        (status.power, status.fault),
        (Power::Off, Some(Fault::EmergencyStop))
    );
}

#[test]
fn a_segment_is_taken_only_with_brakes_released_and_from_where_the_arm_is_or_will_be() {
    let mut rig = Rig::pid();
    let rejected = |rig: &Rig| rig.port.status().rejected;
    let segment = rig.plan(0.5);
    rig.start(segment);
    assert_eq!(rejected(&rig), Some((1, Rejection::NotReleased)));
    rig.release();
    let elsewhere = rig.planner.joint(&GOAL.into(), &START.into(), 0.5).unwrap();
    rig.order(ServoCommand::Move {
        id: 2,
        segment: elsewhere,
    });
    assert_eq!(rejected(&rig), Some((2, Rejection::StartsElsewhere)));
    let segment = rig.plan(0.5);
    rig.order(ServoCommand::Move { id: 3, segment });
    rig.order(ServoCommand::Move { id: 4, segment });
    assert_eq!(rejected(&rig), Some((4, Rejection::StartsElsewhere)));
    // The motion under way is not disturbed and still reported under its own number.
    let motion = rig.run_to_end();
    assert_eq!((motion.id, motion.phase), (3, MotionPhase::Done));
}

/// There and back and there, of which the second and the third may wait.
fn there_and_back(rig: &mut Rig, blend: f64) -> [ServoCommand; 3] {
    let aside = Joints::from_fn(6, |index| GOAL[index] + 0.3);
    let ends = [START.into(), GOAL.into(), aside, START.into()];
    let segment = |index: usize| rig.planner.joint(&ends[index], &ends[index + 1], 0.8);
    let segments = [0, 1, 2].map(|index| segment(index).unwrap());
    [0, 1, 2].map(|index| {
        let (id, segment) = (index as u64 + 1, segments[index]);
        let before = index.checked_sub(1).map(|before| &segments[before]);
        let bridge = before.and_then(|before| {
            let pace = crate::trajectory::Pace::from(0.8);
            rig.planner.bridge((before, &segment), pace, blend)
        });
        match bridge {
            Some(bridge) => ServoCommand::MoveOver {
                id,
                segment,
                bridge,
            },
            None => ServoCommand::Move { id, segment },
        }
    })
}

#[test]
fn segments_that_wait_are_followed_in_their_order_with_a_stop_between_or_over_bridges() {
    let mut took = [0; 2];
    for (took, blend) in took.iter_mut().zip([0.0, 0.6]) {
        let mut rig = Rig::pid();
        rig.release();
        for order in there_and_back(&mut rig, blend) {
            rig.order(order);
        }
        let mut rests = 0;
        let mut before = rig.port.status();
        while rig.port.status().ended.of(3).is_none() {
            rig.servo.tick(0);
            let status = rig.port.status();
            rests += u32::from(
                status.motion.phase == MotionPhase::Settling
                    && before.motion.phase == MotionPhase::Moving,
            );
            assert!(status.motion.id >= before.motion.id);
            for (joint, own) in rig.planner.model().joints().iter().enumerate() {
                let moved = (status.setpoint[joint] - before.setpoint[joint]).abs();
                assert!(moved <= own.limits.velocity * 0.0045 * (1.0 + 1e-9) + 1e-9);
            }
            before = status;
            *took += 1;
            assert!(*took < 5000, "{status:?}");
        }
        assert_eq!(rests, if blend > 0.0 { 1 } else { 3 });
        let status = rig.port.status();
        for id in 1..=3 {
            assert_eq!(status.ended.of(id).unwrap().phase, MotionPhase::Done);
        }
        assert!(distance(&status.setpoint, &START.into()) < 1e-9);
    }
    assert!(took[1] + 100 < took[0], "{took:?}");
}

#[test]
fn what_ends_a_motion_ends_those_that_wait_and_a_queue_that_is_full_says_so() {
    for stop in [
        ServoCommand::Stop,
        ServoCommand::Cancel,
        ServoCommand::EmergencyStop,
        ServoCommand::PowerOff,
    ] {
        let mut rig = Rig::pid();
        rig.release();
        for order in there_and_back(&mut rig, 0.5) {
            rig.order(order);
        }
        let here = rig
            .planner
            .joint(&START.into(), &START.into(), 0.5)
            .unwrap();
        for id in 4..=QUEUE as u64 + 1 {
            rig.order(ServoCommand::Move { id, segment: here });
        }
        let full = rig.port.status().ended;
        let rejected = MotionPhase::Rejected(Rejection::Full);
        assert_eq!(full.of(QUEUE as u64 + 1).unwrap().phase, rejected);
        for _ in 0..60 {
            rig.servo.tick(0);
        }
        let expected = match stop {
            ServoCommand::EmergencyStop => MotionPhase::Failed,
            _ => MotionPhase::Stopped,
        };
        rig.order(stop);
        rig.order(ServoCommand::Move {
            id: 20,
            segment: here,
        });
        rig.run_to_end();
        let ended = rig.port.status().ended;
        for id in 1..=QUEUE as u64 {
            assert_eq!(ended.of(id).unwrap().phase, expected, "{id}");
        }
        assert!(matches!(
            ended.of(20).unwrap().phase,
            MotionPhase::Rejected(_)
        ));
        assert_eq!(ended.newest(), 20);
    }
}

#[test]
fn a_motion_of_no_length_is_done_at_once_and_settles() {
    let mut rig = Rig::pid();
    rig.release();
    let here = rig.port.status().setpoint;
    let segment = rig.planner.joint(&here, &here, 0.5).unwrap();
    rig.start(segment);
    assert_eq!(rig.run_to_end().phase, MotionPhase::Done);
}

#[test]
fn the_same_orders_give_the_same_bits() {
    let run = || {
        let mut rig = Rig::pid();
        rig.release();
        let segment = rig.plan(0.7);
        rig.start(segment);
        rig.run_to_end();
        rig.port.status()
    };
    assert_eq!(run(), run());
}

#[test]
fn a_driver_with_other_slots_or_a_period_of_zero_is_refused() {
    struct Lamp;
    impl ChannelDriver for Lamp {
        fn slots(&self) -> usize {
            1
        }
        fn read(&mut self, _: &mut [SlotReading]) -> Result<(), DriverError> {
            Ok(())
        }
        fn write(&mut self, _: &[f64], _: Power, _: Duration) -> Result<(), DriverError> {
            Ok(())
        }
    }
    let model = Arc::new(built_in_arm("puma560"));
    let config = ServoConfig::default();
    let refused = Servo::new(model, Box::new(Lamp), Box::new(pid()), config).err();
    let slots = ServoError::Slots {
        found: 1,
        needed: 6,
    };
    assert_eq!(refused, Some(slots));
}
