//! The class `stream`: the results of another object as they are made, kept until they are asked for, or
//! handed on to a third object.

use super::answer::{begin, code, mirror};
use crate::comm::Comm;
use crate::ipc::answer::{int, not_yet};
use crate::name::ObjectName;
use crate::object::{self, Context, Outcome, ServiceObject, Waiting};
use crate::options::OptionTable;
use crate::raise;
use crate::report::{Report, code as general};
use crate::request::{Method, Request};
use crate::results::{Keep, MOST_KEPT, Sample};
use crate::sorm::Sorm;
use crate::stream::Stream;
use crate::transport::Transport;
use futures_util::future::select;
use parking_lot::Mutex;
use std::collections::VecDeque;
use std::pin::pin;
use std::sync::{Arc, LazyLock};
use tokio::sync::oneshot;

#[derive(Debug, Clone, PartialEq)]
pub(super) struct Options {
    from: String,
    keep: String,
    capacity: i64,
    resume: bool,
    to: String,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            from: String::new(),
            keep: "latest".to_owned(),
            capacity: 100,
            resume: false,
            to: String::new(),
        }
    }
}

pub(super) static OPTIONS: LazyLock<OptionTable<Options>> = LazyLock::new(|| {
    OptionTable::new(
        "the results of another object, as they are made. EXEC begin: subscribes, which the other requests do too; \
         next: the oldest result kept, as if it had been asked for here, or `not yet`; latest: the newest, without those \
         before it; status: IMSG 4, the number of the last result that was fetched, how many were missed, how many are kept, and \
         whether it is subscribed; end: subscribes no more",
    )
    .word(
        "from",
        "OBJECT",
        "whose results",
        |options: &mut Options| &mut options.from,
    )
    .choice(
        "keep",
        &["latest", "every"],
        "what is kept until it is asked for",
        |options| &mut options.keep,
    )
    .int(
        "capacity",
        1..=10_000,
        "",
        "how many are kept with -keep every; then the oldest make room",
        |options| &mut options.capacity,
    )
    .flag(
        "resume",
        "goes on when the daemon of the object died and is back",
        |options| &mut options.resume,
    )
    .word(
        "to",
        "OBJECT",
        "which object is asked with EXEC and each result that is no error; empty: they are kept here",
        |options| &mut options.to,
    )
});

impl Options {
    fn keeps(&self) -> Keep {
        match self.keep.as_str() {
            "every" => Keep::Every(usize::try_from(self.capacity).unwrap_or(MOST_KEPT)),
            _ => Keep::Latest,
        }
    }
}

#[derive(Default)]
pub(super) struct StreamObject {
    options: Options,
    feed: Option<Feed>,
    last: u64,
    missed: u64,
}

enum Feed {
    /// Of an object of this process: kept where they are made.
    Here(Box<Stream>),
    /// Fetched or handed on by work of its own, which ends when the sender is dropped.
    Pumped(Arc<Mutex<Pumped>>, #[expect(dead_code)] oneshot::Sender<()>),
}

/// What has been fetched.
#[derive(Default)]
struct Pumped {
    samples: VecDeque<Sample>,
    ended: Option<Report>,
}

impl Pumped {
    fn put(&mut self, sample: Sample, capacity: usize) {
        self.samples.push_back(sample);
        if self.samples.len() > capacity
            && let Some(old) = self.samples.pop_front()
            && let Some(next) = self.samples.front_mut()
        {
            next.missed += old.missed + 1;
            next.resumed |= old.resumed;
        }
    }
}

impl StreamObject {
    /// Subscribes, unless it has.
    async fn begin(&mut self, cx: &Waiting<'_>) -> Result<&mut Feed, Report> {
        if self.feed.is_none() {
            let feed = self.subscribe(cx).await?;
            (self.last, self.missed) = (0, 0);
            self.feed = Some(feed);
        }
        let feed = self.feed.as_mut();
        feed.ok_or_else(|| raise!(general::VALUE, "there is no subscription"))
    }

    async fn subscribe(&self, cx: &Waiting<'_>) -> Result<Feed, Report> {
        let options = &self.options;
        if options.from.is_empty() {
            return Err(raise!(
                general::VALUE,
                "whose results? set -from OBJECT, or write a recipe: `{} -from OBJECT`",
                cx.name()
            ));
        }
        let sorm = cx.here().sorm();
        let stream = sorm.subscribe(cx.comm(), &options.from, options.keeps());
        let stream = stream.await?.resuming(options.resume);
        if options.to.is_empty() && stream.is_here() {
            return Ok(Feed::Here(Box::new(stream)));
        }
        let to = match options.to.as_str() {
            "" => None,
            to => Some(
                to.parse()
                    .map_err(|error| raise!(general::SYNTAX, "-to: no name: {error}"))?,
            ),
        };
        let pumped: Arc<Mutex<Pumped>> = Arc::default();
        let (stop, stopped) = oneshot::channel();
        let pump = Pump {
            sorm: sorm.clone(),
            stream,
            capacity: options.keeps().capacity(),
            to,
            into: Arc::clone(&pumped),
        };
        cx.comm().spawn(Box::new(move |comm| {
            Box::pin(async move {
                let run = pin!(pump.run(&*comm));
                select(stopped, run).await;
            })
        }))?;
        Ok(Feed::Pumped(pumped, stop))
    }

