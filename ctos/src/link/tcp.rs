//! Links over TCP: length-delimited frames after a handshake that proves both ends belong to the same
//! run of the same app.

use std::{fmt, net::SocketAddr, ops::ControlFlow, sync::Arc, time::Duration};

use bytes::Bytes;
use futures_util::{SinkExt, StreamExt, stream::SplitSink};
use serde::{Deserialize, Serialize};
use tokio::{
    net::{TcpListener, TcpStream},
    sync::mpsc,
    task::{JoinHandle, JoinSet},
};
use tokio_util::codec::{Framed, LengthDelimitedCodec};

use crate::{
    chassis::Chassis,
    link::{FRAME_LIMIT, Frame, Link},
};

/// Both ends must speak the same version.
pub(crate) const VERSION: u32 = 1;

/// The secret of one run, known to the chassis that were started for it.
#[derive(Clone, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct Token(pub(crate) String);

/// Handshakes are shown in logs; secrets are not.
impl fmt::Debug for Token {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Token(..)")
    }
}

impl Token {
    /// A fresh one from the operating system's randomness.
    pub(crate) fn fresh() -> std::io::Result<Self> {
        let mut bytes = [0_u8; 16];
        getrandom::fill(&mut bytes).map_err(|error| std::io::Error::other(error.to_string()))?;
        Ok(Self(
            bytes.iter().map(|byte| format!("{byte:02x}")).collect(),
        ))
    }
}

/// What is said before the first frame.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) enum Handshake {
    /// Who I am, and where I listen.
    Hello {
        version: u32,
        token: Token,
        chassis: u8,
        listen: Option<SocketAddr>,
    },
    /// I belong to the run, and cannot start.
    Refused { token: Token, reason: String },
    /// Where the other chassis listen.
    Peers(Vec<(u8, SocketAddr)>),
    /// I am connected to all of them.
    Ready,
    /// So are all the others: frames from here on.
    Go,
}

