//! Overview displays: a file says which places and transitions, of which nets, stand together on one display
//! (architecture report, section 6, figure 9).
//!
//! ```toml
//! [display.arm]
//! title = "What the arm does, and who asked"
//! show = ["dispatcher/move_robot", "dispatcher/find_pos", "motion/*"]
//! ```
//!
//! The same file holds [layouts](super::panes), [handles](super::handles) and [plans](super::plans).

use std::{
    collections::BTreeMap,
    path::{Path, PathBuf},
};

use ctos::{
    config::Node,
    diagnostic::{Finding, Findings, Severity, Source},
};
use pnt::layout::Drawing;
use serde::Deserialize;

use super::{
    handles::{self, Handle},
    panes::{Layout, Named},
    plans::{self, Plan},
    wire::{Overview, OverviewPart},
};

/// Where the file of displays of app `name` is unless the configuration says otherwise, relative to its folder.
pub(crate) fn usual_file(name: &str) -> String {
    format!("displays/{name}.toml")
}

/// The file beside a file of displays that says where people have put nodes.
pub(crate) fn layout_beside(displays: &Path) -> PathBuf {
    displays.with_extension("layout.toml")
}

/// Px between the parts of two nets.
const BETWEEN: f64 = 40.0;

/// All overview displays of a file.
#[derive(Debug, Clone, Default, PartialEq)]
pub(crate) struct Overviews {
    displays: BTreeMap<String, Described>,
    layouts: BTreeMap<String, Layout>,
    handles: BTreeMap<String, Handle>,
    plans: BTreeMap<String, Plan>,
}

#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
struct Described {
    #[serde(default)]
    title: String,
    /// `NET/NODE`, in which `*` stands for any letters.
    show: Vec<String>,
    /// Where nodes stand on this display, px, when not where their net's drawing has them.
    #[serde(default)]
    node: BTreeMap<String, Spot>,
}

#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
struct Spot {
    x: f64,
    y: f64,
}

/// The file; its displays are read one by one, so that one mistake does not hide the next.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct File {
    #[serde(default, rename = "display")]
    _display: BTreeMap<String, serde::de::IgnoredAny>,
    #[serde(default, rename = "layout")]
    _layout: BTreeMap<String, serde::de::IgnoredAny>,
    #[serde(default, rename = "handle")]
    _handle: BTreeMap<String, serde::de::IgnoredAny>,
    #[serde(default, rename = "plan")]
    _plan: BTreeMap<String, serde::de::IgnoredAny>,
}

impl Overviews {
    /// Reads a file of displays; what is wrong in it is left out.
    pub(crate) fn read(source: &Source, findings: &mut Findings) -> Self {
        let root = Node::from_toml(source, findings);
        let mut all = Self::default();
        if findings.keep(root.parse::<File>()).is_none() {
            return all;
        }
        let tables = |name| root.get(name).map(Node::entries).unwrap_or_default();
        for entry in tables("display") {
            if let Some(one) = findings.keep(entry.value.parse::<Described>()) {
                all.displays.insert(entry.key.clone(), one);
            }
        }
        for entry in tables("layout") {
            if let Some(one) = findings.keep(entry.value.parse::<Layout>()) {
                all.layouts.insert(entry.key.clone(), one);
            }
        }
        for entry in tables("handle") {
            if let Some(one) = findings.keep(entry.value.parse::<Handle>()) {
                all.handles.insert(entry.key.clone(), one);
            }
        }
        for entry in tables("plan") {
            if let Some(one) = findings.keep(entry.value.parse::<Plan>()) {
                all.plans.insert(entry.key.clone(), one);
            }
        }
        all
    }

