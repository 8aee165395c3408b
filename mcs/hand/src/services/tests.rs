//! The class `manus` by its textual requests, with a hand of the process.

use super::*;
use ctos::diagnostic::Source;
use sorma::{Dictionary, Reply, Transport};

fn manager() -> Sorm {
    let mut dictionary = Dictionary::new();
    dictionary.load(&Source::new("hand", DICTIONARY)).unwrap();
    let sorm = Sorm::new(dictionary);
    register(&sorm);
    sorm
}

/// The reply to a line of text.
fn ask(sorm: &Sorm, line: &str) -> Transport {
    sorm.dispatch(line).parse::<Reply>().unwrap().body
}

fn floats(sorm: &Sorm, line: &str) -> Vec<f64> {
    let reply = ask(sorm, line);
    assert!(reply.is_ok(), "{line}: {:?}", reply.reports);
    reply.floats
}

/// The code and the text of a request that is refused.
fn refused(sorm: &Sorm, line: &str) -> (i32, String) {
    let reply = ask(sorm, line);
    assert!(!reply.is_ok() && reply.floats.is_empty(), "{line}");
    (reply.code, reply.reports.last().unwrap().text.clone())
}

#[test]
fn fingers_move_per_joint_per_finger_and_per_fingertip_and_stay_where_they_are_put() {
    let sorm = manager();
    assert_eq!(floats(&sorm, "manus EXEC where")[..9], [0.0; 9]);
    let moved = floats(&sorm, "manus EXEC joint FMSG 2 2 0.5");
    assert_eq!(moved[..3], [0.0, 0.5, 0.0]);
    let moved = floats(&sorm, "manus EXEC joint by FMSG 2 2 0.25");
    assert_eq!(moved[..3], [0.0, 0.75, 0.0]);
    let moved = floats(&sorm, "manus EXEC finger FMSG 4 3 0.1 0.2 0.3");
    assert_eq!(moved[..9], [0.0, 0.75, 0.0, 0.0, 0.0, 0.0, 0.1, 0.2, 0.3]);
    let goal = floats(&sorm, "manus EXEC tip FMSG 4 1 0.02 0.005 0.14");
    for (found, wanted) in goal[9..12].iter().zip([0.02, 0.005, 0.14]) {
        assert!((found - wanted).abs() < 1e-9, "{goal:?}");
    }
    assert_eq!(goal[3..9], moved[3..9]);
    assert_eq!(floats(&sorm, "manus EXEC where"), goal);
}

#[test]
fn all_fingertips_move_on_alike() {
    let sorm = manager();
    let before = floats(&sorm, "manus EXEC posture tripod");
    let after = floats(&sorm, "manus EXEC tips by FMSG 3 0.004 -0.003 0.005");
    for finger in 0..3 {
        for (axis, way) in [0.004, -0.003, 0.005].into_iter().enumerate() {
            let index = 9 + 3 * finger + axis;
            assert!((after[index] - before[index] - way).abs() < 1e-9, "{index}");
        }
    }
}

#[test]
fn a_sequence_goes_through_its_postures_and_one_that_is_too_fast_is_refused() {
    let sorm = manager();
    let fist = [0.0, 0.9, 1.5].repeat(3);
    assert!(ask(&sorm, "dict CTRL -add sequence.two 'open 2 fist 2'").is_ok());
    assert_eq!(floats(&sorm, "manus EXEC sequence two")[..9], fist);
    assert!(ask(&sorm, "dict CTRL -add sequence.hasty 'open 0.01'").is_ok());
    let (code, text) = refused(&sorm, "manus EXEC sequence hasty");
    assert!(code == code::HAND && text.contains("at least"), "{text}");
    assert_eq!(floats(&sorm, "manus EXEC where")[..9], fist);
}

#[test]
fn what_a_hand_cannot_do_is_refused_by_name_and_moves_nothing() {
    let sorm = manager();
    let before = floats(&sorm, "manus EXEC posture tripod");
    for (line, said) in [
        ("manus EXEC joint FMSG 2 10 0", "joint 1 to 9"),
        ("manus EXEC joint FMSG 2 1.5 0", "joint 1 to 9"),
        ("manus EXEC joint FMSG 2 1 3", "its limits are"),
        ("manus EXEC finger FMSG 4 4 0 0 0", "finger 1 to 3"),
        ("manus EXEC tip FMSG 4 1 0.5 0 0.1", "cannot reach"),
        ("manus EXEC tips by FMSG 3 0 0 0.1", "cannot reach"),
        ("manus EXEC posture nowhere", "posture.nowhere"),
        ("manus EXEC sequence nowhere", "sequence.nowhere"),
        ("manus EXEC joint of FMSG 2 1 0", "joint by"),
        ("manus EXEC grasp", "touches nothing"),
    ] {
        let (_, text) = refused(&sorm, line);
        assert!(text.contains(said), "{line}: {text}");
        assert_eq!(floats(&sorm, "manus EXEC where"), before, "{line}");
    }
}
