//! Frames for the tests of this folder.

use crate::{
    frame::{Frame, NO_DEADLINE},
    message::{Flags, Header, Tid},
};

/// A request with this data.
pub(in crate::session) fn request(body: Vec<u8>) -> Frame {
    Frame {
        header: Header {
            to: Tid::new(1, 1, 0),
            from: Tid::new(2, 1, 0),
            command: 1,
            flags: Flags::REPLY_WAIT,
            size: u32::try_from(body.len()).unwrap(),
        },
        call: 1,
        trace: 0,
        left_ns: NO_DEADLINE,
        body: body.into(),
    }
}

/// A frame in one piece, as a packet carries it.
pub(in crate::session) fn bytes_of(frame: &Frame) -> Vec<u8> {
    [&frame.head()[..], &frame.body.clone().into_vec()].concat()
}
