//! Requests that nobody stands waiting for, and demand streams: every case by reference and protected, in
//! code and in text, in virtual time.

use crate::app::{App, Scenario, ask, kill, request, seconds};
use ctos::boot::{Fault, FaultKind};
use ctos::task::Context as TaskContext;
use ctos::time::Instant;
use sorma::daemon::Tasks;
use sorma::report::code;
use sorma::{Keep, Sorm};
use std::sync::{Arc, Mutex};

/// Where an object may be.
const BOTH: [&str; 2] = ["", "@d1"];

fn run(scenario: Scenario) -> Result<String, String> {
    App::new(scenario).run()
}

fn passes(scenario: Scenario) {
    assert_eq!(run(scenario), Ok(String::new()));
}

/// Asks until there is an answer other than `not yet`.
async fn until_there(sorm: &Sorm, cx: &TaskContext, line: &str) -> sorma::Transport {
    for _ in 0..1000 {
        let body = ask(sorm, cx, line).await.body;
        if body.text != "not yet" {
            return body;
        }
        cx.sleep(seconds(0.05)).await;
    }
    panic!("`{line}` never came");
}

#[test]
fn a_deferred_request_lets_its_caller_go_on_and_is_collected_later() {
    passes(|cx, sorm| {
        Box::pin(async move {
            for at in BOTH {
                let comm = Tasks::of(&cx);
                let begun = cx.now();
                let mut nap = sorm
                    .ask_later(&comm, request(&format!("nap{at} EXEC")))
                    .unwrap();
                let wrong = format!("scale.no{at} EXEC FMSG 1 1");
                let wrong = sorm.ask_later(&comm, request(&wrong)).unwrap();
                assert_eq!(cx.now(), begun, "nobody waited");
                assert!(!nap.is_ready() && nap.try_collect().is_none());
                let wrong = wrong.collect().await.unwrap();
                assert_eq!(wrong.body.code, code::UNKNOWN_FLAVOR, "{at}");
                assert!(cx.now().since(begun) < seconds(1.0));
                cx.sleep(seconds(6.0)).await;
                assert!(nap.is_ready());
                assert!(nap.try_collect().unwrap().body.is_ok());
                assert!(nap.try_collect().is_none(), "an answer is collected once");
            }
            Ok(String::new())
        })
    });
}

#[test]
fn requests_are_begun_in_the_order_in_which_they_are_given() {
    passes(|cx, sorm| {
        Box::pin(async move {
            for at in BOTH {
                let comm = Tasks::of(&cx);
                let line = format!("count{at} EXEC");
                let mut deferred = Vec::new();
                for _ in 0..20 {
                    sorm.tell_only(&comm, request(&line)).await.unwrap();
                    deferred.push(sorm.ask_later(&comm, request(&line)).unwrap());
                }
                for (index, deferred) in (1..).zip(deferred) {
                    let reply = deferred.collect().await.unwrap();
                    assert_eq!(reply.body.ints, [2 * index], "{at}");
                }
            }
            Ok(String::new())
        })
    });
}

#[test]
fn a_one_way_request_is_done_and_one_that_fails_troubles_nobody() {
    passes(|cx, sorm| {
        Box::pin(async move {
            for at in BOTH {
                let comm = Tasks::of(&cx);
                for text in ["EXEC", "EXEC fail", "EXEC"] {
                    let line = format!("count{at} {text}");
                    sorm.tell_only(&comm, request(&line)).await.unwrap();
                }
                let wrong = format!("scale.no{at} EXEC");
                sorm.tell_only(&comm, request(&wrong)).await.unwrap();
                let told = cx.now();
                let nap = format!("nap{at} EXEC");
                sorm.tell_only(&comm, request(&nap)).await.unwrap();
                assert!(cx.now().since(told) < seconds(1.0), "taken, not done");
                let count = ask(&sorm, &cx, &format!("count{at} EXEC")).await;
                assert_eq!(count.body.ints, [3], "{at}");
            }
            let nobody = sorm
                .tell_only(&Tasks::of(&cx), request("count@d7 EXEC"))
                .await;
            assert!(nobody.unwrap_err().text.contains("d7"));
            Ok(String::new())
        })
    });
}

