//! What writers and readers of one process see; see `tests/snapshots.rs` for two processes and
//! `protocol/tests.rs` for the protocol itself.

use super::layout::{HEADER, MAGIC};
use super::record::host_ns;
use super::*;
use crate::process::Process;
use ctos::time::{Clock, Instant};
use proptest::prelude::*;
use std::fs::{self, File, OpenOptions};
use std::os::unix::fs::{FileExt, PermissionsExt};
use std::time::Duration;
use tempfile::TempDir;

struct Shop {
    place: Place,
    clock: Clock,
    folder: TempDir,
}

fn shop() -> Shop {
    let folder = tempfile::tempdir().unwrap();
    let place = Place::under(&folder.path().join("shm"), "app").unwrap();
    let clock = Clock::real();
    Shop {
        place,
        clock,
        folder,
    }
}

impl Shop {
    fn writer(&self, slots: usize, floats: usize) -> Writer {
        self.create(Layout::new(slots, floats)).unwrap()
    }

    fn create(&self, layout: Layout) -> Result<Writer, SnapshotError> {
        Writer::create(&self.place, "pose", layout, &self.clock)
    }

    fn reader(&self) -> Reader {
        Reader::open(&self.place, "pose").unwrap()
    }

    fn file(&self) -> File {
        let path = self.place.path("pose").unwrap();
        OpenOptions::new()
            .read(true)
            .write(true)
            .open(path)
            .unwrap()
    }
}

/// All records that a reader still finds, with the number lost before each.
fn rest(reader: &mut Reader) -> Vec<(u64, u64)> {
    let mut record = Snapshot::default();
    let mut all = Vec::new();
    while let Some(lost) = reader.next(&mut record).unwrap() {
        assert!(
            record
                .floats
                .iter()
                .all(|float| *float == record.count as f64)
        );
        all.push((lost, record.count));
    }
    all
}

fn put(writer: &mut Writer, records: u64) {
    for _ in 0..records {
        let next = (writer.count() + 1) as f64;
        let floats = vec![next; writer.layout().floats];
        writer.write(&floats, &[]).unwrap();
    }
}

#[test]
fn a_reader_takes_the_latest_the_next_all_and_the_recent_history() {
    let shop = shop();
    let mut writer = shop.writer(4, 2);
    let mut reader = shop.reader();
    let mut record = Snapshot::default();
    assert!(!reader.latest(&mut record).unwrap());
    assert_eq!(reader.next(&mut record).unwrap(), None);
    put(&mut writer, 3);
    assert_eq!(rest(&mut reader), [(0, 1), (0, 2), (0, 3)]);
    put(&mut writer, 2);
    assert!(reader.latest(&mut record).unwrap());
    assert_eq!(
        (record.count, record.floats.as_slice()),
        (5, &[5.0, 5.0][..])
    );
    assert_eq!(
        rest(&mut reader),
        [],
        "what the latest passes over is not taken later"
    );
    let mut counts = Vec::new();
    assert_eq!(
        reader.history(2, &mut record, |one| counts.push(one.count)),
        2
    );
    assert_eq!(
        reader.history(99, &mut record, |one| counts.push(one.count)),
        4
    );
    assert_eq!(counts, [4, 5, 2, 3, 4, 5]);
    reader.seek(3);
    assert_eq!(rest(&mut reader), [(0, 4), (0, 5)]);
    reader.seek(0);
    assert_eq!(rest(&mut reader), [(0, 2), (0, 3), (0, 4), (0, 5)]);
    assert_eq!(reader.lost(), 0);
}

#[test]
fn a_reader_that_is_overtaken_is_told_how_many_it_lost() {
    let shop = shop();
    let mut writer = shop.writer(4, 1);
    put(&mut writer, 100);
    let mut reader = shop.reader();
    let counts: Vec<u64> = rest(&mut reader).iter().map(|(_, count)| *count).collect();
    assert_eq!(counts, [97, 98, 99, 100]);
    assert_eq!(
        reader.lost(),
        0,
        "what was gone before it came was never its own"
    );
    put(&mut writer, 10);
    assert_eq!(rest(&mut reader), [(6, 107), (0, 108), (0, 109), (0, 110)]);
    assert_eq!(reader.lost(), 6);
}

#[test]
fn a_record_knows_its_age_also_by_the_clock_of_another_process() {
    let shop = shop();
    let mut writer = shop.writer(2, 0);
    let before = shop.clock.now();
    writer.write(&[], &[]).unwrap();
    let after = shop.clock.now();
    let mut record = Snapshot::default();
    assert!(shop.reader().latest(&mut record).unwrap());
    assert!((before..=after).contains(&record.at(&shop.clock)));
    let other = Clock::real_from(shop.clock.origin_ns().unwrap() - 5_000);
    assert_eq!(
        record.at(&other) - record.at(&shop.clock),
        Duration::from_nanos(5_000)
    );
    assert!(record.age(&other) >= shop.clock.now() - after);
    assert!((before..=after).contains(&record.at(&shop.reader().writers_clock())));
    let later = Clock::real();
    assert_eq!(
        record.at(&later),
        Instant::START,
        "before that app was started"
    );
}

