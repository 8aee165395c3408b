//! What a chassis counts, as Prometheus reads it: a command of its agent, asked by the chassis that boots.
//!
//! Names of tasks are labels, ids never. The text is ours, because `prometheus-client` (0.24) writes no summaries. It
//! also serves what one process counts: these numbers come from all chassis by message.

use crate::refusals::Refusals;
use ctos_core::{
    chassis::Chassis,
    meter::{CommandCount, bound_s},
    sync::{CyclicStatistics, Histogram},
    task_record::TaskRecord,
};
use ctos_message::{command, frame::Counts};
use ctos_record::Recorders;
use serde::{Deserialize, Serialize};
use std::{
    collections::BTreeMap,
    fmt::{Display, Write},
};

command! {
    /// Asks for all that a chassis counts.
    pub struct Gather => Metrics, 0xff80, "gather"
}

/// All metrics, in the order of the page: name, type, help.
const FAMILIES: &str = "\
ctos_uptime_seconds gauge Time since the start of the app.
ctos_up gauge Whether a chassis answers.
ctos_messages_total counter Messages that a handler has ended.
ctos_handler_duration_seconds histogram Time from the call of a handler to its end, waiting included.
ctos_queue_length gauge Messages that wait for a task.
ctos_queue_capacity gauge Messages that its queue holds, of each priority.
ctos_restarts_total counter How often a handler was built anew.
ctos_cyclic_lateness_seconds summary How late a synchronous function began, since the start of the app.
ctos_cyclic_duration_seconds summary How long it took, since the start of the app.
ctos_cyclic_missed_total counter Periods skipped.
ctos_cyclic_overruns_total counter Runs that lasted into the next base tick.
ctos_link_bytes_total counter Data of messages that went over a link.
ctos_lint gauge What is probably not meant, while it lasts.
ctos_refused_total counter Callers, and requests of tools, that were refused.
ctos_record_dropped_total counter Events that could not be recorded.
";

/// Samples, as lines of the text exposition format 0.0.4, by the name of their metric.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Metrics(BTreeMap<String, String>);

impl Metrics {
    /// Adds a sample of the metric `name`; `suffix` is what its own name ends in besides.
    fn add(&mut self, name: &str, suffix: &str, labels: &[(&str, &str)], value: impl Display) {
        let lines = self.0.entry(name.to_owned()).or_default();
        let mut text = String::new();
        for (label, value) in labels {
            let value = value.replace('\\', "\\\\").replace('"', "\\\"");
            let value = value.replace('\n', "\\n");
            let before = if text.is_empty() { '{' } else { ',' };
            // A string takes all that is written to it, here and below.
            let _ = write!(text, "{before}{label}=\"{value}\"");
        }
        let end = if text.is_empty() { "" } else { "}" };
        let _ = writeln!(lines, "{name}{suffix}{text}{end} {value}");
    }

    fn commands(&mut self, task: &str, counts: &[CommandCount]) {
        for count in counts {
            for (result, value) in [("ok", count.ok), ("failed", count.failed)] {
                let command = ("command", count.command.as_str());
                let labels = [("task", task), command, ("result", result)];
                self.add("ctos_messages_total", "", &labels, value);
            }
        }
    }

    /// The times of a task's handler, by bucket.
    fn durations(&mut self, task: &str, counts: &[u64], sum_s: f64) {
        let (name, task) = ("ctos_handler_duration_seconds", ("task", task));
        let mut seen = 0;
        for (bucket, count) in counts.iter().enumerate() {
            seen += count;
            let bound = match bucket + 1 == counts.len() {
                true => "+Inf".to_owned(),
                false => bound_s(bucket).to_string(),
            };
            self.add(name, "_bucket", &[task, ("le", &bound)], seen);
        }
        self.add(name, "_sum", &[task], sum_s);
        self.add(name, "_count", &[task], seen);
    }

