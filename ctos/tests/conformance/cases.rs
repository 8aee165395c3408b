//! What must hold wherever the two tasks are. A case is written once and knows no placement, except
//! through the ids of the tasks it was given.

use std::{
    collections::VecDeque,
    fmt::Debug,
    future::{Future, IntoFuture, poll_fn},
    task::Poll,
    time::Duration,
};

use ctos::{
    Blob, Command as _,
    call::{CallError, Fault},
    message::{CommandInfo, Message},
    recent::{Ending, TaskLook},
    registry::Registry,
    system::{AppResult, Introspect, Ping, Statistics},
    task::{Context, EventHandler, Handled, NameError, Phase, TaskRef},
};
use futures_util::{
    FutureExt,
    future::{LocalBoxFuture, MaybeDone, join, join_all, maybe_done},
};
use serde::Deserialize;

use crate::peer::{
    Block, CallBack, CallOther, Echo, Flood, Fly, Forget, Hold, Log, Mirror, Note, Open, Panic,
    Produce, Refuse, Release, Trail, Value, Waiting, WrongEcho,
};

pub struct Case {
    pub name: &'static str,
    run: fn(Suite) -> LocalBoxFuture<'static, Outcome>,
}

macro_rules! cases {
    ($($name:ident),+ $(,)?) => {
        pub const CASES: &[Case] = &[$(Case {
            name: stringify!($name),
            run: |suite| Box::pin($name(suite)),
        }),+];
    };
}

cases![
    a_call_brings_back_what_the_receiver_answers,
    every_task_answers_a_ping_and_says_what_it_takes,
    an_unknown_name_is_an_error_that_lists_the_known_ones,
    an_unknown_command_is_an_error_that_lists_what_is_taken,
    data_of_another_type_is_an_error_and_not_a_crash,
    a_refusal_arrives_in_the_receivers_words,
    a_request_without_an_answer_ends_at_once,
    a_panic_is_contained_and_the_queue_is_kept,
    a_call_ends_at_its_deadline_and_is_not_begun_afterwards,
    a_call_that_is_dropped_is_not_begun_afterwards,
    a_send_that_is_given_up_is_not_delivered_afterwards,
    a_full_queue_makes_senders_wait_and_loses_nothing,
    more_than_may_wait_is_refused_and_counted,
    only_a_sender_on_the_same_chassis_can_try,
    messages_of_each_sender_keep_their_order_under_load,
    a_task_that_moves_under_load_keeps_every_message_in_its_order,
    high_priority_overtakes_even_a_full_queue,
    deferred_replies_come_in_any_order,
    calls_cross_in_both_directions,
    tasks_that_wait_for_each_other_end_with_an_error,
    many_calls_at_once_from_one_task_each_get_their_own_reply,
    a_mebibyte_goes_there_and_back,
    images_stay_the_same_while_anybody_has_them,
    what_is_too_large_for_a_link_is_refused_and_the_link_lives,
    a_trace_and_the_time_left_travel_with_the_message,
    every_task_says_what_it_has_done,
    a_task_that_is_looked_at_shows_its_last_messages,
    a_semaphore_of_the_app_counts_its_permits_and_gives_them_on,
];

type Outcome = Result<(), Failure>;

/// What went wrong, as text: it travels to the process that runs the tests.
pub struct Failure(String);

impl<E: std::fmt::Display> From<E> for Failure {
    fn from(error: E) -> Self {
        Self(error.to_string())
    }
}

#[track_caller]
fn same<T: PartialEq + Debug>(found: T, expected: T) -> Outcome {
    check(found == expected, || {
        format!("found {found:?}, expected {expected:?}")
    })
}

#[track_caller]
fn check(holds: bool, otherwise: impl FnOnce() -> String) -> Outcome {
    if holds {
        return Ok(());
    }
    let place = std::panic::Location::caller();
    Err(Failure(format!("{place}: {}", otherwise())))
}

/// An error must carry the fault, and name both tasks and the command to a person.
#[track_caller]
fn faulty<T: Debug>(
    result: Result<T, CallError>,
    command: &str,
    is: impl FnOnce(&Fault) -> bool,
) -> Outcome {
    match result {
        Ok(value) => check(false, || format!("{command} answered {value:?}")),
        Err(error) => {
            let text = error.to_string();
            let named = ["`driver`", "`peer`", &format!("`{command}`")]
                .iter()
                .all(|name| text.contains(*name));
            check(named && is(&error.fault), || format!("{error:?}: {text}"))
        }
    }
}

