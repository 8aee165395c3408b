//! The directions in which the pixels of a camera look, in tiles: what meets no ray of a tile is found by one question.

use std::ops::Range;

use nalgebra::Vector3;

use crate::truth::CameraTruth;

/// Pixels along each side of a tile.
const SIDE: usize = 16;

/// Directions of all pixels of a camera, camera frame.
#[derive(Debug, Clone)]
pub struct Rays {
    all: Vec<Vector3<f64>>,
    tiles: Vec<Tile>,
    /// Tiles in a row.
    across: usize,
}

/// Neighbouring pixels.
#[derive(Debug, Clone)]
pub struct Tile {
    /// Its pixels, a run for each row.
    pub runs: Vec<Range<usize>>,
    /// Their rays are around this unit direction.
    pub axis: Vector3<f64>,
    /// No ray is further than this from the axis, per unit of length.
    pub spread: f64,
}

impl Rays {
    /// Those of a camera.
    #[must_use]
    pub fn new(camera: &CameraTruth) -> Self {
        let all: Vec<_> = (0..camera.height)
            .flat_map(|row| (0..camera.width).map(move |column| (column, row)))
            .map(|(column, row)| {
                // A cell with a pixel that no direction reaches is refused before it comes here; the
                // axis stands in so that the pixel still has a ray.
                camera
                    .direction(column as f64, row as f64)
                    .map_or_else(Vector3::z, |ray| ray.normalize())
            })
            .collect();
        let corners = (0..camera.height).step_by(SIDE).flat_map(|row| {
            let columns = (0..camera.width).step_by(SIDE);
            columns.map(move |column| (column, row))
        });
        let tiles = corners.map(|(column, row)| {
            let end = (column + SIDE).min(camera.width);
            let rows = row..(row + SIDE).min(camera.height);
            let runs = rows.map(|row| row * camera.width + column..row * camera.width + end);
            Tile::new(&all, runs.collect())
        });
        let tiles = tiles.collect();
        let across = camera.width.div_ceil(SIDE);
        Self { all, tiles, across }
    }

    /// Unit direction of each pixel, row by row.
    #[must_use]
    pub fn all(&self) -> &[Vector3<f64>] {
        &self.all
    }

    /// All tiles, row by row; each pixel is in one.
    #[must_use]
    pub fn tiles(&self) -> &[Tile] {
        &self.tiles
    }

    /// How many tiles a row of them has.
    #[must_use]
    pub fn across(&self) -> usize {
        self.across
    }
}

impl Tile {
    fn new(rays: &[Vector3<f64>], runs: Vec<Range<usize>>) -> Self {
        let own = || runs.iter().flat_map(|run| &rays[run.clone()]);
        let axis = own().sum::<Vector3<f64>>().normalize();
        let far = own().map(|ray| (ray - axis).norm());
        // Rounding takes nothing away.
        let spread = far.fold(0.0, f64::max) + 1e-12;
        Self { runs, axis, spread }
    }
}
