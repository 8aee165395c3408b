mod model;
#[path = "../../../tests/shared/random_nets.rs"]
mod random_nets;

use std::sync::Arc;

use ctos::diagnostic::Source;
use proptest::{collection::vec, prelude::*};
use rand::SeedableRng as _;
use rand_chacha::ChaCha8Rng;

use super::*;
use crate::{compile, net::TransitionId};
use random_nets::{random_net, random_transitions};

fn execution(text: &str) -> Execution {
    let net = compile::net(&Source::new("test.net", text)).unwrap_or_else(|f| panic!("{f}"));
    Execution::new(Arc::new(net))
}

fn id(execution: &Execution, name: &str) -> TransitionId {
    execution.net().transition(name).unwrap()
}

fn tokens(execution: &Execution, place: &str) -> u32 {
    execution.marking()[execution.net().place(place).unwrap().index()]
}

fn enabled(execution: &Execution) -> Vec<String> {
    let net = execution.net();
    execution.enabled().map(|t| net[t].name.clone()).collect()
}

const ACTION: &str = "net n
place a = 2, b, c
transition work
  in a*2
  do something
  out b
  fail c
";

#[test]
fn tokens_are_taken_at_the_start_and_put_at_completion() {
    let mut execution = execution(ACTION);
    let work = id(&execution, "work");
    assert!(matches!(execution.fire(work), Err(FireError::HasAction(_))));
    let firing = execution.start(work).unwrap();
    assert_eq!(execution.marking(), [0, 0, 0]);
    assert!(enabled(&execution).is_empty());
    execution.complete(firing).unwrap();
    assert_eq!(execution.marking(), [0, 1, 0]);
    assert_eq!(execution.complete(firing), Err(FireError::NotRunning(0)));
}

#[test]
fn a_failed_action_takes_the_failure_branch_or_gives_everything_back() {
    let mut with_branch = execution(ACTION);
    let work = id(&with_branch, "work");
    let firing = with_branch.start(work).unwrap();
    with_branch.fail(firing).unwrap();
    assert_eq!(with_branch.marking(), [0, 0, 1]);

    let mut without = execution(&ACTION.replace("  fail c\n", ""));
    let firing = without.start(work).unwrap();
    without.fail(firing).unwrap();
    assert_eq!(without.marking(), [2, 0, 0]);
    assert_eq!(enabled(&without), ["work"]);
}

#[test]
fn weights_read_arcs_and_inhibitors_decide_what_is_enabled() {
    let mut execution = execution(
        "net n\nplace a = 1, r, h = 2\ntransition t\n  in a*2\n  read r\n  inhibit h*2\n  out a*2\ntransition u\n  in h\n",
    );
    assert_eq!(enabled(&execution), ["u"]);
    execution.put_tokens("a", 1).unwrap();
    execution.put_tokens("r", 1).unwrap();
    assert_eq!(enabled(&execution), ["u"]);
    execution.fire(id(&execution, "u")).unwrap();
    assert_eq!(enabled(&execution), ["t", "u"]);
    execution.fire(id(&execution, "t")).unwrap();
    assert_eq!((tokens(&execution, "a"), tokens(&execution, "r")), (2, 1));
}

#[test]
fn conflicts_go_to_priority_then_to_declared_order_or_to_chance() {
    let text = "net n\nplace a = 1, b\ntransition low\n  in a\ntransition first\n  in a\n  priority 1\ntransition second\n  in a\n  priority 1\n";
    let mut execution = execution(text);
    let net = Arc::clone(execution.net());
    let name = |id: Option<TransitionId>| net[id.unwrap()].name.clone();
    assert_eq!(
        name(execution.choose(&mut Conflicts::Declared, |_| true)),
        "first"
    );
    let mut random = Conflicts::Random(Box::new(ChaCha8Rng::seed_from_u64(7)));
    let mut seen: Vec<String> = (0..64)
        .map(|_| name(execution.choose(&mut random, |_| true)))
        .collect();
    seen.sort();
    seen.dedup();
    assert_eq!(seen, ["first", "second"]);
}

