//! The processes of an app, as the one that boots sees them: started, watched, ended. Some are its own
//! children, others those of agents on other hosts.

use std::{
    collections::BTreeMap,
    process::Stdio,
    sync::{Arc, Mutex},
    time::Duration,
};

use rustix::process::Signal;
use tokio::{process::Command, sync::watch};

use crate::{
    boot::{
        launcher::{Briefing, Launcher, ProcessId},
        spawn::{self, Ending, Spawned},
    },
    control::LogStore,
    remote::{HostLink, Hosts},
};
use ctos_bootstrap::bootstrap::{BootError, BootEvent, End, Observer, ProcessOrder, ProcessOrders};
use ctos_core::{chassis::Chassis, system};
use ctos_link::{handshake::Token, transport::Address};
use ctos_message::ChassisNumber;
use ctos_time::lock::lock;

/// A chassis's process.
#[derive(derive_more::Debug)]
#[debug("Process(`{}` {})", self.name, self.id.incarnation)]
pub(super) struct Process {
    pub(super) name: String,
    pub(super) id: ProcessId,
    home: Home,
    ended: watch::Receiver<Option<Ending>>,
}

/// Where a process lives.
enum Home {
    /// A child of this process.
    Here(Spawned),
    /// A child of the agent of that host.
    There(HostLink),
}

impl Process {
    /// Waits until it has ended and its last words are known.
    pub(super) async fn ended(&mut self) -> Ending {
        let gone = || Ending::unseen("ended unseen");
        // The thread that watches it ends only with the boot.
        let ended = self.ended.wait_for(Option::is_some).await;
        ended.map_or_else(|_| gone(), |ending| ending.clone().unwrap_or_else(gone))
    }

    /// Ends it at once.
    pub(super) fn kill(&self) {
        self.signal(Signal::KILL);
    }

    fn signal(&self, signal: Signal) {
        match &self.home {
            Home::Here(spawned) => spawned.signal(signal),
            Home::There(link) => link.signal(self.id, signal),
        }
    }
}

/// Hears everything of one process, wherever it lives.
pub(crate) struct Witness {
    chassis: Arc<Chassis>,
    pub(crate) id: ProcessId,
    pub(crate) name: String,
    host: Option<String>,
    observer: Observer,
    logs: Arc<LogStore>,
    ended: Mutex<Option<watch::Sender<Option<Ending>>>>,
}

impl Witness {
    /// One whose process nobody starts.
    #[cfg(test)]
    pub(crate) fn of_test(chassis: &Arc<Chassis>, id: ProcessId, observer: Observer) -> Self {
        Self {
            chassis: chassis.clone(),
            id,
            name: chassis.name_of(id.chassis).to_owned(),
            host: None,
            observer,
            logs: Arc::new(LogStore::new(chassis.clock.clone())),
            ended: Mutex::new(None),
        }
    }

    /// It runs.
    pub(crate) fn started(&self, pid: Option<u32>) {
        self.logs.begin(&self.name, self.id.incarnation, pid);
        (self.observer)(&BootEvent::Started {
            chassis: self.name.clone(),
            pid,
            host: self.host.clone(),
        });
    }

    /// Whether it, or one before it, can be talked to.
    pub(crate) fn is_linked(&self) -> bool {
        self.chassis.is_linked(self.id.chassis)
    }

    /// It has written a line to its log.
    pub(crate) fn line(&self, line: String) {
        self.logs.add(&self.name, self.id.incarnation, &line);
        let chassis = self.name.clone();
        (self.observer)(&BootEvent::Log { chassis, line });
    }

    /// It has ended. Only the first time counts.
    pub(crate) fn ended(&self, ending: Ending) {
        let Some(ended) = lock(&self.ended).take() else {
            return;
        };
        // The bootstrap service hears of the end of every process, also when the app ends and it no longer needs that.
        tell_ended(&self.chassis, self.id, &ending);
        // Nobody may be left to see it.
        let _ = ended.send(Some(ending));
    }
}

/// How processes are started, and who hears of them.
pub(super) struct Starter {
    pub(super) chassis: Arc<Chassis>,
    pub(super) launcher: Launcher,
    pub(super) observer: Observer,
    pub(super) boot: Address,
    pub(super) token: Token,
    pub(super) logs: Arc<LogStore>,
    pub(super) hosts: Hosts,
}

