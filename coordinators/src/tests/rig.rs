//! For tests: the Coordination Level with its real nets in virtual time, over three chassis, between
//! stand-ins for the client interface of MCS, the Services Manager of VSS and the world, which can fail
//! on demand.

mod stand_ins;

use std::{
    collections::BTreeMap,
    path::{Path, PathBuf},
    sync::{Arc, Mutex, MutexGuard},
    time::Duration,
};

use ctos::{
    boot::{self, BootEvent, End, Launcher},
    config::{self, App},
    message::{Command, Message},
    registry::Registry,
    system::AppResult,
    task::{Context, EventHandler, Handled, Phase},
};
use mcs::client::{Acquire, Cancel, Move, Plan, ReadPosition, Release, Status};
use nalgebra::{Point3, Rotation3, UnitQuaternion, Vector3};
use pnt::task::{Marking, PutTape, Snapshot, TapeAnswer};
use rand_chacha::{ChaCha8Rng, rand_core::SeedableRng};
use serde::de::DeserializeOwned;
use vss::{
    calibrate::{Calibration, LightPoint, calibrate},
    camera::{Camera, Distortion, Intrinsics},
    command::{Calibrate, SpotFind, SpotReport, TrueCameras},
    spot::SpotFlags,
};

use crate::{
    dom::{Dom, GetData, ListData, PutData},
    outcome::Outcome,
};
use stand_ins::{FaultyDom, Lamp, Mcs, StandIn, Vsm};

ctos::command! {
    /// As the simulated world has it.
    #[derive(Debug, Clone)]
    pub struct SetLamp { pub on: bool } => (), 0x0501, "set_lamp"
}

/// How a stand-in answers.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Answer {
    /// As it should.
    Work,
    /// With a refusal; what has outcomes, with its usual one.
    Refuse,
    /// With this outcome.
    Meet(Outcome),
    /// As it should, after which nobody has the manipulator reserved.
    Taken,
    /// Not at all.
    Silent,
    /// Not at all, having done the work.
    Lost,
    /// Long after everybody's patience.
    Late,
    /// With a panic.
    Crash,
}

/// What a stand-in is asked: command, a detail of it (camera, lamp on or off, elbow), and how often this
/// command with this detail was asked before.
pub(crate) type Script = Arc<dyn Fn(&str, &str, usize) -> Answer + Send + Sync>;

/// An app to run.
pub(crate) struct Rig {
    pub positions: String,
    pub script: Script,
    pub seed: u64,
    /// Commands on the Dispatcher's tape, one after the other.
    pub commands: usize,
    pub results: Option<PathBuf>,
    /// Arguments of each command.
    pub arguments: Vec<&'static str>,
    /// When somebody ends a protective stop, s.
    pub resume_at_s: Option<f64>,
    /// Objects put into the DOM beforehand.
    pub given: Vec<(&'static str, Vec<u8>)>,
}

impl Default for Rig {
    fn default() -> Self {
        Self {
            positions: positions(16),
            script: Arc::new(|_, _, _| Answer::Work),
            seed: 1,
            commands: 1,
            results: None,
            arguments: Vec::new(),
            resume_at_s: None,
            given: Vec::new(),
        }
    }
}

/// A file of positions that fill space, `count` of them from line 3.
pub(crate) fn positions(count: usize) -> String {
    let mut text = "# positions\nx,y,z,roll,pitch,yaw\n".to_owned();
    for n in 0..count {
        let at = |n: usize| (n % 4) as f64 * 0.3 - 0.45;
        let z = 0.4 + 0.9 * ((n * 7 % 11) as f64 / 11.0);
        text += &format!("{},{},{z},0,0,0\n", at(n), at(n / 4));
    }
    text
}

/// What the stand-ins share.
#[derive(Default)]
pub(crate) struct World {
    pub lamp_on: bool,
    pub reserved: bool,
    /// A protective stop holds,
    pub stopped: bool,
    /// and somebody resumes then, s.
    pub resume_at_s: Option<f64>,
    /// `base_t_tool`.
    pub pose: [f64; 16],
    planned: Vec<[f64; 16]>,
    asked: BTreeMap<(String, String), usize>,
    /// Command, detail, begin and end, s.
    pub log: Vec<(String, String, f64, f64)>,
    pub progress: Vec<String>,
    before: Vec<Snapshot>,
    after: Vec<Snapshot>,
    answers: Vec<Result<TapeAnswer, String>>,
    objects: BTreeMap<String, Vec<u8>>,
}

pub(crate) type Shared = Arc<Mutex<World>>;

pub(crate) fn lock(world: &Shared) -> MutexGuard<'_, World> {
    world
        .lock()
        .unwrap_or_else(std::sync::PoisonError::into_inner)
}

