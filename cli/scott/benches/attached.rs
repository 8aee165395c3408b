//! The cost of a request that comes by the control socket of an app, as those of `scott` do. It goes from this
//! process to the boot and to the daemon in a process of its own. There it goes to the thread that calls the object,
//! and back. A byte over Unix sockets between processes and back is measured in turns with it: the ratio does not
//! depend on the machine.

#![allow(
    clippy::unwrap_used,
    clippy::print_stdout,
    reason = "a benchmark ends where something is wrong, and prints"
)]

use cli_common::client::{self, Client};
use ctos::boot::{Launcher, Observer, boot, run_chassis};
use ctos::config::{App, load_texts};
use ctos::control::protocol::{Answer, Request, SayRequest};
use ctos::registry::Registry;
use ctos::time::Clock;
use sorma::{Dictionary, daemon, demo};
use std::ffi::OsString;
use std::io::{Read as _, Write as _};
use std::os::unix::net::{UnixListener, UnixStream};
use std::process::{Command, Stdio};
use std::sync::Arc;
use std::sync::mpsc::channel;
use std::time::Duration;

/// The first argument of a process that is a chassis, and of one that sends bytes back.
const CHASSIS: &str = "bench-chassis";
const ECHO: &str = "bench-echo";

const APP: &str = "[app]\nname = \"attached\"\n[chassis.desk]\n[task.d1]\nhandler = \"sorma.daemon\"\non = \"desk\"\n";

/// Requests of each kind in a round, and rounds.
const EACH: usize = 50;
const ROUNDS: usize = 60;

fn registry() -> Registry {
    let mut registry = Registry::new();
    daemon::register(&mut registry, Dictionary::new(), |_, sorm| {
        demo::register(sorm);
    });
    registry
}

fn app() -> App {
    load_texts(&[("bench.toml", APP)], &[], &[]).unwrap()
}

fn echo(path: &str) {
    let mut stream = UnixStream::connect(path).unwrap();
    let mut byte = [0];
    while stream.read_exact(&mut byte).is_ok() {
        stream.write_all(&byte).unwrap();
    }
}

fn ask(client: &mut Client) {
    let request = Request::Say(SayRequest {
        task: "d1".to_owned(),
        line: "foo EXEC".to_owned(),
        trace: 0,
        limit_s: Some(60.0),
    });
    let answer = client.get(request).unwrap();
    assert!(matches!(answer, Answer::Said { line } if line.contains("RET 0")));
}

/// Times of a deed, us, the least first.
fn timed(clock: &Clock, into: &mut Vec<f64>, mut deed: impl FnMut()) {
    for _ in 0..EACH {
        let began = clock.now();
        deed();
        into.push(clock.now().since(began).as_secs_f64() * 1e6);
    }
}

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    match arguments.as_slice() {
        [first, path] if first == ECHO => return echo(path),
        [first, _, name, _, address, _, origin] if first == CHASSIS => {
            let (address, origin) = (address.parse().unwrap(), origin.parse().unwrap());
            run_chassis(app(), registry(), name, &address, origin).unwrap();
            return;
        }
        _ => {}
    }
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("echo");
    let listener = UnixListener::bind(&path).unwrap();
    let program = std::env::current_exe().unwrap();
    let mut peer = Command::new(&program);
    let mut peer = peer
        .arg(ECHO)
        .arg(&path)
        .stdin(Stdio::null())
        .spawn()
        .unwrap();
    let (mut bytes, _) = listener.accept().unwrap();
    let launcher = Launcher {
        program,
        arguments: vec![OsString::from(CHASSIS)],
    };
    let (tell, told) = channel();
    let booted = std::thread::spawn(move || {
        let observer: Observer = Arc::new(move |event| {
            // The receiver may be gone.
            let _ = tell.send(format!("{event:?}"));
        });
        boot(app(), registry(), &launcher, &observer).unwrap();
    });
    while !told.recv().unwrap().contains("phase: Run") {}
    let pid = std::process::id().to_string();
    let app = client::find(Some(&pid)).unwrap();
    let mut client = Client::connect(app, Duration::from_secs(60)).unwrap();
    let clock = Clock::real();
    let (mut requests, mut echoes) = (Vec::new(), Vec::new());
    for _ in 0..ROUNDS {
        timed(&clock, &mut requests, || ask(&mut client));
        timed(&clock, &mut echoes, || {
            bytes.write_all(&[1]).unwrap();
            bytes.read_exact(&mut [0]).unwrap();
        });
    }
    for times in [&mut requests, &mut echoes] {
        times.sort_by(f64::total_cmp);
    }
    let at = |times: &[f64], part: f64| times[(times.len() as f64 * part) as usize];
    for (name, times) in [("request", &requests), ("byte there and back", &echoes)] {
        let [least, middle, most] = [0.0, 0.5, 0.9].map(|part| at(times, part));
        println!("{name:<20} least {least:>7.1} us, median {middle:>7.1} us, p90 {most:>7.1} us");
    }
    let ratio = at(&requests, 0.5) / at(&echoes, 0.5);
    println!("ratio of the medians {ratio:.2}");
    drop(bytes);
    peer.wait().unwrap();
    client.ask(Request::Stop { now: true }).unwrap();
    booted.join().unwrap();
}
