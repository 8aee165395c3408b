//! What a session writes of a reply: for people, or as JSON.

use std::time::Duration;

use serde_json::{Value, json};
use sorma::{Reply, Report, describe::Layout};

use super::numbers;

/// A reply for people: its text as it stands, its numbers as `layout` names them, and what was reported. Of an error
/// nothing, which is shown as such.
pub(crate) fn for_people(reply: &Reply, layout: &Layout) -> String {
    let body = &reply.body;
    if !body.is_ok() {
        return String::new();
    }
    let mut lines = Vec::new();
    if !body.text.is_empty() {
        lines.push(body.text.clone());
    }
    lines.extend(numbers::floats(layout, &body.floats));
    lines.extend(numbers::ints(layout, &body.ints));
    if lines.is_empty() {
        lines.push("done".to_owned());
    }
    lines.extend(body.reports.iter().map(told));
    lines.join("\n")
}

/// A reply in short, after the name that everybody knows: for the lines of `trace` and `watch`.
pub(crate) fn brief(reply: &str) -> String {
    let Ok(reply) = reply.parse::<Reply>() else {
        return reply.to_owned();
    };
    let mut parts: Vec<String> = reply.body.reports.iter().map(told).collect();
    parts.retain(|_| !reply.body.is_ok());
    if reply.body.is_ok() {
        parts.push("ok".to_owned());
        parts.extend(Some(reply.body.text.replace('\n', " ")).filter(|text| !text.is_empty()));
        let none = Layout::default();
        parts.extend(numbers::floats(&none, &reply.body.floats));
        parts.extend(numbers::ints(&none, &reply.body.ints));
    }
    parts.join(" ")
}

/// A report for people, its text not indented deeper than needed. Where in our source it was said is nothing to them.
pub(crate) fn told(report: &Report) -> String {
    let report = Report {
        file: String::new(),
        ..report.clone()
    };
    report.to_string().replace('\n', "\n    ")
}

/// How long requests took.
pub(crate) struct Times {
    /// How often it was asked, if it was to be repeated.
    pub(crate) repeats: Option<usize>,
    pub(crate) least: Duration,
    pub(crate) median: Duration,
    pub(crate) longest: Duration,
}

impl Times {
    pub(crate) fn text(&self) -> String {
        let us = |time: Duration| format!("{:.3} us", time.as_secs_f64() * 1e6);
        match self.repeats {
            None => format!("# time {}", us(self.median)),
            Some(count) => format!(
                "# repeat {count}: min {}, median {}, max {}",
                us(self.least),
                us(self.median),
                us(self.longest)
            ),
        }
    }
}

/// A reply as one JSON object; floats that JSON does not have are texts as in the textual form.
pub(crate) fn as_json(reply: &Reply, times: Option<&Times>) -> Value {
    let float = |float: &f64| match serde_json::Number::from_f64(*float) {
        Some(number) => Value::Number(number),
        None => json!(format!("{float:?}").to_lowercase()),
    };
    let report = |report: &Report| {
        json!({
            "severity": report.severity.word(),
            "code": report.code,
            "text": report.text,
            "object": report.object,
            "process": report.process,
            "time_ns": report.time_ns,
            "file": report.file,
            "line": report.line,
        })
    };
    let body = &reply.body;
    let mut object = json!({
        "name": reply.name.to_string(),
        "ret": body.code,
        "text": body.text,
        "floats": body.floats.iter().map(float).collect::<Vec<_>>(),
        "ints": body.ints,
        "reports": body.reports.iter().map(report).collect::<Vec<_>>(),
    });
    if let (Some(times), Some(object)) = (times, object.as_object_mut()) {
        let us = |time: Duration| json!(time.as_secs_f64() * 1e6);
        let told = match times.repeats {
            None => us(times.median),
            Some(count) => json!({
                "count": count,
                "min": us(times.least),
                "median": us(times.median),
                "max": us(times.longest),
            }),
        };
        object.insert("time_us".to_owned(), told);
    }
    object
}
