//! `ctos net check`.

mod report;
mod structure;

use std::{
    collections::BTreeSet,
    io::IsTerminal,
    path::{Path, PathBuf},
    sync::Arc,
};

use clap::{Args, ValueEnum};
use ctos::{
    config::Selection,
    diagnostic::{Findings, Source},
    registry::Registry,
    time::Clock,
};
use indicatif::ProgressBar;
use pnt::{
    analysis::{explicit::Progress, verdict::Engines},
    check::{
        self, Asks, Limits, Options, Proof, Rule,
        tapes::{self, Tape},
    },
    format,
    net::Net,
    task,
};
use report::Answer;

use cli_common::{exit, show};

use crate::ReadApp;

/// Prove nets sound, or show a firing sequence by which they are not
///
/// A net without commands is sound when it is bounded, has no dead marking, and each of its transitions can fire at
/// some time. A net with commands is checked with an open tape, on which any command may come when the one before is
/// answered: it must be bounded, answer each command once, and always find back to its initial marking; with a given
/// tape, always be able to come to the end of it. Files whose nets name each other are checked as one system, others by
/// themselves.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  ctos net check configs/nets/hello.net
  ctos net check cell.pnml --json
  ctos net check configs/nets/hello.net --always idle --structure
  ctos net check configs/nets/hello.net --tape 'hello (hello | hello hello)*'
  ctos net check --app configs/calibrate.toml
  ctos net check configs/nets/motion.net --app configs/calibrate.toml")]
pub struct CheckArgs {
    /// The nets
    #[arg(value_name = "FILE", required_unless_present = "app")]
    pub files: Vec<PathBuf>,
    /// Check the nets of this app, all together; a FILE takes the place of its net of the same name
    #[arg(long, value_name = "APP")]
    pub app: Option<PathBuf>,
    /// Print a JSON object for each system of nets
    #[arg(long)]
    pub json: bool,
    /// Stop after so many markings
    #[arg(long, value_name = "N", default_value_t = usize::MAX, hide_default_value = true)]
    pub max_markings: usize,
    /// Stop when markings and what finds them need more; `k`, `M` and `G` stand for 2^10, 2^20 and 2^30
    #[arg(long, value_name = "BYTES", value_parser = bytes, default_value = "4G")]
    pub max_memory: usize,
    /// Threads that look for markings
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=256), default_value = "1")]
    pub threads: u16,
    /// How markings are found
    #[arg(long, value_enum, value_name = "ENGINE", default_value_t)]
    pub engine: EngineArg,
    /// Ask whether a marking like this can be reached, for example `--can "gripper & parts >= 2"` (can be repeated)
    #[arg(long, value_name = "QUESTION")]
    pub can: Vec<String>,
    /// Ask whether no marking like this can be reached (can be repeated)
    #[arg(long, value_name = "QUESTION")]
    pub never: Vec<String>,
    /// Ask whether a marking like this can be reached from every reachable one (can be repeated)
    #[arg(long, value_name = "QUESTION")]
    pub always: Vec<String>,
    /// Let only this come on a net's input tape, for example `--tape "calibrate (carry | resect)* park"`; with the net and
    /// a colon before it where several have tapes; `@FILE` reads it from a file (can be repeated)
    #[arg(long, value_name = "TAPE")]
    pub tape: Vec<String>,
    /// Tell what follows from the arcs alone: invariants, siphons, components, cycle times
    #[arg(long)]
    pub structure: bool,
    /// Show every finding and not only the first 20
    #[arg(long)]
    pub all: bool,
}

/// How markings are found.
#[derive(Debug, Clone, Copy, Default, ValueEnum)]
pub enum EngineArg {
    /// As suits the net
    #[default]
    Auto,
    /// One after the other
    Explicit,
    /// As decision diagrams, where the net permits it
    Symbolic,
}

impl From<EngineArg> for Engines {
    fn from(engine: EngineArg) -> Self {
        match engine {
            EngineArg::Auto => Self::Both,
            EngineArg::Explicit => Self::Explicit,
            EngineArg::Symbolic => Self::Symbolic,
        }
    }
}

/// A number of bytes.
fn bytes(text: &str) -> Result<usize, String> {
    let (digits, factor) = match text.char_indices().last() {
        Some((at, 'k' | 'K')) => (&text[..at], 1_usize << 10),
        Some((at, 'M')) => (&text[..at], 1 << 20),
        Some((at, 'G')) => (&text[..at], 1 << 30),
        _ => (text, 1),
    };
    let number: usize = digits
        .parse()
        .map_err(|error| format!("{error}; write for example 500M"))?;
    number
        .checked_mul(factor)
        .ok_or_else(|| "too large".to_owned())
}

