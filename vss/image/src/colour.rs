//! Colour classes: a look-up table that is trained from labelled colours.
//!
//! A colour is a point (S cos H, S sin H, V) of hue, saturation and value, so that greys have no hue and red lies in one
//! piece. Gaussian units stand at centres that k-means finds in each class; ridge least squares on their normalised
//! activations makes outputs of one for the own class and zero for the others. The network is asked once for each of 32,768
//! colours (5 bits each of red, green and blue); a pixel then costs one load.

use std::collections::HashSet;

use nalgebra::{DMatrix, Vector3};
use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;

/// Bits of a colour's red, green and blue that the table distinguishes.
const BITS: u32 = 5;

/// Entries of the table.
pub const ENTRIES: usize = 1 << (3 * BITS);

/// What an entry says where nothing is known.
const UNKNOWN: u8 = u8::MAX;

/// There are at most so many classes.
pub const CLASSES_MOST: usize = 64;

/// Rounds of k-means, which settle much earlier.
const ROUNDS: usize = 50;

/// Units are at least so wide: cameras have noise of some grey values, and so has the table.
const NARROWEST: f64 = 0.04;

/// How a table is trained.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Training {
    /// Gaussian units of each class, at most.
    pub centres: usize,
    /// Weight that holds the outputs' weights small.
    pub ridge: f64,
    /// Colours whose units are all less active than this are unknown; within 0 to 1.
    pub unknown: f64,
    /// Seed of the first centres.
    pub seed: u64,
}

impl Default for Training {
    fn default() -> Self {
        Self {
            centres: 6,
            ridge: 1e-3,
            unknown: 0.05,
            seed: 1,
        }
    }
}

/// Why nothing can be learned.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum TrainError {
    /// There is nothing to distinguish.
    #[error(
        "only class `{0}` has samples: what else is in the pictures needs a class, too, such as `background`"
    )]
    OneClass(String),
    /// Nothing at all.
    #[error("there are no samples")]
    None,
    /// Too many classes.
    #[error("{0} classes are more than {CLASSES_MOST}")]
    ManyClasses(usize),
    /// How much a class varies is not known.
    #[error("class `{0}` has one sample only: give it several, from light and shadow")]
    OneSample(String),
    /// Two classes are the same colour.
    #[error(
        "all samples of class `{0}` are samples of class `{1}`, too: nothing distinguishes them"
    )]
    SameClass(String, String),
    /// A sample is no colour.
    #[error("sample {0} is no colour: red, green and blue are within 0 to 255")]
    NoColour(usize),
}

/// A trained table.
#[derive(Debug, Clone, PartialEq)]
pub struct Classes {
    names: Vec<String>,
    /// Class and confidence (of 255) of each entry.
    table: Vec<(u8, u8)>,
}

/// What a colour is.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Class {
    /// Which class, in the order of [`Classes::names`]; none for colours unlike all samples.
    pub class: Option<usize>,
    /// The network's output for it, within 0 to 1.
    pub confidence: f64,
}

/// The point of a colour (0 to 255 each): S cos H, S sin H, V.
fn point(rgb: [f64; 3]) -> Vector3<f64> {
    let [red, green, blue] = rgb;
    let (most, least) = (red.max(green).max(blue), red.min(green).min(blue));
    let span = most - least;
    if span <= 0.0 {
        return Vector3::new(0.0, 0.0, most / 255.0);
    }
    let sixths = if most == red {
        (green - blue) / span
    } else if most == green {
        2.0 + (blue - red) / span
    } else {
        4.0 + (red - green) / span
    };
    let (sin, cos) = (sixths * std::f64::consts::FRAC_PI_3).sin_cos();
    let saturation = span / most;
    Vector3::new(saturation * cos, saturation * sin, most / 255.0)
}

impl Classes {
    /// Learns from samples, each the number of its class in `names` and a colour of 0 to 255.
    ///
    /// # Errors
    /// There are fewer than two classes, a class has one sample, a class is another one, or a sample is no colour.
    pub fn train(
        names: &[String],
        samples: &[(usize, [f64; 3])],
        training: &Training,
    ) -> Result<Self, TrainError> {
        let points = checked(names, samples)?;
        let mut rng = ChaCha8Rng::seed_from_u64(training.seed);
        let centres: Vec<Vector3<f64>> = points
            .iter()
            .flat_map(|class| centres(class, training.centres.max(1), &mut rng))
            .collect();
        let units = Units::around(centres);
        let weights = weights(&units, &points, training.ridge);
        let entry = |entry: usize| {
            let sample = |shift: u32| {
                let high = (entry >> shift) & ((1 << BITS) - 1);
                // The middle of the colours that share an entry.
                (high << (8 - BITS)) as f64 + 3.5
            };
            let at = point([sample(2 * BITS), sample(BITS), sample(0)]);
            let (active, most) = units.active(&at);
            if most < training.unknown {
                return (UNKNOWN, 0);
            }
            let outputs = active.transpose() * &weights;
            let mut best = (UNKNOWN, 0.0);
            for (class, output) in (0_u8..).zip(outputs.iter()) {
                if *output > best.1 {
                    best = (class, *output);
                }
            }
            // Rounded, and within the byte.
            (best.0, (best.1.min(1.0) * 255.0).round() as u8)
        };
        Ok(Self {
            names: names.to_vec(),
            table: (0..ENTRIES).map(entry).collect(),
        })
    }

