//! A move that a client has asked for: checked, ordered, and told about until it is over.

use std::time::Duration;

use super::{
    protocol::{Answer, ErrorCode, ErrorView, MoveView},
    service::{Answered, Service, Writer, tell},
    view,
};
use ctos_core::{
    moving::{find_place, place_text},
    system::{self, MoveTask, Place},
};
use ctos_message::fault::Fault;

/// How often a client is told what a move waits for.
const TELL: Duration = Duration::from_secs(1);
/// What a move may take besides the startup phases at the new place.
const PATIENCE: Duration = Duration::from_secs(60);
/// How long the task identification service may take to say where a task is.
const FIND_TIMEOUT: Duration = Duration::from_secs(2);

impl Service {
    /// Moves a task and tells the client about it. A client that goes before the end does not end the move.
    pub(super) async fn move_task(&self, task: String, to: &str, writer: &mut Writer) -> Answered {
        let began = self.chassis.clock.now();
        let took_s = || self.chassis.clock.now().since(began).as_secs_f64();
        let mut moving = self.begin_move(task, to).await?;
        let timeout = PATIENCE + self.chassis.app.phase_timeout.saturating_mul(4);
        let order = MoveTask {
            task: moving.task.clone(),
            to: moving.to.clone(),
        };
        let moved = view::ask(&self.chassis, system::TID_SERVER, order, timeout);
        let mut moved = std::pin::pin!(moved);
        loop {
            moving.took_s = took_s();
            tell(writer, &Answer::Moving(moving.clone())).await?;
            match tokio::time::timeout(TELL, &mut moved).await {
                Ok(Ok(place)) => {
                    return Ok(Answer::Moved(MoveView {
                        to: place,
                        took_s: took_s(),
                        at: None,
                        ..moving
                    }));
                }
                Ok(Err(fault)) => return Err(failure(&moving.task, fault).into()),
                Err(_) => moving.at = self.activity(&moving.task).await,
            }
        }
    }

    /// Finds both ends of the way.
    async fn begin_move(&self, task: String, to: &str) -> Result<MoveView, ErrorView> {
        let to = find_place(&self.chassis, to).map_err(|wrong| ErrorView {
            code: ErrorCode::NoSuchName,
            message: wrong.message,
            known: wrong.known,
        })?;
        let old = self.find(&task, FIND_TIMEOUT).await.map_err(|mut wrong| {
            let chassis = &self.chassis.app.chassis;
            wrong
                .known
                .retain(|name| chassis.iter().all(|one| one.name != *name));
            wrong
        })?;
        let from = Place {
            chassis: old.chassis(),
            processor: old.processor(),
        };
        Ok(MoveView {
            task,
            from: place_text(&self.chassis, from),
            to: place_text(&self.chassis, to),
            took_s: 0.0,
            at: None,
        })
    }

    /// What a task's handler is at: a task moves between two messages.
    async fn activity(&self, task: &str) -> Option<String> {
        let app = self.app().await.ok()?;
        let task = app.tasks.into_iter().find(|one| one.name == task)?;
        let (command, time_s) = (task.command?, task.in_handler_s?);
        Some(format!(
            "its handler has been at `{command}` for {time_s:.1} s"
        ))
    }
}

fn failure(task: &str, fault: Fault) -> ErrorView {
    match fault {
        Fault::Deadline { after } => ErrorView::new(
            ErrorCode::TimedOut,
            format!(
                "`{task}` has not moved within {:.1} s; `ctos status {task}` shows what it is at",
                after.as_secs_f64()
            ),
        ),
        // Who carries it out ends without a word only when the app does.
        Fault::Stopping | Fault::NoReply => {
            ErrorView::new(ErrorCode::Failed, "the app is being stopped")
        }
        other => other.into(),
    }
}
