//! Image noise: normal deviates, fast and the same for the same seed, camera and frame number.

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

/// Number of different deviates; an index takes two bytes of the generator's stream.
const DEVIATES: usize = 1 << 16;

/// Read and shot noise of one camera.
///
/// The deviates come from a table of 65 536 normal numbers (scaled to mean 0 and standard deviation
/// 1 exactly); each pixel draws one by an independent index. That is an ordinary sample from a
/// distribution that differs from the normal one by less than anything 8 bits can show, at a
/// fraction of the cost of computing each deviate.
#[derive(Debug, Clone)]
pub struct Noise {
    table: Vec<f32>,
    bytes: Vec<u8>,
    key: [u8; 16],
    read: f32,
    shot: f32,
}

impl Noise {
    /// Noise with standard deviation `sqrt(read^2 + shot * value)` grey levels.
    #[must_use]
    pub fn new(seed: u64, camera: &str, read: f64, shot: f64) -> Self {
        let mut key = [0; 16];
        let (low, high) = key.split_at_mut(8);
        low.copy_from_slice(&seed.to_le_bytes());
        high.copy_from_slice(&fingerprint(camera).to_le_bytes());
        Self {
            table: table(),
            bytes: Vec::new(),
            key,
            read: read as f32,
            shot: shot as f32,
        }
    }

    /// Adds the noise of frame `number` to `light` and rounds it to 8 bits.
    pub fn expose(&mut self, number: u64, light: &[f32], pixels: &mut [u8]) {
        let mut seed = [0; 32];
        let (key, rest) = seed.split_at_mut(16);
        key.copy_from_slice(&self.key);
        rest[..8].copy_from_slice(&number.to_le_bytes());
        self.bytes.resize(2 * light.len(), 0);
        ChaCha8Rng::from_seed(seed).fill_bytes(&mut self.bytes);
        let variance = self.read * self.read;
        let indices = self.bytes.chunks_exact(2);
        for ((pixel, value), index) in pixels.iter_mut().zip(light).zip(indices) {
            let index = usize::from(u16::from_le_bytes([index[0], index[1]]));
            let sd = if self.shot > 0.0 {
                (variance + self.shot * value.max(0.0)).sqrt()
            } else {
                self.read
            };
            // A float becomes an integer with saturation: 0 and 255 are the sensor's ends.
            *pixel = (value + sd * self.table[index] + 0.5) as u8;
        }
    }
}

/// The table is the same for every camera: what differs is which entries are drawn.
fn table() -> Vec<f32> {
    let mut rng = ChaCha8Rng::seed_from_u64(0);
    let mut values: Vec<f64> = StandardNormal
        .sample_iter(&mut rng)
        .take(DEVIATES)
        .collect();
    let n = DEVIATES as f64;
    let mean = values.iter().sum::<f64>() / n;
    let sd = (values.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / n).sqrt();
    values.iter_mut().for_each(|x| *x = (*x - mean) / sd);
    values.into_iter().map(|x| x as f32).collect()
}

/// FNV-1a: names of cameras to well separated numbers, the same on every machine.
fn fingerprint(name: &str) -> u64 {
    name.bytes().fold(0xcbf2_9ce4_8422_2325, |hash, byte| {
        (hash ^ u64::from(byte)).wrapping_mul(0x0000_0100_0000_01b3)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    const N: usize = 250_000;

    fn picture(seed: u64, camera: &str, number: u64, read: f64, shot: f64) -> Vec<u8> {
        let mut pixels = vec![0; N];
        Noise::new(seed, camera, read, shot).expose(number, &vec![100.0; N], &mut pixels);
        pixels
    }

    fn moments(pixels: &[u8]) -> (f64, f64) {
        let n = pixels.len() as f64;
        let mean = pixels.iter().map(|x| f64::from(*x)).sum::<f64>() / n;
        let variance = pixels
            .iter()
            .map(|x| (f64::from(*x) - mean).powi(2))
            .sum::<f64>();
        (mean, (variance / n).sqrt())
    }

    #[test]
    fn noise_has_the_mean_and_standard_deviation_asked_for() {
        // Rounding to whole grey levels adds 1/12 to the variance.
        let (mean, sd) = moments(&picture(1, "a", 0, 11.0, 0.0));
        assert!((mean - 100.0).abs() < 4.0 * 11.0 / (N as f64).sqrt());
        assert!(
            (sd - (121.0_f64 + 1.0 / 12.0).sqrt()).abs() < 4.0 * 11.0 / (2.0 * N as f64).sqrt()
        );
        let (_, sd) = moments(&picture(1, "a", 0, 3.0, 0.4));
        assert!((sd - (9.0_f64 + 40.0 + 1.0 / 12.0).sqrt()).abs() < 4.0 * 7.0 / 700.0);
    }

    #[test]
    fn neighbouring_pixels_are_uncorrelated() {
        let pixels = picture(1, "a", 0, 11.0, 0.0);
        for lag in [1, 2, 500] {
            let products = pixels
                .iter()
                .zip(&pixels[lag..])
                .map(|(a, b)| (f64::from(*a) - 100.0) * (f64::from(*b) - 100.0));
            let correlation = products.sum::<f64>() / (N - lag) as f64 / 121.0;
            assert!(correlation.abs() < 4.0 / 500.0, "lag {lag}: {correlation}");
        }
    }

    #[test]
    fn the_tails_are_normal() {
        let beyond = |k: f64| {
            let limit = 11.0 * k;
            let count = picture(7, "a", 3, 11.0, 0.0)
                .iter()
                .filter(|x| (f64::from(**x) - 100.0).abs() > limit)
                .count();
            count as f64 / N as f64
        };
        // At half-integer limits rounding does not matter: 22.5 / 11 and 33.5 / 11 sd.
        assert!((beyond(22.5 / 11.0) - 0.040_81).abs() < 2e-3);
        assert!((beyond(33.5 / 11.0) - 0.002_323).abs() < 6e-4);
    }

    #[test]
    fn the_same_seed_camera_and_number_give_the_same_noise_and_any_other_does_not() {
        let first = picture(1, "a", 0, 11.0, 0.0);
        assert_eq!(first, picture(1, "a", 0, 11.0, 0.0));
        assert_ne!(first, picture(2, "a", 0, 11.0, 0.0));
        assert_ne!(first, picture(1, "b", 0, 11.0, 0.0));
        assert_ne!(first, picture(1, "a", 1, 11.0, 0.0));
    }

    #[test]
    fn values_beyond_the_sensor_saturate() {
        let mut pixels = [7; 2];
        Noise::new(1, "a", 0.0, 0.0).expose(0, &[-50.0, 400.0], &mut pixels);
        assert_eq!(pixels, [0, 255]);
    }
}
