//! What the numbers of a record mean: names of tasks and commands, and what the data of these looks like.
//!
//! It stands in the file itself, at its beginning and wherever something has become known since. So
//! programs that do not know the app can read the file.

use std::{collections::BTreeMap, sync::Arc};

use serde::{Deserialize, Serialize};

use ctos_config::App;
use ctos_core::{chassis::BOOT_CHASSIS, registry::Registry, semaphore, system};
use ctos_message::{ChassisNumber, CommandInfo, SYSTEM_COMMANDS, Shape, Tid};

/// The member of the metadata that holds the glossary.
const MEMBER: &str = "json";

/// What is known of a command.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct Known {
    pub(crate) code: u16,
    pub(crate) name: String,
    pub(crate) request: Option<Shape>,
    pub(crate) reply: Option<Shape>,
}

/// Something that has become known, as it stands in a file.
#[derive(Debug, Clone, Serialize, Deserialize)]
enum News {
    /// The name of a task.
    Task(Tid, String),
    /// The commands that some tasks take; the first ones are those that all tasks take.
    Commands(Vec<Known>),
    /// The task of this name takes the commands with this place among all [`News::Commands`].
    Takes(String, usize),
}

/// What is known of the numbers of one app.
#[derive(Debug, Default)]
pub(crate) struct Glossary {
    tasks: BTreeMap<Tid, Arc<str>>,
    commands: Vec<Vec<Known>>,
    takes: BTreeMap<Arc<str>, usize>,
    /// All of it, in the order in which it has become known, for those who write it down.
    news: Vec<News>,
    /// From what `commands` were made, unless they were read.
    sources: Vec<Vec<CommandInfo>>,
}

impl Glossary {
    /// What is known of `app` before it runs. Each agent counts its tasks in the order of the
    /// configuration, so the ids of the tasks of other chassis are known here too.
    pub(crate) fn of(app: &App, registry: &Registry, runtime: &[CommandInfo]) -> Self {
        let mut all = Self::default();
        let system = [system::ALL, runtime, &semaphore::server::COMMANDS];
        all.commands(&system.concat());
        all.put(News::Task(system::TID_SERVER, "tidsvr".to_owned()));
        all.put(News::Task(system::BOOTSTRAP, "bootstrap".to_owned()));
        let mut agent = |number, chassis: &str| {
            let name = format!("agent@{chassis}");
            all.put(News::Task(system::agent_tid(number), name));
        };
        agent(0, BOOT_CHASSIS);
        for (number, chassis) in (1..=ChassisNumber::MAX).zip(&app.chassis) {
            agent(number, &chassis.name);
        }
        for (number, chassis) in (1..=ChassisNumber::MAX).zip(&app.chassis) {
            for (place, processor) in (1..=u8::MAX).zip(&chassis.processors) {
                let tasks = app.tasks_on(&chassis.name);
                let here = tasks.filter(|task| task.processor == processor.name);
                for (slot, task) in (0..).zip(here) {
                    all.name(Tid::new(number, place, slot), &task.name);
                }
            }
        }
        for task in &app.tasks {
            if registry.kind(&task.handler).is_some() {
                all.takes(&task.name, &registry.commands_of(task, app));
            }
        }
        all
    }

    fn put(&mut self, news: News) {
        match &news {
            News::Task(task, name) => {
                self.tasks.insert(*task, name.as_str().into());
            }
            News::Commands(commands) => self.commands.push(commands.clone()),
            News::Takes(name, place) => {
                self.takes.insert(name.as_str().into(), *place);
            }
        }
        self.news.push(news);
    }

    /// `task` is called `name` from now on.
    pub(crate) fn name(&mut self, task: Tid, name: &str) {
        // The tasks of the runtime have names that say where they are.
        if task.processor() > 0 && self.tasks.get(&task).is_none_or(|known| **known != *name) {
            self.put(News::Task(task, name.to_owned()));
        }
    }

    /// What the task `name` takes, which no configuration need declare.
    pub(crate) fn takes(&mut self, name: &str, commands: &[CommandInfo]) {
        if !self.takes.contains_key(name) {
            let place = self.commands(commands);
            self.put(News::Takes(name.to_owned(), place));
        }
    }

    /// The place of these commands.
    fn commands(&mut self, commands: &[CommandInfo]) -> usize {
        let place = self.sources.iter().position(|known| known == commands);
        place.unwrap_or_else(|| {
            let known = |command: &CommandInfo| Known {
                code: command.code,
                name: command.name.to_owned(),
                request: command.request.shape(),
                reply: command.reply.shape(),
            };
            self.put(News::Commands(commands.iter().map(known).collect()));
            self.sources.push(commands.to_vec());
            self.sources.len() - 1
        })
    }

    /// How much is known.
    pub(crate) fn len(&self) -> usize {
        self.news.len()
    }

    /// What has become known after the first `known` things, as metadata.
    pub(crate) fn page(&self, known: usize) -> BTreeMap<String, String> {
        let news = self.news.get(known..).unwrap_or(&[]);
        // News is text and numbers, all of which JSON can hold.
        let json = serde_json::to_string(news).unwrap_or_default();
        BTreeMap::from([(MEMBER.to_owned(), json)])
    }

    /// Adds a page. False when it cannot be read; what is in it stays without name then.
    pub(crate) fn add(&mut self, metadata: &BTreeMap<String, String>) -> bool {
        let news = metadata
            .get(MEMBER)
            .and_then(|json| serde_json::from_str::<Vec<News>>(json).ok());
        let read = news.is_some();
        news.into_iter().flatten().for_each(|news| self.put(news));
        read
    }

    /// The name of a task; its id when it has none that is known.
    pub(crate) fn task(&self, task: Tid) -> Arc<str> {
        let known = self.tasks.get(&task).cloned();
        known.unwrap_or_else(|| task.to_string().into())
    }

    /// What `task` takes under `code`.
    pub(crate) fn command(&self, task: &str, code: u16) -> Option<&Known> {
        let place = match code {
            SYSTEM_COMMANDS.. => 0,
            _ => *self.takes.get(task)?,
        };
        let mut among = self.commands.get(place)?.iter();
        among.find(|known| known.code == code)
    }

    /// Its name, or the code.
    pub(crate) fn command_name(&self, task: &str, code: u16) -> String {
        let known = self.command(task, code);
        known.map_or_else(|| format!("{code:#06x}"), |known| known.name.clone())
    }
}
