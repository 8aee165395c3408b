//! Byte streams between chassis: where one listens, how it is called, and what comes of a call.
//!
//! Unix sockets stay in a folder that only this user may enter. TCP is for the loopback and, with keys,
//! for other hosts; zenoh finds its own way. Knows nothing of sessions and frames.

use std::{
    any::Any,
    ffi::OsStr,
    io,
    net::SocketAddr,
    os::unix::fs::{DirBuilderExt, MetadataExt, PermissionsExt},
    path::{Path, PathBuf},
    sync::Arc,
};

use tokio::{
    io::{AsyncRead, AsyncReadExt, AsyncWrite, AsyncWriteExt},
    net::{TcpListener, TcpStream, UnixListener, UnixStream},
};

pub use crate::address::{Address, AddressError};
use crate::{
    noise,
    security::{Identity, KeyError, Keys},
    zenoh,
};

/// What a stream must be able to do. Any says what it is.
pub trait Bytes: AsyncRead + AsyncWrite + Send + Unpin + Any {}

impl<S: AsyncRead + AsyncWrite + Send + Unpin + Any> Bytes for S {}

/// A stream between two processes: a plain socket, TLS, or one over zenoh.
pub type Stream = Box<dyn Bytes>;

/// Whether it is a plain socket of this kind.
pub fn is<S: Any>(stream: &Stream) -> bool {
    let stream: &dyn Any = &**stream;
    stream.is::<S>()
}

/// A stream as the socket that it is.
///
/// # Errors
/// When it is another.
pub fn socket<S: Any>(stream: Stream) -> io::Result<S> {
    let stream: Box<dyn Any> = stream;
    let socket = stream.downcast().map_err(|_| io::ErrorKind::Unsupported)?;
    Ok(*socket)
}

/// A connection that could not be made, or whose other end did not prove who it is.
#[derive(Debug, thiserror::Error)]
pub enum ConnectError {
    #[error("{address}: {error}")]
    Io { address: Address, error: io::Error },
    #[error("{address}: {error}")]
    Key { address: Address, error: KeyError },
}

impl ConnectError {
    /// Whether nobody listens there: on the same host the process is gone then.
    pub fn is_refused(&self) -> bool {
        let Self::Io { error, .. } = self else {
            return false;
        };
        matches!(
            error.kind(),
            io::ErrorKind::ConnectionRefused | io::ErrorKind::NotFound
        )
    }
}

/// Calls `address`; over whatever others could listen to with keys, when there are any.
///
/// # Errors
/// [`ConnectError`].
pub async fn connect(
    address: &Address,
    keys: Option<&Arc<Keys>>,
    fabric: Option<&Arc<zenoh::Fabric>>,
) -> Result<(Stream, Option<Identity>), ConnectError> {
    let io = |error| ConnectError::Io {
        address: address.clone(),
        error,
    };
    let key = |error| ConnectError::Key {
        address: address.clone(),
        error,
    };
    match address {
        Address::Unix(path) => {
            let stream = UnixStream::connect(path).await.map_err(io)?;
            Ok((Box::new(stream), None))
        }
        Address::Tcp(to) => {
            let stream = TcpStream::connect(to).await.map_err(io)?;
            stream.set_nodelay(true).map_err(io)?;
            call(stream, keys).await.map_err(key)
        }
        Address::Zenoh(to) => {
            let none = || io::Error::other("this process is in no zenoh network");
            let stream = match fabric {
                Some(fabric) => fabric.connect(to).await,
                None => Err(none()),
            };
            let stream = stream.map_err(io)?;
            call(stream, keys).await.map_err(key)
        }
    }
}

/// Both ends of a call prove who they are, where there are keys.
async fn call(
    stream: impl Bytes,
    keys: Option<&Arc<Keys>>,
) -> Result<(Stream, Option<Identity>), KeyError> {
    let Some(keys) = keys else {
        return Ok((Box::new(stream), None));
    };
    let (stream, identity) = keys.call(stream).await?;
    Ok((Box::new(stream), Some(identity)))
}

/// As [`call`], where one is called.
async fn answer(
    stream: impl Bytes,
    keys: Option<Arc<Keys>>,
) -> Result<(Stream, Option<Identity>), KeyError> {
    let Some(keys) = keys else {
        return Ok((Box::new(stream), None));
    };
    let (stream, identity) = keys.answer(stream).await?;
    Ok((Box::new(stream), Some(identity)))
}

