//! What the configuration of a daemon says.

use crate::dictionary::Dictionary;
use crate::trade::Attributes;
use ctos::config::{App, TaskConfig};
use ctos::diagnostic::Findings;
use serde::Deserialize;
use std::collections::BTreeMap;

/// The handler's name, as configurations write it.
pub const HANDLER: &str = "sorma.daemon";

/// Arguments of the handler.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Arguments {
    /// Files of the dictionary, the later ones over the earlier.
    #[serde(default)]
    pub(super) dictionary: Vec<String>,
    /// By which number, besides its name, it is found on its host: `foo.a@host:11`.
    #[serde(default)]
    pub(super) number: Option<u32>,
    /// What it offers in trades, by class.
    #[serde(default)]
    pub(super) offers: Offers,
}

/// Checks the arguments before anything starts, and reads the dictionaries that they name.
pub(super) fn check(arguments: &Arguments, task: &TaskConfig, app: &App, findings: &mut Findings) {
    for (number, file) in arguments.dictionary.iter().enumerate() {
        let place = task.args.locate(&format!("dictionary.{number}"));
        let source = app.read(file).map_err(|finding| finding.at(place));
        if let Some(source) = findings.keep(source)
            && let Err(found) = Dictionary::new().load(&source)
        {
            findings.extend(found);
        }
    }
}

/// Classes with the attributes of what is offered: `args.offers.scale = { arm = "left", price = 2 }`.
#[derive(Debug, Clone, Default, Deserialize)]
#[serde(transparent)]
pub(super) struct Offers(BTreeMap<String, BTreeMap<String, Attribute>>);

#[derive(Debug, Clone, Deserialize)]
#[serde(untagged)]
enum Attribute {
    Flag(bool),
    Int(i64),
    Float(f64),
    Text(String),
}

impl Offers {
    pub(super) fn read(self) -> impl Iterator<Item = (String, Attributes)> {
        self.0.into_iter().map(|(class, attributes)| {
            let attributes = attributes.into_iter();
            let attributes = attributes.map(|(name, value)| (name, value.text()));
            (class, attributes.collect())
        })
    }
}

impl Attribute {
    fn text(self) -> String {
        match self {
            Self::Flag(flag) => flag.to_string(),
            Self::Int(int) => int.to_string(),
            Self::Float(float) => float.to_string(),
            Self::Text(text) => text,
        }
    }
}
