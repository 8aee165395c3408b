//! For tests: the nets of a task in virtual time between stand-ins for an arm and what else the task needs. They fail on demand:
//! at every request, one after the other, in every way; and the processes around them may be killed.

use std::{
    path::{Path, PathBuf},
    sync::{Arc, Mutex, MutexGuard, PoisonError},
    time::Duration,
};

use crate::{
    dom::DomStore,
    strategy::shown::{CHOICES, Choices},
};
use ctos::{
    boot::{self, End, Fault as Event},
    config,
    message::{Command, CommandInfo, Message},
    registry::Registry,
    system::AppResult,
    task::{Context, EventHandler, Handled, Phase},
};
use mcs::{
    Joints,
    client::{
        Acquire, Cancel, MotionError, Move, MoveReport, Outcome as Motion, Plan, PlanReport,
        Position, ReadPosition, Release, Status, StatusReport,
    },
    servo::MotionPhase,
    state::State,
};
use nalgebra::{Isometry3, Matrix4};
use pnt::task::{FiringEvent, Marking, PutOnce, RequestId, put_once};

/// What goes wrong at one request.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Fault {
    /// It is not done, for this reason.
    Meets(Motion),
    /// It is done, and the answer is lost.
    AnswerLost,
    /// What the hand holds falls out of it before it is done.
    Slips,
}

/// Every way in which MCS may refuse a request, and a lost answer.
pub(crate) const FAULTS: [Fault; 8] = [
    Fault::Meets(Motion::Unreachable),
    Fault::Meets(Motion::Stopped),
    Fault::Meets(Motion::Estopped),
    Fault::Meets(Motion::Guard),
    Fault::Meets(Motion::Fault),
    Fault::Meets(Motion::Lost),
    Fault::Meets(Motion::Refused),
    Fault::AnswerLost,
];

/// The faults to try at one request: one or some after the other in the short run, every one with `CTOS_FAULTS=all`.
pub(crate) fn faults_at(number: usize, count: usize) -> impl Iterator<Item = Fault> {
    let all = std::env::var("CTOS_FAULTS").is_ok();
    let count = if all { FAULTS.len() } else { count };
    let faults = FAULTS.into_iter().cycle();
    faults.skip(number % FAULTS.len()).take(count)
}

/// What is kept of every run.
#[derive(Default)]
pub(crate) struct Bench {
    pub reserved: bool,
    pub estopped: bool,
    /// Looks at a protective stop until somebody ends it.
    pub stopped: u32,
    /// Requests so far, and at which of them what goes wrong.
    pub asked: Vec<String>,
    pub faults: Vec<(usize, Fault)>,
    /// Requests of these names go wrong from such a number on, each time.
    pub refuses: Option<(usize, Vec<&'static str>, Fault)>,
    /// How often what was under way was taken back.
    taken_back: u64,
    /// The answers to the commands, and the Dispatcher's marking after them.
    pub answers: Vec<(String, String)>,
    pub marking: Vec<(String, u32)>,
    /// What people see of choices at the end.
    pub choices: Choices,
    /// The latest firings of all nets by their tasks.
    pub firings: Vec<(String, FiringEvent)>,
}

impl Bench {
    pub(crate) fn new(faults: &[(usize, Fault)]) -> Self {
        Self {
            faults: faults.to_vec(),
            ..Self::default()
        }
    }

    /// Tokens of a place of the Dispatcher at the end.
    pub(crate) fn tokens(&self, place: &str) -> u32 {
        let mut places = self.marking.iter();
        let found = places.find(|(name, _)| name == place);
        found.map_or(0, |(_, tokens)| *tokens)
    }

