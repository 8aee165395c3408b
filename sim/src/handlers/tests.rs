mod bar;
mod grasp;
mod guide;
mod hand;
mod two_arms;

use std::{
    cell::RefCell,
    sync::{Arc, Mutex},
    time::Duration,
};

use ctos::{
    boot::{self, End, Launcher},
    config::load_texts,
    message::Message,
    sync::{Cyclic, CyclicHandle, Tick},
    system::AppResult,
    task::{EventHandler, Handled, Phase},
};
use mcs::{
    client::{Manipulator, PathKind},
    driver::{Power, SlotReading},
};
use vss::{
    command::{NamedCamera, TrueCameras},
    frame::Frame,
};

use super::*;
use crate::world_task::{GetScene, SetLamp, SwitchLamp};

const CELL: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../configs/cell.toml");
const PERIOD: Duration = Duration::from_micros(4500);

/// Turns joint 1 for ever, as a servo would.
struct Servo {
    driver: RefCell<Option<Box<dyn ChannelDriver>>>,
    cycle: Option<CyclicHandle>,
}

struct Turn(Box<dyn ChannelDriver>);

impl Cyclic for Turn {
    fn tick(&mut self, _: &Tick) {
        self.0.read(&mut [SlotReading::default(); 6]).unwrap();
        let torques = [40.0, 30.0, 5.0, 0.0, 0.0, 0.0];
        self.0.write(&torques, Power::Released, PERIOD).unwrap();
    }
}

impl EventHandler for Servo {
    async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
        cx.default_processing(message)
    }

    async fn phase(&mut self, cx: &Context, phase: Phase) -> Handled {
        if phase == Phase::Run
            && let Some(driver) = self.driver.take()
        {
            self.cycle = Some(cx.cyclic(PERIOD, Turn(driver)));
        }
        Ok(())
    }
}

/// What the eye saw, for the test's own thread.
#[derive(Debug, Clone, Default, PartialEq)]
struct Seen {
    frames: Vec<Frame>,
    /// When each frame was asked for, and when it came.
    asked: Vec<[Duration; 2]>,
    /// Stamp and tick of the scene just after each frame.
    scenes: Vec<(Duration, u64)>,
    lamps: Vec<bool>,
    truths: Vec<NamedCamera>,
    lamp_moved: f64,
    no_such_lamp: String,
}

struct Eye {
    camera: Option<SimCamera>,
    seen: Arc<Mutex<Seen>>,
}

impl EventHandler for Eye {
    async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
        cx.default_processing(message)
    }

    async fn phase(&mut self, cx: &Context, phase: Phase) -> Handled {
        if phase != Phase::Run {
            return Ok(());
        }
        let Some(mut camera) = self.camera.take() else {
            return Ok(());
        };
        let (child, seen) = (cx.clone(), self.seen.clone());
        cx.spawn(async move {
            let world = child.task("world").await.unwrap();
            let first = child.call(&world, GetScene {}).await.unwrap();
            let mut all = Seen::default();
            for on in [true, false] {
                if on {
                    child.call(&world, SetLamp { on }).await.unwrap();
                } else {
                    let lamp = "wrist".to_owned();
                    child.call(&world, SwitchLamp { lamp, on }).await.unwrap();
                }
                let asked = child.now().since_start();
                all.frames.push(camera.take(&child).await.unwrap());
                all.asked.push([asked, child.now().since_start()]);
                let scene = child.call(&world, GetScene {}).await.unwrap();
                all.scenes.push((scene.stamp, scene.tick));
                all.lamps.push(scene.lamps[0].on);
                child.sleep(Duration::from_millis(100)).await;
            }
            let lamp = "wirst".to_owned();
            let refused = child.call(&world, SwitchLamp { lamp, on: true }).await;
            all.no_such_lamp = refused.unwrap_err().to_string();
            let last = child.call(&world, GetScene {}).await.unwrap();
            all.lamp_moved = (last.lamps[0].centre - first.lamps[0].centre).norm();
            all.truths = child.call(&world, TrueCameras {}).await.unwrap();
            *seen.lock().unwrap() = all;
            child.finish(AppResult {
                ok: true,
                text: String::new(),
                json: String::new(),
            });
        });
        Ok(())
    }
}

