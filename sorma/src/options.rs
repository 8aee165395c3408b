//! The option table of a class: what CTRL understands, written once per class.
//!
//! From one table come the parser (`-option value ...`), `-help` and `-dump`. Options of one request
//! are taken together or not at all: when one is wrong the state stays as it was, and every wrong
//! one is reported.

use crate::name::suggestion;
use crate::report::{Report, code};
use crate::transport::Transport;
use crate::words::{self, Word};
use std::fmt::Write as _;
use std::ops::RangeInclusive;

/// The options of a class whose state is `T`. `T::default()` is an object without a recipe.
///
/// `-help` (what there is) and `-dump` (the state, as a line that CTRL takes back) are always there.
pub struct OptionTable<T> {
    about: &'static str,
    options: Vec<Opt<T>>,
}

struct Opt<T> {
    name: &'static str,
    help: &'static str,
    kind: Kind<T>,
}

type Field<T, V> = fn(&mut T) -> &mut V;
type Act<T> = fn(&mut T, &[String]) -> Result<String, String>;

enum Kind<T> {
    Flag(Field<T, bool>),
    Float(Field<T, f64>, RangeInclusive<f64>, &'static str),
    Int(Field<T, i64>, RangeInclusive<i64>, &'static str),
    Choice(Field<T, String>, &'static [&'static str]),
    Word(Field<T, String>, &'static str),
    Action(&'static [&'static str], Act<T>),
}

impl<T: Clone + Default> OptionTable<T> {
    /// An empty table of a class; `about` says in one line what the class does.
    #[must_use]
    pub fn new(about: &'static str) -> Self {
        Self {
            about,
            options: Vec::new(),
        }
    }

    fn option(mut self, name: &'static str, help: &'static str, kind: Kind<T>) -> Self {
        self.options.push(Opt { name, help, kind });
        self
    }

    /// `-name`, `-name on` or `-name off`.
    #[must_use]
    pub fn flag(self, name: &'static str, help: &'static str, field: Field<T, bool>) -> Self {
        self.option(name, help, Kind::Flag(field))
    }

    /// `-name 0.5`: a finite float within `range`, in `unit` ("" for a pure number).
    #[must_use]
    pub fn float(
        self,
        name: &'static str,
        range: RangeInclusive<f64>,
        unit: &'static str,
        help: &'static str,
        field: Field<T, f64>,
    ) -> Self {
        self.option(name, help, Kind::Float(field, range, unit))
    }

    /// `-name 3`: a whole number within `range`, in `unit` ("" for a pure number).
    #[must_use]
    pub fn int(
        self,
        name: &'static str,
        range: RangeInclusive<i64>,
        unit: &'static str,
        help: &'static str,
        field: Field<T, i64>,
    ) -> Self {
        self.option(name, help, Kind::Int(field, range, unit))
    }

    /// `-name word`: one of a few words.
    #[must_use]
    pub fn choice(
        self,
        name: &'static str,
        choices: &'static [&'static str],
        help: &'static str,
        field: Field<T, String>,
    ) -> Self {
        self.option(name, help, Kind::Choice(field, choices))
    }

    /// `-name word`: any word; `what` names it in the help (`FILE`, `OBJECT`).
    #[must_use]
    pub fn word(
        self,
        name: &'static str,
        what: &'static str,
        help: &'static str,
        field: Field<T, String>,
    ) -> Self {
        self.option(name, help, Kind::Word(field, what))
    }

