//! DBX, which every object inherits: what is known about it that its class need not write.

use crate::description::OptionInfo;
use crate::object::{Body, Context, Outcome};
use crate::options::OptionTable;
use crate::report::Severity;
use crate::transport::Transport;
use std::sync::{LazyLock, OnceLock};

/// How this program was compiled.
const BUILD: &str = if cfg!(debug_assertions) {
    concat!(
        "ctos ",
        env!("CARGO_PKG_VERSION"),
        ", with debug assertions"
    )
} else {
    concat!("ctos ", env!("CARGO_PKG_VERSION"), ", optimized")
};

/// The program's revision and when it was compiled, as it says itself.
static BUILT: OnceLock<String> = OnceLock::new();

/// Says of this program which revision of its sources it was compiled from, and when; `DBX -build` of every object
/// tells it. The first word counts. The crate does not find out by itself: then every commit would compile it anew,
/// and all that is built with it.
pub fn built(revision: &str, at: &str) {
    BUILT.get_or_init(|| format!("revision {revision}, compiled {at}"));
}

fn build() -> String {
    let built = BUILT.get().map(String::as_str);
    let built =
        built.unwrap_or("revision and time of compilation not known: its program did not say");
    format!("{BUILD}, {built}")
}

/// What a DBX request asks for and sets, before anything of it is done.
#[derive(Debug, Clone)]
struct Asked {
    verbosity: String,
    test: bool,
    /// The object's own, for the answers.
    version: String,
    audit: String,
    statistics: String,
    meter: String,
    subscribers: usize,
}

impl Default for Asked {
    fn default() -> Self {
        Self {
            verbosity: Severity::Verbose.word().to_owned(),
            test: false,
            version: String::new(),
            audit: String::new(),
            statistics: String::new(),
            meter: String::new(),
            subscribers: 0,
        }
    }
}

/// What a program may know about the options that DBX takes.
#[must_use]
pub fn dbx_options() -> Vec<OptionInfo> {
    DBX.describe()
}

static DBX: LazyLock<OptionTable<Asked>> = LazyLock::new(|| {
    OptionTable::new("tells about the object itself")
        .choice(
            "verbosity",
            &["verbose", "warning", "error"],
            "the least severe reports that it passes on",
            |asked: &mut Asked| &mut asked.verbosity,
        )
        .action("version", &[], "class and its version", |asked, _| {
            Ok(asked.version.clone())
        })
        .action("build", &[], "how its program was compiled: version, revision and time", |_, _| {
            Ok(build())
        })
        .action(
            "audit",
            &[],
            "the last CTRL requests: number, time, caller, return code, text",
            |asked, _| Ok(asked.audit.clone()),
        )
        .action(
            "statistics",
            &[],
            "how often it was called: EXEC, CTRL, errors",
            |asked, _| Ok(asked.statistics.clone()),
        )
        .action(
            "meter",
            &[],
            "who used it by name, a line for each: calls of EXEC and CTRL, errors, time, bytes in and out",
            |asked, _| Ok(asked.meter.clone()),
        )
        .action(
            "subscribers",
            &[],
            "how many subscribe to its results",
            |asked, _| Ok(asked.subscribers.to_string()),
        )
        .action("test", &[], "has it test itself", |asked, _| {
            asked.test = true;
            Ok(String::new())
        })
});

/// Answers a DBX request to the object in `body`.
pub(crate) fn dbx(body: &mut Body, cx: &Context<'_>, io: &mut Transport) -> Outcome {
    let meta = &mut body.meta;
    let lines: Vec<&str> = meta.audit.iter().map(String::as_str).collect();
    let mut asked = Asked {
        verbosity: meta.verbosity.word().to_owned(),
        test: false,
        version: format!("{} {}", cx.slot.class.name(), cx.slot.class.version()),
        audit: lines.join("\n"),
        statistics: meta.statistics(),
        meter: meta.meter.lines(),
        subscribers: cx.slot.subscribers(),
    };
    DBX.ctrl(&mut asked, io);
    if !io.is_ok() {
        return Ok(());
    }
    meta.verbosity = Severity::from_word(&asked.verbosity).unwrap_or(meta.verbosity);
    if asked.test {
        body.object.self_test(cx)?;
        if !io.text.is_empty() {
            io.text.push('\n');
        }
        io.text.push_str("the self-test is passed");
    }
    Ok(())
}
