//! The application: has druide follow the ball for a while and tells how well, or has the arm learn the map (SORMA technical report,
//! section 2.2.4). Ends the app with the answer.

use std::time::Duration;

use ctos::{
    diagnostic::Finding,
    message::Message,
    registry::Registry,
    system::AppResult,
    task::{Context, EventHandler, Handled, HandlerError, Phase},
};
use mcs::client::{Manipulator, Move, PathKind, Target};
use nalgebra::{Isometry3, Matrix4, Point3, Translation3};
use serde::Deserialize;
use sorma::snapshot::{Place, Reader, Snapshot};

use crate::{
    control,
    judging::{Judge, lines},
    map::{Example, grid},
    wire::{
        BLOB, BlobRecord, COURSE, CourseRecord, LearnMap, LocateBlob, ReadTracker, StartTracking,
        StopTracking, TrueClock, seconds,
    },
};

/// The handler's name.
pub const HANDLER: &str = "tracker.application";

/// How often records are read.
const LOOK: Duration = Duration::from_millis(200);

/// How long a motion of the arm may take.
const LONGEST_MOVE: Duration = Duration::from_secs(60);

/// How long an arm that has arrived is left alone, so that pictures are of where it is.
const STILL: Duration = Duration::from_millis(600);

/// A place without a ball is given up after this.
const PATIENCE: Duration = Duration::from_secs(20);

/// How long taking the arm, and giving it back, may take.
const CHANGE: Duration = Duration::from_secs(40);

/// Arguments.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
struct ApplicationArgs {
    /// What it does.
    #[serde(default)]
    mode: Mode,
    /// For how long the ball is followed, s; for ever with 0.
    #[serde(default = "a_minute")]
    seconds: f64,
    /// The task that moves the arm.
    #[serde(default = "druide_task")]
    druide: String,
    /// The task that looks.
    #[serde(default = "argus_task")]
    argus: String,
    /// The task that tells places from blobs.
    #[serde(default = "client_task")]
    client: String,
    /// The client interface of the arm, which a map is learned with.
    #[serde(default = "mcs_task")]
    mcs: String,
    /// The snapshot buffer with the ball's true places, in the world; only a simulation has one.
    truth: Option<String>,
    /// How far a map reaches to both sides, m along the axes of the tool.
    #[serde(default = "half")]
    grid_m: [f64; 3],
    /// So many pictures are taken at each place of a map.
    #[serde(default = "pictures")]
    pictures: usize,
    /// Fraction of full speed between the places of a map.
    #[serde(default = "speed")]
    speed: f64,
}

/// What the application does.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Deserialize)]
#[serde(rename_all = "snake_case")]
enum Mode {
    /// Follows the ball.
    #[default]
    Track,
    /// Learns the map with a ball that rests.
    Learn,
}

fn a_minute() -> f64 {
    60.0
}

fn druide_task() -> String {
    "druide".to_owned()
}

fn argus_task() -> String {
    "argus".to_owned()
}

fn client_task() -> String {
    "client".to_owned()
}

fn mcs_task() -> String {
    "mcs".to_owned()
}

fn half() -> [f64; 3] {
    [0.08, 0.08, 0.06]
}

fn pictures() -> usize {
    12
}

fn speed() -> f64 {
    0.3
}

/// Registers the handler.
pub(crate) fn register(registry: &mut Registry) {
    let handler = registry.handler(HANDLER, &[], |cx| Ok(Application { args: cx.args()? }));
    handler.checked_args::<ApplicationArgs>(|args, task, app, findings| {
        let place = |key: &str| task.args.locate(key).unwrap_or_else(|| task.place.clone());
        let tasks = [
            ("druide", &args.druide),
            ("argus", &args.argus),
            ("client", &args.client),
            ("mcs", &args.mcs),
        ];
        for (key, name) in tasks {
            if app.task(name).is_none() {
                let names = app.tasks.iter().map(|task| task.name.as_str());
                let text = format!("`{key}` names `{name}`, which is no task");
                let finding = Finding::error("ctos::config::unknown_task", text);
                findings.push(finding.at(place(key)).suggest(name, names));
            }
        }
        let mut refuse = |key: &str, text: String, help: &str| {
            let finding = Finding::error("coordinators::tracker::application", text);
            findings.push(finding.at(place(key)).help(help));
        };
        if !(0.0..=1e6).contains(&args.seconds) {
            let text = format!("`seconds` is {}", args.seconds);
            refuse("seconds", text, "give a number of seconds, 0 for ever");
        }
        if !args.grid_m.iter().all(|half| (0.005..=0.5).contains(half)) {
            let text = format!("`grid_m` is {:?}", args.grid_m);
            refuse("grid_m", text, "give three numbers from 0.005 to 0.5");
        }
        if !(args.speed > 0.0 && args.speed <= 1.0) {
            let text = format!("`speed` is {}", args.speed);
            refuse("speed", text, "give a number above 0, up to 1");
        }
        if args.pictures == 0 {
            refuse("pictures", "`pictures` is 0".to_owned(), "give 1 or more");
        }
    });
}

