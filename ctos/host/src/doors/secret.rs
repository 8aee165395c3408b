//! The secret of a port at the loopback that has no keys. A program that may read files of this user
//! knows it, a page in the user's browser does not.

use std::{
    fs,
    io::{self, Write},
    net::SocketAddr,
    path::{Path, PathBuf},
};

use serde::{Deserialize, Serialize};

use crate::control;
use ctos_link::handshake::Token;

/// The longest secret in a file, bytes.
const LONGEST: usize = 256;

/// What a caller of a port must say.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Secret(Token);

/// A secret that cannot be read.
#[derive(Debug, thiserror::Error)]
pub enum SecretError {
    /// The file is not there, or belongs to somebody else.
    #[error("{}: {error}", .path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// What the system said.
        error: io::Error,
    },
    /// The file holds something else.
    #[error("{} holds no secret of a port", .path.display())]
    Content {
        /// The file.
        path: PathBuf,
    },
}

impl Secret {
    /// Reads the file that [`PortSecret`] wrote, or a copy of it.
    ///
    /// # Errors
    /// [`SecretError`].
    pub fn read(path: &Path) -> Result<Self, SecretError> {
        let text = fs::read_to_string(path).map_err(|error| SecretError::File {
            path: path.to_owned(),
            error,
        })?;
        let text = text.trim();
        if text.is_empty() || text.len() > LONGEST || !text.bytes().all(|b| b.is_ascii_hexdigit()) {
            return Err(SecretError::Content {
                path: path.to_owned(),
            });
        }
        Ok(Self(Token(text.to_owned())))
    }

    /// The secret of the port of this host and user at `address`.
    ///
    /// # Errors
    /// [`SecretError`].
    pub fn of_port(address: SocketAddr) -> Result<Self, SecretError> {
        Self::read(&place(&control::folder(), address))
    }
}

/// Where the secret of a port is.
fn place(folder: &Path, address: SocketAddr) -> PathBuf {
    folder.join(format!("{address}.token"))
}

/// The secret of a port that is open, in a file of this user alone; the file goes with it.
#[derive(Debug)]
pub struct PortSecret {
    secret: Secret,
    path: PathBuf,
}

impl PortSecret {
    /// Draws one and writes it down.
    ///
    /// # Errors
    /// The folder is not this user's alone, or what the system says.
    pub fn new(address: SocketAddr) -> io::Result<Self> {
        Self::within(&control::prepared_folder()?, address)
    }

    fn within(folder: &Path, address: SocketAddr) -> io::Result<Self> {
        let token = Token::fresh()?;
        let path = place(folder, address);
        private_file(&path, &token.0)?;
        Ok(Self {
            secret: Secret(token),
            path,
        })
    }

    /// Whether a caller said it.
    #[must_use]
    pub fn is(&self, said: Option<&Secret>) -> bool {
        said == Some(&self.secret)
    }

    /// Its file.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }
}

impl Drop for PortSecret {
    fn drop(&mut self) {
        // The port may have been given to another process, whose file this is by now.
        if Secret::read(&self.path).is_ok_and(|secret| secret == self.secret) {
            let _ = fs::remove_file(&self.path);
        }
    }
}

/// Writes a file that this user alone may read, from its first byte on, in place of whatever has its name.
///
/// # Errors
/// What the system says.
pub fn private_file(path: &Path, text: &str) -> io::Result<()> {
    let folder = path.parent().unwrap_or(Path::new("."));
    let mut begun = tempfile::NamedTempFile::new_in(folder)?;
    begun.write_all(text.as_bytes())?;
    begun.persist(path)?;
    Ok(())
}

#[cfg(test)]
mod tests {
    use std::os::unix::fs::PermissionsExt;

    use super::*;

    #[test]
    fn the_secret_of_a_port_is_this_users_alone_and_goes_with_the_port() {
        let folder = tempfile::tempdir().unwrap();
        let address: SocketAddr = "127.0.0.1:7411".parse().unwrap();
        let open = PortSecret::within(folder.path(), address).unwrap();
        let mode = fs::metadata(open.path()).unwrap().permissions().mode();
        assert_eq!(mode & 0o777, 0o600);
        let read = Secret::read(open.path()).unwrap();
        assert!(open.is(Some(&read)) && !open.is(None));
        assert!(!format!("{open:?}").contains(&read.0.0));
        // Another process has the port before the first has cleaned up.
        let next = PortSecret::within(folder.path(), address).unwrap();
        assert!(!next.is(Some(&read)));
        let path = next.path().to_owned();
        drop(open);
        assert!(path.exists());
        drop(next);
        assert!(!path.exists());
    }

    #[test]
    fn a_file_that_holds_something_else_is_no_secret() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a");
        assert!(matches!(Secret::read(&path), Err(SecretError::File { .. })));
        for text in ["", "GET / HTTP/1.1", &"a".repeat(1000)] {
            fs::write(&path, text).unwrap();
            let read = Secret::read(&path);
            assert!(matches!(read, Err(SecretError::Content { .. })), "{text}");
        }
    }
}
