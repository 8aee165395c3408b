//! A lamp of the cell: `[[lamp]]`.

use ctos_config::diagnostic::Finding;
use serde::Deserialize;
use toml::Spanned;

use super::{
    super::{ArmSpec, LampSpec},
    check::{Check, GREY},
};

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct LampText {
    pub(super) name: Spanned<String>,
    arm: Option<Spanned<String>>,
    link: Option<Spanned<String>>,
    offset: Spanned<[f64; 3]>,
    radius: Spanned<f64>,
    brightness: Spanned<f64>,
    #[serde(default = "yes")]
    on: bool,
}

const fn yes() -> bool {
    true
}

impl LampText {
    pub(super) fn check(
        &self,
        name: String,
        arms: &[ArmSpec],
        floor_grey: f64,
        check: &mut Check<'_>,
    ) -> LampSpec {
        let brightness = check.number(
            &self.brightness,
            "the lamp's brightness",
            "grey levels",
            GREY,
        );
        if floor_grey + brightness > 255.0 {
            check.findings.push(
                Finding::warning(
                    "sim::cell::saturates",
                    format!(
                        "a lamp of {brightness} on a floor of {floor_grey} grey levels saturates the sensor"
                    ),
                )
                .at(check.source.at(self.brightness.span()))
                .help("keep their sum below 255, or centres of spots will be worse"),
            );
        }
        let mount = check.mount(arms, self.arm.as_ref(), self.link.as_ref());
        // From a joint a lamp is not further away than this; in the room it may be anywhere.
        let reach = if self.arm.is_some() { 0.5 } else { 10.0 };
        LampSpec {
            name,
            mount,
            offset: check.point(&self.offset, "the lamp's offset", reach).into(),
            radius: check.number(&self.radius, "the lamp's radius", "m", [1e-3, 0.1]),
            brightness,
            on: self.on,
        }
    }
}
