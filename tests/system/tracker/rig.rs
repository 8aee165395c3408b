//! The app of `configs/tracker.toml` in virtual time, with people, faults and things in its way, and what is left of a run of it.

use std::{
    path::Path,
    sync::{Arc, Mutex},
    time::Duration,
};

use ctos::{
    Command as _,
    boot::{End, Observer},
    config::Selection,
    registry::Registry,
    simulation::{self, Fault, FaultKind, Faults, Setup},
    task::{Context, EventHandler, Handled, HandlerError, Phase},
    time::Instant,
};
use mcs::{
    client::{EmergencyStop, ReadPosition, Reset, Resume, Stop},
    control::LawRegistry,
    driver::{ChannelDriver, DriverError, DriverRegistry, Mode, Power, Sensor, SlotReading},
    guard::GuardRegistry,
    partition::McsExpander,
};
use mcs_hand::command::{ReadBodies, ReadTouch, Touch};
use pnt::task::{Marking, PutTape};
use serde_json::Value;
use sim::{scene::CameraFault, world_task::FailCamera};
use tracker::{
    blob::Look,
    coordination::ask,
    wire::{ClockTimes, CompareClocks, DeflectMouse, TargetSeen, TuneLook},
};
use vss::{catalog::VssExpander, source::FrameSources};

/// What a clock that can be set shows too much at first.
const AHEAD_NS: u64 = 10_000_000_000;

/// What somebody does.
#[derive(Debug, Clone, Copy)]
pub enum Act {
    /// Puts an order on the net's tape.
    Order(&'static str),
    /// Puts a command with its numbers on the tape of the net that stands for a person.
    Person(&'static str, &'static [f64]),
    Stop,
    Resume,
    EmergencyStop,
    Reset,
    /// Has the camera lie, or be well again.
    Camera(Option<CameraFault>),
    /// Has the force sensor read besides, N; NaN is what a broken one reads.
    Feel([f64; 3]),
    Deflect([f64; 6]),
    /// Has argus expect a ball of at least so many pixels.
    Tune(u64),
    /// Sets what druide hears of the clock of argus so far ahead, ns; see [`Rig::clock_that_is_set`].
    SetClock(u64),
}

/// A run to be.
pub struct Rig {
    name: String,
    app: &'static str,
    seconds: f64,
    sets: Vec<String>,
    more: String,
    cell: String,
    swap: Option<[String; 2]>,
    acts: Vec<(f64, Act)>,
    faults: Vec<Fault>,
}

/// What is left of a run.
pub struct Ended {
    /// What the app told.
    pub result: Value,
    /// Answers to orders: the moment, s, the symbol, and the text.
    pub answers: Vec<(f64, String, String)>,
    /// What the net was from when on, s.
    pub states: Vec<(f64, String)>,
    /// What touched the arm, as the world has it, while something did: the moment, s, and the sum of all forces, N.
    pub touched: Vec<(f64, f64)>,
    /// Where the ball was: the moment, s, and the place, m.
    pub bodies: Vec<(f64, [f64; 3])>,
    /// Where the joints of arm and fingers were, if it has some: the moment, s, and each, rad.
    pub joints: Vec<(f64, [Vec<f64>; 2])>,
    /// The map's table afterwards.
    pub map: String,
}

impl Ended {
    pub fn number(&self, key: &str) -> f64 {
        let number = self.result[key].as_f64();
        number.unwrap_or_else(|| panic!("`{key}` in {}", self.result))
    }

    /// In what state the net was at a moment, s.
    pub fn state(&self, at: f64) -> &str {
        let before = self.states.iter().rev().find(|(since, _)| *since <= at);
        before.map_or("", |(_, state)| state)
    }

    /// What an order was answered, which was given about then, s.
    pub fn answer(&self, at: f64) -> (&str, &str) {
        let found = self
            .answers
            .iter()
            .find(|(given, ..)| (*given - at).abs() < 0.01);
        let (_, symbol, text) = found.unwrap_or_else(|| panic!("{at}: {:?}", self.answers));
        (symbol, text)
    }

    /// The least and the largest force of the world on the arm between two moments, s; N.
    pub fn pressed(&self, from: f64, until: f64) -> [f64; 2] {
        assert!(!self.touched.is_empty(), "nothing was touched");
        let within = |at: f64| at >= from && at < until;
        let forces = self.touched.iter().filter(|(at, _)| within(*at));
        forces.fold([f64::MAX, 0.0], |[low, high], (_, force)| {
            [low.min(*force), high.max(*force)]
        })
    }

