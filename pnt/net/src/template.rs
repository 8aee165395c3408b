//! The line of a request with its values left open. The line is read once, with a mark where each value belongs; a
//! value then goes into the finished request as data. So no value can become a name, a method or a further word.

use ctos::diagnostic::Finding;
use pnt::{
    data::{Kind, Value},
    net::{Line, LinePart},
};
use sorma::{Method, ObjectName, Request, words};

use super::served;

/// The first of the characters that stand for values; Unicode leaves them to private use.
const FIRST: u32 = 0xe000;

/// How many values a line has at most: as many as there are such characters.
const MOST: usize = 0x1900;

/// Where a value goes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Goes {
    Float(usize),
    Int(usize),
    /// Into the text, at its mark.
    Text,
}

/// A request that lacks values.
#[derive(Debug)]
pub(crate) struct Template {
    request: Request,
    goes: Vec<Goes>,
    /// Whether the text is nothing but one value.
    whole: bool,
}

fn mark(index: usize) -> Option<char> {
    char::from_u32(FIRST + u32::try_from(index).ok()?)
}

fn marked(character: char) -> Option<usize> {
    let index = usize::try_from(u32::from(character).checked_sub(FIRST)?).ok()?;
    (index < MOST).then_some(index)
}

/// A finding at the line.
fn wrong(line: &Line, message: impl Into<String>, help: &str) -> Finding {
    Finding::error("pnt::net::request", message)
        .at(line.at.clone())
        .help(help.to_owned())
}

const FORM: &str = "write it as in `scott`: `OBJECT EXEC text FMSG 2 $a $b`, with `CTRL` or `DBX` in the place of `EXEC`";

impl Template {
    /// Reads a line. An object that is named without a daemon is one of `daemon`.
    ///
    /// # Errors
    /// What is wrong with it.
    pub(crate) fn of(line: &Line, daemon: Option<&str>) -> Result<Self, Finding> {
        if line.text.contains(|c| marked(c).is_some()) {
            return Err(wrong(
                line,
                "the line has characters of Unicode's private use",
                "leave them out",
            ));
        }
        let (text, values) = with_marks(line)?;
        let (text, goes) = placed(line, &text, &values)?;
        let request: Request = text.parse().map_err(|error: sorma::RequestError| {
            let said = shown(&error.to_string(), line);
            wrong(line, format!("this is no request: {said}"), FORM)
        })?;
        let name = served(&request.name, daemon).map_err(|why| {
            let help = "write `OBJECT@TASK`, with the task that serves it; or give the net's task `args.daemon = \"TASK\"`";
            wrong(line, format!("`{}`: {why}", request.name), help)
        })?;
        let whole = {
            let mut characters = request.body.text.chars();
            characters.next().and_then(marked).is_some() && characters.next().is_none()
        };
        Ok(Self {
            request: Request { name, ..request },
            goes,
            whole,
        })
    }

    /// Who is asked.
    pub(crate) fn name(&self) -> &ObjectName {
        &self.request.name
    }

    /// The request with its values, in the order of the line.
    pub(crate) fn filled(&self, values: &[Value]) -> Request {
        let mut request = self.request.clone();
        let body = &mut request.body;
        for (goes, value) in self.goes.iter().zip(values) {
            match (*goes, value) {
                (Goes::Float(index), value) => {
                    let number = match value {
                        Value::Float(number) => *number,
                        // Every whole number that people write is a float.
                        #[allow(clippy::cast_precision_loss)]
                        Value::Int(number) => *number as f64,
                        Value::Bool(_) | Value::Text(_) => continue,
                    };
                    body.floats
                        .get_mut(index)
                        .into_iter()
                        .for_each(|there| *there = number);
                }
                (Goes::Int(index), Value::Int(number)) => {
                    body.ints
                        .get_mut(index)
                        .into_iter()
                        .for_each(|there| *there = *number);
                }
                _ => {}
            }
        }
        if self.goes.contains(&Goes::Text) {
            let mut text = String::new();
            for character in self.request.body.text.chars() {
                match marked(character).and_then(|index| values.get(index)) {
                    // Nothing else is there that it could be mistaken for, and an object's EXEC takes a text as one.
                    Some(Value::Text(value))
                        if self.whole && self.request.method == Method::Exec =>
                    {
                        text.push_str(value)
                    }
                    // One word, whatever is in it.
                    Some(Value::Text(value)) => text.push_str(&words::quoted(value)),
                    Some(value) => text.push_str(&value.to_string()),
                    None => text.push(character),
                }
            }
            body.text = text;
        }
        request
    }
}

