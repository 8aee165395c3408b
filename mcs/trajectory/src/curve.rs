//! Where the tool's origin goes: straight pieces and arcs of circles, one after the other without a corner.
//!
//! Places are in m, in the base frame. The progress `s` along a curve goes from 0 to 1 in proportion to its length.

use nalgebra::{Unit, UnitQuaternion, Vector3};

/// An arch has two posts, two corners and a beam.
const PIECES: usize = 5;
/// Shorter than this (m) is no way.
const NO_WAY: f64 = 1e-9;
/// How different the distances of both ends of an arc from its centre may be, m; the centre is moved so far.
const OFF_CENTRE: f64 = 1e-3;
/// Three points whose triangle is flatter than this (its height as a share of its base) lie on one line.
const FLAT: f64 = 1e-6;

/// A curve of the tool's origin.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Curve {
    pieces: [Piece; PIECES],
    /// How many pieces there are.
    count: usize,
    length: f64,
}

/// A piece of a curve.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Piece {
    /// How far along the curve it begins, m.
    begin: f64,
    length: f64,
    shape: Shape,
}

#[derive(Debug, Clone, Copy, PartialEq)]
enum Shape {
    Line {
        from: Vector3<f64>,
        direction: Vector3<f64>,
    },
    Arc {
        centre: Vector3<f64>,
        /// From the centre to where it begins.
        spoke: Vector3<f64>,
        axis: Unit<Vector3<f64>>,
    },
}

/// Why there is no such curve.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum CurveError {
    /// A number that is not finite.
    #[error("a number of the path is not finite")]
    NotFinite,
    /// No circle goes through three points on one line.
    #[error(
        "no arc leads through the point: it lies on one straight line with both ends, or on one of them; take a straight line, or another point"
    )]
    Straight,
    /// The ends are not equally far from the centre.
    #[error(
        "the centre of the arc is {from:.4} m from its start and {to:.4} m from its end; give one that is as far from both"
    )]
    OffCentre {
        /// Distance from the start, m.
        from: f64,
        /// Distance from the end, m.
        to: f64,
    },
    /// Start, centre and end lie on one line, so that the arc could lie in any plane.
    #[error(
        "the arc about this centre is a half circle, a whole one or none, and so could lie in any plane; give a point on the way instead"
    )]
    NoPlane,
    /// An arch without a height.
    #[error("the height of an arch is above 0 m, not {given}")]
    Height {
        /// What was given, m.
        given: f64,
    },
    /// An arch without corners.
    #[error("the corners of an arch have a radius above 0 m, not {given}")]
    Corner {
        /// What was given, m.
        given: f64,
    },
    /// An arch from where to where the tool is above or below.
    #[error(
        "the target of the arch lies right above or below its start, and so it has no way across; take a straight line"
    )]
    Upright,
}

/// Place, derivative and second derivative by the progress, m.
pub type Jet = [Vector3<f64>; 3];

impl Curve {
    fn empty() -> Self {
        let shape = Shape::Line {
            from: Vector3::zeros(),
            direction: Vector3::zeros(),
        };
        let none = Piece {
            begin: 0.0,
            length: 0.0,
            shape,
        };
        Self {
            pieces: [none; PIECES],
            count: 0,
            length: 0.0,
        }
    }

    /// The same curve and a piece more, if that has a length; there is room for it.
    fn with(mut self, length: f64, shape: Shape) -> Self {
        if let (true, Some(piece)) = (length > NO_WAY, self.pieces.get_mut(self.count)) {
            *piece = Piece {
                begin: self.length,
                length,
                shape,
            };
            self.count += 1;
            self.length += length;
        }
        self
    }

    fn with_line(self, from: Vector3<f64>, by: Vector3<f64>) -> Self {
        let length = by.norm();
        let direction = by / length.max(NO_WAY);
        self.with(length, Shape::Line { from, direction })
    }

    fn with_arc(
        self,
        (centre, spoke): (Vector3<f64>, Vector3<f64>),
        axis: Unit<Vector3<f64>>,
        angle: f64,
    ) -> Self {
        let arc = Shape::Arc {
            centre,
            spoke,
            axis,
        };
        self.with(angle * spoke.norm(), arc)
    }

    /// The straight line between two places. One of no length stays at its start.
    #[must_use]
    pub fn line(from: Vector3<f64>, to: Vector3<f64>) -> Self {
        let mut curve = Self::empty();
        curve.pieces[0].shape = Shape::Line {
            from,
            direction: Vector3::zeros(),
        };
        curve.with_line(from, to - from)
    }