    /// Where the ball was at a moment, s.
    pub fn ball(&self, at: f64) -> [f64; 3] {
        let before = self.bodies.iter().rev().find(|(then, _)| *then <= at);
        before.map(|(_, place)| *place).unwrap()
    }

    /// How far a joint of the arm, or else of its fingers, has turned between two moments at most, s; rad.
    pub fn turned(&self, fingers: bool, from: f64, until: f64) -> f64 {
        let within = |at: f64| at >= from && at < until;
        let mut all = self.joints.iter().filter(|(at, _)| within(*at));
        let own = |joints: &[Vec<f64>; 2]| joints[usize::from(fingers)].clone();
        let first = all.next().map(|(_, joints)| own(joints)).unwrap();
        let apart = |(_, joints): &(f64, [Vec<f64>; 2])| {
            let both = own(joints).into_iter().zip(&first);
            both.map(|(now, then)| (now - then).abs())
                .fold(0.0, f64::max)
        };
        all.map(apart).fold(0.0, f64::max)
    }

    /// What holds whatever happens: no step of the commanded speed, no record lost.
    pub fn must_move_smoothly(&self) {
        let told = format!("{:?} {}", self.states, self.result);
        assert!(
            self.number("max_acceleration_ratio") <= 1.0 + 1e-6,
            "{told}"
        );
        // 6 m/s^2 in 4.5 ms.
        assert!(self.number("max_step_m_s") <= 6.0 * 0.0045 + 1e-6, "{told}");
        assert_eq!(self.result["unread"], 0, "{told}");
    }

    /// And as long as nobody sets a clock: clocks known within their bound.
    pub fn must_be_smooth(&self) {
        self.must_move_smoothly();
        assert_eq!(
            self.result["clock_within"], true,
            "{:?} {}",
            self.states, self.result
        );
    }
}

impl Rig {
    pub fn new(name: &str, seconds: f64) -> Self {
        Self {
            name: name.to_owned(),
            app: "tracker",
            seconds,
            sets: Vec::new(),
            more: String::new(),
            cell: String::new(),
            swap: None,
            acts: Vec::new(),
            faults: Vec::new(),
        }
    }

    /// The app with a hand of three fingers.
    pub fn with_hand(mut self) -> Self {
        self.app = "tracker-grasp";
        self
    }

    /// With a key of the configuration.
    pub fn set(mut self, set: &str) -> Self {
        self.sets.push(set.to_owned());
        self
    }

    /// With lines more in the configuration.
    pub fn app(mut self, lines: &str) -> Self {
        self.more += lines;
        self
    }

    /// With more in the cell.
    pub fn cell(mut self, lines: &str) -> Self {
        self.cell += lines;
        self
    }

    /// With another text in the place of one of the cell.
    pub fn swap(mut self, text: &str, other: &str) -> Self {
        self.swap = Some([text, other].map(str::to_owned));
        self
    }

    /// Somebody does something at a moment, s.
    pub fn act(mut self, at: f64, act: Act) -> Self {
        self.acts.push((at, act));
        self
    }

    /// With somebody between druide and those who tell it moments by the clock of argus, who can have that clock set. It shows
    /// 10 s more at first, for no clock shows less than nothing.
    pub fn clock_that_is_set(self) -> Self {
        self.app("[task.between]\nhandler = \"test.between\"\non = \"argus\"\n")
            .set("task.druide.args.argus=\"between\"")
            .set("task.client.args.druide=\"between\"")
    }

    /// A chassis is killed at a moment, s.
    pub fn kill(mut self, chassis: &str, at: f64) -> Self {
        let at = Instant::START + Duration::from_secs_f64(at);
        self.faults
            .push(Fault::on(chassis.to_owned(), FaultKind::Kill, at));
        self
    }

