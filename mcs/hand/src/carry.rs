//! The control law `carry`: two tips of one manipulator hold a thing between them, and press on it along the line between
//! them as hard as they shall, and no harder.
//!
//! Two arms that hold one thing are a closed chain: what their setpoints are apart too much or too little becomes a force
//! along the thing, as stiff as the position loops are. Computed torque moves all joints. Of its torques those are taken back
//! that would move the tips apart or together: along the thing only its damping is left. To it comes the internal force p,
//! with which both tips press towards each other (J_left^T u p - J_right^T u p), and whose rate is w (f - s): s is what the
//! wrists feel of it, f what it shall be, w the loop's natural frequency. Both wrists together feel no motion of the thing: its
//! weight and its inertia pull at both alike (T. Yoshikawa and X. Zheng, Int. J. Robotics Research 12(3), 1993; integral force
//! control after R. Volpe and P. Khosla, IEEE Trans. Automatic Control 38(11), 1993).
//!
//! The event handler `mcs.carry` says while it runs how hard that shall be, and whether anything is carried at all; and it tells
//! how hard it is.

use std::{
    collections::BTreeMap,
    f64::consts::TAU,
    sync::{
        Arc, Mutex, PoisonError,
        atomic::{AtomicU64, Ordering},
    },
    time::Duration,
};

use ctos::{
    Context,
    message::{Command, Message},
    registry::Registry,
    task::{EventHandler, Handled, HandlerError, Phase},
};
use mcs::{
    control::{ComputedTorque, ControlLaw, LawRegistry, LawSettings},
    driver::SlotReading,
    model::{Data, DynamicsOptions, FrameId, Model},
    trajectory::Setpoint,
};
use nalgebra::Vector3;
use serde::Deserialize;

use crate::command::{ReadSqueeze, SetSqueeze, Squeeze};

/// Name of the law.
pub const CARRY: &str = "carry";
/// Name of the handler.
pub const CARRY_TASK: &str = "mcs.carry";

/// No wrist of an arm of this size stands more, N.
const MOST: f64 = 500.0;
/// Where 1 N along the line gives the tips less acceleration, no joint moves them apart, m/s^2.
const IMMOBILE: f64 = 1e-9;

/// How long it takes until nothing of the position loops presses on the thing, and back, s.
const EASING: f64 = 0.3;

/// Tips that are nearer to each other have no line between them, m.
const NEAR: f64 = 1e-3;

/// Arguments of the law.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CarryArgs {
    /// By which a task of the same chassis finds it.
    #[serde(default)]
    pub name: String,
    /// The two frames of the model that hold the thing.
    pub tips: [String; 2],
    /// The frames of the force-torque sensors behind them, the first two of the driver.
    pub sensors: [String; 2],
    /// How hard the tips press towards each other, N; below 0 they pull. They carry nothing when it is left out.
    pub force_n: Option<f64>,
    /// No more than this is added to what the joints do by themselves, N.
    #[serde(default = "most_n")]
    pub most_n: f64,
    /// Natural frequency of the force loop, Hz.
    #[serde(default = "loop_hz")]
    pub loop_hz: f64,
}

fn most_n() -> f64 {
    60.0
}

fn loop_hz() -> f64 {
    10.0
}

/// What law and task share. Reading and writing take no lock.
#[derive(Debug)]
pub struct Carried {
    /// No number while nothing is carried.
    wanted: AtomicU64,
    felt: AtomicU64,
}

impl Carried {
    fn new(force: Option<f64>) -> Result<Self, String> {
        let carried = Self {
            wanted: AtomicU64::new(f64::NAN.to_bits()),
            felt: AtomicU64::new(0),
        };
        carried.set_force(force)?;
        Ok(carried)
    }

    /// From now on the tips press towards each other with so much, N; below 0 they pull. Without a number they carry nothing.
    ///
    /// # Errors
    /// A text about a number that is none, or more than a wrist stands.
    pub fn set_force(&self, force: Option<f64>) -> Result<(), String> {
        if let Some(force) = force.filter(|force| !(-MOST..=MOST).contains(force)) {
            return Err(format!("a force is from -{MOST} to {MOST} N, not {force}"));
        }
        let wanted = force.unwrap_or(f64::NAN);
        self.wanted.store(wanted.to_bits(), Ordering::Relaxed);
        Ok(())
    }

