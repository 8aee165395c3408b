//! The demonstration of the technical report's section 1.5: `foo.a`, `foo.b` and `bar`, built from
//! their recipes. Also that of its section 2.1.5: a flavor added by one line of text.

use ctos::diagnostic::Source;
use sorma::report::code;
use sorma::{
    Class, Context, Dictionary, Method, Outcome, Reply, Report, ServiceObject, Severity, Sorm,
    Transport, demo,
};

/// Says what it does, and asks for a glass.
struct Waiter;

impl ServiceObject for Waiter {
    fn exec(&mut self, cx: &Context<'_>, io: &mut Transport) -> Outcome {
        io.report(Report::verbose("laying the table"));
        let glass = cx.call("glass", Method::Exec, Transport::default(), io)?;
        io.floats = glass.floats;
        Ok(())
    }

    fn ctrl(&mut self, _cx: &Context<'_>, _io: &mut Transport) -> Outcome {
        Ok(())
    }

    fn dump(&self) -> String {
        String::new()
    }
}

/// Is cold, and says so.
struct Glass;

impl ServiceObject for Glass {
    fn exec(&mut self, _cx: &Context<'_>, io: &mut Transport) -> Outcome {
        io.report(Report::warning(201, "the glass is cold"));
        io.floats = vec![0.3];
        Ok(())
    }

    fn ctrl(&mut self, _cx: &Context<'_>, _io: &mut Transport) -> Outcome {
        Ok(())
    }

    fn dump(&self) -> String {
        String::new()
    }
}

/// A manager with the demo classes and their dictionary, a waiter and a glass.
fn kitchen() -> Sorm {
    let mut dictionary = Dictionary::new();
    let source = Source::new("cookbook", demo::DICTIONARY);
    dictionary.load(&source).unwrap();
    let sorm = Sorm::new(dictionary);
    demo::register(&sorm);
    sorm.register(Class::new("waiter", "1", |_, _| Ok(Box::new(Waiter))));
    sorm.register(Class::new("glass", "1", |_, _| Ok(Box::new(Glass))));
    sorm
}

/// How often the object that now has the name was asked for its job.
fn execs(sorm: &Sorm, name: &str) -> String {
    let text = ask(sorm, &format!("{name} DBX -statistics")).text;
    text.split(' ').nth(1).unwrap().to_owned()
}

fn ask(sorm: &Sorm, line: &str) -> Transport {
    sorm.dispatch(line).parse::<Reply>().unwrap().body
}

fn refused(sorm: &Sorm, line: &str) -> (i32, String) {
    let body = ask(sorm, line);
    assert!(!body.is_ok(), "{line} must be refused");
    let report = body.reports.last().unwrap();
    assert_eq!(report.severity, Severity::Error);
    (body.code, report.text.clone())
}

#[test]
fn the_first_use_of_a_name_builds_the_flavor_from_its_recipe_and_later_uses_share_it() {
    let sorm = kitchen();
    assert_eq!(
        ask(&sorm, "foo.a EXEC").text,
        "breakfast in the kitchen, presto"
    );
    assert_eq!(
        ask(&sorm, "foo.b EXEC").text,
        "breakfast in the garden, adagio, fresh juice"
    );
    assert_eq!(
        ask(&sorm, "foo.a@self EXEC").text,
        "breakfast in the kitchen, presto"
    );
    assert_eq!(execs(&sorm, "foo.a"), "2", "both names are one object");
    assert_eq!(sorm.objects(), ["foo.a", "foo.b"]);
    assert_eq!(
        ask(&sorm, "bar CTRL -dump").text,
        "-tea 1.5 -lemon 0.3 -ice crushed",
        "a class without a flavor has its recipe too"
    );
}

#[test]
fn ctrl_changes_one_flavor_and_no_other_until_it_is_removed() {
    let sorm = kitchen();
    ask(&sorm, "foo.a CTRL -tempo piano");
    assert_eq!(
        ask(&sorm, "foo.a EXEC").text,
        "breakfast in the kitchen, piano"
    );
    assert_eq!(
        ask(&sorm, "foo.b EXEC").text,
        "breakfast in the garden, adagio, fresh juice"
    );
    assert!(sorm.remove("foo.a") && !sorm.remove("foo.a"));
    assert_eq!(
        ask(&sorm, "foo.a EXEC").text,
        "breakfast in the kitchen, presto"
    );
    assert_eq!(execs(&sorm, "foo.a"), "1", "it was built anew");
}

#[test]
fn the_carry_example_works_as_printed_with_a_demo_class() {
    let sorm = kitchen();
    let add = "dict CTRL -add foo.slow '-SUBST foo -transferSpeed 0.2'";
    assert!(ask(&sorm, add).is_ok());
    let carried = |name: &str| ask(&sorm, &format!("{name} EXEC FMSG 6 3 4 0 4 5 0")).floats;
    assert_eq!(
        (carried("foo.slow"), carried("foo")),
        (vec![0.2], vec![0.8])
    );
    assert_eq!(
        ask(&sorm, "dict CTRL -query foo.slow").text,
        "-SUBST foo -transferSpeed 0.2"
    );
    assert_eq!(
        ask(&sorm, "dict CTRL -find foo.s").text,
        "foo.slow -SUBST foo -transferSpeed 0.2"
    );
    let list = ask(&sorm, "dict CTRL -remove foo.slow -list").text;
    assert_eq!(list, "bar foo foo.a foo.b");
}

