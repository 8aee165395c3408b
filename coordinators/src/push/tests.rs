//! The nets of `push` in virtual time, between stand-ins for the arm, which know where the thing is and fail on demand: at every
//! request, one after the other, in every way.

use ctos::{
    message::{Command, CommandInfo, Message},
    task::{Context, Handled},
};
use mcs::{
    Joints,
    client::{
        ControlReport, GuardsReport, MotionError, Move, Outcome as Motion, PathKind, Plan,
        ReadGuards, SetLaw, Target,
    },
    guard::GuardReport,
};
use nalgebra::{Isometry3, Point2};

use super::job::Job;
use crate::bench::{self, Bench, StandIn, configs, faults_at, pose};

/// What the stand-ins share. Places are along the way, m.
struct World {
    bench: Bench,
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
    /// A stiff law was in force while the tool pressed on the thing, or a compliant one when the arm was given back.
    misused: bool,
}

fn job() -> Job {
    Job {
        command: 1,
        from: Point2::new(0.5, -0.2),
        to: Point2::new(0.5, 0.1),
    }
}

impl Default for World {
    fn default() -> Self {
        Self {
            bench: Bench::default(),
            tool: Isometry3::translation(0.3, 0.0, 0.8),
            planned: Vec::new(),
            face: Some(0.05),
            wall: None,
            slips: Vec::new(),
            last: None,
            law: "pid".to_owned(),
            misused: false,
        }
    }
}

impl bench::World for World {
    const MORE: &'static [CommandInfo] = &[SetLaw::INFO, ReadGuards::INFO];

    fn bench(&mut self) -> &mut Bench {
        &mut self.bench
    }

    fn plans(&mut self, plan: &Plan) -> Result<Joints, MotionError> {
        Ok(match plan.target {
            Target::Joints(joints) => joints,
            Target::Pose(rows) => {
                self.planned.push(pose(&rows));
                let number = self.planned.len() as f64 - 1.0;
                [number, -99.0, 0.0, 0.0, 0.0, 0.0].into()
            }
        })
    }

    fn goes(&mut self, order: &Move) -> Result<(), MotionError> {
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

    fn tool(&self) -> Isometry3<f64> {
        self.tool
    }

    fn is_released(&mut self) {
        self.misused |= self.law != "pid";
    }

    fn more(stand_in: &StandIn<Self>, cx: &Context, message: Message) -> Handled {
        match message.command() {
            SetLaw::CODE => stand_in.plain::<SetLaw>(message, |world, SetLaw { law }| {
                world.law.clone_from(&law);
                ControlReport {
                    law,
                    bandwidth_hz: 8.0,
                    damping: 1.0,
                    following_error_rad: 0.1,
                }
            }),
            ReadGuards::CODE => stand_in.plain::<ReadGuards>(message, |world, _| GuardsReport {
                recipes: Vec::new(),
                last: world.last.map(|guard| GuardReport {
                    guard: guard.into(),
                    ..GuardReport::default()
                }),
            }),
            _ => cx.default_processing(message),
        }
    }
}

fn app() -> String {
    let nets = configs().join("nets/push");
    let tasks = format!(
        r#"
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
"#,
        nets = nets.display()
    );
    bench::app(&tasks, &["mcs"])
}

fn run(world: World, arguments: &[&str]) -> World {
    let command = format!("push {}", arguments.join(" "));
    bench::run(world, &app(), &[&command])
}

/// Whether the Dispatcher is at rest.
fn rests(world: &World) -> bool {
    world.bench.tokens("arm_free") == 1
}

const PUSH: &[&str] = &["0.5,-0.2", "0.5,0.1"];

fn is_pushed(world: &World) -> bool {
    world.face.is_some_and(|face| (face - 0.3).abs() < 1e-6)
}

#[test]
fn a_thing_is_felt_pushed_to_the_end_of_the_way_and_left_and_the_arm_is_stiff_again() {
    let world = run(World::default(), PUSH);
    let (symbol, text) = &world.bench.answers[0];
    assert_eq!(symbol, "pushed_it", "{text}");
    assert_eq!(text, "felt at 50 mm of the way, pushed 250 mm from there");
    assert!(is_pushed(&world) && !world.misused && !world.bench.reserved && rests(&world));
}

#[test]
fn a_thing_that_slips_away_is_felt_for_again_a_few_times() {
    let slippery = World {
        slips: vec![0.12, 0.2],
        ..World::default()
    };
    let world = run(slippery, PUSH);
    let (symbol, text) = &world.bench.answers[0];
    assert_eq!(symbol, "pushed_it", "{text}");
    assert!(text.contains("felt for again 2 times"), "{text}");
    assert!(is_pushed(&world));
    let worse = World {
        slips: vec![0.12, 0.2, 0.25],
        ..World::default()
    };
    let world = run(worse, PUSH);
    let (symbol, text) = &world.bench.answers[0];
    assert_eq!(symbol, "not_pushed", "{text}");
    assert!(text.contains("push: contact"), "{text}");
    assert!(rests(&world) && !world.bench.reserved);
}

#[test]
fn a_thing_that_meets_a_wall_or_is_not_there_is_told_with_how_far_it_was_pushed() {
    let walled = World {
        wall: Some(0.15),
        ..World::default()
    };
    let world = run(walled, PUSH);
    let (symbol, text) = &world.bench.answers[0];
    assert_eq!(symbol, "not_pushed");
    assert!(
        text.contains("pushed 100 mm") && text.contains("push: blocked"),
        "{text}"
    );
    assert!(!world.misused);
    let empty = World {
        face: None,
        ..World::default()
    };
    let world = run(empty, PUSH);
    let (symbol, text) = &world.bench.answers[0];
    assert_eq!(symbol, "not_pushed");
    assert!(text.contains("nothing was felt"), "{text}");
}

#[test]
fn whatever_goes_wrong_at_any_one_request_the_answer_is_true() {
    let world = || World {
        slips: vec![0.12],
        ..World::default()
    };
    let requests = run(world(), PUSH).bench.asked.len();
    assert!(requests > 30, "{requests}");
    for number in 0..requests {
        for fault in faults_at(number, 1) {
            let mut faulty = world();
            faulty.bench.faults = vec![(number, fault)];
            let world = run(faulty, PUSH);
            let (symbol, text) = &world.bench.answers[0];
            let case = format!(
                "{fault:?} at {number}, {}: {symbol}: {text}; {:?}",
                world.bench.asked[number], world.face
            );
            assert!(rests(&world), "no rest: {case}");
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
        let world = run(World::default(), arguments);
        let (symbol, text) = &world.bench.answers[0];
        assert_eq!(symbol, "not_pushed");
        assert!(!text.is_empty() && world.bench.asked.is_empty());
    }
}

#[test]
fn why_a_thing_was_not_pushed_is_told_by_types_to_who_sent_the_command() {
    let why = |world: World, command: &str| {
        let app = bench::planned(&app(), command, "");
        bench::kinds(&bench::run_planned(world, &app).1)
    };
    let told = |kind: &str| ("not_pushed".to_owned(), vec![kind.to_owned()]);
    let nothing = World {
        face: None,
        ..World::default()
    };
    let walled = World {
        wall: Some(0.15),
        ..World::default()
    };
    assert_eq!(why(nothing, "push 0.5,-0.2 0.5,0.1"), told("absent"));
    assert_eq!(why(walled, "push 0.5,-0.2 0.5,0.1"), told("guard"));
    assert_eq!(why(World::default(), "push 0.5,-0.2"), told("refused"));
}
