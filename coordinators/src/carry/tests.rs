//! The nets of `carry` in virtual time, between stand-ins for the arm and the gripper, which know where the thing is and fail on
//! demand: at every request, one after the other, in every way.

use std::{
    path::Path,
    sync::{Arc, Mutex, MutexGuard, PoisonError},
    time::Duration,
};

use ctos::{
    boot::{self, End, Launcher},
    config,
    diagnostic::Source,
    message::{Command, Message},
    registry::Registry,
    system::AppResult,
    task::{Context, EventHandler, Handled, Phase},
};
use mcs::{
    Joints,
    client::{
        Acquire, Cancel, MotionError, Move, MoveReport, Outcome as Motion, Plan, PlanReport,
        Position, ReadPosition, Release, Status, StatusReport, Target,
    },
    servo::MotionPhase,
    state::State,
};
use mcs_hand::command::{Grasp, Held, Open, ReadHeld};
use nalgebra::{Isometry3, Matrix4, Point3, Vector3};
use pnt::task::{Marking, PutTape};

use vss::command::{Outcome as Vss, VisionError};
use vss_board::discs::SeenDisc;
use vss_board::pose::BoardPose;

use super::{
    board::{Board, Field},
    errand::Errand,
    eyes::LookOver,
    sight::Overview,
    thing::Thing,
};

const BOARD: Board = Board {
    at: [0.5, 0.0, 0.42],
    yaw_deg: 20.0,
    field_m: 0.06,
    fields: 8,
    thick_m: 0.02,
    dot: Some([-0.255, -0.21]),
};

fn disc() -> Thing {
    let disc = include_str!("../../../configs/carry/disc.toml");
    Thing::parse(&Source::new("disc.toml", disc)).unwrap()
}

/// The middle of the bottom of a disc on a field.
fn on(field: &str) -> Point3<f64> {
    BOARD.point(&field.parse().unwrap(), disc().height_m)
}

/// From field 3,4 to 4,5 of a board that is turned.
pub(super) fn errand() -> Errand {
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
        speed: None,
        thing,
    }
}

/// What goes wrong at one request.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Fault {
    /// It is not done, for this reason.
    Meets(Motion),
    /// It is done, and the answer is lost.
    AnswerLost,
    /// The thing falls out of the hand before it is done.
    Slips,
}

/// Where the thing is.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Place {
    /// The middle of its bottom.
    At(Point3<f64>),
    InHand,
}

/// What the stand-ins share.
struct World {
    tool: Isometry3<f64>,
    planned: Vec<Isometry3<f64>>,
    thing: Place,
    /// Other discs.
    others: Vec<Point3<f64>>,
    /// Where the board truly is, and how it is known: an argument of the Vision Coordinator.
    board: Board,
    believes: &'static str,
    /// Looks at the table from this one on show nothing.
    dark_from: usize,
    looks: usize,
    /// Something that is no disc stands on TO.
    clutter: bool,
    /// Turns of the gripper that the arm does not reach, rad.
    unreachable: Vec<f64>,
    is_open: bool,
    reserved: bool,
    estopped: bool,
    /// Looks at a protective stop until somebody ends it.
    stopped: u32,
    /// Let go where nothing was beneath.
    dropped: bool,
    /// Requests so far, and at which of them what goes wrong.
    asked: Vec<String>,
    faults: Vec<(usize, Fault)>,
    answers: Vec<(String, String)>,
    hand_full: u32,
    rest: bool,
}

impl World {
    fn new(faults: &[(usize, Fault)]) -> Self {
        Self {
            tool: Isometry3::translation(0.3, 0.0, 0.8),
            planned: Vec::new(),
            thing: Place::At(on("3,4")),
            others: Vec::new(),
            board: BOARD,
            believes: "seen",
            dark_from: usize::MAX,
            looks: 0,
            clutter: false,
            unreachable: Vec::new(),
            is_open: false,
            reserved: false,
            estopped: false,
            stopped: 0,
            dropped: false,
            asked: Vec::new(),
            faults: faults.to_vec(),
            answers: Vec::new(),
            hand_full: 0,
            rest: false,
        }
    }

