//! The Path-planning Coordinator: the functions of `nets/path/path.net`.
//!
//! It takes the way most likely to succeed for its cost. A way that a guard ended, or that leads out of reach, is a failure of
//! that way in this step, and the next one is tried from where the arm stands; anything else is passed up. Ways around
//! everything are planned by the task with the handler `mcs.path`, on whatever processor that stands.

use std::rc::Rc;

use ctos::{
    config::{App, TaskConfig},
    diagnostic::{Finding, Findings},
    registry::Registry,
    task::{Context, HandlerError},
};
use mcs::{
    Joints,
    client::{PathKind, Target},
};
use mcs_path::{Way, task::PlanWay};
use pnt::library::{Acted, Action, Library};
use serde::{Deserialize, Serialize};

use super::{
    drive::{self, Pace},
    trip::{ACCOUNT, Account, PLANNED, TRIP, Trip},
};
use crate::{
    arm::{self, Arm, ArmKeys},
    dispatching::Told,
    dom::DomStore,
    handler::{self, NetArgs},
    motion::{mcs_task, resume_within_s},
    outcome::{Failure, Outcome},
    strategy::{
        Belief, Step, shown,
        step::{self, Way as _},
    },
};

/// The handler's name.
pub const HANDLER: &str = "coordinators.path";

/// Where a trip begins that does not begin where the last one ended.
const ELSEWHERE: &str = "elsewhere";
/// The arm is at a place when no joint is farther from it, rad or m.
const THERE: f64 = 0.02;

/// A way of going.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
enum Kind {
    /// The tool along a straight line.
    Line,
    /// Joints interpolated.
    Joint,
    /// The tool up, across and down.
    Arch,
    /// Around everything, past the points of the way without a stop.
    Planned,
    /// The same slowly, with a stop at each point.
    PlannedSlowly,
}

impl Kind {
    const ALL: [Self; 5] = [
        Self::Line,
        Self::Joint,
        Self::Arch,
        Self::Planned,
        Self::PlannedSlowly,
    ];

    fn is_planned(self) -> bool {
        matches!(self, Self::Planned | Self::PlannedSlowly)
    }
}

impl step::Way for Kind {
    fn name(self) -> String {
        let name = match self {
            Self::Line => "line",
            Self::Joint => "joint",
            Self::Arch => "arch",
            Self::Planned => "planned",
            Self::PlannedSlowly => "planned_slowly",
        };
        name.to_owned()
    }
}

/// A way that is open, and what it is assumed to cost before it has been gone.
#[derive(Debug, Clone, Copy, Deserialize)]
#[serde(deny_unknown_fields)]
struct WayArgs {
    way: Kind,
    cost_s: f64,
}

/// Arguments.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
struct PathArgs {
    /// The client interface of MCS.
    #[serde(default = "mcs_task")]
    mcs: String,
    /// The data object manager.
    #[serde(default = "crate::dom_task")]
    dom: String,
    /// The task that plans ways around everything.
    #[serde(default = "planner")]
    planner: String,
    /// Fraction of full speed.
    #[serde(default = "speed")]
    speed: f64,
    /// The same on ways that are gone slowly.
    #[serde(default = "slow")]
    slow: f64,
    /// How far above the higher end an arch goes, m.
    #[serde(default = "arch_m")]
    arch_m: f64,
    /// The ways that it knows.
    #[serde(default = "ways")]
    ways: Vec<WayArgs>,
    /// How long a protective stop is waited out before the request fails, s.
    #[serde(default = "resume_within_s")]
    resume_within_s: f64,
    /// How long an MCS that is gone, and may be started again, is waited for, s.
    #[serde(default = "crate::service_within_s")]
    service_within_s: f64,
}

fn planner() -> String {
    "paths".to_owned()
}

fn speed() -> f64 {
    0.5
}

fn slow() -> f64 {
    0.15
}

fn arch_m() -> f64 {
    0.2
}

fn ways() -> Vec<WayArgs> {
    let all = Kind::ALL.into_iter().zip([2.0, 2.0, 4.0, 6.0, 20.0]);
    all.map(|(way, cost_s)| WayArgs { way, cost_s }).collect()
}

impl PathArgs {
    fn costs(&self) -> Vec<(Kind, f64)> {
        self.ways.iter().map(|way| (way.way, way.cost_s)).collect()
    }

