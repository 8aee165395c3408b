//! Whatever comes from a socket is taken in or refused.

use std::{cell::RefCell, time::Duration};

use mcs::driver::{Power, SlotReading};
use mutate::Mutator;

use crate::{
    frame::{Frame, Kind, SIZE, tests::summed},
    peer::Peer,
    session::Session,
};

fn mutator() -> Mutator {
    Mutator {
        corpus: concat!(env!("CARGO_MANIFEST_DIR"), "/tests/corpus").into(),
        words: &[
            "mcsr",
            "mcsr\u{1}\u{1}\u{2}\u{2}",
            "mcsr\u{1}\u{2}\u{2}\u{0}",
        ],
        longest: 2 * SIZE,
        seconds: 2.0,
        targets: 2,
    }
}

/// A driver's and a peer's side after one exchange, and the bytes of both.
fn met() -> (Session, Peer, Vec<Vec<u8>>) {
    let mut session = Session::new(7, vec![1.0; 2], Duration::from_millis(20));
    let mut peer = Peer::new(11, 2);
    let period = Duration::from_millis(4);
    let command = session
        .command(&[0.5, -0.5], Power::Off, period, 1)
        .encode();
    peer.take(&command).unwrap();
    let answer = peer
        .answer(Power::Off, [[0.1, 0.0], [0.2, 0.0]], 2)
        .encode();
    session.take(&answer);
    let own = vec![command.to_vec(), answer.to_vec()];
    (session, peer, own)
}

/// The bytes, and the same as long as a frame and with its checksum: few mutations would come past it.
fn with_mended(bytes: &[u8], mut target: impl FnMut(&[u8])) {
    let mut mended = [0; SIZE];
    let length = bytes.len().min(SIZE);
    mended[..length].copy_from_slice(&bytes[..length]);
    target(bytes);
    target(&summed(mended));
}

#[test]
fn frames_take_any_bytes() {
    let (_, _, own) = met();
    mutator().play("frame", own, |bytes| {
        with_mended(bytes, |bytes| {
            if let Ok(frame) = Frame::decode(bytes) {
                assert_eq!(
                    frame.encode(),
                    bytes,
                    "what is accepted is written as it came"
                );
            }
        });
    });
}

#[test]
fn both_sides_take_any_bytes_and_what_is_read_is_finite() {
    let (session, peer, own) = met();
    let sides = RefCell::new((session, peer));
    mutator().play("session", own, |bytes| {
        let (session, peer) = &mut *sides.borrow_mut();
        with_mended(bytes, |bytes| {
            session.take(bytes);
            // What is refused is not answered.
            if let Ok(order) = peer.take(bytes) {
                assert!(order.commands.iter().all(|torque| torque.is_finite()));
                assert_eq!(Frame::decode(bytes).unwrap().kind, Kind::Command);
            }
        });
        let mut readings = [SlotReading::default(); 2];
        if session.read(&mut readings).is_ok() {
            let mut numbers = readings
                .iter()
                .flat_map(|slot| [slot.position, slot.velocity]);
            assert!(numbers.all(f64::is_finite));
        }
    });
}
