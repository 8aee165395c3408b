//! Reading from a socket into the free place of a vector, but not into all of it: what follows a packet
//! belongs to the next one. The crates that read into free places take the whole of them.

#![allow(
    unsafe_code,
    reason = "a vector is told how much of its free place the system has written; the argument is below"
)]

use std::os::fd::BorrowedFd;

use rustix::{
    io::Errno,
    net::{RecvFlags, recv},
};

/// Appends what has come to `into`, up to `most` bytes and no more than there is place for; how many
/// they are.
///
/// # Errors
/// What the system says; `AGAIN` when nothing has come.
pub(super) fn recv_into(
    socket: BorrowedFd<'_>,
    into: &mut Vec<u8>,
    most: usize,
) -> Result<usize, Errno> {
    let place = into.spare_capacity_mut();
    let (place, _) = place.split_at_mut(most.min(place.len()));
    let ((written, _), _) = recv(socket, place, RecvFlags::DONTWAIT)?;
    let count = written.len();
    let length = into.len() + count;
    // SAFETY: `written` is the beginning of the free place, where bytes stand now, so that the first
    // `length` bytes are written to, and it ends within the capacity.
    unsafe { into.set_len(length) };
    Ok(count)
}

#[cfg(test)]
mod tests {
    use std::{
        io::Write,
        os::{fd::AsFd, unix::net::UnixStream},
    };

    use super::*;

    #[test]
    fn bytes_are_appended_up_to_the_most_and_into_the_free_place_only() {
        let (mut sends, receives) = UnixStream::pair().unwrap();
        let all: Vec<u8> = (0..=255).collect();
        sends.write_all(&all).unwrap();
        let mut into = Vec::with_capacity(100);
        into.extend_from_slice(&[7; 3]);
        let capacity = into.capacity();
        assert_eq!(recv_into(receives.as_fd(), &mut into, 10), Ok(10));
        assert_eq!(into[..3], [7; 3]);
        assert_eq!(into[3..], all[..10]);
        let rest = capacity - into.len();
        assert_eq!(recv_into(receives.as_fd(), &mut into, usize::MAX), Ok(rest));
        assert_eq!(into[3..], all[..capacity - 3]);
        assert_eq!(into.capacity(), capacity);
        assert_eq!(recv_into(receives.as_fd(), &mut into, 10), Ok(0));
        into.clear();
        let rest = all.len() - (capacity - 3);
        into.reserve_exact(300);
        assert_eq!(recv_into(receives.as_fd(), &mut into, 300), Ok(rest));
        assert_eq!(
            recv_into(receives.as_fd(), &mut into, 300),
            Err(Errno::AGAIN)
        );
        drop(sends);
        assert_eq!(recv_into(receives.as_fd(), &mut into, 300), Ok(0));
        assert_eq!(into, all[capacity - 3..]);
    }
}