    /// The layouts.
    pub(crate) fn layouts(&self) -> Vec<Named<'_>> {
        let all = self.layouts.iter();
        all.map(|(name, layout)| Named { name, layout }).collect()
    }

    /// The handles.
    pub(crate) fn handles(&self) -> Vec<handles::Named<'_>> {
        let all = self.handles.iter();
        all.map(|(name, handle)| handles::Named { name, handle })
            .collect()
    }

    /// The plans.
    pub(crate) fn plans(&self) -> Vec<plans::Named<'_>> {
        let all = self.plans.iter();
        all.map(|(name, plan)| plans::Named { name, plan })
            .collect()
    }

    /// The tasks of plans that `known` does not know, as `PLAN: TASK`.
    pub(crate) fn unknown_tasks(&self, known: impl Fn(&str) -> bool) -> Vec<String> {
        let all = self.plans.iter();
        all.flat_map(|(name, plan)| {
            let lost = plan.tasks().filter(|task| !known(task));
            lost.map(move |task| format!("{name}: {task}"))
        })
        .collect()
    }

    /// The commands of handles that `takes` does not know, as `HANDLE: NET/COMMAND`.
    pub(crate) fn unknown_commands(&self, takes: impl Fn(&str, &str) -> bool) -> Vec<String> {
        let all = self.handles.iter();
        let lost = all.filter(|(_, handle)| !takes(&handle.net, &handle.command));
        lost.map(|(name, handle)| format!("{name}: {}/{}", handle.net, handle.command))
            .collect()
    }

    /// What layouts name and `known` does not know as a net or a display, as `LAYOUT: NET`.
    pub(crate) fn unknown_nets(&self, known: impl Fn(&str) -> bool) -> Vec<String> {
        let all = self.layouts.iter();
        all.flat_map(|(name, layout)| {
            let nets = layout.nets().into_iter();
            let lost = nets.filter(|net| !known(net) && !self.displays.contains_key(*net));
            lost.map(move |net| format!("{name}: {net}"))
        })
        .collect()
    }

    /// Takes in a layout that a person has saved.
    pub(crate) fn lay(&mut self, name: &str, layout: Layout) {
        self.layouts.insert(name.to_owned(), layout);
    }

    /// Takes in the layout file beside the file of displays, if there is one. What is wrong in it stops nothing.
    pub(crate) fn arrange_from(&mut self, displays: &Path, findings: &mut Findings) {
        let path = layout_beside(displays);
        if !path.is_file() {
            return;
        }
        let mut found = Findings::new();
        if let Some(source) = found.keep(Source::read(&path)) {
            self.arrange(&source, &mut found);
        }
        for mut finding in found.into_sorted() {
            finding.severity = Severity::Warning;
            findings.push(finding);
        }
    }

    /// Puts nodes where a layout file says: `[display.NAME.node]`, `"NET/NODE" = { x = 0, y = 0 }`.
    pub(crate) fn arrange(&mut self, source: &Source, findings: &mut Findings) {
        let root = Node::from_toml(source, findings);
        let Some(all) = root.get("display") else {
            return;
        };
        for entry in all.entries() {
            let Some(display) = self.displays.get_mut(&entry.key) else {
                let text = format!("there is no display `{}` to arrange", entry.key);
                let place = entry.key_place.clone();
                let finding = Finding::error("pnt::display::unknown_display", text)
                    .suggest(&entry.key, self.displays.keys().map(String::as_str));
                findings.push(finding.at(place.unwrap_or_else(|| source.at(0..0))));
                continue;
            };
            let nodes = entry.value.get("node").map(Node::entries);
            for node in nodes.unwrap_or_default() {
                if let Some(spot) = findings.keep(node.value.parse::<Spot>()) {
                    display.node.insert(node.key.clone(), spot);
                }
            }
        }
    }

    /// The displays as they are drawn, where `drawing` says how a net is. Names that lead nowhere show
    /// nothing; [`Self::unknown`] tells them.
    pub(crate) fn drawn<'d>(&self, drawing: impl Fn(&str) -> Option<&'d Drawing>) -> Vec<Overview> {
        let draw = |(name, one): (&String, &Described)| Overview {
            name: name.clone(),
            title: one.title.clone(),
            parts: one.parts(&drawing),
        };
        self.displays.iter().map(draw).collect()
    }

    /// What displays name and no net has, as `DISPLAY: NET/NODE`.
    pub(crate) fn unknown<'d>(&self, drawing: impl Fn(&str) -> Option<&'d Drawing>) -> Vec<String> {
        let leads_nowhere = |wanted: &String| {
            let (net, node) = wanted.split_once('/').unwrap_or((wanted, ""));
            let nodes = drawing(net).map(|drawing| drawing.nodes.as_slice());
            let mut nodes = nodes.unwrap_or_default().iter();
            !nodes.any(|one| matches(node, &one.name))
        };
        let all = self.displays.iter();
        all.flat_map(|(name, one)| {
            let lost = one.show.iter().filter(|wanted| leads_nowhere(wanted));
            lost.map(move |wanted| format!("{name}: {wanted}"))
        })
        .collect()
    }
}

