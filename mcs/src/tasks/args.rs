//! Arguments of the MCS tasks, as they stand in the configuration.

use std::time::Duration;

use ctos::config::{App, TaskConfig};
use ctos::diagnostic::{Finding, Findings};
use nalgebra::{Isometry3, Translation3, UnitQuaternion};
use serde::Deserialize;
use serde::de::IgnoredAny;

use crate::arm::{ArmModel, JointLimits, Joints};
use crate::servo::{ServoConfig, Settling};
use crate::trajectory::CartesianLimits;

use super::SERVO;

/// Which control law.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Law {
    /// PID with gravity compensation.
    #[default]
    Pid,
    /// Computed torque.
    ComputedTorque,
}

/// Arguments of `mcs.servo`.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ServoArgs {
    /// Registered name of the channel driver.
    pub driver: String,
    /// The driver's own arguments, read by the driver.
    #[serde(default, rename = "driver_args")]
    pub _driver_args: Option<IgnoredAny>,
    /// Servo period, ms.
    #[serde(default = "period_ms")]
    pub period_ms: f64,
    /// The planner gives a setpoint every so many periods.
    #[serde(default = "setpoint_every")]
    pub setpoint_every: u32,
    /// The control law.
    #[serde(default)]
    pub law: Law,
    /// Natural frequency of the position loop, Hz.
    #[serde(default = "bandwidth_hz")]
    pub bandwidth_hz: f64,
    /// Damping ratio of the position loop.
    #[serde(default = "damping")]
    pub damping: f64,
    /// A joint this far from its setpoint (rad) is an emergency.
    #[serde(default = "following_error_rad")]
    pub following_error_rad: f64,
    /// A joint further from its setpoint than this (rad)
    #[serde(default = "following_window_rad")]
    pub following_window_rad: f64,
    /// for this long (s) does not follow, which is a fault.
    #[serde(default = "following_timeout_s")]
    pub following_timeout_s: f64,
    /// When a motion counts as settled.
    #[serde(default)]
    pub settling: Settling,
    /// Joint speed limits, rad/s; at most the arm's own.
    pub velocity: Option<Joints>,
    /// Joint acceleration limits, rad/s^2; at most the arm's own.
    pub acceleration: Option<Joints>,
    /// Tool speeds on straight lines.
    #[serde(default)]
    pub cartesian: CartesianLimits,
    /// Origin of the tool in frame 6, m.
    #[serde(default)]
    pub tool_xyz: [f64; 3],
    /// Orientation of the tool in frame 6: roll, pitch and yaw about x, y and z, rad.
    #[serde(default)]
    pub tool_rpy: [f64; 3],
}

/// Above a twentieth of the servo rate the sampled loop comes near its limit of stability.
pub(super) fn most_bandwidth_hz(period: Duration) -> f64 {
    0.05 / period.as_secs_f64()
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

fn following_window_rad() -> f64 {
    0.03
}

fn following_timeout_s() -> f64 {
    0.1
}

impl ServoArgs {
    /// Reads the arguments and checks every number, all findings at once.
    pub fn read(task: &TaskConfig, findings: &mut Findings) -> Option<Self> {
        let args: Self = findings.keep(task.args.parse())?;
        args.check(task, findings).then_some(args)
    }

    /// Checks every number; whether all are sound.
    pub(super) fn check(&self, task: &TaskConfig, findings: &mut Findings) -> bool {
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
        within("following_window_rad", self.following_window_rad, 1e-4, 3.2);
        within("following_timeout_s", self.following_timeout_s, 0.0, 10.0);
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
        let arm = ArmModel::puma560();
        let mut limited = |key: &str, values: &Option<Joints>, most: fn(&JointLimits) -> f64| {
            let values = values.iter().flatten();
            for (value, limit) in values.zip(&arm.limits) {
                within(key, *value, 1e-3, most(limit));
            }
        };
        limited("velocity", &self.velocity, |limit| limit.velocity);
        limited("acceleration", &self.acceleration, |limit| {
            limit.acceleration
        });
        sound
    }

    /// The arm with the limits given.
    #[must_use]
    pub fn model(&self) -> ArmModel {
        let mut model = ArmModel::puma560();
        for (index, limit) in model.limits.iter_mut().enumerate() {
            if let Some(velocity) = &self.velocity {
                limit.velocity = velocity[index];
            }
            if let Some(acceleration) = &self.acceleration {
                limit.acceleration = acceleration[index];
            }
        }
        model
    }

    /// Rates and limits of the servo.
    #[must_use]
    pub fn config(&self) -> ServoConfig {
        ServoConfig {
            period: Duration::from_secs_f64(self.period_ms / 1000.0),
            setpoint_every: self.setpoint_every,
            following_error: self.following_error_rad,
            following_window: self.following_window_rad,
            following_timeout: Duration::from_secs_f64(self.following_timeout_s),
            settling: self.settling,
        }
    }

    /// `frame6_t_tool`.
    #[must_use]
    pub fn tool(&self) -> Isometry3<f64> {
        let [x, y, z] = self.tool_xyz;
        let [roll, pitch, yaw] = self.tool_rpy;
        Isometry3::from_parts(
            Translation3::new(x, y, z),
            UnitQuaternion::from_euler_angles(roll, pitch, yaw),
        )
    }
}

/// What an app says of its manipulator, for those that check goals before anything runs.
#[derive(Debug, Clone)]
pub struct Manipulator {
    /// The arm with the limits given.
    pub arm: ArmModel,
    /// `frame6_t_tool`.
    pub tool: Isometry3<f64>,
}

impl Manipulator {
    /// The manipulator of the first servo task of `app`. None also when that task's arguments are
    /// wrong, which its own check reports.
    #[must_use]
    pub fn of(app: &App) -> Option<Self> {
        let servo = app.tasks.iter().find(|task| task.handler == SERVO)?;
        let args = ServoArgs::read(servo, &mut Findings::new())?;
        Some(Self {
            arm: args.model(),
            tool: args.tool(),
        })
    }
}

/// Arguments of `mcs.state` and `mcs.planner`.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PartArgs {
    /// Name of the servo task, on the same chassis.
    pub servo: String,
}

/// Arguments of `mcs.client`.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ClientArgs {
    /// Name of the servo task.
    pub servo: String,
    /// Name of the state manager's task.
    pub state: String,
    /// Name of the planner's task.
    pub planner: String,
}
