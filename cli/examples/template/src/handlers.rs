//! The event handlers of my-app, and the functions that its net names.

use std::time::Duration;

use ctos::{
    message::Command,
    registry::Registry,
    task::{Context, HandlerError},
};
use pnt::library::{Acted, Action, Library};
use serde::{Deserialize, Serialize};

/// Adds a number to the sum, and tells the sum.
#[derive(Serialize, Deserialize, Command)]
#[command(reply = i64, code = 0x0001)]
struct Add {
    number: i64,
}

/// Tells the sum to whoever reads the log.
#[derive(Serialize, Deserialize, Command)]
#[command(code = 0x0001)]
struct Report {}

/// What stands in `[task.adder.args]`.
#[derive(Deserialize)]
struct AdderArgs {
    /// How long it takes to add a number, s.
    takes_s: Duration,
}

/// Keeps a sum: an event handler as a type, for any number of commands and with a state.
struct Adder {
    args: AdderArgs,
    sum: i64,
}

#[ctos::handler]
impl Adder {
    #[command]
    async fn add(&mut self, cx: &Context, Add { number }: Add) -> Result<i64, HandlerError> {
        // All that waits is a call or a sleep of the context, so it is the same in virtual time.
        cx.sleep(self.args.takes_s).await;
        let sum = self.sum.checked_add(number);
        self.sum = sum.ok_or("the sum is too large")?;
        Ok(self.sum)
    }
}

/// An event handler as a function: one command, no state.
async fn report(cx: Context, _: Report) -> Result<(), HandlerError> {
    let adder = cx.task("adder").await?;
    let sum = cx.call(&adder, Add { number: 0 }).await?;
    // It stands in the log, with the name of the chassis.
    #[allow(clippy::print_stdout, reason = "the log is where it goes")]
    {
        println!("the sum is {sum}");
    }
    Ok(())
}

/// What `do add_all` in the net means: adds all numbers that the command brings.
async fn add_all(action: Action<()>) -> Acted {
    let adder = action.cx().task("adder").await?;
    let mut sum = 0;
    for number in action.arguments() {
        let number = number.parse()?;
        sum = action.cx().call(&adder, Add { number }).await?;
    }
    // It stands below the net's answer.
    action.note(format!("the sum is {sum}"));
    Ok(())
}

fn library() -> Library<()> {
    Library::new(()).action("add_all", add_all)
}

/// Every event handler that `app.toml` can name: those of CTOS, and these.
pub fn registry() -> Registry {
    let mut registry = cli::program::registry();
    let adder = registry.handler("my_app.adder", &Adder::COMMANDS, |cx| {
        let args = cx.args()?;
        Ok(Adder { args, sum: 0 })
    });
    // What it reads is checked before anything starts.
    adder.args::<AdderArgs>();
    registry.function("my_app.reporter", report);
    pnt::task::register(&mut registry, "my_app.net", library);
    registry
}
