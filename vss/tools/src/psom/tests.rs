//! Known answers of parameterized self-organizing maps: polynomials, published errors, and the derivatives.
use super::*;
use proptest::prelude::*;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Rows of a full grid: parameters, then what `map` makes of them.
fn rows(axes: &[Vec<f64>], map: impl Fn(&[f64]) -> Vec<f64>) -> (Vec<f64>, usize) {
    let mut points = vec![Vec::new()];
    for axis in axes {
        let longer = |point: &Vec<f64>| {
            let point = point.clone();
            axis.iter().map(move |s| [&point[..], &[*s]].concat())
        };
        points = points.iter().flat_map(longer).collect();
    }
    let width = axes.len() + map(&points[0]).len();
    let all = points
        .iter()
        .flat_map(|point| [&point[..], &map(point)].concat());
    (all.collect(), width)
}

fn trained(axes: &[Vec<f64>], map: impl Fn(&[f64]) -> Vec<f64>) -> Psom {
    let (rows, width) = rows(axes, map);
    Psom::train(&rows, width, axes.len()).unwrap()
}

fn even(n: usize, from: f64, to: f64) -> Vec<f64> {
    (0..n)
        .map(|i| from + (to - from) * i as f64 / (n - 1) as f64)
        .collect()
}

/// A polynomial of degree 2 in each of three parameters, and the parameters themselves.
fn quadratic(s: &[f64]) -> Vec<f64> {
    let [x, y, z] = [s[0], s[1], s[2]];
    vec![
        x,
        y,
        z,
        1.0 + 2.0 * x - y * y + 0.5 * x * x * z * z,
        x * y * z - 3.0 * z * z * y,
    ]
}

#[test]
fn a_polynomial_of_its_degree_is_reproduced_everywhere_outside_the_grid_too() {
    let map = trained(
        &[
            vec![-1.0, 0.1, 1.0],
            vec![0.0, 0.5, 2.0],
            even(3, -2.0, 1.0),
        ],
        quadratic,
    );
    let mut scratch = map.scratch();
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    for _ in 0..200 {
        let s: Vec<f64> = (0..3).map(|_| rng.random_range(-3.0..3.0)).collect();
        for (found, expected) in map.at(&mut scratch, &s).iter().zip(quadratic(&s)) {
            assert!(
                (found - expected).abs() < 1e-9 * (1.0 + expected.abs()),
                "{s:?}"
            );
        }
    }
}

#[test]
fn the_map_goes_through_every_training_vector_whatever_the_order_of_the_rows() {
    let axes = [vec![0.0, 0.3, 1.0], vec![-1.0, 2.0]];
    let (table, width) = rows(&axes, |s| vec![s[0].sin(), s[1].exp(), s[0] * s[1]]);
    let mut shuffled: Vec<&[f64]> = table.chunks(width).collect();
    shuffled.reverse();
    shuffled.swap(1, 3);
    let map = Psom::train(&shuffled.concat(), width, 2).unwrap();
    let mut scratch = map.scratch();
    for row in table.chunks(width) {
        let found = map.at(&mut scratch, &row[..2]);
        for (found, expected) in found.iter().zip(&row[2..]) {
            assert!((found - expected).abs() < 1e-14);
        }
    }
    // Saved and trained anew it is the same map.
    let saved: Vec<f64> = map
        .nodes()
        .flat_map(|(at, vector)| [&at[..], vector].concat())
        .collect();
    assert_eq!(Psom::train(&saved, width, 2).unwrap(), map);
}

