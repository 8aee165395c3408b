//! The right half: a net with its marking.

use std::{collections::BTreeMap, error::Error, path::Path, sync::Arc};

use ctos::diagnostic::Source;
use pnt::{
    compile,
    draft::{Draft, DraftArc, DraftTransition},
    exec::{Conflicts, Execution, FireError},
    text,
};
use serde::Deserialize;

use crate::svg::{AMBER, INK, QUIET, RED, Svg, note, towards};

const PLACE_RADIUS: f64 = 12.0;
const BAR: (f64, f64) = (7.0, 30.0);

/// A layout file.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Layout {
    node: BTreeMap<String, Node>,
    #[serde(default)]
    route: Vec<Route>,
}

#[derive(Debug, Clone, Copy, Deserialize)]
#[serde(deny_unknown_fields)]
struct Node {
    x: f64,
    y: f64,
    label: Side,
    #[serde(default)]
    lying: bool,
}

#[derive(Debug, Clone, Copy, Deserialize)]
#[serde(rename_all = "lowercase")]
enum Side {
    Above,
    Below,
    Left,
    Right,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Route {
    from: String,
    to: String,
    via: Vec<(f64, f64)>,
}

/// A net, where its nodes are, and its marking.
pub struct Drawing {
    draft: Draft,
    layout: Layout,
    tokens: BTreeMap<String, u32>,
    command: String,
}

impl Drawing {
    /// The net of a file at the moment when two requests are first served at the same time. Its first command
    /// is put on the tape, every action succeeds, and coordinators answer only when nothing else can happen.
    pub fn at_fork(net: &Path, layout: &Path) -> Result<Self, Box<dyn Error>> {
        let source = Source::read(net).map_err(|f| f.to_string())?;
        let draft = text::parse(&source)?;
        let layout: Layout = toml::from_str(&std::fs::read_to_string(layout)?)?;
        let command = draft.commands.first().ok_or("the net takes no command")?;
        let command = command.symbol.text.clone();
        let mut execution = Execution::new(Arc::new(compile::net(&source)?));
        execution.put_symbol(&command, Vec::new())?;
        let tokens = loop {
            while let Some(id) = execution.choose(&mut Conflicts::Declared, |_| true) {
                match execution.fire(id).map(|_| ()) {
                    Err(FireError::HasAction(_)) => {
                        let firing = execution.start(id)?;
                        execution.complete(firing)?;
                    }
                    other => other?,
                }
            }
            let tokens: BTreeMap<String, u32> = execution
                .net()
                .places()
                .iter()
                .zip(execution.marking())
                .map(|(place, tokens)| (place.name.clone(), *tokens))
                .collect();
            let active = |request: &str| tokens.get(&active(request)).is_some_and(|n| *n > 0);
            let served: Vec<String> = draft
                .coordinators
                .iter()
                .filter(|one| one.requests.iter().any(|request| active(&request.text)))
                .map(|one| one.net.text.clone())
                .collect();
            match served.as_slice() {
                [] => return Err("no two requests are ever served at the same time".into()),
                [one] => {
                    // What a coordinator does: says that it is done, and that it is free again.
                    execution.put_tokens(&format!("O_{one}"), 1)?;
                    execution.put_tokens(&format!("SI_{one}"), 1)?;
                }
                _ => break tokens,
            }
        };
        Ok(Self {
            draft,
            layout,
            tokens,
            command,
        })
    }

    /// Draws it with the layout's origin at `origin`, and a note at `bottom`.
    pub fn draw(
        &self,
        svg: &mut Svg,
        origin: (f64, f64),
        bottom: f64,
    ) -> Result<(), Box<dyn Error>> {
        let head = format!("net {}, executing {}", self.draft.name.text, self.command);
        svg.label(
            (origin.0 - 60.0, 28.0),
            &format!("font-size=\"19\" fill=\"{INK}\""),
            &head,
        );
        for transition in &self.draft.transitions {
            self.arcs(svg, origin, transition)?;
        }
        for place in &self.draft.places {
            let node = self.node(&place.name.text)?.moved(origin);
            svg.circle(
                (node.x, node.y),
                PLACE_RADIUS,
                &format!("fill=\"#ffffff\" stroke=\"{INK}\" stroke-width=\"1.5\""),
            );
            if self.tokens.get(&place.name.text).is_some_and(|n| *n > 0) {
                svg.circle((node.x, node.y), 5.0, &format!("fill=\"{INK}\""));
            }
            name(svg, &node, &place.name.text, PLACE_RADIUS, QUIET);
        }
        for transition in &self.draft.transitions {
            self.bar(svg, origin, &transition.name.text)?;
        }
        let text = "amber: under way, side by side · dashed: the way on after a failure";
        note(svg, (origin.0 - 60.0, bottom), text);
        Ok(())
    }

    fn node(&self, name: &str) -> Result<Node, String> {
        let node = self.layout.node.get(name).copied();
        node.ok_or_else(|| format!("the layout says nothing of `{name}`"))
    }

