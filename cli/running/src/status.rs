//! `ctos status`.

use clap::Args;
use ctos::{
    control::protocol::{Activity, Answer, ChassisView, Request, StatusView, TaskView},
    record::RecordReport,
};

use cli_common::{
    exit,
    remote::{self, RemoteArgs, log_text},
    show, table,
};

use crate::ps;

/// A handler that has kept its processor for so long is not expected to give it back, s.
const STUCK_S: f64 = 5.0;

/// Show everything about one task or chassis on one screen
///
/// Its state and since when, its process, what it has done, what is in its queue, what it waits for, and the last
/// lines of its log and of the logs of the processes before it. Without a name: as `ctos ps`.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  ctos status motion
  ctos status cage_motion --json")]
pub struct StatusArgs {
    /// Name of the task or chassis
    pub name: Option<String>,
    /// Which app
    #[command(flatten)]
    pub remote: RemoteArgs,
    /// Print one JSON object
    #[arg(long)]
    pub json: bool,
}

/// Runs the command.
#[must_use]
pub fn run(args: &StatusArgs) -> u8 {
    let Some(name) = &args.name else {
        return ps::run(&ps::PsArgs {
            remote: args.remote.clone(),
            json: args.json,
        });
    };
    let mut client = match args.remote.connect() {
        Ok(client) => client,
        Err(error) => return remote::failed(&error),
    };
    let request = Request::Status { name: name.clone() };
    let status = match client.get(request) {
        Ok(Answer::Status(status)) => status,
        Ok(_) => {
            show::say("error: the app answers something else; is it of another version?");
            return exit::UNREACHABLE;
        }
        Err(error) => return remote::failed_for(&[name], &error),
    };
    let shown = if args.json {
        serde_json::to_string(&status).unwrap_or_default()
    } else {
        let option = args.remote.option(client.app());
        lines(&status, name, &option, table::width()).join("\n")
    };
    // A reader that went away has what it wanted.
    let _ = show::data(&shown);
    exit::OK
}

fn lines(status: &StatusView, name: &str, option: &str, width: usize) -> Vec<String> {
    let chassis = &status.chassis;
    let mut lines = Vec::new();
    match status.tasks.first().filter(|_| status.is_task) {
        Some(task) => {
            let place = format!("{}/{}", task.chassis, task.processor);
            lines.push(format!("{name} · {} on {place}", task.handler));
            lines.push(String::new());
            lines.extend(task_lines(task, chassis));
        }
        None => {
            lines.push(format!("{name} · chassis of {}", status.app));
            lines.push(String::new());
            lines.extend(chassis_lines(chassis, &status.tasks));
        }
    }
    lines.extend(log_lines(status));
    lines.push(String::new());
    lines.push(format!("follow its log   ctos logs {name} -f{option}"));
    lines.push(format!(
        "restart it       ctos restart {}{option}",
        restartable(status, name)
    ));
    lines
        .iter()
        .map(|line| table::fitted(line, width))
        .collect()
}

/// What is to be restarted so that `name` is: a handler that keeps its processor cannot be built anew.
fn restartable<'a>(status: &'a StatusView, name: &'a str) -> &'a str {
    let mut tasks = status.tasks.iter().filter(|_| status.is_task);
    let is_stuck = |task: &TaskView| {
        task.activity == Activity::Busy && task.in_handler_s.is_some_and(|time| time > STUCK_S)
    };
    match tasks.any(is_stuck) {
        true => &status.chassis.name,
        false => name,
    }
}

fn line(title: &str, text: impl AsRef<str>) -> String {
    format!("  {title:<9} {}", text.as_ref())
}

fn process(chassis: &ChassisView) -> String {
    let pid = match chassis.pid {
        Some(pid) => pid.to_string(),
        None => "none".to_owned(),
    };
    let answers = if chassis.answers {
        ""
    } else {
        ", does not answer"
    };
    format!(
        "{pid}, of chassis {}{}: {} for {}{answers}",
        chassis.name,
        chassis
            .host
            .as_ref()
            .map_or_else(String::new, |host| format!(" on host {host}")),
        chassis.state,
        remote::span(chassis.since_s)
    )
}

