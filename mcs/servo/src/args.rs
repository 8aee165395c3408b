//! Arguments of the servo task, as they stand in the configuration.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;

use ctos::config::{App, TaskConfig};
use ctos::diagnostic::{Finding, Findings};
use nalgebra::{Isometry3, Translation3, UnitQuaternion};
use serde::Deserialize;
use serde::de::IgnoredAny;

use crate::guard::Reaction;
use crate::joints::{Distances, TooManyJoints};
use crate::model::file::{AtText, Inertias};
use crate::model::origin::Origin;
use crate::model::{Limits, Model, Placement};
use crate::servo::{ServoConfig, Settling};
use crate::trajectory::{CartesianLimits, Planner};

/// Registered name of the servo's event handler.
pub const SERVO: &str = "mcs.servo";

/// Arguments of `mcs.servo`.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ServoArgs {
    /// Registered name of the channel driver.
    pub driver: String,
    /// The driver's own arguments, read by the driver.
    #[serde(default, rename = "driver_args")]
    pub _driver_args: Option<IgnoredAny>,
    /// The arm: a model that is built in, or a file in TOML or URDF, relative to the configuration's folder.
    #[serde(default = "model")]
    pub model: String,
    /// Of a URDF, the link whose frame is the base frame; its root where none is named.
    pub base: Option<String>,
    /// The link or frame that carries the tool: of a URDF its only leaf, of another model its own tip, where none is named.
    pub tip: Option<String>,
    /// Which bodies the control law counts with. A simulated arm has those of the engine.
    #[serde(default = "inertias")]
    pub inertias: Inertias,
    /// Servo period, ms.
    #[serde(default = "period_ms")]
    pub period_ms: f64,
    /// A pose on a path of the tool is solved every so many periods, and interpolated between.
    #[serde(default = "setpoint_every")]
    pub setpoint_every: u32,
    /// Registered name of the control law.
    #[serde(default = "law")]
    pub law: String,
    /// The law's own arguments, read by the law.
    #[serde(default, rename = "law_args")]
    pub _law_args: Option<IgnoredAny>,
    /// Guards that watch its motions, by the names of their recipes.
    #[serde(default)]
    pub guards: BTreeMap<String, RecipeArgs>,
    /// Arguments of laws that it may go over to, by their names; read by the laws.
    #[serde(default, rename = "laws")]
    pub _laws: Option<IgnoredAny>,
    /// Natural frequency of the position loop, Hz.
    #[serde(default = "bandwidth_hz")]
    pub bandwidth_hz: f64,
    /// Damping ratio of the position loop.
    #[serde(default = "damping")]
    pub damping: f64,
    /// A joint that turns and is this far from its setpoint (rad) is an emergency.
    #[serde(default = "following_error_rad")]
    pub following_error_rad: f64,
    /// The same of a joint that slides, m.
    #[serde(default = "following_error_m")]
    pub following_error_m: f64,
    /// A joint that turns and is further from its setpoint than this (rad)
    #[serde(default = "following_window_rad")]
    pub following_window_rad: f64,
    /// or one that slides, than this (m),
    #[serde(default = "following_window_m")]
    pub following_window_m: f64,
    /// for this long (s) does not follow, which is a fault.
    #[serde(default = "following_timeout_s")]
    pub following_timeout_s: f64,
    /// What a slot that is no joint has read is stale after this long, s.
    #[serde(default = "slot_timeout_s")]
    pub slot_timeout_s: f64,
    /// When a motion counts as settled.
    #[serde(default)]
    pub settling: Settling,
    /// Joint speed limits, one for each joint, rad/s or m/s; at most the arm's own.
    pub velocity: Option<Vec<f64>>,
    /// Joint acceleration limits, one for each joint, rad/s^2 or m/s^2; at most the arm's own.
    pub acceleration: Option<Vec<f64>>,
    /// Registered name of the solver of inverse kinematics: `closed_form` where the arm has one, else `search`, unless it is
    /// given.
    pub inverse: Option<String>,
    /// Whether motions, stops and streams keep the limits of jerk that the model's joints have.
    #[serde(default)]
    pub limit_jerk: bool,
    /// The tool's limits on lines, arcs and arches.
    #[serde(default)]
    pub cartesian: CartesianLimits,
    /// Origin of the tool in the frame of the tip, m.
    #[serde(default)]
    pub tool_xyz: [f64; 3],
    /// Orientation of the tool in the frame of the tip: roll, pitch and yaw about x, y and z, rad.
    #[serde(default)]
    pub tool_rpy: [f64; 3],
    /// Where viewers see its base frame, when that is not the frame of the scene.
    pub stands: Option<StandsArgs>,
    /// The frames in whose axes its force-torque sensors read, by their names, for viewers; that of its last link where none is named.
    #[serde(default)]
    pub sensor_frames: BTreeMap<String, String>,
}

