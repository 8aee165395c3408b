//! A camera of the cell: `[[camera]]`.

use std::time::Duration;

use nalgebra::Isometry3;
use serde::Deserialize;
use toml::Spanned;

use super::{super::CameraSpec, check::Check};
use crate::camera::truth::{CameraTruth, Distortion};

/// Largest picture side, px: a picture stays within a few megabytes.
const LARGEST_SIDE: u32 = 4096;

/// Longest exposure, ms.
const LONGEST_MS: f64 = 10_000.0;

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct CameraText {
    pub(super) name: Spanned<String>,
    pub(super) arm: Option<Spanned<String>>,
    pub(super) link: Option<Spanned<String>>,
    width: Spanned<u32>,
    height: Spanned<u32>,
    fx: Spanned<f64>,
    fy: Spanned<f64>,
    cx: Spanned<f64>,
    cy: Spanned<f64>,
    k1: Spanned<f64>,
    k2: Spanned<f64>,
    p1: Spanned<f64>,
    p2: Spanned<f64>,
    k3: Spanned<f64>,
    position: Spanned<[f64; 3]>,
    look_at: Spanned<[f64; 3]>,
    up: Spanned<[f64; 3]>,
    blur: Spanned<f64>,
    read_noise: Spanned<f64>,
    shot_noise: Spanned<f64>,
    exposure_ms: Option<Spanned<f64>>,
    #[serde(default)]
    colour: bool,
}

impl CameraText {
    pub(super) fn check(&self, check: &mut Check<'_>) -> CameraSpec {
        let before = check.findings.iter().count();
        let [width, height] =
            [(&self.width, "width"), (&self.height, "height")].map(|(side, what)| {
                if !(16..=LARGEST_SIDE).contains(side.get_ref()) {
                    check.refuse(
                        side.span(),
                        format!("the picture's {what} is {} px", side.get_ref()),
                        &format!("give a whole number from 16 to {LARGEST_SIDE}"),
                    );
                }
                *side.get_ref()
            });
        let size = f64::from(width.max(height));
        let mut focal = |value, what| check.number(value, what, "px", [0.1 * size, 100.0 * size]);
        let focal = [focal(&self.fx, "fx"), focal(&self.fy, "fy")];
        let principal = [
            check.number(&self.cx, "cx", "px", [0.0, f64::from(width)]),
            check.number(&self.cy, "cy", "px", [0.0, f64::from(height)]),
        ];
        let mut term = |value, what| check.number(value, what, "", [-10.0, 10.0]);
        let distortion = Distortion {
            k1: term(&self.k1, "k1"),
            k2: term(&self.k2, "k2"),
            p1: term(&self.p1, "p1"),
            p2: term(&self.p2, "p2"),
            k3: term(&self.k3, "k3"),
        };
        let camera_t_world = self.pose(check);
        let spec = CameraSpec {
            mount: None,
            truth: CameraTruth {
                name: self.name.get_ref().clone(),
                width: width as usize,
                height: height as usize,
                focal,
                principal,
                distortion,
                camera_t_world,
                valid_radius: distortion.monotonic_radius(),
            },
            read_noise: check.number(
                &self.read_noise,
                "the read noise",
                "grey levels",
                [0.0, 64.0],
            ),
            shot_noise: check.number(
                &self.shot_noise,
                "the shot noise",
                "grey levels",
                [0.0, 64.0],
            ),
            blur: check.number(&self.blur, "the blur", "px", [0.3, 10.0]),
            colour: self.colour,
            exposure: self
                .exposure_ms
                .as_ref()
                .map_or(Duration::ZERO, |exposure| {
                    let ms = check.number(exposure, "the exposure", "ms", [0.0, LONGEST_MS]);
                    Duration::from_secs_f64(ms.clamp(0.0, LONGEST_MS) / 1e3)
                }),
        };
        // The lens can only be judged when the numbers it is made of are sound.
        if check.findings.iter().count() == before && !spec.truth.covers_picture() {
            let radius = spec.truth.valid_radius;
            check.refuse(
                self.k1.span(),
                format!(
                    "the distortion of camera `{}` turns back inside the picture (it grows only up \
                     to {radius:.2} focal lengths from the axis)",
                    spec.truth.name
                ),
                "make k1, k2, k3 weaker or the focal length longer",
            );
        }
        spec
    }

    fn pose(&self, check: &mut Check<'_>) -> Isometry3<f64> {
        let position = check.point(&self.position, "the camera's position", 100.0);
        let look_at = check.point(&self.look_at, "the point looked at", 100.0);
        let up = check.point(&self.up, "the upward direction", 100.0);
        CameraTruth::pose(&position.into(), &look_at.into(), &up).unwrap_or_else(|| {
            check.refuse(
                self.look_at.span(),
                format!(
                    "camera `{}` has no definite direction of view",
                    self.name.get_ref()
                ),
                "`look_at` must differ from `position`, and `up` must not point along the view",
            );
            Isometry3::identity()
        })
    }
}
