//! Passing shared memory and its bells over the Unix socket that joins two chassis.

use std::{
    io::{self, IoSlice, IoSliceMut},
    mem::MaybeUninit,
    os::fd::{AsFd, OwnedFd},
};

use rustix::net::{
    RecvAncillaryBuffer, RecvAncillaryMessage, RecvFlags, SendAncillaryBuffer,
    SendAncillaryMessage, SendFlags, recvmsg, sendmsg,
};
use tokio::{io::Interest, net::UnixStream};

use super::Shared;
use crate::transport::{Stream, socket};

/// The byte that file descriptors come with.
const BYTE: u8 = b'm';

/// How many file descriptors are passed: memory and two bells.
const COUNT: usize = 3;

/// Makes the memory and passes it.
///
/// # Errors
/// What the system says.
pub async fn send(stream: Stream) -> io::Result<(UnixStream, Shared)> {
    let socket = socket(stream)?;
    let (shared, passed) = Shared::make()?;
    pass(&socket, &passed).await?;
    Ok((socket, shared))
}

/// Takes the memory that the other side passes.
///
/// # Errors
/// When it passes something else.
pub async fn receive(stream: Stream) -> io::Result<(UnixStream, Shared)> {
    let socket = socket(stream)?;
    let shared = Shared::take(take(&socket).await?)?;
    Ok((socket, shared))
}

async fn pass(socket: &UnixStream, passed: &[OwnedFd; COUNT]) -> io::Result<()> {
    let fds = passed.each_ref().map(AsFd::as_fd);
    let sends = || {
        let mut space = [MaybeUninit::uninit(); rustix::cmsg_space!(ScmRights(COUNT))];
        let mut control = SendAncillaryBuffer::new(&mut space);
        control.push(SendAncillaryMessage::ScmRights(&fds));
        let byte = [IoSlice::new(&[BYTE])];
        sendmsg(socket, &byte, &mut control, SendFlags::NOSIGNAL)?;
        Ok(())
    };
    socket.async_io(Interest::WRITABLE, sends).await
}

async fn take(socket: &UnixStream) -> io::Result<[OwnedFd; COUNT]> {
    let takes = || {
        let mut space = [MaybeUninit::uninit(); rustix::cmsg_space!(ScmRights(COUNT))];
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