    /// How hard they shall press, and how hard the wrists felt them press in the last tick, N.
    #[must_use]
    pub fn squeeze(&self) -> Squeeze {
        let get = |place: &AtomicU64| f64::from_bits(place.load(Ordering::Relaxed));
        Squeeze {
            wanted_n: Some(get(&self.wanted)).filter(|wanted| wanted.is_finite()),
            felt_n: get(&self.felt),
        }
    }
}

/// What the laws of a process share with tasks, by name.
#[derive(Debug, Clone, Default)]
pub(crate) struct Carries(Arc<Mutex<BTreeMap<String, Arc<Carried>>>>);

impl Carries {
    /// Registers the law; those that have a name are found here.
    pub(crate) fn register(&self, laws: &mut LawRegistry) {
        let carries = self.clone();
        laws.law(CARRY, move |settings| {
            let args: CarryArgs = settings.args.parse()?;
            let law = CarryLaw::new(settings, &args)?;
            if !args.name.is_empty() {
                let mut all = carries.0.lock().unwrap_or_else(PoisonError::into_inner);
                all.insert(args.name, Arc::clone(&law.carried));
            }
            Ok(Box::new(law))
        });
    }
}

/// The law.
#[derive(Debug)]
pub struct CarryLaw {
    carried: Arc<Carried>,
    joints: ComputedTorque,
    model: Arc<Model>,
    data: Data,
    tips: [FrameId; 2],
    sensors: [FrameId; 2],
    /// Forces on the sensors, each in its frame, N.
    sensed: [Vector3<f64>; 2],
    /// The internal force that is added, and the most of it, N.
    added: f64,
    most: f64,
    /// Natural frequency of the force loop, rad/s.
    rate: f64,
    /// How much of what the position loops press is taken back, 0 to 1.
    eased: f64,
    /// How the position loops damp, 1/s.
    damper: f64,
    measured: Vec<f64>,
    speeds: Vec<f64>,
    /// How the distance of the tips changes with each joint.
    apart: Vec<f64>,
    trial: Vec<f64>,
}

impl CarryLaw {
    /// The law for the model of `settings`.
    ///
    /// # Errors
    /// A frame that the model does not have, or a number that cannot be.
    pub fn new(settings: &LawSettings<'_>, args: &CarryArgs) -> Result<Self, HandlerError> {
        let model = settings.model;
        let frame = |name: &String| {
            let text = || format!("model `{}` has no frame `{name}`", model.name());
            model.frame(name).ok_or_else(|| HandlerError::new(text()))
        };
        let pair = |[one, other]: &[String; 2]| Ok::<_, HandlerError>([frame(one)?, frame(other)?]);
        let carried = Carried::new(args.force_n).map_err(HandlerError::new)?;
        if !(0.0..=MOST).contains(&args.most_n) {
            let text = format!(
                "`most_n` is {}; give a force from 0 to {MOST} N",
                args.most_n
            );
            return Err(HandlerError::new(text));
        }
        // A faster loop is not stable with what a sensor's filter and a period take.
        let fastest = 0.1 / settings.period.as_secs_f64();
        if !(0.01..=fastest).contains(&args.loop_hz) {
            let text = format!(
                "`loop_hz` is {}; give 0.01 to {fastest:.0} Hz",
                args.loop_hz
            );
            return Err(HandlerError::new(text));
        }
        Ok(Self {
            carried: Arc::new(carried),
            joints: ComputedTorque::new(
                Arc::clone(model),
                settings.bandwidth_hz,
                settings.damping,
                DynamicsOptions::WITH_ROTORS,
            ),
            data: model.data(),
            tips: pair(&args.tips)?,
            sensors: pair(&args.sensors)?,
            sensed: [Vector3::zeros(); 2],
            added: 0.0,
            most: args.most_n,
            rate: TAU * args.loop_hz,
            eased: 0.0,
            damper: 2.0 * settings.damping * TAU * settings.bandwidth_hz,
            measured: vec![0.0; model.dof()],
            speeds: vec![0.0; model.dof()],
            apart: vec![0.0; model.dof()],
            trial: vec![0.0; model.dof()],
            model: Arc::clone(model),
        })
    }

