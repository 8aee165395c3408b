//! The class `manus`: moves the fingers of a hand per joint, per finger and per fingertip, through postures and sequences of
//! them, and has it grasp and let go (SORMA technical report, section 2.1.3).
//!
//! In an app it asks the task with the handler `mcs.hand`. In a process without one it has a hand of its own: kinematics,
//! limits, postures and times, but nothing to touch.

use std::{
    sync::{Arc, LazyLock, Mutex, PoisonError},
    time::Duration,
};

use futures_util::future::LocalBoxFuture;
use mcs::{
    Joints,
    client::{MotionError, PathKind},
    model::{built_in, file::Inertias},
    trajectory::{CartesianLimits, Goal, Pace, Planner, Route},
};
use nalgebra::{Point3, Vector3};
use sorma::{
    Context, Form, Method, OptionTable, Outcome, Report, ServiceObject, Transport, Waiting, words,
};

use super::{code, in_the_way};
use crate::{
    command::{HandState, LetGo, MoveFingers, ReadHand, SetStiffness, SwitchOff, Tripod},
    fingers::{FingerError, Fingers},
};

/// What is moved is answered at its end.
const LONGEST: Duration = Duration::from_secs(180);
/// Motions are checked every so many seconds, as with the usual servo.
const CHECK_PERIOD_S: f64 = 0.018;
/// Joints, and fingers, of the hand.
const JOINTS: usize = 9;
const FINGERS: usize = 3;
/// A sequence has no more steps.
const MOST_STEPS: usize = 1000;

const GIVES: &str = "18 floats: joint positions, rad, then the fingertips in the palm's frame, m";
const RESULTS: &str = "joints 3x3: rad; tips 3x3: m";

const fn form(text: &'static str, floats: usize, takes: &'static str, help: &'static str) -> Form {
    Form {
        text,
        floats,
        takes,
        gives: GIVES,
        results: RESULTS,
        help,
    }
}

const FORMS: &[Form] = &[
    form(
        "joints",
        9,
        "positions of the joints of finger 1, 2 and 3: spread, near and far, rad",
        "moves all joints",
    ),
    form(
        "joint",
        2,
        "number of the joint, 1 to 9, and its position, rad",
        "moves one joint",
    ),
    form(
        "joint by",
        2,
        "number of the joint, and how far, rad",
        "moves one joint on from where it is",
    ),
    form(
        "finger",
        4,
        "number of the finger, 1 to 3, and its joints: spread, near and far, rad",
        "moves one finger",
    ),
    form(
        "finger by",
        4,
        "number of the finger, and how far each joint, rad",
        "moves one finger on from where it is",
    ),
    form(
        "tip",
        4,
        "number of the finger, and x y z of its tip, m",
        "moves one fingertip to a place in the palm's frame",
    ),
    form(
        "tip by",
        4,
        "number of the finger, and how far its tip, m",
        "moves one fingertip on from where it is",
    ),
    form(
        "tips",
        9,
        "x y z of the tips of finger 1, 2 and 3, m",
        "moves all fingertips",
    ),
    form(
        "tips by",
        3,
        "x y z, m",
        "moves all fingertips on alike, and what they hold with them",
    ),
    form(
        "posture NAME",
        0,
        "",
        "takes a posture that the dictionary names: `posture.NAME q1 .. q9`, rad",
    ),
    form(
        "sequence NAME",
        0,
        "",
        "takes postures one after the other, each in its time: the dictionary's `sequence.NAME POSTURE SECONDS POSTURE SECONDS ..`",
    ),
    form("where", 0, "", "tells where the fingers are"),
    Form {
        text: "grasp",
        floats: 0,
        takes: "",
        gives: "3 floats: what each fingertip feels, N; or report 130",
        results: "touch 1x3: N",
        help: "grasps what is at -centre with three fingertips and -force, and verifies that each of them feels it",
    },
    Form {
        text: "release",
        floats: 0,
        takes: "",
        gives: GIVES,
        results: RESULTS,
        help: "lets go: the fingers go back to where they were before the grasp",
    },
    Form {
        text: "holds",
        floats: 0,
        takes: "",
        gives: "3 floats, as grasp; or report 130",
        results: "touch 1x3: N",
        help: "tells whether it holds what it grasped",
    },
    Form {
        text: "stiffness",
        floats: 1,
        takes: "spring of each joint, N m/rad; 0 makes them as stiff as the servo does",
        gives: "nothing",
        results: "",
        help: "how much the fingers comply, from now on",
    },
    Form {
        text: "off",
        floats: 0,
        takes: "",
        gives: "nothing",
        results: "",
        help: "switches power off: brakes hold the fingers",
    },
];

