//! The control plane: how a person, or a program, looks at a running app and tells it what to do.
//!
//! The process that boots an app serves a Unix socket in a folder that belongs to its user alone
//! ([`folder`]). Clients speak to it in lines of JSON ([`protocol`]). To look at an app sends its tasks
//! nothing, so a stuck task is seen as well as any other.

pub mod protocol;

mod gate;
mod logs;
mod moves;
mod news;
mod place;
mod recording;
mod restarts;
mod server;
mod service;
mod view;

pub use logs::{Level, LogLine};
pub use place::{Socket, folder, prepared_folder, sockets};

pub(crate) use gate::Gate;
pub(crate) use logs::LogStore;
pub(crate) use news::Ticker;
pub(crate) use server::Server;
pub(crate) use view::ask;