    /// The arc of a circle from one place through another to a third.
    ///
    /// # Errors
    /// [`CurveError::Straight`] or [`CurveError::NotFinite`].
    pub fn through(
        from: Vector3<f64>,
        via: Vector3<f64>,
        to: Vector3<f64>,
    ) -> Result<Self, CurveError> {
        finite(&[from, via, to])?;
        let (a, b) = (via - from, to - from);
        let normal = a.cross(&b);
        let longest = a.norm().max(b.norm()).max((b - a).norm());
        // The area is half of the base times the height.
        if normal.norm() <= FLAT * longest * longest || b.norm() <= NO_WAY {
            return Err(CurveError::Straight);
        }
        let square = normal.norm_squared();
        let to_centre = (b.cross(&normal) * a.norm_squared() - a.cross(&normal) * b.norm_squared())
            / (2.0 * square);
        // The turn from the start to the point on the way has the sense of the normal.
        let axis = Unit::new_normalize(normal);
        let spoke = -to_centre;
        let angle = turn_about(&axis, &spoke, &(b - to_centre));
        Ok(Self::empty().with_arc((from + to_centre, spoke), axis, angle))
    }

    /// The arc of a circle about a centre from one place to another, the shorter way round or the `longer` one.
    ///
    /// # Errors
    /// [`CurveError::OffCentre`], [`CurveError::NoPlane`] or [`CurveError::NotFinite`].
    pub fn about(
        from: Vector3<f64>,
        centre: Vector3<f64>,
        to: Vector3<f64>,
        longer: bool,
    ) -> Result<Self, CurveError> {
        finite(&[from, centre, to])?;
        let (near, far) = ((from - centre).norm(), (to - centre).norm());
        if (near - far).abs() > OFF_CENTRE || near <= NO_WAY {
            return Err(CurveError::OffCentre {
                from: near,
                to: far,
            });
        }
        let normal = (from - centre).cross(&(to - centre));
        if normal.norm() <= FLAT * near * far {
            return Err(CurveError::NoPlane);
        }
        // Along the chord, to where both are equally far.
        let chord = to - from;
        let excess = (to - centre).norm_squared() - (from - centre).norm_squared();
        let centre = centre + chord * (0.5 * excess / chord.norm_squared());
        let sense = if longer { -1.0 } else { 1.0 };
        let axis = Unit::new_normalize(normal * sense);
        let spoke = from - centre;
        let angle = turn_about(&axis, &spoke, &(to - centre));
        Ok(Self::empty().with_arc((centre, spoke), axis, angle))
    }

    /// Over an obstacle: up, across and down, with `z` of the base frame up. The beam is `height` (m) above the higher end.
    /// Corners are quarters of circles of a radius, m; as large as there is room where none is given, and no larger.
    ///
    /// # Errors
    /// [`CurveError::Height`], [`CurveError::Corner`], [`CurveError::Upright`] or [`CurveError::NotFinite`].
    pub fn arch(
        from: Vector3<f64>,
        to: Vector3<f64>,
        height: f64,
        corner: Option<f64>,
    ) -> Result<Self, CurveError> {
        finite(&[from, to])?;
        if !(height.is_finite() && height > NO_WAY) {
            return Err(CurveError::Height { given: height });
        }
        let corner = corner.unwrap_or(f64::MAX);
        if !(corner.is_finite() && corner > NO_WAY) {
            return Err(CurveError::Corner { given: corner });
        }
        let up = Vector3::z();
        let way = to - from;
        let across = way - up * way.z;
        let distance = across.norm();
        if distance <= NO_WAY {
            return Err(CurveError::Upright);
        }
        let ahead = across / distance;
        let (rise, fall) = (height + way.z.max(0.0), height - way.z.min(0.0));
        let [first, second] = [rise, fall].map(|post| corner.min(post).min(0.5 * distance));
        let axis = Unit::new_normalize(up.cross(&ahead));
        let quarter = std::f64::consts::FRAC_PI_2;
        let top = from + up * rise;
        let (begins, ends) = (top + ahead * first, top + ahead * (distance - second));
        Ok(Self::empty()
            .with_line(from, up * (rise - first))
            .with_arc((begins - up * first, -ahead * first), axis, quarter)
            .with_line(begins, ends - begins)
            .with_arc((ends - up * second, up * second), axis, quarter)
            .with_line(to + up * (fall - second), -up * (fall - second)))
    }

