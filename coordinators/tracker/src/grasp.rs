//! How the ball is taken when it rests: the hand opens, goes to it along a line, grasps it as any hand of MCS does, lifts it, and sees
//! that it still holds it. Who holds the ball lets go when the fingers have it.

use std::time::Duration;

use ctos::{
    message::Command,
    task::{Context, HandlerError},
};
use mcs::{
    client::{Manipulator, MotionError, Move, PathKind, Target},
    state::State,
};
use mcs_hand::command::{Grasp, Held, Open, ReadHeld};
use nalgebra::{Isometry3, Translation3};
use serde::{Deserialize, Serialize};

/// How long a motion of the arm, or of the hand, may take.
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
    /// There was no ball between the fingers, or the arm did not come there; the reason.
    Missed(String),
    /// It was between the fingers, and slipped away while it was lifted; the reason.
    Slipped(String),
}

impl Grasped {
    /// What the net is told.
    #[must_use]
    pub fn symbol(&self) -> &'static str {
        match self {
            Self::Holds { .. } => "grasped",
            Self::Missed(_) => "missed",
            Self::Slipped(_) => "slipped",
        }
    }
}

/// An arm with a hand that grasps.
pub(crate) struct Grasper<'a> {
    pub cx: &'a Context,
    pub args: &'a GraspArgs,
    pub arm: &'a Manipulator,
    /// Whether it was stopped.
    pub is_over: &'a dyn Fn() -> bool,
}

impl Grasper<'_> {
    /// Takes the ball, whose middle is where the tool is at `base_t_ball`. A hand that closed on nothing, or lost it, is open
    /// afterwards. Where arm or hand failed, or were stopped, nothing moves any more.
    pub async fn grasp(&self, base_t_ball: &Isometry3<f64>) -> Grasped {
        let closed = match self.close(base_t_ball).await {
            Ok(held) => self.is_it(held),
            Err(error) => return Grasped::Missed(error.to_string()),
        };
        if let Err(why) = closed {
            self.open().await;
            return Grasped::Missed(why);
        }
        let lifted = match self.lift(base_t_ball).await {
            Ok(held) => self.is_it(held),
            Err(error) => {
                let why = format!("it was not lifted, and the hand stays closed: {error}");
                return Grasped::Slipped(why);
            }
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

    async fn close(&self, base_t_ball: &Isometry3<f64>) -> Result<Held, HandlerError> {
        let Self { args, .. } = self;
        let (width, speed) = (Some(args.open_m), args.speed);
        self.go_on()?;
        self.ask(Open {
            width_m: width,
            speed,
        })
        .await?;
        self.move_to(base_t_ball).await?;
        self.go_on()?;
        let force_n = Some(args.force_n);
        Ok(self.ask(Grasp { force_n, speed }).await?)
    }

    async fn lift(&self, base_t_ball: &Isometry3<f64>) -> Result<Held, HandlerError> {
        self.cx.sleep(GIVEN).await;
        let lifted = Translation3::new(0.0, 0.0, self.args.lift_m) * base_t_ball;
        self.move_to(&lifted).await?;
        Ok(self.ask(ReadHeld {}).await?)
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

    /// Opens the hand, unless somebody or something has stopped the arm: then nothing moves any more.
    async fn open(&self) {
        let arm = self.arm.status().await;
        let may_move =
            arm.is_ok_and(|arm| !arm.stopped && matches!(arm.state, State::Active | State::Motion));
        if !may_move || (self.is_over)() {
            tracing::warn!("the hand stays as it is: its arm was stopped");
            return;
        }
        let (width_m, speed) = (Some(self.args.open_m), self.args.speed);
        if let Err(error) = self.ask(Open { width_m, speed }).await {
            tracing::warn!("the hand does not open: {error}");
        }
    }

    async fn ask<C>(&self, command: C) -> Result<Held, MotionError>
    where
        C: Command<Reply = Result<Held, MotionError>>,
    {
        let hand = self.cx.task(&self.args.hand).await?;
        self.cx.call(&hand, command).deadline(LONGEST).await?
    }

    async fn move_to(&self, to: &Isometry3<f64>) -> Result<(), HandlerError> {
        self.go_on()?;
        let mut rows = [0.0; 16];
        rows.copy_from_slice(to.to_homogeneous().transpose().as_slice());
        let request = Move {
            target: Target::Pose(rows),
            path: PathKind::StraightLine,
            speed: self.args.speed,
            acceleration: None,
            elbow: None,
            guards: Vec::new(),
            blend: 0.0.into(),
        };
        self.arm.go(request, LONGEST).await?;
        Ok(())
    }

    fn go_on(&self) -> Result<(), HandlerError> {
        match (self.is_over)() {
            true => Err("it was stopped".into()),
            false => Ok(()),
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
