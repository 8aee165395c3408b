//! The lens of a camera, from the pyramid that it sees.

use foxglove::messages::{CameraCalibration, Timestamp};

/// A camera without distortion whose picture of `size` px fills the pyramid with these corners: left above, right above,
/// right below, left below, in its frame. None of a pyramid that is no picture's.
pub(crate) fn calibration(
    corners: &[[f64; 3]; 4],
    size: [u32; 2],
    frame_id: String,
    timestamp: Timestamp,
) -> Option<CameraCalibration> {
    let [[left, top, depth], _, [right, bottom, _], _] = *corners;
    let [width, height] = size.map(f64::from);
    let lens = |low: f64, high: f64, pixels: f64| {
        let focal = pixels * depth / (high - low);
        // The corner is half a pixel before the middle of the first one.
        (focal, -low / depth * focal - 0.5)
    };
    let (fx, cx) = lens(left, right, width);
    let (fy, cy) = lens(top, bottom, height);
    let all = [fx, cx, fy, cy];
    if !all.iter().all(|number| number.is_finite()) || fx <= 0.0 || fy <= 0.0 {
        return None;
    }
    Some(CameraCalibration {
        timestamp: Some(timestamp),
        frame_id,
        width: size[0],
        height: size[1],
        k: vec![fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0],
        r: vec![1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
        p: vec![fx, 0.0, cx, 0.0, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0],
        ..CameraCalibration::default()
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_corners_of_the_pyramid_are_the_corners_of_the_picture() {
        let corners = [
            [-0.3, -0.2, 0.5],
            [0.35, -0.2, 0.5],
            [0.35, 0.25, 0.5],
            [-0.3, 0.25, 0.5],
        ];
        let size = [320, 240];
        let camera = calibration(&corners, size, String::new(), Timestamp::MIN).unwrap();
        let [fx, _, cx, _, fy, cy, ..] = camera.k[..] else {
            panic!("{camera:?}");
        };
        let pixels = [[-0.5, -0.5], [319.5, -0.5], [319.5, 239.5], [-0.5, 239.5]];
        for ([x, y, z], [u, v]) in corners.into_iter().zip(pixels) {
            assert!((fx * x / z + cx - u).abs() < 1e-9);
            assert!((fy * y / z + cy - v).abs() < 1e-9);
        }
        let flat = [[0.0; 3]; 4];
        assert!(calibration(&flat, size, String::new(), Timestamp::MIN).is_none());
    }
}
