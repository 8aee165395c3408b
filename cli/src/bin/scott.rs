//! The command `scott`.

use std::process::ExitCode;

fn main() -> ExitCode {
    cli::scott::main()
}
