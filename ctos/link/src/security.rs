//! Who may do what over a connection: keys, the role that each carries in its certificate, and mutual
//! TLS with them.
//!
//! One authority signs the keys of an installation. A key is a certificate and its private half; the
//! certificate names its holder and the holder's [`Role`]. Knows nothing of what is said over a
//! connection.

mod files;
mod tls;

use std::{fmt, io, path::PathBuf, str::FromStr};

use serde::{
    Deserialize, Serialize,
    de::{self, IntoDeserializer},
};

pub use files::{Listed, list_keys, make_key};
pub use tls::{BlockingStream, Keys};

#[cfg(feature = "zenoh")]
pub use files::KeyFiles;

/// What the holder of a key may do; each role includes those before it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Role {
    /// See what happens.
    Watch,
    /// Call tasks.
    Call,
    /// Stop, restart and move tasks.
    Control,
    /// Start chassis, and be one.
    Boot,
}

impl Role {
    /// All roles, the least first.
    pub const ALL: [Self; 4] = [Self::Watch, Self::Call, Self::Control, Self::Boot];
}

impl fmt::Display for Role {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.serialize(f)
    }
}

/// A word that is not a role.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("`{0}` is not a role; there are watch, call, control and boot")]
pub struct RoleError(String);

impl FromStr for Role {
    type Err = RoleError;

    fn from_str(text: &str) -> Result<Self, RoleError> {
        let role = Self::deserialize(text.into_deserializer());
        role.map_err(|_: de::value::Error| RoleError(text.to_owned()))
    }
}

/// Who is at the other end of a connection, as its certificate says.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Identity {
    /// The name of its key.
    pub name: String,
    /// What it may do.
    pub role: Role,
}

impl Identity {
    /// Whether it may do what needs `role`.
    #[must_use]
    pub fn may(&self, role: Role) -> bool {
        self.role >= role
    }

    /// As it stands in a certificate.
    fn uri(&self) -> String {
        format!("ctos:{}/{}", self.role, self.name)
    }

    /// Reads what [`Self::uri`] wrote.
    fn of_uri(uri: &str) -> Option<Self> {
        let (role, name) = uri.strip_prefix("ctos:")?.split_once('/')?;
        Some(Self {
            name: name.to_owned(),
            role: role.parse().ok()?,
        })
    }
}

/// A key that cannot be made, read or believed.
#[derive(Debug, thiserror::Error)]
pub enum KeyError {
    /// The connection failed, or the other end's certificate is not of this authority.
    #[error("{0}")]
    Io(#[from] io::Error),
    /// A file of the key cannot be read or written.
    #[error("{}: {error}", .path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// What the system said.
        error: io::Error,
    },
    /// A file holds something else.
    #[error("{} holds no {what}", .path.display())]
    Content {
        /// The file.
        path: PathBuf,
        /// What it should hold.
        what: &'static str,
    },
    /// Others may read a private key.
    #[error("{} may be read by others; take that away: chmod 600 {}", .path.display(), .path.display())]
    Open {
        /// The file.
        path: PathBuf,
    },
    /// A key of that name exists.
    #[error("{} exists already; choose another name, or remove the key first", .path.display())]
    Exists {
        /// The file.
        path: PathBuf,
    },
    /// The name cannot stand in a certificate.
    #[error(
        "`{name}` cannot be the name of a key; names are 1 to 64 letters, digits, `_`, `-` or `.`"
    )]
    Name {
        /// The name.
        name: String,
    },
    /// The library refused.
    #[error("the certificate cannot be used: {0}")]
    Certificate(String),
    /// The certificate names no role.
    #[error(
        "the other end's certificate names no holder and role; make its key with `ctos keys new`"
    )]
    NoRole,
    /// A web page had a browser call.
    #[error("it speaks HTTP, and this port is no page")]
    Browser,
    /// A caller through a socket of this host belongs to somebody else.
    #[error("the caller belongs to user {user}, not to this one")]
    User {
        /// The user's number.
        user: u32,
    },
}

#[cfg(test)]
mod tests;