    fn arm<'a>(&'a self, cx: &'a Context) -> Arm<'a> {
        Arm {
            cx,
            mcs: &self.mcs,
            within_s: self.service_within_s,
        }
    }
}

/// What the functions share.
struct Coordinator {
    args: Rc<PathArgs>,
    store: DomStore,
    step: Step<Kind>,
    belief: Belief,
    /// The place that was reached last, and the choices so far.
    at: Option<Trip>,
    choices: u64,
}

/// Registers the handler.
pub(super) fn register(registry: &mut Registry) {
    handler::register::<PathArgs>(registry);
}

impl NetArgs for PathArgs {
    const HANDLER: &'static str = HANDLER;
    type State = Coordinator;

    fn dom(&self) -> &str {
        &self.dom
    }

    fn library(self, store: DomStore) -> Library<Coordinator> {
        library(self, store)
    }

    fn check(&self, task: &TaskConfig, app: &App, findings: &mut Findings) {
        check(self, task, app, findings);
    }
}

fn check(args: &PathArgs, task: &TaskConfig, app: &App, findings: &mut Findings) {
    let keys = ArmKeys {
        mcs: &args.mcs,
        resume_within_s: args.resume_within_s,
        service_within_s: args.service_within_s,
        speeds: &[("speed", args.speed), ("slow", args.slow)],
        park_deg: None,
    };
    keys.check(task, app, "coordinators::path::way", findings);
    if args.ways.iter().any(|way| way.way.is_planned()) {
        crate::need_task(task, app, "planner", &args.planner, findings);
    }
    let mut wrong = |key: &str, text: String| {
        let place = task.args.locate(key).unwrap_or_else(|| task.place.clone());
        findings.push(Finding::error("coordinators::path::way", text).at(place));
    };
    if !(0.0..=2.0).contains(&args.arch_m) {
        let text = format!("`arch_m` is {}; give from 0 to 2 m", args.arch_m);
        wrong("arch_m", text);
    }
    let mut kinds: Vec<Kind> = args.ways.iter().map(|way| way.way).collect();
    kinds.sort_unstable();
    kinds.dedup();
    if kinds.len() != args.ways.len() || kinds.is_empty() {
        let text = "`ways` names each way at most once, and at least one".to_owned();
        wrong("ways", text);
    }
    for (number, way) in args.ways.iter().enumerate() {
        if !(1e-3..=3600.0).contains(&way.cost_s) {
            let text = format!(
                "`cost_s` of `{}` is {}; give from 0.001 to 3600 s",
                way.way.name(),
                way.cost_s
            );
            wrong(&format!("ways.{number}.cost_s"), text);
        }
    }
}

fn library(args: PathArgs, store: DomStore) -> Library<Coordinator> {
    let state = Coordinator {
        args: Rc::new(args),
        store,
        step: Step::default(),
        belief: Belief::default(),
        at: None,
        choices: 0,
    };
    let save = |state: &Coordinator| {
        let (step, belief) = (state.step.clone(), state.belief.clone());
        (step, belief, state.at.clone(), state.choices)
    };
    let chosen = |kind: Kind| move |state: &Coordinator| state.step.chosen == Some(kind);
    Library::new(state)
        .kept(save, |state, (step, belief, at, choices)| {
            (state.step, state.belief) = (step, belief);
            (state.at, state.choices) = (at, choices);
        })
        .enabling("ways_left", |state: &Coordinator| {
            !state.step.open.is_empty()
        })
        .enabling("by_planned_way", |state: &Coordinator| {
            state.step.chosen.is_some_and(Kind::is_planned)
        })
        .enabling("by_arch", chosen(Kind::Arch))
        .enabling("by_line", chosen(Kind::Line))
        .enabling("stopped", |state: &Coordinator| state.step.is_stopped())
        .enabling("another_may_do", |state: &Coordinator| {
            state.step.may_go_on()
        })
        .action("begin", begin)
        .action("choose", choose)
        .action("plan_way", plan_way)
        .action("go_planned_way", go)
        .action("go_arch", go)
        .action("go_line", go)
        .action("go_joint", go)
        .action("await_resume", await_resume)
        .action("next_way", next_way)
        .action("give_up", give_up)
        .action("give_back", give_back)
}

type Act = Action<Coordinator>;