/// Runs the command. The code is the worst of all systems.
#[must_use]
pub fn run(args: &CheckArgs, registry: &Registry, read: ReadApp) -> u8 {
    let (nets, warnings) = match nets(args, registry, read) {
        Ok(read) => read,
        Err(findings) => return wrong(findings, args),
    };
    shown(warnings, args);
    let tapes = match tapes(args, &nets) {
        Ok(tapes) => tapes,
        Err(findings) => return wrong(findings, args),
    };
    let systems = if args.app.is_some() {
        vec![nets]
    } else {
        systems(nets)
    };
    let codes = systems.iter().map(|nets| system(nets, &tapes, args));
    codes.max().unwrap_or(exit::OK)
}

fn wrong(findings: Findings, args: &CheckArgs) -> u8 {
    shown(findings, args);
    exit::CONFIG
}

fn shown(findings: Findings, args: &CheckArgs) {
    let most = if args.all {
        usize::MAX
    } else {
        show::FINDINGS_SHOWN
    };
    show::findings_up_to(findings, most);
}

/// The nets of the files and of the app, and warnings about them.
fn nets(
    args: &CheckArgs,
    registry: &Registry,
    read: ReadApp,
) -> Result<(Vec<Arc<Net>>, Findings), Findings> {
    let mut findings = Findings::new();
    let mut nets: Vec<Arc<Net>> = Vec::new();
    for file in &args.files {
        match format::load(file) {
            Ok((net, warnings)) => {
                findings.extend(warnings);
                nets.push(Arc::new(net));
            }
            Err(found) => findings.extend(found),
        }
    }
    if let Some(file) = &args.app {
        let selection = Selection {
            file: file.clone(),
            ..Selection::default()
        };
        let others =
            read(&selection).and_then(|app| task::nets(&app, registry).map(|others| (app, others)));
        match others {
            Ok((app, others)) => {
                let given: BTreeSet<String> = nets.iter().map(|n| n.name().to_owned()).collect();
                nets.extend(others.into_iter().filter(|net| !given.contains(net.name())));
                task::check_messages(&nets, &app, registry, &mut findings);
            }
            Err(found) => findings.extend(found),
        }
    }
    if findings.has_errors() {
        Err(findings)
    } else {
        Ok((nets, findings))
    }
}

/// What is said to come on tapes.
fn tapes(args: &CheckArgs, nets: &[Arc<Net>]) -> Result<Vec<Tape>, Findings> {
    let mut findings = Findings::new();
    let mut all = Vec::new();
    for text in &args.tape {
        let source = match text.strip_prefix('@') {
            Some(file) => findings.keep(Source::read(Path::new(file))),
            None => Some(Source::new("--tape", text.as_str())),
        };
        match source.map(|source| tapes::tapes(&source, nets)) {
            Some(Ok(tapes)) => all.extend(tapes),
            Some(Err(found)) => findings.extend(found),
            None => {}
        }
    }
    findings.extend(tapes::given_twice(&all));
    if findings.has_errors() {
        Err(findings)
    } else {
        Ok(all)
    }
}

/// The nets in groups: those that name each other, directly or through others, are together.
fn systems(nets: Vec<Arc<Net>>) -> Vec<Vec<Arc<Net>>> {
    let mut groups: Vec<Vec<Arc<Net>>> = Vec::new();
    for net in nets {
        let (with, mut without): (Vec<_>, Vec<_>) = groups.into_iter().partition(|group| {
            group
                .iter()
                .any(|other| knows(&net, other) || knows(other, &net))
        });
        let mut together: Vec<Arc<Net>> = with.into_iter().flatten().collect();
        together.push(net);
        without.push(together);
        groups = without;
    }
    groups
}

/// Whether one net names the other.
fn knows(net: &Net, other: &Net) -> bool {
    let partners = net.coordinators().iter().chain(net.serves());
    let mut names = partners
        .map(|partner| partner.net.as_str())
        .chain(net.remote_nets());
    names.any(|name| name == other.name())
}

