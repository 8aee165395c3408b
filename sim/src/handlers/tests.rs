use std::{cell::RefCell, path::Path, sync::Mutex, time::Duration};

use ctos::{
    boot::{self, End, Launcher},
    config::load_texts,
    sync::{Cyclic, CyclicHandle, Tick},
    system::AppResult,
    task::Phase,
};
use mcs::driver::Power;

use super::*;

const CELL: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../configs/cell.toml");

/// Turns joint 1 for ever, as a servo would.
struct Servo {
    driver: RefCell<Option<Box<dyn ChannelDriver>>>,
    cycle: Option<CyclicHandle>,
}

struct Turn(Box<dyn ChannelDriver>);

impl Cyclic for Turn {
    fn tick(&mut self, _: &Tick) {
        let period = Duration::from_micros(4500);
        let power = Power::Released;
        self.0
            .write(&[40.0, 30.0, 5.0, 0.0, 0.0, 0.0], power, period)
            .unwrap();
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
            self.cycle = Some(cx.cyclic(Duration::from_micros(4500), Turn(driver)));
        }
        Ok(())
    }
}

/// What the eye saw, for the test's own thread.
#[derive(Debug, Clone, Default, PartialEq)]
struct Seen {
    frames: Vec<Frame>,
    lamps: Vec<bool>,
    truths: Vec<NamedCamera>,
    lamp_moved: f64,
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
                child.call(&world, SetLamp { on }).await.unwrap();
                all.frames.push(camera.take(&child).await.unwrap());
                let scene = child.call(&world, GetScene {}).await.unwrap();
                all.lamps.push(scene.lamp_on);
                child.sleep(Duration::from_millis(100)).await;
            }
            let last = child.call(&world, GetScene {}).await.unwrap();
            all.lamp_moved = (last.lamp - first.lamp).norm();
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

/// Runs an app with world and servo on one chassis and the eye on another, in virtual time.
fn run(camera: &str, seed: u64) -> (End, Seen) {
    let text = format!(
        r#"
        [app]
        name = "look"
        seed = {seed}
        until = "eye"
        [time]
        mode = "virtual"
        [chassis.motion]
        [chassis.vision]
        [task.servo]
        handler = "test.servo"
        on = "motion"
        args = {{ cell = '{CELL}' }}
        [task.world]
        handler = "sim.world"
        on = "motion"
        [task.eye]
        handler = "test.eye"
        on = "vision"
        args = {{ cell = '{CELL}' }}
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
    let launcher = Launcher {
        program: "none".into(),
        arguments: Vec::new(),
    };
    let observer: boot::Observer = Arc::new(|_: &boot::BootEvent| {});
    let outcome = boot::boot(app, registry, &launcher, &observer).unwrap();
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

#[test]
fn arguments_are_checked_with_their_cell_file_before_anything_starts() {
    let args = Node::table().with("cell", "no/such.toml");
    let mut findings = Findings::new();
    let configs = |path: &str| Source::read(&Path::new("configs").join(path));
    check_arm(&configs, &args, &mut findings);
    assert!(findings.to_string().contains("configs/no/such.toml"));
    let args = Node::table().with("cell", CELL).with("wrld", "x");
    let read = |path: &str| Source::read(Path::new(path));
    let mut findings = Findings::new();
    check_camera(&read, "ceiling_west", &args, &mut findings);
    assert!(findings.to_string().contains("wrld"), "{findings}");
    let args = Node::table().with("cell", CELL);
    let mut findings = Findings::new();
    check_camera(&read, "ceiling_south", &args, &mut findings);
    assert!(
        findings.to_string().contains("no camera `ceiling_south`"),
        "{findings}"
    );
}

#[test]
fn a_camera_whose_world_or_name_is_not_in_the_app_is_found_before_anything_starts() {
    let check = |camera: &str, world: &str| {
        let text = format!(
            r#"
            [app]
            name = "look"
            [chassis.one]
            [task.world]
            handler = "sim.world"
            on = "one"
            [task.vm]
            handler = "vss.vm_snap"
            on = "one"
            [task.vm.args]
            camera = "{camera}"
            source = "sim.camera"
            args = {{ cell = '{CELL}', world = "{world}" }}
            "#
        );
        let app = load_texts(&[("app.toml", text.as_str())], &[], &[]).unwrap();
        let mut findings = Findings::new();
        check_cameras(&app, &mut findings);
        findings.to_string()
    };
    assert_eq!(check("ceiling_west", "world"), "");
    let found = check("ceiling_west", "vm");
    assert!(
        found.contains("asks `vm`") && found.starts_with("app.toml:"),
        "{found}"
    );
    let found = check("ceiling_north", "world");
    assert!(found.contains("no camera `ceiling_north`"), "{found}");
    assert!(found.starts_with("app.toml:14:"), "{found}");
}