struct Application {
    args: ApplicationArgs,
}

impl EventHandler for Application {
    async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
        cx.default_processing(message)
    }

    async fn phase(&mut self, cx: &Context, phase: Phase) -> Handled {
        if phase == Phase::Run {
            let (own, args) = (cx.clone(), self.args.clone());
            cx.spawn(async move {
                own.reads_unrecorded("what the tracker leaves");
                let result = match args.mode {
                    Mode::Track => track(&own, &args).await,
                    Mode::Learn => learn(&own, &args).await,
                };
                own.finish(result.unwrap_or_else(|error| failure(&error)));
            });
        }
        Ok(())
    }
}

fn failure(error: &HandlerError) -> AppResult {
    let reason = error.to_string();
    AppResult {
        ok: false,
        json: serde_json::json!({ "ok": false, "reason": reason }).to_string(),
        text: reason,
    }
}

/// Follows the ball, and tells how well.
async fn track(cx: &Context, args: &ApplicationArgs) -> Result<AppResult, HandlerError> {
    let place = Place::of_app(&cx.app().name)?;
    let druide = cx.task(&args.druide).await?;
    let argus = cx.task(&args.argus).await?;
    let mut judge = Judge::new();
    let clocks = (
        cx.call(&druide, TrueClock {}).await?,
        cx.call(&argus, TrueClock {}).await?,
    );
    judge.know_clocks(clocks.0, clocks.1);
    cx.call(&druide, StartTracking {}).deadline(CHANGE).await?;
    let mut course = Reader::open(&place, COURSE)?;
    let mut truth = match &args.truth {
        Some(buffer) => Some(Reader::open(&place, buffer)?),
        None => None,
    };
    let clock = cx.chassis().clock().clone();
    let (mut record, begin) = (Snapshot::default(), cx.now());
    let span = Duration::from_secs_f64(args.seconds);
    let mut lost = 0;
    while span.is_zero() || cx.now().since(begin) < span {
        cx.sleep(LOOK).await;
        if cx.is_stopping() {
            break;
        }
        if let Some(truth) = &mut truth {
            while truth.next(&mut record)?.is_some() {
                if let [x, y, z] = record.floats[..] {
                    judge.ball(seconds(record.at(&clock)), Point3::new(x, y, z));
                }
            }
        }
        while let Some(missed) = course.next(&mut record)? {
            lost += missed;
            if let Some(record) = CourseRecord::from_floats(&record.floats) {
                judge.course(&record);
            }
        }
    }
    let report = cx.call(&druide, ReadTracker {}).await?;
    cx.call(&druide, StopTracking {}).deadline(CHANGE).await?;
    let verdict = judge.verdict();
    let mut text = lines(&verdict, &report.counts);
    if let Some(why) = &report.stopped {
        text += &format!("{:>16}  {} times, last: {why}\n", "stopped", report.stops);
    }
    if truth.is_none() {
        text += "Nobody knows where the ball truly was: the errors mean nothing.\n";
    }
    // A hand that stands where something stopped it follows nothing.
    let ok = report.counts.used > 0 && report.phase != control::Phase::Stopped;
    let json = serde_json::json!({
        "ok": ok,
        "seconds": verdict.seconds,
        "tracked": verdict.tracked,
        "rms_m": verdict.rms_m,
        "p95_m": verdict.p95_m,
        "estimate_rms_m": verdict.estimate_rms_m,
        "estimate_mean_m": verdict.estimate_mean_m,
        "servo_rms_m": verdict.servo_rms_m,
        "max_force_n": verdict.max_force_n,
        "max_acceleration_ratio": verdict.max_acceleration_ratio,
        "max_step_m_s": verdict.max_step_m_s,
        "clock_error_s": verdict.clock_error_s,
        "clock_bound_s": verdict.clock_bound_s,
        "clock_within": verdict.clock_within,
        "clock_restarts": report.clock_restarts,
        "expired": report.counts.expired,
        "lost": report.counts.lost,
        "used": report.counts.used,
        "late": report.counts.late,
        "far": report.counts.far,
        "unplaced": report.unplaced,
        "unread": lost,
        "phase": format!("{:?}", report.phase),
        "stops": report.stops,
        "stopped": report.stopped,
    });
    Ok(AppResult {
        ok,
        text,
        json: json.to_string(),
    })
}