#[test]
fn opaque_bytes_keep_their_length_and_what_does_not_fit_is_refused() {
    let shop = shop();
    let mut writer = shop.create(Layout::new(2, 1).bytes(5)).unwrap();
    let mut reader = shop.reader();
    let mut record = Snapshot::default();
    for bytes in [&b"abcde"[..], b"", b"xyz"] {
        writer.write(&[1.0], bytes).unwrap();
        assert!(reader.latest(&mut record).unwrap());
        assert_eq!(record.opaque, bytes);
    }
    let wrong = |writer: &mut Writer, floats: &[f64], bytes: &[u8]| {
        writer.write(floats, bytes).unwrap_err().to_string()
    };
    assert_eq!(
        wrong(&mut writer, &[], &[]),
        "the buffer takes floats 1, not 0"
    );
    assert_eq!(
        wrong(&mut writer, &[1.0], &[0; 6]),
        "the buffer takes opaque bytes, at most 5, not 6"
    );
    assert_eq!(writer.count(), 3);
}

#[test]
fn a_second_writer_is_refused_and_told_who_writes() {
    let shop = shop();
    let writer = shop.writer(2, 1);
    let SnapshotError::Busy { writer: who, .. } = shop.create(Layout::new(2, 1)).unwrap_err()
    else {
        panic!("busy");
    };
    assert_eq!(who, Process::this());
    drop(writer);
    assert!(shop.create(Layout::new(2, 1)).is_ok());
}

#[test]
fn a_writer_that_was_killed_in_mid_write_is_succeeded_and_its_slot_is_skipped() {
    let shop = shop();
    let mut writer = shop.writer(3, 2);
    let mut reader = shop.reader();
    put(&mut writer, 4);
    writer.begin_and_leave(&[77.0, 77.0]);
    writer.die();
    assert!(matches!(reader.writer(), WriterState::Dead(_)));
    assert_eq!(
        reader.wait(Duration::ZERO, &shop.clock),
        Waited::Ready,
        "what is there can still be read"
    );
    assert_eq!(
        rest(&mut reader),
        [(2, 3), (0, 4)],
        "the slot of record 2 is half of record 5"
    );
    let ended = reader.wait(Duration::from_secs(60), &shop.clock);
    assert!(matches!(ended, Waited::Ended(WriterState::Dead(_))));

    let mut next = shop.writer(3, 2);
    assert_eq!(
        (next.generation(), next.count(), reader.generation()),
        (2, 4, 2)
    );
    put(&mut next, 1);
    let mut record = Snapshot::default();
    assert_eq!(reader.next(&mut record).unwrap(), Some(0));
    assert_eq!(
        (record.count, record.generation, record.floats[0]),
        (5, 2, 5.0)
    );
    assert_eq!(reader.writer(), WriterState::Writing(Process::this()));
}

#[test]
fn a_writer_with_another_layout_takes_the_place_and_readers_of_the_old_one_are_told() {
    let shop = shop();
    let mut writer = shop.writer(2, 1);
    put(&mut writer, 1);
    let mut reader = shop.reader();
    writer.die();
    let mut next = shop
        .create(Layout::new(2, 3).described("x m\ny m\nz m"))
        .unwrap();
    put(&mut next, 1);
    assert_eq!(
        rest(&mut reader),
        [(0, 1)],
        "the old records are still there"
    );
    let ended = reader.wait(Duration::from_secs(60), &shop.clock);
    assert_eq!(ended, Waited::Ended(WriterState::Replaced));
    let mut reader = shop.reader();
    assert_eq!((next.generation(), reader.generation()), (2, 2));
    assert_eq!(reader.layout().name_of(1), Some("y"));
    assert_eq!(rest(&mut reader), [(0, 1)]);
    let refused = Reader::open_as(&shop.place, "pose", 1, 0).unwrap_err();
    assert!(
        refused
            .to_string()
            .ends_with("records there have floats 3, not 1"),
        "{refused}"
    );
    assert!(Reader::open_as(&shop.place, "pose", 3, 0).is_ok());
}

