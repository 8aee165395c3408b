//! The tasks of the runtime itself.

use std::sync::Arc;

use super::{Bootstrap, Seat};
use crate::agent::Agent;
use ctos_core::{
    chassis::Chassis,
    context::Context,
    handler::EventHandler,
    names::{self, TidServer},
    registry::Recipe,
    runner::{TaskSpec, dynamic::plain, start_task},
    semaphore::{self, server::SemaphoreServer},
    system,
};
use ctos_message::{CommandInfo, Tid};

/// Starts the tasks of the runtime itself on processor 0 of `chassis`. Their queues exist when this
/// returns, so no message to them is lost however soon it comes. `seat` is for the chassis that boots.
pub fn start_system_tasks(chassis: &Arc<Chassis>, seat: Option<&Seat>) {
    let agent = system::agent_tid(chassis.index());
    start(chassis, "agent", agent, &Agent::COMMANDS, |_| {
        Agent::default()
    });
    if let Some(seat) = seat {
        let tidsvr = system::TID_SERVER;
        start(chassis, "tidsvr", tidsvr, &names::COMMANDS, |_| {
            TidServer::default()
        });
        let (seat, service) = (seat.clone(), system::BOOTSTRAP);
        let semsvr = system::SEMAPHORE_SERVER;
        start(
            chassis,
            "semsvr",
            semsvr,
            &semaphore::server::COMMANDS,
            |_| SemaphoreServer,
        );
        start(
            chassis,
            "bootstrap",
            service,
            &Bootstrap::COMMANDS,
            move |cx| Bootstrap::new(cx, seat.clone()),
        );
    }
}

fn start<H: EventHandler>(
    chassis: &Arc<Chassis>,
    name: &'static str,
    tid: Tid,
    commands: &[CommandInfo],
    build: impl Fn(&Context) -> H + Send + Sync + 'static,
) {
    let Some((_, processor)) = chassis.processors.first() else {
        return;
    };
    let recipe = Recipe {
        commands: commands.into(),
        build: Arc::new(move |cx| Ok(plain(build(cx)))),
    };
    let spec = TaskSpec::new(name, tid, None, Arc::new(recipe), processor);
    let record = spec.record.clone();
    let home = chassis.clone();
    processor.inject(move |processor| {
        if let Err(error) = start_task(&home, processor, spec) {
            tracing::error!(task = name, error = %error, "a task of the runtime did not start");
        }
    });
    // After the order to start it, so that no message comes before that.
    chassis.add_task(record);
}
