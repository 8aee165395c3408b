//! What a file of a net holds, whatever its form. Knows no parser of any form.

use std::{collections::BTreeMap, fmt};

use ctos::diagnostic::Findings;

use crate::{compile, draft::Draft, net::Net, pnml::kept::Kept};

/// The form of a file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Format {
    /// Net text (`docs/net-text.md`).
    Text,
    /// Place/transition nets of ISO/IEC 15909-2, and the dialects that tools write.
    Pnml,
    /// The textual form of TINA.
    Tina,
}

impl fmt::Display for Format {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Text => "net text",
            Self::Pnml => "PNML",
            Self::Tina => "TINA text",
        })
    }
}

/// Where the nodes of a picture stand: x to the right, y down, in the file's own unit.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Positions {
    /// Places, by name.
    pub places: BTreeMap<String, [f64; 2]>,
    /// Transitions, by name.
    pub transitions: BTreeMap<String, [f64; 2]>,
    /// Points that an arc passes, by the names of its two ends; the first is a place's if `true`.
    pub arcs: BTreeMap<(bool, String, String), Vec<[f64; 2]>>,
}

/// What a file holds.
#[derive(Debug, Clone)]
pub struct NetFile {
    /// Its form.
    pub format: Format,
    /// The net.
    pub draft: Draft,
    /// Positions, if it has any.
    pub positions: Positions,
    /// What of a PNML file is not a part of the net and is written back.
    pub kept: Kept,
    /// What should be known about it.
    pub warnings: Findings,
}

impl NetFile {
    /// The net of a file, ready to be analysed.
    ///
    /// # Errors
    /// All findings about names used twice or not known in this net.
    pub fn compile(&self) -> Result<Net, Findings> {
        let net = compile::compile(&self.draft)?;
        let findings = compile::without_transitions(&net);
        if findings.has_errors() {
            Err(findings)
        } else {
            Ok(net)
        }
    }
}
