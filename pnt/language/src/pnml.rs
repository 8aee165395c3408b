//! Place/transition nets in PNML, ISO/IEC 15909-2 (grammar of 2009), and the dialects that tools
//! write: 2004 files with `<value>` (PIPE, JARP), ProM's core nets, TAPAAL's attributes. A dialect is
//! read with a warning; what has no counterpart here is refused by name, never left out.
//!
//! What net text can say and PNML cannot stands in one `toolspecific` block per element, tool `pnt`, as
//! lines of net text. Tool sections of others, graphics and namespaces are kept and written back.

mod element;
mod label;
mod read;
mod write;
mod xml;

#[cfg(test)]
mod tests;

use std::collections::BTreeMap;

pub use read::read;
pub use write::write;

/// The net type that is written.
const TYPE: &str = "http://www.pnml.org/version-2009/grammar/ptnet";

/// The namespace that is written.
const NAMESPACE: &str = "http://www.pnml.org/version-2009/grammar/pnml";

/// The tool of our own sections.
const TOOL: &str = "pnt";

/// What of an element is no part of the net: raw XML, as it stood.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct KeptElement {
    /// Its id.
    pub id: Option<String>,
    /// Its own graphics and tool sections.
    pub own: Vec<String>,
    /// Those of its name.
    pub name: Vec<String>,
    /// Those of its initial marking or inscription.
    pub label: Vec<String>,
}

/// What of a PNML file is no part of the net and is written back. Elements are found by the names of
/// their nodes.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Kept {
    /// Prefixes of namespaces and what they stand for.
    pub namespaces: BTreeMap<String, String>,
    /// The net.
    pub net: KeptElement,
    /// Tool sections and graphics of all pages.
    pub page: Vec<String>,
    /// Places.
    pub places: BTreeMap<String, KeptElement>,
    /// Transitions.
    pub transitions: BTreeMap<String, KeptElement>,
    /// Arcs by their ends; `true` when the first is a place.
    pub arcs: BTreeMap<(bool, String, String), KeptElement>,
}
