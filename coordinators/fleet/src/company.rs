//! The company: issues jobs, gives each to a site for good, and hears how they ended. It rolls out new versions, sums up for
//! displays, and ends the app with what the referee counts.

use std::{
    cell::RefCell,
    collections::{BTreeMap, BTreeSet},
    rc::Rc,
    sync::Arc,
    time::Duration,
};

use ctos::{
    config::{App, TaskConfig},
    diagnostic::{Finding, Findings},
    message::Replier,
    registry::Registry,
    system::AppResult,
    task::{Context, Durable, Handled, HandlerError, Handover, Phase},
    time::Instant,
};
use scene_summary::{Decide, Step, SumUp};
use serde::{Deserialize, Serialize};

use crate::{
    agent::{self, CARRY, ask},
    operator::turn,
    rollout::{Plan, Rollout, Stage, What},
    stand_in,
    sums::{Jobs, Sums, decided},
    table,
    wire::{Attempt, Ended, Install, Job, JobNumber, Judge, Look, Outcome, Seek, Take, Turn},
    world,
};

/// The handler's name.
pub const HANDLER: &str = "fleet.company";

/// How often it looks what is to be done when nothing has happened.
const TURN: Duration = Duration::from_secs(1);

/// How long an answer is waited for.
const ANSWER: Duration = Duration::from_secs(5);

/// Whoever has asked for a summary within this time looks on.
const LOOKS_ON: Duration = Duration::from_secs(3);

/// So many turns pass between two looks at the sites while nobody looks on.
const SURVEY: u32 = 5;

/// How long a cell may take to install something, with the ways there and back.
const INSTALLED_WITHIN: Duration = Duration::from_secs(310);

/// Fields of a board in a row.
const FIELDS: u64 = 8;

/// Version that cells begin with, and the one that is rolled out.
const VERSIONS: (u64, u64) = (1, 2);

/// Arguments.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
struct Args {
    /// The trader that hears what sites offer.
    trader: String,
    /// So many jobs are issued for each cell.
    #[serde(default = "jobs_per_cell")]
    jobs_per_cell: u64,
    /// So many more jobs than it has cells a site is given at a time, as a share of its cells.
    #[serde(default = "spare")]
    spare: f64,
    /// The new version that goes out, if there is one. Jobs are issued as long as it is under way.
    rollout: Option<Plan>,
}

fn jobs_per_cell() -> u64 {
    5
}

fn spare() -> f64 {
    0.25
}

/// A job that a site has.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
struct Open {
    site: Arc<str>,
    /// Its number among those given to that site.
    number: u64,
    /// The site has it for sure.
    taken: bool,
}

/// What the company knows after a kill.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub(crate) struct State {
    /// How many jobs were issued.
    issued: u64,
    /// Jobs whose end is not known.
    open: BTreeMap<JobNumber, Open>,
    /// How many were given to each site.
    given: BTreeMap<String, u64>,
    carried: u64,
    failed: u64,
    attempts: u64,
    rollout: Option<Rollout>,
}

/// Registers the handler.
pub(crate) fn register(registry: &mut Registry) {
    registry
        .durable(HANDLER, &Company::COMMANDS, |cx| {
            Ok(Company {
                desk: Desk::new(cx, cx.args()?),
            })
        })
        .checked_args::<Args>(check);
}

fn check(args: &Args, task: &TaskConfig, app: &App, findings: &mut Findings) {
    crate::need_task(task, app, "trader", &args.trader, findings);
    let mut wrong = |key: &str, text: String, help: &str| {
        let place = task.args.locate(key).unwrap_or_else(|| task.place.clone());
        findings.push(
            Finding::error("coordinators::fleet::company", text)
                .at(place)
                .help(help),
        );
    };
    if args.jobs_per_cell == 0 {
        wrong(
            "jobs_per_cell",
            "no job is issued".to_owned(),
            "give 1 or more",
        );
    }
    if !(0.0..=100.0).contains(&args.spare) {
        let text = format!("`spare` is {}", args.spare);
        wrong("spare", text, "give a share from 0 to 100");
    }
    let Some(plan) = &args.rollout else { return };
    let shares = [("worse", plan.worse), ("error", plan.error)];
    for (key, share) in shares {
        if !(share > 0.0 && share <= 0.5) {
            let text = format!("`{key}` is {share}");
            wrong(
                &format!("rollout.{key}"),
                text,
                "give a share above 0, up to 0.5",
            );
        }
    }
    if plan.baseline == 0 || plan.first == 0 {
        let text = "`baseline` and `first` of a rollout are counts".to_owned();
        wrong("rollout", text, "give 1 or more");
    }
    let Some(what) = plan.what() else {
        let text = "a rollout does not say what goes out".to_owned();
        let help = "give `net` and `before`, or `task` and `args`";
        wrong("rollout", text, help);
        return;
    };
    let files = match what {
        What::Net { new, before } => vec![("net", new), ("before", before)],
        What::Args { file, .. } => vec![("args", file)],
    };
    for (key, file) in files {
        if let Err(finding) = app.read(file) {
            let place = task.args.locate(&format!("rollout.{key}"));
            findings.push(finding.at(place.unwrap_or_else(|| task.place.clone())));
        }
    }
    if let What::Args { task: of, file } = what {
        check_arguments(task, app, of, file, findings);
    }
}

