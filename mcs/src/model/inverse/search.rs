//! Inverse kinematics of any chain, by damped least squares (Y. Nakamura and H. Hanafusa, ASME J. DSMC 108, 1986) with
//! the damping of T. Sugihara (IEEE Trans. Robotics 27(5), 2011).
//!
//! Joints that would leave their limits stay on them while the others go on. What a redundant arm is free to do goes
//! along the gradient of its preferences (A. Liegeois, IEEE Trans. SMC 7(12), 1977). A search that sticks begins anew
//! elsewhere, always at the same places.

use nalgebra::{Matrix6, Rotation3, UnitQuaternion, Vector6};

use super::error::IkError;
use crate::model::data::Data;
use crate::model::features::{FrameId, JointKind, Limits, Model};
use crate::model::placement::Placement;

/// A pose is reached when it is off by no more than this, m and rad together.
const REACHED: f64 = 1e-11;
/// So much is still good when the search does not come nearer, as at a singular pose.
const GOOD: f64 = 1e-9;
/// Steps of a search from one start.
const STEPS: usize = 250;
/// The first of them follow the preferences, too.
const PREFERRING: usize = 40;
/// Starts of a search, the given one among them.
const STARTS: usize = 60;
/// The longest step of a joint, rad or m.
const LONGEST: f64 = 0.5;
/// The longest step for the preferences.
const GENTLE: f64 = 0.05;
/// Damping that stays when the error is gone.
const LEAST_DAMPING: f64 = 1e-14;
/// Step of the differences that give the manipulability's gradient, rad or m.
const DIFFERENCE: f64 = 1e-5;

/// What a redundant arm does with its freedom: weights of the gradients.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Preferences {
    /// Of staying away from the limits: each joint to the middle of its range, as part of the range.
    pub limits: f64,
    /// Of staying near the start, per rad or m.
    pub posture: f64,
    /// Of manipulability, the root of det(J J^T) (T. Yoshikawa, Int. J. Robotics Research 4(2), 1985): its growth.
    pub manipulability: f64,
}

impl Default for Preferences {
    fn default() -> Self {
        Self {
            limits: 0.1,
            posture: 0.02,
            manipulability: 0.05,
        }
    }
}

/// Finds joint positions for one frame of a model. All that it writes is allocated with it.
#[derive(Debug, Clone)]
pub struct Search {
    frame: FrameId,
    chain: Vec<usize>,
    limits: Vec<Limits>,
    preferences: Preferences,
    data: Data,
    q: Vec<f64>,
    next: Vec<f64>,
    wish: Vec<f64>,
    free: Vec<bool>,
}

/// How far a pose is from the goal: m, then rad about the axes of the base frame.
fn error(goal: &Placement, there: &Placement) -> Vector6<f64> {
    let turn = Rotation3::from_matrix_unchecked(goal.rotation * there.rotation.transpose());
    // The quaternion keeps the axis of half a turn.
    let turn = UnitQuaternion::from_rotation_matrix(&turn).scaled_axis();
    let way = goal.origin - there.origin;
    Vector6::new(way.x, way.y, way.z, turn.x, turn.y, turn.z)
}

impl Search {
    /// A search for positions of the joints that carry `frame`, within their limits or, without `limits`, anywhere.
    #[must_use]
    pub fn new(model: &Model, frame: FrameId, limits: bool, preferences: Preferences) -> Self {
        let n = model.dof();
        let bounds = model
            .joints()
            .iter()
            .map(|joint| if limits { joint.limits } else { Limits::NONE });
        Self {
            frame,
            chain: model.chain(frame),
            limits: bounds.collect(),
            preferences,
            data: model.data(),
            q: vec![0.0; n],
            next: vec![0.0; n],
            wish: vec![0.0; n],
            free: vec![true; n],
        }
    }

