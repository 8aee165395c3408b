//! Servo-rate setpoints between those of the planner, which come at a multiple of the servo period.
//!
//! Between two planned setpoints each joint follows the cubic through both positions and velocities.
//! Running ahead from the last setpoint alone would step in position wherever the acceleration changes
//! within the interval; the cubic is continuous in position and velocity for any multiple, and
//! exact wherever the acceleration is constant.

use super::Setpoint;

/// A cubic between two setpoints.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Interpolator {
    from: Setpoint,
    to: Setpoint,
    interval: f64,
}

impl Interpolator {
    /// From one setpoint to another, `interval` seconds (above zero) later.
    #[must_use]
    pub fn new(from: Setpoint, to: Setpoint, interval: f64) -> Self {
        Self { from, to, interval }
    }

    /// The setpoint at the end of the interval.
    #[must_use]
    pub fn end(&self) -> &Setpoint {
        &self.to
    }

    /// The setpoint `t` seconds after the first one.
    #[must_use]
    pub fn at(&self, t: f64) -> Setpoint {
        if t <= 0.0 {
            return self.from;
        }
        if t >= self.interval {
            return self.to;
        }
        let h = self.interval;
        let x = t / h;
        let mut setpoint = self.from;
        for index in 0..self.from.position.len() {
            let (p0, v0) = (self.from.position[index], self.from.velocity[index]);
            let (p1, v1) = (self.to.position[index], self.to.velocity[index]);
            let way = p1 - p0;
            let square = (3.0 * way - h * (2.0 * v0 + v1)) / (h * h);
            let cube = (h * (v0 + v1) - 2.0 * way) / (h * h);
            setpoint.position[index] = p0 + t * (v0 + t * (square + cube * x));
            setpoint.velocity[index] = v0 + t * (2.0 * square + 3.0 * cube * x);
            setpoint.acceleration[index] = 2.0 * square + 6.0 * cube * x;
        }
        setpoint
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn motion_under_constant_acceleration_is_reproduced_exactly(
            p in -3.0..3.0_f64, v in -5.0..5.0_f64, a in -20.0..20.0_f64, share in 0.0..1.0_f64,
        ) {
            let h = 0.018;
            let at = |t: f64| Setpoint {
                position: [p + t * (v + 0.5 * a * t); 6].into(),
                velocity: [v + a * t; 6].into(),
                acceleration: [a; 6].into(),
            };
            let found = Interpolator::new(at(0.0), at(h), h).at(share * h);
            let expected = at(share * h);
            prop_assert!((found.position[0] - expected.position[0]).abs() < 1e-12);
            prop_assert!((found.velocity[3] - expected.velocity[3]).abs() < 1e-10);
            prop_assert!((found.acceleration[5] - expected.acceleration[5]).abs() < 1e-7);
        }
    }
}
