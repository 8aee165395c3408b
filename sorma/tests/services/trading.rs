//! Trading: which daemon gets a request, by attributes, availability and measured latency, and how the load
//! moves when one dies or slows. In virtual time.

use crate::app::{App, Scenario, ask, kill, request, seconds};
use ctos::boot::{Fault, FaultKind};
use ctos::task::Context as TaskContext;
use ctos::time::Instant;
use futures_util::future::join;
use sorma::daemon::Tasks;
use sorma::report::code;
use sorma::{Keep, Sorm};

/// Three that offer the class, one of them with the other arm, and one that does not.
fn market(scenario: Scenario, here: &'static str, faults: Vec<Fault>) -> Result<String, String> {
    let app = App {
        here,
        daemons: vec![
            (
                "d1",
                "one",
                "args.offers.scale = { arm = \"left\", price = 3 }\nargs.offers.count = {}",
            ),
            (
                "d2",
                "two",
                "args.offers.scale = { arm = \"left\", price = 2.5 }\nargs.offers.count = {}",
            ),
            (
                "d3",
                "three",
                "args.offers.scale = { arm = \"right\", price = 1, spare = true }",
            ),
            ("d4", "four", ""),
        ],
        faults,
        ..App::new(scenario)
    };
    app.run()
}

/// How many requests each daemon's object has met.
async fn load(sorm: &Sorm, cx: &TaskContext) -> Vec<String> {
    let mut load = Vec::new();
    for daemon in ["d1", "d2", "d3"] {
        let answer = ask(sorm, cx, &format!("scale.two@{daemon} DBX -statistics")).await;
        let text = answer.body.text;
        let count = text.split(' ').nth(1).unwrap_or("none").to_owned();
        load.push(count);
    }
    load
}

#[test]
fn a_request_goes_to_the_offer_that_meets_what_is_wanted_and_is_the_best() {
    for (here, expected) in [
        ("SCALE trade arm=left -least price\n", "0 10 0"),
        ("SCALE trade -least price\n", "0 0 10"),
        ("SCALE trade -most price\n", "10 0 0"),
        ("SCALE trade spare=true\n", "0 0 10"),
        ("SCALE trade -least price -among d1,d4\n", "10 0 0"),
        ("SCALE trade price>2.5\n", "10 0 0"),
        ("SCALE d2\n", "0 10 0"),
    ] {
        let scenario: Scenario = |cx, sorm| {
            Box::pin(async move {
                for _ in 0..10 {
                    let reply = ask(&sorm, &cx, "SCALE.two EXEC FMSG 1 21").await;
                    assert_eq!(reply.body.floats, [42.0], "{:?}", reply.body.reports);
                    cx.sleep(seconds(0.4)).await;
                }
                Ok(load(&sorm, &cx).await.join(" "))
            })
        };
        assert_eq!(
            market(scenario, here, Vec::new()),
            Ok(expected.to_owned()),
            "{here}"
        );
    }
}

#[test]
fn an_alias_is_traded_as_a_class_is_and_so_are_one_way_requests_and_streams() {
    let scenario: Scenario = |cx, sorm| {
        Box::pin(async move {
            let comm = Tasks::of(&cx);
            let mut stream = sorm
                .subscribe(&comm, "scale.two@cheap", Keep::Latest)
                .await
                .unwrap();
            let one_way = request("scale.two@cheap EXEC FMSG 1 4");
            sorm.tell_only(&comm, one_way).await.unwrap();
            let sample = stream.next(&comm).await.unwrap();
            assert_eq!(sample.body.floats, [8.0]);
            Ok(load(&sorm, &cx).await.join(" "))
        })
    };
    let here = "cheap trade arm=left -least price\n";
    assert_eq!(market(scenario, here, Vec::new()), Ok("0 1 0".to_owned()));
}

