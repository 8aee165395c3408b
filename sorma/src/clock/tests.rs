//! Simulated clocks whose difference is known.

use super::*;
use proptest::prelude::*;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// The clock there: by pieces, each with a rate of its own. What it shows is rounded to the nanosecond. What it
/// carries from piece to piece is not, or it would drift faster than its rates say.
struct There {
    /// Moments here at which a piece begins, ns. With each stand the time of the clock there, in 10^-9 ns,
    /// and how much faster it runs than the one here, in 10^-9.
    pieces: Vec<(i128, i128, i128)>,
}

const BILLION: i128 = 1_000_000_000;
/// One piece that is longer than any test, ns.
const FOREVER: i128 = i128::MAX / BILLION / BILLION;

impl There {
    fn shows(&self, here: i128) -> Instant {
        let after = self.pieces.partition_point(|(begin, ..)| *begin <= here);
        let (begin, has, rate) = self.pieces[after.max(1) - 1];
        let shown = (has + (here - begin) * (BILLION + rate)).div_euclid(BILLION);
        Instant::from_nanos(u64::try_from(shown).unwrap())
    }

    fn with_rates(offset: i128, every: i128, rates: impl Iterator<Item = i128>) -> Self {
        let mut there = Self { pieces: Vec::new() };
        let mut begin = 0;
        let mut has = offset * BILLION;
        for rate in rates {
            there.pieces.push((begin, has, rate));
            begin += every;
            has += every * (BILLION + rate);
        }
        there
    }
}

fn at(here: i128) -> Instant {
    Instant::from_nanos(u64::try_from(here).unwrap())
}

fn exchange(there: &There, begin: i128, out: i128, stay: i128, back: i128) -> Exchange {
    Exchange {
        t1: at(begin),
        t2: there.shows(begin + out),
        t3: there.shows(begin + out + stay),
        t4: at(begin + out + stay + back),
    }
}

/// What is wrong with an estimate, when its error is beyond its bound.
fn outside(clock: &ClockDifference, there: &There, here: i128) -> Option<String> {
    let truth = i128::from(there.shows(here).as_nanos()) - here;
    let said = clock.at(at(here)).unwrap();
    let wrong = (truth - i128::from(said.offset_ns)).unsigned_abs();
    if wrong > u128::from(said.error_ns) {
        return Some(format!("at {here}: {truth}, said {said:?}"));
    }
    let corrected = clock.correct(there.shows(here)).unwrap();
    let wrong = (i128::from(corrected.at.as_nanos()) - here).unsigned_abs();
    (wrong > corrected.error.as_nanos()).then(|| format!("{here}, corrected {corrected:?}"))
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(100))]

    /// Delays as unlike as they may be, rates that change all the time, moments before, between and after.
    #[test]
    fn the_truth_is_always_within_the_bound(
        seed in any::<u64>(),
        offset in prop_oneof![0_i128..10_000, Just(1_i128 << 61), 0_i128..(1 << 50)],
        drift_ppb in prop_oneof![Just(0_i128), 1_i128..200_000],
        exchanges in 1_usize..200,
        jitter in 1_i128..50_000_000,
    ) {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let every = 50_000_000;
        let rates: Vec<i128> = (0..2000).map(|_| random.random_range(-drift_ppb..=drift_ppb)).collect();
        let there = There::with_rates(offset, every, rates.into_iter());
        let mut clock = ClockDifference::new(drift_ppb as f64 * 1e-9).unwrap();
        prop_assert_eq!(clock.at(at(5)), None);
        prop_assert_eq!(clock.correct(at(5)), None);
        let mut begin = 0;
        for _ in 0..exchanges {
            begin += random.random_range(1..200_000_000);
            let out = random.random_range(0..jitter) * i128::from(random.random_bool(0.7));
            let back = random.random_range(0..jitter) * i128::from(random.random_bool(0.7));
            let stay = random.random_range(0..1_000_000);
            let exchange = exchange(&there, begin, out, stay, back);
            prop_assert_eq!(clock.observe(exchange), Ok(Observed::Used));
            begin += out + stay + back;
            let ahead = random.random_range(0..10_000_000_000);
            let before = random.random_range(0..=begin);
            for here in [begin, begin + ahead, before] {
                prop_assert_eq!(outside(&clock, &there, here), None);
            }
        }
    }
}

