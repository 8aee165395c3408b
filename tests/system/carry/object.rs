//! A new object, which nobody has thought of: all that is to be said of it is one file.

use nalgebra::{Isometry3, Translation3};

use super::{
    layout::{board, error, nothing_was_hit, other},
    person::{Step, seen_in},
};
use crate::harness::Scratch;

/// Narrower, higher and heavier than the disc, in a colour that no other thing has, and grasped otherwise.
const PUCK: &str = r#"
name = "puck"
width_m = 0.03
tolerance_m = 0.003
height_m = 0.016
mass_kg = 0.05

[grasp]
force_n = 12.0
open_m = 0.046
finger_m = 0.012
above_m = 0.018
turns_deg = [45.0, -45.0, 0.0]

[[colour]]
name = "violet"
rgb = [150.0, 45.0, 160.0]
"#;

#[test]
fn a_new_object_in_another_size_colour_and_grasp_is_carried_by_its_file_alone() {
    let scratch = Scratch::new();
    // The world has one; that is no configuration of the app.
    let cell = scratch.read("configs/carry-cell.toml");
    let disc = "radius = 0.018\nheight = 0.01\nmass = 0.02\nfriction = 0.6\ncolour = [190.0, 45.0, 40.0]\nposition = [0.41, -0.03, 0.425]";
    let puck = "radius = 0.015\nheight = 0.016\nmass = 0.05\nfriction = 0.6\ncolour = [150.0, 45.0, 160.0]\nposition = [0.41, -0.03, 0.428]";
    assert!(cell.contains(disc));
    scratch.write("configs/carry-cell.toml", cell.replace(disc, puck));
    scratch.write("configs/carry/puck.toml", PUCK);
    let surface = board(0.55, -0.05, 25.0);
    let stands = |field: [f64; 2]| -> Isometry3<f64> {
        let (x, y) = ((field[0] - 4.5) * 0.06, (field[1] - 4.5) * 0.06);
        surface * Translation3::new(x + 0.004, y - 0.003, 0.0082)
    };
    let below = surface * Translation3::new(0.0, 0.0, -0.01);
    let mut steps = vec![
        Step::Put("board", below),
        Step::Put("disc", stands([3.0, 4.0])),
    ];
    steps.push(other(&surface, [6.0, 6.0]));
    steps.push(Step::Carry("3,4 4,5".to_owned()));
    steps.push(Step::Carry("4,5 5,3".to_owned()));
    let more = "[task.dispatcher.args]\nthing = \"carry/puck.toml\"\n";
    let seen = seen_in(&scratch, more, steps);
    let all = seen.answers.lock().unwrap();
    for (answer, field) in all.iter().zip([[4.0, 5.0], [5.0, 3.0]]) {
        assert_eq!(answer.symbol, "carried", "{}", answer.text);
        let said = "grasp of puck: turned by";
        assert!(answer.text.contains(said), "{}", answer.text);
        assert!(error(answer, field) < 1.5e-3, "{answer:?}");
    }
    nothing_was_hit(&seen);
}
