//! The states of a boot and of the chassis it supervises, as tables. The code steps through them and
//! draws them into the documents; nothing else says what may follow what.

/// A state machine: which state follows which at what event.
pub(crate) trait Table: Copy + PartialEq + 'static {
    /// What happens to it.
    type Event: Copy + 'static;
    /// All states, the first one first.
    #[cfg(test)]
    const STATES: &'static [Self];
    /// All events.
    #[cfg(test)]
    const EVENTS: &'static [Self::Event];

    /// The state after `event`; `None` when the event means nothing in this state.
    fn next(self, event: Self::Event) -> Option<Self>;

    /// The name of the state, and what is true in it.
    fn words(self) -> (&'static str, &'static str);

    /// What happened, in words.
    #[cfg(test)]
    fn event_words(event: Self::Event) -> &'static str;
}

/// Where an app is between its first process and its last.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum BootState {
    /// The processes start and connect.
    #[default]
    Starting,
    /// The tasks are created and pass phase create.
    Create,
    /// The tasks find each other.
    Connect,
    /// The tasks begin.
    Run,
    /// Every task has passed all phases.
    Up,
    /// The tasks are stopped, and the processes ended.
    Stopping,
    /// Nothing of the app is left but the process that booted it.
    Ended,
}

/// Where a chassis is in its life, which may have several incarnations.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum ChassisState {
    /// Its process starts and connects.
    #[default]
    Starting,
    /// Its tasks are created and pass the phases.
    Phases,
    /// Its tasks run.
    Up,
    /// It is gone or must go; its process is not known to be dead yet.
    Ending,
    /// Its process is dead; the next one is started after a pause.
    Waiting,
    /// It failed too often, or may not be started again.
    Down,
    /// It is stopped with the app.
    Stopped,
}

/// What happens to an app.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum BootStep {
    /// Every chassis is connected.
    Linked,
    /// Every task has acknowledged the phase.
    Acknowledged,
    /// Something ends the app: its result, a failure, a person.
    End,
    /// All tasks are stopped or given up.
    AtRest,
}

impl Table for BootState {
    type Event = BootStep;

    #[cfg(test)]
    const STATES: &'static [Self] = &[
        Self::Starting,
        Self::Create,
        Self::Connect,
        Self::Run,
        Self::Up,
        Self::Stopping,
        Self::Ended,
    ];
    #[cfg(test)]
    const EVENTS: &'static [BootStep] = &[
        BootStep::Linked,
        BootStep::Acknowledged,
        BootStep::End,
        BootStep::AtRest,
    ];

    fn next(self, event: BootStep) -> Option<Self> {
        match (self, event) {
            (Self::Starting, BootStep::Linked) => Some(Self::Create),
            (Self::Create, BootStep::Acknowledged) => Some(Self::Connect),
            (Self::Connect, BootStep::Acknowledged) => Some(Self::Run),
            (Self::Run, BootStep::Acknowledged) => Some(Self::Up),
            (Self::Stopping, BootStep::AtRest) => Some(Self::Ended),
            (Self::Stopping | Self::Ended, _) => None,
            (_, BootStep::End) => Some(Self::Stopping),
            _ => None,
        }
    }

    fn words(self) -> (&'static str, &'static str) {
        match self {
            Self::Starting => ("starting", "the processes start and connect"),
            Self::Create => ("create", "the tasks are created and pass phase create"),
            Self::Connect => ("connect", "the tasks find each other by name"),
            Self::Run => ("run", "the tasks begin"),
            Self::Up => ("up", "every task has passed all phases"),
            Self::Stopping => (
                "stopping",
                "the tasks are stopped and the processes ended, rung by rung",
            ),
            Self::Ended => ("ended", "nothing of the app is left"),
        }
    }

    #[cfg(test)]
    fn event_words(event: BootStep) -> &'static str {
        match event {
            BootStep::Linked => "every chassis is connected",
            BootStep::Acknowledged => "every task has acknowledged the phase",
            BootStep::End => "a result, a failure, or a person ends it",
            BootStep::AtRest => "every task is stopped or given up",
        }
    }
}