    /// The middle of the bottom of what the pads would be around.
    fn bottom(&self) -> Point3<f64> {
        let at = Point3::from(self.tool.translation.vector);
        at - Vector3::z() * disc().grasp.above_m
    }

    /// Notes a request; what goes wrong with it.
    fn meets(&mut self, request: &str) -> Option<Fault> {
        let number = self.asked.len();
        self.asked.push(request.to_owned());
        let fault = self.faults.iter().find(|(at, _)| *at == number)?.1;
        match fault {
            Fault::Meets(Motion::Estopped) => self.estopped = true,
            Fault::Meets(Motion::Stopped) => self.stopped = 3,
            // What stands slips no more.
            Fault::Slips if self.thing == Place::InHand && !self.stands() => {
                let below = self.bottom();
                self.thing = Place::At(Point3::new(below.x + 0.03, below.y, 0.42));
            }
            _ => {}
        }
        Some(fault)
    }

    /// What the cameras see.
    fn overview(&mut self) -> Result<Overview, VisionError> {
        self.looks += 1;
        if self.looks > self.dark_from {
            return Err(VisionError::new(Vss::Unseen, "no camera sees the board"));
        }
        let pose = self.board.pose();
        let disc = |at: &Point3<f64>, colour: usize| SeenDisc {
            at: pose.inverse() * at,
            colour,
            rms_px: 0.1,
            sd_m: 1e-4,
            cameras: 2,
        };
        let mut discs: Vec<SeenDisc> = self.others.iter().map(|at| disc(at, 1)).collect();
        if let Place::At(at) = &self.thing {
            discs.push(disc(at, 0));
        }
        Ok(Overview {
            board: BoardPose {
                base_t_board: pose,
                sd: [1e-4; 6],
                rms_px: 0.1,
                corners: 98,
                cameras: vec!["left".to_owned(), "right".to_owned()],
            },
            discs,
            bare: vec![Some(if self.clutter { 0.1 } else { 1.0 })],
            doubts: Vec::new(),
        })
    }

    fn goes(&mut self, order: &Move) -> Result<(), MotionError> {
        if self.estopped {
            return Err(MotionError::new(
                Motion::Estopped,
                "an emergency stop holds",
            ));
        }
        if self.stopped > 0 {
            return Err(MotionError::new(Motion::Stopped, "a protective stop holds"));
        }
        if !self.reserved {
            return Err(MotionError::new(Motion::Refused, "the arm is not reserved"));
        }
        let mut to = match order.target {
            Target::Pose(rows) => pose(&rows),
            Target::Joints(joints) => match self.planned.get(joints[0] as usize) {
                Some(planned) if joints[1] < -1.0 => *planned,
                _ => Isometry3::translation(0.3, 0.0, 0.8),
            },
        };
        let mut met = Ok(());
        if !order.guards.is_empty() {
            let held = self.thing == Place::InHand;
            for other in &self.others {
                let over = (other.xy() - Point3::from(to.translation.vector).xy()).norm() < 0.02;
                let top = other.z + disc().height_m + disc().grasp.above_m;
                if held && over && to.translation.z < top {
                    to.translation.z = top;
                    met = Err(MotionError::new(Motion::Guard, "force 9 N"));
                }
            }
        }
        self.tool = to;
        met
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

    fn held(&self) -> Held {
        let holds = self.thing == Place::InHand;
        Held {
            holds,
            width_m: if holds { disc().width_m } else { 0.0 },
            force_n: 15.0,
        }
    }
}

fn pose(rows: &[f64; 16]) -> Isometry3<f64> {
    nalgebra::try_convert(Matrix4::from_row_slice(rows)).unwrap()
}

type Shared = Arc<Mutex<World>>;

fn lock(world: &Shared) -> MutexGuard<'_, World> {
    world.lock().unwrap_or_else(PoisonError::into_inner)
}

/// The arm and the gripper.
struct StandIn(Shared);

