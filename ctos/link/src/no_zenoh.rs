//! What stands for [`zenoh`](super::zenoh) in a program that was built without it: a network that cannot be
//! joined. The configuration has said so before.

use std::{io, sync::Arc};

use crate::config::App;

/// There is none.
pub enum Fabric {}

/// There is none.
pub enum Listener {}

/// There is none.
pub enum Caller {}

/// There is none.
pub type ZenohStream = tokio::io::Empty;

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

    pub async fn connect(&self, _: &str) -> io::Result<ZenohStream> {
        match *self {}
    }

    pub async fn close(&self) {
        match *self {}
    }
}

impl Listener {
    pub fn key(&self) -> &str {
        match *self {}
    }

    pub async fn accept(&self) -> io::Result<Caller> {
        match *self {}
    }
}

impl Caller {
    pub async fn answer(self) -> io::Result<ZenohStream> {
        match self {}
    }
}
