//! The nets of `path` in virtual time, between stand-ins for the arm and for the planner, which fail on demand: at every
//! request, one after the other, in every way.

use std::collections::BTreeSet;

use ctos::{
    message::{Command, CommandInfo, Message},
    task::{Context, Handled},
};
use mcs::{
    Joints,
    client::{MotionError, Move, Outcome as Motion, PathKind, Plan, Target},
};
use mcs_path::{
    PathError, Way,
    task::{PlanWay, Planned, Unplanned},
};

use crate::bench::{self, Bench, Fault, StandIn, configs, faults_at};

/// What the stand-ins share.
struct World {
    bench: Bench,
    at: Joints,
    /// Kinds of path that a guard ends half way.
    blocked: BTreeSet<&'static str>,
    /// A motion ended before its end, and with it those that wait.
    dropped: bool,
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
            bench: Bench::new(faults),
            at: Joints::zeros(6),
            blocked: blocked.iter().copied().collect(),
            dropped: false,
        }
    }
}

impl Default for World {
    fn default() -> Self {
        Self::new(&[], &[])
    }
}

impl bench::World for World {
    const MORE: &'static [CommandInfo] = &[PlanWay::INFO];

    fn bench(&mut self) -> &mut Bench {
        &mut self.bench
    }

    fn strikes(&mut self, request: &str, fault: Option<Fault>) {
        self.dropped &= request == Move::NAME;
        let ends = fault.is_some_and(|fault| fault != Fault::AnswerLost);
        self.dropped |= request == Move::NAME && ends;
    }

    fn plans(&mut self, _plan: &Plan) -> Result<Joints, MotionError> {
        Ok(self.at)
    }

    fn goes(&mut self, order: &Move) -> Result<(), MotionError> {
        let refused = |outcome, text: &str| Err(MotionError::new(outcome, text));
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

    fn joints(&self) -> Joints {
        self.at
    }

    /// The planner.
    fn more(stand_in: &StandIn<Self>, cx: &Context, message: Message) -> Handled {
        if message.command() != PlanWay::CODE {
            return cx.default_processing(message);
        }
        let (PlanWay { from, goals, .. }, reply) = message.open::<PlanWay>()?;
        match stand_in.meets("plan_way").0 {
            Some(Fault::Meets(Motion::Unreachable)) => {
                return reply.ok(Err(Unplanned::Path(PathError::NoGoal)));
            }
            Some(_) => return reply.fail("it is broken"),
            None => {}
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
}

fn app() -> String {
    let nets = configs().join("nets/path");
    let tasks = format!(
        r#"
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
"#,
        nets = nets.display()
    );
    bench::app(&tasks, &["mcs", "paths"])
}

fn run_seeded(world: World, places: &[&str], seed: u64) -> World {
    let app = app();
    let sets = [format!("app.seed={seed}")];
    let commands: Vec<String> = places.iter().map(|place| format!("go {place}")).collect();
    let commands: Vec<&str> = commands.iter().map(String::as_str).collect();
    bench::run_with(world, (&app, &sets), &commands, &[])
}

fn run(world: World, places: &[&str]) -> World {
    run_seeded(world, places, 1)
}

/// Whether the Dispatcher is at rest.
fn rests(world: &World) -> bool {
    world.bench.tokens("arm_free") == 1
}

fn is_at(world: &World, degrees: f64) -> bool {
    (world.at[0] - degrees.to_radians()).abs() < 1e-9
}

#[test]
fn an_arm_that_nothing_blocks_goes_where_it_is_sent_and_is_given_back() {
    let world = run(World::new(&[], &[]), &["left", "right"]);
    for ((symbol, text), step) in world
        .bench
        .answers
        .iter()
        .zip(["elsewhere to left", "left to right"])
    {
        assert_eq!(symbol, "there", "{text}");
        assert!(text.contains(step), "{text}");
    }
    assert!(is_at(&world, -10.0) && !world.bench.reserved && rests(&world));
}

#[test]
fn where_ways_are_blocked_the_next_one_is_tried_and_where_all_are_the_answer_has_every_reason() {
    let world = run(World::new(&["line", "joint", "arch"], &[]), &["left"]);
    let (symbol, text) = &world.bench.answers[0];
    assert_eq!(symbol, "there", "{text}");
    assert!(
        text.contains("planned") && text.contains("3 points"),
        "{text}"
    );
    let all = ["line", "joint", "arch", "planned"];
    let world = run(World::new(&all, &[]), &["left"]);
    let (symbol, text) = &world.bench.answers[0];
    assert_eq!(symbol, "not_there");
    for way in ["line", "joint", "arch", "planned", "planned_slowly"] {
        assert!(text.contains(&format!("{way} failed")), "{way}: {text}");
    }
    assert!(rests(&world) && !world.bench.reserved);
}

#[test]
fn what_is_blocked_is_hardly_tried_first_any_more_after_some_trips() {
    let tour: Vec<&str> = ["left", "right"].into_iter().cycle().take(60).collect();
    let (mut early, mut late) = (0, 0);
    for seed in 0..3 {
        let world = run_seeded(World::new(&["line", "joint", "arch"], &[]), &tour, seed);
        let wasted = |(_, text): &(String, String)| text.matches(" failed after").count();
        assert!(
            world
                .bench
                .answers
                .iter()
                .all(|(symbol, _)| symbol == "there")
        );
        let counts: Vec<usize> = world.bench.answers.iter().map(wasted).collect();
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
        world.bench.answers
    };
    assert_eq!(texts(4), texts(4));
}

#[test]
fn whatever_goes_wrong_at_any_one_request_the_answer_is_true() {
    let blocked = ["line", "joint", "arch"];
    let plain = run(World::new(&blocked, &[]), &["left"]);
    let requests = plain.bench.asked.len();
    assert!(requests > 8, "{requests}");
    for number in 0..requests {
        for fault in faults_at(number, 2) {
            let world = run(World::new(&blocked, &[(number, fault)]), &["left"]);
            let (symbol, text) = &world.bench.answers[0];
            let case = format!(
                "{fault:?} at {number}, {}: {symbol}: {text}",
                world.bench.asked[number]
            );
            assert!(rests(&world), "no rest: {case}");
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
    for (symbol, text) in &world.bench.answers {
        assert_eq!(symbol, "not_there");
        assert!(text.contains("there are left, right"), "{text}");
    }
    assert!(world.bench.asked.is_empty());
}

#[test]
fn why_a_place_was_not_reached_is_told_by_types_to_who_sent_the_command() {
    let why = |world: World, command: &str| {
        let app = bench::planned(&app(), command, "");
        bench::kinds(&bench::run_planned(world, &app).1)
    };
    let all = ["line", "joint", "arch", "planned"];
    let (answer, kinds) = why(World::new(&all, &[]), "go left");
    assert_eq!(answer, "not_there");
    assert_eq!(kinds, ["guard"; 5]);
    let (answer, kinds) = why(World::new(&[], &[]), "go nowhere");
    assert_eq!(
        (answer.as_str(), kinds),
        ("not_there", vec!["refused".to_owned()])
    );
}
