//! Which other sites are there, by when they were last heard. Data only: it is told what time it is.

use std::{collections::BTreeMap, time::Duration};

use ctos::time::Instant;

use crate::wire::{Beat, VERSION};

/// Another site.
#[derive(Debug, Clone, Copy)]
struct Site {
    /// When it was last heard, if it ever was.
    heard: Option<Instant>,
    /// Which gate it was.
    gate: Option<Beat>,
    /// Whether that it is cut off was told.
    cut: bool,
}

/// How a site is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum State {
    /// Its gate is this run.
    There(u64),
    /// It was not heard yet, and not long enough to call it cut off.
    Awaited,
    /// It has not been heard for so long.
    Cut(Duration),
}

/// What has changed about a site.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) enum Change {
    /// It is heard: for the first time, or again after so long.
    Back(String, Option<Duration>),
    /// Nothing was heard of it for so long.
    Cut(String, Duration),
    /// Its gate was started anew: what it was asked before is lost.
    Anew(String),
    /// Its gate speaks another version.
    Foreign(String, u16),
}

/// All other sites.
#[derive(Debug)]
pub(crate) struct Sites {
    began: Instant,
    cut_after: Duration,
    all: BTreeMap<String, Site>,
}

impl Sites {
    /// Nothing was heard yet.
    pub(crate) fn new(
        names: impl IntoIterator<Item = String>,
        began: Instant,
        cut_after: Duration,
    ) -> Self {
        let silent = Site {
            heard: None,
            gate: None,
            cut: false,
        };
        Self {
            began,
            cut_after,
            all: names.into_iter().map(|name| (name, silent)).collect(),
        }
    }

    /// A gate of a site was heard.
    pub(crate) fn heard(&mut self, name: &str, beat: Beat, now: Instant) -> Vec<Change> {
        let began = self.began;
        let Some(site) = self.all.get_mut(name) else {
            return Vec::new();
        };
        if beat.version != VERSION {
            let known = site.gate.replace(beat);
            let told = known.is_some_and(|known| known.version == beat.version);
            return match told {
                true => Vec::new(),
                false => vec![Change::Foreign(name.to_owned(), beat.version)],
            };
        }
        let silent = now.since(site.heard.unwrap_or(began));
        let known = site.gate.filter(|known| known.version == VERSION);
        // Of two gates the one that was started later is meant; the other may be one that routers still know. Dates may
        // go back, so one that is silent is not waited for.
        if known.is_some_and(|known| known.run > beat.run) && silent < self.cut_after {
            return Vec::new();
        }
        let mut changes = Vec::new();
        if known.is_some_and(|known| known.run != beat.run) {
            changes.push(Change::Anew(name.to_owned()));
        }
        if site.heard.is_none() || site.cut {
            let after = site.cut.then_some(silent);
            changes.push(Change::Back(name.to_owned(), after));
        }
        *site = Site {
            heard: Some(now),
            gate: Some(beat),
            cut: false,
        };
        changes
    }

    /// Which sites have been silent for too long since it was last looked.
    pub(crate) fn look(&mut self, now: Instant) -> Vec<Change> {
        let (began, limit) = (self.began, self.cut_after);
        let mut changes = Vec::new();
        for (name, site) in &mut self.all {
            let silent = now.since(site.heard.unwrap_or(began));
            if !site.cut && silent >= limit {
                site.cut = true;
                changes.push(Change::Cut(name.clone(), silent));
            }
        }
        changes
    }

    /// How a site is; `None` for one that the app does not know.
    pub(crate) fn state(&self, name: &str, now: Instant) -> Option<State> {
        let site = self.all.get(name)?;
        let silent = now.since(site.heard.unwrap_or(self.began));
        Some(match site.gate {
            _ if site.cut || silent >= self.cut_after => State::Cut(silent),
            Some(gate) if gate.version == VERSION => State::There(gate.run),
            _ => State::Awaited,
        })
    }

    /// How long nothing was heard of a site.
    pub(crate) fn silent(&self, name: &str, now: Instant) -> Duration {
        let site = self.all.get(name);
        let heard = site.and_then(|site| site.heard);
        now.since(heard.unwrap_or(self.began))
    }

