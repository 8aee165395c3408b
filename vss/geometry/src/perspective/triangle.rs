//! The poses that three points allow (J. Grunert, 1841, as in R. Haralick and others, International Journal of Computer
//! Vision 13, 1994): the law of cosines in the three triangles of two points and the camera gives a polynomial of the
//! fourth order in the ratio of two distances.

use nalgebra::{
    Isometry3, Matrix3, Matrix4, Point3, Rotation3, Translation3, UnitQuaternion, Vector3,
};

/// A root with a smaller imaginary part is real: double roots come out as pairs.
const REAL: f64 = 1e-3;

/// The poses of the points before the camera, which sees them along `rays` of length 1. Four at most.
pub(super) fn poses(points: &[Point3<f64>; 3], rays: &[Vector3<f64>; 3]) -> Vec<Isometry3<f64>> {
    let [first, second, third] = points;
    let (a, b, c) = (
        (second - third).norm_squared(),
        (first - third).norm_squared(),
        (first - second).norm_squared(),
    );
    let (cos_a, cos_b, cos_c) = (
        rays[1].dot(&rays[2]),
        rays[0].dot(&rays[2]),
        rays[0].dot(&rays[1]),
    );
    let (q, sum, ratio) = ((a - c) / b, (a + c) / b, c / b);
    let polynomial = [
        (1.0 + q).powi(2) - 4.0 * a / b * cos_c * cos_c,
        4.0 * (-q * (1.0 + q) * cos_b + 2.0 * a / b * cos_c * cos_c * cos_b
            - (1.0 - sum) * cos_a * cos_c),
        2.0 * (q * q - 1.0 + 2.0 * q * q * cos_b * cos_b + 2.0 * (b - c) / b * cos_a * cos_a
            - 4.0 * sum * cos_a * cos_b * cos_c
            + 2.0 * (b - a) / b * cos_c * cos_c),
        4.0 * (q * (1.0 - q) * cos_b - (1.0 - sum) * cos_a * cos_c
            + 2.0 * ratio * cos_a * cos_a * cos_b),
        (q - 1.0).powi(2) - 4.0 * ratio * cos_a * cos_a,
    ];
    let poses = roots(&polynomial).into_iter().filter_map(|v| {
        let u = ((q - 1.0) * v * v - 2.0 * q * cos_b * v + 1.0 + q) / (2.0 * (cos_c - v * cos_a));
        let near = (b / (1.0 + v * v - 2.0 * v * cos_b)).sqrt();
        let distances = [near, u * near, v * near];
        let before = |distance: &f64| distance.is_finite() && *distance > 0.0;
        distances
            .iter()
            .all(before)
            .then(|| placed(points, &std::array::from_fn(|k| rays[k] * distances[k])))
            .flatten()
    });
    poses.collect()
}

/// The real positive roots of a polynomial of the fourth order, lowest coefficient first.
fn roots(polynomial: &[f64; 5]) -> Vec<f64> {
    let [p0, p1, p2, p3, p4] = polynomial.map(|one| one / polynomial[4]);
    let companion = Matrix4::new(
        -p3, -p2, -p1, -p0, //
        p4, 0.0, 0.0, 0.0, //
        0.0, p4, 0.0, 0.0, //
        0.0, 0.0, p4, 0.0,
    );
    if !companion.iter().all(|one| one.is_finite()) {
        return Vec::new();
    }
    let Some(schur) = nalgebra::Schur::try_new(companion, 1e-14, 1000) else {
        return Vec::new();
    };
    let all = schur.complex_eigenvalues();
    let real = all
        .iter()
        .filter(|root| root.im.abs() < REAL * (1.0 + root.re.abs()));
    real.map(|root| root.re)
        .filter(|root| *root > 0.0)
        .collect()
}

/// The pose that takes a triangle to an equal one.
fn placed(from: &[Point3<f64>; 3], to: &[Vector3<f64>; 3]) -> Option<Isometry3<f64>> {
    let there = frame(&to[0], &to[1], &to[2])?;
    let here = frame(&from[0].coords, &from[1].coords, &from[2].coords)?;
    let turn = Rotation3::from_matrix_unchecked(there * here.transpose());
    let turn = UnitQuaternion::from_rotation_matrix(&turn);
    let middle = |of: [Vector3<f64>; 3]| (of[0] + of[1] + of[2]) / 3.0;
    let shift = middle(*to) - turn * middle(from.map(|one| one.coords));
    Some(Isometry3::from_parts(Translation3::from(shift), turn))
}

/// Axes along a triangle.
fn frame(a: &Vector3<f64>, b: &Vector3<f64>, c: &Vector3<f64>) -> Option<Matrix3<f64>> {
    let along = (b - a).try_normalize(1e-12)?;
    let normal = along.cross(&(c - a)).try_normalize(1e-12)?;
    Some(Matrix3::from_columns(&[
        along,
        normal.cross(&along),
        normal,
    ]))
}
