//! The option table of a class: what CTRL understands, written once per class.
//!
//! From one table come the parser (`-option value ...`), `-help`, `-dump`, and the description that
//! completion, panels and the page of services are made from. Options of one request are taken
//! together or not at all. When one is wrong the state stays as it was, and every wrong one is
//! reported. The forms of EXEC that a class understands stand in the same table and are checked by it.

mod kind;

use crate::description::{ClassInfo, Form, FormInfo, OptionInfo};
use crate::name::suggestion;
use crate::report::{Report, code};
use crate::transport::Transport;
use crate::words::{self, Word};
use kind::{Act, Bound, Field, Numbers};
use std::borrow::Cow;
use std::fmt::Write as _;
use std::ops::RangeInclusive;

/// The options of a class whose state is `T`. `T::default()` is an object without a recipe.
///
/// `-help` (what there is) and `-dump` (the state, as a line that CTRL takes back) are always there.
pub struct OptionTable<T> {
    about: &'static str,
    forms: &'static [Form],
    options: Vec<Opt<T>>,
}

struct Opt<T> {
    name: &'static str,
    help: &'static str,
    at: Box<At<T>>,
}

/// The option at one state. The code that works with it knows no `T`, so it is compiled once.
type At<T> = dyn Fn(&mut T) -> Bound<'_> + Send + Sync;

impl<T: Clone + Default + 'static> OptionTable<T> {
    /// An empty table of a class; `about` says in one line what the class does.
    #[must_use]
    pub fn new(about: &'static str) -> Self {
        Self {
            about,
            forms: &[],
            options: Vec::new(),
        }
    }

    /// The forms of EXEC that the class understands; [`Self::form`] then tells them apart.
    #[must_use]
    pub fn exec(mut self, forms: &'static [Form]) -> Self {
        self.forms = forms;
        self
    }

    fn option(
        mut self,
        name: &'static str,
        help: &'static str,
        at: impl Fn(&mut T) -> Bound<'_> + Send + Sync + 'static,
    ) -> Self {
        let at = Box::new(at);
        self.options.push(Opt { name, help, at });
        self
    }

    /// `-name`, `-name on` or `-name off`.
    #[must_use]
    pub fn flag(self, name: &'static str, help: &'static str, field: Field<T, bool>) -> Self {
        self.option(name, help, move |state| Bound::Flag(field(state)))
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
        let numbers = Numbers { range, unit };
        self.option(name, help, move |state| {
            Bound::Float(field(state), numbers.clone())
        })
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
        let numbers = Numbers { range, unit };
        self.option(name, help, move |state| {
            Bound::Int(field(state), numbers.clone())
        })
    }

    /// `-name 3` or `-name word`: a whole number within `range`, in `unit`, or the one word that says
    /// that there is no such number. The field holds either as text.
    #[must_use]
    pub fn int_or(
        self,
        name: &'static str,
        word: &'static str,
        range: RangeInclusive<i64>,
        unit: &'static str,
        help: &'static str,
        field: Field<T, String>,
    ) -> Self {
        let numbers = Numbers { range, unit };
        self.option(name, help, move |state| {
            Bound::IntOr(field(state), word, numbers.clone())
        })
    }

    /// `-name 0.1 0.2 0.3`: as many finite floats as there are `parameters`, each within `range`, in
    /// `unit`. Parameters with `..` among them stand for any number of floats from one. A list without numbers is not
    /// set; `-dump` leaves it out.
    #[must_use]
    pub fn floats(
        self,
        name: &'static str,
        parameters: &'static [&'static str],
        range: RangeInclusive<f64>,
        unit: &'static str,
        help: &'static str,
        field: Field<T, Vec<f64>>,
    ) -> Self {
        let numbers = Numbers { range, unit };
        self.option(name, help, move |state| {
            Bound::Floats(field(state), parameters, numbers.clone())
        })
    }

    /// `-name 640 480`: as many whole numbers as there are `parameters`, each within `range`, in
    /// `unit`. A list without numbers is not set; `-dump` leaves it out.
    #[must_use]
    pub fn ints(
        self,
        name: &'static str,
        parameters: &'static [&'static str],
        range: RangeInclusive<i64>,
        unit: &'static str,
        help: &'static str,
        field: Field<T, Vec<i64>>,
    ) -> Self {
        let numbers = Numbers { range, unit };
        self.option(name, help, move |state| {
            Bound::Ints(field(state), parameters, numbers.clone())
        })
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
        self.option(name, help, move |state| {
            Bound::Choice(field(state), choices)
        })
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
        self.option(name, help, move |state| Bound::Word(field(state), what))
    }

    /// `-name a b`: does something with that many words and may answer with a text. It is not a state,
    /// so `-dump` leaves it out.
    #[must_use]
    pub fn action(
        self,
        name: &'static str,
        parameters: &'static [&'static str],
        help: &'static str,
        act: Act<T>,
    ) -> Self {
        self.option(name, help, move |state| {
            Bound::Action(parameters, Box::new(move |words| act(state, words)))
        })
    }

    /// What a program may know about the options, in the order of the table; `help` and `dump` are
    /// left out.
    #[must_use]
    pub fn describe(&self) -> Vec<OptionInfo> {
        describe(&mut self.at(&mut T::default()))
    }

    /// What a program may know about the class.
    #[must_use]
    pub fn class(&self, name: &str, version: &str) -> ClassInfo {
        ClassInfo {
            name: name.to_owned(),
            version: version.to_owned(),
            about: self.about.to_owned(),
            forms: self.forms.iter().map(FormInfo::from).collect(),
            options: self.describe(),
        }
    }

    /// Which form of EXEC a request has, when its numbers are what that form takes. That is the
    /// right count of floats, all of them finite, and nothing else. Allocates nothing when all is
    /// well.
    ///
    /// # Errors
    /// What is wrong with the request, and what would have been right.
    pub fn form(&self, io: &Transport) -> Result<&'static Form, Report> {
        form(self.forms, io)
    }

    /// What `-help` answers: a line for each form of EXEC and for each option, with its form, meaning
    /// and default.
    #[must_use]
    pub fn help(&self) -> String {
        help(self.about, self.forms, &mut self.at(&mut T::default()))
    }

    /// What `-dump` answers: every option with its value, as one line that CTRL takes back.
    #[must_use]
    pub fn dump(&self, state: &T) -> String {
        dump(&mut self.at(&mut state.clone()))
    }

    /// A CTRL request: takes the options in `io.text` into `state` and leaves the answers there.
    /// What is wrong goes to `io` as reports, and `state` is then as before.
    pub fn ctrl(&self, state: &mut T, io: &mut Transport) {
        let mut next = state.clone();
        if ctrl(&mut self.at(&mut next), &|| self.help(), io) {
            *state = next;
        }
    }

    fn at<'a>(&'a self, state: &'a mut T) -> Table<'a, T> {
        Table {
            options: &self.options,
            state,
        }
    }
}