    /// All sites in words.
    pub(crate) fn words(&self, now: Instant) -> String {
        let all = self.all.keys().map(|name| match self.state(name, now) {
            Some(State::There(_)) => format!("site {name} is there"),
            Some(State::Cut(after)) => {
                format!(
                    "site {name} has been cut off for {:.0} s",
                    after.as_secs_f64()
                )
            }
            Some(State::Awaited) | None => format!("site {name} was not heard yet"),
        });
        all.collect::<Vec<_>>().join("; ")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const LIMIT: Duration = Duration::from_secs(2);

    fn at(ms: u64) -> Instant {
        Instant::from_nanos(ms * 1_000_000)
    }

    fn beat(run: u64) -> Beat {
        Beat {
            version: VERSION,
            run,
        }
    }

    fn north() -> Sites {
        Sites::new(["north".to_owned()], at(0), LIMIT)
    }

    #[test]
    fn a_site_is_awaited_then_there_then_cut_off_and_says_for_how_long() {
        let mut sites = north();
        assert_eq!(sites.state("north", at(100)), Some(State::Awaited));
        assert_eq!(
            sites.heard("north", beat(7), at(500)),
            [Change::Back("north".to_owned(), None)]
        );
        assert_eq!(sites.heard("north", beat(7), at(1000)), []);
        assert_eq!(sites.look(at(2900)), []);
        assert_eq!(sites.state("north", at(2900)), Some(State::There(7)));
        let limit = Duration::from_secs(2);
        assert_eq!(sites.state("north", at(3000)), Some(State::Cut(limit)));
        assert_eq!(
            sites.look(at(3000)),
            [Change::Cut("north".to_owned(), limit)]
        );
        assert_eq!(sites.look(at(3500)), [], "it is told once");
        let minute = Duration::from_secs(60);
        assert_eq!(sites.state("north", at(61_000)), Some(State::Cut(minute)));
        let back = sites.heard("north", beat(7), at(61_000));
        assert_eq!(back, [Change::Back("north".to_owned(), Some(minute))]);
        assert_eq!(sites.state("north", at(61_000)), Some(State::There(7)));
    }

    #[test]
    fn a_site_that_was_never_heard_is_cut_off_in_the_end() {
        let mut sites = north();
        assert_eq!(
            sites.look(at(2000)),
            [Change::Cut("north".to_owned(), LIMIT)]
        );
        assert_eq!(
            sites.state("north", at(2500)),
            Some(State::Cut(Duration::from_millis(2500)))
        );
        assert_eq!(sites.state("west", at(0)), None);
        assert_eq!(sites.heard("west", beat(1), at(0)), []);
    }

    #[test]
    fn of_two_gates_of_a_site_the_later_one_is_asked_whoever_is_heard_last() {
        let mut sites = north();
        sites.heard("north", beat(1), at(0));
        assert_eq!(
            sites.heard("north", beat(2), at(100)),
            [Change::Anew("north".to_owned())]
        );
        assert_eq!(sites.heard("north", beat(1), at(200)), []);
        assert_eq!(sites.state("north", at(200)), Some(State::There(2)));
        // The stale one keeps no site alive.
        sites.heard("north", beat(1), at(2050));
        assert_eq!(sites.state("north", at(2100)), Some(State::Cut(LIMIT)));
        // The clock of its host was set back.
        let anew = sites.heard("north", beat(1), at(2200));
        assert_eq!(anew[0], Change::Anew("north".to_owned()));
        assert_eq!(sites.state("north", at(2200)), Some(State::There(1)));
    }

    #[test]
    fn a_gate_of_another_version_is_told_once_and_not_asked() {
        let mut sites = north();
        let foreign = Beat {
            version: VERSION + 1,
            run: 1,
        };
        assert_eq!(
            sites.heard("north", foreign, at(0)),
            [Change::Foreign("north".to_owned(), VERSION + 1)]
        );
        assert_eq!(sites.heard("north", foreign, at(500)), []);
        assert_eq!(sites.state("north", at(500)), Some(State::Awaited));
        assert_eq!(sites.state("north", at(2000)), Some(State::Cut(LIMIT)));
        assert_eq!(
            sites.heard("north", beat(2), at(2500)),
            [Change::Back("north".to_owned(), None)]
        );
        // Nor once it takes the place of one that was asked.
        sites.heard("north", foreign, at(3000));
        assert_eq!(sites.state("north", at(3000)), Some(State::Awaited));
    }
}
