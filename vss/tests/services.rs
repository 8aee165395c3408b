//! The Vision Services System as an app sees it: booted on the virtual clock, asked through the Services Manager.

#![allow(
    clippy::unwrap_used,
    clippy::panic,
    reason = "helpers of tests, outside test functions"
)]

use std::{
    collections::BTreeMap,
    future::Future,
    sync::{
        Arc, Mutex,
        atomic::{AtomicUsize, Ordering},
    },
    time::Duration,
};

use ctos::{
    boot::{End, Launcher, boot},
    config::{App, load_texts},
    message::{Command, Message},
    registry::Registry,
    system::AppResult,
    task::{Context, EventHandler, Handled, HandlerError, Phase},
};
use futures_util::future::{LocalBoxFuture, join, join_all};
use nalgebra::{Point3, UnitQuaternion, Vector3};
use rand::RngExt;
use vss::{
    calibrate::LightPoint,
    camera::{Camera, Distortion, Intrinsics},
    catalog::VssExpander,
    command::{
        AcquireVm, Calibrate, FindPair, OrderLaser, Outcome, ReleaseVm, SpotFind, SpotReport,
        SteerLaser, VisionError, WhatIsShown,
    },
    frame::{Frame, FrameError},
    laser::LaserOrder,
    source::{FrameSource, FrameSources},
};

/// A camera that sees a spot where its arguments say, or nothing, and takes a second for a picture.
struct TestCamera {
    name: String,
    spot: Option<(f64, f64)>,
    taken: u64,
    busy: Arc<AtomicUsize>,
}

impl TestCamera {
    fn picture(&self, cx: &Context) -> Vec<u8> {
        let mut rng = cx.rng(&format!("picture {}", self.taken));
        let mut value = |index: usize| {
            let (u, v) = ((index % 100) as f64, (index / 100) as f64);
            let lamp = self.spot.map_or(0.0, |(su, sv)| {
                120.0 * (-((u - su).powi(2) + (v - sv).powi(2)) / 8.0).exp()
            });
            (40.0 + lamp + rng.random_range(-4.0..4.0)) as u8
        };
        (0..100 * 80).map(&mut value).collect()
    }
}

impl FrameSource for TestCamera {
    fn snap<'a>(&'a mut self, cx: &'a Context) -> LocalBoxFuture<'a, Result<Frame, FrameError>> {
        Box::pin(async move {
            assert_eq!(
                self.busy.fetch_add(1, Ordering::SeqCst),
                0,
                "used twice at once"
            );
            cx.sleep(Duration::from_secs(1)).await;
            self.busy.fetch_sub(1, Ordering::SeqCst);
            self.taken += 1;
            if self.name == "broken" {
                let reason = "no signal".to_owned();
                return Err(FrameError::Fault {
                    camera: self.name.clone(),
                    reason,
                });
            }
            Ok(Frame {
                camera: self.name.clone(),
                number: self.taken - 1,
                stamp: cx.now().since_start(),
                ..Frame::grey8(100, 80, self.picture(cx))
            })
        })
    }
}

fn sources() -> FrameSources {
    let mut sources = FrameSources::new();
    let camera = sources.source("test.camera", |_, camera, args| {
        let at = |key: &str| args.get(key).and_then(ctos::config::Node::as_f64);
        Ok(Box::new(TestCamera {
            name: camera.to_owned(),
            spot: at("u").zip(at("v")),
            taken: 0,
            busy: Arc::default(),
        }) as Box<dyn FrameSource>)
    });
    camera.keys(&["u", "v"]);
    sources
}

const APP: &str = r#"
[app]
name = "test"
until = "client"
[time]
mode = "virtual"
[chassis.ws1]
[chassis.cage_vision]
[task.client]
handler = "test.client"
on = "ws1"
[vss]
on = "cage_vision"
services = ["SpotFind", "PairFind", "Calibrate"]
hold_limit_s = 3.0
[vss.cameras.left]
source = "test.camera"
args = { u = 41.3, v = 30.8 }
[vss.cameras.right]
source = "test.camera"
args = { u = 12.25, v = 66.5 }
[vss.cameras.dark]
source = "test.camera"
[vss.cameras.broken]
source = "test.camera"
[task.objects]
handler = "sorma.daemon"
on = "ws1"
[vss.scanners.roof]
task = "mirrors"
[task.mirrors]
handler = "test.mirrors"
on = "ws1"
"#;

