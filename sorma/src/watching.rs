//! Watching: which requests the objects of a process get, and what they answer, as long as there is a watcher.
//! The class `watch` does so from anywhere by lines of text.
//!
//! What is wanted is picked out here, at the source: whatever a watcher does not want is neither kept nor sent. Each
//! watcher has a buffer of its own, which drops the oldest when nobody fetches, so that no object ever waits for
//! one. While nobody watches, a call pays for one look at a counter. Calls through a [`Claim`](crate::Claim) are
//! not seen: they are as bare as a virtual call.

pub(crate) mod object;

use crate::report::Report;
use crate::request::{Method, Reply, Request};
use crate::transport::Transport;
use ctos::time::{Clock, Instant};
use parking_lot::{Mutex, RwLock};
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Weak};
use std::time::Duration;
use tokio::sync::Notify;

pub use crate::transport::Trace;

/// The name of the class.
const CLASS: &str = "watch";
/// A text or a list that is longer is cut in what a watcher gets.
const MOST_TEXT: usize = 400;
const MOST_NUMBERS: usize = 64;

/// A request that was met, with its reply.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Seen {
    /// When it began, s of the app's time.
    pub at_s: f64,
    /// How long it took, s.
    pub took_s: f64,
    /// The process that met it.
    pub process: String,
    /// The object, by its local name.
    pub object: String,
    /// EXEC, CTRL or DBX.
    pub method: String,
    /// Who asked; empty for a call inside the process.
    pub from: String,
    /// The request that it belongs to; 0 when nobody follows it.
    pub trace: u64,
    /// How deep it is nested in that.
    pub depth: u32,
    /// The return code.
    pub code: i32,
    /// The request as text, shortened.
    pub request: String,
    /// The reply as text, shortened.
    pub reply: String,
}

/// Which requests somebody wants to see.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Filter {
    objects: String,
    method: String,
    from: String,
    slower_s: f64,
    failed: bool,
    trace: i64,
}

impl Default for Filter {
    fn default() -> Self {
        Self {
            objects: "*".to_owned(),
            method: "any".to_owned(),
            from: "*".to_owned(),
            slower_s: 0.0,
            failed: false,
            trace: 0,
        }
    }
}

impl Filter {
    /// The part of the filter that can be decided before the request is met.
    fn wants(&self, object: &str, method: &str, io: &Transport) -> bool {
        let trace = u64::try_from(self.trace).unwrap_or(0);
        (trace == 0 || trace == io.trace.id)
            && (self.method == "any" || self.method == method)
            && matches(&self.objects, object)
            && matches(&self.from, &io.from)
    }

    /// The part that can be decided only afterwards.
    fn wants_result(&self, took: Duration, io: &Transport) -> bool {
        took.as_secs_f64() >= self.slower_s && (!self.failed || !io.is_ok())
    }
}

/// Whether a name fits a pattern, in which `*` stands for any characters. Linear but for the number of stars.
pub(crate) fn matches(pattern: &str, name: &str) -> bool {
    let mut parts = pattern.split('*');
    let first = parts.next().unwrap_or_default();
    let Some(mut rest) = name.strip_prefix(first) else {
        return false;
    };
    let mut last = None;
    for part in parts {
        if let Some(middle) = last.replace(part) {
            match rest.find(middle) {
                Some(at) => rest = rest.get(at + middle.len()..).unwrap_or_default(),
                None => return false,
            }
        }
    }
    match last {
        None => rest.is_empty(),
        Some(end) => rest.ends_with(end),
    }
}

/// What waits to be fetched.
#[derive(Debug, Default)]
struct Kept {
    lines: VecDeque<Seen>,
    lost: u64,
}

/// Somebody who watches.
#[derive(Debug)]
pub(crate) struct Watcher {
    filter: RwLock<Filter>,
    capacity: AtomicUsize,
    kept: Mutex<Kept>,
    news: Notify,
}

impl Watcher {
    fn new(capacity: usize) -> Self {
        Self {
            filter: RwLock::default(),
            capacity: AtomicUsize::new(capacity),
            kept: Mutex::default(),
            news: Notify::new(),
        }
    }

    fn take(&self, seen: Seen) {
        let mut kept = self.kept.lock();
        while kept.lines.len() >= self.capacity.load(Ordering::Relaxed).max(1) {
            kept.lines.pop_front();
            kept.lost += 1;
        }
        kept.lines.push_back(seen);
        drop(kept);
        self.news.notify_one();
    }

    /// Everything since the last time, and how many were lost before it.
    fn fetch(&self, most: usize) -> (Vec<Seen>, u64) {
        let mut kept = self.kept.lock();
        let count = most.min(kept.lines.len());
        let lines = kept.lines.drain(..count).collect();
        (lines, std::mem::take(&mut kept.lost))
    }

    fn is_empty(&self) -> bool {
        self.kept.lock().lines.is_empty()
    }
}