#[test]
fn an_enabling_function_and_its_negation_let_exactly_one_through() {
    let mut execution = execution(
        "net n\nplace a = 1\ntransition again\n  in a\n  when more\ntransition done\n  in a\n  when not more\n",
    );
    for (more, expected) in [(true, "again"), (false, "done")] {
        let chosen = execution.choose(&mut Conflicts::Declared, |when| {
            assert_eq!(when.function, "more");
            more
        });
        assert_eq!(execution.net()[chosen.unwrap()].name, expected);
    }
}

const TAPE: &str = "net n
place free = 1, busy
command go -> gone, lost
command stop -> stopped
transition begin
  in free
  tape go
  do begin
  out busy
transition end
  in busy
  out free
  write gone
transition halt
  in free
  tape stop
  out free
  write stopped
";

#[test]
fn one_command_is_in_progress_at_a_time_and_gets_its_answer() {
    let mut execution = execution(TAPE);
    assert!(enabled(&execution).is_empty());
    let go = execution.put_symbol("go", vec!["x".into()]).unwrap();
    let stop = execution.put_symbol("stop", Vec::new()).unwrap();
    assert_eq!(enabled(&execution), ["begin"]);
    let firing = execution.start(id(&execution, "begin")).unwrap();
    assert_eq!(execution.tape().current().unwrap().arguments, ["x"]);
    execution.complete(firing).unwrap();
    assert_eq!(enabled(&execution), ["end"]);
    let end = id(&execution, "end");
    let effects = execution.fire(end).unwrap();
    let symbol = "gone".to_owned();
    assert_eq!(
        effects.written,
        Some(Written::Answer {
            command: go,
            symbol
        })
    );
    assert_eq!(enabled(&execution), ["halt"]);
    let halt = id(&execution, "halt");
    let effects = execution.fire(halt).unwrap();
    let symbol = "stopped".to_owned();
    assert_eq!(
        effects.written,
        Some(Written::Answer {
            command: stop,
            symbol
        })
    );
}

#[test]
fn a_symbol_goes_back_to_the_tape_when_its_action_fails() {
    let mut execution = execution(TAPE);
    execution.put_symbol("go", Vec::new()).unwrap();
    let firing = execution.start(id(&execution, "begin")).unwrap();
    assert!(enabled(&execution).is_empty());
    execution.fail(firing).unwrap();
    assert_eq!(enabled(&execution), ["begin"]);
    assert_eq!(execution.tape().waiting().count(), 1);
}

#[test]
fn a_symbol_outside_the_alphabet_is_refused_with_the_alphabet() {
    let error = execution(TAPE).put_symbol("gp", Vec::new()).unwrap_err();
    assert_eq!(
        error.to_string(),
        "net `n` takes no command `gp`; it takes: go, stop"
    );
}

#[test]
fn a_symbol_written_without_a_command_is_reported() {
    let mut execution = execution(TAPE);
    execution.put_tokens("busy", 1).unwrap();
    let end = id(&execution, "end");
    let symbol = "gone".to_owned();
    assert_eq!(
        execution.fire(end).unwrap().written,
        Some(Written::Unasked { symbol })
    );
}

#[test]
fn remote_outputs_are_handed_to_the_caller() {
    let mut execution =
        execution("net n\nplace a = 1, p3\ntransition t1\n  in a\n  out p1@other*2, p3\n");
    let t1 = id(&execution, "t1");
    let effects = execution.fire(t1).unwrap();
    let [arc] = effects.remote else {
        panic!("{effects:?}")
    };
    assert_eq!(
        (arc.net.as_str(), arc.place.as_str(), arc.weight),
        ("other", "p1", 2)
    );
    assert_eq!(tokens(&execution, "p3"), 1);
}

#[test]
fn a_place_that_is_full_stops_the_firing_and_nothing_changes() {
    let mut execution = execution("net n\nplace a = 1, b = 1\ntransition t\n  in a\n  out b\n");
    execution.put_tokens("b", u32::MAX - 1).unwrap();
    let t = id(&execution, "t");
    assert_eq!(execution.fire(t), Err(FireError::TooManyTokens("b".into())));
    assert_eq!(tokens(&execution, "a"), 1);
    assert!(execution.put_tokens("b", 1).is_err());
    assert!(matches!(
        execution.put_tokens("x", 1),
        Err(FireError::UnknownPlace { .. })
    ));
}

