//! A net as a drawing for papers and for other programs: SVG, Graphviz's DOT and Mermaid, with the marking
//! of a moment.

use std::fmt::Write as _;

use pnt::{
    layout::{Drawing, DrawnArc, DrawnNode, Kind, Point, Way},
    stream::{NetView, Side, Standing, State},
};

const RADIUS: f64 = 13.0;
const BAR: (f64, f64) = (8.0, 32.0);
const INK: &str = "#1d2430";
const SOFT: &str = "#5d6778";
const ARC: &str = "#8b94a3";
const RED: &str = "#c2352b";
const AMBER: &str = "#d97706";
const GREEN: &str = "#0f7b6c";

/// A net at a moment.
pub(crate) struct Figure<'f> {
    pub(crate) view: &'f NetView,
    pub(crate) drawing: &'f Drawing,
    pub(crate) state: &'f State,
}

impl Figure<'_> {
    fn tokens(&self, node: &DrawnNode) -> u32 {
        match node.kind {
            Kind::Place(place) => self.state.places.get(place as usize).copied().unwrap_or(0),
            _ => 0,
        }
    }

    fn standing(&self, node: &DrawnNode) -> Option<Standing> {
        let Kind::Transition(parts, active) = &node.kind else {
            return None;
        };
        let place = active.and_then(|place| self.state.places.get(place as usize));
        if place.is_some_and(|tokens| *tokens > 0) {
            return Some(Standing::Running);
        }
        let parts = parts
            .iter()
            .filter_map(|part| self.view.transitions.get(*part as usize));
        parts
            .map(|one| Standing::of(self.view, self.state, one).0)
            .min()
    }

    /// As SVG 1.1 on white.
    pub(crate) fn svg(&self) -> String {
        let (left, top, right, bottom) = self.drawing.bounds();
        let (width, height) = (right - left + 24.0, bottom - top + 24.0);
        let mut out = format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{width:.0}\" height=\"{height:.0}\" viewBox=\"{:.0} {:.0} {width:.0} {height:.0}\" \
             font-family=\"'Helvetica Neue', Helvetica, Arial, 'DejaVu Sans', sans-serif\" font-size=\"12\">\n\
             <title>{}</title>\n<rect x=\"{:.0}\" y=\"{:.0}\" width=\"{width:.0}\" height=\"{height:.0}\" fill=\"#ffffff\"/>\n<defs>\n",
            left - 12.0,
            top - 12.0,
            escaped(&self.view.name),
            left - 12.0,
            top - 12.0,
        );
        for (name, colour) in [("arrow", ARC), ("fail", RED)] {
            put(
                &mut out,
                format_args!(
                    "<marker id=\"{name}\" viewBox=\"0 0 10 10\" refX=\"8.5\" refY=\"5\" markerWidth=\"8\" markerHeight=\"8\" markerUnits=\"userSpaceOnUse\" orient=\"auto\"><path d=\"M0 1.2 9 5 0 8.8z\" fill=\"{colour}\"/></marker>"
                ),
            );
        }
        put(
            &mut out,
            format_args!(
                "<marker id=\"inhibit\" viewBox=\"0 0 10 10\" refX=\"9\" refY=\"5\" markerWidth=\"9\" markerHeight=\"9\" markerUnits=\"userSpaceOnUse\" orient=\"auto\"><circle cx=\"5\" cy=\"5\" r=\"3.6\" fill=\"#ffffff\" stroke=\"{ARC}\"/></marker>\n</defs>"
            ),
        );
        for arc in &self.drawing.arcs {
            self.arc(&mut out, arc);
        }
        for node in &self.drawing.nodes {
            self.node(&mut out, node);
        }
        out.push_str("</svg>\n");
        out
    }

    fn ends(&self, arc: &DrawnArc) -> Option<(&DrawnNode, &DrawnNode)> {
        let nodes = &self.drawing.nodes;
        Some((nodes.get(arc.from)?, nodes.get(arc.to)?))
    }

    fn arc(&self, out: &mut String, arc: &DrawnArc) {
        let Some((from, to)) = self.ends(arc) else {
            return;
        };
        let first = arc.via.first().copied().unwrap_or((to.x, to.y));
        let last = arc.via.last().copied().unwrap_or((from.x, from.y));
        let mut points = vec![edge(from, first)];
        points.extend(&arc.via);
        points.push(edge(to, last));
        let look = match arc.way {
            Way::Fail => {
                format!("stroke=\"{RED}\" stroke-dasharray=\"4 3\" marker-end=\"url(#fail)\"")
            }
            Way::Inhibit => format!("stroke=\"{ARC}\" marker-end=\"url(#inhibit)\""),
            Way::Read => {
                format!("stroke=\"{ARC}\" stroke-dasharray=\"1 3\" marker-end=\"url(#arrow)\"")
            }
            Way::Reset => {
                format!("stroke=\"{ARC}\" stroke-dasharray=\"6 3\" marker-end=\"url(#arrow)\"")
            }
            Way::Input | Way::Output => format!("stroke=\"{ARC}\" marker-end=\"url(#arrow)\""),
        };
        put(
            out,
            format_args!(
                "<path d=\"{}\" fill=\"none\" stroke-width=\"1.25\" {look}/>",
                path(&points)
            ),
        );
        if arc.weight > 1
            && let [a, b, ..] = points.as_slice()
        {
            put(
                out,
                format_args!(
                    "<text x=\"{:.1}\" y=\"{:.1}\" fill=\"{SOFT}\" text-anchor=\"middle\">{}</text>",
                    f64::midpoint(a.0, b.0),
                    f64::midpoint(a.1, b.1) - 4.0,
                    arc.weight
                ),
            );
        }
    }

    fn node(&self, out: &mut String, node: &DrawnNode) {
        let (x, y) = (node.x, node.y);
        let (half_width, half_height) = half(node);
        match (&node.kind, self.standing(node)) {
            (Kind::Transition(..), standing) => {
                let (fill, stroke) = match standing {
                    Some(Standing::Running) => (AMBER, AMBER),
                    Some(Standing::Enabled) => (GREEN, GREEN),
                    _ => (INK, INK),
                };
                put(
                    out,
                    format_args!(
                        "<rect x=\"{:.1}\" y=\"{:.1}\" width=\"{:.1}\" height=\"{:.1}\" rx=\"2\" fill=\"{fill}\" stroke=\"{stroke}\"/>",
                        x - half_width,
                        y - half_height,
                        2.0 * half_width,
                        2.0 * half_height
                    ),
                );
            }
            (kind, _) => {
                let dash = if matches!(kind, Kind::Remote(..)) {
                    " stroke-dasharray=\"3 3\""
                } else {
                    ""
                };
                put(
                    out,
                    format_args!(
                        "<circle cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"{RADIUS}\" fill=\"#ffffff\" stroke=\"{INK}\" stroke-width=\"1.5\"{dash}/>"
                    ),
                );
                self.dots(out, node);
            }
        }
        let (dx, dy, anchor) = match node.label {
            Side::Above => (0.0, -half_height - 8.0, "middle"),
            Side::Below => (0.0, half_height + 15.0, "middle"),
            Side::Left => (-half_width - 8.0, 4.0, "end"),
            Side::Right => (half_width + 8.0, 4.0, "start"),
        };
        put(
            out,
            format_args!(
                "<text x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"{anchor}\" fill=\"{INK}\" paint-order=\"stroke\" stroke=\"#ffffff\" stroke-width=\"3.5\">{}</text>",
                x + dx,
                y + dy,
                escaped(&node.name)
            ),
        );
    }

    fn dots(&self, out: &mut String, node: &DrawnNode) {
        let (r, at): (f64, &[Point]) = match self.tokens(node) {
            0 => return,
            1 => (5.0, &[(0.0, 0.0)]),
            2 => (3.6, &[(-4.2, 0.0), (4.2, 0.0)]),
            3 => (3.2, &[(0.0, -4.4), (-4.4, 3.4), (4.4, 3.4)]),
            4 => (3.0, &[(-4.2, -4.2), (4.2, -4.2), (-4.2, 4.2), (4.2, 4.2)]),
            many => {
                put(
                    out,
                    format_args!(
                        "<text x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"middle\" font-weight=\"bold\" fill=\"{INK}\">{many}</text>",
                        node.x,
                        node.y + 4.0
                    ),
                );
                return;
            }
        };
        for (dx, dy) in at {
            put(
                out,
                format_args!(
                    "<circle cx=\"{:.1}\" cy=\"{:.1}\" r=\"{r}\" fill=\"{INK}\"/>",
                    node.x + dx,
                    node.y + dy
                ),
            );
        }
    }

    /// As Graphviz reads it.
    pub(crate) fn dot(&self) -> String {
        let mut out = format!(
            "digraph {} {{\n  rankdir=LR\n  node [fontname=Helvetica, fontsize=11]\n",
            quoted(&self.view.name)
        );
        for (index, node) in self.drawing.nodes.iter().enumerate() {
            let look = match (&node.kind, self.standing(node)) {
                (Kind::Transition(..), Some(Standing::Running)) => {
                    "shape=box, style=filled, fillcolor=orange".to_owned()
                }
                (Kind::Transition(..), Some(Standing::Enabled)) => {
                    "shape=box, style=filled, fillcolor=palegreen".to_owned()
                }
                (Kind::Transition(..), _) => "shape=box".to_owned(),
                (Kind::Remote(..), _) => "shape=ellipse, style=dashed".to_owned(),
                (Kind::Place(_), _) => match self.tokens(node) {
                    0 => "shape=ellipse".to_owned(),
                    tokens => format!("shape=ellipse, penwidth=2, xlabel=\"{tokens}\""),
                },
            };
            put(
                &mut out,
                format_args!("  n{index} [label={}, {look}]", quoted(&node.name)),
            );
        }
        for arc in &self.drawing.arcs {
            let look = match arc.way {
                Way::Input | Way::Output => "",
                Way::Fail => ", color=red, style=dashed",
                Way::Read => ", style=dotted",
                Way::Inhibit => ", arrowhead=odot",
                Way::Reset => ", arrowhead=normalnormal",
            };
            let weight = if arc.weight > 1 {
                arc.weight.to_string()
            } else {
                String::new()
            };
            put(
                &mut out,
                format_args!("  n{} -> n{} [label=\"{weight}\"{look}]", arc.from, arc.to),
            );
        }
        out.push_str("}\n");
        out
    }

    /// As Mermaid reads it.
    pub(crate) fn mermaid(&self) -> String {
        let mut out = "flowchart LR\n".to_owned();
        for (index, node) in self.drawing.nodes.iter().enumerate() {
            let name = node.name.replace('"', "#quot;");
            match (&node.kind, self.tokens(node)) {
                (Kind::Transition(..), _) => put(&mut out, format_args!("  n{index}[\"{name}\"]")),
                (_, 0) => put(&mut out, format_args!("  n{index}((\"{name}\"))")),
                (_, tokens) => put(&mut out, format_args!("  n{index}((\"{name}: {tokens}\"))")),
            }
            match self.standing(node) {
                Some(Standing::Running) => put(
                    &mut out,
                    format_args!("  style n{index} fill:#fdebc8,stroke:{AMBER}"),
                ),
                Some(Standing::Enabled) => put(
                    &mut out,
                    format_args!("  style n{index} fill:#d3ece6,stroke:{GREEN}"),
                ),
                _ => {}
            }
        }
        for arc in &self.drawing.arcs {
            let line = match arc.way {
                Way::Input | Way::Output => "-->",
                Way::Inhibit => "--o",
                Way::Fail | Way::Read | Way::Reset => "-.->",
            };
            let weight = if arc.weight > 1 {
                format!("|{}|", arc.weight)
            } else {
                String::new()
            };
            put(
                &mut out,
                format_args!("  n{} {line}{weight} n{}", arc.from, arc.to),
            );
        }
        out
    }
}

