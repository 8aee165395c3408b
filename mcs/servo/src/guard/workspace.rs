//! The guard `workspace`: where the tool may be.
//!
//! The tool is a sphere about its frame's origin. It must be in one of the boxes `inside`, if there are any, on the
//! side of every half-space `above` to which its normal points, and in none of the boxes `keep_out`; all in the base
//! frame. A box is grown (or shrunk) by the sphere's radius on each side, so that at its edges and corners a little more
//! is forbidden than need be. What counts is where the tool would come to rest if the arm braked now: it stops outside.

use nalgebra::Vector3;
use serde::Deserialize;

use ctos::task::HandlerError;

use super::{Guard, GuardSettings, Line, Seen, Words, edges};

/// A box along the axes of the base frame, m.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Region {
    /// Least x, y and z.
    pub low: [f64; 3],
    /// Largest x, y and z.
    pub high: [f64; 3],
}

/// Points p with `normal . p >= at`, m.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct HalfSpace {
    /// The direction that points into it, of any length.
    pub normal: [f64; 3],
    /// How far its surface is from the origin along the normal, m.
    pub at: f64,
}

/// Where the tool may be.
#[derive(Debug, Clone, PartialEq, Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Workspace {
    /// It is in one of these, if there are any,
    pub inside: Vec<Region>,
    /// in all of these
    pub above: Vec<HalfSpace>,
    /// and in none of these.
    pub keep_out: Vec<Region>,
    /// The tool's radius, m.
    pub radius: f64,
}

/// Shallower than this, m, is rounding.
const ROUNDING: f64 = 1e-9;

/// How far from the origin the outline of what has no end is drawn, m.
const DRAWN: f64 = 1.5;

impl Region {
    /// Its edges; those at infinity are drawn at [`DRAWN`].
    fn edges(&self) -> Vec<Line> {
        let bound = |corner: &[f64; 3]| corner.map(|at| at.clamp(-DRAWN, DRAWN));
        edges(bound(&self.low), bound(&self.high))
    }

    /// How far a point is outside, m, along the axis where it is farthest; how far inside where that is below zero.
    fn out(&self, point: &Vector3<f64>, grown: f64) -> f64 {
        let axes = (0..3).map(|axis| {
            let beyond = (self.low[axis] - point[axis]).max(point[axis] - self.high[axis]);
            beyond - grown
        });
        axes.fold(f64::NEG_INFINITY, f64::max)
    }

    /// Whether the straight way between two points comes into it.
    fn meets(&self, from: &Vector3<f64>, to: &Vector3<f64>, grown: f64) -> bool {
        let (mut enters, mut leaves) = (0.0_f64, 1.0_f64);
        for axis in 0..3 {
            let (low, high) = (self.low[axis] - grown, self.high[axis] + grown);
            let way = to[axis] - from[axis];
            if way == 0.0 {
                if from[axis] <= low || from[axis] >= high {
                    return false;
                }
                continue;
            }
            let (one, other) = ((low - from[axis]) / way, (high - from[axis]) / way);
            enters = enters.max(one.min(other));
            leaves = leaves.min(one.max(other));
        }
        enters < leaves
    }
}

impl HalfSpace {
    /// The edges of a square of its surface, around the point nearest to the origin, and its normal there.
    fn edges(&self) -> impl Iterator<Item = Line> {
        let normal = Vector3::from(self.normal);
        let across = normal.cross(&Vector3::ith(normal.iamin(), 1.0)).normalize();
        let other = normal.cross(&across);
        let middle = normal * self.at;
        let corners = [(1.0, 1.0), (1.0, -1.0), (-1.0, -1.0), (-1.0, 1.0)];
        let corners = corners.map(|(u, v)| middle + (across * u + other * v) * DRAWN);
        let edges = [0, 1, 2, 3].map(|at| [corners[at], corners[(at + 1) % 4]]);
        let edges = edges.into_iter().chain([[middle, middle + normal * 0.1]]);
        edges.map(|edge| edge.map(Into::into))
    }
}

/// The point in words, m.
fn place(point: &Vector3<f64>) -> impl std::fmt::Display {
    crate::words!("{:.3} {:.3} {:.3} m", point.x, point.y, point.z)
}