    /// The force along the thing that takes back what `torques` would do to the distance of the tips, but for its damping, N;
    /// `apart` is up to date. `tips` are where the tips are, m, `along` is from one to the other.
    fn pressed_by(
        &mut self,
        torques: &[f64],
        tips: &[Vector3<f64>; 2],
        along: &Vector3<f64>,
    ) -> f64 {
        let (model, data, options) = (&self.model, &mut self.data, DynamicsOptions::WITH_ROTORS);
        let across = |rates: &[f64], apart: &[f64]| -> f64 {
            apart
                .iter()
                .zip(rates)
                .map(|(part, rate)| part * rate)
                .sum()
        };
        // What the tips do with no torque more, in turning about one another too, and with that of 1 N along the thing.
        let mut parts = 0.0;
        let mut moves = Vector3::zeros();
        for (tip, sign) in [(0, -1.0), (1, 1.0)] {
            let bias = model.bias_acceleration(data, &self.measured, &self.speeds, self.tips[tip]);
            parts += sign * bias.fixed_rows::<3>(0).dot(along);
            let jacobian = model.jacobian_there(data, self.tips[tip], &tips[tip]);
            for (column, speed) in jacobian.column_iter().zip(&self.speeds) {
                moves += column.fixed_rows::<3>(0) * (sign * speed);
            }
        }
        let turning = (moves - along * moves.dot(along)).norm_squared();
        parts += turning / (tips[1] - tips[0]).norm();
        parts += self.damper * across(&self.speeds, &self.apart);
        for ((trial, torque), part) in self.trial.iter_mut().zip(torques).zip(&self.apart) {
            *trial = torque + part;
        }
        let (q, qd) = (&self.measured, &self.speeds);
        let Ok(rates) = model.forward_dynamics(data, q, qd, torques, options) else {
            return 0.0;
        };
        let before = across(rates, &self.apart);
        let Ok(rates) = model.forward_dynamics(data, q, qd, &self.trial, options) else {
            return 0.0;
        };
        let mobility = across(rates, &self.apart) - before;
        match mobility > IMMOBILE {
            true => (before + parts) / mobility,
            false => 0.0,
        }
    }

    /// What it shares with a task.
    #[must_use]
    pub fn carried(&self) -> &Arc<Carried> {
        &self.carried
    }
}

impl ControlLaw for CarryLaw {
    fn reset(&mut self, readings: &[SlotReading]) {
        self.joints.reset(readings);
        (self.added, self.eased) = (0.0, 0.0);
    }

    fn tune(&mut self, bandwidth: f64, damping: f64) {
        self.joints.tune(bandwidth, damping);
        self.damper = 2.0 * damping * TAU * bandwidth;
    }

    fn sense(&mut self, numbers: &[f64]) {
        for (sensed, wrench) in self.sensed.iter_mut().zip(numbers.chunks_exact(6)) {
            *sensed = Vector3::new(wrench[0], wrench[1], wrench[2]);
        }
    }

