//! The exact projection of a simulated camera: pinhole, Brown-Conrady distortion, pose.
//!
//! Pixel centres at whole numbers, the first pixel is (0, 0), u right, v down. Camera frame: x right,
//! y down, z forward. The estimator never sees this; the final table of a run may, to say how well the
//! estimator did.

use nalgebra::{Isometry3, Matrix3, Point3, Rotation3, Translation3, UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};
use vss_geometry::camera::{self, Camera};

/// Brown-Conrady coefficients in the usual order.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct Distortion {
    /// Radial, r^2.
    pub k1: f64,
    /// Radial, r^4.
    pub k2: f64,
    /// Tangential, vertical.
    pub p1: f64,
    /// Tangential, horizontal.
    pub p2: f64,
    /// Radial, r^6.
    pub k3: f64,
}

impl Distortion {
    /// Ideal to distorted coordinates, both normalised (focal length 1).
    #[must_use]
    pub fn apply(&self, x: f64, y: f64) -> (f64, f64) {
        let s = x * x + y * y;
        let radial = self.radial(s);
        (
            x * radial + 2.0 * self.p1 * x * y + self.p2 * (s + 2.0 * x * x),
            y * radial + self.p1 * (s + 2.0 * y * y) + 2.0 * self.p2 * x * y,
        )
    }

    /// Distorted to ideal normalised coordinates by Newton's method; `None` where no ideal point
    /// within `radius` maps there.
    #[must_use]
    pub fn remove(&self, xd: f64, yd: f64, radius: f64) -> Option<(f64, f64)> {
        let (mut x, mut y) = (xd, yd);
        for _ in 0..50 {
            let (fx, fy) = self.apply(x, y);
            let (ex, ey) = (fx - xd, fy - yd);
            let s = x * x + y * y;
            let radial = self.radial(s);
            let slope = 2.0 * (self.k1 + s * (2.0 * self.k2 + 3.0 * self.k3 * s));
            let xx = radial + x * x * slope + 2.0 * self.p1 * y + 6.0 * self.p2 * x;
            let yy = radial + y * y * slope + 6.0 * self.p1 * y + 2.0 * self.p2 * x;
            let xy = x * y * slope + 2.0 * self.p1 * x + 2.0 * self.p2 * y;
            let det = xx * yy - xy * xy;
            x -= (yy * ex - xy * ey) / det;
            y -= (xx * ey - xy * ex) / det;
            if !(x.is_finite() && y.is_finite()) {
                return None;
            }
            if ex.abs() + ey.abs() < 1e-13 {
                return (x.hypot(y) < radius).then_some((x, y));
            }
        }
        None
    }

    /// The ideal radius (tangent of the angle off the axis) up to which the radial polynomial grows,
    /// at most [`WIDEST`].
    #[must_use]
    pub fn monotonic_radius(&self) -> f64 {
        let slope = |s: f64| 1.0 + s * (3.0 * self.k1 + s * (5.0 * self.k2 + s * 7.0 * self.k3));
        let limit = WIDEST * WIDEST;
        let step = 0.01;
        let mut low = 0.0;
        while low < limit {
            if slope(low + step) <= 0.0 {
                let mut high = low + step;
                for _ in 0..60 {
                    let middle = f64::midpoint(low, high);
                    if slope(middle) > 0.0 {
                        low = middle;
                    } else {
                        high = middle;
                    }
                }
                return low.sqrt();
            }
            low += step;
        }
        WIDEST
    }

    fn radial(&self, s: f64) -> f64 {
        1.0 + s * (self.k1 + s * (self.k2 + s * self.k3))
    }
}

/// A ray further from the axis than this tangent (84 degrees) is outside every lens of this model.
pub const WIDEST: f64 = 10.0;

/// A camera as it truly is.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct CameraTruth {
    /// Its name in the cell file.
    pub name: String,
    /// Width of its pictures, px.
    pub width: usize,
    /// Height of its pictures, px.
    pub height: usize,
    /// Focal length along u and v, px.
    pub focal: [f64; 2],
    /// Principal point, px.
    pub principal: [f64; 2],
    /// Lens distortion.
    pub distortion: Distortion,
    /// Pose: world coordinates to camera coordinates, m.
    pub camera_t_world: Isometry3<f64>,
    /// The ideal radius within which the lens model is one to one
    /// ([`Distortion::monotonic_radius`]).
    pub valid_radius: f64,
}

impl CameraTruth {
    /// The pose of a camera at `position` that looks at `look_at` with `up` upwards in the picture;
    /// `None` when these do not fix a direction.
    #[must_use]
    pub fn pose(
        position: &Point3<f64>,
        look_at: &Point3<f64>,
        up: &Vector3<f64>,
    ) -> Option<Isometry3<f64>> {
        let z = (look_at - position).try_normalize(1e-9)?;
        let x = z.cross(up).try_normalize(1e-9)?;
        let y = z.cross(&x);
        let world_r_camera = Rotation3::from_matrix_unchecked(Matrix3::from_columns(&[x, y, z]));
        let world_t_camera = Isometry3::from_parts(
            Translation3::from(position.coords),
            UnitQuaternion::from_rotation_matrix(&world_r_camera),
        );
        Some(world_t_camera.inverse())
    }

