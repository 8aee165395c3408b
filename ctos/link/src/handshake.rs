//! What is said over a stream before a session uses it. Both ends check that they belong to the same
//! run of the same app, and say up to which number each has heard the other.
//!
//! Everything a stranger sends is bounded, and nothing of it is believed before the run's secret was
//! said.

use std::io;

use serde::{Deserialize, Serialize, de::DeserializeOwned};
use tokio::io::{AsyncRead, AsyncReadExt, AsyncWrite, AsyncWriteExt};

use crate::{address::Address, noise};
use ctos_message::ChassisNumber;

/// The first bytes of a caller: the protocol, and its version.
pub const GREETING: [u8; 8] = *b"ctos\0\0\0\x07";

/// The most that is read before both ends know each other, bytes.
pub const HANDSHAKE_LIMIT: usize = 16 * 1024;

/// The secret of one run, known to the chassis that were started for it. Handshakes are shown in logs; secrets
/// are not.
#[derive(Clone, Serialize, Deserialize, derive_more::Debug)]
#[debug("Token(..)")]
pub struct Token(pub String);

/// In a time that does not depend on where they differ.
impl PartialEq for Token {
    fn eq(&self, other: &Self) -> bool {
        let (ours, theirs) = (self.0.as_bytes(), other.0.as_bytes());
        let differ = ours.iter().zip(theirs).fold(0, |all, (a, b)| all | (a ^ b));
        differ == 0 && ours.len() == theirs.len()
    }
}

impl Token {
    /// A fresh one from the operating system's randomness.
    ///
    /// # Errors
    /// When there is none.
    pub fn fresh() -> io::Result<Self> {
        Ok(Self(noise::text(noise::bytes::<16>()?)))
    }
}

/// A process, so that others on its host can see it end.
///
/// The default is one that nobody sees.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct Process {
    /// The same for all processes that see each other's numbers.
    pub host: String,
    pub pid: u32,
}

impl Process {
    /// This one.
    pub fn this() -> Self {
        let boot = std::fs::read_to_string("/proc/sys/kernel/random/boot_id").unwrap_or_default();
        // Process numbers mean something within their name space only, paths of sockets within that of
        // files; and a socket's folder is its user's.
        let space = |of: &str| {
            let link = std::fs::read_link(format!("/proc/self/ns/{of}"));
            link.map_or_else(|_| String::new(), |link| link.display().to_string())
        };
        let user = rustix::process::geteuid().as_raw();
        Self {
            host: format!("{}/{}/{}/{user}", boot.trim(), space("pid"), space("mnt")),
            pid: std::process::id(),
        }
    }

    /// Whether `other` runs where this one can see it.
    pub fn sees(&self, other: &Self) -> bool {
        // Without a name for the host nobody sees anybody.
        !self.host.starts_with('/') && !self.host.is_empty() && self.host == other.host
    }
}

/// A chassis that others can call.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Member {
    pub chassis: ChassisNumber,
    /// How often the chassis was started; the first time is 1.
    pub incarnation: u32,
    pub process: Process,
    /// Where it can be called itself.
    pub listen: Vec<Address>,
}

/// Who one end is.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Hello {
    pub member: Member,
    /// The number up to which it has received everything of the session.
    pub received: u64,
    /// Whether the caller would rather use shared memory from here on, and whether the called awaits it.
    pub shared: bool,
}

/// What a caller says.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub enum Greeting {
    /// Who it is.
    Hello { token: Token, hello: Hello },
    /// It belongs to the run, and cannot start.
    Unable {
        token: Token,
        chassis: ChassisNumber,
        reason: String,
    },
}

impl Greeting {
    pub fn token(&self) -> &Token {
        match self {
            Self::Hello { token, .. } | Self::Unable { token, .. } => token,
        }
    }
}

/// What the other end answers.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub enum Answer {
    /// Who it is, and frames from here on.
    Welcome(Hello),
    /// The caller was given up and may not come back.
    GivenUp,
}

/// A handshake that went wrong.
#[derive(Debug, thiserror::Error)]
pub enum HandshakeError {
    #[error("the connection failed: {0}")]
    Io(#[from] io::Error),
    #[error("the other end does not speak this protocol")]
    Foreign,
    #[error(
        "the other end speaks version {theirs} of the protocol, and this program version {ours}: run the same program at both"
    )]
    Version { theirs: u8, ours: u8 },
    #[error("the other end does not speak this protocol: {0}")]
    Garbled(#[from] postcard::Error),
    #[error("the other end announced {0} bytes where at most {HANDSHAKE_LIMIT} are allowed")]
    TooLong(usize),
    #[error("the other end does not know the secret of this run")]
    Stranger,
    #[error("it calls itself chassis {0}, which cannot be")]
    Nobody(ChassisNumber),
    #[error("its key has the role `{role}`, and a chassis needs `boot`")]
    Role { role: crate::security::Role },
    #[error("it said nothing in time")]
    Late,
}

