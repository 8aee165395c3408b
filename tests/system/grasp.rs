//! An arm with a gripper, asked by lines of text: a file of requests picks a box up and places it elsewhere.

use crate::harness::{CTOS, Scratch};

#[test]
fn a_file_of_requests_has_the_box_picked_up_and_placed_elsewhere() {
    let scratch = Scratch::new();
    let mut run = scratch.start(CTOS, &["boot", "configs/grasp.toml"], &[]);
    run.wait_for("phase 3");
    let ended = scratch.scott(&["grasp", "-f", "configs/pick_and_place.sor"]);
    ended.must_exit_leaving(0);
    // It is no more where it was: what it should hold is refused with the reason.
    let again = scratch.scott(&["grasp", "-f", "configs/pick_and_place.sor"]);
    again
        .must_exit_leaving(1)
        .must_say("the jaws stand 0.0 mm apart");
}
