//! What each word of a net text stands for, for editors. The text is read line by line, whatever is wrong
//! in the other lines, alone or with the files that it includes. Knows no protocol and reads no files.

use std::{collections::BTreeMap, ops::Range};

use ctos::diagnostic::Source;

use super::line::{self, Symbol, Token};

/// What a word stands for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Kind {
    /// The word that begins a line.
    Keyword,
    /// This net or another one.
    Net,
    /// A place.
    Place,
    /// A transition.
    Transition,
    /// A symbol of the input tape.
    Symbol,
    /// A symbol of the output tape.
    Answer,
    /// A request to a coordinator.
    Request,
    /// A local function.
    Function,
    /// An enabling function.
    Enabling,
    /// A task that gets a message.
    Task,
    /// The message's command.
    Command,
    /// A data object.
    Data,
    /// A subnet.
    Subnet,
    /// An instance of a subnet.
    Instance,
    /// A parameter of a subnet.
    Parameter,
    /// An argument of an instance.
    Argument,
}

/// A word in a text.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Occurrence {
    /// What it stands for.
    pub kind: Kind,
    /// The name, without quotes.
    pub name: String,
    /// In which of the texts it stands: 0 for the first.
    pub file: usize,
    /// Its bytes, with quotes.
    pub range: Range<usize>,
    /// Whether it is declared here.
    pub declared: bool,
    /// The subnet in which the name means something; empty for the net itself.
    pub scope: String,
}

/// All words of a text, or of several that are one net.
#[derive(Debug, Default)]
pub struct Outline {
    words: Vec<Occurrence>,
    /// The files that the texts include, as they are written.
    includes: Vec<String>,
    /// Of an instance, by its scope and name, the subnet.
    instances: BTreeMap<(String, String), String>,
    /// Byte range of each transition's lines in the first text, its name's index among the words.
    transitions: Vec<(Range<usize>, usize)>,
}

impl Outline {
    /// Reads a text.
    #[must_use]
    pub fn of(source: &Source) -> Self {
        Self::of_all(std::iter::once(source))
    }

    /// Reads a net's text, which comes first, and those of the files that it includes.
    #[must_use]
    pub fn of_all<'s>(sources: impl IntoIterator<Item = &'s Source>) -> Self {
        let mut walk = Walk::default();
        for (file, source) in sources.into_iter().enumerate() {
            walk.file(file);
            let mut start = 0;
            for with_end in source.text().split_inclusive('\n') {
                let text = with_end.trim_end_matches(['\n', '\r']);
                if let Ok(tokens) = line::cut(source, text, start) {
                    walk.line(&tokens, start + with_end.len());
                }
                start += with_end.len();
            }
        }
        walk.resolve();
        walk.outline
    }

    /// The names of the files that the texts include, as they are written.
    #[must_use]
    pub fn includes(&self) -> &[String] {
        &self.includes
    }

    /// The word at a byte of the first text, or just before it.
    #[must_use]
    pub fn at(&self, offset: usize) -> Option<&Occurrence> {
        self.at_in(0, offset)
    }

    /// The word at a byte of one of the texts, or just before it.
    #[must_use]
    pub fn at_in(&self, file: usize, offset: usize) -> Option<&Occurrence> {
        let touches = |word: &&Occurrence| {
            word.file == file && word.range.start <= offset && offset <= word.range.end
        };
        // Between two words that touch, the one that begins here.
        self.words.iter().rev().find(touches)
    }

    /// Every word that stands for the same thing.
    #[must_use]
    pub fn same(&self, word: &Occurrence) -> Vec<&Occurrence> {
        let key = |word: &Occurrence| (group(word.kind), word.scope.clone(), word.name.clone());
        let wanted = key(word);
        self.words
            .iter()
            .filter(|other| key(other) == wanted)
            .collect()
    }

    /// Where it is declared.
    #[must_use]
    pub fn declaration(&self, word: &Occurrence) -> Option<&Occurrence> {
        self.same(word).into_iter().find(|word| word.declared)
    }

    /// The names of one kind in a scope and, for places of a subnet, in the net around it, in order.
    #[must_use]
    pub fn names(&self, kind: Kind, scope: &str) -> Vec<String> {
        let seen = |word: &&Occurrence| {
            word.kind == kind && (word.scope == scope || word.scope.is_empty())
        };
        let mut names: Vec<String> = self
            .words
            .iter()
            .filter(seen)
            .map(|word| word.name.clone())
            .collect();
        names.sort();
        names.dedup();
        names
    }

    /// Every word, in order.
    #[must_use]
    pub fn words(&self) -> &[Occurrence] {
        &self.words
    }

    /// The transition whose lines hold a byte of the first text.
    #[must_use]
    pub fn transition_at(&self, offset: usize) -> Option<&Occurrence> {
        let around = |(lines, _): &&(Range<usize>, usize)| lines.contains(&offset);
        let (_, word) = self.transitions.iter().find(around)?;
        self.words.get(*word)
    }
}