fn launcher() -> Launcher {
    Launcher {
        program: "none".into(),
        arguments: Vec::new(),
    }
}

/// Runs an app with world and servo on one chassis and the eye on another, in virtual time; scenes by message.
fn run(camera: &str, seed: u64) -> (End, Seen) {
    run_by("look", "", camera, seed)
}

/// The same, the arguments `by` given to both world and eye.
fn run_by(name: &str, by: &str, camera: &str, seed: u64) -> (End, Seen) {
    run_in(CELL, (name, by), camera, seed)
}

/// The same in a cell's file.
fn run_in(cell: &str, (name, by): (&str, &str), camera: &str, seed: u64) -> (End, Seen) {
    let text = format!(
        r#"
        [app]
        name = "{name}"
        seed = {seed}
        until = "eye"
        [time]
        mode = "virtual"
        [chassis.motion]
        [chassis.vision]
        [task.servo]
        handler = "test.servo"
        on = "motion"
        [task.world]
        handler = "sim.world"
        on = "motion"
        args = {{ cell = '{cell}' {by} }}
        [task.eye]
        handler = "test.eye"
        on = "vision"
        args = {{ cell = '{cell}' {by} }}
        "#
    );
    let app = load_texts(&[("app.toml", text.as_str())], &[], &[]).unwrap();
    let seen = Arc::new(Mutex::new(Seen::default()));
    let mut registry = Registry::new();
    register_world(&mut registry);
    let servo = registry.handler("test.servo", &[], |cx| {
        let args = &cx.config().unwrap().args;
        Ok(Servo {
            driver: RefCell::new(Some(open_arm(cx, args)?)),
            cycle: None,
        })
    });
    servo.args::<ArmArgs>();
    let (camera, shared) = (camera.to_owned(), seen.clone());
    let eye = registry.handler("test.eye", &[], move |cx| {
        let args = &cx.config().unwrap().args;
        Ok(Eye {
            camera: Some(SimCamera::new(cx, &camera, args)?),
            seen: shared.clone(),
        })
    });
    eye.args::<CameraArgs>();
    assert!(!registry.check(&app).has_errors());
    let observer: boot::Observer = Arc::new(|_: &boot::BootEvent| {});
    let outcome = boot::boot(app, registry, &launcher(), &observer).unwrap();
    let seen = seen.lock().unwrap().clone();
    (outcome.end, seen)
}

#[test]
fn a_camera_on_another_chassis_sees_the_lamp_of_the_moving_arm() {
    let (end, seen) = run("ceiling_west", 1);
    assert!(matches!(end, End::Finished(_)), "{end:?}");
    assert_eq!(seen.lamps, [true, false]);
    assert!(seen.lamp_moved > 0.02, "{}", seen.lamp_moved);
    let brightest = |frame: &Frame| frame.pixels.iter().copied().max();
    let [lit, dark] = seen.frames.as_slice() else {
        panic!("{} frames", seen.frames.len());
    };
    assert!(brightest(lit) > brightest(dark));
    assert_eq!((lit.number, dark.number), (0, 1));
    assert!(dark.stamp > lit.stamp);
    let names: Vec<_> = seen
        .truths
        .iter()
        .map(|truth| truth.name.as_str())
        .collect();
    assert_eq!(names, ["ceiling_west", "ceiling_east"]);
    assert!(
        seen.no_such_lamp.contains("no lamp `wirst`"),
        "{}",
        seen.no_such_lamp
    );
}

#[test]
fn a_frame_has_the_stamp_of_its_scene() {
    let (_, seen) = run("ceiling_west", 1);
    for (frame, (stamp, tick)) in seen.frames.iter().zip(&seen.scenes) {
        // The scene was asked for once more at once: at most one tick of the world later.
        let later = stamp.checked_sub(frame.stamp);
        let soon = later.is_some_and(|later| later <= Duration::from_micros(1500));
        assert!(soon, "{tick} {later:?}");
    }
    assert!(seen.scenes[1].1 > 60, "{:?}", seen.scenes);
}

