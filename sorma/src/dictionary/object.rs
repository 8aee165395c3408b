//! The dictionary as a service object, `dict`.

use super::Dictionary;
use crate::description::ClassInfo;
use crate::name::suggestion;
use crate::object::{Context, Outcome, ServiceObject};
use crate::options::OptionTable;
use crate::raise;
use crate::report::code;
use crate::transport::Transport;
use crate::words;
use ctos::diagnostic::Findings;
use parking_lot::RwLock;
use std::sync::{Arc, LazyLock};

/// The class `dict`.
pub(crate) struct DictionaryObject {
    dictionary: Arc<RwLock<Dictionary>>,
}

impl DictionaryObject {
    pub(crate) fn of(dictionary: Arc<RwLock<Dictionary>>) -> Self {
        Self { dictionary }
    }
}

/// The dictionary while a request changes it.
#[derive(Clone, Default)]
struct Edit {
    dictionary: Dictionary,
    /// Whether it is to be saved when the whole request is right.
    save: bool,
}

fn index(words: &[String]) -> &str {
    words.first().map_or("", String::as_str)
}

/// The entries whose index words begin so, a line each.
fn found(dictionary: &Dictionary, beginning: &str) -> String {
    let index = dictionary.index();
    let lines = index
        .filter(|index| index.starts_with(beginning))
        .map(|index| {
            let words = dictionary.entry(index).unwrap_or_default();
            words::join(std::iter::once(index).chain(words.iter().map(String::as_str)))
        });
    lines.collect::<Vec<_>>().join("\n")
}

fn unknown(dictionary: &Dictionary, index: &str) -> String {
    let hint = suggestion(index, dictionary.index());
    format!("`{index}` is not in the dictionary{hint}")
}

fn told(findings: &Findings) -> String {
    let lines: Vec<String> = findings.iter().map(ToString::to_string).collect();
    lines.join("; ")
}

/// What a program may know about the class.
pub(crate) fn class() -> ClassInfo {
    OPTIONS.class("dict", env!("CARGO_PKG_VERSION"))
}

static OPTIONS: LazyLock<OptionTable<Edit>> = LazyLock::new(|| {
    OptionTable::new("expands an index word to a list of words: recipes of flavors, daemons")
        .action(
            "add",
            &["WORD", "'WORDS'"],
            "adds or replaces an entry",
            |edit: &mut Edit, words| {
                let [index, recipe] = words else {
                    return Err("takes a word and a list of words".to_owned());
                };
                let words = words::texts(recipe).map_err(|error| error.to_string())?;
                edit.dictionary.add(index, words);
                Ok(String::new())
            },
        )
        .action("remove", &["WORD"], "removes an entry", |edit, words| {
            if edit.dictionary.remove(index(words)) {
                return Ok(String::new());
            }
            Err(unknown(&edit.dictionary, index(words)))
        })
        .action(
            "query",
            &["WORD"],
            "answers an entry as it stands",
            |edit, words| match edit.dictionary.entry(index(words)) {
                Some(words) => Ok(words::join(words.iter().map(String::as_str))),
                None => Err(unknown(&edit.dictionary, index(words))),
            },
        )
        .action("list", &[], "answers all index words", |edit, _| {
            Ok(words::join(edit.dictionary.index()))
        })
        .action(
            "find",
            &["BEGINNING"],
            "answers the entries whose word begins so, a line each",
            |edit, words| Ok(found(&edit.dictionary, index(words))),
        )
        .action(
            "reload",
            &[],
            "reads its files again; what was not saved is lost",
            |edit, _| {
                let read = edit.dictionary.reload();
                read.map(|()| String::new()).map_err(|wrong| told(&wrong))
            },
        )
        .action(
            "save",
            &[],
            "writes its files, with their comments kept",
            |edit, _| {
                edit.save = true;
                Ok(String::new())
            },
        )
});

impl ServiceObject for DictionaryObject {
    fn ctrl(&mut self, _cx: &Context<'_>, io: &mut Transport) -> Outcome {
        let mut edit = Edit {
            dictionary: self.dictionary.read().clone(),
            save: false,
        };
        OPTIONS.ctrl(&mut edit, io);
        if !io.is_ok() {
            return Ok(());
        }
        if edit.save {
            edit.dictionary
                .save()
                .map_err(|text| raise!(code::FILE, "{text}"))?;
        }
        *self.dictionary.write() = edit.dictionary;
        Ok(())
    }

    fn dump(&self) -> String {
        found(&self.dictionary.read(), "")
    }
}