/// Names of these kinds are the same when they read the same: an argument is most often a place.
fn group(kind: Kind) -> Kind {
    match kind {
        Kind::Argument => Kind::Place,
        other => other,
    }
}

#[derive(Default)]
struct Walk {
    outline: Outline,
    file: usize,
    scope: String,
    parameters: Vec<String>,
    open: Option<usize>,
}

/// A list of tokens taken from its front.
struct Rest<'t>(&'t [Token]);

impl<'t> Rest<'t> {
    fn mark(&mut self, mark: &str) -> bool {
        let found = matches!(self.0.first(), Some(Token { symbol: Symbol::Mark(next), .. }) if *next == mark);
        if found {
            self.0 = self.0.get(1..).unwrap_or_default();
        }
        found
    }

    fn word(&mut self, wanted: &str) -> bool {
        let found = matches!(self.0.first(), Some(Token { symbol: Symbol::Name(next), .. }) if next == wanted);
        if found {
            self.0 = self.0.get(1..).unwrap_or_default();
        }
        found
    }

    fn name(&mut self) -> Option<(&'t str, Range<usize>)> {
        let Some(Token {
            symbol: Symbol::Name(name) | Symbol::Quoted(name),
            range,
            ..
        }) = self.0.first()
        else {
            return None;
        };
        self.0 = self.0.get(1..).unwrap_or_default();
        Some((name, range.clone()))
    }

    fn skip(&mut self) -> bool {
        let more = !self.0.is_empty();
        self.0 = self.0.get(1..).unwrap_or_default();
        more
    }
}

impl Walk {
    /// Another text begins.
    fn file(&mut self, file: usize) {
        self.file = file;
        self.scope.clear();
        self.parameters.clear();
        self.open = None;
    }

    fn push(&mut self, kind: Kind, name: &str, range: Range<usize>, declared: bool) {
        let parameter = self.parameters.iter().any(|parameter| parameter == name);
        let local = matches!(
            kind,
            Kind::Place | Kind::Transition | Kind::Instance | Kind::Parameter | Kind::Argument
        );
        let scope = if local || parameter {
            self.scope.clone()
        } else {
            String::new()
        };
        self.outline.words.push(Occurrence {
            kind: if parameter && kind != Kind::Keyword {
                Kind::Parameter
            } else {
                kind
            },
            name: name.to_owned(),
            file: self.file,
            range,
            declared,
            scope,
        });
    }

    fn next(&mut self, rest: &mut Rest<'_>, kind: Kind, declared: bool) -> bool {
        let Some((name, range)) = rest.name() else {
            return false;
        };
        self.push(kind, name, range, declared);
        true
    }

    /// Names with commas between them.
    fn list(&mut self, rest: &mut Rest<'_>, kind: Kind, declared: bool) {
        while self.next(rest, kind, declared) && rest.mark(",") {}
    }

