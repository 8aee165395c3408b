//! Sees that the arm follows: what happens is told to the net in front, and what that answers is done.

use std::{cell::RefCell, rc::Rc, time::Duration};

use ctos::task::{Context, HandlerError};
use mcs::{
    client::{Acquire, MotionError, ReadGuards, ReadStream, Status, StreamKind, StreamSetpoints},
    guard::GuardReport,
    state::State,
};

use super::{DruideArgs, Shared};
use crate::{
    control::Phase,
    coordination::ask,
    wire::{SETPOINT, seconds},
};

/// A setpoint older than this ends the stream, s.
const OLDEST: f64 = 0.1;

/// How often it is looked whether the arm still follows.
const WATCH: Duration = Duration::from_millis(50);

/// An arm that may begin again does so after this, and a ball that rests is told of anew.
const AGAIN: Duration = Duration::from_secs(1);

/// What druide tells the net.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Event {
    Seen,
    Gone,
    Silent,
    AtRest,
    BallRests,
    TooMuchForce,
    GuardSpoke,
    StoppedByOthers,
    PowerOff,
    StreamEnded,
}

impl Event {
    /// All.
    #[cfg(test)]
    const ALL: [Self; 10] = [
        Self::Seen,
        Self::Gone,
        Self::Silent,
        Self::AtRest,
        Self::BallRests,
        Self::TooMuchForce,
        Self::GuardSpoke,
        Self::StoppedByOthers,
        Self::PowerOff,
        Self::StreamEnded,
    ];

    fn symbol(self) -> &'static str {
        match self {
            Self::Seen => "seen",
            Self::Gone => "gone",
            Self::Silent => "silent",
            Self::AtRest => "at_rest",
            Self::BallRests => "ball_rests",
            Self::TooMuchForce => "too_much_force",
            Self::GuardSpoke => "guard_spoke",
            Self::StoppedByOthers => "stopped_by_others",
            Self::PowerOff => "power_off",
            Self::StreamEnded => "stream_ended",
        }
    }
}

/// What the net says.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Order {
    /// The hand goes where the ball is, or is expected.
    Follow,
    /// The hand comes to rest where it is.
    Hold,
    /// An arm that does not follow begins again.
    BeginAgain,
}

impl Order {
    /// What is not known is no permission.
    fn of(symbol: &str) -> Self {
        match symbol {
            "follow" | "predict" | "slow_down" | "look" | "stay" => Self::Follow,
            "begin_again" => Self::BeginAgain,
            _ => Self::Hold,
        }
    }
}

/// What watches over one time that the arm follows.
pub(super) struct Watch<F> {
    cx: Context,
    args: DruideArgs,
    /// What a guard had found last when the arm began to follow.
    found: RefCell<Option<GuardReport>>,
    shared: Rc<RefCell<Shared>>,
    is_over: F,
}

impl<F: Fn() -> bool> Watch<F> {
    /// Of a time that ends when `is_over` says so.
    pub(super) fn new(
        cx: &Context,
        args: &DruideArgs,
        shared: Rc<RefCell<Shared>>,
        is_over: F,
    ) -> Self {
        Self {
            cx: cx.clone(),
            args: args.clone(),
            found: RefCell::default(),
            shared,
            is_over,
        }
    }

    /// Has the servo follow the setpoints, if that is safe: somebody who holds the arm, an emergency stop and a stop that holds are
    /// not overruled.
    pub(super) async fn again(&self) -> Result<(), MotionError> {
        let client = self.cx.task(&self.args.mcs).await?;
        self.cx.call(&client, Acquire {}).await??;
        let guards = self.cx.call(&client, ReadGuards {}).await?;
        self.found.replace(guards.last);
        let stream = StreamSetpoints {
            kind: StreamKind::Joints,
            buffer: Some(SETPOINT.to_owned()),
            max_age_s: OLDEST,
            speed: 1.0,
            acceleration: None,
            guards: Vec::new(),
        };
        self.cx.call(&client, stream).await??;
        if let Some(period) = &mut self.shared.borrow_mut().period {
            period.resume();
        }
        Ok(())
    }

