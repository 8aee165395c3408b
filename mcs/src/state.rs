//! The state manager's rules: five states, the events between them, and who holds the manipulator.
//!
//! Report 108, section 4 and figure 7: cold, reserved and estopped mean power off; active means power
//! and brakes on; motion means brakes off. The reserved state makes sure that the degrees of
//! freedom are allocated to one task before power comes on. All rules are in one table; nothing
//! here knows messages or the servo.

use std::fmt::{self, Write as _};

use serde::{Deserialize, Serialize};

use crate::driver::Power;

/// The five states.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub enum State {
    /// Nobody holds the manipulator; power off.
    #[default]
    Cold,
    /// One task holds it; power off.
    Reserved,
    /// Power on, brakes on.
    Active,
    /// Power on, brakes off: only now can it move.
    Motion,
    /// Power was taken away; a reset and a new reservation are needed.
    Estopped,
}

impl State {
    /// All states, in the columns of the table.
    pub const ALL: [Self; 5] = [
        Self::Cold,
        Self::Reserved,
        Self::Active,
        Self::Motion,
        Self::Estopped,
    ];

    /// The physical state that this state means.
    #[must_use]
    pub fn power(self) -> Power {
        match self {
            Self::Cold | Self::Reserved | Self::Estopped => Power::Off,
            Self::Active => Power::Braked,
            Self::Motion => Power::Released,
        }
    }
}

impl fmt::Display for State {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Cold => "cold",
            Self::Reserved => "reserved",
            Self::Active => "active",
            Self::Motion => "motion",
            Self::Estopped => "estopped",
        })
    }
}

/// What may be asked of the state manager.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum Event {
    /// A task takes the manipulator for itself.
    Reserve,
    /// The holder gives it back.
    Unreserve,
    /// Power on; brakes stay on.
    PowerOn,
    /// Power off.
    PowerOff,
    /// Open the brakes.
    ReleaseBrakes,
    /// Close the brakes, with the arm at rest.
    EngageBrakes,
    /// Take power away now.
    EmergencyStop,
    /// Leave the estopped state. The reservation is lost.
    Reset,
}

impl Event {
    /// All events, in the rows of the table.
    pub const ALL: [Self; 8] = [
        Self::Reserve,
        Self::Unreserve,
        Self::PowerOn,
        Self::PowerOff,
        Self::ReleaseBrakes,
        Self::EngageBrakes,
        Self::EmergencyStop,
        Self::Reset,
    ];

    /// Whether only the holder of the manipulator may ask for it.
    #[must_use]
    pub fn is_for_the_holder(self) -> bool {
        !matches!(self, Self::Reserve | Self::EmergencyStop | Self::Reset)
    }
}

impl fmt::Display for Event {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Reserve => "reserve",
            Self::Unreserve => "unreserve",
            Self::PowerOn => "power on",
            Self::PowerOff => "power off",
            Self::ReleaseBrakes => "release brakes",
            Self::EngageBrakes => "engage brakes",
            Self::EmergencyStop => "emergency stop",
            Self::Reset => "reset",
        })
    }
}

/// The whole of figure 7: next state by event (row) and state (column); `None` is illegal.
const TABLE: [[Option<State>; 5]; 8] = {
    use State::{Active, Cold, Estopped, Motion, Reserved};
    const NO: Option<State> = None;
    [
        // from     cold             reserved         active           motion           estopped
        /* reserve        */
        [Some(Reserved), NO, NO, NO, NO],
        /* unreserve      */ [NO, Some(Cold), NO, NO, NO],
        /* power on       */ [NO, Some(Active), NO, NO, NO],
        /* power off      */ [NO, NO, Some(Reserved), NO, NO],
        /* release brakes */ [NO, NO, Some(Motion), NO, NO],
        /* engage brakes  */ [NO, NO, NO, Some(Active), NO],
        /* emergency stop */ [Some(Estopped); 5],
        /* reset          */ [NO, NO, NO, NO, Some(Cold)],
    ]
};

/// The state that `event` leads to from `state`, or `None` when it is illegal there.
#[must_use]
pub fn next(state: State, event: Event) -> Option<State> {
    // Enum order is table order; a test walks both.
    TABLE.get(event as usize)?.get(state as usize).copied()?
}

