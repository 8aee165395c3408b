//! Nothing is executed twice unasked, whatever happens to links and processes; in virtual time, with many
//! seeds. Besides: what is done with data that no program of ours sends.

use crate::app::{App, Scenario, ask, request, seconds};
use ctos::boot::{Fault, FaultKind};
use ctos::message::{Command, Replier};
use ctos::registry::Registry;
use ctos::task::{Context as TaskContext, Handled};
use ctos::time::Instant;
use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};
use sorma::daemon::{self, Tasks};
use sorma::report::code;
use sorma::{Class, Context, Dictionary, Outcome, ServiceObject, Transport};
use std::cell::RefCell;

thread_local! {
    /// The numbers of the requests that were executed. A simulation is one thread's.
    static EXECUTED: RefCell<Vec<i64>> = const { RefCell::new(Vec::new()) };
    /// Those that were answered.
    static ANSWERED: RefCell<Vec<i64>> = const { RefCell::new(Vec::new()) };
}

/// Notes which requests it has executed.
struct Ledger;

impl ServiceObject for Ledger {
    fn exec(&mut self, _cx: &Context<'_>, io: &mut Transport) -> Outcome {
        EXECUTED.with(|executed| executed.borrow_mut().extend(&io.ints));
        Ok(())
    }

    fn ctrl(&mut self, _cx: &Context<'_>, _io: &mut Transport) -> Outcome {
        Ok(())
    }

    fn dump(&self) -> String {
        String::new()
    }
}

fn ledgers(registry: &mut Registry) {
    daemon::register(registry, Dictionary::new(), |_, sorm| {
        sorm.register(Class::new("ledger", "1", |_, _| Ok(Box::new(Ledger))));
    });
}

/// A storm of faults on the two daemons, the same for the same seed.
fn storm(seed: u64) -> Vec<Fault> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut storm = Vec::new();
    for _ in 0..rng.random_range(1..6) {
        let chassis = ["cage", "other"][rng.random_range(0..2)].to_owned();
        let (one, other) = ("desk".to_owned(), chassis.clone());
        let at = Instant::START + seconds(rng.random_range(0.5..6.0));
        let until = at + seconds(rng.random_range(0.01..1.5));
        storm.push(match rng.random_range(0..6) {
            0 => Fault::on(chassis, FaultKind::Kill, at),
            1 => Fault::between(one, other, FaultKind::Break, at).until(until),
            2 => Fault::between(one, other, FaultKind::Stall, at).until(until),
            3 => {
                Fault::between(one, other, FaultKind::Loss { share_ppm: 300_000 }, at).until(until)
            }
            4 => Fault::between(
                one,
                other,
                FaultKind::Delay {
                    extra: seconds(0.3),
                },
                at,
            )
            .until(until),
            _ => Fault::on(chassis, FaultKind::Freeze, at).until(until),
        });
    }
    storm
}

/// Asks by name, by trade, one-way, deferred and forked, a new number each time.
const BUSY: Scenario = |cx, sorm| {
    Box::pin(async move {
        let comm = Tasks::of(&cx);
        let mut number = 0;
        while cx.now() < Instant::START + seconds(7.0) {
            for name in ["ledger@d1", "LEDGER"] {
                number += 10;
                let line = |number: i64| request(&format!("{name} EXEC IMSG 1 {number}"));
                // A refusal is an error here, and has no further effect.
                let _ = sorm.tell_only(&comm, line(number)).await;
                let deferred = sorm.ask_later(&comm, line(number + 1)).unwrap();
                let requests = (2..5).map(|index| line(number + index)).collect();
                let forked = sorm.fork(&comm, requests, 2).await;
                let deferred = deferred.collect().await.unwrap();
                for reply in forked.into_iter().chain([deferred]) {
                    if reply.body.is_ok() {
                        ANSWERED.with(|answered| answered.borrow_mut().extend(&reply.body.ints));
                    }
                }
            }
            cx.sleep(seconds(0.1)).await;
        }
        Ok(number.to_string())
    })
};

