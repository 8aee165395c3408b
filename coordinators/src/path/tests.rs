//! The nets of `path` in virtual time, between stand-ins for the arm and for the planner, which fail on demand: at every
//! request, one after the other, in every way.

use std::{
    collections::BTreeSet,
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
        Acquire, Cancel, MotionError, Move, MoveReport, Outcome as Motion, PathKind, Plan,
        PlanReport, Position, ReadPosition, Release, Status, StatusReport, Target,
    },
    servo::MotionPhase,
    state::State,
};
use mcs_path::{
    PathError, Way,
    task::{PlanWay, Planned, Unplanned},
};
use pnt::task::{Marking, PutTape};

/// What goes wrong at one request.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Fault {
    /// It is not done, for this reason.
    Meets(Motion),
    /// It is done, and the answer is lost.
    AnswerLost,
}

/// What the stand-ins share.
struct World {
    at: Joints,
    /// Kinds of path that a guard ends half way.
    blocked: BTreeSet<&'static str>,
    reserved: bool,
    estopped: bool,
    /// Looks at a protective stop until somebody ends it.
    stopped: u32,
    /// A motion ended before its end, and with it those that wait.
    dropped: bool,
    asked: Vec<String>,
    faults: Vec<(usize, Fault)>,
    answers: Vec<(String, String)>,
    rest: bool,
}

fn kind(path: &PathKind) -> &'static str {
    match path {
        PathKind::Joint => "joint",
        PathKind::StraightLine => "line",
        PathKind::Arch { .. } => "arch",
        _ => "planned",
    }
}

impl World {
    fn new(blocked: &[&'static str], faults: &[(usize, Fault)]) -> Self {
        Self {
            at: Joints::zeros(6),
            blocked: blocked.iter().copied().collect(),
            reserved: false,
            estopped: false,
            stopped: 0,
            dropped: false,
            asked: Vec::new(),
            faults: faults.to_vec(),
            answers: Vec::new(),
            rest: false,
        }
    }

    /// Notes a request; what goes wrong with it.
    fn meets(&mut self, request: &str) -> Option<Fault> {
        let number = self.asked.len();
        self.asked.push(request.to_owned());
        self.dropped &= request == Move::NAME;
        let fault = self.faults.iter().find(|(at, _)| *at == number)?.1;
        self.dropped |= request == Move::NAME && fault != Fault::AnswerLost;
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
        if self.dropped {
            return refused(Motion::Fault, "the motion before it ended early");
        }
        let Target::Joints(to) = order.target else {
            return refused(Motion::Refused, "no joints");
        };
        if self.blocked.contains(kind(&order.path)) {
            self.at = Joints::from_fn(6, |joint| 0.5 * (self.at[joint] + to[joint]));
            return refused(Motion::Guard, "post is near");
        }
        self.at = to;
        Ok(())
    }
}

type Shared = Arc<Mutex<World>>;

fn lock(world: &Shared) -> MutexGuard<'_, World> {
    world.lock().unwrap_or_else(PoisonError::into_inner)
}

