//! Arm and gripper of a world that moves by itself, as MCS moves them: above a disc, down around it, up, across, and down again.
//! `ahead` has what the arm looks at before it begins.

mod ahead;
mod sight;

use std::{cell::Cell, time::Duration};

use coordinators::{
    arm::{self, Arm, ArmKeys},
    outcome::{Failure, Outcome},
    wrist::WristArgs,
};
use ctos::{
    config::{App, TaskConfig},
    diagnostic::{Finding, Findings},
    message::Command,
    task::{Context, HandlerError},
};
use mcs::client::{MotionError, Move, PathKind, Plan};
use mcs_hand::command::{Grasp, Held, Open, ReadHeld};
use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector2, Vector3};
use serde::Deserialize;

use self::{
    ahead::{At, Kept, Then, here},
    sight::Lesson,
};
use crate::wire::{self, Errand, Hindrance, Spot, TABLE_M, disc_m};

/// The middle of the pads is so far above the lower side of the lowest disc that they hold, m.
const PADS_M: f64 = 0.016;
/// So high, in the arm's base frame, the tool goes to and fro, m: what it holds passes 30 mm or more above the highest stack.
const TRAVEL_M: f64 = 0.53;
/// The last of the ways down is gone gently, m.
const GENTLE_M: f64 = 0.015;
/// What is felt so little above where a disc should stand is that it stands, m.
const EARLY_M: f64 = 0.006;
/// Turns of the gripper about the vertical: the first with which the arm gets there, in parts of the turn after which its fingers
/// stand as before.
const TURNS: [f64; 4] = [0.0, 0.5, 0.25, -0.25];
const MOST_FINGERS: u8 = 6;
/// Diameter of a disc, and by how much what is held may differ, m.
const DISC_WIDTH_M: f64 = 0.04;
const TOLERANCE_M: f64 = 0.004;
/// Half the width of closed jaws, and how far from the disc they come down before they push it, m.
const CLOSED_M: f64 = 0.012;
const BESIDE_M: f64 = 0.004;
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
    /// The task that looks ahead along ways before the arm begins them.
    #[serde(default = "paths_task")]
    paths: String,
    /// Its gripper, which is opened before the arm goes down.
    #[serde(default)]
    gripper: GripperArgs,
    /// How many fingers or jaws it has, evenly about the tool.
    #[serde(default = "fingers")]
    fingers: u8,
    /// How high a disc is, m.
    #[serde(default = "disc_m")]
    disc_m: f64,
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
    /// The camera on the hand, which looks at what is grasped from above it; none looks without it.
    wrist: Option<WristArgs>,
    #[serde(skip)]
    lesson: Cell<Lesson>,
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

fn paths_task() -> String {
    "paths".to_owned()
}

const fn fingers() -> u8 {
    2
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
    /// Whether it is one disc, with none beneath.
    single: bool,
}

impl Stand {
    /// The ends of an errand, whose places the transform has found, and discs so high, m.
    fn both(errand: &Errand, points: &[[f64; 2]; 2], disc_m: f64) -> [Self; 2] {
        let [from, to] = *points;
        let [under_from, under_to] = errand.beneath();
        let stand = |at, spot: Spot, below: u8| {
            let floor = match spot {
                Spot::Board(_) => TABLE_M + wire::BOARD_M,
                _ => TABLE_M,
            };
            Self {
                at,
                bottom: floor + f64::from(below) * disc_m,
                single: below == 0 && errand.discs == 1,
            }
        };
        [
            stand(from, errand.from, under_from),
            stand(to, errand.to, under_to),
        ]
    }

