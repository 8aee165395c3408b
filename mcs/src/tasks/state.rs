//! The state manager as a task: applies the rules of [`crate::state`] and makes the servo follow.
//!
//! A new state is only taken once the servo shows the power state that it means.

use std::sync::Arc;

use ctos::message::{Command, Message};
use ctos::registry::Registry;
use ctos::task::{Context, EventHandler, Handled, HandlerError, Phase};
use serde::{Deserialize, Serialize};

use super::args::PartArgs;
use super::{Link, SERVO, STATE, check_reference};
use crate::driver::Power;
use crate::servo::{ServoCommand, ServoStatus};
use crate::state::{Event, State, StateManager};

/// State and holder.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct StateReport {
    /// The state.
    pub state: State,
    /// Task that holds the manipulator.
    pub holder: Option<String>,
}

ctos::command! {
    /// Reserves the manipulator for a task and switches its power on.
    #[derive(Debug, Clone, PartialEq)]
    pub struct Reserve {
        /// The task's name.
        pub by: String,
    } => State, 0x0341, "reserve"
}
ctos::command! {
    /// Releases the brakes for the task that holds the manipulator, if they are on.
    #[derive(Debug, Clone, PartialEq)]
    pub struct EnableMotion {
        /// The task's name.
        pub by: String,
    } => State, 0x0342, "enable_motion"
}
ctos::command! {
    /// Comes to rest, switches power off and frees the manipulator.
    #[derive(Debug, Clone, PartialEq)]
    pub struct Unreserve {
        /// The task's name.
        pub by: String,
    } => State, 0x0343, "unreserve"
}
ctos::command! {
    /// Leaves the estopped state.
    #[derive(Debug, Clone, PartialEq)]
    pub struct ResetEstop {
        /// The task's name.
        pub by: String,
    } => State, 0x0344, "reset_estop"
}
ctos::command! {
    /// Tells state and holder.
    #[derive(Debug, Clone, PartialEq)]
    pub struct ReadState => StateReport, 0x0345, "read_state"
}

pub(super) fn register(registry: &mut Registry) {
    let commands = [
        Reserve::INFO,
        EnableMotion::INFO,
        Unreserve::INFO,
        ResetEstop::INFO,
        ReadState::INFO,
    ];
    registry
        .handler(STATE, &commands, |cx| {
            let args: PartArgs = cx.args()?;
            Ok(StateTask {
                servo: args.servo,
                link: None,
                manager: StateManager::new(),
            })
        })
        .check_in_app(|task, app, findings| {
            if let Some(args) = findings.keep(task.args.parse::<PartArgs>()) {
                check_reference(task, app, findings, ("servo", &args.servo), SERVO, true);
            }
        });
}

struct StateTask {
    servo: String,
    link: Option<Arc<Link>>,
    manager: StateManager,
}

impl StateTask {
    fn link(&self) -> Result<Arc<Link>, HandlerError> {
        self.link
            .clone()
            .ok_or_else(|| "the servo is not connected yet".into())
    }

    /// Takes note of what the servo did on its own: a fault, or power switched off in a stop.
    fn sync(&mut self, link: &Link) -> Result<(), HandlerError> {
        let status = link.port.status();
        if status.fault.is_some() && self.manager.state() != State::Estopped {
            self.manager.apply(Event::EmergencyStop, &self.servo)?;
        }
        let holder = self.manager.holder().unwrap_or_default().to_owned();
        if self.manager.state() == State::Motion && status.power != Power::Released {
            self.manager.apply(Event::EngageBrakes, &holder)?;
        }
        if self.manager.state() == State::Active && status.power == Power::Off {
            self.manager.apply(Event::PowerOff, &holder)?;
        }
        Ok(())
    }