fn put(out: &mut String, line: std::fmt::Arguments) {
    // Writing to a string never fails.
    let _ = writeln!(out, "{line}");
}

fn half(node: &DrawnNode) -> (f64, f64) {
    match (&node.kind, node.lying) {
        (Kind::Transition(..), false) => (BAR.0 / 2.0, BAR.1 / 2.0),
        (Kind::Transition(..), true) => (BAR.1 / 2.0, BAR.0 / 2.0),
        _ => (RADIUS, RADIUS),
    }
}

fn towards(from: Point, to: Point, distance: f64) -> Point {
    let (dx, dy) = (to.0 - from.0, to.1 - from.1);
    let length = dx.hypot(dy).max(1e-9);
    (
        from.0 + dx / length * distance,
        from.1 + dy / length * distance,
    )
}

/// Where a line to `point` leaves a node.
fn edge(node: &DrawnNode, point: Point) -> Point {
    let at = (node.x, node.y);
    let (half_width, half_height) = half(node);
    if !matches!(node.kind, Kind::Transition(..)) {
        return towards(at, point, RADIUS + 1.5);
    }
    let (dx, dy) = (point.0 - at.0, point.1 - at.1);
    let part =
        ((half_width + 2.0) / dx.abs().max(1e-9)).min((half_height + 2.0) / dy.abs().max(1e-9));
    (at.0 + dx * part, at.1 + dy * part)
}

/// A line through points, with round corners.
fn path(points: &[Point]) -> String {
    let mut d = String::new();
    for (index, &(x, y)) in points.iter().enumerate() {
        let around = index
            .checked_sub(1)
            .and_then(|before| points.get(before))
            .zip(points.get(index + 1));
        let _ = match around {
            _ if index == 0 => write!(d, "M{x:.1} {y:.1}"),
            Some((&before, &after)) => {
                let reach = |other: Point| (14.0_f64).min((other.0 - x).hypot(other.1 - y) / 2.0);
                let (bx, by) = towards((x, y), before, reach(before));
                let (ax, ay) = towards((x, y), after, reach(after));
                write!(d, "L{bx:.1} {by:.1}Q{x:.1} {y:.1} {ax:.1} {ay:.1}")
            }
            None => write!(d, "L{x:.1} {y:.1}"),
        };
    }
    d
}

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;")
        .replace('<', "&lt;")
        .replace('>', "&gt;")
}

fn quoted(text: &str) -> String {
    format!("\"{}\"", text.replace('\\', "\\\\").replace('"', "\\\""))
}
