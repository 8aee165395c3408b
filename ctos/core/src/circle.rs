//! Who waits for whose reply, and whether such waits close to a circle.
//!
//! A task that waits takes no message, so tasks that wait for one another in a circle wait until the
//! deadline of their calls. Each task notes whom it asked. When a call has waited `LONG`, the notes are
//! followed from task to task, chassis by chassis, and a circle is reported. While calls are answered
//! in time, nobody looks for circles.

use std::time::Duration;

use crate::{
    chassis::Chassis,
    context::core::Context,
    envelope::Message,
    reply::CallKey,
    system::{self, WaitsFor},
    tap::WaitFor,
};
use ctos_message::{Command, Flags, Tid};

/// After this time a call asks itself whether it can ever end.
pub(crate) const LONG: Duration = Duration::from_secs(1);

/// The longest chain of tasks that is followed.
const LONGEST_CHAIN: usize = 64;

/// Looks whether a call to `to` that has waited long waits in a circle. The lint is a warning: the call
/// goes on, because one of the others may give up first.
pub(crate) fn look_for(cx: Context, call: CallKey, to: Tid) {
    // Whether it was one, the record tells.
    if cx.chassis().tap.replay().is_some() {
        return;
    }
    let processor = cx.processor().clone();
    let looking = async move {
        if let Some(circle) = circle(&cx, to).await {
            tracing::warn!(task = %cx.name(), circle = %circle, "tasks wait for one another");
            cx.processor().note_circle(call, circle);
        }
    };
    processor.spawn(looking, None);
}

/// Follows the notes from `to`; the circle in words if they lead back to this task.
async fn circle(cx: &Context, to: Tid) -> Option<String> {
    let me = cx.tid();
    let mut text = format!("`{}`", cx.name());
    let mut next = to;
    for _ in 0..LONGEST_CHAIN {
        if next == me {
            text.push_str(&format!(" -> `{}`", cx.name()));
            return Some(text);
        }
        let waits = ask_agent(cx, next).await?;
        text.push_str(&format!(" -> `{}`", waits.name));
        next = waits.to;
    }
    None
}

/// Whom `task` waits for, if it has waited long. Asked past the notes: a question about waiting is no
/// wait of this task.
async fn ask_agent(cx: &Context, task: Tid) -> Option<system::Waits> {
    let agent = system::agent_tid(task.chassis());
    let message = Message::request(agent, cx.tid(), WaitsFor::CODE, WaitsFor { task })
        .flagged(Flags::HIGH_PRIORITY)
        .until(Some(cx.now() + LONG));
    let waiting = cx.inner.chassis.dispatch(message, WaitFor::Reply);
    let answer = cx.timeout(LONG, waiting).await.ok()?.ok()?;
    answer.take::<Option<system::Waits>>().ok()?
}

/// What an agent answers for a task of its chassis: whom it waits for. `None`, unless its handler is
/// at work and has waited for so long that the wait is no passing one.
pub fn of_task(chassis: &Chassis, task: Tid) -> Option<system::Waits> {
    let record = chassis.task(task)?;
    let (to, since) = record.statistics.waits()?.latest()?;
    let began = record.statistics.read().began?;
    let long = chassis.clock.now().since(since) >= LONG / 2;
    (long && began <= since).then(|| system::Waits {
        name: record.name.to_string(),
        to: chassis.directory.current(to),
    })
}
