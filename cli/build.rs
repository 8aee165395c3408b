//! Which revision of the sources a program is compiled from, and when: for `DBX -build`.
//!
//! `CTOS_REVISION` says the revision, else git does; `SOURCE_DATE_EPOCH` says the time (s since 1970), else the clock
//! does. Without git it compiles all the same, and says so. Only this crate, which stands above all others, is compiled
//! anew for it. That happens only when a source of the workspace has changed, or the revision.

#![allow(
    clippy::print_stdout,
    reason = "that is how a build script speaks to cargo"
)]

use std::{
    env,
    path::{Path, PathBuf},
    process::Command,
    time::{SystemTime, UNIX_EPOCH},
};

fn main() {
    println!("cargo::rerun-if-env-changed=CTOS_REVISION");
    println!("cargo::rerun-if-env-changed=SOURCE_DATE_EPOCH");
    let said = env::var("CTOS_REVISION").ok();
    let revision = said.filter(|said| is_line(said)).or_else(revision);
    let revision =
        revision.unwrap_or_else(|| "not known (no git where it was compiled)".to_owned());
    println!("cargo::rustc-env=CTOS_BUILD_REVISION={revision}");
    println!("cargo::rustc-env=CTOS_BUILD_TIME={}", date(seconds()));
    println!("cargo::rerun-if-changed=build.rs");
    // Cargo looks at each listed folder file by file. A path that does not exist would have this run each time.
    for folder in sources() {
        println!("cargo::rerun-if-changed={}", folder.display());
    }
}

fn is_line(text: &str) -> bool {
    !text.is_empty() && !text.contains(char::is_control)
}

/// The folders of sources of the workspace.
fn sources() -> Vec<PathBuf> {
    let folders = |at: &Path| {
        let entries = at.read_dir().into_iter().flatten().flatten();
        entries.map(|entry| entry.path()).collect::<Vec<_>>()
    };
    let root = Path::new("..");
    if !root.join("sorma/src").is_dir() {
        return vec![PathBuf::from("src")];
    }
    let crates = folders(root)
        .into_iter()
        .filter(|at| !at.ends_with("target") && !at.ends_with("tests"));
    let crates = crates.flat_map(|at| [folders(&at), vec![at]].concat());
    let mut sources: Vec<PathBuf> = crates.map(|at| at.join("src")).collect();
    sources.retain(|at| at.is_dir());
    sources.sort();
    sources
}

fn git(arguments: &[&str]) -> Option<String> {
    let output = Command::new("git").args(arguments).output().ok()?;
    let text = String::from_utf8(output.stdout).ok()?;
    output.status.success().then(|| text.trim().to_owned())
}

/// The commit that is checked out, and whether anything was changed since.
fn revision() -> Option<String> {
    // A repository around a copy of these sources says nothing about them.
    git(&["ls-files", "--error-unmatch", "build.rs"])?;
    let commit = git(&["rev-parse", "--short=12", "HEAD"])?;
    if let Some(log) = git(&["rev-parse", "--git-path", "logs/HEAD"])
        && Path::new(&log).is_file()
    {
        println!("cargo::rerun-if-changed={log}");
    }
    let changes = git(&["status", "--porcelain", "--untracked-files=no"])?;
    Some(match changes.as_str() {
        "" => commit,
        _ => format!("{commit} with changes"),
    })
}

/// When it is compiled, s since 1970.
fn seconds() -> u64 {
    let said = env::var("SOURCE_DATE_EPOCH").ok();
    let said = said.and_then(|said| said.parse().ok());
    said.unwrap_or_else(|| {
        let now = SystemTime::now().duration_since(UNIX_EPOCH);
        now.map(|since| since.as_secs()).unwrap_or_default()
    })
}

/// As ISO 8601 has it, in UTC.
fn date(seconds: u64) -> String {
    let (mut days, second) = (seconds / 86_400, seconds % 86_400);
    let is_leap = |year: u64| {
        year.is_multiple_of(4) && (!year.is_multiple_of(100) || year.is_multiple_of(400))
    };
    let mut year = 1970;
    while days >= 365 + u64::from(is_leap(year)) && year < 9999 {
        days -= 365 + u64::from(is_leap(year));
        year += 1;
    }
    let february = 28 + u64::from(is_leap(year));
    let mut month = 1;
    for length in [31, february, 31, 30, 31, 30, 31, 31, 30, 31, 30] {
        if days < length {
            break;
        }
        days -= length;
        month += 1;
    }
    let (hour, minute, second) = (second / 3600, second / 60 % 60, second % 60);
    format!(
        "{year}-{month:02}-{:02}T{hour:02}:{minute:02}:{second:02}Z",
        days + 1
    )
}
