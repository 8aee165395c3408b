//! The half of the law `split_torque` that knows the model, as a task on a processor of its own.

use ctos::message::Message;
use ctos::registry::Registry;
use ctos::sync::{CyclicHandle, Synchronous, Tick};
use ctos::task::{Context, EventHandler, Handled, Phase};

use super::args::PartArgs;
use super::{Link, SERVO, check_reference};
use crate::control::split_torque::{Exchange, Half};

/// Registered name of the event handler.
pub const SPLIT_TORQUE: &str = "mcs.split_torque";

pub(super) fn register(registry: &mut Registry) {
    registry
        .handler(SPLIT_TORQUE, &[], |cx| {
            let PartArgs { servo } = cx.args()?;
            Ok(HalfTask { servo, half: None })
        })
        .checked_args::<PartArgs>(|args, task, app, findings| {
            check_reference(task, app, findings, ("servo", &args.servo), SERVO, true);
        });
}

struct HalfTask {
    servo: String,
    half: Option<CyclicHandle>,
}

impl EventHandler for HalfTask {
    async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
        cx.default_processing(message)
    }

    async fn phase(&mut self, cx: &Context, phase: Phase) -> Handled {
        if phase == Phase::Connect {
            let link = Link::find(cx, &self.servo)?;
            let model = link.planner.model();
            let exchange = Exchange::of(cx, &self.servo, model.dof());
            let mut half = Half::new(model.clone(), exchange);
            // Twice in a servo period: whatever the law asks in a tick is answered before the next one, though nobody waits.
            let half = Synchronous::new("half", move |_: &Tick| half.tick());
            self.half = Some(cx.schedule(half.period(link.config.period / 2))?);
        }
        Ok(())
    }
}
