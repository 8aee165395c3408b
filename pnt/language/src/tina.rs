//! The textual nets of TINA (`.net`), as its manual describes them: `net`, `tr`, `pl`, `lb`, `nt` and
//! `pr` lines. One element's description may be split over several lines. Times other than fixed
//! ones, stopwatch arcs and priorities have no counterpart here and are refused by name.

use std::{collections::BTreeMap, fmt::Write as _, time::Duration};

use ctos::diagnostic::{Finding, Findings, Source};

use crate::{
    draft::{Draft, DraftArc, DraftPlace, DraftTransition, Word},
    enough::enough,
    text::MOST_TOKENS,
    timing::Timing,
};

#[cfg(test)]
mod tests;

/// What a line begins with and no line of net text does.
pub(crate) const KEYWORDS: [&str; 5] = ["tr", "pl", "lb", "nt", "pr"];

/// Reads a net.
///
/// # Errors
/// All findings.
pub fn read(source: &Source) -> Result<Draft, Findings> {
    let mut reader = Reader {
        source,
        draft: Draft::new(Word::new("net", source.at(0..0))),
        findings: Findings::new(),
        places: BTreeMap::new(),
        marked: Vec::new(),
        transitions: BTreeMap::new(),
    };
    let mut start = 0;
    for with_end in source.text().split_inclusive('\n') {
        let line = with_end.trim_end_matches(['\n', '\r']);
        if enough(&reader.findings) {
            break;
        }
        let result = reader.line(line, start);
        reader.findings.keep(result);
        start += with_end.len();
    }
    if reader.draft.transitions.is_empty() {
        reader.findings.push(
            Finding::error("pnt::net::no_transitions", "this net has no transition")
                .at(source.at_line(1))
                .help("a net without transitions does nothing; was the file cut off?"),
        );
    }
    if reader.findings.has_errors() {
        Err(reader.findings)
    } else {
        Ok(reader.draft)
    }
}

struct Reader<'s> {
    source: &'s Source,
    draft: Draft,
    findings: Findings,
    places: BTreeMap<String, usize>,
    /// Per place, whether a line gave its marking.
    marked: Vec<bool>,
    transitions: BTreeMap<String, usize>,
}

/// One line, read from left to right.
struct Line<'s> {
    source: &'s Source,
    text: &'s str,
    /// Byte of the source at which `text` begins.
    start: usize,
    at: usize,
}

/// What an arc's mark says.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Kind {
    Normal,
    Read,
    Inhibitor,
}

