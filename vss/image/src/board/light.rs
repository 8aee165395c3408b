//! How light the places of a picture are: smoothed, at most about a million pixels.

use super::homography::Homography;
use crate::{Picture, luminance};

/// Larger pictures are halved: corners need no more.
const PIXELS_MOST: usize = 1_300_000;

/// Light values, which may be those of a smaller picture.
#[derive(Debug, Clone)]
pub(super) struct Light {
    pub(super) width: usize,
    pub(super) height: usize,
    values: Vec<f32>,
    /// Pixels of the picture a side of each value.
    step: usize,
}

impl Light {
    pub(super) fn of(picture: &Picture) -> Self {
        let values: Vec<f32> = match picture.format {
            crate::Format::Grey8 => picture.pixels.iter().map(|grey| f32::from(*grey)).collect(),
            crate::Format::Rgb8 => {
                let pixels = picture.pixels.chunks_exact(3);
                pixels
                    .map(|rgb| f32::from(luminance(rgb[0], rgb[1], rgb[2])))
                    .collect()
            }
        };
        let mut light = Self {
            width: picture.width,
            height: picture.height,
            values,
            step: 1,
        };
        while light.width * light.height > PIXELS_MOST && light.width > 1 && light.height > 1 {
            light = light.halved();
        }
        light.smoothed()
    }

    fn halved(&self) -> Self {
        let (width, height) = (self.width / 2, self.height / 2);
        let places = (0..height).flat_map(|v| (0..width).map(move |u| (2 * u, 2 * v)));
        let mean = |(u, v): (usize, usize)| {
            let four = [(0, 0), (1, 0), (0, 1), (1, 1)];
            four.iter()
                .map(|(du, dv)| self.value(u + du, v + dv))
                .sum::<f32>()
                / 4.0
        };
        Self {
            width,
            height,
            values: places.map(mean).collect(),
            step: 2 * self.step,
        }
    }

    /// Weights 1, 2, 1 in both directions; the border's pixels repeat.
    fn smoothed(&self) -> Self {
        let (width, height) = (self.width, self.height);
        let mut rows = vec![0.0; self.values.len()];
        for (to, from) in rows
            .chunks_exact_mut(width)
            .zip(self.values.chunks_exact(width))
        {
            for (u, to) in to.iter_mut().enumerate() {
                let (left, right) = (u.saturating_sub(1), (u + 1).min(width - 1));
                *to = (from[left] + 2.0 * from[u] + from[right]) / 4.0;
            }
        }
        let mut values = vec![0.0; self.values.len()];
        for (v, to) in values.chunks_exact_mut(width).enumerate() {
            let row = |v: usize| rows.get(v * width..(v + 1) * width).unwrap_or_default();
            let (above, here, below) = (
                row(v.saturating_sub(1)),
                row(v),
                row((v + 1).min(height - 1)),
            );
            for (u, to) in to.iter_mut().enumerate() {
                *to = (above[u] + 2.0 * here[u] + below[u]) / 4.0;
            }
        }
        Self { values, ..*self }
    }

    /// The value of a pixel; places outside have that of the nearest one.
    pub(super) fn value(&self, u: usize, v: usize) -> f32 {
        let (u, v) = (u.min(self.width - 1), v.min(self.height - 1));
        self.values
            .get(v * self.width + u)
            .copied()
            .unwrap_or_default()
    }

    /// The value some pixels beside one, which must be in the picture: what reads most of all pixels.
    pub(super) fn beside(&self, u: usize, v: usize, (du, dv): (isize, isize)) -> f32 {
        let row = (v * self.width + u).wrapping_add_signed(dv * self.width.cast_signed());
        let value = self.values.get(row.wrapping_add_signed(du));
        value.copied().unwrap_or_default()
    }

    /// Between pixels, or nothing outside the picture.
    pub(super) fn at(&self, [u, v]: [f64; 2]) -> Option<f64> {
        let inside = |at: f64, length: usize| (0.0..=(length - 1) as f64).contains(&at);
        if !(inside(u, self.width) && inside(v, self.height)) {
            return None;
        }
        let (column, row) = (u.floor(), v.floor());
        let (du, dv) = (u - column, v - row);
        let (column, row) = (column as usize, row as usize);
        let value = |u: usize, v: usize| f64::from(self.value(u, v));
        let above = value(column, row) * (1.0 - du) + value(column + 1, row) * du;
        let below = value(column, row + 1) * (1.0 - du) + value(column + 1, row + 1) * du;
        Some(above * (1.0 - dv) + below * dv)
    }

    /// The mean of five places about one, or nothing outside the picture.
    pub(super) fn around(&self, [u, v]: [f64; 2]) -> Option<f64> {
        let places = [(0.0, 0.0), (1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0)];
        let values = places.iter().map(|(du, dv)| self.at([u + du, v + dv]));
        values.sum::<Option<f64>>().map(|sum| sum / 5.0)
    }

    /// Pixels of the picture a side of a value.
    pub(super) fn scale(&self) -> f64 {
        self.step as f64
    }

    /// A place of the picture from one here.
    pub(super) fn to_picture(&self, at: [f64; 2]) -> [f64; 2] {
        at.map(|at| (at + 0.5) * self.scale() - 0.5)
    }

    /// A place here from one of the picture.
    pub(super) fn of_picture(&self, at: [f64; 2]) -> [f64; 2] {
        at.map(|at| (at + 0.5) / self.scale() - 0.5)
    }

    /// A homography to the picture from one to here.
    pub(super) fn homography_to_picture(&self, map: &Homography) -> [f64; 9] {
        let (scale, shift) = (self.scale(), 0.5 * self.scale() - 0.5);
        map.before([[scale, 0.0, shift], [0.0, scale, shift]])
            .rows()
    }
}