/// Takes the hand through a grid around where it is, and learns the map of what it sees.
async fn learn(cx: &Context, args: &ApplicationArgs) -> Result<AppResult, HandlerError> {
    let arm = Manipulator::find(cx, &args.mcs).await?;
    arm.acquire().await?;
    let learned = learn_with(cx, args, &arm).await;
    // Whatever was seen, the arm is given back.
    arm.release().await?;
    learned
}

async fn learn_with(
    cx: &Context,
    args: &ApplicationArgs,
    arm: &Manipulator,
) -> Result<AppResult, HandlerError> {
    let home = pose(&arm.position().await?.base_t_tool);
    let client = cx.task(&args.client).await?;
    let mut examples = Vec::new();
    let places = grid(args.grid_m);
    let all = places.len() as u64;
    for (done, [x, y, z]) in (0..).zip(places) {
        cx.progress(done, all, "learn", "the ball from each place of the grid");
        // The ball is to be at (x, y, z) from its nominal place, so the hand goes the other way.
        let there = home * Translation3::new(-x, -y, -z);
        examples.push(example(cx, args, arm, &home, &there).await?);
    }
    let request = LearnMap {
        examples: examples.clone(),
    };
    cx.call(&client, request).await?;
    // Held against places between those of the grid.
    let mut squares = Vec::new();
    for [x, y, z] in grid(args.grid_m.map(|half| 0.5 * half))
        .into_iter()
        .step_by(5)
    {
        let there = home * Translation3::new(-x, -y, -z);
        let between = example(cx, args, arm, &home, &there).await?;
        let seen = between.seen;
        let found = cx.call(&client, LocateBlob { seen }).await?;
        let (found, _) = found.ok_or("the map does not know a place between its examples")?;
        let off = Point3::from(found) - Point3::from(between.place);
        squares.push(off.norm_squared());
    }
    move_to(arm, args, &home).await?;
    let rms = (squares.iter().sum::<f64>() / squares.len().max(1) as f64).sqrt();
    let text = format!(
        "learned {} places; {} others are known within {:.2} mm rms\n",
        examples.len(),
        squares.len(),
        rms * 1e3
    );
    let json = serde_json::json!({
        "ok": true,
        "examples": examples.len(),
        "checked": squares.len(),
        "checked_rms_m": rms,
    });
    Ok(AppResult {
        ok: true,
        text,
        json: json.to_string(),
    })
}

/// What is seen from a place, and where the hand should be, seen from there.
async fn example(
    cx: &Context,
    args: &ApplicationArgs,
    arm: &Manipulator,
    home: &Isometry3<f64>,
    there: &Isometry3<f64>,
) -> Result<Example, HandlerError> {
    move_to(arm, args, there).await?;
    cx.sleep(STILL).await;
    let mut reader = Reader::open(&Place::of_app(&cx.app().name)?, BLOB)?;
    let head = reader.head();
    reader.seek(head);
    let (mut record, mut sums, mut taken) = (Snapshot::default(), [0.0; 4], 0_usize);
    let until = cx.now() + PATIENCE;
    while taken < args.pictures {
        if cx.now() >= until {
            let place = there.translation.vector;
            let text = format!("no whole ball is seen from {place:.3?}");
            return Err(HandlerError::new(text));
        }
        cx.sleep(LOOK / 10).await;
        while taken < args.pictures && reader.next(&mut record)?.is_some() {
            let blob = BlobRecord::from_floats(&record.floats);
            if let Some(blob) = blob.filter(|blob| blob.sighting.doubts == 0) {
                let seen = blob.sighting.seen;
                let numbers = [seen.u, seen.v, seen.radius, seen.spread];
                for (sum, number) in sums.iter_mut().zip(numbers) {
                    *sum += number;
                }
                taken += 1;
            }
        }
    }
    // What counts is where the hand was.
    let measured = pose(&arm.position().await?.base_t_tool);
    let nominal = measured.inverse() * Point3::from(home.translation.vector);
    Ok(Example {
        place: nominal.coords.into(),
        seen: sums.map(|sum| sum / taken as f64),
    })
}

async fn move_to(
    arm: &Manipulator,
    args: &ApplicationArgs,
    to: &Isometry3<f64>,
) -> Result<(), HandlerError> {
    let mut rows = [0.0; 16];
    rows.copy_from_slice(to.to_homogeneous().transpose().as_slice());
    let request = Move {
        target: Target::Pose(rows),
        path: PathKind::Joint,
        speed: args.speed,
        acceleration: None,
        elbow: None,
        guards: Vec::new(),
        blend: 0.0.into(),
    };
    arm.go(request, LONGEST_MOVE).await?;
    Ok(())
}

/// A pose from 16 numbers, row by row.
fn pose(rows: &[f64; 16]) -> Isometry3<f64> {
    let matrix = Matrix4::from_row_slice(rows);
    nalgebra::try_convert(matrix).unwrap_or_else(Isometry3::identity)
}
