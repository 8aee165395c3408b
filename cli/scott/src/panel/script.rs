//! What stands on a panel, and the file that says so.

use ctos::{
    config::Node,
    diagnostic::{Finding, Findings, Source},
};
use serde::{Deserialize, Serialize, de::IgnoredAny};

use super::logic::{Expression, Kind, Value};

/// A panel.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Panel {
    /// What stands above it.
    pub title: String,
    /// What its expressions are about.
    #[serde(default, rename = "value")]
    pub values: Vec<Value>,
    /// How often these are asked for, s.
    #[serde(default = "often")]
    pub values_every_s: f64,
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
        /// It stops something: it stands above everything else, wherever the page is, and Escape presses the first one.
        #[serde(default)]
        stop: bool,
        /// What it does, in some words.
        #[serde(default)]
        help: String,
        /// The condition under which it can be pressed.
        when: Option<String>,
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
        /// The condition under which they can be used.
        when: Option<String>,
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
        /// As many other floats, of which the first ones are taken away: an error is a setpoint less a position.
        less: Option<[usize; 2]>,
        /// Whether the answer is that of `shmem_r`: records of a snapshot buffer, each with all floats and its time.
        #[serde(default)]
        records: bool,
        /// A line that a page that may change something asks first, for there to be something to show.
        begin: Option<String>,
        /// What each is multiplied by, to be in its unit.
        #[serde(default = "one")]
        scale: f64,
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
        /// The first float and the last, from 1; `None` when it is left out.
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
        /// The condition under which it can be used.
        when: Option<String>,
    },
    /// Two buttons for each joint or axis, which is moved on by a small step again and again while one is held.
    Jog {
        /// What stands above it.
        label: String,
        /// The line, in which `{by}` stands for how many numbers there are and the numbers: 0 but for what is moved.
        ask: String,
        /// A line that the page asks before the first step: what makes the steps follow each other soon.
        begin: Option<String>,
        /// A line that is answered as `slots EXEC` is: it names the joints, and shows each within its limits.
        slots: Option<String>,
        /// The axes, where no joints are meant.
        #[serde(default)]
        axes: Vec<Axis>,
        /// A line whose floats the axes show.
        from: Option<String>,
        /// How far a step goes: of what turns, rad, and of what slides, m.
        #[serde(default = "step")]
        step: Step,
        /// The condition under which it can be used.
        when: Option<String>,
    },
    /// Positions with names, which are kept in the files of a dictionary.
    Poses {
        /// What stands above them.
        label: String,
        /// What their words in the dictionary begin with, as in `position.left.`.
        #[serde(default = "beginning")]
        beginning: String,
        /// The dictionary.
        #[serde(default = "dictionary")]
        dictionary: String,
        /// The line that goes to one, with `{name}`.
        ask: String,
        /// A line whose first floats are the positions now.
        from: String,
        /// How many.
        joints: usize,
        /// The condition under which one can be gone to.
        when: Option<String>,
    },
    /// What follows from the panel's values: a number, a text, or whether a condition is met.
    Value {
        /// What stands before it.
        label: String,
        /// The expression.
        is: String,
        /// Its unit.
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
    /// Where it begins; in the middle by default.
    pub value: Option<f64>,
    /// Its unit.
    #[serde(default)]
    pub unit: String,
}

/// What a jog moves that is not a joint.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Axis {
    /// Its name.
    pub name: String,
    /// Its unit: a step is as long as that of what turns, if this is rad.
    pub unit: String,
    /// Which float of `from` it shows, from 1.
    pub float: Option<usize>,
}

/// How far a step of a jog goes.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Step {
    /// Of what turns, rad.
    pub turn: f64,
    /// Of what slides, m.
    pub slide: f64,
}

fn often() -> f64 {
    0.25
}

fn one() -> f64 {
    1.0
}

fn step() -> Step {
    Step {
        turn: 0.02,
        slide: 0.005,
    }
}

fn beginning() -> String {
    "position.".to_owned()
}

fn dictionary() -> String {
    "dict".to_owned()
}

/// How often something may be asked, s.
const EVERY_S: std::ops::RangeInclusive<f64> = 0.02..=3600.0;

/// The file; its widgets are read one by one, so that one mistake does not hide the next.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct File {
    title: String,
    #[serde(default, rename = "value")]
    _values: Vec<IgnoredAny>,
    #[serde(default = "often")]
    values_every_s: f64,
    #[serde(default, rename = "widget")]
    _widgets: Vec<IgnoredAny>,
}

