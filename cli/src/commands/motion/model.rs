//! What `ctos motion` shows: one look at the manipulators of an app, and its lines. Knows nothing of terminals.

use std::time::Duration;

use cli_common::{
    client::{Client, ClientError},
    remote,
    table::fitted,
};
use ctos::{control::protocol::ErrorCode, diagnostic::Finding};
use mcs::client::{JointReport, ReadSlots, SlotsReport, Status, StatusReport};
use serde::Serialize;

/// A manipulator answers at once, or something keeps its tasks.
const DEADLINE: Duration = Duration::from_secs(2);
/// A joint this near to a limit, as part of its range, stands out.
const NEAR: f64 = 0.05;
/// How wide the range of a joint is drawn, and its torque.
const RANGE: usize = 11;
const LOAD: usize = 4;
/// The longest name of a joint that is not cut.
const NAME: usize = 17;

/// One look.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Sample {
    app: String,
    /// How long ago it was started, s.
    up_s: f64,
    /// Its manipulators, or those that were named.
    manipulators: Vec<Manipulator>,
    /// All that there are.
    #[serde(skip)]
    known: Vec<String>,
}

/// A manipulator.
#[derive(Debug, Clone, PartialEq, Serialize)]
struct Manipulator {
    name: String,
    #[serde(flatten)]
    answer: Answer,
}

/// What it tells, or why it does not.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[serde(untagged)]
enum Answer {
    Seen(Seen),
    None { no_answer: String },
}

/// How a manipulator is.
#[derive(Debug, Clone, PartialEq, Serialize)]
struct Seen {
    state: String,
    owner: Option<String>,
    motion: String,
    /// Whether a protective stop holds.
    stopped: bool,
    last_stop: Option<String>,
    ticks: u64,
    missed: u64,
    joints: Vec<Joint>,
    sensors: Vec<Sensor>,
}

/// A joint: rad and N m, or m and N of one that slides.
#[derive(Debug, Clone, PartialEq, Serialize)]
struct Joint {
    name: String,
    unit: &'static str,
    position: f64,
    /// Its smallest and its largest position; null where it has none.
    range: [f64; 2],
    /// Setpoint less position.
    error: f64,
    torque: f64,
    most_torque: f64,
    torque_unit: &'static str,
}

#[derive(Debug, Clone, PartialEq, Serialize)]
struct Sensor {
    name: String,
    unit: &'static str,
    numbers: Vec<f64>,
    /// Whether they are too old to go by.
    stale: bool,
}

/// A line, and how it stands out.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Line {
    pub text: String,
    pub kind: Kind,
}

/// How a line stands out.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    Title,
    Plain,
    /// Something is wrong, or nearly.
    Wrong,
}

impl Sample {
    /// Asks an app how its manipulators are, or those with these names.
    ///
    /// # Errors
    /// The app cannot be reached, or does not let these be asked.
    pub fn look(client: &mut Client, names: &[String]) -> Result<Self, ClientError> {
        let view = remote::view(client)?;
        let tasks = view.tasks.iter();
        let tasks = tasks.filter(|task| task.handler == mcs::CLIENT);
        let known: Vec<String> = tasks.map(|task| task.name.clone()).collect();
        let mut manipulators = Vec::new();
        for name in known
            .iter()
            .filter(|name| names.is_empty() || names.contains(name))
        {
            let asked = client.call(name, Status {}, DEADLINE);
            let asked =
                asked.and_then(|status| Ok((status, client.call(name, ReadSlots {}, DEADLINE)?)));
            let answer = match asked {
                Ok((status, slots)) => Answer::Seen(Seen::new(&status, slots)),
                // It may be one of several, and the others answer.
                Err(ClientError::Refused(refused)) if is_of_task(refused.code) => Answer::None {
                    no_answer: refused.message,
                },
                Err(error) => return Err(error),
            };
            manipulators.push(Manipulator {
                name: name.clone(),
                answer,
            });
        }
        Ok(Self {
            app: view.app,
            up_s: view.up_s,
            manipulators,
            known,
        })
    }

    /// What there is not, of what was asked for.
    pub fn lacks(&self, names: &[String]) -> Option<String> {
        if self.known.is_empty() {
            return Some(format!(
                "app `{}` has no manipulator: no task has the handler `{}`",
                self.app,
                mcs::CLIENT
            ));
        }
        let missing = names.iter().find(|name| !self.known.contains(name))?;
        let near =
            Finding::error("cli", "").suggest(missing, self.known.iter().map(String::as_str));
        let near = near
            .help
            .map_or_else(String::new, |help| format!("; {help}"));
        Some(format!(
            "app `{}` has no manipulator `{missing}`; there are: {}{near}",
            self.app,
            self.known.join(", ")
        ))
    }

    /// What a person reads, no line wider than `width`.
    pub fn lines(&self, width: usize) -> Vec<Line> {
        let title = format!("{} · up {}", self.app, remote::span(self.up_s));
        let mut lines = vec![Line::new(Kind::Plain, &title, width)];
        for Manipulator { name, answer } in &self.manipulators {
            lines.push(Line::new(Kind::Plain, "", width));
            match answer {
                Answer::Seen(seen) => seen.lines(name, width, &mut lines),
                Answer::None { no_answer } => {
                    lines.push(Line::new(Kind::Title, name, width));
                    let text = format!("  no answer: {no_answer}");
                    lines.push(Line::new(Kind::Wrong, &text, width));
                }
            }
        }
        lines
    }
}

