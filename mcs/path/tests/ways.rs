//! Ways around obstacles: free wherever they are looked at, the same for the same seed, found where a grid finds one, and
//! refused where there is none.

#![allow(
    clippy::unwrap_used,
    clippy::panic,
    reason = "a test that cannot be set up fails"
)]

use std::collections::{BTreeSet, VecDeque};
use std::sync::Arc;

use ctos::diagnostic::Source;
use mcs::Joints;
use mcs::model::{Model, Placement, Solid, built_in, file, file::Inertias};
use mcs::trajectory::{Blend, CartesianLimits, Follower, Pace, Planner};
use mcs_path::search::{CHECKED_M, End};
use mcs_path::space::RESOLUTION_M;
use mcs_path::{Options, PathError, Search, Space, Way, way};
use proptest::prelude::*;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// The distance that is kept, m.
const MARGIN: f64 = 0.02;

/// A ball of 50 mm that two sliding joints move in a square of 2 m.
fn gantry() -> Arc<Model> {
    arm("name = \"gantry\"\n\
         [[joint]]\nname = \"x\"\nlink = \"bridge\"\ntype = \"prismatic\"\naxis = [1, 0, 0]\n\
         limits = { range = [-1, 1], velocity = 1, acceleration = 2 }\n\
         [[joint]]\nname = \"y\"\nlink = \"ball\"\ntype = \"prismatic\"\naxis = [0, 1, 0]\n\
         limits = { range = [-1, 1], velocity = 1, acceleration = 2 }\n\
         shapes = [{ sphere = [0, 0, 0], radius = 0.05 }]\n")
}

/// An arm of three links in a plane, 0.4, 0.3 and 0.2 m long.
fn planar() -> Arc<Model> {
    let joint = |number: usize, before: f64, length: f64| {
        format!(
            "[[joint]]\nname = \"joint{number}\"\nlink = \"link{number}\"\ntype = \"revolute\"\naxis = [0, 0, 1]\n\
             at = {{ xyz = [{before}, 0, 0] }}\n\
             limits = {{ range = [-150, 150], velocity = 2, acceleration = 5 }}\n\
             shapes = [{{ capsule = [[0.05, 0, 0], [{length}, 0, 0]], radius = 0.03 }}]\n"
        )
    };
    let joints = [joint(1, 0.0, 0.4), joint(2, 0.4, 0.3), joint(3, 0.3, 0.2)];
    arm(&format!("name = \"planar\"\n{}", joints.concat()))
}

fn puma() -> Arc<Model> {
    let model = built_in::model("puma560", Inertias::Engine).unwrap();
    Arc::new(model.unwrap())
}

fn arm(text: &str) -> Arc<Model> {
    let source = Source::new("arm.toml", text);
    let model = file::parse(&source, Inertias::Identified);
    Arc::new(model.unwrap_or_else(|found| panic!("{found}")))
}

fn block(name: &str, centre: [f64; 3], edges: [f64; 3]) -> (String, Solid) {
    let [x, y, z] = centre;
    let solid = Solid::Block {
        at: Placement::shifted(x, y, z),
        half: edges.map(|edge| 0.5 * edge).into(),
    };
    (name.to_owned(), solid)
}

fn space(model: &Arc<Model>, room: &[(String, Solid)], margin: f64) -> Space {
    Space::new(Arc::clone(model), Vec::new(), room.to_vec(), margin)
}

fn plan(
    model: &Arc<Model>,
    room: &[(String, Solid)],
    [from, to]: [&[f64]; 2],
    options: Options,
) -> Result<Way, PathError> {
    let [from, to] = [from, to].map(|joints| Joints::try_from(joints).unwrap());
    Search::new(space(model, room, MARGIN), &from, &[to], options)?.run()
}

fn seeded(seed: u64) -> Options {
    Options {
        seed,
        ..Options::default()
    }
}

/// A wall across the square at x = 0, with a gap of 0.2 m, or none.
fn wall(gap: bool) -> Vec<(String, Solid)> {
    match gap {
        false => vec![block("wall", [0.0, 0.0, 0.0], [0.1, 3.0, 0.5])],
        true => vec![
            block("wall", [0.0, -0.6, 0.0], [0.1, 2.2, 0.5]),
            block("wall", [0.0, 1.2, 0.0], [0.1, 1.0, 0.5]),
        ],
    }
}