fn system(nets: &[Arc<Net>], tapes: &[Tape], args: &CheckArgs) -> u8 {
    let rule = if args.app.is_some() {
        Rule::Rest
    } else {
        Rule::of(nets)
    };
    let options = Options {
        rule,
        limits: Limits {
            markings: args.max_markings,
            bytes: args.max_memory,
            threads: usize::from(args.threads),
        },
        engines: args.engine.into(),
        questions: questions(args),
        workflows: rule == Rule::Rest,
        tapes: tapes
            .iter()
            .filter(|tape| nets.iter().any(|net| net.name() == tape.net))
            .cloned()
            .collect(),
    };
    let clock = Clock::real();
    let start = clock.now();
    let display = Display::new();
    let proof = check::prove(nets, &options, &mut |progress| display.show(progress));
    let seconds = (clock.now() - start).as_secs_f64();
    display.clear();
    let mut proof = match proof {
        Ok(proof) => proof,
        Err(findings) => return wrong(findings, args),
    };
    let answer = Answer::new(nets, &options, &proof, seconds, args.structure);
    let code = code(&proof, answer.sound);
    shown(std::mem::take(&mut proof.findings), args);
    // A reader that went away has what it wanted.
    let _ = show::data(&if args.json {
        answer.json()
    } else {
        answer.text()
    });
    code
}

fn questions(args: &CheckArgs) -> Vec<(Asks, String)> {
    let lists = [
        (Asks::Can, &args.can),
        (Asks::Never, &args.never),
        (Asks::Always, &args.always),
    ];
    let asked = lists
        .into_iter()
        .flat_map(|(asks, texts)| texts.iter().map(move |t| (asks, t)));
    asked.map(|(asks, text)| (asks, text.clone())).collect()
}

/// Not proved for want of room is no fault of the nets; a question may be answered all the same.
fn code(proof: &Proof, sound: bool) -> u8 {
    let unknown = proof
        .answers
        .iter()
        .any(|answered| answered.yes().is_none());
    let no = proof
        .answers
        .iter()
        .any(|answered| answered.yes() == Some(false));
    let decided = proof.verdict.complete || proof.verdict.bounded.is_some();
    match (decided && !unknown, sound && !no) {
        (false, _) => exit::TIMED_OUT,
        (true, true) => exit::OK,
        (true, false) => exit::FAILED,
    }
}

/// How far a long search is, on a terminal.
struct Display(Option<ProgressBar>);

impl Display {
    fn new() -> Self {
        Self(
            std::io::stderr()
                .is_terminal()
                .then(ProgressBar::new_spinner),
        )
    }

    fn show(&self, progress: &Progress) {
        if let Some(bar) = &self.0 {
            let what = match progress.for_deadlock {
                true => "looking only for deadlocks now: ",
                false => "",
            };
            bar.set_message(format!(
                "{what}{} markings, {} of them looked at, {} firings away; {} MiB",
                progress.markings,
                progress.expanded,
                progress.level,
                progress.bytes >> 20
            ));
            bar.tick();
        }
    }

    fn clear(&self) {
        if let Some(bar) = &self.0 {
            bar.finish_and_clear();
        }
    }
}

#[cfg(test)]
mod tests {
    use ctos::diagnostic::Source;

    use super::*;

    #[test]
    fn numbers_of_bytes_have_units_of_powers_of_two() {
        assert_eq!(bytes("17"), Ok(17));
        assert_eq!(bytes("2k"), Ok(2048));
        assert_eq!(bytes("3M"), Ok(3 << 20));
        assert_eq!(bytes("4G"), Ok(4 << 30));
        for wrong in [
            "",
            "M",
            "-1",
            "1.5G",
            "1T",
            "99999999999999999999",
            "18446744073709551615G",
        ] {
            assert!(bytes(wrong).is_err(), "{wrong}");
        }
    }

    #[test]
    fn nets_that_name_each_other_are_one_system() {
        let net = |name: &str, out: &str| {
            let text = format!("net {name}\nplace p = 1\ntransition t\n  in p\n  out p{out}\n");
            let net = pnt::compile::net(&Source::new(name.to_owned(), text));
            Arc::new(net.unwrap_or_else(|findings| panic!("{findings}")))
        };
        let groups = systems(vec![
            net("a", ", p@c"),
            net("b", ""),
            net("c", ""),
            net("d", ", p@b"),
        ]);
        let names = |group: &Vec<Arc<Net>>| -> Vec<String> {
            group.iter().map(|net| net.name().to_owned()).collect()
        };
        let names: Vec<Vec<String>> = groups.iter().map(names).collect();
        assert_eq!(names, [["a", "c"], ["b", "d"]]);
    }
}
