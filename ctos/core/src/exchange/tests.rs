use std::task::Waker;

use super::*;
use crate::{
    envelope::Message,
    processor::{Processor, ProcessorHandle},
};
use ctos_message::{Data, Tid};
use ctos_time::Clock;

const DEADLINE: Duration = Duration::from_secs(5);

fn begin(calls: &mut Calls, home: &Arc<ProcessorHandle>, deadline: Duration) -> Ticket {
    calls.begin(|| home.clone(), at(1), deadline)
}

fn look(calls: &mut Calls, key: CallKey) -> Looked {
    let waits = || LocalWake::Waker(Waker::noop().clone());
    calls.look(key, waits, &mut None, |_| ())
}

fn number(looked: Looked) -> Option<u8> {
    match looked {
        Looked::Ended(Ok(envelope)) => envelope.data.take().ok(),
        _ => None,
    }
}

fn answer(number: u8) -> Returned {
    let (to, from) = (Tid::default(), Tid::default());
    Ok(Message::with_data(to, from, 0, Data::of(number)).envelope)
}

fn at(millis: u64) -> Instant {
    Instant::START + Duration::from_millis(millis)
}

#[test]
fn one_slot_serves_call_after_call_and_keeps_late_answers_from_the_next() {
    let (mut calls, home) = (Calls::default(), Arc::default());
    let first = begin(&mut calls, &home, DEADLINE);
    let gone = first.key();
    drop(calls.give_up(gone, |_| ()));
    assert!(first.is_abandoned());
    let second = begin(&mut calls, &home, DEADLINE);
    let key = second.key();
    assert_eq!(gone.slot, key.slot, "a free slot was not used");
    assert!(!second.is_abandoned());
    let late = calls.answer(gone, answer(1));
    assert!(late.is_err());
    assert!(matches!(look(&mut calls, key), Looked::Waiting));
    let given = calls.answer(key, answer(2));
    assert!(matches!(given, Ok(Some(_))));
    assert_eq!(number(look(&mut calls, key)), Some(2));
}

#[test]
fn a_call_with_little_time_is_looked_after_at_its_deadline() {
    let (mut calls, home) = (Calls::default(), Arc::default());
    let little = Duration::from_millis(1);
    let ticket = begin(&mut calls, &home, little);
    let key = ticket.key();
    assert_eq!(calls.settle(key), Some(at(1) + little));
    assert!(calls.fired(key).again.is_none());
    assert!(ticket.is_abandoned());
    assert!(
        matches!(look(&mut calls, key), Looked::Late(Fault::Deadline { after }) if after == little)
    );
}

#[test]
fn a_long_wait_is_told_once_before_the_deadline() {
    let (mut calls, home) = (Calls::default(), Arc::default());
    let ticket = begin(&mut calls, &home, DEADLINE);
    let key = ticket.key();
    assert_eq!(calls.settle(key), Some(at(1) + LONG));
    let fired = calls.fired(key);
    assert_eq!(fired.again, Some(at(1) + DEADLINE));
    assert!(matches!(look(&mut calls, key), Looked::Long));
    assert!(matches!(look(&mut calls, key), Looked::Waiting));
    assert!(!ticket.is_abandoned());
    assert_eq!(calls.fired(key).again, None);
    assert!(matches!(
        look(&mut calls, key),
        Looked::Late(Fault::Deadline { after: DEADLINE })
    ));
    let late = calls.answer(key, answer(1));
    assert!(late.is_err());
}

#[test]
fn a_call_that_has_ended_leaves_no_timer() {
    let processor = Processor::new(Arc::default(), Clock::virtual_clock());
    let ticket = processor.begin_call(Instant::START, DEADLINE);
    let key = ticket.key();
    let wait = Wait {
        activity: Arc::default(),
        to: "t".into(),
        tid: Tid::default(),
        command: "c",
        place: None,
    };
    processor.await_call(key, DEADLINE, wait);
    assert_eq!(processor.next_deadline(), Some(Instant::START + LONG));
    processor.enter();
    ticket.answer(answer(1));
    let cx = std::task::Context::from_waker(Waker::noop());
    assert_eq!(number(processor.poll_call(key, &cx)), Some(1));
    assert_eq!(processor.next_deadline(), None);
}
