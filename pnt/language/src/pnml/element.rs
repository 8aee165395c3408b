//! What a PNML document contains, found in one walk through its pages, and what the ids stand for.
//! Reference nodes are followed to what they stand for. Knows no tokens and no weights.

use std::collections::{BTreeMap, BTreeSet};

use ctos::diagnostic::{Finding, Findings, Source};
use roxmltree::Node;

use crate::enough::enough;

use super::{
    label::{is_ours, kept, short},
    xml::{attribute, attribute_range, elements, name, opening},
};

/// A place or a transition by its position in its list.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum End {
    Place(usize),
    Transition(usize),
}

/// What an id stands for.
#[derive(Clone, Copy)]
enum Target<'a, 'i> {
    Node(End),
    Reference(Node<'a, 'i>),
    Other,
}

/// Everything in a net.
pub(super) struct Elements<'a, 'i> {
    pub(super) places: Vec<Node<'a, 'i>>,
    pub(super) transitions: Vec<Node<'a, 'i>>,
    pub(super) arcs: Vec<Node<'a, 'i>>,
    references: Vec<Node<'a, 'i>>,
    /// Graphics and tool sections of pages.
    pub(super) page: Vec<String>,
    /// Our own sections of the net and its pages.
    pub(super) ours: Vec<Node<'a, 'i>>,
    ids: BTreeMap<&'a str, Target<'a, 'i>>,
    unknown: BTreeSet<&'i str>,
}

/// What tools put into places, transitions, arcs and nets beside what the standard has, and what
/// changes nothing in a place/transition net.
const HARMLESS: [&str; 17] = [
    "name",
    "graphics",
    "toolspecific",
    "initialMarking",
    "inscription",
    "orientation",
    "tagged",
    "arcpath",
    "arctype",
    "type",
    "rate",
    "timed",
    "infiniteServer",
    "priority",
    "capacity",
    "finalmarkings",
    "labels",
];

/// What changes the meaning of a net and has no counterpart here.
const UNREADABLE: [&str; 9] = [
    "declaration",
    "condition",
    "hlinitialMarking",
    "hlinscription",
    "structure",
    "shared-place",
    "shared-transition",
    "colorinvariant",
    "colorexpression",
];

impl<'a, 'i> Elements<'a, 'i> {
    /// Walks through a net.
    pub(super) fn of(source: &Source, net: Node<'a, 'i>, findings: &mut Findings) -> Self {
        let mut elements = Self {
            places: Vec::new(),
            transitions: Vec::new(),
            arcs: Vec::new(),
            references: Vec::new(),
            page: Vec::new(),
            ours: Vec::new(),
            ids: BTreeMap::new(),
            unknown: BTreeSet::new(),
        };
        elements.walk(source, net, findings);
        for reference in elements.references.clone() {
            if enough(findings) {
                break;
            }
            // Also those that no arc uses.
            let end = elements.follow(source, reference, findings);
            let wanted_place = name(reference) == "referencePlace";
            if end.is_some_and(|end| matches!(end, End::Place(_)) != wanted_place) {
                findings.push(
                    Finding::error(
                        "pnt::pnml::reference",
                        format!("this {} refers to a node of another kind", name(reference)),
                    )
                    .at(source.at(attribute_range(reference, "ref")))
                    .help("a reference place stands for a place, a reference transition for a transition"),
                );
            }
        }
        elements
    }

    /// Pages lie at most as deep in each other as XML elements may.
    fn walk(&mut self, source: &Source, container: Node<'a, 'i>, findings: &mut Findings) {
        for node in elements(container) {
            if enough(findings) {
                return;
            }
            let kind = name(node);
            match kind {
                "place" => {
                    let end = End::Place(self.places.len());
                    self.places.push(node);
                    self.id(source, node, Target::Node(end), findings);
                }
                "transition" => {
                    let end = End::Transition(self.transitions.len());
                    self.transitions.push(node);
                    self.id(source, node, Target::Node(end), findings);
                }
                "referencePlace" | "referenceTransition" => {
                    self.references.push(node);
                    self.id(source, node, Target::Reference(node), findings);
                }
                "arc" => {
                    self.arcs.push(node);
                    if attribute(node, "id").is_some() {
                        self.id(source, node, Target::Other, findings);
                    }
                }
                "page" => {
                    if attribute(node, "id").is_some() {
                        self.id(source, node, Target::Other, findings);
                    }
                    self.page.extend(kept(source, node));
                    self.walk(source, node, findings);
                }
                "toolspecific" if is_ours(node) => self.ours.push(node),
                _ => self.other(source, node, findings),
            }
            if matches!(kind, "place" | "transition" | "arc") {
                for child in elements(node) {
                    self.other(source, child, findings);
                }
            }
        }
    }

