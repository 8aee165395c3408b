//! Stand-ins for devices: tasks that take as long for a step as was recorded, and succeed as often.
//!
//! The file of times says for each step what was recorded, where, and with which distribution it is drawn. A draw belongs
//! to the step, the job and the epoch, so a restart changes none. The step that sets the disc down changes the
//! [`world`], unless its epoch was settled meanwhile.
//!
//! It takes other arguments while it runs, and knows them after a kill where its state is durable.

use std::{
    collections::BTreeMap,
    path::Path,
    rc::Rc,
    sync::{Arc, OnceLock},
    time::Duration,
};

use ctos::{
    config::{App, Entry, Node, TaskConfig, Value},
    diagnostic::{Finding, Findings, Source},
    message::Replier,
    registry::Registry,
    task::{Context, Durable, Handled, HandlerError, Handover},
};
use rand::RngExt;
use rand_distr::{Distribution, Normal};
use serde::{Deserialize, Serialize};

use crate::{
    wire::{Configure, Do, Settle},
    world::{self, World},
};

/// The handler's name.
pub const HANDLER: &str = "fleet.stand_in";

/// The longest that a step may take, s.
const LONGEST_S: f64 = 3600.0;

/// A step, as it was recorded.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Step {
    /// The device of the cell that does it.
    pub by: String,
    /// Mean of its duration, s.
    pub mean_s: f64,
    /// Standard deviation, s.
    #[serde(default)]
    pub sd_s: f64,
    /// Nothing shorter is drawn, s.
    #[serde(default)]
    pub least_s: f64,
    /// Nothing longer is drawn, s.
    pub most_s: f64,
    /// The share of attempts that succeed.
    #[serde(default = "always")]
    pub succeeds: f64,
    /// Whether it changes the board for good.
    #[serde(default)]
    pub sets_down: bool,
}

fn always() -> f64 {
    1.0
}

/// The file of times.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Times {
    /// Where the numbers are from.
    pub source: String,
    /// The steps by their names.
    pub step: BTreeMap<String, Step>,
}

impl Times {
    /// Reads a file of an app.
    ///
    /// # Errors
    /// What is wrong with it, with its place.
    pub fn read(app: &App, file: &str) -> Result<Self, Findings> {
        let source = app.read(file)?;
        let mut findings = Findings::new();
        let root = ctos::config::Node::from_toml(&source, &mut findings);
        let times = root.parse_all::<Self>(&mut findings);
        for (name, step) in times.iter().flat_map(|times| &times.step) {
            let ordered = 0.0 <= step.least_s
                && step.least_s <= step.mean_s
                && step.mean_s <= step.most_s
                && step.most_s <= LONGEST_S
                && step.sd_s >= 0.0;
            if !ordered || !(0.0..=1.0).contains(&step.succeeds) {
                let text = format!("the times of step `{name}` make no sense");
                let help = "write 0 <= least_s <= mean_s <= most_s <= 3600, sd_s >= 0 and 0 <= succeeds <= 1";
                let finding = Finding::error("coordinators::fleet::times", text).help(help);
                findings.push(finding.at(root.locate(&format!("step.{name}"))));
            }
        }
        match times {
            Some(times) if !findings.has_errors() => Ok(times),
            _ => Err(findings),
        }
    }

    /// The same, read once for all tasks of a simulated app.
    ///
    /// # Errors
    /// What is wrong with it.
    pub fn shared(cx: &Context, file: &str) -> Result<Arc<Self>, HandlerError> {
        let path = Path::new("fleet times").join(file);
        let kept = cx.disk().and_then(|disk| disk.open::<OnceLock<_>>(&path));
        if let Some(times) = kept.as_ref().and_then(|kept| kept.get()) {
            return Ok(Arc::clone(times));
        }
        let times = Self::read(cx.app(), file).map_err(|findings| findings.to_string())?;
        let times = Arc::new(times);
        kept.inspect(|kept| _ = kept.set(Arc::clone(&times)));
        Ok(times)
    }
}

impl Step {
    /// Draws how long it takes, and whether it succeeds.
    fn draw(&self, rng: &mut impl rand::Rng) -> (Duration, bool) {
        let normal = Normal::new(self.mean_s, self.sd_s);
        let drawn = normal.map_or(self.mean_s, |normal| normal.sample(rng));
        let seconds = drawn.clamp(self.least_s, self.most_s);
        let luck: f64 = rng.random();
        (Duration::from_secs_f64(seconds), luck < self.succeeds)
    }
}

/// Arguments.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
struct Args {
    /// The file of times.
    times: String,
    /// The cell that it stands in.
    cell: String,
    /// The tasks that it asks before it does a step, which take no time.
    #[serde(default)]
    asks: Vec<String>,
}

/// Registers the handler.
pub(crate) fn register(registry: &mut Registry) {
    registry
        .durable(HANDLER, &StandIn::COMMANDS, |cx| {
            let given = Given::default();
            let (args, times) = given.read(cx)?;
            Ok(StandIn { args, times, given })
        })
        .checked_args::<Args>(check);
}

/// Arguments that were given while the task runs.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct Given {
    file: String,
    /// TOML; empty: none.
    text: String,
}

impl Given {
    /// What the task works with.
    fn read(&self, cx: &Context) -> Result<(Rc<Args>, Arc<Times>), HandlerError> {
        let wrong = |findings: Findings| HandlerError::new(findings.to_string());
        let task = cx
            .config()
            .ok_or("a stand-in stands in the configuration")?;
        let mut findings = Findings::new();
        let source = Source::new(self.file.as_str(), self.text.as_str());
        let laid = laid_over(task, &source, &mut findings);
        match laid.args.parse_all::<Args>(&mut findings) {
            Some(args) if !findings.has_errors() => {
                let times = Times::shared(cx, &args.times)?;
                Ok((Rc::new(args), times))
            }
            _ => Err(wrong(findings)),
        }
    }
}

