//! The 20 bytes in front of every message: receiver, sender, command, flags, data size.

use std::fmt;

use bitflags::bitflags;
use serde::Serialize;

/// The number of a chassis in its app. Processors (8 bits) and slots (24) have other types, so that none is taken for another.
pub type ChassisNumber = u16;

/// Task id: 48 bits that route a message. Chassis, processor on it, slot on the processor. JSON holds it as a number.
#[derive(
    Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, serde::Deserialize, Default,
)]
pub struct Tid(u64);

impl Tid {
    /// The last slot of a processor.
    pub const LAST_SLOT: u32 = 0xff_ffff;

    /// The task in `slot`, of which 24 bits count, of `processor` of `chassis`.
    #[must_use]
    pub const fn new(chassis: ChassisNumber, processor: u8, slot: u32) -> Self {
        let slot = (slot & Self::LAST_SLOT) as u64;
        Self(((chassis as u64) << 32) | ((processor as u64) << 24) | slot)
    }

    /// From the 48 low bits.
    #[must_use]
    pub const fn from_bits(bits: u64) -> Self {
        Self(bits & 0xffff_ffff_ffff)
    }

    /// The 48 bits as they stand in the header.
    #[must_use]
    pub const fn bits(self) -> u64 {
        self.0
    }

    /// Which chassis.
    #[must_use]
    pub const fn chassis(self) -> ChassisNumber {
        (self.0 >> 32) as ChassisNumber
    }

    /// Which processor of the chassis.
    #[must_use]
    pub const fn processor(self) -> u8 {
        (self.0 >> 24) as u8
    }

    /// Which slot of the processor.
    #[must_use]
    pub const fn slot(self) -> u32 {
        self.0 as u32 & Self::LAST_SLOT
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

/// The 20 bytes in front of every message.
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
    pub const BYTES: usize = 20;

    /// The 20 bytes, little-endian: the two ids with 6 each, command and flags with 2, the size with 4.
    #[must_use]
    pub fn encode(&self) -> [u8; Self::BYTES] {
        let route = u128::from(self.to.bits()) | u128::from(self.from.bits()) << 48;
        let flags = u128::from(self.flags.bits()) << 112;
        let most = route | u128::from(self.command) << 96 | flags;
        let mut bytes = [0; Self::BYTES];
        bytes[..16].copy_from_slice(&most.to_le_bytes());
        bytes[16..].copy_from_slice(&self.size.to_le_bytes());
        bytes
    }

    /// Reads 20 bytes.
    #[must_use]
    pub fn decode(bytes: &[u8; Self::BYTES]) -> Self {
        let (mut most, mut size) = ([0; 16], [0; 4]);
        most.copy_from_slice(&bytes[..16]);
        size.copy_from_slice(&bytes[16..]);
        let most = u128::from_le_bytes(most);
        Self {
            to: Tid::from_bits(most as u64),
            from: Tid::from_bits((most >> 48) as u64),
            command: (most >> 96) as u16,
            flags: Flags::from_bits_retain((most >> 112) as u16),
            size: u32::from_le_bytes(size),
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
        fn a_header_is_twenty_bytes_and_survives_them(
            to: u64, from: u64, command: u16, flags: u16, size: u32
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
        fn any_twenty_bytes_are_those_of_the_header_that_they_are_read_as(bytes: [u8; Header::BYTES]) {
            prop_assert_eq!(Header::decode(&bytes).encode(), bytes);
        }

        #[test]
        fn a_task_id_survives_its_bits_its_encoding_and_json(bits: u64) {
            let tid = Tid::from_bits(bits);
            prop_assert_eq!(tid.bits(), bits & ((1 << 48) - 1));
            prop_assert_eq!(Tid::new(tid.chassis(), tid.processor(), tid.slot()), tid);
            let bytes = postcard::to_stdvec(&tid).unwrap();
            prop_assert_eq!(postcard::from_bytes::<Tid>(&bytes).unwrap(), tid);
            // Every such number is one of the floats that JSON means.
            prop_assert_eq!(tid.bits() as f64 as u64, tid.bits());
        }

        #[test]
        fn ids_stand_in_the_order_of_chassis_processor_and_slot(
            one: (ChassisNumber, u8, u32), other: (ChassisNumber, u8, u32)
        ) {
            let part = |(chassis, processor, slot)| (chassis, processor, slot & Tid::LAST_SLOT);
            let tid = |(chassis, processor, slot)| Tid::new(chassis, processor, slot);
            prop_assert_eq!(tid(one).cmp(&tid(other)), part(one).cmp(&part(other)));
        }

        #[test]
        fn a_task_id_keeps_its_three_parts(chassis: u16, processor: u8, slot in 0..=Tid::LAST_SLOT) {
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
