//! The process that boots: starts one process per chassis, connects them, and sees them end.

use std::{
    cell::RefCell,
    collections::{BTreeMap, BTreeSet, VecDeque},
    net::SocketAddr,
    ops::ControlFlow,
    process::{ExitStatus, Stdio},
    sync::{Arc, Mutex},
    time::Duration,
};

use futures_util::future::try_join_all;
use rustix::process::{Pid, Signal, kill_process};
use tokio::{
    io::{AsyncBufReadExt, BufReader},
    net::TcpListener,
    process::{Child, Command},
    signal::unix::{SignalKind, signal},
    sync::oneshot,
    task::JoinHandle,
};

use crate::{
    boot::{self, BootError, BootEvent, End, Launcher, Observer, Outcome, TOKEN_VARIABLE, io},
    bootstrap::EndSlot,
    call::lock,
    chassis::Chassis,
    config::App,
    link::tcp::{Connection, FLUSH_LIMIT, Handshake, HandshakeError, Token, callers},
    record,
    registry::Registry,
    system,
    time::Clock,
    watch,
};

/// How many of its last lines are kept of a chassis's log, for the error that its end causes.
const LAST_LINES: usize = 5;

/// A chassis's process.
struct Process {
    name: String,
    child: Child,
    last_lines: Arc<Mutex<VecDeque<String>>>,
    /// Reads its log; `None` when that is read to its end.
    log: Option<JoinHandle<()>>,
}

impl Process {
    /// Waits until it has ended and its last words are known.
    async fn ended(&mut self) -> std::io::Result<ExitStatus> {
        let status = self.child.wait().await;
        if let Some(log) = &mut self.log
            && tokio::time::timeout(FLUSH_LIMIT, log).await.is_ok()
        {
            self.log = None;
        }
        status
    }
}

/// Boots `app` with one process per chassis.
pub(crate) fn boot(
    clock: &Clock,
    app: &Arc<App>,
    registry: &Arc<Registry>,
    launcher: &Launcher,
    observer: &Observer,
) -> Result<Outcome, BootError> {
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build()
        .map_err(io("cannot start the runtime"))?;
    let chassis = Chassis::new(0, app.clone(), registry.clone(), clock.clone());
    let recording = record::start(std::slice::from_ref(&chassis)).map_err(io("cannot record"))?;
    let outcome = runtime.block_on(run(&chassis, launcher, observer));
    runtime.shutdown_background();
    if let Some(recording) = recording {
        recording.finish();
    }
    outcome
}

async fn run(
    chassis: &Arc<Chassis>,
    launcher: &Launcher,
    observer: &Observer,
) -> Result<Outcome, BootError> {
    let mut processes = Vec::new();
    let outcome = run_processes(chassis, launcher, observer, &mut processes).await;
    // Those that are still in the list were not brought up: nothing moves yet, and nobody may be left.
    for mut process in processes {
        // An error says that it has ended already.
        let _ = process.child.kill().await;
    }
    outcome
}

/// Starts the processes and runs the app to its end. Those that have not been seen to end are left in
/// `processes`.
async fn run_processes(
    chassis: &Arc<Chassis>,
    launcher: &Launcher,
    observer: &Observer,
    processes: &mut Vec<Process>,
) -> Result<Outcome, BootError> {
    let token = Token::fresh().map_err(io("cannot make the run's secret"))?;
    let listener = TcpListener::bind(SocketAddr::from(([127, 0, 0, 1], 0)))
        .await
        .map_err(io("cannot listen on the loopback"))?;
    let address = listener.local_addr().map_err(io("cannot listen"))?;
    let mut interrupt = signal(SignalKind::interrupt()).map_err(io("cannot watch Ctrl-C"))?;
    let mut terminate = signal(SignalKind::terminate()).map_err(io("cannot watch SIGTERM"))?;
    for config in &chassis.app.chassis {
        let process = start(&config.name, launcher, address, &token, chassis, observer)?;
        processes.push(process);
    }
    let limit = chassis.app.phase_timeout;
    let mut missing: BTreeSet<u8> = chassis.others().collect();
    let writers = tokio::select! {
        connected = tokio::time::timeout(limit, connect(chassis, &listener, &token, processes, &mut missing)) => {
            match connected {
                Ok(connected) => connected?,
                Err(_) => return Err(late(chassis, &missing, limit)),
            }
        }
        _ = interrupt.recv() => return Ok(interrupted(chassis)),
        _ = terminate.recv() => return Ok(interrupted(chassis)),
    };
    let end_slot = EndSlot::default();
    let (sender, mut exited) = oneshot::channel();
    chassis.set_on_exit(move |code| {
        // The receiver lives until the service has exited.
        let _ = sender.send(code);
    });
    boot::start_system_tasks(chassis, observer, &end_slot);
    if let Some(address) = chassis.app.metrics {
        let served = watch::serve(chassis, address).await;
        served.map_err(|error| io("metrics")(std::io::Error::other(error)))?;
    }
    let threads = boot::start_processors(chassis).map_err(io("cannot start a thread"))?;
    chassis.post_system(system::BOOTSTRAP, system::AllLinked {});
    loop {
        tokio::select! {
            _ = &mut exited => break,
            _ = interrupt.recv() => chassis.post_system(system::BOOTSTRAP, system::Interrupt {}),
            _ = terminate.recv() => chassis.post_system(system::BOOTSTRAP, system::Interrupt {}),
        }
    }
    let end = lock(&end_slot).take().unwrap_or(End::Interrupted);
    let took = chassis.clock.now().since_start();
    chassis.drop_links();
    let flushed = futures_util::future::join_all(writers);
    // What cannot be written belongs to a chassis that no longer reads; its process is ended below.
    let _ = tokio::time::timeout(FLUSH_LIMIT, flushed).await;
    let processes = std::mem::take(processes);
    let casualties = end_processes(processes, chassis.app.stop_timeout, &end, observer).await;
    chassis.stop_processors();
    for thread in threads {
        // The service is the last thing that ran on it.
        let _ = thread.ended.await;
    }
    chassis.close();
    Ok(Outcome {
        end,
        casualties,
        took,
    })
}

