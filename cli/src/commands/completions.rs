//! `ctos completions`.

use clap::{Args, CommandFactory};
use clap_complete::Shell;

use crate::{commands::Cli, exit};

/// Print completions for a shell
#[derive(Debug, Args)]
#[command(after_help = "Example:
  ctos completions bash > ~/.local/share/bash-completion/completions/ctos")]
pub struct CompletionsArgs {
    /// For which shell
    pub shell: Shell,
}

/// Runs the command.
#[must_use]
pub fn run(args: &CompletionsArgs) -> u8 {
    let mut text = Vec::new();
    clap_complete::generate(args.shell, &mut Cli::command(), "ctos", &mut text);
    // A closed pipe means that the reader has what it wanted.
    let _ = std::io::Write::write_all(&mut std::io::stdout(), &text);
    exit::OK
}