/// How much of what the other end says is still read when it is hung up on, bytes.
const UNHEARD_LIMIT: u64 = 64 << 10;

/// After how long without a word the system asks whether the other end is there.
const KEEP_ALIVE: std::time::Duration = std::time::Duration::from_secs(10);

/// A caller who has not said anything yet.
pub enum Call {
    Tcp(TcpStream, Option<Arc<Keys>>),
    Unix(UnixStream),
    Zenoh(zenoh::Caller, Option<Arc<Keys>>),
}

impl Call {
    /// Where it comes from, and where it arrived, if it came over a network.
    pub fn ends(&self) -> Option<(SocketAddr, SocketAddr)> {
        match self {
            Self::Tcp(stream, _) => Some((stream.peer_addr().ok()?, stream.local_addr().ok()?)),
            Self::Unix(_) | Self::Zenoh(..) => None,
        }
    }

    /// Lets the system notice when the other end is gone without a word.
    pub fn keep_alive(&self) {
        use rustix::net::sockopt::{set_socket_keepalive, set_tcp_keepidle, set_tcp_keepintvl};
        if let Self::Tcp(stream, _) = self {
            // One that is not watched is noticed when it is written to.
            let _ = set_socket_keepalive(stream, true);
            let _ = set_tcp_keepidle(stream, KEEP_ALIVE);
            let _ = set_tcp_keepintvl(stream, KEEP_ALIVE);
        }
    }

    /// Lets the caller prove who it is, where that is asked for.
    ///
    /// # Errors
    /// When it does not.
    pub async fn prove(self) -> Result<(Stream, Option<Identity>), KeyError> {
        match self {
            Self::Unix(stream) => {
                let theirs = stream.peer_cred()?.uid();
                let ours = rustix::process::geteuid().as_raw();
                // Root may do what it likes anyway.
                if theirs != ours && theirs != 0 {
                    return Err(KeyError::User { user: theirs });
                }
                Ok((Box::new(stream), None))
            }
            Self::Tcp(mut stream, keys) => {
                stream.set_nodelay(true)?;
                refuse_browser(&mut stream).await?;
                answer(stream, keys).await
            }
            Self::Zenoh(caller, keys) => answer(caller.answer().await?, keys).await,
        }
    }
}

/// What a browser is told at a port that is not a page.
pub const NO_PAGE: &str = "HTTP/1.1 403 Forbidden\r\nContent-Type: text/plain\r\n\
    Content-Length: 23\r\nConnection: close\r\n\r\nthis port is no page.\r\n";

/// Whether a caller's first words are those of HTTP. A browser writes to whatever port a page of any
/// site tells it to.
pub fn is_http(said: &[u8]) -> bool {
    const METHODS: [&str; 9] = [
        "GET ", "POST ", "PUT ", "HEAD ", "OPTIONS ", "PATCH ", "DELETE ", "CONNECT ", "TRACE ",
    ];
    let begins = |with: &str| {
        let start = said.get(..with.len());
        start.is_some_and(|start| start.eq_ignore_ascii_case(with.as_bytes()))
    };
    let line = said.split(|byte| *byte == b'\n').next().unwrap_or_default();
    METHODS.into_iter().any(begins)
        || begins("Host:")
        || line.windows(6).any(|part| part == b" HTTP/")
}

/// Tells a browser that this is not a page.
///
/// # Errors
/// [`KeyError::Browser`] when it is one.
async fn refuse_browser(stream: &mut TcpStream) -> Result<(), KeyError> {
    let mut first = [0; 64];
    // The caller of a port of ours speaks first.
    let length = stream.peek(&mut first).await?;
    if !is_http(first.get(..length).unwrap_or_default()) {
        return Ok(());
    }
    stream.write_all(NO_PAGE.as_bytes()).await?;
    hang_up(stream).await?;
    Err(KeyError::Browser)
}

/// Ends a stream whose last words the other end shall hear. What the other end has said and nobody reads would take
/// these words with it when the stream is closed.
///
/// # Errors
/// What the system says.
pub async fn hang_up(mut stream: impl AsyncRead + AsyncWrite + Unpin) -> io::Result<()> {
    stream.shutdown().await?;
    let mut rest = stream.take(UNHEARD_LIMIT);
    tokio::io::copy(&mut rest, &mut tokio::io::sink()).await?;
    Ok(())
}