/// What is left of a run.
pub(crate) struct Run {
    pub end: End,
    pub answers: Vec<Result<TapeAnswer, String>>,
    pub world: Shared,
    pub before: Vec<Snapshot>,
    pub after: Vec<Snapshot>,
    objects: BTreeMap<String, Vec<u8>>,
}

impl Run {
    /// The answer to the last command: symbol and text, or why there was none.
    pub(crate) fn answer(&self) -> (String, String) {
        match self.answers.last() {
            Some(Ok(answer)) => (answer.symbol.clone(), answer.text.clone()),
            Some(Err(error)) => ("none".to_owned(), error.clone()),
            None => ("none".to_owned(), format!("{:?}", self.end)),
        }
    }

    pub(crate) fn object<T: DeserializeOwned>(&self, name: &str) -> Option<T> {
        let bytes = self.objects.get(name)?;
        Some(postcard::from_bytes(bytes).unwrap())
    }

    /// How often a stand-in did a command with this detail.
    pub(crate) fn done(&self, command: &str, detail: &str) -> usize {
        let world = lock(&self.world);
        let same = |entry: &&(String, String, f64, f64)| entry.0 == command && entry.1 == detail;
        world.log.iter().filter(same).count()
    }

    /// How often a stand-in was asked for a command with this detail.
    pub(crate) fn asked(&self, command: &str, detail: &str) -> usize {
        let key = (command.to_owned(), detail.to_owned());
        lock(&self.world).asked.get(&key).copied().unwrap_or(0)
    }

    /// Names of a net's firings with their phases, oldest first.
    pub(crate) fn firings(&self, net: &str) -> Vec<String> {
        let snapshots = self.after.iter().filter(|snapshot| snapshot.net == net);
        let events = snapshots.flat_map(|snapshot| &snapshot.events);
        events
            .map(|event| format!("{} {}", event.transition, event.phase))
            .collect()
    }
}

pub(crate) const NETS: [&str; 3] = ["dispatcher", "motion", "vision"];

/// The folder of the nets that the app is delivered with.
pub(crate) fn nets() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../configs/nets")
}

pub(crate) fn app_text(rig: &Rig, folder: &Path) -> String {
    std::fs::write(folder.join("positions.csv"), &rig.positions).unwrap();
    let results = rig.results.as_ref().map_or_else(String::new, |folder| {
        format!("results = {:?}\n", folder.display().to_string())
    });
    format!(
        r#"[app]
name = "test"
until = "operator"
seed = {}
[time]
mode = "virtual"
[chassis.ws1]
[chassis.cage_motion]
[chassis.cage_vision]
[task.operator]
handler = "test.operator"
on = "ws1"
[task.dom]
handler = "test.dom"
on = "ws1"
[task.dispatcher]
handler = "coordinators.dispatcher"
on = "ws1"
[task.dispatcher.args]
net = "{nets}/dispatcher.net"
positions = "positions.csv"
{results}
[task.motion]
handler = "coordinators.motion"
on = "ws1"
args.net = "{nets}/motion.net"
[task.vision]
handler = "coordinators.vision"
on = "ws1"
[task.vision.args]
net = "{nets}/vision.net"
cameras = ["west", "east"]
retries = 2
[task.mcs]
handler = "test.mcs"
on = "cage_motion"
[task.world]
handler = "test.world"
on = "cage_motion"
[task.vsm]
handler = "test.vsm"
on = "cage_vision"
"#,
        rig.seed,
        nets = nets().display()
    )
}

