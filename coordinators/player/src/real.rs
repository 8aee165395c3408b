//! Arm and gripper of a world that moves by itself, as MCS moves them: above a disc, down around it, up, across, and down again.

use std::time::Duration;

use coordinators::{
    arm::{self, Arm, ArmKeys},
    outcome::{Failure, Outcome},
};
use ctos::{
    config::{App, TaskConfig},
    diagnostic::Findings,
    message::Command,
    task::{Context, HandlerError},
};
use mcs::client::{MotionError, Move, PathKind, Target};
use mcs_hand::command::{Grasp, Held, Open, ReadHeld};
use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector2, Vector3};
use serde::Deserialize;

use crate::wire::{DISC_M, Errand, Hindrance, Spot, TABLE_M};

/// The middle of the pads is so far above the lower side of the lowest disc that they hold, m.
const PADS_M: f64 = 0.016;
/// So high, in the arm's base frame, the tool goes to and fro, m: what it holds passes 70 mm above the highest stack.
const TRAVEL_M: f64 = 0.53;
/// The last of the ways down is gone gently, m.
const GENTLE_M: f64 = 0.015;
/// What is felt so little above where a disc should stand is that it stands, m.
const EARLY_M: f64 = 0.006;
/// Turns of the gripper about the vertical: the first with which the arm gets there, degrees.
const TURNS_DEG: [f64; 4] = [0.0, 90.0, 45.0, -45.0];
/// Diameter of a disc, and by how much what is held may differ, m.
const DISC_WIDTH_M: f64 = 0.04;
const TOLERANCE_M: f64 = 0.004;
/// Half the width of closed jaws, and how far from the disc they come down before they push it, m.
const CLOSED_M: f64 = 0.012;
const BESIDE_M: f64 = 0.004;
/// Farther round than this the arm swings first, rad: the nearest joints to those of now may be those of an arm that reaches over its
/// shoulder, and what it carries would be turned upside down on the way.
const SWING: f64 = 2.0;
/// What is nearer to where it is to be is not pushed, m.
const THERE_M: f64 = 0.001;
/// How long the jaws may take.
const JAWS: Duration = Duration::from_secs(60);

/// Arguments of the Robot Coordinator whose arm is real.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ArmArgs {
    /// The client interface of MCS.
    #[serde(default = "mcs_task")]
    mcs: String,
    /// Its gripper, which is opened before the arm goes down.
    #[serde(default)]
    gripper: GripperArgs,
    /// Fractions of full speed: to and fro, up and down, and on the last of the ways down.
    #[serde(default = "speed")]
    speed: f64,
    #[serde(default = "slow")]
    slow: f64,
    #[serde(default = "gentle")]
    gentle: f64,
    /// Recipes of guards that end a way down.
    #[serde(default)]
    touch: Vec<String>,
    /// Where the arm waits, degrees of its joints.
    park_deg: Vec<f64>,
    /// How long an MCS that is gone, and may be started again, is waited for, s.
    #[serde(default = "within_s")]
    service_within_s: f64,
}

/// Arguments of the Hand Coordinator whose gripper is real.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct GripperArgs {
    /// The task of the gripper.
    task: String,
    /// How hard each jaw presses, N.
    force_n: f64,
    /// How far the pads are apart on the way down, m.
    open_m: f64,
    /// Fraction of full speed of the jaws.
    speed: f64,
}

impl Default for GripperArgs {
    fn default() -> Self {
        Self {
            task: "gripper".to_owned(),
            force_n: 15.0,
            open_m: 0.06,
            speed: 0.5,
        }
    }
}

fn mcs_task() -> String {
    "mcs".to_owned()
}

const fn speed() -> f64 {
    0.6
}

const fn slow() -> f64 {
    0.4
}

const fn gentle() -> f64 {
    0.05
}

const fn within_s() -> f64 {
    30.0
}

/// Where discs stand, or are to stand.
#[derive(Debug, Clone, Copy)]
pub struct Stand {
    /// In the arm's base frame, m.
    at: [f64; 2],
    /// The lower side of the lowest of them, m.
    bottom: f64,
}

impl Stand {
    /// The ends of an errand, whose places the transform has found.
    #[must_use]
    pub fn both(errand: &Errand, points: &[[f64; 2]; 2]) -> [Self; 2] {
        let [from, to] = *points;
        let [under_from, under_to] = errand.beneath();
        let stand = |at, spot: Spot, below: u8| {
            let floor = match spot {
                Spot::Board(_) => TABLE_M + crate::wire::BOARD_M,
                _ => TABLE_M,
            };
            Self {
                at,
                bottom: floor + f64::from(below) * DISC_M,
            }
        };
        [
            stand(from, errand.from, under_from),
            stand(to, errand.to, under_to),
        ]
    }

