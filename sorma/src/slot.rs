//! Calls of an object by reference, from any thread.
//!
//! Three handles for three needs. A [`Handle`] is shared, and each call takes the object's lock. A
//! [`Claim`] has taken it once, so that a call costs what a virtual call does. An [`Owned`] object is
//! not shared and stands in no repository.

use crate::dbx;
use crate::meter;
use crate::object::{Body, Context, Outcome, Slot};
use crate::raise;
use crate::report::{Report, code};
use crate::request::Method;
use crate::sorm::Sorm;
use crate::transport::Transport;
use parking_lot::MutexGuard;
use std::any::Any;
use std::sync::Arc;
use std::time::Duration;

/// How long a call waits for one from another thread to end.
pub(crate) const PATIENCE: Duration = Duration::from_secs(10);

/// A reference to an object, for any thread; it stays usable after the object was removed from the
/// repository.
#[derive(Clone)]
pub struct Handle {
    pub(crate) slot: Arc<Slot>,
}

/// An object that is held: nobody else can call it until this is dropped.
pub struct Claim<'a> {
    slot: &'a Slot,
    body: MutexGuard<'a, Body>,
}

/// An object outside the repository, for its owner alone.
pub struct Owned {
    slot: Slot,
}

impl std::fmt::Debug for Handle {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Handle({})", self.slot.name())
    }
}

impl std::fmt::Debug for Claim<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Claim({})", self.slot.name())
    }
}

impl std::fmt::Debug for Owned {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Owned({})", self.slot.name())
    }
}

impl Handle {
    /// The object's full local name.
    #[must_use]
    pub fn name(&self) -> &str {
        self.slot.name()
    }

    /// Calls a method. Results and reports are in `io`; its code is 0 when all went well.
    ///
    /// A panic of the object goes on to the caller, as that of a function would;
    /// [`Sorm::request`] contains it.
    pub fn call(&self, sorm: &Sorm, method: Method, io: &mut Transport) {
        self.slot.call(sorm, None, method, io);
    }

    /// [`Self::call`] of EXEC.
    pub fn exec(&self, sorm: &Sorm, io: &mut Transport) {
        self.call(sorm, Method::Exec, io);
    }

    /// Takes the object for a while.
    ///
    /// # Errors
    /// Another thread does not let go of it.
    pub fn claim(&self) -> Result<Claim<'_>, Report> {
        let body = self.slot.lock(None)?;
        Ok(Claim {
            slot: &self.slot,
            body,
        })
    }

    /// All data inside the object, as text; `None` while the object is in a call.
    #[must_use]
    pub fn dump(&self) -> Option<String> {
        self.slot.body.try_lock().map(|body| body.object.dump())
    }
}

impl Claim<'_> {
    /// EXEC, at the cost of a virtual call. Results and reports are in `io`.
    #[inline]
    pub fn exec(&mut self, sorm: &Sorm, io: &mut Transport) {
        self.slot.exec(&mut self.body, sorm, None, io);
    }

    /// Calls a method.
    pub fn call(&mut self, sorm: &Sorm, method: Method, io: &mut Transport) {
        self.slot.method(&mut self.body, sorm, None, method, io);
    }
}

impl Owned {
    pub(crate) fn new(slot: Slot) -> Self {
        Self { slot }
    }

    /// The object's full local name.
    #[must_use]
    pub fn name(&self) -> &str {
        self.slot.name()
    }

    /// EXEC in a call of its owner. Results and reports are in `io`.
    pub fn exec(&mut self, cx: &Context<'_>, io: &mut Transport) {
        self.call(cx, Method::Exec, io);
    }

    /// Calls a method in a call of its owner.
    pub fn call(&mut self, cx: &Context<'_>, method: Method, io: &mut Transport) {
        // Nobody else has it: the lock is free.
        self.slot.call(cx.sorm, Some(cx), method, io);
    }
}

impl Context<'_> {
    /// Calls another object by reference: `sub` goes in and comes out. Its reports are added to `io`, so that
    /// they reach the first caller; an error of it is an error here, naming both.
    ///
    /// # Errors
    /// The call ended with an error.
    pub fn call_by(
        &self,
        object: &Handle,
        method: Method,
        sub: &mut Transport,
        io: &mut Transport,
    ) -> Outcome {
        sub.inherit(io);
        object.slot.call(self.sorm, Some(self), method, sub);
        io.reports.append(&mut sub.reports);
        if sub.is_ok() {
            return Ok(());
        }
        Err(self.failed(object.name(), method, sub.code))
    }
}