    fn torques(
        &mut self,
        setpoint: &Setpoint,
        readings: &[SlotReading],
        period: Duration,
        out: &mut [f64],
    ) {
        self.joints.torques(setpoint, readings, period, out);
        for (index, reading) in readings.iter().enumerate().take(self.measured.len()) {
            self.measured[index] = reading.position;
            self.speeds[index] = reading.velocity;
        }
        let (model, data) = (&self.model, &mut self.data);
        model.forward(data, &self.measured);
        let ends = self.tips.map(|tip| data.placement(model, tip).origin);
        let Some(along) = (ends[1] - ends[0]).try_normalize(NEAR) else {
            return;
        };
        let felt = [0, 1].map(|side| {
            let turn = data.placement(model, self.sensors[side]).rotation;
            (turn * self.sensed[side]).dot(&along)
        });
        // What is pressed pushes the tips apart.
        let felt = 0.5 * (felt[1] - felt[0]);
        self.carried.felt.store(felt.to_bits(), Ordering::Relaxed);
        let (error, eases) = match self.carried.squeeze().wanted_n {
            Some(wanted) => (wanted - felt, 1.0),
            // Whoever carries nothing comes back to where the joints shall be.
            None => (-self.added, -1.0),
        };
        let seconds = period.as_secs_f64();
        let added = self.added + self.rate * error * seconds;
        self.added = added.clamp(-self.most, self.most);
        self.eased = (self.eased + eases * seconds / EASING).clamp(0.0, 1.0);
        self.apart.fill(0.0);
        for (tip, sign) in [(0, -1.0), (1, 1.0)] {
            let jacobian = model.jacobian_there(data, self.tips[tip], &ends[tip]);
            for (apart, column) in self.apart.iter_mut().zip(jacobian.column_iter()) {
                *apart += sign * column.fixed_rows::<3>(0).dot(&along);
            }
        }
        let taken = match self.eased > 0.0 {
            true => self.eased * self.pressed_by(out, &ends, &along),
            false => 0.0,
        };
        let force = (self.added + taken).clamp(-self.most, self.most);
        for (out, apart) in out.iter_mut().zip(&self.apart) {
            *out -= apart * force;
        }
    }
}

/// Arguments of the handler.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
struct TaskArgs {
    /// `law_args.name` of a servo with this law, on the same chassis.
    carry: String,
}

struct Carry {
    args: TaskArgs,
    carries: Carries,
    carried: Option<Arc<Carried>>,
}

/// Registers the handler; laws of the process are found in `carries`.
pub(crate) fn register(registry: &mut Registry, carries: &Carries) {
    let commands = [SetSqueeze::INFO, ReadSqueeze::INFO];
    let carries = carries.clone();
    registry
        .handler(CARRY_TASK, &commands, move |cx| {
            Ok(Carry {
                args: cx.args()?,
                carries: carries.clone(),
                carried: None,
            })
        })
        .args::<TaskArgs>();
}

impl Carry {
    fn carried(&self) -> Result<&Carried, HandlerError> {
        let carried = self.carried.as_deref();
        carried.ok_or_else(|| HandlerError::new("it is not connected yet"))
    }
}

