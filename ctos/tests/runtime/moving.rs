//! A running task is moved about while many send to it. Nothing is lost, doubled or reordered, in
//! virtual time under many seeds. A move that fails leaves nothing behind.

use std::{
    collections::{BTreeMap, VecDeque},
    future::{Future, IntoFuture, poll_fn},
    pin::Pin,
    sync::{Arc, Mutex},
    task::Poll,
    time::Duration,
};

use ctos::{
    boot::{BootEvent, End, Observer, Outcome, simulate},
    call::{CallError, Fault},
    config::load_texts,
    message::{Command, CommandInfo, Message, Replier},
    registry::Registry,
    simulation,
    system::{AppResult, Shutdown},
    task::{Context, EventHandler, Handled, HandlerError, Handover, Phase, StopReason, TaskRef},
    time::Instant,
};
use futures_util::future::join_all;
use rand::RngExt;
use rand_chacha::{ChaCha8Rng, rand_core::SeedableRng};

ctos::command! {
    /// Is written down and answered with how many were written down before.
    pub struct Note { pub sender: u32, pub urgent: bool, pub number: u32 } => u32, 1, "note"
}
ctos::command! {
    /// What was written down, in order.
    pub struct Log => Vec<(u32, bool, u32)>, 2, "log"
}
ctos::command! {
    /// Is answered at the next `note`.
    pub struct Keep => (), 3, "keep"
}
ctos::command! {
    /// Sends so many notes of both priorities, several at a time, and answers with those that were
    /// taken.
    pub struct Play { pub count: u32, pub breaks: bool } => Vec<(bool, u32)>, 4, "play"
}
ctos::command! {
    /// Moves a task about so many times.
    pub struct Wander { pub task: String, pub times: u32 } => Vec<String>, 5, "wander"
}

ctos::command! {
    /// Asks the sink for its log.
    pub struct AskLog => Vec<(u32, bool, u32)>, 6, "ask_log"
}

/// What the handlers did, seen from outside: task, what.
type Trace = Arc<Mutex<Vec<String>>>;

/// Writes notes down; slowly, so that its queue fills.
struct Sink {
    log: Vec<(u32, bool, u32)>,
    kept: Vec<Replier<Keep>>,
    trace: Trace,
}

impl EventHandler for Sink {
    async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
        match message.command() {
            Note::CODE => {
                let (note, reply) = message.open::<Note>()?;
                self.kept.clear();
                let pause = cx.rng(&format!("{}", self.log.len())).random_range(0..300);
                if pause > 100 {
                    cx.sleep(Duration::from_micros(pause)).await;
                }
                let before = u32::try_from(self.log.len())?;
                self.log.push((note.sender, note.urgent, note.number));
                reply.ok(before)
            }
            Log::CODE => {
                let (Log {}, reply) = message.open::<Log>()?;
                reply.ok(self.log.clone())
            }
            Keep::CODE => {
                let (Keep {}, reply) = message.open::<Keep>()?;
                self.kept.push(reply);
                Ok(())
            }
            _ => cx.default_processing(message),
        }
    }

    async fn phase(&mut self, cx: &Context, phase: Phase) -> Handled {
        let line = format!("{} enters {phase} on {}", cx.name(), cx.chassis().name());
        self.trace.lock().unwrap().push(line);
        Ok(())
    }

    async fn stop(&mut self, cx: &Context, _: &StopReason) -> Handled {
        let line = format!("{} stops on {}", cx.name(), cx.chassis().name());
        self.trace.lock().unwrap().push(line);
        Ok(())
    }
}

impl Handover for Sink {
    type State = Vec<(u32, bool, u32)>;

    fn hand_over(&mut self) -> Result<Self::State, HandlerError> {
        if self.kept.is_empty() {
            Ok(std::mem::take(&mut self.log))
        } else {
            Err("somebody waits for a reply".into())
        }
    }

    fn take_over(&mut self, _: &Context, state: Self::State) -> Handled {
        self.log = state;
        Ok(())
    }
}

type Sending = Pin<Box<dyn Future<Output = Result<(), CallError>>>>;

