//! Convex forms by their corners: how far two of them are apart, and few corners around many points. Plain functions of
//! numbers.

use nalgebra::Vector3;
use tinyvec::ArrayVec;

/// A hull has so many corners at most: each is looked at in every step of a distance.
const MOST_CORNERS: usize = 64;
/// What stands out by less than this, m, needs no corner.
const FINE: f64 = 1e-4;
/// A distance is found in fewer steps than this; after them it is what is certain.
const MOST_STEPS: usize = 64;
/// A distance is as good as this, as a share of the size of what it is between.
const CLOSE: f64 = 1e-10;

type Point = Vector3<f64>;

/// All points within a distance of a convex form with few corners, about the middle of the box around it.
#[derive(Debug, Clone, PartialEq)]
pub struct Hull {
    corners: Vec<Point>,
    rounding: f64,
    radius: f64,
    half: Point,
}

impl Hull {
    /// What holds all of these points (m), and where its middle is among them; `None` when there are none, or when one is
    /// not finite. What its corners leave out is within its rounding.
    #[must_use]
    pub fn around(points: &[Point]) -> Option<(Point, Self)> {
        if points.is_empty() || !points.iter().flatten().all(|number| number.is_finite()) {
            return None;
        }
        let (mut corners, rounding) = few(points);
        let end = |least: fn(f64, f64) -> f64| {
            let folded = corners.iter().copied().reduce(|a, b| a.zip_map(&b, least));
            folded.unwrap_or_default()
        };
        let (low, high) = (end(f64::min), end(f64::max));
        let middle = (low + high) * 0.5;
        for corner in &mut corners {
            *corner -= middle;
        }
        let farthest = corners.iter().map(Vector3::norm).fold(0.0, f64::max);
        let hull = Self {
            rounding,
            radius: farthest + rounding,
            half: ((high - low) * 0.5).add_scalar(rounding),
            corners,
        };
        Some((middle, hull))
    }

    /// Its corners, m.
    #[must_use]
    pub fn corners(&self) -> &[Point] {
        &self.corners
    }

    /// How far it goes beyond its corners, m.
    #[must_use]
    pub fn rounding(&self) -> f64 {
        self.rounding
    }

    /// The radius of the ball around it, m.
    #[must_use]
    pub fn radius(&self) -> f64 {
        self.radius
    }

    /// Half the edge lengths of the box around it, m.
    #[must_use]
    pub fn half(&self) -> &Point {
        &self.half
    }

    /// The triangles of its surface by the numbers of their corners, counterclockwise as seen from outside. Where more than
    /// three corners lie in a plane, triangles overlap there. A form without a volume has none.
    #[must_use]
    pub fn triangles(&self) -> Vec<[usize; 3]> {
        let corners = &self.corners;
        let flat = 1e-6 * self.radius;
        let mut all = Vec::new();
        for (i, a) in corners.iter().enumerate() {
            for (j, b) in corners.iter().enumerate().skip(i + 1) {
                for (k, c) in corners.iter().enumerate().skip(j + 1) {
                    let Some(normal) = (b - a).cross(&(c - a)).try_normalize(0.0) else {
                        continue;
                    };
                    let out = corners.iter().map(|corner| normal.dot(&(corner - a)));
                    let (low, high) = out.fold((0.0, 0.0), |(low, high): (f64, f64), out| {
                        (low.min(out), high.max(out))
                    });
                    match (low < -flat, high > flat) {
                        (true, false) => all.push([i, j, k]),
                        (false, true) => all.push([i, k, j]),
                        _ => {}
                    }
                }
            }
        }
        all
    }
}

/// The point that is farthest in a direction.
pub(crate) fn farthest(points: &[Point], direction: &Point) -> Point {
    let mut best = (f64::NEG_INFINITY, Point::zeros());
    for point in points {
        let far = point.dot(direction);
        if far > best.0 {
            best = (far, *point);
        }
    }
    best.1
}

/// Few of the points, and how far (m) the others are at most from the convex form with these corners: the one that is
/// farthest out becomes the next corner.
fn few(points: &[Point]) -> (Vec<Point>, f64) {
    let mut corners: Vec<Point> = Vec::new();
    for axis in [Point::x(), Point::y(), Point::z()] {
        for direction in [axis, -axis] {
            let corner = farthest(points, &direction);
            if !corners.contains(&corner) {
                corners.push(corner);
            }
        }
    }
    // How far out each point was when it was looked at last: with more corners it is no farther.
    let mut outside: Vec<(f64, Point)> =
        points.iter().map(|point| (f64::INFINITY, *point)).collect();
    loop {
        let (mut most, mut next) = (0.0, None);
        for (out, point) in &mut outside {
            if *out > most {
                *out = apart(|_| *point, |direction| farthest(&corners, direction)).1;
                if *out > most {
                    (most, next) = (*out, Some(*point));
                }
            }
        }
        match next {
            Some(corner) if most > FINE && corners.len() < MOST_CORNERS => corners.push(corner),
            _ => return (corners, most),
        }
        outside.retain(|(out, _)| *out > FINE);
    }
}

