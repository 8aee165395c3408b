//! Times against closed forms, and against the profiles integrated step by step.

use super::*;
use proptest::prelude::*;

fn bounds() -> impl Strategy<Value = JointBounds> {
    (0.1..5.0_f64, 0.5..20.0_f64, 5.0..300.0_f64).prop_map(|(velocity, acceleration, jerk)| {
        JointBounds {
            velocity,
            acceleration,
            jerk,
        }
    })
}

fn trapezoids() -> impl Strategy<Value = (f64, f64, JointBounds)> {
    let ends = (-3.0..3.0_f64, -3.0..3.0_f64);
    (ends, bounds()).prop_map(|((from, to), bounds)| {
        (
            from,
            to,
            JointBounds {
                jerk: 0.0,
                ..bounds
            },
        )
    })
}

fn at(position: f64) -> JointState {
    JointState {
        position,
        ..JointState::default()
    }
}

/// The least time from rest to rest with a limit of jerk, by bisection of the speed reached: an independent way.
fn jerk_limited(way: f64, bounds: &JointBounds) -> f64 {
    let JointBounds {
        velocity: v,
        acceleration: a,
        jerk: j,
    } = *bounds;
    // Time and way to reach speed `peak` from rest.
    let ramp = |peak: f64| {
        let time = if peak * j >= a * a {
            peak / a + a / j
        } else {
            2.0 * (peak / j).sqrt()
        };
        (time, 0.5 * peak * time)
    };
    let (time, half) = ramp(v);
    if 2.0 * half <= way {
        return 2.0 * time + (way - 2.0 * half) / v;
    }
    let (mut low, mut high) = (0.0, v);
    for _ in 0..200 {
        let middle = 0.5 * (low + high);
        if 2.0 * ramp(middle).1 < way {
            low = middle;
        } else {
            high = middle;
        }
    }
    2.0 * ramp(low).0
}