pub(crate) fn load(text: &str, folder: &Path) -> App {
    let file = folder.join("app.toml").display().to_string();
    config::load_texts(&[(&file, text)], &[], &[]).unwrap_or_else(|found| panic!("{found}"))
}

/// The Coordination Level and its stand-ins.
pub(crate) fn registry(rig: &Rig, world: &Shared) -> Registry {
    let mut registry = Registry::new();
    crate::register(&mut registry);
    let stand_in = || StandIn {
        world: world.clone(),
        script: rig.script.clone(),
    };
    let mcs = stand_in();
    let commands = [
        Acquire::INFO,
        Plan::INFO,
        Move::INFO,
        ReadPosition::INFO,
        Status::INFO,
        Cancel::INFO,
        Release::INFO,
    ];
    registry.handler("test.mcs", &commands, move |_| Ok(Mcs(mcs.clone())));
    let vsm = stand_in();
    let commands = [SpotFind::INFO, Calibrate::INFO];
    registry.handler("test.vsm", &commands, move |_| Ok(Vsm(vsm.clone())));
    let lamp = stand_in();
    let commands = [SetLamp::INFO, TrueCameras::INFO];
    registry.handler("test.world", &commands, move |_| Ok(Lamp(lamp.clone())));
    let dom = stand_in();
    registry.handler("test.dom", crate::dom::COMMANDS, move |_| {
        Ok(FaultyDom(dom.clone(), Dom::default()))
    });
    lock(world).resume_at_s = rig.resume_at_s;
    let (world, commands, given) = (world.clone(), rig.commands, rig.given.clone());
    let arguments: Vec<String> = rig.arguments.iter().map(ToString::to_string).collect();
    registry.handler("test.operator", &[], move |_| {
        Ok(Operator {
            world: world.clone(),
            commands,
            arguments: arguments.clone(),
            given: given.clone(),
        })
    });
    registry
}

pub(crate) fn boot(app: App, registry: Registry, world: &Shared) -> End {
    let launcher = Launcher {
        program: "none".into(),
        arguments: Vec::new(),
    };
    let seen = world.clone();
    let observer: boot::Observer = Arc::new(move |event| {
        if let BootEvent::Progress(progress) = event {
            lock(&seen).progress.push(progress.what.clone());
        }
    });
    boot::boot(app, registry, &launcher, &observer).unwrap().end
}

pub(crate) fn run(rig: &Rig) -> Run {
    let folder = tempfile::tempdir().unwrap();
    let world = Shared::default();
    let app = load(&app_text(rig, folder.path()), folder.path());
    let end = boot(app, registry(rig, &world), &world);
    let mut left = lock(&world);
    let (before, after) = (
        std::mem::take(&mut left.before),
        std::mem::take(&mut left.after),
    );
    let (answers, objects) = (
        std::mem::take(&mut left.answers),
        std::mem::take(&mut left.objects),
    );
    drop(left);
    Run {
        end,
        answers,
        world,
        before,
        after,
        objects,
    }
}

// -- the cameras ------------------------------------------------------------------------------------

/// A ceiling camera that looks at the work volume.
pub(crate) fn camera(centre: Point3<f64>) -> Camera {
    let view = Rotation3::face_towards(&(Point3::new(0.0, 0.0, 0.8) - centre), &-Vector3::y());
    Camera {
        rotation: UnitQuaternion::from_rotation_matrix(&view).inverse(),
        centre,
        intrinsics: Intrinsics {
            fx: 418.0,
            fy: 416.0,
            cx: 250.0,
            cy: 247.0,
        },
        distortion: Distortion::default(),
    }
}