#[test]
fn a_writer_that_ends_removes_its_segment_unless_it_is_kept() {
    let shop = shop();
    let mut writer = shop.writer(2, 1);
    put(&mut writer, 2);
    let mut reader = shop.reader();
    drop(writer);
    assert_eq!(rest(&mut reader), [(0, 1), (0, 2)]);
    assert_eq!(
        reader.wait(Duration::from_secs(60), &shop.clock),
        Waited::Ended(WriterState::Closed)
    );
    let missing = Reader::open(&shop.place, "pose").unwrap_err();
    assert!(matches!(missing, SnapshotError::Missing { .. }));

    let mut writer = shop.writer(2, 1);
    writer.keep(true);
    put(&mut writer, 1);
    drop(writer);
    assert_eq!(shop.writer(2, 1).count(), 1);
}

#[test]
fn what_nobody_writes_any_more_is_stale_and_removed() {
    let shop = shop();
    let mut alive = Writer::create(&shop.place, "alive", Layout::new(1, 1), &shop.clock).unwrap();
    put(&mut alive, 1);
    let mut fresh = shop.writer(1, 1);
    put(&mut fresh, 1);
    fresh.die();
    let old = Clock::real_from(0);
    let mut stale = Writer::create(&shop.place, "stale", Layout::new(1, 0), &old).unwrap();
    stale.write_stamped(1, &[], &[]).unwrap();
    stale.die();
    let unfinished = shop.place.unfinished(7);
    fs::write(&unfinished, "half").unwrap();
    let listed = shop.place.segments().unwrap();
    let seen: Vec<_> = listed
        .iter()
        .map(|one| (one.name.as_str(), one.is_written))
        .collect();
    assert_eq!(seen, [("alive", true), ("pose", false), ("stale", false)]);

    let name = unfinished.file_name().unwrap().to_str().unwrap().to_owned();
    let host_is_up = host_ns(&shop.clock) > STALE_AFTER.as_nanos() as u64;
    let removed = shop.place.remove_stale().unwrap();
    if host_is_up {
        assert_eq!(removed, [name, "stale".to_owned()]);
    }
    assert!(
        shop.place
            .remove_unwritten(Duration::ZERO)
            .unwrap()
            .contains(&"pose".to_owned())
    );
    assert_eq!(shop.place.segments().unwrap().len(), 1);
}

#[test]
fn a_place_that_is_not_the_users_alone_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    for wrong in ["", ".hidden", "a/b", "..", "ä", "x y", &"x".repeat(101)] {
        let refused = Place::under(&folder.path().join("shm"), wrong);
        assert!(matches!(refused, Err(SnapshotError::Name(_))), "{wrong}");
    }
    Place::under(&folder.path().join("shm"), "app").unwrap();
    let app = folder.path().join("shm/app");
    fs::set_permissions(&app, fs::Permissions::from_mode(0o750)).unwrap();
    let refused = Place::under(&folder.path().join("shm"), "app");
    assert!(matches!(refused, Err(SnapshotError::NotOurs { .. })));
    fs::remove_dir(&app).unwrap();
    std::os::unix::fs::symlink("/tmp", &app).unwrap();
    let refused = Place::under(&folder.path().join("shm"), "app");
    assert!(matches!(refused, Err(SnapshotError::NotOurs { .. })));
}

#[test]
fn only_the_user_may_read_a_segment() {
    let shop = shop();
    let writer = shop.writer(1, 1);
    assert_eq!(
        fs::metadata(writer.path()).unwrap().permissions().mode() & 0o777,
        0o600
    );
    let folder = fs::metadata(shop.folder.path().join("shm/app")).unwrap();
    assert_eq!(folder.permissions().mode() & 0o777, 0o700);
}

#[test]
fn a_file_of_another_kind_version_or_size_is_refused_with_what_is_wrong() {
    let shop = shop();
    let open = || Reader::open(&shop.place, "pose").unwrap_err().to_string();
    let path = shop.place.path("pose").unwrap();
    fs::write(&path, "hello").unwrap();
    assert!(open().ends_with("this is no snapshot buffer"));
    fs::write(&path, vec![0; 2 * HEADER]).unwrap();
    assert!(open().ends_with("this is no snapshot buffer"));
    fs::remove_file(&path).unwrap();
    let mut writer = shop.writer(4, 4);
    writer.keep(true);
    drop(writer);
    shop.file().write_at(&7_u64.to_ne_bytes(), 8).unwrap();
    assert!(open().contains("the buffer has version 7, and this program reads version 1"));
    shop.file().write_at(&1_u64.to_ne_bytes(), 8).unwrap();
    shop.file().write_at(&u64::MAX.to_ne_bytes(), 24).unwrap();
    assert!(
        open().contains("is damaged (slots must be 1 to"),
        "{}",
        open()
    );
    shop.file().write_at(&5000_u64.to_ne_bytes(), 24).unwrap();
    assert!(open().contains("and its records need"), "{}", open());
    // The next writer makes it anew.
    let mut writer = shop.writer(4, 4);
    put(&mut writer, 1);
    assert_eq!(rest(&mut shop.reader()), [(0, 1)]);
}

