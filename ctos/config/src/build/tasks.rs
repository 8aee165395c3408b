//! The tasks of an app: those of `[task]` and those that the tables of others stand for.

use super::super::app::{App, ChassisConfig, TaskConfig};
use super::super::check::check_name;
use super::super::expander::{Expander, GeneratedTask};
use super::super::node::{Entry, Node};
use super::{Builder, restart};
use crate::diagnostic::{Finding, Findings, Place, nearest};
use crate::settings::{Policy, is_name};
use std::collections::BTreeSet;

const QUEUE: usize = 64;

impl Builder<'_> {
    pub(super) fn tasks(
        &mut self,
        root: &Node,
        chassis: &[ChassisConfig],
        expanders: &[(&'static str, &dyn Expander)],
    ) -> Vec<TaskConfig> {
        let written = root.tables("task");
        let read = written.iter();
        let mut tasks: Vec<_> = read.filter_map(|entry| self.task(entry, chassis)).collect();
        self.partial |= tasks.len() < written.len();
        for (table, expander) in expanders {
            if let Some(entry) = root.entry(table) {
                let mut found = Findings::new();
                for generated in expander.expand(&entry.value, &mut found) {
                    let task = self.generated(generated, chassis, &tasks);
                    self.partial |= task.is_none();
                    tasks.extend(task);
                }
                self.partial |= found.has_errors();
                self.findings.extend(found);
            }
        }
        tasks
    }

    fn task(&mut self, entry: &Entry, chassis: &[ChassisConfig]) -> Option<TaskConfig> {
        let (node, place) = (&entry.value, entry.place_or(self.whole));
        let idle = "where nothing is restarted";
        let restart = restart(node, Policy::default(), idle, self.findings);
        let on_place = node.place_of("on")?;
        let on = node.get("on")?.as_str()?;
        let found = self.find_processor(on, &on_place, chassis);
        // Whatever else is wrong with it is found at once, as if it were where it was probably meant to be.
        let (chassis, processor) = found.unwrap_or_else(|| self.meant(on, chassis));
        let args = node.get("args").cloned();
        Some(TaskConfig {
            name: entry.key.clone(),
            handler: node.read("handler")?,
            handler_place: node.place_of("handler")?,
            chassis,
            processor,
            on_place,
            queue: node.read("queue").unwrap_or(QUEUE),
            restart,
            durable: node.get("state").and_then(Node::as_str) == Some("durable"),
            handler_limit: node.seconds("handler_limit_s"),
            call_deadline: node.seconds("call_deadline_s"),
            args: args.unwrap_or_else(|| Node::table().placed(&place)),
            place,
        })
    }

    /// Resolves `CHASSIS` or `CHASSIS/PROCESSOR`; a colon will do, as for `ctos move`.
    fn find_processor(
        &mut self,
        on: &str,
        place: &Place,
        all: &[ChassisConfig],
    ) -> Option<(String, String)> {
        let (name, processor) = match on.split_once(['/', ':']) {
            Some((name, processor)) => (name, Some(processor)),
            None => (on, None),
        };
        let Some(chassis) = all.iter().find(|chassis| chassis.name == name) else {
            let text = format!("there is no chassis `{name}`");
            let finding = Finding::error("ctos::config::unknown_chassis", text)
                .help(format!("declare it: [chassis.{name}]"))
                .suggest(name, all.iter().map(|chassis| chassis.name.as_str()));
            self.findings.push(finding.at(place.clone()));
            return None;
        };
        let names = || chassis.processors.iter().map(|known| known.name.as_str());
        let found = match processor {
            None => names().next(),
            Some(wanted) => names().find(|known| *known == wanted),
        };
        if found.is_none() {
            let wanted = processor.unwrap_or_default();
            let text = format!("chassis `{name}` has no processor `{wanted}`");
            let finding =
                Finding::error("ctos::config::unknown_processor", text).suggest(wanted, names());
            self.findings.push(finding.at(place.clone()));
        }
        found.map(|found| (chassis.name.clone(), found.to_owned()))
    }

    /// The chassis and processor that were probably meant by an unknown one.
    fn meant(&mut self, on: &str, all: &[ChassisConfig]) -> (String, String) {
        let (name, _) = on.split_once(['/', ':']).unwrap_or((on, ""));
        let meant = nearest(name, all.iter().map(|chassis| chassis.name.as_str()));
        let chassis = all.iter().find(|one| Some(one.name.as_str()) == meant);
        let processor = chassis.and_then(|chassis| chassis.processors.first());
        match (chassis, processor) {
            (Some(chassis), Some(processor)) => (chassis.name.clone(), processor.name.clone()),
            _ => {
                self.partial = true;
                (on.to_owned(), String::new())
            }
        }
    }

    fn generated(
        &mut self,
        task: GeneratedTask,
        chassis: &[ChassisConfig],
        tasks: &[TaskConfig],
    ) -> Option<TaskConfig> {
        let place = task.place;
        let node = Node::table().with("handler", task.handler);
        let node = node.with("on", task.on).with("args", task.args);
        let entry = Entry {
            key: task.name,
            key_place: Some(place.clone()),
            value: node.placed(&place),
        };
        // What stands for a task at another site is called `TASK@SITE`.
        let parts = entry.key.split_once('@');
        if !parts.is_some_and(|(task, site)| is_name(task) && is_name(site)) {
            check_name("task", &entry, self.findings);
        }
        if let Some(other) = tasks.iter().find(|other| other.name == entry.key) {
            let (name, at) = (&other.name, &other.place);
            let text = format!(
                "a task called `{name}` is generated here, but `{name}` is declared at {at} already"
            );
            let finding = Finding::error("ctos::config::same_name", text);
            let finding = finding.help("rename one of them");
            self.findings.push(finding.at(place));
            return None;
        }
        self.task(&entry, chassis)
    }
}

impl App {
    /// Whether there are tasks, everywhere where a chassis is, and the one that `until` names.
    pub(super) fn check_tasks(&self, whole: &Place, findings: &mut Findings) {
        for one in &self.chassis {
            // With errors, the task that belongs there may be the one that could not be read.
            let used = self.tasks.iter().any(|task| task.chassis == one.name);
            if !used && !findings.has_errors() {
                let text = format!("no task is on chassis `{}`", one.name);
                let finding = Finding::warning("ctos::config::idle_chassis", text);
                findings.push(finding.at(one.place.clone()));
            }
        }
        if self.tasks.is_empty() && !findings.has_errors() {
            let finding = Finding::error("ctos::config::no_task", "this app has no task to run")
                .help("add [task.NAME] with handler = \"...\" and on = \"CHASSIS\"");
            findings.push(finding.at(whole.clone()));
        }
        let Some(until) = &self.until else { return };
        // One that has other mistakes is meant, too.
        let declared = self.root.tables("task").iter().map(|entry| &entry.key);
        let known = declared.chain(self.tasks.iter().map(|task| &task.name));
        let known: BTreeSet<&str> = known.map(String::as_str).collect();
        if !known.contains(until.as_str()) {
            let text = format!("`until` waits for the task `{until}`, which does not exist");
            let finding = Finding::error("ctos::config::unknown_task", text).suggest(until, known);
            findings.push(finding.at(self.root.place_of("app.until")));
        }
    }
}
