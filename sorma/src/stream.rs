//! Demand streams: the results of an object, wherever it is, as they are made (SORMA technical report,
//! section 1.9.2).
//!
//! The subscriber of an object of another process fetches what its daemon keeps for it, and each fetch
//! says what has arrived. So a lost answer loses no result, and the daemon never waits for a subscriber.

use crate::comm::{Comm, Taken};
use crate::name::{Location, ObjectName};
use crate::raise;
use crate::report::{Report, code};
use crate::results::{Keep, MOST_KEPT, Sample, Tap};
use crate::sorm::{Inner, Place, Sorm, parse};
use std::collections::VecDeque;
use std::sync::{Arc, Weak};
use std::time::Duration;

/// How many results are fetched at once.
pub(crate) const BATCH: usize = 64;

/// How often a stream tries to subscribe anew, and how long it waits before the next time.
const ATTEMPTS: u32 = 60;
const PAUSE: Duration = Duration::from_millis(500);

/// A subscription to the results of an object. It ends when it is dropped.
pub struct Stream {
    /// Not held: an object may hold a stream, and the manager holds the object.
    sorm: Weak<Inner>,
    name: ObjectName,
    keep: Keep,
    resumes: bool,
    source: Source,
    /// The number of the last result that was fetched.
    last: u64,
    /// Fetched, and not yet handed on.
    ready: VecDeque<Sample>,
    /// The next result comes after an interruption.
    interrupted: bool,
}

enum Source {
    Here(Tap),
    There {
        at: Location,
        subscriber: u64,
    },
    /// The daemon is gone; why.
    Gone(Report),
}

impl std::fmt::Debug for Stream {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Stream({}, {:?})", self.name, self.keep)
    }
}

impl Sorm {
    /// Subscribes to the results of an object: of every EXEC that anybody asks of it from now on, and of
    /// whatever it [says by itself](crate::Context::publish). The object is built if it is not there.
    ///
    /// # Errors
    /// No name, no such object, or a daemon that cannot be reached.
    pub async fn subscribe(
        &self,
        comm: &dyn Comm,
        name: &str,
        keep: Keep,
    ) -> Result<Stream, Report> {
        let name = parse(name)?;
        let (source, last) = self.source(comm, &name, keep).await?;
        Ok(Stream {
            sorm: Arc::downgrade(&self.inner),
            name,
            keep,
            resumes: false,
            source,
            last,
            ready: VecDeque::new(),
            interrupted: false,
        })
    }

    async fn source(
        &self,
        comm: &dyn Comm,
        name: &ObjectName,
        keep: Keep,
    ) -> Result<(Source, u64), Report> {
        let at = match self.place(name)? {
            Place::Here => {
                let tap = self.tap(&name.here(), keep)?;
                let begun = tap.begun();
                return Ok((Source::Here(tap), begun));
            }
            Place::There(at) => at,
            Place::Traded(wanted) => self.best(comm, name, &wanted).await?,
        };
        let here = name.here();
        self.used(&at, &here);
        let (subscriber, begun) = comm.subscribe(&at, &here, keep).await?;
        Ok((Source::There { at, subscriber }, begun))
    }

    /// Subscribes to an object of this process.
    pub(crate) fn tap(&self, name: &ObjectName, keep: Keep) -> Result<Tap, Report> {
        keep.check()?;
        let handle = self.resolve(name)?;
        let results = self.results(handle.name());
        // When it is built anew, they are found by its name.
        handle.slot.feed(&results);
        Ok(results.subscribe(keep))
    }
}

impl Stream {
    /// Whether it goes on when the daemon died and is back: with a new subscription, under the same name.
    /// The first result after that is marked as [resumed](Sample::resumed). Without this the stream ends
    /// with an error.
    #[must_use]
    pub fn resuming(mut self, resumes: bool) -> Self {
        self.resumes = resumes;
        self
    }

    /// Whether the object is one of this process.
    #[must_use]
    pub fn is_here(&self) -> bool {
        matches!(self.source, Source::Here(_))
    }

