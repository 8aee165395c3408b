//! From the checked tree to the typed app, and everything that can be wrong with it by itself.
//!
//! Knows the tables `[app]`, `[chassis]`, `[semaphore]` and `[barrier]`; those of tasks, links, hosts, records and
//! zenoh have files of their own. Knows no handler: whether one exists and takes its arguments is for the registry
//! to say.

mod tasks;

use super::app::{App, ChassisConfig, ProcessorConfig, SharedConfig};
use super::check::checked;
use super::expander::Expander;
use super::index::Index;
use super::keys::{self, TOP};
use super::node::{Entry, Node};
use super::policies::{restart, supervision};
use super::selection::Selection;
use super::trail::Trail;
use super::{hosts, links, observe};
use crate::diagnostic::{Finding, Findings, Place, Source};
use std::path::PathBuf;
use std::time::Duration;

/// A task id has 16 bits for the chassis; 0 is the one that boots, 65535 is kept for the runtime.
const MOST_CHASSIS: usize = 65_534;
/// A task id has 8 bits for the processor; 0 is the runtime's own.
const MOST_PROCESSORS: usize = 255;

/// Makes the typed app. Errors go to `findings`; the result then still holds what could be read.
pub(super) fn build(
    root: Node,
    selection: &Selection,
    trail: Trail,
    expanders: &[(&'static str, &dyn Expander)],
    findings: &mut Findings,
) -> App {
    let was_whole = !findings.has_errors();
    let extra: Vec<&str> = expanders.iter().map(|(table, _)| *table).collect();
    let mut root = checked(with_tables(root, expanders, findings), &extra, findings);
    // Under a table of another name may stand what is missing below.
    let known = |entry: &Entry| {
        extra.contains(&entry.key.as_str()) || keys::names(TOP).any(|name| name == entry.key)
    };
    let is_known = root.entries().iter().all(known);
    let file = &selection.file;
    let whole = root.place.clone();
    let whole = &whole.unwrap_or_else(|| Source::new(file.display().to_string(), "").at(0..0));
    let stem = file.file_stem().map(|stem| stem.to_string_lossy());
    if root.get("app.name").is_none()
        && let Some(app) = root.inner("app")
    {
        app.set("name", stem.as_deref().unwrap_or("app"));
    }
    let mut builder = Builder {
        whole,
        findings,
        partial: !(was_whole && is_known),
    };
    let chassis = builder.all_chassis(&root);
    let tasks = builder.tasks(&root, &chassis, expanders);
    let partial = builder.partial;
    let shared = |table: &str, count: &str| {
        let shared = root.tables(table).iter().map(|entry| SharedConfig {
            name: entry.key.clone(),
            scope: entry.value.read("scope"),
            count: entry.value.read(count),
        });
        shared.collect()
    };
    let folder = file
        .parent()
        .filter(|folder| !folder.as_os_str().is_empty());
    let app = App {
        name: root.read("app.name").unwrap_or_default(),
        seed: root.read("app.seed").unwrap_or_default(),
        until: root.read("app.until"),
        phase_timeout: root.seconds("app.phase_timeout_s").unwrap_or_default(),
        stop_timeout: root.seconds("app.stop_timeout_s").unwrap_or_default(),
        time: root.read("time.mode").unwrap_or_default(),
        links: links::links(&root, &chassis, builder.findings),
        security: links::security(&root),
        record: observe::record(&root, builder.findings),
        metrics: observe::metrics(&root, builder.findings),
        listen: root.read("app.listen"),
        control: root.read("control.listen"),
        hosts: hosts::hosts(&root, builder.findings),
        semaphores: shared("semaphore", "permits"),
        barriers: shared("barrier", "parties"),
        index: Index::of(
            chassis.iter().map(|one| one.name.as_str()),
            tasks
                .iter()
                .map(|one| [&one.name, &one.handler, &one.chassis].map(String::as_str)),
        ),
        chassis,
        tasks,
        folder: folder.map_or_else(|| PathBuf::from("."), PathBuf::from),
        selection: Selection {
            profiles: trail.applied.iter().map(|one| one.key.clone()).collect(),
            ..selection.clone()
        },
        warnings: Findings::new(),
        trail,
        root,
        partial,
    };
    app.check_tasks(whole, builder.findings);
    hosts::check(&app, builder.findings);
    app
}

/// The tree over the tables that others stand for.
fn with_tables(
    mut root: Node,
    expanders: &[(&'static str, &dyn Expander)],
    findings: &mut Findings,
) -> Node {
    for (table, expander) in expanders {
        if let Some(entry) = root.entry(table) {
            let mut under = expander.tables(&entry.value, findings);
            under.place.clone_from(&root.place);
            under.merge(root);
            root = under;
        }
    }
    root
}

struct Builder<'a> {
    /// The start of the main file, for findings about nothing in particular.
    whole: &'a Place,
    findings: &'a mut Findings,
    /// Something that is written is not in the app.
    partial: bool,
}

impl Entry {
    /// Where its key stands; a default stands nowhere.
    pub(super) fn place_or(&self, place: &Place) -> Place {
        self.key_place.as_ref().unwrap_or(place).clone()
    }
}

impl Builder<'_> {
    fn all_chassis(&mut self, root: &Node) -> Vec<ChassisConfig> {
        let entries = root.tables("chassis");
        self.too_many(entries, MOST_CHASSIS, "an app", "chassis");
        let chassis: Vec<_> = entries.iter().map(|entry| self.chassis(entry)).collect();
        for (index, one) in chassis.iter().enumerate() {
            let same = |other: &&ChassisConfig| {
                one.listen.is_some_and(|at| at.port() != 0) && other.listen == one.listen
            };
            if let Some(other) = chassis.iter().take(index).find(same) {
                let (other, own) = (&other.name, &one.name);
                let text = format!("chassis `{other}` and `{own}` listen at the same address");
                let finding = Finding::error("ctos::config::same_address", text).help(
                    "give each its own port, or leave `listen` out to have a free one chosen",
                );
                self.findings.push(finding.at(one.place_of(root, "listen")));
            }
        }
        chassis
    }

    /// Points at the first that a task id has no bits for.
    fn too_many(&mut self, entries: &[Entry], most: usize, whole: &str, parts: &str) {
        if let Some(first) = entries.get(most) {
            let count = entries.len();
            let text = format!("{whole} has room for {most} {parts}, and this is one of {count}");
            let finding = Finding::error("ctos::config::too_many", text)
                .help("put more tasks on one processor");
            self.findings.push(finding.at(first.key_place.clone()));
        }
    }

    fn chassis(&mut self, entry: &Entry) -> ChassisConfig {
        let (node, place) = (&entry.value, entry.place_or(self.whole));
        let processors = node.tables("processors");
        self.too_many(processors, MOST_PROCESSORS, "a chassis", "processors");
        let processors = processors.iter();
        ChassisConfig {
            name: entry.key.clone(),
            host: node.read("host"),
            listen: node.read("listen"),
            stop_first: node.read("stop_first").unwrap_or_default(),
            start: node.read("start").unwrap_or_default(),
            supervision: supervision(node, self.findings),
            processors: processors.map(|one| self.processor(one, &place)).collect(),
            place,
        }
    }

    fn processor(&mut self, entry: &Entry, chassis: &Place) -> ProcessorConfig {
        let node = &entry.value;
        // Beside `true` and `false` there is one word.
        let required = node.read::<String>("realtime").is_some();
        let realtime = required || node.read("realtime").unwrap_or_default();
        let priority = node.read("priority");
        if priority.is_some() && !realtime {
            let text = "a priority without `realtime = true` has no effect";
            let finding = Finding::warning("ctos::config::no_effect", text);
            self.findings.push(finding.at(node.place_of("priority")));
        }
        let period = node.seconds("period_s");
        let spin = node.read("spin_us").map(Duration::from_micros);
        if let (Some(period), Some(spin)) = (period, spin)
            && spin > period / 2
        {
            let text = format!(
                "{} us of spinning are more than half of the period of {} s; the other tasks of the processor would starve",
                spin.as_micros(),
                period.as_secs_f64()
            );
            let finding = Finding::error("ctos::config::spin", text);
            self.findings.push(finding.at(node.place_of("spin_us")));
        }
        ProcessorConfig {
            name: entry.key.clone(),
            realtime,
            required,
            priority,
            cpu: node.read("cpu"),
            period,
            overrun: node.read("overrun").unwrap_or_default(),
            spin,
            place: entry.place_or(chassis),
        }
    }
}
