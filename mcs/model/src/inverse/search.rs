//! Inverse kinematics of any chain, by damped least squares (Y. Nakamura and H. Hanafusa, ASME J. DSMC 108, 1986) with
//! the damping of T. Sugihara (IEEE Trans. Robotics 27(5), 2011).
//!
//! Joints that would leave their limits stay on them while the others go on. What a redundant arm is free to do goes
//! along the gradient of its preferences (A. Liegeois, IEEE Trans. SMC 7(12), 1977). A search that sticks begins anew
//! elsewhere, always at the same places.

use nalgebra::{Cholesky, Matrix6, Rotation3, U6, UnitQuaternion, Vector6};

use super::error::IkError;
use crate::data::Data;
use crate::features::{FrameId, JointKind, Limits, Model};
use crate::placement::Placement;

/// A pose is reached when it is off by no more than this, m and rad together.
const REACHED: f64 = 1e-11;
/// So much is still good when the search does not come nearer, as at a singular pose.
const GOOD: f64 = 1e-9;
/// Steps of a search from one start.
const STEPS: usize = 250;
/// The first of them follow the preferences, too.
const PREFERRING: usize = 40;
/// Steps of following a path, from one of its poses to the next.
const FOLLOWING: usize = 30;
/// A joint on its limit is held when it would go beyond by more than this, rad or m: less is rounding.
const OUTWARD: f64 = 1e-9;
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
        self.set(start);
        self.within_reach(model, goal)?;
        let mut nearest = Vector6::repeat(f64::INFINITY);
        for attempt in 0..STARTS {
            self.begin(start, attempt);
            let off = self.descend(model, goal, start, (STEPS, PREFERRING));
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

    /// Joint positions that put the frame at `goal`, next to `start`: for following a path. Nothing else is tried, and
    /// preferences do not count: of all ways the one that moves the joints least, 1 rad as much as 1 m.
    ///
    /// # Errors
    /// [`IkError::NotFinite`], or [`IkError::NotFound`] with how near it came.
    pub fn follow(
        &mut self,
        model: &Model,
        goal: &Placement,
        start: &[f64],
    ) -> Result<&[f64], IkError> {
        if !goal.is_finite() || start.iter().any(|position| !position.is_finite()) {
            return Err(IkError::NotFinite);
        }
        self.set(start);
        self.begin(start, 0);
        let off = self.descend(model, goal, start, (FOLLOWING, 0));
        if off.norm() <= GOOD {
            return Ok(&self.q);
        }
        Err(IkError::NotFound {
            starts: 1,
            distance: off.fixed_rows::<3>(0).norm(),
            angle: off.fixed_rows::<3>(3).norm(),
        })
    }

    /// Joint speeds and accelerations at positions `q` that move the frame with `velocity` (m/s, then rad/s) and
    /// `acceleration` (m/s^2, rad/s^2), both in the base frame: the smallest ones. A joint on a limit that they would push
    /// stays. They go to `speeds` and `rates`; joints that do not carry the frame get zero.
    ///
    /// # Errors
    /// `None` at a singular pose.
    pub fn rates(
        &mut self,
        model: &Model,
        q: &[f64],
        (velocity, acceleration): (&Vector6<f64>, &Vector6<f64>),
        (speeds, rates): (&mut [f64], &mut [f64]),
    ) -> Option<()> {
        self.set(q);
        self.wish.fill(0.0);
        model.jacobian(&mut self.data, q, self.frame);
        let solved = self.direction(velocity, 0.0)?;
        speeds.fill(0.0);
        rates.fill(0.0);
        for &index in &self.chain {
            *speeds.get_mut(index)? = self.next[index];
        }
        let bias = model.bias_acceleration(&mut self.data, q, speeds, self.frame);
        let pull = solved.solve(&(acceleration - bias));
        for &index in self.chain.iter().filter(|index| self.free[**index]) {
            let column = self.data.jacobian.fixed_view::<6, 1>(0, index);
            *rates.get_mut(index)? = column.dot(&pull);
        }
        let all = speeds.iter().chain(rates.iter());
        all.clone().all(|number| number.is_finite()).then_some(())
    }

    fn set(&mut self, positions: &[f64]) {
        for (index, q) in self.q.iter_mut().enumerate() {
            *q = positions.get(index).copied().unwrap_or_default();
        }
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

    /// Goes to the goal from where the joints are, in at most so many steps, the first of which follow the preferences,
    /// too; and says how far off the end is.
    fn descend(
        &mut self,
        model: &Model,
        goal: &Placement,
        start: &[f64],
        (steps, preferring): (usize, usize),
    ) -> Vector6<f64> {
        let mut off = Vector6::repeat(f64::INFINITY);
        for step in 0..steps {
            model.forward(&mut self.data, &self.q);
            let there = self.data.placement(model, self.frame);
            off = error(goal, &there);
            let prefers = step < preferring && self.chain.len() > 6;
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

    /// One damped step. Whether anything moved.
    fn step(&mut self, off: &Vector6<f64>) -> bool {
        let damping = 0.5 * off.norm_squared() * 1e-2 + LEAST_DAMPING;
        if self.direction(off, damping).is_none() {
            return false;
        }
        let size = |most: f64, &index: &usize| most.max(self.next[index].abs());
        let longest = self.chain.iter().fold(0.0_f64, size);
        let scale = if longest > LONGEST {
            LONGEST / longest
        } else {
            1.0
        };
        let mut moved = false;
        for &index in &self.chain {
            let limits = &self.limits[index];
            let q = (self.q[index] + scale * self.next[index]).clamp(limits.lower, limits.upper);
            moved |= q != self.q[index];
            self.q[index] = q;
        }
        moved
    }

    /// Sets `next` to the changes of the joints that move the frame by `off`, for the last Jacobian, with the joints that
    /// they would take beyond their limits left on them. What solved for them, unless the pose is singular.
    fn direction(&mut self, off: &Vector6<f64>, damping: f64) -> Option<Cholesky<f64, U6>> {
        for &index in &self.chain {
            self.free[index] = true;
        }
        // Each round holds at least one joint more.
        for _ in 0..=self.chain.len() {
            let mut square = Matrix6::from_diagonal_element(damping);
            let mut wished = Vector6::zeros();
            for &index in self.chain.iter().filter(|index| self.free[**index]) {
                let column = self.data.jacobian.fixed_view::<6, 1>(0, index).into_owned();
                square += column * column.transpose();
                wished += column * self.wish[index];
            }
            let solved = square.cholesky()?;
            // What the wishes do to the pose is taken back.
            let pull = solved.solve(&(off - wished));
            let mut held = false;
            for &index in &self.chain {
                self.next[index] = 0.0;
                if self.free[index] {
                    let column = self.data.jacobian.fixed_view::<6, 1>(0, index);
                    self.next[index] = column.dot(&pull) + self.wish[index];
                }
                let limits = &self.limits[index];
                let (q, by) = (self.q[index], self.next[index]);
                if (q <= limits.lower && by < -OUTWARD) || (q >= limits.upper && by > OUTWARD) {
                    self.free[index] = false;
                    held = true;
                }
            }
            if !held {
                return Some(solved);
            }
        }
        None
    }
}

/// The positive root of x^(n+1) = x + 1.
fn golden(n: usize) -> f64 {
    let power = 1.0 / (n as f64 + 1.0);
    (0..40).fold(2.0, |x: f64, _| (x + 1.0).powf(power))
}
