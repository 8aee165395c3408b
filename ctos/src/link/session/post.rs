//! How frames are posted to a session: which lane they take, and what becomes of those for which there
//! is no room.

use super::{
    Session,
    line::{gives_up, is_fence, lane_of_request},
    window::{Lane, NoRoom},
};
use crate::{
    call::Fault,
    link::{Counts, Frame, Full, Link},
    message::{Flags, SYSTEM_COMMANDS},
};

/// Faults are let through when there is no room for answers; they are small.
const SMALL: usize = 4 * 1024;

impl Link for Session {
    fn post(&self, frame: Frame) -> Result<(), Full> {
        let lane = lane_of(&frame);
        let size = frame.body.len();
        tracing::trace!(
            target: "ctos::link",
            from = %frame.header.from,
            to = %frame.header.to,
            command = frame.header.command,
            bytes = size,
            "out"
        );
        let mut result = Ok(());
        self.put(|core, now| {
            let counts = &mut core.counts;
            match lane {
                Lane::Data | Lane::Urgent => {
                    if let Err(NoRoom { held }) = core.line.send(frame, &mut core.outgoing, now) {
                        counts.refused += 1;
                        result = Err(Full { bytes: held });
                        return;
                    }
                }
                // One that still waits for room is not sent at all.
                Lane::Control if gives_up(&frame) && core.line.withdraw(frame.call) => {}
                Lane::Control => {
                    let frame = match core.outgoing.has_room(lane, size) {
                        Ok(()) => frame,
                        Err(NoRoom { held }) => {
                            counts.refused += 1;
                            without_body(frame, held)
                        }
                    };
                    core.outgoing.put_frame(frame, lane, now);
                }
            }
            counts.frames_out += 1;
            counts.bytes_out += size as u64;
        });
        result
    }

    fn counts(&self) -> Counts {
        self.counts()
    }
}

/// Answers and the runtime's own messages are never kept out by requests, but for a fence, which follows them.
fn lane_of(frame: &Frame) -> Lane {
    let flags = frame.header.flags;
    let answers = flags.contains(Flags::REPLY) || flags.contains(Flags::ABANDONED);
    let of_runtime = frame.header.command >= SYSTEM_COMMANDS && !is_fence(frame);
    if answers || of_runtime {
        Lane::Control
    } else {
        lane_of_request(frame)
    }
}

/// A control frame for which there is no room: what is small goes anyway, a large answer becomes the
/// fault that says so.
fn without_body(mut frame: Frame, held: usize) -> Frame {
    if frame.body.len() <= SMALL || !frame.header.flags.contains(Flags::REPLY) {
        return frame;
    }
    let fault = Fault::LinkFull { bytes: held };
    // A fault is plain data; should it fail to encode, the empty body is read as one.
    frame.body = postcard::to_stdvec(&fault).unwrap_or_default().into();
    frame.header.flags = frame.header.flags.with(Flags::FAULT);
    frame.header.size = u32::try_from(frame.body.len()).unwrap_or(u32::MAX);
    frame
}
