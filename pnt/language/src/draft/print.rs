//! The printed form of a draft: net text (`docs/net-text.md`), one statement a line.

use std::{
    fmt::{self, Display as _},
    time::Duration,
};

use super::{
    Draft, DraftAction, DraftArc, DraftData, DraftField, DraftPlace, DraftServes, DraftSet,
    DraftShape, DraftTransition, DraftWhen, Word,
};
use crate::timing::{Servers, Timing};

/// A name as net text has it: as it is, or in quotes where it is not an identifier.
pub(crate) struct InText<'a>(pub(crate) &'a str);

impl fmt::Display for InText<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mut characters = self.0.chars();
        let begins = |c: char| c.is_ascii_alphabetic() || c == '_';
        if characters.next().is_some_and(begins)
            && characters.all(|c| c.is_ascii_alphanumeric() || c == '_')
        {
            f.write_str(self.0)
        } else {
            Quoted(self.0).fmt(f)
        }
    }
}

/// A text between quotes, with what cannot stand there escaped.
struct Quoted<'a>(&'a str);

impl fmt::Display for Quoted<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("\"")?;
        for character in self.0.chars() {
            match character {
                '"' => f.write_str("\\\"")?,
                '\\' => f.write_str("\\\\")?,
                '\n' => f.write_str("\\n")?,
                '\r' => f.write_str("\\r")?,
                '\t' => f.write_str("\\t")?,
                // The last two are no characters, and XML cannot hold them.
                c if c.is_control() || ['\u{fffe}', '\u{ffff}'].contains(&c) => {
                    write!(f, "\\u{{{:x}}}", u32::from(c))?
                }
                c => write!(f, "{c}")?,
            }
        }
        f.write_str("\"")
    }
}

/// A time as net text has it: in seconds, or below one second in milliseconds.
fn shown_time(time: Duration) -> String {
    let micros = time.as_micros();
    let (per_unit, digits, unit) = if micros >= 1_000_000 {
        (1_000_000, 6, "s")
    } else {
        (1_000, 3, "ms")
    };
    let (whole, part) = (micros / per_unit, micros % per_unit);
    if part == 0 {
        return format!("{whole} {unit}");
    }
    let part = format!("{part:0digits$}");
    format!("{whole}.{} {unit}", part.trim_end_matches('0'))
}

/// Items with commas between them.
struct List<'a, T>(&'a [T]);

impl<T: Print> fmt::Display for List<'_, T> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (index, item) in self.0.iter().enumerate() {
            if index > 0 {
                f.write_str(", ")?;
            }
            item.print(f)?;
        }
        Ok(())
    }
}

/// What can stand in a list.
trait Print {
    fn print(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result;
}

impl Print for Word {
    fn print(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        InText(&self.text).fmt(f)
    }
}

impl Print for DraftField {
    fn print(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} : {}", self.name.in_text(), self.kind.in_text())
    }
}

impl Print for DraftArc {
    fn print(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.place.print(f)?;
        if let Some(net) = &self.net {
            write!(f, "@{}", net.in_text())?;
        }
        if self.weight != 1 {
            write!(f, "*{}", self.weight)?;
        }
        Ok(())
    }
}

impl Word {
    fn in_text(&self) -> InText<'_> {
        InText(&self.text)
    }
}

impl fmt::Display for DraftPlace {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.name.print(f)?;
        if self.tokens > 0 {
            write!(f, " = {}", self.tokens)?;
        }
        if let Some(capacity) = self.capacity {
            write!(f, " capacity {capacity}")?;
        }
        if let Some(data) = &self.data {
            write!(f, " data {}", data.in_text())?;
        }
        Ok(())
    }
}

impl fmt::Display for DraftArc {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.print(f)
    }
}

impl fmt::Display for DraftWhen {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let not = if self.negated { "not " } else { "" };
        if self.expression {
            return write!(f, "when {not}{}", self.function);
        }
        match self.function.text.as_str() {
            "not" => write!(f, "when {not}\"not\""),
            _ => write!(f, "when {not}{}", self.function.in_text()),
        }
    }
}

impl fmt::Display for DraftAction {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Do {
                function,
                inputs,
                outputs,
            } => {
                write!(f, "do {}", function.in_text())?;
                objects(f, inputs, outputs)
            }
            Self::Ask {
                coordinator,
                request,
            } => write!(f, "ask {} {}", coordinator.in_text(), request.in_text()),
            Self::Send {
                task,
                command,
                inputs,
                outputs,
            } => {
                write!(f, "send {}.{}", task.in_text(), command.in_text())?;
                objects(f, inputs, outputs)
            }
            Self::Request { line } => write!(f, "request {}", Quoted(&line.text)),
            Self::Wait { time, .. } => write!(f, "wait {}", shown_time(*time)),
            Self::Log { line } => write!(f, "log {}", Quoted(&line.text)),
        }
    }
}

impl fmt::Display for DraftSet {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("set ")?;
        let mut parts = self.target.text.split('.');
        if parts.clone().any(str::is_empty) {
            // Points and nothing between them: one name in quotes.
            InText(&self.target.text).fmt(f)?;
        } else {
            InText(parts.next().unwrap_or_default()).fmt(f)?;
            for part in parts {
                write!(f, ".{}", InText(part))?;
            }
        }
        write!(f, " = {}", self.value)
    }
}

