//! Apps at two and three sites on this machine, each with its own router: what they may ask of each other, and what becomes of
//! it when the way between them is cut.

use std::{
    io::{Read as _, Write as _},
    net::{Shutdown, TcpListener, TcpStream},
    process::Command,
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

/// Boots a site, with more arguments.
fn boots<'s>(scratch: &'s Scratch, within: &[&str], site: &str, more: &[&str]) -> Run<'s> {
    let file = format!("configs/sites/{site}.toml");
    let all = [within, &[CTOS, "boot", &file], more].concat();
    let mut run = scratch.start(all[0], &all[1..], &[]);
    run.wait_for("the network of sites is there");
    // The gate is there before all others.
    let nets = [("north", "depot"), ("south", "shop")];
    for (_, net) in nets.iter().filter(|(of, _)| *of == site) {
        let runs = || scratch.ctos(&["net", "marking", net, "--app", site]);
        while runs().code != Some(0) {
            run.hold(Duration::from_millis(100));
        }
    }
    run
}

/// Boots a site that listens and connects at these ports.
fn up<'s>(scratch: &'s Scratch, site: &str, listen: Option<u16>, connect: Option<u16>) -> Run<'s> {
    let endpoints = |key: &str, port: Option<u16>| {
        let port = port.map(|port| format!("\"tls/127.0.0.1:{port}\""));
        format!("site.{key}=[{}]", port.unwrap_or_default())
    };
    let (listen, connect) = (endpoints("listen", listen), endpoints("connect", connect));
    boots(scratch, &[], site, &["--set", &listen, "--set", &connect])
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

/// For how long a site has been cut off, as whoever asks it at once is told, s.
fn told_of_cut(scratch: &Scratch) -> f64 {
    let words = ["--within", "60", "parcel", "never"];
    let at_once = ask(scratch, "south", "depot@north", &words);
    at_once.must_exit_leaving(1);
    let told = at_once.stderr.split("site `north` has been cut off for ");
    let told = told.last().and_then(|rest| rest.split(" s").next());
    let told = told.and_then(|number| number.parse().ok());
    assert!(
        !at_once.stderr.contains("may have been done"),
        "{}",
        at_once.told
    );
    told.unwrap_or_else(|| panic!("{}", at_once.told))
}

