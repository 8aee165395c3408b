//! The planner as a task: takes [`Plan`] and [`Move`], checks them, gives segments to the servo and
//! answers a move when the arm has settled or is on its way to the next target, or says what ended it.

use std::cell::RefCell;
use std::collections::VecDeque;
use std::future::Future;
use std::rc::Rc;
use std::sync::Arc;
use std::time::Duration;

use ctos::message::{ChassisNumber, Command, Message, Replier};
use ctos::registry::Registry;
use ctos::survey::AtReport;
use ctos::task::{Context, EventHandler, Handled, HandlerError, Phase, StopReason};

use super::args::PartArgs;
use super::{Link, PLANNER, SERVO, check_reference, retreat};
use crate::client::{MotionError, Move, MoveReport, Outcome, Plan, PlanReport};
use crate::driver::Power;
use crate::guard::Reaction;
use crate::joints::Joints;
use crate::servo::{MotionPhase, QUEUE, Rejection, ServoCommand, ServoStatus};
use crate::trajectory::{Blend, Bridge, Pace, PlanError, Planner, Segment};

pub(super) fn register(registry: &mut Registry) {
    registry
        .handler(PLANNER, &[Move::INFO, Plan::INFO], |cx| {
            let args: PartArgs = cx.args()?;
            Ok(PlannerTask {
                servo: args.servo,
                link: None,
                planner: None,
                waiting: Rc::default(),
                last: None,
                last_id: 0,
                asked_from: 0,
                ending: None,
            })
        })
        .checked_args::<PartArgs>(|args, task, app, findings| {
            check_reference(task, app, findings, ("servo", &args.servo), SERVO, true);
        });
}

/// The callers of the motion under way and of those that wait, with the motions' numbers.
type Waiting = Rc<RefCell<VecDeque<(u64, Replier<Move>)>>>;

/// The motion that was ordered last.
struct Last {
    segment: Segment,
    /// Where it ends, rad or m.
    end: Joints,
    pace: Pace,
}

struct PlannerTask {
    servo: String,
    link: Option<Arc<Link>>,
    planner: Option<Planner>,
    waiting: Waiting,
    last: Option<Last>,
    last_id: u64,
    /// The number of the chassis from which the latest move was asked for.
    asked_from: ChassisNumber,
    /// Why nothing moves any more: the app is being stopped.
    ending: Option<String>,
}

impl PlannerTask {
    fn link(&self) -> Result<Arc<Link>, HandlerError> {
        self.link
            .clone()
            .ok_or_else(|| "the servo is not connected yet".into())
    }

    /// The motion that was ordered last, while it has not ended.
    fn last(&self, link: &Link) -> Option<&Last> {
        let last = self.last.as_ref()?;
        let ended = link.port.status().ended.of(self.last_id).is_some();
        (!ended).then_some(last)
    }

    /// The segment for a request, and where it ends: from where the last motion ends, or the arm is held (or stands).
    fn plan(&mut self, link: &Link, request: &Plan) -> Result<(Segment, Joints), MotionError> {
        let held = link.port.status().setpoint;
        let start = self.last(link).map_or(held, |last| last.end);
        let planner = self.planner.get_or_insert_with(|| link.planner.clone());
        let route = request.route().map_err(refused)?;
        planner.segment(&start, &route).map_err(unplanned)
    }

    /// Gives the servo the segment for a move, or says what is in the way of it.
    fn begin(&mut self, cx: &Context, request: Move, reply: Replier<Move>) -> Handled {
        let link = self.link()?;
        if let Err(error) = self.may_begin(&link, request.blend) {
            return reply.ok(Err(error));
        }
        let guards = match link.guards.named(&request.guards) {
            Ok(guards) => guards,
            Err(error) => return reply.ok(Err(error)),
        };
        let pace = Pace::new(request.speed, request.acceleration);
        let blend = request.blend;
        let request = Plan {
            target: request.target,
            path: request.path,
            speed: request.speed,
            acceleration: request.acceleration,
            elbow: request.elbow,
        };
        let (segment, end) = match self.plan(&link, &request) {
            Ok(planned) => planned,
            Err(error) => return reply.ok(Err(error)),
        };
        let status = link.port.status();
        let bridge = self.bridge(&link, &segment, pace, blend);
        let singularity = segment.singularity();
        if let Some((smallest, slowed)) = singularity.filter(|(_, slowed)| *slowed > 1.0) {
            tracing::info!(
                task = cx.name(),
                "the limits of the joints make the path {slowed:.2} times as long; the smallest singular value along it is {smallest:.3e}"
            );
        }
        let newest = status.ended.newest().max(status.motion.id);
        let id = self.last_id.max(newest) + 1;
        link.port.order(ServoCommand::Name { guards })?;
        link.port.order(match bridge {
            Some(bridge) => ServoCommand::MoveOver {
                id,
                segment,
                bridge,
            },
            None => ServoCommand::Move { id, segment },
        })?;
        self.waiting.borrow_mut().push_back((id, reply));
        link.ways.add(id, segment, &status.ended);
        self.last_id = id;
        self.last = Some(Last { segment, end, pace });
        let duration = Duration::from_secs_f64(segment.duration());
        cx.is_at(Some(AtReport {
            text: "moves the arm".to_owned(),
            until: Some(cx.now() + duration),
        }));
        cx.spawn(watch(
            cx.clone(),
            link,
            Rc::clone(&self.waiting),
            id,
            (duration, singularity.map(|(smallest, _)| smallest)),
        ));
        Ok(())
    }

