//! How well the hand follows, without pictures and without an arm: the ball moves, is measured late and with noise where the map knows
//! it, and the hand is where its setpoint was a moment ago. Beside it runs a Kalman filter that has the true stamps and statistics.
//!
//! `CTOS_TRACKER_SEEDS=20 CTOS_TRACKER_SECONDS=60 cargo test --workspace --test following -- --nocapture` prints the table of `docs/tracker.md`;
//! `CTOS_TRACKER_HOURS=1` has the long run go on for so many hours.
#![allow(
    clippy::unwrap_used,
    clippy::print_stdout,
    reason = "all of this is test code, and tells what it measures"
)]

mod jumps;

use nalgebra::{Matrix3, Point3, RowVector3, Vector3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use tracker::{
    control::{Control, ControlArgs, Phase},
    target::Taken,
};

/// From setpoint to setpoint, from picture to picture, and until the hand is where it was sent, s.
const PERIOD: f64 = 0.0045;
const PICTURE: f64 = 0.04;
const SERVO: f64 = 0.0135;
/// Standard deviation of a place that the map tells, m, and the largest error of the clocks' difference, s.
const SIGMA: f64 = 0.000_5;
const CLOCK: f64 = 0.000_2;
/// What the map knows to both sides of the nominal place, m: its examples and as much again.
const KNOWN: [f64; 3] = [0.16, 0.16, 0.12];
/// What is held against the truth begins then, s.
const SETTLED: f64 = 3.0;

/// A ball over time.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Ball {
    /// 0.12 m of radius, 0.2 m/s.
    Circle,
    /// 0.2 m to both sides, up to 0.5 m/s.
    Sweep,
    /// Jumps with 2 m/s^2 and stops.
    Saccade,
}

/// A way with constant acceleration and as much deceleration.
#[derive(Debug, Clone, Copy)]
struct Jump {
    begin: f64,
    half: f64,
    from: Vector3<f64>,
    to: Vector3<f64>,
}

struct Motion {
    ball: Ball,
    rng: ChaCha8Rng,
    jumps: Vec<Jump>,
}

impl Motion {
    fn new(ball: Ball, seed: u64, seconds: f64) -> Self {
        let mut motion = Self {
            ball,
            rng: ChaCha8Rng::seed_from_u64(seed),
            jumps: Vec::new(),
        };
        let (mut begin, mut from) = (1.0, Vector3::zeros());
        while ball == Ball::Saccade && begin < seconds {
            let mut to = || motion.rng.random_range(-1.0..1.0_f64);
            let to = Vector3::new(0.1 * to(), 0.15 * to(), 0.05 * to());
            let half = ((to - from).norm() / 2.0).sqrt();
            motion.jumps.push(Jump {
                begin,
                half,
                from,
                to,
            });
            begin += 2.0 * half + motion.rng.random_range(0.3..1.0);
            from = to;
        }
        motion
    }

    fn at(&self, t: f64) -> Point3<f64> {
        // Soft at first, as hands are.
        let soft = (t / 1.5).clamp(0.0, 1.0);
        match self.ball {
            Ball::Circle => {
                let turn = 0.2 / 0.12 * t;
                let there = Vector3::new(0.1 * (1.0 - turn.cos()), 0.12 * turn.sin(), 0.0);
                Point3::from(there * soft)
            }
            Ball::Sweep => Point3::new(0.0, 0.2 * (2.5 * t).sin() * soft, 0.0),
            Ball::Saccade => {
                let after = self.jumps.partition_point(|jump| jump.begin <= t);
                let Some(jump) = after.checked_sub(1).map(|at| self.jumps[at]) else {
                    return Point3::origin();
                };
                let share = ((t - jump.begin) / (2.0 * jump.half).max(1e-9)).clamp(0.0, 1.0);
                let done = match share < 0.5 {
                    true => 2.0 * share * share,
                    false => 1.0 - 2.0 * (1.0 - share).powi(2),
                };
                Point3::from(jump.from + (jump.to - jump.from) * done)
            }
        }
    }
}