proptest! {
    #[test]
    fn the_jacobian_is_the_derivative_at_nodes_too(s in prop::collection::vec(-1.0..1.0_f64, 3), node in any::<bool>()) {
        let axes = [even(4, -1.0, 1.0), even(3, -1.0, 1.0), even(2, -1.0, 1.0)];
        let map = trained(&axes, |s| vec![(s[0] + s[1]).sin(), (s[1] * s[2]).cos(), s[0] * s[2]]);
        let s = if node { vec![axes[0][1], 0.0, 1.0] } else { s };
        let mut scratch = map.scratch();
        let mut jacobian = [0.0; 9];
        map.jacobian(&mut scratch, &s, &mut jacobian);
        for axis in 0..3 {
            let mut there = |by: f64| {
                let mut moved = s.clone();
                moved[axis] += by;
                map.at(&mut scratch, &moved).to_vec()
            };
            let (after, before) = (there(1e-5), there(-1e-5));
            for component in 0..3 {
                let slope = (after[component] - before[component]) / 2e-5;
                prop_assert!((jacobian[3 * component + axis] - slope).abs() < 1e-8);
            }
        }
    }

    /// Every direction: from any three independent components to all the others.
    #[test]
    fn a_vector_of_the_map_is_completed_from_part_of_it(s in prop::collection::vec(-0.9..0.9_f64, 3), which in 0..2_usize) {
        let axes = [even(3, -1.0, 1.0), even(3, -1.0, 1.0), even(3, -1.0, 1.0)];
        let map = trained(&axes, |s| {
            vec![s[0], s[1], s[2], s[0] + 0.3 * s[1] * s[2], 2.0 * s[1] - 0.2 * s[0] * s[0], s[2] + 0.1 * s[0] * s[1]]
        });
        let mut scratch = map.scratch();
        let whole = map.at(&mut scratch, &s).to_vec();
        let weights = [[1.0, 1.0, 1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 4.0, 0.5, 1.0]][which];
        let known: Vec<f64> = whole.iter().zip(weights).map(|(x, p)| if p > 0.0 { *x } else { f64::NAN }).collect();
        let found = map.complete(&mut scratch, &known, &weights, &Search::default()).unwrap();
        prop_assert!(found.error < 1e-20 && found.good, "{}", found.error);
        for (found, expected) in found.values.iter().zip(&whole) {
            prop_assert!((found - expected).abs() < 1e-9);
        }
        for (found, expected) in found.parameters.iter().zip(&s) {
            prop_assert!((found - expected).abs() < 1e-9);
        }
    }

    /// Nothing on a fine net of points is nearer.
    #[test]
    fn what_is_found_for_noisy_vectors_is_the_nearest_point(noise in prop::collection::vec(-0.2..0.2_f64, 3), s in prop::collection::vec(0.1..0.9_f64, 2)) {
        let axes = [even(3, 0.0, 1.0), even(3, 0.0, 1.0)];
        let bowl = |s: &[f64]| vec![s[0], s[1], (s[0] - 0.5).powi(2) + 0.5 * s[1]];
        let map = trained(&axes, bowl);
        let mut scratch = map.scratch();
        let known: Vec<f64> = bowl(&s).iter().zip(&noise).map(|(x, n)| x + n).collect();
        let found = map.complete(&mut scratch, &known, &[1.0, 2.0, 3.0], &Search::default()).unwrap().error;
        for i in -10..=30 {
            for j in -10..=30 {
                let at = bowl(&[f64::from(i) * 0.05, f64::from(j) * 0.05]);
                let there = 0.5 * ((at[0] - known[0]).powi(2) + 2.0 * (at[1] - known[1]).powi(2) + 3.0 * (at[2] - known[2]).powi(2));
                prop_assert!(found <= there + 1e-12);
            }
        }
    }
}

#[test]
fn a_vector_far_from_the_map_has_a_large_error_and_is_not_good() {
    let map = trained(&[even(3, 0.0, 1.0)], |s| vec![s[0], s[0] * s[0]]);
    let mut scratch = map.scratch();
    let found = map
        .complete(&mut scratch, &[0.5, 3.0], &[1.0, 1.0], &Search::default())
        .unwrap();
    assert!(!found.good && found.error > 0.5, "{found:?}");
    let near = map
        .complete(&mut scratch, &[0.5, 0.25], &[1.0, 1.0], &Search::default())
        .unwrap();
    assert!(near.good && near.error < 1e-20, "{near:?}");
}

