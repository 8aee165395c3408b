//! The Robot Coordinator: the functions of `nets/carry/robot.net`, which move the arm on the way of an errand.
//!
//! It knows several turns of the gripper about the vertical, and takes the first with which the arm reaches both ends of the
//! way. What ends a motion at a touch is an end of it where something is set down, and a failure elsewhere.

use std::rc::Rc;

use ctos::{
    config::{App, TaskConfig},
    diagnostic::{Finding, Findings},
    registry::Registry,
    task::Context,
};
use mcs::client::{Move, PathKind, PlanReport, Target};
use nalgebra::{Isometry3, Translation3, Vector3};
use pnt::library::{Acted, Action, Library};
use serde::{Deserialize, Serialize};

use super::errand::{ERRAND, End, Errand, ROBOT_PROBLEMS, WAY, Way};
use crate::{
    arm::{self, Arm, ArmKeys},
    dom::DomStore,
    handler::{self, NetArgs},
    motion::{mcs_task, resume_within_s},
    outcome::{Failure, Outcome},
};

/// The handler's name.
pub const HANDLER: &str = "coordinators.carry_robot";

/// The most of the thing's height by which it may stand too high when the arm feels that it has been set down.
const EARLY: f64 = 0.5;

/// Arguments.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
struct RobotArgs {
    /// The client interface of MCS.
    #[serde(default = "mcs_task")]
    mcs: String,
    /// The data object manager.
    #[serde(default = "crate::dom_task")]
    dom: String,
    /// Fraction of full speed to and fro.
    #[serde(default = "speed")]
    speed: f64,
    /// The same down to near the board and up from it.
    #[serde(default = "slow")]
    slow: f64,
    /// The same on the last of the ways down, where a touch ends them.
    #[serde(default = "gentle")]
    gentle: f64,
    /// How long that last part is, m.
    #[serde(default = "gentle_m")]
    gentle_m: f64,
    /// How far above the higher end the arch to the target goes, m.
    #[serde(default = "arch_m")]
    arch_m: f64,
    /// Recipes of guards that watch the ways down.
    #[serde(default)]
    touch: Vec<String>,
    /// Where the arm waits, degrees of its joints.
    park_deg: Vec<f64>,
    /// How long a protective stop is waited out before the request fails, s.
    #[serde(default = "resume_within_s")]
    resume_within_s: f64,
    /// How long an MCS that is gone, and may be started again, is waited for, s.
    #[serde(default = "crate::service_within_s")]
    service_within_s: f64,
}

fn speed() -> f64 {
    0.5
}

fn slow() -> f64 {
    0.2
}

fn gentle() -> f64 {
    0.03
}

fn gentle_m() -> f64 {
    0.015
}

fn arch_m() -> f64 {
    0.05
}

impl RobotArgs {
    fn arm<'a>(&'a self, cx: &'a Context) -> Arm<'a> {
        Arm {
            cx,
            mcs: &self.mcs,
            within_s: self.service_within_s,
        }
    }
}

/// A part of the way, as the Dispatcher asks for it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
enum Leg {
    /// To above the thing, with the turn that reaches all.
    Approach,
    /// Down around the thing.
    Descend,
    /// Up with it.
    Lift,
    /// To above the target.
    Transfer,
    /// Down, until it stands.
    SetDown,
    /// Up without it.
    Withdraw,
    /// Back to where it was taken, and down until it stands.
    GoBack,
    /// To where the arm waits; there it is given back.
    Park,
}

impl Leg {
    fn name(self) -> &'static str {
        match self {
            Self::Approach => "approach",
            Self::Descend => "descend",
            Self::Lift => "lift",
            Self::Transfer => "transfer",
            Self::SetDown => "set_down",
            Self::Withdraw => "withdraw",
            Self::GoBack => "go_back",
            Self::Park => "park",
        }
    }
}

