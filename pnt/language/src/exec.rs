//! One net in motion: marking, input tape, two-phase firing (architecture report, section 6). A
//! transition takes its tokens when it starts and puts tokens when its action is complete or has
//! failed. The caller runs actions, calls enabling functions and carries tokens to other nets; this
//! module only says which. It knows no clock and no task. The caller says what time it is for time
//! limits ([`Execution::advance_to`]). Transitions that take time fire when the caller fires them,
//! at the times that [`Race`] gives.
//!
//! A net is flat arrays here, and only transitions whose conditions a changed place decides are checked
//! again. So a firing costs the same in a net of ten transitions and in one of a hundred thousand, with
//! one token or a million. It allocates nothing.

mod choice;
mod enabling;
mod error;
mod events;
mod execution;
mod outside;
mod race;
mod running;
mod shares;
mod state;
mod tape;
mod wiring;

#[cfg(test)]
mod tests;

pub use choice::Conflicts;
pub use error::FireError;
pub use events::{End, Event, Happened, Wrote};
pub use execution::{Effects, Execution, Written};
pub use outside::Tokens;
pub use race::{Clock, Race};
pub use running::FiringId;
pub use state::{RestoreError, RunningFiring, State};
pub use tape::{OnTape, Tape};