    /// The classes' names.
    #[must_use]
    pub fn names(&self) -> &[String] {
        &self.names
    }

    /// What a colour is.
    #[must_use]
    pub fn of(&self, rgb: [u8; 3]) -> Class {
        let high = rgb.map(|sample| usize::from(sample >> (8 - BITS)));
        let entry = (high[0] << (2 * BITS)) | (high[1] << BITS) | high[2];
        let (class, confidence) = self.table.get(entry).copied().unwrap_or((UNKNOWN, 0));
        Class {
            class: (class != UNKNOWN).then_some(usize::from(class)),
            confidence: f64::from(confidence) / 255.0,
        }
    }

    /// For each class the pixels (red, green, blue) that are of it and the mean of their confidences; the unknown ones last.
    #[must_use]
    pub fn counted(&self, pixels: &[u8]) -> Vec<(u64, f64)> {
        let mut counts = vec![(0_u64, 0.0); self.names.len() + 1];
        for pixel in pixels.chunks_exact(3) {
            let found = self.of([pixel[0], pixel[1], pixel[2]]);
            let place = found.class.unwrap_or(self.names.len());
            if let Some((count, sum)) = counts.get_mut(place) {
                *count += 1;
                *sum += found.confidence;
            }
        }
        for (count, sum) in &mut counts {
            *sum /= (*count).max(1) as f64;
        }
        counts
    }

    /// For each class the share of its samples that the table takes for it, and the class it takes most others for.
    #[must_use]
    pub fn agreement(&self, samples: &[(usize, [f64; 3])]) -> Vec<(f64, Option<usize>)> {
        let count = self.names.len();
        let mut taken = vec![vec![0_usize; count + 1]; count];
        for (class, rgb) in samples {
            let found = self.of(rgb.map(|sample| sample.round() as u8)).class;
            if let Some(row) = taken.get_mut(*class) {
                row[found.unwrap_or(count)] += 1;
            }
        }
        let shares = taken.iter().enumerate().map(|(class, row)| {
            let all: usize = row.iter().sum();
            let others = (0..count).filter(|other| *other != class && row[*other] > 0);
            let most = others.max_by_key(|other| row[*other]);
            (row[class] as f64 / all.max(1) as f64, most)
        });
        shares.collect()
    }
}

/// The points of each class, where all can be learned.
fn checked(
    names: &[String],
    samples: &[(usize, [f64; 3])],
) -> Result<Vec<Vec<Vector3<f64>>>, TrainError> {
    if names.len() > CLASSES_MOST {
        return Err(TrainError::ManyClasses(names.len()));
    }
    let mut points = vec![Vec::new(); names.len()];
    for (nth, (class, rgb)) in samples.iter().enumerate() {
        let possible = rgb.iter().all(|sample| (0.0..=255.0).contains(sample));
        let class = points.get_mut(*class).filter(|_| possible);
        class.ok_or(TrainError::NoColour(nth))?.push(point(*rgb));
    }
    let with_samples = names
        .iter()
        .zip(&points)
        .filter(|(_, class)| !class.is_empty());
    let with_samples: Vec<_> = with_samples.collect();
    match with_samples.as_slice() {
        [] => return Err(TrainError::None),
        [(name, _)] => return Err(TrainError::OneClass((*name).clone())),
        several => {
            if let Some((name, _)) = several.iter().find(|(_, class)| class.len() == 1) {
                return Err(TrainError::OneSample((*name).clone()));
            }
            let bits = |point: &Vector3<f64>| [point.x, point.y, point.z].map(f64::to_bits);
            let sets: Vec<HashSet<[u64; 3]>> = several
                .iter()
                .map(|(_, class)| class.iter().map(bits).collect())
                .collect();
            for (nth, (name, _)) in several.iter().enumerate() {
                let same = (0..several.len())
                    .find(|other| *other != nth && sets[nth].is_subset(&sets[*other]));
                if let Some(other) = same {
                    let other = several[other].0.clone();
                    return Err(TrainError::SameClass((*name).clone(), other));
                }
            }
        }
    }
    Ok(points)
}