#[test]
fn what_is_not_known_or_no_number_is_refused() {
    let map = trained(&[even(2, 0.0, 1.0)], |s| vec![s[0], 1.0 - s[0]]);
    let mut scratch = map.scratch();
    let mut ask = |x: [f64; 2], p: [f64; 2]| {
        let found = map.complete(&mut scratch, &x, &p, &Search::default());
        found.map(|found| found.error)
    };
    assert_eq!(ask([1.0, 1.0], [0.0, 0.0]), Err(Unknown::Nothing));
    assert_eq!(ask([1.0, 1.0], [1.0, -1.0]), Err(Unknown::Number(2)));
    assert_eq!(ask([f64::NAN, 1.0], [1.0, 1.0]), Err(Unknown::Number(1)));
    assert!(ask([f64::NAN, 0.3], [0.0, 1.0]).is_ok());
}

/// The hand of a PUMA 560 without its wrist, m: three joints, link lengths 0.43 m.
fn hand(q: &[f64]) -> [f64; 3] {
    let reach = 0.4318 * q[1].cos() + 0.4318 * (q[1] + q[2]).sin();
    let height = 0.4318 * q[1].sin() - 0.4318 * (q[1] + q[2]).cos();
    let side = 0.15;
    [
        q[0].cos() * reach - q[0].sin() * side,
        q[0].sin() * reach + q[0].cos() * side,
        height,
    ]
}

/// Mean error of the inverse kinematics over random goals, m.
fn error_with(axes: &[Vec<f64>], ends: &[(f64, f64); 3]) -> f64 {
    let map = trained(axes, |q| [q, &hand(q)[..]].concat());
    let mut scratch = map.scratch();
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    let count = 200;
    let total: f64 = (0..count)
        .map(|_| {
            let q: Vec<f64> = ends
                .iter()
                .map(|(low, high)| rng.random_range(*low..*high))
                .collect();
            let goal = hand(&q);
            let known = [0.0, 0.0, 0.0, goal[0], goal[1], goal[2]];
            let weights = [0.0, 0.0, 0.0, 1.0, 1.0, 1.0];
            let found = map
                .complete(&mut scratch, &known, &weights, &Search::default())
                .unwrap();
            let there = hand(&found.values[..3]);
            (0..3)
                .map(|axis| (there[axis] - goal[axis]).powi(2))
                .sum::<f64>()
                .sqrt()
        })
        .sum();
    total / f64::from(count)
}

/// Walter 1996, table 8.3: 17, 2.4 and 0.11 mm for 3, 4 and 5 nodes an axis; less with Chebyshev nodes. His workspace is not
/// told exactly, so the order of size and how it falls are what must agree.
#[test]
fn inverse_kinematics_of_three_joints_fall_as_published_with_the_nodes() {
    let ends = [(-1.3, 0.2), (-0.3, 1.0), (-2.2, -1.0)];
    let with = |n: usize| error_with(&ends.map(|(low, high)| even(n, low, high)), &ends);
    let [three, four, five] = [3, 4, 5].map(with);
    assert!((0.002..0.034).contains(&three), "{three}");
    assert!(four < three / 4.0 && four < 0.0024, "{four}");
    assert!(five < four / 4.0 && five < 0.0005, "{five}");
    let zeros = error_with(&ends.map(|(low, high)| chebyshev(4, low, high)), &ends);
    assert!(zeros < four, "{zeros} {four}");
}

