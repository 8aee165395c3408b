//! Links over TCP: length-delimited frames after a handshake that proves both ends belong to the same
//! run of the same app.

use std::{net::SocketAddr, sync::Arc, time::Duration};

use bytes::Bytes;
use futures_util::{SinkExt, StreamExt};
use serde::{Deserialize, Serialize};
use tokio::{net::TcpStream, sync::mpsc, task::JoinHandle};
use tokio_util::codec::{Framed, LengthDelimitedCodec};

use crate::{
    chassis::Chassis,
    link::{FRAME_LIMIT, Frame, Link},
};

/// Both ends must speak the same version.
pub(crate) const VERSION: u32 = 1;

/// The secret of one run, known to the chassis that were started for it.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct Token(pub(crate) String);

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
    /// I cannot start.
    Refused(String),
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

/// A connection on its way to becoming a link.
pub(crate) struct Connection {
    framed: Framed<TcpStream, LengthDelimitedCodec>,
}

impl Connection {
    pub(crate) fn new(stream: TcpStream) -> std::io::Result<Self> {
        stream.set_nodelay(true)?;
        let codec = LengthDelimitedCodec::builder()
            .max_frame_length(FRAME_LIMIT)
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
        match postcard::from_bytes(&bytes)? {
            Handshake::Refused(reason) => Err(HandshakeError::Refused(reason)),
            handshake => Ok(handshake),
        }
    }

    /// Hears a [`Handshake::Hello`] of this run: the chassis's number and where it listens.
    pub(crate) async fn hear_hello(
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
            other => Err(HandshakeError::Unexpected(Box::new(other))),
        }
    }

    /// Turns the connection into the link of `chassis` to `peer`. The handle ends when everything
    /// posted has been written.
    pub(crate) fn into_link(self, chassis: &Arc<Chassis>, peer: u8) -> JoinHandle<()> {
        let (mut sink, mut stream) = self.framed.split();
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
        tokio::spawn(async move {
            while let Some(frame) = frames.recv().await {
                if sink.feed(frame.encode()).await.is_err() {
                    return;
                }
                while let Ok(frame) = frames.try_recv() {
                    if sink.feed(frame.encode()).await.is_err() {
                        return;
                    }
                }
                if sink.flush().await.is_err() {
                    return;
                }
            }
        })
    }
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

/// How long the last frames may take when a process ends.
pub(crate) const FLUSH_LIMIT: Duration = Duration::from_secs(1);