/// At most `count` centres of points (k-means from spread seeds: Arthur and Vassilvitskii, 2007).
fn centres(points: &[Vector3<f64>], count: usize, rng: &mut ChaCha8Rng) -> Vec<Vector3<f64>> {
    let mut centres: Vec<Vector3<f64>> = Vec::new();
    let square = |centres: &[Vector3<f64>], point: &Vector3<f64>| {
        let squares = centres.iter().map(|centre| (centre - point).norm_squared());
        squares.fold(f64::INFINITY, f64::min)
    };
    while centres.len() < count {
        let squares: Vec<f64> = points
            .iter()
            .map(|point| square(&centres, point).min(1e9))
            .collect();
        let sum: f64 = squares.iter().sum();
        if sum <= 0.0 {
            break;
        }
        let mut left = rng.random_range(0.0..sum);
        let chosen = squares.iter().position(|square| {
            left -= square;
            left < 0.0
        });
        match chosen.and_then(|chosen| points.get(chosen)) {
            Some(point) => centres.push(*point),
            None => break,
        }
    }
    for _ in 0..ROUNDS {
        let mut sums = vec![(Vector3::zeros(), 0.0); centres.len()];
        for point in points {
            let distance = |centre: &Vector3<f64>| (centre - point).norm_squared();
            let nearest = (0..centres.len())
                .min_by(|a, b| distance(&centres[*a]).total_cmp(&distance(&centres[*b])));
            if let Some(nearest) = nearest {
                sums[nearest].0 += point;
                sums[nearest].1 += 1.0;
            }
        }
        let mut moved = 0.0_f64;
        for (centre, (sum, count)) in centres.iter_mut().zip(sums) {
            if count > 0.0 {
                let mean: Vector3<f64> = sum / count;
                moved = moved.max((mean - *centre).norm());
                *centre = mean;
            }
        }
        if moved < 1e-9 {
            break;
        }
    }
    centres
}

/// Gaussian units.
struct Units {
    centres: Vec<Vector3<f64>>,
    widths: Vec<f64>,
}

impl Units {
    /// Each as wide as its two nearest neighbours are far in the mean.
    fn around(centres: Vec<Vector3<f64>>) -> Self {
        let widths = centres.iter().enumerate().map(|(nth, centre)| {
            let others = centres
                .iter()
                .enumerate()
                .filter(|(other, _)| *other != nth);
            let mut far: Vec<f64> = others.map(|(_, other)| (other - centre).norm()).collect();
            far.sort_by(f64::total_cmp);
            let near = &far[..far.len().min(2)];
            let mean = near.iter().sum::<f64>() / near.len().max(1) as f64;
            mean.max(NARROWEST)
        });
        let widths = widths.collect();
        Self { centres, widths }
    }

    /// The units' activations, which sum to one, and the largest as it was before.
    fn active(&self, at: &Vector3<f64>) -> (nalgebra::DVector<f64>, f64) {
        let active = self
            .centres
            .iter()
            .zip(&self.widths)
            .map(|(centre, width)| {
                let far = (at - centre).norm_squared() / (2.0 * width * width);
                // Far from all units the nearest still counts.
                (-far).exp().max(1e-300)
            });
        let active = nalgebra::DVector::from_iterator(self.centres.len(), active);
        let most = active.max();
        let sum = active.sum();
        (active / sum, most)
    }
}

/// The weights from units to classes, by ridge least squares in which every class counts the same.
fn weights(units: &Units, points: &[Vec<Vector3<f64>>], ridge: f64) -> DMatrix<f64> {
    let count = units.centres.len();
    let mut normal = DMatrix::identity(count, count) * ridge.max(1e-12);
    let mut right = DMatrix::zeros(count, points.len());
    for (class, points) in points.iter().enumerate() {
        let share = 1.0 / points.len().max(1) as f64;
        for point in points {
            let (active, _) = units.active(point);
            normal.ger(share, &active, &active, 1.0);
            let mut column = right.column_mut(class);
            column.axpy(share, &active, 1.0);
        }
    }
    // The ridge makes the matrix positive definite.
    match normal.cholesky() {
        Some(factors) => factors.solve(&right),
        None => right,
    }
}

#[cfg(test)]
mod tests {
    use rand_distr::{Distribution as _, Normal};

    use super::*;

    /// The classes of a draughts board with noise, as a camera sees them.
    const SHOWN: [(&str, [f64; 3]); 6] = [
        ("light", [225.0, 205.0, 170.0]),
        ("dark", [110.0, 65.0, 35.0]),
        ("white", [245.0, 245.0, 240.0]),
        ("black", [30.0, 30.0, 35.0]),
        ("hand", [205.0, 145.0, 120.0]),
        ("red", [200.0, 20.0, 25.0]),
    ];

    fn names() -> Vec<String> {
        SHOWN.iter().map(|(name, _)| (*name).to_owned()).collect()
    }