/// Finds what is wrong with arguments that go out to a task of each cell. Cells are replicas: the first one tells.
fn check_arguments(task: &TaskConfig, app: &App, of: &str, file: &str, findings: &mut Findings) {
    let Some(agent) = app.tasks_with(agent::HANDLER).next() else {
        return;
    };
    let name = table::beside(&agent.name, of);
    crate::need_task(task, app, "rollout.task", &name, findings);
    let (Some(changed), Ok(source)) = (app.task(&name), app.read(file)) else {
        return;
    };
    let place = task.args.locate("rollout.task");
    let mut wrong = |text: String, help: &str| {
        let finding = Finding::error("coordinators::fleet::company", text).help(help);
        findings.push(finding.at(place.clone().unwrap_or_else(|| task.place.clone())));
    };
    if changed.handler != stand_in::HANDLER {
        let text = format!("task `{name}` takes no other arguments while it runs");
        wrong(text, "name a stand-in");
    } else if !changed.durable {
        let text = format!("task `{name}` would forget its new arguments when it is killed");
        wrong(text, "give it `state = \"durable\"`");
    } else {
        stand_in::check_given(changed, app, &source, findings);
    }
}

/// The event handler.
struct Company {
    desk: Desk,
}

/// What the handler and its children share.
#[derive(Clone)]
struct Desk {
    args: Rc<Args>,
    state: Rc<RefCell<State>>,
    seen: Rc<RefCell<Seen>>,
    /// So many jobs are issued at least.
    jobs: u64,
}

/// What is found again after a kill.
#[derive(Debug, Default)]
struct Seen {
    /// How many cells each site offers.
    sites: BTreeMap<String, u64>,
    /// What operators have told of their cells.
    sums: Sums,
    /// When somebody last asked for a summary.
    looked: Option<Instant>,
    /// Who looks on has seen the end.
    shown_end: bool,
    /// Sites that are just being given jobs.
    giving: BTreeSet<String>,
    /// Cells that are just being given an order.
    ordering: BTreeSet<String>,
    /// The app is over.
    finished: bool,
}

#[ctos::handler]
impl Company {
    #[phase]
    async fn enters(&mut self, cx: &Context, phase: Phase) -> Handled {
        if phase == Phase::Run {
            let here = cx.clone();
            cx.spawn(async move {
                loop {
                    turn(&here);
                    here.sleep(TURN).await;
                }
            });
            let (desk, here) = (self.desk.clone(), cx.clone());
            cx.spawn(async move { desk.survey_for_ever(&here).await });
        }
        Ok(())
    }

    #[command]
    async fn turn(&mut self, cx: &Context, _: Turn) -> Result<(), HandlerError> {
        self.desk.issue(cx);
        let state = self.desk.state.borrow().clone();
        cx.keep(&state).await?;
        self.desk.give(cx);
        self.desk.roll(cx).await?;
        self.desk.finish(cx)
    }

    /// Sites have more jobs than cells: the next ones have time until the next turn.
    #[command]
    fn ended(&mut self, cx: &Context, ended: Ended) {
        self.desk.ended(cx, &ended);
    }

    #[command]
    fn sum_up(&mut self, cx: &Context, SumUp { after }: SumUp) -> Step {
        let (state, mut seen) = (self.desk.state.borrow(), self.desk.seen.borrow_mut());
        seen.looked = Some(cx.now());
        seen.shown_end = !self.desk.is_open(&state) && state.open.is_empty();
        let rollout = self.desk.args.rollout.as_ref().zip(state.rollout.as_ref());
        let jobs = Jobs {
            issued: state.issued,
            open: state.open.len(),
            carried: state.carried,
            failed: state.failed,
            rollout,
        };
        seen.sums.since(after, &jobs, cx.now())
    }