/// A picture of a board 0.4 m wide, seen in perspective, mapped to the board.
#[test]
fn a_board_of_four_by_four_nodes_is_mapped_within_a_twentieth_of_a_millimetre() {
    let view = |s: &[f64]| {
        let (x, y) = (s[0], s[1]);
        let depth = 1.0 + 0.3 * x - 0.2 * y;
        vec![
            x,
            y,
            320.0 + 800.0 * (x - 0.1 * y) / depth,
            240.0 + 780.0 * (y + 0.05 * x) / depth,
        ]
    };
    let map = trained(&[even(4, 0.0, 0.4), even(4, 0.0, 0.4)], view);
    let mut scratch = map.scratch();
    let mut worst = 0.0_f64;
    for i in 0..=20 {
        for j in 0..=20 {
            let at = [f64::from(i) * 0.02, f64::from(j) * 0.02];
            let mut known = view(&at);
            known[..2].fill(0.0);
            let weights = [0.0, 0.0, 1.0, 1.0];
            let found = map
                .complete(&mut scratch, &known, &weights, &Search::default())
                .unwrap();
            worst = worst.max((found.values[0] - at[0]).hypot(found.values[1] - at[1]));
        }
    }
    assert!(worst < 50e-6, "{worst}");
}

#[test]
fn a_local_map_of_two_nodes_a_side_is_multilinear_and_one_of_all_nodes_is_the_map() {
    let axes = [even(5, 0.0, 4.0), even(5, 0.0, 4.0)];
    let map = trained(&axes, |s| vec![s[0], s[1], (s[0] - 1.0).powi(2) + s[1]]);
    let search = Search::default();
    let ask = |size: usize| {
        let found = map.complete_locally(size, &[2.5, 1.25, 0.0], &[1.0, 1.0, 0.0], &search);
        found.unwrap().0[2]
    };
    // Between the nodes 2 and 3 the square is the line from 1 to 4.
    assert!((ask(2) - (2.5 + 1.25)).abs() < 1e-9, "{}", ask(2));
    assert!((ask(5) - (2.25 + 1.25)).abs() < 1e-9, "{}", ask(5));
    assert!((ask(3) - (2.25 + 1.25)).abs() < 1e-9, "{}", ask(3));
}

#[test]
fn tables_that_are_no_full_grid_are_refused_by_row_or_place() {
    let train = |rows: &[f64], width, parameters| Psom::train(rows, width, parameters).unwrap_err();
    let grid = [0.0, 0.0, 1.0, 0.0, 1.0, 2.0, 1.0, 0.0, 3.0, 1.0, 1.0, 4.0];
    assert_eq!(train(&grid, 3, 0), TrainError::Parameters(0));
    assert_eq!(train(&grid, 3, 7), TrainError::Parameters(7));
    assert_eq!(train(&grid, 3, 3), TrainError::Components(3));
    assert_eq!(
        train(&[0.0, f64::NAN, 1.0, 1.0], 2, 1),
        TrainError::Number(1)
    );
    assert_eq!(train(&[1.0, 2.0, 1.0, 3.0], 2, 1), TrainError::OneNode(1));
    let missing = TrainError::Missing {
        nodes: vec![2, 2],
        missing: vec![1.0, 1.0],
    };
    assert_eq!(train(&grid[..9], 3, 2), missing);
    let twice = [&grid[..], &[1.0, 0.0, 9.0]].concat();
    assert_eq!(train(&twice, 3, 2), TrainError::Twice(3, 5));
    // Two hundred rows on a diagonal would be a grid of forty thousand.
    let diagonal: Vec<f64> = (0..200)
        .flat_map(|i| [f64::from(i), f64::from(i), 0.0])
        .collect();
    let TrainError::Missing { missing, .. } = train(&diagonal, 3, 2) else {
        panic!("a hole");
    };
    assert_eq!(missing, [0.0, 1.0]);
}

#[test]
fn chebyshev_nodes_are_the_zeros_of_the_polynomial() {
    let nodes = chebyshev(5, -1.0, 1.0);
    assert!(nodes.is_sorted());
    for x in &nodes {
        assert!((16.0 * x.powi(5) - 20.0 * x.powi(3) + 5.0 * x).abs() < 1e-12);
    }
    let moved = chebyshev(2, 0.0, 2.0);
    assert!(
        (moved[0] - (1.0 - 0.5_f64.sqrt())).abs() < 1e-12
            && (moved[1] - (1.0 + 0.5_f64.sqrt())).abs() < 1e-12
    );
}
