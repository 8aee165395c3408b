//! What can stand at the end of a line, and a hint of what should: from the descriptions of the classes
//! and from nothing else. Knows no terminal.

use std::fs;

use sorma::{
    ClassInfo, Form,
    describe::{self, FormInfo, OptionInfo, OptionKind},
};

use super::{
    helping,
    script::{REPLY, STATEMENTS},
};

/// Entries of a folder that are offered at most.
const MOST_FILES: usize = 200;

/// One way to go on.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Candidate {
    /// The word, from where it begins.
    pub word: String,
    /// What it means.
    pub about: String,
    /// Whether a space follows it; not after a folder.
    pub ends: bool,
}

/// What is known when a line is completed.
#[derive(Debug, Clone, Copy)]
pub struct Known<'a> {
    /// The classes.
    pub classes: &'a [ClassInfo],
    /// Names of flavors and objects.
    pub names: &'a [String],
    /// Names of daemons.
    pub daemons: &'a [String],
    /// Names of variables.
    pub variables: &'a [String],
}

/// A line up to the cursor, taken apart.
struct Line<'a> {
    /// The words that are done.
    done: Vec<&'a str>,
    /// The word that is begun; may be empty.
    begun: &'a str,
}

impl<'a> Line<'a> {
    fn new(text: &'a str) -> Self {
        let start = text
            .rfind(|letter: char| letter.is_ascii_whitespace())
            .map_or(0, |at| at + 1);
        let (done, begun) = text.split_at(start);
        let mut done: Vec<&str> = done.split_ascii_whitespace().collect();
        // What is timed is a request like any other.
        match done.as_slice() {
            ["time" | "trace", next, ..] if !is_method(next) => drop(done.drain(..1)),
            ["time" | "trace"] => drop(done.drain(..1)),
            ["repeat", count, ..] if count.parse::<u64>().is_ok() => drop(done.drain(..2)),
            _ => {}
        }
        Self { done, begun }
    }
}

fn is_method(word: &str) -> bool {
    ["EXEC", "CTRL", "DBX"].contains(&word)
}

/// The ways to go on after `text`, the line up to the cursor, and the byte at which their words begin.
#[must_use]
pub fn candidates(text: &str, known: Known<'_>) -> (usize, Vec<Candidate>) {
    let line = Line::new(text);
    let start = text.len() - line.begun.len();
    let all = if line.begun.starts_with('$') {
        variables(known)
    } else {
        offered(&line, known)
    };
    let fitting = all
        .into_iter()
        .filter(|candidate| candidate.word.starts_with(line.begun));
    (start, fitting.collect())
}

fn variables(known: Known<'_>) -> Vec<Candidate> {
    let own = known.variables.iter().map(String::as_str);
    let mut names: Vec<&str> = own.chain(REPLY).collect();
    names.sort_unstable();
    names.dedup();
    let words = names.into_iter().map(|name| format!("${name}"));
    words.map(|word| candidate(&word, "a variable")).collect()
}

fn offered(line: &Line<'_>, known: Known<'_>) -> Vec<Candidate> {
    match line.done.as_slice() {
        [] if line.begun.contains('@') => at_daemons(line.begun, known),
        [] => beginnings(known),
        ["set", ..] | ["repeat"] => Vec::new(),
        ["help" | "?" | "list"] => beginnings_of_objects(known),
        ["watch"] => {
            let own = known.names.iter();
            own.map(|name| candidate(name, "an object")).collect()
        }
        ["watch", ..] => ["--kind", "--slower", "--from", "--failed", "--count", "&"]
            .map(|word| candidate(word, ""))
            .to_vec(),
        ["expect", ..] => ["RET", "TMSG", "FMSG", "IMSG", "TDBX", "within"]
            .map(|word| candidate(word, ""))
            .to_vec(),
        [_] => vec![
            candidate("EXEC", "do the job"),
            candidate("CTRL", "take options"),
            candidate("DBX", "tell about the object"),
        ],
        [name, "EXEC", rest @ ..] => match class_of(name, known) {
            Some(class) => requests(class, rest, line.begun),
            None => Vec::new(),
        },
        [name, "CTRL", rest @ ..] => match class_of(name, known) {
            Some(class) => options(&class.options, rest),
            None => Vec::new(),
        },
        [_, "DBX", rest @ ..] => options(&describe::dbx_options(), rest),
        _ => Vec::new(),
    }
}

/// A name whose daemon is begun.
fn at_daemons(begun: &str, known: Known<'_>) -> Vec<Candidate> {
    let object = begun.split('@').next().unwrap_or_default();
    let daemons = known.daemons.iter().map(String::as_str);
    let places = daemons.chain(["self"]);
    places
        .map(|daemon| candidate(&format!("{object}@{daemon}"), "a daemon"))
        .collect()
}

fn beginnings(known: Known<'_>) -> Vec<Candidate> {
    let mut all = beginnings_of_objects(known);
    all.extend(STATEMENTS.map(|(word, about)| candidate(word, about)));
    all
}

