//! What a task of the Organization Level needs of the Coordination Level: it has a command done, learns by types why it was not,
//! and may send another net in the place of the Dispatcher's (CIRSSE report 108, sections 1 and 6). [`planner`] is an example.

pub mod planner;

use std::time::Duration;

use ctos::{
    call::{CallError, Fault},
    task::Context,
};
use pnt::task::{Control, Order, PutOnce, RequestId, TapeAnswer, put_once};
use serde::{Deserialize, Serialize};

use crate::{
    dom::DomStore,
    outcome::{Failure, Outcome},
};

/// Why a command was not done as asked: written by Dispatchers, for whoever sent it.
pub const WHY: &str = "why";

/// The word of a command's arguments that names its sender's request, before the name.
pub const TAG: &str = "tag=";

/// How much longer than the new net waits for its moment an answer may take.
const MARGIN: Duration = Duration::from_secs(10);

/// [`WHY`].
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Why {
    /// The tag that the command came with; empty when it came with none.
    pub tag: String,
    /// Everything that was in the way, in the order of time.
    pub failures: Vec<Failure>,
}

/// A command that was not done as asked.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{symbol}: {text}")]
pub struct NotDone {
    /// The answer.
    pub symbol: String,
    /// What was in the way, in the order of time; empty when nobody told, or another command has told meanwhile.
    pub failures: Vec<Failure>,
    /// The same in words.
    pub text: String,
}

impl NotDone {
    fn before_any_answer(failure: Failure) -> Self {
        Self {
            symbol: "no answer".to_owned(),
            text: failure.to_string(),
            failures: vec![failure],
        }
    }

    /// Whether one of these was in the way.
    #[must_use]
    pub fn is_one_of(&self, outcomes: &[Outcome]) -> bool {
        let mut failures = self.failures.iter();
        failures.any(|failure| outcomes.contains(&failure.outcome))
    }
}

/// Has the net `net` do the command of a request, once; `dom` is the data object manager of its coordinators. The request's
/// `from` must be another in each life of its sender.
///
/// # Errors
/// Any other answer than the first that the net declares for the command, or none.
pub async fn command(
    cx: &Context,
    (net, dom): (&str, &str),
    mut put: PutOnce,
    within: Duration,
) -> Result<TapeAnswer, NotDone> {
    let RequestId { from, number } = &put.request;
    let tag = format!("{from} {number}");
    put.arguments.push(format!("{TAG}{tag}"));
    let answer = put_once(cx, net, &put, within).await;
    let answer = answer.map_err(|error| NotDone::before_any_answer(error.into()))?;
    if answer.first {
        return Ok(answer);
    }
    let why = DomStore::new(dom).fetch::<Why>(cx, WHY).await.ok();
    let why = why.filter(|why| why.tag == tag);
    Err(NotDone {
        symbol: answer.symbol,
        failures: why.map_or_else(Vec::new, |why| why.failures),
        text: answer.text,
    })
}

/// Sends a net for the task `net`, where it takes the place of the running one. It is checked together with all other nets of the
/// app, and waits so long for a marking at which that may be. The task must allow control.
///
/// # Errors
/// [`Outcome::Refused`] with the findings or with what it waited for, the running net goes on; [`Outcome::Lost`] when the task is
/// gone or does not answer, and which net it runs is not known.
pub async fn send_net(
    cx: &Context,
    net: &str,
    (file, text): (&str, String),
    within: Duration,
) -> Result<(), Failure> {
    let lost = |error: &dyn ToString| Failure::new(Outcome::Lost, error.to_string());
    let task = cx.task(net).await.map_err(|error| lost(&error))?;
    let order = Order::Replace {
        file: file.to_owned(),
        text,
        within_ms: u64::try_from(within.as_millis()).unwrap_or(u64::MAX),
    };
    let by = cx.name().to_owned();
    let sent = cx.call(&task, Control { order, by });
    let sent: Result<String, CallError> = sent.deadline(within + MARGIN).await;
    match sent {
        Ok(_) => Ok(()),
        Err(error) => match error.fault {
            Fault::Refused { .. } => Err(Failure::new(Outcome::Refused, error.reason())),
            _ => Err(lost(&error)),
        },
    }
}
