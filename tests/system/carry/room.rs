//! What the arm keeps clear of: it goes around what the collision watch knows of, and touches nothing.

use nalgebra::{Isometry3, Translation3, UnitQuaternion};

use super::{
    layout::{board, error, laid, nothing_was_hit, other},
    person::{Answer, Step, seen_in},
};
use crate::harness::{CTOS, Scratch};

#[test]
fn what_one_recipe_of_the_collision_watch_knows_of_the_room_and_the_other_does_not_is_found() {
    let check = |scratch: &Scratch| {
        scratch
            .start(CTOS, &["check", "configs/carry.toml"], &[])
            .end()
    };
    let whole = check(&with_a_post());
    whole.must_exit(0);
    whole.must_not_say("mcs::collision::rooms");
    let scratch = with_a_post();
    let app = scratch.read("configs/carry.toml");
    let (most, _) = app
        .rsplit_once("\n[[task.servo_arm.args.guards.clear")
        .unwrap();
    scratch.write("configs/carry.toml", most);
    let half = check(&scratch);
    half.must_say("the recipe `clear` has no `post`, as `collision` has");
    half.must_say("mcs::collision::rooms");
}

/// A post hangs over the board, between field 3,2 and field 3,7, down to 30 mm above it; the collision watch knows of it.
fn with_a_post() -> Scratch {
    let scratch = Scratch::new();
    let (centre, size) = ("[0.41, 0.0, 0.56]", "[0.06, 0.06, 0.22]");
    let cell = scratch.read("configs/carry-cell.toml");
    let post = format!("\n[[furniture]]\ncentre = {centre}\nsize = {size}\ngrey = 80.0\n");
    scratch.write("configs/carry-cell.toml", cell + &post);
    let mut app = scratch.read("configs/carry.toml");
    for guard in ["collision", "clear"] {
        app += &format!(
            "\n[[task.servo_arm.args.guards.{guard}.args.room]]\nname = \"post\"\n\
            shapes = [{{ box = {size}, at = {{ xyz = {centre} }} }}]\n"
        );
    }
    scratch.write("configs/carry.toml", app);
    scratch
}

/// The board is believed where it is; the post hides it from the cameras.
const KNOWN: &str = "[task.vision.args]\nboard = \"known\"\n";

/// A disc on 3,2, which is to go to 3,7.
fn past_the_post() -> Vec<Step> {
    let surface = board(0.5, 0.0, 0.0);
    let mut steps = laid(&surface, [3.0, 2.0], [0.0; 2]);
    steps.push(other(&surface, [7.0, 7.0]));
    steps.push(Step::Carry("3,2 3,7".to_owned()));
    steps
}

#[test]
fn a_carry_whose_way_crosses_a_post_goes_around_it_and_touches_nothing() {
    let seen = seen_in(&with_a_post(), KNOWN, past_the_post());
    let all = seen.answers.lock().unwrap();
    assert_eq!(all[0].symbol, "carried", "{}", all[0].text);
    assert!(error(&all[0], [3.0, 7.0]) < 3e-3, "{all:?}");
    assert!(all[0].text.contains("post"), "{}", all[0].text);
    nothing_was_hit(&seen);
}

#[test]
fn a_carry_that_knows_no_way_around_a_post_says_what_ended_each_and_brings_the_disc_back() {
    let straight = "[task.robot.args.ways]\napproach = [{ way = \"joint\", cost_s = 2.0 }]\n\
        transfer = [{ way = \"arch\", cost_s = 2.0 }, { way = \"line\", cost_s = 4.0 }]\n";
    let seen = seen_in(
        &with_a_post(),
        &format!("{KNOWN}{straight}"),
        past_the_post(),
    );
    let all = seen.answers.lock().unwrap();
    let Answer { symbol, text, .. } = &all[0];
    assert_eq!(symbol, "not_carried", "{text}");
    for way in ["arch", "line"] {
        assert!(text.contains(&format!("transfer: {way} failed")), "{text}");
    }
    assert!(text.contains("and post are"), "{text}");
    assert!(error(&all[0], [3.0, 2.0]) < 3e-3, "{all:?}");
    nothing_was_hit(&seen);
}

#[test]
fn a_way_that_is_ordered_into_the_table_or_the_board_ends_before_anything_touches() {
    let down = UnitQuaternion::from_euler_angles(std::f64::consts::PI, 0.0, 0.0);
    let at = |x: f64, y: f64, z: f64| Isometry3::from_parts(Translation3::new(x, y, z), down);
    let seen = seen_in(
        &Scratch::new(),
        "",
        vec![
            Step::Move(at(0.5, 0.4, 0.55), &[]),
            // Beside the board, into the table.
            Step::Move(at(0.5, 0.4, 0.38), &[]),
            Step::Move(at(0.5, 0.4, 0.55), &[]),
            Step::Move(at(0.5, 0.0, 0.55), &["clear"]),
            // On the ways to and fro nothing comes near the board.
            Step::Move(at(0.5, 0.0, 0.44), &["clear"]),
            Step::Move(at(0.5, 0.0, 0.55), &["clear"]),
        ],
    );
    let all = seen.answers.lock().unwrap();
    let symbols: Vec<&str> = all.iter().map(|answer| answer.symbol.as_str()).collect();
    let said: Vec<&str> = all.iter().map(|answer| answer.text.as_str()).collect();
    let (moved, guard) = ("moved", "Guard");
    assert_eq!(
        symbols,
        [moved, guard, moved, moved, guard, moved],
        "{said:?}"
    );
    for text in [said[1], said[4]] {
        assert!(text.contains("fingers and table are"), "{text}");
    }
    let touches = seen.touches.lock().unwrap();
    assert!(touches.is_empty(), "{touches:?}");
}