impl StandIn {
    /// Answers a request whose answer may be an error, unless something goes wrong with it.
    fn typed<C, T>(
        &self,
        message: Message,
        act: impl FnOnce(&mut World, C) -> Result<T, MotionError>,
    ) -> Handled
    where
        C: Command<Reply = Result<T, MotionError>>,
    {
        let (request, reply) = message.open::<C>()?;
        let mut world = lock(&self.0);
        match world.meets(C::NAME) {
            Some(Fault::Meets(Motion::Lost)) => reply.fail("it is broken"),
            Some(Fault::Meets(outcome)) => reply.ok(Err(MotionError::new(
                outcome,
                format!("{outcome:?} on purpose"),
            ))),
            fault => {
                let answer = act(&mut world, request);
                drop(world);
                match fault {
                    Some(Fault::AnswerLost) => reply.ok(Err(MotionError::new(
                        Motion::Lost,
                        "the answer is lost on purpose",
                    ))),
                    _ => reply.ok(answer),
                }
            }
        }
    }
}

impl EventHandler for StandIn {
    async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
        match message.command() {
            Acquire::CODE => self.typed::<Acquire, _>(message, |world, _| {
                if world.estopped {
                    return Err(MotionError::new(
                        Motion::Estopped,
                        "an emergency stop holds",
                    ));
                }
                world.reserved = true;
                Ok(State::Motion)
            }),
            Release::CODE => self.typed::<Release, _>(message, |world, _| {
                world.reserved = false;
                Ok(State::Cold)
            }),
            Plan::CODE => self.typed::<Plan, _>(message, |world, plan| {
                let joints = match plan.target {
                    Target::Joints(joints) => joints,
                    Target::Pose(rows) => {
                        let to = pose(&rows);
                        let across = to * Vector3::x();
                        let turn = across.y.atan2(across.x) - BOARD.yaw();
                        let is_near = |turned: &f64| (turn - turned).sin().abs() < 1e-6;
                        if world.unreachable.iter().any(is_near) {
                            let text = "out of reach";
                            return Err(MotionError::new(Motion::Unreachable, text));
                        }
                        world.planned.push(to);
                        let number = world.planned.len() as f64 - 1.0;
                        [number, -99.0, 0.0, 0.0, 0.0, 0.0].into()
                    }
                };
                Ok(PlanReport {
                    joints,
                    duration_s: 1.0,
                    smallest_singular_value: None,
                })
            }),
            Move::CODE => self.typed::<Move, _>(message, |world, order| {
                world.goes(&order)?;
                Ok(MoveReport {
                    duration_s: 1.0,
                    max_tracking_error_rad: 0.0,
                    max_tracking_error_m: 0.0,
                    final_error_rad: 0.0,
                    final_error_m: 0.0,
                    joints: Joints::zeros(6),
                    smallest_singular_value: None,
                })
            }),
            Grasp::CODE => self.typed::<Grasp, _>(message, |world, _| {
                world.closes();
                Ok(world.held())
            }),
            Open::CODE => self.typed::<Open, _>(message, |world, _| {
                world.opens();
                Ok(world.held())
            }),
            ReadHeld::CODE => self.typed::<ReadHeld, _>(message, |world, _| Ok(world.held())),
            LookOver::CODE => {
                let (LookOver { .. }, reply) = message.open::<LookOver>()?;
                let mut world = lock(&self.0);
                let error = |outcome| Err(VisionError::new(outcome, "no picture on purpose"));
                match world.meets("look_over") {
                    Some(Fault::Meets(Motion::Lost)) => reply.fail("it is broken"),
                    Some(Fault::Meets(Motion::Unreachable)) => reply.ok(error(Vss::Unseen)),
                    Some(Fault::Meets(Motion::Refused)) => reply.ok(error(Vss::Refused)),
                    Some(Fault::Meets(_)) => reply.ok(error(Vss::Fault)),
                    Some(Fault::AnswerLost) => reply.ok(error(Vss::Lost)),
                    Some(Fault::Slips) | None => reply.ok(world.overview()),
                }
            }
            ReadPosition::CODE => {
                let (ReadPosition {}, reply) = message.open::<ReadPosition>()?;
                let mut world = lock(&self.0);
                if matches!(world.meets("read_position"), Some(Fault::Meets(_))) {
                    return reply.fail("it is broken");
                }
                let matrix = world.tool.to_homogeneous().transpose();
                let mut base_t_tool = [0.0; 16];
                base_t_tool.copy_from_slice(matrix.as_slice());
                reply.ok(Position {
                    joints: Joints::zeros(6),
                    base_t_tool,
                    at_rest: true,
                })
            }
            Status::CODE => {
                let (Status {}, reply) = message.open::<Status>()?;
                let mut world = lock(&self.0);
                world.stopped = world.stopped.saturating_sub(1);
                reply.ok(StatusReport {
                    state: State::Motion,
                    holder: world.reserved.then(|| "robot".to_owned()),
                    fault: None,
                    stopped: world.stopped > 0,
                    motion: MotionPhase::None,
                    ticks: 0,
                    missed: 0,
                })
            }
            Cancel::CODE => message.open::<Cancel>()?.1.ok(()),
            _ => cx.default_processing(message),
        }
    }
}

