//! The dictionary: an index word stands for a list of words (SORMA technical report, section 1.4.4).
//!
//! It holds the recipes of flavors (`foo.a -breakfast -where kitchen`) and the addresses of daemons
//! (`d1 druide:11`, `FOO self`). Within a recipe, `-SUBST word` stands for the recipe of `word`.

mod files;
pub(crate) mod object;

use crate::name::suggestion;
use crate::raise;
use crate::report::{Report, code};
use crate::words;
use ctos::diagnostic::{Finding, Findings, Source};
use files::File;
use std::collections::{BTreeMap, BTreeSet};
use std::ops::Range;

/// No recipe may look at more words than this, substitutions included.
const MOST_WORDS: usize = 10_000;
/// No recipe may lead through more recipes than this.
const MOST_DEPTH: usize = 64;

/// Index words with what they stand for.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Dictionary {
    entries: BTreeMap<String, Vec<String>>,
    /// The files that it was read from, in their order.
    files: Vec<File>,
}

/// An entry as it stands in a text.
#[derive(Debug, Clone, PartialEq, Eq)]
struct Entry {
    index: String,
    words: Vec<String>,
    /// The bytes of its lines, the last line end included.
    span: Range<usize>,
}

impl Dictionary {
    /// Empty.
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }

    /// Adds the entries of a text; those that are there already are replaced.
    ///
    /// A line is `indexWord word word ...`. A word that begins with `#` begins a comment, and a line
    /// that ends with `\` goes on in the next one. Words with white space are quoted.
    ///
    /// # Errors
    /// Every wrong line with its place: quotes that do not close, an index word that stands in the
    /// text twice. Nothing is added then.
    pub fn load(&mut self, source: &Source) -> Result<(), Findings> {
        let read = read(source)?;
        let entries = read.into_iter().map(|entry| (entry.index, entry.words));
        self.entries.extend(entries);
        Ok(())
    }

    /// Adds an entry for each variable whose name begins with `SORMA_`. The rest of the name is the
    /// index word, with `__` for `.`, so that `SORMA_foo__a` is `foo.a`.
    ///
    /// # Errors
    /// Every value whose quotes do not close. Nothing is added then.
    pub fn load_environment(
        &mut self,
        variables: impl IntoIterator<Item = (String, String)>,
    ) -> Result<(), Findings> {
        let mut findings = Findings::new();
        let mut read = BTreeMap::new();
        for (name, value) in variables {
            let Some(index) = name.strip_prefix("SORMA_").filter(|rest| !rest.is_empty()) else {
                continue;
            };
            match words::texts(&value) {
                Ok(words) => {
                    read.insert(index.replace("__", "."), words);
                }
                Err(error) => {
                    let source = Source::new(format!("${name}"), value.as_str());
                    let finding = Finding::error("sorma::dictionary::line", error.to_string());
                    findings.push(finding.at(source.at(0..value.len())));
                }
            }
        }
        if findings.has_errors() {
            return Err(findings);
        }
        self.entries.extend(read);
        Ok(())
    }

    /// Adds or replaces one entry.
    pub fn add(&mut self, index: impl Into<String>, words: Vec<String>) {
        self.entries.insert(index.into(), words);
    }

    /// Removes an entry; says whether it was there.
    pub fn remove(&mut self, index: &str) -> bool {
        self.entries.remove(index).is_some()
    }

    /// What stands in the dictionary for a word, substitutions not yet made.
    #[must_use]
    pub fn entry(&self, index: &str) -> Option<&[String]> {
        self.entries.get(index).map(Vec::as_slice)
    }

    /// All index words, in alphabetical order.
    pub fn index(&self) -> impl Iterator<Item = &str> {
        self.entries.keys().map(String::as_str)
    }

    /// The recipe of a word with every `-SUBST` replaced, or `None` when it has none.
    ///
    /// # Errors
    /// A `-SUBST` of nothing or of an unknown word, recipes that lead in a circle (which is shown),
    /// and recipes that grow without measure.
    pub fn recipe(&self, index: &str) -> Result<Option<Vec<String>>, Report> {
        if !self.entries.contains_key(index) {
            return Ok(None);
        }
        let mut expansion = Expansion::default();
        self.expand(index, &mut expansion)?;
        Ok(Some(expansion.words))
    }

    fn expand<'a>(&'a self, index: &'a str, now: &mut Expansion<'a>) -> Result<(), Report> {
        let wrong = |text: String| Err(raise!(code::RECIPE, "{text}"));
        let chain = &now.chain;
        if chain.contains(&index) {
            let circle = format!("{} -> {index}", chain.join(" -> "));
            return wrong(format!("recipes lead in a circle: {circle}"));
        }
        if chain.len() >= MOST_DEPTH {
            return wrong(format!(
                "the recipe of `{index}` is nested deeper than {MOST_DEPTH}"
            ));
        }
        let Some(words) = self.entries.get(index) else {
            let by = chain.last().copied().unwrap_or_default();
            let hint = suggestion(index, self.index());
            return wrong(format!(
                "`{by}` says -SUBST {index}, which is not in the dictionary{hint}"
            ));
        };
        now.chain.push(index);
        let mut words = words.iter();
        while let Some(word) = words.next() {
            now.seen += 1;
            if now.seen > MOST_WORDS {
                return wrong(format!(
                    "the recipe of `{index}` has more than {MOST_WORDS} words"
                ));
            }
            if word == "-SUBST" {
                let Some(other) = words.next() else {
                    return wrong(format!(
                        "`{index}`: after -SUBST stands the word to substitute"
                    ));
                };
                self.expand(other, now)?;
            } else {
                now.words.push(word.clone());
            }
        }
        now.chain.pop();
        Ok(())
    }
}