    fn line(&mut self, tokens: &[Token], end: usize) {
        let mut rest = Rest(tokens);
        let Some(Token {
            symbol: Symbol::Name(_),
            ..
        }) = tokens.first()
        else {
            return;
        };
        let Some((keyword, range)) = rest.name() else {
            return;
        };
        let start = range.start;
        let parameters = std::mem::take(&mut self.parameters);
        self.push(Kind::Keyword, keyword, range, false);
        self.parameters = parameters;
        if super::keywords::CLAUSES.contains(&keyword) {
            self.clause(keyword, &mut rest);
        } else {
            self.open = None;
            self.declaration(keyword, &mut rest);
        }
        if self.file > 0 {
            return;
        }
        if keyword == "transition" && self.open.is_none() {
            let last = self.outline.words.len().saturating_sub(1);
            self.open = Some(self.outline.transitions.len());
            self.outline.transitions.push((start..end, last));
        } else if let Some(open) = self
            .open
            .and_then(|open| self.outline.transitions.get_mut(open))
        {
            open.0.end = end;
        }
    }

    fn declaration(&mut self, keyword: &str, rest: &mut Rest<'_>) {
        match keyword {
            "net" => drop(self.next(rest, Kind::Net, true)),
            "place" => self.places(rest),
            "data" => {
                self.next(rest, Kind::Data, true);
            }
            "command" => {
                self.next(rest, Kind::Symbol, true);
                while !rest.mark("->") && rest.skip() {}
                self.list(rest, Kind::Answer, true);
            }
            "coordinator" => {
                self.next(rest, Kind::Net, true);
                rest.mark(":");
                self.list(rest, Kind::Request, true);
            }
            "serves" => {
                self.next(rest, Kind::Net, true);
                rest.mark(":");
                self.list(rest, Kind::Request, true);
                while rest.mark(";") {
                    let _ = rest.word("done") || rest.word("failed");
                    self.place(rest);
                }
            }
            "safe" => self.arcs(rest),
            "transition" => drop(self.next(rest, Kind::Transition, true)),
            "subnet" => {
                self.parameters.clear();
                let name = rest.name();
                if let Some((name, range)) = name {
                    self.scope.clear();
                    self.push(Kind::Subnet, name, range, true);
                    self.scope = name.to_owned();
                }
                rest.mark("(");
                let mut inner = Rest(rest.0);
                self.list(rest, Kind::Parameter, true);
                while let Some((name, _)) = inner.name() {
                    self.parameters.push(name.to_owned());
                    inner.mark(",");
                }
            }
            "end" => {
                self.scope.clear();
                self.parameters.clear();
            }
            "use" => self.instance(rest),
            "include" => {
                let file = rest.name().map(|(file, _)| file.to_owned());
                self.outline.includes.extend(file);
            }
            _ => {}
        }
    }

    fn places(&mut self, rest: &mut Rest<'_>) {
        while self.next(rest, Kind::Place, true) {
            while !rest.mark(",") {
                if rest.word("data") {
                    self.next(rest, Kind::Data, false);
                } else if !rest.skip() {
                    return;
                }
            }
        }
    }

    fn instance(&mut self, rest: &mut Rest<'_>) {
        let Some((subnet, range)) = rest.name() else {
            return;
        };
        self.push(Kind::Subnet, subnet, range, false);
        if rest.mark("(") {
            while !rest.mark(")") {
                if !self.next(rest, Kind::Argument, false) && !rest.skip() {
                    return;
                }
            }
        }
        if rest.word("as")
            && let Some((name, range)) = rest.name()
        {
            self.push(Kind::Instance, name, range, true);
            let key = (self.scope.clone(), name.to_owned());
            self.outline.instances.insert(key, subnet.to_owned());
        }
    }

