//! Everything that one look at a model tells, in numbers, whichever engine found it.

#[cfg(test)]
mod tests;

use super::{
    explicit::{Explored, Limits, Progress, Stopped, explore_with},
    model::{Model, TransitionNumber},
    returns::{Returns, returns},
    stubborn,
    symbolic::{self, Counted, Effort},
};

/// How the two engines take turns where either may succeed. Diagrams that work are soon done, so they are given up
/// soon. They are tried again only when listing has taken longer than they may.
#[derive(Debug, Clone, Copy)]
struct Turns {
    /// Markings that are always listed before anything else is tried.
    listed_first: usize,
    /// What diagrams may take then.
    diagrams_first: Effort,
    /// Markings that are listed next.
    listed_next: usize,
    /// What diagrams may take then. After that, markings are listed up to the limits.
    diagrams_next: Effort,
}

/// A step of a diagram takes about as long as a marking that is listed.
const TURNS: Turns = Turns {
    listed_first: 200_000,
    diagrams_first: Effort {
        bytes: 16 << 20,
        steps: 1_000_000,
    },
    listed_next: 8_000_000,
    diagrams_next: Effort {
        bytes: 256 << 20,
        steps: 100_000_000,
    },
};

/// The engine that found the reachable markings.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Engine {
    /// One marking after the other.
    Explicit,
    /// Sets of markings as decision diagrams.
    Symbolic,
}

/// What is known about a model. Where something is `None`, a limit came first.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Verdict {
    /// What found it.
    pub engine: Engine,
    /// Reachable markings; those found so far when not `complete`.
    pub markings: u128,
    /// Pairs of a reachable marking and a transition enabled in it.
    pub edges: u128,
    /// The most tokens in each place.
    pub bounds: Vec<u32>,
    /// The most tokens in a marking.
    pub most_tokens: u64,
    /// Whether every place has a bound.
    pub bounded: Option<bool>,
    /// Whether no place ever holds more than one token.
    pub safe: Option<bool>,
    /// Markings that nothing is sure to leave.
    pub deadlocks: u128,
    /// Whether there is none: also known, by stubborn sets, of some nets with more markings than the
    /// limits permit.
    pub deadlock_free: Option<bool>,
    /// Whether every transition can become enabled again from every reachable marking.
    pub live: Option<bool>,
    /// Whether the initial marking can be reached from every reachable one.
    pub reversible: Option<bool>,
    /// Markings that can be reached from every reachable one.
    pub home_states: Option<u128>,
    /// Per label of the model, whether one of its transitions is enabled somewhere.
    pub seen: Vec<bool>,
    /// Whether all reachable markings were found.
    pub complete: bool,
    /// What ended the search before.
    pub stopped: Option<Stopped>,
    /// Bytes for the markings and what finds them, at most at any time.
    pub peak_bytes: usize,
    /// Steps of decision diagrams, those that were given up included.
    pub diagram_steps: u64,
}

/// What was explored one by one, and what follows for the long run.
pub struct Looked<'a> {
    /// The markings.
    pub explored: Explored<'a>,
    /// Where they lead, when all were found and memory permitted.
    pub returns: Option<Returns>,
    /// All of it in numbers.
    pub verdict: Verdict,
    /// A shortest firing sequence to the nearest dead marking, and that marking, where decision
    /// diagrams found one.
    pub deadlock: Option<(Vec<TransitionNumber>, Vec<u32>)>,
}

/// Which engines may be used.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Engines {
    /// What suits the net.
    #[default]
    Both,
    /// One marking after the other.
    Explicit,
    /// Decision diagrams if the net permits it.
    Symbolic,
}