/// A handshake that went wrong.
#[derive(Debug, thiserror::Error)]
pub(crate) enum HandshakeError {
    #[error("the connection failed: {0}")]
    Io(#[from] std::io::Error),
    #[error("the other end closed the connection")]
    Closed,
    #[error("the other end does not speak this protocol: {0}")]
    Garbled(#[from] postcard::Error),
    #[error("the other end sent {0:?} where something else was expected")]
    Unexpected(Box<Handshake>),
    #[error("{0}")]
    Refused(String),
}

/// The largest frame before both ends know each other, bytes: a stranger's announcement must not make
/// anybody reserve memory.
const HANDSHAKE_LIMIT: usize = 64 * 1024;

/// A connection on its way to becoming a link.
pub(crate) struct Connection {
    framed: Framed<TcpStream, LengthDelimitedCodec>,
}

impl Connection {
    pub(crate) fn new(stream: TcpStream) -> std::io::Result<Self> {
        stream.set_nodelay(true)?;
        let codec = LengthDelimitedCodec::builder()
            .max_frame_length(HANDSHAKE_LIMIT)
            .little_endian()
            .new_codec();
        Ok(Self {
            framed: Framed::new(stream, codec),
        })
    }

    pub(crate) async fn tell(&mut self, handshake: &Handshake) -> Result<(), HandshakeError> {
        let bytes = postcard::to_stdvec(handshake)?;
        self.framed.send(Bytes::from(bytes)).await?;
        Ok(())
    }

    pub(crate) async fn hear(&mut self) -> Result<Handshake, HandshakeError> {
        let bytes = self.framed.next().await.ok_or(HandshakeError::Closed)??;
        Ok(postcard::from_bytes(&bytes)?)
    }

    /// Hears a [`Handshake::Hello`] of this run: the chassis's number and where it listens.
    async fn hear_hello(
        &mut self,
        token: &Token,
    ) -> Result<(u8, Option<SocketAddr>), HandshakeError> {
        match self.hear().await? {
            Handshake::Hello {
                version: VERSION,
                token: theirs,
                chassis,
                listen,
            } if theirs == *token => Ok((chassis, listen)),
            Handshake::Refused {
                token: theirs,
                reason,
            } if theirs == *token => Err(HandshakeError::Refused(reason)),
            other => Err(HandshakeError::Unexpected(Box::new(other))),
        }
    }

    /// Turns the connection into the link of `chassis` to `peer`. The handle ends when everything
    /// posted has been written.
    pub(crate) fn into_link(self, chassis: &Arc<Chassis>, peer: u8) -> JoinHandle<()> {
        let mut framed = self.framed;
        framed.codec_mut().set_max_frame_length(FRAME_LIMIT);
        let (mut sink, mut stream) = framed.split();
        let (sender, mut frames) = mpsc::unbounded_channel::<Frame>();
        chassis.link_up(peer, Arc::new(TcpLink { sender }));
        let receiver = chassis.clone();
        tokio::spawn(async move {
            while let Some(Ok(bytes)) = stream.next().await {
                match Frame::decode(&bytes) {
                    Ok(frame) => receiver.receive(peer, frame),
                    Err(error) => {
                        tracing::error!(peer = receiver.name_of(peer), error = %error, "bad frame");
                        break;
                    }
                }
            }
            receiver.link_down(peer);
        });
        let sender = chassis.clone();
        tokio::spawn(async move {
            if let Err(error) = write_all(&mut sink, &mut frames).await {
                tracing::error!(peer = sender.name_of(peer), error = %error, "cannot write");
                // Frames may be lost, so whoever waits must be told even if the other direction lives.
                sender.link_down(peer);
            }
        })
    }
}

/// Writes what is posted until nobody can post any more.
async fn write_all(
    sink: &mut SplitSink<Framed<TcpStream, LengthDelimitedCodec>, Bytes>,
    frames: &mut mpsc::UnboundedReceiver<Frame>,
) -> std::io::Result<()> {
    while let Some(frame) = frames.recv().await {
        sink.feed(frame.encode()).await?;
        while let Ok(frame) = frames.try_recv() {
            sink.feed(frame.encode()).await?;
        }
        sink.flush().await?;
    }
    Ok(())
}

struct TcpLink {
    sender: mpsc::UnboundedSender<Frame>,
}

impl Link for TcpLink {
    fn post(&self, frame: Frame) {
        // Fails only when the writer has ended, which the reader reports as a link that is down.
        let _ = self.sender.send(frame);
    }
}

/// Takes callers on `listener` until `enough` of them have shown that they belong to this run.
///
/// Callers are heard side by side: a stranger who says nothing, or rubbish, delays nobody.
///
/// # Errors
/// What `accept` says: [`HandshakeError::Refused`] when a chassis that belongs says it cannot start.
pub(crate) async fn callers(
    listener: &TcpListener,
    token: &Token,
    mut accept: impl FnMut(Caller) -> ControlFlow<()>,
) -> Result<(), HandshakeError> {
    let mut hellos = JoinSet::new();
    loop {
        tokio::select! {
            accepted = listener.accept() => match accepted {
                Ok((stream, _)) => {
                    let token = token.clone();
                    hellos.spawn(async move { Caller::hear(stream, &token).await });
                }
                // Aborted by the caller, or no file descriptors for the moment: others may succeed.
                Err(error) => {
                    tracing::warn!(error = %error, "a call was lost");
                    tokio::time::sleep(ACCEPT_PAUSE).await;
                }
            },
            Some(heard) = hellos.join_next() => match heard {
                Ok(Ok(caller)) => {
                    if accept(caller).is_break() {
                        return Ok(());
                    }
                }
                Ok(Err(HandshakeError::Refused(reason))) => {
                    return Err(HandshakeError::Refused(reason));
                }
                Ok(Err(error)) => tracing::warn!(error = %error, "a stranger called"),
                Err(error) => tracing::warn!(error = %error, "a stranger was not heard"),
            },
        }
    }
}

/// How long to wait after an `accept` that failed.
const ACCEPT_PAUSE: Duration = Duration::from_millis(20);

/// A chassis of this run that called.
pub(crate) struct Caller {
    pub(crate) chassis: u8,
    pub(crate) listen: Option<SocketAddr>,
    pub(crate) connection: Connection,
}

impl Caller {
    async fn hear(stream: TcpStream, token: &Token) -> Result<Self, HandshakeError> {
        let mut connection = Connection::new(stream)?;
        let (chassis, listen) = connection.hear_hello(token).await?;
        Ok(Self {
            chassis,
            listen,
            connection,
        })
    }
}

/// How long the last frames may take when a process ends.
pub(crate) const FLUSH_LIMIT: Duration = Duration::from_secs(1);

#[cfg(test)]
mod tests;
