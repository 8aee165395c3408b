//! What the arm looks at before it begins: all ways of a carry from where it stands, one after another, by the task that knows what the
//! collision watch knows. A way that would lead too near to something is refused, with what that is, and another turn or path is tried.

use coordinators::{
    arm::{self, Arm},
    outcome::{Failure, Outcome},
};
use ctos::task::Context;
use mcs::{
    Joints,
    client::{PathKind, Plan, Target},
};
use mcs_path::{
    Refused,
    task::{LookAhead, Unplanned},
};
use nalgebra::{Isometry3, Matrix4, UnitQuaternion, Vector3};

use super::{ArmArgs, Stand, TRAVEL_M, at_height, forbids};

/// Farther round than this the arm swings first, rad. The nearest joints may be those of an arm that reaches over its shoulder:
/// what it carries would be turned upside down on the way.
const SWING: f64 = 2.0;

/// Where the arm is, or is thought to be.
#[derive(Debug, Clone, Copy)]
pub struct At {
    joints: Joints,
    /// `base_t_tool`.
    tool: Isometry3<f64>,
}

impl At {
    /// Where it stands.
    pub async fn now(arm: &Arm<'_>) -> Result<Self, Failure> {
        let position = arm.ask(|arm| async move { arm.position().await }).await?;
        let matrix = Matrix4::from_row_slice(&position.base_t_commanded);
        let tool = nalgebra::try_convert(matrix)
            .ok_or_else(|| Failure::new(Outcome::Fault, "the arm's pose is none"))?;
        Ok(Self {
            joints: position.commanded,
            tool,
        })
    }
}

/// A failure at the first end of a carry.
pub fn here(failure: Failure) -> (Failure, u8) {
    (failure, 0)
}

/// A way down to a place, from the height at which the arm goes to and fro.
#[derive(Debug, Clone, Copy)]
pub struct Way {
    /// The index of its turn.
    pub turn: usize,
    /// Its end.
    pub down: Isometry3<f64>,
    /// How the arm gets above that.
    pub path: PathKind,
    /// The place.
    stand: Stand,
}

/// What the arm is to do when it is down at a place.
#[derive(Clone, Copy)]
pub enum Then<'a> {
    /// Nothing is known of that.
    Nothing,
    /// It carries what it grasps to another place.
    Carry(Stand),
    /// It goes straight on, to a pose by that which it has.
    Push(&'a dyn Fn(Isometry3<f64>) -> Isometry3<f64>),
}

/// What has kept the arm from its ways so far: what it would have touched, or else what was first.
#[derive(Debug, Default)]
pub struct Kept(Option<Failure>);

impl Kept {
    /// # Errors
    /// A failure after which no other way may be tried.
    pub fn note(&mut self, failure: Failure) -> Result<(), Failure> {
        if forbids(failure.outcome) {
            return Err(failure);
        }
        let is_blocked = |failure: &Failure| failure.outcome == Outcome::Blocked;
        match &self.0 {
            Some(first) if is_blocked(first) || !is_blocked(&failure) => {}
            _ => self.0 = Some(failure),
        }
        Ok(())
    }

    /// That the arm does not get to a place.
    pub fn told(self, stand: Stand) -> Failure {
        let [x, y] = stand.at;
        let failure = self.0;
        let failure = failure.unwrap_or_else(|| Failure::new(Outcome::Unreachable, "no way"));
        if failure.outcome == Outcome::Blocked {
            return failure;
        }
        let text = format!("{x:.3}, {y:.3} cannot be reached: {}", failure.reason);
        Failure::new(failure.outcome, text)
    }
}

/// Poses down at a place, each with the index of its turn, in the order in which they are tried. Turned by a part of
/// the circle they stand as before: of these poses the nearest to how the gripper is turned now comes first.
pub fn turned(
    stand: Stand,
    turns: &[f64],
    fingers: u8,
    now: &UnitQuaternion<f64>,
) -> Vec<(usize, Isometry3<f64>)> {
    let far = |pose: &Isometry3<f64>| pose.rotation.angle_to(now);
    let of_turn = |(nth, turn_deg): (usize, &f64)| {
        let part = 360.0 / f64::from(fingers);
        let turns = (0..fingers).map(|nth| turn_deg + part * f64::from(nth));
        let mut same: Vec<_> = turns.map(|turn| stand.pose(turn)).collect();
        same.sort_by(|one, other| far(one).total_cmp(&far(other)));
        same.into_iter().map(move |pose| (nth, pose))
    };
    turns.iter().enumerate().flat_map(of_turn).collect()
}

impl ArmArgs {
    /// A motion of the tool; what goes gently stops as soon as anything else.
    pub(super) fn motion(&self, (pose, path): (Isometry3<f64>, PathKind), speed: f64) -> Plan {
        Plan {
            target: arm::pose(&pose),
            path,
            speed,
            acceleration: Some(speed.max(self.slow)),
            elbow: None,
        }
    }

    /// Where the joints are after motions that lead too near to nothing.
    async fn ahead(
        &self,
        cx: &Context,
        from: &Joints,
        motions: Vec<Plan>,
    ) -> Result<Joints, Failure> {
        let ask = LookAhead {
            from: *from,
            motions,
            others: Vec::new(),
        };
        let seen = crate::wire::ask(cx, &self.paths, ask).await?;
        seen.map_err(|unplanned| match unplanned {
            Unplanned::Refused(Refused::Unplanned { reason, .. }) => {
                Failure::new(Outcome::Unreachable, reason)
            }
            Unplanned::Refused(Refused::Touches { touch, .. }) => {
                let [one, other] = touch.pair;
                let text = format!("{one} would come too near to {other}");
                Failure::new(Outcome::Blocked, text)
            }
            other => Failure::new(Outcome::Fault, other),
        })
    }

