//! The kinds of option: how each reads its words, shows its value and describes itself.

use super::clipped;
use crate::describe::{OptionInfo, OptionKind};
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
    pub(super) fn shown(&self, state: &mut T) -> Option<String> {
        match self {
            Self::Flag(field) => Some(if *field(state) { "on" } else { "off" }.to_owned()),
            Self::Float(field, _) => Some(format!("{:?}", field(state))),
            Self::Int(field, _) => Some(field(state).to_string()),
            Self::Floats(field, ..) => many(field(state)),
            Self::Ints(field, ..) => many(field(state)),
            Self::Choice(field, _) | Self::Word(field, _) | Self::IntOr(field, ..) => {
                Some(words::word(field(state)))
            }
            Self::Action(..) => None,
        }
    }

    /// Sets the value from as many words as the option takes.
    pub(super) fn set(&self, state: &mut T, words: &[String]) -> Result<Option<String>, String> {
        let word = words.first().map_or("", String::as_str);
        match self {
            Self::Flag(field) => *field(state) = word != "off",
            Self::Float(field, numbers) => *field(state) = numbers.read(word, "")?,
            Self::Int(field, numbers) => *field(state) = numbers.read(word, "")?,
            Self::IntOr(field, none, numbers) => {
                if word != *none {
                    numbers.read(word, &format!("must be `{none}`, or it "))?;
                }
                word.clone_into(field(state));
            }
            Self::Floats(field, names, numbers) => {
                *field(state) = numbers.read_all(words, names)?;
            }
            Self::Ints(field, names, numbers) => *field(state) = numbers.read_all(words, names)?,
            Self::Choice(field, choices) => {
                if !choices.contains(&word) {
                    let hint = suggestion(word, choices.iter().copied());
                    return Err(format!(
                        "must be one of {}, not `{}`{hint}",
                        choices.join(", "),
                        clipped(word)
                    ));
                }
                word.clone_into(field(state));
            }
            Self::Word(field, _) => word.clone_into(field(state)),
            Self::Action(_, act) => return act(state, words).map(Some),
        }
        Ok(None)
    }

    /// What a program may know about the option; `initial` is a state without a recipe.
    pub(super) fn describe(
        &self,
        name: &'static str,
        help: &'static str,
        initial: &mut T,
    ) -> OptionInfo {
        let owned = |names: &[&str]| names.iter().map(|name| (*name).to_owned()).collect();
        let mut info = OptionInfo {
            name: name.to_owned(),
            kind: OptionKind::Flag,
            parameters: Vec::new(),
            unit: String::new(),
            range: None,
            choices: Vec::new(),
            default: self.shown(initial),
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
