//! Recording: every message, handler, reply, phase, firing and log line of an app as MCAP. Such a file
//! can be read, and one task can be replayed from it.
//!
//! Each process writes a file of its own, so that the end of one takes nothing from another. A simulated
//! app, which is one process, writes one. An entry costs its processor a lock that nobody else takes and
//! some bytes in a buffer. A writer next to it puts these into the file as they are. Lines for people and
//! viewers are made when the file is read. The page `docs/recording.md` shows how it is used.

extern crate ctos_core as ctos;

#[doc(hidden)]
pub mod attach;
mod batch;
mod counts;
mod event;
mod glossary;
mod lines;
mod log;
mod parts;
mod read;
mod recorder;
mod recorders;
mod replay;
mod summary;
mod traffic;
mod writer;

use ctos_config::RecordConfig;
use ctos_core::chassis::Chassis;
use ctos_message::CommandInfo;
use ctos_time::Drift;
use std::{collections::BTreeMap, path::PathBuf, sync::Arc, time::Duration};

pub use lines::Number;
pub use log::RecordLayer;
pub use read::{Channel, Entry, Filter, ReadError, Record, Run, noted, scan_only};
pub use replay::{Difference, ReplayError, ReplayReport, replay, replayable};

pub use attach::{Attached, BeginRecord, EndRecord, ReadRecord};

pub use ctos_core::report::{Ending, RecordReport};
pub use recorders::Recorders;

use glossary::Glossary;
use parts::{Parts, Place, suffixed};
use recorder::Recorder;
use writer::Writer;

/// Under which names it says how the clock of each chassis was wrong: offset, ns, and rate, ns per s.
const DRIFT: &str = "drift.";

/// How long the end of a record waits for its disk.
const CLOSE_TIMEOUT: Duration = Duration::from_secs(5);

/// The record of this process, while it is written.
pub struct Recording(Arc<Recorder>);

impl Recording {
    /// Records a chassis that was started again, too.
    pub fn add(&self, chassis: &Chassis) {
        Recorders::record(chassis, self.0.clone());
    }

    /// Writes what is left and closes the file.
    pub fn finish(self) {
        log::detach(&self.0);
        self.0.finish(CLOSE_TIMEOUT);
    }
}

/// Begins to record the chassis of this process, if the configuration says so: one in real time, all
/// of them in virtual time. `runtime` are commands of the runtime that the core does not know.
///
/// # Errors
/// When the file cannot be made: an app that is to be recorded does not run without it.
pub fn start(
    chassis: &[Arc<Chassis>],
    runtime: &[CommandInfo],
) -> std::io::Result<Option<Recording>> {
    let first = chassis.first();
    let Some((first, config)) = first.and_then(|one| Some((one, one.app.record.as_ref()?))) else {
        return Ok(None);
    };
    let mut path = first.app.folder.join(&config.file);
    if first.clock.origin_ns().is_some() {
        path = suffixed(&path, first.name());
    }
    let mut run = run_of(first);
    for one in chassis {
        let drift = one.clock.drift();
        let drift = format!("{} {}", drift.offset_ns, drift.rate_ppb);
        run.insert(format!("{DRIFT}{}", one.index()), drift);
    }
    let recorder = begin(first, config, path, run, runtime)?;
    for one in chassis {
        Recorders::record(one, recorder.clone());
    }
    log::attach(&recorder, first.index());
    Ok(Some(Recording(recorder)))
}

/// Begins a file at `path` for what happens at `chassis`.
fn begin(
    chassis: &Chassis,
    config: &RecordConfig,
    path: PathBuf,
    run: BTreeMap<String, String>,
    runtime: &[CommandInfo],
) -> std::io::Result<Arc<Recorder>> {
    let names = Glossary::of(&chassis.app, &chassis.registry(), runtime);
    let place = Place::new(path, config.max_bytes, config.keep);
    let parts = Parts::open(place, run).map_err(std::io::Error::other)?;
    let writer = Writer::new(names, parts, config.channels.clone());
    // The true time, in which all chassis of a simulated app are noted.
    let clock = chassis.clock.drifting(Drift::default());
    let limit = config.buffer_bytes;
    match clock.origin_ns() {
        Some(_) => Recorder::threaded(clock, writer, chassis.processors.len(), limit, config.flush),
        None => Ok(Recorder::inline(clock, writer, limit)),
    }
}

/// The file of a record of app `name` in a folder where no configuration says it: `NAME.mcap`.
#[must_use]
pub fn file_name(name: &str) -> String {
    let plain = |letter: char| {
        if letter.is_ascii_alphanumeric() || "_-".contains(letter) {
            letter
        } else {
            '_'
        }
    };
    let name: String = name.chars().take(64).map(plain).collect();
    format!("{name}.mcap")
}

/// Of what a file is the record.
fn run_of(chassis: &Chassis) -> BTreeMap<String, String> {
    let app = &chassis.app;
    let mut run = BTreeMap::from([
        ("app".to_owned(), app.name.clone()),
        ("seed".to_owned(), app.seed.to_string()),
    ]);
    if let Some(origin) = chassis.clock.origin_ns() {
        run.insert("chassis".to_owned(), chassis.name().to_owned());
        run.insert("time".to_owned(), "real".to_owned());
        run.insert("origin_ns".to_owned(), origin.to_string());
        // Whose monotonic clock that is.
        if let Ok(id) = std::fs::read_to_string("/proc/sys/kernel/random/boot_id") {
            run.insert("host".to_owned(), id.trim().to_owned());
        }
    } else {
        run.insert("time".to_owned(), "virtual".to_owned());
    }
    run
}