/// Whether one task said no, not the app.
fn is_of_task(code: ErrorCode) -> bool {
    matches!(
        code,
        ErrorCode::Failed | ErrorCode::TimedOut | ErrorCode::Busy
    )
}

impl Line {
    fn new(kind: Kind, text: &str, width: usize) -> Self {
        Self {
            text: fitted(text, width),
            kind,
        }
    }
}

impl Seen {
    fn new(status: &StatusReport, slots: SlotsReport) -> Self {
        let mut numbers = slots.sensors.numbers.into_iter();
        let stale = slots.sensors.stale;
        let sensors = slots.sensors.sensors.into_iter().map(|sensor| Sensor {
            stale: stale.contains(&sensor.name),
            name: sensor.name,
            unit: sensor.kind.unit(),
            numbers: numbers.by_ref().take(sensor.kind.width()).collect(),
        });
        Self {
            state: status.state.to_string(),
            owner: status.holder.clone(),
            motion: format!("{:?}", status.motion).to_lowercase(),
            stopped: status.stopped,
            last_stop: slots.last_stop,
            ticks: status.ticks,
            missed: status.missed,
            joints: slots.joints.into_iter().map(Joint::new).collect(),
            sensors: sensors.collect(),
        }
    }

    fn lines(&self, name: &str, width: usize, lines: &mut Vec<Line>) {
        let owner = self.owner.as_deref().unwrap_or("nobody");
        let title = format!(
            "{name} · {} · held by {owner} · motion: {} · {} ticks, {} missed",
            self.state, self.motion, self.ticks, self.missed
        );
        lines.push(Line::new(Kind::Title, &title, width));
        if self.stopped {
            let text = "  stopped until `pino EXEC resume`";
            lines.push(Line::new(Kind::Wrong, text, width));
        }
        if let Some(why) = &self.last_stop {
            let is_now = self.stopped || self.state == "estopped";
            let kind = if is_now { Kind::Wrong } else { Kind::Plain };
            lines.push(Line::new(kind, &format!("  last stop: {why}"), width));
        }
        let longest = self.joints.iter().map(|joint| joint.name.chars().count());
        let longest = longest.max().unwrap_or_default().min(NAME);
        let joints = self.joints.iter().map(|joint| joint.line(longest, width));
        lines.extend(joints);
        for sensor in &self.sensors {
            let numbers = sensor.numbers.iter().map(|number| format!("{number:.2}"));
            let numbers: Vec<String> = numbers.collect();
            let mut text = format!("  {}: {} {}", sensor.name, numbers.join("  "), sensor.unit);
            if sensor.stale {
                text.push_str(" (stale)");
            }
            lines.push(Line::new(Kind::Plain, text.trim_end(), width));
        }
    }
}

impl Joint {
    fn new(joint: JointReport) -> Self {
        Self {
            unit: joint.kind.unit(),
            torque_unit: joint.kind.effort_unit(),
            position: joint.position,
            range: joint.range,
            error: joint.setpoint - joint.position,
            torque: joint.torque,
            most_torque: joint.most_torque,
            name: joint.name,
        }
    }

    /// Where it is in its range, 0 to 1; `None` where that has no end.
    fn part(&self) -> Option<f64> {
        let [low, high] = self.range;
        let part = (self.position - low) / (high - low);
        part.is_finite().then(|| part.clamp(0.0, 1.0))
    }

    fn line(&self, longest: usize, width: usize) -> Line {
        let part = self.part();
        let near = part.is_some_and(|part| !(NEAR..=1.0 - NEAR).contains(&part));
        let load = (self.torque / self.most_torque).abs();
        let load = if load.is_finite() { load.min(1.0) } else { 0.0 };
        let text = format!(
            "  {:<longest$}  {:>8.4} {:<3}  {}  {:>7.3} m{:<3}  {:>8.2} {:<3}  {}",
            fitted(&self.name, longest),
            self.position,
            self.unit,
            drawn_range(part),
            self.error * 1e3,
            self.unit,
            self.torque,
            self.torque_unit,
            drawn_load(load),
        );
        let kind = if near || load > 1.0 - NEAR {
            Kind::Wrong
        } else {
            Kind::Plain
        };
        Line::new(kind, text.trim_end(), width)
    }
}

/// A range with a mark in it: `!` near a limit, so that it is seen without colours.
fn drawn_range(part: Option<f64>) -> String {
    let Some(part) = part else {
        return format!("{:^RANGE$}", "no limits");
    };
    // Within the range, so it fits.
    let at = (part * (RANGE - 1) as f64).round() as usize;
    let mark = if (NEAR..=1.0 - NEAR).contains(&part) {
        '●'
    } else {
        '!'
    };
    let letter = |index: usize| match index {
        index if index == at => mark,
        0 => '├',
        last if last == RANGE - 1 => '┤',
        _ => '─',
    };
    (0..RANGE).map(letter).collect()
}

