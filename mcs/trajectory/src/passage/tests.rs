//! Passages against stops at every point, against straight lines, and sampled against their limits.

use super::*;
use proptest::prelude::*;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

fn bounds(with_jerk: bool) -> impl Strategy<Value = JointBounds> {
    let jerk = if with_jerk {
        5.0..300.0_f64
    } else {
        0.0..1e-300
    };
    (0.1..5.0_f64, 0.5..20.0_f64, jerk).prop_map(move |(velocity, acceleration, jerk)| {
        JointBounds {
            velocity,
            acceleration,
            jerk: if with_jerk { jerk } else { 0.0 },
        }
    })
}

/// Up to six joints through up to four way points; some joints have a limit of jerk.
fn paths() -> impl Strategy<Value = (Vec<f64>, Vec<JointBounds>)> {
    (1..=6_usize, 0..=4_usize).prop_flat_map(|(joints, way_points)| {
        let points = prop::collection::vec(-3.0..3.0_f64, joints * (way_points + 2));
        let bounds = any::<bool>().prop_flat_map(bounds);
        (points, prop::collection::vec(bounds, joints))
    })
}

/// How long it takes to stop at every point.
fn with_stops(points: &[f64], bounds: &[JointBounds]) -> f64 {
    let pairs = points.chunks_exact(bounds.len());
    let pairs = pairs.clone().zip(pairs.skip(1));
    pairs.map(|(from, to)| rest_to_rest(from, to, bounds)).sum()
}

fn rest_to_rest(from: &[f64], to: &[f64], bounds: &[JointBounds]) -> f64 {
    let ends = from
        .iter()
        .zip(to)
        .map(|(from, to)| (at_rest(*from), at_rest(*to)));
    let motions: Vec<Motion> = ends
        .zip(bounds)
        .map(|((from, to), bounds)| (from, to, *bounds))
        .collect();
    timing::between(&motions).unwrap().together
}