/// What the functions share.
struct Coordinator {
    args: Rc<RobotArgs>,
    store: DomStore,
    /// The part of the way that is asked for.
    leg: Leg,
    /// What ended the latest motion before its end.
    ended: Option<Failure>,
}

/// Registers the handler.
pub(super) fn register(registry: &mut Registry) {
    handler::register::<RobotArgs>(registry);
}

impl NetArgs for RobotArgs {
    const HANDLER: &'static str = HANDLER;
    type State = Coordinator;

    fn dom(&self) -> &str {
        &self.dom
    }

    fn library(self, store: DomStore) -> Library<Coordinator> {
        library(self, store)
    }

    fn check(&self, task: &TaskConfig, app: &App, findings: &mut Findings) {
        let keys = ArmKeys {
            mcs: &self.mcs,
            resume_within_s: self.resume_within_s,
            service_within_s: self.service_within_s,
            speeds: &[
                ("speed", self.speed),
                ("slow", self.slow),
                ("gentle", self.gentle),
            ],
            park_deg: Some(&self.park_deg),
        };
        keys.check(task, app, "coordinators::carry::robot", findings);
        let mut wrong = |key: &str, text: String| {
            let place = task.args.locate(key).unwrap_or_else(|| task.place.clone());
            findings.push(Finding::error("coordinators::carry::robot", text).at(place));
        };
        for (key, value) in [("arch_m", self.arch_m), ("gentle_m", self.gentle_m)] {
            if !(0.0..=2.0).contains(&value) {
                wrong(key, format!("`{key}` is {value}; give from 0 to 2 m"));
            }
        }
    }
}

fn library(args: RobotArgs, store: DomStore) -> Library<Coordinator> {
    let state = Coordinator {
        args: Rc::new(args),
        store,
        leg: Leg::Park,
        ended: None,
    };
    let save = |state: &Coordinator| (state.leg, state.ended.clone());
    let mut library = Library::new(state)
        .kept(save, |state, (leg, ended)| {
            (state.leg, state.ended) = (leg, ended);
        })
        .enabling("stopped", |state: &Coordinator| {
            let ended = state.ended.as_ref();
            ended.is_some_and(|failure| failure.outcome == Outcome::Stopped)
        })
        .action("again", |action: Act| async move {
            let leg = action.with_state(|state| state.leg);
            go(action, leg).await
        })
        .action("await_resume", await_resume);
    for leg in [
        Leg::Approach,
        Leg::Descend,
        Leg::Lift,
        Leg::Transfer,
        Leg::SetDown,
        Leg::Withdraw,
        Leg::GoBack,
        Leg::Park,
    ] {
        library = library.action(leg.name(), move |action: Act| go(action, leg));
    }
    library
}

type Act = Action<Coordinator>;

/// Goes a part of the way. Why that ended is kept, and passed up when it is given up.
async fn go(action: Act, leg: Leg) -> Acted {
    let ride = Ride::of(&action).await;
    let gone = match &ride {
        Ok(ride) => ride.go(leg).await,
        Err(failure) => Err(failure.clone()),
    };
    action.with_state(|state| {
        state.leg = leg;
        state.ended = gone.as_ref().err().cloned();
    });
    pass_up(&action, gone).await
}

/// Waits until somebody ends the protective stop that ended the motion; the part of the way is then begun anew.
async fn await_resume(action: Act) -> Acted {
    let (args, ended) = action.with_state(|state| (state.args.clone(), state.ended.clone()));
    let reason = ended.map_or_else(String::new, |ended| ended.reason);
    let arm = args.arm(action.cx());
    let resumed = arm.resumed(args.resume_within_s, &reason).await;
    pass_up(&action, resumed).await
}

/// Tells the Dispatcher why a request could not be done. A protective stop is told only when nobody ends it.
async fn pass_up(action: &Act, acted: Result<(), Failure>) -> Acted {
    let Err(failure) = acted else { return Ok(()) };
    let (store, leg) = action.with_state(|state| (state.store.clone(), state.leg));
    let (cx, request) = (action.cx(), leg.name().to_owned());
    super::errand::note_problem(cx, &store, ROBOT_PROBLEMS, &request, &failure).await;
    Err(failure.into())
}

