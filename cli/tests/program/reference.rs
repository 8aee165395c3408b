//! What is written from the code and kept beside it: `docs/commands.md`, `docs/services.md` and
//! `configs/ctos.schema.json`.
//!
//! `UPDATE=1 cargo test -p cli --test program reference` writes them anew.

use std::{collections::BTreeSet, fmt::Write, fs, path::Path};

use crate::common::root;
use clap::{Arg, Command, CommandFactory};
use cli::{
    commands::{Cli, explain},
    exit, program,
    scott::{self, services::CLASSES},
};
use sorma::describe::{self, Form, OptionInfo};

/// Holds `text` against the file, or writes the file when asked to.
fn same_as(file: &str, text: &str) {
    let path = root().join(file);
    if std::env::var_os("UPDATE").is_some() {
        fs::write(&path, text).unwrap_or_else(|error| panic!("{file}: {error}"));
    }
    let there = fs::read_to_string(&path).unwrap_or_default();
    assert!(
        there == text,
        "{file} is not what the code says; UPDATE=1 cargo test -p cli --test program reference writes it anew"
    );
}

#[test]
fn the_page_of_commands_is_what_the_commands_say() {
    same_as("docs/commands.md", &page());
}

#[test]
fn the_schema_beside_the_configurations_is_the_programs() {
    same_as(
        "configs/ctos.schema.json",
        &format!("{:#}\n", program::schema()),
    );
}

/// `docs/commands.md`.
fn page() -> String {
    let mut page = String::from(
        "# Commands of ctos and scott\n\nWritten from the program's own help: \
         `UPDATE=1 cargo test -p cli --test program reference` writes it anew.\n\n## Exit codes\n\n\
         | code | meaning |\n|---|---|\n",
    );
    for (code, meaning) in exit::CODES {
        let _ = writeln!(page, "| {code} | {meaning} |");
    }
    let mut cli = Cli::command().term_width(100);
    cli.build();
    page.push_str("\n## Everywhere\n\n");
    table(
        &mut page,
        cli.get_arguments().filter(|arg| arg.is_global_set()),
    );
    for command in shown(&cli) {
        section(&mut page, command, "ctos");
    }
    let mut scott = scott::Cli::command().term_width(100);
    scott.build();
    section(&mut page, &scott, "");
    page
}

/// Which class is for what: what a person wants, and the classes for it.
const OVERVIEW: [(&str, &str); 22] = [
    (
        "move an arm; stop it, reset it, see its state; watch its joints",
        "mvpos pino slots",
    ),
    ("stream setpoints or torques to an arm", "setpoint torque"),
    ("have guards watch motions", "wspc"),
    (
        "calculate with an arm's model: kinematics, dynamics, times",
        "kin dyn traj",
    ),
    (
        "get an arm around obstacles: plan a way, go to a place",
        "path go",
    ),
    (
        "close and open a gripper; move fingers and grasp; press with two arms",
        "gripper manus squeeze",
    ),
    (
        "have a whole task done: carry a thing, push one",
        "carry push",
    ),
    ("know the rules of checkers, and the best move", "game"),
    (
        "find things in pictures: spots, regions, colours, chequer corners, lines",
        "spot blobs colour corners lines",
    ),
    (
        "find boards and discs in pictures, and correct a gripper by one",
        "board findBrdMarker getDisk diskFind",
    ),
    (
        "calibrate cameras: one, by a plane, a pair, several, on a tool",
        "resect planecal stereo bundle handeye",
    ),
    ("get points and poses from pixels", "triangulate pose"),
    (
        "point with light: a laser scanner, the pointer in the hand",
        "laser pointer",
    ),
    (
        "filter and fit numbers: a moving position, two clocks, any map from examples",
        "abg clockfit psom",
    ),
    (
        "manage objects: those of a process, recipes and daemons",
        "sorm dict",
    ),
    (
        "ask several objects at once, or without waiting",
        "fork later",
    ),
    (
        "get results as they are made; tell subscribers",
        "stream event",
    ),
    ("watch requests; see when one was met", "watch stamp"),
    (
        "share data between tasks: items, permits, values by key",
        "queue semaphore blackboard",
    ),
    (
        "write, read and record snapshot buffers",
        "shmem_w shmem_r shmem_far flight",
    ),
    ("tell people in the room", "sound"),
    (
        "have a program be an object; see how classes behave (demos)",
        "program foo bar",
    ),
];

