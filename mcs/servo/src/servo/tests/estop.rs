//! Emergency stops at any moment: on segments of any shape and on bridges, while a motion settles, while another stop brakes or
//! holds, and on a stream.

use nalgebra::{Isometry3, Vector3};

use super::*;

/// Ticks after which the stop that a scenario has is ordered: the second segment is under way.
const STOPS: u32 = 120;
/// Every so many ticks of a scenario there is an emergency stop: no multiple of any period.
const APART: usize = 7;

/// Three motions, blended, and a stop of another kind on their way; up to some tick.
fn until(tick: u32, stop: Option<&ServoCommand>) -> Rig {
    let mut rig = Rig::pid();
    rig.release();
    for order in there_and_back(&mut rig, 0.6) {
        rig.port.order(order).unwrap();
    }
    for number in 0..tick {
        if let (STOPS, Some(stop)) = (number, stop) {
            rig.port.order(stop.clone()).unwrap();
        }
        rig.servo.tick(0);
    }
    rig
}

/// An emergency stop takes the power in its tick. No order moves anything before a reset, and after it the arm is held where it is.
/// `told` sees the status of that tick.
#[track_caller]
pub(super) fn must_lose_power(rig: &mut Rig, at: &str, told: impl Fn(&ServoStatus)) {
    let before = rig.port.status();
    let under_power = |rig: &Rig| rig.knobs.writes_under_power.load(Ordering::Relaxed);
    let writes = under_power(rig);
    rig.port.emergency_stop();
    rig.servo.tick(0);
    let stopped = rig.port.status();
    let latched = before.fault.unwrap_or(Fault::EmergencyStop);
    assert_eq!(
        (stopped.power, stopped.fault),
        (Power::Off, Some(latched)),
        "{at}"
    );
    let last = *rig.knobs.last_write.lock().unwrap();
    assert_eq!(last, Some((Power::Off, Joints::zeros(6))), "{at}");
    told(&stopped);
    let here = stopped.position;
    let segment = rig.planner.joint(&here, &START.into(), 0.5).unwrap();
    for order in [
        ServoCommand::Resume,
        ServoCommand::PowerOn,
        ServoCommand::ReleaseBrakes,
        ServoCommand::Move { id: 9, segment },
    ] {
        rig.order(order);
    }
    let status = rig.port.status();
    assert_eq!((status.power, status.position), (Power::Off, here), "{at}");
    assert_eq!(under_power(rig), writes, "{at}");
    rig.order(ServoCommand::Reset);
    assert_eq!(rig.port.status().power, Power::Off, "{at}");
    // Held where it is, and not sent on.
    rig.release();
    for _ in 0..20 {
        rig.servo.tick(0);
    }
    let status = rig.port.status();
    assert!(distance(&status.position, &here) < 2e-4, "{at}");
    assert!(distance(&status.setpoint, &here) < 1e-9, "{at}");
}

#[test]
fn an_emergency_stop_at_any_moment_takes_the_power_in_its_tick_and_nothing_moves_before_a_reset() {
    let mut met = Vec::new();
    for (stop, ticks) in [
        (None, 620),
        (Some(ServoCommand::Stop), 220),
        (Some(ServoCommand::Cancel), 220),
        (Some(ServoCommand::ControlledStop), 220),
        (Some(ServoCommand::EngageBrakes), 220),
        (Some(ServoCommand::PowerOff), 220),
    ] {
        let first = if stop.is_some() { STOPS } else { 0 };
        for tick in (first..ticks).step_by(APART) {
            let mut rig = until(tick, stop.as_ref());
            let before = rig.port.status();
            met.push((before.motion.phase, before.power));
            let at = format!("{stop:?}, tick {tick}");
            must_lose_power(&mut rig, &at, |stopped| {
                // What had not ended before is told, and not as a success.
                for id in 1..=3 {
                    let ended = |status: &ServoStatus| status.ended.of(id).map(|ended| ended.phase);
                    match ended(&before) {
                        Some(phase) => assert_eq!(ended(stopped), Some(phase), "{at}"),
                        None => assert_eq!(ended(stopped), Some(MotionPhase::Failed), "{at}"),
                    }
                }
            });
        }
    }
    for wanted in [
        (MotionPhase::Moving, Power::Released),
        (MotionPhase::Settling, Power::Released),
        (MotionPhase::Done, Power::Released),
        (MotionPhase::Stopped, Power::Released),
        (MotionPhase::Stopped, Power::Braked),
        (MotionPhase::Stopped, Power::Off),
    ] {
        assert!(met.contains(&wanted), "{wanted:?} was not met: {met:?}");
    }
}

#[test]
fn an_emergency_stop_on_a_line_an_arc_or_an_arch_takes_the_power_in_its_tick_with_any_law() {
    let shapes: [fn(&mut Planner) -> Segment; 3] = [
        |planner| {
            let goal = aside(planner);
            planner.line(&START.into(), &goal, 0.5).unwrap()
        },
        |planner| {
            let goal = aside(planner);
            let via = planner.tool_pose(&START).translation.vector;
            let via = 0.5 * (via + goal.translation.vector) + Vector3::new(0.0, 0.0, -0.05);
            let arc = planner.arc_through(&START.into(), (via, &goal), 0.5);
            arc.unwrap()
        },
        |planner| {
            let goal = aside(planner);
            let arch = planner.arch(&START.into(), (0.02, None, &goal), 0.5);
            arch.unwrap()
        },
    ];
    let model = Arc::new(built_in_arm("puma560"));
    let computed = || {
        let options = DynamicsOptions::WITH_ROTORS;
        ComputedTorque::new(Arc::clone(&model), 8.0, 1.0, options)
    };
    let rigs: [&dyn Fn() -> Rig; 2] = [&Rig::pid, &|| {
        Rig::new(built_in_arm("puma560"), false, computed())
    }];
    for (number, shape) in shapes.iter().enumerate() {
        for (law, new) in rigs.iter().enumerate() {
            let mut moving = 0;
            for ticks in (0..400).step_by(4 * APART) {
                let mut rig = new();
                rig.servo.config.limit_jerk = law == 1;
                rig.release();
                let segment = shape(&mut rig.planner);
                rig.order(ServoCommand::Move { id: 1, segment });
                for _ in 0..ticks {
                    rig.servo.tick(0);
                }
                let before = rig.port.status();
                let moves = before.motion.phase == MotionPhase::Moving;
                moving += u32::from(moves);
                let at = format!("shape {number}, law {law}, tick {ticks}");
                must_lose_power(&mut rig, &at, |stopped| {
                    let ended = stopped.ended.of(1).map(|ended| ended.phase);
                    assert!(!moves || ended == Some(MotionPhase::Failed), "{at}");
                });
            }
            assert!(moving > 3, "shape {number}, law {law}: {moving}");
        }
    }
}

/// Beside where the tool is at the start.
fn aside(planner: &mut Planner) -> Isometry3<f64> {
    Translation3::new(0.1, 0.1, -0.15) * planner.tool_pose(&START)
}
