//! The rings in one process, where Miri can watch, and through a passed file.

use proptest::prelude::*;
use rustix::event::{PollFd, PollFlags};

use super::*;

fn write(sender: &Sender, bytes: &[u8]) -> io::Result<usize> {
    sender.try_write(&[IoSlice::new(bytes)])
}

/// Sleeps at the bell until there is work, as the reactor does.
fn wait(receiver: &Receiver, bell: &OwnedFd) {
    receiver.set_asleep(true);
    fence(Ordering::SeqCst);
    if !receiver.has_work() {
        let mut fds = [PollFd::new(bell, PollFlags::IN)];
        rustix::event::poll(&mut fds, None).unwrap();
    }
    receiver.set_asleep(false);
    let _ = rustix::io::read(bell, &mut [0; 8]);
}

#[test]
fn bytes_arrive_in_order_however_they_are_cut_and_wrapped() {
    let (maker, guest) = Shared::pair();
    let (sender, _room, _) = maker.split();
    let (_back, receiver, _) = guest.split();
    let total = if cfg!(miri) { RING / 8 } else { 3 * RING + 17 };
    let mut sent = 0;
    let mut read = 0;
    let mut chunk = vec![0; 5_000];
    let mut size = 1;
    while read < total {
        size = (size * 7 + 3) % 4_099 + 1;
        let bytes: Vec<u8> = (sent..(sent + size).min(total))
            .map(|at| (at % 251) as u8)
            .collect();
        if !bytes.is_empty() {
            sent += write(&sender, &bytes).unwrap();
        }
        let count = receiver.read(&mut chunk[..size]).unwrap();
        for byte in &chunk[..count] {
            assert_eq!(*byte, (read % 251) as u8);
            read += 1;
        }
    }
    assert_eq!((sent, receiver.read(&mut chunk)), (total, Ok(0)));
}

#[test]
fn a_full_ring_takes_no_more_until_something_was_read() {
    let (maker, guest) = Shared::pair();
    let (sender, _receiver, _) = maker.split();
    let (_sender, receiver, _) = guest.split();
    let all = vec![1; RING + 1];
    assert_eq!(write(&sender, &all).unwrap(), RING);
    let full = write(&sender, &all).unwrap_err();
    assert_eq!(full.kind(), io::ErrorKind::WouldBlock);
    let mut chunk = [0; 10];
    assert_eq!(receiver.read(&mut chunk).unwrap(), 10);
    assert_eq!(write(&sender, &all).unwrap(), 10);
}

#[test]
fn two_threads_that_sleep_never_miss_each_other() {
    // Each round trip puts both to sleep; a lost ring would hang the test.
    let rounds: u32 = if cfg!(miri) { 20 } else { 20_000 };
    let (maker, guest) = Shared::pair();
    let play = move |shared: Shared, begins: bool| {
        let (sender, receiver, bell) = shared.split();
        let mut number = 0_u32;
        if begins {
            write(&sender, &number.to_le_bytes()).unwrap();
        }
        let mut bytes = [0; 4];
        let mut filled = 0;
        while number < rounds {
            let count = receiver.read(&mut bytes[filled..]).unwrap();
            filled += count;
            if count == 0 {
                wait(&receiver, &bell);
            }
            if filled == 4 {
                filled = 0;
                number = u32::from_le_bytes(bytes) + 1;
                write(&sender, &number.to_le_bytes()).unwrap();
            }
        }
    };
    let other = std::thread::spawn(move || play(guest, false));
    play(maker, true);
    other.join().unwrap();
}

#[test]
fn a_writer_that_waits_for_room_is_woken_by_it() {
    let total = if cfg!(miri) { 2 * RING } else { 64 * RING };
    let (maker, guest) = Shared::pair();
    let writer = std::thread::spawn(move || {
        let (sender, room, bell) = maker.split();
        let bytes = vec![7; 100_000];
        let mut left = total;
        while left > 0 {
            match write(&sender, &bytes[..left.min(bytes.len())]) {
                Ok(count) => left -= count,
                Err(_) => wait(&room, &bell),
            }
        }
    });
    let (_sender, receiver, bell) = guest.split();
    let mut chunk = vec![0; 70_000];
    let mut read = 0;
    while read < total {
        match receiver.read(&mut chunk).unwrap() {
            0 => wait(&receiver, &bell),
            count => read += count,
        }
    }
    writer.join().unwrap();
}

proptest! {
    #[test]
    fn positions_that_cannot_be_are_found_and_no_byte_is_read(written: u64, read: u64) {
        let (maker, guest) = Shared::pair();
        let (sender, _, _) = maker.split();
        let (_, receiver, _) = guest.split();
        sender.ring.field(WRITTEN).store(written, Ordering::SeqCst);
        sender.ring.field(READ).store(read, Ordering::SeqCst);
        let mut chunk = [0; 16];
        prop_assert_eq!(receiver.read(&mut chunk).is_err(), written > RING as u64);
        let refused = write(&sender, &chunk).map_err(|error| error.kind());
        if read != 0 {
            prop_assert_eq!(refused, Err(io::ErrorKind::InvalidData));
        }
    }
}

#[cfg(not(miri))]
#[test]
fn memory_that_was_passed_is_the_same_and_memory_that_could_shrink_is_refused() {
    let (maker, passed) = Shared::make().unwrap();
    let [file, ..] = &passed;
    let file = file.try_clone().unwrap();
    let guest = Shared::take(passed).unwrap();
    let (sender, _, _) = maker.split();
    let (_, receiver, _) = guest.split();
    write(&sender, b"hello").unwrap();
    let mut chunk = [0; 16];
    assert_eq!(receiver.read(&mut chunk).unwrap(), 5);
    assert_eq!(&chunk[..5], b"hello");
    assert!(rustix::fs::ftruncate(&file, 0).is_err());
    let with = |file: OwnedFd| [file, bell().unwrap(), bell().unwrap()];
    let loose = rustix::fs::memfd_create("loose", MemfdFlags::ALLOW_SEALING).unwrap();
    rustix::fs::ftruncate(&loose, SIZE as u64).unwrap();
    assert!(Shared::take(with(loose)).is_err());
    let small = rustix::fs::memfd_create("small", MemfdFlags::ALLOW_SEALING).unwrap();
    rustix::fs::fcntl_add_seals(&small, SEALS).unwrap();
    assert!(Shared::take(with(small)).is_err());
}
