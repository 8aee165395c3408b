//! The People Coordinator of the checkers player: the functions of `nets/checkers/people.net`, which note what people want. The player takes it up between two moves.

use coordinators::{dom::DomStore, handler::NetArgs};
use ctos::{
    config::{App, TaskConfig},
    diagnostic::Findings,
    task::HandlerError,
};
use pnt::library::{Acted, Action, Library};
use serde::Deserialize;

use crate::{
    player::DEEPEST,
    wire::{self, SETTINGS, Settings, WISH, Wish},
};

/// Arguments.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PeopleArgs {
    /// The data object manager.
    #[serde(default = "crate::coordinator::dom")]
    dom: String,
    /// The task of the room, whose light is set.
    #[serde(default = "crate::coordinator::room")]
    room: String,
}

/// What the functions share.
pub struct People {
    store: DomStore,
    room: String,
}

type Act = Action<People>;

impl NetArgs for PeopleArgs {
    const HANDLER: &'static str = "checkers.people";
    type State = People;

    fn dom(&self) -> &str {
        &self.dom
    }

    fn library(self, store: DomStore) -> Library<People> {
        let room = self.room;
        Library::new(People { store, room })
            // Between two requests there is nothing to know.
            .kept(|_| (), |_, ()| ())
            .action("hear", hear)
            .action("set", set)
    }

    fn check(&self, task: &TaskConfig, app: &App, findings: &mut Findings) {
        coordinators::need_task(task, app, "room", &self.room, findings);
    }
}

/// Sets how the player, or the light, is to be. It counts from the next look on.
async fn set(action: Act) -> Acted {
    let (store, room) = action.with_state(|state| (state.store.clone(), state.room.clone()));
    let cx = action.cx();
    let what = action.command().map(|command| command.symbol.clone());
    let what = what.unwrap_or_default();
    let given = action.arguments().first().cloned().unwrap_or_default();
    let number = number(&what, &given).map_err(HandlerError::new)?;
    let kept: Option<Settings> = store.fetch(cx, SETTINGS).await.ok();
    let mut settings = kept.unwrap_or_default();
    match what.as_str() {
        // In range: it is one of a few whole numbers.
        "depth" => settings.depth = Some(number as u32),
        "seconds" => settings.seconds = Some(number),
        "verbosity" => settings.verbosity = Some(number as u32),
        "dry" => settings.dry = Some(number > 0.5),
        _ => {
            wire::ask(cx, &room, wire::Shine { share: number }).await?;
            settings.light = Some(number);
        }
    }
    wire::keep(cx, &store, SETTINGS, &settings).await
}

/// The number that somebody wants something to be.
fn number(what: &str, given: &str) -> Result<f64, String> {
    let (least, most, whole) = match what {
        "depth" => (1.0, f64::from(DEEPEST), true),
        "seconds" => (0.01, 3600.0, false),
        "verbosity" => (1.0, 3.0, true),
        "dry" => (0.0, 1.0, true),
        _ => (0.0, 1.0, false),
    };
    let number = given.parse::<f64>().ok();
    let fits = |number: &f64| (least..=most).contains(number) && !(whole && number.fract() != 0.0);
    let whole = if whole { "a whole number" } else { "a number" };
    number
        .filter(fits)
        .ok_or_else(|| format!("`{what} {given}`: give {whole} from {least} to {most}"))
}

async fn hear(action: Act) -> Acted {
    let store = action.with_state(|state| state.store.clone());
    let cx = action.cx();
    let what = action.command().map(|command| command.symbol.clone());
    let before: Option<Wish> = store.fetch(cx, WISH).await.ok();
    let wish = Wish {
        number: before.map_or(0, |before| before.number) + 1,
        what: what.unwrap_or_default(),
    };
    wire::keep(cx, &store, WISH, &wish).await
}

#[cfg(test)]
mod tests {
    use super::number;

    #[test]
    fn what_people_want_is_a_number_in_its_range_and_else_they_are_told_which() {
        assert_eq!(number("depth", "6"), Ok(6.0));
        assert_eq!(number("seconds", "0.5"), Ok(0.5));
        assert_eq!(number("light", "0"), Ok(0.0));
        for (what, given) in [
            ("depth", "0"),
            ("depth", "2.5"),
            ("verbosity", "4"),
            ("dry", "maybe"),
            ("light", "nan"),
            ("seconds", ""),
        ] {
            let told = number(what, given).unwrap_err();
            assert!(told.contains(what) && told.contains(" from "), "{told}");
        }
    }
}
