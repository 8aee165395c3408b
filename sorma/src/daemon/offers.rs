//! What a daemon offers, as its configuration says it: `args.offers.scale = { arm = "left", price = 2 }`.

use crate::trade::Attributes;
use serde::Deserialize;
use std::collections::BTreeMap;

/// Classes with the attributes of what is offered.
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