#[test]
fn a_reference_gives_what_the_name_gives() {
    let sorm = kitchen();
    let bar = sorm.get("bar").unwrap();
    let mut io = Transport::default();
    bar.call(&sorm, Method::Exec, &mut io);
    let mut by_name = ask(&sorm, "bar EXEC");
    for (one, other) in io.reports.iter().zip(&mut by_name.reports) {
        // Only the moment may differ.
        other.time_ns = one.time_ns;
    }
    assert_eq!(io, by_name);
    assert_eq!(io.floats, [1.5, 0.3]);
    assert_eq!(bar.dump().unwrap(), "-tea 1.5 -lemon 0.3 -ice crushed");
}

#[test]
fn reports_of_sub_services_reach_the_first_caller_with_who_said_them_and_where() {
    let sorm = kitchen();
    let served = ask(&sorm, "waiter EXEC");
    assert!(served.is_ok());
    assert_eq!(served.floats, [0.3]);
    let said = served.reports.iter();
    let said = said.map(|report| {
        (
            report.object.as_str(),
            report.severity,
            report.text.as_str(),
        )
    });
    assert_eq!(
        said.collect::<Vec<_>>(),
        [
            ("waiter", Severity::Verbose, "laying the table"),
            ("glass", Severity::Warning, "the glass is cold"),
        ]
    );
    let mut reports = served.reports.iter();
    assert!(reports.all(|report| report.file.ends_with("demo_classes.rs") && report.line > 0));

    ask(&sorm, "foo.a CTRL -drink bar");
    ask(&sorm, "bar CTRL -tea 0");
    let failed = ask(&sorm, "foo.a EXEC");
    let first = demo::code::NO_TEA;
    assert_eq!(failed.code, first, "the first cause is the return code");
    let texts = failed.reports.iter().map(|report| report.text.as_str());
    assert_eq!(
        texts.collect::<Vec<_>>(),
        [
            "there is no tea; set -tea",
            "`foo.a` needs `bar EXEC`, which ended with 100",
        ]
    );

    ask(&sorm, "waiter DBX -verbosity warning");
    let quiet = ask(&sorm, "waiter EXEC").reports.len();
    assert_eq!(quiet, 1, "a quiet object keeps its talk back");
}

#[test]
fn dbx_tells_version_and_the_audit_trail_of_ctrl() {
    let sorm = kitchen();
    ask(&sorm, "foo.a CTRL -tempo piano");
    ask(&sorm, "foo.a CTRL -tempo largo");
    assert_eq!(ask(&sorm, "foo.a DBX -version").text, "foo 1.0");
    let trail = ask(&sorm, "foo.a DBX -audit").text;
    let lines: Vec<Vec<&str>> = trail
        .lines()
        .map(|line| line.splitn(4, ' ').collect())
        .collect();
    let untimed: Vec<(&str, &str)> = lines.iter().map(|line| (line[0], line[3])).collect();
    assert_eq!(
        untimed,
        [
            (
                "1",
                "here RET 0 \"-breakfast -where kitchen -tempo presto\""
            ),
            ("2", "here RET 0 \"-tempo piano\""),
            ("3", "here RET 5 \"-tempo largo\""),
        ]
    );
    let times: Vec<f64> = lines.iter().map(|line| line[1].parse().unwrap()).collect();
    assert!(times.is_sorted());
    for index in 0..200 {
        ask(
            &sorm,
            &format!("foo.a CTRL -where garden -drink bar.{index}"),
        );
    }
    assert_eq!(
        ask(&sorm, "foo.a DBX -audit").text.lines().count(),
        64,
        "the trail is bounded"
    );
}

#[test]
fn every_request_that_cannot_be_met_is_answered_with_what_would_have_been_right() {
    let sorm = kitchen();
    let cases = [
        (
            "fo EXEC",
            code::UNKNOWN_CLASS,
            "`fo`: there is no class `fo`; did you mean `foo`?",
        ),
        (
            "foo.c EXEC",
            code::UNKNOWN_FLAVOR,
            "the dictionary has no recipe for `foo.c`; did you mean `foo.a`?",
        ),
        (
            "bar CTRL -te 1",
            code::UNKNOWN_OPTION,
            "unknown option `-te`; did you mean `tea`?",
        ),
        (
            "bar CTRL -tea 9",
            code::VALUE,
            "-tea: must be a number from 0.0 to 2.0 l, not `9`",
        ),
        (
            "bar TALK",
            code::SYNTAX,
            "after the name stands EXEC, CTRL or DBX, not `TALK`",
        ),
        (
            "bar EXEC FMSG 1 2",
            code::VALUE,
            "EXEC takes no floats (FMSG), not 1",
        ),
        ("dict EXEC", code::UNSUPPORTED, "this class has no EXEC"),
        (
            "dict CTRL -query fooa",
            code::VALUE,
            "-query: `fooa` is not in the dictionary; did you mean `foo`?",
        ),
        (
            "foo.a@d1 EXEC",
            code::DAEMON,
            "`foo.a@d1` is served by another daemon: it is asked with `Sorm::ask`, over a link",
        ),
        (
            "FOO.a EXEC",
            code::DAEMON,
            "`FOO.a`: the dictionary names no daemon for `FOO`; add a line `FOO self`, `FOO ALIAS`, `FOO host:number` or `FOO trade`",
        ),
        (
            "bar@druide:11 EXEC",
            code::DAEMON,
            "`bar@druide:11` is served by another daemon: it is asked with `Sorm::ask`, over a link",
        ),
    ];
    for (line, code, text) in cases {
        assert_eq!(refused(&sorm, line), (code, text.to_owned()), "{line}");
    }
    assert_eq!(sorm.objects(), ["bar", "dict"], "no `foo` was built");
}

