//! The ways of looking that the Vision Coordinator knows: with the cameras of the room, and with the camera on the hand from other
//! poses. It takes the one most likely to see for its cost, and goes on with the next where that sees nothing, or not for sure.

use ctos::{
    config::{App, TaskConfig},
    diagnostic::{Finding, Findings},
    task::HandlerError,
};
use mcs::client::{Move, PathKind, Target};
use pnt::library::Acted;
use serde::{Deserialize, Serialize};
use vss::{
    command::{Snap, VisionError},
    frame::Frame,
    tool::fetched,
};

use super::{Act, VisionArgs, Where, look};
use crate::{
    arm::{self, Arm, ArmKeys},
    carry::{
        errand::{ERRAND, Errand, VISION_PROBLEMS, note_problem},
        sight::{FOUND, Found, Overview, SIGHT, Sight},
    },
    motion::{mcs_task, resume_within_s},
    outcome::{Failure, Outcome},
    strategy::{
        Step, shown,
        step::{self, Way},
    },
};

/// What looking is called in log, answers and belief.
const STEP: &str = "look";

/// What the cameras of the room are assumed to cost, s.
const ROOM_COST_S: f64 = 1.0;

/// Fewer pictures do not tell how high a thing lies.
const PICTURES: usize = 2;

/// A way of looking.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub(super) enum Viewpoint {
    /// The cameras of the room.
    Room,
    /// The camera on the hand, from the pose of that number.
    Hand(u8),
}

impl Way for Viewpoint {
    fn name(self) -> String {
        match self {
            Self::Room => "the room".to_owned(),
            Self::Hand(pose) => format!("pose {} of the hand", u32::from(pose) + 1),
        }
    }
}

/// The camera on the hand, and from where it looks when the others see nothing or not for sure.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct AnotherArgs {
    /// The camera.
    #[serde(default = "camera")]
    pub camera: String,
    /// The Tool that takes pictures.
    #[serde(default = "snap_task")]
    pub snap: String,
    /// The client interface of MCS.
    #[serde(default = "mcs_task")]
    pub mcs: String,
    /// The poses, a way each.
    pub poses: Vec<PoseArgs>,
    /// A board whose place has a larger standard deviation is seen in doubt, m.
    #[serde(default = "doubt_m")]
    pub doubt_m: f64,
    /// Fraction of full speed.
    #[serde(default = "speed")]
    pub speed: f64,
    /// Recipes of guards that watch the ways.
    #[serde(default)]
    pub clear: Vec<String>,
    /// Where the arm waits, degrees of its joints.
    pub park_deg: Vec<f64>,
    /// How long a protective stop is waited out, s.
    #[serde(default = "resume_within_s")]
    pub resume_within_s: f64,
}

/// A pose to look from.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct PoseArgs {
    /// Degrees of the arm's joints, at each of two places at least: two pictures tell heights.
    pub at_deg: Vec<Vec<f64>>,
    /// What it is assumed to cost before it has been tried, s.
    #[serde(default = "cost_s")]
    pub cost_s: f64,
}

fn camera() -> String {
    "hand".to_owned()
}

fn snap_task() -> String {
    "toolSnap".to_owned()
}

fn doubt_m() -> f64 {
    0.002
}

fn speed() -> f64 {
    0.5
}

fn cost_s() -> f64 {
    8.0
}

impl AnotherArgs {
    /// Why what was seen is in doubt, if it is.
    pub(super) fn doubt(&self, seen: &Overview) -> Option<String> {
        let board = &seen.board;
        if board.cameras.len() < PICTURES {
            return Some("only one camera sees the board, which does not tell heights".to_owned());
        }
        let sd = board.sd[3].hypot(board.sd[4]);
        let is_sure = sd <= self.doubt_m;
        (!is_sure).then(|| {
            let (sd, most) = (sd * 1e3, self.doubt_m * 1e3);
            format!(
                "the standard deviation of the board's place is {sd:.1} mm, more than {most:.1} mm"
            )
        })
    }

