//! How cost grows with work: each area is measured at sizes over several decades, each size in a process of its own. Prints a
//! table with the slopes in double logarithm, and writes all curves as one picture.
//!
//! `cargo run --release -p growth [-- AREA ...]`; `--help` names the areas.

mod apps;
mod areas;
mod curve;
mod parts;
mod picture;

use std::{
    io::Write as _,
    path::PathBuf,
    process::{Command, ExitCode, Stdio},
};

use clap::{Parser, builder::PossibleValuesParser};

use areas::{AREAS, Area, Failed};
use curve::{Cost, Curve};

/// The first argument of a process that measures one size.
const ONE: &str = "growth-one";

/// How cost grows with work
#[derive(Debug, Parser)]
#[command(version)]
struct Arguments {
    /// What is measured; all of it, if nothing is named
    #[arg(value_parser = PossibleValuesParser::new(AREAS.iter().map(|area| area.name)))]
    areas: Vec<String>,
    /// The largest size
    #[arg(long, default_value_t = u64::MAX, hide_default_value = true)]
    most: u64,
    /// Records of up to 4 GB, too: an hour, and that much room in the folder of temporary files (TMPDIR)
    #[arg(long)]
    large: bool,
    /// An area goes no further after a size that took longer, s
    #[arg(long, default_value_t = 60.0)]
    limit: f64,
    /// Where the picture goes
    #[arg(long, default_value = "growth.svg")]
    picture: PathBuf,
}

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let done = match arguments.split_first() {
        Some((first, rest)) if first == apps::CHASSIS => apps::be_chassis(rest),
        Some((first, rest)) if first == ONE => one(rest),
        _ => all(&Arguments::parse()),
    };
    match done {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            // Where it cannot be told, nobody hears it.
            let _ = writeln!(std::io::stderr(), "error: {error}");
            ExitCode::FAILURE
        }
    }
}

/// Measures one size of one area, and prints what it costs.
fn one(arguments: &[String]) -> Result<(), Failed> {
    let [name, size] = arguments else {
        return Err(format!("{ONE} needs an area and a size").into());
    };
    let area = areas::find(name).ok_or("no such area")?;
    let cost = (area.measure)(size.parse()?)?;
    writeln!(std::io::stdout(), "{}", serde_json::to_string(&cost)?)?;
    Ok(())
}

/// Measures all areas, and tells what came out.
fn all(arguments: &Arguments) -> Result<(), Failed> {
    let wanted = |area: &&Area| {
        arguments.areas.is_empty() || arguments.areas.iter().any(|name| name == area.name)
    };
    let mut curves = Vec::new();
    for area in AREAS.iter().filter(wanted) {
        curves.push(measured(area, arguments)?);
    }
    write!(std::io::stdout(), "{}", curve::table(&curves))?;
    std::fs::write(&arguments.picture, picture::svg(&curves))?;
    Ok(())
}

fn measured(area: &Area, arguments: &Arguments) -> Result<Curve, Failed> {
    let mut curve = Curve {
        what: area.what,
        whole: area.whole,
        points: Vec::new(),
        ended: None,
    };
    for size in areas::sizes(area, arguments.most, arguments.large) {
        match in_process(area.name, size) {
            Ok(cost) => {
                let time = curve::time(cost.seconds);
                writeln!(std::io::stderr(), "{:14} {size:>9}  {time}", area.name)?;
                curve.points.push((size as f64, cost));
                if cost.seconds > arguments.limit {
                    curve.ended = Some(format!(
                        "the next size would take over {} s",
                        arguments.limit
                    ));
                    break;
                }
            }
            Err(error) => {
                writeln!(std::io::stderr(), "{:14} {size:>9}  {error}", area.name)?;
                curve.ended = Some(format!("{size}: {error}"));
                break;
            }
        }
    }
    Ok(curve)
}

fn in_process(name: &str, size: u64) -> Result<Cost, Failed> {
    let program = std::env::current_exe()?;
    let ended = Command::new(program)
        .args([ONE, name, &size.to_string()])
        .stdin(Stdio::null())
        .output()?;
    if !ended.status.success() {
        let said = String::from_utf8_lossy(&ended.stderr);
        let last = said.lines().last().unwrap_or_default();
        return Err(format!("{} ({})", last.trim_start_matches("error: "), ended.status).into());
    }
    Ok(serde_json::from_slice(&ended.stdout)?)
}
