//! What the numbers of a record mean: tasks by their ids, commands by their codes.

use std::{
    collections::BTreeMap,
    sync::{Arc, Mutex},
};

use ctos_config::App;
use ctos_core::{chassis::BOOT_CHASSIS, names, registry::Registry, semaphore, system};
use ctos_message::{CommandInfo, SYSTEM_COMMANDS, Tid};
use ctos_time::lock::lock;

/// Names of tasks and commands, for one app.
#[derive(Debug)]
pub(crate) struct Names {
    tasks: Mutex<BTreeMap<Tid, Arc<str>>>,
    commands: Mutex<BTreeMap<Arc<str>, Vec<CommandInfo>>>,
    system: Vec<CommandInfo>,
    /// All that has become known, in order, for those who write it down.
    news: Mutex<Vec<News>>,
}

/// Something that has become known.
#[derive(Debug, Clone)]
pub(crate) enum News {
    /// The name of a task.
    Task(Tid, Arc<str>),
    /// What the task of a name takes.
    Takes(Arc<str>, Vec<CommandInfo>),
}

impl Names {
    /// What is known of `app` before it runs: each agent counts its tasks in the order of the
    /// configuration, so that the ids of the tasks of other chassis are known here too.
    pub(crate) fn new(app: &App, registry: &Registry, runtime: &[CommandInfo]) -> Self {
        let mut tasks: BTreeMap<Tid, Arc<str>> = BTreeMap::new();
        tasks.insert(system::TID_SERVER, "tidsvr".into());
        tasks.insert(system::BOOTSTRAP, "bootstrap".into());
        tasks.insert(system::agent_tid(0), format!("agent@{BOOT_CHASSIS}").into());
        let mut commands = BTreeMap::new();
        for (number, chassis) in (1_u8..).zip(&app.chassis) {
            let agent = format!("agent@{}", chassis.name);
            tasks.insert(system::agent_tid(number), agent.into());
            for (place, processor) in (1_u8..).zip(&chassis.processors) {
                let here = app.tasks.iter().filter(|task| {
                    task.chassis == chassis.name && task.processor == processor.name
                });
                for (slot, task) in (0_u16..).zip(here) {
                    tasks.insert(Tid::new(number, place, slot), task.name.as_str().into());
                }
            }
        }
        for task in &app.tasks {
            if let Some(kind) = registry.kind(&task.handler) {
                commands.insert(task.name.as_str().into(), kind.commands().to_vec());
            }
        }
        let mut all = system::ALL.to_vec();
        all.extend(runtime);
        all.extend(names::COMMANDS);
        all.extend(semaphore::server::COMMANDS);
        let named = tasks
            .iter()
            .map(|(tid, name)| News::Task(*tid, name.clone()));
        let taken = commands.iter();
        let taken = taken.map(|(name, takes): (&Arc<str>, &Vec<CommandInfo>)| {
            News::Takes(name.clone(), takes.clone())
        });
        Self {
            news: Mutex::new(named.chain(taken).collect()),
            tasks: Mutex::new(tasks),
            commands: Mutex::new(commands),
            system: all,
        }
    }

    /// `task` is called `name` from now on.
    pub(crate) fn name(&self, task: Tid, name: &Arc<str>) {
        // The tasks of the runtime have names that say where they are.
        if task.processor() > 0 {
            let before = lock(&self.tasks).insert(task, name.clone());
            if before.as_ref() != Some(name) {
                lock(&self.news).push(News::Task(task, name.clone()));
            }
        }
    }

    /// What the task `name` takes, which no configuration need declare.
    pub(crate) fn takes(&self, name: &Arc<str>, commands: &[CommandInfo]) {
        let mut all = lock(&self.commands);
        all.entry(name.clone()).or_insert_with(|| {
            lock(&self.news).push(News::Takes(name.clone(), commands.to_vec()));
            commands.to_vec()
        });
    }

    /// What has become known after the first `known`.
    pub(crate) fn news(&self, known: usize) -> Vec<News> {
        lock(&self.news).get(known..).unwrap_or(&[]).to_vec()
    }

    /// What all tasks take.
    pub(crate) fn system(&self) -> &[CommandInfo] {
        &self.system
    }

    /// The name of a task; its id when it has none that is known.
    pub(crate) fn task(&self, task: Tid) -> Arc<str> {
        let known = lock(&self.tasks).get(&task).cloned();
        known.unwrap_or_else(|| task.to_string().into())
    }

    /// The id of a task.
    pub(crate) fn tid(&self, name: &str) -> Option<Tid> {
        let tasks = lock(&self.tasks);
        let found = tasks.iter().find(|(_, known)| ***known == *name);
        found.map(|(tid, _)| *tid)
    }

    /// What `task` takes under `code`.
    pub(crate) fn command(&self, task: &str, code: u16) -> Option<CommandInfo> {
        let find = |among: &[CommandInfo]| {
            let mut among = among.iter();
            among.find(|command| command.code == code).copied()
        };
        if code >= SYSTEM_COMMANDS {
            find(&self.system)
        } else {
            find(lock(&self.commands).get(task)?)
        }
    }
}
