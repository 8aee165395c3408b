//! The same requests by reference and protected, in another process: every case both ways; and what
//! becomes of them when the daemon dies. In virtual time, over simulated links.

use crate::app::{App, Scenario, ask, kill};
use ctos::boot::Fault;
use sorma::daemon::Tasks;
use sorma::report::code;
use sorma::{Request, Transport};
use std::rc::Rc;
use std::time::Duration;

/// Runs a scenario; `here` is what the client's dictionary has besides the cookbook.
fn run(scenario: Scenario, here: &'static str, faults: &[Fault]) -> Result<String, String> {
    let app = App {
        here,
        faults: faults.to_vec(),
        ..App::new(scenario)
    };
    app.run()
}

/// A case of the conformance suite: requests, and what comes back.
const CASES: [&str; 14] = [
    "scale.two EXEC FMSG 3 1 -0.0 inf",
    "scale.minus EXEC FMSG 1 5e-324",
    "scale.two EXEC",
    "scale.two CTRL -dump",
    "scale.two CTRL -factor 3 -dump",
    "scale.two CTRL -factor 30",
    "scale.two CTRL -help",
    "scale.two EXEC FMSG 1 1",
    "scale.two DBX -version",
    "scale.two EXEC burn FMSG 1 1",
    "scale.two EXEC FMSG 1 1",
    "scale.three EXEC",
    "sale EXEC",
    "chain.a EXEC FMSG 1 4",
];

/// The reply without what tells one place from another: process, time, and the name's daemon.
fn neutral(reply: sorma::Reply) -> String {
    let mut body = reply.body;
    body.from.clear();
    for report in &mut body.reports {
        report.time_ns = 0;
        assert!(!report.process.is_empty(), "{report:?}");
        report.process.clear();
    }
    format!("{body:?}")
}

#[test]
fn every_request_is_met_in_the_same_way_by_reference_and_protected() {
    let scenario: Scenario = |cx, sorm| {
        Box::pin(async move {
            for line in CASES {
                let far = line.replacen(' ', "@d1 ", 1);
                let near = neutral(ask(&sorm, &cx, line).await);
                let far = neutral(ask(&sorm, &cx, &far).await);
                if near != far {
                    return Err(format!("{line}:\n{near}\n{far}"));
                }
            }
            Ok("the same".to_owned())
        })
    };
    assert_eq!(run(scenario, "", &[]), Ok("the same".to_owned()));
}

#[test]
fn a_line_of_dictionary_moves_an_object_and_the_code_stays() {
    // Upper case: wherever the dictionary says.
    let scenario: Scenario = |cx, sorm| {
        Box::pin(async move {
            let reply = ask(&sorm, &cx, "SCALE.two EXEC FMSG 1 21").await;
            assert_eq!(reply.body.floats, [42.0]);
            assert_eq!(reply.name.to_string(), "SCALE.two");
            Ok(sorm.objects().join(" "))
        })
    };
    assert_eq!(
        run(scenario, "SCALE self\n", &[]),
        Ok("scale.two".to_owned())
    );
    assert_eq!(run(scenario, "SCALE d1\n", &[]), Ok(String::new()));
}

#[test]
fn reports_come_back_over_processes_with_who_said_them() {
    let scenario: Scenario = |cx, sorm| {
        Box::pin(async move {
            let reply = ask(&sorm, &cx, "chain.mixed EXEC FMSG 1 3").await;
            assert_eq!(reply.body.floats, [-6.0]);
            let said = reply.body.reports.iter();
            let said: Vec<String> = said
                .map(|report| format!("{} in {}", report.object, report.process))
                .collect();
            Ok(said.join(", "))
        })
    };
    let here = "chain.mixed -first scale.two -second scale.minus@d1\n";
    assert_eq!(
        run(scenario, here, &[]),
        Ok("scale.minus in cage".to_owned())
    );
}

#[test]
fn opaque_bytes_reach_another_process_and_come_back() {
    let scenario: Scenario = |cx, sorm| {
        Box::pin(async move {
            // Large ones are lent, not copied; the lender sees nothing of what the borrower does.
            for size in [0, 1, 256, 16 * 1024 - 1, 16 * 1024, 1_000_003] {
                let bytes: Vec<u8> = (0..size).map(|at| (at * 7 % 251) as u8).collect();
                let mut request: Request = "scale.two@d1 EXEC FMSG 1 1".parse().unwrap();
                request.body.opaque = bytes.clone().into();
                request.body.opaque.share();
                let lent = request.body.opaque.clone();
                let reply = sorm.ask(&Tasks::of(&cx), request).await;
                let mut back = reply.body.opaque;
                assert_eq!(lent, bytes);
                back.to_mut().reverse();
                assert_eq!(back, bytes);
            }
            Ok(String::new())
        })
    };
    assert_eq!(run(scenario, "", &[]), Ok(String::new()));
}

