//! One arm as its drives, its brakes and what touches it move it.
//!
//! Smooth forces are integrated with the articulated bodies of `mcs_model` by the classical method of Runge and Kutta.
//! Dry friction, brakes and stops are impulses at the end of each step, as large as it takes to bring a joint to rest and
//! no larger than they can be: a joint that they hold does not creep (Gauss-Seidel with bounds, after J. J. Moreau).
//!
//! Units are those of the model; the base frame of the model is the world's. Knows no engine, no slot and no file.

use mcs_model::{Data, DynamicsOptions, FrameId, Limits, Model, Motor};
use nalgebra::{DMatrix, DVector, Isometry3, Point3, Vector3};

/// Braking force as a multiple of the largest of the drive.
const BRAKE_FACTOR: f64 = 1.5;

/// Sweeps over the joints in which the impulses of friction are found, and the change of a speed that ends them.
const SWEEPS: usize = 200;
const SPEED_TOLERANCE: f64 = 1e-13;

/// An arm that still things touch is given at most so many times what its links were.
const MOST_STOPPED: f64 = 50.0;

/// What touched an arm in a step.
#[derive(Debug, Clone)]
pub struct Touch {
    /// The impulse at each joint, N m s or N s.
    pub impulse: Vec<f64>,
    /// It moved the arm as this impulse times one second would.
    pub shift: Vec<f64>,
    /// What stopped the links never moves: the arm then stops as they did, though they weigh less than it.
    pub by_still: bool,
    /// The impulses on the links times the changes of their speeds, J.
    pub work: f64,
}

impl Touch {
    /// None yet, of an arm with so many joints.
    pub fn none(joints: usize) -> Self {
        Self {
            impulse: vec![0.0; joints],
            shift: vec![0.0; joints],
            by_still: true,
            work: 0.0,
        }
    }

    /// Both together, of which one is no wall that stops it.
    pub fn with(&self, other: &Self) -> Self {
        let sum = |own: &[f64], other: &[f64]| own.iter().zip(other).map(|(a, b)| a + b).collect();
        Self {
            impulse: sum(&self.impulse, &other.impulse),
            shift: sum(&self.shift, &other.shift),
            by_still: self.by_still && other.by_still,
            work: self.work + other.work,
        }
    }
}

/// The arm's state is no longer made of finite numbers.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Lost;

/// Positions and speeds of all joints.
#[derive(Debug, Clone, PartialEq)]
struct Motion {
    q: Vec<f64>,
    v: Vec<f64>,
}

/// An arm with its state.
#[derive(Debug, Clone)]
pub struct Arm {
    model: Model,
    data: Data,
    friction: bool,
    torques: Vec<f64>,
    /// What pulls at its links, N m or N.
    pulled: Vec<f64>,
    braked: Vec<bool>,
    /// At the beginning of the step.
    now: Motion,
    /// At its end, if there were neither dry friction nor anything that touches the arm.
    smooth: Motion,
    /// At its end.
    next: Motion,
    trial: Motion,
    drive: Vec<f64>,
    slopes: [Vec<f64>; 4],
}

impl Arm {
    /// An arm at rest at `start` with all brakes on.
    pub fn new(model: Model, start: &[f64], friction: bool) -> Self {
        let zero = vec![0.0; model.dof()];
        let now = Motion {
            q: start.to_vec(),
            v: zero.clone(),
        };
        Self {
            data: model.data(),
            friction,
            torques: zero.clone(),
            pulled: zero.clone(),
            braked: vec![true; model.dof()],
            smooth: now.clone(),
            next: now.clone(),
            trial: now.clone(),
            now,
            drive: zero.clone(),
            slopes: [zero.clone(), zero.clone(), zero.clone(), zero],
            model,
        }
    }

    pub fn model(&self) -> &Model {
        &self.model
    }

    /// Joint positions, rad or m.
    pub fn positions(&self) -> &[f64] {
        &self.now.q
    }

