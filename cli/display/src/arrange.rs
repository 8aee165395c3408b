//! Where people put nodes: kept in the layout file beside the net, or beside the file of displays. With the
//! first node that is moved all others are pinned where they stand, so that none of them ever moves by itself.

use std::path::{Path, PathBuf};

use ctos::{
    diagnostic::{Findings, Source},
    task::{Context, HandlerError},
};
use pnt::{
    layout::{Drawing, LayoutFile, beside},
    stream::{NetView, Side},
    task::settings,
};
use toml_edit::{Array, ArrayOfTables, DocumentMut, InlineTable, Item, Table, value};

use super::{
    hub::Hub,
    overview::{Overviews, layout_beside},
    panes::Layout,
    wire::Asked,
};

/// Letters in the name of a layout.
const LONGEST_NAME: usize = 60;

/// Px beyond which nothing is drawn.
const FAR: f64 = 1e6;

/// Puts the nodes of a net where the file beside it says now.
pub(super) fn pin(cx: &Context, view: &mut NetView) {
    let Ok(path) = layout_of(cx, &view.name) else {
        return;
    };
    let mut findings = Findings::new();
    let file = LayoutFile::of_net(&path, &mut findings);
    // On another host, or with a file that is being edited, nodes stay where the net says.
    if path.is_file() && findings.is_empty() && beside(&path).is_file() {
        file.pin(view);
    }
}

/// The file of a net, on this host.
fn layout_of(cx: &Context, net: &str) -> Result<PathBuf, HandlerError> {
    let task = cx.app().task(net);
    let task = task.ok_or_else(|| HandlerError::new(format!("there is no net `{net}`")))?;
    Ok(cx.app().file_at(&settings(task)?.net))
}

/// Keeps where a person put a node.
///
/// # Errors
/// What is missing in the order, or why a file cannot be read or written; it is then as it was.
pub(super) fn keep(
    cx: &Context,
    hub: &Hub,
    displays: &str,
    asked: &Asked,
) -> Result<String, HandlerError> {
    let node = asked.node.as_deref().ok_or("which node?")?;
    let at = asked.at.ok_or("where to?")?;
    if !at.iter().all(|at| at.abs() <= FAR) {
        return Err(HandlerError::new("a node cannot stand so far away"));
    }
    if let Some(display) = &asked.display {
        let path = layout_beside(&cx.app().file_at(displays));
        let shown = hub.overview(display);
        let shown =
            shown.ok_or_else(|| HandlerError::new(format!("there is no display `{display}`")))?;
        let parts = shown.parts.iter().map(|part| (&*part.net, &part.drawing));
        let name = format!("{}/{node}", asked.net);
        let text = on_display(&text_of(&path)?, &path, display, parts, (&name, at))?;
        write(&path, &text)?;
        let source = Source::new(path.display().to_string(), text);
        hub.rearranged(|overviews: &mut Overviews| {
            // It was read when it was written.
            overviews.arrange(&source, &mut Findings::new());
        });
        return Ok(format!("{} keeps it", path.display()));
    }
    let path = beside(&layout_of(cx, &asked.net)?);
    let drawing = hub.written(&asked.net);
    let drawing =
        drawing.ok_or_else(|| HandlerError::new(format!("net `{}` is not shown", asked.net)))?;
    let text = of_net(&text_of(&path)?, &path, &drawing, node, at)?;
    write(&path, &text)?;
    let source = Source::new(path.display().to_string(), text);
    hub.arranged(&asked.net, LayoutFile::read(&source, &mut Findings::new()));
    Ok(format!("{} keeps it", path.display()))
}

/// Keeps a layout under a name.
///
/// # Errors
/// What is missing in the order, or why the file cannot be read or written; it is then as it was.
pub(super) fn keep_layout(
    cx: &Context,
    hub: &Hub,
    displays: &str,
    asked: &Asked,
) -> Result<String, HandlerError> {
    let layout = asked.layout.clone().ok_or("which layout?")?;
    let name = asked.name.trim();
    if name.is_empty() || name.len() > LONGEST_NAME {
        let text = format!("a layout needs a name of at most {LONGEST_NAME} letters");
        return Err(HandlerError::new(text));
    }
    let path = cx.app().file_at(displays);
    let text = with_layout(&text_of(&path)?, &path, name, &layout)?;
    if let Some(folder) = path.parent() {
        std::fs::create_dir_all(folder)?;
    }
    write(&path, &text)?;
    hub.rearranged(|overviews: &mut Overviews| overviews.lay(name, layout));
    Ok(format!("{} keeps it", path.display()))
}

