//! The Dispatcher of `carry`: the functions of `nets/carry/dispatcher.net`, which turns a command in board coordinates into
//! an errand, and tells what became of it.

mod aside;
mod judging;
mod orders;
mod state;
mod telling;
mod wishes;

use std::rc::Rc;

use ctos::{
    config::{App, TaskConfig},
    diagnostic::{Finding, Findings},
    registry::Registry,
};
use pnt::library::Library;

pub(super) use self::state::{CarryArgs, Dispatcher};
use self::{
    judging::{aim, aim_point, hear, judge, tell_found, weigh_hand, weigh_trouble},
    orders::{begin, begin_point, refuse},
    state::Ends,
    telling::{report, report_held, report_point, tell_shown, tell_unverified},
    wishes::{MOST_TRIES, Wishes},
};
use super::{speaker, thing::Thing};
use crate::{
    dom::DomStore,
    handler::{self, NetArgs},
};

/// The handler's name.
pub const HANDLER: &str = "coordinators.carry";

/// No thing has more others stuck to it.
const MOST_PUSHES: u32 = 12;

/// Registers the handler.
pub(super) fn register(registry: &mut Registry) {
    handler::register::<CarryArgs>(registry);
}

impl NetArgs for CarryArgs {
    const HANDLER: &'static str = HANDLER;
    type State = Dispatcher;

    fn dom(&self) -> &str {
        &self.dom
    }

    fn library(self, store: DomStore) -> Library<Dispatcher> {
        library(self, store)
    }

    fn check(&self, task: &TaskConfig, app: &App, findings: &mut Findings) {
        check(self, task, app, findings);
    }
}

fn check(args: &CarryArgs, task: &TaskConfig, app: &App, findings: &mut Findings) {
    let place = |key: &str| task.args.locate(key).unwrap_or_else(|| task.place.clone());
    if let Err((key, help)) = args.board.check() {
        let key = format!("board.{key}");
        let finding = Finding::error(
            "coordinators::carry::board",
            format!("`{key}` makes no sense"),
        );
        findings.push(finding.at(place(&key)).help(help));
    }
    if !(1..=MOST_TRIES).contains(&args.tries) {
        let text = format!("`tries` is {}", args.tries);
        let finding = Finding::error("coordinators::carry::board", text);
        let help = format!("give from 1 to {MOST_TRIES}");
        findings.push(finding.at(place("tries")).help(help));
    }
    if args.pushes > MOST_PUSHES {
        let text = format!("`pushes` is {}", args.pushes);
        let finding = Finding::error("coordinators::carry::board", text);
        let help = format!("give from 0 to {MOST_PUSHES}");
        findings.push(finding.at(place("pushes")).help(help));
    }
    if !(0.0..=2.0).contains(&args.clearance_m) {
        let text = format!("`clearance_m` is {}", args.clearance_m);
        let finding = Finding::error("coordinators::carry::board", text);
        findings.push(finding.at(place("clearance_m")).help("give from 0 to 2 m"));
    }
    speaker::check(args.speaker.as_deref(), task, app, findings);
    match app.read(&args.thing) {
        Ok(source) => {
            if let Err(found) = Thing::parse(&source) {
                findings.extend(found);
            }
        }
        Err(finding) => findings.push(finding.at(place("thing"))),
    }
}

fn library(args: CarryArgs, store: DomStore) -> Library<Dispatcher> {
    let state = Dispatcher {
        args: Rc::new(args),
        store,
        command: 0,
        ends: Ends::default(),
        tried: 0,
        again: false,
        aside: aside::Aside::default(),
        fetches: false,
        asks: false,
        tag: String::new(),
        hindrances: Vec::new(),
        wishes: Wishes::default(),
    };
    Library::new(state)
        .kept(
            |state| {
                let tries = (state.tried, state.again, state.fetches, state.asks);
                let why = (state.tag.clone(), state.hindrances.clone());
                let (wishes, aside) = (state.wishes.clone(), state.aside.clone());
                (state.command, state.ends, tries, why, wishes, aside)
            },
            |state, (command, ends, tries, why, wishes, aside)| {
                state.aside = aside;
                (state.command, state.ends, state.wishes) = (command, ends, wishes);
                (state.tried, state.again, state.fetches, state.asks) = tries;
                (state.tag, state.hindrances) = why;
            },
        )
        .enabling("from_is_empty", |state: &Dispatcher| {
            state.ends.from_is_empty
        })
        .enabling("to_is_taken", |state: &Dispatcher| state.ends.to_is_taken)
        .enabling("is_crowded", |state: &Dispatcher| state.ends.is_crowded)
        .enabling("to_the_left", |state: &Dispatcher| state.aside.is_left())
        .enabling("another_look", |state: &Dispatcher| state.again)
        .enabling("stands_there", |state: &Dispatcher| {
            !state.ends.is_elsewhere
        })
        .enabling("another_try", |state: &Dispatcher| state.again)
        .enabling("is_fetched", |state: &Dispatcher| state.again)
        .enabling("is_asked", |state: &Dispatcher| state.asks)
        .enabling("is_shown", |state: &Dispatcher| state.ends.is_shown)
        .enabling("hand_is_full", |state: &Dispatcher| state.ends.hand_is_full)
        .action("begin", begin)
        .action("weigh_hand", weigh_hand)
        .action("aim", aim)
        .action("choose_side", aside::choose_side)
        .action("weigh_push", aside::weigh_push)
        .action("judge", judge)
        .action("weigh_trouble", weigh_trouble)
        .action("tell_unverified", tell_unverified)
        .action("tell_found", tell_found)
        .action("tell_shown", tell_shown)
        .action("hear", hear)
        .action("begin_point", begin_point)
        .action("aim_point", aim_point)
        .action("report_point", report_point)
        .action("report", report)
        .action("report_held", report_held)
        .action("refuse", refuse)
}