/// Puts commands on the Dispatcher's tape, one after the other, and looks at the net at the end.
struct Operator(Shared, Vec<(String, Vec<String>)>);

impl EventHandler for Operator {
    async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
        cx.default_processing(message)
    }

    async fn phase(&mut self, cx: &Context, phase: Phase) -> Handled {
        if phase == Phase::Run {
            let (child, world, commands) = (cx.clone(), self.0.clone(), self.1.clone());
            cx.spawn(async move {
                let operated = operate(&child, &world, commands).await;
                child.finish(AppResult {
                    ok: operated.is_ok(),
                    text: operated
                        .err()
                        .map_or_else(String::new, |error| error.to_string()),
                    json: String::new(),
                });
            });
        }
        Ok(())
    }
}

async fn operate(cx: &Context, world: &Shared, commands: Vec<(String, Vec<String>)>) -> Handled {
    let dispatcher = cx.task("dispatcher").await?;
    for (symbol, arguments) in commands {
        let put = PutTape { symbol, arguments };
        let answer = cx.call(&dispatcher, put);
        let answer = answer.deadline(Duration::from_secs(100_000)).await?;
        lock(world).answers.push((answer.symbol, answer.text));
    }
    // The last tokens may still be on their way.
    cx.sleep(Duration::from_secs(1)).await;
    let marking = cx.call(&dispatcher, Marking {}).await?;
    let tokens = |name: &str| {
        let mut places = marking.places.iter();
        places
            .find(|(place, _)| place == name)
            .map_or(0, |(_, tokens)| *tokens)
    };
    let (empty, full) = (tokens("hand_empty"), tokens("hand_full"));
    let mut world = lock(world);
    world.hand_full = full;
    world.rest = empty + full == 1;
    Ok(())
}

fn app(believes: &str) -> String {
    let nets = Path::new(env!("CARGO_MANIFEST_DIR")).join("../configs/nets/carry");
    let configs = Path::new(env!("CARGO_MANIFEST_DIR")).join("../configs");
    format!(
        r#"[app]
name = "test"
until = "operator"
[time]
mode = "virtual"
[chassis.ws1]
[chassis.cage]
[task.operator]
handler = "test.operator"
on = "ws1"
[task.dom]
handler = "coordinators.dom"
on = "ws1"
[task.dispatcher]
handler = "coordinators.carry"
on = "ws1"
[task.dispatcher.args]
net = "{nets}/dispatcher.net"
thing = "{configs}/carry/disc.toml"
board = {{ at = [0.5, 0.0, 0.42], yaw_deg = 20.0, field_m = 0.06, dot = [-0.255, -0.21] }}
[task.robot]
handler = "coordinators.carry_robot"
on = "ws1"
[task.robot.args]
net = "{nets}/robot.net"
touch = ["touch"]
park_deg = [0, 75, -180, 0, -75, 0]
service_within_s = 2.0
[task.hand]
handler = "coordinators.carry_hand"
on = "ws1"
[task.hand.args]
net = "{nets}/hand.net"
service_within_s = 2.0
[task.vision]
handler = "coordinators.carry_vision"
on = "ws1"
[task.vision.args]
net = "{nets}/vision.net"
board = "{believes}"
service_within_s = 2.0
[task.eyes]
handler = "test.arm"
on = "cage"
[task.mcs]
handler = "test.arm"
on = "cage"
[task.gripper]
handler = "test.arm"
on = "cage"
"#,
        nets = nets.display(),
        configs = configs.display()
    )
}

