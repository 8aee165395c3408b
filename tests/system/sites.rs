//! Apps at two and three sites on this machine, each with its own router: what they may ask of each other, and what becomes of
//! it when the way between them is cut.

use std::{
    io::{Read as _, Write as _},
    net::{Shutdown, TcpListener, TcpStream},
    sync::{Arc, Condvar, Mutex},
    time::Duration,
};

use rustix::process::Signal;

use crate::harness::{CTOS, Ended, Run, Scratch};

/// A port that nobody has at the moment.
fn free_port() -> u16 {
    let listener = TcpListener::bind(("127.0.0.1", 0)).unwrap();
    listener.local_addr().unwrap().port()
}

/// The way between two sites, which can be cut: bytes stay where they are, and connections are neither made nor ended.
#[derive(Clone)]
struct Way {
    port: u16,
    cut: Arc<(Mutex<bool>, Condvar)>,
}

impl Way {
    /// To what listens at `to`.
    fn to(to: u16) -> Self {
        let listener = TcpListener::bind(("127.0.0.1", 0)).unwrap();
        let port = listener.local_addr().unwrap().port();
        let way = Self {
            port,
            cut: Arc::default(),
        };
        let here = way.clone();
        std::thread::spawn(move || {
            for near in listener.incoming().flatten() {
                here.open();
                let Ok(far) = TcpStream::connect(("127.0.0.1", to)) else {
                    continue;
                };
                here.carry(near.try_clone().unwrap(), far.try_clone().unwrap());
                here.carry(far, near);
            }
        });
        way
    }

    /// Waits until it is whole.
    fn open(&self) {
        let (cut, changed) = &*self.cut;
        let _whole = changed.wait_while(cut.lock().unwrap(), |cut| *cut).unwrap();
    }

    fn carry(&self, mut from: TcpStream, mut to: TcpStream) {
        let way = self.clone();
        to.set_nodelay(true).unwrap();
        std::thread::spawn(move || {
            let mut bytes = [0; 1 << 16];
            while let Ok(read @ 1..) = from.read(&mut bytes) {
                way.open();
                if to.write_all(&bytes[..read]).is_err() {
                    break;
                }
            }
            way.open();
            // Each end is told when the other has gone.
            let _ = from.shutdown(Shutdown::Both);
            let _ = to.shutdown(Shutdown::Both);
        });
    }

    fn set(&self, is_cut: bool) {
        let (cut, changed) = &*self.cut;
        *cut.lock().unwrap() = is_cut;
        changed.notify_all();
    }
}

/// The sites of `configs/sites`, with keys.
fn scratch() -> Scratch {
    let scratch = Scratch::new();
    for site in ["north", "south", "west"] {
        let key = format!("configs/sites/keys/{site}");
        scratch
            .ctos(&["keys", "new", &key, "--role", "boot"])
            .must_exit(0);
    }
    scratch
}

/// Boots a site that listens and connects at these ports.
fn up<'s>(scratch: &'s Scratch, site: &str, listen: Option<u16>, connect: Option<u16>) -> Run<'s> {
    let file = format!("configs/sites/{site}.toml");
    let endpoints = |key: &str, port: Option<u16>| {
        let port = port.map(|port| format!("\"tls/127.0.0.1:{port}\""));
        format!("site.{key}=[{}]", port.unwrap_or_default())
    };
    let (listen, connect) = (endpoints("listen", listen), endpoints("connect", connect));
    let mut run = scratch.start(
        CTOS,
        &["boot", &file, "--set", &listen, "--set", &connect],
        &[],
    );
    run.wait_for("the network of sites is there");
    run
}

/// North and south, which hear each other, and the way between them.
fn two(scratch: &Scratch) -> (Run<'_>, Run<'_>, Way) {
    let port = free_port();
    let north = up(scratch, "north", Some(port), None);
    let way = Way::to(port);
    let mut south = up(scratch, "south", None, Some(way.port));
    south.wait_for("a site is there");
    (north, south, way)
}

