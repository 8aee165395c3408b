//! The process that boots: starts one process per chassis, connects them, and sees them end.

use std::{collections::BTreeSet, net::SocketAddr, sync::Arc, time::Duration};

use tokio::{
    signal::unix::{Signal, SignalKind, signal},
    sync::oneshot,
};

use crate::{
    boot::{
        launcher::{Launcher, ProcessId},
        mesh::{FLUSH_TIMEOUT, Identification, Mesh, MeshEvent},
        processes::{Keeper, Process, Starter, tell_ended},
        spawn::Ending,
    },
    control::{Gate, LogStore, Server, Ticker},
    doors::PortSecret,
    remote::{Hosts, HostsSetup},
};
use ctos_bootstrap::{
    bootstrap::{BootError, BootEvent, End, Observer, Outcome, Seat, io_error as io},
    watch,
};
use ctos_config::{App, ChassisRestart};
use ctos_core::{chassis::Chassis, registry::Registry, system};
use ctos_link::{
    handshake::Token,
    security::Keys,
    transport::{Address, Listener},
};
use ctos_message::ChassisNumber;
use ctos_time::{Clock, lock::lock};

/// How chassis are started, and who watches.
pub struct Setup<'a> {
    /// How chassis of this host are started.
    pub launcher: &'a Launcher,
    /// What chassis of other hosts are told besides the app.
    pub options: &'a [String],
    /// Who hears what happens.
    pub observer: &'a Observer,
}

/// Boots `app` with one process per chassis.
pub fn boot(
    clock: &Clock,
    app: &Arc<App>,
    registry: &Arc<Registry>,
    setup: &Setup<'_>,
) -> Result<Outcome, BootError> {
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build()
        .map_err(io("cannot start the runtime"))?;
    let chassis = Chassis::new(0, app.clone(), registry.clone(), clock.clone());
    let recording = ctos_record::start(std::slice::from_ref(&chassis), watch::COMMANDS)
        .map_err(io("cannot record"))?;
    let outcome = runtime.block_on(run(&chassis, setup));
    runtime.shutdown_background();
    if let Some(recording) = recording {
        recording.finish();
    }
    outcome
}

async fn run(chassis: &Arc<Chassis>, setup: &Setup<'_>) -> Result<Outcome, BootError> {
    let mut started = Started::default();
    let outcome = run_processes(chassis, setup, &mut started).await;
    // Those that are still in the list were not brought up: nothing moves yet, and nobody may be left.
    for mut process in started.processes {
        process.kill();
        process.ended().await;
    }
    started.hosts.close().await;
    outcome
}

/// Listens for tools; without keys those know the secret of the port.
async fn open_gate(address: SocketAddr, keys: Option<Arc<Keys>>) -> std::io::Result<Gate> {
    let is_open = keys.is_none();
    let listener = Listener::tcp(address, keys).await?;
    let secret = match listener.address()? {
        Address::Tcp(bound) if is_open => Some(PortSecret::new(bound)?),
        _ => None,
    };
    Ok(Gate { listener, secret })
}

/// What must not be left behind.
#[derive(Default)]
struct Started {
    /// Those that have not been seen to end.
    processes: Vec<Process>,
    hosts: Hosts,
}

