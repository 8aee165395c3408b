//! The stand-ins: an arm, a gripper and cameras that know where the thing is.

mod app;
mod pushing;
mod seeing;

use std::{sync::LazyLock, time::Duration};

use ctos::{
    diagnostic::Source,
    message::{Command, CommandInfo, Message},
    task::{Context, Handled},
};
use mcs::{
    Joints,
    client::{
        ControlReport, GuardsReport, MotionError, Move, Outcome as Motion, PathKind, Plan,
        ReadGuards, ReadSensors, SensorReport, SetLaw, SetOutput, Target,
    },
    guard::GuardReport,
};
use mcs_hand::command::{Grasp, Held, Open, ReadHeld};
use mcs_path::{
    PathError, Way,
    task::{PlanWay, Planned, Unplanned},
};
use nalgebra::{Isometry3, Point3, Vector3};
use pnt::task::{PutOnce, RequestId, put_once};
use vss::{
    command::{DiskOffset, Outcome as Vss, Snap, VisionError},
    frame::Frame,
};

use crate::{
    bench::{self, Bench, Fault, Shared, StandIn, lock, pose},
    carry::{board::Board, errand::Errand, eyes::LookOver, thing::Thing},
};

pub(crate) use self::app::{
    CARRY, POSES, PUSHES, STAND_INS, motions, requests, run, run_all_with, run_seeded, run_with,
    tasks,
};

pub(crate) const BOARD: Board = Board {
    at: [0.5, 0.0, 0.42],
    yaw_deg: 20.0,
    field_m: 0.06,
    fields: 8,
    thick_m: 0.02,
    dot: Some([-0.255, -0.21]),
};

/// Its file is read once: stand-ins ask for it at each request.
pub(crate) fn disc() -> Thing {
    static DISC: LazyLock<Thing> = LazyLock::new(|| {
        let disc = include_str!("../../../../configs/carry/disc.toml");
        Thing::parse(&Source::new("disc.toml", disc)).unwrap()
    });
    DISC.clone()
}

/// How often the pointer blinks.
pub(crate) const BLINKS: usize = 3;

/// The middle of the bottom of a disc on a field.
pub(crate) fn on(field: &str) -> Point3<f64> {
    BOARD.point(&field.parse().unwrap(), disc().height_m)
}

/// From field 3,4 to 4,5 of a board that is turned.
pub(in crate::carry) fn errand() -> Errand {
    let thing = disc();
    let [from, to] = ["3,4", "4,5"].map(|text| text.parse().unwrap());
    Errand {
        command: 1,
        from,
        to,
        board: BOARD,
        points: [from, to].map(|field| BOARD.point(&field, thing.height_m)),
        yaw: BOARD.yaw(),
        clearance_m: 0.1,
        open_m: thing.grasp.open_m,
        speed: None,
        thing,
    }
}

/// Where the thing is.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Place {
    /// The middle of its bottom.
    At(Point3<f64>),
    InHand,
}

/// How well the cameras of the room see.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Room {
    Well,
    /// By one camera alone.
    InDoubt,
    Not,
}

