//! The guard `speed`: how quickly the tool and the joints may move, as commanded and as read back.

use ctos::task::HandlerError;
use serde::Deserialize;

use super::{Guard, GuardSettings, Seen, Words};

/// Largest speeds. What is not given is not watched.
#[derive(Debug, Clone, PartialEq, Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Speed {
    /// Of the tool's origin, m/s.
    pub tool: Option<f64>,
    /// Of the tool's turning, rad/s.
    pub turning: Option<f64>,
    /// Of each joint in the model's order, rad/s or m/s.
    pub joints: Vec<f64>,
}

impl Speed {
    /// The speeds that the recipe's arguments give.
    ///
    /// # Errors
    /// A number that is no limit, a wrong count of joints, or no limit at all.
    pub fn from_args(settings: &GuardSettings<'_>) -> Result<Box<dyn Guard>, HandlerError> {
        let speed: Self = settings.args.parse()?;
        let all = speed.tool.iter().chain(&speed.turning).chain(&speed.joints);
        let mut all = all.copied().peekable();
        if all.peek().is_none() {
            return Err("it limits nothing: give `tool`, `turning` or `joints`".into());
        }
        if let Some(wrong) = all.find(|limit| !(limit.is_finite() && *limit > 0.0)) {
            return Err(format!("a largest speed is above zero, not {wrong}").into());
        }
        let (given, needed) = (speed.joints.len(), settings.model.dof());
        if given != 0 && given != needed {
            return Err(
                format!("`joints` has {given} numbers, the arm has {needed} joints").into(),
            );
        }
        Ok(Box::new(speed))
    }
}

impl Guard for Speed {
    fn check(&mut self, seen: &Seen<'_>) -> Option<Words> {
        let commanded = |index: usize| seen.setpoint.velocity[index];
        let read = |index: usize| seen.readings[index].velocity;
        for (index, limit) in self.joints.iter().enumerate() {
            let speed = commanded(index).abs().max(read(index).abs());
            if speed > *limit {
                let unit = seen.model.joints()[index].kind.unit();
                let joint = index + 1;
                return Some(crate::words!(
                    "joint {joint} moves at {speed:.3} {unit}/s, the limit is {limit:.3} {unit}/s"
                ));
            }
        }
        if self.tool.is_none() && self.turning.is_none() {
            return None;
        }
        let (one, other) = (seen.tool_velocity(commanded), seen.tool_velocity(read));
        let moves = one.0.norm().max(other.0.norm());
        let turns = one.1.norm().max(other.1.norm());
        let beyond = |speed: f64, limit: Option<f64>| limit.filter(|limit| speed > *limit);
        if let Some(limit) = beyond(moves, self.tool) {
            return Some(crate::words!(
                "the tool moves at {moves:.3} m/s, the limit is {limit:.3} m/s"
            ));
        }
        let limit = beyond(turns, self.turning)?;
        Some(crate::words!(
            "the tool turns at {turns:.3} rad/s, the limit is {limit:.3} rad/s"
        ))
    }
}