    pub fn run(self) -> Ended {
        let folder = tempfile::tempdir().unwrap();
        let configs = folder.path().join("configs");
        let from = Path::new(env!("CARGO_MANIFEST_DIR")).join("../configs");
        std::fs::create_dir_all(configs.join("nets/tracker")).unwrap();
        std::fs::create_dir_all(configs.join("models")).unwrap();
        for file in [
            "tracker-cell.toml",
            "tracker-map.csv",
            "tracker.toml",
            "tracker-grasp.toml",
            "tracker-grasp-cell.toml",
            "tracker-grasp-map.csv",
            "models/puma560_carrying_hand.toml",
            "nets/tracker/tracking.net",
            "nets/tracker/person.net",
        ] {
            std::fs::copy(from.join(file), configs.join(file)).unwrap();
        }
        let append = |file: &str, lines: &str| {
            let file = configs.join(file);
            let text = std::fs::read_to_string(&file).unwrap();
            std::fs::write(file, format!("{text}\n{lines}")).unwrap();
        };
        let app = format!("{}.toml", self.app);
        append(
            &app,
            &format!(
                "[task.script]\nhandler = \"test.script\"\non = \"desk\"\n{}",
                self.more
            ),
        );
        let cell = format!("{}-cell.toml", self.app);
        append(&cell, &self.cell);
        if let Some([text, other]) = self.swap {
            let file = configs.join(cell);
            let cell = std::fs::read_to_string(&file).unwrap();
            assert!(cell.contains(&text));
            std::fs::write(file, cell.replace(&text, &other)).unwrap();
        }
        for file in ["tracker.toml", &app].map(|file| configs.join(file)) {
            let text = std::fs::read_to_string(&file).unwrap();
            // The first is that of the arm.
            std::fs::write(file, text.replacen("\"sim.arm\"", "\"test.felt\"", 1)).unwrap();
        }
        let mut sets = vec![
            format!("app.name=\"rig_{}_{}\"", self.name, std::process::id()),
            "time.mode=\"virtual\"".to_owned(),
            format!("task.tracker.args.seconds={:?}", self.seconds),
            // The ball is followed after 0.2 s.
            "task.ball.args.begins_s=2.0".to_owned(),
        ];
        sets.extend(self.sets);
        let selection = Selection {
            sets,
            ..Selection::new(configs.join(app))
        };
        let app = selection
            .load(&[("mcs", &McsExpander), ("vss", &VssExpander)])
            .unwrap_or_else(|found| panic!("{found}"));
        let seen = Arc::new(Mutex::new(Seen::default()));
        let watched = Watched {
            hand: self.app == "tracker-grasp",
            touches: self.cell.contains("feels"),
        };
        let registry = registry(self.acts, watched, &seen);
        let findings = registry.check(&app);
        assert!(!findings.has_errors(), "{findings}");
        let setup = Setup {
            faults: Faults::of_script("script", self.faults),
            ..Setup::default()
        };
        let observer: Observer = Arc::new(|_| {});
        let ran = simulation::run(app, registry, setup, &observer).unwrap();
        let End::Finished(result) = ran.outcome.end else {
            panic!("{:?}", ran.outcome.end);
        };
        let seen = std::mem::take(&mut *seen.lock().unwrap());
        let result = serde_json::from_str(&result.json).unwrap();
        println!(
            "{}: {:?} {:?} {result}",
            self.name, seen.states, seen.answers
        );
        Ended {
            result,
            answers: seen.answers,
            states: seen.states,
            touched: seen.touched,
            map: std::fs::read_to_string(configs.join(format!("{}-map.csv", self.app))).unwrap(),
            bodies: seen.bodies,
            joints: seen.joints,
        }
    }
}

/// What is noted besides the net's state.
#[derive(Clone, Copy)]
struct Watched {
    /// The ball and the joints.
    hand: bool,
    /// What touches the arm, at each period of the servo.
    touches: bool,
}

#[derive(Default)]
struct Seen {
    answers: Vec<(f64, String, String)>,
    states: Vec<(f64, String)>,
    touched: Vec<(f64, f64)>,
    bodies: Vec<(f64, [f64; 3])>,
    joints: Vec<(f64, [Vec<f64>; 2])>,
    feels: [f64; 3],
    ahead_ns: Option<u64>,
}

fn registry(acts: Vec<(f64, Act)>, watched: Watched, seen: &Arc<Mutex<Seen>>) -> Registry {
    let mut registry = Registry::new();
    let mut drivers = DriverRegistry::new();
    let mut sources = FrameSources::new();
    sim::register(&mut registry, &mut drivers, &mut sources);
    let felt = Arc::clone(seen);
    let driver = drivers.driver("test.felt", move |cx, args| {
        Ok(Box::new(Felt {
            arm: sim::handlers::open_arm(cx, args)?,
            seen: Arc::clone(&felt),
        }))
    });
    driver.keys(&["world", "arm", "sensors", "joints"]);
    let mut laws = LawRegistry::new();
    mcs_hand::register(&mut registry, &mut laws);
    mcs::register(&mut registry, drivers, laws, GuardRegistry::new());
    vss::register(&mut registry, sources);
    coordinators::register(&mut registry);
    tracker::register(&mut registry);
    pnt_net::register(&mut registry);
    let between = Arc::clone(seen);
    let commands = [CompareClocks::INFO, TargetSeen::INFO];
    registry.handler("test.between", &commands, move |_| {
        Ok(Between {
            seen: Arc::clone(&between),
        })
    });
    let seen = Arc::clone(seen);
    registry.handler("test.script", &[], move |_| {
        Ok(Script {
            acts: acts.clone(),
            watched,
            seen: Arc::clone(&seen),
        })
    });
    registry
}

/// The simulated arm, whose force sensor reads what a test wants.
struct Felt {
    arm: Box<dyn ChannelDriver>,
    seen: Arc<Mutex<Seen>>,
}

impl ChannelDriver for Felt {
    fn slots(&self) -> usize {
        self.arm.slots()
    }

