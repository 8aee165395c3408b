//! Whom a session asks: the objects of this very process, or those of a running app.

use std::sync::atomic::Ordering;

use futures_util::FutureExt as _;
use sorma::{Alone, ClassInfo, Reply, Report, Sorm, report::code, watching::Trace, words};

use super::{
    attach::{App, Interrupted},
    patience,
    services::CLASSES,
};

/// Whom a session asks.
#[derive(Debug)]
pub enum Backend {
    /// The objects of this process.
    Local(Sorm),
    /// A running app.
    App(Box<App>),
}

impl Backend {
    /// Has a request line met; the reply always comes.
    ///
    /// # Errors
    /// The user did not want to wait for it.
    pub fn dispatch(&mut self, line: &str, trace: u64) -> Result<String, Interrupted> {
        match self {
            Self::Local(sorm) => Ok(patience::during(line, || here(sorm, line, trace))),
            Self::App(app) => app.dispatch(line, trace),
        }
    }

    /// Whether the user has pressed Ctrl-C since it was asked last.
    pub fn is_interrupted(&self) -> bool {
        match self {
            // Ctrl-C ends the program.
            Self::Local(_) => false,
            Self::App(app) => app.interrupt().swap(false, Ordering::Relaxed),
        }
    }

    /// What there is to be offered now: names of objects and flavors, and what is known about the classes.
    pub fn known(&mut self) -> (Vec<String>, Vec<ClassInfo>) {
        let (mut names, classes) = match self {
            Self::Local(sorm) => {
                let listed = here(sorm, "dict CTRL -list", 0);
                let listed = listed.parse::<Reply>().map(|reply| reply.body.text);
                let listed = words::split(&listed.unwrap_or_default()).unwrap_or_default();
                let mut names = sorm.objects();
                names.extend(listed.into_iter().map(|word| word.text));
                (names, CLASSES.clone())
            }
            Self::App(app) => {
                let names = app.names();
                (names, self.classes().to_vec())
            }
        };
        names.sort_unstable();
        names.dedup();
        (names, classes)
    }

    /// What is known about the classes.
    pub fn classes(&mut self) -> &[ClassInfo] {
        match self {
            Self::Local(_) => &CLASSES,
            // Most apps serve the classes of this program.
            Self::App(app) => app.classes().unwrap_or(&CLASSES),
        }
    }

    /// Another that asks the same, over a connection of its own; `None` when it cannot be had.
    #[must_use]
    pub fn again(&self) -> Option<Self> {
        match self {
            Self::Local(sorm) => Some(Self::Local(sorm.clone())),
            Self::App(app) => {
                let again = app.again(app.interrupt().clone()).ok()?;
                Some(Self::App(Box::new(again)))
            }
        }
    }

    /// The daemons that there are.
    #[must_use]
    pub fn daemons(&self) -> &[String] {
        match self {
            Self::Local(_) => &[],
            Self::App(app) => app.daemons(),
        }
    }
}

/// Has a line met in this process. An object that asks others finds them here, and nothing here takes time.
fn here(sorm: &Sorm, line: &str, trace: u64) -> String {
    let trace = Trace {
        id: trace,
        depth: 0,
    };
    let told = sorm.tell_traced(&Alone, line, "", trace).now_or_never();
    told.unwrap_or_else(|| {
        let report = Report::error(code::BUSY, "it waits for something that never comes here");
        let text = words::quoted(&report.to_line());
        format!("sorm RET {} TDBX {text}", report.code)
    })
}