    /// Findings where they make no sense.
    pub(super) fn check(
        &self,
        (task, app): (&TaskConfig, &App),
        service_within_s: f64,
        findings: &mut Findings,
    ) {
        crate::need_task(task, app, "another.snap", &self.snap, findings);
        let keys = ArmKeys {
            mcs: &self.mcs,
            resume_within_s: self.resume_within_s,
            service_within_s,
            speeds: &[("speed", self.speed)],
            park_deg: Some(&self.park_deg),
        };
        keys.check(task, app, "coordinators::carry::eyes", findings);
        let mut wrong = |key: String, text: String| {
            let place = task.args.locate(&key).unwrap_or_else(|| task.place.clone());
            findings.push(Finding::error("coordinators::carry::eyes", text).at(place));
        };
        if !(1..=MOST_POSES).contains(&self.poses.len()) {
            let text = format!(
                "`another.poses` has {}; give from 1 to {MOST_POSES}",
                self.poses.len()
            );
            wrong("another.poses".to_owned(), text);
        }
        if !(1e-4..=0.1).contains(&self.doubt_m) {
            let text = format!(
                "`another.doubt_m` is {}; give from 0.0001 to 0.1 m",
                self.doubt_m
            );
            wrong("another.doubt_m".to_owned(), text);
        }
        let joints = self.park_deg.len();
        for (number, pose) in self.poses.iter().enumerate() {
            let key = format!("another.poses.{number}");
            if pose.at_deg.len() < PICTURES || pose.at_deg.iter().any(|at| at.len() != joints) {
                let text = format!(
                    "`{key}.at_deg` needs {PICTURES} places or more, each with {joints} joints: two pictures tell heights"
                );
                wrong(format!("{key}.at_deg"), text);
            }
            if !(1e-3..=3600.0).contains(&pose.cost_s) {
                let text = format!(
                    "`{key}.cost_s` is {}; give from 0.001 to 3600 s",
                    pose.cost_s
                );
                wrong(format!("{key}.cost_s"), text);
            }
        }
    }
}

/// More poses are not known.
const MOST_POSES: usize = 8;

/// The ways with what each is assumed to cost.
pub(super) fn costs(args: &VisionArgs) -> Vec<(Viewpoint, f64)> {
    let another = args.another.iter().filter(|_| args.board != Where::Known);
    let poses = another.flat_map(|another| &another.poses);
    let poses = (0..).zip(poses);
    let poses = poses.map(|(number, pose)| (Viewpoint::Hand(number), pose.cost_s));
    std::iter::once((Viewpoint::Room, ROOM_COST_S))
        .chain(poses)
        .collect()
}

/// Begins to look; all ways are open.
pub(super) async fn begin(action: Act, look: look::Look) -> Acted {
    action.with_state(|state| {
        state.look = look;
        state.tries_left = state.args.retries;
        state.step = Step::new(0, STEP.to_owned(), &costs(&state.args));
        (state.missed, state.was_seen) = (None, false);
    });
    Ok(())
}

/// Chooses the way most likely to see for its cost among those that were not tried yet.
pub(super) async fn choose(action: Act) -> Acted {
    let (args, store, step, belief, choices) = action.with_state(|state| {
        let (step, belief) = (state.step.clone(), state.belief.clone());
        let choices = state.choices + 1;
        (
            state.args.clone(),
            state.store.clone(),
            step,
            belief,
            choices,
        )
    });
    let cx = action.cx();
    // The same app with the same seed chooses the same, also after a restart.
    let mut rng = cx.rng(&format!("look {choices}"));
    let chosen = step.choose(&belief, &costs(&args), &mut rng);
    let (way, figures) = chosen.ok_or_else(|| HandlerError::new("no way is left"))?;
    if args.another.is_some() {
        shown::tell_choice(cx, &store, STEP, (way.name(), figures)).await;
    }
    action.with_state(|state| {
        state.choices = choices;
        state.step.begin(way, cx.now());
    });
    Ok(())
}

/// Looks with the cameras of the room.
pub(super) async fn from_the_room(action: Act) -> Acted {
    let saw = look::see(&action, Vec::new(), failed_before(&action)).await;
    let saw = saw.map_err(|failure| match failure.outcome {
        // Cameras that are covered or broken are no reason not to look with another one.
        Outcome::Fault if action.with_state(|state| state.args.another.is_some()) => {
            Failure::new(Outcome::Unseen, failure.reason)
        }
        _ => failure,
    });
    ended(&action, saw).await
}

/// Looks once more.
pub(super) async fn again(action: Act) -> Acted {
    action.with_state(|state| state.tries_left = state.tries_left.saturating_sub(1));
    from_the_room(action).await
}

