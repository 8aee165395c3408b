use std::{fmt::Write as _, sync::Arc};

use ctos::diagnostic::Source;

use super::*;
use crate::compile;

fn space(text: &str) -> Space {
    let net = compile::net(&Source::new("test.net", text)).unwrap_or_else(|f| panic!("{f}"));
    let (system, findings) = System::compose(&[Arc::new(net)]);
    assert!(findings.is_empty(), "{findings}");
    explore(&system, &Limits::default())
}

/// Philosophers who take either fork first (model Philosophers of the Model Checking Contest).
fn philosophers(count: usize) -> String {
    let mut text = String::from("net philosophers\n");
    for i in 0..count {
        let next = (i + 1) % count;
        let _ = write!(
            text,
            "place think{i} = 1, fork{i} = 1, left{i}, right{i}, eat{i}
transition take_left{i}
  in think{i}, fork{i}
  out left{i}
transition then_right{i}
  in left{i}, fork{next}
  out eat{i}
transition take_right{i}
  in think{i}, fork{next}
  out right{i}
transition then_left{i}
  in right{i}, fork{i}
  out eat{i}
transition end{i}
  in eat{i}
  out think{i}, fork{i}, fork{next}
"
        );
    }
    text
}

#[test]
fn philosophers_have_three_to_the_n_markings_and_two_deadlocks() {
    // Each fork is free or with one of its two neighbours, which decides all else; they starve when
    // all hold their left forks or all their right ones.
    for count in [3_usize, 5, 8] {
        let found = space(&philosophers(count));
        assert!(found.complete);
        assert_eq!(found.markings, 3_usize.pow(u32::try_from(count).unwrap()));
        assert_eq!(found.dead.len(), 2);
        assert_eq!(found.path(found.dead[0]).len(), count);
    }
}

/// Four-cell Kanban system (Ciardo and Tilgner 1996; model Kanban of the Model Checking Contest).
fn kanban(cards: usize) -> String {
    let mut text = String::from("net kanban\n");
    for i in 1..=4 {
        let _ = writeln!(text, "place pm{i}, pback{i}, pout{i}, pkan{i} = {cards}");
    }
    for i in 1..=4 {
        let _ = write!(
            text,
            "transition tok{i}\n  in pm{i}\n  out pout{i}
transition tredo{i}\n  in pm{i}\n  out pback{i}
transition tback{i}\n  in pback{i}\n  out pm{i}\n"
        );
    }
    text.push_str(
        "transition tin1\n  in pkan1\n  out pm1
transition tsynch1\n  in pout1, pkan2, pkan3\n  out pkan1, pm2, pm3
transition tsynch2\n  in pout2, pout3, pkan4\n  out pkan2, pkan3, pm4
transition tout4\n  in pout4\n  out pkan4\n",
    );
    text
}

#[test]
fn kanban_systems_have_the_published_numbers_of_markings() {
    for (cards, markings) in [(1, 160), (2, 4_600), (3, 58_400)] {
        let found = space(&kanban(cards));
        assert!(found.complete && found.dead.is_empty() && found.trapped.is_none());
        assert_eq!(found.markings, markings);
        assert!(found.bounds.iter().all(|bound| *bound as usize == cards));
    }
}

#[test]
fn a_producer_and_a_consumer_share_a_buffer_of_n_in_four_times_n_plus_one_markings() {
    // Two states each, and 0 to n items; more than 255 items need wider cells.
    for items in [1_usize, 7, 300] {
        let found = space(&format!(
            "net pc
place ready = 1, made, idle = 1, got, items, room = {items}
transition make\n  in ready\n  out made
transition put\n  in made, room\n  out ready, items
transition get\n  in idle, items\n  out got, room
transition use\n  in got\n  out idle\n"
        ));
        assert_eq!(found.markings, 4 * (items + 1));
        assert!(found.complete && found.dead.is_empty() && found.trapped.is_none());
    }
}

#[test]
fn growth_is_proved_with_a_sequence_that_can_be_repeated() {
    let text = "net n\nplace a = 1, b, heap\ntransition go\n  in a\n  out b\ntransition back\n  in b\n  out a, heap*2\n";
    let net = Arc::new(compile::net(&Source::new("t", text)).unwrap());
    let (system, _) = System::compose(&[net]);
    let found = explore(&system, &Limits::default());
    let growth = found.growth.unwrap();
    assert_eq!(system.places()[growth.place].name, "n.heap");
    let once = [growth.lead.clone(), growth.cycle.clone()].concat();
    let twice = [once.clone(), growth.cycle].concat();
    let (once, twice) = (
        Space::replay(&system, &once),
        Space::replay(&system, &twice),
    );
    assert!(twice[growth.place] > once[growth.place]);
}

#[test]
fn an_inhibitor_arc_that_bounds_a_place_is_not_taken_for_growth() {
    let found = space(
        "net n\nplace a = 1, heap\ntransition grow\n  in a\n  inhibit heap*5\n  out a, heap\ntransition shrink\n  in heap\n",
    );
    assert!(found.complete && found.growth.is_none());
    assert_eq!(found.markings, 6);
}

#[test]
fn a_more_urgent_transition_keeps_others_from_firing() {
    let text = "net n\nplace a = 1, b, c\ntransition low\n  in a\n  out b\ntransition high\n  in a\n  out c\n  priority 1\ntransition from_b\n  in b\n  out a\ntransition from_c\n  in c\n  out a\n";
    assert_eq!(space(text).markings, 2);
    assert_eq!(space(&text.replace("  priority 1\n", "")).markings, 3);
}

#[test]
fn a_limit_ends_the_search_without_a_claim() {
    let net = compile::net(&Source::new("t", kanban(3))).unwrap();
    let (system, _) = System::compose(&[Arc::new(net)]);
    let limits = Limits {
        markings: 100,
        edges: true,
    };
    let found = explore(&system, &limits);
    assert!(!found.complete && found.trapped.is_none());
}