#[test]
fn an_object_that_asks_itself_is_refused_and_nothing_hangs() {
    let scenario: Scenario = |cx, sorm| {
        Box::pin(async move {
            let reply = ask(&sorm, &cx, "chain.loop@d1 EXEC FMSG 1 1").await;
            assert_eq!(reply.body.code, code::BUSY);
            let by_reference = sorm.get("chain.loop").unwrap();
            let mut io = Transport::floats([1.0]);
            by_reference.exec(&sorm, &mut io);
            assert_eq!(io.code, code::UNSUPPORTED);
            Ok(String::new())
        })
    };
    assert_eq!(run(scenario, "", &[]), Ok(String::new()));
}

#[test]
fn who_waits_for_its_turn_gets_it_in_the_order_of_asking() {
    let scenario: Scenario = |cx, sorm| {
        Box::pin(async move {
            let done: Rc<std::cell::RefCell<Vec<u32>>> = Rc::default();
            let calls = (0..5_u32).map(|index| {
                let (sorm, cx, done) = (sorm.clone(), cx.clone(), done.clone());
                async move {
                    let line = format!("chain.far EXEC FMSG 1 {index}");
                    let reply = ask(&sorm, &cx, &line).await;
                    assert_eq!(reply.body.floats, [f64::from(index) * -2.0]);
                    done.borrow_mut().push(index);
                }
            });
            futures_util::future::join_all(calls).await;
            let order = done.borrow().clone();
            Ok(format!("{order:?}"))
        })
    };
    let here = "chain.far -first scale.two@d1 -second scale.minus@d1\n";
    assert_eq!(run(scenario, here, &[]), Ok("[0, 1, 2, 3, 4]".to_owned()));
}

#[test]
fn locks_of_a_caller_end_with_its_chassis_and_hold_until_then() {
    let scenario: Scenario = |cx, sorm| {
        Box::pin(async move {
            let locked = ask(&sorm, &cx, "sorm@d1 CTRL -lock scale.two 1000").await;
            assert!(locked.body.is_ok());
            let mine = ask(&sorm, &cx, "scale.two@d1 EXEC FMSG 1 1").await;
            assert!(mine.body.is_ok());
            let mut other: Request = "scale.two@d1 EXEC FMSG 1 1".parse().unwrap();
            other.body.from = "somebody@else".to_owned();
            let refused = sorm.ask(&Tasks::of(&cx), other).await;
            assert_eq!(refused.body.code, code::LOCKED);
            Ok(refused.body.reports[0].text.clone())
        })
    };
    let text = run(scenario, "", &[]).unwrap();
    assert!(text.contains("locked by `client@desk`"), "{text}");
}

fn kill_at(seconds: f64) -> [Fault; 1] {
    [kill("cage", seconds)]
}

#[test]
fn a_daemon_that_dies_is_an_error_with_both_names_and_the_next_call_works() {
    let scenario: Scenario = |cx, sorm| {
        Box::pin(async move {
            let tuned = ask(&sorm, &cx, "scale.two@d1 CTRL -factor 5").await;
            assert!(tuned.body.is_ok());
            let asked = cx.now();
            let lost = ask(&sorm, &cx, "nap@d1 EXEC").await;
            assert_eq!(lost.body.code, code::DAEMON);
            let text = lost.body.reports[0].text.clone();
            assert!(text.contains("nap@d1") && text.contains("client"), "{text}");
            let noticed = cx.now().since(asked);
            assert!(noticed < Duration::from_secs(5), "noticed, not timed out");
            let again = ask(&sorm, &cx, "scale.two@d1 EXEC FMSG 1 1").await;
            assert_eq!(
                again.body.floats,
                [2.0],
                "once it is back, as its recipe says"
            );
            cx.sleep(Duration::from_secs(20)).await;
            let list = ask(&sorm, &cx, "sorm@d1 CTRL -list").await.body.text;
            assert!(list.contains("nap"), "built from its name again: {list}");
            Ok(String::new())
        })
    };
    assert_eq!(run(scenario, "", &kill_at(2.0)), Ok(String::new()));
}

#[test]
fn only_who_says_that_it_does_no_harm_asks_again() {
    let scenario: Scenario = |cx, sorm| {
        Box::pin(async move {
            let request: Request = "nap@d1 EXEC".parse().unwrap();
            let (careful, again) = (Tasks::of(&cx), Tasks::of(&cx).idempotent(3));
            let once = sorm.ask(&careful, request.clone());
            let twice = sorm.ask(&again, request);
            let (once, twice) = futures_util::future::join(once, twice).await;
            assert_eq!(once.body.code, code::DAEMON);
            assert!(twice.body.is_ok(), "{:?}", twice.body.reports);
            Ok(String::new())
        })
    };
    assert_eq!(run(scenario, "", &kill_at(2.0)), Ok(String::new()));
}

#[test]
fn a_daemon_that_nobody_knows_is_named_with_those_there_are() {
    let scenario: Scenario = |cx, sorm| {
        Box::pin(async move {
            let reply = ask(&sorm, &cx, "scale.two@d2 EXEC FMSG 1 1").await;
            assert_eq!(reply.body.code, code::DAEMON);
            Ok(reply.body.reports[0].text.clone())
        })
    };
    let text = run(scenario, "", &[]).unwrap();
    assert!(
        text.contains("no task is called `d2`") && text.contains("d1"),
        "{text}"
    );
}
