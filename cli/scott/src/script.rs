//! The grammar of scripts: one statement a line, which is also what is typed at the prompt.
//!
//! ```text
//! set NAME = WORDS         a variable; $NAME and ${NAME} stand for it from then on, $$ for a dollar
//! expect RET 0             also TMSG, FMSG (within TOLERANCE), IMSG, TDBX: what the last reply must be
//! time REQUEST             the reply and how long it took
//! repeat 1000 REQUEST      the last reply, and the least, the median and the longest time
//! trace REQUEST            everything that it leads to
//! watch PATTERN            the requests that objects meet, with their replies
//! help [NAME]              how one asks, or what an object can do; also `?` and `NAME ?`
//! list [TEXT]              the objects and classes that there are
//! REQUEST                  name EXEC|CTRL|DBX text
//! ```
//!
//! A word that begins with `#` begins a comment. $RET, $TMSG, $FMSG and $IMSG are those of the last
//! reply, the numbers with their count.

use std::collections::BTreeMap;

use ctos::diagnostic::Finding;
use sorma::{Reply, Transport, words};

use super::watch::Wanted;

/// The words that begin a statement other than a request.
pub const STATEMENTS: [(&str, &str); 8] = [
    ("set", "set NAME = WORDS: a variable, used as $NAME"),
    (
        "expect",
        "expect RET 0, expect FMSG 3 1 2 3 within 1e-6: what the last reply must be",
    ),
    ("time", "time REQUEST: how long it takes"),
    (
        "repeat",
        "repeat 1000 REQUEST: least, median and longest time",
    ),
    ("trace", "trace REQUEST: everything that it leads to"),
    (
        "help",
        "help [NAME]: how one asks, or what an object can do",
    ),
    (
        "list",
        "list [TEXT]: the objects and classes that there are",
    ),
    (
        "watch",
        "watch PATTERN[@DAEMON] [--kind EXEC] [--slower 50ms] [--failed] [--count N] [&]",
    ),
];

/// The most repetitions.
const MOST_REPEATS: u64 = 10_000_000;

/// Variables replaced in a line make it at most this long, bytes.
const LONGEST: usize = 64 << 20;

/// One line of a script.
#[derive(Debug, Clone, PartialEq)]
pub enum Statement {
    /// Nothing but white space or a comment.
    Nothing,
    /// A variable.
    Set {
        /// Its name.
        name: String,
        /// What it stands for.
        words: String,
    },
    /// What the last reply must be.
    Expect(Expectation),
    /// A request, as text.
    Request(String),
    /// A request that is timed.
    Time(String),
    /// A request that is timed often.
    Repeat(u64, String),
    /// A request that is followed.
    Trace(String),
    /// The requests of others.
    Watch(Wanted),
    /// What an object can do, or without a name how one asks.
    Help(Option<String>),
    /// What there is with this text in its name.
    List(String),
}

/// What a reply must be; what is `None` may be anything.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Expectation {
    /// The return code.
    pub code: Option<i32>,
    /// The text.
    pub text: Option<String>,
    /// The floats.
    pub floats: Option<Vec<f64>>,
    /// How far a float may be off.
    pub within: f64,
    /// The whole numbers.
    pub ints: Option<Vec<i64>>,
    /// What one of the reports must say.
    pub message: Option<String>,
}

/// Variables by name.
pub type Variables = BTreeMap<String, String>;

