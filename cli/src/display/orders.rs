//! What a page asks of the app: how a task is, and orders for nets.

use std::{sync::Arc, time::Duration};

use ctos::{
    system::Statistics,
    task::{Context, HandlerError, TaskRef},
};
use tokio::sync::mpsc;

use super::{
    hub::Hub,
    server::Asking,
    wire::{Asked, Breakpoint, TaskState, Told},
};

/// How long whoever is asked may take.
const LIMIT: Duration = Duration::from_secs(2);

/// Carries orders out, each beside the others, until the server ends.
pub(super) async fn carry(cx: &Context, hub: &Arc<Hub>, mut orders: mpsc::Receiver<Asking>) {
    while let Some((asked, answer)) = orders.recv().await {
        let (child, hub) = (cx.new_trace(), hub.clone());
        cx.spawn(async move {
            let told = if asked.kind == "task" {
                Told::Task {
                    task: task(&child, &asked.task).await,
                }
            } else {
                let done = order(&child, &hub, &asked).await;
                let (ok, text) = done.map_or_else(|e| (false, e.to_string()), |text| (true, text));
                Told::Answer {
                    id: asked.id,
                    ok,
                    text,
                }
            };
            // A browser that went away needs no answer.
            let _ = answer.send(told.text());
        });
    }
}

/// How a task is.
async fn task(cx: &Context, name: &str) -> TaskState {
    let on = cx.app().task(name).map(|task| task.chassis.clone());
    let mut state = TaskState {
        name: name.to_owned(),
        on: on.unwrap_or_default(),
        ..TaskState::default()
    };
    let counters = async {
        let to = cx.task(name).await?;
        let counters = cx.call(&to, Statistics {}).deadline(LIMIT).await?;
        Ok::<_, HandlerError>(counters)
    };
    match counters.await {
        Ok(counters) => {
            state.handled = counters.handled;
            state.failed = counters.failed;
            state.busy = counters.began.is_some();
            let kind = cx
                .app()
                .task(name)
                .and_then(|task| cx.registry().kind(&task.handler));
            let mut commands = kind.into_iter().flat_map(|kind| kind.commands());
            let command = commands.find(|command| command.code == counters.command);
            state.command = command.map(|command| command.name.to_owned());
        }
        Err(error) => state.error = Some(error.to_string()),
    }
    state
}

/// Has an order carried out by its net.
async fn order(_cx: &Context, _hub: &Hub, asked: &Asked) -> Result<String, HandlerError> {
    Err(HandlerError::new(format!(
        "net `{}` takes no orders",
        asked.net
    )))
}

/// The breakpoints of a net.
pub(super) async fn breakpoints(
    _cx: &Context,
    _net: &TaskRef,
) -> Result<Vec<Breakpoint>, HandlerError> {
    Ok(Vec::new())
}
