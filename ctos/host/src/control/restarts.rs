//! A restart that a client has asked for: ordered, and told about until it is over.

use std::time::Duration;

use super::{
    protocol::{Activity, Answer, ErrorCode, ErrorView},
    service::{Answered, Service, Writer, tell},
    view,
};
use ctos_core::system::{self, RestartChassis, RestartTask};
use ctos_message::fault::Fault;

/// How often a client is told what a restart waits for.
const TELL: Duration = Duration::from_secs(1);

impl Service {
    /// Restarts a task or a chassis and tells the client about it. A client that goes before the end does not end the
    /// restart.
    pub(super) async fn restart(&self, name: &str, writer: &mut Writer) -> Answered {
        let began = self.chassis.clock.now();
        let mut restarted = std::pin::pin!(self.restarted(name));
        loop {
            if let Ok(over) = tokio::time::timeout(TELL, &mut restarted).await {
                over?;
                return Ok(Answer::Done {});
            }
            let took_s = self.chassis.clock.now().since(began).as_secs_f64();
            let at = self.kept(name, took_s).await?;
            tell(writer, &Answer::Waiting { took_s, at }).await?;
        }
    }

    async fn restarted(&self, name: &str) -> Result<(), ErrorView> {
        let app = &self.chassis.app;
        // Every phase and every rung of the ladder may take its time.
        let timeout = app.phase_timeout.saturating_mul(4) + app.stop_timeout.saturating_mul(4);
        let chassis = (1..).zip(&app.chassis).find(|(_, one)| one.name == name);
        let restarted = if let Some((chassis, _)) = chassis {
            let order = RestartChassis { chassis };
            view::ask(&self.chassis, system::BOOTSTRAP, order, timeout).await
        } else {
            self.app().await?;
            let task = self.find(name, timeout).await?;
            view::ask(&self.chassis, task, RestartTask {}, timeout).await
        };
        restarted.map_err(|fault| match fault {
            Fault::NoReply => {
                let text = format!("the app ended while `{name}` was being restarted");
                ErrorView::new(ErrorCode::Failed, text)
            }
            fault => fault.into(),
        })
    }

    /// What a restart waits for since `took_s`; an error when that is a handler that does not come to an end.
    async fn kept(&self, name: &str, took_s: f64) -> Result<String, ErrorView> {
        let app = self.app().await?;
        let Some(task) = app.tasks.iter().find(|one| one.name == name) else {
            let chassis = app.chassis.iter().find(|one| one.name == name);
            return Ok(chassis.map_or_else(String::new, |one| format!("it is `{}`", one.state)));
        };
        let at = match (task.in_handler_s, &task.command) {
            (Some(time_s), Some(command)) => {
                format!("its handler has been at `{command}` for {time_s:.1} s")
            }
            _ if task.activity == Activity::Gone => "its chassis does not answer".to_owned(),
            _ => return Ok("it is built anew and brought to its phase".to_owned()),
        };
        let is_same = task.in_handler_s.is_none_or(|time_s| time_s >= took_s);
        if !is_same || took_s < self.chassis.app.stop_timeout.as_secs_f64() {
            return Ok(at);
        }
        let text = format!(
            "`{name}` is not restarted: {at}, and a handler is built anew only between two messages; \
             `ctos restart {chassis}` restarts its chassis `{chassis}`, whatever its tasks are at",
            chassis = task.chassis
        );
        Err(ErrorView::new(ErrorCode::TimedOut, text))
    }
}
