//! The Dispatcher of `carry`: the functions of `nets/carry/dispatcher.net`, which turns a command in board coordinates into
//! an errand, and tells what became of it.

mod judging;
mod orders;
mod telling;

use std::rc::Rc;

use ctos::{
    config::{App, TaskConfig},
    diagnostic::{Finding, Findings},
    registry::Registry,
    task::Context,
};
use pnt::library::{Action, Library};
use serde::{Deserialize, Serialize};

use self::{
    judging::{aim, aim_point, judge, tell_found, weigh_hand, weigh_trouble},
    orders::{Wishes, begin, begin_point, refuse},
    telling::{report, report_held, report_point, tell_shown, tell_unverified},
};
use super::{
    board::Board,
    speaker::{self, Speaker},
    thing::Thing,
};
use crate::{
    dom::DomStore,
    handler::{self, NetArgs},
    outcome::Failure,
};

/// The handler's name.
pub const HANDLER: &str = "coordinators.carry";

/// Arguments.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct CarryArgs {
    /// The file of the thing that is carried, relative to the configuration's folder.
    thing: String,
    /// Where the board stands.
    pub(super) board: Board,
    /// How far above the fields the gripper goes to and fro, m.
    #[serde(default = "clearance_m")]
    clearance_m: f64,
    /// What is done when the thing was lost on the way and cameras see it.
    #[serde(default)]
    lost: Lost,
    /// How often the thing is tried to grasp, each time with another turn of the gripper.
    #[serde(default = "tries")]
    tries: u32,
    /// The service object that tells people in the room what went wrong, such as `fork.sound@speaker`; nobody when it is left
    /// out.
    speaker: Option<String>,
    /// Whether the pointer in the hand shows where the thing lies that was lost.
    #[serde(default)]
    show: bool,
    /// The data object manager.
    #[serde(default = "crate::dom_task")]
    dom: String,
}

fn clearance_m() -> f64 {
    0.1
}

/// What is done with a thing that was lost on the way.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
enum Lost {
    /// It is told where it lies.
    #[default]
    Tell,
    /// It is fetched, once.
    Fetch,
}

fn tries() -> u32 {
    2
}

/// More turns are not known.
const MOST_TRIES: u32 = 100;

/// What the functions share.
pub(super) struct Dispatcher {
    args: Rc<CarryArgs>,
    store: DomStore,
    /// Number of the command in work, from 1.
    command: u32,
    /// What was seen of its ends.
    ends: Ends,
    /// How often it was tried to grasp the thing, and whether it is tried once more.
    tried: u32,
    again: bool,
    /// The thing was lost, and is being fetched from where it was seen.
    fetches: bool,
    /// What the command's sender calls it, and what was in the way besides the problems of the Coordinators.
    tag: String,
    hindrances: Vec<Failure>,
    /// What it wants otherwise than the arguments say.
    wishes: Wishes,
}

impl Dispatcher {
    fn speaker(&self) -> Option<Speaker> {
        let name = self.wishes.speaker.as_ref();
        let name = name.or(self.args.speaker.as_ref())?;
        Speaker::named(name).ok()
    }
}

/// What was seen of the ends of an errand.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
struct Ends {
    /// Nothing stands on FROM.
    from_is_empty: bool,
    /// Something stands on TO.
    to_is_taken: bool,
    /// After it was set down, the thing is not seen on TO.
    is_elsewhere: bool,
    /// People in the room were told what went wrong.
    said: bool,
    /// Where it lies is shown them by the pointer in the hand.
    is_shown: bool,
    /// Something was in the hand before the errand.
    hand_is_full: bool,
}

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
        fetches: false,
        tag: String::new(),
        hindrances: Vec::new(),
        wishes: Wishes::default(),
    };
    Library::new(state)
        .kept(
            |state| {
                let tries = (state.tried, state.again, state.fetches);
                let why = (state.tag.clone(), state.hindrances.clone());
                let wishes = state.wishes.clone();
                (state.command, state.ends, tries, why, wishes)
            },
            |state, (command, ends, tries, why, wishes)| {
                (state.command, state.ends, state.wishes) = (command, ends, wishes);
                (state.tried, state.again, state.fetches) = tries;
                (state.tag, state.hindrances) = why;
            },
        )
        .enabling("from_is_empty", |state: &Dispatcher| {
            state.ends.from_is_empty
        })
        .enabling("to_is_taken", |state: &Dispatcher| state.ends.to_is_taken)
        .enabling("stands_there", |state: &Dispatcher| {
            !state.ends.is_elsewhere
        })
        .enabling("another_try", |state: &Dispatcher| state.again)
        .enabling("is_fetched", |state: &Dispatcher| state.again)
        .enabling("is_shown", |state: &Dispatcher| state.ends.is_shown)
        .enabling("hand_is_full", |state: &Dispatcher| state.ends.hand_is_full)
        .action("begin", begin)
        .action("weigh_hand", weigh_hand)
        .action("aim", aim)
        .action("judge", judge)
        .action("weigh_trouble", weigh_trouble)
        .action("tell_unverified", tell_unverified)
        .action("tell_found", tell_found)
        .action("tell_shown", tell_shown)
        .action("begin_point", begin_point)
        .action("aim_point", aim_point)
        .action("report_point", report_point)
        .action("report", report)
        .action("report_held", report_held)
        .action("refuse", refuse)
}

type Act = Action<Dispatcher>;

fn parts(action: &Act) -> (Context, Rc<CarryArgs>, DomStore) {
    let (args, store) = action.with_state(|state| (state.args.clone(), state.store.clone()));
    (action.cx().clone(), args, store)
}
