//! What a program may know about a class: its requests and its options, as data.
//!
//! From this come completion and hints in the inspector, panels, and the page of services. It is
//! made from the class's [`OptionTable`](crate::OptionTable) and from nothing else.

use crate::layout::Layout;
use serde::{Deserialize, Serialize};

/// One form of EXEC that a class understands, as it is written in the class's table.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Form {
    /// The text of the request: a literal word, a placeholder in capitals (`FILE`), or both (`camera
    /// NAME`). Empty when the request has no text.
    pub text: &'static str,
    /// How many floats go in; [`Form::ANY`] for any number of them.
    pub floats: usize,
    /// What these floats are, with units.
    pub takes: &'static str,
    /// What comes out, with units and shape.
    pub gives: &'static str,
    /// What the numbers are that come out, for programs that show them: a [`Layout`]; empty when they are not
    /// always the same.
    pub results: &'static str,
    /// What it does, in one line.
    pub help: &'static str,
}

impl Form {
    /// The count of floats where a request may have any number of them.
    pub const ANY: usize = usize::MAX;

    /// Whether the text stands for something else, for example a file.
    #[must_use]
    pub fn is_placeholder(&self) -> bool {
        self.text
            .starts_with(|first: char| first.is_ascii_uppercase())
    }

    /// Whether a request of this form has so many floats.
    pub(crate) fn takes_so_many(&self, floats: usize) -> bool {
        self.floats == floats || self.floats == Self::ANY
    }

    /// Whether the text of a request is of this form.
    pub(crate) fn is_of(&self, text: &str) -> bool {
        is_of(self.text, self.is_placeholder(), text)
    }
}

/// Whether the text of a request is of the form with that text.
fn is_of(form: &str, placeholder: bool, text: &str) -> bool {
    if placeholder {
        return !text.is_empty();
    }
    match form.split_once(' ') {
        Some((word, _)) => {
            let words = |text: &str| text.split_whitespace().count();
            text.split_whitespace().next() == Some(word) && words(text) >= words(form)
        }
        None => form == text,
    }
}

/// One form of EXEC, as data.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct FormInfo {
    /// The text of the request.
    pub text: String,
    /// Whether the text stands for something else, for example a file.
    pub placeholder: bool,
    /// How many floats go in; [`Form::ANY`] for any number of them.
    pub floats: usize,
    /// What these floats are, with units.
    pub takes: String,
    /// What comes out, with units and shape.
    pub gives: String,
    /// What the numbers are that come out, as a [`Layout`].
    #[serde(default)]
    pub results: String,
    /// What it does, in one line.
    pub help: String,
}

impl From<&Form> for FormInfo {
    fn from(form: &Form) -> Self {
        Self {
            text: form.text.to_owned(),
            placeholder: form.is_placeholder(),
            floats: form.floats,
            takes: form.takes.to_owned(),
            gives: form.gives.to_owned(),
            results: form.results.to_owned(),
            help: form.help.to_owned(),
        }
    }
}

impl FormInfo {
    /// Whether a request of this form has so many floats.
    #[must_use]
    pub fn takes_so_many(&self, floats: usize) -> bool {
        self.floats == floats || self.floats == Form::ANY
    }

    /// Whether the text of a request is of this form.
    #[must_use]
    pub fn is_of(&self, text: &str) -> bool {
        is_of(&self.text, self.placeholder, text)
    }

    /// What the numbers are that come out; nothing when it does not say.
    #[must_use]
    pub fn layout(&self) -> Layout {
        self.results.parse().unwrap_or_default()
    }
}

/// What kind of value an option has.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum OptionKind {
    /// On or off.
    Flag,
    /// A finite float.
    Float,
    /// A whole number.
    Int,
    /// A fixed count of floats.
    Floats,
    /// A fixed count of whole numbers.
    Ints,
    /// One of a few words.
    Choice,
    /// Any word.
    Word,
    /// No value: it does something and may answer.
    Action,
}

/// One option of a class, as data. Numbers are texts that CTRL takes.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct OptionInfo {
    /// Its name, without the dash.
    pub name: String,
    /// The kind of its value.
    pub kind: OptionKind,
    /// The names of what stands after it, where there are several or they have one (`W H`, `FILE`).
    pub parameters: Vec<String>,
    /// The unit of its numbers; empty for pure numbers and for other kinds.
    pub unit: String,
    /// The least and the largest number, both allowed.
    pub range: Option<[String; 2]>,
    /// The words that it takes, when they are few.
    pub choices: Vec<String>,
    /// What it is without a recipe; `None` for actions and for lists that are not set.
    pub default: Option<String>,
    /// What it means.
    pub help: String,
}

/// No word of a help is longer than so many characters.
const LONGEST_WORD: usize = 60;

impl OptionInfo {
    /// What stands after the option: `0.0..1.0 m/s`, `on|off`, `W H, each 1..65536 px`.
    #[must_use]
    pub fn form(&self) -> String {
        let mut parts = self.parameters.join(" ");
        if !self.choices.is_empty() {
            let text = self.choices.join("|");
            // A long list is to be broken between lines.
            match text.len() > LONGEST_WORD {
                true => parts.push_str(&self.choices.join(" | ")),
                false => parts.push_str(&text),
            }
        }
        if let Some([low, high]) = &self.range {
            if !self.choices.is_empty() {
                parts.push('|');
            } else if !parts.is_empty() {
                parts.push_str(", each ");
            }
            parts.push_str(&format!("{low}..{high}"));
        }
        if !self.unit.is_empty() {
            parts.push_str(&format!(" {}", self.unit));
        }
        parts
    }
}

/// A class, as data.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct ClassInfo {
    /// Its name.
    pub name: String,
    /// Its version.
    pub version: String,
    /// What it does, in one line.
    pub about: String,
    /// The forms of EXEC that it understands.
    pub forms: Vec<FormInfo>,
    /// Its options, `help` and `dump` left out: every class has them.
    pub options: Vec<OptionInfo>,
}

impl ClassInfo {
    /// The form of EXEC that a request with that text and so many floats has, as its object tells them apart.
    #[must_use]
    pub fn form(&self, text: &str, floats: usize) -> Option<&FormInfo> {
        let text = text.trim();
        let mut fitting = self.forms.iter().filter(|form| form.is_of(text));
        let counted = fitting.clone().find(|form| form.takes_so_many(floats));
        counted.or_else(|| fitting.next())
    }
}
