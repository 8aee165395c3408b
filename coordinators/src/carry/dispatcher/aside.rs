//! What cannot be grasped for a thing beside it: that one is pushed aside first. To which side is chosen as other ways are; the Push
//! Coordinator does it, and cameras tell whether it has helped.

use ctos::task::HandlerError;
use nalgebra::{Point2, Point3, Vector2};
use pnt::library::Acted;
use serde::{Deserialize, Serialize};

use super::{
    state::{Act, parts},
    telling::hinder,
};
use crate::{
    carry::{
        errand::{ERRAND, Errand},
        sight::{self, Crowd, SIGHT, Sight},
    },
    outcome::{Failure, Outcome},
    push::job::{ACCOUNT, Account, JOB, Job},
    strategy::{
        Belief, Step, shown,
        step::{self, Way},
    },
};

/// What it is called in log, answers and belief.
const STEP: &str = "push aside";

/// What a push is assumed to cost before it has been tried, s.
const COST_S: f64 = 10.0;

/// So far before the thing the gripper goes down, from rim to the middle between the jaws, m.
const BEFORE_M: f64 = 0.03;

/// What pushes takes so much room around it, m: half its width and what is not known.
const ROUND_M: f64 = 0.02;

/// A thing goes further than it must by so much, m.
const FURTHER_M: f64 = 6e-3;

/// What was pushed in vain is seen within so much of its place, m.
const SAME_M: f64 = 0.01;

/// To which side, as seen from the thing that is to be taken.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub(in crate::carry) enum Side {
    /// Left.
    Left,
    /// Right.
    Right,
}

impl Way for Side {
    fn name(self) -> String {
        match self {
            Self::Left => "to the left".to_owned(),
            Self::Right => "to the right".to_owned(),
        }
    }
}

const COSTS: [(Side, f64); 2] = [(Side::Left, COST_S), (Side::Right, COST_S)];

/// What the Dispatcher knows of pushing aside.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub(in crate::carry) struct Aside {
    /// The sides to which the thing beside it may be pushed.
    step: Step<Side>,
    belief: Belief,
    /// Choices so far: each push is a job of its own.
    choices: u32,
    /// Pushes of the command in work.
    pushed: u32,
    /// What is pushed, in the board's frame, m.
    what: Option<Point2<f64>>,
}

impl Aside {
    /// Nothing was pushed for a new command.
    pub(super) fn begin_anew(&mut self) {
        (self.step, self.pushed, self.what) = (Step::default(), 0, None);
    }

    /// Whether anything was pushed for the command in work.
    pub(super) fn has_pushed(&self) -> bool {
        self.pushed > 0
    }

    /// Whether the chosen side is the left one.
    pub(super) fn is_left(&self) -> bool {
        self.step.chosen == Some(Side::Left)
    }
}

/// The way of what pushes, from where it goes down to where it ends, and where the other thing stands then; in the board's frame, m.
struct Push {
    from: Point2<f64>,
    to: Point2<f64>,
    ends: Point2<f64>,
}

/// A push across the line of both middles: they slide along one another until a finger goes between them.
fn push(errand: &Errand, crowd: &Crowd, side: Side) -> Option<Push> {
    let thing = &errand.thing;
    let radius = 0.5 * thing.width_m;
    let line = (crowd.other - crowd.thing).xy();
    let away = line.try_normalize(1e-9)?;
    let left = Vector2::new(-away.y, away.x);
    let along = match side {
        Side::Left => left,
        Side::Right => -left,
    };
    let apart = thing.apart() + FURTHER_M;
    let far = (apart.powi(2) - line.norm_squared()).max(0.0).sqrt();
    let other = crowd.other.xy();
    Some(Push {
        from: other - along * (radius + BEFORE_M),
        to: other + along * (far - radius),
        ends: other + along * far,
    })
}

/// Why there is no room to push it so, if there is none.
fn obstacle(errand: &Errand, sight: &Sight, crowd: &Crowd, push: &Push) -> Option<&'static str> {
    let (thing, board) = (&errand.thing, &sight.board);
    let radius = 0.5 * thing.width_m;
    let low = |at: f64| at.abs() < 0.5 * thing.height_m;
    if !(low(crowd.thing.z) && low(crowd.other.z)) {
        return Some("only what lies on the board itself is pushed");
    }
    let ends = Point3::new(push.ends.x, push.ends.y, 0.0);
    if !board.has(&board.field(&ends, thing.height_m)) {
        return Some("it would leave the board");
    }
    let to = board.on_board(&errand.to, thing.height_m).xy();
    if (push.ends - to).norm() < thing.apart() {
        return Some("it would stand in the way on TO");
    }
    let way = push.ends - push.from;
    let is_near = |at: &Point2<f64>| {
        let part = (at - push.from).dot(&way) / way.norm_squared();
        let nearest = push.from + way * part.clamp(0.0, 1.0);
        (at - nearest).norm() < radius + ROUND_M.max(radius)
    };
    let mut rest = crowd.rest.iter().map(|at| at.xy());
    if rest.any(|at| is_near(&at)) {
        return Some("something else is in the way there");
    }
    None
}

