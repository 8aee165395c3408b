//! Where a session writes: the ends of streams that are written to.

use std::{
    io,
    os::fd::{AsFd, BorrowedFd, OwnedFd},
    pin::Pin,
    sync::{
        Arc, Weak,
        atomic::{AtomicBool, AtomicUsize, Ordering},
    },
    task::{Context as PollContext, Poll},
};

use mio::Token;
use rustix::net::{SendAncillaryBuffer, SendFlags, send, sendmsg};
use tokio::io::{AsyncRead, AsyncWrite};

use super::window::{PIECE, PIECE_NEARBY};
use crate::{reactor::Reactor, shm};

/// What a stream must be able to do.
pub trait Bytes: AsyncRead + AsyncWrite + Send + Unpin {}

impl<S: AsyncRead + AsyncWrite + Send + Unpin> Bytes for S {}

/// Where a session writes.
pub enum Writer {
    /// A socket at which the chassis's own reactor waits.
    Socket(Arc<Socket>),
    Shared(shm::Sender),
    /// Written to by its driver only.
    Other(Box<dyn AsyncWrite + Send + Unpin>),
}

impl Writer {
    /// Writes from any thread what can be written at once.
    pub(super) fn try_write(&self, slices: &[io::IoSlice<'_>]) -> io::Result<usize> {
        match self {
            Self::Socket(socket) => socket.try_write(slices),
            Self::Shared(sender) => sender.try_write(slices),
            Self::Other(_) => Err(io::ErrorKind::WouldBlock.into()),
        }
    }

    /// Into pieces of how many bytes large frames are cut.
    pub(super) fn piece(&self) -> usize {
        let is_nearby = match self {
            Self::Socket(socket) => socket.is_nearby,
            Self::Shared(_) => true,
            Self::Other(_) => false,
        };
        if is_nearby { PIECE_NEARBY } else { PIECE }
    }

    /// Whether the reactor is told when it is writable again, so that the driver need not ask.
    pub(super) fn is_watched(&self) -> bool {
        matches!(self, Self::Socket(_) | Self::Shared(_))
    }

    /// Writes from the driver, which is woken when more can be written.
    pub(super) fn poll_write(
        &mut self,
        cx: &mut PollContext<'_>,
        slices: &[io::IoSlice<'_>],
    ) -> Poll<io::Result<usize>> {
        match self {
            Self::Other(stream) => Pin::new(stream).poll_write_vectored(cx, slices),
            Self::Socket(_) | Self::Shared(_) => match self.try_write(slices) {
                Err(error) if error.kind() == io::ErrorKind::WouldBlock => Poll::Pending,
                written => Poll::Ready(written),
            },
        }
    }

    pub(super) fn poll_flush(&mut self, cx: &mut PollContext<'_>) -> Poll<io::Result<()>> {
        match self {
            Self::Other(stream) => Pin::new(stream).poll_flush(cx),
            _ => Poll::Ready(Ok(())),
        }
    }
}

/// A plain socket that is read and written without a driver of its own, by whoever is at the links.
pub struct Socket {
    fd: OwnedFd,
    /// The other end is a process of this host.
    is_nearby: bool,
    reactor: Weak<Reactor>,
    /// Its token at the reactor; 0 until it has one.
    token: AtomicUsize,
    /// The reactor tells when it is writable.
    awaited: AtomicBool,
}

impl Socket {
    /// A socket that does not block.
    pub(super) fn new(fd: OwnedFd, is_nearby: bool, reactor: Weak<Reactor>) -> Self {
        Self {
            fd,
            is_nearby,
            reactor,
            token: AtomicUsize::new(0),
            // The reactor begins with it.
            awaited: AtomicBool::new(true),
        }
    }

    pub(super) fn set_token(&self, token: Token) {
        self.token.store(token.0, Ordering::Release);
    }

    pub(super) fn fd(&self) -> BorrowedFd<'_> {
        self.fd.as_fd()
    }

    fn try_write(&self, slices: &[io::IoSlice<'_>]) -> io::Result<usize> {
        let flags = SendFlags::NOSIGNAL | SendFlags::DONTWAIT;
        let written = match slices {
            [only] => send(&self.fd, only, flags),
            slices => sendmsg(&self.fd, slices, &mut SendAncillaryBuffer::default(), flags),
        };
        let written = written.map_err(io::Error::from);
        if let Err(error) = &written
            && error.kind() == io::ErrorKind::WouldBlock
        {
            self.await_writable(true);
        }
        written
    }

    /// The reactor tells when it is writable, or need no longer.
    pub(super) fn await_writable(&self, awaits: bool) {
        if self.awaited.swap(awaits, Ordering::SeqCst) != awaits {
            self.tell(awaits);
        }
    }

    /// More has come than was read: it is to be told again.
    pub(super) fn tell_again(&self) {
        self.awaited.store(true, Ordering::SeqCst);
        self.tell(true);
    }

    fn tell(&self, writable: bool) {
        if let Some(reactor) = self.reactor.upgrade() {
            let token = Token(self.token.load(Ordering::Acquire));
            reactor.tell(self.fd(), token, writable);
        }
    }
}
