//! The agent of a cell offers its work to the trader of the site, and takes one job at a time under a lease. The net of the
//! cell does it. The agent reports how it ended until the operator has heard.
//!
//! A job that is lent may be begun only while the lease holds by the cell's own clock, and only when the operator says
//! yes. What has not begun by then is given up. The agent knows after a kill what it has, and goes on.

use std::{cell::RefCell, rc::Rc, time::Duration};

use ctos::{
    call::CallError,
    diagnostic::Finding,
    message::{Command, Replier},
    registry::Registry,
    task::{Context, Durable, Handled, HandlerError, Handover, Phase},
    time::Instant,
};
use pnt::task::{Control, Order, PutOnce, RequestId, put_once};
use serde::{Deserialize, Serialize};

use crate::{
    table,
    wire::{
        Attempt, Begin, Configure, Holds, Install, Job, Lend, MayBegin, Offer, Outcome, Report,
    },
    world::{self, World},
};

/// The handler's name.
pub const HANDLER: &str = "fleet.agent";

/// The service that cells offer.
pub const CARRY: &str = "carry";

/// The wait before somebody is asked again who did not answer.
const AGAIN: Duration = Duration::from_millis(500);

/// How long an answer of the operator, or of the trader, is waited for.
const ANSWER: Duration = Duration::from_secs(5);

/// How long the net may take for a job before it is asked again.
const LONGEST: Duration = Duration::from_secs(3600);

/// How long a net is waited for until it may be replaced.
const REPLACED_WITHIN: Duration = Duration::from_secs(120);

/// How much the latest attempt counts in what is told of the reliability.
const LATEST: f64 = 0.1;

/// Whether the agent keeps to its leases; a mutant does not, and the referee has to find it.
#[doc(hidden)]
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Leases {
    Kept,
    Ignored,
}

/// Arguments.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
struct Args {
    /// The task of the cell's net.
    net: String,
    /// The operator of the site.
    operator: String,
    /// The trader of the site.
    trader: String,
    /// How often an idle cell makes its offer again; it stands three times as long.
    #[serde(default = "offer_every_s")]
    offer_every_s: Duration,
    /// How much of the lease must be left for a job to begin.
    #[serde(default = "needs_s")]
    needs_s: Duration,
}

fn offer_every_s() -> Duration {
    Duration::from_secs(10)
}

fn needs_s() -> Duration {
    Duration::from_secs(30)
}

/// A job that the cell has.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
struct Held {
    job: Job,
    epoch: u64,
    /// The end of the lease by the cell's clock, ns.
    until_ns: u64,
}

/// What the agent knows after a kill.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct State {
    /// The last epoch that was heard of.
    seen: u64,
    held: Option<Held>,
    /// A report that the operator has not taken.
    report: Option<Report>,
    /// The version of the net.
    version: u64,
    /// The last order to install something.
    order: u64,
    /// The share of attempts that succeeded, the latest ones counting most.
    reliability: f64,
}

impl Default for State {
    fn default() -> Self {
        Self {
            seen: 0,
            held: None,
            report: None,
            version: 1,
            order: 0,
            reliability: 1.0,
        }
    }
}

impl State {
    fn is_free(&self) -> bool {
        self.held.is_none() && self.report.is_none()
    }
}

/// Registers the handler.
pub(crate) fn register(registry: &mut Registry, leases: Leases) {
    registry
        .durable(HANDLER, &Agent::COMMANDS, move |cx| {
            Ok(Agent {
                cell: Cell {
                    args: Rc::new(cx.args()?),
                    leases,
                    state: Rc::default(),
                    installing: Rc::default(),
                },
            })
        })
        .checked_args::<Args>(|args, task, app, findings| {
            let needed = [
                ("net", &args.net),
                ("operator", &args.operator),
                ("trader", &args.trader),
            ];
            for (key, name) in needed {
                crate::need_task(task, app, key, name, findings);
            }
            let operator = app.task(&args.operator);
            let lease = operator.and_then(|one| crate::operator::lease_of(&one.args));
            if lease.is_some_and(|lease| lease <= args.needs_s) {
                let place = task.args.locate("needs_s");
                let text = "no lease is long enough for a job to begin";
                let finding = Finding::error("coordinators::fleet::lease", text);
                let finding = finding.at(place.unwrap_or_else(|| task.place.clone()));
                findings.push(finding.help("give less than `lease_s` of the operator"));
            }
        });
}

/// The event handler.
struct Agent {
    cell: Cell,
}

/// What the handler and its children share.
#[derive(Clone)]
struct Cell {
    args: Rc<Args>,
    leases: Leases,
    state: Rc<RefCell<State>>,
    /// A net is being replaced: no job is taken.
    installing: Rc<std::cell::Cell<bool>>,
}

#[ctos::handler]
impl Agent {
    #[phase]
    async fn enters(&mut self, cx: &Context, phase: Phase) -> Handled {
        if phase == Phase::Run {
            let (cell, here) = (self.cell.clone(), cx.clone());
            cx.spawn(async move { cell.offer_for_ever(&here).await });
            self.go_on(cx);
        }
        Ok(())
    }