    /// Joint speeds, rad/s or m/s.
    pub fn velocities(&self) -> &[f64] {
        &self.now.v
    }

    /// Lets a joint be driven by `torque` (N m or N), or held by its brake when there is none.
    pub fn command(&mut self, joint: usize, torque: Option<f64>) {
        if let (Some(braked), Some(own)) = (self.braked.get_mut(joint), self.torques.get_mut(joint))
        {
            *braked = torque.is_none();
            *own = torque.unwrap_or(0.0);
        }
    }

    /// What pulls at its links until it is told otherwise, as a torque or a force of each joint (N m or N).
    pub fn pull(&mut self, pulled: Vec<f64>) {
        self.pulled = pulled;
    }

    /// Whether all brakes hold: nothing moves the arm then.
    pub fn is_held(&self) -> bool {
        self.braked.iter().all(|braked| *braked) && self.now.v.iter().all(|speed| *speed == 0.0)
    }

    /// Where it is after `h` seconds if it is touched as it is `expected` to be, or not at all.
    pub fn predict(&mut self, h: f64, expected: Option<&Touch>) -> Result<(), Lost> {
        if self.is_held() {
            self.smooth.clone_from(&self.now);
            self.next.clone_from(&self.now);
            return Ok(());
        }
        self.runge_kutta(h)?;
        self.settle(h, expected)
    }

    /// Where it is after `h` seconds if it is touched so; how many times what its links were given it took.
    pub fn push(&mut self, h: f64, touch: &mut Touch) -> Result<f64, Lost> {
        if self.is_held() {
            return Ok(1.0);
        }
        let mut taken = 1.0;
        if touch.by_still && touch.work > 0.0 {
            let inverse = self.inverse_mass_of_loose().ok_or(Lost)?;
            let impulse = DVector::from_column_slice(&touch.impulse);
            let gives = impulse.dot(&(inverse * &impulse));
            // Never less than it was given, nor without bound where it hardly gives way.
            let factor = (touch.work / gives).clamp(1.0, MOST_STOPPED);
            for number in touch.impulse.iter_mut().chain(&mut touch.shift) {
                *number *= factor;
            }
            taken = factor;
        }
        self.settle(h, Some(touch))?;
        Ok(taken)
    }

    /// The step is over.
    pub fn accept(&mut self) -> Result<(), Lost> {
        let mut numbers = self.next.q.iter().chain(&self.next.v);
        if !numbers.all(|number| number.is_finite()) {
            return Err(Lost);
        }
        self.now.clone_from(&self.next);
        Ok(())
    }

    /// Where a frame stands in the world at the beginning of the step.
    pub fn pose(&mut self, frame: FrameId) -> Isometry3<f64> {
        self.model
            .placement(&mut self.data, &self.now.q, frame)
            .isometry()
    }

    /// Linear and angular velocity (m/s, rad/s, world) of a point (m, world) that a frame carries, as the step will leave
    /// the joints' speeds.
    pub fn velocity(&mut self, frame: FrameId, point: &Point3<f64>) -> [Vector3<f64>; 2] {
        self.model.forward(&mut self.data, &self.now.q);
        let jacobian = self
            .model
            .jacobian_there(&mut self.data, frame, &point.coords);
        let speeds = jacobian * DVector::from_column_slice(&self.next.v);
        [
            speeds.fixed_rows::<3>(0).into_owned(),
            speeds.fixed_rows::<3>(3).into_owned(),
        ]
    }

    /// Adds to `joints` what an impulse at a point of a frame (N s, N m s, world) is at each joint.
    pub fn at_joints(
        &mut self,
        frame: FrameId,
        point: &Point3<f64>,
        [linear, angular]: [Vector3<f64>; 2],
        joints: &mut [f64],
    ) {
        self.model.forward(&mut self.data, &self.now.q);
        let jacobian = self
            .model
            .jacobian_there(&mut self.data, frame, &point.coords);
        for (column, joint) in jacobian.column_iter().zip(joints) {
            *joint +=
                column.fixed_rows::<3>(0).dot(&linear) + column.fixed_rows::<3>(3).dot(&angular);
        }
    }