impl<'s> Line<'s> {
    fn rest(&self) -> &'s str {
        self.text.get(self.at..).unwrap_or_default()
    }

    fn skip(&mut self) {
        let rest = self.rest();
        self.at += rest.len() - rest.trim_start().len();
    }

    fn at_end(&mut self) -> bool {
        self.skip();
        self.rest().is_empty()
    }

    fn take(&mut self, mark: &str) -> bool {
        self.skip();
        let found = self.rest().starts_with(mark);
        if found {
            self.at += mark.len();
        }
        found
    }

    fn place(&self, from: usize) -> ctos::diagnostic::Place {
        self.source
            .at(self.start + from..self.start + self.at.max(from))
    }

    fn wrong(&mut self, expected: &str) -> Finding {
        self.skip();
        let found: String = self.rest().chars().take(20).collect();
        let found = if found.is_empty() {
            "the end of the line".to_owned()
        } else {
            format!("`{found}`")
        };
        let place = self.source.at(self.start + self.at..self.start + self.at);
        Finding::error(
            "pnt::tina::expected",
            format!("expected {expected}, found {found}"),
        )
        .at(place)
        .help("a line is `tr NAME [0,w[ p*2 q -> r`, `pl NAME (1)` or `net NAME`")
    }

    /// A name: letters, digits, `_` and `'`, or anything in braces, where a backslash quotes.
    fn name(&mut self, what: &str) -> Result<Word, Finding> {
        self.skip();
        let from = self.at;
        let mut text = String::new();
        if self.rest().starts_with('{') {
            let mut quoted = false;
            let mut length = 1;
            let mut ended = false;
            for character in self.rest().chars().skip(1) {
                length += character.len_utf8();
                if !quoted && character == '}' {
                    ended = true;
                    break;
                }
                quoted = !quoted && character == '\\';
                if !quoted {
                    text.push(character);
                }
            }
            if !ended {
                return Err(self.wrong("a `}` at the end of the name"));
            }
            self.at += length;
        } else {
            let plain = |c: char| c.is_alphanumeric() || c == '_' || c == '\'';
            let rest = self.rest();
            let length = rest.find(|c| !plain(c)).unwrap_or(rest.len());
            text.push_str(rest.get(..length).unwrap_or_default());
            self.at += length;
        }
        if text.is_empty() {
            self.at = from;
            return Err(self.wrong(what));
        }
        Ok(Word::new(text, self.place(from)))
    }

    /// A number, with `K`, `M` or `G` for thousands, millions and thousand millions.
    fn number(&mut self, what: &str) -> Result<u32, Finding> {
        self.skip();
        let from = self.at;
        let rest = self.rest();
        let length = rest
            .find(|c: char| !c.is_ascii_digit())
            .unwrap_or(rest.len());
        let digits = rest.get(..length).unwrap_or_default();
        if digits.is_empty() {
            return Err(self.wrong(what));
        }
        self.at += length;
        let factor = match self.rest().chars().next() {
            Some('K') => 1_000,
            Some('M') => 1_000_000,
            Some('G') => 1_000_000_000,
            Some('T' | 'P' | 'E') => u64::MAX,
            _ => 1,
        };
        if factor > 1 {
            self.at += 1;
        }
        let value = digits
            .parse::<u64>()
            .ok()
            .and_then(|value| value.checked_mul(factor));
        match value.and_then(|value| u32::try_from(value).ok()) {
            Some(value) if value <= MOST_TOKENS => Ok(value),
            _ => Err(Finding::error(
                "pnt::tina::number",
                format!("{what} is more than can be counted here"),
            )
            .at(self.place(from))
            .help(format!("write a whole number up to {MOST_TOKENS}"))),
        }
    }

    /// What follows a name in a list of arcs.
    fn arc(&mut self) -> Result<(Kind, u32), Finding> {
        let from = self.at;
        let kind = if self.rest().starts_with('!') {
            self.at += 1;
            return Err(Finding::error(
                "pnt::tina::unsupported",
                "stopwatch arcs have no counterpart here",
            )
            .at(self.place(from))
            .help("use a read arc (`?`) or an inhibitor arc (`?-`)"));
        } else if self.take_now("?-") {
            Kind::Inhibitor
        } else if self.take_now("?") {
            Kind::Read
        } else if self.take_now("*") {
            Kind::Normal
        } else {
            return Ok((Kind::Normal, 1));
        };
        let weight = self.number("the arc's weight")?;
        if weight == 0 {
            return Err(
                Finding::error("pnt::tina::number", "the arc's weight cannot be 0")
                    .at(self.place(from))
                    .help("write at least 1, or remove the arc"),
            );
        }
        Ok((kind, weight))
    }

    /// A mark that stands directly here, without a blank.
    fn take_now(&mut self, mark: &str) -> bool {
        let found = self.rest().starts_with(mark);
        if found {
            self.at += mark.len();
        }
        found
    }

    /// A time interval: none and `[0,w[` are untimed, `[a,a]` is a fixed time in seconds.
    fn interval(&mut self) -> Result<Timing, Finding> {
        self.skip();
        let from = self.at;
        let rest = self.rest();
        if !rest.starts_with(['[', ']']) {
            return Ok(Timing::Immediate);
        }
        let inner = rest.get(1..).unwrap_or_default();
        let Some(end) = inner.find(['[', ']']) else {
            return Err(self.wrong("a time interval such as `[0,w[`"));
        };
        self.at += end + 2;
        let bounds = inner.get(..end).unwrap_or_default();
        let closed = rest.starts_with('[') && inner.get(end..=end) == Some("]");
        let (low, high) = bounds.split_once(',').unwrap_or((bounds, ""));
        let (low, high) = (low.trim(), high.trim());
        if rest.starts_with('[') && (low, high) == ("0", "w") {
            return Ok(Timing::Immediate);
        }
        match (low.parse::<u32>(), high.parse::<u32>()) {
            (Ok(low), Ok(high)) if closed && low == high && low <= 360_000_000 => Ok(match low {
                0 => Timing::Immediate,
                _ => Timing::Deterministic(Duration::from_secs(low.into())),
            }),
            _ => Err(Finding::error(
                "pnt::tina::unsupported",
                format!(
                    "the time interval `{}` has no counterpart here",
                    self.text.get(from..self.at).unwrap_or_default()
                ),
            )
            .at(self.place(from))
            .help("use `[0,w[` for no time, or `[2,2]` for two seconds")),
        }
    }
}

