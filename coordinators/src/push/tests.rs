//! The nets of `push` in virtual time, between stand-ins for the arm, which know where the thing is and fail on demand: at every
//! request, one after the other, in every way.

use std::{
    path::Path,
    sync::{Arc, Mutex, MutexGuard, PoisonError},
    time::Duration,
};

use ctos::{
    boot::{self, End, Launcher},
    config,
    message::{Command, Message},
    registry::Registry,
    system::AppResult,
    task::{Context, EventHandler, Handled, Phase},
};
use mcs::{
    Joints,
    client::{
        Acquire, Cancel, ControlReport, GuardsReport, MotionError, Move, MoveReport,
        Outcome as Motion, PathKind, Plan, PlanReport, Position, ReadGuards, ReadPosition, Release,
        SetLaw, Status, StatusReport, Target,
    },
    guard::GuardReport,
    servo::MotionPhase,
    state::State,
};
use nalgebra::{Isometry3, Matrix4, Point2};
use pnt::task::{Marking, PutTape};

use super::job::Job;

/// What goes wrong at one request.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Fault {
    /// It is not done, for this reason.
    Meets(Motion),
    /// It is done, and the answer is lost.
    AnswerLost,
}

/// What the stand-ins share. Places are along the way, m.
struct World {
    tool: Isometry3<f64>,
    planned: Vec<Isometry3<f64>>,
    /// Where the near face of the thing is; nothing is there without one.
    face: Option<f64>,
    /// Where it can be pushed no farther.
    wall: Option<f64>,
    /// Where it slips away from the tool, each once.
    slips: Vec<f64>,
    last: Option<&'static str>,
    law: String,
    reserved: bool,
    estopped: bool,
    stopped: u32,
    /// A stiff law was in force while the tool pressed on the thing, or a compliant one when the arm was given back.
    misused: bool,
    asked: Vec<String>,
    faults: Vec<(usize, Fault)>,
    answers: Vec<(String, String)>,
    rest: bool,
}

fn job() -> Job {
    Job {
        command: 1,
        from: Point2::new(0.5, -0.2),
        to: Point2::new(0.5, 0.1),
    }
}

impl World {
    fn new(faults: &[(usize, Fault)]) -> Self {
        Self {
            tool: Isometry3::translation(0.3, 0.0, 0.8),
            planned: Vec::new(),
            face: Some(0.05),
            wall: None,
            slips: Vec::new(),
            last: None,
            law: "pid".to_owned(),
            reserved: false,
            estopped: false,
            stopped: 0,
            misused: false,
            asked: Vec::new(),
            faults: faults.to_vec(),
            answers: Vec::new(),
            rest: false,
        }
    }

    fn meets(&mut self, request: &str) -> Option<Fault> {
        let number = self.asked.len();
        self.asked.push(request.to_owned());
        let fault = self.faults.iter().find(|(at, _)| *at == number)?.1;
        match fault {
            Fault::Meets(Motion::Estopped) => self.estopped = true,
            Fault::Meets(Motion::Stopped) => self.stopped = 3,
            _ => {}
        }
        Some(fault)
    }

