//! `ctos net`: the tools of whoever writes nets, a file each.

pub mod check;
pub mod convert;
pub mod draw;
pub mod fmt;
pub mod lsp;
pub mod perf;

use clap::{Args, Subcommand};
use ctos::registry::Registry;

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
    /// everything; what another form has no words for is told.
    Convert(convert::ConvertArgs),
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
    /// Say how fast nets go whose transitions say what they take
    Perf(perf::PerfArgs),
}

/// Runs the command.
#[must_use]
pub fn run(args: &NetArgs, registry: &Registry) -> u8 {
    match &args.command {
        NetCommand::Check(args) => check::run(args, registry),
        NetCommand::Convert(args) => convert::run(args),
        NetCommand::Draw(args) => draw::run(args),
        NetCommand::Fmt(args) => fmt::run(args),
        NetCommand::Lsp(args) => lsp::run(args, registry),
        NetCommand::Perf(args) => perf::run(args),
    }
}
