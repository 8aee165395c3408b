//! Topics and services of an app for ROS 2, over zenoh as `rmw_zenoh` lays it out: keys, CDR, attachments, liveliness tokens
//! and type hashes of ROS 2 Jazzy and Kilted. No ROS is installed for it.
//!
//! `[bridge.ros2]` in an app makes a task of the event handler [`HANDLER`]. It follows what other tasks show ([`scene`]) and
//! publishes that. It takes trajectories and serves services only by plain commands to the tasks that the configuration names,
//! and only with `allow_control = true`.
//!
//! The network is a feature, `zenoh`, that is off by default. Without it the table is refused with what to do.

mod args;
#[cfg(feature = "zenoh")]
mod control;
#[cfg(feature = "zenoh")]
mod endpoint;
#[cfg(feature = "zenoh")]
mod graph;
#[cfg(feature = "zenoh")]
mod messages;
#[cfg(feature = "zenoh")]
mod network;
#[cfg(feature = "zenoh")]
mod status;
#[cfg(feature = "zenoh")]
mod task;
#[cfg(feature = "zenoh")]
mod translate;

use ctos::registry::Registry;

pub use args::BridgeExpander;

/// The name of the event handler.
pub const HANDLER: &str = "bridge.ros2";

/// Registers the handler.
pub fn register(registry: &mut Registry) {
    #[cfg(feature = "zenoh")]
    let kind = registry.handler(HANDLER, &[], task::Bridge::new);
    #[cfg(not(feature = "zenoh"))]
    let kind = registry.handler(HANDLER, &[], |_| {
        Err::<not_built::NotBuilt, _>("this program was built without the feature `ros2`".into())
    });
    kind.checked_args(args::check);
    registry.app_check("bridge::ros2", args::check_app);
}

/// What stands for the handler in a program that was built without the network.
#[cfg(not(feature = "zenoh"))]
mod not_built {
    use ctos::{
        message::Message,
        task::{Context, EventHandler, Handled},
    };

    /// There is none.
    pub(super) enum NotBuilt {}

    impl EventHandler for NotBuilt {
        async fn handle(&mut self, _: &Context, _: Message) -> Handled {
            match *self {}
        }
    }
}
