//! Passing shared memory, its bells and the pools over the Unix socket that joins two chassis.

use std::{
    io::{self, IoSlice, IoSliceMut},
    mem::MaybeUninit,
    os::fd::{AsFd, BorrowedFd, OwnedFd},
    sync::Arc,
};

use rustix::net::{
    RecvAncillaryBuffer, RecvAncillaryMessage, RecvFlags, SendAncillaryBuffer,
    SendAncillaryMessage, SendFlags, recvmsg, sendmsg,
};
use tokio::{io::Interest, net::UnixStream};

use super::{Shared, pool::Pool};
use crate::link::transport::Stream;

/// The byte that file descriptors come with.
const BYTE: u8 = b'm';

/// The most file descriptors that are passed at once: memory, two bells, pool, pipe.
const MOST: usize = 5;

/// Makes the memory and passes it, with what the other side needs to borrow from `pool`; returns when the
/// other side has it and has offered its own pool.
///
/// # Errors
/// What the system says, or when the other side does not take it.
pub(crate) async fn send(socket: &UnixStream, pool: &Arc<Pool>) -> io::Result<Shared> {
    let (mut shared, [file, maker, guest]) = Shared::make()?;
    let (pipe, [ours, end]) = pool.offer()?;
    pass(socket, &[file, maker, guest, ours, end]).await?;
    let theirs = take(socket).await?;
    shared.share(pool.clone(), pipe, theirs)?;
    Ok(shared)
}

/// Takes the memory that the other side passes, and offers `pool` to it.
///
/// # Errors
/// When it passes something else.
pub(crate) async fn receive(stream: Stream, pool: &Arc<Pool>) -> io::Result<(UnixStream, Shared)> {
    let Stream::Unix(socket) = stream else {
        return Err(io::ErrorKind::Unsupported.into());
    };
    let [file, maker, guest, theirs, end] = take(&socket).await?;
    let mut shared = Shared::take([file, maker, guest])?;
    let (pipe, offered) = pool.offer()?;
    shared.share(pool.clone(), pipe, [theirs, end])?;
    pass(&socket, &offered).await?;
    Ok((socket, shared))
}

async fn pass(socket: &UnixStream, passed: &[OwnedFd]) -> io::Result<()> {
    let fds: Vec<BorrowedFd<'_>> = passed.iter().map(AsFd::as_fd).collect();
    let sends = || {
        let mut space = [MaybeUninit::uninit(); rustix::cmsg_space!(ScmRights(MOST))];
        let mut control = SendAncillaryBuffer::new(&mut space);
        control.push(SendAncillaryMessage::ScmRights(&fds));
        let byte = [IoSlice::new(&[BYTE])];
        sendmsg(socket, &byte, &mut control, SendFlags::NOSIGNAL)?;
        Ok(())
    };
    socket.async_io(Interest::WRITABLE, sends).await
}

async fn take<const N: usize>(socket: &UnixStream) -> io::Result<[OwnedFd; N]> {
    let takes = || {
        let mut space = [MaybeUninit::uninit(); rustix::cmsg_space!(ScmRights(MOST))];
        let mut control = RecvAncillaryBuffer::new(&mut space);
        let mut byte = [0];
        let into = &mut [IoSliceMut::new(&mut byte)];
        recvmsg(socket, into, &mut control, RecvFlags::CMSG_CLOEXEC)?;
        let rights = control.drain().find_map(|message| match message {
            RecvAncillaryMessage::ScmRights(files) => files.collect::<Vec<_>>().try_into().ok(),
            _ => None,
        });
        let none = || io::Error::new(io::ErrorKind::InvalidData, "no memory was passed");
        rights.filter(|_| byte == [BYTE]).ok_or_else(none)
    };
    socket.async_io(Interest::READABLE, takes).await
}
