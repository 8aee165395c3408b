//! How well the hand followed: what druide did against where the ball truly was. Knows no tasks.
//!
//! The hand should be as far from the ball as it was while the map was learned: at the beginning, with the ball at home. All places
//! are m in the arm's base frame, which is the world's here, and all times s of druide's clock.

use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion, Vector3};

use crate::{
    control::{Counts, Phase},
    history::History,
    wire::{ClockTruth, CourseRecord},
};

/// Places of the ball are remembered for so long, s.
const REMEMBERED: f64 = 6.0;

/// What is held against the truth begins so long after the ball is first followed, s.
const SETTLED: f64 = 2.0;

/// Distances are counted in steps of this, m, up to so many of them.
const STEP: f64 = 0.000_1;
const STEPS: usize = 5000;

/// Root mean square and 95th percentile of distances, m. What is kept does not grow.
#[derive(Debug, Clone)]
struct Errors {
    steps: Vec<u64>,
    count: u64,
    sum: f64,
    largest: f64,
    last: f64,
}

impl Default for Errors {
    fn default() -> Self {
        Self {
            steps: vec![0; STEPS],
            count: 0,
            sum: 0.0,
            largest: 0.0,
            last: 0.0,
        }
    }
}

impl Errors {
    fn add(&mut self, error: f64) {
        let step = ((error / STEP) as usize).min(STEPS - 1);
        if let Some(count) = self.steps.get_mut(step) {
            *count += 1;
        }
        self.count += 1;
        self.sum += error * error;
        self.largest = self.largest.max(error);
        self.last = error;
    }

    fn rms(&self) -> f64 {
        (self.sum / self.count.max(1) as f64).sqrt()
    }

    /// What so large a part of them is not above, to a step.
    fn part(&self, part: f64) -> f64 {
        let wanted = (self.count as f64 * part).ceil();
        let mut below = 0;
        let found = self.steps.iter().position(|count| {
            below += count;
            below as f64 >= wanted
        });
        found.map_or(0.0, |step| ((step + 1) as f64 * STEP).min(self.largest))
    }
}

/// What came out.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Verdict {
    /// How long was judged, s.
    pub seconds: f64,
    /// The part of it during which the ball was followed.
    pub tracked: f64,
    /// Following error of the hand: root mean square, m.
    pub rms_m: f64,
    /// Its 95th percentile, m.
    pub p95_m: f64,
    /// The largest of it, m.
    pub max_error_m: f64,
    /// How far the hand is from where it should be at the end, m.
    pub last_error_m: f64,
    /// Error of the estimate of where the ball is now: root mean square, m.
    pub estimate_rms_m: f64,
    /// Its mean, m along the axes.
    pub estimate_mean_m: [f64; 3],
    /// Distance of the hand from where it was sent: root mean square, m.
    pub servo_rms_m: f64,
    /// From a picture's exposure to the first setpoint that knows of it: median, s.
    pub setpoint_median_s: f64,
    /// Its 99th percentile, s.
    pub setpoint_p99_s: f64,
    /// The part of it that is our own work: from when the camera had given the picture. Median, s.
    pub own_median_s: f64,
    /// Its 99th percentile, s.
    pub own_p99_s: f64,
    /// Largest force at the wrist, N.
    pub max_force_n: f64,
    /// Largest change of the commanded velocity, as a part of what the limit allows.
    pub max_acceleration_ratio: f64,
    /// The same from the velocities themselves, when none is missing between.
    pub max_step_m_s: f64,
    /// Largest error of the difference of the clocks, s.
    pub clock_error_s: f64,
    /// The largest bound of it that was told, s.
    pub clock_bound_s: f64,
    /// Whether the error was within its bound all the time.
    pub clock_within: bool,
}

/// Holds records against the truth.
#[derive(Debug, Clone)]
pub struct Judge {
    ball: History,
    /// From the ball to where the hand should be.
    offset: Option<Vector3<f64>>,
    clocks: Option<(ClockTruth, ClockTruth)>,
    began: Option<f64>,
    following: Errors,
    estimate: Errors,
    means: Vector3<f64>,
    servo: Errors,
    /// Seconds from exposures to setpoints.
    setpoints: Errors,
    /// The part of them that is our own work.
    own: Errors,
    force: f64,
    ratio: f64,
    step: f64,
    last: Option<CourseRecord>,
    clock_error: f64,
    clock_bound: f64,
    clock_within: bool,
    judged: u64,
    tracked: u64,
    first: Option<f64>,
}

impl Judge {
    /// That has seen nothing yet.
    #[must_use]
    pub fn new() -> Self {
        Self {
            ball: History::new(REMEMBERED),
            offset: None,
            clocks: None,
            began: None,
            following: Errors::default(),
            estimate: Errors::default(),
            means: Vector3::zeros(),
            servo: Errors::default(),
            setpoints: Errors::default(),
            own: Errors::default(),
            force: 0.0,
            ratio: 0.0,
            step: 0.0,
            last: None,
            clock_error: 0.0,
            clock_bound: 0.0,
            clock_within: true,
            judged: 0,
            tracked: 0,
            first: None,
        }
    }

