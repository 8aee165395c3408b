//! From PNML to a draft.

use std::{
    collections::{BTreeMap, BTreeSet},
    time::Duration,
};

use ctos::diagnostic::{Finding, Findings, Place as At, Source};
use roxmltree::Node;

use super::{
    element::{Elements, End},
    kept::{Kept, KeptElement, TYPE},
    label::{self, Label, is_ours, kept, kept_of_label, label, number, only, positions, short},
    xml::{self, attribute, attribute_range, elements, name, opening, text},
};
use crate::{
    draft::{Draft, DraftArc, DraftPlace, DraftTransition, Word},
    enough::enough,
    format::file::{Format, NetFile, Positions},
    text::{self as net_text, MOST_TOKENS},
    timing::{Servers, Timing},
};

/// Reads a document.
///
/// # Errors
/// All findings, when at least one of them is an error.
pub fn read(source: &Source) -> Result<NetFile, Findings> {
    let document = xml::parse(source)?;
    let mut findings = Findings::new();
    let Some(net) = the_net(source, document.root_element(), &mut findings) else {
        return Err(findings);
    };
    let elements = Elements::of(source, net, &mut findings);
    let reader = Reader {
        source,
        elements,
        findings,
        place_names: Vec::new(),
        transition_names: Vec::new(),
        positions: Positions::default(),
        kept: Kept::default(),
        counted: (0, 1, 1),
    };
    reader.read(net)
}

/// The only net of a document, if its type can be read.
fn the_net<'a, 'i>(
    source: &Source,
    root: Node<'a, 'i>,
    findings: &mut Findings,
) -> Option<Node<'a, 'i>> {
    let error = |message: String, node: Node<'_, '_>| {
        Finding::error("pnt::pnml::net", message).at(source.at(opening(node)))
    };
    if name(root) != "pnml" {
        findings.push(
            error(format!("this XML is a `{}` and no PNML", name(root)), root)
                .help("a PNML document is a `pnml` element with a `net` in it"),
        );
        return None;
    }
    let mut nets = elements(root).filter(|node| name(*node) == "net");
    let net = nets.next();
    let Some(net) = net else {
        findings.push(
            error("this document holds no net".to_owned(), root)
                .help("put a `net` element into it"),
        );
        return None;
    };
    if let Some(second) = nets.next() {
        findings.push(
            error(
                "a file holds one net, and this is a second one".to_owned(),
                second,
            )
            .help("move it into a file of its own"),
        );
    }
    check_type(source, net, findings);
    Some(net)
}

fn check_type(source: &Source, net: Node<'_, '_>, findings: &mut Findings) {
    const OTHER: [&str; 6] = [
        "symmetricnet",
        "highlevelnet",
        "hlcoremodel",
        "pt-hlpng",
        "stocnet",
        "tpn",
    ];
    let given = attribute(net, "type").unwrap_or_default();
    let last = given.rsplit(['/', '#']).next().unwrap_or_default();
    if last == "ptnet" {
        return;
    }
    let at = source.at(attribute_range(net, "type"));
    let shown = short(given);
    if OTHER.contains(&last) {
        findings.push(
            Finding::error(
                "pnt::pnml::type",
                format!("a net of type `{last}` is no place/transition net"),
            )
            .at(at)
            .help("have the tool that wrote the file unfold it into a place/transition net"),
        );
    } else if given.contains("PTNet")
        || given.contains("ptNet")
        || given.eq_ignore_ascii_case("P/T net")
        || last == "pnmlcoremodel"
        || given.is_empty()
    {
        findings.push(
            Finding::warning(
                "pnt::pnml::dialect",
                format!("the type `{shown}` is read as a place/transition net"),
            )
            .at(at)
            .help(format!("the standard's type is {}", TYPE)),
        );
    } else {
        findings.push(
            Finding::error(
                "pnt::pnml::type",
                format!("the net type `{shown}` is not known"),
            )
            .at(at)
            .help(format!("a place/transition net has the type {}", TYPE)),
        );
    }
}

/// What an arc does.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum ArcKind {
    Input,
    Output,
    Inhibitor,
    Read,
    Reset,
}

struct Reader<'s, 'a, 'i> {
    source: &'s Source,
    elements: Elements<'a, 'i>,
    findings: Findings,
    place_names: Vec<String>,
    transition_names: Vec<String>,
    positions: Positions,
    kept: Kept,
    /// The byte up to which lines were counted, with its line and column.
    counted: (usize, usize, usize),
}

