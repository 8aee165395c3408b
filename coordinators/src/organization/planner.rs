//! An example of the Organization Level: it has one command done. When that is not done, it looks by types why, sends the net of
//! a plan in the place of the Dispatcher's, and has the command done again.

use std::time::Duration;

use ctos::{
    config::{App, TaskConfig},
    diagnostic::{Finding, Findings, Source},
    message::Message,
    registry::Registry,
    system::AppResult,
    task::{Context, EventHandler, Handled, HandlerError, Phase},
};
use pnt::task::{PutOnce, RequestId, TapeAnswer};
use serde::Deserialize;

use super::{NotDone, command, send_net};
use crate::outcome::{Failure, Outcome};

/// The handler's name.
pub const HANDLER: &str = "coordinators.planner";

/// The longest that a command may take.
const LONGEST: Duration = Duration::from_secs(1_000_000_000);

/// Arguments.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
struct PlannerArgs {
    /// The net task that takes the command. It must allow control.
    #[serde(default = "dispatcher_task")]
    dispatcher: String,
    /// The data object manager of its coordinators.
    #[serde(default = "crate::dom_task")]
    dom: String,
    /// The input tape symbol.
    command: String,
    /// What goes along with it.
    #[serde(default)]
    arguments: Vec<String>,
    /// How long the command may take, each time.
    #[serde(default = "within_s")]
    within_s: Duration,
    /// How long a net that was sent waits for a marking at which it may take over.
    #[serde(default = "send_within_s")]
    send_within_s: Duration,
    /// The plans, of which each is tried once.
    #[serde(default)]
    plans: Vec<Plan>,
}

/// What is done when something was in the way.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
struct Plan {
    /// What was in the way: names of outcomes.
    after: Vec<String>,
    /// A file of lines that the Dispatcher's net has then besides its own, relative to the configuration's folder.
    adds: String,
}

impl Plan {
    /// Whether it is one for what was in the way.
    fn is_for(&self, failed: &NotDone) -> bool {
        let after = self.after.iter().filter_map(|name| Outcome::named(name));
        failed.is_one_of(&after.collect::<Vec<_>>())
    }
}

fn dispatcher_task() -> String {
    "dispatcher".to_owned()
}

fn within_s() -> Duration {
    Duration::from_secs(1800)
}

fn send_within_s() -> Duration {
    Duration::from_secs(10)
}

/// Registers the handler.
pub(crate) fn register(registry: &mut Registry) {
    registry
        .handler(HANDLER, &[], |cx| Ok(Planner { args: cx.args()? }))
        .checked_args::<PlannerArgs>(check);
}

fn check(args: &PlannerArgs, task: &TaskConfig, app: &App, findings: &mut Findings) {
    const CODE: &str = "coordinators::planner::plan";
    crate::need_task(task, app, "dispatcher", &args.dispatcher, findings);
    crate::need_task(task, app, "dom", &args.dom, findings);
    let place = |key: &str| task.args.locate(key).unwrap_or_else(|| task.place.clone());
    for (key, value) in [
        ("within_s", args.within_s),
        ("send_within_s", args.send_within_s),
    ] {
        if value.is_zero() || value > LONGEST {
            let text = format!("`{key}` is {} s", value.as_secs_f64());
            let finding = Finding::error(CODE, text).at(place(key));
            findings.push(finding.help("give a positive number of seconds"));
        }
    }
    let Some(dispatcher) = app.task(&args.dispatcher) else {
        return;
    };
    let allows = dispatcher.args.get("allow_control");
    if !args.plans.is_empty() && allows.and_then(|allows| allows.as_bool()) != Some(true) {
        let text = format!("task `{}` takes no other net", args.dispatcher);
        let finding = Finding::error(CODE, text).at(dispatcher.place.clone());
        findings.push(finding.help("let it: `allow_control = true` in its arguments"));
    }
    for (number, plan) in args.plans.iter().enumerate() {
        let key = format!("plans.{number}.after");
        for name in &plan.after {
            if Outcome::named(name).is_none() {
                let text = format!("`{name}` is nothing that can be in the way");
                let known: Vec<String> = Outcome::ALL.iter().map(ToString::to_string).collect();
                let finding = Finding::error(CODE, text).at(place(&key));
                findings.push(finding.suggest(name, known.iter().map(String::as_str)));
            }
        }
        match composed(app, dispatcher, plan) {
            Ok(source) => {
                if let Err(found) = pnt::compile::net(&source) {
                    findings.extend(found);
                }
            }
            Err(finding) => findings.push(finding.at(place(&format!("plans.{number}.adds")))),
        }
    }
}

