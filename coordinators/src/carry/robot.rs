//! The Robot Coordinator: the functions of `nets/carry/robot.net`, which move the arm on the way of an errand.
//!
//! It knows several turns of the gripper about the vertical, and several ways above both ends. Of those with which the arm reaches
//! both ends, it takes the ones most likely to succeed for their cost. A touch that ends a motion is its end where something is set
//! down, and a failure elsewhere.

mod ride;
mod sight;
mod weighing;

use std::rc::Rc;

use ctos::{
    config::{App, TaskConfig},
    diagnostic::{Finding, Findings},
    registry::Registry,
    task::{Context, HandlerError},
};
use pnt::library::{Acted, Action, Library};
use serde::{Deserialize, Serialize};

use self::ride::Ride;
use super::{
    errand::{End, ROBOT_PROBLEMS, WAY, WAYS, Way, Ways},
    ways::{Doing, Going, Spot, Turn, WaysArgs, costs, turns},
};
use crate::{
    arm::{Arm, ArmKeys},
    dom::DomStore,
    handler::{self, NetArgs},
    motion::{mcs_task, resume_within_s},
    outcome::{Failure, Outcome},
    strategy::{
        Belief, Figures, Step, shown,
        step::{self, Tried},
    },
    wrist::WristArgs,
};

/// The handler's name.
pub const HANDLER: &str = "coordinators.carry_robot";

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
    /// The ways that it knows to above the thing and to above the target.
    #[serde(default)]
    ways: WaysArgs,
    /// The task that plans ways around everything; needed by the way `planned`.
    #[serde(default = "planner")]
    planner: String,
    /// Recipes of guards that watch the ways down.
    #[serde(default)]
    touch: Vec<String>,
    /// Recipes of guards that watch the ways to and fro.
    #[serde(default)]
    clear: Vec<String>,
    /// The camera on the hand that corrects the arm above the thing; none when it is left out.
    wrist: Option<WristArgs>,
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

