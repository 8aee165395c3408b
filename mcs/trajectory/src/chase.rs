//! A joint that goes after what moves, within its limits: the speed of the next period. Knows no arm and no stream.
//!
//! The speed is the largest one from which the joint can still brake to rest, at its acceleration limit and in whole periods,
//! beside what it goes after: the discrete form of a time-optimal course, without overshoot and without chatter (R. Zanasi,
//! C. Guarino Lo Bianco and A. Tonielli, Nonlinear filters for the generation of smooth trajectories, Automatica 36, 2000).

use mcs_model::Limits;

/// The speed at the end of the next `period` with which a joint that goes at `speed` gets over a `gap` soonest and rests
/// there, braking no harder than `acceleration`. It may ask for a quicker change of the speed than that; the caller holds it.
///
/// From `m` whole steps of speed and a rest `r` of one, braking takes `m^2 / 2 + (m + 1/2) r` steps times the period.
fn approach(gap: f64, speed: f64, acceleration: f64, period: f64) -> f64 {
    if gap < 0.0 {
        return -approach(-gap, -speed, acceleration, period);
    }
    if gap.is_infinite() {
        return gap;
    }
    let step = acceleration * period;
    let room = (gap / period - 0.5 * speed) / step;
    if room <= 0.0 {
        return room * step;
    }
    let whole = (0.5 * ((1.0 + 8.0 * room).sqrt() - 1.0)).floor();
    step * (room / (whole + 1.0) + 0.5 * whole)
}

/// The speed after the next `period` (s) of a joint at `position` with `speed` that goes after `aim`, a position and a speed:
/// at most the fraction `pace` of the largest speed and acceleration in `limits`. It rests before a limit of its position.
#[must_use]
pub fn chase(
    (position, speed): (f64, f64),
    (aim, aim_speed): (f64, f64),
    limits: &Limits,
    pace: (f64, f64),
    period: f64,
) -> f64 {
    let (fastest, hardest) = (limits.velocity * pace.0, limits.acceleration * pace.1);
    let step = hardest * period;
    let wanted = aim_speed + approach(aim - position, speed - aim_speed, hardest, period);
    let up = approach(limits.upper - position, speed, hardest, period);
    let down = -approach(position - limits.lower, -speed, hardest, period);
    wanted
        .min(fastest)
        .max(-fastest)
        .min(up)
        .max(down)
        .max(speed - step)
        .min(speed + step)
}

/// The speed after the next `period` (s) of a joint that brakes as hard as it may.
#[must_use]
pub fn brake(speed: f64, limits: &Limits, period: f64) -> f64 {
    let step = limits.acceleration * period;
    speed - speed.clamp(-step, step)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const PERIOD: f64 = 0.0045;

    fn limits() -> Limits {
        Limits {
            lower: -1.0,
            upper: 1.5,
            velocity: 2.0,
            acceleration: 8.0,
            ..Limits::NONE
        }
    }

    /// So many periods towards what stands there: each position and speed.
    fn run(from: f64, aims: &[f64], pace: (f64, f64)) -> Vec<(f64, f64)> {
        let (mut position, mut speed) = (from, 0.0);
        let each = aims.iter().map(|aim| {
            let next = chase((position, speed), (*aim, 0.0), &limits(), pace, PERIOD);
            position += 0.5 * (speed + next) * PERIOD;
            speed = next;
            (position, speed)
        });
        each.collect()
    }

    #[test]
    fn a_jump_is_made_in_the_time_of_a_trapezoid_and_without_overshoot() {
        let passed = run(0.0, &[1.0; 400], (1.0, 1.0));
        // 1 / 2 s at full speed, and 2 / 8 s for both ends: 0.75 s.
        let there = passed.iter().position(|(at, _)| (at - 1.0).abs() < 1e-9);
        let periods = there.unwrap() as f64;
        assert!((periods * PERIOD - 0.75).abs() < 3.0 * PERIOD, "{periods}");
        assert!(passed.iter().all(|(at, _)| *at < 1.0 + 1e-9));
        // It rests there.
        assert!(passed[399].1.abs() < 1e-12);
    }

    #[test]
    fn what_moves_evenly_is_caught_and_kept() {
        let (mut position, mut speed) = (0.3, 0.0);
        for tick in 0..400 {
            let aim = -0.8 + 0.9 * f64::from(tick) * PERIOD;
            let next = chase((position, speed), (aim, 0.9), &limits(), (1.0, 1.0), PERIOD);
            position += 0.5 * (speed + next) * PERIOD;
            speed = next;
            if tick > 300 {
                let off = position - aim - 0.9 * PERIOD;
                assert!(off.abs() < 1e-9, "tick {tick}: {off}");
            }
        }
    }

    proptest! {
        #[test]
        fn whatever_it_goes_after_no_limit_is_passed(
            from in -1.0..1.5_f64,
            aims in prop::collection::vec(-3.0..3.0_f64, 1..200),
            hold in 1..30_usize,
            pace in (0.05..1.0_f64, 0.05..1.0_f64),
        ) {
            let aims: Vec<f64> = aims.into_iter().flat_map(|aim| std::iter::repeat_n(aim, hold)).collect();
            let limits = limits();
            let mut before = 0.0;
            for (position, speed) in run(from, &aims, pace) {
                prop_assert!(speed.abs() <= limits.velocity * pace.0 + 1e-9);
                prop_assert!((speed - before).abs() <= limits.acceleration * pace.1 * PERIOD + 1e-9);
                prop_assert!(position <= limits.upper + 1e-9 && position >= limits.lower - 1e-9);
                before = speed;
            }
        }
    }
}