proptest! {
    #[test]
    fn the_incremental_enabled_set_is_the_one_that_the_marking_gives(transitions in random_transitions(), picks in vec(any::<prop::sample::Index>(), 0..60)) {
        let mut execution = execution(&random_net(&transitions));
        for pick in picks {
            let by_definition: Vec<usize> = transitions
                .iter()
                .enumerate()
                .filter(|(_, (from, _, inhibit))| {
                    from.iter().zip(execution.marking()).all(|(w, t)| u32::from(*w) <= *t)
                        && execution.marking().get(usize::from(*inhibit)).is_none_or(|t| *t < 4)
                })
                .map(|(index, _)| index)
                .collect();
            let choices: Vec<TransitionId> = execution.enabled().collect();
            prop_assert_eq!(choices.iter().map(|t| t.index()).collect::<Vec<_>>(), by_definition);
            if choices.is_empty() { break; }
            execution.fire(*pick.get(&choices)).unwrap();
        }
    }
}

#[test]
fn weights_say_how_often_chance_chooses_each() {
    let mut execution = execution(
        "net n\nplace a = 1\ntransition seldom\n  in a\ntransition often\n  in a\n  weight 3\n",
    );
    let often = id(&execution, "often");
    let mut random = Conflicts::Random(Box::new(ChaCha8Rng::seed_from_u64(1)));
    let count = (0..10_000)
        .filter(|_| execution.choose(&mut random, |_| true) == Some(often))
        .count();
    // Four standard deviations of a binomial with p = 3/4.
    assert!((7_327..=7_673).contains(&count), "{count}");
}

#[test]
fn chance_leaves_out_what_an_enabling_function_forbids_and_goes_on_to_lower_priorities() {
    let mut execution = execution(
        "net n\nplace a = 1\ntransition t\n  in a\n  when f\n  priority 1\ntransition u\n  in a\n  when not f\n  priority 1\ntransition v\n  in a\n  when f\n  priority 1\ntransition w\n  in a\n",
    );
    let net = Arc::clone(execution.net());
    let mut random = Conflicts::Random(Box::new(ChaCha8Rng::seed_from_u64(2)));
    let mut chosen = |say: &dyn Fn(bool) -> bool| -> Vec<String> {
        let mut names: Vec<String> = (0..200)
            .filter_map(|_| execution.choose(&mut random, |when| say(when.negated)))
            .map(|id| net[id].name.clone())
            .collect();
        names.sort();
        names.dedup();
        names
    };
    assert_eq!(chosen(&|_| true), ["t", "v"]);
    assert_eq!(chosen(&|_| false), ["u"]);
    // A function that answers differently each time it is asked is no function; here it lets none pass.
    assert_eq!(chosen(&|negated| negated), ["w"]);
}

#[test]
fn an_action_that_takes_too_long_fails_at_its_limit_by_the_time_that_the_caller_tells() {
    let text = ACTION.replace("  do something\n", "  do something\n  within 5 ms\n");
    let mut execution = execution(&text);
    let work = id(&execution, "work");
    execution.advance_to(1_000);
    let firing = execution.start(work).unwrap();
    assert_eq!(execution.next_deadline(), Some((5_001_000, firing)));
    execution.advance_to(5_000_999);
    assert!(execution.expire().unwrap().is_none());
    execution.advance_to(5_001_000);
    execution.advance_to(7);
    assert_eq!(execution.now_ns(), 5_001_000);
    let (over, transition, _) = execution.expire().unwrap().unwrap();
    assert_eq!((over, transition), (firing, work));
    assert_eq!(execution.marking(), [0, 0, 1]);
    assert!(execution.expire().unwrap().is_none());
    assert_eq!(execution.next_deadline(), None);
}

#[test]
fn a_cancelled_firing_puts_everything_back_whatever_its_failure_branch_says() {
    let mut execution = execution(ACTION);
    let work = id(&execution, "work");
    let firing = execution.start(work).unwrap();
    execution.cancel(firing).unwrap();
    assert_eq!(execution.marking(), [2, 0, 0]);
    assert_eq!(execution.cancel(firing), Err(FireError::NotRunning(0)));
}