/// A Kalman filter of one axis, whose acceleration is a random walk and decays ahead of the last measurement.
struct Kalman {
    state: Vector3<f64>,
    spread: Matrix3<f64>,
    at: f64,
    agility: f64,
    lasts: f64,
}

impl Kalman {
    fn new(at: f64, z: f64, [agility, lasts]: [f64; 2]) -> Self {
        Self {
            state: Vector3::new(z, 0.0, 0.0),
            spread: Matrix3::from_diagonal(&Vector3::new(SIGMA * SIGMA, 1.0, 10.0)),
            at,
            agility,
            lasts,
        }
    }

    fn step(dt: f64) -> Matrix3<f64> {
        Matrix3::new(1.0, dt, 0.5 * dt * dt, 0.0, 1.0, dt, 0.0, 0.0, 1.0)
    }

    fn measure(&mut self, at: f64, z: f64) {
        let t = at - self.at;
        let step = Self::step(t);
        let q = self.agility * self.agility;
        let (a, b, c) = (t.powi(5) / 20.0, t.powi(4) / 8.0, t.powi(3) / 6.0);
        let noise = Matrix3::new(a, b, c, b, 2.0 * c, 0.5 * t * t, c, 0.5 * t * t, t) * q;
        self.state = step * self.state;
        self.spread = step * self.spread * step.transpose() + noise;
        let see = RowVector3::new(1.0, 0.0, 0.0);
        let gain = self.spread * see.transpose() / (self.spread[(0, 0)] + SIGMA * SIGMA);
        self.state += gain * (z - self.state.x);
        self.spread = (Matrix3::identity() - gain * see) * self.spread;
        self.at = at;
    }

    fn ahead(&self, now: f64) -> f64 {
        let later = now - self.at;
        let gone = self.lasts * (1.0 - (-later / self.lasts).exp());
        self.state.x + self.state.y * later + self.state.z * self.lasts * (later - gone)
    }
}

/// What Kalman filters believe of a ball: how agile it is, and how long it accelerates alike. The best of them for a motion at a
/// latency, found in hindsight, is the one that knows its statistics.
const STATISTICS: [[f64; 2]; 9] = [
    [0.1, 0.5],
    [0.3, 0.1],
    [0.3, 0.25],
    [1.0, 0.1],
    [1.0, 0.25],
    [1.0, 0.5],
    [3.0, 0.02],
    [3.0, 0.05],
    [6.0, 0.02],
];

/// What came out of a run: squares of errors of hand, estimate and Kalman filters, m^2.
#[derive(Debug, Clone, Default)]
struct Run {
    hand: Vec<f64>,
    estimate: f64,
    kalman: [f64; STATISTICS.len()],
    tracked: u64,
    judged: u64,
    lost: u64,
    expired: u64,
    ratio: f64,
}

impl Run {
    fn rms(&self) -> f64 {
        (self.hand.iter().sum::<f64>() / self.hand.len().max(1) as f64).sqrt()
    }

    fn p95(&self) -> f64 {
        let mut all = self.hand.clone();
        all.sort_by(f64::total_cmp);
        all.get(all.len() * 95 / 100)
            .map_or(0.0, |square| square.sqrt())
    }

    fn add(&mut self, other: &Self) {
        self.hand.extend(&other.hand);
        self.estimate += other.estimate;
        for (sum, own) in self.kalman.iter_mut().zip(other.kalman) {
            *sum += own;
        }
        self.tracked += other.tracked;
        self.judged += other.judged;
        self.lost += other.lost;
        self.expired += other.expired;
        self.ratio = self.ratio.max(other.ratio);
    }
}

