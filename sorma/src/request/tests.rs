//! Reading is the inverse of printing, and what is refused says what would have been right.

use super::*;
use crate::name::tests::any_name;
use crate::report::tests::any_report;
use proptest::prelude::*;

fn any_body() -> impl Strategy<Value = Transport> {
    let word = prop::sample::select(vec![
        "a", " ", "'", "\"", "\\", "TMSG", "FMSG", "IMSG", "TDBX", "RET", "-x", "1", "\n", "é", "#",
    ]);
    let text = prop_oneof![
        any::<String>(),
        prop::collection::vec(word, 0..8).prop_map(|words| words.concat()),
    ];
    let float = prop_oneof![
        any::<u64>().prop_map(f64::from_bits),
        // Every NaN: all bits of the exponent set.
        any::<u64>().prop_map(|bits| f64::from_bits(bits | 0x7ff0_0000_0000_0000)),
        prop::sample::select(vec![
            0.0,
            -0.0,
            f64::INFINITY,
            f64::NEG_INFINITY,
            5e-324,
            f64::MAX
        ]),
    ];
    let parts = (
        text,
        prop::collection::vec(float, 0..5),
        prop::collection::vec(any::<i64>(), 0..5),
        prop::collection::vec(any_report(), 0..4),
    );
    parts.prop_map(|(text, floats, ints, reports)| Transport {
        text,
        floats,
        ints,
        reports,
        ..Transport::default()
    })
}

/// Equality that sees the bits of a NaN.
fn same(one: &Transport, other: &Transport) -> bool {
    let bits = |body: &Transport| -> Vec<u64> { body.floats.iter().map(|f| f.to_bits()).collect() };
    let rest = |body: &Transport| {
        let mut body = body.clone();
        body.floats.clear();
        body
    };
    bits(one) == bits(other) && rest(one) == rest(other)
}

proptest! {
    #[test]
    fn a_request_is_read_back_exactly(
        name in any_name(),
        method in prop::sample::select(Method::ALL.to_vec()),
        body in any_body(),
    ) {
        let line = Request { name: name.clone(), method, body: body.clone() }.to_text().unwrap();
        prop_assert!(!line.contains('\n'));
        let back: Request = line.parse().unwrap();
        prop_assert_eq!((back.name, back.method), (name, method));
        prop_assert!(same(&back.body, &body), "{}", line);
    }

    #[test]
    fn a_reply_is_read_back_exactly(name in any_name(), code in any::<i32>(), body in any_body()) {
        let body = Transport { code, ..body };
        let line = Reply { name: name.clone(), body: body.clone() }.to_text().unwrap();
        let back: Reply = line.parse().unwrap();
        prop_assert_eq!(back.name, name);
        prop_assert!(same(&back.body, &body), "{}", line);
    }

    #[test]
    fn any_line_is_read_or_refused(line in any::<String>(), tail in any::<String>()) {
        let _ = line.parse::<Request>();
        let _ = line.parse::<Reply>();
        if let Ok(request) = format!("foo EXEC {tail}").parse::<Request>() {
            let again: Request = request.to_text().unwrap().parse().unwrap();
            prop_assert!(same(&again.body, &request.body));
        }
    }
}

fn body(line: &str) -> Transport {
    line.parse::<Request>().unwrap().body
}

#[test]
fn the_lines_of_the_report_are_read_as_printed_there() {
    let add = body("dict CTRL -add carry.slow '-SUBST carry -transferSpeed 0.2'");
    assert_eq!(
        add.text,
        "-add carry.slow '-SUBST carry -transferSpeed 0.2'"
    );
    let carry = body("carry.slow EXEC FMSG 6 3 4 0 4 5 0");
    assert_eq!(carry.floats, [3.0, 4.0, 0.0, 4.0, 5.0, 0.0]);
    let help: Request = "foo.a@d1 CTRL -help -dump".parse().unwrap();
    assert_eq!(
        (help.method, help.body.text.as_str()),
        (Method::Ctrl, "-help -dump")
    );
    assert_eq!(body("nop@self EXEC"), Transport::default());
}

#[test]
fn all_parts_of_a_body_are_read_with_and_without_tmsg() {
    let full = body("k EXEC TMSG ikine now FMSG 2 -0.5 inf IMSG 1 -7 TDBX mind the gap");
    assert_eq!(full.text, "ikine now");
    assert_eq!(full.floats, [-0.5, f64::INFINITY]);
    assert_eq!(full.ints, [-7]);
    assert_eq!(full.reports, [Report::message("mind the gap")]);
    assert_eq!(body("k EXEC \" FMSG  \"").text, " FMSG  ");
    assert_eq!(body("k EXEC say 'FMSG 3' aloud").text, "say 'FMSG 3' aloud");
}

#[test]
fn what_is_no_request_says_what_would_have_been_right() {
    let wrong = |line: &str| line.parse::<Request>().unwrap_err().to_string();
    assert_eq!(
        wrong("  "),
        "the request is empty; write: name EXEC|CTRL|DBX text"
    );
    assert_eq!(
        wrong("foo exec"),
        "after the name stands EXEC, CTRL or DBX, not `exec`"
    );
    assert_eq!(
        wrong("foo"),
        "after the name stands EXEC, CTRL or DBX, not ``"
    );
    assert_eq!(
        wrong("foo EXEC FMSG 3 1 2"),
        "FMSG announces 3 values, but 2 follow"
    );
    assert_eq!(
        wrong("foo EXEC IMSG 18446744073709551615 1"),
        "IMSG announces 18446744073709551615 values, but 1 follow"
    );
    assert_eq!(
        wrong("foo EXEC FMSG 2 1 x"),
        "`x` at byte 18 is not a float"
    );
    assert_eq!(
        wrong("foo EXEC IMSG 1 1.5"),
        "`1.5` at byte 16 is not a whole number"
    );
    assert_eq!(wrong("foo EXEC FMSG -1"), "`-1` at byte 14 is not a count");
    assert!(wrong("foo EXEC FMSG 1 1 2").starts_with("nothing announces `2` at byte 18"));
    assert!(wrong("foo EXEC FMSG 1 1 FMSG 1 2").starts_with("`FMSG` at byte 18 is out of place"));
    assert!(wrong("foo EXEC IMSG 1 1 FMSG 1 2").starts_with("`FMSG` at byte 18 is out of place"));
    assert!(wrong("foo EXEC 'a").starts_with("the quote at byte 9"));
    assert_eq!(
        "foo EXEC".parse::<Reply>().unwrap_err().to_string(),
        "after the name of a reply stands RET and a code, not `EXEC`"
    );
}

#[test]
fn opaque_bytes_are_refused_and_not_dropped() {
    let body = Transport {
        opaque: vec![1, 2].into(),
        ..Transport::default()
    };
    let request = Request {
        name: "foo".parse().unwrap(),
        method: Method::Exec,
        body,
    };
    assert_eq!(request.to_text(), Err(RequestError::Opaque(2)));
}