    /// Applies `events` in turn, orders `command` if all are legal, and takes the new state once the
    /// servo shows its power state.
    async fn change(
        &mut self,
        cx: &Context,
        events: &[Event],
        by: &str,
        command: ServoCommand,
    ) -> Result<State, HandlerError> {
        let link = self.link()?;
        self.sync(&link)?;
        let mut changed = self.manager.clone();
        for event in events {
            changed.apply(*event, by)?;
        }
        link.port.order(command)?;
        let power = changed.state().power();
        let reached = move |status: &ServoStatus| status.power == power || status.fault.is_some();
        let what = format!("reach the {} state", changed.state());
        let patience = link.rest_patience();
        let status = link.wait(cx, &what, patience, reached).await?;
        if status.power != power {
            self.sync(&link)?;
            let fault = link.fault().unwrap_or_default();
            return Err(format!("the servo did not {what}: {fault}").into());
        }
        self.manager = changed;
        Ok(self.manager.state())
    }

    async fn reserve(&mut self, cx: &Context, by: &str) -> Result<State, HandlerError> {
        let events = [Event::Reserve, Event::PowerOn];
        self.change(cx, &events, by, ServoCommand::PowerOn).await
    }

    async fn enable(&mut self, cx: &Context, by: &str) -> Result<State, HandlerError> {
        let link = self.link()?;
        self.sync(&link)?;
        if self.manager.state() == State::Motion && self.manager.holder() == Some(by) {
            return Ok(State::Motion);
        }
        let events = [Event::ReleaseBrakes];
        self.change(cx, &events, by, ServoCommand::ReleaseBrakes)
            .await
    }

    async fn unreserve(&mut self, cx: &Context, by: &str) -> Result<State, HandlerError> {
        let link = self.link()?;
        self.sync(&link)?;
        let events: &[Event] = match self.manager.state() {
            State::Motion => &[Event::EngageBrakes, Event::PowerOff, Event::Unreserve],
            State::Active => &[Event::PowerOff, Event::Unreserve],
            _ => &[Event::Unreserve],
        };
        self.change(cx, events, by, ServoCommand::PowerOff).await
    }

    async fn reset(&mut self, cx: &Context, by: &str) -> Result<State, HandlerError> {
        let link = self.link()?;
        self.sync(&link)?;
        let mut changed = self.manager.clone();
        changed.apply(Event::Reset, by)?;
        link.port.order(ServoCommand::Reset)?;
        let cleared = |status: &ServoStatus| status.fault.is_none();
        let patience = link.rest_patience();
        link.wait(cx, "clear its fault", patience, cleared).await?;
        self.manager = changed;
        Ok(self.manager.state())
    }
}

impl EventHandler for StateTask {
    async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
        match message.command() {
            Reserve::CODE => {
                let (Reserve { by }, reply) = message.open::<Reserve>()?;
                reply.ok(self.reserve(cx, &by).await?)
            }
            EnableMotion::CODE => {
                let (EnableMotion { by }, reply) = message.open::<EnableMotion>()?;
                reply.ok(self.enable(cx, &by).await?)
            }
            Unreserve::CODE => {
                let (Unreserve { by }, reply) = message.open::<Unreserve>()?;
                reply.ok(self.unreserve(cx, &by).await?)
            }
            ResetEstop::CODE => {
                let (ResetEstop { by }, reply) = message.open::<ResetEstop>()?;
                reply.ok(self.reset(cx, &by).await?)
            }
            ReadState::CODE => {
                let (ReadState {}, reply) = message.open::<ReadState>()?;
                let link = self.link()?;
                self.sync(&link)?;
                reply.ok(StateReport {
                    state: self.manager.state(),
                    holder: self.manager.holder().map(str::to_owned),
                })
            }
            _ => cx.default_processing(message),
        }
    }

    async fn phase(&mut self, cx: &Context, phase: Phase) -> Handled {
        if phase == Phase::Connect {
            self.link = Some(Link::find(cx, &self.servo)?);
        }
        Ok(())
    }
}
