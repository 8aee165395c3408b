//! The operator: stands in for the Organization Level. Puts one command on a Dispatcher's input tape,
//! waits for the answer on its output tape, and ends the app with it.

use std::time::Duration;

use ctos::{
    diagnostic::Finding,
    message::Message,
    registry::Registry,
    system::AppResult,
    task::{Context, EventHandler, Handled, HandlerError, Phase},
};
use pnt::task::{PutTape, TapeAnswer};
use serde::Deserialize;

use crate::referee::Judge;

/// The handler's name.
pub const HANDLER: &str = "coordinators.operator";

/// Arguments.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
struct OperatorArgs {
    /// The net task that takes the command.
    #[serde(default = "dispatcher_task")]
    dispatcher: String,
    /// The input tape symbol.
    command: String,
    /// What goes along with it.
    #[serde(default)]
    arguments: Vec<String>,
    /// The output tape symbol that means success.
    success: String,
    /// How long the command may take, s.
    #[serde(default = "within_s")]
    within_s: f64,
    /// The task that judges the result against the truth, if there is one.
    judge: Option<String>,
}

fn dispatcher_task() -> String {
    "dispatcher".to_owned()
}

fn within_s() -> f64 {
    1800.0
}

/// The event handler.
struct Operator {
    args: OperatorArgs,
}

/// Registers the handler.
pub(crate) fn register(registry: &mut Registry) {
    registry
        .handler(HANDLER, &[], |cx| Ok(Operator { args: cx.args()? }))
        .check_in_app(|task, app, findings| {
            let Some(args) = findings.keep(task.args.parse::<OperatorArgs>()) else {
                return;
            };
            crate::need_task(task, app, "dispatcher", &args.dispatcher, findings);
            if let Some(judge) = &args.judge {
                crate::need_task(task, app, "judge", judge, findings);
            }
            if !(args.within_s > 0.0 && args.within_s.is_finite() && args.within_s < 1e9) {
                let place = task.args.locate("within_s");
                findings.push(
                    Finding::error(
                        "coordinators::operator::within",
                        format!("`within_s` is {}", args.within_s),
                    )
                    .at(place.unwrap_or_else(|| task.place.clone()))
                    .help("give a positive number of seconds"),
                );
            }
        });
}

impl EventHandler for Operator {
    async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
        cx.default_processing(message)
    }

    async fn phase(&mut self, cx: &Context, phase: Phase) -> Handled {
        match phase {
            Phase::Create => {}
            Phase::Connect => {
                cx.task(&self.args.dispatcher).await?;
            }
            Phase::Run => {
                let (child, args) = (cx.clone(), self.args.clone());
                cx.spawn(async move {
                    let result = command(&child, &args).await;
                    child.finish(result.unwrap_or_else(|error| failure(&error.to_string())));
                });
            }
        }
        Ok(())
    }
}

fn failure(reason: &str) -> AppResult {
    AppResult {
        ok: false,
        text: reason.to_owned(),
        json: serde_json::json!({ "ok": false, "reason": reason }).to_string(),
    }
}

async fn command(cx: &Context, args: &OperatorArgs) -> Result<AppResult, HandlerError> {
    let began = cx.now();
    let dispatcher = cx.task(&args.dispatcher).await?;
    let request = PutTape {
        symbol: args.command.clone(),
        arguments: args.arguments.clone(),
    };
    let limit = Duration::from_secs_f64(args.within_s);
    let answered = cx.call(&dispatcher, request).deadline(limit).await;
    let TapeAnswer { symbol, text } =
        answered.map_err(|error| HandlerError::new(error.reason()))?;
    if symbol != args.success {
        return Ok(failure(&format!("{symbol}: {text}")));
    }
    let Some(judge) = &args.judge else {
        let json = serde_json::json!({ "ok": true, "answer": symbol }).to_string();
        return Ok(AppResult {
            ok: true,
            text: format!("{symbol}\n{text}"),
            json,
        });
    };
    let judge = cx.task(judge).await?;
    let seconds = cx.now().since(began).as_secs_f64();
    let judged = cx
        .call(
            &judge,
            Judge {
                seconds,
                notes: text,
            },
        )
        .await;
    judged.map_err(|error| HandlerError::new(error.reason()))
}
