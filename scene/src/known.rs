//! What a follower knows of a scene, for those who tell it in the words of another protocol: where all parts are, joints,
//! and the lenses of cameras. Lengths in m, angles in rad, other units as [`crate::Number`] says.

use std::collections::BTreeMap;

use crate::{Batch, Layer, Moved, Part, Picture, Said, Solid, View};

/// The name of a part's frame, of one app.
#[must_use]
pub fn frame(source: &str, part: &Part) -> String {
    format!("{source}/{}", part.name)
}

/// What one task shows.
#[derive(Debug, Default)]
pub struct Known {
    /// The latest moment, ns since the start of the app.
    pub at_ns: u64,
    /// The parts.
    pub view: View,
    /// Where they are, by their index.
    pub moved: BTreeMap<usize, Moved>,
    /// What the task says.
    pub said: Option<Said>,
}

/// What a batch has brought.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct News {
    /// There are others than before; a task that shows pictures alone has no parts.
    pub parts: bool,
    /// Some have moved.
    pub moved: bool,
    /// The task says something else.
    pub said: bool,
    /// The pictures that came.
    pub pictures: Vec<Picture>,
}

/// A joint as it is now: rad, rad/s and N m of one that turns, m, m/s and N of one that slides. What nobody knows is none.
#[derive(Debug, Clone, PartialEq)]
pub struct Joint {
    /// Its name.
    pub name: String,
    /// Where it is.
    pub position: Option<f64>,
    /// How fast it moves.
    pub velocity: Option<f64>,
    /// Torque or force of its drive.
    pub effort: Option<f64>,
}

/// A lens without distortion: focal lengths and principal point, px; the first pixel's middle is at (0, 0).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Lens {
    /// Focal lengths, px.
    pub focal: [f64; 2],
    /// The principal point, px.
    pub centre: [f64; 2],
}

impl Known {
    /// Takes in what the task shows.
    pub fn take(&mut self, batch: Batch) -> News {
        self.at_ns = batch.at_ns;
        let had_parts = !self.view.parts.is_empty();
        let mut news = News {
            moved: !batch.moved.is_empty(),
            said: batch.said.is_some(),
            pictures: batch.pictures,
            ..News::default()
        };
        if let Some(view) = batch.view {
            news.parts = had_parts || !view.parts.is_empty();
            self.view = view;
            self.moved.clear();
        }
        for one in batch.moved {
            self.moved.insert(one.part as usize, one);
        }
        if batch.said.is_some() {
            self.said = batch.said;
        }
        news
    }

    /// Whether it was measured, and not told by a simulator.
    #[must_use]
    pub fn is_measured(&self) -> bool {
        self.view.layer == Layer::Measured
    }

    /// The parts that are somewhere.
    pub fn placed(&self) -> impl Iterator<Item = (&Part, &Moved)> {
        let parts = self.view.parts.iter().enumerate();
        parts.filter_map(|(index, part)| Some((part, self.moved.get(&index)?)))
    }

    /// The joints: see [`Part::numbers`].
    pub fn joints(&self) -> impl Iterator<Item = Joint> {
        self.placed().filter_map(|(part, moved)| joint(part, moved))
    }

    /// The pyramids of cameras: the camera, the corners, and the part that has them.
    pub fn pyramids(&self) -> impl Iterator<Item = (&str, &[[f64; 3]; 4], &Part)> {
        self.view.parts.iter().flat_map(|part| {
            part.solids.iter().filter_map(move |solid| match solid {
                Solid::Frustum { corners, camera } => Some((camera.as_str(), corners, part)),
                _ => None,
            })
        })
    }
}

/// The frame of a camera: that of its pyramid in a scene that was measured, once it is known. `sources` are what tasks show, by
/// the tasks' names.
#[must_use]
pub fn camera_frame(sources: &BTreeMap<String, Known>, camera: &str) -> String {
    let measured = sources.iter().filter(|(_, known)| known.is_measured());
    let mut all = measured.flat_map(|(source, known)| {
        let pyramids = known.pyramids();
        pyramids.map(move |(of, _, part)| (of, source, part))
    });
    let found = all.find(|(of, _, _)| *of == camera);
    found.map_or_else(
        || format!("camera/{camera}"),
        |(_, source, part)| frame(source, part),
    )
}

fn joint(part: &Part, moved: &Moved) -> Option<Joint> {
    let of = |name: &str| {
        let at = part.numbers.iter().position(|number| number.name == name)?;
        moved.numbers.get(at).copied()
    };
    let (velocity, effort) = (of("velocity")?, of("effort")?);
    let finite = |value: f64| value.is_finite().then_some(value);
    Some(Joint {
        name: part.numbers.first()?.name.clone(),
        position: moved.numbers.first().copied().and_then(finite),
        velocity: finite(velocity),
        effort: finite(effort),
    })
}

impl Lens {
    /// The lens of a camera whose picture of `size` px fills the pyramid with these corners: left above, right above, right
    /// below, left below, in its frame. None of a pyramid that is no picture's.
    #[must_use]
    pub fn of(corners: &[[f64; 3]; 4], size: [u32; 2]) -> Option<Self> {
        let [[left, top, depth], _, [right, bottom, _], _] = *corners;
        let [width, height] = size.map(f64::from);
        let lens = |low: f64, high: f64, pixels: f64| {
            let focal = pixels * depth / (high - low);
            // The corner is half a pixel before the middle of the first one.
            (focal, -low / depth * focal - 0.5)
        };
        let (fx, cx) = lens(left, right, width);
        let (fy, cy) = lens(top, bottom, height);
        let all = [fx, cx, fy, cy].iter().all(|number| number.is_finite());
        (all && fx > 0.0 && fy > 0.0).then_some(Self {
            focal: [fx, fy],
            centre: [cx, cy],
        })
    }

    /// The matrices K (3 by 3) and P (3 by 4), row by row.
    #[must_use]
    pub fn matrices(&self) -> ([f64; 9], [f64; 12]) {
        let ([fx, fy], [cx, cy]) = (self.focal, self.centre);
        (
            [fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0],
            [fx, 0.0, cx, 0.0, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0],
        )
    }
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
        let lens = Lens::of(&corners, size).unwrap();
        let (k, p) = lens.matrices();
        let [fx, _, cx, _, fy, cy, ..] = k;
        assert_eq!([p[0], p[2], p[5], p[6]], [fx, cx, fy, cy]);
        let pixels = [[-0.5, -0.5], [319.5, -0.5], [319.5, 239.5], [-0.5, 239.5]];
        for ([x, y, z], [u, v]) in corners.into_iter().zip(pixels) {
            assert!((fx * x / z + cx - u).abs() < 1e-9);
            assert!((fy * y / z + cy - v).abs() < 1e-9);
        }
        assert!(Lens::of(&[[0.0; 3]; 4], size).is_none());
    }
}
