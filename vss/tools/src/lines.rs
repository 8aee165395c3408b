//! Lines of light and edges in a picture, each point to a part of a pixel, and the straight pieces of them.
//!
//! A line is where the picture, smoothed by a Gaussian, is highest across it; an edge is where it rises most (C. Steger, An
//! unbiased detector of curvilinear structures, PAMI 20(2), 1998). A point is found by derivatives of the Gaussian about the
//! place itself, so nothing is interpolated. Directions are rad from u towards v.

mod chain;
mod place;

use std::f64::consts::PI;

use crate::{frame::Frame, spot::noise_sd};
use place::Plane;

/// What is looked for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Kind {
    /// Lines that are brighter than what is beside them.
    #[default]
    Bright,
    /// Lines that are darker.
    Dark,
    /// Steps from dark to bright.
    Edge,
}

/// How lines are looked for.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LinesOptions {
    /// What is looked for.
    pub kind: Kind,
    /// Width of the Gaussian that smooths the picture, px. For lines that of their own profile is best.
    pub sigma: f64,
    /// Lowest height of a line as wide as `sigma`, or of a sharp step, grey values. What noise makes does not count either.
    pub contrast: f64,
    /// How far points may be beside a straight piece, px.
    pub straight: f64,
    /// The shortest piece, px.
    pub length: f64,
    /// So many points are looked at.
    pub most: usize,
}

impl Default for LinesOptions {
    fn default() -> Self {
        Self {
            kind: Kind::Bright,
            sigma: 1.5,
            contrast: 10.0,
            straight: 1.0,
            length: 10.0,
            most: 200_000,
        }
    }
}

/// Widths that the Gaussian may have, px: a narrower one sees single pixels, a wider one takes long.
pub const SIGMAS: std::ops::RangeInclusive<f64> = 0.8..=10.0;

/// A response of less than so many of its standard deviations is noise: of 16 million pixels none reaches it.
const LEAST_DEVIATIONS: f64 = 6.0;

/// A point of a line or an edge.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LinePoint {
    /// Column, px.
    pub u: f64,
    /// Row, px.
    pub v: f64,
    /// Direction of the line there. An edge has its bright side on the right of it, with v downwards; a line goes towards
    /// larger u.
    pub direction: f64,
    /// Standard deviation of the place across the line, px.
    pub sd: f64,
    /// Height of a line as wide as the Gaussian, or of a sharp step, that would look so, grey values.
    pub contrast: f64,
}

/// A straight piece.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Piece {
    /// Where it begins, u and v, px.
    pub from: [f64; 2],
    /// Where it ends, px. The way there is directed as its points are.
    pub to: [f64; 2],
    /// Standard deviation of its middle across it, px.
    pub sd: f64,
    /// Standard deviation of its direction, rad.
    pub sd_direction: f64,
    /// Root mean square of the distances of its points from it, px.
    pub rms: f64,
    /// Mean contrast of its points, grey values.
    pub contrast: f64,
    /// How many points it has.
    pub points: usize,
}

/// Lines or edges of a picture.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Lines {
    /// Their points, row by row.
    pub points: Vec<LinePoint>,
    /// Their straight pieces, those with most points first.
    pub pieces: Vec<Piece>,
}

/// Why lines are not looked for.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum NoLines {
    /// The bytes are not those of a picture of the size.
    #[error("the picture claims {width} x {height} px and has other bytes")]
    WrongSize {
        /// Width, px.
        width: usize,
        /// Height, px.
        height: usize,
    },
    /// The picture without the light is another one.
    #[error("the picture without the light is {} x {} px, and the one with it {} x {}", .dark.0, .dark.1, .lit.0, .lit.1)]
    OtherSize {
        /// Width and height of the one without the light.
        dark: (usize, usize),
        /// And of the one with it.
        lit: (usize, usize),
    },
    /// A number among the options that none can be.
    #[error("sigma must be {} to {} px, not {given}", SIGMAS.start(), SIGMAS.end())]
    Sigma {
        /// What was asked for, px.
        given: f64,
    },
    /// More points than are looked at.
    #[error("more than {0} points look like parts of lines; raise the contrast or sigma")]
    TooMany(usize),
}

/// Finds lines or edges in a picture, less the same view without the light (`dark`) when there is one.
///
/// # Errors
/// [`NoLines`]. A picture in which there are none is no error.
pub fn find_lines(
    frame: &Frame,
    dark: Option<&Frame>,
    options: &LinesOptions,
) -> Result<Lines, NoLines> {
    let whole = |frame: &Frame| {
        let (width, height) = (frame.width, frame.height);
        let wrong = NoLines::WrongSize { width, height };
        if frame.is_whole() { Ok(()) } else { Err(wrong) }
    };
    whole(frame)?;
    if let Some(dark) = dark {
        whole(dark)?;
        if (dark.width, dark.height) != (frame.width, frame.height) {
            return Err(NoLines::OtherSize {
                dark: (dark.width, dark.height),
                lit: (frame.width, frame.height),
            });
        }
    }
    if !SIGMAS.contains(&options.sigma) {
        return Err(NoLines::Sigma {
            given: options.sigma,
        });
    }
    let (lit, without) = (frame.grey(), dark.map(Frame::grey));
    let noise = noise_sd(&lit, frame.width);
    let noise = match &without {
        Some(dark) => noise.hypot(noise_sd(dark, frame.width)),
        None => noise,
    };
    let plane = Plane::new(&lit, without.as_deref(), frame.width, options.sigma);
    let points = place::points(&plane, noise, options)?;
    let pieces = chain::pieces(&points, options);
    Ok(Lines {
        points: points.into_iter().map(|(_, point)| point).collect(),
        pieces,
    })
}

/// A direction of a line, which has no sign: from over -π/2 to π/2.
fn unsigned(direction: f64) -> f64 {
    let turned = direction.rem_euclid(PI);
    if turned > PI / 2.0 {
        turned - PI
    } else {
        turned
    }
}

#[cfg(test)]
mod tests;
