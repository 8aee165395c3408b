//! A record of the running app that a client has asked for: begun on every chassis, told about, and ended
//! whatever becomes of the client.

use std::{
    collections::BTreeMap,
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
    service::{Answered, Service, Writer, tell},
    view,
};
use ctos_core::{chassis::Chassis, context::TaskRef, report::RecordReport, system};
use ctos_message::{ChassisNumber, Command, fault::Fault};
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
    pub(super) async fn record(&self, request: RecordRequest, writer: &mut Writer) -> Answered {
        let chassis = &self.chassis;
        let mut news = self.ticker.subscribe();
        let mut recording = Recording::begin(chassis, &self.recordings, request).await?;
        let stop = recording.stop.clone();
        loop {
            let view = recording.view();
            tell(writer, &Answer::Recording(view)).await?;
            let pause = recording.left().map_or(TELL, |left| left.min(TELL));
            tokio::select! {
                biased;
                () = stop.notified() => break,
                name = restarted(&mut news) => match name {
                    Some(name) => {
                        let is_it = |index: &ChassisNumber| chassis.name_of(*index) == name;
                        recording.begin_on(chassis.others().filter(is_it)).await;
                    }
                    None => {
                        // Every process has closed its part with the rest of it.
                        recording.over = true;
                        return Ok(Answer::Recorded(recording.view()));
                    }
                },
                () = tokio::time::sleep(pause) => {
                    if recording.left() == Some(Duration::ZERO) {
                        break;
                    }
                    let key = recording.key;
                    recording.ask(|| ReadRecord { key }, TIMEOUT).await;
                }
            }
        }
        recording.over = true;
        let (took_s, key) = (recording.view().took_s, recording.key);
        recording.ask(|| EndRecord { key }, CLOSE_TIMEOUT).await;
        let view = recording.view();
        Ok(Answer::Recorded(RecordView { took_s, ..view }))
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
    files: BTreeMap<ChassisNumber, RecordReport>,
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
        let mut recording = Self {
            chassis: chassis.clone(),
            all: all.clone(),
            request,
            key: all.last.fetch_add(1, Ordering::Relaxed) + 1,
            stop: Arc::default(),
            began: chassis.clock.now(),
            files: BTreeMap::new(),
            over: false,
        };
        lock(&all.stops).insert(recording.key, recording.stop.clone());
        recording
            .begin_on([0].into_iter().chain(chassis.others()))
            .await;
        let files = recording.files.values();
        let mut reasons: Vec<String> = files.filter_map(|file| file.trouble.clone()).collect();
        if reasons.len() < recording.files.len() {
            return Ok(recording);
        }
        reasons.dedup();
        Err(ErrorView::new(ErrorCode::Failed, reasons.join("; ")))
    }

    async fn begin_on(&mut self, members: impl Iterator<Item = ChassisNumber>) {
        let surveys = view::surveys(&self.chassis).await;
        let tasks = surveys.into_iter().flatten().flat_map(|one| one.tasks);
        let names: Vec<TaskRef> = tasks
            .map(|(tid, task)| TaskRef::new(task.name, tid))
            .collect();
        let order = || BeginRecord {
            key: self.key,
            folder: self.request.folder.clone(),
            channels: self.request.channels.clone(),
            names: names.clone(),
        };
        let members = members.filter(|index| *index == 0 || self.chassis.is_linked(*index));
        for (index, begun) in ask_all(&self.chassis, members, order, TIMEOUT).await {
            let file = begun.unwrap_or_else(|fault| RecordReport {
                trouble: Some(ErrorView::from(fault).message),
                ..RecordReport::default()
            });
            self.files.insert(index, file);
        }
    }

    /// Asks all that have a part of it how that is. Of one that does not answer, the last report stays.
    async fn ask<C: Command<Reply = Option<RecordReport>>>(
        &mut self,
        order: impl Fn() -> C,
        timeout: Duration,
    ) {
        let members = self.files.keys().copied();
        for (index, told) in ask_all(&self.chassis, members, order, timeout).await {
            if let Ok(Some(file)) = told {
                self.files.insert(index, file);
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
        let file = |(index, record): (&ChassisNumber, &RecordReport)| RecordFile {
            chassis: self.chassis.name_of(*index).to_owned(),
            record: record.clone(),
        };
        RecordView {
            key: self.key,
            took_s: self.chassis.clock.now().since(self.began).as_secs_f64(),
            files: self.files.iter().map(file).collect(),
        }
    }
}

impl Drop for Recording {
    fn drop(&mut self) {
        lock(&self.all.stops).remove(&self.key);
        if !self.over {
            let (chassis, key) = (self.chassis.clone(), self.key);
            let members = std::mem::take(&mut self.files).into_keys();
            tokio::spawn(async move {
                ask_all(&chassis, members, || EndRecord { key }, CLOSE_TIMEOUT).await;
            });
        }
    }
}

/// Asks the agents of `members`.
async fn ask_all<C: Command>(
    chassis: &Arc<Chassis>,
    members: impl Iterator<Item = ChassisNumber>,
    order: impl Fn() -> C,
    timeout: Duration,
) -> Vec<(ChassisNumber, Result<C::Reply, Fault>)> {
    let asked = members.map(|index| {
        let told = view::ask(chassis, system::agent_tid(index), order(), timeout);
        async move { (index, told.await) }
    });
    join_all(asked).await
}
