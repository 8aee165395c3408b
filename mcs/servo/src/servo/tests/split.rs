//! A law of two halves: what it gives, and what happens when one half is late or gone.

use super::*;
use crate::control::split_torque::{Exchange, Half, PATIENCE, SplitTorque};

struct Split {
    rig: Rig,
    half: Half,
}

/// An arm that is released, under a law whose other half the test ticks.
fn released() -> Split {
    let model = Arc::new(built_in_arm("puma560"));
    let exchange = Exchange::new(6);
    let law = SplitTorque::new(Arc::clone(&model), 8.0, 1.0, Arc::clone(&exchange));
    let mut half = Half::new(model, exchange);
    let mut rig = Rig::new(built_in_arm("puma560"), false, law);
    rig.order(ServoCommand::PowerOn);
    rig.order(ServoCommand::ReleaseBrakes);
    half.tick();
    Split { rig, half }
}

impl Split {
    fn begin(&mut self) {
        let segment = self.rig.plan(0.5);
        self.rig.start(segment);
        self.half.tick();
    }

    fn tick(&mut self, answers: bool) -> ServoStatus {
        self.rig.servo.tick(0);
        if answers {
            self.half.tick();
        }
        self.rig.port.status()
    }
}

#[test]
fn a_law_of_two_halves_tracks_nearly_as_well_as_one_of_one_piece() {
    let mut split = released();
    split.begin();
    while !split.tick(true).motion.phase.is_over() {}
    let motion = split.rig.port.status().motion;
    assert_eq!(motion.phase, MotionPhase::Done);
    // A tenth of what PID with gravity is allowed.
    assert!(motion.max_tracking_error.turning < 4e-4, "{motion:?}");
}

#[test]
fn while_a_half_is_late_the_arm_goes_on_and_when_it_is_gone_the_arm_stops_and_says_so() {
    let mut split = released();
    split.begin();
    for tick in 0..60 {
        // Late by as much as it may be, again and again.
        let status = split.tick(tick % (PATIENCE + 1) == 0);
        assert_eq!(status.fault, None, "tick {tick}");
    }
    assert_eq!(split.tick(true).motion.phase, MotionPhase::Moving);
    let gone = (1..=100).find(|_| split.tick(false).fault.is_some());
    assert_eq!(gone, Some(PATIENCE + 2));
    let status = split.rig.port.status();
    assert_eq!(status.power, Power::Off);
    assert_eq!(status.motion.phase, MotionPhase::Failed);
    let fault = status.fault.unwrap().to_string();
    assert!(
        fault.contains("gave up: its half on the other processor has not answered for 4 ticks"),
        "{fault}"
    );
    // It stands. After a reset, with both halves there, it goes on.
    let rested = (0..50).map(|_| split.tick(true).at_rest).last();
    assert_eq!(rested, Some(true));
    for command in [
        ServoCommand::Reset,
        ServoCommand::PowerOn,
        ServoCommand::ReleaseBrakes,
    ] {
        split.rig.order(command);
        split.half.tick();
    }
    split.begin();
    while !split.tick(true).motion.phase.is_over() {}
    let motion = split.rig.port.status().motion;
    assert_eq!(motion.phase, MotionPhase::Done);
}

#[test]
fn an_answer_to_a_law_before_this_one_is_none() {
    let model = Arc::new(built_in_arm("puma560"));
    let exchange = Exchange::new(6);
    let mut half = Half::new(Arc::clone(&model), Arc::clone(&exchange));
    let setpoint = Setpoint::at_rest(START.into());
    let readings = START.map(|position| SlotReading {
        position,
        velocity: 0.0,
    });
    let (mut out, period) = ([0.0; 6], ServoConfig::default().period);
    let law = || SplitTorque::new(Arc::clone(&model), 8.0, 1.0, Arc::clone(&exchange));
    let mut before = law();
    for _ in 0..100 {
        before.torques(&setpoint, &readings, period, &mut out);
        half.tick();
    }
    let mut next = law();
    // The hundredth answer of the law before lies there.
    let ticks = (1..=100).find(|_| {
        next.torques(&setpoint, &readings, period, &mut out);
        next.gave_up().is_some()
    });
    assert_eq!(ticks, Some(PATIENCE + 3));
}