/// Takes the camera on the hand to the places of the pose, and looks with its pictures.
pub(super) async fn from_another_pose(action: Act) -> Acted {
    let saw = match pictures(&action).await {
        Ok(pictures) => {
            let mut notes = failed_before(&action);
            let way = action.with_state(|state| state.step.chosen);
            notes.extend(way.map(|way| format!("seen from {}", way.name())));
            look::see(&action, pictures, notes).await
        }
        Err(failure) => Err(failure),
    };
    ended(&action, saw).await
}

/// The pictures of the chosen pose.
async fn pictures(action: &Act) -> Result<Vec<Frame>, Failure> {
    let (args, chosen) = action.with_state(|state| (state.args.clone(), state.step.chosen));
    let none = || Failure::new(Outcome::Fault, "no pose was chosen");
    let another = args.another.as_ref().ok_or_else(none)?;
    let Some(Viewpoint::Hand(number)) = chosen else {
        return Err(none());
    };
    let pose = another.poses.get(usize::from(number)).ok_or_else(none)?;
    let arm = hand(action, another, &args);
    arm.acquire().await?;
    // Whatever comes of it, it is given back.
    action.with_state(|state| state.has_moved = true);
    let mut pictures = Vec::new();
    for at_deg in &pose.at_deg {
        arm.travel(order(another, at_deg)).await?;
        pictures.push(picture(action, another).await?);
    }
    Ok(pictures)
}

async fn picture(action: &Act, another: &AnotherArgs) -> Result<Frame, VisionError> {
    let cx = action.cx();
    let tool = cx.task(&another.snap).await?;
    let camera = another.camera.clone();
    let taken = cx.call(&tool, Snap { camera }).await?;
    let mut frame = taken.and_then(|frame| fetched(cx, frame))?;
    // Its pixels go with it: the buffer may have others by then.
    frame.left = None;
    Ok(frame)
}

fn order(another: &AnotherArgs, at_deg: &[f64]) -> Move {
    let target = Target::Joints(arm::radians(at_deg));
    Move {
        guards: another.clear.clone(),
        ..arm::order(target, PathKind::Joint, another.speed)
    }
}

fn hand<'a>(action: &'a Act, another: &'a AnotherArgs, args: &VisionArgs) -> Arm<'a> {
    Arm {
        cx: action.cx(),
        mcs: &another.mcs,
        within_s: args.service_within_s,
    }
}

/// What the ways that were tried before have told, for people.
fn failed_before(action: &Act) -> Vec<String> {
    action.with_state(|state| {
        let tried = state.step.tried.iter();
        tried.map(|tried| tried.line(STEP)).collect()
    })
}

/// Keeps how the chosen way ended. What was seen in doubt counts as seen when no other way tells more.
async fn ended(action: &Act, saw: Result<Option<look::Told>, Failure>) -> Acted {
    let (failure, again) = match saw {
        Ok(told) => {
            let (board, doubt) = told.unzip();
            action.with_state(|state| {
                state.last = board.or(state.last);
                state.was_seen = true;
            });
            let Some(doubt) = doubt.flatten() else {
                note(action, Ok(String::new())).await;
                return Ok(());
            };
            (Failure::new(Outcome::Unseen, doubt), false)
        }
        Err(failure) => {
            let again = failure.outcome == Outcome::Unseen;
            (failure, again)
        }
    };
    action.with_state(|state| {
        // Only what was not seen from the room may be seen the next time.
        if !again || state.step.chosen != Some(Viewpoint::Room) {
            state.tries_left = 0;
        }
        state.step.ended = Some(failure.clone());
    });
    Err(failure.into())
}

/// Notes how the chosen way ended, and shows what is believed of all by now.
async fn note(action: &Act, ended: Result<String, Failure>) {
    let now = action.cx().now();
    let (store, line, figures) = action.with_state(|state| {
        state.step.note(&mut state.belief, now, ended);
        let line = state.step.tried.last().map(|tried| tried.line(STEP));
        let figures = step::figures(&state.belief, STEP, &costs(&state.args));
        let figures = state.args.another.is_some().then_some(figures);
        (state.store.clone(), line, figures)
    });
    let Some(figures) = figures else { return };
    if let Some(line) = line {
        tracing::info!(task = action.cx().name(), "{line}");
    }
    shown::show(action.cx(), &store, STEP, (None, figures)).await;
}

