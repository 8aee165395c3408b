//! What a daemon and its callers send each other about requests.

use crate::request::{Method, Request};
use crate::transport::Transport;
use ctos::message::Command;
use ctos::task::HandlerError;
use serde::{Deserialize, Serialize};

/// What a daemon and its callers must agree in.
pub const VERSION: u32 = 2;

/// Asks an object of this daemon.
#[derive(Debug, Clone, Serialize, Deserialize, Command)]
#[command(name = "ask", reply = Transport, code = 0x0001)]
pub struct Ask {
    /// The caller's version of this command.
    pub(super) version: u32,
    /// The object, by its local name.
    pub(super) object: String,
    pub(super) method: Method,
    pub(super) body: Transport,
}

impl Ask {
    /// What is asked, of a caller of this version.
    pub(super) fn read(self) -> Result<Request, HandlerError> {
        same_version(self.version)?;
        Ok(Request {
            name: self.object.parse()?,
            method: self.method,
            body: self.body,
        })
    }
}

/// Does what [`Ask`] does, and answers nothing.
#[derive(Debug, Serialize, Deserialize, Command)]
#[command(name = "tell", code = 0x0013)]
pub struct Tell {
    pub(super) ask: Ask,
}

/// Refuses a caller of another version.
pub(super) fn same_version(version: u32) -> Result<(), HandlerError> {
    if version == VERSION {
        return Ok(());
    }
    Err(HandlerError::new(format!(
        "the caller speaks version {version} of service objects, this daemon {VERSION}: \
         run the same program on both sides"
    )))
}
