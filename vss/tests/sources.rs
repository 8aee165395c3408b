//! Frame sources without hardware, as an app sees them: booted on the virtual clock, asked through the Tool that takes
//! pictures.

#![allow(
    clippy::unwrap_used,
    clippy::panic,
    reason = "helpers of tests, outside test functions"
)]

use std::{fs, future::Future, path::Path, sync::Arc, time::Duration};

use ctos::{
    boot::{End, Launcher, boot},
    config::{App, load_texts},
    message::Message,
    registry::Registry,
    system::AppResult,
    task::{Context, EventHandler, Handled, HandlerError, Phase},
    time::Clock,
};
use futures_util::future::LocalBoxFuture;
use nalgebra::Isometry3;
use vss::{
    catalog::VssExpander,
    command::{DiskOffset, DiskReport, Drawing, Outcome, Snap, VisionError, WhatIsShown},
    frame::{Carried, Frame, PixelFormat, buffer::FrameWriter},
    source::{FrameSources, kinds},
    visual_jacobian::Seen,
};

type Scenario =
    Arc<dyn Fn(Context) -> LocalBoxFuture<'static, Result<String, HandlerError>> + Send + Sync>;

/// Runs a scenario when the app runs, and ends the app with what it says.
struct Client(Scenario);

impl EventHandler for Client {
    async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
        cx.default_processing(message)
    }

    async fn phase(&mut self, cx: &Context, phase: Phase) -> Handled {
        if phase == Phase::Run {
            let (cx, running) = (cx.clone(), (self.0)(cx.clone()));
            cx.clone().spawn(async move {
                let (ok, text) = match running.await {
                    Ok(text) => (true, text),
                    Err(error) => (false, error.to_string()),
                };
                let json = "{}".to_owned();
                cx.finish(AppResult { ok, text, json });
            });
        }
        Ok(())
    }
}

/// An app with one camera, whose source and arguments are given.
fn text(name: &str, camera: &str, more: &str) -> String {
    format!(
        "[app]\nname = \"{name}\"\nuntil = \"client\"\n[time]\nmode = \"virtual\"\n[chassis.ws1]\n[chassis.vision]\n\
         [task.client]\nhandler = \"test.client\"\non = \"ws1\"\n[vss]\non = \"vision\"\nservices = [\"SpotFind\"]\n\
         [vss.cameras.left]\n{camera}\n{more}\n"
    )
}

fn load(text: &str) -> App {
    let app = load_texts(&[("app.toml", text)], &[], &[("vss", &VssExpander)]);
    app.unwrap_or_else(|findings| panic!("{findings}"))
}

fn registry<F, Fut>(scenario: F) -> Registry
where
    F: Fn(Context) -> Fut + Send + Sync + 'static,
    Fut: Future<Output = Result<String, HandlerError>> + 'static,
{
    let scenario: Scenario = Arc::new(move |cx| Box::pin(scenario(cx)));
    let (mut registry, mut sources) = (Registry::new(), FrameSources::new());
    kinds::register(&mut sources);
    vss::register(&mut registry, sources);
    registry.handler("test.client", &[], move |_| Ok(Client(scenario.clone())));
    registry
}

/// Boots the app and answers with what its scenario says.
fn run<F, Fut>(text: &str, scenario: F) -> String
where
    F: Fn(Context) -> Fut + Send + Sync + 'static,
    Fut: Future<Output = Result<String, HandlerError>> + 'static,
{
    let registry = registry(scenario);
    let app = load(text);
    let findings = registry.check(&app);
    assert!(!findings.has_errors(), "{findings}");
    let launcher = Launcher {
        program: "unused".into(),
        arguments: Vec::new(),
    };
    let outcome = boot(app, registry, &launcher, &(Arc::new(|_: &_| ()) as _)).unwrap();
    match outcome.end {
        End::Finished(result) if result.ok => result.text,
        other => panic!("{other:?}"),
    }
}

