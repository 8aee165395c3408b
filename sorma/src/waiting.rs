//! Requests that may wait: for an object that asks others, and for objects that another daemon serves.
//!
//! By this path the same request is met here or there, whichever its name says (service migration,
//! technical report, sections 1.7.3 and 1.10).

use crate::arrival::Arrival;
use crate::comm::Comm;
use crate::meter;
use crate::name::{Location, ObjectName};
use crate::object::{Call, Context, Outcome, Slot, Waiting, unsupported};
use crate::raise;
use crate::relay::relay;
use crate::report::{Report, code};
use crate::request::{Method, Reply, Request};
use crate::slot::{self, Handle};
use crate::sorm::{Place, Sorm, parse};
use crate::transport::Transport;
use crate::workers::{Work, Workers};
use ctos::message::{Command, Data, PayloadError};
use futures_util::FutureExt as _;
use futures_util::future::{Either, LocalBoxFuture, join, pending, select};
use std::panic::{AssertUnwindSafe, resume_unwind};
use std::pin::pin;
use std::sync::Arc;
use std::time::Duration;

/// How long a request waits for its turn at an object that waits for others itself.
const PATIENCE: Duration = Duration::from_secs(60);

impl<'a> Waiting<'a> {
    /// What every method may use; by it other objects of this process are called by reference.
    #[must_use]
    pub fn here(&self) -> &Context<'a> {
        &self.cx
    }

    /// The full local name of the object that is called.
    #[must_use]
    pub fn name(&self) -> &str {
        self.cx.name()
    }

    /// Calls an object wherever it is. Its reports are added to `io`, so that they reach the first
    /// caller; an error of it is an error here, naming both.
    ///
    /// # Errors
    /// The name is wrong or cannot be built, its daemon cannot be reached, or the call ended with an
    /// error.
    pub async fn call(
        &self,
        name: &str,
        method: Method,
        mut sub: Transport,
        io: &mut Transport,
    ) -> Result<Transport, Report> {
        sub.inherit(io);
        let request = Request {
            name: parse(name)?,
            method,
            body: sub,
        };
        let mut sub = self.ask(request).await.body;
        io.reports.append(&mut sub.reports);
        if sub.is_ok() {
            return Ok(sub);
        }
        Err(self.cx.failed(name, method, sub.code))
    }

    /// Has a request met, wherever its object is, and leaves its reports and its code in the reply.
    pub fn ask(&self, request: Request) -> LocalBoxFuture<'_, Reply> {
        Box::pin(self.cx.sorm.ask_in(self.comm, Some(self), request))
    }

    /// What reaches other daemons from here, for [`Sorm::ask_later`], [`Sorm::subscribe`] and the like.
    #[must_use]
    pub fn comm(&self) -> &'a dyn Comm {
        self.comm
    }

    /// Asks a task of the app that is no daemon, in the name of the task that this object is carried by.
    ///
    /// # Errors
    /// There is no app, or no such task; the task refused ([`code::REFUSED`]) or did not answer.
    pub async fn call_task<C: Command>(
        &self,
        task: &str,
        request: C,
        deadline: Duration,
    ) -> Result<C::Reply, Report> {
        let wrong = |error: PayloadError| {
            raise!(
                code::DAEMON,
                "`{}` of task `{task}`: {error}; is it of another version?",
                C::NAME
            )
        };
        let data = Data::of(request).into_bytes().map_err(wrong)?;
        let answer = self.comm.call_task(task, C::INFO, data, deadline).await?;
        Data::Bytes(answer).take::<C::Reply>().map_err(wrong)
    }

    /// The names of the app's tasks that have this handler, in order: who could have been meant where [`Self::call_task`] found
    /// nobody.
    ///
    /// # Errors
    /// The task that this object is carried by is gone.
    pub async fn tasks_of(&self, handler: &str) -> Result<Vec<String>, Report> {
        self.comm.tasks_of(handler).await
    }

    /// Whether there is an app, whose tasks [`Self::call_task`] reaches.
    #[must_use]
    pub fn is_in_app(&self) -> bool {
        self.comm.is_in_app()
    }

    /// Waits.
    pub async fn sleep(&self, time: Duration) {
        self.comm.sleep(time).await;
    }
}

impl Sorm {
    /// Has a request met, here or by another daemon; the reply always comes, errors, panics and all.
    pub async fn ask(&self, comm: &dyn Comm, request: Request) -> Reply {
        self.ask_in(comm, None, request).await
    }