    fn samples(each: usize, sd: f64, seed: u64) -> Vec<(usize, [f64; 3])> {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let noise = Normal::new(0.0, sd).unwrap();
        let mut samples = Vec::new();
        for (class, (_, rgb)) in SHOWN.iter().enumerate() {
            for _ in 0..each {
                let light = rng.random_range(0.85..1.0);
                let drawn =
                    rgb.map(|sample| (sample * light + noise.sample(&mut rng)).clamp(0.0, 255.0));
                samples.push((class, drawn));
            }
        }
        samples
    }

    #[test]
    fn colours_that_were_not_in_the_training_are_taken_for_their_classes() {
        let classes = Classes::train(&names(), &samples(60, 5.0, 1), &Training::default()).unwrap();
        let unseen = samples(300, 5.0, 2);
        let right = unseen.iter().filter(|(class, rgb)| {
            classes.of(rgb.map(|sample| sample.round() as u8)).class == Some(*class)
        });
        let share = right.count() as f64 / unseen.len() as f64;
        assert!(share > 0.97, "{share}");
        for (share, _) in classes.agreement(&samples(60, 5.0, 1)) {
            assert!(share > 0.95, "{share}");
        }
    }

    #[test]
    fn a_colour_unlike_all_samples_is_unknown() {
        let classes = Classes::train(&names(), &samples(60, 5.0, 1), &Training::default()).unwrap();
        for rgb in [[0, 0, 255], [0, 255, 0], [0, 255, 255]] {
            assert_eq!(classes.of(rgb).class, None, "{rgb:?}");
        }
    }

    #[test]
    fn reds_on_both_sides_of_the_hue_circle_are_one_class() {
        let names = ["red".to_owned(), "grey".to_owned()];
        let mut samples = vec![(1, [100.0; 3]), (1, [140.0; 3])];
        for hue in [0.0, 10.0, 20.0] {
            samples.push((0, [200.0, 20.0 + hue, 20.0]));
            samples.push((0, [200.0, 20.0, 20.0 + hue]));
        }
        let classes = Classes::train(&names, &samples, &Training::default()).unwrap();
        for rgb in [[200, 20, 20], [200, 28, 20], [200, 20, 28], [180, 20, 20]] {
            assert_eq!(classes.of(rgb).class, Some(0), "{rgb:?}");
        }
        // Greys have no hue: one that leans to red by a value is still grey.
        assert_eq!(classes.of([121, 120, 120]).class, Some(1));
    }

    #[test]
    fn the_same_seed_makes_the_same_table_and_counts_add_up() {
        let train = |seed| {
            let training = Training {
                seed,
                ..Training::default()
            };
            Classes::train(&names(), &samples(60, 5.0, 1), &training).unwrap()
        };
        let classes = train(3);
        assert_eq!(classes, train(3));
        let pixels: Vec<u8> = (0..ENTRIES)
            .flat_map(|entry| {
                [entry >> 10, entry >> 5 & 31, entry & 31].map(|high| (high << 3) as u8)
            })
            .collect();
        let counted = classes.counted(&pixels);
        assert_eq!(counted.len(), 7);
        assert_eq!(counted.iter().map(|one| one.0).sum::<u64>(), ENTRIES as u64);
        assert!(counted.iter().all(|one| (0.0..=1.0).contains(&one.1)));
    }

    #[test]
    fn training_that_teaches_nothing_is_refused_by_name() {
        let of = |names: &[&str], samples: &[(usize, [f64; 3])]| {
            let names: Vec<String> = names.iter().map(|name| (*name).to_owned()).collect();
            Classes::train(&names, samples, &Training::default()).unwrap_err()
        };
        let (a, b) = ([10.0; 3], [200.0; 3]);
        assert_eq!(of(&[], &[]), TrainError::None);
        assert_eq!(
            of(&["a"], &[(0, a), (0, b)]),
            TrainError::OneClass("a".to_owned())
        );
        let one = of(&["a", "b"], &[(0, a), (0, b), (1, b)]);
        assert_eq!(one, TrainError::OneSample("b".to_owned()));
        let same = of(&["a", "b"], &[(0, a), (0, a), (1, a), (1, b)]);
        assert_eq!(same, TrainError::SameClass("a".to_owned(), "b".to_owned()));
        for wrong in [f64::NAN, -1.0, 255.5, f64::INFINITY] {
            let error = of(&["a", "b"], &[(0, a), (1, [0.0, wrong, 0.0])]);
            assert_eq!(error, TrainError::NoColour(1));
        }
        let many: Vec<String> = (0..65).map(|nth| nth.to_string()).collect();
        let error = Classes::train(&many, &[], &Training::default()).unwrap_err();
        assert_eq!(error, TrainError::ManyClasses(65));
    }
}