fn run(world: World, commands: &[&str]) -> World {
    let believes = world.believes;
    let world = Arc::new(Mutex::new(world));
    let mut registry = Registry::new();
    crate::register(&mut registry);
    let shared = world.clone();
    let takes = [
        Acquire::INFO,
        Release::INFO,
        Plan::INFO,
        Move::INFO,
        ReadPosition::INFO,
        Status::INFO,
        Cancel::INFO,
        Grasp::INFO,
        Open::INFO,
        ReadHeld::INFO,
        LookOver::INFO,
    ];
    registry.handler("test.arm", &takes, move |_| Ok(StandIn(shared.clone())));
    let commands: Vec<(String, Vec<String>)> = commands
        .iter()
        .map(|line| {
            let mut words = line.split_whitespace().map(ToOwned::to_owned);
            (words.next().unwrap(), words.collect())
        })
        .collect();
    let shared = world.clone();
    registry.handler("test.operator", &[], move |_| {
        Ok(Operator(shared.clone(), commands.clone()))
    });
    let app = config::load_texts(&[("app.toml", &app(believes))], &[], &[]);
    let app = app.unwrap_or_else(|found| panic!("{found}"));
    let launcher = Launcher {
        program: "none".into(),
        arguments: Vec::new(),
    };
    let observer: boot::Observer = Arc::new(|_| {});
    let end = boot::boot(app, registry, &launcher, &observer).unwrap().end;
    assert!(
        matches!(&end, End::Finished(result) if result.ok),
        "{end:?}"
    );
    let mut left = lock(&world);
    std::mem::replace(&mut *left, World::new(&[]))
}

const CARRY: &str = "carry 3,4,0 4,5,0";

#[test]
fn a_thing_is_carried_from_field_to_field_and_the_arm_is_given_back() {
    let world = run(World::new(&[]), &[CARRY]);
    assert_eq!(world.answers[0].0, "carried", "{:?}", world.answers);
    let Place::At(at) = world.thing else {
        panic!("it is in the hand")
    };
    assert!((at - on("4,5")).norm() < 1e-9);
    assert!(!world.reserved && world.is_open && world.rest && world.hand_full == 0);
}

#[test]
fn whatever_goes_wrong_at_any_one_request_the_answer_is_true_and_nothing_is_dropped() {
    let requests = run(World::new(&[]), &[CARRY]).asked.len();
    assert!(requests > 20, "{requests}");
    let outcomes = [
        Motion::Unreachable,
        Motion::Stopped,
        Motion::Estopped,
        Motion::Guard,
        Motion::Fault,
        Motion::Lost,
        Motion::Refused,
    ];
    let mut faults: Vec<Fault> = outcomes.map(Fault::Meets).to_vec();
    faults.extend([Fault::AnswerLost, Fault::Slips]);
    for number in 0..requests {
        for fault in &faults {
            let world = run(World::new(&[(number, *fault)]), &[CARRY]);
            let (symbol, text) = &world.answers[0];
            let case = format!(
                "{fault:?} at {number}, {}: {symbol}: {text}; {:?}, hand_full {}",
                world.asked[number], world.thing, world.hand_full
            );
            assert!(!world.dropped, "dropped: {case}");
            assert!(world.rest, "no rest: {case}");
            let arrived = matches!(world.thing, Place::At(at) if (at - on("4,5")).norm() < 6e-3);
            match symbol.as_str() {
                "carried" => assert!(arrived, "{case}"),
                "not_carried" => {
                    assert!(!text.is_empty(), "no reason: {case}");
                    // It may be on its field when only what comes after that failed, which the text says.
                    let after = ["let_go", "withdraw", "park"];
                    let late = after.iter().any(|request| text.contains(request));
                    assert!(!arrived || late, "{case}");
                }
                _ => panic!("{case}"),
            }
            if world.thing == Place::InHand {
                assert_eq!(world.hand_full, 1, "{case}");
            }
        }
    }
}

