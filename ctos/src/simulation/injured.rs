//! The injuries of an app's configuration as mishaps of a simulated run: a packet that is lost is sent
//! again and comes late, a link that is cut breaks and heals.

use crate::{config::InjuryConfig, simulation::Mishap, time::Instant};

/// The end of what lasts.
const FOR_GOOD: Instant = Instant::from_nanos(u64::MAX);

/// What `config` does to the links between the chassis of these names, from the start and later.
/// Streams have no bytes here after which they could break; that they do and are had anew is time only.
pub(super) fn mishaps(config: &InjuryConfig, names: &[String]) -> Vec<Mishap> {
    let mut all = Vec::new();
    let pairs = || {
        let firsts = names.iter().enumerate();
        firsts.flat_map(|(index, one)| names.iter().skip(index + 1).map(move |other| (one, other)))
    };
    for (one, other) in pairs() {
        let (one, other) = (one.clone(), other.clone());
        all.extend(lasting(config, &one, &other));
    }
    for cut in &config.cuts {
        all.push(Mishap::Break {
            one: cut.one.clone(),
            other: cut.other.clone(),
            at: cut.at,
            until: cut.until,
        });
    }
    all
}

/// What it does to one link from its beginning to its end.
pub(super) fn lasting(config: &InjuryConfig, one: &str, other: &str) -> Vec<Mishap> {
    let mut all = Vec::new();
    // At most 0.9, so the product fits.
    let share_ppm = (config.drop * 1e6).round() as u32;
    if share_ppm > 0 {
        all.push(Mishap::Loss {
            one: one.to_owned(),
            other: other.to_owned(),
            at: Instant::START,
            until: FOR_GOOD,
            share_ppm,
        });
    }
    let (_, extra) = config.delay;
    if !extra.is_zero() {
        all.push(Mishap::Delay {
            one: one.to_owned(),
            other: other.to_owned(),
            at: Instant::START,
            until: FOR_GOOD,
            extra,
        });
    }
    all
}
