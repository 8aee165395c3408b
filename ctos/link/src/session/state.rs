//! The states of a session as a table, which is also drawn into `docs/links.md`.
//!
//! Knows no stream, no clock and no frame: what moves the session comes as an event.

use std::time::Duration;

/// Where a session with one peer stands.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum State {
    /// No stream has been had yet.
    Waiting,
    /// A stream carries frames.
    Up,
    /// The stream broke; what is under way is kept, and the mesh looks for a new stream.
    Broken,
    /// The peer's process has ended; what it still said is read.
    Draining,
    /// This end is done; the last frames go out.
    Closing,
    /// For good.
    Down,
}

/// What happens to a session.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Event {
    /// Both ends have shaken hands over a stream.
    Attached,
    /// The stream ended or failed.
    StreamLost,
    /// Nothing was heard for the configured time, or no stream was had for that long.
    Silence,
    /// The peer's process has ended: its parent or the system says so.
    PeerEnded,
    /// The peer said that it ends, after its last frame.
    Bye,
    /// The peer told that it has given this end up.
    GivenUp,
    /// The peer sent what no peer may send.
    Rubbish,
    /// This end wants to end.
    Close,
    /// Everything that was posted has arrived.
    Flushed,
}

#[cfg(test)]
impl State {
    pub const ALL: [Self; 6] = [
        Self::Waiting,
        Self::Up,
        Self::Broken,
        Self::Draining,
        Self::Closing,
        Self::Down,
    ];

    fn name(self) -> &'static str {
        match self {
            Self::Waiting => "waiting",
            Self::Up => "up",
            Self::Broken => "broken",
            Self::Draining => "draining",
            Self::Closing => "closing",
            Self::Down => "down",
        }
    }
}

#[cfg(test)]
impl Event {
    fn name(self) -> &'static str {
        match self {
            Self::Attached => "attached",
            Self::StreamLost => "stream lost",
            Self::Silence => "silence",
            Self::PeerEnded => "peer ended",
            Self::Bye => "bye",
            Self::GivenUp => "given up",
            Self::Rubbish => "rubbish",
            Self::Close => "close",
            Self::Flushed => "flushed",
        }
    }
}

/// Why a session is down.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum DownReason {
    /// Nothing was heard for so long.
    #[error("nothing was heard of it for {:.3} s", .0.as_secs_f64())]
    Silence(Duration),
    /// The peer's process has ended.
    #[error("its process has ended")]
    Ended,
    /// Nobody listens where the peer did; what the system says.
    #[error("nobody listens there any more: {0}")]
    Deserted(String),
    /// Another chassis, or another life of this one, answers where the peer did.
    #[error("another chassis answers there")]
    Replaced,
    /// The peer said that it ends.
    #[error("it said goodbye")]
    Bye,
    /// The peer has given this chassis up.
    #[error("it has given this chassis up")]
    GivenUp,
    /// What the peer sent cannot be read.
    #[error("it sent what no peer may send: {0}")]
    Rubbish(String),
    /// This end wanted it.
    #[error("this end closed the link")]
    Closed,
}

/// Every transition. What is not listed leaves the session as it is.
const TABLE: [(State, Event, State); 27] = [
    (State::Waiting, Event::Attached, State::Up),
    (State::Waiting, Event::Silence, State::Down),
    (State::Waiting, Event::PeerEnded, State::Down),
    (State::Waiting, Event::GivenUp, State::Down),
    (State::Waiting, Event::Close, State::Down),
    (State::Up, Event::StreamLost, State::Broken),
    (State::Up, Event::Silence, State::Down),
    (State::Up, Event::PeerEnded, State::Draining),
    (State::Up, Event::Bye, State::Down),
    (State::Up, Event::GivenUp, State::Down),
    (State::Up, Event::Rubbish, State::Down),
    (State::Up, Event::Close, State::Closing),
    (State::Broken, Event::Attached, State::Up),
    (State::Broken, Event::Silence, State::Down),
    (State::Broken, Event::PeerEnded, State::Down),
    (State::Broken, Event::GivenUp, State::Down),
    (State::Broken, Event::Close, State::Down),
    (State::Draining, Event::StreamLost, State::Down),
    (State::Draining, Event::Silence, State::Down),
    (State::Draining, Event::Bye, State::Down),
    (State::Draining, Event::Rubbish, State::Down),
    (State::Draining, Event::Close, State::Down),
    (State::Closing, Event::Flushed, State::Down),
    (State::Closing, Event::StreamLost, State::Down),
    (State::Closing, Event::Silence, State::Down),
    (State::Closing, Event::PeerEnded, State::Down),
    (State::Closing, Event::Rubbish, State::Down),
];

impl State {
    /// Where `event` leads; `None` when it changes nothing.
    pub fn after(self, event: Event) -> Option<Self> {
        TABLE
            .iter()
            .find(|(from, on, _)| (*from, *on) == (self, event))
            .map(|(_, _, to)| *to)
    }
}

/// The table as a Mermaid diagram.
#[cfg(test)]
pub fn diagram() -> String {
    let mut lines = vec![
        "stateDiagram-v2".to_owned(),
        format!("    [*] --> {}", State::Waiting.name()),
    ];
    lines.extend(
        TABLE
            .iter()
            .map(|(from, on, to)| format!("    {} --> {} : {}", from.name(), to.name(), on.name())),
    );
    lines.push(format!("    {} --> [*]", State::Down.name()));
    lines.join("\n") + "\n"
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::*;

    #[test]
    fn the_page_shows_the_table_as_it_is() {
        let page = include_str!("../../../../docs/links.md");
        let drawn = diagram();
        assert!(
            page.contains(&drawn),
            "put this into docs/links.md:\n{drawn}"
        );
    }

    #[test]
    fn each_event_leads_to_one_state_and_nothing_leads_out_of_down() {
        let mut seen = BTreeSet::new();
        for (from, on, _) in TABLE {
            assert!(seen.insert((from.name(), on.name())));
            assert_ne!(from, State::Down);
        }
    }

    #[test]
    fn every_state_that_has_no_end_of_its_own_ends_by_silence() {
        for state in State::ALL {
            if state != State::Down {
                assert_eq!(state.after(Event::Silence), Some(State::Down), "{state:?}");
            }
        }
    }
}
