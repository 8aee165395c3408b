//! An app's configuration as it counts in the end: every value, also those that no file says, each
//! with where it comes from.

use std::fmt::Write;

use ctos::{
    config::{App, Entry, Node, Origin, TaskConfig, Value},
    diagnostic::Place,
};
use toml_writer::{ToTomlKey, ToTomlValue, TomlKeyBuilder, TomlStringBuilder};

/// Where the comments of [`toml`] begin, in characters, when the line is not longer.
const COMMENT_COLUMN: usize = 44;

/// A value and where it comes from.
pub(super) struct Shown<'a> {
    /// Its dotted path; parts that are no bare keys are quoted.
    pub(super) path: String,
    /// The value: a scalar, an array, or a table that is empty.
    pub(super) value: &'a Node,
    /// Where it comes from.
    pub(super) origin: Origin,
}

/// Every value of the merged configuration with its origin, in the order of the files.
pub(super) fn values(app: &App) -> Vec<Shown<'_>> {
    let mut values = Vec::new();
    collect(app, app.root(), "", &mut values);
    values
}

fn collect<'a>(app: &App, table: &'a Node, path: &str, values: &mut Vec<Shown<'a>>) {
    for entry in table.entries() {
        let path = joined(path, &entry.key);
        if entry.value.entries().is_empty() {
            values.push(Shown {
                path,
                value: &entry.value,
                origin: app.origin(&entry.value),
            });
        } else {
            collect(app, &entry.value, &path, values);
        }
    }
}

/// The merged configuration as a TOML file that makes the same app by itself; a comment says of
/// each value where it comes from.
pub(super) fn toml(app: &App) -> String {
    toml_of(app, app.root())
}

pub(super) fn toml_of(app: &App, root: &Node) -> String {
    let mut text = format!("# {}", app.selection.file.display());
    for profile in &app.selection.profiles {
        let _ = write!(text, " --profile {profile}");
    }
    for set in &app.selection.sets {
        let _ = write!(text, " --set {}", set.escape_debug());
    }
    text.push('\n');
    write_table(app, root, "", &mut text);
    let written = root.get("task").map_or(&[][..], Node::entries);
    let is_made = |task: &&TaskConfig| !written.iter().any(|entry| entry.key == task.name);
    let mut made = app.tasks.iter().filter(is_made).peekable();
    if made.peek().is_some() {
        text.push_str("\n# Made from these tables:\n");
    }
    for task in made {
        let (name, handler) = (&task.name, &task.handler);
        let (chassis, processor) = (&task.chassis, &task.processor);
        let _ = writeln!(text, "# task {name}: {handler} on {chassis}/{processor}");
    }
    text
}

fn write_table(app: &App, table: &Node, path: &str, text: &mut String) {
    let is_table = |entry: &&Entry| matches!(entry.value.value(), Value::Table(_));
    let (tables, values): (Vec<&Entry>, _) = table.entries().iter().partition(is_table);
    if !path.is_empty() && (!values.is_empty() || tables.is_empty()) {
        text.push('\n');
        write_line(app, &format!("[{path}]"), table, text);
    }
    for entry in values {
        let mut line = format!("{} = ", bare_or_quoted(&entry.key));
        write_value(&entry.value, &mut line);
        write_line(app, &line, &entry.value, text);
    }
    for entry in tables {
        write_table(app, &entry.value, &joined(path, &entry.key), text);
    }
}

fn write_line(app: &App, line: &str, value: &Node, text: &mut String) {
    let line_of = |place: &Place| {
        let (line, _) = place.source.line_column(place.range.start);
        format!("{}:{line}", place.source.name())
    };
    let origin = match app.origin(value) {
        Origin::Default => "default".to_owned(),
        Origin::File(place) => line_of(&place),
        Origin::Profile { name, place } => format!("profile {name}, {}", line_of(&place)),
        Origin::Set(_) => "--set".to_owned(),
    };
    let _ = writeln!(text, "{line:<COMMENT_COLUMN$} # {origin}");
}

/// Writes a value as it can stand behind `key = `.
fn write_value(node: &Node, out: &mut String) {
    // Writing into a String cannot fail.
    let _ = match node.value() {
        // What would else be a variable of the environment.
        Value::String(text) => write!(out, "{}", basic(&text.replace("${", "$${"))),
        Value::Integer(number) => write!(out, "{number}"),
        Value::Float(number) if number.is_nan() => write!(out, "nan"),
        Value::Float(number) => write!(out, "{number:?}"),
        Value::Bool(value) => write!(out, "{value}"),
        Value::Datetime(text) => write!(out, "{text}"),
        Value::Array(elements) => {
            out.push('[');
            for (index, element) in elements.iter().enumerate() {
                out.push_str(if index > 0 { ", " } else { "" });
                write_value(element, out);
            }
            out.push(']');
            Ok(())
        }
        Value::Table(entries) => {
            out.push('{');
            for (index, entry) in entries.iter().enumerate() {
                out.push_str(if index > 0 { ", " } else { " " });
                let _ = write!(out, "{} = ", bare_or_quoted(&entry.key));
                write_value(&entry.value, out);
            }
            out.push_str(" }");
            Ok(())
        }
    };
}

/// A TOML basic string on one line.
fn basic(text: &str) -> String {
    TomlStringBuilder::new(text).as_basic().to_toml_value()
}

fn bare_or_quoted(key: &str) -> String {
    let builder = TomlKeyBuilder::new(key);
    match builder.as_unquoted() {
        Some(bare) => bare.to_toml_key(),
        None => builder.as_basic().to_toml_key(),
    }
}

fn joined(path: &str, key: &str) -> String {
    let key = bare_or_quoted(key);
    if path.is_empty() {
        key
    } else {
        format!("{path}.{key}")
    }
}