    /// Joint positions near `start` that put the frame at `goal`. Joints that do not carry the frame stay at the start, and
    /// a start beyond a limit counts as on it. A number that is missing in `start` counts as 0.
    ///
    /// # Errors
    /// [`IkError::NotFinite`], [`IkError::TooFar`], or [`IkError::NotFound`] with how near the search came.
    pub fn solve(
        &mut self,
        model: &Model,
        goal: &Placement,
        start: &[f64],
    ) -> Result<&[f64], IkError> {
        if !goal.is_finite() || start.iter().any(|position| !position.is_finite()) {
            return Err(IkError::NotFinite);
        }
        for (index, q) in self.q.iter_mut().enumerate() {
            *q = start.get(index).copied().unwrap_or_default();
        }
        self.within_reach(model, goal)?;
        let mut nearest = Vector6::repeat(f64::INFINITY);
        for attempt in 0..STARTS {
            self.begin(start, attempt);
            let off = self.descend(model, goal, start);
            if off.norm() <= GOOD {
                return Ok(&self.q);
            }
            if off.norm() < nearest.norm() {
                nearest = off;
            }
            if self.chain.is_empty() {
                break;
            }
        }
        Err(IkError::NotFound {
            starts: STARTS,
            distance: nearest.fixed_rows::<3>(0).norm(),
            angle: nearest.fixed_rows::<3>(3).norm(),
        })
    }

    /// Nothing is farther away than all links and slides together are long.
    fn within_reach(&mut self, model: &Model, goal: &Placement) -> Result<(), IkError> {
        let Some(&first) = self.chain.first() else {
            return Ok(());
        };
        model.forward(&mut self.data, &self.q);
        let joints = model.joints();
        let mut farthest = model.at(self.frame).placement.origin.norm();
        for &index in &self.chain {
            if index != first {
                farthest += joints[index].placement.origin.norm();
            }
            if joints[index].kind == JointKind::Prismatic {
                let limits = &self.limits[index];
                farthest += limits.lower.abs().max(limits.upper.abs());
            }
        }
        // A first joint that slides has moved its frame; its own place at 0 is what counts.
        let distance = (goal.origin - joints[first].placement.origin).norm();
        if distance > farthest + GOOD {
            return Err(IkError::TooFar { distance, farthest });
        }
        Ok(())
    }

    /// Sets the joints of the chain to where an attempt begins: the start, then places spread evenly over the ranges
    /// by the additive recurrence of the generalised golden ratio.
    fn begin(&mut self, start: &[f64], attempt: usize) {
        let golden = golden(self.chain.len());
        let mut step = 1.0;
        for &index in &self.chain {
            step /= golden;
            let limits = &self.limits[index];
            let from = start.get(index).copied().unwrap_or_default();
            let at = if attempt == 0 {
                from
            } else {
                let share = (0.5 + attempt as f64 * step).fract();
                let lower = limits.lower.max(from - std::f64::consts::PI);
                let upper = limits.upper.min(from + std::f64::consts::PI);
                if limits.upper - limits.lower < std::f64::consts::TAU {
                    limits.lower + share * (limits.upper - limits.lower)
                } else {
                    lower + share * (upper - lower)
                }
            };
            self.q[index] = at.clamp(limits.lower, limits.upper);
        }
    }

    /// Goes to the goal from where the joints are, and says how far off the end is.
    fn descend(&mut self, model: &Model, goal: &Placement, start: &[f64]) -> Vector6<f64> {
        let mut off = Vector6::repeat(f64::INFINITY);
        for step in 0..STEPS {
            model.forward(&mut self.data, &self.q);
            let there = self.data.placement(model, self.frame);
            off = error(goal, &there);
            let prefers = step < PREFERRING && self.chain.len() > 6;
            if off.norm() <= REACHED && !prefers {
                break;
            }
            self.wish.fill(0.0);
            if prefers {
                self.wishes(model, start);
                model.forward(&mut self.data, &self.q);
            }
            model.jacobian_there(&mut self.data, self.frame, &there.origin);
            if !self.step(&off) {
                break;
            }
        }
        off
    }

