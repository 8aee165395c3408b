//! `ctos net check`.

mod ending;
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
use ending::Ending;
use indicatif::ProgressBar;
use pnt::{
    analysis::{explicit::Progress, verdict::Engines},
    check::{
        self, Asks, Limits, Options, Proof, Rule,
        tapes::{self, Tape},
    },
    format::{self, Format},
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
  ctos net check cell.pnml --seconds 30 --deadlocks 10
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
    /// Stop after so many seconds and tell what is known by then; so does Ctrl-C
    #[arg(long, value_name = "SECONDS", value_parser = seconds)]
    pub seconds: Option<f64>,
    /// Show so many dead markings, each with a shortest firing sequence to it
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=1000), default_value = "1")]
    pub deadlocks: u16,
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

/// A time limit, s.
fn seconds(text: &str) -> Result<f64, String> {
    let seconds: f64 = text.parse().map_err(|_| "not a number".to_owned())?;
    if (0.0..=1.0e9).contains(&seconds) {
        Ok(seconds)
    } else {
        Err("write a number of seconds from 0 up".to_owned())
    }
}

/// Runs the command. The code is the worst of all systems.
#[must_use]
pub fn run(args: &CheckArgs, registry: &Registry, read: ReadApp) -> u8 {
    let ending = match Ending::new(args.seconds) {
        Ok(ending) => ending,
        Err(error) => {
            show::say(&format!("error: Ctrl-C cannot be waited for: {error}"));
            return exit::FAILED;
        }
    };
    let (nets, warnings) = match nets(args, registry, read) {
        Ok(read) => read,
        Err(findings) => return wrong(findings, args),
    };
    shown(warnings, args);
    let tapes = match tapes(args, &nets) {
        Ok(tapes) => tapes,
        Err(findings) => return wrong(findings, args),
    };
    let systems = check::systems(&nets);
    let codes = systems
        .iter()
        .map(|nets| system(nets, &tapes, &ending, args));
    codes.max().unwrap_or(exit::OK)
}

