use std::{
    io::PipeReader,
    os::fd::OwnedFd,
    sync::atomic::{AtomicBool, Ordering},
};

use proptest::prelude::*;

use super::*;
use crate::read::{Filter, Record};

fn line(at: u64, json: &[u8]) -> Line<'_> {
    Line {
        topic: "/x",
        schema: &Schema::Value,
        at,
        bytes: json,
        lines: 1,
    }
}

fn open(path: &Path, max_bytes: u64, keep: usize) -> Parts {
    let place = Place::new(path.to_owned(), max_bytes, keep);
    Parts::open(place, BTreeMap::new()).unwrap()
}

fn read(path: &Path) -> Record {
    Record::read(&[path.to_owned()], &Filter::default()).unwrap()
}

#[test]
fn files_are_bounded_in_size_and_number_and_the_newest_are_kept() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("run.mcap");
    let mut parts = open(&path, 10_000, 3);
    let json = format!("{{\"x\":\"{}\"}}", "y".repeat(90));
    for at in 0..1000 {
        parts.write(at, &line(at, json.as_bytes()));
    }
    parts.close(1000);
    let there = parts_of(&path).unwrap();
    assert_eq!(there.len(), 3, "{there:?}");
    let mut ends = Vec::new();
    for file in there.values() {
        let length = std::fs::metadata(file).unwrap().len();
        assert!(length < 20_000, "{} has {length} bytes", file.display());
        let record = read(file);
        assert_eq!(record.runs[0].torn, None);
        ends.push(record.runs[0].span.unwrap());
    }
    assert_eq!(ends[2].1.as_nanos(), 999, "the last line is there");
    for pair in ends.windows(2) {
        assert_eq!(
            pair[0].1.as_nanos() + 1,
            pair[1].0.as_nanos(),
            "a gap between two files"
        );
    }
}

#[test]
fn what_was_recorded_before_is_never_overwritten() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("run.mcap");
    for at in 0..2 {
        let mut parts = open(&path, 1_000_000, 8);
        parts.write(at, &line(at, b"{}"));
        parts.close(at);
    }
    let there = parts_of(&path).unwrap();
    let spans: Vec<u64> = there
        .values()
        .map(|file| read(file).runs[0].span.unwrap().0.as_nanos())
        .collect();
    assert_eq!(spans, [0, 1]);
}

#[test]
fn a_file_that_is_cut_anywhere_is_read_up_to_the_last_whole_chunk() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("run.mcap");
    let mut parts = open(&path, 1_000_000, 8);
    for at in 0..100 {
        parts.write(at, &line(at, b"{\"n\":1}"));
        if at % 10 == 9 {
            parts.flush(at);
        }
    }
    parts.close(100);
    let whole = std::fs::read(&path).unwrap();
    let cut = folder.path().join("cut.mcap");
    let mut most = 0;
    for length in (0..whole.len()).step_by(7) {
        std::fs::write(&cut, &whole[..length]).unwrap();
        let Ok(record) = Record::read(std::slice::from_ref(&cut), &Filter::default()) else {
            assert!(length < 100, "nothing could be read of {length} bytes");
            continue;
        };
        let lines = record.entries.len();
        assert_eq!(lines % 10, 0, "half a chunk was read");
        assert!(lines >= most, "more bytes, less lines");
        most = lines;
    }
    assert_eq!(most, 100);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]
    #[test]
    fn a_damaged_file_is_never_a_panic(place in 0_usize..4000, byte: u8) {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("run.mcap");
        let mut parts = open(&path, 1_000_000, 8);
        for at in 0..50 {
            parts.write(at, &line(at, b"{\"n\":1}"));
        }
        parts.close(50);
        let mut bytes = std::fs::read(&path).unwrap();
        let place = place % bytes.len();
        bytes[place] ^= byte;
        std::fs::write(&path, bytes).unwrap();
        let _ = Record::read(&[path], &Filter::default());
    }
}

/// A disk that takes what its reader takes, and breaks when that is dropped; then, a good one.
fn breaking(folder: &Path) -> (Place, PipeReader) {
    let (reader, writer) = std::io::pipe().unwrap();
    let first = Mutex::new(Some(File::from(OwnedFd::from(writer))));
    let mut place = Place::new(folder.join("run.mcap"), 1_000_000, 8);
    place.create = Box::new(move |path| {
        let file = File::create_new(path)?;
        Ok(lock(&first).take().unwrap_or(file))
    });
    (place, reader)
}

#[test]
fn a_disk_that_breaks_loses_what_is_counted_and_nothing_else() {
    let folder = tempfile::tempdir().unwrap();
    let (place, reader) = breaking(folder.path());
    let path = place.path.clone();
    let mut parts = Parts::open(place, BTreeMap::new()).unwrap();
    parts.write(1, &line(1, b"{}"));
    parts.flush(1);
    drop(reader);
    parts.write(2, &line(2, b"{}"));
    parts.write(3, &line(3, b"{}"));
    parts.flush(3);
    parts.write(4, &line(4, b"{}"));
    assert_eq!(
        parts.report().lost,
        3,
        "two that were not whole and one that found no file"
    );
    let later = RETRY_NS + 10;
    parts.write(later, &line(later, b"{}"));
    parts.tell_lost(later);
    parts.close(later);
    let record = read(&part_path(&path, 2));
    assert_eq!(record.runs[0].lost, 3, "the file says what is missing");
    let topics: Vec<&str> = record
        .entries
        .iter()
        .map(|entry| entry.channel.topic.as_str())
        .collect();
    assert_eq!(topics, ["/x", "/recorder"]);
    assert!(
        record.entries[1]
            .json
            .windows(11)
            .any(|text| text == b"\"dropped\":3")
    );
}