/// An errand, and the arm that goes its way.
struct Ride<'a> {
    cx: &'a Context,
    args: Rc<RobotArgs>,
    store: DomStore,
    errand: Errand,
}

impl<'a> Ride<'a> {
    async fn of(action: &'a Act) -> Result<Self, Failure> {
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

    async fn go(&self, leg: Leg) -> Result<(), Failure> {
        self.arm().acquire().await?;
        match leg {
            Leg::Approach => self.approach().await,
            Leg::Descend => {
                let down = self.errand.pose(End::From, self.turn().await?);
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
                let up = self.errand.above(End::From, self.turn().await?);
                self.line(up, self.args.slow, &[]).await
            }
            Leg::Transfer => self.arch_to(End::To).await,
            Leg::SetDown => self.set_down(End::To).await,
            Leg::Withdraw => self.withdraw().await,
            Leg::GoBack => {
                self.arch_to(End::From).await?;
                self.set_down(End::From).await
            }
            Leg::Park => self.park().await,
        }
    }

    /// Fraction of full speed to and fro.
    fn speed(&self) -> f64 {
        self.errand.speed.unwrap_or(self.args.speed)
    }

    fn arm(&self) -> Arm<'_> {
        self.args.arm(self.cx)
    }

    /// The turn that was chosen for this errand.
    async fn turn(&self) -> Result<f64, Failure> {
        let way: Way = self.store.fetch(self.cx, WAY).await?;
        if way.command == self.errand.command {
            return Ok(way.turn);
        }
        Err(Failure::new(
            Outcome::Fault,
            "no way was chosen for this errand",
        ))
    }

    /// To above the thing, with the first turn that reaches both ends of the way and what is above them.
    async fn approach(&self) -> Result<(), Failure> {
        let mut first = None;
        for turn in &self.errand.thing.grasp.turns_deg {
            let turn = turn.to_radians();
            match self.plan_all(turn).await {
                Ok(planned) => {
                    let way = Way {
                        command: self.errand.command,
                        turn,
                    };
                    self.store.store(self.cx, WAY, &way).await?;
                    let target = Target::Joints(planned.joints);
                    let order = arm::order(target, PathKind::Joint, self.speed());
                    return self.arm().go(order, planned.duration_s).await.map(|_| ());
                }
                Err(failure) if failure.outcome == Outcome::Unreachable => {
                    first.get_or_insert(failure);
                }
                Err(failure) => return Err(failure),
            }
        }
        let none = || Failure::new(Outcome::Fault, "the thing's file names no turn");
        Err(first.unwrap_or_else(none))
    }

    /// Whether the arm reaches all of the way with this turn; the plan to its beginning.
    async fn plan_all(&self, turn: f64) -> Result<PlanReport, Failure> {
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
        let above = self.errand.above(End::From, turn);
        self.plan(above, PathKind::Joint).await
    }

    async fn plan(&self, pose: Isometry3<f64>, path: PathKind) -> Result<PlanReport, Failure> {
        self.arm().plan(arm::pose(&pose), path, self.speed()).await
    }

    /// Straight to a pose.
    async fn line(
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
        let above = self.errand.above(end, self.turn().await?);
        let arch = PathKind::Arch {
            height: self.args.arch_m,
            corner: None,
        };
        self.along(above, arch, self.speed(), &[]).await
    }

    /// Down until the thing stands. What is felt earlier than that stands there already.
    async fn set_down(&self, end: End) -> Result<(), Failure> {
        let pose = self.errand.pose(end, self.turn().await?);
        match self.guarded(pose).await {
            Err(failure) if failure.outcome == Outcome::Guard => {
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
        let park = &self.args.park_deg;
        self.arm().park(park, self.speed()).await
    }
}
