//! Why a message did not lead to a reply.

use std::{fmt, time::Duration};

use serde::{Deserialize, Serialize};

use crate::PayloadError;

/// Why a message did not lead to a reply, without the names of the tasks.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, thiserror::Error)]
pub enum Fault {
    /// No task has this id (any more).
    #[error("no such task is running")]
    UnknownTask,
    /// The receiver's queue is full, and so is the line of senders that wait.
    #[error("its queue is full ({capacity} messages)")]
    Full {
        /// The capacity of the queue.
        capacity: usize,
    },
    /// Too much is under way to the receiver's chassis already: it does not read, or not fast enough.
    #[error("the link to its chassis is full ({bytes} bytes under way)")]
    LinkFull {
        /// Bytes that are under way.
        bytes: usize,
    },
    /// The reply did not come in time.
    #[error("no answer within {:.3} s", .after.as_secs_f64())]
    Deadline {
        /// How long the sender waited.
        after: Duration,
    },
    /// The reply did not come in time, and could not: tasks wait for one another.
    #[error("no answer within {:.3} s, because tasks wait for one another: {circle}", .after.as_secs_f64())]
    Circle {
        /// How long the sender waited.
        after: Duration,
        /// Who waits for whom.
        circle: String,
    },
    /// The chassis of the receiver is gone.
    #[error("chassis `{chassis}` is gone")]
    PeerDown {
        /// Its name.
        chassis: String,
    },
    /// The receiver takes no such command.
    #[error("it takes no such command; it takes: {}", .takes.join(", "))]
    UnknownCommand {
        /// What it takes.
        takes: Vec<String>,
    },
    /// The data is not what the command needs.
    #[error("the data cannot be read: {text}")]
    BadPayload {
        /// What is wrong with it.
        text: String,
    },
    /// The receiver understood and said no.
    #[error("refused: {text}")]
    Refused {
        /// Its reason.
        text: String,
    },
    /// The receiver ended the request without an answer.
    #[error("ended without an answer")]
    NoReply,
    /// The receiver's handler panicked.
    #[error("the handler panicked: {text}")]
    Panicked {
        /// What the panic said.
        text: String,
    },
    /// The receiver is being stopped.
    #[error("it is being stopped")]
    Stopping,
    /// Whether there is a permit cannot be seen from here: the receiver is on another chassis.
    #[error("it is on chassis `{chassis}`, so whether it has a credit cannot be seen from here")]
    Elsewhere {
        /// Its name.
        chassis: String,
    },
    /// The receiver is at another site, of which nothing is heard.
    #[error("site `{site}` has been cut off for {:.1} s{}", .after.as_secs_f64(), done(.asked))]
    CutOff {
        /// The site.
        site: String,
        /// For how long nothing was heard of it.
        after: Duration,
        /// Whether the request had been sent when that was noticed.
        asked: bool,
    },
}

/// What may have come of a request to a site that was cut off.
fn done(asked: &bool) -> &'static str {
    match asked {
        true => ", and what was asked may have been done",
        false => "",
    }
}

impl From<PayloadError> for Fault {
    fn from(error: PayloadError) -> Self {
        let text = error.to_string();
        Self::BadPayload { text }
    }
}

/// A call or a send that failed: who asked whom for what, and why it failed.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct CallError {
    /// The asking task.
    pub from: String,
    /// The asked task.
    pub to: String,
    /// The command's name.
    pub command: String,
    /// What went wrong.
    pub fault: Fault,
}

impl CallError {
    /// The receiver's own words, when it refused; else the whole error.
    #[must_use]
    pub fn reason(&self) -> String {
        match &self.fault {
            Fault::Refused { text } => text.clone(),
            _ => self.to_string(),
        }
    }

    /// Whether the receiver, or the chassis it lives on, is gone or going. What was asked for may have been
    /// done, in part or not at all. The task may come back: `cx.task(&error.to)` waits for it while its chassis
    /// is being restarted, and says at once if it does not come back. It never finds the dead task again.
    #[must_use]
    pub fn is_gone(&self) -> bool {
        matches!(
            self.fault,
            Fault::PeerDown { .. } | Fault::UnknownTask | Fault::Stopping
        )
    }

    /// Whether it is worth while to look for the receiver again and repeat the request, if that is permitted. True if
    /// the receiver is gone ([`Self::is_gone`]) or its site is cut off, or its handler panicked or dropped the request
    /// and may have been built anew. `cx.task(&error.to)` tells whether it comes back. False for what the receiver said itself, and for
    /// deadlines.
    #[must_use]
    pub fn may_come_back(&self) -> bool {
        self.is_gone()
            || matches!(
                self.fault,
                Fault::Panicked { .. } | Fault::NoReply | Fault::CutOff { .. }
            )
    }
}

impl fmt::Display for CallError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self {
            from,
            to,
            command,
            fault,
        } = self;
        match fault {
            Fault::UnknownTask => write!(
                f,
                "`{to}`, asked by `{from}` for `{command}`, is not running"
            ),
            Fault::Full { capacity } => write!(
                f,
                "the queue of `{to}` is full ({capacity} messages), so `{command}` from `{from}` was not taken; give it a larger `queue` or send less"
            ),
            Fault::LinkFull { bytes } => write!(
                f,
                "the link to the chassis of `{to}` is full ({bytes} bytes under way), so `{command}` from `{from}` was not sent; it reads too slowly or not at all: send less, or raise `app.link_unacknowledged_mib`"
            ),
            Fault::Deadline { after } => write!(
                f,
                "`{to}` did not answer `{command}` from `{from}` within {:.3} s",
                after.as_secs_f64()
            ),
            Fault::Circle { after, circle } => write!(
                f,
                "`{to}` did not answer `{command}` from `{from}` within {:.3} s, because tasks wait for one another: {circle}",
                after.as_secs_f64()
            ),
            Fault::PeerDown { chassis } => write!(
                f,
                "chassis `{chassis}` is gone, and with it `{to}`, which `{from}` asked for `{command}`"
            ),
            Fault::UnknownCommand { takes } => write!(
                f,
                "`{to}` takes no `{command}` (from `{from}`); it takes: {}",
                takes.join(", ")
            ),
            Fault::BadPayload { text } => {
                write!(
                    f,
                    "`{to}` cannot read the data of `{command}` from `{from}`: {text}"
                )
            }
            Fault::Refused { text } => {
                write!(f, "`{to}` refused `{command}` from `{from}`: {text}")
            }
            Fault::NoReply => write!(
                f,
                "`{to}` ended `{command}` from `{from}` without an answer"
            ),
            Fault::Panicked { text } => write!(
                f,
                "the handler of `{to}` panicked at `{command}` from `{from}`: {text}"
            ),
            Fault::Elsewhere { chassis } => write!(
                f,
                "`{to}` is on chassis `{chassis}`, so `{from}` cannot see whether it has a credit for `{command}`; use `send`, which waits"
            ),
            Fault::CutOff { site, after, asked } => {
                let after = after.as_secs_f64();
                write!(
                    f,
                    "site `{site}` has been cut off for {after:.1} s: `{to}` "
                )?;
                match asked {
                    true => write!(
                        f,
                        "has not answered `{command}` from `{from}`, and may have carried it out"
                    ),
                    false => write!(f, "was not asked for `{command}` by `{from}`"),
                }
            }
            Fault::Stopping => {
                write!(
                    f,
                    "`{to}` is being stopped and took no `{command}` from `{from}`"
                )
            }
        }
    }
}

impl std::error::Error for CallError {}
