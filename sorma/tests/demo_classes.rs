//! The demonstration of the technical report's section 1.5: `foo.a`, `foo.b` and `bar`, built from
//! their recipes, and of its section 2.1.5: a flavor added by one line of text.

#![allow(
    clippy::unwrap_used,
    reason = "helpers of tests stand outside test functions"
)]

use ctos::diagnostic::Source;
use sorma::report::code;
use sorma::{
    Class, Context, Dictionary, Method, OptionTable, Outcome, Reply, Report, ServiceObject,
    Severity, Sorm, Transport,
};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, LazyLock};

const COOKBOOK: &str = "\
# the entries of section 1.5
foo.a -breakfast -where kitchen -tempo presto
foo.b -breakfast -where garden -freshJuice -tempo adagio
bar   -tea 1.5 -ice crushed \\
      -lemon 0.3
carry -transferSpeed 0.8
";

#[derive(Debug, Clone, Default)]
struct Meal {
    breakfast: bool,
    fresh_juice: bool,
    place: String,
    tempo: String,
    drink: String,
}

static MEAL: LazyLock<OptionTable<Meal>> = LazyLock::new(|| {
    OptionTable::new("serves a meal")
        .flag("breakfast", "early", |meal: &mut Meal| &mut meal.breakfast)
        .flag("freshJuice", "pressed now", |meal| &mut meal.fresh_juice)
        .choice(
            "where",
            &["kitchen", "garden"],
            "where it is served",
            |meal| &mut meal.place,
        )
        .choice(
            "tempo",
            &["adagio", "piano", "presto"],
            "how fast",
            |meal| &mut meal.tempo,
        )
        .word(
            "drink",
            "OBJECT",
            "the service that brings the drink",
            |meal| &mut meal.drink,
        )
});

struct Foo(Meal);

impl ServiceObject for Foo {
    fn exec(&mut self, cx: &Context<'_>, io: &mut Transport) -> Outcome {
        io.report(Report::verbose("laying the table"));
        if !self.0.drink.is_empty() {
            let drink = cx.call(&self.0.drink, Method::Exec, Transport::default(), io)?;
            io.floats = drink.floats;
        }
        io.text = format!("breakfast in the {}, {}", self.0.place, self.0.tempo);
        Ok(())
    }

    fn ctrl(&mut self, _cx: &Context<'_>, io: &mut Transport) -> Outcome {
        MEAL.ctrl(&mut self.0, io);
        Ok(())
    }

    fn dump(&self) -> String {
        MEAL.dump(&self.0)
    }
}

#[derive(Debug, Clone, Default)]
struct Drink {
    tea: f64,
    lemon: f64,
    ice: String,
}

static DRINK: LazyLock<OptionTable<Drink>> = LazyLock::new(|| {
    OptionTable::new("mixes a drink")
        .float(
            "tea",
            0.0..=2.0,
            "l",
            "how much tea",
            |drink: &mut Drink| &mut drink.tea,
        )
        .float("lemon", 0.0..=1.0, "", "part of a lemon", |drink| {
            &mut drink.lemon
        })
        .choice(
            "ice",
            &["none", "crushed", "cubes"],
            "form of the ice",
            |drink| &mut drink.ice,
        )
});

struct Bar(Drink);

impl ServiceObject for Bar {
    fn exec(&mut self, _cx: &Context<'_>, io: &mut Transport) -> Outcome {
        if self.0.tea == 0.0 {
            return Err(Report::error(117, "there is no tea; set -tea"));
        }
        io.report(Report::warning(101, "the glass is cold"));
        io.floats = vec![self.0.tea, self.0.lemon];
        Ok(())
    }

    fn ctrl(&mut self, _cx: &Context<'_>, io: &mut Transport) -> Outcome {
        DRINK.ctrl(&mut self.0, io);
        Ok(())
    }

    fn dump(&self) -> String {
        DRINK.dump(&self.0)
    }
}

#[derive(Debug, Clone, Default)]
struct Speed {
    transfer: f64,
}

static SPEED: LazyLock<OptionTable<Speed>> = LazyLock::new(|| {
    OptionTable::new("carries a piece from field to field").float(
        "transferSpeed",
        0.0..=1.0,
        "m/s",
        "speed of the transfer",
        |speed: &mut Speed| &mut speed.transfer,
    )
});

