//! The robot checkers player (SORMA technical report, section 2.1): the plot of a game over six daemons.
//!
//! `player` follows the plot, and has Coordinators do the rest: `vision` reads the board, `transform` says where its fields are,
//! `robot` and `hand` carry discs, `speaker` tells people. Their nets stand in `configs/nets/checkers/`. In a dry game a
//! `room` without physics is in the place of table, arm and person; `guest` is the hand of a person who plays from a display, to which
//! `drawn` shows the table, and `symbols` what the player believes; `shown` puts what is there before cameras; `real` moves
//! an arm and a gripper of a world with physics, and `meddling` is what befalls them. `referee` holds the
//! game against it. `wire` has what they exchange.

mod coordinator;
mod drawn;
mod guest;
mod hand;
mod meddling;
mod people;
mod person;
mod play;
mod player;
mod real;
mod referee;
mod robot;
mod room;
mod shown;
mod speaker;
mod state;
mod symbols;
mod table;
mod thinker;
mod transform;
mod vision;
mod wire;

use coordinator::RoomArgs;
use ctos::registry::Registry;

/// Registers the event handlers.
pub fn register(registry: &mut Registry) {
    coordinators::handler::register::<player::PlayerArgs>(registry);
    coordinators::handler::register::<vision::VisionArgs>(registry);
    coordinators::handler::register::<transform::TransformArgs>(registry);
    coordinators::handler::register::<RoomArgs<robot::Robot>>(registry);
    coordinators::handler::register::<RoomArgs<hand::Hand>>(registry);
    coordinators::handler::register::<people::PeopleArgs>(registry);
    coordinators::handler::register::<speaker::SpeakerArgs>(registry);
    room::register(registry);
    symbols::register(registry);
    thinker::register(registry);
    referee::register(registry);
}
