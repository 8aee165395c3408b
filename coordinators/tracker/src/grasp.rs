//! How the ball is taken when it rests: the hand opens, goes to it along a line, grasps it as any hand of MCS does, lifts it, and sees
//! that it still holds it. Who holds the ball lets go when the fingers have it.

use std::time::Duration;

use ctos::{
    message::Command,
    task::{Context, HandlerError},
};
use mcs::{client::MotionError, state::State};
use mcs_hand::command::{Grasp, Held, Open, ReadHeld};
use nalgebra::{Isometry3, Translation3};
use serde::{Deserialize, Serialize};

use crate::mover::Mover;

/// How long a motion of the hand may take.
const LONGEST: Duration = Duration::from_secs(60);

/// How long who holds the ball has to let go of it.
const GIVEN: Duration = Duration::from_millis(800);

/// Arguments.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GraspArgs {
    /// The task of the hand, or of a gripper.
    pub hand: String,
    /// How far it opens before, m.
    #[serde(default = "open_m")]
    pub open_m: f64,
    /// How hard each finger presses, N.
    #[serde(default = "force_n")]
    pub force_n: f64,
    /// How wide the ball is at least and at most where fingertips touch it, m: not always at its widest.
    #[serde(default = "width_m")]
    pub width_m: [f64; 2],
    /// How far the ball is lifted, m.
    #[serde(default = "lift_m")]
    pub lift_m: f64,
    /// Fraction of full speed of arm and fingers.
    #[serde(default = "speed")]
    pub speed: f64,
}

fn open_m() -> f64 {
    0.07
}

fn force_n() -> f64 {
    2.0
}

fn width_m() -> [f64; 2] {
    [0.02, 0.045]
}

fn lift_m() -> f64 {
    0.1
}

fn speed() -> f64 {
    0.3
}

impl GraspArgs {
    /// The first number that cannot be, by its key.
    #[must_use]
    pub fn wrong(&self) -> Option<(&'static str, f64)> {
        let all = [
            ("open_m", self.open_m, 0.2),
            ("force_n", self.force_n, 50.0),
            ("width_m", self.width_m[1], 0.2),
            ("lift_m", self.lift_m, 0.5),
            ("speed", self.speed, 1.0),
        ];
        let wrong = |(_, value, most): &(_, f64, f64)| !(*value > 0.0 && value <= most);
        let turned = self.width_m[0].is_nan() || self.width_m[0] >= self.width_m[1];
        let wrong = all.into_iter().find(wrong);
        let wrong = wrong.map(|(key, value, _)| (key, value));
        wrong.or_else(|| turned.then_some(("width_m", self.width_m[0])))
    }
}

/// How grasping ended.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub enum Grasped {
    /// The ball is held, and was lifted: how wide it is, m, and how hard the finger presses that presses the least, N.
    Holds {
        /// m.
        width_m: f64,
        /// N.
        force_n: f64,
    },
    /// There was no ball between the fingers; the reason.
    Missed(String),
    /// It was between the fingers, and slipped away while it was lifted; the reason.
    Slipped(String),
    /// Arm or hand were stopped, or failed: during what, and the reason. The hand stays as it was then.
    BrokenOff(String),
}

impl Grasped {
    /// What the net is told.
    #[must_use]
    pub fn symbol(&self) -> &'static str {
        match self {
            Self::Holds { .. } => "grasped",
            Self::Missed(_) => "missed",
            Self::Slipped(_) => "slipped",
            Self::BrokenOff(_) => "broken_off",
        }
    }
}

/// Has the hand let go of what it holds.
///
/// # Errors
/// The hand does not open.
pub(crate) async fn let_go(cx: &Context, args: &GraspArgs) -> Result<(), HandlerError> {
    let (width_m, speed) = (Some(args.open_m), args.speed);
    ask(cx, args, Open { width_m, speed }).await?;
    Ok(())
}

/// Asks the hand for something.
async fn ask<C>(cx: &Context, args: &GraspArgs, command: C) -> Result<Held, MotionError>
where
    C: Command<Reply = Result<Held, MotionError>>,
{
    let hand = cx.task(&args.hand).await?;
    cx.call(&hand, command).deadline(LONGEST).await?
}

