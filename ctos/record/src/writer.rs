//! The writer empties the buffers. It puts their lines and stretches of events into files, with the names
//! that belong to these, and counts what was lost.

use std::{
    collections::BTreeMap,
    sync::{Arc, Mutex},
};

use super::{
    batch::Batch,
    counts::Counts,
    glossary::Glossary,
    lines::{self, Schema},
    parts::{Line, NAMES, Parts},
    read::matches,
    traffic::Events,
};
use ctos_time::lock::lock;

/// Writes one record.
pub(crate) struct Writer {
    pub(crate) names: Arc<Mutex<Glossary>>,
    /// Which file has been told how much of them.
    told: (u64, usize),
    pub(crate) parts: Parts,
    /// Which channels are written, in whose names `*` stands for any characters; none: all.
    channels: Vec<String>,
    /// Events that found no space in the buffers.
    dropped: u64,
}

impl Writer {
    pub(crate) fn new(names: Glossary, parts: Parts, channels: Vec<String>) -> Self {
        Self {
            names: Arc::new(Mutex::new(names)),
            told: (0, 0),
            parts,
            channels,
            dropped: 0,
        }
    }

    fn takes(&self, topic: &str) -> bool {
        let mut channels = self.channels.iter();
        self.channels.is_empty() || channels.any(|pattern| matches(pattern, topic))
    }

    /// Writes what all buffers hold; they have not taken `dropped` so far. What one holds keeps its order.
    pub(crate) fn write(&mut self, now: u64, batches: &[Batch], dropped: u64) {
        let before = std::mem::replace(&mut self.dropped, dropped);
        if dropped > before {
            if before == 0 {
                tracing::warn!(
                    dropped,
                    "the record is not complete: more happened than could be written; what is lost from now on is counted (`ctos status CHASSIS`); `record.buffer_mb` makes room for more"
                );
            }
            let why = "more happened than could be written";
            self.parts.lost(dropped - before, why);
        }
        for line in batches.iter().flat_map(Batch::lines) {
            if *line.schema != Schema::Events {
                if self.takes(line.topic) {
                    self.parts.write(now, &line);
                }
            } else if self.channels.is_empty() {
                self.stretch(now, &line);
            } else {
                let chosen = self.chosen(line.bytes);
                chosen.lines().for_each(|line| self.stretch(now, &line));
            }
        }
        self.parts.tell_lost(now);
    }

    /// Writes a stretch of what happened to messages, behind the names that it needs.
    fn stretch(&mut self, now: u64, line: &Line<'_>) {
        if self.parts.ready(now) {
            self.tell_names();
        }
        let packed = self.counted(line);
        self.parts.write_stretch(now, line, &packed);
    }

    /// What is in a stretch.
    fn counted(&self, stretch: &Line<'_>) -> Counts {
        // Few kinds of events of few tasks come again and again.
        let mut tally: BTreeMap<_, (u64, u64)> = BTreeMap::new();
        let mut span = (u64::MAX, 0);
        for (event, _, length) in Events::new(stretch.bytes) {
            let (kind, _) = lines::kind_of(&event.step);
            let counted = tally.entry((event.key.task, kind)).or_default();
            counted.0 += 1;
            counted.1 += u64::try_from(length).unwrap_or(0);
            span = (span.0.min(event.at), span.1.max(event.at));
        }
        let mut counts = Counts::default();
        let names = lock(&self.names);
        for ((task, kind), counted) in tally {
            let topic = lines::channel_of(kind, &names.task(task));
            counts.add_lines(&topic, counted, span);
        }
        let (before, after) = (
            stretch.at.saturating_sub(span.0),
            span.1.saturating_sub(stretch.at),
        );
        counts.longest = before.max(after);
        counts
    }

    fn tell_names(&mut self) {
        let (part, known) = self.told;
        let number = self.parts.number();
        let known = if part == number { known } else { 0 };
        let names = lock(&self.names);
        if names.len() > known {
            self.parts.note(NAMES, names.page(known));
            self.told = (number, names.len());
        }
    }

    /// What is wanted of a stretch.
    fn chosen(&self, bytes: &[u8]) -> Batch {
        let mut chosen = Batch::default();
        for (event, data, _) in Events::new(bytes) {
            let task = lock(&self.names).task(event.key.task);
            let (kind, _) = lines::kind_of(&event.step);
            if self.takes(&lines::channel_of(kind, &task)) {
                // What has been read can be written.
                chosen.traffic(event, |buffer| {
                    buffer.extend_from_slice(data);
                    true
                });
            }
        }
        chosen
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

    fn writer(path: &Path, channels: &[&str]) -> Writer {
        let app = "[chassis.a.processors.p]\n[task.arm]\nhandler = \"h\"\non = \"a/p\"\n";
        let app = ctos_config::load_texts(&[("app.toml", app)], &[], &[]).unwrap();
        let names = Glossary::of(&app, &Registry::new(), &[]);
        let place = Place::new(path.to_owned(), 100_000, 100);
        let channels = channels.iter().map(|&channel| channel.to_owned()).collect();
        Writer::new(
            names,
            Parts::open(place, BTreeMap::new()).unwrap(),
            channels,
        )
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
            took: 0,
            ending: Ending::Done,
        };
        for step in [sent, Step::Began, ended] {
            let event = Traffic {
                at: 10 * id,
                chassis: 1,
                key,
                step,
            };
            batch.traffic(event, |data| {
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
        let mut writer = writer(&path, &[]);
        let late = Tid::new(1, 1, 5);
        for id in 1..=600 {
            if id == 300 {
                lock(&writer.names).name(late, "late");
            }
            let task = if id < 300 { TASK } else { late };
            writer.write(id, &[batch(task, id)], 0);
        }
        writer.parts.close(600);
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
        let mut writer = writer(&path, &["/ended/a*"]);
        for id in 1..=9 {
            writer.write(id, &[batch(TASK, id), batch(Tid::new(1, 1, 5), id)], 0);
        }
        assert_eq!(writer.parts.report().lines, 9);
        writer.parts.close(9);
        let record = Record::read(&[path], &Filter::default()).unwrap();
        let topics = record
            .entries
            .iter()
            .map(|entry| entry.channel.topic.as_str());
        assert_eq!(topics.collect::<Vec<_>>(), ["/ended/arm"; 9]);
    }
}