    /// Notes a request; what goes wrong with it.
    fn meets(&mut self, request: &str) -> Option<Fault> {
        let number = self.asked.len();
        self.asked.push(request.to_owned());
        let once = self.faults.iter().find(|(at, _)| *at == number);
        let always = self.refuses.as_ref();
        let always = always.filter(|(from, names, _)| number >= *from && names.contains(&request));
        let always = always.map(|(.., fault)| *fault);
        let fault = once.map(|(_, fault)| *fault).or(always)?;
        match fault {
            Fault::Meets(Motion::Estopped) => self.estopped = true,
            Fault::Meets(Motion::Stopped) => self.stopped = 3,
            _ => {}
        }
        Some(fault)
    }

    /// Why nothing moves, if that is so.
    fn is_ready(&self) -> Result<(), MotionError> {
        let refused = |outcome, text: &str| Err(MotionError::new(outcome, text));
        if self.estopped {
            return refused(Motion::Estopped, "an emergency stop holds");
        }
        if self.stopped > 0 {
            return refused(Motion::Stopped, "a protective stop holds");
        }
        if !self.reserved {
            return refused(Motion::Refused, "the arm is not reserved");
        }
        Ok(())
    }
}

/// What the stand-ins share: where everything is, and how the arm moves it.
pub(crate) trait World: Default + Send + 'static {
    /// The commands that are taken besides those of an arm.
    const MORE: &'static [CommandInfo] = &[];

    fn bench(&mut self) -> &mut Bench;

    /// What a fault, or none, at a request does to the world.
    fn strikes(&mut self, _request: &str, _fault: Option<Fault>) {}

    /// How long a request takes.
    fn takes(&self, _request: &str) -> Duration {
        Duration::ZERO
    }

    /// The joints at the end of a plan.
    fn plans(&mut self, plan: &Plan) -> Result<Joints, MotionError>;

    /// Moves the arm, which is reserved and not stopped.
    fn goes(&mut self, order: &Move) -> Result<(), MotionError>;

    /// A motion is taken back while it is under way.
    fn is_broken_off(&mut self, _order: &Move) {}

    fn joints(&self) -> Joints {
        Joints::zeros(6)
    }

    /// `base_t_tool`.
    fn tool(&self) -> Isometry3<f64> {
        Isometry3::identity()
    }

    /// A command was answered.
    fn is_answered(&mut self) {}

    /// The arm is given back.
    fn is_released(&mut self) {}

    /// Takes one of [`Self::MORE`].
    fn more(_stand_in: &StandIn<Self>, cx: &Context, message: Message) -> Handled {
        cx.default_processing(message)
    }
}

pub(crate) type Shared<W> = Arc<Mutex<W>>;

pub(crate) fn lock<W>(world: &Mutex<W>) -> MutexGuard<'_, W> {
    world.lock().unwrap_or_else(PoisonError::into_inner)
}

/// A pose as requests have it.
pub(crate) fn pose(rows: &[f64; 16]) -> Isometry3<f64> {
    nalgebra::try_convert(Matrix4::from_row_slice(rows)).unwrap()
}

/// The client interface of the arm, and everything else.
pub(crate) struct StandIn<W>(pub Shared<W>);

impl<W: World> StandIn<W> {
    /// Notes a request; what goes wrong with it, and how long it takes.
    pub(crate) fn meets(&self, request: &str) -> (Option<Fault>, Duration) {
        let mut world = lock(&self.0);
        let fault = world.bench().meets(request);
        world.strikes(request, fault);
        (fault, world.takes(request))
    }

    /// Answers a request whose answer may be an error, unless something goes wrong with it.
    pub(crate) fn typed<C, T>(
        &self,
        cx: &Context,
        message: Message,
        act: impl FnOnce(&mut W, C) -> Result<T, MotionError> + 'static,
    ) -> Handled
    where
        C: Command<Reply = Result<T, MotionError>> + 'static,
        T: 'static,
    {
        let (request, reply) = message.open::<C>()?;
        let (fault, takes) = self.meets(C::NAME);
        let error = |outcome, text: String| Err(MotionError::new(outcome, text));
        match fault {
            Some(Fault::Meets(Motion::Lost)) => reply.fail("it is broken"),
            Some(Fault::Meets(outcome)) => {
                reply.ok(error(outcome, format!("{outcome:?} on purpose")))
            }
            fault => {
                let shared = self.0.clone();
                after(cx, takes, move || {
                    let answer = act(&mut lock(&shared), request);
                    match fault {
                        Some(Fault::AnswerLost) => {
                            let text = "the answer is lost on purpose".to_owned();
                            reply.ok(error(Motion::Lost, text))
                        }
                        _ => reply.ok(answer),
                    }
                })
            }
        }
    }

