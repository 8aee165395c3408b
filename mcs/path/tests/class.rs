//! The class `path` by its textual requests.

#![allow(clippy::unwrap_used, reason = "a test that cannot be set up fails")]

use ctos::diagnostic::Source;
use mcs_path::services::{DICTIONARY, code, register};
use sorma::{Dictionary, Reply, Sorm, Transport};

fn manager() -> Sorm {
    let mut dictionary = Dictionary::new();
    dictionary.load(&Source::new("path", DICTIONARY)).unwrap();
    let sorm = Sorm::new(dictionary);
    register(&sorm);
    sorm
}

fn ask(sorm: &Sorm, line: &str) -> Transport {
    sorm.dispatch(line).parse::<Reply>().unwrap().body
}

fn done(sorm: &Sorm, line: &str) -> Transport {
    let reply = ask(sorm, line);
    assert!(reply.is_ok(), "{line}: {:?}", reply.reports);
    reply
}

fn refused(sorm: &Sorm, line: &str) -> (i32, String) {
    let reply = ask(sorm, line);
    assert!(!reply.is_ok() && reply.floats.is_empty(), "{line}");
    (reply.code, reply.reports.last().unwrap().text.clone())
}

const PLAN: &str = "path EXEC TMSG plan FMSG 12  -0.7 0.6 -2.6 0 0.4 0  0.9 0.6 -2.6 0 0.4 0";

#[test]
fn an_arm_alone_goes_straight_and_around_a_box_it_goes_by_more_points() {
    let sorm = manager();
    let straight = done(&sorm, PLAN);
    assert_eq!(straight.ints, [2, 6]);
    assert_eq!(straight.floats.len(), 12);
    done(&sorm, "path EXEC box FMSG 6 0.55 0.15 0.4 0.08 0.08 0.8");
    let around = done(&sorm, PLAN);
    assert!(
        around.ints[0] > 2 && around.ints[1] == 6,
        "{:?}",
        around.ints
    );
    assert_eq!(around.floats[..6], straight.floats[..6]);
    assert!(around.text.contains("mm from"), "{}", around.text);
    assert_eq!(done(&sorm, PLAN).floats, around.floats);
    assert_eq!(done(&sorm, "path EXEC clear").ints, [0]);
    assert_eq!(done(&sorm, PLAN).floats, straight.floats);
}

#[test]
fn a_position_is_free_or_the_report_names_what_it_touches() {
    let sorm = manager();
    let free = done(&sorm, "path EXEC free FMSG 6 0.9 0.6 -2.6 0 0.4 0");
    assert_eq!(free.floats.len(), 1);
    done(&sorm, "path EXEC capsule FMSG 7 0.5 0.5 0 0.5 0.5 1.5 0.05");
    done(&sorm, "path EXEC box FMSG 6 0.3 0.35 0.8 0.3 0.3 0.3");
    let (number, text) = refused(&sorm, "path EXEC free FMSG 6 0.9 0.6 -2.6 0 0.4 0");
    assert_eq!(number, code::TOUCHES);
    assert!(
        text.contains("box 2") || text.contains("capsule 1"),
        "{text}"
    );
}

#[test]
fn wrong_requests_are_refused_in_words_and_leave_the_object_as_it_was() {
    let sorm = manager();
    for (line, word) in [
        ("path EXEC TMSG plan FMSG 3 0 0 0", "takes 12 floats, not 3"),
        ("path EXEC box FMSG 6 0 0 0 1 0 1", "above 0 m"),
        ("path EXEC capsule FMSG 7 0 0 0 1 0 1 -1", "above 0 m"),
        (
            "path EXEC TMSG plan FMSG 12 9 0 0 0 0 0 0 0 0 0 0 0",
            "joint 1 of the start",
        ),
        ("path CTRL -arm puma5600", "puma5600"),
        ("path CTRL -room nowhere.toml", "nowhere.toml"),
    ] {
        let reply = ask(&sorm, line);
        let text = reply
            .reports
            .last()
            .map_or("", |report| report.text.as_str());
        assert!(text.contains(word), "{line}: {text}");
    }
    assert!(done(&sorm, "path CTRL -dump").text.contains("-arm puma560"));
    let none = "path.testbed9 EXEC TMSG plan FMSG 2 0 0";
    assert!(refused(&sorm, none).1.contains("18 floats"));
}
