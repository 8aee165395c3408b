//! What a link to an agent makes of what that says.

use std::sync::Mutex;

use super::*;
use ctos_bootstrap::bootstrap::{BootEvent, Observer};
use ctos_config::load_texts;
use ctos_core::registry::Registry;
use ctos_time::lock::lock;

const APP: &str = "[host.x]\nagent = \"127.0.0.1:9\"\n[chassis.a]\nhost = \"x\"\n[task.t]\nhandler = \"h\"\non = \"a\"\n";

/// A link that has no connection, the process that it watches, and what is seen of that.
fn watched() -> (Link, Arc<Witness>, Arc<Mutex<Vec<String>>>) {
    let app = load_texts(&[("app.toml", APP)], &[], &[]).unwrap();
    let chassis = Chassis::new(0, Arc::new(app), Arc::new(Registry::new()), Clock::real());
    let seen = Arc::new(Mutex::new(Vec::new()));
    let events = seen.clone();
    let observer: Observer = Arc::new(move |event: &BootEvent| {
        lock(&events).push(match event {
            BootEvent::Log { line, .. } => line.clone(),
            other => format!("{other:?}"),
        });
    });
    let setup = HostsSetup {
        chassis: &chassis,
        keys: None,
        options: &[],
        boot: Address::Tcp(([127, 0, 0, 1], 9).into()),
        token: Token(String::new()),
    };
    let files = files(&chassis.app, &chassis.registry(), &[]).unwrap();
    let link = Link::new(&setup, &chassis.app.hosts[0], Arc::new(files));
    let witness = Arc::new(Witness::of_test(&chassis, id(2), observer));
    (link, witness, seen)
}

fn id(incarnation: u32) -> ProcessId {
    let chassis = 1;
    ProcessId {
        chassis,
        incarnation,
    }
}

fn line(incarnation: u32, number: u64, text: &str) -> ToBoot {
    ToBoot::Line(id(incarnation), number, text.to_owned())
}

#[test]
fn lines_that_are_lost_on_the_way_are_counted_in_the_log_and_none_is_shown_twice() {
    let (mut link, witness, seen) = watched();
    link.start(witness);
    for said in [
        line(2, 1, "one"),
        line(2, 1, "one"),
        line(1, 2, "of the process before it"),
        line(2, 5, "five"),
        line(2, 3, "three"),
        ToBoot::Ended(id(2), Ending::unseen("ended"), 6),
        line(2, 7, "of one that has ended"),
    ] {
        link.heard(said).unwrap();
    }
    let lost = |lines: &str| format!("WARN {lines} of this log were lost on the way from host `x`");
    assert_eq!(
        *lock(&seen),
        ["one", &lost("3 lines"), "five", &lost("1 line")]
    );
    assert!(link.live.is_empty());
}

#[test]
fn a_process_is_told_to_run_once_however_often_the_agent_says_so() {
    let (mut link, witness, seen) = watched();
    link.start(witness);
    for _ in 0..3 {
        let started = ToBoot::Started(id(2), Some(7));
        link.heard(started).unwrap();
    }
    assert_eq!(lock(&seen).len(), 1);
    assert!(link.heard(ToBoot::Over).is_err());
}

#[test]
fn the_clocks_are_compared_by_the_answer_that_was_least_under_way() {
    let (mut link, ..) = watched();
    link.ping();
    link.pong(link.pings, 5_000_000_000);
    let first = link.compared.unwrap();
    // One that nobody asked for says nothing.
    link.pong(link.pings, 9_000_000_000);
    assert_eq!(link.compared.unwrap().origin_ns, first.origin_ns);
    let now = link.clock.now().as_nanos();
    let error = (first.origin_ns + now).abs_diff(5_000_000_000);
    assert!(
        error <= now,
        "the agent's clock showed 5 s at some moment before {now} ns"
    );
}