/// The net of a plan: that of the Dispatcher's file with the plan's lines behind its name.
fn composed(app: &App, dispatcher: &TaskConfig, plan: &Plan) -> Result<Source, Finding> {
    let file = dispatcher.args.get("net").and_then(|net| net.as_str());
    let net = app.read(file.unwrap_or_default())?;
    let more = app.read(&plan.adds)?;
    let text = net.text();
    let named = text.lines().take_while(|line| !line.starts_with("net "));
    let before: usize = named.map(|line| line.len() + 1).sum();
    let rest = text.get(before..).unwrap_or_default();
    let (name, rest) = rest.split_once('\n').unwrap_or((rest, ""));
    let head = text.get(..before).unwrap_or_default();
    let text = format!("{head}{name}\n{}\n{rest}", more.text());
    Ok(Source::new(plan.adds.clone(), text))
}

/// The event handler.
struct Planner {
    args: PlannerArgs,
}

impl EventHandler for Planner {
    async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
        cx.default_processing(message)
    }

    async fn phase(&mut self, cx: &Context, phase: Phase) -> Handled {
        if phase == Phase::Run {
            let (child, args) = (cx.clone(), self.args.clone());
            cx.spawn(async move { child.finish(plan(&child, &args).await) });
        }
        Ok(())
    }
}

async fn plan(cx: &Context, args: &PlannerArgs) -> AppResult {
    let mut left: Vec<&Plan> = args.plans.iter().collect();
    let mut sent = Vec::new();
    let mut number = 0;
    loop {
        number += 1;
        let failed = match ask(cx, args, number).await {
            Ok(answer) => return result(&Ok(answer), &sent),
            Err(failed) => failed,
        };
        let Some(at) = left.iter().position(|plan| plan.is_for(&failed)) else {
            return result(&Err(failed), &sent);
        };
        let next = left.remove(at);
        tracing::info!(task = cx.name(), plan = next.adds, reason = %failed, "plans anew");
        match send(cx, args, next).await {
            Ok(()) => sent.push(next.adds.clone()),
            Err(failure) => {
                let NotDone {
                    symbol,
                    mut failures,
                    text,
                } = failed;
                let text = format!("{text}\nno other net was sent: {failure}");
                failures.push(failure);
                let failed = NotDone {
                    symbol,
                    failures,
                    text,
                };
                return result(&Err(failed), &sent);
            }
        }
    }
}

async fn ask(cx: &Context, args: &PlannerArgs, number: u64) -> Result<TapeAnswer, NotDone> {
    let put = PutOnce {
        request: RequestId {
            from: format!("{} {:016x}", cx.name(), cx.started_ns()),
            number,
        },
        symbol: args.command.clone(),
        arguments: args.arguments.clone(),
    };
    command(cx, (&args.dispatcher, &args.dom), put, args.within_s).await
}

async fn send(cx: &Context, args: &PlannerArgs, plan: &Plan) -> Result<(), Failure> {
    let dispatcher = cx.app().task(&args.dispatcher);
    let dispatcher = dispatcher.ok_or_else(|| HandlerError::new("there is no Dispatcher"))?;
    let source = composed(cx.app(), dispatcher, plan);
    let source = source.map_err(|finding| HandlerError::new(finding.to_string()))?;
    let net = (plan.adds.as_str(), source.text().to_owned());
    send_net(cx, &args.dispatcher, net, args.send_within_s).await
}

/// What the app ends with.
fn result(ended: &Result<TapeAnswer, NotDone>, sent: &[String]) -> AppResult {
    let (symbol, text, failures) = match ended {
        Ok(answer) => (&answer.symbol, &answer.text, &[][..]),
        Err(failed) => (&failed.symbol, &failed.text, failed.failures.as_slice()),
    };
    let failures = failures.iter().map(|Failure { outcome, reason }| {
        serde_json::json!({ "code": outcome.code(), "kind": outcome.to_string(), "reason": reason })
    });
    let json = serde_json::json!({
        "ok": ended.is_ok(),
        "answer": symbol,
        "failures": failures.collect::<Vec<_>>(),
        "plans": sent,
    });
    let plans = sent.iter().map(|plan| format!("plan: {plan}\n"));
    AppResult {
        ok: ended.is_ok(),
        text: format!("{}{symbol}\n{text}", plans.collect::<String>()),
        json: json.to_string(),
    }
}

#[cfg(test)]
mod tests;