#[test]
fn a_camera_that_reads_the_worlds_snapshot_buffer_sees_what_one_sees_that_asks_the_world() {
    // No other app of this host has the name, and so the buffer.
    let name = format!("look-{}", std::process::id());
    let (end, read) = run_by(&name, ", scenes = \"scenes\"", "ceiling_west", 1);
    assert!(matches!(end, End::Finished(_)), "{end:?}");
    let (_, asked) = run("ceiling_west", 1);
    assert_eq!((&read.scenes, &read.lamps), (&asked.scenes, &asked.lamps));
    for (read, asked) in read.frames.iter().zip(&asked.frames) {
        // By message it takes a moment, in which the world may go on by a tick.
        let apart = read.stamp.abs_diff(asked.stamp);
        assert!(apart <= Duration::from_micros(1500), "{apart:?}");
        let pixels = read.pixels.iter().zip(asked.pixels.iter());
        let other = pixels.filter(|(read, asked)| read.abs_diff(**asked) > 3);
        assert!(other.count() < 500);
    }
    for (frame, (stamp, _)) in read.frames.iter().zip(&read.scenes) {
        let later = stamp.checked_sub(frame.stamp);
        assert!(later.is_some_and(|later| later <= Duration::from_micros(1500)));
    }
}

/// The shipped cell with another text for its first camera.
fn cell_with(folder: &tempfile::TempDir, edits: &[(&str, &str)]) -> String {
    let mut text = std::fs::read_to_string(CELL).unwrap();
    for (from, to) in edits {
        assert!(text.contains(from), "{from}");
        text = text.replacen(from, to, 1);
    }
    let path = folder.path().join("cell.toml");
    std::fs::write(&path, text).unwrap();
    path.display().to_string()
}

#[test]
fn a_frame_is_stamped_in_the_middle_of_its_exposure() {
    let folder = tempfile::tempdir().unwrap();
    let cell = cell_with(
        &folder,
        &[(
            "name = \"ceiling_west\"",
            "name = \"ceiling_west\"\nexposure_ms = 40.0",
        )],
    );
    let (_, seen) = run_in(&cell, ("look", ""), "ceiling_west", 1);
    for (frame, [asked, came]) in seen.frames.iter().zip(&seen.asked) {
        assert_eq!(frame.exposure, Duration::from_millis(40));
        assert!(*came >= *asked + frame.exposure);
        // The scene is that of the last tick of the world before the middle.
        let early = (*asked + frame.exposure / 2).checked_sub(frame.stamp);
        let early = early.unwrap();
        assert!(early <= Duration::from_micros(1500), "{early:?}");
        assert_eq!(frame.camera, "ceiling_west");
        assert_eq!(frame.carrier, None);
    }
    assert_eq!(seen.frames.len(), 2);
}

#[test]
fn a_frame_of_a_carried_camera_has_the_pose_of_its_link_at_the_stamp() {
    let folder = tempfile::tempdir().unwrap();
    let mount = "name = \"ceiling_west\"\narm = \"puma\"\nlink = \"link6\"";
    let cell = cell_with(
        &folder,
        &[
            ("name = \"ceiling_west\"", mount),
            (
                "position = [-0.52, 0.06, 2.91]",
                "position = [0.05, 0.0, 0.05]",
            ),
            ("look_at = [0.05, -0.02, 0.8]", "look_at = [0.05, 0.0, 1.0]"),
        ],
    );
    let (end, seen) = run_in(&cell, ("look", ""), "ceiling_west", 1);
    assert!(matches!(end, End::Finished(_)), "{end:?}");
    let carriers: Vec<_> = seen
        .frames
        .iter()
        .map(|frame| frame.carrier.clone().unwrap())
        .collect();
    let cell = Cell::read(Path::new(&cell)).unwrap();
    // The lamp is fixed to the same link: where the link is, the lamp is seen from the camera's own place.
    let lamp = cell.lamps[0].offset;
    assert!(carriers.iter().all(|carrier| carrier.link == "puma.link6"));
    let places: Vec<_> = carriers
        .iter()
        .map(|carrier| carrier.world_t_link * lamp)
        .collect();
    assert!((places[1] - places[0]).norm() > 0.02, "{places:?}");
}

#[test]
fn the_same_seed_gives_the_same_pictures_and_another_seed_other_noise() {
    let (_, first) = run("ceiling_east", 7);
    assert_eq!(first, run("ceiling_east", 7).1);
    assert_ne!(
        first.frames[0].pixels,
        run("ceiling_east", 8).1.frames[0].pixels
    );
}

