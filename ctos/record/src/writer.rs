//! The one who empties the buffers: puts what happened to messages into files as it is, and all else as
//! lines, with the names that belong to both, and keeps account of what was lost on the way.

use std::sync::Arc;

use super::{
    batch::{Batch, Noted},
    event::Told,
    glossary,
    lines::{self, EVENTS},
    parts::{Line, NAMES, Parts},
    read::matches,
    traffic::Events,
};
use crate::names::Names;
use ctos_core::report::RecordReport;

/// Writes one record.
pub(crate) struct Writer {
    names: Arc<Names>,
    /// Which file has been told how much of them.
    told: (u64, usize),
    parts: Parts,
    /// Which channels are written; none: all.
    channels: Vec<String>,
    json: Vec<u8>,
    /// Events that found no space in the buffers.
    dropped: u64,
}

impl Writer {
    pub(crate) fn new(names: Arc<Names>, parts: Parts) -> Self {
        Self {
            names,
            told: (0, 0),
            parts,
            channels: Vec::new(),
            json: Vec::new(),
            dropped: 0,
        }
    }

    /// Writes these channels alone, in whose names `*` stands for any letters.
    pub(crate) fn choosing(self, channels: Vec<String>) -> Self {
        Self { channels, ..self }
    }

    fn takes(&self, topic: &str) -> bool {
        let mut channels = self.channels.iter();
        self.channels.is_empty() || channels.any(|pattern| matches(pattern, topic))
    }

    /// Events that found no space on the disk.
    pub(crate) fn unwritten(&self) -> u64 {
        self.parts.lost_in_all().saturating_sub(self.dropped)
    }

    /// How the record is.
    pub(crate) fn report(&self) -> RecordReport {
        self.parts.report()
    }

    pub(crate) fn names(&self) -> &Arc<Names> {
        &self.names
    }

    /// Writes what all buffers hold; `dropped` more were not taken. What one buffer holds keeps its order.
    pub(crate) fn write(&mut self, now: u64, batches: &[Batch], dropped: u64) {
        if dropped > 0 {
            if self.dropped == 0 {
                tracing::warn!(
                    dropped,
                    "the record is not complete: more happened than could be written; what is lost from now on is counted (`ctos status CHASSIS`); `record.buffer_mb` makes room for more"
                );
            }
            self.dropped += dropped;
            self.parts
                .lost(dropped, "more happened than could be written");
        }
        for noted in batches.iter().flat_map(Batch::noted) {
            match noted {
                Noted::Traffic { bytes, events, at } if self.channels.is_empty() => {
                    self.stretch(now, at, bytes, events);
                }
                Noted::Traffic { bytes, .. } => self.chosen(now, bytes),
                Noted::Told(told, data) => self.line(now, &told, data),
            }
        }
        self.parts.tell_lost(now);
    }

    /// Writes a stretch of what happened to messages, behind the names that it needs.
    fn stretch(&mut self, now: u64, at: u64, bytes: &[u8], events: u64) {
        if self.parts.ready(now) {
            self.tell_names();
        }
        self.parts.write(
            now,
            &Line {
                topic: "/events",
                schema: EVENTS,
                at,
                bytes,
                lines: events,
            },
        );
    }

    fn tell_names(&mut self) {
        let (part, known) = self.told;
        let known = if part == self.parts.number() {
            known
        } else {
            0
        };
        if let Some((page, known)) = glossary::page(&self.names, known) {
            self.parts.note(NAMES, page);
            self.told = (self.parts.number(), known);
        }
    }

    /// Writes what is wanted of a stretch.
    fn chosen(&mut self, now: u64, bytes: &[u8]) {
        let mut chosen = Batch::default();
        for (event, data, _) in Events::new(bytes) {
            let (topic, _) = lines::channel_of(&event.step, &self.names.task(event.key.task));
            if self.takes(&topic) {
                chosen.traffic(&event, |buffer| {
                    buffer.extend_from_slice(data);
                    true
                });
            }
        }
        for noted in chosen.noted() {
            if let Noted::Traffic { bytes, events, at } = noted {
                self.stretch(now, at, bytes, events);
            }
        }
    }

