//! Whether points lie on a curve of the third order (a twisted cubic). From points on such a curve that also passes through
//! the camera no camera follows: many see the same picture (R. Hartley and A. Zisserman, Multiple View Geometry, 2004,
//! section 22.1).

use nalgebra::{Matrix3, Point3, SMatrix, SVector, Vector3};

/// Terms of a quadric.
const TERMS: usize = 10;
/// A twisted cubic is what three quadrics share.
const QUADRICS: usize = 3;
/// Fewer points lie on some curve by chance.
const FEWEST: usize = 12;
/// What a quadric leaves (rms, for positions scaled to 1) when the points lie on it.
const ON_QUADRIC: f64 = 1e-3;
/// The camera's centre, which is known less well, is on it within this part of its distance.
const NEAR_QUADRIC: f64 = 0.05;

/// A twisted cubic.
pub(super) struct Curve {
    middle: Vector3<f64>,
    /// Scales positions about the middle to a mean square of 1 along each axis.
    scale: Matrix3<f64>,
    quadrics: [SVector<f64, TERMS>; QUADRICS],
}

impl Curve {
    /// The curve that all points lie on, if they lie on one.
    pub(super) fn of(points: &[Point3<f64>]) -> Option<Self> {
        if points.len() < FEWEST {
            return None;
        }
        let n = points.len() as f64;
        let middle = points
            .iter()
            .map(|point| point.coords)
            .sum::<Vector3<f64>>()
            / n;
        let mut spread = Matrix3::zeros();
        for point in points {
            let off = point.coords - middle;
            spread += off * off.transpose() / n;
        }
        let axes = spread.try_symmetric_eigen(1e-15, 500)?;
        let widths = axes.eigenvalues.map(|square| 1.0 / square.max(0.0).sqrt());
        let scale = Matrix3::from_diagonal(&widths) * axes.eigenvectors.transpose();
        let mut curve = Self {
            middle,
            scale,
            quadrics: [SVector::zeros(); QUADRICS],
        };
        let mut normal = SMatrix::<f64, TERMS, TERMS>::zeros();
        for point in points {
            let terms = curve.terms(point);
            normal += terms * terms.transpose() / n;
        }
        if !normal.iter().all(|entry| entry.is_finite()) {
            return None;
        }
        let eigen = normal.try_symmetric_eigen(1e-15, 1000)?;
        let mut order: Vec<usize> = (0..TERMS).collect();
        order.sort_by(|a, b| eigen.eigenvalues[*a].total_cmp(&eigen.eigenvalues[*b]));
        for (quadric, index) in curve.quadrics.iter_mut().zip(order) {
            if eigen.eigenvalues[index] > ON_QUADRIC * ON_QUADRIC {
                return None;
            }
            *quadric = eigen.eigenvectors.column(index).into_owned();
        }
        Some(curve)
    }

    fn terms(&self, point: &Point3<f64>) -> SVector<f64, TERMS> {
        let p = self.scale * (point.coords - self.middle);
        let (x, y, z) = (p.x, p.y, p.z);
        SVector::from([1.0, x, y, z, x * x, x * y, x * z, y * y, y * z, z * z])
    }

    /// Whether it passes through a point, or near it: the distances from the quadrics, to first order.
    pub(super) fn passes(&self, point: &Point3<f64>) -> bool {
        let reach = (point.coords - self.middle).norm();
        let step = 1e-5 * reach;
        let near = |quadric: &SVector<f64, TERMS>| {
            let value = |by: Vector3<f64>| quadric.dot(&self.terms(&(point + by)));
            let slope = Vector3::from_fn(|k, _| {
                let by = Vector3::ith(k, step);
                (value(by) - value(-by)) / (2.0 * step)
            });
            value(Vector3::zeros()).abs() < NEAR_QUADRIC * reach * slope.norm()
        };
        self.quadrics.iter().all(near)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cubic(t: f64) -> Point3<f64> {
        Point3::new(
            0.5 * t + 0.1 * t * t,
            0.4 - 0.3 * t * t,
            0.2 * t * t * t - 0.1 * t,
        )
    }

    #[test]
    fn a_twisted_cubic_is_known_and_what_lies_on_it() {
        let points: Vec<_> = (0..40).map(|k| cubic(f64::from(k) / 20.0 - 1.0)).collect();
        let curve = Curve::of(&points).unwrap();
        assert!(curve.passes(&cubic(2.5)));
        let beside = cubic(2.5) + Vector3::new(0.6, 0.6, 0.0);
        assert!(!curve.passes(&beside));
    }

    #[test]
    fn a_grid_two_levels_and_a_spiral_are_none() {
        let grid = (0..27).map(|k| Point3::new((k % 3) as f64, (k / 3 % 3) as f64, (k / 9) as f64));
        assert!(Curve::of(&grid.collect::<Vec<_>>()).is_none());
        let levels =
            (0..50).map(|k| Point3::new((k % 5) as f64, (k / 5 % 5) as f64, (k / 25) as f64));
        assert!(Curve::of(&levels.collect::<Vec<_>>()).is_none());
        let spiral = (0..60).map(|k| {
            let t = f64::from(k) * 0.2;
            Point3::new(t.cos(), t.sin(), 0.2 * t)
        });
        assert!(Curve::of(&spiral.collect::<Vec<_>>()).is_none());
    }
}