#[test]
fn nothing_is_executed_twice_and_what_is_answered_was_executed_in_any_storm() {
    let mut answered_in_all = 0;
    for seed in 0..40 {
        EXECUTED.with(|executed| executed.borrow_mut().clear());
        ANSWERED.with(|answered| answered.borrow_mut().clear());
        let app = App {
            here: "LEDGER trade\n",
            daemons: vec![
                ("d1", "cage", "args.offers.ledger = {}"),
                ("d2", "other", "args.offers.ledger = {}"),
            ],
            faults: storm(seed),
            handlers: ledgers,
            seed,
            ..App::new(BUSY)
        };
        app.run().unwrap_or_else(|why| panic!("seed {seed}: {why}"));
        let mut executed = EXECUTED.with(|executed| executed.borrow().clone());
        executed.sort_unstable();
        let twice = executed.windows(2).find(|pair| pair[0] == pair[1]);
        assert_eq!(twice, None, "seed {seed}");
        let answered = ANSWERED.with(|answered| answered.borrow().clone());
        for number in &answered {
            let known = executed.binary_search(number).is_ok();
            assert!(known, "seed {seed}: {number} was answered and not executed");
        }
        answered_in_all += answered.len();
    }
    assert!(answered_in_all > 40 * 50, "most are: {answered_in_all}");
}

/// As a daemon's `ask`, but with bytes where the text of the name is.
#[derive(Debug, Serialize, Deserialize, Command)]
#[command(name = "ask", reply = Transport, code = 0x0001)]
struct BytesAsk {
    version: u32,
    object: Vec<u8>,
    method: sorma::Method,
    body: Transport,
}

/// As a daemon's `ask`, by a program of another version, which has more to say.
#[derive(Debug, Serialize, Deserialize, Command)]
#[command(name = "ask", reply = Transport, code = 0x0001)]
struct LaterAsk {
    version: u32,
    object: String,
    method: sorma::Method,
    body: Transport,
    more: String,
}

fn bytes_ask(version: u32, object: &[u8]) -> BytesAsk {
    BytesAsk {
        version,
        object: object.to_vec(),
        method: sorma::Method::Exec,
        body: Transport::floats([1.0]),
    }
}

#[test]
fn a_caller_of_another_version_or_with_bytes_that_are_no_text_is_refused_and_the_daemon_lives() {
    let scenario: Scenario = |cx, sorm| {
        Box::pin(async move {
            let daemon = cx.task("d1").await.unwrap();
            let good = cx
                .call(&daemon, bytes_ask(daemon::VERSION, b"scale.two"))
                .await
                .unwrap();
            assert_eq!(good.floats, [2.0], "the same bytes as a text has");
            let wrong = cx
                .call(&daemon, bytes_ask(daemon::VERSION, b"scale.\xff\xfe"))
                .await;
            let wrong = wrong.unwrap_err().to_string();
            assert!(wrong.contains("cannot read the data of `ask`"), "{wrong}");
            let later = cx
                .call(&daemon, bytes_ask(daemon::VERSION + 1, b"scale.two"))
                .await;
            let later = later.unwrap_err().to_string();
            let told = format!(
                "version {} of service objects, this daemon {}",
                daemon::VERSION + 1,
                daemon::VERSION
            );
            assert!(later.contains(&told), "{later}");
            let ask = LaterAsk {
                version: daemon::VERSION + 1,
                object: "scale.two".to_owned(),
                method: sorma::Method::Exec,
                body: Transport::default(),
                more: "and what I also wanted to say".to_owned(),
            };
            let longer = cx.call(&daemon, ask).await.unwrap_err().to_string();
            assert!(longer.contains("cannot read the data of `ask`"), "{longer}");
            let alive = ask_two(&cx, &sorm).await;
            assert_eq!(alive, [42.0]);
            Ok(String::new())
        })
    };
    assert_eq!(App::new(scenario).run(), Ok(String::new()));
}

