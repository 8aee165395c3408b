//! Druide moves the arm: knows where the hand was when a picture was exposed, predicts the ball, and leaves a setpoint in every period
//! (SORMA technical report, sections 2.2.5 to 2.2.8).
//!
//! The servo follows its snapshot buffer and stops by itself when that falls silent. What was stopped is begun anew after a while, but
//! for what needs a person: an emergency stop, a stop that holds, and the guards that the configuration names.

mod period;

use std::{cell::RefCell, rc::Rc, sync::Arc, time::Duration};

use ctos::{
    diagnostic::Finding,
    message::{Command, Message},
    registry::Registry,
    sync::{CyclicHandle, Tick},
    task::{Context, EventHandler, Handled, HandlerError, Phase},
    time::Instant,
};
use mcs::{
    client::{
        Acquire, Manipulator, MotionError, ReadGuards, ReadStream, RecordStates, StreamKind,
        StreamSetpoints,
    },
    guard::GuardReport,
    trajectory::Solver,
};
use serde::Deserialize;
use sorma::clock::{ClockDifference, Exchange, Observed, USUAL_DRIFT};

use crate::{
    control::{self, ControlArgs},
    wire::{
        ClockTruth, CompareClocks, ReadTracker, SETPOINT, STATES, StartTracking, StopTracking,
        TargetSeen, TrackerReport, TrueClock, seconds,
    },
};
use period::Period;

/// The handler's name.
pub const HANDLER: &str = "tracker.druide";

/// A setpoint older than this ends the stream, s.
const OLDEST: f64 = 0.1;

/// How often the clocks are compared.
const COMPARE: Duration = Duration::from_millis(250);

/// How often it is looked whether the arm still follows.
const WATCH: Duration = Duration::from_millis(50);

/// An arm that was stopped is tried again after this.
const AGAIN: Duration = Duration::from_secs(1);

/// How long an exchange of times may take.
const EXCHANGE: Duration = Duration::from_secs(1);

/// Arguments.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
struct DruideArgs {
    /// The client interface of the arm.
    #[serde(default = "mcs_task")]
    mcs: String,
    /// The task that looks.
    #[serde(default = "argus_task")]
    argus: String,
    /// From setpoint to setpoint, ms.
    #[serde(default = "period_ms")]
    period_ms: f64,
    /// Which number of the slots that are no joints is the first of the force at the wrist, from 0; none where there is no sensor.
    wrist: Option<usize>,
    /// About where the ball is seen from a hand that is where it should be: m along the axes of the tool. It counts as far as the hand
    /// is turned from how it was at the beginning.
    #[serde(default)]
    ball_m: [f64; 3],
    /// A deflection of the mouse older than this counts as none, s.
    #[serde(default = "mouse_age_s")]
    mouse_age_s: f64,
    /// Largest drift of the clocks, s per s.
    #[serde(default = "drift")]
    drift: f64,
    /// Whether the ball's motion is predicted.
    #[serde(default = "yes")]
    prediction: bool,
    /// Guards after which the arm does not begin again by itself: a person has to start the tracking anew.
    #[serde(default = "waits_after")]
    waits_after: Vec<String>,
    /// How the hand follows.
    #[serde(default)]
    control: ControlArgs,
}

fn mcs_task() -> String {
    "mcs".to_owned()
}

fn argus_task() -> String {
    "argus".to_owned()
}

fn period_ms() -> f64 {
    4.5
}

fn mouse_age_s() -> f64 {
    0.1
}

fn waits_after() -> Vec<String> {
    vec!["overload".to_owned()]
}

fn drift() -> f64 {
    USUAL_DRIFT
}

fn yes() -> bool {
    true
}

