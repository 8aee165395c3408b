//! Transfers to other nets, over messages: sent again until the other net says that it has them.

use std::{
    future::poll_fn,
    rc::Rc,
    sync::Arc,
    task::{Poll, Waker},
    time::Duration,
};

use ctos::task::{Context, NameError};

use super::{
    carrying::Carrier,
    engine::Engine,
    messages::{Tokens, Transfer},
    other::{Failed, is_durable, may_succeed},
    routes::Bundle,
    transfers::Ready,
};

/// The wait before transfers that were not taken are sent again; it doubles up to the longest.
const FIRST_PAUSE: Duration = Duration::from_millis(20);
const LONGEST_PAUSE: Duration = Duration::from_secs(2);

/// How long a net waits for another one that is not there, before it looks again.
const COME_BACK: Duration = Duration::from_secs(5);

impl Engine {
    /// Sends tokens to their nets.
    pub(super) fn post(self: &Rc<Self>, cx: &Context, bundle: &Bundle) {
        for route in bundle.iter() {
            self.post_to(cx, &route.net, &route.transfer);
        }
    }

    /// Keeps a transfer for a net; it goes when the change that it came with is stored.
    pub(super) fn post_to(self: &Rc<Self>, cx: &Context, net: &Arc<str>, transfer: &Arc<Transfer>) {
        {
            let mut core = self.core.borrow_mut();
            let change = core.changes;
            let number = core.transfers.post(net, Arc::clone(transfer), change);
            let partner = core.carrying.partners.of(net);
            partner.traces.push_back((number, cx.clone()));
        }
        let net = Arc::clone(net);
        self.when_stored(move |engine| engine.carry_to(&net));
    }

    /// Sees to it that a child carries to a net.
    pub(super) fn carry_to(self: &Rc<Self>, net: &Arc<str>) {
        let mut core = self.core.borrow_mut();
        let carrier = &mut core.carrying.partners.of(net).carrier;
        match std::mem::replace(carrier, Carrier::Busy) {
            Carrier::None => {
                let (engine, net) = (Rc::clone(self), Arc::clone(net));
                self.cx.spawn(async move { engine.carry(net).await });
            }
            Carrier::Waiting(waker) => waker.wake(),
            Carrier::Busy => {}
        }
    }

    /// What can be sent to a net next, with the context that the first of it belongs to. Where there is
    /// nothing, [`Self::carry_to`] wakes who waits for it.
    fn next_ready(&self, net: &Arc<str>, waiting: &Waker) -> Poll<(Ready, Option<Context>)> {
        let stored = self.durable.stored();
        let mut core = self.core.borrow_mut();
        let ready = core.transfers.ready(net, stored);
        let partner = core.carrying.partners.of(net);
        let Some(ready) = ready else {
            partner.carrier = Carrier::Waiting(waiting.clone());
            return Poll::Pending;
        };
        let oldest = partner.traces.front();
        let of_first = oldest.filter(|(number, _)| *number == ready.first);
        let cx = of_first.map(|(_, cx)| cx.clone());
        Poll::Ready((ready, cx))
    }

    /// Carries to one net whatever there is for it.
    async fn carry(self: Rc<Self>, net: Arc<str>) {
        let mut pause = FIRST_PAUSE;
        let durable = {
            let partners = &mut self.core.borrow_mut().carrying.partners;
            let durable = &mut partners.of(&net).durable;
            *durable.get_or_insert_with(|| is_durable(&self.cx, &net))
        };
        loop {
            let (ready, cx) = poll_fn(|task| self.next_ready(&net, task.waker())).await;
            let wanted = ready.transfers.len() as u64;
            let first = ready.first;
            match self
                .deliver(&cx.unwrap_or_else(|| self.cx.clone()), &net, durable, ready)
                .await
            {
                Ok(last) => {
                    let news = self.arrived(&net, last);
                    if news {
                        pause = FIRST_PAUSE;
                    }
                    if last + 1 >= first + wanted {
                        continue;
                    }
                }
                Err(Failed::NotNow) => {}
                Err(Failed::Never(error)) => {
                    return self.halt(&format!(
                        "a token could not be carried to net `{net}`: {error}"
                    ));
                }
            }
            if self.core.borrow().halted.is_some() {
                return;
            }
            self.cx.sleep(pause).await;
            pause = (pause * 2).min(LONGEST_PAUSE);
        }
    }

    /// The other net has all up to a number. If a crash takes that back, the other net says it
    /// again and takes nothing twice.
    fn arrived(self: &Rc<Self>, net: &Arc<str>, last: u64) -> bool {
        let news = {
            let mut core = self.core.borrow_mut();
            let news = core.transfers.arrived(net, last);
            let traces = &mut core.carrying.partners.of(net).traces;
            while traces.front().is_some_and(|(number, _)| *number <= last) {
                traces.pop_front();
            }
            if news {
                core.changes += 1;
            }
            core.requests.look_again();
            news
        };
        self.store_changes();
        news
    }

    async fn deliver(
        &self,
        cx: &Context,
        net: &str,
        durable: bool,
        ready: Ready,
    ) -> Result<u64, Failed> {
        let Ready {
            stream,
            first,
            transfers,
        } = ready;
        // A task of the app that is not there now is being started again.
        let found = if durable {
            cx.wait_for_task(net, COME_BACK).await
        } else {
            // Its next life would not know what the tokens are about.
            cx.task(net).deadline(Duration::ZERO).await
        };
        let to = found.map_err(|error| match error {
            NameError::NotYet { .. } => Failed::NotNow,
            NameError::Service(error) => may_succeed(&error, durable),
            error => Failed::Never(error.to_string()),
        })?;
        let message = Tokens {
            from: Arc::clone(&self.name),
            stream,
            first,
            transfers,
        };
        let answer = cx.call(&to, message).await;
        answer.map_err(|error| may_succeed(&error, durable))
    }
}
