//! Layout files: `NAME.layout.toml` beside a net's text says where its nodes are drawn.

use std::{
    collections::BTreeMap,
    fmt::Write as _,
    path::{Path, PathBuf},
};

use ctos::{
    config::Node,
    diagnostic::{Finding, Findings, Source},
};
use serde::Deserialize;

use crate::stream::{NetView, PinView, RouteView, Side};

/// Coordinates that are drawn, px.
const MOST: f64 = 1e6;

/// What a layout file says, names not yet held against a net.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct LayoutFile {
    /// Where nodes are.
    pub nodes: BTreeMap<String, PinView>,
    /// Arcs that are not straight.
    pub routes: Vec<RouteView>,
}

/// A node as the file says it.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct NodeAt {
    /// To the right, px.
    pub x: f64,
    /// Down, px.
    pub y: f64,
    /// On which side its name stands.
    #[serde(default)]
    pub label: Side,
    /// Whether a transition's bar lies.
    #[serde(default)]
    pub lying: bool,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Route {
    from: String,
    to: String,
    via: Vec<(f64, f64)>,
}

/// The layout file of a net's file: `motion.net` has `motion.layout.toml` beside it.
#[must_use]
pub fn beside(net: &Path) -> PathBuf {
    net.with_extension("layout.toml")
}

impl LayoutFile {
    /// Reads a layout file; what is wrong in it is left out.
    pub fn read(source: &Source, findings: &mut Findings) -> Self {
        let mut file = Self::default();
        let root = Node::from_toml(source, findings);
        for entry in root.entries() {
            match entry.key.as_str() {
                "node" => {
                    for node in entry.value.entries() {
                        if let Some(at) = findings.keep(node.value.parse::<NodeAt>()) {
                            let pin = PinView {
                                x: pixel(at.x),
                                y: pixel(at.y),
                                label: at.label,
                                lying: at.lying,
                            };
                            file.nodes.insert(node.key.clone(), pin);
                        }
                    }
                }
                "route" => {
                    for route in entry.value.elements() {
                        if let Some(route) = findings.keep(route.parse::<Route>()) {
                            let via = route.via.iter();
                            let via = via.map(|(x, y)| (pixel(*x), pixel(*y))).collect();
                            file.routes.push(RouteView {
                                from: route.from,
                                to: route.to,
                                via,
                            });
                        }
                    }
                }
                other => {
                    let message = format!("a layout file has no part `{other}`");
                    let finding = Finding::error("pnt::layout::unknown_part", message);
                    let known = ["node", "route"];
                    let finding = finding.suggest(other, known);
                    let place = entry.key_place.clone();
                    findings.push(finding.at(place.unwrap_or_else(|| source.at(0..0))));
                }
            }
        }
        file
    }

    /// Reads the layout file beside the file of a net, if there is one.
    pub fn of_net(net: &Path, findings: &mut Findings) -> Self {
        let path = beside(net);
        if !path.is_file() {
            return Self::default();
        }
        match findings.keep(Source::read(&path)) {
            Some(source) => Self::read(&source, findings),
            None => Self::default(),
        }
    }

    /// Puts what the file says of nodes that the net has into its view. Returns the names of the others,
    /// which are another net's or no longer exist.
    pub fn pin(self, view: &mut NetView) -> Vec<String> {
        let shown = |name: &str| {
            view.place(name).is_some()
                || view.transition(name).is_some()
                || view.transitions.iter().any(|one| one.shown == name)
                || view.sends_to(name)
        };
        let (known, unknown): (BTreeMap<_, _>, BTreeMap<_, _>) =
            self.nodes.into_iter().partition(|(name, _)| shown(name));
        let routes = self.routes.into_iter();
        view.routes = routes
            .filter(|route| shown(&route.from) && shown(&route.to))
            .collect();
        view.pins = known;
        unknown.into_keys().collect()
    }

    /// The file as text. Comments of a file that it replaces are not kept.
    #[must_use]
    pub fn write(&self) -> String {
        let mut text = "[node]\n".to_owned();
        let quoted = |name: &str| toml_key(name);
        for (name, pin) in &self.nodes {
            let label = match pin.label {
                Side::Above => "above",
                Side::Below => "below",
                Side::Left => "left",
                Side::Right => "right",
            };
            let lying = if pin.lying { ", lying = true" } else { "" };
            // Writing to a string never fails.
            let _ = writeln!(
                text,
                "{} = {{ x = {}, y = {}, label = \"{label}\"{lying} }}",
                quoted(name),
                pin.x,
                pin.y
            );
        }
        for RouteView { from, to, via } in &self.routes {
            let via: Vec<String> = via.iter().map(|(x, y)| format!("[{x}, {y}]")).collect();
            let _ = writeln!(
                text,
                "\n[[route]]\nfrom = {}\nto = {}\nvia = [{}]",
                basic_string(from),
                basic_string(to),
                via.join(", ")
            );
        }
        text
    }
}

/// A whole pixel within what is drawn.
fn pixel(at: f64) -> i32 {
    // It is not a number, or within the range of `i32`.
    #[allow(clippy::cast_possible_truncation, reason = "it is clamped")]
    if at.is_nan() {
        0
    } else {
        at.clamp(-MOST, MOST).round() as i32
    }
}

fn toml_key(name: &str) -> String {
    let plain = |letter: char| letter.is_ascii_alphanumeric() || letter == '_' || letter == '-';
    if !name.is_empty() && name.chars().all(plain) {
        name.to_owned()
    } else {
        basic_string(name)
    }
}

fn basic_string(text: &str) -> String {
    let mut quoted = "\"".to_owned();
    for letter in text.chars() {
        match letter {
            '"' | '\\' => quoted.extend(['\\', letter]),
            letter if letter.is_control() => {
                let _ = write!(quoted, "\\u{:04X}", u32::from(letter));
            }
            letter => quoted.push(letter),
        }
    }
    quoted.push('"');
    quoted
}