#[test]
fn what_stays_in_the_hand_is_put_back_when_somebody_says_so_and_meanwhile_nothing_is_taken() {
    // The arm fails over the target, and again on the way back.
    let plain = run(World::new(&[]), &[CARRY]).asked;
    let moves: Vec<usize> = (0..plain.len()).filter(|at| plain[*at] == "move").collect();
    // Approach, down, up, then the way to the target: an emergency stop.
    let world = World::new(&[(moves[3], Fault::Meets(Motion::Estopped))]);
    let stuck = run(world, &[CARRY, "carry 3,4 4,5"]);
    assert_eq!(stuck.answers[0].0, "not_carried");
    assert_eq!(stuck.answers[1].0, "not_carried");
    assert!(
        stuck.answers[1].1.contains("put_back"),
        "{:?}",
        stuck.answers
    );
    assert_eq!((stuck.thing, stuck.hand_full), (Place::InHand, 1));
    // A fault there, and again on the way back: reserved, planned, moved.
    let fault = Fault::Meets(Motion::Fault);
    let world = World::new(&[(moves[3], fault), (moves[3] + 3, fault)]);
    let back = run(world, &[CARRY, "put_back"]);
    assert_eq!(back.answers[0].0, "not_carried");
    assert_eq!(back.answers[1].0, "put_down");
    let Place::At(at) = back.thing else {
        panic!("it is in the hand")
    };
    assert!((at - on("3,4")).norm() < 1e-9);
}

#[test]
fn without_cameras_a_thing_that_is_not_there_or_cannot_be_set_down_is_told_and_stays_where_it_was()
{
    let mut blind = World::new(&[]);
    blind.believes = "known";
    let world = run(blind, &["carry 2,2 4,5"]);
    assert_eq!(world.looks, 0);
    let (symbol, text) = &world.answers[0];
    assert_eq!(symbol, "not_carried");
    assert!(text.contains("no disc is between the jaws"), "{text}");
    let mut occupied = World::new(&[]);
    occupied.believes = "known";
    occupied.others.push(on("4,5"));
    let world = run(occupied, &[CARRY]);
    let (symbol, text) = &world.answers[0];
    assert_eq!(symbol, "not_carried");
    assert!(
        text.contains("something stands there already, 10 mm high"),
        "{text}"
    );
    assert_eq!(world.thing, Place::At(on("3,4")));
    assert!(!world.dropped && world.hand_full == 0);
}

#[test]
fn the_first_turn_with_which_the_arm_reaches_everything_is_taken() {
    let mut world = World::new(&[]);
    world.unreachable = vec![0.0];
    let world = run(world, &[CARRY]);
    assert_eq!(world.answers[0].0, "carried", "{:?}", world.answers);
    let mut nowhere = World::new(&[]);
    let turns = disc().grasp.turns_deg;
    nowhere.unreachable = turns.iter().map(|turn| turn.to_radians()).collect();
    let world = run(nowhere, &[CARRY]);
    let (symbol, text) = &world.answers[0];
    assert_eq!(symbol, "not_carried");
    assert!(text.contains("`from` cannot be reached"), "{text}");
}

#[test]
fn a_command_that_names_no_two_fields_is_refused_in_words_and_moves_nothing() {
    let world = run(World::new(&[]), &["carry", "carry 3,4 9,9", "carry a b"]);
    for (symbol, text) in &world.answers {
        assert_eq!(symbol, "not_carried");
        assert!(
            text.contains("FROM") || text.contains("field") || text.contains("board"),
            "{text}"
        );
    }
    assert!(world.asked.is_empty(), "{:?}", world.asked);
}

/// Whether anything was asked but the cameras.
fn moved(world: &World) -> bool {
    world.asked.iter().any(|request| request != "look_over")
}