/// The least distance of two convex forms, m, or a little less; 0 where they touch. Each says which of its points is
/// farthest in a direction.
#[must_use]
pub fn gap(one: impl Fn(&Point) -> Point, other: impl Fn(&Point) -> Point) -> f64 {
    apart(one, other).0
}

/// The same, and one that is surely no less. After E. Gilbert, D. Johnson and S. Keerthi, IEEE Journal of Robotics and
/// Automation 4 (1988): of the differences of both forms' points, the one that is nearest to nothing.
fn apart(one: impl Fn(&Point) -> Point, other: impl Fn(&Point) -> Point) -> (f64, f64) {
    let toward = |direction: &Point| one(direction) - other(&-direction);
    let mut nearest = toward(&Point::x());
    let mut simplex = Simplex::default();
    simplex.push(nearest);
    let (mut surely, mut size) = (0.0_f64, nearest.norm());
    for _ in 0..MOST_STEPS {
        let next = toward(&-nearest);
        let fine = CLOSE * next.norm().max(size);
        if size <= fine {
            return (0.0, size);
        }
        // All of the differences are beyond the plane through this one.
        surely = surely.max(nearest.dot(&next) / size);
        if size - surely <= fine || simplex.contains(&next) {
            break;
        }
        simplex.push(next);
        let (closer, between) = nearest_of(&simplex);
        if between.len() == between.capacity() {
            return (0.0, 0.0);
        }
        // What comes no nearer is as near as numbers of this length get.
        if closer.norm() >= size {
            break;
        }
        (nearest, simplex, size) = (closer, between, closer.norm());
    }
    (surely, size)
}

/// One to four points.
type Simplex = ArrayVec<[Point; 4]>;

