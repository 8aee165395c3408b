//! An arm goes around a post, and pushes a box, by nets, in virtual time.

use crate::harness::{CTOS, Ended, Scratch};

fn boot(file: &str, sets: &[&str]) -> Ended {
    let scratch = Scratch::new();
    let mut all = vec!["boot", file, "--set", "time.mode=\"virtual\"", "--json"];
    for set in sets {
        all.extend(["--set", set]);
    }
    scratch.start(CTOS, &all, &[]).end()
}

#[test]
fn an_arm_goes_from_place_to_place_around_a_post_that_its_line_would_hit() {
    let scratch = Scratch::new();
    let all = [
        "boot",
        "configs/around.toml",
        "--set",
        "time.mode=\"virtual\"",
    ];
    let ended = scratch.start(CTOS, &all, &[]).end();
    ended.must_exit(0);
    assert!(
        ended.told.contains("believed of right to left"),
        "{}",
        ended.told
    );
    ended.must_say("a motion would have ended in a collision");
}

#[test]
fn a_box_is_pushed_to_the_end_of_a_line_and_stands_where_the_answer_says() {
    let ended = boot("configs/push.toml", &[]);
    ended.must_exit(0);
    let json = ended.json();
    let error = json["error_m"].as_f64().unwrap();
    assert!(error.abs() < 0.015, "{}", ended.told);
    // Half the box, and the tool, behind the end of the way of 200 mm.
    let along = json["along_m"].as_f64().unwrap();
    assert!((0.225..0.265).contains(&along), "{}", ended.told);
}

#[test]
fn a_push_at_nothing_and_one_at_what_stands_fast_are_told_as_such() {
    let nothing = "task.operator.args.arguments=[\"0.6,-0.25\", \"0.6,-0.15\"]";
    let ended = boot("configs/push.toml", &[nothing]);
    ended.must_say("nothing was felt");
    assert_ne!(ended.code, Some(0));
}

#[test]
fn a_box_that_something_stands_behind_is_pushed_no_harder_than_it_may_be() {
    let scratch = Scratch::new();
    let cell = scratch.read("configs/push-cell.toml");
    let wall =
        "\n[[furniture]]\ncentre = [0.45, 0.0, 0.45]\nsize = [0.2, 0.05, 0.1]\ngrey = 80.0\n";
    scratch.write("configs/push-cell.toml", cell + wall);
    let all = [
        "boot",
        "configs/push.toml",
        "--set",
        "time.mode=\"virtual\"",
        "--json",
    ];
    let ended = scratch.start(CTOS, &all, &[]).end();
    assert_ne!(ended.code, Some(0));
    ended.must_say("the limit is 25.00 N");
}

#[test]
fn one_straightened_finger_pushes_a_box_to_the_end_of_a_line() {
    let ended = boot("configs/push-finger.toml", &[]);
    ended.must_exit(0);
    let json = ended.json();
    let error = json["error_m"].as_f64().unwrap();
    assert!(error.abs() < 0.015, "{}", ended.told);
}
