use super::*;

fn difference(at_ns: u64) -> ReplayReport {
    let mut report = ReplayReport {
        task: "arm".to_owned(),
        messages: 3,
        lost: 2,
        ..ReplayReport::default()
    };
    report.same += 1;
    let at = Instant::from_nanos(at_ns);
    report.differs(at, 7, "this".to_owned(), "that".to_owned());
    report.differs(at, 8, "one".to_owned(), "two".to_owned());
    report
}

#[test]
fn a_report_shows_the_first_difference_and_whatever_may_explain_it() {
    let report = difference(1_500_000_000);
    assert!(!report.is_same());
    let text = report.to_string();
    for part in [
        "3 messages, 1 results the same, 2 different",
        "first difference at 1.500000 s, trace 0.7",
        "expected  this",
        "got       that",
        "lacks 2 events",
    ] {
        assert!(text.contains(part), "{part:?} is not in {text}");
    }
}
