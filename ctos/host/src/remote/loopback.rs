//! To whom a connection over the loopback belongs: without keys only a caller of the same user is
//! heard, as on a Unix socket.

use std::{io, net::IpAddr, net::SocketAddr};

/// Whether the caller at `peer`, who called `ours` over the loopback, belongs to this user or to root.
///
/// # Errors
/// When the system does not tell.
pub(crate) fn is_same_user(peer: SocketAddr, ours: SocketAddr) -> io::Result<bool> {
    let us = rustix::process::geteuid().as_raw();
    for table in ["/proc/net/tcp", "/proc/net/tcp6"] {
        let text = match std::fs::read_to_string(table) {
            Ok(text) => text,
            // A host without IPv6 has no table of it.
            Err(error) if error.kind() == io::ErrorKind::NotFound => continue,
            Err(error) => return Err(error),
        };
        if let Some(owner) = owner_in(&text, peer, ours) {
            return Ok(owner == us || owner == 0);
        }
    }
    Ok(false)
}

/// The user of the socket at `local` that is connected to `remote`, as a table of the system has it.
fn owner_in(table: &str, local: SocketAddr, remote: SocketAddr) -> Option<u32> {
    table.lines().skip(1).find_map(|line| {
        let mut words = line.split_whitespace();
        let (here, there) = (address(words.nth(1)?)?, address(words.next()?)?);
        let same = |one: SocketAddr, other: SocketAddr| {
            one.ip().to_canonical() == other.ip().to_canonical() && one.port() == other.port()
        };
        // State, queues, timer, retransmissions, then the user.
        let owner = words.nth(4)?.parse().ok()?;
        (same(here, local) && same(there, remote)).then_some(owner)
    })
}

/// Reads `0100007F:1CF2`: words of four bytes in the order of this machine, then the port.
fn address(text: &str) -> Option<SocketAddr> {
    let (address, port) = text.split_once(':')?;
    let port = u16::from_str_radix(port, 16).ok()?;
    let word = |text: &str| Some(u32::from_str_radix(text, 16).ok()?.to_ne_bytes());
    let ip: IpAddr = match address.len() {
        8 => word(address)?.into(),
        32 => {
            let mut bytes = [0_u8; 16];
            for (index, part) in bytes.chunks_mut(4).enumerate() {
                part.copy_from_slice(&word(address.get(index * 8..index * 8 + 8)?)?);
            }
            bytes.into()
        }
        _ => return None,
    };
    Some((ip, port).into())
}

#[cfg(test)]
mod tests {
    use std::net::{TcpListener, TcpStream};

    use proptest::prelude::*;

    use super::*;

    #[test]
    fn a_caller_of_this_process_belongs_to_this_user_and_one_that_is_not_there_to_nobody() {
        for address in ["127.0.0.1:0", "[::1]:0"] {
            let Ok(listener) = TcpListener::bind(address) else {
                continue;
            };
            let ours = listener.local_addr().unwrap();
            let stream = TcpStream::connect(ours).unwrap();
            let peer = stream.local_addr().unwrap();
            assert!(is_same_user(peer, ours).unwrap(), "{address}");
            assert!(!is_same_user(ours, (ours.ip(), 1).into()).unwrap());
        }
    }

    #[test]
    fn the_owner_stands_in_the_line_of_the_connection() {
        if cfg!(target_endian = "big") {
            return;
        }
        let table = "  sl  local_address rem_address   st tx_queue rx_queue tr tm->when retrnsmt   uid  timeout inode
   0: 0100007F:1CF2 00000000:0000 0A 00000000:00000000 00:00000000 00000000  1000        0 1 1
   1: 0100007F:C350 0100007F:1CF2 01 00000000:00000000 00:00000000 00000000  1001        0 2 1\n";
        let at = |text: &str| text.parse::<SocketAddr>().unwrap();
        let owner = owner_in(table, at("127.0.0.1:50000"), at("127.0.0.1:7410"));
        assert_eq!(owner, Some(1001));
        assert_eq!(
            owner_in(table, at("127.0.0.1:50001"), at("127.0.0.1:7410")),
            None
        );
    }

    proptest! {
        #[test]
        fn a_table_of_rubbish_names_nobody(text in "[0-9A-F: \n]{0,300}") {
            let local = SocketAddr::from(([127, 0, 0, 1], 1));
            prop_assert_eq!(owner_in(&text, local, SocketAddr::from(([9, 9, 9, 9], 2))), None);
        }
    }
}