    async fn ask_in(
        &self,
        comm: &dyn Comm,
        within: Option<&Waiting<'_>>,
        request: Request,
    ) -> Reply {
        let Request {
            name,
            method,
            mut body,
        } = request;
        match self.place(&name) {
            Ok(Place::Here) => {
                let met = async {
                    let arrival = self.arrive(comm, within, &name).await?;
                    let handle = self.built(comm, &name, method, &body.from).await?;
                    Ok((arrival, handle))
                };
                match met.await {
                    Ok((arrival, handle)) => {
                        self.meet(comm, within, (arrival, &handle), method, &mut body)
                            .await;
                    }
                    Err(report) => self.refuse(&mut body, report),
                }
            }
            Ok(Place::There(at)) => {
                self.ask_daemon(comm, &at, &name, method, &mut body).await;
            }
            Ok(Place::Traded(wanted)) => {
                self.ask_traded(comm, &wanted, &name, method, &mut body)
                    .await;
            }
            Err(report) => self.refuse(&mut body, report),
        }
        Reply { name, body }
    }

    /// The caller's place among those who ask for an object that is not built yet.
    ///
    /// # Errors
    /// Its building takes long.
    async fn arrive(
        &self,
        comm: &dyn Comm,
        within: Option<&Waiting<'_>>,
        name: &ObjectName,
    ) -> Result<Option<Arrival>, Report> {
        // Without threads an object is built at once; and one that is in a call may ask itself.
        if comm.workers().is_none() || within.is_some() {
            return Ok(None);
        }
        let local = name.local();
        let is_there = || self.find(&local).is_some();
        let arrived = Arrival::at(&self.inner.arrivals, &local, is_there);
        match select(pin!(arrived), comm.sleep(slot::PATIENCE)).await {
            Either::Left((arrival, _)) => Ok(arrival),
            Either::Right(_) => Err(self.in_the_making(&local)),
        }
    }

    /// The object of that name in this process. If it has to be built for a request of `from`, that is done on a thread of
    /// its own.
    async fn built(
        &self,
        comm: &dyn Comm,
        name: &ObjectName,
        method: Method,
        from: &str,
    ) -> Result<Handle, Report> {
        let local = name.local();
        let Some(workers) = comm.workers().filter(|_| self.find(&local).is_none()) else {
            return self.resolve(name);
        };
        let call = Call {
            from: from.to_owned(),
            method,
            since: self.now(),
        };
        let (manager, wanted) = (self.clone(), name.clone());
        let work = Work {
            name: local.clone(),
            call: call.title(),
            since: call.since,
        };
        let built = workers.call(work, self.process(), None, move |built| {
            *built = Some(manager.resolve(&wanted));
        });
        let built = match select(pin!(built), comm.sleep(slot::PATIENCE)).await {
            Either::Left((built, _)) => built,
            // It goes on, for the next caller.
            Either::Right(_) => return Err(self.in_the_making(&local)),
        };
        let (built, ended) = built.map_err(|(_, report)| report)?;
        match (built, ended) {
            (Some(built), _) => built,
            (None, Err(panic)) => {
                let text = ctos::panic_text(panic.as_ref());
                Err(raise!(
                    code::PANIC,
                    "`{name}` panicked while it was built: {text}"
                ))
            }
            (None, Ok(())) => self.resolve(name),
        }
    }

    /// Has a request met by an object of this process, panics and all.
    pub(crate) async fn meet(
        &self,
        comm: &dyn Comm,
        within: Option<&Waiting<'_>>,
        (arrival, object): (Option<Arrival>, &Handle),
        method: Method,
        body: &mut Transport,
    ) {
        let slot = &object.slot;
        let seen = self
            .watchers()
            .begin(self.clock(), slot.name(), method, body);
        let call = ask((arrival, slot), self, comm, within, method, body);
        if let Err(panic) = AssertUnwindSafe(call).catch_unwind().await {
            // Nobody knows what state it is in.
            self.remove(slot.name());
            body.code = 0;
            body.report(slot.panicked(self, panic.as_ref()));
        }
        if let Some(seen) = seen {
            seen.end(self.process(), self.now(), body);
        }
    }

    /// The proxy's part: sends the request on, and puts what comes back in its place.
    async fn ask_daemon(
        &self,
        comm: &dyn Comm,
        at: &Location,
        name: &ObjectName,
        method: Method,
        body: &mut Transport,
    ) {
        let request = Request {
            name: name.here(),
            method,
            body: std::mem::take(body),
        };
        self.used(at, &request.name);
        match comm.ask(at, request).await {
            Ok(answer) => *body = answer,
            Err(report) => self.unanswered(name, body, report),
        }
    }
}

