//! A record of the running app that a client has asked for: begun on every chassis, told about, and ended
//! whatever becomes of the client.

use std::{
    collections::BTreeMap,
    future::Future,
    sync::{
        Arc, Mutex,
        atomic::{AtomicU64, Ordering},
    },
    time::Duration,
};

use futures_util::future::join_all;
use tokio::sync::Notify;

use crate::control::{
    protocol::{Answer, ErrorCode, ErrorView, RecordFile, RecordRequest, RecordView},
    view,
};
use ctos_core::{
    chassis::Chassis,
    report::RecordReport,
    system::{self, TaskName},
};
use ctos_message::fault::Fault;
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

/// One record. Dropped, it ends on every chassis.
pub(super) struct Recording {
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
    pub(super) async fn begin(
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
        Err(ErrorView {
            code: ErrorCode::Failed,
            message: reasons.join("; "),
            known: Vec::new(),
        })
    }

    async fn begin_on(&mut self, members: &[u8]) {
        let names = self.names().await;
        let orders = members
            .iter()
            .filter(|index| **index == 0 || self.chassis.is_linked(**index))
            .map(|index| {
                let order = BeginRecord {
                    key: self.key,
                    folder: self.request.folder.clone(),
                    channels: self.request.channels.clone(),
                    names: names.clone(),
                };
                let chassis = self.chassis.clone();
                async move {
                    let agent = system::agent_tid(*index);
                    (*index, view::ask(&chassis, agent, order, TIMEOUT).await)
                }
            });
        for (index, begun) in join_all(orders).await {
            let file = begun.unwrap_or_else(|fault| RecordReport {
                trouble: Some(reason(&fault)),
                ..RecordReport::default()
            });
            self.files.insert(index, file);
        }
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

    /// What the client is told next; `None` when that was all. `news` ends with the app, or with the name
    /// of a chassis that was started again.
    pub(super) async fn next(
        &mut self,
        news: impl Future<Output = Option<String>>,
    ) -> Option<Answer> {
        if self.over {
            return None;
        }
        let pause = match self.left() {
            Some(left) => left.min(TELL),
            None => TELL,
        };
        let stop = self.stop.clone();
        tokio::select! {
            biased;
            () = stop.notified() => Some(self.end().await),
            news = news => match news {
                Some(name) => {
                    let index = self.chassis.others().find(|index| {
                        self.chassis.name_of(*index) == name
                    });
                    self.begin_on(&index.into_iter().collect::<Vec<_>>()).await;
                    Some(Answer::Recording(self.view()))
                }
                // Every process has closed its part with the rest of it.
                None => {
                    self.over = true;
                    Some(Answer::Recorded(self.view()))
                }
            },
            () = tokio::time::sleep(pause) => {
                if self.left() == Some(Duration::ZERO) {
                    return Some(self.end().await);
                }
                self.read().await;
                Some(Answer::Recording(self.view()))
            }
        }
    }

    /// How long it still lasts, if that was said.
    fn left(&self) -> Option<Duration> {
        let timeout = self.request.for_s?;
        let timeout = Duration::try_from_secs_f64(timeout).unwrap_or(Duration::MAX);
        Some(timeout.saturating_sub(self.chassis.clock.now().since(self.began)))
    }

    pub(super) fn view(&self) -> RecordView {
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

    async fn read(&mut self) {
        let asked = self.files.keys().map(|index| {
            let (chassis, key) = (self.chassis.clone(), self.key);
            async move {
                let agent = system::agent_tid(*index);
                let told = view::ask(&chassis, agent, ReadRecord { key }, TIMEOUT).await;
                (*index, told)
            }
        });
        for (index, told) in join_all(asked).await {
            // One that does not answer is told by its own means.
            if let Ok(Some(record)) = told {
                self.files.insert(index, record);
            }
        }
    }

    async fn end(&mut self) -> Answer {
        self.over = true;
        let view = self.view();
        for (index, told) in end_all(&self.chassis, self.key, self.files.keys().copied()).await {
            if let Ok(Some(record)) = told {
                self.files.insert(index, record);
            }
        }
        Answer::Recorded(RecordView {
            took_s: view.took_s,
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
                end_all(&chassis, key, members.into_iter()).await;
            });
        }
    }
}

async fn end_all(
    chassis: &Arc<Chassis>,
    key: u64,
    members: impl Iterator<Item = u8>,
) -> Vec<(u8, Result<Option<RecordReport>, Fault>)> {
    let ends = members.map(|index| async move {
        let agent = system::agent_tid(index);
        let told = view::ask(chassis, agent, EndRecord { key }, CLOSE_TIMEOUT).await;
        (index, told)
    });
    join_all(ends).await
}

fn reason(fault: &Fault) -> String {
    match fault {
        Fault::Refused { text } => text.clone(),
        other => format!("{other:?}"),
    }
}