proptest! {
    #[test]
    fn trapezoids_take_the_closed_forms_time_and_all_together_the_slowest_ones(
        joints in prop::collection::vec(trapezoids(), 1..9),
    ) {
        let motions: Vec<Motion> = joints.iter().map(|(from, to, bounds)| (at(*from), at(*to), *bounds)).collect();
        let times = between(&motions).unwrap();
        let mut slowest = 0.0_f64;
        for ((from, to, bounds), least) in joints.iter().zip(&times.least) {
            let (way, v, a) = ((to - from).abs(), bounds.velocity, bounds.acceleration);
            let closed = if way >= v * v / a { way / v + v / a } else { 2.0 * (way / a).sqrt() };
            prop_assert!((least - closed).abs() < 1e-9, "{least} {closed}");
            slowest = slowest.max(closed);
        }
        prop_assert!((times.together - slowest).abs() < 1e-9);
    }

    #[test]
    fn from_rest_to_rest_with_a_limit_of_jerk_takes_the_least_time(
        from in -3.0..3.0_f64, to in -3.0..3.0_f64, bounds in bounds(),
    ) {
        let times = between(&[(at(from), at(to), bounds)]).unwrap();
        let expected = jerk_limited((to - from).abs(), &bounds);
        prop_assert!((times.together - expected).abs() < 1e-9 * (1.0 + expected), "{} {expected}", times.together);
    }

    #[test]
    fn a_stop_takes_the_closed_forms_time_and_way(
        velocity in -5.0..5.0_f64, share in -1.0..1.0_f64, bounds in bounds(), with_jerk in any::<bool>(),
    ) {
        let bounds = JointBounds { jerk: if with_jerk { bounds.jerk } else { 0.0 }, ..bounds };
        let now = JointState { velocity, acceleration: share * bounds.acceleration, ..at(0.3) };
        let [(time, way)] = stops(&[(now, bounds)]).unwrap()[..] else { panic!("one joint") };
        if !with_jerk {
            prop_assert!((time - velocity.abs() / bounds.acceleration).abs() < 1e-9);
            prop_assert!((way - 0.5 * velocity * velocity.abs() / bounds.acceleration).abs() < 1e-9);
            return Ok(());
        }
        // By hand: the acceleration goes to a peak, stays there, and goes to zero; the peak is found by bisection.
        let JointBounds { acceleration: most, jerk, .. } = bounds;
        let a0 = now.acceleration;
        // What is left of the speed when the acceleration goes straight to zero says which way to go first.
        let sign = if velocity + a0 * a0.abs() / (2.0 * jerk) > 0.0 { -1.0 } else { 1.0 };
        let (v, a) = (sign * velocity, sign * a0);
        let gained = |peak: f64| (2.0 * peak * peak - a * a) / (2.0 * jerk);
        let peak = (0.5 * (a * a - 2.0 * jerk * v)).max(0.0).sqrt().min(most);
        let (up, down) = ((peak - a) / jerk, peak / jerk);
        let flat = ((-v - gained(peak)) / peak).max(0.0);
        prop_assert!((time - (up + flat + down)).abs() < 1e-9 * (1.0 + time), "{time} {}", up + flat + down);
        let mut state = (0.0, v, a);
        for (duration, jerk) in [(up, jerk), (flat, 0.0), (down, -jerk)] {
            let (p, v, a) = state;
            let t = duration;
            state = (p + t * (v + t * (a / 2.0 + t * jerk / 6.0)), v + t * (a + t * jerk / 2.0), a + t * jerk);
        }
        prop_assert!((way - sign * state.0).abs() < 1e-7, "{way} {}", sign * state.0);
    }

    #[test]
    fn numbers_at_the_edge_of_what_is_allowed_give_times_or_a_reason(
        powers in prop::collection::vec((-6.0..6.0_f64, any::<bool>()), 18), zero in 0..18_usize,
    ) {
        let n: Vec<f64> = powers.iter().enumerate().map(|(index, (power, negative))| {
            let size = if index == zero { 0.0 } else { 10.0_f64.powf(*power) };
            if *negative && index % 9 < 6 { -size } else { size }
        }).collect();
        let joints: Vec<Motion> = n.chunks(9).map(|n| (
            JointState { position: n[0], velocity: n[1], acceleration: n[2] },
            JointState { position: n[3], velocity: n[4].clamp(-n[6], n[6]), acceleration: 0.0 },
            JointBounds { velocity: n[6], acceleration: n[7], jerk: n[8] },
        )).collect();
        if let Ok(times) = between(&joints) {
            let slowest = times.least.iter().fold(0.0_f64, |most, time| most.max(*time));
            prop_assert!(times.together.is_finite() && times.together >= slowest * (1.0 - 1e-9));
        }
        let stopping: Vec<(JointState, JointBounds)> = joints.iter().map(|(now, _, bounds)| (*now, *bounds)).collect();
        if let Ok(found) = stops(&stopping) {
            prop_assert!(found.iter().all(|(time, way)| *time >= 0.0 && way.is_finite()));
        }
    }

    #[test]
    fn any_numbers_give_times_or_a_reason(numbers in prop::collection::vec(prop::num::f64::ANY, 9)) {
        let n = &numbers;
        let (start, end) = (
            JointState { position: n[0], velocity: n[1], acceleration: n[2] },
            JointState { position: n[3], velocity: n[4], acceleration: n[5] },
        );
        let bounds = JointBounds { velocity: n[6], acceleration: n[7], jerk: n[8] };
        let _ = between(&[(start, end, bounds)]);
        let _ = stops(&[(start, bounds)]);
    }
}

#[test]
fn what_cannot_be_is_named() {
    let bounds = JointBounds {
        velocity: 1.0,
        acceleration: 2.0,
        jerk: 3.0,
    };
    let none = JointBounds {
        acceleration: 0.0,
        ..bounds
    };
    let refused = between(&[(at(0.0), at(1.0), bounds), (at(0.0), at(1.0), none)]);
    let text = refused.unwrap_err().to_string();
    assert_eq!(
        text,
        "the largest acceleration of joint 2 is 0; it must be above zero"
    );
    let fast = JointState {
        velocity: 1.5,
        ..at(1.0)
    };
    let text = between(&[(at(0.0), fast, bounds)]).unwrap_err().to_string();
    assert_eq!(
        text,
        "joint 1: the speed at the end, 1.5, is beyond its limit of 1"
    );
}
