//! The typed app: what the files and `--set` texts of an app say, once nothing is wrong with them.

use super::index::Index;
use super::links::{LinkConfig, SecurityConfig};
use super::load::SET;
use super::node::Node;
use super::selection::Selection;
use super::trail::{Origin, Read, Trail};
use crate::diagnostic::{Finding, Findings, Place, Source};
use crate::settings::{Lead, Overrun, Policy, Scope};
use serde::Deserialize;
use std::collections::BTreeSet;
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::time::Duration;

/// Where a data file of an app may be.
const LOOKED_FOR: &str = "check the path; it is looked for in the folder of the app's file, then in those of the files that it includes";

/// An app: everything its files and `--set` texts say, checked and in declared order.
#[derive(Debug, Clone, PartialEq)]
pub struct App {
    /// Its name; the file's name without extension when none is given.
    pub name: String,
    /// Seed of all randomness.
    pub seed: u64,
    /// The task whose end ends the app.
    pub until: Option<String>,
    /// How long each startup phase may take.
    pub phase_timeout: Duration,
    /// How long an orderly stop may take.
    pub stop_timeout: Duration,
    /// Which clock the app runs on.
    pub time: TimeMode,
    /// How links behave.
    pub links: LinkConfig,
    /// Whose keys count beyond this host; `None` = nobody beyond this host is let in.
    pub security: Option<SecurityConfig>,
    /// What is recorded, if anything is.
    pub record: Option<RecordConfig>,
    /// Where `/metrics` is served, if anywhere.
    pub metrics: Option<SocketAddr>,
    /// Where the boot listens for chassis of other hosts.
    pub listen: Option<SocketAddr>,
    /// Where tools of other hosts reach the app, if anywhere.
    pub control: Option<SocketAddr>,
    /// The other hosts, in declared order.
    pub hosts: Vec<HostConfig>,
    /// The chassis, in declared order.
    pub chassis: Vec<ChassisConfig>,
    /// The tasks, in declared order, those made by expanders after them.
    pub tasks: Vec<TaskConfig>,
    /// The semaphores that the configuration declares, in declared order.
    pub semaphores: Vec<SharedConfig>,
    /// The barriers that the configuration declares, in declared order.
    pub barriers: Vec<SharedConfig>,
    /// What makes the same app again in another process of this host: the file, the `--set` texts as given,
    /// and the chosen profiles.
    pub selection: Selection,
    /// The folder that relative paths of the app start from: that of its file.
    pub folder: PathBuf,
    /// Warnings; an app with errors is not made.
    pub warnings: Findings,
    pub(super) index: Index,
    pub(super) trail: Trail,
    pub(super) root: Node,
    pub(super) partial: bool,
}

/// Which clock an app runs on.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum TimeMode {
    /// The machine's clock; every chassis is a process.
    #[default]
    Real,
    /// One process on a virtual clock: as fast as the machine allows, and the same every time.
    Virtual,
}

/// Where an app's messages, phases, firings and log lines are recorded, and how much of them is kept.
#[derive(Debug, Clone, PartialEq)]
pub struct RecordConfig {
    /// The file as given, relative to the app's folder. Each process puts its name before the extension.
    pub file: PathBuf,
    /// A file that has grown to this size is closed and the next one begun, bytes.
    pub max_bytes: u64,
    /// So many files of a process are kept, the present one included.
    pub keep: usize,
    /// At most this much is lost when a process is killed.
    pub flush: Duration,
    /// What a processor may have waiting for the disk, bytes; what comes then is dropped and counted.
    pub buffer_bytes: usize,
    /// Which channels are written, in whose names `*` stands for any characters; none: all.
    pub channels: Vec<String>,
}

/// Another host, on which an agent waits for boots.
#[derive(Debug, Clone, PartialEq)]
pub struct HostConfig {
    /// Its symbolic name.
    pub name: String,
    /// Where its agent listens.
    pub agent: SocketAddr,
}

/// One process of an app.
#[derive(Debug, Clone, PartialEq)]
pub struct ChassisConfig {
    /// Its symbolic name.
    pub name: String,
    /// The host it lives on; `None` = that of the boot.
    pub host: Option<String>,
    /// The address at which the other chassis reach it; `None` = any free port of this host.
    pub listen: Option<SocketAddr>,
    /// Whether it is stopped before the others (hardware that must come to rest first).
    pub stop_first: bool,
    /// Whether its process starts when somebody looks for one of its tasks, and not with the app.
    pub start: Start,
    /// What happens when its process ends while the app runs.
    pub supervision: ChassisSupervision,
    /// Its processors, in declared order; never empty.
    pub processors: Vec<ProcessorConfig>,
    /// Where its name stands.
    pub place: Place,
}