    /// The object.
    #[must_use]
    pub fn name(&self) -> &ObjectName {
        &self.name
    }

    /// Waits for the next result.
    ///
    /// # Errors
    /// The daemon is gone, with both names. Asked again, a stream that does not resume says the same.
    pub async fn next(&mut self, comm: &dyn Comm) -> Result<Sample, Report> {
        loop {
            if let Some(sample) = self.ready.pop_front() {
                return Ok(sample);
            }
            self.more(comm).await?;
        }
    }

    /// The next result if it is there already. Of an object of another process that is what was fetched
    /// together with the one before.
    #[must_use]
    pub fn try_next(&mut self) -> Option<Sample> {
        if self.ready.is_empty()
            && let Source::Here(tap) = &self.source
        {
            let samples = tap.after(self.last, BATCH);
            self.arrived(samples.into_iter().map(Arc::unwrap_or_clone));
        }
        self.ready.pop_front()
    }

    /// How many results are here and not handed on.
    pub(crate) fn kept(&self) -> usize {
        let kept = match &self.source {
            Source::Here(tap) => tap.after(self.last, MOST_KEPT).len(),
            Source::There { .. } | Source::Gone(_) => 0,
        };
        kept + self.ready.len()
    }

    /// Tells the daemon that nobody listens any more, which it would find out by itself later.
    pub async fn end(self, comm: &dyn Comm) {
        if let Source::There { at, subscriber } = &self.source {
            comm.leave(at, *subscriber).await;
        }
    }

    /// Waits a while for results.
    pub(crate) async fn more(&mut self, comm: &dyn Comm) -> Result<(), Report> {
        let (at, taken) = match &self.source {
            Source::Here(tap) => {
                tap.wait(self.last).await;
                let samples = tap.after(self.last, BATCH);
                self.arrived(samples.into_iter().map(Arc::unwrap_or_clone));
                return Ok(());
            }
            Source::There { at, subscriber } => {
                let here = self.name.here();
                let taken = comm.take(at, &here, *subscriber, self.last).await;
                (at.clone(), taken)
            }
            Source::Gone(report) => return Err(report.clone()),
        };
        let why = match taken {
            Ok(Taken::Samples(samples)) => {
                self.arrived(samples.into_iter());
                return Ok(());
            }
            Ok(Taken::Unknown) => raise!(
                code::DAEMON,
                "`{}`: its daemon does not know the subscriber any more; it was started anew",
                self.name
            ),
            Err(report) => report,
        };
        if !self.resumes {
            self.source = Source::Gone(why.clone());
            return Err(why);
        }
        self.resume(comm, &at, &why).await
    }

    /// Subscribes anew when the daemon is back; a traded object may then be another daemon's.
    async fn resume(&mut self, comm: &dyn Comm, at: &Location, why: &Report) -> Result<(), Report> {
        tracing::warn!(object = %self.name, error = %why.text, "a stream is interrupted");
        let Some(inner) = self.sorm.upgrade() else {
            return Err(why.clone());
        };
        let sorm = Sorm { inner };
        let mut left = ATTEMPTS;
        let (source, last) = loop {
            if !matches!(sorm.place(&self.name), Ok(Place::Traded(_))) {
                comm.back(at).await?;
            }
            match sorm.source(comm, &self.name, self.keep).await {
                Ok(found) => break found,
                // It went again, or has not yet been found to be back.
                Err(report) if left > 0 && report.code == code::DAEMON => {
                    left -= 1;
                    comm.sleep(PAUSE).await;
                }
                Err(report) => return Err(report),
            }
        };
        (self.source, self.last) = (source, last);
        self.interrupted = true;
        Ok(())
    }

    fn arrived(&mut self, samples: impl Iterator<Item = Sample>) {
        for mut sample in samples {
            // A daemon that answers twice must not be heard twice.
            if sample.number <= self.last {
                continue;
            }
            sample.missed = sample.number - self.last - 1;
            sample.resumed = std::mem::take(&mut self.interrupted);
            self.last = sample.number;
            self.ready.push_back(sample);
        }
    }
}