/// Where the base frame of an arm is seen.
#[derive(Debug, Clone, Default, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct StandsArgs {
    /// The servo's task of the arm that carries it, on the same chassis; none: it stands in the room.
    pub on: Option<String>,
    /// The frame of that arm; its tip where none is named.
    pub frame: Option<String>,
    /// Where the base frame is in that frame, or in the room.
    #[serde(default)]
    pub at: AtText,
}

/// The recipe of a guard.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RecipeArgs {
    /// Registered name of its kind.
    pub kind: String,
    /// Whether it watches motions that do not name it.
    #[serde(default = "always")]
    pub always: bool,
    /// What happens when it finds something.
    #[serde(default)]
    pub reaction: Reaction,
    /// The kind's own arguments, read by the kind.
    #[serde(default, rename = "args")]
    pub _args: Option<IgnoredAny>,
}

fn always() -> bool {
    true
}

/// Above a twentieth of the servo rate the sampled loop comes near its limit of stability.
pub fn most_bandwidth_hz(period: Duration) -> f64 {
    0.05 / period.as_secs_f64()
}

fn model() -> String {
    "puma560".to_owned()
}

fn inertias() -> Inertias {
    Inertias::Engine
}

fn law() -> String {
    "pid".to_owned()
}

fn period_ms() -> f64 {
    4.5
}

fn setpoint_every() -> u32 {
    4
}

fn bandwidth_hz() -> f64 {
    8.0
}

fn damping() -> f64 {
    1.0
}

fn following_error_rad() -> f64 {
    0.1
}

fn following_error_m() -> f64 {
    0.05
}

fn following_window_rad() -> f64 {
    0.03
}

fn following_window_m() -> f64 {
    0.015
}

fn following_timeout_s() -> f64 {
    0.1
}

fn slot_timeout_s() -> f64 {
    0.1
}

impl ServoArgs {
    /// Reads the arguments, checks every number and makes the arm; all findings at once.
    pub fn read(task: &TaskConfig, app: &App, findings: &mut Findings) -> Option<(Self, Model)> {
        let args: Self = findings.keep(task.args.parse())?;
        let model = args.check(task, app, findings)?;
        Some((args, model))
    }

    /// Checks every number; the arm with the limits and the tool given, when all are sound.
    pub fn check(&self, task: &TaskConfig, app: &App, findings: &mut Findings) -> Option<Model> {
        let sound = self.check_numbers(task, findings);
        let model = self.load(task, app, findings)?;
        let velocity = (&self.velocity, "velocity");
        let fast = check_limits(task, &model, velocity, |limit| limit.velocity, findings);
        let acceleration = (&self.acceleration, "acceleration");
        let hard = check_limits(
            task,
            &model,
            acceleration,
            |limit| limit.acceleration,
            findings,
        );
        if !(sound && fast && hard) {
            return None;
        }
        let limited = model.with_joints(|index, joint| {
            let given = |values: &Option<Vec<f64>>| values.as_ref()?.get(index).copied();
            let limits = &mut joint.limits;
            limits.velocity = given(&self.velocity).unwrap_or(limits.velocity);
            limits.acceleration = given(&self.acceleration).unwrap_or(limits.acceleration);
        });
        Some(limited.with_tool(&Placement::from(&self.tool())))
    }

