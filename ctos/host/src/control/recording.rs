//! A record of the running app that a client has asked for: begun on every chassis, told about, and ended
//! whatever becomes of the client.

use std::{
    collections::BTreeMap,
    io,
    sync::{
        Arc, Mutex,
        atomic::{AtomicU64, Ordering},
    },
    time::Duration,
};

use futures_util::future::join_all;
use tokio::sync::Notify;

use super::{
    news::restarted,
    protocol::{Answer, ErrorCode, ErrorView, RecordFile, RecordRequest, RecordView},
    service::{Service, Writer, tell},
    view,
};
use ctos_core::{
    chassis::Chassis,
    report::RecordReport,
    system::{self, TaskName},
};
use ctos_message::{Command, fault::Fault};
use ctos_record::{BeginRecord, EndRecord, ReadRecord};
use ctos_time::{Instant, lock::lock};

/// How often a client is told how its record is.
const TELL: Duration = Duration::from_secs(1);
/// How long a chassis may take to begin, or to tell.
const TIMEOUT: Duration = Duration::from_secs(2);
/// How long one may take to bring a record to the disk.
const CLOSE_TIMEOUT: Duration = Duration::from_secs(8);

/// The records that clients have asked for, by their keys.
#[derive(Default)]
pub(super) struct Recordings {
    last: AtomicU64,
    stops: Mutex<BTreeMap<u64, Arc<Notify>>>,
}

impl Recordings {
    /// Ends a record. False when there is none with this key.
    pub(super) fn stop(&self, key: u64) -> bool {
        let stop = lock(&self.stops).get(&key).cloned();
        stop.map(|stop| stop.notify_one()).is_some()
    }
}

impl Service {
    /// Records the app and tells the client about it.
    pub(super) async fn record(
        &self,
        request: RecordRequest,
        writer: &mut Writer,
    ) -> io::Result<()> {
        let mut news = self.ticker.subscribe();
        let begun = Recording::begin(&self.chassis, &self.recordings, request).await;
        let mut recording = match begun {
            Ok(recording) => recording,
            Err(wrong) => return tell(writer, &Answer::Error(wrong)).await,
        };
        tell(writer, &Answer::Recording(recording.view())).await?;
        while !recording.over {
            let answer = recording.next(restarted(&mut news)).await;
            tell(writer, &answer).await?;
        }
        Ok(())
    }
}

/// One record. Dropped, it ends on every chassis.
struct Recording {
    chassis: Arc<Chassis>,
    all: Arc<Recordings>,
    request: RecordRequest,
    key: u64,
    stop: Arc<Notify>,
    began: Instant,
    /// The last that is known of each chassis.
    files: BTreeMap<u8, RecordReport>,
    over: bool,
}

impl Recording {
    /// Begins on every chassis that is there.
    ///
    /// # Errors
    /// When not even one can be recorded; all reasons.
    async fn begin(
        chassis: &Arc<Chassis>,
        all: &Arc<Recordings>,
        request: RecordRequest,
    ) -> Result<Self, ErrorView> {
        let key = all.last.fetch_add(1, Ordering::Relaxed) + 1;
        let stop = Arc::new(Notify::new());
        lock(&all.stops).insert(key, stop.clone());
        let mut recording = Self {
            chassis: chassis.clone(),
            all: all.clone(),
            request,
            key,
            stop,
            began: chassis.clock.now(),
            files: BTreeMap::new(),
            over: false,
        };
        let everybody: Vec<u8> = [0].into_iter().chain(chassis.others()).collect();
        recording.begin_on(&everybody).await;
        if recording.files.values().any(|file| file.trouble.is_none()) {
            return Ok(recording);
        }
        let mut reasons: Vec<String> = recording
            .files
            .values()
            .filter_map(|file| file.trouble.clone())
            .collect();
        reasons.dedup();
        Err(ErrorView::new(ErrorCode::Failed, reasons.join("; ")))
    }

    async fn begin_on(&mut self, members: &[u8]) {
        let names = self.names().await;
        let there = |index: &u8| *index == 0 || self.chassis.is_linked(*index);
        let members = members.iter().copied().filter(there);
        let order = || BeginRecord {
            key: self.key,
            folder: self.request.folder.clone(),
            channels: self.request.channels.clone(),
            names: names.clone(),
        };
        let begun = ask_all(&self.chassis, members, order, TIMEOUT).await;
        self.files.extend(begun.into_iter().map(|(index, begun)| {
            let file = begun.unwrap_or_else(|fault| RecordReport {
                trouble: Some(ErrorView::from(fault).message),
                ..RecordReport::default()
            });
            (index, file)
        }));
    }