/// Why the state manager says no.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum StateError {
    /// The event is illegal in this state.
    #[error("`{event}` is not possible in the {state} state; {hint}")]
    Illegal {
        /// The event.
        event: Event,
        /// The state.
        state: State,
        /// What to do instead.
        hint: &'static str,
    },
    /// Another task holds the manipulator.
    #[error("`{event}` by task `{by}` refused: the manipulator is reserved by task `{holder}`")]
    Held {
        /// The event.
        event: Event,
        /// Who asked.
        by: String,
        /// Who holds it.
        holder: String,
    },
}

fn hint(state: State) -> &'static str {
    match state {
        State::Cold => "acquire the manipulator first",
        State::Reserved => "switch its power on first, or release it",
        State::Active => "release the brakes, or switch its power off",
        State::Motion => "engage the brakes first",
        State::Estopped => "reset it, then acquire it anew",
    }
}

/// State and holder of one manipulator.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct StateManager {
    state: State,
    holder: Option<String>,
}

impl StateManager {
    /// Cold and held by nobody.
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }

    /// The present state.
    #[must_use]
    pub fn state(&self) -> State {
        self.state
    }

    /// Name of the task that holds the manipulator.
    #[must_use]
    pub fn holder(&self) -> Option<&str> {
        self.holder.as_deref()
    }

    /// Applies an event that task `by` asks for, and returns the new state.
    ///
    /// # Errors
    /// [`StateError`]; then nothing has changed.
    pub fn apply(&mut self, event: Event, by: &str) -> Result<State, StateError> {
        let takes_part = event.is_for_the_holder() || event == Event::Reserve;
        if let Some(holder) = &self.holder
            && takes_part
            && holder != by
        {
            return Err(StateError::Held {
                event,
                by: by.to_owned(),
                holder: holder.clone(),
            });
        }
        let state = next(self.state, event).ok_or(StateError::Illegal {
            event,
            state: self.state,
            hint: hint(self.state),
        })?;
        match (event, state) {
            (Event::Reserve, _) => self.holder = Some(by.to_owned()),
            (_, State::Cold | State::Estopped) => self.holder = None,
            _ => {}
        }
        self.state = state;
        Ok(state)
    }
}

