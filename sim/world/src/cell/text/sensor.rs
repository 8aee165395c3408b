//! A force-torque sensor of the cell: `[[force_torque]]`.

use mcs_model::{Body, FrameId, Model};
use serde::Deserialize;
use toml::Spanned;

use super::{
    super::{ArmSpec, SensorSpec},
    check::Check,
};
use crate::wrist::Electronics;

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct SensorText {
    pub(super) name: Spanned<String>,
    arm: Spanned<String>,
    link: Option<Spanned<String>>,
    load: Option<LoadText>,
    compensates: Option<LoadText>,
    #[serde(default)]
    compensates_hand: bool,
    bias: Option<Spanned<[f64; 6]>>,
    noise: Option<Spanned<[f64; 2]>>,
    filter_hz: Option<Spanned<f64>>,
    #[serde(default = "one")]
    seed: u64,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct LoadText {
    mass: Spanned<f64>,
    centre: Spanned<[f64; 3]>,
}

const fn one() -> u64 {
    1
}

/// The frames that hang on a frame, each with what is fixed to it.
pub(super) fn hanging(model: &Model, frame: FrameId) -> impl Iterator<Item = (FrameId, Body)> {
    let all = model.hanging(frame);
    all.map(|(frame, body)| (frame, *body))
}

impl LoadText {
    fn check(&self, check: &mut Check<'_>) -> Body {
        let mass = check.number(&self.mass, "the mass behind a sensor", "kg", [0.0, 100.0]);
        let what = "the centre of what hangs behind a sensor";
        let centre = check.point(&self.centre, what, 1.0);
        Body::diagonal(mass, centre.into(), [0.0; 3])
    }
}

impl SensorText {
    /// The sensor, of what hangs on it only its load; that becomes part of its arm.
    pub(super) fn check(
        &self,
        name: String,
        arms: &mut [ArmSpec],
        check: &mut Check<'_>,
    ) -> Option<SensorSpec> {
        let usual = Electronics::default();
        let mut load = |text: &Option<LoadText>| {
            let text = text.as_ref();
            text.map_or_else(Body::default, |text| text.check(check))
        };
        let (load, compensates) = (load(&self.load), load(&self.compensates));
        let bias = self.bias.as_ref();
        let bias = bias.map_or(usual.bias, |bias| {
            check.each(bias, "the bias of a sensor", [-1000.0, 1000.0])
        });
        let noise = self.noise.as_ref();
        let noise = noise.map_or(usual.noise, |noise| {
            check.each(noise, "the noise of a sensor", [0.0, 100.0])
        });
        let filter_hz = self.filter_hz.as_ref().map_or(usual.filter_hz, |corner| {
            check.number(corner, "the filter of a sensor", "Hz", [0.01, 1e6])
        });
        let mount = check.mount(arms, Some(&self.arm), self.link.as_ref())?;
        let arm = arms.get_mut(mount.arm)?;
        arm.model = arm.model.clone().with_body(mount.frame, &load);
        let mut known = vec![(mount.frame, compensates)];
        if self.compensates_hand {
            known.extend(hanging(&arm.nominal, mount.frame));
        }
        Some(SensorSpec {
            name,
            mount,
            hanging: vec![(mount.frame, load)],
            known,
            electronics: Electronics {
                bias,
                noise,
                filter_hz,
                seed: self.seed,
            },
        })
    }
}
