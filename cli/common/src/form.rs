//! The forms in which a net is written or drawn, by one name each in all commands.

use std::path::Path;

use clap::ValueEnum;

/// A form of a net.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, ValueEnum)]
pub enum Form {
    /// Net text
    Text,
    /// PNML (ISO/IEC 15909-2)
    Pnml,
    /// The text of TINA
    Tina,
    /// A drawing as scalable vector graphics, for papers and pages
    #[default]
    Svg,
    /// A drawing in the language of Graphviz
    Dot,
    /// A drawing in the language of Mermaid
    Mermaid,
}

impl Form {
    /// Whether it shows a net and is not read back.
    #[must_use]
    pub fn is_drawing(self) -> bool {
        matches!(self, Self::Svg | Self::Dot | Self::Mermaid)
    }

    /// The form that the name of a file says.
    #[must_use]
    pub fn of_file(file: &Path) -> Option<Self> {
        match file.extension()?.to_str()? {
            "net" => Some(Self::Text),
            "pnml" | "xml" => Some(Self::Pnml),
            "svg" => Some(Self::Svg),
            "dot" | "gv" => Some(Self::Dot),
            "mmd" | "mermaid" => Some(Self::Mermaid),
            _ => None,
        }
    }
}
