//! Strangers at the ports of a running app: they keep nobody out who belongs to it, and fill no log.

use std::{
    io::Read,
    net::{SocketAddr, TcpStream},
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    thread::JoinHandle,
};

use rustix::process::Signal;

use crate::{
    harness::{MISBEHAVING, Scratch},
    hosts::free_port,
};

/// More than are heard at a time.
const IDLE: usize = 70;

/// Connections that say nothing, and come again when they are closed.
struct Idle {
    over: Arc<AtomicBool>,
    threads: Vec<JoinHandle<()>>,
}

impl Idle {
    fn at(address: SocketAddr) -> Self {
        let over = Arc::new(AtomicBool::new(false));
        let threads = (0..IDLE).map(|_| {
            let over = over.clone();
            std::thread::spawn(move || {
                while !over.load(Ordering::Relaxed) {
                    let Ok(mut stream) = TcpStream::connect(address) else {
                        return;
                    };
                    // Ends when it is closed there.
                    let _ = stream.read(&mut [0; 1]);
                }
            })
        });
        Self {
            threads: threads.collect(),
            over,
        }
    }

    /// Ends with the app.
    fn end(self) {
        self.over.store(true, Ordering::Relaxed);
        for thread in self.threads {
            thread.join().unwrap();
        }
    }
}

#[test]
fn a_killed_chassis_comes_back_while_idle_strangers_hold_every_port_and_the_log_stays_short() {
    let scratch = Scratch::empty();
    let port = free_port();
    scratch.write(
        "app.toml",
        format!(
            "[app]\nsame_host = \"tcp\"\nstop_timeout_s = 2\n[chassis.side]\nlisten = \"127.0.0.1:{port}\"\n[chassis.cage]\nrestart = \"on-failure\"\nmax_restarts = 1\n\
             [task.arm]\nhandler = \"test.steady\"\non = \"cage\"\nargs = {{ slow_s = 0.0 }}\n\
             [task.other]\nhandler = \"test.steady\"\non = \"side\"\nargs = {{ slow_s = 0.0, waits_for = \"arm\" }}\n"
        ),
    );
    let mut run = scratch.start(MISBEHAVING, &["boot", "app.toml"], &[]);
    run.wait_for("phase 3");
    // A chassis is told where its boot listens.
    let pid = run.chassis["cage"].pid.as_raw_nonzero();
    let told = std::fs::read_to_string(format!("/proc/{pid}/cmdline")).unwrap();
    let mut told = told.split('\0').skip_while(|word| *word != "--boot");
    let boot = told.nth(1).unwrap().strip_prefix("tcp:").unwrap();
    let ports = [boot.parse().unwrap(), ([127, 0, 0, 1], port).into()];
    let idle = ports.map(Idle::at);
    run.wait_for("a caller was refused");
    run.kill("cage");
    run.wait_for("cage is up again");
    run.signal(Signal::INT);
    let ended = run.end();
    idle.into_iter().for_each(Idle::end);
    ended.must_exit(130);
    let refused = ended.told.matches("a caller was refused").count();
    assert!(refused <= 100, "{refused} lines");
}
