//! A daemon's subscribers: what is kept for each until it says that it has arrived.

use super::protocol::{VERSION, same_version};
use crate::name::ObjectName;
use crate::results::{Keep, Sample, Tap};
use crate::sorm::Sorm;
use crate::stream::BATCH;
use ctos::message::Command;
use ctos::task::{Context, HandlerError};
use ctos::time::Instant;
use serde::{Deserialize, Serialize};
use std::cell::RefCell;
use std::collections::BTreeMap;
use std::rc::Rc;
use std::sync::Arc;
use std::time::Duration;

/// How long a question for results waits for one.
const WAIT: Duration = Duration::from_secs(5);

/// How long a subscriber waits for the answer to that.
pub(super) const PATIENCE: Duration = Duration::from_secs(15);

/// A subscriber that has not asked for so long is dead.
const LEASE: Duration = Duration::from_secs(60);

/// No more subscribers than this.
const MOST: usize = 10_000;

/// About how much one answer holds, bytes; it holds one result of any size.
const ANSWER: usize = 1 << 20;

/// Subscribes to the results of an object; answers the number of the subscription, and that of the last
/// result before it.
#[derive(Debug, Serialize, Deserialize, Command)]
#[command(name = "subscribe", reply = (u64, u64), code = 0x0010)]
pub struct Subscribe {
    version: u32,
    /// The object, by its local name.
    object: String,
    keep: Keep,
    /// Who subscribes.
    from: String,
}

impl Subscribe {
    pub(super) fn new(object: &ObjectName, keep: Keep, from: String) -> Self {
        Self {
            version: VERSION,
            object: object.to_string(),
            keep,
            from,
        }
    }
}

/// Waits a while for results of an object that was subscribed to. Nothing is answered to a subscription
/// that is not known.
#[derive(Debug, Serialize, Deserialize, Command)]
#[command(name = "take", reply = Option<Vec<Sample>>, code = 0x0011)]
pub struct Take {
    /// The number of the subscription.
    pub subscriber: u64,
    /// The last result that has arrived.
    pub after: u64,
}

/// Ends a subscription.
#[derive(Debug, Serialize, Deserialize, Command)]
#[command(name = "leave", code = 0x0012)]
pub struct Leave {
    /// The number of the subscription.
    pub subscriber: u64,
}

/// Those who subscribe to objects of a daemon.
#[derive(Default)]
pub(super) struct Subscribers {
    state: RefCell<State>,
}

#[derive(Default)]
struct State {
    last: u64,
    known: BTreeMap<u64, Subscriber>,
}

struct Subscriber {
    tap: Rc<Tap>,
    from: String,
    heard: Instant,
}

impl Subscribers {
    pub(super) fn add(
        self: &Rc<Self>,
        sorm: &Sorm,
        cx: &Context,
        request: &Subscribe,
    ) -> Result<(u64, u64), HandlerError> {
        same_version(request.version)?;
        let name: ObjectName = request.object.parse()?;
        let tap = sorm.tap(&name, request.keep)?;
        let begun = tap.begun();
        let mut state = self.state.borrow_mut();
        if state.known.len() >= MOST {
            return Err(HandlerError::new(format!(
                "there are {MOST} subscribers already; that is the most"
            )));
        }
        state.last += 1;
        let number = state.last;
        let subscriber = Subscriber {
            tap: Rc::new(tap),
            from: request.from.clone(),
            heard: cx.now(),
        };
        state.known.insert(number, subscriber);
        drop(state);
        self.watch(cx, number);
        Ok((number, begun))
    }

    /// Forgets the subscriber when it is dead.
    fn watch(self: &Rc<Self>, cx: &Context, number: u64) {
        let (all, here) = (Rc::downgrade(self), cx.clone());
        cx.spawn(async move {
            let mut left = LEASE;
            loop {
                here.sleep(left).await;
                let Some(all) = all.upgrade() else { return };
                let mut state = all.state.borrow_mut();
                let Some(subscriber) = state.known.get(&number) else {
                    return;
                };
                let silent = here.now().since(subscriber.heard);
                if silent >= LEASE {
                    tracing::warn!(subscriber = subscriber.from, "a subscriber is forgotten");
                    state.known.remove(&number);
                    return;
                }
                left = LEASE - silent;
            }
        });
    }

    /// What is kept for a subscriber; waits for something for a while.
    pub(super) async fn take(&self, cx: &Context, request: &Take) -> Option<Vec<Sample>> {
        let tap = self.heard(cx, request.subscriber)?;
        let _ = cx.timeout(WAIT, tap.wait(request.after)).await;
        // It may have ended meanwhile.
        let _ = self.heard(cx, request.subscriber)?;
        let mut size = 0;
        let samples = tap.after(request.after, BATCH);
        let fitting = samples
            .into_iter()
            .enumerate()
            .take_while(|(index, sample)| {
                let body = &sample.body;
                size += body.text.len() + body.opaque.len();
                size += 8 * (body.floats.len() + body.ints.len());
                *index == 0 || size <= ANSWER
            });
        Some(
            fitting
                .map(|(_, sample)| Arc::unwrap_or_clone(sample))
                .collect(),
        )
    }

    fn heard(&self, cx: &Context, number: u64) -> Option<Rc<Tap>> {
        let mut state = self.state.borrow_mut();
        let subscriber = state.known.get_mut(&number)?;
        subscriber.heard = cx.now();
        Some(Rc::clone(&subscriber.tap))
    }

    pub(super) fn leave(&self, number: u64) {
        self.state.borrow_mut().known.remove(&number);
    }

    /// Forgets the subscribers whose callers' names end so.
    pub(super) fn gone(&self, suffix: &str) {
        let known = &mut self.state.borrow_mut().known;
        known.retain(|_, subscriber| !subscriber.from.ends_with(suffix));
    }
}
