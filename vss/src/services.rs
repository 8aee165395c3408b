//! What this crate can do, as classes of service objects (SORMA technical report, chapter 1).
//!
//! The classes here need no running app and no camera: they work on files. Their texts and numbers are a
//! fixed interface that other programs lean on: metres, rad, pixels with centres at whole numbers.

mod resect;
mod spot;
mod table;

use std::{fs::File, path::Path};

use sorma::{ClassInfo, Outcome, Report, Sorm, Transport};

/// Version of the classes.
const VERSION: &str = env!("CARGO_PKG_VERSION");

/// The largest file that is read, bytes.
const LARGEST_FILE: u64 = 256 << 20;

/// The codes of the reports of these classes.
pub mod code {
    /// A file cannot be read, or is not of the kind it should be.
    pub const FILE: i32 = 140;
    /// A table has wrong lines.
    pub const TABLE: i32 = 141;
    /// No camera follows from a table.
    pub const NO_CAMERA: i32 = 142;
    /// Points of a table were not used.
    pub const REJECTED: i32 = 143;
    /// There is no spot in a picture.
    pub const NO_SPOT: i32 = 144;
}

/// Makes the classes known to a manager.
pub fn register(sorm: &Sorm) {
    sorm.register("spot", VERSION, |_, _| Ok(Box::new(spot::Spot::default())));
    sorm.register("resect", VERSION, |_, _| {
        Ok(Box::new(resect::Resect::default()))
    });
}

/// What a program may know about the classes.
#[must_use]
pub fn classes() -> Vec<ClassInfo> {
    vec![
        spot::TABLE.class("spot", VERSION),
        resect::TABLE.class("resect", VERSION),
    ]
}

/// Refuses what no request should wait for or fill the memory with: folders, devices, huge files.
fn check_file(path: &str) -> Outcome {
    let wrong = |text: String| Err(Report::error(code::FILE, text));
    let about = match File::open(Path::new(path)).and_then(|file| file.metadata()) {
        Ok(about) => about,
        Err(error) => {
            return wrong(format!(
                "cannot read `{path}`: {error}; a path is taken from where this process was started"
            ));
        }
    };
    if !about.is_file() {
        return wrong(format!("`{path}` is no file"));
    }
    if about.len() > LARGEST_FILE {
        let size = about.len();
        return wrong(format!(
            "`{path}` has {size} bytes; files up to {LARGEST_FILE} bytes are read"
        ));
    }
    Ok(())
}

/// Ends a request: what came in must not stay there as if it were an answer.
fn ended(io: &mut Transport, outcome: Outcome) -> Outcome {
    io.text.clear();
    if outcome.is_err() {
        io.floats.clear();
        io.ints.clear();
    }
    outcome
}

#[cfg(test)]
mod tests;
