//! Arrangements of nets of the workspace and of nets made at random.

use std::{collections::BTreeMap, fmt::Write as _};

use ctos::diagnostic::{Findings, Source};
use proptest::prelude::*;

use super::*;
use crate::stream::NetView;
use pnt_language::compile;

fn view(text: &str) -> NetView {
    let net = compile::net(&Source::new("n.net", text)).unwrap_or_else(|f| panic!("{f}"));
    NetView::new(&net)
}

fn dispatcher() -> NetView {
    view(include_str!("../../../../configs/nets/dispatcher.net"))
}

fn at(drawing: &Drawing) -> BTreeMap<&str, (f64, f64)> {
    let nodes = drawing.nodes.iter();
    nodes
        .map(|node| (node.name.as_str(), (node.x, node.y)))
        .collect()
}

/// No two nodes stand so near that their names or bodies cover each other.
fn must_not_overlap(drawing: &Drawing) {
    for (index, a) in drawing.nodes.iter().enumerate() {
        for b in &drawing.nodes[index + 1..] {
            let (dx, dy) = ((a.x - b.x).abs(), (a.y - b.y).abs());
            assert!(dx >= 30.0 || dy >= 40.0, "{a:?} {b:?}");
        }
    }
}

#[test]
fn a_request_is_one_transition_as_written_and_its_whole_structure_in_full() {
    let view = dispatcher();
    let written = Drawing::new(&view, Detail::Written);
    let full = Drawing::new(&view, Detail::Full);
    let names = at(&written);
    assert!(names.contains_key("move_robot") && !names.contains_key("start_move_robot"));
    assert!(!names.contains_key("SI_motion"));
    assert!(at(&full).contains_key("start_move_robot") && at(&full).contains_key("SI_motion"));
    let node = written
        .nodes
        .iter()
        .find(|node| node.name == "move_robot")
        .unwrap();
    let Kind::Transition(parts, active) = &node.kind else {
        panic!("{node:?}")
    };
    assert_eq!(parts.len(), 3);
    assert_eq!(
        view.places[active.unwrap() as usize].name,
        "move_robot_active"
    );
    must_not_overlap(&written);
    must_not_overlap(&full);
}

#[test]
fn nodes_stay_where_the_file_says_and_only_new_ones_are_placed() {
    let source = Source::new(
        "d.layout.toml",
        include_str!("../../../../configs/nets/dispatcher.layout.toml"),
    );
    let mut findings = Findings::new();
    let file = LayoutFile::read(&source, &mut findings);
    assert!(findings.is_empty(), "{findings}");
    let mut whole = dispatcher();
    assert_eq!(file.clone().pin(&mut whole), Vec::<String>::new());
    let drawing = Drawing::new(&whole, Detail::Written);
    for (name, pin) in &file.nodes {
        assert_eq!(
            at(&drawing)[name.as_str()],
            (f64::from(pin.x), f64::from(pin.y)),
            "{name}"
        );
    }
    assert!(drawing.nodes.iter().all(|node| node.pinned));
    // Two nodes are new.
    let mut less = file.clone();
    less.nodes.remove("fork");
    less.nodes.remove("calib_valid");
    let mut partly = dispatcher();
    less.pin(&mut partly);
    let again = Drawing::new(&partly, Detail::Written);
    for (name, place) in at(&drawing) {
        let new = ["fork", "calib_valid"].contains(&name);
        assert!(new || at(&again)[name] == place, "{name}");
    }
    must_not_overlap(&again);
    assert_eq!(again.nodes.iter().filter(|node| !node.pinned).count(), 2);
}

#[test]
fn a_written_layout_file_is_read_as_it_was_and_another_nets_names_are_told() {
    let mut findings = Findings::new();
    let text = "[node]\n\"p 1\" = { x = -3, y = 4.4, label = \"left\" }\nt = { x = 1e300, y = 0, lying = true }\n[[route]]\nfrom = \"t\"\nto = \"p 1\"\nvia = [[1, 2], [3.5, -4]]\n";
    let file = LayoutFile::read(&Source::new("a.layout.toml", text), &mut findings);
    assert!(findings.is_empty(), "{findings}");
    assert_eq!(file.nodes["t"].x, 1_000_000);
    let again = LayoutFile::read(&Source::new("b.layout.toml", file.write()), &mut findings);
    assert_eq!(again, file);
    let mut net = view("net n\nplace q = 1\ntransition t\n  in q\n");
    assert_eq!(file.pin(&mut net), ["p 1"]);
    assert!(net.routes.is_empty() && net.pins.contains_key("t"));
}