/// `docs/services.md`.
fn services() -> String {
    let mut page = String::from(
        "# Services\n\nThe classes of service objects, written from their own tables: \
         `UPDATE=1 cargo test -p cli --test program reference` writes it anew. `scott --local` carries all of them; \
         `NAME CTRL -help` tells the same, `NAME CTRL -dump` the state.\n\n\
         Numbers are in SI units and rad, matrices row by row. An option that is wrong leaves the object as it was. \
         The option `-help` and `-dump` of CTRL and everything under DBX are those of every class.\n\n\
         | to | ask |\n|---|---|\n",
    );
    for (purpose, classes) in OVERVIEW {
        let links: Vec<String> = classes
            .split(' ')
            .map(|class| format!("[`{class}`](#{})", class.to_lowercase()))
            .collect();
        let _ = writeln!(page, "| {purpose} | {} |", links.join(", "));
    }
    let manager = scott::services::manager(&[]).expect("the shipped dictionary is right");
    for class in CLASSES.iter() {
        let _ = write!(
            page,
            "\n## {}\n\n{} (version {}).\n",
            class.name,
            sentence(&class.about),
            class.version
        );
        if !class.forms.is_empty() {
            page.push_str("\n| EXEC | FMSG in | answer | does |\n|---|---|---|---|\n");
        }
        for form in &class.forms {
            let text = if form.text.is_empty() {
                String::new()
            } else {
                format!("`{}`", form.text)
            };
            let takes = match form.floats {
                0 => "none".to_owned(),
                Form::ANY => format!("any number: {}", form.takes),
                count => format!("{count}: {}", form.takes),
            };
            let _ = writeln!(
                page,
                "| {text} | {} | {} | {} |",
                cell(&takes),
                cell(&form.gives),
                cell(&form.help)
            );
        }
        option_table(&mut page, "CTRL", &class.options);
        let mut codes: Vec<_> = manager
            .prototypes()
            .into_iter()
            .filter(|(name, _)| *name == class.name)
            .collect();
        codes.sort_by_key(|(_, prototype)| prototype.code);
        if !codes.is_empty() {
            page.push_str("\n| code | report | what to do |\n|---|---|---|\n");
        }
        for (_, prototype) in codes {
            let _ = writeln!(
                page,
                "| {} | {} | {} |",
                prototype.code,
                cell(prototype.text),
                cell(prototype.help)
            );
        }
    }
    page.push_str("\n## Every object\n");
    option_table(&mut page, "DBX", &describe::dbx_options());
    page
}

fn option_table(page: &mut String, method: &str, options: &[OptionInfo]) {
    if options.is_empty() {
        return;
    }
    let _ = write!(
        page,
        "\n| {method} | values | default | meaning |\n|---|---|---|---|\n"
    );
    for option in options {
        let default = option.default.as_ref().map(|value| format!("`{value}`"));
        let form = option.form();
        let form = if form.is_empty() {
            String::new()
        } else {
            format!("`{form}`")
        };
        let _ = writeln!(
            page,
            "| `-{}` | {} | {} | {} |",
            option.name,
            cell(&form),
            cell(&default.unwrap_or_default()),
            cell(&option.help)
        );
    }
}

/// A bar would end the cell.
fn cell(text: &str) -> String {
    text.replace('|', "\\|")
}

fn sentence(text: &str) -> String {
    let mut letters = text.chars();
    let first = letters.next().map(|first| first.to_uppercase().to_string());
    first.unwrap_or_default() + letters.as_str()
}

#[test]
fn the_overview_of_services_has_every_class_once() {
    let mut told: Vec<&str> = OVERVIEW
        .iter()
        .flat_map(|(_, classes)| classes.split(' '))
        .collect();
    told.sort_unstable();
    let mut all: Vec<&str> = CLASSES.iter().map(|class| class.name.as_str()).collect();
    all.sort_unstable();
    assert_eq!(told, all);
}

#[test]
fn the_page_of_services_is_what_the_option_tables_say() {
    same_as("docs/services.md", &services());
}

fn shown(command: &Command) -> impl Iterator<Item = &Command> {
    let all = command.get_subcommands();
    all.filter(|command| !command.is_hide_set() && command.get_name() != "help")
}

fn section(page: &mut String, command: &Command, parent: &str) {
    let name = format!("{parent} {}", command.get_name());
    let name = name.trim_start().to_owned();
    let about = command.get_long_about().or(command.get_about());
    let usage = command.clone().render_usage().to_string();
    let _ = write!(page, "\n## {name}\n\n");
    if let Some(about) = about {
        let _ = write!(page, "{}\n\n", about.to_string().trim());
    }
    let _ = write!(
        page,
        "```text\n{}\n```\n",
        usage.trim_start_matches("Usage: ").trim()
    );
    let own = command.get_arguments().filter(|arg| {
        let id = arg.get_id().as_str();
        !arg.is_global_set() && !arg.is_hide_set() && id != "help" && id != "version"
    });
    let own: Vec<&Arg> = own.collect();
    if !own.is_empty() {
        page.push('\n');
        table(page, own.into_iter());
    }
    if let Some(after) = command.get_after_help() {
        let _ = write!(page, "\n```text\n{}\n```\n", after.to_string().trim());
    }
    for command in shown(command) {
        section(page, command, &name);
    }
}

