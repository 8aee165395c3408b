//! What stands for [`zenoh`](super::zenoh) in a program that was built without it: a network that cannot be
//! joined. The configuration has said so before.

use std::{io, sync::Arc};

use crate::{config::App, transport::Stream};

/// There is none, so nobody listens at it and nobody calls.
pub enum Fabric {}

pub use Fabric as Listener;
pub use Fabric as Caller;

impl Fabric {
    /// Joins no network.
    ///
    /// # Errors
    /// When the configuration describes one.
    pub async fn join(app: &App, _: bool) -> io::Result<Option<Arc<Self>>> {
        match app.links.zenoh {
            None => Ok(None),
            Some(_) => Err(io::Error::other("this program was built without zenoh")),
        }
    }

    pub async fn listen(self: &Arc<Self>, _: &str) -> io::Result<Listener> {
        match **self {}
    }

    pub async fn connect(&self, _: &str) -> io::Result<Stream> {
        match *self {}
    }

    pub async fn close(&self) {
        match *self {}
    }

    pub fn key(&self) -> &str {
        match *self {}
    }

    pub async fn accept(&self) -> io::Result<Caller> {
        match *self {}
    }

    pub async fn answer(self) -> io::Result<Stream> {
        match self {}
    }
}