impl EventHandler for Carry {
    async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
        match message.command() {
            SetSqueeze::CODE => {
                let (order, reply) = message.open::<SetSqueeze>()?;
                reply.ok(self.carried()?.set_force(order.force_n))
            }
            ReadSqueeze::CODE => {
                let (ReadSqueeze {}, reply) = message.open::<ReadSqueeze>()?;
                reply.ok(self.carried()?.squeeze())
            }
            _ => cx.default_processing(message),
        }
    }

    async fn phase(&mut self, cx: &Context, phase: Phase) -> Handled {
        if phase == Phase::Connect {
            let name = &self.args.carry;
            cx.reads_unrecorded(format_args!("the grip `{name}` of two tips"));
            let all = self
                .carries
                .0
                .lock()
                .unwrap_or_else(PoisonError::into_inner);
            let found = all.get(name).cloned();
            self.carried = Some(found.ok_or_else(|| {
                HandlerError::new(format!("no servo of this chassis carries as `{name}`"))
            })?);
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use ctos::config::Node;
    use mcs::{
        Joints,
        model::{built_in, file::Inertias},
    };

    use super::*;

    const PERIOD: Duration = Duration::from_micros(4500);

    fn law(args: &CarryArgs) -> Result<CarryLaw, HandlerError> {
        let model = built_in::model("testbed18", Inertias::Engine);
        let settings = LawSettings {
            model: &Arc::new(model.unwrap().unwrap()),
            bandwidth_hz: 8.0,
            damping: 1.0,
            period: PERIOD,
            cx: None,
            args: &Node::table(),
        };
        CarryLaw::new(&settings, args)
    }

    fn args() -> CarryArgs {
        CarryArgs {
            name: String::new(),
            tips: ["left", "right"].map(str::to_owned),
            sensors: ["left_arm.flange", "right_arm.flange"].map(str::to_owned),
            force_n: Some(20.0),
            most_n: 60.0,
            loop_hz: 2.0,
        }
    }

    #[test]
    fn what_is_added_is_a_force_of_each_tip_towards_the_other_and_no_more_than_may_be() {
        let mut law = law(&args()).unwrap();
        let q: Vec<f64> = (0..18).map(|joint| 0.05 * f64::from(joint) - 0.4).collect();
        let at = |q: &[f64]| -> Vec<SlotReading> {
            let reading = |position: &f64| SlotReading {
                position: *position,
                velocity: 0.0,
            };
            q.iter().map(reading).collect()
        };
        let setpoint = Setpoint::at_rest(Joints::try_from(q.as_slice()).unwrap());
        let (mut before, mut after) = ([0.0; 18], [0.0; 18]);
        law.joints.torques(&setpoint, &at(&q), PERIOD, &mut before);
        // Nothing is felt, so the force grows to the most.
        for _ in 0..1000 {
            law.torques(&setpoint, &at(&q), PERIOD, &mut after);
        }
        // By the principle of virtual work: the distance of the tips falls by what a joint's step makes it fall.
        let (model, mut data) = (Arc::clone(&law.model), law.model.data());
        let mut apart = |q: &[f64]| {
            model.forward(&mut data, q);
            let [one, other] = law.tips.map(|tip| data.placement(&model, tip).origin);
            (one - other).norm()
        };
        for joint in 0..18 {
            let step = |way: f64| -> Vec<f64> {
                let mut moved = q.clone();
                moved[joint] += way;
                moved
            };
            let slope = (apart(&step(1e-6)) - apart(&step(-1e-6))) / 2e-6;
            let found = after[joint] - before[joint];
            assert!(
                (found + 60.0 * slope).abs() < 1e-5,
                "{joint}: {found}, {slope}"
            );
        }
    }

    #[test]
    fn a_thing_that_both_pull_along_is_no_squeeze_and_one_between_them_is() {
        let mut law = law(&args()).unwrap();
        let q = [0.0; 18];
        let readings = [SlotReading::default(); 18];
        let setpoint = Setpoint::at_rest(Joints::from(q));
        law.model.forward(&mut law.data, &q);
        let [one, other] = law
            .tips
            .map(|tip| law.data.placement(&law.model, tip).origin);
        let along = (other - one).normalize();
        let wrench = |law: &CarryLaw, side: usize, force: Vector3<f64>| {
            let frame = law.sensors[side];
            let own = law
                .data
                .placement(&law.model, frame)
                .rotation
                .tr_mul(&force);
            [own.x, own.y, own.z, 0.0, 0.0, 0.0]
        };
        for (left, right, expected) in [(7.0, 7.0, 0.0), (-5.0, 5.0, 5.0), (4.0, -4.0, -4.0)] {
            let across = Vector3::new(3.0, 0.0, -9.0);
            let wrenches = [
                wrench(&law, 0, along * left + across),
                wrench(&law, 1, along * right + across),
            ];
            law.sense(&wrenches.concat());
            law.torques(&setpoint, &readings, PERIOD, &mut [0.0; 18]);
            let found = law.carried().squeeze().felt_n;
            assert!((found - expected).abs() < 1e-9, "{found}, not {expected}");
        }
    }

    #[test]
    fn arguments_that_cannot_be_are_refused_by_name() {
        for (wrong, why) in [
            (
                CarryArgs {
                    tips: ["left", "rihgt"].map(str::to_owned),
                    ..args()
                },
                "no frame `rihgt`",
            ),
            (
                CarryArgs {
                    force_n: Some(f64::NAN),
                    ..args()
                },
                "a force is from",
            ),
            (
                CarryArgs {
                    most_n: -1.0,
                    ..args()
                },
                "`most_n` is -1",
            ),
            (
                CarryArgs {
                    loop_hz: 100.0,
                    ..args()
                },
                "`loop_hz` is 100",
            ),
        ] {
            let error = law(&wrong).unwrap_err().to_string();
            assert!(error.contains(why), "{error}");
        }
    }
}
