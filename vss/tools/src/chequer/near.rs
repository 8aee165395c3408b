//! Corners of a chequer pattern near the places where they are expected.

use super::{
    InnerCorner,
    corner::{Smooth, refined, saddles},
};
use crate::spot::noise_sd;

/// The corner nearest to each place (px), if there is one within its reach (px); its edges are looked at as far as that. Pixels
/// are grey values, `width` to a row.
#[must_use]
pub fn corners_near(
    grey: &[u8],
    width: usize,
    places: &[([f64; 2], f64)],
) -> Vec<Option<InnerCorner>> {
    let height = grey.len().checked_div(width).unwrap_or(0);
    if width < 8 || height < 8 {
        return vec![None; places.len()];
    }
    let found = saddles(&Smooth::of(grey, width));
    let noise = noise_sd(grey, width);
    let nearest = places.iter().map(|([u, v], reach)| {
        let off = |one: &&super::corner::Saddle| (one.u - u).hypot(one.v - v);
        let nearest = found.iter().min_by(|a, b| off(a).total_cmp(&off(b)))?;
        (off(&nearest) <= *reach)
            .then(|| refined(grey, width, nearest, *reach, noise))
            .flatten()
    });
    nearest.collect()
}
