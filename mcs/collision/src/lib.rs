//! Collision detection as a module of motion control (the example of expandability in CIRSSE report 108, section 4): a
//! synchronous function and an event handler, in files of their own, which an app adds by configuration.
//!
//! [`guard`] is the function: a kind of guard called `collision`, which the servo asks in every tick. [`task`] is the
//! event handler `mcs.collision`, which tells what was found. [`distance`] has the geometry, [`scene`] the arms and the
//! room with what can touch what, [`sight`] what viewers see of it. Knows no simulator; of motion control it knows what any guard does.

pub mod distance;
pub mod guard;
pub mod scene;
pub mod sight;
pub mod task;

use ctos::registry::Registry;
use mcs::guard::GuardRegistry;

/// Registers the kind of guard `collision` and the event handler `mcs.collision`.
pub fn register(registry: &mut Registry, guards: &mut GuardRegistry) {
    guards.guard(guard::KIND, guard::build);
    task::register(registry);
}
