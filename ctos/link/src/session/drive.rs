//! Drivers: what moves bytes between a session and one stream, until the stream ends.

use std::{future::poll_fn, io, pin::pin, sync::Arc, task::Poll, time::Duration};

use rustix::net::sockopt::set_socket_send_buffer_size;
use tokio::{
    io::{AsyncRead, AsyncReadExt},
    net::{TcpStream, UnixStream},
};

use super::{
    AttachError, Core, Session, Writer,
    direct::{Carrier, DirectStream},
};
use crate::{
    reactor::Reactor,
    shm,
    transport::{Stream, is, socket},
};

/// How much a Unix socket holds that has not been read, bytes; TCP finds its own measure.
const SEND_BUFFER: usize = 1 << 20;

/// How many bytes are read at a time.
const CHUNK: usize = 64 * 1024;

/// How often a driver looks whether late packets of an injured link may leave.
const INJURED_TICK: Duration = Duration::from_millis(1);

/// How long the driver waits for the last words of the other end when that takes no more.
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
    let is_plain = is::<TcpStream>(&stream) || is::<UnixStream>(&stream);
    // What makes other bytes of what it reads, or keeps it back, needs a driver of its own.
    if !is_plain || session.look(Core::is_injured) {
        return driven(session, stream, received).await;
    }
    match plain(stream) {
        Ok(carrier) => direct(session, carrier, received, reactor, std::future::pending()).await,
        Err(error) => {
            broke(&error);
            Ok(())
        }
    }
}

/// Carries `session` over a stream that is not a plain socket.
async fn driven(session: &Arc<Session>, stream: Stream, received: u64) -> Result<(), AttachError> {
    let (mut reader, writer) = tokio::io::split(stream);
    let number = session.attach(Writer::Driven(Box::new(writer)), received)?;
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
            if session.look(Core::is_injured) {
                // A stream that is broken on purpose is broken at once.
                Err(error)
            } else {
                // The other end has closed; what it said last may not have been read yet.
                let rest = tokio::time::timeout(LAST_WORDS_DEADLINE, read).await;
                rest.unwrap_or(Ok(())).and(Err(error))
            }
        }
        () = late, if session.look(Core::is_injured) => Ok(()),
    };
    if let Err(error) = ended {
        broke(&error);
    }
    session.lost(number);
    Ok(())
}

/// A plain socket; it stays non-blocking.
fn plain(stream: Stream) -> io::Result<Carrier> {
    if is::<TcpStream>(&stream) {
        let stream: TcpStream = socket(stream)?;
        let is_nearby = stream.peer_addr().is_ok_and(|peer| peer.ip().is_loopback());
        let fd = stream.into_std()?.into();
        return Ok(Carrier::Socket { fd, is_nearby });
    }
    let stream = socket::<UnixStream>(stream)?.into_std()?;
    // An image leaves at once, and its receiver is woken once. What the system refuses is not a reason to do
    // without the socket.
    if let Err(error) = set_socket_send_buffer_size(&stream, SEND_BUFFER) {
        tracing::debug!(error = %error, "a socket keeps its small buffer");
    }
    Ok(Carrier::Socket {
        fd: stream.into(),
        is_nearby: true,
    })
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
    let carrier = Carrier::Shared {
        sender,
        receiver,
        bell,
    };
    direct(session, carrier, received, reactor, hung_up(&socket)).await
}

/// Has the reactor read what `carrier` brings until it ends, or until the other end has `hung_up`.
async fn direct(
    session: &Arc<Session>,
    carrier: Carrier,
    received: u64,
    reactor: &Arc<Reactor>,
    hung_up: impl Future<Output = ()>,
) -> Result<(), AttachError> {
    let carrier = Arc::new(carrier);
    let number = session.attach(Writer::Direct(carrier.clone()), received)?;
    let (stream, mut ended) = DirectStream::new(session.clone(), number, carrier);
    match reactor.add(Arc::new(stream)) {
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
    Ok(())
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

#[cfg(test)]
mod tests {
    use tokio::net::TcpListener;

    use super::*;

    #[tokio::test]
    async fn only_a_stream_whose_other_end_is_known_to_be_on_this_host_is_nearby() {
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let there = TcpStream::connect(listener.local_addr().unwrap());
        assert!(plain(Box::new(there.await.unwrap())).unwrap().is_nearby());
        let (here, _there) = UnixStream::pair().unwrap();
        assert!(plain(Box::new(here)).unwrap().is_nearby());
        // What is behind a router may be anywhere.
        let (here, _there) = tokio::io::duplex(1);
        assert!(plain(Box::new(here)).is_err());
    }
}
