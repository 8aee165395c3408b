//! Commands that may be asked for again because their answer was lost, and are put once all the same.
//!
//! The caller gives each command a number of its own. A net stores the number with its state: until the
//! command is answered, and then with the answer. A caller that repeats the command gets the same answer,
//! or waits for it, whatever died in between.
//!
//! Data only: it sends nothing and knows no task.

use std::collections::{BTreeMap, VecDeque};

use serde::{Deserialize, Serialize};

use super::messages::{RequestId, TapeAnswer};

/// Answers that are kept for repeated requests; the oldest is forgotten first.
const KEPT: usize = 256;

/// What was asked for under a number.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
struct Asked {
    request: RequestId,
    symbol: String,
}

/// All such commands of one net.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub(super) struct Once {
    /// Those that are not answered, by their numbers on the tape.
    open: BTreeMap<u64, Asked>,
    /// Those that are, oldest first.
    answered: VecDeque<(Asked, TapeAnswer)>,
}

/// What the net knows of a request.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum Known {
    /// Nothing: it is new.
    New,
    /// It is on the tape, or in progress, under this number.
    Open(u64),
    /// It was answered.
    Answered(TapeAnswer),
}

/// A number was used for two commands.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error(
    "`{from}` has asked for `{before}` as its request {number} and cannot ask for `{symbol}` under the same number"
)]
pub(super) struct Reused {
    from: String,
    number: u64,
    before: String,
    symbol: String,
}

impl Once {
    /// What the net knows of a request for this symbol.
    ///
    /// # Errors
    /// [`Reused`].
    pub(super) fn known(&self, request: &RequestId, symbol: &str) -> Result<Known, Reused> {
        let same = |asked: &Asked| {
            if asked.symbol == symbol {
                return Ok(());
            }
            Err(Reused {
                from: request.from.clone(),
                number: request.number,
                before: asked.symbol.clone(),
                symbol: symbol.to_owned(),
            })
        };
        let mut open = self.open.iter();
        if let Some((number, asked)) = open.find(|(_, asked)| asked.request == *request) {
            return same(asked).map(|()| Known::Open(*number));
        }
        let mut answered = self.answered.iter().rev();
        match answered.find(|(asked, _)| asked.request == *request) {
            Some((asked, answer)) => same(asked).map(|()| Known::Answered(answer.clone())),
            None => Ok(Known::New),
        }
    }

    /// A request was put on the tape under this number.
    pub(super) fn put(&mut self, number: u64, request: RequestId, symbol: String) {
        self.open.insert(number, Asked { request, symbol });
    }

    /// A command was taken off the tape: a repeated request counts as new.
    pub(super) fn forget(&mut self, number: u64) {
        self.open.remove(&number);
    }

    /// A command has its answer. Returns whether it is kept for the caller.
    pub(super) fn answered(&mut self, number: u64, answer: &TapeAnswer) -> bool {
        let Some(asked) = self.open.remove(&number) else {
            return false;
        };
        if self.answered.len() == KEPT {
            self.answered.pop_front();
        }
        self.answered.push_back((asked, answer.clone()));
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn request(number: u64) -> RequestId {
        RequestId {
            from: "a".to_owned(),
            number,
        }
    }

    fn answer(text: &str) -> TapeAnswer {
        TapeAnswer {
            symbol: "gone".to_owned(),
            text: text.to_owned(),
            first: true,
        }
    }

    #[test]
    fn a_request_is_new_then_open_then_answered_and_so_after_a_restart() {
        let mut once = Once::default();
        assert_eq!(once.known(&request(1), "go"), Ok(Known::New));
        once.put(7, request(1), "go".to_owned());
        assert_eq!(once.known(&request(1), "go"), Ok(Known::Open(7)));
        assert_eq!(once.known(&request(2), "go"), Ok(Known::New));
        assert!(once.answered(7, &answer("well")));
        assert!(!once.answered(8, &answer("of somebody who asked in the usual way")));
        let stored = postcard::to_stdvec(&once).unwrap();
        let once: Once = postcard::from_bytes(&stored).unwrap();
        let known = once.known(&request(1), "go");
        assert_eq!(known, Ok(Known::Answered(answer("well"))));
        let error = once.known(&request(1), "stop").unwrap_err().to_string();
        assert!(
            error.contains("`go` as its request 1 and cannot ask for `stop`"),
            "{error}"
        );
    }

    #[test]
    fn so_many_answers_are_kept_and_the_oldest_goes_first() {
        let mut once = Once::default();
        for number in 0..=KEPT as u64 {
            once.put(number, request(number), "go".to_owned());
            once.answered(number, &answer(""));
        }
        assert_eq!(once.known(&request(0), "go"), Ok(Known::New));
        assert_eq!(
            once.known(&request(1), "go"),
            Ok(Known::Answered(answer("")))
        );
    }
}
