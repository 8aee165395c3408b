//! What a transition does or waits for, in words: the same on the page, in the terminal and in drawings.

use super::{ArcView, NetView, State, TransitionView};

/// How a transition stands.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, serde::Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Standing {
    /// Its action goes on.
    Running,
    /// It may fire.
    Enabled,
    /// It lacks something.
    Waiting,
}

impl Standing {
    /// How a transition of a net in `state` stands, and why.
    #[must_use]
    pub fn of(view: &NetView, state: &State, one: &TransitionView) -> (Self, String) {
        if state
            .running
            .iter()
            .any(|running| running.transition == one.name)
        {
            let at = one.task.as_ref();
            let at = at.map_or_else(String::new, |task| format!(" at task {task}"));
            return (
                Self::Running,
                format!("action {} is pending{at}", one.target),
            );
        }
        let lacks = lacks(view, state, one);
        if !lacks.is_empty() {
            return (Self::Waiting, lacks.join("; "));
        }
        match (&state.stopped, &state.paused, &one.when) {
            (Some(_), ..) => (Self::Waiting, "the net has stopped".to_owned()),
            (_, Some(why), _) => (Self::Enabled, format!("the net is paused: {why}")),
            (.., Some(when)) => (Self::Waiting, format!("guard {when} is false")),
            _ => (Self::Enabled, "enabled".to_owned()),
        }
    }
}

fn lacks(view: &NetView, state: &State, one: &TransitionView) -> Vec<String> {
    let name = |arc: &ArcView| {
        let place = view.places.get(arc.place as usize);
        place.map_or("?", |place| place.name.as_str())
    };
    let held = |arc: &ArcView| state.places.get(arc.place as usize).copied().unwrap_or(0);
    let some = |count: u32| match count {
        1 => "a token".to_owned(),
        count => format!("{count} tokens"),
    };
    let mut lacks = Vec::new();
    for (arcs, what) in [(&one.inputs, "missing"), (&one.reads, "to be seen")] {
        for arc in arcs {
            let missing = arc.weight.saturating_sub(held(arc));
            if missing > 0 {
                lacks.push(format!("{} {what} in {}", some(missing), name(arc)));
            }
        }
    }
    for arc in one.inhibitors.iter().filter(|arc| held(arc) >= arc.weight) {
        let most = match arc.weight {
            1 => "empty".to_owned(),
            weight => format!("below {weight}"),
        };
        lacks.push(format!("{} must be {most}", name(arc)));
    }
    if let Some(symbol) = &one.tape {
        match &state.in_progress {
            Some(before) => lacks.push(format!(
                "symbol {symbol} is awaited, after the answer to {before}"
            )),
            None if state.tape.first() != Some(symbol) => {
                lacks.push(format!("symbol {symbol} is awaited on the tape"));
            }
            None => {}
        }
    }
    lacks
}
