//! Calibration results as files: ROS `camera_info` YAML for the lens, and a poses YAML for where the cameras stand.
//!
//! ROS counts pixel centres as whole numbers and its optical frame has x right, y down, z forward, as we do,
//! so the numbers go over unchanged. Every number reads back to the same bits.

use nalgebra::{Point3, Quaternion, UnitQuaternion};
use serde::{Deserialize, Serialize};
use serde_saphyr::FlowSeq;

use crate::{
    calibrate::Calibration,
    camera::{Camera, Distortion, Intrinsics},
};

/// A file that is not what it should be, or numbers that cannot be written.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum CameraFileError {
    /// Not YAML of the expected keys; the text has line and column.
    #[error("{0}")]
    Yaml(String),
    /// A matrix has another shape.
    #[error("`{key}` is {rows} x {cols} with {numbers} numbers, not {expected}")]
    Shape {
        /// Which matrix.
        key: &'static str,
        /// Its rows.
        rows: usize,
        /// Its columns.
        cols: usize,
        /// The numbers in it.
        numbers: usize,
        /// What it should be.
        expected: &'static str,
    },
    /// A model that we do not know.
    #[error("distortion model `{0}` is not known here; `plumb_bob` is")]
    Model(String),
    /// NaN or infinite numbers, or focal lengths that are not positive.
    #[error("`{0}` holds numbers that no camera has")]
    Numbers(&'static str),
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Matrix {
    rows: usize,
    cols: usize,
    data: FlowSeq<Vec<f64>>,
}

impl Matrix {
    fn new(rows: usize, cols: usize, data: &[f64]) -> Self {
        Self {
            rows,
            cols,
            data: FlowSeq(data.to_vec()),
        }
    }

    fn numbers<const N: usize>(
        &self,
        key: &'static str,
        shape: (usize, usize),
        expected: &'static str,
    ) -> Result<[f64; N], CameraFileError> {
        let wrong = || CameraFileError::Shape {
            key,
            rows: self.rows,
            cols: self.cols,
            numbers: self.data.0.len(),
            expected,
        };
        if (self.rows, self.cols) != shape {
            return Err(wrong());
        }
        let numbers: [f64; N] = self.data.0.as_slice().try_into().map_err(|_| wrong())?;
        let finite = numbers.iter().all(|number| number.is_finite());
        finite
            .then_some(numbers)
            .ok_or(CameraFileError::Numbers(key))
    }
}

/// The keys of a `camera_info` file in ROS's order.
#[derive(Serialize, Deserialize)]
struct CameraInfoFile {
    image_width: usize,
    image_height: usize,
    camera_name: String,
    camera_matrix: Matrix,
    distortion_model: String,
    distortion_coefficients: Matrix,
    rectification_matrix: Matrix,
    projection_matrix: Matrix,
}

/// What a `camera_info` file says of a camera's lens.
#[derive(Debug, Clone, PartialEq)]
pub struct CameraInfo {
    /// The camera's name.
    pub name: String,
    /// Picture width, px.
    pub width: usize,
    /// Picture height, px.
    pub height: usize,
    /// Pinhole.
    pub intrinsics: Intrinsics,
    /// Lens distortion.
    pub distortion: Distortion,
}

impl CameraInfo {
    /// The lens of a calibrated camera.
    #[must_use]
    pub fn of(name: &str, calibration: &Calibration) -> Self {
        Self {
            name: name.to_owned(),
            width: calibration.width,
            height: calibration.height,
            intrinsics: calibration.camera.intrinsics,
            distortion: calibration.camera.distortion,
        }
    }

    /// As ROS `camera_info` YAML: not rectified (identity), projection matrix [K | 0].
    ///
    /// # Errors
    /// [`CameraFileError`] when a number is not finite.
    pub fn to_yaml(&self) -> Result<String, CameraFileError> {
        let (i, d) = (&self.intrinsics, &self.distortion);
        let numbers = [i.fx, i.fy, i.cx, i.cy, d.k1, d.k2, d.p1, d.p2, d.k3];
        if !numbers.iter().all(|number| number.is_finite()) {
            return Err(CameraFileError::Numbers("camera_matrix"));
        }
        write(&CameraInfoFile {
            image_width: self.width,
            image_height: self.height,
            camera_name: self.name.clone(),
            camera_matrix: Matrix::new(3, 3, &[i.fx, 0.0, i.cx, 0.0, i.fy, i.cy, 0.0, 0.0, 1.0]),
            distortion_model: "plumb_bob".to_owned(),
            distortion_coefficients: Matrix::new(1, 5, &[d.k1, d.k2, d.p1, d.p2, d.k3]),
            rectification_matrix: Matrix::new(3, 3, &[1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]),
            projection_matrix: Matrix::new(
                3,
                4,
                &[
                    i.fx, 0.0, i.cx, 0.0, 0.0, i.fy, i.cy, 0.0, 0.0, 0.0, 1.0, 0.0,
                ],
            ),
        })
    }

    /// Reads `camera_info` YAML; further keys that ROS tools write (binning, region of interest) are ignored.
    ///
    /// # Errors
    /// [`CameraFileError`] with the key, or line and column.
    pub fn from_yaml(text: &str) -> Result<Self, CameraFileError> {
        let file: CameraInfoFile = read(text)?;
        if file.distortion_model != "plumb_bob" {
            return Err(CameraFileError::Model(file.distortion_model));
        }
        let [fx, skew, cx, z1, fy, cy, z2, z3, one] =
            file.camera_matrix
                .numbers("camera_matrix", (3, 3), "3 x 3 with 9")?;
        let pinhole = fx > 0.0 && fy > 0.0 && [skew, z1, z2, z3] == [0.0; 4] && one == 1.0;
        if !pinhole {
            return Err(CameraFileError::Numbers("camera_matrix"));
        }
        let coefficients = &file.distortion_coefficients;
        let [k1, k2, p1, p2, k3] =
            coefficients.numbers("distortion_coefficients", (1, 5), "1 x 5 with 5")?;
        Ok(Self {
            name: file.camera_name,
            width: file.image_width,
            height: file.image_height,
            intrinsics: Intrinsics { fx, fy, cx, cy },
            distortion: Distortion { k1, k2, p1, p2, k3 },
        })
    }
}

/// Where one camera stands, and how well that is known.
#[derive(Debug, Clone, PartialEq)]
pub struct CameraPose {
    /// The camera's name.
    pub name: String,
    /// Orientation: turns world directions into the camera frame.
    pub rotation: UnitQuaternion<f64>,
    /// The camera's centre in the world, m.
    pub centre: Point3<f64>,
    /// Standard deviations of the centre along the world's axes, m.
    pub position_sd_m: [f64; 3],
    /// Standard deviations of the rotation vector about the camera's axes, rad.
    pub rotation_sd_rad: [f64; 3],
    /// Standard deviations of fx, fy, cx, cy, px.
    pub intrinsics_sd_px: [f64; 4],
    /// Standard deviations of k1, k2, p1, p2, k3; 0 for terms that the lens model leaves out.
    pub distortion_sd: [f64; 5],
    /// Relative standard deviation of the focal length.
    pub focal_sd_rel: f64,
    /// Root of the mean over the points of du² + dv², px.
    pub rms_px: f64,
}

impl CameraPose {
    /// The pose of a calibrated camera.
    #[must_use]
    pub fn of(name: &str, calibration: &Calibration) -> Self {
        let [rx, ry, rz, x, y, z, fx, fy, cx, cy, k1, k2, p1, p2, k3] =
            calibration.uncertainty.parameter_sd;
        Self {
            name: name.to_owned(),
            rotation: calibration.camera.rotation,
            centre: calibration.camera.centre,
            position_sd_m: [x, y, z],
            rotation_sd_rad: [rx, ry, rz],
            intrinsics_sd_px: [fx, fy, cx, cy],
            distortion_sd: [k1, k2, p1, p2, k3],
            focal_sd_rel: calibration.uncertainty.focal_sd_rel,
            rms_px: calibration.rms_px,
        }
    }
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct PosesFile {
    cameras: Vec<PoseEntry>,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct PoseEntry {
    camera_name: String,
    /// x_camera = R x_world + t: translation t in m, rotation as a unit quaternion x y z w.
    #[serde(rename = "camera_T_world")]
    camera_from_world: Transform,
    position_m: FlowSeq<Vec<f64>>,
    position_sd_m: FlowSeq<Vec<f64>>,
    rotation_sd_rad: FlowSeq<Vec<f64>>,
    intrinsics_sd_px: FlowSeq<Vec<f64>>,
    distortion_sd: FlowSeq<Vec<f64>>,
    focal_sd_rel: f64,
    rms_px: f64,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Transform {
    translation_m: FlowSeq<Vec<f64>>,
    rotation_xyzw: FlowSeq<Vec<f64>>,
}

/// The poses of cameras as YAML: `camera_T_world`, the centre in the world, and standard deviations.
///
/// # Errors
/// [`CameraFileError`] when it cannot be written.
pub fn poses_to_yaml(poses: &[CameraPose]) -> Result<String, CameraFileError> {
    let entry = |pose: &CameraPose| {
        let t = -(pose.rotation * pose.centre.coords);
        PoseEntry {
            camera_name: pose.name.clone(),
            camera_from_world: Transform {
                translation_m: FlowSeq(t.iter().copied().collect()),
                rotation_xyzw: FlowSeq(pose.rotation.coords.iter().copied().collect()),
            },
            position_m: FlowSeq(pose.centre.coords.iter().copied().collect()),
            position_sd_m: FlowSeq(pose.position_sd_m.to_vec()),
            rotation_sd_rad: FlowSeq(pose.rotation_sd_rad.to_vec()),
            intrinsics_sd_px: FlowSeq(pose.intrinsics_sd_px.to_vec()),
            distortion_sd: FlowSeq(pose.distortion_sd.to_vec()),
            focal_sd_rel: pose.focal_sd_rel,
            rms_px: pose.rms_px,
        }
    };
    write(&PosesFile {
        cameras: poses.iter().map(entry).collect(),
    })
}

/// Reads what [`poses_to_yaml`] wrote. The centre is taken from `position_m`, which must agree with `camera_T_world`.
///
/// # Errors
/// [`CameraFileError`] with the key, or line and column.
pub fn poses_from_yaml(text: &str) -> Result<Vec<CameraPose>, CameraFileError> {
    let file: PosesFile = read(text)?;
    file.cameras.into_iter().map(pose_of).collect()
}

fn pose_of(entry: PoseEntry) -> Result<CameraPose, CameraFileError> {
    let [x, y, z, w] = fixed("rotation_xyzw", &entry.camera_from_world.rotation_xyzw)?;
    let quaternion = Quaternion::new(w, x, y, z);
    if (quaternion.norm() - 1.0).abs() > 1e-6 {
        return Err(CameraFileError::Numbers("rotation_xyzw"));
    }
    // Normalising again would change the last bits.
    let rotation = UnitQuaternion::new_unchecked(quaternion);
    let centre = Point3::from(fixed::<3>("position_m", &entry.position_m)?);
    let t = nalgebra::Vector3::from(fixed::<3>(
        "translation_m",
        &entry.camera_from_world.translation_m,
    )?);
    if (rotation * centre.coords + t).norm() > 1e-6 * (1.0 + t.norm()) {
        return Err(CameraFileError::Numbers("position_m"));
    }
    Ok(CameraPose {
        name: entry.camera_name,
        rotation,
        centre,
        position_sd_m: fixed("position_sd_m", &entry.position_sd_m)?,
        rotation_sd_rad: fixed("rotation_sd_rad", &entry.rotation_sd_rad)?,
        intrinsics_sd_px: fixed("intrinsics_sd_px", &entry.intrinsics_sd_px)?,
        distortion_sd: fixed("distortion_sd", &entry.distortion_sd)?,
        focal_sd_rel: entry.focal_sd_rel,
        rms_px: entry.rms_px,
    })
}

impl CameraInfo {
    /// This lens at that place.
    #[must_use]
    pub fn at(&self, pose: &CameraPose) -> Camera {
        Camera {
            rotation: pose.rotation,
            centre: pose.centre,
            intrinsics: self.intrinsics,
            distortion: self.distortion,
        }
    }
}

fn fixed<const N: usize>(
    key: &'static str,
    numbers: &FlowSeq<Vec<f64>>,
) -> Result<[f64; N], CameraFileError> {
    let expected = match N {
        3 => "3 numbers",
        4 => "4 numbers",
        _ => "5 numbers",
    };
    let found = numbers.0.len();
    let wrong = CameraFileError::Shape {
        key,
        rows: 1,
        cols: found,
        numbers: found,
        expected,
    };
    let numbers: [f64; N] = numbers.0.as_slice().try_into().map_err(|_| wrong)?;
    let finite = numbers.iter().all(|number| number.is_finite());
    finite
        .then_some(numbers)
        .ok_or(CameraFileError::Numbers(key))
}

fn write<T: Serialize>(value: &T) -> Result<String, CameraFileError> {
    serde_saphyr::to_string(value).map_err(|error| CameraFileError::Yaml(error.to_string()))
}

fn read<T: for<'de> Deserialize<'de>>(text: &str) -> Result<T, CameraFileError> {
    serde_saphyr::from_str(text).map_err(|error| CameraFileError::Yaml(error.to_string()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::tests::ceiling_camera;
    use proptest::prelude::*;

    fn info() -> CameraInfo {
        let camera = ceiling_camera();
        let distortion = Distortion {
            p1: 5e-7,
            k3: -1.25e-10,
            ..camera.distortion
        };
        CameraInfo {
            name: "ceiling_left".into(),
            width: 500,
            height: 480,
            intrinsics: camera.intrinsics,
            distortion,
        }
    }

    /// As written by ROS's own `camera_calibration`.
    const BY_ROS: &str = "image_width: 640
image_height: 480
camera_name: head_camera
camera_matrix:
  rows: 3
  cols: 3
  data: [ 438.783367, 0.000000, 305.593336, 0.000000, 437.302876, 243.738352, 0.000000, 0.000000, 1.000000]
distortion_model: plumb_bob
distortion_coefficients:
  rows: 1
  cols: 5
  data: [-0.361976, 0.110510, 0.001014, 0.000505, 0.000000]
rectification_matrix:
  rows: 3
  cols: 3
  data: [1, 0, 0, 0, 1, 0, 0, 0, 1]
projection_matrix:
  rows: 3
  cols: 4
  data: [393.653800, 0.000000, 322.797939, 0.000000, 0.000000, 393.653800, 241.090902, 0, 0, 0, 1, 0]
";

    #[test]
    fn a_file_written_by_ros_is_read() {
        let info = CameraInfo::from_yaml(BY_ROS).unwrap();
        assert_eq!(
            (info.name.as_str(), info.width, info.height),
            ("head_camera", 640, 480)
        );
        assert_eq!(
            info.intrinsics,
            Intrinsics {
                fx: 438.783_367,
                fy: 437.302_876,
                cx: 305.593_336,
                cy: 243.738_352
            }
        );
        assert_eq!(
            info.distortion,
            Distortion {
                k1: -0.361_976,
                k2: 0.110_51,
                p1: 0.001_014,
                p2: 0.000_505,
                k3: 0.0
            }
        );
    }

    #[test]
    fn ours_has_the_keys_in_order_and_numbers_that_every_yaml_reader_takes_as_numbers() {
        let text = info().to_yaml().unwrap();
        let keys: Vec<&str> = text
            .lines()
            .filter(|l| !l.starts_with(' '))
            .filter_map(|l| l.split(':').next())
            .collect();
        let by_ros: Vec<&str> = BY_ROS
            .lines()
            .filter(|l| !l.starts_with(' '))
            .filter_map(|l| l.split(':').next())
            .collect();
        assert_eq!(keys, by_ros);
        // YAML 1.1 readers (ROS's Python tools) take 5e-7 for a word: there must be a dot and a signed exponent.
        for number in text
            .lines()
            .filter(|l| l.contains('['))
            .flat_map(|l| l.split(['[', ']', ',']))
        {
            if let Some((mantissa, exponent)) = number
                .split_once(['e', 'E'])
                .filter(|(m, _)| !m.contains("data"))
            {
                assert!(
                    mantissa.contains('.') && exponent.starts_with(['-', '+']),
                    "{number} in {text}"
                );
            }
        }
    }

    #[test]
    fn what_is_wrong_in_a_file_is_said() {
        let refused = |from: &str, to: &str| {
            CameraInfo::from_yaml(&BY_ROS.replace(from, to))
                .unwrap_err()
                .to_string()
        };
        assert!(refused("plumb_bob", "equidistant").contains("`equidistant` is not known"));
        assert!(
            refused("cols: 5", "cols: 8").contains("`distortion_coefficients` is 1 x 8 with 5")
        );
        assert!(refused("438.783367", "-438.783367").contains("`camera_matrix`"));
        assert!(refused("438.783367", ".nan").contains("`camera_matrix`"));
        assert!(refused("image_width: 640\n", "").contains("image_width"));
    }

    proptest! {
        #[test]
        fn every_bit_survives_the_files(
            lens in prop::array::uniform9(-1e3..1e3_f64), tiny in -1e-9..1e-9_f64,
            axis in prop::array::uniform3(-3.0..3.0_f64), centre in prop::array::uniform3(-10.0..10.0_f64),
        ) {
            let [fx, fy, cx, cy, k1, k2, p1, p2, _] = lens;
            let info = CameraInfo {
                intrinsics: Intrinsics { fx: fx.abs() + 1.0, fy: fy.abs() + 1.0, cx, cy },
                distortion: Distortion { k1, k2, p1, p2, k3: tiny },
                ..info()
            };
            prop_assert_eq!(CameraInfo::from_yaml(&info.to_yaml().unwrap()).unwrap(), info);
            let pose = CameraPose {
                name: "a: #b".into(), rotation: UnitQuaternion::new(axis.into()), centre: centre.into(),
                position_sd_m: [1e-3, tiny.abs(), 2e-3], rotation_sd_rad: [tiny.abs(); 3],
                intrinsics_sd_px: [tiny.abs(); 4], distortion_sd: [tiny.abs(), 0.0, 1e-3, 2e-4, 0.0], focal_sd_rel: 1e-4, rms_px: 0.2,
            };
            let poses = vec![pose.clone(), pose];
            prop_assert_eq!(poses_from_yaml(&poses_to_yaml(&poses).unwrap()).unwrap(), poses);
        }

        #[test]
        fn no_text_panics(text in "\\PC{0,200}", cut in 0_usize..800) {
            let _ = CameraInfo::from_yaml(&text);
            let _ = poses_from_yaml(&text);
            let _ = CameraInfo::from_yaml(BY_ROS.get(..cut).unwrap_or(BY_ROS));
        }
    }
}
