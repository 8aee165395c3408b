//! Cameras that lie, in an app: the simulated world has a camera do each thing that no good camera does, and the Vision Module
//! names it within five frames and gives no picture.

#![allow(
    clippy::unwrap_used,
    clippy::panic,
    reason = "helpers of tests, outside test functions"
)]

use std::{sync::Arc, time::Duration};

use ctos::{
    boot::{BootEvent, End, Launcher, boot},
    config::load_texts,
    message::Message,
    registry::Registry,
    system::AppResult,
    task::{Context, EventHandler, Handled, HandlerError, Phase},
};
use mcs::driver::DriverRegistry;
use sim::{scene::CameraFault, world_task::FailCamera};
use vss::{
    catalog::VssExpander,
    command::{Outcome, SpotFind, SpotReport, VisionError},
    frame::buffer::FrameReader,
    source::FrameSources,
};

const CELL: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../configs/cell.toml");

/// Each fault, and what it is called.
const FAULTS: [(CameraFault, &str); 6] = [
    (CameraFault::Freeze, "frozen"),
    (CameraFault::Repeat, "repeated"),
    (CameraFault::Jump, "time_jump"),
    (CameraFault::Shrink, "size"),
    (CameraFault::Black, "black"),
    (CameraFault::Cover, "covered"),
];

struct Client;

async fn spot(cx: &Context, camera: &str) -> Result<SpotReport, VisionError> {
    let vsm = cx.task("vsm").await?;
    let camera = camera.to_owned();
    let call = cx.call(&vsm, SpotFind { camera });
    let found = call.deadline(Duration::from_secs(60)).await?;
    cx.sleep(Duration::from_millis(40)).await;
    found
}

/// Has a camera fail in each way; what each is called, and after how many frames.
async fn watch(cx: &Context) -> Result<String, HandlerError> {
    let world = cx.task("world").await?;
    let camera = || "ceiling_west".to_owned();
    for (fault, name) in FAULTS {
        for _ in 0..3 {
            spot(cx, "ceiling_west").await?;
        }
        let (camera, fault) = (camera(), Some(fault));
        cx.call(&world, FailCamera { camera, fault }).await?;
        let mut named = None;
        for frame in 1..=5 {
            match spot(cx, "ceiling_west").await {
                // What is seen before it can be told must not be worse than a picture of a moment before.
                Ok(_) => {}
                Err(error) if error.reason.contains(name) => {
                    assert_eq!(error.outcome, Outcome::Fault, "{error}");
                    named = Some(frame);
                    break;
                }
                Err(error) if error.outcome == Outcome::Unseen => {}
                Err(error) => panic!("{name}: {error}"),
            }
            // The other camera is well.
            spot(cx, "ceiling_east").await?;
        }
        assert!(named.is_some(), "{name} was not named within five frames");
        let well = FailCamera {
            camera: "ceiling_west".to_owned(),
            fault: None,
        };
        cx.call(&world, well).await?;
        let mut again = 0;
        while spot(cx, "ceiling_west").await.is_err() {
            again += 1;
            assert!(again <= 2, "{name}: not believed again");
        }
    }
    let nobody = FailCamera {
        camera: "ceiling_wset".to_owned(),
        fault: None,
    };
    let refused = cx.call(&world, nobody).await.unwrap_err().to_string();
    assert!(refused.contains("no camera `ceiling_wset`"), "{refused}");
    // What it leaves in its snapshot buffer is the last frame that was believed.
    let last = spot(cx, "ceiling_west").await?;
    let left = FrameReader::new(&cx.app().name, "west").latest();
    let left = left.map_err(|error| HandlerError::new(error.to_string()))?;
    assert_eq!((left.number, left.stamp), (last.frame, last.stamp));
    assert_eq!((left.camera.as_str(), left.width), ("ceiling_west", 500));
    Ok(String::new())
}

impl EventHandler for Client {
    async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
        cx.default_processing(message)
    }

    async fn phase(&mut self, cx: &Context, phase: Phase) -> Handled {
        if phase == Phase::Run {
            let child = cx.clone();
            cx.spawn(async move {
                let watched = watch(&child).await;
                child.finish(AppResult {
                    ok: watched.is_ok(),
                    text: watched.unwrap_or_else(|error| error.to_string()),
                    json: "{}".to_owned(),
                });
            });
        }
        Ok(())
    }
}

#[test]
fn each_lie_of_a_camera_is_named_within_five_frames_and_no_measurement_comes_of_it() {
    let text = format!(
        r#"
        [app]
        name = "lying-{}"
        until = "client"
        [time]
        mode = "virtual"
        [chassis.motion]
        [chassis.vision]
        [task.client]
        handler = "test.client"
        on = "vision"
        [task.world]
        handler = "sim.world"
        on = "motion"
        args = {{ cell = '{CELL}', period_ms = 20.0 }}
        [vss]
        on = "vision"
        services = ["SpotFind"]
        [vss.args.toolSpotFind]
        max_sigma_px = 4.0
        [vss.cameras.ceiling_west]
        source = "sim.camera"
        args.cell = '{CELL}'
        buffer = "west"
        [vss.cameras.ceiling_east]
        source = "sim.camera"
        args.cell = '{CELL}'
        "#,
        std::process::id()
    );
    let app = load_texts(
        &[("app.toml", text.as_str())],
        &[],
        &[("vss", &VssExpander)],
    );
    let app = app.unwrap_or_else(|findings| panic!("{findings}"));
    let mut registry = Registry::new();
    let (mut drivers, mut sources) = (DriverRegistry::new(), FrameSources::new());
    sim::register(&mut registry, &mut drivers, &mut sources);
    vss::register(&mut registry, sources);
    registry.handler("test.client", &[], |_| Ok(Client));
    let findings = registry.check(&app);
    assert!(!findings.has_errors(), "{findings}");
    let launcher = Launcher {
        program: "unused".into(),
        arguments: Vec::new(),
    };
    let observer = Arc::new(|_: &BootEvent| ()) as _;
    let outcome = boot(app, registry, &launcher, &observer).unwrap();
    assert!(
        matches!(&outcome.end, End::Finished(result) if result.ok),
        "{:?}",
        outcome.end
    );
}
