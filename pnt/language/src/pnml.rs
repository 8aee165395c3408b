//! Place/transition nets in PNML, ISO/IEC 15909-2 (grammar of 2009), and in the dialects that tools
//! write. These are 2004 files with `<value>` (PIPE, JARP), ProM's core nets, TAPAAL's attributes. A
//! dialect is read with a warning; what has no counterpart here is refused by name, never left out.
//!
//! What net text can say and PNML cannot stands in one `toolspecific` block per element, tool `pnt`, as
//! lines of net text. Tool sections of others, graphics and namespaces are kept and written back.

mod element;
pub(crate) mod kept;
mod label;
mod read;
mod write;
mod xml;

#[cfg(test)]
mod tests;

pub use kept::{Kept, KeptElement};
pub use read::read;
pub use write::{only_here, write};