#[test]
fn requests_that_come_at_once_before_any_offer_is_known_are_all_met() {
    let scenario: Scenario = |cx, sorm| {
        Box::pin(async move {
            let line = "SCALE.two EXEC FMSG 1 21";
            let (one, other) = join(ask(&sorm, &cx, line), ask(&sorm, &cx, line)).await;
            for reply in [one, other] {
                assert_eq!(reply.body.floats, [42.0], "{:?}", reply.body.reports);
            }
            Ok(String::new())
        })
    };
    let here = "SCALE trade arm=left -least price\n";
    assert_eq!(market(scenario, here, Vec::new()), Ok(String::new()));
}

#[test]
fn nobody_who_offers_it_is_an_error_that_says_what_there_is() {
    let scenario: Scenario = |cx, sorm| {
        Box::pin(async move {
            let reply = ask(&sorm, &cx, "SCALE.two EXEC FMSG 1 21").await;
            assert_eq!(reply.body.code, code::DAEMON);
            let wrong = ask(&sorm, &cx, "COUNT EXEC").await;
            assert_eq!(wrong.body.code, code::SYNTAX, "a line that cannot be read");
            Ok(reply.body.reports[0].text.clone())
        })
    };
    let here = "SCALE trade arm=left price<2\nCOUNT trade cheap\n";
    let text = market(scenario, here, Vec::new()).unwrap();
    assert!(text.contains("trade arm=left price<2"), "{text}");
    assert!(
        text.contains("d2 arm=left price=2.5") && text.contains("d3 arm=right"),
        "{text}"
    );
}

#[test]
fn offers_are_made_and_withdrawn_while_the_app_runs() {
    let scenario: Scenario = |cx, sorm| {
        Box::pin(async move {
            let ask = |line: &'static str| {
                let (sorm, cx) = (sorm.clone(), cx.clone());
                async move { ask(&sorm, &cx, line).await.body }
            };
            assert!(ask("SCALE.two EXEC FMSG 1 1").await.is_ok());
            assert_eq!(ask("sorm@d4 CTRL -offers").await.text, "");
            let offer = "sorm@d4 CTRL -offer scale 'arm=left price=0.5 \"note=new here\"'";
            assert!(ask(offer).await.is_ok());
            assert_eq!(
                ask("sorm@d4 CTRL -offers").await.text,
                "scale arm=left \"note=new here\" price=0.5"
            );
            assert!(ask("sorm@d2 CTRL -withdraw scale").await.is_ok());
            assert_eq!(
                ask("sorm@d2 CTRL -withdraw scale").await.code,
                code::NO_OBJECT
            );
            assert_eq!(
                ask("sorm@d4 CTRL -offer none ''").await.code,
                code::UNKNOWN_CLASS
            );
            assert_eq!(
                ask("sorm@d4 CTRL -offer scale price").await.code,
                code::VALUE
            );
            cx.sleep(seconds(2.0)).await;
            // The first question runs concurrently with the request, so it is the second request that knows.
            for _ in 0..2 {
                assert!(ask("SCALE.two EXEC FMSG 1 1").await.is_ok());
                cx.sleep(seconds(0.5)).await;
            }
            assert_eq!(
                ask("scale.two@d4 DBX -statistics").await.text,
                "exec 1 ctrl 1 errors 0"
            );
            let market = ask("sorm CTRL -market").await.text;
            assert!(
                market.contains("d4 up latency 0.0") && market.contains("price=0.5"),
                "{market}"
            );
            Ok(String::new())
        })
    };
    let here = "SCALE trade arm=left -least price\n";
    assert_eq!(market(scenario, here, Vec::new()), Ok(String::new()));
}

/// Asks every 0.2 s until `until_s`, and counts the errors.
async fn keep_asking(sorm: &Sorm, cx: &TaskContext, comm: &Tasks, until_s: f64) -> usize {
    let mut errors = 0;
    while cx.now() < Instant::START + seconds(until_s) {
        let reply = sorm.ask(comm, request("SCALE.two EXEC FMSG 1 1")).await;
        errors += usize::from(!reply.body.is_ok());
        cx.sleep(seconds(0.2)).await;
    }
    errors
}