    fn bar(&self, svg: &mut Svg, origin: (f64, f64), text: &str) -> Result<(), String> {
        let node = self.node(text)?.moved(origin);
        let in_action = self.tokens.get(&active(text)).is_some_and(|n| *n > 0);
        let (width, height) = node.size();
        let (grow, fill, colour) = if in_action {
            (7.0, AMBER, INK)
        } else {
            (0.0, INK, INK)
        };
        let (width, height) = (width + grow, height + grow);
        svg.element(
            "rect",
            format_args!(
                "x=\"{:.1}\" y=\"{:.1}\" width=\"{width}\" height=\"{height}\" rx=\"2\" fill=\"{fill}\"",
                node.x - width / 2.0,
                node.y - height / 2.0
            ),
        );
        if in_action {
            svg.circle((node.x, node.y), 5.0, &format!("fill=\"{INK}\""));
        }
        name(svg, &node, text, height.max(width) / 2.0 - 1.0, colour);
        Ok(())
    }

    fn arcs(
        &self,
        svg: &mut Svg,
        origin: (f64, f64),
        transition: &DraftTransition,
    ) -> Result<(), String> {
        let this = &transition.name.text;
        let usual = format!("stroke=\"{INK}\" stroke-width=\"1.2\" marker-end=\"url(#ink)\"");
        let failed = format!(
            "stroke=\"{RED}\" stroke-width=\"1.2\" stroke-dasharray=\"4 3\" marker-end=\"url(#red)\""
        );
        let local = |arc: &&DraftArc| arc.net.is_none();
        for arc in transition.inputs.iter().filter(local) {
            svg.path(&self.way(origin, &arc.place.text, this)?, &usual);
        }
        for arc in transition.outputs.iter().filter(local) {
            svg.path(&self.way(origin, this, &arc.place.text)?, &usual);
        }
        // A failure branch to the same places as the success needs no arc of its own.
        let also = |arc: &&DraftArc| !transition.outputs.contains(arc);
        let fail: Vec<_> = transition.fail.iter().filter(local).filter(also).collect();
        let (near, far): (Vec<_>, Vec<_>) = fail
            .into_iter()
            .partition(|arc| self.routed(this, &arc.place.text));
        for arc in near {
            svg.path(&self.way(origin, this, &arc.place.text)?, &failed);
        }
        if !far.is_empty() {
            let stub = self.node(this)?.moved(origin).stub();
            svg.path(&stub, &failed);
        }
        Ok(())
    }

    fn routed(&self, from: &str, to: &str) -> bool {
        let mut routes = self.layout.route.iter();
        routes.any(|route| route.from == from && route.to == to)
    }

    /// The line from one node's edge to another's.
    fn way(&self, origin: (f64, f64), from: &str, to: &str) -> Result<Vec<(f64, f64)>, String> {
        let (start, end) = (self.node(from)?.moved(origin), self.node(to)?.moved(origin));
        let route = self
            .layout
            .route
            .iter()
            .find(|route| route.from == from && route.to == to);
        let via = route.map_or(&[][..], |route| &route.via);
        let via: Vec<_> = via
            .iter()
            .map(|(x, y)| (x + origin.0, y + origin.1))
            .collect();
        let first = via.first().copied().unwrap_or((end.x, end.y));
        let last = via.last().copied().unwrap_or((start.x, start.y));
        let is_place = |name: &str| self.draft.places.iter().any(|one| one.name.text == name);
        let mut way = vec![start.edge(first, is_place(from))];
        way.extend(&via);
        way.push(end.edge(last, is_place(to)));
        Ok(way)
    }
}

impl Node {
    fn moved(self, origin: (f64, f64)) -> Self {
        Self {
            x: self.x + origin.0,
            y: self.y + origin.1,
            ..self
        }
    }

    /// Width and height of a transition's bar.
    fn size(&self) -> (f64, f64) {
        if self.lying { (BAR.1, BAR.0) } else { BAR }
    }

    /// The beginning of an arc to a place too far away to be drawn.
    fn stub(&self) -> [(f64, f64); 2] {
        if self.lying {
            [
                (self.x - 18.0, self.y + 3.0),
                (self.x - 33.0, self.y + 18.0),
            ]
        } else {
            [
                (self.x + 5.0, self.y - 13.0),
                (self.x + 20.0, self.y - 28.0),
            ]
        }
    }

    /// Where a line to `other` leaves this node.
    fn edge(&self, other: (f64, f64), place: bool) -> (f64, f64) {
        let here = (self.x, self.y);
        if place {
            return towards(here, other, PLACE_RADIUS + 1.0);
        }
        let (width, height) = self.size();
        let (dx, dy) = (other.0 - self.x, other.1 - self.y);
        let gap = 2.0;
        let (half_width, half_height) = (width / 2.0 + gap, height / 2.0 + gap);
        let part = (half_width / dx.abs().max(1e-9)).min(half_height / dy.abs().max(1e-9));
        (self.x + dx * part, self.y + dy * part)
    }
}

/// The place that is marked while a request is served.
fn active(request: &str) -> String {
    format!("{request}_active")
}

fn name(svg: &mut Svg, node: &Node, text: &str, half: f64, colour: &str) {
    let (x, y, anchor) = match node.label {
        Side::Above => (node.x, node.y - half - 8.0, "middle"),
        Side::Below => (node.x, node.y + half + 17.0, "middle"),
        Side::Left => (node.x - half - 7.0, node.y + 5.0, "end"),
        Side::Right => (node.x + half + 7.0, node.y + 5.0, "start"),
    };
    svg.label(
        (x, y),
        &format!(
            "font-size=\"15\" fill=\"{colour}\" text-anchor=\"{anchor}\" paint-order=\"stroke\" \
             stroke=\"#ffffff\" stroke-width=\"4\""
        ),
        text,
    );
}
