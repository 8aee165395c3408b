//! Whatever several clients ask at random, in whatever order, while some of them die and power is lost: the rules of the
//! state manager hold. `CTOS_STATE_SEEDS=1000` runs so many seeds; a failure names its seed, and `CTOS_STATE_SEED=7` runs
//! that one alone.

use std::collections::BTreeMap;
use std::sync::Mutex;

use ctos::call::Fault as CallFault;
use ctos::simulation::{self, Fault, FaultKind, Faults, Setup};
use ctos::time::Instant;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::*;
use crate::driver::{ChannelDriver, DriverError};
use crate::model::{Data, Model};

/// Who asks, each on a chassis of its own.
const CLIENTS: [&str; 3] = ["ann", "ben", "cid"];
/// How long a run is.
const LONG: Duration = Duration::from_secs(12);
/// Eight motions that wait are over by then, and any stop.
const ANSWERED: Duration = Duration::from_secs(20);

const RANDOM: &str = r#"
app.until = "clock"
time.mode = "virtual"
[chassis.cage]
stop_first = true
processors.servo = {}
processors.main = {}
[chassis.desk]
[chassis.ann]
restart = "on-failure"
[chassis.ben]
restart = "on-failure"
[chassis.cid]
restart = "on-failure"
[task.servo]
handler = "mcs.servo"
on = "cage/servo"
args.driver = "test.watched"
[task.state]
handler = "mcs.state"
on = "cage/main"
args.servo = "servo"
[task.planner]
handler = "mcs.planner"
on = "cage/main"
args.servo = "servo"
[task.mcs]
handler = "mcs.client"
on = "cage/main"
args = { servo = "servo", state = "state", planner = "planner" }
[task.clock]
handler = "test.clock"
on = "desk"
[task.ann]
handler = "test.asker"
on = "ann"
[task.ben]
handler = "test.asker"
on = "ben"
[task.cid]
handler = "test.asker"
on = "cid"
"#;

/// What is known of the run, by whoever sees it.
#[derive(Default)]
struct Seen {
    /// What went against the rules.
    wrong: Vec<String>,
    /// Who holds the arm for certain, since an answer said so, and since when.
    holder: Option<(String, Instant)>,
    /// When clients die.
    deaths: Vec<(String, Instant)>,
    /// Counts what may have ended a reservation.
    lost: u64,
    /// Counts resets and acquisitions that were begun.
    resets: u64,
    acquisitions: u64,
    /// Those of each client that may still be on the way.
    open: BTreeMap<(String, &'static str), u64>,
    /// An answer said that power is latched off: until there is another reset, and another acquisition.
    latched: Option<(u64, u64)>,
    asked: u64,
    moved: u64,
    streamed: u64,
    released: u64,
}

impl Seen {
    /// What may have ended a reservation happens, or has happened.
    fn lose(&mut self) {
        self.lost += 1;
        self.holder = None;
    }

    fn is_open(&self, name: &str) -> bool {
        let mut open = self.open.iter();
        open.any(|((_, what), count)| *what == name && *count > 0)
    }

    /// A client was told that it holds the arm.
    fn holds(&mut self, name: &str, now: Instant) {
        let before = self.holder.replace((name.to_owned(), now));
        let Some((other, since)) = before else {
            return;
        };
        let dead = |(who, at): &(String, Instant)| *who == other && (since..=now).contains(at);
        if other != name && !self.deaths.iter().any(dead) {
            self.wrong.push(format!("{name} and {other} hold the arm"));
        }
    }
}

type Shared = Arc<Mutex<Seen>>;

/// The test arm, and a look at what the servo has it do.
struct Watched {
    arm: TestArm,
    knobs: Arc<Knobs>,
    seen: Shared,
    model: Model,
    data: Data,
    readings: Vec<SlotReading>,
    power: Power,
    rng: ChaCha8Rng,
}

impl ChannelDriver for Watched {
    fn slots(&self) -> usize {
        self.arm.slots()
    }

    fn read(&mut self, readings: &mut [SlotReading]) -> Result<(), DriverError> {
        let read = self.arm.read(readings);
        self.readings.copy_from_slice(readings);
        // Power is lost now and then, for some periods.
        let fault = match self.rng.random_range(0..6000) {
            0 => 1,
            1 => 2,
            _ if self.rng.random_range(0..20) == 0 => 0,
            _ => self.knobs.fault.load(Ordering::Relaxed),
        };
        if fault != self.knobs.fault.swap(fault, Ordering::Relaxed) && fault != 0 {
            self.seen.lock().unwrap().lose();
        }
        read
    }