#[test]
fn a_full_disk_is_an_error_at_the_start_and_leaves_no_empty_file() {
    let folder = tempfile::tempdir().unwrap();
    let mut place = Place::new(folder.path().join("run.mcap"), 1_000_000, 8);
    let path = place.path.clone();
    place.create = Box::new(|path| {
        File::create_new(path)?;
        OpenOptions::new().write(true).open("/dev/full")
    });
    let error = Parts::open(place, BTreeMap::new()).err().unwrap();
    let text = error.to_string();
    assert!(
        text.contains("run.mcap") && text.contains("space"),
        "{text}"
    );
    assert!(!path.exists());
}

/// A file name that is taken by a folder, a folder that is not there: said, not ignored.
#[test]
fn a_place_that_cannot_be_written_is_an_error_that_names_it() {
    let folder = tempfile::tempdir().unwrap();
    let place = Place::new(folder.path().join("none/run.mcap"), 1, 1);
    let error = Parts::open(place, BTreeMap::new()).err().unwrap();
    assert!(error.to_string().contains("none/run.mcap"), "{error}");
}

mod slow {
    use std::time::Duration;

    use super::*;
    use crate::{glossary::Glossary, recorder::Recorder, writer::Writer};
    use ctos_core::registry::Registry;
    use ctos_message::Tid;
    use ctos_time::Clock;

    /// Nobody reads the pipe, so the writer hangs in its first large write; the recording threads go on.
    #[test]
    fn a_disk_that_takes_nothing_hangs_nobody_and_what_is_dropped_is_counted() {
        let folder = tempfile::tempdir().unwrap();
        let (place, reader) = breaking(folder.path());
        let app = "[chassis.a]\n[task.t]\nhandler = \"h\"\non = \"a\"\n";
        let app = ctos_config::load_texts(&[("app.toml", app)], &[], &[]).unwrap();
        let names = Glossary::of(&app, &Registry::new(), &[]);
        let parts = Parts::open(place, BTreeMap::new()).unwrap();
        let writer = Writer::new(names, parts, Vec::new());
        let limit = 1 << 20;
        let flush = Duration::from_millis(1);
        let recorder = Recorder::threaded(Clock::real(), writer, 1, limit, flush).unwrap();
        let json = format!("\"{}\"", "z".repeat(10_000));
        let refused = AtomicBool::new(false);
        // The pipe holds 64 KiB, the buffer 1 MiB, the writer one batch.
        for _ in 0..1000 {
            let channel = "/x".to_owned();
            let write = |buffer: &mut Vec<u8>| {
                buffer.extend_from_slice(json.as_bytes());
                true
            };
            let noted = recorder.note(Tid::default(), |batch| {
                batch.line(1, channel, Schema::Value, write)
            });
            if !noted {
                refused.store(true, Ordering::Relaxed);
            }
        }
        assert!(refused.load(Ordering::Relaxed), "10 MB went into 1 MiB");
        recorder.finish(Duration::from_millis(20));
        drop(reader);
    }
}

#[test]
fn a_disk_that_is_full_is_told_of_until_it_has_taken_lines_for_a_while() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("run.mcap");
    let full = Arc::new(AtomicBool::new(false));
    let is_full = full.clone();
    let mut place = Place::new(path.clone(), 1_000, 100);
    place.create = Box::new(move |path| {
        let full = is_full.load(Ordering::Relaxed);
        let path = if full { Path::new("/dev/full") } else { path };
        let mut options = OpenOptions::new();
        options.write(true).create_new(!full).open(path)
    });
    let mut parts = Parts::open(place, BTreeMap::new()).unwrap();
    let json = format!("{{\"x\":\"{}\"}}", "y".repeat(900));
    let write = |parts: &mut Parts, now| {
        parts.write(now, &line(now, json.as_bytes()));
        parts.flush(now);
    };
    write(&mut parts, 1);
    let before = parts.report();
    assert_eq!((before.lines, before.lost, before.trouble), (1, 0, None));
    // The next file is begun on the full disk.
    full.store(true, Ordering::Relaxed);
    for now in 2..10 {
        write(&mut parts, now);
    }
    let during = parts.report();
    let trouble = during.trouble.unwrap();
    assert!(trouble.contains("No space left"), "{trouble}");
    assert!(during.lost >= 7, "{} are lost", during.lost);
    assert_eq!(during.bytes, std::fs::metadata(&path).unwrap().len());
    full.store(false, Ordering::Relaxed);
    // Not before the pause is over, and it counts as mended when it has held for as long again.
    let retried = 10 + RETRY_NS;
    write(&mut parts, retried);
    assert!(parts.report().trouble.is_some());
    write(&mut parts, retried + RETRY_NS);
    let after = parts.report();
    assert_eq!(after.trouble, None);
    parts.close(retried + RETRY_NS);
    assert_eq!(
        after.lost,
        parts.report().lost,
        "what is lost stays counted"
    );
    let all: usize = parts_of(&path)
        .unwrap()
        .values()
        .map(|file| {
            let record = read(file);
            let lines = record.entries.iter();
            lines.filter(|entry| entry.channel.topic == "/x").count()
        })
        .sum();
    assert_eq!(
        all as u64 + after.lost,
        11,
        "every line is there or counted"
    );
}
