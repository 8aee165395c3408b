//! Net texts that belong together: nets, and the files whose subnets they include. What is open in the editor counts
//! before what is on disk. A name in a file that several nets include stands in all of them.

use std::{
    collections::{BTreeMap, BTreeSet},
    ops::Range,
    path::{Component, Path, PathBuf},
};

use ctos::diagnostic::Source;
use pnt::text::{
    self,
    outline::{Kind, Occurrence, Outline},
};

/// Files that are read at most; an editor's folder may be a large one.
const MOST_FILES: usize = 2000;
/// A longer file is not a net that a person wrote.
const LONGEST: u64 = 4 << 20;

/// A word's place: its file, and its bytes in it.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub struct Spot {
    /// The file.
    pub file: PathBuf,
    /// First byte, and the one behind the last.
    pub bytes: (usize, usize),
}

impl Spot {
    /// Its bytes.
    pub fn range(&self) -> Range<usize> {
        self.bytes.0..self.bytes.1
    }
}

/// A net with all that it includes, or a file of subnets by itself.
struct Whole {
    /// The net's own file, then the others.
    files: Vec<PathBuf>,
    outline: Outline,
}

impl Whole {
    /// The net of `file`, of texts as they are.
    fn of(file: &Path, texts: &BTreeMap<PathBuf, Source>) -> Option<Self> {
        let files = with_included(file, &mut |path| texts.get(path).cloned());
        let sources: Option<Vec<&Source>> = files.iter().map(|file| texts.get(file)).collect();
        let outline = Outline::of_all(sources?);
        Some(Self { files, outline })
    }

    fn spot(&self, word: &Occurrence) -> Option<Spot> {
        let file = self.files.get(word.file)?.clone();
        let bytes = (word.range.start, word.range.end);
        Some(Spot { file, bytes })
    }

    /// The word that begins at a place, if its file belongs to this net.
    fn word(&self, spot: &Spot) -> Option<&Occurrence> {
        let file = self.files.iter().position(|file| *file == spot.file)?;
        let mut words = self.outline.words().iter();
        words.find(|word| word.file == file && word.range.start == spot.bytes.0)
    }

    /// Everywhere where the word at a place stands for the same thing in this net.
    fn same(&self, spot: &Spot) -> BTreeSet<Spot> {
        let same = self.word(spot).map(|word| self.outline.same(word));
        let same = same.into_iter().flatten();
        same.filter_map(|word| self.spot(word)).collect()
    }
}

/// A net's file, and those that it includes, directly or through others, as far as `read` has them.
fn with_included(file: &Path, read: &mut impl FnMut(&Path) -> Option<Source>) -> Vec<PathBuf> {
    let folder = file.parent().unwrap_or(Path::new(""));
    let mut files = Vec::new();
    let mut waiting = vec![file.to_owned()];
    while let Some(file) = waiting.pop() {
        let Some(source) = read(&file).filter(|_| !files.contains(&file)) else {
            continue;
        };
        files.push(file);
        // Included files are found from the folder of the net, wherever they are themselves.
        let outline = Outline::of(&source);
        let included = outline.includes().iter().rev();
        waiting.extend(included.map(|included| plain(&folder.join(included))));
    }
    files
}

/// A file's text, if it can be that of a net.
fn from_disk(file: &Path) -> Option<Source> {
    let known = std::fs::metadata(file).ok()?;
    (known.is_file() && known.len() <= LONGEST)
        .then(|| Source::read(file).ok())
        .flatten()
}

/// All nets and subnets around an open text.
pub struct Workspace {
    texts: BTreeMap<PathBuf, Source>,
    wholes: Vec<Whole>,
}

impl Workspace {
    /// What is open in the editor, in the folders that it works in, and beside `file`.
    pub fn around(file: &Path, folders: &[PathBuf], open: BTreeMap<PathBuf, Source>) -> Self {
        let mut texts = open;
        let mut files = Vec::new();
        for folder in folders {
            find(folder, true, &mut files);
        }
        if let Some(folder) = file.parent().filter(|_| file.is_absolute()) {
            find(folder, false, &mut files);
        }
        files.extend(texts.keys().cloned());
        for file in files {
            // What it includes may lie elsewhere.
            with_included(&file, &mut |path| {
                if !texts.contains_key(path) {
                    texts.insert(path.to_owned(), from_disk(path)?);
                }
                texts.get(path).cloned()
            });
        }
        Self::of(texts)
    }

    /// These texts by themselves.
    pub fn of(texts: BTreeMap<PathBuf, Source>) -> Self {
        let wholes = texts.keys().filter_map(|file| Whole::of(file, &texts));
        Self {
            wholes: wholes.collect(),
            texts,
        }
    }

    /// The text of a file.
    pub fn text(&self, file: &Path) -> Option<&Source> {
        self.texts.get(file)
    }

