//! The parts of an errand's way: where each leads, and how the arm goes it. Chooses nothing.

use std::rc::Rc;

use ctos::task::Context;
use mcs::{
    Joints,
    client::{Move, PathKind, PlanReport, Target},
};
use nalgebra::{Isometry3, Translation3, Vector3};

use super::{Act, Leg, RobotArgs};
use crate::{
    arm::{self, Arm},
    carry::{
        errand::{ERRAND, End, Errand, WAY, Way},
        ways::{Going, turns},
    },
    dom::DomStore,
    outcome::{Failure, Outcome},
    path::{
        coordinator::plan_around,
        drive::{self, Pace},
    },
};

/// The most of the thing's height by which it may stand too high when the arm feels that it has been set down.
const EARLY: f64 = 0.5;

/// An arm that is lower than where it goes to and fro by more may meet what lies beside it, m.
const LOW_M: f64 = 0.02;

/// An errand, and the arm that goes its way.
pub(super) struct Ride<'a> {
    pub(super) cx: &'a Context,
    pub(super) args: Rc<RobotArgs>,
    pub(super) store: DomStore,
    pub(super) errand: Errand,
}

impl<'a> Ride<'a> {
    pub(super) async fn of(action: &'a Act) -> Result<Self, Failure> {
        let (args, store) = action.with_state(|state| (state.args.clone(), state.store.clone()));
        let cx = action.cx();
        let errand = store.fetch(cx, ERRAND).await?;
        Ok(Self {
            cx,
            args,
            store,
            errand,
        })
    }

    pub(super) async fn go(&self, leg: Leg) -> Result<(), Failure> {
        self.arm().acquire().await?;
        match leg {
            Leg::Descend => {
                let down = self.grip(End::From).await?;
                self.guarded(down)
                    .await
                    .map_err(|failure| match failure.outcome {
                        Outcome::Guard => Failure::new(
                            Outcome::Guard,
                            format!("something is in the way down: {}", failure.reason),
                        ),
                        _ => failure,
                    })
            }
            Leg::Lift => {
                let up = self.grip_above(End::From).await?;
                self.line(up, self.args.slow, &[]).await?;
                self.weigh().await
            }
            Leg::SetDown => self.set_down(End::To).await,
            Leg::Withdraw => self.withdraw().await,
            Leg::GoBack => {
                self.take_some_way().await?;
                self.arch_to(End::From).await?;
                self.set_down(End::From).await
            }
            Leg::Park => self.park().await,
            Leg::Approach | Leg::Adjust | Leg::Transfer => Err(Failure::new(
                Outcome::Fault,
                "above an end the arm goes by a way that is chosen",
            )),
        }
    }

    /// Fraction of full speed to and fro.
    fn speed(&self) -> f64 {
        self.errand.speed.unwrap_or(self.args.speed)
    }

