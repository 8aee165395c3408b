//! The Hand Coordinator of the checkers player: the functions of `nets/checkers/hand.net`, which grasp discs and let them go.

use ctos::{
    config::{App, TaskConfig},
    diagnostic::Findings,
    task::HandlerError,
};
use pnt::library::{Acted, Action, Library};

use crate::{
    coordinator::{Functions, InRoom},
    real::GripperArgs,
    wire::{self, Errand},
};

/// The functions.
#[derive(Debug, Clone)]
pub struct Hand;

type Act = Action<InRoom<Hand>>;

impl Functions for Hand {
    const HANDLER: &'static str = "checkers.hand";
    type Real = GripperArgs;

    fn add(library: Library<InRoom<Self>>) -> Library<InRoom<Self>> {
        library.action("grasp", grasp).action("release", release)
    }

    fn check(real: &GripperArgs, task: &TaskConfig, app: &App, findings: &mut Findings) {
        real.check(task, app, findings);
    }
}

async fn grasp(action: Act) -> Acted {
    let InRoom {
        store, room, real, ..
    } = InRoom::of(&action);
    let cx = action.cx();
    if let Some(gripper) = &*real {
        let grasped = gripper.grasp(cx).await;
        if let Err(error) = &grasped {
            tracing::warn!(%error, "the hand has grasped nothing");
        }
        return grasped;
    }
    let Errand { number, discs, .. } = wire::fetch(cx, &store, wire::ERRAND).await?;
    let close = wire::Close {
        errand: number,
        discs,
    };
    if wire::ask(cx, &room, close).await? == discs {
        return Ok(());
    }
    Err(HandlerError::new("there is nothing between the fingers"))
}

/// Fails when the hand was empty before.
async fn release(action: Act) -> Acted {
    let InRoom {
        store, room, real, ..
    } = InRoom::of(&action);
    let cx = action.cx();
    if let Some(gripper) = &*real {
        return gripper.release(cx).await;
    }
    let Errand { number, discs, .. } = wire::fetch(cx, &store, wire::ERRAND).await?;
    if wire::ask(cx, &room, wire::Open { errand: number }).await? == discs {
        return Ok(());
    }
    Err(HandlerError::new("the disc was lost on the way"))
}