    /// A place, or places of instances with points between them.
    fn place(&mut self, rest: &mut Rest<'_>) -> bool {
        let Some((name, range)) = rest.name() else {
            return false;
        };
        let mut last = (name, range);
        let mut path: Vec<&str> = Vec::new();
        while rest.mark(".") {
            self.part(Kind::Instance, &path, &last);
            path.push(last.0);
            let Some(next) = rest.name() else { return true };
            last = next;
        }
        self.part(Kind::Place, &path, &last);
        true
    }

    /// A part of a name with points: its scope is settled when all instances are known.
    fn part(&mut self, kind: Kind, path: &[&str], (name, range): &(&str, Range<usize>)) {
        self.push(kind, name, range.clone(), false);
        if let (false, Some(word)) = (path.is_empty(), self.outline.words.last_mut()) {
            word.scope = format!("{}\0{}", word.scope, path.join("\0"));
        }
    }

    fn resolve(&mut self) {
        for word in &mut self.outline.words {
            let mut parts = word.scope.split('\0').map(str::to_owned);
            let mut scope = parts.next().unwrap_or_default();
            for instance in parts {
                let subnet = self.outline.instances.get(&(scope, instance));
                scope = subnet.cloned().unwrap_or_else(|| "?".to_owned());
            }
            word.scope = scope;
        }
        // A name that a subnet does not declare is that of the net around it.
        let declared: std::collections::BTreeSet<(Kind, String, String)> = self
            .outline
            .words
            .iter()
            .filter(|word| word.declared)
            .map(|word| (word.kind, word.scope.clone(), word.name.clone()))
            .collect();
        let own = |word: &&mut Occurrence| !word.scope.starts_with('@');
        for word in self.outline.words.iter_mut().filter(own) {
            let key = |scope: &str| (group(word.kind), scope.to_owned(), word.name.clone());
            if !declared.contains(&key(&word.scope)) && declared.contains(&key("")) {
                word.scope.clear();
            }
        }
    }

    fn arcs(&mut self, rest: &mut Rest<'_>) {
        while self.place(rest) {
            if rest.mark("@")
                && let Some((net, range)) = rest.name()
            {
                // The place is the other net's.
                if let Some(place) = self.outline.words.last_mut() {
                    place.scope = "@".to_owned() + net;
                }
                self.push(Kind::Net, net, range, false);
            }
            if rest.mark("*") {
                rest.skip();
            }
            if rest.word("data") && self.next(rest, Kind::Data, false) && rest.mark("=") {
                rest.word(crate::draft::DraftSet::REPLY);
            }
            if !rest.mark(",") {
                return;
            }
        }
    }

    fn clause(&mut self, keyword: &str, rest: &mut Rest<'_>) {
        match keyword {
            "in" | "read" | "inhibit" | "reset" | "out" | "fail" => self.arcs(rest),
            "set" => drop(self.next(rest, Kind::Data, false)),
            "tape" => drop(self.next(rest, Kind::Symbol, false)),
            "write" => drop(self.next(rest, Kind::Answer, false)),
            "when" => {
                rest.word("not");
                self.next(rest, Kind::Enabling, false);
            }
            "do" => {
                self.next(rest, Kind::Function, false);
                self.objects(rest);
            }
            "ask" => {
                self.next(rest, Kind::Net, false);
                self.next(rest, Kind::Request, false);
            }
            "send" => {
                self.next(rest, Kind::Task, false);
                rest.mark(".");
                self.next(rest, Kind::Command, false);
                self.objects(rest);
            }
            _ => {}
        }
    }