impl Described {
    fn parts<'d>(&self, drawing: &impl Fn(&str) -> Option<&'d Drawing>) -> Vec<OverviewPart> {
        let mut wanted: BTreeMap<&str, Vec<&str>> = BTreeMap::new();
        let mut order = Vec::new();
        for one in &self.show {
            let (net, node) = one.split_once('/').unwrap_or((one, "*"));
            if !wanted.contains_key(net) {
                order.push(net);
            }
            wanted.entry(net).or_default().push(node);
        }
        let mut top = 0.0;
        let mut parts = Vec::new();
        for net in order {
            let Some(whole) = drawing(net) else { continue };
            let mut part = chosen(whole, wanted.get(net).map_or(&[], Vec::as_slice));
            let (left, above, _, below) = part.bounds();
            let mut moved = Vec::with_capacity(part.nodes.len());
            for node in &mut part.nodes {
                let usual = (node.x - left, node.y - above + top);
                (node.x, node.y) = match self.node.get(&format!("{net}/{}", node.name)) {
                    Some(spot) => (spot.x, spot.y),
                    None => usual,
                };
                moved.push((node.x - usual.0).abs() + (node.y - usual.1).abs() > 2.0);
            }
            // The way of an arc was made for where its ends were.
            let has_moved = |at: usize| moved.get(at).copied().unwrap_or(false);
            for arc in &mut part.arcs {
                if has_moved(arc.from) || has_moved(arc.to) {
                    arc.via.clear();
                }
            }
            for (x, y) in part.arcs.iter_mut().flat_map(|arc| arc.via.iter_mut()) {
                (*x, *y) = (*x - left, *y - above + top);
            }
            top += below - above + BETWEEN;
            parts.push(OverviewPart {
                net: net.to_owned(),
                drawing: part,
            });
        }
        parts
    }
}

/// The nodes that are wanted, with the arcs between them.
fn chosen(whole: &Drawing, wanted: &[&str]) -> Drawing {
    let kept = |name: &str| wanted.iter().any(|pattern| matches(pattern, name));
    let mut place = Vec::with_capacity(whole.nodes.len());
    let mut nodes = Vec::new();
    for node in &whole.nodes {
        place.push(kept(&node.name).then_some(nodes.len()));
        if kept(&node.name) {
            nodes.push(node.clone());
        }
    }
    let arcs = whole.arcs.iter().filter_map(|arc| {
        let mut arc = arc.clone();
        arc.from = place.get(arc.from).copied().flatten()?;
        arc.to = place.get(arc.to).copied().flatten()?;
        Some(arc)
    });
    Drawing {
        nodes,
        arcs: arcs.collect(),
    }
}

/// Whether a name fits a pattern in which `*` stands for any letters.
fn matches(pattern: &str, name: &str) -> bool {
    let mut parts = pattern.split('*');
    let first = parts.next().unwrap_or_default();
    let Some(mut rest) = name.strip_prefix(first) else {
        return false;
    };
    let mut last = None;
    for part in parts {
        if let Some(before) = last.replace(part) {
            match rest.find(before) {
                Some(at) => rest = rest.get(at + before.len()..).unwrap_or_default(),
                None => return false,
            }
        }
    }
    last.map_or(rest.is_empty(), |last: &str| rest.ends_with(last))
}

#[cfg(test)]
mod tests {
    use pnt::{compile, layout::Detail, stream::NetView};

    use super::*;

