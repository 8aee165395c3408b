//! `docs/authoring-nets.md`: every file of the page is written, and every line after `$` is run.

use std::{fs, process::Command};

use crate::common::root;

const PAGE: &str = include_str!("../../../docs/authoring-nets.md");

enum Step {
    File(String, String),
    /// A command line, its exit code, and what it must say.
    Run(String, i32, String),
}

/// The steps of the page, in order.
fn steps() -> Vec<Step> {
    let mut steps = Vec::new();
    let mut named = None;
    let mut parts = PAGE.split("```");
    while let (Some(prose), Some(block)) = (parts.next(), parts.next()) {
        let before = prose.trim_end().lines().last().unwrap_or_default();
        if let Some(name) = before
            .strip_prefix('`')
            .and_then(|rest| rest.strip_suffix("`:"))
        {
            named = Some(name.to_owned());
        }
        let (kind, text) = block.split_once('\n').unwrap();
        if kind == "console" {
            steps.extend(text.lines().map(step));
        } else {
            let name = named
                .take()
                .unwrap_or_else(|| panic!("a block without a file:{block}"));
            steps.push(Step::File(name, text.to_owned()));
        }
    }
    steps
}

fn step(line: &str) -> Step {
    let line = line
        .strip_prefix("$ ")
        .unwrap_or_else(|| panic!("no command: {line}"));
    let (line, expected) = line.split_once('#').unwrap_or((line, "exit 0: "));
    let expected = expected.trim().strip_prefix("exit ").unwrap();
    let (code, said) = expected.split_once(':').unwrap();
    Step::Run(
        line.trim().to_owned(),
        code.parse().unwrap(),
        said.trim().to_owned(),
    )
}

#[test]
fn every_step_of_the_page_is_run_and_does_what_it_says() {
    let folder = tempfile::tempdir().unwrap();
    std::os::unix::fs::symlink(root().join("configs"), folder.path().join("configs")).unwrap();
    let steps = steps();
    // Nets may be named before the page shows them.
    for step in &steps {
        if let Step::File(name, text) = step {
            fs::write(folder.path().join(name), text).unwrap();
        }
    }
    let mut run = 0;
    for step in &steps {
        let Step::Run(line, code, said) = step else {
            continue;
        };
        let arguments = line.strip_prefix("ctos ").unwrap();
        let output = Command::new(env!("CARGO_BIN_EXE_ctos"))
            .args(arguments.split(' '))
            .current_dir(folder.path())
            .env("NO_COLOR", "1")
            .output()
            .unwrap();
        let told =
            String::from_utf8(output.stderr).unwrap() + &String::from_utf8(output.stdout).unwrap();
        assert_eq!(output.status.code(), Some(*code), "$ {line}\n{told}");
        assert!(told.contains(said), "$ {line}\nshould say {said}:\n{told}");
        run += 1;
    }
    assert!(run >= 15, "only {run} commands were found");
}
