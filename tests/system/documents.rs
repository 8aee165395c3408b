//! The documents hold together. Every page of the book stands in its summary, and every link and every anchor
//! leads somewhere. The tutorial shows the files of an app and the output of all of its commands.
//!
//! `cli/tests/program/readme.rs` compares the README with its example; other pages have tests beside what they tell of.

use std::{
    collections::{BTreeMap, BTreeSet},
    fs,
    path::{Component, Path, PathBuf},
};

use crate::harness::{CTOS, Scratch, TUTORIAL};

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..")
}

fn read(path: &str) -> String {
    fs::read_to_string(root().join(path)).unwrap_or_else(|error| panic!("{path}: {error}"))
}

/// The pages of the book, as paths from the root.
fn pages() -> BTreeSet<String> {
    let mut pages = BTreeSet::new();
    for entry in fs::read_dir(root().join("docs")).unwrap() {
        let name = entry.unwrap().file_name().into_string().unwrap();
        if name.ends_with(".md") && name != "SUMMARY.md" {
            pages.insert(format!("docs/{name}"));
        }
    }
    pages
}

/// The lines of a page outside its fenced blocks.
fn prose(text: &str) -> Vec<&str> {
    let mut inside = false;
    text.lines()
        .filter(|line| {
            let fence = line.trim_start().starts_with("```");
            inside ^= fence;
            !inside && !fence
        })
        .collect()
}

/// A page's fenced blocks: what stands behind the fence, and the text.
fn blocks(text: &str) -> Vec<(&str, &str)> {
    let mut parts = text.split("\n```").skip(1);
    let mut blocks = Vec::new();
    while let Some(block) = parts.next() {
        blocks.push(block.split_once('\n').unwrap());
        parts.next();
    }
    blocks
}

/// The targets of all links and pictures in a line, code left out.
fn links(line: &str) -> Vec<String> {
    let text: String = line.split('`').step_by(2).collect();
    text.split("](")
        .skip(1)
        .filter_map(|rest| rest.split_once(')'))
        .map(|(target, _)| target.to_owned())
        .filter(|target| !target.contains("://"))
        .collect()
}

/// The anchor that a forge and mdBook make of a heading.
fn anchor(heading: &str) -> String {
    let kept = |letter: &char| letter.is_alphanumeric() || matches!(letter, ' ' | '-' | '_');
    let text = heading.trim().to_lowercase();
    text.chars()
        .filter(kept)
        .map(|letter| if letter == ' ' { '-' } else { letter })
        .collect()
}

/// The anchors of a page; a heading that stands there again gets a number.
fn anchors(text: &str) -> BTreeSet<String> {
    let mut seen: BTreeMap<String, usize> = BTreeMap::new();
    let mut anchors = BTreeSet::new();
    for line in prose(text) {
        let heading = line.trim_start_matches('#');
        if !line.starts_with('#') || !heading.starts_with(' ') {
            continue;
        }
        let name = anchor(heading);
        let before = seen.entry(name.clone()).or_default();
        anchors.insert(match before {
            0 => name,
            _ => format!("{name}-{before}"),
        });
        *before += 1;
    }
    anchors
}

/// A path without `..`, as far as it can be had from the text alone.
fn plain(path: &Path) -> String {
    let mut parts: Vec<String> = Vec::new();
    for part in path.components() {
        match part {
            Component::ParentDir if parts.last().is_some_and(|last| last != "..") => {
                parts.pop();
            }
            part => parts.push(part.as_os_str().to_string_lossy().into_owned()),
        }
    }
    parts.join("/")
}

/// What is wrong with a link on a page, if anything is.
fn broken(page: &str, target: &str) -> Option<String> {
    let (file, anchor) = target.split_once('#').unwrap_or((target, ""));
    let folder = Path::new(page).parent().unwrap();
    let file = match file {
        "" => page.to_owned(),
        _ => plain(&folder.join(file)),
    };
    if !root().join(&file).exists() {
        return Some(format!("{page} links to {target}: there is no {file}"));
    }
    if page.starts_with("docs/") && !file.starts_with("docs/") {
        return Some(format!(
            "{page} links to {target}, which is not in the book"
        ));
    }
    let lost =
        !(anchor.is_empty() || file.ends_with(".md") && anchors(&read(&file)).contains(anchor));
    lost.then(|| format!("{page} links to {target}: no heading of {file} has that anchor"))
}