/// Explores a model. It lists the markings if they are few. Else it counts them by decision diagrams, where
/// that is permitted and works, or lists them as far as the limits permit. Where either may do, the two take
/// turns with growing effort. So a net that suits only one of them does not wait long for the other.
/// Stubborn sets look for dead markings among the rest, where they apply.
#[must_use]
pub fn look<'a>(
    model: &'a Model,
    limits: &Limits,
    engines: Engines,
    progress: &mut dyn FnMut(&Progress),
) -> Looked<'a> {
    let mut looked = choose(model, limits, engines, TURNS, progress);
    look_for_deadlock(&mut looked, limits, progress);
    looked
}

fn choose<'a>(
    model: &'a Model,
    limits: &Limits,
    engines: Engines,
    turns: Turns,
    progress: &mut dyn FnMut(&Progress),
) -> Looked<'a> {
    let listed_first = match engines {
        Engines::Explicit => usize::MAX,
        Engines::Both => turns.listed_first,
        Engines::Symbolic => 1,
    };
    if limits.markings <= listed_first || !symbolic::fits(model) {
        return list(model, limits, progress);
    }
    let up_to = |markings: usize| Limits {
        markings: limits.markings.min(markings),
        ..*limits
    };
    let first = list(model, &up_to(listed_first), progress);
    if first.verdict.complete || first.verdict.bounded.is_some() {
        return first;
    }
    let mut steps = 0;
    let mut count = |effort: Effort, whole: bool| {
        let bytes = limits.bytes.min(effort.bytes);
        let counted = symbolic::count(model, Effort { bytes, ..effort }, limits.stop);
        steps += counted
            .as_ref()
            .map_or_else(|gave_up| gave_up.steps, |counted| counted.steps);
        let counted = counted.ok().filter(|counted| {
            counted.markings <= limits.markings as u128 && (counted.is_whole() || !whole)
        });
        (counted, steps)
    };
    if engines == Engines::Both {
        if let (Some(counted), _) = count(turns.diagrams_first, true) {
            return counted_look(first, counted);
        }
        if limits.stop.is_set() {
            return stopped(first, steps);
        }
        let next = up_to(turns.listed_next);
        let mut listed = list(model, &next, progress);
        let enough = next.markings == limits.markings;
        if enough || listed.verdict.stopped != Some(Stopped::Markings) {
            listed.verdict.diagram_steps = steps;
            return listed;
        }
    }
    let (counted, steps) = count(
        match engines {
            Engines::Symbolic => Effort {
                steps: u64::MAX,
                ..turns.diagrams_next
            },
            Engines::Both | Engines::Explicit => turns.diagrams_next,
        },
        false,
    );
    let mut looked = match counted {
        Some(counted) => counted_look(first, counted),
        None if limits.stop.is_set() => return stopped(first, steps),
        None => list(model, limits, progress),
    };
    looked.verdict.diagram_steps = steps;
    looked
}

