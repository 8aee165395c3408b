//! What lies and stands in the cell: `[[object]]`, `[[furniture]]` and `[[mark]]`.

use mcs_model::Placement;
use nalgebra::{Point3, Vector3};
use serde::Deserialize;
use toml::Spanned;

use super::{
    super::{ObjectSpec, PlateSpec},
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
    #[serde(default)]
    held: bool,
    grey: Option<Spanned<f64>>,
    colour: Option<Spanned<[f64; 3]>>,
    pub(super) position: Spanned<[f64; 3]>,
    rpy: Option<Spanned<[f64; 3]>>,
    chequer: Option<ChequerText>,
    #[serde(default)]
    dot: Vec<DotText>,
}

/// Dark fields on the upper side of a box: those of a board of square fields whose first one, at the smallest x and y, is dark.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct ChequerText {
    fields: Spanned<u32>,
    side: Spanned<f64>,
    grey: Option<Spanned<f64>>,
    colour: Option<Spanned<[f64; 3]>>,
}

/// A round dot on the upper side of a box.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct DotText {
    at: Spanned<[f64; 2]>,
    radius: Spanned<f64>,
    grey: Option<Spanned<f64>>,
    colour: Option<Spanned<[f64; 3]>>,
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
    pub(super) feels: Option<PlateText>,
    centre: Spanned<[f64; 3]>,
    size: Spanned<[f64; 3]>,
    grey: Option<Spanned<f64>>,
    colour: Option<Spanned<[f64; 3]>>,
}

/// What feels with what arms press a piece of furniture.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct PlateText {
    pub(super) name: Spanned<String>,
    cuts_n: Option<Spanned<f64>>,
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

/// Paint lies so far above what it is on, m.
const PAINT: f64 = 1e-5;

/// A chequer has no more fields a side.
const MOST_FIELDS: u32 = 20;

/// What each form needs.
const FORMS: &str = "a box has `size`, its edge lengths along x, y and z; a sphere `radius`; a cylinder `radius` and `height` along z; all in m";

impl ObjectText {
    pub(super) fn check(&self, name: String, check: &mut Check<'_>) -> ObjectSpec {
        let origin = check.point(&self.position, "the position of an object", 10.0);
        let solid = self.solid(check);
        ObjectSpec {
            marks: self.marks(&solid, check),
            shape: Shape {
                solid,
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
            held: self.held,
            start: Placement::from_degrees(origin.into(), check.turn(self.rpy.as_ref())).isometry(),
            name,
        }
    }

    /// What is painted on its upper side.
    fn marks(&self, solid: &Solid, check: &mut Check<'_>) -> Vec<Shape> {
        let Solid::Block { half, .. } = solid else {
            if self.chequer.is_some() || !self.dot.is_empty() {
                let message = format!("object `{}` is no box", self.name.get_ref());
                check.refuse(
                    self.shape.span(),
                    message,
                    "only the upper side of a box is painted",
                );
            }
            return Vec::new();
        };
        let chequer = self.chequer.iter().flat_map(|text| text.check(half, check));
        let mut marks: Vec<Shape> = chequer.collect();
        marks.extend(self.dot.iter().map(|text| text.check(half, check)));
        marks
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

impl ChequerText {
    fn check(&self, half: &Vector3<f64>, check: &mut Check<'_>) -> Vec<Shape> {
        let fields = *self.fields.get_ref();
        if !(1..=MOST_FIELDS).contains(&fields) {
            check.refuse(
                self.fields.span(),
                format!("a chequer has {fields} fields a side"),
                &format!("give from 1 to {MOST_FIELDS}"),
            );
            return Vec::new();
        }
        let side = check.number(&self.side, "the side of a field", "m", [1e-3, 10.0]);
        let paint = check.paint(
            self.grey.as_ref(),
            self.colour.as_ref(),
            "a chequer",
            self.side.span(),
        );
        let reach = 0.5 * side * f64::from(fields);
        if reach > half.x.min(half.y) + 1e-9 {
            check.refuse(
                self.side.span(),
                format!("a chequer {:.3} m wide is larger than its box", 2.0 * reach),
                "make the box larger, or the fields smaller",
            );
        }
        let middle = |number: u32| (f64::from(number) + 0.5) * side - reach;
        let places = (0..fields).flat_map(|x| (0..fields).map(move |y| (x, y)));
        let dark = places.filter(|(x, y)| (x + y) % 2 == 0);
        dark.map(|(x, y)| Shape {
            solid: Solid::Block {
                centre: Point3::new(middle(x), middle(y), half.z),
                half: Vector3::new(0.5 * side, 0.5 * side, PAINT),
            },
            paint,
        })
        .collect()
    }
}

impl DotText {
    fn check(&self, half: &Vector3<f64>, check: &mut Check<'_>) -> Shape {
        let [x, y] = *self.at.get_ref();
        if !(x.abs() <= half.x && y.abs() <= half.y) {
            check.refuse(
                self.at.span(),
                format!("a dot at {x}, {y} is beside its box"),
                "give its place from the middle of the upper side, m",
            );
        }
        Shape {
            solid: Solid::Disc {
                centre: Point3::new(x, y, half.z + 2.0 * PAINT),
                normal: Vector3::z(),
                radius: check.number(&self.radius, "the radius of a dot", "m", [1e-4, 10.0]),
            },
            paint: check.paint(
                self.grey.as_ref(),
                self.colour.as_ref(),
                "a dot",
                self.radius.span(),
            ),
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

impl PlateText {
    pub(super) fn check(&self, name: String, piece: usize, check: &mut Check<'_>) -> PlateSpec {
        let what = "the force that cuts the power";
        let cuts = self.cuts_n.as_ref();
        let cuts = cuts.map(|force| check.number(force, what, "N", [0.1, 1e4]));
        PlateSpec {
            name,
            piece,
            cuts_n: cuts.unwrap_or(f64::INFINITY),
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
