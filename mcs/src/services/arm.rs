//! Which arm an object of class `kin` or `dyn` is about: one that is built in, one from a file, or a way through a URDF.

use ctos::diagnostic::{Finding, Findings};
use sorma::{OptionTable, Report};

use super::code;
use crate::model::{FrameId, Model, Placement, file::Inertias, origin::Origin};

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

/// What is wrong as one report: with its place before it, where it has one.
fn wrong(findings: Findings) -> Report {
    let told = |finding: &Finding| match (&finding.place, &finding.help) {
        (Some(_), _) => finding.to_string(),
        (None, Some(help)) => format!("{} ({help})", finding.message),
        (None, None) => finding.message.clone(),
    };
    let lines: Vec<String> = findings.into_sorted().iter().map(told).collect();
    Report::error(code::MODEL, lines.join("\n"))
}

fn named(text: &str) -> Option<&str> {
    (!text.is_empty()).then_some(text)
}

impl Which {
    fn origin(&self) -> Origin {
        match (self.urdf.as_str(), self.model.as_str()) {
            ("", "") => Origin::BuiltIn(self.arm.clone()),
            ("", model) => Origin::Toml(model.into()),
            (urdf, _) => Origin::Urdf(urdf.into()),
        }
    }

    /// Makes the model. A built-in one on a pedestal stands on one of the height asked for, m.
    pub fn load(&self, inertias: Inertias, height: Option<f64>) -> Result<Loaded, Report> {
        let origin = self.origin();
        let found = origin.load(named(&self.base), named(&self.tip), inertias);
        let found = found.map_err(wrong)?;
        let warnings = found.warnings.iter();
        let warnings = warnings.map(|warning| Report::warning(code::MODEL, warning.to_string()));
        let mut loaded = Loaded {
            tip: found.model.tip(),
            warnings: warnings.collect(),
            model: found.model,
        };
        if let (Some(own), Some(height), Origin::BuiltIn(_)) =
            (pedestal(&self.arm), height, &origin)
        {
            let higher = Placement::shifted(0.0, 0.0, height - own);
            loaded.model = loaded.model.moved(&higher);
        }
        Ok(loaded)
    }
}
