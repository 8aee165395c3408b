//! The event handler `mcs.collision`: tells what the guards of the arms on its chassis found, to whoever asks and in the
//! log.

use std::time::Duration;

use ctos::config::{App, TaskConfig};
use ctos::diagnostic::{Finding, Findings as Wrong};
use ctos::message::{Command, Message};
use ctos::registry::Registry;
use ctos::task::{Context, EventHandler, Handled, Phase};
use serde::{Deserialize, Serialize};

use crate::guard::{Findings, Found};

/// Its registered name.
pub const HANDLER: &str = "mcs.collision";

/// What one guard of an arm found.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ArmFindings {
    /// The servo's task.
    pub servo: String,
    /// Both solids of the pair that is nearest, and its distance, m; none before the first motion.
    pub nearest: Option<([String; 2], f64)>,
    /// How often a motion was found to end in a collision.
    pub stops: u64,
    /// The pair of the latest such motion.
    pub last: Option<[String; 2]>,
}

ctos::command! {
    /// Tells what the guards found, each of them; the nearest pair is as in the latest tick of the latest motion.
    #[derive(Debug, Clone, PartialEq)]
    pub struct ReadCollisions => Vec<ArmFindings>, 0x0351, "read_collisions"
}

/// Arguments of the event handler.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
struct Args {
    /// The servo tasks, on the same chassis, that have a guard of the kind `collision`.
    servos: Vec<String>,
    /// How often it looks, s.
    #[serde(default = "every_s")]
    every_s: f64,
}

fn every_s() -> f64 {
    0.1
}

/// Makes the handler known.
pub fn register(registry: &mut Registry) {
    registry
        .handler(HANDLER, &[ReadCollisions::INFO], |cx| {
            let args: Args = cx.args()?;
            Ok(Collisions { args })
        })
        .checked_args::<Args>(check);
}

fn check(args: &Args, task: &TaskConfig, app: &App, wrong: &mut Wrong) {
    let place = |key: &str| task.args.locate(key).unwrap_or_else(|| task.place.clone());
    if !(0.01..=60.0).contains(&args.every_s) {
        let text = format!("`every_s` is {}", args.every_s);
        let finding = Finding::error("mcs::out_of_range", text).at(place("every_s"));
        wrong.push(finding.help("give a value from 0.01 to 60"));
    }
    for servo in &args.servos {
        let here = |other: &&TaskConfig| other.chassis == task.chassis;
        if !app
            .tasks
            .iter()
            .filter(here)
            .any(|other| other.name == *servo)
        {
            let text = format!(
                "task `{}` finds no task `{servo}` on its chassis",
                task.name
            );
            let names = app
                .tasks
                .iter()
                .filter(here)
                .map(|other| other.name.as_str());
            let finding = Finding::error("mcs::unknown_part", text).at(place("servos"));
            wrong.push(finding.suggest(servo, names));
        }
    }
}

struct Collisions {
    args: Args,
}

fn told(servo: &str, findings: &Findings) -> ArmFindings {
    let Found {
        nearest,
        stops,
        last,
    } = findings.read();
    let names = |pair: usize| findings.names.get(pair).cloned().unwrap_or_default();
    ArmFindings {
        servo: servo.to_owned(),
        nearest: nearest.map(|(pair, distance)| (names(pair), distance)),
        stops,
        last: last.map(names),
    }
}

/// What every guard of every arm found.
fn read(cx: &Context, args: &Args) -> Vec<ArmFindings> {
    let servos = args.servos.iter();
    let told = servos.flat_map(|servo| {
        let all = Findings::of(cx, servo).into_iter();
        all.map(move |findings| told(servo, &findings))
    });
    told.collect()
}

/// Logs each motion that was stopped, once.
async fn watch(cx: Context, args: Args) {
    let mut before = Vec::new();
    loop {
        cx.sleep(Duration::from_secs_f64(args.every_s)).await;
        let all = read(&cx, &args);
        before.resize(all.len(), 0);
        for (found, before) in all.into_iter().zip(&mut before) {
            if found.stops > *before {
                let pair = found.last.unwrap_or_default().join(" and ");
                tracing::warn!(
                    task = cx.name(),
                    servo = found.servo,
                    pair,
                    "a motion would have ended in a collision"
                );
            }
            // A recipe that is changed counts anew.
            *before = found.stops;
        }
    }
}

impl EventHandler for Collisions {
    async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
        match message.command() {
            ReadCollisions::CODE => {
                let (ReadCollisions {}, reply) = message.open::<ReadCollisions>()?;
                reply.ok(read(cx, &self.args))
            }
            _ => cx.default_processing(message),
        }
    }

    async fn phase(&mut self, cx: &Context, phase: Phase) -> Handled {
        if phase == Phase::Run {
            cx.spawn(watch(cx.clone(), self.args.clone()));
        }
        Ok(())
    }
}
