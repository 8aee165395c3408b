//! Drivers: what moves bytes between a session and one stream, until the stream ends.

use std::{
    future::poll_fn,
    io,
    pin::pin,
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    task::{Context as PollContext, Poll, Wake, Waker},
    time::Duration,
};

use bytes::BufMut;
use tokio::{
    io::{AsyncRead, AsyncReadExt},
    net::UnixStream,
};

use super::{
    AttachError, Session, Writer,
    packet::{Decoder, PacketError},
    state::Event,
};
use crate::link::{
    session::DownReason,
    shm::{self, Bell},
    transport::Stream,
};

/// How many bytes are read at a time.
const CHUNK: usize = 64 * 1024;

/// How often a driver looks whether late packets of an injured link may leave.
const INJURED_TICK: Duration = Duration::from_millis(1);

/// How long what the other end said last is waited for when it takes no more.
const LAST_WORDS_LIMIT: Duration = Duration::from_millis(500);

/// Carries `session` over `stream` until that ends; `received` is what the other end has.
///
/// # Errors
/// When the session does not want the stream.
pub(crate) async fn drive(
    session: &Arc<Session>,
    stream: Stream,
    received: u64,
) -> Result<(), AttachError> {
    let (mut reader, writer) = stream.split();
    let number = session.attach(writer, received)?;
    let mut read = pin!(read_all(session, number, &mut reader));
    let write = poll_fn(|cx| session.poll_pump(cx, number));
    let late = async {
        loop {
            tokio::time::sleep(INJURED_TICK).await;
            poll_fn(|cx| Poll::Ready(session.poll_pump(cx, number).is_ready())).await;
        }
    };
    let ended = tokio::select! {
        ended = &mut read => ended,
        error = write => {
            // The other end has closed; what it said last may not have been read yet.
            let rest = tokio::time::timeout(LAST_WORDS_LIMIT, read).await;
            rest.unwrap_or(Ok(())).and(Err(error))
        }
        () = late, if session.is_injured() => Ok(()),
    };
    if let Err(error) = ended {
        tracing::debug!(error = %error, "a stream broke");
    }
    session.lost(number);
    Ok(())
}

async fn read_all(
    session: &Arc<Session>,
    number: u64,
    reader: &mut (impl AsyncRead + Unpin),
) -> io::Result<()> {
    let mut chunk = vec![0; CHUNK];
    let mut decoder = Decoder::default();
    loop {
        if let Some(mut space) = decoder.large_body() {
            if reader.read_buf(&mut space).await? == 0 {
                return Ok(());
            }
            continue;
        }
        let count = reader.read(&mut chunk).await?;
        if count == 0 {
            return Ok(());
        }
        let read = chunk.get(..count).unwrap_or_default();
        if !take(session, number, &mut decoder, read) {
            return Ok(());
        }
    }
}

/// Hands what was read to the session. False when nothing more may come.
fn take(session: &Session, number: u64, decoder: &mut Decoder, mut bytes: &[u8]) -> bool {
    loop {
        match decoder.feed(&mut bytes) {
            Ok(Some(packet)) => {
                if !session.receive(number, packet) {
                    return false;
                }
            }
            Ok(None) => return true,
            Err(error) => {
                rubbish(session, &error);
                return false;
            }
        }
    }
}

fn rubbish(session: &Session, error: &PacketError) {
    session.event(Event::Rubbish, DownReason::Rubbish(error.to_string()));
}

/// Wakes the thread that drives a session through shared memory.
struct BellWaker {
    bell: Bell,
}

impl Wake for BellWaker {
    fn wake(self: Arc<Self>) {
        self.bell.ring_here();
    }
}

/// Carries `session` through shared memory until the socket by which it came is closed: that is how the
/// end of the other process shows. `spin` is how long the reader looks before it sleeps.
///
/// # Errors
/// When the session does not want the stream, or there is no thread for it.
pub(crate) async fn drive_shared(
    session: &Arc<Session>,
    socket: UnixStream,
    shared: shm::Shared,
    received: u64,
    spin: Duration,
    name: &str,
) -> Result<(), AttachError> {
    let (sender, receiver, bell) = shared.split();
    let number = session.attach(Writer::Shared(sender), received)?;
    let closed = Arc::new(AtomicBool::new(false));
    let (ending, ended) = tokio::sync::oneshot::channel::<()>();
    let thread = {
        let (session, closed) = (session.clone(), closed.clone());
        let waker = Waker::from(Arc::new(BellWaker { bell: bell.clone() }));
        std::thread::Builder::new()
            .name(name.to_owned())
            .spawn(move || {
                let _ending = ending;
                let shared = SharedDriver {
                    session: &session,
                    number,
                    receiver,
                    waker,
                    closed: &closed,
                    spin,
                };
                shared.run();
                session.lost(number);
            })
    };
    if let Err(error) = thread {
        tracing::error!(error = %error, "no thread for shared memory");
        session.lost(number);
        return Ok(());
    }
    let mut ended = ended;
    tokio::select! {
        _ = &mut ended => {}
        () = hung_up(&socket) => {
            closed.store(true, Ordering::Release);
            bell.ring_here();
            // It reads what is still there and ends.
            let _ = ended.await;
        }
    }
    Ok(())
}

/// Ends when the other end of the socket is closed. Nothing is said there any more.
async fn hung_up(socket: &UnixStream) {
    let mut byte = [0; 1];
    loop {
        if socket.readable().await.is_err() {
            return;
        }
        match socket.try_read(&mut byte) {
            Ok(0) => return,
            Ok(_) => {}
            Err(error) if error.kind() == io::ErrorKind::WouldBlock => {}
            Err(_) => return,
        }
    }
}

/// The thread of a session through shared memory.
struct SharedDriver<'a> {
    session: &'a Session,
    number: u64,
    receiver: shm::Receiver,
    waker: Waker,
    closed: &'a AtomicBool,
    spin: Duration,
}

impl SharedDriver<'_> {
    fn run(mut self) {
        let mut chunk = vec![0; CHUNK];
        let mut decoder = Decoder::default();
        loop {
            let heard = self.receiver.heard();
            // Seen before the ring is: what was written before the end is still read.
            let closed = self.closed.load(Ordering::Acquire);
            match self.read(&mut decoder, &mut chunk) {
                Ok(true) => continue,
                Ok(false) if closed => return,
                Ok(false) => {}
                Err(()) => return,
            }
            let mut cx = PollContext::from_waker(&self.waker);
            if self.session.poll_pump(&mut cx, self.number).is_ready() {
                return;
            }
            self.receiver.wait(self.spin, heard);
        }
    }

    /// Reads once; whether there was anything.
    fn read(&mut self, decoder: &mut Decoder, chunk: &mut [u8]) -> Result<bool, ()> {
        if let Some(mut space) = decoder.large_body() {
            let most = space.remaining_mut().min(chunk.len());
            let part = chunk.get_mut(..most).unwrap_or_default();
            let count = self.copy(part)?;
            space.put_slice(part.get(..count).unwrap_or_default());
            return Ok(count > 0);
        }
        let count = self.copy(chunk)?;
        let read = chunk.get(..count).unwrap_or_default();
        if take(self.session, self.number, decoder, read) {
            Ok(count > 0)
        } else {
            Err(())
        }
    }

    fn copy(&mut self, into: &mut [u8]) -> Result<usize, ()> {
        self.receiver.read(into).map_err(|error| {
            let reason = DownReason::Rubbish(error.to_string());
            self.session.event(Event::Rubbish, reason);
        })
    }
}