    async fn exec(&mut self, cx: &Waiting<'_>, io: &mut Transport) -> Outcome {
        match io.text.trim() {
            "begin" => {
                self.begin(cx).await?;
                io.empty();
            }
            "next" => {
                let found = self.begin(cx).await?.next();
                self.answer(found, io)?;
            }
            "latest" => {
                let feed = self.begin(cx).await?;
                let mut found = feed.next();
                while let Ok(Some(before)) = &found
                    && let Ok(Some(mut later)) = feed.next()
                {
                    later.missed += before.missed;
                    later.resumed |= before.resumed;
                    found = Ok(Some(later));
                }
                self.answer(found, io)?;
            }
            "status" => {
                let kept = self.feed.as_ref().map_or(0, Feed::kept);
                let is_on = self.feed.is_some();
                io.empty();
                let numbers = [self.last, self.missed, kept, u64::from(is_on)];
                io.ints.extend(numbers.map(int));
            }
            "end" => {
                self.feed = None;
                io.empty();
            }
            text => {
                return Err(raise!(
                    general::VALUE,
                    "EXEC takes begin, next, latest, status or end, not `{}`",
                    begin(text)
                ));
            }
        }
        Ok(())
    }

    fn answer(&mut self, found: Result<Option<Sample>, Report>, io: &mut Transport) -> Outcome {
        let sample = match found {
            Ok(Some(sample)) => sample,
            Ok(None) => {
                not_yet(io);
                return Ok(());
            }
            Err(report) => {
                // Said once; the next request subscribes anew.
                self.feed = None;
                return Err(report);
            }
        };
        self.last = sample.number;
        self.missed += sample.missed;
        mirror(io, sample.body);
        if sample.missed > 0 {
            let text = format!("{} results before it were not kept", sample.missed);
            io.report(Report::warning(code::MISSED, text));
        }
        if sample.resumed {
            let text = format!("`{}` was away before it", self.options.from);
            io.report(Report::warning(code::RESUMED, text));
        }
        Ok(())
    }
}

impl Feed {
    fn next(&mut self) -> Result<Option<Sample>, Report> {
        match self {
            Self::Here(stream) => Ok(stream.try_next()),
            Self::Pumped(pumped, _) => {
                let mut pumped = pumped.lock();
                match (pumped.samples.pop_front(), &pumped.ended) {
                    (None, Some(why)) => Err(why.clone()),
                    (sample, _) => Ok(sample),
                }
            }
        }
    }

    fn kept(&self) -> u64 {
        let kept = match self {
            Self::Here(stream) => stream.kept(),
            Self::Pumped(pumped, _) => pumped.lock().samples.len(),
        };
        u64::try_from(kept).unwrap_or(u64::MAX)
    }
}

/// Fetches results as they come.
struct Pump {
    sorm: Sorm,
    stream: Stream,
    capacity: usize,
    to: Option<ObjectName>,
    into: Arc<Mutex<Pumped>>,
}

impl Pump {
    async fn run(mut self, comm: &dyn Comm) {
        loop {
            match self.stream.next(comm).await {
                Ok(sample) => match &self.to {
                    None => self.into.lock().put(sample, self.capacity),
                    Some(to) => self.hand_on(comm, to.clone(), sample).await,
                },
                Err(report) => {
                    if self.to.is_some() {
                        tracing::warn!(object = %self.stream.name(), error = %report, "a stream has ended");
                    }
                    self.into.lock().ended = Some(report);
                    return;
                }
            }
        }
    }

    async fn hand_on(&self, comm: &dyn Comm, to: ObjectName, sample: Sample) {
        if !sample.body.is_ok() {
            return self.sorm.unheard(self.stream.name(), &sample.body);
        }
        let mut body = sample.body;
        body.reports.clear();
        let request = Request {
            name: to,
            method: Method::Exec,
            body,
        };
        let reply = self.sorm.ask(comm, request).await;
        self.sorm.unheard(&reply.name, &reply.body);
    }
}

impl ServiceObject for StreamObject {
    fn exec_waiting<'a>(
        &'a mut self,
        cx: &'a Waiting<'a>,
        io: &'a mut Transport,
    ) -> object::Later<'a> {
        Some(Box::pin(self.exec(cx, io)))
    }

    fn ctrl(&mut self, _cx: &Context<'_>, io: &mut Transport) -> Outcome {
        let before = self.options.clone();
        OPTIONS.ctrl(&mut self.options, io);
        if self.options != before {
            // The next request subscribes as it is wanted now.
            self.feed = None;
        }
        Ok(())
    }

    fn dump(&self) -> String {
        let is_on = if self.feed.is_some() { "on" } else { "off" };
        format!(
            "{}\nsubscribed {is_on}, last {}, missed {}",
            OPTIONS.dump(&self.options),
            self.last,
            self.missed
        )
    }
}
