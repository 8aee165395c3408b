//! The client interface as a task: the one door for users who do not deal with the lower layers.
//!
//! Checks who asks, has the state manager bring the manipulator into the state needed, and passes
//! motions to the planner. Never blocked by a motion: stopping and asking stay possible meanwhile.

use std::time::Duration;

use ctos::call::CallError;
use ctos::message::{ChassisNumber, Command, Message};
use ctos::registry::Registry;
use ctos::task::{Context, EventHandler, Handled, HandlerError, Phase, TaskRef};

use super::args::ClientArgs;
use super::servo::{ReadServo, ResumeServo, StopKind, StopServo};
use super::state::{EnableMotion, ReadState, Reserve, ResetEstop, Unreserve};
use super::{CLIENT, PLANNER, SERVO, STATE, caller, check_reference};
use crate::client::{
    Acquire, Cancel, ControlledStop, EmergencyStop, MotionError, Move, Outcome, Plan, Position,
    ReadControl, ReadGuards, ReadPosition, ReadSensors, ReadSlots, ReadStream, RecordStates,
    Release, RemoveGuard, Reset, Resume, SetControl, SetGuard, SetLaw, SetOutput, Status,
    StatusReport, Stop, StreamReport, StreamSetpoints, StreamValue,
};

/// The planner answers every move at its end; this only bounds what cannot happen.
const LONGEST_MOVE: Duration = Duration::from_secs(3600);
/// Coming to rest and switching off may take as long as settling.
const REST: Duration = Duration::from_secs(30);

pub(super) fn register(registry: &mut Registry) {
    let commands = [
        Acquire::INFO,
        Move::INFO,
        Plan::INFO,
        ReadPosition::INFO,
        Stop::INFO,
        Release::INFO,
        Status::INFO,
        ControlledStop::INFO,
        EmergencyStop::INFO,
        Reset::INFO,
        ReadControl::INFO,
        RecordStates::INFO,
        SetControl::INFO,
        SetLaw::INFO,
        ReadSensors::INFO,
        ReadSlots::INFO,
        Cancel::INFO,
        Resume::INFO,
        SetGuard::INFO,
        RemoveGuard::INFO,
        ReadGuards::INFO,
        StreamSetpoints::INFO,
        StreamValue::INFO,
        ReadStream::INFO,
        SetOutput::INFO,
    ];
    registry
        .handler(CLIENT, &commands, |cx| {
            Ok(ClientTask {
                args: cx.args()?,
                parts: None,
            })
        })
        .checked_args::<ClientArgs>(|args, task, app, findings| {
            for (key, name, handler) in [
                ("servo", &args.servo, SERVO),
                ("state", &args.state, STATE),
                ("planner", &args.planner, PLANNER),
            ] {
                check_reference(task, app, findings, (key, name), handler, false);
            }
        });
}

#[derive(Clone)]
struct Parts {
    servo: TaskRef,
    state: TaskRef,
    planner: TaskRef,
}

struct ClientTask {
    args: ClientArgs,
    parts: Option<Parts>,
}

/// What a part answered, or what became of asking it.
fn flat<T>(answer: Result<Result<T, MotionError>, CallError>) -> Result<T, MotionError> {
    answer.unwrap_or_else(|error| Err(error.into()))
}

/// A refusal of a part is passed on in its own words; anything else names both tasks.
fn passed_on(error: &CallError) -> HandlerError {
    HandlerError::new(error.reason())
}

impl ClientTask {
    fn parts(&self) -> Result<Parts, HandlerError> {
        self.parts.clone().ok_or_else(|| "not connected yet".into())
    }

    async fn ask<C: Command>(
        cx: &Context,
        part: &TaskRef,
        request: C,
    ) -> Result<C::Reply, CallError> {
        let asked = cx.call(part, request).deadline(REST).high_priority();
        asked.await
    }

    /// As [`Self::ask`], of what is answered in every state.
    async fn told<C: Command>(
        cx: &Context,
        part: &TaskRef,
        request: C,
    ) -> Result<C::Reply, HandlerError> {
        let asked = Self::ask(cx, part, request).await;
        asked.map_err(|error| passed_on(&error))
    }