    /// The name of a net, if its text gives it one, and its words with those of all that it includes.
    pub fn whole(&self, file: &Path) -> Option<(Option<&str>, &Outline)> {
        let whole = self.wholes.iter().find(|whole| is_of(whole, file));
        whole.map(|whole| (net_of(whole), &whole.outline))
    }

    /// The files whose nets include this one.
    pub fn users<'a>(&'a self, file: &'a Path) -> impl Iterator<Item = &'a Path> {
        let included = self.wholes.iter().filter(move |whole| {
            !is_of(whole, file) && whole.files.iter().any(|other| other == file)
        });
        included.filter_map(|whole| whole.files.first().map(PathBuf::as_path))
    }

    /// All places where the word stands for the same thing. They are in its file, in the nets that
    /// include it, in what those include, and in nets that name a place of this one.
    pub fn same(&self, spot: &Spot) -> BTreeSet<Spot> {
        let mut found = BTreeSet::new();
        let mut waiting = vec![spot.clone()];
        while let Some(spot) = waiting.pop() {
            if !found.insert(spot.clone()) {
                continue;
            }
            for whole in &self.wholes {
                waiting.extend(whole.same(&spot));
                waiting.extend(self.elsewhere(whole, &spot));
            }
        }
        found
    }

    /// The same place of a net, where others name it (`P@net`), and the other way round.
    fn elsewhere(&self, whole: &Whole, spot: &Spot) -> Vec<Spot> {
        let Some(word) = whole.word(spot).filter(|word| word.kind == Kind::Place) else {
            return Vec::new();
        };
        let (net, scope) = match (word.scope.strip_prefix('@'), net_of(whole)) {
            (Some(net), _) => (net.to_owned(), String::new()),
            (None, Some(net)) if word.scope.is_empty() => (net.to_owned(), format!("@{net}")),
            _ => return Vec::new(),
        };
        let nets = self.wholes.iter();
        let called = nets.clone().filter(|whole| net_of(whole) == Some(&net));
        if called.count() != 1 {
            return Vec::new();
        }
        let theirs = nets.filter(|whole| !scope.is_empty() || net_of(whole) == Some(&net));
        let spots = theirs.flat_map(|whole| {
            let words = whole.outline.words().iter().filter(|other| {
                other.kind == Kind::Place && other.scope == scope && other.name == word.name
            });
            words.filter_map(|word| whole.spot(word))
        });
        spots.collect()
    }

    /// Where the word at a place is declared.
    pub fn declarations(&self, spot: &Spot) -> BTreeSet<Spot> {
        let mut same = self.same(spot);
        same.retain(|spot| {
            let words = self.wholes.iter().filter_map(|whole| whole.word(spot));
            words.into_iter().any(|word| word.declared)
        });
        same
    }

    /// Every place that must read `name` when the word at a place is called so.
    ///
    /// # Errors
    /// Why it cannot be called so: something else is, here or in a net that includes this.
    pub fn renamed(&self, spot: &Spot, name: &str) -> Result<BTreeSet<Spot>, String> {
        let spots = self.same(spot);
        if let Some(why) = self.taken(&spots, name) {
            return Err(why);
        }
        let new = text::name_in_text(name);
        let mut texts = self.texts.clone();
        for file in spots.iter().map(|spot| &spot.file).collect::<BTreeSet<_>>() {
            let Some(source) = self.texts.get(file) else {
                continue;
            };
            let edits = spots.iter().filter(|spot| spot.file == *file);
            let changed = edited(source.text(), edits.map(Spot::range), &new);
            let changed = changed.ok_or("the texts have changed")?;
            texts.insert(file.clone(), Source::new(source.name(), changed));
        }
        let after = Self::of(texts);
        let moved = |spot: &Spot| moved(spot, &spots, new.len());
        for (old, new) in self.wholes.iter().zip(&after.wholes) {
            for spot in spots.iter().filter(|spot| old.word(spot).is_some()) {
                let wanted: BTreeSet<Spot> = old.same(spot).iter().map(moved).collect();
                if new.same(&moved(spot)) != wanted {
                    let file = old.files.first().map(|file| file.display().to_string());
                    return Err(format!(
                        "`{name}` stands for something else in {}",
                        file.unwrap_or_default()
                    ));
                }
            }
        }
        Ok(spots)
    }

    /// Why a name is taken already where words stand.
    fn taken(&self, spots: &BTreeSet<Spot>, name: &str) -> Option<String> {
        for whole in &self.wholes {
            for word in spots.iter().filter_map(|spot| whole.word(spot)) {
                let kind = kind_of(word.kind);
                let mut words = whole.outline.words().iter();
                let other = words.find(|other| {
                    other.declared
                        && kind_of(other.kind) == kind
                        && other.scope == word.scope
                        && other.name == name
                        && word.name != name
                });
                if let Some(file) = other.and_then(|other| whole.files.get(other.file)) {
                    let what = name_of(kind);
                    let file = file.file_name().unwrap_or_default().to_string_lossy();
                    return Some(format!("there is a {what} `{name}` already, in {file}"));
                }
            }
        }
        None
    }
}