    /// An element that is not a node, arc or page.
    fn other(&mut self, source: &Source, node: Node<'a, 'i>, findings: &mut Findings) {
        let kind = name(node);
        let parent = node.parent().map_or("net", name);
        if UNREADABLE.contains(&kind) {
            findings.push(
                Finding::error(
                    "pnt::pnml::unsupported",
                    format!(
                        "a `{kind}` of a {parent} has no counterpart in a place/transition net"
                    ),
                )
                .at(source.at(opening(node)))
                .help("have the tool that wrote the file unfold it into a place/transition net"),
            );
        } else if !HARMLESS.contains(&kind) && self.unknown.insert(kind) {
            findings.push(
                Finding::warning(
                    "pnt::pnml::dialect",
                    format!("`{kind}` of a {parent} is no part of PNML and was not read"),
                )
                .at(source.at(opening(node)))
                .help("what belongs to a tool stands in a `toolspecific` element, which is kept"),
            );
        }
    }

    fn id(
        &mut self,
        source: &Source,
        node: Node<'a, 'i>,
        target: Target<'a, 'i>,
        findings: &mut Findings,
    ) {
        let kind = name(node);
        let Some(id) = attribute(node, "id")
            .map(str::trim)
            .filter(|id| !id.is_empty())
        else {
            findings.push(
                Finding::error("pnt::pnml::id", format!("this {kind} has no id"))
                    .at(source.at(opening(node)))
                    .help("give it an id of its own: arcs and references name it by that"),
            );
            return;
        };
        if self.ids.insert(id, target).is_some() {
            findings.push(
                Finding::error(
                    "pnt::pnml::id",
                    format!("the id `{}` of this {kind} is there already", short(id)),
                )
                .at(source.at(attribute_range(node, "id")))
                .help("ids are unique in a document, over all its pages and kinds of element"),
            );
        }
    }

    /// The place or transition that an attribute of `node` names, through all references.
    pub(super) fn end(
        &self,
        source: &Source,
        node: Node<'a, 'i>,
        which: &str,
        findings: &mut Findings,
    ) -> Option<End> {
        let kind = name(node);
        let Some(id) = attribute(node, which).map(str::trim) else {
            findings.push(
                Finding::error(
                    "pnt::pnml::reference",
                    format!("this {kind} has no `{which}`"),
                )
                .at(source.at(opening(node)))
                .help(format!("add {which}=\"ID\" with the id of a node")),
            );
            return None;
        };
        match self.ids.get(id) {
            Some(Target::Node(end)) => Some(*end),
            Some(Target::Reference(reference)) if name(node) == "arc" => {
                // A mistake of a reference is one finding, about the reference.
                self.follow(source, *reference, &mut Findings::new())
            }
            Some(Target::Reference(_)) => None,
            Some(Target::Other) | None => {
                let nodes = self.ids.iter();
                let known = nodes.filter(|(_, target)| !matches!(target, Target::Other));
                let finding = Finding::error(
                    "pnt::pnml::reference",
                    format!(
                        "the {which} of this {kind} is `{}`, and no node has that id",
                        short(id)
                    ),
                )
                .at(source.at(attribute_range(node, which)))
                .help("name the id of a place or a transition");
                let few: Vec<&str> = known.map(|(id, _)| *id).take(1000).collect();
                findings.push(finding.suggest(id, few));
                None
            }
        }
    }

    /// What a reference node stands for at the end of its chain.
    fn follow(
        &self,
        source: &Source,
        reference: Node<'a, 'i>,
        findings: &mut Findings,
    ) -> Option<End> {
        let mut now = reference;
        for _ in 0..=self.references.len() {
            let next = attribute(now, "ref")
                .map(str::trim)
                .and_then(|id| self.ids.get(id));
            match next {
                Some(Target::Reference(next)) => now = *next,
                // Told about the last of the chain, which is a reference, too.
                _ if now != reference => return self.end(source, now, "ref", &mut Findings::new()),
                _ => return self.end(source, now, "ref", findings),
            }
        }
        findings.push(
            Finding::error(
                "pnt::pnml::reference",
                format!("this {} refers to itself in a circle", name(reference)),
            )
            .at(source.at(attribute_range(reference, "ref")))
            .help("let one of the circle refer to a place or a transition"),
        );
        None
    }
}
