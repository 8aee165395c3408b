//! Requests that are worked on beside each other: Services and Tools wait most of the time, and two
//! cameras shall not wait for one another.

use std::future::Future;

use ctos::{
    message::{Command, Message},
    task::{Context, Handled, HandlerError},
};

/// Opens the request and answers it from a child of the task, so that the task can take the next one meanwhile.
pub(crate) fn answer<C, Work, F>(cx: &Context, message: Message, work: Work) -> Handled
where
    C: Command,
    Work: FnOnce(Context, C) -> F,
    F: Future<Output = Result<C::Reply, HandlerError>> + 'static,
{
    let (request, reply) = message.open::<C>()?;
    let working = work(cx.clone(), request);
    cx.spawn(async move {
        // Answering never fails; its result exists to end a handler with.
        let _ = match working.await {
            Ok(result) => reply.ok(result),
            Err(error) => reply.fail(error),
        };
    });
    Ok(())
}