    /// That the arm does not get there, and what kept it from that first.
    fn out_of_reach(&self, first: Option<Failure>) -> Failure {
        let [x, y] = self.at;
        let failure = first.unwrap_or_else(|| Failure::new(Outcome::Unreachable, "no way"));
        let text = format!("{x:.3}, {y:.3} cannot be reached: {}", failure.reason);
        Failure::new(failure.outcome, text)
    }

    /// `base_t_tool` with the pads around them.
    fn pose(&self, turn_deg: f64) -> Isometry3<f64> {
        let [x, y] = self.at;
        let down = UnitQuaternion::from_euler_angles(std::f64::consts::PI, 0.0, 0.0);
        let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), turn_deg.to_radians());
        Isometry3::from_parts(Translation3::new(x, y, self.bottom + PADS_M), turn * down)
    }
}

/// Whether another way may not be tried after such a failure: somebody stopped the arm, or it does not work.
fn forbids(outcome: Outcome) -> bool {
    matches!(
        outcome,
        Outcome::Stopped | Outcome::Estopped | Outcome::Fault | Outcome::Lost
    )
}

/// The same pose at another height.
fn at_height(mut pose: Isometry3<f64>, z: f64) -> Isometry3<f64> {
    pose.translation.z = z;
    pose
}

/// Poses down at a place, each with the index of its turn, in the order in which they are tried. A half turn more is the same to a
/// gripper: the nearer of the two to how it is turned now comes first.
fn turned(
    stand: Stand,
    turns: &[f64],
    now: &UnitQuaternion<f64>,
) -> impl Iterator<Item = (usize, Isometry3<f64>)> {
    turns.iter().enumerate().flat_map(move |(nth, turn_deg)| {
        let mut both = [*turn_deg, turn_deg + 180.0].map(|turn| stand.pose(turn));
        both.sort_by(|one, other| {
            let far = |pose: &Isometry3<f64>| pose.rotation.angle_to(now);
            far(one).total_cmp(&far(other))
        });
        both.map(|pose| (nth, pose))
    })
}

impl ArmArgs {
    /// Findings where the arguments make no sense.
    pub fn check(&self, task: &TaskConfig, app: &App, findings: &mut Findings) {
        let keys = ArmKeys {
            mcs: &self.mcs,
            resume_within_s: 0.0,
            service_within_s: self.service_within_s,
            speeds: &[
                ("real.speed", self.speed),
                ("real.slow", self.slow),
                ("real.gentle", self.gentle),
            ],
            park_deg: Some(&self.park_deg),
        };
        keys.check(task, app, "checkers::player::args", findings);
        self.gripper.check(task, app, findings);
    }

    fn arm<'a>(&'a self, cx: &'a Context) -> Arm<'a> {
        Arm {
            cx,
            mcs: &self.mcs,
            within_s: self.service_within_s,
        }
    }

    /// With open jaws around what stands there, if it can be set down where it is to go.
    pub async fn reach(&self, cx: &Context, from: Stand, to: Stand) -> Result<(), Hindrance> {
        let of = |end: u8| move |failure: Failure| Hindrance::of(&failure, end);
        let (mut turns, mut met) = (TURNS_DEG.as_slice(), None);
        loop {
            let turn = match self.above_turned(cx, from, turns).await {
                Ok(turn) => turn,
                // What was met on the way down says more than that there is no other turn.
                Err(failure) if forbids(failure.outcome) => return Err(of(0)(failure)),
                Err(failure) => return Err(of(0)(met.unwrap_or(failure))),
            };
            self.is_in_reach(&self.arm(cx), to).await.map_err(of(1))?;
            self.gripper.open(cx).await.map_err(of(0))?;
            let Err(failure) = self.down(cx, from).await else {
                return Ok(());
            };
            let text = format!("something is in the way down: {}", failure.reason);
            let outcome = failure.outcome;
            let failure = Failure::new(outcome, text);
            if outcome != Outcome::Guard {
                return Err(of(0)(failure));
            }
            // Turned otherwise, the fingers may pass beside it.
            turns = turns.get(turn + 1..).unwrap_or_default();
            met = Some(failure);
        }
    }

    /// Whether the arm can get down there from where it is.
    async fn is_in_reach(&self, arm: &Arm<'_>, stand: Stand) -> Result<(), Failure> {
        let now = arm.tool().await?.rotation;
        let mut first = None;
        for (_, down) in turned(stand, &TURNS_DEG, &now) {
            match self.plan_down(arm, down).await {
                Ok(()) => return Ok(()),
                Err(failure) => first.get_or_insert(failure),
            };
        }
        Err(stand.out_of_reach(first))
    }

