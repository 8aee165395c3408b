//! What the functions of the Dispatcher share: its arguments, and what it knows of the command in work.

use std::rc::Rc;

use ctos::task::Context;
use pnt::library::Action;
use serde::{Deserialize, Serialize};

use super::{
    aside::Aside,
    wishes::{Lost, Wishes},
};
use crate::{carry::board::Board, dom::DomStore, outcome::Failure, served::Served};

/// Arguments.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub(in crate::carry) struct CarryArgs {
    /// The file of the thing that is carried, relative to the configuration's folder.
    pub thing: String,
    /// Where the board stands.
    pub(in crate::carry) board: Board,
    /// How far above the fields the gripper goes to and fro, m.
    #[serde(default = "clearance_m")]
    pub clearance_m: f64,
    /// What is done when the thing was lost on the way and cameras see it.
    #[serde(default)]
    pub lost: Lost,
    /// How often the thing is tried to grasp, each time with another turn of the gripper.
    #[serde(default = "tries")]
    pub tries: u32,
    /// How often things that are stuck to it are pushed aside before it is grasped.
    #[serde(default)]
    pub pushes: u32,
    /// The service object that tells people in the room what went wrong, such as `fork.sound@speaker`; nobody when it is left
    /// out.
    pub speaker: Option<String>,
    /// Whether the pointer in the hand shows where the thing lies that was lost.
    #[serde(default)]
    pub show: bool,
    /// The data object manager.
    #[serde(default = "crate::dom_task")]
    pub dom: String,
}

fn clearance_m() -> f64 {
    0.1
}

fn tries() -> u32 {
    2
}

/// What the functions share.
pub(in crate::carry) struct Dispatcher {
    pub args: Rc<CarryArgs>,
    pub store: DomStore,
    /// Number of the command in work, from 1.
    pub command: u32,
    /// What was seen of its ends.
    pub ends: Ends,
    /// How often it was tried to grasp the thing, and whether it is tried once more.
    pub tried: u32,
    pub again: bool,
    /// What is stuck to the thing, and is pushed aside.
    pub aside: Aside,
    /// The thing was lost, and is being fetched from where it was seen.
    pub fetches: bool,
    /// A person is asked whether it is fetched.
    pub asks: bool,
    /// What the command's sender calls it, and what was in the way besides the problems of the Coordinators.
    pub tag: String,
    pub hindrances: Vec<Failure>,
    /// What it wants otherwise than the arguments say.
    pub wishes: Wishes,
}

impl Dispatcher {
    pub fn speaker(&self) -> Option<Served> {
        let name = self.wishes.speaker.as_ref();
        let name = name.or(self.args.speaker.as_ref())?;
        Served::named(name).ok()
    }
}

/// What was seen of the ends of an errand.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
pub(in crate::carry) struct Ends {
    /// Nothing stands on FROM.
    pub from_is_empty: bool,
    /// Something stands on TO.
    pub to_is_taken: bool,
    /// After it was set down, the thing is not seen on TO.
    pub is_elsewhere: bool,
    /// People in the room were told what went wrong.
    pub said: bool,
    /// Where it lies is shown them by the pointer in the hand.
    pub is_shown: bool,
    /// Another thing is stuck to that on FROM, and is pushed aside.
    pub is_crowded: bool,
    /// Something was in the hand before the errand.
    pub hand_is_full: bool,
}

pub(super) type Act = Action<Dispatcher>;

pub(super) fn parts(action: &Act) -> (Context, Rc<CarryArgs>, DomStore) {
    let (args, store) = action.with_state(|state| (state.args.clone(), state.store.clone()));
    (action.cx().clone(), args, store)
}
