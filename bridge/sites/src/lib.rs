//! Apps at several sites, joined by routers of zenoh: a task at another site has the local name `TASK@SITE`.
//!
//! `[site]` in an app makes one task, the *gate* ([`HANDLER`]), which alone speaks with the network. For each task of another
//! site that the app may ask it makes a *stand-in* ([`STAND_IN`]) of the name `TASK@SITE`. A stand-in hands what it is sent to
//! the gate, the gate at the other site asks the task there, and its answer or error comes back the same way:
//!
//! ```text
//! caller -> carry@north (stand-in) -> gate | router | router | gate of north -> carry
//! ```
//!
//! A site permits nothing unless its `allow` names the site, the task and the command. Whatever gates say is signed with the
//! app's key, which bears the name of the site: who asks is proved, whatever routers are between. Gates tell twice a second that they are
//! there. A site that is not heard for `cut_after_s` is cut off: whatever waits for it ends with
//! [`Fault::CutOff`](ctos::call::Fault::CutOff), and nothing more is sent there until it is heard again. Nothing is ever
//! repeated here. Who must know that a request was carried out once numbers it, as transfers between nets do.
//!
//! The network is a feature, `zenoh`, that is off by default. Without it the table is refused with what to do.

mod args;
#[cfg(feature = "zenoh")]
mod gate;
#[cfg(feature = "zenoh")]
mod network;
#[cfg(feature = "zenoh")]
mod proof;
#[cfg(feature = "zenoh")]
mod signature;
#[cfg(feature = "zenoh")]
mod sites;
#[cfg(feature = "zenoh")]
mod stand_in;
#[cfg(feature = "zenoh")]
mod wire;

use ctos::registry::Registry;

pub use args::SiteExpander;

/// The event handler of the gate.
pub const HANDLER: &str = "bridge.site";

/// The event handler of a stand-in.
pub const STAND_IN: &str = "bridge.site.task";

/// Registers the handlers.
pub fn register(registry: &mut Registry) {
    #[cfg(feature = "zenoh")]
    registry
        .handler(HANDLER, &gate::COMMANDS, gate::Gate::new)
        .checked_args(args::check);
    #[cfg(feature = "zenoh")]
    let stand_in = registry.handler(STAND_IN, &[], stand_in::StandIn::new);
    #[cfg(not(feature = "zenoh"))]
    registry
        .handler(HANDLER, &[], |_| not_built::refused())
        .checked_args(args::check);
    #[cfg(not(feature = "zenoh"))]
    let stand_in = registry.handler(STAND_IN, &[], |_| not_built::refused());
    stand_in
        .args::<args::StandInArgs>()
        .declares(args::commands);
    registry.app_check("bridge::site", args::check_app);
}

/// What stands for the handlers in a program that was built without the network.
#[cfg(not(feature = "zenoh"))]
mod not_built {
    use ctos::{
        message::Message,
        task::{Context, EventHandler, Handled, HandlerError},
    };

    /// There is none.
    pub(super) enum NotBuilt {}

    pub(super) fn refused() -> Result<NotBuilt, HandlerError> {
        Err("this program was built without the feature `zenoh`".into())
    }

    impl EventHandler for NotBuilt {
        async fn handle(&mut self, _: &Context, _: Message) -> Handled {
            match *self {}
        }
    }
}