impl ChassisConfig {
    /// Where one of its keys stands, else its name.
    pub(super) fn place_of(&self, root: &Node, key: &str) -> Place {
        let found = root.locate(&format!("chassis.\"{}\".{key}", self.name));
        found.unwrap_or_else(|| self.place.clone())
    }
}

impl HostConfig {
    /// Where the address of its agent stands.
    pub(super) fn agent_place(&self, root: &Node) -> Option<Place> {
        root.place_of(&format!("host.\"{}\".agent", self.name))
    }
}

/// What the boot does about a chassis that fails.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ChassisSupervision {
    /// When its process is started again, and how often; without restarts, or with too many, the app ends with it.
    pub restart: Policy,
    /// What a task that failed for good leads to.
    pub on_task_failure: OnTaskFailure,
}

impl Default for ChassisSupervision {
    fn default() -> Self {
        Self {
            restart: Policy {
                backoff: Duration::from_millis(500),
                ..Policy::default()
            },
            on_task_failure: OnTaskFailure::App,
        }
    }
}

/// What a task that failed for good leads to.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum OnTaskFailure {
    /// The end of the app.
    #[default]
    App,
    /// A restart of its chassis, under that chassis's policy.
    RestartChassis,
}

/// When the process of a chassis starts.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Start {
    /// With the app.
    #[default]
    Boot,
    /// When somebody looks for one of its tasks.
    OnDemand,
}

/// One thread of a chassis.
#[derive(Debug, Clone, PartialEq)]
pub struct ProcessorConfig {
    /// Its name, unique in its chassis.
    pub name: String,
    /// Whether it asks for the real-time scheduler (`SCHED_FIFO`).
    pub realtime: bool,
    /// Whether the app cannot run when the system refuses that.
    pub required: bool,
    /// Real-time priority, 1 to 99; `None` = the runtime chooses.
    pub priority: Option<u8>,
    /// The CPU it is pinned to, counted from 0.
    pub cpu: Option<usize>,
    /// The base period of its synchronous functions; `None` = they bring their own.
    pub period: Option<Duration>,
    /// What it does with ticks that it comes too late for.
    pub overrun: Overrun,
    /// How long it is awake and waits spinning: before a tick, and for messages before it sleeps; `None` =
    /// as long as suits its placement.
    pub spin: Option<Duration>,
    /// Where its name stands (the chassis's for the implicit `main`).
    pub place: Place,
}

impl ProcessorConfig {
    /// How long before a tick it wakes up and spins.
    #[must_use]
    pub fn lead(&self) -> Lead {
        match self.spin {
            Some(spin) => Lead::Fixed(spin),
            None if self.realtime => Lead::Learned,
            None => Lead::default(),
        }
    }
}

/// What the configuration says of a semaphore or a barrier.
#[derive(Debug, Clone, PartialEq)]
pub struct SharedConfig {
    /// Its name.
    pub name: String,
    /// Who shares it; `None` = its name says so.
    pub scope: Option<Scope>,
    /// How many permits a semaphore has, or how many must arrive at a barrier; `None` = as many as the tasks say.
    pub count: Option<u32>,
}

/// One instantiation of an event handler.
#[derive(Debug, Clone, PartialEq)]
pub struct TaskConfig {
    /// Its symbolic name.
    pub name: String,
    /// The handler's registered name.
    pub handler: String,
    /// Where the handler's name stands.
    pub handler_place: Place,
    /// The chassis it lives on.
    pub chassis: String,
    /// The processor of that chassis.
    pub processor: String,
    /// Where `on` stands.
    pub on_place: Place,
    /// How many messages wait at most.
    pub queue: usize,
    /// When it is restarted, and how often.
    pub restart: Policy,
    /// Whether its state survives its process.
    pub durable: bool,
    /// How long its handler may be at one message before a warning names it.
    pub handler_limit: Option<Duration>,
    /// Deadline of calls it makes, in place of the runtime's.
    pub call_deadline: Option<Duration>,
    /// `[task.NAME.args]`, for the handler; an empty table when there is none.
    pub args: Node,
    /// Where its name stands.
    pub place: Place,
}

