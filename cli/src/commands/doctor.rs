//! `ctos doctor`: what this host permits, and whether it permits what an app asks for.

use std::{
    net::{TcpListener, TcpStream},
    path::PathBuf,
};

use clap::Args;
use ctos::{
    config::{App, Selection, has_zenoh},
    diagnostic::{Finding, Findings},
};
use rustix::{
    process::{Resource, getrlimit},
    thread::{CpuSet, sched_getaffinity},
};
use thread_priority::{
    RealtimeThreadSchedulePolicy, ThreadPriority, ThreadPriorityValue, ThreadSchedulePolicy,
    set_thread_priority_and_policy, thread_native_id,
};

use cli_common::{exit, show, table};

use crate::{commands::ports, program};

/// The real-time priority that is tried: that of a processor that names none.
const PRIORITY: u8 = 80;

/// Fewer open files than this are soon used up by links between many chassis.
const FEW_FILES: u64 = 1024;

/// Tell what this host permits, and whether that is enough for an app
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  ctos doctor
  ctos doctor configs/calibrate.toml")]
pub struct DoctorArgs {
    /// Configuration of an app that is to run here
    pub file: Option<PathBuf>,
    /// Lay `[profile.NAME]` of the configuration over it (can be repeated)
    #[arg(long = "profile", value_name = "NAME")]
    pub profiles: Vec<String>,
    /// Print one JSON object per thing looked at
    #[arg(long)]
    pub json: bool,
}

/// How a thing stands.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum State {
    Good,
    /// Apps run, some of them less well.
    Limited,
    /// No app with several chassis can run.
    Bad,
}

/// One thing looked at.
#[derive(Debug)]
struct Probe {
    what: &'static str,
    state: State,
    found: String,
    /// What to do when it is not good.
    help: &'static str,
}

/// Runs the command.
#[must_use]
pub fn run(args: &DoctorArgs) -> u8 {
    let cpus = cpus();
    let realtime = realtime();
    let probes = [
        cpu_probe(&cpus),
        realtime_probe(&realtime),
        memory_probe(),
        files_probe(),
        loopback_probe(),
        zenoh_probe(),
    ];
    for probe in &probes {
        let line = match args.json {
            true => json(probe),
            false => table::for_terminal(&text(probe)),
        };
        if show::data(&line).is_err() {
            break;
        }
    }
    let bad = probes.iter().any(|probe| probe.state == State::Bad);
    let code = if bad { exit::FAILED } else { exit::OK };
    let Some(file) = &args.file else {
        return code;
    };
    let selection = Selection {
        profiles: args.profiles.clone(),
        ..Selection::new(file)
    };
    let found = match program::app(&selection) {
        Ok(app) => needs(&app, &cpus, &realtime),
        Err(findings) => {
            show::findings(findings);
            return exit::CONFIG;
        }
    };
    let failed = found.has_errors();
    if args.json {
        for finding in found.into_sorted() {
            // A closed pipe means that the reader has what it wanted.
            let _ = show::data(&show::finding_json(&finding).to_string());
        }
    } else {
        let counted = show::counted(&found);
        show::findings(found);
        show::say(&format!("{}: {counted}", file.display()));
    }
    if failed { exit::FAILED } else { code }
}

/// What the app asks of this host and does not get.
fn needs(app: &App, cpus: &[usize], realtime: &Result<(), String>) -> Findings {
    let mut findings = ports::taken(app, None, None);
    for chassis in &app.chassis {
        for processor in &chassis.processors {
            let name = format!("{}/{}", chassis.name, processor.name);
            if let Some(cpu) = processor.cpu.filter(|cpu| !cpus.contains(cpu)) {
                let finding = Finding::warning(
                    "ctos::doctor::cpu",
                    format!("processor `{name}` is pinned to CPU {cpu}, which is not to be had"),
                );
                let numbers: Vec<String> = cpus.iter().map(ToString::to_string).collect();
                let help = format!("there are {}", numbers.join(", "));
                findings.push(finding.at(processor.place.clone()).help(help));
            }
            if let (true, Err(error)) = (processor.realtime, realtime) {
                let finding = Finding::warning(
                    "ctos::doctor::realtime",
                    format!("processor `{name}` cannot be real-time here: {error}"),
                );
                findings.push(finding.at(processor.place.clone()).help(REALTIME_HELP));
            }
        }
    }
    findings
}

/// The CPUs that this process may run on.
fn cpus() -> Vec<usize> {
    match sched_getaffinity(None) {
        Ok(set) => (0..CpuSet::MAX_CPU)
            .filter(|cpu| set.is_set(*cpu))
            .collect(),
        Err(_) => Vec::new(),
    }
}

fn cpu_probe(cpus: &[usize]) -> Probe {
    Probe {
        what: "cpus",
        state: if cpus.len() > 1 {
            State::Good
        } else {
            State::Limited
        },
        found: format!("{} to run on", cpus.len()),
        help: "with one CPU, whatever else runs delays a servo loop",
    }
}

const REALTIME_HELP: &str =
    "allow it: `rtprio 99` for this user in /etc/security/limits.conf, or CAP_SYS_NICE";

