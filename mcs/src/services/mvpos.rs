//! The class `mvpos`: moves the arm. In an app it asks the client interface of MCS; in a process without one it
//! moves the arm that the process holds for itself.

use std::{sync::LazyLock, time::Duration};

use futures_util::future::{LocalBoxFuture, join_all};
use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion, Vector3};
use sorma::{
    Context, Form, Method, OptionTable, Outcome, Report, ServiceObject, Transport, Waiting, words,
};

use super::kinematics;
use super::local::{SharedArm, rows, target};
use super::wspc::guard_name;
use super::{code, ended, in_the_way, known, six, streaming};
use crate::client::{
    Acquire, Move, MoveReport, PathKind, Plan, PlanReport, Position, ReadPosition, Release, Status,
    StreamKind, StreamSetpoints,
};
use crate::joints::Joints;
use crate::model::inverse::Elbow;
use crate::servo::QUEUE;
use crate::state::State;
use crate::trajectory::registry::NameTooLong;
use crate::trajectory::{Blend, Goal, Pace, Route};

/// A motion is answered at its end.
const LONGEST_MOVE: Duration = Duration::from_secs(3600);
/// Anything else is answered at once, but for coming to rest.
const DEADLINE: Duration = Duration::from_secs(30);

const FORMS: &[Form] = &[
    Form {
        text: "joints",
        floats: Form::ANY,
        takes: "joint positions q1 to qn, as many as the arm has joints, rad or m",
        gives: "n + 1 floats: joint positions at the end, rad or m, and how long it took, s",
        results: "q1 q2 q3 q4 q5 q6: rad; took: s",
        help: "moves the joints there",
    },
    Form {
        text: "by",
        floats: Form::ANY,
        takes: "how far each joint turns or slides, rad or m",
        gives: "n + 1 floats, as joints",
        results: "q1 q2 q3 q4 q5 q6: rad; took: s",
        help: "moves the joints on: while the arm is held, from where they shall be, and after its power was off, from where they are",
    },
    Form {
        text: "along",
        floats: Form::ANY,
        takes: "up to 8 joint positions, one after the other, as many numbers for each as the arm has joints, rad or m",
        gives: "n + 1 floats, as joints, at the last of them",
        results: "q1 q2 q3 q4 q5 q6: rad; took: s",
        help: "moves through joint positions in their order, with a stop at each as far as -blend does not leave it out",
    },
    Form {
        text: "pose",
        floats: 16,
        takes: "base_T_tool, or reference_T_tool, row by row, m",
        gives: "n + 1 floats, as joints",
        results: "q1 q2 q3 q4 q5 q6: rad; took: s",
        help: "moves the tool to a pose in the reference frame",
    },
    Form {
        text: "place",
        floats: 6,
        takes: "x y z, m, and roll pitch yaw about the base's x, y and z, rad",
        gives: "n + 1 floats, as joints",
        results: "q1 q2 q3 q4 q5 q6: rad; took: s",
        help: "moves the tool to a place in the reference frame",
    },
    Form {
        text: "shift",
        floats: 6,
        takes: "dx dy dz, m, and roll pitch yaw about the base's axes, rad",
        gives: "n + 1 floats, as joints",
        results: "q1 q2 q3 q4 q5 q6: rad; took: s",
        help: "moves the tool on, from where by does, and turns it about itself, both along the base's axes",
    },
    Form {
        text: "relative",
        floats: 16,
        takes: "tool_T_goal, row by row, m",
        gives: "n + 1 floats, as joints",
        results: "q1 q2 q3 q4 q5 q6: rad; took: s",
        help: "moves the tool on, from where by does, along its own axes, by a transformation matrix",
    },
    Form {
        text: "arc",
        floats: 9,
        takes: "x y z of a point on the way, m; then x y z, m, and roll pitch yaw, rad, of the target, as place",
        gives: "n + 1 floats, as joints, and a text with the smallest singular value of the Jacobian on the way",
        results: "q1 q2 q3 q4 q5 q6: rad; took: s",
        help: "moves the tool from where it is along the arc of a circle through the point to the target",
    },
    Form {
        text: "about",
        floats: 9,
        takes: "x y z of the centre, m; then x y z, m, and roll pitch yaw, rad, of the target, as place",
        gives: "as arc",
        results: "q1 q2 q3 q4 q5 q6: rad; took: s",
        help: "moves the tool from where it is along the arc of a circle about the centre to the target, which is as far from the \
               centre; the shorter way round unless -longer is set",
    },
    Form {
        text: "arch",
        floats: 7,
        takes: "how far above the higher end it goes across, m; then x y z, m, and roll pitch yaw, rad, of the target, as place",
        gives: "as arc",
        results: "q1 q2 q3 q4 q5 q6: rad; took: s",
        help: "moves the tool up along the base's z axis, across and down to the target, with corners of -corner",
    },
    Form {
        text: "where",
        floats: 0,
        takes: "",
        gives: "n + 16 floats: joint positions, rad or m, and base_T_tool, row by row, m",
        results: "q1 q2 q3 q4 q5 q6: rad; base_T_tool 4x4: m",
        help: "tells where the arm is",
    },
    Form {
        text: "listen",
        floats: 0,
        takes: "",
        gives: "1 float: age of the newest value, s; 1 int: values taken",
        results: "age: s; ints values",
        help: "follows poses or displacements of the tool from buffer -listen until EXEC release, a stop or silence",
    },
    Form {
        text: "release",
        floats: 0,
        takes: "",
        gives: "nothing",
        results: "",
        help: "switches power off and gives the arm back after -keep",
    },
    Form {
        text: "POSITION",
        floats: 0,
        takes: "",
        gives: "n + 1 floats, as joints",
        results: "q1 q2 q3 q4 q5 q6: rad; took: s",
        help: "moves to a position that the dictionary names: `position.NAME q1 .. qn`, rad or m",
    },
    Form {
        text: "",
        floats: 0,
        takes: "",
        gives: "n + 1 floats, as joints",
        results: "q1 q2 q3 q4 q5 q6: rad; took: s",
        help: "moves to the flavor's own position, -to",
    },
];

