//! What one net has sent to others and got from them, so that everything moves exactly once.
//!
//! What goes from one net to another is numbered, without gaps, in a stream that belongs to the pair. The
//! sender keeps each transfer until the receiver has said that it has it. After a lost message, a lost
//! link or a restart it sends it again. The receiver counts what it has taken of the stream, and takes
//! nothing twice. Both counts are stored with the markings that they belong to.
//!
//! A sender that is not durable forgets, and begins a new stream with its next life. A receiver
//! that forgets takes a stream up wherever it stands.
//!
//! Data only: it sends nothing and knows no task.

use std::{collections::VecDeque, sync::Arc};

use serde::{Deserialize, Serialize};

use super::{by_net::ByNet, messages::Transfer};

/// Transfers that go in one message at most.
const MOST_IN_MESSAGE: usize = 256;

/// All streams of one net.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub(super) struct Transfers {
    /// The number of this net's streams: one for each of its lives.
    stream: u64,
    out: ByNet<Outbox>,
    received: ByNet<Received>,
}

/// To one net.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
struct Outbox {
    /// Number of the last transfer, counted from 1.
    last: u64,
    /// Those that the receiver is not known to have, oldest first.
    waiting: VecDeque<Kept>,
}

#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
struct Kept {
    number: u64,
    transfer: Arc<Transfer>,
    /// The change of the net with which it came to be. What was read from a store is stored.
    #[serde(skip)]
    change: u64,
}

/// From one net.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
struct Received {
    stream: u64,
    /// Number of the last transfer that was taken.
    last: u64,
}

/// Transfers to one net that can be sent.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Ready {
    pub(super) stream: u64,
    /// Number of the first one.
    pub(super) first: u64,
    pub(super) transfers: Vec<Arc<Transfer>>,
}

/// Transfers are missing in between: the sender lost what it had not been told that we have.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("transfers {expected} to {} from net `{from}` are missing", .got - 1)]
pub(super) struct Gap {
    from: Arc<str>,
    expected: u64,
    got: u64,
}

impl Transfers {
    /// A net that has exchanged nothing.
    pub(super) fn new(stream: u64) -> Self {
        Self {
            stream,
            ..Self::default()
        }
    }

    /// The number of the streams of this net's life.
    pub(super) fn stream(&self) -> u64 {
        self.stream
    }

    /// Keeps a transfer for a net; it came to be with this change. Returns its number.
    pub(super) fn post(&mut self, net: &Arc<str>, transfer: Arc<Transfer>, change: u64) -> u64 {
        let outbox = self.out.of(net);
        outbox.last += 1;
        outbox.waiting.push_back(Kept {
            number: outbox.last,
            transfer,
            change,
        });
        outbox.last
    }

    /// The oldest transfers to a net, as far as the changes that they came to be with are stored.
    pub(super) fn ready(&self, net: &Arc<str>, stored: u64) -> Option<Ready> {
        let waiting = &self.out.get(net)?.waiting;
        let first = waiting.front()?.number;
        let transfers: Vec<Arc<Transfer>> = waiting
            .iter()
            .take_while(|kept| kept.change <= stored)
            .take(MOST_IN_MESSAGE)
            .map(|kept| Arc::clone(&kept.transfer))
            .collect();
        (!transfers.is_empty()).then_some(Ready {
            stream: self.stream,
            first,
            transfers,
        })
    }

    /// A net has all transfers up to a number. Returns whether that was news.
    pub(super) fn arrived(&mut self, net: &Arc<str>, last: u64) -> bool {
        let waiting = &mut self.out.of(net).waiting;
        let before = waiting.len();
        while waiting.front().is_some_and(|kept| kept.number <= last) {
            waiting.pop_front();
        }
        waiting.len() < before
    }

    /// The nets for which something waits, with how much.
    pub(super) fn waiting(&self) -> impl Iterator<Item = (&Arc<str>, usize)> {
        let out = self.out.iter();
        out.filter(|(_, outbox)| !outbox.waiting.is_empty())
            .map(|(net, outbox)| (net, outbox.waiting.len()))
    }

    /// How many transfers of a message, from its beginning, were taken before.
    ///
    /// # Errors
    /// [`Gap`].
    #[inline]
    pub(super) fn known(&self, from: &Arc<str>, stream: u64, first: u64) -> Result<u64, Gap> {
        let taken = match self.received.get(from) {
            Some(received) if received.stream == stream => received.last,
            _ => return Ok(0),
        };
        if first > taken + 1 {
            return Err(Gap {
                from: Arc::clone(from),
                expected: taken + 1,
                got: first,
            });
        }
        Ok((taken + 1).saturating_sub(first))
    }

