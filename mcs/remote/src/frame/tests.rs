use proptest::prelude::*;

use super::*;

/// A frame with something in every field.
fn full() -> Frame {
    let mut frame = Frame::new(Kind::State, 6);
    frame.power = Power::Released;
    (frame.session, frame.receiver) = (0x0102_0304, 0x0506_0708);
    (frame.sequence, frame.answers, frame.stamp_ns) = (9, 8, 1_000_000_007);
    (frame.period_ns, frame.watchdog_ns) = (4_500_000, 100_000_000);
    frame.trouble = Trouble::Late;
    for (index, row) in frame.rows_mut().iter_mut().enumerate() {
        row.values = [0.5 * index as f64, -1.5];
    }
    frame
}

/// The bytes with the checksum that they should have.
pub(crate) fn summed(mut bytes: [u8; SIZE]) -> [u8; SIZE] {
    let checksum = crc32fast::hash(&bytes[..CHECKSUM]);
    bytes[CHECKSUM..].copy_from_slice(&checksum.to_le_bytes());
    bytes
}

#[test]
fn every_field_stands_where_the_page_says() {
    let bytes = full().encode();
    assert_eq!(&bytes[..8], b"mcsr\x01\x02\x06\x02");
    assert_eq!(bytes[8..12], [4, 3, 2, 1]);
    assert_eq!(bytes[12..16], [8, 7, 6, 5]);
    assert_eq!((bytes[16], bytes[24]), (9, 8));
    assert_eq!(bytes[32..40], 1_000_000_007_u64.to_le_bytes());
    assert_eq!(bytes[40..44], 4_500_000_u32.to_le_bytes());
    assert_eq!(bytes[44..48], 100_000_000_u32.to_le_bytes());
    assert_eq!(bytes[48..56], [1, 0, 0, 0, 0, 0, 0, 0]);
    assert_eq!(bytes[56..63], [10, 10, 10, 10, 10, 10, 0]);
    assert_eq!(bytes[88 + 16..88 + 24], 0.5_f64.to_le_bytes());
    assert_eq!(bytes[88 + 24..88 + 32], (-1.5_f64).to_le_bytes());
    // The check value of CRC-32 as Ethernet and zlib have it.
    assert_eq!(crc32fast::hash(b"123456789"), 0xcbf4_3926);
    assert_eq!(Frame::decode(&bytes), Ok(full()));
}

#[test]
fn what_is_no_frame_is_refused_with_the_first_thing_that_is_wrong() {
    let good = full().encode();
    let changed = |at: usize, byte: u8| {
        let mut bytes = good;
        bytes[at] = byte;
        bytes
    };
    let field = |field, found| FrameError::Field { field, found };
    let cases = [
        (changed(0, b'M').to_vec(), FrameError::Magic),
        (changed(4, 2).to_vec(), FrameError::Version { found: 2 }),
        (changed(100, 1).to_vec(), FrameError::Checksum),
        (changed(603, !good[603]).to_vec(), FrameError::Checksum),
        (good[..603].to_vec(), FrameError::Length { found: 603 }),
        (Vec::new(), FrameError::Length { found: 0 }),
        (
            [&good[..], &[0]].concat(),
            FrameError::Length { found: 605 },
        ),
        (summed(changed(5, 3)).to_vec(), field("kind", 3)),
        (summed(changed(6, 0)).to_vec(), field("slots", 0)),
        (summed(changed(6, 33)).to_vec(), field("slots", 33)),
        (summed(changed(7, 3)).to_vec(), field("power", 3)),
        (summed(changed(48, 4)).to_vec(), field("trouble", 4)),
        (summed(changed(57, 0)).to_vec(), field("mode", 0)),
        (summed(changed(55, 1)).to_vec(), FrameError::Unused),
        (summed(changed(62, 10)).to_vec(), FrameError::Unused),
        (summed(changed(88 + 96, 1)).to_vec(), FrameError::Unused),
        (summed(changed(599, 1)).to_vec(), FrameError::Unused),
    ];
    for (bytes, error) in cases {
        assert_eq!(Frame::decode(&bytes), Err(error));
    }
}

proptest! {
    #[test]
    fn one_bit_that_is_changed_anywhere_is_found(at in 0..8 * SIZE) {
        let mut bytes = full().encode();
        bytes[at / 8] ^= 1 << (at % 8);
        prop_assert!(Frame::decode(&bytes).is_err());
    }

    #[test]
    fn a_frame_is_read_as_it_was_written(slots in 1..=MAX_SLOTS, numbers in proptest::array::uniform6(any::<u64>()), value in any::<f64>()) {
        let mut frame = Frame::new(Kind::Command, slots);
        let [a, b, c, d, e, f] = numbers;
        (frame.session, frame.receiver, frame.period_ns) = (a as u32, b as u32, c as u32);
        (frame.sequence, frame.answers, frame.stamp_ns) = (d, e, f);
        for row in frame.rows_mut() {
            row.values = [value, -value];
        }
        // By bytes, for a number that is none is unlike itself.
        let bytes = frame.encode();
        prop_assert_eq!(Frame::decode(&bytes).unwrap().encode(), bytes);
    }
}