/// The tasks that a case plays with.
struct Suite {
    cx: Context,
    peer: TaskRef,
    near: TaskRef,
    gate: TaskRef,
}

impl Suite {
    async fn new(cx: Context) -> Result<Self, NameError> {
        Ok(Self {
            peer: cx.task("peer").await?,
            near: cx.task("near").await?,
            gate: cx.task("gate").await?,
            cx,
        })
    }

    fn crosses_chassis(&self) -> bool {
        self.peer.tid().chassis() != self.cx.tid().chassis()
    }

    async fn log(&self) -> Result<Vec<(u32, u32)>, CallError> {
        self.cx.call(&self.peer, Log {}).await
    }

    fn note(&self, number: u32) -> LocalBoxFuture<'static, Result<(), CallError>> {
        let note = Note { sender: 0, number };
        Box::pin(self.cx.call(&self.peer, note).into_future())
    }

    fn sent(&self, number: u32) -> LocalBoxFuture<'static, Result<(), CallError>> {
        let note = Note { sender: 0, number };
        Box::pin(self.cx.send(&self.peer, note).into_future())
    }

    /// Makes the peer's handler wait. What is returned ends when [`Self::open`] has let it go.
    async fn block(&self) -> Result<LocalBoxFuture<'static, Result<(), CallError>>, CallError> {
        let mut blocked = self.cx.call(&self.peer, Block {}).into_future();
        begin(&mut blocked).await;
        while self.cx.call(&self.gate, Waiting {}).await? == 0 {
            self.cx.sleep(Duration::from_micros(200)).await;
        }
        Ok(Box::pin(blocked))
    }

    async fn open(&self) -> Result<(), CallError> {
        self.cx.call(&self.gate, Open {}).await
    }
}

/// Makes a call without waiting for its end.
async fn begin<F: Future + Unpin>(future: &mut F) {
    poll_fn(|cx| {
        let begun = std::pin::Pin::new(&mut *future).poll(cx);
        assert!(begun.is_pending(), "it ended as soon as it was begun");
        Poll::Ready(())
    })
    .await;
}

/// The end of what was begun.
async fn ended<T>(mut begun: MaybeDone<LocalBoxFuture<'static, T>>) -> T {
    std::pin::Pin::new(&mut begun).await;
    std::pin::Pin::new(&mut begun).take_output().unwrap()
}

/// Sends without waiting for the end, which may come at once.
trait Begun<T> {
    async fn begun(self) -> MaybeDone<LocalBoxFuture<'static, T>>;
}

impl<T> Begun<T> for LocalBoxFuture<'static, T> {
    async fn begun(self) -> MaybeDone<Self> {
        let mut begun = maybe_done(self);
        let _ = poll_fn(|cx| Poll::Ready(std::pin::Pin::new(&mut begun).poll(cx))).await;
        begun
    }
}

const DEADLINE: Duration = Duration::from_millis(20);

async fn a_trace_and_the_time_left_travel_with_the_message(suite: Suite) -> Outcome {
    let cx = suite.cx.new_trace();
    let limit = Duration::from_secs(3);
    let call = cx.call(&suite.near, Trail { to: Vec::new() });
    let first = call.deadline(limit).await?;
    let to = vec!["near".to_owned()];
    let second = cx.call(&suite.peer, Trail { to }).deadline(limit).await?;
    let traces: Vec<u64> = first
        .iter()
        .chain(&second)
        .map(|(trace, _)| *trace)
        .collect();
    same(traces, vec![cx.trace(); 3])?;
    let left = second.first().and_then(|(_, left)| *left).unwrap_or(0);
    check(left > 0 && left <= 3_000_000, || {
        format!("{left} us were left of 3 s")
    })?;
    let other = suite.cx.new_trace();
    check(other.trace() != cx.trace(), || {
        "two traces have one id".to_owned()
    })
}

