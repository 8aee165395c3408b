//! The process that boots: starts one process per chassis, connects them, and sees them end.

use std::{
    cell::RefCell,
    collections::{BTreeMap, BTreeSet},
    net::SocketAddr,
    ops::ControlFlow,
    sync::{Arc, Mutex},
    time::Duration,
};

use futures_util::future::try_join_all;
use tokio::{
    net::TcpListener,
    signal::unix::{SignalKind, signal},
    sync::oneshot,
    task::JoinHandle,
};

use crate::{
    boot::{
        self, BootError, End, Launcher, Observer, Outcome, io_error as io,
        processes::{Keeper, Process, Starter},
        rejoin::{Doorman, Writers},
    },
    bootstrap::{EndSlot, Seat},
    call::lock,
    chassis::Chassis,
    config::App,
    control::{LogStore, Server, Ticker},
    link::tcp::{Connection, FLUSH_LIMIT, Handshake, HandshakeError, Token, callers},
    registry::Registry,
    system,
    time::Clock,
};

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
    let outcome = runtime.block_on(run(&chassis, launcher, observer));
    runtime.shutdown_background();
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
        process.kill();
        process.ended().await;
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
    let logs = Arc::new(LogStore::new(chassis.clock.clone()));
    let (ticker, observer) = &Ticker::observe(observer);
    let starter = Starter {
        chassis: chassis.clone(),
        launcher: launcher.clone(),
        observer: observer.clone(),
        boot: address,
        token: token.clone(),
        logs: logs.clone(),
    };
    for index in chassis.others() {
        processes.push(starter.start(index, 1)?);
    }
    let limit = chassis.app.phase_timeout;
    let mut missing: BTreeSet<u8> = chassis.others().collect();
    let (writers, addresses) = tokio::select! {
        connected = tokio::time::timeout(limit, connect(chassis, &listener, &token, processes, &mut missing)) => {
            match connected {
                Ok(connected) => connected?,
                Err(_) => return Err(late(chassis, &missing, limit)),
            }
        }
        _ = interrupt.recv() => return Ok(interrupted(chassis)),
        _ = terminate.recv() => return Ok(interrupted(chassis)),
    };
    let (mut keeper, orders) = Keeper::new(starter, std::mem::take(processes));
    let writers: Writers = Arc::new(Mutex::new(writers));
    let doorman = Arc::new(Doorman {
        chassis: chassis.clone(),
        token,
        addresses: Arc::new(Mutex::new(addresses.into_iter().collect())),
        incarnations: keeper.incarnations(),
        writers: writers.clone(),
    });
    let seat = Seat {
        observer: observer.clone(),
        end: EndSlot::default(),
        processes: orders,
    };
    let (sender, mut exited) = oneshot::channel();
    chassis.set_on_exit(move |code| {
        // The receiver lives until the service has exited.
        let _ = sender.send(code);
    });
    boot::start_system_tasks(chassis, Some(&seat));
    let threads = boot::start_processors(chassis).map_err(io("cannot start a thread"))?;
    let newcomers = tokio::spawn(doorman.serve(listener));
    let server = serve(chassis, &logs, ticker);
    chassis.post_system(system::BOOTSTRAP, system::AllLinked {});
    loop {
        tokio::select! {
            _ = &mut exited => break,
            _ = interrupt.recv() => chassis.post_system(system::BOOTSTRAP, system::Interrupt {}),
            _ = terminate.recv() => chassis.post_system(system::BOOTSTRAP, system::Interrupt {}),
            () = keeper.serve() => {}
        }
    }
    newcomers.abort();
    let end = lock(&seat.end).take().unwrap_or(End::Interrupted);
    let took = chassis.clock.now().since_start();
    chassis.drop_links();
    let writers = std::mem::take(&mut *lock(&writers));
    let flushed = futures_util::future::join_all(writers);
    // What cannot be written belongs to a chassis that no longer reads; its process is ended below.
    let _ = tokio::time::timeout(FLUSH_LIMIT, flushed).await;
    let casualties = keeper.end(chassis.app.stop_timeout, &end).await;
    chassis.stop_processors();
    for thread in threads {
        // The service is the last thing that ran on it.
        let _ = thread.ended.await;
    }
    chassis.close();
    let outcome = Outcome {
        end,
        casualties,
        took,
    };
    if let Some(server) = server {
        server.finish(&outcome).await;
    }
    Ok(outcome)
}

/// Serves the control socket. An app that cannot have one runs without.
fn serve(chassis: &Arc<Chassis>, logs: &Arc<LogStore>, ticker: &Ticker) -> Option<Server> {
    match Server::start(chassis, logs, ticker.clone()) {
        Ok(server) => Some(server),
        Err(error) => {
            tracing::warn!(error = %error, "no control socket: `ctos ps` and the like do not see this app");
            None
        }
    }
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

/// Waits until all chassis have called, lets them call each other, and turns the calls into links.
/// `missing` says at any time who is not connected yet.
async fn connect(
    chassis: &Arc<Chassis>,
    listener: &TcpListener,
    token: &Token,
    processes: &mut [Process],
    missing: &mut BTreeSet<u8>,
) -> Result<(Vec<JoinHandle<()>>, Vec<(u8, SocketAddr)>), BootError> {
    if missing.is_empty() {
        return Ok((Vec::new(), Vec::new()));
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
    Ok((writers, peers))
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
    let ((chassis, ending, lines), _, _) = futures_util::future::select_all(waits).await;
    let how = ending.how;
    let lines = lock(&lines).iter().cloned().collect::<Vec<_>>().join("\n");
    let reason = if lines.is_empty() {
        format!("it {how}")
    } else {
        format!("it {how}; its last lines:\n{lines}")
    };
    BootError::Chassis { chassis, reason }
}
