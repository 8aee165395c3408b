//! Leads the arm along a way that was planned: straight in its joints from point to point, past each without a stop where the
//! way leaves room for it.

use futures_util::{StreamExt as _, TryStreamExt as _, stream};
use mcs::{
    Joints,
    client::{Blend, Move, PathKind, Target},
};
use mcs_path::Way;

use crate::{
    arm::{self, Arm},
    outcome::Failure,
};

/// So many motions are under way and wait at a time: fewer than a servo takes.
const AHEAD: usize = 5;

/// How a way is gone.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Pace<'a> {
    /// Fraction of full speed.
    pub speed: f64,
    /// Whether points are passed without a stop.
    pub blends: bool,
    /// Recipes of guards that watch besides those that always do.
    pub guards: &'a [String],
}

/// Straight in the joints to a point.
pub(crate) fn straight() -> PathKind {
    PathKind::Named {
        // It is short enough: a test of the nets goes by it.
        name: "direct".parse().unwrap_or_default(),
        numbers: Joints::default(),
    }
}

/// Goes along a way from its start. The first motion that ends otherwise than it should ends it.
pub(crate) async fn along(arm: &Arm<'_>, way: &Way, pace: Pace<'_>) -> Result<(), Failure> {
    let points = way.points.iter().zip(&way.leeway);
    // Of a motion that waits, the time counts from when it is ordered.
    let longest_s = way.full_speed_s / pace.speed;
    let orders = points.skip(1).scan(0.0, |before, (point, leeway)| {
        let blend = std::mem::replace(before, *leeway);
        Some(Move {
            blend: match pace.blends {
                true => Blend::Joints(blend),
                false => Blend::default(),
            },
            guards: pace.guards.to_vec(),
            ..arm::order(Target::Joints(*point), straight(), pace.speed)
        })
    });
    let moves = orders.map(|order| arm.go(order, longest_s));
    let ended = stream::iter(moves).buffered(AHEAD);
    let gone = ended.try_for_each(|_| async { Ok(()) }).await;
    if gone.is_err() {
        // One that was ordered already would go on from elsewhere.
        if let Err(failure) = arm.end().await {
            tracing::warn!(%failure, "what was ordered could not be taken back");
        }
    }
    gone
}

/// Where the arm is, joint by joint.
pub(crate) async fn here(arm: &Arm<'_>) -> Result<Joints, Failure> {
    let position = arm.ask(|arm| async move { arm.position().await }).await?;
    Ok(position.joints)
}