/// The same of an arm with so many joints.
fn forms(n: usize) -> Vec<Form> {
    let counted = |form: &Form| match form.text {
        "joints" | "by" => Form {
            floats: n,
            takes: "one number for each joint in the model's order, rad or m",
            ..*form
        },
        _ => *form,
    };
    FORMS.iter().map(counted).collect()
}

#[derive(Debug, Clone)]
pub(super) struct Options {
    client: String,
    to: Vec<f64>,
    path: String,
    speed: f64,
    acceleration: Vec<f64>,
    reference: Vec<f64>,
    elbow: String,
    planner: String,
    with: Vec<f64>,
    corner: Vec<f64>,
    longer: bool,
    blend: f64,
    blend_by: String,
    plan: bool,
    keep: bool,
    guards: String,
    listen: String,
    age: f64,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            client: "mcs".to_owned(),
            to: Vec::new(),
            path: "joint".to_owned(),
            speed: 0.3,
            acceleration: Vec::new(),
            reference: Vec::new(),
            elbow: "nearest".to_owned(),
            planner: String::new(),
            with: Vec::new(),
            corner: Vec::new(),
            longer: false,
            blend: 0.0,
            blend_by: "share".to_owned(),
            plan: false,
            keep: false,
            guards: String::new(),
            listen: String::new(),
            age: 0.5,
        }
    }
}

