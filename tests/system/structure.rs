//! The structure of the code: which crate uses which, as `docs/architecture.md` says, and which files of a crate
//! import one another in a circle.

use std::{
    collections::{BTreeMap, BTreeSet},
    fs,
    path::{Path, PathBuf},
};

use petgraph::{algo::tarjan_scc, graphmap::DiGraphMap};
use syn::{Item, UseTree};

/// No more files than these may import one another in a circle.
const MOST: usize = 3;

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..")
}

fn read(path: impl AsRef<Path>) -> String {
    let path = path.as_ref();
    fs::read_to_string(path).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}

/// The folders of all crates.
fn members() -> Vec<String> {
    let manifest = read(root().join("Cargo.toml"));
    let line = manifest.lines().find(|line| line.starts_with("members"));
    let words = line.expect("the workspace has members").split('"');
    words.skip(1).step_by(2).map(str::to_owned).collect()
}

/// The names of the crates of this workspace that the crate in `folder` is built with.
fn uses(folder: &str, all: &BTreeSet<String>) -> BTreeSet<String> {
    let manifest = read(root().join(folder).join("Cargo.toml"));
    let dependencies = manifest.split("\n[dependencies]\n").nth(1);
    let lines = dependencies.unwrap_or_default().lines();
    lines
        .take_while(|line| !line.starts_with('['))
        .filter_map(|line| line.split(['.', ' ', '=']).next())
        .filter(|name| all.contains(*name))
        .map(str::to_owned)
        .collect()
}

fn name_of(folder: &str) -> String {
    let manifest = read(root().join(folder).join("Cargo.toml"));
    let line = manifest
        .lines()
        .find_map(|line| line.strip_prefix("name = "));
    line.expect("a name").trim_matches('"').to_owned()
}

#[test]
fn the_table_of_crates_says_what_their_manifests_say() {
    let folders: Vec<String> = members()
        .into_iter()
        .filter(|folder| !folder.starts_with("tests"))
        .collect();
    let names: BTreeSet<String> = folders.iter().map(|folder| name_of(folder)).collect();
    let page = read(root().join("docs/architecture.md"));
    let rows: BTreeMap<String, BTreeSet<String>> = page
        .lines()
        .filter_map(|line| {
            let cells: Vec<&str> = line.split('|').map(str::trim).collect();
            let [_, name, _, uses, _, _] = cells[..] else {
                return None;
            };
            let name = name.trim_matches('`').to_owned();
            let uses = uses.split(", ").map(|one| one.trim_matches('`').to_owned());
            let uses = uses.filter(|one| !one.is_empty()).collect();
            names.contains(&name).then_some((name, uses))
        })
        .collect();
    for folder in &folders {
        let name = name_of(folder);
        let row = rows.get(&name);
        assert_eq!(row, Some(&uses(folder, &names)), "the row of `{name}`");
    }
}

/// The modules of a crate, by path, with their files.
fn modules(sources: &Path) -> BTreeMap<Vec<String>, PathBuf> {
    let mut modules = BTreeMap::new();
    let mut folders = vec![sources.to_owned()];
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(&folder).expect("a folder") {
            let path = entry.expect("an entry").path();
            let stem = path.file_stem().and_then(|stem| stem.to_str());
            let stem = stem.unwrap_or_default();
            if path.is_dir() && !["tests", "bin"].contains(&stem) {
                folders.push(path);
            } else if path.extension().is_some_and(|end| end == "rs") && stem != "tests" {
                let inner = path
                    .strip_prefix(sources)
                    .expect("inside")
                    .with_extension("");
                let parts = inner.iter().map(|part| part.to_string_lossy().into_owned());
                let parts: Vec<String> = parts.filter(|part| part != "lib").collect();
                modules.insert(parts, path);
            }
        }
    }
    modules
}

/// All paths that a tree of imports names.
fn paths(tree: &UseTree, before: &[String], found: &mut Vec<Vec<String>>) {
    let mut path = before.to_vec();
    match tree {
        UseTree::Path(next) => {
            path.push(next.ident.to_string());
            paths(&next.tree, &path, found);
        }
        UseTree::Group(group) => {
            for tree in &group.items {
                paths(tree, before, found);
            }
        }
        UseTree::Name(name) => {
            path.push(name.ident.to_string());
            found.push(path);
        }
        UseTree::Rename(name) => {
            path.push(name.ident.to_string());
            found.push(path);
        }
        UseTree::Glob(_) => found.push(path),
    }
}

/// The path from the root of the crate of what the module `at` calls `path`; none for other crates.
fn absolute(at: &[String], path: &[String]) -> Option<Vec<String>> {
    let (mut base, mut rest) = match path.first()?.as_str() {
        "crate" => (Vec::new(), &path[1..]),
        "self" => (at.to_vec(), &path[1..]),
        "super" => (at.to_vec(), path),
        _ => return None,
    };
    while rest.first().is_some_and(|part| part == "super") {
        base.pop();
        rest = &rest[1..];
    }
    base.extend(rest.iter().cloned());
    Some(base)
}