/// The options of a class at one state. The code that works with them is compiled once, and not for every class.
trait Options {
    /// The option that stands at `index` in the table.
    fn get(&mut self, index: usize) -> Option<Named<'_>>;

    /// The names in the order of the table, without `help` and `dump`.
    fn names(&self) -> Vec<&'static str>;
}

/// An option at one state.
struct Named<'a> {
    name: &'static str,
    help: &'static str,
    kind: Bound<'a>,
}

struct Table<'a, T> {
    options: &'a [Opt<T>],
    state: &'a mut T,
}

impl<T> Options for Table<'_, T> {
    fn get(&mut self, index: usize) -> Option<Named<'_>> {
        let option = self.options.get(index)?;
        Some(Named {
            name: option.name,
            help: option.help,
            kind: (option.at)(self.state),
        })
    }

    fn names(&self) -> Vec<&'static str> {
        self.options.iter().map(|option| option.name).collect()
    }
}

/// Calls `each` for every option of the table.
fn each(options: &mut dyn Options, mut each: impl FnMut(Named<'_>)) {
    let mut index = 0;
    while let Some(option) = options.get(index) {
        each(option);
        index += 1;
    }
}

fn describe(options: &mut dyn Options) -> Vec<OptionInfo> {
    let mut described = Vec::new();
    each(options, |Named { name, help, kind }| {
        described.push(kind.describe(name, help));
    });
    described
}

/// Which of `forms` a request has, as [`OptionTable::form`]: for an object whose counts of floats follow from its
/// options, and so stand in no table.
///
/// # Errors
/// What is wrong with the request, and what would have been right.
pub fn form<'f>(forms: &'f [Form], io: &Transport) -> Result<&'f Form, Report> {
    let text = io.text.trim();
    let fits = |form: &&Form| form.is_of(text);
    let mut fitting = forms.iter().filter(fits);
    // Forms of one text differ by the count of their floats.
    let counted = fitting
        .clone()
        .find(|form| form.takes_so_many(io.floats.len()));
    let Some(form) = counted.or_else(|| fitting.next()) else {
        return Err(no_form(forms, text));
    };
    let takes = form.takes;
    let wrong = |text: String| {
        Err(Report::error(
            code::VALUE,
            format!("{} {text}", called(form)),
        ))
    };
    if !form.takes_so_many(io.floats.len()) {
        let given = io.floats.len();
        return wrong(match form.floats {
            0 => format!("takes no floats (FMSG), not {given}"),
            count => format!(
                "takes {count} floats ({takes}), not {given}: write FMSG {count} and the numbers"
            ),
        });
    }
    if let Some(index) = io.floats.iter().position(|float| !float.is_finite()) {
        let (count, given) = (
            io.floats.len(),
            io.floats.get(index).copied().unwrap_or_default(),
        );
        let at = index + 1;
        return wrong(format!(
            "takes finite floats ({takes}), and float {at} of {count} is {given:?}"
        ));
    }
    let (ints, bytes) = (io.ints.len(), io.opaque.len());
    if ints > 0 {
        return wrong(format!("takes no whole numbers (IMSG), not {ints}"));
    }
    if bytes > 0 {
        return wrong(format!("takes no opaque bytes, not {bytes}"));
    }
    Ok(form)
}

