//! Interventions in a running net, and looking at it: `ctos net fire`, `put`, `take`, `pause`, `resume`,
//! `step`, `break`, `cancel`, `complete`, `replace`, `ask`, `tape` and `marking`.

use std::{path::PathBuf, time::Duration};

use clap::Args;
use ctos::message::Command;
use pnt::task::{Control, Marking, Order, Output, PutTape, ReadTape, Snapshot};

use cli_common::{
    exit,
    remote::{self, RemoteArgs},
    show,
};

/// How long a net may take to answer, s. It answers when what was done is stored.
const LIMIT_S: f64 = 10.0;

/// Which net, and how it is told.
#[derive(Debug, Args)]
pub struct NetTaskArgs {
    /// Name of the net's task
    pub net: String,
    /// Which app
    #[command(flatten)]
    pub remote: RemoteArgs,
    /// Print one JSON object
    #[arg(long)]
    pub json: bool,
}

/// A net and one of its transitions.
#[derive(Debug, Args)]
pub struct TransitionArgs {
    /// Which net
    #[command(flatten)]
    pub task: NetTaskArgs,
    /// Name of the transition
    pub transition: String,
}

/// A net and one of its places.
#[derive(Debug, Args)]
pub struct PlaceArgs {
    /// Which net
    #[command(flatten)]
    pub task: NetTaskArgs,
    /// Name of the place
    pub place: String,
    /// How many tokens
    #[arg(default_value_t = 1)]
    pub tokens: u32,
}

/// A net and a number of firings.
#[derive(Debug, Args)]
pub struct StepArgs {
    /// Which net
    #[command(flatten)]
    pub task: NetTaskArgs,
    /// How many firings
    #[arg(default_value_t = 1)]
    pub firings: u32,
}

/// A net and a breakpoint.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  ctos net break dispatcher move_robot
  ctos net break dispatcher 'spot_done>=1'
  ctos net break dispatcher --clear")]
pub struct BreakArgs {
    /// Which net
    #[command(flatten)]
    pub task: NetTaskArgs,
    /// A transition, or PLACE>=N, PLACE<=N or PLACE=N
    #[arg(value_name = "WHERE", required_unless_present = "clear")]
    pub breakpoint: Option<String>,
    /// Remove this breakpoint, or all when none is named
    #[arg(long)]
    pub clear: bool,
}

/// A net and what shall take its place.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  ctos net replace dispatcher configs/nets/dispatcher.net --within 30")]
pub struct ReplaceArgs {
    /// Which net
    #[command(flatten)]
    pub task: NetTaskArgs,
    /// The new net
    pub file: PathBuf,
    /// How long to wait for a safe marking, s
    #[arg(long, default_value_t = 10.0, value_name = "SECONDS")]
    pub within: f64,
}

/// A net and a command for its tape.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  ctos net ask dispatcher --success carried carry 3,4,0 4,5,0")]
pub struct AskArgs {
    /// Which net
    #[command(flatten)]
    pub task: NetTaskArgs,
    /// The command, as the net has it
    pub symbol: String,
    /// Its arguments
    #[arg(allow_hyphen_values = true)]
    pub arguments: Vec<String>,
    /// Exit with 1 unless this is the answer (can be repeated)
    #[arg(long, value_name = "ANSWER")]
    pub success: Vec<String>,
    /// How long to wait for the answer, s; the command goes on without being waited for
    #[arg(long, default_value_t = 600.0, value_name = "SECONDS")]
    pub within: f64,
}

/// A net whose output tape is read.
#[derive(Debug, Args)]
pub struct TapeArgs {
    /// Which net
    #[command(flatten)]
    pub task: NetTaskArgs,
    /// Remove the answers up to this number first
    #[arg(long, default_value_t = 0, value_name = "NUMBER")]
    pub taken: u64,
}

/// Runs `ctos net fire`.
#[must_use]
pub fn fire(args: &TransitionArgs) -> u8 {
    let transition = args.transition.clone();
    order(&args.task, Order::Fire { transition })
}

/// Runs `ctos net cancel`.
#[must_use]
pub fn cancel(args: &TransitionArgs) -> u8 {
    let transition = args.transition.clone();
    order(&args.task, Order::Cancel { transition })
}

/// Runs `ctos net complete`.
#[must_use]
pub fn complete(args: &TransitionArgs) -> u8 {
    let transition = args.transition.clone();
    order(&args.task, Order::Complete { transition })
}

/// Runs `ctos net put`.
#[must_use]
pub fn put(args: &PlaceArgs) -> u8 {
    let (place, tokens) = (args.place.clone(), args.tokens);
    order(&args.task, Order::Put { place, tokens })
}

/// Runs `ctos net take`.
#[must_use]
pub fn take(args: &PlaceArgs) -> u8 {
    let (place, tokens) = (args.place.clone(), args.tokens);
    order(&args.task, Order::Take { place, tokens })
}

/// Runs `ctos net pause`.
#[must_use]
pub fn pause(args: &NetTaskArgs) -> u8 {
    order(args, Order::Pause)
}

/// Runs `ctos net resume`.
#[must_use]
pub fn resume(args: &NetTaskArgs) -> u8 {
    order(args, Order::Resume)
}

/// Runs `ctos net step`.
#[must_use]
pub fn step(args: &StepArgs) -> u8 {
    let firings = args.firings;
    order(&args.task, Order::Step { firings })
}

/// Runs `ctos net break`.
#[must_use]
pub fn set_breakpoint(args: &BreakArgs) -> u8 {
    let at = args.breakpoint.clone();
    let wanted = match at {
        Some(at) if !args.clear => Order::Break { at },
        at => Order::Clear { at },
    };
    order(&args.task, wanted)
}