#[test]
fn a_wall_with_a_gap_is_passed_through_the_gap() {
    for seed in 0..10 {
        let ends: [&[f64]; 2] = [&[-0.5, -0.5], &[0.5, -0.5]];
        let found = plan(&gantry(), &wall(true), ends, seeded(seed)).unwrap();
        assert_eq!(found.points[0][..], *ends[0]);
        assert_eq!(found.points.last().unwrap()[..], *ends[1]);
        for part in found.points.windows(2) {
            let (one, other) = (part[0], part[1]);
            if one[0] * other[0] < 0.0 {
                let share = one[0] / (one[0] - other[0]);
                let y = one[1] + share * (other[1] - one[1]);
                assert!((0.5..0.7).contains(&y), "{seed}: {:?}", found.points);
            }
        }
        // Twice the way from an end to the nearer end of the gap, and through it.
        assert!((1.9..2.9).contains(&found.length_m), "{}", found.length_m);
    }
}

#[test]
fn a_closed_wall_is_refused_after_as_many_tries_as_there_are() {
    let options = Options {
        iterations: 500,
        ..seeded(1)
    };
    let refused = plan(
        &gantry(),
        &wall(false),
        [&[-0.5, 0.0], &[0.5, 0.0]],
        options,
    );
    let Err(PathError::NoWay {
        iterations: 500,
        start,
        goal,
    }) = refused
    else {
        panic!("{refused:?}")
    };
    assert!(start > 5 && goal > 5);
}

#[test]
fn the_same_seed_finds_the_same_way_and_another_one_another() {
    let ends: [&[f64]; 2] = [&[-0.5, -0.5], &[0.5, -0.5]];
    let way = |seed| plan(&gantry(), &wall(true), ends, seeded(seed)).unwrap();
    assert_eq!(way(7), way(7));
    assert_ne!(way(7).points, way(8).points);
}

#[test]
fn a_search_that_goes_on_bit_by_bit_finds_what_one_at_a_stretch_finds() {
    let [from, to] = [[-0.5, -0.5], [0.5, -0.5]].map(Joints::from);
    let search = || {
        Search::new(
            space(&gantry(), &wall(true), MARGIN),
            &from,
            &[to],
            seeded(3),
        )
        .unwrap()
    };
    let whole = search().run().unwrap();
    let mut bits = search();
    let found = loop {
        if let Some(way) = bits.advance(1).unwrap() {
            break way;
        }
    };
    assert_eq!(whole, found);
}

#[test]
fn an_end_that_touches_something_or_is_out_of_limits_is_told_by_name() {
    let room = [block("crate", [0.5, 0.0, 0.0], [0.2, 0.2, 0.2])];
    let refused =
        |from: &[f64], to: &[f64]| plan(&gantry(), &room, [from, to], seeded(1)).unwrap_err();
    let start = refused(&[0.5, 0.05], &[-0.5, 0.0]);
    assert!(
        matches!(&start, PathError::Touches { end: End::Start, touch } if touch.pair == ["ball", "crate"]),
        "{start:?}"
    );
    let text = start.to_string();
    assert!(text.contains("at the start ball is in crate"), "{text}");
    let goal = refused(&[-0.5, 0.0], &[0.5, 0.149]);
    assert!(matches!(goal, PathError::Touches { end: End::Goal, .. }));
    let beyond = refused(&[-0.5, 0.0], &[-0.5, 1.5]);
    assert!(
        matches!(
            beyond,
            PathError::Limit {
                end: End::Goal,
                joint: 2,
                ..
            }
        ),
        "{beyond:?}"
    );
    assert!(
        beyond.to_string().contains("-1.0000 to 1.0000 m"),
        "{beyond}"
    );
    let nan = refused(&[f64::NAN, 0.0], &[0.5, 0.5]);
    assert!(matches!(
        nan,
        PathError::Limit {
            end: End::Start,
            joint: 1,
            ..
        }
    ));
    let few = refused(&[0.0], &[0.5, 0.5]);
    assert!(matches!(
        few,
        PathError::Count {
            needed: 2,
            given: 1,
            ..
        }
    ));
    let none = Search::new(
        space(&gantry(), &room, MARGIN),
        &[-0.5, 0.0].into(),
        &[],
        seeded(1),
    );
    assert_eq!(none.unwrap_err(), PathError::NoGoal);
}

