//! A disc is carried over a board by nets, in virtual time: where it should stand it stands, and what cannot be done is told.

use crate::harness::{CTOS, Ended, Scratch};

fn carry(sets: &[&str]) -> Ended {
    let scratch = Scratch::new();
    let mut all = vec![
        "boot",
        "configs/carry.toml",
        "--set",
        "time.mode=\"virtual\"",
        "--json",
    ];
    for set in sets {
        all.extend(["--set", set]);
    }
    scratch.start(CTOS, &all, &[]).end()
}

#[test]
fn a_disc_is_carried_to_its_field_within_a_millimetre_and_onto_another_disc_and_off_again() {
    let ended = carry(&["task.operator.args.list=\"carry/short_tour.txt\""]);
    ended.must_exit(0);
    assert!(
        ended.json()["error_m"].as_f64().unwrap() < 1e-3,
        "{}",
        ended.told
    );
}

#[test]
fn a_disc_whose_target_is_occupied_is_back_where_it_was_and_the_answer_says_why() {
    let ended = carry(&["task.operator.args.arguments=[\"3,4\", \"6,6\"]"]);
    ended.must_say("something stands there already");
    assert_ne!(ended.code, Some(0));
}