/// A part, 0 to 1, as a bar.
fn drawn_load(part: f64) -> String {
    let full = (part * LOAD as f64).round() as usize;
    let letter = |index: usize| if index < full { '█' } else { '░' };
    (0..LOAD).map(letter).collect()
}

#[cfg(test)]
pub mod tests {
    use mcs::client::{Sensor as Slot, SensorKind, SensorReport};
    use mcs::{model::JointKind, servo::MotionPhase, state::State};

    use super::*;

    fn joint(name: &str, kind: JointKind, position: f64, range: [f64; 2]) -> JointReport {
        JointReport {
            name: name.to_owned(),
            kind,
            position,
            velocity: 0.0,
            setpoint: position + 0.001,
            torque: -25.0,
            range,
            most_torque: 100.0,
        }
    }

    /// An arm of two joints that was stopped, and one that does not answer.
    pub fn sample() -> Sample {
        let status = StatusReport {
            state: State::Motion,
            holder: Some("objects".to_owned()),
            fault: None,
            stopped: true,
            motion: MotionPhase::Stopped,
            ticks: 1234,
            missed: 1,
        };
        let slots = SlotsReport {
            joints: vec![
                joint("waist", JointKind::Revolute, 0.0, [-2.0, 2.0]),
                joint("track", JointKind::Prismatic, 0.99, [0.0, 1.0]),
                joint(
                    "flange",
                    JointKind::Revolute,
                    7.0,
                    [f64::NEG_INFINITY, f64::INFINITY],
                ),
            ],
            sensors: SensorReport {
                sensors: vec![Slot {
                    name: "wrist".to_owned(),
                    kind: SensorKind::ForceTorque,
                }],
                numbers: vec![1.0, 2.0, -3.5, 0.0, 0.0, 0.1],
                stale: Vec::new(),
            },
            last_stop: Some("a protective stop was asked for".to_owned()),
        };
        let silent = Answer::None {
            no_answer: "it is busy".to_owned(),
        };
        let answers = [Answer::Seen(Seen::new(&status, slots)), silent];
        let manipulators = ["left", "right"].into_iter().zip(answers);
        let manipulators = manipulators.map(|(name, answer)| Manipulator {
            name: name.to_owned(),
            answer,
        });
        Sample {
            app: "testbed".to_owned(),
            up_s: 12.0,
            manipulators: manipulators.collect(),
            known: vec!["left".to_owned(), "right".to_owned()],
        }
    }

    #[test]
    fn every_manipulator_is_told_with_its_joints_between_their_limits_and_its_last_stop() {
        let lines = sample().lines(100);
        let texts: Vec<&str> = lines.iter().map(|line| line.text.as_str()).collect();
        assert_eq!(
            texts,
            [
                "testbed · up 12 s",
                "",
                "left · motion · held by objects · motion: stopped · 1234 ticks, 1 missed",
                "  stopped until `pino EXEC resume`",
                "  last stop: a protective stop was asked for",
                "  waist     0.0000 rad  ├────●────┤    1.000 mrad    -25.00 N m  █░░░",
                "  track     0.9900 m    ├─────────!    1.000 mm      -25.00 N    █░░░",
                "  flange    7.0000 rad   no limits     1.000 mrad    -25.00 N m  █░░░",
                "  wrist: 1.00  2.00  -3.50  0.00  0.00  0.10 N, N m",
                "",
                "right",
                "  no answer: it is busy",
            ]
        );
        let wrong = lines.iter().filter(|line| line.kind == Kind::Wrong);
        assert_eq!(wrong.count(), 4);
        for width in [0, 1, 20, 60] {
            let lines = sample().lines(width);
            assert!(
                lines
                    .iter()
                    .all(|line| line.text.chars().count() <= width.max(1))
            );
        }
    }

    #[test]
    fn a_look_is_one_json_object_in_which_what_is_unlimited_is_null() {
        let text = serde_json::to_string(&sample()).unwrap();
        assert!(!text.contains('\n'));
        let told: serde_json::Value = serde_json::from_str(&text).unwrap();
        let left = &told["manipulators"][0];
        assert_eq!(
            (&left["name"], &left["owner"]),
            (&"left".into(), &"objects".into())
        );
        assert_eq!(left["state"], "motion");
        assert_eq!(left["joints"][1]["unit"], "m");
        assert!(left["joints"][2]["range"][0].is_null());
        assert_eq!(told["manipulators"][1]["no_answer"], "it is busy");
    }

    #[test]
    fn a_name_that_is_not_there_is_told_with_those_that_are() {
        let sample = sample();
        assert_eq!(sample.lacks(&["left".to_owned()]), None);
        let text = sample.lacks(&["lift".to_owned()]).unwrap();
        assert!(text.contains("there are: left, right"), "{text}");
        assert!(text.contains("did you mean `left`?"), "{text}");
        let none = Sample {
            known: Vec::new(),
            ..sample
        };
        assert!(
            none.lacks(&[])
                .unwrap()
                .contains("no task has the handler `mcs.client`")
        );
    }
}
