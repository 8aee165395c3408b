//! The guard `contact`: ends a motion that pushes something when there is nothing to push any more.
//!
//! It needs a force sensor; where none is read it finds just that.

use ctos::task::HandlerError;
use serde::Deserialize;

use super::{Guard, GuardSettings, Seen, Words};

/// The longest time for which a force may be missing, in ticks.
const MOST_TICKS: f64 = 1e6;

/// What counts as a contact.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
struct Args {
    /// Least force, N.
    force: f64,
    /// It may be less for this long, s: what is pushed stops and slips.
    #[serde(default = "within")]
    within: f64,
}

fn within() -> f64 {
    0.2
}

/// The guard.
#[derive(Debug)]
pub struct Contact {
    args: Args,
    ticks: u32,
    missing: u32,
}

impl Contact {
    /// The contact that the recipe's arguments describe.
    ///
    /// # Errors
    /// A number that is no force, or no time.
    pub fn from_args(settings: &GuardSettings<'_>) -> Result<Box<dyn Guard>, HandlerError> {
        let args: Args = settings.args.parse()?;
        Ok(Box::new(Self::new(args, settings.period.as_secs_f64())?))
    }

    fn new(args: Args, period: f64) -> Result<Self, HandlerError> {
        if !(args.force > 0.0 && args.force.is_finite()) {
            return Err(format!("`force` is above 0 N, not {}", args.force).into());
        }
        let ticks = (args.within / period).ceil();
        if !(0.0..=MOST_TICKS).contains(&ticks) {
            return Err(format!("`within` is no such time: {} s", args.within).into());
        }
        Ok(Self {
            args,
            // It is a small whole number.
            ticks: ticks as u32,
            missing: 0,
        })
    }

    fn check_load(&mut self, load: Option<&[f64; 6]>) -> Option<Words> {
        let Some([x, y, z, ..]) = load else {
            return Some("no force is measured: the arm has no sensor".into());
        };
        let force = (x * x + y * y + z * z).sqrt();
        if !force.is_finite() {
            return Some("the force sensor reads no finite number".into());
        }
        let Args {
            force: least,
            within,
        } = self.args;
        self.missing = if force >= least { 0 } else { self.missing + 1 };
        (self.missing > self.ticks)
            .then(|| crate::words!("the contact is lost: less than {least:.2} N for {within:.2} s"))
    }
}

impl Guard for Contact {
    fn begin(&mut self, _: &Seen<'_>) {
        self.missing = 0;
    }

    fn check(&mut self, seen: &Seen<'_>) -> Option<Words> {
        self.check_load(seen.force.as_ref())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn guard(force: f64, within: f64) -> Result<Contact, HandlerError> {
        Contact::new(Args { force, within }, 0.0045)
    }

    #[test]
    fn a_force_that_is_missing_for_longer_than_it_may_is_a_lost_contact() {
        let mut guard = guard(2.0, 0.018).unwrap();
        let load = |force: f64| Some([0.0, -force, 0.0, 0.0, 0.0, 0.0]);
        let mut lost = |forces: &[f64]| {
            let mut found = forces
                .iter()
                .map(|force| guard.check_load(load(*force).as_ref()).is_some());
            found.position(|found| found)
        };
        assert_eq!(lost(&[5.0, 1.0, 1.0, 1.0, 1.0, 5.0]), None);
        assert_eq!(lost(&[5.0, 1.0, 1.0, 1.0, 1.0, 1.0]), Some(5));
        assert!(guard.check_load(None).is_some());
        assert!(guard.check_load(load(f64::NAN).as_ref()).is_some());
    }

    #[test]
    fn what_is_no_contact_is_refused() {
        for (force, within) in [
            (0.0, 0.1),
            (f64::NAN, 0.1),
            (1.0, -1.0),
            (1.0, f64::INFINITY),
        ] {
            assert!(guard(force, within).is_err(), "{force} {within}");
        }
    }
}
