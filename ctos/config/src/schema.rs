//! The JSON schema of a configuration file, for editors: draft-07, which those for TOML read.

use super::check::parsed;
use super::keys::{self, Key, Kind, TABLES, TOP};
use serde_json::{Map, Value, json};

/// The schema of a file whose top level also holds these tables, which belong to expanders.
///
/// Nothing is required in it: what one file leaves out, another that includes it may say.
#[must_use]
pub fn schema(expanders: &[&str]) -> Value {
    let mut definitions = Map::new();
    for table in TABLES.iter().filter(|table| table.path != TOP) {
        definitions.insert(table.path.to_owned(), closed(properties(table.keys)));
    }
    let mut top = properties(keys::table(TOP));
    for table in expanders {
        let free = json!({
            "type": "object",
            "description": "Makes tasks; its keys are read by what makes them.",
        });
        top.insert((*table).to_owned(), free);
    }
    let mut profile = top.clone();
    profile.remove("include");
    profile.remove("profile");
    definitions.insert("profile".to_owned(), closed(profile));
    let mut schema = closed(top);
    schema["$schema"] = json!("http://json-schema.org/draft-07/schema#");
    schema["title"] = json!("Configuration of a CTOS app");
    schema["definitions"] = Value::Object(definitions);
    schema
}

/// A table that has no keys but these.
fn closed(properties: Map<String, Value>) -> Value {
    json!({ "type": "object", "properties": properties, "additionalProperties": false })
}

fn properties(keys: &[Key]) -> Map<String, Value> {
    let property = |key: &Key| (key.name.to_owned(), property(key));
    keys.iter().map(property).collect()
}

fn property(key: &Key) -> Value {
    let mut property = of_kind(&key.kind);
    property["description"] = json!(key.doc);
    if let Some(default) = key.default.and_then(parsed) {
        property["default"] = Value::from(&default);
    }
    property
}

fn of_kind(kind: &Kind) -> Value {
    match kind {
        Kind::Text | Kind::Address(_) => json!({ "type": "string", "minLength": 1 }),
        // A reference to a variable may stand for any of the words.
        Kind::Choice(words) => json!({
            "anyOf": [{ "enum": words }, { "type": "string", "pattern": "\\$\\{" }],
        }),
        Kind::Flag => json!({ "type": "boolean" }),
        Kind::FlagOr(word) => json!({
            "anyOf": [{ "type": "boolean" }, { "enum": [word] }],
        }),
        Kind::Integer(least, most) => {
            json!({ "type": "integer", "minimum": least, "maximum": most })
        }
        Kind::Number(least, most) => {
            json!({ "type": "number", "minimum": least, "maximum": most })
        }
        Kind::Seconds(most) => json!({ "type": "number", "exclusiveMinimum": 0, "maximum": most }),
        Kind::Texts(_) => json!({ "type": "array", "items": { "type": "string" } }),
        // Beside a reference draft-07 reads nothing else, so the description stands outside of it.
        Kind::One(path) => json!({ "allOf": [reference(path)] }),
        Kind::Named(path) => named(path),
        Kind::Profiles => named("profile"),
        Kind::Free => json!({ "type": "object" }),
    }
}

fn named(definition: &str) -> Value {
    json!({
        "type": "object",
        "propertyNames": { "pattern": "^[A-Za-z0-9_.-]{1,64}$" },
        "additionalProperties": reference(definition),
    })
}

fn reference(definition: &str) -> Value {
    json!({ "$ref": format!("#/definitions/{definition}") })
}