#[test]
fn what_is_wrong_in_a_layout_file_is_told_with_its_place_and_the_rest_is_used() {
    let text = "[node]\na = { x = 1, y = 2 }\nb = { x = 1, z = 2 }\nc = 3\n[nodes]\n";
    let mut findings = Findings::new();
    let file = LayoutFile::read(&Source::new("a.layout.toml", text), &mut findings);
    let told = findings.to_string();
    assert_eq!(file.nodes.keys().collect::<Vec<_>>(), ["a"]);
    assert!(
        told.contains("a.layout.toml:3:") && told.contains("a.layout.toml:4:"),
        "{told}"
    );
    assert!(
        told.contains("a layout file has no part `nodes` (did you mean `node`?)"),
        "{told}"
    );
}

#[test]
fn a_chain_goes_straight_to_the_right_and_a_circle_comes_back() {
    let chain = view(
        "net n\nplace a = 1, b, c\ntransition t\n  in a\n  out b\ntransition u\n  in b\n  out c\n",
    );
    let drawing = Drawing::new(&chain, Detail::Written);
    let order = ["a", "t", "b", "u", "c"].map(|name| at(&drawing)[name]);
    assert!(
        order.is_sorted_by(|a, b| a.0 < b.0 && a.1 == b.1),
        "{order:?}"
    );
    let circle = view(
        "net n\nplace a = 1, b\ntransition t\n  in a\n  out b\ntransition u\n  in b\n  out a\n",
    );
    let drawing = Drawing::new(&circle, Detail::Written);
    let back = drawing
        .arcs
        .iter()
        .find(|arc| arc.way == Way::Output && !arc.via.is_empty());
    let back = back.unwrap_or_else(|| panic!("{drawing:?}"));
    assert!(back.via.is_sorted_by(|a, b| a.0 > b.0), "{back:?}");
}

#[test]
fn two_rows_that_only_look_crossed_are_drawn_without_a_crossing() {
    // a -> y, b -> x, written so that their followers stand the other way round.
    let sizes = [(10.0, 10.0); 6];
    let arcs = [(0, 3), (1, 2), (3, 4), (2, 5)];
    let mut graph = layers::Layers::new(&sizes, &arcs);
    order::reduce_crossings(&mut graph);
    assert_eq!(order::crossings(&graph), 0);
}

/// Crossings, counted pair by pair.
fn counted(graph: &layers::Layers) -> usize {
    let mut count = 0;
    for pair in graph.layers.windows(2) {
        let ends: Vec<(usize, usize)> = pair[0]
            .iter()
            .enumerate()
            .flat_map(|(from, one)| {
                let after = graph.vertices[*one].after.iter();
                after.map(move |to| (from, pair[1].iter().position(|other| other == to).unwrap()))
            })
            .collect();
        for (index, a) in ends.iter().enumerate() {
            count += ends[index + 1..]
                .iter()
                .filter(|b| (a.0 < b.0 && a.1 > b.1) || (a.0 > b.0 && a.1 < b.1))
                .count();
        }
    }
    count
}

proptest! {
    #[test]
    fn any_graph_is_arranged_without_overlap_and_always_the_same(
        count in 1_usize..40,
        arcs in prop::collection::vec((0_usize..40, 0_usize..40), 0..90),
    ) {
        let sizes: Vec<(f64, f64)> = (0..count).map(|index| (30.0 + (index % 5) as f64 * 20.0, 44.0)).collect();
        let mut graph = layers::Layers::new(&sizes, &arcs);
        prop_assert_eq!(order::crossings(&graph), counted(&graph));
        let before = order::crossings(&graph);
        order::reduce_crossings(&mut graph);
        prop_assert!(order::crossings(&graph) <= before);
        let (nodes, points) = layered(&sizes, &arcs);
        prop_assert_eq!(layered(&sizes, &arcs), (nodes.clone(), points.clone()));
        prop_assert_eq!(points.len(), arcs.len());
        for (index, a) in nodes.iter().enumerate() {
            prop_assert!(a.0.is_finite() && a.1.is_finite());
            for (other, b) in nodes.iter().enumerate().skip(index + 1) {
                let beside = (a.0 - b.0).abs() + 1e-6 >= (sizes[index].0 + sizes[other].0) / 2.0;
                prop_assert!(beside || (a.1 - b.1).abs() + 1e-6 >= 44.0, "{index} {other} {a:?} {b:?}");
            }
        }
    }
}

#[test]
fn two_thousand_nodes_are_arranged() {
    let mut text = "net n\nplace p0 = 1".to_owned();
    for index in 1..1000 {
        let _ = write!(text, ", p{index}");
    }
    text.push('\n');
    for index in 0..1000_usize {
        let _ = writeln!(
            text,
            "transition t{index}\n  in p{index}\n  out p{}, p{}",
            (index * 7 + 4) % 1000,
            (index + 1) % 1000
        );
    }
    let drawing = Drawing::new(&view(&text), Detail::Written);
    assert_eq!((drawing.nodes.len(), drawing.arcs.len()), (2000, 3000));
}