    /// `-name a b`: does something with that many words and may answer with a text. It is no state,
    /// so `-dump` leaves it out.
    #[must_use]
    pub fn action(
        self,
        name: &'static str,
        parameters: &'static [&'static str],
        help: &'static str,
        act: Act<T>,
    ) -> Self {
        self.option(name, help, Kind::Action(parameters, act))
    }

    /// The names of the options, without the dash, `help` and `dump` among them.
    pub fn names(&self) -> impl Iterator<Item = &'static str> {
        let own = self.options.iter().map(|option| option.name);
        own.chain(["help", "dump"])
    }

    /// What `-help` answers: a line for each option with its form, meaning and default.
    #[must_use]
    pub fn help(&self) -> String {
        let mut initial = T::default();
        let mut out = self.about.to_owned();
        for option in &self.options {
            let form = option.kind.form();
            // Writing to a `String` cannot fail.
            let _ = write!(
                out,
                "\n  {:<28} {}",
                format!("-{}{form}", option.name),
                option.help
            );
            if let Some(value) = option.kind.shown(&mut initial) {
                let _ = write!(out, " (default {value})");
            }
        }
        out.push_str("\n  -help                        what CTRL understands");
        out.push_str("\n  -dump                        the state, as options");
        out
    }

    /// What `-dump` answers: every option with its value, as one line that CTRL takes back.
    #[must_use]
    pub fn dump(&self, state: &T) -> String {
        let mut state = state.clone();
        let shown = self.options.iter().filter_map(|option| {
            let value = option.kind.shown(&mut state)?;
            Some(format!("-{} {value}", option.name))
        });
        shown.collect::<Vec<_>>().join(" ")
    }

    /// A CTRL request: takes the options in `io.text` into `state` and leaves the answers there.
    /// What is wrong goes to `io` as reports, and `state` is then as before.
    pub fn ctrl(&self, state: &mut T, io: &mut Transport) {
        let text = std::mem::take(&mut io.text);
        let words = match words::split(&text) {
            Ok(words) => words,
            Err(error) => return io.report(Report::error(code::SYNTAX, error.to_string())),
        };
        let mut next = state.clone();
        let mut answers = Vec::new();
        let mut errors = Vec::new();
        let mut rest = words.as_slice();
        while let Some((word, after)) = rest.split_first() {
            rest = match self.one(&mut next, word, after) {
                Ok((answer, rest)) => {
                    answers.extend(answer);
                    rest
                }
                Err(report) => {
                    errors.push(report);
                    let skipped = after.iter().take_while(|word| !begins_option(word));
                    after.get(skipped.count()..).unwrap_or_default()
                }
            };
        }
        if errors.is_empty() {
            *state = next;
            io.text = answers.join("\n");
        }
        for error in errors {
            io.report(error);
        }
    }

    /// Takes one option and returns its answer and the words after it.
    fn one<'w>(
        &self,
        state: &mut T,
        word: &Word,
        rest: &'w [Word],
    ) -> Result<(Option<String>, &'w [Word]), Report> {
        let Some(name) = word.text.strip_prefix('-') else {
            let text = format!(
                "`{}` is no option; options begin with `-`, see -help",
                word.text
            );
            return Err(Report::error(code::SYNTAX, text));
        };
        match name {
            "help" => return Ok((Some(self.help()), rest)),
            "dump" => return Ok((Some(self.dump(state)), rest)),
            _ => {}
        }
        let Some(option) = self.options.iter().find(|option| option.name == name) else {
            let text = format!("unknown option `-{name}`{}", suggestion(name, self.names()));
            return Err(Report::error(code::UNKNOWN_OPTION, text));
        };
        option.take(state, rest)
    }
}

impl<T> Opt<T> {
    fn take<'w>(
        &self,
        state: &mut T,
        rest: &'w [Word],
    ) -> Result<(Option<String>, &'w [Word]), Report> {
        let wrong = |text: String| Report::error(code::VALUE, format!("-{}: {text}", self.name));
        let count = match (&self.kind, rest.first()) {
            (Kind::Flag(_), Some(word)) if word.text == "on" || word.text == "off" => 1,
            (Kind::Flag(_), _) => 0,
            (Kind::Action(parameters, _), _) => parameters.len(),
            _ => 1,
        };
        if rest.len() < count {
            return Err(wrong(format!("write -{}{}", self.name, self.kind.form())));
        }
        let (own, rest) = rest.split_at(count);
        let own: Vec<String> = own.iter().map(|word| word.text.clone()).collect();
        let answer = self.kind.set(state, &own).map_err(wrong)?;
        Ok((answer.filter(|answer| !answer.is_empty()), rest))
    }
}