#[test]
fn a_reader_that_sleeps_is_woken_by_the_next_record() {
    let shop = shop();
    let mut writer = shop.writer(8, 1);
    let mut reader = shop.reader();
    let clock = shop.clock.clone();
    let reading = std::thread::spawn(move || {
        let mut record = Snapshot::default();
        let mut counts = Vec::new();
        while counts.len() < 200 {
            assert_eq!(reader.wait(Duration::from_secs(60), &clock), Waited::Ready);
            while reader.next(&mut record).unwrap().is_some() {
                counts.push(record.count);
            }
        }
        counts
    });
    // Each record only when the one before was certainly seen is not needed: nothing may be lost of
    // the waking, whatever the order.
    while !reading.is_finished() {
        put(&mut writer, 1);
        std::thread::yield_now();
    }
    let counts = reading.join().unwrap();
    assert!(counts.is_sorted());
}

#[test]
fn a_run_in_virtual_time_has_nothing_of_what_a_killed_run_has_left() {
    let shop = Shop {
        clock: Clock::virtual_clock(),
        ..shop()
    };
    let mut writer = shop.writer(4, 2);
    put(&mut writer, 3);
    let mut before = shop.reader();
    // Another process from now on.
    writer.die();
    let mut next = shop.writer(4, 2);
    let mut reader = shop.reader();
    assert_eq!(rest(&mut reader), []);
    assert_eq!((next.count(), next.generation()), (0, 2));
    put(&mut next, 1);
    assert_eq!(rest(&mut reader), [(0, 1)]);
    assert_eq!(rest(&mut before).len(), 3);
    assert_eq!(before.writer(), WriterState::Replaced);
}

#[test]
fn waiting_in_virtual_time_does_not_wait() {
    let folder = tempfile::tempdir().unwrap();
    let place = Place::under(&folder.path().join("shm"), "app").unwrap();
    let clock = Clock::virtual_clock();
    let mut writer = Writer::create(&place, "v", Layout::new(2, 1), &clock).unwrap();
    let reader = Reader::open(&place, "v").unwrap();
    assert!(reader.is_virtual_time());
    assert_eq!(reader.wait(Duration::from_secs(3600), &clock), Waited::Late);
    writer.write(&[1.0], &[]).unwrap();
    assert_eq!(
        reader.wait(Duration::from_secs(3600), &clock),
        Waited::Ready
    );
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(300))]

    /// Whatever stands in the memory, a reader answers.
    #[test]
    fn a_reader_of_hostile_memory_reads_nothing_outside_and_ends(
        changes in prop::collection::vec((0_usize..700, prop_oneof![
            any::<u64>(), 0_u64..20, Just(u64::MAX), Just(u64::MAX - 1), Just(MAGIC)
        ]), 0..40),
        before in any::<bool>(),
    ) {
        let shop = shop();
        let mut writer = shop.create(Layout::new(3, 2).bytes(9)).unwrap();
        for n in 0..4 {
            writer.write(&[f64::from(n); 2], &[1; 9]).unwrap();
        }
        let file = shop.file();
        let change = || {
            for (at, word) in &changes {
                // Not the parts that a reader must trust when it opens, if it has opened before.
                file.write_at(&word.to_ne_bytes(), (*at * 8) as u64).unwrap();
            }
        };
        let opened = if before {
            change();
            Reader::open(&shop.place, "pose")
        } else {
            let opened = Reader::open(&shop.place, "pose");
            change();
            opened
        };
        if let Ok(mut reader) = opened {
            let mut record = Snapshot::default();
            let (floats, bytes) = (reader.layout().floats, reader.layout().bytes);
            let _ = reader.latest(&mut record);
            for _ in 0..10 {
                let _ = reader.next(&mut record);
            }
            reader.seek(u64::MAX);
            reader.seek(0);
            let _ = reader.next(&mut record);
            if reader.layout().slots < 10_000 {
                reader.history(u64::MAX, &mut record, |_| ());
            }
            let _ = reader.wait(Duration::ZERO, &shop.clock);
            prop_assert!(record.floats.len() <= floats && record.opaque.len() <= bytes);
        }
        let _ = shop.place.segments();
        writer.die();
        let mut next = shop.create(Layout::new(3, 2).bytes(9)).unwrap();
        next.write(&[1.0, 2.0], &[]).unwrap();
        let mut record = Snapshot::default();
        prop_assert!(shop.reader().latest(&mut record).unwrap());
        prop_assert_eq!(&record.floats, &[1.0, 2.0]);
    }
}