    /// The same of a request whose answer is no error.
    pub(crate) fn plain<C: Command>(
        &self,
        message: Message,
        act: impl FnOnce(&mut W, C) -> C::Reply,
    ) -> Handled {
        let (request, reply) = message.open::<C>()?;
        match self.meets(C::NAME).0 {
            Some(Fault::Meets(_)) => reply.fail("it is broken"),
            fault => {
                let answer = act(&mut lock(&self.0), request);
                match fault {
                    Some(Fault::AnswerLost) => reply.fail("the answer is lost on purpose"),
                    _ => reply.ok(answer),
                }
            }
        }
    }
}

/// Does something after so long, or at once.
fn after(cx: &Context, takes: Duration, act: impl FnOnce() -> Handled + 'static) -> Handled {
    if takes.is_zero() {
        return act();
    }
    let child = cx.clone();
    cx.spawn(async move {
        child.sleep(takes).await;
        // Answering never fails; its result exists to end a handler with.
        let _ = act();
    });
    Ok(())
}

impl<W: World> EventHandler for StandIn<W> {
    async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
        match message.command() {
            Acquire::CODE => self.typed::<Acquire, _>(cx, message, |world, _| {
                let bench = world.bench();
                if bench.estopped {
                    let text = "an emergency stop holds";
                    return Err(MotionError::new(Motion::Estopped, text));
                }
                // Whoever had it is gone: the arm comes to rest.
                bench.taken_back += 1;
                bench.reserved = true;
                Ok(State::Motion)
            }),
            Release::CODE => self.typed::<Release, _>(cx, message, |world, _| {
                world.is_released();
                world.bench().reserved = false;
                Ok(State::Cold)
            }),
            Plan::CODE => self.typed::<Plan, _>(cx, message, |world, plan| {
                Ok(PlanReport {
                    joints: world.plans(&plan)?,
                    duration_s: 1.0,
                    smallest_singular_value: None,
                })
            }),
            Move::CODE => {
                let before = lock(&self.0).bench().taken_back;
                self.typed::<Move, _>(cx, message, move |world, order| {
                    if world.bench().taken_back != before {
                        world.is_broken_off(&order);
                        return Err(MotionError::new(Motion::Stopped, "it was taken back"));
                    }
                    world.bench().is_ready()?;
                    world.goes(&order)?;
                    Ok(MoveReport {
                        duration_s: 1.0,
                        max_tracking_error_rad: 0.0,
                        max_tracking_error_m: 0.0,
                        final_error_rad: 0.0,
                        final_error_m: 0.0,
                        joints: world.joints(),
                        smallest_singular_value: None,
                    })
                })
            }
            ReadPosition::CODE => self.plain::<ReadPosition>(message, |world, _| {
                let matrix = world.tool().to_homogeneous().transpose();
                let mut base_t_tool = [0.0; 16];
                base_t_tool.copy_from_slice(matrix.as_slice());
                Position {
                    joints: world.joints(),
                    base_t_tool,
                    commanded: world.joints(),
                    base_t_commanded: base_t_tool,
                    at_rest: true,
                }
            }),
            Status::CODE => {
                let (Status {}, reply) = message.open::<Status>()?;
                let mut world = lock(&self.0);
                let bench = world.bench();
                bench.stopped = bench.stopped.saturating_sub(1);
                reply.ok(StatusReport {
                    state: State::Motion,
                    holder: bench.reserved.then(|| "coordinator".to_owned()),
                    fault: None,
                    stopped: bench.stopped > 0,
                    motion: MotionPhase::None,
                    ticks: 0,
                    missed: 0,
                })
            }
            Cancel::CODE => {
                lock(&self.0).bench().taken_back += 1;
                message.open::<Cancel>()?.1.ok(())
            }
            _ => W::more(self, cx, message),
        }
    }
}

