//! Takes the hand from place to place, until that is stopped: what learning a map and grasping a ball have in common.

use std::time::Duration;

use ctos::task::HandlerError;
use mcs::client::{Manipulator, Move, PathKind, Target};
use nalgebra::Isometry3;

/// How long a motion of the arm may take.
const LONGEST: Duration = Duration::from_secs(60);

/// An arm that is held.
pub(crate) struct Mover<'a> {
    pub arm: &'a Manipulator,
    /// Whether it was stopped.
    pub is_over: &'a dyn Fn() -> bool,
    pub path: PathKind,
    /// Fraction of full speed.
    pub speed: f64,
}

impl Mover<'_> {
    /// Takes the tool to `base_t_tool`.
    ///
    /// # Errors
    /// It was stopped, or the arm does not get there.
    pub async fn move_to(&self, base_t_tool: &Isometry3<f64>) -> Result<(), HandlerError> {
        self.go_on()?;
        let mut rows = [0.0; 16];
        rows.copy_from_slice(base_t_tool.to_homogeneous().transpose().as_slice());
        let request = Move {
            target: Target::Pose(rows),
            path: self.path,
            speed: self.speed,
            acceleration: None,
            elbow: None,
            guards: Vec::new(),
            blend: 0.0.into(),
        };
        self.arm.go(request, LONGEST).await?;
        Ok(())
    }

    /// # Errors
    /// It was stopped.
    pub fn go_on(&self) -> Result<(), HandlerError> {
        match (self.is_over)() {
            true => Err("it was stopped".into()),
            false => Ok(()),
        }
    }
}
