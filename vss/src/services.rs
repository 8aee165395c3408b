//! What this crate can do, as classes of service objects (SORMA technical report, chapter 1).
//!
//! The classes here need no running app and no camera: they work on files; in an app `spot`, `board` and some others have
//! its cameras take pictures besides. Their texts and numbers are a
//! fixed interface that other programs lean on: metres, rad, pixels with centres at whole numbers.

mod abg;
mod blobs;
mod board;
mod brd;
mod bundle;
mod clockfit;
mod colour;
mod corners;
mod diskfind;
mod handeye;
mod laser;
mod lines;
mod picture;
mod planecal;
mod pose;
mod psom;
mod resect;
mod spot;
mod stereo;
mod table;
mod triangulate;

use std::{fs::File, path::Path};

use ctos::diagnostic::{Findings, Source};
use sorma::{Class, ClassInfo, Outcome, Report, Sorm, Transport};

/// Version of the classes.
const VERSION: &str = env!("CARGO_PKG_VERSION");

/// The largest table that is read, bytes.
const LARGEST_FILE: u64 = 256 << 20;

sorma::prototypes! {
    /// The codes of the reports of these classes.
    pub mod code {
        FILE = 140, Error, "a file cannot be read, or is not of the kind it should be",
            "check the path; it is taken from where the process was started";
        TABLE = 141, Error, "a table has wrong lines",
            "correct the lines at the places given; `help` of the class names the columns";
        NO_CAMERA = 142, Error, "no camera follows from a table",
            "the text says what is missing: points, depth, or agreement";
        REJECTED = 143, Warning, "points of a table were not used",
            "look at the rows: they are off by more than the noise explains";
        NO_SPOT = 144, Warning, "there is no spot in a picture, or there are too many",
            "look at the picture, then at -threshold, -polarity and -min-area";
        CAMERA = 145, Error, "no picture comes from a camera",
            "the text says why; cameras are those of the app's [vss.cameras], and only an app has some";
        NO_MAP = 146, Error, "there is no map, or no point of it is near what is known",
            "the text says what is missing: CTRL -train FILE -params P, known components, or training nearby";
        CLOCKS = 147, Warning, "exchanges contradict one another",
            "a clock was set meanwhile, or drifts faster than -max-drift";
        PICTURE = 148, Warning, "a picture is not taken as its file means it to be shown",
            "the text says what was scaled, ignored or not rotated; convert the file if that matters";
        COLOURS = 149, Error, "there are no colour classes, or none can be learned",
            "CTRL -train FILE needs samples of two classes or more, each with several; the text says what is missing";
        DRIFT = 150, Warning, "colours are not what they should be",
            "train anew under today's light, mend the white balance, or give samples that differ more";
        BOARD = 151, Error, "there is no board in a picture",
            "the text says what was seen of it: take it from above, whole, sharp and lit, with nothing over most of its corners";
        NO_CORNERS = 152, Error, "a picture shows no chequer pattern of the size that was asked for",
            "the text says what was found: all of the pattern must be in view, and -inner counts its inner corners";
        UNEXPECTED = 153, Warning, "components of a picture are not as expected",
            "the text says in what: look at the picture, then at -area, -eccentricity, -holes and -threshold";
        NO_POSE = 154, Error, "no pose of an object follows from a table",
            "the text says why: more points, not all in one plane, from nearer, each in the row of its pixel";
        MARKERS = 155, Error, "the markers of a board are not seen",
            "the text says what was seen instead: -threshold, -dark and -area, or -train and -class, say what a marker is";
        NO_POINT = 156, Error, "no point follows from the pixels of two cameras",
            "the text says why: pixels of two points, rays that are nearly parallel, or a lens that cannot be undone there";
        NO_LINE = 157, Warning, "there is no line or edge in a picture, or there are too many",
            "look at the picture, then at -kind, -sigma, -contrast and -length";
        NO_LASER = 158, Error, "a laser scanner does not what it is ordered to",
            "the text says why: only an app has scanners ([vss.scanners]), -name says which one, and another client may hold it";
    }
}

