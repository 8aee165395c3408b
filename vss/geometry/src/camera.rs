//! The camera model: pose, pinhole and Brown-Conrady distortion, with derivatives.
//!
//! The camera frame has x right, y down, z forward. A world point `X` is at `R (X - C)` in it, where
//! `C` is the camera's centre. Pixel centres are at whole numbers. Metres, radians, pixels.
//! This module knows nothing of pictures, calibration or tasks.

use nalgebra::{
    Isometry3, Matrix2, Matrix2x3, Matrix3, Point3, SMatrix, Translation3, UnitQuaternion, Vector2,
    Vector3,
};
use serde::{Deserialize, Serialize};

/// Number of parameters of the full model: 3 rotation, 3 centre, 4 pinhole, 5 distortion.
pub const PARAMETERS: usize = 15;

/// Derivatives of (u, v) with respect to all parameters, in the order of [`Camera::project_with_jacobian`].
pub type ParameterJacobian = SMatrix<f64, 2, PARAMETERS>;

/// Newton steps that undistortion may take; it needs 3 or 4.
const NEWTON_STEPS: usize = 20;

/// The lens and the sensor.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Intrinsics {
    /// Focal length along u, px.
    pub fx: f64,
    /// Focal length along v, px.
    pub fy: f64,
    /// Principal point, u, px.
    pub cx: f64,
    /// Principal point, v, px.
    pub cy: f64,
}

/// Brown-Conrady distortion in the order of ROS's `plumb_bob`: k1 k2 p1 p2 k3, no units.
///
/// With r² = x² + y² of the undistorted normalised point:
/// x' = x (1 + k1 r² + k2 r⁴ + k3 r⁶) + 2 p1 x y + p2 (r² + 2 x²),
/// y' = y (1 + k1 r² + k2 r⁴ + k3 r⁶) + p1 (r² + 2 y²) + 2 p2 x y.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct Distortion {
    /// Radial, r².
    pub k1: f64,
    /// Radial, r⁴.
    pub k2: f64,
    /// Tangential, along y.
    pub p1: f64,
    /// Tangential, along x.
    pub p2: f64,
    /// Radial, r⁶.
    pub k3: f64,
}

impl Distortion {
    /// The distorted normalised point of an undistorted one.
    #[must_use]
    pub fn distort(&self, p: Vector2<f64>) -> Vector2<f64> {
        let (x, y) = (p.x, p.y);
        let r2 = p.norm_squared();
        let radial = 1.0 + r2 * (self.k1 + r2 * (self.k2 + r2 * self.k3));
        Vector2::new(
            x * radial + 2.0 * self.p1 * x * y + self.p2 * (r2 + 2.0 * x * x),
            y * radial + self.p1 * (r2 + 2.0 * y * y) + 2.0 * self.p2 * x * y,
        )
    }

    /// Derivative of [`Self::distort`] with respect to the point.
    #[must_use]
    pub fn jacobian(&self, p: Vector2<f64>) -> Matrix2<f64> {
        let (x, y) = (p.x, p.y);
        let r2 = p.norm_squared();
        let radial = 1.0 + r2 * (self.k1 + r2 * (self.k2 + r2 * self.k3));
        // Half the derivative of `radial` along x is x times this.
        let slope = self.k1 + r2 * (2.0 * self.k2 + r2 * 3.0 * self.k3);
        let mixed = 2.0 * x * y * slope + 2.0 * (self.p1 * x + self.p2 * y);
        Matrix2::new(
            radial + 2.0 * x * x * slope + 2.0 * self.p1 * y + 6.0 * self.p2 * x,
            mixed,
            mixed,
            radial + 2.0 * y * y * slope + 6.0 * self.p1 * y + 2.0 * self.p2 * x,
        )
    }

    /// The smallest radius (undistorted, normalised) at which the radial polynomial stops growing, where
    /// 1 + 3 k1 r² + 5 k2 r⁴ + 7 k3 r⁶ = 0; infinite if it always grows. Beyond it the model folds over
    /// and its pixels mean nothing.
    #[must_use]
    pub fn valid_radius(&self) -> f64 {
        let slope = |s: f64| 1.0 + s * (3.0 * self.k1 + s * (5.0 * self.k2 + s * 7.0 * self.k3));
        // Between the stationary points of this cubic it is monotonic, so each stretch holds one root at most.
        let (a, b, c) = (21.0 * self.k3, 10.0 * self.k2, 3.0 * self.k1);
        let mut ends: Vec<f64> = quadratic_roots(a, b, c)
            .into_iter()
            .filter(|s| *s > 0.0)
            .collect();
        ends.sort_by(f64::total_cmp);
        // Past the last stationary point: double until the sign shows or the radius is absurd.
        let mut far = ends.last().copied().unwrap_or(0.0).max(1e-3);
        while slope(far) > 0.0 && far < 1e9 {
            far *= 2.0;
        }
        ends.push(far);
        let mut low = 0.0;
        for high in ends {
            if slope(high) <= 0.0 {
                return bisect(slope, low, high).sqrt();
            }
            low = high;
        }
        f64::INFINITY
    }

