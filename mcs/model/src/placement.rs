//! Where a frame stands in another. Knows no joints.

use nalgebra::{Isometry3, Matrix3, Rotation3, Translation3, UnitQuaternion, Vector3};

/// Rotation and origin of one frame in another; cheaper to chain than a quaternion.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Placement {
    /// Its columns are the frame's axes in the other frame.
    pub rotation: Matrix3<f64>,
    /// Origin in the other frame, m.
    pub origin: Vector3<f64>,
}

impl Placement {
    /// The other frame itself.
    #[must_use]
    pub fn identity() -> Self {
        Self {
            rotation: Matrix3::identity(),
            origin: Vector3::zeros(),
        }
    }

    /// Shifted by `x`, `y` and `z`, m.
    #[must_use]
    pub fn shifted(x: f64, y: f64, z: f64) -> Self {
        Self {
            origin: Vector3::new(x, y, z),
            ..Self::identity()
        }
    }

    /// At `origin` (m), turned about x, then y, then z of the other frame by `rpy` (deg): the fixed axes of URDF.
    /// Quarter turns are exact.
    #[must_use]
    pub fn from_degrees(origin: [f64; 3], rpy: [f64; 3]) -> Self {
        let [roll, pitch, yaw] = rpy.map(sin_cos_degrees);
        Self::turned(origin, roll, pitch, yaw)
    }

    /// At `origin` (m), turned about x, then y, then z of the other frame by `rpy` (rad).
    #[must_use]
    pub fn from_radians(origin: [f64; 3], rpy: [f64; 3]) -> Self {
        let [roll, pitch, yaw] = rpy.map(f64::sin_cos);
        Self::turned(origin, roll, pitch, yaw)
    }

    fn turned(origin: [f64; 3], roll: (f64, f64), pitch: (f64, f64), yaw: (f64, f64)) -> Self {
        let ((sr, cr), (sp, cp), (sy, cy)) = (roll, pitch, yaw);
        #[rustfmt::skip]
        let rotation = Matrix3::new(
            cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr,
            sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr,
            -sp,     cp * sr,                cp * cr,
        );
        Self {
            rotation,
            origin: origin.into(),
        }
    }

    /// A frame whose z axis points along `axis` (not zero), its origin where the other's is.
    #[must_use]
    pub fn along(axis: &Vector3<f64>) -> Self {
        let turn = Rotation3::rotation_between(&Vector3::z(), axis);
        // Only the opposite direction has no shortest way: any half turn about an axis across will do.
        let half = Matrix3::from_diagonal(&Vector3::new(1.0, -1.0, -1.0));
        Self {
            rotation: turn.map_or(half, Rotation3::into_inner),
            ..Self::identity()
        }
    }

    /// The pose of `inner` in the other frame, where `inner` is given in this one.
    #[must_use]
    #[inline]
    pub fn then(&self, inner: &Self) -> Self {
        Self {
            rotation: self.rotation * inner.rotation,
            origin: self.point(&inner.origin),
        }
    }

    /// A point of this frame, in the other (m).
    #[must_use]
    #[inline]
    pub fn point(&self, point: &Vector3<f64>) -> Vector3<f64> {
        self.rotation * point + self.origin
    }

    /// The other frame in this one.
    #[must_use]
    pub fn inverse(&self) -> Self {
        Self {
            rotation: self.rotation.transpose(),
            origin: -self.rotation.tr_mul(&self.origin),
        }
    }

    /// The pose as an isometry.
    #[must_use]
    pub fn isometry(&self) -> Isometry3<f64> {
        let rotation = Rotation3::from_matrix_unchecked(self.rotation);
        Isometry3::from_parts(
            Translation3::from(self.origin),
            UnitQuaternion::from_rotation_matrix(&rotation),
        )
    }

    /// Whether every number is finite.
    #[must_use]
    pub fn is_finite(&self) -> bool {
        let mut numbers = self.rotation.iter().chain(self.origin.iter());
        numbers.all(|number| number.is_finite())
    }
}

impl From<&Isometry3<f64>> for Placement {
    fn from(pose: &Isometry3<f64>) -> Self {
        Self {
            rotation: pose.rotation.to_rotation_matrix().into_inner(),
            origin: pose.translation.vector,
        }
    }
}

/// Sine and cosine of an angle in degrees; exact for quarter turns, which the axes of most arms are apart.
pub(super) fn sin_cos_degrees(degrees: f64) -> (f64, f64) {
    let turned = degrees.rem_euclid(360.0);
    if turned == 0.0 {
        (0.0, 1.0)
    } else if turned == 90.0 {
        (1.0, 0.0)
    } else if turned == 180.0 {
        (0.0, -1.0)
    } else if turned == 270.0 {
        (-1.0, 0.0)
    } else {
        degrees.to_radians().sin_cos()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_frame_along_an_axis_has_its_z_there_whatever_the_axis() {
        for axis in [
            Vector3::x(),
            Vector3::z(),
            -Vector3::z(),
            Vector3::new(0.3, -0.4, 1.2),
            Vector3::new(1e-9, 0.0, -1.0),
        ] {
            let frame = Placement::along(&axis);
            assert!(
                (frame.rotation.column(2) - axis.normalize()).norm() < 1e-9,
                "{axis}"
            );
            assert!((frame.rotation.determinant() - 1.0).abs() < 1e-12);
        }
    }

    #[test]
    fn a_placement_after_its_inverse_is_none() {
        let placement = Placement::from_radians([0.3, -0.2, 1.0], [0.4, -1.1, 2.5]);
        let none = placement.then(&placement.inverse());
        assert!((none.rotation - Matrix3::identity()).norm() < 1e-14);
        assert!(none.origin.norm() < 1e-14);
    }

    #[test]
    fn the_three_turns_are_about_fixed_axes_x_first() {
        let found = Placement::from_radians([0.0; 3], [0.4, -1.1, 2.5]).rotation;
        let expected = Rotation3::from_axis_angle(&Vector3::z_axis(), 2.5)
            * Rotation3::from_axis_angle(&Vector3::y_axis(), -1.1)
            * Rotation3::from_axis_angle(&Vector3::x_axis(), 0.4);
        assert!((found - expected.matrix()).norm() < 1e-14);
    }
}
