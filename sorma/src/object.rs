//! What a service object is, where it stands, and what it is given when it is called.

use crate::class::Class;
use crate::comm::Comm;
use crate::meta::Meta;
use crate::report::{Report, code};
use crate::request::Method;
use crate::reserve::Reservation;
use crate::results::Results;
use crate::sorm::Sorm;
use crate::transport::Transport;
use ctos::time::Instant;
use futures_util::future::LocalBoxFuture;
use parking_lot::Mutex;
use std::sync::{Arc, OnceLock};

/// How a method of a service object ends; the error becomes a report and the return code.
pub type Outcome = Result<(), Report>;

/// How an EXEC that waits for others ends; `None` in a class whose EXEC does not.
pub type Later<'a> = Option<LocalBoxFuture<'a, Outcome>>;

/// A service object: a small interface to anything that serves (SORMA technical report,
/// section 1.3.3).
///
/// The transport goes in with the arguments and comes out, in the same place, with the results. A
/// method that fails leaves the object as it was.
pub trait ServiceObject: Send {
    /// Does the job. What goes in and comes out is free for the class to say.
    ///
    /// # Errors
    /// The reason why it was not done.
    fn exec(&mut self, cx: &Context<'_>, io: &mut Transport) -> Outcome {
        let _ = (cx, io);
        Err(unsupported(Method::Exec))
    }

    /// Does a job for which it asks other objects, wherever they are, and waits for them. A class has
    /// this or [`Self::exec`]; one with this is registered with [`Class::waits`](crate::Class::waits).
    fn exec_waiting<'a>(&'a mut self, cx: &'a Waiting<'a>, io: &'a mut Transport) -> Later<'a> {
        let _ = (cx, io);
        None
    }

    /// Takes options; usually [`OptionTable::ctrl`](crate::OptionTable::ctrl).
    ///
    /// # Errors
    /// The reason why they were not taken.
    fn ctrl(&mut self, cx: &Context<'_>, io: &mut Transport) -> Outcome;

    /// All data inside, as text for people; usually [`OptionTable::dump`](crate::OptionTable::dump).
    fn dump(&self) -> String;

    /// Somebody who may have used it is gone: it gives back what it kept for him. Answers whether it has itself
    /// served its time and is to be removed.
    fn forget(&mut self, gone: &dyn Fn(&str) -> bool) -> bool {
        let _ = gone;
        false
    }

    /// Sees whether it can do its job. Asked when the object has been built and has taken its recipe,
    /// and by `DBX -test`; an object that says no is not built.
    ///
    /// # Errors
    /// What is wrong.
    fn self_test(&mut self, cx: &Context<'_>) -> Outcome {
        let _ = cx;
        Ok(())
    }

    /// The object's side of a two-step commitment, if it has one. Without it, `prepare` is refused.
    fn two_step(&mut self) -> Option<&mut dyn TwoStep> {
        None
    }
}

/// An EXEC in two steps, so that several objects do their jobs all or not at all. Between the steps the
/// object is locked for the caller.
pub trait TwoStep {
    /// Sees whether it could do the job, and keeps what it needs for it. Nothing is to be seen from
    /// outside yet.
    ///
    /// # Errors
    /// Why it cannot. The object is then as before.
    fn prepare(&mut self, cx: &Context<'_>, io: &mut Transport) -> Outcome;

    /// Does what was prepared. It must not fail for any reason that could have been seen before; if it
    /// fails nevertheless, its report says what state things are in.
    ///
    /// # Errors
    /// What went wrong.
    fn commit(&mut self, cx: &Context<'_>, io: &mut Transport) -> Outcome;

    /// Lets go of what was prepared.
    fn abort(&mut self, cx: &Context<'_>);
}

/// What a method may use while it runs.
pub struct Context<'a> {
    pub(crate) sorm: &'a Sorm,
    pub(crate) slot: &'a Slot,
    /// The call that this one is made in, if it is.
    pub(crate) within: Option<&'a Context<'a>>,
}

impl Context<'_> {
    /// The full local name of the object that is called.
    #[must_use]
    pub fn name(&self) -> &str {
        self.slot.name()
    }

    /// The manager of this process.
    #[must_use]
    pub fn sorm(&self) -> &Sorm {
        self.sorm
    }

    /// Gives those who subscribe to this object's results something without having been asked: what has
    /// happened, in the form that the class says. (What an EXEC answers they get anyway.) Waits for nobody.
    pub fn publish(&self, body: &Transport) {
        self.slot.publish(self.sorm, body);
    }

    /// What ends a call that needed another object, which ended with that code.
    pub(crate) fn failed(&self, name: &str, method: Method, code: i32) -> Report {
        let text = format!(
            "`{}` needs `{name} {method}`, which ended with {code}",
            self.name()
        );
        Report::error(code, text)
    }

    /// Whether this call is made, directly or not, in one of that object.
    pub(crate) fn is_within(&self, slot: &Slot) -> bool {
        let mut call = Some(self);
        while let Some(now) = call {
            if std::ptr::eq(now.slot, slot) {
                return true;
            }
            call = now.within;
        }
        false
    }
}

/// What an EXEC that waits may use while it runs.
pub struct Waiting<'a> {
    pub(crate) cx: Context<'a>,
    pub(crate) comm: &'a dyn Comm,
}

/// A call that a daemon has an object in.
#[derive(Debug, Clone)]
pub(crate) struct Call {
    pub(crate) from: String,
    pub(crate) method: Method,
    pub(crate) since: Instant,
}

impl Call {
    /// In words: who has called what.
    pub(crate) fn title(&self) -> String {
        let by = match &*self.from {
            "" => "somebody",
            from => from,
        };
        format!("{} of `{by}`", self.method)
    }

