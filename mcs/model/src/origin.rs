//! Where a model comes from, by what somebody calls it: built in, or a file in TOML or URDF.

use std::fs;
use std::path::{Path, PathBuf};

use ctos_config::diagnostic::{Finding, Findings};

use super::built_in;
use super::features::Model;
use super::file::{self, Inertias};
use super::urdf;

/// Longer files than this are no descriptions of arms.
const MOST_BYTES: u64 = 64 << 20;

/// Where a model comes from.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Origin {
    /// One that is built in, by its name.
    BuiltIn(String),
    /// A file in TOML, as in `configs/models`.
    Toml(PathBuf),
    /// A file in URDF.
    Urdf(PathBuf),
}

/// A model and what is odd about its description.
#[derive(Debug, Clone)]
pub struct Loaded {
    /// The model, its tip as asked for.
    pub model: Model,
    /// What a reader should know.
    pub warnings: Vec<Finding>,
}

impl Origin {
    /// What is meant by a name: a file ends with `.toml` or `.urdf`, anything else is built in.
    #[must_use]
    pub fn named(name: &str) -> Self {
        let extension = Path::new(name).extension();
        let is = |end: &str| extension.is_some_and(|extension| extension.eq_ignore_ascii_case(end));
        if is("toml") {
            Self::Toml(name.into())
        } else if is("urdf") {
            Self::Urdf(name.into())
        } else {
            Self::BuiltIn(name.to_owned())
        }
    }

    /// The file, if it comes from one.
    #[must_use]
    pub fn file(&self) -> Option<&Path> {
        match self {
            Self::BuiltIn(_) => None,
            Self::Toml(path) | Self::Urdf(path) => Some(path),
        }
    }

    /// Makes the model. `base` is the link of a URDF at which it begins, its root where none is named; `tip` is the link
    /// at which it ends, or a frame of another model.
    ///
    /// # Errors
    /// Everything that is wrong, each with its place in the file if it has one.
    pub fn load(
        &self,
        base: Option<&str>,
        tip: Option<&str>,
        inertias: Inertias,
    ) -> Result<Loaded, Findings> {
        if let Some(path) = self.file() {
            readable(path)?;
        }
        let model = match self {
            Self::Urdf(path) => {
                let found = urdf::read(path, base, tip)?;
                return Ok(Loaded {
                    model: found.model,
                    warnings: found.warnings,
                });
            }
            Self::Toml(path) => file::read(path, inertias)?,
            Self::BuiltIn(name) => match built_in::model(name, inertias) {
                Some(model) => model?,
                None => {
                    let unknown = unusable(format!("there is no model `{name}`"));
                    return Err(unknown.suggest(name, built_in::NAMES).into());
                }
            },
        };
        let model = match tip {
            None => model,
            Some(name) => {
                let Some(tip) = model.frame(name) else {
                    let text = format!("`{}` has no frame `{name}` for its tip", model.name());
                    let frames = model.frames().iter();
                    let known: Vec<&str> = frames.map(|frame| frame.name.as_str()).collect();
                    let help = format!("it has {}", known.join(", "));
                    return Err(unusable(text).help(help).into());
                };
                model.with_tip(tip)
            }
        };
        Ok(Loaded {
            model,
            warnings: Vec::new(),
        })
    }
}

fn unusable(text: String) -> Finding {
    Finding::error("mcs::model::origin", text)
}

/// What is no file might never end, and longer ones than any arm's are not read.
fn readable(path: &Path) -> Result<(), Finding> {
    let name = path.display();
    let about =
        fs::metadata(path).map_err(|error| unusable(format!("cannot read `{name}`: {error}")))?;
    if !about.is_file() {
        return Err(unusable(format!("cannot read `{name}`: it is no file")));
    }
    if about.len() > MOST_BYTES {
        let text = format!("cannot read `{name}`: it is longer than {MOST_BYTES} bytes");
        return Err(unusable(text));
    }
    Ok(())
}
