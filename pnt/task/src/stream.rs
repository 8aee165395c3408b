//! What a net does, as one stream of numbered events. A follower knows the marking at every moment
//! (architecture report, section 6: displays are connected to subnets many to many).
//!
//! A net's task answers [`Describe`] with what does not change ([`NetView`]). It answers [`Follow`] with
//! what does: a [`State`] once, then the [`Event`]s after it, numbered without a gap. A follower asks again
//! when it has taken in the last [`Batch`]. So a slow display is not pressed, and a stuck one costs nothing.
//! A net answers at most every few milliseconds, to all at once, with at most [`MOST_EVENTS`] events each. A
//! follower further behind gets a new state and the number of events that it missed.
//!
//! The page, the terminal, the record of a run and what is drawn from a record all live on these types.
//! They know no screen.

mod event;
mod replica;
mod source;
mod standing;
pub(crate) mod view;

#[cfg(test)]
mod tests;

use std::sync::Arc;

use serde::{Deserialize, Serialize};

pub use event::{Event, EventPhase, Running, Sent, State};
pub use replica::{Replica, ReplicaError};
pub(crate) use source::{Changed, Happened, Source};
pub use standing::Standing;
pub use view::{
    ArcView, CommandView, DataView, NetView, PinView, PlaceView, RemoteView, RouteView, Side,
    TransitionView,
};

/// The most events of one [`Batch`].
pub const MOST_EVENTS: usize = 256;

/// The longest that a net waits for something to happen before it answers, ms.
pub const MOST_PATIENCE_MS: u32 = 5_000;

/// The most that may follow one net at a time.
pub const MOST_FOLLOWERS: usize = 256;

/// A moment of one run of a net's task.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Mark {
    /// Which run: when its task began, ns since the start of the app. A restarted task begins another.
    pub run: u64,
    /// The last event before the moment; 0 before the first.
    pub seq: u64,
}

/// What happened since a [`Mark`].
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Batch {
    /// Where the stream is after this: what to ask from next.
    pub mark: Mark,
    /// The net as it is at `mark`, for those that are new or too far behind; `events` is empty then.
    pub state: Option<State>,
    /// Events between the mark that was asked for and that of `state`.
    pub skipped: u64,
    /// The events, in order.
    #[serde(with = "shared")]
    pub events: Arc<Vec<Event>>,
}

ctos::command! {
    /// Shows the net's places, transitions and arcs
    #[derive(Debug, Clone, PartialEq, Eq)]
    pub struct Describe => NetView, 0x0040, "describe_net"
}

ctos::command! {
    /// Shows what the net did since a moment, and waits until there is something
    #[derive(Debug, Clone, PartialEq, Eq)]
    pub struct Follow {
        /// The moment; none: from now on.
        pub after: Option<Mark>,
        /// How long to wait for something to happen, ms; at most [`MOST_PATIENCE_MS`].
        pub patience_ms: u32,
    } => Batch, 0x0041, "follow"
}

/// One list for all who follow, encoded like any other.
mod shared {
    use std::sync::Arc;

    use serde::{Deserialize, Deserializer, Serialize, Serializer};

    use super::Event;

    pub(super) fn serialize<S: Serializer>(
        events: &Arc<Vec<Event>>,
        serializer: S,
    ) -> Result<S::Ok, S::Error> {
        events.as_slice().serialize(serializer)
    }

    pub(super) fn deserialize<'de, D: Deserializer<'de>>(
        deserializer: D,
    ) -> Result<Arc<Vec<Event>>, D::Error> {
        Vec::deserialize(deserializer).map(Arc::new)
    }
}
