//! Commands to other nets that are put once, however often they are asked for: by an action, or by another
//! task.

use std::time::Duration;

use ctos::{
    task::{Context, HandlerError},
    time::Instant,
};

use super::{
    messages::{PutOnce, TapeAnswer},
    other::{Failed, is_durable, may_succeed},
};

/// The wait before a net that may have died is asked again.
const ASK_AGAIN: Duration = Duration::from_millis(50);

/// Puts a command on the tape of the net `net` and waits for its answer. A durable net is asked again under
/// the same number when it may have died before it answered, until `limit` is over. It takes the command
/// once. Any other net is asked once, for it has forgotten what it was asked.
///
/// # Errors
/// Why the last asking failed.
pub async fn put_once(
    cx: &Context,
    net: &str,
    put: &PutOnce,
    limit: Duration,
) -> Result<TapeAnswer, HandlerError> {
    let until = cx.now() + limit;
    let durable = is_durable(cx, net);
    loop {
        match ask(cx, net, put, (until, durable)).await {
            Ok(answer) => return Ok(answer),
            Err((_, Failed::NotNow)) if durable && cx.now() + ASK_AGAIN < until => {
                cx.sleep(ASK_AGAIN).await;
            }
            Err((error, _)) => return Err(error),
        }
    }
}

/// Asks a net once, and says whether it may be asked again.
async fn ask(
    cx: &Context,
    net: &str,
    put: &PutOnce,
    (until, durable): (Instant, bool),
) -> Result<TapeAnswer, (HandlerError, Failed)> {
    let found = if durable {
        cx.wait_for_task(net, until.since(cx.now())).await
    } else {
        cx.task(net).deadline(until.since(cx.now())).await
    };
    let to = found.map_err(|error| (HandlerError::from(error), Failed::NotNow))?;
    let asked = cx.call(&to, put.clone());
    let answer = asked.deadline(until.since(cx.now())).await;
    answer.map_err(|error| {
        (
            HandlerError::new(error.reason()),
            may_succeed(&error, durable),
        )
    })
}