/// Says in a protocol who calls.
///
/// # Errors
/// [`HandshakeError`].
pub async fn greet(
    stream: &mut (impl AsyncWrite + Unpin),
    protocol: [u8; 8],
    greeting: &impl Serialize,
) -> Result<(), HandshakeError> {
    stream.write_all(&protocol).await?;
    say(stream, greeting).await
}

/// Hears who calls, if it speaks this protocol.
///
/// # Errors
/// [`HandshakeError`].
pub async fn hear_greeting<T: DeserializeOwned>(
    stream: &mut (impl AsyncRead + Unpin),
    protocol: [u8; 8],
) -> Result<T, HandshakeError> {
    let mut said = protocol;
    stream.read_exact(&mut said).await?;
    let ([name @ .., theirs], [own_name @ .., ours]) = (said, protocol);
    match said == protocol {
        true => hear(stream).await,
        false if name == own_name => Err(HandshakeError::Version { theirs, ours }),
        false => Err(HandshakeError::Foreign),
    }
}

/// Says one thing, behind its length.
///
/// # Errors
/// [`HandshakeError`].
pub async fn say(
    stream: &mut (impl AsyncWrite + Unpin),
    what: &impl Serialize,
) -> Result<(), HandshakeError> {
    let body = postcard::to_stdvec(what)?;
    if body.len() > HANDSHAKE_LIMIT {
        return Err(HandshakeError::TooLong(body.len()));
    }
    let length = u32::try_from(body.len()).unwrap_or(u32::MAX).to_le_bytes();
    stream.write_all(&[&length[..], &body].concat()).await?;
    Ok(stream.flush().await?)
}

/// Hears one thing, and not a byte more.
///
/// # Errors
/// [`HandshakeError`].
pub async fn hear<T: DeserializeOwned>(
    stream: &mut (impl AsyncRead + Unpin),
) -> Result<T, HandshakeError> {
    let mut length = [0; 4];
    stream.read_exact(&mut length).await?;
    let length = usize::try_from(u32::from_le_bytes(length)).unwrap_or(usize::MAX);
    if length > HANDSHAKE_LIMIT {
        return Err(HandshakeError::TooLong(length));
    }
    let mut body = vec![0; length];
    stream.read_exact(&mut body).await?;
    Ok(postcard::from_bytes(&body)?)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn run<T>(test: impl Future<Output = T>) -> T {
        let runtime = tokio::runtime::Builder::new_current_thread().build();
        runtime.unwrap().block_on(test)
    }

    fn unable() -> Greeting {
        Greeting::Unable {
            token: Token("the secret of this run".to_owned()),
            chassis: 1,
            reason: "the port is taken".to_owned(),
        }
    }

    #[test]
    fn a_greeting_is_heard_and_nothing_behind_it_is_taken() {
        run(async {
            let mut bytes = Vec::new();
            greet(&mut bytes, GREETING, &unable()).await.unwrap();
            bytes.extend_from_slice(b"frames");
            let mut stream = bytes.as_slice();
            assert_eq!(
                hear_greeting::<Greeting>(&mut stream, GREETING)
                    .await
                    .unwrap(),
                unable()
            );
            assert_eq!(stream, b"frames");
        });
    }

    #[test]
    fn another_version_is_refused_with_both_and_another_protocol_as_such() {
        run(async {
            let says = async |mut said: &[u8]| {
                let heard = hear_greeting::<Greeting>(&mut said, GREETING).await;
                heard.unwrap_err().to_string()
            };
            let older = says(b"ctos\0\0\0\x06 and what it has to say").await;
            assert!(
                older.contains("version 6") && older.contains("version 7"),
                "{older}"
            );
            let foreign = says(b"GET / HTTP/1.1").await;
            assert_eq!(foreign, "the other end does not speak this protocol");
        });
    }

    #[test]
    fn secrets_are_not_shown_and_compare_by_all_of_their_letters() {
        let shown = format!("{:?}", unable());
        assert!(!shown.contains("secret"), "{shown}");
        let token = |text: &str| Token(text.to_owned());
        assert_eq!(token("ab"), token("ab"));
        assert!(
            token("ab") != token("ac") && token("ab") != token("abc") && token("") != token("a")
        );
    }

    #[test]
    fn an_announcement_beyond_the_limit_is_refused_before_anything_is_reserved() {
        run(async {
            let two_gibibytes = [&GREETING[..], &(1_u32 << 31).to_le_bytes()].concat();
            let error = hear_greeting::<Greeting>(&mut two_gibibytes.as_slice(), GREETING)
                .await
                .unwrap_err();
            assert!(matches!(error, HandshakeError::TooLong(length) if length == 1 << 31));
        });
    }

    proptest! {
        #[test]
        fn rubbish_is_an_error_and_never_a_panic(bytes in proptest::collection::vec(any::<u8>(), 0..200)) {
            let behind = [&GREETING[..], &bytes].concat();
            run(async {
                let _ = hear_greeting::<Greeting>(&mut bytes.as_slice(), GREETING).await;
                let _ = hear_greeting::<Greeting>(&mut behind.as_slice(), GREETING).await;
                let _ = hear::<Answer>(&mut bytes.as_slice()).await;
            });
        }
    }
}
