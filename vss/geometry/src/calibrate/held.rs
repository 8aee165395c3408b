//! What is known of a lens before any point is seen: how far real lenses bend pictures.
//!
//! Points in a small volume determine the radial terms to many times what a lens has. The fit is then far from linear, and
//! what linear theory says of it is a third too small. A term that is expected to be about 0, as loosely as lenses differ,
//! costs points that show it nothing.

use nalgebra::DMatrix;

use crate::camera::Camera;

/// Where the lens terms k1 k2 p1 p2 k3 begin among the parameters.
const FIRST_TERM: usize = 10;

/// Standard deviations of what k1, k2 and k3 each add to the radius in the corners of a picture, relative to it. The lenses
/// of `sim` and of published calibrations stay within one or two of them.
const RADIAL_SD: [f64; 3] = [0.5, 0.25, 0.1];

/// Standard deviation of p1 and p2.
const TANGENTIAL_SD: f64 = 3e-3;

/// How tightly a fit to pixels holds the lens terms about 0.
#[derive(Debug, Clone, Copy)]
pub(super) struct Held {
    /// Noise over standard deviation, px, in the order k1 k2 p1 p2 k3.
    weights: [f64; 5],
}

impl Held {
    /// For pictures of `size` that `camera` takes, the noise of the pixels being `noise`, px.
    pub fn of(camera: &Camera, size: (usize, usize), noise: f64) -> Self {
        let corner = 0.5 * (size.0 as f64).hypot(size.1 as f64) / camera.focal();
        let square = corner * corner;
        let [first, second, third] = RADIAL_SD;
        let sds = [
            first / square,
            second / square.powi(2),
            TANGENTIAL_SD,
            TANGENTIAL_SD,
            third / square.powi(3),
        ];
        Self {
            weights: sds.map(|sd| noise / sd),
        }
    }

    /// Adds to JᵀJ of the first parameters what is known beforehand.
    pub fn add_to(&self, normal: &mut DMatrix<f64>) {
        for (index, weight) in self.terms(normal.nrows()) {
            normal[(index, index)] += weight * weight;
        }
    }

    /// The lens terms among the first `free` parameters, with their weights.
    pub fn terms(&self, free: usize) -> impl Iterator<Item = (usize, f64)> + use<> {
        let all = self.weights.into_iter().enumerate();
        all.map(|(nth, weight)| (FIRST_TERM + nth, weight))
            .take_while(move |(index, _)| *index < free)
    }
}