/// What stands for the arm in the file of a panel that is the same for several.
const ARM: &str = "{arm}";

/// The arm of such a panel, where nobody says which.
pub const SOME_ARM: &str = "arm";

/// The names of the joints of such an arm, where nobody says others.
pub const SOME_JOINTS: [&str; 6] = ["waist", "shoulder", "elbow", "roll", "bend", "flange"];

/// The text of a panel for each of the arms, which have these joints; one, when it names no arm. Of n joints `{n}`, `{n+4}`, `{2n+1}`
/// and the like stand for numbers, and `{joints}` for a list of their names.
pub(super) fn for_arms(source: &Source, arms: &[String], joints: &[String]) -> Vec<Source> {
    let text = source.text();
    if !text.contains(ARM) {
        return vec![source.clone()];
    }
    let text = filled(text, joints.len()).replace("{joints}", &format!("{joints:?}"));
    let of = |arm: &String| Source::new(source.name(), text.replace(ARM, arm));
    arms.iter().map(of).collect()
}

/// A text in which numbers stand for those that follow from `n`.
fn filled(text: &str, n: usize) -> String {
    let number = |word: &str| {
        let (times, more) = word.split_once('n')?;
        let times: usize = if times.is_empty() {
            1
        } else {
            times.parse().ok()?
        };
        let more: usize = match more {
            "" => 0,
            more => more.strip_prefix('+')?.parse().ok()?,
        };
        times.checked_mul(n)?.checked_add(more)
    };
    let mut parts = text.split('{');
    let mut out = parts.next().unwrap_or_default().to_owned();
    for part in parts {
        let found = part.split_once('}');
        match found.and_then(|(word, rest)| Some((number(word)?, rest))) {
            Some((number, rest)) => out += &format!("{number}{rest}"),
            None => out += &format!("{{{part}"),
        }
    }
    out
}

impl Panel {
    /// Reads a panel's file; a widget that is wrong is left out and said, with its place.
    pub fn read(source: &Source, findings: &mut Findings) -> Option<Self> {
        let root = Node::from_toml(source, findings);
        let file: File = findings.keep(root.parse())?;
        let wrong = |node: &Node, code: &'static str, why: String| {
            let finding = Finding::error(code, why);
            match node.place() {
                Some(place) => finding.at(place.clone()),
                None => finding,
            }
        };
        let mut values: Vec<Value> = Vec::new();
        let written = root.get("value").map(Node::elements);
        for node in written.unwrap_or_default() {
            let Some(value) = findings.keep(node.parse::<Value>()) else {
                continue;
            };
            let again = values.iter().any(|other| other.name == value.name);
            let name = &value.name;
            let checked = match again {
                true => Err(format!("value `{name}` is there already")),
                false => value.check(),
            };
            match checked {
                Ok(()) => values.push(value),
                Err(why) => findings.push(wrong(node, "sorma::panel::value", why)),
            }
        }
        if !EVERY_S.contains(&file.values_every_s) {
            let why = format!(
                "values_every_s is 0.02 to 3600 s, not {}",
                file.values_every_s
            );
            let node = root.get("values_every_s").unwrap_or(&root);
            findings.push(wrong(node, "sorma::panel::value", why));
        }
        let mut widgets = Vec::new();
        let written = root.get("widget").map(Node::elements);
        for node in written.unwrap_or_default() {
            let Some(widget) = findings.keep(node.parse::<Widget>()) else {
                continue;
            };
            match widget.check().and_then(|()| widget.check_logic(&values)) {
                Ok(()) => widgets.push(widget),
                Err(why) => findings.push(wrong(node, "sorma::panel::widget", why)),
            }
        }
        Some(Self {
            title: file.title,
            values,
            values_every_s: file.values_every_s,
            widgets,
        })
    }

    /// The options of one object.
    #[must_use]
    pub fn of_object(object: &str) -> Self {
        Self {
            title: object.to_owned(),
            values: Vec::new(),
            values_every_s: often(),
            widgets: vec![Widget::Options {
                object: object.to_owned(),
                label: None,
            }],
        }
    }
}

impl Widget {
    /// The lines by which it shows how it stands; such a line changes nothing.
    pub(super) fn looks(&self) -> Vec<String> {
        match self {
            Self::Plot { ask, .. } | Self::Readout { ask, .. } => vec![ask.clone()],
            Self::Sliders { from, .. } => from.iter().cloned().collect(),
            Self::Jog { slots, from, .. } => slots.iter().chain(from).cloned().collect(),
            Self::Poses { from, .. } => vec![from.clone(), self.finds().unwrap_or_default()],
            Self::Button { .. }
            | Self::Joystick { .. }
            | Self::Options { .. }
            | Self::Value { .. } => Vec::new(),
        }
    }