#[test]
fn an_unknown_camera_fails_the_boot_by_name() {
    let (end, _) = run("ceiling_est", 1);
    let text = format!("{end:?}");
    assert!(
        text.contains("ceiling_est") && text.contains("did you mean"),
        "{text}"
    );
}

/// What is found in an app with a world, a camera and servos; `more` goes to its end.
fn found(world: &str, more: &str) -> String {
    let text = format!(
        "[chassis.one]\n[chassis.two]\n[task.world]\nhandler = \"sim.world\"\non = \"one\"\nargs = {{ {world} }}\n{more}[task.filler]\nhandler = \"test.filler\"\non = \"two\"\n"
    );
    let app = load_texts(&[("app.toml", text.as_str())], &[], &[]).unwrap();
    let mut registry = Registry::new();
    register_world(&mut registry);
    let servo = registry.handler("test.servo", &[], |_| -> Result<Servo, _> {
        Err(HandlerError::new("never run"))
    });
    servo.checked_args::<ServoArgs>(|_, task, app, findings| {
        let args = task
            .args
            .get("driver_args")
            .cloned()
            .unwrap_or_else(Node::table);
        check_arm(task, app, &args, findings);
    });
    registry.app_check("sim::cameras", |app, _, findings| {
        check_cameras(app, findings)
    });
    let vision = registry.handler("vss.vm_snap", &[], |_| -> Result<Servo, _> {
        Err(HandlerError::new("never run"))
    });
    vision.keys(&["camera", "source", "args"]);
    registry.handler("test.filler", &[], |_| -> Result<Servo, _> {
        Err(HandlerError::new("never run"))
    });
    registry.check(&app).to_string()
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct ServoArgs {
    #[serde(rename = "driver")]
    _driver: String,
    #[serde(rename = "driver_args")]
    _driver_args: Option<serde::de::IgnoredAny>,
}

fn servo(name: &str, chassis: &str, args: &str) -> String {
    format!(
        "[task.{name}]\nhandler = \"test.servo\"\non = \"{chassis}\"\n[task.{name}.args]\ndriver = \"sim.arm\"\ndriver_args = {{ {args} }}\n"
    )
}

fn sound() -> String {
    format!("cell = '{CELL}'")
}

#[track_caller]
fn says(found: &str, words: &[&str]) {
    for word in words {
        assert!(found.contains(word), "no `{word}` in: {found}");
    }
}

#[test]
fn a_world_is_checked_with_its_cell_before_anything_starts() {
    assert_eq!(found(&sound(), ""), "");
    says(
        &found("cell = 'no/such.toml'", ""),
        &["no/such.toml", "app.toml:6:"],
    );
    says(
        &found(&format!("{}, period_ms = 0.0", sound()), ""),
        &["period of world `world` is 0 ms", "app.toml:6:"],
    );
    says(
        &found(&format!("{}, perod_ms = 1.5", sound()), ""),
        &["perod_ms"],
    );
    let twin = format!(
        "[task.other]\nhandler = \"sim.world\"\non = \"two\"\nargs = {{ {} }}\n",
        sound()
    );
    says(
        &found(&sound(), &twin),
        &["`world` owns the arms", "app.toml:10:"],
    );
}

#[test]
fn a_driver_without_its_world_arm_or_joints_is_found_before_anything_starts() {
    let check = |chassis: &str, args: &str| found(&sound(), &servo("servo", chassis, args));
    assert_eq!(check("one", ""), "");
    assert_eq!(
        check(
            "one",
            "world = 'world', arm = 'puma', joints = ['joint1', 'joint6']"
        ),
        ""
    );
    says(
        &check("two", ""),
        &["on chassis `two`", "on chassis `one`", "app.toml:12:"],
    );
    says(
        &check("one", "world = 'wrld'"),
        &["`wrld`", "did you mean `world`?", "app.toml:12:"],
    );
    says(
        &check("one", "arm = 'pume'"),
        &["no arm `pume`", "did you mean `puma`?", "app.toml:12:"],
    );
    says(
        &check("one", "joints = ['joint7']"),
        &["no joint `joint7`", "app.toml:12:"],
    );
    says(
        &check("one", "joints = ['joint1', 'joint1']"),
        &["named twice"],
    );
    says(&check("one", "joint = ['joint1']"), &["joint"]);
}

#[test]
fn two_drivers_of_one_joint_are_found_before_anything_starts() {
    let pair = |one: &str, other: &str| {
        found(
            &sound(),
            &(servo("left", "one", one) + &servo("right", "one", other)),
        )
    };
    let wrist = "joints = ['joint4', 'joint5', 'joint6']";
    assert_eq!(pair("joints = ['joint1', 'joint2', 'joint3']", wrist), "");
    let words = [
        "joint `joint4` of arm `puma` is driven by task `left` already",
        "app.toml:18:",
    ];
    says(&pair("", wrist), &words[1..]);
    says(&pair(wrist, "joints = ['joint1', 'joint4']"), &words);
}

#[test]
fn a_camera_whose_world_or_name_is_not_in_the_app_is_found_before_anything_starts() {
    let check = |camera: &str, world: &str| {
        let task = format!(
            "[task.vm]\nhandler = \"vss.vm_snap\"\non = \"two\"\n[task.vm.args]\ncamera = \"{camera}\"\nsource = \"sim.camera\"\nargs = {{ cell = '{CELL}', world = \"{world}\" }}\n"
        );
        found(&sound(), &task)
    };
    assert_eq!(check("ceiling_west", "world"), "");
    says(&check("ceiling_west", "vm"), &["asks `vm`", "app.toml:7:"]);
    says(
        &check("ceiling_north", "world"),
        &["no camera `ceiling_north`", "app.toml:13:"],
    );
}

#[test]
fn a_camera_that_reads_a_buffer_in_which_its_world_leaves_nothing_is_found_before_anything_starts()
{
    let check = |world: &str| {
        let task = format!(
            "[task.vm]\nhandler = \"vss.vm_snap\"\non = \"two\"\n[task.vm.args]\ncamera = \"ceiling_west\"\nsource = \"sim.camera\"\nargs = {{ cell = '{CELL}', scenes = \"scenes\" }}\n"
        );
        found(&format!("{}{world}", sound()), &task)
    };
    assert_eq!(check(", scenes = \"scenes\""), "");
    for world in ["", ", scenes = \"others\""] {
        let words = ["reads snapshot buffer `scenes`, in which world `world` leaves nothing"];
        says(&check(world), &words);
        says(&check(world), &["app.toml:13:"]);
    }
}

#[test]
fn the_joints_of_one_arm_are_parted_among_drivers_as_the_configuration_says() {
    let folder = tempfile::tempdir().unwrap();
    let cell = folder.path().join("cell.toml");
    let start = [0.0; 18];
    let text = format!("[[arm]]\nname = 'testbed'\nmodel = 'testbed18'\nstart = {start:?}\n");
    std::fs::write(&cell, text).unwrap();
    let world = format!("cell = '{}'", cell.display());
    let of = |part: &str, joints: &[&str]| -> Vec<String> {
        joints
            .iter()
            .map(|joint| format!("'{part}.{joint}'"))
            .collect()
    };
    let cart = |side: &str| of(&format!("{side}_cart"), &["track", "rotate", "tilt"]);
    let puma = |side: &str| {
        let joints = ["joint1", "joint2", "joint3", "joint4", "joint5", "joint6"];
        of(&format!("{side}_arm"), &joints)
    };
    let part = |name: &str, joints: Vec<String>| {
        servo(name, "one", &format!("joints = [{}]", joints.join(", ")))
    };
    let three_times_six = part("left", puma("left"))
        + &part("right", puma("right"))
        + &part("carts", [cart("left"), cart("right")].concat());
    let two_times_nine = part("left", [cart("left"), puma("left")].concat())
        + &part("right", [cart("right"), puma("right")].concat());
    for parted in [&three_times_six, &two_times_nine, &servo("all", "one", "")] {
        assert_eq!(found(&world, parted), "");
    }
    let both = two_times_nine + &part("carts", cart("left"));
    let words = ["joint `left_cart.track` of arm `testbed` is driven by task `left` already"];
    says(&found(&world, &both), &words);
}