/// What the stand-ins share.
pub(crate) struct World {
    pub bench: Bench,
    tool: Isometry3<f64>,
    planned: Vec<Isometry3<f64>>,
    pub thing: Place,
    /// Other discs.
    pub others: Vec<Point3<f64>>,
    /// A person takes them away after so many looks.
    pub is_cleared_after: usize,
    /// Where the board truly is, and how it is known: an argument of the Vision Coordinator.
    pub board: Board,
    pub believes: &'static str,
    /// Looks at the table from this one on show nothing.
    pub dark_from: usize,
    pub looks: usize,
    pub room: Room,
    /// Poses of the hand from which its camera sees nothing.
    pub blind_poses: Vec<usize>,
    joints: Joints,
    /// Another thing is stuck to the one to be carried, on the side away from where that is to go, before each errand.
    pub sticks: bool,
    /// Pushes to the left (1) or to the right (-1) of it are ended before they move anything.
    pub vain_side: f64,
    /// Pushes that moved something.
    pub pushed: usize,
    /// Something that is no disc stands on TO.
    pub clutter: bool,
    /// Turns of the gripper that the arm does not reach, rad.
    pub unreachable: Vec<f64>,
    /// The arm reaches nothing at all.
    pub nothing_in_reach: bool,
    /// Turns with which something is in the way down to a thing, rad.
    pub blocked_turns: Vec<f64>,
    /// Kinds of path that a guard ends half way.
    pub blocked: Vec<&'static str>,
    /// Ways down with the thing are ended so high above their ends by the collision watch, m.
    pub held_off: Option<f64>,
    /// The guard that ended a motion last.
    last: Option<&'static str>,
    pub is_open: bool,
    /// Let go where nothing was beneath.
    pub dropped: bool,
    /// How long a motion takes.
    pub motion: Duration,
    /// What the pointer was set to, and where the tool was then. Without power it is off.
    pub light: Vec<(f64, Isometry3<f64>)>,
    /// How far beside their places the cameras of the room see things from the second errand on, m.
    pub squint: Vector3<f64>,
    /// Examples that the camera on the hand was shown.
    pub taught: usize,
    /// The planner finds no way.
    pub is_walled_in: bool,
    /// How far the gripper was asked to open, m.
    pub opened: Vec<f64>,
    /// What a person says some seconds after each look, while that is not answered.
    pub says: Option<&'static str>,
    /// What was answered to that.
    pub replies: Vec<String>,
    /// Another thing hangs on the one that is lifted.
    pub is_stuck: bool,
    /// Where the thing was at each answer.
    pub at_answers: Vec<Place>,
}

impl Default for World {
    fn default() -> Self {
        Self::new(&[])
    }
}

impl World {
    pub fn new(faults: &[(usize, Fault)]) -> Self {
        Self {
            bench: Bench::new(faults),
            tool: Isometry3::translation(0.3, 0.0, 0.8),
            planned: Vec::new(),
            thing: Place::At(on("3,4")),
            others: Vec::new(),
            is_cleared_after: usize::MAX,
            board: BOARD,
            believes: "seen",
            dark_from: usize::MAX,
            looks: 0,
            room: Room::Well,
            blind_poses: Vec::new(),
            joints: Joints::zeros(6),
            sticks: false,
            vain_side: 0.0,
            pushed: 0,
            clutter: false,
            unreachable: Vec::new(),
            nothing_in_reach: false,
            blocked_turns: Vec::new(),
            blocked: Vec::new(),
            held_off: None,
            last: None,
            is_open: false,
            dropped: false,
            motion: Duration::ZERO,
            light: Vec::new(),
            squint: Vector3::zeros(),
            taught: 0,
            is_walled_in: false,
            opened: Vec::new(),
            says: None,
            replies: Vec::new(),
            is_stuck: false,
            at_answers: Vec::new(),
        }
    }

    /// Where the thing stands.
    ///
    /// # Panics
    /// When it is in the hand.
    pub fn stands_at(&self) -> Point3<f64> {
        match self.thing {
            Place::At(at) => at,
            Place::InHand => panic!("it is in the hand"),
        }
    }

    /// Whether the Dispatcher is at rest.
    pub fn rests(&self) -> bool {
        self.bench.tokens("hand_empty") + self.hand_full() == 1
    }

    /// Whether the Dispatcher knows that something is in the hand.
    pub fn hand_full(&self) -> u32 {
        self.bench.tokens("hand_full")
    }

    /// Whether anything was asked but the cameras.
    pub fn moved(&self) -> bool {
        let mut asked = self.bench.asked.iter();
        asked.any(|request| request != LookOver::NAME)
    }

    /// Whether the pointer is out.
    pub fn is_dark(&self) -> bool {
        self.light.last().is_none_or(|(lit, _)| *lit == 0.0)
    }

    /// How often the pointer blinked with its light on a place.
    pub fn blinks_at(&self, at: &Point3<f64>) -> usize {
        let lit = self.light.iter().filter(|(lit, _)| *lit == 1.0);
        let hits = lit.filter(|(_, tool)| {
            let leaves = tool * Point3::new(0.05, 0.0, -0.065);
            let along = tool * Vector3::z();
            let met = leaves + along * ((at.z - leaves.z) / along.z);
            along.z < 0.0 && (met - at).norm() < 1e-6
        });
        hits.count()
    }

