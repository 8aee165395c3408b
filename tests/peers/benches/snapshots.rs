//! The cost of handing on a record with snapshot buffers and with iceoryx2, in one process, so that
//! no scheduler matters. Of iceoryx2 these are publish-subscribe with an overwriting history of the
//! same depth, and the blackboard, which holds the latest value only.
//!
//! `cargo bench -p peers --features iceoryx2`.

#![allow(
    clippy::unwrap_used,
    reason = "a benchmark may end when the machine refuses something"
)]

use ctos::time::Clock;
use divan::{Bencher, black_box};
use iceoryx2::prelude::*;
use sorma::snapshot::{Layout, Place, Reader, Snapshot, Writer};

const FRAME: usize = 1 << 20;
const SLOTS: usize = 8;

fn main() {
    divan::main();
}

fn ours(name: &str, floats: usize, bytes: usize) -> (Writer, Reader) {
    let place = Place::of_app("bench").unwrap();
    let name = &format!("{name}-{}", std::process::id());
    let layout = Layout::new(SLOTS, floats).bytes(bytes);
    let writer = Writer::create(&place, name, layout, &Clock::real()).unwrap();
    let reader = Reader::open(&place, name).unwrap();
    (writer, reader)
}

fn node() -> Node<ipc::Service> {
    set_log_level(LogLevel::Error);
    NodeBuilder::new().create::<ipc::Service>().unwrap()
}

fn service_name(name: &str) -> ServiceName {
    format!("sorma/{name}/{}", std::process::id())
        .as_str()
        .try_into()
        .unwrap()
}

#[divan::bench]
fn write_and_take_64_floats_ours(bencher: Bencher<'_, '_>) {
    let (mut writer, mut reader) = ours("a", 64, 0);
    let mut record = Snapshot::default();
    let floats = [1.5; 64];
    bencher.bench_local(|| {
        writer.write(black_box(&floats), &[]).unwrap();
        reader.next(&mut record).unwrap().unwrap()
    });
}

#[divan::bench]
fn write_and_take_64_floats_iceoryx2(bencher: Bencher<'_, '_>) {
    let node = node();
    let service = node
        .service_builder(&service_name("a"))
        .publish_subscribe::<[f64; 64]>()
        .subscriber_max_buffer_size(SLOTS)
        .history_size(SLOTS)
        .open_or_create()
        .unwrap();
    let publisher = service.publisher_builder().create().unwrap();
    let subscriber = service.subscriber_builder().create().unwrap();
    let floats = [1.5; 64];
    let mut into = [0.0; 64];
    bencher.bench_local(|| {
        let sample = publisher.loan_uninit().unwrap();
        sample.write_payload(black_box(floats)).send().unwrap();
        let sample = subscriber.receive().unwrap().unwrap();
        into.copy_from_slice(&*sample);
        black_box(&into);
    });
}

#[divan::bench]
fn write_64_floats_ours(bencher: Bencher<'_, '_>) {
    let (mut writer, _reader) = ours("b", 64, 0);
    let floats = [1.5; 64];
    bencher.bench_local(|| writer.write(black_box(&floats), &[]).unwrap());
}

/// The subscriber is there and does not take: its oldest sample is thrown out each time.
#[divan::bench]
fn write_64_floats_iceoryx2(bencher: Bencher<'_, '_>) {
    let node = node();
    let service = node
        .service_builder(&service_name("b"))
        .publish_subscribe::<[f64; 64]>()
        .subscriber_max_buffer_size(SLOTS)
        .history_size(SLOTS)
        .enable_safe_overflow(true)
        .open_or_create()
        .unwrap();
    let publisher = service.publisher_builder().create().unwrap();
    let _subscriber = service.subscriber_builder().create().unwrap();
    let floats = [1.5; 64];
    bencher.bench_local(|| {
        let sample = publisher.loan_uninit().unwrap();
        sample.write_payload(black_box(floats)).send().unwrap()
    });
}

#[divan::bench]
fn write_64_floats_iceoryx2_blackboard(bencher: Bencher<'_, '_>) {
    let node = node();
    let service = node
        .service_builder(&service_name("c"))
        .blackboard_creator::<u64>()
        .add::<[f64; 64]>(1, [0.0; 64])
        .create()
        .unwrap();
    let writer = service.writer_builder().create().unwrap();
    let entry = writer.entry::<[f64; 64]>(&1).unwrap();
    let floats = [1.5; 64];
    bencher.bench_local(|| entry.update_with_copy(black_box(floats)));
}

#[divan::bench]
fn read_latest_64_floats_ours(bencher: Bencher<'_, '_>) {
    let (mut writer, mut reader) = ours("d", 64, 0);
    writer.write(&[1.5; 64], &[]).unwrap();
    let mut record = Snapshot::default();
    bencher.bench_local(|| reader.latest(black_box(&mut record)).unwrap());
}

#[divan::bench]
fn read_latest_64_floats_iceoryx2_blackboard(bencher: Bencher<'_, '_>) {
    let node = node();
    let service = node
        .service_builder(&service_name("d"))
        .blackboard_creator::<u64>()
        .add::<[f64; 64]>(1, [0.0; 64])
        .create()
        .unwrap();
    let reader = service.reader_builder().create().unwrap();
    let entry = reader.entry::<[f64; 64]>(&1).unwrap();
    bencher.bench_local(|| black_box(*entry.get()));
}

#[divan::bench]
fn write_1_mb_ours(bencher: Bencher<'_, '_>) {
    let (mut writer, _reader) = ours("e", 0, FRAME);
    let frame = vec![7_u8; FRAME];
    bencher.bench_local(|| writer.write(&[], black_box(&frame)).unwrap());
}

#[divan::bench]
fn write_1_mb_iceoryx2(bencher: Bencher<'_, '_>) {
    let node = node();
    let service = node
        .service_builder(&service_name("e"))
        .publish_subscribe::<[u8]>()
        .subscriber_max_buffer_size(SLOTS)
        .history_size(SLOTS)
        .enable_safe_overflow(true)
        .open_or_create()
        .unwrap();
    let publisher = service
        .publisher_builder()
        .initial_max_slice_len(FRAME)
        .create()
        .unwrap();
    let _subscriber = service.subscriber_builder().create().unwrap();
    let frame = vec![7_u8; FRAME];
    bencher.bench_local(|| {
        let sample = publisher.loan_slice_uninit(FRAME).unwrap();
        sample.write_from_slice(black_box(&frame)).send().unwrap()
    });
}

#[divan::bench]
fn memcpy_1_mb(bencher: Bencher<'_, '_>) {
    let mut slots = vec![vec![0_u8; FRAME]; SLOTS];
    let frame = vec![7_u8; FRAME];
    let mut next = 0;
    bencher.bench_local(|| {
        slots[next % SLOTS].copy_from_slice(black_box(&frame));
        next += 1;
        black_box(&mut slots[0][0]);
    });
}
