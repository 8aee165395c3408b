//! Arms with grippers, asked by lines of text: a file of requests picks a box up and places it elsewhere, another one has two
//! arms carry a bar.

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

#[test]
fn a_file_of_requests_has_both_arms_carry_the_bar_and_put_it_back_and_holds_nothing_afterwards() {
    let scratch = Scratch::new();
    let mut run = scratch.start(CTOS, &["boot", "configs/bar.toml"], &[]);
    run.wait_for("phase 3");
    let carried = scratch.scott(&["bar", "-f", "configs/carry_bar.sor"]);
    carried.must_exit_leaving(0);
    let holds = scratch.scott(&["bar", "-c", "gripper.left EXEC holds"]);
    holds.must_exit_leaving(1);
}