    /// How long it is, m.
    #[must_use]
    pub fn length(&self) -> f64 {
        self.length
    }

    fn pieces(&self) -> &[Piece] {
        &self.pieces[..self.count.clamp(1, PIECES)]
    }

    /// The place at progress `s`, and its derivatives by the progress.
    #[must_use]
    pub fn at(&self, s: f64) -> Jet {
        let along = s.clamp(0.0, 1.0) * self.length;
        let begun = |piece: &&Piece| piece.begin <= along;
        let piece = self.pieces().iter().rev().find(begun);
        let piece = piece.unwrap_or(&self.pieces[0]);
        let (way, scale) = (along - piece.begin, self.length);
        match piece.shape {
            Shape::Line { from, direction } => {
                [from + direction * way, direction * scale, Vector3::zeros()]
            }
            Shape::Arc {
                centre,
                spoke,
                axis,
            } => {
                let radius = spoke.norm();
                let turned = UnitQuaternion::from_axis_angle(&axis, way / radius) * spoke;
                let ahead = axis.cross(&turned) / radius;
                let inward = -turned / (radius * radius);
                [centre + turned, ahead * scale, inward * (scale * scale)]
            }
        }
    }

    /// The largest curvature between two places of the progress, 1/m.
    #[must_use]
    pub fn curvature(&self, from: f64, to: f64) -> f64 {
        let (from, to) = (from * self.length, to * self.length);
        let touched = |piece: &&Piece| piece.begin <= to && piece.begin + piece.length >= from;
        let touched = self.pieces().iter().filter(touched);
        touched.fold(0.0, |most: f64, piece| match piece.shape {
            Shape::Line { .. } => most,
            Shape::Arc { spoke, .. } => most.max(1.0 / spoke.norm()),
        })
    }

    /// Whether it is one line or one arc, so that its curvature is the same all along.
    #[must_use]
    pub fn is_even(&self) -> bool {
        self.count <= 1
    }
}

/// The turn about an axis that takes one spoke's direction into that of another, above 0 up to a whole turn, rad.
fn turn_about(axis: &Unit<Vector3<f64>>, from: &Vector3<f64>, to: &Vector3<f64>) -> f64 {
    let angle = axis.dot(&from.cross(to)).atan2(from.dot(to));
    if angle > 0.0 {
        angle
    } else {
        angle + std::f64::consts::TAU
    }
}