fn run(ball: Ball, latency: [f64; 2], args: ControlArgs, seed: u64, seconds: f64) -> Run {
    let motion = Motion::new(ball, seed, seconds);
    let mut rng = ChaCha8Rng::seed_from_u64(seed ^ 0x5eed);
    let mut normal = move || -> f64 { StandardNormal.sample(&mut rng) };
    let clock = CLOCK * normal().clamp(-1.0, 1.0);
    let mut control = Control::new(args, Point3::origin());
    let mut kalman: Option<[[Kalman; 3]; STATISTICS.len()]> = None;
    let (mut waiting, mut hand) = (Vec::new(), vec![Point3::origin(); 4]);
    let mut run = Run::default();
    let mut next = 0.0;
    for tick in 0..(seconds / PERIOD) as u64 {
        let now = tick as f64 * PERIOD;
        let there = hand[hand.len() - 1 - (SERVO / PERIOD) as usize];
        if now >= next {
            next += PICTURE;
            let truth = motion.at(now);
            let seen = (truth - there)
                .iter()
                .zip(KNOWN)
                .all(|(off, most)| off.abs() < most);
            let place = truth + Vector3::from_fn(|_, _| SIGMA * normal());
            let late = (latency[0] + latency[1] * normal().clamp(-2.0, 2.0)).max(0.0);
            if seen {
                waiting.push((now + late, now, place));
            }
        }
        waiting.sort_by(|one: &(f64, f64, Point3<f64>), other| one.0.total_cmp(&other.0));
        while waiting.first().is_some_and(|first| first.0 <= now) {
            let (_, at, place) = waiting.remove(0);
            match control.measure(now, at + clock, &place) {
                Taken::Begun if args.prediction => {
                    kalman = Some(STATISTICS.map(|statistics| {
                        [0, 1, 2].map(|axis| Kalman::new(at, place[axis], statistics))
                    }));
                }
                Taken::Used => {
                    for axes in kalman.iter_mut().flatten() {
                        for (kalman, z) in axes.iter_mut().zip(place.iter()) {
                            kalman.measure(at, *z);
                        }
                    }
                }
                Taken::Begun | Taken::Late | Taken::Far | Taken::Wrong => {}
            }
        }
        let none = Vector3::zeros();
        run.ratio = run.ratio.max(control.go(now, &none, &none, PERIOD));
        hand.push(control.course().place);
        if hand.len() > 1000 {
            hand.drain(..900);
        }
        if now < SETTLED {
            continue;
        }
        run.judged += 1;
        if control.phase() != Phase::Track {
            continue;
        }
        run.tracked += 1;
        let truth = motion.at(now);
        run.hand.push((there - truth).norm_squared());
        let estimate = control.target(now).unwrap().place;
        run.estimate += (estimate - truth).norm_squared();
        for (sum, axes) in run.kalman.iter_mut().zip(kalman.iter().flatten()) {
            for (kalman, truth) in axes.iter().zip(truth.iter()) {
                *sum += (kalman.ahead(now) - truth).powi(2);
            }
        }
    }
    let counts = control.counts();
    (run.lost, run.expired) = (counts.lost, counts.expired);
    run
}

fn seeds() -> u64 {
    let seeds = std::env::var("CTOS_TRACKER_SEEDS");
    seeds.map_or(2, |seeds| seeds.parse().unwrap())
}

/// How long each runs, s.
fn long() -> f64 {
    let seconds = std::env::var("CTOS_TRACKER_SECONDS");
    seconds.map_or(30.0, |seconds| seconds.parse().unwrap())
}

const LATENCIES: [(&str, [f64; 2]); 3] = [
    ("40 ms", [0.04, 0.0]),
    ("110 +- 20 ms", [0.11, 0.02]),
    ("200 ms", [0.2, 0.0]),
];

