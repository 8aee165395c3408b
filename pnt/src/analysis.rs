//! Proofs about nets. From bottom to top:
//!
//! - [`model`]: a net as the analyses see it, numbers only;
//! - [`explicit`]: its markings one by one; [`returns`]: where they lead in the end;
//!
//! Knows no net text and no finding: [`crate::check`] says in words what is proved here.

pub mod explicit;
mod layout;
pub mod model;
pub mod returns;
mod store;

#[cfg(test)]
pub(crate) mod samples;