#[test]
fn one_line_of_dictionary_brings_a_remote_name_home() {
    let sorm = kitchen();
    ask(
        &sorm,
        "dict CTRL -add d1 self -add FOO self -add d2 druide:11",
    );
    assert_eq!(
        ask(&sorm, "foo.a@d1 EXEC").text,
        "breakfast in the kitchen, presto"
    );
    assert_eq!(
        ask(&sorm, "FOO.a EXEC").text,
        "breakfast in the kitchen, presto"
    );
    assert_eq!(sorm.objects(), ["dict", "foo.a"]);
    assert_eq!(refused(&sorm, "foo.a@d2 EXEC").0, code::DAEMON);
}

#[test]
fn an_object_whose_recipe_is_wrong_is_not_kept_and_the_recipe_is_named() {
    let sorm = kitchen();
    ask(&sorm, "dict CTRL -add foo.c '-tempo presot -dinner'");
    let (code, text) = refused(&sorm, "foo.c EXEC");
    assert_eq!(code, code::VALUE);
    assert_eq!(
        text,
        "`foo.c` does not take its recipe `-tempo presot -dinner`: -tempo: must be one of adagio, piano, presto, \
         not `presot`; did you mean `presto`?; unknown option `-dinner`; \
         known here: breakfast, drink, dump, freshJuice, help, tempo, transferSpeed, where"
    );
    ask(&sorm, "dict CTRL -add foo.c '-SUBST foo.a -tempo piano'");
    assert_eq!(
        ask(&sorm, "foo.c EXEC").text,
        "breakfast in the kitchen, piano"
    );
}

#[test]
fn objects_that_call_each_other_in_a_circle_get_an_error_and_no_hang() {
    let sorm = kitchen();
    ask(&sorm, "foo.a CTRL -drink foo.b");
    ask(&sorm, "foo.b CTRL -drink foo.a");
    let failed = ask(&sorm, "foo.a EXEC");
    assert_eq!(failed.code, code::BUSY);
    assert!(
        failed
            .reports
            .iter()
            .any(|report| report.text.starts_with("`foo.a` is in a call already"))
    );
    ask(&sorm, "foo.b CTRL -drink bar");
    assert!(ask(&sorm, "foo.a EXEC").is_ok());
}

#[test]
fn a_class_that_needs_itself_to_be_built_is_refused_with_the_chain() {
    let sorm = kitchen();
    sorm.register(Class::new("hen", "1", |_, sorm| {
        sorm.get("egg")?;
        Ok(Box::new(Glass))
    }));
    sorm.register(Class::new("egg", "1", |_, sorm| {
        sorm.get("hen")?;
        Ok(Box::new(Glass))
    }));
    let (code, text) = refused(&sorm, "hen EXEC");
    assert_eq!(
        (code, text.as_str()),
        (
            code::RECIPE,
            "objects need each other to be built: hen -> egg -> hen"
        )
    );
    assert_eq!(
        ask(&sorm, "bar EXEC").floats,
        [1.5, 0.3],
        "the manager goes on"
    );
}

#[test]
fn opaque_bytes_travel_by_reference_and_are_refused_as_text() {
    struct Camera;
    impl ServiceObject for Camera {
        fn exec(&mut self, _cx: &Context<'_>, io: &mut Transport) -> Outcome {
            io.opaque = vec![1, 2, 3].into();
            Ok(())
        }
        fn ctrl(&mut self, _cx: &Context<'_>, _io: &mut Transport) -> Outcome {
            Ok(())
        }
        fn dump(&self) -> String {
            String::new()
        }
    }
    let sorm = kitchen();
    sorm.register(Class::new("camera", "1", |_, _| Ok(Box::new(Camera))));
    let mut io = Transport::default();
    sorm.get("camera")
        .unwrap()
        .call(&sorm, Method::Exec, &mut io);
    assert_eq!(io.opaque, [1, 2, 3]);
    let (_, text) = refused(&sorm, "camera EXEC");
    assert_eq!(
        text,
        "3 opaque bytes have no textual form; call the object by reference instead"
    );
}
