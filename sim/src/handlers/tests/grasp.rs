//! The app of `configs/grasp.toml` in virtual time: its arm picks the box up with the gripper, and places it elsewhere.

use ctos::config::{Expander, Selection};
use futures_util::future::LocalBoxFuture;
use mcs::{
    client::{Move, Target},
    control::LawRegistry,
    partition::McsExpander,
};
use mcs_hand::command::{Grasp, Held, Open, ReadHeld, SwitchOff};
use nalgebra::Vector3;

use super::*;

/// Where the box stands at the start and in the end, m.
const FROM: [f64; 3] = [0.5, -0.1, 0.43];
const TO: [f64; 3] = [0.5, 0.15, 0.43];
/// So far above it the gripper comes and goes.
pub const ABOVE: f64 = 0.12;

/// What became of a step: what the gripper says, and where the box is.
#[derive(Debug, Clone, Copy)]
struct Step {
    held: Held,
    at: Vector3<f64>,
}

type Log<T> = Arc<Mutex<Vec<T>>>;
type Job<T> = fn(Context, Log<T>) -> LocalBoxFuture<'static, ()>;

/// Does a job and ends the app.
struct Worker<T>(Job<T>, Log<T>);

/// The gripper straight down, the middle between its pads at a place.
pub fn down([x, y, z]: [f64; 3], up: f64) -> Target {
    let z = z + up;
    Target::Pose([
        1.0, 0.0, 0.0, x, 0.0, -1.0, 0.0, y, 0.0, 0.0, -1.0, z, 0.0, 0.0, 0.0, 1.0,
    ])
}

/// Moves the tip of the arm.
pub async fn go(arm: &Manipulator, target: Target, path: PathKind) {
    let to = Move {
        target,
        path,
        speed: 0.5,
        acceleration: None,
        elbow: None,
        blend: 0.0,
        guards: Vec::new(),
    };
    arm.go(to, Duration::from_secs(60)).await.unwrap();
}

async fn pick_and_place(cx: Context, steps: Log<(&'static str, Step)>) {
    let gripper = cx.task("gripper").await.unwrap();
    let world = cx.task("world").await.unwrap();
    let arm = Manipulator::find(&cx, "mcs").await.unwrap();
    let note = async |name: &'static str, held: Held| {
        let scene = cx.call(&world, GetScene {}).await.unwrap();
        let at = scene.body("box").unwrap().pose.translation.vector;
        steps.lock().unwrap().push((name, Step { held, at }));
    };
    let open = async |width: f64| {
        let order = Open {
            width_m: Some(width),
            speed: 1.0,
        };
        cx.call(&gripper, order).await.unwrap().unwrap()
    };
    let holds = async || cx.call(&gripper, ReadHeld {}).await.unwrap().unwrap();
    arm.acquire().await.unwrap();
    note("open", open(0.08).await).await;
    go(&arm, down(FROM, ABOVE), PathKind::Joint).await;
    go(&arm, down(FROM, 0.0), PathKind::StraightLine).await;
    let order = Grasp {
        force_n: Some(15.0),
        speed: 0.5,
    };
    let grasped = cx.call(&gripper, order).await.unwrap().unwrap();
    note("grasped", grasped).await;
    go(&arm, down(FROM, ABOVE), PathKind::StraightLine).await;
    note("lifted", holds().await).await;
    cx.sleep(Duration::from_secs(5)).await;
    note("held", holds().await).await;
    go(&arm, down(TO, ABOVE), PathKind::StraightLine).await;
    note("carried", holds().await).await;
    go(&arm, down(TO, 0.001), PathKind::StraightLine).await;
    note("let go", open(0.08).await).await;
    go(&arm, down(TO, ABOVE), PathKind::StraightLine).await;
    note("placed", holds().await).await;
    // Nothing is there any more.
    let order = Grasp {
        force_n: None,
        speed: 1.0,
    };
    let empty = cx.call(&gripper, order).await.unwrap().unwrap();
    note("empty", empty).await;
    cx.call(&gripper, SwitchOff {}).await.unwrap().unwrap();
    arm.release().await.unwrap();
}

impl<T: 'static> EventHandler for Worker<T> {
    async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
        cx.default_processing(message)
    }

    async fn phase(&mut self, cx: &Context, phase: Phase) -> Handled {
        if phase == Phase::Run {
            let (own, job) = (cx.clone(), self.0(cx.clone(), Arc::clone(&self.1)));
            cx.spawn(async move {
                job.await;
                own.finish(AppResult {
                    ok: true,
                    text: String::new(),
                    json: String::new(),
                });
            });
        }
        Ok(())
    }
}

