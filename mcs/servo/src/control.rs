//! The motion control layer: control laws, which turn a setpoint and readings into joint torques.
//!
//! A law of one's own is one file with one type that implements [`ControlLaw`], and one name in a [`LawRegistry`].
//! Laws know the arm's model and nothing of tasks, planning or hardware.

pub mod cartesian_impedance;
pub mod computed_torque;
#[cfg(test)]
mod impedance_tests;
mod integral;
pub mod joint_impedance;
pub mod pid;
mod registry;
pub mod split_torque;

use std::time::Duration;

pub use cartesian_impedance::{CartesianImpedance, CartesianImpedanceArgs};
pub use computed_torque::ComputedTorque;
pub use joint_impedance::{JointImpedance, JointImpedanceArgs};
pub use pid::PidGravity;
pub use registry::{LawRegistry, LawSettings};
pub use split_torque::SplitTorque;

use crate::{driver::SlotReading, guard::Words, trajectory::Setpoint};

/// A control law. Called once per servo period while the brakes are released; must neither allocate,
/// lock nor wait.
pub trait ControlLaw: Send {
    /// Forgets the past: called when the brakes are about to be released, with the arm at rest.
    fn reset(&mut self, readings: &[SlotReading]);

    /// Takes other parameters: the position loop's natural frequency (Hz) and damping ratio. Called between two
    /// periods; must neither allocate, lock nor wait. A law without such parameters stays as it is.
    fn tune(&mut self, bandwidth: f64, damping: f64) {
        let _ = (bandwidth, damping);
    }

    /// Takes in what the driver's sensors read, one after the other, before [`torques`](Self::torques) of the same period. A
    /// law that asks for none does nothing with it.
    fn sense(&mut self, numbers: &[f64]) {
        let _ = numbers;
    }

    /// Why it cannot go on, after [`torques`](Self::torques): then the power is taken away.
    fn gave_up(&self) -> Option<Words> {
        None
    }

    /// Computes one torque per slot into `out` (N m, or N for a joint that slides) from the setpoint and the
    /// readings of the same instant. The servo limits the torques afterwards; a law that
    /// integrates should know the limits itself. `period` is the servo period.
    fn torques(
        &mut self,
        setpoint: &Setpoint,
        readings: &[SlotReading],
        period: Duration,
        out: &mut [f64],
    );
}