fn cameras() -> [(&'static str, Camera); 2] {
    [
        ("west", camera(Point3::new(-0.5, 0.1, 2.9))),
        ("east", camera(Point3::new(0.5, -0.1, 2.8))),
    ]
}

pub(crate) fn spot(camera: &str, u: f64, v: f64) -> SpotReport {
    SpotReport {
        camera: camera.to_owned(),
        u,
        v,
        sd_u: 0.1,
        sd_v: 0.1,
        amplitude: 60.0,
        sigma: 1.3,
        area: 20,
        flags: SpotFlags::default(),
        stamp: Duration::ZERO,
        frame: 1,
        width: 500,
        height: 500,
    }
}

/// An estimate that stands on `used` spots; the rest of it is that of a real one.
pub(crate) fn calibration(estimate: Camera, used: usize) -> Calibration {
    let table: Vec<LightPoint> = (0..30)
        .map(|n| {
            let n = f64::from(n);
            let point = Point3::new((n * 0.7).sin() * 0.5, (n * 1.3).cos() * 0.5, 0.4 + n * 0.03);
            let pixel = estimate.project(&point).unwrap();
            let (u, v) = (
                pixel.x + 0.1 * (n * 2.1).sin(),
                pixel.y + 0.1 * (n * 3.7).cos(),
            );
            LightPoint {
                x: point.x,
                y: point.y,
                z: point.z,
                u,
                v,
            }
        })
        .collect();
    let mut calibration = calibrate(&table, 500, 500, &mut ChaCha8Rng::seed_from_u64(1)).unwrap();
    calibration.camera = estimate;
    calibration.used = used;
    calibration
}

/// Puts commands on the Dispatcher's tape; keeps the answers and how the nets and the DOM were before
/// and after.
struct Operator {
    world: Shared,
    commands: usize,
    arguments: Vec<String>,
    given: Vec<(&'static str, Vec<u8>)>,
}

impl EventHandler for Operator {
    async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
        cx.default_processing(message)
    }

    async fn phase(&mut self, cx: &Context, phase: Phase) -> Handled {
        if phase == Phase::Run {
            let (child, world) = (cx.clone(), self.world.clone());
            let (commands, given) = (self.commands, self.given.clone());
            let arguments = self.arguments.clone();
            cx.spawn(async move {
                let commands = vec![arguments; commands];
                let operated = operate(&child, &world, commands, given).await;
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

async fn operate(
    cx: &Context,
    world: &Shared,
    commands: Vec<Vec<String>>,
    given: Vec<(&'static str, Vec<u8>)>,
) -> Handled {
    let dispatcher = cx.task("dispatcher").await?;
    let dom = cx.task("dom").await?;
    for (name, bytes) in given {
        let name = name.to_owned();
        cx.call(&dom, PutData { name, bytes }).await?;
    }
    let before = snapshots(cx).await?;
    lock(world).before = before;
    for arguments in commands {
        let put = PutTape {
            symbol: "calibrate_camera".to_owned(),
            arguments,
        };
        let limit = Duration::from_secs(100_000);
        let answer = cx.call(&dispatcher, put).deadline(limit).await;
        lock(world)
            .answers
            .push(answer.map_err(|error| error.to_string()));
    }
    // The last tokens may still be on their way between chassis.
    cx.sleep(Duration::from_secs(1)).await;
    let after = snapshots(cx).await?;
    lock(world).after = after;
    for object in cx.call(&dom, ListData {}).await? {
        if object.bytes.is_some() {
            let name = object.name.clone();
            let bytes = cx.call(&dom, GetData { name }).await?;
            lock(world).objects.insert(object.name, bytes);
        }
    }
    Ok(())
}

async fn snapshots(cx: &Context) -> Result<Vec<Snapshot>, ctos::task::HandlerError> {
    let mut all = Vec::new();
    for net in NETS {
        let net = cx.task(net).await?;
        all.push(cx.call(&net, Marking {}).await?);
    }
    Ok(all)
}
