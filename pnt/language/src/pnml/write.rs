//! From a net to PNML of the 2009 grammar: one page, and what was kept of the file it came from.
//!
//! The text is ours: what was kept of a file is written as it was read. An event writer such as `quick-xml` would have to
//! parse it again. It would take the place of `escape` alone.

use std::{
    collections::{BTreeMap, BTreeSet},
    fmt::Write as _,
};

use ctos::diagnostic::{Finding, Findings};

use super::kept::{Kept, KeptElement, NAMESPACE, TOOL, TYPE};
use crate::{
    draft::{Draft, DraftArc, DraftPlace, DraftTransition, Word},
    format::file::{NetFile, Positions},
};

/// Writes a net. What PNML has no words for stands in `toolspecific` sections of tool `pnt`. An inhibitor or reset arc
/// says its kind three times. An attribute `type` is for TAPAAL, an element `type` for PIPE and GreatSPN, and a label
/// `arctype` for PM4Py. A read arc is a loop that other tools take for one and this one for what it is.
///
/// # Errors
/// Names that XML cannot hold.
pub fn write(file: &NetFile) -> Result<String, Findings> {
    let draft = &file.draft;
    let mut findings = Findings::new();
    let places = draft.places.iter().map(|place| &place.name);
    let transitions = draft.transitions.iter().map(|transition| &transition.name);
    for word in places.chain(transitions).chain([&draft.name]) {
        check_name(word, &mut findings);
    }
    if let Some(title) = &draft.title
        && title.contains(unkept)
    {
        check_name(&draft.name.derived(title), &mut findings);
    }
    if findings.has_errors() {
        return Err(findings);
    }
    let mut writer = Writer {
        draft,
        positions: &file.positions,
        kept: &file.kept,
        taken: BTreeSet::new(),
        places: BTreeMap::new(),
        out: String::new(),
    };
    writer.document();
    Ok(writer.out)
}

/// What of a net other tools read otherwise or not at all when it is written as PNML: one warning for each kind.
#[must_use]
pub fn only_here(draft: &Draft) -> Findings {
    let mut findings = Findings::new();
    let here = |arc: &&DraftArc| arc.net.is_none();
    let mut warn = |words: &mut dyn Iterator<Item = &Word>, what: &str, instead: &str| {
        let Some(first) = words.next() else { return };
        let (count, name) = (words.count() + 1, &first.text);
        let text = match count {
            1 => format!("{what} (`{name}`): {instead}"),
            _ => format!("{what} (`{name}` and {} more): {instead}", count - 1),
        };
        findings.push(
            Finding::warning("pnt::pnml::only_here", text)
                .at(first.at.clone())
                .help("PNML of ISO/IEC 15909-2 has places, transitions and weighted arcs only; this tool reads back all of it"),
        );
    };
    let transitions = || draft.transitions.iter();
    let places = draft.places.iter();
    let capped = places.filter(|place| place.capacity.is_some());
    warn(
        &mut capped.map(|place| &place.name),
        "capacities",
        "other tools read a place that holds any number of tokens",
    );
    warn(
        &mut transitions().flat_map(|t| t.inhibitors.iter().filter(here).map(|arc| &arc.place)),
        "inhibitor arcs",
        "TAPAAL, PIPE, GreatSPN and PM4Py know them; other tools refuse them or take them for ordinary arcs",
    );
    warn(
        &mut transitions().flat_map(|t| &t.resets),
        "reset arcs",
        "PM4Py knows them; other tools refuse them or, as TAPAAL does, take them for ordinary arcs",
    );
    warn(
        &mut transitions().flat_map(|t| t.reads.iter().filter(here).map(|arc| &arc.place)),
        "read arcs",
        "other tools read a loop, which takes the tokens and puts them back",
    );
    let timed =
        |t: &&DraftTransition| !t.timing.is_immediate() || t.priority > 0 || t.servers.is_some();
    warn(
        &mut transitions().filter(timed).map(|t| &t.name),
        "times, priorities and servers",
        "other tools read transitions that fire whenever their tokens are there",
    );
    let acts = |t: &&DraftTransition| {
        t.action.is_some()
            || !t.sets.is_empty()
            || t.when.is_some()
            || t.tape.is_some()
            || t.write.is_some()
    };
    warn(
        &mut transitions().filter(acts).map(|t| &t.name),
        "actions, failures, functions and tapes",
        "other tools read transitions that fire in one step, always as if they had succeeded",
    );
    warn(
        &mut draft.data.iter().map(|data| &data.name),
        "declared data",
        "other tools do not see it",
    );
    let remote = transitions().flat_map(|t| t.outputs.iter().chain(&t.fail));
    warn(
        &mut remote.filter(|arc| arc.net.is_some()).map(|arc| &arc.place),
        "tokens for other nets",
        "other tools do not see them",
    );
    findings
}