fn beginnings_of_objects(known: Known<'_>) -> Vec<Candidate> {
    let mut all: Vec<Candidate> = known
        .classes
        .iter()
        .map(|class| candidate(&class.name, &class.about))
        .collect();
    for name in known.names {
        if let Some(class) = class_of(name, known)
            && !all.iter().any(|other| other.word == *name)
        {
            all.push(candidate(name, &class.about));
        }
    }
    all.sort_by(|a, b| a.word.cmp(&b.word));
    all
}

/// The class that a name means.
fn class_of<'a>(name: &str, known: Known<'a>) -> Option<&'a ClassInfo> {
    helping::class_of(name, known.classes)
}

fn requests(class: &ClassInfo, rest: &[&str], begun: &str) -> Vec<Candidate> {
    if !matches!(rest, [] | ["TMSG"]) {
        return Vec::new();
    }
    let mut all: Vec<Candidate> = class
        .forms
        .iter()
        .filter(|form| !form.placeholder && !form.text.is_empty())
        .map(|form| {
            // Of `camera NAME` the word that stands as it is; the name is the user's.
            let word = form.text.split(' ').next().unwrap_or_default();
            candidate(word, &form.help)
        })
        .collect();
    if class.forms.iter().any(|form| form.text == "FILE") {
        all.extend(files(begun));
    }
    if rest.is_empty() {
        all.push(candidate("TMSG", "text follows"));
    }
    all
}

/// The entries of the folder in which a path is begun.
fn files(begun: &str) -> Vec<Candidate> {
    let (folder, _) = begun.rsplit_once('/').unwrap_or(("", begun));
    let shown = if begun.contains('/') {
        format!("{folder}/")
    } else {
        String::new()
    };
    let place = if shown.is_empty() { "." } else { &shown };
    let Ok(entries) = fs::read_dir(place) else {
        return Vec::new();
    };
    let mut all: Vec<Candidate> = entries
        .flatten()
        .filter_map(|entry| {
            let name = entry.file_name().into_string().ok()?;
            let is_folder = entry.file_type().is_ok_and(|kind| kind.is_dir());
            let end = if is_folder { "/" } else { "" };
            Some(Candidate {
                word: format!("{shown}{name}{end}"),
                about: String::new(),
                ends: !is_folder,
            })
        })
        .take(MOST_FILES)
        .collect();
    all.sort_by(|a, b| a.word.cmp(&b.word));
    all
}

fn options(options: &[OptionInfo], rest: &[&str]) -> Vec<Candidate> {
    let last = rest.last().and_then(|word| named(options, word));
    if let Some(option) = last {
        let values = option.choices.iter();
        let values: Vec<Candidate> = values.map(|word| candidate(word, &option.help)).collect();
        if option.kind == OptionKind::Flag {
            // Its value may be left out.
            return [values, names(options)].concat();
        }
        if option.kind != OptionKind::Action || !option.parameters.is_empty() {
            return values;
        }
    }
    names(options)
}

fn names(options: &[OptionInfo]) -> Vec<Candidate> {
    let own = options
        .iter()
        .map(|option| candidate(&format!("-{}", option.name), &option.help));
    let always = [
        candidate("-help", "what CTRL understands"),
        candidate("-dump", "the state, as options"),
    ];
    own.chain(always).collect()
}

fn named<'a>(options: &'a [OptionInfo], word: &str) -> Option<&'a OptionInfo> {
    let name = word.strip_prefix('-')?;
    options.iter().find(|option| option.name == name)
}

fn candidate(word: &str, about: &str) -> Candidate {
    Candidate {
        word: word.to_owned(),
        about: about.to_owned(),
        ends: true,
    }
}

/// What should come next after `text`, the whole line, as one short text; empty when nothing is to be
/// said.
#[must_use]
pub fn hint(text: &str, known: Known<'_>) -> String {
    let line = Line::new(text);
    if !line.begun.is_empty() {
        return String::new();
    }
    match line.done.as_slice() {
        [name] if class_of(name, known).is_some() => "EXEC | CTRL | DBX".to_owned(),
        [name, "EXEC", rest @ ..] => match class_of(name, known) {
            Some(class) => next_of_request(class, rest),
            None => String::new(),
        },
        [name, "CTRL", rest @ ..] => match class_of(name, known) {
            Some(class) => next_of_option(&class.options, rest),
            None => String::new(),
        },
        [_, "DBX", rest @ ..] => next_of_option(&describe::dbx_options(), rest),
        _ => String::new(),
    }
}

