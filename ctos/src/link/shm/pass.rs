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
use tokio::{
    io::{AsyncWriteExt, Interest},
    net::UnixStream,
};

use super::Shared;
use crate::link::transport::Stream;

/// The byte that the memory comes with, and the one that says it has come.
const BYTE: u8 = b'm';

/// Makes the memory and passes it; returns when the other side has it.
///
/// # Errors
/// What the system says, or when the other side does not take it.
pub(crate) async fn send(socket: &UnixStream) -> io::Result<Shared> {
    let (shared, passed) = Shared::make()?;
    let fds = passed.each_ref().map(AsFd::as_fd);
    socket
        .async_io(Interest::WRITABLE, || {
            let mut space = [MaybeUninit::uninit(); rustix::cmsg_space!(ScmRights(3))];
            let mut control = SendAncillaryBuffer::new(&mut space);
            control.push(SendAncillaryMessage::ScmRights(&fds));
            sendmsg(
                socket,
                &[IoSlice::new(&[BYTE])],
                &mut control,
                SendFlags::NOSIGNAL,
            )?;
            Ok(())
        })
        .await?;
    let mut taken = [0];
    socket.readable().await?;
    loop {
        match socket.try_read(&mut taken) {
            Ok(1) if taken == [BYTE] => return Ok(shared),
            Ok(_) => return Err(io::ErrorKind::UnexpectedEof.into()),
            Err(error) if error.kind() == io::ErrorKind::WouldBlock => socket.readable().await?,
            Err(error) => return Err(error),
        }
    }
}

/// Takes the memory that the other side passes.
///
/// # Errors
/// When it passes something else.
pub(crate) async fn receive(stream: Stream) -> io::Result<(UnixStream, Shared)> {
    let Stream::Unix(mut socket) = stream else {
        return Err(io::ErrorKind::Unsupported.into());
    };
    let passed: [OwnedFd; 3] = socket
        .async_io(Interest::READABLE, || {
            let mut space = [MaybeUninit::uninit(); rustix::cmsg_space!(ScmRights(3))];
            let mut control = RecvAncillaryBuffer::new(&mut space);
            let mut byte = [0];
            let into = &mut [IoSliceMut::new(&mut byte)];
            recvmsg(&socket, into, &mut control, RecvFlags::CMSG_CLOEXEC)?;
            let rights = control.drain().find_map(|message| match message {
                RecvAncillaryMessage::ScmRights(files) => files.collect::<Vec<_>>().try_into().ok(),
                _ => None,
            });
            rights.ok_or_else(|| io::Error::new(io::ErrorKind::InvalidData, "no memory was passed"))
        })
        .await?;
    let shared = Shared::take(passed)?;
    socket.write_all(&[BYTE]).await?;
    socket.flush().await?;
    Ok((socket, shared))
}