#[test]
fn the_load_moves_when_a_daemon_dies_and_comes_back_when_it_does() {
    let scenario: Scenario = |cx, sorm| {
        Box::pin(async move {
            let errors = keep_asking(&sorm, &cx, &Tasks::of(&cx), 2.05).await;
            assert_eq!(errors, 0);
            let errors = keep_asking(&sorm, &cx, &Tasks::of(&cx), 3.0).await;
            assert!(
                errors <= 1,
                "at most the request that was under way: {errors}"
            );
            let before = load(&sorm, &cx).await;
            assert_ne!(before[0], "0", "the next best has taken over: {before:?}");
            let errors = keep_asking(&sorm, &cx, &Tasks::of(&cx), 20.0).await;
            assert_eq!(errors, 0);
            let after = load(&sorm, &cx).await;
            assert_ne!(after[1], "0", "it is back: {after:?}");
            Ok(String::new())
        })
    };
    let here = "SCALE trade arm=left -least price\n";
    let dies = vec![kill("two", 2.1)];
    assert_eq!(market(scenario, here, dies), Ok(String::new()));
}

#[test]
fn who_says_that_it_does_no_harm_does_not_notice_that_a_daemon_dies() {
    let scenario: Scenario = |cx, sorm| {
        Box::pin(async move {
            let comm = Tasks::of(&cx).idempotent(2);
            let errors = keep_asking(&sorm, &cx, &comm, 10.0).await;
            Ok(errors.to_string())
        })
    };
    for at in [2.0, 2.001, 2.1, 2.2001] {
        let here = "SCALE trade arm=left -least price\n";
        let result = market(scenario, here, vec![kill("two", at)]);
        assert_eq!(result, Ok("0".to_owned()), "killed at {at} s");
    }
}

#[test]
fn the_load_moves_away_from_a_daemon_that_slows_or_stands_still() {
    let scenario: Scenario = |cx, sorm| {
        Box::pin(async move {
            let comm = Tasks::of(&cx);
            keep_asking(&sorm, &cx, &comm, 4.0).await;
            let early = load(&sorm, &cx).await;
            assert_eq!(
                (early[0].as_str(), early[2].as_str()),
                ("0", "0"),
                "{early:?}"
            );
            // It is slow by now; as soon as that was measured the other one is asked.
            keep_asking(&sorm, &cx, &comm, 12.0).await;
            let there = request("scale.two@d1 DBX -statistics");
            let there = sorm.ask(&comm, there).await.body.text;
            let moved: u32 = there.split(' ').nth(1).unwrap().parse().unwrap();
            assert!(moved >= 10, "{there}; {:?}", sorm.market());
            Ok(String::new())
        })
    };
    let here = "SCALE trade arm=left -least price\n";
    let (at, until) = (
        Instant::START + seconds(5.0),
        Instant::START + seconds(60.0),
    );
    let chassis = "two".to_owned();
    let slow = Fault::on(
        chassis.clone(),
        FaultKind::Slow {
            per_step: seconds(0.5),
        },
        at,
    )
    .until(until);
    assert_eq!(market(scenario, here, vec![slow]), Ok(String::new()));
    let freeze = Fault::on(chassis, FaultKind::Freeze, at).until(until);
    assert_eq!(market(scenario, here, vec![freeze]), Ok(String::new()));
}

#[test]
fn the_example_trades_balances_and_streams_the_same_every_time() {
    let told = crate::market::run().unwrap();
    assert_eq!(crate::market::run(), Ok(told.clone()));
    for part in [
        "traded: frame by two\n",
        "without d2: frame by one\n",
        "balanced: one one three three two two in 0.2 s\n",
        "streamed: picture1 picture2 picture3\n",
    ] {
        assert!(told.contains(part), "{part}: {told}");
    }
}