    #[command]
    fn decide(&mut self, cx: &Context, decide: Decide, reply: Replier<Decide>) -> Handled {
        let Decide { key, choice, by } = decide;
        let (site, job, epoch, carried) = match decided(&key, &choice) {
            Ok(decided) => decided,
            Err(why) => return reply.fail(why),
        };
        tracing::info!(by, site, job, choice, "a person has said how a job ended");
        let here = cx.clone();
        cx.spawn(async move {
            let judge = Judge {
                job,
                epoch,
                carried,
            };
            // Answering never fails; who is gone needs no answer.
            let _ = match ask(&here, &site, judge, ANSWER).await {
                Ok(Ok(())) => reply.ok(format!("job {job}: {choice}")),
                Ok(Err(why)) => reply.fail(why),
                Err(error) => reply.fail(error.to_string()),
            };
        });
        Ok(())
    }
}

impl Desk {
    fn new(cx: &Context, args: Args) -> Self {
        let agents = cx.app().tasks_with(agent::HANDLER);
        let nets = agents.filter_map(|agent| {
            let net = agent.args.get("net")?.as_str()?;
            Some((agent.name.clone(), net.to_owned()))
        });
        let nets: BTreeMap<String, String> = nets.collect();
        let jobs = args.jobs_per_cell * u64::try_from(nets.len()).unwrap_or(0);
        let seen = Seen {
            sums: Sums::new(cx.now(), nets),
            ..Seen::default()
        };
        let rollout = args.rollout.is_some().then(|| Rollout::new(VERSIONS.1));
        let state = State {
            rollout,
            ..State::default()
        };
        Self {
            args: Rc::new(args),
            state: Rc::new(RefCell::new(state)),
            seen: Rc::new(RefCell::new(seen)),
            jobs,
        }
    }

    /// Whether jobs are still issued.
    fn is_open(&self, state: &State) -> bool {
        let rolling = state.rollout.as_ref().is_some_and(|one| !one.is_over());
        state.issued < self.jobs || rolling
    }

