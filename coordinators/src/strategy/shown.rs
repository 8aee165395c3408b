//! What people see of choices: a data object with the numbers of all ways of each step, and which one is tried. The DOM shows it.

use std::collections::BTreeMap;

use ctos::task::Context;
use serde::{Deserialize, Serialize};

use super::{Figures, step};
use crate::dom::DomStore;

/// The data object: written by Coordinators that choose.
pub const CHOICES: &str = "choices";

/// [`CHOICES`]: by step.
pub type Choices = BTreeMap<String, Shown>;

/// The ways of a step.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Shown {
    /// The one that was chosen last.
    pub chosen: Option<String>,
    /// What is believed of each.
    pub figures: Vec<Figures>,
}

/// Tells the log, and whoever looks at the display, which way of a step was chosen.
pub(crate) async fn tell_choice(
    cx: &Context,
    store: &DomStore,
    step: &str,
    (way, figures): (String, Vec<Figures>),
) {
    tracing::info!(
        task = cx.name(),
        step,
        way,
        figures = step::in_words(&figures),
        "a way was chosen"
    );
    show(cx, store, step, (Some(way), figures)).await;
}

/// Shows what is believed of the ways of a step, and which one was chosen, if another was. What could not be shown is logged.
pub(crate) async fn show(
    cx: &Context,
    store: &DomStore,
    step: &str,
    (chosen, mut figures): (Option<String>, Vec<Figures>),
) {
    let mut all: Choices = store.fetch(cx, CHOICES).await.unwrap_or_default();
    let before = all.remove(step);
    let before_chosen = before.as_ref().and_then(|before| before.chosen.clone());
    // Of ways that are open no more, what was believed last is still believed.
    let is_new = |old: &Figures| figures.iter().all(|new| new.name != old.name);
    let old: Vec<Figures> = before.map_or_else(Vec::new, |before| before.figures);
    let old = old.into_iter().filter(is_new).collect::<Vec<_>>();
    figures.extend(old);
    figures.sort_by(|one, other| one.name.cmp(&other.name));
    let chosen = chosen.or(before_chosen);
    all.insert(step.to_owned(), Shown { chosen, figures });
    if let Err(unshown) = store.store(cx, CHOICES, &all).await {
        tracing::warn!(%unshown, "what is believed of ways could not be shown");
    }
}
