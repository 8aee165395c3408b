//! Addresses, and the sockets of both sides. Datagrams only: a frame is whole or not there, and one that is late is in
//! nobody's way. A stream would have neither, and nothing that the fixed size of a frame does not give.
//!
//! Both sides are connected or answer whom they heard: a driver hears its peer only.

use std::{
    fmt, io,
    net::{SocketAddr, ToSocketAddrs, UdpSocket},
    os::unix::net::{self as unix, UnixDatagram},
    path::{Path, PathBuf},
    str::FromStr,
    time::Duration,
};

use rustix::{
    event::{PollFd, PollFlags, Timespec, poll},
    net::SocketAddrUnix,
};

use crate::frame::SIZE;

/// Where a peer is.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Address {
    /// `udp:HOST:PORT`; an IPv6 address stands in brackets.
    Udp {
        /// A name, or an address.
        host: String,
        /// Not 0.
        port: u16,
    },
    /// `unix:PATH`, a datagram socket; a relative path is relative to the folder of the configuration.
    Unix(PathBuf),
}

/// Why a text is no address.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("`{text}` is no address of a peer: {why}")]
pub struct BadAddress {
    text: String,
    why: &'static str,
}

/// Paths of sockets are shorter than this, bytes.
const LONGEST_PATH: usize = 107;

impl FromStr for Address {
    type Err = BadAddress;

    fn from_str(text: &str) -> Result<Self, BadAddress> {
        let bad = |why| BadAddress {
            text: text.to_owned(),
            why,
        };
        if let Some(path) = text.strip_prefix("unix:") {
            return match path.len() {
                0 => Err(bad("it names no path")),
                _ if path.contains('\0') => Err(bad("its path has a zero byte")),
                1..=LONGEST_PATH => Ok(Self::Unix(path.into())),
                _ => Err(bad("its path is longer than 107 bytes")),
            };
        }
        let Some(rest) = text.strip_prefix("udp:") else {
            return Err(bad("it begins neither with `udp:` nor with `unix:`"));
        };
        let Some((host, port)) = rest.rsplit_once(':') else {
            return Err(bad("it names no port"));
        };
        let bare = host
            .strip_prefix('[')
            .and_then(|inner| inner.strip_suffix(']'));
        if bare.is_some_and(|inner| inner.parse::<std::net::Ipv6Addr>().is_err())
            || bare.is_none() && host.contains([':', '[', ']'])
        {
            return Err(bad("an IPv6 address stands in brackets"));
        }
        if host.is_empty() || host.contains(char::is_whitespace) {
            return Err(bad("it names no host"));
        }
        match port.parse() {
            Ok(port) if port > 0 => Ok(Self::Udp {
                host: host.to_owned(),
                port,
            }),
            _ => Err(bad("its port is no number from 1 to 65535")),
        }
    }
}

impl fmt::Display for Address {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Udp { host, port } => write!(f, "udp:{host}:{port}"),
            Self::Unix(path) => write!(f, "unix:{}", path.display()),
        }
    }
}

impl Address {
    /// The same with a relative path taken from `folder`.
    #[must_use]
    pub fn within(self, folder: &Path) -> Self {
        match self {
            Self::Unix(path) => Self::Unix(folder.join(path)),
            udp @ Self::Udp { .. } => udp,
        }
    }

    fn resolve(host: &str, port: u16) -> io::Result<SocketAddr> {
        let bare = host.trim_start_matches('[').trim_end_matches(']');
        let mut found = (bare, port).to_socket_addrs()?;
        let none = || io::Error::new(io::ErrorKind::NotFound, "the host has no address");
        found.next().ok_or_else(none)
    }
}

/// The driver's socket: it never waits.
#[derive(Debug)]
pub enum Line {
    /// Over a network.
    Udp(UdpSocket),
    /// On this host. The peer may be started after the driver, and again: its path is looked up until it is there.
    Unix {
        /// Has a name of the kernel's.
        socket: UnixDatagram,
        /// The peer's.
        peer: unix::SocketAddr,
        /// Whether the socket hears it.
        connected: bool,
    },
}

