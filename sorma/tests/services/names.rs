//! Names and dictionaries across processes: every form of the report's section 1.4.3, and recipes that are
//! edited where they are used. In virtual time.

use crate::app::{App, Scenario, ask};
use sorma::report::code;

fn two(scenario: Scenario, here: &'static str) -> Result<String, String> {
    let app = App {
        here,
        daemons: vec![
            ("d1", "one", "args.number = 11"),
            ("d2", "two", "args.number = 0x14"),
        ],
        ..App::new(scenario)
    };
    app.run()
}

/// Sets a factor by each name and sees by the plain ones whose object it was.
const WHERE: Scenario = |cx, sorm| {
    Box::pin(async move {
        let mut found = Vec::new();
        for name in [
            "scale",
            "scale@self",
            "scale@d1",
            "scale@localhost:11",
            "scale@localhost:0x14",
            "scale@mine",
            "SCALE",
        ] {
            for plain in ["scale", "scale@d1", "scale@d2"] {
                let clear = ask(&sorm, &cx, &format!("{plain} CTRL -factor 1")).await;
                assert!(clear.body.is_ok());
            }
            let set = ask(&sorm, &cx, &format!("{name} CTRL -factor 7")).await;
            assert!(set.body.is_ok(), "{:?}", set.body.reports);
            assert_eq!(set.name.to_string(), name.replace("0x14", "20"));
            for plain in ["scale", "scale@d1", "scale@d2"] {
                let reply = ask(&sorm, &cx, &format!("{plain} EXEC FMSG 1 1")).await;
                if reply.body.floats == [7.0] {
                    found.push(plain);
                }
            }
        }
        Ok(found.join(" "))
    })
};

#[test]
fn each_form_of_a_name_leads_to_the_daemon_that_it_says() {
    let plain = "scale scale scale@d1 scale@d1 scale@d2";
    let by_name = "mine d2\nSCALE d1\n";
    assert_eq!(
        two(WHERE, by_name),
        Ok(format!("{plain} scale@d2 scale@d1"))
    );
    let by_address = "mine localhost:11\nSCALE localhost:20\n";
    assert_eq!(
        two(WHERE, by_address),
        Ok(format!("{plain} scale@d1 scale@d2"))
    );
    let here = "mine self\nSCALE self\n";
    assert_eq!(two(WHERE, here), Ok(format!("{plain} scale scale")));
}

#[test]
fn an_address_that_nobody_has_is_told_with_those_there_are() {
    let scenario: Scenario = |cx, sorm| {
        Box::pin(async move {
            let mut texts = Vec::new();
            for name in ["scale@druide:11", "scale@localhost:12", "SCALE"] {
                let reply = ask(&sorm, &cx, &format!("{name} EXEC FMSG 1 1")).await;
                assert_eq!(reply.body.code, code::DAEMON, "{name}");
                texts.push(reply.body.reports[0].text.clone());
            }
            Ok(texts.join("\n"))
        })
    };
    let text = two(scenario, "").unwrap();
    for part in [
        "scale@druide:11",
        "localhost:11 (`d1`), localhost:20 (`d2`)",
        "names no daemon for `SCALE`",
    ] {
        assert!(text.contains(part), "{part}: {text}");
    }
    let app = App {
        daemons: vec![
            ("d1", "one", "args.number = 11"),
            ("d2", "two", "args.number = 11"),
        ],
        ..App::new(scenario)
    };
    let text = app.run().unwrap();
    assert!(
        text.contains("there are localhost:11 (`d1`), localhost:11 (`d2`)"),
        "{text}"
    );
}

#[test]
fn a_dictionary_of_another_process_is_edited_while_it_runs_and_its_next_objects_follow() {
    let scenario: Scenario = |cx, sorm| {
        Box::pin(async move {
            let says = |line: &'static str| {
                let (sorm, cx) = (sorm.clone(), cx.clone());
                async move { ask(&sorm, &cx, line).await.body }
            };
            let unknown = says("scale.slow@d1 EXEC FMSG 1 1").await;
            assert_eq!(unknown.code, code::UNKNOWN_FLAVOR);
            let add = "dict@d1 CTRL -add scale.slow '-SUBST scale.two -factor 0.2'";
            assert!(says(add).await.is_ok());
            assert_eq!(says("scale.slow@d1 EXEC FMSG 1 1").await.floats, [0.2]);
            let here = says("scale.slow EXEC FMSG 1 1").await;
            assert_eq!(here.code, code::UNKNOWN_FLAVOR, "ours is another one");
            assert_eq!(
                says("dict@d1 CTRL -query scale.slow").await.text,
                "-SUBST scale.two -factor 0.2"
            );
            // An object that was built keeps its state; the next one is cooked by the new recipe.
            assert!(
                says("dict@d1 CTRL -add scale.slow '-factor 3'")
                    .await
                    .is_ok()
            );
            assert_eq!(says("scale.slow@d1 EXEC FMSG 1 1").await.floats, [0.2]);
            assert!(says("sorm@d1 CTRL -free scale.slow").await.is_ok());
            assert_eq!(says("scale.slow@d1 EXEC FMSG 1 1").await.floats, [3.0]);
            assert!(says("dict@d1 CTRL -remove scale.slow").await.is_ok());
            assert_eq!(
                says("dict@d1 CTRL -query scale.slow").await.code,
                code::VALUE
            );
            assert!(
                says("dict@d1 CTRL -add scale.slow '-factor 4' -save")
                    .await
                    .is_ok()
            );
            assert!(
                says("dict@d1 CTRL -remove scale.slow -reload")
                    .await
                    .is_ok()
            );
            assert_eq!(
                says("dict@d1 CTRL -query scale.slow").await.text,
                "-factor 4"
            );
            let circle =
                says("dict@d1 CTRL -add scale.a '-SUBST scale.b' -add scale.b '-SUBST scale.a'")
                    .await;
            assert!(circle.is_ok());
            let circle = says("scale.a@d1 EXEC FMSG 1 1").await;
            assert_eq!(circle.code, code::RECIPE);
            assert!(
                circle.reports[0]
                    .text
                    .contains("scale.a -> scale.b -> scale.a")
            );
            Ok(String::new())
        })
    };
    assert_eq!(App::new(scenario).run(), Ok(String::new()));
}

