//! What no hand that reacts at twice the noise can do better at jumps. It is told the truth, late: that a jump has begun and which way it goes, later that the ball
//! brakes, and with that where it stops. Until then jumps of all lengths look alike, so one motion has to do for all of them.
//! That motion has the least mean square of its distance from the ball, within the hand's acceleration: a convex problem.
//!
//! It is told of a change when the first picture shows the ball by more than twice the noise from where it would have been.

use nalgebra::{DMatrix, DVector, Vector3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::{PICTURE, SERVO, SIGMA};

/// Acceleration of the ball, m/s^2, and the mean stop, s.
const BALL: f64 = 2.0;
const STOP: f64 = 0.65;
/// Lengths of jumps that stand for all, and the step of time, s.
const LENGTHS: usize = 6;
const STEP: f64 = 0.025;

/// Half the durations of jumps, s, each as likely.
fn halves() -> Vec<f64> {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let mut place = || {
        let mut to = || rng.random_range(-1.0..1.0_f64);
        Vector3::new(0.1 * to(), 0.15 * to(), 0.05 * to())
    };
    let half = |_| ((place() - place()).norm() / BALL).sqrt();
    let mut halves: Vec<f64> = (0..4000).map(half).collect();
    halves.sort_by(f64::total_cmp);
    let middle = |part: usize| halves[halves.len() * (2 * part + 1) / (2 * LENGTHS)];
    (0..LENGTHS).map(middle).collect()
}

/// Where the ball is on a jump, m.
fn ball(half: f64, at: f64) -> f64 {
    let way = BALL * half * half;
    match at {
        at if at < half => 0.5 * BALL * at * at,
        at if at < 2.0 * half => way - 0.5 * BALL * (2.0 * half - at).powi(2),
        _ => way,
    }
}

/// From a change of the ball's acceleration, m/s^2, to the first picture that shows it, s: the mean over all moments between pictures.
fn shown_after(change: f64) -> f64 {
    (2.0 * 2.0 * SIGMA / change).sqrt() + 0.5 * PICTURE
}

/// No hand with such an acceleration, m/s^2, that is told of pictures so late, s, has a smaller root mean square of its distance, m.
pub fn least_rms(hand: f64, latency: f64) -> f64 {
    let begins_late = latency + SERVO + shown_after(BALL);
    let brakes_late = latency + SERVO + shown_after(2.0 * BALL);
    let halves = halves();
    let last = halves.iter().copied().fold(0.0, f64::max);
    let steps = ((2.0 * last + STOP) / STEP).ceil() as usize;
    let at = |step: usize| (step as f64 + 1.0) * STEP;
    // Which unknown is the acceleration of a jump in a step; it is the same one for all jumps that still look alike.
    let mut unknowns = 0;
    let mut which = vec![Vec::new(); LENGTHS];
    for step in 0..steps {
        // Steps are rounded in favour of the hand.
        let alike = |half: f64| at(step) <= half + brakes_late;
        let shared = unknowns;
        unknowns += usize::from(halves.iter().any(|half| alike(*half)));
        for (own, half) in which.iter_mut().zip(&halves) {
            own.push(if alike(*half) { shared } else { unknowns });
            unknowns += usize::from(!alike(*half));
        }
    }
    let still = (begins_late / STEP) as usize;
    let mut rows = Vec::new();
    for (own, half) in which.iter().zip(&halves) {
        for step in 0..((2.0 * half + STOP) / STEP) as usize {
            let mut row = DVector::zeros(unknowns);
            for (before, unknown) in own.iter().enumerate().take(step + 1).skip(still) {
                row[*unknown] += ((step - before) as f64 + 0.5) * STEP * STEP;
            }
            rows.push((row, ball(*half, at(step))));
        }
    }
    let moves = DMatrix::from_fn(rows.len(), unknowns, |row, column| rows[row].0[column]);
    let balls = DVector::from_fn(rows.len(), |row, _| rows[row].1);
    let square = least_square(&moves, &balls, hand);
    (square / rows.len() as f64).sqrt()
}

/// A number that the least `|M a - b|^2` with `|a_i| <= most` is not below, and is close to: by accelerated projected gradients
/// (A. Beck and M. Teboulle, 2009), less their gap of duality.
fn least_square(moves: &DMatrix<f64>, balls: &DVector<f64>, most: f64) -> f64 {
    let (square, cross) = (moves.transpose() * moves, moves.transpose() * balls);
    let rate = 1.0
        / square
            .row_iter()
            .map(|row| row.abs().sum())
            .fold(0.0, f64::max);
    let mut now = DVector::zeros(cross.len());
    let (mut ahead, mut momentum) = (now.clone(), 1.0_f64);
    for _ in 0..3000 {
        let gradient = &square * &ahead - &cross;
        let next = (&ahead - gradient * rate).map(|a: f64| a.clamp(-most, most));
        let grown = 0.5 * (1.0 + (1.0 + 4.0 * momentum * momentum).sqrt());
        ahead = &next + (&next - &now) * ((momentum - 1.0) / grown);
        (now, momentum) = (next, grown);
    }
    let gradient = (&square * &now - &cross) * 2.0;
    // The square lies above its tangent plane, and that is lowest in a corner.
    let gap = gradient.dot(&now) + most * gradient.abs().sum();
    (moves * &now - balls).norm_squared() - gap
}