#[test]
fn a_daemon_goes_on_beside_an_object_that_waits_which_is_named_to_who_asks_and_to_who_wants_it() {
    passes(|cx, sorm| {
        Box::pin(async move {
            for at in BOTH {
                let comm = Tasks::of(&cx).deadline(seconds(120.0));
                let doze = format!("doze{at} EXEC");
                sorm.tell_only(&comm, request(&doze)).await.unwrap();
                let asked = cx.now();
                let count = ask(&sorm, &cx, &format!("count{at} EXEC")).await;
                assert_eq!(count.body.ints, [1], "{at}");
                let busy = ask(&sorm, &cx, &format!("sorm{at} CTRL -busy")).await.body;
                assert!(busy.text.starts_with("doze: EXEC of `"), "{}", busy.text);
                assert!(cx.now().since(asked) < seconds(1.0));
                // Another call of it does not wait for ever.
                for line in [doze, format!("doze{at} CTRL -dump")] {
                    let late = sorm.ask(&comm, request(&line)).await.body;
                    assert_eq!(late.code, code::BUSY);
                    let text = &late.reports[0].text;
                    assert!(text.starts_with("`doze` is in EXEC of `"), "{text}");
                    assert!(text.contains("`ctos restart "), "{text}");
                }
                // When it is over, it is not named any more.
                cx.sleep(seconds(100.0)).await;
                let busy = ask(&sorm, &cx, &format!("sorm{at} CTRL -busy")).await.body;
                assert_eq!(busy.text, "");
            }
            Ok(String::new())
        })
    });
}

#[test]
fn a_callback_gets_the_answer_errors_and_all() {
    passes(|cx, sorm| {
        Box::pin(async move {
            for at in BOTH {
                let comm = Tasks::of(&cx);
                let heard: Arc<Mutex<Vec<i32>>> = Arc::default();
                for line in ["scale.two@ EXEC FMSG 1 21", "scale.two@ EXEC"] {
                    let line = line.replace('@', at);
                    let heard = Arc::clone(&heard);
                    let then =
                        move |reply: sorma::Reply| heard.lock().unwrap().push(reply.body.code);
                    sorm.ask_then(&comm, request(&line), then).unwrap();
                }
                cx.sleep(seconds(1.0)).await;
                assert_eq!(*heard.lock().unwrap(), [0, code::VALUE], "{at}");
            }
            Ok(String::new())
        })
    });
}

#[test]
fn a_fork_asks_so_many_at_once_and_no_more_and_its_replies_are_in_order() {
    passes(|cx, sorm| {
        Box::pin(async move {
            for at in BOTH {
                let comm = Tasks::of(&cx);
                // An object naps once at a time, so each has one of its own.
                for flavor in 0..6 {
                    let add = format!("dict{at} CTRL -add nap.n{flavor} ''");
                    assert!(ask(&sorm, &cx, &add).await.body.is_ok());
                }
                let mut lines: Vec<String> = (0..6).map(|n| format!("nap.n{n}{at} EXEC")).collect();
                lines.insert(1, format!("nap.lazy{at} EXEC"));
                let requests: Vec<_> = lines.iter().map(|line| request(line)).collect();
                let begun = cx.now();
                let replies = sorm.fork(&comm, requests.clone(), 2).await;
                let took = cx.now().since(begun);
                assert!(took >= seconds(15.0) && took < seconds(16.0), "{took:?}");
                let names: Vec<String> =
                    replies.iter().map(|reply| reply.name.to_string()).collect();
                let asked: Vec<String> = requests
                    .iter()
                    .map(|request| request.name.to_string())
                    .collect();
                assert_eq!(names, asked);
                let codes: Vec<i32> = replies.iter().map(|reply| reply.body.code).collect();
                assert_eq!(codes, [0, code::UNKNOWN_FLAVOR, 0, 0, 0, 0, 0]);
                let begun = cx.now();
                let all = sorm.fork_later(&comm, requests, 100).unwrap();
                assert_eq!(cx.now(), begun, "nobody waited");
                assert_eq!(all.collect().await.unwrap().len(), 7);
                let took = cx.now().since(begun);
                assert!(took >= seconds(5.0) && took < seconds(6.0), "{took:?}");
            }
            Ok(String::new())
        })
    });
}

