//! Viewers that are connected now, over the Foxglove WebSocket protocol. They look on: nothing can be ordered there.

use std::{
    cell::RefCell,
    collections::BTreeMap,
    net::{Ipv4Addr, SocketAddr},
    sync::Arc,
};

use cli_common::page::{Front, Served};
use ctos::{
    record::ChannelSchema,
    task::{Context as TaskContext, HandlerError},
};
use foxglove::{
    ChannelBuilder, Context, PartialMetadata, RawChannel, Schema, WebSocketServerHandle,
    websocket::{ChannelView, Client, ServerListener},
};
use tokio::sync::mpsc::{Sender, error::TrySendError};

use crate::{front, translate::Sent};

/// The server, on threads of its own, and the channels so far.
pub(crate) struct Live {
    context: Arc<Context>,
    channels: RefCell<BTreeMap<String, Arc<RawChannel>>>,
    server: WebSocketServerHandle,
    served: Served,
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
    /// Serves viewers of the app where `front` is bound; `comers` hears of those that come.
    ///
    /// # Errors
    /// The system has no port or no thread to give.
    pub(crate) fn open(
        cx: &TaskContext,
        front: Front,
        comers: Sender<()>,
    ) -> Result<Self, HandlerError> {
        let context = Context::new();
        // The server of the protocol knows no token and no keys: who may come is told in front of it.
        let server = context
            .websocket_server()
            .name(&cx.app().name)
            .bind(Ipv4Addr::LOCALHOST.to_string(), 0)
            .listener(Arc::new(Comers(comers)))
            .start_blocking()
            .map_err(|error| HandlerError::new(format!("viewers cannot be served: {error}")))?;
        let behind = SocketAddr::from((Ipv4Addr::LOCALHOST, server.port()));
        let served = front.serve_task(cx, "viewers", move |pages, door, stopped| {
            front::serve(pages, door, behind, stopped)
        })?;
        Ok(Self {
            context,
            channels: RefCell::default(),
            server,
            served,
        })
    }

    /// Where it is served, and the file that has the address with the token.
    pub(crate) fn served(&self) -> &Served {
        &self.served
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