/// A task with the arguments of a file over its own.
fn laid_over(task: &TaskConfig, source: &Source, findings: &mut Findings) -> TaskConfig {
    let new = Node::from_toml(source, findings);
    let keeps = |entry: &&Entry| new.entry(&entry.key).is_none();
    let kept = task.args.entries().iter().filter(keeps);
    let entries = kept.chain(new.entries()).cloned().collect();
    TaskConfig {
        args: Node::from(Value::Table(entries)),
        ..task.clone()
    }
}

/// Finds what is wrong with arguments that a task shall be given while it runs.
pub(crate) fn check_given(task: &TaskConfig, app: &App, source: &Source, findings: &mut Findings) {
    let laid = laid_over(task, source, findings);
    let Some(args) = laid.args.parse_all::<Args>(findings) else {
        return;
    };
    check(&args, &laid, app, findings);
}

fn check(args: &Args, task: &TaskConfig, app: &App, findings: &mut Findings) {
    // Tasks are many and the files few: a mistake in a file is told at the first task that reads it.
    let reads_it = |other: &&TaskConfig| {
        other.args.get("times").and_then(Node::as_str) == Some(args.times.as_str())
    };
    let first = app.tasks_with(HANDLER).find(reads_it);
    if first.is_none_or(|first| first.name == task.name)
        && let Err(found) = Times::read(app, &args.times)
    {
        findings.extend(found);
    }
    for (number, asked) in args.asks.iter().enumerate() {
        crate::need_task(task, app, &format!("asks.{number}"), asked, findings);
    }
}

/// The event handler.
struct StandIn {
    args: Rc<Args>,
    times: Arc<Times>,
    given: Given,
}

#[ctos::handler]
impl StandIn {
    #[command]
    fn step(&mut self, cx: &Context, request: Do, reply: Replier<Do>) -> Handled {
        let Do { step, job, epoch } = request;
        let known = self.times.step.get(&step).cloned();
        if known.is_none() && !step.is_empty() {
            return reply.fail(format!("no time was recorded for the step `{step}`"));
        }
        if known.is_none() && self.args.asks.is_empty() {
            return reply.ok(true);
        }
        let (here, args) = (cx.clone(), self.args.clone());
        cx.spawn(async move {
            let done: Result<bool, HandlerError> = async {
                for asked in &args.asks {
                    let to = here.task(asked).await?;
                    world::note(&here, World::message);
                    let asking = Do {
                        step: String::new(),
                        job,
                        epoch,
                    };
                    here.call(&to, asking).await?;
                }
                let Some(known) = known else {
                    return Ok(true);
                };
                let mut rng = here.rng(&format!("{step} {job} {epoch}"));
                let (lasts, succeeds) = known.draw(&mut rng);
                here.sleep(lasts).await;
                if !(succeeds && known.sets_down) {
                    return Ok(succeeds);
                }
                world::see(&here, "whether the disc was set down", |world| {
                    world.set_down(&args.cell, job, epoch)
                })
            }
            .await;
            // Answering never fails; who is gone needs no answer.
            let _ = match done {
                Ok(done) => reply.ok(done),
                Err(error) => reply.fail(error.to_string()),
            };
        });
        Ok(())
    }

    #[command]
    fn configure(
        &mut self,
        cx: &Context,
        configure: Configure,
    ) -> Result<Result<(), String>, HandlerError> {
        let Configure { file, text } = configure;
        let given = Given { file, text };
        Ok(match given.read(cx) {
            Ok(read) => {
                (self.args, self.times) = read;
                self.given = given;
                Ok(())
            }
            Err(error) => Err(error.to_string()),
        })
    }

    #[command]
    fn settle(&mut self, cx: &Context, settle: Settle) -> Result<bool, HandlerError> {
        let Settle { job, epoch } = settle;
        world::see(cx, "whether the disc lies where it shall", |world| {
            world.settle(&self.args.cell, job, epoch)
        })
    }
}

impl Handover for StandIn {
    type State = Given;

    fn hand_over(&mut self) -> Result<Given, HandlerError> {
        Ok(self.state())
    }

    fn take_over(&mut self, cx: &Context, given: Given) -> Handled {
        (self.args, self.times) = given.read(cx)?;
        self.given = given;
        Ok(())
    }
}

impl Durable for StandIn {
    fn state(&self) -> Given {
        self.given.clone()
    }
}

#[cfg(test)]
mod tests {
    use rand_chacha::{ChaCha8Rng, rand_core::SeedableRng};

    use super::*;

    #[test]
    fn drawn_times_have_the_recorded_mean_and_stay_within_what_was_recorded() {
        let step = Step {
            by: "arm".to_owned(),
            mean_s: 2.14,
            sd_s: 0.2,
            least_s: 1.9,
            most_s: 2.6,
            succeeds: 0.9,
            sets_down: false,
        };
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let drawn: Vec<(Duration, bool)> = (0..4000).map(|_| step.draw(&mut rng)).collect();
        let seconds = drawn.iter().map(|(lasts, _)| lasts.as_secs_f64());
        assert!(seconds.clone().all(|one| (1.9..=2.6).contains(&one)));
        let mean = seconds.sum::<f64>() / 4000.0;
        assert!((mean - 2.14).abs() < 0.03, "{mean}");
        let succeeded = drawn.iter().filter(|(_, ok)| *ok).count();
        assert!((3500..3700).contains(&succeeded), "{succeeded}");
    }
}