/// The sides to which there is room, and why there is none to the others.
fn sides(errand: &Errand, sight: &Sight, crowd: &Crowd) -> (Vec<Side>, Vec<String>) {
    let (mut open, mut shut) = (Vec::new(), Vec::new());
    for (side, _) in COSTS {
        let Some(push) = push(errand, crowd, side) else {
            continue;
        };
        match obstacle(errand, sight, crowd, &push) {
            None => open.push(side),
            Some(why) => shut.push(format!("{STEP}: not {}: {why}", side.name())),
        }
    }
    (open, shut)
}

/// Whether what is stuck to the thing is pushed aside, after what cameras see now. What was pushed before is judged by that.
pub(super) async fn may_push(action: &Act, errand: &Errand, sight: &Sight) -> bool {
    let crowd = sight::crowd(errand, sight);
    let crowd = crowd.as_ref();
    let what = crowd.map(|crowd| crowd.other.xy());
    let (was_pushed, most) = action.with_state(|state| {
        let was_chosen = state.aside.step.chosen.is_some();
        (
            was_chosen.then_some(state.aside.what).flatten(),
            state.args.pushes,
        )
    });
    if let Some(was) = was_pushed {
        let still = what.filter(|now| (now - was).norm() < SAME_M);
        let ended = match still {
            None => Ok(String::new()),
            Some(_) => Err(Failure::new(Outcome::Guard, "it still touches the thing")),
        };
        note(action, ended).await;
    }
    let Some(crowd) = crowd else { return false };
    let (open, shut) = sides(errand, sight, crowd);
    let may_push = action.with_state(|state| {
        let aside = &mut state.aside;
        let is_same = |was: Point2<f64>| (was - crowd.other.xy()).norm() < SAME_M;
        if !aside.what.is_some_and(is_same) {
            aside.step = Step::new(errand.command, STEP.to_owned(), &COSTS);
        }
        aside.what = Some(crowd.other.xy());
        aside.step.open.retain(|side| open.contains(side));
        aside.pushed < most && !aside.step.open.is_empty()
    });
    if most > 0 && !may_push {
        for line in shut {
            action.note(line);
        }
    }
    may_push
}

/// Chooses the side, and makes a job of it for the Push Coordinator.
pub(super) async fn choose_side(action: Act) -> Acted {
    let (cx, _, store) = parts(&action);
    let errand: Errand = store.fetch(&cx, ERRAND).await?;
    let sight: Sight = store.fetch(&cx, SIGHT).await?;
    let gone = || HandlerError::new("nothing is stuck to it any more");
    let crowd = sight::crowd(&errand, &sight).ok_or_else(gone)?;
    let aside = action.with_state(|state| state.aside.clone());
    let choices = aside.choices.wrapping_add(1);
    // The same app with the same seed chooses the same, also after a restart.
    let mut rng = cx.rng(&format!("side {choices}"));
    let chosen = aside.step.choose(&aside.belief, &COSTS, &mut rng);
    let (side, figures) = chosen.ok_or_else(|| HandlerError::new("no side is left"))?;
    let push = push(&errand, &crowd, side).ok_or_else(gone)?;
    let in_base = |at: Point2<f64>| (sight.board.pose() * Point3::new(at.x, at.y, 0.0)).xy();
    let job = Job {
        command: choices,
        from: in_base(push.from),
        to: in_base(push.to),
    };
    store.store(&cx, JOB, &job).await?;
    shown::tell_choice(&cx, &store, STEP, (side.name(), figures)).await;
    action.with_state(|state| {
        let aside = &mut state.aside;
        (aside.choices, aside.pushed) = (choices, aside.pushed + 1);
        aside.step.begin(side, cx.now());
    });
    Ok(())
}

/// Notes what the Push Coordinator could not do. Whether it is looked again: after a push that was done, and after one for which another
/// side may do.
pub(super) async fn weigh_push(action: Act) -> Acted {
    let (cx, _, store) = parts(&action);
    let account: Account = store.fetch(&cx, ACCOUNT).await?;
    let job = action.with_state(|state| state.aside.choices);
    let problems = match account.command == job {
        true => account.problems,
        false => Vec::new(),
    };
    for (request, failure) in &problems {
        hinder(&action, failure.outcome, &failure.reason);
        action.note(format!("{STEP}: {request}: {}", failure.reason));
    }
    let first = problems.into_iter().next().map(|(_, failure)| failure);
    let again = match first {
        None => true,
        Some(failure) => {
            let mut step = action.with_state(|state| state.aside.step.clone());
            step.ended = Some(failure.clone());
            note(&action, Err(failure)).await;
            step.may_go_on()
        }
    };
    action.with_state(|state| state.again = again);
    Ok(())
}

/// Notes how the push to the chosen side ended, and shows what is believed of both.
async fn note(action: &Act, ended: Result<String, Failure>) {
    let (cx, _, store) = parts(action);
    let (line, figures) = action.with_state(|state| {
        let aside = &mut state.aside;
        aside.step.note(&mut aside.belief, cx.now(), ended);
        let line = aside.step.tried.last().map(|tried| tried.line(STEP));
        (line, step::figures(&aside.belief, STEP, &COSTS))
    });
    let believed = format!("believed of {STEP}: {}", step::in_words(&figures));
    for line in line.into_iter().chain([believed]) {
        tracing::info!(task = cx.name(), "{line}");
        action.note(line);
    }
    shown::show(&cx, &store, STEP, (None, figures)).await;
}