async fn every_task_says_what_it_has_done(suite: Suite) -> Outcome {
    let mut before = suite.cx.call(&suite.peer, Statistics {}).await?;
    // It comes to its last startup phase, which is a message as well, when this task may be there already.
    while before.phase != Some(Phase::Run) {
        before = suite.cx.call(&suite.peer, Statistics {}).await?;
    }
    suite.note(1).await?;
    let refused = suite.cx.call(&suite.peer, Refuse {}).await;
    check(refused.is_err(), || "it was not refused".to_owned())?;
    let after = suite.cx.call(&suite.peer, Statistics {}).await?;
    // The two, and the question before.
    same(after.handled - before.handled, 3)?;
    same(after.failed - before.failed, 1)?;
    same(after.phase, Some(Phase::Run))
}

async fn a_task_that_is_looked_at_shows_its_last_messages(suite: Suite) -> Outcome {
    // From the first look on.
    let before = suite.cx.look_at(&suite.peer, &[Echo::CODE]).await?;
    let me = suite.cx.name().to_owned();
    // The peer may come to its startup phase, a message of the runtime, only now.
    let know = |look: &TaskLook| -> Vec<(String, String, bool)> {
        let last = look.last.iter().filter(|one| one.from == me);
        last.map(|one| {
            let done = matches!(one.ended, Some((_, Ending::Done)));
            (one.from.clone(), one.command.clone(), done)
        })
        .collect()
    };
    suite.note(1).await?;
    let echo = Echo {
        value: Value::Nothing,
    };
    suite.cx.call(&suite.peer, echo).await?;
    let refused = suite.cx.call(&suite.peer, Refuse {}).await;
    check(refused.is_err(), || "it was not refused".to_owned())?;
    let after = suite.cx.look_at(&suite.peer, &[]).await?;
    let new = know(&after);
    let new = new.get(know(&before).len()..).unwrap_or_default().to_vec();
    let expected = [("note", true), ("refuse", false)];
    same(
        new,
        expected
            .map(|(command, done)| (me.clone(), command.to_owned(), done))
            .to_vec(),
    )?;
    let moments = after.last.windows(2);
    check(
        moments.clone().all(|two| two[0].began <= two[1].began),
        || "they are not in order".to_owned(),
    )?;
    same(after.task.name, suite.peer.name().to_owned())?;
    // While its handler waits, too.
    let blocked = suite.block().await?;
    let mut busy = suite.cx.look_at(&suite.peer, &[]).await?;
    // Its processor notes whom it waits for when there is time for that.
    while busy.task.waits.is_empty() {
        busy = suite.cx.look_at(&suite.peer, &[]).await?;
    }
    suite.open().await?;
    blocked.await?;
    let at_hand = busy
        .last
        .last()
        .map(|one| (one.command.clone(), one.ended.is_none()));
    same(at_hand, Some(("block".to_owned(), true)))?;
    same(busy.task.waits.len(), 1)?;
    Ok(())
}

async fn a_call_brings_back_what_the_receiver_answers(suite: Suite) -> Outcome {
    for value in [
        Value::Nothing,
        Value::Pair(-0.125, Some(i64::MIN)),
        Value::Named {
            text: "Stäubli \u{1F916}".to_owned(),
            list: vec![f32::MIN_POSITIVE, f32::MAX],
        },
    ] {
        let request = Echo {
            value: value.clone(),
        };
        same(suite.cx.call(&suite.peer, request).await?, value)?;
    }
    Ok(())
}

async fn every_task_answers_a_ping_and_says_what_it_takes(suite: Suite) -> Outcome {
    suite.cx.call(&suite.peer, Ping {}).await?;
    let takes = suite.cx.call(&suite.peer, Introspect {}).await?;
    let echo = takes.iter().find(|command| command.name == "echo");
    let doc = echo.map(|command| command.doc.as_str());
    same(doc, Some("Answers what it was given."))
}

async fn an_unknown_name_is_an_error_that_lists_the_known_ones(suite: Suite) -> Outcome {
    match suite.cx.task("pear").await {
        Err(NameError::Unknown { from, name, known }) => {
            same((from.as_str(), name.as_str()), ("driver", "pear"))?;
            let expected = [
                "driver",
                "far_sender",
                "gate",
                "near",
                "near_sender",
                "peer",
                "roamer",
            ];
            same(known, expected.map(str::to_owned).to_vec())
        }
        other => check(false, || format!("{other:?}")),
    }
}

async fn an_unknown_command_is_an_error_that_lists_what_is_taken(suite: Suite) -> Outcome {
    let answer = suite.cx.call(&suite.peer, Fly {}).await;
    faulty(
        answer,
        "fly",
        |fault| matches!(fault, Fault::UnknownCommand { takes } if takes.iter().any(|name| name == "echo")),
    )
}

