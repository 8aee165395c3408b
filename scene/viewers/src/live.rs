//! Viewers that are connected now, over the Foxglove WebSocket protocol. They look on: nothing can be ordered there.

use std::{cell::RefCell, collections::BTreeMap, net::SocketAddr, sync::Arc};

use ctos::{record::ChannelSchema, task::HandlerError};
use foxglove::{
    ChannelBuilder, Context, PartialMetadata, RawChannel, Schema, WebSocketServerHandle,
    websocket::{ChannelView, Client, ServerListener},
};
use tokio::sync::mpsc::{Sender, error::TrySendError};

use crate::translate::Sent;

/// The server, on threads of its own, and the channels so far.
pub(crate) struct Live {
    context: Arc<Context>,
    channels: RefCell<BTreeMap<String, Arc<RawChannel>>>,
    server: WebSocketServerHandle,
}

/// Tells that somebody has come who lacks the whole.
struct Comers(Sender<()>);

impl ServerListener for Comers {
    fn on_subscribe(&self, _client: Client, _channel: ChannelView) {
        match self.0.try_send(()) {
            // One that waits already is for all; a task that has ended tells nobody anything.
            Ok(()) | Err(TrySendError::Full(()) | TrySendError::Closed(())) => {}
        }
    }
}

impl Live {
    /// Serves viewers of the app `name` at `listen`; `comers` hears of those that come.
    ///
    /// # Errors
    /// The address cannot be had.
    pub(crate) fn open(
        name: &str,
        listen: SocketAddr,
        comers: Sender<()>,
    ) -> Result<Self, HandlerError> {
        let context = Context::new();
        let server = context
            .websocket_server()
            .name(name)
            .bind(listen.ip().to_string(), listen.port())
            .listener(Arc::new(Comers(comers)))
            .start_blocking()
            .map_err(|error| {
                HandlerError::new(format!("viewers cannot be served at {listen}: {error}"))
            })?;
        Ok(Self {
            context,
            channels: RefCell::default(),
            server,
        })
    }

    /// Where it is served, when port 0 was asked for.
    pub(crate) fn port(&self) -> u16 {
        self.server.port()
    }

    /// Sends a message to those who have subscribed to its channel. One that is slow misses some.
    pub(crate) fn send(&self, sent: &Sent) {
        let mut channels = self.channels.borrow_mut();
        if !channels.contains_key(&sent.channel) {
            let ChannelSchema {
                name,
                language,
                text,
                encoding,
            } = &*sent.schema;
            let built = ChannelBuilder::new(sent.channel.clone())
                .context(&self.context)
                .message_encoding(encoding.clone())
                .schema(Schema::new(name.clone(), language.clone(), text.clone()))
                .build_raw();
            match built {
                Ok(channel) => drop(channels.insert(sent.channel.clone(), channel)),
                Err(error) => {
                    let channel = &sent.channel;
                    tracing::warn!(channel, %error, "a channel is not told to viewers");
                }
            }
        }
        if let Some(channel) = channels.get(&sent.channel) {
            let meta = PartialMetadata {
                log_time: Some(sent.at_ns),
            };
            channel.log_with_meta(&sent.bytes, meta);
        }
    }

    /// Ends the server.
    pub(crate) fn close(self) {
        // Its threads end by themselves.
        drop(self.server.stop());
    }
}