    #[command]
    async fn lend(&mut self, cx: &Context, lend: Lend) -> Result<bool, HandlerError> {
        let Lend {
            job,
            epoch,
            lease_ms,
        } = lend;
        {
            let mut state = self.cell.state.borrow_mut();
            if epoch <= state.seen || !state.is_free() || self.cell.installing.get() {
                return Ok(false);
            }
            let until = cx.now() + Duration::from_millis(lease_ms);
            state.seen = epoch;
            state.held = Some(Held {
                job,
                epoch,
                until_ns: ns(until),
            });
        }
        // The net hears of nothing that a kill could make the agent forget.
        let state = self.cell.state.borrow().clone();
        cx.keep(&state).await?;
        self.go_on(cx);
        Ok(true)
    }

    #[command]
    fn may_begin(&mut self, cx: &Context, request: MayBegin, reply: Replier<MayBegin>) -> Handled {
        let (cell, here) = (self.cell.clone(), cx.clone());
        cx.spawn(async move {
            let may = cell.may_begin(&here, request.epoch).await;
            // Answering never fails; a net that is gone asks again.
            let _ = reply.ok(may);
        });
        Ok(())
    }

    #[command]
    fn holds(&mut self, cx: &Context, Holds { epoch }: Holds) -> bool {
        self.cell.holds(cx, epoch, Duration::ZERO)
    }

    #[command]
    fn install(&mut self, cx: &Context, install: Install, reply: Replier<Install>) -> Handled {
        let (cell, here) = (self.cell.clone(), cx.clone());
        if cell.installing.replace(true) {
            return reply.fail("another version is being installed");
        }
        cx.spawn(async move {
            let installed = cell.install(&here, install).await;
            cell.installing.set(false);
            let _ = match installed {
                Ok(installed) => reply.ok(installed),
                Err(error) => reply.fail(error.to_string()),
            };
        });
        Ok(())
    }
}

impl Agent {
    /// Works on what the cell has, and reports what it has to report.
    fn go_on(&self, cx: &Context) {
        let (cell, here) = (self.cell.clone(), cx.clone());
        cx.spawn(async move {
            if let Err(error) = cell.work(&here).await {
                here.fail(&error.to_string());
            }
        });
    }
}

fn ns(moment: Instant) -> u64 {
    u64::try_from(moment.since_start().as_nanos()).unwrap_or(u64::MAX)
}

/// Calls a task by its name, and counts the message where there is a world to count in.
pub(crate) async fn ask<C: Command>(
    cx: &Context,
    task: &str,
    request: C,
    within: Duration,
) -> Result<C::Reply, HandlerError> {
    world::note(cx, World::message);
    let to = cx.task(task).deadline(within).await?;
    let answer: Result<C::Reply, CallError> = cx.call(&to, request).deadline(within).await;
    Ok(answer?)
}

impl Cell {
    /// Whether the lease of an epoch holds, and so much of it is left.
    fn holds(&self, cx: &Context, epoch: u64, left: Duration) -> bool {
        if self.leases == Leases::Ignored {
            return true;
        }
        let state = self.state.borrow();
        let held = state.held.as_ref().filter(|held| held.epoch == epoch);
        held.is_some_and(|held| ns(cx.now() + left) <= held.until_ns)
    }

    /// Asks the operator, as long as the lease leaves enough time.
    async fn may_begin(&self, cx: &Context, epoch: u64) -> bool {
        if self.leases == Leases::Ignored {
            return true;
        }
        while self.holds(cx, epoch, self.args.needs_s) {
            let held = self.state.borrow().held.clone();
            let Some(job) = held.map(|held| held.job.number) else {
                return false;
            };
            match ask(cx, &self.args.operator, Begin { job, epoch }, ANSWER).await {
                Ok(may) => return may && self.holds(cx, epoch, self.args.needs_s),
                Err(_) => cx.sleep(AGAIN).await,
            }
        }
        false
    }

    /// Has the net do what the cell has, then reports it.
    async fn work(&self, cx: &Context) -> Handled {
        let held = self.state.borrow().held.clone();
        if let Some(held) = held {
            let Job { number, from, to } = held.job.clone();
            let put = PutOnce {
                request: RequestId {
                    from: cx.name().to_owned(),
                    number: held.epoch,
                },
                symbol: CARRY.to_owned(),
                arguments: vec![
                    number.to_string(),
                    held.epoch.to_string(),
                    from.to_string(),
                    to.to_string(),
                ],
            };
            let answer = loop {
                match put_once(cx, &self.args.net, &put, LONGEST).await {
                    Ok(answer) => break answer,
                    Err(error) => {
                        tracing::debug!(net = %self.args.net, %error, "the net is asked again");
                        cx.sleep(AGAIN).await;
                    }
                }
            };
            let symbol = &answer.symbol;
            let outcome = Outcome::of(symbol)
                .ok_or_else(|| format!("net `{}` wrote `{symbol}`", self.args.net))?;
            self.ended(cx, &held, outcome);
            let state = self.state.borrow().clone();
            cx.keep(&state).await?;
        }
        let report = self.state.borrow().report.clone();
        let Some(report) = report else {
            return Ok(());
        };
        while ask(cx, &self.args.operator, report.clone(), ANSWER)
            .await
            .is_err()
        {
            cx.sleep(AGAIN).await;
        }
        self.state.borrow_mut().report = None;
        let state = self.state.borrow().clone();
        cx.keep(&state).await?;
        self.offer(cx).await;
        Ok(())
    }