/// Parcels that are sent before, in and after a cut arrive once, and whoever calls in it is told of it.
fn cut(scratch: &Scratch, north: Run<'_>, mut south: Run<'_>, set: impl Fn(bool), time: Duration) {
    order(scratch, 0..3);
    arrived(scratch, &south);
    set(true);
    // It is not noticed yet: the call is sent, and ends when it is.
    let lost = ask(
        scratch,
        "south",
        "depot@north",
        &["--within", "60", "parcel", "lost"],
    );
    lost.must_exit_leaving(1)
        .must_say("site `north` has been cut off for");
    lost.must_say("what was asked may have been done");
    south.wait_for("a site is cut off");
    order(scratch, 3..6);
    told_of_cut(scratch);
    south.hold(time);
    let told = told_of_cut(scratch);
    assert!(told >= time.as_secs_f64(), "it tells the whole cut: {told}");
    assert_eq!(waiting(scratch), 3, "they wait");
    set(false);
    south.wait_for("a site is there again");
    order(scratch, 6..8);
    arrived(scratch, &south);
    let mut all = stored(scratch);
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

/// The cut of a way on the loopback, where bytes stay where they are.
fn cut_on_the_loopback(time: Duration) {
    let scratch = scratch();
    let (north, south, way) = two(&scratch);
    cut(&scratch, north, south, |is_cut| way.set(is_cut), time);
}

#[test]
fn in_a_cut_of_a_second_calls_are_told_of_it_and_parcels_arrive_once_after_it() {
    cut_on_the_loopback(Duration::from_secs(1));
}

#[test]
#[ignore = "takes more than a minute"]
fn in_a_cut_of_a_minute_calls_are_told_of_it_and_parcels_arrive_once_after_it() {
    cut_on_the_loopback(Duration::from_secs(60));
}

#[test]
#[ignore = "takes more than ten minutes, with CTOS_RUN_LIMIT_S=900"]
fn in_a_cut_of_ten_minutes_calls_are_told_of_it_and_parcels_arrive_once_after_it() {
    cut_on_the_loopback(Duration::from_secs(600));
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

/// Two network namespaces that are joined by a wire, and gone with it.
struct Wire([String; 2]);

/// Runs `ip`; what it said if it failed.
fn ip(words: &str) -> Result<(), String> {
    let ended = Command::new("ip").args(words.split(' ')).output();
    let ended = ended.map_err(|error| format!("ip: {error}"))?;
    match ended.status.success() {
        true => Ok(()),
        false => Err(format!(
            "ip {words}: {}",
            String::from_utf8_lossy(&ended.stderr).trim()
        )),
    }
}

impl Wire {
    /// The addresses of north and south on it.
    const ADDRESSES: [&'static str; 2] = ["10.9.0.1", "10.9.0.2"];

    /// Two namespaces and what joins them, for a test that is known by how long it cuts the wire.
    ///
    /// # Errors
    /// The first namespace is not permitted. Whatever fails after that fails the test.
    fn new(cut: Duration) -> Result<Self, String> {
        let (own, cut) = (std::process::id(), cut.as_secs());
        let wire = Self(["north", "south"].map(|site| format!("ctos-{own}-{cut}-{site}")));
        let [north, south] = &wire.0;
        ip(&format!("netns add {north}"))?;
        ip(&format!("netns add {south}")).unwrap();
        ip(&format!(
            "link add wire netns {north} type veth peer name wire netns {south}"
        ))
        .unwrap();
        for (name, address) in wire.0.iter().zip(Self::ADDRESSES) {
            ip(&format!("-n {name} addr add {address}/24 dev wire")).unwrap();
            ip(&format!("-n {name} link set lo up")).unwrap();
            ip(&format!("-n {name} link set wire up")).unwrap();
        }
        Ok(wire)
    }

    /// Takes the end in south down, or up again.
    fn set(&self, is_cut: bool) {
        let to = if is_cut { "down" } else { "up" };
        ip(&format!("-n {} link set wire {to}", self.0[1])).unwrap();
    }
}

impl Drop for Wire {
    fn drop(&mut self) {
        for name in &self.0 {
            // It may never have been made.
            let _ = ip(&format!("netns del {name}"));
        }
    }
}

/// The cut of a wire between two network namespaces: packets are lost, and connections break.
fn cut_on_a_wire(time: Duration) {
    let wire = match Wire::new(time) {
        Ok(wire) => wire,
        Err(error) => {
            let why = "left out, because this host permits no network namespaces";
            let mut shown = std::io::stderr();
            writeln!(shown, "{why}: {error}").unwrap();
            return;
        }
    };
    let scratch = scratch();
    let [north, south] = [0, 1].map(|at| format!("--net=/run/netns/{}", wire.0[at]));
    let address = format!("[\"tls/{}:7461\"]", Wire::ADDRESSES[0]);
    let (listen, connect) = (
        format!("site.listen={address}"),
        format!("site.connect={address}"),
    );
    let north = boots(&scratch, &["nsenter", &north], "north", &["--set", &listen]);
    let mut south = boots(
        &scratch,
        &["nsenter", &south],
        "south",
        &["--set", "site.listen=[]", "--set", &connect],
    );
    south.wait_for("a site is there");
    cut(&scratch, north, south, |is_cut| wire.set(is_cut), time);
}

#[test]
#[ignore = "needs network namespaces"]
fn in_a_cut_wire_of_a_second_calls_are_told_of_it_and_parcels_arrive_once_after_it() {
    cut_on_a_wire(Duration::from_secs(1));
}

#[test]
#[ignore = "needs network namespaces, and takes more than a minute"]
fn in_a_cut_wire_of_a_minute_calls_are_told_of_it_and_parcels_arrive_once_after_it() {
    cut_on_a_wire(Duration::from_secs(60));
}

#[test]
#[ignore = "needs network namespaces, and takes more than ten minutes, with CTOS_RUN_LIMIT_S=900"]
fn in_a_cut_wire_of_ten_minutes_calls_are_told_of_it_and_parcels_arrive_once_after_it() {
    cut_on_a_wire(Duration::from_secs(600));
}

/// The program `zenohd`, as the router of a site.
fn zenohd<'s>(scratch: &'s Scratch, site: &str) -> Run<'s> {
    let program = std::env::var("CTOS_ZENOHD").unwrap_or_else(|_| "zenohd".to_owned());
    let file = format!("{site}-router.json5");
    // It reads keys in the folder of its file.
    scratch.start("env", &["-C", "configs/sites", &program, "-c", &file], &[])
}

#[test]
#[ignore = "needs zenohd: cargo install zenohd --locked; CTOS_ZENOHD names it if it is not in the PATH"]
fn sites_are_joined_by_the_program_zenohd_which_goes_on_while_apps_come_and_go() {
    let scratch = scratch();
    let ports = [free_port(), free_port()];
    for (site, of) in [("north", 0), ("south", 1)] {
        let file = format!("configs/sites/{site}-router.json5");
        let listens = format!("listen: {{ endpoints: [\"tls/127.0.0.1:747{}\"]", of + 1);
        let instead = format!("listen: {{ endpoints: [\"tls/127.0.0.1:{}\"]", ports[of]);
        scratch.edit(&file, &listens, &instead);
    }
    scratch.edit(
        "configs/sites/south-router.json5",
        "tls/127.0.0.1:7471",
        &format!("tls/127.0.0.1:{}", ports[0]),
    );
    let routers = [zenohd(&scratch, "north"), zenohd(&scratch, "south")];
    let joins = |site: &str, port: u16| {
        let connect = format!("site.connect=[\"tls/127.0.0.1:{port}\"]");
        boots(
            &scratch,
            &[],
            site,
            &["--profile", "zenohd", "--set", &connect],
        )
    };
    let north = joins("north", ports[0]);
    let mut south = joins("south", ports[1]);
    south.wait_for("a site is there");
    ask(&scratch, "south", "depot@north", &["parcel", "hat"]).must_exit_leaving(0);
    scratch
        .ctos(&["net", "pause", "depot@north", "--app", "south"])
        .must_exit_leaving(1)
        .must_say("site `north` lets site `south` not ask `control` of `depot`");
    // West is no neighbour of the router of north.
    let mut west = joins("west", ports[1]);
    west.wait_for("a site is there");
    ask(&scratch, "west", "depot@north", &["parcel", "hat"])
        .must_exit_leaving(1)
        .must_say("site `north` lets site `west` ask nothing of `depot`");
    stopped(west);
    order(&scratch, 0..2);
    arrived(&scratch, &south);
    stopped(north);
    south.wait_for("a site is cut off");
    order(&scratch, 2..4);
    assert_eq!(waiting(&scratch), 2, "they wait");
    let north = joins("north", ports[0]);
    south.wait_for("a site is there again");
    arrived(&scratch, &south);
    let mut all = stored(&scratch);
    all.retain(|one| one != "hat");
    assert_eq!(all[all.len() - 2..], numbers(2..4), "each once, in order");
    stopped(south);
    stopped(north);
    for router in routers {
        router.signal(Signal::INT);
        router.end();
    }
}

#[test]
fn a_site_with_the_key_of_another_one_is_told_which_it_needs_before_anything_starts() {
    let scratch = scratch();
    scratch.edit("configs/sites/south.toml", "keys/south", "keys/west");
    let checked = scratch.ctos(&["check", "configs/sites/south.toml"]);
    checked
        .must_exit(3)
        .must_say("site `south` proves who it is by a key of its name with the role boot, and [security] has one of `west`");
    checked.must_say("ctos keys new keys/south --role boot");
}
