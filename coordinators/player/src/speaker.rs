//! The Speaker Coordinator of the checkers player: the functions of `nets/checkers/speaker.net`, which tell people what to know.

use coordinators::{carry::speaker, dom::DomStore, handler::NetArgs, served::Served};
use ctos::{
    config::{App, TaskConfig},
    diagnostic::Findings,
};
use pnt::library::{Acted, Action, Library};
use serde::Deserialize;

use crate::wire::{self, Words};

/// Arguments.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SpeakerArgs {
    /// The data object manager.
    #[serde(default = "crate::coordinator::dom")]
    dom: String,
    /// The task of the room.
    #[serde(default = "crate::coordinator::room")]
    room: String,
    /// The service object that speaks, such as `fork.sound@speaker_daemon`.
    speaker: Option<String>,
}

/// What the functions share.
pub struct Speaker {
    args: SpeakerArgs,
    store: DomStore,
}

type Act = Action<Speaker>;

impl NetArgs for SpeakerArgs {
    const HANDLER: &'static str = "checkers.speaker";
    type State = Speaker;

    fn dom(&self) -> &str {
        &self.dom
    }

    fn library(self, store: DomStore) -> Library<Speaker> {
        Library::new(Speaker { args: self, store })
            // Between two requests there is nothing to know.
            .kept(|_| (), |_, ()| ())
            .action("say", say)
    }

    fn check(&self, task: &TaskConfig, app: &App, findings: &mut Findings) {
        coordinators::need_task(task, app, "room", &self.room, findings);
        speaker::check(self.speaker.as_deref(), task, app, findings);
    }
}

fn parts(action: &Act) -> (SpeakerArgs, DomStore) {
    action.with_state(|state| (state.args.clone(), state.store.clone()))
}

async fn say(action: Act) -> Acted {
    let (args, store) = parts(&action);
    let cx = action.cx();
    let told: Words = wire::fetch(cx, &store, wire::WORDS).await?;
    let Words {
        number,
        words,
        shown,
        board,
    } = told;
    let object = args.speaker.as_deref();
    let object = object.and_then(|name| Served::named(name).ok());
    speaker::say(cx, object.as_ref(), &words);
    let hear = wire::Hear {
        number,
        words,
        shown,
        board,
    };
    wire::ask(cx, &args.room, hear).await
}
