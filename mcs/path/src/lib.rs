//! Path planning around obstacles: a way of an arm from one position to another on which it touches neither itself, nor
//! other arms, nor the room.
//!
//! [`space`] is what an arm may do: which positions and straight ways of its joints are free, by the solids that the
//! collision guard has (`mcs_collision`). [`search`] finds a way with two trees that grow towards one another (J. Kuffner and
//! S. LaValle, RRT-Connect, IEEE ICRA 2000), and [`way`] makes it shorter and says how much its corners may be rounded. The
//! same seed finds the same way. [`ahead`] looks along motions that somebody else has chosen. [`task`] is the event handler `mcs.path`, which plans for whoever asks, on any processor;
//! [`services`] the class `path`. Knows no servo, no simulator and no net: it plans, and moves nothing.

pub mod ahead;
pub mod search;
pub mod services;
pub mod space;
pub mod task;
pub mod way;

pub use ahead::Refused;
pub use search::{Options, PathError, Search};
pub use space::{Space, Touch};
pub use way::Way;

use ctos::registry::Registry;

/// Registers the event handler `mcs.path`.
pub fn register(registry: &mut Registry) {
    task::register(registry);
}