    /// Whether it blinked there as often as it should.
    pub fn has_shown(&self, at: &Point3<f64>) -> bool {
        self.blinks_at(at) >= BLINKS
    }

    /// Where a motion leads.
    fn target(&self, order: &Move) -> Isometry3<f64> {
        match order.target {
            Target::Pose(rows) => pose(&rows),
            Target::Joints(joints) => match self.planned.get(joints[0] as usize) {
                Some(planned) if joints[1] < -1.0 => *planned,
                _ => Isometry3::translation(0.3, 0.0, 0.8),
            },
        }
    }

    /// How the gripper is turned about the vertical of the board, rad.
    fn turn(&self, tool: &Isometry3<f64>) -> f64 {
        let across = tool * Vector3::x();
        across.y.atan2(across.x) - self.board.yaw()
    }

    /// The middle of the bottom of what the pads would be around.
    fn bottom(&self) -> Point3<f64> {
        self.bottom_at(&self.tool)
    }

    fn bottom_at(&self, tool: &Isometry3<f64>) -> Point3<f64> {
        let at = Point3::from(tool.translation.vector);
        at - Vector3::z() * disc().grasp.above_m
    }

    fn closes(&mut self) {
        self.is_open = false;
        if let Place::At(at) = self.thing
            && (at - self.bottom()).norm() < 2e-3
        {
            self.thing = Place::InHand;
        }
    }

    /// Whether there is a field right beneath what the pads would be around.
    fn stands(&self) -> bool {
        let bottom = self.bottom();
        let height_m = disc().height_m;
        let fields =
            ["3,4", "4,5"].map(|field| self.board.point(&field.parse().unwrap(), height_m));
        fields.iter().any(|field| (bottom - field).norm() < 6e-3)
    }

    fn opens(&mut self) {
        self.is_open = true;
        if self.thing == Place::InHand {
            self.dropped |= !self.stands();
            self.thing = Place::At(self.bottom());
        }
    }

    /// What the sensor in the wrist reads: force, N, and torque.
    fn weight(&self) -> SensorReport {
        let things = match self.thing {
            Place::InHand => 1.0 + f64::from(u8::from(self.is_stuck)),
            Place::At(_) => 0.0,
        };
        let weight = things * 9.80665 * disc().mass_kg.unwrap_or_default();
        SensorReport {
            sensors: Vec::new(),
            numbers: vec![0.0, 0.0, weight, 0.0, 0.0, 0.0],
            stale: Vec::new(),
        }
    }

    fn held(&self) -> Held {
        let holds = self.thing == Place::InHand;
        Held {
            holds,
            width_m: if holds { disc().width_m } else { 0.0 },
            force_n: 15.0,
        }
    }
}

