//! The class `blackboard`: values by key, for several callers (SORMA technical report, figure 1.10). Each
//! has a version that goes up with every change, so to wait for a change is to ask for a later version.

use super::answer::{after, code, int, not_yet, number, split, wrong};
use crate::description::Form;
use crate::name::suggestion;
use crate::object::{Context, Outcome, ServiceObject};
use crate::opaque::Opaque;
use crate::options::OptionTable;
use crate::report::Report;
use crate::transport::Transport;
use crate::words;
use ctos::time::Instant;
use std::collections::BTreeMap;
use std::sync::LazyLock;

#[derive(Debug, Clone, PartialEq)]
struct Entry {
    version: u64,
    at: Instant,
    text: String,
    floats: Vec<f64>,
    opaque: Opaque,
}

#[derive(Debug, Clone)]
pub(super) struct Board {
    capacity: i64,
    entries: BTreeMap<String, Entry>,
    /// The version of the last change of all.
    version: u64,
}

impl Default for Board {
    fn default() -> Self {
        Self {
            capacity: 10_000,
            entries: BTreeMap::new(),
            version: 0,
        }
    }
}

impl Board {
    /// The version of a key's value; 0 when there is none.
    fn version_of(&self, key: &str) -> u64 {
        self.entries.get(key).map_or(0, |entry| entry.version)
    }

    fn set(&mut self, key: &str, text: &str, at: Instant, io: &Transport) -> Result<u64, Report> {
        let is_new = !self.entries.contains_key(key);
        if is_new && self.entries.len() >= usize::try_from(self.capacity).unwrap_or(0) {
            let text = format!(
                "the blackboard has {} keys; remove some, or set -capacity",
                self.entries.len()
            );
            return Err(Report::error(code::FULL, text));
        }
        self.version += 1;
        let entry = Entry {
            version: self.version,
            at,
            text: text.to_owned(),
            floats: io.floats.clone(),
            opaque: io.opaque.to_own(),
        };
        self.entries.insert(key.to_owned(), entry);
        Ok(self.version)
    }

    fn get(&self, key: &str) -> Result<&Entry, Report> {
        self.entries.get(key).ok_or_else(|| {
            let hint = suggestion(key, self.entries.keys().map(String::as_str));
            Report::error(
                code::UNKNOWN,
                format!("the blackboard has no `{key}`{hint}"),
            )
        })
    }
}

pub(super) static OPTIONS: LazyLock<OptionTable<Board>> = LazyLock::new(|| {
    OptionTable::new(
        "values by key. EXEC set KEY [TEXT] with FMSG, opaque: IMSG 1 VERSION; get KEY: the value with IMSG 2, its \
         version and when it was set (ns of the app's time); wait KEY VERSION: the value when it is later than \
         VERSION (0: any), else `not yet`; swap KEY VERSION [TEXT]: as set, but only if the value has that version; \
         remove KEY; keys [PREFIX]; changes VERSION: the keys that changed after it, with IMSG 1, the version now",
    )
    .exec(&[
        Form {
            text: "set KEY",
            floats: Form::ANY,
            takes: "the value",
            gives: "IMSG 1 VERSION",
            results: "",
            help: "sets a value; a text may stand after the key",
        },
        Form {
            text: "swap KEY VERSION",
            floats: Form::ANY,
            takes: "the value",
            gives: "IMSG 1 VERSION",
            results: "",
            help: "sets a value, but only if it has that version",
        },
        Form {
            text: "get KEY",
            floats: 0,
            takes: "",
            gives: "the value; IMSG 2: its version, and when it was set (ns)",
            results: "",
            help: "tells a value",
        },
        Form {
            text: "wait KEY VERSION",
            floats: 0,
            takes: "",
            gives: "the value, or `not yet`",
            results: "",
            help: "tells a value that is later than VERSION",
        },
        Form {
            text: "remove KEY",
            floats: 0,
            takes: "",
            gives: "nothing",
            results: "",
            help: "removes a key",
        },
        Form {
            text: "keys",
            floats: 0,
            takes: "",
            gives: "the keys",
            results: "",
            help: "tells the keys",
        },
        Form {
            text: "keys PREFIX",
            floats: 0,
            takes: "",
            gives: "the keys that begin so",
            results: "",
            help: "tells some of the keys",
        },
        Form {
            text: "changes VERSION",
            floats: 0,
            takes: "",
            gives: "the keys that changed after it; IMSG 1, the version now",
            results: "",
            help: "tells what changed",
        },
    ])
    .int(
        "capacity",
        1..=1_000_000,
        "",
        "the most keys",
        |board: &mut Board| &mut board.capacity,
    )
    .action("clear", &[], "removes all keys", |board, _| {
        board.version += 1;
        let count = board.entries.len();
        board.entries.clear();
        Ok(format!("{count} keys removed"))
    })
});