    /// Whether a point lies within [`Self::valid_radius`], without computing that.
    fn is_valid_at(&self, p: Vector2<f64>) -> bool {
        let slope = |s: f64| 1.0 + s * (3.0 * self.k1 + s * (5.0 * self.k2 + s * 7.0 * self.k3));
        let s = p.norm_squared();
        // The least slope up to here is at the end or where the slope itself has a lowest place.
        let (a, b, c) = (21.0 * self.k3, 10.0 * self.k2, 3.0 * self.k1);
        let root = (b * b - 4.0 * a * c).max(0.0).sqrt();
        let q = -0.5 * (b + root.copysign(b));
        let positive = |place: f64| {
            let within = place > 0.0 && place < s;
            !within || slope(place) > 0.0
        };
        slope(s) > 0.0 && positive(q / a) && positive(c / q)
    }

    /// The undistorted normalised point of a distorted one, by Newton's method on both coordinates, or
    /// `None` where the model has no inverse (beyond [`Self::valid_radius`]).
    #[must_use]
    pub fn undistort(&self, distorted: Vector2<f64>) -> Option<Vector2<f64>> {
        let mut p = distorted;
        let mut error = self.distort(p) - distorted;
        for _ in 0..NEWTON_STEPS {
            if !error.iter().all(|e| e.is_finite()) {
                return None;
            }
            if error.norm() < 1e-14 * (1.0 + distorted.norm()) {
                break;
            }
            let step = self.jacobian(p).try_inverse()? * error;
            // Halve the step while it makes things worse: far out the plain step can leave the valid radius.
            let mut scale = 1.0;
            let (mut next, mut next_error) = (p - step, self.distort(p - step) - distorted);
            while next_error.norm() > error.norm() && scale > 1e-6 {
                scale *= 0.5;
                next = p - step * scale;
                next_error = self.distort(next) - distorted;
            }
            if next_error.norm() >= error.norm() {
                break;
            }
            (p, error) = (next, next_error);
        }
        let solved = error.norm() < 1e-9 * (1.0 + distorted.norm());
        (solved && self.is_valid_at(p)).then_some(p)
    }
}

/// The real roots of a s² + b s + c, none, one or two.
fn quadratic_roots(a: f64, b: f64, c: f64) -> Vec<f64> {
    if a == 0.0 {
        return if b == 0.0 { vec![] } else { vec![-c / b] };
    }
    let discriminant = b * b - 4.0 * a * c;
    if discriminant < 0.0 {
        return vec![];
    }
    // The form that does not cancel.
    let q = -0.5 * (b + discriminant.sqrt().copysign(b));
    if q == 0.0 {
        vec![0.0]
    } else {
        vec![q / a, c / q]
    }
}

/// The root of a function that is positive at `low` and not at `high`.
fn bisect(function: impl Fn(f64) -> f64, mut low: f64, mut high: f64) -> f64 {
    for _ in 0..200 {
        let middle = 0.5 * (low + high);
        if function(middle) > 0.0 {
            low = middle;
        } else {
            high = middle;
        }
    }
    low
}

/// A camera in the world: where it stands, how it looks, and its lens.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Camera {
    /// `camera_T_world`'s rotation: turns world directions into the camera frame.
    pub rotation: UnitQuaternion<f64>,
    /// The camera's centre in the world, m.
    pub centre: Point3<f64>,
    /// Pinhole.
    pub intrinsics: Intrinsics,
    /// Lens distortion.
    pub distortion: Distortion,
}

impl Camera {
    /// `camera_T_world`: a world point X is at R X + t in the camera frame, t = -R C.
    #[must_use]
    pub fn camera_from_world(&self) -> Isometry3<f64> {
        let t = -(self.rotation * self.centre.coords);
        Isometry3::from_parts(Translation3::from(t), self.rotation)
    }

    /// The point in the camera frame, m.
    #[must_use]
    pub fn in_camera_frame(&self, point: &Point3<f64>) -> Vector3<f64> {
        self.rotation * (point - self.centre)
    }

