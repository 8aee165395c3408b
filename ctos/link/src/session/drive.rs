//! Drivers: what moves bytes between a session and one stream, until the stream ends.

use std::{future::poll_fn, io, os::fd::OwnedFd, pin::pin, sync::Arc, task::Poll, time::Duration};

use rustix::net::sockopt::set_socket_send_buffer_size;
use tokio::{
    io::{AsyncRead, AsyncReadExt},
    net::UnixStream,
};

use super::{
    AttachError, Session, Writer,
    direct::{Carrier, DirectStream},
    writer::Socket,
};
use crate::{reactor::Reactor, shm, transport::Stream};

/// How much a Unix socket holds that has not been read, bytes; TCP finds its own measure.
const SEND_BUFFER: usize = 1 << 20;

/// How many bytes are read at a time.
const CHUNK: usize = 64 * 1024;

/// How often a driver looks whether late packets of an injured link may leave.
const INJURED_TICK: Duration = Duration::from_millis(1);

/// How long what the other end said last is waited for when it takes no more.
const LAST_WORDS_DEADLINE: Duration = Duration::from_millis(500);

/// Carries `session` over `stream` until that ends; `received` is what the other end has. Plain sockets are
/// read by `reactor`.
///
/// # Errors
/// When the session does not want the stream.
pub async fn drive(
    session: &Arc<Session>,
    stream: Stream,
    received: u64,
    reactor: &Arc<Reactor>,
) -> Result<(), AttachError> {
    let stream = match stream {
        // What makes other bytes of what it reads, or keeps it back, needs a driver of its own.
        Stream::Other(_) => stream,
        _ if session.is_injured() => stream,
        Stream::Tcp(_) | Stream::Unix(_) => {
            let is_nearby = stream.is_nearby();
            return match fd_of(stream) {
                Ok(fd) => {
                    let socket = Socket::new(fd, is_nearby, Arc::downgrade(reactor));
                    drive_socket(session, socket, received, reactor).await
                }
                Err(error) => {
                    broke(&error);
                    Ok(())
                }
            };
        }
    };
    let (mut reader, writer) = tokio::io::split(stream);
    let number = session.attach(Writer::Other(Box::new(writer)), received)?;
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
            if session.is_injured() {
                // A stream that is broken on purpose is broken at once.
                Err(error)
            } else {
                // The other end has closed; what it said last may not have been read yet.
                let rest = tokio::time::timeout(LAST_WORDS_DEADLINE, read).await;
                rest.unwrap_or(Ok(())).and(Err(error))
            }
        }
        () = late, if session.is_injured() => Ok(()),
    };
    if let Err(error) = ended {
        broke(&error);
    }
    session.lost(number);
    Ok(())
}

/// The file descriptor of a plain socket; it stays non-blocking.
fn fd_of(stream: Stream) -> io::Result<OwnedFd> {
    match stream {
        Stream::Tcp(stream) => Ok(stream.into_std()?.into()),
        Stream::Unix(stream) => {
            let stream = stream.into_std()?;
            // An image leaves at once, and its receiver is woken once. What the system refuses is no reason to do
            // without the socket.
            if let Err(error) = set_socket_send_buffer_size(&stream, SEND_BUFFER) {
                tracing::debug!(error = %error, "a socket keeps its small buffer");
            }
            Ok(stream.into())
        }
        Stream::Other(_) => Err(io::ErrorKind::Unsupported.into()),
    }
}

async fn read_all(
    session: &Arc<Session>,
    number: u64,
    reader: &mut (impl AsyncRead + Unpin),
) -> io::Result<()> {
    let mut chunk = vec![0; CHUNK];
    loop {
        let count = reader.read(&mut chunk).await?;
        if count == 0 {
            return Ok(());
        }
        let read = chunk.get(..count).unwrap_or_default();
        if !session.read(number, read).goes_on {
            return Ok(());
        }
    }
}

/// Carries `session` through shared memory until the socket by which it came is closed: that is how the
/// end of the other process shows.
///
/// # Errors
/// When the session does not want the stream.
pub async fn drive_shared(
    session: &Arc<Session>,
    socket: UnixStream,
    shared: shm::Shared,
    received: u64,
    reactor: &Arc<Reactor>,
) -> Result<(), AttachError> {
    let (sender, receiver, bell) = shared.split();
    let number = session.attach(Writer::Shared(sender), received)?;
    let carrier = Carrier::Shared { receiver, bell };
    watched(session, number, carrier, reactor, hung_up(&socket)).await;
    Ok(())
}

/// Carries `session` over a plain socket that the reactor reads.
async fn drive_socket(
    session: &Arc<Session>,
    socket: Socket,
    received: u64,
    reactor: &Arc<Reactor>,
) -> Result<(), AttachError> {
    let socket = Arc::new(socket);
    let number = session.attach(Writer::Socket(socket.clone()), received)?;
    let carrier = Carrier::Socket(socket);
    watched(session, number, carrier, reactor, std::future::pending()).await;
    Ok(())
}

/// Has the reactor read stream `number` until it ends, or until the other end has `hung_up`.
async fn watched(
    session: &Arc<Session>,
    number: u64,
    carrier: Carrier,
    reactor: &Arc<Reactor>,
    hung_up: impl Future<Output = ()>,
) {
    let (stream, mut ended) = DirectStream::new(session.clone(), number, carrier);
    let watched = reactor.add(move |token| {
        stream.set_token(token);
        Arc::new(stream)
    });
    match watched {
        Ok(watched) => {
            tokio::select! {
                _ = &mut ended => {}
                error = poll_fn(|cx| session.poll_pump(cx, number)) => {
                    broke(&error);
                    // The other end has closed; what it said last may not have been read yet.
                    let _ = tokio::time::timeout(LAST_WORDS_DEADLINE, ended).await;
                }
                () = hung_up => {
                    // What is still there is read.
                    watched.serve();
                }
            }
        }
        Err(error) => broke(&error),
    }
    session.lost(number);
}

fn broke(error: &io::Error) {
    tracing::debug!(error = %error, "a stream broke");
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
