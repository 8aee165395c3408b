//! The alpha-beta-gamma filter of one axis: position, velocity and acceleration from measurements of the position
//! (P. Kalata, The tracking index, IEEE Transactions on Aerospace and Electronic Systems, 1984).
//!
//! The manoeuvring index is L = σ_w T² / σ_v: the standard deviation σ_w of the change of the acceleration from one
//! measurement to the next, the period T, and the standard deviation σ_v of a measurement. From it follow the gains of the
//! steady state, with γ²/(1-α) = L², β = 2(2-α) - 4√(1-α) and γ = β²/(2α).

/// Gains of the filter. A correction by the residual r adds α r to the position, β r/T to the velocity and γ r/T² to the
/// acceleration.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Gains {
    /// Of the position, in (0, 1).
    pub alpha: f64,
    /// Of the velocity.
    pub beta: f64,
    /// Of the acceleration.
    pub gamma: f64,
}

impl Gains {
    /// The gains of the steady state for a manoeuvring index; `None` unless it is finite and above 0.
    #[must_use]
    pub fn of(index: f64) -> Option<Self> {
        if !(index.is_finite() && index > 0.0) {
            return None;
        }
        // With u = 1 - √(1-α), Kalata's cubic is u³ = L/2 (1-u)(2-u). The left side grows and the right one falls, so
        // there is one root in (0, 1), and in this form nothing cancels for small L.
        let half = 0.5 * index;
        let (mut low, mut high) = (0.0_f64, 1.0_f64);
        loop {
            let u = 0.5 * (low + high);
            if u <= low || u >= high {
                break;
            }
            if u.powi(3) < half * (1.0 - u) * (2.0 - u) {
                low = u;
            } else {
                high = u;
            }
        }
        let u = high;
        let (alpha, beta) = (u * (2.0 - u), 2.0 * u * u);
        Some(Self {
            alpha,
            beta,
            gamma: beta * beta / (2.0 * alpha),
        })
    }
}

/// What is known of one axis.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Track {
    /// Position.
    pub x: f64,
    /// Velocity, per s.
    pub v: f64,
    /// Acceleration, per s².
    pub a: f64,
}

impl Track {
    /// At rest at the first measurement.
    #[must_use]
    pub fn at_rest(x: f64) -> Self {
        Self { x, v: 0.0, a: 0.0 }
    }

    /// Where it is after `dt` s of constant acceleration.
    #[must_use]
    pub fn predicted(self, dt: f64) -> Self {
        Self {
            x: self.x + dt * (self.v + 0.5 * dt * self.a),
            v: self.v + dt * self.a,
            a: self.a,
        }
    }

    /// What a measurement makes of a prediction over `dt` s.
    #[must_use]
    pub fn corrected(self, measured: f64, gains: Gains, dt: f64) -> Self {
        let residual = measured - self.x;
        Self {
            x: self.x + gains.alpha * residual,
            v: self.v + gains.beta / dt * residual,
            a: self.a + gains.gamma / (dt * dt) * residual,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Matrix3, RowVector3, Vector3};
    use proptest::prelude::*;

    /// The steady gain of a Kalman filter whose acceleration takes a random step each period, by iterating Riccati's
    /// equation: nothing of it is in the formulas above.
    fn riccati(index: f64) -> Vector3<f64> {
        let step = Matrix3::new(1.0, 1.0, 0.5, 0.0, 1.0, 1.0, 0.0, 0.0, 1.0);
        let kick = Vector3::new(0.5, 1.0, 1.0);
        let see = RowVector3::new(1.0, 0.0, 0.0);
        let noise = kick * kick.transpose() * (index * index);
        let mut spread = Matrix3::identity() * (1.0 + index * index);
        let mut gain = Vector3::zeros();
        for _ in 0..200_000 {
            let before = step * spread * step.transpose() + noise;
            let next = before * see.transpose() / (before[(0, 0)] + 1.0);
            spread = (Matrix3::identity() - next * see) * before;
            spread = (spread + spread.transpose()) * 0.5;
            let still = (next - gain).abs().max() < 1e-15;
            gain = next;
            if still {
                break;
            }
        }
        gain
    }

    #[test]
    fn the_gains_are_those_of_the_steady_kalman_filter() {
        for index in [1e-3, 0.01, 0.1, 0.5, 1.0, 3.0, 20.0, 25.0, 100.0] {
            let gains = Gains::of(index).unwrap();
            let kalman = riccati(index);
            let ours = [gains.alpha, gains.beta, gains.gamma];
            for (ours, theirs) in ours.iter().zip(kalman.iter()) {
                assert!(
                    (ours - theirs).abs() < 1e-7 * (1.0 + theirs),
                    "{index}: {gains:?} {kalman}"
                );
            }
        }
    }

    proptest! {
        #[test]
        fn the_gains_satisfy_kalatas_equations(exponent in -8.0..6.0_f64) {
            let index = 10_f64.powf(exponent);
            let Gains { alpha, beta, gamma } = Gains::of(index).unwrap();
            prop_assert!(alpha > 0.0 && alpha <= 1.0);
            prop_assert!((gamma * gamma - index * index * (1.0 - alpha)).abs() <= 1e-9 * gamma * gamma.max(1.0) * (1.0 + index * index * 1e-6));
            prop_assert!((beta - (2.0 * (2.0 - alpha) - 4.0 * (1.0 - alpha).sqrt())).abs() < 1e-7);
        }
    }

    #[test]
    fn what_is_no_index_has_no_gains() {
        for index in [0.0, -1.0, f64::NAN, f64::INFINITY] {
            assert_eq!(Gains::of(index), None);
        }
    }

    #[test]
    fn a_parabola_is_followed_without_an_error_after_the_first_measurements() {
        let gains = Gains::of(1.0).unwrap();
        let at = |t: f64| 3.0 - 2.0 * t + 0.5 * 4.0 * t * t;
        let mut track = Track::at_rest(at(0.0));
        for step in 1..400 {
            let t = f64::from(step) * 0.1;
            track = track.predicted(0.1).corrected(at(t), gains, 0.1);
        }
        let end = 39.9;
        assert!((track.x - at(end)).abs() < 1e-9);
        assert!((track.v - (-2.0 + 4.0 * end)).abs() < 1e-9);
        assert!((track.a - 4.0).abs() < 1e-9);
    }
}
