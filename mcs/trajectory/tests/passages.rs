//! How long a passage through way points takes at least, found another way: by trying all times of its sections.
//!
//! Joints have nothing in common but these times. So whatever the times are, each joint is asked by itself whether it can be at its
//! points then, within its limits of speed and acceleration. From rest it leaves a section with any of an interval of speeds, whose
//! ends come from the hardest braking and the hardest pull. From an interval it leaves the next section with another one.

#![allow(clippy::unwrap_used, reason = "a test that cannot be set up fails")]

use mcs_model::{built_in, file::Inertias};
use mcs_trajectory::{Passage, timing::JointBounds};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

const PATHS: u32 = 12;
/// Times that are tried for each of two sections at once, and how often the search is repeated around the best.
const TRIED: u32 = 24;
const CLOSER: usize = 3;

/// Speeds, the least and the largest.
type Speeds = (f64, f64);

/// Where a joint is and how fast, after so long: it brakes for a part of the time, and gains speed in the rest.
fn braked(speed: f64, (first, time): (f64, f64), limits: &JointBounds) -> (f64, f64) {
    let (most, hard) = (limits.velocity, limits.acceleration);
    let brakes = first.min((speed + most) / hard);
    let (x, v) = (
        speed * brakes - 0.5 * hard * brakes * brakes,
        speed - hard * brakes,
    );
    let x = x + v * (first - brakes);
    let rest = time - first;
    let gains = rest.min((most - v) / hard);
    let (x, v) = (x + v * gains + 0.5 * hard * gains * gains, v + hard * gains);
    (x + v * (rest - gains), v)
}

/// The largest speed at the end of a section of length `way` (m or rad) and `time` (s) that begins with one of these speeds.
fn fastest(speeds: Speeds, way: f64, time: f64, limits: &JointBounds) -> Option<f64> {
    let (mut low, mut high) = speeds;
    // The slower it comes, the harder it may pull: the slowest that gets there at all.
    if braked(high, (0.0, time), limits).0 < way - 1e-12 {
        return None;
    }
    if braked(low, (0.0, time), limits).0 < way {
        for _ in 0..50 {
            let middle = 0.5 * (low + high);
            match braked(middle, (0.0, time), limits).0 < way {
                true => low = middle,
                false => high = middle,
            }
        }
        low = high;
    }
    if braked(low, (time, time), limits).0 > way + 1e-12 {
        return None;
    }
    let (mut less, mut more) = (0.0, time);
    for _ in 0..50 {
        let middle = 0.5 * (less + more);
        match braked(low, (middle, time), limits).0 > way {
            true => less = middle,
            false => more = middle,
        }
    }
    Some(braked(low, (less, time), limits).1)
}

/// All speeds at the end of a section.
fn leaves(speeds: Speeds, way: f64, time: f64, limits: &JointBounds) -> Option<Speeds> {
    let most = fastest(speeds, way, time, limits)?;
    let least = fastest((-speeds.1, -speeds.0), -way, time, limits)?;
    Some((-least, most))
}

/// Ways of each joint in the three sections, and its limits.
type Joint = ([f64; 3], JointBounds);

/// Whether each joint can be at all of its points at these times.
fn can(joints: &[Joint], times: [f64; 3]) -> bool {
    joints.iter().all(|(ways, limits)| {
        let Some(first) = leaves((0.0, 0.0), ways[0], times[0], limits) else {
            return false;
        };
        let second = leaves(first, ways[1], times[1], limits);
        // The last section backwards in time is one from rest.
        let third = leaves((0.0, 0.0), ways[2], times[2], limits);
        second
            .zip(third)
            .is_some_and(|(one, other)| one.0 <= other.1 && other.0 <= one.1)
    })
}

/// The least time of all, to 0.1 % or so, s; `stops` are the times of the sections with a stop at each point.
fn least(joints: &[Joint], stops: [f64; 3]) -> f64 {
    let mut best: f64 = stops.iter().sum();
    let mut at = [0.6 * stops[0], 0.6 * stops[1]];
    let mut wide = [0.6 * stops[0], 0.6 * stops[1]];
    for _ in 0..CLOSER {
        let middle = at;
        for one in 0..=TRIED {
            for other in 0..=TRIED {
                let time = |axis: usize, number: u32| {
                    middle[axis] + wide[axis] * (2.0 * f64::from(number) / f64::from(TRIED) - 1.0)
                };
                let times = [time(0, one).max(1e-6), time(1, other).max(1e-6)];
                let rest = best - times[0] - times[1];
                if rest <= 0.0 || !can(joints, [times[0], times[1], rest]) {
                    continue;
                }
                let (mut no, mut yes) = (0.0, rest);
                for _ in 0..30 {
                    let middle = 0.5 * (no + yes);
                    match can(joints, [times[0], times[1], middle]) {
                        true => yes = middle,
                        false => no = middle,
                    }
                }
                (best, at) = (times[0] + times[1] + yes, times);
            }
        }
        wide = wide.map(|wide| wide / 8.0);
    }
    best
}

