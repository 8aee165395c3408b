//! The kinds of option: how each reads its words, shows its value and describes itself.

use super::{begins_option, clipped};
use crate::description::{OptionInfo, OptionKind};
use crate::name::suggestion;
use crate::words::{self, Word};
use std::fmt::Debug;
use std::ops::RangeInclusive;
use std::str::FromStr;

pub(super) type Field<T, V> = fn(&mut T) -> &mut V;
pub(super) type Act<T> = fn(&mut T, &[String]) -> Result<String, String>;

/// Among the parameters of an option with floats: it takes as many as come before the next option, at least one.
const MANY: &str = "..";

/// One or several numbers within a range.
#[derive(Clone)]
pub(super) struct Numbers<N> {
    pub range: RangeInclusive<N>,
    pub unit: &'static str,
}

/// What an action does with its words.
type BoundAct<'a> = Box<dyn FnOnce(&[String]) -> Result<String, String> + 'a>;

/// An option and its value in one state.
pub(super) enum Bound<'a> {
    Flag(&'a mut bool),
    Float(&'a mut f64, Numbers<f64>),
    Int(&'a mut i64, Numbers<i64>),
    IntOr(&'a mut String, &'static str, Numbers<i64>),
    Floats(&'a mut Vec<f64>, &'static [&'static str], Numbers<f64>),
    Ints(&'a mut Vec<i64>, &'static [&'static str], Numbers<i64>),
    Choice(&'a mut String, &'static [&'static str]),
    Word(&'a mut String, &'static str),
    Action(&'static [&'static str], BoundAct<'a>),
}

impl Bound<'_> {
    /// How many words the option takes of those that come after it.
    pub(super) fn count(&self, rest: &[Word]) -> usize {
        match self {
            Self::Flag(_) => {
                let next = rest.first().map(|word| word.text.as_str());
                usize::from(matches!(next, Some("on" | "off")))
            }
            Self::Floats(_, parameters, _) if parameters.contains(&MANY) => {
                let own = rest.iter().take_while(|word| !begins_option(word));
                own.count().max(1)
            }
            Self::Floats(_, parameters, _)
            | Self::Ints(_, parameters, _)
            | Self::Action(parameters, _) => parameters.len(),
            _ => 1,
        }
    }

    /// What stands after the option in the help.
    pub(super) fn form(&self) -> String {
        let form = self.describe("", "").form();
        match self {
            Self::Flag(_) => format!(" [{form}]"),
            _ => spaced(&form),
        }
    }

    /// The value as CTRL takes it; `None` for actions and for lists that are not set.
    pub(super) fn shown(&self) -> Option<String> {
        match self {
            Self::Flag(value) => Some(if **value { "on" } else { "off" }.to_owned()),
            Self::Float(value, _) => Some(format!("{value:?}")),
            Self::Int(value, _) => Some(value.to_string()),
            Self::Floats(values, ..) => many(values),
            Self::Ints(values, ..) => many(values),
            Self::Choice(value, _) | Self::Word(value, _) | Self::IntOr(value, ..) => {
                Some(words::word(value))
            }
            Self::Action(..) => None,
        }
    }

    /// Sets the value from as many words as the option takes.
    pub(super) fn set(self, words: &[String]) -> Result<Option<String>, String> {
        let word = words.first().map_or("", String::as_str);
        match self {
            Self::Flag(value) => *value = word != "off",
            Self::Float(value, numbers) => *value = numbers.read(word, "")?,
            Self::Int(value, numbers) => *value = numbers.read(word, "")?,
            Self::IntOr(value, none, numbers) => {
                if word != none {
                    numbers.read(word, &format!("must be `{none}`, or it "))?;
                }
                word.clone_into(value);
            }
            Self::Floats(values, names, numbers) => *values = numbers.read_all(words, names)?,
            Self::Ints(values, names, numbers) => *values = numbers.read_all(words, names)?,
            Self::Choice(value, choices) => {
                if !choices.contains(&word) {
                    let hint = suggestion(word, choices.iter().copied());
                    return Err(format!(
                        "must be one of {}, not `{}`{hint}",
                        choices.join(", "),
                        clipped(word)
                    ));
                }
                word.clone_into(value);
            }
            Self::Word(value, _) => word.clone_into(value),
            Self::Action(_, act) => return act(words).map(Some),
        }
        Ok(None)
    }

    /// What a program may know about the option; the state is one without a recipe.
    pub(super) fn describe(&self, name: &str, help: &str) -> OptionInfo {
        let one;
        let (kind, parameters, choices, limits): (_, &[&str], &[&str], _) = match self {
            Self::Flag(_) => (OptionKind::Flag, &[], &["on", "off"], None),
            Self::Float(_, numbers) => (OptionKind::Float, &[], &[], Some(numbers.limits())),
            Self::Int(_, numbers) => (OptionKind::Int, &[], &[], Some(numbers.limits())),
            Self::IntOr(_, word, numbers) => {
                one = [*word];
                (OptionKind::Int, &[], &one, Some(numbers.limits()))
            }
            Self::Floats(_, names, numbers) => {
                (OptionKind::Floats, names, &[], Some(numbers.limits()))
            }
            Self::Ints(_, names, numbers) => (OptionKind::Ints, names, &[], Some(numbers.limits())),
            Self::Choice(_, choices) => (OptionKind::Choice, &[], choices, None),
            Self::Word(_, what) => {
                one = [*what];
                (OptionKind::Word, &one, &[], None)
            }
            Self::Action(names, _) => (OptionKind::Action, names, &[], None),
        };
        let owned = |names: &[&str]| names.iter().map(|name| (*name).to_owned()).collect();
        let (range, unit) = limits.unzip();
        OptionInfo {
            name: name.to_owned(),
            kind,
            parameters: owned(parameters),
            unit: unit.unwrap_or_default().to_owned(),
            range,
            choices: owned(choices),
            default: self.shown(),
            help: help.to_owned(),
        }
    }
}

/// A number that an option can take.
pub(super) trait Number: Copy + Debug + FromStr + PartialOrd {
    /// What it is called in reports.
    const CALLED: &'static str;
}

impl Number for f64 {
    const CALLED: &'static str = "a number";
}

impl Number for i64 {
    const CALLED: &'static str = "a whole number";
}

impl<N: Number> Numbers<N> {
    /// Reads one word; `called` names it in the report when there are several.
    fn read(&self, word: &str, called: &str) -> Result<N, String> {
        // A NaN is in no range.
        let number = word.parse().ok();
        number
            .filter(|number| self.range.contains(number))
            .ok_or_else(|| {
                format!(
                    "{called}must be {} from {:?} to {:?}{}, not `{}`",
                    N::CALLED,
                    self.range.start(),
                    self.range.end(),
                    spaced(self.unit),
                    clipped(word)
                )
            })
    }

    fn read_all(&self, words: &[String], names: &[&str]) -> Result<Vec<N>, String> {
        let named = words.iter().enumerate().map(|(index, word)| {
            let name = match names.get(index) {
                Some(name) if !names.contains(&MANY) => (*name).to_owned(),
                _ => format!("number {}", index + 1),
            };
            self.read(word, &format!("{name} "))
        });
        named.collect()
    }

    /// The least and the largest, as texts, and the unit.
    fn limits(&self) -> ([String; 2], &'static str) {
        let (low, high) = (self.range.start(), self.range.end());
        ([format!("{low:?}"), format!("{high:?}")], self.unit)
    }
}

fn many<N: Debug>(values: &[N]) -> Option<String> {
    let values: Vec<String> = values.iter().map(|value| format!("{value:?}")).collect();
    (!values.is_empty()).then(|| values.join(" "))
}

fn spaced(unit: &str) -> String {
    if unit.is_empty() {
        String::new()
    } else {
        format!(" {unit}")
    }
}
