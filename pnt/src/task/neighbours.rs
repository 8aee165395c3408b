//! Tokens for a net on the same processor: put there at once, without a message. The two nets are parts of one
//! thread, so that nothing can be lost on the way, and what the receiver has it need not acknowledge. It goes
//! on with its firings in the turn of a child of its own, which the sender lets it have as soon as it has nothing
//! left to fire itself, or which comes like any other (see [`Context::give_turn`]). What comes back meanwhile the
//! sender goes on with itself, so that tokens that go to and fro need no turns within turns within turns. Transfers
//! are counted as if they had been sent, so that those which are messages follow without a gap.
//!
//! A transfer goes as a message all the same where one of the nets is durable, where earlier ones are on their way,
//! while something is recorded (a record is to show who sent what to whom), and where the receiver does not
//! take it now: then its answer says why, or it is sent again. In virtual time all are messages, so that a run
//! with some seed is the same when it is run again to be recorded.

use std::{
    cell::Cell,
    future::poll_fn,
    rc::{Rc, Weak},
    sync::Arc,
    task::Poll,
};

use ctos::{
    task::{Child, Context},
    time::Instant,
};

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

    /// Goes on with what it has taken, within the turn of who asks for it if that may be.
    fn goes_on_within(&self, cx: &Context);
}

/// How nets find each other on their processor.
type Shown = Weak<dyn Neighbour>;

fn key(net: &str) -> String {
    format!("net {net}")
}

/// What has come from nets beside this one, and the child that goes on with it.
#[derive(Default)]
pub(super) struct Coming {
    /// The trace of the latest of what nobody has gone on with yet.
    news: Option<u64>,
    child: Option<Rc<Child>>,
}

/// While this is there, the net is at work and looks for news before it ends.
pub(super) struct AtWork<'e> {
    now: &'e Cell<bool>,
    before: bool,
}

impl Drop for AtWork<'_> {
    fn drop(&mut self) {
        self.now.set(self.before);
    }
}

/// The net that another name belongs to, where it is on this processor.
#[derive(Default)]
pub(super) struct Known(Option<Shown>);

impl Known {
    /// The net, looked for anew when it has ended.
    #[inline]
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
    pub(super) fn put_beside(&self, cx: &Context, net: &Arc<str>, transfer: &Transfer) -> bool {
        if !self.puts_beside.get() || self.durable.is_kept() || cx.is_recording() {
            return false;
        }
        // Borrowed until the other net has it or not: a net that sends to itself does not take it so.
        let core = &mut *self.core.borrow_mut();
        let Some(neighbour) = core.carrying.neighbour(&self.cx, net) else {
            return false;
        };
        let at = core.journal.stream.at();
        let taken = core.transfers.pass(net, |stream, number| {
            Rc::clone(&neighbour).takes(&Comes {
                from: &self.name,
                stream,
                number,
                transfer,
                at,
                trace: cx.trace(),
            })
        });
        if taken {
            core.carrying.goes_on(neighbour);
        }
        taken
    }

    /// Until the guard is dropped, nobody is woken for what comes.
    pub(super) fn at_work(&self) -> AtWork<'_> {
        let now = &self.at_work;
        let before = now.replace(true);
        AtWork { now, before }
    }

    /// Sees to it that somebody goes on with what has come: who is at work, or a child.
    fn go_on(self: &Rc<Self>) {
        if self.at_work.get() {
            return;
        }
        let coming = &mut self.core.borrow_mut().coming;
        if let Some(child) = &coming.child {
            return child.wake();
        }
        let engine = Rc::clone(self);
        let child = self.cx.spawn_child(async move { engine.goes_on().await });
        coming.child = Some(Rc::new(child));
    }

    async fn goes_on(self: Rc<Self>) {
        loop {
            let cx = poll_fn(|_| self.news().map_or(Poll::Pending, Poll::Ready)).await;
            self.advance(&cx);
        }
    }

    /// Where what has come belongs to, if there is anything that nobody has gone on with.
    pub(super) fn news(&self) -> Option<Context> {
        let news = self.core.borrow_mut().coming.news.take();
        news.map(|trace| match trace {
            0 => self.cx.new_trace(),
            trace => self.cx.within(trace),
        })
    }

    /// The nets that something was put into go on, those first that were the first to get something.
    pub(super) fn let_neighbours_go_on(&self) {
        loop {
            let next = self.core.borrow_mut().carrying.next_to_go_on();
            let Some(neighbour) = next else { return };
            neighbour.goes_on_within(&self.cx);
        }
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

    fn goes_on_within(&self, cx: &Context) {
        if self.at_work.get() {
            return;
        }
        let child = self.core.borrow().coming.child.clone();
        if let Some(child) = child {
            cx.give_turn(&child);
        }
    }
}