    fn line(&mut self, now: u64, told: &Told, data: &[u8]) {
        match lines::told(told, data, &self.names, &mut self.json) {
            Ok((topic, _)) if !self.takes(&topic) => {}
            Ok((topic, schema)) => self.parts.write(
                now,
                &Line {
                    topic: &topic,
                    schema,
                    at: told.at,
                    bytes: &self.json,
                    lines: 1,
                },
            ),
            Err(error) => {
                tracing::warn!(error = %error, "an event could not be put into the record");
                self.parts.lost(1, "an event could not be encoded");
            }
        }
    }

    /// Brings to the disk what was written.
    pub(crate) fn flush(&mut self, now: u64) {
        self.parts.flush(now);
    }

    /// Closes the record.
    pub(crate) fn close(&mut self, now: u64) {
        self.parts.close(now);
    }
}

#[cfg(test)]
mod tests {
    use std::{collections::BTreeMap, path::Path};

    use super::*;
    use crate::{
        event::{Key, Side, Step, Traffic},
        parts::{Place, parts_of},
        read::{Filter, Record},
    };
    use ctos_core::{registry::Registry, report::Ending};
    use ctos_message::Tid;

    const TASK: Tid = Tid::new(1, 1, 0);

    fn writer(path: &Path) -> Writer {
        let app = "[chassis.a.processors.p]\n[task.arm]\nhandler = \"h\"\non = \"a/p\"\n";
        let app = ctos_config::load_texts(&[("app.toml", app)], &[], &[]).unwrap();
        let names = Arc::new(Names::new(&app, &Registry::new(), &[]));
        let place = Place::new(path.to_owned(), 100_000, 100);
        Writer::new(names, Parts::open(place, BTreeMap::new()).unwrap())
    }

    /// Message `id` to the task of this name, from itself, and what becomes of it.
    fn batch(task: Tid, id: u64) -> Batch {
        let mut batch = Batch::default();
        let key = Key {
            id,
            task,
            peer: task,
            command: 0x0001,
            trace: id,
        };
        let sent = Step::Sent {
            flags: 0,
            deadline: None,
            side: Side::Here,
        };
        let ended = Step::Ended {
            began: 10 * id,
            ending: Ending::Done,
        };
        for step in [sent, Step::Began, ended] {
            let event = Traffic {
                at: 10 * id,
                chassis: 1,
                key,
                step,
            };
            batch.traffic(&event, |data| {
                data.extend_from_slice(&[7; 1000]);
                true
            });
        }
        batch
    }

    #[test]
    fn each_file_of_a_record_can_be_read_by_itself() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("run.mcap");
        let mut writer = writer(&path);
        let late = Tid::new(1, 1, 5);
        for id in 1..=600 {
            if id == 300 {
                writer.names().name(late, &"late".into());
            }
            let task = if id < 300 { TASK } else { late };
            writer.write(id, &[batch(task, id)], 0);
        }
        writer.close(600);
        let files = parts_of(&path).unwrap();
        assert!(files.len() > 3, "{files:?}");
        let mut ids = Vec::new();
        for file in files.into_values() {
            let record = Record::read(&[file], &Filter::default()).unwrap();
            assert_eq!(record.runs[0].torn, None);
            for entry in &record.entries {
                let Some(name) = entry.channel.topic.strip_prefix("/message/") else {
                    continue;
                };
                let line: serde_json::Value = serde_json::from_slice(&entry.json).unwrap();
                let id: u64 = line["id"].as_str().unwrap()[2..].parse().unwrap();
                assert_eq!(name, if id < 300 { "arm" } else { "late" });
                assert_eq!(line["from"], name);
                ids.push(id);
            }
        }
        assert_eq!(ids, (1..=600).collect::<Vec<_>>());
    }

    #[test]
    fn of_chosen_channels_all_is_written_and_of_others_nothing() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("run.mcap");
        let mut writer = writer(&path).choosing(vec!["/ended/a*".to_owned()]);
        for id in 1..=9 {
            writer.write(id, &[batch(TASK, id), batch(Tid::new(1, 1, 5), id)], 0);
        }
        assert_eq!(writer.report().lines, 9);
        writer.close(9);
        let record = Record::read(&[path], &Filter::default()).unwrap();
        let topics = record
            .entries
            .iter()
            .map(|entry| entry.channel.topic.as_str());
        assert_eq!(topics.collect::<Vec<_>>(), ["/ended/arm"; 9]);
    }
}
