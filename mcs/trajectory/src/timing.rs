//! Least times of joints from state to state and to rest, under limits of speed, acceleration and jerk, and the time in
//! which all of them arrive together. Computed by rsruckig, the algorithm of L. Berscheid and T. Kroeger (Robotics:
//! Science and Systems 2021); a joint without a limit of jerk gets a trapezoid of speed.
//!
//! Positions are in rad or m, all else per s, s^2 and s^3.

use mcs_model::Limits;
use rsruckig::prelude::{
    ControlInterface, InputParameter, Ruckig, RuckigError, RuckigResult, Synchronization,
    ThrowErrorHandler, Trajectory,
};

/// Larger numbers than this, and smaller limits than its inverse, are no joint's.
const LARGEST: f64 = 1e6;

/// What errors call the limit that 0 stands for none of.
const JERK: &str = "jerk";

/// Position and its derivatives at one end of a motion.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct JointState {
    /// rad, or m.
    pub position: f64,
    /// rad/s, or m/s.
    pub velocity: f64,
    /// rad/s^2, or m/s^2. Without a limit of jerk it does not matter.
    pub acceleration: f64,
}

/// The largest speed, acceleration and jerk of a joint; a jerk of 0 stands for no limit of it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct JointBounds {
    /// rad/s, or m/s.
    pub velocity: f64,
    /// rad/s^2, or m/s^2.
    pub acceleration: f64,
    /// rad/s^3, or m/s^3; 0 for none.
    pub jerk: f64,
}

impl JointBounds {
    /// Fractions of a joint's limits: of its speed, and of acceleration and jerk, that of jerk where it counts and there is one.
    #[must_use]
    pub fn of(limits: &Limits, (speed, acceleration): (f64, f64), with_jerk: bool) -> Self {
        let jerk = with_jerk && limits.jerk > 0.0 && limits.jerk.is_finite();
        Self {
            velocity: limits.velocity * speed,
            acceleration: limits.acceleration * acceleration,
            jerk: match jerk {
                true => limits.jerk * acceleration,
                false => 0.0,
            },
        }
    }
}

/// How long a motion takes.
#[derive(Debug, Clone, PartialEq)]
pub struct Times {
    /// In which all joints arrive together, s.
    pub together: f64,
    /// The least time of each joint alone, s.
    pub least: Vec<f64>,
}

/// Why there is no time.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum TimingError {
    /// A limit that nothing can be moved under.
    #[error(
        "the largest {what} of joint {joint} is {value}; it must be {}",
        if *.what == JERK { "above zero, or 0 for none" } else { "above zero" }
    )]
    Bound {
        /// Joint number, from 1.
        joint: usize,
        /// Which.
        what: &'static str,
        /// Its value.
        value: f64,
    },
    /// The state to be reached cannot be reached without passing a limit.
    #[error("joint {joint}: the {what} at the end, {value}, is beyond its limit of {limit}")]
    End {
        /// Joint number, from 1.
        joint: usize,
        /// Which.
        what: &'static str,
        /// Its value.
        value: f64,
        /// The limit.
        limit: f64,
    },
    /// A number with which nothing can be computed.
    #[error(
        "the {what} of joint {joint} is {value:?}; numbers must be finite and at most {LARGEST:e}, limits at least {:e}",
        1.0 / LARGEST
    )]
    TooLarge {
        /// Joint number, from 1.
        joint: usize,
        /// Which.
        what: &'static str,
        /// Its value.
        value: f64,
    },
    /// Nothing lies between two points of a path.
    #[error(
        "point {point} of the path is where point {} is, the start being point 0; leave one of them out",
        .point - 1
    )]
    Standing {
        /// The later one; the start is 0.
        point: usize,
    },
    /// More way points than are computed with.
    #[error("a path has at most {most} way points, not {given}; give it in parts")]
    TooManyPoints {
        /// How many there are.
        given: usize,
        /// How many there may be.
        most: usize,
    },
    /// The computation found nothing.
    #[error("no motion was found under these limits: {0}")]
    NotFound(String),
}

impl From<RuckigError> for TimingError {
    fn from(error: RuckigError) -> Self {
        Self::NotFound(error.to_string())
    }
}

/// Joints with their states at both ends, and their limits.
pub type Motion = (JointState, JointState, JointBounds);

/// How long joints take from state to state.
///
/// # Errors
/// [`TimingError`].
pub fn between(joints: &[Motion]) -> Result<Times, TimingError> {
    Timer::new(joints.len()).between(joints)
}

/// Computes [`between`] for many motions of as many joints, with one scratch.
pub struct Timer(Engine);

impl Timer {
    /// For so many joints.
    #[must_use]
    pub fn new(joints: usize) -> Self {
        Self(Engine::new(joints, ControlInterface::Position))
    }

    /// As [`between`]. Another number of joints takes a new scratch.
    ///
    /// # Errors
    /// [`TimingError`].
    pub fn between(&mut self, joints: &[Motion]) -> Result<Times, TimingError> {
        check_all(joints, ControlInterface::Position)?;
        if joints.len() != self.0.input.degrees_of_freedom {
            *self = Self::new(joints.len());
        }
        let trajectory = self.0.compute(joints)?;
        Ok(Times {
            together: trajectory.duration,
            least: trajectory.independent_min_durations.to_vec(),
        })
    }
}

