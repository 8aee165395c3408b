//! Records of a chassis that runs already: begun and ended by message, any number side by side.
//!
//! Each writes a file of its own next to those that the configuration asks for, through the same recorder.

use ctos_config::RecordConfig;
use ctos_core::{
    chassis::Chassis,
    context::{Context, TaskRef},
    envelope::Replier,
    report::RecordReport,
};
use ctos_message::{CommandInfo, command};
use std::{collections::BTreeMap, path::Path, sync::Arc};

use super::{
    CLOSE_TIMEOUT, begin, file_name, log, parts::suffixed, recorder::Recorder,
    recorders::Recorders, run_of,
};

command! {
    /// Lets an agent record its chassis into a folder; answers with the file. The names are those of the
    /// tasks of all chassis.
    pub struct BeginRecord {
        pub key: u64,
        pub folder: String,
        pub channels: Vec<String>,
        pub names: Vec<TaskRef>,
    } => RecordReport, 0xff71, "begin_record"
}
command! {
    /// Asks how a record is.
    pub struct ReadRecord { pub key: u64 } => Option<RecordReport>, 0xff72, "read_record"
}
command! {
    /// Ends a record; answers when its file is closed.
    pub struct EndRecord { pub key: u64 } => Option<RecordReport>, 0xff73, "end_record"
}

/// The records of a chassis that were begun while it ran, by the keys of those who asked. Dropped, all
/// are closed.
#[derive(Default)]
pub struct Attached(BTreeMap<u64, Guest>);

impl Attached {
    /// Begins a record of `cx`'s chassis.
    ///
    /// # Errors
    /// When its file cannot be made.
    pub fn begin(
        &mut self,
        cx: &Context,
        request: BeginRecord,
        runtime: &[CommandInfo],
    ) -> Result<RecordReport, String> {
        let guest = Guest::begin(cx.chassis(), &request, runtime)?;
        let report = guest.recorder.report();
        self.0.insert(request.key, guest);
        Ok(report)
    }

    /// How a record is.
    pub fn read(&self, key: u64) -> Option<RecordReport> {
        self.0.get(&key).map(|guest| guest.recorder.report())
    }

    /// Ends a record and answers when its file is closed: on a thread of its own, since a disk may take its
    /// time.
    pub fn end(&mut self, cx: &Context, key: u64, reply: Replier<EndRecord>) {
        let Some(guest) = self.0.remove(&key) else {
            // A reply cannot fail, here and below.
            let _ = reply.ok(None);
            return;
        };
        let recorder = guest.recorder.clone();
        let (closed, closing) = tokio::sync::oneshot::channel();
        let thread = std::thread::Builder::new().name("record-end".to_owned());
        let started = thread.spawn(move || {
            drop(guest);
            // Nobody listens when the app has ended meanwhile.
            let _ = closed.send(());
        });
        cx.spawn(async move {
            // Without a thread the record has been closed where the order came.
            if started.is_ok() {
                let _ = closing.await;
            }
            let _ = reply.ok(Some(recorder.report()));
        });
    }
}

/// One record.
struct Guest {
    chassis: Arc<Chassis>,
    recorder: Arc<Recorder>,
}

impl Guest {
    fn begin(
        chassis: &Arc<Chassis>,
        request: &BeginRecord,
        runtime: &[CommandInfo],
    ) -> Result<Self, String> {
        let app = &chassis.app;
        let file = Path::new(&request.folder).join(file_name(&app.name));
        let config = app.record.clone();
        let mut config = config.unwrap_or_else(|| RecordConfig::new(file.clone()));
        config.channels.clone_from(&request.channels);
        let path = suffixed(&file, chassis.name());
        let mut run = run_of(chassis);
        let now = chassis.clock.now().as_nanos();
        run.insert("attached_ns".to_owned(), now.to_string());
        // Each process has its own disk, where a tool on another host cannot make anything.
        std::fs::create_dir_all(&request.folder)
            .map_err(|error| format!("{}: {error}", request.folder))?;
        let recorder = begin(chassis, &config, path, run, runtime);
        let recorder = recorder.map_err(|error| error.to_string())?;
        for task in &request.names {
            recorder.name(task.tid(), task.name());
        }
        for task in chassis.tasks() {
            let commands = task.statistics.commands();
            recorder.named(task.tid, &task.name, commands);
        }
        Recorders::admit(chassis, recorder.clone());
        log::attach(&recorder, chassis.index());
        Ok(Self {
            chassis: chassis.clone(),
            recorder,
        })
    }
}

impl Drop for Guest {
    fn drop(&mut self) {
        Recorders::dismiss(&self.chassis, &self.recorder);
        log::detach(&self.recorder);
        self.recorder.finish(CLOSE_TIMEOUT);
    }
}