/// What was listed before somebody ended the counting.
fn stopped(mut listed: Looked<'_>, steps: u64) -> Looked<'_> {
    listed.verdict.stopped = Some(Stopped::Stop);
    listed.verdict.diagram_steps = steps;
    listed
}

/// Looks for a deadlock where listing has ended without one, by looking at fewer markings. The listed
/// ones are given up for it, so that both together keep to the limit of memory.
pub fn look_for_deadlock(
    looked: &mut Looked<'_>,
    limits: &Limits,
    progress: &mut dyn FnMut(&Progress),
) {
    let model = looked.explored.model;
    let ended = matches!(
        looked.verdict.stopped,
        Some(Stopped::Markings | Stopped::Bytes)
    );
    if !ended || looked.verdict.deadlock_free.is_some() || !stubborn::applies(model) {
        return;
    }
    looked.explored.forget();
    let found = stubborn::deadlock_with(model, limits, progress);
    let verdict = &mut looked.verdict;
    verdict.peak_bytes = verdict.peak_bytes.max(found.peak_bytes);
    if found.stopped.is_none() {
        verdict.deadlock_free = Some(found.deadlock.is_none());
    }
    if let Some((sequence, marking)) = found.deadlock {
        verdict.deadlocks = 1;
        // From there nothing fires again, and nothing leads back.
        if model.label_count() > 0 {
            verdict.live = Some(false);
        }
        if !sequence.is_empty() {
            verdict.reversible = Some(false);
        }
        looked.deadlock = Some((sequence, marking));
    }
}

/// The answer of the diagrams, beside the few markings that were listed.
fn counted_look<'a>(first: Looked<'a>, counted: Counted) -> Looked<'a> {
    let model = first.explored.model;
    let verdict = Verdict {
        engine: Engine::Symbolic,
        markings: counted.markings,
        edges: counted.edges,
        most_tokens: counted.most_tokens,
        bounded: Some(true),
        safe: Some(counted.bounds.iter().all(|bound| *bound <= 1)),
        bounds: counted.bounds,
        deadlocks: counted.deadlocks,
        deadlock_free: Some(counted.deadlocks == 0),
        live: counted.live,
        reversible: counted.reversible,
        home_states: (counted.reversible == Some(true)).then_some(counted.markings),
        seen: by_label(model, &counted.seen),
        complete: true,
        stopped: None,
        peak_bytes: first.verdict.peak_bytes.max(counted.bytes),
        diagram_steps: counted.steps,
    };
    Looked {
        verdict,
        deadlock: counted.deadlock,
        ..first
    }
}

/// Lists the markings of a model one after the other.
#[must_use]
pub fn list<'a>(
    model: &'a Model,
    limits: &Limits,
    progress: &mut dyn FnMut(&Progress),
) -> Looked<'a> {
    let explored = explore_with(model, limits, progress);
    let left = limits.bytes.saturating_sub(explored.peak_bytes);
    let complete = explored.complete();
    let returns = complete.then(|| returns(&explored, left)).flatten();
    let verdict = verdict(&explored, returns.as_ref());
    Looked {
        deadlock: None,
        explored,
        returns,
        verdict,
    }
}

/// Per label, whether one of its transitions is enabled somewhere.
fn by_label(model: &Model, enabled: &[bool]) -> Vec<bool> {
    let mut seen = vec![false; model.label_count()];
    for (transition, enabled) in model.transitions.iter().zip(enabled) {
        if let (Some(label), true) = (transition.label, enabled) {
            seen[label as usize] = true;
        }
    }
    seen
}

fn verdict(explored: &Explored<'_>, returns: Option<&Returns>) -> Verdict {
    let complete = explored.complete();
    let most = explored.bounds.iter().copied().max().unwrap_or(0);
    let labels = explored.model.label_count();
    Verdict {
        engine: Engine::Explicit,
        markings: explored.markings as u128,
        edges: u128::from(explored.edges),
        bounds: explored.bounds.clone(),
        most_tokens: explored.most_tokens,
        bounded: match (complete, &explored.growth) {
            (true, _) => Some(true),
            (false, Some(_)) => Some(false),
            (false, None) => None,
        },
        safe: match (complete, most > 1) {
            (_, true) => Some(false),
            (true, false) => Some(true),
            (false, false) => None,
        },
        deadlocks: u128::from(explored.dead_count),
        deadlock_free: match (complete, explored.dead_count) {
            (_, 1..) => Some(false),
            (true, 0) => Some(true),
            (false, 0) => None,
        },
        live: match returns {
            Some(returns) => Some(returns.all_live()),
            // What cannot fire at some reachable marking, nor after it, is not live.
            None if explored.dead_count > 0 && labels > 0 => Some(false),
            None => None,
        },
        reversible: returns.map(|returns| returns.reversible),
        home_states: returns.map(|returns| returns.home_states as u128),
        seen: by_label(explored.model, &explored.seen),
        complete,
        stopped: explored.stopped,
        peak_bytes: explored
            .peak_bytes
            .max(returns.map_or(0, |returns| explored.bytes() + returns.bytes)),
        diagram_steps: 0,
    }
}