/// A picture of the camera, or why there is none.
async fn snap(cx: &Context) -> Result<Result<Frame, String>, HandlerError> {
    let tool = cx.task("toolSnap").await?;
    let camera = "left".to_owned();
    let call = cx.call(&tool, Snap { camera });
    let taken = call.deadline(Duration::from_secs(60)).await?;
    Ok(taken.map_err(|error| error.reason))
}

/// Three pictures in three formats, whose grey values say in which order they come.
fn pictures(folder: &Path) {
    let mut png = Vec::new();
    vss::png::write(&mut png, 2, 1, &[3, 33]).unwrap();
    for (name, bytes) in [
        ("b_0.5.pgm", &b"P5 2 1 255\n\x02\x16"[..]),
        // Its name says something else.
        ("a_0.25.jpg", b"P2 2 1 255 1 11"),
        ("c_1.5.png", &png),
        ("notes.txt", b"no picture"),
    ] {
        fs::write(folder.join(name), bytes).unwrap();
    }
    let table = "name,stamp_s\n# the first one is left out\nc_1.5.png,7\nb_0.5.pgm,7.5\n";
    fs::write(folder.join("stamps.csv"), table).unwrap();
}

/// The numbers, first pixels and stamps of the pictures until there are no more, and why there are no more.
async fn all(cx: &Context, most: usize) -> Result<String, HandlerError> {
    let mut text = String::new();
    for _ in 0..most {
        match snap(cx).await? {
            Ok(frame) => {
                assert_eq!(frame.camera, "left");
                assert_eq!(frame.format, PixelFormat::Grey8);
                let (first, stamp) = (frame.pixels[0], frame.stamp.as_secs_f64());
                text += &format!("{}:{first}@{stamp:?} ", frame.number);
            }
            Err(why) => return Ok(text + &why),
        }
    }
    Ok(text)
}

#[test]
fn an_app_boots_with_the_pictures_of_a_folder_and_takes_them_in_order() {
    let folder = tempfile::tempdir().unwrap();
    pictures(folder.path());
    let shown = folder.path().display();
    let camera =
        |more: &str| format!("source = \"vss.directory\"\nargs = {{ folder = \"{shown}\"{more} }}");
    let app = text(
        "folder",
        &camera(", period_s = 0.04, exposure_s = 0.01"),
        "",
    );
    let found = run(&app, |cx| async move { all(&cx, 9).await });
    assert!(found.starts_with("0:1@0.0 1:2@0.04 2:3@0.08 "), "{found}");
    assert!(found.contains("all 3 pictures of"), "{found}");
    let app = text("folder", &camera(", stamps = \"names\""), "");
    let found = run(&app, |cx| async move { all(&cx, 3).await });
    assert_eq!(found, "0:1@0.25 1:2@0.5 2:3@1.5 ");
    let app = text("folder", &camera(", stamps = \"stamps.csv\""), "");
    let found = run(&app, |cx| async move { all(&cx, 2).await });
    assert_eq!(found, "0:3@7.0 1:2@7.5 ");
    // Without stamps they are of the moment.
    let app = text("folder", &camera(", repeat = true"), "");
    let found = run(&app, |cx| async move {
        cx.sleep(Duration::from_secs(3)).await;
        all(&cx, 5).await
    });
    let order: Vec<&str> = found.split('@').collect();
    assert!(
        order[0] == "0:1" && order[4].ends_with("4:2") && order[1].starts_with('3'),
        "{found}"
    );
}

#[test]
fn a_picture_that_is_cut_ends_nothing_but_its_own_request() {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("a.pgm"), b"P5 2 1 255\n1").unwrap();
    let camera = format!(
        "source = \"vss.directory\"\nargs = {{ folder = \"{}\" }}",
        folder.path().display()
    );
    let found = run(
        &text("cut", &camera, ""),
        |cx| async move { all(&cx, 2).await },
    );
    assert!(
        found.contains("a.pgm") && found.contains("cut off"),
        "{found}"
    );
}