/// Sends one note; it is on its way when this returns.
async fn begin(cx: &Context, to: &TaskRef, note: Note, by_call: bool) -> Sending {
    let urgent = note.urgent;
    let deadline = Duration::from_secs(300);
    let mut sending: Sending = if by_call {
        let call = cx.call(to, note).deadline(deadline);
        let call = if urgent { call.high_priority() } else { call };
        Box::pin(async move { call.await.map(|_| ()) })
    } else {
        let send = cx.send(to, note).deadline(deadline);
        let send = if urgent { send.high_priority() } else { send };
        Box::pin(send.into_future())
    };
    match poll_fn(|cx| Poll::Ready(sending.as_mut().poll(cx))).await {
        Poll::Ready(done) => Box::pin(std::future::ready(done)),
        Poll::Pending => sending,
    }
}

struct Player(u32);

impl EventHandler for Player {
    async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
        match message.command() {
            Play::CODE => {
                let (Play { count, breaks }, reply) = message.open::<Play>()?;
                let sink = cx.task("sink").await?;
                let mut rng = cx.rng("play");
                let mut numbers = BTreeMap::from([(false, 0), (true, 0)]);
                let mut taken = Vec::new();
                let mut under_way: VecDeque<(bool, u32, Sending)> = VecDeque::new();
                while numbers.values().sum::<u32>() < count || !under_way.is_empty() {
                    if numbers.values().sum::<u32>() < count && under_way.len() < WINDOW {
                        let urgent = rng.random_bool(0.3);
                        let number = numbers.entry(urgent).or_default();
                        *number += 1;
                        let note = Note {
                            sender: self.0,
                            urgent,
                            number: *number,
                        };
                        let by_call = rng.random_bool(0.5);
                        let sent = begin(cx, &sink, note, by_call).await;
                        under_way.push_back((urgent, *number, sent));
                        cx.sleep(Duration::from_micros(rng.random_range(0..120)))
                            .await;
                    } else if let Some((urgent, number, sent)) = under_way.pop_front() {
                        match sent.await {
                            Ok(()) => taken.push((urgent, number)),
                            // A clear word of its own, and then it must not arrive.
                            Err(error) if matches!(error.fault, Fault::Full { .. }) => {}
                            Err(error) if breaks && error.is_gone() => {}
                            Err(error) => return Err(error.into()),
                        }
                    }
                }
                reply.ok(taken)
            }
            AskLog::CODE => {
                let (AskLog {}, reply) = message.open::<AskLog>()?;
                let sink = cx.task("sink").await?;
                reply.ok(cx.call(&sink, Log {}).await?)
            }
            Wander::CODE => {
                let (Wander { task, times }, reply) = message.open::<Wander>()?;
                let mut rng = cx.rng("wander");
                let mut places = Vec::new();
                for _ in 0..times {
                    cx.sleep(Duration::from_micros(rng.random_range(0..2_000)))
                        .await;
                    let chassis = ["a", "b", "c"][rng.random_range(0..3)];
                    let processor = ["main", "second"][rng.random_range(0..2)];
                    let place = format!("{chassis}:{processor}");
                    match cx.move_task(&task, &place).await {
                        Ok(now) => assert_eq!(now, place),
                        Err(error)
                            if error.to_string().contains("`c`")
                                || error.to_string().contains("`a`") =>
                        {
                            places.push(format!("stayed: {error}"));
                        }
                        Err(error) => return Err(error.into()),
                    }
                    places.push(place);
                }
                reply.ok(places)
            }
            _ => cx.default_processing(message),
        }
    }
}

/// Runs a scene and ends the app with what it says.
struct Driver {
    scene: Scene,
}

type Scene = Arc<
    dyn Fn(Context) -> Pin<Box<dyn Future<Output = Result<String, HandlerError>>>> + Send + Sync,
>;

