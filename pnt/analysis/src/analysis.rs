//! Proofs about nets. From bottom to top:
//!
//! - [`model`]: a net as the analyses see it, numbers only;
//! - [`explicit`]: its markings one by one; [`returns`]: where they lead in the end;
//! - [`symbolic`]: the markings as a decision diagram; [`stubborn`]: whether any is dead, by looking at few;
//! - [`cover`]: what an unbounded net can cover; [`structure`]: what follows from the arcs alone;
//! - [`question`]: what an author asks about them; [`play`]: a firing sequence, step by step;
//! - [`verdict`]: all that in numbers.
//!
//! Only [`question`] reads a text and makes findings of it, about that text. The rest knows numbers only;
//! [`crate::check`] says in words what is proved here.

mod compare;
pub mod cover;
pub mod explicit;
mod layout;
pub mod model;
pub mod play;
pub mod question;
pub mod returns;
pub mod stop;
mod store;
pub mod structure;
pub mod stubborn;
pub mod symbolic;
mod tables;
pub mod verdict;

#[cfg(test)]
mod definitions;
#[cfg(test)]
pub(crate) mod samples;
