//! The last correction above what is grasped, by one picture of the camera on the hand. It knows the way down; `coordinators::wrist`
//! knows the camera.

use coordinators::{arm::Arm, outcome::Failure};
use ctos::task::Context;
use mcs::client::PathKind;
use nalgebra::{Isometry3, Translation3};

use super::{ArmArgs, Stand, TRAVEL_M, ahead::At, forbids};
use crate::wire::{BOARD_M, TABLE_M};

/// The tool looks from so far above what a disc stands on, m: at one on the board from where it goes to and fro.
const LOOK_M: f64 = TRAVEL_M - TABLE_M - BOARD_M;

impl Stand {
    /// `base_t_tool` from where the camera on the hand looks at it, turned as the tool is.
    fn looked_at(&self, tool: &Isometry3<f64>) -> Isometry3<f64> {
        let [x, y] = self.at;
        let looks = Translation3::new(x, y, self.bottom + LOOK_M);
        Isometry3::from_parts(looks, tool.rotation)
    }
}

impl ArmArgs {
    /// Where the camera on the hand sees what is grasped: where it was seen before, if no camera is on the hand, or if it sees nothing
    /// there that it knows, or to where no clear way leads.
    pub(super) async fn seen(
        &self,
        cx: &Context,
        stand: Stand,
        to: Stand,
    ) -> Result<Stand, (Failure, u8)> {
        let here = |failure: Failure| (failure, 0);
        let arm = self.arm(cx);
        let shift = self.shift(cx, &arm, stand).await.map_err(here)?;
        let Some([x, y]) = shift else {
            return Ok(stand);
        };
        let tool = arm.tool().await.map_err(here)?;
        let moved = stand.looked_at(&tool) * Translation3::new(x, y, 0.0);
        let seen = Stand {
            at: [moved.translation.x, moved.translation.y],
            ..stand
        };
        match self.look_down(cx, &arm, seen, to).await {
            Ok(()) => Ok(seen),
            Err((failure, end)) if forbids(failure.outcome) => Err((failure, end)),
            // The ways that were looked at before are clear.
            Err((failure, _)) => {
                tracing::warn!(
                    reason = failure.reason,
                    "the hand goes where it was seen before"
                );
                Ok(stand)
            }
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
        let above = stand.looked_at(&arm.tool().await?);
        let go = async |[x, y]: [f64; 2]| {
            let there = above * Translation3::new(x, y, 0.0);
            let line = (there, PathKind::StraightLine);
            self.go(arm, line, self.slow, &[]).await
        };
        go([0.0; 2]).await?;
        match wrist.offset(cx, [0.0; 2]).await {
            Ok(Some(shift)) => Ok(Some(shift)),
            Ok(None) => wrist.learn(cx, go).await.map(|()| None),
            Err(failure) => {
                tracing::warn!(
                    reason = failure.reason,
                    "the camera on the hand does not correct the arm"
                );
                Ok(None)
            }
        }
    }

    /// That the way down to there leads too near to nothing, and what is grasped there can be carried on.
    async fn look_down(
        &self,
        cx: &Context,
        arm: &Arm<'_>,
        seen: Stand,
        to: Stand,
    ) -> Result<(), (Failure, u8)> {
        let here = |failure: Failure| (failure, 0);
        let at = At::now(arm).await.map_err(here)?;
        let there = self.lowered(cx, &at, seen).await.map_err(here)?;
        let risen = self.risen(cx, there).await.map_err(here)?;
        self.carries(cx, risen, to).await.map_err(|kept| (kept, 1))
    }
}
