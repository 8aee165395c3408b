//! The Vision Coordinator of `carry`: the functions of `nets/carry/vision.net`, which find the board and what lies on it before
//! anything moves, and the thing after it.
//!
//! The module `look` is one look over the table; `ways` has the ways of looking, of which it takes the one most likely to see. The board's
//! place may also be that of the configuration, always or when no camera sees it. Nothing is verified then.

mod look;
mod ways;

use std::rc::Rc;

use ctos::{
    config::{App, TaskConfig},
    diagnostic::{Finding, Findings},
    registry::Registry,
};
use pnt::library::{Action, Library};
use serde::Deserialize;

use self::{
    look::Look,
    ways::{AnotherArgs, Viewpoint},
};
use super::board::Board;
use crate::{
    dom::DomStore,
    handler::{self, NetArgs},
    outcome::Failure,
    strategy::{Belief, Step},
};

/// The handler's name.
pub const HANDLER: &str = "coordinators.carry_vision";

/// Where the board is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
enum Where {
    /// Where cameras see it.
    Seen,
    /// The same; where the configuration has it when none sees it.
    SeenElseKnown,
    /// Where the configuration has it. No camera is asked.
    Known,
}

/// Arguments.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
struct VisionArgs {
    /// How it is known where the board is.
    #[serde(default = "seen")]
    board: Where,
    /// The task that looks.
    #[serde(default = "eyes_task")]
    eyes: String,
    /// The data object manager.
    #[serde(default = "crate::dom_task")]
    dom: String,
    /// How often it looks again when it did not see the board.
    #[serde(default = "retries")]
    retries: u32,
    /// How long a vision system that is gone, and may be started again, is waited for, s.
    #[serde(default = "crate::service_within_s")]
    service_within_s: f64,
    /// The camera on the hand, which looks from other poses when the others see nothing, or not for sure; the arm stays where it is
    /// when it is left out.
    another: Option<AnotherArgs>,
}

fn seen() -> Where {
    Where::Seen
}

fn eyes_task() -> String {
    "eyes".to_owned()
}

fn retries() -> u32 {
    2
}

type Act = Action<Coordinator>;

/// What the functions share.
struct Coordinator {
    args: Rc<VisionArgs>,
    store: DomStore,
    /// What is asked for.
    look: Look,
    /// So many more pictures of the room, when the board is not in the first.
    tries_left: u32,
    /// The way of looking that is in work.
    step: Step<Viewpoint>,
    belief: Belief,
    choices: u64,
    /// Something was seen, perhaps in doubt.
    was_seen: bool,
    /// Why it was not seen.
    missed: Option<Failure>,
    /// The arm was moved to look.
    has_moved: bool,
    /// Where the board was seen last.
    last: Option<Board>,
}

/// Registers the handler.
pub(super) fn register(registry: &mut Registry) {
    handler::register::<VisionArgs>(registry);
}

impl NetArgs for VisionArgs {
    const HANDLER: &'static str = HANDLER;
    type State = Coordinator;

    fn dom(&self) -> &str {
        &self.dom
    }

    fn library(self, store: DomStore) -> Library<Coordinator> {
        library(self, store)
    }

    fn check(&self, task: &TaskConfig, app: &App, findings: &mut Findings) {
        crate::check_seconds(task, "service_within_s", self.service_within_s, findings);
        if self.board != Where::Known {
            crate::need_task(task, app, "eyes", &self.eyes, findings);
        }
        if let Some(another) = &self.another {
            another.check((task, app), self.service_within_s, findings);
        }
        if self.retries > MOST_RETRIES {
            let place = task.args.locate("retries");
            let text = format!("`retries` is {}", self.retries);
            findings.push(
                Finding::error("coordinators::carry::eyes", text)
                    .at(place.unwrap_or_else(|| task.place.clone()))
                    .help(format!("give up to {MOST_RETRIES}")),
            );
        }
    }
}

/// Nobody looks more often.
const MOST_RETRIES: u32 = 100;

fn library(args: VisionArgs, store: DomStore) -> Library<Coordinator> {
    let state = Coordinator {
        args: Rc::new(args),
        store,
        look: Look::Find,
        tries_left: 0,
        step: Step::default(),
        belief: Belief::default(),
        choices: 0,
        was_seen: false,
        missed: None,
        has_moved: false,
        last: None,
    };
    let save = |state: &Coordinator| {
        let asked = (state.look, state.tries_left, state.was_seen, state.last);
        let ways = (state.step.clone(), state.belief.clone(), state.choices);
        let failed = (state.missed.clone(), state.has_moved);
        (asked, ways, failed)
    };
    let mut library = Library::new(state)
        .kept(save, |state, (asked, ways, failed)| {
            (state.look, state.tries_left, state.was_seen, state.last) = asked;
            (state.step, state.belief, state.choices) = ways;
            (state.missed, state.has_moved) = failed;
        })
        .enabling("ways_left", |state: &Coordinator| {
            !state.step.open.is_empty()
        })
        .enabling("by_room", |state: &Coordinator| {
            state.step.chosen == Some(Viewpoint::Room)
        })
        .enabling("tries_left", |state: &Coordinator| state.tries_left > 0)
        .enabling("stopped", |state: &Coordinator| state.step.is_stopped())
        .enabling("another_may_do", |state: &Coordinator| {
            state.step.may_go_on()
        })
        .enabling("has_moved", |state: &Coordinator| state.has_moved)
        .enabling("was_seen", |state: &Coordinator| state.was_seen)
        .action("choose", ways::choose)
        .action("look_from_the_room", ways::from_the_room)
        .action("look_from_another_pose", ways::from_another_pose)
        .action("look_again", ways::again)
        .action("await_resume", ways::await_resume)
        .action("next_way", ways::next_way)
        .action("go_home", ways::go_home)
        .action("tell_doubt", ways::tell_doubt)
        .action("do_without", ways::do_without);
    for look in [Look::Find, Look::Verify, Look::Search] {
        library = library.action(look.name(), move |action| ways::begin(action, look));
    }
    library
}
