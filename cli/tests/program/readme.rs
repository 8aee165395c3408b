//! The documents are true. Code in the README is code of the example, its output is the output of a run,
//! and every file that a document names exists.

use std::fs;

use crate::common::{good, hello, root};

/// The pages a person reads: those of the top folder and all of `docs`.
fn documents() -> Vec<String> {
    let pages = fs::read_dir(root().join("docs")).expect("docs is a folder");
    let mut pages: Vec<String> = pages
        .map(|page| page.expect("docs can be read").file_name())
        .map(|name| format!("docs/{}", name.to_string_lossy()))
        .filter(|page| page.ends_with(".md"))
        .collect();
    pages.sort_unstable();
    pages.extend(["README.md", "CONTRIBUTING.md"].map(str::to_owned));
    pages
}

fn read(path: &str) -> String {
    fs::read_to_string(root().join(path)).unwrap_or_else(|error| panic!("{path}: {error}"))
}

/// The fenced blocks of a document: language and text.
fn blocks(document: &str) -> Vec<(String, String)> {
    let mut parts = document.split("\n```");
    parts.next();
    let mut blocks = Vec::new();
    while let Some(block) = parts.next() {
        let (language, text) = block.split_once('\n').expect("a block has lines");
        blocks.push((language.to_owned(), format!("{text}\n")));
        parts.next();
    }
    blocks
}

/// A document without its fenced blocks.
fn prose(document: &str) -> String {
    document.split("\n```").step_by(2).collect()
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

#[test]
fn code_in_the_readme_stands_in_the_example_word_for_word() {
    let mut seen = [0; 3];
    for (language, text) in blocks(&read("README.md")) {
        let (file, kind) = match language.as_str() {
            "rust" => ("cli/examples/hello.rs", 0),
            "toml" => ("configs/hello.toml", 1),
            "net" => ("configs/nets/hello.net", 2),
            _ => continue,
        };
        seen[kind] += 1;
        assert!(
            read(file).contains(&text),
            "README.md shows what is not in {file}:\n{text}"
        );
    }
    assert_eq!(seen, [2, 1, 1]);
}

#[test]
fn output_in_the_readme_is_the_output_of_a_run() {
    let readme = read("README.md");
    let mut shown = blocks(&readme)
        .into_iter()
        .filter(|(language, _)| language == "console");
    let (_, text) = shown.next().expect("the README shows a run");
    assert!(shown.next().is_none());
    let (command, output) = text.split_once('\n').expect("a command and its output");
    assert_eq!(
        command,
        "$ cargo run --example hello -- boot configs/hello.toml -v"
    );
    let (out, err) = good(&hello(&["-v"]));
    // The lines of two processes and of two streams may come in another order.
    let sorted = |text: &str| {
        let lines = text.lines().map(masked).filter(|line| !line.is_empty());
        let mut lines: Vec<String> = lines.collect();
        lines.sort();
        lines
    };
    assert_eq!(sorted(output), sorted(&format!("{err}{out}")));
}

#[test]
fn the_readme_has_a_line_for_every_crate() {
    let (readme, manifest) = (read("README.md"), read("Cargo.toml"));
    let members = manifest
        .lines()
        .find_map(|line| line.strip_prefix("members = ["))
        .expect("the workspace has members");
    for member in members.trim_end_matches(']').split(", ") {
        let member = member.trim_matches('"');
        let row = format!("| [{member}]({member}/");
        assert!(readme.contains(&row), "README.md has no row for {member}");
    }
}

#[test]
fn every_link_and_every_path_in_the_documents_leads_to_a_file() {
    for document in documents() {
        let text = prose(&read(&document));
        let folder = root().join(&document);
        let folder = folder.parent().expect("a document is in a folder");
        for link in text.split("](").skip(1) {
            let link = link.split([')', '#']).next().unwrap_or_default();
            if !link.is_empty() && !link.contains("://") {
                assert!(folder.join(link).exists(), "{document} links to {link}");
            }
        }
        for path in text.split('`').skip(1).step_by(2) {
            if is_path(path) {
                assert!(root().join(path).exists(), "{document} names {path}");
            }
        }
    }
}

/// Whether a word in code font is meant as a path of this repository: it begins with a folder of it.
fn is_path(word: &str) -> bool {
    let Some((first, rest)) = word.split_once('/') else {
        return false;
    };
    let ours = !first.is_empty() && !first.starts_with('-') && root().join(first).is_dir();
    ours && !rest.contains([' ', '*', '<'])
}

#[test]
fn the_licence_is_the_one_that_the_manifest_names() {
    assert!(read("Cargo.toml").contains("license = \"Apache-2.0\""));
    let licence = read("LICENSE");
    assert!(licence.contains("Apache License"));
    assert!(licence.contains("END OF TERMS AND CONDITIONS"));
}
