use std::task::Waker;

use super::*;
use crate::{call::ReplySlot, message::Data, time::Clock};

const LIMIT: Duration = Duration::from_secs(5);

fn look(calls: &mut Calls, key: CallKey) -> Looked {
    let mut timers = Timers::<()>::default();
    let waits = || LocalWake::Waker(Waker::noop().clone());
    calls.look(key, &mut None, &mut timers, waits).0
}

fn number(looked: Looked) -> Option<u8> {
    match looked {
        Looked::Ended(Brought::Data(letter)) => letter.take().ok(),
        _ => None,
    }
}

fn answer(number: u8) -> Brought {
    Ok(Data::of(number)).into()
}

/// The answer to a call in a letter that brings its ticket.
fn bringing(ticket: Ticket, number: u8) -> Box<Letter> {
    let mut letter = Letter::blank();
    letter.write(Data::of(number));
    letter.set_reply(Some(ReplySlot::call(ticket)));
    letter
}

fn at(millis: u64) -> Instant {
    Instant::START + Duration::from_millis(millis)
}

#[test]
fn one_slot_serves_call_after_call_and_keeps_late_answers_from_the_next() {
    let (mut calls, home) = (Calls::default(), Arc::default());
    let first = calls.begin(&home, LIMIT);
    let (gone, copy) = (first.key(), first.shared.clone());
    drop(calls.give_up(gone));
    assert!(first.is_abandoned());
    let second = calls.begin(&home, LIMIT);
    let key = second.key();
    assert!(
        Arc::ptr_eq(&copy, &second.shared),
        "a free slot was not used"
    );
    let late = calls.answer(gone, Some(first), answer(1));
    assert!(matches!(late, Given::Unwanted { .. }));
    drop(late);
    assert!(matches!(look(&mut calls, key), Looked::Waiting));
    let given = calls.answer(key, Some(second), answer(2));
    assert!(matches!(given, Given::Taken(Some(_))));
    assert_eq!(number(look(&mut calls, key)), Some(2));
    // The ticket came home with its answer, and is used again.
    assert_eq!(Arc::strong_count(&copy), 3);
}

#[test]
fn a_call_that_ends_soon_never_needs_a_timer_and_one_that_lasts_gets_one() {
    let (mut calls, home) = (Calls::default(), Arc::default());
    let ticket = calls.begin(&home, LIMIT);
    let key = ticket.key();
    let Started::List(slot) = calls.start(key, at(1)) else {
        panic!("nobody would look after it");
    };
    // Its answer comes, and its slot waits again, before anybody has looked.
    drop(calls.answer(key, Some(ticket), answer(1)));
    assert_eq!(number(look(&mut calls, key)), Some(1));
    assert_eq!(calls.settle(slot), None);
    let ticket = calls.begin(&home, LIMIT);
    assert!(matches!(calls.start(ticket.key(), at(7)), Started::List(_)));
    assert!(matches!(calls.start(ticket.key(), at(8)), Started::Done));
    let due = at(7) + circle::LONG;
    assert_eq!(calls.settle(slot), Some((ticket.key(), due)));
    drop(calls.answer(ticket.key(), Some(ticket), answer(1)));
}

#[test]
fn a_call_with_little_time_has_its_timer_at_once() {
    let (mut calls, home) = (Calls::default(), Arc::default());
    let ticket = calls.begin(&home, SOON / 2);
    let key = ticket.key();
    assert!(matches!(calls.start(key, at(1)), Started::Urgent));
    assert_eq!(calls.settle_call(key), Some((key, at(1) + SOON / 2)));
    assert_eq!(calls.deadline(key), Some(at(1) + SOON / 2));
    drop(calls.fired(key));
    assert!(ticket.is_abandoned());
    assert!(matches!(look(&mut calls, key), Looked::Late(limit) if limit == SOON / 2));
}

#[test]
fn a_long_wait_is_told_once_before_the_deadline() {
    let (mut calls, home) = (Calls::default(), Arc::default());
    let ticket = calls.begin(&home, LIMIT);
    let key = ticket.key();
    let _ = calls.start(key, at(0));
    let fired = calls.fired(key);
    assert_eq!(fired.again, Some(at(0) + LIMIT));
    assert!(matches!(look(&mut calls, key), Looked::Long(_)));
    assert!(matches!(look(&mut calls, key), Looked::Waiting));
    assert!(!ticket.is_abandoned());
    assert_eq!(calls.fired(key).again, None);
    assert!(matches!(look(&mut calls, key), Looked::Late(LIMIT)));
    let late = calls.answer(key, Some(ticket), answer(1));
    assert!(matches!(late, Given::Taken(None) | Given::Unwanted { .. }));
}

#[test]
fn calls_made_while_a_processor_is_busy_are_looked_after_within_a_millisecond() {
    let clock = Clock::virtual_clock();
    let processor = Processor::new(Arc::default(), clock.clone());
    let ticket = processor.begin_call(LIMIT);
    processor.spawn(async {}, None);
    assert!(processor.poll_ready(0));
    assert_eq!(
        processor.next_deadline(),
        Some(Instant::START + circle::LONG)
    );
    processor.take_answer(ticket, answer(1));
}

#[test]
fn an_answer_that_nobody_has_looked_for_is_there_at_once_and_wakes_nobody() {
    let (mut calls, home) = (Calls::default(), Arc::default());
    let ticket = calls.begin(&home, LIMIT);
    let key = ticket.key();
    assert!(calls.take_answered(key).is_none(), "it is not there yet");
    assert!(calls.answer_unseen(&home, bringing(ticket, 1)).is_ok());
    let taken = calls.take_answered(key).unwrap();
    assert_eq!(taken.take::<u8>().unwrap(), 1);
    assert!(calls.take_answered(key).is_none(), "the call is over");
    // The slot and its ticket are used again, and the call before is over for good.
    let next = calls.begin(&home, LIMIT);
    assert_eq!(next.key().slot, key.slot);
    assert!(calls.take_answered(key).is_none());
    assert!(matches!(look(&mut calls, next.key()), Looked::Waiting));
}

#[test]
fn an_answer_that_somebody_waits_for_or_has_given_up_is_given_in_the_usual_way() {
    let (mut calls, home) = (Calls::default(), Arc::default());
    let ticket = calls.begin(&home, LIMIT);
    let key = ticket.key();
    assert!(matches!(look(&mut calls, key), Looked::Waiting));
    let mut back = calls.answer_unseen(&home, bringing(ticket, 1)).unwrap_err();
    let ticket = back.take_ticket();
    let given = calls.answer(key, ticket, Brought::Data(back));
    assert!(matches!(given, Given::Taken(Some(_))), "it is not woken");
    assert_eq!(number(look(&mut calls, key)), Some(1));
    let ticket = calls.begin(&home, LIMIT);
    drop(calls.give_up(ticket.key()));
    let mut back = calls.answer_unseen(&home, bringing(ticket, 2)).unwrap_err();
    assert!(back.ticket().is_some_and(Ticket::is_abandoned));
    // A late answer does not reach the next call, which has a ticket of its own.
    let next = calls.begin(&home, LIMIT);
    back.write(Data::of(3_u8));
    let mut back = calls.answer_unseen(&home, back).unwrap_err();
    assert!(back.take_ticket().is_some());
    assert!(matches!(look(&mut calls, next.key()), Looked::Waiting));
}
