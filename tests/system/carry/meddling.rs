//! A person who puts things elsewhere while something is pushed aside, or while the hand looks from another pose: whatever the answer is,
//! it is true.

use std::time::Duration;

use nalgebra::{Isometry3, Point3, Translation3};

use super::{
    layout::{board, disc_on, error, laid, nothing_was_hit, other},
    person::{Answer, Seen, Step, seen_in},
    ways::{by_hand, covered, stuck},
};
use crate::harness::Scratch;

/// What a person puts elsewhere, and how long after the order.
type Meddling = (u64, &'static str, Isometry3<f64>);

/// Where discs lie beside the board.
fn table(number: usize) -> Isometry3<f64> {
    Isometry3::translation(0.9, -0.4 + 0.1 * number as f64, 0.4052)
}

/// The board, slid over the table.
fn slid(surface: &Isometry3<f64>, by: [f64; 2]) -> Isometry3<f64> {
    surface * Translation3::new(by[0], by[1], -0.01)
}

/// An errand after the other, each with what a person does meanwhile.
fn steps(begin: impl Fn() -> Vec<Step>, line: &str, meddled: &[Meddling]) -> Vec<Step> {
    let mut steps = Vec::new();
    for (ms, body, pose) in meddled {
        steps.extend(begin());
        steps.push(Step::Later(Duration::from_millis(*ms), body, *pose));
        steps.push(Step::Carry(line.to_owned()));
    }
    steps
}

/// The place that words tell, in the arm's base frame.
fn place(said: &str, board: &Isometry3<f64>) -> Option<Point3<f64>> {
    let number = |word: &str| word.trim_end_matches(',').parse::<f64>().ok();
    if let Some((_, rest)) = said.split_once("beside the board at x ") {
        let mut words = rest.split(' ');
        let x = number(words.next()?)?;
        let y = number(words.nth(2)?)?;
        return Some(Point3::new(x, y, 0.0));
    }
    let (_, rest) = said.split_once(" on ")?;
    let mut numbers = rest.split(' ').next()?.split(',');
    let (column, row) = (number(numbers.next()?)?, number(numbers.next()?)?);
    Some(board * Point3::new((column - 4.5) * 0.06, (row - 4.5) * 0.06, 0.0))
}

/// Each answer says what is so, and where it says that the disc is, it is.
fn are_true(seen: &Seen, to: [f64; 2], meddled: &[Meddling]) {
    let all = seen.answers.lock().unwrap();
    assert_eq!(all.len(), meddled.len());
    for (answer, (ms, body, _)) in all.iter().zip(meddled) {
        let Answer { symbol, text, .. } = answer;
        let case = format!("{body} at {ms} ms: {symbol}: {text}: {answer:?}");
        let off = error(answer, to);
        let level = (answer.board.inverse() * answer.disc).translation.z;
        let lies = (0.01..0.02).contains(&level);
        match symbol.as_str() {
            "carried" => assert!(off < 3e-3 && lies, "{case}"),
            _ => assert!(off > 0.03 && !text.is_empty(), "{case}"),
        }
        for said in text.split("red disc").skip(1) {
            let said = said.split(['\n', ';']).next().unwrap_or_default();
            let said = said.split(", a ").next().unwrap_or_default();
            // One picture alone does not tell how high it lies.
            let within = if said.contains("one picture") {
                0.05
            } else {
                6e-3
            };
            if let Some(place) = place(said, &answer.board) {
                let far = (answer.disc.translation.vector.xy() - place.coords.xy()).norm();
                assert!(far < within, "{far} m from{said}: {case}");
            }
        }
    }
    nothing_was_hit(seen);
}

#[test]
fn who_moves_board_or_discs_while_one_is_pushed_aside_gets_an_answer_that_is_true() {
    let surface = board(0.5, 0.0, 0.0);
    // Pushed from about 3 s after the order to 9 s.
    let meddled: [Meddling; 4] = [
        (3500, "other_disc", table(0)),
        (5500, "disc", table(1)),
        (6500, "board", slid(&surface, [0.02, -0.02])),
        (7500, "other_disc", disc_on(&surface, [6.0, 5.0], [0.0; 2])),
    ];
    let begin = || stuck(&surface, [1.0, 0.0]);
    let seen = seen_in(&Scratch::new(), "", steps(begin, "3,4 6,5", &meddled));
    are_true(&seen, [6.0, 5.0], &meddled);
}

#[test]
fn who_moves_board_or_discs_while_the_hand_looks_from_another_pose_gets_an_answer_that_is_true() {
    let surface = board(0.5, 0.0, 0.0);
    let meddled: [Meddling; 3] = [
        (2000, "disc", table(1)),
        (4000, "disc", disc_on(&surface, [5.0, 3.0], [0.0; 2])),
        (4000, "board", slid(&surface, [0.03, 0.02])),
    ];
    let begin = || {
        let mut steps = laid(&surface, [3.0, 4.0], [0.0; 2]);
        steps.push(other(&surface, [6.0, 6.0]));
        steps.extend([covered("left"), covered("right")]);
        steps
    };
    let seen = by_hand(steps(begin, "3,4 4,5", &meddled));
    are_true(&seen, [4.0, 5.0], &meddled);
}