/// Runs the app of `configs/NAME.toml` in virtual time, its cell changed so, without its service objects, with a job.
pub fn run_app<T: Clone + Send + 'static>(
    name: &str,
    (from, to): (&str, &str),
    job: Job<T>,
) -> Vec<T> {
    let configs = Path::new(env!("CARGO_MANIFEST_DIR")).join("../configs");
    let folder = tempfile::tempdir().unwrap();
    let read = |file: &str| std::fs::read_to_string(configs.join(file)).unwrap();
    let write = |file: &str, text: String| std::fs::write(folder.path().join(file), text).unwrap();
    let text = read(&format!("{name}.toml"));
    let (text, _) = text.split_once("# -- Service objects").unwrap();
    let text = text.replace("mode = \"real\"", "mode = \"virtual\"");
    let text = text.replace("seed = 1\n", "seed = 1\nuntil = \"worker\"\n");
    let worker = "[task.worker]\nhandler = \"test.worker\"\non = \"cage/main\"\n";
    write("app.toml", text + worker);
    let cell = format!("{name}-cell.toml");
    let text = read(&cell);
    assert!(text.contains(from), "{from}");
    write(&cell, text.replace(from, to));
    std::fs::create_dir(folder.path().join("models")).unwrap();
    for model in [
        "puma560",
        "puma560_carrying_gripper",
        "puma560_carrying_hand",
        "testbed18_carrying_grippers",
        "transporter",
    ] {
        let file = format!("models/{model}.toml");
        write(&file, read(&file));
    }
    let app = Selection::new(folder.path().join("app.toml"));
    let expanders: [(&str, &dyn Expander); 1] = [("mcs", &McsExpander)];
    let app = app
        .load(&expanders)
        .unwrap_or_else(|found| panic!("{found}"));
    let log = Log::<T>::default();
    let (mut registry, mut laws) = (Registry::new(), LawRegistry::new());
    let (mut drivers, mut sources) = (DriverRegistry::new(), FrameSources::new());
    register(&mut registry, &mut drivers, &mut sources);
    mcs_hand::register(&mut registry, &mut laws);
    mcs::register(
        &mut registry,
        drivers,
        laws,
        mcs::guard::GuardRegistry::new(),
    );
    let shared = Arc::clone(&log);
    registry.handler("test.worker", &[], move |_| {
        Ok(Worker(job, Arc::clone(&shared)))
    });
    let findings = registry.check(&app);
    assert!(!findings.has_errors(), "{findings}");
    let observer: boot::Observer = Arc::new(|_: &boot::BootEvent| {});
    let outcome = boot::boot(app, registry, &launcher(), &observer).unwrap();
    assert!(matches!(outcome.end, End::Finished(_)), "{:?}", outcome.end);
    let log = log.lock().unwrap();
    log.clone()
}

/// What became of each step with a box of so much, kg.
fn run(mass: &str) -> Vec<(&'static str, Step)> {
    let mass = format!("mass = {mass}");
    run_app("grasp", ("mass = 0.5", mass.as_str()), |cx, steps| {
        Box::pin(pick_and_place(cx, steps))
    })
}

fn step(steps: &[(&'static str, Step)], name: &str) -> Step {
    let (_, step) = steps.iter().find(|(known, _)| *known == name).unwrap();
    *step
}

#[test]
fn an_arm_with_a_gripper_picks_a_box_up_holds_it_and_places_it_where_it_shall_be() {
    let steps = run("0.5");
    let place = |name: &str| step(&steps, name).at;
    let holding = ["grasped", "lifted", "held", "carried"];
    for (name, Step { held, .. }) in &steps {
        assert_eq!(held.holds, holding.contains(name), "{name}");
        if held.holds {
            assert!((held.width_m - 0.04).abs() < 1e-3, "{name}: {held:?}");
        }
    }
    assert!((place("lifted").z - FROM[2] - ABOVE).abs() < 2e-3);
    let slipped = (place("held") - place("lifted")).norm();
    assert!(slipped < 1e-3, "{slipped} m in 5 s");
    let off = place("placed") - Vector3::from(TO);
    assert!(off.norm() < 3e-3, "{off}");
    assert!(step(&steps, "empty").held.width_m < 1e-3);
}

#[test]
fn a_gripper_whose_box_is_too_heavy_says_that_it_holds_nothing_when_it_is_lifted() {
    // Friction carries 2 x 0.8 x 15 N, which is 2.4 kg.
    let steps = run("3.5");
    assert!(step(&steps, "grasped").held.holds);
    assert!(!step(&steps, "lifted").held.holds);
    let off = step(&steps, "placed").at - Vector3::from(FROM);
    assert!(off.z.abs() < 2e-3, "{off}");
}
