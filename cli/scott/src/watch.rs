//! `watch` and `trace`: what the daemons of an app are asked, and what a request leads to. What is wanted is picked out
//! by the daemons themselves, with an object of the class `watch` each.

use std::{process, sync::atomic::Ordering, time::Duration};

use serde_json::{Value, json};
use sorma::{Reply, watching::Seen, words};

use super::{
    attach::{App, Interrupted},
    backend::Backend,
};

/// How long a daemon waits for something to show before it says that there was nothing, s.
const WAIT_S: f64 = 0.5;

/// What `watch` shows.
#[derive(Debug, Clone, PartialEq)]
pub struct Wanted {
    /// Of which objects.
    pub objects: String,
    /// By which daemon; all of the app's when there is none.
    pub daemon: Option<String>,
    /// The options of class `watch` that this means.
    options: String,
    /// After so many it is over.
    pub count: Option<u64>,
    /// Beside the prompt.
    pub background: bool,
}

const FORM: &str = "write: watch PATTERN[@DAEMON] [--kind EXEC|CTRL|DBX] [--slower TIME] [--from PATTERN] [--failed] \
                    [--count N] [&], for example: watch foo.* --kind EXEC --slower 50ms";

impl Wanted {
    /// Reads what stands after `watch`.
    ///
    /// # Errors
    /// What is wrong, and what would have been right.
    pub fn read(rest: &str) -> Result<Self, String> {
        let found = words::split(rest).map_err(|error| error.to_string())?;
        let mut found = found.iter().map(|word| word.text.as_str());
        let pattern = found.next().ok_or(FORM)?;
        let (objects, daemon) = match pattern.split_once('@') {
            Some((objects, daemon)) => (objects, Some(daemon.to_owned())),
            None => (pattern, None),
        };
        if objects.starts_with('-') || objects.is_empty() {
            return Err(FORM.to_owned());
        }
        let mut wanted = Self {
            objects: objects.to_owned(),
            daemon,
            options: format!("-objects {}", words::word(objects)),
            count: None,
            background: false,
        };
        while let Some(word) = found.next() {
            let mut value = || {
                found
                    .next()
                    .ok_or(format!("after {word} stands a value; {FORM}"))
            };
            let option = match word {
                "--kind" => {
                    let kind = value()?;
                    if !["EXEC", "CTRL", "DBX"].contains(&kind) {
                        return Err(format!("--kind is EXEC, CTRL or DBX, not `{kind}`"));
                    }
                    format!("-method {kind}")
                }
                "--slower" => format!("-slower {:?}", seconds(value()?)?),
                "--from" => format!("-from {}", words::word(value()?)),
                "--failed" => "-failed".to_owned(),
                "--count" => {
                    let count = value()?;
                    let count = count.parse().ok().filter(|count| *count > 0);
                    wanted.count = Some(count.ok_or("--count is a whole number from 1 on")?);
                    continue;
                }
                "&" => {
                    wanted.background = true;
                    continue;
                }
                other => return Err(format!("`{other}` is no option of watch; {FORM}")),
            };
            wanted.options.push(' ');
            wanted.options.push_str(&option);
        }
        Ok(wanted)
    }
}

/// A time as a person writes it: `50ms`, `0.2s`, `3` (s).
fn seconds(text: &str) -> Result<f64, String> {
    let units = [("ms", 1e3), ("us", 1e6), ("s", 1.0)];
    let unit = units.iter().find(|(unit, _)| text.ends_with(unit));
    let (number, in_a_second) = match unit {
        Some((unit, most)) => (text.strip_suffix(unit).unwrap_or(text), *most),
        None => (text, 1.0),
    };
    let time = number
        .parse::<f64>()
        .ok()
        .map(|number| number / in_a_second);
    time.filter(|time| (0.0..=86_400.0).contains(time))
        .ok_or_else(|| format!("a time is written 50ms, 0.2s or 3, not `{text}`"))
}