impl Slot {
    /// The object, when no call of another thread has it.
    ///
    /// # Errors
    /// This very call has it already, or another thread does not let go of it.
    pub(crate) fn lock(
        &self,
        within: Option<&Context<'_>>,
    ) -> Result<MutexGuard<'_, Body>, Report> {
        if let Some(body) = self.body.try_lock() {
            return Ok(body);
        }
        let name = self.name();
        let text = if within.is_some_and(|call| call.is_within(self)) {
            format!("`{name}` is in a call already: it was called by itself, directly or not")
        } else if self.waits() {
            // The call that has it may need this very thread to go on.
            format!("`{name}` is in a call that waits for other objects")
        } else if let Some(body) = self.body.try_lock_for(PATIENCE) {
            return Ok(body);
        } else {
            format!(
                "`{name}` has been in a call of another thread for {} s",
                PATIENCE.as_secs()
            )
        };
        Err(self.signed(Report::error(code::BUSY, text), None))
    }

    /// Answers that the object has been in another call for too long, and whose.
    pub(crate) fn refuse_busy(&self, sorm: &Sorm, io: &mut Transport) {
        let call = self.call.lock().clone();
        let call = call.map_or_else(
            || "a call that does not end".to_owned(),
            |call| call.words(sorm.now()),
        );
        let text = format!(
            "`{}` is in {call}; when that is not to be waited for, `ctos restart {}` ends it",
            self.name(),
            sorm.process()
        );
        io.code = 0;
        io.report(self.signed(Report::error(code::BUSY, text), Some(sorm)));
    }

    pub(crate) fn call(
        &self,
        sorm: &Sorm,
        within: Option<&Context<'_>>,
        method: Method,
        io: &mut Transport,
    ) {
        let seen = sorm.watchers().begin(sorm.clock(), self.name(), method, io);
        self.call_unseen(sorm, within, method, io);
        if let Some(seen) = seen {
            seen.end(sorm.process(), sorm.now(), io);
        }
    }

    /// [`Self::call`], of which no watcher hears.
    pub(crate) fn call_unseen(
        &self,
        sorm: &Sorm,
        within: Option<&Context<'_>>,
        method: Method,
        io: &mut Transport,
    ) {
        match self.lock(within) {
            Ok(mut body) => self.method(&mut body, sorm, within, method, io),
            Err(report) => {
                io.code = 0;
                io.report(report);
            }
        }
    }

    /// What a panic of the object said.
    pub(crate) fn panicked(&self, sorm: &Sorm, panic: &(dyn Any + Send)) -> Report {
        let text = ctos::panic_text(panic);
        let text = format!(
            "`{}` panicked: {text}; its next use builds it anew",
            self.name()
        );
        self.signed(Report::error(code::PANIC, text), Some(sorm))
    }

    fn method(
        &self,
        body: &mut Body,
        sorm: &Sorm,
        within: Option<&Context<'_>>,
        method: Method,
        io: &mut Transport,
    ) {
        let metered = meter::begin(method, io, || sorm.now());
        match method {
            Method::Exec => self.exec(body, sorm, within, io),
            Method::Ctrl => self.ctrl(body, sorm, within, io),
            Method::Dbx => self.with_reports(body, sorm, within, io, |body, cx, io| {
                dbx::dbx(body, cx, io)
            }),
        }
        if let Some(begun) = metered {
            body.meta.meter.add(begun, io, sorm.now());
        }
    }

    /// EXEC of an object that is held. Into its caller goes what every call does; all else is apart.
    #[inline]
    fn exec(&self, body: &mut Body, sorm: &Sorm, within: Option<&Context<'_>>, io: &mut Transport) {
        if (body.reserved.is_some() || self.waits()) && !self.may_exec(body, sorm, io) {
            return;
        }
        let cx = self.context(sorm, within);
        io.code = 0;
        let before = io.reports.len();
        let outcome = body.object.exec(&cx, io);
        body.meta.execs += 1;
        if outcome.is_err() || io.reports.len() != before || io.code != 0 {
            self.collect(body, sorm, before, outcome, io);
        }
        self.publish(sorm, io);
    }

    /// Whether an object that is locked, or waits for others, may be called so; if not, `io` says why.
    #[cold]
    fn may_exec(&self, body: &mut Body, sorm: &Sorm, io: &mut Transport) -> bool {
        io.code = 0;
        if let Err(report) = self.free_for(body, sorm, &io.from) {
            io.report(report);
            return false;
        }
        if self.waits() {
            body.meta.execs += 1;
            let before = io.reports.len();
            self.collect(body, sorm, before, Err(self.must_wait()), io);
            return false;
        }
        true
    }

    #[cold]
    fn must_wait(&self) -> Report {
        let name = self.name();
        raise!(
            code::UNSUPPORTED,
            "`{name}` asks other objects and waits for them: it is asked with `Sorm::ask`, by name"
        )
    }

    fn ctrl(&self, body: &mut Body, sorm: &Sorm, within: Option<&Context<'_>>, io: &mut Transport) {
        let asked = io.text.clone();
        let keeps = sorm.keeps(self);
        let before = keeps.then(|| self.options(body, sorm));
        self.with_reports(body, sorm, within, io, |body, cx, io| {
            self.free_for(body, sorm, &io.from)?;
            body.object.ctrl(cx, io)
        });
        if let Some(before) = before {
            let after = self.options(body, sorm);
            if after.is_some() && after != before {
                sorm.keep_options(self.name(), after);
            }
        }
        body.meta.audited(sorm.now(), &io.from, &asked, io.code);
    }

    /// Its options, as CTRL takes them back.
    fn options(&self, body: &mut Body, sorm: &Sorm) -> Option<String> {
        let mut io = Transport::text("-dump");
        let outcome = body.object.ctrl(&self.context(sorm, None), &mut io);
        (outcome.is_ok() && io.is_ok()).then_some(io.text)
    }

    /// Does something in the name of the object, and signs what is reported about it.
    pub(crate) fn with_reports(
        &self,
        body: &mut Body,
        sorm: &Sorm,
        within: Option<&Context<'_>>,
        io: &mut Transport,
        act: impl FnOnce(&mut Body, &Context<'_>, &mut Transport) -> Outcome,
    ) {
        let cx = self.context(sorm, within);
        io.code = 0;
        let before = io.reports.len();
        let outcome = act(body, &cx, io);
        self.collect(body, sorm, before, outcome, io);
    }

    /// Whether `from` may change or use the object now.
    pub(crate) fn free_for(&self, body: &mut Body, sorm: &Sorm, from: &str) -> Outcome {
        let Some(reserved) = &body.reserved else {
            return Ok(());
        };
        let now = sorm.now();
        if reserved.is_over(now) {
            self.let_go(body, sorm);
            return Ok(());
        }
        if reserved.is_of(from) {
            return Ok(());
        }
        let text = format!("`{}` is {}", self.name(), reserved.words(now));
        Err(self.signed(Report::error(code::LOCKED, text), Some(sorm)))
    }

    /// Ends the reservation, and what was prepared under it.
    pub(crate) fn let_go(&self, body: &mut Body, sorm: &Sorm) {
        let Some(reserved) = body.reserved.take() else {
            return;
        };
        if reserved.is_prepared()
            && let Some(steps) = body.object.two_step()
        {
            steps.abort(&self.context(sorm, None));
        }
    }

    /// Puts the object's name on what it reported, and leaves out what nobody wants to hear.
    #[cold]
    pub(crate) fn collect(
        &self,
        body: &mut Body,
        sorm: &Sorm,
        before: usize,
        outcome: Outcome,
        io: &mut Transport,
    ) {
        if let Err(report) = outcome {
            io.report(report);
        }
        if io.code != 0 {
            body.meta.errors += 1;
        }
        let own = io.reports.split_off(before.min(io.reports.len()));
        let own = own.into_iter().filter(|report| body.meta.passes(report));
        let own = own.map(|report| self.signed(report, Some(sorm)));
        io.reports.extend(own);
    }

    /// The report with this object's name, unless a sub-service has put its own.
    pub(crate) fn signed(&self, mut report: Report, sorm: Option<&Sorm>) -> Report {
        if report.object.is_empty() {
            self.name().clone_into(&mut report.object);
        }
        if let Some(sorm) = sorm.filter(|_| report.process.is_empty()) {
            sorm.process().clone_into(&mut report.process);
            report.time_ns = sorm.now().as_nanos();
        }
        report
    }
}
