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
use tokio::{
    io::{AsyncRead, AsyncWrite},
    net::{tcp, unix},
};

use super::window::{PIECE, PIECE_NEARBY};
use crate::{reactor::Reactor, shm};

/// A stream that takes what it has room for from whatever thread.
pub trait DirectWrite: AsyncWrite + Send + Unpin {
    /// Takes what there is room for.
    ///
    /// # Errors
    /// `WouldBlock` when there is none.
    fn try_write(&self, slices: &[io::IoSlice<'_>]) -> io::Result<usize>;
}

/// What a stream must be able to do.
pub trait Bytes: AsyncRead + AsyncWrite + Send + Unpin + 'static {
    /// The half that is read, and the half that is written.
    fn halves(self: Box<Self>) -> (Box<dyn AsyncRead + Send + Unpin>, Writer) {
        let (reader, writer) = tokio::io::split(self);
        (Box::new(reader), Writer::Other(Box::new(writer)))
    }
}

/// Where a session writes.
pub enum Writer {
    Tcp(tcp::OwnedWriteHalf),
    Unix(unix::OwnedWriteHalf),
    /// A socket at which the chassis's own reactor waits.
    Socket(Arc<Socket>),
    Shared(shm::Sender),
    #[cfg_attr(
        not(feature = "zenoh"),
        allow(dead_code, reason = "only streams over zenoh are such")
    )]
    Direct(Box<dyn DirectWrite>),
    /// Written to by its driver only.
    Other(Box<dyn AsyncWrite + Send + Unpin>),
}

impl Writer {
    /// Writes from any thread what can be written at once.
    pub(super) fn try_write(&self, slices: &[io::IoSlice<'_>]) -> io::Result<usize> {
        match self {
            Self::Tcp(stream) => stream.try_write_vectored(slices),
            Self::Unix(stream) => stream.try_write_vectored(slices),
            Self::Socket(socket) => socket.try_write(slices),
            Self::Shared(sender) => sender.try_write(slices),
            Self::Direct(stream) => stream.try_write(slices),
            Self::Other(_) => Err(io::ErrorKind::WouldBlock.into()),
        }
    }

    /// Into pieces of how many bytes large frames are cut.
    pub(super) fn piece(&self) -> usize {
        let is_nearby = match self {
            Self::Socket(socket) => socket.is_nearby,
            Self::Unix(_) | Self::Shared(_) => true,
            Self::Tcp(_) | Self::Direct(_) | Self::Other(_) => false,
        };
        if is_nearby { PIECE_NEARBY } else { PIECE }
    }

    /// Whether room that comes is told to the reactor, so that the driver need not ask for it.
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
            Self::Tcp(stream) => Pin::new(stream).poll_write_vectored(cx, slices),
            Self::Unix(stream) => Pin::new(stream).poll_write_vectored(cx, slices),
            Self::Direct(stream) => Pin::new(stream).poll_write_vectored(cx, slices),
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
    /// The reactor waits for room.
    wants_room: AtomicBool,
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
            wants_room: AtomicBool::new(true),
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
            self.set_wants_room(true);
        }
        written
    }

    /// There is room, or there shall be some.
    pub(super) fn set_wants_room(&self, wants: bool) {
        if self.wants_room.swap(wants, Ordering::SeqCst) != wants {
            self.tell(wants);
        }
    }

    /// More has come than was read: it is to be told again.
    pub(super) fn tell_again(&self) {
        self.wants_room.store(true, Ordering::SeqCst);
        self.tell(true);
    }

    fn tell(&self, room: bool) {
        if let Some(reactor) = self.reactor.upgrade() {
            let token = Token(self.token.load(Ordering::Acquire));
            reactor.tell(self.fd(), token, room);
        }
    }
}