impl bench::World for World {
    const MORE: &'static [CommandInfo] = &[
        Grasp::INFO,
        Open::INFO,
        ReadHeld::INFO,
        LookOver::INFO,
        SetOutput::INFO,
        PlanWay::INFO,
        DiskOffset::INFO,
        ReadGuards::INFO,
        ReadSensors::INFO,
        Snap::INFO,
        SetLaw::INFO,
    ];

    fn bench(&mut self) -> &mut Bench {
        &mut self.bench
    }

    fn strikes(&mut self, _request: &str, fault: Option<Fault>) {
        // What stands slips no more.
        if fault == Some(Fault::Slips) && self.thing == Place::InHand && !self.stands() {
            let below = self.bottom();
            self.thing = Place::At(Point3::new(below.x + 0.03, below.y, 0.42));
        }
    }

    fn takes(&self, request: &str) -> Duration {
        match request {
            Move::NAME => self.motion,
            Grasp::NAME | Open::NAME => self.motion / 4,
            _ => Duration::ZERO,
        }
    }

    fn plans(&mut self, plan: &Plan) -> Result<Joints, MotionError> {
        let rows = match plan.target {
            Target::Joints(joints) => return Ok(joints),
            Target::Pose(rows) => rows,
        };
        let to = pose(&rows);
        let turn = self.turn(&to);
        let is_near = |turned: &f64| (turn - turned).sin().abs() < 1e-6;
        if self.nothing_in_reach || self.unreachable.iter().any(is_near) {
            return Err(MotionError::new(Motion::Unreachable, "out of reach"));
        }
        self.planned.push(to);
        let number = self.planned.len() as f64 - 1.0;
        Ok([number, -99.0, 0.0, 0.0, 0.0, 0.0].into())
    }

    fn goes(&mut self, order: &Move) -> Result<(), MotionError> {
        let mut to = self.target(order);
        let mut met = Ok(());
        if let Target::Joints(joints) = order.target {
            self.joints = joints;
        }
        let kind = match order.path {
            PathKind::Arch { .. } => "arch",
            PathKind::StraightLine => "line",
            PathKind::Named { .. } => "planned",
            _ => "joint",
        };
        // The ways down have guards of their own.
        if order.guards.is_empty() && self.blocked.contains(&kind) {
            self.tool = self.tool.lerp_slerp(&to, 0.5);
            self.last = Some("collision");
            return Err(MotionError::new(Motion::Guard, "post is near"));
        }
        if order.guards == ["blocked"] {
            self.pushes(&to)?;
            self.tool = to;
            return Ok(());
        }
        let turn = self.turn(&to);
        let is_near = |turned: &f64| (turn - turned).sin().abs() < 1e-6;
        let empty = self.thing != Place::InHand;
        if !order.guards.is_empty()
            && !empty
            && let Some(above) = self.held_off
            && self.bottom_at(&to).z < 0.42 + 1e-3
        {
            to.translation.z += above;
            self.tool = to;
            self.last = Some("collision");
            return Err(MotionError::new(Motion::Guard, "table is near"));
        }
        if !order.guards.is_empty() && empty && self.blocked_turns.iter().any(is_near) {
            self.last = Some("touch");
            return Err(MotionError::new(Motion::Guard, "force 9 N"));
        }
        if !order.guards.is_empty() {
            let held = self.thing == Place::InHand;
            for other in &self.others {
                let over = (other.xy() - Point3::from(to.translation.vector).xy()).norm() < 0.02;
                let top = other.z + disc().height_m + disc().grasp.above_m;
                if held && over && to.translation.z < top {
                    to.translation.z = top;
                    self.last = Some("touch");
                    met = Err(MotionError::new(Motion::Guard, "force 9 N"));
                }
            }
        }
        self.tool = to;
        met
    }

    fn is_broken_off(&mut self, order: &Move) {
        let to = self.target(order);
        self.tool = self.tool.lerp_slerp(&to, 0.5);
    }

    fn tool(&self) -> Isometry3<f64> {
        self.tool
    }

    fn is_released(&mut self) {
        self.light.push((0.0, self.tool));
    }

    fn is_answered(&mut self) {
        self.at_answers.push(self.thing);
        if self.sticks {
            self.stick();
        }
    }

    /// The gripper and the cameras.
    fn more(stand_in: &StandIn<Self>, cx: &Context, message: Message) -> Handled {
        match message.command() {
            Grasp::CODE => stand_in.typed::<Grasp, _>(cx, message, |world, _| {
                world.closes();
                Ok(world.held())
            }),
            Open::CODE => stand_in.typed::<Open, _>(cx, message, |world, order| {
                world.opened.extend(order.width_m);
                world.opens();
                Ok(world.held())
            }),
            ReadHeld::CODE => {
                stand_in.typed::<ReadHeld, _>(cx, message, |world, _| Ok(world.held()))
            }
            // Asked so often that no fault is drawn for it.
            ReadSensors::CODE => {
                let (ReadSensors {}, reply) = message.open::<ReadSensors>()?;
                reply.ok(lock(&stand_in.0).weight())
            }
            ReadGuards::CODE => stand_in.plain::<ReadGuards>(message, |world, _| GuardsReport {
                recipes: Vec::new(),
                last: world.last.map(|guard| GuardReport {
                    guard: guard.into(),
                    ..GuardReport::default()
                }),
            }),
            SetOutput::CODE => {
                stand_in.typed::<SetOutput, _>(cx, message, |world, SetOutput { name, value }| {
                    let refused = |text| Err(MotionError::new(Motion::Refused, text));
                    if name != "pointer" {
                        return refused("there is no such output");
                    }
                    if !world.bench.reserved {
                        return refused("the arm is not reserved");
                    }
                    world.light.push((value, world.tool));
                    Ok(())
                })
            }
            DiskOffset::CODE => {
                let (request, reply) = message.open::<DiskOffset>()?;
                match stand_in.meets("disk_offset").0 {
                    Some(_) => reply.ok(Err(VisionError::new(Vss::Unseen, "on purpose"))),
                    None => reply.ok(lock(&stand_in.0).offset(&request)),
                }
            }
            PlanWay::CODE => {
                let (PlanWay { from, goals, .. }, reply) = message.open::<PlanWay>()?;
                if lock(&stand_in.0).is_walled_in {
                    return reply.ok(Err(Unplanned::Path(PathError::NoGoal)));
                }
                reply.ok(Ok(Planned {
                    way: Way {
                        points: vec![from, goals[0]],
                        leeway: vec![0.0; 2],
                        length_m: 1.0,
                        full_speed_s: 1.0,
                        nearest: None,
                    },
                    iterations: 1,
                }))
            }
            SetLaw::CODE => stand_in.plain::<SetLaw>(message, |_, SetLaw { law }| ControlReport {
                law,
                bandwidth_hz: 8.0,
                damping: 1.0,
                following_error_rad: 0.1,
            }),
            Snap::CODE => {
                let (Snap { .. }, reply) = message.open::<Snap>()?;
                match stand_in.meets("snap").0 {
                    Some(Fault::Meets(Motion::Lost)) => reply.fail("it is broken"),
                    Some(_) => reply.ok(Err(VisionError::new(Vss::Fault, "no picture on purpose"))),
                    None => reply.ok(Ok(Frame::grey8(2, 2, vec![0; 4]))),
                }
            }
            LookOver::CODE => {
                let (LookOver { pictures, .. }, reply) = message.open::<LookOver>()?;
                if let Some(words) = lock(&stand_in.0).says {
                    answer(cx, words, stand_in.0.clone());
                }
                let error = |outcome| Err(VisionError::new(outcome, "no picture on purpose"));
                match stand_in.meets("look_over").0 {
                    Some(Fault::Meets(Motion::Lost)) => reply.fail("it is broken"),
                    Some(Fault::Meets(Motion::Unreachable)) => reply.ok(error(Vss::Unseen)),
                    Some(Fault::Meets(Motion::Refused)) => reply.ok(error(Vss::Refused)),
                    Some(Fault::Meets(_)) => reply.ok(error(Vss::Fault)),
                    Some(Fault::AnswerLost) => reply.ok(error(Vss::Lost)),
                    Some(Fault::Slips) | None if pictures.is_empty() => {
                        reply.ok(lock(&stand_in.0).overview())
                    }
                    Some(Fault::Slips) | None => {
                        reply.ok(lock(&stand_in.0).overview_by_hand(pictures.len()))
                    }
                }
            }
            _ => cx.default_processing(message),
        }
    }
}

/// A person answers some seconds later.
fn answer(cx: &Context, words: &'static str, world: Shared<World>) {
    let child = cx.clone();
    cx.spawn(async move {
        child.sleep(Duration::from_secs(20)).await;
        // The same answer is heard once, also by a process that comes back.
        let put = PutOnce {
            request: RequestId {
                from: "person".to_owned(),
                number: child.now().as_nanos(),
            },
            symbol: "answer".to_owned(),
            arguments: words.split_whitespace().map(ToOwned::to_owned).collect(),
        };
        let within = Duration::from_secs(60);
        let reply = put_once(&child, "people", &put, within).await.unwrap();
        lock(&world).replies.push(reply.symbol);
    });
}
