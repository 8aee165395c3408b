//! Requests that nobody stands waiting for: deferred, one-way, with a callback, and several at once (SORMA
//! technical report, section 1.7).
//!
//! Whatever is said here holds for an object of this process as for one of another daemon. A request is
//! begun at once, in the order in which requests are given. It is done to its end even if the caller stops
//! listening; it ends with its task. None of it is ever executed twice.

use crate::comm::Comm;
use crate::name::ObjectName;
use crate::object::{Outcome, Waiting};
use crate::raise;
use crate::report::{Report, code};
use crate::request::{Reply, Request};
use crate::sorm::{Place, Sorm};
use crate::transport::Transport;
use futures_util::StreamExt as _;
use futures_util::stream;
use std::rc::Rc;
use std::sync::Arc;
use tokio::sync::{Semaphore, oneshot};

/// An answer that comes later. Dropped, it is not heard, and what was asked is done all the same.
#[derive(Debug)]
pub struct Deferred<T> {
    answer: oneshot::Receiver<T>,
    /// The answer that `is_ready` has already found.
    found: Option<T>,
    /// Stands in for an answer that never comes, because the task that should make it has ended.
    instead: Option<T>,
}

impl<T> Deferred<T> {
    /// Whether the answer is there.
    pub fn is_ready(&mut self) -> bool {
        if self.found.is_none() {
            self.found = match self.answer.try_recv() {
                Ok(answer) => {
                    self.instead = None;
                    Some(answer)
                }
                Err(oneshot::error::TryRecvError::Empty) => None,
                Err(oneshot::error::TryRecvError::Closed) => self.instead.take(),
            };
        }
        self.found.is_some()
    }

    /// The answer, if it is there.
    pub fn try_collect(&mut self) -> Option<T> {
        let _ = self.is_ready();
        self.found.take()
    }

    /// Waits for the answer. `None` when it was collected before.
    pub async fn collect(mut self) -> Option<T> {
        if self.is_ready() {
            return self.found.take();
        }
        match self.answer.await {
            Ok(answer) => Some(answer),
            Err(_) => self.instead.take(),
        }
    }
}

impl Sorm {
    /// Deferred: asks, and has the answer collected later. The answer always comes, errors and all.
    ///
    /// # Errors
    /// Nothing can run concurrently with the caller here.
    pub fn ask_later(&self, comm: &dyn Comm, request: Request) -> Result<Deferred<Reply>, Report> {
        let never = self.never(&request);
        let sorm = self.clone();
        defer(comm, never, move |comm| async move {
            sorm.ask(&*comm, request).await
        })
    }

    /// [`Self::ask_later`], begun when `turns` has a permit. So that many of all that share it are under way at
    /// once, in the order in which they are asked.
    ///
    /// # Errors
    /// Nothing can run concurrently with the caller here.
    pub(crate) fn ask_in_turn(
        &self,
        comm: &dyn Comm,
        request: Request,
        turns: Arc<Semaphore>,
    ) -> Result<Deferred<Reply>, Report> {
        let never = self.never(&request);
        let sorm = self.clone();
        // Asked for here and not by the job, which keeps the order.
        let turn = turns.acquire_owned();
        defer(comm, never, move |comm| async move {
            // Nobody closes it.
            let _turn = turn.await;
            sorm.ask(&*comm, request).await
        })
    }

    /// Callback: asks, and hands the answer, errors and all, to `then` when it comes.
    ///
    /// # Errors
    /// Nothing can run concurrently with the caller here.
    pub fn ask_then(
        &self,
        comm: &dyn Comm,
        request: Request,
        then: impl FnOnce(Reply) + Send + 'static,
    ) -> Outcome {
        let sorm = self.clone();
        comm.spawn(Box::new(move |comm| {
            Box::pin(async move { then(sorm.ask(&*comm, request).await) })
        }))
    }

