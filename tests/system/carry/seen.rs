//! What cameras see: a board that was pushed, discs beside the middles of their fields, and cameras that are not to be believed.

use sim::scene::CameraFault;

use super::{
    layout::{board, error, laid, other},
    person::{Answer, Step, answers},
};

#[test]
fn a_board_that_is_pushed_and_a_disc_beside_the_middle_of_its_field_are_seen_and_the_disc_is_placed_within_1_5_mm()
 {
    let moved = board(0.57, -0.06, 115.0);
    let mut steps = laid(&moved, [3.0, 4.0], [0.008, -0.006]);
    steps.push(other(&moved, [6.0, 6.0]));
    steps.push(Step::Carry("3,4 5,5".to_owned()));
    let again = board(0.53, 0.04, -20.0);
    steps.extend(laid(&again, [5.0, 5.0], [-0.005, 0.007]));
    steps.push(other(&again, [6.0, 2.0]));
    steps.push(Step::Carry("5,5 3,4".to_owned()));
    // It is there no more.
    steps.push(Step::Carry("5,5 3,4".to_owned()));
    steps.push(Step::Carry("3,4 6,2".to_owned()));
    let all = answers(steps);
    for (answer, field) in all.iter().zip([[5.0, 5.0], [3.0, 4.0]]) {
        assert_eq!(answer.symbol, "carried", "{}", answer.text);
        assert!(error(answer, field) < 1.5e-3, "{answer:?}");
        assert!(answer.text.contains("seen on"), "{}", answer.text);
    }
    assert!(
        all[1].text.contains("the board was moved by"),
        "{}",
        all[1].text
    );
    assert_eq!(all[2].symbol, "nothing_at_from", "{}", all[2].text);
    assert!(all[2].text.contains("a red disc on 3.0"), "{}", all[2].text);
    assert_eq!(all[3].symbol, "occupied", "{}", all[3].text);
    assert!(
        all[3].text.contains("a blue disc stands on"),
        "{}",
        all[3].text
    );
}

#[test]
fn a_camera_that_is_covered_dark_or_frozen_is_named_and_the_other_goes_on_alone() {
    let both = |fault| {
        ["left", "right"]
            .map(|camera| Step::Camera(camera, fault))
            .to_vec()
    };
    let mut steps = Vec::new();
    for fault in [CameraFault::Cover, CameraFault::Black, CameraFault::Freeze] {
        steps.extend(both(Some(fault)));
        steps.push(Step::Carry("3,4 4,5".to_owned()));
        steps.extend(both(None));
        // A picture that is believed again.
        steps.push(Step::Carry("1,1 4,5".to_owned()));
    }
    steps.push(Step::Camera("left", Some(CameraFault::Freeze)));
    steps.push(Step::Carry("3,4 4,5".to_owned()));
    let all = answers(steps);
    for (index, name) in [(0, "covered"), (2, "black"), (4, "frozen")] {
        let Answer { symbol, text, .. } = &all[index];
        assert_eq!(symbol, "not_carried", "{name}: {text}");
        assert!(
            text.contains("camera `left`") && text.contains(name),
            "{name}: {text}"
        );
        assert_eq!(
            all[index + 1].symbol,
            "nothing_at_from",
            "{}",
            all[index + 1].text
        );
    }
    let last = &all[6];
    assert_eq!(last.symbol, "carried", "{}", last.text);
    assert!(last.text.contains("frozen"), "{}", last.text);
    assert!(error(last, [4.0, 5.0]) < 3e-3, "{last:?}");
}
