//! Snapshot buffers between processes: writers that are killed in the middle of a record, readers that sleep.
//!
//! The writers are processes of this same program.

#![allow(
    clippy::unwrap_used,
    clippy::panic,
    clippy::print_stdout,
    reason = "a test may end when something is not as it must be, and its writers speak to it over a pipe"
)]

use ctos::time::Clock;
use libtest_mimic::{Arguments, Failed, Trial};
use rustix::process::{Pid, Signal, WaitOptions, kill_process, waitpid};
use sorma_snapshot::{Layout, Place, Reader, Snapshot, Waited, Writer, WriterState};
use std::io::{BufRead, BufReader, Write};
use std::os::unix::{fs::FileExt, process::parent_id};
use std::path::Path;
use std::process::{Child, Command, ExitCode, Stdio};
use std::time::Duration;
use tempfile::TempDir;

/// The first argument of a process that is a writer and not the test.
const WRITER: &str = "writer-of-snapshots";
/// Bytes of a record: so many that a writer spends nearly all of its time in the middle of one.
const BYTES: usize = 1 << 18;
const FLOATS: usize = 6;
const SLOTS: usize = 4;
/// How many writers are killed, unless `CTOS_KILLS` says another number.
const KILLS: usize = 60;
/// Longer than anything here takes on the slowest machine.
const LONG: Duration = Duration::from_secs(60);

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    match arguments.iter().map(String::as_str).collect::<Vec<_>>()[..] {
        [WRITER, folder, "all the time"] => write_all_the_time(folder),
        [WRITER, folder, "when told"] => write_when_told(folder),
        _ => {
            let trials = vec![
                Trial::test(
                    "a_writer_killed_in_mid_write_many_times_tears_nothing",
                    killed_writers,
                ),
                Trial::test(
                    "a_reader_that_sleeps_is_woken_by_another_process",
                    sleeping_reader,
                ),
            ];
            return libtest_mimic::run(&Arguments::from_args(), trials).exit_code();
        }
    }
    ExitCode::SUCCESS
}

fn place(folder: &Path) -> Place {
    Place::under(&folder.join("shm"), "stress").unwrap()
}

/// How many kinds of records there are; no number of slots divides it, so that a slot gets another kind
/// each time.
const KINDS: u64 = 13;

/// The bytes of a record: one value all along, another one in each kind; some records are short.
fn bytes_of(count: u64) -> Vec<u8> {
    let kind = (count % KINDS) as u8;
    vec![kind; if kind == 7 { 100 } else { BYTES }]
}

fn write_all_the_time(folder: &str) {
    let layout = Layout::new(SLOTS, FLOATS).bytes(BYTES);
    let place = place(Path::new(folder));
    let mut writer = Writer::create(&place, "stress", layout, &Clock::real()).unwrap();
    // Made beforehand, so that it spends its time in nothing but writing.
    let kinds: Vec<Vec<u8>> = (0..KINDS).map(bytes_of).collect();
    let parent = parent_id();
    // A test that is ended from outside leaves no writer behind.
    while parent_id() == parent {
        let count = writer.count() + 1;
        let floats = [count as f64; FLOATS];
        writer
            .write(&floats, &kinds[(count % KINDS) as usize])
            .unwrap();
    }
}

fn write_when_told(folder: &str) {
    let place = place(Path::new(folder));
    let layout = Layout::new(SLOTS, FLOATS);
    let mut writer = Writer::create(&place, "stress", layout, &Clock::real()).unwrap();
    println!("ready");
    for _ in std::io::stdin().lines() {
        let count = writer.count() + 1;
        writer.write(&[count as f64; FLOATS], &[]).unwrap();
    }
}

fn start(folder: &TempDir, how: &str) -> Child {
    Command::new(std::env::current_exe().unwrap())
        .args([WRITER, folder.path().to_str().unwrap(), how])
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .spawn()
        .unwrap()
}

fn folder() -> TempDir {
    tempfile::tempdir_in("/dev/shm").unwrap()
}

/// Fails unless a record is one that the writer wrote.
fn hold_whole(record: &Snapshot) {
    let Snapshot {
        count,
        floats,
        opaque,
        ..
    } = record;
    assert_eq!(*floats, [*count as f64; FLOATS], "torn");
    assert!(*opaque == bytes_of(*count), "record {count} is torn");
}

/// Whether a record was begun and not ended: the sequence word of a slot is odd. Where it lies says
/// `docs/snapshots.md`.
fn is_in_mid_write(reader: &Reader) -> bool {
    let stride = (8 * 8 + FLOATS * 8 + BYTES).next_multiple_of(64);
    let file = std::fs::File::open(reader.path()).unwrap();
    (0..SLOTS).any(|slot| {
        let mut word = [0; 8];
        file.read_exact_at(&mut word, (4096 + slot * stride) as u64)
            .unwrap();
        u64::from_ne_bytes(word) % 2 == 1
    })
}