    /// The mean of fx and fy, px: "the" focal length.
    #[must_use]
    pub fn focal(&self) -> f64 {
        0.5 * (self.intrinsics.fx + self.intrinsics.fy)
    }

    /// The pixel (u, v) of a world point, or `None` if the point is not in front of the camera or lies
    /// beyond the radius up to which the distortion has an inverse.
    #[must_use]
    pub fn project(&self, point: &Point3<f64>) -> Option<Vector2<f64>> {
        let c = self.in_camera_frame(point);
        if c.z.is_nan() || c.z <= 0.0 {
            return None;
        }
        let p = Vector2::new(c.x / c.z, c.y / c.z);
        let pixel = self.pixel_of(self.distortion.distort(p));
        let valid = self.distortion.is_valid_at(p);
        (valid && pixel.iter().all(|c| c.is_finite())).then_some(pixel)
    }

    fn pixel_of(&self, p: Vector2<f64>) -> Vector2<f64> {
        let i = &self.intrinsics;
        Vector2::new(i.fx * p.x + i.cx, i.fy * p.y + i.cy)
    }

    /// The direction, in the camera frame and with z = 1, that a pixel looks along, or `None` where the
    /// distortion has no inverse.
    #[must_use]
    pub fn ray(&self, pixel: Vector2<f64>) -> Option<Vector3<f64>> {
        let i = &self.intrinsics;
        let p = Vector2::new((pixel.x - i.cx) / i.fx, (pixel.y - i.cy) / i.fy);
        let p = self.distortion.undistort(p)?;
        Some(Vector3::new(p.x, p.y, 1.0))
    }

    /// Whether the distortion can be undone over the whole picture: the radial polynomial grows at least up to
    /// the farthest corner.
    #[must_use]
    pub fn is_monotonic_over(&self, width: usize, height: usize) -> bool {
        let (right, low) = (width as f64 - 0.5, height as f64 - 0.5);
        let corners = [(-0.5, -0.5), (right, -0.5), (-0.5, low), (right, low)];
        corners
            .iter()
            .all(|&(u, v)| self.ray(Vector2::new(u, v)).is_some())
    }

    /// The formula of the projection without its checks: points behind the camera have a pixel too. `None` on
    /// the plane z = 0 only.
    #[must_use]
    pub fn project_unchecked(&self, point: &Point3<f64>) -> Option<Vector2<f64>> {
        let c = self.in_camera_frame(point);
        if c.z.is_nan() || c.z.abs() < 1e-12 {
            return None;
        }
        let p = Vector2::new(c.x / c.z, c.y / c.z);
        Some(self.pixel_of(self.distortion.distort(p)))
    }

    /// The formula of the projection without its checks, with derivatives with respect to
    /// [rotation vector ω (3), centre (3), fx, fy, cx, cy, k1, k2, p1, p2, k3], where ω turns the camera
    /// frame: R(ω) = exp(ω) R. `None` on the plane z = 0 only; the depth may be negative.
    #[must_use]
    pub fn project_with_jacobian(
        &self,
        point: &Point3<f64>,
    ) -> Option<(Vector2<f64>, ParameterJacobian)> {
        let c = self.in_camera_frame(point);
        if c.z.is_nan() || c.z.abs() < 1e-12 {
            return None;
        }
        let p = Vector2::new(c.x / c.z, c.y / c.z);
        let i = &self.intrinsics;
        let d = self.distortion.distort(p);
        let focal = Matrix2::new(i.fx, 0.0, 0.0, i.fy);
        let perspective = Matrix2x3::new(1.0, 0.0, -p.x, 0.0, 1.0, -p.y) / c.z;
        let by_camera_point = focal * self.distortion.jacobian(p) * perspective;
        let mut j = ParameterJacobian::zeros();
        j.fixed_view_mut::<2, 3>(0, 0)
            .copy_from(&(by_camera_point * -c.cross_matrix()));
        let rotation: Matrix3<f64> = self.rotation.to_rotation_matrix().into_inner();
        j.fixed_view_mut::<2, 3>(0, 3)
            .copy_from(&(by_camera_point * -rotation));
        j.fixed_view_mut::<2, 4>(0, 6)
            .copy_from(&nalgebra::Matrix2x4::new(
                d.x, 0.0, 1.0, 0.0, //
                0.0, d.y, 0.0, 1.0,
            ));
        let (x, y, r2) = (p.x, p.y, p.norm_squared());
        let (r4, r6) = (r2 * r2, r2 * r2 * r2);
        let by_distortion = nalgebra::Matrix2x5::new(
            x * r2,
            x * r4,
            2.0 * x * y,
            r2 + 2.0 * x * x,
            x * r6, //
            y * r2,
            y * r4,
            r2 + 2.0 * y * y,
            2.0 * x * y,
            y * r6,
        );
        j.fixed_view_mut::<2, 5>(0, 10)
            .copy_from(&(focal * by_distortion));
        Some((self.pixel_of(d), j))
    }

