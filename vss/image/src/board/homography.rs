//! Homographies of the plane, by the normalised direct linear transformation (Hartley and Zisserman, chapter 4).

use nalgebra::{DMatrix, Matrix3, Vector3};

/// From one plane to another, up to scale.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Homography(Matrix3<f64>);

impl Homography {
    /// The one that maps the first places to the second ones best; four or more pairs, not all on a line.
    pub(super) fn fitted(pairs: &[([f64; 2], [f64; 2])]) -> Option<Self> {
        if pairs.len() < 4 {
            return None;
        }
        let from = normalising(pairs.iter().map(|pair| pair.0));
        let to = normalising(pairs.iter().map(|pair| pair.1));
        let mut normal = DMatrix::<f64>::zeros(9, 9);
        for (one, other) in pairs {
            let a = from * Vector3::new(one[0], one[1], 1.0);
            let b = to * Vector3::new(other[0], other[1], 1.0);
            let rows = [
                [a.x, a.y, 1.0, 0.0, 0.0, 0.0, -b.x * a.x, -b.x * a.y, -b.x],
                [0.0, 0.0, 0.0, a.x, a.y, 1.0, -b.y * a.x, -b.y * a.y, -b.y],
            ];
            for row in rows {
                let row = nalgebra::DVector::from_row_slice(&row);
                normal.ger(1.0, &row, &row, 1.0);
            }
        }
        let eigen = normal.symmetric_eigen();
        let (least, _) = eigen.eigenvalues.argmin();
        let h = eigen.eigenvectors.column(least);
        let h = Matrix3::new(h[0], h[1], h[2], h[3], h[4], h[5], h[6], h[7], h[8]);
        let map = to.try_inverse()? * h * from;
        // The scale is that of the last number, which no visible plane has at 0.
        let map = map / map[(2, 2)];
        (map.iter().all(|number| number.is_finite()) && map.determinant().abs() > 1e-12)
            .then_some(Self(map))
    }

    /// An affine map.
    pub(super) fn affine([[a, b, c], [d, e, f]]: [[f64; 3]; 2]) -> Self {
        Self(Matrix3::new(a, b, c, d, e, f, 0.0, 0.0, 1.0))
    }

    pub(super) fn of(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        let row = |nth: usize| self.0[(nth, 0)] * x + self.0[(nth, 1)] * y + self.0[(nth, 2)];
        let z = row(2);
        [row(0) / z, row(1) / z]
    }

    /// How far a pair is from it.
    pub(super) fn residual(&self, (from, to): &([f64; 2], [f64; 2])) -> f64 {
        let at = self.of(*from);
        (at[0] - to[0]).hypot(at[1] - to[1])
    }

    /// This one after an affine map.
    pub(super) fn after(&self, [[a, b, c], [d, e, f]]: [[f64; 3]; 2]) -> Self {
        Self(self.0 * Self::affine([[a, b, c], [d, e, f]]).0)
    }

    /// This one before an affine map.
    pub(super) fn before(&self, [[a, b, c], [d, e, f]]: [[f64; 3]; 2]) -> Self {
        Self(Self::affine([[a, b, c], [d, e, f]]).0 * self.0)
    }

    /// Its nine numbers, row by row, the last one 1.
    pub(super) fn rows(&self) -> [f64; 9] {
        let map = self.0 / self.0[(2, 2)];
        std::array::from_fn(|nth| map[(nth / 3, nth % 3)])
    }
}

/// Moves places to a mean of 0 and a mean square of 2.
fn normalising(places: impl Iterator<Item = [f64; 2]> + Clone) -> Matrix3<f64> {
    let count = places.clone().count().max(1) as f64;
    let sums = places
        .clone()
        .fold([0.0; 2], |sum, at| [sum[0] + at[0], sum[1] + at[1]]);
    let [u, v] = sums.map(|sum| sum / count);
    let squares = places.map(|at| (at[0] - u).powi(2) + (at[1] - v).powi(2));
    let scale = (2.0 * count / squares.sum::<f64>().max(f64::MIN_POSITIVE)).sqrt();
    Matrix3::new(
        scale,
        0.0,
        -scale * u,
        0.0,
        scale,
        -scale * v,
        0.0,
        0.0,
        1.0,
    )
}
