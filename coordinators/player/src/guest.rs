//! The hand of a person who plays from a display: it takes a disc, and sets it down where the person has put it. Knows no task.

use crate::{
    table::{Stack, Table, table_at},
    wire::{Hue, apart, centre},
};

/// A hand over the board takes so long to do something, s.
pub const TAKES_S: f64 = 1.2;

/// A disc that is let go so near to the middle of a square stands there; farther off, where it was let go, m.
const MIDDLE_M: f64 = 0.017;
/// So near to another disc it is set on that one, m.
const ONTO_M: f64 = 0.012;
/// Two discs beside one another, m.
const BESIDE_M: f64 = 0.041;
/// The edge of the board from its middle, m.
const EDGE_M: f64 = 0.3;

/// A disc that somebody drags: the colour, where it is, and where it is put, in the table's frame.
#[derive(Debug, Clone, Copy)]
pub struct Drag {
    pub hue: Hue,
    pub from: [f64; 2],
    pub to: [f64; 2],
}

/// Does it, with the hand over the board. Discs that are in the way are pushed aside.
///
/// # Errors
/// There is no such disc any more.
pub fn drag(table: &mut Table, Drag { hue, from, to }: Drag) -> Result<(), String> {
    let board = table.board;
    let mut stacks = table.stacks.iter_mut();
    let taken = stacks.find(|stack| {
        apart(table_at(stack, &board), from) < ONTO_M && stack.discs.last() == Some(&hue)
    });
    let taken = taken.ok_or("the disc is not there any more")?;
    taken.discs.pop();
    table.stacks.retain(|stack| !stack.discs.is_empty());
    let mut at = board.on_board(to);
    if at.iter().any(|along| along.abs() > EDGE_M) {
        // Captured discs are kept by the person.
        table.away.push(hue);
        return Ok(());
    }
    if let Some(middle) = (0..32)
        .map(centre)
        .find(|middle| apart(*middle, at) < MIDDLE_M)
    {
        at = middle;
    }
    let on_board = |stack: &&mut Stack| stack.on_board;
    let mut others = table.stacks.iter_mut().filter(on_board);
    if let Some(under) = others.find(|other| apart(other.at, at) < ONTO_M) {
        under.discs.push(hue);
        return Ok(());
    }
    for other in table.stacks.iter_mut().filter(on_board) {
        let off = apart(other.at, at);
        if off < BESIDE_M {
            for (own, under) in other.at.iter_mut().zip(at) {
                *own = under + (*own - under) * BESIDE_M / off;
            }
        }
    }
    table.stacks.push(Stack {
        on_board: true,
        at,
        discs: vec![hue],
    });
    Ok(())
}

#[cfg(test)]
mod tests {
    use checkers::{Colour, Position};
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;

    use super::*;
    use crate::table::Chances;

    fn table() -> Table {
        let rng = ChaCha8Rng::seed_from_u64(1);
        Table::new(Chances::default(), Position::start(Colour::White), rng)
    }

    fn dragged(table: &mut Table, from: u8, to: [f64; 2]) -> Result<(), String> {
        let board = table.board;
        let drag_it = Drag {
            hue: Hue::Light,
            from: board.on_table(centre(from)),
            to: board.on_table(to),
        };
        drag(table, drag_it)
    }

    #[test]
    fn a_disc_that_is_let_go_near_the_middle_of_a_square_stands_there_and_else_where_it_was_let_go()
    {
        let mut table = table();
        let [x, y] = centre(16);
        dragged(&mut table, 20, [x + 0.011, y - 0.009]).unwrap();
        let [white, ..] = table.squares();
        assert_eq!(white, 0xfff0_0000 & !(1 << 20) | 1 << 16);
        dragged(&mut table, 16, [x + 0.02, y]).unwrap();
        let stack = table.stacks.last().unwrap();
        assert!(apart(stack.at, [x + 0.02, y]) < 1e-12, "crooked");
        assert!(dragged(&mut table, 20, [x, y]).is_err(), "it has gone");
    }

    #[test]
    fn what_is_in_the_way_is_pushed_aside_what_is_below_is_a_stack_and_no_disc_comes_or_goes() {
        let mut table = table();
        let [x, y] = centre(21);
        dragged(&mut table, 20, [x - 0.03, y + 0.01]).unwrap();
        let at = table.stacks.last().unwrap().at;
        let near = |stack: &&Stack| stack.on_board && apart(stack.at, at) < BESIDE_M - 1e-9;
        assert_eq!(table.stacks.iter().filter(near).count(), 1, "itself");
        dragged(&mut table, 24, centre(25)).unwrap();
        assert_eq!(table.squares()[2], 1 << 25, "a stack of two");
        dragged(&mut table, 28, [0.0, 0.4]).unwrap();
        assert_eq!((table.away.len(), table.truth().discs), (1, [24, 24]));
    }
}