impl<'s> Reader<'s> {
    fn line(&mut self, text: &'s str, start: usize) -> Result<(), Finding> {
        let mut line = Line {
            source: self.source,
            text,
            start,
            at: 0,
        };
        if line.at_end() || line.rest().starts_with('#') {
            return Ok(());
        }
        let keyword = line.name("`net`, `tr`, `pl`, `lb`, `nt` or `pr`")?;
        match keyword.text.as_str() {
            "net" => self.draft.name = line.name("the net's name")?,
            "tr" => self.transition(&mut line)?,
            "pl" => self.marked_place(&mut line)?,
            // Labels and notes are for people.
            "lb" | "nt" => return Ok(()),
            "pr" => {
                return Err(Finding::error(
                    "pnt::tina::unsupported",
                    "priorities between transitions are given as numbers here",
                )
                .at(keyword.at)
                .help("convert the net without its `pr` lines and add `priority` lines to the net text"));
            }
            other => {
                return Err(Finding::error(
                    "pnt::tina::expected",
                    format!("no line of a TINA net begins with `{other}`"),
                )
                .at(keyword.at)
                .suggest(other, KEYWORDS.iter().copied().chain(["net"])));
            }
        }
        if line.at_end() {
            Ok(())
        } else {
            Err(line.wrong("the end of the line"))
        }
    }

    fn place(&mut self, word: &Word) -> usize {
        if let Some(index) = self.places.get(&word.text) {
            return *index;
        }
        let index = self.draft.places.len();
        self.places.insert(word.text.clone(), index);
        self.draft.places.push(DraftPlace::new(word.clone()));
        self.marked.push(false);
        index
    }

    fn transition_of(&mut self, word: &Word) -> usize {
        if let Some(index) = self.transitions.get(&word.text) {
            return *index;
        }
        let index = self.draft.transitions.len();
        self.transitions.insert(word.text.clone(), index);
        self.draft
            .transitions
            .push(DraftTransition::new(word.clone()));
        index
    }

    fn transition(&mut self, line: &mut Line<'s>) -> Result<(), Finding> {
        let name = line.name("the transition's name")?;
        let index = self.transition_of(&name);
        if line.take(":") {
            line.name("a label")?;
        }
        let timing = line.interval()?;
        if let Some(transition) = self.draft.transitions.get_mut(index)
            && !timing.is_immediate()
        {
            transition.timing = timing;
        }
        let mut outputs = false;
        while !line.at_end() {
            if line.take("->") {
                if outputs {
                    return Err(line.wrong("one `->` only"));
                }
                outputs = true;
                continue;
            }
            let place = line.name("a place or `->`")?;
            let from = line.at;
            let (kind, weight) = line.arc()?;
            self.place(&place);
            if outputs && kind != Kind::Normal {
                return Err(inward(line, from));
            }
            self.arc(index, place, kind, weight, outputs)?;
        }
        Ok(())
    }

    fn marked_place(&mut self, line: &mut Line<'s>) -> Result<(), Finding> {
        let name = line.name("the place's name")?;
        let index = self.place(&name);
        if line.take(":") {
            line.name("a label")?;
        }
        if line.take("(") {
            let tokens = line.number("the marking")?;
            if !line.take(")") {
                return Err(line.wrong("`)`"));
            }
            let before = self
                .marked
                .get_mut(index)
                .map(|marked| std::mem::replace(marked, true));
            if before == Some(true) {
                return Err(Finding::error(
                    "pnt::tina::twice",
                    format!("the marking of place `{name}` is given twice"),
                )
                .at(name.at)
                .help("keep the one that is meant"));
            }
            if let Some(place) = self.draft.places.get_mut(index) {
                place.tokens = tokens;
            }
        }
        // Transitions that put into the place, then those that take from it.
        let mut takes = false;
        while !line.at_end() {
            if line.take("->") {
                if takes {
                    return Err(line.wrong("one `->` only"));
                }
                takes = true;
                continue;
            }
            let transition = line.name("a transition or `->`")?;
            let from = line.at;
            let (kind, weight) = line.arc()?;
            if !takes && kind != Kind::Normal {
                return Err(inward(line, from));
            }
            let transition = self.transition_of(&transition);
            self.arc(transition, name.clone(), kind, weight, !takes)?;
        }
        Ok(())
    }

    /// Adds an arc; parallel ones add up.
    fn arc(
        &mut self,
        transition: usize,
        place: Word,
        kind: Kind,
        weight: u32,
        output: bool,
    ) -> Result<(), Finding> {
        let Some(transition) = self.draft.transitions.get_mut(transition) else {
            return Ok(());
        };
        let arcs = match kind {
            Kind::Read => &mut transition.reads,
            Kind::Inhibitor => &mut transition.inhibitors,
            Kind::Normal if output => &mut transition.outputs,
            Kind::Normal => &mut transition.inputs,
        };
        let Some(same) = arcs.iter_mut().find(|arc| arc.place == place) else {
            arcs.push(DraftArc {
                place,
                net: None,
                weight,
            });
            return Ok(());
        };
        same.weight = match kind {
            Kind::Read => same.weight.max(weight),
            Kind::Inhibitor => same.weight.min(weight),
            Kind::Normal => same.weight.saturating_add(weight),
        };
        if same.weight > MOST_TOKENS {
            return Err(Finding::error(
                "pnt::tina::number",
                "the weights of parallel arcs add up to more than can be counted here",
            )
            .at(place.at)
            .help(format!("their sum is at most {MOST_TOKENS}")));
        }
        Ok(())
    }
}

