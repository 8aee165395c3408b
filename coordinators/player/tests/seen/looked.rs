//! What the pictures on the monitor of vision show of a look.

use std::{
    collections::BTreeMap,
    path::Path,
    sync::{Arc, Mutex},
    time::Duration,
};

use ctos::task::Context;
use mcs_hand::command::ReadBodies;
use nalgebra::{Matrix4, Point3};
use sim::cell::Cell;
use vss::command::{Drawing, WhatIsShown};

use super::play::{self, record_of};

/// How often the monitor is looked at.
const LOOK: Duration = Duration::from_millis(100);

/// The camera.
const CAMERA: &str = "left";

/// What was drawn over the pictures, by their number, and where the board was.
#[derive(Default)]
struct Seen {
    drawn: BTreeMap<u64, Drawing>,
    board: Option<Matrix4<f64>>,
}

/// Looks at the monitor and at the world.
async fn look_on(cx: Context, seen: Arc<Mutex<Seen>>) {
    while !cx.is_stopping() {
        cx.sleep(LOOK).await;
        look(&cx, &seen).await;
    }
}

async fn look(cx: &Context, seen: &Mutex<Seen>) {
    let (Ok(monitor), Ok(world)) = (cx.task("vmImageDisp").await, cx.task("world").await) else {
        return;
    };
    let camera = CAMERA.to_owned();
    let Ok(Some(shown)) = cx.call(&monitor, WhatIsShown { camera }).await else {
        return;
    };
    let Ok(bodies) = cx.call(&world, ReadBodies {}).await else {
        return;
    };
    let board = bodies.iter().find(|body| body.name == "board");
    let mut seen = seen.lock().unwrap();
    seen.board = board.map(|body| Matrix4::from_row_slice(&body.world_t_body));
    seen.drawn.insert(shown.frame.number, shown.drawing);
}

/// What is drawn over pictures of a game that is given up after some half-moves, and where the middles of the squares are in them.
fn looked(plies: usize, sets: &[&str]) -> (Vec<Drawing>, Vec<[f64; 2]>) {
    let seen = Arc::<Mutex<Seen>>::default();
    let shared = Arc::clone(&seen);
    let folder = tempfile::tempdir().unwrap();
    let opponent = record_of(folder.path(), plies);
    let mut all = vec![
        "task.player_daemon.handler=\"test.monitor\"",
        "task.room.args.bumps=0.0",
        "task.operator.args.within_s=60",
        &opponent,
    ];
    all.extend(sets);
    play::simulated("checkers-seen.toml", 1, &all, &[], |registry| {
        play::beside(registry, "test.monitor", move |cx| {
            look_on(cx, Arc::clone(&shared))
        });
    });
    let seen = std::mem::take(&mut *seen.lock().unwrap());
    let configs = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../configs");
    let cell = Cell::read(&configs.join("checkers-seen-cell.toml")).unwrap();
    let camera = cell.camera(CAMERA).unwrap().truth.camera();
    let board = seen.board.unwrap();
    let middles = (0..32).map(|square| {
        let (row, column) = (square / 4, square % 4);
        let file = 2 * column + usize::from(row % 2 == 0);
        let [x, y] = [file, 7 - row].map(|at| (at as f64 - 3.5) * 0.06);
        let at = camera.project(&board.transform_point(&Point3::new(x, y, 0.01)));
        at.unwrap().into()
    });
    (seen.drawn.into_values().collect(), middles.collect())
}

/// The middles of outlines of a colour and a text.
fn middles(drawing: &Drawing, wanted: impl Fn(&[u8; 3], &str) -> bool) -> Vec<[f64; 2]> {
    let outlines = drawing.outlines.iter();
    let wanted = outlines.filter(|outline| wanted(&outline.colour, &outline.text));
    let middle = wanted.map(|outline| {
        let count = outline.corners.len() as f64;
        let sum = |axis: usize| outline.corners.iter().map(|at| at[axis]).sum::<f64>();
        [sum(0) / count, sum(1) / count]
    });
    middle.collect()
}

/// The square whose middle is nearest, and how far it is, px.
fn nearest(squares: &[[f64; 2]], [u, v]: [f64; 2]) -> (usize, f64) {
    let far = squares.iter().map(|at| (at[0] - u).hypot(at[1] - v));
    let all = far.enumerate();
    all.min_by(|one, other| one.1.total_cmp(&other.1)).unwrap()
}

/// The squares on which there are marks of a colour, each of which is in its middle.
fn squares_of(drawing: &Drawing, squares: &[[f64; 2]], colour: [u8; 3]) -> Vec<usize> {
    let marks = middles(drawing, |own, text| *own == colour && text.is_empty());
    let mut all: Vec<usize> = marks
        .into_iter()
        .map(|at| {
            let (square, far) = nearest(squares, at);
            assert!(far < 2.0, "{at:?} is {far} px off {:?}", squares[square]);
            square
        })
        .collect();
    all.sort_unstable();
    all
}

fn said(drawn: &[Drawing]) -> Vec<&str> {
    drawn.iter().map(|drawing| &*drawing.said).collect()
}

const LIGHT: [u8; 3] = [255, 222, 80];
const DARK: [u8; 3] = [255, 84, 70];
const NOTHING: [u8; 3] = [170, 210, 225];

#[test]
fn a_look_is_shown_with_a_mark_on_each_square_where_it_is() {
    let (drawn, squares) = looked(0, &["task.room.args.glare=0.0"]);
    let clear = drawn
        .iter()
        .find(|drawing| drawing.said == "12 light, 12 dark")
        .unwrap_or_else(|| panic!("{:?}", said(&drawn)));
    assert_eq!(
        squares_of(clear, &squares, DARK),
        (0..12).collect::<Vec<_>>()
    );
    assert_eq!(
        squares_of(clear, &squares, NOTHING),
        (12..20).collect::<Vec<_>>()
    );
    assert_eq!(
        squares_of(clear, &squares, LIGHT),
        (20..32).collect::<Vec<_>>()
    );
    assert!(middles(clear, |_, text| !text.is_empty()).is_empty());
}

#[test]
fn a_square_that_something_hides_is_shown_as_unsure_with_its_confidence() {
    let (drawn, squares) = looked(2, &["task.room.args.glare=1.0"]);
    let unsure = drawn
        .iter()
        .find(|drawing| drawing.said.contains("unsure"))
        .unwrap_or_else(|| panic!("{:?}", said(&drawn)));
    let marks = middles(unsure, |_, text| !text.is_empty());
    let count = format!("{} unsure", marks.len());
    assert!(unsure.said.contains(&count), "{unsure:?}");
    for at in marks {
        let (square, far) = nearest(&squares, at);
        assert!(far < 2.0, "{at:?} is {far} px off {:?}", squares[square]);
    }
    let texts = unsure.outlines.iter().map(|outline| &outline.text);
    for text in texts.filter(|text| !text.is_empty()) {
        let percent: f64 = text.parse().unwrap();
        assert!((0.0..=100.0).contains(&percent), "{text}");
    }
}
