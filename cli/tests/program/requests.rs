//! The requests to service objects that stand in the documents are requests that their classes take. Which numbers an
//! object answers needs its app, its arm or its pictures, and is a matter of other tests.

use std::fs;

use cli::scott::services::CLASSES;
use sorma::ClassInfo;

use crate::{common::root, lines::pages};

/// What separates an explanation from the request before it.
const GAP: &str = "   ";

/// What is wrong with a line that asks an object; none for other lines.
fn wrong(line: &str) -> Option<String> {
    let request = line.split(GAP).next()?;
    let (name, rest) = request.split_once(' ')?;
    let (method, rest) = rest.split_once(' ')?;
    let mut class_name = name.split(['.', '@']).next()?.to_owned();
    // Capitals mean the default daemon.
    if !class_name.contains(|letter: char| letter.is_ascii_lowercase()) {
        class_name.make_ascii_lowercase();
    }
    let Some(class) = CLASSES.iter().find(|class| class.name == class_name) else {
        return Some(format!("there is no class {class_name}"));
    };
    match method {
        "EXEC" => wrong_form(class, rest),
        _ => wrong_option(class, rest),
    }
}

fn wrong_form(class: &ClassInfo, request: &str) -> Option<String> {
    let words: Vec<&str> = request.split_whitespace().collect();
    let numbers = words
        .iter()
        .position(|word| ["FMSG", "IMSG"].contains(word));
    let (text, numbers) = words.split_at(numbers.unwrap_or(words.len()));
    let text = text.join(" ");
    let floats = match numbers {
        ["FMSG", count, ..] => count.parse().ok(),
        _ => Some(0),
    };
    let text = text.trim_start_matches("TMSG").trim();
    // A variable brings its own count, and a model its own number of joints.
    let is_counted = !["kin", "dyn"].contains(&class.name.as_str());
    match (class.form(text, floats.unwrap_or(0)), floats) {
        (None, _) => Some(format!("{} has no EXEC {text}", class.name)),
        (Some(form), Some(floats)) if is_counted && !form.takes_so_many(floats) => Some(format!(
            "EXEC {text} of {} takes {} floats, not {floats}",
            class.name, form.floats
        )),
        _ => None,
    }
}

fn wrong_option(class: &ClassInfo, options: &str) -> Option<String> {
    let named = options.split_whitespace().filter_map(|word| {
        let name = word.strip_prefix('-')?;
        name.starts_with(|first: char| first.is_ascii_alphabetic())
            .then_some(name)
    });
    let known = |name: &&str| {
        let own = class.options.iter().any(|option| option.name == **name);
        own || ["help", "dump"].contains(name)
    };
    // A recipe that the dictionary is told stands in quotes, and belongs to another class.
    let quoted = options.contains('\'');
    let unknown = named.take(if quoted { 1 } else { usize::MAX });
    let unknown: Vec<&str> = unknown.filter(|name| !known(name)).collect();
    (!unknown.is_empty()).then(|| format!("{} has no {}", class.name, unknown.join(", ")))
}

#[test]
fn requests_to_objects_in_the_documents_are_requests_that_their_classes_take() {
    let mut found = Vec::new();
    let mut seen = 0;
    for page in pages() {
        let text = fs::read_to_string(root().join(&page)).unwrap();
        let mut fence = None;
        for (number, line) in text.lines().enumerate() {
            if let Some(kind) = line.strip_prefix("```") {
                fence = fence.is_none().then_some(kind);
            } else if fence == Some("text") && !line.contains(" | ") {
                let is_request = line
                    .split_whitespace()
                    .nth(1)
                    .is_some_and(|word| ["EXEC", "CTRL"].contains(&word));
                seen += usize::from(is_request);
                let wrong = wrong(line).filter(|_| is_request);
                found.extend(wrong.map(|wrong| format!("{page}:{}: {wrong}: {line}", number + 1)));
            }
        }
    }
    assert!(found.is_empty(), "{}", found.join("\n"));
    assert!(seen > 60, "{seen} requests");
}

#[test]
fn requests_that_no_class_takes_are_found() {
    for line in [
        "kinn EXEC fkine FMSG 6 0 0 0 0 0 0",
        "kin.puma560 EXEC fkyne FMSG 6 0 0 0 0 0 0",
        "mvpos EXEC arc FMSG 8 0 0 0 0 0 0 0 0",
        "mvpos CTRL -blent 0.5",
    ] {
        assert!(wrong(line).is_some(), "{line}");
    }
    assert_eq!(wrong("kin.puma560 EXEC fkine FMSG 6 0 0 0 0 0 0"), None);
}
