//! What gates say to each other, and by which keys of the network. Knows no session.
//!
//! | key | what |
//! |---|---|
//! | `ctos/site/SITE/beat` | a gate tells twice a second that it is there: [`Beat`] |
//! | `ctos/site/SITE/RUN/ask/FROM/TASK/COMMAND` | a request of the site `FROM`; the payload is the command's data |
//!
//! A key names who asks. Beside the data stand a [`Head`], or how a request [`Ended`], and the signature of who says it
//! ([`Said`](crate::proof::Said)). `RUN` is the date at which a gate was started. So nobody asks a predecessor that the routers
//! still know, or two gates at once. What one run was asked is not believed by the next.

use std::time::Duration;

use ctos::call::Fault;
use serde::{Deserialize, Serialize, de::DeserializeOwned};

/// The version of all that is said here.
pub(crate) const VERSION: u16 = 2;

/// A sign of life.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct Beat {
    pub version: u16,
    /// Which run of the gate it is: the date at which it began, ns since 1970. Of two the later one is meant.
    pub run: u64,
}

/// What stands beside the data of a request.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct Head {
    pub version: u16,
    /// How long the caller still waits, ms.
    pub left_ms: u64,
    /// Whether it waits for a reply, or only until the task's queue has taken the message.
    pub replies: bool,
    /// Which run of its gate asks.
    pub run: u64,
    /// Which request of that run it is, from 1.
    pub number: u64,
}

impl Head {
    pub(crate) fn new(left: Duration, replies: bool, run: u64, number: u64) -> Self {
        let left_ms = u64::try_from(left.as_millis()).unwrap_or(u64::MAX);
        Self {
            version: VERSION,
            left_ms,
            replies,
            run,
            number,
        }
    }

    /// How long the caller still waits, an hour at most.
    pub(crate) fn left(&self) -> Duration {
        Duration::from_millis(self.left_ms.min(3_600_000))
    }
}

/// How a request ended. The data of a reply is the payload beside it.
pub(crate) type Ended = Result<(), Fault>;

/// As it goes through the network.
pub(crate) fn written<T: Serialize>(value: &T) -> Vec<u8> {
    // Plain data: writing it cannot fail.
    postcard::to_stdvec(value).unwrap_or_default()
}

/// What came through the network.
pub(crate) fn read<T: DeserializeOwned>(bytes: &[u8]) -> Option<T> {
    postcard::from_bytes(bytes).ok()
}

/// Where the gate of a site tells that it is there.
pub(crate) fn beat_key(site: &str) -> String {
    format!("ctos/site/{site}/beat")
}

/// Whatever a run of the gate of a site is asked.
pub(crate) fn all_asks(site: &str, run: u64) -> String {
    format!("ctos/site/{site}/{run:016x}/ask/*/*/*")
}

/// Who asks which task for what.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Asked {
    pub from: String,
    pub task: String,
    pub command: u16,
}

impl Asked {
    /// Where it is asked of a run of the gate of `site`.
    pub(crate) fn key(&self, site: &str, run: u64) -> String {
        let Self {
            from,
            task,
            command,
        } = self;
        format!("ctos/site/{site}/{run:016x}/ask/{from}/{task}/{command:04x}")
    }

    /// What a key says.
    pub(crate) fn of_key(key: &str) -> Option<Self> {
        let (_, asked) = key.split_once("/ask/")?;
        let mut parts = asked.split('/');
        let (from, task, command) = (parts.next()?, parts.next()?, parts.next()?);
        if parts.next().is_some() {
            return None;
        }
        Some(Self {
            from: from.to_owned(),
            task: task.to_owned(),
            command: u16::from_str_radix(command, 16).ok()?,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_key_tells_who_asks_whom_for_what() {
        let asked = Asked {
            from: "north".to_owned(),
            task: "left.arm".to_owned(),
            command: 0xfe,
        };
        let key = asked.key("south", 0xab);
        assert_eq!(
            key,
            "ctos/site/south/00000000000000ab/ask/north/left.arm/00fe"
        );
        assert_eq!(Asked::of_key(&key), Some(asked));
        let all = zenoh::key_expr::KeyExpr::new(all_asks("south", 0xab)).unwrap();
        assert!(all.includes(&zenoh::key_expr::KeyExpr::new(key).unwrap()));
        for wrong in [
            "",
            "a/ask/b/c",
            "a/ask/b/c/zz",
            "a/ask/b/c/00fe/d",
            "a/ask/b/c/10000",
        ] {
            assert_eq!(Asked::of_key(wrong), None, "{wrong}");
        }
    }

    #[test]
    fn what_was_cut_or_is_something_else_is_not_read() {
        let whole = written(&Beat {
            version: VERSION,
            run: u64::MAX,
        });
        assert!(read::<Beat>(&whole).is_some());
        for end in 0..whole.len() {
            assert_eq!(read::<Beat>(&whole[..end]), None);
        }
        let fault: Ended = Err(Fault::Full { capacity: 3 });
        assert_eq!(read::<Ended>(&written(&fault)), Some(fault));
        assert_eq!(read::<Ended>(&[7, 7]), None);
    }
}