    /// One-way: has it done, and wants no answer. It is done when the server of the object has taken
    /// it, not when it is executed. What the object reports is logged where it is served.
    ///
    /// # Errors
    /// It was not taken: a name that leads nowhere, a daemon that is not there, or whose queue is full.
    pub async fn tell_only(&self, comm: &dyn Comm, request: Request) -> Outcome {
        let at = match self.place(&request.name)? {
            Place::Here => {
                let (sorm, name) = (self.clone(), request.name.clone());
                return self.ask_then(comm, request, move |reply| {
                    sorm.unheard(&name, &reply.body);
                });
            }
            Place::There(at) => at,
            Place::Traded(wanted) => self.best(comm, &request.name, &wanted).await?,
        };
        let request = Request {
            name: request.name.here(),
            ..request
        };
        self.used(&at, &request.name);
        comm.tell(&at, request).await
    }

    /// Logs what nobody waits to hear.
    pub(crate) fn unheard(&self, name: &ObjectName, body: &Transport) {
        if !body.is_ok() {
            tracing::warn!(object = %name, chassis = self.process(), error = body.said(), "a one-way request came to nothing");
        }
    }

    /// FORK: several requests at once, at most `at_once` of them under way; the replies stand in the order
    /// of the requests, errors and all. One that fails or is slow stops none of the others.
    pub async fn fork(
        &self,
        comm: &dyn Comm,
        requests: Vec<Request>,
        at_once: usize,
    ) -> Vec<Reply> {
        forked(requests, at_once, |request| self.ask(comm, request)).await
    }

    /// [`Self::fork`], whose replies are collected later: the caller is not kept.
    ///
    /// # Errors
    /// Nothing can run concurrently with the caller here.
    pub fn fork_later(
        &self,
        comm: &dyn Comm,
        requests: Vec<Request>,
        at_once: usize,
    ) -> Result<Deferred<Vec<Reply>>, Report> {
        let never = requests.iter().map(|request| self.never(request));
        let never = never.collect();
        let sorm = self.clone();
        defer(comm, never, move |comm| async move {
            sorm.fork(&*comm, requests, at_once).await
        })
    }

    /// The answer to a request that nobody is left to make.
    fn never(&self, request: &Request) -> Reply {
        let name = request.name.clone();
        let mut body = Transport::default().from(request.body.from.clone());
        let report = raise!(
            code::BUSY,
            "`{name}`: the task that asked has ended, or begun anew, before the answer came"
        );
        self.refuse(&mut body, report);
        Reply { name, body }
    }
}

impl Waiting<'_> {
    /// [`Sorm::fork`] from within an object. The reports of all are added to `io`, so that they reach the
    /// first caller; the replies keep their codes.
    pub async fn fork(
        &self,
        requests: Vec<Request>,
        at_once: usize,
        io: &mut Transport,
    ) -> Vec<Reply> {
        let mut replies = forked(requests, at_once, |mut request| {
            request.body.inherit(io);
            self.ask(request)
        })
        .await;
        for reply in &mut replies {
            io.reports.append(&mut reply.body.reports);
        }
        replies
    }
}

async fn forked<F: Future<Output = Reply>>(
    requests: Vec<Request>,
    at_once: usize,
    ask: impl Fn(Request) -> F,
) -> Vec<Reply> {
    let asked = requests.into_iter().enumerate().map(|(index, request)| {
        let asked = ask(request);
        async move { (index, asked.await) }
    });
    let mut replies: Vec<(usize, Reply)> = stream::iter(asked)
        .buffer_unordered(at_once.max(1))
        .collect()
        .await;
    replies.sort_by_key(|(index, _)| *index);
    replies.into_iter().map(|(_, reply)| reply).collect()
}

fn defer<T: Send + 'static, F: Future<Output = T> + 'static>(
    comm: &dyn Comm,
    instead: T,
    work: impl FnOnce(Rc<dyn Comm>) -> F + Send + 'static,
) -> Result<Deferred<T>, Report> {
    let (sender, answer) = oneshot::channel();
    comm.spawn(Box::new(move |comm| {
        Box::pin(async move {
            // The caller may have stopped listening.
            let _ = sender.send(work(comm).await);
        })
    }))?;
    Ok(Deferred {
        answer,
        found: None,
        instead: Some(instead),
    })
}
