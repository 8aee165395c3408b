//! What stands on a panel, and the file that says so.

use std::{fs, path::Path};

use serde::{Deserialize, Serialize};

/// A panel.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Panel {
    /// What stands above it.
    pub title: String,
    /// What stands on it, in this order.
    #[serde(default, rename = "widget")]
    pub widgets: Vec<Widget>,
}

/// One thing on a panel. In a line that is asked, `{name}` stands for a value of the widget.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "lowercase", deny_unknown_fields)]
pub enum Widget {
    /// Asks a line when it is pressed.
    Button {
        /// What stands on it.
        label: String,
        /// The line.
        ask: String,
        /// It stops something: it stands out, and Escape presses it.
        #[serde(default)]
        stop: bool,
    },
    /// Values by sliders. Without `go` a line is asked whenever one of them has been moved.
    Sliders {
        /// What stands above them.
        label: String,
        /// The line, with `{name}` for each value.
        ask: String,
        /// The values.
        values: Vec<Slider>,
        /// What stands on the button that asks; without it, moving a slider does.
        go: Option<String>,
        /// A line whose answer has the values as they are, as its first floats.
        from: Option<String>,
    },
    /// Floats of an answer over time.
    Plot {
        /// What stands above it.
        label: String,
        /// The line.
        ask: String,
        /// How often, s.
        #[serde(default = "often")]
        every_s: f64,
        /// The first float and the last, from 1.
        floats: [usize; 2],
        /// Their names.
        #[serde(default)]
        names: Vec<String>,
        /// Their unit.
        #[serde(default)]
        unit: String,
    },
    /// The text and some floats of an answer, as they are now.
    Readout {
        /// What stands before it.
        label: String,
        /// The line.
        ask: String,
        /// How often, s.
        #[serde(default = "often")]
        every_s: f64,
        /// The first float and the last, from 1; none when it is left out.
        floats: Option<[usize; 2]>,
        /// Their unit.
        #[serde(default)]
        unit: String,
    },
    /// Two values, `{x}` and `{y}` from -1 to 1 times `span`, asked again and again while it is held; arrow keys
    /// move it too.
    Joystick {
        /// What stands above it.
        label: String,
        /// The line.
        ask: String,
        /// What stands for full deflection.
        span: f64,
        /// How often it is asked while it is held, s.
        #[serde(default = "often")]
        every_s: f64,
        /// The unit of both.
        #[serde(default)]
        unit: String,
    },
    /// Every option of an object, made of the table of its class.
    Options {
        /// The object.
        object: String,
        /// What stands above them; the object's name when it is left out.
        label: Option<String>,
    },
}

/// One value.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Slider {
    /// Its name, in the line and beside it.
    pub name: String,
    /// The least and the largest.
    pub range: [f64; 2],
    /// Where it begins; in the middle when nothing is said.
    pub value: Option<f64>,
    /// Its unit.
    #[serde(default)]
    pub unit: String,
}

fn often() -> f64 {
    0.25
}

impl Panel {
    /// Reads a panel's file.
    ///
    /// # Errors
    /// What is wrong, with its place.
    pub fn load(path: &Path) -> Result<Self, String> {
        let name = path.display();
        let text =
            fs::read_to_string(path).map_err(|error| format!("cannot read `{name}`: {error}"))?;
        Self::read(&text).map_err(|why| format!("{name}: {why}"))
    }

    /// Reads a panel.
    ///
    /// # Errors
    /// What is wrong, with its place.
    pub fn read(text: &str) -> Result<Self, String> {
        let panel: Self = toml::from_str(text).map_err(|error| error.to_string())?;
        for widget in &panel.widgets {
            widget.check()?;
        }
        Ok(panel)
    }

    /// The options of one object.
    #[must_use]
    pub fn of_object(object: &str) -> Self {
        Self {
            title: object.to_owned(),
            widgets: vec![Widget::Options {
                object: object.to_owned(),
                label: None,
            }],
        }
    }
}