#[test]
fn a_stream_brings_its_pictures_and_says_when_it_has_ended() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("stream");
    let mut bytes = Vec::new();
    vss::png::write(&mut bytes, 1, 1, &[4]).unwrap();
    vss::png::write(&mut bytes, 1, 1, &[5]).unwrap();
    fs::write(&path, &bytes).unwrap();
    let camera = |args: &str| {
        format!(
            "source = \"vss.stream\"\nargs = {{ path = \"{}\", {args} }}",
            path.display()
        )
    };
    let app = text("stream", &camera("format = \"png\", period_s = 0.5"), "");
    let found = run(&app, |cx| async move { all(&cx, 9).await });
    assert!(
        found.starts_with("0:4@0.0 1:5@0.5 ") && found.ends_with("the stream has ended"),
        "{found}"
    );
    fs::write(&path, [6, 7, 8, 9, 10]).unwrap();
    let app = text(
        "stream",
        &camera("format = \"raw\", width = 2, height = 1, period_s = 1"),
        "",
    );
    let found = run(&app, |cx| async move { all(&cx, 9).await });
    assert!(found.starts_with("0:6@0.0 1:8@1.0 "), "{found}");
    assert!(
        found.contains("picture 2 of the stream") && found.contains("1 of 2 bytes")
            || found.contains("after 0 of 1 bytes"),
        "{found}"
    );
}

#[test]
fn the_frames_of_a_recorded_app_come_again_with_their_stamps() {
    let folder = tempfile::tempdir().unwrap();
    pictures(folder.path());
    let shown = folder.path().display();
    let camera = format!(
        "source = \"vss.directory\"\nargs = {{ folder = \"{shown}\", stamps = \"names\" }}"
    );
    let record = folder.path().join("run.mcap");
    let app = text(
        "recorded",
        &camera,
        &format!("[record]\nfile = \"{}\"", record.display()),
    );
    let first = run(&app, |cx| async move { all(&cx, 3).await });
    let camera = format!(
        "source = \"vss.recording\"\nargs = {{ file = \"{}\" }}",
        record.display()
    );
    let again = run(&text("again", &camera, ""), |cx| async move {
        all(&cx, 9).await
    });
    assert!(again.starts_with(&first), "{first} {again}");
    assert!(again.contains("all recorded frames of"), "{again}");
}

#[test]
fn the_latest_frame_of_a_buffer_is_taken_once_with_its_stamp_and_what_carried_it() {
    let app = format!("vss-sources-{}", std::process::id());
    let mut writer = FrameWriter::new((&app, "frames"), &Clock::real());
    let frame = Frame {
        camera: "wrist".to_owned(),
        number: 41,
        stamp: Duration::from_millis(1250),
        exposure: Duration::from_millis(8),
        carrier: Some(Carried {
            link: "puma.link6".to_owned(),
            world_t_link: Isometry3::translation(0.1, 0.2, 0.3),
        }),
        ..Frame::rgb8(1, 1, vec![1, 2, 3])
    };
    writer.write(&frame).unwrap();
    let camera = format!(
        "source = \"vss.buffer\"\nargs = {{ buffer = \"frames\", app = \"{app}\", within_s = 0.1 }}"
    );
    let found = run(&text("reader", &camera, ""), move |cx| {
        let frame = frame.clone();
        async move {
            let expected = Frame {
                camera: "left".to_owned(),
                ..frame
            };
            assert_eq!(snap(&cx).await?, Ok(expected));
            let begun = cx.now();
            let none = snap(&cx).await?.unwrap_err();
            assert!(cx.now() - begun >= Duration::from_millis(100));
            Ok(none)
        }
    });
    assert!(
        found.contains("no frame came within 100ms after frame 41"),
        "{found}"
    );
}

/// A disc of `radius` px as a camera sees it that is off by so much: 2 px for each mm.
fn disc([x, y]: [f64; 2], radius: f64) -> Vec<u8> {
    let (width, height) = (200_u16, 160_u16);
    let (u, v) = (100.0 + 2000.0 * x, 80.0 - 2000.0 * y);
    let mut pgm = format!("P5 {width} {height} 255\n").into_bytes();
    for at in 0..width * height {
        let off = (f64::from(at % width) - u).hypot(f64::from(at / width) - v) - radius;
        // Its border is as wide as a pixel.
        pgm.push((60.0 + 120.0 * (0.5 - off).clamp(0.0, 1.0)) as u8);
    }
    pgm
}

