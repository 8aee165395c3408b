//! The Robot Coordinator of the checkers player: the functions of `nets/checkers/robot.net`, which move the arm.

use coordinators::{dom::DomStore, handler::NetArgs};
use ctos::{
    config::{App, TaskConfig},
    diagnostic::Findings,
    task::HandlerError,
};
use pnt::library::{Acted, Action, Library};
use serde::Deserialize;

use crate::wire;

/// Arguments.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RobotArgs {
    /// The data object manager.
    #[serde(default = "dom")]
    dom: String,
    /// The task of the room.
    #[serde(default = "room")]
    room: String,
}

fn dom() -> String {
    "dom".to_owned()
}

fn room() -> String {
    "room".to_owned()
}

/// What the functions share.
pub struct Robot {
    args: RobotArgs,
    store: DomStore,
}

type Act = Action<Robot>;

impl NetArgs for RobotArgs {
    const HANDLER: &'static str = "checkers.robot";
    type State = Robot;

    fn dom(&self) -> &str {
        &self.dom
    }

    fn library(self, store: DomStore) -> Library<Robot> {
        Library::new(Robot { args: self, store })
            // Between two requests there is nothing to know.
            .kept(|_| (), |_, ()| ())
            .action("reach", |action| go(action, Some(0)))
            .action("transfer", |action| go(action, Some(1)))
            .action("park", |action| go(action, None))
    }

    fn check(&self, task: &TaskConfig, app: &App, findings: &mut Findings) {
        coordinators::need_task(task, app, "room", &self.room, findings);
    }
}

fn parts(action: &Act) -> (RobotArgs, DomStore) {
    action.with_state(|state| (state.args.clone(), state.store.clone()))
}

/// Goes above an end of the errand, or to where the arm waits.
async fn go(action: Act, end: Option<usize>) -> Acted {
    let (args, store) = parts(&action);
    let cx = action.cx();
    let points: Option<[[f64; 2]; 2]> = match end {
        Some(_) => Some(wire::fetch(cx, &store, wire::POINTS).await?),
        None => None,
    };
    let to = end.and_then(|end| points?.get(end).copied());
    if wire::ask(cx, &args.room, wire::Go { to }).await? {
        return Ok(());
    }
    Err(HandlerError::new("a hand is over the board"))
}