    /// `base_t_tool` with the pads around them.
    fn pose(&self, turn_deg: f64) -> Isometry3<f64> {
        let [x, y] = self.at;
        let down = UnitQuaternion::from_euler_angles(std::f64::consts::PI, 0.0, 0.0);
        let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), turn_deg.to_radians());
        Isometry3::from_parts(Translation3::new(x, y, self.bottom + PADS_M), turn * down)
    }

    /// The same, turned as the tool is.
    fn turned_as(&self, tool: &Isometry3<f64>) -> Isometry3<f64> {
        Isometry3::from_parts(self.pose(0.0).translation, tool.rotation)
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
        coordinators::need_task(task, app, "real.paths", &self.paths, findings);
        wire::check_disc_m(task, "real.disc_m", self.disc_m, findings);
        if !(2..=MOST_FINGERS).contains(&self.fingers) {
            let place = task.args.locate("real.fingers");
            let text = format!("`real.fingers` is {}", self.fingers);
            let finding = Finding::error("checkers::player::args", text);
            let finding = finding.at(place.unwrap_or_else(|| task.place.clone()));
            findings.push(finding.help(format!("give from 2 to {MOST_FINGERS}")));
        }
        self.gripper.check(task, app, findings);
        if let Some(wrist) = &self.wrist {
            wrist.check(task, app, "real.wrist", "checkers::player::args", findings);
        }
    }

    /// The ends of an errand, whose places the transform has found.
    #[must_use]
    pub fn stands(&self, errand: &Errand, points: &[[f64; 2]; 2]) -> [Stand; 2] {
        Stand::both(errand, points, self.disc_m)
    }

    /// The turn after which the fingers stand as before, degrees.
    fn period_deg(&self) -> f64 {
        360.0 / f64::from(self.fingers)
    }

    /// Turns of the gripper in the order in which they are tried, degrees.
    fn turns_deg(&self) -> [f64; 4] {
        TURNS.map(|part| part * self.period_deg())
    }

    fn arm<'a>(&'a self, cx: &'a Context) -> Arm<'a> {
        Arm {
            cx,
            mcs: &self.mcs,
            within_s: self.service_within_s,
        }
    }

    /// With open jaws around what stands there, if all of the carry can be done.
    pub async fn reach(&self, cx: &Context, from: Stand, to: Stand) -> Result<(), Hindrance> {
        let of = |end: u8| move |failure: Failure| Hindrance::of(&failure, end);
        let all = self.turns_deg();
        let (mut turns, mut met) = (all.as_slice(), None);
        loop {
            let turn = match self.above_turned(cx, from, turns, Then::Carry(to)).await {
                Ok(turn) => turn,
                // What was met on the way down says more than that there is no other turn.
                Err((failure, end)) if forbids(failure.outcome) || end > 0 => {
                    return Err(of(end)(failure));
                }
                Err((failure, end)) => return Err(of(end)(met.unwrap_or(failure))),
            };
            self.gripper.open(cx).await.map_err(of(0))?;
            let seen = match self.seen(cx, from, to).await {
                Ok(seen) => seen,
                Err((failure, end)) if forbids(failure.outcome) => return Err(of(end)(failure)),
                Err((failure, _)) => {
                    turns = turns.get(turn + 1..).unwrap_or_default();
                    met = Some(failure);
                    continue;
                }
            };
            let Err(failure) = self.down(cx, seen).await else {
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

    /// Up with what is held, and down with it until it stands there.
    pub async fn transfer(&self, cx: &Context, stand: Stand) -> Result<(), Failure> {
        let arm = self.arm(cx);
        arm.acquire().await?;
        self.risen_now(cx, &arm).await?;
        self.up(&arm).await?;
        self.gripper.holds(cx).await?;
        self.lesson.set(self.lesson.get().carried());
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
        let there = beside(to, behind).pose(0.0).translation;
        let pushed = |now: Isometry3<f64>| {
            let to = Translation3::new(there.x, there.y, now.translation.z);
            Isometry3::from_parts(to, now.rotation)
        };
        let arm = self.arm(cx);
        arm.acquire().await?;
        self.risen_now(cx, &arm).await?;
        self.up(&arm).await?;
        self.gripper.open_to(cx, 0.0).await?;
        // A flat side is ahead.
        let first = ahead.y.atan2(ahead.x).to_degrees();
        let turns = [0.0, 90.0].map(|turn| first + turn);
        let behind_it = beside(from, behind + BESIDE_M);
        self.above_turned(cx, behind_it, &turns, Then::Push(&pushed))
            .await
            .map_err(|(failure, _)| failure)?;
        self.down(cx, behind_it).await?;
        let line = (pushed(arm.tool().await?), PathKind::StraightLine);
        self.go(&arm, line, self.gentle, &self.touch).await?;
        self.up(&arm).await
    }

    /// Up, and to where the arm waits; there it is given back.
    pub async fn park(&self, cx: &Context) -> Result<(), Failure> {
        let arm = self.arm(cx);
        arm.acquire().await?;
        let risen = self.risen_now(cx, &arm).await?;
        self.parks(cx, &risen).await?;
        self.up(&arm).await?;
        arm.park(&self.park_deg, self.speed).await
    }

    async fn go(
        &self,
        arm: &Arm<'_>,
        way: (Isometry3<f64>, PathKind),
        speed: f64,
        guards: &[String],
    ) -> Result<(), Failure> {
        let Plan {
            target,
            path,
            acceleration,
            ..
        } = self.motion(way, speed);
        let order = Move {
            acceleration,
            guards: guards.to_vec(),
            ..arm::order(target, path, speed)
        };
        arm.travel(order).await.map(|_| ())
    }

    /// Straight up to where the arm goes to and fro.
    async fn up(&self, arm: &Arm<'_>) -> Result<(), Failure> {
        match self.rise(arm.tool().await?) {
            Some(up) => self.go(arm, up, self.slow, &[]).await,
            None => Ok(()),
        }
    }

    /// Turns about the vertical to the side of the table where a place is, if that is far round.
    async fn swing(&self, arm: &Arm<'_>, stand: Stand) -> Result<(), Failure> {
        let Some((swing, _)) = self.swung(&At::now(arm).await?, stand) else {
            return Ok(());
        };
        let order = arm::order(swing.target, swing.path, swing.speed);
        arm.travel(order).await.map(|_| ())
    }

    /// To above a place, turned so that the arm gets down there.
    async fn above(&self, cx: &Context, stand: Stand) -> Result<(), Failure> {
        let turns = self.turns_deg();
        let above = self.above_turned(cx, stand, &turns, Then::Nothing);
        above.await.map(|_| ()).map_err(|(failure, _)| failure)
    }

    /// The same with one of these turns: which one it is. The arm stays where it is when it could not go on from there.
    async fn above_turned(
        &self,
        cx: &Context,
        stand: Stand,
        turns: &[f64],
        then: Then<'_>,
    ) -> Result<usize, (Failure, u8)> {
        let arm = self.arm(cx);
        arm.acquire().await.map_err(here)?;
        let mut at = self.risen_now(cx, &arm).await.map_err(here)?;
        let (mut kept, mut onward) = (Kept::default(), None);
        for way in self.ways(&at, stand, turns) {
            let pushed = match then {
                Then::Push(pushed) => Some(pushed(way.down)),
                _ => None,
            };
            let there = match self.look(cx, &at, &way, pushed).await {
                Ok(there) => there,
                Err(failure) => {
                    kept.note(failure).map_err(here)?;
                    continue;
                }
            };
            let follows = match self.risen(cx, there).await {
                Ok(risen) => match then {
                    Then::Carry(to) => self.carries(cx, risen, to).await.map_err(|kept| (kept, 1)),
                    _ => Ok(()),
                },
                Err(failure) => Err(here(failure)),
            };
            match follows {
                Ok(()) => {}
                Err((failure, _)) if forbids(failure.outcome) => return Err(here(failure)),
                Err((failure, 0)) => {
                    kept.note(failure).map_err(here)?;
                    continue;
                }
                // Grasped otherwise, it may be set down there.
                Err(failure) => {
                    onward.get_or_insert(failure);
                    continue;
                }
            }
            self.up(&arm).await.map_err(here)?;
            self.swing(&arm, stand).await.map_err(here)?;
            let above = (at_height(way.down, TRAVEL_M), way.path);
            match self.go(&arm, above, self.speed, &[]).await {
                Ok(()) => return Ok(way.turn),
                Err(failure) => kept.note(failure).map_err(here)?,
            }
            at = self.risen_now(cx, &arm).await.map_err(here)?;
        }
        Err(onward.unwrap_or_else(|| here(kept.told(stand))))
    }

    /// Straight down from above it, the last of it gently.
    async fn down(&self, cx: &Context, stand: Stand) -> Result<(), Failure> {
        let arm = self.arm(cx);
        let now = arm.tool().await?;
        let down = stand.turned_as(&now);
        for (way, speed) in self.downs(now, down) {
            self.go(&arm, way, speed, &self.touch).await?;
        }
        Ok(())
    }

    /// The ways down from above a pose to it, and how fast.
    fn downs(
        &self,
        now: Isometry3<f64>,
        down: Isometry3<f64>,
    ) -> impl Iterator<Item = ((Isometry3<f64>, PathKind), f64)> + use<> {
        let near = at_height(down, down.translation.z + GENTLE_M);
        let is_above = now.translation.z > near.translation.z;
        let near = is_above.then_some((near, self.slow));
        let ways = near.into_iter().chain([(down, self.gentle)]);
        ways.map(|(pose, speed)| ((pose, PathKind::StraightLine), speed))
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