async fn data_of_another_type_is_an_error_and_not_a_crash(suite: Suite) -> Outcome {
    let answer = suite.cx.call(&suite.peer, WrongEcho { value: 250 }).await;
    faulty(answer, "echo", |fault| {
        matches!(fault, Fault::BadPayload { .. })
    })?;
    suite.cx.call(&suite.peer, Ping {}).await?;
    Ok(())
}

async fn a_refusal_arrives_in_the_receivers_words(suite: Suite) -> Outcome {
    let answer = suite.cx.call(&suite.peer, Refuse {}).await;
    faulty(
        answer,
        "refuse",
        |fault| matches!(fault, Fault::Refused { text } if text == "the arm is cold"),
    )
}

async fn a_request_without_an_answer_ends_at_once(suite: Suite) -> Outcome {
    let began = suite.cx.now();
    let answer = suite.cx.call(&suite.peer, Forget {}).await;
    faulty(answer, "forget", |fault| *fault == Fault::NoReply)?;
    let took = suite.cx.now().since(began);
    check(took < ctos::DEFAULT_DEADLINE, || format!("took {took:?}"))
}

async fn a_panic_is_contained_and_the_queue_is_kept(suite: Suite) -> Outcome {
    suite.note(1).await?;
    let blocked = suite.block().await?;
    let mut panics = suite.cx.call(&suite.peer, Panic {}).into_future();
    let mut note = suite.note(2);
    let mut log = suite.cx.call(&suite.peer, Log {}).into_future();
    begin(&mut panics).await;
    begin(&mut note).await;
    begin(&mut log).await;
    suite.open().await?;
    blocked.await?;
    faulty(
        panics.await,
        "panic",
        |fault| matches!(fault, Fault::Panicked { text } if text == "as it was told"),
    )?;
    note.await?;
    // Built anew, it knows nothing of the first note; the second one waited in the queue.
    same(log.await?, vec![(0, 2)])?;
    // Its processor, and the other tasks there, go on.
    suite.cx.call(&suite.gate, Ping {}).await?;
    Ok(())
}

async fn a_call_ends_at_its_deadline_and_is_not_begun_afterwards(suite: Suite) -> Outcome {
    let blocked = suite.block().await?;
    let late = Note {
        sender: 0,
        number: 1,
    };
    let answer = suite.cx.call(&suite.peer, late).deadline(DEADLINE).await;
    faulty(answer, "note", |fault| {
        *fault == Fault::Deadline { after: DEADLINE }
    })?;
    let never = suite.cx.call(&suite.peer, Ping {}).deadline(Duration::ZERO);
    faulty(never.await, "ping", |fault| {
        matches!(fault, Fault::Deadline { .. })
    })?;
    suite.open().await?;
    blocked.await?;
    same(suite.log().await?, Vec::new())
}

async fn a_call_that_is_dropped_is_not_begun_afterwards(suite: Suite) -> Outcome {
    let blocked = suite.block().await?;
    let mut dropped = suite.note(1);
    begin(&mut dropped).await;
    let mut kept = suite.note(2);
    begin(&mut kept).await;
    drop(dropped);
    suite.open().await?;
    blocked.await?;
    kept.await?;
    same(suite.log().await?, vec![(0, 2)])
}

async fn a_send_that_is_given_up_is_not_delivered_afterwards(suite: Suite) -> Outcome {
    let blocked = suite.block().await?;
    for number in 0..4 {
        suite.sent(number).await?;
    }
    let note = Note {
        sender: 0,
        number: 4,
    };
    let answer = suite.cx.send(&suite.peer, note).deadline(DEADLINE).await;
    faulty(answer, "note", |fault| {
        *fault == Fault::Deadline { after: DEADLINE }
    })?;
    suite.open().await?;
    blocked.await?;
    suite.sent(5).await?;
    same(
        suite.log().await?,
        [0, 1, 2, 3, 5].map(|number| (0, number)).to_vec(),
    )
}

