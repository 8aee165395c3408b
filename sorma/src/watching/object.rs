//! The class `watch`: one object for each who watches.

use super::{CLASS, Filter, Watcher, Watchers};
use crate::description::ClassInfo;
use crate::object::{self, Context, Outcome, ServiceObject, Waiting};
use crate::options::OptionTable;
use crate::raise;
use crate::report::{Report, code};
use crate::transport::Transport;
use crate::words;
use std::fmt::Write as _;
use std::sync::atomic::Ordering;
use std::sync::{Arc, LazyLock};
use std::time::Duration;

/// The longest that EXEC next waits, s.
const MOST_WAIT_S: f64 = 60.0;
/// The most requests that one answer has.
const MOST_LINES: usize = 1000;

#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Settings {
    filter: Filter,
    capacity: i64,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            filter: Filter::default(),
            capacity: 1000,
        }
    }
}

static OPTIONS: LazyLock<OptionTable<Settings>> = LazyLock::new(|| {
    OptionTable::new(
        "shows the requests that the objects of its process meet, paired with their replies. EXEC next [SECONDS]: those \
         since the last time, a JSON object a line; when there are none it waits so long for one; IMSG 2, how many \
         these are, and how many were lost before them because they were not fetched in time. A flavor of one's own is a view of one's own, \
         which ends with whoever made it",
    )
    .word(
        "objects",
        "PATTERN",
        "of which objects; * stands for any letters",
        |set: &mut Settings| &mut set.filter.objects,
    )
    .choice(
        "method",
        &["any", "EXEC", "CTRL", "DBX"],
        "which method",
        |set| &mut set.filter.method,
    )
    .word(
        "from",
        "PATTERN",
        "asked by whom; * stands for any letters",
        |set| &mut set.filter.from,
    )
    .float(
        "slower",
        0.0..=86_400.0,
        "s",
        "only those that took at least so long",
        |set| &mut set.filter.slower_s,
    )
    .flag("failed", "only those that ended with an error", |set| {
        &mut set.filter.failed
    })
    .int(
        "trace",
        0..=i64::MAX,
        "",
        "only those that belong to the request of this number; 0: all",
        |set| &mut set.filter.trace,
    )
    .int(
        "capacity",
        1..=100_000,
        "",
        "how many are kept until they are fetched; the oldest give way",
        |set| &mut set.capacity,
    )
});

/// What a program may know about the class.
pub(crate) fn class() -> ClassInfo {
    OPTIONS.class(CLASS, env!("CARGO_PKG_VERSION"))
}

/// An object of class `watch`.
pub(crate) struct Watch {
    settings: Settings,
    watcher: Arc<Watcher>,
    /// Whether it does so yet: not before its first request has said what it is to see.
    watches: bool,
    watchers: Arc<Watchers>,
    owner: String,
}

impl Watch {
    pub(crate) fn new(watchers: &Arc<Watchers>) -> Self {
        let settings = Settings::default();
        let watcher = Arc::new(Watcher::new(capacity(&settings)));
        Self {
            settings,
            watcher,
            watches: false,
            watchers: Arc::clone(watchers),
            owner: String::new(),
        }
    }

    fn begin(&mut self) {
        if !std::mem::replace(&mut self.watches, true) {
            self.watchers.add(&self.watcher);
        }
    }

    fn own(&mut self, from: &str) {
        if self.owner.is_empty() {
            from.clone_into(&mut self.owner);
        }
    }

    fn answer(&self, io: &mut Transport) {
        let (lines, lost) = self.watcher.fetch(MOST_LINES);
        io.text.clear();
        for seen in &lines {
            // A structure of texts and finite numbers always has a JSON form; writing to a `String` cannot fail.
            let line = serde_json::to_string(seen).unwrap_or_default();
            let _ = writeln!(io.text, "{line}");
        }
        io.text.truncate(io.text.trim_end().len());
        io.floats.clear();
        let whole = |count: u64| i64::try_from(count).unwrap_or(i64::MAX);
        io.ints = vec![whole(lines.len() as u64), whole(lost)];
    }
}

impl Drop for Watch {
    fn drop(&mut self) {
        // Its own reference must be gone before those that are left are counted.
        self.watcher = Arc::new(Watcher::new(1));
        self.watchers.sweep();
    }
}

fn capacity(settings: &Settings) -> usize {
    usize::try_from(settings.capacity).unwrap_or(1)
}

/// How long EXEC is to wait.
fn patience(text: &str) -> Result<Duration, Report> {
    let found = words::texts(text).map_err(|error| raise!(code::SYNTAX, "{error}"))?;
    let wait = match found.iter().map(String::as_str).collect::<Vec<_>>()[..] {
        ["next"] | [] => return Ok(Duration::ZERO),
        ["next", seconds] => seconds.parse().ok(),
        _ => {
            return Err(raise!(
                code::UNSUPPORTED,
                "EXEC takes next [SECONDS], not `{text}`"
            ));
        }
    };
    wait.filter(|seconds| (0.0..=MOST_WAIT_S).contains(seconds))
        .map(Duration::from_secs_f64)
        .ok_or_else(|| {
            raise!(
                code::VALUE,
                "the time to wait is 0 to {MOST_WAIT_S} s, not `{text}`"
            )
        })
}

impl ServiceObject for Watch {
    fn exec_waiting<'a>(
        &'a mut self,
        cx: &'a Waiting<'a>,
        io: &'a mut Transport,
    ) -> object::Later<'a> {
        self.own(&io.from);
        self.begin();
        Some(Box::pin(async move {
            let patience = patience(&io.text)?;
            if self.watcher.is_empty() && !patience.is_zero() {
                let news = std::pin::pin!(self.watcher.news.notified());
                let over = cx.sleep(patience);
                let over = std::pin::pin!(over);
                futures_util::future::select(news, over).await;
            }
            self.answer(io);
            Ok(())
        }))
    }

    fn ctrl(&mut self, _cx: &Context<'_>, io: &mut Transport) -> Outcome {
        self.own(&io.from);
        OPTIONS.ctrl(&mut self.settings, io);
        *self.watcher.filter.write() = self.settings.filter.clone();
        self.watcher
            .capacity
            .store(capacity(&self.settings), Ordering::Relaxed);
        self.begin();
        Ok(())
    }

    fn dump(&self) -> String {
        OPTIONS.dump(&self.settings)
    }

    fn forget(&mut self, gone: &dyn Fn(&str) -> bool) -> bool {
        !self.owner.is_empty() && gone(&self.owner)
    }
}