impl EventHandler for Driver {
    async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
        cx.default_processing(message)
    }

    async fn phase(&mut self, cx: &Context, phase: Phase) -> Handled {
        if phase == Phase::Run {
            let (scene, here) = (self.scene.clone(), cx.clone());
            cx.spawn(async move {
                let said = scene(here.clone()).await;
                here.finish(AppResult {
                    ok: said.is_ok(),
                    text: said.unwrap_or_else(|error| error.to_string()),
                    json: String::new(),
                });
            });
        }
        Ok(())
    }
}

const SENDERS: u32 = 5;
/// How many notes of one sender are on their way at most.
const WINDOW: usize = 10;

fn text(seed: u64) -> String {
    let mut text = format!(
        r#"
        [app]
        seed = {seed}
        until = "driver"
        phase_timeout_s = 2.0
        "#
    );
    for chassis in ["a", "b", "c"] {
        text.push_str(&format!(
            "[chassis.{chassis}]\nprocessors.main = {{}}\nprocessors.second = {{}}\n"
        ));
    }
    let mut task = |name: &str, handler: &str, on: &str| {
        text.push_str(&format!(
            "[task.{name}]\nhandler = \"{handler}\"\non = \"{on}\"\nqueue = 4\ncall_deadline_s = 600.0\n"
        ));
    };
    task("driver", "driver", "a");
    task("mover", "player", "b");
    task("sink", "sink", "a/second");
    task("fixed", "player", "c");
    for (number, on) in (1..=SENDERS).zip(["a", "a/second", "b/second", "c", "c/second"]) {
        task(&format!("sender{number}"), "player", on);
    }
    text
}

fn registry(trace: &Trace, scene: Scene) -> Registry {
    let mut registry = Registry::new();
    registry.handler("driver", &[], move |_| {
        Ok(Driver {
            scene: scene.clone(),
        })
    });
    registry.handler(
        "player",
        &[Play::INFO, AskLog::INFO, Wander::INFO],
        |cx: &Context| {
            let number = cx.name().strip_prefix("sender");
            Ok(Player(number.map_or(Ok(0), str::parse)?))
        },
    );
    let commands: [CommandInfo; 3] = [Note::INFO, Log::INFO, Keep::INFO];
    let trace = trace.clone();
    registry.handover("sink", &commands, move |_| {
        Ok(Sink {
            log: Vec::new(),
            kept: Vec::new(),
            trace: trace.clone(),
        })
    });
    registry
}

fn run<F, Fut>(seed: u64, faults: &[simulation::Fault], scene: F) -> (Outcome, Vec<String>)
where
    F: Fn(Context) -> Fut + Send + Sync + 'static,
    Fut: Future<Output = Result<String, HandlerError>> + 'static,
{
    let trace = Trace::default();
    let app = load_texts(&[("moving.toml", &text(seed))], &[], &[]).unwrap();
    let observer: Observer = Arc::new(|_: &BootEvent| ());
    let scene: Scene = Arc::new(move |cx| Box::pin(scene(cx)));
    let outcome = simulate(app, registry(&trace, scene), faults, &observer).unwrap();
    let trace = trace.lock().unwrap().clone();
    (outcome, trace)
}

#[track_caller]
fn finished(outcome: &Outcome, seed: u64) -> &str {
    match &outcome.end {
        End::Finished(result) if result.ok => &result.text,
        end => panic!("seed {seed}: {end:?}"),
    }
}