/// Whether a thread becomes real-time, tried on one that ends at once.
fn realtime() -> Result<(), String> {
    let tried = std::thread::spawn(|| {
        let priority =
            ThreadPriorityValue::try_from(PRIORITY).map_err(|error| error.to_string())?;
        set_thread_priority_and_policy(
            thread_native_id(),
            ThreadPriority::Crossplatform(priority),
            ThreadSchedulePolicy::Realtime(RealtimeThreadSchedulePolicy::Fifo),
        )
        .map_err(|error| format!("{error:?}"))
    });
    tried
        .join()
        .unwrap_or_else(|_| Err("it could not be tried".to_owned()))
}

fn realtime_probe(realtime: &Result<(), String>) -> Probe {
    let (state, found) = match realtime {
        Ok(()) => (State::Good, format!("SCHED_FIFO {PRIORITY} is granted")),
        Err(error) => (State::Limited, format!("SCHED_FIFO is refused: {error}")),
    };
    Probe {
        what: "real-time",
        state,
        found,
        help: REALTIME_HELP,
    }
}

fn memory_probe() -> Probe {
    let (state, found) = match getrlimit(Resource::Memlock).current {
        None => (State::Good, "may all be locked".to_owned()),
        Some(bytes) => (
            State::Limited,
            format!("{} KiB may be locked", bytes / 1024),
        ),
    };
    Probe {
        what: "memory",
        state,
        found,
        help: "a page that is fetched from disk delays a servo loop: raise `ulimit -l`",
    }
}

fn files_probe() -> Probe {
    let limit = getrlimit(Resource::Nofile).current;
    let few = limit.is_some_and(|limit| limit < FEW_FILES);
    Probe {
        what: "files",
        state: if few { State::Limited } else { State::Good },
        found: limit.map_or_else(
            || "any number may be open".to_owned(),
            |limit| format!("{limit} may be open"),
        ),
        help: "every link is an open file: raise `ulimit -n`",
    }
}

fn loopback_probe() -> Probe {
    let tried = TcpListener::bind(("127.0.0.1", 0))
        .and_then(|listener| TcpStream::connect(listener.local_addr()?));
    let (state, found) = match tried {
        Ok(_) => (State::Good, "chassis can reach each other".to_owned()),
        Err(error) => (State::Bad, error.to_string()),
    };
    Probe {
        what: "loopback",
        state,
        found,
        help: "chassis of one host talk over 127.0.0.1: bring the interface `lo` up",
    }
}

/// Whether links over zenoh are part of this program. Most apps need none.
fn zenoh_probe() -> Probe {
    let found = if has_zenoh() {
        "links over zenoh are built in"
    } else {
        "not built in; [zenoh] in a configuration needs `cargo build --release --features zenoh`"
    };
    Probe {
        what: "zenoh",
        state: State::Good,
        found: found.to_owned(),
        help: "",
    }
}

fn text(probe: &Probe) -> String {
    let (word, help) = match probe.state {
        State::Good => ("good", String::new()),
        State::Limited => ("limited", format!(" ({})", probe.help)),
        State::Bad => ("bad", format!(" ({})", probe.help)),
    };
    format!("{word:<8} {:<10} {}{help}", probe.what, probe.found)
}

fn json(probe: &Probe) -> String {
    let state = match probe.state {
        State::Good => "good",
        State::Limited => "limited",
        State::Bad => "bad",
    };
    let help = (probe.state != State::Good).then_some(probe.help);
    let (what, found) = (probe.what, &probe.found);
    serde_json::json!({ "what": what, "state": state, "found": found, "help": help }).to_string()
}

#[cfg(test)]
mod tests {
    use super::*;
    use ctos::config::load_texts;

    fn found(text: &str, cpus: &[usize], realtime: &Result<(), String>) -> Vec<String> {
        let text = format!("{text}\n[task.a]\nhandler = \"h\"\non = \"w\"\n");
        let app = load_texts(&[("app.toml", text.as_str())], &[], &[]).unwrap();
        let findings = needs(&app, cpus, realtime).into_sorted();
        findings.iter().map(ToString::to_string).collect()
    }

    #[test]
    fn what_an_app_asks_for_and_does_not_get_is_told_where_it_asks() {
        let text = "[chassis.w]\nprocessors.servo = { realtime = true, cpu = 5 }\nprocessors.main = { cpu = 1 }";
        assert_eq!(found(text, &[0, 1, 5], &Ok(())), Vec::<String>::new());
        let refused = Err("no".to_owned());
        assert_eq!(
            found(text, &[0, 1], &refused),
            [
                "app.toml:2:12: warning: processor `w/servo` is pinned to CPU 5, which is not to be had (there are 0, 1)"
                    .to_owned(),
                format!(
                    "app.toml:2:12: warning: processor `w/servo` cannot be real-time here: no ({REALTIME_HELP})"
                ),
            ]
        );
    }

    #[test]
    fn an_address_that_is_taken_is_an_error_and_a_free_one_is_not() {
        let taken = TcpListener::bind(("127.0.0.1", 0)).unwrap();
        let address = taken.local_addr().unwrap();
        let text = format!("[chassis.w]\nlisten = \"{address}\"");
        let lines = found(&text, &[0], &Ok(()));
        let start = format!("app.toml:2:1: error: chassis `w` cannot listen on {address} here: ");
        assert!(
            lines.len() == 1 && lines[0].starts_with(&start),
            "{lines:?}"
        );
        drop(taken);
        assert_eq!(found(&text, &[0], &Ok(())), Vec::<String>::new());
    }
}
