//! What the process that booted a running app answers, and the last lines of its log about a task: those of `ctos logs TASK`.

use std::{os::unix::process::parent_id, process, thread, time::Duration};

use ctos::control::{
    LogLine, Socket,
    protocol::{Answer, LogRequest, Request},
};
use tokio::sync::oneshot;

use cli_common::client::{self, Client, ClientError};

use super::wire::TaskLine;

/// So many lines are told.
const MOST: usize = 8;
/// How long the app may take to tell them.
const LIMIT: Duration = Duration::from_secs(1);

/// The lines about `task`, oldest first; none where the app was booted from another host.
pub(super) async fn about(task: &str) -> Vec<TaskLine> {
    let task = task.to_owned();
    let read = move |client: &mut Client| {
        let lines = logs(
            client,
            LogRequest {
                name: Some(task),
                last: Some(MOST),
                ..LogRequest::default()
            },
        )?;
        Ok(lines.iter().map(told).collect())
    };
    asked(read).await.unwrap_or_default()
}

/// What the process that booted the app answers; nothing where it does not, or booted it from another host.
pub(super) async fn asked<T: Send + 'static>(
    ask: impl FnOnce(&mut Client) -> Result<T, ClientError> + Send + 'static,
) -> Option<T> {
    let (tell, told) = oneshot::channel();
    // Its socket is read by a thread of its own, for that has to be waited for.
    let asking = thread::Builder::new()
        .name("display-log".to_owned())
        .spawn(move || {
            let client = booted().and_then(|app| Client::connect(app, LIMIT));
            tell.send(client.and_then(|mut client| ask(&mut client)).ok())
        });
    asking.ok()?;
    told.await.ok().flatten()
}

/// Lines of the log.
pub(super) fn logs(client: &mut Client, wanted: LogRequest) -> Result<Vec<LogLine>, ClientError> {
    client.ask(Request::Logs(wanted))?;
    let mut lines = Vec::new();
    while let Some(Answer::Log(line)) = client.read()? {
        lines.push(line);
    }
    Ok(lines)
}

/// Where the process listens that booted this chassis: the one that started this process, or this one.
fn booted() -> Result<Socket, ClientError> {
    let of = |pid: u32| client::find(Some(&pid.to_string()));
    of(parent_id()).or_else(|_| of(process::id()))
}

pub(super) fn told(line: &LogLine) -> TaskLine {
    // Since the start of the app; `as` ends at the largest number.
    let at_ns = (line.at_s.max(0.0) * 1e9) as u64;
    TaskLine::new(at_ns, line.level, said(&line.text))
}

/// What a line says, without its time and its level.
fn said(text: &str) -> &str {
    let is_time = |word: &str| word.parse::<f64>().is_ok();
    let is_level = |word: &str| ["TRACE", "DEBUG", "INFO", "WARN", "ERROR"].contains(&word);
    let text = text.trim();
    let text = match text.split_once(' ') {
        Some((word, rest)) if is_time(word) => rest.trim_start(),
        _ => text,
    };
    match text.split_once(' ') {
        Some((word, rest)) if is_level(word) => rest.trim_start(),
        _ => text,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_a_line_says_is_told_without_its_time_and_its_level() {
        let line = r#"     0.010  INFO pnt::firing: net="hello" phase="started""#;
        assert_eq!(said(line), r#"pnt::firing: net="hello" phase="started""#);
        assert_eq!(said("1.5 WARN late"), "late");
        let other = [
            "",
            "WARN",
            "3.5",
            "thread 'a' panicked",
            r#"{"level":"INFO"}"#,
        ];
        assert!(other.iter().all(|line| said(line) == *line));
    }
}
