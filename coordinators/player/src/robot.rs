//! The Robot Coordinator of the checkers player: the functions of `nets/checkers/robot.net`, which move the arm. The room says whether
//! somebody's hand is in the way, and in a dry game it has the arm too.

use ctos::{
    config::{App, TaskConfig},
    diagnostic::Findings,
    task::HandlerError,
};
use pnt::library::{Acted, Action, Library};

use crate::{
    coordinator::{Functions, InRoom},
    real::{ArmArgs, Stand},
    wire::{self, Errand},
};

/// The functions.
#[derive(Debug, Clone)]
pub struct Robot;

type Act = Action<InRoom<Robot>>;

impl Functions for Robot {
    const HANDLER: &'static str = "checkers.robot";
    type Real = ArmArgs;

    fn add(library: Library<InRoom<Self>>) -> Library<InRoom<Self>> {
        library
            .action("reach", |action| go(action, Some(0)))
            .action("transfer", |action| go(action, Some(1)))
            .action("park", |action| go(action, None))
    }

    fn check(real: &ArmArgs, task: &TaskConfig, app: &App, findings: &mut Findings) {
        real.check(task, app, findings);
    }
}

/// Goes to an end of the errand, or to where the arm waits.
async fn go(action: Act, end: Option<usize>) -> Acted {
    let InRoom { store, room, real } = InRoom::of(&action);
    let cx = action.cx();
    let Some(end) = end else {
        if let Some(arm) = &*real {
            arm.park(cx).await?;
        }
        return match wire::ask(cx, &room, wire::Go { to: None }).await? {
            true => Ok(()),
            false => Err(HandlerError::new("a hand is over the board")),
        };
    };
    let points: [[f64; 2]; 2] = wire::fetch(cx, &store, wire::POINTS).await?;
    let to = points.get(end).copied();
    if !wire::ask(cx, &room, wire::Go { to }).await? {
        return Err(HandlerError::new("a hand is over the board"));
    }
    let Some(arm) = &*real else { return Ok(()) };
    let errand: Errand = wire::fetch(cx, &store, wire::ERRAND).await?;
    let stand = Stand::of(&errand, &points, end).ok_or("an errand has two ends")?;
    match end {
        0 => arm.reach(cx, stand).await?,
        _ => arm.transfer(cx, stand).await?,
    }
    Ok(())
}
