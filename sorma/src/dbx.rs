//! DBX, which every object inherits: what is known about it that its class need not write.

use crate::description::OptionInfo;
use crate::object::{Body, Context, Outcome};
use crate::options::OptionTable;
use crate::report::Severity;
use crate::transport::Transport;
use std::sync::LazyLock;

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

/// What a DBX request asks for and sets, before anything of it is done.
#[derive(Debug, Clone)]
struct Asked {
    verbosity: String,
    test: bool,
    /// The object's own, for the answers.
    version: String,
    audit: String,
    statistics: String,
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
        .action("build", &[], "how its program was compiled", |_, _| {
            Ok(BUILD.to_owned())
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
