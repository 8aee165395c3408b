//! A laser scanner of the cell, or a pointer that an arm carries: `[[laser]]`.

use serde::Deserialize;
use toml::Spanned;
use vss_tools::laser::Scanner;

use super::{
    super::{ArmSpec, LaserSpec},
    check::{Check, GREY},
};
use crate::camera::truth::CameraTruth;

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct LaserText {
    pub(super) name: Spanned<String>,
    arm: Option<Spanned<String>>,
    link: Option<Spanned<String>>,
    position: Spanned<[f64; 3]>,
    look_at: Spanned<[f64; 3]>,
    up: Spanned<[f64; 3]>,
    mirror_offset: Option<Spanned<f64>>,
    gain: Option<Spanned<[f64; 2]>>,
    zero: Option<Spanned<[f64; 2]>>,
    radius: Spanned<f64>,
    brightness: Spanned<f64>,
}

/// Degrees for a command of 1, and degrees at 0.
const GAIN: f64 = 60.0;

impl LaserText {
    pub(super) fn check(&self, name: String, arms: &[ArmSpec], check: &mut Check<'_>) -> LaserSpec {
        let mount = check.mount(arms, self.arm.as_ref(), self.link.as_ref());
        let position = check.point(&self.position, "the laser's position", 100.0);
        let look_at = check.point(&self.look_at, "the point looked at", 100.0);
        let up = check.point(&self.up, "the upward direction", 100.0);
        let pose = CameraTruth::pose(&position.into(), &look_at.into(), &up);
        if pose.is_none() {
            check.refuse(
                self.look_at.span(),
                format!("laser `{name}` has no definite direction"),
                "`look_at` must differ from `position`, and `up` must not point along the way",
            );
        }
        let has_mirrors = self.gain.is_some() && self.mirror_offset.is_some();
        if self.arm.is_none() && !has_mirrors {
            check.refuse(
                self.name.span(),
                format!("scanner `{name}` lacks `gain` or `mirror_offset`"),
                "give both, or name the `arm` that carries it as a pointer",
            );
        }
        let mut degrees = |value: &Spanned<[f64; 2]>, what: &str| {
            let numbers = *value.get_ref();
            if !numbers.iter().all(|number| number.abs() <= GAIN) {
                check.refuse(
                    value.span(),
                    format!("{what} is {numbers:?} degrees"),
                    &format!("give two numbers from -{GAIN} to {GAIN} degrees"),
                );
            }
            numbers.map(f64::to_radians)
        };
        // A pointer has no mirrors: its light goes straight ahead.
        let gain = self.gain.as_ref();
        let gain = gain.map_or([1.0; 2], |gain| {
            degrees(gain, "what a command of 1 turns the light by")
        });
        let zero = self.zero.as_ref();
        let zero = zero.map_or([0.0; 2], |zero| degrees(zero, "the light's angle at 0"));
        if let (true, Some(own)) = (gain.contains(&0.0), &self.gain) {
            check.refuse(
                own.span(),
                format!("a mirror of laser `{name}` does not move"),
                "give two numbers that are not 0",
            );
        }
        LaserSpec {
            name,
            mount,
            scanner: Scanner {
                world_t_scanner: pose.unwrap_or_default().inverse(),
                offset: self.mirror_offset.as_ref().map_or(0.0, |offset| {
                    check.number(offset, "the way between the mirrors", "m", [0.0, 1.0])
                }),
                gain,
                zero,
            },
            radius: check.number(&self.radius, "the radius of the spot", "m", [1e-4, 0.1]),
            brightness: check.number(
                &self.brightness,
                "the laser's brightness",
                "grey levels",
                GREY,
            ),
        }
    }
}
