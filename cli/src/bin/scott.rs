//! The command `scott`.

use std::process::ExitCode;

fn main() -> ExitCode {
    cli::tell_build();
    cli::scott::main()
}