#[test]
fn whoever_stands_nearer_than_the_margin_goes_away_without_coming_nearer() {
    let room = [block("crate", [0.5, 0.0, 0.0], [0.2, 0.2, 0.2])];
    // 10 mm from its face, and 5 mm are allowed.
    let ends: [&[f64]; 2] = [&[0.34, 0.0], &[0.8, 0.0]];
    let options = Options {
        least_m: 0.005,
        ..seeded(1)
    };
    let found = plan(&gantry(), &room, ends, options).unwrap();
    let mut watch = space(&gantry(), &room, 0.0);
    let at = |point: &Joints, watch: &mut Space| watch.nearest(point).unwrap().distance_m;
    let begin = at(&found.points[0], &mut watch);
    assert!((begin - 0.01).abs() < 1e-9);
    for step in 0..=1000 {
        let here =
            mcs_path::space::between(&found.points[0], &found.points[1], f64::from(step) / 1000.0);
        assert!(at(&here, &mut watch) > begin - RESOLUTION_M / 2.0);
    }
    way::check(
        &mut space(&gantry(), &room, MARGIN - RESOLUTION_M / 2.0),
        &found.points[1..],
        5e-4,
    )
    .unwrap();
}

#[test]
fn of_several_goals_one_that_is_free_is_reached_and_the_first_ones_fault_told_when_none_is() {
    let room = [block("crate", [0.5, 0.0, 0.0], [0.2, 0.2, 0.2])];
    let (from, inside, free) = ([-0.5, 0.0].into(), [0.5, 0.0].into(), [0.5, 0.5].into());
    let search =
        |goals: &[Joints]| Search::new(space(&gantry(), &room, MARGIN), &from, goals, seeded(1));
    let found = search(&[inside, free]).unwrap().run().unwrap();
    assert_eq!(*found.points.last().unwrap(), free);
    let refused = search(&[inside, inside]).unwrap_err();
    assert!(matches!(refused, PathError::Touches { end: End::Goal, .. }));
}

/// Which cells of a grid are free, and whether one leads to another through neighbours between which `goes` says yes.
fn grid_finds(
    cells: i32,
    joints: usize,
    [from, to]: [&[i32]; 2],
    mut goes: impl FnMut(&[i32], &[i32]) -> bool,
) -> bool {
    let mut seen = BTreeSet::from([from.to_vec()]);
    let mut queue = VecDeque::from([from.to_vec()]);
    while let Some(here) = queue.pop_front() {
        if here == to {
            return true;
        }
        for joint in 0..joints {
            for step in [-1, 1] {
                let mut next = here.clone();
                next[joint] += step;
                if (0..=cells).contains(&next[joint]) && !seen.contains(&next) && goes(&here, &next)
                {
                    seen.insert(next.clone());
                    queue.push_back(next);
                }
            }
        }
    }
    false
}

/// Boxes at random places of the square, which leave both ends free.
fn boxes(seed: u64) -> Vec<(String, Solid)> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let count = 6 + seed % 10;
    let boxes = (0..count).filter_map(|number| {
        let mut random = |size: f64| size * (2.0 * rng.random::<f64>() - 1.0);
        let (x, y) = (random(0.9), random(0.9));
        let (along, across) = (0.1 + random(0.1).abs() * 4.0, 0.1 + random(0.1).abs() * 8.0);
        let covers = |end: f64| {
            (x - end).abs() < along / 2.0 + 0.15 && (y - end).abs() < across / 2.0 + 0.15
        };
        let apart = !covers(-0.8) && !covers(0.8);
        apart.then(|| block(&format!("box {number}"), [x, y, 0.0], [along, across, 0.4]))
    });
    boxes.collect()
}

/// How far the gantry's ball is from the nearest box, m: by hand, and not by the collision module.
fn clear(room: &[(String, Solid)], x: f64, y: f64) -> f64 {
    let all = room.iter().map(|(_, solid)| match solid {
        Solid::Block { at, half } => {
            let out = |way: f64, half: f64| (way.abs() - half).max(0.0);
            out(x - at.origin.x, half.x).hypot(out(y - at.origin.y, half.y))
        }
        _ => panic!("no box"),
    });
    all.fold(f64::INFINITY, f64::min) - 0.05
}

