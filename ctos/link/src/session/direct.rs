//! Streams that are read where their frames are handled: plain sockets and shared memory, by whichever
//! thread of the chassis is at the links.

use std::{
    os::fd::{AsFd, BorrowedFd, OwnedFd},
    sync::{Arc, Mutex},
};

use mio::Token;
use rustix::{
    io::Errno,
    net::{RecvFlags, recv},
};
use tokio::sync::oneshot;

use super::{Session, writer::Socket};
use crate::{
    lock::lock,
    reactor::{Happened, Seen, Source, Visible},
    shm,
};

/// How many bytes are read at a time.
const CHUNK: usize = 64 * 1024;

/// How often one stream is read before others are polled.
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
    chunk: Vec<u8>,
    /// Told, once, that the stream is over.
    ended: Option<oneshot::Sender<()>>,
}

/// A stream of a session, as the reactor sees it.
pub(super) struct DirectStream {
    session: Arc<Session>,
    number: u64,
    carrier: Carrier,
    reading: Mutex<Reading>,
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
                chunk: vec![0; CHUNK],
                ended: Some(ended),
            }),
        };
        (stream, ends)
    }

    /// Its token at the reactor.
    pub(super) fn set_token(&self, token: Token) {
        if let Carrier::Socket(socket) = &self.carrier {
            socket.set_token(token);
        }
    }

    /// Reads what there is, up to the end if the other end has `closed`. What came.
    fn read(&self, chunk: &mut [u8], closed: bool) -> Seen {
        let mut seen = Seen::Nothing;
        for _ in 0..READS {
            let (end, count) = self.read_once(chunk, closed);
            if count > 0 {
                let bytes = chunk.get(..count).unwrap_or_default();
                let read = self.session.read(self.number, bytes);
                if read.frames {
                    seen = Seen::Frames;
                }
                if !read.goes_on {
                    return Seen::End;
                }
            }
            match end {
                Read::More => {}
                Read::Drained => return seen,
                Read::End => return Seen::End,
            }
        }
        if let Carrier::Socket(socket) = &self.carrier {
            socket.tell_again();
        }
        seen
    }

    /// One read, and how many bytes it gave.
    fn read_once(&self, chunk: &mut [u8], closed: bool) -> (Read, usize) {
        match &self.carrier {
            Carrier::Socket(socket) => {
                match recv(socket.fd(), &mut *chunk, RecvFlags::DONTWAIT) {
                    Ok((_, 0)) => (Read::End, 0),
                    // A socket that gave less than there was place for has no more, but perhaps its end.
                    Ok((_, count)) if count < chunk.len() && !closed => (Read::Drained, count),
                    Ok((_, count)) => (Read::More, count),
                    Err(Errno::AGAIN) => (Read::Drained, 0),
                    Err(Errno::INTR) => (Read::More, 0),
                    Err(_) => (Read::End, 0),
                }
            }
            Carrier::Shared { receiver, .. } => match receiver.read(chunk) {
                Ok(0) if closed => (Read::End, 0),
                Ok(0) => (Read::Drained, 0),
                Ok(count) => (Read::More, count),
                Err(error) => {
                    self.session.rubbish(&error);
                    (Read::End, 0)
                }
            },
        }
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
        match &self.carrier {
            Carrier::Socket(socket) if happened.writable => {
                self.session.pump(self.number, Some(socket));
            }
            Carrier::Socket(_) => {}
            // The bell of shared memory rings for what comes and for space.
            Carrier::Shared { receiver, .. } => {
                if happened.writable || receiver.waits_for_space() {
                    self.session.pump(self.number, None);
                }
            }
        }
        seen
    }

    fn fd(&self) -> BorrowedFd<'_> {
        match &self.carrier {
            Carrier::Socket(socket) => socket.fd(),
            Carrier::Shared { bell, .. } => bell.as_fd(),
        }
    }

    fn visible(&self) -> Option<&dyn Visible> {
        match &self.carrier {
            Carrier::Socket(_) => None,
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