    fn drawing() -> Drawing {
        let text = include_str!("../../../configs/nets/dispatcher.net");
        let net = compile::net(&Source::new("d.net", text)).unwrap_or_else(|f| panic!("{f}"));
        Drawing::new(&NetView::new(&net), Detail::Written)
    }

    #[test]
    fn a_star_stands_for_any_letters() {
        let yes = [
            ("a*", "abc"),
            ("*c", "abc"),
            ("a*c", "ac"),
            ("*", ""),
            ("*b*c*", "abcd"),
            ("abc", "abc"),
        ];
        let no = [("a", "abc"), ("*b", "abc"), ("a*a", "a"), ("abc*d", "abc")];
        assert!(yes.iter().all(|(pattern, name)| matches(pattern, name)));
        assert!(!no.iter().any(|(pattern, name)| matches(pattern, name)));
    }

    #[test]
    fn an_overview_shows_what_was_chosen_and_tells_what_no_net_has() {
        let text = "[display.arm]\ntitle = \"the arm\"\nshow = [\"dispatcher/move_*\", \"dispatcher/robot_at_pos\", \"nobody/x\", \"dispatcher/typo\"]\nnode.\"dispatcher/move_robot\" = { x = 5, y = 6 }\n";
        let mut findings = Findings::new();
        let overviews = Overviews::read(&Source::new("d.toml", text), &mut findings);
        assert!(findings.is_empty(), "{findings}");
        let drawing = drawing();
        let of = |net: &str| (net == "dispatcher").then_some(&drawing);
        let drawn = overviews.drawn(of);
        let nodes = &drawn[0].parts[0].drawing.nodes;
        let mut names: Vec<&str> = nodes.iter().map(|node| node.name.as_str()).collect();
        names.sort_unstable();
        assert_eq!(names, ["move_robot", "robot_at_pos"]);
        assert_eq!(drawn[0].parts[0].drawing.arcs.len(), 1);
        let moved = nodes.iter().find(|node| node.name == "move_robot").unwrap();
        assert_eq!((moved.x, moved.y), (5.0, 6.0));
        assert_eq!(
            overviews.unknown(of),
            ["arm: nobody/x", "arm: dispatcher/typo"]
        );
    }

    #[test]
    fn nodes_of_a_display_stand_where_they_were_put_and_names_of_no_display_are_told() {
        let text = "[display.arm]\nshow = [\"dispatcher/*\"]\n";
        let mut findings = Findings::new();
        let mut overviews = Overviews::read(&Source::new("d.toml", text), &mut findings);
        let put = "[display.arm.node]\n\"dispatcher/fork\" = { x = -300, y = 7 }\n[display.leg.node]\n\"a/b\" = { x = 1, y = 1 }\n";
        overviews.arrange(&Source::new("d.layout.toml", put), &mut findings);
        let told = findings.to_string();
        assert!(
            told.contains("d.layout.toml:3:") && told.contains("no display `leg`"),
            "{told}"
        );
        let drawing = drawing();
        let drawn = overviews.drawn(|net| (net == "dispatcher").then_some(&drawing));
        let part = &drawn[0].parts[0].drawing;
        let fork = part
            .nodes
            .iter()
            .position(|node| node.name == "fork")
            .unwrap();
        assert_eq!((part.nodes[fork].x, part.nodes[fork].y), (-300.0, 7.0));
        let of_fork = part
            .arcs
            .iter()
            .filter(|arc| arc.from == fork || arc.to == fork);
        assert!(of_fork.clone().count() > 1 && of_fork.clone().all(|arc| arc.via.is_empty()));
    }

    #[test]
    fn each_mistake_in_a_file_of_displays_is_told_and_the_rest_is_shown() {
        let text =
            "[display.a]\nshow = [\"n/p\"]\n[display.b]\nshows = []\n[display.c]\nshow = 3\n";
        let mut findings = Findings::new();
        let overviews = Overviews::read(&Source::new("d.toml", text), &mut findings);
        let told = findings.to_string();
        assert!(
            told.contains("d.toml:4:1") && told.contains("d.toml:6:"),
            "{told}"
        );
        assert_eq!(overviews.displays.keys().collect::<Vec<_>>(), ["a"]);
    }
}
