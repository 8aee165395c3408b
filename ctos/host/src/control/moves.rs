//! A move that a client has asked for: checked, ordered, and told about until it is over.

use std::{future::Future, pin::Pin, sync::Arc, time::Duration};

use crate::control::{
    LogStore,
    protocol::{Answer, ErrorCode, ErrorView, MoveView},
    view,
};
use ctos_core::{
    chassis::Chassis,
    moving::{NoPlace, find_place, place_text},
    system::{self, MoveTask, Place, QueryTid},
};
use ctos_message::fault::Fault;
use ctos_time::Instant;

/// How often a client is told what a move waits for.
const TELL: Duration = Duration::from_secs(1);
/// What a move may take besides the startup phases at the new place.
const PATIENCE: Duration = Duration::from_secs(60);
/// How long the task identification service may take to say where a task is.
const ASK: Duration = Duration::from_secs(2);

type UnderWay = Pin<Box<dyn Future<Output = Result<String, Fault>> + Send>>;

/// A move, as a client sees it.
pub(super) struct Moving<'d> {
    chassis: &'d Arc<Chassis>,
    logs: &'d LogStore,
    task: String,
    to: String,
    from: String,
    began: Instant,
    stage: Stage,
}

enum Stage {
    Asked,
    UnderWay(UnderWay),
    Over,
}

impl<'d> Moving<'d> {
    pub(super) fn new(
        chassis: &'d Arc<Chassis>,
        logs: &'d LogStore,
        task: String,
        to: String,
    ) -> Self {
        Self {
            chassis,
            logs,
            task,
            to,
            from: String::new(),
            began: chassis.clock.now(),
            stage: Stage::Asked,
        }
    }

    /// What the client is told next; `None` when that was all. A client that goes before the end does not
    /// end the move.
    pub(super) async fn next(&mut self) -> Option<Answer> {
        match std::mem::replace(&mut self.stage, Stage::Over) {
            Stage::Asked => Some(match self.begin().await {
                Ok(under_way) => {
                    self.stage = Stage::UnderWay(under_way);
                    Answer::Moving(self.view(None))
                }
                Err(wrong) => Answer::Error(wrong),
            }),
            Stage::UnderWay(mut under_way) => {
                match tokio::time::timeout(TELL, &mut under_way).await {
                    Ok(Ok(place)) => {
                        self.to = place;
                        Some(Answer::Moved(self.view(None)))
                    }
                    Ok(Err(fault)) => Some(Answer::Error(self.failure(&fault))),
                    Err(_) => {
                        self.stage = Stage::UnderWay(under_way);
                        let at = self.at().await;
                        Some(Answer::Moving(self.view(at)))
                    }
                }
            }
            Stage::Over => None,
        }
    }

    /// Finds both ends of the way, and gives the order.
    async fn begin(&mut self) -> Result<UnderWay, ErrorView> {
        let place = find_place(self.chassis, &self.to).map_err(no_such_place)?;
        let query = QueryTid {
            name: self.task.clone(),
        };
        let found = view::ask(self.chassis, system::TID_SERVER, query, ASK).await;
        let old = match found {
            Ok(Ok(old)) => old,
            Ok(Err(_)) if self.chassis.app.task(&self.task).is_some() => {
                let message = format!("`{}` does not run at the moment", self.task);
                return Err(error(ErrorCode::Failed, message));
            }
            Ok(Err(known)) => {
                return Err(ErrorView {
                    code: ErrorCode::NoSuchName,
                    message: format!("no task is called `{}`", self.task),
                    known,
                });
            }
            Err(fault) => return Err(self.failure(&fault)),
        };
        self.to = place_text(self.chassis, place);
        self.from = place_text(
            self.chassis,
            Place {
                chassis: old.chassis(),
                processor: old.processor(),
            },
        );
        let (chassis, timeout) = (self.chassis.clone(), self.timeout());
        let order = MoveTask {
            task: self.task.clone(),
            to: self.to.clone(),
        };
        Ok(Box::pin(async move {
            view::ask(&chassis, system::TID_SERVER, order, timeout).await
        }))
    }

    fn timeout(&self) -> Duration {
        PATIENCE + self.chassis.app.phase_timeout.saturating_mul(4)
    }

    fn view(&self, at: Option<String>) -> MoveView {
        MoveView {
            task: self.task.clone(),
            from: self.from.clone(),
            to: self.to.clone(),
            took_s: self.chassis.clock.now().since(self.began).as_secs_f64(),
            at,
        }
    }

    /// What the task's handler is at: a task moves between two messages.
    async fn at(&mut self) -> Option<String> {
        let app = view::app(self.chassis, self.logs).await.ok()?;
        let tasks = app.tasks.iter().filter(|task| task.name == self.task);
        let mut busy = tasks.filter_map(|task| Some((task.in_handler_s?, task.command.clone()?)));
        let (time_s, command) = busy.next()?;
        Some(format!(
            "its handler has been at `{command}` for {time_s:.1} s"
        ))
    }

    fn failure(&self, fault: &Fault) -> ErrorView {
        let (code, message) = match fault {
            Fault::Refused { text } => (ErrorCode::Failed, text.clone()),
            Fault::Deadline { after } => (
                ErrorCode::TimedOut,
                format!(
                    "`{}` has not moved within {:.1} s; `ctos status {}` shows what it is at",
                    self.task,
                    after.as_secs_f64(),
                    self.task
                ),
            ),
            // Who carries it out ends without a word only when the app does.
            Fault::Stopping | Fault::NoReply => {
                (ErrorCode::Failed, "the app is being stopped".to_owned())
            }
            other => (ErrorCode::Failed, format!("{other:?}")),
        };
        error(code, message)
    }
}

fn error(code: ErrorCode, message: String) -> ErrorView {
    ErrorView {
        code,
        message,
        known: Vec::new(),
    }
}

fn no_such_place(wrong: NoPlace) -> ErrorView {
    ErrorView {
        code: ErrorCode::NoSuchName,
        message: wrong.message,
        known: wrong.known,
    }
}
