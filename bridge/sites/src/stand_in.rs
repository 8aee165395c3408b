//! What stands for a task at another site: whatever it is sent, it hands to the gate, in order.

use std::time::Duration;

use ctos::{
    call::Fault,
    message::{Flags, Message, SYSTEM_COMMANDS},
    task::{Context, EventHandler, Handled, HandlerError},
};
use futures_util::FutureExt as _;

use crate::{
    args::{GATE, StandInArgs},
    gate::Pass,
};

/// How long the gate may take for a message that nobody waits for.
const SEND: Duration = Duration::from_secs(10);
/// The gate ends each request at its deadline; this is for its answer.
const GRACE: Duration = Duration::from_secs(2);

/// Begins some work now, which keeps messages in their order; it goes on concurrently with the task.
pub(crate) fn begin(cx: &Context, work: impl Future<Output = ()> + 'static) {
    let mut work = Box::pin(work);
    if work.as_mut().now_or_never().is_none() {
        cx.spawn(work);
    }
}

/// The event handler.
pub(crate) struct StandIn {
    args: StandInArgs,
}

impl StandIn {
    pub(crate) fn new(cx: &Context) -> Result<Self, HandlerError> {
        Ok(Self { args: cx.args()? })
    }
}

impl EventHandler for StandIn {
    async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
        let command = message.command();
        // About the stand-in itself: how it is, what it takes.
        if command >= SYSTEM_COMMANDS {
            return cx.default_processing(message);
        }
        let replies = message.header().flags.contains(Flags::REPLY_WAIT);
        let left = match message.deadline() {
            Some(deadline) => deadline.since(cx.now()),
            None => SEND,
        };
        let cx = cx.within(message.trace());
        let gate = cx.task(GATE).await?;
        let StandInArgs { site, task, .. } = self.args.clone();
        let (data, reply) = message.open_raw()?;
        let pass = Pass {
            site,
            task,
            command,
            replies,
            left,
            data: data.into(),
        };
        let call = cx.call(&gate, pass).deadline(left + GRACE);
        begin(&cx.clone(), async move {
            let ended: Result<_, Fault> = match call.await {
                Ok(ended) => ended,
                Err(error) => Err(error.fault),
            };
            match ended {
                Ok(data) => reply.ok(data.into_inner().into()),
                Err(fault) if replies => reply.end(fault),
                // Its sender went on when the queue had taken it.
                Err(fault) => {
                    tracing::warn!(task = cx.name(), command, %fault, "what was sent is lost");
                }
            }
        });
        Ok(())
    }
}