fn interrupted(chassis: &Arc<Chassis>) -> Outcome {
    Outcome {
        end: End::Interrupted,
        casualties: Vec::new(),
        took: chassis.clock.now().since_start(),
    }
}

fn late(chassis: &Arc<Chassis>, missing: &BTreeSet<u8>, limit: Duration) -> BootError {
    let missing = missing
        .iter()
        .map(|index| format!("`{}`", chassis.name_of(*index)));
    BootError::Late {
        chassis: missing.collect(),
        limit_s: limit.as_secs_f64(),
    }
}

/// Starts the process of chassis `name`; its log is shown line by line.
fn start(
    name: &str,
    launcher: &Launcher,
    boot: SocketAddr,
    token: &Token,
    chassis: &Arc<Chassis>,
    observer: &Observer,
) -> Result<Process, BootError> {
    let origin = chassis.clock.origin_ns().unwrap_or(0);
    let mut child = Command::new(&launcher.program)
        .args(&launcher.arguments)
        .args(["--chassis", name, "--boot", &boot.to_string()])
        .args(["--origin", &origin.to_string()])
        .env(TOKEN_VARIABLE, &token.0)
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .process_group(0)
        .kill_on_drop(true)
        .spawn()
        .map_err(io(format!("cannot start chassis `{name}`")))?;
    observer(&BootEvent::Started {
        chassis: name.to_owned(),
        pid: child.id(),
    });
    let last_lines = Arc::new(Mutex::new(VecDeque::new()));
    let log = child.stderr.take().map(|stderr| {
        let kept = last_lines.clone();
        let observer = observer.clone();
        let chassis = name.to_owned();
        tokio::spawn(async move {
            let mut lines = BufReader::new(stderr).lines();
            while let Ok(Some(line)) = lines.next_line().await {
                let mut kept = lock(&kept);
                if kept.len() == LAST_LINES {
                    kept.pop_front();
                }
                kept.push_back(line.clone());
                drop(kept);
                let chassis = chassis.clone();
                observer(&BootEvent::Log { chassis, line });
            }
        })
    });
    Ok(Process {
        name: name.to_owned(),
        child,
        last_lines,
        log,
    })
}

/// Waits until all chassis have called, lets them call each other, and turns the calls into links.
/// `missing` says at any time who is not connected yet.
async fn connect(
    chassis: &Arc<Chassis>,
    listener: &TcpListener,
    token: &Token,
    processes: &mut [Process],
    missing: &mut BTreeSet<u8>,
) -> Result<Vec<JoinHandle<()>>, BootError> {
    if missing.is_empty() {
        return Ok(Vec::new());
    }
    let mut connections: BTreeMap<u8, (Connection, SocketAddr)> = BTreeMap::new();
    let called = callers(listener, token, |caller| {
        if let Some(listen) = caller.listen
            && missing.remove(&caller.chassis)
        {
            connections.insert(caller.chassis, (caller.connection, listen));
        }
        if missing.is_empty() {
            ControlFlow::Break(())
        } else {
            ControlFlow::Continue(())
        }
    });
    let called = tokio::select! {
        called = called => called,
        ended = first_exit(processes) => return Err(ended),
    };
    if let Err(error) = called {
        return Err(refused(processes, error.to_string()).await);
    }
    let peers: Vec<(u8, SocketAddr)> = connections
        .iter()
        .map(|(index, (_, address))| (*index, *address))
        .collect();
    missing.extend(connections.keys());
    let waiting = RefCell::new(missing);
    let introduced =
        try_join_all(connections.into_iter().map(|(index, (connection, _))| {
            introduce(chassis, index, connection, &peers, &waiting)
        }));
    let connections = tokio::select! {
        // The process first: that it ended says more than that its connection did.
        biased;
        ended = first_exit(processes) => return Err(ended),
        introduced = introduced => introduced,
    };
    let connections = match connections {
        Ok(connections) => connections,
        // A connection that breaks off mostly belongs to a process that is just ending.
        Err(error) => {
            let ended = tokio::time::timeout(FLUSH_LIMIT, first_exit(processes)).await;
            return Err(ended.unwrap_or(error));
        }
    };
    let mut writers = Vec::new();
    for (index, mut connection) in connections {
        let told = connection.tell(&Handshake::Go).await;
        told.map_err(|error| failed(chassis, index, &error))?;
        writers.push(connection.into_link(chassis, index));
    }
    Ok(writers)
}