struct Carry(Speed);

impl ServiceObject for Carry {
    fn exec(&mut self, _cx: &Context<'_>, io: &mut Transport) -> Outcome {
        if io.floats.len() != 6 {
            let text = format!(
                "takes 6 floats, two fields of x y z, not {}",
                io.floats.len()
            );
            return Err(Report::error(code::VALUE, text));
        }
        io.floats = vec![self.0.transfer];
        Ok(())
    }

    fn ctrl(&mut self, _cx: &Context<'_>, io: &mut Transport) -> Outcome {
        SPEED.ctrl(&mut self.0, io);
        Ok(())
    }

    fn dump(&self) -> String {
        SPEED.dump(&self.0)
    }
}

/// A manager with the demo classes, and how many objects of class `foo` were built.
fn kitchen() -> (Sorm, Arc<AtomicUsize>) {
    let mut dictionary = Dictionary::new();
    dictionary.load(&Source::new("cookbook", COOKBOOK)).unwrap();
    let sorm = Sorm::new(dictionary);
    let built = Arc::new(AtomicUsize::new(0));
    let count = Arc::clone(&built);
    sorm.register(Class::new("foo", "1.2", move |_, _| {
        count.fetch_add(1, Ordering::Relaxed);
        Ok(Box::new(Foo(Meal::default())))
    }));
    sorm.register(Class::new("bar", "0.3", |_, _| {
        Ok(Box::new(Bar(Drink::default())))
    }));
    sorm.register(Class::new("carry", "2.0", |_, _| {
        Ok(Box::new(Carry(Speed::default())))
    }));
    (sorm, built)
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
    let (sorm, built) = kitchen();
    assert_eq!(
        ask(&sorm, "foo.a EXEC").text,
        "breakfast in the kitchen, presto"
    );
    assert_eq!(
        ask(&sorm, "foo.b EXEC").text,
        "breakfast in the garden, adagio"
    );
    assert_eq!(
        ask(&sorm, "foo.a@self EXEC").text,
        "breakfast in the kitchen, presto"
    );
    assert_eq!(built.load(Ordering::Relaxed), 2);
    assert_eq!(sorm.objects(), ["foo.a", "foo.b"]);
    assert_eq!(
        ask(&sorm, "bar CTRL -dump").text,
        "-tea 1.5 -lemon 0.3 -ice crushed",
        "a class without a flavor has its recipe too"
    );
}

#[test]
fn ctrl_changes_one_flavor_and_no_other_until_it_is_removed() {
    let (sorm, built) = kitchen();
    ask(&sorm, "foo.a CTRL -tempo piano");
    assert_eq!(
        ask(&sorm, "foo.a EXEC").text,
        "breakfast in the kitchen, piano"
    );
    assert_eq!(
        ask(&sorm, "foo.b EXEC").text,
        "breakfast in the garden, adagio"
    );
    assert!(sorm.remove("foo.a") && !sorm.remove("foo.a"));
    assert_eq!(
        ask(&sorm, "foo.a EXEC").text,
        "breakfast in the kitchen, presto"
    );
    assert_eq!(built.load(Ordering::Relaxed), 3);
}

#[test]
fn the_carry_example_works_as_printed() {
    let (sorm, _) = kitchen();
    assert!(
        ask(
            &sorm,
            "dict CTRL -add carry.slow '-SUBST carry -transferSpeed 0.2'"
        )
        .is_ok()
    );
    assert_eq!(
        ask(&sorm, "carry.slow EXEC FMSG 6 3 4 0 4 5 0").floats,
        [0.2]
    );
    assert_eq!(ask(&sorm, "carry EXEC FMSG 6 4 5 0 3 4 0").floats, [0.8]);
    assert_eq!(
        ask(&sorm, "dict CTRL -query carry.slow").text,
        "-SUBST carry -transferSpeed 0.2"
    );
    let list = ask(&sorm, "dict CTRL -remove carry.slow -list").text;
    assert_eq!(list, "bar carry foo.a foo.b");
}