fn planner() -> String {
    "paths".to_owned()
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
    /// Above the thing, as the camera on the hand sees it.
    Adjust,
    /// Down around the thing.
    Descend,
    /// Up with it, where it is weighed.
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
            Self::Adjust => "adjust",
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
    /// The part was begun again since MCS had gone in the midst of it.
    begun_again: bool,
    /// The way above an end, or of looking at the thing, that is in work.
    step: Step<Doing>,
    /// The grasp of the command in work.
    grasp: Step<Turn>,
    belief: Belief,
    choices: u64,
    /// What has been tried for this command, line by line.
    lines: Vec<String>,
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
        if self.ways.are_planned() {
            crate::need_task(task, app, "planner", &self.planner, findings);
        }
        if let Some(wrist) = &self.wrist {
            wrist.check(task, app, "wrist", "coordinators::carry::robot", findings);
        }
        let mut wrong = |key: &str, text: String| {
            let place = task.args.locate(key).unwrap_or_else(|| task.place.clone());
            findings.push(Finding::error("coordinators::carry::robot", text).at(place));
        };
        if let Err((key, text)) = self.ways.check() {
            wrong(&key, text);
        }
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
        begun_again: false,
        step: Step::default(),
        grasp: Step::default(),
        belief: Belief::default(),
        choices: 0,
        lines: Vec::new(),
    };
    let save = |state: &Coordinator| {
        let motion = (state.leg, state.ended.clone(), state.begun_again);
        let (step, grasp) = (state.step.clone(), state.grasp.clone());
        let (belief, lines) = (state.belief.clone(), state.lines.clone());
        (motion, step, grasp, belief, state.choices, lines)
    };
    let is_chosen =
        |way: Going| move |state: &Coordinator| state.step.chosen == Some(Doing::Go(way));
    let mut library = Library::new(state)
        .kept(
            save,
            |state, (motion, step, grasp, belief, choices, lines)| {
                (state.leg, state.ended, state.begun_again) = motion;
                (state.step, state.grasp) = (step, grasp);
                (state.belief, state.choices, state.lines) = (belief, choices, lines);
            },
        )
        .enabling("ways_left", |state: &Coordinator| {
            !state.step.open.is_empty()
        })
        .enabling("by_arch", is_chosen(Going::Arch))
        .enabling("by_line", is_chosen(Going::Line))
        .enabling("by_planned_way", is_chosen(Going::Planned))
        .enabling("way_stopped", |state: &Coordinator| state.step.is_stopped())
        .enabling("another_may_do", |state: &Coordinator| {
            state.step.may_go_on()
        })
        .action("begin_approach", |action| begin(action, Leg::Approach))
        .action("begin_transfer", |action| begin(action, Leg::Transfer))
        .action("begin_adjust", |action| begin(action, Leg::Adjust))
        .enabling("by_looking", |state: &Coordinator| {
            matches!(state.step.chosen, Some(Doing::Look(_)))
        })
        .enabling("is_adjusting", |state: &Coordinator| {
            state.leg == Leg::Adjust
        })
        .action("look", go_way)
        .action("go_without", go_without)
        .action("choose", choose)
        .action("go_arch", go_way)
        .action("go_line", go_way)
        .action("go_joint", go_way)
        .action("go_planned_way", go_way)
        .action("await_resume_on_way", await_resume_on_way)
        .action("next_way", next_way)
        .action("give_up_way", give_up_way)
        .enabling("stopped", |state: &Coordinator| {
            let ended = state.ended.as_ref();
            ended.is_some_and(|failure| failure.outcome == Outcome::Stopped)
        })
        .enabling("was_gone", |state: &Coordinator| {
            let ended = state.ended.as_ref();
            let was_gone = ended.is_some_and(|failure| failure.outcome == Outcome::Lost);
            was_gone && !state.begun_again
        })
        .action("again", |action: Act| async move {
            let leg = action.with_state(|state| state.leg);
            go(action, leg).await
        })
        .action("begin_again", |action: Act| async move {
            let leg = action.with_state(|state| {
                state.begun_again = true;
                state.leg
            });
            go(action, leg).await
        })
        .action("await_resume", await_resume);
    for leg in [
        Leg::Descend,
        Leg::Lift,
        Leg::SetDown,
        Leg::Withdraw,
        Leg::GoBack,
        Leg::Park,
    ] {
        library = library.action(leg.name(), move |action: Act| async move {
            action.with_state(|state| state.begun_again = false);
            go(action, leg).await
        });
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
    note_grasp(&action, leg, &gone).await;
    pass_up(&action, gone).await
}

/// Notes how the grasp ended, as far as that shows in a leg: what is lifted was grasped.
async fn note_grasp(action: &Act, leg: Leg, gone: &Result<(), Failure>) {
    let ended = match (leg, gone) {
        (Leg::Lift, Ok(())) => Ok(String::new()),
        (Leg::Descend, Err(failure)) if failure.outcome == Outcome::Guard => Err(failure.clone()),
        // These have nothing to do with the grasp.
        (
            Leg::Lift,
            Err(Failure {
                outcome: Outcome::Stuck,
                ..
            }),
        ) => return forget_grasp(action),
        (Leg::Descend, Err(failure)) if failure.outcome != Outcome::Stopped => {
            return forget_grasp(action);
        }
        (Leg::Withdraw, Ok(())) => Err(Failure::new(Outcome::Guard, "it was not grasped")),
        _ => return,
    };
    let now = action.cx().now();
    let noted = action.with_state(|state| {
        let grasp = &mut state.grasp;
        let was = grasp.tried.len();
        grasp.note(&mut state.belief, now, ended);
        let line = grasp.tried[was..].first();
        let line = line.map(|tried| tried.line(&grasp.context));
        state.lines.extend(line.clone());
        line.is_some()
    });
    if noted {
        tell(action).await;
        show_grasps(action).await;
    }
}

/// Shows what is believed of the turns of the gripper by now.
async fn show_grasps(action: &Act) {
    // Without a data object manager nobody is shown anything.
    let Ok(ride) = Ride::of(action).await else {
        return;
    };
    let costs = turns(&ride.errand.thing);
    let (context, figures) = action.with_state(|state| {
        let context = state.grasp.context.clone();
        let figures = step::figures(&state.belief, &context, &costs);
        (context, figures)
    });
    shown::show(ride.cx, &ride.store, &context, (None, figures)).await;
}

