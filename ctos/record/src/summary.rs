//! The end of a file that was closed: where its chunks are, of which moments and channels, and what it counts. With it
//! a reader passes over the chunks that hold nothing for it. Where anything is doubtful, the file is read whole.

use std::{
    collections::{BTreeSet, VecDeque},
    io::{self, Read, Seek, SeekFrom},
    ops::Range,
};

use mcap::{
    Summary,
    records::{ChunkIndex, MetadataIndex, Record as Part},
    sans_io::{SummaryReadEvent, SummaryReader, SummaryReaderOptions},
};

use super::{
    counts::{COUNTS, Counts},
    lines::EVENTS,
    read::{Filter, RECORD_LIMIT},
};

/// What a file says of itself at its end.
pub(crate) struct Contents {
    pub(crate) summary: Summary,
    pub(crate) counts: Counts,
}

impl Contents {
    /// Reads the end of a file of `size` bytes. `None` when it was not closed, or says nothing that can be relied on.
    ///
    /// # Errors
    /// When the system cannot read it.
    pub(crate) fn read(file: &mut (impl Read + Seek), size: u64) -> io::Result<Option<Self>> {
        let options = SummaryReaderOptions::default()
            .with_file_size(size)
            .with_record_length_limit(RECORD_LIMIT);
        let mut reader = SummaryReader::new_with_options(options);
        while let Some(event) = reader.next_event() {
            match event {
                Ok(SummaryReadEvent::ReadRequest(wanted)) => {
                    let read = file.read(reader.insert(wanted))?;
                    reader.notify_read(read);
                }
                Ok(SummaryReadEvent::SeekRequest(to)) => {
                    let at = file.seek(to)?;
                    reader.notify_seeked(at);
                }
                // It breaks off, or is no such file: who reads it whole will say so.
                Err(_) => return Ok(None),
            }
        }
        let Some(summary) = reader.finish() else {
            return Ok(None);
        };
        let mut indexes = summary.metadata_indexes.iter();
        let Some(index) = indexes.rfind(|index| index.name == COUNTS) else {
            return Ok(None);
        };
        let counts = counts_at(file, index, size)?;
        Ok(counts.map(|counts| Self { summary, counts }))
    }

    /// The parts of the file in which `filter` takes nothing, in order. `None` when the index contradicts itself.
    pub(crate) fn superfluous(&self, filter: &Filter) -> Option<VecDeque<Range<u64>>> {
        let wanted = self.wanted(filter);
        let mut chunks: Vec<&ChunkIndex> = self.summary.chunk_indexes.iter().collect();
        chunks.sort_unstable_by_key(|chunk| chunk.chunk_start_offset);
        let mut passed = VecDeque::new();
        let mut end = 0;
        for chunk in chunks {
            let start = chunk.chunk_start_offset;
            if start < end {
                return None;
            }
            let length = chunk.chunk_length.checked_add(chunk.message_index_length)?;
            end = start.checked_add(length)?;
            if !self.holds(chunk, filter, wanted.as_ref()) {
                passed.push_back(start..end);
            }
        }
        Some(passed)
    }

    /// The channels of the file with lines that `filter` may take; `None`: all.
    fn wanted(&self, filter: &Filter) -> Option<BTreeSet<u16>> {
        if filter.topics.is_empty() {
            return None;
        }
        let channels = || self.summary.channels.iter();
        let plain: BTreeSet<&str> = channels().map(|(_, one)| one.topic.as_str()).collect();
        let mut packed = self.counts.channels.keys();
        // Lines about messages stand packed in one channel for all of them.
        let any_packed = packed.any(|name| !plain.contains(name.as_str()) && filter.names(name));
        let takes = |channel: &mcap::Channel<'_>| match channel.message_encoding == EVENTS {
            true => any_packed,
            false => filter.names(&channel.topic),
        };
        let taken = channels().filter(|(_, channel)| takes(channel));
        Some(taken.map(|(id, _)| *id).collect())
    }

    fn holds(&self, chunk: &ChunkIndex, filter: &Filter, wanted: Option<&BTreeSet<u16>>) -> bool {
        // A stretch of events stands at one moment, and they around it.
        let first = chunk.message_start_time.saturating_sub(self.counts.longest);
        let last = chunk.message_end_time.saturating_add(self.counts.longest);
        let in_time = filter.from.is_none_or(|from| last >= from.as_nanos())
            && filter.to.is_none_or(|to| first <= to.as_nanos());
        let mut channels = chunk.message_index_offsets.keys();
        // One without an index of its own may hold anything.
        let any = channels.len() == 0;
        in_time && wanted.is_none_or(|wanted| any || channels.any(|one| wanted.contains(one)))
    }
}