    fn write(
        &mut self,
        torques: &[f64],
        power: Power,
        period: Duration,
    ) -> Result<(), DriverError> {
        let mut seen = self.seen.lock().unwrap();
        if power != Power::Off
            && let Some((resets, acquisitions)) = seen.latched
            && (seen.resets == resets || seen.acquisitions == acquisitions)
        {
            let text = format!("power is {power:?} without a reset and a new reservation");
            seen.wrong.push(text);
        }
        if power == Power::Off && self.power != Power::Off {
            // Whatever the reason, a fault of the servo's own or that the arm is given back.
            seen.lose();
        }
        if power == Power::Released && self.power != Power::Released {
            seen.released += 1;
            let q: Vec<f64> = self.readings.iter().map(|slot| slot.position).collect();
            let weight = self.model.gravity_torques(&mut self.data, &q);
            for (joint, (torque, weight)) in torques.iter().zip(weight).enumerate() {
                if (torque - weight).abs() > 1e-6 {
                    let (number, step) = (joint + 1, torque - weight);
                    let text = format!("brakes open with a step of {step} N m at joint {number}");
                    seen.wrong.push(text);
                }
            }
        }
        drop(seen);
        self.power = power;
        self.arm.write(torques, power, period)
    }
}

/// A client that asks at random until the app ends.
struct Asker {
    seen: Shared,
    seed: u64,
    /// How many lives it had.
    lives: Arc<Mutex<[u64; 3]>>,
}

#[derive(Debug, Clone, Copy, PartialEq)]
enum What {
    Acquire,
    Release,
    Move,
    Stream,
    Value,
    Status,
    Stop,
    Resume,
    Cancel,
    Stop1,
    Estop,
    Reset,
}

/// Faults that somebody asks for, or that the driver has. No other may come of what is asked.
const FAULTS: [&str; 3] = [
    "emergency stop was asked for",
    "a controlled stop was asked for",
    "the channel driver failed",
];

/// Often what makes the arm move, seldom what stops it.
const WHATS: [(What, u32); 12] = [
    (What::Acquire, 20),
    (What::Release, 5),
    (What::Move, 25),
    (What::Stream, 6),
    (What::Value, 25),
    (What::Status, 6),
    (What::Stop, 2),
    (What::Resume, 5),
    (What::Cancel, 3),
    (What::Stop1, 1),
    (What::Estop, 1),
    (What::Reset, 8),
];

fn drawn(rng: &mut ChaCha8Rng) -> What {
    let all: u32 = WHATS.iter().map(|(_, weight)| weight).sum();
    let mut at = rng.random_range(0..all);
    for (what, weight) in WHATS {
        if at < weight {
            return what;
        }
        at -= weight;
    }
    What::Status
}

/// One call; what is wrong when it is not answered by who was asked.
async fn answered<C: Command>(
    cx: &Context,
    mcs: &TaskRef,
    seen: &Shared,
    request: C,
) -> Option<C::Reply> {
    let key = (cx.name().to_owned(), C::NAME);
    {
        let mut seen = seen.lock().unwrap();
        *seen.open.entry(key.clone()).or_default() += 1;
        seen.asked += 1;
    }
    let answer = cx.call(mcs, request).deadline(ANSWERED).await;
    let mut seen = seen.lock().unwrap();
    *seen.open.entry(key).or_default() -= 1;
    match answer {
        Ok(reply) => Some(reply),
        Err(error) => {
            if !matches!(error.fault, CallFault::Refused { .. }) {
                let text = format!("{} of {}: {}", C::NAME, cx.name(), error.reason());
                seen.wrong.push(text);
            }
            None
        }
    }
}

impl Asker {
    async fn ask(cx: &Context, mcs: &TaskRef, seen: &Shared, rng: &mut ChaCha8Rng) {
        let lock = || seen.lock().unwrap();
        let near = |rng: &mut ChaCha8Rng| START.map(|at| at + rng.random_range(-0.25..0.25));
        match drawn(rng) {
            What::Acquire => {
                let before = {
                    let mut seen = lock();
                    seen.acquisitions += 1;
                    seen.lost
                };
                let Some(answer) = answered(cx, mcs, seen, Acquire {}).await else {
                    return;
                };
                let mut seen = lock();
                if answer.is_ok() && seen.lost == before {
                    seen.holds(cx.name(), cx.now());
                }
            }
            What::Release => {
                lock().lose();
                answered(cx, mcs, seen, Release {}).await;
            }
            What::Move => {
                let goal = Target::Joints(near(rng).into());
                let moved = answered(cx, mcs, seen, to(goal)).await;
                if moved.is_some_and(|moved| moved.is_ok()) {
                    lock().moved += 1;
                }
            }
            What::Stream => {
                let request = StreamSetpoints {
                    kind: match rng.random_range(0..3) {
                        0 => StreamKind::Torques { gravity: true },
                        _ => StreamKind::Joints,
                    },
                    buffer: None,
                    max_age_s: 0.3,
                    speed: rng.random_range(0.1..1.0),
                    acceleration: None,
                    guards: Vec::new(),
                };
                answered(cx, mcs, seen, request).await;
            }
            What::Value => {
                let numbers = match rng.random_range(0..4) {
                    0 => vec![0.0; 6],
                    _ => near(rng).to_vec(),
                };
                let taken = answered(cx, mcs, seen, StreamValue { numbers }).await;
                if taken.is_some_and(|taken| taken.is_ok()) {
                    lock().streamed += 1;
                }
            }
            What::Status => {
                if let Some(status) = answered(cx, mcs, seen, Status {}).await {
                    let powered = !matches!(
                        status.state,
                        State::Cold | State::Reserved | State::Estopped
                    );
                    if let Some(fault) = &status.fault
                        && !FAULTS.iter().any(|known| fault.starts_with(known))
                    {
                        lock()
                            .wrong
                            .push(format!("{} met a fault: {fault}", cx.name()));
                    }
                    if powered && status.holder.is_none() {
                        lock()
                            .wrong
                            .push(format!("power without a holder: {status:?}"));
                    }
                }
            }
            What::Stop => drop(answered(cx, mcs, seen, Stop {}).await),
            What::Resume => drop(answered(cx, mcs, seen, Resume {}).await),
            What::Cancel => drop(answered(cx, mcs, seen, Cancel {}).await),
            what @ (What::Estop | What::Stop1) => {
                let (resets, undone) = {
                    let mut seen = lock();
                    seen.lose();
                    (seen.resets, seen.is_open(Reset::NAME))
                };
                let answer = match what {
                    What::Estop => answered(cx, mcs, seen, EmergencyStop {}).await,
                    _ => answered(cx, mcs, seen, ControlledStop {}).await,
                };
                let mut seen = lock();
                seen.lose();
                let certain = answer.is_some() && seen.resets == resets && !undone;
                if certain && !seen.is_open(Acquire::NAME) {
                    seen.latched = Some((resets, seen.acquisitions));
                }
            }
            What::Reset => {
                lock().resets += 1;
                answered(cx, mcs, seen, Reset {}).await;
            }
        }
    }
}

impl EventHandler for Asker {
    async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
        cx.default_processing(message)
    }