impl<T> Kind<T> {
    /// What stands after the option in the help.
    fn form(&self) -> String {
        match self {
            Self::Flag(_) => " [on|off]".to_owned(),
            Self::Float(_, range, unit) => {
                format!(" {:?}..{:?}{}", range.start(), range.end(), spaced(unit))
            }
            Self::Int(_, range, unit) => {
                format!(" {}..{}{}", range.start(), range.end(), spaced(unit))
            }
            Self::Choice(_, choices) => format!(" {}", choices.join("|")),
            Self::Word(_, what) => format!(" {what}"),
            Self::Action(parameters, _) => {
                parameters.iter().map(|name| format!(" {name}")).collect()
            }
        }
    }

    /// The value as CTRL takes it; `None` for actions.
    fn shown(&self, state: &mut T) -> Option<String> {
        match self {
            Self::Flag(field) => Some(if *field(state) { "on" } else { "off" }.to_owned()),
            Self::Float(field, ..) => Some(format!("{:?}", field(state))),
            Self::Int(field, ..) => Some(field(state).to_string()),
            Self::Choice(field, _) | Self::Word(field, _) => Some(words::word(field(state))),
            Self::Action(..) => None,
        }
    }

    /// Sets the value from as many words as the option takes.
    fn set(&self, state: &mut T, words: &[String]) -> Result<Option<String>, String> {
        let word = words.first().map_or("", String::as_str);
        match self {
            Self::Flag(field) => *field(state) = word != "off",
            Self::Float(field, range, unit) => {
                let number: Option<f64> = word.parse().ok();
                *field(state) =
                    number
                        .filter(|number| range.contains(number))
                        .ok_or_else(|| {
                            let (low, high) = (range.start(), range.end());
                            format!(
                                "must be a number from {low:?} to {high:?}{}, not `{word}`",
                                spaced(unit)
                            )
                        })?;
            }
            Self::Int(field, range, unit) => {
                let number: Option<i64> = word.parse().ok();
                *field(state) =
                    number
                        .filter(|number| range.contains(number))
                        .ok_or_else(|| {
                            let (low, high) = (range.start(), range.end());
                            format!(
                                "must be a whole number from {low} to {high}{}, not `{word}`",
                                spaced(unit)
                            )
                        })?;
            }
            Self::Choice(field, choices) => {
                if !choices.contains(&word) {
                    let hint = suggestion(word, choices.iter().copied());
                    return Err(format!(
                        "must be one of {}, not `{word}`{hint}",
                        choices.join(", ")
                    ));
                }
                word.clone_into(field(state));
            }
            Self::Word(field, _) => word.clone_into(field(state)),
            Self::Action(_, act) => return act(state, words).map(Some),
        }
        Ok(None)
    }
}

/// Where reading goes on after a wrong option: at the next word that looks like one and not like a
/// negative number.
fn begins_option(word: &Word) -> bool {
    let name = word.text.strip_prefix('-').filter(|_| !word.quoted);
    name.is_some_and(|name| name.starts_with(|first: char| first.is_ascii_alphabetic()))
}

