//! Finding a spot in a 500x500 picture, and its parts.

use divan::{Bencher, black_box};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, Normal};
use vss::{
    components::components,
    frame::Frame,
    spot::{SpotOptions, find_spot, noise_sd},
};

fn main() {
    divan::main();
}

const SIZE: usize = 500;

/// A lamp (σ 2 px) on a dark background with noise.
fn picture(noise: f64, lamp: f64) -> Frame {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let deviates = Normal::new(0.0, noise).ok();
    let pixels: Vec<u8> = (0..SIZE * SIZE)
        .map(|k| {
            let (u, v) = ((k % SIZE) as f64 - 240.3, (k / SIZE) as f64 - 260.7);
            let value = 40.0 + lamp * (-(u * u + v * v) / 8.0).exp();
            (value + deviates.map_or(0.0, |d| d.sample(&mut rng))).clamp(0.0, 255.0) as u8
        })
        .collect();
    Frame::grey8(SIZE, SIZE, pixels)
}

#[divan::bench]
fn find_spot_in_500x500(bencher: Bencher) {
    let frame = picture(11.0, 90.0);
    bencher.bench_local(|| find_spot(black_box(&frame), &SpotOptions::default()));
}

#[divan::bench]
fn no_spot_in_500x500(bencher: Bencher) {
    let frame = picture(11.0, 0.0);
    bencher.bench_local(|| find_spot(black_box(&frame), &SpotOptions::default()));
}

#[divan::bench]
fn noise_of_500x500(bencher: Bencher) {
    let frame = picture(11.0, 90.0);
    bencher.bench_local(|| noise_sd(black_box(&frame.pixels), SIZE));
}

/// Threshold, components and second moments of one disc.
#[divan::bench]
fn components_one_disc(bencher: Bencher) {
    let frame = picture(0.0, 200.0);
    bencher.bench_local(|| components(black_box(&frame.pixels), SIZE, 100));
}

/// The worst case: every other pixel.
#[divan::bench]
fn components_half_noise(bencher: Bencher) {
    let mut rng = ChaCha8Rng::seed_from_u64(2);
    let pixels: Vec<u8> = (0..SIZE * SIZE).map(|_| rng.random()).collect();
    bencher.bench_local(|| components(black_box(&pixels), SIZE, 128));
}