/// Puts commands on the Dispatcher's tape, one after the other, and looks at the nets at the end.
struct Operator<W> {
    world: Shared<W>,
    /// Symbols with their arguments.
    commands: Vec<Vec<String>>,
}

impl<W: World> EventHandler for Operator<W> {
    async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
        cx.default_processing(message)
    }

    async fn phase(&mut self, cx: &Context, phase: Phase) -> Handled {
        if phase == Phase::Run {
            let (child, world, commands) = (cx.clone(), self.world.clone(), self.commands.clone());
            cx.spawn(async move {
                let operated = operate(&child, &world, commands).await;
                child.finish(AppResult {
                    ok: operated.is_ok(),
                    text: operated
                        .err()
                        .map_or_else(String::new, |error| error.to_string()),
                    json: String::new(),
                });
            });
        }
        Ok(())
    }
}

async fn operate<W: World>(cx: &Context, world: &Shared<W>, commands: Vec<Vec<String>>) -> Handled {
    for (number, words) in (1..).zip(commands) {
        let mut words = words.into_iter();
        let put = PutOnce {
            request: RequestId {
                from: cx.name().to_owned(),
                number,
            },
            symbol: words.next().unwrap_or_default(),
            arguments: words.collect(),
        };
        let answer = put_once(cx, "dispatcher", &put, Duration::from_secs(100_000)).await?;
        let answer = (answer.symbol, answer.text);
        let mut world = lock(world);
        world.bench().answers.push(answer);
        world.is_answered();
    }
    // The last tokens may still be on their way, and a process that was killed comes back.
    cx.sleep(Duration::from_secs(5)).await;
    let choices = DomStore::new("dom").fetch(cx, CHOICES).await;
    lock(world).bench().choices = choices.unwrap_or_default();
    let nets = cx.app().tasks.iter();
    let nets = nets.filter(|task| task.args.get("net").is_some());
    let nets: Vec<String> = nets.map(|task| task.name.clone()).collect();
    for name in nets {
        let net = cx.wait_for_task(&name, Duration::from_secs(60)).await?;
        let snapshot = cx.call(&net, Marking {}).await?;
        let mut world = lock(world);
        let bench = world.bench();
        if name == "dispatcher" {
            bench.marking = snapshot.places;
        }
        let firings = snapshot.events.into_iter();
        bench
            .firings
            .extend(firings.map(|event| (name.clone(), event)));
    }
    Ok(())
}

/// The folder of the configurations that are delivered.
pub(crate) fn configs() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../configs")
}

/// The app of a task: its nets in one process, and their stand-ins, of the handler `test.arm`, in another.
pub(crate) fn app(tasks: &str, stand_ins: &[&str]) -> String {
    let mut text =
        "[app]\nname = \"test\"\nuntil = \"operator\"\n[time]\nmode = \"virtual\"\n[chassis.ws1]\n\
        [chassis.cage]\n[task.operator]\nhandler = \"test.operator\"\non = \"ws1\"\n[task.dom]\n\
        handler = \"coordinators.dom\"\non = \"ws1\"\n"
            .to_owned();
    text += tasks;
    for name in stand_ins {
        text += &format!("[task.{name}]\nhandler = \"test.arm\"\non = \"cage\"\n");
    }
    text
}

