//! The program `scott`, the inspector: service objects asked by lines of text (SORMA technical report,
//! section 1.8.1).
//!
//! [`services`] gathers the objects, [`attach`] reaches those of a running app. [`lines`] reads scripts, [`script`]
//! is the grammar, [`session`] runs it, [`replies`] and `numbers` write the results. `helping` tells what there is,
//! [`prompt`] is the line editor, [`complete`] what it offers. [`panel`] shows objects on a web page, for this
//! program and as an event handler.

pub mod attach;
pub mod backend;
pub mod complete;
pub mod follow;
mod helping;
pub mod lines;
mod numbers;
pub mod panel;
mod patience;
pub mod prompt;
pub mod replies;
pub mod script;
pub mod services;
pub mod session;
pub mod watch;

use std::{
    fs::File,
    io::{self, IsTerminal},
    net::SocketAddr,
    path::{Path, PathBuf},
    process::ExitCode,
    sync::Arc,
    time::Duration,
};

use clap::Parser;
use signal_hook::consts::SIGINT;

use attach::{App, AttachError, Interrupt, Limit, Where};
use backend::Backend;
use cli_common::{
    exit,
    remote::{self, AtArgs},
    show::{self, Colour},
};
use session::{Flow, Place, Session};

/// What an app permits, s.
const LONGEST_LIMIT_S: f64 = 86_400.0;

const EXAMPLES: &str = "Examples:
  scott calibrate
  scott calibrate -c 'watch mvpos.* --kind EXEC --slower 50ms'
  scott --at lab7:7411 --key keys/anna -c 'sorm CTRL -list'
  scott --local
  scott --local -c 'kin.puma560 EXEC TMSG fkine FMSG 6 0 0 0 0 0 0'
  scott --local -c 'resect CTRL -size 640 480 -model k1k2' -c 'resect EXEC lights.csv'
  scott --local -f checks.sor --json
  scott --local --panel configs/panels/puma560.toml";

/// Ask service objects by lines of text
///
/// It asks a running app, found as by `ctos ps`, or with `--local` the classes that this program carries itself.
/// A request is `name EXEC|CTRL|DBX text`, for example `foo.a EXEC` or `spot CTRL -help`; docs/services.md lists what
/// there is. Replies go to standard output, one line each, in the form that reads back exactly; what is to be said
/// about them goes to standard error. Without `-c` and `-f`, statements come from standard input; at a terminal they
/// are typed at a prompt, with completion (Tab), search in the history (Ctrl-R), and Ctrl-D to leave. There numbers stand
/// as they are (`kin EXEC fkine 0 0 0 0 0 0`), and answers have names and units.
#[derive(Debug, Parser)]
#[command(name = "scott", version, max_term_width = 100)]
#[command(after_help = format!("{STATEMENTS}\n\n{EXAMPLES}\n\n{}", exit::help()))]
pub struct Cli {
    /// Running app to attach to: its name, process id or NAME-PID; needed only when several are running
    #[arg(value_name = "APP", conflicts_with_all = ["local", "at"])]
    pub app: Option<String>,
    /// An app on another host
    #[command(flatten)]
    pub at: AtArgs,
    /// Task that is asked when a name says none (`NAME@TASK`); the app's first with the handler `sorma.daemon` when
    /// it is left out
    #[arg(long, value_name = "TASK", conflicts_with = "local")]
    pub daemon: Option<String>,
    /// How long an answer is waited for, s; then it is said what keeps it, and what can be done. What is asked of
    /// objects of this very process (--local) has no limit but Ctrl-C, which ends the program
    #[arg(long, value_name = "S", default_value_t = attach::LIMIT_S, value_parser = limit, conflicts_with = "local")]
    pub limit: f64,
    /// Carry all classes of service objects in this process; no app needs to run
    #[arg(long, conflicts_with = "at")]
    pub local: bool,
    /// Run this statement and end (can be repeated)
    #[arg(short = 'c', long = "command", value_name = "STATEMENT")]
    pub commands: Vec<String>,
    /// Run the statements of a file, after those of -c, and end; `-` is standard input
    #[arg(short, long, value_name = "FILE")]
    pub file: Option<PathBuf>,
    /// Go on after a failure; the exit code is that of the first
    #[arg(short, long)]
    pub keep_going: bool,
    /// Print replies as JSON, one object per line
    #[arg(long)]
    pub json: bool,
    /// Read recipes and addresses from a dictionary file, over those that are shipped (can be repeated)
    #[arg(long = "dict", value_name = "FILE", requires = "local")]
    pub dictionaries: Vec<PathBuf>,
    /// Serve a panel as a web page: a file that describes it, or the name of an object whose options it shows
    #[arg(long, value_name = "FILE|OBJECT", conflicts_with_all = ["commands", "file"])]
    pub panel: Option<String>,
    /// Where the panel is served
    #[arg(
        long,
        value_name = "ADDRESS:PORT",
        default_value = "127.0.0.1:0",
        requires = "panel"
    )]
    pub listen: SocketAddr,
    /// Edit lines with the keys of vi
    #[arg(long)]
    pub vi: bool,
    /// When to use colours; `auto` asks NO_COLOR, then CLICOLOR_FORCE, then the terminal
    #[arg(long, value_enum, value_name = "WHEN", default_value_t)]
    pub color: Colour,
}