/// Registers the handler.
pub(crate) fn register(registry: &mut Registry) {
    let commands = [
        TargetSeen::INFO,
        StartTracking::INFO,
        StopTracking::INFO,
        ReadTracker::INFO,
        TrueClock::INFO,
    ];
    let handler = registry.handler(HANDLER, &commands, |cx| Druide::new(cx, cx.args()?));
    handler.checked_args::<DruideArgs>(|args, task, app, findings| {
        let place = |key: &str| task.args.locate(key).unwrap_or_else(|| task.place.clone());
        for (key, name) in [("mcs", &args.mcs), ("argus", &args.argus)] {
            if app.task(name).is_none() {
                let names = app.tasks.iter().map(|task| task.name.as_str());
                let text = format!("`{key}` names `{name}`, which is no task");
                let finding = Finding::error("ctos::config::unknown_task", text);
                findings.push(finding.at(place(key)).suggest(name, names));
            }
        }
        let wrong = args.control.wrong();
        let wrong = wrong.map(|(key, value)| (format!("control.{key}"), value));
        let own = [
            ("period_ms", args.period_ms, 0.5, 50.0),
            ("mouse_age_s", args.mouse_age_s, 0.001, 10.0),
            ("drift", args.drift, 0.0, sorma::clock::MOST_DRIFT),
        ];
        let own = own
            .into_iter()
            .find(|(_, value, least, most)| !(*value >= *least && *value <= *most));
        let wrong = wrong.or_else(|| own.map(|(key, value, ..)| (key.to_owned(), value)));
        if let Some((key, value)) = wrong {
            let text = format!("`{key}` is {value}");
            let at = place(&key);
            let finding = Finding::error("coordinators::tracker::druide", text).at(at);
            findings.push(finding.help("`docs/tracker.md` says what it may be"));
        }
    });
}

/// What the periods, the messages and the watch share.
struct Shared {
    clocks: ClockDifference,
    report: TrackerReport,
    /// What a period works with while the arm is followed.
    period: Option<Period>,
}

/// The event handler.
struct Druide {
    args: DruideArgs,
    shared: Rc<RefCell<Shared>>,
    solver: Solver,
    cyclic: Option<CyclicHandle>,
    /// Which tracking is under way; that of an earlier one ends by itself.
    serial: Rc<RefCell<u64>>,
}

impl Druide {
    fn new(cx: &Context, mut args: DruideArgs) -> Result<Self, HandlerError> {
        args.control.prediction = args.prediction;
        let model = mcs::manipulator(cx.app()).ok_or("no servo task has a sound arm")?;
        let solver = Solver::new(Arc::new(model))?;
        let clocks = ClockDifference::new(args.drift)?;
        let shared = Shared {
            clocks,
            report: TrackerReport::default(),
            period: None,
        };
        Ok(Self {
            args,
            shared: Rc::new(RefCell::new(shared)),
            solver,
            cyclic: None,
            serial: Rc::default(),
        })
    }

    /// Takes the arm and follows from now on.
    async fn start(&mut self, cx: &Context) -> Result<(), HandlerError> {
        let arm = Manipulator::find(cx, &self.args.mcs).await?;
        let recipes = arm.guards().await?.recipes;
        for name in &self.args.waits_after {
            if !recipes.iter().any(|recipe| recipe.name == *name) {
                let text = format!(
                    "`waits_after` names the guard `{name}`, which the arm has not: add it, or leave the name out"
                );
                return Err(HandlerError::new(text));
            }
        }
        arm.acquire().await?;
        let client = cx.task(&self.args.mcs).await?;
        let buffer = Some(STATES.to_owned());
        cx.call(&client, RecordStates { buffer }).await?;
        cx.reads_unrecorded("what the servo leaves");
        let period = Period::new(cx, self.solver.clone(), &self.args)?;
        self.shared.borrow_mut().period = Some(period);
        let (shared, own) = (Rc::clone(&self.shared), cx.clone());
        let length = Duration::from_secs_f64(self.args.period_ms * 1e-3);
        let tick = move |tick: &Tick| {
            let mut shared = shared.borrow_mut();
            let Shared {
                clocks,
                report,
                period: Some(period),
            } = &mut *shared
            else {
                return;
            };
            period.go(&own, seconds(tick.now), clocks.at(tick.now), report);
        };
        self.cyclic = Some(cx.cyclic(length, tick));
        let serial = {
            let mut serial = self.serial.borrow_mut();
            *serial += 1;
            *serial
        };
        let watch = Watch {
            cx: cx.clone(),
            mcs: self.args.mcs.clone(),
            waits_after: self.args.waits_after.clone(),
            found: RefCell::default(),
            shared: Rc::clone(&self.shared),
            serial: (Rc::clone(&self.serial), serial),
        };
        watch.begin().await?;
        cx.spawn(async move { watch.watch().await });
        Ok(())
    }