#[test]
fn a_subscriber_gets_every_result_or_the_latest_whoever_asks_for_it() {
    passes(|cx, sorm| {
        Box::pin(async move {
            for at in BOTH {
                let comm = Tasks::of(&cx);
                let name = format!("count{at}");
                let mut every = sorm
                    .subscribe(&comm, &name, Keep::Every(1000))
                    .await
                    .unwrap();
                let mut few = sorm.subscribe(&comm, &name, Keep::Every(3)).await.unwrap();
                let mut latest = sorm.subscribe(&comm, &name, Keep::Latest).await.unwrap();
                for _ in 0..100 {
                    ask(&sorm, &cx, &format!("{name} EXEC")).await;
                }
                ask(&sorm, &cx, &format!("{name} EXEC fail")).await;
                ask(&sorm, &cx, &format!("{name} CTRL -anew")).await;
                for expected in 1..=100 {
                    let sample = every.next(&comm).await.unwrap();
                    assert_eq!(
                        (sample.body.ints, sample.missed),
                        (vec![expected], 0),
                        "{at}"
                    );
                }
                let failed = every.next(&comm).await.unwrap();
                assert_eq!(failed.body.code, code::VALUE, "what failed is a result too");
                let said = every.next(&comm).await.unwrap();
                assert_eq!(
                    (said.body.text.as_str(), said.number),
                    ("it begins anew", 102)
                );
                let sample = few.next(&comm).await.unwrap();
                assert_eq!((sample.number, sample.missed), (100, 99), "{at}");
                let sample = latest.next(&comm).await.unwrap();
                assert_eq!((sample.number, sample.missed), (102, 101), "{at}");
                // One who waits is woken, and by the result.
                let (again, here) = (sorm.clone(), cx.clone());
                let line = format!("{name} EXEC");
                cx.spawn(async move {
                    here.sleep(seconds(20.0)).await;
                    ask(&again, &here, &line).await;
                });
                let waited = cx.now();
                let sample = every.next(&comm).await.unwrap();
                assert_eq!(sample.body.ints, [1]);
                let waited = cx.now().since(waited);
                assert!(
                    waited >= seconds(20.0) && waited < seconds(21.0),
                    "{waited:?}"
                );
                every.end(&comm).await;
                latest.end(&comm).await;
                drop(few);
            }
            Ok(String::new())
        })
    });
}

#[test]
fn who_subscribes_again_later_gets_results_also_of_an_object_that_was_built_anew() {
    passes(|cx, sorm| {
        Box::pin(async move {
            let comm = Tasks::of(&cx);
            for at in BOTH {
                let (name, other) = (format!("count{at}"), format!("scale{at}"));
                let first = sorm.subscribe(&comm, &name, Keep::Latest).await.unwrap();
                first.end(&comm).await;
                let _other = sorm.subscribe(&comm, &other, Keep::Latest).await.unwrap();
                let mut again = sorm.subscribe(&comm, &name, Keep::Latest).await.unwrap();
                ask(&sorm, &cx, &format!("{name} EXEC")).await;
                assert_eq!(again.next(&comm).await.unwrap().body.ints, [1], "{at}");
                let free = format!("sorm{at} CTRL -free count");
                assert!(ask(&sorm, &cx, &free).await.body.is_ok());
                ask(&sorm, &cx, &format!("{name} EXEC")).await;
                let sample = again.next(&comm).await.unwrap();
                assert_eq!((sample.number, sample.body.ints), (2, vec![1]), "{at}");
                let none = sorm
                    .subscribe(&comm, &name, Keep::Every(0))
                    .await
                    .unwrap_err();
                assert!(
                    none.text.contains("1 to 10000 results can be kept, not 0"),
                    "{none}"
                );
            }
            Ok(String::new())
        })
    });
}

#[test]
fn subscribers_that_do_not_fetch_cost_the_object_no_time_and_are_forgotten() {
    passes(|cx, sorm| {
        Box::pin(async move {
            for at in BOTH {
                let comm = Tasks::of(&cx);
                let name = format!("count{at}");
                let asked = cx.now();
                ask(&sorm, &cx, &format!("{name} EXEC")).await;
                let alone = cx.now().since(asked);
                let mut dead = Vec::new();
                for _ in 0..50 {
                    dead.push(sorm.subscribe(&comm, &name, Keep::Every(2)).await.unwrap());
                }
                for _ in 0..10 {
                    let asked = cx.now();
                    ask(&sorm, &cx, &format!("{name} EXEC")).await;
                    let watched = cx.now().since(asked);
                    assert!(watched <= alone * 2, "{at}: {watched:?}, alone {alone:?}");
                }
                let subscribers = format!("{name} DBX -subscribers");
                assert_eq!(ask(&sorm, &cx, &subscribers).await.body.text, "50");
                drop(dead);
                cx.sleep(seconds(130.0)).await;
                assert_eq!(ask(&sorm, &cx, &subscribers).await.body.text, "0", "{at}");
            }
            Ok(String::new())
        })
    });
}

