//! The Robot Coordinator of the checkers player: the functions of `nets/checkers/robot.net`, which move the arm.

use ctos::task::HandlerError;
use pnt::library::{Acted, Action, Library};

use crate::{
    coordinator::{Functions, InRoom},
    wire,
};

/// The functions.
#[derive(Debug, Clone)]
pub struct Robot;

impl Functions for Robot {
    const HANDLER: &'static str = "checkers.robot";

    fn add(library: Library<InRoom>) -> Library<InRoom> {
        library
            .action("reach", |action| go(action, Some(0)))
            .action("transfer", |action| go(action, Some(1)))
            .action("park", |action| go(action, None))
    }
}

/// Goes above an end of the errand, or to where the arm waits.
async fn go(action: Action<InRoom>, end: Option<usize>) -> Acted {
    let InRoom { store, room } = InRoom::of(&action);
    let cx = action.cx();
    let points: Option<[[f64; 2]; 2]> = match end {
        Some(_) => Some(wire::fetch(cx, &store, wire::POINTS).await?),
        None => None,
    };
    let to = end.and_then(|end| points?.get(end).copied());
    if wire::ask(cx, &room, wire::Go { to }).await? {
        return Ok(());
    }
    Err(HandlerError::new("a hand is over the board"))
}
