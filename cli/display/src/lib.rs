//! The display: an event handler that anyone can put into an app, `pnt.display`. It follows the streams of nets
//! ([`pnt::stream`]), of scenes ([`scene`]) and of summaries ([`scene_summary`]), and serves a page that shows them, to as many browsers as its limit permits.
//!
//! The task runs on its processor, the server on a thread of its own. Between them stands the `hub`:
//! what is known of all nets, and the messages about what is new. A slow browser loses messages there
//! and gets the whole state again; no net is ever asked for that.
//!
//! Two commands show nets outside of an app: `ctos display` ([`watch`]) and `ctos net draw` ([`draw`]).

mod args;
mod arrange;
mod assets;
pub mod draw;
mod figure;
mod handled;
mod handles;
mod hub;
mod lines;
mod looking;
mod orders;
mod overview;
mod panes;
mod plans;
mod record;
mod server;
mod standing;
mod summing;
mod task;
mod text;
pub mod watch;
mod wire;

pub use args::{DEFAULT_LISTEN, HANDLER, displays_of};

use ctos::registry::Registry;

/// Registers the handler.
pub fn register(registry: &mut Registry) {
    registry
        .handler(HANDLER, &[], task::NetDisplay::new)
        .checked_args(args::check);
    registry.app_check(HANDLER, args::check_overviews);
}
