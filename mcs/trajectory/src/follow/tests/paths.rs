//! Arcs, arches and paths near singularities, followed period by period; blends by a distance; a queue that runs dry.

use super::*;
use crate::{Blend, Curve, PlanError};

/// With room on all sides.
const READY: [f64; 6] = [0.1, 0.8, -2.6, 0.2, 0.7, 0.1];

fn planner(name: &str) -> Planner {
    let planner = Planner::new(arm(name), CartesianLimits::default(), 0.018);
    planner.unwrap()
}

/// The pose of the tool, moved and turned.
fn beside(
    planner: &mut Planner,
    start: &Joints,
    by: Vector3<f64>,
    turn: Vector3<f64>,
) -> Isometry3<f64> {
    let from = planner.tool_pose(start);
    Isometry3::from_parts(
        Translation3::from(from.translation.vector + by),
        UnitQuaternion::from_scaled_axis(turn) * from.rotation,
    )
}

fn curve(segment: &Segment) -> &Curve {
    match segment.path() {
        Path::Tool(path) => &path.curve,
        Path::Joint(_) => panic!("no path of the tool"),
    }
}

/// Follows a path whole and to a stop, checks the joints' limits, and that the tool is on its curve and keeps its own.
fn keeps_its_limits(planner: &mut Planner, start: &Joints, segment: &Segment, stop_at: f64) {
    let model = Arc::clone(planner.model());
    let limits = CartesianLimits::default();
    let planned = (segment.duration() / PERIOD).ceil() as usize + 1;
    for stop_before in [usize::MAX, (stop_at * planned as f64) as usize] {
        let all = followed(planner, (segment, start), stop_before);
        check(&model, &all, Pace::from(1.0), stop_before);
        if planner.limits_jerk {
            check_jerk(&model, &all, 1.02);
        }
        let poses: Vec<Vector3<f64>> = all
            .iter()
            .map(|setpoint| planner.tool_pose(&setpoint.position).translation.vector)
            .collect();
        for place in &poses {
            let off = (0..=1_000)
                .map(|step| (curve(segment).at(f64::from(step) / 1_000.0)[0] - place).norm())
                .fold(f64::INFINITY, f64::min);
            let between = curve(segment).length() / 2_000.0;
            assert!(off < between + 3e-4, "{off} m off the path");
        }
        for pair in poses.windows(2) {
            let speed = (pair[1] - pair[0]).norm() / PERIOD;
            assert!(speed < limits.linear_speed * 1.001 + 1e-6, "{speed} m/s");
        }
        for triple in poses.windows(3) {
            let change = triple[2] - 2.0 * triple[1] + triple[0];
            let acceleration = change.norm() / (PERIOD * PERIOD);
            // Between two solved poses the tool is off the curve by what cubics of joints are.
            assert!(
                acceleration < limits.linear_acceleration * 1.05 + 1e-3,
                "{acceleration} m/s^2, stopped before {stop_before}"
            );
        }
        if stop_before == usize::MAX {
            let end = segment.end(&mut planner.solver).unwrap();
            let last = all.last().unwrap().position;
            assert!(last.iter().zip(&end).all(|(a, b)| (a - b).abs() < 1e-7));
        }
    }
}

fn offset(most: f64) -> impl Strategy<Value = Vector3<f64>> {
    prop::array::uniform3(-most..most).prop_map(Vector3::from)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(16))]

    #[test]
    fn arcs_keep_every_limit_of_joints_and_tool_on_the_way_and_in_a_stop(
        via in offset(0.12), by in offset(0.2), turn in offset(0.3), stop_at in 0.0..1.0_f64, pace in 0.2..=1.0_f64,
    ) {
        let mut planner = planner("puma560");
        let start = Joints::from(READY);
        let goal = beside(&mut planner, &start, by, turn);
        let via = planner.tool_pose(&start).translation.vector + via;
        let segment = planner.arc_through(&start, (via, &goal), pace);
        prop_assume!(segment.is_ok());
        keeps_its_limits(&mut planner, &start, &segment.unwrap(), stop_at);
    }

    #[test]
    fn arches_keep_every_limit_of_joints_and_tool_on_the_way_and_in_a_stop(
        by in offset(0.2), turn in offset(0.3), stop_at in 0.0..1.0_f64, height in 0.02..0.15_f64,
        corner in prop::option::of(0.02..0.1_f64),
    ) {
        let mut planner = planner("puma560");
        let start = Joints::from(READY);
        let goal = beside(&mut planner, &start, by, turn);
        let segment = planner.arch(&start, (height, corner, &goal), 1.0);
        prop_assume!(segment.is_ok());
        keeps_its_limits(&mut planner, &start, &segment.unwrap(), stop_at);
    }

    #[test]
    fn a_blend_by_a_distance_stays_within_it_and_within_the_halves_of_both_segments(
        points in (within_limits("puma560"), within_limits("puma560"), within_limits("puma560")),
        most in 0.01..1.0_f64, by_radius in any::<bool>(), jerk in any::<bool>(),
    ) {
        let mut planner = planner("puma560").limiting_jerk(jerk);
        let pace = Pace::from(1.0);
        let first = planner.joint(&points.0, &points.1, pace).unwrap();
        let second = planner.joint(&points.1, &points.2, pace).unwrap();
        let blend = if by_radius { Blend::Radius(most) } else { Blend::Joints(most) };
        let bridge = planner.bridge((&first, &second), pace, blend);
        prop_assume!(bridge.is_some());
        let bridge = bridge.unwrap();
        prop_assert!(bridge.leave >= 0.5 * first.duration() - 1e-9);
        prop_assert!(bridge.join <= 0.5 * second.duration() + 1e-9);
        let corner = planner.tool_pose(&points.1).translation.vector;
        let model = Arc::clone(planner.model());
        let mut follower = Follower::new(2, PERIOD, 4);
        assert!(follower.push(first, None) && follower.push(second, Some(bridge)));
        let all = setpoints(&mut planner.solver, &mut follower, &points.0, usize::MAX);
        check(&model, &all, Pace::from(1.0), usize::MAX);
        if jerk {
            check_jerk(&model, &all, 1.0);
        }
        for (period, setpoint) in all.iter().enumerate() {
            let time = PERIOD * period as f64;
            if time < bridge.leave || time > bridge.leave + bridge.duration() {
                continue;
            }
            let off = if by_radius {
                (planner.tool_pose(&setpoint.position).translation.vector - corner).norm()
            } else {
                let pairs = setpoint.position.iter().zip(&points.1);
                pairs.fold(0.0, |most: f64, (a, b)| most.max((a - b).abs()))
            };
            prop_assert!(off <= most * 1.001 + 1e-6, "{off} {most}");
        }
    }
}