/// What happens to a chassis.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum ChassisStep {
    /// Its process is connected to all the others.
    Joined,
    /// Its tasks have passed all phases.
    Passed,
    /// Its process ended or fell silent, its tasks failed, or a person wants it anew.
    Fails,
    /// Its process is dead and may be started again.
    DeadMayRestart,
    /// Its process is dead and may not be started again.
    DeadForGood,
    /// The pause is over.
    Paused,
    /// The app is being stopped.
    Stop,
}

impl Table for ChassisState {
    type Event = ChassisStep;

    #[cfg(test)]
    const STATES: &'static [Self] = &[
        Self::Starting,
        Self::Phases,
        Self::Up,
        Self::Ending,
        Self::Waiting,
        Self::Down,
        Self::Stopped,
    ];
    #[cfg(test)]
    const EVENTS: &'static [ChassisStep] = &[
        ChassisStep::Joined,
        ChassisStep::Passed,
        ChassisStep::Fails,
        ChassisStep::DeadMayRestart,
        ChassisStep::DeadForGood,
        ChassisStep::Paused,
        ChassisStep::Stop,
    ];

    fn next(self, event: ChassisStep) -> Option<Self> {
        match (self, event) {
            (Self::Starting, ChassisStep::Joined) => Some(Self::Phases),
            (Self::Phases, ChassisStep::Passed) => Some(Self::Up),
            (Self::Starting | Self::Phases | Self::Up, ChassisStep::Fails) => Some(Self::Ending),
            (Self::Ending, ChassisStep::DeadMayRestart) => Some(Self::Waiting),
            (Self::Ending, ChassisStep::DeadForGood) => Some(Self::Down),
            (Self::Waiting, ChassisStep::Paused) => Some(Self::Starting),
            (Self::Stopped, _) => None,
            (_, ChassisStep::Stop) => Some(Self::Stopped),
            _ => None,
        }
    }

    fn words(self) -> (&'static str, &'static str) {
        match self {
            Self::Starting => ("starting", "its process starts and connects"),
            Self::Phases => ("phases", "its tasks are created and pass the phases"),
            Self::Up => ("up", "its tasks run"),
            Self::Ending => (
                "ending",
                "it is gone or must go, and its process is not known to be dead yet",
            ),
            Self::Waiting => (
                "waiting",
                "its process is dead; a pause before the next one",
            ),
            Self::Down => ("down", "it may not be started again; the app ends"),
            Self::Stopped => ("stopped", "it is stopped with the app"),
        }
    }

    #[cfg(test)]
    fn event_words(event: ChassisStep) -> &'static str {
        match event {
            ChassisStep::Joined => "it is connected to all the others",
            ChassisStep::Passed => "its tasks have passed all phases",
            ChassisStep::Fails => {
                "its process ends, is silent or late, a task fails, or a person restarts it"
            }
            ChassisStep::DeadMayRestart => "its process is dead and its policy allows a restart",
            ChassisStep::DeadForGood => "its process is dead and its policy forbids a restart",
            ChassisStep::Paused => "the pause is over",
            ChassisStep::Stop => "the app is being stopped",
        }
    }
}

impl std::fmt::Display for BootState {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.pad(self.words().0)
    }
}

impl std::fmt::Display for ChassisState {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.pad(self.words().0)
    }
}

#[cfg(test)]
mod tests {
    use std::{fmt::Write, path::Path};

    use super::*;