fn parts(action: &Act) -> (Context, Rc<PathArgs>, DomStore) {
    let (args, store) = action.with_state(|state| (state.args.clone(), state.store.clone()));
    (action.cx().clone(), args, store)
}

/// Reserves the arm for a trip; all ways are open.
async fn begin(action: Act) -> Acted {
    let begun = begun(&action).await;
    let failed = begun.as_ref().err().cloned();
    let (cx, _, store) = parts(&action);
    match begun {
        Ok(step) => {
            action.with_state(|state| state.step = step);
            Ok(())
        }
        Err(failure) => {
            let command = store
                .fetch::<Trip>(&cx, TRIP)
                .await
                .map(|trip| trip.command);
            action.with_state(|state| {
                state.step = Step {
                    command: command.unwrap_or_default(),
                    ..Step::default()
                };
            });
            tell(&action, failed).await;
            Err(failure.into())
        }
    }
}

async fn begun(action: &Act) -> Result<Step<Kind>, Failure> {
    let (cx, args, store) = parts(action);
    let trip: Trip = store.fetch(&cx, TRIP).await?;
    let arm = args.arm(&cx);
    arm.acquire().await?;
    let here = drive::here(&arm).await?;
    let from = action.with_state(|state| {
        let at = state.at.as_ref();
        let is_there = |at: &&Trip| {
            let joints = at.goal.iter().zip(&here);
            at.goal.len() == here.len()
                && joints.fold(0.0, |most: f64, (a, b)| most.max((a - b).abs())) < THERE
        };
        at.filter(is_there)
            .map_or_else(|| ELSEWHERE.to_owned(), |at| at.to.clone())
    });
    let context = format!("{from} to {}", trip.to);
    Ok(Step::new(trip.command, context, &args.costs()))
}

/// Chooses the way most likely to succeed for its cost among those that were not tried yet.
async fn choose(action: Act) -> Acted {
    let (cx, args, store) = parts(&action);
    let (choices, step, belief) = action.with_state(|state| {
        let (step, belief) = (state.step.clone(), state.belief.clone());
        (state.choices, step, belief)
    });
    // The same app with the same seed chooses the same, also after a restart.
    let mut rng = cx.rng(&format!("choice {choices}"));
    let chosen = step.choose(&belief, &args.costs(), &mut rng);
    let (way, figures) = chosen.ok_or_else(|| HandlerError::new("no way is left"))?;
    shown::tell_choice(&cx, &store, &step.context, (way.name(), figures)).await;
    action.with_state(|state| {
        state.choices = choices + 1;
        state.step.begin(way, cx.now());
    });
    Ok(())
}

/// Has a way planned around everything, from where the arm stands.
async fn plan_way(action: Act) -> Acted {
    let planned = planned(&action).await;
    ended(&action, planned.map(|()| None)).await
}

async fn planned(action: &Act) -> Result<(), Failure> {
    let (cx, args, store) = parts(action);
    let trip: Trip = store.fetch(&cx, TRIP).await?;
    let from = drive::here(&args.arm(&cx)).await?;
    let way = plan_around(&cx, &args.planner, from, trip.goal).await?;
    Ok(store.store(&cx, PLANNED, &way).await?)
}

/// A way around everything, as the task `planner` finds it.
pub(crate) async fn plan_around(
    cx: &Context,
    planner: &str,
    from: Joints,
    goal: Joints,
) -> Result<Way, Failure> {
    let planner = cx.task(planner).await;
    let planner = planner.map_err(|error| Failure::new(Outcome::Lost, error))?;
    let ask = PlanWay {
        from,
        goals: vec![goal],
        others: Vec::new(),
        seed: None,
    };
    let answer = cx.call(&planner, ask).await;
    let answer = answer.map_err(|error| Failure::new(Outcome::Lost, error.reason()))?;
    let planned = answer.map_err(|error| Failure::new(Outcome::Unreachable, error))?;
    Ok(planned.way)
}

/// Goes the way that was chosen.
async fn go(action: Act) -> Acted {
    let gone = gone(&action).await;
    ended(&action, gone.map(Some)).await
}

