//! The event handlers of my-app.

use std::time::Duration;

use ctos::{
    message::{Command, Message},
    registry::Registry,
    system::AppResult,
    task::{Context, EventHandler, Handled, HandlerError, Phase},
};
use serde::Deserialize;

ctos::command! {
    /// Adds a number to the sum, and tells the sum.
    pub struct Add { pub number: i64 } => i64, 0x0001, "add"
}

/// Keeps a sum: an event handler with a state.
struct Adder {
    sum: i64,
}

impl EventHandler for Adder {
    async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
        match message.command() {
            Add::CODE => {
                let (Add { number }, reply) = message.open::<Add>()?;
                let sum = self.sum.checked_add(number);
                self.sum = sum.ok_or("the sum is too large")?;
                reply.ok(self.sum)
            }
            _ => cx.default_processing(message),
        }
    }
}

/// What stands in `[task.client.args]`.
#[derive(Clone, Deserialize)]
#[serde(deny_unknown_fields)]
struct ClientArgs {
    /// The task that adds.
    adder: String,
    /// What it is to add.
    numbers: Vec<i64>,
    /// Time between two numbers, s.
    every_s: f64,
}

/// Gives numbers to the adder, then ends the app with their sum.
struct Client {
    args: ClientArgs,
}

impl EventHandler for Client {
    async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
        cx.default_processing(message)
    }

    async fn phase(&mut self, cx: &Context, phase: Phase) -> Handled {
        if phase == Phase::Run {
            let (child, args) = (cx.clone(), self.args.clone());
            cx.spawn(async move {
                match add_all(&child, &args).await {
                    Ok(result) => child.finish(result),
                    Err(error) => child.fail(&error.to_string()),
                }
            });
        }
        Ok(())
    }
}

/// All that waits is a call or a sleep of the context, so it is the same in virtual time.
async fn add_all(cx: &Context, args: &ClientArgs) -> Result<AppResult, HandlerError> {
    let adder = cx.task(&args.adder).await?;
    let pause = Duration::try_from_secs_f64(args.every_s)?;
    let mut sum = 0;
    for number in args.numbers.iter().copied() {
        cx.sleep(pause).await;
        sum = cx.call(&adder, Add { number }).await?;
    }
    Ok(AppResult {
        ok: true,
        text: format!("the sum is {sum}"),
        json: serde_json::json!({ "ok": true, "sum": sum }).to_string(),
    })
}

/// Every event handler of this app, by the name that `app.toml` uses.
pub fn registry() -> Registry {
    let mut registry = Registry::new();
    registry.handler("my_app.adder", &[Add::INFO], |_| Ok(Adder { sum: 0 }));
    registry
        .handler("my_app.client", &[], |cx| Ok(Client { args: cx.args()? }))
        .check(|task, findings| {
            findings.keep(task.args.parse::<ClientArgs>());
        });
    registry
}
