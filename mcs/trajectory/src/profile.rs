//! Speed over time along a path of given length: the trapezoid, and braking to rest.

/// Position along a path and its derivatives by time.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct ProfilePoint {
    /// Position along the path, in the unit of the path's length.
    pub position: f64,
    /// Speed, unit/s.
    pub speed: f64,
    /// Acceleration, unit/s^2.
    pub acceleration: f64,
}

/// Motion along a path: accelerate, cruise, brake. Also holds the braking that follows an interrupted
/// motion (no acceleration, no cruise).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Profile {
    start: f64,
    end: f64,
    /// Speed at time zero; zero but for braking.
    start_speed: f64,
    peak_speed: f64,
    acceleration: f64,
    ramp: f64,
    cruise: f64,
    brake: f64,
}

impl Profile {
    /// Rest to rest over `length` with at most `speed` (unit/s) and `acceleration` (unit/s^2), in the
    /// least time. `length` is at least zero, both limits are above zero; [`super::Planner`] is
    /// the one who makes sure.
    #[must_use]
    pub fn trapezoid(length: f64, speed: f64, acceleration: f64) -> Self {
        let peak_speed = speed.min((length * acceleration).sqrt());
        let ramp = peak_speed / acceleration;
        let cruise = if peak_speed > 0.0 {
            (length / peak_speed - ramp).max(0.0)
        } else {
            0.0
        };
        Self {
            start: 0.0,
            end: length,
            start_speed: 0.0,
            peak_speed,
            acceleration,
            ramp,
            cruise,
            brake: ramp,
        }
    }

    /// From `position` at `speed` (unit/s, at least zero) to rest with constant `deceleration`
    /// (unit/s^2, above zero).
    #[must_use]
    pub fn braking(position: f64, speed: f64, deceleration: f64) -> Self {
        let brake = speed / deceleration;
        Self {
            start: position,
            end: position + 0.5 * speed * brake,
            start_speed: speed,
            peak_speed: speed,
            acceleration: deceleration,
            ramp: 0.0,
            cruise: 0.0,
            brake,
        }
    }

    /// Time from start to rest, s.
    #[must_use]
    pub fn duration(&self) -> f64 {
        self.ramp + self.cruise + self.brake
    }

    /// Position along the path at the end.
    #[must_use]
    pub fn end(&self) -> f64 {
        self.end
    }

    /// Times (s) at which the acceleration jumps, besides start and end.
    #[must_use]
    pub fn corners(&self) -> [f64; 2] {
        [self.ramp, self.ramp + self.cruise]
    }

    /// Where the motion is at time `t` (s); before the start and after the end it rests, exactly at
    /// the ends.
    #[must_use]
    pub fn at(&self, t: f64) -> ProfilePoint {
        let left = self.duration() - t;
        if left <= 0.0 {
            return ProfilePoint {
                position: self.end,
                ..ProfilePoint::default()
            };
        }
        if t < 0.0 {
            return ProfilePoint {
                position: self.start,
                speed: self.start_speed,
                acceleration: 0.0,
            };
        }
        if t < self.ramp {
            return ProfilePoint {
                position: self.start + 0.5 * self.acceleration * t * t,
                speed: self.acceleration * t,
                acceleration: self.acceleration,
            };
        }
        if left > self.brake {
            let ramp_length = 0.5 * self.acceleration * self.ramp * self.ramp;
            return ProfilePoint {
                position: self.start + ramp_length + self.peak_speed * (t - self.ramp),
                speed: self.peak_speed,
                acceleration: 0.0,
            };
        }
        // Braking is counted backwards from the end, so that the end is exact.
        ProfilePoint {
            position: self.end - 0.5 * self.acceleration * left * left,
            speed: self.acceleration * left,
            acceleration: -self.acceleration,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn duration_is_the_closed_form(
            length in 0.0..10.0_f64, speed in 0.01..5.0_f64, acceleration in 0.1..20.0_f64,
        ) {
            let profile = Profile::trapezoid(length, speed, acceleration);
            let expected = if length >= speed * speed / acceleration {
                length / speed + speed / acceleration
            } else {
                2.0 * (length / acceleration).sqrt()
            };
            prop_assert!((profile.duration() - expected).abs() < 1e-9);
        }

        #[test]
        fn limits_hold_everywhere_and_both_ends_are_exact(
            length in 0.0..10.0_f64, speed in 0.01..5.0_f64, acceleration in 0.1..20.0_f64,
        ) {
            let profile = Profile::trapezoid(length, speed, acceleration);
            let mut previous = profile.at(0.0);
            prop_assert_eq!(previous.position, 0.0);
            for step in 1..=500_u32 {
                let t = profile.duration() * f64::from(step) / 500.0;
                let now = profile.at(t);
                prop_assert!(now.speed <= speed * (1.0 + 1e-12) && now.speed >= 0.0);
                prop_assert!(now.acceleration.abs() <= acceleration);
                let dt = profile.duration() / 500.0;
                let travelled = 0.5 * (now.speed + previous.speed) * dt;
                // Exact but in the step that holds a corner, where half a step of ramp is missed.
                prop_assert!((now.position - previous.position - travelled).abs()
                    <= 0.125 * acceleration * dt * dt + 1e-9);
                previous = now;
            }
            prop_assert_eq!(profile.at(profile.duration()).position, length);
            prop_assert_eq!(profile.at(profile.duration() + 1.0).speed, 0.0);
        }

        #[test]
        fn braking_stops_in_speed_over_deceleration(
            position in 0.0..1.0_f64, speed in 0.0..5.0_f64, deceleration in 0.1..20.0_f64,
        ) {
            let profile = Profile::braking(position, speed, deceleration);
            prop_assert!((profile.duration() - speed / deceleration).abs() < 1e-12);
            let start = profile.at(0.0);
            prop_assert!((start.position - position).abs() < 1e-9);
            prop_assert!((start.speed - speed).abs() < 1e-9);
            let expected = position + speed * speed / (2.0 * deceleration);
            prop_assert!((profile.end() - expected).abs() < 1e-9);
        }
    }

    #[test]
    fn a_motion_of_no_length_takes_no_time() {
        let profile = Profile::trapezoid(0.0, 1.0, 1.0);
        assert_eq!(profile.duration(), 0.0);
        assert_eq!(profile.at(0.0).position, 0.0);
    }
}
