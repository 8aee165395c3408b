//! The little logic of a panel: values that are read of answers, and what follows from them. It is not a program: it has no
//! variables of its own, no loops, and it asks nothing. What may happen to an arm is for the arm's object to say, not for
//! a page.
//!
//! ```text
//! abs(waist) > 2.5 and state == 'active'
//! or   and   not   == != < <= > >=   + -   * /   -x   ( )   abs(x) min(x, y) max(x, y)   12.5   'text'   NAME
//! ```

use std::collections::BTreeMap;

use ctos::diagnostic::Finding;
use serde::{Deserialize, Serialize};
use sorma::Transport;

/// The longest expression, bytes.
const LONGEST: usize = 1000;
/// Parentheses, `not` and `-` within one another at most.
const DEEPEST: usize = 50;

/// Something of an answer, by a name.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Value {
    /// Its name in expressions.
    pub name: String,
    /// The line that is asked.
    pub ask: String,
    /// Which float of the answer it is, from 1.
    pub float: Option<usize>,
    /// Which whole number of the answer, from 1.
    pub int: Option<usize>,
    /// Which word of the answer's text, from 1.
    pub word: Option<usize>,
}

/// What an expression is worth.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Worth {
    Number(f64),
    Text(String),
    Truth(bool),
}

/// The kind of a worth, which is known before anything is asked.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Kind {
    Number,
    Text,
    Truth,
}

impl Kind {
    fn word(self) -> &'static str {
        match self {
            Self::Number => "a number",
            Self::Text => "a text",
            Self::Truth => "a condition",
        }
    }
}

impl Value {
    /// What is wrong with it.
    ///
    /// # Errors
    /// Which key, and what would have been right.
    pub(super) fn check(&self) -> Result<(), String> {
        let name = &self.name;
        let plain = |letter: char| letter.is_ascii_alphanumeric() || letter == '_';
        let begins = name.starts_with(|first: char| first.is_ascii_alphabetic());
        if !begins || !name.chars().all(plain) || WORDS.contains(&name.as_str()) {
            return Err(format!(
                "value `{name}`: a name has letters, digits and `_`, begins with a letter and is none of {}",
                WORDS.join(", ")
            ));
        }
        let parts = [self.float, self.int, self.word];
        match parts.iter().flatten().collect::<Vec<_>>().as_slice() {
            [0] => return Err(format!("value `{name}`: parts are counted from 1")),
            [_] => {}
            _ => {
                return Err(format!(
                    "value `{name}`: say which part of the answer it is by one of `float`, `int` and `word`"
                ));
            }
        }
        let ask = &self.ask;
        let request = ask.parse::<sorma::Request>();
        let request = request.map(|_| ());
        request.map_err(|error| format!("value `{name}`: `{ask}` is no request: {error}"))
    }

    fn kind(&self) -> Kind {
        match self.word {
            Some(_) => Kind::Text,
            None => Kind::Number,
        }
    }

    /// Its worth in an answer; `None` when the answer does not have it.
    pub(super) fn of(&self, answer: &Transport) -> Option<Worth> {
        if !answer.is_ok() {
            return None;
        }
        let at = |number: usize| number.checked_sub(1);
        if let Some(word) = self.word {
            let word = answer.text.split_whitespace().nth(at(word)?)?;
            let word = word.trim_end_matches([',', ';', ':', '.']);
            return Some(Worth::Text(word.to_owned()));
        }
        let number = match (self.float, self.int) {
            (Some(float), _) => *answer.floats.get(at(float)?)?,
            #[expect(clippy::cast_precision_loss, reason = "a page shows it")]
            (None, int) => *answer.ints.get(at(int?)?)? as f64,
        };
        Some(Worth::Number(number))
    }
}

impl Worth {
    /// For a page.
    pub(super) fn shown(&self) -> String {
        match self {
            Self::Number(number) => {
                let text = format!("{number:.4}");
                match text.contains('.') {
                    true => text.trim_end_matches('0').trim_end_matches('.').to_owned(),
                    false => text,
                }
            }
            Self::Text(text) => text.clone(),
            Self::Truth(true) => "yes".to_owned(),
            Self::Truth(false) => "no".to_owned(),
        }
    }
}

/// Words that are no names.
const WORDS: [&str; 6] = ["or", "and", "not", "abs", "min", "max"];

