use super::*;
use crate::analysis::{
    returns::returns,
    samples::{KANBAN, buffer, kanban, model, philosophers},
};

fn all(model: &Model) -> Explored<'_> {
    let limits = Limits {
        markings: usize::MAX,
        ..Limits::default()
    };
    explore(model, &limits)
}

#[test]
fn philosophers_have_three_to_the_n_markings_and_two_deadlocks() {
    for count in [3_usize, 5, 8] {
        let model = philosophers(count);
        let found = all(&model);
        assert!(found.complete());
        assert_eq!(found.markings, 3_usize.pow(u32::try_from(count).unwrap()));
        assert_eq!((found.dead.len(), found.dead_count), (2, 2));
        for dead in &found.dead {
            let path = found.path(&dead.marking).unwrap();
            assert_eq!((path.len(), dead.distance), (count, count));
            assert_eq!(model.replay(&path).as_ref(), Some(&dead.marking));
        }
        let returns = returns(&found, usize::MAX).unwrap();
        assert!(!returns.reversible && !returns.live.contains(&true));
        assert_eq!((returns.terminal, returns.home_states), (2, 0));
    }
}

#[test]
fn kanban_systems_have_the_published_numbers_of_markings() {
    for (cards, markings) in (1..).zip(KANBAN).take(3) {
        let model = kanban(cards);
        let found = all(&model);
        assert!(found.complete() && found.dead.is_empty());
        assert_eq!(found.markings as u64, markings);
        assert!(found.bounds.iter().all(|bound| *bound == cards));
        assert_eq!(found.most_tokens, u64::from(4 * cards));
        let returns = returns(&found, usize::MAX).unwrap();
        assert!(returns.reversible && returns.all_live());
    }
}

#[test]
fn edges_are_pairs_of_a_marking_and_a_transition_enabled_in_it() {
    // Published with the anchors of the Model Checking Contest for five cards; here the smaller ones by
    // a count of their own, from the definition.
    let model = kanban(2);
    let found = all(&model);
    let mut edges = 0;
    let (mut packed, mut marking) = (Vec::new(), Vec::new());
    for number in found.levels.numbers() {
        found.store.read(number, &mut packed);
        found.rules.layout.unpack(&packed, &mut marking);
        edges += (0..model.transitions.len())
            .filter(|t| model.is_enabled(u32::try_from(*t).unwrap(), &marking))
            .count();
    }
    assert_eq!(found.edges, edges as u64);
}

#[test]
fn more_threads_find_the_same() {
    let model = kanban(3);
    let one = all(&model);
    for threads in [2, 3] {
        let limits = Limits {
            markings: usize::MAX,
            threads,
            ..Limits::default()
        };
        let many = explore(&model, &limits);
        assert_eq!((many.markings, many.edges), (58_400, one.edges));
        assert_eq!(
            (&many.bounds, many.most_tokens),
            (&one.bounds, one.most_tokens)
        );
        let far = many
            .nearest(|marking| marking[3] == 0 && marking[15] == 0)
            .unwrap();
        assert_eq!(
            one.nearest(|marking| marking[3] == 0 && marking[15] == 0),
            Some(far.clone())
        );
        let path = many.path(&far.marking).unwrap();
        assert_eq!(
            (path.len(), model.replay(&path)),
            (far.distance, Some(far.marking))
        );
    }
}

#[test]
fn a_buffer_of_n_has_four_times_n_plus_one_markings_however_wide() {
    for items in [1, 7, 300, 5_000] {
        let model = buffer(items);
        let found = all(&model);
        assert_eq!(found.markings as u64, 4 * (u64::from(items) + 1));
        assert!(found.complete() && found.dead.is_empty());
    }
}

#[test]
fn growth_is_proved_with_a_sequence_that_can_be_repeated() {
    let model = model(
        "net n\nplace a = 1, b, heap\ntransition go\n  in a\n  out b\ntransition back\n  in b\n  out a, heap*2\n",
    );
    let found = all(&model);
    assert_eq!(found.stopped, Some(Stopped::Growth));
    let growth = found.growth.unwrap();
    assert_eq!(model.places[growth.place as usize].name, "n.heap");
    let once = [growth.lead.clone(), growth.cycle.clone()].concat();
    let twice = [once.clone(), growth.cycle].concat();
    let tokens = |path: &[u32]| model.replay(path).unwrap()[growth.place as usize];
    assert!(tokens(&twice) > tokens(&once));
}

/// Parts arrive, are served and leave; only leaving takes no time.
const PUMP: &str = "net pump
place s, done
transition arrive
  out s
  time exponential 4 s
transition serve
  in s
  out done
  time exponential 2 s
transition leave
  in done
";

#[test]
fn growth_beside_immediate_transitions_is_found_within_a_few_markings() {
    let line = "net line
place free = 1, waits, busy, done, store
transition arrive
  out waits
  time exponential 4 s
transition begin
  in waits, free
  out busy
transition work
  in busy
  out done
  time normal 2 s spread 0.1 s
transition end
  in done
  out free, store
transition take
  in store*2
  time 1 s
";
    for text in [PUMP, line] {
        let model = model(text);
        let limits = Limits {
            markings: 2_000,
            ..Limits::default()
        };
        let found = explore(&model, &limits);
        assert_eq!(found.stopped, Some(Stopped::Growth), "{text}");
        let growth = found.growth.unwrap();
        let mut player = crate::analysis::play::Player::new(&model);
        let mut before = 0;
        for round in 0..50 {
            let steps = if round == 0 {
                &growth.lead
            } else {
                &growth.cycle
            };
            for step in steps {
                player.fire(*step).unwrap();
            }
            let tokens = player.marking()[growth.place as usize];
            assert!(round < 2 || tokens > before);
            before = tokens;
        }
    }
}