fn text_of(path: &Path) -> Result<String, HandlerError> {
    match std::fs::read_to_string(path) {
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => Ok(String::new()),
        read => read.map_err(|error| {
            HandlerError::new(format!("{} cannot be read: {error}", path.display()))
        }),
    }
}

/// Replaces a file as a whole, or not at all.
fn write(path: &Path, text: &str) -> Result<(), HandlerError> {
    let beside = path.with_extension("toml.new");
    let written = std::fs::write(&beside, text).and_then(|()| std::fs::rename(&beside, path));
    written.map_err(|error| {
        HandlerError::new(format!("{} cannot be written: {error}", path.display()))
    })
}

/// A file as it may be changed: what a person wrote into it stays, with comments.
fn document(text: &str, path: &Path) -> Result<DocumentMut, HandlerError> {
    text.parse().map_err(|error| {
        HandlerError::new(format!(
            "{} cannot be read, and is left as it is: {error}",
            path.display()
        ))
    })
}

/// The layout file of a net, with `node` at another place.
fn of_net(
    text: &str,
    path: &Path,
    drawing: &Drawing,
    node: &str,
    at: [f64; 2],
) -> Result<String, HandlerError> {
    if !drawing.nodes.iter().any(|one| one.name == node) {
        return Err(HandlerError::new(format!("the net has no node `{node}`")));
    }
    let mut file = document(text, path)?;
    let arranged = file.contains_key("node");
    let nodes = table(&mut file, &["node"], path)?;
    for one in &drawing.nodes {
        let at = if one.name == node { at } else { [one.x, one.y] };
        if one.name != node && nodes.contains_key(&one.name) {
            continue;
        }
        let known = nodes.get_mut(&one.name).and_then(Item::as_table_like_mut);
        if let Some(known) = known {
            known.insert("x", value(whole(at[0])));
            known.insert("y", value(whole(at[1])));
        } else {
            let mut spot = spot(at);
            if one.label != Side::Below {
                spot.insert("label", side(one.label).into());
            }
            if one.lying {
                spot.insert("lying", true.into());
            }
            nodes.insert(&one.name, value(spot));
        }
    }
    let routes = file
        .entry("route")
        .or_insert_with(|| Item::ArrayOfTables(ArrayOfTables::new()));
    if let Some(routes) = routes.as_array_of_tables_mut() {
        if !arranged {
            for arc in drawing.arcs.iter().filter(|arc| !arc.via.is_empty()) {
                let name = |at: usize| drawing.nodes.get(at).map_or("", |node| &node.name);
                let mut route = Table::new();
                route.insert("from", value(name(arc.from)));
                route.insert("to", value(name(arc.to)));
                let via = arc.via.iter().map(|(x, y)| [whole(*x), whole(*y)]);
                let via: Array = via.map(Array::from_iter).collect();
                route.insert("via", value(via));
                routes.push(route);
            }
        }
        // The way of an arc was made for where its ends were.
        routes.retain(|route| {
            let ends = |key: &str| route.get(key).and_then(Item::as_str) == Some(node);
            !ends("from") && !ends("to")
        });
    }
    Ok(file.to_string())
}

/// A file of displays with a layout in it.
fn with_layout(
    text: &str,
    path: &Path,
    name: &str,
    layout: &Layout,
) -> Result<String, HandlerError> {
    let mut file = document(text, path)?;
    let kept = table(&mut file, &["layout", name], path)?;
    kept.clear();
    let Layout {
        title,
        panes,
        net,
        plots,
    } = layout;
    if !title.is_empty() {
        kept.insert("title", value(title));
    }
    let panes = panes.iter().map(|pane| pane.word());
    kept.insert("panes", value(Array::from_iter(panes)));
    if let Some(net) = net {
        kept.insert("net", value(net));
    }
    if !plots.is_empty() {
        let plots = plots.iter().map(|plot| String::from(plot.clone()));
        kept.insert("plots", value(Array::from_iter(plots)));
    }
    Ok(file.to_string())
}