impl Workspace {
    /// The workspace that the recipe's arguments describe.
    ///
    /// # Errors
    /// What does not make one.
    pub fn from_args(settings: &GuardSettings<'_>) -> Result<Box<dyn Guard>, HandlerError> {
        let mut workspace: Self = settings.args.parse()?;
        workspace.check()?;
        Ok(Box::new(workspace))
    }

    /// Checks all numbers, and makes the normals one long.
    fn check(&mut self) -> Result<(), HandlerError> {
        if self.inside.is_empty() && self.above.is_empty() && self.keep_out.is_empty() {
            return Err("it forbids nothing: give `inside`, `above` or `keep_out`".into());
        }
        if !(0.0..=1.0).contains(&self.radius) {
            return Err(format!("`radius` is 0 to 1 m, not {}", self.radius).into());
        }
        let boxes = [("inside", &self.inside), ("keep_out", &self.keep_out)];
        for (name, region) in boxes
            .into_iter()
            .flat_map(|(name, regions)| regions.iter().map(move |region| (name, region)))
        {
            let pairs = || region.low.iter().zip(&region.high);
            // Infinite edges are edges; no number is none.
            if !pairs().all(|(low, high)| low < high) {
                let text = format!(
                    "a box of `{name}` has its `low` {:?} not below its `high` {:?}",
                    region.low, region.high
                );
                return Err(text.into());
            }
        }
        for half in &mut self.above {
            let normal = Vector3::from(half.normal);
            let length = normal.norm();
            if !(length.is_finite() && length > 0.0 && half.at.is_finite()) {
                return Err("a half-space of `above` has no direction, or no place".into());
            }
            half.normal = (normal / length).into();
        }
        Ok(())
    }

    /// How far a point is outside of all the boxes in one of which it must be, m.
    fn outside(&self, point: &Vector3<f64>) -> f64 {
        let out = self
            .inside
            .iter()
            .map(|region| region.out(point, -self.radius));
        out.reduce(f64::min).unwrap_or(f64::NEG_INFINITY)
    }

    /// What is wrong with a way of the tool's origin; `None` where it leads out of what is forbidden, or stays clear.
    fn violated(&self, from: &Vector3<f64>, to: &Vector3<f64>) -> Option<Words> {
        // Deeper than now, which a way out never is.
        let deeper = |now: f64, then: f64| then > ROUNDING && then > now + ROUNDING;
        let (now, then) = (self.outside(from), self.outside(to));
        if deeper(now, then) {
            return Some(crate::words!(
                "the tool at {} would come {then:.3} m outside of where it may be",
                place(from)
            ));
        }
        for (half, number) in self.above.iter().zip(1..) {
            let below = |point: &Vector3<f64>| {
                half.at + self.radius - Vector3::from(half.normal).dot(point)
            };
            let (now, then) = (below(from), below(to));
            if deeper(now, then) {
                return Some(crate::words!(
                    "the tool at {} would come {then:.3} m below half-space {number}",
                    place(from)
                ));
            }
        }
        for (region, number) in self.keep_out.iter().zip(1..) {
            let depth = |point: &Vector3<f64>| -region.out(point, self.radius);
            let (now, then) = (depth(from), depth(to));
            let comes_in = now <= ROUNDING && region.meets(from, to, self.radius - ROUNDING);
            if comes_in || deeper(now, then) {
                return Some(crate::words!(
                    "the tool at {} would come into keep-out box {number}, by {:.3} m at rest",
                    place(from),
                    then.max(0.0)
                ));
            }
        }
        None
    }
}

impl Guard for Workspace {
    fn check(&mut self, seen: &Seen<'_>) -> Option<Words> {
        self.violated(&seen.tool.origin, &seen.tool_at_rest.origin)
    }