    /// Comes to rest and gives the arm back.
    async fn stop(&mut self, cx: &Context) -> Result<(), HandlerError> {
        *self.serial.borrow_mut() += 1;
        let arm = Manipulator::find(cx, &self.args.mcs).await?;
        let released = arm.release().await;
        self.cyclic = None;
        let mut shared = self.shared.borrow_mut();
        shared.period = None;
        shared.report.phase = control::Phase::Idle;
        released?;
        Ok(())
    }

    /// Takes in where the hand should have been.
    fn take(&self, now: f64, seen: &TargetSeen) {
        let mut shared = self.shared.borrow_mut();
        let Shared {
            clocks,
            report,
            period: Some(period),
        } = &mut *shared
        else {
            return;
        };
        let stamp = clocks.correct(Instant::from_nanos(seen.stamp_ns));
        let placed = stamp.is_some_and(|stamp| period.take(now, seconds(stamp.at), &seen.relative));
        if !placed {
            report.unplaced += 1;
        }
    }
}

impl EventHandler for Druide {
    async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
        match message.command() {
            TargetSeen::CODE => {
                let (seen, reply) = message.open::<TargetSeen>()?;
                self.take(seconds(cx.now()), &seen);
                reply.ok(())
            }
            StartTracking::CODE => {
                let (StartTracking {}, reply) = message.open::<StartTracking>()?;
                match self.start(cx).await {
                    Ok(()) => reply.ok(()),
                    Err(error) => reply.fail(error.to_string()),
                }
            }
            StopTracking::CODE => {
                let (StopTracking {}, reply) = message.open::<StopTracking>()?;
                match self.stop(cx).await {
                    Ok(()) => reply.ok(()),
                    Err(error) => reply.fail(error.to_string()),
                }
            }
            ReadTracker::CODE => {
                let (ReadTracker {}, reply) = message.open::<ReadTracker>()?;
                reply.ok(self.shared.borrow().report.clone())
            }
            TrueClock::CODE => {
                let (TrueClock {}, reply) = message.open::<TrueClock>()?;
                reply.ok(ClockTruth::here(cx))
            }
            _ => cx.default_processing(message),
        }
    }

    async fn phase(&mut self, cx: &Context, phase: Phase) -> Handled {
        if phase == Phase::Run {
            let (own, argus) = (cx.clone(), self.args.argus.clone());
            let shared = Rc::clone(&self.shared);
            cx.spawn(async move {
                loop {
                    if let Err(error) = compare(&own, &argus, &shared).await {
                        tracing::debug!("the clocks are not compared: {error}");
                    }
                    own.sleep(COMPARE).await;
                }
            });
        }
        Ok(())
    }
}