/// Notes why the chosen way did not see, or not for sure.
pub(super) async fn next_way(action: Act) -> Acted {
    let Some(failure) = action.with_state(|state| state.step.ended.take()) else {
        return Ok(());
    };
    note(&action, Err(failure.clone())).await;
    action.with_state(|state| {
        state.missed = Some(match state.missed.take() {
            None => failure,
            // The kind is that of the latest; the words are those of all.
            Some(first) => {
                let reason = format!("{}; {}", first.reason, failure.reason);
                Failure::new(failure.outcome, reason)
            }
        });
    });
    Ok(())
}

/// Says that what was seen in doubt is believed, and why no way told more.
pub(super) async fn tell_doubt(action: Act) -> Acted {
    let (store, look, is_sure) = action.with_state(|state| {
        let last = state.step.tried.last();
        let is_sure = last.is_none_or(|tried| tried.ended.is_ok());
        (state.store.clone(), state.look, is_sure)
    });
    if is_sure {
        return Ok(());
    }
    let mut lines = failed_before(&action);
    lines.push("what was seen in doubt is believed".to_owned());
    let cx = action.cx();
    let add = |notes: &mut Vec<String>| {
        let new = lines.iter().filter(|line| !notes.contains(line));
        let new: Vec<String> = new.cloned().collect();
        notes.extend(new);
    };
    match look {
        look::Look::Find => {
            let mut sight: Sight = store.fetch(cx, SIGHT).await?;
            add(&mut sight.notes);
            store.store(cx, SIGHT, &sight).await
        }
        look::Look::Verify | look::Look::Search => {
            let mut found: Found = store.fetch(cx, FOUND).await?;
            add(&mut found.notes);
            store.store(cx, FOUND, &found).await
        }
    }
}

/// Waits until somebody ends the protective stop that ended the chosen way.
pub(super) async fn await_resume(action: Act) -> Acted {
    let (args, ended) = action.with_state(|state| (state.args.clone(), state.step.ended.clone()));
    let (Some(another), Some(ended)) = (&args.another, ended) else {
        return Ok(());
    };
    let arm = hand(&action, another, &args);
    let resumed = arm.resumed(another.resume_within_s, &ended.reason).await;
    if let Err(failure) = &resumed {
        action.with_state(|state| state.missed = Some(failure.clone()));
    }
    Ok(resumed?)
}

/// Parks the arm, and gives it back, also where it cannot be parked: the Robot Coordinator goes on from there.
pub(super) async fn go_home(action: Act) -> Acted {
    let (args, store) = action.with_state(|state| (state.args.clone(), state.store.clone()));
    let Some(another) = &args.another else {
        return Ok(());
    };
    let arm = hand(&action, another, &args);
    let gone = async {
        arm.acquire().await?;
        arm.travel(order(another, &another.park_deg)).await
    };
    let gone: Result<_, Failure> = gone.await;
    let released = arm.release().await;
    if let Err(failure) = gone.map(|_| ()).and(released) {
        note_problem(action.cx(), &store, VISION_PROBLEMS, "park", &failure).await;
    }
    action.with_state(|state| state.has_moved = false);
    Ok(())
}

/// Goes on without having seen, where the configuration allows that; else the Dispatcher is told why.
pub(super) async fn do_without(action: Act) -> Acted {
    let (args, store) = action.with_state(|state| (state.args.clone(), state.store.clone()));
    let (asked, missed) = action.with_state(|state| (state.look, state.missed.clone()));
    let missed = missed.unwrap_or_else(|| Failure::new(Outcome::Fault, "nobody looked"));
    let cx = action.cx();
    if args.board == Where::SeenElseKnown && asked == look::Look::Find {
        tracing::warn!(reason = %missed, "the board is not seen: it is where the configuration has it");
        let without = async {
            let errand: Errand = store.fetch(cx, ERRAND).await?;
            let note = format!(
                "nobody saw the board, which is taken to be where it is configured: {}",
                missed.reason
            );
            look::known(cx, &store, asked, &errand, vec![note]).await
        };
        let without: Result<(), Failure> = without.await;
        return without.map_err(Into::into);
    }
    note_problem(cx, &store, VISION_PROBLEMS, asked.name(), &missed).await;
    Err(missed.into())
}
