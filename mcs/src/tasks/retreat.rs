//! The reaction of a guard that has the arm go back to where all was still well.

use std::time::Duration;

use ctos::task::{Context, HandlerError};

use super::Link;
use crate::guard::{GuardReport, GuardSet};
use crate::servo::{MotionPhase, ServoCommand, ServoStatus};
use crate::trajectory::{Goal, Pace, PathKind, Route};

/// Fraction of full speed.
const SPEED: f64 = 0.1;

/// Goes back from where motion `id` came to rest, all joints in proportion, and returns when the arm has settled. Guards
/// that always watch do so on this way too.
///
/// # Errors
/// Why it is not where it should be.
pub(super) async fn back(
    cx: &Context,
    link: &Link,
    id: u64,
    report: &GuardReport,
) -> Result<(), HandlerError> {
    let mut planner = link.planner.clone();
    let route = Route {
        goal: Goal::Joints(report.allowed),
        path: PathKind::Joint,
        pace: Pace::new(SPEED, None),
        elbow: None,
    };
    let (segment, _) = planner.segment(&link.port.status().setpoint, &route)?;
    let id = id + 1;
    let patience = Duration::from_secs_f64(segment.duration()) + link.rest_patience();
    let guards = GuardSet::default();
    link.port.order(ServoCommand::Name { guards })?;
    link.port.order(ServoCommand::Move { id, segment })?;
    let over = move |status: &ServoStatus| {
        status.fault.is_some()
            || status.rejected.is_some_and(|(rejected, _)| rejected == id)
            || (status.motion.id == id && status.motion.phase.is_over())
    };
    let status = link.wait(cx, "go back", patience, over).await?;
    if let Some(fault) = status.fault {
        return Err(fault.into());
    }
    match status.rejected {
        Some((rejected, reason)) if rejected == id => Err(reason.into()),
        _ if status.motion.phase == MotionPhase::Done => Ok(()),
        _ => Err("something stopped it on the way".into()),
    }
}