    /// How wrong the clocks of druide and of argus truly are.
    pub fn know_clocks(&mut self, druide: ClockTruth, argus: ClockTruth) {
        self.clocks = Some((druide, argus));
    }

    /// Where the ball was at a moment.
    pub fn ball(&mut self, at: f64, place: Point3<f64>) {
        let pose =
            Isometry3::from_parts(Translation3::from(place.coords), UnitQuaternion::identity());
        self.ball.note(at, pose);
    }

    fn truth(&self, at: f64) -> Option<Point3<f64>> {
        let place = self.ball.at(at)?.translation.vector;
        Some(Point3::from(place + self.offset?))
    }

    /// What druide did in a period.
    pub fn course(&mut self, record: &CourseRecord) {
        if self.offset.is_none()
            && let Some(ball) = self.ball.at(record.tool_at)
        {
            self.offset = Some(record.tool.coords - ball.translation.vector);
        }
        self.force = self.force.max(record.force);
        self.ratio = self.ratio.max(record.ratio);
        if let Some(last) = &self.last
            && record.now - last.now < 0.02
            && last.phase != Phase::Stopped
            && record.phase != Phase::Stopped
        {
            self.step = self.step.max((record.velocity - last.velocity).norm());
        }
        // A younger picture than the one before is one that has just come.
        if let Some(last) = &self.last
            && last.phase == Phase::Track
            && record.phase == Phase::Track
            && record.age < last.age
        {
            self.setpoints.add(record.age);
            self.own.add(record.own);
        }
        self.last = Some(*record);
        if let (Some((druide, argus)), false) = (&self.clocks, record.clock.is_nan()) {
            let error = (record.clock - druide.ahead_of_this(argus, record.now)).abs();
            self.clock_error = self.clock_error.max(error);
            self.clock_bound = self.clock_bound.max(record.clock_bound);
            self.clock_within &= error <= record.clock_bound + 1e-9;
        }
        if record.phase == Phase::Track {
            self.began.get_or_insert(record.now);
        }
        if self.began.is_none_or(|began| record.now < began + SETTLED) {
            return;
        }
        self.first.get_or_insert(record.now);
        self.judged += 1;
        if record.phase != Phase::Track {
            return;
        }
        self.tracked += 1;
        if let Some(truth) = self.truth(record.tool_at) {
            self.following.add((record.tool - truth).norm());
        }
        if let (Some(truth), Some(target)) = (self.truth(record.now), record.target) {
            self.estimate.add((target - truth).norm());
            self.means += target - truth;
        }
        self.servo.add((record.tool - record.place).norm());
    }

    /// What came out.
    #[must_use]
    pub fn verdict(&self) -> Verdict {
        let span = self.last.as_ref().zip(self.first);
        let means = self.means / self.estimate.count.max(1) as f64;
        Verdict {
            seconds: span.map_or(0.0, |(last, first)| last.now - first),
            tracked: self.tracked as f64 / self.judged.max(1) as f64,
            rms_m: self.following.rms(),
            p95_m: self.following.part(0.95),
            max_error_m: self.following.largest,
            last_error_m: self.following.last,
            estimate_rms_m: self.estimate.rms(),
            estimate_mean_m: means.into(),
            servo_rms_m: self.servo.rms(),
            setpoint_median_s: self.setpoints.part(0.5),
            setpoint_p99_s: self.setpoints.part(0.99),
            own_median_s: self.own.part(0.5),
            own_p99_s: self.own.part(0.99),
            max_force_n: self.force,
            max_acceleration_ratio: self.ratio,
            max_step_m_s: self.step,
            clock_error_s: self.clock_error,
            clock_bound_s: self.clock_bound,
            clock_within: self.clock_within,
        }
    }
}

impl Default for Judge {
    fn default() -> Self {
        Self::new()
    }
}

