//! The smallest app of one's own: two event handlers. A net asks them in turn, which needs no code.
//!
//! ```text
//! cargo run --example hello -- boot configs/hello.toml -v
//! ```

use std::process::ExitCode;

use ctos::{
    message::Command,
    registry::Registry,
    task::{Context, HandlerError},
};
use serde::{Deserialize, Serialize};

/// Greets somebody.
#[derive(Serialize, Deserialize, Command)]
#[command(reply = String, code = 0x0001)]
struct Greet {
    name: String,
}

/// An event handler as a function: one command, no state.
async fn greet(cx: Context, Greet { name }: Greet) -> Result<String, HandlerError> {
    Ok(format!("Hello, {name}, from {}!", cx.chassis().name()))
}

/// Counts, and tells how often it has.
#[derive(Serialize, Deserialize, Command)]
#[command(reply = u64, code = 0x0001)]
struct Count {}

/// An event handler as a type: any number of commands, and a state.
struct Counter(u64);

#[ctos::handler]
impl Counter {
    #[command]
    fn count(&mut self, _: Count) -> u64 {
        self.0 += 1;
        self.0
    }
}

/// What a configuration can name.
pub fn register(registry: &mut Registry) {
    registry.function("hello.greeter", greet);
    registry.handler("hello.counter", &Counter::COMMANDS, |_| Ok(Counter(0)));
}

fn main() -> ExitCode {
    // All of `ctos`, here for the operator that gives the net its command, and these:
    let mut registry = cli::program::registry();
    register(&mut registry);
    cli::commands::main(registry)
}
