//! The People Coordinator: the functions of `nets/carry/people.net`, which ask people in the room whether a thing that was lost is
//! fetched. They answer on the tape of its net.

use std::rc::Rc;

use ctos::{
    config::{App, TaskConfig},
    diagnostic::Findings,
    registry::Registry,
    task::HandlerError,
};
use pnt::library::{Acted, Action, Library};
use serde::{Deserialize, Serialize};

use super::{
    errand::{ERRAND, Errand, PEOPLE_PROBLEMS, note_problem},
    speaker,
};
use crate::{
    dom::DomStore,
    handler::{self, NetArgs},
    outcome::{Failure, Outcome},
    served::Served,
};

/// The handler's name.
pub const HANDLER: &str = "coordinators.carry_people";

/// What people answered: written by the People Coordinator.
pub const ANSWERED: &str = "answered";

/// What becomes of a thing that was lost.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum Answer {
    /// It is fetched.
    Fetch,
    /// It stays where it lies.
    Leave,
}

/// [`ANSWERED`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Answered {
    /// The errand's command.
    pub command: u32,
    /// The answer.
    pub answer: Answer,
}

/// Arguments.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
struct PeopleArgs {
    /// The data object manager.
    #[serde(default = "crate::dom_task")]
    dom: String,
    /// The service object that asks, such as `fork.sound@speaker`; the question stands in the log alone when it is left out.
    speaker: Option<String>,
}

/// What the functions share.
struct Coordinator {
    args: Rc<PeopleArgs>,
    store: DomStore,
}

type Act = Action<Coordinator>;

/// Registers the handler.
pub(super) fn register(registry: &mut Registry) {
    handler::register::<PeopleArgs>(registry);
}

impl NetArgs for PeopleArgs {
    const HANDLER: &'static str = HANDLER;
    type State = Coordinator;

    fn dom(&self) -> &str {
        &self.dom
    }

    fn library(self, store: DomStore) -> Library<Coordinator> {
        Library::new(Coordinator {
            args: Rc::new(self),
            store,
        })
        // The question is in the DOM.
        .kept(|_| (), |_, ()| ())
        .action("question", question)
        .action("hear", hear)
        .action("tell_unanswered", tell_unanswered)
    }

    fn check(&self, task: &TaskConfig, app: &App, findings: &mut Findings) {
        speaker::check(self.speaker.as_deref(), task, app, findings);
    }
}

async fn question(action: Act) -> Acted {
    let (args, store) = action.with_state(|state| (state.args.clone(), state.store.clone()));
    let cx = action.cx();
    let errand: Errand = store.fetch(cx, ERRAND).await?;
    tracing::warn!(
        "shall the {} be fetched? Say so with `carry.answer EXEC fetch`, or `leave`",
        errand.thing.name
    );
    let speaker = args.speaker.as_deref();
    let speaker = speaker.and_then(|name| Served::named(name).ok());
    let words = format!("fetch the {} or leave it", errand.thing.name);
    speaker::say(cx, speaker.as_ref(), &words);
    Ok(())
}

async fn hear(action: Act) -> Acted {
    let answer = match action.arguments() {
        [word] if word == "fetch" => Answer::Fetch,
        [word] if word == "leave" => Answer::Leave,
        other => {
            let text = format!("`{}` is no answer: fetch or leave", other.join(" "));
            action.note(&text);
            return Err(HandlerError::new(text));
        }
    };
    let store = action.with_state(|state| state.store.clone());
    let errand: Errand = store.fetch(action.cx(), ERRAND).await?;
    let command = errand.command;
    let answered = Answered { command, answer };
    store.store(action.cx(), ANSWERED, &answered).await
}

async fn tell_unanswered(action: Act) -> Acted {
    let store = action.with_state(|state| state.store.clone());
    let text = "nobody answered whether it shall be fetched";
    let failure = Failure::new(Outcome::Refused, text);
    note_problem(action.cx(), &store, PEOPLE_PROBLEMS, "question", &failure).await;
    Ok(())
}
