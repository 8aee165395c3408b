//! Looks at boards, right and wrong, sure and unsure.

use proptest::prelude::*;
use rand::{RngExt, SeedableRng, seq::IndexedRandom};
use rand_chacha::ChaCha8Rng;

use super::*;

fn position(fen: &str, variant: Variant) -> Position {
    Position::read(fen, variant, Numbering::Plain).unwrap()
}

/// The verdict when a board stands still.
fn seen(look: &Look, before: &Position, variant: Variant) -> Verdict {
    let mut watch = Watch::default();
    let first = watch.see(look, before, variant);
    assert_eq!(first, Verdict::NotFinal);
    watch.see(look, before, variant)
}

fn rejected(before: &str, after: &str, variant: Variant) -> String {
    let before = position(before, variant);
    match seen(&Look::at(&position(after, variant)), &before, variant) {
        Verdict::Rejected(reason, squares) => {
            assert!(!squares.is_empty());
            reason
        }
        other => format!("{other:?}"),
    }
}

#[test]
fn what_was_done_instead_of_a_move_is_said_in_words() {
    let start = "W:W21,22,23:B9,14,15";
    let cases = [
        (
            start,
            "W:W13,22,23:B9,14,15",
            "from 21 to 13: 21 and 13 are not on one diagonal",
        ),
        (
            start,
            "W:W21,23:B9,14,15",
            "White's piece on 22 was taken away",
        ),
        (
            start,
            "W:W17,18,23:B9,14,15",
            "more than one piece was moved: from 21, 22 to 17, 18",
        ),
        (
            start,
            "W:W21,22,23:B13,14,15",
            "Black's piece was moved from 9 to 13",
        ),
        (
            start,
            "W:W21,22,23:B14,15",
            "Black's piece on 9 was taken away, and nothing was moved",
        ),
        (
            start,
            "W:W21,22,23,24:B9,14,15",
            "there is a piece of White too many on 24",
        ),
        (
            start,
            "W:W21,22,23:B9,14,15,16",
            "there is a piece of Black too many on 16",
        ),
        (
            "W:W22,32:B18",
            "W:W22,28:B18",
            "from 32 to 28: captures are compulsory: 22x15",
        ),
        (
            "W:W22,32:B18",
            "W:W15,32:B18",
            "what was captured is to be taken away: 18",
        ),
        ("W:W22:B18,1", "W:W15:B", "1 was not captured from 22 to 15"),
        (
            "W:W22,24:B17,19,10",
            "W:W13,24:B19,10",
            "from 22 to 13: the largest number must be captured, 2 and not 1: 24x15x6",
        ),
        (
            "W:W24:B19,10",
            "W:W15:B10",
            "from 24 to 15: a capture goes on as long as it can: 24x15x6",
        ),
    ];
    for (before, after, expected) in cases {
        assert_eq!(
            rejected(before, after, Variant::Brazilian),
            expected,
            "{before} {after}"
        );
    }
}

#[test]
fn a_hand_and_a_change_make_a_move_wait() {
    let variant = Variant::Brazilian;
    let before = Position::start(Colour::White);
    let step = before.moves(variant)[0];
    let (still, moved) = (Look::at(&before), Look::at(&before.after(step)));
    let hand = Look {
        hand: true,
        ..moved.clone()
    };
    let mut watch = Watch::default();
    for (look, expected) in [
        (&still, Verdict::NotFinal),
        (&still, Verdict::Waiting),
        (&hand, Verdict::NotFinal),
        (&moved, Verdict::NotFinal),
        (&hand, Verdict::NotFinal),
        (&moved, Verdict::NotFinal),
        (&moved, Verdict::Accepted(step)),
    ] {
        assert_eq!(watch.see(look, &before, variant), expected);
    }
}

#[test]
fn an_unsure_square_that_matters_is_asked_for_and_another_is_not() {
    let variant = Variant::Brazilian;
    let before = position("W:W22:B1", variant);
    let step = before.moves(variant)[0];
    let mut look = Look::at(&before.after(step));
    look.squares[3].confidence = 0.1;
    assert_eq!(seen(&look, &before, variant), Verdict::Accepted(step));
    look.squares[usize::from(step.to)].confidence = f64::NAN;
    assert_eq!(
        seen(&look, &before, variant),
        Verdict::Unsure(vec![step.to])
    );
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn every_legal_move_is_accepted_and_wrong_sights_that_are_unsure_never_make_another_of_it(seed: u64) {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        for variant in Variant::ALL {
            let mut before = Position::start(variant.starts());
            for _ in 0..60 {
                let moves = before.moves(variant);
                let Some(step) = moves.choose(&mut random) else { break };
                let after = before.after(*step);
                let mut look = Look::at(&after);
                let accepted = seen(&look, &before, variant);
                let Verdict::Accepted(found) = accepted else {
                    return Err(TestCaseError::fail(format!("{accepted:?}")));
                };
                prop_assert_eq!(before.after(found), after);
                for sight in &mut look.squares {
                    if random.random_bool(0.2) {
                        *sight = Sight {
                            piece: *[None, Some(Colour::White), Some(Colour::Black)].choose(&mut random).unwrap(),
                            confidence: random.random_range(0.0..0.79),
                        };
                    }
                }
                match seen(&look, &before, variant) {
                    Verdict::Accepted(found) => prop_assert_eq!(before.after(found), after),
                    Verdict::Unsure(squares) => {
                        prop_assert!(squares.iter().all(|square| look.squares[usize::from(*square)].confidence < 0.8));
                    }
                    Verdict::Waiting => {}
                    other => return Err(TestCaseError::fail(format!("{other:?}"))),
                }
                before = after;
            }
        }
    }

    #[test]
    fn any_board_is_answered_and_accepted_only_when_a_legal_move_leads_to_it(seed: u64) {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        for variant in Variant::ALL {
            let before = Position::start(variant.starts());
            let mut look = Look::at(&before);
            for _ in 0..random.random_range(1..4) {
                let square = random.random_range(0..32);
                look.squares[square].piece = *[None, Some(Colour::White), Some(Colour::Black)].choose(&mut random).unwrap();
            }
            let legal = before.moves(variant).iter().any(|step| Look::at(&before.after(*step)) == look);
            match seen(&look, &before, variant) {
                Verdict::Accepted(_) => prop_assert!(legal),
                Verdict::Waiting => prop_assert!(look == Look::at(&before)),
                Verdict::Rejected(reason, squares) => prop_assert!(!legal && !reason.is_empty() && !squares.is_empty()),
                other => return Err(TestCaseError::fail(format!("{other:?}"))),
            }
        }
    }
}
