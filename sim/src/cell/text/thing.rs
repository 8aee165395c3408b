//! What lies and stands in the cell: `[[object]]`, `[[furniture]]` and `[[mark]]`.

use mcs::model::Placement;
use nalgebra::{Point3, Vector3};
use serde::Deserialize;
use toml::Spanned;

use super::{
    super::ObjectSpec,
    check::{Check, FRICTION},
};
use crate::shapes::{Shape, Solid};

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct ObjectText {
    pub(super) name: Spanned<String>,
    shape: Spanned<FormText>,
    size: Option<Spanned<[f64; 3]>>,
    radius: Option<Spanned<f64>>,
    height: Option<Spanned<f64>>,
    mass: Spanned<f64>,
    friction: Option<Spanned<f64>>,
    grey: Option<Spanned<f64>>,
    colour: Option<Spanned<[f64; 3]>>,
    pub(super) position: Spanned<[f64; 3]>,
    rpy: Option<Spanned<[f64; 3]>>,
}

#[derive(Deserialize, Clone, Copy, PartialEq)]
#[serde(rename_all = "lowercase")]
enum FormText {
    Box,
    Sphere,
    Cylinder,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct FurnitureText {
    centre: Spanned<[f64; 3]>,
    size: Spanned<[f64; 3]>,
    grey: Option<Spanned<f64>>,
    colour: Option<Spanned<[f64; 3]>>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct MarkText {
    centre: Spanned<[f64; 3]>,
    normal: Spanned<[f64; 3]>,
    radius: Spanned<f64>,
    grey: Option<Spanned<f64>>,
    colour: Option<Spanned<[f64; 3]>>,
}

/// What each form needs.
const FORMS: &str = "a box has `size`, its edge lengths along x, y and z; a sphere `radius`; a cylinder `radius` and `height` along z; all in m";

impl ObjectText {
    pub(super) fn check(&self, name: String, check: &mut Check<'_>) -> ObjectSpec {
        let origin = check.point(&self.position, "the position of an object", 10.0);
        ObjectSpec {
            shape: Shape {
                solid: self.solid(check),
                paint: check.paint(
                    self.grey.as_ref(),
                    self.colour.as_ref(),
                    "an object",
                    self.shape.span(),
                ),
            },
            mass: check.number(&self.mass, "the mass of an object", "kg", [1e-4, 1000.0]),
            friction: self.friction.as_ref().map_or(FRICTION, |friction| {
                check.number(friction, "the friction of an object", "", [0.0, 10.0])
            }),
            start: Placement::from_degrees(origin.into(), check.turn(self.rpy.as_ref())).isometry(),
            name,
        }
    }

    fn solid(&self, check: &mut Check<'_>) -> Solid {
        let mut length = |value: Option<&Spanned<f64>>, what: &str| match value {
            Some(value) => check.number(value, what, "m", [1e-3, 10.0]),
            None => {
                let message = format!("object `{}` has no {what}", self.name.get_ref());
                check.refuse(self.shape.span(), message, FORMS);
                1.0
            }
        };
        match self.shape.get_ref() {
            FormText::Sphere => Solid::Capsule {
                a: Point3::origin(),
                b: Point3::origin(),
                radius: length(self.radius.as_ref(), "radius"),
            },
            FormText::Cylinder => Solid::Cylinder {
                half: length(self.height.as_ref(), "height") / 2.0,
                radius: length(self.radius.as_ref(), "radius"),
            },
            FormText::Box => {
                let size = self.size.as_ref().map(|size| {
                    (
                        size.span(),
                        check.point(size, "the size of an object", 10.0),
                    )
                });
                let (span, size) = size.unwrap_or((self.shape.span(), Vector3::zeros()));
                if size.min() < 1e-3 {
                    let message = format!(
                        "object `{}` has no size, or is thinner than 1 mm",
                        self.name.get_ref()
                    );
                    check.refuse(span, message, FORMS);
                }
                Solid::Block {
                    centre: Point3::origin(),
                    half: size / 2.0,
                }
            }
        }
    }
}

impl FurnitureText {
    pub(super) fn check(&self, check: &mut Check<'_>) -> Shape {
        let centre = check.point(&self.centre, "the centre of a piece of furniture", 10.0);
        let size = check.point(&self.size, "the size of a piece of furniture", 10.0);
        if size.min() < 1e-3 {
            check.refuse(
                self.size.span(),
                "a piece of furniture is thinner than 1 mm".to_owned(),
                "give its full edge lengths along x, y and z, m",
            );
        }
        Shape {
            solid: Solid::Block {
                centre: centre.into(),
                half: size / 2.0,
            },
            paint: check.paint(
                self.grey.as_ref(),
                self.colour.as_ref(),
                "a piece of furniture",
                self.size.span(),
            ),
        }
    }
}

impl MarkText {
    pub(super) fn check(&self, check: &mut Check<'_>) -> Shape {
        let centre = check.point(&self.centre, "the centre of a mark", 10.0);
        let normal = check.point(&self.normal, "the direction of a mark", 10.0);
        let normal = normal.try_normalize(1e-9).unwrap_or_else(|| {
            let message = "the direction of a mark has no length".to_owned();
            check.refuse(
                self.normal.span(),
                message,
                "give a vector at right angles to the disc",
            );
            Vector3::z()
        });
        Shape {
            solid: Solid::Disc {
                centre: centre.into(),
                normal,
                radius: check.number(&self.radius, "the radius of a mark", "m", [1e-4, 10.0]),
            },
            paint: check.paint(
                self.grey.as_ref(),
                self.colour.as_ref(),
                "a mark",
                self.radius.span(),
            ),
        }
    }
}