    /// The line by which a dictionary tells the poses.
    pub(super) fn finds(&self) -> Option<String> {
        match self {
            Self::Poses {
                dictionary,
                beginning,
                ..
            } => Some(format!("{dictionary} CTRL -find {beginning}")),
            _ => None,
        }
    }

    /// The condition under which it can be used, and what it shows of the panel's values.
    pub(super) fn logic(&self) -> (Option<&str>, Option<&str>) {
        match self {
            Self::Button { when, .. }
            | Self::Sliders { when, .. }
            | Self::Jog { when, .. }
            | Self::Poses { when, .. }
            | Self::Joystick { when, .. } => (when.as_deref(), None),
            Self::Value { is, .. } => (None, Some(is)),
            Self::Plot { .. } | Self::Readout { .. } | Self::Options { .. } => (None, None),
        }
    }

    fn check_logic(&self, values: &[Value]) -> Result<(), String> {
        let (when, is) = self.logic();
        if let Self::Button {
            stop: true,
            when: Some(_),
            label,
            ..
        } = self
        {
            return Err(format!(
                "widget `{label}`: what stops something can always be pressed; leave out `when`"
            ));
        }
        if let Some(when) = when {
            let kind = Expression::read(when, values)?.kind(values)?;
            if kind != Kind::Truth {
                return Err(format!(
                    "`when` is a condition, for example `x > 1`, not `{when}`"
                ));
            }
        }
        if let Some(is) = is {
            Expression::read(is, values)?;
        }
        Ok(())
    }

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
                floats,
                less,
                begin,
                ..
            } => {
                for [first, last] in [Some(floats), less.as_ref()].into_iter().flatten() {
                    if *first == 0 || last < first {
                        return Err(format!(
                            "widget `{label}`: floats are counted from 1, the first and then the last, not [{first}, {last}]"
                        ));
                    }
                }
                let count = |[first, last]: &[usize; 2]| last - first;
                if less
                    .as_ref()
                    .is_some_and(|less| count(less) != count(floats))
                {
                    return Err(format!(
                        "widget `{label}`: `less` has as many floats as `floats`"
                    ));
                }
                is_request(label, begin.as_deref())?;
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
            Self::Jog {
                label,
                ask,
                begin,
                slots,
                axes,
                from,
                step,
                ..
            } => {
                if slots.is_none() == axes.is_empty() {
                    return Err(format!(
                        "widget `{label}`: it jogs either the joints that `slots` tells of, or `axes`"
                    ));
                }
                if !(step.turn > 0.0 && step.slide > 0.0) {
                    return Err(format!("widget `{label}`: a step is above 0"));
                }
                for line in [begin, slots, from] {
                    is_request(label, line.as_deref())?;
                }
                (label, ask, vec!["by"], 1.0)
            }
            Self::Poses {
                label, ask, from, ..
            } => {
                for line in [Some(from.clone()), self.finds()] {
                    is_request(label, line.as_deref())?;
                }
                (label, ask, vec!["name"], 1.0)
            }
            Self::Options { .. } | Self::Value { .. } => return Ok(()),
        };
        if !EVERY_S.contains(&every_s) {
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
            // As many numbers as are said.
            let example = if *name == "by" { "1 0" } else { "0" };
            line.replace(&format!("{{{name}}}"), example)
        });
        is_request(label, Some(&filled))
    }
}

