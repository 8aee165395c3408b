//! The 16 bytes in front of every message: receiver, sender, command, flags, data size.

use std::fmt;

use bitflags::bitflags;
use serde::Serialize;

/// Task id: 32 bits that route a message. Chassis, processor on it, slot on the processor.
#[derive(
    Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, serde::Deserialize, Default,
)]
pub struct Tid(u32);

impl Tid {
    /// The task in `slot` of `processor` of `chassis`.
    #[must_use]
    pub const fn new(chassis: u8, processor: u8, slot: u16) -> Self {
        Self(((chassis as u32) << 24) | ((processor as u32) << 16) | slot as u32)
    }

    /// From the 32 bits of the header.
    #[must_use]
    pub const fn from_bits(bits: u32) -> Self {
        Self(bits)
    }

    /// The 32 bits as they stand in the header.
    #[must_use]
    pub const fn bits(self) -> u32 {
        self.0
    }

    /// Which chassis.
    #[must_use]
    pub const fn chassis(self) -> u8 {
        (self.0 >> 24) as u8
    }

    /// Which processor of the chassis.
    #[must_use]
    pub const fn processor(self) -> u8 {
        (self.0 >> 16) as u8
    }

    /// Which slot of the processor.
    #[must_use]
    pub const fn slot(self) -> u16 {
        self.0 as u16
    }
}

impl fmt::Display for Tid {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}.{}.{}", self.chassis(), self.processor(), self.slot())
    }
}

impl fmt::Debug for Tid {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Tid({self})")
    }
}

bitflags! {
    /// Message handling flags.
    #[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
    pub struct Flags: u16 {
        /// Nothing special.
        const NONE = 0;
        /// Handled before messages without this flag that wait at the same task.
        const HIGH_PRIORITY = 1;
        /// The sender waits for a reply.
        const REPLY_WAIT = 1 << 1;
        /// The receiver owns the data; set on every message of this runtime, where data is moved.
        const OWNED = 1 << 2;
        /// This is the reply to a message.
        const REPLY = 1 << 3;
        /// The reply is a fault instead of a value.
        const FAULT = 1 << 4;
        /// A one-way message whose sender waits until the receiver's queue has taken it.
        const ACCEPT_WAIT = 1 << 5;
        /// The sender of a request no longer waits for its answer. Between chassis only.
        const ABANDONED = 1 << 6;
        /// It came by the place where its receiver was before it moved.
        const FORWARDED = 1 << 7;
    }
}

/// The 16 bytes in front of every message.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Header {
    /// Receiver.
    pub to: Tid,
    /// Sender.
    pub from: Tid,
    /// What the receiver shall do.
    pub command: u16,
    /// How the message is handled.
    pub flags: Flags,
    /// Bytes of data that follow on the wire; 0 inside a chassis, where data is a pointer.
    pub size: u32,
}

impl Header {
    /// Length on the wire.
    pub const BYTES: usize = 16;

    /// The 16 bytes, little-endian.
    #[must_use]
    pub fn encode(&self) -> [u8; Self::BYTES] {
        let mut bytes = [0; Self::BYTES];
        bytes[0..4].copy_from_slice(&self.to.bits().to_le_bytes());
        bytes[4..8].copy_from_slice(&self.from.bits().to_le_bytes());
        bytes[8..10].copy_from_slice(&self.command.to_le_bytes());
        bytes[10..12].copy_from_slice(&self.flags.bits().to_le_bytes());
        bytes[12..16].copy_from_slice(&self.size.to_le_bytes());
        bytes
    }

    /// Reads 16 bytes.
    #[must_use]
    pub fn decode(bytes: &[u8; Self::BYTES]) -> Self {
        let all = u128::from_le_bytes(*bytes);
        Self {
            to: Tid::from_bits(all as u32),
            from: Tid::from_bits((all >> 32) as u32),
            command: (all >> 64) as u16,
            flags: Flags::from_bits_retain((all >> 80) as u16),
            size: (all >> 96) as u32,
        }
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::Data;

    proptest! {
        #[test]
        fn a_header_is_sixteen_bytes_and_survives_them(
            to: u32, from: u32, command: u16, flags: u16, size: u32
        ) {
            let header = Header {
                to: Tid::from_bits(to),
                from: Tid::from_bits(from),
                command,
                flags: Flags::from_bits_retain(flags),
                size,
            };
            prop_assert_eq!(Header::decode(&header.encode()), header);
        }

        #[test]
        fn a_task_id_keeps_its_three_parts(chassis: u8, processor: u8, slot: u16) {
            let tid = Tid::new(chassis, processor, slot);
            prop_assert_eq!(
                (tid.chassis(), tid.processor(), tid.slot()),
                (chassis, processor, slot)
            );
        }

        #[test]
        fn rubbish_bytes_never_panic(bytes in proptest::collection::vec(any::<u8>(), 0..64)) {
            let _ = Data::Bytes(bytes).take::<(String, Vec<f64>)>();
        }
    }

    #[test]
    fn data_is_the_same_moved_or_encoded() {
        let value = (String::from("spot"), vec![1.5_f64, 2.5]);
        let moved: (String, Vec<f64>) = Data::of(value.clone()).take().unwrap();
        let bytes = Data::of(value.clone()).into_bytes().unwrap();
        let decoded: (String, Vec<f64>) = Data::Bytes(bytes).take().unwrap();
        assert_eq!((moved, decoded), (value.clone(), value));
    }

    #[test]
    fn bytes_too_many_are_refused() {
        let mut bytes = Data::of(7_u8).into_bytes().unwrap();
        bytes.push(0);
        let error = Data::Bytes(bytes).take::<u8>().unwrap_err();
        assert!(error.to_string().contains("1 bytes too many"));
    }
}