/// The layout file of displays, with a node of one at another place.
fn on_display<'d>(
    text: &str,
    path: &Path,
    display: &str,
    parts: impl Iterator<Item = (&'d str, &'d Drawing)>,
    (name, at): (&str, [f64; 2]),
) -> Result<String, HandlerError> {
    let mut file = document(text, path)?;
    let nodes = table(&mut file, &["display", display, "node"], path)?;
    let mut found = false;
    for (net, drawing) in parts {
        for node in &drawing.nodes {
            let key = format!("{net}/{}", node.name);
            if key == name {
                found = true;
                nodes.insert(&key, value(spot(at)));
            } else if !nodes.contains_key(&key) {
                nodes.insert(&key, value(spot([node.x, node.y])));
            }
        }
    }
    if found {
        Ok(file.to_string())
    } else {
        let text = format!("display `{display}` does not show `{name}`");
        Err(HandlerError::new(text))
    }
}

/// The table at the end of `keys`, made where there is none.
fn table<'f>(
    file: &'f mut DocumentMut,
    keys: &[&str],
    path: &Path,
) -> Result<&'f mut dyn toml_edit::TableLike, HandlerError> {
    let mut table: &mut dyn toml_edit::TableLike = file.as_table_mut();
    for (depth, key) in keys.iter().enumerate() {
        let made = || {
            let mut made = Table::new();
            made.set_implicit(depth + 1 < keys.len());
            Item::Table(made)
        };
        table = table
            .entry(key)
            .or_insert_with(made)
            .as_table_like_mut()
            .ok_or_else(|| HandlerError::new(format!("{}: `{key}` is no table", path.display())))?;
    }
    Ok(table)
}

fn spot([x, y]: [f64; 2]) -> InlineTable {
    let mut spot = InlineTable::new();
    spot.insert("x", whole(x).into());
    spot.insert("y", whole(y).into());
    spot
}

/// A whole pixel.
fn whole(at: f64) -> i64 {
    #[allow(
        clippy::cast_possible_truncation,
        reason = "nothing is drawn beyond a million"
    )]
    let whole = at.clamp(-FAR, FAR).round() as i64;
    whole
}

fn side(side: Side) -> &'static str {
    match side {
        Side::Above => "above",
        Side::Below => "below",
        Side::Left => "left",
        Side::Right => "right",
    }
}

#[cfg(test)]
mod tests {
    use pnt::{compile, layout::Detail};

    use super::*;
    use crate::panes::{Pane, Plot};

    const TEXT: &str = "net n\nplace a = 1, b, c\ntransition t\n  in a\n  out b, there@m\ntransition u\n  in b\n  out a, c\n";

    fn view() -> NetView {
        let net = compile::net(&Source::new("n.net", TEXT)).unwrap_or_else(|f| panic!("{f}"));
        NetView::new(&net)
    }

    fn spots(drawing: &Drawing) -> Vec<(String, f64, f64)> {
        let spot = |node: &pnt::layout::DrawnNode| (node.name.clone(), node.x, node.y);
        drawing.nodes.iter().map(spot).collect()
    }

    /// What is drawn once a file is read.
    fn drawn(text: &str) -> Drawing {
        let mut findings = Findings::new();
        let file = LayoutFile::read(&Source::new("n.layout.toml", text), &mut findings);
        assert!(findings.is_empty(), "{findings}");
        let mut view = view();
        assert_eq!(file.pin(&mut view), Vec::<String>::new());
        Drawing::new(&view, Detail::Written)
    }

