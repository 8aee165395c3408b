//! `ctos net perf`.

use std::{path::PathBuf, sync::Arc};

use clap::Args;
use ctos::diagnostic::Findings;
use pnt::{
    compose::System,
    format,
    net::Net,
    stochastic::{self, Figure, Options, PerfError, Report},
};

use cli_common::{
    exit, show,
    table::{self, left, right},
};

/// Say how fast nets go whose transitions say what they take
///
/// Mean tokens, throughput and utilisation in steady state: exactly, when all times are exponential and the markings
/// are few enough, and by simulation with confidence intervals. Nets that name each other are given together.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  ctos net perf configs/nets/cell.net
  ctos net perf configs/nets/cell.net --time 3600 --confidence 0.99 --seed 7 --json")]
pub struct PerfArgs {
    /// The nets, in any form
    #[arg(value_name = "FILE", required = true)]
    pub files: Vec<PathBuf>,
    /// Simulated seconds [default: as many as a million firings take]
    #[arg(long, value_name = "SECONDS")]
    pub time: Option<f64>,
    /// Probability that an interval holds the true value
    #[arg(long, value_name = "P", default_value_t = 0.95)]
    pub confidence: f64,
    /// Seed of all chance
    #[arg(long, value_name = "N", default_value_t = 1)]
    pub seed: u64,
    /// Markings that the exact solution may have; 0 for simulation alone
    #[arg(long, value_name = "N", default_value_t = stochastic::MOST_MARKINGS)]
    pub markings: usize,
    /// Print a JSON object
    #[arg(long)]
    pub json: bool,
}

/// Runs the command.
#[must_use]
pub fn run(args: &PerfArgs) -> u8 {
    let nets = match load(&args.files) {
        Ok(nets) => nets,
        Err(findings) => {
            show::findings(findings);
            return exit::CONFIG;
        }
    };
    let options = Options {
        time_s: args.time,
        confidence: args.confidence,
        seed: args.seed,
        markings: args.markings,
    };
    let report = match stochastic::analyse(&nets, &options) {
        Ok(report) => report,
        Err(error) => {
            show::say(&format!("error: {error}"));
            return match error {
                PerfError::Option(_) => exit::USAGE,
                PerfError::NothingTimed | PerfError::ResetOfPromised { .. } => exit::CONFIG,
                PerfError::Timeless { .. } | PerfError::Stops { .. } | PerfError::Overflow(_) => {
                    exit::FAILED
                }
            };
        }
    };
    let text = if args.json {
        match serde_json::to_string(&report) {
            Ok(text) => text,
            Err(error) => {
                show::say(&format!("error: {error}"));
                return exit::FAILED;
            }
        }
    } else {
        for note in &report.notes {
            show::say(&format!("note: {note}"));
        }
        shown(&report)
    };
    // A reader that went away has what it wanted.
    let _ = show::data(&text);
    exit::OK
}

/// Nets that fit together.
fn load(files: &[PathBuf]) -> Result<Vec<Arc<Net>>, Findings> {
    let mut findings = Findings::new();
    let mut nets: Vec<Arc<Net>> = Vec::new();
    for file in files {
        match format::load(file) {
            Ok((net, warnings)) => {
                findings.extend(warnings);
                nets.push(Arc::new(net));
            }
            Err(found) => findings.extend(found),
        }
    }
    if !findings.has_errors() {
        findings.extend(System::compose(&nets).1);
    }
    if findings.has_errors() {
        return Err(findings);
    }
    Ok(nets)
}

/// The report as a person reads it.
fn shown(report: &Report) -> String {
    let columns = [
        left("PLACE"),
        right("TOKENS"),
        right("SIMULATED"),
        right("MARKED"),
        right("SIMULATED"),
    ];
    let places: Vec<Vec<String>> = report
        .places
        .iter()
        .map(|place| {
            let mut row = vec![place.place.clone()];
            row.extend(cells(Some(&place.tokens)));
            row.extend(cells(Some(&place.marked)));
            row
        })
        .collect();
    let mut lines = table::lines(&columns, &places, table::width());
    lines.push(String::new());
    let columns = [
        left("TRANSITION"),
        right("PER SECOND"),
        right("SIMULATED"),
        right("BUSY"),
        right("SIMULATED"),
        right("UTILISATION"),
    ];
    let transitions: Vec<Vec<String>> = report
        .transitions
        .iter()
        .map(|transition| {
            let mut row = vec![transition.transition.clone()];
            row.extend(cells(Some(&transition.throughput_per_s)));
            row.extend(cells(transition.busy.as_ref()));
            let of = transition.utilisation;
            row.push(of.map_or_else(String::new, |u| number(u.exact.unwrap_or(u.simulated.mean))));
            row
        })
        .collect();
    lines.extend(table::lines(&columns, &transitions, table::width()));
    lines.push(String::new());
    lines.extend(how(report));
    lines.join("\n")
}

/// The exact value and the interval.
fn cells(figure: Option<&Figure>) -> [String; 2] {
    let Some(figure) = figure else {
        return [String::new(), String::new()];
    };
    let simulated = figure.simulated;
    [
        figure.exact.map_or_else(String::new, number),
        format!(
            "{} ± {}",
            number(simulated.mean),
            number(simulated.half_width)
        ),
    ]
}

/// Four digits that count, without an exponent where it can be.
fn number(value: f64) -> String {
    match value.abs() {
        0.0 => "0".to_owned(),
        size if !(1e-5..1e7).contains(&size) => format!("{value:.3e}"),
        size if size >= 1000.0 => format!("{value:.0}"),
        size if size >= 100.0 => format!("{value:.1}"),
        size if size >= 10.0 => format!("{value:.2}"),
        size if size >= 1.0 => format!("{value:.3}"),
        size if size >= 0.1 => format!("{value:.4}"),
        size if size >= 0.01 => format!("{value:.5}"),
        size if size >= 0.001 => format!("{value:.6}"),
        _ => format!("{value:.7}"),
    }
}

/// How the figures were found.
fn how(report: &Report) -> Vec<String> {
    let mut lines = Vec::new();
    match (&report.solved, &report.not_exact) {
        (Some(solved), _) => {
            let by = match solved.sweeps {
                0 => "by elimination".to_owned(),
                sweeps => format!("in {sweeps} sweeps"),
            };
            lines.push(format!(
                "exact: {} markings in which time passes, {} of them for ever, solved {by}",
                solved.markings, solved.recurrent
            ));
        }
        (None, Some(why)) => lines.push(format!("not exact: {why}")),
        (None, None) => {}
    }
    let run = report.simulated;
    lines.push(format!(
        "simulated: {} s, {} firings, {} % intervals from {} batches, seed {}",
        number(run.time_s),
        run.firings,
        number(run.confidence * 100.0),
        run.batches,
        run.seed
    ));
    let (both, agree) = report.agreement();
    if both > 0 {
        lines.push(format!(
            "{agree} of {both} exact values lie in their intervals"
        ));
    }
    lines
}