/// Learns nothing of the grasp in work.
fn forget_grasp(action: &Act) {
    action.with_state(|state| state.grasp.chosen = None);
}

/// Begins a way above an end; all ways are open. To the thing, a turn of the gripper is chosen before.
async fn begin(action: Act, leg: Leg) -> Acted {
    action.with_state(|state| state.leg = leg);
    let begun = begun(&action, leg).await;
    pass_up(&action, begun).await
}

async fn begun(action: &Act, leg: Leg) -> Result<(), Failure> {
    let ride = Ride::of(action).await?;
    let (command, args) = (ride.errand.command, ride.args.clone());
    if leg != Leg::Adjust || args.wrist.is_some() {
        ride.arm().acquire().await?;
    }
    if leg == Leg::Approach {
        choose_turn(action, &ride).await?;
    }
    let step = Step::new(command, leg.name().to_owned(), &known(&args, leg.name()));
    action.with_state(|state| state.step = step);
    Ok(())
}

/// Chooses a turn of the gripper that was not tried for this command, among those with which the arm reaches all of the way.
async fn choose_turn(action: &Act, ride: &Ride<'_>) -> Result<(), Failure> {
    let errand = &ride.errand;
    let costs = turns(&errand.thing);
    action.with_state(|state| {
        if state.grasp.command != errand.command {
            let context = format!("grasp of {}", errand.thing.name);
            state.grasp = Step::new(errand.command, context, &costs);
            state.lines = Vec::new();
        }
    });
    let mut first = None;
    loop {
        let (grasp, belief, choices) = action.with_state(|state| {
            state.choices += 1;
            (state.grasp.clone(), state.belief.clone(), state.choices)
        });
        let mut rng = action.cx().rng(&format!("turn {choices}"));
        let Some((turn, figures)) = grasp.choose(&belief, &costs, &mut rng) else {
            let none = || Failure::new(Outcome::Unreachable, "every turn of the gripper was tried");
            return Err(first.unwrap_or_else(none));
        };
        let now = action.cx().now();
        match ride.plan_all(turn.radians()).await {
            Ok(()) => {
                let way = Way {
                    command: errand.command,
                    turn: turn.radians(),
                    shift: None,
                };
                ride.store.store(ride.cx, WAY, &way).await?;
                tell_choice(action, &grasp.context, turn, figures).await;
                action.with_state(|state| state.grasp.begin(turn, now));
                return Ok(());
            }
            Err(failure) if failure.outcome == Outcome::Unreachable => {
                first.get_or_insert(failure);
                action.with_state(|state| state.grasp.open.retain(|open| *open != turn));
            }
            Err(failure) => return Err(failure),
        }
    }
}

/// Tells which way was chosen.
async fn tell_choice(action: &Act, step: &str, way: impl step::Way, figures: Vec<Figures>) {
    let store = action.with_state(|state| state.store.clone());
    shown::tell_choice(action.cx(), &store, step, (way.name(), figures)).await;
}

/// The ways of a step with what each is assumed to cost.
fn known(args: &RobotArgs, step: &str) -> Vec<(Doing, f64)> {
    match &args.wrist {
        _ if step == Leg::Transfer.name() => costs(&args.ways.transfer),
        Some(_) if step == Leg::Adjust.name() => Spot::COSTS.to_vec(),
        None if step == Leg::Adjust.name() => Vec::new(),
        _ => costs(&args.ways.approach),
    }
}

/// Chooses the way most likely to succeed for its cost among those that were not tried yet.
async fn choose(action: Act) -> Acted {
    let (args, step, belief, choices) = action.with_state(|state| {
        state.choices += 1;
        let (step, belief) = (state.step.clone(), state.belief.clone());
        (state.args.clone(), step, belief, state.choices)
    });
    // The same app with the same seed chooses the same, also after a restart.
    let mut rng = action.cx().rng(&format!("choice {choices}"));
    let chosen = step.choose(&belief, &known(&args, &step.context), &mut rng);
    let (way, figures) = chosen.ok_or_else(|| HandlerError::new("no way is left"))?;
    tell_choice(&action, &step.context, way, figures).await;
    let now = action.cx().now();
    action.with_state(|state| state.step.begin(way, now));
    Ok(())
}