    /// In words: who has called what, and how long ago.
    pub(crate) fn words(&self, now: Instant) -> String {
        let time = now.since(self.since).as_secs_f64();
        format!("{} for {time:.1} s", self.title())
    }
}

/// An object with its name.
pub(crate) struct Slot {
    name: String,
    pub(crate) class: Arc<Class>,
    /// Whether its EXEC waits for others.
    waits: bool,
    /// Whose turn it is, where many ask at once.
    pub(crate) turn: tokio::sync::Mutex<()>,
    /// The call that a daemon has it in.
    pub(crate) call: Mutex<Option<Call>>,
    /// Where its results go, if anybody has ever wanted them.
    results: OnceLock<Arc<Results>>,
    pub(crate) body: Mutex<Body>,
}

/// What a call has to itself.
pub(crate) struct Body {
    pub(crate) object: Box<dyn ServiceObject>,
    pub(crate) meta: Meta,
    pub(crate) reserved: Option<Reservation>,
}

impl Slot {
    pub(crate) fn new(name: String, object: Box<dyn ServiceObject>, class: Arc<Class>) -> Self {
        Self {
            waits: class.is_waiting(),
            turn: tokio::sync::Mutex::default(),
            call: Mutex::default(),
            results: OnceLock::new(),
            name,
            class,
            body: Mutex::new(Body {
                object,
                meta: Meta::default(),
                reserved: None,
            }),
        }
    }

    pub(crate) fn name(&self) -> &str {
        &self.name
    }

    /// What a method of the object may use.
    #[inline]
    pub(crate) fn context<'a>(
        &'a self,
        sorm: &'a Sorm,
        within: Option<&'a Context<'a>>,
    ) -> Context<'a> {
        Context {
            sorm,
            slot: self,
            within,
        }
    }

    /// Whether its EXEC waits for others.
    pub(crate) fn waits(&self) -> bool {
        self.waits
    }

    /// From now on its results go there.
    pub(crate) fn feed(&self, results: &Arc<Results>) {
        self.results.get_or_init(|| Arc::clone(results));
    }

    /// How many subscribe to its results.
    pub(crate) fn subscribers(&self) -> usize {
        self.results
            .get()
            .map_or(0, |results| results.subscribers())
    }

    /// Gives subscribers to the object's results a copy.
    #[inline]
    pub(crate) fn publish(&self, sorm: &Sorm, body: &Transport) {
        if let Some(results) = self.results.get() {
            Self::publish_to(results, sorm, body);
        }
    }

    #[cold]
    fn publish_to(results: &Results, sorm: &Sorm, body: &Transport) {
        results.publish(sorm.now(), body);
    }
}

/// A class without a job of its own answers EXEC by this.
#[track_caller]
#[must_use]
pub fn unsupported(method: Method) -> Report {
    Report::error(code::UNSUPPORTED, format!("this class has no {method}"))
}
