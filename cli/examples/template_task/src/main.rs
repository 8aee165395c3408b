//! The program of my-app: the commands of `ctos` for the handlers of this app.

mod handlers;
#[cfg(test)]
mod tests;

use std::process::ExitCode;

fn main() -> ExitCode {
    cli::commands::main(handlers::registry())
}