    fn outline(&self) -> Vec<Line> {
        let boxes = self.inside.iter().chain(&self.keep_out);
        let boxes = boxes.flat_map(Region::edges);
        boxes
            .chain(self.above.iter().flat_map(HalfSpace::edges))
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn table() -> Workspace {
        let low = [0.2, -0.5, f64::NEG_INFINITY];
        let high = [0.8, 0.5, 0.7];
        Workspace {
            keep_out: vec![Region { low, high }],
            radius: 0.05,
            ..Workspace::default()
        }
    }

    fn at(x: f64, y: f64, z: f64) -> Vector3<f64> {
        Vector3::new(x, y, z)
    }

    #[test]
    fn a_way_into_a_box_or_through_it_is_found_and_one_beside_or_out_of_it_is_not() {
        let table = table();
        for (from, to, forbidden) in [
            (at(0.5, 0.0, 0.9), at(0.5, 0.0, 0.74), true),
            (at(0.5, 0.0, 0.9), at(0.5, 0.0, 0.76), false),
            // Over the edge, so quickly that it would rest on the other side.
            (at(0.1, 0.0, 0.6), at(0.9, 0.0, 0.6), true),
            (at(0.1, 0.0, 0.8), at(0.9, 0.0, 0.8), false),
            // Out of it, upwards; along it at the same depth; deeper.
            (at(0.5, 0.0, 0.60), at(0.5, 0.0, 0.65), false),
            (at(0.5, 0.0, 0.60), at(0.4, 0.0, 0.60), false),
            (at(0.5, 0.0, 0.60), at(0.5, 0.0, 0.59), true),
        ] {
            let found = table.violated(&from, &to);
            assert_eq!(found.is_some(), forbidden, "{from} {to} {found:?}");
        }
    }

    #[test]
    fn the_outline_of_a_workspace_is_the_edges_of_its_boxes_and_squares_of_its_surfaces() {
        let mut workspace = table();
        workspace.above = vec![HalfSpace {
            normal: [0.0, 0.0, -2.0],
            at: -1.0,
        }];
        workspace.check().unwrap();
        let (outline, table) = (workspace.outline(), &workspace.keep_out[0]);
        let (edges, square) = outline.split_at(12);
        // Each of the 12 edges goes along one axis, from the one face to the other.
        for [from, to] in edges {
            let differ: Vec<usize> = (0..3).filter(|axis| from[*axis] != to[*axis]).collect();
            let [along] = differ[..] else {
                panic!("{from:?} {to:?}");
            };
            let ends = [table.low[along].max(-DRAWN), table.high[along]];
            assert_eq!([from[along], to[along]], ends);
        }
        let mut corners: Vec<String> = edges.iter().flatten().map(|at| format!("{at:?}")).collect();
        corners.sort();
        corners.dedup();
        assert_eq!((edges.len(), corners.len(), square.len()), (12, 8, 5));
        // The surface is 1 m below the origin's plane of the normal -z: at z = 1.
        assert!(
            square[..4]
                .iter()
                .flatten()
                .all(|at| (at[2] - 1.0).abs() < 1e-12)
        );
        assert!(
            (square[4][1][2] - 0.9).abs() < 1e-12,
            "the normal points down"
        );
    }

    #[test]
    fn boxes_in_one_of_which_the_tool_must_be_and_half_spaces_forbid_what_is_beyond() {
        let region = |low: [f64; 3], high: [f64; 3]| Region { low, high };
        let mut workspace = Workspace {
            inside: vec![
                region([0.0, 0.0, 0.0], [1.0, 1.0, 1.0]),
                region([0.5, 0.0, 0.0], [2.0, 0.5, 1.0]),
            ],
            above: vec![HalfSpace {
                normal: [0.0, 0.0, 2.0],
                at: 0.2,
            }],
            ..Workspace::default()
        };
        workspace.check().unwrap();
        for (from, to, forbidden) in [
            (at(0.5, 0.2, 0.5), at(1.5, 0.2, 0.5), false),
            (at(0.5, 0.8, 0.5), at(1.5, 0.8, 0.5), true),
            (at(1.5, 0.8, 0.5), at(1.2, 0.6, 0.5), false),
            (at(0.5, 0.2, 0.5), at(0.5, 0.2, 0.1), true),
            (at(0.5, 0.2, 0.1), at(0.5, 0.2, 0.15), false),
        ] {
            let found = workspace.violated(&from, &to);
            assert_eq!(found.is_some(), forbidden, "{from} {to} {found:?}");
        }
    }

    #[test]
    fn a_workspace_that_forbids_nothing_or_is_no_place_is_refused() {
        let mut wrong = [
            (Workspace::default(), "forbids nothing"),
            (table(), "radius"),
            (table(), "not below"),
            (table(), "no direction"),
        ];
        wrong[1].0.radius = f64::NAN;
        wrong[2].0.keep_out[0].low[1] = f64::NAN;
        wrong[3].0.above = vec![HalfSpace {
            normal: [0.0; 3],
            at: 0.0,
        }];
        for (mut workspace, reason) in wrong {
            let error = workspace.check().unwrap_err().to_string();
            assert!(error.contains(reason), "{error}");
        }
    }
}
