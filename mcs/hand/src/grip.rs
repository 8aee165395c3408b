//! The control law `grip`: joints go to their setpoints as on springs, and press with no more than was asked for.
//!
//! What stands in the way of a finger or a jaw is pressed with just that force: a grasp is a setpoint beyond the surface of
//! the object. Joints that one motor moves (`coupled`) press together with the force of each, and stay in step however they
//! are loaded. Whether something is held follows from where the joints stand still, which is for a task to look at.
//!
//! A joint's spring is `stiffness` (N m/rad or N/m; the compliance of a hand), or as stiff as the servo's bandwidth makes it;
//! its damper has the servo's damping ratio. What may be asked for while the law runs lies in a [`Grip`] that both share.

use std::{
    collections::BTreeMap,
    f64::consts::TAU,
    sync::{
        Arc, Mutex, PoisonError,
        atomic::{AtomicU64, Ordering},
    },
    time::Duration,
};

use ctos::task::{Context, HandlerError};
use mcs::{
    control::{ControlLaw, LawRegistry, LawSettings},
    driver::SlotReading,
    model::{Data, DynamicsOptions, Model},
    trajectory::Setpoint,
};
use nalgebra::Vector3;
use serde::Deserialize;

/// Name of the law.
pub const GRIP: &str = "grip";

/// Arguments of the law.
#[derive(Debug, Clone, Default, Deserialize)]
#[serde(deny_unknown_fields)]
struct GripArgs {
    /// By which a task of the same chassis finds what it may change while the law runs.
    #[serde(default)]
    name: String,
    /// How hard each joint presses until something else is asked for, N or N m; as hard as its drive can when left out.
    force: Option<Vec<f64>>,
    /// Spring of each joint, N/m or N m/rad; by the servo's bandwidth when left out.
    stiffness: Option<Vec<f64>>,
    /// Whether one motor moves all joints alike.
    #[serde(default)]
    coupled: bool,
    /// Free fall in the base frame of the model, m/s^2, against which it holds its own weight; none when left out.
    gravity: Option<[f64; 3]>,
}

/// Numbers that do not fit the joints.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum GripError {
    /// Too few, or too many.
    #[error("`{what}` has {found} numbers, and the model has {needed} joints")]
    Count {
        /// Of what.
        what: &'static str,
        /// How many there are.
        found: usize,
        /// How many there must be.
        needed: usize,
    },
    /// A number that no joint can have.
    #[error("`{what}` of joint `{joint}` is {value}; it goes from {least} to {most}")]
    Range {
        /// Of what.
        what: &'static str,
        /// The joint.
        joint: String,
        /// What was given.
        value: f64,
        /// The least that can be.
        least: f64,
        /// The most that can be.
        most: f64,
    },
}

/// What may be changed while the law runs. Reading and writing take no lock.
#[derive(Debug)]
pub struct Grip {
    model: Arc<Model>,
    force: Box<[AtomicU64]>,
    stiffness: Box<[AtomicU64]>,
    /// As the configuration has it.
    usual_force: Vec<f64>,
}

/// The stiffest spring of a joint, N/m or N m/rad.
const STIFFEST: f64 = 1e5;

impl Grip {
    fn new(model: &Arc<Model>, args: &GripArgs) -> Result<Self, GripError> {
        let drives = model.joints().iter().map(|joint| joint.limits.torque);
        let force = args.force.clone().unwrap_or_else(|| drives.collect());
        // A spring of 0 is one by the bandwidth.
        let soft = vec![0.0; model.dof()];
        let stiffness = args.stiffness.clone().unwrap_or(soft);
        let row = |values: &[f64]| values.iter().map(|_| AtomicU64::new(0)).collect();
        let grip = Self {
            model: Arc::clone(model),
            force: row(&force),
            stiffness: row(&stiffness),
            usual_force: force.clone(),
        };
        grip.set_force(&force)?;
        grip.set_stiffness(&stiffness)?;
        Ok(grip)
    }

    /// What grips.
    #[must_use]
    pub fn model(&self) -> &Arc<Model> {
        &self.model
    }

    /// From now on each joint presses with no more than this, N or N m.
    ///
    /// # Errors
    /// Not one number for each joint, or one beyond what its drive can. Nothing changes then.
    pub fn set_force(&self, force: &[f64]) -> Result<(), GripError> {
        let most = |index: usize| self.model.joints()[index].limits.torque;
        self.set("force", &self.force, force, &most)
    }

    /// How hard each joint presses, N or N m.
    #[must_use]
    pub fn force(&self) -> Vec<f64> {
        self.force.iter().map(get).collect()
    }

    /// From now on each joint has this spring, N/m or N m/rad; 0 is that of the bandwidth.
    ///
    /// # Errors
    /// Not one number for each joint, or one that is none. Nothing changes then.
    pub fn set_stiffness(&self, stiffness: &[f64]) -> Result<(), GripError> {
        self.set("stiffness", &self.stiffness, stiffness, &|_| STIFFEST)
    }