/// Starts the processes and runs the app to its end. What is to be undone is left in `started`.
async fn run_processes(
    chassis: &Arc<Chassis>,
    setup: &Setup<'_>,
    started: &mut Started,
) -> Result<Outcome, BootError> {
    let token = Token::fresh().map_err(io("cannot make the run's secret"))?;
    let who = Identification {
        token: token.clone(),
        incarnation: 1,
    };
    let mesh = Mesh::start(chassis, who).await;
    let mut mesh = mesh.map_err(|error| BootError::Links(error.to_string()))?;
    let Some(address) = mesh.addresses().first().cloned() else {
        return Err(io("cannot listen")(
            std::io::ErrorKind::AddrNotAvailable.into(),
        ));
    };
    let mut interrupts = Interrupts::new(setup.observer)?;
    let gate = match chassis.app.control {
        Some(address) => {
            let gate = open_gate(address, mesh.keys()).await;
            Some(gate.map_err(io(format!("cannot listen at {address}, as [control] says")))?)
        }
        None => None,
    };
    let is_tcp = |address: &&Address| matches!(address, Address::Tcp(_));
    let beyond = mesh.addresses().iter().find(is_tcp).unwrap_or(&address);
    let hosts = HostsSetup {
        chassis,
        keys: mesh.keys(),
        options: setup.options,
        boot: beyond.clone(),
        token: token.clone(),
    };
    started.hosts = tokio::select! {
        hosts = Hosts::connect(&hosts) => hosts.map_err(BootError::Hosts)?,
        () = interrupts.next() => return Ok(interrupted(chassis)),
    };
    let processes = &mut started.processes;
    let logs = Arc::new(LogStore::new(chassis.clock.clone()));
    let (ticker, observer) = &Ticker::observe(setup.observer);
    interrupts.observer = observer.clone();
    let starter = Starter {
        chassis: chassis.clone(),
        launcher: setup.launcher.clone(),
        observer: observer.clone(),
        boot: address,
        token: token.clone(),
        logs: logs.clone(),
        hosts: started.hosts.clone(),
    };
    // The others start when they are asked for.
    let starts = |index: &ChassisNumber| !chassis.starts_on_demand(*index);
    for index in chassis.others().filter(starts) {
        let id = ProcessId {
            chassis: index,
            incarnation: 1,
        };
        processes.push(starter.start(id)?);
    }
    let timeout = chassis.app.phase_timeout;
    let mut missing: BTreeSet<ChassisNumber> = chassis.others().filter(starts).collect();
    let killed = tokio::select! {
        connected = tokio::time::timeout(timeout, connect(&starter, &mut mesh, processes, &mut missing)) => {
            match connected {
                Ok(connected) => connected?,
                Err(_) => return Err(late(chassis, &missing, timeout)),
            }
        }
        () = interrupts.next() => return Ok(interrupted(chassis)),
    };
    let (seat, orders) = Seat::new(observer);
    let mut keeper = Keeper::new(starter, orders, std::mem::take(processes));
    let (sender, mut exited) = oneshot::channel();
    chassis.set_on_exit(move |code| {
        // The receiver lives until the service has exited.
        let _ = sender.send(code);
    });
    ctos_bootstrap::bootstrap::start_system_tasks(chassis, Some(&seat));
    if let Some(address) = chassis.app.metrics {
        let served = crate::metrics::serve(chassis, address);
        served.map_err(|error| io("metrics")(std::io::Error::other(error)))?;
    }
    let threads =
        ctos_core::threads::start_processors(chassis).map_err(io("cannot start a thread"))?;
    let server = Server::start(chassis, &logs, ticker.clone(), gate);
    chassis.post_system(system::BOOTSTRAP, system::AllLinked {});
    for (id, ending) in killed {
        tell_ended(chassis, id, &ending);
    }
    loop {
        tokio::select! {
            _ = &mut exited => break,
            () = interrupts.next() => chassis.post_system(system::BOOTSTRAP, system::Interrupt { by_operator: false }),
            started = keeper.serve() => mesh.expect(started.chassis, started.incarnation),
            // What a chassis that is gone means is decided by the tasks, which have been told.
            event = mesh.next() => welcome(chassis, event),
        }
    }
    let end = lock(&seat.end).take().unwrap_or(End::Interrupted);
    let took = chassis.clock.now().since_start();
    chassis.drop_links();
    // What cannot be written belongs to a chassis that no longer reads; its process is ended below.
    mesh.close().await;
    let casualties = keeper.end(chassis.app.stop_timeout, &end).await;
    chassis.stop_processors();
    for thread in threads {
        // The service is the last thing that ran on it.
        let _ = thread.await;
    }
    chassis.close();
    let outcome = Outcome {
        end,
        casualties,
        took,
    };
    server.finish(&outcome).await;
    Ok(outcome)
}

fn interrupted(chassis: &Arc<Chassis>) -> Outcome {
    Outcome {
        end: End::Interrupted,
        casualties: Vec::new(),
        took: chassis.clock.now().since_start(),
    }
}

fn late(chassis: &Arc<Chassis>, missing: &BTreeSet<ChassisNumber>, timeout: Duration) -> BootError {
    let missing = missing
        .iter()
        .map(|index| format!("`{}`", chassis.name_of(*index)));
    BootError::Late {
        chassis: missing.collect(),
        timeout_s: timeout.as_secs_f64(),
    }
}

/// Tells the bootstrap service of a process that has joined the running app.
fn welcome(chassis: &Arc<Chassis>, event: MeshEvent) {
    match event {
        // The first ones are there when the app begins.
        MeshEvent::Joined {
            chassis: index,
            incarnation: incarnation @ 2..,
        } => {
            let linked = system::ChassisLinked {
                chassis: index,
                incarnation,
            };
            chassis.post_system(system::BOOTSTRAP, linked);
        }
        MeshEvent::Unable {
            chassis: index,
            reason,
        } => {
            // Its process ends, which the supervisor sees.
            tracing::error!(chassis = chassis.name_of(index), reason, "cannot join");
        }
        _ => {}
    }
}

