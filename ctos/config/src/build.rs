//! From the merged tree to the typed app: what every key means, and everything that can be wrong
//! with it by itself.
//!
//! Knows the tables `[app]`, `[time]`, `[chassis]` and `[task]`; `observe` those of recording and
//! metrics, `hosts` those of other hosts. Knows no handler: whether a
//! handler exists and takes its arguments is for the registry to say.

mod tasks;

use super::app::{
    App, BarrierConfig, ChassisConfig, HostConfig, ProcessorConfig, SemaphoreConfig, TimeMode,
};
use super::expander::Expander;
use super::fields::{Fields, FlagOr, check_name, unknown_key};
use super::hosts;
use super::keys;
use super::links;
use super::node::{Entry, Node};
use super::observe;
use super::policies::supervision;
use super::trail::Trail;
use super::zenoh;
use crate::diagnostic::{Finding, Findings, Place};
use crate::settings::{Overrun, Scope};
use std::net::SocketAddr;
use std::path::PathBuf;
use std::time::Duration;

const SEED: u64 = 1;
const PHASE_TIMEOUT: Duration = Duration::from_secs(20);
const STOP_TIMEOUT: Duration = Duration::from_secs(5);
const QUEUE: usize = 64;
const MAIN: &str = "main";
/// A task id has 8 bits for the chassis; 0 is the one that boots, 255 is kept for the runtime.
const MOST_CHASSIS: usize = 254;
/// A task id has 8 bits for the processor; 0 is the runtime's own.
const MOST_PROCESSORS: usize = 255;

/// Where an app came from.
#[derive(Clone)]
pub(super) struct Origin {
    pub(super) file: PathBuf,
    pub(super) sets: Vec<String>,
    pub(super) place: Place,
}