/// What the Service answers.
async fn offset(
    cx: &Context,
    taught: Option<[f64; 2]>,
) -> Result<Result<DiskReport, VisionError>, HandlerError> {
    let vsm = cx.task("vsm").await?;
    let camera = "left".to_owned();
    let call = cx.call(&vsm, DiskOffset { camera, taught });
    Ok(call.deadline(Duration::from_secs(60)).await?)
}

/// What is drawn over the picture that the monitor shows.
async fn shown(cx: &Context) -> Result<Drawing, HandlerError> {
    let monitor = cx.task("vmImageDisp").await?;
    let camera = "left".to_owned();
    let shown = cx.call(&monitor, WhatIsShown { camera }).await?;
    Ok(shown.ok_or("nothing is shown")?.drawing)
}

#[test]
fn four_pictures_teach_the_correction_of_a_gripper_and_a_ring_on_the_monitor_shows_it() {
    const CORNERS: [[f64; 2]; 4] = [[-0.01, -0.01], [0.01, -0.01], [-0.01, 0.01], [0.01, 0.01]];
    let folder = tempfile::tempdir().unwrap();
    let between = [0.004, -0.006];
    let all = [[0.0; 2]].into_iter().chain(CORNERS).chain([between; 2]);
    for (k, place) in all.enumerate() {
        let radius = if k == 6 { 24.0 } else { 20.0 };
        fs::write(folder.path().join(format!("{k}.pgm")), disc(place, radius)).unwrap();
    }
    let camera = format!(
        "source = \"vss.directory\"\nargs = {{ folder = \"{}\", period_s = 0.1 }}",
        folder.path().display()
    );
    let app = text("hand", &camera, "[vss.args.toolDiskFind]\nradius_px = 20.0");
    let app = app.replace("\"SpotFind\"", "\"DiskFind\"");
    run(&app, move |cx| async move {
        let untaught = offset(&cx, None).await?.unwrap_err();
        assert_eq!(untaught.outcome, Outcome::Refused);
        assert!(untaught.reason.contains("0 of 4 examples"), "{untaught}");
        for (k, corner) in CORNERS.into_iter().enumerate() {
            let report = offset(&cx, Some(corner)).await??;
            assert_eq!((report.disk.examples, report.frame), (k + 1, k as u64 + 1));
            assert_eq!(report.disk.correction, None);
        }
        let report = offset(&cx, None).await??;
        let found = report.disk.correction.unwrap();
        for (by, off) in found.by.iter().zip(between) {
            assert!((by + off).abs() < 5e-5, "{found:?}");
        }
        assert!(
            found.sd.iter().all(|sd| (5e-5..5e-4).contains(sd)),
            "{found:?}"
        );
        let shown = shown(&cx).await?;
        let [ring] = shown.outlines.as_slice() else {
            panic!("{shown:?}");
        };
        let Seen { u, v, radius } = report.disk.seen;
        for [column, row] in &ring.corners {
            let off = (column - u).hypot(row - v) - radius;
            assert!(off.abs() < 1e-9, "{ring:?}");
        }
        assert_eq!(shown.said, "move by -4.0, 6.0 mm");
        // A larger disc, or a hand that is nearer.
        let other = offset(&cx, None).await?.unwrap_err();
        assert_eq!(other.outcome, Outcome::Unseen, "{other}");
        Ok(String::new())
    });
}