    /// The data objects of an action.
    fn objects(&mut self, rest: &mut Rest<'_>) {
        rest.mark("(");
        self.list(rest, Kind::Data, false);
        rest.mark("->");
        self.list(rest, Kind::Data, false);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const TEXT: &str = "net n\nplace p = 1 data d, q\nsubnet s(free)\nplace open\ntransition t\n  in open, free, q\nend\nuse s(p) as left\ntransition t\n  in p, left.open\n  out r@m, q*2\n  do f\n";

    fn outline() -> Outline {
        Outline::of(&Source::new("a.net", TEXT))
    }

    /// The texts around the words that are the same as the `nth` word that reads `name`.
    fn same(name: &str, nth: usize) -> Vec<usize> {
        let outline = outline();
        let (at, _) = TEXT.match_indices(name).nth(nth).unwrap();
        let word = outline.at(at).unwrap_or_else(|| panic!("nothing at {at}"));
        assert_eq!(word.name, name);
        let lines = outline.same(word);
        lines
            .iter()
            .map(|word| TEXT[..word.range.start].matches('\n').count() + 1)
            .collect()
    }

    #[test]
    fn a_name_is_found_wherever_it_stands_for_the_same_thing() {
        assert_eq!(
            same("q", 0),
            [2, 6, 11],
            "a subnet sees the places around it"
        );
        assert_eq!(
            same("open", 0),
            [4, 6, 10],
            "an instance's place is its subnet's"
        );
        assert_eq!(same("free", 0), [3, 6]);
        assert_eq!(same("left", 0), [8, 10]);
        // The place that is declared on line 2, as an argument and as an input.
        let outline = outline();
        let p = outline.at(TEXT.find("p = 1").unwrap()).unwrap();
        assert_eq!(outline.same(p).len(), 3);
        assert_eq!(outline.declaration(outline.same(p)[2]), Some(p));
        let remote = outline.at(TEXT.find("r@m").unwrap()).unwrap();
        assert_eq!(outline.same(remote).len(), 1);
        // Also where this net has a place of that name.
        let text = "net n\nplace r\ntransition t\n  out r@m, r\n";
        let outline = Outline::of(&Source::new("b.net", text));
        let remote = outline.at(text.find("r@m").unwrap()).unwrap();
        assert_eq!(outline.same(remote).len(), 1);
    }

    #[test]
    fn a_subnet_of_another_file_means_the_same_in_both() {
        let net = Source::new(
            "net",
            "net n\ninclude \"s.net\"\nplace q = 1\nuse s(q) as a\ntransition t\n  in a.open\n",
        );
        let subnets = Source::new(
            "s",
            "subnet s(free)\nplace open\ntransition t\n  in free, q\n  out open\nend\n",
        );
        let outline = Outline::of_all([&net, &subnets]);
        assert_eq!(outline.includes(), ["s.net"]);
        let same = |file: usize, text: &Source, name: &str| {
            let word = outline
                .at_in(file, text.text().find(name).unwrap())
                .unwrap();
            let same = outline.same(word).into_iter();
            same.map(|word| word.file).collect::<Vec<usize>>()
        };
        assert_eq!(same(0, &net, "open"), [0, 1, 1]);
        assert_eq!(
            same(0, &net, "q ="),
            [0, 0, 1],
            "the subnet's `q` is the net's"
        );
        assert_eq!(same(1, &subnets, "free"), [1, 1]);
        assert_eq!(same(1, &subnets, "s("), [0, 1]);
        assert_eq!(
            same(1, &subnets, "t\n"),
            [1],
            "the net's `t` is another one"
        );
    }

    #[test]
    fn transitions_of_a_subnet_and_of_the_net_are_two() {
        let outline = outline();
        let at = |text: &str| {
            outline
                .transition_at(TEXT.find(text).unwrap())
                .unwrap()
                .scope
                .clone()
        };
        assert_eq!((at("in open"), at("do f")), ("s".to_owned(), String::new()));
    }

    proptest::proptest! {
        #[test]
        fn no_text_makes_it_panic(text in "(place |use |subnet |in |send |as |[a-c.,()@*=\" \n]){0,60}") {
            let outline = Outline::of(&Source::new("any", text.clone()));
            for word in outline.words() {
                proptest::prop_assert!(text.get(word.range.clone()).is_some());
            }
        }
    }
}