/// The point nearest to nothing of all between these corners, and the corners between which it is.
fn nearest_of(corners: &[Point]) -> (Point, Simplex) {
    let only = |points: &[Point]| points.iter().copied().collect::<Simplex>();
    let best = |faces: &[&[Point]]| {
        let each = faces.iter().map(|face| nearest_of(face));
        each.min_by(|one, other| one.0.norm_squared().total_cmp(&other.0.norm_squared()))
            .unwrap_or_default()
    };
    match *corners {
        [a, b] => {
            let way = b - a;
            let share = -a.dot(&way) / way.norm_squared();
            match share {
                share if share >= 1.0 => (b, only(&[b])),
                share if share > 0.0 => (a + way * share, only(corners)),
                _ => (a, only(&[a])),
            }
        }
        [a, b, c] => {
            let normal = (b - a).cross(&(c - a));
            let inside = [b.cross(&c), c.cross(&a), a.cross(&b)]
                .iter()
                .all(|side| side.dot(&normal) > 0.0);
            match inside {
                true => (
                    normal * (a.dot(&normal) / normal.norm_squared()),
                    only(corners),
                ),
                false => best(&[&[a, b], &[b, c], &[c, a]]),
            }
        }
        [a, b, c, d] => {
            let faces = [[a, b, c, d], [a, c, d, b], [a, d, b, c], [b, d, c, a]];
            // Whether nothing is on the other side of a face than the corner that is not of it, or the four are flat.
            let beyond = |[a, b, c, d]: &[Point; 4]| {
                let normal = (b - a).cross(&(c - a));
                -a.dot(&normal) * (d - a).dot(&normal) <= 0.0
            };
            let outer: ArrayVec<[&[Point]; 4]> = faces
                .iter()
                .filter(|face| beyond(face))
                .map(|face| &face[..3])
                .collect();
            match outer.is_empty() {
                true => (Point::zeros(), only(corners)),
                false => best(&outer),
            }
        }
        _ => (corners.first().copied().unwrap_or_default(), only(corners)),
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn points(
        count: impl Into<proptest::collection::SizeRange>,
    ) -> impl Strategy<Value = Vec<Point>> {
        let point = proptest::array::uniform3(-1.0..1.0_f64).prop_map(Point::from);
        proptest::collection::vec(point, count)
    }

    fn unit() -> impl Strategy<Value = Point> {
        proptest::array::uniform3(-1.0..1.0_f64)
            .prop_filter("a direction", |v| Point::from(*v).norm() > 0.1)
            .prop_map(|v| Point::from(v).normalize())
    }

    proptest! {
        #[test]
        fn a_distance_is_one_between_points_of_both_and_a_plane_keeps_them_as_far_apart(
            one in points(1..20),
            other in points(1..20),
            way in unit(),
            far in 0.0..4.0_f64,
        ) {
            let other: Vec<Point> = other.iter().map(|point| point + way * far).collect();
            let (surely, size) = apart(|d| farthest(&one, d), |d| farthest(&other, d));
            prop_assert!(surely <= size + 1e-12);
            prop_assert!(size - surely < 1e-6, "{} {}", surely, size);
            // No plane keeps them farther apart than the distance.
            let most = |points: &[Point], d: &Point| farthest(points, d).dot(d);
            let along = -(most(&one, &way) + most(&other, &-way));
            prop_assert!(along <= size + 1e-9);
        }

        #[test]
        fn a_hull_holds_every_point_and_goes_no_farther_than_its_rounding(points in points(1..400), way in unit()) {
            let (middle, hull) = Hull::around(&points).unwrap();
            prop_assert!(hull.corners().len() <= MOST_CORNERS);
            let most = farthest(&points, &way).dot(&way);
            let own = (farthest(hull.corners(), &way) + middle).dot(&way);
            prop_assert!(own <= most + 1e-12);
            prop_assert!(most <= own + hull.rounding() + 1e-9);
            for point in &points {
                prop_assert!((point - middle).norm() <= hull.radius() + 1e-9);
                prop_assert!(((point - middle).abs() - hull.half()).max() <= 1e-9);
            }
        }
    }

    #[test]
    fn a_cube_of_many_points_has_eight_corners_and_no_rounding() {
        let points: Vec<Point> = (0..1000)
            .map(|index| {
                let along = |by: i32| f64::from(index / by % 10) / 9.0;
                Point::new(along(1), along(10), along(100))
            })
            .collect();
        let (middle, hull) = Hull::around(&points).unwrap();
        assert_eq!(hull.corners().len(), 8);
        assert!(hull.rounding() < FINE);
        assert!((middle - Point::repeat(0.5)).norm() < 1e-12);
        assert!((hull.half() - Point::repeat(0.5)).norm() < 2.0 * FINE);
    }

    /// By the theorem of divergence, from its surface; triangles that overlap would count twice.
    fn volume(hull: &Hull) -> f64 {
        let corner = |at: usize| hull.corners()[at];
        let all = hull.triangles().into_iter();
        all.map(|[a, b, c]| corner(a).dot(&corner(b).cross(&corner(c))) / 6.0)
            .sum()
    }

    #[test]
    fn the_triangles_of_a_hull_enclose_its_volume_and_a_flat_one_has_none() {
        let tetrahedron = [Point::zeros(), Point::x(), Point::y(), Point::z() * 3.0];
        let (_, hull) = Hull::around(&tetrahedron).unwrap();
        assert_eq!(hull.triangles().len(), 4);
        assert!((volume(&hull) - 0.5).abs() < 1e-12);
        // An octahedron of unit half axes.
        let axes = [Point::x(), Point::y(), Point::z()];
        let corners = axes.map(|axis| [axis, -axis]).concat();
        let (_, hull) = Hull::around(&corners).unwrap();
        assert_eq!(hull.triangles().len(), 8);
        assert!((volume(&hull) - 4.0 / 3.0).abs() < 1e-12);
        let square = [
            Point::zeros(),
            Point::x(),
            Point::y(),
            Point::x() + Point::y(),
        ];
        assert_eq!(
            Hull::around(&square).unwrap().1.triangles(),
            Vec::<[usize; 3]>::new()
        );
    }

    #[test]
    fn what_is_no_form_has_no_hull_and_a_flat_one_or_one_of_a_point_has() {
        assert_eq!(Hull::around(&[]), None);
        assert_eq!(Hull::around(&[Point::new(0.0, f64::NAN, 0.0)]), None);
        let (middle, point) = Hull::around(&[Point::x(); 5]).unwrap();
        assert_eq!(
            (middle, point.corners().len(), point.radius()),
            (Point::x(), 1, 0.0)
        );
        let square = [
            Point::zeros(),
            Point::x(),
            Point::y(),
            Point::x() + Point::y(),
        ];
        let (_, flat) = Hull::around(&square).unwrap();
        let above = |_: &Point| Point::new(0.1, 0.1, 0.3);
        assert!((gap(above, |d| farthest(flat.corners(), d)) - 0.3).abs() < 1e-9);
    }
}
