//! Druide moves the arm: knows where the hand was when a picture was exposed, predicts the ball, and leaves a setpoint in every period
//! (SORMA technical report, sections 2.2.5 to 2.2.8).
//!
//! The servo follows its snapshot buffer and stops by itself when that falls silent. What happens is told to the net in front, which
//! says what is done: whether the arm begins anew, waits for a person, or is handed over.

mod period;
mod watch;

use std::{
    cell::{Cell, RefCell},
    rc::Rc,
    sync::Arc,
    time::Duration,
};

use ctos::{
    diagnostic::Finding,
    message::{Command, Message},
    registry::Registry,
    sync::{CyclicHandle, Tick},
    task::{Context, EventHandler, Handled, HandlerError, Phase},
    time::Instant,
};
use mcs::{
    client::{Manipulator, PathKind, RecordStates},
    trajectory::Solver,
};
use nalgebra::Isometry3;
use serde::Deserialize;
use sorma::clock::{ClockDifference, Exchange, Observed, USUAL_DRIFT};

use crate::{
    control::{self, ControlArgs},
    coordination::{ask, net_task},
    grasp::{GraspArgs, Grasped, Grasper, let_go},
    learning::{LearnArgs, Learner, Learning},
    mover::Mover,
    walls::Wall,
    wire::{
        ClockTruth, CompareClocks, LetGo, ReadTracker, ResumeTracking, STATES, StartGrasp,
        StartLearning, StartTracking, StopTracking, TargetSeen, TrackerReport, TrueClock, seconds,
    },
};
use period::Period;
use watch::Watch;

/// The handler's name.
pub const HANDLER: &str = "tracker.druide";

/// How often the clocks are compared.
const COMPARE: Duration = Duration::from_millis(250);

/// How often it is looked whether learning has ended that was stopped.
const LOOK: Duration = Duration::from_millis(20);

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
    /// The task of the net in front.
    #[serde(default = "net_task")]
    net: String,
    /// The task that tells places from blobs, which a map is learned with.
    #[serde(default = "client_task")]
    client: String,
    /// Guards that speak of too much force.
    #[serde(default = "overload")]
    overload: Vec<String>,
    /// Guards after which the arm begins again by itself. After all others it waits for a person.
    #[serde(default)]
    again_after: Vec<String>,
    /// The arm is taken again only while less force than this is felt, N.
    #[serde(default = "resume_below_n")]
    resume_below_n: f64,
    /// A ball that has stayed within this for so long rests: m and s.
    #[serde(default = "rests")]
    rests: [f64; 2],
    /// How the map is learned.
    #[serde(default)]
    learn: LearnArgs,
    /// How the hand follows.
    #[serde(default)]
    control: ControlArgs,
    /// Walls before which the hand slows down.
    #[serde(default)]
    walls: Vec<Wall>,
    /// How the ball is grasped; nobody can where there is no hand.
    grasp: Option<GraspArgs>,
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

fn client_task() -> String {
    "client".to_owned()
}

fn rests() -> [f64; 2] {
    [0.005, 1.0]
}

fn resume_below_n() -> f64 {
    15.0
}

