//! Feeds whatever reads bytes or texts from outside with mutations of a kept corpus.
//!
//! A target must answer any input with a value or an error. It must never panic, never go on without
//! end, and never reserve what was only announced. The same seed makes the same inputs, so a run differs
//! from the last one only in how far it comes. `CTOS_FUZZ_SECONDS` makes it longer (for all targets of a
//! crate together), and `CTOS_FUZZ_SEED` sets another seed. An input that fails is written into the
//! corpus beside the others, where the next run begins with it.

#![allow(
    clippy::panic,
    clippy::expect_used,
    reason = "this is the body of tests: it ends them where it finds something wrong"
)]

use std::{
    env, fs,
    panic::{AssertUnwindSafe, catch_unwind},
    path::PathBuf,
    str::FromStr,
    time::Duration,
};

use ctos::time::Clock;
use rand::{Rng, RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;

/// The seed of a run that is told no other.
const SEED: u64 = 1;

/// What the targets of one crate have in common.
#[derive(Debug, Clone)]
pub struct Mutator {
    /// The folder of kept inputs: `corpus/<target>/*`.
    pub corpus: PathBuf,
    /// Pieces that mean something to one target or another.
    pub words: &'static [&'static str],
    /// The longest input, bytes.
    pub longest: usize,
    /// Seconds for all targets together, where nobody says another number.
    pub seconds: f64,
    /// How many targets there are.
    pub targets: u32,
}

impl Mutator {
    /// Feeds `target`, known as `name`, first with `own` and what is kept, then with mutations of them.
    ///
    /// # Panics
    /// When an input made the target panic, once the input is kept; and where the corpus cannot be read or written.
    pub fn play(&self, name: &str, own: Vec<Vec<u8>>, target: impl Fn(&[u8])) {
        let seconds = told("CTOS_FUZZ_SECONDS").unwrap_or(self.seconds);
        let seed = told("CTOS_FUZZ_SEED").unwrap_or(SEED);
        let passes = |input: &[u8]| catch_unwind(AssertUnwindSafe(|| target(input))).is_ok();
        let corpus = self.kept(name, own);
        for input in &corpus {
            self.hold(name, seed, input, passes(input));
        }
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let clock = Clock::real();
        let end = clock.now() + Duration::from_secs_f64(seconds) / self.targets.max(1);
        while clock.now() < end {
            let input = self.mutated(&corpus, &mut rng);
            self.hold(name, seed, &input, passes(&input));
        }
    }

    /// The inputs that a target begins with: its own, and those that are kept, by name.
    fn kept(&self, name: &str, own: Vec<Vec<u8>>) -> Vec<Vec<u8>> {
        let folder = self.corpus.join(name);
        let mut files: Vec<PathBuf> = match fs::read_dir(&folder) {
            Ok(files) => files.filter_map(|file| Some(file.ok()?.path())).collect(),
            Err(_) => Vec::new(),
        };
        files.sort();
        let kept = files
            .iter()
            .map(|file| fs::read(file).expect("an input of the corpus can be read"));
        let all: Vec<_> = own.into_iter().chain(kept).collect();
        assert!(!all.is_empty(), "`{name}` has no input to begin with");
        all
    }

    /// Keeps an input that the target did not take, and says where.
    fn hold(&self, name: &str, seed: u64, input: &[u8], passed: bool) {
        if passed {
            return;
        }
        let digest = input
            .iter()
            .fold(0xcbf2_9ce4_8422_2325_u64, |digest, byte| {
                (digest ^ u64::from(*byte)).wrapping_mul(0x0100_0000_01b3)
            });
        let folder = self.corpus.join(name);
        fs::create_dir_all(&folder).expect("the corpus can be written");
        let file = folder.join(format!("failed-{digest:016x}"));
        fs::write(&file, input).expect("the corpus can be written");
        panic!(
            "`{name}` failed with seed {seed}; its input is kept in {}",
            file.display()
        );
    }