#[test]
fn every_page_of_the_book_stands_in_its_summary_once_and_in_its_index() {
    for contents in ["docs/SUMMARY.md", "docs/README.md"] {
        let text = read(contents);
        let listed: Vec<String> = prose(&text)
            .into_iter()
            .flat_map(links)
            .map(|target| format!("docs/{target}"))
            .filter(|page| page != "docs/SUMMARY.md")
            .collect();
        let once: BTreeSet<String> = listed.iter().cloned().collect();
        let mut pages = pages();
        if contents == "docs/README.md" {
            pages.remove(contents);
        }
        assert_eq!(once, pages, "{contents}");
        assert_eq!(once.len(), listed.len(), "{contents} lists a page twice");
    }
}

#[test]
fn every_relative_link_and_every_anchor_leads_somewhere() {
    let mut pages = pages();
    pages.extend(["docs/SUMMARY.md", "README.md", "CONTRIBUTING.md"].map(str::to_owned));
    let mut wrong = Vec::new();
    let mut count = 0;
    for page in &pages {
        let text = read(page);
        for target in prose(&text).into_iter().flat_map(links) {
            wrong.extend(broken(page, &target));
            count += 1;
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
    assert!(count > 100, "only {count} links were found");
}

#[test]
fn links_and_anchors_that_lead_nowhere_are_found() {
    for target in [
        "#no-such-heading",
        "boot.md#no-such-heading",
        "nowhere.md",
        "../README.md",
    ] {
        assert!(broken("docs/links.md", target).is_some(), "{target}");
    }
    assert_eq!(broken("docs/links.md", "boot.md#other-hosts"), None);
    assert_eq!(broken("README.md", "docs/README.md"), None);
    assert_eq!(
        links("see [`a`](b.md#c), `[no](d.md)` and ![](e.png)"),
        ["b.md#c", "e.png"]
    );
    assert_eq!(
        anchor(" `[chassis.NAME]`, in short "),
        "chassisname-in-short"
    );
    let twice: Vec<String> = anchors("# A\n## A\n```\n# B\n```\n").into_iter().collect();
    assert_eq!(twice, ["a", "a-1"]);
}

/// Every number as `#`, every run of spaces as one: times, process ids and columns vary.
fn masked(line: &str) -> String {
    let mut out = String::new();
    for letter in line.trim().chars() {
        match letter {
            '0'..='9' | '.' if out.ends_with('#') => {}
            '0'..='9' => out.push('#'),
            ' ' if out.ends_with(' ') => {}
            other => out.push(other),
        }
    }
    out
}

/// The names that are called in a text in Rust: what stands before each `(`, turbofish left out.
fn called(text: &str) -> BTreeSet<String> {
    let code = text.lines().map(|line| line.split("//").next().unwrap());
    let code: Vec<&str> = code.collect();
    let code = code.join("\n");
    let mut names = BTreeSet::new();
    for (at, _) in code.match_indices('(') {
        let before = match code[..at].rsplit_once("::<") {
            Some((name, kind)) if kind.ends_with('>') && !kind.contains(['(', ';']) => name,
            _ => &code[..at],
        };
        let is_name = |letter: char| letter.is_ascii_alphanumeric() || letter == '_';
        let start = before
            .rfind(|letter| !is_name(letter))
            .map_or(0, |at| at + 1);
        let (path, name) = before.split_at(start);
        let defined = path.ends_with("fn ");
        let called = path.ends_with('.') || path.ends_with("::");
        if !name.is_empty() && !defined && (called || path.ends_with(' ')) {
            names.insert(name.to_owned());
        }
    }
    names
}

#[test]
fn every_call_of_the_app_that_ctos_new_writes_stands_in_the_documents() {
    /// Those of the standard library, of Rust, and of the app itself.
    const PLAIN: [&str; 25] = [
        "Add",
        "Arc",
        "Err",
        "None",
        "Ok",
        "Some",
        "add",
        "add_all",
        "checked_add",
        "collect",
        "concat",
        "contains",
        "derive",
        "from_secs",
        "iter",
        "map",
        "new",
        "ok_or",
        "parse",
        "registry",
        "report",
        "run",
        "to_owned",
        "told",
        "unwrap",
    ];
    let page = read("docs/tasks.md");
    let (_, section) = page.split_once("## The calls of a small app").unwrap();
    let section = section.split("\n## ").next().unwrap();
    let mut calls = BTreeSet::new();
    for file in ["main", "handlers", "tests"] {
        calls.extend(called(&read(&format!(
            "cli/examples/template/src/{file}.rs"
        ))));
    }
    assert!(calls.len() > 20, "{calls:?}");
    for call in calls.iter().filter(|call| !PLAIN.contains(&call.as_str())) {
        let written = [format!("{call}("), format!("{call}::<")];
        let told = written.iter().any(|text| section.contains(text));
        assert!(told, "docs/tasks.md does not tell of `{call}`: {calls:?}");
    }
}

/// The files that the tutorial shows whole, and whether they are the reader's app before anything is compiled.
const FILES: [(&str, bool); 6] = [
    ("tea.net", true),
    ("kettle.py", true),
    ("kettle.toml", true),
    ("app.toml", true),
    ("src/handlers.rs", false),
    ("src/main.rs", false),
];

/// The commands of a block, each with what it prints.
fn session(block: &str) -> Vec<(&str, String)> {
    let mut commands: Vec<(&str, String)> = Vec::new();
    for line in block.lines() {
        match (line.strip_prefix("$ "), commands.last_mut()) {
            (Some(command), _) => commands.push((command, String::new())),
            (None, Some((_, printed))) => printed.push_str(&format!("{line}\n")),
            (None, None) => {}
        }
    }
    commands
}

#[test]
fn every_piece_of_configuration_in_the_documents_can_be_read() {
    let mut wrong = Vec::new();
    let mut count = 0;
    for page in pages() {
        let text = read(&page);
        for (kind, block) in blocks(&text) {
            if kind == "toml" {
                count += 1;
                if let Err(error) = block.parse::<toml::Table>() {
                    wrong.push(format!("{page}: {error}\n{block}"));
                }
            }
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
    assert!(count > 30, "only {count} pieces were found");
}

#[test]
fn the_tutorial_shows_the_files_of_its_app_and_what_every_command_prints() {
    let page = read("docs/tutorial.md");
    for (file, _) in FILES {
        let text = read(&format!("tests/tutorial/{file}"));
        let shown = blocks(&page)
            .iter()
            .any(|(_, block)| format!("{block}\n") == text);
        assert!(
            shown,
            "the tutorial does not show tests/tutorial/{file} as it is"
        );
    }
    let scratch = Scratch::empty();
    // What the reader calls `ctos`, and what cargo runs of the reader's package.
    let path = |folder: &str, program: &str| {
        let folder = scratch.path(folder);
        fs::create_dir(&folder).unwrap();
        std::os::unix::fs::symlink(program, folder.join("ctos")).unwrap();
        format!("{}:{}", folder.display(), std::env::var("PATH").unwrap())
    };
    let (plain, rust) = (path("bin", CTOS), path("rust", TUTORIAL));
    let (mut folder, mut runs) = (".".to_owned(), 0);
    for (language, block) in blocks(&page) {
        // The net with the mistake, and the file with the kettle in Rust.
        if block.contains("Forgets to fill") {
            scratch.write("tea/wrong.net", format!("{block}\n"));
        }
        if language == "toml" && block.contains("handler = \"tea.kettle\"") {
            let old = "[task.kettle]\nhandler = \"ctos.program\"\non = \"kitchen\"\nargs.command = [\"python3\", \"kettle.py\"]";
            scratch.edit("tea/app.toml", old, block);
        }
        if language != "console" {
            continue;
        }
        for (command, output) in session(block) {
            if let Some(to) = command.strip_prefix("cd ") {
                folder = to.to_owned();
                // What the reader writes there later changes nothing before.
                for (file, _) in FILES.into_iter().filter(|(_, first)| *first) {
                    let text = read(&format!("tests/tutorial/{file}"));
                    if file != "app.toml" {
                        scratch.write(&format!("{to}/{file}"), text);
                    }
                }
                continue;
            }
            if command == "ctos check app.toml" {
                scratch.write("tea/app.toml", read("tests/tutorial/app.toml"));
            }
            let (command, path) = match command.strip_prefix("cargo run -q -- ") {
                Some(arguments) => (format!("ctos {arguments}"), &rust),
                None => (command.to_owned(), &plain),
            };
            let line = format!("cd {folder} && {command}");
            let environment = [("NO_COLOR", "1"), ("PATH", path)];
            let ended = scratch.start("sh", &["-c", &line], &environment).end();
            // Lines of several processes, and of two streams, come in another order.
            let sorted = |text: &str| {
                let lines = text.lines().map(masked).filter(|line| !line.is_empty());
                let mut lines: Vec<String> = lines.collect();
                lines.sort();
                lines
            };
            let said = format!("{}{}", ended.stderr, ended.stdout);
            assert_eq!(sorted(&output), sorted(&said), "{command}\n{}", ended.told);
            runs += 1;
        }
    }
    assert!(runs >= 11, "only {runs} commands were run");
}