    /// The machine as a diagram and a table in Markdown.
    fn drawn<S: Table>() -> String {
        let mut text = String::from("```mermaid\nstateDiagram-v2\n");
        // Writing to a string cannot fail.
        if let Some(first) = S::STATES.first() {
            let _ = writeln!(text, "    [*] --> {}", first.words().0);
        }
        for state in S::STATES {
            for (event, next) in transitions(*state) {
                let (from, to) = (state.words().0, next.words().0);
                let _ = writeln!(text, "    {from} --> {to}: {}", S::event_words(event));
            }
            if transitions(*state).next().is_none() {
                let _ = writeln!(text, "    {} --> [*]", state.words().0);
            }
        }
        text.push_str(
            "```\n\n| state | what is true in it | leaves it when | for |\n|---|---|---|---|\n",
        );
        for state in S::STATES {
            let (name, meaning) = state.words();
            let mut first = true;
            for (event, next) in transitions(*state) {
                let (name, meaning) = if first { (name, meaning) } else { ("", "") };
                let (event, next) = (S::event_words(event), next.words().0);
                let _ = writeln!(text, "| {name} | {meaning} | {event} | {next} |");
                first = false;
            }
            if first {
                let _ = writeln!(text, "| {name} | {meaning} | never | |");
            }
        }
        text
    }

    fn transitions<S: Table>(state: S) -> impl Iterator<Item = (S::Event, S)> {
        let events = S::EVENTS.iter().copied();
        events.filter_map(move |event| Some((event, state.next(event)?)))
    }

    /// What stands between the marks `<!-- NAME -->` and `<!-- end -->` of a page must be `drawn`. With
    /// `UPDATE=1` in the environment it is written there instead.
    fn must_show(page: &str, name: &str, drawn: &str) {
        let path = Path::new(env!("CARGO_MANIFEST_DIR"))
            .join("../../docs")
            .join(page);
        let text = std::fs::read_to_string(&path).unwrap();
        let mark = format!("<!-- {name} -->\n");
        let (before, rest) = text.split_once(&mark).unwrap();
        let (shown, after) = rest.split_once("<!-- end -->").unwrap();
        if std::env::var_os("UPDATE").is_some() {
            std::fs::write(&path, format!("{before}{mark}{drawn}<!-- end -->{after}")).unwrap();
        } else {
            assert_eq!(
                shown, drawn,
                "`UPDATE=1 cargo test -p ctos` draws {page} anew"
            );
        }
    }

    #[test]
    fn the_documents_show_the_tables_that_the_code_steps_through() {
        must_show("boot.md", "states of a boot", &drawn::<BootState>());
        must_show(
            "supervision.md",
            "states of a chassis",
            &drawn::<ChassisState>(),
        );
    }

    /// The states that can be reached from the first one.
    fn reached<S: Table>() -> Vec<S> {
        let mut reached: Vec<S> = S::STATES.first().copied().into_iter().collect();
        let mut at = 0;
        while let Some(state) = reached.get(at).copied() {
            for (_, next) in transitions(state) {
                if !reached.contains(&next) {
                    reached.push(next);
                }
            }
            at += 1;
        }
        reached
    }

    #[test]
    fn every_state_can_be_reached_and_only_the_last_ones_are_for_ever() {
        assert_eq!(reached::<BootState>().len(), BootState::STATES.len());
        assert_eq!(reached::<ChassisState>().len(), ChassisState::STATES.len());
        for state in BootState::STATES {
            assert_eq!(
                transitions(*state).next().is_none(),
                *state == BootState::Ended
            );
        }
        for state in ChassisState::STATES {
            let last = *state == ChassisState::Stopped;
            assert_eq!(transitions(*state).next().is_none(), last);
        }
    }

    #[test]
    fn a_chassis_is_started_anew_only_after_its_process_was_seen_dead() {
        for state in ChassisState::STATES {
            for (event, next) in transitions(*state) {
                if next == ChassisState::Starting {
                    assert_eq!(
                        (*state, event),
                        (ChassisState::Waiting, ChassisStep::Paused)
                    );
                }
                if next == ChassisState::Waiting {
                    assert_eq!(event, ChassisStep::DeadMayRestart);
                }
            }
        }
    }

    #[test]
    fn an_app_can_be_stopped_in_every_state_before_the_stop() {
        for state in [
            BootState::Starting,
            BootState::Create,
            BootState::Connect,
            BootState::Run,
            BootState::Up,
        ] {
            assert_eq!(state.next(BootStep::End), Some(BootState::Stopping));
        }
    }
}