/// `senders` send, and the sink is moved about meanwhile. Where links break, what was not taken may
/// have arrived, and some moves fail.
async fn storm(
    cx: Context,
    senders: Vec<u32>,
    count: u32,
    moves: u32,
    breaks: bool,
) -> Result<String, HandlerError> {
    let limit = Duration::from_secs(600);
    let mover = cx.task("mover").await?;
    let wander = Wander {
        task: "sink".to_owned(),
        times: moves,
    };
    let wandering = cx.call(&mover, wander).deadline(limit);
    let mut players = Vec::new();
    for number in &senders {
        let sender = cx.task(&format!("sender{number}")).await?;
        let play = Play { count, breaks };
        players.push(cx.call(&sender, play).deadline(limit).into_future());
    }
    let (places, taken) =
        futures_util::future::join(wandering.into_future(), join_all(players)).await;
    let places = places?.join(", ");
    let mut log = None;
    for asker in ["sender3", "sender1", "sender4"] {
        let asker = cx.task(asker).await?;
        if let Ok(found) = cx.call(&asker, AskLog {}).await {
            log = Some(found);
            break;
        }
    }
    let log = log.ok_or("nobody reaches the sink")?;
    for (number, taken) in senders.into_iter().zip(taken) {
        let taken = taken?;
        for urgent in [false, true] {
            let of_lane = |note: &&(u32, bool, u32)| (note.0, note.1) == (number, urgent);
            let sent: Vec<u32> = taken
                .iter()
                .filter(|note| note.0 == urgent)
                .map(|note| note.1)
                .collect();
            let mut arrived: Vec<u32> = log.iter().filter(of_lane).map(|note| note.2).collect();
            let ordered = arrived.windows(2).all(|pair| pair[0] < pair[1]);
            if breaks {
                arrived.retain(|number| sent.contains(number));
            }
            if !ordered || sent != arrived {
                let text = format!(
                    "sender {number}, urgent {urgent}: sent {sent:?}, arrived {arrived:?}; places {places}"
                );
                return Err(HandlerError::new(text));
            }
        }
    }
    Ok(places)
}

fn seeds(usual: u64) -> std::ops::Range<u64> {
    let wanted = std::env::var("CTOS_SEEDS").ok();
    0..wanted.and_then(|seeds| seeds.parse().ok()).unwrap_or(usual)
}

fn micros(micros: u64) -> Instant {
    Instant::START + Duration::from_micros(micros)
}

/// Links that stand still for a while, so that one way is much slower than another.
fn stalls(seed: u64) -> Vec<simulation::Fault> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut draw = || {
        let at = rng.random_range(0..30_000);
        let ends = [
            ("a", "b"),
            ("b", "c"),
            ("a", "c"),
            ("boot", "a"),
            ("boot", "b"),
        ];
        let (one, other) = ends[rng.random_range(0..ends.len())];
        simulation::Fault::between(
            one.to_owned(),
            other.to_owned(),
            simulation::FaultKind::Stall,
            micros(at),
        )
        .until(micros(at + rng.random_range(1_000..8_000)))
    };
    (0..6).map(|_| draw()).collect()
}

#[test]
fn a_task_that_is_moved_about_under_load_loses_doubles_and_reorders_nothing() {
    for seed in seeds(60) {
        let everybody: Vec<u32> = (1..=SENDERS).collect();
        let (outcome, trace) = run(seed, &stalls(seed), move |cx| {
            storm(cx, everybody.clone(), 60, 8, false)
        });
        finished(&outcome, seed);
        // It is stopped once, where it is.
        let stops = trace.iter().filter(|line| line.starts_with("sink stops"));
        assert_eq!(stops.count(), 1, "seed {seed}: {trace:#?}");
    }
}

#[test]
fn a_link_that_breaks_during_a_move_leaves_one_task_that_has_all_it_accepted() {
    let mut failed = 0;
    for seed in seeds(60) {
        // The sender, the mover and the boot still reach both ends.
        let cut = simulation::Fault::between(
            "a",
            "c",
            simulation::FaultKind::Cut,
            micros(1_000 + seed * 61 % 9_000),
        );
        let (outcome, trace) = run(seed, &[cut], |cx| storm(cx, vec![3], 80, 8, true));
        let text = finished(&outcome, seed);
        failed += u32::from(text.contains("stayed"));
        let stops = trace.iter().filter(|line| line.starts_with("sink stops"));
        assert_eq!(stops.count(), 1, "seed {seed}: {trace:#?}");
    }
    assert!(failed > 0, "the link broke during no move");
}