/// Exchanges times with argus.
async fn compare(cx: &Context, argus: &str, shared: &RefCell<Shared>) -> Result<(), HandlerError> {
    let argus = cx.task(argus).await?;
    let t1 = cx.now();
    let there = cx
        .call(&argus, CompareClocks {})
        .deadline(EXCHANGE)
        .high_priority()
        .await?;
    let exchange = Exchange {
        t1,
        t2: Instant::from_nanos(there.arrived_ns),
        t3: Instant::from_nanos(there.replied_ns),
        t4: cx.now(),
    };
    let mut shared = shared.borrow_mut();
    let Shared { clocks, report, .. } = &mut *shared;
    let observed = clocks.observe(exchange);
    if observed.map_err(|error| HandlerError::new(error.to_string()))? == Observed::Restarted {
        report.clock_restarts += 1;
        tracing::warn!("a clock was set, or drifts faster than was said");
    }
    if let Some(difference) = clocks.at(cx.now()) {
        report.clock_s = difference.offset_ns as f64 * 1e-9;
        report.clock_bound_s = difference.error_ns as f64 * 1e-9;
    }
    Ok(())
}

/// Sees that the arm follows.
struct Watch {
    cx: Context,
    mcs: String,
    waits_after: Vec<String>,
    /// What a guard had found last when the arm began to follow.
    found: RefCell<Option<GuardReport>>,
    shared: Rc<RefCell<Shared>>,
    serial: (Rc<RefCell<u64>>, u64),
}

impl Watch {
    fn is_over(&self) -> bool {
        *self.serial.0.borrow() != self.serial.1 || self.cx.is_stopping()
    }

    /// Has the servo follow the setpoints.
    async fn begin(&self) -> Result<(), MotionError> {
        let client = self.cx.task(&self.mcs).await?;
        let guards = self.cx.call(&client, ReadGuards {}).await?;
        self.found.replace(guards.last);
        let stream = StreamSetpoints {
            kind: StreamKind::Tool,
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

    /// Looks at the stream, and begins it anew when it has ended.
    async fn watch(&self) {
        let mut told: Option<String> = None;
        while !self.is_over() {
            self.cx.sleep(WATCH).await;
            let Some(why) = self.ended().await else {
                continue;
            };
            if self.is_over() {
                return;
            }
            let person = self.needs_person().await;
            {
                let mut shared = self.shared.borrow_mut();
                if let Some(period) = &mut shared.period
                    && period.halt()
                {
                    tracing::warn!("the arm was stopped: {why}");
                    shared.report.stops += 1;
                    shared.report.stopped = Some(why);
                }
            }
            match person {
                Ok(None) => {}
                Ok(Some(guard)) => {
                    tracing::warn!(
                        guard,
                        "the arm waits for a person, who starts the tracking anew"
                    );
                    return;
                }
                // Not known is no permission: it is looked again.
                Err(error) => {
                    tracing::debug!("the guards do not answer: {error}");
                    continue;
                }
            }
            self.cx.sleep(AGAIN).await;
            if self.is_over() {
                return;
            }
            match self.again().await {
                Ok(()) => {
                    tracing::info!("the arm follows again");
                    told = None;
                }
                Err(error) => {
                    let error = error.to_string();
                    if told.as_ref() != Some(&error) {
                        tracing::warn!("the arm does not follow: {error}");
                        self.shared.borrow_mut().report.stopped = Some(error.clone());
                        told = Some(error);
                    }
                }
            }
        }
    }

    /// The guard that ended the stream, if it is one after which a person has to say that it goes on.
    async fn needs_person(&self) -> Result<Option<String>, MotionError> {
        let client = self.cx.task(&self.mcs).await?;
        let last = self.cx.call(&client, ReadGuards {}).await?.last;
        let new = last.filter(|last| self.found.borrow().as_ref() != Some(last));
        let guard = new.map(|report| report.guard.to_string());
        Ok(guard.filter(|guard| self.waits_after.contains(guard)))
    }

    /// Why the arm does not follow, if it does not.
    async fn ended(&self) -> Option<String> {
        let asked = async {
            let client = self.cx.task(&self.mcs).await?;
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

    /// Follows again, if that is safe: somebody who holds the arm, an emergency stop and a stop that holds are not overruled.
    async fn again(&self) -> Result<(), MotionError> {
        let client = self.cx.task(&self.mcs).await?;
        self.cx.call(&client, Acquire {}).await??;
        self.begin().await
    }
}