    fn read(&mut self, readings: &mut [SlotReading]) -> Result<(), DriverError> {
        self.arm.read(readings)
    }

    fn sensors(&self) -> &[Sensor] {
        self.arm.sensors()
    }

    fn ages(&mut self, ages: &mut [f64]) {
        self.arm.ages(ages);
    }

    fn sense(&mut self, numbers: &mut [f64]) -> Result<(), DriverError> {
        self.arm.sense(numbers)?;
        let feels = self.seen.lock().unwrap().feels;
        for (number, felt) in numbers.iter_mut().zip(feels) {
            *number += felt;
        }
        Ok(())
    }

    fn modes(&self) -> &[Mode] {
        self.arm.modes()
    }

    fn write(
        &mut self,
        torques: &[f64],
        power: Power,
        period: Duration,
    ) -> Result<(), DriverError> {
        self.arm.write(torques, power, period)
    }
}

/// Tells druide all moments by a clock of argus that somebody sets.
struct Between {
    seen: Arc<Mutex<Seen>>,
}

impl Between {
    fn shown(&self, ns: u64) -> u64 {
        let ahead = self.seen.lock().unwrap().ahead_ns;
        ns + ahead.unwrap_or(AHEAD_NS)
    }
}

impl EventHandler for Between {
    async fn handle(&mut self, cx: &Context, message: ctos::message::Message) -> Handled {
        match message.command() {
            CompareClocks::CODE => {
                let (CompareClocks {}, reply) = message.open::<CompareClocks>()?;
                let now = self.shown(cx.now().as_nanos());
                reply.ok(ClockTimes {
                    arrived_ns: now,
                    replied_ns: now,
                })
            }
            TargetSeen::CODE => {
                let (mut seen, reply) = message.open::<TargetSeen>()?;
                seen.stamp_ns = self.shown(seen.stamp_ns);
                seen.received_ns = self.shown(seen.received_ns);
                let druide = cx.task("druide").await?;
                cx.send(&druide, seen).await?;
                reply.ok(())
            }
            _ => cx.default_processing(message),
        }
    }
}

/// Somebody beside the robot, and somebody who watches the net.
struct Script {
    acts: Vec<(f64, Act)>,
    watched: Watched,
    seen: Arc<Mutex<Seen>>,
}

impl EventHandler for Script {
    async fn handle(&mut self, cx: &Context, message: ctos::message::Message) -> Handled {
        cx.default_processing(message)
    }

