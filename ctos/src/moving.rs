//! Moving a running task to another processor, process or host: nothing sent to it is lost, doubled or
//! reordered.
//!
//! 1. Between two messages the old place asks the handler for its state and ends it. Messages that come
//!    from now on wait and are not accepted.
//! 2. The new place builds the handler, which takes the state over and passes the startup phases, but
//!    takes no messages yet. It is sent copies of the messages that the old place had accepted.
//! 3. The task identification service gives the name to the new place. This is the moment: before it,
//!    any failure leaves the task where it was, with its state and its queue; after it, the old place
//!    only sends on what still comes to it, and replies take the way back.
//! 4. Every chassis turns to the new place by itself and sends a fence by the old one. The new place
//!    keeps what comes straight from a chassis until the fence of that chassis has arrived, so the two
//!    ways of one sender never mix. When all fences are through, the old place is given up.
//!
//! It knows how a task leaves ([`depart`], [`forward`]) and how it comes ([`arrive`], [`deliver`]). Who
//! decides is `names.rs`, who carries out is `agent.rs`.

mod place;

use std::{
    cell::RefCell,
    collections::BTreeMap,
    future::{Future, IntoFuture, poll_fn},
    panic::AssertUnwindSafe,
    pin::{Pin, pin},
    rc::Rc,
    sync::Arc,
    task::Poll,
    time::Duration,
};

use futures_util::{
    FutureExt,
    future::{Either, select},
};
use tokio::sync::oneshot;

use crate::{
    call::{CallError, Fault, ReplySlot},
    chassis::{Chassis, WaitFor},
    context::{Context, TaskRef},
    mailbox::{Acceptance, TaskQueue},
    message::{Command, Data, Flags, Message, Replier, Tid},
    processor::panic_text,
    runner::{Origin, Runner, TaskSpec, drop_handler, record, start_at},
    supervise::Ending,
    system::{
        self, AbortMove, Broke, ChassisDown, CommitMove, Delivered, Fence, Forwarded, Load, MoveIn,
        MoveOut, MoveTask, Rebound, Settle, Settled, StopTask, Transfer,
    },
    task::{Handled, Phase},
};

pub(crate) use place::{NoPlace, find_place, place_text};

/// How often a message that is on its way is looked after: does its sender still wait?
const LOOK: Duration = Duration::from_millis(10);

/// The deadline of what must end by itself: the last resort against a chassis that stands still.
const PATIENCE: Duration = Duration::from_secs(60);

/// After this time nobody is still in the middle of sending a message to where the task was.
const QUIET: Duration = Duration::from_secs(1);

/// A load on its way to the new place.
type UnderWay = Pin<Box<dyn Future<Output = Result<Delivered, CallError>>>>;

impl Context {
    /// Moves a running task to `CHASSIS` or `CHASSIS:PROCESSOR` while others send to it; answers with
    /// its place. Its handler must have been registered with
    /// [`Registry::handover`](crate::registry::Registry::handover).
    ///
    /// # Errors
    /// Why the task stays where it is; it goes on there.
    pub async fn move_task(&self, task: &str, to: &str) -> Result<String, CallError> {
        let request = MoveTask {
            task: task.to_owned(),
            to: to.to_owned(),
        };
        let limit = PATIENCE + self.app().phase_timeout.saturating_mul(4);
        self.call(&Self::server(), request).deadline(limit).await
    }
}

fn agent_of(chassis: u8) -> TaskRef {
    TaskRef::new("agent", system::agent_tid(chassis))
}

// -- the new place ---------------------------------------------------------------------------------

/// What a task that comes from another place brings, and how it learns whether it stays.
pub(crate) struct Arrival {
    pub(crate) state: Vec<u8>,
    /// Told when the handler could begin.
    pub(crate) ready: oneshot::Sender<Result<(), String>>,
    /// Whether it does.
    pub(crate) settled: oneshot::Receiver<bool>,
}

