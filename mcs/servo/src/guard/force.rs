//! The guard `force`: patterns of force and torque on the tool. A threshold, perhaps in one direction only, and a rise
//! within a short time.
//!
//! It needs a force sensor; where none is read it finds just that, so that no motion relies on it in vain. A threshold
//! that is exceeded already when a motion begins (the arm moves out of a contact) counts again once it is met; until then
//! the load may be a tenth more than it was.

use std::time::Duration;

use ctos::task::HandlerError;
use nalgebra::Vector3;
use serde::Deserialize;

use super::{Guard, GuardSettings, Seen, Words};

/// What of a load counts as too much; all of it in the sensor's frame.
#[derive(Debug, Clone, PartialEq, Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
struct Args {
    /// Largest force, N.
    force: Option<f64>,
    /// Largest torque, N m.
    torque: Option<f64>,
    /// Only the force's part in this direction counts.
    direction: Option<[f64; 3]>,
    /// Largest rise of the force, N,
    rise: Option<f64>,
    /// within this time, s.
    within: Option<f64>,
}

/// The guard.
#[derive(Debug)]
pub struct Force {
    args: Args,
    /// The forces of the latest ticks, N, the oldest one at `oldest`.
    past: Vec<f64>,
    oldest: usize,
    /// Of the force and of the torque: what it may be until it is below the limit again.
    relief: [f64; 2],
}

/// How much more a load may become than what it was at the beginning.
const MORE: f64 = 1.1;
/// A rise is looked for within this, s, unless the recipe says otherwise.
const WITHIN: f64 = 0.02;
/// The longest time, in ticks, within which a rise is looked for.
const MOST_TICKS: usize = 1000;

impl Force {
    /// The pattern that the recipe's arguments describe.
    ///
    /// # Errors
    /// A number that is no limit, or no limit at all.
    pub fn from_args(settings: &GuardSettings<'_>) -> Result<Box<dyn Guard>, HandlerError> {
        let args: Args = settings.args.parse()?;
        Ok(Box::new(Self::new(args, settings.period)?))
    }

    fn new(mut args: Args, period: Duration) -> Result<Self, HandlerError> {
        if args.force.is_none() && args.torque.is_none() && args.rise.is_none() {
            return Err("it limits nothing: give `force`, `torque` or `rise`".into());
        }
        let limits = [args.force, args.torque, args.rise, args.within];
        let mut limits = limits.iter().flatten();
        if let Some(wrong) = limits.find(|limit| !(limit.is_finite() && **limit > 0.0)) {
            return Err(format!("a limit of a force pattern is above zero, not {wrong}").into());
        }
        if let Some(direction) = &mut args.direction {
            let unit = Vector3::from(*direction).try_normalize(1e-9);
            let unit = unit.filter(|unit| unit.iter().all(|number| number.is_finite()));
            *direction = unit.ok_or("`direction` has none")?.into();
        }
        let ticks = args.within.unwrap_or(WITHIN) / period.as_secs_f64();
        let ticks = (ticks.ceil() as usize).clamp(1, MOST_TICKS);
        Ok(Self {
            past: vec![f64::NAN; ticks],
            args,
            oldest: 0,
            relief: [0.0; 2],
        })
    }

    /// What counts of a load: force, N, and torque, N m.
    fn measure(&self, load: &[f64; 6]) -> [f64; 2] {
        let [x, y, z, a, b, c] = *load;
        let force = Vector3::new(x, y, z);
        let counts = self.args.direction.map_or_else(
            || force.norm(),
            |direction| force.dot(&Vector3::from(direction)),
        );
        [counts, Vector3::new(a, b, c).norm()]
    }

    fn begin_with(&mut self, load: Option<&[f64; 6]>) {
        self.past.fill(f64::NAN);
        let now = load.map_or([0.0; 2], |load| self.measure(load));
        self.relief = now.map(|value| value * MORE);
    }