    /// The springs, N/m or N m/rad; 0 is that of the bandwidth.
    #[must_use]
    pub fn stiffness(&self) -> Vec<f64> {
        self.stiffness.iter().map(get).collect()
    }

    /// How hard each joint presses by the configuration, N or N m.
    #[must_use]
    pub fn usual_force(&self) -> &[f64] {
        &self.usual_force
    }

    fn set(
        &self,
        what: &'static str,
        row: &[AtomicU64],
        values: &[f64],
        most: &dyn Fn(usize) -> f64,
    ) -> Result<(), GripError> {
        let joints = self.model.joints();
        if values.len() != joints.len() {
            let (found, needed) = (values.len(), joints.len());
            return Err(GripError::Count {
                what,
                found,
                needed,
            });
        }
        for (index, (value, joint)) in values.iter().zip(joints).enumerate() {
            if !(0.0..=most(index)).contains(value) {
                return Err(GripError::Range {
                    what,
                    joint: joint.name.clone(),
                    value: *value,
                    least: 0.0,
                    most: most(index),
                });
            }
        }
        for (place, value) in row.iter().zip(values) {
            place.store(value.to_bits(), Ordering::Relaxed);
        }
        Ok(())
    }
}

fn get(place: &AtomicU64) -> f64 {
    f64::from_bits(place.load(Ordering::Relaxed))
}

/// The grips of the laws of a process, by name.
#[derive(Debug, Clone, Default)]
pub struct Grips(Arc<Mutex<BTreeMap<String, Arc<Grip>>>>);

impl Grips {
    /// The grip of the law whose `law_args.name` this is, if it runs in this process.
    #[must_use]
    pub fn find(&self, name: &str) -> Option<Arc<Grip>> {
        let grips = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        grips.get(name).cloned()
    }

    /// The grip of the law called `name`, for a task of its chassis.
    ///
    /// # Errors
    /// No law of this process has that name.
    pub(crate) fn of(&self, cx: &Context, name: &str) -> Result<Arc<Grip>, HandlerError> {
        cx.reads_unrecorded(format_args!("the grip `{name}`"));
        self.find(name).ok_or_else(|| {
            HandlerError::new(format!("no servo of this chassis has the grip `{name}`"))
        })
    }

    /// Registers the law; those that have a name are found here.
    pub fn register(&self, laws: &mut LawRegistry) {
        let grips = self.clone();
        laws.law(GRIP, move |settings| {
            let law = GripLaw::from(settings)?;
            let args: GripArgs = settings.args.parse()?;
            if !args.name.is_empty() {
                let mut grips = grips.0.lock().unwrap_or_else(PoisonError::into_inner);
                grips.insert(args.name, Arc::clone(&law.grip));
            }
            Ok(Box::new(law))
        });
    }
}

/// The law.
#[derive(Debug)]
pub struct GripLaw {
    grip: Arc<Grip>,
    coupled: bool,
    /// With the gravity that it holds against.
    model: Model,
    data: Data,
    /// Natural frequency (rad/s) and damping ratio.
    natural: f64,
    damping: f64,
    measured: Vec<f64>,
    /// Of each joint: how hard it shall press, before and after what couples them.
    wanted: Vec<f64>,
}

impl GripLaw {
    /// The law for the joints of `model`, which are moved by motors of their own.
    #[must_use]
    pub fn new(model: &Arc<Model>, bandwidth_hz: f64, damping: f64) -> Option<Self> {
        Self::with(model, bandwidth_hz, damping, &GripArgs::default()).ok()
    }

    /// The same joints, moved by one motor all alike.
    #[must_use]
    pub fn coupled(mut self) -> Self {
        self.coupled = true;
        self
    }

    /// What may be changed while it runs.
    #[must_use]
    pub fn grip(&self) -> &Arc<Grip> {
        &self.grip
    }

    fn from(settings: &LawSettings<'_>) -> Result<Self, HandlerError> {
        let args: GripArgs = settings.args.parse()?;
        let law = Self::with(
            settings.model,
            settings.bandwidth_hz,
            settings.damping,
            &args,
        );
        Ok(law?)
    }

    fn with(
        model: &Arc<Model>,
        bandwidth_hz: f64,
        damping: f64,
        args: &GripArgs,
    ) -> Result<Self, GripError> {
        let gravity = args.gravity.map_or_else(Vector3::zeros, Vector3::from);
        let still = vec![0.0; model.dof()];
        Ok(Self {
            grip: Arc::new(Grip::new(model, args)?),
            coupled: args.coupled,
            data: model.data(),
            model: model.as_ref().clone().with_gravity(gravity),
            natural: TAU * bandwidth_hz,
            damping,
            measured: still.clone(),
            wanted: still,
        })
    }

