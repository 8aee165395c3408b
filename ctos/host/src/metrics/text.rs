//! Metrics as Prometheus reads them: text exposition format 0.0.4. Names of tasks are labels, ids never.
//!
//! Ours, because `prometheus-client` (0.24) writes no summaries, and because it serves what one process counts: the
//! numbers here come from all chassis by message.

use std::fmt::Write;

use ctos_bootstrap::watch::{ChassisMetrics, CyclicMetrics, Quantiles};
use ctos_core::meter::bound_s;

/// A number of a task.
type OfTask<T> = fn(&ctos_bootstrap::watch::TaskMetrics) -> T;
/// A number of a synchronous function.
type OfCyclic<T> = fn(&CyclicMetrics) -> T;

/// A chassis and what it counts; `None` when it did not answer.
pub(super) type Answers = Vec<(String, Option<ChassisMetrics>)>;

struct Page(String);

impl Page {
    /// Begins a metric.
    fn metric(&mut self, name: &str, kind: &str, help: &str) {
        // A string takes all that is written to it.
        let _ = writeln!(self.0, "# HELP {name} {help}\n# TYPE {name} {kind}");
    }

    fn line(&mut self, name: &str, labels: &[(&str, &str)], value: impl std::fmt::Display) {
        self.0.push_str(name);
        for (index, (label, text)) in labels.iter().enumerate() {
            let before = if index == 0 { '{' } else { ',' };
            let _ = write!(self.0, "{before}{label}=\"{}\"", escaped(text));
        }
        if !labels.is_empty() {
            self.0.push('}');
        }
        let _ = writeln!(self.0, " {value}");
    }
}

fn escaped(text: &str) -> String {
    text.replace('\\', "\\\\")
        .replace('"', "\\\"")
        .replace('\n', "\\n")
}

/// The whole page. `uptime_s` is the time since the start of the app.
pub(super) fn page(uptime_s: f64, answers: &Answers) -> String {
    let mut page = Page(String::new());
    let name = "ctos_uptime_seconds";
    page.metric(name, "gauge", "Time since the start of the app.");
    page.line(name, &[], uptime_s);
    page.metric("ctos_up", "gauge", "Whether a chassis answers.");
    for (chassis, metrics) in answers {
        let up = u8::from(metrics.is_some());
        page.line("ctos_up", &[("chassis", chassis)], up);
    }
    let up = || answers.iter().filter_map(|(_, metrics)| metrics.as_ref());
    let tasks = || up().flat_map(|chassis| &chassis.tasks);
    let name = "ctos_messages_total";
    page.metric(name, "counter", "Messages that a handler has ended.");
    for task in tasks() {
        for count in &task.commands {
            for (result, value) in [("ok", count.ok), ("failed", count.failed)] {
                let labels = [
                    ("task", task.task.as_str()),
                    ("command", &count.command),
                    ("result", result),
                ];
                page.line(name, &labels, value);
            }
        }
    }
    let name = "ctos_handler_duration_seconds";
    page.metric(
        name,
        "histogram",
        "Time from the call of a handler to its end, waiting included.",
    );
    for task in tasks() {
        let mut seen = 0;
        let last = task.durations.len().saturating_sub(1);
        for (bucket, count) in task.durations.iter().enumerate() {
            seen += count;
            let bound = if bucket == last {
                "+Inf".to_owned()
            } else {
                bound_s(bucket).to_string()
            };
            let labels = [("task", task.task.as_str()), ("le", &bound)];
            page.line(&format!("{name}_bucket"), &labels, seen);
        }
        let labels = [("task", task.task.as_str())];
        page.line(&format!("{name}_sum"), &labels, task.busy_s);
        page.line(&format!("{name}_count"), &labels, seen);
    }
    let gauges: [(&str, &str, &str, OfTask<u64>); 3] = [
        (
            "ctos_queue_length",
            "gauge",
            "Messages that wait for a task.",
            |task| task.queue,
        ),
        (
            "ctos_queue_capacity",
            "gauge",
            "Messages that its queue holds, of each priority.",
            |task| task.capacity,
        ),
        (
            "ctos_restarts_total",
            "counter",
            "How often a handler was built anew.",
            |task| task.restarts,
        ),
    ];
    for (name, kind, help, value) in gauges {
        page.metric(name, kind, help);
        for task in tasks() {
            page.line(name, &[("task", &task.task)], value(task));
        }
    }
    let summaries: [(&str, &str, OfCyclic<Quantiles>); 2] = [
        (
            "ctos_cyclic_lateness_seconds",
            "How late a synchronous function began, since the start of the app.",
            |cyclic| cyclic.lateness,
        ),
        (
            "ctos_cyclic_duration_seconds",
            "How long it took, since the start of the app.",
            |cyclic| cyclic.duration,
        ),
    ];
    let cyclics = || up().flat_map(|chassis| &chassis.cyclics);
    for (name, help, quantiles) in summaries {
        page.metric(name, "summary", help);
        for cyclic in cyclics() {
            let of = quantiles(cyclic);
            let function = ("function", cyclic.function.as_str());
            for (quantile, value) in [("0.5", of.p50_s), ("0.99", of.p99_s), ("1", of.max_s)] {
                page.line(name, &[function, ("quantile", quantile)], value);
            }
            page.line(&format!("{name}_sum"), &[function], of.sum_s);
            page.line(&format!("{name}_count"), &[function], of.count);
        }
    }
    let counters: [(&str, &str, OfCyclic<u64>); 2] = [
        ("ctos_cyclic_missed_total", "Periods skipped.", |cyclic| {
            cyclic.missed
        }),
        (
            "ctos_cyclic_overruns_total",
            "Runs that lasted into the next base tick.",
            |cyclic| cyclic.overruns,
        ),
    ];
    for (name, help, value) in counters {
        page.metric(name, "counter", help);
        for cyclic in cyclics() {
            page.line(name, &[("function", &cyclic.function)], value(cyclic));
        }
    }
    let name = "ctos_link_bytes_total";
    page.metric(name, "counter", "Data of messages that went over a link.");
    for chassis in up() {
        for link in &chassis.links {
            for (direction, bytes) in [("out", link.bytes_out), ("in", link.bytes_in)] {
                let labels = [
                    ("chassis", chassis.chassis.as_str()),
                    ("peer", &link.peer),
                    ("direction", direction),
                ];
                page.line(name, &labels, bytes);
            }
        }
    }
    page.metric(
        "ctos_lint",
        "gauge",
        "What is probably not meant, while it lasts.",
    );
    for lint in up().flat_map(|chassis| &chassis.lints) {
        let code = lint.code.to_string();
        page.line("ctos_lint", &[("code", &code), ("task", &lint.task)], 1);
    }
    let name = "ctos_refused_total";
    page.metric(
        name,
        "counter",
        "Callers, and requests of tools, that were refused.",
    );
    for chassis in up() {
        page.line(name, &[("chassis", &chassis.chassis)], chassis.refused);
    }
    let name = "ctos_record_dropped_total";
    page.metric(name, "counter", "Events that could not be recorded.");
    for chassis in up() {
        if let Some(dropped) = chassis.unrecorded {
            page.line(name, &[("chassis", &chassis.chassis)], dropped);
        }
    }
    page.0
}
