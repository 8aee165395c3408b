//! The programs take every command line in the README, the documents and the help. The files, tasks and breakpoints
//! of the shipped apps that it names exist. Those that need neither a running app nor minutes are run.

use std::{collections::BTreeSet, fs, path::Path, process::Command};

use crate::{
    common::{configurations, root},
    hello_example,
};
use clap::{CommandFactory, Parser, error::ErrorKind};
use cli::{
    commands::{
        Cli,
        breakpoints::{Breakpoints, Released},
    },
    program, scott,
};
use ctos::config::Selection;

/// A command line, and where it stands.
pub struct Line {
    pub place: String,
    pub words: Vec<String>,
    /// Whether it stands in running text, where what is left out is meant to be.
    pub in_text: bool,
}

impl Line {
    pub fn text(&self) -> String {
        format!("{}: {}", self.place, self.words.join(" "))
    }
}

/// The commands of a line of a shell, each as its words. Quotes are taken off and comments left out; what stands behind
/// a gap is an explanation.
fn commands(line: &str) -> Vec<Vec<String>> {
    let mut commands = vec![Vec::new()];
    let mut word: Option<String> = None;
    let mut quote = None;
    let mut skips = false;
    let mut letters = line.chars().chain([' ']).peekable();
    while let Some(letter) = letters.next() {
        match (quote, letter) {
            (Some(open), _) if letter == open => quote = None,
            (Some(_), _) => word.get_or_insert_default().push(letter),
            (None, '\'' | '"') => {
                quote = Some(letter);
                word.get_or_insert_default();
            }
            (None, '#') if word.is_none() => break,
            (None, '|') => commands.push(Vec::new()),
            (None, '&') => {}
            // A file of the shell.
            (None, '<' | '>') if word.is_none() => skips = true,
            (None, ' ') => {
                if let Some(word) = word.take()
                    && !std::mem::take(&mut skips)
                    && let Some(command) = commands.last_mut()
                {
                    command.push(word);
                }
                if letters.peek() == Some(&' ') {
                    break;
                }
            }
            (None, _) => word.get_or_insert_default().push(letter),
        }
    }
    commands
}

/// What lines of cargo begin with that build, measure or run something else than these two programs. Each says where
/// that is done, or why it is not.
const OF_CARGO: [(&str, &str); 14] = [
    ("cargo bench", "takes minutes, and an idle machine"),
    ("cargo build", "every test needs what it makes"),
    ("cargo doc", "tests/run makes the pages"),
    ("cargo test", "it runs this test"),
    ("cargo install zenohd", "takes minutes, and a network"),
    (
        "cargo run --release -p peers",
        "takes minutes, and an idle machine",
    ),
    (
        "cargo run --release -p cli --example picture",
        "makes pictures for documents by hand",
    ),
    (
        "cargo run --release -p sim --example peer",
        "sim/tests/remote.rs serves the same world",
    ),
    (
        "cargo run --release -p sim --example track",
        "tests/system/remote.rs tracks the same",
    ),
    (
        "cargo run -p sorma --example market",
        "sorma/tests/services/trading.rs calls it",
    ),
    ("cargo run --release --", "stands for `ctos`"),
    ("cargo run --release --bin scott --", "stands for `scott`"),
    ("cargo run --release", "stands for the program"),
    ("cargo run", "stands for the program"),
];

/// The words of a command of ours, without what runs it; none for that of another program.
fn ours(mut words: Vec<String>) -> Option<Vec<String>> {
    if words.first().is_some_and(|first| first == "cargo") {
        let rest = words.iter().position(|word| word == "--")?;
        let runs = words.get(1).is_some_and(|word| word == "run");
        let before = words.get(..rest)?;
        let others = ["peers", "picture", "peer", "track", "market"];
        let other = |word: &String| others.contains(&word.as_str());
        if !runs || rest + 1 == words.len() || before.iter().any(other) {
            return None;
        }
        let program = match before.iter().any(|word| word == "scott") {
            true => "scott",
            false => "ctos",
        };
        words.splice(..=rest, [program.to_owned()]);
    }
    let first = words.first()?;
    // A drawing has other signs, and a prompt of the inspector is none of a shell.
    let is_command = words
        .iter()
        .all(|word| !word.starts_with('─') && !word.ends_with("objects>"));
    (is_command && (first == "ctos" || first == "scott")).then_some(words)
}

