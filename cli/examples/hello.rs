//! The smallest app of one's own: two event handlers and a net that asks them in turn.
//!
//! ```text
//! cargo run --example hello -- boot configs/hello.toml -v
//! ```

use std::process::ExitCode;

use ctos::{
    message::{Command, Message},
    registry::Registry,
    task::{Context, EventHandler, Handled, HandlerError},
};
use pnt::library::{Acted, Action, Library};

ctos::command! {
    /// Greets somebody.
    struct Greet { name: String } => String, 0x0001, "greet"
}

/// An event handler as a function: one command, no state.
async fn greet(cx: Context, Greet { name }: Greet) -> Result<String, HandlerError> {
    Ok(format!("Hello, {name}, from {}!", cx.chassis().name()))
}

ctos::command! {
    /// Counts, and tells how often it has.
    struct Count => u64, 0x0001, "count"
}

/// An event handler as a type: any number of commands, and a state.
struct Counter(u64);

impl EventHandler for Counter {
    async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
        match message.command() {
            Count::CODE => {
                let (Count {}, reply) = message.open::<Count>()?;
                self.0 += 1;
                reply.ok(self.0)
            }
            _ => cx.default_processing(message),
        }
    }
}

/// What `do greet_all` in the net means: greets everybody whom the command names.
async fn greet_all(action: Action<()>) -> Acted {
    let greeter = action.cx().task("greeter").await?;
    for name in action.arguments() {
        let name = name.clone();
        let greeting = action.cx().call(&greeter, Greet { name }).await?;
        action.note(greeting);
    }
    Ok(())
}

fn library() -> Library<()> {
    Library::new(()).action("greet_all", greet_all)
}

fn main() -> ExitCode {
    // All of `ctos`, here for the operator that gives the net its command, and these:
    let mut registry: Registry = cli::program::registry();
    registry.function("hello.greeter", greet);
    registry.handler("hello.counter", &[Count::INFO], |_| Ok(Counter(0)));
    pnt::task::register(&mut registry, "hello.net", library);
    cli::commands::main(registry)
}