    /// The names of the tasks of all chassis, by their ids.
    async fn names(&self) -> Vec<TaskName> {
        let surveys = view::surveys(&self.chassis).await;
        let tasks = surveys.into_iter().flatten().flat_map(|one| one.tasks);
        tasks
            .filter(|task| task.tid.processor() > 0)
            .map(|task| TaskName {
                name: task.name,
                tid: task.tid,
            })
            .collect()
    }

    /// What the client is told next. `restarted` ends with the name of a chassis that was started again, or with the
    /// app.
    async fn next(&mut self, restarted: impl Future<Output = Option<String>>) -> Answer {
        let pause = self.left().map_or(TELL, |left| left.min(TELL));
        let stop = self.stop.clone();
        tokio::select! {
            biased;
            () = stop.notified() => self.end().await,
            name = restarted => match name {
                Some(name) => {
                    let chassis = self.chassis.clone();
                    let index = chassis.others().find(|index| chassis.name_of(*index) == name);
                    self.begin_on(index.as_slice()).await;
                    Answer::Recording(self.view())
                }
                // Every process has closed its part with the rest of it.
                None => {
                    self.over = true;
                    Answer::Recorded(self.view())
                }
            },
            () = tokio::time::sleep(pause) => {
                if self.left() == Some(Duration::ZERO) {
                    return self.end().await;
                }
                let members = self.files.keys().copied();
                let key = self.key;
                let told = ask_all(&self.chassis, members, || ReadRecord { key }, TIMEOUT).await;
                self.told(told);
                Answer::Recording(self.view())
            }
        }
    }

    /// How long it still lasts, if that was said.
    fn left(&self) -> Option<Duration> {
        let timeout = self.request.for_s?;
        let timeout = Duration::try_from_secs_f64(timeout).unwrap_or(Duration::MAX);
        Some(timeout.saturating_sub(self.chassis.clock.now().since(self.began)))
    }

    fn view(&self) -> RecordView {
        let files = self.files.iter();
        RecordView {
            key: self.key,
            took_s: self.chassis.clock.now().since(self.began).as_secs_f64(),
            files: files
                .map(|(index, record)| RecordFile {
                    chassis: self.chassis.name_of(*index).to_owned(),
                    record: record.clone(),
                })
                .collect(),
        }
    }

    /// What chassis tell of their records. One that does not answer is told by its own means.
    fn told(&mut self, told: Vec<(u8, Result<Option<RecordReport>, Fault>)>) {
        let told = told.into_iter();
        self.files
            .extend(told.filter_map(|(index, told)| Some((index, told.ok()??))));
    }

    async fn end(&mut self) -> Answer {
        self.over = true;
        let took_s = self.view().took_s;
        let (members, key) = (self.files.keys().copied(), self.key);
        let told = ask_all(&self.chassis, members, || EndRecord { key }, CLOSE_TIMEOUT).await;
        self.told(told);
        Answer::Recorded(RecordView {
            took_s,
            ..self.view()
        })
    }
}

impl Drop for Recording {
    fn drop(&mut self) {
        lock(&self.all.stops).remove(&self.key);
        if !self.over {
            let (chassis, key) = (self.chassis.clone(), self.key);
            let members: Vec<u8> = self.files.keys().copied().collect();
            tokio::spawn(async move {
                let order = || EndRecord { key };
                ask_all(&chassis, members.into_iter(), order, CLOSE_TIMEOUT).await;
            });
        }
    }
}

/// Asks the agents of `members`.
async fn ask_all<C: Command>(
    chassis: &Arc<Chassis>,
    members: impl Iterator<Item = u8>,
    order: impl Fn() -> C,
    timeout: Duration,
) -> Vec<(u8, Result<C::Reply, Fault>)> {
    let asked = members.map(|index| {
        let told = view::ask(chassis, system::agent_tid(index), order(), timeout);
        async move { (index, told.await) }
    });
    join_all(asked).await
}