/// Has an object of this process called when it is the caller's turn.
async fn ask(
    (arrival, slot): (Option<Arrival>, &Arc<Slot>),
    sorm: &Sorm,
    comm: &dyn Comm,
    within: Option<&Waiting<'_>>,
    method: Method,
    io: &mut Transport,
) {
    let outer = within.map(|call| &call.cx);
    let workers = comm.workers();
    // What calls itself finds that, and says so.
    let at_once = !slot.waits() && workers.is_none();
    if at_once || outer.is_some_and(|call| call.is_within(slot)) {
        return slot.call_unseen(sorm, outer, method, io);
    }
    let patience = if slot.waits() {
        PATIENCE
    } else {
        slot::PATIENCE
    };
    let turn = match select(pin!(slot.turn.lock()), comm.sleep(patience)).await {
        Either::Left((turn, _)) => Some(turn),
        Either::Right(_) => None,
    };
    // Who came next is behind this one now.
    drop(arrival);
    match (turn, workers) {
        (Some(_turn), Some(workers)) => call_on(workers, slot, (sorm, comm), method, io).await,
        (Some(_turn), None) if slot.waits() && method == Method::Exec => {
            let _noted = Noted::new(slot, sorm, method, io);
            slot.exec_waiting(sorm, comm, outer, io).await;
        }
        (None, _) if slot.waits() || workers.is_some() => slot.refuse_busy(sorm, io),
        // Without the lock `turn` the object is still in a call, which this finds.
        _ => slot.call_unseen(sorm, outer, method, io),
    }
}

/// The call of an object that waits is told of for as long as this is kept, also when nobody waits for it any more.
struct Noted<'a>(&'a Slot);

impl<'a> Noted<'a> {
    fn new(slot: &'a Slot, sorm: &Sorm, method: Method, io: &Transport) -> Self {
        *slot.call.lock() = Some(Call {
            from: io.from.clone(),
            method,
            since: sorm.now(),
        });
        Self(slot)
    }
}

impl Drop for Noted<'_> {
    fn drop(&mut self) {
        *self.0.call.lock() = None;
    }
}

/// Has an object called on a thread of its own. What it asks there goes through `comm` here.
async fn call_on(
    workers: &'static Workers,
    slot: &Arc<Slot>,
    (sorm, comm): (&Sorm, &dyn Comm),
    method: Method,
    io: &mut Transport,
) {
    let call = Call {
        from: io.from.clone(),
        method,
        since: sorm.now(),
    };
    let work = Work {
        name: slot.name().to_owned(),
        call: call.title(),
        since: call.since,
    };
    *slot.call.lock() = Some(call);
    let (object, manager) = (Arc::clone(slot), sorm.clone());
    let waits = slot.waits() && method == Method::Exec;
    let (relay, orders) = relay(comm);
    let called = workers.call(work, sorm.process(), std::mem::take(io), move |io| {
        if waits {
            relay.run(object.exec_waiting(&manager, &relay, None, io));
        } else {
            object.call_unseen(&manager, None, method, io);
        }
        *object.call.lock() = None;
    });
    let called = join(called, orders.serve(comm)).map(|(called, ())| called);
    // How long a call lasts that waits for others is not its own doing.
    let patience = async {
        match waits {
            true => pending().await,
            false => comm.sleep(slot::PATIENCE).await,
        }
    };
    let called = match select(pin!(called), pin!(patience)).await {
        Either::Left((done, _)) => done,
        Either::Right(((), called)) => {
            let call = slot.call.lock().clone();
            let call = call.map(|call| call.words(sorm.now())).unwrap_or_default();
            tracing::warn!(object = slot.name(), call, "does not come to an end");
            called.await
        }
    };
    let (body, ended) = match called {
        Ok(called) => called,
        Err((body, report)) => {
            *slot.call.lock() = None;
            *io = body;
            io.code = 0;
            return io.report(slot.signed(report, Some(sorm)));
        }
    };
    *io = body;
    if let Err(panic) = ended {
        *slot.call.lock() = None;
        resume_unwind(panic);
    }
}

impl Slot {
    #[expect(
        clippy::await_holding_lock,
        reason = "whoever would wait for it has waited for the turn before; all others only try"
    )]
    async fn exec_waiting(
        &self,
        sorm: &Sorm,
        comm: &dyn Comm,
        outer: Option<&Context<'_>>,
        io: &mut Transport,
    ) {
        io.code = 0;
        let before = io.reports.len();
        let mut guard = match self.lock(outer) {
            Ok(guard) => guard,
            Err(report) => return io.report(report),
        };
        let body = &mut *guard;
        let metered = meter::begin(Method::Exec, io, || sorm.now());
        let outcome: Outcome = match self.free_for(body, sorm, &io.from) {
            Err(report) => Err(report),
            Ok(()) => {
                let cx = Waiting {
                    cx: self.context(sorm, outer),
                    comm,
                };
                match body.object.exec_waiting(&cx, io) {
                    Some(job) => job.await,
                    None => Err(unsupported(Method::Exec)),
                }
            }
        };
        body.meta.execs += 1;
        self.collect(body, sorm, before, outcome, io);
        if let Some(begun) = metered {
            body.meta.meter.add(begun, io, sorm.now());
        }
        self.publish(sorm, io);
    }
}