#[test]
fn room_in_a_place_is_kept_for_a_running_firing() {
    let mut execution = execution(
        "net n\nplace a = 2, b = 0 capacity 1\ntransition work\n  in a\n  do something\n  out b\ntransition clear\n  in b\n",
    );
    let work = id(&execution, "work");
    let firing = execution.start(work).unwrap();
    assert!(!execution.is_enabled(work), "the room of b is promised");
    assert!(matches!(
        execution.put_tokens("b", 1),
        Err(FireError::Full {
            tokens: 1,
            capacity: 1,
            more: 1,
            ..
        })
    ));
    execution.complete(firing).unwrap();
    assert!(!execution.is_enabled(work), "b is full");
    execution.fire(id(&execution, "clear")).unwrap();
    assert!(execution.is_enabled(work));
}

#[test]
fn limited_servers_limit_the_actions_that_go_on() {
    let mut execution =
        execution("net n\nplace a = 5\ntransition work\n  in a\n  do something\n  servers 2\n");
    let work = id(&execution, "work");
    let first = execution.start(work).unwrap();
    execution.start(work).unwrap();
    assert_eq!(
        execution.start(work),
        Err(FireError::NotEnabled("work".into()))
    );
    execution.fail(first).unwrap();
    assert!(execution.start(work).is_ok());
}

#[test]
fn a_full_tape_takes_no_more_commands() {
    let mut execution = execution(TAPE);
    execution.limit_tape(1);
    execution.put_symbol("go", Vec::new()).unwrap();
    let error = execution.put_symbol("stop", Vec::new()).unwrap_err();
    assert_eq!(
        error.to_string(),
        "the tape of net `n` is full: 1 commands wait"
    );
    // One that has been read waits no more.
    execution.start(id(&execution, "begin")).unwrap();
    assert!(execution.put_symbol("stop", Vec::new()).is_ok());
}

#[test]
fn events_say_what_was_moved_and_keep_their_numbers_when_old_ones_are_forgotten() {
    let mut execution = execution(
        "net n\nplace a = 3, b, junk = 4\ntransition t\n  in a\n  reset junk\n  out b*2\n",
    );
    execution.record_events(2);
    let t = id(&execution, "t");
    for _ in 0..3 {
        execution.fire(t).unwrap();
    }
    assert_eq!(execution.next_event(), 3);
    let events: Vec<Event<'_>> = execution.events_since(0).collect();
    assert_eq!(
        events.iter().map(|event| event.number).collect::<Vec<_>>(),
        [1, 2]
    );
    execution.record_events(8);
    execution.put_tokens("a", 1).unwrap();
    execution.put_tokens("junk", 4).unwrap();
    execution.fire(t).unwrap();
    let last = execution.events_since(5).next().unwrap();
    let Happened::Fired {
        consumed,
        emptied,
        produced,
        ..
    } = last.happened
    else {
        panic!("{last:?}")
    };
    let of = |arcs: &[crate::net::Arc]| -> Vec<(usize, u32)> {
        arcs.iter()
            .map(|arc| (arc.place.index(), arc.weight))
            .collect()
    };
    assert_eq!(
        (of(consumed), of(emptied), of(produced)),
        (vec![(0, 1)], vec![(2, 4)], vec![(1, 2)])
    );
    execution.forget_events(6);
    assert_eq!(execution.events_since(0).count(), 0);
    assert_eq!(execution.next_event(), 6);
}

#[test]
fn a_state_of_another_net_or_a_broken_one_is_refused() {
    let execution = execution(TAPE);
    let state = execution.state();
    let restore = |state: State| Execution::restore(Arc::clone(execution.net()), state).map(|_| ());
    assert_eq!(restore(state.clone()), Ok(()));
    assert!(matches!(
        restore(State {
            net: "other".into(),
            ..state.clone()
        }),
        Err(RestoreError::OtherNet { .. })
    ));
    assert!(matches!(
        restore(State {
            marking: vec![1],
            ..state.clone()
        }),
        Err(RestoreError::Places { .. })
    ));
    let running = |firing, transition| RunningFiring {
        firing: FiringId(firing),
        transition: TransitionId(transition),
        command: None,
        deadline_ns: None,
    };
    for (running, firings) in [
        (vec![running(0, 9)], 1),
        (vec![running(0, 0)], 0),
        (vec![running(1, 0), running(0, 0)], 2),
        (Vec::new(), u64::MAX),
    ] {
        let broken = State {
            running,
            firings,
            ..state.clone()
        };
        assert!(matches!(restore(broken), Err(RestoreError::Broken { .. })));
    }
}