async fn ask_two(cx: &TaskContext, sorm: &sorma::Sorm) -> Vec<f64> {
    let reply = ask(sorm, cx, "scale.two@d1 EXEC FMSG 1 21").await;
    reply.body.floats
}

/// As the ask of a daemon, whose reply ends in the middle.
#[derive(Debug, Serialize, Deserialize, Command)]
#[command(name = "ask", reply = String, code = 0x0001)]
struct ShortAsk {
    version: u32,
    object: String,
    method: sorma::Method,
    body: Transport,
}

/// Answers with the first few bytes of what it should.
struct Short;

#[ctos::handler]
impl Short {
    #[command]
    fn ask(&mut self, request: ShortAsk, reply: Replier<ShortAsk>) -> Handled {
        assert_eq!(
            (request.version, request.object.as_str()),
            (daemon::VERSION, "scale.two")
        );
        // From whom, and then nothing.
        reply.ok("client@desk".to_owned())
    }
}

#[test]
fn a_reply_that_is_cut_short_is_an_error_with_both_names() {
    let scenario: Scenario = |cx, sorm| {
        Box::pin(async move {
            let reply = ask(&sorm, &cx, "scale.two@liar EXEC FMSG 1 1").await;
            assert_eq!(reply.body.code, code::DAEMON);
            assert!(reply.body.floats.is_empty());
            let text = reply.body.reports[0].text.clone();
            for part in ["scale.two@liar", "client", "its reply", "another version"] {
                assert!(text.contains(part), "{part}: {text}");
            }
            let comm = Tasks::of(&cx);
            let wrong = sorm.subscribe(&comm, "scale.two@liar", sorma::Keep::Latest);
            let wrong = wrong.await.unwrap_err();
            assert!(wrong.text.contains("takes no `subscribe`"), "{wrong}");
            Ok(String::new())
        })
    };
    let app = App {
        daemons: vec![("liar", "cage", "handler = \"short\"")],
        handlers: |registry| {
            registry.handler("short", &Short::COMMANDS, |_| Ok(Short));
        },
        ..App::new(scenario)
    };
    assert_eq!(app.run(), Ok(String::new()));
}

#[test]
fn a_hundred_megabytes_of_text_are_refused_with_the_reason_and_the_daemon_lives() {
    let scenario: Scenario = |cx, sorm| {
        Box::pin(async move {
            let huge = "x".repeat(100 << 20);
            // As options here, and over a link, where no message may be that long.
            let mut near = request("scale.two CTRL -dump");
            near.body.text = format!("-factor {huge}");
            let near = sorm.ask(&Tasks::of(&cx), near).await;
            assert_eq!(near.body.code, code::SYNTAX);
            let said: usize = near.body.reports.iter().map(|one| one.text.len()).sum();
            assert!(said < 10_000, "the report does not repeat it: {said}");
            let mut far = request("scale.two@d1 CTRL -dump");
            far.body.text = huge;
            let far = sorm.ask(&Tasks::of(&cx), far).await;
            assert_eq!(far.body.code, code::DAEMON);
            let text = &far.body.reports[0].text;
            assert!(
                text.len() < 10_000 && text.contains("scale.two@d1"),
                "{text}"
            );
            for words in [20 << 20, 2_000_000] {
                let line = format!("scale.two EXEC {}", "x ".repeat(words));
                let reply = sorm.dispatch(&line);
                assert!(reply.starts_with("sorm RET 1 ") && reply.len() < 10_000);
            }
            // An answer that has no text for its length is told as such.
            let request = request("event EXEC");
            let mut long = request.clone();
            long.body.floats = vec![0.5; 1_000_000];
            let reply = sorm.request(long);
            assert!(reply.to_text().is_err() && reply.body.floats.len() == 1_000_000);
            assert_eq!(ask_two(&cx, &sorm).await, [42.0]);
            Ok(String::new())
        })
    };
    assert_eq!(App::new(scenario).run(), Ok(String::new()));
}
