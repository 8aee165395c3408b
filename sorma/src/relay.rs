//! The way to daemons and tasks for an object that is called on a thread of its own. The task that serves the object
//! asks for it, on the thread of that task.

use crate::comm::{Answer, Comm, Job, NoAnswer, Taken};
use crate::name::{Location, ObjectName};
use crate::raise;
use crate::report::{Report, code};
use crate::request::Request;
use crate::results::Keep;
use crate::transport::Transport;
use ctos::message::CommandInfo;
use futures_util::future::{LocalBoxFuture, pending, select};
use futures_util::stream::{FuturesUnordered, StreamExt as _};
use std::pin::pin;
use std::time::Duration;
use tokio::runtime::Handle;
use tokio::sync::{mpsc, oneshot};

/// Something to be asked on the other thread. It ends early when the caller stops listening.
type Order = Box<dyn for<'c> FnOnce(&'c dyn Comm) -> LocalBoxFuture<'c, ()> + Send>;

/// The object's end.
pub(crate) struct Relay {
    orders: mpsc::UnboundedSender<Order>,
    daemons: Vec<String>,
    retries: u32,
    is_in_app: bool,
}

/// The task's end.
pub(crate) struct Orders(mpsc::UnboundedReceiver<Order>);

/// Both ends, of which the second asks by `comm`.
pub(crate) fn relay(comm: &dyn Comm) -> (Relay, Orders) {
    let (orders, taken) = mpsc::unbounded_channel();
    let relay = Relay {
        orders,
        daemons: comm.daemons(),
        retries: comm.retries(),
        is_in_app: comm.is_in_app(),
    };
    (relay, Orders(taken))
}

impl Orders {
    /// Asks what the object wants asked, in its order, until the object is done.
    pub(crate) async fn serve(mut self, comm: &dyn Comm) {
        let mut under_way = FuturesUnordered::new();
        loop {
            tokio::select! {
                biased;
                order = self.0.recv() => match order {
                    Some(order) => under_way.push(order(comm)),
                    None => return,
                },
                Some(()) = under_way.next() => {}
            }
        }
    }
}

impl Relay {
    /// Runs on this thread, while the task's end is there, what asks by this one.
    pub(crate) fn run(&self, call: impl Future<Output = ()>) {
        let task_ends = self.orders.closed();
        Handle::current().block_on(select(pin!(call), pin!(task_ends)));
    }

    async fn relayed<T: Send + 'static>(
        &self,
        ask: impl for<'c> FnOnce(&'c dyn Comm) -> LocalBoxFuture<'c, T> + Send + 'static,
    ) -> Result<T, Report> {
        let (mut to, answer) = oneshot::channel();
        let order: Order = Box::new(move |comm| {
            let asked = ask(comm);
            Box::pin(async move {
                tokio::select! {
                    biased;
                    answer = asked => {
                        // The caller may have stopped listening just now.
                        let _ = to.send(answer);
                    }
                    () = to.closed() => {}
                }
            })
        });
        let sent = self.orders.send(order);
        let gone = || raise!(code::BUSY, "the task that serves this object has ended");
        sent.map_err(|_| gone())?;
        answer.await.map_err(|_| gone())
    }

    /// [`Self::relayed`] for what may fail itself.
    async fn tried<T: Send + 'static>(
        &self,
        ask: impl for<'c> FnOnce(&'c dyn Comm) -> Answer<'c, T> + Send + 'static,
    ) -> Result<T, Report> {
        self.relayed(ask).await?
    }
}

impl Comm for Relay {
    fn ask<'a>(&'a self, at: &'a Location, request: Request) -> Answer<'a, Transport> {
        let at = at.clone();
        Box::pin(self.tried(|comm| Box::pin(async move { comm.ask(&at, request).await })))
    }

    fn sleep(&self, time: Duration) -> LocalBoxFuture<'_, ()> {
        Box::pin(async move {
            if self.relayed(move |comm| comm.sleep(time)).await.is_err() {
                // The task has ended, and with it this call.
                pending::<()>().await;
            }
        })
    }

    fn ask_once<'a>(
        &'a self,
        at: &'a Location,
        request: Request,
    ) -> LocalBoxFuture<'a, Result<Transport, NoAnswer>> {
        let at = at.clone();
        Box::pin(async move {
            let asked =
                self.relayed(|comm| Box::pin(async move { comm.ask_once(&at, request).await }));
            asked.await.unwrap_or_else(|report| {
                Err(NoAnswer {
                    report,
                    perhaps_executed: true,
                })
            })
        })
    }

    fn retries(&self) -> u32 {
        self.retries
    }

    fn tell<'a>(&'a self, at: &'a Location, request: Request) -> Answer<'a, ()> {
        let at = at.clone();
        Box::pin(self.tried(|comm| Box::pin(async move { comm.tell(&at, request).await })))
    }

    fn spawn(&self, job: Job) -> Result<(), Report> {
        let order: Order = Box::new(|comm| {
            if let Err(report) = comm.spawn(job) {
                tracing::warn!(error = %report, "work that was begun beside a call is not done");
            }
            Box::pin(std::future::ready(()))
        });
        let sent = self.orders.send(order);
        sent.map_err(|_| raise!(code::BUSY, "the task that serves this object has ended"))
    }

    fn daemons(&self) -> Vec<String> {
        self.daemons.clone()
    }

    fn subscribe<'a>(
        &'a self,
        at: &'a Location,
        name: &'a ObjectName,
        keep: Keep,
    ) -> Answer<'a, (u64, u64)> {
        let (at, name) = (at.clone(), name.clone());
        Box::pin(
            self.tried(move |comm| Box::pin(async move { comm.subscribe(&at, &name, keep).await })),
        )
    }

    fn take<'a>(
        &'a self,
        at: &'a Location,
        name: &'a ObjectName,
        subscriber: u64,
        after: u64,
    ) -> Answer<'a, Taken> {
        let (at, name) = (at.clone(), name.clone());
        Box::pin(self.tried(move |comm| {
            Box::pin(async move { comm.take(&at, &name, subscriber, after).await })
        }))
    }

    fn leave<'a>(&'a self, at: &'a Location, subscriber: u64) -> LocalBoxFuture<'a, ()> {
        let at = at.clone();
        Box::pin(async move {
            let left = self
                .relayed(move |comm| Box::pin(async move { comm.leave(&at, subscriber).await }));
            // A task that has ended holds no subscription.
            let _ = left.await;
        })
    }

    fn back<'a>(&'a self, at: &'a Location) -> Answer<'a, ()> {
        let at = at.clone();
        Box::pin(self.tried(|comm| Box::pin(async move { comm.back(&at).await })))
    }

    fn is_in_app(&self) -> bool {
        self.is_in_app
    }

    fn tasks_of<'a>(&'a self, handler: &'a str) -> Answer<'a, Vec<String>> {
        let handler = handler.to_owned();
        Box::pin(self.tried(move |comm| Box::pin(async move { comm.tasks_of(&handler).await })))
    }

    fn call_task<'a>(
        &'a self,
        task: &'a str,
        command: CommandInfo,
        data: Vec<u8>,
        deadline: Duration,
    ) -> Answer<'a, Vec<u8>> {
        let task = task.to_owned();
        Box::pin(self.tried(move |comm| {
            Box::pin(async move { comm.call_task(&task, command, data, deadline).await })
        }))
    }
}