/// Shows what daemons are asked until it is over, by its count or by Ctrl-C. `show` answers whether anybody still
/// reads.
///
/// # Errors
/// Why it cannot be shown.
pub fn watch(
    app: &mut App,
    wanted: &Wanted,
    number: u64,
    mut show: impl FnMut(&Seen) -> bool,
    mut say: impl FnMut(&str),
) -> Result<(), String> {
    let daemons = match &wanted.daemon {
        Some(daemon) if app.daemons().contains(daemon) => vec![daemon.clone()],
        Some(daemon) => {
            return Err(format!(
                "app `{}` has no daemon `{daemon}`; it has {}",
                app.name(),
                app.daemons().join(", ")
            ));
        }
        None => app.daemons().to_vec(),
    };
    let name = view_name(number);
    let order = format!("{name} CTRL {}", wanted.options);
    for daemon in &daemons {
        asked(app, daemon, &order)?;
    }
    let mut shown = 0;
    // One waits for all: the others are asked in between.
    let wait_s = WAIT_S / daemons.len() as f64;
    'watching: loop {
        for daemon in &daemons {
            let reply = match app.say(daemon, &format!("{name} EXEC next {wait_s}"), 0) {
                Err(Interrupted) => break 'watching,
                Ok(reply) => reply,
            };
            let (seen, lost) = match reply.and_then(|reply| answered(&reply)) {
                Ok(answer) => answer,
                Err(why) => {
                    say(&why);
                    if !back(app, &daemons, &order, &mut say) {
                        break 'watching;
                    }
                    continue 'watching;
                }
            };
            if lost > 0 {
                say(&format!(
                    "… {lost} requests were lost: they came faster than they were fetched"
                ));
            }
            for one in &seen {
                shown += 1;
                if !show(one) || wanted.count.is_some_and(|count| shown >= count) {
                    break 'watching;
                }
            }
        }
    }
    for daemon in &daemons {
        // It ends with the connection in any case.
        let _ = app.say(daemon, &format!("sorm CTRL -free {name}"), 0);
    }
    Ok(())
}

/// Waits until an app, or a chassis of it, is back, and watches it again. `false` on Ctrl-C.
fn back(app: &mut App, daemons: &[String], order: &str, say: &mut impl FnMut(&str)) -> bool {
    let (_never, pause) = std::sync::mpsc::channel::<()>();
    loop {
        if app.interrupt().swap(false, Ordering::Relaxed) {
            return false;
        }
        // Nothing is ever sent: this is a pause.
        let _ = pause.recv_timeout(Duration::from_millis(300));
        let is_back = daemons
            .iter()
            .all(|daemon| asked(app, daemon, order).is_ok());
        if is_back {
            say(&format!("app `{}` is watched again", app.name()));
            return true;
        }
    }
}

fn view_name(number: u64) -> String {
    format!("watch.scott-{}-{number}", process::id())
}

/// Has a line met that must not fail.
fn asked(app: &mut App, daemon: &str, line: &str) -> Result<Reply, String> {
    let reply = match app.say(daemon, line, 0) {
        Ok(reply) => reply?,
        Err(Interrupted) => return Err("cancelled".to_owned()),
    };
    good(&reply)
}

fn good(reply: &str) -> Result<Reply, String> {
    let reply: Reply = reply.parse().map_err(|error| format!("{error}"))?;
    if reply.body.is_ok() {
        return Ok(reply);
    }
    let reports = reply.body.reports.iter().map(ToString::to_string);
    Err(reports.collect::<Vec<_>>().join("; "))
}

/// What EXEC next of a watch answered: the requests, and how many were lost.
fn answered(reply: &str) -> Result<(Vec<Seen>, i64), String> {
    let reply = good(reply)?;
    let lines = reply.body.text.lines();
    let seen = lines.map(|line| serde_json::from_str(line).map_err(|error| error.to_string()));
    let lost = reply.body.ints.get(1).copied().unwrap_or(0);
    Ok((seen.collect::<Result<_, _>>()?, lost))
}

