//! Snapshot buffers: what writing and reading a record costs, beside bare copies of the same bytes.

#![allow(
    clippy::unwrap_used,
    reason = "a benchmark may end when the machine refuses something"
)]

use ctos::time::Clock;
use divan::{Bencher, black_box, counter::BytesCount};
use sorma_snapshot::{Layout, Place, Reader, Snapshot, Writer};

/// Bytes of a large frame.
const FRAME: usize = 1 << 20;
/// Slots of each buffer.
const SLOTS: usize = 8;

fn main() {
    divan::main();
}

fn buffer(name: &str, floats: usize, bytes: usize) -> (Writer, Reader) {
    let place = Place::of_app("bench").unwrap();
    let name = &format!("{name}-{}", std::process::id());
    let layout = Layout::new(SLOTS, floats).bytes(bytes);
    let writer = Writer::create(&place, name, layout, &Clock::real()).unwrap();
    let reader = Reader::open(&place, name).unwrap();
    (writer, reader)
}

#[divan::bench]
fn write_64_floats(bencher: Bencher<'_, '_>) {
    let (mut writer, _reader) = buffer("w64", 64, 0);
    let floats = [1.5; 64];
    bencher.bench_local(|| writer.write(black_box(&floats), &[]).unwrap());
}

#[divan::bench]
fn stamp(bencher: Bencher<'_, '_>) {
    let clock = Clock::real();
    bencher.bench_local(|| clock.now());
}

#[divan::bench]
fn read_latest_64_floats(bencher: Bencher<'_, '_>) {
    let (mut writer, mut reader) = buffer("r64", 64, 0);
    writer.write(&[1.5; 64], &[]).unwrap();
    let mut record = Snapshot::default();
    bencher.bench_local(|| reader.latest(black_box(&mut record)).unwrap());
}

#[divan::bench]
fn write_1_mb(bencher: Bencher<'_, '_>) {
    let (mut writer, _reader) = buffer("w1m", 0, FRAME);
    let frame = vec![7_u8; FRAME];
    bencher
        .counter(BytesCount::new(FRAME))
        .bench_local(|| writer.write(&[], black_box(&frame)).unwrap());
}

/// The same number of places, so that the caches help neither of the two more.
#[divan::bench]
fn memcpy_1_mb(bencher: Bencher<'_, '_>) {
    let mut slots = vec![vec![0_u8; FRAME]; SLOTS];
    let frame = vec![7_u8; FRAME];
    let mut next = 0;
    bencher.counter(BytesCount::new(FRAME)).bench_local(|| {
        slots[next % SLOTS].copy_from_slice(black_box(&frame));
        next += 1;
        black_box(&mut slots[0][0]);
    });
}

#[divan::bench]
fn read_latest_1_mb(bencher: Bencher<'_, '_>) {
    let (mut writer, mut reader) = buffer("r1m", 0, FRAME);
    writer.write(&[], &vec![7_u8; FRAME]).unwrap();
    let mut record = Snapshot::default();
    bencher
        .counter(BytesCount::new(FRAME))
        .bench_local(|| reader.latest(black_box(&mut record)).unwrap());
}