async fn a_full_queue_makes_senders_wait_and_loses_nothing(suite: Suite) -> Outcome {
    let blocked = suite.block().await?;
    for number in 0..4 {
        suite.sent(number).await?;
    }
    let mut waiting: Vec<_> = (4..40).map(|number| suite.sent(number)).collect();
    for sent in &mut waiting {
        begin(sent).await;
    }
    // The queue holds four; nobody else is told that its message was taken.
    suite.cx.sleep(DEADLINE).await;
    for sent in &mut waiting {
        begin(sent).await;
    }
    suite.open().await?;
    blocked.await?;
    for sent in join_all(waiting).await {
        sent?;
    }
    same(
        suite.log().await?,
        (0..40).map(|number| (0, number)).collect(),
    )
}

async fn more_than_may_wait_is_refused_and_counted(suite: Suite) -> Outcome {
    let blocked = suite.block().await?;
    let calls: Vec<_> = (0..100).map(|number| suite.note(number)).collect();
    let opened = async {
        suite.cx.call(&suite.near, Ping {}).await?;
        suite.cx.sleep(DEADLINE).await;
        suite.open().await
    };
    let (answers, opened) = join(join_all(calls), opened).await;
    opened?;
    blocked.await?;
    let mut noted = Vec::new();
    for (number, answer) in (0..).zip(answers) {
        match answer {
            Ok(()) => noted.push((0, number)),
            refused => faulty(refused, "note", |fault| {
                *fault == Fault::Full { capacity: 4 }
            })?,
        }
    }
    // Four in the queue, sixteen times as many who wait.
    same(noted.len(), 68)?;
    same(suite.log().await?, noted)
}

async fn only_a_sender_on_the_same_chassis_can_try(suite: Suite) -> Outcome {
    let blocked = suite.block().await?;
    let note = |number| Note { sender: 0, number };
    for number in 0..4 {
        let tried = suite.cx.try_send(&suite.peer, note(number));
        if suite.crosses_chassis() {
            faulty(
                tried,
                "note",
                |fault| matches!(fault, Fault::Elsewhere { chassis } if chassis == "b"),
            )?;
        } else {
            tried?;
        }
    }
    if !suite.crosses_chassis() {
        let tried = suite.cx.try_send(&suite.peer, note(4));
        faulty(tried, "note", |fault| *fault == Fault::Full { capacity: 4 })?;
    }
    suite.open().await?;
    blocked.await?;
    let expected = if suite.crosses_chassis() { 0 } else { 4 };
    same(
        suite.log().await?,
        (0..expected).map(|number| (0, number)).collect(),
    )
}

async fn a_task_that_moves_under_load_keeps_every_message_in_its_order(suite: Suite) -> Outcome {
    const COUNT: u32 = 200;
    const UNDER_WAY: usize = 8;
    let cx = &suite.cx;
    let roamer = cx.task("roamer").await?;
    let mut floods = Vec::new();
    for (sender, name) in (1..).zip(["near", "near_sender", "far_sender"]) {
        let task = cx.task(name).await?;
        let to = "roamer".to_owned();
        let count = COUNT;
        floods.push(cx.call(&task, Flood { to, sender, count }).into_future());
    }
    // Several at a time, so that some go by the old place while others go straight to the new one.
    let own = async {
        let mut under_way = VecDeque::new();
        for number in 0..COUNT {
            let note = Note { sender: 0, number };
            let sent = cx.send(&roamer, note).into_future().boxed_local();
            under_way.push_back(sent.begun().await);
            if under_way.len() == UNDER_WAY
                && let Some(first) = under_way.pop_front()
            {
                ended(first).await?;
            }
        }
        for sent in under_way {
            ended(sent).await?;
        }
        Ok::<(), CallError>(())
    };
    let moves = async {
        let places = if suite.crosses_chassis() {
            ["a:second", "b", "a", "b", "a:second", "b"]
        } else {
            ["a:second", "a", "a:second", "a", "a:second", "a"]
        };
        for place in places {
            cx.move_task("roamer", place).await?;
        }
        Ok::<(), CallError>(())
    };
    let ((floods, own), moves) = join(join(join_all(floods), own), moves).await;
    moves?;
    own?;
    for flood in floods {
        flood?;
    }
    let log = cx.call(&roamer, Log {}).await?;
    for sender in 0..4 {
        let numbers = log.iter().filter(|note| note.0 == sender);
        let numbers: Vec<u32> = numbers.map(|note| note.1).collect();
        same(numbers, (0..COUNT).collect())?;
    }
    same(log.len(), 4 * COUNT as usize)
}

