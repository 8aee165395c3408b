//! The command `ctos`.

use std::process::ExitCode;

fn main() -> ExitCode {
    cli::commands::main(cli::program::registry())
}