fn answer(io: &mut Transport, entry: &Entry) {
    io.empty();
    io.text.clone_from(&entry.text);
    io.floats.clone_from(&entry.floats);
    io.opaque.clone_from(&entry.opaque);
    io.ints
        .extend([int(entry.version), int(entry.at.as_nanos())]);
}

fn versioned(io: &mut Transport, version: u64) {
    io.empty();
    io.ints.push(int(version));
}

impl ServiceObject for Board {
    fn exec(&mut self, cx: &Context<'_>, io: &mut Transport) -> Outcome {
        let text = io.text.clone();
        let words = split(&text)?;
        let board = self;
        match words.iter().map(String::as_str).collect::<Vec<_>>()[..] {
            ["set", key, ..] => {
                let version = board.set(key, &after(&text, 2)?, cx.sorm().now(), io)?;
                versioned(io, version);
            }
            ["swap", key, version, ..] => {
                let wanted = number("a version", version)?;
                let has = board.version_of(key);
                if has != wanted {
                    let text = format!("`{key}` has version {has}, not {wanted}; read it again");
                    return Err(Report::error(code::CONFLICT, text));
                }
                let version = board.set(key, &after(&text, 3)?, cx.sorm().now(), io)?;
                versioned(io, version);
            }
            ["get", key] => answer(io, board.get(key)?),
            ["wait", key, version] => {
                let seen = number("a version", version)?;
                match board.entries.get(key) {
                    Some(entry) if entry.version > seen => answer(io, entry),
                    _ => not_yet(io),
                }
            }
            ["remove", key] => {
                board.get(key)?;
                board.version += 1;
                board.entries.remove(key);
                let version = board.version;
                versioned(io, version);
            }
            ["keys"] | ["keys", _] => {
                let prefix = words.get(1).map_or("", String::as_str);
                let keys = board.entries.keys().map(String::as_str);
                let keys = words::join(keys.filter(|key| key.starts_with(prefix)));
                io.empty();
                io.text = keys;
            }
            ["changes", version] => {
                let seen = number("a version", version)?;
                let changed = board
                    .entries
                    .iter()
                    .filter(|(_, entry)| entry.version > seen);
                let keys = words::join(changed.map(|(key, _)| key.as_str()));
                let version = board.version;
                versioned(io, version);
                io.text = keys;
            }
            _ => {
                return Err(wrong(format!(
                    "EXEC takes set KEY [TEXT], get KEY, wait KEY VERSION, swap KEY VERSION [TEXT], remove KEY, \
                     keys [PREFIX] or changes VERSION, not `{text}`"
                )));
            }
        }
        Ok(())
    }

    fn ctrl(&mut self, _cx: &Context<'_>, io: &mut Transport) -> Outcome {
        OPTIONS.ctrl(self, io);
        Ok(())
    }

    fn dump(&self) -> String {
        let mut lines = vec![OPTIONS.dump(self)];
        for (key, entry) in &self.entries {
            lines.push(format!(
                "{} version {} at {}: {} floats={:?} {} bytes",
                words::word(key),
                entry.version,
                entry.at,
                words::quoted(&entry.text),
                entry.floats,
                entry.opaque.len()
            ));
        }
        lines.join("\n")
    }
}