#[derive(Debug, Clone)]
pub(super) struct Options {
    task: String,
    speed: f64,
    force: f64,
    centre: Vec<f64>,
    signal: String,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            task: "hand".to_owned(),
            speed: 0.5,
            force: 2.0,
            centre: vec![0.0, 0.0, 0.145],
            signal: String::new(),
        }
    }
}

pub(super) static TABLE: LazyLock<OptionTable<Options>> = LazyLock::new(|| {
    OptionTable::new("moves the fingers of a hand")
        .exec(FORMS)
        .float("speed", 0.001..=1.0, "", "fraction of full speed", |options: &mut Options| &mut options.speed)
        .float("force", 0.1..=20.0, "N", "how hard each fingertip presses in a grasp", |options| &mut options.force)
        .floats(
            "centre",
            &["X", "Y", "Z"],
            -0.3..=0.3,
            "m",
            "in the palm's frame, where the fingertips would meet in a grasp",
            |options| &mut options.centre,
        )
        .word(
            "signal",
            "OBJECT",
            "which object is asked with EXEC and the reason when a grasp is not verified; empty for none",
            |options| &mut options.signal,
        )
        .word("task", "TASK", "the app's task with the handler mcs.hand", |options| &mut options.task)
});

/// A hand of this process: it goes as planned.
#[derive(Debug)]
struct LocalHand {
    planner: Planner,
    joints: Joints,
    /// Where they were before the last grasp.
    before: Option<Joints>,
}

/// The hand that all objects of a process share, and its kinematics.
#[derive(Debug, Clone)]
pub(super) struct SharedHand(Result<(Fingers, Arc<Mutex<LocalHand>>), Report>);

impl SharedHand {
    pub(super) fn new() -> Self {
        Self(Self::made())
    }

    fn made() -> Result<(Fingers, Arc<Mutex<LocalHand>>), Report> {
        let wrong = |text: String| Report::error(code::HAND, text);
        let model = built_in::model("hand", Inertias::Identified);
        let model = model.ok_or_else(|| wrong("there is no model `hand`".to_owned()))?;
        let model = Arc::new(model.map_err(|found| wrong(found.to_string()))?);
        let planner = Planner::new(
            Arc::clone(&model),
            CartesianLimits::default(),
            CHECK_PERIOD_S,
        );
        let hand = LocalHand {
            planner: planner.map_err(|error| wrong(error.to_string()))?,
            joints: Joints::zeros(model.dof()),
            before: None,
        };
        let fingers = Fingers::new(model).map_err(cannot)?;
        Ok((fingers, Arc::new(Mutex::new(hand))))
    }
}

fn cannot(error: FingerError) -> Report {
    Report::error(code::HAND, error.to_string())
}

/// An object of class `manus`.
pub(super) struct Manus {
    options: Options,
    fingers: Result<Fingers, Report>,
    own: SharedHand,
}

/// Where fingers shall go: joint positions, and in which time, s.
type Step = (Joints, Option<f64>);

impl Manus {
    pub(super) fn new(own: &SharedHand) -> Self {
        Self {
            options: Options::default(),
            fingers: own
                .0
                .as_ref()
                .map(|(fingers, _)| fingers.clone())
                .map_err(Report::clone),
            own: own.clone(),
        }
    }