fn stopped(run: Run<'_>) -> Ended {
    run.signal(Signal::INT);
    let ended = run.end();
    ended.must_exit_leaving(130);
    ended
}

/// Asks a net of an app.
fn ask(scratch: &Scratch, app: &str, net: &str, words: &[&str]) -> Ended {
    let arguments = [&["net", "ask", net, "--app", app], words].concat();
    scratch.ctos(&arguments)
}

/// What was stored in the depot of north, in order, without those whose callers waited for it.
fn stored(scratch: &Scratch) -> Vec<String> {
    let tape = scratch.ctos(&["net", "tape", "depot", "--app", "north", "--json"]);
    tape.must_exit_leaving(0);
    let tape = tape.json();
    let all = tape["output"].as_array().unwrap().iter();
    all.map(|one| one["arguments"][0].as_str().unwrap().to_owned())
        .collect()
}

/// How many parcels south has sent that north has not acknowledged.
fn waiting(scratch: &Scratch) -> u64 {
    let marking = scratch.ctos(&["net", "marking", "shop", "--app", "south", "--json"]);
    marking.must_exit_leaving(0);
    let marking = marking.json();
    let all = marking["sending"].as_array().unwrap().iter();
    all.map(|one| one[1].as_u64().unwrap()).sum()
}

/// Orders that are packed in south, as many as `numbers`.
fn order(scratch: &Scratch, numbers: std::ops::Range<u32>) {
    for number in numbers {
        let number = number.to_string();
        let words = ["--success", "parcel", "order", &number];
        ask(scratch, "south", "shop", &words).must_exit_leaving(0);
    }
}

/// Until north has acknowledged all parcels; the watchdog of a run ends what never comes.
fn arrived(scratch: &Scratch, south: &Run<'_>) {
    while waiting(scratch) > 0 {
        south.hold(Duration::from_millis(100));
    }
}

fn numbers(numbers: std::ops::Range<u32>) -> Vec<String> {
    numbers.map(|number| number.to_string()).collect()
}

#[test]
fn a_task_of_another_site_is_asked_by_its_name_and_what_its_site_does_not_permit_is_refused() {
    let scratch = scratch();
    let ports = [free_port(), free_port()];
    let north = up(&scratch, "north", Some(ports[0]), None);
    let mut south = up(&scratch, "south", Some(ports[1]), Some(ports[0]));
    south.wait_for("a site is there");
    // A net, and what it does not know.
    let stored_one = ask(&scratch, "south", "depot@north", &["parcel", "hat"]);
    stored_one.must_exit_leaving(0);
    assert!(
        stored_one.stdout.starts_with("stored"),
        "{}",
        stored_one.told
    );
    ask(&scratch, "south", "depot@north", &["letter"])
        .must_exit_leaving(1)
        .must_say("letter");
    // What is not permitted, though it is a command of the task.
    let paused = scratch.ctos(&["net", "pause", "depot@north", "--app", "south"]);
    paused
        .must_exit_leaving(1)
        .must_say("site `north` lets site `south` not ask `control` of `depot`");
    // A service object.
    let said = scratch.scott(&["south", "-c", "sorm@d1@north CTRL -help"]);
    said.must_exit_leaving(0);
    assert!(
        said.stdout.starts_with("sorm@d1@north RET 0"),
        "{}",
        said.told
    );
    // A display of south.
    let shown = scratch.ctos(&[
        "display",
        "--app",
        "south",
        "--json",
        "--net",
        "depot@north",
    ]);
    shown.must_exit_leaving(0);
    let shown = shown.json_lines();
    assert!(
        shown.iter().any(|line| line["net"] == "depot@north"),
        "{shown:?}"
    );
    // How sites are is seen at the gate.
    let status = scratch.ctos(&["status", "site", "--app", "south"]);
    status.must_exit_leaving(0);
    assert!(
        status.stdout.contains("site north is there"),
        "{}",
        status.told
    );
    // Another site, through the router of south: north permits it nothing.
    let mut west = up(&scratch, "west", None, Some(ports[1]));
    west.wait_for("a site is there");
    ask(&scratch, "west", "depot@north", &["parcel", "hat"])
        .must_exit_leaving(1)
        .must_say("site `north` lets site `west` ask nothing of `depot`: its [site.allow.west] does not name it");
    stopped(west);
    stopped(south);
    let north = stopped(north);
    north.must_say("lets site `west` ask nothing of `depot`");
}