#[test]
fn a_way_is_found_where_a_grid_of_two_joints_finds_one_and_none_where_even_a_generous_grid_has_none()
 {
    const CELLS: i32 = 100;
    let place = |cell: i32| -1.0 + 0.02 * f64::from(cell);
    let (mut found, mut closed) = (0, 0);
    for seed in 0..40 {
        let room = boxes(seed);
        // From -0.8, -0.8 to 0.8, 0.8.
        let by_grid = |least: f64| {
            grid_finds(CELLS, 2, [&[10, 10], &[90, 90]], |_, to| {
                clear(&room, place(to[0]), place(to[1])) > least
            })
        };
        // Between two cells nothing is nearer by more than half the way; and whatever way there is has cells near it.
        let (surely, perhaps) = (by_grid(MARGIN + 0.01), by_grid(MARGIN - 0.03));
        let options = Options {
            iterations: if surely { 20_000 } else { 1500 },
            cuts: 20,
            ..seeded(seed)
        };
        let way = plan(&gantry(), &room, [&[-0.8, -0.8], &[0.8, 0.8]], options);
        match &way {
            Ok(way) => {
                assert!(perhaps, "{seed}: {way:?}");
                for part in way.points.windows(2) {
                    for step in 0..=2000 {
                        let at =
                            mcs_path::space::between(&part[0], &part[1], f64::from(step) / 2000.0);
                        let clear = clear(&room, at[0], at[1]);
                        assert!(clear > MARGIN - RESOLUTION_M / 2.0, "{seed}: {clear}");
                    }
                }
                found += 1;
            }
            Err(error) => {
                assert!(!surely, "{seed}: {error}");
                closed += 1;
            }
        }
    }
    assert!(found >= 10 && closed >= 3, "{found} found, {closed} closed");
}

#[test]
fn an_arm_of_three_joints_finds_a_way_wherever_a_grid_of_its_joints_has_one() {
    const CELLS: i32 = 30;
    let model = planar();
    let angle = |cell: i32| (-150.0 + 10.0 * f64::from(cell)).to_radians();
    let joints = |cells: &[i32]| Joints::from_fn(3, |joint| angle(cells[joint]));
    let (mut found, mut tried) = (0, 0);
    for seed in 0..6 {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let room: Vec<(String, Solid)> = (0..4)
            .map(|post| {
                let turn = rng.random::<f64>() * std::f64::consts::TAU;
                let far = 0.25 + 0.6 * rng.random::<f64>();
                let (x, y) = (far * turn.cos(), far * turn.sin());
                let ends = [-0.2, 0.2].map(|z| [x, y, z].into());
                let [a, b] = ends;
                let radius = 0.03 + 0.05 * rng.random::<f64>();
                (format!("post {post}"), Solid::Capsule { a, b, radius })
            })
            .collect();
        let mut watch = space(&model, &room, MARGIN);
        let mut free = || loop {
            let cells: Vec<i32> = (0..3).map(|_| rng.random_range(1..CELLS)).collect();
            if watch.stands_free(&joints(&cells)).is_ok() {
                break cells;
            }
        };
        let (from, to) = (free(), free());
        let by_grid = grid_finds(CELLS, 3, [&from, &to], |here, next| {
            watch.goes_free(&joints(here), &joints(next)).is_ok()
        });
        if !by_grid {
            continue;
        }
        tried += 1;
        let options = Options {
            iterations: 20_000,
            cuts: 20,
            ..seeded(seed)
        };
        let way = plan(
            &model,
            &room,
            [&joints(&from)[..], &joints(&to)[..]],
            options,
        );
        let way = way.unwrap_or_else(|error| panic!("{seed}: {error}"));
        let mut finer = space(&model, &room, MARGIN - RESOLUTION_M / 2.0);
        way::check(&mut finer, &way.points, CHECKED_M / 4.0).unwrap();
        found += 1;
    }
    assert!(tried >= 3 && found == tried, "{found} of {tried}");
}

/// A post on each side in front of the PUMA, and a beam over them.
fn gate() -> Vec<(String, Solid)> {
    vec![
        block("left post", [0.55, 0.15, 0.4], [0.08, 0.08, 0.8]),
        block("beam", [0.55, 0.0, 1.25], [0.08, 0.8, 0.08]),
    ]
}

const ONE_SIDE: [f64; 6] = [-0.7, 0.6, -2.6, 0.0, 0.4, 0.0];
const OTHER_SIDE: [f64; 6] = [0.9, 0.6, -2.6, 0.0, 0.4, 0.0];