    fn kinematics(&mut self) -> Result<&mut Fingers, Report> {
        self.fingers.as_mut().map_err(|report| report.clone())
    }

    async fn job(&mut self, cx: &Waiting<'_>, io: &mut Transport) -> Outcome {
        let form = TABLE.form(io)?.text;
        // The other forms of two words end with a name.
        if form.ends_with(" by") && io.text.trim() != form {
            let text = format!(
                "EXEC `{}` is not known here; did you mean `{form}`?",
                io.text.trim()
            );
            return Err(Report::error(sorma::report::code::UNSUPPORTED, text));
        }
        let given = io.floats.clone();
        match form {
            "grasp" => self.grasp(cx, io).await,
            "holds" => {
                let state = match cx.is_in_app() {
                    true => self.ask(cx, ReadHand {}).await?,
                    false => return Err(nothing("a hand of this process touches nothing")),
                };
                self.verified(cx, io, &state).await
            }
            "release" => {
                let joints = match cx.is_in_app() {
                    true => {
                        let speed = self.options.speed;
                        self.ask(cx, LetGo { speed }).await?.joints
                    }
                    false => {
                        let before = self.local(|hand| hand.before.unwrap_or(hand.joints))?;
                        self.go(cx, (before, None)).await?
                    }
                };
                self.answer(io, &joints)
            }
            "stiffness" => {
                io.floats.clear();
                let stiffness = given.first().copied().unwrap_or_default();
                if cx.is_in_app() {
                    let set = cx.call_task(&self.options.task, SetStiffness { stiffness }, LONGEST);
                    set.await?.map_err(in_the_way)?;
                }
                Ok(())
            }
            "off" => {
                io.floats.clear();
                if cx.is_in_app() {
                    let off = cx.call_task(&self.options.task, SwitchOff {}, LONGEST);
                    off.await?.map_err(in_the_way)?;
                }
                Ok(())
            }
            _ => {
                let now = self.joints(cx).await?;
                let steps = match form {
                    "where" => Vec::new(),
                    "posture NAME" => vec![(named(cx, io, &name(&io.text)).await?, None)],
                    "sequence NAME" => sequence(cx, io, &name(&io.text)).await?,
                    _ => vec![(self.goal(form, &now, &given)?, None)],
                };
                let mut joints = now;
                for step in steps {
                    joints = self.go(cx, step).await?;
                }
                self.answer(io, &joints)
            }
        }
    }

    /// Where a request wants the joints.
    fn goal(&mut self, form: &str, now: &Joints, given: &[f64]) -> Result<Joints, Report> {
        let at = |index: usize| given.get(index).copied().unwrap_or_default();
        let vector = |index: usize| Vector3::new(at(index), at(index + 1), at(index + 2));
        let mut to = *now;
        match form {
            "joints" => to = Joints::from_fn(JOINTS, at),
            "joint" | "joint by" => {
                let joint = number(at(0), JOINTS, "joint")? - 1;
                to[joint] = at(1) + if form == "joint" { 0.0 } else { now[joint] };
            }
            "finger" | "finger by" => {
                let finger = number(at(0), FINGERS, "finger")?;
                let joints = self.kinematics()?.joints(finger).map_err(cannot)?.to_vec();
                for (index, joint) in joints.into_iter().enumerate() {
                    to[joint] = at(index + 1) + if form == "finger" { 0.0 } else { now[joint] };
                }
            }
            "tip" | "tip by" => {
                let finger = number(at(0), FINGERS, "finger")?;
                let fingers = self.kinematics()?;
                let point = match form {
                    "tip" => Point3::from(vector(1)),
                    _ => fingers.tips(now)[finger - 1] + vector(1),
                };
                to = fingers.reach(finger, &point, now).map_err(cannot)?;
            }
            _ => {
                let fingers = self.kinematics()?;
                let tips = fingers.tips(now);
                for (index, tip) in tips.into_iter().enumerate() {
                    let point = match form {
                        "tips" => Point3::from(vector(3 * index)),
                        _ => tip + vector(0),
                    };
                    to = fingers.reach(index + 1, &point, &to).map_err(cannot)?;
                }
            }
        }
        Ok(to)
    }