#[test]
fn a_chassis_that_dies_during_a_move_takes_the_task_with_it_only_if_it_had_it() {
    let (mut stayed, mut went) = (0, 0);
    for at in (2_000..4_000).step_by(50) {
        let kill = simulation::Fault::on("c", simulation::FaultKind::Kill, micros(at));
        let result: Arc<Mutex<Option<Result<String, CallError>>>> = Arc::default();
        let seen = result.clone();
        let (outcome, trace) = run(at, &[kill], move |cx| {
            let seen = seen.clone();
            async move {
                let moved = cx.move_task("sink", "c").await;
                *seen.lock().unwrap() = Some(moved);
                std::future::pending().await
            }
        });
        let gone = End::ChassisDown {
            chassis: "c".to_owned(),
        };
        assert_eq!(outcome.end, gone);
        let stops: Vec<&String> = trace
            .iter()
            .filter(|line| line.starts_with("sink stops"))
            .collect();
        match result.lock().unwrap().take() {
            Some(Ok(_)) => {
                went += 1;
                assert_eq!(stops.len(), 0, "at {at} us: {trace:#?}");
            }
            Some(Err(_)) => {
                stayed += 1;
                assert_eq!(stops, ["sink stops on a"], "at {at} us: {trace:#?}");
            }
            // The app was stopped before the answer came.
            None => assert!(stops.len() < 2, "at {at} us: {trace:#?}"),
        }
    }
    assert!(stayed > 0 && went > 0, "{stayed} stayed, {went} went");
}

#[test]
fn what_cannot_be_moved_stays_and_says_why() {
    let (outcome, _) = run(1, &[], |cx| async move {
        let sink = cx.task("sink").await?;
        let mut said = Vec::new();
        for (task, to) in [
            ("sing", "b"),
            ("sink", "d"),
            ("sink", "b:third"),
            ("fixed", "a"),
            ("tidsvr", "a"),
        ] {
            let error = cx.move_task(task, to).await.unwrap_err();
            said.push(error.reason());
        }
        let mut kept = Box::pin(cx.call(&sink, Keep {}).into_future());
        let begun = poll_fn(|cx| Poll::Ready(kept.as_mut().poll(cx))).await;
        assert!(begun.is_pending());
        said.push(cx.move_task("sink", "b").await.unwrap_err().reason());
        let note = Note {
            sender: 0,
            urgent: false,
            number: 1,
        };
        // It goes on where it is, with what it knows.
        assert_eq!(cx.call(&sink, note).await?, 0);
        assert_eq!(cx.task("sink").await?.tid(), sink.tid());
        // Where it is already is not a move.
        assert_eq!(cx.move_task("sink", "a:second").await?, "a:second");
        Ok(said.join("\n"))
    });
    let names = "driver, fixed, mover, sender1, sender2, sender3, sender4, sender5, sink";
    let expected = [
        format!("no task is called `sing`; there are: {names}"),
        "there is no chassis `d`; there are: a, b, c".to_owned(),
        "chassis `b` has no processor `third`; there are: b:main, b:second".to_owned(),
        "`fixed` stays where it is: its handler passes no state on; see `task::Handover`"
            .to_owned(),
        format!("no task is called `tidsvr`; there are: {names}"),
        "`sink` stays where it is: somebody waits for a reply".to_owned(),
    ];
    assert_eq!(finished(&outcome, 1), expected.join("\n"));
}

#[test]
fn a_reference_held_since_before_a_move_still_reaches_the_task() {
    let (outcome, trace) = run(1, &[], |cx| async move {
        let before = cx.task("sink").await?;
        for place in ["b", "c:second", "a", "a:second", "b"] {
            cx.move_task("sink", place).await?;
        }
        let note = Note {
            sender: 0,
            urgent: false,
            number: 1,
        };
        cx.call(&before, note).await?;
        cx.try_send(&before, Log {}).unwrap_err();
        let now = cx.task("sink").await?;
        assert_ne!(now.tid(), before.tid());
        // A task that is told to end ends where it is.
        cx.call(&before, Shutdown {}).await?;
        let gone = cx.task("sink").await.unwrap_err().to_string();
        assert!(gone.contains("no task is called `sink`"), "{gone}");
        Ok(String::new())
    });
    finished(&outcome, 1);
    let stops: Vec<&String> = trace
        .iter()
        .filter(|line| line.starts_with("sink stops"))
        .collect();
    assert_eq!(stops, ["sink stops on b"]);
}