/// The tasks that are on their way to a chassis, by their new ids.
#[derive(Clone, Default)]
pub(crate) struct Arrivals(Rc<RefCell<BTreeMap<Tid, Expected>>>);

struct Expected {
    /// Where it comes from.
    from: Tid,
    settle: oneshot::Sender<bool>,
}

impl Arrivals {
    /// Makes a place for a task that comes here; the answer is sent when its handler could begin.
    pub(crate) fn expect(&self, cx: &Context, request: MoveIn, reply: Replier<MoveIn>) {
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
            let limit = here.app().phase_timeout.saturating_mul(2);
            let why = match here.timeout(limit, starting).await {
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
    pub(crate) fn settle(&self, place: Tid, stays: bool) -> bool {
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
    pub(crate) fn lost(&self, cx: &Context, peer: u8) {
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
    let kind = chassis.registry.kind(&config.handler);
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
    let record = record(&request.name, new, Some(&config), processor);
    let everybody = chassis.others().chain([chassis.index()]);
    record.mailbox.close_gates(everybody.collect());
    let spec = TaskSpec {
        record,
        config: Some(config),
        commands: kind.commands_shared(),
        build: kind.builder(),
    };
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
pub(crate) async fn arrive(runner: &mut Runner, arrival: Arrival) -> bool {
    let cx = runner.cx.clone();
    let limit = cx.app().phase_timeout;
    let settling = AssertUnwindSafe(cx.timeout(limit, settle_in(runner, &arrival.state)));
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
            handler.take_over(&cx, state)?;
        }
        handler.phase(&cx, phase).await?;
        runner.entered(phase);
    }
    Ok(())
}

/// Brings a message that was sent to the old place into the queue at the new one. The reply of the
/// transfer is the reply to the message.
pub(crate) fn deliver(cx: &Context, to: Tid, message: Forwarded, reply: Replier<Transfer>) {
    let chassis = cx.chassis();
    let wait = if message.reply {
        WaitFor::Reply
    } else {
        WaitFor::Acceptance
    };
    let priority = Flags::from_bits(message.flags & Flags::HIGH_PRIORITY.bits());
    let left = message.left_ns.map(Duration::from_nanos);
    let data = Data::Bytes(message.body);
    let sent_on = Message::with_data(to, message.from, message.command, data)
        .flagged(priority.with(Flags::FORWARDED))
        .in_trace(message.trace)
        .until(left.map(|left| cx.now() + left));
    let mut waiting = chassis.dispatch(sent_on, wait);
    let here = cx.clone();
    cx.spawn(async move {
        loop {
            if let Ok(answer) = here.timeout(LOOK, &mut waiting).await {
                let bytes = answer.and_then(|data| {
                    data.into_bytes().map_err(|error| Fault::BadPayload {
                        text: error.to_string(),
                    })
                });
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

// -- the old place ---------------------------------------------------------------------------------

/// A task that has left: where it went, and what was sent after it so far.
pub(crate) struct Departed {
    to: Tid,
    accepted: Vec<(Message, Option<UnderWay>)>,
}

/// Takes the task to another place. `None` when it stays; then it needs a new handler if its old one is
/// gone.
pub(crate) async fn depart(runner: &mut Runner, message: Message) -> Option<Departed> {
    let (MoveOut { to }, reply) = message.open::<MoveOut>().ok()?;
    let state = match give_state(runner) {
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
fn give_state(runner: &mut Runner) -> Result<Vec<u8>, String> {
    if runner.is_child() {
        return Err(
            "it belongs to the task that started it, which can be moved instead".to_owned(),
        );
    }
    if !runner.is_running() {
        return Err("it can be moved between phase run and its stop only".to_owned());
    }
    let handler = runner.handler.as_mut().ok_or("it is being restarted")?;
    let given = std::panic::catch_unwind(AssertUnwindSafe(|| handler.hand_over()));
    match given {
        Ok(Some(Ok(state))) => Ok(state),
        Ok(Some(Err(error))) => Err(error.to_string()),
        Ok(None) => Err("its handler passes no state on; see `task::Handover`".to_owned()),
        Err(panic) => {
            let text = panic_text(panic.as_ref());
            runner.cx.when_broken()(&format!("it panicked while it gave its state: {text}"));
            Err(format!("it panicked while it gave its state: {text}"))
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
    let chassis = cx.chassis();
    let give_up = Settle {
        place: new,
        how: Settled::Drop,
    };
    chassis.post_system(agent.tid(), give_up);
    Err(error.reason())
}

async fn make_ready(
    cx: &Context,
    agent: &TaskRef,
    to: system::Place,
    state: Vec<u8>,
    accepted: &[Message],
) -> Result<(Tid, Vec<Option<UnderWay>>), String> {
    let limit = cx.app().phase_timeout.saturating_mul(2);
    let request = MoveIn {
        name: cx.name().to_owned(),
        from: cx.tid(),
        processor: to.processor,
        state,
    };
    let new = cx.call(agent, request).deadline(limit).await;
    let new = new.map_err(|error| error.reason())?;
    let place = Place {
        cx,
        agent,
        place: Some(new),
    };
    let mut copies = Vec::new();
    for message in accepted {
        if is_given_up(message) {
            copies.push(None);
            continue;
        }
        let load = load_of(cx, message).map_err(|fault| format!("{fault:?}"))?;
        copies.push(Some(
            begin(cx, agent, new, load, wait_of(cx, message)).await,
        ));
    }
    // Behind the copies on the same way: when this is answered, they are there.
    let sync = Transfer {
        to: new,
        what: Load::Sync,
    };
    let arrived = cx.call(agent, sync).deadline(limit).await;
    arrived
        .map_err(|error| error.reason())?
        .map_err(|fault| format!("{fault:?}"))?;
    place.keep();
    Ok((new, copies))
}

/// A place that was made ready; dropped, it is given up.
struct Place<'a> {
    cx: &'a Context,
    agent: &'a TaskRef,
    place: Option<Tid>,
}

impl Place<'_> {
    fn keep(mut self) {
        self.place = None;
    }
}

impl Drop for Place<'_> {
    fn drop(&mut self) {
        if let Some(place) = self.place {
            let how = Settled::Drop;
            let settle = Settle { place, how };
            self.cx.chassis().post_system(self.agent.tid(), settle);
        }
    }
}

fn is_given_up(message: &Message) -> bool {
    message
        .letter
        .reply
        .as_ref()
        .is_some_and(ReplySlot::is_abandoned)
}

/// How long the sender of a message waits. What was accepted has to arrive.
fn wait_of(cx: &Context, message: &Message) -> Duration {
    match (&message.letter.reply, message.deadline()) {
        (Some(_), Some(deadline)) => deadline.since(cx.now()),
        _ => PATIENCE,
    }
}

fn load_of(cx: &Context, message: &Message) -> Result<Load, Fault> {
    let body = message
        .letter
        .data
        .to_bytes()
        .map_err(|error| Fault::BadPayload {
            text: error.to_string(),
        })?;
    let left = message.deadline().map(|deadline| deadline.since(cx.now()));
    Ok(Load::Message(Forwarded {
        from: message.from(),
        command: message.command(),
        flags: message.header().flags.bits(),
        trace: message.trace(),
        left_ns: left.map(|left| u64::try_from(left.as_nanos()).unwrap_or(u64::MAX)),
        body,
        reply: message.letter.reply.is_some(),
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
            see_through(cx, message.letter.reply, Acceptance::Silent, load);
        }
    }
    while let Some(batch) = queue.next_held().await {
        let mut fences = Vec::new();
        for (message, acceptance) in batch {
            match message.command() {
                Fence::CODE => fences.push(message),
                // About the old place only.
                ChassisDown::CODE | Broke::CODE => {}
                StopTask::CODE => {
                    if let Some(message) = stop_for(to, message) {
                        send_on(cx, &agent, to, message, acceptance).await;
                    }
                }
                _ if is_given_up(&message) || acceptance.is_abandoned() => {}
                _ => send_on(cx, &agent, to, message, acceptance).await,
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
    let data = message.letter.data.to_bytes().ok();
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

async fn send_on(cx: &Context, agent: &TaskRef, to: Tid, message: Message, acceptance: Acceptance) {
    let load = match load_of(cx, &message) {
        Ok(load) => load,
        Err(fault) => {
            message.refuse(fault.clone());
            return acceptance.tell(Err(fault));
        }
    };
    let deadline = wait_of(cx, &message);
    let load = begin(cx, agent, to, load, deadline).await;
    see_through(cx, message.letter.reply, acceptance, load);
}

/// Takes the answer of the new place back to the sender. Outlives the old place.
fn see_through(cx: &Context, slot: Option<ReplySlot>, acceptance: Acceptance, mut load: UnderWay) {
    let here = cx.clone();
    let seeing = async move {
        let answer = loop {
            if let Ok(ended) = here.timeout(LOOK, &mut load).await {
                break ended.unwrap_or_else(|error| Err(error.fault));
            }
            let given_up = match &slot {
                Some(slot) => slot.is_abandoned(),
                None => acceptance.is_abandoned(),
            };
            if given_up {
                return;
            }
        };
        match slot {
            Some(slot) => slot.answer(answer.map(Data::Bytes)),
            None => acceptance.tell(answer.map(|_| ())),
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
            Ok(Err(fault)) => reply.fail(format!("{fault:?}")),
            Err(error) => reply.fail(error),
        };
    };
    cx.inner.processor.spawn(passing, None);
}

// -- everybody else --------------------------------------------------------------------------------

/// Turns this chassis to the new place of a task: its messages go straight there from now on, and a
/// fence follows those that went by the old place.
pub(crate) async fn turn(cx: &Context, rebound: &Rebound, new: Tid) -> Handled {
    let chassis = cx.chassis();
    chassis
        .directory
        .rebind(&rebound.name, rebound.old, Some(new));
    quiet(cx, chassis).await;
    let old = TaskRef::new(rebound.name.as_str(), rebound.old);
    let fence = Fence {
        chassis: chassis.index(),
    };
    Ok(cx.call(&old, fence).deadline(PATIENCE).await?)
}

/// Fences off a chassis that cannot reach the old place of a task any more, or whose fence cannot reach
/// the new one: done by the chassis that boots, which reaches everybody who is left.
pub(crate) async fn turn_for(cx: &Context, rebound: &Rebound, new: Tid, chassis: u8) -> bool {
    let old = TaskRef::new(rebound.name.as_str(), rebound.old);
    let agent = agent_of(new.chassis());
    let began = cx.now();
    while cx.now().since(began) < PATIENCE {
        // Good when the old place has lost its link to the chassis: nothing more can come from there.
        if cx.call(&old, Fence { chassis }).await.is_ok() {
            return true;
        }
        // Good when the new place has lost its link to the old one: nothing more can come by it.
        let gate = Transfer {
            to: new,
            what: Load::Without {
                chassis,
                old: rebound.old.chassis(),
            },
        };
        match cx.call(&agent, gate).await {
            Ok(Ok(_)) => return true,
            Err(error) if error.is_gone() => return true,
            _ => cx.sleep(LOOK).await,
        }
    }
    false
}

/// Ends when every processor of the chassis has come out of whatever it was sending when this began.
async fn quiet(cx: &Context, chassis: &Arc<Chassis>) {
    let mut passed = Vec::new();
    for (_, processor) in &chassis.processors {
        let (through, passing) = oneshot::channel::<()>();
        processor.inject(move |_| drop(through));
        passed.push(passing);
    }
    // A processor whose handler never returns is not in the middle of sending after that time.
    let all = futures_util::future::join_all(passed);
    if cx.timeout(QUIET, all).await.is_err() {
        tracing::warn!("a processor is busy while a task moves");
    }
}
