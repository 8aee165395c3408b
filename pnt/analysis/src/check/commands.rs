//! Whether each command of a tape is sound by itself, as a workflow. After it is put once to nets at
//! rest, every run ends, and the end is rest with the answer written.

use crate::{
    analysis::{
        explicit::{Explored, Limits, explore},
        model::{Model, Place},
        returns,
    },
    compose::{Phase, Stands, System},
};
use pnt_language::net::CommandId;

use super::ending::End;

/// What one command by itself comes to.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Workflow {
    /// Name of the net.
    pub net: String,
    /// The input symbol.
    pub command: String,
    /// Whether it is sound; `None` where a limit came first.
    pub sound: Option<bool>,
    /// Firings after which no way leads to the end, in words; empty when sound or not known.
    pub counterexample: Vec<String>,
}

/// Every command of a system, with the number of its net.
fn commands(system: &System) -> impl Iterator<Item = (usize, CommandId)> {
    let nets = system.nets().iter().enumerate();
    nets.flat_map(|(number, net)| {
        (0..)
            .map(CommandId)
            .zip(net.commands())
            .map(move |(id, _)| (number, id))
    })
}

impl Workflow {
    fn new(
        system: &System,
        (net, command): (usize, CommandId),
        (sound, counterexample): (Option<bool>, Vec<String>),
    ) -> Self {
        let net = &system.nets()[net];
        Self {
            net: net.name().to_owned(),
            command: net[command].symbol.clone(),
            sound,
            counterexample,
        }
    }
}

/// Looks at every command of a system by itself.
#[must_use]
pub fn workflows(system: &System, limits: &Limits) -> Vec<Workflow> {
    commands(system)
        .map(|(net, id)| Workflow::new(system, (net, id), workflow(system, net, id, limits)))
        .collect()
}

/// Checks every command on tapes with a given language: whether it can always be answered, from every
/// marking that is reached with it.
#[must_use]
pub(super) fn on_tapes(
    system: &System,
    explored: &Explored<'_>,
    end: &End,
    limits: &Limits,
) -> Vec<Workflow> {
    let comes = |(net, id): &(usize, CommandId)| {
        let steps = system.steps().iter().zip(&explored.seen);
        steps
            .filter(|(step, _)| (step.net, step.phase) == (*net, Phase::Put(*id)))
            .any(|(_, seen)| *seen)
    };
    commands(system)
        .filter(comes)
        .map(|command| {
            let answer = match end {
                // At the end of the tape every command is answered.
                End::Always => (Some(true), Vec::new()),
                End::NotFrom(_) | End::Unknown => answered(system, explored, command, limits),
            };
            Workflow::new(system, command, answer)
        })
        .collect()
}

/// Whether a command can always be answered; if not, firings after which it cannot.
fn answered(
    system: &System,
    explored: &Explored<'_>,
    (net, command): (usize, CommandId),
    limits: &Limits,
) -> (Option<bool>, Vec<String>) {
    let asked =
        |stands: Stands| stands == Stands::OnTape(command) || stands == Stands::InProgress(command);
    let places = system.places().iter().enumerate();
    let places = places.filter(|(_, place)| place.net == net && asked(place.stands));
    let places: Vec<usize> = places.map(|(number, _)| number).collect();
    let answered = |marking: &[u32]| places.iter().all(|place| marking[*place] == 0);
    match returns::always_reachable(explored, &answered, limits.bytes) {
        None => (None, Vec::new()),
        Some(None) => (Some(true), Vec::new()),
        Some(Some(marking)) => (Some(false), words(explored, &marking)),
    }
}

/// A shortest way to a marking, in words.
fn words(explored: &Explored<'_>, marking: &[u32]) -> Vec<String> {
    let path = explored.path(marking).unwrap_or_default();
    let transitions = &explored.model().transitions;
    let names = path.iter().filter_map(|n| transitions.get(*n as usize));
    names.map(|transition| transition.name.clone()).collect()
}

fn workflow(
    system: &System,
    net: usize,
    command: CommandId,
    limits: &Limits,
) -> (Option<bool>, Vec<String>) {
    let mut model = Model::of_system(system);
    let budget = u32::try_from(model.places.len()).unwrap_or(u32::MAX);
    model.places.push(Place {
        name: "the command to come".to_owned(),
        tokens: 1,
        capacity: None,
    });
    let mut forbidden = Vec::new();
    for (transition, step) in model.transitions.iter_mut().zip(system.steps()) {
        match step.phase {
            Phase::Put(id) if (step.net, id) == (net, command) => {
                transition.takes.push((budget, 1));
            }
            // Nothing else is put. No place ever holds fewer than no tokens.
            Phase::Put(_) => transition.inhibitors.push((budget, 0)),
            _ => {}
        }
        forbidden.push(step.unasked || step.overfills.is_some());
    }
    let mut end = model.initial();
    if let Some(tokens) = end.last_mut() {
        *tokens = 0;
    }
    let explored = explore(&model, limits);
    if explored.growth.is_some() {
        return (Some(false), Vec::new());
    }
    let unasked = (0..).zip(&forbidden).zip(&explored.seen);
    for ((number, forbidden), seen) in unasked {
        if *forbidden && *seen {
            let reached = explored.nearest_enabled(number);
            return (
                Some(false),
                reached
                    .map(|r| words(&explored, &r.marking))
                    .unwrap_or_default(),
            );
        }
    }
    match returns::always_reachable(&explored, &|marking| marking == end, limits.bytes) {
        None => (None, Vec::new()),
        Some(None) => (Some(true), Vec::new()),
        Some(Some(marking)) => (Some(false), words(&explored, &marking)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::analysis::samples::net;

    #[test]
    fn a_command_is_sound_or_there_is_a_run_that_never_ends_at_rest() {
        let text = "net n
place free = 1, busy, stuck
command go -> gone
command jam -> jammed
transition begin
  in free
  tape go
  out busy
transition end
  in busy
  out free
  write gone
transition break
  in free
  tape jam
  out stuck
";
        let (system, findings) = System::compose(&[net(text)]);
        assert!(!findings.has_errors(), "{findings}");
        let found = workflows(&system, &Limits::default());
        assert_eq!(
            (found[0].command.as_str(), found[0].sound),
            ("go", Some(true))
        );
        assert_eq!(
            (found[1].command.as_str(), found[1].sound),
            ("jam", Some(false))
        );
        assert_eq!(found[1].counterexample, ["command jam to n", "n.break"]);
        let few = Limits {
            markings: 1,
            ..Limits::default()
        };
        assert_eq!(workflows(&system, &few)[0].sound, None);
    }

    #[test]
    fn the_commands_of_the_case_study_are_sound() {
        let nets = ["dispatcher", "motion", "vision"].map(|name| {
            let path = format!("{}/../tests/nets/{name}.net", env!("CARGO_MANIFEST_DIR"));
            net(&std::fs::read_to_string(path).unwrap())
        });
        let (system, _) = System::compose(&nets);
        let found = workflows(&system, &Limits::default());
        assert!(
            !found.is_empty() && found.iter().all(|w| w.sound == Some(true)),
            "{found:?}"
        );
    }
}