pub(crate) const STATEMENTS: &str =
    "Statements, one a line (\\ at its end: the next one belongs to it; # a comment):
  NAME EXEC|CTRL|DBX TEXT   a request
  help [NAME]               how one asks, or what an object can do;
                            also ? and NAME ?
  list [TEXT]               objects and classes, or those with TEXT in a name
  set NAME = WORDS          a variable, used as $NAME; the last reply's are
                            $RET, $TMSG, $FMSG and $IMSG
  expect RET 0              what the last reply must be: RET, TMSG,
                            FMSG n .. [within TOLERANCE], IMSG, TDBX; an error
                            is a failure unless an expect RET meets it
  time REQUEST              how long it takes, reading and writing its text too
  repeat 1000 REQUEST       least, median and longest time
  trace REQUEST             every call that it leads to, on every daemon, with
                            its reply and how long it took
  watch PATTERN[@DAEMON]    the requests that the objects of a running app meet,
                            with their replies, until Ctrl-C;
                            --kind EXEC|CTRL|DBX, --slower 50ms, --from PATTERN,
                            --failed, --count N pick out some at the source;
                            with & at the end it goes on above the prompt";

/// Runs the command line of this process.
#[must_use]
pub fn main() -> ExitCode {
    show::choose_colour(Colour::of_command_line(std::env::args_os()));
    ExitCode::from(run(&Cli::parse()))
}

/// Reads how long `scott` waits for an answer, s.
fn limit(text: &str) -> Result<f64, String> {
    let limit = text.parse().ok();
    let limit = limit.filter(|limit| (0.0..=LONGEST_LIMIT_S).contains(limit));
    limit.ok_or_else(|| format!("it is 0 to {LONGEST_LIMIT_S} s"))
}

fn run(cli: &Cli) -> u8 {
    let backend = match backend(cli) {
        Ok(backend) => backend,
        Err(code) => return code,
    };
    if let Some(what) = &cli.panel {
        return panel::run(backend, what, cli.listen);
    }
    let mut session = Session::new(backend, cli.json, cli.keep_going);
    for command in &cli.commands {
        let place = Place {
            name: "-c",
            line: 0,
            wrong: exit::USAGE,
        };
        if session.line(&place, command) == Flow::Stop {
            return session.end();
        }
    }
    match &cli.file {
        Some(path) if path == Path::new("-") => from_input(&mut session),
        Some(path) => from_file(&mut session, path),
        None if !cli.commands.is_empty() => session.end(),
        None if io::stdin().is_terminal() => prompt::run(&mut session, cli.vi),
        None => from_input(&mut session),
    }
}

/// Whom the session asks, or the exit code.
fn backend(cli: &Cli) -> Result<Backend, u8> {
    if cli.local {
        return match services::manager(&cli.dictionaries) {
            Ok(sorm) => Ok(Backend::Local(sorm)),
            Err(findings) => {
                show::findings(findings);
                Err(exit::CONFIG)
            }
        };
    }
    let interrupt = Interrupt::default();
    // A request is given up by Ctrl-C, and nothing else is. Where that cannot be had, the program ends.
    if let Err(error) = signal_hook::flag::register(SIGINT, Arc::clone(&interrupt)) {
        show::say(&format!("Ctrl-C ends the program: {error}"));
    }
    let place = Where {
        app: cli.app.clone(),
        at: cli.at.clone(),
        daemon: cli.daemon.clone(),
        limit: Limit(Duration::from_secs_f64(cli.limit)),
    };
    match App::attach(place, interrupt) {
        Ok(app) => Ok(Backend::App(Box::new(app))),
        Err(AttachError::Client(error)) => {
            let code = remote::failed(&error);
            show::say("  scott --local needs no running app");
            Err(code)
        }
        Err(error) => {
            show::say(&format!("error: {error}"));
            Err(exit::NO_SUCH_NAME)
        }
    }
}

fn from_input(session: &mut Session) -> u8 {
    let name = "standard input";
    session.script(name, io::stdin().lock());
    session.end()
}

fn from_file(session: &mut Session, path: &Path) -> u8 {
    let name = path.display().to_string();
    match File::open(path) {
        Ok(file) => {
            session.script(&name, file);
            session.end()
        }
        Err(error) => {
            show::say(&format!("error: cannot read `{name}`: {error}"));
            exit::CONFIG
        }
    }
}