    /// Least mass (kg) and inertia (kg m^2) with which a point of a frame resists, whatever the direction; infinite where
    /// the joints cannot move it.
    pub fn resistance(&mut self, frame: FrameId, point: &Point3<f64>) -> Option<[f64; 2]> {
        let inverse = self.inverse_mass_of_loose()?;
        let jacobian = self
            .model
            .jacobian_there(&mut self.data, frame, &point.coords);
        let mobility = jacobian * inverse * jacobian.transpose();
        let of = |row: usize| {
            let block = mobility.fixed_view::<3, 3>(row, row).into_owned();
            1.0 / block.symmetric_eigenvalues().max().max(0.0)
        };
        Some([of(0), of(3)])
    }

    /// Inverse of the mass matrix at the beginning of the step.
    fn inverse_mass(&mut self) -> Option<DMatrix<f64>> {
        let options = DynamicsOptions::WITH_ROTORS;
        let mass = self.model.mass_matrix(&mut self.data, &self.now.q, options);
        Some(mass.clone().cholesky()?.inverse())
    }

    /// [`Self::inverse_mass`] of an arm whose held joints are rigid.
    fn inverse_mass_of_loose(&mut self) -> Option<DMatrix<f64>> {
        let options = DynamicsOptions::WITH_ROTORS;
        let mut mass = self
            .model
            .mass_matrix(&mut self.data, &self.now.q, options)
            .clone();
        let held: Vec<bool> = (self.braked.iter().zip(&self.now.v))
            .map(|(braked, speed)| *braked && *speed == 0.0)
            .collect();
        let held = || (0..held.len()).filter(|joint| held[*joint]);
        for joint in held() {
            mass.row_mut(joint).fill(0.0);
            mass.column_mut(joint).fill(0.0);
            mass[(joint, joint)] = 1.0;
        }
        let mut inverse = mass.cholesky()?.inverse();
        held().for_each(|joint| inverse[(joint, joint)] = 0.0);
        Some(inverse)
    }

    /// One step under smooth forces alone.
    fn runge_kutta(&mut self, h: f64) -> Result<(), Lost> {
        self.trial.clone_from(&self.now);
        self.smooth.clone_from(&self.now);
        // Share of the step at which each slope is taken, and its weight.
        let stages = [
            (0.5, 1.0 / 6.0),
            (0.5, 1.0 / 3.0),
            (1.0, 1.0 / 3.0),
            (0.0, 1.0 / 6.0),
        ];
        for (stage, (ahead, weight)) in stages.into_iter().enumerate() {
            self.accelerate(stage)?;
            let slope = &self.slopes[stage];
            for (joint, rate) in slope.iter().enumerate() {
                let speed = self.trial.v[joint];
                self.smooth.q[joint] += h * weight * speed;
                self.smooth.v[joint] += h * weight * rate;
                self.trial.q[joint] = self.now.q[joint] + h * ahead * speed;
                self.trial.v[joint] = self.now.v[joint] + h * ahead * rate;
            }
        }
        Ok(())
    }

    /// Accelerations at the trial state.
    fn accelerate(&mut self, stage: usize) -> Result<(), Lost> {
        let joints = self.model.joints().iter().zip(&self.torques);
        let state = joints.zip(self.braked.iter().zip(&self.trial.v));
        let state = state.zip(&self.pulled);
        for (drive, (((joint, torque), (braked, speed)), pulled)) in
            self.drive.iter_mut().zip(state)
        {
            let most = joint.limits.torque;
            *drive = if *braked {
                0.0
            } else {
                torque.clamp(-most, most)
            };
            *drive += pulled;
            if self.friction {
                let gear = joint.motor.gear_ratio;
                *drive -= gear * gear * joint.motor.friction.viscous * speed;
            }
        }
        let options = DynamicsOptions::WITH_ROTORS;
        let rates = self.model.forward_dynamics(
            &mut self.data,
            &self.trial.q,
            &self.trial.v,
            &self.drive,
            options,
        );
        self.slopes[stage].copy_from_slice(rates.map_err(|_| Lost)?);
        Ok(())
    }