/// Goes the way that was chosen, from where the arm stands.
async fn go_way(action: Act) -> Acted {
    let gone = gone(&action).await;
    match gone {
        Ok(about) => {
            note_way(&action, Ok(about)).await;
            Ok(())
        }
        Err(failure) => {
            action.with_state(|state| state.step.ended = Some(failure.clone()));
            Err(failure.into())
        }
    }
}

async fn gone(action: &Act) -> Result<String, Failure> {
    let ride = Ride::of(action).await?;
    ride.arm().acquire().await?;
    let (leg, chosen) = action.with_state(|state| (state.leg, state.step.chosen));
    let end = match leg {
        Leg::Transfer => End::To,
        _ => End::From,
    };
    match chosen {
        Some(Doing::Go(way)) => ride.go_above(end, way).await,
        Some(Doing::Look(spot)) => ride.look_from(spot).await,
        None => Err(Failure::new(Outcome::Fault, "no way was chosen")),
    }
}

/// What the camera on the hand does not tell from anywhere, the errand goes on without.
async fn go_without(action: Act) -> Acted {
    let tried = action.with_state(|state| state.step.tried.len());
    if tried > 0 {
        tracing::warn!(
            tried,
            "the camera on the hand tells nothing, from wherever it looked"
        );
    }
    Ok(())
}

/// Notes how the chosen way ended.
async fn note_way(action: &Act, ended: Result<String, Failure>) {
    let now = action.cx().now();
    action.with_state(|state| {
        let step = &mut state.step;
        step.note(&mut state.belief, now, ended);
        let line = step.tried.last();
        let line = line.map(|tried| tried.line(&step.context));
        state.lines.extend(line);
    });
    tell(action).await;
}

/// Tells the Dispatcher which ways were tried, and what is believed of them by now.
async fn tell(action: &Act) {
    let (store, ways, believed) = action.with_state(|state| {
        let mut lines = state.lines.clone();
        let believed = |context: &str, figures: &[Figures]| {
            format!("believed of {context}: {}", step::in_words(figures))
        };
        let going = known(&state.args, &state.step.context);
        let context = &state.step.context;
        let figures = step::figures(&state.belief, context, &going);
        lines.push(believed(context, &figures));
        let command = state.grasp.command;
        let believed = (context.clone(), figures);
        (state.store.clone(), Ways { command, lines }, believed)
    });
    for line in ways.lines.iter().rev().take(2).rev() {
        tracing::info!(task = action.cx().name(), "{line}");
    }
    let (step, figures) = believed;
    shown::show(action.cx(), &store, &step, (None, figures)).await;
    if let Err(untold) = store.store(action.cx(), WAYS, &ways).await {
        tracing::warn!(%untold, "which ways were gone could not be passed up");
    }
}

/// Waits until somebody ends the protective stop that ended the chosen way.
async fn await_resume_on_way(action: Act) -> Acted {
    let (args, ended) = action.with_state(|state| (state.args.clone(), state.step.ended.clone()));
    let reason = ended.map_or_else(String::new, |ended| ended.reason);
    let arm = args.arm(action.cx());
    let resumed = arm.resumed(args.resume_within_s, &reason).await;
    if let Err(failure) = &resumed {
        note_way(&action, Err(failure.clone())).await;
    }
    pass_up(&action, resumed).await
}

/// Notes that a way failed for which another one may do.
async fn next_way(action: Act) -> Acted {
    if let Some(failure) = action.with_state(|state| state.step.ended.take()) {
        note_way(&action, Err(failure)).await;
    }
    Ok(())
}

/// Passes up why the arm is not above the end.
async fn give_up_way(action: Act) -> Acted {
    let ended = action.with_state(|state| state.step.ended.take());
    if let Some(failure) = ended {
        note_way(&action, Err(failure.clone())).await;
        // Why it failed is told; that this was told is no failure.
        let _ = pass_up(&action, Err(failure)).await;
        return Ok(());
    }
    let tried = action.with_state(|state| state.step.tried.last().cloned());
    if let Some(Tried {
        ended: Err(failure),
        ..
    }) = tried
    {
        let _ = pass_up(&action, Err(failure)).await;
    }
    Ok(())
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