async fn gone(action: &Act) -> Result<(Trip, String), Failure> {
    let (cx, args, store) = parts(action);
    let trip: Trip = store.fetch(&cx, TRIP).await?;
    let chosen = action.with_state(|state| state.step.chosen);
    let arm = args.arm(&cx);
    let path = match chosen {
        Some(Kind::Line) => PathKind::StraightLine,
        Some(Kind::Arch) => PathKind::Arch {
            height: args.arch_m,
            corner: None,
        },
        Some(kind) if kind.is_planned() => {
            let way: Way = store.fetch(&cx, PLANNED).await?;
            let slowly = kind == Kind::PlannedSlowly;
            let pace = Pace {
                speed: if slowly { args.slow } else { args.speed },
                blends: !slowly,
                guards: &[],
            };
            drive::along(&arm, &way, pace).await?;
            let (points, length) = (way.points.len(), way.length_m);
            return Ok((trip, format!("{points} points, {length:.2} m, ")));
        }
        _ => PathKind::Joint,
    };
    let target = Target::Joints(trip.goal);
    let planned = arm.plan(target, path, args.speed);
    // What the planner refuses, an arch without a way across, say, is no way; who may move was settled before.
    let planned = planned.await.map_err(|failure| match failure.outcome {
        Outcome::Refused => Failure::new(Outcome::Unreachable, failure.reason),
        _ => failure,
    })?;
    let order = arm::order(target, path, args.speed);
    arm.go(order, planned.duration_s).await?;
    Ok((trip, String::new()))
}

/// Notes how a part of a way ended. Where a trip is given the arm is there, with words about the way.
async fn ended(action: &Act, part: Result<Option<(Trip, String)>, Failure>) -> Acted {
    match part {
        Ok(None) => Ok(()),
        Ok(Some((trip, about))) => {
            note(action, Ok(about));
            action.with_state(|state| state.at = Some(trip));
            tell(action, None).await;
            Ok(())
        }
        Err(failure) => {
            action.with_state(|state| state.step.ended = Some(failure.clone()));
            Err(failure.into())
        }
    }
}

/// Notes how the way that was chosen ended.
fn note(action: &Act, ended: Result<String, Failure>) {
    let now = action.cx().now();
    action.with_state(|state| state.step.note(&mut state.belief, now, ended));
}

/// Tells the Dispatcher, and the log, how the trip went.
async fn tell(action: &Act, problem: Option<Failure>) {
    let (cx, args, store) = parts(action);
    let account = action.with_state(|state| {
        let step = &state.step;
        Account {
            command: step.command,
            context: step.context.clone(),
            tried: step.tried.clone(),
            problem,
            figures: match step.tried.is_empty() {
                true => Vec::new(),
                false => step::figures(&state.belief, &step.context, &args.costs()),
            },
        }
    });
    for line in account.lines() {
        tracing::info!(task = cx.name(), "{line}");
    }
    if !account.figures.is_empty() {
        let believed = (None, account.figures.clone());
        shown::show(&cx, &store, &account.context, believed).await;
    }
    if let Err(untold) = store.store(&cx, ACCOUNT, &account).await {
        tracing::warn!(%untold, "how a trip went could not be passed up");
    }
}

/// Waits until somebody ends the protective stop that ended the motion; the way is then gone from where the arm stands.
async fn await_resume(action: Act) -> Acted {
    let (cx, args, _) = parts(&action);
    let reason =
        action.with_state(|state| state.step.ended.as_ref().map(|ended| ended.reason.clone()));
    let resumed = args
        .arm(&cx)
        .resumed(args.resume_within_s, &reason.unwrap_or_default())
        .await;
    if let Err(failure) = resumed {
        note(&action, Err(failure.clone()));
        tell(&action, None).await;
        return Err(failure.into());
    }
    Ok(())
}

/// Notes that a way failed for which another one may do.
async fn next_way(action: Act) -> Acted {
    if let Some(failure) = action.with_state(|state| state.step.ended.take()) {
        note(&action, Err(failure));
    }
    Ok(())
}

/// Passes up why the trip could not be done.
async fn give_up(action: Act) -> Acted {
    if let Some(failure) = action.with_state(|state| state.step.ended.take()) {
        note(&action, Err(failure));
    }
    tell(&action, None).await;
    Ok(())
}

/// Gives the arm back.
async fn give_back(action: Act) -> Acted {
    let (cx, args, _) = parts(&action);
    let given = args.arm(&cx).release().await;
    if let Err(failure) = &given {
        tracing::warn!(%failure, "the arm could not be given back");
    }
    Ok(given?)
}
