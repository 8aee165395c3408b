//! A net as text, for terminals and for log files.

use std::fmt::Write as _;

use pnt::stream::{Event, EventPhase, NetView, Standing, State};

/// The last events that are shown.
pub(crate) const EVENTS: usize = 12;

/// How all transitions of a net stand, those that do something first; wiring left out.
pub(crate) fn standings<'v>(view: &'v NetView, state: &State) -> Vec<(&'v str, Standing, String)> {
    let mut all: Vec<(&str, Standing, String)> = Vec::new();
    for one in &view.transitions {
        if ["end", "fail", "back"].contains(&one.part.as_str()) {
            continue;
        }
        let active = view.place(&format!("{}_active", one.shown));
        let active = active.filter(|_| one.part == "start");
        let served = active.and_then(|place| state.places.get(place));
        let (standing, words) = if served.is_some_and(|tokens| *tokens > 0) {
            let task = one.task.as_deref().unwrap_or("its coordinator");
            (Standing::Running, format!("request is pending at {task}"))
        } else {
            Standing::of(view, state, one)
        };
        all.push((&one.shown, standing, words));
    }
    all.sort_by_key(|(_, standing, _)| *standing);
    all
}

/// Marked places, wiring left out.
pub(crate) fn marked<'v>(
    view: &'v NetView,
    state: &'v State,
) -> impl Iterator<Item = (&'v str, u32)> {
    let places = view.places.iter().zip(&state.places).enumerate();
    places
        .filter(|(index, (_, tokens))| **tokens > 0 && !view.hidden(*index))
        .map(|(_, (place, tokens))| (place.name.as_str(), *tokens))
}

/// Declared data with its values.
pub(crate) fn data(view: &NetView, state: &State) -> String {
    let each = view.data.iter().zip(&state.data).map(|(data, value)| {
        let unit = match data.kind.as_str() {
            "int" | "float" | "bool" | "text" => String::new(),
            unit => format!(" {unit}"),
        };
        format!("{} = {value}{unit}", data.name)
    });
    each.collect::<Vec<_>>().join(", ")
}

/// A net in lines.
pub(crate) fn plain(
    view: &NetView,
    state: &State,
    events: &[Event],
    breakpoints: &[String],
) -> String {
    let mut out = format!(
        "net {}  {:.3} s  event {}\n",
        view.name,
        state.at_ns as f64 / 1e9,
        state.seq
    );
    let mut line = |head: &str, text: &str| {
        // Writing to a string never fails.
        let _ = writeln!(out, "  {head:<9}{text}");
    };
    for (head, why) in [("stopped", &state.stopped), ("paused", &state.paused)] {
        if let Some(why) = why {
            line(head, why);
        }
    }
    if !breakpoints.is_empty() {
        line("breaks", &breakpoints.join(" "));
    }
    let marked: Vec<String> = marked(view, state)
        .map(|(place, tokens)| {
            if tokens == 1 {
                place.to_owned()
            } else {
                format!("{place}*{tokens}")
            }
        })
        .collect();
    line("marked", &marked.join(" "));
    if !view.data.is_empty() {
        line("data", &data(view, state));
    }
    if !view.commands.is_empty() {
        let progress = state.in_progress.as_ref();
        let progress = progress.map_or_else(String::new, |symbol| format!("[{symbol}] "));
        line("tape", &format!("{progress}{}", state.tape.join(" ")));
    }
    for (name, standing, words) in standings(view, state) {
        let head = match standing {
            Standing::Running => "running",
            Standing::Enabled => "enabled",
            Standing::Waiting => continue,
        };
        line(head, &format!("{name}: {words}"));
    }
    for event in events {
        line("event", &event_line(view, event));
    }
    out
}

/// An event in a line.
pub(crate) fn event_line(view: &NetView, event: &Event) -> String {
    let (transition, phase) = view.told(event);
    let tokens = |list: &[(String, u32)]| {
        let named = |(place, count): &(String, u32)| match count {
            1 => place.clone(),
            count => format!("{place}*{count}"),
        };
        list.iter().map(named).collect::<Vec<_>>().join(" ")
    };
    let mut text = format!("{:>10.3}  {:<10}", event.at_ns as f64 / 1e9, phase.word());
    let mut add = |part: &str| {
        if !part.is_empty() {
            text.push(' ');
            text.push_str(part);
        }
    };
    add(transition);
    if !event.consumed.is_empty() || !event.produced.is_empty() {
        add(&format!(
            "({} -> {})",
            tokens(&event.consumed),
            tokens(&event.produced)
        ));
    }
    match (&event.read, event.phase) {
        (Some(symbol), EventPhase::Asked) => add(&format!("tape + {symbol}")),
        (Some(symbol), _) => add(&format!("reads {symbol}")),
        _ => {}
    }
    if let Some(symbol) = &event.wrote {
        add(&format!("writes {symbol}"));
    }
    add(&event.text);
    text
}

/// A net as one JSON object on one line.
pub(crate) fn json(
    view: &NetView,
    state: &State,
    events: &[Event],
    breakpoints: &[String],
) -> String {
    let standings: Vec<serde_json::Value> = standings(view, state)
        .into_iter()
        .map(|(name, standing, words)| {
            serde_json::json!({ "transition": name, "standing": standing, "words": words })
        })
        .collect();
    let places = view.places.iter().zip(&state.places);
    let places: serde_json::Map<String, serde_json::Value> = places
        .map(|(place, tokens)| (place.name.clone(), (*tokens).into()))
        .collect();
    let data = view.data.iter().zip(&state.data);
    let data: serde_json::Map<String, serde_json::Value> = data
        .map(|(data, value)| (data.name.clone(), value.as_str().into()))
        .collect();
    serde_json::json!({
        "net": view.name,
        "at_s": state.at_ns as f64 / 1e9,
        "seq": state.seq,
        "places": places,
        "data": data,
        "transitions": standings,
        "tape": state.tape,
        "in_progress": state.in_progress,
        "paused": state.paused,
        "stopped": state.stopped,
        "breakpoints": breakpoints,
        "events": events,
    })
    .to_string()
}
