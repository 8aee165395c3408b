//! A configuration as one value that can be sent to another host. It holds its files, the data
//! files that its checks read, and the settings of the command line and the environment here.

use super::app::App;
use super::expander::Expander;
use super::load::lexical;
use super::selection::Selection;
use crate::diagnostic::{Finding, Findings};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::{Component, Path, PathBuf};

/// A configuration, whole. Made by [`App::bundle`]; at the other end [`Bundle::unpack`] lays it
/// down in a folder, from which chassis are started as they are here.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Bundle {
    /// Every file by its path relative to the deepest folder that holds them all, with `/`.
    pub files: BTreeMap<String, String>,
    /// Which of `files` is the app's, the profiles that were chosen and the `--set` texts.
    pub selection: Selection,
    /// The environment variables that the files name. `None` = not set where the bundle was made;
    /// it must not be set where the app is read again.
    pub variables: BTreeMap<String, Option<String>>,
}

/// Why a bundle cannot be laid down.
#[derive(Debug, thiserror::Error)]
pub enum BundleError {
    /// A path that leads out of the folder, or is none.
    #[error(
        "the bundle holds a file `{0}`, which would not stay in its folder; nothing was written"
    )]
    Path(String),
    /// The app's own file is not in it.
    #[error("the bundle has no file `{0}`, which should be the app's")]
    Missing(String),
    /// The system refused.
    #[error("cannot write `{path}`: {error}")]
    Io {
        /// Which file.
        path: PathBuf,
        /// What the system said.
        error: std::io::Error,
    },
}

impl App {
    /// The app's configuration as one value. Make it after the
    /// registry has checked the app: it holds the data files that checks have read through [`App::read`].
    ///
    /// # Errors
    /// A file that is named by an absolute path: the other host would look for it there.
    pub fn bundle(&self) -> Result<Bundle, Finding> {
        let mut files = BTreeMap::new();
        for (path, read) in self.trail.read().iter() {
            if read.absolute {
                let path = path.display();
                let text = format!(
                    "`{path}` is an absolute path, so the app cannot be sent to another host"
                );
                let finding = Finding::error("ctos::config::bundle", text);
                return Err(finding.help("name it relative to the file that names it"));
            }
            files.insert(whole(path)?, read.text.clone());
        }
        let top = common_folder(files.keys());
        let name = |path: &Path| {
            let relative = path.strip_prefix(&top).unwrap_or(path);
            let parts = relative.iter().map(|part| part.to_string_lossy());
            parts.collect::<Vec<_>>().join("/")
        };
        Ok(Bundle {
            files: files
                .iter()
                .map(|(path, text)| (name(path), text.clone()))
                .collect(),
            selection: Selection {
                file: name(&whole(&self.selection.file)?).into(),
                ..self.selection.clone()
            },
            variables: self.trail.used.clone(),
        })
    }
}

/// An absolute path without `.` and `..`.
fn whole(path: &Path) -> Result<PathBuf, Finding> {
    let absolute = std::path::absolute(path).map_err(|error| {
        Finding::error(
            "ctos::file::unreadable",
            format!("cannot find `{}`: {error}", path.display()),
        )
        .help("the current folder may be gone: change into one that is there")
    })?;
    Ok(lexical(&absolute))
}

fn common_folder<'a>(files: impl Iterator<Item = &'a PathBuf>) -> PathBuf {
    let folders = files.map(|file| file.parent().unwrap_or(Path::new("")).to_owned());
    let common = folders.reduce(|one, other| {
        let pairs = one.components().zip(other.components());
        let same = pairs.take_while(|(one, other)| one == other);
        same.map(|(part, _)| part).collect()
    });
    common.unwrap_or_default()
}

impl Bundle {
    /// Reads the app from memory, to look at it. Its data files are not where [`App::folder`]
    /// says; [`unpack`](Self::unpack) a bundle to run it.
    ///
    /// # Errors
    /// As [`load`](super::load).
    pub fn load(&self, expanders: &[(&'static str, &dyn Expander)]) -> Result<App, Findings> {
        let texts = self.files.iter();
        let texts: Vec<_> = texts
            .map(|(path, text)| (path.as_str(), text.as_str()))
            .collect();
        let set = |(name, value): (&String, &Option<String>)| Some((name.clone(), value.clone()?));
        let variables = self.variables.iter().filter_map(set).collect();
        self.selection.load_texts(&texts, &variables, expanders)
    }

    /// Writes the files into `folder`, which is made, and returns what to read the app again by.
    /// The process that reads it must have `variables` set, and those unset that have no value.
    ///
    /// # Errors
    /// [`BundleError`]; a path that leads out of the folder is refused before anything is written.
    pub fn unpack(&self, folder: &Path) -> Result<Selection, BundleError> {
        let plain = |path: &str| {
            let mut parts = Path::new(path).components();
            !path.is_empty() && parts.all(|part| matches!(part, Component::Normal(_)))
        };
        if let Some(path) = self.files.keys().find(|path| !plain(path)) {
            return Err(BundleError::Path(path.clone()));
        }
        let file = &self.selection.file;
        if !self.files.keys().any(|path| Path::new(path) == file) {
            return Err(BundleError::Missing(file.display().to_string()));
        }
        for (path, text) in &self.files {
            let path = folder.join(path);
            let parent = path.parent().unwrap_or(folder);
            std::fs::create_dir_all(parent)
                .and_then(|()| std::fs::write(&path, text))
                .map_err(|error| BundleError::Io { path, error })?;
        }
        Ok(Selection {
            file: folder.join(file),
            ..self.selection.clone()
        })
    }
}
