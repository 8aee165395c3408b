//! The kinds of option: how each reads its words, shows its value and describes itself.

use super::clipped;
use crate::description::{OptionInfo, OptionKind};
use crate::name::suggestion;
use crate::words;
use std::fmt::Debug;
use std::ops::RangeInclusive;
use std::str::FromStr;

pub(super) type Field<T, V> = fn(&mut T) -> &mut V;
pub(super) type Act<T> = fn(&mut T, &[String]) -> Result<String, String>;

/// One or several numbers within a range.
pub(super) struct Numbers<N> {
    pub range: RangeInclusive<N>,
    pub unit: &'static str,
}

pub(super) enum Kind<T> {
    Flag(Field<T, bool>),
    Float(Field<T, f64>, Numbers<f64>),
    Int(Field<T, i64>, Numbers<i64>),
    /// A whole number or one word that stands for none, kept as its text.
    IntOr(Field<T, String>, &'static str, Numbers<i64>),
    Floats(Field<T, Vec<f64>>, &'static [&'static str], Numbers<f64>),
    Ints(Field<T, Vec<i64>>, &'static [&'static str], Numbers<i64>),
    Choice(Field<T, String>, &'static [&'static str]),
    Word(Field<T, String>, &'static str),
    Action(&'static [&'static str], Act<T>),
}

impl<T> Kind<T> {
    /// The option at one state. What is done with it knows no `T`, and so is compiled once.
    pub(super) fn at<'a>(&'a self, state: &'a mut T) -> Bound<'a> {
        match self {
            Self::Flag(field) => Bound::Flag(field(state)),
            Self::Float(field, numbers) => Bound::Float(field(state), numbers),
            Self::Int(field, numbers) => Bound::Int(field(state), numbers),
            Self::IntOr(field, none, numbers) => Bound::IntOr(field(state), none, numbers),
            Self::Floats(field, names, numbers) => Bound::Floats(field(state), names, numbers),
            Self::Ints(field, names, numbers) => Bound::Ints(field(state), names, numbers),
            Self::Choice(field, choices) => Bound::Choice(field(state), choices),
            Self::Word(field, what) => Bound::Word(field(state), what),
            Self::Action(names, act) => {
                Bound::Action(names, Box::new(move |words| act(state, words)))
            }
        }
    }
}

/// What an action does with its words.
type BoundAct<'a> = Box<dyn FnOnce(&[String]) -> Result<String, String> + 'a>;

/// An option and its value in one state.
pub(super) enum Bound<'a> {
    Flag(&'a mut bool),
    Float(&'a mut f64, &'a Numbers<f64>),
    Int(&'a mut i64, &'a Numbers<i64>),
    IntOr(&'a mut String, &'static str, &'a Numbers<i64>),
    Floats(&'a mut Vec<f64>, &'static [&'static str], &'a Numbers<f64>),
    Ints(&'a mut Vec<i64>, &'static [&'static str], &'a Numbers<i64>),
    Choice(&'a mut String, &'static [&'static str]),
    Word(&'a mut String, &'static str),
    Action(&'static [&'static str], BoundAct<'a>),
}

impl Bound<'_> {
    /// How many words the option takes, when `next` comes after it.
    pub(super) fn count(&self, next: Option<&str>) -> usize {
        match self {
            Self::Flag(_) => usize::from(matches!(next, Some("on" | "off"))),
            Self::Floats(_, parameters, _)
            | Self::Ints(_, parameters, _)
            | Self::Action(parameters, _) => parameters.len(),
            _ => 1,
        }
    }

    /// What stands after the option in the help.
    pub(super) fn form(&self) -> String {
        match self {
            Self::Flag(_) => " [on|off]".to_owned(),
            Self::Float(_, numbers) => format!(" {}", numbers.span()),
            Self::Int(_, numbers) => format!(" {}", numbers.span()),
            Self::IntOr(_, word, numbers) => format!(" {word}|{}", numbers.span()),
            Self::Floats(_, parameters, numbers) => {
                format!("{}, each {}", listed(parameters), numbers.span())
            }
            Self::Ints(_, parameters, numbers) => {
                format!("{}, each {}", listed(parameters), numbers.span())
            }
            Self::Choice(_, choices) => format!(" {}", choices.join("|")),
            Self::Word(_, what) => format!(" {what}"),
            Self::Action(parameters, _) => listed(parameters),
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
        let owned = |names: &[&str]| names.iter().map(|name| (*name).to_owned()).collect();
        let mut info = OptionInfo {
            name: name.to_owned(),
            kind: OptionKind::Flag,
            parameters: Vec::new(),
            unit: String::new(),
            range: None,
            choices: Vec::new(),
            default: self.shown(),
            help: help.to_owned(),
        };
        match self {
            Self::Flag(_) => info.choices = owned(&["on", "off"]),
            Self::Float(_, numbers) => {
                info.kind = OptionKind::Float;
                numbers.describe(&mut info);
            }
            Self::Int(_, numbers) => {
                info.kind = OptionKind::Int;
                numbers.describe(&mut info);
            }
            Self::IntOr(_, word, numbers) => {
                (info.kind, info.choices) = (OptionKind::Int, owned(&[word]));
                numbers.describe(&mut info);
            }
            Self::Floats(_, parameters, numbers) => {
                (info.kind, info.parameters) = (OptionKind::Floats, owned(parameters));
                numbers.describe(&mut info);
            }
            Self::Ints(_, parameters, numbers) => {
                (info.kind, info.parameters) = (OptionKind::Ints, owned(parameters));
                numbers.describe(&mut info);
            }
            Self::Choice(_, choices) => {
                (info.kind, info.choices) = (OptionKind::Choice, owned(choices));
            }
            Self::Word(_, what) => {
                (info.kind, info.parameters) = (OptionKind::Word, owned(&[what]))
            }
            Self::Action(parameters, _) => {
                (info.kind, info.parameters) = (OptionKind::Action, owned(parameters));
            }
        }
        info
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
    /// `0.0..1.0 m/s`.
    fn span(&self) -> String {
        format!(
            "{:?}..{:?}{}",
            self.range.start(),
            self.range.end(),
            spaced(self.unit)
        )
    }

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
        let pairs = words.iter().zip(names);
        pairs
            .map(|(word, name)| self.read(word, &format!("{name} ")))
            .collect()
    }

    fn describe(&self, info: &mut OptionInfo) {
        let (low, high) = (self.range.start(), self.range.end());
        info.range = Some([format!("{low:?}"), format!("{high:?}")]);
        self.unit.clone_into(&mut info.unit);
    }
}

fn many<N: Debug>(values: &[N]) -> Option<String> {
    let values: Vec<String> = values.iter().map(|value| format!("{value:?}")).collect();
    (!values.is_empty()).then(|| values.join(" "))
}

fn listed(parameters: &[&str]) -> String {
    parameters.iter().map(|name| format!(" {name}")).collect()
}

fn spaced(unit: &str) -> String {
    if unit.is_empty() {
        String::new()
    } else {
        format!(" {unit}")
    }
}