/// Stops the writer in the middle of a record. It waits for that instead of killing at random: a writer that
/// has just woken its reader on a shared core is never there.
fn stop_in_mid_write(writer: &Child, reader: &Reader) {
    let writer = Pid::from_child(writer);
    loop {
        while !is_in_mid_write(reader) {
            std::thread::yield_now();
        }
        kill_process(writer, Signal::STOP).unwrap();
        let (_, status) = waitpid(Some(writer), WaitOptions::UNTRACED)
            .unwrap()
            .unwrap();
        assert!(status.stopped(), "{status:?}");
        if is_in_mid_write(reader) {
            return;
        }
        kill_process(writer, Signal::CONT).unwrap();
    }
}

fn killed_writers() -> Result<(), Failed> {
    let kills = std::env::var("CTOS_KILLS").map_or(KILLS, |kills| kills.parse().unwrap());
    let folder = folder();
    let place = place(folder.path());
    let clock = Clock::real();
    let mut record = Snapshot::default();
    let mut reader: Option<Reader> = None;
    let mut mid_writes = 0;
    let mut last = 0;
    for kill in 0..kills {
        let mut writer = start(&folder, "all the time");
        let generation = kill as u64 + 1;
        let mut taken = 0;
        // Each is killed at another moment, and always while it works.
        while taken < kill % 5 + 1 {
            let Some(reader) = &mut reader else {
                reader = Reader::open(&place, "stress").ok();
                std::thread::yield_now();
                continue;
            };
            match reader.wait(LONG, &clock) {
                Waited::Ready => {}
                // The next one has not begun yet.
                Waited::Ended(WriterState::Dead(_)) => continue,
                other => panic!("{other:?} while a writer is there"),
            }
            // A writer may overtake us for as long as it likes.
            while let Ok(Some(_)) = reader.next(&mut record) {
                hold_whole(&record);
                assert!(record.count > last, "a number came twice");
                assert!(record.generation <= generation);
                last = record.count;
                taken += usize::from(record.generation == generation);
            }
        }
        let reader = reader.as_mut().unwrap();
        // Every other one where it happens to be, the others in the middle of a record.
        if kill % 2 == 0 {
            stop_in_mid_write(&writer, reader);
        }
        writer.kill().unwrap();
        writer.wait().unwrap();
        assert!(matches!(reader.writer(), WriterState::Dead(_)));
        mid_writes += usize::from(is_in_mid_write(reader));
        // All that is whole can still be read, but for the slot in which the writer died.
        let found = reader.history(u64::MAX, &mut record, hold_whole);
        assert!(found >= SLOTS as u64 - 1 || reader.head() < SLOTS as u64);
        assert!(reader.latest(&mut record).unwrap());
        hold_whole(&record);
        last = record.count;
    }
    let reader = reader.unwrap();
    assert_eq!(reader.generation(), kills as u64);
    assert!(
        mid_writes >= kills / 2,
        "only {mid_writes} of {kills} were killed in the middle"
    );
    Ok(())
}

fn sleeping_reader() -> Result<(), Failed> {
    let folder = folder();
    let place = place(folder.path());
    let clock = Clock::real();
    let mut writer = start(&folder, "when told");
    let mut said = String::new();
    BufReader::new(writer.stdout.take().unwrap())
        .read_line(&mut said)
        .unwrap();
    let mut reader = Reader::open(&place, "stress").unwrap();
    let mut told = writer.stdin.take().unwrap();
    let (ask, asked) = std::sync::mpsc::channel::<()>();
    let telling = std::thread::spawn(move || {
        for () in asked {
            told.write_all(b"\n").unwrap();
        }
    });
    let mut record = Snapshot::default();
    for count in 1..=200 {
        ask.send(()).unwrap();
        assert_eq!(reader.wait(LONG, &clock), Waited::Ready);
        assert_eq!(reader.next(&mut record).unwrap(), Some(0));
        assert_eq!((record.count, record.floats[0]), (count, count as f64));
    }
    // Its end of the pipe closed, the writer ends orderly, and a reader that sleeps is told.
    drop(ask);
    telling.join().unwrap();
    assert_eq!(
        reader.wait(LONG, &clock),
        Waited::Ended(WriterState::Closed)
    );
    assert!(writer.wait().unwrap().success());
    assert!(
        Reader::open(&place, "stress").is_err(),
        "nothing is left behind"
    );
    Ok(())
}