    fn goes(&mut self, order: &Move) -> Result<(), MotionError> {
        let refused = |outcome, text: &str| Err(MotionError::new(outcome, text));
        if self.estopped {
            return refused(Motion::Estopped, "an emergency stop holds");
        }
        if self.stopped > 0 {
            return refused(Motion::Stopped, "a protective stop holds");
        }
        if !self.reserved {
            return refused(Motion::Refused, "the arm is not reserved");
        }
        let mut to = match order.target {
            Target::Pose(rows) => pose(&rows),
            Target::Joints(joints) => match self.planned.get(joints[0] as usize) {
                Some(planned) if joints[1] < -1.0 => *planned,
                _ => Isometry3::translation(0.3, 0.0, 0.8),
            },
        };
        let (job, height) = (job(), to.translation.z);
        let along = |tool: &Isometry3<f64>| job.along(&Point2::from(tool.translation.vector.xy()));
        let mut met = Ok(());
        let has = |guard: &str| order.guards.iter().any(|name| name == guard);
        let ends = |world: &mut Self, guard: &'static str, at: f64, to: &mut Isometry3<f64>| {
            world.last = Some(guard);
            *to = job.pose(at, height, 0.0);
            MotionError::new(Motion::Guard, format!("{guard}: as it should"))
        };
        let goal = along(&to);
        if order.path == PathKind::StraightLine && height < 0.45 {
            match self.face {
                Some(face) if has("touch") && goal >= face && along(&self.tool) <= face + 1e-9 => {
                    met = Err(ends(self, "touch", face, &mut to));
                }
                Some(face) if has("contact") => {
                    self.misused |= self.law != "cartesian_impedance";
                    let slip = self.slips.iter().position(|slip| *slip < goal);
                    if (along(&self.tool) - face).abs() > 1e-6 {
                        let at = along(&self.tool);
                        met = Err(ends(self, "contact", at, &mut to));
                    } else if let Some(slip) = slip {
                        let at = self.slips.remove(slip);
                        self.face = Some(at + 0.02);
                        met = Err(ends(self, "contact", at, &mut to));
                    } else if let Some(wall) = self.wall.filter(|wall| *wall < goal) {
                        self.face = Some(wall);
                        met = Err(ends(self, "blocked", wall, &mut to));
                    } else {
                        self.face = Some(goal);
                    }
                }
                None if has("contact") => {
                    let at = along(&self.tool);
                    met = Err(ends(self, "contact", at, &mut to));
                }
                _ => {}
            }
        }
        self.tool = to;
        met
    }
}

fn pose(rows: &[f64; 16]) -> Isometry3<f64> {
    nalgebra::try_convert(Matrix4::from_row_slice(rows)).unwrap()
}

type Shared = Arc<Mutex<World>>;

fn lock(world: &Shared) -> MutexGuard<'_, World> {
    world.lock().unwrap_or_else(PoisonError::into_inner)
}

struct StandIn(Shared);

impl StandIn {
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