#[test]
fn a_daemon_that_dies_ends_its_streams_unless_they_are_to_resume() {
    let scenario: Scenario = |cx, sorm| {
        Box::pin(async move {
            let comm = Tasks::of(&cx);
            let mut ends = sorm
                .subscribe(&comm, "count@d1", Keep::Latest)
                .await
                .unwrap();
            let goes_on = sorm.subscribe(&comm, "count@d1", Keep::Every(100)).await;
            let mut goes_on = goes_on.unwrap().resuming(true);
            ask(&sorm, &cx, "count@d1 EXEC").await;
            assert_eq!(goes_on.next(&comm).await.unwrap().body.ints, [1]);
            assert_eq!(ends.next(&comm).await.unwrap().body.ints, [1]);
            let report = ends.next(&comm).await.unwrap_err();
            let noticed = cx.now().since(Instant::START + seconds(2.0));
            assert!(noticed < seconds(5.0), "noticed, not timed out");
            assert_eq!(report.code, code::DAEMON);
            assert!(
                report.text.contains("count@d1") && report.text.contains("client"),
                "{report}"
            );
            assert_eq!(ends.next(&comm).await.unwrap_err(), report, "and for good");
            let (again, here) = (sorm.clone(), cx.clone());
            cx.spawn(async move {
                here.sleep(seconds(10.0)).await;
                ask(&again, &here, "count@d1 EXEC").await;
            });
            let sample = goes_on.next(&comm).await.unwrap();
            assert!(sample.resumed, "what came between is not known");
            assert_eq!(sample.body.ints, [1], "of the new one");
            ask(&sorm, &cx, "count@d1 EXEC").await;
            assert!(!goes_on.next(&comm).await.unwrap().resumed);
            Ok(String::new())
        })
    };
    let app = App {
        faults: vec![kill("cage", 2.0)],
        ..App::new(scenario)
    };
    assert_eq!(app.run(), Ok(String::new()));
}

#[test]
fn a_link_that_breaks_and_heals_loses_no_result_and_brings_none_twice() {
    let scenario: Scenario = |cx, sorm| {
        Box::pin(async move {
            let comm = Tasks::of(&cx);
            let mut every = sorm
                .subscribe(&comm, "count@d1", Keep::Every(1000))
                .await
                .unwrap();
            let (again, here) = (sorm.clone(), cx.clone());
            cx.spawn(async move {
                for _ in 0..100 {
                    ask(&again, &here, "count@d1 EXEC").await;
                    here.sleep(seconds(0.02)).await;
                }
            });
            for expected in 1..=100 {
                let sample = every
                    .next(&comm)
                    .await
                    .map_err(|report| report.to_string())?;
                assert_eq!((sample.number, sample.missed), (expected, 0));
            }
            Ok(String::new())
        })
    };
    let at = |s: f64| Instant::START + seconds(s);
    let (one, other) = ("desk".to_owned(), "cage".to_owned());
    for seed in 0..8 {
        let faults = vec![
            Fault::between(
                one.clone(),
                other.clone(),
                FaultKind::Loss { share_ppm: 200_000 },
                at(0.2),
            )
            .until(at(2.0)),
            Fault::between(one.clone(), other.clone(), FaultKind::Break, at(0.5)).until(at(0.7)),
        ];
        let app = App {
            faults,
            seed,
            ..App::new(scenario)
        };
        assert_eq!(app.run(), Ok(String::new()), "seed {seed}");
    }
}

#[test]
fn a_subscriber_whose_chassis_dies_is_forgotten_at_once() {
    // The subscriber is an object of another daemon, by its recipe.
    let scenario: Scenario = |cx, sorm| {
        Box::pin(async move {
            let begun = ask(&sorm, &cx, "stream.count@d2 EXEC begin").await;
            assert!(begun.body.is_ok(), "{:?}", begun.body.reports);
            let subscribers = "count@d1 DBX -subscribers";
            assert_eq!(ask(&sorm, &cx, subscribers).await.body.text, "1");
            cx.sleep(seconds(8.0)).await;
            assert_eq!(ask(&sorm, &cx, subscribers).await.body.text, "0");
            Ok(String::new())
        })
    };
    let app = App {
        daemons: vec![("d1", "cage", ""), ("d2", "other", "")],
        faults: vec![kill("other", 2.0)],
        ..App::new(scenario)
    };
    assert_eq!(app.run(), Ok(String::new()));
}

