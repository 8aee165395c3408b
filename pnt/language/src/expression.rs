//! Expressions in net text: the Common Expression Language over declared data, with types and units checked before
//! anything starts. Parsing and evaluation are the crate's; here is what a net allows of it. There are no loops, lists
//! and maps, so what an expression costs is bounded by its length.

mod types;

#[cfg(test)]
mod tests;

use std::{
    fmt,
    sync::{Arc, LazyLock},
};

use cel::{
    Context, Env, ExecutionError, ParseErrors, Program,
    common::{
        types::{CelBool, CelDouble, CelInt, CelString},
        value::CowVal,
    },
    context::VariableResolver,
};
use ctos::diagnostic::{Finding, Place as At};

use crate::{
    data::{Declared, Kind, LONGEST_TEXT, Parameter, Value},
    draft::Word,
};

/// The longest expression, bytes.
const LONGEST: usize = 1000;

/// How deep parentheses may stand in each other.
const DEEPEST: usize = 32;

/// The most characters of operators: each may be a level of the tree that is evaluated.
const MOST_OPERATORS: usize = 64;

/// The stack for the parser, bytes: it takes some 100 kB for each level of parentheses.
const STACK: usize = 32 << 20;

/// The functions and operators of the language, without its macros.
static ENV: LazyLock<Arc<Env>> =
    LazyLock::new(|| Arc::new(Env::default().with_optional_support(false).with_stdlib()));

/// An expression whose names and types were checked.
#[derive(Clone)]
pub struct Expression {
    text: Arc<str>,
    tree: Arc<cel::IdedExpr>,
    kind: Kind,
    at: At,
}

impl fmt::Debug for Expression {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Expression({})", self.text)
    }
}

/// What an expression may name.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Scope<'a> {
    /// Data of the net.
    pub(crate) declared: &'a Declared,
    /// What came with the command in progress.
    pub(crate) parameters: &'a [Parameter],
}

/// The values that an expression is evaluated with.
#[derive(Debug, Clone, Copy)]
pub struct Values<'a> {
    /// Data of the net.
    pub declared: &'a Declared,
    /// Its values.
    pub values: &'a [Value],
    /// What came with the command in progress, by name.
    pub arguments: &'a [(String, Value)],
}

impl Values<'_> {
    /// The value of that name, fields with a point.
    #[must_use]
    pub fn get(&self, name: &str) -> Option<&Value> {
        match self.declared.slot(name) {
            Some(slot) => self.values.get(slot),
            None => {
                let mut arguments = self.arguments.iter();
                arguments.find_map(|(argument, value)| (argument == name).then_some(value))
            }
        }
    }
}

impl VariableResolver for Values<'_> {
    fn resolve<'b>(&'b self, name: &str) -> Option<CowVal<'b, 'b>> {
        Some(match self.get(name)? {
            Value::Int(number) => CowVal::owned(CelInt::from(*number)),
            Value::Float(number) => CowVal::owned(CelDouble::from(*number)),
            Value::Bool(yes) => CowVal::owned(CelBool::from(*yes)),
            Value::Text(text) => CowVal::owned(CelString::from(text.as_str())),
        })
    }
}

impl Expression {
    /// Reads and checks an expression; `wanted` is the type that it must have, if there is one.
    ///
    /// # Errors
    /// The first thing that is wrong, at its place.
    pub(crate) fn checked(
        word: &Word,
        scope: Scope<'_>,
        wanted: Option<Kind>,
    ) -> Result<Self, Finding> {
        let text = word.text.as_str();
        bounded(word)?;
        let program = parsed(word)?.map_err(|errors| {
            let first = errors.errors.first();
            let (line, column) = first.map_or((1, 1), |error| error.pos);
            let said = first.map(|error| error.msg.replace('\n', " "));
            let said = said.unwrap_or_else(|| "it has no meaning".to_owned());
            let offset = usize::try_from(column.saturating_sub(1)).unwrap_or(0);
            let offset = if line == 1 { offset } else { 0 };
            let finding = Finding::error(
                "pnt::text::expression",
                format!("`{text}` is not an expression: {said}"),
            );
            finding
                .at(part(word, offset..(offset + 1).min(text.len())))
                .help("expressions are those of the Common Expression Language, such as `count < 3 && spot.sd < 0.2`")
        })?;
        let mut types = types::Types::new(word, scope, program.source_info());
        let mut tree = program.expression().clone();
        let kind = types.whole(&mut tree, wanted)?;
        Ok(Self {
            text: text.into(),
            tree: Arc::new(tree),
            kind,
            at: word.at.clone(),
        })
    }

    /// Its text.
    #[must_use]
    pub fn text(&self) -> &str {
        &self.text
    }

    /// Its type.
    #[must_use]
    pub fn kind(&self) -> Kind {
        self.kind
    }

    /// Where it stands.
    #[must_use]
    pub fn at(&self) -> &At {
        &self.at
    }

