//! What a person has done to a net: pauses, steps and breakpoints. It knows the net and its marking, and neither
//! who orders nor what follows.

use std::collections::BTreeSet;

use ctos::diagnostic::Finding;
use pnt_language::{
    exec::Execution,
    net::{Net, PlaceId, TransitionId},
};
use thiserror::Error;

use crate::stream::NetView;

/// What a person has done to a net, and where it shall stop.
#[derive(Debug, Default)]
pub(super) struct Manual {
    /// Why nothing is fired.
    pub(super) paused: Option<String>,
    /// Firings that may begin nevertheless.
    pub(super) steps: u32,
    breakpoints: Vec<Breakpoint>,
    /// The transition at which it stands: it does not stop there again when it goes on.
    stands_at: Option<TransitionId>,
    /// A breakpoint that was met and not told yet.
    pub(super) met: Option<String>,
}

#[derive(Debug, Clone)]
struct Breakpoint {
    /// As it was written, but for a transition with its name in the net.
    text: String,
    at: At,
    /// Whether the condition held when it was looked at last.
    held: bool,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum At {
    Transition(TransitionId),
    Place(PlaceId, Comparison, u32),
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Comparison {
    AtLeast,
    AtMost,
    Equal,
}

/// A breakpoint that cannot be.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
pub(super) enum BreakError {
    #[error(
        "`{0}` is no breakpoint: write the name of a transition, or PLACE>=N, PLACE<=N or PLACE=N"
    )]
    Form(String),
    #[error("net `{net}` has no {what} `{name}`; there are: {}", .known.join(", "))]
    Unknown {
        net: String,
        what: &'static str,
        name: String,
        known: Vec<String>,
    },
    #[error("there is no breakpoint `{0}`; there are: {1}")]
    NotSet(String, String),
}

impl Breakpoint {
    fn parse(text: &str, net: &Net) -> Result<Self, BreakError> {
        let comparisons = [
            (">=", Comparison::AtLeast),
            ("<=", Comparison::AtMost),
            ("==", Comparison::Equal),
            ("=", Comparison::Equal),
        ];
        let unknown = |what, name: &str, known: Vec<String>| BreakError::Unknown {
            net: net.name().to_owned(),
            what,
            name: name.to_owned(),
            known,
        };
        let split = comparisons.iter().find_map(|(sign, comparison)| {
            let (place, number) = text.split_once(sign)?;
            Some((place.trim(), *comparison, number.trim()))
        });
        let at = if let Some((name, comparison, number)) = split {
            let number = number
                .parse()
                .map_err(|_| BreakError::Form(text.to_owned()))?;
            let names = || net.places().iter().map(|place| place.name.clone());
            let place = net.place(name);
            let place = place.ok_or_else(|| unknown("place", name, names().collect()))?;
            At::Place(place, comparison, number)
        } else {
            let name = text.trim();
            // As the author of the net calls them.
            let names = || {
                let all = NetView::new(net).transitions.into_iter();
                let names: BTreeSet<String> = all.map(|one| one.shown).collect();
                names.into_iter()
            };
            // One that asks another net is two in the net: before it is asked, and after it has answered.
            let transition = net.written(name);
            let transition =
                transition.ok_or_else(|| unknown("transition", name, names().collect()))?;
            At::Transition(transition)
        };
        let text = match at {
            At::Transition(transition) => net[transition].called().to_owned(),
            At::Place(..) => text.to_owned(),
        };
        let held = false;
        Ok(Self { text, at, held })
    }

    fn holds(&self, execution: &Execution) -> bool {
        let At::Place(place, comparison, number) = self.at else {
            return false;
        };
        let held = execution.marking().get(place.index()).copied();
        let held = held.unwrap_or(0);
        match comparison {
            Comparison::AtLeast => held >= number,
            Comparison::AtMost => held <= number,
            Comparison::Equal => held == number,
        }
    }
}

/// The same breakpoint as displays name it.
pub(super) fn name_of(text: &str, net: &Net) -> String {
    Breakpoint::parse(text, net).map_or_else(|_| text.to_owned(), |breakpoint| breakpoint.text)
}