#[test]
fn in_text_requests_are_deferred_one_way_or_called_back() {
    passes(|cx, sorm| {
        Box::pin(async move {
            for at in BOTH {
                // The object that asks is here; so is, or is not, the one that is asked.
                let line = format!("later EXEC ask 'nap{at} EXEC'");
                let ticket = ask(&sorm, &cx, &line).await.body.ints[0];
                let collect = format!("later EXEC collect {ticket}");
                assert_eq!(ask(&sorm, &cx, &collect).await.body.text, "not yet");
                let ready = format!("later EXEC ready {ticket}");
                assert_eq!(ask(&sorm, &cx, &ready).await.body.ints, [0]);
                let open = ask(&sorm, &cx, "later EXEC open").await.body.text;
                assert_eq!(open, format!("{ticket} nap{at}"));
                assert!(until_there(&sorm, &cx, &collect).await.is_ok());
                let twice = ask(&sorm, &cx, &collect).await.body;
                assert_eq!(twice.code, sorma::asynchronous::code::UNKNOWN);
                let told = format!("later EXEC tell 'count{at} EXEC'");
                assert!(ask(&sorm, &cx, &told).await.body.is_ok());
                let call = format!("later EXEC call 'scale.two{at} EXEC FMSG 1 4' scale.minus{at}");
                assert!(ask(&sorm, &cx, &call).await.body.is_ok());
                cx.sleep(seconds(1.0)).await;
                let count = ask(&sorm, &cx, &format!("count{at} EXEC")).await;
                assert_eq!(count.body.ints, [2]);
                let called = ask(&sorm, &cx, &format!("scale.minus{at} DBX -statistics")).await;
                assert_eq!(called.body.text, "exec 1 ctrl 1 errors 0");
                // And the other way round: the caller is there.
                let far = format!("later{at} EXEC ask 'scale.two EXEC FMSG 1 21'");
                let ticket = ask(&sorm, &cx, &far).await.body.ints[0];
                let collect = format!("later{at} EXEC collect {ticket}");
                assert_eq!(until_there(&sorm, &cx, &collect).await.floats, [42.0]);
            }
            for (line, expected) in [
                ("later EXEC", code::VALUE),
                ("later EXEC ask", code::VALUE),
                ("later EXEC ask 'no request'", code::SYNTAX),
                ("later EXEC collect x", sorma::asynchronous::code::UNKNOWN),
                ("later EXEC call 'count EXEC' 1a", code::SYNTAX),
            ] {
                assert_eq!(ask(&sorm, &cx, line).await.body.code, expected, "{line}");
            }
            let few = ask(&sorm, &cx, "later CTRL -capacity 1").await;
            assert!(few.body.is_ok());
            let ask_one = "later EXEC ask 'nap@d1 EXEC'";
            assert!(ask(&sorm, &cx, ask_one).await.body.is_ok());
            let full = ask(&sorm, &cx, ask_one).await.body.code;
            assert_eq!(full, sorma::asynchronous::code::FULL);
            Ok(String::new())
        })
    });
}

#[test]
fn in_text_a_fork_answers_all_replies_with_their_numbers_and_reports() {
    passes(|cx, sorm| {
        Box::pin(async move {
            for at in BOTH {
                let line = format!(
                    "fork EXEC 'scale.two{at} EXEC FMSG 2 1 2' 'scale.no{at} EXEC' 'scale.minus{at} EXEC FMSG 1 3'"
                );
                let body = ask(&sorm, &cx, &line).await.body;
                assert_eq!(body.floats, [2.0, 4.0, -3.0]);
                let no = i64::from(code::UNKNOWN_FLAVOR);
                assert_eq!(
                    (body.code, body.ints),
                    (code::UNKNOWN_FLAVOR, vec![0, no, 0])
                );
                let lines: Vec<&str> = body.text.lines().collect();
                assert_eq!(lines[0], format!("scale.two{at} RET 0 FMSG 2 2.0 4.0"));
                assert_eq!(lines[1], format!("scale.no{at} RET 3"));
                let said: Vec<&str> = body.reports.iter().map(|one| one.text.as_str()).collect();
                assert!(said[0].contains("no recipe for `scale.no`"), "{said:?}");
                assert_eq!(said[1], "turns the sign");
                // An object that asks itself is refused here as everywhere.
                let line = format!("fork{at} EXEC 'fork EXEC \"scale.two EXEC FMSG 1 1\"'");
                assert_eq!(ask(&sorm, &cx, &line).await.body.code, code::BUSY);
            }
            assert_eq!(ask(&sorm, &cx, "fork EXEC").await.body.code, code::VALUE);
            Ok(String::new())
        })
    });
}