#[test]
fn what_is_not_there_or_in_the_way_is_answered_by_name_before_anything_moves() {
    let world = run(World::new(&[]), &["carry 2,2 4,5"]);
    let (symbol, text) = &world.answers[0];
    assert_eq!(symbol, "nothing_at_from", "{text}");
    let said = "no disc is seen on 2,2,0; seen are a red disc on 3.00,4.00,0";
    assert!(text.contains(said), "{text}");
    assert!(!moved(&world), "{:?}", world.asked);

    let mut occupied = World::new(&[]);
    occupied.others.push(on("4,5"));
    let world = run(occupied, &[CARRY]);
    let (symbol, text) = &world.answers[0];
    assert_eq!(symbol, "occupied", "{text}");
    assert!(text.contains("a blue disc stands on 4.00,5.00,0"), "{text}");
    assert!(!moved(&world) && world.rest && world.hand_full == 0);

    let mut cluttered = World::new(&[]);
    cluttered.clutter = true;
    let world = run(cluttered, &[CARRY]);
    assert_eq!(world.answers[0].0, "occupied", "{:?}", world.answers);
    assert!(!moved(&world));

    // Nothing lies on TO to set it down upon, and something lies upon what is to be taken.
    for (other, command, said) in [
        (None, "carry 3,4 4,5,1", "fewer than 1 lie on 4,5"),
        (Some("3,4,1"), CARRY, "is at height 1, not at 0"),
    ] {
        let mut world = World::new(&[]);
        world.others.extend(other.map(on));
        let world = run(world, &[command]);
        let (symbol, text) = &world.answers[0];
        assert_eq!(symbol, "not_carried", "{text}");
        assert!(text.contains(said), "{text}");
        assert!(!moved(&world));
    }
}

#[test]
fn a_board_that_was_pushed_and_a_thing_off_its_field_are_taken_where_they_are_seen() {
    let mut pushed = World::new(&[]);
    pushed.board.at = [0.54, -0.03, 0.42];
    pushed.board.yaw_deg = -35.0;
    let at = |board: &Board, field: &str| board.point(&field.parse().unwrap(), 0.01);
    let board = pushed.board;
    // 10 mm off the middle of its field.
    pushed.thing = Place::At(at(&board, "3,4") + board.pose() * Vector3::new(0.008, -0.006, 0.0));
    let world = run(pushed, &[CARRY]);
    let (symbol, text) = &world.answers[0];
    assert_eq!(symbol, "carried", "{text}");
    assert!(text.contains("seen on 4,5,0: 0.0 mm"), "{text}");
    let Place::At(stands) = world.thing else {
        panic!("it is in the hand")
    };
    assert!((stands - at(&board, "4,5")).norm() < 1e-6);
}

#[test]
fn a_thing_that_slipped_in_the_air_is_found_again_and_told_by_where_it_lies() {
    let plain = run(World::new(&[]), &[CARRY]).asked;
    let moves: Vec<usize> = (0..plain.len()).filter(|at| plain[*at] == "move").collect();
    // Approach, down in two parts, up, then the way to the target.
    let world = run(World::new(&[(moves[4], Fault::Slips)]), &[CARRY]);
    let (symbol, text) = &world.answers[0];
    assert_eq!(symbol, "not_carried");
    let Place::At(at) = world.thing else {
        panic!("it is in the hand")
    };
    let field: Field = BOARD.field(&(BOARD.pose().inverse() * at), 0.01);
    let said = format!("a red disc lies on {:.2},{:.2}", field.column, field.row);
    assert!(text.contains(&said), "{said}: {text}");
}

#[test]
fn cameras_that_see_nothing_end_an_errand_before_anything_moves_or_leave_it_to_the_configuration() {
    let mut dark = World::new(&[]);
    dark.dark_from = 0;
    let world = run(dark, &[CARRY]);
    let (symbol, text) = &world.answers[0];
    assert_eq!(symbol, "not_carried");
    assert!(text.contains("find: no camera sees the board"), "{text}");
    assert_eq!(world.looks, 3);
    assert!(!moved(&world) && world.rest);

    let mut believing = World::new(&[]);
    believing.dark_from = 0;
    believing.believes = "seen_else_known";
    let world = run(believing, &[CARRY]);
    let (symbol, text) = &world.answers[0];
    assert_eq!(symbol, "carried", "{text}");
    assert!(
        text.contains("taken to be where it is configured"),
        "{text}"
    );
    assert!(text.contains("nobody sees it"), "{text}");

    // Dark after the thing was set down.
    let mut later = World::new(&[]);
    later.dark_from = 1;
    let world = run(later, &[CARRY]);
    let (symbol, text) = &world.answers[0];
    assert_eq!(symbol, "carried", "{text}");
    assert!(
        text.contains("it was set down, and nobody sees it"),
        "{text}"
    );
}
