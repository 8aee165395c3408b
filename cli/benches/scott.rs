//! The cost of a request in a script that `scott` sends to a running app. It is the time for 2,000 requests less that
//! for 1,000, so that starting, finding the app and ending do not count. A byte to another process over a Unix socket
//! and back is measured in turns with it: the ratio does not depend on the machine.

#![allow(
    clippy::unwrap_used,
    clippy::print_stdout,
    reason = "a benchmark ends where something is wrong, and prints"
)]

use ctos::time::Clock;
use std::fs;
use std::io::{BufRead as _, BufReader, Read as _, Write as _};
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::Path;
use std::process::{Child, Command, Stdio};

/// The first argument of a process that sends bytes back.
const ECHO: &str = "bench-echo";

const APP: &str = "[app]\nname = \"scripted\"\n[chassis.desk]\n[task.d1]\nhandler = \"sorma.daemon\"\non = \"desk\"\n";

/// Requests by which the two scripts differ; the shorter one has as many.
const REQUESTS: u32 = 1000;
const ROUNDS: usize = 15;

fn echo(path: &str) {
    let mut stream = UnixStream::connect(path).unwrap();
    let mut byte = [0];
    while stream.read_exact(&mut byte).is_ok() {
        stream.write_all(&byte).unwrap();
    }
}

/// A program that knows no app but that of the folder.
fn command(program: &str, folder: &Path) -> Command {
    let mut command = Command::new(program);
    command
        .current_dir(folder)
        .env("XDG_RUNTIME_DIR", folder)
        .stdin(Stdio::null());
    command
}

fn boot(folder: &Path) -> Child {
    fs::write(folder.join("app.toml"), APP).unwrap();
    let mut boot = command(env!("CARGO_BIN_EXE_ctos"), folder);
    let mut app = boot
        .args(["boot", "app.toml"])
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut lines = BufReader::new(app.stderr.take().unwrap()).lines();
    while !lines.next().unwrap().unwrap().contains("phase 3") {}
    std::thread::spawn(move || lines.for_each(drop));
    app
}

/// How long it takes to have a script met, s.
fn scripted(clock: &Clock, folder: &Path, script: &str) -> f64 {
    let began = clock.now();
    let mut scott = command(env!("CARGO_BIN_EXE_scott"), folder);
    let met = scott
        .args(["scripted", "-f", script])
        .stdout(Stdio::null())
        .status();
    assert!(met.unwrap().success());
    clock.now().since(began).as_secs_f64()
}

/// The one in the middle, us.
fn median(times: &mut [f64]) -> f64 {
    times.sort_by(f64::total_cmp);
    times[times.len() / 2] * 1e6
}

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    if let [first, path] = arguments.as_slice()
        && first == ECHO
    {
        return echo(path);
    }
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    for (script, requests) in [("short.sor", REQUESTS), ("long.sor", 2 * REQUESTS)] {
        fs::write(folder.join(script), "foo EXEC\n".repeat(requests as usize)).unwrap();
    }
    let listener = UnixListener::bind(folder.join("echo")).unwrap();
    let mut peer = Command::new(std::env::current_exe().unwrap());
    let mut peer = peer.arg(ECHO).arg(folder.join("echo")).spawn().unwrap();
    let (mut bytes, _) = listener.accept().unwrap();
    let mut app = boot(folder);
    let clock = Clock::real();
    let (mut requests, mut echoes) = (Vec::new(), Vec::new());
    for _ in 0..ROUNDS {
        let short = scripted(&clock, folder, "short.sor");
        let long = scripted(&clock, folder, "long.sor");
        requests.push((long - short) / f64::from(REQUESTS));
        let began = clock.now();
        for _ in 0..REQUESTS {
            bytes.write_all(&[1]).unwrap();
            bytes.read_exact(&mut [0]).unwrap();
        }
        echoes.push(clock.now().since(began).as_secs_f64() / f64::from(REQUESTS));
    }
    let (request, echoed) = (median(&mut requests), median(&mut echoes));
    println!("request of a script of scott  {request:>7.1} us");
    println!("byte there and back           {echoed:>7.1} us");
    println!("ratio of the medians          {:>7.2}", request / echoed);
    drop(bytes);
    peer.wait().unwrap();
    let mut stop = command(env!("CARGO_BIN_EXE_ctos"), folder);
    let stopped = stop.args(["stop", "scripted"]).stderr(Stdio::null());
    assert!(stopped.status().unwrap().success());
    app.wait().unwrap();
}
