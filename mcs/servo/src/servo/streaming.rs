//! How a servo follows a stream: it is begun, followed in each period, and ended.

use super::Servo;
use super::blend::Blend;
use super::motion::{Motion, Progress};
use super::port::{Fault, MotionPhase, MotionStatus, Rejection};
use super::stream::{Stream, StreamKind};
use crate::driver::{Mode, Power};
use crate::joints::Joints;
use crate::words;

impl Servo {
    /// Begins the streams that were ordered, as far as the present state allows.
    pub(super) fn take_streams(&mut self) {
        while let Some(mut stream) = self.streams.next() {
            let direct = matches!(stream.how().kind, StreamKind::Torques { .. });
            let other = |mode: &Mode| *mode != Mode::Torque;
            let rejection = match self.status.power {
                _ if direct && self.driver.modes().iter().any(other) => Some(Rejection::NoTorque),
                _ if self.stream.is_some() => Some(Rejection::Streaming),
                _ if self.motion.is_some() => Some(Rejection::Moving),
                _ if self.status.stopped => Some(Rejection::Stopped),
                Power::Released if self.after_rest.is_none() => self.stale(),
                _ => Some(Rejection::NotReleased),
            };
            if let Some(rejection) = rejection {
                self.status.stream_rejected = Some((stream.how().serial, rejection));
                self.streams.retire(stream);
                continue;
            }
            let held = self.setpoint.position;
            stream.begin(&held, &mut self.solver, self.config.limit_jerk);
            self.guards
                .begin(&self.setpoint.position, stream.how().guards);
            self.status.stream = stream.status();
            self.status.motion = MotionStatus {
                id: self.status.motion.id.max(self.status.ended.newest()) + 1,
                phase: MotionPhase::Moving,
                ..MotionStatus::default()
            };
            self.motion = Some(Motion::new(self.config.settling));
            self.stream = Some(stream);
        }
    }

    /// One period of the stream under way.
    pub(super) fn advance_stream(&mut self, mut motion: Motion, mut stream: Box<Stream>) {
        let period = self.config.period.as_secs_f64();
        let measured = (&self.status.position, &self.status.velocity);
        self.setpoint = stream.setpoint(&mut self.solver, measured, period);
        self.status.stream = stream.status();
        let ends = (stream.rests(), stream.is_ending());
        let model = self.solver.model();
        let progress = motion.settle(model, &self.setpoint, &self.readings, ends);
        motion.report(ends, &mut self.status.motion);
        self.stream = Some(stream);
        match progress {
            Progress::Going => self.motion = Some(motion),
            Progress::Finished(phase) => self.end_stream(phase),
            Progress::NotSettled => {
                let fault = self.not_settled(&motion);
                self.motion = Some(motion);
                self.fail(fault);
            }
        }
    }

    /// The stream under way has ended.
    pub(super) fn end_stream(&mut self, phase: MotionPhase) {
        self.status.motion.phase = phase;
        if let Some(stream) = self.stream.take() {
            self.streams.retire(stream);
        }
    }

    /// A stream ends with the power.
    pub(super) fn fail_stream(&mut self, fault: Fault) {
        if self.stream.is_some() {
            let why = || words!("{fault}");
            self.status.stream.end.get_or_insert_with(why);
            self.end_stream(MotionPhase::Failed);
        }
    }

    /// The torques of this tick where a stream gives them, at first blended with those of the law.
    pub(super) fn direct_torques(&mut self) -> Option<Joints> {
        let stream = self.stream.as_mut();
        let model = self.solver.model();
        let torques = stream.and_then(|stream| stream.torques(model, &self.status.position));
        let was_direct = std::mem::replace(&mut self.direct, torques.is_some());
        match (&torques, was_direct) {
            (Some(torques), false) => {
                let before = &self.status.torque;
                self.blend = Blend::between(before, torques, self.config.period);
            }
            // The arm brakes: at once, and not as the stream would have it.
            (None, true) => {
                self.blend = Blend::default();
                self.law.reset(&self.readings);
            }
            _ => {}
        }
        torques
    }
}
