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
    drive::rubbish,
    free::recv_into,
    packet::Decoder,
    writer::{Patience, Socket},
};
use crate::{
    call::lock,
    link::{
        lookout::{Happened, Seen, Source},
        shm,
    },
    time::Instant,
};

/// How many bytes are read at a time, where they are not the data of one large frame.
const CHUNK: usize = 16 * 1024;

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
        decoder: Decoder,
    ) -> (Self, oneshot::Receiver<()>) {
        let (ended, ends) = oneshot::channel();
        let stream = Self {
            session,
            number,
            carrier,
            reading: Mutex::new(Reading {
                decoder,
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
        let mut patience = None;
        // When the first of it came; the rest follows at once.
        let mut since = None;
        for _ in 0..READS {
            let (read, count) = self.read_once(reading);
            let taken = count.map(|count| {
                let now = *since.get_or_insert_with(|| self.session.now());
                self.take(reading, count, now, &mut frames)
            });
            match taken {
                Some(false) => return (frames, true),
                Some(true) => patience = None,
                None => {}
            }
            match read {
                Read::More => {}
                Read::Drained => {
                    // The rest of something large is being written at this moment.
                    if !reading.decoder.is_in_large() || !self.looks_again(&mut patience) {
                        return (frames, false);
                    }
                }
                Read::End => return (frames, true),
            }
        }
        (frames, false)
    }

    fn looks_again(&self, patience: &mut Option<Patience>) -> bool {
        let Carrier::Socket(socket) = &self.carrier else {
            return false;
        };
        patience.get_or_insert_with(|| socket.patience()).lasts()
    }

    /// One read; how much lies in the chunk, if it was read there. Data of a large frame goes to where
    /// it stays.
    fn read_once(&self, reading: &mut Reading) -> (Read, Option<usize>) {
        let Reading { decoder, chunk, .. } = reading;
        let closed = self.closed.load(Ordering::Acquire);
        match &self.carrier {
            Carrier::Socket(socket) => {
                let large = decoder.large_body();
                let is_large = large.is_some();
                let (result, wanted) = match large {
                    Some((body, most)) => (recv_into(socket.fd(), body, most), most),
                    None => {
                        let (chunk, _) = chunk.split_at_mut(decoder.most(CHUNK));
                        let read = recv(socket.fd(), &mut *chunk, RecvFlags::DONTWAIT);
                        (read.map(|(_, count)| count), chunk.len())
                    }
                };
                match result {
                    Ok(0) => (Read::End, None),
                    Ok(count) => {
                        // A socket that gave less than there was place for has no more.
                        let read = if count < wanted {
                            Read::Drained
                        } else {
                            Read::More
                        };
                        (read, Some(if is_large { 0 } else { count }))
                    }
                    Err(Errno::AGAIN) => (Read::Drained, None),
                    Err(Errno::INTR) => (Read::More, None),
                    Err(_) => (Read::End, None),
                }
            }
            Carrier::Shared { receiver, .. } => {
                let large = decoder.large_body();
                let is_large = large.is_some();
                let read = match large {
                    Some((body, most)) => receiver.read_into(body, most),
                    None => receiver.read(chunk),
                };
                match read {
                    Ok(0) if closed => (Read::End, None),
                    Ok(0) => (Read::Drained, None),
                    Ok(count) => (Read::More, Some(if is_large { 0 } else { count })),
                    Err(error) => {
                        rubbish(&self.session, &error);
                        (Read::End, None)
                    }
                }
            }
        }
    }

    /// Hands what lies in the chunk, or completes a large frame, to the session. False when nothing more
    /// may come.
    fn take(&self, reading: &mut Reading, count: usize, now: Instant, frames: &mut bool) -> bool {
        let mut bytes = reading.chunk.get(..count).unwrap_or_default();
        if count == 0 {
            // A large frame takes long: what has come of it is a sign of life, too.
            self.session.heard_of(self.number, now);
        }
        loop {
            match reading.decoder.feed(&mut bytes) {
                Ok(Some(packet)) => {
                    *frames |= packet.is_frame();
                    if !self.session.receive(self.number, packet, now) {
                        return false;
                    }
                }
                Ok(None) => return true,
                Err(error) => {
                    rubbish(&self.session, &error);
                    return false;
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