#[test]
fn wrong_arguments_of_a_source_are_found_before_anything_starts() {
    for (camera, what) in [
        ("source = \"vss.directory\"", "the key `folder` is missing"),
        (
            "source = \"vss.directory\"\nargs = { folder = \"a\", rate = 3 }",
            "`rate`",
        ),
        (
            "source = \"vss.directory\"\nargs = { folder = \"a\", stamps = \"names\", period_s = 1.0 }",
            "`stamps` and `period_s` say the same",
        ),
        (
            "source = \"vss.directory\"\nargs = { folder = \"a\", stamps = \"names\", repeat = true }",
            "`repeat` would bring the same `stamps` again",
        ),
        (
            "source = \"vss.directory\"\nargs = { folder = \"a\", period_s = -1.0 }",
            "0 s or more, not -1.0",
        ),
        (
            "source = \"vss.stream\"\nargs = { path = \"a\", format = \"gif\" }",
            "gif",
        ),
        (
            "source = \"vss.stream\"\nargs = { path = \"a\", format = \"raw\", width = 3 }",
            "need `width` and `height`",
        ),
        (
            "source = \"vss.stream\"\nargs = { path = \"a\", format = \"png\", width = 3 }",
            "are those of raw pictures",
        ),
        (
            "source = \"vss.recording\"\nargs = { camera = \"left\" }",
            "the key `file` is missing",
        ),
        (
            "source = \"vss.buffer\"\nargs = { buffer = \"a\", within_s = nan }",
            "0 s or more, not NaN",
        ),
    ] {
        let registry = registry(|_| async { Ok(String::new()) });
        let findings = registry.check(&load(&text("wrong", camera, "")));
        let told = findings.to_string();
        assert!(
            findings.has_errors() && told.contains(what),
            "{camera}: {told}"
        );
    }
}

#[test]
fn what_is_not_there_is_told_when_the_app_boots() {
    let folder = tempfile::tempdir().unwrap();
    let empty = folder.path().display();
    for (camera, what) in [
        (
            format!("source = \"vss.directory\"\nargs = {{ folder = \"{empty}\" }}"),
            "no pictures are in",
        ),
        (
            format!("source = \"vss.directory\"\nargs = {{ folder = \"{empty}/none\" }}"),
            "cannot read the folder",
        ),
        (
            format!(
                "source = \"vss.stream\"\nargs = {{ path = \"{empty}/none\", format = \"png\" }}"
            ),
            "cannot read the stream",
        ),
        (
            format!("source = \"vss.recording\"\nargs = {{ file = \"{empty}/none.mcap\" }}"),
            "none.mcap",
        ),
    ] {
        let launcher = Launcher {
            program: "unused".into(),
            arguments: Vec::new(),
        };
        let registry = registry(|_| async { Ok(String::new()) });
        let app = load(&text("missing", &camera, ""));
        let outcome = boot(app, registry, &launcher, &(Arc::new(|_: &_| ()) as _));
        let told = match outcome {
            Ok(outcome) => format!("{:?}", outcome.end),
            Err(error) => format!("{error:?}"),
        };
        assert!(told.contains(what), "{camera}: {told}");
    }
    // Stamps that go back, and a picture that is not there, are told with their place.
    pictures(folder.path());
    for (table, what) in [
        ("name,stamp_s\nc_1.5.png,2\nb_0.5.pgm,1\n", "wrong.csv:3:1"),
        ("name,stamp_s\nnone.png,2\n", "wrong.csv:2:1"),
        ("name,stamp_s\nc_1.5.png,NaN\n", "wrong.csv:2:1"),
        ("picture,time\n", "wrong.csv:1:1"),
    ] {
        fs::write(folder.path().join("wrong.csv"), table).unwrap();
        let camera = format!(
            "source = \"vss.directory\"\nargs = {{ folder = \"{empty}\", stamps = \"wrong.csv\" }}"
        );
        let launcher = Launcher {
            program: "unused".into(),
            arguments: Vec::new(),
        };
        let registry = registry(|_| async { Ok(String::new()) });
        let outcome = boot(
            load(&text("stamps", &camera, "")),
            registry,
            &launcher,
            &(Arc::new(|_: &_| ()) as _),
        );
        let told = match outcome {
            Ok(outcome) => format!("{:?}", outcome.end),
            Err(error) => format!("{error:?}"),
        };
        assert!(told.contains(what), "{table}: {told}");
    }
}