/// Reads a statement whose variables are replaced.
///
/// # Errors
/// What is wrong, and what would have been right.
pub fn read(line: &str) -> Result<Statement, String> {
    // A request's own quotes are the request's to judge; a comment is found either way.
    let line = match words::split_commented(line) {
        Ok((_, end)) => line.get(..end).unwrap_or(line).trim(),
        Err(_) => line.trim(),
    };
    let mut parts = line.splitn(3, |letter: char| letter.is_ascii_whitespace());
    let (first, second) = (parts.next().unwrap_or(""), parts.next().unwrap_or(""));
    let rest = line.get(first.len()..).unwrap_or("").trim();
    // An object may be called as a statement is: a method after it makes it a request.
    if ["EXEC", "CTRL", "DBX"].contains(&second) {
        return Ok(Statement::Request(line.to_owned()));
    }
    let one = |word: &str| Some(word.to_owned()).filter(|word| !word.is_empty());
    if second == "?" && parts.next().is_none_or(|more| more.trim().is_empty()) {
        return Ok(Statement::Help(one(first)));
    }
    match first {
        "" => Ok(Statement::Nothing),
        "help" | "?" => Ok(Statement::Help(one(rest))),
        "list" => Ok(Statement::List(rest.to_owned())),
        "set" => set(rest),
        "expect" => expect(rest).map(Statement::Expect),
        "time" if rest.is_empty() => Err("after time stands a request".to_owned()),
        "time" => Ok(Statement::Time(rest.to_owned())),
        "repeat" => repeat(rest),
        "trace" if rest.is_empty() => Err("after trace stands a request".to_owned()),
        "trace" => Ok(Statement::Trace(rest.to_owned())),
        "watch" => Wanted::read(rest).map(Statement::Watch),
        _ => Ok(Statement::Request(line.to_owned())),
    }
}

fn set(rest: &str) -> Result<Statement, String> {
    let wrong = || format!("write: set NAME = WORDS, not `set {}`", cut(rest));
    let (name, words) = rest.split_once('=').ok_or_else(wrong)?;
    let name = name.trim();
    if !is_name(name) {
        return Err(wrong());
    }
    if REPLY.contains(&name) {
        return Err(format!("${name} is the last reply's and cannot be set"));
    }
    Ok(Statement::Set {
        name: name.to_owned(),
        words: words.trim().to_owned(),
    })
}

fn repeat(rest: &str) -> Result<Statement, String> {
    let wrong = || format!("write: repeat COUNT REQUEST, with a count from 1 to {MOST_REPEATS}");
    let (count, request) = rest
        .split_once(|letter: char| letter.is_ascii_whitespace())
        .ok_or_else(wrong)?;
    let count = count.parse().ok();
    let count = count.filter(|count| (1..=MOST_REPEATS).contains(count));
    Ok(Statement::Repeat(
        count.ok_or_else(wrong)?,
        request.trim().to_owned(),
    ))
}

/// Reads what stands after `expect`: the parts of a reply that matter, and a tolerance at the end.
fn expect(rest: &str) -> Result<Expectation, String> {
    const FORM: &str = "write: expect RET 0, expect TMSG text, expect FMSG 2 0.5 1 within 1e-6, expect IMSG 1 4, expect TDBX text";
    let split = words::split(rest).map_err(|error| error.to_string())?;
    let mut expected = Expectation::default();
    let mut end = rest.len();
    if let [.., within, tolerance] = split.as_slice()
        && within.text == "within"
        && !within.quoted
    {
        let number = tolerance.text.parse().ok();
        expected.within = number
            .filter(|number: &f64| number.is_finite() && *number >= 0.0)
            .ok_or_else(|| format!("after within stands a number, not `{}`", tolerance.text))?;
        end = within.span.start;
    }
    let body = rest.get(..end).unwrap_or(rest).trim();
    let words = words::split(body).map_err(|error| error.to_string())?;
    let has = |keyword: &str| {
        let mut found = words.iter();
        found.any(|word| !word.quoted && word.text == keyword)
    };
    let first = words.first().map_or("", |word| word.text.as_str());
    const KEYWORDS: [&str; 5] = ["RET", "TMSG", "FMSG", "IMSG", "TDBX"];
    if !KEYWORDS.contains(&first) {
        let help = suggested(first, KEYWORDS);
        return Err(format!(
            "expect cannot begin with `{}`{help}; {FORM}",
            cut(first)
        ));
    }
    let reply = if first == "RET" {
        format!("x {body}")
    } else {
        format!("x RET 0 {body}")
    };
    let reply: Reply = reply.parse().map_err(|error| format!("{error}; {FORM}"))?;
    let Transport {
        text,
        floats,
        ints,
        code,
        reports,
        ..
    } = reply.body;
    expected.code = (first == "RET").then_some(code);
    expected.text = has("TMSG").then_some(text);
    expected.floats = has("FMSG").then_some(floats);
    expected.ints = has("IMSG").then_some(ints);
    expected.message = has("TDBX").then(|| {
        let texts: Vec<String> = reports.into_iter().map(|report| report.text).collect();
        texts.join("\n")
    });
    Ok(expected)
}