#[test]
fn flavors_of_another_process_are_shared_private_removed_aliased_and_listed() {
    let scenario: Scenario = |cx, sorm| {
        Box::pin(async move {
            let says = |line: &'static str| {
                let (sorm, cx) = (sorm.clone(), cx.clone());
                async move { ask(&sorm, &cx, line).await.body }
            };
            assert!(
                says("dict@d1 CTRL -add count.mine '' -add count.yours ''")
                    .await
                    .is_ok()
            );
            for (line, expected) in [
                ("count.mine@d1 EXEC", 1),
                ("count.mine@d1 EXEC", 2),
                ("count.yours@d1 EXEC", 1),
            ] {
                assert_eq!(says(line).await.ints, [expected], "{line}");
            }
            assert!(says("sorm@d1 CTRL -alias counter count.mine").await.is_ok());
            assert_eq!(says("counter@d1 EXEC").await.ints, [3]);
            assert_eq!(
                says("sorm@d1 CTRL -list").await.text,
                "count.mine\ncount.yours\ndict\nsorm"
            );
            assert!(says("sorm@d1 CTRL -free count.mine").await.is_ok());
            assert_eq!(
                says("counter@d1 EXEC").await.ints,
                [1],
                "its next use builds it anew"
            );
            let statistics = says("sorm@d1 CTRL -statistics").await.text;
            assert!(
                statistics.contains("count.mine exec 1 ctrl 1 errors 0"),
                "{statistics}"
            );
            let classes = says("sorm@d1 CTRL -classes").await.text;
            assert!(
                classes.contains("scale 1.0") && classes.contains("stream "),
                "{classes}"
            );
            Ok(String::new())
        })
    };
    assert_eq!(App::new(scenario).run(), Ok(String::new()));
}

#[test]
fn a_daemon_of_ones_own_has_fork_later_stream_and_event() {
    let scenario: Scenario = |cx, sorm| {
        Box::pin(async move {
            let classes = ask(&sorm, &cx, "sorm@own CTRL -classes").await.body.text;
            for class in ["event", "fork", "later", "stream"] {
                assert!(classes.contains(&format!("{class} ")), "{class}: {classes}");
            }
            let ticket = ask(&sorm, &cx, "later@own EXEC ask 'sorm CTRL -list'").await;
            assert_eq!(ticket.body.ints, [1], "{:?}", ticket.body.reports);
            Ok(String::new())
        })
    };
    let app = App {
        daemons: vec![("own", "cage", "")],
        classes: |_| {},
        ..App::new(scenario)
    };
    assert_eq!(app.run(), Ok(String::new()));
}

#[test]
fn wrong_arguments_of_a_daemon_and_missing_dictionaries_are_found_before_anything_starts() {
    let found = |lines: &str| {
        let text = format!(
            "[chassis.cage]\n[task.d1]\nhandler = \"sorma.daemon\"\non = \"cage\"\n{lines}\n"
        );
        let app = ctos::config::load_texts(&[("app.toml", &text)], &[], &[]).unwrap();
        let mut registry = ctos::registry::Registry::new();
        sorma::daemon::register(&mut registry, sorma::Dictionary::new(), |_, _| {});
        let findings = registry.check(&app);
        findings.iter().map(ToString::to_string).collect::<Vec<_>>()
    };
    assert_eq!(found(""), Vec::<String>::new());
    for (lines, part) in [
        ("args.dictonary = [\"a.dict\"]", "dictonary"),
        ("args.dictionary = [\"gone.dict\"]", "gone.dict"),
        ("args.number = -1", "number"),
    ] {
        let said = found(lines);
        assert!(
            said.len() == 1 && said[0].contains(part) && said[0].contains("app.toml:5"),
            "{said:?}"
        );
    }
}

#[test]
fn an_object_tells_who_used_it_how_often_how_long_and_with_how_much_data() {
    let scenario: Scenario = |cx, sorm| {
        Box::pin(async move {
            for line in [
                "scale.two@d1 EXEC FMSG 2 1 2",
                "scale.two@d1 EXEC",
                "scale.two@d1 CTRL -factor 3",
                "scale.two@d1 DBX -version",
                "nap@d1 EXEC",
            ] {
                let _ = ask(&sorm, &cx, line).await;
            }
            let meter = ask(&sorm, &cx, "scale.two@d1 DBX -meter").await.body.text;
            // Two floats in and out, and the text of the CTRL.
            assert!(
                meter.starts_with("client@desk calls 3 errors 1 took 0.0")
                    && meter.ends_with(" s in 25 bytes out 16 bytes"),
                "{meter}"
            );
            let meter = ask(&sorm, &cx, "nap@d1 DBX -meter").await.body.text;
            assert!(
                meter.contains("calls 1 errors 0 took 5.0"),
                "the time of what it waited for: {meter}"
            );
            Ok(String::new())
        })
    };
    assert_eq!(App::new(scenario).run(), Ok(String::new()));
}