fn inward(line: &Line<'_>, from: usize) -> Finding {
    Finding::error(
        "pnt::tina::expected",
        "read and inhibitor arcs lead from a place to a transition",
    )
    .at(line.place(from))
    .help("put it on the side of the inputs")
}

/// Writes a net.
///
/// # Errors
/// What TINA's text has no words for, all at once.
pub fn write(draft: &Draft) -> Result<String, Findings> {
    let mut findings = Findings::new();
    refuse(draft, &mut findings);
    if findings.has_errors() {
        return Err(findings);
    }
    let mut out = format!("net {}\n", braced(&draft.name.text));
    // Writing to a string cannot fail.
    for place in &draft.places {
        let _ = match place.tokens {
            0 => writeln!(out, "pl {}", braced(&place.name.text)),
            tokens => writeln!(out, "pl {} ({tokens})", braced(&place.name.text)),
        };
    }
    for transition in &draft.transitions {
        let _ = write!(out, "tr {}", braced(&transition.name.text));
        if let Timing::Deterministic(time) = transition.timing {
            let _ = write!(out, " [{0},{0}]", time.as_secs());
        }
        let arcs = [
            ("*", &transition.inputs),
            ("?", &transition.reads),
            ("?-", &transition.inhibitors),
        ];
        for (mark, arcs) in arcs {
            for arc in arcs {
                let _ = write!(
                    out,
                    " {}{}",
                    braced(&arc.place.text),
                    weighted(mark, arc.weight)
                );
            }
        }
        out.push_str(" ->");
        for arc in &transition.outputs {
            let _ = write!(
                out,
                " {}{}",
                braced(&arc.place.text),
                weighted("*", arc.weight)
            );
        }
        out.push('\n');
    }
    Ok(out)
}

fn weighted(mark: &str, weight: u32) -> String {
    if (mark, weight) == ("*", 1) {
        return String::new();
    }
    format!("{mark}{weight}")
}

/// A name, in braces where it is no plain one.
fn braced(name: &str) -> String {
    let plain = |c: char| c.is_ascii_alphanumeric() || c == '_' || c == '\'';
    if name.starts_with(|c: char| c.is_ascii_alphabetic()) && name.chars().all(plain) {
        return name.to_owned();
    }
    let mut out = "{".to_owned();
    for character in name.chars() {
        if ['{', '}', '\\'].contains(&character) {
            out.push('\\');
        }
        out.push(character);
    }
    out + "}"
}

fn refuse(draft: &Draft, findings: &mut Findings) {
    let mut lacks = |what: &str, word: &Word| {
        findings.push(
            Finding::error(
                "pnt::tina::unsupported",
                format!("TINA's text has no words for {what}"),
            )
            .at(word.at.clone())
            .help("write PNML, which keeps it in a section of its own"),
        );
    };
    for word in draft.commands.iter().map(|c| &c.symbol) {
        lacks("tape symbols", word);
    }
    for word in draft.data.iter().map(|data| &data.name) {
        lacks("declared data", word);
    }
    for word in draft.coordinators.iter().map(|c| &c.net) {
        lacks("coordination structures", word);
    }
    for word in draft.serves.iter().map(|s| &s.net) {
        lacks("coordination structures", word);
    }
    for place in &draft.places {
        if place.capacity.is_some() || place.data.is_some() {
            lacks("capacities and data objects", &place.name);
        }
    }
    let line_end = |word: &&Word| word.text.contains(['\n', '\r']);
    let places = draft.places.iter().map(|place| &place.name);
    let names = places.chain(draft.transitions.iter().map(|t| &t.name));
    for word in names.filter(line_end) {
        lacks("names of several lines", word);
    }
    for transition in &draft.transitions {
        let whole_seconds = match transition.timing {
            Timing::Immediate => true,
            Timing::Deterministic(time) => time.subsec_nanos() == 0 && time.as_secs() > 0,
            _ => false,
        };
        let remote = transition.outputs.iter().any(|arc| arc.net.is_some());
        if !whole_seconds {
            lacks("times other than whole seconds", &transition.name);
        } else if remote
            || transition.tape.is_some()
            || transition.when.is_some()
            || transition.action.is_some()
            || !transition.sets.is_empty()
            || transition.write.is_some()
            || transition.priority > 0
            || !transition.resets.is_empty()
            || !transition.fail.is_empty()
        {
            lacks(
                "tapes, enabling functions, actions, priorities, reset arcs and remote places",
                &transition.name,
            );
        }
    }
}