async fn messages_of_each_sender_keep_their_order_under_load(suite: Suite) -> Outcome {
    const COUNT: u32 = 300;
    let mut floods = Vec::new();
    for (sender, name) in (1..).zip(["near", "near_sender", "far_sender"]) {
        let task = suite.cx.task(name).await?;
        let to = "peer".to_owned();
        let count = COUNT;
        floods.push(
            suite
                .cx
                .call(&task, Flood { to, sender, count })
                .into_future(),
        );
    }
    // Sends and calls of one task keep their order among each other, too.
    let own = async {
        for number in 0..COUNT {
            if number % 3 == 0 {
                suite.note(number).await?;
            } else {
                suite.sent(number).await?;
            }
        }
        Ok::<(), CallError>(())
    };
    let (floods, own) = join(join_all(floods), own).await;
    own?;
    for flood in floods {
        flood?;
    }
    let log = suite.log().await?;
    for sender in 0..4 {
        let numbers = log
            .iter()
            .filter(|note| note.0 == sender)
            .map(|note| note.1);
        same(numbers.collect::<Vec<_>>(), (0..COUNT).collect())?;
    }
    same(log.len(), 4 * COUNT as usize)
}

async fn high_priority_overtakes_even_a_full_queue(suite: Suite) -> Outcome {
    let blocked = suite.block().await?;
    for number in 0..4 {
        suite.sent(number).await?;
    }
    let mut waits = suite.sent(4);
    begin(&mut waits).await;
    for number in [90, 91] {
        let note = Note { sender: 0, number };
        suite.cx.send(&suite.peer, note).high_priority().await?;
    }
    suite.open().await?;
    blocked.await?;
    waits.await?;
    let expected = [90, 91, 0, 1, 2, 3, 4].map(|number| (0, number));
    same(suite.log().await?, expected.to_vec())
}

async fn deferred_replies_come_in_any_order(suite: Suite) -> Outcome {
    let hold = |number| suite.cx.call(&suite.peer, Hold { number }).into_future();
    // Behind the three in the queue.
    let order = vec![3, 1, 2];
    let release = suite.cx.call(&suite.peer, Release { order });
    let (answers, released) = join(join_all([1, 2, 3].map(hold)), release.into_future()).await;
    released?;
    for (number, answer) in (1..).zip(answers) {
        same(answer?, number * 10)?;
    }
    Ok(())
}

async fn calls_cross_in_both_directions(suite: Suite) -> Outcome {
    let near_sender = suite.cx.task("near_sender").await?;
    let far_sender = suite.cx.task("far_sender").await?;
    let calls = |to: &str| CallOther {
        to: to.to_owned(),
        count: 200,
        deadline_ms: 30_000,
    };
    let there = suite
        .cx
        .call(&near_sender, calls("peer"))
        .deadline(Duration::from_secs(60));
    let back = suite
        .cx
        .call(&far_sender, calls("near"))
        .deadline(Duration::from_secs(60));
    let (there, back) = join(there.into_future(), back.into_future()).await;
    same((there?, back?), (200, 200))
}

async fn tasks_that_wait_for_each_other_end_with_an_error(suite: Suite) -> Outcome {
    let request = CallBack {
        to: "peer".to_owned(),
        back: "near".to_owned(),
    };
    // `near` waits for `peer`, which calls `near`, which handles one message at a time.
    same(suite.cx.call(&suite.near, request).await?, 0)?;
    // Nothing is left of it.
    suite.cx.call(&suite.near, Ping {}).await?;
    suite.cx.call(&suite.peer, Ping {}).await?;
    Ok(())
}

async fn many_calls_at_once_from_one_task_each_get_their_own_reply(suite: Suite) -> Outcome {
    let calls = (0..60).map(|number| {
        let value = Value::Pair(f64::from(number), Some(i64::from(number)));
        suite.cx.call(&suite.peer, Echo { value }).into_future()
    });
    for (number, answer) in (0..).zip(join_all(calls).await) {
        same(
            answer?,
            Value::Pair(f64::from(number), Some(i64::from(number))),
        )?;
    }
    Ok(())
}

async fn a_mebibyte_goes_there_and_back(suite: Suite) -> Outcome {
    let bytes: Vec<u8> = (0..1 << 20).map(|index: u32| (index % 251) as u8).collect();
    let request = Mirror {
        bytes: bytes.clone().into(),
    };
    let mirrored = suite.cx.call(&suite.peer, request).await?;
    check(*mirrored == *bytes, || {
        "the bytes changed on their way".to_owned()
    })
}

