//! What a cell's text is checked with: numbers in their ranges, names that are free, frames and models that there are.

use std::ops::Range;

use ctos_config::diagnostic::{Finding, Findings, Source};
use mcs_model::{
    FrameId, Model, built_in,
    file::{self, Inertias},
    urdf,
};
use nalgebra::Vector3;
use toml::Spanned;

use super::super::{ArmSpec, Mount, ReadModel};
use crate::shapes::Paint;

pub(super) const GREY: [f64; 2] = [0.0, 255.0];

/// Friction of an object or of an arm's surface that the file says nothing of.
pub(super) const FRICTION: f64 = 0.5;

pub(super) struct Check<'a> {
    pub(super) source: &'a Source,
    pub(super) model: ReadModel<'a>,
    /// The names of all arms of the file, also of those that are no good.
    pub(super) arms: Vec<String>,
    pub(super) findings: Findings,
}

impl Check<'_> {
    pub(super) fn refuse(&mut self, span: Range<usize>, message: String, help: &str) {
        self.findings.push(
            Finding::error("sim::cell::bad_value", message)
                .at(self.source.at(span))
                .help(help),
        );
    }

    /// A number within `low..=high`; said of `what`, in `unit`.
    pub(super) fn number(
        &mut self,
        value: &Spanned<f64>,
        what: &str,
        unit: &str,
        [low, high]: [f64; 2],
    ) -> f64 {
        let number = *value.get_ref();
        if !(low..=high).contains(&number) {
            self.refuse(
                value.span(),
                format!("{what} is {number} {unit}"),
                &format!("give a number from {low} to {high} {unit}"),
            );
        }
        number
    }

    /// Numbers within `low..=high` each.
    pub(super) fn each<const N: usize>(
        &mut self,
        values: &Spanned<[f64; N]>,
        what: &str,
        [low, high]: [f64; 2],
    ) -> [f64; N] {
        let numbers = *values.get_ref();
        if !numbers.iter().all(|number| (low..=high).contains(number)) {
            self.refuse(
                values.span(),
                format!("{what} is {numbers:?}"),
                &format!("give numbers from {low} to {high}: N, then N m"),
            );
        }
        numbers
    }

    /// Three coordinates within `reach` of the origin, m.
    pub(super) fn point(
        &mut self,
        value: &Spanned<[f64; 3]>,
        what: &str,
        reach: f64,
    ) -> Vector3<f64> {
        let point = Vector3::from(*value.get_ref());
        if !point.iter().all(|x| (-reach..=reach).contains(x)) {
            self.refuse(
                value.span(),
                format!("{what} is {:?}", value.get_ref()),
                &format!("give three numbers from {} to {reach} m", -reach),
            );
        }
        point
    }

    /// Angles about x, y and z, degrees: none when nothing is said.
    pub(super) fn turn(&mut self, value: Option<&Spanned<[f64; 3]>>) -> [f64; 3] {
        let Some(value) = value else {
            return [0.0; 3];
        };
        if !value
            .get_ref()
            .iter()
            .all(|angle| (-360.0..=360.0).contains(angle))
        {
            self.refuse(
                value.span(),
                format!("the turn is {:?} degrees", value.get_ref()),
                "give three angles from -360 to 360 degrees, about x, then y, then z",
            );
        }
        *value.get_ref()
    }

    /// A factor on what the model says: 1 when nothing is said.
    pub(super) fn factor(&mut self, value: Option<&Spanned<f64>>, what: &str) -> f64 {
        value.map_or(1.0, |value| self.number(value, what, "", [0.01, 100.0]))
    }

    /// What something is painted with: `grey` or `colour`, one of them. `span` is said where both are missing.
    pub(super) fn paint(
        &mut self,
        grey: Option<&Spanned<f64>>,
        colour: Option<&Spanned<[f64; 3]>>,
        what: &str,
        span: Range<usize>,
    ) -> Paint {
        const HELP: &str = "give one of `grey`, a level, and `colour`, levels of red, green and blue, each from 0 to 255";
        match (grey, colour) {
            (Some(grey), None) => {
                let grey = self.number(grey, &format!("the grey of {what}"), "grey levels", GREY);
                Paint::Grey(grey)
            }
            (None, Some(colour)) => {
                let [low, high] = GREY;
                if !colour.get_ref().iter().all(|x| (low..=high).contains(x)) {
                    let message = format!("the colour of {what} is {:?}", colour.get_ref());
                    self.refuse(colour.span(), message, HELP);
                }
                Paint::Colour(*colour.get_ref())
            }
            (None, None) => {
                self.refuse(span, format!("{what} has no colour"), HELP);
                Paint::Grey(0.0)
            }
            (Some(_), Some(colour)) => {
                let message = format!("{what} has both a grey and a colour");
                self.refuse(colour.span(), message, HELP);
                Paint::Grey(0.0)
            }
        }
    }

    /// Refuses a name that is empty or taken.
    pub(super) fn name(
        &mut self,
        what: &str,
        name: &Spanned<String>,
        taken: &mut Vec<String>,
    ) -> String {
        let given = name.get_ref().clone();
        if given.is_empty() || taken.contains(&given) {
            self.refuse(
                name.span(),
                format!("{what} cannot be called `{given}`: the name is empty or taken"),
                &format!(
                    "give every {} its own name",
                    what.split_once(' ').map_or(what, |(_, noun)| noun)
                ),
            );
        }
        taken.push(given.clone());
        given
    }

    /// What carries something: the tip of `arm`, or its `link`; nothing when no arm is named.
    pub(super) fn mount(
        &mut self,
        arms: &[ArmSpec],
        arm: Option<&Spanned<String>>,
        link: Option<&Spanned<String>>,
    ) -> Option<Mount> {
        let Some(arm) = arm else {
            if let Some(link) = link {
                self.refuse(
                    link.span(),
                    format!("link `{}` is of no arm", link.get_ref()),
                    "say which one besides: `arm = \"NAME\"`",
                );
            }
            return None;
        };
        let names = || arms.iter().map(|arm| arm.name.as_str());
        let Some(index) = names().position(|name| name == arm.get_ref()) else {
            if self.arms.contains(arm.get_ref()) {
                return None;
            }
            let message = format!("the cell has no arm `{}`", arm.get_ref());
            self.findings.push(
                Finding::error("sim::cell::unknown_arm", message)
                    .at(self.source.at(arm.span()))
                    .suggest(arm.get_ref(), names()),
            );
            return None;
        };
        let model = &arms.get(index)?.model;
        let frame = match link {
            None => model.tip(),
            Some(link) => self.frame(model, link)?,
        };
        Some(Mount { arm: index, frame })
    }

    pub(super) fn frame(&mut self, model: &Model, link: &Spanned<String>) -> Option<FrameId> {
        let found = model.frame(link.get_ref());
        if found.is_none() {
            let message = format!("model `{}` has no frame `{}`", model.name(), link.get_ref());
            let names = model.frames().iter().map(|frame| frame.name.as_str());
            self.findings.push(
                Finding::error("sim::cell::unknown_link", message)
                    .at(self.source.at(link.span()))
                    .suggest(link.get_ref(), names),
            );
        }
        found
    }

    /// The model of that name, or of that file.
    pub(super) fn model(&mut self, name: &Spanned<String>) -> Option<Model> {
        let (given, inertias) = (name.get_ref().as_str(), Inertias::Engine);
        let read = match built_in::model(given, inertias) {
            Some(model) => model,
            None if given.ends_with(".urdf") => (self.model)(given)
                .and_then(|source| urdf::parse(&source, None, None))
                .map(|read| read.model)
                .map_err(Findings::from),
            None if given.ends_with(".toml") => (self.model)(given)
                .map_err(Findings::from)
                .and_then(|source| file::parse(&source, inertias)),
            None => {
                let message = format!("there is no model `{given}`");
                Err(Finding::error("sim::cell::unknown_model", message)
                    .suggest(given, built_in::NAMES)
                    .into())
            }
        };
        match read {
            Ok(model) => Some(model),
            Err(found) => {
                for finding in found.into_sorted() {
                    let place = finding.place.clone();
                    self.findings
                        .push(finding.at(place.unwrap_or_else(|| self.source.at(name.span()))));
                }
                None
            }
        }
    }
}