#[test]
fn a_reference_gives_what_the_name_gives() {
    let (sorm, _) = kitchen();
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
    let (sorm, _) = kitchen();
    ask(&sorm, "foo.a CTRL -drink bar");
    let meal = ask(&sorm, "foo.a EXEC");
    assert!(meal.is_ok());
    assert_eq!(meal.floats, [1.5, 0.3]);
    let said: Vec<_> = meal
        .reports
        .iter()
        .map(|report| {
            (
                report.object.as_str(),
                report.severity,
                report.text.as_str(),
            )
        })
        .collect();
    assert_eq!(
        said,
        [
            ("foo.a", Severity::Verbose, "laying the table"),
            ("bar", Severity::Warning, "the glass is cold"),
        ]
    );
    assert!(
        meal.reports
            .iter()
            .all(|report| report.file.ends_with("demo_classes.rs") && report.line > 0)
    );

    ask(&sorm, "bar CTRL -tea 0");
    let failed = ask(&sorm, "foo.a EXEC");
    assert_eq!(failed.code, 117, "the first cause is the return code");
    let last: Vec<_> = failed
        .reports
        .iter()
        .rev()
        .take(2)
        .map(|report| report.text.as_str())
        .collect();
    assert_eq!(
        last,
        [
            "`foo.a` needs `bar EXEC`, which ended with 117",
            "there is no tea; set -tea"
        ]
    );

    ask(&sorm, "foo.a DBX -verbosity warning");
    ask(&sorm, "bar CTRL -tea 1");
    assert_eq!(
        ask(&sorm, "foo.a EXEC").reports.len(),
        1,
        "a quiet object keeps its talk back"
    );
}

#[test]
fn dbx_tells_version_and_the_audit_trail_of_ctrl() {
    let (sorm, _) = kitchen();
    ask(&sorm, "foo.a CTRL -tempo piano");
    ask(&sorm, "foo.a CTRL -tempo largo");
    assert_eq!(ask(&sorm, "foo.a DBX -version").text, "foo 1.2");
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
    let (sorm, built) = kitchen();
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
            "carry EXEC FMSG 1 2",
            code::VALUE,
            "takes 6 floats, two fields of x y z, not 1",
        ),
        ("dict EXEC", code::UNSUPPORTED, "this class has no EXEC"),
        (
            "dict CTRL -query fooa",
            code::VALUE,
            "-query: `fooa` is not in the dictionary; did you mean `foo.a`?",
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
    assert_eq!(built.load(Ordering::Relaxed), 0);
}

#[test]
fn one_line_of_dictionary_brings_a_remote_name_home() {
    let (sorm, _) = kitchen();
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
    let (sorm, _) = kitchen();
    ask(&sorm, "dict CTRL -add foo.c '-tempo presot -dinner'");
    let (code, text) = refused(&sorm, "foo.c EXEC");
    assert_eq!(code, code::VALUE);
    assert_eq!(
        text,
        "`foo.c` does not take its recipe `-tempo presot -dinner`: -tempo: must be one of adagio, piano, presto, \
         not `presot`; did you mean `presto`?; unknown option `-dinner`; \
         known here: breakfast, drink, dump, freshJuice, help, tempo, where"
    );
    ask(&sorm, "dict CTRL -add foo.c '-SUBST foo.a -tempo piano'");
    assert_eq!(
        ask(&sorm, "foo.c EXEC").text,
        "breakfast in the kitchen, piano"
    );
}

#[test]
fn objects_that_call_each_other_in_a_circle_get_an_error_and_no_hang() {
    let (sorm, _) = kitchen();
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
    let (sorm, _) = kitchen();
    sorm.register(Class::new("hen", "1", |_, sorm| {
        sorm.get("egg")?;
        Ok(Box::new(Bar(Drink::default())))
    }));
    sorm.register(Class::new("egg", "1", |_, sorm| {
        sorm.get("hen")?;
        Ok(Box::new(Bar(Drink::default())))
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
            io.opaque = vec![1, 2, 3];
            Ok(())
        }
        fn ctrl(&mut self, _cx: &Context<'_>, _io: &mut Transport) -> Outcome {
            Ok(())
        }
        fn dump(&self) -> String {
            String::new()
        }
    }
    let (sorm, _) = kitchen();
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