/// Makes the classes known to a manager.
pub fn register(sorm: &Sorm) {
    let made: [Class; 20] = [
        // A camera's picture is waited for.
        Class::new("spot", VERSION, |_, _| Ok(Box::new(spot::Spot::default()))).waits(),
        Class::new("blobs", VERSION, |_, _| {
            Ok(Box::new(blobs::Blobs::default()))
        }),
        Class::new("resect", VERSION, |_, _| {
            Ok(Box::new(resect::Resect::default()))
        }),
        Class::new("corners", VERSION, |_, _| {
            Ok(Box::new(corners::Corners::default()))
        }),
        Class::new("planecal", VERSION, |_, _| {
            Ok(Box::new(planecal::PlaneCal::default()))
        }),
        Class::new("stereo", VERSION, |_, _| {
            Ok(Box::new(stereo::Stereo::default()))
        }),
        Class::new("handeye", VERSION, |_, _| Ok(Box::new(handeye::HandEye))),
        Class::new("bundle", VERSION, |_, _| {
            Ok(Box::new(bundle::Cameras::default()))
        }),
        Class::new("pose", VERSION, |_, _| Ok(Box::new(pose::Pose::default()))),
        // A scanner of the app is waited for.
        Class::new("laser", VERSION, |_, _| {
            Ok(Box::new(laser::Laser::default()))
        })
        .waits(),
        // And so is a camera's picture.
        Class::new("lines", VERSION, |_, _| {
            Ok(Box::new(lines::Lines::default()))
        })
        .waits(),
        Class::new("psom", VERSION, |_, _| Ok(Box::new(psom::Map::default()))),
        Class::new("abg", VERSION, |_, _| Ok(Box::new(abg::Filter::default()))),
        Class::new("clockfit", VERSION, |_, _| {
            Ok(Box::new(clockfit::ClockFit::default()))
        }),
        Class::new("colour", VERSION, |_, _| {
            Ok(Box::new(colour::Colour::default()))
        }),
        // These two as well.
        Class::new("board", VERSION, |_, _| {
            Ok(Box::new(board::Board::default()))
        })
        .waits(),
        Class::new("findBrdMarker", VERSION, |_, _| {
            Ok(Box::new(brd::FindBrdMarker::default()))
        })
        .waits(),
        Class::new("getDisk", VERSION, |_, _| {
            Ok(Box::new(brd::GetDisk::default()))
        }),
        // Pictures of two cameras are waited for.
        Class::new("triangulate", VERSION, |_, _| {
            Ok(Box::new(triangulate::Triangulate::default()))
        })
        .waits(),
        Class::new("diskFind", VERSION, |_, _| {
            Ok(Box::new(diskfind::DiskFind::default()))
        }),
    ];
    for (class, info) in made.into_iter().zip(classes()) {
        sorm.register(class.codes(code::PROTOTYPES).described(info));
    }
}

/// What a program may know about the classes.
#[must_use]
pub fn classes() -> Vec<ClassInfo> {
    vec![
        spot::TABLE.class("spot", VERSION),
        blobs::TABLE.class("blobs", VERSION),
        resect::TABLE.class("resect", VERSION),
        corners::TABLE.class("corners", VERSION),
        planecal::TABLE.class("planecal", VERSION),
        stereo::TABLE.class("stereo", VERSION),
        handeye::TABLE.class("handeye", VERSION),
        bundle::TABLE.class("bundle", VERSION),
        pose::TABLE.class("pose", VERSION),
        laser::TABLE.class("laser", VERSION),
        lines::TABLE.class("lines", VERSION),
        psom::TABLE.class("psom", VERSION),
        abg::TABLE.class("abg", VERSION),
        clockfit::TABLE.class("clockfit", VERSION),
        colour::TABLE.class("colour", VERSION),
        board::TABLE.class("board", VERSION),
        brd::MARKER.class("findBrdMarker", VERSION),
        brd::DISK.class("getDisk", VERSION),
        triangulate::TABLE.class("triangulate", VERSION),
        diskfind::TABLE.class("diskFind", VERSION),
    ]
}

/// So many findings, or rows that were not used, are told one by one.
const MOST_TOLD: usize = 20;

/// The text of a file that a request names.
fn opened(path: &str) -> Result<Source, Report> {
    check_file(path, LARGEST_FILE)?;
    Source::read(Path::new(path)).map_err(|finding| Report::error(code::FILE, finding.to_string()))
}

/// The findings of a table as one report.
fn told(findings: Findings) -> Report {
    let sorted = findings.into_sorted();
    let mut lines: Vec<String> = sorted
        .iter()
        .take(MOST_TOLD)
        .map(ToString::to_string)
        .collect();
    let more = sorted.len().saturating_sub(MOST_TOLD);
    if more > 0 {
        lines.push(format!("and {more} more"));
    }
    Report::error(code::TABLE, lines.join("\n"))
}

/// Refuses what no request should wait for or fill the memory with: folders, devices, huge files.
fn check_file(path: &str, most: u64) -> Outcome {
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
    if about.len() > most {
        let size = about.len();
        return wrong(format!(
            "`{path}` has {size} bytes; files up to {most} bytes are read"
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
