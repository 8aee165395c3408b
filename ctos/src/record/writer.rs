//! The one who empties the buffers: turns events into lines and puts them into files, and keeps
//! account of what was lost on the way.

use std::sync::Arc;

use super::{
    event::{Head, events},
    lines,
    names::Names,
    parts::{Line, Parts},
    read::matches,
    report::RecordReport,
};

/// Writes one record.
pub(crate) struct Writer {
    names: Arc<Names>,
    parts: Parts,
    /// Which channels are written; none: all.
    channels: Vec<String>,
    json: Vec<u8>,
    /// Events that found no room in the buffers.
    dropped: u64,
}

impl Writer {
    pub(crate) fn new(names: Arc<Names>, parts: Parts) -> Self {
        Self {
            names,
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

    /// Events that found no room on the disk.
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

    /// Writes the events of all buffers in the order of their moments; `dropped` more were not taken.
    pub(crate) fn write(&mut self, now: u64, batch: &[Vec<u8>], dropped: u64) {
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
        let mut all: Vec<(Head, &[u8])> = batch.iter().flat_map(|bytes| events(bytes)).collect();
        if batch.len() > 1 {
            // Stable: what one task did keeps its order.
            all.sort_by_key(|(head, _)| head.at);
        }
        for (head, data) in all {
            self.write_one(now, &head, data);
        }
        self.parts.tell_lost(now);
    }

    fn write_one(&mut self, now: u64, head: &Head, data: &[u8]) {
        match lines::write(head, data, &self.names, &mut self.json) {
            Ok((topic, _)) if !self.takes(&topic) => {}
            Ok((topic, schema)) => self.parts.write(
                now,
                &Line {
                    topic: &topic,
                    schema,
                    at: head.at,
                    json: &self.json,
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
