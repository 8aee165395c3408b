//! Layouts: which panes of the page stand together, and what is plotted. Kept in the file of displays.
//!
//! ```toml
//! [layout.following]
//! title = "How well the arm follows"
//! panes = ["scene", "lanes", "side"]
//! net = "motion"
//! plots = ["number/state/link2/error", "tokens/motion/idle"]
//! ```

use serde::{Deserialize, Serialize};

/// What the page shows together.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Layout {
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub(crate) title: String,
    pub(crate) panes: Vec<Pane>,
    /// The net or overview display that is drawn; none: the net with most commands.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) net: Option<String>,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub(crate) plots: Vec<Plot>,
}

impl Layout {
    /// The nets that it names.
    pub(crate) fn nets(&self) -> Vec<&str> {
        let plotted = self.plots.iter().filter_map(|Plot(key)| {
            let names = key.strip_prefix("tokens/")?;
            names.split('/').next()
        });
        self.net.as_deref().into_iter().chain(plotted).collect()
    }
}

/// A pane of the page.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum Pane {
    /// The scene in three dimensions.
    Scene,
    /// The pictures of the cameras.
    Pictures,
    /// Plans, buttons and sliders.
    Plan,
    /// The net.
    Net,
    /// What tasks sum up of those below them.
    Summary,
    /// What is chosen, in words and numbers.
    Side,
    /// Actions over time. Plots stand above them.
    Lanes,
    /// The table of events.
    Events,
}

impl Pane {
    /// As it is written.
    pub(crate) fn word(self) -> &'static str {
        match self {
            Self::Scene => "scene",
            Self::Pictures => "pictures",
            Self::Plan => "plan",
            Self::Net => "net",
            Self::Summary => "summary",
            Self::Side => "side",
            Self::Lanes => "lanes",
            Self::Events => "events",
        }
    }
}

/// What is plotted: `number/TASK/PART/NAME`, a number of a part of the scene, or `tokens/NET/PLACE`. The page encodes
/// letters of names that a URL cannot hold.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub(crate) struct Plot(String);

impl TryFrom<String> for Plot {
    type Error = String;

    fn try_from(text: String) -> Result<Self, Self::Error> {
        let names: Vec<&str> = text.split('/').collect();
        let known = match names[..] {
            ["number", task, part, number] => ![task, part, number].contains(&""),
            ["tokens", net, place] => ![net, place].contains(&""),
            _ => false,
        };
        match known {
            true => Ok(Self(text)),
            false => Err(format!(
                "`{text}` names nothing to plot: write `number/TASK/PART/NAME` or `tokens/NET/PLACE`"
            )),
        }
    }
}

impl From<Plot> for String {
    fn from(plot: Plot) -> Self {
        plot.0
    }
}

/// A layout as a page is told of it.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub(crate) struct Named<'l> {
    pub(crate) name: &'l str,
    #[serde(flatten)]
    pub(crate) layout: &'l Layout,
}

#[cfg(test)]
mod tests {
    use ctos::{
        config::Node,
        diagnostic::{Findings, Source},
    };

    use super::*;

    fn read(text: &str) -> Result<Layout, String> {
        let mut findings = Findings::new();
        let node = Node::from_toml(&Source::new("app.toml", text), &mut findings);
        let layout = findings.keep(node.parse::<Layout>());
        layout.ok_or_else(|| findings.to_string())
    }

    #[test]
    fn what_is_wrong_in_a_layout_is_told_with_its_place() {
        let good = "panes = [\"scene\", \"lanes\"]\nnet = \"n\"\nplots = [\"number/a/b/c\", \"tokens/m/p\"]\n";
        assert_eq!(read(good).unwrap().nets(), ["n", "m"]);
        for (wrong, says) in [
            ("panes = [\"scenes\"]\n", "scenes"),
            ("panes = []\nplot = []\n", "plot"),
            (
                "panes = []\nplots = [\"number/a/b\"]\n",
                "names nothing to plot",
            ),
            (
                "panes = []\nplots = [\"tokens//p\"]\n",
                "names nothing to plot",
            ),
        ] {
            let told = read(wrong).unwrap_err();
            assert!(told.contains(says) && told.contains("app.toml:"), "{told}");
        }
    }
}