/// What came out, as lines for people.
#[must_use]
pub fn lines(verdict: &Verdict, counts: &Counts) -> String {
    let mm = 1e3;
    let rows = [
        (
            "judged",
            format!(
                "{:.1} s, of which {:.1} % followed",
                verdict.seconds,
                100.0 * verdict.tracked
            ),
        ),
        (
            "following error",
            format!(
                "{:.2} mm rms, {:.2} mm at 95 %",
                verdict.rms_m * mm,
                verdict.p95_m * mm
            ),
        ),
        (
            "estimate",
            format!("{:.2} mm rms", verdict.estimate_rms_m * mm),
        ),
        (
            "servo",
            format!(
                "{:.2} mm rms from where it was sent",
                verdict.servo_rms_m * mm
            ),
        ),
        (
            "exposure",
            format!(
                "to setpoint {:.1} ms, {:.1} ms at 99 %",
                verdict.setpoint_median_s * 1e3,
                verdict.setpoint_p99_s * 1e3
            ),
        ),
        (
            "own work",
            format!(
                "{:.1} ms of it, {:.1} ms at 99 %: from when the camera gave the picture",
                verdict.own_median_s * 1e3,
                verdict.own_p99_s * 1e3
            ),
        ),
        ("force", format!("{:.1} N at most", verdict.max_force_n)),
        (
            "acceleration",
            format!("{:.3} of its limit at most", verdict.max_acceleration_ratio),
        ),
        (
            "clocks",
            format!(
                "{:.1} us off at most, known within {:.1} us",
                verdict.clock_error_s * 1e6,
                verdict.clock_bound_s * 1e6
            ),
        ),
        (
            "pictures",
            format!(
                "{} used, {} late, {} far off",
                counts.used, counts.late, counts.far
            ),
        ),
        (
            "ball",
            format!(
                "lost {} times, expired {} times",
                counts.lost, counts.expired
            ),
        ),
    ];
    let mut text = String::new();
    for (name, value) in rows {
        text += &format!("{name:>16}  {value}\n");
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    fn record(now: f64, x: f64) -> CourseRecord {
        let tool = Point3::new(x, 0.0, 0.0);
        CourseRecord {
            now,
            place: tool,
            velocity: Vector3::zeros(),
            target: Some(tool + Vector3::new(0.0, 0.001, 0.0)),
            age: 0.0,
            own: 0.0,
            phase: Phase::Track,
            tool,
            tool_at: now,
            force: 1.0,
            ratio: 0.5,
            clock: 2.0,
            clock_bound: 1e-3,
        }
    }

    #[test]
    fn errors_are_those_to_where_the_hand_should_be() {
        let mut judge = Judge::new();
        let ahead = ClockTruth {
            ahead_s: 2.000_5,
            rate: 0.0,
        };
        judge.know_clocks(ClockTruth::default(), ahead);
        for step in 0..2000 {
            let now = f64::from(step) * 0.0045;
            let ball = 0.1 * now;
            judge.ball(now, Point3::new(0.5 + ball, 0.0, 0.0));
            // 2 mm behind from the beginning of the motion on.
            let behind = if step < 10 { 0.0 } else { 0.002 };
            judge.course(&record(now, ball - behind));
        }
        let found = judge.verdict();
        assert!((found.rms_m - 0.002).abs() < 1e-6 && (found.p95_m - 0.002).abs() < 1.01e-4);
        assert!((found.estimate_rms_m - 0.002_f64.hypot(0.001)).abs() < 1e-6);
        assert!((found.clock_error_s - 0.000_5).abs() < 1e-9 && found.clock_within);
        assert!((found.tracked - 1.0).abs() < 1e-9 && found.seconds > 6.9);
        assert_eq!(
            (found.max_force_n, found.max_acceleration_ratio),
            (1.0, 0.5)
        );
        assert!(!lines(&found, &Counts::default()).is_empty());
    }

    #[test]
    fn percentiles_forces_and_times_are_those_of_all_records() {
        let mut judge = Judge::new();
        let (mut errors, mut ages) = (Vec::new(), Vec::new());
        for step in 0..3000_u32 {
            let now = f64::from(step) * 0.0045;
            judge.ball(now, Point3::new(0.5, 0.0, 0.0));
            // Far at times, and a picture every ninth period, each after another time.
            let wrong = if step < 10 {
                0.0
            } else {
                f64::from(step * 7919 % 1000) * 1e-5
            };
            let age = 0.01 + f64::from(step / 9 * 31 % 100) * 1e-4 + f64::from(step % 9) * 0.0045;
            let mut record = CourseRecord {
                age,
                own: age - 0.008,
                ..record(now, wrong)
            };
            record.force = if step == 1500 { 7.5 } else { 0.5 };
            record.clock_bound = if step == 9 { 2e-3 } else { 1e-3 };
            judge.course(&record);
            if now >= SETTLED {
                errors.push(wrong);
            }
            if step > 0 && step % 9 == 0 {
                ages.push(age);
            }
        }
        let part = |mut all: Vec<f64>, part: f64| {
            all.sort_by(f64::total_cmp);
            all[(all.len() as f64 * part).ceil() as usize - 1]
        };
        judge.know_clocks(ClockTruth::default(), ClockTruth::default());
        let last = CourseRecord {
            age: 9.0,
            ..record(13.5, 0.0)
        };
        judge.course(&last);
        let found = judge.verdict();
        assert!(
            (found.p95_m - part(errors, 0.95)).abs() < 1.01 * STEP,
            "{found:?}"
        );
        assert!((found.setpoint_median_s - part(ages.clone(), 0.5)).abs() < 1.01 * STEP);
        assert!((found.setpoint_p99_s - part(ages.clone(), 0.99)).abs() < 1.01 * STEP);
        assert!((found.own_median_s - part(ages.clone(), 0.5) + 0.008).abs() < 1.01 * STEP);
        assert!((found.own_p99_s - part(ages, 0.99) + 0.008).abs() < 1.01 * STEP);
        assert_eq!(found.max_force_n, 7.5);
        assert_eq!(found.clock_bound_s, 1e-3);
    }
}