proptest! {
    #[test]
    fn a_passage_is_at_every_point_keeps_every_limit_and_is_no_longer_than_one_that_stops(
        (points, bounds) in paths(),
    ) {
        let passage = Passage::through(&points, &bounds).unwrap();
        let stops = with_stops(&points, &bounds);
        prop_assert!(passage.duration() <= stops * (1.0 + 1e-9), "{} {stops}", passage.duration());
        let joints = bounds.len();
        let times = [vec![0.0], passage.times()].concat();
        prop_assert_eq!(times.len(), points.len() / joints);
        for (time, point) in times.iter().zip(points.chunks_exact(joints)) {
            for (state, position) in passage.at(*time).iter().zip(point) {
                prop_assert!((state.position - position).abs() < 1e-6, "{time}: {state:?} {position}");
            }
        }
        for end in [0.0, passage.duration()] {
            prop_assert!(passage.at(end).iter().all(|state| state.velocity.abs() < 1e-6));
        }
        let (dt, mut before) = (passage.duration() / 2000.0, passage.at(0.0));
        for step in 1..=2000_u32 {
            let now = passage.at(dt * f64::from(step));
            for ((now, before), bounds) in now.iter().zip(&before).zip(&bounds) {
                prop_assert!(now.velocity.abs() <= bounds.velocity * (1.0 + 1e-6), "{now:?} {bounds:?}");
                prop_assert!(now.acceleration.abs() <= bounds.acceleration * (1.0 + 1e-6), "{now:?} {bounds:?}");
                // No step in position or speed, and none in acceleration where there is a limit of jerk.
                let moved = (now.position - before.position).abs();
                prop_assert!(moved <= bounds.velocity * dt * (1.0 + 1e-6) + 1e-7, "{moved}");
                let faster = (now.velocity - before.velocity).abs();
                prop_assert!(faster <= bounds.acceleration * dt * (1.0 + 1e-6) + 1e-7, "{faster}");
                let harder = (now.acceleration - before.acceleration).abs();
                prop_assert!(bounds.jerk == 0.0 || harder <= bounds.jerk * dt * (1.0 + 1e-6) + 1e-7, "{harder}");
            }
            before = now;
        }
    }

    #[test]
    fn without_way_points_it_is_the_motion_from_rest_to_rest(
        ends in prop::collection::vec((-3.0..3.0_f64, -3.0..3.0_f64, any::<bool>().prop_flat_map(bounds)), 1..=9),
    ) {
        let (from, to): (Vec<f64>, Vec<f64>) = ends.iter().map(|(from, to, _)| (*from, *to)).unzip();
        let bounds: Vec<JointBounds> = ends.iter().map(|(_, _, bounds)| *bounds).collect();
        let passage = Passage::through(&[from.clone(), to.clone()].concat(), &bounds).unwrap();
        prop_assert!((passage.duration() - rest_to_rest(&from, &to, &bounds)).abs() < 1e-12);
    }

    #[test]
    fn points_on_a_straight_line_take_no_longer_than_the_line_in_proportion(
        ends in prop::collection::vec((-3.0..3.0_f64, -3.0..3.0_f64, any::<bool>().prop_flat_map(bounds)), 1..=6),
        mut shares in prop::collection::vec(0.02..0.98_f64, 1..=4),
    ) {
        shares.sort_by(f64::total_cmp);
        let apart = shares.windows(2).all(|pair| pair[1] - pair[0] > 1e-3);
        let goes = ends.iter().any(|(from, to, _)| (to - from).abs() > 1e-3);
        prop_assume!(apart && goes);
        let bounds: Vec<JointBounds> = ends.iter().map(|(_, _, bounds)| *bounds).collect();
        let at = |share: f64| ends.iter().map(move |(from, to, _)| from + share * (to - from));
        let points: Vec<f64> = [&[0.0][..], &shares, &[1.0]].concat().into_iter().flat_map(at).collect();
        // One joint for the line, with the limits that all joints leave it.
        let least = |limit: fn(&JointBounds) -> f64| {
            let limits = ends.iter().map(|(from, to, bounds)| limit(bounds) / (to - from).abs());
            limits.filter(|limit| *limit > 0.0).fold(f64::INFINITY, f64::min)
        };
        let jerk = least(|bounds| bounds.jerk);
        let along = JointBounds {
            velocity: least(|bounds| bounds.velocity),
            acceleration: least(|bounds| bounds.acceleration),
            jerk: if jerk.is_finite() { jerk } else { 0.0 },
        };
        let straight = rest_to_rest(&[0.0], &[1.0], &[along]);
        let passage = Passage::through(&points, &bounds).unwrap();
        prop_assert!(passage.duration() <= straight * (1.0 + 1e-5), "{} {straight}", passage.duration());
    }

    #[test]
    fn any_numbers_give_a_time_or_a_reason(
        points in prop::collection::vec(prop::num::f64::ANY, 9), limits in prop::collection::vec(prop::num::f64::ANY, 6),
    ) {
        let bounds: Vec<JointBounds> = limits.chunks_exact(3).map(|limits| JointBounds {
            velocity: limits[0],
            acceleration: limits[1],
            jerk: limits[2],
        }).collect();
        let _ = Passage::through(&points, &bounds);
        let _ = Passage::through(&points, &[]);
        let _ = Passage::through(&[], &bounds);
    }
}

/// Random points of six joints under random limits, in which a joint has hardly time to be fast.
fn random_paths(with_jerk: bool) -> impl Iterator<Item = (Vec<f64>, Vec<JointBounds>)> {
    let mut random = ChaCha8Rng::seed_from_u64(19);
    (0..20).map(move |_| {
        let bounds = (0..6).map(|_| JointBounds {
            velocity: random.random_range(1.0..3.0),
            acceleration: random.random_range(1.0..3.0),
            jerk: random.random_range(2.0..6.0),
        });
        let mut bounds: Vec<JointBounds> = bounds.collect();
        if !with_jerk {
            bounds.iter_mut().for_each(|bounds| bounds.jerk = 0.0);
        }
        let points = (0..24).map(|_| random.random_range(-0.5..0.5)).collect();
        (points, bounds)
    })
}