/// What XML cannot hold, or would give back as something else.
fn unkept(c: char) -> bool {
    c.is_control() || ['\u{fffe}', '\u{ffff}'].contains(&c)
}

fn check_name(word: &Word, findings: &mut Findings) {
    if word.text.contains(unkept) || word.text.trim() != word.text {
        findings.push(
            Finding::error(
                "pnt::pnml::name",
                format!(
                    "the name `{}` cannot be kept in PNML",
                    word.text.escape_debug()
                ),
            )
            .at(word.at.clone())
            .help("use a name without control characters and without blanks at its ends"),
        );
    }
}

/// Text with what XML would take for its own escaped.
fn escape(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    for character in text.chars() {
        match character {
            '&' => out.push_str("&amp;"),
            '<' => out.push_str("&lt;"),
            '>' => out.push_str("&gt;"),
            '"' => out.push_str("&quot;"),
            other => out.push(other),
        }
    }
    out
}

struct Writer<'a> {
    draft: &'a Draft,
    positions: &'a Positions,
    kept: &'a Kept,
    /// Ids in use.
    taken: BTreeSet<String>,
    /// Ids of places by name.
    places: BTreeMap<&'a str, String>,
    out: String,
}

impl<'a> Writer<'a> {
    /// Writing to a string cannot fail.
    fn line(&mut self, depth: usize, text: &str) {
        let _ = writeln!(self.out, "{:1$}{text}", "", 2 * depth);
    }

    fn raw(&mut self, depth: usize, parts: &[String]) {
        for part in parts {
            self.line(depth, part);
        }
    }

    /// An id that nobody else has: the kept one, or one made from the name.
    fn id(&mut self, kept: Option<&KeptElement>, name: &str) -> String {
        let kept = kept.and_then(|kept| kept.id.clone());
        let mut base = kept.unwrap_or_else(|| {
            let plain = |c: char| c.is_ascii_alphanumeric() || ['_', '-', '.'].contains(&c);
            let made: String = name
                .chars()
                .map(|c| if plain(c) { c } else { '_' })
                .collect();
            if made.starts_with(|c: char| c.is_ascii_alphabetic() || c == '_') {
                made
            } else {
                format!("_{made}")
            }
        });
        if !self.taken.insert(base.clone()) {
            let free = (2_u64..)
                .map(|number| format!("{base}-{number}"))
                .find(|id| !self.taken.contains(id));
            base = free.unwrap_or(base);
            self.taken.insert(base.clone());
        }
        base
    }

    fn document(&mut self) {
        let (draft, kept) = (self.draft, self.kept);
        let known = |map: &BTreeMap<String, KeptElement>| {
            map.values()
                .filter_map(|kept| kept.id.clone())
                .collect::<Vec<_>>()
        };
        // Ids that are kept are taken by their owners, whatever else is made up before them.
        let mut reserved: BTreeSet<String> = known(&kept.places).into_iter().collect();
        reserved.extend(known(&kept.transitions));
        reserved.extend(kept.net.id.clone());
        self.line(0, "<?xml version=\"1.0\" encoding=\"UTF-8\"?>");
        let mut root = format!("<pnml xmlns=\"{NAMESPACE}\"");
        for (prefix, uri) in &kept.namespaces {
            let _ = write!(root, " xmlns:{prefix}=\"{}\"", escape(uri));
        }
        self.line(0, &format!("{root}>"));
        let net = self.id(Some(&kept.net), &draft.name.text);
        self.line(1, &format!("<net id=\"{}\" type=\"{TYPE}\">", escape(&net)));
        self.name(2, &draft.name, &kept.net.name);
        self.own_of_net();
        self.raw(2, &kept.net.own);
        let page = self.unreserved("page", &reserved);
        self.line(2, &format!("<page id=\"{page}\">"));
        self.raw(3, &kept.page);
        for place in &draft.places {
            self.place(place, &reserved);
        }
        let mut arcs = 0;
        for transition in &draft.transitions {
            self.transition(transition, &reserved, &mut arcs);
        }
        self.line(2, "</page>");
        self.line(1, "</net>");
        self.line(0, "</pnml>");
    }