    /// The arm as it is described.
    fn load(&self, task: &TaskConfig, app: &App, findings: &mut Findings) -> Option<Model> {
        let at = |key: &str| task.args.locate(key).unwrap_or_else(|| task.place.clone());
        let place = at("model");
        let mut origin = Origin::named(&self.model);
        if let Origin::Toml(path) | Origin::Urdf(path) = &mut origin {
            if let Err(finding) = app.read(&*path) {
                findings.push(finding.at(place));
                return None;
            }
            *path = app.file_at(&*path);
        }
        let (base, tip) = (self.base.as_deref(), self.tip.as_deref());
        if base.is_some() && !matches!(origin, Origin::Urdf(_)) {
            let text = format!("`base` is of a URDF, and `{}` is none", self.model);
            let finding = Finding::error("mcs::servo::base", text).at(at("base"));
            findings.push(finding.help("leave it out"));
            return None;
        }
        let loaded = match origin.load(base, tip, self.inertias) {
            Ok(loaded) => loaded,
            Err(wrong) => {
                for finding in wrong.into_sorted() {
                    // What has no place in a file is wrong in the arguments.
                    let placed = finding.place.is_some();
                    findings.push(match placed {
                        true => finding,
                        false => finding.at(place.clone()),
                    });
                }
                return None;
            }
        };
        if let Err(error) = TooManyJoints::check(loaded.model.dof()) {
            findings.push(Finding::error("mcs::servo::joints", error.to_string()).at(place));
            return None;
        }
        for warning in loaded.warnings {
            findings.push(warning);
        }
        Some(loaded.model)
    }

    fn check_numbers(&self, task: &TaskConfig, findings: &mut Findings) -> bool {
        let mut sound = true;
        let mut within = |key: &str, value: f64, low: f64, high: f64| {
            if !(low..=high).contains(&value) {
                sound = false;
                let text = format!("`{key}` is {value}");
                let place = task.args.locate(key).unwrap_or_else(|| task.place.clone());
                let help = format!("give a value from {low} to {high}");
                let finding = Finding::error("mcs::out_of_range", text);
                findings.push(finding.at(place).help(help));
            }
        };
        within("period_ms", self.period_ms, 0.1, 100.0);
        within("setpoint_every", f64::from(self.setpoint_every), 1.0, 100.0);
        within("damping", self.damping, 0.1, 5.0);
        within("following_error_rad", self.following_error_rad, 1e-4, 3.2);
        within("following_error_m", self.following_error_m, 1e-4, 3.2);
        within("following_window_rad", self.following_window_rad, 1e-4, 3.2);
        within("following_window_m", self.following_window_m, 1e-4, 3.2);
        within("following_timeout_s", self.following_timeout_s, 0.0, 10.0);
        within("slot_timeout_s", self.slot_timeout_s, 1e-3, 60.0);
        let top = most_bandwidth_hz(Duration::from_secs_f64(
            self.period_ms.clamp(0.1, 1e3) / 1e3,
        ));
        within("bandwidth_hz", self.bandwidth_hz, 0.1, top);
        within("settling.error", self.settling.error, 1e-6, 1.0);
        within("settling.speed", self.settling.speed, 1e-6, 10.0);
        within(
            "settling.patience",
            f64::from(self.settling.patience),
            1.0,
            1e5,
        );
        let line = &self.cartesian;
        within("cartesian.linear_speed", line.linear_speed, 1e-3, 10.0);
        within(
            "cartesian.linear_acceleration",
            line.linear_acceleration,
            1e-3,
            100.0,
        );
        within("cartesian.angular_speed", line.angular_speed, 1e-3, 50.0);
        within(
            "cartesian.angular_acceleration",
            line.angular_acceleration,
            1e-3,
            500.0,
        );
        for value in self.tool_xyz {
            within("tool_xyz", value, -2.0, 2.0);
        }
        for value in self.tool_rpy {
            within("tool_rpy", value, -7.0, 7.0);
        }
        sound
    }