    /// That motions from where the arm stands lead too near to nothing.
    pub(super) async fn are_clear(
        &self,
        cx: &Context,
        arm: &Arm<'_>,
        motions: Vec<Plan>,
    ) -> Result<(), Failure> {
        let at = At::now(arm).await?;
        self.ahead(cx, &at.joints, motions).await.map(|_| ())
    }

    /// Straight up from there to where the arm goes to and fro, if it is not there yet.
    pub(super) fn rise(&self, tool: Isometry3<f64>) -> Option<(Isometry3<f64>, PathKind)> {
        let up = at_height(tool, TRAVEL_M);
        let is_low = tool.translation.z < TRAVEL_M - 0.01;
        is_low.then_some((up, PathKind::StraightLine))
    }

    /// Where the arm is when it has gone up from there.
    pub(super) async fn risen(&self, cx: &Context, at: At) -> Result<At, Failure> {
        let Some(up) = self.rise(at.tool) else {
            return Ok(at);
        };
        let motions = vec![self.motion(up, self.slow)];
        Ok(At {
            joints: self.ahead(cx, &at.joints, motions).await?,
            tool: up.0,
        })
    }

    /// Where the arm is when it has gone up from where it stands.
    pub(super) async fn risen_now(&self, cx: &Context, arm: &Arm<'_>) -> Result<At, Failure> {
        self.risen(cx, At::now(arm).await?).await
    }

    /// That it gets from there to where it waits.
    pub(super) async fn parks(&self, cx: &Context, at: &At) -> Result<(), Failure> {
        let back = self.ahead(cx, &at.joints, vec![self.parking()]);
        back.await.map(|_| ())
    }

    /// The motion to where the arm waits.
    pub(super) fn parking(&self) -> Plan {
        Plan {
            target: Target::Joints(arm::radians(&self.park_deg)),
            path: PathKind::Joint,
            speed: self.speed,
            acceleration: None,
            elbow: None,
        }
    }

    /// The turn about the vertical to the side of the table where a place is, if that is far round, and how the tool is turned then.
    pub(super) fn swung(&self, at: &At, stand: Stand) -> Option<(Plan, UnitQuaternion<f64>)> {
        let around = |x: f64, y: f64| y.atan2(x);
        let ([x, y], now) = (stand.at, at.tool.translation);
        let by = around(x, y) - around(now.x, now.y);
        if by.abs() < SWING {
            return None;
        }
        let mut joints = at.joints;
        if let Some(first) = joints.iter_mut().next() {
            *first += by;
        }
        let swing = Plan {
            target: Target::Joints(joints),
            path: PathKind::Joint,
            speed: self.speed,
            acceleration: None,
            elbow: None,
        };
        let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), by);
        Some((swing, turn * at.tool.rotation))
    }

    /// Ways down to a place in the order in which they are tried.
    pub(super) fn ways(&self, at: &At, stand: Stand, turns: &[f64]) -> Vec<Way> {
        let swung = self.swung(at, stand);
        let now = swung.map_or(at.tool.rotation, |(_, rotation)| rotation);
        let paths = [PathKind::StraightLine, PathKind::Joint];
        let way = |turn, down| {
            paths.map(|path| Way {
                turn,
                down,
                path,
                stand,
            })
        };
        turned(stand, turns, self.fingers, &now)
            .into_iter()
            .flat_map(|(turn, down)| way(turn, down))
            .collect()
    }

    /// Where the arm is when it has gone a way, from where it goes to and fro, and pushed something from there on, to this pose.
    pub(super) async fn look(
        &self,
        cx: &Context,
        at: &At,
        way: &Way,
        pushed: Option<Isometry3<f64>>,
    ) -> Result<At, Failure> {
        let above = at_height(way.down, TRAVEL_M);
        let swing = self.swung(at, way.stand).map(|(swing, _)| swing);
        let mut motions: Vec<Plan> = swing.into_iter().collect();
        motions.push(self.motion((above, way.path), self.speed));
        let downs = self.downs(above, way.down);
        motions.extend(downs.map(|(way, speed)| self.motion(way, speed)));
        let line = pushed.map(|pushed| (pushed, PathKind::StraightLine));
        motions.extend(line.map(|line| self.motion(line, self.gentle)));
        Ok(At {
            joints: self.ahead(cx, &at.joints, motions).await?,
            tool: pushed.unwrap_or(way.down),
        })
    }

    /// Where the arm is when it has gone down to a place from above it, turned as it is.
    pub(super) async fn lowered(&self, cx: &Context, at: &At, stand: Stand) -> Result<At, Failure> {
        let down = stand.turned_as(&at.tool);
        let downs = self.downs(at.tool, down);
        let motions = downs.map(|(way, speed)| self.motion(way, speed));
        Ok(At {
            joints: self.ahead(cx, &at.joints, motions.collect()).await?,
            tool: down,
        })
    }

    /// That what is grasped and lifted there can be set down at another place, and the arm goes back to where it waits.
    pub(super) async fn carries(&self, cx: &Context, at: At, to: Stand) -> Result<(), Failure> {
        let mut kept = Kept::default();
        for way in self.ways(&at, to, &self.turns_deg()) {
            let back = async {
                let there = self.look(cx, &at, &way, None).await?;
                let risen = self.risen(cx, there).await?;
                self.parks(cx, &risen).await
            };
            match back.await {
                Ok(()) => return Ok(()),
                Err(failure) => kept.note(failure)?,
            }
        }
        Err(kept.told(to))
    }
}