fn no_form(forms: &[Form], text: &str) -> Report {
    let mut known: Vec<&str> = forms.iter().map(|form| form.text).collect();
    known.dedup();
    known.retain(|text| !text.is_empty());
    let listed = known.join(", ");
    let none_is_known = forms.is_empty();
    // The text when the numbers at its end are meant as numbers.
    let (mut words, mut count) = (text, 0);
    while let Some((before, last)) = words.rsplit_once(char::is_whitespace)
        && last.parse::<f64>().is_ok()
    {
        words = before.trim_end();
        count += 1;
    }
    let meant = forms
        .iter()
        .find(|form| words != text && form.floats > 0 && form.text == words);
    // A form with numbers, of which one cannot be read.
    let misread = forms.iter().find_map(|form| {
        let numbers = text.strip_prefix(form.text)?.strip_prefix(' ')?;
        let mut numbers = numbers.split_whitespace();
        let wrong = numbers.find(|number| number.parse::<f64>().is_err())?;
        (form.floats > 0 && !form.text.is_empty()).then_some((form, wrong))
    });
    if let Some((form, wrong)) = misread {
        let (text, takes, wrong) = (form.text, form.takes, clipped(wrong));
        let why = format!("EXEC {text} takes numbers ({takes}), and `{wrong}` is none");
        return Report::error(code::UNSUPPORTED, why);
    }
    let text = match (known.as_slice(), text) {
        _ if meant.is_some() => format!(
            "the numbers of EXEC {words} stand after FMSG and their count: write FMSG {} and the numbers",
            meant.map_or(0, |form| match form.floats {
                Form::ANY => count,
                floats => floats,
            })
        ),
        ([], _) if none_is_known => "this class has no EXEC".to_owned(),
        ([one], "") => format!("after EXEC stands {one}"),
        (_, "") => format!("after EXEC stands one of {listed}"),
        (_, given) => {
            // What is known is listed anyway.
            let hint = suggestion(words, known);
            let hint = if hint.contains("did you mean") {
                hint
            } else {
                String::new()
            };
            format!(
                "EXEC `{}` is not known here: this class has {listed}{hint}",
                clipped(given)
            )
        }
    };
    Report::error(code::UNSUPPORTED, text)
}

