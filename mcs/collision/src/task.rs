//! The event handler `mcs.collision`: tells what the guards of the arms on its chassis found, to whoever asks and in the
//! log.

use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

use ctos::config::{App, TaskConfig};
use ctos::diagnostic::{Finding, Findings as Wrong};
use ctos::message::{Command, Message};
use ctos::registry::Registry;
use ctos::task::{Context, EventHandler, Handled, Phase};
use serde::{Deserialize, Serialize};

use crate::guard::{Findings, Found, KIND, Surroundings};

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
        if let Some(other) = app.tasks.iter().find(|other| other.name == *servo) {
            check_rooms(other, wrong);
        }
    }
}

/// The pieces of a room, and whose recipe has them.
type Room = (String, BTreeMap<String, String>);

/// Warns of what one recipe of a servo says of the room, and another one otherwise or not at all: an arm that one of them watches
/// runs into what only the other knows.
fn check_rooms(servo: &TaskConfig, wrong: &mut Wrong) {
    let Some(guards) = servo.args.get("guards") else {
        return;
    };
    let recipes = guards.entries().iter().filter_map(|recipe| {
        let kind = recipe.value.get("kind")?.as_str()?;
        // What is wrong with it, its servo says.
        let around = Surroundings::read(recipe.value.get("args")?).ok()?;
        let mut room: BTreeMap<String, String> = BTreeMap::new();
        for (piece, solid) in around.room {
            *room.entry(piece).or_default() += &format!("{solid:?};");
        }
        (kind == KIND).then(|| (recipe.key.clone(), room))
    });
    let recipes: Vec<Room> = recipes.collect();
    for (index, one) in recipes.iter().enumerate() {
        for other in recipes.iter().skip(index + 1) {
            for text in differences(one, other) {
                let key = format!("guards.{}", other.0);
                let place = servo
                    .args
                    .locate(&key)
                    .unwrap_or_else(|| servo.place.clone());
                let text = format!("task `{}`: {text}", servo.name);
                let finding = Finding::warning("mcs::collision::rooms", text).at(place);
                wrong.push(finding.help("say the same of the room in both recipes"));
            }
        }
    }
}

fn differences((one, here): &Room, (other, there): &Room) -> Vec<String> {
    let names: BTreeSet<&String> = here.keys().chain(there.keys()).collect();
    let differences =
        names
            .into_iter()
            .filter_map(|name| match (here.get(name), there.get(name)) {
                (Some(form), Some(same)) if form == same => None,
                (Some(_), Some(_)) => Some(format!(
                    "`{name}` has another form in the recipe `{one}` than in `{other}`"
                )),
                (Some(_), None) => Some(format!(
                    "the recipe `{other}` has no `{name}`, as `{one}` has"
                )),
                _ => Some(format!(
                    "the recipe `{one}` has no `{name}`, as `{other}` has"
                )),
            });
    differences.collect()
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_one_recipe_says_of_the_room_and_another_otherwise_or_not_at_all_is_named() {
        let room = |recipe: &str, pieces: &[(&str, &str)]| {
            let pieces = pieces.iter();
            let pieces = pieces.map(|(name, form)| ((*name).to_owned(), (*form).to_owned()));
            (recipe.to_owned(), pieces.collect())
        };
        let whole = room("collision", &[("floor", "a"), ("table", "b")]);
        assert!(differences(&whole, &room("clear", &[("table", "b"), ("floor", "a")])).is_empty());
        let found = differences(&whole, &room("clear", &[("post", "c"), ("table", "d")]));
        assert_eq!(
            found,
            [
                "the recipe `clear` has no `floor`, as `collision` has",
                "the recipe `collision` has no `post`, as `clear` has",
                "`table` has another form in the recipe `collision` than in `clear`",
            ]
        );
    }
}