/// What is wrong with files keeps everything from being decided.
fn wrong(findings: Findings, args: &CheckArgs) -> u8 {
    if args.json {
        let each: Vec<_> = findings.iter().map(show::finding_json).collect();
        let object = serde_json::json!({ "nets": [], "sound": null, "findings": each });
        // A reader that went away has what it wanted.
        let _ = show::data(&object.to_string());
    }
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

/// The nets of the files and of the app, and warnings about them. Or else everything that is wrong with them, also
/// how they fit together as far as that is known.
fn nets(
    args: &CheckArgs,
    registry: &Registry,
    read: ReadApp,
) -> Result<(Vec<Arc<Net>>, Findings), Findings> {
    let mut findings = Findings::new();
    let mut nets: Vec<Arc<Net>> = Vec::new();
    // Nets of which some lines cannot be read, and whether every net has a name at least.
    let (mut broken, mut named) = (BTreeSet::new(), true);
    let mut given = Vec::new();
    for file in &args.files {
        let (net, found) = format::load_all(file);
        match net {
            Some(net) => {
                if found.has_errors() {
                    broken.insert(net.name().to_owned());
                }
                findings.extend(pnt_net::check_lines(&net));
                let net = Arc::new(net);
                given.push((Arc::clone(&net), file.as_path()));
                nets.push(net);
            }
            None => named = false,
        }
        findings.extend(found);
    }
    if let Some(file) = &args.app {
        match of_app(file, &given, registry, read) {
            Ok((others, found)) => {
                nets.extend(others);
                findings.extend(found);
            }
            Err(found) => {
                named = false;
                findings.extend(found);
            }
        }
    }
    if findings.has_errors() {
        for finding in check::fit(&nets).into_sorted() {
            let sure = match finding.code {
                "pnt::app::unknown_net" => named,
                "pnt::app::unknown_place" | "pnt::app::unknown_request" => broken.is_empty(),
                _ => false,
            };
            if sure {
                findings.push(finding);
            }
        }
        Err(with_hint(findings, args))
    } else {
        Ok((nets, findings))
    }
}

/// Where a net is missing that a file names, what to give as well.
fn with_hint(findings: Findings, args: &CheckArgs) -> Findings {
    let mut hinted = Findings::new();
    for mut finding in findings.into_sorted() {
        let meant = finding.help.as_deref().unwrap_or_default();
        let meant = meant.starts_with("did you mean");
        if finding.code == "pnt::app::unknown_net" && args.app.is_none() && !meant {
            let name = finding.message.split('`').nth(1).unwrap_or_default();
            let beside = finding.place.as_ref().and_then(|place| {
                let file = Path::new(place.source.name()).with_file_name(format!("{name}.net"));
                file.is_file().then_some(file)
            });
            let help = match beside {
                Some(file) => format!(
                    "give `{}` as well, or the app with `--app APP`",
                    file.display()
                ),
                None => {
                    format!("give the file of net `{name}` as well, or the app with `--app APP`")
                }
            };
            finding = finding.help(help);
        }
        hinted.push(finding);
    }
    hinted
}

/// The nets of an app but for those that are given.
///
/// # Errors
/// All findings about the app and its nets.
pub(crate) fn others_of_app(
    file: &Path,
    given: &[Arc<Net>],
    registry: &Registry,
    read: ReadApp,
) -> Result<Vec<Arc<Net>>, Findings> {
    let others = task::nets(&read(&Selection::new(file))?, registry)?;
    let is_given = |net: &Arc<Net>| given.iter().any(|other| other.name() == net.name());
    Ok(others.into_iter().filter(|net| !is_given(net)).collect())
}

/// The nets of an app but for those that are given, and what the boot finds wrong about all of them. The given ones
/// take the place of the app's own.
fn of_app(
    file: &Path,
    given: &[(Arc<Net>, &Path)],
    registry: &Registry,
    read: ReadApp,
) -> Result<(Vec<Arc<Net>>, Findings), Findings> {
    let mut selection = Selection::new(file);
    let mut app = read(&selection)?;
    let tasks = task::net_tasks(&app, registry);
    for (net, path) in given {
        let text = format::read(path).is_ok_and(|file| file.format == Format::Text);
        if let (true, Ok(path)) = (
            text && tasks.iter().any(|t| t == net.name()),
            path.canonicalize(),
        ) {
            // As TOML has strings.
            let path = serde_json::Value::from(path.to_string_lossy());
            let set = format!("task.{}.args.net={path}", net.name());
            selection.sets.push(set);
        }
    }
    if !selection.sets.is_empty() {
        app = read(&selection)?;
    }
    let mut findings = Findings::new();
    for finding in registry.check(&app).into_sorted() {
        let code = finding.code;
        // The report has the proof itself, with its numbers.
        let told = code.starts_with("pnt::check::") || code.starts_with("pnt::app::");
        if code.starts_with("pnt::") && !told {
            findings.push(finding);
        }
    }
    if findings.has_errors() {
        return Err(findings);
    }
    let others = task::nets(&app, registry)?;
    let is_given = |net: &Arc<Net>| given.iter().any(|(other, _)| other.name() == net.name());
    let others: Vec<_> = others.into_iter().filter(|net| !is_given(net)).collect();
    // What a message action asks of a task that is not a net has findings of the runtime.
    let given = given.iter().map(|(net, _)| Arc::clone(net));
    let all: Vec<_> = given.chain(others.iter().cloned()).collect();
    let mut messages = Findings::new();
    task::check_messages(&all, &app, registry, &mut messages);
    for finding in messages.into_sorted() {
        if !finding.code.starts_with("pnt::") {
            findings.push(finding);
        }
    }
    if findings.has_errors() {
        return Err(findings);
    }
    Ok((others, findings))
}

/// The tapes that the command line gives.
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

fn system(nets: &[Arc<Net>], tapes: &[Tape], ending: &Ending, args: &CheckArgs) -> u8 {
    // Only net text is run.
    let text = |net: &Arc<Net>| format::sniff(net.at().source.text()) == Format::Text;
    let rule = match Rule::of(nets) {
        Rule::Alone if !nets.iter().all(text) => Rule::Closed,
        rule => rule,
    };
    let options = Options {
        rule,
        limits: Limits {
            markings: args.max_markings,
            bytes: args.max_memory,
            threads: usize::from(args.threads),
            stop: ending.stop(),
        },
        boot: Limits::default(),
        engines: args.engine.into(),
        questions: questions(args),
        workflows: rule == Rule::Rest,
        tapes: tapes
            .iter()
            .filter(|tape| nets.iter().any(|net| net.name() == tape.net))
            .cloned()
            .collect(),
        deadlocks: usize::from(args.deadlocks),
    };
    let clock = Clock::real();
    let start = clock.now();
    let display = Display::new();
    let proof = check::prove(nets, &options, &mut |progress| display.show(progress));
    let seconds = (clock.now() - start).as_secs_f64();
    display.clear();
    let mut proof = match proof {
        Ok(proof) => proof,
        Err(findings) => return wrong(with_hint(findings, args), args),
    };
    let answer = Answer::new(nets, &options, &proof, seconds, args.structure);
    let code = code(&proof, ending);
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

/// That nothing was proved for want of memory or time is not a fault of the nets; a question may be
/// answered all the same.
fn code(proof: &Proof, ending: &Ending) -> u8 {
    let unknown = proof
        .answers
        .iter()
        .any(|answered| answered.yes().is_none());
    let no = proof
        .answers
        .iter()
        .any(|answered| answered.yes() == Some(false));
    match proof.sound() {
        Some(sound) if !unknown => {
            if sound && !no {
                exit::OK
            } else {
                exit::FAILED
            }
        }
        _ if ending.interrupted() => exit::INTERRUPTED,
        _ => exit::TIMED_OUT,
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
        let groups = check::systems(&[
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
