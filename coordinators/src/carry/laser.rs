//! The Laser Coordinator: the functions of `nets/carry/laser.net`, which have the pointer in the hand show people in the room a
//! place, and blink (SORMA technical report, section 2.1.3).
//!
//! The light leaves the hand along the tool's z axis. It comes from the arm's side, aslant, so that the hand hides its spot
//! neither from people nor from cameras on the other side. Only who has reserved the arm may set its slots: so the same task
//! moves the arm and lights the pointer.

use std::{rc::Rc, time::Duration};

use ctos::{
    config::{App, TaskConfig},
    diagnostic::{Finding, Findings},
    registry::Registry,
    task::Context,
};
use mcs::client::PathKind;
use nalgebra::{Isometry3, Matrix3, Point3, Rotation3, Translation3, UnitQuaternion, Vector3};
use pnt::library::{Acted, Action, Library};
use serde::{Deserialize, Serialize};

use super::errand::LASER_PROBLEMS;
use crate::{
    arm::{self, Arm, ArmKeys},
    dom::DomStore,
    handler::{self, NetArgs},
    motion::mcs_task,
    outcome::{Failure, Outcome},
};

/// The handler's name.
pub const HANDLER: &str = "coordinators.carry_laser";

/// What shall be pointed at: written by the Dispatcher.
pub const SHOWN: &str = "shown";

/// [`SHOWN`].
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Shown {
    /// The command.
    pub command: u32,
    /// Where the spot shall be in the base frame of the arm, m.
    pub at: Point3<f64>,
}

/// How far the light may be from the vertical, degrees: those that are tried, in this order.
const TILTS_DEG: [f64; 6] = [35.0, 45.0, 25.0, 55.0, 15.0, 0.0];

/// Turns of the hand about the light, in quarters.
const QUARTERS: u32 = 4;

/// Nobody waits for more.
const MOST_BLINKS: u32 = 1000;

/// Arguments.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
struct LaserArgs {
    /// The client interface of MCS.
    #[serde(default = "mcs_task")]
    mcs: String,
    /// The data object manager.
    #[serde(default = "crate::dom_task")]
    dom: String,
    /// The slot of the pointer among those of the arm.
    #[serde(default = "pointer_slot")]
    slot: String,
    /// Where the light leaves the hand, in the tool's frame, m.
    light: [f64; 3],
    /// How far it is from there to the spot, m.
    #[serde(default = "away_m")]
    away_m: f64,
    /// How often it blinks, and how long once on and off takes, s.
    #[serde(default = "blinks")]
    blinks: u32,
    #[serde(default = "blink_s")]
    blink_s: f64,
    /// Fraction of full speed.
    #[serde(default = "speed")]
    speed: f64,
    /// Where the arm waits, degrees of its joints.
    park_deg: Vec<f64>,
    /// How long an MCS that is gone, and may be started again, is waited for, s.
    #[serde(default = "crate::service_within_s")]
    service_within_s: f64,
}

fn pointer_slot() -> String {
    "pointer".to_owned()
}

fn away_m() -> f64 {
    0.35
}

fn blinks() -> u32 {
    6
}

fn blink_s() -> f64 {
    0.6
}

fn speed() -> f64 {
    0.5
}

/// What the functions share.
struct Coordinator {
    args: Rc<LaserArgs>,
    store: DomStore,
}

/// Registers the handler.
pub(super) fn register(registry: &mut Registry) {
    handler::register::<LaserArgs>(registry);
}

impl NetArgs for LaserArgs {
    const HANDLER: &'static str = HANDLER;
    type State = Coordinator;

    fn dom(&self) -> &str {
        &self.dom
    }

    fn library(self, store: DomStore) -> Library<Coordinator> {
        Library::new(Coordinator {
            args: Rc::new(self),
            store,
        })
        // Between two requests there is nothing to know.
        .kept(|_| (), |_, ()| ())
        .action("point", point)
        .action("retreat", retreat)
    }

    fn check(&self, task: &TaskConfig, app: &App, findings: &mut Findings) {
        let keys = ArmKeys {
            mcs: &self.mcs,
            resume_within_s: 0.0,
            service_within_s: self.service_within_s,
            speeds: &[("speed", self.speed)],
            park_deg: Some(&self.park_deg),
        };
        keys.check(task, app, "coordinators::carry::robot", findings);
        let mut wrong = |key: &str, text: String| {
            let place = task.args.locate(key).unwrap_or_else(|| task.place.clone());
            findings.push(Finding::error("coordinators::carry::robot", text).at(place));
        };
        if !self.light.iter().all(|number| number.abs() <= 1.0) {
            wrong("light", "`light` is further than 1 m".to_owned());
        }
        if !(0.05..=2.0).contains(&self.away_m) {
            let text = format!("`away_m` is {}; give from 0.05 to 2 m", self.away_m);
            wrong("away_m", text);
        }
        if !(1..=MOST_BLINKS).contains(&self.blinks) {
            let text = format!("`blinks` is {}; give from 1 to {MOST_BLINKS}", self.blinks);
            wrong("blinks", text);
        }
        if !(0.1..=60.0).contains(&self.blink_s) {
            let text = format!("`blink_s` is {}; give from 0.1 to 60 s", self.blink_s);
            wrong("blink_s", text);
        }
    }
}

type Act = Action<Coordinator>;

