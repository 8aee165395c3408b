//! Guards: what watches a motion and ends it when something is seen that must not be (SORMA technical report, 2.1.3).
//!
//! A [`Guard`] is a synchronous function: the servo asks it in every tick of a motion, after the setpoint of the tick is
//! known and before it is commanded. What happens then is the recipe's [`Reaction`]. Recipes have names; some hold for
//! every motion, others for those that name them. A guard of one's own is one file with one type and one name in a
//! [`GuardRegistry`]. Knows the arm's model, and no task, planner or hardware.

pub mod contact;
pub mod force;
pub(crate) mod rack;
mod registry;
pub mod speed;
mod words;
pub mod workspace;

use std::sync::Arc;

use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

use crate::driver::SlotReading;
use crate::joints::Joints;
use crate::latest::Latest;
use crate::model::{Data, Joint, JointKind, Model, Placement};
use crate::trajectory::{REST_PARTS, Setpoint, WayToRest};
pub use rack::{GuardSet, MAX_GUARDS, Mounted};
pub use registry::{Around, GuardRegistry, GuardSettings};
pub use words::Words;

/// A watchdog of motions. Called once per servo period while a motion is under way; must neither allocate, lock nor
/// wait.
pub trait Guard: Send {
    /// A motion begins: called once before its first [`Self::check`], with what that sees. Whoever compares with the
    /// past forgets it here.
    fn begin(&mut self, seen: &Seen<'_>) {
        let _ = seen;
    }

    /// What must not be, in words with the numbers that were measured (see [`words!`](crate::words)); `None` when all
    /// is well. A motion out of what is forbidden must be allowed, and one further into it must not: compare where the
    /// arm would come to rest with where it is.
    fn check(&mut self, seen: &Seen<'_>) -> Option<Words>;

    /// Whether what it finds is that the arm presses on something. Then the setpoint, which is inside of that, is left at once for
    /// where the arm was measured and how fast; from there it rests within the limits of its joints, at that position.
    fn feels(&self) -> bool {
        false
    }

    /// Straight lines in the base frame, m, that show a viewer what it forbids; none where that has no place. Asked once,
    /// before it watches.
    fn outline(&self) -> Vec<Line> {
        Vec::new()
    }

    /// What it sees that moves, for viewers; none where there is nothing. Asked once, before it watches.
    fn sight(&self) -> Option<Arc<dyn Sight>> {
        None
    }
}

/// A straight line between two points, m.
pub type Line = [[f64; 3]; 2];

/// What a guard sees that moves. Viewers ask on threads of their own: the servo does nothing for them.
pub trait Sight: std::fmt::Debug + Send + Sync {
    /// The distance that it keeps, m.
    fn margin(&self) -> f64;

    /// The two solids that the latest tick found nearest, as they are with the arm at positions `q` (rad or m); none before the
    /// first motion.
    fn nearest(&self, q: &[f64]) -> Option<Nearest>;
}

/// Two solids that are near one another.
#[derive(Debug, Clone, PartialEq)]
pub struct Nearest {
    /// Their names.
    pub names: [String; 2],
    /// Their distance, m; below zero where one is in the other.
    pub distance: f64,
    /// The points of both that are nearest, base frame, m. None of hulls, and of what is in the other.
    pub ends: Option<Line>,
}

/// The twelve edges of a box along the axes, between two of its corners, m.
#[must_use]
pub fn edges(low: [f64; 3], high: [f64; 3]) -> Vec<Line> {
    let ends = [low, high];
    let of_axis = |along: usize| {
        let (one, other) = ((along + 1) % 3, (along + 2) % 3);
        [(0, 0), (0, 1), (1, 1), (1, 0)].map(|(first, second)| {
            [0, 1].map(|end| {
                let mut corner = ends[end];
                corner[one] = ends[first][one];
                corner[other] = ends[second][other];
                corner
            })
        })
    };
    (0..3).flat_map(of_axis).collect()
}

/// What happens when a guard finds something.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Reaction {
    /// The arm brakes along its path to rest, or gives way where the guard [feels](Guard::feels) a touch. The next motion may
    /// begin at once.
    #[default]
    Stop,
    /// As [`Self::Stop`]; then the arm goes back to where it was when all was still well, after a touch a little farther.
    Retreat,
    /// The motion goes on; it is told, once in a motion.
    Report,
}

/// How the arm would come to rest if it braked from the next tick on.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Stopping {
    /// Time from then until rest, s.
    pub time: f64,
    /// Where the joints are meanwhile, rad or m: when the braking begins, and at the end of each of
    /// [`REST_PARTS`] equal parts of that time.
    pub way: WayToRest,
}

impl Stopping {
    /// Of an arm that stands there, rad or m.
    #[must_use]
    pub fn standing(position: &Joints) -> Self {
        let mut way = WayToRest::default();
        way.fill(*position);
        Self { time: 0.0, way }
    }

