//! A board of square fields: where it stands, and where its fields are. Pure geometry.
//!
//! Columns run along the board's x axis and rows along its y axis, both from 1. The board's frame has its origin in the middle of
//! its surface and z up. A height counts things that lie beneath: 0 is the field itself.

use std::{fmt, str::FromStr};

use nalgebra::{Isometry3, Point3, Rotation3, Translation3, UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};

/// The most fields of a side.
const MOST_FIELDS: u32 = 100;

/// A dot is nearer to the middle, m.
const MOST_DOT: f64 = 100.0;

/// Where a board stands.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Board {
    /// The middle of its surface in the base frame of the arm, m.
    pub at: [f64; 3],
    /// How far it is turned about the vertical, degrees.
    #[serde(default)]
    pub yaw_deg: f64,
    /// Length of a field's side, m.
    pub field_m: f64,
    /// Fields along each side.
    #[serde(default = "fields")]
    pub fields: u32,
    /// How high its surface is above the table, m.
    #[serde(default = "thick_m")]
    pub thick_m: f64,
    /// The middle of the bright dot on its rim, by which cameras tell which way it lies, in its own frame, m.
    #[serde(default)]
    pub dot: Option<[f64; 2]>,
}

fn fields() -> u32 {
    8
}

fn thick_m() -> f64 {
    0.02
}

/// A place on a board. Columns and rows need not be whole.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Field {
    /// Column, from 1.
    pub column: f64,
    /// Row, from 1.
    pub row: f64,
    /// How many things lie beneath.
    pub height: f64,
}

/// Why a text names no field.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("`{0}` is no field: give COLUMN,ROW or COLUMN,ROW,HEIGHT, such as 3,4,0")]
pub struct NoField(String);

impl FromStr for Field {
    type Err = NoField;

    fn from_str(text: &str) -> Result<Self, NoField> {
        let numbers: Option<Vec<f64>> = text
            .split(',')
            .map(|number| number.trim().parse().ok().filter(|n: &f64| n.is_finite()))
            .collect();
        match numbers.as_deref() {
            Some(&[column, row]) => Ok(Self {
                column,
                row,
                height: 0.0,
            }),
            Some(&[column, row, height]) => Ok(Self {
                column,
                row,
                height,
            }),
            _ => Err(NoField(text.to_owned())),
        }
    }
}

impl fmt::Display for Field {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{},{},{}", self.column, self.row, self.height)
    }
}

impl Board {
    /// What is wrong with it: a key, and words.
    ///
    /// # Errors
    /// The first number that makes no sense.
    pub fn check(&self) -> Result<(), (&'static str, String)> {
        if !self.at.iter().all(|x| x.abs() < 100.0) {
            return Err((
                "at",
                "give the middle of the board in m, nearer than 100".to_owned(),
            ));
        }
        if !(-360.0..=360.0).contains(&self.yaw_deg) {
            return Err(("yaw_deg", "give from -360 to 360 degrees".to_owned()));
        }
        if !(1e-3..=1.0).contains(&self.field_m) {
            return Err(("field_m", "give from 0.001 to 1 m".to_owned()));
        }
        if !(1..=MOST_FIELDS).contains(&self.fields) {
            return Err(("fields", format!("give from 1 to {MOST_FIELDS} fields")));
        }
        if !(0.0..=1.0).contains(&self.thick_m) {
            return Err(("thick_m", "give from 0 to 1 m".to_owned()));
        }
        if let Some(dot) = self.dot
            && !dot.iter().all(|x| x.abs() < MOST_DOT)
        {
            return Err((
                "dot",
                format!("give its place in m, nearer than {MOST_DOT}"),
            ));
        }
        Ok(())
    }

    /// How the board is turned about the vertical, rad.
    #[must_use]
    pub fn yaw(&self) -> f64 {
        self.yaw_deg.to_radians()
    }

    /// `base_t_board`.
    #[must_use]
    pub fn pose(&self) -> Isometry3<f64> {
        let turn = Rotation3::from_axis_angle(&Vector3::z_axis(), self.yaw());
        let at = Translation3::from(Vector3::from(self.at));
        Isometry3::from_parts(at, UnitQuaternion::from_rotation_matrix(&turn))
    }

    /// Whether a place lies on the board.
    #[must_use]
    pub fn has(&self, field: &Field) -> bool {
        let most = f64::from(self.fields) + 0.5;
        let side = 0.5..=most;
        side.contains(&field.column) && side.contains(&field.row) && field.height >= 0.0
    }

    /// The middle of a field in the base frame, at the bottom of what lies there on things of such a height (m).
    #[must_use]
    pub fn point(&self, field: &Field, height_m: f64) -> Point3<f64> {
        self.pose() * self.on_board(field, height_m)
    }

    /// The same in the board's own frame.
    #[must_use]
    pub fn on_board(&self, field: &Field, height_m: f64) -> Point3<f64> {
        let along = |number: f64| (number - self.middle()) * self.field_m;
        Point3::new(
            along(field.column),
            along(field.row),
            field.height * height_m,
        )
    }

    /// The field in which a point of the board's own frame is, on things of such a height (m).
    #[must_use]
    pub fn field(&self, point: &Point3<f64>, height_m: f64) -> Field {
        let number = |along: f64| along / self.field_m + self.middle();
        Field {
            column: number(point.x),
            row: number(point.y),
            height: point.z / height_m,
        }
    }

    /// The number of a column or row in the middle of the board.
    fn middle(&self) -> f64 {
        (f64::from(self.fields) + 1.0) / 2.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const BOARD: Board = Board {
        at: [0.5, 0.1, 0.42],
        yaw_deg: 90.0,
        field_m: 0.06,
        fields: 8,
        thick_m: 0.02,
        dot: None,
    };

    #[test]
    fn neighbours_are_a_side_apart_along_the_axes_of_the_turned_board() {
        let at = |text: &str| BOARD.point(&text.parse().unwrap(), 0.01);
        let [a, b, c] = [at("3,4"), at("4,4"), at("3,5")];
        // A quarter turn: columns run along the base's y axis, rows against its x axis.
        assert!((b - a - Vector3::new(0.0, 0.06, 0.0)).norm() < 1e-12);
        assert!((c - a - Vector3::new(-0.06, 0.0, 0.0)).norm() < 1e-12);
        let middle = nalgebra::center(&at("1,1"), &at("8,8"));
        assert!((middle - Point3::new(0.5, 0.1, 0.42)).norm() < 1e-12);
        let stacked = at("3,4,2");
        assert!((stacked - a - Vector3::new(0.0, 0.0, 0.02)).norm() < 1e-12);
    }

    #[test]
    fn a_text_that_names_no_field_is_refused_with_the_form() {
        for text in ["", "3", "3,4,0,1", "a,b", "3,nan", "3,inf,0"] {
            let error = text.parse::<Field>().unwrap_err();
            assert!(error.to_string().contains("COLUMN,ROW,HEIGHT"), "{error}");
        }
        let off = ["0.4,4", "9,1", "3,4,-1"];
        assert!(off.iter().all(|text| !BOARD.has(&text.parse().unwrap())));
        assert!(BOARD.has(&"8.4,1".parse().unwrap()));
    }
}
