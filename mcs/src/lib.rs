//! Motion Control System: slots, control laws, planning, state manager, client interface

pub mod arm;
pub mod control;
pub mod driver;
pub mod servo;
pub mod state;
pub mod trajectory;