    async fn plan_down(&self, arm: &Arm<'_>, down: Isometry3<f64>) -> Result<(), Failure> {
        let planned = arm.plan(arm::pose(&down), PathKind::Joint, self.speed);
        planned.await.map(|_| ())
    }

    /// Up with what is held, and down with it until it stands there.
    pub async fn transfer(&self, cx: &Context, stand: Stand) -> Result<(), Failure> {
        let arm = self.arm(cx);
        arm.acquire().await?;
        self.up(&arm).await?;
        self.gripper.holds(cx).await?;
        self.above(cx, stand).await?;
        self.gripper.holds(cx).await?;
        match self.down(cx, stand).await {
            Err(failure)
                if failure.outcome == Outcome::Guard && arm.was_ended_by(&self.touch).await? =>
            {
                let early = arm.tool().await?.translation.z - stand.pose(0.0).translation.z;
                if early <= EARLY_M {
                    return Ok(());
                }
                let text = format!("something stands there already, {:.0} mm high", early * 1e3);
                Err(Failure::new(Outcome::Occupied, text))
            }
            ended => ended,
        }
    }

    /// Pushes the disc that stands at one place to another, with the closed jaws behind it.
    pub async fn push(&self, cx: &Context, from: Stand, to: Stand) -> Result<(), Failure> {
        let way = Vector2::from(to.at) - Vector2::from(from.at);
        let Some(ahead) = way.try_normalize(THERE_M) else {
            return Ok(());
        };
        let behind = 0.5 * DISC_WIDTH_M + CLOSED_M;
        let beside = |stand: Stand, behind: f64| Stand {
            at: (Vector2::from(stand.at) - ahead * behind).into(),
            ..stand
        };
        let arm = self.arm(cx);
        arm.acquire().await?;
        self.up(&arm).await?;
        self.gripper.open_to(cx, 0.0).await?;
        // A flat side is ahead.
        let first = ahead.y.atan2(ahead.x).to_degrees();
        let turns = [0.0, 90.0].map(|turn| first + turn);
        self.above_turned(cx, beside(from, behind + BESIDE_M), &turns)
            .await?;
        self.down(cx, from).await?;
        let there = beside(to, behind).pose(0.0).translation;
        let now = arm.tool().await?;
        let pushed = Isometry3::from_parts(
            Translation3::new(there.x, there.y, now.translation.z),
            now.rotation,
        );
        let line = (pushed, PathKind::StraightLine);
        self.go(&arm, line, self.gentle, &self.touch).await?;
        self.up(&arm).await
    }

    /// Up, and to where the arm waits; there it is given back.
    pub async fn park(&self, cx: &Context) -> Result<(), Failure> {
        let arm = self.arm(cx);
        arm.acquire().await?;
        self.up(&arm).await?;
        arm.park(&self.park_deg, self.speed).await
    }

    async fn go(
        &self,
        arm: &Arm<'_>,
        (pose, path): (Isometry3<f64>, PathKind),
        speed: f64,
        guards: &[String],
    ) -> Result<(), Failure> {
        let order = Move {
            // What goes gently stops as soon as anything else.
            acceleration: Some(speed.max(self.slow)),
            guards: guards.to_vec(),
            ..arm::order(arm::pose(&pose), path, speed)
        };
        arm.travel(order).await.map(|_| ())
    }

    /// Straight up to where the arm goes to and fro.
    async fn up(&self, arm: &Arm<'_>) -> Result<(), Failure> {
        let now = arm.tool().await?;
        if now.translation.z >= TRAVEL_M - 0.01 {
            return Ok(());
        }
        let up = at_height(now, TRAVEL_M);
        self.go(arm, (up, PathKind::StraightLine), self.slow, &[])
            .await
    }

    /// Turns about the vertical to the side of the table where a place is, if that is far round.
    async fn swing(&self, arm: &Arm<'_>, stand: Stand) -> Result<(), Failure> {
        let now = arm.ask(|arm| async move { arm.position().await }).await?;
        let around = |x: f64, y: f64| y.atan2(x);
        let [x, y] = stand.at;
        let by = around(x, y) - around(now.base_t_tool[3], now.base_t_tool[7]);
        if by.abs() < SWING {
            return Ok(());
        }
        let mut joints = now.joints;
        if let Some(first) = joints.iter_mut().next() {
            *first += by;
        }
        let order = arm::order(Target::Joints(joints), PathKind::Joint, self.speed);
        arm.travel(order).await.map(|_| ())
    }

