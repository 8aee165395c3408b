//! How a task comes to its new place, and how what was sent after it does.

use std::{
    cell::RefCell, collections::BTreeMap, future::Future, panic::AssertUnwindSafe, pin::Pin,
    rc::Rc, time::Duration,
};

use futures_util::FutureExt;
use tokio::sync::oneshot;

use super::{LOOK, PATIENCE, QUIET};
use crate::{
    contain::panic_text,
    context::Context,
    envelope::{Message, Replier},
    handled::Handled,
    phase::Phase,
    runner::{Origin, Runner, TaskSpec, drop_handler, dynamic::Notice, start_at},
    system::{AbortMove, Forwarded, MoveIn, Transfer},
    tap::WaitFor,
};
use ctos_message::{ChassisNumber, Data, Flags, Tid};

/// What a task that comes from another place brings, and how it learns whether it stays.
pub struct Arrival {
    pub(crate) state: Vec<u8>,
    /// Told when the handler could begin.
    pub(crate) ready: oneshot::Sender<Result<(), String>>,
    /// Whether it does.
    pub(crate) settled: oneshot::Receiver<bool>,
}

/// The tasks that are on their way to a chassis, by their new ids.
#[derive(Clone, Default)]
pub struct Arrivals(Rc<RefCell<BTreeMap<Tid, Expected>>>);

struct Expected {
    /// Where it comes from.
    from: Tid,
    settle: oneshot::Sender<bool>,
}

impl Arrivals {
    /// Makes a place for a task that comes here; the answer is sent when its handler could begin.
    pub fn expect(&self, cx: &Context, request: MoveIn, reply: Replier<MoveIn>) {
        let from = request.from;
        let (settle, settled) = oneshot::channel();
        let (new, starting) = match make_place(cx, request, settled) {
            Ok(made) => made,
            Err(why) => {
                // A reply cannot fail, here and below.
                let _ = reply.fail(why);
                return;
            }
        };
        self.0.borrow_mut().insert(new, Expected { from, settle });
        let (arrivals, here) = (self.clone(), cx.clone());
        cx.spawn(async move {
            let deadline = here.app().phase_timeout.saturating_mul(2);
            let why = match here.timeout(deadline, starting).await {
                Ok(Ok(Ok(()))) if !reply.is_abandoned() => {
                    let _ = reply.ok(new);
                    return arrivals.see_settled(&here, new).await;
                }
                Ok(Ok(Ok(()))) => "nobody waits for it any more".to_owned(),
                Ok(Ok(Err(why))) => why,
                Ok(Err(_)) => "its processor has stopped".to_owned(),
                Err(elapsed) => format!("the new place is not ready: {elapsed}"),
            };
            arrivals.settle(new, false);
            let _ = reply.fail(why);
        });
    }

    /// Says what becomes of a place. Only the first word counts.
    pub fn settle(&self, place: Tid, stays: bool) -> bool {
        let expected = self.0.borrow_mut().remove(&place);
        expected.is_some_and(|expected| expected.settle.send(stays).is_ok())
    }

    /// The one who knows may be gone: then the task identification service is asked.
    async fn see_settled(&self, cx: &Context, place: Tid) {
        let began = cx.now();
        while self.0.borrow().contains_key(&place) {
            if cx.now().since(began) > PATIENCE.saturating_mul(2) {
                return self.ask(cx, place).await;
            }
            cx.sleep(QUIET).await;
        }
    }

    /// Chassis `peer` is gone: what comes from there is settled by what was decided before.
    pub fn lost(&self, cx: &Context, peer: ChassisNumber) {
        let expected = self.0.borrow();
        let from_peer = expected
            .iter()
            .filter(|(_, expected)| expected.from.chassis() == peer)
            .map(|(place, _)| *place);
        for place in from_peer {
            let (arrivals, here) = (self.clone(), cx.clone());
            cx.spawn(async move { arrivals.ask(&here, place).await });
        }
    }

    async fn ask(&self, cx: &Context, place: Tid) {
        let abort = cx.call(&Context::server(), AbortMove { new: place });
        let committed = abort.deadline(PATIENCE).await;
        self.settle(place, committed == Ok(true));
    }
}

type Starting =
    Pin<Box<dyn Future<Output = Result<Result<(), String>, oneshot::error::RecvError>>>>;