fn load(text: &str) -> App {
    let app = load_texts(&[("app.toml", text)], &[], &[("vss", &VssExpander)]);
    app.unwrap_or_else(|findings| panic!("{findings}"))
}

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
                cx.finish(AppResult {
                    ok,
                    text,
                    json: "{}".to_owned(),
                });
            });
        }
        Ok(())
    }
}

/// What the driver of the scanner was ordered to do, known to its chassis.
type Orders = Mutex<Vec<(String, LaserOrder)>>;

fn orders(cx: &Context) -> Arc<Orders> {
    cx.shared::<Orders>("orders").unwrap_or_else(|| {
        cx.share("orders", Arc::<Orders>::default());
        cx.shared("orders").unwrap()
    })
}

struct Mirrors;

impl EventHandler for Mirrors {
    async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
        let (OrderLaser { laser, order }, reply) = message.open::<OrderLaser>()?;
        orders(cx).lock().unwrap().push((laser, order));
        reply.ok(())
    }
}

fn registry<F, Fut>(scenario: F) -> Registry
where
    F: Fn(Context) -> Fut + Send + Sync + 'static,
    Fut: Future<Output = Result<String, HandlerError>> + 'static,
{
    let scenario: Scenario = Arc::new(move |cx| Box::pin(scenario(cx)));
    let mut registry = Registry::new();
    vss::register(&mut registry, sources());
    sorma::daemon::register(&mut registry, sorma::Dictionary::new(), |_, sorm| {
        vss::services::register(sorm);
    });
    registry.handler("test.mirrors", &[OrderLaser::INFO], |_| Ok(Mirrors));
    registry.handler("test.client", &[], move |_| Ok(Client(scenario.clone())));
    registry
}