    /// An input that is like those of the corpus, but for one to eight changes.
    fn mutated(&self, corpus: &[Vec<u8>], rng: &mut impl Rng) -> Vec<u8> {
        let mut input = any(corpus, rng).to_vec();
        for _ in 0..rng.random_range(1..=8) {
            self.change(&mut input, any(corpus, rng), rng);
            input.truncate(self.longest);
        }
        input
    }

    fn change(&self, input: &mut Vec<u8>, other: &[u8], rng: &mut impl Rng) {
        let place = rng.random_range(0..=input.len());
        let rest = input.len() - place;
        let from = rng.random_range(0..=other.len());
        let some = |rng: &mut dyn Rng, most: usize| rng.random_range(0..=most.min(64));
        match rng.random_range(0..9) {
            0 if rest > 0 => input[place] ^= 1 << rng.random_range(0..8),
            1 if rest > 0 => input[place] = rng.random(),
            2 => input.insert(place, rng.random()),
            3 => drop(input.drain(place..place + rng.random_range(0..=rest))),
            // Lengths and numbers at their limits.
            4 if rest >= 4 => {
                let limits = [0_u32, 1, 0x7f, 0x80, 0xffff, 1 << 26, 1 << 31, u32::MAX];
                let limit = limits[rng.random_range(0..limits.len())].to_le_bytes();
                input[place..place + 4].copy_from_slice(&limit);
            }
            5 => drop(input.splice(place.., other[from..].iter().copied())),
            6 => {
                let part = &other[from..from + some(rng, other.len() - from)];
                drop(input.splice(place..place, part.iter().copied()));
            }
            7 => {
                let again = input[place..place + some(rng, rest)].to_vec();
                drop(input.splice(place..place, again));
            }
            _ if !self.words.is_empty() => {
                let word = self.words[rng.random_range(0..self.words.len())];
                drop(input.splice(place..place, word.bytes()));
            }
            _ => {}
        }
    }
}

fn any<'a>(corpus: &'a [Vec<u8>], rng: &mut impl Rng) -> &'a [u8] {
    &corpus[rng.random_range(0..corpus.len())]
}

/// What the environment says under `name`.
///
/// # Panics
/// When it is not such a value.
fn told<T: FromStr>(name: &str) -> Option<T> {
    let text = env::var(name).ok()?;
    let value = text.parse().ok();
    Some(value.unwrap_or_else(|| panic!("{name}=`{text}` is not a number")))
}

#[cfg(test)]
mod tests {
    use std::cell::RefCell;

    use super::*;

    fn mutator(corpus: PathBuf) -> Mutator {
        Mutator {
            corpus,
            words: &["word"],
            longest: 32,
            seconds: 0.05,
            targets: 1,
        }
    }

    #[test]
    fn the_same_seed_makes_the_same_inputs_and_none_is_too_long() {
        let of = |seed| {
            let (mut rng, corpus) = (ChaCha8Rng::seed_from_u64(seed), [vec![0; 40], vec![7; 3]]);
            let mutator = mutator(PathBuf::new());
            let inputs = (0..2000).map(|_| mutator.mutated(&corpus, &mut rng));
            inputs.collect::<Vec<_>>()
        };
        assert_eq!(of(1), of(1));
        assert_ne!(of(1), of(2));
        assert!(of(1).iter().all(|input| input.len() <= 32));
        assert!(
            of(1)
                .iter()
                .any(|input| input.windows(4).any(|part| part == b"word"))
        );
    }

    #[test]
    fn an_input_that_fails_is_kept_and_the_next_run_begins_with_it() {
        let folder = tempfile::tempdir().expect("a folder");
        let mutator = mutator(folder.path().to_owned());
        let bad = |input: &[u8]| assert!(!input.contains(&1), "a one");
        let own = || vec![vec![0; 8]];
        let failed = catch_unwind(|| mutator.play("bad", own(), bad));
        assert!(failed.is_err());
        let seen = RefCell::new(Vec::new());
        mutator.play("bad", own(), |input| seen.borrow_mut().push(input.to_vec()));
        let seen = seen.into_inner();
        assert!(seen[0] == [0; 8] && seen[1].contains(&1));
    }
}