    async fn phase(&mut self, cx: &Context, phase: Phase) -> Handled {
        if phase != Phase::Run {
            return Ok(());
        }
        let index = CLIENTS.iter().position(|name| *name == cx.name());
        let index = index.unwrap_or_default();
        let life = {
            let mut lives = self.lives.lock().unwrap();
            lives[index] += 1;
            lives[index]
        };
        if life > 1 {
            // Its predecessor's calls will not be answered to anybody; what it held is free, or about to be.
            let mut seen = self.seen.lock().unwrap();
            seen.lose();
            seen.open.retain(|(who, _), _| who.as_str() != cx.name());
        }
        let seed = self.seed ^ ((index as u64) << 8) ^ (life << 16);
        let mcs = cx.task("mcs").await?;
        // Two requests at once, so that one can disturb the other.
        for half in 0..2 {
            let (cx, own, mcs, seen) =
                (cx.clone(), cx.clone(), mcs.clone(), Arc::clone(&self.seen));
            let mut rng = ChaCha8Rng::seed_from_u64(seed ^ (half << 24));
            cx.spawn(async move {
                loop {
                    let pause = Duration::from_millis(rng.random_range(1..120));
                    own.sleep(pause).await;
                    Self::ask(&own, &mcs, &seen, &mut rng).await;
                }
            });
        }
        Ok(())
    }
}