impl fmt::Display for DraftData {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "data {}", self.name.in_text())?;
        match &self.shape {
            DraftShape::One { kind, initial } => {
                write!(f, " : {}", kind.in_text())?;
                match initial {
                    Some(initial) => write!(f, " = {initial}"),
                    None => Ok(()),
                }
            }
            DraftShape::Fields(fields) => write!(f, " {{ {} }}", List(fields)),
        }
    }
}

/// The data objects of an action.
fn objects(f: &mut fmt::Formatter<'_>, inputs: &[Word], outputs: &[Word]) -> fmt::Result {
    match (inputs, outputs) {
        ([], []) => Ok(()),
        (_, []) => write!(f, "({})", List(inputs)),
        ([], _) => write!(f, "(-> {})", List(outputs)),
        _ => write!(f, "({} -> {})", List(inputs), List(outputs)),
    }
}

impl fmt::Display for DraftServes {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (net, requests) = (self.net.in_text(), List(&self.requests));
        write!(
            f,
            "serves {net} : {requests} ; done {}",
            self.done.in_text()
        )?;
        match &self.failed {
            Some(failed) => write!(f, " ; failed {}", failed.in_text()),
            None => Ok(()),
        }
    }
}

/// A line of a transition.
fn line(f: &mut fmt::Formatter<'_>, text: impl fmt::Display) -> fmt::Result {
    writeln!(f, "  {text}")
}

/// A line of a transition that is there if it lists anything.
fn list<T: Print>(f: &mut fmt::Formatter<'_>, keyword: &str, items: &[T]) -> fmt::Result {
    if items.is_empty() {
        return Ok(());
    }
    line(f, format_args!("{keyword} {}", List(items)))
}

impl fmt::Display for DraftTransition {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "transition {}", self.name.in_text())?;
        list(f, "in", &self.inputs)?;
        list(f, "read", &self.reads)?;
        list(f, "inhibit", &self.inhibitors)?;
        list(f, "reset", &self.resets)?;
        if let Some(tape) = &self.tape {
            line(f, format_args!("tape {}", tape.in_text()))?;
        }
        if let Some(when) = &self.when {
            line(f, when)?;
        }
        if let Some(action) = &self.action {
            line(f, action)?;
        }
        for set in &self.sets {
            line(f, set)?;
        }
        if self.idempotent {
            line(f, "idempotent")?;
        }
        list(f, "out", &self.outputs)?;
        list(f, "fail", &self.fail)?;
        if let Some(symbol) = &self.write {
            line(f, format_args!("write {}", symbol.in_text()))?;
        }
        self.print_choice(f)
    }
}

impl DraftTransition {
    /// When it fires, and before which others.
    fn print_choice(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.priority > 0 {
            line(f, format_args!("priority {}", self.priority))?;
        }
        // The weight that every transition has unless it says otherwise.
        if self.weight.to_bits() != 1.0_f64.to_bits() {
            line(f, format_args!("weight {}", self.weight))?;
        }
        match self.timing {
            Timing::Immediate => {}
            Timing::Deterministic(time) => line(f, format_args!("time {}", shown_time(time)))?,
            Timing::Exponential { mean } => {
                line(f, format_args!("time exponential {}", shown_time(mean)))?;
            }
            Timing::Normal { mean, spread } => {
                let (mean, spread) = (shown_time(mean), shown_time(spread));
                line(f, format_args!("time normal {mean} spread {spread}"))?;
            }
        }
        match self.servers {
            None => {}
            Some(Servers::Many) => line(f, "servers many")?,
            Some(Servers::Limit(most)) => line(f, format_args!("servers {most}"))?,
        }
        match self.within {
            Some(within) => line(f, format_args!("within {}", shown_time(within))),
            None => Ok(()),
        }
    }
}

impl fmt::Display for Draft {
    /// Net text; parsing it gives an equal draft.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "net {}", self.name.in_text())?;
        match &self.title {
            Some(title) => writeln!(f, " {}", Quoted(title))?,
            None => writeln!(f)?,
        }
        for place in &self.places {
            writeln!(f, "place {place}")?;
        }
        for data in &self.data {
            writeln!(f, "{data}")?;
        }
        for command in &self.commands {
            let (symbol, answers) = (command.symbol.in_text(), List(&command.answers));
            match command.parameters.as_slice() {
                [] => writeln!(f, "command {symbol} -> {answers}")?,
                with => writeln!(f, "command {symbol}({}) -> {answers}", List(with))?,
            }
        }
        for coordinator in &self.coordinators {
            let (net, requests) = (coordinator.net.in_text(), List(&coordinator.requests));
            writeln!(f, "coordinator {net} : {requests}")?;
        }
        for serves in &self.serves {
            writeln!(f, "{serves}")?;
        }
        for safe in &self.safe {
            writeln!(f, "safe {}", List(safe))?;
        }
        for transition in &self.transitions {
            write!(f, "{transition}")?;
        }
        Ok(())
    }
}
