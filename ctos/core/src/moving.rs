//! Moving a running task to another processor, process or host: nothing sent to it is lost, doubled or
//! reordered.
//!
//! 1. Between two messages the old place asks the handler for its state and ends it. Messages that come
//!    from now on wait and are not accepted.
//! 2. The new place builds the handler, which takes the state over and passes the startup phases, but
//!    takes no messages yet. It is sent copies of the messages that the old place had accepted.
//! 3. The task identification service gives the name to the new place. This is the moment. Before it,
//!    any failure leaves the task where it was, with its state and its queue. After it, the old place
//!    only sends on what still comes to it, and replies take the way back.
//! 4. Every chassis redirects itself to the new place and sends a fence by the old one. The new place
//!    keeps what comes straight from a chassis until the fence of that chassis has arrived. So the two
//!    ways of one sender never mix. When all fences are through, the old place is given up.
//!
//! It knows how a task leaves (`depart`, `forward`) and how it comes (`arrive`, [`deliver`]). The
//! task identification service decides (`names/moves.rs`). The agents of both chassis carry the move out.

mod arrive;
mod depart;
mod place;

use std::{future::Future, pin::Pin, sync::Arc, time::Duration};

use tokio::sync::oneshot;

use crate::{
    chassis::Chassis,
    context::{Context, TaskRef},
    handled::Handled,
    system::{self, Delivered, Fence, Load, MoveTask, Rebound, Transfer},
};
use ctos_message::{ChassisNumber, Tid, fault::CallError};

pub use arrive::{Arrival, Arrivals, arrive, deliver};
pub(crate) use depart::{Departed, depart, forward};
pub use place::{NoPlace, find_place, place_text};

/// How often both places look whether the sender of a message that is on its way still waits.
const LOOK: Duration = Duration::from_millis(10);

/// The deadline of what must end by itself: the last resort against a chassis that stands still.
const PATIENCE: Duration = Duration::from_secs(60);

/// After this time nobody is still in the middle of sending a message to where the task was.
const QUIET: Duration = Duration::from_secs(1);

/// A load on its way to the new place.
type UnderWay = Pin<Box<dyn Future<Output = Result<Delivered, CallError>>>>;

impl Context {
    /// Moves a running task to `CHASSIS` or `CHASSIS:PROCESSOR` while others send to it; answers with
    /// its place. Its handler must have been registered with
    /// [`Registry::handover`](crate::registry::Registry::handover).
    ///
    /// # Errors
    /// Why the task stays where it is; it goes on there.
    pub async fn move_task(&self, task: &str, to: &str) -> Result<String, CallError> {
        let request = MoveTask {
            task: task.to_owned(),
            to: to.to_owned(),
        };
        let deadline = PATIENCE + self.app().phase_timeout.saturating_mul(4);
        self.call(&Self::server(), request).deadline(deadline).await
    }
}

fn agent_of(chassis: ChassisNumber) -> TaskRef {
    TaskRef::new("agent", system::agent_tid(chassis))
}

/// Redirects this chassis to the new place of a task. Its messages go straight there from now on, and a
/// fence follows those that went by the old place.
pub async fn redirect(cx: &Context, rebound: &Rebound, new: Tid) -> Handled {
    let chassis = cx.chassis();
    chassis
        .directory
        .rebind(&rebound.name, rebound.old, Some(new));
    quiet(cx, chassis).await;
    let old = TaskRef::new(rebound.name.as_str(), rebound.old);
    let fence = Fence {
        chassis: chassis.index(),
    };
    Ok(cx.call(&old, fence).deadline(PATIENCE).await?)
}

/// Fences off a chassis that cannot reach the old place of a task any more, or whose fence cannot reach
/// the new one. The chassis that boots does it, because it reaches all that are left.
pub(crate) async fn redirect_for(
    cx: &Context,
    rebound: &Rebound,
    new: Tid,
    chassis: ChassisNumber,
) -> bool {
    let old = TaskRef::new(rebound.name.as_str(), rebound.old);
    let agent = agent_of(new.chassis());
    let began = cx.now();
    while cx.now().since(began) < PATIENCE {
        // Good when the old place has lost its link to the chassis: nothing more can come from there.
        if cx.call(&old, Fence { chassis }).await.is_ok() {
            return true;
        }
        // Good when the new place has lost its link to the old one: nothing more can come by it.
        let gate = Transfer {
            to: new,
            what: Load::Without {
                chassis,
                old: rebound.old.chassis(),
            },
        };
        match cx.call(&agent, gate).await {
            Ok(Ok(_)) => return true,
            Err(error) if error.is_gone() => return true,
            _ => cx.sleep(LOOK).await,
        }
    }
    false
}

/// Ends when every processor of the chassis has come out of whatever it was sending when this began.
async fn quiet(cx: &Context, chassis: &Arc<Chassis>) {
    let mut passed = Vec::new();
    for (_, processor) in &chassis.processors {
        let (through, passing) = oneshot::channel::<()>();
        processor.inject(move |_| drop(through));
        passed.push(passing);
    }
    // A processor whose handler never returns is not in the middle of sending after that time.
    let all = futures_util::future::join_all(passed);
    if cx.timeout(QUIET, all).await.is_err() {
        tracing::warn!("a processor is busy while a task moves");
    }
}
