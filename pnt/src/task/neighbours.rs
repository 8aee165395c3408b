//! Tokens for a net on the same processor: put there at once, without a message. The two nets are parts of one
//! thread, so that nothing can be lost on the way, and what the receiver has it need not acknowledge; it goes
//! on with its firings in a turn of its own, as after a message. Transfers are counted as if they had been sent, so
//! that those which are messages follow without a gap.
//!
//! A transfer goes as a message all the same where one of the nets is durable, where earlier ones are on their way,
//! while something is recorded (a record is to show who sent what to whom), and where the receiver does not
//! take it now: then its answer says why, or it is sent again. In virtual time all are messages, so that a run
//! with some seed is the same when it is run again to be recorded.

use std::{
    future::poll_fn,
    rc::{Rc, Weak},
    sync::Arc,
    task::{Poll, Waker},
};

use ctos::{task::Context, time::Instant};

use super::{engine::Engine, messages::Transfer};

/// A transfer from a net beside this one.
pub(super) struct Comes<'a> {
    pub(super) from: &'a Arc<str>,
    /// The stream of the sender, and the number of this transfer in it.
    pub(super) stream: u64,
    pub(super) number: u64,
    pub(super) transfer: &'a Transfer,
    /// When the sender noted what led to it.
    pub(super) at: Instant,
    /// The trace that it belongs to; 0 for none.
    pub(super) trace: u64,
}

/// A net as those on its processor see it.
pub(super) trait Neighbour {
    /// Takes a transfer, or leaves everything as it is.
    fn takes(self: Rc<Self>, comes: &Comes<'_>) -> bool;
}

/// How nets find each other on their processor.
type Shown = Weak<dyn Neighbour>;

fn key(net: &str) -> String {
    format!("net {net}")
}

/// What has come from nets beside this one, and the child that goes on with it.
#[derive(Default)]
pub(super) struct Coming {
    /// The trace of the latest of what the child has not seen yet.
    news: Option<u64>,
    child: Option<Waker>,
    is_spawned: bool,
}

/// The net that another name belongs to, where it is on this processor.
#[derive(Default)]
pub(super) struct Known(Option<Shown>);

impl Known {
    /// The net, looked for anew when it has ended.
    pub(super) fn find(&mut self, cx: &Context, net: &str) -> Option<Rc<dyn Neighbour>> {
        let known = self.0.as_ref().and_then(Weak::upgrade);
        known.or_else(|| {
            self.0 = cx.beside::<Shown>(&key(net));
            self.0.as_ref().and_then(Weak::upgrade)
        })
    }
}

impl<S: 'static> Engine<S> {
    /// Shows this net to those on its processor.
    pub(super) fn show_beside(self: &Rc<Self>) {
        if !self.durable.is_kept() {
            let this: Weak<Self> = Rc::downgrade(self);
            let shown: Shown = this;
            self.cx.show_beside(&key(self.cx.name()), shown);
        }
    }

    /// Puts a transfer into a net on this processor; false when it must be a message.
    pub(super) fn put_beside(&self, cx: &Context, net: &str, transfer: &Transfer) -> bool {
        // A net that sends to itself is not called from within itself.
        let is_own = net == self.cx.name();
        if !self.puts_beside.get() || self.durable.is_kept() || cx.is_recording() || is_own {
            return false;
        }
        let (neighbour, comes) = {
            let mut core = self.core.borrow_mut();
            let Some(neighbour) = core.carrying.neighbour(&self.cx, net) else {
                return false;
            };
            let Some(number) = core.transfers.next(net) else {
                return false;
            };
            let comes = Comes {
                from: &self.name,
                stream: core.transfers.stream(),
                number,
                transfer,
                at: core.journal.stream.at(),
                trace: cx.trace(),
            };
            (neighbour, comes)
        };
        let taken = neighbour.takes(&comes);
        if taken {
            self.core.borrow_mut().transfers.passed(net, comes.number);
        }
        taken
    }

    /// Sees to it that a child goes on with what has come.
    fn go_on(self: &Rc<Self>) {
        let coming = &mut self.core.borrow_mut().coming;
        if let Some(child) = &coming.child {
            return child.wake_by_ref();
        }
        if !std::mem::replace(&mut coming.is_spawned, true) {
            let engine = Rc::clone(self);
            self.cx.spawn(async move { engine.goes_on().await });
        }
    }

    async fn goes_on(self: Rc<Self>) {
        loop {
            let trace = poll_fn(|task| self.news(task.waker())).await;
            let cx = match trace {
                0 => self.cx.new_trace(),
                trace => self.cx.within(trace),
            };
            self.advance(&cx);
        }
    }

    fn news(&self, waker: &Waker) -> Poll<u64> {
        let coming = &mut self.core.borrow_mut().coming;
        if let Some(trace) = coming.news.take() {
            return Poll::Ready(trace);
        }
        match &mut coming.child {
            Some(child) => child.clone_from(waker),
            None => coming.child = Some(waker.clone()),
        }
        Poll::Pending
    }
}

impl<S: 'static> Neighbour for Engine<S> {
    fn takes(self: Rc<Self>, comes: &Comes<'_>) -> bool {
        let Comes {
            from,
            stream,
            number,
            transfer,
            at,
            trace,
        } = *comes;
        {
            let Ok(mut core) = self.core.try_borrow_mut() else {
                return false;
            };
            let is_next = core.transfers.known(from, stream, number) == Ok(0);
            if core.halted.is_some() || !is_next {
                return false;
            }
            let Ok(Some(put)) = core.take_in(transfer, self.settings.tape) else {
                return false;
            };
            core.has_taken((from, stream, number), (transfer, put), |core, what| {
                self.note_at(core, (at, trace), &self.cx, what);
            });
            core.coming.news = Some(trace);
        }
        self.go_on();
        true
    }
}