    /// Issues jobs to sites that have room.
    fn issue(&self, cx: &Context) {
        let (mut state, seen) = (self.state.borrow_mut(), self.seen.borrow());
        let mut has: BTreeMap<Arc<str>, u64> = BTreeMap::new();
        for open in state.open.values() {
            *has.entry(open.site.clone()).or_default() += 1;
        }
        for (site, cells) in &seen.sites {
            let name: Arc<str> = site.as_str().into();
            #[expect(
                clippy::cast_precision_loss,
                clippy::cast_possible_truncation,
                clippy::cast_sign_loss,
                reason = "cells are few, and shares not negative"
            )]
            let spare = (*cells as f64 * self.args.spare).ceil() as u64;
            let room = (cells + spare).saturating_sub(has.get(&*name).copied().unwrap_or(0));
            for _ in 0..room {
                if !self.is_open(&state) {
                    return;
                }
                state.issued += 1;
                let (number, given) = (state.issued, state.given.entry(site.clone()).or_default());
                *given += 1;
                let open = Open {
                    site: name.clone(),
                    number: *given,
                    taken: false,
                };
                world::note(cx, |world| world.issue(number));
                state.open.insert(number, open);
            }
        }
    }

    /// Gives each site the jobs that it has not taken, in order, each until it has.
    fn give(&self, cx: &Context) {
        let mut wanted: BTreeMap<Arc<str>, Vec<(u64, JobNumber)>> = BTreeMap::new();
        for (job, open) in self
            .state
            .borrow()
            .open
            .iter()
            .filter(|(_, open)| !open.taken)
        {
            let of_site = wanted.entry(open.site.clone()).or_default();
            of_site.push((open.number, *job));
        }
        for (site, jobs) in wanted {
            if !self.seen.borrow_mut().giving.insert(site.to_string()) {
                continue;
            }
            let (desk, here) = (self.clone(), cx.clone());
            cx.spawn(async move {
                for (number, of) in jobs {
                    let take = Take {
                        number,
                        job: job(of),
                    };
                    match ask(&here, &site, take, ANSWER).await {
                        Ok(last) if last >= number => {
                            let mut state = desk.state.borrow_mut();
                            if let Some(open) = state.open.get_mut(&of) {
                                open.taken = true;
                            }
                        }
                        // The next turn begins with this one.
                        _ => break,
                    }
                }
                desk.seen.borrow_mut().giving.remove(&*site);
            });
        }
    }

    /// A job has ended; told again, it is known already.
    fn ended(&self, cx: &Context, ended: &Ended) {
        let mut state = self.state.borrow_mut();
        if state.open.remove(&ended.job).is_none() {
            return;
        }
        if ended.outcome == Outcome::Carried {
            state.carried += 1;
        } else {
            state.failed += 1;
        }
        state.attempts += ended.attempts.len() as u64;
        if let Some(rollout) = &mut state.rollout {
            ended
                .attempts
                .iter()
                .for_each(|one: &Attempt| rollout.saw(one));
        }
        self.seen.borrow_mut().sums.ended(cx.now());
        world::note(cx, |world| world.report(ended.job, ended.outcome));
    }

    /// Whether somebody looks at the summary.
    fn is_looked_at(&self, now: Instant) -> bool {
        let looked = self.seen.borrow().looked;
        looked.is_some_and(|last| now.since(last) < LOOKS_ON)
    }

    /// Learns again and again which sites there are, and how their cells stand.
    async fn survey_for_ever(&self, cx: &Context) {
        for turn in 0_u32.. {
            if turn % SURVEY != 0 && !self.is_looked_at(cx.now()) {
                cx.sleep(TURN).await;
                continue;
            }
            let seek = Seek {
                service: CARRY.to_owned(),
                wanted: "cells>0".to_owned(),
                most: u32::MAX,
            };
            let found = ask(cx, &self.args.trader, seek, ANSWER).await;
            for offered in found.unwrap_or_default() {
                let cells = offered.attributes.split_once("cells=");
                let cells = cells.and_then(|(_, count)| count.parse().ok());
                let mut seen = self.seen.borrow_mut();
                seen.sites.insert(offered.from, cells.unwrap_or(0));
            }
            let sites: Vec<String> = self.seen.borrow().sites.keys().cloned().collect();
            for site in sites {
                let after = self.seen.borrow().sums.mark(&site);
                if let Ok(overview) = ask(cx, &site, Look { after }, ANSWER).await {
                    self.seen.borrow_mut().sums.take(&site, overview);
                }
            }
            cx.sleep(TURN).await;
        }
    }

    /// Goes on with the rollout.
    async fn roll(&self, cx: &Context) -> Handled {
        let Some(plan) = &self.args.rollout else {
            return Ok(());
        };
        // Which site each cell is on; a cell that was never heard of gets the version when it is.
        let sites = self.seen.borrow().sums.cells();
        let all: BTreeSet<String> = sites.keys().cloned().collect();
        let orders = {
            let mut state = self.state.borrow_mut();
            let Some(rollout) = &mut state.rollout else {
                return Ok(());
            };
            let before = rollout.stage;
            rollout.step(&all, plan);
            if rollout.stage != before {
                let (stage, cells) = (rollout.stage, rollout.cells.len());
                tracing::info!(?stage, cells, why = %rollout.why, "rollout");
            }
            (rollout.order, rollout.orders())
        };
        let state = self.state.borrow().clone();
        cx.keep(&state).await?;
        let (order, orders) = orders;
        for (cell, new) in orders {
            let Some(site) = sites.get(&cell).cloned() else {
                continue;
            };
            if !self.seen.borrow_mut().ordering.insert(cell.clone()) {
                continue;
            }
            let install = install(cx.app(), plan, &cell, order, new)?;
            let (desk, here) = (self.clone(), cx.clone());
            cx.spawn(async move {
                let installed = ask(&here, &site, install, INSTALLED_WITHIN).await;
                desk.seen.borrow_mut().ordering.remove(&cell);
                let Ok(installed) = installed else { return };
                if let Some(rollout) = &mut desk.state.borrow_mut().rollout {
                    // An order that was overtaken says nothing.
                    if rollout.order == order {
                        rollout.installed(&cell, installed);
                    }
                }
            });
        }
        Ok(())
    }

    /// Ends the app when all is done.
    fn finish(&self, cx: &Context) -> Handled {
        let state = self.state.borrow();
        if self.is_open(&state) || !state.open.is_empty() || self.seen.borrow().finished {
            return Ok(());
        }
        // Who looks on sees how it ended.
        if self.is_looked_at(cx.now()) && !self.seen.borrow().shown_end {
            return Ok(());
        }
        self.seen.borrow_mut().finished = true;
        let (count, moved, messages) = world::see(cx, "what the referee counts", |world| {
            (world.count(), world.moved(), world.messages())
        })?;
        let told = state.carried + state.failed;
        let ok = count.is_clean() && told == state.issued && count.carried as u64 == state.carried;
        let hours = cx.now().since_start().as_secs_f64() / 3600.0;
        #[expect(clippy::cast_precision_loss, reason = "counts are small")]
        let (jobs, messages) = (state.issued as f64, messages as f64);
        let moved_s = |share: usize| {
            let place = moved.len().saturating_sub(1) * share / 100;
            moved.get(place).map(Duration::as_secs_f64)
        };
        let rollout = state.rollout.as_ref();
        let rolled = rollout.map(|one| (one.stage == Stage::Reached, one.most));
        let json = serde_json::json!({
            "cells": cx.app().tasks_with(agent::HANDLER).count(),
            "jobs": state.issued,
            "carried": state.carried,
            "not_carried": state.failed,
            "attempts": state.attempts,
            "lost": count.lost,
            "doubled": count.doubled,
            "untrue": count.untrue,
            "jobs_per_hour": jobs / hours,
            "messages_per_job": messages / jobs,
            "moved": moved.len(),
            "moved_s": { "median": moved_s(50), "most": moved_s(100) },
            "rollout": rolled.map(|(reached, most)| serde_json::json!({
                "reached_all": reached,
                "cells_at_most": most,
                "why": rollout.map(|one| one.why.as_str()),
            })),
        });
        let mut text = format!(
            "{} jobs: {} carried, {} not, {} lost, {} doubled, {} untrue\n{:.0} jobs in an hour, {:.1} messages for a job, {} jobs of cells that died went elsewhere",
            state.issued,
            state.carried,
            state.failed,
            count.lost.len(),
            count.doubled.len(),
            count.untrue.len(),
            jobs / hours,
            messages / jobs,
            moved.len(),
        );
        if let Some(most) = moved_s(100) {
            text += &format!(", within {most:.2} s");
        }
        if let Some((reached, most)) = rolled {
            text += match reached {
                true => "\nthe new version reached all cells",
                false => "\nthe new version was rolled back",
            };
            text += &format!("; {most} cells had it at most");
        }
        cx.finish(AppResult {
            ok,
            text,
            json: json.to_string(),
        });
        Ok(())
    }
}

