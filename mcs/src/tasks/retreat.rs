//! The reaction of a guard that has the arm go back to where all was still well.

use std::time::Duration;

use ctos::task::{Context, HandlerError};

use super::Link;
use crate::guard::{GuardReport, GuardSet};
use crate::servo::{MotionPhase, ServoCommand, ServoStatus};
use crate::trajectory::{Goal, Pace, PathKind, Route};

/// Fraction of full speed.
const SPEED: f64 = 0.1;

/// Goes back from where the arm came to rest, joint-interpolated, and returns when the arm has settled. Guards
/// that always watch do so on this way too.
///
/// # Errors
/// Why it is not where it should be.
pub(super) async fn back(
    cx: &Context,
    link: &Link,
    report: &GuardReport,
) -> Result<(), HandlerError> {
    let mut planner = link.planner.clone();
    let route = Route {
        goal: Goal::Joints(report.allowed),
        path: PathKind::Joint,
        pace: Pace::new(SPEED, None),
        elbow: None,
    };
    let status = link.port.status();
    let (segment, _) = planner.segment(&status.setpoint, &route)?;
    // All that was ordered has ended: what a guard ends takes what waited behind it along.
    let id = status.ended.newest().max(status.motion.id) + 1;
    let patience = Duration::from_secs_f64(segment.duration()) + link.rest_patience();
    let guards = GuardSet::default();
    link.port.order(ServoCommand::Name { guards })?;
    link.port.order(ServoCommand::Move { id, segment })?;
    let over = move |status: &ServoStatus| status.fault.is_some() || status.ended.of(id).is_some();
    let status = link.wait(cx, "go back", patience, over).await?;
    if let Some(fault) = status.fault {
        return Err(fault.into());
    }
    match status.ended.of(id).map(|motion| motion.phase) {
        Some(MotionPhase::Done) => Ok(()),
        Some(MotionPhase::Rejected(reason)) => Err(reason.into()),
        _ => Err("something stopped it on the way".into()),
    }
}
