//! What can go wrong in a simulated app: one enum, with its words for people.

use std::{fmt, time::Duration};

use ctos_time::Instant;

use crate::reader::nanos;

/// Something that goes wrong in a simulated app, and when, in true time. `boot` is the name of the
/// chassis that boots.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Fault {
    /// The process of a chassis ends at once, as by `kill -9`.
    Kill {
        /// Its name.
        chassis: String,
        /// When.
        at: Instant,
    },
    /// A person has a chassis restarted, as `ctos restart CHASSIS` does.
    Restart {
        /// Its name.
        chassis: String,
        /// When.
        at: Instant,
    },
    /// The link between two chassis is refused for good, which both notice at once; what is under way
    /// is lost. Each then holds the other for gone.
    Cut {
        /// One end.
        one: String,
        /// The other end.
        other: String,
        /// When.
        at: Instant,
    },
    /// The link between two chassis breaks and heals. What was not received is sent again, in its
    /// order; but a chassis that hears nothing for longer than the peer time-out gives the other up.
    Break {
        /// One end.
        one: String,
        /// The other end.
        other: String,
        /// From when.
        at: Instant,
        /// When it heals.
        until: Instant,
    },
    /// As [`Self::Break`], but what is under way already still arrives.
    Stall {
        /// One end.
        one: String,
        /// The other end.
        other: String,
        /// From when.
        at: Instant,
        /// Until when.
        until: Instant,
    },
    /// A share of what is sent between two chassis is lost on its way and sent again, so it and what
    /// follows it come late.
    Loss {
        /// One end.
        one: String,
        /// The other end.
        other: String,
        /// From when.
        at: Instant,
        /// Until when.
        until: Instant,
        /// How many of 10^6 frames are lost.
        share_ppm: u32,
    },
    /// What is sent between two chassis takes longer, each frame differently.
    Delay {
        /// One end.
        one: String,
        /// The other end.
        other: String,
        /// From when.
        at: Instant,
        /// Until when.
        until: Instant,
        /// At most so much longer.
        extra: Duration,
    },
    /// The process of a chassis stands still, as by SIGSTOP. When it goes on after the others have
    /// given it up, it is told.
    Freeze {
        /// Its name.
        chassis: String,
        /// From when.
        at: Instant,
        /// Until when.
        until: Instant,
    },
    /// The processors of a chassis are slow: whatever a task does between two waits takes this long.
    Slow {
        /// Its name.
        chassis: String,
        /// From when.
        at: Instant,
        /// Until when.
        until: Instant,
        /// How long each step takes.
        per_step: Duration,
    },
    /// The clock of a chassis is wrong from the start.
    Drift {
        /// Its name.
        chassis: String,
        /// What it shows when the app starts.
        ahead: Duration,
        /// How much faster than the true time it runs, ns per s; slower when negative.
        rate_ppb: i32,
    },
}

/// Where a fault happens.
pub(crate) enum Site<'a> {
    /// On a chassis.
    Chassis(&'a str),
    /// Between two.
    Link(&'a str, &'a str),
}

/// A kind of fault, as files of faults name it.
pub(crate) struct Kind {
    pub(crate) word: &'static str,
    /// Its word in the seed of its generator; empty: no profile draws it.
    pub(crate) seed: &'static str,
    /// Between two chassis, or on one.
    pub(crate) on_link: bool,
    pub(crate) lasts: bool,
    /// The key that says how bad it is.
    pub(crate) extent: Option<&'static str>,
}

const fn kind(
    word: &'static str,
    seed: &'static str,
    (on_link, lasts): (bool, bool),
    extent: Option<&'static str>,
) -> Kind {
    Kind {
        word,
        seed,
        on_link,
        lasts,
        extent,
    }
}

/// All kinds but the drift of clocks, which has no moment.
pub(crate) const KINDS: [Kind; 9] = [
    kind("loss", "Loss", (true, true), Some("share")),
    kind("delay", "Delay", (true, true), Some("extra_s")),
    kind("stall", "Stall", (true, true), None),
    kind("cut", "Break", (true, true), None),
    kind("refuse", "", (true, false), None),
    kind("freeze", "Freeze", (false, true), None),
    kind("slow", "Slow", (false, true), Some("step_s")),
    kind("kill", "Kill", (false, false), None),
    kind("restart", "", (false, false), None),
];