pub(super) static TABLE: LazyLock<OptionTable<Options>> = LazyLock::new(|| {
    OptionTable::new("moves an arm")
        .exec(FORMS)
        .float(
            "speed",
            0.001..=1.0,
            "",
            "fraction of full speed",
            |options: &mut Options| &mut options.speed,
        )
        .floats(
            "acceleration",
            &["A"],
            0.001..=1.0,
            "",
            "fraction of full acceleration; as -speed unless it is set",
            |options| &mut options.acceleration,
        )
        .floats(
            "reference",
            &["X", "Y", "Z", "ROLL", "PITCH", "YAW"],
            -10.0..=10.0,
            "m, rad",
            "the frame, in the base, in which pose and place are given; the base itself unless it is set",
            |options| &mut options.reference,
        )
        .choice(
            "path",
            &["joint", "line"],
            "whether every joint takes a course of its own, all in the time of the slowest, or the tool goes along a straight \
             line; arc, about and arch have paths of their own",
            |options| &mut options.path,
        )
        .choice(
            "elbow",
            &["nearest", "above", "below"],
            "posture at a pose; nearest to where the joints are",
            |options| &mut options.elbow,
        )
        .float(
            "blend",
            0.0..=1.0,
            "",
            "how much of the stop at the position before may be left out: 0 nothing, 1 the second half of the way there and \
             the first half of the way on give way to a bridge between both; see -blendBy",
            |options| &mut options.blend,
        )
        .choice(
            "blendBy",
            &["share", "radius", "joints"],
            "what -blend counts: a share of both halves, the distance of the tool from the position before, m, or the largest \
             distance of a joint from it, rad or m; never more than both halves",
            |options| &mut options.blend_by,
        )
        .word(
            "planner",
            "NAME",
            "a path planner that the program registers, instead of -path: joint, direct, line, arc, about, arch or one of its own",
            |options| &mut options.planner,
        )
        .floats(
            "with",
            &["N1", "..", "NN"],
            -1e6..=1e6,
            "",
            "the numbers that -planner takes",
            |options| &mut options.with,
        )
        .floats(
            "corner",
            &["R"],
            0.001..=10.0,
            "m",
            "the radius of the corners of an arch; as large as there is room unless it is set",
            |options| &mut options.corner,
        )
        .flag(
            "longer",
            "whether about goes the longer way round",
            |options| &mut options.longer,
        )
        .floats(
            "to",
            &["Q1", "..", "QN"],
            -10.0..=10.0,
            "rad or m",
            "the position of a flavor, as many numbers as the arm has joints, to which EXEC without a text moves",
            |options| &mut options.to,
        )
        .flag(
            "plan",
            "only tells where a motion would end and how long it would take",
            |options| &mut options.plan,
        )
        .flag(
            "keep",
            "keeps the arm and its power after a motion, until EXEC release",
            |options| &mut options.keep,
        )
        .word(
            "guards",
            "NAMES",
            "guards that watch the motions, with commas between: wspc.NAME, whose recipe is put in force, or NAME of one that \
             the arm has",
            |options| &mut options.guards,
        )
        .word(
            "listen",
            "BUFFER",
            "the snapshot buffer of poses or displacements that EXEC listen follows",
            |options| &mut options.listen,
        )
        .float(
            "age",
            0.001..=60.0,
            "s",
            "a value of -listen older than this brings the arm to rest",
            |options| &mut options.age,
        )
        .word(
            "client",
            "TASK",
            "the app's task with the client interface of MCS",
            |options| &mut options.client,
        )
});

/// An object of class `mvpos`.
pub(super) struct MvPos {
    options: Options,
    arm: SharedArm,
}

impl MvPos {
    pub(super) fn new(arm: &SharedArm) -> Self {
        Self {
            options: Options::default(),
            arm: arm.clone(),
        }
    }

    /// The way that a form with these numbers takes.
    fn path(&self, form: &str, numbers: &[f64]) -> Result<PathKind, Report> {
        let given = six(numbers);
        let [x, y, z, ..] = given;
        let point = self.reference() * Point3::new(x, y, z);
        let point = [point.x, point.y, point.z];
        let planner = self.options.planner.trim();
        Ok(match (form, self.options.path.as_str()) {
            ("arc", _) => PathKind::Arc { through: point },
            ("about", _) => PathKind::ArcAbout {
                centre: point,
                longer: self.options.longer,
            },
            ("arch", _) => PathKind::Arch {
                height: given[0],
                corner: self.options.corner.first().copied(),
            },
            _ if !planner.is_empty() => {
                let wrong = |error: String| Report::error(sorma::report::code::VALUE, error);
                let numbers = Joints::try_from(&self.options.with[..]);
                PathKind::Named {
                    name: planner
                        .parse()
                        .map_err(|error: NameTooLong| wrong(error.to_string()))?,
                    numbers: numbers.map_err(|error| wrong(format!("-with: {error}")))?,
                }
            }
            (_, "line") => PathKind::StraightLine,
            _ => PathKind::Joint,
        })
    }

    fn blend(&self) -> Blend {
        let most = self.options.blend;
        match self.options.blend_by.as_str() {
            "radius" => Blend::Radius(most),
            "joints" => Blend::Joints(most),
            _ => Blend::Share(most),
        }
    }

    fn pace(&self) -> Pace {
        Pace::new(
            self.options.speed,
            self.options.acceleration.first().copied(),
        )
    }

    /// `base_t_reference`.
    fn reference(&self) -> Isometry3<f64> {
        match self.options.reference.len() {
            6 => place(&six(&self.options.reference)),
            _ => Isometry3::identity(),
        }
    }

    fn elbow(&self) -> Option<Elbow> {
        match self.options.elbow.as_str() {
            "above" => Some(Elbow::Above),
            "below" => Some(Elbow::Below),
            _ => None,
        }
    }

