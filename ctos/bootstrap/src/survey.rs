//! What a chassis tells about its tasks without disturbing them. It is read from their records, so
//! that a busy or stuck task is seen as well as an idle one.

use crate::refusals::Refusals;
use ctos_core::{
    chassis::Chassis, last_messages::TaskLook, sync::CyclicStatistics, task_record::TaskRecord,
};
use ctos_message::Tid;
use ctos_record::Recorders;
use ctos_time::Instant;
use std::{collections::BTreeMap, sync::Arc, time::Duration};

pub use ctos_core::report::{Activity, ChassisReport, TaskReport};

/// Everything that is known of `chassis` now.
pub(crate) fn survey(chassis: &Chassis) -> ChassisReport {
    if let Some(here) = ctos_core::processor::Processor::here() {
        here.settle_calls();
    }
    let processors = chassis.processors.iter();
    let cyclic = cyclic_times(&chassis.cyclics());
    ChassisReport {
        pid: Some(std::process::id()),
        processors: processors.map(|(name, _)| name.clone()).collect(),
        records: Recorders::of(chassis).reports(),
        tasks: chassis
            .tasks()
            .iter()
            .filter(|task| task.tid.processor() > 0)
            .map(|task| (task.tid, report(chassis, task, &cyclic)))
            .collect(),
        refused: Refusals::of(chassis).count(),
    }
}

/// What the synchronous functions of each task have taken together.
fn cyclic_times(functions: &[(String, Arc<CyclicStatistics>)]) -> BTreeMap<String, Duration> {
    let mut times = BTreeMap::new();
    for (function, statistics) in functions {
        if let Some((task, _)) = function.rsplit_once('.') {
            *times.entry(task.to_owned()).or_insert(Duration::ZERO) += statistics.duration.sum();
        }
    }
    times
}

/// One of its tasks.
pub(crate) fn of_task(chassis: &Chassis, task: &TaskRecord) -> TaskReport {
    report(chassis, task, &cyclic_times(&chassis.cyclics()))
}

fn report(chassis: &Chassis, task: &TaskRecord, cyclic: &BTreeMap<String, Duration>) -> TaskReport {
    let (statistics, now) = (&task.statistics, chassis.clock.now());
    let seconds = |since: Instant| now.since(since).as_secs_f64();
    let counters = statistics.read();
    let config = chassis.app.task(&task.name);
    let handler = config.map_or_else(String::new, |config| config.handler.clone());
    let any = counters.handled > 0 || counters.began.is_some();
    let processor = chassis.processors.get(usize::from(task.tid.processor()));
    let cyclic = cyclic.get(&*task.name).copied().unwrap_or_default();
    let in_handler_s = counters.began.map(seconds);
    let [urgent, normal, waiting] = task.mailbox.lengths();
    let (_, capacity) = task.mailbox.depth();
    let waits = statistics.waits().map(|waits| waits.read(now));
    let waits = waits.unwrap_or_default();
    let at = statistics.at();
    let left = at.as_ref().and_then(|at| Some(at.until?.since(now)));
    TaskReport {
        name: task.name.to_string(),
        chassis: chassis.name().to_owned(),
        processor: processor.map_or_else(String::new, |(name, _)| name.clone()),
        pid: Some(std::process::id()),
        activity: match (waits.is_empty(), in_handler_s) {
            (false, _) => Activity::Waits,
            (true, Some(_)) => Activity::Busy,
            (true, None) => Activity::Idle,
        },
        phase: counters.phase,
        phase_s: statistics.phase_since().map_or(0.0, seconds),
        handled: counters.handled,
        failed: counters.failed,
        busy_s: (counters.busy + cyclic).as_secs_f64() + in_handler_s.unwrap_or(0.0),
        longest_s: counters.longest.as_secs_f64(),
        in_handler_s,
        command: any.then(|| command_name(task, counters.command)),
        handler,
        urgent: urgent as u64,
        queued: normal as u64,
        senders_waiting: waiting as u64,
        capacity: capacity as u64,
        restarts: counters.restarts,
        waits,
        left_s: left.map(|left| left.as_secs_f64()),
        at: at.map(|at| at.text),
    }
}

/// The name of a command, as far as it is known.
pub(crate) fn command_name(task: &TaskRecord, code: u16) -> String {
    let own = task.statistics.commands().iter();
    let mut all = own.chain(ctos_core::system::ALL);
    all.find(|command| command.code == code)
        .map_or_else(|| format!("{code:#06x}"), |command| command.name.to_owned())
}

/// How the task `tid` of `chassis` is.
pub(crate) fn seen(chassis: &Chassis, tid: Tid, without: &[u16]) -> Option<TaskLook> {
    let record = chassis.task(tid)?;
    let mut last = record.statistics.activity().recent.look(without);
    let task = of_task(chassis, &record);
    for message in &mut last {
        message.command = command_name(&record, message.code);
    }
    let until = record.statistics.at().and_then(|at| at.until);
    Some(TaskLook { task, until, last })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_synchronous_functions_take_is_the_time_of_their_task() {
        let function = |name: &str, millis: u64| {
            let statistics = CyclicStatistics::default();
            statistics.duration.record(Duration::from_millis(millis));
            (name.to_owned(), Arc::new(statistics))
        };
        let functions = [
            function("arm.servo", 3),
            function("arm.guard", 4),
            function("arm.left.servo", 9),
        ];
        let times = cyclic_times(&functions);
        let expected = [("arm", 7), ("arm.left", 9)];
        let expected =
            expected.map(|(task, millis)| (task.to_owned(), Duration::from_millis(millis)));
        assert_eq!(times, BTreeMap::from(expected));
    }
}