/// What follows from values.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Expression {
    Worth(Worth),
    Value(String),
    Not(Box<Self>),
    Minus(Box<Self>),
    Abs(Box<Self>),
    Of(&'static str, Box<Self>, Box<Self>),
}

/// Signs of two sides, those that bind least before those that bind more.
const LEVELS: [&[&str]; 5] = [
    &["or"],
    &["and"],
    &["==", "!=", "<=", ">=", "<", ">"],
    &["+", "-"],
    &["*", "/"],
];

impl Expression {
    /// Reads an expression about these values.
    ///
    /// # Errors
    /// What is wrong, and where in the text.
    pub(super) fn read(text: &str, values: &[Value]) -> Result<Self, String> {
        if text.len() > LONGEST {
            return Err(format!("an expression has at most {LONGEST} bytes"));
        }
        let mut reader = Reader {
            text,
            at: 0,
            depth: 0,
        };
        let expression = reader.level(0)?;
        reader.space();
        if reader.at < text.len() {
            return Err(reader.wrong("an operator or the end"));
        }
        expression.kind(values)?;
        Ok(expression)
    }

    /// The kind of what it is worth.
    ///
    /// # Errors
    /// A name that no value has, or sides that do not go together.
    pub(super) fn kind(&self, values: &[Value]) -> Result<Kind, String> {
        let must = |side: &Self, kind: Kind, sign: &str| match side.kind(values)? {
            own if own == kind => Ok(kind),
            own => Err(format!(
                "`{sign}` takes {}, not {}",
                kind.word(),
                own.word()
            )),
        };
        match self {
            Self::Worth(Worth::Number(_)) => Ok(Kind::Number),
            Self::Worth(Worth::Text(_)) => Ok(Kind::Text),
            Self::Worth(Worth::Truth(_)) => Ok(Kind::Truth),
            Self::Value(name) => {
                let mut known = values.iter();
                let found = known.find(|value| value.name == *name);
                found.map(Value::kind).ok_or_else(|| {
                    let names = values.iter().map(|value| value.name.as_str());
                    let help = Finding::error("scott", "").suggest(name, names).help;
                    let help = help.map(|help| format!("; {help}")).unwrap_or_default();
                    format!("there is no value `{name}`{help}")
                })
            }
            Self::Not(side) => must(side, Kind::Truth, "not"),
            Self::Minus(side) => must(side, Kind::Number, "-"),
            Self::Abs(side) => must(side, Kind::Number, "abs"),
            Self::Of(sign, one, other) => match *sign {
                "or" | "and" => {
                    must(one, Kind::Truth, sign)?;
                    must(other, Kind::Truth, sign)
                }
                "==" | "!=" => {
                    let kind = one.kind(values)?;
                    must(other, kind, sign)?;
                    Ok(Kind::Truth)
                }
                _ => {
                    must(one, Kind::Number, sign)?;
                    must(other, Kind::Number, sign)?;
                    let is_compared = ["<", "<=", ">", ">="].contains(sign);
                    Ok(if is_compared {
                        Kind::Truth
                    } else {
                        Kind::Number
                    })
                }
            },
        }
    }

    /// What it is worth; `None` when a value that it needs is not there.
    pub(super) fn worth(&self, values: &BTreeMap<String, Worth>) -> Option<Worth> {
        let number = |side: &Self| match side.worth(values)? {
            Worth::Number(number) => Some(number),
            _ => None,
        };
        let truth = |side: &Self| match side.worth(values)? {
            Worth::Truth(truth) => Some(truth),
            _ => None,
        };
        match self {
            Self::Worth(worth) => Some(worth.clone()),
            Self::Value(name) => values.get(name).cloned(),
            Self::Not(side) => Some(Worth::Truth(!truth(side)?)),
            Self::Minus(side) => Some(Worth::Number(-number(side)?)),
            Self::Abs(side) => Some(Worth::Number(number(side)?.abs())),
            Self::Of(sign, one, other) => Some(match *sign {
                "or" => Worth::Truth(truth(one)? || truth(other)?),
                "and" => Worth::Truth(truth(one)? && truth(other)?),
                "==" => Worth::Truth(one.worth(values)? == other.worth(values)?),
                "!=" => Worth::Truth(one.worth(values)? != other.worth(values)?),
                "<" => Worth::Truth(number(one)? < number(other)?),
                "<=" => Worth::Truth(number(one)? <= number(other)?),
                ">" => Worth::Truth(number(one)? > number(other)?),
                ">=" => Worth::Truth(number(one)? >= number(other)?),
                "+" => Worth::Number(number(one)? + number(other)?),
                "-" => Worth::Number(number(one)? - number(other)?),
                "*" => Worth::Number(number(one)? * number(other)?),
                "/" => Worth::Number(number(one)? / number(other)?),
                "min" => Worth::Number(number(one)?.min(number(other)?)),
                "max" => Worth::Number(number(one)?.max(number(other)?)),
                _ => return None,
            }),
        }
    }
}

