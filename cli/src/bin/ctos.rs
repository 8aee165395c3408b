//! The command `ctos`.

use std::process::ExitCode;

/// The smallest app of one's own, which is a program of its own as well: its configuration works with both.
#[allow(dead_code, reason = "its `main`")]
#[path = "../../examples/hello.rs"]
mod hello;

fn main() -> ExitCode {
    let mut registry = cli::program::registry();
    hello::register(&mut registry);
    cli::commands::main(registry)
}
