//! Whole games of the plot against a person by lot, with discs on a table.

use proptest::prelude::*;
use rand::{RngExt, SeedableRng, seq::IndexedRandom};
use rand_chacha::ChaCha8Rng;

use super::*;
use crate::{notation::Numbering, table::Table};

/// Plays a game to its end; says how it ended, and how often a move was rejected.
fn played(seed: u64, variant: Variant, ours: Colour) -> Result<(Status, usize), TestCaseError> {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let mut plot = Plot::new(Game::new(variant), ours, Watch::default());
    let mut table = Table::of(plot.game().position());
    let mut rejected = 0;
    let mut next = plot.next();
    // What the board shows beside the game's position: the person's move, perhaps a wrong one.
    let mut shown = *plot.game().position();
    for _ in 0..20_000 {
        next = match next {
            Next::Over(status) => {
                prop_assert_eq!(table.differs(plot.game().position()), 0);
                return Ok((status, rejected));
            }
            Next::Think => {
                let moves = plot.game().position().moves(variant);
                let step = *moves.choose(&mut random).unwrap();
                plot.thought(step).unwrap()
            }
            Next::Carry(carry) => {
                prop_assert_eq!(table.carry(carry), Ok(()));
                plot.carried().unwrap()
            }
            Next::Verify => {
                prop_assert_eq!(table.differs(plot.game().position()), 0);
                shown = *plot.game().position();
                plot.see(&Look::at(&shown))
            }
            Next::Look => {
                let position = *plot.game().position();
                if shown == position && random.random_bool(0.7) {
                    let moves = position.moves(variant);
                    let step = *moves.choose(&mut random).unwrap();
                    shown = position.after(step);
                    if random.random_bool(0.2) {
                        // Something else of this side is gone too.
                        let own = shown.side(position.turn);
                        let other = own & own.wrapping_sub(1);
                        shown.white &= !other;
                        shown.black &= !other;
                    }
                }
                let before = plot.game().moves().len();
                let hands = random.random_bool(0.1);
                let look = Look {
                    hand: hands,
                    ..Look::at(&shown)
                };
                let heaps = plot.heaps();
                let next = plot.see(&look);
                if plot.game().moves().len() > before {
                    // The person has carried: the same on the table, but for the crown.
                    let step = *plot.game().moves().last().unwrap();
                    let route = position
                        .routes(variant)
                        .into_iter()
                        .find(|route| route.step == step)
                        .unwrap();
                    let mut heaps = heaps;
                    for carry in heaps.carries(&position, &route) {
                        if !matches!(carry.to, Place::Square(_, 1)) {
                            prop_assert_eq!(table.carry(carry), Ok(()));
                        }
                    }
                    shown = *plot.game().position();
                }
                next
            }
            Next::Reject(reason, squares) => {
                prop_assert!(!reason.is_empty() && !squares.is_empty());
                rejected += 1;
                // The person takes it back.
                shown = *plot.game().position();
                plot.see(&Look::at(&shown))
            }
            other => return Err(TestCaseError::fail(format!("{other:?}"))),
        };
    }
    Err(TestCaseError::fail("the game has no end"))
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    #[test]
    fn every_game_ends_with_a_true_result_and_every_disc_in_its_place(seed: u64) {
        let mut rejected = 0;
        for variant in Variant::ALL {
            for ours in [Colour::White, Colour::Black] {
                let (status, times) = played(seed, variant, ours)?;
                prop_assert!(status != Status::Playing);
                rejected += times;
            }
        }
        prop_assert!(rejected > 0);
    }
}

#[test]
fn a_board_that_is_not_as_it_should_be_is_told_after_a_carry() {
    let mut plot = Plot::new(
        Game::new(Variant::Brazilian),
        Colour::White,
        Watch::default(),
    );
    let step = plot.game().position().moves(Variant::Brazilian)[0];
    let mut next = plot.thought(step).unwrap();
    while let Next::Carry(_) = next {
        next = plot.carried().unwrap();
    }
    assert_eq!(next, Next::Verify);
    let mut look = Look::at(plot.game().position());
    look.squares[usize::from(step.to)].piece = None;
    assert_eq!(plot.see(&look), Next::Wrong(vec![step.to]));
    look.squares[usize::from(step.to)].confidence = 0.0;
    assert_eq!(plot.see(&look), Next::LookAgain(vec![step.to]));
    assert_eq!(plot.see(&Look::at(plot.game().position())), Next::Look);
}

#[test]
fn a_game_may_be_resigned_and_begun_anew() {
    let mut plot = Plot::new(Game::new(Variant::Russian), Colour::Black, Watch::default());
    assert_eq!(plot.next(), Next::Look);
    assert!(plot.carried().is_err());
    assert!(
        plot.thought(plot.game().position().moves(Variant::Russian)[0])
            .is_err()
    );
    assert!(matches!(
        plot.resign(Colour::White),
        Next::Over(Status::Won(Colour::Black, _))
    ));
    assert_eq!(plot.new_game(Variant::Italian, Colour::White), Next::Think);
    assert_eq!(plot.game().position().fen(Numbering::Mirrored).len(), 66);
}
