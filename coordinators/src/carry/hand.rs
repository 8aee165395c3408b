//! The Hand Coordinator: the functions of `nets/carry/hand.net`, which open and close the gripper, and see what it holds. A hand
//! that grasps with three fingertips is asked for the same.

use std::{future::Future, rc::Rc, time::Duration};

use ctos::{
    config::{App, TaskConfig},
    diagnostic::Findings,
    message::Command,
    registry::Registry,
    task::Context,
};
use mcs::client::{MotionError, Outcome as Motion};
use mcs_hand::command::{Grasp, Held, Open, ReadHeld};
use pnt::library::{Acted, Action, Library};
use serde::Deserialize;

use super::{
    errand::{ERRAND, Errand, HAND_PROBLEMS},
    speaker,
};
use crate::{
    dom::DomStore,
    handler::{self, NetArgs},
    outcome::{Failure, Outcome},
    served::Served,
};

/// The handler's name.
pub const HANDLER: &str = "coordinators.carry_hand";

/// How long the jaws may take.
const LIMIT: Duration = Duration::from_secs(60);

/// Arguments.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
struct HandArgs {
    /// The task of the gripper, or of a hand.
    #[serde(default = "gripper_task")]
    gripper: String,
    /// The data object manager.
    #[serde(default = "crate::dom_task")]
    dom: String,
    /// Fraction of full speed of the jaws.
    #[serde(default = "speed")]
    speed: f64,
    /// The service object that tells people in the room what the hand could not do, such as `fork.sound@speaker`; nobody when it is
    /// left out.
    speaker: Option<String>,
    /// How long a gripper that is gone, and may be started again, is waited for, s.
    #[serde(default = "crate::service_within_s")]
    service_within_s: f64,
}

fn gripper_task() -> String {
    "gripper".to_owned()
}

fn speed() -> f64 {
    0.5
}

/// What the functions share.
struct Coordinator {
    args: Rc<HandArgs>,
    store: DomStore,
}

/// Registers the handler.
pub(super) fn register(registry: &mut Registry) {
    handler::register::<HandArgs>(registry);
}

impl NetArgs for HandArgs {
    const HANDLER: &'static str = HANDLER;
    type State = Coordinator;

    fn dom(&self) -> &str {
        &self.dom
    }

    fn library(self, store: DomStore) -> Library<Coordinator> {
        library(self, store)
    }

    fn check(&self, task: &TaskConfig, app: &App, findings: &mut Findings) {
        crate::need_task(task, app, "gripper", &self.gripper, findings);
        speaker::check(self.speaker.as_deref(), task, app, findings);
        crate::check_seconds(task, "service_within_s", self.service_within_s, findings);
        crate::check_speed(task, "speed", self.speed, findings);
    }
}

fn library(args: HandArgs, store: DomStore) -> Library<Coordinator> {
    Library::new(Coordinator {
        args: Rc::new(args),
        store,
    })
    // Between two requests there is nothing to know.
    .kept(|_| (), |_, ()| ())
    .action("feel", |action| done(action, "feel", feel))
    .action("preshape", |action| done(action, "preshape", preshape))
    .action("grasp", |action| done(action, "grasp", grasp))
    .action("check", |action| done(action, "check", check))
    .action("let_go", |action| done(action, "let_go", preshape))
}

type Act = Action<Coordinator>;

/// Does one thing for the errand, and tells the Dispatcher why when that fails.
async fn done<F: Future<Output = Result<(), Failure>>>(
    action: Act,
    request: &'static str,
    act: impl Fn(Hand, Errand) -> F,
) -> Acted {
    let (args, store) = action.with_state(|state| (state.args.clone(), state.store.clone()));
    let speaker = args
        .speaker
        .as_deref()
        .and_then(|name| Served::named(name).ok());
    let hand = Hand {
        cx: action.cx().clone(),
        args,
    };
    let acted = async {
        let errand: Errand = store.fetch(action.cx(), ERRAND).await?;
        act(hand, errand).await
    };
    let acted: Result<(), Failure> = acted.await;
    if let Err(failure) = acted {
        if let Some(speaker) = &speaker {
            speaker::say(action.cx(), Some(speaker), &failure.reason);
        }
        super::errand::note_problem(action.cx(), &store, HAND_PROBLEMS, request, &failure).await;
        return Err(failure.into());
    }
    Ok(())
}

/// The gripper, as one action asks it.
struct Hand {
    cx: Context,
    args: Rc<HandArgs>,
}

impl Hand {
    /// Asks, again while the gripper's task is gone and may be started again: each request may be made twice.
    async fn ask<C>(&self, request: C) -> Result<Held, Failure>
    where
        C: Command<Reply = Result<Held, MotionError>> + Clone,
    {
        let within = Duration::try_from_secs_f64(self.args.service_within_s);
        let within = within.unwrap_or(Duration::MAX);
        let is_lost = |error: &MotionError| error.outcome == Motion::Lost;
        let asked = crate::patiently(&self.cx, within, is_lost, || async {
            let gripper = self.cx.task(&self.args.gripper).await?;
            let call = self.cx.call(&gripper, request.clone());
            call.deadline(LIMIT).await?
        });
        Ok(asked.await?)
    }

    /// Closes as hard as the thing is grasped.
    async fn close(&self, errand: &Errand) -> Result<Held, Failure> {
        let close = Grasp {
            force_n: Some(errand.thing.grasp.force_n),
            speed: self.args.speed,
        };
        self.ask(close).await
    }
}

/// Closes, and sees that nothing is between the jaws. Who was asked last knows nothing of earlier lives.
async fn feel(hand: Hand, errand: Errand) -> Result<(), Failure> {
    let held = hand.close(&errand).await?;
    if !held.holds {
        return Ok(());
    }
    let text = format!(
        "something {:.1} mm wide is in the hand already: take it out, or say `put_back`",
        held.width_m * 1e3
    );
    Err(Failure::new(Outcome::Occupied, text))
}

/// Opens as far as goes round the thing and between its neighbours, which also lets go of it.
async fn preshape(hand: Hand, errand: Errand) -> Result<(), Failure> {
    let open = Open {
        width_m: Some(errand.open_m),
        speed: hand.args.speed,
    };
    hand.ask(open).await.map(|_| ())
}

/// Closes on the thing, and sees that it is that.
async fn grasp(hand: Hand, errand: Errand) -> Result<(), Failure> {
    is_it(&hand.close(&errand).await?, &errand)
}

/// Sees that the thing is still held.
async fn check(hand: Hand, errand: Errand) -> Result<(), Failure> {
    is_it(&hand.ask(ReadHeld {}).await?, &errand)
}

/// Whether what is held is the thing of the errand.
fn is_it(held: &Held, errand: &Errand) -> Result<(), Failure> {
    let thing = &errand.thing;
    if !held.holds {
        let text = format!("no {} is in the grasp", thing.name);
        return Err(Failure::new(Outcome::Absent, text));
    }
    if (held.width_m - thing.width_m).abs() > thing.tolerance_m {
        let text = format!(
            "what is in the grasp is {:.1} mm wide, and a {} is {:.1} mm",
            held.width_m * 1e3,
            thing.name,
            thing.width_m * 1e3
        );
        return Err(Failure::new(Outcome::Absent, text));
    }
    Ok(())
}