fn counts_at(
    file: &mut (impl Read + Seek),
    index: &MetadataIndex,
    size: u64,
) -> io::Result<Option<Counts>> {
    let end = index.offset.checked_add(index.length);
    let length = usize::try_from(index.length).unwrap_or(usize::MAX);
    if end.is_none_or(|end| end > size) || length > RECORD_LIMIT {
        return Ok(None);
    }
    file.seek(SeekFrom::Start(index.offset))?;
    let mut record = vec![0; length];
    file.read_exact(&mut record)?;
    // A record is its kind, its length and its data.
    let (Some(kind), Some(data)) = (record.first(), record.get(9..)) else {
        return Ok(None);
    };
    Ok(match mcap::parse_record(*kind, data) {
        Ok(Part::Metadata(metadata)) if metadata.name == COUNTS => {
            Counts::of_page(&metadata.metadata)
        }
        _ => None,
    })
}

/// A file without some of its parts.
pub(crate) struct Without<R> {
    file: R,
    at: u64,
    passed: VecDeque<Range<u64>>,
}

impl<R: Read + Seek> Without<R> {
    /// `file`, which stands at its beginning, without `passed`, which are in order.
    pub(crate) fn new(file: R, passed: VecDeque<Range<u64>>) -> Self {
        let at = 0;
        Self { file, at, passed }
    }
}

impl<R: Read + Seek> Read for Without<R> {
    fn read(&mut self, into: &mut [u8]) -> io::Result<usize> {
        let before = self.at;
        while let Some(next) = self.passed.pop_front_if(|next| next.start <= self.at) {
            self.at = self.at.max(next.end);
        }
        if self.at != before {
            self.file.seek(SeekFrom::Start(self.at))?;
        }
        let most = self
            .passed
            .front()
            .map_or(u64::MAX, |next| next.start - self.at);
        let most = usize::try_from(most).unwrap_or(usize::MAX).min(into.len());
        let read = self.file.read(into.get_mut(..most).unwrap_or_default())?;
        self.at += u64::try_from(read).unwrap_or(0);
        Ok(read)
    }
}

#[cfg(test)]
mod tests {
    use std::{cell::Cell, fs::File, path::Path, rc::Rc};

    use proptest::prelude::*;

    use super::*;
    use crate::{
        batch::Batch,
        event::{Key, Side, Step, Traffic},
        glossary::Glossary,
        lines::Schema,
        parts::{Parts, Place},
        read::{Entry, Run, Scan, scan_in},
        writer::Writer,
    };
    use ctos_core::registry::Registry;
    use ctos_message::Tid;
    use ctos_time::Instant;

    /// Counts what is read of a file.
    struct Counting {
        file: File,
        bytes: Rc<Cell<u64>>,
    }

    impl Read for Counting {
        fn read(&mut self, into: &mut [u8]) -> io::Result<usize> {
            let read = self.file.read(into)?;
            self.bytes.set(self.bytes.get() + read as u64);
            Ok(read)
        }
    }