    /// The same camera in the words of the vision system, for the judge of an estimate.
    #[must_use]
    pub fn camera(&self) -> Camera {
        let Distortion { k1, k2, p1, p2, k3 } = self.distortion;
        let [fx, fy] = self.focal;
        let [cx, cy] = self.principal;
        Camera {
            rotation: self.camera_t_world.rotation,
            centre: self.position(),
            intrinsics: camera::Intrinsics { fx, fy, cx, cy },
            distortion: camera::Distortion { k1, k2, p1, p2, k3 },
        }
    }

    /// The camera's centre in the world, m.
    #[must_use]
    pub fn position(&self) -> Point3<f64> {
        self.camera_t_world.inverse() * Point3::origin()
    }

    /// Where a world point falls in the image plane, px; `None` behind the camera or where the
    /// lens model has turned back. The place may lie outside the picture.
    #[must_use]
    pub fn project(&self, point: &Point3<f64>) -> Option<(f64, f64)> {
        let p = self.camera_t_world * point;
        if p.z <= 1e-6 {
            return None;
        }
        let (x, y) = (p.x / p.z, p.y / p.z);
        if x.hypot(y) >= self.valid_radius {
            return None;
        }
        Some(self.pixel(x, y))
    }

    /// The direction in the camera frame (z = 1) that is seen at a place of the image plane.
    #[must_use]
    pub fn direction(&self, u: f64, v: f64) -> Option<Vector3<f64>> {
        let xd = (u - self.principal[0]) / self.focal[0];
        let yd = (v - self.principal[1]) / self.focal[1];
        let (x, y) = self.distortion.remove(xd, yd, self.valid_radius)?;
        Some(Vector3::new(x, y, 1.0))
    }

    /// Whether every pixel of the picture has a direction.
    #[must_use]
    pub fn covers_picture(&self) -> bool {
        let (w, h) = (self.width as f64 - 1.0, self.height as f64 - 1.0);
        [(0.0, 0.0), (w, 0.0), (0.0, h), (w, h)]
            .iter()
            .all(|(u, v)| self.direction(*u, *v).is_some())
    }

    /// The pixel of a point at `(x, y)` in the plane 1 m before the camera, distorted.
    #[must_use]
    pub fn pixel(&self, x: f64, y: f64) -> (f64, f64) {
        let (xd, yd) = self.distortion.apply(x, y);
        (
            self.focal[0] * xd + self.principal[0],
            self.focal[1] * yd + self.principal[1],
        )
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn lens() -> Distortion {
        Distortion {
            k1: -0.15,
            k2: 0.04,
            p1: 5e-4,
            p2: -4e-4,
            k3: 0.0,
        }
    }

    fn overhead() -> CameraTruth {
        CameraTruth {
            name: "overhead".into(),
            width: 500,
            height: 500,
            focal: [400.0, 410.0],
            principal: [250.0, 240.0],
            distortion: Distortion::default(),
            camera_t_world: CameraTruth::pose(
                &Point3::new(0.0, 0.0, 3.0),
                &Point3::origin(),
                &Vector3::y(),
            )
            .unwrap(),
            valid_radius: WIDEST,
        }
    }

    #[test]
    fn a_camera_that_looks_down_has_world_y_upwards_in_the_picture() {
        let camera = overhead();
        let close = |a: Option<(f64, f64)>, b: (f64, f64)| {
            let (u, v) = a.unwrap();
            assert!((u - b.0).abs() < 1e-9 && (v - b.1).abs() < 1e-9, "{u} {v}");
        };
        close(camera.project(&Point3::origin()), (250.0, 240.0));
        close(camera.project(&Point3::new(0.3, 0.0, 0.0)), (290.0, 240.0));
        close(camera.project(&Point3::new(0.0, 0.3, 0.0)), (250.0, 199.0));
        assert_eq!(camera.project(&Point3::new(0.0, 0.0, 3.5)), None);
        assert!((camera.position() - Point3::new(0.0, 0.0, 3.0)).norm() < 1e-12);
    }

    #[test]
    fn a_known_distorted_point_comes_out_as_computed_by_hand() {
        // x = 0.5, y = -0.25: s = 0.3125, radial = 1 - 0.15 s + 0.04 s^2 = 0.95703125.
        let (x, y) = lens().apply(0.5, -0.25);
        let expected_x = 0.5 * 0.957_031_25 + 2.0 * 5e-4 * -0.125 - 4e-4 * (0.3125 + 0.5);
        let expected_y = -0.25 * 0.957_031_25 + 5e-4 * (0.3125 + 0.125) - 2.0 * 4e-4 * -0.125;
        assert!((x - expected_x).abs() < 1e-15 && (y - expected_y).abs() < 1e-15);
    }

    #[test]
    fn the_valid_radius_is_where_the_radial_slope_is_zero() {
        let barrel = Distortion {
            k1: -0.3,
            ..Distortion::default()
        };
        assert!((barrel.monotonic_radius() - (1.0_f64 / 0.9).sqrt()).abs() < 1e-9);
        assert_eq!(Distortion::default().monotonic_radius(), WIDEST);
    }

    proptest! {
        #[test]
        fn removing_the_distortion_undoes_it(x in -0.9..0.9_f64, y in -0.9..0.9_f64) {
            let (xd, yd) = lens().apply(x, y);
            let (xu, yu) = lens().remove(xd, yd, 10.0).unwrap();
            prop_assert!((x - xu).hypot(y - yu) < 1e-11);
        }
    }
}
