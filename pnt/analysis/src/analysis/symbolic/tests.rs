use proptest::prelude::*;

use super::*;
use crate::analysis::{
    explicit::{Limits, explore},
    returns::returns,
    samples::{KANBAN, buffer, kanban, philosophers, random_model},
};

const EFFORT: Effort = Effort {
    bytes: 256 << 20,
    steps: u64::MAX,
};

fn counted(model: &Model) -> Counted {
    count(model, EFFORT, Stop::default()).unwrap()
}

#[test]
fn philosophers_are_counted_far_beyond_what_can_be_listed() {
    for count in [5_u32, 20] {
        let model = philosophers(count as usize);
        let found = counted(&model);
        assert_eq!(found.markings, 3_u128.pow(count));
        assert_eq!(found.deadlocks, 2);
        let (sequence, dead) = found.deadlock.unwrap();
        assert_eq!(sequence.len(), count as usize);
        assert_eq!(model.replay(&sequence), Some(dead));
        assert_eq!((found.reversible, found.live), (Some(false), Some(false)));
        assert!(found.bounds.iter().all(|bound| *bound == 1));
    }
}

#[test]
fn kanban_systems_are_counted_as_published() {
    for (cards, markings) in (1..).zip(KANBAN) {
        let found = counted(&kanban(cards));
        assert_eq!(found.markings, u128::from(markings));
        assert_eq!(
            (found.reversible, found.live, found.deadlocks),
            (Some(true), Some(true), 0)
        );
        assert_eq!(found.most_tokens, u64::from(4 * cards));
    }
    // Published by the Model Checking Contest, as are the edges with five cards.
    assert_eq!(counted(&kanban(5)).edges, 24_460_016);
    assert_eq!(counted(&kanban(10)).markings, 1_005_927_208);
}

#[test]
fn a_diagram_that_outgrows_its_memory_or_takes_too_many_steps_gives_up() {
    let model = kanban(5);
    let gave_up = |effort| count(&model, effort, Stop::default()).unwrap_err();
    let little_room = Effort {
        bytes: 10_000,
        ..EFFORT
    };
    assert!(gave_up(little_room).steps > 0);
    let whole = counted(&model);
    assert!(whole.is_whole());
    let few_steps = Effort {
        steps: whole.steps / 10,
        ..EFFORT
    };
    // The step that is refused is counted, too.
    assert_eq!(gave_up(few_steps).steps, few_steps.steps + 1);
    let enough = Effort {
        steps: whole.steps,
        ..EFFORT
    };
    assert_eq!(count(&model, enough, Stop::default()), Ok(whole));
}

#[test]
fn wide_buffers_are_counted() {
    assert_eq!(counted(&buffer(2_000)).markings, 8_004);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(300))]

    /// Two engines that share no code but the model agree on everything that both tell.
    #[test]
    fn both_engines_agree(model in random_model()) {
        let limits = Limits { markings: 3_000, ..Limits::default() };
        let listed = explore(&model, &limits);
        if listed.complete() {
            let found = counted(&model);
            prop_assert_eq!(found.markings, listed.markings as u128);
            prop_assert_eq!(found.edges, u128::from(listed.edges));
            prop_assert_eq!(&found.bounds, &listed.bounds);
            prop_assert_eq!(found.most_tokens, listed.most_tokens);
            prop_assert_eq!(found.deadlocks, u128::from(listed.dead_count));
            prop_assert_eq!(&found.seen, &listed.seen);
            prop_assert_eq!(
                found.deadlock.map(|(sequence, _)| sequence.len()),
                listed.dead.first().map(|dead| dead.distance)
            );
            let returns = returns(&listed, usize::MAX).unwrap();
            prop_assert_eq!(found.reversible, Some(returns.reversible));
            prop_assert_eq!(found.live, Some(returns.all_live()));
        } else if let Some(growth) = &listed.growth {
            let twice = [growth.lead.clone(), growth.cycle.clone(), growth.cycle.clone()].concat();
            let once = [growth.lead.clone(), growth.cycle.clone()].concat();
            let tokens = |sequence: &[u32]| model.replay(sequence).unwrap()[growth.place as usize];
            prop_assert!(tokens(&twice) > tokens(&once));
        }
    }
}