    /// What springs and dampers want, and what accelerates the joints as their setpoints are.
    fn springs(&mut self, setpoint: &Setpoint, readings: &[SlotReading]) {
        for (measured, reading) in self.measured.iter_mut().zip(readings) {
            *measured = reading.position;
        }
        let options = DynamicsOptions::WITH_ROTORS;
        let mass = self
            .model
            .mass_matrix(&mut self.data, &self.measured, options);
        let stiffness = self.grip.stiffness.iter().map(get);
        let joints = self.wanted.iter_mut().zip(readings).zip(stiffness);
        for (index, ((wanted, reading), stiffness)) in joints.enumerate() {
            let inertia = mass[(index, index)];
            let spring = match stiffness > 0.0 {
                true => stiffness,
                false => inertia * self.natural * self.natural,
            };
            let damper = 2.0 * self.damping * (spring * inertia).sqrt();
            *wanted = inertia * setpoint.acceleration[index]
                + spring * (setpoint.position[index] - reading.position)
                + damper * (setpoint.velocity[index] - reading.velocity);
        }
    }
}

impl ControlLaw for GripLaw {
    fn reset(&mut self, _readings: &[SlotReading]) {}

    fn tune(&mut self, bandwidth: f64, damping: f64) {
        self.natural = TAU * bandwidth;
        self.damping = damping;
    }

    fn torques(
        &mut self,
        setpoint: &Setpoint,
        readings: &[SlotReading],
        _period: Duration,
        out: &mut [f64],
    ) {
        self.springs(setpoint, readings);
        let count = self.wanted.len().max(1) as f64;
        let together = self.wanted.iter().sum::<f64>() / count;
        let gravity = self.model.gravity_torques(&mut self.data, &self.measured);
        let limits = self.grip.force.iter().map(get);
        let joints = self.wanted.iter().zip(limits).zip(gravity);
        for (out, ((wanted, most), gravity)) in out.iter_mut().zip(joints) {
            let pressed = match self.coupled {
                // What keeps them in step presses on nothing: it is as much the one way as the other.
                true => together.clamp(-most, most) + (wanted - together),
                false => wanted.clamp(-most, most),
            };
            *out = pressed + gravity;
        }
    }
}

#[cfg(test)]
mod tests {
    use mcs::model::{built_in, file::Inertias};

    use super::*;

    const PERIOD: Duration = Duration::from_micros(4500);

    fn model(name: &str) -> Arc<Model> {
        Arc::new(built_in::model(name, Inertias::Engine).unwrap().unwrap())
    }

    fn at(positions: &[f64]) -> Vec<SlotReading> {
        let reading = |position: &f64| SlotReading {
            position: *position,
            velocity: 0.0,
        };
        positions.iter().map(reading).collect()
    }

    /// What the law gives joints at rest at `positions` that shall be at `to`.
    fn forces(law: &mut GripLaw, to: &[f64], positions: &[f64]) -> Vec<f64> {
        let mut out = vec![0.0; positions.len()];
        let setpoint = Setpoint::at_rest(to.try_into().unwrap());
        law.torques(&setpoint, &at(positions), PERIOD, &mut out);
        out
    }

    #[test]
    fn what_stands_in_the_way_is_pressed_with_the_force_that_was_asked_for() {
        let mut law = GripLaw::new(&model("gripper"), 8.0, 1.0).unwrap().coupled();
        law.grip().set_force(&[15.0, 15.0]).unwrap();
        assert_eq!(forces(&mut law, &[0.0; 2], &[0.03; 2]), [-15.0; 2]);
        assert_eq!(forces(&mut law, &[0.05; 2], &[0.03; 2]), [15.0; 2]);
        law.grip().set_force(&[5.0, 5.0]).unwrap();
        assert_eq!(forces(&mut law, &[0.0; 2], &[0.03; 2]), [-5.0; 2]);
    }

    #[test]
    fn coupled_jaws_that_are_not_in_step_are_brought_back_however_hard_they_press() {
        let mut law = GripLaw::new(&model("gripper"), 8.0, 1.0).unwrap().coupled();
        law.grip().set_force(&[15.0, 15.0]).unwrap();
        let found = forces(&mut law, &[0.0; 2], &[0.031, 0.029]);
        assert!((found[0] + found[1] + 30.0).abs() < 1e-9, "{found:?}");
        assert!(found[0] < -15.5 && found[1] > -14.5, "{found:?}");
    }

    #[test]
    fn a_spring_that_was_given_is_the_ratio_of_force_and_way() {
        let mut law = GripLaw::new(&model("hand"), 8.0, 1.0).unwrap();
        law.grip().set_stiffness(&[2.0; 9]).unwrap();
        let found = forces(&mut law, &[0.1; 9], &[0.0; 9]);
        for torque in found {
            assert!((torque - 0.2).abs() < 1e-12, "{torque}");
        }
    }

    #[test]
    fn what_does_not_fit_the_joints_is_refused_and_changes_nothing() {
        let law = GripLaw::new(&model("gripper"), 8.0, 1.0).unwrap();
        let grip = law.grip();
        let before = grip.force();
        assert_eq!(before, [60.0; 2]);
        for wrong in [&[1.0][..], &[1.0, 61.0], &[1.0, -1.0], &[f64::NAN, 1.0]] {
            let error = grip.set_force(wrong).unwrap_err();
            assert!(error.to_string().contains("force"), "{error}");
            assert_eq!(grip.force(), before);
        }
    }
}