/// Bytes of blanks at most that bring a text of our own to the line and column it has in the file.
const MOST_BLANKS: usize = 1 << 12;

impl<'a, 'i> Reader<'_, 'a, 'i> {
    fn read(mut self, net: Node<'a, 'i>) -> Result<NetFile, Findings> {
        let places = self.elements.places.clone();
        let transitions = self.elements.transitions.clone();
        self.place_names = self.names(&places);
        self.transition_names = self.names(&transitions);
        let mut draft = self.head(net);
        for (index, node) in places.into_iter().enumerate() {
            if enough(&self.findings) {
                return Err(self.findings);
            }
            let place = self.place(index, node);
            draft.places.push(place);
        }
        for (index, node) in transitions.into_iter().enumerate() {
            if enough(&self.findings) {
                return Err(self.findings);
            }
            let transition = self.transition(index, node);
            draft.transitions.push(transition);
        }
        let mut parallel = BTreeMap::new();
        for node in self.elements.arcs.clone() {
            if enough(&self.findings) {
                return Err(self.findings);
            }
            if let Err(finding) = self.arc(node, &mut draft, &mut parallel) {
                self.findings.push(finding);
            }
        }
        self.sections(&mut draft);
        if draft.transitions.is_empty() {
            self.findings.push(
                Finding::error("pnt::net::no_transitions", "this net has no transition")
                    .at(self.source.at(opening(net)))
                    .help("a net without transitions does nothing; was the file cut off?"),
            );
        }
        if self.findings.has_errors() {
            return Err(self.findings);
        }
        Ok(NetFile {
            format: Format::Pnml,
            draft,
            positions: self.positions,
            kept: self.kept,
            warnings: self.findings,
        })
    }

    /// An empty draft with the net's name, and what is kept of the net.
    fn head(&mut self, net: Node<'a, 'i>) -> Draft {
        let label = label(self.source, net, "name", &mut self.findings);
        let label = label.filter(|label| !label.text.is_empty());
        let id = attribute(net, "id").filter(|id| !id.trim().is_empty());
        let word = match (label, id) {
            (Some(label), _) => Word::new(label.text, self.source.at(label.range)),
            (None, Some(id)) => Word::new(id.trim(), self.source.at(attribute_range(net, "id"))),
            (None, None) => Word::new("net", self.source.at(opening(net))),
        };
        for namespace in net.namespaces() {
            if let Some(prefix) = namespace.name() {
                let uri = namespace.uri().to_owned();
                self.kept.namespaces.insert(prefix.to_owned(), uri);
            }
        }
        self.kept.net = KeptElement {
            id: id.map(str::to_owned),
            own: kept(self.source, net),
            name: kept_of_label(self.source, net, "name"),
            label: Vec::new(),
        };
        self.kept.page = std::mem::take(&mut self.elements.page);
        Draft::new(word)
    }

    /// Names of nodes of one kind: what a person calls them where that is unique, else their ids.
    fn names(&mut self, nodes: &[Node<'a, 'i>]) -> Vec<String> {
        let id = |node: &Node<'a, 'i>| attribute(*node, "id").unwrap_or_default().trim().to_owned();
        let mut called = Vec::with_capacity(nodes.len());
        for node in nodes {
            let label = label(self.source, *node, "name", &mut self.findings);
            let given = label.map(|label| label.text);
            let given = given.or_else(|| attribute(*node, "name").map(str::to_owned));
            called.push(given.filter(|text| !text.is_empty()));
        }
        let mut counts: BTreeMap<&str, usize> = BTreeMap::new();
        for text in called.iter().flatten() {
            *counts.entry(text).or_default() += 1;
        }
        let names: Vec<String> = nodes
            .iter()
            .zip(&called)
            .map(|(node, called)| match called {
                Some(text) if counts.get(text.as_str()) == Some(&1) => text.clone(),
                _ => id(node),
            })
            .collect();
        let distinct: BTreeSet<&String> = names.iter().collect();
        if distinct.len() == names.len() {
            names
        } else {
            nodes.iter().map(id).collect()
        }
    }

    fn at(&self, node: Node<'_, '_>) -> At {
        self.source.at(attribute_range(node, "id"))
    }

    fn keep(&self, node: Node<'_, '_>, label: &str) -> KeptElement {
        KeptElement {
            id: attribute(node, "id").map(|id| id.trim().to_owned()),
            own: kept(self.source, node),
            name: kept_of_label(self.source, node, "name"),
            label: kept_of_label(self.source, node, label),
        }
    }

    fn place(&mut self, index: usize, node: Node<'a, 'i>) -> DraftPlace {
        let name = self.place_names.get(index).cloned().unwrap_or_default();
        let mut place = DraftPlace::new(Word::new(name.clone(), self.at(node)));
        if let Some(tokens) = self.number(node, "initialMarking", "the initial marking", 0) {
            place.tokens = tokens;
        }
        // PIPE writes 0 for no capacity.
        place.capacity = self
            .number(node, "capacity", "the capacity", 0)
            .filter(|capacity| *capacity > 0);
        self.refuse_clock(node);
        if let Some(at) = positions(node).first() {
            self.positions.places.insert(name.clone(), *at);
        }
        for ours in elements(node).filter(|child| is_ours(*child)) {
            if let Some((source, text, start)) = self.section(ours) {
                net_text::place_rest(&source, &text, start, &mut place, &mut self.findings);
            }
        }
        let kept = self.keep(node, "initialMarking");
        self.kept.places.insert(name, kept);
        place
    }

    /// The number of a label, or of an attribute of that name.
    fn number(&mut self, node: Node<'a, 'i>, label: &str, what: &str, least: u32) -> Option<u32> {
        let found = label::label(self.source, node, label, &mut self.findings).or_else(|| {
            attribute(node, label).map(|value| Label {
                text: value.trim().to_owned(),
                range: attribute_range(node, label),
            })
        })?;
        let read = number(self.source, what, &found, least);
        self.findings.keep(read)
    }

    /// A clock invariant other than none.
    fn refuse_clock(&mut self, node: Node<'a, 'i>) {
        let given = attribute(node, "invariant").map(|text| text.replace(' ', ""));
        if given.is_some_and(|text| !["<inf", ""].contains(&text.as_str())) {
            self.findings.push(
                Finding::error(
                    "pnt::pnml::unsupported",
                    "a place with a time invariant has no counterpart here",
                )
                .at(self.source.at(attribute_range(node, "invariant")))
                .help("give times to transitions instead"),
            );
        }
    }

    fn transition(&mut self, index: usize, node: Node<'a, 'i>) -> DraftTransition {
        let name = self
            .transition_names
            .get(index)
            .cloned()
            .unwrap_or_default();
        let mut transition = DraftTransition::new(Word::new(name.clone(), self.at(node)));
        if let Some(at) = positions(node).first() {
            self.positions.transitions.insert(name.clone(), *at);
        }
        let kept = self.keep(node, "name");
        self.kept.transitions.insert(name, kept);
        self.pipe_times(node, &mut transition);
        for ours in elements(node).filter(|child| is_ours(*child)) {
            if let Some((source, text, start)) = self.section(ours) {
                net_text::clauses(&source, &text, start, &mut transition, &mut self.findings);
            }
        }
        transition
    }

    /// PIPE's elements for stochastic nets: rate and servers of timed transitions, weight and priority
    /// of immediate ones.
    fn pipe_times(&mut self, node: Node<'a, 'i>, transition: &mut DraftTransition) {
        let mut word = |name: &str| label(self.source, node, name, &mut self.findings);
        let (timed, servers) = (word("timed"), word("infiniteServer"));
        let (rate, priority) = (word("rate"), word("priority"));
        let Some(timed) = timed else { return };
        let is = |label: &Option<Label>, wanted: &str| {
            label.as_ref().is_some_and(|label| label.text == wanted)
        };
        if is(&servers, "true") {
            transition.servers = Some(Servers::Many);
        }
        let value = match &rate {
            None => 1.0,
            Some(label) => match label.text.parse::<f64>() {
                Ok(rate) if (1.0e-9..=1.0e6).contains(&rate) => rate,
                _ => {
                    self.findings.push(
                        Finding::error(
                            "pnt::pnml::number",
                            format!("the rate cannot be `{}`", short(&label.text)),
                        )
                        .at(self.source.at(label.range.clone()))
                        .help("write a number from 0.000000001 to 1000000, per second"),
                    );
                    return;
                }
            },
        };
        if timed.text == "true" {
            let mean = Duration::from_secs_f64(1.0 / value);
            // To whole microseconds, as times are kept.
            let micros = u64::try_from(mean.as_micros()).unwrap_or(u64::MAX).max(1);
            let mean = Duration::from_micros(micros);
            transition.timing = Timing::Exponential { mean };
        } else {
            transition.weight = value;
            let priority = priority.map(|label| number(self.source, "the priority", &label, 0));
            if let Some(priority) = priority.and_then(|read| self.findings.keep(read)) {
                transition.priority = priority;
            }
        }
    }

    /// The net text in a section of our own: a source, its text, and where in the source it starts.
    fn section(&mut self, ours: Node<'a, 'i>) -> Option<(Source, String, usize)> {
        let inner = only(self.source, ours, "text", &mut self.findings)?;
        let whole = text(inner);
        let mut parts = inner.children().filter(Node::is_text);
        let range = parts.next().map_or(0..0, |part| part.range());
        if self.source.text().get(range.clone()) == Some(whole.as_str()) {
            return Some((self.source.clone(), whole, range.start));
        }
        // Escapes and CDATA move the bytes: findings point to the right line of a text of its own.
        let (line, column) = self.line_column(range.start);
        if line + column > MOST_BLANKS {
            let name = format!("{}:{line}:{column}", self.source.name());
            return Some((Source::new(name, whole.as_str()), whole, 0));
        }
        let before = "\n".repeat(line - 1) + &" ".repeat(column - 1);
        let start = before.len();
        let source = Source::new(self.source.name(), before + &whole);
        Some((source, whole, start))
    }

    /// The line and column of a byte. Sections come one after the other, so only what lies between them is read.
    fn line_column(&mut self, to: usize) -> (usize, usize) {
        let (from, mut line, mut column) = match self.counted {
            counted if counted.0 <= to => counted,
            _ => (0, 1, 1),
        };
        for character in self.source.text().get(from..to).unwrap_or_default().chars() {
            column += 1;
            if character == '\n' {
                (line, column) = (line + 1, 1);
            }
        }
        self.counted = (to, line, column);
        (line, column)
    }

    fn arc_kind(&mut self, node: Node<'a, 'i>) -> Result<ArcKind, Finding> {
        let label = label(self.source, node, "arctype", &mut self.findings)
            .or_else(|| label(self.source, node, "type", &mut self.findings))
            .map(|label| label.text);
        let child = elements(node).find(|child| name(*child) == "type");
        let given = child
            .and_then(|child| attribute(child, "value"))
            .map(str::to_owned)
            .or(label)
            .or_else(|| attribute(node, "type").map(str::to_owned));
        match given.as_deref().map(str::trim) {
            None | Some("" | "normal") => Ok(ArcKind::Input),
            Some("timed") => match attribute(node, "inscription").map(|t| t.replace(' ', "")) {
                Some(interval) if interval != "[0,inf)" => Err(self.no_counterpart(node, "timed")),
                _ => Ok(ArcKind::Input),
            },
            Some("inhibitor" | "tapnInhibitor") => Ok(ArcKind::Inhibitor),
            Some("read" | "test") => Ok(ArcKind::Read),
            Some("reset") => Ok(ArcKind::Reset),
            Some(other) => Err(self.no_counterpart(node, other)),
        }
    }

    fn no_counterpart(&self, node: Node<'a, 'i>, kind: &str) -> Finding {
        Finding::error(
            "pnt::pnml::unsupported",
            format!("an arc of type `{}` has no counterpart here", short(kind)),
        )
        .at(self.at(node))
        .help("arcs are normal, inhibitor, read (test) or reset arcs, without times")
    }

    fn arc_weight(&mut self, node: Node<'a, 'i>) -> Option<u32> {
        let what = "the arc's weight";
        let label = label(self.source, node, "inscription", &mut self.findings);
        let attribute_label = |name: &str| {
            attribute(node, name).map(|value| Label {
                text: value.trim().to_owned(),
                range: attribute_range(node, name),
            })
        };
        let plain = |label: &Label| !label.text.starts_with('[');
        let label = label
            .or_else(|| attribute_label("weight"))
            .or_else(|| attribute_label("inscription").filter(plain));
        match label {
            None => Some(1),
            Some(label) => {
                let read = number(self.source, what, &label, 1);
                self.findings.keep(read)
            }
        }
    }

    fn arc(
        &mut self,
        node: Node<'a, 'i>,
        draft: &mut Draft,
        parallel: &mut BTreeMap<(usize, ArcKind, usize), usize>,
    ) -> Result<(), Finding> {
        let kind = self.arc_kind(node)?;
        let weight = self.arc_weight(node);
        let (source, findings) = (self.source, &mut self.findings);
        let from = self.elements.end(source, node, "source", findings);
        let to = self.elements.end(source, node, "target", findings);
        let (Some(from), Some(to), Some(weight)) = (from, to, weight) else {
            return Ok(());
        };
        let (place, transition, from_place) = match (from, to) {
            (End::Place(place), End::Transition(transition)) => (place, transition, true),
            (End::Transition(transition), End::Place(place)) => (place, transition, false),
            (End::Place(_), End::Place(_)) => return Err(self.same_kind(node, "places")),
            _ => return Err(self.same_kind(node, "transitions")),
        };
        let ours = elements(node).find(|child| is_ours(*child));
        let read = ours.is_some_and(|ours| {
            elements(ours).any(|child| name(child) == "text" && text(child).trim() == "read")
        });
        let kind = match (kind, from_place) {
            // The way back of a read arc that was written as a loop.
            (ArcKind::Input, false) if read => {
                self.keep_arc(node, place, transition, from_place);
                return Ok(());
            }
            (ArcKind::Input, true) if read => ArcKind::Read,
            (ArcKind::Input, false) => ArcKind::Output,
            (other, true) => other,
            (_, false) => {
                return Err(Finding::error(
                    "pnt::pnml::arc",
                    "an inhibitor, read or reset arc leads from a place to a transition",
                )
                .at(self.at(node))
                .help("swap its source and its target"));
            }
        };
        self.keep_arc(node, place, transition, from_place);
        let name = self.place_names.get(place).cloned().unwrap_or_default();
        let at = source.at(attribute_range(
            node,
            if from_place { "source" } else { "target" },
        ));
        let word = Word::new(name, at);
        let Some(target) = draft.transitions.get_mut(transition) else {
            return Ok(());
        };
        let arcs = match kind {
            ArcKind::Input => &mut target.inputs,
            ArcKind::Output => &mut target.outputs,
            ArcKind::Inhibitor => &mut target.inhibitors,
            ArcKind::Read => &mut target.reads,
            ArcKind::Reset => {
                if parallel.insert((transition, kind, place), 0).is_none() {
                    target.resets.push(word);
                }
                return Ok(());
            }
        };
        let index = *parallel
            .entry((transition, kind, place))
            .or_insert(arcs.len());
        match arcs.get_mut(index) {
            None => arcs.push(DraftArc {
                place: word,
                net: None,
                weight,
            }),
            Some(arc) => {
                arc.weight = match kind {
                    // Both conditions hold when the stricter one does.
                    ArcKind::Inhibitor => arc.weight.min(weight),
                    ArcKind::Read => arc.weight.max(weight),
                    _ => arc.weight.saturating_add(weight),
                };
                if arc.weight > MOST_TOKENS {
                    return Err(Finding::error(
                        "pnt::pnml::number",
                        "the weights of parallel arcs add up to more than can be counted here",
                    )
                    .at(self.at(node))
                    .help(format!("their sum is at most {MOST_TOKENS}")));
                }
            }
        }
        Ok(())
    }

    fn same_kind(&self, node: Node<'a, 'i>, kind: &str) -> Finding {
        Finding::error("pnt::pnml::arc", format!("this arc joins two {kind}"))
            .at(self.at(node))
            .help("an arc joins a place and a transition")
    }

    fn keep_arc(&mut self, node: Node<'a, 'i>, place: usize, transition: usize, from_place: bool) {
        let name = |names: &[String], index: usize| names.get(index).cloned().unwrap_or_default();
        let place = name(&self.place_names, place);
        let transition = name(&self.transition_names, transition);
        let key = if from_place {
            (true, place, transition)
        } else {
            (false, transition, place)
        };
        let kept = self.keep(node, "inscription");
        let points = positions(node);
        if !points.is_empty() {
            self.positions.arcs.entry(key.clone()).or_insert(points);
        }
        self.kept.arcs.entry(key).or_insert(kept);
    }

    /// Our own sections of the net: its title, and lines of net text.
    fn sections(&mut self, draft: &mut Draft) {
        for ours in self.elements.ours.clone() {
            if let Some(title) = only(self.source, ours, "title", &mut self.findings) {
                draft.title = Some(text(title));
            }
            if let Some((source, text, start)) = self.section(ours) {
                net_text::declarations(&source, &text, start, draft, &mut self.findings);
            }
        }
    }
}