fn restarts(chassis: &ChassisView) -> Option<String> {
    let last = chassis.last_end.as_ref()?;
    let times = match chassis.restarts {
        1 => "once".to_owned(),
        times => format!("{times} times"),
    };
    Some(line(
        "restarted",
        format!("{times}; the process before this one {last}"),
    ))
}

fn task_lines(task: &TaskView, chassis: &ChassisView) -> Vec<String> {
    let mut lines = vec![line("does", remote::does(task))];
    // Whom it waits for hides what it says itself.
    if task.activity == Activity::Waits
        && let Some(at) = &task.at
    {
        lines.push(line("says", at.clone()));
    }
    for wait in task.waits.iter().skip(1) {
        let time = remote::span(wait.for_s);
        lines.push(line(
            "",
            format!("waits {time} for {}: {}", wait.to, wait.command),
        ));
    }
    if let Some(phase) = task.phase {
        let time = remote::span(task.phase_s);
        lines.push(line("phase", format!("{phase}, for {time}")));
    }
    lines.push(line("process", process(chassis)));
    lines.extend(restarts(chassis));
    let last = task
        .command
        .as_ref()
        .map_or_else(String::new, |command| format!(", last {command}"));
    lines.push(line(
        "messages",
        format!("{} handled, {} failed{last}", task.handled, task.failed),
    ));
    if task.phase_s > 0.0 {
        let busy = (100.0 * task.busy_s / task.phase_s).min(100.0);
        let longest = task.longest_s;
        lines.push(line(
            "busy",
            format!("{busy:.0} % of the time, longest {longest:.3} s"),
        ));
    }
    lines.push(line(
        "queue",
        format!(
            "{} urgent, {} normal of {}; {} senders wait for room",
            task.urgent, task.queued, task.capacity, task.senders_waiting
        ),
    ));
    if task.restarts > 0 {
        lines.push(line(
            "handler",
            format!("built anew {} times", task.restarts),
        ));
    }
    lines
}

fn record_lines(record: &RecordReport) -> Vec<String> {
    let size = remote::size(record.bytes);
    let mut lines = vec![line("record", format!("{size} in {}", record.file))];
    let trouble = record.trouble.as_ref();
    let trouble = trouble.map(|why| format!("nothing is written: {why}"));
    let lost = (record.lost > 0).then(|| format!("{} events are lost", record.lost));
    let lacks: Vec<String> = trouble.into_iter().chain(lost).collect();
    if !lacks.is_empty() {
        lines.push(line("", lacks.join("; ")));
    }
    lines
}

fn chassis_lines(chassis: &ChassisView, tasks: &[TaskView]) -> Vec<String> {
    let mut lines = vec![line("process", process(chassis))];
    lines.extend(restarts(chassis));
    if !chassis.processors.is_empty() {
        lines.push(line("threads", chassis.processors.join(", ")));
    }
    lines.extend(chassis.records.iter().flat_map(record_lines));
    let rows: Vec<Vec<String>> = tasks
        .iter()
        .map(|task| {
            vec![
                format!("  {}", task.name),
                task.processor.clone(),
                task.handled.to_string(),
                remote::does(task),
            ]
        })
        .collect();
    let columns = [
        table::left("  TASK"),
        table::left("ON"),
        table::right("HANDLED"),
        table::left("DOES"),
    ];
    lines.push(String::new());
    lines.extend(table::lines(&columns, &rows, usize::MAX));
    lines
}

fn log_lines(status: &StatusView) -> Vec<String> {
    let mut lines = Vec::new();
    let present = status.logs.last().map(|log| log.incarnation);
    for log in &status.logs {
        let earlier = Some(log.incarnation) != present;
        if earlier && log.lines.is_empty() {
            continue;
        }
        lines.push(String::new());
        let pid = log
            .pid
            .map_or_else(String::new, |pid| format!(" (pid {pid})"));
        lines.push(match (earlier, log.lines.is_empty()) {
            (true, _) => format!("  last lines of process {}{pid}", log.incarnation),
            (false, true) => "  nothing in its log".to_owned(),
            (false, false) => "  last lines of its log".to_owned(),
        });
        lines.extend(log.lines.iter().map(|line| format!("  {}", log_text(line))));
    }
    lines
}