/// Reads an expression from left to right.
struct Reader<'a> {
    text: &'a str,
    at: usize,
    depth: usize,
}

impl Reader<'_> {
    fn rest(&self) -> &str {
        self.text.get(self.at..).unwrap_or_default()
    }

    fn space(&mut self) {
        let rest = self.rest();
        self.at += rest.len() - rest.trim_start().len();
    }

    fn wrong(&self, expected: &str) -> String {
        let found: String = self.rest().chars().take(20).collect();
        let found = match found.as_str() {
            "" => "the end".to_owned(),
            found => format!("`{found}`"),
        };
        format!(
            "in `{}` at byte {}: {expected} is expected, not {found}",
            self.text,
            self.at + 1
        )
    }

    /// Takes a sign, or a word that is not the beginning of a longer one.
    fn takes(&mut self, sign: &str) -> bool {
        self.space();
        let Some(after) = self.rest().strip_prefix(sign) else {
            return false;
        };
        let is_word = sign.starts_with(|first: char| first.is_ascii_alphabetic());
        let goes_on = |next: char| next.is_ascii_alphanumeric() || next == '_';
        if is_word && after.starts_with(goes_on) {
            return false;
        }
        self.at += sign.len();
        true
    }

    fn level(&mut self, level: usize) -> Result<Expression, String> {
        let Some(signs) = LEVELS.get(level) else {
            return self.deeper(Self::one);
        };
        let mut left = self.level(level + 1)?;
        while let Some(sign) = signs.iter().copied().find(|sign| self.takes(sign)) {
            let right = self.level(level + 1)?;
            left = Expression::Of(sign, Box::new(left), Box::new(right));
        }
        Ok(left)
    }

    /// One that is within others.
    fn deeper(
        &mut self,
        read: impl Fn(&mut Self) -> Result<Expression, String>,
    ) -> Result<Expression, String> {
        self.depth += 1;
        if self.depth > DEEPEST {
            return Err(format!(
                "more than {DEEPEST} parts stand within one another"
            ));
        }
        let read = read(self);
        self.depth -= 1;
        read
    }

    fn closed(&mut self) -> Result<(), String> {
        match self.takes(")") {
            true => Ok(()),
            false => Err(self.wrong("`)`")),
        }
    }

    fn one(&mut self) -> Result<Expression, String> {
        if self.takes("not") {
            // It binds less than what is compared: `not a < b`.
            let side = self.deeper(|reader| reader.level(2))?;
            return Ok(Expression::Not(Box::new(side)));
        }
        if self.takes("-") {
            let side = self.deeper(Self::one)?;
            return Ok(Expression::Minus(Box::new(side)));
        }
        if self.takes("(") {
            let inner = self.level(0)?;
            self.closed()?;
            return Ok(inner);
        }
        for function in ["abs", "min", "max"] {
            if self.takes(function) {
                return self.function(function);
            }
        }
        self.word()
    }

    fn function(&mut self, name: &'static str) -> Result<Expression, String> {
        if !self.takes("(") {
            return Err(self.wrong("`(`"));
        }
        let one = Box::new(self.level(0)?);
        if name == "abs" {
            self.closed()?;
            return Ok(Expression::Abs(one));
        }
        if !self.takes(",") {
            return Err(self.wrong("`,`"));
        }
        let other = Box::new(self.level(0)?);
        self.closed()?;
        Ok(Expression::Of(name, one, other))
    }

    /// A number, a text or the name of a value.
    fn word(&mut self) -> Result<Expression, String> {
        self.space();
        let rest = self.rest();
        if let Some(text) = rest.strip_prefix('\'') {
            let Some((text, _)) = text.split_once('\'') else {
                return Err(self.wrong("the end of a text"));
            };
            let worth = Worth::Text(text.to_owned());
            self.at += text.len() + 2;
            return Ok(Expression::Worth(worth));
        }
        let own = |letter: char| letter.is_ascii_alphanumeric() || "_.".contains(letter);
        let end = rest.find(|letter| !own(letter)).unwrap_or(rest.len());
        let word = rest.get(..end).unwrap_or_default().to_owned();
        let expression = match word.chars().next() {
            Some(first) if first.is_ascii_digit() || first == '.' => {
                let number = word.parse::<f64>().ok();
                number.map(|number| Expression::Worth(Worth::Number(number)))
            }
            Some(first) if first.is_ascii_alphabetic() && !WORDS.contains(&word.as_str()) => {
                Some(Expression::Value(word))
            }
            _ => None,
        };
        let expression = expression.ok_or_else(|| self.wrong("a number, a 'text' or a value"))?;
        self.at += end;
        Ok(expression)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn value(name: &str, word: bool) -> Value {
        Value {
            name: name.to_owned(),
            ask: "foo.a EXEC".to_owned(),
            float: (!word).then_some(1),
            int: None,
            word: word.then_some(1),
        }
    }

    fn values() -> Vec<Value> {
        vec![value("x", false), value("y", false), value("state", true)]
    }

    fn worth(text: &str) -> String {
        let known = [
            ("x".to_owned(), Worth::Number(3.0)),
            ("y".to_owned(), Worth::Number(-0.5)),
            ("state".to_owned(), Worth::Text("active".to_owned())),
        ];
        let expression = Expression::read(text, &values()).unwrap();
        let worth = expression.worth(&known.into()).unwrap();
        worth.shown()
    }

    #[test]
    fn signs_bind_as_in_mathematics() {
        for (text, expected) in [
            ("1 + 2 * x", "7"),
            ("(1 + 2) * x", "9"),
            ("-x - -y", "-3.5"),
            ("abs(y) / 4", "0.125"),
            ("max(x, min(y, 7))", "3"),
            ("x > 2.5 and state == 'active'", "yes"),
            ("not x < 2 and y < 0", "yes"),
            ("x < 2 or state != 'cold'", "yes"),
            ("1 - 2 - 3", "-4"),
            ("state", "active"),
            ("x >= 3", "yes"),
        ] {
            assert_eq!(worth(text), expected, "{text}");
        }
    }

    #[test]
    fn what_cannot_be_meant_is_said_with_its_place() {
        for (text, part) in [
            (
                "x +",
                "byte 4: a number, a 'text' or a value is expected, not the end",
            ),
            ("x y", "an operator or the end"),
            ("z > 1", "there is no value `z`"),
            ("stat == 'cold'", "did you mean `state`?"),
            ("state > 1", "`>` takes a number, not a text"),
            ("x and y", "`and` takes a condition, not a number"),
            ("x == 'cold'", "takes a number, not a text"),
            ("(x", "`)`"),
            ("'open", "the end of a text"),
            ("min(x)", "`,`"),
            ("1.2.3", "a number"),
            ("x > 1 > 2", "takes a number, not a condition"),
            ("", "the end"),
            ("é", "a number"),
        ] {
            let why = Expression::read(text, &values()).unwrap_err();
            assert!(why.contains(part), "{text}: {why}");
        }
        for bomb in [
            "(".repeat(900),
            "-".repeat(900),
            "not ".repeat(200),
            "x".repeat(2000),
        ] {
            assert!(Expression::read(&bomb, &values()).is_err());
        }
    }

    #[test]
    fn without_an_answer_nothing_follows() {
        let expression = Expression::read("x > 1 or y > 1", &values()).unwrap();
        assert_eq!(expression.worth(&BTreeMap::new()), None);
    }

    #[test]
    fn a_value_is_the_part_of_the_answer_that_it_names() {
        let mut answer = Transport::floats([1.5, 2.5]);
        answer.text = "active, servo".to_owned();
        answer.ints = vec![7];
        let mut value = value("v", false);
        value.float = Some(2);
        assert_eq!(value.of(&answer), Some(Worth::Number(2.5)));
        value.float = Some(3);
        assert_eq!(value.of(&answer), None);
        (value.float, value.int) = (None, Some(1));
        assert_eq!(value.of(&answer), Some(Worth::Number(7.0)));
        (value.int, value.word) = (None, Some(2));
        assert_eq!(value.of(&answer), Some(Worth::Text("servo".to_owned())));
        answer.code = 5;
        assert_eq!(value.of(&answer), None);
        value.int = Some(1);
        assert!(value.check().is_err(), "two parts");
        value.name = "and".to_owned();
        assert!(value.check().is_err());
    }
}