    /// The transfers of a net up to a number were taken.
    #[inline]
    pub(super) fn take(&mut self, from: &Arc<str>, stream: u64, last: u64) {
        *self.received.of(from) = Received { stream, last };
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn net(name: &str) -> Arc<str> {
        name.into()
    }

    fn token(number: u32) -> Arc<Transfer> {
        Arc::new(Transfer {
            tokens: vec![("p".to_owned(), number)],
            symbol: None,
        })
    }

    /// What can happen to a sender and a receiver, both of which are stored at every step.
    #[derive(Debug, Clone)]
    enum Happens {
        Post,
        /// A message is sent; then it is taken or lost.
        Send {
            arrives: bool,
            answered: bool,
        },
        /// An old message comes once more, as after a retransmission.
        Repeat,
        /// The sender, or the receiver, goes on from what was stored.
        Restart,
    }

    fn happens() -> impl Strategy<Value = Happens> {
        prop_oneof![
            3 => Just(Happens::Post),
            4 => (any::<bool>(), any::<bool>()).prop_map(|(arrives, answered)| Happens::Send { arrives, answered }),
            1 => Just(Happens::Repeat),
            1 => Just(Happens::Restart),
        ]
    }

    /// Takes a message as a net does.
    fn receive(transfers: &mut Transfers, ready: &Ready, got: &mut Vec<Arc<Transfer>>) -> u64 {
        let known = transfers
            .known(&net("a"), ready.stream, ready.first)
            .unwrap();
        got.extend(ready.transfers.iter().skip(known as usize).cloned());
        let last = ready.first + ready.transfers.len() as u64 - 1;
        if known < ready.transfers.len() as u64 {
            transfers.take(&net("a"), ready.stream, last);
        }
        last
    }

    proptest! {
        #[test]
        fn whatever_is_lost_or_repeated_everything_arrives_once_and_in_order(
            steps in prop::collection::vec(happens(), 0..200)
        ) {
            let (mut sender, mut receiver) = (Transfers::new(7), Transfers::new(8));
            let (mut posted, mut got) = (Vec::new(), Vec::new());
            let mut old: Option<Ready> = None;
            for step in steps {
                match step {
                    Happens::Post => {
                        let transfer = token(posted.len() as u32);
                        sender.post(&net("b"), transfer.clone(), 0);
                        posted.push(transfer);
                    }
                    Happens::Send { arrives, answered } => {
                        let Some(ready) = sender.ready(&net("b"), 0) else { continue };
                        if arrives {
                            let last = receive(&mut receiver, &ready, &mut got);
                            old = Some(ready);
                            if answered {
                                sender.arrived(&net("b"), last);
                            }
                        }
                    }
                    Happens::Repeat => {
                        if let Some(ready) = &old {
                            receive(&mut receiver, ready, &mut got);
                        }
                    }
                    Happens::Restart => {
                        let stored = postcard::to_stdvec(&(&sender, &receiver)).unwrap();
                        (sender, receiver) = postcard::from_bytes(&stored).unwrap();
                    }
                }
            }
            while let Some(ready) = sender.ready(&net("b"), 0) {
                let last = receive(&mut receiver, &ready, &mut got);
                prop_assert!(sender.arrived(&net("b"), last));
            }
            prop_assert_eq!(got, posted);
        }
    }

    #[test]
    fn nothing_is_sent_before_the_change_that_it_came_with_is_stored() {
        let mut sender = Transfers::new(1);
        sender.post(&net("b"), token(1), 3);
        sender.post(&net("b"), token(2), 4);
        assert_eq!(sender.ready(&net("b"), 2), None);
        assert_eq!(sender.ready(&net("b"), 3).unwrap().transfers.len(), 1);
        assert_eq!(sender.ready(&net("b"), 4).unwrap().transfers.len(), 2);
    }

    #[test]
    fn a_new_life_of_the_sender_is_no_repetition_and_a_gap_is_told() {
        let mut receiver = Transfers::new(1);
        receiver.take(&net("a"), 5, 9);
        assert_eq!(receiver.known(&net("a"), 5, 8), Ok(2));
        assert_eq!(receiver.known(&net("a"), 6, 1), Ok(0));
        let gap = receiver.known(&net("a"), 5, 12).unwrap_err().to_string();
        assert_eq!(gap, "transfers 10 to 11 from net `a` are missing");
    }
}