impl App {
    /// The merged tree, for showing each value with its origin.
    #[must_use]
    pub fn root(&self) -> &Node {
        &self.root
    }

    /// Whether something of it could not be read. What it lacks may then be no mistake of the person.
    #[must_use]
    pub fn is_partial(&self) -> bool {
        self.partial
    }

    /// The names of what has been read for it so far: its configuration with `--set`, then the files that checks open.
    #[must_use]
    pub fn read_so_far(&self) -> BTreeSet<String> {
        let read = self.trail.read();
        let names = read.keys().map(|path| path.display().to_string());
        names.chain([SET.to_owned()]).collect()
    }

    /// The task of that name. Takes as long among many tasks as among few.
    #[must_use]
    pub fn task(&self, name: &str) -> Option<&TaskConfig> {
        let task = self.tasks.get(*self.index.tasks.all(name).first()?);
        task.filter(|task| task.name == name)
    }

    /// The tasks of an event handler, in declared order. The others are not looked at.
    pub fn tasks_with<'a>(&'a self, handler: &'a str) -> impl Iterator<Item = &'a TaskConfig> {
        let places = self.index.handlers.all(handler).iter();
        let tasks = places.filter_map(|place| self.tasks.get(*place));
        tasks.filter(move |task| task.handler == handler)
    }

    /// The tasks of a chassis, in declared order. Those of others are not looked at.
    pub fn tasks_on<'a>(&'a self, chassis: &'a str) -> impl Iterator<Item = &'a TaskConfig> {
        let places = self.index.homes.all(chassis).iter();
        let tasks = places.filter_map(|place| self.tasks.get(*place));
        tasks.filter(move |task| task.chassis == chassis)
    }

    /// The place of the chassis of that name in [`App::chassis`].
    #[must_use]
    pub fn place_of_chassis(&self, name: &str) -> Option<usize> {
        let place = *self.index.chassis.all(name).first()?;
        let chassis = self.chassis.get(place)?;
        (chassis.name == name).then_some(place)
    }

    /// The place of a key by its dotted path, for example `task.mcs.args.speed`. Tasks made by an
    /// expander are found too; their place is the one the expander gave.
    #[must_use]
    pub fn locate(&self, path: &str) -> Option<Place> {
        if let Some(place) = self.root.locate(path) {
            return Some(place);
        }
        let task = path.strip_prefix("task.")?;
        let (name, rest) = task.split_once('.').unwrap_or((task, ""));
        let task = self.task(name)?;
        match rest {
            "" | "handler" | "on" | "args" => Some(task.place.clone()),
            _ => task.args.locate(rest.strip_prefix("args.")?),
        }
    }

    /// The path of a data file of the app: in [`App::folder`]. If it is not there, the path is in the
    /// folder of a file that the app includes.
    #[must_use]
    pub fn file_at(&self, relative: impl AsRef<Path>) -> PathBuf {
        let own = self.folder.join(&relative);
        let folders = self.trail.folders.iter().filter(|_| !own.is_file());
        let mut paths = folders.map(|folder| folder.join(&relative));
        paths.find(|path| path.is_file()).unwrap_or(own)
    }

    /// Reads a data file of the app at [`App::file_at`]. Checks read files
    /// through this, so that a [`Bundle`](crate::Bundle) holds every file that the app needs.
    ///
    /// # Errors
    /// A finding without a place when the file cannot be read or is not UTF-8.
    pub fn read(&self, relative: impl AsRef<Path>) -> Result<Source, Finding> {
        let path = self.file_at(&relative);
        let source = Source::read(&path).map_err(|finding| finding.help(LOOKED_FOR))?;
        let read = Read {
            text: source.text().to_owned(),
            absolute: relative.as_ref().is_absolute(),
        };
        self.trail.read().insert(path, read);
        Ok(source)
    }

    /// Where a value of the tree [`App::root`] comes from.
    #[must_use]
    pub fn origin(&self, value: &Node) -> Origin {
        let Some(place) = value.place().cloned() else {
            return Origin::Default;
        };
        if place.source.name() == SET {
            return Origin::Set(place);
        }
        let mut profiles = self.trail.applied.iter().rev();
        match profiles.find(|profile| profile.value.holds(&place)) {
            Some(profile) => Origin::Profile {
                name: profile.key.clone(),
                place,
            },
            None => Origin::File(place),
        }
    }
}