/// An app with a task of the Organization Level in place of the operator, which has one command done.
pub(crate) fn planned(app: &str, command: &str, plans: &str) -> String {
    let mut words = command.split_whitespace();
    let command = words.next().unwrap_or_default();
    let arguments: Vec<&str> = words.collect();
    let planner = format!(
        "handler = \"coordinators.planner\"\non = \"ws1\"\n[task.operator.args]\n\
         command = \"{command}\"\narguments = {arguments:?}\nsend_within_s = 5\nplans = [{plans}]\n"
    );
    app.replace("handler = \"test.operator\"\non = \"ws1\"\n", &planner)
}

/// What such an app ends with.
pub(crate) fn run_planned<W: World>(world: W, app: &str) -> (W, AppResult) {
    let sets: &[String] = &[];
    match end(world, (app, sets), &[], &[]) {
        (world, End::Finished(result)) => (world, result),
        (_, other) => panic!("{other:?}"),
    }
}

/// The answer, and the kinds of what was in the way.
pub(crate) fn kinds(result: &AppResult) -> (String, Vec<String>) {
    let json: serde_json::Value = serde_json::from_str(&result.json).unwrap();
    let failures = json["failures"].as_array().unwrap().iter();
    let kinds = failures.map(|failure| failure["kind"].as_str().unwrap().to_owned());
    (json["answer"].as_str().unwrap().to_owned(), kinds.collect())
}

/// Runs an app until its commands are answered; what is left of the world then.
pub(crate) fn run<W: World>(world: W, app: &str, commands: &[&str]) -> W {
    let sets: &[String] = &[];
    run_with(world, (app, sets), commands, &[])
}

/// The same with settings as `--set` takes them, and with faults of the processes.
pub(crate) fn run_with<W: World>(
    world: W,
    (app, sets): (&str, &[String]),
    commands: &[&str],
    events: &[Event],
) -> W {
    let (world, end) = self::end(world, (app, sets), commands, events);
    assert!(
        matches!(&end, End::Finished(result) if result.ok),
        "{end:?}"
    );
    world
}

/// Apps with their settings that are known to be sound: that takes as long as a run, and no seed changes it.
static SOUND: Mutex<Vec<(String, Vec<String>)>> = Mutex::new(Vec::new());

/// The same, with how it ended.
pub(crate) fn end<W: World>(
    world: W,
    (app, sets): (&str, &[String]),
    commands: &[&str],
    events: &[Event],
) -> (W, End) {
    let world = Arc::new(Mutex::new(world));
    let mut registry = Registry::new();
    crate::register(&mut registry);
    let takes = [
        Acquire::INFO,
        Release::INFO,
        Plan::INFO,
        Move::INFO,
        ReadPosition::INFO,
        Status::INFO,
        Cancel::INFO,
    ];
    let takes: Vec<CommandInfo> = takes.iter().chain(W::MORE).copied().collect();
    let shared = world.clone();
    registry.handler("test.arm", &takes, move |_| Ok(StandIn(shared.clone())));
    let words = |line: &&str| line.split_whitespace().map(ToOwned::to_owned).collect();
    let commands: Vec<Vec<String>> = commands.iter().map(words).collect();
    let shared = world.clone();
    registry.handler("test.operator", &[], move |_| {
        Ok(Operator {
            world: shared.clone(),
            commands: commands.clone(),
        })
    });
    let unseeded = sets.iter().filter(|set| !set.starts_with("app.seed="));
    let key = (app.to_owned(), unseeded.cloned().collect::<Vec<_>>());
    let app = config::load_texts(&[("app.toml", app)], sets, &[]);
    let app = app.unwrap_or_else(|found| panic!("{found}"));
    if !lock(&SOUND).contains(&key) {
        let findings = registry.check(&app);
        assert!(!findings.has_errors(), "{findings}");
        lock(&SOUND).push(key);
    }
    let observer: boot::Observer = Arc::new(|_| {});
    let end = boot::simulate(app, registry, events, &observer)
        .unwrap()
        .end;
    (std::mem::take(&mut *lock(&world)), end)
}