impl Starter {
    /// Starts the process of chassis `index`; its log is shown line by line. One on another host may
    /// turn out later not to have started: it ends then.
    pub(super) fn start(&self, id: ProcessId) -> Result<Process, BootError> {
        let name = self.chassis.name_of(id.chassis).to_owned();
        let host = self.chassis.app.host_of(&name);
        let (ending, ended) = watch::channel(None);
        let witness = Arc::new(Witness {
            chassis: self.chassis.clone(),
            id,
            name: name.clone(),
            host: host.map(|host| host.name.clone()),
            observer: self.observer.clone(),
            logs: self.logs.clone(),
            ended: Mutex::new(Some(ending)),
        });
        let home = match host.and_then(|host| self.hosts.link(&host.name)) {
            Some(link) => {
                link.start(witness);
                Home::There(link)
            }
            None => self.start_here(witness)?,
        };
        Ok(Process {
            name,
            id,
            home,
            ended,
        })
    }

    fn start_here(&self, witness: Arc<Witness>) -> Result<Home, BootError> {
        let briefing = Briefing {
            name: witness.name.clone(),
            incarnation: witness.id.incarnation,
            origin_ns: self.chassis.clock.origin_ns().unwrap_or(0),
            boot: self.boot.clone(),
            token: self.token.clone(),
        };
        let mut command = Command::new(&self.launcher.program);
        command.args(&self.launcher.arguments);
        briefing.put_into(&mut command);
        // Its lines are read by this thread, which has then told that it runs.
        let (heard, at_end) = (witness.clone(), witness.clone());
        let spawned = spawn::spawn(
            command,
            Stdio::null(),
            move |line| heard.line(line),
            move |ending| at_end.ended(ending),
        )
        .map_err(ctos_bootstrap::bootstrap::io_error(format!(
            "cannot start chassis `{}`",
            witness.name
        )))?;
        witness.started(spawned.pid);
        Ok(Home::Here(spawned))
    }
}

/// Tells the bootstrap service of the end of a process.
pub(super) fn tell_ended(chassis: &Arc<Chassis>, id: ProcessId, ending: &Ending) {
    let ended = system::ProcessEnded {
        chassis: id.chassis,
        incarnation: id.incarnation,
        how: ending.how.clone(),
        code: ending.code,
    };
    chassis.post_system(system::BOOTSTRAP, ended);
}

/// The processes of an app that is up, by chassis.
pub(super) struct Keeper {
    starter: Starter,
    orders: ProcessOrders,
    processes: BTreeMap<ChassisNumber, Process>,
}

impl Keeper {
    /// Keeps `processes`.
    pub(super) fn new(starter: Starter, orders: ProcessOrders, processes: Vec<Process>) -> Self {
        Self {
            starter,
            orders,
            processes: processes
                .into_iter()
                .map(|one| (one.id.chassis, one))
                .collect(),
        }
    }

    /// Carries out orders until a process was started: which one.
    pub(super) async fn serve(&mut self) -> ProcessId {
        loop {
            match self.orders.recv().await {
                Some(ProcessOrder::Start(chassis, incarnation)) => {
                    let id = ProcessId {
                        chassis,
                        incarnation,
                    };
                    match self.starter.start(id) {
                        Ok(process) => drop(self.processes.insert(id.chassis, process)),
                        Err(error) => {
                            let how = format!("could not be started again: {error}");
                            tell_ended(&self.starter.chassis, id, &Ending::unseen(how));
                        }
                    }
                    return id;
                }
                Some(ProcessOrder::Kill(index)) => {
                    if let Some(process) = self.processes.get(&index) {
                        process.kill();
                    }
                }
                None => std::future::pending().await,
            }
        }
    }

    /// Waits for all processes: those that do not end by themselves get SIGTERM, then SIGKILL.
    /// Names those that ended otherwise than they should have.
    pub(super) async fn end(self, timeout: Duration, end: &End) -> Vec<(String, String)> {
        let expected = i32::from(!matches!(end, End::Finished(result) if result.ok));
        let mut casualties = Vec::new();
        for mut process in self.processes.into_values() {
            let mut ended = tokio::time::timeout(timeout, process.ended()).await;
            for (number, name) in [(Signal::TERM, "SIGTERM"), (Signal::KILL, "SIGKILL")] {
                if ended.is_ok() {
                    break;
                }
                (self.starter.observer)(&BootEvent::Signalled {
                    chassis: process.name.clone(),
                    signal: name.to_owned(),
                });
                process.signal(number);
                ended = tokio::time::timeout(timeout, process.ended()).await;
            }
            match ended {
                Ok(ending) if ending.code == Some(expected) => {}
                Ok(ending) => casualties.push((process.name, ending.how)),
                Err(_) => casualties.push((process.name, "could not be ended".to_owned())),
            }
        }
        casualties
    }
}