    /// Moves the fingers, and tells where they are then.
    async fn go(&self, cx: &Waiting<'_>, (joints, time_s): Step) -> Result<Joints, Report> {
        let speed = self.options.speed;
        if cx.is_in_app() {
            let order = MoveFingers {
                joints,
                speed,
                time_s,
            };
            return Ok(self.ask(cx, order).await?.joints);
        }
        let route = |speed: f64| Route {
            goal: Goal::Joints(joints),
            path: PathKind::Joint,
            pace: Pace::new(speed, Some(1.0)),
            elbow: None,
        };
        let moved = self.local(|hand| {
            let wrong = |text: String| Report::error(code::HAND, text);
            let planned = hand
                .planner
                .segment(&hand.joints, &route(time_s.map_or(speed, |_| 1.0)));
            let (segment, end) = planned.map_err(|error| wrong(error.to_string()))?;
            if let Some(time) = time_s.filter(|time| *time < segment.duration()) {
                let least = segment.duration();
                return Err(wrong(format!(
                    "it takes {least:.2} s at least, not {time} s"
                )));
            }
            hand.joints = end;
            Ok(end)
        });
        moved?
    }

    async fn grasp(&self, cx: &Waiting<'_>, io: &mut Transport) -> Outcome {
        let at = |index: usize| self.options.centre.get(index).copied().unwrap_or_default();
        let order = Tripod {
            centre_m: [at(0), at(1), at(2)],
            force_n: self.options.force,
            speed: self.options.speed,
        };
        if !cx.is_in_app() {
            return Err(nothing("a hand of this process touches nothing"));
        }
        let state = self.ask(cx, order).await?;
        self.verified(cx, io, &state).await
    }

    /// Answers what fingertips feel, or says, also to -signal, that nothing is held.
    async fn verified(&self, cx: &Waiting<'_>, io: &mut Transport, state: &HandState) -> Outcome {
        io.floats = state.touch_n.to_vec();
        if state.holds {
            return Ok(());
        }
        let [one, two, three] = state.touch_n;
        let text = format!(
            "the fingertips feel {one:.2}, {two:.2} and {three:.2} N, and should press with {} N",
            self.options.force
        );
        if !self.options.signal.is_empty() {
            let said = Transport::text(format!("nothing is held: {text}"));
            cx.call(&self.options.signal, Method::Exec, said, io)
                .await?;
        }
        Err(nothing(text))
    }

    async fn ask<C: ctos::message::Command<Reply = Result<HandState, MotionError>>>(
        &self,
        cx: &Waiting<'_>,
        order: C,
    ) -> Result<HandState, Report> {
        let answer = cx.call_task(&self.options.task, order, LONGEST).await?;
        answer.map_err(in_the_way)
    }

    async fn joints(&self, cx: &Waiting<'_>) -> Result<Joints, Report> {
        match cx.is_in_app() {
            true => Ok(self.ask(cx, ReadHand {}).await?.joints),
            false => self.local(|hand| hand.joints),
        }
    }

    fn local<T>(&self, what: impl FnOnce(&mut LocalHand) -> T) -> Result<T, Report> {
        let (_, hand) = self.own.0.as_ref().map_err(Report::clone)?;
        // It is changed in whole steps, so one who panicked has left it whole.
        Ok(what(
            &mut hand.lock().unwrap_or_else(PoisonError::into_inner),
        ))
    }

    fn answer(&mut self, io: &mut Transport, joints: &Joints) -> Outcome {
        let tips = self.kinematics()?.tips(joints);
        io.floats = joints.to_vec();
        io.floats
            .extend(tips.iter().flat_map(|tip| [tip.x, tip.y, tip.z]));
        Ok(())
    }
}

fn nothing(text: impl Into<String>) -> Report {
    Report::error(code::NOTHING_HELD, text.into())
}