/// Has a request met and finds everything that it led to, on every daemon: its reply, and the calls in the order of
/// their beginnings.
///
/// # Errors
/// The user did not want to wait for it.
pub fn trace(
    backend: &mut Backend,
    request: &str,
    number: u64,
) -> Result<(String, Result<Vec<Seen>, String>), Interrupted> {
    let name = view_name(number);
    // Unlike those of any other tool at the same time.
    let id = (u64::from(process::id()) << 24) | (number & 0xff_ffff);
    let places: Vec<String> = match backend.daemons() {
        [] => vec![String::new()],
        daemons => daemons.iter().map(|daemon| format!("@{daemon}")).collect(),
    };
    let mut wrong = None;
    for place in &places {
        let order = format!("{name}{place} CTRL -trace {id} -capacity 100000");
        if let Err(why) = good(&backend.dispatch(&order, 0)?) {
            wrong = Some(why);
        }
    }
    let reply = backend.dispatch(request, id)?;
    let mut all = Vec::new();
    for place in &places {
        loop {
            let answer = backend.dispatch(&format!("{name}{place} EXEC next"), 0)?;
            match answered(&answer) {
                Ok((seen, _)) if seen.is_empty() => break,
                Ok((seen, _)) => all.extend(seen),
                Err(why) => {
                    wrong = Some(why);
                    break;
                }
            }
        }
        backend.dispatch(&format!("sorm{place} CTRL -free {name}"), 0)?;
    }
    all.sort_by(|a, b| {
        (a.at_s, a.depth)
            .partial_cmp(&(b.at_s, b.depth))
            .unwrap_or(std::cmp::Ordering::Equal)
    });
    Ok((reply, wrong.map_or(Ok(all), Err)))
}

/// A time for a person.
fn span(seconds: f64) -> String {
    let (number, unit) = match seconds {
        s if s < 1e-3 => (s * 1e6, "us"),
        s if s < 1.0 => (s * 1e3, "ms"),
        s => (s, "s"),
    };
    format!("{number:.1} {unit}")
}

/// A request with its reply and how long it took, on one line.
#[must_use]
pub fn line(seen: &Seen, answer: &str) -> String {
    let from = match seen.from.as_str() {
        "" => String::new(),
        from => format!("  from {from}"),
    };
    format!(
        "{:>12.6} s {:>9}  {}{} -> {answer}{from}",
        seen.at_s,
        span(seen.took_s),
        process_of(seen),
        seen.request,
    )
}

/// A call of a trace, indented as deep as it is nested; its time is since the beginning.
#[must_use]
pub fn nested_line(seen: &Seen, answer: &str, begin_s: f64) -> String {
    let indent = "  ".repeat(seen.depth as usize);
    format!(
        "{:>10} {:>9}  {indent}{}{} -> {answer}",
        format!("+{}", span((seen.at_s - begin_s).max(0.0))),
        span(seen.took_s),
        process_of(seen),
        seen.request,
    )
}

fn process_of(seen: &Seen) -> String {
    match seen.process.as_str() {
        "" => String::new(),
        process => format!("[{process}] "),
    }
}

/// The reply without the name, which the request has already.
#[must_use]
pub fn answer_of(seen: &Seen) -> &str {
    let rest = seen.reply.strip_prefix(seen.object.as_str());
    rest.unwrap_or(&seen.reply).trim_start()
}

/// The same for a program.
#[must_use]
pub fn as_json(seen: &Seen) -> Value {
    serde_json::to_value(seen).unwrap_or_else(|_| json!({}))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn watch_is_written_as_in_the_help() {
        let wanted =
            Wanted::read("arm.*@cage --kind EXEC --slower 50ms --from 'a b' --count 3 &").unwrap();
        assert_eq!(
            (wanted.objects.as_str(), wanted.daemon.as_deref()),
            ("arm.*", Some("cage"))
        );
        assert_eq!((wanted.count, wanted.background), (Some(3), true));
        assert_eq!(
            wanted.options,
            "-objects arm.* -method EXEC -slower 0.05 -from \"a b\""
        );
        for wrong in [
            "",
            "--kind EXEC",
            "a --kind",
            "a --kind exec",
            "a --slower x",
            "a --count 0",
            "a b",
            "'a",
        ] {
            assert!(Wanted::read(wrong).is_err(), "{wrong}");
        }
    }

    #[test]
    fn times_are_written_with_units() {
        assert_eq!(seconds("50ms"), Ok(0.05));
        assert_eq!(seconds("20us"), Ok(2e-5));
        assert_eq!(seconds("3s"), seconds("3"));
        assert!(seconds("-1").is_err() && seconds("soon").is_err() && seconds("NaN").is_err());
    }
}
