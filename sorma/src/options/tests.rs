//! Option tables: what they take, what they refuse, how they describe themselves.

use super::*;
use crate::description::OptionKind;
use proptest::prelude::*;

#[derive(Debug, Clone, PartialEq)]
struct Arm {
    slow: bool,
    speed: f64,
    retries: i64,
    frame: String,
    tool: String,
    size: Vec<i64>,
    near: Vec<f64>,
}

impl Default for Arm {
    fn default() -> Self {
        Self {
            slow: false,
            speed: 0.5,
            retries: 2,
            frame: "base".to_owned(),
            tool: String::new(),
            size: Vec::new(),
            near: vec![0.0, 0.5],
        }
    }
}

const FORMS: &[Form] = &[
    Form {
        text: "move",
        floats: 2,
        takes: "x and y, m",
        gives: "nothing",
        results: "",
        help: "moves there",
    },
    Form {
        text: "stop",
        floats: 0,
        takes: "",
        gives: "nothing",
        results: "",
        help: "stops",
    },
];

fn table() -> OptionTable<Arm> {
    OptionTable::new("moves an arm")
        .flag("slow", "moves at a tenth of the speed", |arm: &mut Arm| {
            &mut arm.slow
        })
        .float("speed", 0.0..=1.0, "m/s", "speed of the tool", |arm| {
            &mut arm.speed
        })
        .int("retries", -3..=9, "", "how often it tries again", |arm| {
            &mut arm.retries
        })
        .choice("frame", &["base", "tool"], "frame of targets", |arm| {
            &mut arm.frame
        })
        .word("tool", "OBJECT", "what is in the hand", |arm| &mut arm.tool)
        .ints("size", &["W", "H"], 1..=100, "px", "size of it", |arm| {
            &mut arm.size
        })
        .floats(
            "near",
            &["A", "B"],
            -1.0..=1.0,
            "rad",
            "where it is",
            |arm| &mut arm.near,
        )
        .exec(FORMS)
        .action("echo", &["A", "B"], "says both", |_, words| {
            Ok(words.join("+"))
        })
}

fn ctrl(arm: &mut Arm, text: &str) -> Transport {
    let mut io = Transport::text(text);
    table().ctrl(arm, &mut io);
    io
}

fn errors(text: &str) -> Vec<String> {
    let mut arm = Arm::default();
    let io = ctrl(&mut arm, text);
    assert_eq!(arm, Arm::default(), "a refused request changes nothing");
    assert!(!io.is_ok() && io.text.is_empty());
    io.reports.into_iter().map(|report| report.text).collect()
}

#[test]
fn options_set_the_state_and_later_ones_override() {
    let mut arm = Arm::default();
    let io = ctrl(
        &mut arm,
        "-slow -speed 0.1 -retries -3 -tool 'red cup' -speed 1 -frame tool",
    );
    assert!(io.is_ok() && io.text.is_empty() && io.reports.is_empty());
    let expected = Arm {
        slow: true,
        speed: 1.0,
        retries: -3,
        frame: "tool".to_owned(),
        tool: "red cup".to_owned(),
        ..Arm::default()
    };
    assert_eq!(arm, expected);
    ctrl(&mut arm, "-slow off");
    assert!(!arm.slow);
}

#[test]
fn help_and_dump_are_always_there_and_actions_answer() {
    let mut arm = Arm::default();
    let help = ctrl(&mut arm, "-help").text;
    assert!(
        help.contains("-speed 0.0..1.0 m/s") && help.contains("(default 0.5)"),
        "{help}"
    );
    assert!(
        help.contains("-frame base|tool") && help.contains("-echo A B"),
        "{help}"
    );
    let dump = ctrl(&mut arm, "-slow -dump").text;
    assert_eq!(
        dump,
        "-slow on -speed 0.5 -retries 2 -frame base -tool \"\" -near 0.0 0.5"
    );
    assert_eq!(ctrl(&mut arm, "-echo a 'b c' -echo d e").text, "a+b c\nd+e");
}

#[test]
fn all_wrong_options_of_a_request_are_reported_and_nothing_is_taken() {
    assert_eq!(
        errors("-slow -sped 3 x -speed 1.5 -retries 1.5 -frame tol -speed nan"),
        [
            "unknown option `-sped`; did you mean `speed`?",
            "-speed: must be a number from 0.0 to 1.0 m/s, not `1.5`",
            "-retries: must be a whole number from -3 to 9, not `1.5`",
            "-frame: must be one of base, tool, not `tol`; did you mean `tool`?",
            "-speed: must be a number from 0.0 to 1.0 m/s, not `nan`",
        ]
    );
    assert_eq!(errors("-speed"), ["-speed: write -speed 0.0..1.0 m/s"]);
    assert_eq!(errors("-echo a"), ["-echo: write -echo A B"]);
    assert_eq!(
        errors("slow"),
        ["`slow` is no option; options begin with `-`, see -help"]
    );
    assert_eq!(errors("-tool 'a"), ["the quote at byte 6 is not closed"]);
}