impl Expectation {
    /// What of a reply is not as it must be.
    #[must_use]
    pub fn unmet(&self, reply: &Transport) -> Vec<String> {
        let mut unmet = Vec::new();
        if let Some(code) = self.code.filter(|code| *code != reply.code) {
            unmet.push(format!("expected RET {code}, got {}", reply.code));
        }
        if let Some(text) = self.text.as_ref().filter(|text| **text != reply.text) {
            unmet.push(format!("expected TMSG {text:?}, got {:?}", reply.text));
        }
        unmet.extend(
            self.floats
                .as_ref()
                .and_then(|floats| self.unmet_floats(floats, &reply.floats)),
        );
        if let Some(ints) = self.ints.as_ref().filter(|ints| **ints != reply.ints) {
            unmet.push(format!("expected IMSG {ints:?}, got {:?}", reply.ints));
        }
        if let Some(message) = &self.message
            && !reply
                .reports
                .iter()
                .any(|report| report.text.contains(message.as_str()))
        {
            unmet.push(format!("expected a report that says {message:?}"));
        }
        unmet
    }

    fn unmet_floats(&self, expected: &[f64], found: &[f64]) -> Option<String> {
        if expected.len() != found.len() {
            let (want, got) = (expected.len(), found.len());
            return Some(format!("expected FMSG with {want} floats, got {got}"));
        }
        let far = |(expected, found): &(&f64, &f64)| {
            let same = expected == found || expected.is_nan() && found.is_nan();
            // Of a NaN nothing is near.
            let near = (*expected - *found).abs() <= self.within;
            !same && !near
        };
        let pairs = expected.iter().zip(found);
        let (index, (expected, found)) = pairs.enumerate().find(|(_, pair)| far(pair))?;
        Some(format!(
            "expected FMSG value {} to be {expected:?} within {:?}, got {found:?} (off by {:e})",
            index + 1,
            self.within,
            (expected - found).abs()
        ))
    }
}

/// The variables that the last reply sets.
pub const REPLY: [&str; 4] = ["RET", "TMSG", "FMSG", "IMSG"];

/// Replaces the variables of a line.
///
/// # Errors
/// A name that nothing was set for, a `$` without a name, a line that grows without measure.
pub fn replace(line: &str, variables: &Variables) -> Result<String, String> {
    let mut out = String::with_capacity(line.len());
    let mut rest = line;
    while let Some(at) = rest.find('$') {
        let (before, dollar) = rest.split_at(at);
        out.push_str(before);
        let after = dollar.get(1..).unwrap_or_default();
        if let Some(after) = after.strip_prefix('$') {
            out.push('$');
            rest = after;
            continue;
        }
        let (name, next) = match after.strip_prefix('{') {
            Some(inside) => inside
                .split_once('}')
                .ok_or_else(|| format!("the brace of `${}` is not closed", cut(after)))?,
            None => after.split_at(
                after
                    .find(|letter: char| !is_letter(letter))
                    .unwrap_or(after.len()),
            ),
        };
        if !is_name(name) {
            return Err("after `$` stands the name of a variable; `$$` is a dollar".to_owned());
        }
        let Some(words) = variables.get(name) else {
            let help = suggested(name, variables.keys().map(String::as_str));
            return Err(format!("nothing was set for `${}`{help}", cut(name)));
        };
        out.push_str(words);
        if out.len() > LONGEST {
            return Err(format!(
                "with its variables the line is over {LONGEST} bytes"
            ));
        }
        rest = next;
    }
    out.push_str(rest);
    Ok(out)
}

