//! The arguments of the Push Coordinator, and what is wrong with them.

use ctos::{
    config::{App, TaskConfig},
    diagnostic::{Finding, Findings},
    task::Context,
};
use serde::Deserialize;

use crate::{
    arm::{Arm, ArmKeys},
    motion::{mcs_task, resume_within_s},
};

/// Arguments.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct ArmArgs {
    /// The client interface of MCS.
    #[serde(default = "mcs_task")]
    pub mcs: String,
    /// The data object manager.
    #[serde(default = "crate::dom_task")]
    pub dom: String,
    /// Fraction of full speed to and fro.
    #[serde(default = "speed")]
    pub speed: f64,
    /// The same while it feels for the thing, and while it pushes.
    #[serde(default = "gentle")]
    pub gentle: f64,
    /// The same of the acceleration in a push.
    #[serde(default = "softly")]
    pub softly: f64,
    /// Height of what pushes, m.
    pub height_m: f64,
    /// What pushes, in the tool's frame, m: the tool itself when it is left out.
    #[serde(default)]
    pub tip_m: [f64; 3],
    /// The hand whose fingers are shaped before; none when it is left out.
    pub hand: Option<HandArgs>,
    /// How far above that it goes to and fro, m.
    #[serde(default = "clearance_m")]
    pub clearance_m: f64,
    /// How the tool may be turned about the vertical from the direction of the push, degrees: the first turn with which the
    /// arm reaches all of the way is taken.
    #[serde(default = "turns_deg")]
    pub turns_deg: Vec<f64>,
    /// The recipe of the guard that ends an approach at a touch.
    #[serde(default = "touch")]
    pub touch: String,
    /// The recipe of the guard that ends a push which meets too much force.
    #[serde(default = "blocked")]
    pub blocked: String,
    /// The recipe of the guard that ends a push whose contact is lost.
    #[serde(default = "contact")]
    pub contact: String,
    /// The control law in a push, and otherwise.
    #[serde(default = "compliant")]
    pub compliant: String,
    /// See above.
    #[serde(default = "stiff")]
    pub stiff: String,
    /// What is pushed is too light to be felt: it is not felt for, a stiff arm pushes, and only the guard `blocked` ends that early.
    #[serde(default)]
    pub light: bool,
    /// A compliant arm lags behind: a push is done when it ends so near to its end, m.
    #[serde(default = "within_m")]
    pub within_m: f64,
    /// How often a contact that was lost is felt for again.
    #[serde(default = "again")]
    pub again: u32,
    /// How far it backs off a thing before it goes up, m.
    #[serde(default = "back_m")]
    pub back_m: f64,
    /// Where the arm waits, degrees of its joints.
    pub park_deg: Vec<f64>,
    /// How long a protective stop is waited out before the request fails, s.
    #[serde(default = "resume_within_s")]
    pub resume_within_s: f64,
    /// How long an MCS that is gone, and may be started again, is waited for, s.
    #[serde(default = "crate::service_within_s")]
    pub service_within_s: f64,
}

/// A hand with fingers.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct HandArgs {
    /// Its task.
    pub task: String,
    /// Its joints while it pushes, degrees: one finger straight, the others out of the way.
    pub posture_deg: Vec<f64>,
    /// Fraction of full speed of the fingers.
    #[serde(default = "speed")]
    pub speed: f64,
}

fn speed() -> f64 {
    0.5
}

fn gentle() -> f64 {
    0.08
}

fn softly() -> f64 {
    0.2
}

fn clearance_m() -> f64 {
    0.1
}

fn turns_deg() -> Vec<f64> {
    vec![0.0, 180.0]
}

fn touch() -> String {
    "touch".to_owned()
}

fn blocked() -> String {
    "blocked".to_owned()
}

fn contact() -> String {
    "contact".to_owned()
}

fn compliant() -> String {
    "cartesian_impedance".to_owned()
}

fn stiff() -> String {
    "pid".to_owned()
}

fn within_m() -> f64 {
    0.01
}

fn again() -> u32 {
    2
}

fn back_m() -> f64 {
    0.02
}

impl ArmArgs {
    pub fn arm<'a>(&'a self, cx: &'a Context) -> Arm<'a> {
        Arm {
            cx,
            mcs: &self.mcs,
            within_s: self.service_within_s,
        }
    }

    /// Findings where they make no sense.
    pub fn check(&self, task: &TaskConfig, app: &App, findings: &mut Findings) {
        let keys = ArmKeys {
            mcs: &self.mcs,
            resume_within_s: self.resume_within_s,
            service_within_s: self.service_within_s,
            speeds: &[
                ("speed", self.speed),
                ("gentle", self.gentle),
                ("softly", self.softly),
            ],
            park_deg: Some(&self.park_deg),
        };
        keys.check(task, app, "coordinators::push::range", findings);
        if let Some(hand) = &self.hand {
            crate::need_task(task, app, "hand.task", &hand.task, findings);
            crate::check_speed(task, "hand.speed", hand.speed, findings);
        }
        let mut wrong = |key: &str, text: String| {
            let place = task.args.locate(key).unwrap_or_else(|| task.place.clone());
            findings.push(Finding::error("coordinators::push::range", text).at(place));
        };
        for (key, value, most) in [
            ("clearance_m", self.clearance_m, 2.0),
            ("back_m", self.back_m, 0.5),
            ("within_m", self.within_m, 0.2),
        ] {
            if !(0.0..=most).contains(&value) {
                wrong(key, format!("`{key}` is {value}; give from 0 to {most} m"));
            }
        }
        if !(-5.0..=5.0).contains(&self.height_m) {
            let text = format!("`height_m` is {}; give from -5 to 5 m", self.height_m);
            wrong("height_m", text);
        }
        if self.tip_m.iter().any(|part| !(-1.0..=1.0).contains(part)) {
            let text = format!("`tip_m` is {:?}; give from -1 to 1 m", self.tip_m);
            wrong("tip_m", text);
        }
        if self.turns_deg.is_empty() {
            wrong(
                "turns_deg",
                "`turns_deg` needs at least one turn".to_owned(),
            );
        }
    }
}