/// The circles of a crate: files that import one another, directly or not, by their `use` lines outside of tests.
fn circles(folder: &str) -> Vec<Vec<String>> {
    let modules = modules(&root().join(folder).join("src"));
    let numbers: BTreeMap<&Vec<String>, usize> = modules.keys().zip(0..).collect();
    let mut graph = DiGraphMap::<usize, ()>::new();
    for (at, file) in &modules {
        let parsed = syn::parse_file(&read(file)).expect("Rust");
        let mut found = Vec::new();
        for item in &parsed.items {
            if let Item::Use(item) = item {
                paths(&item.tree, &[], &mut found);
            }
        }
        for path in found {
            let Some(mut to) = absolute(at, &path) else {
                continue;
            };
            while !to.is_empty() && !modules.contains_key(&to) {
                to.pop();
            }
            // What stands in the root is re-exported there from its own place.
            if !to.is_empty() && to != *at {
                graph.add_edge(numbers[at], numbers[&to], ());
            }
        }
    }
    let all: Vec<&Vec<String>> = modules.keys().collect();
    tarjan_scc(&graph)
        .into_iter()
        .map(|circle| circle.into_iter().map(|one| all[one].join("/")).collect())
        .collect()
}

#[test]
fn no_more_than_three_files_of_a_crate_import_one_another() {
    let mut found = Vec::new();
    for folder in members() {
        if !root().join(&folder).join("src").is_dir() {
            continue;
        }
        for circle in circles(&folder) {
            if circle.len() > MOST {
                found.push(format!(
                    "{folder}: {} files: {}",
                    circle.len(),
                    circle.join(", ")
                ));
            }
        }
    }
    assert!(found.is_empty(), "{}", found.join("\n"));
}

#[test]
fn a_circle_of_files_is_found() {
    let found = circles("tests/system/circle");
    let largest = found.iter().map(Vec::len).max();
    assert_eq!(largest, Some(4), "{found:?}");
}

/// No crate has more lines of code than these, without its tests, blanks and comments.
const MOST_LINES: usize = 12_000;

/// The lines of code of a file: what its modules for tests do not hold.
fn code(text: &str) -> Vec<&str> {
    let (mut code, mut skipped) = (Vec::new(), false);
    let mut lines = text.lines().peekable();
    while let Some(line) = lines.next() {
        if line == "#[cfg(test)]" {
            // A module that is a file of its own ends here.
            skipped = lines.peek().is_some_and(|next| !next.ends_with(';'));
            lines.next();
        } else if skipped {
            skipped = line != "}";
        } else if !line.trim().is_empty() && !line.trim_start().starts_with("//") {
            code.push(line);
        }
    }
    code
}

/// The lines of code of a crate.
fn lines_of_code(folder: &str) -> usize {
    let modules = modules(&root().join(folder).join("src"));
    modules.values().map(|file| code(&read(file)).len()).sum()
}

#[test]
fn no_crate_has_more_lines_than_one_person_can_know() {
    let mut large = Vec::new();
    for folder in members() {
        let sources = root().join(&folder).join("src");
        if folder.starts_with("tests") || !sources.is_dir() {
            continue;
        }
        let count = lines_of_code(&folder);
        if count > MOST_LINES {
            large.push(format!("{folder}: {count}"));
        }
    }
    assert!(large.is_empty(), "{large:?}");
}

/// All crates of the runtime together have no more.
const MOST_LINES_OF_RUNTIME: usize = 35_095;

#[test]
fn the_runtime_does_not_grow() {
    let members = members();
    let of_runtime = members
        .iter()
        .filter(|folder| folder.split('/').next() == Some("ctos"));
    let count: usize = of_runtime.map(|folder| lines_of_code(folder)).sum();
    assert!(count <= MOST_LINES_OF_RUNTIME, "{count} lines");
}

/// What sockets, files and processes are called.
const SOCKETS: &[&str] = &[
    "TcpStream",
    "TcpListener",
    "UdpSocket",
    "UnixStream",
    "UnixListener",
    "UnixDatagram",
    "tokio::net",
    "rustix::net",
];
const FILES: &[&str] = &[
    "std::fs",
    "tokio::fs",
    "rustix::fs",
    "File::",
    "OpenOptions",
];
const PROCESSES: &[&str] = &[
    "std::process::Command",
    "std::process::Child",
    "tokio::process",
    "rustix::process::Pid",
];

/// What crates may not know of the standard library and others, as the table of crates says.
const WALLS: &[(&str, &[&[&str]])] = &[
    ("ctos/bootstrap", &[SOCKETS, PROCESSES]),
    ("ctos/config", &[SOCKETS, PROCESSES]),
    ("ctos/core", &[SOCKETS, FILES, PROCESSES]),
    ("ctos/message", &[SOCKETS, FILES, PROCESSES]),
    ("ctos/record", &[SOCKETS, PROCESSES]),
    ("ctos/simulation", &[SOCKETS, PROCESSES]),
    ("ctos/time", &[SOCKETS, FILES, PROCESSES]),
    ("vss/board", &[FILES]),
];

#[test]
fn no_crate_names_sockets_files_or_processes_that_it_may_not_know() {
    let mut found = Vec::new();
    for (folder, forbidden) in WALLS {
        for file in modules(&root().join(folder).join("src")).values() {
            let text = read(file);
            let mut names: Vec<String> = code(&text).into_iter().map(str::to_owned).collect();
            for item in &syn::parse_file(&text).expect("Rust").items {
                if let Item::Use(item) = item {
                    let mut paths_in = Vec::new();
                    paths(&item.tree, &[], &mut paths_in);
                    names.extend(paths_in.into_iter().map(|path| path.join("::")));
                }
            }
            let forbidden = || forbidden.iter().copied().flatten();
            let broken = names
                .iter()
                .filter(|name| forbidden().any(|one| name.contains(one)));
            found.extend(broken.map(|name| format!("{}: {}", file.display(), name.trim())));
        }
    }
    assert!(found.is_empty(), "{}", found.join("\n"));
}