    /// Tells the net what happens, and does what it says.
    pub(super) async fn watch(&self) {
        let (mut told, mut order, mut since) = (None, Order::Follow, self.cx.now());
        let mut failed: Option<String> = None;
        loop {
            self.cx.sleep(WATCH).await;
            let Some(event) = self.event().await else {
                continue;
            };
            if (self.is_over)() {
                return;
            }
            let waited = self.cx.now().since(since) >= AGAIN;
            if told != Some(event) || (event == Event::BallRests && waited) {
                order = match ask(&self.cx, &self.args.net, event.symbol()).await {
                    Ok(answer) => {
                        told = Some(event);
                        Order::of(&answer.symbol)
                    }
                    Err(error) => {
                        self.tell(&mut failed, "the net does not answer", &error);
                        told = None;
                        Order::Hold
                    }
                };
                if (self.is_over)() {
                    return;
                }
                since = self.cx.now();
                tracing::debug!(event = event.symbol(), ?order, "told");
                if let Some(period) = &mut self.shared.borrow_mut().period {
                    period.stand(order == Order::Hold);
                }
            } else if order == Order::BeginAgain && waited {
                since = self.cx.now();
                match self.again().await {
                    Ok(()) => {
                        tracing::info!("the arm follows again");
                        (told, failed) = (None, None);
                    }
                    Err(error) => self.tell(&mut failed, "the arm does not follow", &error.into()),
                }
            }
        }
    }

    /// Tells once what fails.
    fn tell(&self, failed: &mut Option<String>, what: &str, error: &HandlerError) {
        let error = error.to_string();
        if failed.as_ref() != Some(&error) {
            tracing::warn!("{what}: {error}");
            self.shared.borrow_mut().report.stopped = Some(error.clone());
            *failed = Some(error);
        }
    }

    /// What happens now; nothing as long as the arm's tasks do not say why it does not follow. Not known is no permission.
    async fn event(&self) -> Option<Event> {
        let Some(why) = self.ended().await else {
            return self.seen();
        };
        let stopped = match (self.is_over)() {
            true => false,
            false => self
                .shared
                .borrow_mut()
                .period
                .as_mut()
                .is_some_and(super::Period::halt),
        };
        if stopped {
            tracing::warn!("the arm was stopped: {why}");
            let report = &mut self.shared.borrow_mut().report;
            report.stops += 1;
            report.stopped = Some(why);
        }
        match self.reason().await {
            Ok((event, fault)) => {
                // What took the power away says more than the stream that it ended.
                if let (true, Some(fault)) = (stopped, fault) {
                    self.shared.borrow_mut().report.stopped = Some(fault);
                }
                Some(event)
            }
            Err(error) => {
                tracing::debug!("why the arm does not follow is not known: {error}");
                None
            }
        }
    }

    /// How the ball is that the arm follows.
    fn seen(&self) -> Option<Event> {
        let shared = self.shared.borrow();
        let period = shared.period.as_ref()?;
        Some(match period.phase() {
            Phase::Track if period.ball_rests(seconds(self.cx.now())) => Event::BallRests,
            Phase::Track => Event::Seen,
            Phase::Lost => Event::Gone,
            Phase::Expired => Event::Silent,
            Phase::Idle | Phase::Acquire | Phase::Stopped => Event::AtRest,
        })
    }

    /// Why the arm does not follow, as the net understands it, and what took its power away.
    async fn reason(&self) -> Result<(Event, Option<String>), MotionError> {
        let client = self.cx.task(&self.args.mcs).await?;
        let status = self.cx.call(&client, Status {}).await?;
        if status.state == State::Estopped {
            return Ok((Event::PowerOff, status.fault));
        }
        let last = self.cx.call(&client, ReadGuards {}).await?.last;
        let new = last.filter(|last| self.found.borrow().as_ref() != Some(last));
        let guard = new.map(|report| report.guard.to_string());
        let event = match guard {
            Some(guard) if self.args.overload.contains(&guard) => Event::TooMuchForce,
            Some(guard) if !self.args.again_after.contains(&guard) => Event::GuardSpoke,
            _ if status.stopped => Event::StoppedByOthers,
            _ => Event::StreamEnded,
        };
        Ok((event, None))
    }

    /// Why the arm does not follow, if it does not.
    async fn ended(&self) -> Option<String> {
        let asked = async {
            let client = self.cx.task(&self.args.mcs).await?;
            Ok::<_, MotionError>(self.cx.call(&client, ReadStream {}).await?)
        };
        match asked.await {
            Ok(report) if report.follows => None,
            Ok(report) => Some(
                report
                    .end
                    .unwrap_or_else(|| "no stream is under way".to_owned()),
            ),
            Err(error) => Some(error.to_string()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_net_takes_everything_that_is_told_and_nothing_but_its_permission_moves_the_hand() {
        let net = include_str!("../../../../configs/nets/tracker/tracking.net");
        for event in Event::ALL {
            let line = format!("command {} -> ", event.symbol());
            let answers = net.lines().find_map(|net| net.strip_prefix(&line)).unwrap();
            for answer in answers.split(", ") {
                let order = match answer {
                    "hold" | "release" => Order::Hold,
                    "begin_again" => Order::BeginAgain,
                    _ => Order::Follow,
                };
                assert_eq!(Order::of(answer), order, "{answer}");
            }
        }
        assert_eq!(Order::of("anything else"), Order::Hold);
    }
}