/// Goes where the light meets the place, has it blink, and parks the arm.
async fn point(action: Act) -> Acted {
    let (args, store) = action.with_state(|state| (state.args.clone(), state.store.clone()));
    let cx = action.cx();
    let pointed = async {
        let shown: Shown = store.fetch(cx, SHOWN).await?;
        let arm = args.arm(cx);
        arm.acquire().await?;
        // Who died while it was on has left it so.
        arm.output(&args.slot, 0.0).await?;
        let pose = args.within_reach(&arm, &shown.at).await?;
        let order = arm::order(arm::pose(&pose), PathKind::Joint, args.speed);
        arm.travel(order).await?;
        args.blink(&arm).await?;
        arm.park(&args.park_deg, args.speed).await
    };
    let pointed: Result<(), Failure> = pointed.await;
    if let Err(failure) = pointed {
        super::errand::note_problem(cx, &store, LASER_PROBLEMS, "point", &failure).await;
        return Err(failure.into());
    }
    Ok(())
}

/// Puts the light out, and gives the arm back: where it waits, or where it is when it can go nowhere.
async fn retreat(action: Act) -> Acted {
    let args = action.with_state(|state| state.args.clone());
    let arm = args.arm(action.cx());
    let parked = async {
        arm.acquire().await?;
        arm.output(&args.slot, 0.0).await?;
        arm.park(&args.park_deg, args.speed).await
    };
    let parked: Result<(), Failure> = parked.await;
    if let Err(failure) = parked {
        tracing::warn!(reason = %failure, "the arm stays where it has pointed");
        // Without power there is no light.
        arm.release().await?;
    }
    Ok(())
}

impl LaserArgs {
    fn arm<'a>(&'a self, cx: &'a Context) -> Arm<'a> {
        Arm {
            cx,
            mcs: &self.mcs,
            within_s: self.service_within_s,
        }
    }

    /// The first pose from which the light meets the place, and which the arm reaches.
    async fn within_reach(
        &self,
        arm: &Arm<'_>,
        at: &Point3<f64>,
    ) -> Result<Isometry3<f64>, Failure> {
        let mut first = None;
        for pose in poses(at, &self.light.into(), self.away_m) {
            match arm
                .plan(arm::pose(&pose), PathKind::Joint, self.speed)
                .await
            {
                Ok(_) => return Ok(pose),
                Err(failure) if failure.outcome == Outcome::Unreachable => {
                    first.get_or_insert(failure);
                }
                Err(failure) => return Err(failure),
            }
        }
        let why = first.map_or_else(String::new, |failure| failure.reason);
        let text = format!(
            "the pointer reaches x {:.3} m, y {:.3} m from nowhere: {why}",
            at.x, at.y
        );
        Err(Failure::new(Outcome::Unreachable, text))
    }

    async fn blink(&self, arm: &Arm<'_>) -> Result<(), Failure> {
        // Checked with the arguments.
        let half = Duration::try_from_secs_f64(0.5 * self.blink_s).unwrap_or_default();
        for _ in 0..self.blinks {
            if arm.cx.is_stopping() {
                break;
            }
            for lit in [1.0, 0.0] {
                arm.output(&self.slot, lit).await?;
                arm.cx.sleep(half).await;
            }
        }
        Ok(())
    }
}

/// Poses of the tool, `base_t_tool`, from which light that leaves at `light` (tool's frame, m) along the tool's z axis meets a
/// place after `away_m`: aslant from the arm's side first, and straight down last.
fn poses(
    at: &Point3<f64>,
    light: &Point3<f64>,
    away_m: f64,
) -> impl Iterator<Item = Isometry3<f64>> {
    let (at, light) = (*at, *light);
    // Straight above the arm every direction is as good.
    let outwards = Vector3::new(at.x, at.y, 0.0);
    let outwards = outwards.try_normalize(1e-6).unwrap_or_else(Vector3::x);
    let tilts = TILTS_DEG.into_iter().map(f64::to_radians);
    tilts.flat_map(move |tilt| {
        let z = outwards * tilt.sin() - Vector3::z() * tilt.cos();
        let x = outwards * tilt.cos() + Vector3::z() * tilt.sin();
        let axes = Matrix3::from_columns(&[x, z.cross(&x), z]);
        let aslant = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(axes));
        (0..QUARTERS).map(move |quarter| {
            let about = f64::from(quarter) * std::f64::consts::FRAC_PI_2;
            let turn = aslant * UnitQuaternion::from_axis_angle(&Vector3::z_axis(), about);
            let tool = at - z * away_m - turn * light.coords;
            Isometry3::from_parts(Translation3::from(tool), turn)
        })
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn from_every_pose_the_light_meets_the_place_from_above_and_from_the_arms_side() {
        let light = Point3::new(0.05, 0.01, -0.065);
        for at in [
            Point3::new(0.5, 0.1, 0.43),
            Point3::new(0.1, -0.6, 0.4),
            Point3::new(0.0, 0.0, 0.4),
        ] {
            let all: Vec<Isometry3<f64>> = poses(&at, &light, 0.35).collect();
            assert_eq!(all.len(), TILTS_DEG.len() * QUARTERS as usize);
            for pose in all {
                let leaves = pose * light;
                assert!((leaves + pose * Vector3::z() * 0.35 - at).norm() < 1e-12);
                assert!(leaves.z > at.z + 0.15);
                let out = |point: &Point3<f64>| point.coords.xy().norm();
                assert!(at.x == 0.0 || out(&leaves) < out(&at) + 1e-9, "{leaves}");
                let x = pose * Vector3::x();
                assert!((x.cross(&(pose * Vector3::y())) - pose * Vector3::z()).norm() < 1e-12);
            }
        }
    }
}
