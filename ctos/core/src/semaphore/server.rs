//! The task that keeps the semaphores and barriers of an app, for all its chassis.

use std::time::Duration;

use super::{
    Scope, SemaphoreView,
    ledger::{Claim, Hold, Kind},
    store::Answer,
};
use crate::{context::Context, envelope::Replier, handled::Handled};
use ctos_message::{CommandInfo, Tid, command};

/// What the service takes.
pub const COMMANDS: [CommandInfo; 4] = SemaphoreServer::COMMANDS;

command! {
    /// Waits for a permit of a semaphore, or arrives at a barrier and waits for the others.
    #[derive(Debug)]
    pub struct AwaitTurn {
        pub kind: Kind,
        pub name: String,
        pub count: u32,
        pub hold: u64,
        pub task: String,
        pub wait: Duration,
        pub high: bool,
    } => Answer, 0xff71, "await_turn";

    /// Gives a permit back, or waits no longer.
    pub struct ReleaseTicket { pub hold: u64 } => (), 0xff72, "release_ticket";

    /// Asks whether the asking chassis has a permit still.
    pub struct HasPermit { pub hold: u64 } => bool, 0xff74, "has_permit";

    /// Asks for the semaphores of the app, who holds them and who waits.
    pub struct ListSemaphores => Vec<SemaphoreView>, 0xff73, "list_semaphores"
}

/// The service. What it keeps lies in the store of its chassis, where displays can see it.
pub struct SemaphoreServer;

#[ctos_derive::handler]
impl SemaphoreServer {
    #[command]
    fn await_turn(&self, cx: &Context, request: AwaitTurn, reply: Replier<AwaitTurn>) -> Handled {
        let store = cx.chassis().blocking();
        let kept = store.find(request.kind, Scope::App, &request.name, request.count);
        let has = kept.count();
        if has != request.count {
            return reply.ok(Answer::Disagree { has });
        }
        let (tid, task) = (reply.asker(), request.task.into());
        let hold = hold(tid, request.hold);
        // Here, not in the child: those who wait stand in the order of their messages.
        let served = kept.enter(Claim { hold, task, tid }, request.high);
        let here = cx.clone();
        cx.spawn(async move {
            let answer = kept.wait(&here, hold, served, request.wait).await;
            if let Some(Answer::Late(_)) = answer {
                kept.end(|claim| claim.hold == hold);
            }
            if let Some(answer) = answer {
                // An answer cannot fail.
                let _ = reply.ok(answer);
            }
        });
        Ok(())
    }

    #[command]
    fn release_ticket(
        &self,
        cx: &Context,
        request: ReleaseTicket,
        reply: Replier<ReleaseTicket>,
    ) -> Handled {
        let hold = hold(reply.asker(), request.hold);
        let store = cx.chassis().blocking();
        store.end(|claim| claim.hold == hold);
        reply.ok(())
    }

    #[command]
    fn has_permit(&self, cx: &Context, request: HasPermit, reply: Replier<HasPermit>) -> Handled {
        let hold = hold(reply.asker(), request.hold);
        reply.ok(cx.chassis().blocking().has(hold))
    }

    #[command]
    fn list_semaphores(&self, cx: &Context, _: ListSemaphores) -> Vec<SemaphoreView> {
        let mut views = cx.chassis().semaphores();
        views.retain(|view| view.scope == Scope::App);
        views
    }

    #[chassis_down]
    fn lost(&mut self, cx: &Context, chassis: &str) -> Handled {
        let home = cx.chassis();
        let gone = |claim: &Claim| home.name_of(claim.hold.chassis) == chassis;
        home.blocking().end(gone);
        Ok(())
    }
}

/// The chassis of a task is known from the link, so nobody can name the holds of others.
fn hold(task: Tid, number: u64) -> Hold {
    let chassis = task.chassis();
    Hold { chassis, number }
}