/// Runs `ctos net replace`.
#[must_use]
pub fn replace(args: &ReplaceArgs) -> u8 {
    let text = match std::fs::read_to_string(&args.file) {
        Ok(text) => text,
        Err(error) => {
            show::say(&format!("error: {}: {error}", args.file.display()));
            return exit::CONFIG;
        }
    };
    if !(args.within >= 0.0 && args.within <= 3000.0) {
        show::say("error: `--within` is a number of seconds from 0 to 3000");
        return exit::USAGE;
    }
    let order = Order::Replace {
        file: args.file.display().to_string(),
        text,
        // Within the limits above.
        within_ms: (args.within * 1000.0) as u64,
    };
    told(&args.task, order, args.within + LIMIT_S)
}

/// Runs `ctos net ask`.
#[must_use]
pub fn ask_command(args: &AskArgs) -> u8 {
    if !(args.within > 0.0 && args.within <= 86_400.0) {
        show::say("error: `--within` is a number of seconds above 0, up to 86400");
        return exit::USAGE;
    }
    let put = PutTape {
        symbol: args.symbol.clone(),
        arguments: args.arguments.clone(),
    };
    let answer = match ask(&args.task, put, args.within) {
        Ok(answer) => answer,
        Err(code) => return code,
    };
    let is_success = args.success.is_empty() || args.success.contains(&answer.symbol);
    if args.task.json {
        data(&serde_json::json!({
            "net": args.task.net, "answer": answer.symbol, "text": answer.text,
        }));
    } else {
        let text = answer.text.replace('\n', "\n          ");
        // A reader that went away has what it wanted.
        let _ = show::data(&format!("{}  {text}", answer.symbol));
    }
    match is_success {
        true => exit::OK,
        false => exit::FAILED,
    }
}

/// Runs `ctos net tape`.
#[must_use]
pub fn tape(args: &TapeArgs) -> u8 {
    let read = ReadTape { taken: args.taken };
    let output = match ask(&args.task, read, LIMIT_S) {
        Ok(output) => output,
        Err(code) => return code,
    };
    if args.task.json {
        return data(&serde_json::json!({ "net": args.task.net, "output": output }));
    }
    for Output {
        number,
        command,
        arguments,
        answer,
    } in output
    {
        let words = [&[command], arguments.as_slice()].concat().join(" ");
        let text = answer.text.replace('\n', "\n          ");
        let _ = show::data(&format!(
            "{number:>8}  {words} -> {}  {text}",
            answer.symbol
        ));
    }
    exit::OK
}

/// Runs `ctos net marking`.
#[must_use]
pub fn marking(args: &NetTaskArgs) -> u8 {
    let snapshot = match ask(args, Marking {}, LIMIT_S) {
        Ok(snapshot) => snapshot,
        Err(code) => return code,
    };
    if args.json {
        return data(&serde_json::json!(snapshot));
    }
    // A reader that went away has what it wanted.
    let _ = show::data(&words(&snapshot));
    exit::OK
}

/// A net as a person reads it.
fn words(snapshot: &Snapshot) -> String {
    let mut lines = vec![format!("net      {}", snapshot.net)];
    let marked = snapshot.places.iter().filter(|(_, tokens)| *tokens > 0);
    lines.extend(marked.map(|(place, tokens)| format!("place    {place} {tokens}")));
    lines.extend(
        snapshot
            .data
            .iter()
            .map(|(name, value)| format!("data     {name} = {value}")),
    );
    lines.extend(
        snapshot
            .in_action
            .iter()
            .map(|name| format!("action   {name}")),
    );
    lines.extend(
        snapshot
            .in_progress
            .iter()
            .map(|symbol| format!("command  {symbol}")),
    );
    lines.extend(
        snapshot
            .tape
            .iter()
            .map(|symbol| format!("tape     {symbol}")),
    );
    lines.extend(
        snapshot
            .sending
            .iter()
            .map(|(net, count)| format!("sending  {count} to {net}")),
    );
    lines.extend(
        snapshot
            .breakpoints
            .iter()
            .map(|at| format!("break    {at}")),
    );
    lines.extend(snapshot.paused.iter().map(|why| format!("paused   {why}")));
    lines.extend(snapshot.halted.iter().map(|why| format!("stopped  {why}")));
    lines.join("\n")
}

fn order(args: &NetTaskArgs, order: Order) -> u8 {
    told(args, order, LIMIT_S)
}

/// Tells a net what to do, and shows what it did.
fn told(args: &NetTaskArgs, order: Order, within_s: f64) -> u8 {
    let by = whoever_runs_this();
    match ask(args, Control { order, by }, within_s) {
        Ok(done) if args.json => data(&serde_json::json!({ "net": args.net, "done": done })),
        Ok(done) => {
            show::say(&format!("{}: {done}", args.net));
            exit::OK
        }
        Err(code) => code,
    }
}

/// The user of this command, as the host calls them.
fn whoever_runs_this() -> String {
    let user = ["USER", "LOGNAME"].iter().find_map(|key| {
        let name = std::env::var(key).ok()?;
        (!name.is_empty()).then_some(name)
    });
    user.unwrap_or_else(|| format!("user {}", rustix::process::getuid().as_raw()))
}

fn data(object: &serde_json::Value) -> u8 {
    // A reader that went away has what it wanted.
    let _ = show::data(&object.to_string());
    exit::OK
}

/// Sends a net one of its commands; the exit code when that failed, which has been told.
fn ask<C: Command>(args: &NetTaskArgs, request: C, within_s: f64) -> Result<C::Reply, u8> {
    let within = Duration::from_secs_f64(within_s);
    let answer = args
        .remote
        .connect()
        .and_then(|mut client| client.call(&args.net, request, within));
    answer.map_err(|error| remote::failed_for(&[&args.net], &error))
}