#[test]
fn through_two_random_way_points_a_passage_is_much_shorter_than_with_stops() {
    for (with_jerk, most) in [(true, 0.78), (false, 0.87)] {
        let shares = random_paths(with_jerk).map(|(points, bounds)| {
            let passage = Passage::through(&points, &bounds).unwrap();
            passage.duration() / with_stops(&points, &bounds)
        });
        let mean = shares.sum::<f64>() / 20.0;
        assert!(mean <= most, "with a limit of jerk: {with_jerk}: {mean}");
    }
}

/// How long a passage takes that rsruckig's own search for way points finds in so many sweeps.
fn by_rsruckig(points: &[f64], bounds: &[JointBounds], sweeps: usize) -> f64 {
    use rsruckig::prelude::{DataArrayOrVec, InputParameter, Ruckig, ThrowErrorHandler};
    let joints = bounds.len();
    let mut input = InputParameter::<0>::new(Some(joints));
    let (first, last) = (&points[..joints], &points[points.len() - joints..]);
    for (index, bounds) in bounds.iter().enumerate() {
        input.current_position[index] = first[index];
        input.target_position[index] = last[index];
        input.max_velocity[index] = bounds.velocity;
        input.max_acceleration[index] = bounds.acceleration;
        input.max_jerk[index] = bounds.jerk;
    }
    let between = points[joints..points.len() - joints].chunks_exact(joints);
    input.intermediate_positions = between
        .map(|point| DataArrayOrVec::Heap(point.to_vec()))
        .collect();
    let mut ruckig = Ruckig::<0, ThrowErrorHandler>::new(Some(joints), 1.0);
    ruckig.waypoint_refinement_sweeps = sweeps;
    let mut trajectory = Trajectory::<0>::new(Some(joints));
    ruckig.calculate(&input, &mut trajectory).unwrap();
    trajectory.duration
}

#[test]
fn passages_are_on_average_no_longer_than_those_of_rsruckigs_own_search() {
    let (mut own, mut theirs) = (0.0, 0.0);
    for (points, bounds) in random_paths(true).take(10) {
        own += Passage::through(&points, &bounds).unwrap().duration();
        theirs += by_rsruckig(&points, &bounds, 4);
    }
    assert!(own <= theirs, "{own} {theirs}");
}

#[test]
fn points_that_are_the_same_or_too_many_are_named() {
    let bounds = [JointBounds {
        velocity: 1.0,
        acceleration: 2.0,
        jerk: 0.0,
    }];
    let refused = Passage::through(&[0.0, 1.0, 1.0, 2.0], &bounds);
    assert_eq!(refused.unwrap_err(), TimingError::Standing { point: 2 });
    let many: Vec<f64> = (0..103_u32).map(f64::from).collect();
    let (given, most) = (101, MOST_WAY_POINTS);
    let refused = Passage::through(&many, &bounds).unwrap_err();
    assert_eq!(refused, TimingError::TooManyPoints { given, most });
    // There and back is no standing, and neither is a way of no length without way points.
    assert!(Passage::through(&[0.0, 1.0, 0.0], &bounds).is_ok());
    assert_eq!(
        Passage::through(&[1.0, 1.0], &bounds).unwrap().duration(),
        0.0
    );
}

#[test]
fn the_same_points_give_the_same_bits() {
    let bounds = [JointBounds {
        velocity: 1.0,
        acceleration: 2.0,
        jerk: 30.0,
    }; 2];
    let points = [0.0, 0.0, 1.0, -0.5, 0.3, 2.0, -1.0, 1.0];
    let times = || Passage::through(&points, &bounds).unwrap().times();
    assert_eq!(times(), times());
}