/// Where calls come in.
pub enum Listener {
    Tcp(TcpListener, Option<Arc<Keys>>),
    Unix(UnixListener, SocketFile),
    Zenoh(zenoh::Listener, Option<Arc<Keys>>),
}

impl Listener {
    /// Listens at a port of this host; port 0 is a free one.
    ///
    /// # Errors
    /// What the system says: the port is taken, the address is not one of this host.
    pub async fn tcp(address: SocketAddr, keys: Option<Arc<Keys>>) -> io::Result<Self> {
        Ok(Self::Tcp(TcpListener::bind(address).await?, keys))
    }

    /// Listens at a new socket of this user's own folder; `name` stands in the file's name.
    ///
    /// # Errors
    /// When the folder is not this user's alone, or what the system says.
    pub fn unix(name: &str) -> io::Result<Self> {
        let folder = socket_folder()?;
        remove_stale(&folder);
        Self::unix_at(folder.join(socket_name(name, noise::bytes()?)))
    }

    /// Listens at a socket of this user's own, in place of whatever has its name.
    ///
    /// # Errors
    /// What the system says.
    pub fn unix_at(path: PathBuf) -> io::Result<Self> {
        let listener = listen_at(&path)?;
        Ok(Self::Unix(listener, SocketFile { path }))
    }

    /// Where others reach it.
    ///
    /// # Errors
    /// What the system says.
    pub fn address(&self) -> io::Result<Address> {
        match self {
            Self::Tcp(listener, _) => Ok(Address::Tcp(listener.local_addr()?)),
            Self::Unix(_, file) => Ok(Address::Unix(file.path.clone())),
            Self::Zenoh(listener, _) => Ok(Address::Zenoh(listener.key().to_owned())),
        }
    }

    /// The next caller.
    ///
    /// # Errors
    /// When this one was lost; others may succeed.
    pub async fn accept(&self) -> io::Result<Call> {
        match self {
            Self::Tcp(listener, keys) => {
                let (stream, _) = listener.accept().await?;
                Ok(Call::Tcp(stream, keys.clone()))
            }
            Self::Unix(listener, _) => {
                let (stream, _) = listener.accept().await?;
                Ok(Call::Unix(stream))
            }
            Self::Zenoh(listener, keys) => Ok(Call::Zenoh(listener.accept().await?, keys.clone())),
        }
    }
}

/// Listens at a socket that is this user's alone, in place of whatever has its name. It is bound under another
/// name until it listens: a socket to which nobody listens is stale, and the process that finds it removes it.
///
/// # Errors
/// What the system says.
fn listen_at(path: &Path) -> io::Result<UnixListener> {
    let begun = path.with_extension("new");
    // One of a process of the same number that was killed.
    let _ = std::fs::remove_file(&begun);
    let listener = UnixListener::bind(&begun)?;
    std::fs::set_permissions(&begun, std::fs::Permissions::from_mode(0o600))?;
    std::fs::rename(&begun, path)?;
    Ok(listener)
}

/// The file of a socket at which chassis `name` is called. It cannot be taken for a control socket, which is named
/// by the number of its process so that those of ended processes are found. (The noise may consist of digits alone.)
pub fn socket_name(name: &str, noise: [u8; 6]) -> String {
    let short: String = name.chars().take(16).collect();
    format!("{short}-{}.{LINK}", noise::text(noise))
}

/// How the files of sockets end at which chassis are called, and those of control sockets.
const LINK: &str = "link";
const CONTROL: &str = "sock";

/// A socket's file, removed when nobody listens any more.
pub struct SocketFile {
    path: PathBuf,
}

impl Drop for SocketFile {
    fn drop(&mut self) {
        // Somebody else has removed it: that is what was wanted.
        let _ = std::fs::remove_file(&self.path);
    }
}

/// The longest path that a socket's folder may have, so that the files in it fit into an address.
const FOLDER_LIMIT: usize = 64;