fn is_of(whole: &Whole, file: &Path) -> bool {
    whole.files.first().is_some_and(|first| first == file)
}

fn kind_of(kind: Kind) -> Kind {
    match kind {
        Kind::Argument => Kind::Place,
        other => other,
    }
}

/// What a kind of name is called.
pub fn name_of(kind: Kind) -> &'static str {
    match kind {
        Kind::Keyword => "keyword",
        Kind::Net => "net",
        Kind::Place | Kind::Argument => "place",
        Kind::Transition => "transition",
        Kind::Symbol => "symbol of the input tape",
        Kind::Answer => "symbol of the output tape",
        Kind::Request => "request",
        Kind::Function => "local function",
        Kind::Enabling => "enabling function",
        Kind::Task => "task",
        Kind::Command => "command",
        Kind::Data => "data object",
        Kind::Subnet => "subnet",
        Kind::Instance => "instance",
        Kind::Parameter => "parameter",
    }
}

/// The name that a net gives itself.
fn net_of(whole: &Whole) -> Option<&str> {
    let mut words = whole.outline.words().iter();
    let named = |pair: &(&Occurrence, &Occurrence)| {
        pair.0.kind == Kind::Keyword && pair.0.name == "net" && pair.1.kind == Kind::Net
    };
    let second = whole.outline.words().iter().skip(1);
    let pair = words.by_ref().zip(second).find(named);
    pair.map(|(_, net)| net.name.as_str())
}

/// A text with a new name at some places, which come in order.
fn edited(text: &str, places: impl Iterator<Item = Range<usize>>, name: &str) -> Option<String> {
    let (mut changed, mut done) = (String::with_capacity(text.len()), 0);
    for place in places {
        changed += text.get(done..place.start)?;
        changed += name;
        done = place.end;
    }
    changed += text.get(done..)?;
    Some(changed)
}

/// Where a word is when all `spots` have a name of so many bytes.
fn moved(spot: &Spot, spots: &BTreeSet<Spot>, length: usize) -> Spot {
    let before = spots
        .iter()
        .filter(|other| other.file == spot.file && other.bytes.0 < spot.bytes.0);
    let (mut removed, mut added) = (0, 0);
    for other in before {
        removed += other.range().len();
        added += length;
    }
    let start = spot.bytes.0 + added - removed;
    let end = if spots.contains(spot) {
        start + length
    } else {
        start + spot.range().len()
    };
    Spot {
        file: spot.file.clone(),
        bytes: (start, end),
    }
}

/// A path without `.` and `..`, as far as it says how.
pub fn plain(path: &Path) -> PathBuf {
    let mut plain = PathBuf::new();
    for component in path.components() {
        match component {
            Component::CurDir => {}
            Component::ParentDir if plain.file_name().is_some() => {
                plain.pop();
            }
            other => plain.push(other),
        }
    }
    plain
}