/// A path past a pose with joint 5 at an angle, straight ahead but for a turn aside.
fn past_the_wrist(planner: &mut Planner, joint_5: f64, aside: f64) -> (Joints, Isometry3<f64>) {
    let middle = planner.tool_pose(&[0.1, 0.8, -2.6, -1.0, joint_5, 0.1]);
    let start_joints = Joints::from([0.1, 0.8, -2.6, -1.0, 0.3, 0.1]);
    let start = planner.tool_pose(&start_joints);
    let turn = middle.rotation * start.rotation.inverse();
    let sideways = UnitQuaternion::from_scaled_axis(Vector3::new(0.0, aside, 0.0));
    let goal = Isometry3::from_parts(
        (middle.translation.vector * 2.0 - start.translation.vector).into(),
        sideways * turn * turn * start.rotation,
    );
    (start_joints, goal)
}

#[test]
fn near_the_wrists_singularity_a_path_slows_down_there_alone_and_says_how_near_it_came() {
    let mut planner = planner("puma560");
    let (start, goal) = past_the_wrist(&mut planner, 0.004, -0.05);
    let segment = planner.line(&start, &goal, 1.0).unwrap();
    let (smallest, slowed) = segment.singularity().unwrap();
    assert!(smallest < 0.05 && smallest > 0.0, "{smallest}");
    assert!(slowed > 1.2, "{slowed}");
    keeps_its_limits(&mut planner, &start, &segment, 0.5);
    // What the segment says is the least of what the poses on it say.
    let all = followed(&mut planner, (&segment, &start), usize::MAX);
    let values = all
        .iter()
        .map(|setpoint| planner.solver.smallest_singular_value(&setpoint.position));
    let least = values.fold(f64::INFINITY, f64::min);
    assert!(
        (least - smallest).abs() < 0.1 * smallest,
        "{least} {smallest}"
    );
    // Away from there it is as fast as a path that nothing slows down.
    let (start, goal) = past_the_wrist(&mut planner, 0.2, 0.0);
    let free = planner.line(&start, &goal, 1.0).unwrap();
    assert_eq!(free.singularity().unwrap().1, 1.0);
    let fastest = |segment: &Segment| match segment.path() {
        Path::Tool(path) => path.along.ranges(0.0, segment.duration()).velocity.most,
        Path::Joint(_) => panic!("no path of the tool"),
    };
    assert!(fastest(&segment) > 0.3 * fastest(&free));
}

#[test]
fn a_path_through_a_singularity_is_refused_by_name_before_it_begins() {
    let mut planner = planner("puma560");
    let (start, goal) = past_the_wrist(&mut planner, 0.0, 0.0);
    let refused = planner.line(&start, &goal, 1.0).unwrap_err();
    assert!(matches!(refused, PlanError::Singular { .. }), "{refused}");
    assert!(refused.to_string().contains("singularity"), "{refused}");
    // At a pace at which the joints could follow nearly everything it is refused all the same.
    let refused = planner.line(&start, &goal, 0.01).unwrap_err();
    assert!(refused.to_string().contains("singularity"), "{refused}");
}