    /// The end of the step from where smooth forces lead, what touches the arm, and what is dry.
    fn settle(&mut self, h: f64, touch: Option<&Touch>) -> Result<(), Lost> {
        self.next.clone_from(&self.smooth);
        let boxes: Vec<[f64; 2]> = (0..self.model.dof())
            .map(|joint| self.dry(joint, h))
            .collect();
        if touch.is_none() && boxes.iter().all(|dry| *dry == [0.0; 2]) {
            return Ok(());
        }
        let inverse = self.inverse_mass().ok_or(Lost)?;
        let mut speeds = DVector::from_column_slice(&self.smooth.v);
        let mut places = DVector::from_column_slice(&self.smooth.q);
        if let Some(touch) = touch {
            speeds += &inverse * DVector::from_column_slice(&touch.impulse);
            places += &inverse * DVector::from_column_slice(&touch.shift);
        }
        let dry = impulses(&inverse, &boxes, &mut speeds);
        // The impulse acts all through the step.
        places += &inverse * dry * (h / 2.0);
        for (index, joint) in self.model.joints().iter().enumerate() {
            let Limits { lower, upper, .. } = joint.limits;
            let rested = self.now.v[index] == 0.0 && speeds[index] == 0.0;
            self.next.v[index] = speeds[index];
            self.next.q[index] = if rested {
                self.now.q[index]
            } else {
                places[index].max(lower).min(upper)
            };
        }
        Ok(())
    }

    /// The least and the greatest impulse that friction, brake and stops can give a joint in `h` seconds.
    fn dry(&self, index: usize, h: f64) -> [f64; 2] {
        let Some(joint) = self.model.joints().get(index) else {
            return [0.0; 2];
        };
        let Limits {
            lower,
            upper,
            torque,
            ..
        } = joint.limits;
        let [forward, backward] = if self.braked[index] {
            [BRAKE_FACTOR * torque; 2]
        } else if self.friction {
            coulomb(&joint.motor)
        } else {
            [0.0; 2]
        };
        let place = self.smooth.q[index];
        [
            if place >= upper {
                f64::NEG_INFINITY
            } else {
                -forward * h
            },
            if place <= lower {
                f64::INFINITY
            } else {
                backward * h
            },
        ]
    }
}

/// Coulomb friction at the joint when it moves forward and backward, N m or N, both as magnitudes.
fn coulomb(motor: &Motor) -> [f64; 2] {
    let friction = &motor.friction;
    [friction.coulomb_forward, -friction.coulomb_backward]
        .map(|torque| torque * motor.gear_ratio.abs())
}

/// The impulses within `boxes` that bring every joint to rest that they can; `speeds` become those after them.
fn impulses(inverse: &DMatrix<f64>, boxes: &[[f64; 2]], speeds: &mut DVector<f64>) -> DVector<f64> {
    let mut all = DVector::<f64>::zeros(boxes.len());
    for _ in 0..SWEEPS {
        let mut change: f64 = 0.0;
        for (joint, [least, most]) in boxes.iter().enumerate() {
            let wanted: f64 = all[joint] - speeds[joint] / inverse[(joint, joint)];
            let given = wanted.max(*least).min(*most);
            let more = given - all[joint];
            if more != 0.0 {
                all[joint] = given;
                speeds.axpy(more, &inverse.column(joint), 1.0);
                change = change.max((more * inverse[(joint, joint)]).abs());
            }
        }
        if change <= SPEED_TOLERANCE {
            break;
        }
    }
    for (joint, [least, most]) in boxes.iter().enumerate() {
        if (*least..=*most).contains(&all[joint]) && all[joint] != *least && all[joint] != *most {
            speeds[joint] = 0.0;
        }
    }
    all
}
