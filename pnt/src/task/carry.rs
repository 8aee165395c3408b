//! Transfers to other nets, over messages: sent again until the other net says that it has them.

use std::{
    collections::{BTreeMap, VecDeque},
    rc::Rc,
    time::Duration,
};

use ctos::{
    call::{CallError, Fault},
    task::{Context, NameError},
};

use super::{
    engine::Engine,
    messages::{Tokens, Transfer},
    settings::settings,
    transfers::Ready,
};
use crate::net::RemoteArc;

/// The wait before transfers that were not taken are sent again; it doubles up to the longest.
const FIRST_PAUSE: Duration = Duration::from_millis(20);
const LONGEST_PAUSE: Duration = Duration::from_secs(2);

/// How long a net is waited for that is not there, before it is looked for again.
const COME_BACK: Duration = Duration::from_secs(5);

/// The nets to which something was carried, by name.
#[derive(Default)]
pub(super) struct Carrying {
    /// In the order of their first transfers; they are few.
    partners: Vec<(String, Partner)>,
}

/// One of them.
#[derive(Default)]
struct Partner {
    /// Whether a child carries to it now.
    busy: bool,
    /// Whether it survives its process, once somebody has looked.
    durable: Option<bool>,
    /// The contexts of transfers on their way, by number, oldest first.
    traces: VecDeque<(u64, Context)>,
}

impl Carrying {
    fn partner(&mut self, net: &str) -> &mut Partner {
        let known = self.partners.iter().position(|(name, _)| name == net);
        let index = known.unwrap_or_else(|| {
            self.partners.push((net.to_owned(), Partner::default()));
            self.partners.len() - 1
        });
        &mut self.partners[index].1
    }
}

/// Why transfers were not taken.
pub(super) enum Failed {
    /// They may be taken when they are sent again.
    NotNow,
    /// They never will.
    Never(String),
}

impl<S: 'static> Engine<S> {
    /// Keeps tokens for their nets: one transfer for each net, so that tokens of one firing arrive
    /// together.
    pub(super) fn post(self: &Rc<Self>, cx: &Context, remote: &[RemoteArc]) {
        let mut per_net: BTreeMap<&str, Vec<(String, u32)>> = BTreeMap::new();
        for arc in remote {
            let tokens = per_net.entry(&arc.net).or_default();
            tokens.push((arc.place.clone(), arc.weight));
        }
        for (net, tokens) in per_net {
            let symbol = None;
            self.post_to(cx, net, Transfer { tokens, symbol });
        }
    }

    /// Keeps a transfer, which goes when the change that it came with is stored.
    pub(super) fn post_to(self: &Rc<Self>, cx: &Context, net: &str, transfer: Transfer) {
        {
            let mut core = self.core.borrow_mut();
            let change = core.changes;
            let number = core.transfers.post(net, transfer, change);
            let partner = core.carrying.partner(net);
            partner.traces.push_back((number, cx.clone()));
        }
        let net = net.to_owned();
        self.when_stored(move |engine| engine.carry_to(&net));
    }

    /// Sees to it that a child carries to a net.
    pub(super) fn carry_to(self: &Rc<Self>, net: &str) {
        let mut core = self.core.borrow_mut();
        if !std::mem::replace(&mut core.carrying.partner(net).busy, true) {
            let (engine, net) = (Rc::clone(self), net.to_owned());
            self.cx.spawn(async move { engine.carry(net).await });
        }
    }

    /// Carries to one net until nothing is left for it.
    async fn carry(self: Rc<Self>, net: String) {
        let mut pause = FIRST_PAUSE;
        let durable = {
            let partner = &mut self.core.borrow_mut().carrying;
            let durable = &mut partner.partner(&net).durable;
            *durable.get_or_insert_with(|| is_durable(&self.cx, &net))
        };
        loop {
            let stored = self.durable.stored();
            let next = {
                let mut core = self.core.borrow_mut();
                let ready = core.transfers.ready(&net, stored);
                let partner = core.carrying.partner(&net);
                partner.busy = ready.is_some();
                ready.map(|ready| {
                    let oldest = partner.traces.front();
                    let of_first = oldest.filter(|(number, _)| *number == ready.first);
                    let cx = of_first.map(|(_, cx)| cx.clone());
                    (ready, cx)
                })
            };
            let Some((ready, cx)) = next else { return };
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

    /// The other net has all up to a number. What is not stored of that is told again, and known.
    fn arrived(self: &Rc<Self>, net: &str, last: u64) -> bool {
        let news = {
            let mut core = self.core.borrow_mut();
            let news = core.transfers.arrived(net, last);
            let traces = &mut core.carrying.partner(net).traces;
            while traces.front().is_some_and(|(number, _)| *number <= last) {
                traces.pop_front();
            }
            if news {
                core.changes += 1;
            }
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
            cx.task(net).await
        };
        let to = found.map_err(|error| match error {
            NameError::NotYet { .. } => Failed::NotNow,
            NameError::Service(error) => may_succeed(&error, durable),
            error => Failed::Never(error.to_string()),
        })?;
        let message = Tokens {
            from: self.net().name().to_owned(),
            stream,
            first,
            transfers,
        };
        let answer = cx.call(&to, message).await;
        answer.map_err(|error| may_succeed(&error, durable))
    }
}

/// Whether the net of a task goes on where it was when its process has died.
pub(super) fn is_durable(cx: &Context, net: &str) -> bool {
    let task = cx.app().task(net);
    task.is_some_and(|task| settings(task).is_ok_and(|settings| settings.durable))
}

/// Whether a call that failed may succeed when it is made again. A net that is not durable has lost its
/// marking with its handler: sending it more would only hide that.
pub(super) fn may_succeed(error: &CallError, durable: bool) -> Failed {
    match error.fault {
        Fault::Refused { .. } | Fault::BadPayload { .. } | Fault::UnknownCommand { .. } => {
            Failed::Never(error.to_string())
        }
        Fault::PeerDown { .. } | Fault::UnknownTask | Fault::Stopping | Fault::Panicked { .. }
            if !durable =>
        {
            Failed::Never(error.to_string())
        }
        _ => Failed::NotNow,
    }
}