    async fn phase(&mut self, cx: &Context, phase: Phase) -> Handled {
        if phase != Phase::Run {
            return Ok(());
        }
        let (own, seen) = (cx.clone(), Arc::clone(&self.seen));
        let Watched { hand, touches } = self.watched;
        cx.spawn(async move {
            while !own.is_stopping() {
                if let Ok(net) = own.task("tracking").await
                    && let Ok(snapshot) = own.call(&net, Marking {}).await
                {
                    note(&seen, own.now(), &snapshot.places);
                }
                if hand
                    && let Ok(world) = own.task("world").await
                    && let Ok(bodies) = own.call(&world, ReadBodies {}).await
                    && let Some(ball) = bodies.iter().find(|body| body.name == "ball")
                {
                    let now = own.now().since_start().as_secs_f64();
                    let place = [3, 7, 11].map(|index| ball.world_t_body[index]);
                    seen.lock().unwrap().bodies.push((now, place));
                }
                if hand
                    && let (Ok(arm), Ok(fingers)) =
                        (own.task("arm").await, own.task("fingers").await)
                    && let Ok(arm) = own.call(&arm, ReadPosition {}).await
                    && let Ok(fingers) = own.call(&fingers, ReadPosition {}).await
                {
                    let now = own.now().since_start().as_secs_f64();
                    let both = [arm, fingers].map(|part| part.joints.to_vec());
                    seen.lock().unwrap().joints.push((now, both));
                }
                own.sleep(Duration::from_millis(20)).await;
            }
        });
        let (own, seen) = (cx.clone(), Arc::clone(&self.seen));
        cx.spawn(async move {
            while touches && !own.is_stopping() {
                if let Ok(world) = own.task("world").await
                    && let Ok(touches) = own.call(&world, ReadTouch { arm: None }).await
                    && !touches.is_empty()
                {
                    let force = |touch: &Touch| touch.force_n.map(|n| n * n).iter().sum::<f64>();
                    let sum = touches.iter().map(|touch| force(touch).sqrt()).sum();
                    let now = own.now().since_start().as_secs_f64();
                    seen.lock().unwrap().touched.push((now, sum));
                }
                own.sleep(Duration::from_micros(4500)).await;
            }
        });
        for (at, act) in self.acts.clone() {
            let (own, seen) = (cx.clone(), Arc::clone(&self.seen));
            cx.spawn(async move {
                let moment = Instant::START + Duration::from_secs_f64(at);
                own.sleep(moment.since(own.now())).await;
                if let Err(error) = done(&own, &seen, at, act).await {
                    own.fail(&format!("{act:?}: {error}"));
                }
            });
        }
        Ok(())
    }
}

/// Notes the net's state, which is marked between two commands.
fn note(seen: &Mutex<Seen>, now: Instant, places: &[(String, u32)]) {
    const STATES: [&str; 13] = [
        "idle",
        "learn",
        "acquire",
        "track",
        "lost",
        "expired",
        "handed_over",
        "grasps",
        "holds",
        "overload",
        "guarded",
        "halted",
        "estopped",
    ];
    let marked = places
        .iter()
        .find(|(place, tokens)| *tokens > 0 && STATES.contains(&place.as_str()));
    let mut seen = seen.lock().unwrap();
    if let Some((state, _)) = marked
        && seen.states.last().is_none_or(|(_, last)| last != state)
    {
        let now = now.since_start().as_secs_f64();
        seen.states.push((now, state.clone()));
    }
}

async fn done(cx: &Context, seen: &Mutex<Seen>, at: f64, act: Act) -> Result<(), HandlerError> {
    let arm = cx.task("arm").await?;
    match act {
        Act::Order(symbol) => {
            let answer = ask(cx, "tracking", symbol).await?;
            let mut seen = seen.lock().unwrap();
            seen.answers.push((at, answer.symbol, answer.text));
        }
        Act::Person(symbol, numbers) => {
            let person = cx.task("person").await?;
            let put = PutTape {
                symbol: symbol.to_owned(),
                arguments: numbers.iter().map(f64::to_string).collect(),
            };
            let answer = cx.call(&person, put).await?;
            let mut seen = seen.lock().unwrap();
            seen.answers.push((at, answer.symbol, answer.text));
        }
        Act::Stop => cx.call(&arm, Stop {}).await?,
        Act::Resume => cx.call(&arm, Resume {}).await?,
        Act::EmergencyStop => cx.call(&arm, EmergencyStop {}).await?,
        Act::Reset => drop(cx.call(&arm, Reset {}).await??),
        Act::Camera(fault) => {
            let world = cx.task("world").await?;
            let camera = "wrist".to_owned();
            cx.call(&world, FailCamera { camera, fault }).await?;
        }
        Act::Feel(force) => seen.lock().unwrap().feels = force,
        Act::SetClock(ahead) => seen.lock().unwrap().ahead_ns = Some(AHEAD_NS + ahead),
        Act::Tune(least) => {
            let argus = cx.task("argus").await?;
            let mut look = Look::default();
            look.area_px[0] = least;
            cx.call(&argus, TuneLook { look }).await?;
        }
        Act::Deflect(numbers) => {
            let mouse = cx.task("mouse").await?;
            cx.call(&mouse, DeflectMouse { numbers }).await?;
        }
    }
    Ok(())
}
