//! An app's configuration as it counts in the end: every value, also those that no file says, each
//! with where it comes from.

use super::app::{App, TaskConfig};
use super::node::{Entry, Node, Value};
use super::trail::Origin;
use super::variables::escaped;
use crate::diagnostic::Place;
use std::fmt::Write;
use toml_writer::{ToTomlKey, ToTomlValue, TomlKeyBuilder, TomlStringBuilder};

/// Where the comments of [`App::to_toml`] begin, in characters, when the line is not longer.
const COMMENT_COLUMN: usize = 44;

/// A value and where it comes from.
#[derive(Debug, Clone, PartialEq)]
pub struct ShownValue {
    /// Its dotted path; parts that are no bare keys are quoted.
    pub path: String,
    /// The value: a scalar, an array, or a table that is empty.
    pub value: Node,
    /// Where it comes from.
    pub origin: Origin,
}

impl App {
    /// Every value of the merged configuration with its origin, in the order of the files.
    #[must_use]
    pub fn values(&self) -> Vec<ShownValue> {
        let mut values = Vec::new();
        self.collect(&self.root, "", &mut values);
        values
    }

    fn collect(&self, table: &Node, path: &str, values: &mut Vec<ShownValue>) {
        for entry in table.entries() {
            let path = joined(path, &entry.key);
            if entry.value.entries().is_empty() {
                values.push(ShownValue {
                    path,
                    value: entry.value.clone(),
                    origin: self.origin(&entry.value),
                });
            } else {
                self.collect(&entry.value, &path, values);
            }
        }
    }

    /// The merged configuration as a TOML file that makes the same app by itself; a comment says of
    /// each value where it comes from.
    #[must_use]
    pub fn to_toml(&self) -> String {
        let mut text = format!("# {}", self.selection.file.display());
        for profile in &self.selection.profiles {
            let _ = write!(text, " --profile {profile}");
        }
        for set in &self.selection.sets {
            let _ = write!(text, " --set {}", set.escape_debug());
        }
        text.push('\n');
        self.write_table(&self.root, "", &mut text);
        let written = self.root.tables("task");
        let is_made = |task: &&TaskConfig| !written.iter().any(|entry| entry.key == task.name);
        let mut made = self.tasks.iter().filter(is_made).peekable();
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

    fn write_table(&self, table: &Node, path: &str, text: &mut String) {
        let entries = table.entries().iter();
        let (tables, values): (Vec<&Entry>, _) = entries.partition(|entry| entry.value.is_table());
        if !path.is_empty() && (!values.is_empty() || tables.is_empty()) {
            text.push('\n');
            self.write_line(&format!("[{path}]"), table, text);
        }
        for entry in values {
            let mut line = format!("{} = ", bare_or_quoted(&entry.key));
            write_value(&entry.value, &mut line);
            self.write_line(&line, &entry.value, text);
        }
        for entry in tables {
            self.write_table(&entry.value, &joined(path, &entry.key), text);
        }
    }

    fn write_line(&self, line: &str, value: &Node, text: &mut String) {
        let line_of = |place: &Place| {
            let (line, _) = place.source.line_column(place.range.start);
            format!("{}:{line}", place.source.name())
        };
        let origin = match self.origin(value) {
            Origin::Default => "default".to_owned(),
            Origin::File(place) => line_of(&place),
            Origin::Profile { name, place } => format!("profile {name}, {}", line_of(&place)),
            Origin::Set(_) => "--set".to_owned(),
        };
        let _ = writeln!(text, "{line:<COMMENT_COLUMN$} # {origin}");
    }
}

/// Writes a value as it can stand behind `key = `.
fn write_value(node: &Node, out: &mut String) {
    // Writing into a String cannot fail.
    let _ = match node.value() {
        Value::String(text) => write!(out, "{}", basic(&escaped(text))),
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

/// The value as JSON; NaN and infinite numbers become text, for JSON has none.
impl From<&Node> for serde_json::Value {
    fn from(node: &Node) -> Self {
        match node.value() {
            Value::String(text) | Value::Datetime(text) => text.as_str().into(),
            Value::Integer(number) => match (i64::try_from(*number), u64::try_from(*number)) {
                (Ok(number), _) => number.into(),
                (_, Ok(number)) => number.into(),
                _ => number.to_string().into(),
            },
            Value::Float(number) => serde_json::Number::from_f64(*number)
                .map_or_else(|| format!("{number}").into(), Self::Number),
            Value::Bool(value) => (*value).into(),
            Value::Array(elements) => elements.iter().map(Self::from).collect(),
            Value::Table(entries) => {
                let each = entries.iter();
                let each = each.map(|entry| (entry.key.clone(), Self::from(&entry.value)));
                Self::Object(each.collect())
            }
        }
    }
}