impl Widget {
    fn check(&self) -> Result<(), String> {
        let (label, ask, names, every_s): (_, _, Vec<&str>, f64) = match self {
            Self::Button { label, ask, .. } => (label, ask, Vec::new(), 1.0),
            Self::Sliders {
                label, ask, values, ..
            } => {
                for slider in values {
                    let [low, high] = slider.range;
                    if low.is_nan() || high.is_nan() || low >= high {
                        return Err(format!(
                            "widget `{label}`: the range of `{}` is [{low}, {high}]; the second number must be the larger one",
                            slider.name
                        ));
                    }
                }
                let names = values.iter().map(|value| value.name.as_str());
                (label, ask, names.collect(), 1.0)
            }
            Self::Plot {
                label,
                ask,
                every_s,
                floats: [first, last],
                ..
            } => {
                if *first == 0 || last < first {
                    return Err(format!(
                        "widget `{label}`: floats are counted from 1, the first and then the last, not [{first}, {last}]"
                    ));
                }
                (label, ask, Vec::new(), *every_s)
            }
            Self::Readout {
                label,
                ask,
                every_s,
                ..
            } => (label, ask, Vec::new(), *every_s),
            Self::Joystick {
                label,
                ask,
                every_s,
                ..
            } => (label, ask, vec!["x", "y"], *every_s),
            Self::Options { .. } => return Ok(()),
        };
        if !(0.02..=3600.0).contains(&every_s) {
            return Err(format!(
                "widget `{label}`: every_s is 0.02 to 3600 s, not {every_s}"
            ));
        }
        let unused = names
            .iter()
            .find(|name| !ask.contains(&format!("{{{name}}}")));
        if let Some(name) = unused {
            return Err(format!(
                "widget `{label}`: its line has no {{{name}}}: {ask}"
            ));
        }
        let filled = names.iter().fold(ask.clone(), |line, name| {
            line.replace(&format!("{{{name}}}"), "0")
        });
        filled
            .parse::<sorma::Request>()
            .map(|_| ())
            .map_err(|error| format!("widget `{label}`: `{ask}` is no request: {error}"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_shipped_panels_are_read_and_their_lines_are_requests() {
        for text in [
            include_str!("../../../configs/panels/puma560.toml"),
            include_str!("../../../configs/panels/vss.toml"),
        ] {
            let panel = Panel::read(text).unwrap();
            assert!(panel.widgets.len() > 1, "{}", panel.title);
        }
    }

    #[test]
    fn what_is_wrong_with_a_panel_is_said_with_its_place() {
        let wrong = |widget: &str| {
            let text = format!("title = \"t\"\n[[widget]]\n{widget}\n");
            Panel::read(&text).unwrap_err()
        };
        let typo = wrong("kind = \"button\"\nlabel = \"b\"\nask = \"foo.a EXEC\"\nsop = true");
        assert!(typo.contains("line") && typo.contains("sop"), "{typo}");
        let kind = wrong("kind = \"knob\"");
        assert!(kind.contains("knob"), "{kind}");
        let line = wrong("kind = \"button\"\nlabel = \"b\"\nask = \"foo.a PLAY\"");
        assert!(line.contains("`foo.a PLAY` is no request"), "{line}");
        let stick = wrong(
            "kind = \"joystick\"\nlabel = \"j\"\nask = \"foo.a EXEC FMSG 1 {x}\"\nspan = 1.0",
        );
        assert!(stick.contains("no {y}"), "{stick}");
        let plot = wrong("kind = \"plot\"\nlabel = \"p\"\nask = \"foo.a EXEC\"\nfloats = [0, 3]");
        assert!(plot.contains("counted from 1"), "{plot}");
        let often = wrong("kind = \"readout\"\nlabel = \"r\"\nask = \"foo.a EXEC\"\nevery_s = 0.0");
        assert!(often.contains("0.02 to 3600"), "{often}");
    }
}
