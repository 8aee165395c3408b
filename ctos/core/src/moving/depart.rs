//! How a task leaves its old place, and how what still comes there is sent after it.

use std::{
    future::{IntoFuture, poll_fn},
    pin::pin,
    task::Poll,
    time::Duration,
};

use futures_util::future::{Either, select};
use scopeguard::ScopeGuard;

use super::{LOOK, PATIENCE, UnderWay, agent_of};
use crate::{
    contain::contained,
    context::{Context, TaskRef},
    envelope::Message,
    mailbox::queue::TaskQueue,
    reply::ReplySlot,
    runner::{Runner, drop_handler},
    supervise::Ending,
    system::{
        self, AbortMove, Broke, ChassisDown, CommitMove, Fence, Forwarded, Load, MoveIn, MoveOut,
        Settle, Settled, StopTask, Transfer,
    },
};
use ctos_message::{Command, Data, Flags, Tid, fault::Fault};

/// A task that has left: where it went, and what was sent after it so far.
pub(crate) struct Departed {
    to: Tid,
    accepted: Vec<(Message, Option<UnderWay>)>,
}

/// Takes the task to another place. `None` when it stays; then it needs a new handler if its old one is
/// gone.
pub(crate) async fn depart(runner: &mut Runner, message: Message) -> Option<Departed> {
    let (MoveOut { to }, reply) = message.open::<MoveOut>().ok()?;
    let state = match give_state(runner, to) {
        Ok(state) => state,
        Err(why) => {
            // A reply cannot fail, here and below.
            let _ = reply.fail(why);
            return None;
        }
    };
    let queue = runner.queue.clone();
    queue.hold();
    // The old handler is finished before the new one begins.
    if let Some(handler) = runner.handler.take() {
        drop_handler(&runner.cx, handler);
    }
    runner.end_incarnation(Ending::Order).await;
    runner.kept = Some(state.clone());
    let accepted = queue.take_accepted();
    match prepare(runner, to, state, &accepted).await {
        Ok((new, copies)) => {
            let _ = reply.ok(new);
            Some(Departed {
                to: new,
                accepted: accepted.into_iter().zip(copies).collect(),
            })
        }
        Err(why) => {
            queue.release(accepted);
            let _ = reply.fail(why);
            None
        }
    }
}

/// The handler's state, or why the task cannot be moved.
fn give_state(runner: &mut Runner, to: system::Place) -> Result<Vec<u8>, String> {
    if runner.cx.inner.kept.is_some() && to.chassis != runner.cx.chassis().index() {
        return Err(
            "its state is stored by its chassis: change `on` and boot the app again".to_owned(),
        );
    }
    if runner.is_child() {
        return Err(
            "it belongs to the task that started it, which can be moved instead".to_owned(),
        );
    }
    if !runner.is_running() {
        return Err("it can be moved between phase run and its stop only".to_owned());
    }
    let handler = runner.handler.as_mut().ok_or("it is being restarted")?;
    match contained(|| handler.hand_over()) {
        Ok(Some(Ok(state))) => Ok(state),
        Ok(Some(Err(error))) => Err(error.to_string()),
        Ok(None) => Err("its handler passes no state on; see `task::Handover`".to_owned()),
        Err(panic) => {
            let why = format!("it panicked while it gave its state: {panic}");
            runner.cx.when_broken()(&why);
            Err(why)
        }
    }
}

/// Everything up to the moment from which the task is at the new place.
async fn prepare(
    runner: &Runner,
    to: system::Place,
    state: Vec<u8>,
    accepted: &[Message],
) -> Result<(Tid, Vec<Option<UnderWay>>), String> {
    let (cx, queue) = (&runner.cx, runner.queue.clone());
    let agent = agent_of(to.chassis);
    let readying = pin!(make_ready(cx, &agent, to, state, accepted));
    let (new, copies) = match select(readying, pin!(queue.stop_waits())).await {
        Either::Left((ready, _)) => ready?,
        // The place is given up by the agent there when this end of its call is dropped.
        Either::Right(((), _)) => return Err("it is being stopped".to_owned()),
    };
    let commit = CommitMove {
        name: cx.name().to_owned(),
        old: cx.tid(),
        new,
    };
    let committed = cx.call(&Context::server(), commit).deadline(PATIENCE).await;
    let Err(error) = committed else {
        return Ok((new, copies));
    };
    // Refused, or nobody knows: then the service is asked what it decided.
    let abort = cx.call(&Context::server(), AbortMove { new });
    if abort.deadline(PATIENCE).await == Ok(true) {
        return Ok((new, copies));
    }
    give_up(cx, &agent, new);
    Err(error.reason())
}

async fn make_ready(
    cx: &Context,
    agent: &TaskRef,
    to: system::Place,
    state: Vec<u8>,
    accepted: &[Message],
) -> Result<(Tid, Vec<Option<UnderWay>>), String> {
    let deadline = cx.app().phase_timeout.saturating_mul(2);
    let request = MoveIn {
        name: cx.name().to_owned(),
        from: cx.tid(),
        processor: to.processor,
        state,
    };
    let new = cx.call(agent, request).deadline(deadline).await;
    let new = new.map_err(|error| error.reason())?;
    let place = scopeguard::guard(new, |place| give_up(cx, agent, place));
    let mut copies = Vec::new();
    for message in accepted {
        if message.is_abandoned() {
            copies.push(None);
            continue;
        }
        let load = load_of(cx, message).map_err(|fault| fault.to_string())?;
        copies.push(Some(
            begin(cx, agent, new, load, wait_of(cx, message)).await,
        ));
    }
    // Behind the copies on the same way: when this is answered, they are there.
    let sync = Transfer {
        to: new,
        what: Load::Sync,
    };
    let arrived = cx.call(agent, sync).deadline(deadline).await;
    arrived
        .map_err(|error| error.reason())?
        .map_err(|fault| fault.to_string())?;
    Ok((ScopeGuard::into_inner(place), copies))
}