    /// An id made from a name that no kept element has.
    fn unreserved(&mut self, name: &str, reserved: &BTreeSet<String>) -> String {
        loop {
            let id = self.id(None, name);
            if !reserved.contains(&id) {
                return id;
            }
        }
    }

    fn node_id(
        &mut self,
        kept: Option<&KeptElement>,
        name: &str,
        reserved: &BTreeSet<String>,
    ) -> String {
        match kept {
            Some(kept) if kept.id.is_some() => self.id(Some(kept), name),
            _ => self.unreserved(name, reserved),
        }
    }

    fn name(&mut self, depth: usize, name: &Word, kept: &[String]) {
        self.labelled(depth, "name", &escape(&name.text), kept);
    }

    fn labelled(&mut self, depth: usize, label: &str, text: &str, kept: &[String]) {
        if kept.is_empty() {
            self.line(depth, &format!("<{label}><text>{text}</text></{label}>"));
            return;
        }
        self.line(depth, &format!("<{label}>"));
        self.line(depth + 1, &format!("<text>{text}</text>"));
        self.raw(depth + 1, kept);
        self.line(depth, &format!("</{label}>"));
    }

    /// A section of our own, if there is anything to say.
    fn section(&mut self, depth: usize, title: Option<&str>, text: &str) {
        let text = text.trim();
        if text.is_empty() && title.is_none() {
            return;
        }
        self.line(
            depth,
            &format!("<toolspecific tool=\"{TOOL}\" version=\"1\">"),
        );
        if let Some(title) = title {
            self.line(depth + 1, &format!("<title>{}</title>", escape(title)));
        }
        if !text.is_empty() {
            self.line(depth + 1, &format!("<text>{}</text>", escape(text)));
        }
        self.line(depth, "</toolspecific>");
    }

    /// Everything of the net but its nodes, as net text without its first line.
    fn own_of_net(&mut self) {
        let mut rest = self.draft.clone();
        rest.places.clear();
        rest.transitions.clear();
        let title = rest.title.take();
        let text = rest.to_string();
        let lines = text.split_once('\n').map_or("", |(_, lines)| lines);
        self.section(2, title.as_deref(), lines);
    }

    /// Graphics and tool sections that were kept, or a position.
    fn graphics(&mut self, kept: Option<&KeptElement>, points: &[[f64; 2]]) {
        let own = kept.map_or(&[][..], |kept| &kept.own);
        self.raw(4, own);
        let drawn = own.iter().any(|part| {
            let tag = part.split([' ', '>', '/']).next().unwrap_or_default();
            tag.ends_with("graphics")
        });
        if !drawn && !points.is_empty() {
            let mut text = "<graphics>".to_owned();
            for [x, y] in points {
                let _ = write!(text, "<position x=\"{x}\" y=\"{y}\"/>");
            }
            self.line(4, &(text + "</graphics>"));
        }
    }

    fn place(&mut self, place: &'a DraftPlace, reserved: &BTreeSet<String>) {
        let name = place.name.text.as_str();
        let kept = self.kept.places.get(name);
        let id = self.node_id(kept, name, reserved);
        self.line(3, &format!("<place id=\"{}\">", escape(&id)));
        self.name(4, &place.name, kept.map_or(&[], |kept| &kept.name));
        let at = self.positions.places.get(name).copied();
        self.graphics(kept, at.as_slice());
        let of_label = kept.map_or(&[][..], |kept| &kept.label);
        if place.tokens > 0 || !of_label.is_empty() {
            self.labelled(4, "initialMarking", &place.tokens.to_string(), of_label);
        }
        let rest = DraftPlace {
            name: Word::from("p"),
            tokens: 0,
            ..place.clone()
        };
        self.section(4, None, rest.to_string().trim_start_matches('p'));
        self.line(3, "</place>");
        self.places.insert(name, id);
    }

