//! Carries done on a board of discs.

use proptest::prelude::*;
use rand::{SeedableRng, seq::IndexedRandom};
use rand_chacha::ChaCha8Rng;

use super::*;
use crate::{board::each, notation::Numbering, rules::Variant, table::Table};

fn carries(fen: &str, heaps: &mut Heaps) -> Vec<Carry> {
    let variant = Variant::Brazilian;
    let before = Position::read(fen, variant, Numbering::Plain).unwrap();
    let route = before.routes(variant).remove(0);
    heaps.carries(&before, &route)
}

const fn square(number: u8, height: u8) -> Place {
    Place::Square(number - 1, height)
}

#[test]
fn a_capture_goes_before_its_prey_and_a_king_goes_as_a_stack() {
    let mut heaps = Heaps { white: 0, black: 3 };
    let found = carries("W:W22:BK18", &mut heaps);
    let expected = [
        Carry {
            from: square(22, 0),
            to: square(15, 0),
            discs: 1,
        },
        Carry {
            from: square(18, 0),
            to: Place::Heap(Colour::Black, 3),
            discs: 2,
        },
    ];
    assert_eq!((found.as_slice(), heaps.black), (&expected[..], 5));
}

#[test]
fn a_crown_comes_from_the_heap_of_its_colour_and_otherwise_from_the_spare_discs() {
    let mut heaps = Heaps { white: 2, black: 0 };
    let found = carries("W:W6:B12", &mut heaps);
    assert_eq!(
        found[1],
        Carry {
            from: Place::Heap(Colour::White, 1),
            to: square(1, 1),
            discs: 1
        }
    );
    assert_eq!(heaps.white, 1);
    let found = carries("W:W6:B12", &mut Heaps::default());
    assert_eq!(found[1].from, Place::Spare(Colour::White));
}

#[test]
fn a_circle_moves_only_its_prey() {
    let found = carries("W:W26:B22,14,15,23", &mut Heaps::default());
    assert_eq!(found.len(), 4);
    assert!(
        found
            .iter()
            .all(|carry| matches!(carry.to, Place::Heap(Colour::Black, _)))
    );
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn the_carries_of_whole_games_leave_the_board_as_the_rules_say_and_lose_no_disc(seed: u64) {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        for variant in Variant::ALL {
            let mut position = Position::start(variant.starts());
            let mut table = Table::of(&position);
            let mut heaps = Heaps::default();
            for _ in 0..150 {
                let routes = position.routes(variant);
                let Some(route) = routes.choose(&mut random) else { break };
                for carry in heaps.carries(&position, route) {
                    prop_assert_eq!(table.carry(carry), Ok(()));
                }
                position = position.after(route.step);
                prop_assert_eq!(table.differs(&position), 0, "{:?}", each(table.differs(&position)).collect::<Vec<_>>());
                prop_assert_eq!(table.heaps(), heaps);
                prop_assert_eq!(table.discs(), 24 + table.spares());
            }
        }
    }
}