/// The table drawn as a Mermaid state diagram.
#[must_use]
pub fn mermaid() -> String {
    let mut text = String::from("stateDiagram-v2\n    [*] --> cold\n");
    for event in Event::ALL {
        for state in State::ALL {
            if let Some(to) = next(state, event) {
                // Writing to a string cannot fail.
                let _ = writeln!(text, "    {state} --> {to} : {event}");
            }
        }
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn the_table_is_in_the_order_of_the_enums() {
        for (index, state) in State::ALL.into_iter().enumerate() {
            assert_eq!(state as usize, index);
        }
        for (index, event) in Event::ALL.into_iter().enumerate() {
            assert_eq!(event as usize, index);
        }
    }

    /// Each row of figure 7 as the report has it: an event, the only states that it leads out of, and where to.
    #[test]
    fn each_event_leads_where_figure_7_says_and_is_refused_with_a_hint_in_every_other_state() {
        use State::{Active, Cold, Estopped, Motion, Reserved};
        type Row = (&'static str, Event, &'static [(State, State)]);
        let rows: [Row; 8] = [
            ("reserve", Event::Reserve, &[(Cold, Reserved)]),
            ("unreserve", Event::Unreserve, &[(Reserved, Cold)]),
            ("power on", Event::PowerOn, &[(Reserved, Active)]),
            ("power off", Event::PowerOff, &[(Active, Reserved)]),
            ("release brakes", Event::ReleaseBrakes, &[(Active, Motion)]),
            ("engage brakes", Event::EngageBrakes, &[(Motion, Active)]),
            (
                "emergency stop",
                Event::EmergencyStop,
                &[
                    (Cold, Estopped),
                    (Reserved, Estopped),
                    (Active, Estopped),
                    (Motion, Estopped),
                    (Estopped, Estopped),
                ],
            ),
            ("reset", Event::Reset, &[(Estopped, Cold)]),
        ];
        // How each state is come to, who holds it then, and what its power is.
        let ways: [(State, &str, &[Event], bool, Power); 5] = [
            (Cold, "cold", &[], false, Power::Off),
            (Reserved, "reserved", &[Event::Reserve], true, Power::Off),
            (
                Active,
                "active",
                &[Event::Reserve, Event::PowerOn],
                true,
                Power::Braked,
            ),
            (
                Motion,
                "motion",
                &[Event::Reserve, Event::PowerOn, Event::ReleaseBrakes],
                true,
                Power::Released,
            ),
            (
                Estopped,
                "estopped",
                &[Event::Reserve, Event::EmergencyStop],
                false,
                Power::Off,
            ),
        ];
        for (state, called, way, is_held, power) in ways {
            let mut there = StateManager::new();
            for event in way {
                there.apply(*event, "a").unwrap();
            }
            assert_eq!((there.state(), state.to_string().as_str()), (state, called));
            assert_eq!(there.holder(), is_held.then_some("a"), "{called}");
            assert_eq!(state.power(), power, "{called}");
            for (word, event, leads) in rows {
                let at = format!("{word} in {called}");
                let mut after = there.clone();
                let found = after.apply(event, "a");
                match leads.iter().find(|(from, _)| *from == state) {
                    Some((_, to)) => {
                        assert_eq!(found, Ok(*to), "{at}");
                        let holds = !matches!(to, Cold | Estopped);
                        assert_eq!(after.holder(), holds.then_some("a"), "{at}");
                    }
                    None => {
                        let text = found.unwrap_err().to_string();
                        let begins = format!("`{word}` is not possible in the {called} state; ");
                        assert!(
                            text.starts_with(&begins) && text.len() > begins.len(),
                            "{text}"
                        );
                        assert_eq!(after, there, "{at}");
                    }
                }
                // Of a manipulator that is held, nobody else asks for anything but a stop and a reset.
                let mut after = there.clone();
                let by_another = after.apply(event, "b");
                let anybody = matches!(event, Event::EmergencyStop | Event::Reset);
                if is_held && !anybody {
                    let held = "the manipulator is reserved by task `a`";
                    assert!(by_another.unwrap_err().to_string().ends_with(held), "{at}");
                    assert_eq!(after, there, "{at}");
                }
            }
        }
    }

    #[test]
    fn power_steps_one_physical_state_at_a_time_but_for_the_emergency_stop() {
        let height = |state: State| state.power() as i32;
        for event in Event::ALL {
            for state in State::ALL {
                if let Some(to) = next(state, event)
                    && event != Event::EmergencyStop
                {
                    assert!(
                        (height(to) - height(state)).abs() <= 1,
                        "{state} {event} {to}"
                    );
                }
            }
        }
    }

    #[test]
    fn only_the_holder_may_use_the_manipulator() {
        let mut manager = StateManager::new();
        manager.apply(Event::Reserve, "a").unwrap();
        let refused = manager.apply(Event::PowerOn, "b").unwrap_err();
        let expected = "`power on` by task `b` refused: the manipulator is reserved by task `a`";
        assert_eq!(refused.to_string(), expected);
        assert!(matches!(
            manager.apply(Event::Reserve, "b"),
            Err(StateError::Held { .. })
        ));
        manager.apply(Event::PowerOn, "a").unwrap();
        assert_eq!(
            manager.apply(Event::EmergencyStop, "b"),
            Ok(State::Estopped)
        );
    }

    #[test]
    fn after_an_emergency_stop_reset_alone_is_not_enough() {
        let mut manager = StateManager::new();
        for event in [Event::Reserve, Event::PowerOn, Event::EmergencyStop] {
            manager.apply(event, "a").unwrap();
        }
        assert_eq!(manager.holder(), None);
        for event in [Event::PowerOn, Event::ReleaseBrakes, Event::Reserve] {
            assert!(manager.apply(event, "a").is_err());
        }
        manager.apply(Event::Reset, "a").unwrap();
        assert!(manager.apply(Event::PowerOn, "a").is_err());
        manager.apply(Event::Reserve, "a").unwrap();
        manager.apply(Event::PowerOn, "a").unwrap();
    }

    proptest! {
        #[test]
        fn whatever_is_asked_power_is_on_only_for_a_holder(
            asked in prop::collection::vec((0..Event::ALL.len(), 0..3_usize), 0..60),
        ) {
            let mut manager = StateManager::new();
            for (event, by) in asked {
                let before = manager.clone();
                let result = manager.apply(Event::ALL[event], ["a", "b", "c"][by]);
                prop_assert!(result.is_ok() || manager == before);
                if manager.state().power() != Power::Off {
                    prop_assert!(manager.holder().is_some());
                }
                if matches!(manager.state(), State::Cold | State::Estopped) {
                    prop_assert!(manager.holder().is_none());
                }
            }
        }
    }

    #[test]
    fn the_diagram_in_the_documentation_is_the_table() {
        let page = include_str!("../../docs/mcs-states.md");
        let drawn = format!("```mermaid\n{}```", mermaid());
        assert!(
            page.contains(&drawn),
            "put this into docs/mcs-states.md:\n{drawn}"
        );
    }
}
