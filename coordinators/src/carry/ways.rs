//! The ways that the Robot Coordinator knows of going above an end of an errand, of looking at the thing from there, and of grasping.

use serde::{Deserialize, Serialize};

use super::thing::Thing;
use crate::strategy::step::Way;

/// A way of going above an end of the errand.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum Going {
    /// Joints interpolated.
    Joint,
    /// The tool along a straight line.
    Line,
    /// The tool up, across and down.
    Arch,
    /// Around everything, as the planner finds it.
    Planned,
}

impl Way for Going {
    fn name(self) -> String {
        let name = match self {
            Self::Joint => "joint",
            Self::Line => "line",
            Self::Arch => "arch",
            Self::Planned => "planned",
        };
        name.to_owned()
    }
}

/// From where the camera on the hand looks at the thing.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub(super) enum Spot {
    /// From right above it.
    Above,
    /// From beside that, over the corner of that number of the square in which it has learned.
    Beside(u8),
}

impl Spot {
    /// All of them with what each is assumed to cost, s.
    pub(super) const COSTS: [(Doing, f64); 3] = [
        (Doing::Look(Self::Above), 1.0),
        (Doing::Look(Self::Beside(0)), 2.0),
        (Doing::Look(Self::Beside(1)), 2.0),
    ];

    /// Where that is from above the thing, in halves of the square's side along the tool's x and y axes.
    pub(super) fn offset(self) -> [f64; 2] {
        match self {
            Self::Above => [0.0; 2],
            Self::Beside(0) => [1.0, 1.0],
            Self::Beside(_) => [-1.0, -1.0],
        }
    }
}

/// What a Robot Coordinator does in one of several ways.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub(super) enum Doing {
    /// Goes above an end.
    Go(Going),
    /// Looks at the thing.
    Look(Spot),
}

impl Way for Doing {
    fn name(self) -> String {
        match self {
            Self::Go(way) => way.name(),
            Self::Look(Spot::Above) => "above".to_owned(),
            Self::Look(Spot::Beside(corner)) => format!("beside {}", u32::from(corner) + 1),
        }
    }
}

/// A way that is known, and what it is assumed to cost before it has been gone.
#[derive(Debug, Clone, Copy, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct WayArgs {
    pub way: Going,
    pub cost_s: f64,
}

/// The ways of both steps.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub(super) struct WaysArgs {
    /// To above the thing.
    pub approach: Vec<WayArgs>,
    /// To above the target, with the thing.
    pub transfer: Vec<WayArgs>,
}

impl Default for WaysArgs {
    fn default() -> Self {
        let ways = |ways: [(Going, f64); 3]| ways.map(|(way, cost_s)| WayArgs { way, cost_s });
        let (joint, line, arch) = (Going::Joint, Going::Line, Going::Arch);
        Self {
            approach: ways([(joint, 2.0), (line, 4.0), (arch, 6.0)]).into(),
            transfer: ways([(arch, 2.0), (line, 4.0), (joint, 6.0)]).into(),
        }
    }
}

impl WaysArgs {
    /// What is wrong with them: a key, and words.
    pub(super) fn check(&self) -> Result<(), (String, String)> {
        for (step, ways) in [("approach", &self.approach), ("transfer", &self.transfer)] {
            let mut known: Vec<Going> = ways.iter().map(|way| way.way).collect();
            known.sort_unstable();
            known.dedup();
            if known.len() != ways.len() || known.is_empty() {
                let text = format!("`ways.{step}` names each way at most once, and at least one");
                return Err((format!("ways.{step}"), text));
            }
            for (number, way) in ways.iter().enumerate() {
                if !(1e-3..=3600.0).contains(&way.cost_s) {
                    let (name, cost) = (way.way.name(), way.cost_s);
                    let text = format!("`cost_s` of `{name}` is {cost}; give from 0.001 to 3600 s");
                    return Err((format!("ways.{step}.{number}.cost_s"), text));
                }
            }
        }
        Ok(())
    }

    /// Whether a planner is needed.
    pub(super) fn are_planned(&self) -> bool {
        let mut all = self.approach.iter().chain(&self.transfer);
        all.any(|way| way.way == Going::Planned)
    }
}

/// Ways with what each is assumed to cost.
pub(super) fn costs(ways: &[WayArgs]) -> Vec<(Doing, f64)> {
    let ways = ways.iter();
    ways.map(|way| (Doing::Go(way.way), way.cost_s)).collect()
}

/// A grasp: the gripper turned about the vertical by so many tenths of a degree.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub(super) struct Turn(i32);

impl Turn {
    /// The turn, rad.
    pub(super) fn radians(self) -> f64 {
        (f64::from(self.0) / 10.0).to_radians()
    }
}

impl Way for Turn {
    fn name(self) -> String {
        format!("turned by {} degrees", f64::from(self.0) / 10.0)
    }
}

/// The grasps of a thing with what each is assumed to cost, s: the first least, where nothing else is known.
pub(super) fn turns(thing: &Thing) -> Vec<(Turn, f64)> {
    let turns = thing.grasp.turns_deg.iter().enumerate();
    let turns = turns.map(|(number, turn)| {
        (
            Turn((turn * 10.0).round() as i32),
            2.0 + 2.0 * number as f64,
        )
    });
    turns.collect()
}