    pub(super) fn arm(&self) -> Arm<'_> {
        self.args.arm(self.cx)
    }

    /// What was chosen for this errand.
    pub(super) async fn way(&self) -> Result<Way, Failure> {
        let way: Way = self.store.fetch(self.cx, WAY).await?;
        if way.command == self.errand.command {
            return Ok(way);
        }
        Err(Failure::new(
            Outcome::Fault,
            "no way was chosen for this errand",
        ))
    }

    /// `base_t_tool` with the pads around the thing at an end: at FROM as the camera on the hand has seen it.
    async fn grip(&self, end: End) -> Result<Isometry3<f64>, Failure> {
        let way = self.way().await?;
        let pose = self.errand.pose(end, way.turn);
        Ok(match (end, way.shift) {
            (End::From, Some([x, y])) => pose * Translation3::new(x, y, 0.0),
            _ => pose,
        })
    }

    /// The same, so far above that the gripper goes to and fro.
    async fn grip_above(&self, end: End) -> Result<Isometry3<f64>, Failure> {
        let up = Translation3::new(0.0, 0.0, self.errand.clearance_m);
        Ok(up * self.grip(end).await?)
    }

    /// To above an end by a way; words about it.
    pub(super) async fn go_above(&self, end: End, way: Going) -> Result<String, Failure> {
        let above = self.grip_above(end).await?;
        let path = match way {
            Going::Joint => PathKind::Joint,
            Going::Line => PathKind::StraightLine,
            Going::Arch => self.arch(),
            Going::Planned => return self.go_planned(above).await,
        };
        let gone = self
            .along(above, path, self.speed(), &self.args.clear)
            .await;
        // What the planner refuses, an arch without a way across, say, is no way; who may move was settled before.
        gone.map_err(|failure| match failure.outcome {
            Outcome::Refused => Failure::new(Outcome::Unreachable, failure.reason),
            _ => failure,
        })?;
        Ok(String::new())
    }

    /// To above an end around everything, as the planner finds it.
    async fn go_planned(&self, above: Isometry3<f64>) -> Result<String, Failure> {
        let goal = self.plan(above, PathKind::Joint).await?.joints;
        self.go_around(goal).await
    }

    async fn go_around(&self, goal: Joints) -> Result<String, Failure> {
        let arm = self.arm();
        let way = plan_around(self.cx, &self.args.planner, drive::here(&arm).await?, goal).await?;
        let pace = Pace {
            speed: self.speed(),
            blends: true,
            guards: &self.args.clear,
        };
        drive::along(&arm, &way, pace).await?;
        Ok(format!(
            "{} points, {:.2} m, ",
            way.points.len(),
            way.length_m
        ))
    }

    fn arch(&self) -> PathKind {
        PathKind::Arch {
            height: self.args.arch_m,
            corner: None,
        }
    }

    /// Whether the arm reaches all of the way with this turn.
    pub(super) async fn plan_all(&self, turn: f64) -> Result<(), Failure> {
        for (end, name) in [(End::From, "from"), (End::To, "to")] {
            for pose in [self.errand.pose(end, turn), self.errand.above(end, turn)] {
                let planned = self.plan(pose, PathKind::Joint).await;
                planned.map_err(|failure| match failure.outcome {
                    Outcome::Unreachable => Failure::new(
                        Outcome::Unreachable,
                        format!("`{name}` cannot be reached: {}", failure.reason),
                    ),
                    _ => failure,
                })?;
            }
        }
        Ok(())
    }

    /// Where none was chosen, for the hand was full before the errand: the first turn with which the arm reaches FROM.
    async fn take_some_way(&self) -> Result<(), Failure> {
        if self.way().await.is_ok() {
            return Ok(());
        }
        let mut first = None;
        for (turn, _) in turns(&self.errand.thing) {
            let turn = turn.radians();
            match self
                .plan(self.errand.pose(End::From, turn), PathKind::Joint)
                .await
            {
                Ok(_) => {
                    let way = Way {
                        command: self.errand.command,
                        turn,
                        shift: None,
                    };
                    return Ok(self.store.store(self.cx, WAY, &way).await?);
                }
                Err(failure) if failure.outcome == Outcome::Unreachable => {
                    first.get_or_insert(failure);
                }
                Err(failure) => return Err(failure),
            }
        }
        let none = || Failure::new(Outcome::Unreachable, "the thing has no turn");
        Err(first.unwrap_or_else(none))
    }

    async fn plan(&self, pose: Isometry3<f64>, path: PathKind) -> Result<PlanReport, Failure> {
        self.arm().plan(arm::pose(&pose), path, self.speed()).await
    }

    /// Straight to a pose.
    pub(super) async fn line(
        &self,
        pose: Isometry3<f64>,
        speed: f64,
        guards: &[String],
    ) -> Result<(), Failure> {
        self.along(pose, PathKind::StraightLine, speed, guards)
            .await
    }

    async fn along(
        &self,
        pose: Isometry3<f64>,
        path: PathKind,
        speed: f64,
        guards: &[String],
    ) -> Result<(), Failure> {
        let order = Move {
            // What goes gently stops as soon as anything else.
            acceleration: Some(speed.max(self.args.slow)),
            guards: guards.to_vec(),
            ..arm::order(arm::pose(&pose), path, speed)
        };
        self.arm().travel(order).await.map(|_| ())
    }

    /// Straight down to a pose, the last of it gently. The guards of the ways down end it when they feel something.
    async fn guarded(&self, pose: Isometry3<f64>) -> Result<(), Failure> {
        let touch = &self.args.touch;
        let near = Translation3::new(0.0, 0.0, self.args.gentle_m) * pose;
        if self.height().await? > near.translation.z {
            self.line(near, self.args.slow, touch).await?;
        }
        self.line(pose, self.args.gentle, touch).await
    }

    /// Up, across and down to above an end of the way.
    async fn arch_to(&self, end: End) -> Result<(), Failure> {
        let above = self.grip_above(end).await?;
        let (speed, clear) = (self.speed(), &self.args.clear);
        let mut gone = self.along(above, self.arch(), speed, clear).await;
        let is_ended = gone
            .as_ref()
            .is_err_and(|failure| failure.outcome == Outcome::Guard);
        // Back as it came, where nothing lies as high as that.
        if is_ended && self.height().await? > above.translation.z - LOW_M {
            let line = PathKind::StraightLine;
            gone = self.along(above, line, speed, clear).await;
        }
        match gone {
            Err(failure) if self.may_go_around(&failure) => {
                self.go_planned(above).await.map(|_| ())
            }
            gone => gone,
        }
    }

    /// Whether a way on which there is no choice is gone around everything instead.
    fn may_go_around(&self, failure: &Failure) -> bool {
        failure.outcome == Outcome::Guard && self.args.ways.are_planned()
    }

    /// Down until the thing stands. What is felt earlier than that stands there already.
    async fn set_down(&self, end: End) -> Result<(), Failure> {
        let pose = self.grip(end).await?;
        match self.guarded(pose).await {
            // Any other guard has felt nothing beneath it.
            Err(failure)
                if failure.outcome == Outcome::Guard
                    && self.arm().was_ended_by(&self.args.touch).await? =>
            {
                let early = self.height().await? - pose.translation.z;
                if early <= EARLY * self.errand.thing.height_m {
                    return Ok(());
                }
                Err(Failure::new(
                    Outcome::Occupied,
                    format!("something stands there already, {:.0} mm high", early * 1e3),
                ))
            }
            ended => ended,
        }
    }

    /// How high the tool is in the base frame, m.
    async fn height(&self) -> Result<f64, Failure> {
        Ok(self.arm().tool().await?.translation.z)
    }

    /// Straight up from wherever it is to where the gripper goes to and fro.
    async fn withdraw(&self) -> Result<(), Failure> {
        let now = self.arm().tool().await?;
        let [from, to] = [End::From, End::To].map(|end| self.errand.above(end, 0.0).translation.z);
        let up = from.max(to) - now.translation.z;
        if up <= 0.0 {
            return Ok(());
        }
        let mut above = now;
        above.translation.vector += Vector3::z() * up;
        self.line(above, self.args.slow, &[]).await
    }

    /// To where the arm waits; there it is given back.
    async fn park(&self) -> Result<(), Failure> {
        let (arm, park) = (self.arm(), arm::radians(&self.args.park_deg));
        let order = Move {
            guards: self.args.clear.clone(),
            ..arm::order(Target::Joints(park), PathKind::Joint, self.speed())
        };
        match arm.travel(order).await {
            Err(failure) if self.may_go_around(&failure) => {
                self.go_around(park).await?;
            }
            gone => {
                gone?;
            }
        }
        arm.release().await
    }
}