#[test]
fn what_a_more_urgent_transition_takes_away_is_not_taken_for_growth() {
    // Each arrival but the first is thrown away at once.
    let model = model(
        "net n\nplace s\ntransition arrive\n  out s\n  time 1 s\ntransition throw\n  in s*2\n  out s\n",
    );
    let found = all(&model);
    assert!(found.complete() && found.growth.is_none());
    assert_eq!(found.markings, 3);
}

#[test]
fn what_an_inhibitor_arc_or_a_capacity_bounds_is_not_taken_for_growth() {
    let inhibited = "net n\nplace a = 1, heap\ntransition grow\n  in a\n  inhibit heap*5\n  out a, heap\ntransition shrink\n  in heap\n";
    let full = "net n\nplace a = 1, heap capacity 5\ntransition grow\n  in a\n  out a, heap\ntransition shrink\n  in heap\n";
    for text in [inhibited, full] {
        let model = model(text);
        let found = all(&model);
        assert!(found.complete() && found.growth.is_none());
        assert_eq!((found.markings, found.bounds[1]), (6, 5));
    }
}

#[test]
fn a_reset_arc_empties_and_is_no_bound_by_itself() {
    let model = model(
        "net n\nplace a = 1, b, heap\ntransition grow\n  in a\n  out b, heap\ntransition back\n  in b\n  out a\ntransition sweep\n  in b\n  reset heap\n  out a\n",
    );
    let found = all(&model);
    assert_eq!(found.stopped, Some(Stopped::Growth));
    // The round that grows does not sweep.
    let growth = found.growth.unwrap();
    assert!(!growth.cycle.contains(&2));
    let once = model_always_swept();
    let found = all(&once);
    assert!(found.complete());
    assert_eq!(found.markings, 3);
    let far = found
        .nearest(|marking| marking[1] == 1 && marking[2] == 1)
        .unwrap();
    let path = found.path(&far.marking).unwrap();
    assert_eq!(once.replay(&path), Some(far.marking));
}

/// Here every round sweeps.
fn model_always_swept() -> Model {
    model(
        "net n\nplace a = 1, b, heap\ntransition grow\n  in a\n  out b, heap\ntransition sweep\n  in b\n  reset heap\n  out a\ntransition keep\n  in b, heap\n  out b\n",
    )
}

#[test]
fn a_more_urgent_transition_keeps_others_from_firing() {
    let text = "net n\nplace a = 1, b, c\ntransition low\n  in a\n  out b\ntransition high\n  in a\n  out c\n  priority 1\ntransition from_b\n  in b\n  out a\ntransition from_c\n  in c\n  out a\n";
    assert_eq!(all(&model(text)).markings, 2);
    assert_eq!(all(&model(&text.replace("  priority 1\n", ""))).markings, 3);
    let timed = text
        .replace("  priority 1\n", "")
        .replace("out b\n", "out b\n  time 2 s\n");
    assert_eq!(all(&model(&timed)).markings, 2);
}

#[test]
fn limits_end_the_search_without_a_claim() {
    let model = kanban(4);
    for limits in [
        Limits {
            markings: 100,
            ..Limits::default()
        },
        Limits {
            bytes: 1 << 20,
            ..Limits::default()
        },
        Limits {
            bytes: 1 << 20,
            threads: 2,
            ..Limits::default()
        },
    ] {
        let found = explore(&model, &limits);
        assert!(!found.complete());
        assert!(found.markings < 454_475 && found.peak_bytes <= (1 << 20) + (1 << 19));
    }
}

#[test]
fn a_search_that_is_stopped_tells_what_it_has_and_claims_no_more() {
    use std::sync::atomic::AtomicBool;

    static NOW: AtomicBool = AtomicBool::new(true);
    let model = kanban(4);
    let limits = Limits {
        stop: Stop::when(&NOW),
        ..Limits::default()
    };
    let found = explore(&model, &limits);
    assert_eq!(found.stopped, Some(Stopped::Stop));
    assert!(found.markings > 0 && !found.complete());
    assert!(returns(&found, usize::MAX).is_none());
    let effort = crate::analysis::symbolic::Effort {
        bytes: 1 << 28,
        steps: u64::MAX,
    };
    let counted = crate::analysis::symbolic::count(&model, effort, Stop::when(&NOW));
    assert!(counted.is_err());
}

#[test]
fn no_more_markings_are_told_than_the_limit_permits() {
    let model = kanban(4);
    for markings in [1, 100, 100_000] {
        let limits = Limits {
            markings,
            ..Limits::default()
        };
        let found = explore(&model, &limits);
        assert_eq!(
            (found.markings, found.stopped),
            (markings, Some(Stopped::Markings))
        );
    }
}

#[test]
fn tokens_beyond_32_bits_are_a_finding_and_no_overflow() {
    let model = model(
        // The inhibitor arc keeps growth from being proved.
        "net n\nplace s = 1, a = 1000000000\ntransition t\n  in s\n  out s, a*1000000000\ntransition never\n  in s\n  inhibit a\n",
    );
    let found = all(&model);
    assert!(matches!(found.stopped, Some(Stopped::Tokens(1))));
}