/// Adds the net texts in a folder and, if `deep`, in those within it. Hidden folders and what a build leaves are
/// left out.
fn find(folder: &Path, deep: bool, files: &mut Vec<PathBuf>) {
    let mut folders = vec![folder.to_owned()];
    let mut seen = 0;
    while let Some(folder) = folders.pop() {
        let Ok(entries) = std::fs::read_dir(&folder) else {
            continue;
        };
        let mut entries: Vec<_> = entries.filter_map(Result::ok).collect();
        entries.sort_by_key(std::fs::DirEntry::file_name);
        for entry in entries {
            seen += 1;
            if seen > MOST_FILES * 10 || files.len() >= MOST_FILES {
                return;
            }
            let name = entry.file_name().to_string_lossy().into_owned();
            let Ok(kind) = entry.metadata() else { continue };
            let hidden = name.starts_with('.') || name == "target" || name == "node_modules";
            if kind.is_dir() && deep && !hidden {
                folders.push(entry.path());
            } else if kind.is_file() && name.ends_with(".net") {
                files.push(plain(&entry.path()));
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn workspace(files: &[(&str, &str)]) -> Workspace {
        let texts = files.iter().map(|(name, text)| {
            let path = PathBuf::from("/w").join(name);
            (path, Source::new(*name, *text))
        });
        Workspace::of(texts.collect())
    }

    /// The place where `what` stands for the first time in a file.
    fn spot(workspace: &Workspace, file: &str, what: &str) -> Spot {
        let file = PathBuf::from("/w").join(file);
        let start = workspace.texts[&file].text().find(what).unwrap();
        let (_, outline) = workspace.whole(&file).unwrap();
        let word = outline.at_in(0, start).unwrap();
        let bytes = (word.range.start, word.range.end);
        Spot { file, bytes }
    }

    const LEFT: &str = "net left\ninclude \"parts.net\"\nplace idle = 1\nuse hand(idle) as one\ntransition t\n  in one.open\n  out one.closed, idle, far@right\n";
    const RIGHT: &str = "net right\ninclude \"parts.net\"\nplace idle = 1, far\nuse hand(far) as two\ntransition t\n  in two.open\n  out idle\n";
    const PARTS: &str = "subnet hand(free)\nplace open, closed\ntransition close\n  in open, free, idle\n  out closed\nend\n";

    fn all() -> Workspace {
        workspace(&[
            ("left.net", LEFT),
            ("right.net", RIGHT),
            ("parts.net", PARTS),
        ])
    }

    fn counted(spots: &BTreeSet<Spot>, file: &str) -> usize {
        spots
            .iter()
            .filter(|spot| spot.file.ends_with(file))
            .count()
    }

    #[test]
    fn a_place_of_a_subnet_is_found_in_every_net_that_includes_it() {
        let all = all();
        for (file, what) in [
            ("left.net", "open"),
            ("right.net", "open"),
            ("parts.net", "open"),
        ] {
            let same = all.same(&spot(&all, file, what));
            let counts = ["left.net", "right.net", "parts.net"].map(|file| counted(&same, file));
            assert_eq!(counts, [1, 1, 2], "from {file}");
        }
        let users: Vec<&Path> = all.users(Path::new("/w/parts.net")).collect();
        assert_eq!(users, [Path::new("/w/left.net"), Path::new("/w/right.net")]);
    }

    #[test]
    fn a_name_that_a_subnet_takes_from_the_nets_around_it_is_that_of_all_of_them() {
        let all = all();
        let same = all.same(&spot(&all, "left.net", "idle"));
        let counts = ["left.net", "right.net", "parts.net"].map(|file| counted(&same, file));
        assert_eq!(counts, [3, 2, 1]);
        let declared = all.declarations(&spot(&all, "parts.net", "idle"));
        assert_eq!(
            (
                counted(&declared, "left.net"),
                counted(&declared, "right.net")
            ),
            (1, 1)
        );
    }

    #[test]
    fn a_place_of_another_net_is_found_where_it_is_declared() {
        let all = all();
        for (file, what) in [("left.net", "far@"), ("right.net", "far")] {
            let same = all.same(&spot(&all, file, what));
            assert_eq!(
                (counted(&same, "left.net"), counted(&same, "right.net")),
                (1, 2)
            );
        }
    }

    #[test]
    fn a_name_that_is_taken_or_would_be_caught_by_a_subnet_is_refused() {
        let all = all();
        let taken = all.renamed(&spot(&all, "left.net", "open"), "closed");
        assert_eq!(
            taken.unwrap_err(),
            "there is a place `closed` already, in parts.net"
        );
        // In the file of the subnet by itself, `idle` is a name of the subnet as `open` is.
        let taken = all.renamed(&spot(&all, "left.net", "idle"), "open");
        assert_eq!(
            taken.unwrap_err(),
            "there is a place `open` already, in parts.net"
        );
        // What the subnet takes from the nets around it would be its own.
        let caught = all.renamed(&spot(&all, "left.net", "open"), "idle");
        let caught = caught.unwrap_err();
        assert!(
            caught.contains("`idle` stands for something else in"),
            "{caught}"
        );
    }

    proptest! {
        /// Texts of any kind, in three files, of which some include others.
        #[test]
        fn whatever_is_in_the_files_every_word_is_the_same_as_those_that_are_the_same_as_it(
            texts in proptest::collection::vec(
                "(net [ab]\n|include \"[xyz].net\"\n|place [ab], c\n|subnet [st]\\([ab]\\)\n|end\n|use [st]\\([ab]\\) as [ij]\n|transition t\n|  in [ab], [ij]\\.c, [ab]@[ab]\n){0,9}",
                3,
            ),
        ) {
            let names = ["x.net", "y.net", "z.net"];
            let files: Vec<(&str, &str)> = names.into_iter().zip(texts.iter().map(String::as_str)).collect();
            let all = workspace(&files);
            for whole in &all.wholes {
                for word in whole.outline.words().iter().filter(|word| word.kind != Kind::Keyword) {
                    let spot = whole.spot(word).unwrap();
                    let same = all.same(&spot);
                    prop_assert!(same.contains(&spot));
                    for other in &same {
                        prop_assert!(all.same(other).contains(&spot), "{spot:?} {other:?}");
                    }
                    let _ = all.renamed(&spot, "new");
                }
            }
        }
    }
}