/// The command lines of a page: those of its fenced blocks, and those in its text between single quotes.
fn lines_of(page: &str) -> Vec<Line> {
    let text = fs::read_to_string(root().join(page)).unwrap();
    let mut lines = Vec::new();
    let mut take = |number: usize, text: &str, in_text: bool| {
        for words in commands(text).into_iter().filter_map(ours) {
            let place = format!("{page}:{number}");
            lines.push(Line {
                place,
                words,
                in_text,
            });
        }
    };
    let mut prose = String::new();
    let mut fenced = false;
    let mut begun = String::new();
    for (number, line) in (1..).zip(text.lines()) {
        if line.trim_start().starts_with("```") {
            fenced = !fenced;
        } else if fenced {
            // A line that goes on in the next.
            if let Some(part) = line.strip_suffix(" \\") {
                begun.push_str(part);
                begun.push(' ');
                continue;
            }
            let line = std::mem::take(&mut begun) + line.trim_start();
            let line = line.trim_start();
            let line = line.strip_prefix("$ ").unwrap_or(line);
            // The forms of commands stand in brackets.
            if !line.contains("[OPTIONS]") && !line.contains('<') || line.contains("< ") {
                take(number, line, false);
            }
        } else {
            prose.push_str(line);
            prose.push(' ');
        }
    }
    for span in prose.split('`').skip(1).step_by(2) {
        let starts = ["ctos ", "scott ", "cargo run"];
        // What may be left out stands in brackets.
        if starts.iter().any(|start| span.starts_with(start)) && !span.contains('[') {
            take(0, &span.replace("FILE..", "FILE"), true);
        }
    }
    lines
}

pub fn lines() -> Vec<Line> {
    pages().iter().flat_map(|page| lines_of(page)).collect()
}

/// The pages for users.
pub fn pages() -> Vec<String> {
    let mut pages = vec!["README.md".to_owned(), "CONTRIBUTING.md".to_owned()];
    for entry in fs::read_dir(root().join("docs")).unwrap() {
        let name = entry.unwrap().file_name().into_string().unwrap();
        if name.ends_with(".md") {
            pages.push(format!("docs/{name}"));
        }
    }
    pages.sort();
    pages
}

#[test]
fn every_other_line_of_cargo_is_one_that_is_known_to_run_elsewhere_or_not_at_all() {
    let mut unknown = Vec::new();
    for page in pages() {
        let text = fs::read_to_string(root().join(&page)).unwrap();
        let in_text = text.split('`').skip(1).step_by(2);
        let in_blocks = text
            .lines()
            .map(|line| line.trim().trim_start_matches("$ "));
        for line in in_blocks
            .chain(in_text)
            .filter(|line| line.starts_with("cargo "))
        {
            let known = OF_CARGO.iter().any(|(start, _)| line.starts_with(start));
            if !known && commands(line).into_iter().filter_map(ours).count() == 0 {
                unknown.push(format!("{page}: {line}"));
            }
        }
    }
    assert!(unknown.is_empty(), "{}", unknown.join("\n"));
}