/// The order to a cell to take the new version, or to go back.
fn install(
    app: &App,
    plan: &Plan,
    cell: &str,
    order: u64,
    new: bool,
) -> Result<Install, HandlerError> {
    let what = plan.what().ok_or("a rollout does not say what goes out")?;
    let (task, file) = match (what, new) {
        (What::Net { new, .. }, true) => (None, new),
        (What::Net { before, .. }, false) => (None, before),
        (What::Args { task, file }, _) => (Some(task.to_owned()), file),
    };
    let goes_back = task.is_some() && !new;
    let text = match goes_back {
        true => String::new(),
        false => {
            let read = app.read(file).map_err(|finding| finding.to_string())?;
            read.text().to_owned()
        }
    };
    Ok(Install {
        cell: cell.to_owned(),
        order,
        version: if new { VERSIONS.1 } else { VERSIONS.0 },
        task,
        file: file.to_owned(),
        text,
    })
}

/// The job of a number: any two fields of a board that are not the same.
fn job(number: JobNumber) -> Job {
    let field = |at: u64| format!("{},{}", at % FIELDS + 1, at / FIELDS % FIELDS + 1).into();
    let from = number % (FIELDS * FIELDS);
    Job {
        number,
        from: field(from),
        to: field((from + 9) % (FIELDS * FIELDS)),
    }
}

impl Handover for Company {
    type State = State;

    fn hand_over(&mut self) -> Result<State, HandlerError> {
        Ok(self.state())
    }

    fn take_over(&mut self, _: &Context, state: State) -> Handled {
        *self.desk.state.borrow_mut() = state;
        Ok(())
    }
}

impl Durable for Company {
    fn state(&self) -> State {
        self.desk.state.borrow().clone()
    }
}