/// A recipe while its substitutions are made.
#[derive(Default)]
struct Expansion<'a> {
    words: Vec<String>,
    /// The recipes being expanded now, outermost first.
    chain: Vec<&'a str>,
    /// Words looked at so far; bounds the work also of recipes that expand to nothing.
    seen: usize,
}

/// The entries of a text, in their order.
fn read(source: &Source) -> Result<Vec<Entry>, Findings> {
    let mut reading = Reading {
        source,
        entries: Vec::new(),
        known: BTreeSet::new(),
        open: None,
        findings: Findings::new(),
    };
    let mut offset = 0;
    for line in source.text().split_inclusive('\n') {
        reading.line(line, offset);
        offset += line.len();
    }
    reading.close();
    if reading.findings.has_errors() {
        return Err(reading.findings);
    }
    Ok(reading.entries)
}

/// A text while it is read.
struct Reading<'a> {
    source: &'a Source,
    entries: Vec<Entry>,
    known: BTreeSet<String>,
    /// The entry whose lines go on.
    open: Option<Entry>,
    findings: Findings,
}

impl Reading<'_> {
    fn line(&mut self, line: &str, start: usize) {
        let end = start + line.len();
        let bare = line.strip_suffix('\n').unwrap_or(line);
        let (found, length) = match words::split_commented(bare) {
            Ok(split) => split,
            Err(error) => {
                let finding = Finding::error("sorma::dictionary::line", error.to_string());
                let place = self.source.at(start..start + bare.len());
                self.findings.push(finding.at(place));
                self.open = None;
                return;
            }
        };
        let last = found.last().filter(|_| length == bare.len());
        let goes_on = last.is_some_and(|word| !word.quoted && word.text == "\\");
        let mut recipe: Vec<String> = found.iter().map(|word| word.text.clone()).collect();
        if goes_on {
            recipe.pop();
        }
        let begun = self.open.get_or_insert_with(|| Entry {
            index: String::new(),
            words: Vec::new(),
            span: start..end,
        });
        begun.span.end = end;
        let mut recipe = recipe.into_iter();
        if begun.index.is_empty()
            && let Some(index) = recipe.next()
        {
            if !self.known.insert(index.clone()) {
                let span = found.first().map_or(0..0, |word| word.span.clone());
                let place = self.source.at(start + span.start..start + span.end);
                let text = format!("`{index}` stands in this file already");
                let finding = Finding::error("sorma::dictionary::twice", text);
                self.findings
                    .push(finding.at(place).help("remove one of the two"));
            }
            begun.index = index;
        }
        begun.words.extend(recipe);
        if !goes_on {
            self.close();
        }
    }

    fn close(&mut self) {
        let entry = self.open.take().filter(|entry| !entry.index.is_empty());
        self.entries.extend(entry);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn load(text: &str) -> Result<Dictionary, Vec<String>> {
        let mut dictionary = Dictionary::new();
        match dictionary.load(&Source::new("cook.dict", text)) {
            Ok(()) => Ok(dictionary),
            Err(findings) => Err(findings
                .into_sorted()
                .iter()
                .map(ToString::to_string)
                .collect()),
        }
    }

    fn recipe(dictionary: &Dictionary, index: &str) -> String {
        let words = dictionary.recipe(index).unwrap().unwrap();
        words::join(words.iter().map(String::as_str))
    }

    #[test]
    fn a_file_has_comments_long_lines_quotes_and_substitution() {
        let dictionary = load(
            "# the cookbook\n\nfoo.a -breakfast -where kitchen # inside\n\
             foo.b -SUBST foo.a \\\n   -where 'the garden' \\\n   -tempo adagio\nempty\nd1 druide:11\n",
        )
        .unwrap();
        assert_eq!(recipe(&dictionary, "foo.a"), "-breakfast -where kitchen");
        assert_eq!(
            recipe(&dictionary, "foo.b"),
            "-breakfast -where kitchen -where \"the garden\" -tempo adagio"
        );
        assert_eq!(recipe(&dictionary, "empty"), "");
        assert_eq!(dictionary.recipe("foo.c"), Ok(None));
        assert_eq!(
            dictionary.index().collect::<Vec<_>>(),
            ["d1", "empty", "foo.a", "foo.b"]
        );
    }

    #[test]
    fn every_wrong_line_is_found_and_nothing_is_loaded() {
        let wrong = load("a 1\nb 'x\n  a 2\nc \"\\q\"\n").unwrap_err();
        assert_eq!(wrong.len(), 3);
        assert!(wrong[0].starts_with("cook.dict:2:1: error: the quote at byte 2 is not closed"));
        assert_eq!(
            wrong[1],
            "cook.dict:3:3: error: `a` stands in this file already (remove one of the two)"
        );
        assert!(wrong[2].starts_with("cook.dict:4:1: error: unknown escape"));
    }

    #[test]
    fn recipes_that_cannot_be_expanded_are_refused_with_the_way_there() {
        let dictionary =
            load("a -SUBST b\nb x -SUBST c\nc -SUBST a\nd -SUBST\ne -SUBST bb\n").unwrap();
        let wrong = |index: &str| dictionary.recipe(index).unwrap_err().text;
        assert_eq!(wrong("a"), "recipes lead in a circle: a -> b -> c -> a");
        assert_eq!(
            wrong("d"),
            "`d`: after -SUBST stands the word to substitute"
        );
        assert_eq!(
            wrong("e"),
            "`e` says -SUBST bb, which is not in the dictionary; did you mean `b`?"
        );
        let mut doubling = Dictionary::new();
        doubling.add("r0", vec!["x".to_owned()]);
        for step in 1..60 {
            let sub = format!("-SUBST r{0} -SUBST r{0}", step - 1);
            doubling.add(
                format!("r{step}"),
                sub.split(' ').map(str::to_owned).collect(),
            );
        }
        assert!(
            doubling
                .recipe("r59")
                .unwrap_err()
                .text
                .contains("more than 10000 words")
        );
    }

    #[test]
    fn doubling_an_empty_recipe_ends() {
        let mut doubling = Dictionary::new();
        doubling.add("r0", Vec::new());
        for step in 1..60 {
            let sub = format!("-SUBST r{0} -SUBST r{0}", step - 1);
            doubling.add(
                format!("r{step}"),
                sub.split(' ').map(str::to_owned).collect(),
            );
        }
        assert!(doubling.recipe("r59").is_err());
    }

    proptest! {
        #[test]
        fn any_file_is_loaded_or_refused_with_a_place(text in "[a-c#'\"\\\\ \n-]{0,60}") {
            let mut dictionary = Dictionary::new();
            if let Err(findings) = dictionary.load(&Source::new("t", text.as_str())) {
                prop_assert!(findings.iter().all(|finding| finding.place.is_some()));
                prop_assert_eq!(dictionary, Dictionary::new());
            } else {
                for index in dictionary.index() {
                    let _ = dictionary.recipe(index);
                }
            }
        }
    }
}