/// All who watch the objects of a process.
#[derive(Debug, Default)]
pub(crate) struct Watchers {
    count: AtomicUsize,
    all: RwLock<Vec<Weak<Watcher>>>,
}

/// A request that is being met and watched.
pub(crate) struct Begun {
    at: Instant,
    /// What is known of it so far.
    seen: Seen,
    /// Those who want it, by what can be decided so far.
    by: Vec<Arc<Watcher>>,
}

impl Watchers {
    fn add(&self, watcher: &Arc<Watcher>) {
        let mut all = self.all.write();
        all.retain(|one| one.strong_count() > 0);
        all.push(Arc::downgrade(watcher));
        self.count.store(all.len(), Ordering::Relaxed);
    }

    fn sweep(&self) {
        let mut all = self.all.write();
        all.retain(|one| one.strong_count() > 0);
        self.count.store(all.len(), Ordering::Relaxed);
    }

    /// Notes that a request is about to be met; `None` when nobody wants to know.
    #[inline]
    pub(crate) fn begin(
        &self,
        clock: &Clock,
        object: &str,
        method: Method,
        io: &Transport,
    ) -> Option<Begun> {
        if self.count.load(Ordering::Relaxed) == 0 {
            return None;
        }
        self.note(clock, object, method, io)
    }

    #[cold]
    fn note(&self, clock: &Clock, object: &str, method: Method, io: &Transport) -> Option<Begun> {
        // A watcher of everything does not want to see its own requests.
        if object.split('.').next() == Some(CLASS) {
            return None;
        }
        let word = method.to_string();
        let all = self.all.read();
        let by: Vec<Arc<Watcher>> = all
            .iter()
            .filter_map(Weak::upgrade)
            .filter(|one| one.filter.read().wants(object, &word, io))
            .collect();
        // One that was freed by the very request that it watched was still held then.
        let has_gone = all.iter().any(|one| one.strong_count() == 0);
        drop(all);
        if has_gone {
            self.sweep();
        }
        if by.is_empty() {
            return None;
        }
        let at = clock.now();
        let seen = Seen {
            at_s: at.since_start().as_secs_f64(),
            took_s: 0.0,
            process: String::new(),
            object: object.to_owned(),
            method: word,
            from: io.from.clone(),
            trace: io.trace.id,
            depth: io.trace.depth,
            code: 0,
            request: request_text(object, method, io),
            reply: String::new(),
        };
        Some(Begun { at, seen, by })
    }
}

impl Begun {
    /// The request was met in `process`: `io` is the reply.
    pub(crate) fn end(mut self, process: &str, now: Instant, io: &Transport) {
        let took = now - self.at;
        self.by
            .retain(|watcher| watcher.filter.read().wants_result(took, io));
        if self.by.is_empty() {
            return;
        }
        let seen = &mut self.seen;
        process.clone_into(&mut seen.process);
        (seen.took_s, seen.code) = (took.as_secs_f64(), io.code);
        seen.reply = reply_text(&seen.object, io);
        for watcher in &self.by {
            watcher.take(seen.clone());
        }
    }
}

/// A body that is short enough to be shown, and what it leaves out.
fn shortened(io: &Transport) -> Transport {
    let mut end = io.text.len().min(MOST_TEXT);
    while !io.text.is_char_boundary(end) {
        end -= 1;
    }
    let mut text = io.text.get(..end).unwrap_or_default().to_owned();
    if end < io.text.len() {
        text.push('…');
    }
    let floats = io.floats.iter().take(MOST_NUMBERS).copied().collect();
    let ints = io.ints.iter().take(MOST_NUMBERS).copied().collect();
    let mut reports: Vec<Report> = io.reports.iter().take(8).cloned().collect();
    let left = [
        ("floats", io.floats.len().saturating_sub(MOST_NUMBERS)),
        ("whole numbers", io.ints.len().saturating_sub(MOST_NUMBERS)),
        ("opaque bytes", io.opaque.len()),
        ("reports", io.reports.len().saturating_sub(8)),
    ];
    let left: Vec<String> = left
        .iter()
        .filter(|(_, count)| *count > 0)
        .map(|(what, count)| format!("{count} {what} not shown"))
        .collect();
    if !left.is_empty() {
        reports.push(Report::message(left.join(", ")));
    }
    Transport {
        text,
        floats,
        ints,
        reports,
        code: io.code,
        ..Transport::default()
    }
}

/// A request as text; empty where it has none.
fn request_text(object: &str, method: Method, io: &Transport) -> String {
    let name = object.parse().ok();
    let body = shortened(io);
    let request = name.map(|name| Request { name, method, body });
    let text = request.and_then(|request| request.to_text().ok());
    text.unwrap_or_default()
}

/// A reply as text; empty where it has none.
fn reply_text(object: &str, io: &Transport) -> String {
    let name = object.parse().ok();
    let body = shortened(io);
    let reply = name.map(|name| Reply { name, body });
    let text = reply.and_then(|reply| reply.to_text().ok());
    text.unwrap_or_default()
}

#[cfg(test)]
mod tests;