/// Tells chassis `index` where the others listen, and waits until it is connected to all of them.
async fn introduce(
    chassis: &Arc<Chassis>,
    index: u8,
    mut connection: Connection,
    peers: &[(u8, SocketAddr)],
    waiting: &RefCell<&mut BTreeSet<u8>>,
) -> Result<(u8, Connection), BootError> {
    let told = connection.tell(&Handshake::Peers(peers.to_vec())).await;
    told.map_err(|error| failed(chassis, index, &error))?;
    match connection.hear().await {
        Ok(Handshake::Ready) => {
            waiting.borrow_mut().remove(&index);
            Ok((index, connection))
        }
        Ok(other) => {
            let error = HandshakeError::Unexpected(Box::new(other));
            Err(failed(chassis, index, &error))
        }
        Err(error) => Err(failed(chassis, index, &error)),
    }
}

fn failed(chassis: &Arc<Chassis>, index: u8, error: &HandshakeError) -> BootError {
    BootError::Chassis {
        chassis: chassis.name_of(index).to_owned(),
        reason: error.to_string(),
    }
}

/// A chassis said why it cannot start, and is about to end; which one it was, its end tells.
async fn refused(processes: &mut [Process], reason: String) -> BootError {
    let ended = tokio::time::timeout(FLUSH_LIMIT, first_exit(processes)).await;
    let chassis = match ended {
        Ok(BootError::Chassis { chassis, .. }) => chassis,
        _ => "unknown".to_owned(),
    };
    BootError::Chassis { chassis, reason }
}

/// Ends when the first process does.
async fn first_exit(processes: &mut [Process]) -> BootError {
    let waits = processes.iter_mut().map(|process| {
        let name = process.name.clone();
        let lines = process.last_lines.clone();
        Box::pin(async move { (name, process.ended().await, lines) })
    });
    let ((chassis, status, lines), _, _) = futures_util::future::select_all(waits).await;
    let how = status.map_or_else(|error| error.to_string(), |status| describe(&status));
    let lines = lock(&lines).iter().cloned().collect::<Vec<_>>().join("\n");
    let reason = if lines.is_empty() {
        format!("it {how}")
    } else {
        format!("it {how}; its last lines:\n{lines}")
    };
    BootError::Chassis { chassis, reason }
}

fn describe(status: &ExitStatus) -> String {
    use std::os::unix::process::ExitStatusExt;
    match (status.code(), status.signal()) {
        (Some(code), _) => format!("ended with exit code {code}"),
        (None, Some(9)) => "was killed by signal 9 (SIGKILL)".to_owned(),
        (None, Some(15)) => "was ended by signal 15 (SIGTERM)".to_owned(),
        (None, Some(11)) => "crashed with signal 11 (SIGSEGV)".to_owned(),
        (None, Some(6)) => "aborted with signal 6 (SIGABRT)".to_owned(),
        (None, Some(number)) => format!("was ended by signal {number}"),
        (None, None) => "ended".to_owned(),
    }
}

/// Waits for all processes: those that do not end by themselves get SIGTERM, then SIGKILL.
/// Names those that ended otherwise than they should have.
async fn end_processes(
    processes: Vec<Process>,
    limit: Duration,
    end: &End,
    observer: &Observer,
) -> Vec<(String, String)> {
    let expected = i32::from(!matches!(end, End::Finished(result) if result.ok));
    let mut casualties = Vec::new();
    for mut process in processes {
        let mut status = tokio::time::timeout(limit, process.ended()).await;
        for (number, name) in [(Signal::TERM, "SIGTERM"), (Signal::KILL, "SIGKILL")] {
            if status.is_ok() {
                break;
            }
            let pid = process.child.id().and_then(|pid| i32::try_from(pid).ok());
            if let Some(pid) = pid.and_then(Pid::from_raw) {
                observer(&BootEvent::Signalled {
                    chassis: process.name.clone(),
                    signal: name,
                });
                // It may have ended just now; the wait below tells.
                let _ = kill_process(pid, number);
            }
            status = tokio::time::timeout(limit, process.ended()).await;
        }
        match status {
            Ok(Ok(status)) if status.code() == Some(expected) => {}
            Ok(Ok(status)) => casualties.push((process.name, describe(&status))),
            Ok(Err(error)) => casualties.push((process.name, error.to_string())),
            Err(_) => casualties.push((process.name, "could not be ended".to_owned())),
        }
    }
    casualties
}