    /// The camera moved by a change of its parameters, in the order of [`Self::project_with_jacobian`]: the
    /// rotation by exp(ω) on the left, all others by addition.
    #[must_use]
    pub fn moved_by(&self, step: &[f64; PARAMETERS]) -> Self {
        let [a, b, c, x, y, z, fx, fy, cx, cy, k1, k2, p1, p2, k3] = *step;
        let (i, d) = (&self.intrinsics, &self.distortion);
        Self {
            rotation: UnitQuaternion::new(Vector3::new(a, b, c)) * self.rotation,
            centre: self.centre + Vector3::new(x, y, z),
            intrinsics: Intrinsics {
                fx: i.fx + fx,
                fy: i.fy + fy,
                cx: i.cx + cx,
                cy: i.cy + cy,
            },
            distortion: Distortion {
                k1: d.k1 + k1,
                k2: d.k2 + k2,
                p1: d.p1 + p1,
                p2: d.p2 + p2,
                k3: d.k3 + k3,
            },
        }
    }

    /// The change that [`Self::moved_by`] needs to make `self` into `other`.
    #[must_use]
    pub fn change_to(&self, other: &Self) -> [f64; PARAMETERS] {
        let w = (other.rotation * self.rotation.inverse()).scaled_axis();
        let c = other.centre - self.centre;
        let ((i, d), (j, e)) = (
            (&self.intrinsics, &self.distortion),
            (&other.intrinsics, &other.distortion),
        );
        [
            w.x,
            w.y,
            w.z,
            c.x,
            c.y,
            c.z,
            j.fx - i.fx,
            j.fy - i.fy,
            j.cx - i.cx,
            j.cy - i.cy,
            e.k1 - d.k1,
            e.k2 - d.k2,
            e.p1 - d.p1,
            e.p2 - d.p2,
            e.k3 - d.k3,
        ]
    }

    /// How far this estimate is from the true camera.
    #[must_use]
    pub fn error_against(&self, truth: &Self) -> CameraError {
        CameraError {
            position_m: (self.centre - truth.centre).norm(),
            rotation_rad: self.rotation.angle_to(&truth.rotation),
            focal_rel: (self.focal() / truth.focal() - 1.0).abs(),
        }
    }
}