/// The line with a mark for each value, the marks of one name with blanks between them, and what the values are.
fn with_marks(line: &Line) -> Result<(String, Vec<(String, Kind)>), Finding> {
    let mut values = Vec::new();
    let mut text = String::new();
    for part in &line.parts {
        match part {
            LinePart::Text(literal) => text.push_str(literal),
            LinePart::Values { values: own, .. } => {
                for (index, value) in own.iter().enumerate() {
                    let next = mark(values.len()).filter(|_| values.len() < MOST);
                    let next = next.ok_or_else(|| {
                        wrong(
                            line,
                            format!("the line has more than {MOST} values"),
                            "send fewer",
                        )
                    })?;
                    if index > 0 {
                        text.push(' ');
                    }
                    text.push(next);
                    values.push(value.clone());
                }
            }
        }
    }
    Ok((text, values))
}

/// Where each value goes, and the line with numbers where values are numbers.
fn placed(
    line: &Line,
    text: &str,
    values: &[(String, Kind)],
) -> Result<(String, Vec<Goes>), Finding> {
    let split = words::split(text).map_err(|error| {
        let said = shown(&error.to_string(), line);
        wrong(line, format!("this is no request: {said}"), FORM)
    })?;
    let mut goes = vec![Goes::Text; values.len()];
    let (mut out, mut done) = (String::new(), 0);
    let mut section = "";
    let mut position = 0;
    for (number, word) in split.iter().enumerate() {
        let keyword = ["FMSG", "IMSG", "TMSG", "TDBX"];
        if let Some(keyword) = keyword
            .into_iter()
            .find(|k| !word.quoted && word.text == *k)
        {
            (section, position) = (keyword, 0);
            continue;
        }
        let marks: Vec<usize> = word.text.chars().filter_map(marked).collect();
        let Some(first) = marks.first() else {
            position += 1;
            continue;
        };
        let (name, kind) = match values.get(*first) {
            Some((name, kind)) => (name.as_str(), *kind),
            None => continue,
        };
        if number < 2 {
            return Err(wrong(
                line,
                format!("`${name}` stands where the object and what is asked of it stand"),
                "write these out: what comes from outside never says who is asked",
            ));
        }
        if matches!(section, "FMSG" | "IMSG") {
            if word.text.chars().count() > 1 || word.quoted || position == 0 {
                return Err(wrong(
                    line,
                    format!("`${name}` does not stand by itself among the numbers"),
                    "write the count as a number, then each value as a word of its own",
                ));
            }
            let at = position - 1;
            let fits = match (section, kind) {
                ("FMSG", Kind::Float(_) | Kind::Int) => Goes::Float(at),
                ("IMSG", Kind::Int) => Goes::Int(at),
                _ => {
                    let wanted = if section == "FMSG" {
                        "a number"
                    } else {
                        "a whole number"
                    };
                    return Err(wrong(
                        line,
                        format!(
                            "`${name}` is of type `{kind}`, and behind {section} stands {wanted}"
                        ),
                        "convert it with a `set` line, or send it as text",
                    ));
                }
            };
            if let Some(there) = goes.get_mut(*first) {
                *there = fits;
            }
            out.push_str(text.get(done..word.span.start).unwrap_or_default());
            out.push('0');
            done = word.span.end;
        } else if kind == Kind::Text && (word.quoted || word.text.chars().count() > 1) {
            return Err(wrong(
                line,
                format!("`${name}` is a text and does not stand by itself"),
                "leave out the quotes, and put a blank before and behind it: it becomes one word, whatever is in it",
            ));
        } else if word.quoted && number > 2 {
            return Err(wrong(
                line,
                format!("`${name}` stands in quotes"),
                "leave the quotes out",
            ));
        } else if section == "TDBX" {
            return Err(wrong(
                line,
                format!("`${name}` stands in a report"),
                "reports come from objects; leave it out",
            ));
        }
        position += 1;
    }
    out.push_str(text.get(done..).unwrap_or_default());
    Ok((out, goes))
}

/// An error as people may read it, without marks.
fn shown(said: &str, line: &Line) -> String {
    let mut names = Vec::new();
    for part in &line.parts {
        if let LinePart::Values { values, .. } = part {
            names.extend(values.iter().map(|(name, _)| name.as_str()));
        }
    }
    let mut out = String::new();
    for character in said.chars() {
        match marked(character).and_then(|index| names.get(index)) {
            Some(name) => {
                out.push('$');
                out.push_str(name);
            }
            None => out.push(character),
        }
    }
    out
}
