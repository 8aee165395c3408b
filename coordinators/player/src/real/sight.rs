//! The last correction above what is grasped, by one picture of the camera on the hand. It knows the way down; `coordinators::wrist`
//! knows the camera.

use coordinators::{arm::Arm, outcome::Failure};
use ctos::task::Context;
use mcs::client::PathKind;
use nalgebra::{Isometry3, Translation3, Vector2};

use super::{
    ArmArgs, Stand, TRAVEL_M,
    ahead::{At, here},
    forbids,
};
use crate::wire::{BOARD_M, TABLE_M};

/// The tool looks from so far above what a disc stands on, m: at one on the board from where it goes to and fro.
const LOOK_M: f64 = TRAVEL_M - TABLE_M - BOARD_M;
/// Open jaws come down clear of a disc that is so far beside their middle, m.
const SLACK_M: f64 = 0.005;
/// The cameras of the room are not so far off, m: who sees that again and again has learned from a disc that was elsewhere.
const AMISS_M: f64 = 0.002;

/// What the camera has learned, as far as corrections tell.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Lesson {
    /// The last correction, m.
    last: Option<[f64; 2]>,
    /// Whether the hand has gone down by it, and nothing was carried since.
    tried: bool,
}

impl Lesson {
    /// Whether it is right, by one more correction. It is not after one by which nothing was grasped, nor when two large ones
    /// are alike: the cameras of the room do not err twice in the same way, along the axes of the tool.
    fn holds(&self, shift: [f64; 2]) -> bool {
        let shift = Vector2::from(shift);
        let is_again = self.last.is_some_and(|last| {
            shift.norm() > AMISS_M && (shift - Vector2::from(last)).norm() < 0.5 * shift.norm()
        });
        !self.tried && !is_again
    }

    /// After a correction that is believed.
    const fn after(shift: [f64; 2]) -> Self {
        Self {
            last: Some(shift),
            tried: true,
        }
    }

    /// What was grasped is carried.
    pub const fn carried(self) -> Self {
        Self {
            tried: false,
            ..self
        }
    }
}

impl Stand {
    /// `base_t_tool` from where the camera on the hand takes its picture, turned as the tool is.
    fn above_for_picture(&self, tool: &Isometry3<f64>) -> Isometry3<f64> {
        let [x, y] = self.at;
        let above = Translation3::new(x, y, self.bottom + LOOK_M);
        Isometry3::from_parts(above, tool.rotation)
    }
}

impl ArmArgs {
    /// Where the camera on the hand sees what is grasped. That is where it was seen before if the camera knows nothing there, or
    /// if it is hardly beside that and the way there is not clear.
    ///
    /// # Errors
    /// It is far beside that, and from there it cannot be carried; or the arm does not go on.
    pub(super) async fn seen(
        &self,
        cx: &Context,
        stand: Stand,
        to: Stand,
    ) -> Result<Stand, (Failure, u8)> {
        let arm = self.arm(cx);
        let shift = self.shift(cx, &arm, stand).await.map_err(here)?;
        let Some([x, y]) = shift else {
            return Ok(stand);
        };
        let tool = arm.tool().await.map_err(here)?;
        let moved = stand.above_for_picture(&tool) * Translation3::new(x, y, 0.0);
        let seen = Stand {
            at: [moved.translation.x, moved.translation.y],
            ..stand
        };
        match self.check_down(cx, &arm, seen, to).await {
            Ok(()) => Ok(seen),
            Err((failure, _)) if !forbids(failure.outcome) && x.hypot(y) < SLACK_M => {
                let reason = failure.reason;
                tracing::warn!(reason, "the hand goes where the disc was seen before");
                Ok(stand)
            }
            Err(failure) => Err(failure),
        }
    }

    /// How far it is beside where it was seen before, m, along the axes of the tool; learned with the first disc. Of a stack the
    /// camera sees the side, too, which no disc that was learned has.
    async fn shift(
        &self,
        cx: &Context,
        arm: &Arm<'_>,
        stand: Stand,
    ) -> Result<Option<[f64; 2]>, Failure> {
        let Some(wrist) = self.wrist.as_ref().filter(|_| stand.single) else {
            return Ok(None);
        };
        let above = stand.above_for_picture(&arm.tool().await?);
        let lines = |corner: [f64; 2]| {
            let there = above * Translation3::new(corner[0], corner[1], 0.0);
            (there, PathKind::StraightLine)
        };
        let go = async |corner| self.go(arm, lines(corner), self.slow, &[]).await;
        go([0.0; 2]).await?;
        match wrist.offset(cx, [0.0; 2]).await {
            Ok(Some(shift)) if self.lesson.get().holds(shift) => {
                self.lesson.set(Lesson::after(shift));
                return Ok(Some(shift));
            }
            Ok(_) => {}
            Err(failure) => {
                let reason = failure.reason;
                tracing::warn!(reason, "the camera on the hand does not correct the arm");
                return Ok(None);
            }
        }
        self.lesson.set(Lesson::default());
        let corners = wrist
            .corners()
            .map(|corner| self.motion(lines(corner), self.slow));
        let learned = match self.are_clear(cx, arm, corners.to_vec()).await {
            Ok(()) => wrist.learn(cx, go).await,
            Err(failure) => Err(failure),
        };
        match learned {
            Err(failure) if !forbids(failure.outcome) => {
                let reason = failure.reason;
                tracing::warn!(reason, "the camera on the hand learns nothing here");
                go([0.0; 2]).await?;
            }
            learned => learned?,
        }
        Ok(None)
    }

    /// That the way down to there leads too near to nothing, and what is grasped there can be carried on.
    async fn check_down(
        &self,
        cx: &Context,
        arm: &Arm<'_>,
        seen: Stand,
        to: Stand,
    ) -> Result<(), (Failure, u8)> {
        let at = At::now(arm).await.map_err(here)?;
        let there = self.lowered(cx, &at, seen).await.map_err(here)?;
        let risen = self.risen(cx, there).await.map_err(here)?;
        self.carries(cx, risen, to).await.map_err(|kept| (kept, 1))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_disc_that_was_pushed_once_is_no_reason_to_doubt_the_lesson_and_the_same_error_twice_is() {
        let pushed = Lesson::after([0.006, -0.004]).carried();
        assert!(pushed.holds([0.0004, 0.0003]));
        assert!(pushed.holds([-0.006, 0.004]));
        assert!(!pushed.holds([0.0055, -0.0045]));
        // The cameras of the room are a little off, always in the same way.
        let usual = Lesson::after([0.0006, -0.0003]).carried();
        assert!(usual.holds([0.0006, -0.0003]));
    }

    #[test]
    fn a_correction_by_which_nothing_was_carried_is_not_believed_again() {
        assert!(Lesson::default().holds([0.008, 0.0]));
        let tried = Lesson::after([0.0004, 0.0]);
        assert!(!tried.holds([0.0004, 0.0]));
        assert!(tried.carried().holds([0.0004, 0.0]));
    }
}