/// The arm and the planner.
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
                world.reserved = false;
                Ok(State::Cold)
            }),
            Plan::CODE => self.typed::<Plan, _>(message, |world, _| {
                Ok(PlanReport {
                    joints: world.at,
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
                    joints: world.at,
                    smallest_singular_value: None,
                })
            }),
            PlanWay::CODE => {
                let (PlanWay { from, goals, .. }, reply) = message.open::<PlanWay>()?;
                let mut world = lock(&self.0);
                let fault = world.meets("plan_way");
                if matches!(fault, Some(Fault::Meets(Motion::Unreachable))) {
                    return reply.ok(Err(Unplanned::Path(PathError::NoGoal)));
                }
                if fault.is_some() {
                    return reply.fail("it is broken");
                }
                let middle = mcs_path::space::between(&from, &goals[0], 0.5);
                reply.ok(Ok(Planned {
                    way: Way {
                        points: vec![from, middle, goals[0]],
                        leeway: vec![0.0, 0.1, 0.0],
                        length_m: 1.0,
                        full_speed_s: 1.0,
                        nearest: None,
                    },
                    iterations: 1,
                }))
            }
            ReadPosition::CODE => {
                let (ReadPosition {}, reply) = message.open::<ReadPosition>()?;
                let mut world = lock(&self.0);
                if world.meets("read_position").is_some() {
                    return reply.fail("it is broken");
                }
                reply.ok(Position {
                    joints: world.at,
                    base_t_tool: [0.0; 16],
                    at_rest: true,
                })
            }
            Status::CODE => {
                let (Status {}, reply) = message.open::<Status>()?;
                let mut world = lock(&self.0);
                world.stopped = world.stopped.saturating_sub(1);
                reply.ok(StatusReport {
                    state: State::Motion,
                    holder: world.reserved.then(|| "path".to_owned()),
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
struct Operator(Shared, Vec<String>);

impl EventHandler for Operator {
    async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
        cx.default_processing(message)
    }

    async fn phase(&mut self, cx: &Context, phase: Phase) -> Handled {
        if phase == Phase::Run {
            let (child, world, places) = (cx.clone(), self.0.clone(), self.1.clone());
            cx.spawn(async move {
                let operated = operate(&child, &world, places).await;
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

async fn operate(cx: &Context, world: &Shared, places: Vec<String>) -> Handled {
    let dispatcher = cx.task("dispatcher").await?;
    for place in places {
        let put = PutTape {
            symbol: "go".to_owned(),
            arguments: place.split_whitespace().map(ToOwned::to_owned).collect(),
        };
        let answer = cx.call(&dispatcher, put);
        let answer = answer.deadline(Duration::from_secs(100_000)).await?;
        lock(world).answers.push((answer.symbol, answer.text));
    }
    // The last tokens may still be on their way.
    cx.sleep(Duration::from_secs(1)).await;
    let marking = cx.call(&dispatcher, Marking {}).await?;
    let mut places = marking.places.iter();
    let free = places.find(|(place, _)| place == "arm_free");
    lock(world).rest = free.is_some_and(|(_, tokens)| *tokens == 1);
    Ok(())
}

fn app(seed: u64) -> String {
    let nets = Path::new(env!("CARGO_MANIFEST_DIR")).join("../configs/nets/path");
    format!(
        r#"[app]
name = "test"
until = "operator"
seed = {seed}
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
handler = "coordinators.go"
on = "ws1"
[task.dispatcher.args]
net = "{nets}/dispatcher.net"
places = {{ left = [10, 0, 0, 0, 0, 0], right = [-10, 0, 0, 0, 0, 0] }}
[task.path]
handler = "coordinators.path"
on = "ws1"
[task.path.args]
net = "{nets}/path.net"
service_within_s = 2.0
[task.mcs]
handler = "test.arm"
on = "cage"
[task.paths]
handler = "test.arm"
on = "cage"
"#,
        nets = nets.display()
    )
}

fn run_seeded(world: World, places: &[&str], seed: u64) -> World {
    let world = Arc::new(Mutex::new(world));
    let mut registry = Registry::new();
    crate::register(&mut registry);
    let takes = [
        Acquire::INFO,
        Release::INFO,
        Plan::INFO,
        Move::INFO,
        ReadPosition::INFO,
        Status::INFO,
        Cancel::INFO,
        PlanWay::INFO,
    ];
    let shared = world.clone();
    registry.handler("test.arm", &takes, move |_| Ok(StandIn(shared.clone())));
    let places: Vec<String> = places.iter().map(ToString::to_string).collect();
    let shared = world.clone();
    registry.handler("test.operator", &[], move |_| {
        Ok(Operator(shared.clone(), places.clone()))
    });
    let app = config::load_texts(&[("app.toml", &app(seed))], &[], &[]);
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
    std::mem::replace(&mut *left, World::new(&[], &[]))
}

fn run(world: World, places: &[&str]) -> World {
    run_seeded(world, places, 1)
}

fn is_at(world: &World, degrees: f64) -> bool {
    (world.at[0] - degrees.to_radians()).abs() < 1e-9
}

#[test]
fn an_arm_that_nothing_blocks_goes_where_it_is_sent_and_is_given_back() {
    let world = run(World::new(&[], &[]), &["left", "right"]);
    for ((symbol, text), step) in world
        .answers
        .iter()
        .zip(["elsewhere to left", "left to right"])
    {
        assert_eq!(symbol, "there", "{text}");
        assert!(text.contains(step), "{text}");
    }
    assert!(is_at(&world, -10.0) && !world.reserved && world.rest);
}

#[test]
fn where_ways_are_blocked_the_next_one_is_tried_and_where_all_are_the_answer_has_every_reason() {
    let world = run(World::new(&["line", "joint", "arch"], &[]), &["left"]);
    let (symbol, text) = &world.answers[0];
    assert_eq!(symbol, "there", "{text}");
    assert!(
        text.contains("planned") && text.contains("3 points"),
        "{text}"
    );
    let all = ["line", "joint", "arch", "planned"];
    let world = run(World::new(&all, &[]), &["left"]);
    let (symbol, text) = &world.answers[0];
    assert_eq!(symbol, "not_there");
    for way in ["line", "joint", "arch", "planned", "planned_slowly"] {
        assert!(text.contains(&format!("{way} failed")), "{way}: {text}");
    }
    assert!(world.rest && !world.reserved);
}

#[test]
fn what_is_blocked_is_hardly_tried_first_any_more_after_some_trips() {
    let tour: Vec<&str> = ["left", "right"].into_iter().cycle().take(60).collect();
    let (mut early, mut late) = (0, 0);
    for seed in 0..3 {
        let world = run_seeded(World::new(&["line", "joint", "arch"], &[]), &tour, seed);
        let wasted = |(_, text): &(String, String)| text.matches(" failed after").count();
        assert!(world.answers.iter().all(|(symbol, _)| symbol == "there"));
        let counts: Vec<usize> = world.answers.iter().map(wasted).collect();
        early += counts[..6].iter().sum::<usize>();
        late += counts[54..].iter().sum::<usize>();
    }
    assert!(
        3 * late < early,
        "{early} ways failed at first, {late} at last"
    );
}

#[test]
fn the_same_seed_takes_the_same_ways() {
    let texts = |seed| {
        let world = run_seeded(World::new(&["line"], &[]), &["left", "right", "left"], seed);
        world.answers
    };
    assert_eq!(texts(4), texts(4));
}

#[test]
fn whatever_goes_wrong_at_any_one_request_the_answer_is_true() {
    let blocked = ["line", "joint", "arch"];
    let plain = run(World::new(&blocked, &[]), &["left"]);
    let requests = plain.asked.len();
    assert!(requests > 8, "{requests}");
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
            .take(if all { 8 } else { 2 })
        {
            let world = run(World::new(&blocked, &[(number, *fault)]), &["left"]);
            let (symbol, text) = &world.answers[0];
            let case = format!(
                "{fault:?} at {number}, {}: {symbol}: {text}",
                world.asked[number]
            );
            assert!(world.rest, "no rest: {case}");
            match symbol.as_str() {
                "there" => assert!(is_at(&world, 10.0), "{case}"),
                "not_there" => {
                    assert!(!text.is_empty(), "no reason: {case}");
                    // It may be there when only the answer was lost, which the text says.
                    assert!(!is_at(&world, 10.0) || text.contains("lost"), "{case}");
                }
                _ => panic!("{case}"),
            }
        }
    }
}

#[test]
fn a_command_that_names_no_place_is_refused_in_words_and_moves_nothing() {
    let world = run(World::new(&[], &[]), &["", "up", "left right"]);
    for (symbol, text) in &world.answers {
        assert_eq!(symbol, "not_there");
        assert!(text.contains("there are left, right"), "{text}");
    }
    assert!(world.asked.is_empty());
}