#[test]
fn every_command_line_is_one_that_the_programs_take() {
    let (mut wrong, mut count) = (Vec::new(), 0);
    for line in lines() {
        let command = match line.words.first().map(String::as_str) {
            Some("scott") => scott::Cli::command(),
            _ => Cli::command(),
        };
        let taken = command.try_get_matches_from(&line.words);
        count += 1;
        match taken.map_err(|error| (error.kind(), error)) {
            Ok(_) => {}
            Err((ErrorKind::DisplayHelp | ErrorKind::DisplayVersion, _)) => {}
            Err((
                ErrorKind::MissingRequiredArgument
                | ErrorKind::MissingSubcommand
                | ErrorKind::DisplayHelpOnMissingArgumentOrSubcommand,
                _,
            )) if line.in_text => {}
            // A place for a name or a number.
            Err((ErrorKind::ValueValidation | ErrorKind::InvalidValue, error))
                if line.in_text && error.to_string().contains(char::is_uppercase) => {}
            Err((_, error)) => wrong.push(format!("{}\n{error}", line.text())),
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
    assert!(count > 300, "only {count} command lines were found");
}

fn registry() -> ctos::registry::Registry {
    let mut registry = program::registry();
    hello_example::register(&mut registry);
    registry
}

/// What a line names of a shipped app and what is not there.
fn missing(line: &Line) -> Option<String> {
    let words = &line.words;
    let behind = |option: &str| {
        let place = words.iter().position(|word| word == option)?;
        words.get(place + 1)
    };
    for word in words {
        let Some(file) = word.strip_prefix("configs/") else {
            continue;
        };
        let there = match file.split_once('*') {
            Some((folder, ending)) => {
                fs::read_dir(root().join("configs").join(folder)).is_ok_and(|mut files| {
                    files.any(|file| {
                        file.is_ok_and(|file| file.file_name().to_string_lossy().ends_with(ending))
                    })
                })
            }
            None => root().join(word).exists(),
        };
        if !there {
            return Some(format!("there is no {word}"));
        }
    }
    // Nets that are named without their app are those of the calibration.
    let named = words.iter().find(|word| {
        word.starts_with("configs/")
            && word.ends_with(".toml")
            && !word.starts_with("configs/panels/")
    });
    let of_net = ["break", "fire", "put", "take", "cancel", "complete"];
    let by_hand = words.get(1).is_some_and(|word| word == "net")
        && words
            .get(2)
            .is_some_and(|word| of_net.contains(&word.as_str()));
    let calibrate = "configs/calibrate.toml".to_owned();
    let file = match named {
        Some(file) => file,
        None if by_hand || words.iter().any(|word| word.starts_with("dispatcher.")) => &calibrate,
        None => return None,
    };
    let selection = Selection::new(root().join(file));
    let app = match program::app(&selection) {
        Ok(app) => app,
        Err(findings) => return Some(findings.to_string()),
    };
    if let Some(task) = behind("--task")
        && app.task(task).is_none()
    {
        return Some(format!("{file} has no task {task}"));
    }
    let mut breaks: Vec<String> = behind("--break").cloned().into_iter().collect();
    if by_hand
        && let (Some(net), Some(place)) = (words.get(3), words.get(4))
        && !place.starts_with('-')
        && app.task(net).is_some()
    {
        // What is asked of it distinguishes the marking from a transition.
        let place = match words.get(2).map(String::as_str) {
            Some("put" | "take") => format!("{place}>=0"),
            _ => place.clone(),
        };
        breaks.push(format!("{net}.{place}"));
    }
    let sets = Breakpoints { breaks }.sets(&selection, &registry(), Released::Never);
    sets.err().map(|findings| findings.to_string())
}

#[test]
fn what_command_lines_name_of_the_shipped_apps_is_there() {
    let wrong: Vec<String> = lines()
        .iter()
        .filter_map(|line| Some(format!("{}: {}", line.text(), missing(line)?)))
        .collect();
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
    let broken = Line {
        place: String::new(),
        words: commands("ctos boot configs/calibrate.toml --break dispatcher.no_such").remove(0),
        in_text: false,
    };
    assert!(missing(&broken).is_some());
}

/// Whether a command of `ctos` ends by itself, soon, and needs nothing but the files of this folder.
pub fn is_run(words: &[String]) -> bool {
    let words: Vec<&str> = words.iter().map(String::as_str).collect();
    let shipped = || {
        let files = words
            .iter()
            .filter(|word| word.contains('.') && word.contains('/'));
        files.clone().count() > 0 && files.into_iter().all(|word| word.starts_with("configs/"))
    };
    match words.as_slice() {
        ["ctos", "explain" | "completions" | "doctor", ..] => true,
        ["ctos", "config", "defaults" | "schema", ..] => true,
        ["ctos", "sim", "--profiles"] => true,
        ["ctos", "keys", "new" | "list", ..] => true,
        ["ctos", "check", ..] | ["ctos", "config", "show", ..] => shipped(),
        [
            "ctos",
            "net",
            "check" | "perf" | "draw" | "convert" | "fmt",
            ..,
        ] => shipped(),
        ["scott", "--local", "-c", lines @ ..]
        | ["scott", "--local", "--json", "-c", lines @ ..] => {
            !lines.iter().any(|line| line.contains(".csv"))
        }
        _ => false,
    }
}

#[test]
fn command_lines_that_need_neither_an_app_nor_minutes_are_run_and_go_well() {
    let folder = configurations();
    // A command that makes something finds it made when it stands on two pages.
    let mut seen = BTreeSet::new();
    let mut wrong = Vec::new();
    for line in lines() {
        let in_text = line.in_text
            && line
                .words
                .iter()
                .any(|word| word.contains(char::is_uppercase));
        if in_text || !is_run(&line.words) || !seen.insert(line.words.clone()) {
            continue;
        }
        if let Some(why) = fails(folder.path(), &line.words) {
            wrong.push(format!("{}\n{why}", line.text()));
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
    assert!(seen.len() > 30, "only {} were run", seen.len());
}

/// Why a command does not go well; missing arguments in running text are no reason.
fn fails(folder: &Path, words: &[String]) -> Option<String> {
    let program = match words.first().map(String::as_str) {
        Some("scott") => env!("CARGO_BIN_EXE_scott"),
        _ => env!("CARGO_BIN_EXE_ctos"),
    };
    if program.ends_with("ctos") && Cli::try_parse_from(words).is_err() {
        return None;
    }
    let mut arguments = Vec::new();
    for word in words.iter().skip(1) {
        match word.split_once('*') {
            // As the shell does.
            Some((start, end)) if start.starts_with("configs/") => {
                let mut files: Vec<String> = fs::read_dir(folder.join(start))
                    .unwrap()
                    .map(|file| format!("{start}{}", file.unwrap().file_name().to_string_lossy()))
                    .filter(|file| file.ends_with(end))
                    .collect();
                files.sort();
                arguments.extend(files);
            }
            _ => arguments.push(word.clone()),
        }
    }
    let output = Command::new(program)
        .args(&arguments)
        .current_dir(folder)
        .env("NO_COLOR", "1")
        .output()
        .unwrap();
    let told = String::from_utf8_lossy(&output.stderr);
    let made = told.contains("exists already");
    (!output.status.success() && !made).then(|| format!("{}: {told}", output.status))
}
