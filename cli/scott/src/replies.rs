//! What a session writes of a reply: for people, or as JSON.

use std::time::Duration;

use serde_json::{Value, json};
use sorma::{Reply, Report};

/// A reply for people: its text as it stands, its numbers, and what was reported. Of an error nothing,
/// which is shown as such.
pub(crate) fn for_people(reply: &Reply) -> String {
    let body = &reply.body;
    if !body.is_ok() {
        return String::new();
    }
    let mut lines = Vec::new();
    if !body.text.is_empty() {
        lines.push(body.text.clone());
    }
    if !body.floats.is_empty() {
        let floats: Vec<String> = body
            .floats
            .iter()
            .map(|float| format!("{float:?}"))
            .collect();
        lines.push(format!("FMSG {} {}", floats.len(), floats.join(" ")));
    }
    if !body.ints.is_empty() {
        let ints: Vec<String> = body.ints.iter().map(ToString::to_string).collect();
        lines.push(format!("IMSG {} {}", ints.len(), ints.join(" ")));
    }
    if lines.is_empty() {
        lines.push("done".to_owned());
    }
    lines.extend(body.reports.iter().map(told));
    lines.join("\n")
}

/// A report for people, its text not indented deeper than needed.
pub(crate) fn told(report: &Report) -> String {
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