#[test]
fn balls_are_followed_smoothly_at_any_latency_about_as_well_as_a_kalman_filter_could() {
    let balls = [
        (Ball::Circle, "circle, 0.2 m/s"),
        (Ball::Sweep, "sweep, 0.5 m/s"),
        (Ball::Saccade, "saccades, 2 m/s^2"),
    ];
    println!("{} seeds of {} s each, mm", seeds(), long());
    println!(
        "| ball | latency | rms | p95 | without prediction, rms | estimate over a Kalman filter's | followed | expired |"
    );
    println!("|---|---|---|---|---|---|---|---|");
    for (ball, name) in balls {
        for (late, latency) in LATENCIES {
            let [mut with, mut without] = [Run::default(), Run::default()];
            for seed in 0..seeds() {
                with.add(&run(ball, latency, ControlArgs::default(), seed, long()));
                let args = ControlArgs {
                    prediction: false,
                    ..ControlArgs::default()
                };
                without.add(&run(ball, latency, args, seed, long()));
            }
            let best = with.kalman.iter().copied().fold(f64::MAX, f64::min);
            let over = (with.estimate / best).sqrt();
            let followed = with.tracked as f64 / with.judged as f64;
            println!(
                "| {name} | {late} | {:.1} | {:.1} | {:.1} | {over:.2} | {:.1} % | {} |",
                with.rms() * 1e3,
                with.p95() * 1e3,
                without.rms() * 1e3,
                followed * 100.0,
                with.expired,
            );
            let told = format!("{name} {late}");
            assert!(
                with.ratio <= 1.0 + 1e-9 && without.ratio <= 1.0 + 1e-9,
                "{told}"
            );
            assert!(over <= 1.15, "{told}: {over}");
            let least = match (ball, late) {
                (Ball::Circle | Ball::Sweep, _) => 4.0,
                (Ball::Saccade, "40 ms") => 2.4,
                (Ball::Saccade, "200 ms") => 1.25,
                (Ball::Saccade, _) => 1.5,
            };
            let worse = without.rms() / with.rms();
            assert!(worse >= least, "{told}: {worse}");
            // What no hand could do says how much that is; the joints of an arm allow some 3 m/s^2 outwards.
            if ball == Ball::Saccade {
                let bounds = [6.0, 3.0].map(|hand| jumps::least_rms(hand, latency[0]));
                for (hand, bound) in ["6", "3"].iter().zip(bounds) {
                    let most = without.rms() / bound;
                    println!(
                        "{told}: no hand of {hand} m/s^2 comes below {:.1} mm, {most:.2} times",
                        bound * 1e3
                    );
                }
                // The hand here has no joints.
                let [bound, _] = bounds;
                assert!(bound < with.rms(), "{told}: {bound}");
            }
            // Jumps at 200 ms are shown, and not asked for.
            if ball != Ball::Saccade || latency[0] < 0.15 {
                assert!(followed > 0.99, "{told}: {followed}");
                assert_eq!(with.expired, 0, "{told}");
            }
        }
    }
}

#[test]
fn hours_of_sweeps_and_jumps_are_followed_as_well_at_their_end_as_at_their_beginning() {
    let hours = std::env::var("CTOS_TRACKER_HOURS");
    let seconds = hours.map_or(300.0, |hours| 3600.0 * hours.parse::<f64>().unwrap());
    for ball in [Ball::Sweep, Ball::Saccade] {
        let run = run(ball, [0.11, 0.02], ControlArgs::default(), 7, seconds);
        assert!(run.ratio <= 1.0 + 1e-9);
        assert_eq!(run.expired, 0, "{ball:?}");
        let part = run.hand.len() / 3;
        let rms = |from: usize| {
            let squares = run.hand[from..from + part].iter().sum::<f64>();
            (squares / part as f64).sqrt()
        };
        let (first, last) = (rms(0), rms(2 * part));
        println!("{ball:?}: {:.2} and {:.2} mm", first * 1e3, last * 1e3);
        assert!(
            (0.8..1.25).contains(&(last / first)),
            "{ball:?}: {first} and {last}"
        );
    }
}