/// Whether a net has what a breakpoint names: `TRANSITION`, `PLACE>=N`, `PLACE<=N` or `PLACE=N`.
///
/// # Errors
/// What is wrong with it, without a place.
pub fn check_breakpoint(text: &str, net: &Net) -> Result<(), Finding> {
    const CODE: &str = "pnt::task::breakpoint";
    match Breakpoint::parse(text, net) {
        Ok(_) => Ok(()),
        Err(BreakError::Unknown {
            net,
            what,
            name,
            known,
        }) => {
            let finding = Finding::error(CODE, format!("net `{net}` has no {what} `{name}`"));
            Err(finding.suggest(&name, known.iter().map(String::as_str)))
        }
        Err(error) => Err(Finding::error(CODE, error.to_string())),
    }
}

impl Manual {
    /// Why it is paused.
    pub(super) fn paused(&self) -> Option<&str> {
        self.paused.as_deref()
    }

    /// Whether no firing may begin.
    #[inline]
    pub(super) fn is_stopped(&self) -> bool {
        self.paused.is_some() && self.steps == 0
    }

    pub(super) fn pause(&mut self, why: String) {
        self.paused = Some(why);
        self.steps = 0;
    }

    /// The breakpoints as they were written.
    pub(super) fn breakpoints(&self) -> Vec<String> {
        self.breakpoints.iter().map(|b| b.text.clone()).collect()
    }

    pub(super) fn set(&mut self, text: &str, execution: &Execution) -> Result<(), BreakError> {
        let mut breakpoint = Breakpoint::parse(text, execution.net())?;
        // What holds already has not become true.
        breakpoint.held = breakpoint.holds(execution);
        self.breakpoints
            .retain(|other| other.text != breakpoint.text);
        self.breakpoints.push(breakpoint);
        Ok(())
    }

    pub(super) fn clear(&mut self, at: Option<&str>, net: &Net) -> Result<(), BreakError> {
        let Some(at) = at else {
            self.breakpoints.clear();
            return Ok(());
        };
        let before = self.breakpoints.len();
        let named = name_of(at, net);
        self.breakpoints
            .retain(|breakpoint| breakpoint.text != named);
        if self.breakpoints.len() == before {
            let there = self.breakpoints().join(", ");
            return Err(BreakError::NotSet(at.to_owned(), there));
        }
        Ok(())
    }

    #[inline]
    pub(super) fn has_breakpoints(&self) -> bool {
        !self.breakpoints.is_empty()
    }

    /// Holds the places against the breakpoints after a change.
    pub(super) fn watch_places(&mut self, execution: &Execution) {
        for breakpoint in &mut self.breakpoints {
            let holds = breakpoint.holds(execution);
            if holds && !breakpoint.held {
                let why = format!("breakpoint `{}`", breakpoint.text);
                self.paused = Some(why.clone());
                self.steps = 0;
                self.met = Some(why);
            }
            breakpoint.held = holds;
        }
    }

    /// Keeps the breakpoints that another net has too.
    pub(super) fn replaced(&mut self, execution: &Execution) {
        let texts = self.breakpoints();
        self.breakpoints.clear();
        self.stands_at = None;
        for text in texts {
            if self.set(&text, execution).is_err() {
                tracing::warn!(target: "pnt::net", breakpoint = %text, "the new net has no such place or transition");
            }
        }
    }

    /// Whether a transition that was chosen may fire now.
    #[inline]
    pub(super) fn passes(&mut self, id: TransitionId) -> bool {
        let stood = self.stands_at.take() == Some(id);
        let mut breakpoints = self.breakpoints.iter();
        let breakpoint = breakpoints.find(|b| b.at == At::Transition(id));
        if let Some(breakpoint) = breakpoint
            && !stood
        {
            let why = format!("breakpoint `{}`", breakpoint.text);
            self.paused = Some(why.clone());
            self.steps = 0;
            self.stands_at = Some(id);
            self.met = Some(why);
            return false;
        }
        self.steps = self.steps.saturating_sub(1);
        true
    }
}
