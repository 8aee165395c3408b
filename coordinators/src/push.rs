//! The task `push`: a thing is found by touch and pushed along a line, with a compliant arm.
//!
//! A Dispatcher ([`dispatcher`]) has the Push Coordinator ([`coordinator`]) go down beside the thing, approach until it feels it,
//! push it, and withdraw. A push ends by distance, by force, or when the contact is lost; then the Coordinator feels for the
//! thing again, a few times, and passes up only what it cannot solve. Both nets stand in `configs/nets/push/`; [`job`] is what
//! they exchange. A [`referee`] holds the result against the truth.

mod args;
pub mod coordinator;
pub mod dispatcher;
pub mod job;
pub mod referee;

#[cfg(test)]
mod tests;

use ctos::registry::Registry;

/// Registers the event handlers.
pub(crate) fn register(registry: &mut Registry) {
    coordinator::register(registry);
    dispatcher::register(registry);
    referee::register(registry);
}