#[test]
fn the_example_of_an_exchange_gives_offset_and_half_the_delay() {
    // RFC 5905, section 8: offset ((t2 - t1) + (t3 - t4)) / 2, delay (t4 - t1) - (t3 - t2).
    let mut clock = ClockDifference::new(0.0).unwrap();
    let [t1, t2, t3, t4] = [1_000, 9_500, 9_700, 2_600].map(at);
    clock.observe(Exchange { t1, t2, t3, t4 }).unwrap();
    let said = clock.at(t4).unwrap();
    assert_eq!(said.offset_ns, 7_800);
    assert_eq!(said.error_ns, 700 + ROUNDING_NS as u64);
    let stamp = clock.correct(at(10_000)).unwrap();
    assert_eq!(stamp.at, at(2_200));
}

#[test]
fn one_short_delay_makes_long_ones_harmless() {
    let there = There::with_rates(1_000_000, FOREVER, std::iter::once(0));
    let mut clock = ClockDifference::new(0.0).unwrap();
    for (index, (out, back)) in [(9_000_000, 10), (50, 50), (10, 7_000_000)]
        .iter()
        .enumerate()
    {
        let begin = index as i128 * 100_000_000;
        clock
            .observe(exchange(&there, begin, *out, 5, *back))
            .unwrap();
    }
    let said = clock.at(at(400_000_000)).unwrap();
    assert!((said.offset_ns - 1_000_000).abs() <= 50, "{said:?}");
    assert!(said.error_ns <= 110, "{said:?}");
}

#[test]
fn the_drift_of_two_crystals_is_found_and_makes_the_estimate_better_than_its_bound() {
    let drift_ppb = 47_000;
    let there = There::with_rates(5_000_000, FOREVER, std::iter::once(drift_ppb));
    let mut clock = ClockDifference::new(USUAL_DRIFT).unwrap();
    let mut random = ChaCha8Rng::seed_from_u64(7);
    let second = BILLION;
    for index in 0..120 {
        let out = 100_000 + random.random_range(0..100_000);
        let back = 100_000 + random.random_range(0..100_000);
        let exchange = exchange(&there, index * second, out, 10_000, back);
        clock.observe(exchange).unwrap();
    }
    assert!((clock.drift() - 47e-6).abs() < 2e-6, "{}", clock.drift());
    let here = 130 * second;
    let truth = i128::from(there.shows(here).as_nanos()) - here;
    let said = clock.at(at(here)).unwrap();
    let wrong = (truth - i128::from(said.offset_ns)).unsigned_abs();
    assert!(
        wrong < 100_000 && said.error_ns > 1_000_000,
        "{wrong} {said:?}"
    );
}

#[test]
fn a_clock_that_was_set_is_noticed_and_the_estimate_begins_anew() {
    let before = There::with_rates(0, FOREVER, std::iter::once(0));
    let after = There::with_rates(60 * BILLION, FOREVER, std::iter::once(0));
    let mut clock = ClockDifference::new(USUAL_DRIFT).unwrap();
    clock
        .observe(exchange(&before, 0, 1_000, 1_000, 1_000))
        .unwrap();
    let set = exchange(&after, BILLION, 1_000, 1_000, 1_000);
    assert_eq!(clock.observe(set), Ok(Observed::Restarted));
    assert_eq!(clock.restarts(), 1);
    assert_eq!(clock.at(at(BILLION)).unwrap().offset_ns, 60_000_000_000);
}

#[test]
fn times_that_cannot_be_are_refused_and_change_nothing() {
    let mut clock = ClockDifference::new(USUAL_DRIFT).unwrap();
    let good = Exchange {
        t1: at(10),
        t2: at(500),
        t3: at(510),
        t4: at(40),
    };
    clock.observe(good).unwrap();
    let before = clock.at(at(50));
    for bad in [
        Exchange { t4: at(9), ..good },
        Exchange {
            t3: at(499),
            ..good
        },
    ] {
        assert_eq!(clock.observe(bad), Err(ClockError::Backwards(bad)));
    }
    assert_eq!(clock.at(at(50)), before);
    for drift in [-1e-9, 0.011, f64::NAN] {
        assert!(ClockDifference::new(drift).is_err());
    }
    let extreme = Exchange {
        t1: at(0),
        t2: Instant::from_nanos(u64::MAX),
        t3: Instant::from_nanos(u64::MAX),
        t4: at(0),
    };
    let mut clock = ClockDifference::new(0.0).unwrap();
    clock.observe(extreme).unwrap();
    assert_eq!(clock.at(at(0)).unwrap().offset_ns, i64::MAX);
    assert!(clock.correct(Instant::START).is_some());
}