/// The folder of this user's sockets, made when it is not there: below `XDG_RUNTIME_DIR`, else below
/// the folder for temporary files.
fn socket_folder() -> io::Result<PathBuf> {
    let user = rustix::process::geteuid().as_raw();
    let own = std::env::var_os("XDG_RUNTIME_DIR").map(|folder| PathBuf::from(folder).join("ctos"));
    let fits = |folder: &PathBuf| folder.is_absolute() && folder.as_os_str().len() <= FOLDER_LIMIT;
    let temporary = std::env::temp_dir().join(format!("ctos-{user}"));
    let last = PathBuf::from(format!("/tmp/ctos-{user}"));
    let mut error = None;
    for folder in own.into_iter().chain([temporary, last]).filter(fits) {
        match private_folder(&folder, user) {
            Ok(()) => return Ok(folder),
            Err(reason) => error = Some(reason),
        }
    }
    Err(error.unwrap_or_else(|| io::Error::other("there is no folder for sockets")))
}

/// Makes sure that `folder` exists and that nobody but `user` may enter it: its owner could answer in the place
/// of an app.
///
/// # Errors
/// When it cannot be made, or somebody else may enter it.
pub fn private_folder(folder: &Path, user: u32) -> io::Result<()> {
    match std::fs::DirBuilder::new().mode(0o700).create(folder) {
        Err(error) if error.kind() != io::ErrorKind::AlreadyExists => return Err(error),
        _ => {}
    }
    let found = std::fs::symlink_metadata(folder)?;
    if !found.is_dir() || found.uid() != user || found.mode() & 0o077 != 0 {
        let text = format!(
            "{} is not a folder that belongs to you alone (mode 0700); remove it, or set XDG_RUNTIME_DIR",
            folder.display()
        );
        return Err(io::Error::new(io::ErrorKind::PermissionDenied, text));
    }
    Ok(())
}

/// Removes the sockets of processes that could not do so themselves.
fn remove_stale(folder: &Path) {
    let Ok(files) = std::fs::read_dir(folder) else {
        return;
    };
    for file in files.flatten() {
        let path = file.path();
        let is_socket = |end: &OsStr| end == LINK || end == CONTROL;
        if !path.extension().is_some_and(is_socket) {
            continue;
        }
        let refused = std::os::unix::net::UnixStream::connect(&path)
            .is_err_and(|error| error.kind() == io::ErrorKind::ConnectionRefused);
        if refused {
            // Another process that starts may have been faster.
            let _ = std::fs::remove_file(&path);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_folder_that_others_may_enter_is_not_used() {
        let user = rustix::process::geteuid().as_raw();
        let base = tempfile::tempdir().unwrap();
        let folder = base.path().join("ctos");
        private_folder(&folder, user).unwrap();
        private_folder(&folder, user).unwrap();
        std::fs::set_permissions(&folder, std::fs::Permissions::from_mode(0o755)).unwrap();
        let refused = private_folder(&folder, user).unwrap_err().to_string();
        assert!(refused.contains("belongs to you alone"), "{refused}");
        let link = base.path().join("link");
        std::os::unix::fs::symlink(&folder, &link).unwrap();
        std::fs::set_permissions(&folder, std::fs::Permissions::from_mode(0o700)).unwrap();
        assert!(private_folder(&link, user).is_err());
    }

    #[test]
    fn sockets_to_which_nobody_listens_are_removed_and_others_stay() {
        let folder = tempfile::tempdir().unwrap();
        for end in [LINK, CONTROL] {
            let stale = folder.path().join("a").with_extension(end);
            drop(std::os::unix::net::UnixListener::bind(&stale).unwrap());
            let live = folder.path().join("b").with_extension(end);
            let _listener = std::os::unix::net::UnixListener::bind(&live).unwrap();
            remove_stale(folder.path());
            assert!(!stale.exists() && live.exists());
        }
    }

    #[tokio::test]
    async fn whoever_finds_a_socket_finds_somebody_who_listens() {
        let folder = tempfile::tempdir().unwrap();
        for number in 0..200 {
            let path = folder.path().join(format!("app-{number}.sock"));
            let found = || loop {
                match std::os::unix::net::UnixStream::connect(&path) {
                    Err(error) if error.kind() == io::ErrorKind::NotFound => {}
                    found => return found.map(drop),
                }
            };
            std::thread::scope(|scope| {
                let found = scope.spawn(found);
                let _listener = listen_at(&path).unwrap();
                found.join().unwrap().unwrap();
            });
        }
    }
}