    /// What it says with these values.
    ///
    /// # Errors
    /// A division by zero, an overflow, a number that is not finite, a text that is too long, or an argument that the
    /// command in progress does not have; with the place of the expression.
    pub fn evaluate(&self, values: &Values<'_>) -> Result<Value, EvaluateError> {
        let mut context = Context::with_env(Arc::clone(&ENV));
        context.set_variable_resolver(values);
        let error = |why: String| EvaluateError {
            text: self.text.to_string(),
            at: self.at.to_string(),
            why,
        };
        let value =
            cel::Value::resolve(&self.tree, &context).map_err(|failed| error(why(&failed)))?;
        let value = match value {
            cel::Value::Int(number) => match self.kind {
                // Every whole number that people write is a float.
                #[allow(clippy::cast_precision_loss)]
                Kind::Float(_) => Value::Float(number as f64),
                _ => Value::Int(number),
            },
            cel::Value::Float(number) if number.is_finite() => Value::Float(number),
            cel::Value::Float(number) => return Err(error(format!("it is {number}"))),
            cel::Value::Bool(yes) => Value::Bool(yes),
            cel::Value::String(text) if text.len() <= LONGEST_TEXT => Value::Text(text.to_string()),
            cel::Value::String(text) => {
                return Err(error(format!(
                    "its text has {} bytes, and data holds {LONGEST_TEXT} at most",
                    text.len()
                )));
            }
            other => return Err(error(format!("it gives {other:?}"))),
        };
        match value.is(self.kind) {
            true => Ok(value),
            false => Err(error(format!(
                "it gives `{value}`, which is no {}",
                self.kind
            ))),
        }
    }
}

/// Why an expression has no value.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{at}: `{text}` has no value: {why}")]
pub struct EvaluateError {
    /// The expression.
    pub text: String,
    /// Where it stands.
    pub at: String,
    /// What is wrong.
    pub why: String,
}

fn why(error: &ExecutionError) -> String {
    match error {
        ExecutionError::DivisionByZero(_) | ExecutionError::RemainderByZero(_) => {
            "it divides by zero".to_owned()
        }
        ExecutionError::Overflow(..) => "its number is too large".to_owned(),
        ExecutionError::UndeclaredReference(name) => {
            format!("no command with `{name}` is in progress")
        }
        other => other.to_string(),
    }
}

/// What the parser makes of a text, on a stack that is deep enough.
fn parsed(word: &Word) -> Result<Result<Program, ParseErrors>, Finding> {
    let text = word.text.as_str();
    let parsed = std::thread::scope(|scope| {
        let parser = std::thread::Builder::new().stack_size(STACK);
        let parser = parser.spawn_scoped(scope, || Program::compile(text));
        parser.ok()?.join().ok()
    });
    parsed.ok_or_else(|| {
        Finding::error(
            "pnt::text::expression",
            format!("`{text}` could not be parsed"),
        )
        .at(word.at.clone())
        .help("write it in another way")
    })
}

/// Refuses what would take the parser long or deep.
fn bounded(word: &Word) -> Result<(), Finding> {
    let mut depth = 0_usize;
    let mut signs = 0_usize;
    let mut deepest = 0;
    for character in word.text.chars() {
        match character {
            '(' | '[' | '{' | '?' => depth += 1,
            ')' | ']' | '}' => depth = depth.saturating_sub(1),
            _ => {}
        }
        signs = match character {
            '!' | '-' => signs + 1,
            ' ' => signs,
            _ => 0,
        };
        deepest = deepest.max(depth).max(signs);
    }
    let operators = word
        .text
        .chars()
        .filter(|c| "+-*/%<>=!&|?:.,([{".contains(*c))
        .count();
    let (what, most) = if word.text.len() > LONGEST {
        ("is too long", format!("at most {LONGEST} bytes"))
    } else if deepest > DEEPEST {
        ("is nested too deeply", format!("at most {DEEPEST} deep"))
    } else if operators > MOST_OPERATORS {
        (
            "has too many operators",
            format!("at most {MOST_OPERATORS} characters of them"),
        )
    } else {
        return Ok(());
    };
    Err(Finding::error(
        "pnt::text::expression",
        format!("the expression {what}: {most}"),
    )
    .at(word.at.clone())
    .help("give parts of it to data of their own with `set` lines"))
}

/// The place of a part of a word's text: its own, where the text stands as it is written, else the word's.
pub(crate) fn part(word: &Word, range: std::ops::Range<usize>) -> At {
    let source = &word.at.source;
    let whole = &word.at.range;
    let written = source.text().get(whole.clone()).unwrap_or_default();
    // A text in quotes has one of them before it.
    let before = match written
        .strip_prefix('"')
        .and_then(|text| text.strip_suffix('"'))
    {
        _ if written == word.text => 0,
        Some(inside) if inside == word.text => 1,
        _ => return word.at.clone(),
    };
    let start = whole.start + before + range.start;
    source.at(start..(whole.start + before + range.end).max(start))
}