    /// The way into a segment from the one before it, at the pace of the faster one.
    fn bridge(
        &mut self,
        link: &Link,
        segment: &Segment,
        pace: Pace,
        blend: Blend,
    ) -> Option<Bridge> {
        let last = self.last(link)?;
        let (before, slower) = (last.segment, last.pace);
        let pace = Pace {
            speed: pace.speed.max(slower.speed),
            acceleration: pace.acceleration.max(slower.acceleration),
        };
        let planner = self.planner.as_mut()?;
        planner.bridge((&before, segment), pace, blend)
    }

    fn may_begin(&self, link: &Link, blend: Blend) -> Result<(), MotionError> {
        if let Some(reason) = &self.ending {
            return Err(ended(reason));
        }
        let status = link.port.status();
        if let Some(error) = link.failed() {
            return Err(error);
        }
        if status.stopped {
            return Err(stop_holds());
        }
        blend.check().map_err(unplanned)?;
        let waiting = self.waiting.borrow().len();
        if waiting >= QUEUE {
            return Err(refused(Rejection::Full));
        }
        if status.power != Power::Released {
            return Err(refused(
                "the brakes are on; acquire the manipulator and move through its client interface",
            ));
        }
        let stopping = status.motion.phase == MotionPhase::Stopping;
        if stopping || (waiting == 0 && !status.motion.phase.is_over()) {
            return Err(refused(Rejection::Busy));
        }
        Ok(())
    }

    /// Answers the callers of all motions and brakes, for good; the future ends when the arm rests.
    fn halt(
        &mut self,
        cx: &Context,
        reason: &StopReason,
    ) -> Result<impl Future<Output = Handled> + use<>, HandlerError> {
        let reason = self.ending.insert(reason.to_string());
        for (_, reply) in self.waiting.borrow_mut().drain(..) {
            reply.ok(Err(ended(reason)))?;
        }
        let link = self.link.clone();
        if let Some(link) = &link {
            link.port.order(ServoCommand::Cancel)?;
        }
        let cx = cx.clone();
        Ok(async move {
            if let Some(link) = link {
                let patience = link.rest_patience();
                let resting = |status: &ServoStatus| status.at_rest || status.fault.is_some();
                link.wait(&cx, "come to rest", patience, resting).await?;
            }
            Ok(())
        })
    }
}

fn refused(reason: impl ToString) -> MotionError {
    MotionError::new(Outcome::Refused, reason)
}

/// The app is being stopped.
fn ended(reason: &str) -> MotionError {
    MotionError::new(Outcome::Stopped, format!("stopped because {reason}"))
}

fn stop_holds() -> MotionError {
    MotionError::new(
        Outcome::Stopped,
        "a protective stop holds; `pino EXEC resume` ends it",
    )
}

/// A request that makes no sense is refused; what the arm cannot do may be possible elsewhere.
fn unplanned(error: PlanError) -> MotionError {
    let outcome = match error {
        PlanError::Speed { .. }
        | PlanError::Acceleration { .. }
        | PlanError::NotFinite { .. }
        | PlanError::Count { .. }
        | PlanError::UnknownPath { .. }
        | PlanError::Numbers { .. }
        | PlanError::Share { .. }
        | PlanError::Distance { .. }
        | PlanError::Curve(_)
        | PlanError::NoLimit { .. } => Outcome::Refused,
        PlanError::Target(_)
        | PlanError::Path { .. }
        | PlanError::Singular { .. }
        | PlanError::JointSpeed { .. }
        | PlanError::JointJerk { .. }
        | PlanError::JointAcceleration { .. } => Outcome::Unreachable,
    };
    MotionError::new(outcome, error)
}