fn help(about: &str, forms: &[Form], options: &mut dyn Options) -> String {
    let mut out = about.to_owned();
    for form in forms {
        let floats = match form.floats {
            0 => String::new(),
            Form::ANY => " [FMSG N ...]".to_owned(),
            count => format!(" FMSG {count}"),
        };
        let request = format!("EXEC {}{floats}", form.text);
        // Writing to a `String` cannot fail.
        let _ = write!(out, "\n  {request:<28} {}; gives {}", form.help, form.gives);
        if form.floats > 0 {
            let _ = write!(out, "; takes {}", form.takes);
        }
    }
    each(options, |Named { name, help, kind }| {
        let called = format!("-{name}{}", kind.form());
        let _ = write!(out, "\n  {called:<28} {help}");
        if let Some(value) = kind.shown() {
            let _ = write!(out, " (default {value})");
        }
    });
    out.push_str("\n  -help                        what CTRL understands");
    out.push_str("\n  -dump                        the state, as options");
    out
}

fn dump(options: &mut dyn Options) -> String {
    let mut shown = Vec::new();
    each(options, |Named { name, kind, .. }| {
        shown.extend(kind.shown().map(|value| format!("-{name} {value}")));
    });
    shown.join(" ")
}

/// Whether all options were taken; the answers are then in `io`, and what was wrong otherwise.
fn ctrl(options: &mut dyn Options, help: &dyn Fn() -> String, io: &mut Transport) -> bool {
    let text = std::mem::take(&mut io.text);
    let words = match words::split(&text) {
        Ok(words) => words,
        Err(error) => {
            io.report(Report::error(code::SYNTAX, error.to_string()));
            return false;
        }
    };
    let mut answers = Vec::new();
    let mut errors = Vec::new();
    let mut rest = words.as_slice();
    while let Some((word, after)) = rest.split_first() {
        rest = match one(options, help, word, after) {
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
    let taken = errors.is_empty();
    if taken {
        io.text = answers.join("\n");
    }
    for error in errors {
        io.report(error);
    }
    taken
}

/// Takes one option and returns its answer and the words after it.
fn one<'w>(
    options: &mut dyn Options,
    help: &dyn Fn() -> String,
    word: &Word,
    rest: &'w [Word],
) -> Result<(Option<String>, &'w [Word]), Report> {
    let Some(name) = word.text.strip_prefix('-') else {
        let text = format!(
            "`{}` is no option; options begin with `-`, see -help",
            clipped(&word.text)
        );
        return Err(Report::error(code::SYNTAX, text));
    };
    match name {
        "help" => return Ok((Some(help()), rest)),
        "dump" => return Ok((Some(dump(options)), rest)),
        _ => {}
    }
    let names = options.names();
    let index = names.iter().position(|known| *known == name);
    let Some(Named { name, kind, .. }) = index.and_then(|index| options.get(index)) else {
        let hint = suggestion(name, names.into_iter().chain(["help", "dump"]));
        let text = format!("unknown option `-{}`{hint}", clipped(name));
        return Err(Report::error(code::UNKNOWN_OPTION, text));
    };
    let wrong = |text: String| Report::error(code::VALUE, format!("-{name}: {text}"));
    let count = kind.count(rest);
    if rest.len() < count {
        return Err(wrong(format!("write -{name}{}", kind.form())));
    }
    let (own, rest) = rest.split_at(count);
    let own: Vec<String> = own.iter().map(|word| word.text.clone()).collect();
    let answer = kind.set(&own).map_err(wrong)?;
    Ok((answer.filter(|answer| !answer.is_empty()), rest))
}

/// Where reading goes on after a wrong option: at the next word that looks like one and not like a
/// negative number.
fn begins_option(word: &Word) -> bool {
    let name = word.text.strip_prefix('-').filter(|_| !word.quoted);
    name.is_some_and(|name| name.starts_with(|first: char| first.is_ascii_alphabetic()))
}

/// `EXEC fkine`.
fn called(form: &Form) -> String {
    format!("EXEC {}", form.text).trim_end().to_owned()
}

/// The beginning of a text that may be of any length, for reports.
fn clipped(text: &str) -> Cow<'_, str> {
    const MOST: usize = 80;
    match text.char_indices().nth(MOST) {
        None => Cow::Borrowed(text),
        Some((end, _)) => {
            let begin = text.get(..end).unwrap_or_default();
            Cow::Owned(format!("{begin}… ({} bytes)", text.len()))
        }
    }
}

#[cfg(test)]
mod tests;