    /// Where the joints rest, rad or m.
    #[must_use]
    pub fn at_rest(&self) -> &Joints {
        let [.., last] = &self.way;
        last
    }
}

/// What a guard sees in a tick.
#[derive(Debug, Clone, Copy)]
pub struct Seen<'a> {
    /// The arm; its tip is the tool.
    pub model: &'a Model,
    /// Where the arm is at the setpoint: see [`Data::carrier`].
    pub data: &'a Data,
    /// `base_T_tool` at the setpoint.
    pub tool: Placement,
    /// `base_T_tool` where the arm would come to rest if it braked from the next tick on. Exact where it follows a
    /// straight line of the tool, or of the joints.
    pub tool_at_rest: Placement,
    /// What the arm is to do in this tick.
    pub setpoint: &'a Setpoint,
    /// What was read from the slots in this tick.
    pub readings: &'a [SlotReading],
    /// How the arm would come to rest.
    pub stopping: &'a Stopping,
    /// Force (N) and torque (N m) on the tool in the sensor's frame; `None` where there is no sensor.
    pub force: Option<[f64; 6]>,
    /// Servo period, s.
    pub period: f64,
}

impl Seen<'_> {
    /// Speed of the tool at joint speeds `qd` (rad/s or m/s): of its origin, m/s, and its turning, rad/s, base frame.
    #[must_use]
    pub fn tool_velocity(&self, qd: impl Fn(usize) -> f64) -> (Vector3<f64>, Vector3<f64>) {
        let point = self.tool.origin;
        let (mut linear, mut angular) = (Vector3::zeros(), Vector3::zeros());
        let joints = self.model.joints();
        let carriers = std::iter::successors(self.model.at(self.model.tip()).carrier, |joint| {
            joints.get(*joint).and_then(|joint: &Joint| joint.parent)
        });
        for index in carriers {
            let at = self.data.carrier(Some(index));
            let axis = at.rotation.column(2) * qd(index);
            match joints.get(index).map(|joint| joint.kind) {
                Some(JointKind::Revolute) => {
                    linear += axis.cross(&(point - at.origin));
                    angular += axis;
                }
                _ => linear += axis,
            }
        }
        (linear, angular)
    }
}

/// What a guard found in a motion, and what was done.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct GuardReport {
    /// The number of the motion.
    pub motion: u64,
    /// The recipe's name.
    pub guard: Words,
    /// What it measured.
    pub measured: Words,
    /// What is done.
    pub reaction: Reaction,
    /// Where a retreat goes, rad or m: the last setpoint with which all was well, or of a guard that [feels](Guard::feels) a
    /// touch, where the arm was measured a quarter of a second before, or when the motion began.
    pub allowed: Joints,
}

/// Another arm of the same chassis, as its servo shows it in every tick.
#[derive(Debug, Clone)]
pub struct Neighbour {
    /// Its joints and its form, in its own base frame.
    pub model: Arc<Model>,
    latest: Arc<Latest>,
}

/// What a neighbour shows.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Shown {
    /// Ticks of its servo.
    pub ticks: u64,
    /// Its setpoint: positions, rad or m,
    pub position: Joints,
    /// and speeds in the next tick, rad/s or m/s.
    pub velocity: Joints,
    /// How it would come to rest.
    pub stopping: Stopping,
}

impl Neighbour {
    /// One that nobody moves yet: all zeros.
    #[must_use]
    pub fn new(model: Arc<Model>) -> Self {
        let row = vec![0.0; Self::width(model.dof())];
        Self {
            model,
            latest: Arc::new(Latest::new(&row)),
        }
    }

    /// What it shows of `n` joints: a time, and as many rows of joints as a way to rest has, and two more.
    const fn width(n: usize) -> usize {
        1 + (REST_PARTS + 3) * n
    }

    /// Shows what one tick left; the servo of the arm alone does it. Neither waits nor allocates.
    pub(crate) fn show(&self, setpoint: &Setpoint, stopping: &Stopping, period: f64) {
        let n = setpoint.position.len();
        let speeds = (0..n).map(|joint| setpoint.pace(joint, period));
        let joints = setpoint.position.iter().copied().chain(speeds);
        let way = stopping.way.iter().flat_map(|place| place.iter().copied());
        let time = std::iter::once(stopping.time);
        self.latest.write(time.chain(joints).chain(way));
    }

    /// What its servo showed last. Takes no lock and does not allocate.
    #[must_use]
    pub fn read(&self) -> Shown {
        let n = self.model.dof().min(crate::MAX_SLOTS);
        let mut row = [0.0; Self::width(crate::MAX_SLOTS)];
        let row = &mut row[..Self::width(n)];
        let ticks = self.latest.read(row);
        let joints = |place: usize| Joints::from_fn(n, |index| row[1 + place * n + index]);
        Shown {
            ticks,
            position: joints(0),
            velocity: joints(1),
            stopping: Stopping {
                time: row[0],
                way: std::array::from_fn(|place| joints(2 + place)),
            },
        }
    }
}

#[cfg(test)]
mod tests;
