//! A person in the app of carry.toml, in virtual time: puts things elsewhere, covers cameras, asks for carries, and looks at what comes
//! of it.

use std::{
    collections::BTreeMap,
    sync::{Arc, Mutex},
    time::Duration,
};

use ctos::{
    boot::{self, End, Launcher},
    config::{self, App},
    message::Message,
    registry::Registry,
    system::AppResult,
    task::{Context, EventHandler, Handled, HandlerError, Phase},
};
use mcs::client::{EmergencyStop, Manipulator, MotionError, Move, PathKind, Resume, Stop, Target};
use mcs_hand::command::ReadTouch;
use nalgebra::{Isometry3, Vector3};
use pnt::task::{Marking, PutTape};
use sim::{
    scene::{CameraFault, SceneState},
    world_task::{FailCamera, GetScene, PlaceBody},
};
use vss::{
    camera::Camera,
    command::{Snap, TrueCameras},
    frame::Frame,
    tool::fetched,
};

use crate::harness::Scratch;

/// What a person does, and asks for.
#[derive(Clone)]
pub(super) enum Step {
    /// Puts a body elsewhere.
    Put(&'static str, Isometry3<f64>),
    /// Does so later, while something else is done.
    Later(Duration, &'static str, Isometry3<f64>),
    /// Covers a camera, or has it otherwise fail, or be well again.
    Camera(&'static str, Option<CameraFault>),
    /// Asks for a carry and waits for the answer.
    Carry(String),
    /// Looks from now on what the pointer does.
    Watch,
    /// Looks from now on where board, disc and hand are.
    Trace,
    /// Does something to cameras or arm later, while something else is done.
    After(Duration, Deed),
    /// Waits.
    Rest(Duration),
    /// Moves the tool straight to a pose, with guards besides those that always watch, and gives the arm back.
    Move(Isometry3<f64>, &'static [&'static str]),
}

/// What a person does beside the robot.
#[derive(Debug, Clone, Copy)]
pub(super) enum Deed {
    Camera(&'static str, Option<CameraFault>),
    Stop,
    Resume,
    EmergencyStop,
}

/// Where things truly are at a moment.
#[derive(Debug, Clone)]
pub(super) struct Moment {
    pub(super) at: Duration,
    pub(super) board: Isometry3<f64>,
    pub(super) disc: Isometry3<f64>,
    pub(super) hand: Isometry3<f64>,
}

/// What a camera saw when the pointer was lit, or out.
pub(super) struct Picture {
    pub(super) lit: bool,
    pub(super) frame: Frame,
    pub(super) camera: Camera,
    /// Where the disc truly was.
    pub(super) disc: Isometry3<f64>,
}

pub(super) type Pictures = Arc<Mutex<Vec<Picture>>>;

/// How often it is looked whether the pointer is lit.
pub(super) const LOOK: Duration = Duration::from_millis(50);

/// Takes a picture each time when the pointer was lit or went out.
pub(super) async fn watch(cx: &Context, pictures: &Pictures) -> Result<(), HandlerError> {
    let world = cx.task("world").await?;
    let snap = cx.task("toolSnap").await?;
    let truths = cx.call(&world, TrueCameras {}).await?;
    let left = truths.into_iter().find(|truth| truth.name == "left");
    let camera = left.ok_or("no camera")?.camera;
    let mut before = false;
    while !cx.is_stopping() {
        let scene = cx.call(&world, GetScene {}).await?;
        let lit = !scene.beams.is_empty();
        if lit != before {
            let left = "left".to_owned();
            let frame = cx.call(&snap, Snap { camera: left }).await?;
            let frame = frame.and_then(|frame| fetched(cx, frame));
            pictures.lock().unwrap().push(Picture {
                lit,
                frame: frame.map_err(|error| error.reason)?,
                camera,
                disc: scene.body("disc").ok_or("no disc")?.pose,
            });
            before = lit;
        }
        cx.sleep(LOOK).await;
    }
    Ok(())
}

/// Notes where things are, until the app stops.
pub(super) async fn trace(cx: &Context, moments: &Mutex<Vec<Moment>>) -> Result<(), HandlerError> {
    let world = cx.task("world").await?;
    while !cx.is_stopping() {
        let scene = cx.call(&world, GetScene {}).await?;
        let pose = |name: &str| scene.body(name).map(|body| body.pose).ok_or("no body");
        let moment = Moment {
            at: cx.now().since_start(),
            board: pose("board")?,
            disc: pose("disc")?,
            hand: pose("puma.gripper.palm")?,
        };
        moments.lock().unwrap().push(moment);
        cx.sleep(LOOK).await;
    }
    Ok(())
}

/// Does something beside the robot; when that was done.
pub(super) async fn does(cx: &Context, deed: Deed) -> Result<(), HandlerError> {
    let mcs = cx.task("mcs").await?;
    match deed {
        Deed::Camera(camera, fault) => {
            let (world, camera) = (cx.task("world").await?, camera.to_owned());
            cx.call(&world, FailCamera { camera, fault }).await?;
        }
        Deed::Stop => cx.call(&mcs, Stop {}).await?,
        Deed::Resume => cx.call(&mcs, Resume {}).await?,
        Deed::EmergencyStop => cx.call(&mcs, EmergencyStop {}).await?,
    }
    Ok(())
}

/// An answer, and where board and disc are then.
#[derive(Debug)]
pub(super) struct Answer {
    pub(super) symbol: String,
    pub(super) text: String,
    pub(super) board: Isometry3<f64>,
    pub(super) disc: Isometry3<f64>,
}

pub(super) type Answers = Arc<Mutex<Vec<Answer>>>;

/// How hard anything pressed on each link of the arm at most, N.
pub(super) type Touches = Arc<Mutex<BTreeMap<String, f64>>>;

/// Feels in every period of the servo what presses on the arm.
pub(super) async fn feel(cx: &Context, touches: &Touches) -> Result<(), HandlerError> {
    let world = cx.task("world").await?;
    while !cx.is_stopping() {
        for touch in cx.call(&world, ReadTouch { arm: None }).await? {
            let force = Vector3::from(touch.force_n).norm();
            let mut touches = touches.lock().unwrap();
            let most = touches.entry(touch.link).or_default();
            *most = most.max(force);
        }
        cx.sleep(Duration::from_micros(4500)).await;
    }
    Ok(())
}

/// Moves the tool straight to a pose; how that ended.
pub(super) async fn go(
    cx: &Context,
    to: &Isometry3<f64>,
    guards: &[&str],
) -> Result<(), MotionError> {
    let arm = Manipulator::find(cx, "mcs").await?;
    arm.acquire().await?;
    let mut rows = [0.0; 16];
    rows.copy_from_slice(to.to_homogeneous().transpose().as_slice());
    let order = Move {
        target: Target::Pose(rows),
        path: PathKind::StraightLine,
        speed: 0.3,
        acceleration: None,
        elbow: None,
        guards: guards.iter().map(ToString::to_string).collect(),
        blend: 0.0.into(),
    };
    let gone = arm.go(order, Duration::from_secs(60)).await;
    arm.release().await?;
    gone.map(|_| ())
}

/// What a person has seen.
#[derive(Default, Clone)]
pub(super) struct Seen {
    pub(super) answers: Answers,
    pub(super) pictures: Pictures,
    pub(super) touches: Touches,
    pub(super) moments: Arc<Mutex<Vec<Moment>>>,
    /// What was done beside the robot, and when.
    pub(super) deeds: Arc<Mutex<Vec<(Duration, Deed)>>>,
    /// When each answer came.
    pub(super) answered: Arc<Mutex<Vec<Duration>>>,
    /// Tokens of the Dispatcher's `hand_full` after the latest answer.
    pub(super) hand_full: Arc<Mutex<u32>>,
}

pub(super) struct Person {
    pub(super) steps: Vec<Step>,
    pub(super) seen: Seen,
}

impl EventHandler for Person {
    async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
        cx.default_processing(message)
    }

    async fn phase(&mut self, cx: &Context, phase: Phase) -> Handled {
        if phase == Phase::Run {
            let (child, steps, seen) = (cx.clone(), self.steps.clone(), self.seen.clone());
            let (feeling, touches) = (cx.clone(), seen.touches.clone());
            cx.spawn(async move {
                // What was not felt, the test misses.
                let _ = feel(&feeling, &touches).await;
            });
            cx.spawn(async move {
                let done = act(&child, steps, &seen).await;
                child.finish(AppResult {
                    ok: done.is_ok(),
                    text: done
                        .err()
                        .map_or_else(String::new, |error| error.to_string()),
                    json: "{}".to_owned(),
                });
            });
        }
        Ok(())
    }
}

pub(super) async fn act(cx: &Context, steps: Vec<Step>, seen: &Seen) -> Result<(), HandlerError> {
    let Seen {
        answers, pictures, ..
    } = seen;
    let answered = |symbol: String, text: String, scene: &SceneState| -> Result<(), HandlerError> {
        let pose = |name: &str| scene.body(name).map(|body| body.pose);
        answers.lock().unwrap().push(Answer {
            symbol,
            text,
            board: pose("board").ok_or("no board")?,
            disc: pose("disc").ok_or("no disc")?,
        });
        Ok(())
    };
    let world = cx.task("world").await?;
    let dispatcher = cx.task("dispatcher").await?;
    for step in steps {
        match step {
            Step::Put(body, pose) => {
                let body = body.to_owned();
                cx.call(&world, PlaceBody { body, pose }).await?;
            }
            Step::Later(after, body, pose) => {
                let (child, world, body) = (cx.clone(), world.clone(), body.to_owned());
                cx.spawn(async move {
                    child.sleep(after).await;
                    // Whether it was put there shows in where it is.
                    let _ = child.call(&world, PlaceBody { body, pose }).await;
                });
            }
            Step::Camera(camera, fault) => {
                let camera = camera.to_owned();
                cx.call(&world, FailCamera { camera, fault }).await?;
            }
            Step::Watch => {
                let (child, pictures) = (cx.clone(), pictures.clone());
                cx.spawn(async move {
                    // What was not seen, the test misses.
                    let _ = watch(&child, &pictures).await;
                });
            }
            Step::Trace => {
                let (child, moments) = (cx.clone(), seen.moments.clone());
                cx.spawn(async move {
                    // What was not seen, the test misses.
                    let _ = trace(&child, &moments).await;
                });
            }
            Step::After(after, deed) => {
                let (child, deeds) = (cx.clone(), seen.deeds.clone());
                cx.spawn(async move {
                    child.sleep(after).await;
                    let begun = child.now().since_start();
                    if does(&child, deed).await.is_ok() {
                        // A stop holds when it was answered, and one is over when somebody begins to end it.
                        let at = match deed {
                            Deed::Resume => begun,
                            _ => child.now().since_start(),
                        };
                        deeds.lock().unwrap().push((at, deed));
                    }
                });
            }
            Step::Rest(time) => cx.sleep(time).await,
            Step::Carry(line) => {
                // What was put somewhere comes to rest.
                cx.sleep(Duration::from_millis(500)).await;
                let put = PutTape {
                    symbol: "carry".to_owned(),
                    arguments: line.split_whitespace().map(ToOwned::to_owned).collect(),
                };
                let answer = cx.call(&dispatcher, put);
                let answer = answer.deadline(Duration::from_secs(600)).await?;
                let scene = cx.call(&world, GetScene {}).await?;
                let marking = cx.call(&dispatcher, Marking {}).await?;
                let places = marking.places.iter();
                let full = places.filter(|(place, _)| place == "hand_full");
                *seen.hand_full.lock().unwrap() = full.map(|(_, tokens)| *tokens).sum();
                seen.answered.lock().unwrap().push(cx.now().since_start());
                answered(answer.symbol, answer.text, &scene)?;
            }
            Step::Move(to, guards) => {
                let gone = go(cx, &to, guards).await;
                let ended = gone.map_or_else(
                    |error| (format!("{:?}", error.outcome), error.reason),
                    |()| ("moved".to_owned(), String::new()),
                );
                let scene = cx.call(&world, GetScene {}).await?;
                answered(ended.0, ended.1, &scene)?;
            }
        }
    }
    Ok(())
}

/// The app of carry.toml with a person in place of the operator, in virtual time.
pub(super) const PERSON: &str = r#"
[app]
name = "carry"
until = "person"
[time]
mode = "virtual"
[task.operator.args]
waits = true
[task.person]
handler = "test.person"
on = "ws1/main"
"#;

/// The answers to what a person asks for, in the app of carry.toml in virtual time.
pub(super) fn answers(steps: Vec<Step>) -> Vec<Answer> {
    let seen = seen_in(&Scratch::new(), "", steps);
    std::mem::take(&mut *seen.answers.lock().unwrap())
}

/// What a person sees in the app of a folder's carry.toml, with more lines of configuration.
pub(super) fn seen_in(scratch: &Scratch, more: &str, steps: Vec<Step>) -> Seen {
    seen_by("carry.toml", scratch, more, steps)
}

/// The app with a person in it, and what that person sees.
pub(super) fn prepared(
    app: &str,
    scratch: &Scratch,
    more: &str,
    steps: Vec<Step>,
) -> (App, Registry, Seen) {
    let text = format!("include = [\"{app}\"]\n{PERSON}{more}");
    scratch.write("configs/person.toml", text);
    let file = scratch.path("configs/person.toml");
    let expanders = cli::program::EXPANDERS;
    let app = config::load(&file, &[], &expanders).unwrap_or_else(|found| panic!("{found}"));
    let mut registry = cli::program::registry();
    let seen = Seen::default();
    let shared = seen.clone();
    registry.handler("test.person", &[], move |_| {
        Ok(Person {
            steps: steps.clone(),
            seen: shared.clone(),
        })
    });
    (app, registry, seen)
}

pub(super) fn seen_by(app: &str, scratch: &Scratch, more: &str, steps: Vec<Step>) -> Seen {
    let (app, registry, seen) = prepared(app, scratch, more, steps);
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
    seen
}
