//! What the reader knows, the list of keys, the defaults, the reference page and the schema agree.

use super::*;
use crate::diagnostic::Severity;
use crate::keys::{Kind, PROCESSOR, TABLES, TOP, table};

const PAGE: &str = include_str!("../../../../docs/configuration.md");
const NOBODYS_KEY: &str = "zzzzzzzzzzzzzzzzzzzzzzzzzzzzzz";

/// The keys of a table as the list has them, sorted.
fn listed(path: &str) -> Vec<&'static str> {
    let mut names: Vec<_> = table(path).iter().map(|key| key.name).collect();
    names.sort_unstable();
    names
}

#[test]
fn the_reader_knows_the_listed_keys_and_no_others() {
    for table in TABLES {
        let path = table.path.replace("NAME", "w");
        let header = if path == TOP {
            String::new()
        } else {
            format!("[{path}]\n")
        };
        let text = format!(
            "{header}{NOBODYS_KEY} = 1\n[task.a]\nhandler = \"h\"\non = \"c\"\n[chassis.c]\n"
        );
        // The reader of the table lists all keys that it knows when none is similar.
        let lines = refused(load_one(&text));
        let of_key = lines.iter().find(|line| line.contains(NOBODYS_KEY));
        let known = of_key.and_then(|line| line.split_once("known here: "));
        let known = known.unwrap_or_else(|| panic!("[{path}]: {lines:?}")).1;
        let known: Vec<_> = known.trim_end_matches(')').split(", ").collect();
        assert_eq!(known, listed(table.path), "in [{}]", table.path);
    }
}

/// A key of `defaults.toml`: its name, its value, and whether it is more than a comment.
type DefaultKey = (String, String, bool);

/// The tables of `defaults.toml`: each header with its keys.
fn defaults() -> Vec<(String, Vec<DefaultKey>)> {
    let mut tables = vec![(String::new(), Vec::new())];
    for line in DEFAULTS.lines() {
        if let Some(header) = line.strip_prefix('[') {
            tables.push((header.trim_end_matches(']').to_owned(), Vec::new()));
        }
        let (live, line) = match line.strip_prefix("# ") {
            Some(comment) => (false, comment),
            None => (true, line),
        };
        if let Some((key, value)) = line.split_once(" = ")
            && key
                .chars()
                .all(|letter| letter.is_ascii_lowercase() || letter == '_')
            && let Some((_, keys)) = tables.last_mut()
        {
            keys.push((key.to_owned(), value.to_owned(), live));
        }
    }
    tables
}

#[test]
fn the_defaults_file_has_the_listed_keys_with_their_defaults() {
    let defaults = defaults();
    for table in TABLES {
        let path = table.path.replace("processors.NAME", "processors.main");
        let (_, keys) = defaults
            .iter()
            .find(|(header, _)| *header == path)
            .unwrap_or_else(|| panic!("no [{path}]"));
        let values = table.keys.iter().filter(|key| {
            !matches!(
                key.kind,
                Kind::One(_) | Kind::Named(_) | Kind::Profiles | Kind::Free
            )
        });
        let mut expected: Vec<_> = values.map(|key| (key.name, key.default)).collect();
        expected.sort_unstable();
        let mut found: Vec<_> = keys
            .iter()
            .map(|(key, value, live)| {
                let needed = ["handler", "on", "agent"].contains(&key.as_str());
                (key.as_str(), (*live && !needed).then_some(value.as_str()))
            })
            .collect();
        found.sort_unstable();
        assert_eq!(found, expected, "in [{path}]");
    }
}

#[test]
fn the_reference_page_has_a_row_for_every_listed_key_and_no_other() {
    let sections: Vec<&str> = PAGE.split("\n### ").skip(1).collect();
    for table in TABLES {
        let title = match table.path {
            TOP => "Top level".to_owned(),
            path => format!("`[{path}]`"),
        };
        let section = sections
            .iter()
            .find(|section| section.starts_with(&title))
            .unwrap_or_else(|| panic!("no section {title}"));
        let rows = section.lines().filter_map(|line| line.strip_prefix("| `"));
        let mut rows: Vec<_> = rows.filter_map(|row| row.split('`').next()).collect();
        rows.sort_unstable();
        let mut expected = listed(table.path);
        if table.path == TOP {
            // Tables have sections of their own.
            expected.retain(|key| *key == "include");
        }
        assert_eq!(rows, expected, "in section {title}");
    }
}

/// The schema, ready to judge.
struct Validator {
    schemas: boon::Schemas,
    schema: boon::SchemaIndex,
}

fn validator() -> Validator {
    let mut compiler = boon::Compiler::new();
    compiler.set_default_draft(boon::Draft::V7);
    compiler.add_resource("schema", schema(&["vss"])).unwrap();
    let mut schemas = boon::Schemas::new();
    let schema = compiler.compile("schema", &mut schemas).unwrap();
    Validator { schemas, schema }
}

/// What the schema says to a TOML text.
fn accepts(validator: &Validator, text: &str) -> bool {
    let mut findings = Findings::new();
    let node = Node::from_toml(&Source::new("a.toml", text), &mut findings);
    assert!(findings.is_empty(), "{findings}");
    let value = serde_json::Value::from(&node);
    validator.schemas.validate(&value, validator.schema).is_ok()
}