/// A task that ends the app.
struct Clock(Shared);

impl EventHandler for Clock {
    async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
        cx.default_processing(message)
    }

    async fn phase(&mut self, cx: &Context, phase: Phase) -> Handled {
        if phase == Phase::Run {
            let (own, seen) = (cx.clone(), Arc::clone(&self.0));
            cx.spawn(async move {
                own.sleep(LONG).await;
                let wrong = seen.lock().unwrap().wrong.clone();
                own.finish(AppResult {
                    ok: wrong.is_empty(),
                    text: wrong.join("\n"),
                    json: String::new(),
                });
            });
        }
        Ok(())
    }
}

/// One run; what went wrong, and what it saw.
fn run_seed(seed: u64) -> (String, Shared) {
    let mut rng = ChaCha8Rng::seed_from_u64(seed.wrapping_mul(77));
    let deaths: Vec<(String, Instant)> = (0..3)
        .map(|_| {
            let who = CLIENTS[rng.random_range(0..CLIENTS.len())].to_owned();
            (
                who,
                Instant::from_nanos(rng.random_range(1_000_000_000..11_000_000_000)),
            )
        })
        .collect();
    let seen = Arc::new(Mutex::new(Seen {
        deaths: deaths.clone(),
        ..Seen::default()
    }));
    let knobs = Arc::<Knobs>::default();
    let mut drivers = DriverRegistry::new();
    let (for_arm, watching) = (Arc::clone(&knobs), Arc::clone(&seen));
    let watched = drivers.driver("test.watched", move |_, _| {
        let model = built_in_arm("puma560");
        Ok(Box::new(Watched {
            arm: TestArm::new(model.clone(), &START, false, &for_arm),
            knobs: Arc::clone(&for_arm),
            seen: Arc::clone(&watching),
            data: model.data(),
            model,
            readings: vec![SlotReading::default(); 6],
            power: Power::Off,
            rng: ChaCha8Rng::seed_from_u64(seed),
        }))
    });
    watched.slots(|_, _| Some(6));
    let mut registry = Registry::new();
    register(
        &mut registry,
        drivers,
        LawRegistry::new(),
        GuardRegistry::new(),
    );
    let (asking, lives) = (Arc::clone(&seen), Arc::default());
    registry.handler("test.asker", &[], move |_| {
        Ok(Asker {
            seen: Arc::clone(&asking),
            seed,
            lives: Arc::clone(&lives),
        })
    });
    let ending = Arc::clone(&seen);
    registry.handler("test.clock", &[], move |_| Ok(Clock(Arc::clone(&ending))));
    let sets = [format!("app.seed={}", seed + 1)];
    let app = ctos::config::load_texts(&[("app.toml", RANDOM)], &sets, &[]).unwrap();
    let findings = registry.check(&app);
    assert!(findings.is_empty(), "{findings}");
    let deaths = deaths.into_iter();
    let deaths = deaths.map(|(who, at)| Fault::on(who, FaultKind::Kill, at));
    let setup = Setup {
        faults: Faults::of_script("deaths", deaths.collect()),
        ..Setup::default()
    };
    let observer: ctos::boot::Observer = Arc::new(|_| {});
    let run = simulation::run(app, registry, setup, &observer).unwrap();
    let text = match run.outcome.end {
        End::Finished(result) => result.text,
        other => format!("{other:?}"),
    };
    (text, seen)
}

#[test]
fn whatever_clients_ask_while_some_die_and_power_is_lost_the_rules_of_the_states_hold() {
    let number = |name: &str| {
        let asked = std::env::var(name).ok();
        asked.and_then(|number| number.parse::<u64>().ok())
    };
    let seeds = match number("CTOS_STATE_SEED") {
        Some(one) => one..one + 1,
        None => 0..number("CTOS_STATE_SEEDS").unwrap_or(3),
    };
    let (mut asked, mut moved, mut streamed, mut released) = (0, 0, 0, 0);
    for seed in seeds {
        let (wrong, seen) = run_seed(seed);
        assert!(wrong.is_empty(), "CTOS_STATE_SEED={seed}: {wrong}");
        let seen = seen.lock().unwrap();
        asked += seen.asked;
        moved += seen.moved;
        streamed += seen.streamed;
        released += seen.released;
    }
    // It would be no test of motions without them.
    assert!(asked > 100 && moved > 0 && streamed > 0 && released > 1);
}