/// Waits for the end of motion `id`, which takes so long when it is its turn and has this smallest singular value, and
/// answers its caller.
async fn watch(
    cx: Context,
    link: Arc<Link>,
    waiting: Waiting,
    id: u64,
    (duration, smallest_singular_value): (Duration, Option<f64>),
) {
    let over = move |status: &ServoStatus| status.fault.is_some() || status.ended.of(id).is_some();
    // Each one before it has a watch of its own, and its own patience.
    let ended = loop {
        let first = waiting
            .borrow()
            .front()
            .is_none_or(|(first, _)| *first >= id);
        let patience = duration + link.rest_patience();
        let ended = link.wait(&cx, "end the motion", patience, over).await;
        if ended.is_ok() || first {
            break ended;
        }
    };
    let own = {
        let mut waiting = waiting.borrow_mut();
        let place = waiting.iter().position(|(waits, _)| *waits == id);
        place.and_then(|place| waiting.remove(place))
    };
    let found = ended.as_ref().ok();
    let found = found.and_then(|status| status.ended_by_guard(id));
    let went_back = match found {
        Some(found) if found.reaction == Reaction::Retreat => {
            Some(retreat::back(&cx, &link, &found).await)
        }
        _ => None,
    };
    if waiting.borrow().is_empty() {
        cx.is_at(None);
    }
    // A stop may have answered the caller already.
    let Some((_, reply)) = own else {
        return;
    };
    let result = match ended {
        Ok(status) => outcome(&link, &status, id, went_back).map(|report| MoveReport {
            smallest_singular_value,
            ..report
        }),
        Err(error) => Err(MotionError::new(Outcome::Fault, error)),
    };
    if let Err(error) = reply.ok(result) {
        tracing::warn!(task = cx.name(), %error, "a move could not be answered");
    }
}

/// What became of motion `id`, which ended with this status; and of the way back, if a guard wanted one.
fn outcome(
    link: &Link,
    status: &ServoStatus,
    id: u64,
    went_back: Option<Result<(), HandlerError>>,
) -> Result<MoveReport, MotionError> {
    if let Some(error) = link.failed() {
        return Err(error);
    }
    if let Some(found) = status.ended_by_guard(id) {
        let mut reason = format!("guard `{}` ended it: {}", found.guard, found.measured);
        match went_back {
            Some(Ok(())) => reason += "; the arm went back to where all was well",
            Some(Err(error)) => reason += &format!("; the arm could not go back: {error}"),
            None => {}
        }
        return Err(MotionError::new(Outcome::Guard, reason));
    }
    let Some(motion) = status.ended.of(id) else {
        let text = "how the motion ended is not known any more";
        return Err(MotionError::new(Outcome::Lost, text));
    };
    let stopped = |reason: &str| {
        // One that was stopped while it waited has taken no time.
        let when = match motion.elapsed_ticks {
            0 => "before it began",
            _ => "before its end",
        };
        Err(MotionError::new(
            Outcome::Stopped,
            reason.replace("{when}", when),
        ))
    };
    match motion.phase {
        MotionPhase::Done => Ok(MoveReport {
            duration_s: motion.elapsed_ticks as f64 * link.config.period.as_secs_f64(),
            max_tracking_error_rad: motion.max_tracking_error.turning,
            max_tracking_error_m: motion.max_tracking_error.sliding,
            final_error_rad: motion.error.turning,
            final_error_m: motion.error.sliding,
            joints: status.position,
            smallest_singular_value: None,
        }),
        MotionPhase::Rejected(Rejection::Stopped) => Err(stop_holds()),
        MotionPhase::Rejected(reason) => Err(refused(reason)),
        _ if status.stopped => {
            stopped("stopped {when} by a protective stop, which holds until `pino EXEC resume`")
        }
        _ => stopped("cancelled {when}; the arm has come to rest on the way"),
    }
}

impl EventHandler for PlannerTask {
    async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
        match message.command() {
            Move::CODE => {
                let from = message.from().chassis();
                let (request, reply) = message.open::<Move>()?;
                if self.waiting.borrow().is_empty() {
                    self.asked_from = from;
                }
                self.begin(cx, request, reply)
            }
            Plan::CODE => {
                let (request, reply) = message.open::<Plan>()?;
                let link = self.link()?;
                let planned = self.plan(&link, &request);
                reply.ok(planned.map(|(segment, joints)| PlanReport {
                    joints,
                    duration_s: segment.duration(),
                    smallest_singular_value: segment.singularity().map(|(smallest, _)| smallest),
                }))
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

    /// The arm comes to rest first of all. It keeps its power, so that who holds it can give it back.
    async fn quiesce(&mut self, cx: &Context, reason: &StopReason) -> Handled {
        let rests = self.halt(cx, reason)?;
        cx.quiet_after(|| "the arm comes to rest".to_owned(), rests);
        Ok(())
    }

    async fn stop(&mut self, cx: &Context, reason: &StopReason) -> Handled {
        self.halt(cx, reason)?.await
    }

    /// Nobody could stop a motion any more whose client interface is gone.
    async fn chassis_down(&mut self, cx: &Context, chassis: &str) -> Handled {
        let asked_from = cx.chassis().name_of(self.asked_from);
        if asked_from == chassis && !self.waiting.borrow().is_empty() {
            tracing::warn!(
                task = cx.name(),
                chassis,
                "the arm comes to rest: the chassis of its client interface is gone"
            );
            self.link()?.port.order(ServoCommand::Cancel)?;
        }
        Ok(())
    }
}