/// A number from 1 to `most` that came as a float.
fn number(given: f64, most: usize, what: &str) -> Result<usize, Report> {
    let whole = given as usize;
    if whole as f64 == given && (1..=most).contains(&whole) {
        return Ok(whole);
    }
    let text = format!("the hand has {what} 1 to {most}, not {given}");
    Err(Report::error(sorma::report::code::VALUE, text))
}

/// The name in `posture NAME`.
fn name(text: &str) -> String {
    let word = text.split_whitespace().nth(1);
    word.unwrap_or_default().to_owned()
}

/// The words that the dictionary has under `index`.
async fn entry(cx: &Waiting<'_>, io: &mut Transport, index: &str) -> Result<Vec<String>, Report> {
    let query = Transport::text(format!("-query {}", words::word(index)));
    let mut said = Transport::default();
    let found = cx.call("dict", Method::Ctrl, query, &mut said).await;
    let found = found.map_err(|_| {
        let text = format!(
            "the dictionary has no entry `{index}`; `dict CTRL -add {index} '..'` makes one"
        );
        Report::error(code::HAND, text)
    })?;
    io.reports.append(&mut said.reports);
    Ok(found.text.split_whitespace().map(str::to_owned).collect())
}

/// A posture of the dictionary, rad.
async fn named(cx: &Waiting<'_>, io: &mut Transport, name: &str) -> Result<Joints, Report> {
    let index = format!("posture.{name}");
    let words = entry(cx, io, &index).await?;
    let numbers: Option<Vec<f64>> = words.iter().map(|word| finite(word)).collect();
    let numbers = numbers.filter(|numbers| numbers.len() == JOINTS);
    let joints = numbers.and_then(|numbers| Joints::try_from(numbers.as_slice()).ok());
    joints.ok_or_else(|| {
        let text = format!(
            "the dictionary's entry `{index}` must be {JOINTS} joint positions, rad, not `{}`",
            words.join(" ")
        );
        Report::error(code::HAND, text)
    })
}

fn finite(word: &str) -> Option<f64> {
    word.parse().ok().filter(|number: &f64| number.is_finite())
}

/// A sequence of the dictionary: all of it is known before anything moves.
async fn sequence(cx: &Waiting<'_>, io: &mut Transport, name: &str) -> Result<Vec<Step>, Report> {
    let index = format!("sequence.{name}");
    let words = entry(cx, io, &index).await?;
    let wrong = |what: &str| {
        let text = format!(
            "the dictionary's entry `{index}` must be POSTURE SECONDS POSTURE SECONDS ..: {what}"
        );
        Report::error(code::HAND, text)
    };
    if words.is_empty() || words.len() % 2 != 0 || words.len() > 2 * MOST_STEPS {
        return Err(wrong(&format!("it has {} words", words.len())));
    }
    let mut steps = Vec::new();
    for pair in words.chunks(2) {
        let [posture, seconds] = pair else { continue };
        let time = finite(seconds).filter(|time| *time > 0.0 && *time <= 100.0);
        let time =
            time.ok_or_else(|| wrong(&format!("`{seconds}` is no time above 0 and up to 100 s")))?;
        steps.push((named(cx, io, posture).await?, Some(time)));
    }
    Ok(steps)
}

impl ServiceObject for Manus {
    fn exec_waiting<'a>(
        &'a mut self,
        cx: &'a Waiting<'a>,
        io: &'a mut Transport,
    ) -> Option<LocalBoxFuture<'a, Outcome>> {
        Some(Box::pin(async move {
            let outcome = self.job(cx, io).await;
            io.text.clear();
            if outcome.is_err() {
                io.floats.clear();
            }
            outcome
        }))
    }

    fn ctrl(&mut self, _cx: &Context<'_>, io: &mut Transport) -> Outcome {
        TABLE.ctrl(&mut self.options, io);
        Ok(())
    }

    fn dump(&self) -> String {
        TABLE.dump(&self.options)
    }
}
