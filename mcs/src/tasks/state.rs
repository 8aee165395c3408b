//! The state manager as a task: applies the rules of [`crate::state`] and makes the servo follow.
//!
//! A new state is only taken once the servo shows the power state that it means. When the chassis of
//! the task that holds the manipulator is gone, the arm comes to rest and is free for the next one.

use std::sync::Arc;

use ctos::message::{ChassisNumber, Command, Message};
use ctos::registry::Registry;
use ctos::task::{Context, EventHandler, Handled, Phase};
use scene::{FollowScene, Stage};
use serde::{Deserialize, Serialize};

use super::args::PartArgs;
use super::{Link, SERVO, STATE, check_reference, drawn};
use crate::client::{MotionError, Outcome};
use crate::driver::Power;
use crate::servo::{ServoCommand, ServoStatus};
use crate::state::{Event, State, StateError, StateManager};

/// State and holder.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct StateReport {
    /// The state.
    pub state: State,
    /// Task that holds the manipulator.
    pub holder: Option<String>,
}

ctos::command! {
    /// Reserves the manipulator for a task and switches its power on, unless that is so already.
    #[derive(Debug, Clone, PartialEq)]
    pub struct Reserve {
        /// The task's name.
        pub by: String,
        /// The number of the chassis that it asks from.
        pub chassis: ChassisNumber,
    } => Result<State, MotionError>, 0x0341, "reserve"
}
ctos::command! {
    /// Releases the brakes for the task that holds the manipulator, if they are on.
    #[derive(Debug, Clone, PartialEq)]
    pub struct EnableMotion {
        /// The task's name.
        pub by: String,
        /// The number of the chassis that it asks from.
        pub chassis: ChassisNumber,
    } => Result<State, MotionError>, 0x0342, "enable_motion"
}
ctos::command! {
    /// Comes to rest, switches power off and frees the manipulator, if it is reserved.
    #[derive(Debug, Clone, PartialEq)]
    pub struct Unreserve {
        /// The task's name.
        pub by: String,
    } => Result<State, MotionError>, 0x0343, "unreserve"
}
ctos::command! {
    /// Leaves the estopped state.
    #[derive(Debug, Clone, PartialEq)]
    pub struct ResetEstop {
        /// The task's name.
        pub by: String,
    } => Result<State, MotionError>, 0x0344, "reset_estop"
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
        FollowScene::INFO,
    ];
    registry
        .handler(STATE, &commands, |cx| {
            let args: PartArgs = cx.args()?;
            Ok(StateTask {
                servo: args.servo,
                link: None,
                stage: None,
                manager: StateManager::new(),
                holders_chassis: None,
            })
        })
        .checked_args::<PartArgs>(|args, task, app, findings| {
            check_reference(task, app, findings, ("servo", &args.servo), SERVO, true);
        });
}

struct StateTask {
    servo: String,
    link: Option<Arc<Link>>,
    /// The arm, for viewers.
    stage: Option<Stage>,
    manager: StateManager,
    /// The number of the chassis from which the holder last asked.
    holders_chassis: Option<ChassisNumber>,
}

type Changed = Result<State, MotionError>;

/// What the servo does not do.
fn failed(error: impl ToString) -> MotionError {
    MotionError::new(Outcome::Fault, error)
}

impl StateTask {
    fn link(&self) -> Result<Arc<Link>, MotionError> {
        let link = self.link.clone();
        link.ok_or_else(|| failed("the servo is not connected yet"))
    }

    /// Why the rules say no: after a fault that is the fault.
    fn refused(&self, link: &Link, error: StateError) -> MotionError {
        match self.manager.state() {
            State::Estopped => link.failed(),
            _ => None,
        }
        .unwrap_or_else(|| MotionError::new(Outcome::Refused, error))
    }

    /// Takes note of what the servo did on its own: a fault, or power switched off in a stop.
    fn sync(&mut self, link: &Link) -> Result<(), StateError> {
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
    ) -> Changed {
        let link = self.link()?;
        let mut changed = self.manager.clone();
        for event in events {
            let applied = changed.apply(*event, by);
            applied.map_err(|error| self.refused(&link, error))?;
        }
        link.port.order(command).map_err(failed)?;
        let power = changed.state().power();
        let reached = move |status: &ServoStatus| status.power == power || status.fault.is_some();
        let what = format!("reach the {} state", changed.state());
        let patience = link.rest_patience();
        let waited = link.wait(cx, &what, patience, reached).await;
        let status = waited.map_err(failed)?;
        if status.power != power {
            self.sync(&link).map_err(failed)?;
            let unknown = || failed(format!("the servo did not {what}"));
            return Err(link.failed().unwrap_or_else(unknown));
        }
        self.manager = changed;
        Ok(self.manager.state())
    }

    /// The servo, once the manager's state is in step with it.
    fn in_step(&mut self) -> Result<Arc<Link>, MotionError> {
        let link = self.link()?;
        self.sync(&link).map_err(failed)?;
        Ok(link)
    }