fn next_of_request(class: &ClassInfo, rest: &[&str]) -> String {
    let rest = rest.strip_prefix(&["TMSG"]).unwrap_or(rest);
    let takes = |form: &FormInfo| match form.floats {
        Form::ANY => format!("numbers <{}>", form.takes),
        count => format!("{count} numbers <{}>", form.takes),
    };
    match rest {
        [] => {
            let texts = class.forms.iter().map(|form| match form.text.as_str() {
                "" if form.floats > 0 => takes(form),
                text => text.to_owned(),
            });
            let texts: Vec<String> = texts.filter(|text| !text.is_empty()).collect();
            texts.join(" | ")
        }
        [text] => {
            let begins = |form: &&FormInfo| form.text.split(' ').next() == Some(*text);
            let Some(form) = class.forms.iter().find(begins) else {
                return String::new();
            };
            match form.text.split_once(' ') {
                Some((_, name)) => format!("<{name}> {}", form.help),
                None if form.floats > 0 => takes(form),
                None => String::new(),
            }
        }
        _ => String::new(),
    }
}

fn next_of_option(options: &[OptionInfo], rest: &[&str]) -> String {
    // The option nearest to the cursor, with as many words after it as it takes at most.
    let words = rest.iter().rev().enumerate();
    let near = words
        .filter_map(|(after, word)| Some((after, named(options, word)?)))
        .next();
    let Some((after, option)) = near else {
        return "-option ..., -help lists them".to_owned();
    };
    let takes = match option.kind {
        OptionKind::Flag => return String::new(),
        OptionKind::Action | OptionKind::Floats | OptionKind::Ints => option.parameters.len(),
        _ => 1,
    };
    if after >= takes {
        return String::new();
    }
    let form = option.form();
    let default = option.default.as_ref();
    let default = default.map(|value| format!(" = {value}"));
    format!("<{form}{}> {}", default.unwrap_or_default(), option.help)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::services::CLASSES;

    fn of(text: &str) -> Vec<String> {
        let names = ["kin.puma560", "foo.a", "d1"].map(str::to_owned);
        let variables = ["home".to_owned()];
        let known = Known {
            classes: &CLASSES,
            names: &names,
            daemons: &[],
            variables: &variables,
        };
        let (start, found) = candidates(text, known);
        assert!(start <= text.len());
        found.into_iter().map(|candidate| candidate.word).collect()
    }

    fn hinted(text: &str) -> String {
        let known = Known {
            classes: &CLASSES,
            names: &[],
            daemons: &[],
            variables: &[],
        };
        hint(text, known)
    }

    #[test]
    fn names_methods_requests_options_and_values_are_offered_where_they_stand() {
        assert_eq!(of("k"), ["kin", "kin.puma560"]);
        assert_eq!(of("re"), ["resect", "repeat"]);
        assert_eq!(of("kin.puma560 "), ["EXEC", "CTRL", "DBX"]);
        assert_eq!(
            of("kin.puma560 EXEC "),
            ["fkine", "jacobian", "ikine", "TMSG"]
        );
        assert_eq!(of("kin EXEC TMSG f"), ["fkine"]);
        assert_eq!(of("repeat 10 dyn.puma560 EXEC g"), ["gravity"]);
        assert_eq!(of("time dyn.puma560 CTRL -ro"), ["-rotor"]);
        assert_eq!(of("resect CTRL -model "), ["none", "k1", "k1k2", "brown5"]);
        assert_eq!(of("resect CTRL -model k1 -s"), ["-size", "-seed", "-sd"]);
        assert_eq!(of("resect CTRL -size "), Vec::<String>::new());
        assert_eq!(of("spot CTRL -threshold "), ["auto"]);
        assert!(of("dyn CTRL -rotor ").starts_with(&["on".to_owned(), "off".to_owned()]));
        assert_eq!(of("foo.a DBX -ver"), ["-verbosity", "-version"]);
        assert_eq!(of("kin EXEC TMSG fkine FMSG 6 $ho"), ["$home"]);
        assert_eq!(of("FOO.a CTRL -whe"), ["-where"]);
        assert_eq!(of("nobody CTRL "), Vec::<String>::new());
    }

    #[test]
    fn hints_have_units_and_ranges() {
        assert_eq!(hinted("kin "), "EXEC | CTRL | DBX");
        assert_eq!(hinted("kin EXEC "), "fkine | jacobian | ikine");
        let fkine = hinted("kin EXEC TMSG fkine ");
        assert_eq!(fkine, "6 numbers <joint positions q1 to q6, rad>");
        let gravity = hinted("dyn CTRL -gravity ");
        assert!(
            gravity.starts_with("<0.0..100.0 m/s^2 = 9.81> "),
            "{gravity}"
        );
        let size = hinted("resect CTRL -size 640 ");
        assert!(size.starts_with("<W H, each 1..100000 px> "), "{size}");
        assert_eq!(hinted("resect CTRL -size 640 480 "), "");
        assert_eq!(hinted("kin EXEC fki"), "");
    }

    #[test]
    fn no_beginning_of_a_line_is_too_strange() {
        for text in [
            "",
            " ",
            "$",
            "é",
            "time",
            "repeat x ",
            "foo EXEC é ",
            "a@b.c CTRL -é ",
        ] {
            let _ = (of(text), hinted(text));
        }
    }
}