#[test]
fn a_puma_goes_around_a_post_and_is_free_at_a_finer_resolution_than_it_was_planned_with() {
    let straight = space(&puma(), &gate(), MARGIN).goes_free(&ONE_SIDE.into(), &OTHER_SIDE.into());
    assert!(straight.is_err(), "the post is in the way");
    for seed in 0..4 {
        let found = plan(&puma(), &gate(), [&ONE_SIDE, &OTHER_SIDE], seeded(seed)).unwrap();
        assert!(found.points.len() >= 3 && found.leeway.len() == found.points.len());
        let mut finer = space(&puma(), &gate(), MARGIN - RESOLUTION_M / 2.0);
        way::check(&mut finer, &found.points, CHECKED_M / 2.0).unwrap();
        let nearest = found.nearest.unwrap();
        assert!(nearest.distance_m > MARGIN, "{nearest}");
    }
}

#[test]
fn what_is_driven_through_blended_way_points_is_as_free_as_the_way() {
    const PERIOD: f64 = 0.0045;
    let found = plan(&puma(), &gate(), [&ONE_SIDE, &OTHER_SIDE], seeded(2)).unwrap();
    let mut planner = Planner::new(puma(), CartesianLimits::default(), 0.018).unwrap();
    let pace = Pace::from(1.0);
    let parts = found.points.windows(2);
    let segments: Vec<_> = parts
        .map(|part| planner.direct(&part[0], &part[1], pace).unwrap())
        .collect();
    let mut follower = Follower::new(segments.len(), PERIOD, 4);
    let (mut stops, mut bridges) = (0.0, 0);
    for (number, segment) in segments.iter().enumerate() {
        stops += segment.duration();
        let before = number.checked_sub(1).map(|before| &segments[before]);
        let bridge = before.and_then(|before| {
            let blend = Blend::Joints(found.leeway[number]);
            planner.bridge((before, segment), pace, blend)
        });
        bridges += usize::from(bridge.is_some());
        assert!(follower.push(*segment, bridge));
    }
    let mut watch = space(&puma(), &gate(), MARGIN - RESOLUTION_M / 2.0);
    let mut solver = planner.solver().clone();
    let (mut at, mut ticks) = (found.points[0], 0);
    while !follower.rests() || follower.go_on() {
        at = follower.next(&mut solver, &at).unwrap().position;
        watch.stands_free(&at).unwrap();
        ticks += 1;
    }
    assert_eq!(at, *found.points.last().unwrap());
    assert!(bridges > 0, "{:?}", found.leeway);
    assert!(PERIOD * f64::from(ticks) < stops, "{ticks} {stops}");
}

#[test]
fn an_arm_without_a_form_and_other_arms_in_the_way_are_known() {
    let plain = arm("name = \"plain\"\n[[joint]]\nname = \"a\"\ntype = \"revolute\"\n");
    let refused = plan(&plain, &[], [&[0.0], &[1.0]], seeded(1)).unwrap_err();
    assert!(matches!(refused, PathError::NoForm { .. }), "{refused}");
    // Another gantry beside this one, whose ball stands in the middle.
    let other = (gantry(), Placement::identity(), [0.0, 0.0].into());
    let mut space = Space::new(gantry(), vec![other], Vec::new(), MARGIN);
    let touch = space.stands_free(&[0.0, 0.05].into()).unwrap_err();
    assert_eq!(touch.pair, ["ball", "ball of the other gantry"]);
    assert!(
        space
            .goes_free(&[-0.5, 0.0].into(), &[0.5, 0.0].into())
            .is_err()
    );
    let mut search =
        Search::new(space, &[-0.5, 0.0].into(), &[[0.5, 0.0].into()], seeded(1)).unwrap();
    assert!(search.run().unwrap().points.len() > 2);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(40))]

    #[test]
    fn within_its_leeway_a_position_is_free(seed in any::<u64>(), shares in prop::array::uniform6(-1.0..=1.0_f64)) {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let model = puma();
        let at = Joints::from_fn(6, |joint| {
            let limits = &model.joints()[joint].limits;
            limits.lower + (limits.upper - limits.lower) * rng.random::<f64>()
        });
        let mut space = space(&model, &gate(), MARGIN);
        let leeway = space.leeway(&at, &[1.0; 6].into());
        prop_assert_eq!(leeway > 0.0, space.stands_free(&at).is_ok());
        let beside = Joints::from_fn(6, |joint| at[joint] + 0.999 * leeway * shares[joint]);
        prop_assert!(leeway == 0.0 || space.stands_free(&beside).is_ok());
    }
}
