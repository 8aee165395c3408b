//! Which arm an object of class `kin` or `dyn` is about: one that is built in, one from a file, or a way through a URDF.

use std::{fs, path::Path};

use sorma::{OptionTable, Report};

use super::code;
use crate::model::{FrameId, Model, Placement, built_in, file, file::Inertias, urdf};

/// Longer files than this are no descriptions of arms.
const MOST_BYTES: u64 = 64 << 20;

/// The options that say which arm.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Which {
    pub arm: String,
    /// A file in TOML; empty for none.
    pub model: String,
    /// A file in URDF; empty for none.
    pub urdf: String,
    pub base: String,
    pub tip: String,
}

impl Default for Which {
    fn default() -> Self {
        Self {
            arm: "puma560".to_owned(),
            model: String::new(),
            urdf: String::new(),
            base: String::new(),
            tip: String::new(),
        }
    }
}

/// Options with those that say which arm among them.
pub(super) trait NamesArm: Clone + Default + 'static {
    fn which(&mut self) -> &mut Which;
}

/// Adds the options that describe an arm which is not built in; `tip` says what the frame is for.
pub(super) fn described<T: NamesArm>(table: OptionTable<T>, tip: &'static str) -> OptionTable<T> {
    table
        .word("tip", "FRAME", tip, |options| &mut options.which().tip)
        .word(
            "urdf",
            "FILE",
            "the joints that move between links -base and -tip of a URDF, instead of -arm; bodies off that way are left out",
            |options| &mut options.which().urdf,
        )
        .word(
            "base",
            "LINK",
            "the link of the URDF whose frame is the base frame. Empty: its root",
            |options| &mut options.which().base,
        )
        .word(
            "model",
            "FILE",
            "a model in TOML, as in configs/models, instead of -arm",
            |options| &mut options.which().model,
        )
}

/// An arm, the frame that requests are about, and what is odd about its description.
pub(super) struct Loaded {
    pub model: Model,
    pub tip: FrameId,
    pub warnings: Vec<Report>,
}

/// Height of the shoulder above the base frame, m, of the arms that stand on a pedestal.
pub(super) fn pedestal(arm: &str) -> Option<f64> {
    match arm {
        "puma560" => Some(0.67183),
        "puma600" => Some(0.66),
        _ => None,
    }
}

fn wrong(text: impl std::fmt::Display) -> Report {
    Report::error(code::MODEL, text.to_string())
}

fn named(text: &str) -> Option<&str> {
    (!text.is_empty()).then_some(text)
}

impl Which {
    /// Makes the model. A built-in one on a pedestal stands on one of the height asked for, m.
    pub fn load(&self, inertias: Inertias, height: Option<f64>) -> Result<Loaded, Report> {
        if !self.urdf.is_empty() {
            let path = readable(&self.urdf)?;
            let found = urdf::read(path, named(&self.base), named(&self.tip)).map_err(wrong)?;
            let warnings = found.warnings.iter();
            return Ok(Loaded {
                tip: found.model.tip(),
                warnings: warnings
                    .map(|warning| Report::warning(code::MODEL, warning.to_string()))
                    .collect(),
                model: found.model,
            });
        }
        let mut model = if self.model.is_empty() {
            let model = built_in::model(&self.arm, inertias);
            model.ok_or_else(|| wrong(format!("there is no arm `{}`", self.arm)))?
        } else {
            file::read(readable(&self.model)?, inertias)
        }
        .map_err(wrong)?;
        if let (Some(own), Some(height), true) =
            (pedestal(&self.arm), height, self.model.is_empty())
        {
            model = model.moved(&Placement::shifted(0.0, 0.0, height - own));
        }
        let tip = match named(&self.tip) {
            None => model.tip(),
            Some(name) => model.frame(name).ok_or_else(|| {
                let known: Vec<&str> = model
                    .frames()
                    .iter()
                    .map(|frame| frame.name.as_str())
                    .collect();
                wrong(format!(
                    "`{}` has no frame `{name}` for -tip; it has {}",
                    model.name(),
                    known.join(", ")
                ))
            })?,
        };
        Ok(Loaded {
            model,
            tip,
            warnings: Vec::new(),
        })
    }
}

/// The path, when it leads to a file of sensible length: what is no file might never end.
fn readable(name: &str) -> Result<&Path, Report> {
    let path = Path::new(name);
    let about =
        fs::metadata(path).map_err(|error| wrong(format!("cannot read `{name}`: {error}")))?;
    if !about.is_file() {
        return Err(wrong(format!("cannot read `{name}`: it is no file")));
    }
    if about.len() > MOST_BYTES {
        return Err(wrong(format!(
            "cannot read `{name}`: it is longer than {MOST_BYTES} bytes"
        )));
    }
    Ok(path)
}
