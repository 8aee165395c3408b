//! What of a PNML file is not a part of the net, and the names of the grammar that is written.

use std::collections::BTreeMap;

/// The net type that is written.
pub(super) const TYPE: &str = "http://www.pnml.org/version-2009/grammar/ptnet";

/// The namespace that is written.
pub(super) const NAMESPACE: &str = "http://www.pnml.org/version-2009/grammar/pnml";

/// The tool of our own sections.
pub(super) const TOOL: &str = "pnt";

/// What of an element is not a part of the net: raw XML, as it stood.
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

/// What of a PNML file is not a part of the net and is written back. Elements are found by the names of
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