/// How long each joint takes to come to rest, s, and how far it goes meanwhile (rad or m, with its sign).
///
/// # Errors
/// [`TimingError`].
pub fn stops(joints: &[(JointState, JointBounds)]) -> Result<Vec<(f64, f64)>, TimingError> {
    let to_rest: Vec<Motion> = joints
        .iter()
        .map(|(now, bounds)| (*now, JointState::default(), *bounds))
        .collect();
    check_all(&to_rest, ControlInterface::Velocity)?;
    let mut engine = Engine::new(joints.len(), ControlInterface::Velocity);
    let trajectory = engine.compute(&to_rest)?;
    let mut there = InputParameter::<0>::new(Some(joints.len())).current_position;
    let mut position = Some(&mut there);
    let end = trajectory.duration;
    trajectory.at_time(
        end,
        &mut position,
        &mut None,
        &mut None,
        &mut None,
        &mut None,
    );
    let ways = there
        .iter()
        .zip(joints)
        .map(|(at, (from, _))| at - from.position);
    let times = trajectory.independent_min_durations.iter().copied();
    Ok(times.zip(ways).collect())
}

fn check_all(joints: &[Motion], of: ControlInterface) -> Result<(), TimingError> {
    let mut numbered = joints.iter().enumerate();
    numbered
        .try_for_each(|(index, (start, end, bounds))| check(index + 1, (start, end), bounds, of))
}

/// rsruckig with its scratch: for many motions of the same joints.
pub(super) struct Engine {
    input: InputParameter<0>,
    ruckig: Ruckig<0, ThrowErrorHandler>,
    trajectory: Trajectory<0>,
}

impl Engine {
    /// For so many joints, to states or to speeds.
    pub(super) fn new(count: usize, of: ControlInterface) -> Self {
        let mut input = InputParameter::<0>::new(Some(count));
        input.synchronization = match of {
            ControlInterface::Position => Synchronization::Time,
            _ => Synchronization::None,
        };
        input.control_interface = of;
        Self {
            input,
            ruckig: Ruckig::new(Some(count), 1.0),
            trajectory: Trajectory::new(Some(count)),
        }
    }

    /// The motion of joints, of which [`check`] has found nothing wrong.
    pub(super) fn compute(&mut self, joints: &[Motion]) -> Result<&Trajectory<0>, TimingError> {
        let input = &mut self.input;
        for (index, (start, end, bounds)) in joints.iter().enumerate() {
            input.current_position[index] = start.position;
            input.current_velocity[index] = start.velocity;
            input.current_acceleration[index] = start.acceleration;
            input.target_position[index] = end.position;
            input.target_velocity[index] = end.velocity;
            input.target_acceleration[index] = end.acceleration;
            input.max_velocity[index] = bounds.velocity;
            input.max_acceleration[index] = bounds.acceleration;
            input.max_jerk[index] = bounds.jerk;
            if bounds.jerk == 0.0 {
                input.max_jerk[index] = f64::INFINITY;
                input.current_acceleration[index] = 0.0;
                input.target_acceleration[index] = 0.0;
            }
        }
        match self.ruckig.calculate(input, &mut self.trajectory)? {
            RuckigResult::Working | RuckigResult::Finished => Ok(&self.trajectory),
            other => Err(TimingError::NotFound(format!("{other:?}"))),
        }
    }
}

pub(super) fn check(
    joint: usize,
    (start, end): (&JointState, &JointState),
    bounds: &JointBounds,
    of: ControlInterface,
) -> Result<(), TimingError> {
    // To come to rest no limit of speed counts, and a jerk of 0 is none.
    let speed = (of == ControlInterface::Position).then_some(("speed", bounds.velocity));
    let jerk = (bounds.jerk != 0.0).then_some((JERK, bounds.jerk));
    let limits = [Some(("acceleration", bounds.acceleration)), speed, jerk];
    let limits = || limits.into_iter().flatten();
    if let Some((what, value)) = limits().find(|(_, value)| value.is_nan() || *value <= 0.0) {
        return Err(TimingError::Bound { joint, what, value });
    }
    let states = [
        ("position at the start", start.position),
        ("speed at the start", start.velocity),
        ("acceleration at the start", start.acceleration),
        ("position at the end", end.position),
        ("speed at the end", end.velocity),
        ("acceleration at the end", end.acceleration),
    ];
    let sensible = |value: f64| value.abs() <= LARGEST;
    let wrong_state = states.into_iter().find(|(_, value)| !sensible(*value));
    let wrong_limit = limits().find(|(_, value)| !sensible(*value) || *value < 1.0 / LARGEST);
    if let Some((what, value)) = wrong_state.or(wrong_limit) {
        return Err(TimingError::TooLarge { joint, what, value });
    }
    let beyond = |what, value: f64, limit: f64| match value.abs() <= limit {
        true => Ok(()),
        false => Err(TimingError::End {
            joint,
            what,
            value,
            limit,
        }),
    };
    if of == ControlInterface::Position {
        beyond("speed", end.velocity, bounds.velocity)?;
        if bounds.jerk > 0.0 {
            beyond("acceleration", end.acceleration, bounds.acceleration)?;
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests;
