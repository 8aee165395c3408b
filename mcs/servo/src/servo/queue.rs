//! The segments that are under way and wait: how they begin, follow one another and end.

use super::motion::{Motion, Progress};
use super::port::{Fault, MotionPhase, MotionStatus, QUEUE, Rejection};
use super::{START_TOLERANCE, Servo, distance};
use crate::driver::Power;
use crate::trajectory::{Bridge, Segment};

impl Servo {
    pub(super) fn begin(&mut self, id: u64, segment: Segment, bridge: Option<Bridge>) {
        let before = self.follower.end(&mut self.solver).ok().flatten();
        let from = before.unwrap_or(self.setpoint.position);
        let rejection = match segment.at(&mut self.solver, 0.0, &from) {
            _ if self.status.power != Power::Released || self.after_rest.is_some() => {
                Some(Rejection::NotReleased)
            }
            _ if self.status.stopped => Some(Rejection::Stopped),
            _ if self.stream.is_some() => Some(Rejection::Streaming),
            _ if self.motion.is_some() && self.follower.is_stopping() => Some(Rejection::Busy),
            _ if self.status.stale != 0 => self.stale(),
            _ if self.follower.len() >= QUEUE => Some(Rejection::Full),
            Err(_) => Some(Rejection::Unfit),
            Ok(start) if distance(&start.position, &from) > START_TOLERANCE => {
                Some(Rejection::StartsElsewhere)
            }
            Ok(_) => None,
        };
        if let Some(rejection) = rejection {
            self.status.rejected = Some((id, rejection));
            self.status.ended.push(MotionStatus {
                id,
                phase: MotionPhase::Rejected(rejection),
                ..MotionStatus::default()
            });
            return;
        }
        self.follower.push(segment, bridge);
        self.ids.push_back((id, self.guards.named()));
        if self.motion.is_none() {
            self.motion = Some(self.first_in_queue());
        }
    }

    /// The segment that is now first in the queue.
    fn first_in_queue(&mut self) -> Motion {
        let (id, guards) = self.ids.front().copied().unwrap_or_default();
        self.guards.begin(&self.setpoint.position, guards);
        self.status.motion = MotionStatus {
            id,
            phase: MotionPhase::Moving,
            ..MotionStatus::default()
        };
        Motion::new(self.config.settling)
    }

    /// The segment that was first in the queue has ended.
    pub(super) fn ended(&mut self, phase: MotionPhase) {
        self.status.motion.phase = phase;
        self.status.ended.push(self.status.motion);
        self.ids.pop_front();
    }

    /// What waits is not begun any more.
    pub(super) fn drop_queue(&mut self, phase: MotionPhase) {
        self.follower.clear();
        while let Some((id, _)) = self.ids.pop_front() {
            self.status.ended.push(MotionStatus {
                id,
                phase,
                ..MotionStatus::default()
            });
        }
    }

    /// One period of the segment under way.
    pub(super) fn advance_queue(&mut self, mut motion: Motion) {
        let passed = self.follower.passed();
        if !self.follower.rests() {
            match self
                .follower
                .next(&mut self.solver, &self.setpoint.position)
            {
                Ok(setpoint) => self.setpoint = setpoint,
                Err(_) => {
                    self.motion = Some(motion);
                    return self.fail(Fault::Segment);
                }
            }
        }
        let ends = (self.follower.rests(), self.follower.is_stopping());
        let model = self.solver.model();
        let progress = motion.settle(model, &self.setpoint, &self.readings, ends);
        for _ in passed..self.follower.passed() {
            motion.report(ends, &mut self.status.motion);
            self.ended(MotionPhase::Done);
            motion = self.first_in_queue();
        }
        motion.report(ends, &mut self.status.motion);
        match progress {
            Progress::Going => self.motion = Some(motion),
            Progress::Finished(phase) => {
                self.ended(phase);
                if phase == MotionPhase::Done && self.follower.go_on() {
                    self.motion = Some(self.first_in_queue());
                } else {
                    self.drop_queue(phase);
                }
            }
            Progress::NotSettled => {
                let fault = self.not_settled(&motion);
                self.motion = Some(motion);
                self.fail(fault);
            }
        }
    }
}