/// Waits until all chassis are connected to this one and know of each other. It does not wait for those that were
/// killed and may be started again: they are its result, for their supervisors. `missing` says at any time who
/// is not there.
async fn connect(
    starter: &Starter,
    mesh: &mut Mesh,
    processes: &mut [Process],
    missing: &mut BTreeSet<ChassisNumber>,
) -> Result<Vec<Exit>, BootError> {
    for index in missing.iter() {
        mesh.expect(*index, 1);
    }
    let mut killed: Vec<Exit> = Vec::new();
    while !missing.is_empty() {
        let mut living: Vec<&mut Process> = processes.iter_mut().collect();
        living.retain(|process| killed.iter().all(|(id, _)| *id != process.id));
        let event = tokio::select! {
            // The process first: that it ended says more than that its connection did.
            biased;
            exit = first_exit(&mut living) => Err(exit),
            event = mesh.next() => Ok(event),
        };
        // A connection that breaks off mostly belongs to a process that is just ending. One that
        // said why it cannot start has said more than its end would.
        let exit = match event {
            Err(exit) => exit,
            Ok(MeshEvent::Joined { chassis, .. }) => {
                missing.remove(&chassis);
                continue;
            }
            Ok(MeshEvent::Up { .. }) => continue,
            Ok(MeshEvent::Down { chassis, .. })
                if killed.iter().any(|(id, _)| id.chassis == chassis) =>
            {
                continue;
            }
            Ok(MeshEvent::Down {
                chassis, reason, ..
            }) => {
                let exit = first_exit(&mut living);
                match tokio::time::timeout(FLUSH_TIMEOUT, exit).await {
                    Ok(exit) => exit,
                    Err(_) => return Err(unable(starter, chassis, reason.to_string())),
                }
            }
            Ok(MeshEvent::Unable { chassis, reason }) => {
                return Err(unable(starter, chassis, reason));
            }
        };
        let (id, ending) = &exit;
        let config = starter.chassis.config_of(id.chassis);
        let restarts =
            config.is_some_and(|config| config.supervision.restart.when != ChassisRestart::Never);
        // A process that ends by itself, before anybody asks it for anything, would only do so again.
        if !(ending.by_signal && restarts) {
            return Err(ended(starter, id.chassis, &ending.how));
        }
        missing.remove(&id.chassis);
        mesh.miss(id.chassis);
        killed.push(exit);
    }
    Ok(killed)
}

/// A process that has ended, and how.
type Exit = (ProcessId, Ending);

/// Ends when the first process does.
async fn first_exit(processes: &mut [&mut Process]) -> Exit {
    let waits = processes.iter_mut().map(|process| {
        let id = process.id;
        Box::pin(async move { (id, process.ended().await) })
    });
    futures_util::future::select_all(waits).await.0
}

fn unable(starter: &Starter, chassis: ChassisNumber, reason: String) -> BootError {
    BootError::Chassis {
        chassis: starter.chassis.name_of(chassis).to_owned(),
        reason,
    }
}

/// Why a process that has ended ends the boot, with what it said last.
fn ended(starter: &Starter, chassis: ChassisNumber, how: &str) -> BootError {
    let lines = starter.logs.last_words(starter.chassis.name_of(chassis));
    let reason = if lines.is_empty() {
        format!("it {how}")
    } else {
        format!("it {how}; its last lines:\n{lines}")
    };
    unable(starter, chassis, reason)
}

/// What asks for the end of the app: Ctrl-C, and SIGTERM, of which the observer hears.
struct Interrupts {
    interrupt: Signal,
    terminate: Signal,
    observer: Observer,
}

impl Interrupts {
    fn new(observer: &Observer) -> Result<Self, BootError> {
        Ok(Self {
            interrupt: signal(SignalKind::interrupt()).map_err(io("cannot watch Ctrl-C"))?,
            terminate: signal(SignalKind::terminate()).map_err(io("cannot watch SIGTERM"))?,
            observer: observer.clone(),
        })
    }

    async fn next(&mut self) {
        tokio::select! {
            _ = self.interrupt.recv() => {}
            _ = self.terminate.recv() => (self.observer)(&BootEvent::Terminated),
        }
    }
}