/// The means over paths of a PUMA 560 through two way points in a share of each joint's range: a passage, and the least possible
/// time without a limit of jerk, as shares of the time with stops; and the passage as a share of the least.
fn of_a_puma(share: f64, with_jerk: bool) -> [f64; 3] {
    let model = built_in::model("puma560", Inertias::Identified);
    let model = model.unwrap().unwrap();
    let limits = || model.joints().iter().map(|joint| joint.limits);
    let bounds = |with_jerk: bool| -> Vec<JointBounds> {
        limits()
            .map(|limits| JointBounds::of(&limits, (1.0, 1.0), with_jerk))
            .collect()
    };
    let (own, hard) = (bounds(with_jerk), bounds(false));
    let mut random = ChaCha8Rng::seed_from_u64(11);
    let mut sums = [0.0; 3];
    for _ in 0..PATHS {
        let points: Vec<f64> = (0..4)
            .flat_map(|_| limits())
            .map(|limits| {
                let middle = 0.5 * (limits.upper + limits.lower);
                let half = 0.5 * (limits.upper - limits.lower);
                middle + share * half * random.random_range(-1.0..1.0)
            })
            .collect();
        let section = |number: usize, bounds: &[JointBounds]| {
            let ends = &points[6 * number..6 * number + 12];
            Passage::through(ends, bounds).unwrap().duration()
        };
        let times = |bounds: &[JointBounds]| [0, 1, 2].map(|number| section(number, bounds));
        let stops: f64 = times(&own).iter().sum();
        let found = Passage::through(&points, &own).unwrap().duration();
        let joints: Vec<Joint> = (0..6)
            .map(|joint| {
                let at = |number: usize| points[6 * number + joint];
                (
                    [0, 1, 2].map(|number| at(number + 1) - at(number)),
                    hard[joint],
                )
            })
            .collect();
        let least = least(&joints, times(&hard));
        for (sum, share) in sums
            .iter_mut()
            .zip([found / stops, least / stops, found / least])
        {
            *sum += share / f64::from(PATHS);
        }
    }
    sums
}

#[test]
fn one_joint_takes_at_least_what_it_takes_without_the_points_on_its_way_and_stops_where_it_turns_back()
 {
    let limits = JointBounds {
        velocity: 1.0,
        acceleration: 2.0,
        jerk: 0.0,
    };
    let stops = |ways: [f64; 3]| ways.map(|way: f64| 2.0 * (way.abs() / 2.0).sqrt() + way.abs());
    let alone = |ways: [f64; 3]| least(&[(ways, limits)], stops(ways));
    // 3 m at 1 m/s, and a ramp of 0.5 s at each end.
    let on = alone([1.0, 0.5, 1.5]);
    assert!((on - 3.5).abs() < 5e-3, "{on}");
    // There and back and there: what it would save at full speed, it would have to come back for.
    let back = alone([1.0, -1.0, 0.5]);
    let turns = [1.0, 1.0, 0.5].map(|way: f64| way + 0.5);
    assert!((back - turns.iter().sum::<f64>()).abs() < 5e-3, "{back}");
}

#[test]
fn no_passage_without_a_limit_of_jerk_takes_more_than_the_least_possible_time() {
    for share in [1.0, 0.3] {
        let [found, least, excess] = of_a_puma(share, false);
        assert!(excess < 1.003, "{share}: {excess}");
        // So 0.85 of stopping is not to be had on these ways, whoever plans them.
        assert!(least > 0.86 && found > 0.86, "{share}: {found} {least}");
    }
}

#[test]
fn with_limits_of_jerk_long_ways_take_little_more_than_without_and_short_ones_less_than_0_85_of_stopping()
 {
    // Without a limit of jerk nothing takes longer: its least time is a bound of this one, too.
    let [found, bound, excess] = of_a_puma(1.0, true);
    assert!(bound > 0.87 && excess < 1.03, "{found} {bound} {excess}");
    let [found, ..] = of_a_puma(0.3, true);
    assert!(found < 0.85, "{found}");
}