/// An estimated camera against the true one.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct CameraError {
    /// Distance between the centres, m.
    pub position_m: f64,
    /// Angle between the orientations, rad.
    pub rotation_rad: f64,
    /// |f / f_true - 1| with f = (fx + fy) / 2.
    pub focal_rel: f64,
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use proptest::prelude::*;

    /// A ceiling camera as in the case study.
    pub(crate) fn ceiling_camera() -> Camera {
        let eye = Point3::new(0.5, -0.3, 2.9);
        // `face_towards` builds world_T_camera with z along the view; x right, y down.
        let view =
            nalgebra::Rotation3::face_towards(&(Point3::new(0.1, 0.0, 0.8) - eye), &-Vector3::y());
        Camera {
            rotation: UnitQuaternion::from_rotation_matrix(&view).inverse(),
            centre: eye,
            intrinsics: Intrinsics {
                fx: 551.0,
                fy: 549.0,
                cx: 253.0,
                cy: 246.0,
            },
            distortion: Distortion {
                k1: -0.15,
                k2: 0.04,
                p1: 5e-4,
                p2: -4e-4,
                k3: 0.0,
            },
        }
    }

    #[test]
    fn a_hand_computed_point_lands_on_its_pixel() {
        // x = 0.2, y = -0.1, r2 = 0.05: radial = 1 - 0.01 + 0.00025 + 0.0000125 = 0.9902625.
        let camera = Camera {
            rotation: UnitQuaternion::identity(),
            centre: Point3::new(0.0, 0.0, -2.0),
            intrinsics: Intrinsics {
                fx: 800.0,
                fy: 700.0,
                cx: 320.0,
                cy: 240.0,
            },
            distortion: Distortion {
                k1: -0.2,
                k2: 0.1,
                p1: 0.001,
                p2: -0.002,
                k3: 0.1,
            },
        };
        let pixel = camera.project(&Point3::new(0.4, -0.2, 0.0)).unwrap();
        let x = 0.2 * 0.9902625 + 2.0 * 0.001 * -0.02 - 0.002 * (0.05 + 0.08);
        let y = -0.1 * 0.9902625 + 0.001 * (0.05 + 0.02) + 2.0 * -0.002 * -0.02;
        assert!((pixel.x - (800.0 * x + 320.0)).abs() < 1e-10);
        assert!((pixel.y - (700.0 * y + 240.0)).abs() < 1e-10);
    }

    #[test]
    fn points_behind_the_camera_and_beyond_the_valid_radius_have_no_pixel() {
        let mut camera = ceiling_camera();
        let behind = camera.centre + camera.rotation.inverse() * Vector3::new(0.0, 0.0, -1.0);
        assert_eq!(camera.project(&behind), None);
        camera.distortion = Distortion {
            k1: -0.3,
            ..Distortion::default()
        };
        assert!((camera.distortion.valid_radius() - (1.0_f64 / 0.9).sqrt()).abs() < 1e-9);
        let wide = camera.centre + camera.rotation.inverse() * Vector3::new(1.2, 0.0, 1.0);
        assert_eq!(camera.project(&wide), None);
        assert_eq!(camera.project(&Point3::new(f64::NAN, 0.0, 0.0)), None);
    }

    #[test]
    fn the_jacobian_equals_central_differences() {
        let camera = ceiling_camera();
        let point = Point3::new(0.6, 0.5, 1.3);
        let (_, jacobian) = camera.project_with_jacobian(&point).unwrap();
        for parameter in 0..PARAMETERS {
            let h = 1e-6;
            let at = |sign: f64| {
                let mut step = [0.0; PARAMETERS];
                step[parameter] = sign * h;
                camera.moved_by(&step).project(&point).unwrap()
            };
            let numeric = (at(1.0) - at(-1.0)) / (2.0 * h);
            let column = jacobian.column(parameter);
            assert!(
                (numeric - column).norm() < 1e-6 * (1.0 + column.norm()),
                "{parameter}: {numeric} {column}"
            );
        }
    }

    #[test]
    fn the_change_between_two_cameras_makes_one_into_the_other() {
        let a = ceiling_camera();
        let step = [
            0.3, -0.2, 0.1, 1.0, 2.0, 3.0, 5.0, 6.0, 7.0, 8.0, 0.1, 0.2, 0.3, 0.4, 0.5,
        ];
        let b = a.moved_by(&step);
        for (x, y) in a.change_to(&b).iter().zip(&step) {
            assert!((x - y).abs() < 1e-12);
        }
        assert!((b.error_against(&a).position_m - 14_f64.sqrt()).abs() < 1e-12);
    }

    proptest! {
        #[test]
        fn undistortion_undoes_distortion_inside_the_valid_radius(
            k1 in -0.5..0.5, k2 in -0.3..0.3, k3 in -0.1..0.1, p1 in -2e-3..2e-3, p2 in -2e-3..2e-3,
            angle in 0.0..std::f64::consts::TAU, fraction in 0.0..0.9,
        ) {
            let lens = Distortion { k1, k2, p1, p2, k3 };
            let radius = fraction * lens.valid_radius().min(1.0);
            let p = Vector2::new(radius * angle.cos(), radius * angle.sin());
            let back = lens.undistort(lens.distort(p));
            prop_assert!(back.is_some());
            prop_assert!((back.unwrap() - p).norm() < 1e-9);
        }

        #[test]
        fn points_are_valid_up_to_the_valid_radius_and_not_beyond(
            k1 in -1.0..1.0_f64, k2 in -1.0..1.0_f64, k3 in -1.0..1.0_f64, radius in 0.0..3.0_f64, some in 0..4,
        ) {
            let keep = |k: f64, nth: i32| if some == nth { 0.0 } else { k };
            let lens = Distortion { k1: keep(k1, 1), k2: keep(k2, 2), k3: keep(k3, 3), ..Distortion::default() };
            let limit = lens.valid_radius();
            if (radius / limit - 1.0).abs() > 1e-6 {
                prop_assert_eq!(lens.is_valid_at(Vector2::new(0.0, radius)), radius < limit);
            }
        }

        #[test]
        fn undistortion_ends_and_is_honest_for_any_numbers(
            k in prop::array::uniform5(prop::num::f64::ANY), x in prop::num::f64::ANY, y in prop::num::f64::ANY,
        ) {
            let lens = Distortion { k1: k[0], k2: k[1], p1: k[2], p2: k[3], k3: k[4] };
            if let Some(p) = lens.undistort(Vector2::new(x, y)) {
                prop_assert!((lens.distort(p) - Vector2::new(x, y)).norm() < 1e-8 * (1.0 + x.hypot(y)));
            }
        }
    }
}