#[test]
fn in_text_a_stream_keeps_the_results_of_another_object() {
    passes(|cx, sorm| {
        Box::pin(async move {
            for at in BOTH {
                let set = format!("stream CTRL -from count{at} -keep every -capacity 3");
                assert!(ask(&sorm, &cx, &set).await.body.is_ok());
                assert!(ask(&sorm, &cx, "stream EXEC begin").await.body.is_ok());
                assert_eq!(
                    ask(&sorm, &cx, "stream EXEC next").await.body.text,
                    "not yet"
                );
                let line = format!("count{at} EXEC");
                ask(&sorm, &cx, &line).await;
                let first = until_there(&sorm, &cx, "stream EXEC next").await;
                assert_eq!((first.ints, first.reports.len()), (vec![1], 0), "{at}");
                for _ in 0..10 {
                    ask(&sorm, &cx, &line).await;
                    cx.sleep(seconds(0.5)).await;
                }
                let next = until_there(&sorm, &cx, "stream EXEC next").await;
                assert_eq!(next.ints, [9], "the oldest of three");
                assert_eq!(next.reports[0].code, sorma::asynchronous::code::MISSED);
                let latest = until_there(&sorm, &cx, "stream EXEC latest").await;
                assert_eq!(latest.ints, [11]);
                let status = ask(&sorm, &cx, "stream EXEC status").await.body.ints;
                assert_eq!(status, [11, 7, 0, 1], "{at}");
                ask(&sorm, &cx, &format!("count{at} EXEC fail")).await;
                let failed = until_there(&sorm, &cx, "stream EXEC next").await;
                assert_eq!(failed.code, code::VALUE, "as if it had been asked here");
                assert!(ask(&sorm, &cx, "stream EXEC end").await.body.is_ok());
                assert_eq!(ask(&sorm, &cx, "stream EXEC status").await.body.ints[3], 0);
            }
            let nobody = ask(&sorm, &cx, "stream CTRL -from '' ").await;
            assert!(nobody.body.is_ok());
            assert_eq!(
                ask(&sorm, &cx, "stream EXEC next").await.body.code,
                code::VALUE
            );
            Ok(String::new())
        })
    });
}

#[test]
fn an_event_notifies_all_who_subscribe_wherever_they_are() {
    let scenario: Scenario = |cx, sorm| {
        Box::pin(async move {
            let comm = Tasks::of(&cx);
            // One in code, one in text that keeps it, and one in text that hands it on.
            let mut code = sorm
                .subscribe(&comm, "event@d1", Keep::Every(10))
                .await
                .unwrap();
            for line in ["stream.text@d2 EXEC begin", "stream.scale@d2 EXEC begin"] {
                let begun = ask(&sorm, &cx, line).await;
                assert!(begun.body.is_ok(), "{:?}", begun.body.reports);
            }
            let signal = ask(&sorm, &cx, "event@d1 EXEC lamp FMSG 2 1 0.5").await;
            assert_eq!((signal.body.text.as_str(), signal.body.code), ("lamp", 0));
            let sample = code.next(&comm).await.unwrap();
            assert_eq!(
                (sample.body.text.as_str(), sample.body.floats.len()),
                ("lamp", 2)
            );
            let kept = until_there(&sorm, &cx, "stream.text@d2 EXEC next").await;
            assert_eq!(kept.text, "lamp");
            cx.sleep(seconds(1.0)).await;
            let asked = ask(&sorm, &cx, "scale.two@d2 DBX -statistics").await;
            assert_eq!(asked.body.text, "exec 1 ctrl 1 errors 0");
            Ok(String::new())
        })
    };
    let app = App {
        daemons: vec![("d1", "cage", ""), ("d2", "other", "")],
        ..App::new(scenario)
    };
    assert_eq!(app.run(), Ok(String::new()));
}