impl Line {
    /// Opens a socket to the peer at `address`, which need not be there yet. A host's name is looked up here.
    ///
    /// # Errors
    /// The host is unknown, or the operating system refuses.
    pub fn open(address: &Address) -> io::Result<Self> {
        match address {
            Address::Udp { host, port } => {
                let peer = Address::resolve(host, *port)?;
                let any: SocketAddr = match peer {
                    SocketAddr::V4(_) => (std::net::Ipv4Addr::UNSPECIFIED, 0).into(),
                    SocketAddr::V6(_) => (std::net::Ipv6Addr::UNSPECIFIED, 0).into(),
                };
                let socket = UdpSocket::bind(any)?;
                socket.connect(peer)?;
                socket.set_nonblocking(true)?;
                Ok(Self::Udp(socket))
            }
            Address::Unix(path) => {
                let socket = UnixDatagram::unbound()?;
                rustix::net::bind(&socket, &SocketAddrUnix::new_unnamed())?;
                socket.set_nonblocking(true)?;
                Ok(Self::Unix {
                    socket,
                    peer: unix::SocketAddr::from_pathname(path)?,
                    connected: false,
                })
            }
        }
    }

    /// Sends a frame. One for which there is no room is lost.
    ///
    /// # Errors
    /// Nobody is there, or the operating system refuses.
    pub fn send(&mut self, frame: &[u8; SIZE]) -> io::Result<()> {
        let sent = match self {
            Self::Udp(socket) => socket.send(frame),
            Self::Unix {
                socket,
                peer,
                connected,
            } => {
                if !*connected {
                    socket.connect_addr(peer)?;
                    *connected = true;
                }
                let sent = socket.send(frame);
                // A peer that begins again has another socket behind the same path.
                let full = |error: &io::Error| error.kind() == io::ErrorKind::WouldBlock;
                *connected = sent.as_ref().err().is_none_or(full);
                sent
            }
        };
        match sent {
            Err(error) if error.kind() != io::ErrorKind::WouldBlock => Err(error),
            _ => Ok(()),
        }
    }

    /// Waits until something has come, or an error, at most for `patience`.
    pub fn wait(&self, patience: Duration) {
        let mut fds = [match self {
            Self::Udp(socket) => PollFd::new(socket, PollFlags::IN),
            Self::Unix { socket, .. } => PollFd::new(socket, PollFlags::IN),
        }];
        // Who looks next sees whether something is there, whatever ended the wait.
        let patience = Timespec::try_from(patience).ok();
        let _ = poll(&mut fds, patience.as_ref());
    }

    /// The next datagram that is there, in `buffer`, which is longer than a frame; none if none is.
    ///
    /// # Errors
    /// Nobody is there, or the operating system refuses.
    pub fn receive<'b>(&self, buffer: &'b mut [u8; SIZE + 1]) -> io::Result<Option<&'b [u8]>> {
        let received = match self {
            Self::Udp(socket) => socket.recv(buffer),
            Self::Unix { socket, .. } => socket.recv(buffer),
        };
        match received {
            Ok(length) => Ok(buffer.get(..length)),
            Err(error) if error.kind() == io::ErrorKind::WouldBlock => Ok(None),
            Err(error) => Err(error),
        }
    }
}

/// The socket of a peer.
#[derive(Debug)]
pub enum PeerSocket {
    /// Over a network.
    Udp(UdpSocket),
    /// On this host; its path is removed with it.
    Unix(UnixDatagram, PathBuf),
}

/// Whom a peer answers.
#[derive(Debug, Clone)]
pub enum Sender {
    /// Over a network.
    Udp(SocketAddr),
    /// On this host.
    Unix(unix::SocketAddr),
}