/// Parcels that are sent before, in and after a cut arrive once, and whoever calls in it is told of it.
fn cut(time: Duration) {
    let scratch = scratch();
    let (north, mut south, way) = two(&scratch);
    order(&scratch, 0..3);
    arrived(&scratch, &south);
    way.set(true);
    // It is not noticed yet: the call is sent, and ends when it is.
    let lost = ask(
        &scratch,
        "south",
        "depot@north",
        &["--within", "60", "parcel", "lost"],
    );
    lost.must_exit_leaving(1)
        .must_say("site `north` has been cut off for");
    lost.must_say("what was asked may have been done");
    south.wait_for("a site is cut off");
    order(&scratch, 3..6);
    let at_once = ask(
        &scratch,
        "south",
        "depot@north",
        &["--within", "60", "parcel", "never"],
    );
    at_once
        .must_exit_leaving(1)
        .must_say("site `north` has been cut off for");
    assert!(
        !at_once.stderr.contains("may have been done"),
        "{}",
        at_once.told
    );
    south.hold(time);
    assert_eq!(waiting(&scratch), 3, "they wait");
    way.set(false);
    south.wait_for("a site is there again");
    order(&scratch, 6..8);
    arrived(&scratch, &south);
    let mut all = stored(&scratch);
    // The one that was under way may have come, and then once.
    assert!(
        all.iter().filter(|one| *one == "lost").count() <= 1,
        "{all:?}"
    );
    all.retain(|one| one != "lost");
    assert_eq!(all, numbers(0..8), "each once, in order");
    stopped(south);
    stopped(north);
}

#[test]
fn in_a_cut_of_a_second_calls_are_told_of_it_and_parcels_arrive_once_after_it() {
    cut(Duration::from_secs(1));
}

#[test]
#[ignore = "takes more than a minute"]
fn in_a_cut_of_a_minute_calls_are_told_of_it_and_parcels_arrive_once_after_it() {
    cut(Duration::from_secs(60));
}

#[test]
#[ignore = "takes more than ten minutes, with CTOS_RUN_LIMIT_S=900"]
fn in_a_cut_of_ten_minutes_calls_are_told_of_it_and_parcels_arrive_once_after_it() {
    cut(Duration::from_secs(600));
}

#[test]
fn a_gate_that_is_killed_comes_back_and_parcels_arrive_once() {
    let scratch = scratch();
    let (north, mut south, _way) = two(&scratch);
    order(&scratch, 0..2);
    north.kill("gate");
    order(&scratch, 2..4);
    south.wait_for("the gate of a site was started anew");
    order(&scratch, 4..5);
    arrived(&scratch, &south);
    south.kill("gate");
    order(&scratch, 5..7);
    south.wait_for("a site is there");
    arrived(&scratch, &south);
    assert_eq!(stored(&scratch), numbers(0..7), "each once, in order");
    stopped(south);
    stopped(north);
}

#[test]
fn a_net_that_is_killed_at_the_other_site_takes_each_parcel_once() {
    let scratch = scratch();
    scratch.edit(
        "configs/sites/north.toml",
        "[chassis.desk]",
        "[chassis.desk]\nrestart = \"on-failure\"",
    );
    let (mut north, south, _way) = two(&scratch);
    order(&scratch, 0..3);
    north.kill("desk");
    order(&scratch, 3..6);
    north.wait_for("desk is up");
    arrived(&scratch, &south);
    assert_eq!(stored(&scratch), numbers(0..6), "each once, in order");
    stopped(south);
    stopped(north);
}
