//! `docs/authoring-nets.md` and `docs/own-task.md`: every file of the pages is written, and every line after `$` is run.

use std::{fs, process::Command};

use crate::common::root;

const AUTHORING: &str = include_str!("../../../docs/authoring-nets.md");
const OWN_TASK: &str = include_str!("../../../docs/own-task.md");

enum Step {
    File(String, String),
    /// A command line, its exit code, and what it must say.
    Run(String, i32, String),
}

/// The steps of a page, in order.
fn steps(page: &str) -> Vec<Step> {
    let mut steps = Vec::new();
    let mut named = None;
    let mut parts = page.split("```");
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
fn every_step_about_nets_is_run_and_does_what_it_says() {
    assert!(run_all(AUTHORING) >= 15);
}

#[test]
fn every_step_to_a_task_of_ones_own_is_run_and_its_code_is_that_of_the_template() {
    assert!(run_all(OWN_TASK) >= 5);
    let template = include_str!("../../examples/template_task/src/handlers.rs");
    for step in steps(OWN_TASK) {
        if let Step::File(name, text) = step
            && name == "handlers.rs"
        {
            assert!(template.contains(&text), "{text}");
        }
    }
}

/// Runs all steps of a page: how many commands they were.
fn run_all(page: &str) -> usize {
    let folder = tempfile::tempdir().unwrap();
    std::os::unix::fs::symlink(root().join("configs"), folder.path().join("configs")).unwrap();
    let steps = steps(page);
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
    run
}
