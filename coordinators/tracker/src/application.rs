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
use nalgebra::Point3;
use serde::Deserialize;
use sorma::snapshot::{Place, Reader, Snapshot};

use crate::{
    control,
    coordination::{ask, net_task},
    judging::{Judge, lines},
    learning::Learning,
    wire::{COURSE, CourseRecord, ReadSights, ReadTracker, TrueClock, seconds},
};

/// The handler's name.
pub const HANDLER: &str = "tracker.application";

/// How often records are read.
const LOOK: Duration = Duration::from_millis(200);

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
    /// The task of the net in front.
    #[serde(default = "net_task")]
    net: String,
    /// The snapshot buffer with the ball's true places, in the world; only a simulation has one.
    truth: Option<String>,
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

/// Registers the handler.
pub(crate) fn register(registry: &mut Registry) {
    let handler = registry.handler(HANDLER, &[], |cx| Ok(Application { args: cx.args()? }));
    handler.checked_args::<ApplicationArgs>(|args, task, app, findings| {
        let place = |key: &str| task.args.locate(key).unwrap_or_else(|| task.place.clone());
        let tasks = [
            ("druide", &args.druide),
            ("argus", &args.argus),
            ("client", &args.client),
            ("net", &args.net),
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
    order(cx, args, "track", "tracking").await?;
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
    // A client that is gone has told all the same.
    let sights = match cx.task(&args.client).await {
        Ok(client) => cx.call(&client, ReadSights {}).await.ok(),
        Err(_) => None,
    };
    order(cx, args, "stop", "stopped").await?;
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
        "max_error_m": verdict.max_error_m,
        "last_error_m": verdict.last_error_m,
        "estimate_rms_m": verdict.estimate_rms_m,
        "estimate_mean_m": verdict.estimate_mean_m,
        "servo_rms_m": verdict.servo_rms_m,
        "setpoint_median_s": verdict.setpoint_median_s,
        "setpoint_p99_s": verdict.setpoint_p99_s,
        "own_median_s": verdict.own_median_s,
        "own_p99_s": verdict.own_p99_s,
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
        "sights": sights,
        "unread": lost,
        "phase": format!("{:?}", report.phase),
        "stops": report.stops,
        "held": report.counts.held,
        "held_by": report.held_by,
        "grasped": report.grasped,
        "stopped": report.stopped,
    });
    Ok(AppResult {
        ok,
        text,
        json: json.to_string(),
    })
}

/// Has the arm learn the map, and tells how well it knows places between those that it has seen.
async fn learn(cx: &Context, args: &ApplicationArgs) -> Result<AppResult, HandlerError> {
    let druide = cx.task(&args.druide).await?;
    order(cx, args, "learn", "learns").await?;
    let learned = loop {
        cx.sleep(LOOK).await;
        match cx.call(&druide, ReadTracker {}).await?.learning {
            Learning::None | Learning::Underway => {}
            learned => break learned,
        }
    };
    let (examples, checked, rms) = match learned {
        Learning::Learned {
            examples,
            checked,
            rms_m,
        } => (examples, checked, rms_m),
        Learning::Failed(why) => return Err(HandlerError::new(why)),
        Learning::None | Learning::Underway => return Err("nothing was learned".into()),
    };
    let text = format!(
        "learned {examples} places; {checked} others are known within {:.2} mm rms\n",
        rms * 1e3
    );
    let json = serde_json::json!({
        "ok": true,
        "examples": examples,
        "checked": checked,
        "checked_rms_m": rms,
    });
    Ok(AppResult {
        ok: true,
        text,
        json: json.to_string(),
    })
}

/// Puts an order on the net's tape, which has to be answered so.
async fn order(
    cx: &Context,
    args: &ApplicationArgs,
    symbol: &str,
    success: &str,
) -> Result<(), HandlerError> {
    let answer = ask(cx, &args.net, symbol).await?;
    if answer.symbol == success {
        return Ok(());
    }
    let text = format!("`{symbol}`: {}: {}", answer.symbol, answer.text.trim_end());
    Err(HandlerError::new(text))
}