    /// To above a place, turned so that the arm gets down there.
    async fn above(&self, cx: &Context, stand: Stand) -> Result<(), Failure> {
        self.above_turned(cx, stand, &TURNS_DEG).await.map(|_| ())
    }

    /// The same with one of these turns: which one it is.
    async fn above_turned(
        &self,
        cx: &Context,
        stand: Stand,
        turns: &[f64],
    ) -> Result<usize, Failure> {
        let arm = self.arm(cx);
        arm.acquire().await?;
        self.up(&arm).await?;
        self.swing(&arm, stand).await?;
        let now = arm.tool().await?.rotation;
        let mut first = None;
        for (nth, down) in turned(stand, turns, &now) {
            if let Err(failure) = self.plan_down(&arm, down).await {
                first.get_or_insert(failure);
                continue;
            }
            let above = at_height(down, TRAVEL_M);
            for path in [PathKind::StraightLine, PathKind::Joint] {
                match self.go(&arm, (above, path), self.speed, &[]).await {
                    Ok(()) => return Ok(nth),
                    Err(failure) if forbids(failure.outcome) => return Err(failure),
                    Err(failure) => first.get_or_insert(failure),
                };
            }
        }
        Err(stand.out_of_reach(first))
    }

    /// Straight down, the last of it gently.
    async fn down(&self, cx: &Context, stand: Stand) -> Result<(), Failure> {
        let arm = self.arm(cx);
        let now = arm.tool().await?;
        let bottom = stand.bottom + PADS_M;
        let line = PathKind::StraightLine;
        let near = at_height(now, bottom + GENTLE_M);
        if now.translation.z > near.translation.z {
            self.go(&arm, (near, line), self.slow, &self.touch).await?;
        }
        let down = (at_height(now, bottom), line);
        self.go(&arm, down, self.gentle, &self.touch).await
    }
}

impl GripperArgs {
    /// Findings where the arguments make no sense.
    pub fn check(&self, task: &TaskConfig, app: &App, findings: &mut Findings) {
        coordinators::need_task(task, app, "real", &self.task, findings);
    }

    /// Asks, again while the gripper's task is gone and may be started again: each request may be made twice.
    async fn ask<C>(&self, cx: &Context, request: C) -> Result<Held, Failure>
    where
        C: Command<Reply = Result<Held, MotionError>> + Clone,
    {
        let is_lost = |error: &MotionError| error.outcome == mcs::client::Outcome::Lost;
        let asked = coordinators::patiently(cx, crate::wire::PATIENCE, is_lost, || async {
            let gripper = cx.task(&self.task).await?;
            cx.call(&gripper, request.clone()).deadline(JAWS).await?
        });
        Ok(asked.await?)
    }

    async fn open(&self, cx: &Context) -> Result<(), Failure> {
        self.open_to(cx, self.open_m).await
    }

    async fn open_to(&self, cx: &Context, width_m: f64) -> Result<(), Failure> {
        let open = Open {
            width_m: Some(width_m),
            speed: self.speed,
        };
        self.ask(cx, open).await.map(|_| ())
    }

    /// Closes, and sees that a disc is between the jaws.
    pub async fn grasp(&self, cx: &Context) -> Result<(), HandlerError> {
        let close = Grasp {
            force_n: Some(self.force_n),
            speed: self.speed,
        };
        is_disc(&self.ask(cx, close).await?)
    }

    /// Fails when no disc is held.
    async fn holds(&self, cx: &Context) -> Result<(), Failure> {
        let held = self.ask(cx, ReadHeld {}).await?;
        is_between(&held).map_err(|error| Failure::new(Outcome::Absent, error))
    }

    /// Opens, and tells whether it held something until then.
    pub async fn release(&self, cx: &Context) -> Result<(), HandlerError> {
        let held = is_between(&self.ask(cx, ReadHeld {}).await?);
        self.open(cx).await?;
        held
    }
}

/// Whether jaws that have just closed have a disc between them.
fn is_disc(held: &Held) -> Result<(), HandlerError> {
    if held.holds {
        return is_between(held);
    }
    Err(HandlerError::new("there is nothing between the fingers"))
}

/// Whether a disc is still between the jaws. What is set down on another one moves them for a moment, so only their width counts.
fn is_between(held: &Held) -> Result<(), HandlerError> {
    let off = (held.width_m - DISC_WIDTH_M).abs();
    if off <= TOLERANCE_M {
        return Ok(());
    }
    let width_mm = held.width_m * 1e3;
    let text = format!("the fingers are {width_mm:.0} mm apart, and no disc is so wide");
    Err(HandlerError::new(text))
}

#[cfg(test)]
mod tests;