impl Fault {
    /// The fault that a file calls `kind`, on chassis `one` or between it and `other`. `extent` is how bad it is: a
    /// share, or a time in s. `None` for a drift, and for a word that is no kind.
    pub(crate) fn new(
        kind: &str,
        (one, other): (String, String),
        at: Instant,
        until: Instant,
        extent: f64,
    ) -> Option<Self> {
        let fault = match kind {
            "kill" => Self::Kill { chassis: one, at },
            "restart" => Self::Restart { chassis: one, at },
            "freeze" => Self::Freeze {
                chassis: one,
                at,
                until,
            },
            "slow" => Self::Slow {
                chassis: one,
                at,
                until,
                per_step: nanos(extent),
            },
            "refuse" => Self::Cut { one, other, at },
            "cut" => Self::Break {
                one,
                other,
                at,
                until,
            },
            "stall" => Self::Stall {
                one,
                other,
                at,
                until,
            },
            "loss" => Self::Loss {
                one,
                other,
                at,
                until,
                share_ppm: (extent * 1e6).round() as u32,
            },
            "delay" => Self::Delay {
                one,
                other,
                at,
                until,
                extra: nanos(extent),
            },
            _ => return None,
        };
        Some(fault)
    }

    /// Its word in a file of faults, and with its article, for errors.
    fn words(&self) -> (&'static str, &'static str) {
        match self {
            Self::Kill { .. } => ("kill", "a kill"),
            Self::Restart { .. } => ("restart", "a restart"),
            Self::Cut { .. } => ("refuse", "a cut"),
            Self::Break { .. } => ("cut", "a cut"),
            Self::Stall { .. } => ("stall", "a stall"),
            Self::Loss { .. } => ("loss", "a loss"),
            Self::Delay { .. } => ("delay", "a delay"),
            Self::Freeze { .. } => ("freeze", "a freeze"),
            Self::Slow { .. } => ("slow", "a slow processor"),
            Self::Drift { .. } => ("drift", "a drift"),
        }
    }

    /// When it happens.
    #[must_use]
    pub fn at(&self) -> Instant {
        match self {
            Self::Kill { at, .. }
            | Self::Restart { at, .. }
            | Self::Cut { at, .. }
            | Self::Break { at, .. }
            | Self::Stall { at, .. }
            | Self::Loss { at, .. }
            | Self::Delay { at, .. }
            | Self::Freeze { at, .. }
            | Self::Slow { at, .. } => *at,
            Self::Drift { .. } => Instant::START,
        }
    }

    /// When it is over; `None` for what lasts.
    #[must_use]
    pub fn until(&self) -> Option<Instant> {
        match self {
            Self::Break { until, .. }
            | Self::Stall { until, .. }
            | Self::Loss { until, .. }
            | Self::Delay { until, .. }
            | Self::Freeze { until, .. }
            | Self::Slow { until, .. } => Some(*until),
            _ => None,
        }
    }

    /// Its word in a file of faults.
    #[must_use]
    pub fn kind(&self) -> &'static str {
        self.words().0
    }

    pub(crate) fn site(&self) -> Site<'_> {
        match self {
            Self::Kill { chassis, .. }
            | Self::Restart { chassis, .. }
            | Self::Freeze { chassis, .. }
            | Self::Slow { chassis, .. }
            | Self::Drift { chassis, .. } => Site::Chassis(chassis),
            Self::Cut { one, other, .. }
            | Self::Break { one, other, .. }
            | Self::Stall { one, other, .. }
            | Self::Loss { one, other, .. }
            | Self::Delay { one, other, .. } => Site::Link(one, other),
        }
    }

    /// With its article, for errors.
    pub(crate) fn called(&self) -> &'static str {
        self.words().1
    }
}

impl fmt::Display for Fault {
    /// `cut    desk - cage  at 1.250000 s for 0.3 s`
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:<7}", self.kind())?;
        match self.site() {
            Site::Chassis(chassis) => write!(f, "{chassis}")?,
            Site::Link(one, other) => write!(f, "{one} - {other}")?,
        }
        if let Self::Drift {
            ahead, rate_ppb, ..
        } = self
        {
            let ppm = f64::from(*rate_ppb) / 1e3;
            return write!(f, ": {:.3} s ahead, {ppm:+.3} ppm", ahead.as_secs_f64());
        }
        write!(f, " at {}", self.at())?;
        if let Some(until) = self.until() {
            write!(f, " for {:.3} s", until.since(self.at()).as_secs_f64())?;
        }
        match self {
            Self::Loss { share_ppm, .. } => {
                write!(f, ": {:.1} % of the frames", f64::from(*share_ppm) / 1e4)
            }
            Self::Delay { extra, .. } => {
                write!(f, ": up to {:.1} ms more", extra.as_secs_f64() * 1e3)
            }
            Self::Slow { per_step, .. } => {
                write!(f, ": {:.3} ms a step", per_step.as_secs_f64() * 1e3)
            }
            _ => Ok(()),
        }
    }
}
