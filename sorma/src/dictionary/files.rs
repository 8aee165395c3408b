//! A dictionary and its files: read, read again, and written with their comments kept.

use super::{Dictionary, Entry, read};
use crate::words;
use ctos::diagnostic::{Finding, Findings, Source};
use std::io::Write as _;
use std::path::{Path, PathBuf};

/// A file that entries came from.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct File {
    path: PathBuf,
    text: String,
    entries: Vec<Entry>,
}

impl File {
    fn read(path: &Path) -> Result<Self, Findings> {
        let one = |finding: Finding| {
            let mut findings = Findings::new();
            findings.push(finding);
            findings
        };
        let source = Source::read(path).map_err(one)?;
        Ok(Self {
            path: path.to_owned(),
            entries: read(&source)?,
            text: source.text().to_owned(),
        })
    }

    fn has(&self, index: &str) -> bool {
        self.entries.iter().any(|entry| entry.index == index)
    }
}

/// An entry as a line of a file.
fn line(index: &str, words: &[String]) -> String {
    let words = words.iter().map(String::as_str);
    words::join(std::iter::once(index).chain(words)) + "\n"
}

impl Dictionary {
    /// Adds the entries of a file; those that are there already are replaced. The file is remembered
    /// for [`Self::reload`] and [`Self::save`].
    ///
    /// # Errors
    /// It cannot be read, or as [`Self::load`]. Nothing is added then.
    pub fn load_file(&mut self, path: &Path) -> Result<(), Findings> {
        let file = File::read(path)?;
        self.take(&file);
        self.files.retain(|known| known.path != file.path);
        self.files.push(file);
        Ok(())
    }

    fn take(&mut self, file: &File) {
        for entry in &file.entries {
            self.entries
                .insert(entry.index.clone(), entry.words.clone());
        }
    }

    /// Reads all files again. Entries that came from none of them stay; what was changed since and not
    /// saved is as in the files again.
    ///
    /// # Errors
    /// As [`Self::load_file`], for all files at once. Everything is then as before.
    pub fn reload(&mut self) -> Result<(), Findings> {
        let mut findings = Findings::new();
        let mut files = Vec::new();
        for file in &self.files {
            match File::read(&file.path) {
                Ok(file) => files.push(file),
                Err(wrong) => findings.extend(wrong),
            }
        }
        if findings.has_errors() {
            return Err(findings);
        }
        for entry in self.files.iter().flat_map(|file| &file.entries) {
            self.entries.remove(&entry.index);
        }
        for file in &files {
            self.take(file);
        }
        self.files = files;
        Ok(())
    }

    /// Writes all files: changed entries in their places, new ones at the end of the last file, removed
    /// ones left out. Comments and everything else stay as they stand. A file is replaced as a whole or
    /// not at all.
    ///
    /// # Errors
    /// There is no file, or one cannot be written; the text says which.
    pub fn save(&mut self) -> Result<(), String> {
        let Some(last) = self.files.len().checked_sub(1) else {
            return Err(
                "no file to save to: the dictionary was not read from one; name one in `args.dictionary` of the daemon, or \
                 with `scott --local --dict FILE`"
                    .to_owned(),
            );
        };
        let texts: Vec<String> = (0..=last).map(|index| self.text_of(index, last)).collect();
        let mut files = Vec::new();
        for (file, text) in self.files.iter().zip(texts) {
            let path = &file.path;
            if text != file.text {
                replace(path, &text)
                    .map_err(|error| format!("cannot write {}: {error}", path.display()))?;
            }
            let source = Source::new(path.display().to_string(), text.as_str());
            let entries = read(&source).map_err(|findings| {
                let first = findings.iter().next().map(ToString::to_string);
                format!(
                    "what was saved cannot be read: {}",
                    first.unwrap_or_default()
                )
            })?;
            let path = path.clone();
            files.push(File {
                path,
                text,
                entries,
            });
        }
        self.files = files;
        Ok(())
    }