#[test]
fn the_schema_accepts_what_the_reader_accepts() {
    let validator = validator();
    let profiles = "[profile.sim.time]\nmode = \"virtual\"\n[profile.sim.task.mcs]\nqueue = 3\n[profile.sim.vss]\nx = 1\n";
    let variable = "[time]\nmode = \"${MODE:-virtual}\"\n";
    for text in [
        DEFAULTS,
        CELL,
        PAGE.split("```toml")
            .nth(1)
            .and_then(|rest| rest.split("```").next())
            .unwrap(),
        &format!("{CELL}{profiles}{variable}[vss]\nservices = []\n"),
        "",
    ] {
        assert!(accepts(&validator, text), "{text}");
    }
}

/// The codes of the errors that the reader finds in the last line of a table.
fn errors_in(header: &str, line: &str) -> Vec<&'static str> {
    let text = format!("{header}{line}\n");
    let last = text.lines().count();
    let Err(findings) = load_one(&text) else {
        return Vec::new();
    };
    let in_line = |finding: &&Finding| {
        let place = finding.place.as_ref();
        let line = place.map(|place| place.source.line_column(place.range.start).0);
        finding.severity == Severity::Error && line == Some(last)
    };
    findings
        .iter()
        .filter(in_line)
        .map(|one| one.code)
        .collect()
}

#[test]
fn the_schema_and_the_reader_refuse_the_same_keys_and_values() {
    let validator = validator();
    for table in TABLES {
        let path = table.path.replace("NAME", "w");
        let header = if path == TOP {
            String::new()
        } else {
            format!("[{path}]\n")
        };
        let refused = |line: &str| {
            let text = format!("{header}{line}\n");
            assert!(!accepts(&validator, &text), "schema: [{path}] {line}");
            assert!(
                !errors_in(&header, line).is_empty(),
                "reader: [{path}] {line}"
            );
        };
        refused("zzz = 1");
        if path != TOP {
            assert!(
                !accepts(&validator, &format!("[profile.p.{path}]\nzzz = 1\n")),
                "[{path}]"
            );
        }
        for key in table.keys {
            let name = key.name;
            let mut wrong: Vec<String> = match key.kind {
                Kind::Text | Kind::Address(_) => vec!["3", "\"\"", "[]"],
                Kind::Choice(_) => vec!["3", "\"zzz\""],
                Kind::Flag | Kind::FlagOr(_) => vec!["1", "\"true\""],
                Kind::Integer(0, _) => vec!["-1", "1.5", "\"1\""],
                Kind::Integer(..) => vec!["0", "1.5", "\"1\""],
                Kind::Number(..) => vec!["-1", "1.5", "\"1\""],
                Kind::Seconds(_) => vec!["0", "-1.0", "1e9", "\"1\""],
                Kind::Texts(_) => vec!["3", "[3]"],
                Kind::One(_) | Kind::Named(_) | Kind::Profiles | Kind::Free => vec!["3", "[]"],
            }
            .into_iter()
            .map(str::to_owned)
            .collect();
            let mut right = Vec::new();
            match key.kind {
                Kind::Integer(least, most) => {
                    right.extend([least.to_string(), most.to_string()]);
                    wrong.extend(most.checked_add(1).map(|above| above.to_string()));
                }
                Kind::Number(least, most) => {
                    right.extend([format!("{least:?}"), format!("{most:?}")]);
                    wrong.push(format!("{:?}", most + 0.01));
                }
                Kind::Seconds(most) => {
                    right.extend(["1e-9".to_owned(), format!("{most:?}")]);
                    wrong.push(format!("{:?}", most + 0.01));
                }
                Kind::Choice(words) => {
                    right.extend(words.iter().map(|word| format!("{word:?}")));
                }
                Kind::Flag => right.push("true".to_owned()),
                Kind::FlagOr(word) => right.extend(["true".to_owned(), format!("{word:?}")]),
                _ => {}
            }
            for value in wrong {
                refused(&format!("{name} = {value}"));
            }
            for value in right {
                let line = format!("{name} = {value}");
                let text = format!("{header}{line}\n");
                assert!(accepts(&validator, &text), "schema: [{path}] {line}");
                let errors = errors_in(&header, &line);
                // What does not fit to the rest of the app is another matter.
                let value = |code: &&str| {
                    ["ctos::config::value", "ctos::config::unknown_choice"].contains(code)
                };
                assert!(!errors.iter().any(value), "reader: [{path}] {line}");
            }
        }
    }
    let processors = PROCESSOR.replace("NAME", "\"a b\"");
    assert!(!accepts(&validator, &format!("[{processors}]\n")));
}

#[test]
fn a_default_in_the_schema_is_what_an_app_gets() {
    let schema = schema(&[]);
    let seed = &schema["definitions"]["app"]["properties"]["seed"]["default"];
    assert_eq!(*seed, load_one(CELL).unwrap().seed);
    let queue = &schema["definitions"]["task.NAME"]["properties"]["queue"]["default"];
    assert_eq!(*queue, load_one(CELL).unwrap().tasks[0].queue);
}