    /// Rates and limits of the servo.
    #[must_use]
    pub fn config(&self) -> ServoConfig {
        ServoConfig {
            period: Duration::from_secs_f64(self.period_ms / 1000.0),
            setpoint_every: self.setpoint_every,
            following_error: Distances {
                turning: self.following_error_rad,
                sliding: self.following_error_m,
            },
            following_window: Distances {
                turning: self.following_window_rad,
                sliding: self.following_window_m,
            },
            following_timeout: Duration::from_secs_f64(self.following_timeout_s),
            settling: self.settling,
            stale_after: Duration::from_secs_f64(self.slot_timeout_s),
            limit_jerk: self.limit_jerk,
        }
    }

    /// `tip_t_tool`.
    fn tool(&self) -> Isometry3<f64> {
        let [x, y, z] = self.tool_xyz;
        let [roll, pitch, yaw] = self.tool_rpy;
        Isometry3::from_parts(
            Translation3::new(x, y, z),
            UnitQuaternion::from_euler_angles(roll, pitch, yaw),
        )
    }
}

/// Checks that every joint has a limit of its own or a given one, the given ones being no higher; whether that is so.
fn check_limits(
    task: &TaskConfig,
    model: &Model,
    (given, key): (&Option<Vec<f64>>, &str),
    own: fn(&Limits) -> f64,
    findings: &mut Findings,
) -> bool {
    let place = task.args.locate(key).unwrap_or_else(|| task.place.clone());
    let mut refuse = |code: &'static str, text: String, help: String| {
        findings.push(Finding::error(code, text).at(place.clone()).help(help));
        false
    };
    let needed = model.dof();
    if let Some(values) = given
        && values.len() != needed
    {
        let text = format!("`{key}` has {} numbers", values.len());
        let name = model.name();
        let help = format!("give one for each of the {needed} joints of `{name}`");
        return refuse("mcs::servo::count", text, help);
    }
    let mut sound = true;
    for (index, joint) in model.joints().iter().enumerate() {
        let most = own(&joint.limits);
        match given.as_ref().and_then(|values| values.get(index)) {
            Some(value) if !(1e-3..=most).contains(value) || value.is_infinite() => {
                let text = format!("`{key}` is {value} for joint {}", index + 1);
                let help = format!("give a value from 0.001 to {most}");
                sound = refuse("mcs::out_of_range", text, help);
            }
            None if most <= 0.0 || most.is_infinite() => {
                let text = format!("joint `{}` has no largest {key}", joint.name);
                let help = format!(
                    "write `{key}` with one number for each joint, or limit it in its model"
                );
                sound = refuse("mcs::servo::limit", text, help);
            }
            _ => {}
        }
    }
    sound
}

/// The manipulator of the first servo task of `app`, its tool the tip, for those that check goals before anything runs.
/// None also when that task's arguments are wrong, which its own check reports.
#[must_use]
pub fn manipulator(app: &App) -> Option<Model> {
    let servo = app.tasks.iter().find(|task| task.handler == SERVO)?;
    let (_, model) = ServoArgs::read(servo, app, &mut Findings::new())?;
    Some(model)
}

/// A planner for the arm of a servo task, with its limits and its period, for whoever plans without one. Inverse kinematics is that of
/// the arm, also where the task names another. None when the task's arguments are wrong, which its own check reports.
#[must_use]
pub fn planner(task: &TaskConfig, app: &App) -> Option<Planner> {
    let (args, model) = ServoArgs::read(task, app, &mut Findings::new())?;
    let config = args.config();
    let period = config.period.as_secs_f64() * f64::from(config.setpoint_every);
    let planner = Planner::new(Arc::new(model), args.cartesian, period).ok()?;
    Some(planner.limiting_jerk(args.limit_jerk))
}

/// The arm of a servo task as it is described, for its channel driver: a limit of its own counts, also where the task sets
/// a lower one. None when the task's arguments are wrong, which its own check reports.
#[must_use]
pub fn arm(task: &TaskConfig, app: &App) -> Option<Model> {
    let args: ServoArgs = task.args.parse().ok()?;
    let model = args.load(task, app, &mut Findings::new())?;
    Some(model.with_joints(|index, joint| {
        let velocity = &mut joint.limits.velocity;
        let given = args.velocity.as_ref().and_then(|all| all.get(index));
        if let (true, Some(given)) = (velocity.is_infinite(), given) {
            *velocity = *given;
        }
    }))
}