    /// The gradient of the preferences at the present positions.
    fn wishes(&mut self, model: &Model, start: &[f64]) {
        let Preferences {
            limits,
            posture,
            manipulability,
        } = self.preferences;
        let here = self.manipulability(model);
        for position in 0..self.chain.len() {
            let index = self.chain[position];
            let (q, bounds) = (self.q[index], &self.limits[index]);
            let range = bounds.upper - bounds.lower;
            let mut wish = posture * (start.get(index).copied().unwrap_or_default() - q);
            if range.is_finite() && range > 0.0 {
                wish += limits * (0.5 * (bounds.lower + bounds.upper) - q) / range;
            }
            if manipulability != 0.0 && here > 0.0 {
                self.q[index] = q + DIFFERENCE;
                wish += manipulability * (self.manipulability(model) / here - 1.0) / DIFFERENCE;
                self.q[index] = q;
            }
            self.wish[index] = wish;
        }
        let largest = self
            .wish
            .iter()
            .fold(0.0_f64, |most, wish| most.max(wish.abs()));
        if largest > GENTLE {
            for wish in &mut self.wish {
                *wish *= GENTLE / largest;
            }
        }
    }

    fn manipulability(&mut self, model: &Model) -> f64 {
        let jacobian = model.jacobian(&mut self.data, &self.q, self.frame);
        let mut square = Matrix6::zeros();
        for &index in &self.chain {
            let column = jacobian.fixed_columns::<1>(index);
            let column = column.fixed_rows::<6>(0).into_owned();
            square += column * column.transpose();
        }
        square.determinant().max(0.0).sqrt()
    }

    /// One damped step, with the joints that it would take beyond their limits left on them. Whether anything moved.
    fn step(&mut self, off: &Vector6<f64>) -> bool {
        for &index in &self.chain {
            self.free[index] = true;
        }
        let damping = 0.5 * off.norm_squared() * 1e-2 + LEAST_DAMPING;
        // Each round holds at least one joint more.
        for _ in 0..=self.chain.len() {
            let mut square = Matrix6::from_diagonal_element(damping);
            let mut wished = Vector6::zeros();
            for &index in self.chain.iter().filter(|index| self.free[**index]) {
                let column = self.data.jacobian.fixed_view::<6, 1>(0, index).into_owned();
                square += column * column.transpose();
                wished += column * self.wish[index];
            }
            let Some(solved) = square.cholesky() else {
                return false;
            };
            // What the wishes do to the pose is taken back.
            let pull = solved.solve(&(off - wished));
            let mut longest = 0.0_f64;
            for &index in &self.chain {
                self.next[index] = 0.0;
                if self.free[index] {
                    let column = self.data.jacobian.fixed_view::<6, 1>(0, index);
                    self.next[index] = column.dot(&pull) + self.wish[index];
                    longest = longest.max(self.next[index].abs());
                }
            }
            let scale = if longest > LONGEST {
                LONGEST / longest
            } else {
                1.0
            };
            let mut held = false;
            for &index in &self.chain {
                let limits = &self.limits[index];
                let (q, by) = (self.q[index], self.next[index]);
                let outward = (q <= limits.lower && by < 0.0) || (q >= limits.upper && by > 0.0);
                if self.free[index] && outward {
                    self.free[index] = false;
                    held = true;
                }
            }
            if held {
                continue;
            }
            let mut moved = false;
            for &index in &self.chain {
                let limits = &self.limits[index];
                let q =
                    (self.q[index] + scale * self.next[index]).clamp(limits.lower, limits.upper);
                moved |= q != self.q[index];
                self.q[index] = q;
            }
            return moved;
        }
        false
    }
}

/// The positive root of x^(n+1) = x + 1.
fn golden(n: usize) -> f64 {
    let power = 1.0 / (n as f64 + 1.0);
    (0..40).fold(2.0, |x: f64, _| (x + 1.0).powf(power))
}
