//! The Robot Coordinator of the checkers player: the functions of `nets/checkers/robot.net`, which move the arm and tell what keeps it
//! from that. The room says whether somebody's hand is in the way, and in a dry game it has the arm too.

use ctos::{
    config::{App, TaskConfig},
    diagnostic::Findings,
    task::HandlerError,
};
use pnt::library::{Acted, Action, Library};

use crate::{
    coordinator::{Functions, InRoom},
    real::ArmArgs,
    wire::{self, Errand, Hindrance, Why},
};

/// The functions.
#[derive(Debug, Clone)]
pub struct Robot;

type Act = Action<InRoom<Robot>>;

impl Functions for Robot {
    const HANDLER: &'static str = "checkers.robot";
    type Real = ArmArgs;

    fn add(library: Library<InRoom<Self>>) -> Library<InRoom<Self>> {
        let is = |asked: fn(Why) -> bool| {
            move |robot: &InRoom<Self>| robot.hindrance.as_ref().is_some_and(|own| asked(own.why))
        };
        library
            .action("reach", |action| go(action, Some(Way::To(0))))
            .action("transfer", |action| go(action, Some(Way::To(1))))
            .action("push", |action| go(action, Some(Way::Push)))
            .action("park", |action| go(action, None))
            .action("pass_up", pass_up)
            .enabling("hand_in_the_way", is(|why| why == Why::HandInTheWay))
            .enabling("out_of_reach", is(|why| matches!(why, Why::OutOfReach(_))))
            .enabling("disc_lost", is(|why| why == Why::DiscLost))
            .enabling("no_power", is(|why| why == Why::NoPower))
    }

    fn check(real: &ArmArgs, task: &TaskConfig, app: &App, findings: &mut Findings) {
        real.check(task, app, findings);
    }
}

/// What the arm is to do with an errand.
#[derive(Debug, Clone, Copy)]
enum Way {
    /// Go to one of its ends.
    To(u8),
    /// Push the disc from the one to the other.
    Push,
}

/// Does that, or goes to where the arm waits; notes what keeps it from that.
async fn go(action: Act, way: Option<Way>) -> Acted {
    let gone = gone(&action, way).await;
    let hindrance = gone.err();
    action.with_state(|robot| robot.hindrance.clone_from(&hindrance));
    match hindrance {
        Some(hindrance) => Err(HandlerError::new(hindrance.text)),
        None => Ok(()),
    }
}

async fn gone(action: &Act, way: Option<Way>) -> Result<(), Hindrance> {
    let InRoom {
        store, room, real, ..
    } = InRoom::of(action);
    let cx = action.cx();
    let free = |why: Option<Why>| why.map_or(Ok(()), |why| Err(Hindrance::told(why)));
    let Some(way) = way else {
        if let Some(arm) = &*real {
            let parked = arm.park(cx).await;
            parked.map_err(|failure| Hindrance::of(&failure, 0))?;
        }
        let home = wire::Go {
            to: None,
            then: None,
        };
        return free(wire::ask(cx, &room, home).await?);
    };
    let points: [[f64; 2]; 2] = wire::fetch(cx, &store, wire::POINTS).await?;
    let [from, to] = points;
    let (to_there, then) = match way {
        Way::To(1) => (to, None),
        _ => (from, Some(to)),
    };
    let there = wire::Go {
        to: Some(to_there),
        then,
    };
    free(wire::ask(cx, &room, there).await?)?;
    let Some(arm) = &*real else {
        return match way {
            Way::Push => free(wire::ask(cx, &room, wire::Shove { from, to }).await?),
            Way::To(_) => Ok(()),
        };
    };
    let errand: Errand = wire::fetch(cx, &store, wire::ERRAND).await?;
    let [from, to] = arm.stands(&errand, &points);
    match way {
        Way::To(1) => {
            let transferred = arm.transfer(cx, to).await;
            return transferred.map_err(|failure| Hindrance::of(&failure, 1));
        }
        Way::Push => {
            let pushed = arm.push(cx, from, to).await;
            return pushed.map_err(|failure| Hindrance::of(&failure, 0));
        }
        Way::To(_) => {}
    }
    arm.reach(cx, from, to).await
}

/// Tells the player why.
async fn pass_up(action: Act) -> Acted {
    let InRoom {
        store, hindrance, ..
    } = InRoom::of(&action);
    let hindrance = hindrance.unwrap_or_else(|| Hindrance::told(Why::Fault));
    wire::keep(action.cx(), &store, wire::HINDRANCE, &hindrance).await
}