#[test]
fn a_list_takes_all_its_numbers_or_none() {
    let mut arm = Arm::default();
    assert!(ctrl(&mut arm, "-size 64 48 -near -0.5 1 -slow").is_ok());
    assert_eq!(
        (arm.size, arm.near, arm.slow),
        (vec![64, 48], vec![-0.5, 1.0], true)
    );
    assert_eq!(
        errors("-size 64"),
        ["-size: write -size W H, each 1..100 px"]
    );
    assert_eq!(
        errors("-size 64 0 -near 0 nan"),
        [
            "-size: H must be a whole number from 1 to 100 px, not `0`",
            "-near: B must be a number from -1.0 to 1.0 rad, not `nan`"
        ]
    );
    assert_eq!(
        errors("-size -slow 3"),
        [
            "-size: W must be a whole number from 1 to 100 px, not `-slow`",
            "`3` is no option; options begin with `-`, see -help"
        ]
    );
}

#[test]
fn the_description_says_all_that_the_help_says() {
    let described = table().describe();
    let of = |name: &str| described.iter().find(|info| info.name == name).unwrap();
    let speed = of("speed");
    assert_eq!(speed.kind, OptionKind::Float);
    assert_eq!(speed.range, Some(["0.0".to_owned(), "1.0".to_owned()]));
    assert_eq!(
        (speed.unit.as_str(), speed.default.as_deref()),
        ("m/s", Some("0.5"))
    );
    assert_eq!(of("frame").choices, ["base", "tool"]);
    assert_eq!(of("size").default, None);
    assert_eq!(of("echo").kind, OptionKind::Action);
    let help = table().help();
    for info in &described {
        let line = format!("-{} {}", info.name, info.form());
        let written = line.replace("on|off", "[on|off]");
        assert!(help.contains(&written), "{written}\n{help}");
        assert!(help.contains(&info.help));
    }
    assert!(help.contains("EXEC move FMSG 2") && help.contains("takes x and y, m"));
}

#[test]
fn a_request_that_fits_no_form_is_told_what_fits() {
    let form = |text: &str, floats: &[f64]| {
        let mut io = Transport::floats(floats);
        io.text = text.to_owned();
        table().form(&io)
    };
    let wrong = |text: &str, floats: &[f64]| form(text, floats).unwrap_err().text;
    assert_eq!(form(" move ", &[1.0, 2.0]), Ok(&FORMS[0]));
    assert_eq!(form("stop", &[]), Ok(&FORMS[1]));
    assert_eq!(wrong("", &[]), "after EXEC stands one of move, stop");
    assert_eq!(
        wrong("mve", &[]),
        "EXEC `mve` is not known here: this class has move, stop; did you mean `move`?"
    );
    assert_eq!(
        wrong("mve 1 2", &[]),
        "EXEC `mve 1 2` is not known here: this class has move, stop; did you mean `move`?"
    );
    assert_eq!(
        wrong("move 1 x", &[]),
        "EXEC move takes numbers (x and y, m), and `x` is none"
    );
    assert_eq!(
        wrong("somewhere", &[]),
        "EXEC `somewhere` is not known here: this class has move, stop"
    );
    assert_eq!(
        wrong("move", &[1.0]),
        "EXEC move takes 2 floats (x and y, m), not 1: write FMSG 2 and the numbers"
    );
    assert_eq!(
        wrong("stop", &[1.0]),
        "EXEC stop takes no floats (FMSG), not 1"
    );
    assert_eq!(
        wrong("move", &[1.0, f64::NEG_INFINITY]),
        "EXEC move takes finite floats (x and y, m), and float 2 of 2 is -inf"
    );
    let endless = wrong(&"x".repeat(1_000_000), &[]);
    assert!(endless.len() < 300 && endless.contains("(1000000 bytes)"));
    let mut io = Transport::text("stop");
    io.ints = vec![1];
    let text = table().form(&io).unwrap_err().text;
    assert_eq!(text, "EXEC stop takes no whole numbers (IMSG), not 1");
}

proptest! {
    #[test]
    fn a_dump_is_a_recipe_for_the_same_state(
        slow in any::<bool>(),
        speed in 0.0..=1.0_f64,
        retries in -3..=9_i64,
        frame in prop::sample::select(vec!["base", "tool"]),
        tool in any::<String>(),
        size in prop_oneof![Just(Vec::new()), prop::collection::vec(1..=100_i64, 2)],
        near in prop::collection::vec(-1.0..=1.0_f64, 2),
    ) {
        let arm = Arm { slow, speed, retries, frame: frame.to_owned(), tool, size, near };
        let mut copy = Arm::default();
        let io = ctrl(&mut copy, &table().dump(&arm));
        prop_assert!(io.is_ok(), "{:?}", io.reports);
        prop_assert_eq!(copy, arm);
    }

    #[test]
    fn any_text_is_taken_whole_or_changes_nothing(text in "[-a-z0-9.'\" ]{0,40}") {
        let mut arm = Arm::default();
        if !ctrl(&mut arm, &text).is_ok() {
            prop_assert_eq!(arm, Arm::default());
        }
    }
}

#[test]
fn a_form_that_wants_a_name_after_its_word_is_none_without_one() {
    let form = Form {
        text: "camera NAME",
        floats: 0,
        takes: "",
        gives: "",
        results: "",
        help: "",
    };
    for text in ["camera left", "camera  the left one"] {
        assert!(form.is_of(text), "{text}");
    }
    for text in ["", "camera", "camera ", "cameras left", "left camera"] {
        assert!(!form.is_of(text), "{text}");
    }
}
