//! Streams that are read and written where frames are handled: plain sockets and shared memory, by whichever
//! thread of the chassis is at the links.

use std::{
    io::{self, IoSlice},
    os::fd::{AsFd, BorrowedFd, OwnedFd},
    sync::{Arc, Mutex},
};

use rustix::net::{RecvFlags, SendAncillaryBuffer, SendFlags, recv, send, sendmsg};
use tokio::sync::oneshot;

use super::Session;
use crate::{
    lock::lock,
    reactor::{Happened, Seen, Source, Visible},
    shm,
};

/// How many bytes are read at a time.
const CHUNK: usize = 64 * 1024;

/// How often one stream is read before others are polled.
const READS: usize = 64;

/// What brings bytes to the other end and back without waiting.
pub(super) enum Carrier {
    /// A socket that does not block, and whether the other end is a process of this host.
    Socket { fd: OwnedFd, is_nearby: bool },
    Shared {
        sender: shm::Sender,
        receiver: shm::Receiver,
        bell: OwnedFd,
    },
}

impl Carrier {
    /// Whether the other end is a process of this host.
    pub(super) fn is_nearby(&self) -> bool {
        match self {
            Self::Socket { is_nearby, .. } => *is_nearby,
            Self::Shared { .. } => true,
        }
    }

    /// Writes from any thread what can be written at once. The reactor sees when more can be.
    pub(super) fn try_write(&self, slices: &[IoSlice<'_>]) -> io::Result<usize> {
        let flags = SendFlags::NOSIGNAL | SendFlags::DONTWAIT;
        match (self, slices) {
            (Self::Shared { sender, .. }, slices) => sender.try_write(slices),
            (Self::Socket { fd, .. }, [only]) => Ok(send(fd, only, flags)?),
            (Self::Socket { fd, .. }, slices) => {
                let nothing = &mut SendAncillaryBuffer::default();
                Ok(sendmsg(fd, slices, nothing, flags)?)
            }
        }
    }

    /// Reads what has come; no bytes at the end of a socket.
    ///
    /// # Errors
    /// `InvalidData` when the other side spoilt the memory, and what the system says.
    fn try_read(&self, chunk: &mut [u8]) -> io::Result<usize> {
        match self {
            Self::Socket { fd, .. } => Ok(recv(fd, chunk, RecvFlags::DONTWAIT)?.1),
            Self::Shared { receiver, .. } => match receiver.read(chunk) {
                Ok(0) => Err(io::ErrorKind::WouldBlock.into()),
                Ok(count) => Ok(count),
                Err(corrupt) => Err(io::Error::new(io::ErrorKind::InvalidData, corrupt)),
            },
        }
    }
}

struct Reading {
    chunk: Vec<u8>,
    /// Told, once, that the stream is over.
    ended: Option<oneshot::Sender<()>>,
}

/// A stream of a session, as the reactor sees it.
pub(super) struct DirectStream {
    session: Arc<Session>,
    number: u64,
    carrier: Arc<Carrier>,
    reading: Mutex<Reading>,
}

impl DirectStream {
    /// Reads stream `number` of `session`; the other half hears when it is over.
    pub(super) fn new(
        session: Arc<Session>,
        number: u64,
        carrier: Arc<Carrier>,
    ) -> (Self, oneshot::Receiver<()>) {
        let (ended, ends) = oneshot::channel();
        let stream = Self {
            session,
            number,
            carrier,
            reading: Mutex::new(Reading {
                chunk: vec![0; CHUNK],
                ended: Some(ended),
            }),
        };
        (stream, ends)
    }

    /// Reads what there is, up to the end if the other end has `closed`. What came.
    fn read(&self, chunk: &mut [u8], closed: bool) -> Seen {
        let mut seen = Seen::Nothing;
        for _ in 0..READS {
            let count = match self.carrier.try_read(chunk) {
                Ok(0) => return Seen::End,
                Ok(count) => count,
                Err(error) => match error.kind() {
                    io::ErrorKind::WouldBlock if !closed => return seen,
                    io::ErrorKind::Interrupted => continue,
                    io::ErrorKind::InvalidData => {
                        self.session.rubbish(&error);
                        return Seen::End;
                    }
                    _ => return Seen::End,
                },
            };
            let bytes = chunk.get(..count).unwrap_or_default();
            let read = self.session.read(self.number, bytes);
            if read.frames {
                seen = Seen::Frames;
            }
            if !read.goes_on {
                return Seen::End;
            }
            // What gave less than there was place for has no more, but perhaps its end.
            if count < chunk.len() && !closed {
                return seen;
            }
        }
        Seen::More
    }
}

impl Source for DirectStream {
    fn serve(&self, happened: Happened) -> Seen {
        let mut seen = Seen::Nothing;
        if happened.readable {
            let mut reading = lock(&self.reading);
            seen = self.read(&mut reading.chunk, happened.closed);
            if seen == Seen::End {
                if let Some(ended) = reading.ended.take() {
                    // The driver may be gone.
                    let _ = ended.send(());
                }
                return Seen::End;
            }
        }
        let waits = match &*self.carrier {
            Carrier::Socket { .. } => false,
            // The bell of shared memory rings for what comes and for space.
            Carrier::Shared { receiver, .. } => receiver.waits_for_space(),
        };
        if happened.writable || waits {
            self.session.pump(self.number);
        }
        seen
    }

    fn fd(&self) -> BorrowedFd<'_> {
        match &*self.carrier {
            Carrier::Socket { fd, .. } | Carrier::Shared { bell: fd, .. } => fd.as_fd(),
        }
    }

    fn visible(&self) -> Option<&dyn Visible> {
        match &*self.carrier {
            Carrier::Socket { .. } => None,
            Carrier::Shared { receiver, .. } => Some(receiver),
        }
    }
}

impl Visible for shm::Receiver {
    fn has_come(&self) -> bool {
        self.has_work()
    }

    fn set_asleep(&self, asleep: bool) {
        shm::Receiver::set_asleep(self, asleep);
    }
}