fn overload() -> Vec<String> {
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
        ResumeTracking::INFO,
        StartLearning::INFO,
        StartGrasp::INFO,
        LetGo::INFO,
        ReadTracker::INFO,
        TrueClock::INFO,
    ];
    let handler = registry.handler(HANDLER, &commands, |cx| Druide::new(cx, cx.args()?));
    handler.checked_args::<DruideArgs>(|args, task, app, findings| {
        let place = |key: &str| task.args.locate(key).unwrap_or_else(|| task.place.clone());
        let hand = args.grasp.as_ref().map(|grasp| ("grasp.hand", &grasp.hand));
        let tasks = [
            ("mcs", &args.mcs),
            ("argus", &args.argus),
            ("client", &args.client),
            ("net", &args.net),
        ];
        for (key, name) in tasks.into_iter().chain(hand) {
            if app.task(name).is_none() {
                let names = app.tasks.iter().map(|task| task.name.as_str());
                let text = format!("`{key}` names `{name}`, which is no task");
                let finding = Finding::error("ctos::config::unknown_task", text);
                findings.push(finding.at(place(key)).suggest(name, names));
            }
        }
        let wrong = args.control.wrong();
        let wrong = wrong.map(|(key, value)| (format!("control.{key}"), value));
        let grasp = args.grasp.as_ref().and_then(GraspArgs::wrong);
        let wrong = wrong.or_else(|| grasp.map(|(key, value)| (format!("grasp.{key}"), value)));
        let own = [
            ("period_ms", args.period_ms, 0.5, 50.0),
            ("mouse_age_s", args.mouse_age_s, 0.001, 10.0),
            ("drift", args.drift, 0.0, sorma::clock::MOST_DRIFT),
            ("resume_below_n", args.resume_below_n, 0.1, 1e4),
            ("rests", args.rests[0], 0.0, 1.0),
            ("rests", args.rests[1], 0.0, 1e3),
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
        let walls = args.walls.iter().enumerate();
        for (number, text) in walls.filter_map(|(number, wall)| Some((number, wall.wrong()?))) {
            let finding = Finding::error("coordinators::tracker::druide", text);
            let help = "`docs/tracker.md` says what a wall may be";
            findings.push(finding.at(place(&format!("walls.{number}"))).help(help));
        }
        if let Some((key, value, help)) = args.learn.wrong() {
            let key = format!("learn.{key}");
            let text = format!("`{key}` is {value}");
            let finding = Finding::error("coordinators::tracker::druide", text);
            findings.push(finding.at(place(&key)).help(help));
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
    /// Which tracking or learning is under way; that of an earlier one ends by itself.
    serial: Rc<Cell<u64>>,
    /// Whether the map is being learned, or the ball grasped: the arm is given back by who does that.
    learns: Rc<Cell<bool>>,
    /// Where the tool would have had the ball in its middle when the arm was given back.
    rested: Option<Isometry3<f64>>,
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
            learns: Rc::default(),
            rested: None,
        })
    }

    /// The next tracking or learning: whether it is over.
    fn next(&self, cx: &Context) -> impl Fn() -> bool + use<> {
        let serial = self.serial.get() + 1;
        self.serial.set(serial);
        let (own, newest) = (cx.clone(), Rc::clone(&self.serial));
        move || newest.get() != serial || own.is_stopping()
    }

    /// Takes the arm and follows from now on.
    async fn start(&mut self, cx: &Context) -> Result<(), HandlerError> {
        let arm = Manipulator::find(cx, &self.args.mcs).await?;
        let recipes = arm.guards().await?.recipes;
        for (key, names) in [
            ("overload", &self.args.overload),
            ("again_after", &self.args.again_after),
        ] {
            let known = |name: &&String| !recipes.iter().any(|recipe| recipe.name == **name);
            if let Some(name) = names.iter().find(known) {
                let text = format!(
                    "`{key}` names the guard `{name}`, which the arm has not: add it, or leave the name out"
                );
                return Err(HandlerError::new(text));
            }
        }
        arm.acquire().await?;
        let begun = self.begin(cx).await;
        if begun.is_err() {
            if let Err(error) = arm.release().await {
                tracing::warn!("the arm is not given back: {error}");
            }
            // The next beginning finds buffers without a writer.
            self.cyclic = None;
            let mut shared = self.shared.borrow_mut();
            shared.period = None;
            shared.report.phase = control::Phase::Idle;
        }
        begun
    }

    /// Follows from now on with an arm that is held.
    async fn begin(&mut self, cx: &Context) -> Result<(), HandlerError> {
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
        self.follow(cx).await
    }

    /// Has the arm that is held follow, and sees to it.
    async fn follow(&self, cx: &Context) -> Result<(), HandlerError> {
        if self.shared.borrow().period.is_none() {
            return Err("nothing is tracked".into());
        }
        let watch = Watch::new(cx, &self.args, Rc::clone(&self.shared), self.next(cx));
        watch.again().await?;
        cx.spawn(async move { watch.watch().await });
        Ok(())
    }

    /// Has an arm follow that was stopped, unless something presses on it still.
    async fn resume(&self, cx: &Context) -> Result<(), HandlerError> {
        let felt = match &self.shared.borrow().period {
            Some(period) => period.felt(),
            None => 0.0,
        };
        if felt.is_nan() || felt >= self.args.resume_below_n {
            let most = self.args.resume_below_n;
            let text = format!("the wrist feels {felt:.1} N, and less than {most} N is needed");
            return Err(HandlerError::new(text));
        }
        self.follow(cx).await
    }

    /// Comes to rest and gives the arm back.
    async fn stop(&mut self, cx: &Context) -> Result<(), HandlerError> {
        self.serial.set(self.serial.get() + 1);
        let arm = Manipulator::find(cx, &self.args.mcs).await?;
        if self.learns.get() {
            // Who learns gives the arm back.
            arm.cancel().await?;
            while self.learns.get() {
                cx.sleep(LOOK).await;
            }
            return Ok(());
        }
        let released = arm.release().await;
        self.cyclic = None;
        let mut shared = self.shared.borrow_mut();
        let period = shared.period.take();
        self.rested = period.and_then(|period| period.grasp(seconds(cx.now())));
        shared.report.phase = control::Phase::Idle;
        released?;
        Ok(())
    }

    /// Takes the arm, and learns the map from now on.
    async fn learn(&self, cx: &Context) -> Result<(), HandlerError> {
        let arm = Manipulator::find(cx, &self.args.mcs).await?;
        arm.acquire().await?;
        let (cx, args, is_over) = (cx.clone(), self.args.clone(), self.next(cx));
        let (shared, learns) = (Rc::clone(&self.shared), Rc::clone(&self.learns));
        learns.set(true);
        shared.borrow_mut().report.learning = Learning::Underway;
        cx.clone().spawn(async move {
            let learner = Learner {
                cx: &cx,
                args: args.learn,
                mover: Mover {
                    arm: &arm,
                    is_over: &is_over,
                    path: PathKind::Joint,
                    speed: args.learn.speed,
                },
                client: &args.client,
            };
            let learned = learner.learn().await;
            // Whatever was seen, the arm is given back.
            let released = arm.release().await.map_err(HandlerError::from);
            let learned = learned.and_then(|learned| released.map(|_| learned));
            if let Err(error) = &learned {
                tracing::warn!("the map is not learned: {error}");
            }
            let learned = learned.unwrap_or_else(|error| Learning::Failed(error.to_string()));
            shared.borrow_mut().report.learning = learned;
            learns.set(false);
            if let Err(error) = ask(&cx, &args.net, "learned").await {
                tracing::warn!("the net is not told that learning has ended: {error}");
            }
        });
        Ok(())
    }

    /// The hand, if there is one.
    fn hand(&self) -> Result<&GraspArgs, HandlerError> {
        let none = "there is no hand: `grasp` is not among the arguments of druide";
        self.args.grasp.as_ref().ok_or_else(|| none.into())
    }

    /// Lets go of what the hand holds, and gives the arm back.
    async fn let_go(&self, cx: &Context) -> Result<(), HandlerError> {
        let arm = Manipulator::find(cx, &self.args.mcs).await?;
        let holder = arm.status().await?.holder;
        if let Some(holder) = holder.filter(|holder| holder != cx.name()) {
            return Err(format!("`{holder}` holds the arm, and what its hand holds").into());
        }
        let_go(cx, self.hand()?).await?;
        if let Err(error) = arm.release().await {
            tracing::warn!("the arm is not given back: {error}");
        }
        Ok(())
    }

    /// Takes the arm, and grasps the ball from now on.
    async fn grasp(&mut self, cx: &Context) -> Result<(), HandlerError> {
        let args = self.hand()?.clone();
        let base_t_ball = self.rested.take();
        let base_t_ball = base_t_ball.ok_or("nobody knows where the ball rests")?;
        let arm = Manipulator::find(cx, &self.args.mcs).await?;
        arm.acquire().await?;
        let (cx, net, is_over) = (cx.clone(), self.args.net.clone(), self.next(cx));
        let (shared, learns) = (Rc::clone(&self.shared), Rc::clone(&self.learns));
        learns.set(true);
        shared.borrow_mut().report.grasped = None;
        cx.clone().spawn(async move {
            let grasper = Grasper {
                cx: &cx,
                args: &args,
                mover: Mover {
                    arm: &arm,
                    is_over: &is_over,
                    path: PathKind::StraightLine,
                    speed: args.speed,
                },
            };
            let grasped = grasper.grasp(&base_t_ball).await;
            let holds = matches!(grasped, Grasped::Holds { .. });
            match &grasped {
                Grasped::Holds { .. } => tracing::info!("the ball is held"),
                Grasped::Missed(why) => tracing::warn!("the ball is not grasped: {why}"),
                Grasped::Slipped(why) => tracing::warn!("the ball has slipped away: {why}"),
                Grasped::BrokenOff(why) => tracing::warn!("grasping is broken off: {why}"),
            }
            // Who holds the ball holds the arm, unless it was stopped.
            if (!holds || is_over())
                && let Err(error) = arm.release().await
            {
                tracing::warn!("the arm is not given back: {error}");
            }
            let symbol = grasped.symbol();
            shared.borrow_mut().report.grasped = Some(grasped);
            learns.set(false);
            if let Err(error) = ask(&cx, &net, symbol).await {
                tracing::warn!("the net is not told how grasping has ended: {error}");
            }
        });
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
        let here = |ns| Some(seconds(clocks.correct(Instant::from_nanos(ns))?.at));
        let times = here(seen.stamp_ns).zip(here(seen.received_ns));
        let placed =
            times.is_some_and(|(at, received)| period.take(now, [at, received], &seen.relative));
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
            ResumeTracking::CODE => {
                let (ResumeTracking {}, reply) = message.open::<ResumeTracking>()?;
                match self.resume(cx).await {
                    Ok(()) => reply.ok(()),
                    Err(error) => reply.fail(error.to_string()),
                }
            }
            StartGrasp::CODE => {
                let (StartGrasp {}, reply) = message.open::<StartGrasp>()?;
                match self.grasp(cx).await {
                    Ok(()) => reply.ok(()),
                    Err(error) => reply.fail(error.to_string()),
                }
            }
            LetGo::CODE => {
                let (LetGo {}, reply) = message.open::<LetGo>()?;
                match self.let_go(cx).await {
                    Ok(()) => reply.ok(()),
                    Err(error) => reply.fail(error.to_string()),
                }
            }
            StartLearning::CODE => {
                let (StartLearning {}, reply) = message.open::<StartLearning>()?;
                match self.learn(cx).await {
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