/// Makes the typed app. Errors go to `findings`; the result then still holds what could be read.
pub(super) fn build(
    root: Node,
    origin: Origin,
    expanders: &[(&'static str, &dyn Expander)],
    findings: &mut Findings,
) -> App {
    let mut builder = Builder {
        whole: origin.place,
        findings,
    };
    builder.top_level(&root, expanders);
    let chassis = builder.all_chassis(&root);
    let mut tasks = builder.tasks(&root, &chassis);
    builder.expand(&root, expanders, &chassis, &mut tasks);
    builder.idle_chassis(&chassis, &tasks);
    if tasks.is_empty() && !builder.findings.has_errors() {
        let finding = Finding::error("ctos::config::no_task", "this app has no task to run")
            .help("add [task.NAME] with handler = \"...\" and on = \"CHASSIS\"");
        builder.findings.push(finding.at(builder.whole.clone()));
    }
    let times = [("real", TimeMode::Real), ("virtual", TimeMode::Virtual)];
    let time = Fields::top(&root, keys::TIME, builder.findings).choice("mode", &times);
    let semaphores = builder.semaphores(&root);
    let barriers = builder.barriers(&root);
    let record = observe::record(Fields::top(&root, keys::RECORD, builder.findings));
    let metrics = observe::metrics(Fields::top(&root, keys::METRICS, builder.findings));
    let control = hosts::control(Fields::top(&root, keys::CONTROL, builder.findings));
    let hosts = builder.hosts(&root);
    let stem = origin.file.file_stem().map_or_else(
        || "app".to_owned(),
        |stem| stem.to_string_lossy().into_owned(),
    );
    let mut fields = Fields::top(&root, keys::APP, builder.findings);
    let name = fields
        .text("name")
        .map_or(stem, |(name, _)| name.to_owned());
    let seed = fields.integer("seed").unwrap_or(SEED);
    let phase_timeout = fields.seconds("phase_timeout_s").unwrap_or(PHASE_TIMEOUT);
    let stop_timeout = fields.seconds("stop_timeout_s").unwrap_or(STOP_TIMEOUT);
    let until = fields.text("until");
    let listen = fields.parsed::<SocketAddr>("listen", "an address such as \"192.168.1.10:0\"");
    let listen = listen.map(|listen| (listen, fields.place("listen")));
    let mut links = links::links(&mut fields);
    links.injury = links::injury(&root, &chassis, builder.findings);
    links.zenoh = zenoh::zenoh(&root, links.same_host, builder.findings);
    let security = links::security(&root, &chassis, builder.findings);
    let together = hosts::Together {
        root: &root,
        hosts: &hosts,
        chassis: &chassis,
        boot: &listen,
        control: &control,
        has_keys: security.is_some(),
    };
    together.check(builder.findings);
    let until = until.map(|(task, place)| {
        builder.check_until(task, place, &root, &tasks);
        task.to_owned()
    });
    let folder = match origin.file.parent() {
        Some(folder) if folder.as_os_str().is_empty() => PathBuf::from("."),
        Some(folder) => folder.to_owned(),
        None => PathBuf::from("."),
    };
    App {
        name,
        seed,
        until,
        phase_timeout,
        stop_timeout,
        time,
        links,
        security,
        record,
        metrics,
        listen: listen.map(|(listen, _)| listen),
        control: control.map(|(listen, _)| listen),
        hosts,
        chassis,
        tasks,
        semaphores,
        barriers,
        file: origin.file,
        profiles: Vec::new(),
        sets: origin.sets,
        folder,
        warnings: Findings::new(),
        trail: Trail::default(),
        root,
    }
}

struct Builder<'f> {
    /// The start of the main file, for findings about nothing in particular.
    whole: Place,
    findings: &'f mut Findings,
}

impl Builder<'_> {
    fn place_of(&self, entry: &Entry) -> Place {
        entry
            .key_place
            .clone()
            .unwrap_or_else(|| self.whole.clone())
    }

    fn top_level(&mut self, root: &Node, expanders: &[(&'static str, &dyn Expander)]) {
        for entry in root.entries() {
            let known = || {
                let extra = expanders.iter().map(|(table, _)| *table);
                keys::names(keys::TOP).chain(extra)
            };
            if !known().any(|table| table == entry.key) {
                self.findings
                    .push(unknown_key(entry, "at the top level", known()));
            }
        }
    }

    /// The named tables below `[chassis]` or `[task]`.
    fn named<'a>(&mut self, root: &'a Node, table: &str) -> &'a [Entry] {
        let Some(entry) = root.entry(table) else {
            return &[];
        };
        if !entry.value.is_table() {
            let text = format!("`{table}` holds named tables, found {}", entry.value.kind());
            let finding =
                Finding::error("ctos::config::value", text).help(format!("write [{table}.NAME]"));
            self.findings.push(finding.at(self.place_of(entry)));
        }
        for named in entry.value.entries() {
            let place = self.place_of(named);
            check_name(table, &named.key, &place, self.findings);
        }
        entry.value.entries()
    }

    fn hosts(&mut self, root: &Node) -> Vec<HostConfig> {
        let entries = self.named(root, "host").iter();
        let read = entries.filter_map(|entry| {
            let place = self.place_of(entry);
            hosts::host(entry, place, self.findings)
        });
        read.collect()
    }

    fn all_chassis(&mut self, root: &Node) -> Vec<ChassisConfig> {
        let entries = self.named(root, "chassis");
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
            self.findings.push(finding.at(self.place_of(first)));
        }
    }

    fn chassis(&mut self, entry: &Entry) -> ChassisConfig {
        let place = self.place_of(entry);
        let mut fields = Fields::named(entry, "chassis", keys::CHASSIS, self.findings);
        let host = fields.text("host").map(|(host, _)| host.to_owned());
        let listen = fields.parsed::<SocketAddr>("listen", "an address such as \"127.0.0.1:0\"");
        let stop_first = fields.flag("stop_first").unwrap_or(false);
        let supervision = supervision(&mut fields);
        let table = fields.table("processors");
        let named = table.map_or(&[][..], Node::entries);
        self.too_many(named, MOST_PROCESSORS, "a chassis", "processors");
        let mut processors: Vec<_> = named
            .iter()
            .map(|processor| self.processor(&entry.key, processor))
            .collect();
        if processors.is_empty() {
            processors.push(ProcessorConfig {
                name: MAIN.to_owned(),
                realtime: false,
                required: false,
                priority: None,
                cpu: None,
                period: None,
                overrun: Overrun::default(),
                spin: None,
                place: place.clone(),
            });
        }
        ChassisConfig {
            name: entry.key.clone(),
            host,
            listen,
            stop_first,
            supervision,
            processors,
            place,
        }
    }

    fn processor(&mut self, chassis: &str, entry: &Entry) -> ProcessorConfig {
        let place = self.place_of(entry);
        check_name("processor", &entry.key, &place, self.findings);
        let what = format!("processor `{chassis}/{}`", entry.key);
        let mut fields = Fields::new(Some(&entry.value), what, keys::PROCESSOR, self.findings);
        let realtime = fields.flag_or("realtime");
        let required = realtime == Some(FlagOr::Word);
        let realtime = required || realtime == Some(FlagOr::Flag(true));
        let priority = fields.integer("priority");
        let cpu = fields.integer("cpu");
        if priority.is_some() && !realtime {
            let text = "a priority without `realtime = true` has no effect";
            let finding = Finding::warning("ctos::config::no_effect", text);
            let finding = finding.at(fields.place("priority"));
            fields.push(finding);
        }
        let period = fields.seconds("period_s");
        let overruns = [
            ("skip", Overrun::Skip),
            ("run-late-once", Overrun::RunLateOnce),
            ("stop", Overrun::Stop),
        ];
        let overrun = fields.choice("overrun", &overruns);
        let spin = fields.integer("spin_us").map(Duration::from_micros);
        if let (Some(period), Some(spin)) = (period, spin)
            && spin > period / 2
        {
            let text = format!(
                "{} us of spinning are more than half of the period of {} s; the other tasks of the processor would starve",
                spin.as_micros(),
                period.as_secs_f64()
            );
            let finding = Finding::error("ctos::config::spin", text).at(fields.place("spin_us"));
            fields.push(finding);
        }
        ProcessorConfig {
            name: entry.key.clone(),
            realtime,
            required,
            priority,
            cpu,
            period,
            overrun,
            spin,
            place,
        }
    }

    fn semaphores(&mut self, root: &Node) -> Vec<SemaphoreConfig> {
        let entries = self.named(root, "semaphore").iter();
        let read = entries.map(|entry| {
            let mut fields = Fields::named(entry, "semaphore", keys::SEMAPHORE, self.findings);
            SemaphoreConfig {
                name: entry.key.clone(),
                scope: scope(&mut fields),
                permits: fields.integer("permits"),
                place: self.place_of(entry),
            }
        });
        read.collect()
    }

    fn barriers(&mut self, root: &Node) -> Vec<BarrierConfig> {
        let entries = self.named(root, "barrier").iter();
        let read = entries.map(|entry| {
            let mut fields = Fields::named(entry, "barrier", keys::BARRIER, self.findings);
            BarrierConfig {
                name: entry.key.clone(),
                scope: scope(&mut fields),
                parties: fields.integer("parties"),
                place: self.place_of(entry),
            }
        });
        read.collect()
    }
}

/// Who shares a semaphore or barrier.
fn scope(fields: &mut Fields<'_, '_>) -> Option<Scope> {
    fields.choice(
        "scope",
        &[("chassis", Some(Scope::Chassis)), ("app", Some(Scope::App))],
    )
}
