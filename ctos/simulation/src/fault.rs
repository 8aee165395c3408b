//! What can go wrong in a simulated app: what, where and when, with its words for people.

use std::{fmt, time::Duration};

use ctos_time::Instant;

use crate::reader::nanos;

/// Something that goes wrong in a simulated app, and when, in true time.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Fault {
    /// What.
    pub kind: FaultKind,
    /// Where.
    pub site: Site,
    /// When; of what is wrong from the start, [`Instant::START`].
    pub at: Instant,
    /// When it is over; `None` for what has no end, or no length.
    pub until: Option<Instant>,
}

/// Where a fault happens. `boot` is the name of the chassis that boots.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Site {
    /// On a chassis.
    Chassis(String),
    /// On the link between two.
    Link(String, String),
}

impl Site {
    /// The chassis concerned.
    pub(crate) fn chassis(&self) -> impl Iterator<Item = &String> {
        let (one, other) = match self {
            Self::Chassis(one) => (one, None),
            Self::Link(one, other) => (one, Some(other)),
        };
        std::iter::once(one).chain(other)
    }
}

/// What goes wrong.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FaultKind {
    /// The process of a chassis ends at once, as by `kill -9`.
    Kill,
    /// A person has a chassis restarted, as `ctos restart CHASSIS` does.
    Restart,
    /// The link between two chassis is refused for good, which both notice at once; what is under way
    /// is lost. Each then holds the other for gone.
    Cut,
    /// The link between two chassis breaks and heals. What was not received is sent again, in its
    /// order. But a chassis that hears nothing for longer than the peer time-out gives the other up.
    Break,
    /// As [`Self::Break`], but what is under way already still arrives.
    Stall,
    /// A share of what is sent between two chassis is lost on its way and sent again, so it and what
    /// follows it come late.
    Loss {
        /// How many of 10^6 frames are lost.
        share_ppm: u32,
    },
    /// What is sent between two chassis takes longer, each frame differently.
    Delay {
        /// At most so much longer.
        extra: Duration,
    },
    /// The process of a chassis stands still, as by SIGSTOP. When it goes on after the others have
    /// given it up, it is told.
    Freeze,
    /// The processors of a chassis are slow: whatever a task does between two waits takes this long.
    Slow {
        /// How long each step takes.
        per_step: Duration,
    },
    /// The clock of a chassis is wrong from the start.
    Drift {
        /// What it shows when the app starts.
        ahead: Duration,
        /// How much faster than the true time it runs, ns per s; slower when negative.
        rate_ppb: i32,
    },
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
pub(crate) static KINDS: [Kind; 9] = [
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

impl FaultKind {
    /// What a file calls `kind`. `extent` is how bad it is: a share, or a time in s. `None` for a drift, and for
    /// a word that is not a kind.
    pub(crate) fn of(kind: &str, extent: f64) -> Option<Self> {
        Some(match kind {
            "kill" => Self::Kill,
            "restart" => Self::Restart,
            "freeze" => Self::Freeze,
            "refuse" => Self::Cut,
            "cut" => Self::Break,
            "stall" => Self::Stall,
            "slow" => Self::Slow {
                per_step: nanos(extent),
            },
            "loss" => Self::Loss {
                share_ppm: (extent * 1e6).round() as u32,
            },
            "delay" => Self::Delay {
                extra: nanos(extent),
            },
            _ => return None,
        })
    }

    /// Its word in a file of faults.
    #[must_use]
    pub fn word(self) -> &'static str {
        self.words().0
    }

    /// With its article, for errors.
    pub(crate) fn called(self) -> &'static str {
        self.words().1
    }

    /// Its word in a file of faults, and with its article, for errors.
    fn words(self) -> (&'static str, &'static str) {
        match self {
            Self::Kill => ("kill", "a kill"),
            Self::Restart => ("restart", "a restart"),
            Self::Cut => ("refuse", "a cut"),
            Self::Break => ("cut", "a cut"),
            Self::Stall => ("stall", "a stall"),
            Self::Loss { .. } => ("loss", "a loss"),
            Self::Delay { .. } => ("delay", "a delay"),
            Self::Freeze => ("freeze", "a freeze"),
            Self::Slow { .. } => ("slow", "a slow processor"),
            Self::Drift { .. } => ("drift", "a drift"),
        }
    }
}

impl Fault {
    /// A fault on a chassis, which has no end, or no length.
    #[must_use]
    pub fn on(chassis: impl Into<String>, kind: FaultKind, at: Instant) -> Self {
        Self {
            kind,
            site: Site::Chassis(chassis.into()),
            at,
            until: None,
        }
    }

    /// A fault of the link between two chassis, which has no end, or no length.
    #[must_use]
    pub fn between(
        one: impl Into<String>,
        other: impl Into<String>,
        kind: FaultKind,
        at: Instant,
    ) -> Self {
        let site = Site::Link(one.into(), other.into());
        Self {
            site,
            ..Self::on("", kind, at)
        }
    }

    /// The same until a moment.
    #[must_use]
    pub fn until(self, until: Instant) -> Self {
        let until = Some(until);
        Self { until, ..self }
    }
}

impl fmt::Display for Fault {
    /// `cut    desk - cage  at 1.250000 s for 0.3 s`
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:<7}", self.kind.word())?;
        match &self.site {
            Site::Chassis(chassis) => write!(f, "{chassis}")?,
            Site::Link(one, other) => write!(f, "{one} - {other}")?,
        }
        if let FaultKind::Drift { ahead, rate_ppb } = self.kind {
            let ppm = f64::from(rate_ppb) / 1e3;
            return write!(f, ": {:.3} s ahead, {ppm:+.3} ppm", ahead.as_secs_f64());
        }
        write!(f, " at {}", self.at)?;
        if let Some(until) = self.until {
            write!(f, " for {:.3} s", until.since(self.at).as_secs_f64())?;
        }
        match self.kind {
            FaultKind::Loss { share_ppm } => {
                write!(f, ": {:.1} % of the frames", f64::from(share_ppm) / 1e4)
            }
            FaultKind::Delay { extra } => {
                write!(f, ": up to {:.1} ms more", extra.as_secs_f64() * 1e3)
            }
            FaultKind::Slow { per_step } => {
                write!(f, ": {:.3} ms a step", per_step.as_secs_f64() * 1e3)
            }
            _ => Ok(()),
        }
    }
}
