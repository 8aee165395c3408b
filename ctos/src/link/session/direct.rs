//! Streams that are read where their frames are handled: plain sockets and shared memory, by whichever
//! thread of the chassis is at the links.

use std::{
    os::fd::{AsFd, BorrowedFd, OwnedFd},
    sync::{
        Arc, Mutex,
        atomic::{AtomicBool, Ordering},
    },
};

use rustix::{
    io::Errno,
    net::{RecvFlags, recv},
};
use tokio::sync::oneshot;

use super::{
    Session,
    drive::{rubbish, take},
    packet::Decoder,
    writer::Socket,
};
use crate::{
    link::{
        lookout::{Happened, Seen, Source},
        shm,
    },
    lock::lock,
};

/// How many bytes are read at a time.
const CHUNK: usize = 64 * 1024;

/// How often one stream is read before others have their turn.
const READS: usize = 64;

/// What a stream is read from.
pub(super) enum Carrier {
    Socket(Arc<Socket>),
    Shared {
        receiver: shm::Receiver,
        bell: OwnedFd,
    },
}

/// How one read ended.
enum Read {
    /// Something came, and there may be more.
    More,
    /// That was all for now.
    Drained,
    /// Nothing will come any more.
    End,
}

struct Reading {
    decoder: Decoder,
    chunk: Vec<u8>,
    /// Told, once, that the stream is over.
    ended: Option<oneshot::Sender<()>>,
}

/// A stream of a session, as the lookout sees it.
pub(super) struct DirectStream {
    session: Arc<Session>,
    number: u64,
    carrier: Carrier,
    reading: Mutex<Reading>,
    /// The process at the other end is gone: what is there is the last.
    pub(super) closed: AtomicBool,
}

impl DirectStream {
    /// Reads stream `number` of `session`; the other half is told when it is over.
    pub(super) fn new(
        session: Arc<Session>,
        number: u64,
        carrier: Carrier,
    ) -> (Self, oneshot::Receiver<()>) {
        let (ended, ends) = oneshot::channel();
        let stream = Self {
            session,
            number,
            carrier,
            reading: Mutex::new(Reading {
                decoder: Decoder::default(),
                chunk: vec![0; CHUNK],
                ended: Some(ended),
            }),
            closed: AtomicBool::new(false),
        };
        (stream, ends)
    }

    /// Reads what there is. Whether frames came, and whether it is over.
    fn read(&self, reading: &mut Reading) -> (bool, bool) {
        let mut frames = false;
        for _ in 0..READS {
            let Reading { decoder, chunk, .. } = reading;
            let (read, count) = self.read_once(chunk);
            let bytes = chunk.get(..count).unwrap_or_default();
            let goes_on =
                count == 0 || take(&self.session, self.number, decoder, bytes, &mut frames);
            match read {
                _ if !goes_on => return (frames, true),
                Read::More => {}
                Read::Drained => return (frames, false),
                Read::End => return (frames, true),
            }
        }
        (frames, false)
    }

    /// One read, and how many bytes it gave.
    fn read_once(&self, chunk: &mut [u8]) -> (Read, usize) {
        match &self.carrier {
            Carrier::Socket(socket) => {
                match recv(socket.fd(), &mut *chunk, RecvFlags::DONTWAIT) {
                    Ok((_, 0)) => (Read::End, 0),
                    // A socket that gave less than there was place for has no more.
                    Ok((_, count)) if count < chunk.len() => (Read::Drained, count),
                    Ok((_, count)) => (Read::More, count),
                    Err(Errno::AGAIN) => (Read::Drained, 0),
                    Err(Errno::INTR) => (Read::More, 0),
                    Err(_) => (Read::End, 0),
                }
            }
            Carrier::Shared { receiver, .. } => {
                let closed = self.closed.load(Ordering::Acquire);
                match receiver.read(chunk) {
                    Ok(0) if closed => (Read::End, 0),
                    Ok(0) => (Read::Drained, 0),
                    Ok(count) => (Read::More, count),
                    Err(error) => {
                        rubbish(&self.session, &error);
                        (Read::End, 0)
                    }
                }
            }
        }
    }
}

impl Source for DirectStream {
    fn serve(&self, happened: Happened) -> Seen {
        let mut seen = Seen::Nothing;
        if happened.came {
            let mut reading = lock(&self.reading);
            let (frames, over) = self.read(&mut reading);
            if over {
                if let Some(ended) = reading.ended.take() {
                    // The driver may be gone.
                    let _ = ended.send(());
                }
                return Seen::End;
            }
            if frames {
                seen = Seen::Frames;
            }
        }
        match &self.carrier {
            Carrier::Socket(socket) if happened.room => {
                self.session.pump_socket(self.number, socket);
            }
            Carrier::Socket(_) => {}
            // The bell of shared memory rings for what comes and for room.
            Carrier::Shared { receiver, .. } => {
                if happened.room || receiver.waits_for_room() {
                    self.session.pump(self.number);
                }
            }
        }
        seen
    }

    fn has_come(&self) -> bool {
        match &self.carrier {
            Carrier::Socket(_) => false,
            Carrier::Shared { receiver, .. } => receiver.has_work(),
        }
    }

    fn is_visible(&self) -> bool {
        matches!(self.carrier, Carrier::Shared { .. })
    }

    fn fd(&self) -> BorrowedFd<'_> {
        match &self.carrier {
            Carrier::Socket(socket) => socket.fd(),
            Carrier::Shared { bell, .. } => bell.as_fd(),
        }
    }

    fn set_asleep(&self, asleep: bool) {
        if let Carrier::Shared { receiver, .. } = &self.carrier {
            receiver.set_asleep(asleep);
        }
    }
}