/// Begins to build the task at its new place, whose gates are closed.
fn make_place(
    cx: &Context,
    request: MoveIn,
    settled: oneshot::Receiver<bool>,
) -> Result<(Tid, Starting), String> {
    let chassis = cx.chassis().clone();
    let config = chassis.app.task(&request.name).cloned();
    let mut config = config.ok_or("it is not in the configuration of the new place")?;
    let registry = chassis.registry();
    let kind = registry.kind(&config.handler);
    let kind = kind.ok_or("nobody registered its event handler at the new place")?;
    let index = usize::from(request.processor);
    let (name, processor) = chassis
        .processors
        .get(index)
        .ok_or("there is no such processor")?;
    let slot = chassis.directory.free_slot(request.processor);
    let slot = slot.ok_or("the processor has had as many tasks as it can have in one run")?;
    let new = Tid::new(chassis.index(), request.processor, slot);
    chassis.name().clone_into(&mut config.chassis);
    name.clone_into(&mut config.processor);
    let recipe = kind.recipe_of(&config, &chassis.app, &registry);
    let spec = TaskSpec::new(&request.name, new, Some(config), recipe, processor);
    spec.record.mailbox.close_gates();
    let (ready, readied) = oneshot::channel();
    let (built, building) = oneshot::channel();
    let arrival = Arrival {
        state: request.state,
        ready,
        settled,
    };
    let home = chassis.clone();
    processor.inject(move |processor| {
        let result = start_at(&home, processor, spec, Origin::Moved(arrival));
        // Nobody listens any more when the move was given up.
        let _ = built.send(result.map_err(|error| error.to_string()));
    });
    let starting = async move {
        match building.await? {
            Ok(()) => readied.await,
            Err(why) => Ok(Err(why)),
        }
    };
    Ok((new, Box::pin(starting)))
}

/// Lets the handler take over and pass the phases; true when the place is the task's.
pub async fn arrive(runner: &mut Runner, arrival: Arrival) -> bool {
    let cx = runner.cx.clone();
    let deadline = cx.app().phase_timeout;
    let settling = AssertUnwindSafe(cx.timeout(deadline, settle_in(runner, &arrival.state)));
    let outcome = match settling.catch_unwind().await {
        Ok(Ok(Ok(()))) => Ok(()),
        Ok(Ok(Err(error))) => Err(error.to_string()),
        Ok(Err(elapsed)) => Err(elapsed.to_string()),
        Err(panic) => Err(format!("it panicked: {}", panic_text(panic.as_ref()))),
    };
    let ready = outcome.is_ok();
    // Nobody listens any more when the move was given up.
    let listened = arrival.ready.send(outcome).is_ok();
    let stays = ready && listened && arrival.settled.await.unwrap_or(false);
    if !stays {
        cx.cancel_children();
        if let Some(handler) = runner.handler.take() {
            drop_handler(&cx, handler);
        }
    }
    stays
}

async fn settle_in(runner: &mut Runner, state: &[u8]) -> Handled {
    let cx = runner.cx.clone();
    for phase in Phase::ALL {
        let handler = runner.handler.as_mut().ok_or("it has no handler")?;
        if phase == Phase::Create {
            cx.load_state().await?;
            runner.resumed = true;
            handler.take_over(&cx, state)?;
        }
        handler.tell(&cx, Notice::Phase(phase)).await?;
        runner.entered(phase);
    }
    Ok(())
}

/// Brings a message that was sent to the old place into the queue at the new one. The reply of the
/// transfer is the reply to the message.
pub fn deliver(cx: &Context, to: Tid, message: Forwarded, reply: Replier<Transfer>) {
    let chassis = cx.chassis();
    let wait = if message.reply {
        WaitFor::Reply
    } else {
        WaitFor::Acceptance
    };
    let priority = Flags::from_bits_retain(message.flags) & Flags::HIGH_PRIORITY;
    let left = message.left_ns.map(Duration::from_nanos);
    let data = Data::Bytes(message.body);
    let sent_on = Message::with_data(to, message.from, message.command, data)
        .flagged(priority | Flags::FORWARDED)
        .in_trace(message.trace)
        .until(left.map(|left| cx.now() + left));
    let mut waiting = chassis.dispatch(sent_on, wait);
    let here = cx.clone();
    cx.spawn(async move {
        loop {
            if let Ok(answer) = here.timeout(LOOK, &mut waiting).await {
                let bytes = answer.and_then(|data| Ok(data.into_bytes()?));
                // A reply cannot fail.
                let _ = reply.ok(bytes);
                return;
            }
            if reply.is_abandoned() {
                return;
            }
        }
    });
}
