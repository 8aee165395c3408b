//! `ctos net`: tools for authors of nets, gathered from their crates.

pub mod run;
pub mod watch;

use clap::{Args, Subcommand};
use cli_display::draw;
use cli_net::{check, control, convert, fmt, lsp, perf, play};
use ctos::registry::Registry;

use crate::program;

/// Check nets, and other tools of whoever writes them
#[derive(Debug, Args)]
pub struct NetArgs {
    /// What to do
    #[command(subcommand)]
    pub command: NetCommand,
}

/// What can be done with nets.
#[derive(Debug, Subcommand)]
pub enum NetCommand {
    /// Prove nets sound, or show a firing sequence by which they are not
    Check(check::CheckArgs),
    /// Write a net in another form
    ///
    /// Net text, PNML (ISO/IEC 15909-2) and the text of TINA are read, whichever it is, and written. PNML keeps
    /// everything; what another form has no words for is told. The other forms are drawings, as by `ctos net draw`.
    Convert(convert::ConvertArgs),
    /// Fire an enabled transition of a running net by hand
    ///
    /// As all interventions, it needs `allow_control = true` in the arguments of the net's task, the role `call`
    /// from another host, and is in the record and the log of the app.
    Fire(control::TransitionArgs),
    /// Put tokens into a place of a running net
    Put(control::PlaceArgs),
    /// Take tokens out of a place of a running net
    Take(control::PlaceArgs),
    /// Begin no more firings; actions that are going on come to their ends
    Pause(control::NetTaskArgs),
    /// Go on after a pause or a breakpoint
    Resume(control::NetTaskArgs),
    /// Begin so many firings of a paused net, then pause it again
    Step(control::StepArgs),
    /// Pause a net before a transition fires, or when a place comes to hold so many tokens
    Break(control::BreakArgs),
    /// End the action of a transition as failed
    Cancel(control::TransitionArgs),
    /// End the action of a transition as completed; what it would have put into data objects is not put
    Complete(control::TransitionArgs),
    /// Put another net in the place of a running one
    ///
    /// It is checked together with all nets of the app first, and put in place at the next safe marking: one that the
    /// net declares, or else its rest marking between two commands. Tokens are carried over by the names of places.
    Replace(control::ReplaceArgs),
    /// Put a command on the tape of a running net, and wait for its answer
    Ask(control::AskArgs),
    /// Read the output tape of a running net: answers that nobody waited for
    Tape(control::TapeArgs),
    /// Show the marking of a running net
    Marking(control::NetTaskArgs),
    /// Draw a net, or a moment of a recorded one
    ///
    /// As SVG, or in the language of Graphviz or Mermaid. Nodes stand where the layout file beside the net or its PNML says;
    /// what these do not name is arranged by rule.
    Draw(draw::DrawArgs),
    /// Lay out net text in the one usual way
    Fmt(fmt::FmtArgs),
    /// Serve an editor: findings as you type, completion, hover, rename, go to definition, layout
    ///
    /// Speaks the Language Server Protocol on standard input and output; an editor starts it. With `--app` the tasks
    /// of an app and their commands are offered, too.
    Lsp(lsp::LspArgs),
    /// Play a firing sequence, such as a counterexample of `ctos net check`, step by step
    ///
    /// The sequence begins at the initial marking of the nets. Each step is shown with the marking after it, and at the
    /// end what may fire then. A step that is not possible ends it with exit code 1 and the reason.
    Play(play::PlayArgs),
    /// Run one net by itself, without a configuration
    Run(run::RunArgs),
    /// Check a net at every save, until Ctrl-C
    Watch(watch::WatchArgs),
    /// Say how fast nets go whose transitions say what they take
    Perf(perf::PerfArgs),
}

/// Runs the command.
#[must_use]
pub fn run(args: &NetArgs, registry: Registry) -> u8 {
    let own = &registry;
    match &args.command {
        NetCommand::Check(args) => check::run(args, own, program::app),
        NetCommand::Convert(args) => convert::run(args, draw::drawing),
        NetCommand::Fire(args) => control::fire(args),
        NetCommand::Put(args) => control::put(args),
        NetCommand::Take(args) => control::take(args),
        NetCommand::Pause(args) => control::pause(args),
        NetCommand::Resume(args) => control::resume(args),
        NetCommand::Step(args) => control::step(args),
        NetCommand::Break(args) => control::set_breakpoint(args),
        NetCommand::Cancel(args) => control::cancel(args),
        NetCommand::Complete(args) => control::complete(args),
        NetCommand::Replace(args) => control::replace(args),
        NetCommand::Ask(args) => control::ask_command(args),
        NetCommand::Tape(args) => control::tape(args),
        NetCommand::Marking(args) => control::marking(args),
        NetCommand::Draw(args) => draw::run(args, |file, form| {
            let args = convert::ConvertArgs::to_output(file, form);
            convert::run(&args, draw::drawing)
        }),
        NetCommand::Fmt(args) => fmt::run(args),
        NetCommand::Lsp(args) => lsp::run(args, own, program::app),
        NetCommand::Perf(args) => perf::run(args),
        NetCommand::Play(args) => play::run(args, own, program::app),
        NetCommand::Run(args) => run::run(args, registry),
        NetCommand::Watch(args) => watch::run(args),
    }
}
