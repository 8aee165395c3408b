//! Whether each command of a tape is sound by itself, as a workflow: put once to nets at rest, every run
//! comes to its end, and that is rest again with the answer written.

use crate::{
    analysis::{
        explicit::{Limits, explore},
        model::{Model, Place},
        returns,
    },
    compose::{Phase, System},
    net::CommandId,
};

/// What one command by itself comes to.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Workflow {
    /// Name of the net.
    pub net: String,
    /// The input symbol.
    pub command: String,
    /// Whether it is sound; nothing where a limit came first.
    pub sound: Option<bool>,
    /// Firings after which no way leads to the end, in words; empty when sound or not known.
    pub counterexample: Vec<String>,
}

/// Looks at every command of a system by itself.
#[must_use]
pub fn workflows(system: &System, limits: &Limits) -> Vec<Workflow> {
    let nets = system.nets().iter().enumerate();
    let commands = nets.flat_map(|(number, net)| {
        (0..)
            .map(CommandId)
            .zip(net.commands())
            .map(move |(id, command)| (number, id, command))
    });
    commands
        .map(|(net, id, command)| {
            let (sound, counterexample) = workflow(system, net, id, limits);
            Workflow {
                net: system.nets()[net].name().to_owned(),
                command: command.symbol.clone(),
                sound,
                counterexample,
            }
        })
        .collect()
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
    let words = |marking: &[u32]| -> Vec<String> {
        let path = explored.path(marking).unwrap_or_default();
        let names = path
            .iter()
            .filter_map(|number| model.transitions.get(*number as usize));
        names.map(|transition| transition.name.clone()).collect()
    };
    if explored.growth.is_some() {
        return (Some(false), Vec::new());
    }
    let unasked = (0..).zip(&forbidden).zip(&explored.seen);
    for ((number, forbidden), seen) in unasked {
        if *forbidden && *seen {
            let reached = explored.nearest_enabled(number);
            return (
                Some(false),
                reached.map(|r| words(&r.marking)).unwrap_or_default(),
            );
        }
    }
    match returns::always_reachable(&explored, &|marking| marking == end, limits.bytes) {
        None => (None, Vec::new()),
        Some(None) => (Some(true), Vec::new()),
        Some(Some(marking)) => (Some(false), words(&marking)),
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
            let path = format!("{}/tests/nets/{name}.net", env!("CARGO_MANIFEST_DIR"));
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
