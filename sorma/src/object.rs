//! What a service object is, and what it is given when it is called.

use crate::options::OptionTable;
use crate::report::{Report, Severity, code};
use crate::request::Method;
use crate::sorm::Sorm;
use crate::transport::Transport;
use std::cell::RefCell;
use std::collections::VecDeque;
use std::sync::LazyLock;

/// How a method of a service object ends; the error becomes a report and the return code.
pub type Outcome = Result<(), Report>;

/// A service object: a small interface to anything that serves (SORMA technical report,
/// section 1.3.3).
///
/// The transport goes in with the arguments and comes out, in the same place, with the results. A
/// method that fails leaves the object as it was.
pub trait ServiceObject {
    /// Does the job. What goes in and comes out is free for the class to say.
    ///
    /// # Errors
    /// The reason why it was not done.
    fn exec(&mut self, cx: &Context<'_>, io: &mut Transport) -> Outcome;

    /// Takes options; usually [`OptionTable::ctrl`].
    ///
    /// # Errors
    /// The reason why they were not taken.
    fn ctrl(&mut self, cx: &Context<'_>, io: &mut Transport) -> Outcome;

    /// Tells about the object itself: version, audit trail of CTRL, verbosity. Inherited by every
    /// class that does not write its own.
    ///
    /// # Errors
    /// The reason why it could not.
    fn dbx(&mut self, cx: &Context<'_>, io: &mut Transport) -> Outcome {
        cx.inherited_dbx(io);
        Ok(())
    }

    /// All data inside, as text for people; usually [`OptionTable::dump`].
    fn dump(&self) -> String;
}

/// What a method may use while it runs.
pub struct Context<'a> {
    pub(crate) sorm: &'a Sorm,
    pub(crate) name: &'a str,
    pub(crate) meta: &'a RefCell<Meta>,
}

impl Context<'_> {
    /// The full local name of the object that is called.
    #[must_use]
    pub fn name(&self) -> &str {
        self.name
    }

    /// Calls another object by name. Its reports are added to `io`, so that they reach the first
    /// caller; an error of it is an error here, naming both.
    ///
    /// # Errors
    /// The name is wrong or cannot be built, or the call ended with an error.
    pub fn call(
        &self,
        name: &str,
        method: Method,
        mut sub: Transport,
        io: &mut Transport,
    ) -> Result<Transport, Report> {
        self.sorm.get(name)?.call(self.sorm, method, &mut sub);
        io.reports.append(&mut sub.reports);
        if sub.is_ok() {
            return Ok(sub);
        }
        let text = format!(
            "`{}` needs `{name} {method}`, which ended with {}",
            self.name, sub.code
        );
        Err(Report::error(sub.code, text))
    }

    /// DBX as every class has it.
    pub fn inherited_dbx(&self, io: &mut Transport) {
        let mut meta = self.meta.borrow_mut();
        DBX.ctrl(&mut meta, io);
    }
}

/// How many CTRL requests the audit trail keeps.
const AUDIT: usize = 64;

/// What DBX knows about an object.
#[derive(Debug, Clone, Default)]
pub(crate) struct Meta {
    pub(crate) version: String,
    pub(crate) class: String,
    quiet: bool,
    audit: VecDeque<String>,
    /// CTRL requests so far, also those that the trail no longer keeps.
    count: u64,
}

impl Meta {
    pub(crate) fn new(class: &str, version: &str) -> Self {
        Self {
            version: version.to_owned(),
            class: class.to_owned(),
            ..Self::default()
        }
    }

    /// Notes a CTRL request.
    pub(crate) fn audited(&mut self, text: &str, code: i32) {
        self.count += 1;
        if self.audit.len() >= AUDIT {
            self.audit.pop_front();
        }
        self.audit
            .push_back(format!("{} RET {code} {text}", self.count));
    }

    /// Whether a report of this object is passed on.
    pub(crate) fn passes(&self, report: &Report) -> bool {
        !(self.quiet && report.severity == Severity::Verbose)
    }
}

static DBX: LazyLock<OptionTable<Meta>> = LazyLock::new(|| {
    OptionTable::new("tells about the object itself")
        .flag("quiet", "keeps verbose reports back", |meta: &mut Meta| {
            &mut meta.quiet
        })
        .action("version", &[], "class and its version", |meta, _| {
            Ok(format!("{} {}", meta.class, meta.version))
        })
        .action(
            "audit",
            &[],
            "the last CTRL requests, with number and return code",
            |meta, _| {
                let lines: Vec<&str> = meta.audit.iter().map(String::as_str).collect();
                Ok(lines.join("\n"))
            },
        )
});

/// A class without a job of its own answers EXEC by this.
#[track_caller]
#[must_use]
pub fn unsupported(method: Method) -> Report {
    Report::error(code::UNSUPPORTED, format!("this class has no {method}"))
}
