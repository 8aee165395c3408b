//! What an app has that a net can name: its tasks, their commands, and the functions of its nets.

use std::{
    collections::{BTreeMap, BTreeSet},
    path::PathBuf,
};

use ctos::{
    config::Selection,
    diagnostic::Findings,
    registry::{Registry, Vocabulary},
};

use crate::ReadApp;

/// What can be offered beside the words of the text itself.
#[derive(Debug, Default)]
pub struct Offered {
    /// Commands of each task, with their help.
    pub tasks: BTreeMap<String, Vec<(String, String)>>,
    /// The functions of each net, which is called as its task is.
    pub functions: BTreeMap<String, Vocabulary>,
}

impl Offered {
    /// What the app of `file` offers; nothing where there is none.
    ///
    /// # Errors
    /// What is wrong with the configuration.
    pub fn of(app: Option<&PathBuf>, registry: &Registry, read: ReadApp) -> Result<Self, Findings> {
        let Some(file) = app else {
            return Ok(Self::default());
        };
        let app = read(&Selection {
            file: file.clone(),
            profiles: Vec::new(),
            sets: Vec::new(),
        })?;
        let shown = |command: &ctos::message::CommandInfo| {
            (command.name.to_owned(), command.doc.to_owned())
        };
        let tasks = app.tasks.iter().map(|task| {
            let commands = registry.commands_of(task, &app);
            (task.name.clone(), commands.iter().map(shown).collect())
        });
        let functions = app.tasks.iter().filter_map(|task| {
            let words = registry.kind(&task.handler)?.vocabulary(task);
            Some((task.name.clone(), words))
        });
        Ok(Self {
            tasks: tasks.collect(),
            functions: functions.collect(),
        })
    }

    /// The functions of one kind that a net may use; all that are known if it is none of the app's.
    pub fn functions(&self, net: Option<&str>, what: &str) -> BTreeSet<&str> {
        let own = net.and_then(|net| self.functions.get(net));
        let all = self.functions.values().filter(|_| own.is_none());
        let words = own
            .into_iter()
            .chain(all)
            .filter_map(|words| words.get(what));
        words.flatten().map(String::as_str).collect()
    }
}