    /// Brings the manipulator into the motion state for the caller, then lets the planner answer.
    async fn begin(&self, cx: &Context, message: Message) -> Handled {
        let parts = self.parts()?;
        let (by, chassis) = (caller(cx, message.from()).await?, message.from().chassis());
        let (request, reply) = message.open::<Move>()?;
        let enabled = Self::ask(cx, &parts.state, EnableMotion { by, chassis }).await;
        if let Err(error) = flat(enabled) {
            return reply.ok(Err(error));
        }
        let call = cx.call(&parts.planner, request).deadline(LONGEST_MOVE);
        let own = cx.clone();
        cx.spawn(async move {
            let moved = call.await.unwrap_or_else(|error| Err(error.into()));
            if let Err(error) = reply.ok(moved) {
                tracing::warn!(task = own.name(), %error, "a move could not be answered");
            }
        });
        Ok(())
    }

    /// Brings the manipulator into the motion state for the caller, then has the servo follow.
    async fn stream(
        &self,
        cx: &Context,
        (by, chassis): (String, ChassisNumber),
        request: StreamSetpoints,
    ) -> Result<StreamReport, MotionError> {
        let parts = self.parts();
        let parts = parts.map_err(|error| MotionError::new(Outcome::Lost, error))?;
        flat(Self::ask(cx, &parts.state, EnableMotion { by, chassis }).await)?;
        flat(Self::ask(cx, &parts.servo, request).await)
    }

    /// Hands on what only the task that holds the manipulator may ask.
    async fn of_holder<T, C: Command<Reply = Result<T, MotionError>>>(
        &self,
        cx: &Context,
        by: &str,
        request: C,
    ) -> Result<Result<T, MotionError>, HandlerError> {
        let parts = self.parts()?;
        let state = Self::told(cx, &parts.state, ReadState {}).await?;
        if state.holder.as_deref() != Some(by) {
            let holder = match &state.holder {
                Some(holder) => format!("task `{holder}`"),
                None => "nobody".to_owned(),
            };
            let text = format!(
                "`{}` by task `{by}` refused: the manipulator is reserved by {holder}; acquire it first",
                C::NAME
            );
            return Ok(Err(MotionError::new(Outcome::Refused, text)));
        }
        Ok(flat(Self::ask(cx, &parts.servo, request).await))
    }

    async fn status(&self, cx: &Context) -> Result<StatusReport, HandlerError> {
        let parts = self.parts()?;
        let servo = Self::told(cx, &parts.servo, ReadServo {}).await?;
        let state = Self::told(cx, &parts.state, ReadState {}).await?;
        Ok(StatusReport {
            state: state.state,
            holder: state.holder,
            fault: servo.fault,
            stopped: servo.status.stopped,
            motion: servo.status.motion.phase,
            ticks: servo.status.ticks,
            missed: servo.status.missed,
        })
    }

    async fn halt(&self, cx: &Context, kind: StopKind) -> Result<(), HandlerError> {
        let parts = self.parts()?;
        Self::told(cx, &parts.servo, StopServo { kind }).await
    }
}

