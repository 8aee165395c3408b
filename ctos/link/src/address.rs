//! Where a chassis can be reached, as text and as data.

use std::{net::SocketAddr, path::PathBuf, str::FromStr};

use derive_more::Display;
use serde::{Deserialize, Serialize};

/// Where a chassis can be reached.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, Display)]
pub enum Address {
    /// A port of a host.
    #[display("tcp:{_0}")]
    Tcp(SocketAddr),
    /// A socket in the file system of this host.
    #[display("unix:{}", _0.display())]
    Unix(PathBuf),
    /// A key of the zenoh network that the app's processes have joined.
    #[display("zenoh:{_0}")]
    Zenoh(String),
}

/// A text that is not an address.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("`{0}` is not an address; write tcp:IP:PORT, unix:/PATH or zenoh:KEY")]
pub struct AddressError(String);

impl FromStr for Address {
    type Err = AddressError;

    fn from_str(text: &str) -> Result<Self, AddressError> {
        let wrong = || AddressError(text.to_owned());
        if let Some(path) = text.strip_prefix("unix:") {
            let path = PathBuf::from(path);
            return if path.is_absolute() {
                Ok(Self::Unix(path))
            } else {
                Err(wrong())
            };
        }
        if let Some(key) = text.strip_prefix("zenoh:") {
            let key = is_plain_key(key).then(|| Self::Zenoh(key.to_owned()));
            return key.ok_or_else(wrong);
        }
        let address = text.strip_prefix("tcp:").unwrap_or(text);
        address.parse().map(Self::Tcp).map_err(|_| wrong())
    }
}

/// Whether it is a key of a zenoh network that stands for itself only: no wildcards, no empty parts.
pub fn is_plain_key(key: &str) -> bool {
    let plain = |byte: u8| byte.is_ascii_alphanumeric() || b"_-.%/".contains(&byte);
    key.len() <= 1024 && key.bytes().all(plain) && key.split('/').all(|part| !part.is_empty())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn addresses_survive_their_text() {
        for text in [
            "tcp:127.0.0.1:80",
            "tcp:[::1]:1",
            "unix:/run/x.sock",
            "zenoh:ctos/cell/a-0f",
        ] {
            assert_eq!(text.parse::<Address>().unwrap().to_string(), text);
        }
        assert_eq!(
            "127.0.0.1:80".parse::<Address>().unwrap().to_string(),
            "tcp:127.0.0.1:80"
        );
        for text in [
            "",
            "unix:",
            "unix:relative",
            "tcp:host",
            "127.0.0.1",
            "zenoh:",
            "zenoh:a//b",
            "zenoh:ctos/**",
        ] {
            assert!(text.parse::<Address>().is_err(), "{text}");
        }
    }
}