    /// The same of a request whose answer is no error.
    fn plain<C: Command>(
        &self,
        message: Message,
        act: impl FnOnce(&mut World, C) -> C::Reply,
    ) -> Handled {
        let (request, reply) = message.open::<C>()?;
        let mut world = lock(&self.0);
        match world.meets(C::NAME) {
            Some(Fault::Meets(_)) => reply.fail("it is broken"),
            fault => {
                let answer = act(&mut world, request);
                match fault {
                    Some(Fault::AnswerLost) => reply.fail("the answer is lost on purpose"),
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
                    let text = "an emergency stop holds";
                    return Err(MotionError::new(Motion::Estopped, text));
                }
                world.reserved = true;
                Ok(State::Motion)
            }),
            Release::CODE => self.typed::<Release, _>(message, |world, _| {
                world.misused |= world.law != "pid";
                world.reserved = false;
                Ok(State::Cold)
            }),
            Plan::CODE => self.typed::<Plan, _>(message, |world, plan| {
                let joints = match plan.target {
                    Target::Joints(joints) => joints,
                    Target::Pose(rows) => {
                        world.planned.push(pose(&rows));
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
            SetLaw::CODE => self.plain::<SetLaw>(message, |world, SetLaw { law }| {
                world.law.clone_from(&law);
                ControlReport {
                    law,
                    bandwidth_hz: 8.0,
                    damping: 1.0,
                    following_error_rad: 0.1,
                }
            }),
            ReadGuards::CODE => self.plain::<ReadGuards>(message, |world, _| GuardsReport {
                recipes: Vec::new(),
                last: world.last.map(|guard| GuardReport {
                    guard: guard.into(),
                    ..GuardReport::default()
                }),
            }),
            ReadPosition::CODE => self.plain::<ReadPosition>(message, |world, _| {
                let matrix = world.tool.to_homogeneous().transpose();
                let mut base_t_tool = [0.0; 16];
                base_t_tool.copy_from_slice(matrix.as_slice());
                Position {
                    joints: Joints::zeros(6),
                    base_t_tool,
                    at_rest: true,
                }
            }),
            Status::CODE => {
                let (Status {}, reply) = message.open::<Status>()?;
                let mut world = lock(&self.0);
                world.stopped = world.stopped.saturating_sub(1);
                reply.ok(StatusReport {
                    state: State::Motion,
                    holder: world.reserved.then(|| "pusher".to_owned()),
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

/// Puts a command on the Dispatcher's tape, and looks at the net at the end.
struct Operator(Shared, Vec<String>);

impl EventHandler for Operator {
    async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
        cx.default_processing(message)
    }

    async fn phase(&mut self, cx: &Context, phase: Phase) -> Handled {
        if phase == Phase::Run {
            let (child, world, arguments) = (cx.clone(), self.0.clone(), self.1.clone());
            cx.spawn(async move {
                let operated = operate(&child, &world, arguments).await;
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

async fn operate(cx: &Context, world: &Shared, arguments: Vec<String>) -> Handled {
    let dispatcher = cx.task("dispatcher").await?;
    let put = PutTape {
        symbol: "push".to_owned(),
        arguments,
    };
    let answer = cx.call(&dispatcher, put);
    let answer = answer.deadline(Duration::from_secs(100_000)).await?;
    lock(world).answers.push((answer.symbol, answer.text));
    // The last tokens may still be on their way.
    cx.sleep(Duration::from_secs(1)).await;
    let marking = cx.call(&dispatcher, Marking {}).await?;
    let mut places = marking.places.iter();
    let free = places.find(|(place, _)| place == "arm_free");
    lock(world).rest = free.is_some_and(|(_, tokens)| *tokens == 1);
    Ok(())
}

fn app() -> String {
    let nets = Path::new(env!("CARGO_MANIFEST_DIR")).join("../configs/nets/push");
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
handler = "coordinators.push"
on = "ws1"
args.net = "{nets}/dispatcher.net"
[task.pusher]
handler = "coordinators.push_arm"
on = "ws1"
[task.pusher.args]
net = "{nets}/pusher.net"
height_m = 0.43
park_deg = [0, 75, -180, 0, -75, 0]
service_within_s = 2.0
[task.mcs]
handler = "test.arm"
on = "cage"
"#,
        nets = nets.display()
    )
}

fn run(world: World, arguments: &[&str]) -> World {
    let world = Arc::new(Mutex::new(world));
    let mut registry = Registry::new();
    crate::register(&mut registry);
    let takes = [
        Acquire::INFO,
        Release::INFO,
        Plan::INFO,
        Move::INFO,
        SetLaw::INFO,
        ReadGuards::INFO,
        ReadPosition::INFO,
        Status::INFO,
        Cancel::INFO,
    ];
    let shared = world.clone();
    registry.handler("test.arm", &takes, move |_| Ok(StandIn(shared.clone())));
    let arguments: Vec<String> = arguments.iter().map(ToString::to_string).collect();
    let shared = world.clone();
    registry.handler("test.operator", &[], move |_| {
        Ok(Operator(shared.clone(), arguments.clone()))
    });
    let app = config::load_texts(&[("app.toml", &app())], &[], &[]);
    let app = app.unwrap_or_else(|found| panic!("{found}"));
    let findings = registry.check(&app);
    assert!(!findings.has_errors(), "{findings}");
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

const PUSH: &[&str] = &["0.5,-0.2", "0.5,0.1"];

fn is_pushed(world: &World) -> bool {
    world.face.is_some_and(|face| (face - 0.3).abs() < 1e-6)
}

#[test]
fn a_thing_is_felt_pushed_to_the_end_of_the_way_and_left_and_the_arm_is_stiff_again() {
    let world = run(World::new(&[]), PUSH);
    let (symbol, text) = &world.answers[0];
    assert_eq!(symbol, "pushed_it", "{text}");
    assert_eq!(text, "felt at 50 mm of the way, pushed 250 mm from there");
    assert!(is_pushed(&world) && !world.misused && !world.reserved && world.rest);
}

#[test]
fn a_thing_that_slips_away_is_felt_for_again_a_few_times() {
    let mut slippery = World::new(&[]);
    slippery.slips = vec![0.12, 0.2];
    let world = run(slippery, PUSH);
    let (symbol, text) = &world.answers[0];
    assert_eq!(symbol, "pushed_it", "{text}");
    assert!(text.contains("felt for again 2 times"), "{text}");
    assert!(is_pushed(&world));
    let mut worse = World::new(&[]);
    worse.slips = vec![0.12, 0.2, 0.25];
    let world = run(worse, PUSH);
    let (symbol, text) = &world.answers[0];
    assert_eq!(symbol, "not_pushed", "{text}");
    assert!(text.contains("push: contact"), "{text}");
    assert!(world.rest && !world.reserved);
}

#[test]
fn a_thing_that_meets_a_wall_or_is_not_there_is_told_with_how_far_it_was_pushed() {
    let mut walled = World::new(&[]);
    walled.wall = Some(0.15);
    let world = run(walled, PUSH);
    let (symbol, text) = &world.answers[0];
    assert_eq!(symbol, "not_pushed");
    assert!(
        text.contains("pushed 100 mm") && text.contains("push: blocked"),
        "{text}"
    );
    assert!(!world.misused);
    let mut empty = World::new(&[]);
    empty.face = None;
    let world = run(empty, PUSH);
    let (symbol, text) = &world.answers[0];
    assert_eq!(symbol, "not_pushed");
    assert!(text.contains("nothing was felt"), "{text}");
}

#[test]
fn whatever_goes_wrong_at_any_one_request_the_answer_is_true() {
    let world = || {
        let mut world = World::new(&[]);
        world.slips = vec![0.12];
        world
    };
    let requests = run(world(), PUSH).asked.len();
    assert!(requests > 30, "{requests}");
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
    faults.push(Fault::AnswerLost);
    let all = std::env::var("CTOS_FAULTS").is_ok();
    for number in 0..requests {
        // One after the other in the short run; every one at every request with `CTOS_FAULTS=all`.
        for fault in faults
            .iter()
            .cycle()
            .skip(number % 8)
            .take(if all { 8 } else { 1 })
        {
            let mut faulty = world();
            faulty.faults = vec![(number, *fault)];
            let world = run(faulty, PUSH);
            let (symbol, text) = &world.answers[0];
            let case = format!(
                "{fault:?} at {number}, {}: {symbol}: {text}; {:?}",
                world.asked[number], world.face
            );
            assert!(world.rest, "no rest: {case}");
            assert!(!world.misused, "stiff where it should give way: {case}");
            match symbol.as_str() {
                "pushed_it" => assert!(is_pushed(&world), "{case}"),
                "not_pushed" => {
                    assert!(!text.is_empty(), "no reason: {case}");
                    // It may stand there when only what comes after that failed, or was not heard of, or when the text says
                    // that it was pushed all the way.
                    let late = ["withdraw", "park", "lost", "pushed 250 mm"];
                    let late = late.iter().any(|word| text.contains(word));
                    assert!(!is_pushed(&world) || late, "{case}");
                }
                _ => panic!("{case}"),
            }
        }
    }
}

#[test]
fn a_command_that_names_no_way_is_refused_in_words_and_moves_nothing() {
    for arguments in [&[][..], &["0.5,-0.2"], &["here", "there"], &["0,0", "0,0"]] {
        let world = run(World::new(&[]), arguments);
        let (symbol, text) = &world.answers[0];
        assert_eq!(symbol, "not_pushed");
        assert!(!text.is_empty() && world.asked.is_empty());
    }
}
