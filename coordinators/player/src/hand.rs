//! The Hand Coordinator of the checkers player: the functions of `nets/checkers/hand.net`, which grasp discs and let them go.

use ctos::task::HandlerError;
use pnt::library::{Acted, Action, Library};

use crate::{
    coordinator::{Functions, InRoom},
    wire::{self, Errand},
};

/// The functions.
#[derive(Debug, Clone)]
pub struct Hand;

impl Functions for Hand {
    const HANDLER: &'static str = "checkers.hand";

    fn add(library: Library<InRoom>) -> Library<InRoom> {
        library.action("grasp", grasp).action("release", release)
    }
}

async fn grasp(action: Action<InRoom>) -> Acted {
    let InRoom { store, room } = InRoom::of(&action);
    let cx = action.cx();
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
async fn release(action: Action<InRoom>) -> Acted {
    let InRoom { store, room } = InRoom::of(&action);
    let cx = action.cx();
    let Errand { number, discs, .. } = wire::fetch(cx, &store, wire::ERRAND).await?;
    if wire::ask(cx, &room, wire::Open { errand: number }).await? == discs {
        return Ok(());
    }
    Err(HandlerError::new("the disc was lost on the way"))
}