    fn task(&mut self, task: &TaskRecord) {
        let counters = task.statistics.read();
        let (commands, durations) = task.statistics.counts();
        let (queue, capacity) = task.mailbox.depth();
        self.commands(&task.name, &commands);
        self.durations(&task.name, &durations, counters.busy.as_secs_f64());
        let label = [("task", &*task.name)];
        self.add("ctos_queue_length", "", &label, queue);
        self.add("ctos_queue_capacity", "", &label, capacity);
        self.add("ctos_restarts_total", "", &label, counters.restarts);
    }

    fn summary(&mut self, name: &str, function: &str, times: &Histogram) {
        let function = ("function", function);
        let quantile = |quantile| times.quantile(quantile).as_secs_f64();
        let max = times.max().as_secs_f64();
        for (of, value) in [("0.5", quantile(0.5)), ("0.99", quantile(0.99)), ("1", max)] {
            self.add(name, "", &[function, ("quantile", of)], value);
        }
        self.add(name, "_sum", &[function], times.sum().as_secs_f64());
        self.add(name, "_count", &[function], times.count());
    }

    fn cyclic(&mut self, name: &str, counted: &CyclicStatistics) {
        self.summary("ctos_cyclic_lateness_seconds", name, &counted.lateness);
        self.summary("ctos_cyclic_duration_seconds", name, &counted.duration);
        let label = [("function", name)];
        self.add("ctos_cyclic_missed_total", "", &label, counted.missed());
        self.add("ctos_cyclic_overruns_total", "", &label, counted.overruns());
    }

    fn link(&mut self, ends: &[(&str, &str); 2], counts: Counts) {
        let [here, peer] = *ends;
        for (direction, bytes) in [("out", counts.bytes_out), ("in", counts.bytes_in)] {
            let labels = [here, peer, ("direction", direction)];
            self.add("ctos_link_bytes_total", "", &labels, bytes);
        }
    }
}

/// What this chassis counts now.
pub fn gather_here(chassis: &Chassis) -> Metrics {
    let mut metrics = Metrics::default();
    let tasks = chassis.tasks();
    // The tasks of the runtime are not the app's; the first processor is theirs.
    for task in tasks.iter().filter(|task| task.tid.processor() > 0) {
        metrics.task(task);
    }
    for (function, counted) in chassis.cyclics() {
        metrics.cyclic(&function, &counted);
    }
    let here = ("chassis", chassis.name());
    for (peer, counts) in chassis.link_counts() {
        metrics.link(&[here, ("peer", &peer)], counts);
    }
    for lint in super::lints(chassis) {
        let labels = [("code", &*lint.code.to_string()), ("task", &lint.task)];
        metrics.add("ctos_lint", "", &labels, 1);
    }
    let refused = Refusals::of(chassis).count();
    metrics.add("ctos_refused_total", "", &[here], refused);
    if let Some(dropped) = Recorders::of(chassis).dropped() {
        metrics.add("ctos_record_dropped_total", "", &[here], dropped);
    }
    metrics
}

/// The page of an app that was started `uptime_s` ago, s: what its chassis count, nothing where one does not answer.
pub fn page(uptime_s: f64, chassis: &[(String, Option<Metrics>)]) -> String {
    let mut own = Metrics::default();
    own.add("ctos_uptime_seconds", "", &[], uptime_s);
    for (name, answer) in chassis {
        let up = u8::from(answer.is_some());
        own.add("ctos_up", "", &[("chassis", name)], up);
    }
    let mut page = String::new();
    for family in FAMILIES.lines() {
        let mut words = family.splitn(3, ' ');
        let mut word = || words.next().unwrap_or_default();
        let (name, kind, help) = (word(), word(), word());
        let _ = writeln!(page, "# HELP {name} {help}\n# TYPE {name} {kind}");
        let answers = chassis.iter().filter_map(|(_, answer)| answer.as_ref());
        let samples = [&own].into_iter().chain(answers);
        page.extend(
            samples
                .filter_map(|one| one.0.get(name))
                .map(String::as_str),
        );
    }
    page
}

#[cfg(test)]
mod tests;