async fn images_stay_the_same_while_anybody_has_them(suite: Suite) -> Outcome {
    // More than fits into what chassis share, so that some go the ordinary way.
    let mut kept = Vec::new();
    for number in 0..80_u8 {
        let bytes = Blob::from(vec![number; 300_000]);
        kept.push((number, bytes.clone()));
        kept.push((number, suite.cx.call(&suite.peer, Mirror { bytes }).await?));
        if number % 3 == 0 {
            kept.swap_remove(usize::from(number) / 3);
        }
    }
    for (number, image) in kept {
        check(*image == *vec![number; 300_000], || {
            format!("image {number} has changed")
        })?;
    }
    Ok(())
}

async fn what_is_too_large_for_a_link_is_refused_and_the_link_lives(suite: Suite) -> Outcome {
    let size = 65 << 20;
    let limit = Duration::from_secs(60);
    let too_large =
        |fault: &Fault| matches!(fault, Fault::BadPayload { text } if text.contains("at most"));
    let bytes = vec![0; size].into();
    let there = suite
        .cx
        .call(&suite.peer, Mirror { bytes })
        .deadline(limit)
        .await;
    let back = suite
        .cx
        .call(&suite.peer, Produce { size })
        .deadline(limit)
        .await;
    if suite.crosses_chassis() {
        faulty(there.map(|bytes| bytes.len()), "mirror", too_large)?;
        faulty(back.map(|bytes| bytes.len()), "produce", too_large)?;
    } else {
        same((there?.len(), back?.len()), (size, size))?;
    }
    suite.cx.call(&suite.peer, Ping {}).await?;
    Ok(())
}

#[derive(Deserialize)]
struct Args {
    case: String,
}

/// Runs one case and ends the app with what came of it.
struct Driver {
    case: String,
}

impl EventHandler for Driver {
    async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
        cx.default_processing(message)
    }

    async fn phase(&mut self, cx: &Context, phase: Phase) -> Handled {
        if phase != Phase::Run {
            return Ok(());
        }
        let case = CASES.iter().find(|case| case.name == self.case);
        let run = case.ok_or("there is no such case")?.run;
        let (cx, child) = (cx.clone(), cx.clone());
        child.spawn(async move {
            let outcome = match Suite::new(cx.clone()).await {
                Ok(suite) => run(suite).await,
                Err(error) => Err(error.into()),
            };
            cx.finish(AppResult {
                ok: outcome.is_ok(),
                text: outcome.err().map_or(String::new(), |Failure(text)| text),
                json: "{}".to_owned(),
            });
        });
        Ok(())
    }
}

pub fn register(registry: &mut Registry) {
    const NONE: [CommandInfo; 0] = [];
    registry.handler("suite.driver", &NONE, |cx: &Context| {
        let Args { case } = cx.args::<Args>()?;
        Ok(Driver { case })
    });
}

async fn a_semaphore_of_the_app_counts_its_permits_and_gives_them_on(suite: Suite) -> Outcome {
    let cx = &suite.cx;
    let board = cx.semaphore("app/board", 2)?;
    let (first, second) = (board.acquire().await?, board.acquire().await?);
    let refused = board.acquire().deadline(Duration::from_millis(20)).await;
    let text = refused
        .err()
        .map(|error| error.to_string())
        .unwrap_or_default();
    check(
        text.contains("held by `driver` for ") && text.contains(" and `driver` for "),
        || text,
    )?;
    // Given up while the answer may be on its way: nothing is lost.
    for _ in 0..20 {
        let waits = async { board.acquire().await.map(drop) };
        let _ = cx.timeout(Duration::from_micros(50), waits).await;
    }
    let third = board.acquire();
    let released = async {
        cx.sleep(Duration::from_millis(20)).await;
        drop(first);
    };
    let (third, ()) = join(third.into_future(), released).await;
    let third = third?;
    same(board.try_acquire().await?.is_some(), false)?;
    drop((second, third));
    let all = (board.try_acquire().await?, board.try_acquire().await?);
    same((all.0.is_some(), all.1.is_some()), (true, true))?;
    let start = cx.barrier("app/start", 2)?;
    let (one, other) = join(start.wait(), start.wait()).await;
    same((one?.last, other?.last), (false, true))
}