    fn check_load(&mut self, load: Option<&[f64; 6]>) -> Option<Words> {
        let Some(load) = load else {
            return Some("no force is measured: the arm has no sensor".into());
        };
        if load.iter().any(|number| !number.is_finite()) {
            return Some("the force sensor reads no finite number".into());
        }
        let measured = self.measure(load);
        let [force, torque] = measured;
        let limits = [self.args.force, self.args.torque];
        for (index, limit) in limits.into_iter().enumerate() {
            let Some(limit) = limit else { continue };
            if measured[index] <= limit {
                self.relief[index] = 0.0;
            }
            if measured[index] > limit.max(self.relief[index]) {
                let ([what, unit], value) = match index {
                    0 => (["force", "N"], force),
                    _ => (["torque", "N m"], torque),
                };
                return Some(crate::words!(
                    "the {what} is {value:.2} {unit}, the limit is {limit:.2} {unit}"
                ));
            }
        }
        let place = self.past.get_mut(self.oldest)?;
        let before = std::mem::replace(place, force);
        self.oldest = (self.oldest + 1) % self.past.len();
        let rise = self.args.rise?;
        let rose = force - before;
        // The first forces of a motion have nothing before them, and compare with nothing.
        (rose > rise).then(|| {
            let within = self.args.within.unwrap_or(WITHIN);
            crate::words!(
                "the force rose by {rose:.2} N within {within:.3} s, the limit is {rise:.2} N"
            )
        })
    }
}

impl Guard for Force {
    fn begin(&mut self, seen: &Seen<'_>) {
        self.begin_with(seen.force.as_ref());
    }

    fn check(&mut self, seen: &Seen<'_>) -> Option<Words> {
        self.check_load(seen.force.as_ref())
    }

    fn feels(&self) -> bool {
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PERIOD: Duration = Duration::from_micros(4500);

    fn guard(args: Args) -> Force {
        let mut guard = Force::new(args, PERIOD).unwrap();
        guard.begin_with(Some(&[0.0; 6]));
        guard
    }

    fn load(force: f64, torque: f64) -> Option<[f64; 6]> {
        Some([0.0, 0.0, force, 0.0, torque, 0.0])
    }

    #[test]
    fn a_force_beyond_its_limit_is_found_in_the_tick_in_which_it_is_read() {
        let args = Args {
            force: Some(10.0),
            torque: Some(2.0),
            ..Args::default()
        };
        let mut guard = guard(args);
        assert_eq!(guard.check_load(load(9.9, 1.9).as_ref()), None);
        let found = guard.check_load(load(10.1, 0.0).as_ref()).unwrap();
        assert_eq!(found.as_str(), "the force is 10.10 N, the limit is 10.00 N");
        assert!(guard.check_load(load(0.0, -2.1).as_ref()).is_some());
        assert!(guard.check_load(None).is_some());
        assert!(guard.check_load(load(f64::NAN, 0.0).as_ref()).is_some());
    }

    #[test]
    fn with_a_direction_only_the_force_in_it_counts() {
        let args = Args {
            force: Some(10.0),
            direction: Some([0.0, 0.0, -2.0]),
            ..Args::default()
        };
        let mut guard = guard(args);
        assert_eq!(guard.check_load(load(50.0, 0.0).as_ref()), None);
        assert!(guard.check_load(load(-11.0, 0.0).as_ref()).is_some());
    }

    #[test]
    fn a_quick_rise_is_found_and_a_slow_one_to_the_same_force_is_not() {
        let args = Args {
            rise: Some(5.0),
            within: Some(0.018),
            ..Args::default()
        };
        let mut slow = guard(args.clone());
        for tick in 0..40 {
            // 4 N in four ticks.
            assert_eq!(slow.check_load(load(f64::from(tick), 0.0).as_ref()), None);
        }
        let mut quick = guard(args);
        let found = (0..10).position(|tick| {
            quick
                .check_load(load(2.0 * f64::from(tick), 0.0).as_ref())
                .is_some()
        });
        // 8 N in four ticks: as soon as four are behind.
        assert_eq!(found, Some(4));
    }

    #[test]
    fn a_motion_out_of_a_contact_is_allowed_and_one_further_into_it_is_not() {
        let args = Args {
            force: Some(10.0),
            ..Args::default()
        };
        let mut guard = guard(args);
        guard.begin_with(load(20.0, 0.0).as_ref());
        for force in [20.0, 21.0, 15.0, 9.0] {
            assert_eq!(guard.check_load(load(force, 0.0).as_ref()), None, "{force}");
        }
        assert!(guard.check_load(load(15.0, 0.0).as_ref()).is_some());
        guard.begin_with(load(20.0, 0.0).as_ref());
        assert!(guard.check_load(load(23.0, 0.0).as_ref()).is_some());
    }
}