    /// Does what a request wants; the text of the answer.
    async fn job(&self, cx: &Waiting<'_>, io: &mut Transport) -> Result<String, Report> {
        let text = self.form(cx, io).await?;
        match text {
            "where" => {
                let (joints, pose) = self.position(cx).await?;
                answer(io, &joints, &pose);
                Ok(String::new())
            }
            "listen" => {
                let guards = match cx.is_in_app() {
                    true => self.guards(cx, io).await?,
                    false => Vec::new(),
                };
                let request = StreamSetpoints {
                    kind: StreamKind::Tool,
                    buffer: Some(self.options.listen.clone()).filter(|name| !name.is_empty()),
                    max_age_s: self.options.age,
                    speed: self.options.speed,
                    acceleration: self.options.acceleration.first().copied(),
                    guards,
                };
                streaming::listen(cx, &self.options.client, request, io)
                    .await
                    .map(|()| String::new())
            }
            "release" => {
                io.floats.clear();
                if cx.is_in_app() {
                    let released = cx.call_task(&self.options.client, Release {}, DEADLINE);
                    released.await?.map_err(in_the_way)?;
                }
                Ok(String::new())
            }
            _ => {
                let path = self.path(text, &io.floats)?;
                let goals = match text {
                    "along" => self.goals(cx, io).await?,
                    _ => vec![self.goal(text, cx, io).await?],
                };
                let planned = match cx.is_in_app() {
                    true => self.ask(cx, (path, &goals), io).await?,
                    false => self.move_here(path, &goals)?,
                };
                io.floats.clear();
                io.floats.extend_from_slice(&planned.joints);
                io.floats.push(planned.duration_s);
                let smallest = planned.smallest_singular_value;
                Ok(smallest.map_or_else(String::new, |smallest| {
                    format!("smallest singular value {smallest:.6e}")
                }))
            }
        }
    }

