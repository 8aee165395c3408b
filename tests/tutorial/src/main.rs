//! The program of tea: the commands of `ctos` for the handlers of this app.

mod handlers;

use std::process::ExitCode;

fn main() -> ExitCode {
    cli::commands::main(handlers::registry())
}