fn is_letter(letter: char) -> bool {
    letter.is_ascii_alphanumeric() || letter == '_'
}

fn is_name(text: &str) -> bool {
    text.starts_with(|first: char| first.is_ascii_alphabetic()) && text.chars().all(is_letter)
}

/// "did you mean" after a semicolon, or nothing.
fn suggested<'a>(given: &str, known: impl IntoIterator<Item = &'a str>) -> String {
    if given.len() > 100 {
        return String::new();
    }
    let help = Finding::error("scott", "").suggest(given, known).help;
    help.map(|help| format!("; {help}")).unwrap_or_default()
}

/// The beginning of a text that may be of any length.
fn cut(text: &str) -> String {
    text.chars().take(60).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn statements_are_told_apart_and_comments_left_out() {
        let request = |text: &str| Ok(Statement::Request(text.to_owned()));
        assert_eq!(read("  # only this"), Ok(Statement::Nothing));
        assert_eq!(read("bar EXEC # now"), request("bar EXEC"));
        assert_eq!(
            read("foo CTRL -drink '#1'"),
            request("foo CTRL -drink '#1'")
        );
        assert_eq!(read("time EXEC x"), request("time EXEC x"));
        assert_eq!(read("help EXEC"), request("help EXEC"));
        let help = |name: Option<&str>| Ok(Statement::Help(name.map(str::to_owned)));
        assert_eq!(read("help"), help(None));
        assert_eq!(read("?"), help(None));
        assert_eq!(read("? foo.a"), help(Some("foo.a")));
        assert_eq!(read("foo.a ? # what"), help(Some("foo.a")));
        assert_eq!(read("list foo"), Ok(Statement::List("foo".to_owned())));
        assert_eq!(
            read("repeat 10 bar EXEC"),
            Ok(Statement::Repeat(10, "bar EXEC".to_owned()))
        );
        assert_eq!(
            read("set q = 0 1.5 'a b'"),
            Ok(Statement::Set {
                name: "q".to_owned(),
                words: "0 1.5 'a b'".to_owned()
            })
        );
        for wrong in [
            "set q 1",
            "set 1 = 2",
            "set RET = 2",
            "repeat 0 bar EXEC",
            "repeat bar EXEC",
            "time",
            "expect",
            "expect RET",
            "expect FMGS 1 2",
            "expect FMSG 2 1",
            "expect FMSG 1 1 within -1",
        ] {
            assert!(read(wrong).is_err(), "{wrong}");
        }
    }

    #[test]
    fn variables_stand_for_words() {
        let variables: Variables = [("q".to_owned(), "1 2".to_owned())].into();
        let of = |line: &str| replace(line, &variables);
        assert_eq!(of("FMSG 2 $q").as_deref(), Ok("FMSG 2 1 2"));
        assert_eq!(of("${q}3 $$q").as_deref(), Ok("1 23 $q"));
        let unknown = of("$qq").unwrap_err();
        assert_eq!(unknown, "nothing was set for `$qq`; did you mean `q`?");
        assert!(of("$ 1").is_err() && of("${q").is_err());
    }

    #[test]
    fn an_expectation_looks_at_what_it_names_and_no_more() {
        let Ok(Statement::Expect(expected)) = read("expect RET 0 FMSG 2 1 2 within 0.1") else {
            panic!("no expectation");
        };
        let mut reply = Transport::floats([1.05, 2.0]);
        reply.text = "anything".to_owned();
        assert!(expected.unmet(&reply).is_empty());
        reply.floats[1] = 2.2;
        assert_eq!(expected.unmet(&reply).len(), 1);
        reply.floats[1] = f64::NAN;
        reply.code = 5;
        assert_eq!(expected.unmet(&reply).len(), 2);
        let Ok(Statement::Expect(text)) = read("expect TMSG anything") else {
            panic!("no expectation");
        };
        assert!(text.unmet(&reply).is_empty());
    }
}