impl PeerSocket {
    /// Listens at `address`. A path that a peer left behind is taken over.
    ///
    /// # Errors
    /// The operating system refuses, or another peer is there.
    pub fn bind(address: &Address) -> io::Result<Self> {
        match address {
            Address::Udp { host, port } => {
                let own = Address::resolve(host, *port)?;
                Ok(Self::Udp(UdpSocket::bind(own)?))
            }
            Address::Unix(path) => {
                let gone = UnixDatagram::unbound()?.connect(path);
                if gone.is_err_and(|error| error.kind() == io::ErrorKind::ConnectionRefused) {
                    std::fs::remove_file(path)?;
                }
                Ok(Self::Unix(UnixDatagram::bind(path)?, path.clone()))
            }
        }
    }

    /// The next datagram and who sent it; none if none comes within `patience`, which is at least 1 ms.
    ///
    /// # Errors
    /// The operating system refuses.
    pub fn receive<'b>(
        &self,
        buffer: &'b mut [u8; SIZE + 1],
        patience: Duration,
    ) -> io::Result<Option<(&'b [u8], Sender)>> {
        let patience = Some(patience.max(Duration::from_millis(1)));
        let received = match self {
            Self::Udp(socket) => {
                socket.set_read_timeout(patience)?;
                let received = socket.recv_from(buffer);
                received.map(|(length, from)| (length, Sender::Udp(from)))
            }
            Self::Unix(socket, _) => {
                socket.set_read_timeout(patience)?;
                let received = socket.recv_from(buffer);
                received.map(|(length, from)| (length, Sender::Unix(from)))
            }
        };
        use io::ErrorKind::{ConnectionRefused, Interrupted, TimedOut, WouldBlock};
        match received {
            Ok((length, from)) => Ok(buffer.get(..length).map(|bytes| (bytes, from))),
            // Refused was an answer to a driver that is gone.
            Err(error)
                if [ConnectionRefused, Interrupted, TimedOut, WouldBlock]
                    .contains(&error.kind()) =>
            {
                Ok(None)
            }
            Err(error) => Err(error),
        }
    }

    /// Answers; a driver that is gone does not hear it.
    pub fn send(&self, bytes: &[u8], to: &Sender) {
        // The driver sends its next command whatever becomes of this answer.
        let _ = match (self, to) {
            (Self::Udp(socket), Sender::Udp(to)) => socket.send_to(bytes, to),
            (Self::Unix(socket, _), Sender::Unix(to)) => socket.send_to_addr(bytes, to),
            _ => Ok(0),
        };
    }

    /// The port that it listens on, of UDP.
    #[must_use]
    pub fn port(&self) -> Option<u16> {
        match self {
            Self::Udp(socket) => socket.local_addr().ok().map(|own| own.port()),
            Self::Unix(..) => None,
        }
    }
}

impl Drop for PeerSocket {
    fn drop(&mut self) {
        if let Self::Unix(_, path) = self {
            // Whoever comes next removes it otherwise.
            let _ = std::fs::remove_file(path);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_address_is_written_as_it_was_read() {
        for text in [
            "udp:127.0.0.1:4560",
            "udp:[::1]:4560",
            "udp:robot.lab:1",
            "unix:arm.socket",
            "unix:/run/arm",
        ] {
            let address: Address = text.parse().unwrap();
            assert_eq!(address.to_string(), text);
        }
        let relative: Address = "unix:arm.socket".parse().unwrap();
        let found = relative.within(Path::new("/etc/app")).to_string();
        assert_eq!(found, "unix:/etc/app/arm.socket");
    }

    #[test]
    fn what_is_no_address_is_refused_with_the_reason() {
        let long = format!("unix:/{}", "a".repeat(200));
        for (text, why) in [
            ("", "neither"),
            ("tcp:localhost:1", "neither"),
            ("udp:localhost", "no port"),
            ("udp:localhost:0", "65535"),
            ("udp:localhost:65536", "65535"),
            ("udp:localhost:-1", "65535"),
            ("udp::4560", "no host"),
            ("udp: :4560", "no host"),
            ("udp:::1:4560", "brackets"),
            ("udp:[::g]:4560", "brackets"),
            ("unix:", "no path"),
            ("unix:a\0b", "zero byte"),
            (&long, "107"),
        ] {
            let refused = text.parse::<Address>().unwrap_err().to_string();
            assert!(refused.contains(why), "{text}: {refused}");
        }
    }
}
