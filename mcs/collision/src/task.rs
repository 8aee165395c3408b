//! The event handler `mcs.collision`: tells what the guards of the arms on its chassis found, to whoever asks and in the
//! log.

use std::sync::Arc;
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

/// What the guard of one arm found.
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
    /// Tells what the guards found; the nearest pair is as in the latest tick of the latest motion.
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

fn findings(cx: &Context, servo: &str) -> Option<Arc<Findings>> {
    cx.shared(&Findings::key(servo))
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

/// Logs each motion that was stopped, once.
async fn watch(cx: Context, args: Args) {
    let mut before = vec![0; args.servos.len()];
    loop {
        cx.sleep(Duration::from_secs_f64(args.every_s)).await;
        for (servo, before) in args.servos.iter().zip(&mut before) {
            let Some(findings) = findings(&cx, servo) else {
                continue;
            };
            let found = told(servo, &findings);
            if found.stops > *before {
                let pair = found.last.unwrap_or_default().join(" and ");
                tracing::warn!(
                    task = cx.name(),
                    servo,
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
                let servos = self.args.servos.iter();
                let all = servos.filter_map(|servo| Some(told(servo, &*findings(cx, servo)?)));
                reply.ok(all.collect())
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
