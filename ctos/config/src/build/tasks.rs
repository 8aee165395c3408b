//! The tasks of an app: those of `[task]` and those that the tables of others stand for.

use super::super::app::{ChassisConfig, TaskConfig};
use super::super::expander::{Expander, GeneratedTask};
use super::super::fields::{Fields, check_name};
use super::super::keys;
use super::super::node::{Entry, Node};
use super::super::policies::restart;
use super::{Builder, QUEUE};
use crate::diagnostic::{Finding, Place};
use crate::settings::Policy;

impl Builder<'_> {
    pub(super) fn tasks(&mut self, root: &Node, chassis: &[ChassisConfig]) -> Vec<TaskConfig> {
        let entries = self.named(root, "task");
        let read = entries.iter();
        read.filter_map(|entry| self.task(entry, chassis)).collect()
    }

    fn task(&mut self, entry: &Entry, chassis: &[ChassisConfig]) -> Option<TaskConfig> {
        let place = self.place_of(entry);
        let mut fields = Fields::named(entry, "task", keys::TASK, self.findings);
        let help = "add handler = \"NAME\", the handler that this task runs";
        let handler = fields.required("handler", help);
        let on = fields.required("on", "add on = \"CHASSIS\" or on = \"CHASSIS/PROCESSOR\"");
        let queue = fields.integer("queue").unwrap_or(QUEUE);
        let restart = restart(&mut fields);
        let call_deadline = fields.seconds("call_deadline_s");
        let handler_limit = fields.seconds("handler_limit_s");
        let args = fields.table("args").cloned();
        let args = args.unwrap_or_else(|| Node::table().placed(&place));
        let (handler, handler_place) = handler?;
        let (on, on_place) = on?;
        let (chassis, processor) = self.find_processor(on, &on_place, chassis)?;
        Some(TaskConfig {
            name: entry.key.clone(),
            handler: handler.to_owned(),
            handler_place,
            chassis,
            processor,
            on_place,
            queue,
            restart,
            handler_limit,
            call_deadline,
            args,
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
            let finding = Finding::error("ctos::config::unknown_chassis", text).at(place.clone());
            self.findings.push(if all.is_empty() {
                finding.help(format!("declare it: [chassis.{name}]"))
            } else {
                finding.suggest(name, all.iter().map(|chassis| chassis.name.as_str()))
            });
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

    pub(super) fn expand(
        &mut self,
        root: &Node,
        expanders: &[(&'static str, &dyn Expander)],
        chassis: &[ChassisConfig],
        tasks: &mut Vec<TaskConfig>,
    ) {
        for (table, expander) in expanders {
            let Some(entry) = root.entry(table) else {
                continue;
            };
            for generated in expander.expand(&entry.value, self.findings) {
                self.generated(generated, chassis, tasks);
            }
        }
    }

    fn generated(
        &mut self,
        task: GeneratedTask,
        chassis: &[ChassisConfig],
        tasks: &mut Vec<TaskConfig>,
    ) {
        let place = task.place;
        check_name("task", &task.name, &place, self.findings);
        if let Some(other) = tasks.iter().find(|other| other.name == task.name) {
            let (name, at) = (&task.name, &other.place);
            let text = format!(
                "a task called `{name}` is generated here, but `{name}` is declared at {at} already"
            );
            let finding =
                Finding::error("ctos::config::same_name", text).help("rename one of them");
            self.findings.push(finding.at(place));
            return;
        }
        let Some((chassis, processor)) = self.find_processor(&task.on, &place, chassis) else {
            return;
        };
        tasks.push(TaskConfig {
            name: task.name,
            handler: task.handler,
            handler_place: place.clone(),
            chassis,
            processor,
            on_place: place.clone(),
            queue: QUEUE,
            restart: Policy::default(),
            handler_limit: None,
            call_deadline: None,
            args: task.args.placed(&place),
            place,
        });
    }

    pub(super) fn idle_chassis(&mut self, chassis: &[ChassisConfig], tasks: &[TaskConfig]) {
        for one in chassis {
            // With errors, the task that belongs there may be the one that could not be read.
            let used = tasks.iter().any(|task| task.chassis == one.name);
            if !used && !self.findings.has_errors() {
                let text = format!("no task is on chassis `{}`", one.name);
                let finding = Finding::warning("ctos::config::idle_chassis", text);
                self.findings.push(finding.at(one.place.clone()));
            }
        }
    }

    /// `until` must name a task, also one that has other mistakes.
    pub(super) fn check_until(
        &mut self,
        until: &str,
        place: Place,
        root: &Node,
        tasks: &[TaskConfig],
    ) {
        let declared = root.tables("task");
        let names = || {
            let declared = declared.iter().map(|entry| entry.key.as_str());
            let made = tasks.iter().map(|task| task.name.as_str());
            declared.chain(made)
        };
        if !names().any(|name| name == until) {
            let text = format!("`until` waits for the task `{until}`, which does not exist");
            let finding = Finding::error("ctos::config::unknown_task", text);
            let mut known: Vec<_> = names().collect();
            known.sort_unstable();
            known.dedup();
            self.findings.push(finding.suggest(until, known).at(place));
        }
    }
}
