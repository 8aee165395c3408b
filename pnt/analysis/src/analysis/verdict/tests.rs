use super::*;
use crate::analysis::samples::{KANBAN, kanban, philosophers};

const ANY: Effort = Effort {
    bytes: usize::MAX,
    steps: u64::MAX,
};

/// Turns by which diagrams may first take so many steps, after 100 markings.
fn turns(steps: u64, listed_next: usize) -> Turns {
    Turns {
        listed_first: 100,
        diagrams_first: Effort { steps, ..ANY },
        listed_next,
        diagrams_next: ANY,
    }
}

fn verdict_of(model: &Model, turns: Turns) -> Verdict {
    let limits = Limits::default();
    choose(model, &limits, Engines::Both, turns, &mut |_| {}).verdict
}

#[test]
fn listing_takes_over_after_the_steps_that_diagrams_may_take() {
    let model = kanban(2);
    let whole = verdict_of(&model, turns(u64::MAX, 0));
    assert_eq!(whole.engine, Engine::Symbolic);
    for steps in [100, whole.diagram_steps / 4, whole.diagram_steps - 1] {
        let verdict = verdict_of(&model, turns(steps, 50_000));
        assert_eq!(verdict.engine, Engine::Explicit);
        assert!(verdict.complete);
        assert_eq!(verdict.markings, u128::from(KANBAN[1]));
        // What is refused is counted, too: a step of the count, of the way, of the return and of liveness.
        let beyond = verdict.diagram_steps - steps;
        assert!((1..=4).contains(&beyond), "{beyond}");
    }
    let verdict = verdict_of(&model, turns(whole.diagram_steps, 50_000));
    assert_eq!(verdict.engine, Engine::Symbolic);
}

#[test]
fn diagrams_come_again_where_listing_has_come_to_no_end() {
    let verdict = verdict_of(&kanban(2), turns(100, 1_000));
    assert_eq!(verdict.engine, Engine::Symbolic);
    assert_eq!(verdict.markings, u128::from(KANBAN[1]));
    assert!(verdict.diagram_steps > 101);
}

#[test]
fn a_first_count_that_leaves_something_out_is_given_up() {
    let model = philosophers(5);
    let whole = verdict_of(&model, turns(u64::MAX, 0));
    let limits = Limits::default();
    for steps in (0..whole.diagram_steps).step_by(100) {
        let turns = turns(steps, 50_000);
        let looked = choose(&model, &limits, Engines::Both, turns, &mut |_| {});
        assert_eq!(looked.verdict.engine, Engine::Explicit);
        assert_eq!(
            (looked.verdict.markings, looked.verdict.deadlocks),
            (243, 2)
        );
        assert_eq!(looked.explored.dead.len(), 2);
    }
}

#[test]
fn no_turn_of_the_diagrams_takes_much_longer_than_what_was_listed_before_it() {
    let per_marking = |effort: Effort, listed: usize| effort.steps / listed as u64;
    assert!(per_marking(TURNS.diagrams_first, TURNS.listed_first) <= 5);
    assert!(per_marking(TURNS.diagrams_next, TURNS.listed_next) <= 13);
}

#[test]
fn a_count_that_somebody_ends_says_so() {
    static NOW: std::sync::atomic::AtomicBool = std::sync::atomic::AtomicBool::new(true);
    let limits = Limits {
        stop: crate::analysis::stop::Stop::when(&NOW),
        ..Limits::default()
    };
    let turns = turns(100, 1_000);
    let model = kanban(2);
    let looked = choose(&model, &limits, Engines::Symbolic, turns, &mut |_| {});
    assert_eq!(looked.verdict.stopped, Some(Stopped::Stop));
}
