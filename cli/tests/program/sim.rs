//! `ctos sim` on the smallest app, as a person uses it: what it prints can be typed, and is the same.

use std::{
    path::Path,
    process::{Command, Output},
};

use crate::common::root;

/// Runs `ctos sim` with these arguments from the workspace's folder.
fn sim(arguments: &[&str]) -> Output {
    sim_in(arguments, &[])
}

fn sim_in(arguments: &[&str], environment: &[(&str, &str)]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_ctos"))
        .current_dir(root())
        .arg("sim")
        .args(arguments)
        .env("NO_COLOR", "1")
        .envs(environment.iter().copied())
        .output()
        .expect("it runs")
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

/// Two files in a folder of the test's own.
fn files(folder: &Path) -> (String, String) {
    let path = |name: &str| folder.join(name).display().to_string();
    (path("one"), path("two"))
}

#[test]
fn hello_under_one_seed_is_the_same_event_for_event_in_every_process() {
    let folder = tempfile::tempdir().unwrap();
    let (one, two) = files(folder.path());
    for faults in ["none", "rough"] {
        let run = |events: &str, environment: &[(&str, &str)]| {
            let arguments = [
                "configs/hello.toml",
                "--seed",
                "4",
                "--faults",
                faults,
                "--events",
            ];
            sim_in(&[&arguments[..], &[events]].concat(), environment)
        };
        let padding = "y".repeat(50_001);
        let first = run(&one, &[]);
        let second = run(&two, &[("PADDING", &padding), ("TZ", "Asia/Kathmandu")]);
        assert_eq!(text(&first.stdout).trim_end(), "hello_done");
        assert_eq!(
            first,
            second,
            "{}\n{}",
            text(&first.stderr),
            text(&second.stderr)
        );
        let events = std::fs::read_to_string(&one).unwrap();
        assert_eq!(events, std::fs::read_to_string(&two).unwrap());
        assert!(
            events.contains(" deliver shelf/greeter from desk/hello "),
            "{events}"
        );
    }
}

/// The words of the command that a failed run prints to repeat it, after the program and `sim`.
fn repetition(told: &str) -> Vec<String> {
    let line = told.lines().rfind(|line| line.starts_with("repeat"));
    let line = line.unwrap_or_else(|| unreachable!("no repetition in {told}"));
    line.split_whitespace().skip(3).map(str::to_owned).collect()
}

/// A fault that hello cannot survive, among others that it can.
const FATAL: &str = r#"
[loss]
per_s = 20
lasts_s = [0.001, 0.01]
share = [0.1, 0.5]

[[fault]]
kind = "kill"
chassis = "shelf"
at_s = 0.001
"#;

#[test]
fn a_run_that_fails_prints_the_command_that_repeats_it_and_fewer_faults_that_do() {
    let folder = tempfile::tempdir().unwrap();
    let (faults, fewer) = files(folder.path());
    std::fs::write(&faults, FATAL).unwrap();
    let many = sim(&["configs/hello.toml", "--seeds", "3..6", "--faults", &faults]);
    let told = text(&many.stderr);
    assert_eq!(many.status.code(), Some(1), "{told}");
    assert_eq!(text(&many.stdout), "3 of 3 seeds failed\n");
    let words = repetition(&told);
    assert_eq!(words[..3], ["configs/hello.toml", "--seed", "5"]);
    let words: Vec<&str> = words.iter().map(String::as_str).collect();
    let again = sim(&words);
    let told = text(&again.stderr);
    assert_eq!(again.status.code(), Some(1), "{told}");
    assert!(told.contains("error: chassis `shelf` was killed"), "{told}");
    // Every fault that was drawn is part of the report.
    assert!(told.contains("fault    loss"), "{told}");
    assert!(
        told.contains("fault    kill   shelf at 0.001000 s"),
        "{told}"
    );
    let shrunk = sim(&[&words[..], &["--shrink", &fewer]].concat());
    let told = text(&shrunk.stderr);
    let list = std::fs::read_to_string(&fewer).unwrap();
    assert_eq!(
        list, "[[fault]]\nkind = \"kill\"\nchassis = \"shelf\"\nat_s = 0.001000000\n\n",
        "{told}"
    );
    let words = repetition(&told);
    assert!(words.contains(&fewer), "{told}");
    let words: Vec<&str> = words.iter().map(String::as_str).collect();
    assert_eq!(sim(&words).status.code(), Some(1));
}

#[test]
fn many_seeds_of_an_app_that_holds_pass_and_each_is_one_json_object() {
    let run = sim(&[
        "configs/hello.toml",
        "--seeds",
        "0..20",
        "--faults",
        "rough",
        "--json",
    ]);
    let told = text(&run.stderr);
    assert_eq!(run.status.code(), Some(0), "{told}");
    let out = text(&run.stdout);
    assert_eq!(out.lines().count(), 20);
    for (seed, line) in out.lines().enumerate() {
        let object: serde_json::Value = serde_json::from_str(line).unwrap();
        assert_eq!(object["seed"], seed);
        assert_eq!(object["ok"], true);
    }
}

#[test]
fn what_is_wrong_with_the_faults_is_said_with_its_place_before_anything_runs() {
    let folder = tempfile::tempdir().unwrap();
    let (faults, _) = files(folder.path());
    std::fs::write(&faults, "[cut]\nper_s = 1\nlast_s = [1, 2]\n").unwrap();
    let run = sim(&["configs/hello.toml", "--faults", &faults]);
    let told = text(&run.stderr);
    assert_eq!(run.status.code(), Some(3), "{told}");
    assert!(told.contains("did you mean `lasts_s`?"), "{told}");
    let run = sim(&["configs/hello.toml", "--faults", "ruogh"]);
    let told = text(&run.stderr);
    assert_eq!(run.status.code(), Some(3), "{told}");
    assert!(told.contains("did you mean `rough`?"), "{told}");
    std::fs::write(
        &faults,
        "[[fault]]\nkind = \"kill\"\nchassis = \"desc\"\nat_s = 1\n",
    )
    .unwrap();
    let run = sim(&["configs/hello.toml", "--faults", &faults]);
    let told = text(&run.stderr);
    assert_eq!(run.status.code(), Some(3), "{told}");
    assert!(told.contains("there is no chassis `desc`"), "{told}");
}

#[test]
fn the_profiles_that_are_printed_can_be_used_as_files() {
    let run = sim(&["--profiles"]);
    let out = text(&run.stdout);
    let rough = out.split("## rough\n").nth(1).unwrap();
    let rough = rough.split("\n## ").next().unwrap();
    let folder = tempfile::tempdir().unwrap();
    let (file, _) = files(folder.path());
    std::fs::write(&file, rough).unwrap();
    let run = |faults: &str| sim(&["configs/hello.toml", "--json", "--faults", faults]);
    assert_eq!(text(&run("rough").stdout), text(&run(&file).stdout));
}

/// The commands of the page, each with the lines that it shows below them.
fn shown(page: &str) -> Vec<(Vec<String>, Vec<String>)> {
    let blocks = page.split("```console\n").skip(1);
    let blocks = blocks.map(|block| block.split("```").next().unwrap());
    blocks
        .map(|block| {
            let mut lines = block.lines();
            let command = lines.next().unwrap().strip_prefix("$ ctos sim ").unwrap();
            let words = command.split_whitespace().map(str::to_owned).collect();
            (words, lines.map(str::to_owned).collect())
        })
        .collect()
}

#[test]
fn what_the_pages_show_is_what_the_commands_print() {
    let read = |name: &str| std::fs::read_to_string(root().join(name)).unwrap();
    let page = read("docs/time-and-simulation.md");
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("faults.toml").display().to_string();
    let faults = page.split("```toml\n").nth(1).unwrap();
    std::fs::write(&file, faults.split("```").next().unwrap()).unwrap();
    let examples = [shown(&page), shown(&read("docs/architecture.md"))].concat();
    assert!(examples.len() >= 4);
    for (words, lines) in examples {
        let words: Vec<&str> = words
            .iter()
            .map(|word| {
                if word == "faults.toml" {
                    file.as_str()
                } else {
                    word
                }
            })
            .collect();
        let run = sim(&words);
        let told = text(&run.stdout) + &text(&run.stderr);
        for line in lines.iter().filter(|line| *line != "...") {
            let line = line.replace("faults.toml", &file);
            assert!(
                told.lines().any(|said| said == line),
                "no `{line}` in {told}"
            );
        }
    }
}

#[test]
fn a_breakpoint_of_the_command_line_stops_a_net_before_its_first_firing() {
    let folder = tempfile::tempdir().unwrap();
    let (one, two) = files(folder.path());
    let stopped = sim(&[
        "configs/hello.toml",
        "--break",
        "hello.greet",
        "--events",
        &one,
    ]);
    let told = text(&stopped.stderr);
    assert_eq!(stopped.status.code(), Some(7), "{told}");
    assert!(
        told.contains("net `hello` is at breakpoint `greet`"),
        "{told}"
    );
    assert!(told.contains("--break hello.greet"), "{told}");
    let later = sim(&[
        "configs/hello.toml",
        "--break",
        "hello.greeted>=1",
        "--events",
        &two,
    ]);
    assert_eq!(later.status.code(), Some(7), "{}", text(&later.stderr));
    // The action of `greet` is a message to the greeter: it was never sent in the first run.
    let greeted = |events: &str| {
        let events = std::fs::read_to_string(events).unwrap();
        events.contains(" deliver shelf/greeter from desk/hello ")
    };
    assert!(!greeted(&one) && greeted(&two));
}

#[test]
fn a_breakpoint_that_names_nothing_is_refused_before_anything_starts() {
    for (given, said) in [
        ("hello.gret", "net `hello` has no transition `gret`"),
        ("hallo.greet", "no task called `hallo` runs a net"),
        ("hello.idel>=1", "net `hello` has no place `idel`"),
        ("greet", "`greet` does not say where in which net"),
    ] {
        let refused = sim(&["configs/hello.toml", "--break", given]);
        let told = text(&refused.stderr);
        assert_eq!(refused.status.code(), Some(3), "{told}");
        assert!(told.contains(said), "{told}");
        assert!(told.contains("nothing was run"), "{told}");
        if given != "greet" {
            assert!(told.contains("did you mean"), "{told}");
        }
    }
}