#[test]
fn what_an_arc_or_an_arch_cannot_reach_is_refused_before_it_begins() {
    let mut planner = planner("puma560");
    let start = Joints::from(READY);
    let goal = beside(
        &mut planner,
        &start,
        Vector3::new(0.0, 0.2, 0.0),
        Vector3::zeros(),
    );
    // The target can be reached, the top cannot.
    let refused = planner.arch(&start, (2.0, None, &goal), 0.5).unwrap_err();
    assert!(
        matches!(
            refused,
            PlanError::Path {
                reason: SegmentError::Unreachable(_),
                ..
            }
        ),
        "{refused}"
    );
    let far = Vector3::new(3.0, 0.0, 0.0);
    let refused = planner.arc_through(&start, (far, &goal), 0.5).unwrap_err();
    assert!(matches!(refused, PlanError::Path { .. }), "{refused}");
    let middle = beside(
        &mut planner,
        &start,
        Vector3::new(0.0, 0.1, 0.0),
        Vector3::zeros(),
    );
    let refused = planner.arc_through(&start, (middle.translation.vector, &goal), 0.5);
    assert!(matches!(refused, Err(PlanError::Curve(_))), "{refused:?}");
}

/// The queue holds two segments and a bridge between them; the third comes before some period.
fn runs_dry(blend: Blend, comes_before: usize) -> (Vec<Setpoint>, [Joints; 4], u64) {
    let mut planner = planner("puma560");
    let points = [
        READY,
        [0.6, 0.5, -2.2, 0.4, 0.5, 0.3],
        [1.1, 0.9, -2.8, 0.0, 0.9, 0.0],
        [0.7, 1.2, -2.5, -0.3, 0.4, 0.2],
    ]
    .map(Joints::from);
    let pace = Pace::from(1.0);
    let segments: Vec<Segment> = points
        .windows(2)
        .map(|ends| planner.joint(&ends[0], &ends[1], pace).unwrap())
        .collect();
    let bridge = |planner: &mut Planner, index: usize| {
        planner.bridge((&segments[index], &segments[index + 1]), pace, blend)
    };
    let [first, second] = [0, 1].map(|index| bridge(&mut planner, index));
    assert!(first.is_some() && second.is_some());
    let mut follower = Follower::new(3, PERIOD, 4);
    assert!(follower.push(segments[0], None) && follower.push(segments[1], first));
    let (mut all, mut near) = (Vec::new(), points[0]);
    loop {
        if all.len() == comes_before {
            assert!(follower.push(segments[2], second));
        }
        if follower.rests() && !follower.go_on() && all.len() > comes_before {
            break;
        }
        if follower.is_empty() {
            // It stands and waits for the third.
            all.push(Setpoint::at_rest(near));
        } else {
            all.push(follower.next(&mut planner.solver, &near).unwrap());
        }
        near = all[all.len() - 1].position;
        assert!(all.len() < 10_000, "it never rests");
    }
    check(planner.model(), &all, pace, usize::MAX);
    (all, points, follower.passed())
}

#[test]
fn when_the_queue_runs_dry_in_a_blend_the_arm_stops_at_the_end_of_the_last_segment_and_goes_on_from_there()
 {
    let blend = Blend::Share(1.0);
    // How many periods two segments take.
    let (alone, points, _) = runs_dry(blend, 5_000);
    let there = |setpoint: &Setpoint| setpoint.position == points[2];
    let arrives = alone.iter().position(there).unwrap();
    assert!(
        alone[arrives..5_000]
            .iter()
            .all(|setpoint| *setpoint == Setpoint::at_rest(points[2]))
    );
    // The third one comes at every moment: in the first segment, in its blend, in the second, in and after the second's end.
    let mut passed = [0, 0, 0];
    for comes_before in 1..arrives + 5 {
        let (all, points, bridges) = runs_dry(blend, comes_before);
        assert_eq!(all[all.len() - 1], Setpoint::at_rest(points[3]));
        assert!(bridges == 2 || all.iter().any(there), "{comes_before}");
        passed[bridges as usize] += 1;
    }
    assert!(passed[1] > 0 && passed[2] > 0, "{passed:?}");
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(16))]

    #[test]
    fn lines_arcs_and_arches_keep_limits_of_jerk_where_they_are_asked_to_and_so_does_a_stop_on_them(
        by in offset(0.2), turn in offset(0.3), aside in offset(0.1), kind in 0..3_usize, pace in 0.2..=1.0_f64,
        stop_at in 0.0..1.0_f64,
    ) {
        let mut planner = planner("puma560").limiting_jerk(true);
        let start = Joints::from(READY);
        let goal = beside(&mut planner, &start, by, turn);
        let via = planner.tool_pose(&start).translation.vector + 0.5 * by + aside;
        let segment = match kind {
            0 => planner.line(&start, &goal, pace),
            1 => planner.arc_through(&start, (via, &goal), pace),
            _ => planner.arch(&start, (0.05, None, &goal), pace),
        };
        prop_assume!(segment.is_ok());
        let segment = segment.unwrap();
        keeps_its_limits(&mut planner, &start, &segment, stop_at);
    }
}