fn run<F, Fut>(scenario: F) -> String
where
    F: Fn(Context) -> Fut + Send + Sync + 'static,
    Fut: Future<Output = Result<String, HandlerError>> + 'static,
{
    let registry = registry(scenario);
    let app = load(APP);
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

async fn ask<C: Command>(cx: &Context, task: &str, request: C) -> Result<C::Reply, HandlerError> {
    let task = cx.task(task).await?;
    let answer = cx
        .call(&task, request)
        .deadline(Duration::from_secs(60))
        .await;
    answer.map_err(|error| HandlerError::new(error.reason()))
}

/// The spot that a camera sees, or what is in the way.
async fn find_spot(cx: &Context, camera: &str) -> Result<SpotReport, VisionError> {
    let camera = camera.to_owned();
    let vsm = cx.task("vsm").await?;
    let call = cx.call(&vsm, SpotFind { camera });
    call.deadline(Duration::from_secs(60)).await?
}

/// What an object of the app answers to a line of text.
async fn told(cx: &Context, line: &str) -> Result<sorma::Transport, HandlerError> {
    let say = sorma::daemon::Say {
        line: line.to_owned(),
        from: "a person".to_owned(),
        trace: 0,
    };
    let reply = ask(cx, "objects", say).await?.parse::<sorma::Reply>();
    let reply = reply.map_err(|error| HandlerError::new(error.to_string()))?;
    Ok(reply.body)
}

#[test]
fn one_line_of_text_has_a_camera_of_the_app_find_spots() {
    run(|cx| async move {
        // The noise makes small things that are no lamps.
        told(&cx, "spot CTRL -threshold 90 -min-area 5").await?;
        let seen = told(&cx, "spot EXEC camera left").await?;
        assert!(seen.is_ok(), "{:?}", seen.reports);
        assert!((seen.floats[0] - 41.3).hypot(seen.floats[1] - 30.8) < 0.2);
        assert_eq!(seen.ints[..2], [1, 0]);
        // The camera takes a second; the rest of the way takes little.
        let exposed = Duration::from_nanos(seen.ints[2].unsigned_abs());
        assert!(exposed >= Duration::from_secs(1) && exposed < cx.now().since_start());
        let again = told(&cx, "spot EXEC TMSG camera left").await?;
        assert_eq!(again.ints[..2], [1, 1]);
        let dark = told(&cx, "spot EXEC camera dark").await?;
        assert_eq!((dark.code, dark.ints[0]), (0, 0));
        assert!(dark.reports[0].text.contains("has no spot"), "{dark:?}");
        for (line, why) in [
            (
                "spot EXEC camera leftt",
                "no camera is called `leftt`; there are: ",
            ),
            ("spot EXEC camera broken", "no signal"),
        ] {
            let refused = told(&cx, line).await?;
            assert_eq!(refused.code, vss::services::code::CAMERA);
            assert!(refused.reports[0].text.contains(why), "{refused:?}");
            assert!(refused.floats.is_empty() && refused.ints.is_empty());
        }
        // Another tool than this app's is named with the task that is not there.
        told(&cx, "spot CTRL -tool toolSnip").await?;
        let refused = told(&cx, "spot EXEC camera left").await?;
        assert!(refused.reports[0].text.contains("toolSnip"), "{refused:?}");
        Ok(String::new())
    });
}

#[test]
fn the_table_of_lights_is_answered_in_the_app_as_without_one() {
    run(|cx| async move {
        let refused = told(&cx, "resect EXEC lights.csv").await?;
        assert!(refused.reports[0].text.contains("-size W H"), "{refused:?}");
        let folder = tempfile::tempdir().map_err(|error| HandlerError::new(error.to_string()))?;
        let path = folder.path().join("lights.csv");
        let mut table = String::from("X,Y,Z,u,v\n");
        // A camera at the origin that looks along z: u = 500 x/z + 320, v = 510 y/z + 240.
        for k in 0..40 {
            let at = f64::from(k);
            let (x, y, z) = (
                (at * 1.3).sin(),
                (at * 2.1).cos() * 0.8,
                3.0 + (at * 0.7).sin(),
            );
            let (u, v) = (500.0 * x / z + 320.0, 510.0 * y / z + 240.0);
            table += &format!("{x:?},{y:?},{z:?},{u:?},{v:?}\n");
        }
        std::fs::write(&path, table).map_err(|error| HandlerError::new(error.to_string()))?;
        told(&cx, "resect CTRL -size 640 480 -model none").await?;
        let found = told(&cx, &format!("resect EXEC {}", path.display())).await?;
        assert!(found.is_ok(), "{:?}", found.reports);
        for (found, true_value) in found.floats.iter().zip([500.0, 510.0, 320.0, 240.0]) {
            assert!((found - true_value).abs() < 1e-3, "{found} {true_value}");
        }
        Ok(String::new())
    });
}

#[test]
fn a_spot_is_found_shown_and_marked_through_the_services_manager() {
    run(|cx| async move {
        let report = find_spot(&cx, "left").await?;
        assert!((report.u - 41.3).hypot(report.v - 30.8) < 0.1, "{report:?}");
        assert_eq!((report.camera.as_str(), report.frame), ("left", 0));
        assert!(report.sd_u > 0.0 && report.sd_u < 0.1);
        let shown = ask(
            &cx,
            "vmImageDisp",
            WhatIsShown {
                camera: "left".into(),
            },
        )
        .await?
        .unwrap();
        assert_eq!((shown.frame.width, shown.marks.len()), (100, 1));
        assert_eq!(shown.marks[0].u, report.u);
        Ok(String::new())
    });
}

#[test]
fn two_cameras_work_at_the_same_time_and_one_camera_in_turn() {
    run(|cx| async move {
        let begin = cx.now();
        let (left, right) = join(find_spot(&cx, "left"), find_spot(&cx, "right")).await;
        assert!((left?.u - 41.3).abs() < 0.1);
        assert!((right?.u - 12.25).abs() < 0.1);
        let took = (cx.now() - begin).as_secs_f64();
        assert!((1.0..1.5).contains(&took), "{took}");
        let begin = cx.now();
        let reports = join_all((0..4).map(|_| find_spot(&cx, "left"))).await;
        let frames: Result<Vec<u64>, HandlerError> =
            reports.into_iter().map(|r| Ok(r?.frame)).collect();
        let mut frames = frames?;
        frames.sort_unstable();
        assert_eq!(frames, [1, 2, 3, 4]);
        let took = (cx.now() - begin).as_secs_f64();
        assert!((4.0..4.5).contains(&took), "{took}");
        Ok(String::new())
    });
}

#[test]
fn a_pair_of_cameras_sees_at_the_same_moment() {
    run(|cx| async move {
        let begin = cx.now();
        let pair = |left: &str, right: &str| FindPair {
            cameras: [left.to_owned(), right.to_owned()],
        };
        let [left, right] = ask(&cx, "vsm", pair("left", "right")).await??;
        assert_eq!(
            (left.camera.as_str(), right.camera.as_str()),
            ("left", "right")
        );
        assert!((left.u - 41.3).abs() < 0.1 && (right.u - 12.25).abs() < 0.1);
        assert!(left.stamp.abs_diff(right.stamp) < Duration::from_millis(10));
        let took = (cx.now() - begin).as_secs_f64();
        assert!((1.0..1.5).contains(&took), "{took}");
        let refused = ask(&cx, "vsm", pair("left", "dark")).await?;
        assert_eq!(refused.unwrap_err().outcome, Outcome::Unseen);
        Ok(String::new())
    });
}

#[test]
fn what_cannot_be_done_is_refused_with_the_reason() {
    run(|cx| async move {
        let mut reasons = BTreeMap::new();
        for (camera, outcome) in [
            ("dark", Outcome::Unseen),
            ("broken", Outcome::Fault),
            ("lfet", Outcome::Refused),
        ] {
            let refused = find_spot(&cx, camera).await.unwrap_err();
            assert_eq!(refused.outcome, outcome, "{refused}");
            reasons.insert(camera, refused.to_string());
        }
        assert!(
            reasons["dark"].starts_with("camera `dark`: nothing stands out: brightest"),
            "{reasons:?}"
        );
        assert_eq!(reasons["broken"], "frame source `broken`: no signal");
        assert!(
            reasons["lfet"]
                .contains("no camera is called `lfet`; there are: broken, dark, left, right")
        );
        // The hardware was given back after the fault.
        let again = find_spot(&cx, "broken").await.unwrap_err();
        assert_eq!(again.to_string(), reasons["broken"]);
        Ok(String::new())
    });
}

#[test]
fn hardware_that_is_never_given_back_goes_on_after_the_limit() {
    run(|cx| async move {
        ask(
            &cx,
            "vmm",
            AcquireVm {
                vm: "vmSnap.left".into(),
            },
        )
        .await?;
        let begin = cx.now();
        let report = find_spot(&cx, "left").await?;
        let took = (cx.now() - begin).as_secs_f64();
        assert!((4.0..4.5).contains(&took), "limit 3 s, picture 1 s: {took}");
        assert_eq!(report.frame, 0);
        let unknown = ask(
            &cx,
            "vmm",
            AcquireVm {
                vm: "vmSnap.lfet".into(),
            },
        )
        .await
        .unwrap_err();
        assert!(
            unknown
                .to_string()
                .contains("no Vision Module is called `vmSnap.lfet`")
        );
        Ok(String::new())
    });
}

/// One client is an object that is told by text, the other one a task that asks the manager itself.
#[test]
fn two_clients_do_not_steer_a_scanner_at_once_and_who_lost_it_is_told() {
    run(|cx| async move {
        let vm = || "vmLaser.roof".to_owned();
        let done = told(&cx, "laser CTRL -name roof -gain 0.1 0.1").await?;
        assert!(done.is_ok(), "{:?}", done.reports);
        let pointed = told(&cx, "laser EXEC point FMSG 3 0.1 0 1").await?;
        assert!(pointed.is_ok(), "{:?}", pointed.reports);
        let spot = LaserOrder::Spot([pointed.floats[0], pointed.floats[1]]);
        let ordered = || orders(&cx).lock().unwrap().clone();
        assert_eq!(ordered(), [("roof".to_owned(), spot)]);
        // It is held meanwhile, and its holder may go on.
        let vmm = cx.task("vmm").await?;
        let call = cx.call(&vmm, AcquireVm { vm: vm() });
        assert!(call.deadline(Duration::from_secs(1)).await.is_err());
        assert!(told(&cx, "laser EXEC draw FMSG 4 0 0 1 0").await?.is_ok());
        assert_eq!(ordered().len(), 2);
        // After the limit of 3 s it goes to whoever waits, and the object learns that with its next order.
        let grant = ask(&cx, "vmm", AcquireVm { vm: vm() }).await?;
        let mine = LaserOrder::Spot([0.5, 0.25]);
        ask(&cx, &vm(), SteerLaser { grant, order: mine }).await?;
        let lost = told(&cx, "laser EXEC draw FMSG 4 0 0 2 0").await?;
        let text = &lost.reports[0].text;
        assert!(
            text.contains("another client has the scanner `roof` now"),
            "{text}"
        );
        assert_eq!(ordered().last(), Some(&("roof".to_owned(), mine)));
        // Given back, it is free for the object at once.
        ask(&cx, "vmm", ReleaseVm { grant }).await?;
        let begin = cx.now();
        assert!(told(&cx, "laser EXEC off").await?.is_ok());
        assert!((cx.now() - begin).as_secs_f64() < 1.0);
        assert_eq!(
            ordered().last(),
            Some(&("roof".to_owned(), LaserOrder::Off))
        );
        let grant = ask(&cx, "vmm", AcquireVm { vm: vm() }).await?;
        ask(&cx, "vmm", ReleaseVm { grant }).await?;
        // A scanner that the app does not have.
        told(&cx, "laser CTRL -name cellar").await?;
        let none = told(&cx, "laser EXEC off").await?;
        let text = &none.reports[0].text;
        assert!(
            text.contains("no Vision Module is called `vmLaser.cellar`"),
            "{text}"
        );
        Ok(String::new())
    });
}

/// Left at (41.3, 30.8) and right at (12.25, 66.5): cameras whose rays there meet at a point, and such as stand side by side.
#[test]
fn a_spot_that_two_cameras_of_the_app_see_is_triangulated_or_refused() {
    run(|cx| async move {
        let lens = "100 100 50 40 0 0 0 0 0";
        let alone = told(&cx, "triangulate EXEC cameras left right").await?;
        assert!(
            alone.reports[0].text.contains("-left"),
            "{:?}",
            alone.reports
        );
        // The point (0, 0, 2) of the left camera's frame turned into the world: both look along z.
        let of = |u: f64, v: f64| ((u - 50.0) / 100.0 * 2.0, (v - 40.0) / 100.0 * 2.0);
        let (one, other) = (of(41.3, 30.8), of(12.25, 66.5));
        let line = format!(
            "triangulate CTRL -sd 0.5 -left {lens} 0 0 0 {} {} 0 -right {lens} 0 0 0 {} {} 0",
            one.0, one.1, other.0, other.1
        );
        assert!(told(&cx, &line).await?.is_ok());
        let found = told(&cx, "triangulate EXEC cameras left right").await?;
        assert!(found.is_ok(), "{:?}", found.reports);
        let floats = &found.floats;
        assert_eq!(floats.len(), 8);
        for (k, truth) in [0.0, 0.0, 2.0].iter().enumerate() {
            assert!(
                (floats[k] - truth).abs() < 4.0 * floats[3 + k],
                "{floats:?}"
            );
        }
        assert!(floats[6] < 4.0 * floats[7], "{floats:?}");
        // Principal points at which both pixels are seen in the same direction.
        let line = "triangulate CTRL -left 100 100 50 40 0 0 0 0 0 0 0 0 0 0 0 -right 100 100 20.95 75.7 0 0 0 0 0 0 0 0 0.5 0 0";
        assert!(told(&cx, line).await?.is_ok());
        let parallel = told(&cx, "triangulate EXEC cameras left right").await?;
        assert!(!parallel.is_ok() && parallel.floats.is_empty());
        let text = &parallel.reports[0].text;
        assert!(
            text.contains("`left` and `right`: the rays are parallel"),
            "{text}"
        );
        let gone = told(&cx, "triangulate EXEC cameras left dark").await?;
        assert!(
            gone.reports[0].text.contains("see no spot at once"),
            "{:?}",
            gone.reports
        );
        Ok(String::new())
    });
}

fn light_table(camera: &Camera) -> Vec<LightPoint> {
    let at = |k: usize| {
        Point3::new(
            (k % 4) as f64 * 0.3 - 0.45,
            (k / 4 % 4) as f64 * 0.2 - 0.3,
            (k / 16) as f64 * 0.25,
        )
    };
    let see = |p: Point3<f64>| {
        let pixel = camera.project(&p).unwrap();
        LightPoint {
            x: p.x,
            y: p.y,
            z: p.z,
            u: pixel.x,
            v: pixel.y,
        }
    };
    (0..64).map(at).map(see).collect()
}

#[test]
fn the_calibrate_service_answers_with_the_camera_or_the_reason() {
    run(|cx| async move {
        let truth = Camera {
            rotation: UnitQuaternion::from_axis_angle(&Vector3::x_axis(), 3.0),
            centre: Point3::new(0.1, 0.2, 2.5),
            intrinsics: Intrinsics {
                fx: 500.0,
                fy: 505.0,
                cx: 250.0,
                cy: 245.0,
            },
            distortion: Distortion {
                k1: -0.1,
                ..Distortion::default()
            },
        };
        let points = light_table(&truth);
        let request = |points| Calibrate {
            camera: "left".into(),
            width: 500,
            height: 500,
            points,
            seed: 7,
        };
        let found = ask(&cx, "vsm", request(points.clone())).await?;
        assert!(found.camera.error_against(&truth).position_m < 1e-6);
        let refused = ask(&cx, "vsm", request(points[..16].to_vec()))
            .await
            .unwrap_err();
        assert!(
            refused
                .to_string()
                .starts_with("camera `left`: the light positions lie in one plane"),
            "{refused}"
        );
        Ok(String::new())
    });
}

#[test]
fn the_same_seed_gives_the_same_spots_to_the_last_bit() {
    let spots = || {
        run(|cx| async move {
            let left = find_spot(&cx, "left").await?;
            let right = find_spot(&cx, "right").await?;
            Ok(format!("{left:?} {right:?}"))
        })
    };
    assert_eq!(spots(), spots());
}

#[test]
fn arguments_that_no_handler_takes_are_found_before_anything_starts() {
    let found = |from: &str, to: &str| {
        let app = load(&APP.replacen(from, to, 1));
        let registry = registry(|_| async { Ok(String::new()) });
        registry
            .check(&app)
            .iter()
            .map(ToString::to_string)
            .collect::<Vec<_>>()
    };
    let source = found("source = \"test.camera\"", "source = \"test.camrea\"");
    assert_eq!(
        source,
        [
            "app.toml:17:10: error: no frame source is called `test.camrea` (did you mean `test.camera`?)"
        ]
    );
    let key = found("u = 41.3, v", "uu = 41.3, v");
    assert_eq!(
        key,
        [
            "app.toml:18:10: error: camera `left` gives `args.uu`, and its frame source `test.camera` does not read it (did you mean `u`?)"
        ]
    );
    let scanner = found("task = \"mirrors\"", "task = \"mirors\"");
    assert!(
        scanner[0].contains("there is no task `mirors`, which drives the scanner `roof`")
            && scanner[0].contains("did you mean `mirrors`?"),
        "{scanner:?}"
    );
    let options = found(
        "[vss.cameras.left]",
        "[vss.args.toolSpotFind]\nmax_sigma = 3.0\n[vss.cameras.left]",
    );
    assert!(
        options[0].starts_with("app.toml:17:1: error:") && options[0].contains("max_sigma_px"),
        "{options:?}"
    );
    let file = found(
        "[vss.cameras.left]",
        "[vss.args.vmSpotDisp]\nfile = 3\n[vss.cameras.left]",
    );
    assert!(file[0].starts_with("app.toml:17:"), "{file:?}");
}

#[test]
fn a_marked_picture_is_written_where_the_configuration_says() {
    let folder = tempfile::tempdir().unwrap();
    let pattern = folder.path().join("out/{camera}.png");
    let text = APP.replace(
        "[vss.cameras.left]",
        &format!(
            "[vss.args.vmSpotDisp]\nfile = '{}'\n[vss.cameras.left]",
            pattern.display()
        ),
    );
    let registry = registry(|cx| async move {
        let report = find_spot(&cx, "left").await?;
        Ok(format!("{} {}", report.u.round(), report.v.round()))
    });
    let launcher = Launcher {
        program: "unused".into(),
        arguments: Vec::new(),
    };
    let outcome = boot(
        load(&text),
        registry,
        &launcher,
        &(Arc::new(|_: &_| ()) as _),
    )
    .unwrap();
    assert!(
        matches!(outcome.end, End::Finished(AppResult { ok: true, .. })),
        "{outcome:?}"
    );
    let bytes = std::fs::read(folder.path().join("out/left.png")).unwrap();
    let picture = vss::image::read(&bytes).unwrap();
    assert_eq!((picture.width, picture.height), (100, 80));
    let arm = picture.pixels[31 * 100 + 41 + 5];
    assert_eq!(arm, 255, "the marker's right arm");
}