    #[test]
    fn a_node_that_is_moved_is_kept_and_no_other_ever_moves() {
        let before = Drawing::new(&view(), Detail::Written);
        let path = Path::new("n.layout.toml");
        let text = of_net("", path, &before, "t", [333.0, -40.4]).unwrap();
        let after = drawn(&text);
        for ((name, x, y), (_, was_x, was_y)) in spots(&after).into_iter().zip(spots(&before)) {
            let wanted = if name == "t" {
                (333.0, -40.0)
            } else {
                (was_x.round(), was_y.round())
            };
            assert_eq!((x, y), wanted, "{name}");
        }
        // Moved once more, only that changes.
        let again = drawn(&of_net(&text, path, &after, "there@m", [1.0, 2.0]).unwrap());
        let moved = spots(&again)
            .into_iter()
            .zip(spots(&after))
            .filter(|(a, b)| a != b);
        assert_eq!(
            moved.map(|(a, _)| a).collect::<Vec<_>>(),
            [("there@m".to_owned(), 1.0, 2.0)]
        );
    }

    #[test]
    fn a_layout_that_is_saved_is_read_again_and_the_rest_of_the_file_stays() {
        let text =
            "# mine\n[display.arm]\nshow = [\"a/b\"] # here\n\n[layout.old]\npanes = [\"net\"]\n";
        let layout = Layout {
            title: "Two".to_owned(),
            panes: vec![Pane::Scene, Pane::Lanes],
            net: Some("n".to_owned()),
            plots: vec![Plot::try_from("tokens/n/a".to_owned()).unwrap()],
        };
        let path = Path::new("displays/app.toml");
        let mut kept = text.to_owned();
        for name in ["new one", "old", "new one"] {
            kept = with_layout(&kept, path, name, &layout).unwrap();
        }
        assert!(
            kept.starts_with("# mine\n[display.arm]\nshow = [\"a/b\"] # here\n"),
            "{kept}"
        );
        let mut findings = Findings::new();
        let read = Overviews::read(&Source::new("app.toml", &*kept), &mut findings);
        assert!(findings.is_empty(), "{findings}");
        let layouts = read.layouts();
        assert_eq!(layouts.len(), 2, "{kept}");
        assert!(layouts.iter().all(|one| *one.layout == layout), "{kept}");
    }

    #[test]
    fn what_a_person_wrote_into_a_layout_file_stays() {
        let text = "# mine\n[node]\na = { x = 5, y = 6, label = \"right\" } # here\nother = { x = 1, y = 1 }\n\n[[route]]\nfrom = \"a\"\nto = \"t\"\nvia = [[1, 2]]\n\n[[route]]\nfrom = \"b\"\nto = \"u\"\nvia = [[3, 4]]\n";
        let before = Drawing::new(&view(), Detail::Written);
        let path = Path::new("n.layout.toml");
        let after = of_net(text, path, &before, "a", [7.0, 8.0]).unwrap();
        assert!(after.starts_with("# mine\n[node]\n"), "{after}");
        assert!(
            after.contains("x = 7")
                && after.contains("label = \"right\"")
                && after.contains("# here"),
            "{after}"
        );
        assert!(after.contains("other = { x = 1, y = 1 }"), "{after}");
        // The arc of the node that was moved goes straight now.
        assert!(
            !after.contains("[[1, 2]]") && after.contains("[[3, 4]]"),
            "{after}"
        );
        for (wrong, node) in [("[node", "a"), ("node = 3\n", "a"), (text, "nobody")] {
            assert!(
                of_net(wrong, path, &before, node, [0.0, 0.0]).is_err(),
                "{wrong}"
            );
        }
    }

    #[test]
    fn a_display_keeps_where_its_nodes_were_put() {
        let drawing = Drawing::new(&view(), Detail::Written);
        let path = Path::new("d.layout.toml");
        let parts = || [("n", &drawing)].into_iter();
        let text = on_display("", path, "arm", parts(), ("n/t", [5.0, 9.0])).unwrap();
        assert!(text.contains("[display.arm.node]"), "{text}");
        assert!(text.contains("\"n/t\" = { x = 5, y = 9 }"), "{text}");
        assert_eq!(text.matches("x = ").count(), drawing.nodes.len());
        assert!(on_display("", path, "arm", parts(), ("n/no", [5.0, 9.0])).is_err());
    }
}