/// Gives up a place that was made ready.
fn give_up(cx: &Context, agent: &TaskRef, place: Tid) {
    let how = Settled::Drop;
    let settle = Settle { place, how };
    cx.chassis().post_system(agent.tid(), settle);
}

/// How long the sender of a message waits. What was accepted has to arrive.
fn wait_of(cx: &Context, message: &Message) -> Duration {
    match (&message.envelope.reply, message.deadline()) {
        (Some(_), Some(deadline)) => deadline.since(cx.now()),
        _ => PATIENCE,
    }
}

fn load_of(cx: &Context, message: &Message) -> Result<Load, Fault> {
    let body = message.envelope.data.to_bytes()?;
    let left = message.deadline().map(|deadline| deadline.since(cx.now()));
    Ok(Load::Message(Forwarded {
        from: message.from(),
        command: message.command(),
        flags: message.header().flags.bits(),
        trace: message.trace(),
        left_ns: left.map(|left| u64::try_from(left.as_nanos()).unwrap_or(u64::MAX)),
        body,
        reply: message.header().flags.contains(Flags::REPLY_WAIT),
    }))
}

/// Sends a load. It is on its way when this returns.
async fn begin(cx: &Context, agent: &TaskRef, to: Tid, what: Load, deadline: Duration) -> UnderWay {
    let call = cx.call(agent, Transfer { to, what }).deadline(deadline);
    let mut load: UnderWay = Box::pin(call.into_future());
    match poll_fn(|cx| Poll::Ready(load.as_mut().poll(cx))).await {
        Poll::Ready(ended) => Box::pin(std::future::ready(ended)),
        Poll::Pending => load,
    }
}

/// Sends on what still comes to the old place, in its order, until nobody can send there any more.
pub(crate) async fn forward(cx: &Context, queue: &TaskQueue, departed: Departed) {
    let Departed { to, accepted } = departed;
    let agent = agent_of(to.chassis());
    for (message, load) in accepted {
        if let Some(load) = load {
            see_through(cx, message.envelope.reply, load);
        }
    }
    while let Some(batch) = queue.next_held().await {
        let mut fences = Vec::new();
        for message in batch {
            match message.command() {
                Fence::CODE => fences.push(message),
                // About the old place only.
                ChassisDown::CODE | Broke::CODE => {}
                StopTask::CODE => {
                    if let Some(message) = stop_for(to, message) {
                        send_on(cx, &agent, to, message).await;
                    }
                }
                _ if message.is_abandoned() => {}
                _ => send_on(cx, &agent, to, message).await,
            }
        }
        // Behind everything that came before it, of either priority.
        for fence in fences {
            pass_fence(cx, &agent, to, fence).await;
        }
    }
}

/// An order to stop that concerns the new place too; one that stops a chassis ends here.
fn stop_for(to: Tid, message: Message) -> Option<Message> {
    let data = message.envelope.data.to_bytes().ok();
    let order: Option<StopTask> = data.and_then(|bytes| postcard::from_bytes(&bytes).ok());
    if order.is_none_or(|order| order.on.is_none_or(|on| on == to.chassis())) {
        return Some(message);
    }
    if let Ok((_, reply)) = message.open::<StopTask>() {
        // A reply cannot fail.
        let _ = reply.ok(());
    }
    None
}

async fn send_on(cx: &Context, agent: &TaskRef, to: Tid, message: Message) {
    let load = match load_of(cx, &message) {
        Ok(load) => load,
        Err(fault) => return message.refuse(fault),
    };
    let deadline = wait_of(cx, &message);
    let load = begin(cx, agent, to, load, deadline).await;
    see_through(cx, message.envelope.reply, load);
}

/// Takes the answer of the new place back to the sender. Outlives the old place.
fn see_through(cx: &Context, slot: Option<ReplySlot>, mut load: UnderWay) {
    let here = cx.clone();
    let seeing = async move {
        let answer = loop {
            if let Ok(ended) = here.timeout(LOOK, &mut load).await {
                break ended.unwrap_or_else(|error| Err(error.fault));
            }
            if slot.as_ref().is_some_and(ReplySlot::is_abandoned) {
                return;
            }
        };
        if let Some(slot) = slot {
            slot.answer(answer.map(Data::Bytes));
        }
    };
    cx.inner.processor.spawn(seeing, None);
}

async fn pass_fence(cx: &Context, agent: &TaskRef, to: Tid, fence: Message) {
    let sender = fence.from().chassis();
    let Ok((Fence { chassis }, reply)) = fence.open::<Fence>() else {
        return;
    };
    if sender != chassis && cx.chassis().is_linked(chassis) {
        // A reply cannot fail, here and below.
        let _ = reply.fail("that chassis may still send something");
        return;
    }
    let load = begin(cx, agent, to, Load::Gate(chassis), PATIENCE).await;
    let passing = async move {
        let _ = match load.await {
            Ok(Ok(_)) => reply.ok(()),
            Ok(Err(fault)) => reply.fail(fault.to_string()),
            Err(error) => reply.fail(error),
        };
    };
    cx.inner.processor.spawn(passing, None);
}