/// An arm with a hand that grasps.
pub(crate) struct Grasper<'a> {
    pub cx: &'a Context,
    pub args: &'a GraspArgs,
    pub mover: Mover<'a>,
}

impl Grasper<'_> {
    /// Takes the ball, whose middle is where the tool is at `base_t_ball`. A hand that closed on nothing, or lost it, is open
    /// afterwards. Where arm or hand failed, or were stopped, nothing moves any more.
    pub async fn grasp(&self, base_t_ball: &Isometry3<f64>) -> Grasped {
        let broken = |step: &str, error| Grasped::BrokenOff(format!("{step}: {error}"));
        if let Err(error) = self.approach(base_t_ball).await {
            return broken("while the hand went to the ball", error);
        }
        let closed = match self.close().await {
            Ok(held) => self.is_it(held),
            Err(error) => return broken("while the hand closed", error),
        };
        if let Err(why) = closed {
            self.open().await;
            return Grasped::Missed(why);
        }
        let lifted = match self.lift(base_t_ball).await {
            Ok(held) => self.is_it(held),
            Err(error) => return broken("while the ball was lifted", error),
        };
        match lifted {
            Ok(Held {
                width_m, force_n, ..
            }) => Grasped::Holds { width_m, force_n },
            Err(why) => {
                self.open().await;
                Grasped::Slipped(why)
            }
        }
    }

    async fn approach(&self, base_t_ball: &Isometry3<f64>) -> Result<(), HandlerError> {
        self.mover.go_on()?;
        let_go(self.cx, self.args).await?;
        self.mover.move_to(base_t_ball).await
    }

    async fn close(&self) -> Result<Held, HandlerError> {
        self.may_move().await?;
        let (force_n, speed) = (Some(self.args.force_n), self.args.speed);
        let held = ask(self.cx, self.args, Grasp { force_n, speed }).await?;
        self.may_move().await?;
        Ok(held)
    }

    async fn lift(&self, base_t_ball: &Isometry3<f64>) -> Result<Held, HandlerError> {
        self.cx.sleep(GIVEN).await;
        let lifted = Translation3::new(0.0, 0.0, self.args.lift_m) * base_t_ball;
        self.mover.move_to(&lifted).await?;
        Ok(ask(self.cx, self.args, ReadHeld {}).await?)
    }

    /// What is held, if it is the ball.
    fn is_it(&self, held: Held) -> Result<Held, String> {
        let [least, most] = self.args.width_m;
        let wide = held.width_m * 1e3;
        if !held.holds {
            return Err(format!(
                "not every finger feels a ball; they stand {wide:.0} mm apart"
            ));
        }
        match (least..=most).contains(&held.width_m) {
            true => Ok(held),
            false => Err(format!("what is between the fingers is {wide:.0} mm wide")),
        }
    }

    /// # Errors
    /// Somebody or something has stopped the arm: then the hand moves no more either.
    async fn may_move(&self) -> Result<(), HandlerError> {
        self.mover.go_on()?;
        let arm = self.mover.arm.status().await?;
        match arm.state {
            State::Active | State::Motion if !arm.stopped => Ok(()),
            State::Active | State::Motion => Err("the arm was stopped".into()),
            state => {
                let why = arm.fault.unwrap_or_else(|| format!("it is {state}"));
                Err(HandlerError::new(format!("the arm has no power: {why}")))
            }
        }
    }

    /// Opens the hand, unless somebody or something has stopped the arm.
    async fn open(&self) {
        let opened = match self.may_move().await {
            Ok(()) => let_go(self.cx, self.args).await,
            stopped => stopped,
        };
        if let Err(error) = opened {
            tracing::warn!("the hand stays as it is: {error}");
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_that_cannot_be_are_named() {
        let good = GraspArgs {
            hand: "hand".to_owned(),
            open_m: 0.07,
            force_n: 2.0,
            width_m: [0.03, 0.046],
            lift_m: 0.1,
            speed: 0.3,
        };
        assert_eq!(good.wrong(), None);
        let turned = GraspArgs {
            width_m: [0.05, 0.04],
            ..good.clone()
        };
        assert_eq!(turned.wrong(), Some(("width_m", 0.05)));
        let fast = GraspArgs { speed: 2.0, ..good };
        assert_eq!(fast.wrong(), Some(("speed", 2.0)));
    }
}
