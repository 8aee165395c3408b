//! What the numbers in a file mean: names of tasks and commands, and what the data of these looks like.
//!
//! It stands in the file itself, at its beginning and wherever something has become known since, so that a
//! file can be read by programs that do not know the app.

use std::{collections::BTreeMap, sync::Arc};

use serde::{Deserialize, Serialize};

use crate::names::{Names, News};
use ctos_message::{CommandInfo, SYSTEM_COMMANDS, Shape, Tid};

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

impl Known {
    fn new(command: &CommandInfo) -> Self {
        Self {
            code: command.code,
            name: command.name.to_owned(),
            request: command.request.shape(),
            reply: command.reply.shape(),
        }
    }
}

/// A part of a glossary, as it stands in a file.
#[derive(Debug, Default, Serialize, Deserialize)]
struct Page {
    /// Names by task ids.
    tasks: Vec<(u32, String)>,
    /// By the names of tasks, what they take: a place in `commands`.
    takes: Vec<(String, usize)>,
    commands: Vec<Vec<Known>>,
    /// What all tasks take.
    system: Vec<Known>,
}

/// What `names` knows after the first `known` things, as metadata, and how much that is in all. `None` when
/// nothing is new.
pub(crate) fn page(names: &Names, known: usize) -> Option<(BTreeMap<String, String>, usize)> {
    let news = names.news(known);
    if news.is_empty() {
        return None;
    }
    let mut page = Page::default();
    if known == 0 {
        page.system = names.system().iter().map(Known::new).collect();
    }
    let mut kinds: Vec<&[CommandInfo]> = Vec::new();
    for one in &news {
        match one {
            News::Task(tid, name) => page.tasks.push((tid.bits(), name.to_string())),
            News::Takes(name, commands) => {
                let place = kinds.iter().position(|kind| *kind == commands.as_slice());
                let place = place.unwrap_or_else(|| {
                    kinds.push(commands);
                    page.commands
                        .push(commands.iter().map(Known::new).collect());
                    kinds.len() - 1
                });
                page.takes.push((name.to_string(), place));
            }
        }
    }
    // What is told is text and numbers: nothing of it cannot be written.
    let json = serde_json::to_string(&page).unwrap_or_default();
    let metadata = BTreeMap::from([(MEMBER.to_owned(), json)]);
    Some((metadata, known + news.len()))
}

/// The glossary of a file, as far as it has been read.
#[derive(Debug, Default)]
pub(crate) struct Glossary {
    tasks: BTreeMap<Tid, Arc<str>>,
    takes: BTreeMap<Arc<str>, Arc<Vec<Known>>>,
    system: Vec<Known>,
}

impl Glossary {
    /// Adds a page. False when it cannot be read; what is in it stays without name then.
    pub(crate) fn add(&mut self, metadata: &BTreeMap<String, String>) -> bool {
        let page = metadata
            .get(MEMBER)
            .and_then(|json| serde_json::from_str::<Page>(json).ok());
        let Some(page) = page else {
            return false;
        };
        for (tid, name) in page.tasks {
            self.tasks.insert(Tid::from_bits(tid), name.into());
        }
        let commands: Vec<_> = page.commands.into_iter().map(Arc::new).collect();
        for (name, place) in page.takes {
            if let Some(commands) = commands.get(place) {
                self.takes.insert(name.into(), commands.clone());
            }
        }
        self.system.extend(page.system);
        true
    }

    /// The name of a task; its id when it has none that is known.
    pub(crate) fn task(&self, task: Tid) -> Arc<str> {
        let known = self.tasks.get(&task).cloned();
        known.unwrap_or_else(|| task.to_string().into())
    }

    /// What `task` takes under `code`.
    pub(crate) fn command(&self, task: &str, code: u16) -> Option<&Known> {
        let among = if code >= SYSTEM_COMMANDS {
            &self.system
        } else {
            &**self.takes.get(task)?
        };
        among.iter().find(|known| known.code == code)
    }
}