    async fn reserve(&mut self, cx: &Context, by: &str, chassis: ChassisNumber) -> Changed {
        let link = self.in_step()?;
        let own = self.manager.holder() == Some(by);
        let changed = match self.manager.state() {
            state @ (State::Active | State::Motion) if own => Ok(state),
            State::Reserved if own => {
                let events = [Event::PowerOn];
                self.change(cx, &events, by, ServoCommand::PowerOn).await
            }
            state => {
                // Nothing leaves cold while a part of it is missing.
                if let (State::Cold, Some(missing)) = (state, link.missing()) {
                    return Err(missing);
                }
                let events = [Event::Reserve, Event::PowerOn];
                self.change(cx, &events, by, ServoCommand::PowerOn).await
            }
        };
        if changed.is_ok() {
            self.held_from(cx, chassis, by).await?;
        }
        changed
    }

    async fn enable(&mut self, cx: &Context, by: &str, chassis: ChassisNumber) -> Changed {
        self.in_step()?;
        let enabled = if self.manager.state() == State::Motion && self.manager.holder() == Some(by)
        {
            Ok(State::Motion)
        } else {
            let events = [Event::ReleaseBrakes];
            self.change(cx, &events, by, ServoCommand::ReleaseBrakes)
                .await
        };
        if enabled.is_ok() {
            self.held_from(cx, chassis, by).await?;
        }
        enabled
    }

    /// The holder is on this chassis. It asked by the client interface, which may be elsewhere: who is linked is told when it is
    /// gone, and one that is gone already holds nothing.
    async fn held_from(&mut self, cx: &Context, chassis: ChassisNumber, by: &str) -> Changed {
        self.holders_chassis = Some(chassis);
        if chassis == cx.chassis().index() || cx.chassis().reach(chassis) {
            return Ok(self.manager.state());
        }
        self.unreserve(cx, by).await?;
        let text = format!("`{by}` is gone");
        Err(MotionError::new(Outcome::Refused, text))
    }

    async fn unreserve(&mut self, cx: &Context, by: &str) -> Changed {
        self.in_step()?;
        let events: &[Event] = match self.manager.state() {
            state @ (State::Cold | State::Estopped) => return Ok(state),
            State::Motion => &[Event::EngageBrakes, Event::PowerOff, Event::Unreserve],
            State::Active => &[Event::PowerOff, Event::Unreserve],
            State::Reserved => &[Event::Unreserve],
        };
        self.change(cx, events, by, ServoCommand::PowerOff).await
    }

    async fn reset(&mut self, cx: &Context, by: &str) -> Changed {
        let link = self.in_step()?;
        let mut changed = self.manager.clone();
        let applied = changed.apply(Event::Reset, by);
        applied.map_err(|error| MotionError::new(Outcome::Refused, error))?;
        let before = link.port.status().ticks;
        link.port.order(ServoCommand::Reset).map_err(failed)?;
        // The tick that was under way may not have seen it. What is still wrong is a fault again in the tick that has.
        let obeyed = |status: &ServoStatus| status.ticks > before + 1;
        let patience = link.rest_patience();
        let waited = link.wait(cx, "clear its fault", patience, obeyed).await;
        waited.map_err(failed)?;
        if let Some(error) = link.failed() {
            return Err(error);
        }
        self.manager = changed;
        Ok(self.manager.state())
    }
}

impl EventHandler for StateTask {
    async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
        match message.command() {
            Reserve::CODE => {
                let (Reserve { by, chassis }, reply) = message.open::<Reserve>()?;
                reply.ok(self.reserve(cx, &by, chassis).await)
            }
            EnableMotion::CODE => {
                let (EnableMotion { by, chassis }, reply) = message.open::<EnableMotion>()?;
                reply.ok(self.enable(cx, &by, chassis).await)
            }
            Unreserve::CODE => {
                let (Unreserve { by }, reply) = message.open::<Unreserve>()?;
                reply.ok(self.unreserve(cx, &by).await)
            }
            ResetEstop::CODE => {
                let (ResetEstop { by }, reply) = message.open::<ResetEstop>()?;
                reply.ok(self.reset(cx, &by).await)
            }
            ReadState::CODE => {
                let (ReadState {}, reply) = message.open::<ReadState>()?;
                self.in_step()?;
                reply.ok(StateReport {
                    state: self.manager.state(),
                    holder: self.manager.holder().map(str::to_owned),
                })
            }
            FollowScene::CODE => {
                let link = self.link()?;
                let stage = self
                    .stage
                    .get_or_insert_with(|| drawn::stage(cx, &self.servo, &link));
                stage.follow(cx, message)
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

    async fn chassis_down(&mut self, cx: &Context, chassis: &str) -> Handled {
        let holder = self.manager.holder().map(str::to_owned);
        let on = self
            .holders_chassis
            .map(|index| cx.chassis().name_of(index));
        let (Some(holder), Some(on)) = (holder, on) else {
            return Ok(());
        };
        if on != chassis {
            return Ok(());
        }
        tracing::warn!(
            task = cx.name(),
            chassis,
            holder,
            "the arm comes to rest and is given free: the chassis of the task that holds it is gone"
        );
        self.unreserve(cx, &holder).await?;
        Ok(())
    }
}