    fn transition(
        &mut self,
        transition: &'a DraftTransition,
        reserved: &BTreeSet<String>,
        arcs: &mut usize,
    ) {
        let name = transition.name.text.as_str();
        let kept = self.kept.transitions.get(name);
        let id = self.node_id(kept, name, reserved);
        self.line(3, &format!("<transition id=\"{}\">", escape(&id)));
        self.name(4, &transition.name, kept.map_or(&[], |kept| &kept.name));
        let at = self.positions.transitions.get(name).copied();
        self.graphics(kept, at.as_slice());
        // Arcs to places of other nets and of coordination structures have no node to end at here.
        let mut rest = transition.clone();
        rest.inputs.retain(|arc| !self.is_here(arc));
        rest.reads.retain(|arc| !self.is_here(arc));
        rest.inhibitors.retain(|arc| !self.is_here(arc));
        rest.outputs.retain(|arc| !self.is_here(arc));
        rest.resets
            .retain(|place| !self.places.contains_key(place.text.as_str()));
        let text = rest.to_string();
        let lines: Vec<&str> = text.lines().skip(1).map(str::trim).collect();
        self.section(4, None, &lines.join("\n"));
        self.line(3, "</transition>");
        let ends = (name, id.as_str());
        for arc in &transition.inputs {
            self.arc(ends, arc, "", true, reserved, arcs);
        }
        for arc in &transition.reads {
            self.arc(ends, arc, "read", true, reserved, arcs);
            self.arc(ends, arc, "read", false, reserved, arcs);
        }
        for arc in &transition.inhibitors {
            self.arc(ends, arc, "inhibitor", true, reserved, arcs);
        }
        for place in &transition.resets {
            let arc = DraftArc::local(place.clone());
            self.arc(ends, &arc, "reset", true, reserved, arcs);
        }
        for arc in &transition.outputs {
            self.arc(ends, arc, "", false, reserved, arcs);
        }
    }

    fn is_here(&self, arc: &DraftArc) -> bool {
        arc.net.is_none() && self.places.contains_key(arc.place.text.as_str())
    }

    /// An arc between a place and the transition with that name and id.
    fn arc(
        &mut self,
        (name, id): (&str, &str),
        arc: &DraftArc,
        kind: &str,
        from_place: bool,
        reserved: &BTreeSet<String>,
        count: &mut usize,
    ) {
        let place = arc.place.text.as_str();
        let Some(place_id) = self
            .places
            .get(place)
            .filter(|_| self.is_here(arc))
            .cloned()
        else {
            return;
        };
        let key = if from_place {
            (true, place.to_owned(), name.to_owned())
        } else {
            (false, name.to_owned(), place.to_owned())
        };
        let kept = self.kept.arcs.get(&key);
        *count += 1;
        let own = match kept.and_then(|kept| kept.id.as_ref()) {
            Some(own) if !self.taken.contains(own) && !reserved.contains(own) => {
                self.taken.insert(own.clone());
                own.clone()
            }
            _ => self.unreserved(&format!("arc{count}"), reserved),
        };
        let (source, target) = if from_place {
            (place_id.as_str(), id)
        } else {
            (id, place_id.as_str())
        };
        let typed = !matches!(kind, "" | "read");
        let of_type = match typed {
            true => format!(" type=\"{kind}\""),
            false => String::new(),
        };
        let [own, source, target] = [own.as_str(), source, target].map(escape);
        let tag = format!("arc id=\"{own}\" source=\"{source}\" target=\"{target}\"{of_type}");
        self.line(3, &format!("<{tag}>"));
        let opened = self.out.len();
        let of_label = kept.map_or(&[][..], |kept| &kept.label);
        if arc.weight != 1 || !of_label.is_empty() {
            self.labelled(4, "inscription", &arc.weight.to_string(), of_label);
        }
        if typed {
            self.line(4, &format!("<type value=\"{kind}\"/>"));
            self.line(4, &format!("<arctype><text>{kind}</text></arctype>"));
        }
        let points = self.positions.arcs.get(&key);
        self.graphics(kept, points.map_or(&[], Vec::as_slice));
        if kind == "read" {
            self.section(4, None, "read");
        }
        if self.out.len() > opened {
            self.line(3, "</arc>");
        } else {
            self.out.truncate(opened - ">\n".len());
            self.out.push_str("/>\n");
        }
    }
}