fn spaced(unit: &str) -> String {
    if unit.is_empty() {
        String::new()
    } else {
        format!(" {unit}")
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[derive(Debug, Clone, PartialEq)]
    struct Arm {
        slow: bool,
        speed: f64,
        retries: i64,
        frame: String,
        tool: String,
    }

    impl Default for Arm {
        fn default() -> Self {
            Self {
                slow: false,
                speed: 0.5,
                retries: 2,
                frame: "base".to_owned(),
                tool: String::new(),
            }
        }
    }

    fn table() -> OptionTable<Arm> {
        OptionTable::new("moves an arm")
            .flag("slow", "moves at a tenth of the speed", |arm: &mut Arm| {
                &mut arm.slow
            })
            .float("speed", 0.0..=1.0, "m/s", "speed of the tool", |arm| {
                &mut arm.speed
            })
            .int("retries", -3..=9, "", "how often it tries again", |arm| {
                &mut arm.retries
            })
            .choice("frame", &["base", "tool"], "frame of targets", |arm| {
                &mut arm.frame
            })
            .word("tool", "OBJECT", "what is in the hand", |arm| &mut arm.tool)
            .action("echo", &["A", "B"], "says both", |_, words| {
                Ok(words.join("+"))
            })
    }

    fn ctrl(arm: &mut Arm, text: &str) -> Transport {
        let mut io = Transport::text(text);
        table().ctrl(arm, &mut io);
        io
    }

    fn errors(text: &str) -> Vec<String> {
        let mut arm = Arm::default();
        let io = ctrl(&mut arm, text);
        assert_eq!(arm, Arm::default(), "a refused request changes nothing");
        assert!(!io.is_ok() && io.text.is_empty());
        io.reports.into_iter().map(|report| report.text).collect()
    }

    #[test]
    fn options_set_the_state_and_later_ones_override() {
        let mut arm = Arm::default();
        let io = ctrl(
            &mut arm,
            "-slow -speed 0.1 -retries -3 -tool 'red cup' -speed 1 -frame tool",
        );
        assert!(io.is_ok() && io.text.is_empty() && io.reports.is_empty());
        let expected = Arm {
            slow: true,
            speed: 1.0,
            retries: -3,
            frame: "tool".to_owned(),
            tool: "red cup".to_owned(),
        };
        assert_eq!(arm, expected);
        ctrl(&mut arm, "-slow off");
        assert!(!arm.slow);
    }

    #[test]
    fn help_and_dump_are_always_there_and_actions_answer() {
        let mut arm = Arm::default();
        let help = ctrl(&mut arm, "-help").text;
        assert!(
            help.contains("-speed 0.0..1.0 m/s") && help.contains("(default 0.5)"),
            "{help}"
        );
        assert!(
            help.contains("-frame base|tool") && help.contains("-echo A B"),
            "{help}"
        );
        let dump = ctrl(&mut arm, "-slow -dump").text;
        assert_eq!(
            dump,
            "-slow on -speed 0.5 -retries 2 -frame base -tool \"\""
        );
        assert_eq!(ctrl(&mut arm, "-echo a 'b c' -echo d e").text, "a+b c\nd+e");
    }

    #[test]
    fn all_wrong_options_of_a_request_are_reported_and_nothing_is_taken() {
        assert_eq!(
            errors("-slow -sped 3 x -speed 1.5 -retries 1.5 -frame tol -speed nan"),
            [
                "unknown option `-sped`; did you mean `speed`?",
                "-speed: must be a number from 0.0 to 1.0 m/s, not `1.5`",
                "-retries: must be a whole number from -3 to 9, not `1.5`",
                "-frame: must be one of base, tool, not `tol`; did you mean `tool`?",
                "-speed: must be a number from 0.0 to 1.0 m/s, not `nan`",
            ]
        );
        assert_eq!(errors("-speed"), ["-speed: write -speed 0.0..1.0 m/s"]);
        assert_eq!(errors("-echo a"), ["-echo: write -echo A B"]);
        assert_eq!(
            errors("slow"),
            ["`slow` is no option; options begin with `-`, see -help"]
        );
        assert_eq!(errors("-tool 'a"), ["the quote at byte 6 is not closed"]);
    }

    proptest! {
        #[test]
        fn a_dump_is_a_recipe_for_the_same_state(
            slow in any::<bool>(),
            speed in 0.0..=1.0_f64,
            retries in -3..=9_i64,
            frame in prop::sample::select(vec!["base", "tool"]),
            tool in any::<String>(),
        ) {
            let arm = Arm { slow, speed, retries, frame: frame.to_owned(), tool };
            let mut copy = Arm::default();
            let io = ctrl(&mut copy, &table().dump(&arm));
            prop_assert!(io.is_ok(), "{:?}", io.reports);
            prop_assert_eq!(copy, arm);
        }

        #[test]
        fn any_text_is_taken_whole_or_changes_nothing(text in "[-a-z0-9.'\" ]{0,40}") {
            let mut arm = Arm::default();
            if !ctrl(&mut arm, &text).is_ok() {
                prop_assert_eq!(arm, Arm::default());
            }
        }
    }
}
