//! `ctos completions`.

use clap::{Args, Command};
use clap_complete::Shell;
use cli_common::exit;

/// Print completions for a shell
#[derive(Debug, Args)]
#[command(after_help = "Example:
  ctos completions bash > ~/.local/share/bash-completion/completions/ctos")]
pub struct CompletionsArgs {
    /// For which shell
    pub shell: Shell,
}

/// Runs the command, for all that `program` has.
#[must_use]
pub fn run(args: &CompletionsArgs, program: &mut Command) -> u8 {
    let mut text = Vec::new();
    clap_complete::generate(args.shell, program, "ctos", &mut text);
    // A closed pipe means that the reader has what it wanted.
    let _ = std::io::Write::write_all(&mut std::io::stdout(), &text);
    exit::OK
}