impl EventHandler for ClientTask {
    async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
        match message.command() {
            Move::CODE => self.begin(cx, message).await,
            Acquire::CODE => {
                let by = caller(cx, message.from()).await?;
                let chassis = message.from().chassis();
                let (Acquire {}, reply) = message.open::<Acquire>()?;
                let reserve = Reserve { by, chassis };
                reply.ok(flat(Self::ask(cx, &self.parts()?.state, reserve).await))
            }
            Release::CODE => {
                let by = caller(cx, message.from()).await?;
                let (Release {}, reply) = message.open::<Release>()?;
                reply.ok(flat(
                    Self::ask(cx, &self.parts()?.state, Unreserve { by }).await,
                ))
            }
            Reset::CODE => {
                let by = caller(cx, message.from()).await?;
                let (Reset {}, reply) = message.open::<Reset>()?;
                reply.ok(flat(
                    Self::ask(cx, &self.parts()?.state, ResetEstop { by }).await,
                ))
            }
            Plan::CODE => {
                let (request, reply) = message.open::<Plan>()?;
                reply.ok(flat(Self::ask(cx, &self.parts()?.planner, request).await))
            }
            ReadPosition::CODE => {
                let (ReadPosition {}, reply) = message.open::<ReadPosition>()?;
                let servo = Self::told(cx, &self.parts()?.servo, ReadServo {}).await?;
                reply.ok(Position {
                    joints: servo.status.position,
                    base_t_tool: servo.base_t_tool,
                    commanded: servo.status.setpoint,
                    base_t_commanded: servo.base_t_commanded,
                    at_rest: servo.status.at_rest,
                })
            }
            Stop::CODE => {
                let (Stop {}, reply) = message.open::<Stop>()?;
                self.halt(cx, StopKind::Protective).await?;
                reply.ok(())
            }
            Cancel::CODE => {
                let (Cancel {}, reply) = message.open::<Cancel>()?;
                self.halt(cx, StopKind::Cancel).await?;
                reply.ok(())
            }
            Resume::CODE => {
                let (Resume {}, reply) = message.open::<Resume>()?;
                Self::told(cx, &self.parts()?.servo, ResumeServo {}).await?;
                reply.ok(())
            }
            EmergencyStop::CODE => {
                let (EmergencyStop {}, reply) = message.open::<EmergencyStop>()?;
                self.halt(cx, StopKind::Emergency).await?;
                reply.ok(())
            }
            ControlledStop::CODE => {
                let (ControlledStop {}, reply) = message.open::<ControlledStop>()?;
                self.halt(cx, StopKind::Controlled).await?;
                reply.ok(())
            }
            ReadControl::CODE => {
                let (request, reply) = message.open::<ReadControl>()?;
                reply.ok(Self::told(cx, &self.parts()?.servo, request).await?)
            }
            RecordStates::CODE => {
                let (request, reply) = message.open::<RecordStates>()?;
                Self::told(cx, &self.parts()?.servo, request).await?;
                reply.ok(())
            }
            SetControl::CODE => {
                let (request, reply) = message.open::<SetControl>()?;
                reply.ok(Self::told(cx, &self.parts()?.servo, request).await?)
            }
            SetGuard::CODE => {
                let (request, reply) = message.open::<SetGuard>()?;
                reply.ok(Self::told(cx, &self.parts()?.servo, request).await?)
            }
            RemoveGuard::CODE => {
                let (request, reply) = message.open::<RemoveGuard>()?;
                reply.ok(Self::told(cx, &self.parts()?.servo, request).await?)
            }
            ReadGuards::CODE => {
                let (request, reply) = message.open::<ReadGuards>()?;
                reply.ok(Self::told(cx, &self.parts()?.servo, request).await?)
            }
            ReadSensors::CODE => {
                let (request, reply) = message.open::<ReadSensors>()?;
                reply.ok(Self::told(cx, &self.parts()?.servo, request).await?)
            }
            ReadSlots::CODE => {
                let (request, reply) = message.open::<ReadSlots>()?;
                reply.ok(Self::told(cx, &self.parts()?.servo, request).await?)
            }
            SetLaw::CODE => {
                let (request, reply) = message.open::<SetLaw>()?;
                reply.ok(Self::told(cx, &self.parts()?.servo, request).await?)
            }
            StreamSetpoints::CODE => {
                let by = (caller(cx, message.from()).await?, message.from().chassis());
                let (request, reply) = message.open::<StreamSetpoints>()?;
                reply.ok(self.stream(cx, by, request).await)
            }
            StreamValue::CODE => {
                let by = caller(cx, message.from()).await?;
                let (value, reply) = message.open::<StreamValue>()?;
                reply.ok(self.of_holder(cx, &by, value).await?)
            }
            SetOutput::CODE => {
                let by = caller(cx, message.from()).await?;
                let (request, reply) = message.open::<SetOutput>()?;
                reply.ok(self.of_holder(cx, &by, request).await?)
            }
            ReadStream::CODE => {
                let (request, reply) = message.open::<ReadStream>()?;
                reply.ok(Self::told(cx, &self.parts()?.servo, request).await?)
            }
            Status::CODE => {
                let (Status {}, reply) = message.open::<Status>()?;
                reply.ok(self.status(cx).await?)
            }
            _ => cx.default_processing(message),
        }
    }

    async fn phase(&mut self, cx: &Context, phase: Phase) -> Handled {
        if phase == Phase::Connect {
            self.parts = Some(Parts {
                servo: cx.task(&self.args.servo).await?,
                state: cx.task(&self.args.state).await?,
                planner: cx.task(&self.args.planner).await?,
            });
        }
        Ok(())
    }
}