#[test]
fn a_fork_with_an_object_forwards_without_waiting_one_at_a_time_and_answers_a_ticket() {
    passes(|cx, sorm| {
        Box::pin(async move {
            for at in BOTH {
                let dict = format!("dict{at} CTRL -add fork.nap '-object nap -width 1'");
                assert!(ask(&sorm, &cx, &dict).await.body.is_ok());
                let begun = cx.now();
                for ticket in 1..=3 {
                    let body = ask(&sorm, &cx, &format!("fork.nap{at} EXEC")).await.body;
                    assert_eq!((body.code, body.ints), (0, vec![ticket]), "{at}");
                }
                assert!(cx.now().since(begun) < seconds(1.0), "nobody waited");
                let ctrl = async |words: &str| {
                    ask(&sorm, &cx, &format!("fork.nap{at} CTRL {words}"))
                        .await
                        .body
                };
                assert_eq!(ctrl("-open").await.text, "1 nap\n2 nap\n3 nap");
                assert_eq!(ctrl("-collect 1").await.text, "not yet");
                // One after the other, 5 s each.
                cx.sleep(seconds(6.0)).await;
                assert_eq!(ctrl("-collect 1").await.text, "nap RET 0");
                assert_eq!(ctrl("-collect 2").await.text, "not yet");
                assert!(ctrl("-drop 2").await.is_ok());
                cx.sleep(seconds(10.0)).await;
                assert_eq!(ctrl("-collect 3").await.text, "nap RET 0");
                assert_eq!(ctrl("-collect 3").await.code, 190, "it was collected");
            }
            Ok(String::new())
        })
    });
}

#[test]
fn a_fork_forwards_its_data_and_answers_that_nobody_collects_give_way() {
    passes(|cx, sorm| {
        Box::pin(async move {
            let ask = async |line: &str| ask(&sorm, &cx, line).await.body;
            // As in the report: FORK.scale is served by the default daemon.
            let recipes = "dict CTRL -add FORK d1";
            assert!(ask(recipes).await.is_ok());
            let there = "dict@d1 CTRL -add fork.scale '-object scale.two -width 1 -capacity 2'";
            assert!(ask(there).await.is_ok());
            for number in 1..=5 {
                let body = ask(&format!("FORK.scale EXEC FMSG 1 {number}")).await;
                assert_eq!(body.ints, [number], "{:?}", body.reports);
                cx.sleep(seconds(0.1)).await;
            }
            let open = ask("FORK.scale CTRL -open").await.text;
            assert_eq!(open, "4 scale.two\n5 scale.two");
            assert_eq!(
                ask("FORK.scale CTRL -collect 5").await.text,
                "scale.two RET 0 FMSG 1 10.0"
            );
            // A fork of a fork would never end.
            assert!(ask("fork.scale@d1 CTRL -object fork.scale").await.is_ok());
            assert_eq!(ask("FORK.scale EXEC").await.code, code::VALUE);
            Ok(String::new())
        })
    });
}

#[test]
fn the_width_of_a_fork_bounds_what_several_daemons_do_for_it_at_once() {
    let scenario: Scenario = |cx, sorm| {
        Box::pin(async move {
            let ask = async |line: &str| ask(&sorm, &cx, line).await.body;
            let add = "dict CTRL -add fork.one '-object nap@anyone -width 1' -add fork.two '-object nap@anyone -width 2'";
            assert!(ask(add).await.is_ok());
            for (fork, after_6_s) in [("fork.one", "not yet"), ("fork.two", "nap@anyone RET 0")] {
                for _ in 0..2 {
                    assert!(ask(&format!("{fork} EXEC")).await.is_ok());
                }
                cx.sleep(seconds(6.0)).await;
                let second = ask(&format!("{fork} CTRL -collect 2")).await.text;
                assert_eq!(second, after_6_s, "{fork}");
                cx.sleep(seconds(10.0)).await;
            }
            Ok(String::new())
        })
    };
    let app = App {
        here: "anyone trade -spread\n",
        daemons: vec![
            ("d1", "one", "args.offers.nap = {}"),
            ("d2", "two", "args.offers.nap = {}"),
        ],
        ..App::new(scenario)
    };
    assert_eq!(app.run(), Ok(String::new()));
}