    /// Which form the request has. Joint positions are counted by the arm that it is for.
    async fn form(&self, cx: &Waiting<'_>, io: &Transport) -> Result<&'static str, Report> {
        let counted = ["joints", "by"].contains(&io.text.trim());
        if !counted {
            return TABLE.form(io).map(|form| form.text);
        }
        let (joints, _) = self.position(cx).await?;
        sorma::options::form(&forms(joints.len()), io).map(|form| form.text)
    }

    /// The positions of a way through several.
    async fn goals(&self, cx: &Waiting<'_>, io: &Transport) -> Result<Vec<Goal>, Report> {
        let (joints, _) = self.position(cx).await?;
        let (needed, given) = (joints.len(), io.floats.len());
        let goals = io.floats.chunks_exact(needed);
        let goals: Result<Vec<Goal>, _> = goals
            .map(|goal| Joints::try_from(goal).map(Goal::Joints))
            .collect();
        let goals = goals.map_err(|error| Report::error(code::MOTION, error.to_string()))?;
        if !(1..=QUEUE).contains(&goals.len()) || goals.len() * needed != given {
            let text = format!(
                "EXEC along takes {needed} floats for each of 1 to {QUEUE} positions, not {given} in all"
            );
            return Err(Report::error(sorma::report::code::VALUE, text));
        }
        Ok(goals)
    }

    /// Where the request wants it to go.
    async fn goal(&self, form: &str, cx: &Waiting<'_>, io: &mut Transport) -> Result<Goal, Report> {
        let given = six(&io.floats);
        let positions = |floats: &[f64]| {
            let found = Joints::try_from(floats);
            found.map_err(|error| Report::error(code::MOTION, error.to_string()))
        };
        Ok(match form {
            "joints" => Goal::Joints(positions(&io.floats)?),
            "pose" => Goal::Pose(self.reference() * kinematics::pose(io)?),
            "place" => Goal::Pose(self.reference() * place(&given)),
            "arc" | "about" | "arch" => {
                let before = if form == "arch" { 1 } else { 3 };
                let target = six(io.floats.get(before..).unwrap_or_default());
                Goal::Pose(self.reference() * place(&target))
            }
            "relative" => {
                let by = kinematics::pose(io)?;
                let (_, now) = self.commanded(cx).await?;
                Goal::Pose(now * by)
            }
            "by" => {
                let (now, _) = self.commanded(cx).await?;
                let by = positions(&io.floats)?;
                let pairs = |index: usize| now[index] + by.get(index).copied().unwrap_or_default();
                Goal::Joints(Joints::from_fn(now.len(), pairs))
            }
            "shift" => {
                let (_, now) = self.commanded(cx).await?;
                let by = place(&given);
                Goal::Pose(Isometry3::from_parts(
                    Translation3::from(now.translation.vector + by.translation.vector),
                    by.rotation * now.rotation,
                ))
            }
            "" if !self.options.to.is_empty() => Goal::Joints(positions(&self.options.to)?),
            "" => {
                let text = format!(
                    "`{}` has no position of its own; set -to, or say where: EXEC joints FMSG 6 ..",
                    cx.name()
                );
                return Err(Report::error(code::NO_POSITION, text));
            }
            _ => {
                let (now, _) = self.position(cx).await?;
                Goal::Joints(named(cx.here(), io, now.len())?)
            }
        })
    }

    /// Where the arm is: its joints and its tool.
    async fn position(&self, cx: &Waiting<'_>) -> Result<(Joints, Isometry3<f64>), Report> {
        if !cx.is_in_app() {
            let mut arm = self.arm.lock()?;
            return Ok((arm.joints, arm.pose()));
        }
        let client = &self.options.client;
        let Position {
            joints,
            base_t_tool,
            ..
        } = cx.call_task(client, ReadPosition {}, DEADLINE).await?;
        let mut pose = Transport::floats(base_t_tool);
        Ok((joints, kinematics::pose(&mut pose)?))
    }

    /// Where the arm shall be, from which a motion goes on: what it is off by is in no sum of such motions.
    async fn commanded(&self, cx: &Waiting<'_>) -> Result<(Joints, Isometry3<f64>), Report> {
        if !cx.is_in_app() {
            return self.position(cx).await;
        }
        let client = &self.options.client;
        let Position {
            commanded,
            base_t_commanded,
            ..
        } = cx.call_task(client, ReadPosition {}, DEADLINE).await?;
        let mut pose = Transport::floats(base_t_commanded);
        Ok((commanded, kinematics::pose(&mut pose)?))
    }

    /// Moves the arm of this process.
    fn move_here(&self, path: PathKind, goals: &[Goal]) -> Result<PlanReport, Report> {
        if !self.options.guards.trim().is_empty() && !self.options.plan {
            let text = "the arm of this process has no servo that could ask guards; clear it with -guards ''";
            return Err(Report::error(code::MOTION, text));
        }
        let mut arm = self.arm.lock()?;
        let routes: Vec<Route> = goals
            .iter()
            .map(|goal| Route {
                goal: *goal,
                path,
                pace: self.pace(),
                elbow: self.elbow(),
            })
            .collect();
        let planned = arm.plan(&routes, self.blend());
        let planned = planned.map_err(|error| Report::error(code::MOTION, error.to_string()))?;
        if !self.options.plan {
            arm.moved(planned.joints, planned.duration_s);
        }
        Ok(planned)
    }

    /// The guards that are to watch a motion; those that are recipes of the dictionary are put in force.
    async fn guards(&self, cx: &Waiting<'_>, io: &mut Transport) -> Result<Vec<String>, Report> {
        let mut names = Vec::new();
        let all = self.options.guards.split(',').map(str::trim);
        for name in all.filter(|name| !name.is_empty()) {
            if name.contains('.') {
                let order = Transport::text(format!("for {}", self.options.client));
                cx.call(name, Method::Exec, order, io).await?;
            }
            names.push(guard_name(name).to_owned());
        }
        Ok(names)
    }

    /// Has the app's arm move.
    async fn ask(
        &self,
        cx: &Waiting<'_>,
        (path, goals): (PathKind, &[Goal]),
        io: &mut Transport,
    ) -> Result<PlanReport, Report> {
        let (client, speed) = (&self.options.client, self.options.speed);
        let acceleration = self.options.acceleration.first().copied();
        let elbow = self.elbow();
        if self.options.plan {
            let [goal] = goals else {
                let text =
                    "-plan tells of one motion from where the arm is; ask for each position alone";
                return Err(Report::error(code::MOTION, text));
            };
            let plan = Plan {
                target: target(goal),
                path,
                speed,
                acceleration,
                elbow,
            };
            let planned = cx.call_task(client, plan, DEADLINE).await?;
            return planned.map_err(in_the_way);
        }
        let guards = self.guards(cx, io).await?;
        let status = cx.call_task(client, Status {}, DEADLINE).await?;
        let acquires = status.state == State::Cold;
        if acquires {
            let acquired = cx.call_task(client, Acquire {}, DEADLINE).await?;
            acquired.map_err(in_the_way)?;
        }
        let moves = goals.iter().map(|goal| {
            let order = Move {
                target: target(goal),
                path,
                speed,
                acceleration,
                elbow,
                blend: self.blend(),
                guards: guards.clone(),
            };
            cx.call_task(client, order, LONGEST_MOVE)
        });
        // Each waits in the queue of the arm for the one before it.
        let moved = join_all(moves).await.into_iter();
        let moved = moved.map(|moved| moved.and_then(|moved| moved.map_err(in_the_way)));
        let moved: Result<Vec<MoveReport>, Report> = moved.collect();
        if acquires && (!self.options.keep || moved.is_err()) {
            // It was had for this motion, whatever became of it.
            let released = cx.call_task(client, Release {}, DEADLINE).await;
            let moved = moved?;
            released?.map_err(in_the_way)?;
            return Ok(last_of(&moved));
        }
        Ok(last_of(&moved?))
    }
}

/// Where the last of several motions ended, how long all took, and the smallest singular value on the way.
fn last_of(moved: &[MoveReport]) -> PlanReport {
    let joints = moved.last().map(|moved| moved.joints);
    let values = moved
        .iter()
        .filter_map(|moved| moved.smallest_singular_value);
    PlanReport {
        joints: joints.unwrap_or_default(),
        duration_s: moved.iter().map(|moved| moved.duration_s).sum(),
        smallest_singular_value: values.reduce(f64::min),
    }
}

/// x y z and roll pitch yaw as a pose.
fn place(numbers: &[f64; 6]) -> Isometry3<f64> {
    let [x, y, z, roll, pitch, yaw] = *numbers;
    Isometry3::from_parts(
        Translation3::from(Vector3::new(x, y, z)),
        UnitQuaternion::from_euler_angles(roll, pitch, yaw),
    )
}

/// The positions of `count` joints that the dictionary has under the name in the request.
fn named(cx: &Context<'_>, io: &mut Transport, count: usize) -> Result<Joints, Report> {
    let name = io.text.clone();
    if let Some(form) = forms(count).iter().find(|form| form.text == name) {
        let text = format!(
            "EXEC {name} takes {} floats ({}): write FMSG {} and the numbers",
            form.floats, form.takes, form.floats
        );
        return Err(Report::error(sorma::report::code::VALUE, text));
    }
    let wrong = |text: String| Report::error(code::NO_POSITION, text);
    let index = words::word(&format!("position.{name}"));
    let query = Transport::text(format!("-query {index}"));
    let mut said = Transport::default();
    let found = cx.call("dict", Method::Ctrl, query, &mut said);
    let found = found.map_err(|_| {
        let why = said.reports.first().map_or("", |report| report.text.as_str());
        wrong(format!(
            "there is no position `{name}`: {why}; a position is an entry `position.{name} q1 .. qn` of the dictionary, rad or m"
        ))
    })?;
    let numbers: Option<Vec<f64>> = found
        .text
        .split_whitespace()
        .map(|word| word.parse().ok().filter(|number: &f64| number.is_finite()))
        .collect();
    let positions = numbers.filter(|numbers| numbers.len() == count);
    let positions = positions.and_then(|numbers| Joints::try_from(numbers.as_slice()).ok());
    positions.ok_or_else(|| {
        wrong(format!(
            "the dictionary's entry `position.{name}` must be {count} joint positions, rad or m, not `{}`",
            found.text
        ))
    })
}

/// Joint positions and a pose.
pub(super) fn answer(io: &mut Transport, joints: &Joints, pose: &Isometry3<f64>) {
    io.floats.clear();
    io.floats.extend_from_slice(joints);
    io.floats.extend(rows(pose));
}

impl ServiceObject for MvPos {
    fn exec_waiting<'a>(
        &'a mut self,
        cx: &'a Waiting<'a>,
        io: &'a mut Transport,
    ) -> Option<LocalBoxFuture<'a, Outcome>> {
        Some(Box::pin(async move {
            let answer = self.job(cx, io).await;
            let text = answer
                .as_ref()
                .map_or_else(|_| String::new(), String::clone);
            let outcome = known(cx, &self.options.client, answer.map(drop)).await;
            let outcome = ended(io, outcome);
            io.text = text;
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
