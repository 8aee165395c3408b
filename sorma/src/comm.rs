//! The seam to other daemons: what carries requests, and waits. This crate's own carrier over tasks is
//! in [`crate::daemon`]; a program of one process needs none.

use crate::name::{Location, ObjectName};
use crate::raise;
use crate::report::{Report, code};
use crate::request::Request;
use crate::results::{Keep, Sample};
use crate::transport::Transport;
use crate::workers::Workers;
use ctos::message::CommandInfo;
use futures_util::FutureExt as _;
use futures_util::future::LocalBoxFuture;
use std::rc::Rc;
use std::time::Duration;

/// Work that goes on while its caller does something else; it gets a carrier of its own.
pub type Job = Box<dyn FnOnce(Rc<dyn Comm>) -> LocalBoxFuture<'static, ()> + Send>;

/// What a daemon answers, or why it does not.
pub type Answer<'a, T> = LocalBoxFuture<'a, Result<T, Report>>;

/// Why there is no answer.
#[derive(Debug, Clone, PartialEq)]
pub struct NoAnswer {
    /// What happened.
    pub report: Report,
    /// Whether the request may have been executed; when not, it may be asked of somebody else.
    pub perhaps_executed: bool,
}

/// What a daemon has for a subscriber.
#[derive(Debug, Clone, PartialEq)]
pub enum Taken {
    /// The results after the one that was named, the oldest first; none if none came for a while.
    Samples(Vec<Sample>),
    /// The daemon knows no such subscriber: it was started anew, or was not asked for long.
    Unknown,
}

/// What reaches other daemons (the report's COMM and its connection objects, sections 1.4.1 and 1.4.3).
pub trait Comm {
    /// Has the daemon at `at` meet a request, whose name is a local one there. What the object
    /// answers, errors of its own among it, is an `Ok`.
    ///
    /// An `Err` says why there is no answer. Whether the request was executed is then not known; it is
    /// never executed twice unless the caller has said that this does no harm.
    fn ask<'a>(
        &'a self,
        at: &'a Location,
        request: Request,
    ) -> LocalBoxFuture<'a, Result<Transport, Report>>;

    /// Waits.
    fn sleep(&self, time: Duration) -> LocalBoxFuture<'_, ()>;

    /// [`Self::ask`], once only, and with whether the request may have been executed.
    fn ask_once<'a>(
        &'a self,
        at: &'a Location,
        request: Request,
    ) -> LocalBoxFuture<'a, Result<Transport, NoAnswer>> {
        Box::pin(async move {
            let answer = self.ask(at, request).await;
            answer.map_err(|report| NoAnswer {
                report,
                perhaps_executed: true,
            })
        })
    }

    /// How often more a request may be asked when it is lost; 0 unless the caller has said that
    /// executing it twice does no harm.
    fn retries(&self) -> u32 {
        0
    }

    /// Gives the daemon a request whose answer nobody wants; done when the daemon has taken it.
    fn tell<'a>(&'a self, at: &'a Location, request: Request) -> Answer<'a, ()> {
        Box::pin(async move { self.ask(at, request).await.map(|_| ()) })
    }

    /// Begins some work at once and goes on with it while the caller does something else.
    ///
    /// # Errors
    /// There is nothing here that could go on with it.
    fn spawn(&self, job: Job) -> Result<(), Report>;

    /// The daemons that could be asked, for trading.
    fn daemons(&self) -> Vec<String> {
        Vec::new()
    }

    /// Subscribes to the results of an object of another daemon; answers the subscriber's number there and
    /// the number of the last result before.
    fn subscribe<'a>(
        &'a self,
        at: &'a Location,
        name: &'a ObjectName,
        keep: Keep,
    ) -> Answer<'a, (u64, u64)> {
        let _ = keep;
        Box::pin(async move { Err(unreachable(at, name)) })
    }

    /// Waits a while for results after number `after`, and says that those before have arrived.
    fn take<'a>(
        &'a self,
        at: &'a Location,
        name: &'a ObjectName,
        subscriber: u64,
        after: u64,
    ) -> Answer<'a, Taken> {
        let _ = (subscriber, after);
        Box::pin(async move { Err(unreachable(at, name)) })
    }

    /// Ends a subscription.
    fn leave<'a>(&'a self, at: &'a Location, subscriber: u64) -> LocalBoxFuture<'a, ()> {
        let _ = (at, subscriber);
        Box::pin(std::future::ready(()))
    }

    /// Waits until a daemon that is gone is there again, as long as anybody would.
    ///
    /// # Errors
    /// It did not come back.
    fn back<'a>(&'a self, at: &'a Location) -> Answer<'a, ()> {
        let _ = at;
        Box::pin(std::future::ready(Ok(())))
    }

    /// The threads on which objects are called, so that none of them keeps its server from other objects. `None`:
    /// they are called at once.
    fn workers(&self) -> Option<&'static Workers> {
        None
    }

    /// Whether there is an app with tasks.
    fn is_in_app(&self) -> bool {
        false
    }

    /// The names of the app's tasks that have this handler, in order; none without an app.
    fn tasks_of<'a>(&'a self, handler: &'a str) -> Answer<'a, Vec<String>> {
        let _ = handler;
        Box::pin(async { Ok(Vec::new()) })
    }

    /// Asks a task of the app, in the encoding of messages between processes.
    fn call_task<'a>(
        &'a self,
        task: &'a str,
        command: CommandInfo,
        data: Vec<u8>,
        deadline: Duration,
    ) -> Answer<'a, Vec<u8>> {
        let _ = (data, deadline);
        Box::pin(async move {
            Err(raise!(
                code::DAEMON,
                "`{}` of task `{task}`: there is no app here; ask in one that runs",
                command.name
            ))
        })
    }
}

/// Reaches nobody.
#[derive(Debug, Clone, Copy, Default)]
pub struct Alone;

impl Comm for Alone {
    fn ask<'a>(&'a self, at: &'a Location, request: Request) -> Answer<'a, Transport> {
        Box::pin(async move { Err(unreachable(at, &request.name)) })
    }

    fn sleep(&self, _time: Duration) -> LocalBoxFuture<'_, ()> {
        Box::pin(std::future::ready(()))
    }

    /// Does what can be done at once.
    fn spawn(&self, job: Job) -> Result<(), Report> {
        job(Rc::new(Self)).now_or_never().ok_or_else(|| {
            raise!(
                code::UNSUPPORTED,
                "this waits for something else, and nothing else goes on here; ask in an app that runs"
            )
        })
    }
}

fn unreachable(at: &Location, name: &ObjectName) -> Report {
    let name = name.local();
    match at {
        Location::Alias(alias) => raise!(
            code::DAEMON,
            "`{name}@{alias}`: this process reaches no other daemon, and the dictionary does not say that `{alias}` \
             is itself; add a line `{alias} self`, or ask in an app that runs"
        ),
        _ => raise!(
            code::DAEMON,
            "`{name}` is served by another daemon, and this process has no link to it"
        ),
    }
}