    /// The text of file `index` as it should be now.
    fn text_of(&self, index: usize, last: usize) -> String {
        let Some(file) = self.files.get(index) else {
            return String::new();
        };
        let later = self.files.get(index + 1..).unwrap_or_default();
        let mut text = String::with_capacity(file.text.len());
        let mut at = 0;
        for entry in &file.entries {
            text.push_str(file.text.get(at..entry.span.start).unwrap_or_default());
            at = entry.span.end;
            let as_it_stands = file.text.get(entry.span.clone()).unwrap_or_default();
            let overridden = later.iter().any(|later| later.has(&entry.index));
            match self.entries.get(&entry.index) {
                None => {}
                Some(words) if overridden || *words == entry.words => text.push_str(as_it_stands),
                Some(words) => text.push_str(&line(&entry.index, words)),
            }
        }
        text.push_str(file.text.get(at..).unwrap_or_default());
        if index == last {
            let new = self.entries.iter();
            let new = new.filter(|(index, _)| !self.files.iter().any(|file| file.has(index)));
            for (index, words) in new {
                if !text.is_empty() && !text.ends_with('\n') {
                    text.push('\n');
                }
                text.push_str(&line(index, words));
            }
        }
        text
    }
}

/// Writes a file beside the old one and puts it in its place.
fn replace(path: &Path, text: &str) -> std::io::Result<()> {
    let folder = path
        .parent()
        .filter(|folder| !folder.as_os_str().is_empty());
    let mut file = tempfile::NamedTempFile::new_in(folder.unwrap_or(Path::new(".")))?;
    if let Ok(old) = std::fs::metadata(path) {
        file.as_file().set_permissions(old.permissions())?;
    }
    file.write_all(text.as_bytes())?;
    file.as_file().sync_all()?;
    file.persist(path)?;
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    const TEXT: &str = "# the cookbook\n\nfoo.a -where kitchen # as ever\nfoo.b \\\n  -x 1 \\\n  -y 2\n# in the end\nbar";

    fn of(text: &str) -> (tempfile::TempDir, PathBuf, Dictionary) {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("cook.dict");
        std::fs::write(&path, text).unwrap();
        let mut dictionary = Dictionary::new();
        dictionary.load_file(&path).unwrap();
        (folder, path, dictionary)
    }

    fn words(text: &str) -> Vec<String> {
        text.split(' ').map(str::to_owned).collect()
    }

    #[test]
    fn what_is_not_changed_is_saved_letter_by_letter() {
        let (_folder, path, mut dictionary) = of(TEXT);
        dictionary.save().unwrap();
        assert_eq!(std::fs::read_to_string(path).unwrap(), TEXT);
    }

    #[test]
    fn changes_are_saved_in_their_places_and_comments_stay() {
        let (_folder, path, mut dictionary) = of(TEXT);
        dictionary.add("foo.b", words("-x 3"));
        dictionary.add("new", vec!["two words".to_owned()]);
        assert!(dictionary.remove("foo.a"));
        dictionary.save().unwrap();
        let saved = std::fs::read_to_string(&path).unwrap();
        assert_eq!(
            saved,
            "# the cookbook\n\nfoo.b -x 3\n# in the end\nbar\nnew \"two words\"\n"
        );
        let mut again = Dictionary::new();
        again.load_file(&path).unwrap();
        assert_eq!(again, dictionary);
    }

    #[test]
    fn a_file_that_was_edited_is_read_again_and_a_wrong_one_changes_nothing() {
        let (_folder, path, mut dictionary) = of(TEXT);
        dictionary.add("mine", words("stays"));
        std::fs::write(&path, "foo.a -where garden\n").unwrap();
        dictionary.reload().unwrap();
        let index: Vec<&str> = dictionary.index().collect();
        assert_eq!(index, ["foo.a", "mine"]);
        assert_eq!(dictionary.entry("foo.a").unwrap(), ["-where", "garden"]);
        let before = dictionary.clone();
        std::fs::write(&path, "foo.a 'open\n").unwrap();
        let findings = dictionary.reload().unwrap_err();
        assert!(findings.iter().all(|finding| finding.place.is_some()));
        assert_eq!(dictionary, before);
        std::fs::remove_file(&path).unwrap();
        assert!(dictionary.reload().is_err());
        assert_eq!(dictionary, before);
    }

    #[test]
    fn of_an_entry_in_two_files_the_later_one_is_saved() {
        let (folder, path, mut dictionary) = of("a 1\n");
        let second = folder.path().join("second.dict");
        std::fs::write(&second, "a 2\n").unwrap();
        dictionary.load_file(&second).unwrap();
        dictionary.add("a", words("3"));
        dictionary.save().unwrap();
        assert_eq!(std::fs::read_to_string(path).unwrap(), "a 1\n");
        assert_eq!(std::fs::read_to_string(second).unwrap(), "a 3\n");
    }

    #[test]
    fn without_a_file_nothing_is_saved() {
        let mut dictionary = Dictionary::new();
        dictionary.add("a", words("1"));
        assert!(dictionary.save().unwrap_err().contains("no file"));
    }
}