    impl Seek for Counting {
        fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
            self.file.seek(to)
        }
    }

    const MS: u64 = 1_000_000;

    /// A record of messages to two tasks, one each millisecond, and a line of another channel now and then.
    fn record(path: &Path, messages: u64) {
        let app = "[chassis.a.processors.p]\n[task.arm]\nhandler = \"h\"\non = \"a/p\"\n[task.eye]\nhandler = \"h\"\non = \"a/p\"\n";
        let app = ctos_config::load_texts(&[("app.toml", app)], &[], &[]).unwrap();
        let names = Glossary::of(&app, &Registry::new(), &[]);
        let place = Place::new(path.to_owned(), u64::MAX, 1);
        let run = [("app".to_owned(), "app".to_owned())].into();
        let mut writer = Writer::new(names, Parts::open(place, run).unwrap(), Vec::new());
        for id in 1..=messages {
            let task = Tid::new(1, 1, u32::from(id % 3 == 0));
            let mut batch = Batch::default();
            let key = Key {
                id,
                task,
                peer: task,
                command: 1,
                trace: id,
            };
            let sent = Step::Sent {
                flags: 0,
                deadline: None,
                side: Side::Here,
            };
            for (later, step) in [(0, sent), (MS / 2, Step::Began)] {
                let event = Traffic {
                    at: id * MS + later,
                    chassis: 1,
                    key,
                    step,
                };
                batch.traffic(event, |data| {
                    data.extend_from_slice(&[7; 500]);
                    true
                });
            }
            if id % 100 == 0 {
                batch.line(id * MS, "/said".to_owned(), Schema::Value, |json| {
                    json.extend_from_slice(b"{}");
                    true
                });
            }
            writer.write(id * MS, &[batch], 0);
        }
        writer.parts.close(messages * MS);
    }

    fn at(ms: u64) -> Instant {
        Instant::from_nanos(ms * MS)
    }

    /// The lines that `filter` takes, what is known of the file, and how many bytes of it were read.
    fn scanned(path: &Path, filter: &Filter) -> (Vec<Entry>, Run, u64) {
        let (mut entries, bytes) = (Vec::new(), Rc::default());
        let file = Counting {
            file: File::open(path).unwrap(),
            bytes: Rc::clone(&bytes),
        };
        let run = scan_in(file, path, filter, |entry| entries.push(entry)).unwrap();
        (entries, run, bytes.get())
    }

    /// The same without a look at its end.
    fn whole(path: &Path, filter: &Filter) -> (Vec<Entry>, Run) {
        let mut entries = Vec::new();
        let scan = Scan::new(path, filter);
        let file = File::open(path).unwrap();
        let run = scan.read(file, |entry| entries.push(entry), |_| false);
        (entries, run.unwrap())
    }

    #[test]
    fn of_a_long_record_a_look_at_its_end_and_a_count_read_a_small_part() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("long.mcap");
        record(&path, 6000);
        let size = std::fs::metadata(&path).unwrap().len();
        assert!(size > 6_000_000, "{size}");
        let end = Filter {
            from: Some(at(5990)),
            ..Filter::default()
        };
        let (entries, run, bytes) = scanned(&path, &end);
        assert_eq!((entries.len(), run.lines()), (23, 12_060));
        assert!(bytes < size / 10, "{bytes} of {size} for its end");
        let nothing = Filter {
            topics: vec![String::new()],
            ..Filter::default()
        };
        let (entries, run, bytes) = scanned(&path, &nothing);
        assert_eq!((entries.len(), run.lines()), (0, 12_060));
        assert!(bytes < size / 50, "{bytes} of {size} to count");
        // What was cut off has no end that tells, and is read as far as it is whole.
        let cut = folder.path().join("cut.mcap");
        let mut bytes = std::fs::read(&path).unwrap();
        bytes.truncate(bytes.len() / 2);
        std::fs::write(&cut, bytes).unwrap();
        let (_, run, bytes) = scanned(&cut, &nothing);
        assert!(run.torn.is_some() && run.lines() > 5000, "{run:?}");
        assert!(bytes > size * 2 / 5, "{bytes} of {size} when it is cut");
    }

    #[test]
    fn a_damaged_end_is_no_panic_and_brings_no_line_that_is_not_wanted() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("run.mcap");
        record(&path, 300);
        let bytes = std::fs::read(&path).unwrap();
        let filter = Filter {
            from: Some(at(200)),
            ..Filter::default()
        };
        let end = bytes.len() - 1500;
        // Each byte of the end, and of what it points to, may be another one.
        for place in (end..bytes.len()).step_by(7) {
            let mut damaged = bytes.clone();
            damaged[place] ^= 0x55;
            std::fs::write(&path, damaged).unwrap();
            let mut lines = 0;
            let _ = crate::read::scan_only(&path, &filter, |_| lines += 1);
            assert!(lines <= 204, "{lines} lines with byte {place} changed");
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(24))]
        #[test]
        fn with_its_index_a_record_gives_the_lines_that_it_gives_when_it_is_read_whole(
            from in proptest::option::of(0..1600_u64),
            to in proptest::option::of(0..1600_u64),
            topics in proptest::sample::subsequence(vec!["/said", "/message/*", "*arm", "/began/eye", "/none"], 0..3),
        ) {
            let folder = tempfile::tempdir().unwrap();
            let path = folder.path().join("run.mcap");
            record(&path, 1500);
            let filter = Filter {
                topics: topics.into_iter().map(str::to_owned).collect(),
                from: from.map(at),
                to: to.map(at),
            };
            let (entries, run, _) = scanned(&path, &filter);
            prop_assert_eq!((entries, run), whole(&path, &filter));
        }
    }
}