fn table<'a>(page: &mut String, args: impl Iterator<Item = &'a Arg>) {
    page.push_str("| argument | meaning |\n|---|---|\n");
    for arg in args {
        let help = arg.get_help().map(ToString::to_string).unwrap_or_default();
        let values: Vec<String> = arg
            .get_possible_values()
            .iter()
            .map(|value| format!("`{}`", value.get_name()))
            .collect();
        let takes = arg.get_action().takes_values() && !values.is_empty();
        let values = if takes {
            format!(" ({})", values.join(", "))
        } else {
            String::new()
        };
        // A bar would end the cell.
        let meaning = format!("{help}{values}").replace('|', "\\|");
        let _ = writeln!(page, "| `{}` | {meaning} |", spelled(arg));
    }
}

/// How an argument is written: `-v, --verbose`, `--set KEY=VALUE`, `FILE`.
fn spelled(arg: &Arg) -> String {
    let value = arg.get_value_names().map(|names| {
        let names: Vec<&str> = names.iter().map(|name| name.as_str()).collect();
        names.join(" ")
    });
    let value = value.filter(|_| arg.get_action().takes_values());
    let short = arg.get_short().map(|short| format!("-{short}"));
    let long = arg.get_long().map(|long| format!("--{long}"));
    let flags: Vec<String> = [short, long].into_iter().flatten().collect();
    let flags = flags.join(", ");
    match (flags.is_empty(), value) {
        (true, value) => value.unwrap_or_else(|| arg.get_id().as_str().to_uppercase()),
        (false, Some(value)) => format!("{flags} {value}"),
        (false, None) => flags,
    }
}

#[test]
fn every_command_says_what_it_does_and_every_argument_what_it_means() {
    fn ask(command: &Command, path: &str) {
        let about = command.get_about().map(ToString::to_string);
        let about = about.unwrap_or_default();
        assert!(
            !about.is_empty() && !about.ends_with('.'),
            "{path}: {about:?}"
        );
        for arg in command.get_arguments() {
            assert!(arg.get_help().is_some(), "{path}: {}", arg.get_id());
        }
        for command in shown(command) {
            ask(command, &format!("{path} {}", command.get_name()));
        }
    }
    let mut cli = Cli::command();
    cli.build();
    ask(&cli, "ctos");
    ask(&scott::Cli::command(), "scott");
}

/// Every text of three parts with `::` between them in the sources of the crates, tests left out.
fn codes_in(folder: &Path, codes: &mut BTreeSet<String>) {
    for entry in fs::read_dir(folder).expect("a folder of sources") {
        let path = entry.expect("an entry").path();
        let name = path
            .file_name()
            .and_then(|name| name.to_str())
            .unwrap_or_default();
        if path.is_dir() && name != "tests" {
            codes_in(&path, codes);
        } else if name.ends_with(".rs") && name != "tests.rs" {
            let text = fs::read_to_string(&path).expect("a source");
            let code = text.split("\nmod tests {").next().unwrap_or_default();
            let found = code.split('"').filter(|word| is_code(word));
            codes.extend(found.map(str::to_owned));
        }
    }
}

fn is_code(word: &str) -> bool {
    let plain = |letter: char| matches!(letter, 'a'..='z' | '0'..='9' | '_');
    let parts: Vec<&str> = word.split("::").collect();
    parts.len() == 3
        && !["crate", "self", "super"].contains(&parts[0])
        && parts
            .iter()
            .all(|part| !part.is_empty() && part.chars().all(plain))
}

#[test]
fn every_code_has_an_explanation_and_every_explanation_a_code() {
    let mut codes = BTreeSet::new();
    for member in fs::read_dir(root()).expect("the workspace") {
        let member = member.expect("an entry").path();
        // A crate, or a folder of crates.
        let inner = fs::read_dir(&member).into_iter().flatten().flatten();
        for folder in inner.map(|entry| entry.path()).chain([member]) {
            let sources = folder.join("src");
            if sources.is_dir() {
                codes_in(&sources, &mut codes);
            }
        }
    }
    assert!(
        codes.contains("ctos::config::unknown_key"),
        "nothing was read"
    );
    let explained: Vec<&str> = explain::explanations().map(|(code, _)| code).collect();
    let explained_set: BTreeSet<String> = explained.iter().map(|code| (*code).to_owned()).collect();
    assert_eq!(
        explained.len(),
        explained_set.len(),
        "a code is explained twice"
    );
    let missing: Vec<_> = codes.difference(&explained_set).collect();
    let idle: Vec<_> = explained_set.difference(&codes).collect();
    assert!(
        missing.is_empty() && idle.is_empty(),
        "docs/diagnostics.md lacks {missing:?} and has nobody's {idle:?}"
    );
    for (code, text) in explain::explanations() {
        assert!(text.contains("\nDo: "), "{code} does not say what to do");
    }
}
