//! Corners of chequer patterns: where two dark and two light squares meet (ChESS: Bennett and Lasenby, 2014).

use super::light::Light;

/// The ring's radius, px. Squares must be larger.
const RADIUS: usize = 5;

/// The ring: 16 pixels, opposite ones eight apart.
const RING: [(isize, isize); 16] = [
    (5, 0),
    (5, 2),
    (4, 4),
    (2, 5),
    (0, 5),
    (-2, 5),
    (-4, 4),
    (-5, 2),
    (-5, 0),
    (-5, -2),
    (-4, -4),
    (-2, -5),
    (0, -5),
    (2, -5),
    (4, -4),
    (5, -2),
];

/// Weaker corners than this part of the strongest are none.
const WEAKEST: f32 = 0.1;

/// Corners of less difference than some grey values are noise.
const LEAST: f32 = 30.0;

/// No more are looked at.
const MOST: usize = 800;

/// The places of corners, the sharpest first.
pub(super) fn find(light: &Light) -> Vec<[f64; 2]> {
    let (width, height) = (light.width, light.height);
    if width <= 2 * RADIUS || height <= 2 * RADIUS {
        return Vec::new();
    }
    let mut responses = vec![0.0_f32; width * height];
    for v in RADIUS..height - RADIUS {
        for u in RADIUS..width - RADIUS {
            responses[v * width + u] = response(light, u, v);
        }
    }
    let most = responses.iter().copied().fold(0.0, f32::max);
    let least = LEAST.max(WEAKEST * most);
    let mut found = Vec::new();
    for v in RADIUS..height - RADIUS {
        for u in RADIUS..width - RADIUS {
            let here = responses[v * width + u];
            if here >= least && is_highest(&responses, width, height, (u, v)) {
                // For the same difference of light, squares respond more than what is smooth.
                let sharpness = here / spread(&ring(light, u, v)).max(1.0);
                found.push((sharpness, refined(&responses, width, (u, v))));
            }
        }
    }
    found.sort_by(|one, other| other.0.total_cmp(&one.0));
    found.truncate(MOST);
    found.into_iter().map(|(_, at)| at).collect()
}

/// The values on the ring about a pixel, all of which is in the picture.
fn ring(light: &Light, u: usize, v: usize) -> [f32; 16] {
    RING.map(|step| light.beside(u, v, step))
}

/// The difference of the largest and the smallest value.
fn spread(values: &[f32; 16]) -> f32 {
    let most = values.iter().copied().fold(f32::MIN, f32::max);
    most - values.iter().copied().fold(f32::MAX, f32::min)
}

/// How much the ring about a pixel looks like four squares: sums across against one another, less what differs between
/// opposite places, less what differs between ring and middle.
fn response(light: &Light, u: usize, v: usize) -> f32 {
    let ring = ring(light, u, v);
    let sums = (0..4).map(|n| (ring[n] + ring[n + 8] - ring[n + 4] - ring[n + 12]).abs());
    let differences = (0..8).map(|n| (ring[n] - ring[n + 8]).abs());
    let middle = [(0, 0), (1, 0), (-1, 0), (0, 1), (0, -1)];
    let middle = middle.map(|step| light.beside(u, v, step));
    let middle = middle.iter().sum::<f32>() / 5.0;
    let mean = ring.iter().sum::<f32>() / 16.0;
    sums.sum::<f32>() - differences.sum::<f32>() - 16.0 * (mean - middle).abs()
}

/// Whether no response within the ring is higher; of equal ones the first counts.
fn is_highest(responses: &[f32], width: usize, height: usize, (u, v): (usize, usize)) -> bool {
    let here = responses[v * width + u];
    let rows = v.saturating_sub(RADIUS)..(v + RADIUS + 1).min(height);
    rows.into_iter().all(|row| {
        let columns = u.saturating_sub(RADIUS)..(u + RADIUS + 1).min(width);
        columns.into_iter().all(|column| {
            let other = responses[row * width + column];
            other < here || (other == here && (row, column) >= (v, u))
        })
    })
}

/// The middle of the response about its highest pixel.
fn refined(responses: &[f32], width: usize, (u, v): (usize, usize)) -> [f64; 2] {
    let (mut sum, mut at) = (0.0, [0.0; 2]);
    for row in v - 2..=v + 2 {
        for column in u - 2..=u + 2 {
            let weight = f64::from(responses[row * width + column].max(0.0));
            sum += weight;
            at[0] += weight * column as f64;
            at[1] += weight * row as f64;
        }
    }
    at.map(|coordinate| coordinate / sum.max(f64::MIN_POSITIVE))
}