    /// The net has answered.
    fn ended(&self, cx: &Context, held: &Held, outcome: Outcome) {
        let mut state = self.state.borrow_mut();
        let succeeded = match outcome {
            Outcome::Carried => Some(1.0),
            Outcome::NotCarried => Some(0.0),
            _ => None,
        };
        if let Some(succeeded) = succeeded {
            state.reliability += (succeeded - state.reliability) * LATEST;
        }
        state.held = None;
        state.report = Some(Report {
            job: held.job.number,
            epoch: held.epoch,
            attempt: Attempt {
                cell: cx.name().to_owned(),
                version: state.version,
                outcome,
            },
        });
    }

    /// Has the net replaced by another one.
    async fn replace(&self, cx: &Context, install: Install) -> Result<(), String> {
        let order = Order::Replace {
            file: install.file,
            text: install.text,
            within_ms: u64::try_from(REPLACED_WITHIN.as_millis()).unwrap_or(u64::MAX),
        };
        let by = cx.name().to_owned();
        let control = Control { order, by };
        let done = ask(cx, &self.args.net, control, REPLACED_WITHIN + ANSWER).await;
        done.map(|_| ()).map_err(|error| error.to_string())
    }

    /// Gives a task of the cell other arguments, as soon as it can be reached.
    async fn configure(&self, cx: &Context, task: &str, install: Install) -> Result<(), String> {
        let Install { file, text, .. } = install;
        let device = table::beside(cx.name(), task);
        let until = cx.now() + REPLACED_WITHIN;
        loop {
            let (file, text) = (file.clone(), text.clone());
            match ask(cx, &device, Configure { file, text }, ANSWER).await {
                Ok(taken) => return taken,
                Err(_) if cx.now() < until => cx.sleep(AGAIN).await,
                Err(error) => return Err(error.to_string()),
            }
        }
    }

    /// Installs what the operator asks for.
    async fn install(
        &self,
        cx: &Context,
        install: Install,
    ) -> Result<Result<u64, String>, HandlerError> {
        {
            let state = self.state.borrow();
            // What the net runs is not known after an order without an answer, so a later one is always followed.
            if install.order <= state.order {
                return Ok(Ok(state.version));
            }
        }
        // A job that came before is done first, by the net that it was begun with.
        while !self.state.borrow().is_free() {
            cx.sleep(AGAIN).await;
        }
        let (order, version) = (install.order, install.version);
        let changed = match install.task.clone() {
            Some(task) => self.configure(cx, &task, install).await,
            None => self.replace(cx, install).await,
        };
        if let Err(why) = changed {
            return Ok(Err(why));
        }
        let state = {
            let mut state = self.state.borrow_mut();
            state.order = order;
            state.version = version;
            state.clone()
        };
        cx.keep(&state).await?;
        Ok(Ok(state.version))
    }

    /// Makes the offer again and again. An offer that is lost costs time only.
    async fn offer_for_ever(&self, cx: &Context) {
        loop {
            self.offer(cx).await;
            cx.sleep(self.args.offer_every_s).await;
        }
    }

    /// Tells the trader what the cell offers.
    async fn offer(&self, cx: &Context) {
        let attributes = {
            let state = self.state.borrow();
            let load = u8::from(!state.is_free() || self.installing.get());
            format!(
                "load={load} reliability={:.3} version={}",
                state.reliability, state.version
            )
        };
        let stands = self.args.offer_every_s * 3;
        let offer = Offer {
            service: CARRY.to_owned(),
            from: cx.name().to_owned(),
            attributes,
            stands_ms: u64::try_from(stands.as_millis()).unwrap_or(u64::MAX),
        };
        if let Err(error) = ask(cx, &self.args.trader, offer, ANSWER).await {
            tracing::debug!(trader = %self.args.trader, %error, "the offer was not heard");
        }
    }
}

impl Handover for Agent {
    type State = State;

    fn hand_over(&mut self) -> Result<State, HandlerError> {
        Ok(self.state())
    }

    fn take_over(&mut self, _: &Context, state: State) -> Handled {
        *self.cell.state.borrow_mut() = state;
        Ok(())
    }
}

impl Durable for Agent {
    fn state(&self) -> State {
        self.cell.state.borrow().clone()
    }
}
