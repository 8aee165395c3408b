//! What stands for [`zenoh`](super::zenoh) in a program that was built without it: a network that cannot be
//! joined. The configuration has said so before.

use std::{io, sync::Arc};

use crate::{config::App, link::session::Bytes};

/// There is none.
pub(crate) enum Fabric {}

/// There is none.
pub(crate) enum Listener {}

/// There is none.
pub(crate) enum Caller {}

/// There is none.
pub(crate) type ZenohStream = tokio::io::Empty;

impl Bytes for ZenohStream {}

impl Fabric {
    /// Joins no network.
    ///
    /// # Errors
    /// When the configuration describes one.
    pub(crate) async fn join(app: &App, _: bool) -> io::Result<Option<Arc<Self>>> {
        match app.links.zenoh {
            None => Ok(None),
            Some(_) => Err(io::Error::other("this program was built without zenoh")),
        }
    }

    pub(crate) async fn listen(self: &Arc<Self>, _: &str) -> io::Result<Listener> {
        match **self {}
    }

    pub(crate) async fn connect(&self, _: &str) -> io::Result<ZenohStream> {
        match *self {}
    }

    pub(crate) async fn close(&self) {
        match *self {}
    }
}

impl Listener {
    pub(crate) fn key(&self) -> &str {
        match *self {}
    }

    pub(crate) async fn accept(&self) -> io::Result<Caller> {
        match *self {}
    }
}

impl Caller {
    pub(crate) async fn answer(self) -> io::Result<ZenohStream> {
        match self {}
    }
}