fn is_request(label: &str, line: Option<&str>) -> Result<(), String> {
    let Some(line) = line else { return Ok(()) };
    let request = line.parse::<sorma::Request>().map(|_| ());
    request.map_err(|error| format!("widget `{label}`: `{line}` is no request: {error}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn six() -> Vec<String> {
        SOME_JOINTS.map(str::to_owned).into()
    }

    fn read(text: &str) -> (Option<Panel>, Vec<String>) {
        let mut findings = Findings::new();
        let source = Source::new("p.toml", text);
        let source = for_arms(&source, &[SOME_ARM.to_owned()], &six()).remove(0);
        let panel = Panel::read(&source, &mut findings);
        (panel, findings.iter().map(ToString::to_string).collect())
    }

    #[test]
    fn the_shipped_panels_are_read_and_their_lines_are_requests() {
        for text in [
            include_str!("../../../../configs/panels/puma560.toml"),
            include_str!("../../../../configs/panels/vss.toml"),
            include_str!("../../../../configs/panels/pendant.toml"),
        ] {
            let (panel, findings) = read(text);
            assert_eq!(findings, Vec::<String>::new());
            let panel = panel.unwrap();
            assert!(panel.widgets.len() > 1, "{}", panel.title);
        }
    }

    #[test]
    fn a_panel_that_names_an_arm_stands_once_for_each_and_any_other_one_once() {
        let arms = ["left".to_owned(), "right".to_owned()];
        let titles = |text: &str| {
            let panels = for_arms(&Source::new("p.toml", text), &arms, &six()).into_iter();
            let panels = panels.filter_map(|source| Panel::read(&source, &mut Findings::new()));
            panels.map(|panel| panel.title).collect::<Vec<_>>()
        };
        assert_eq!(titles("title = \"{arm} arm\""), ["left arm", "right arm"]);
        assert_eq!(titles("title = \"no arm\""), ["no arm"]);
    }

    /// The floats of the plots of a pendant, with those that are taken away, and how many poses have.
    fn numbers(panel: &Panel) -> Vec<[usize; 4]> {
        let each = panel.widgets.iter().filter_map(|widget| match widget {
            Widget::Plot {
                floats: [first, last],
                less,
                records: true,
                ..
            } => {
                let [from, to] = less.unwrap_or_default();
                Some([*first, *last, from, to])
            }
            Widget::Poses { joints, .. } => Some([*joints; 4]),
            _ => None,
        });
        each.collect()
    }

    #[test]
    fn one_pendant_is_for_arms_of_any_number_of_joints() {
        let text = include_str!("../../../../configs/panels/pendant.toml");
        let arms = ["left".to_owned(), "right".to_owned()];
        for n in [1, 6, 9, 18] {
            let names: Vec<String> = (1..=n).map(|joint| format!("joint {joint}")).collect();
            let panels = for_arms(&Source::new("p.toml", text), &arms, &names);
            assert_eq!(panels.len(), 2);
            for (source, arm) in panels.iter().zip(&arms) {
                let mut findings = Findings::new();
                let panel = Panel::read(source, &mut findings).unwrap();
                assert!(!findings.has_errors(), "{findings}");
                assert_eq!(panel.title, format!("Teach pendant: {arm}"));
                // Records have positions, speeds, setpoints and torques of all joints, one after the other.
                let expected = [
                    [n; 4],
                    [1, n, 0, 0],
                    [2 * n + 1, 3 * n, 1, n],
                    [3 * n + 1, 4 * n, 0, 0],
                ];
                assert_eq!(numbers(&panel), expected);
                let Some(Widget::Plot { names: shown, .. }) =
                    (panel.widgets.iter()).find(|one| matches!(one, Widget::Plot { .. }))
                else {
                    panic!("no plot");
                };
                assert_eq!(*shown, names);
                // The columns of a pose by rows, which comes after the joints: x, y and z stand in the last one.
                let places = panel.widgets.iter().filter_map(|widget| match widget {
                    Widget::Jog { axes, .. } => Some(axes.iter().filter_map(|axis| axis.float)),
                    _ => None,
                });
                let places: Vec<usize> = places.flatten().collect();
                assert_eq!(places, [n + 4, n + 8, n + 12]);
            }
        }
    }

    #[test]
    fn nothing_that_moves_the_arm_can_be_pressed_while_another_task_holds_it() {
        for text in [
            include_str!("../../../../configs/panels/puma560.toml"),
            include_str!("../../../../configs/panels/pendant.toml"),
        ] {
            let (panel, _) = read(text);
            let panel = panel.unwrap();
            let mut moving = 0;
            for widget in &panel.widgets {
                let moves = match widget {
                    Widget::Button { ask, .. } => {
                        ask.starts_with("mvpos") && !ask.ends_with("release")
                    }
                    Widget::Sliders { ask, .. } => ask.starts_with("mvpos EXEC"),
                    Widget::Joystick { .. } | Widget::Jog { .. } | Widget::Poses { .. } => true,
                    _ => false,
                };
                if !moves {
                    continue;
                }
                moving += 1;
                let (when, _) = widget.logic();
                let when = Expression::read(when.unwrap(), &panel.values).unwrap();
                let usable = |text: &str| {
                    let answer = sorma::Transport {
                        text: text.to_owned(),
                        floats: vec![0.0; 22],
                        ..sorma::Transport::default()
                    };
                    let known = panel.values.iter().filter_map(|value| {
                        let worth = value.of(&answer)?;
                        Some((value.name.clone(), worth))
                    });
                    when.worth(&known.collect()).map(|worth| worth.shown())
                };
                for (text, expected) in [
                    ("cold, held by nobody, motion None", "yes"),
                    ("active, held by objects, motion Done", "yes"),
                    ("motion, held by motion, motion Moving", "no"),
                    ("active, held by dispatcher, motion Done", "no"),
                    ("estopped, held by nobody, motion Failed", "no"),
                ] {
                    let found = usable(text);
                    assert_eq!(found.as_deref(), Some(expected), "{text}: {widget:?}");
                }
            }
            assert!(moving > 3, "{}", panel.title);
        }
    }

    #[test]
    fn everything_that_is_wrong_with_a_panel_is_said_with_its_place() {
        let widgets = [
            "kind = \"button\"\nlabel = \"b\"\nask = \"foo.a EXEC\"\nsop = true",
            "kind = \"knob\"",
            "kind = \"button\"\nlabel = \"b\"\nask = \"foo.a PLAY\"",
            "kind = \"joystick\"\nlabel = \"j\"\nask = \"foo.a EXEC FMSG 1 {x}\"\nspan = 1.0",
            "kind = \"plot\"\nlabel = \"p\"\nask = \"foo.a EXEC\"\nfloats = [0, 3]",
            "kind = \"readout\"\nlabel = \"r\"\nask = \"foo.a EXEC\"\nevery_s = 0.0",
            "kind = \"sliders\"\nlabel = \"s\"\nask = \"foo.a EXEC FMSG 1 {v}\"\nvalues = [{ name = \"v\", range = [2.0, 1.0] }]",
            "kind = \"button\"\nlabel = \"good\"\nask = \"foo.a EXEC\"",
            "kind = \"button\"\nlabel = \"b\"\nask = \"foo.a EXEC\"\nwhen = \"tea\"",
            "kind = \"button\"\nlabel = \"b\"\nask = \"foo.a EXEC\"\nwhen = \"te > 1\"",
            "kind = \"button\"\nlabel = \"b\"\nask = \"foo.a EXEC\"\nwhen = \"tea > 1\"\nstop = true",
            "kind = \"value\"\nlabel = \"v\"\nis = \"tea +\"",
            "kind = \"jog\"\nlabel = \"j\"\nask = \"foo.a EXEC FMSG {by}\"",
            "kind = \"jog\"\nlabel = \"j\"\nask = \"foo.a EXEC\"\nslots = \"slots EXEC\"",
            "kind = \"poses\"\nlabel = \"p\"\nask = \"foo.a EXEC home\"\nfrom = \"pino EXEC\"\njoints = 6",
            "kind = \"plot\"\nlabel = \"p\"\nask = \"foo.a EXEC\"\nfloats = [1, 3]\nless = [4, 7]",
            "kind = \"value\"\nlabel = \"good too\"\nis = \"tea * 2\"",
        ];
        let text = widgets.map(|widget| format!("[[widget]]\n{widget}\n"));
        let (panel, findings) = read(&format!(
            "title = \"t\"\n[[value]]\nname = \"tea\"\nask = \"bar EXEC\"\nfloat = 1\n[[value]]\nname = \"tea\"\n\
             ask = \"bar EXEC\"\nfloat = 2\n{}",
            text.concat()
        ));
        assert_eq!(panel.unwrap().widgets.len(), 2);
        for part in [
            "sop",
            "knob",
            "`foo.a PLAY` is no request",
            "no {y}",
            "counted from 1",
            "0.02 to 3600",
            "the second number must be the larger one",
            "`tea` is there already",
            "`when` is a condition",
            "did you mean `tea`?",
            "can always be pressed",
            "`tea +`",
            "the joints that `slots` tells of, or `axes`",
            "no {by}",
            "no {name}",
            "as many floats as",
        ] {
            let said = |finding: &String| finding.contains(part) && finding.contains("p.toml:");
            assert!(findings.iter().any(said), "{part}: {findings:?}");
        }
        assert_eq!(findings.len(), 16, "{findings:?}");
        let (panel, findings) = read("titel = \"t\"");
        assert!(
            panel.is_none() && findings.concat().contains("titel"),
            "{findings:?}"
        );
    }
}
