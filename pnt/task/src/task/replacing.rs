//! A net that waits to be put in the place of the running one.

use std::sync::Arc;

use ctos::message::Replier;
use pnt_language::net::Net;

use super::messages::Control;

/// A net that waits to be put in place.
pub(super) struct Replacing {
    pub(super) number: u64,
    pub(super) file: String,
    pub(super) text: String,
    /// Who wants it.
    pub(super) by: String,
    pub(super) net: Arc<Net>,
    pub(super) reply: Replier<Control>,
}