fn finite(places: &[Vector3<f64>]) -> Result<(), CurveError> {
    let numbers = places.iter().flat_map(|place| place.iter());
    match numbers.clone().all(|number| number.is_finite()) {
        true => Ok(()),
        false => Err(CurveError::NotFinite),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn place() -> impl Strategy<Value = Vector3<f64>> {
        prop::array::uniform3(-1.0..1.0_f64).prop_map(Vector3::from)
    }

    /// That a curve has no gap and no corner, has its derivatives, and is as long as it says.
    fn check(curve: &Curve, from: &Vector3<f64>, to: &Vector3<f64>) {
        let steps = 2_000_u32;
        let h = 1.0 / f64::from(steps);
        let mut before = curve.at(0.0);
        assert!((before[0] - from).norm() < 1e-9);
        assert!((curve.at(1.0)[0] - to).norm() < 1e-9);
        let mut length = 0.0;
        for step in 1..=steps {
            let now = curve.at(f64::from(step) * h);
            length += (now[0] - before[0]).norm();
            assert!((now[1].norm() - curve.length()).abs() < 1e-9);
            // The slope bends no more than the curvature says: no corner.
            let most = curve.curvature(0.0, 1.0) * curve.length().powi(2) * h;
            assert!((now[1] - before[1]).norm() <= most * (1.0 + 1e-6) + 1e-9);
            let mean = (now[0] - before[0]) / h;
            assert!((mean - 0.5 * (now[1] + before[1])).norm() <= most + 1e-6);
            before = now;
        }
        assert!((length - curve.length()).abs() < 1e-4 * (1.0 + length));
    }

    proptest! {
        #[test]
        fn an_arc_goes_through_the_point_at_one_distance_from_its_centre(a in place(), b in place(), c in place()) {
            let normal = (b - a).cross(&(c - a));
            prop_assume!(normal.norm() > 0.05);
            let curve = Curve::through(a, b, c).unwrap();
            check(&curve, &a, &c);
            let near = (0..=2_000).map(|step| (curve.at(f64::from(step) / 2_000.0)[0] - b).norm());
            prop_assert!(near.fold(f64::INFINITY, f64::min) < 1e-3 * curve.length());
            for step in 0..=10 {
                let place = curve.at(f64::from(step) / 10.0)[0];
                prop_assert!((place - a).dot(&normal).abs() < 1e-9);
            }
            // The way back is the same arc.
            let back = Curve::through(c, b, a).unwrap();
            prop_assert!((back.at(0.3)[0] - curve.at(0.7)[0]).norm() < 1e-8);
        }

        #[test]
        fn an_arc_about_a_centre_keeps_its_radius_and_both_ways_make_a_circle(
            a in place(), centre in place(), axis in place(), angle in 0.1..3.0_f64,
        ) {
            let spoke = a - centre;
            let axis = axis.cross(&spoke);
            prop_assume!(spoke.norm() > 0.05 && axis.norm() > 0.01);
            let turn = UnitQuaternion::from_axis_angle(&Unit::new_normalize(axis), angle);
            let to = centre + turn * spoke;
            let [short, long] = [false, true].map(|longer| Curve::about(a, centre, to, longer).unwrap());
            check(&short, &a, &to);
            check(&long, &a, &to);
            prop_assert!((short.length() - angle * spoke.norm()).abs() < 1e-9);
            let circle = std::f64::consts::TAU * spoke.norm();
            prop_assert!((short.length() + long.length() - circle).abs() < 1e-9);
            for step in 0..=10 {
                let radius = (long.at(f64::from(step) / 10.0)[0] - centre).norm();
                prop_assert!((radius - spoke.norm()).abs() < 1e-9);
            }
        }

        #[test]
        fn an_arch_rises_falls_and_stays_below_its_beam(
            a in place(), b in place(), height in 0.01..0.5_f64, corner in prop::option::of(0.005..1.0_f64),
        ) {
            prop_assume!((b - a).xy().norm() > 0.02);
            let curve = Curve::arch(a, b, height, corner).unwrap();
            check(&curve, &a, &b);
            let beam = a.z.max(b.z) + height;
            let mut highest = f64::NEG_INFINITY;
            for step in 0..=2_000 {
                let place = curve.at(f64::from(step) / 2_000.0)[0];
                highest = highest.max(place.z);
                prop_assert!(place.z <= beam + 1e-9 && place.z >= a.z.min(b.z) - 1e-9);
                // In the upright plane of both ends.
                let way = (b - a).xy();
                let off = (place - a).xy();
                prop_assert!((way.x * off.y - way.y * off.x).abs() < 1e-9);
            }
            prop_assert!(highest > beam - 1e-3);
            // It leaves and comes upright.
            let [up, down] = [0.0, 1.0].map(|s| curve.at(s)[1].normalize().z);
            prop_assert!((up - 1.0).abs() < 1e-6 && (down + 1.0).abs() < 1e-6);
        }
    }

    #[test]
    fn what_is_no_arc_and_no_arch_is_named() {
        let [o, x] = [Vector3::zeros(), Vector3::x()];
        let straight = Err(CurveError::Straight);
        assert_eq!(Curve::through(o, x * 0.3, x), straight);
        assert_eq!(Curve::through(o, o, x), straight);
        assert_eq!(Curve::through(o, x, o), straight);
        assert_eq!(Curve::about(o, x, x * 2.0, false), Err(CurveError::NoPlane));
        let off = Curve::about(o, x, Vector3::new(1.0, 0.9, 0.0), false);
        assert!(matches!(off, Err(CurveError::OffCentre { .. })));
        let nan = Vector3::new(0.0, f64::NAN, 0.0);
        assert_eq!(Curve::through(o, nan, x), Err(CurveError::NotFinite));
        assert_eq!(
            Curve::arch(o, Vector3::z(), 0.1, None),
            Err(CurveError::Upright)
        );
        for given in [0.0, -0.1, f64::INFINITY] {
            let refused = Curve::arch(o, x, given, None);
            assert_eq!(refused, Err(CurveError::Height { given }));
            let refused = Curve::arch(o, x, 0.1, Some(given));
            assert_eq!(refused, Err(CurveError::Corner { given }));
        }
    }
}
