//! The app of `configs/calibrate.toml` with one disturbance, and what is left of a run of it.

use std::{
    collections::BTreeMap,
    path::{Path, PathBuf},
    sync::{Arc, Mutex},
    time::Duration,
};

use ctos::{
    boot::{End, Observer},
    config::{Node, Selection},
    registry::Registry,
    simulation::{self, EventSink, Fault, FaultKind, Faults, Setup},
    task::{Context, EventHandler, Handled, HandlerError, Phase},
    time::{Clock, Instant},
};
use futures_util::future::LocalBoxFuture;
use mcs::{
    client::{EmergencyStop, Resume, Stop},
    control::LawRegistry,
    driver::{ChannelDriver, DriverError, DriverRegistry, Power, SlotReading},
    guard::GuardRegistry,
};
use serde::Deserialize;
use vss::{
    catalog::VssExpander,
    frame::{Frame, FrameError},
    source::{FrameSource, FrameSources},
};

/// What happens, and when, s.
pub enum Disturbance {
    None,
    Kill(&'static str, f64),
    /// The same, and its policy starts it again.
    KillAndStart(&'static str, f64),
    /// The chassis of the Dispatcher of `calibrate-durable.toml`, at each of these moments.
    KillDispatcher(Vec<f64>),
    Restart(&'static str, f64),
    Freeze(&'static str, f64, f64),
    Stop(f64),
    StopAndResume(f64, f64),
    EmergencyStop(f64),
    /// Ctrl-C.
    Interrupt(f64),
    /// A post on the floor, x and y, m, from the beginning.
    Obstacle([f64; 2]),
    /// The western camera.
    CameraLost(f64),
}

/// What is calibrated.
pub struct Job {
    /// Positions of the file, from its beginning; all of them without.
    pub positions: Option<usize>,
    pub enough: usize,
    /// How long the arm moves, about, s.
    pub moves_s: f64,
    /// How many moments are tried.
    pub moments: usize,
}

impl Job {
    pub fn of_environment() -> Self {
        match std::env::var("CTOS_MOMENTS") {
            Ok(moments) => Self {
                positions: None,
                enough: 60,
                moves_s: 96.0,
                moments: moments.parse().expect("CTOS_MOMENTS is no number"),
            },
            Err(_) => Self {
                positions: Some(18),
                enough: 15,
                moves_s: 23.0,
                moments: 1,
            },
        }
    }
}

/// What stands in the results' folder before a run.
const OLD: &str = "an earlier result";

/// What the driver saw of the arm.
#[derive(Default)]
struct Seen {
    now_s: f64,
    power: Power,
    /// From when to when it moved, s.
    motions: Vec<(f64, f64)>,
    /// When power changed, s, and to what.
    powers: Vec<(f64, Power)>,
    speed: f64,
    /// Longest time for which a torque near its limit was written while the arm stood.
    pushed_for_s: f64,
    pushing_since: Option<f64>,
}

/// What is left of a run.
pub struct Ended {
    pub end: End,
    /// How many faults came to pass.
    pub faults: usize,
    pub motions: Vec<(f64, f64)>,
    powers: Vec<(f64, Power)>,
    speed: f64,
    pub pushed_for_s: f64,
    results: BTreeMap<String, String>,
    /// Deliveries, as the simulation writes them.
    events: Vec<String>,
    wanted: usize,
}

impl Ended {
    pub fn told(&self) -> String {
        match &self.end {
            End::Finished(result) if result.ok => "succeeded".to_owned(),
            End::Finished(result) => format!("failed: {}", result.text),
            other => format!("{other:?}"),
        }
    }

    pub fn succeeded(&self) -> bool {
        matches!(&self.end, End::Finished(result) if result.ok)
    }

    pub fn is_chassis_down(&self, name: &str) -> bool {
        match &self.end {
            End::ChassisDown { chassis } | End::GivenUp { chassis, .. } => chassis == name,
            _ => false,
        }
    }

    /// All positions were reached, and the cameras are where they should be.
    pub fn must_succeed(&self) {
        let End::Finished(result) = &self.end else {
            panic!("{}", self.told());
        };
        assert!(result.ok, "{}", self.told());
        let json: serde_json::Value = serde_json::from_str(&result.json).unwrap();
        assert_eq!(json["positions"], self.wanted, "{json}");
        for camera in json["cameras"].as_array().unwrap() {
            for (error, sd) in [
                ("position_error_m", "position_sd_m"),
                ("rotation_error_rad", "rotation_sd_rad"),
            ] {
                let [error, sd] = [error, sd].map(|key| camera[key].as_f64().unwrap());
                assert!(error < 6.0 * sd, "{camera}");
            }
        }
        assert!(self.results_are_new());
    }

    /// The command failed, with all these words, and left the earlier results alone.
    pub fn must_fail(&self, words: &[&str]) {
        let End::Finished(result) = &self.end else {
            panic!("{}", self.told());
        };
        assert!(!result.ok, "{}", self.told());
        for word in words {
            assert!(result.text.contains(word), "`{word}`: {}", self.told());
        }
        assert!(!self.results_are_new());
    }

    pub fn results_are_new(&self) -> bool {
        self.results.values().all(|text| text != OLD)
    }

    pub fn results_must_be_true_or_untouched(&self) {
        let untouched = self.results.values().all(|text| text == OLD);
        assert!(
            untouched || self.results_are_new(),
            "half of the results is new: {:?}",
            self.results.keys()
        );
        assert!(
            untouched || self.succeeded(),
            "a run that failed replaced the results: {}",
            self.told()
        );
    }

    pub fn arm_must_be_at_rest_without_power(&self) {
        let power = self.powers.last().map(|(_, power)| *power);
        assert_eq!(power, Some(Power::Off), "{}", self.told());
        assert!(
            self.speed < 1e-2,
            "at {} rad/s: {}",
            self.speed,
            self.told()
        );
    }

    pub fn arm_must_stand(&self, from: f64, until: f64) {
        for (begin, end) in &self.motions {
            assert!(
                *end < from || *begin > until,
                "it moved from {begin:.3} to {end:.3} s, and was to stand from {from:.3} to {until:.3} s: {}",
                self.told()
            );
        }
    }

    pub fn arm_must_be_without_power(&self, from: f64) {
        let later = self.powers.iter().filter(|(at, _)| *at > from);
        for (at, power) in later {
            assert_eq!(*power, Power::Off, "at {at:.3} s: {}", self.told());
        }
        let before = self.powers.iter().rev().find(|(at, _)| *at <= from);
        assert_eq!(before.map(|(_, power)| *power), Some(Power::Off));
    }

    /// After `at` the lamp's task was asked once more, which a calibration does last to switch it off.
    pub fn lamp_must_be_off_before_its_task_stops(&self, at: f64) {
        let asked = self
            .events
            .iter()
            .filter(|line| line.contains("/world ") && line.contains(SET_LAMP));
        let times: Vec<f64> = asked.filter_map(|line| moment_of(line)).collect();
        assert!(
            times.iter().any(|time| *time >= at),
            "the lamp is on: {times:?} and {at}"
        );
    }
}

/// The command that switches the lamp, as events show it.
const SET_LAMP: &str = "command=0x0502";

/// The moment, s, at the beginning of a line of events.
fn moment_of(line: &str) -> Option<f64> {
    line.split_whitespace().next()?.parse().ok()
}

/// The simulated arm, watched.
struct Watched {
    arm: Box<dyn ChannelDriver>,
    clock: Clock,
    seen: Arc<Mutex<Seen>>,
}

/// An arm that is slower than this stands, rad/s.
const STANDS: f64 = 0.02;

impl ChannelDriver for Watched {
    fn slots(&self) -> usize {
        self.arm.slots()
    }

    fn read(&mut self, readings: &mut [SlotReading]) -> Result<(), DriverError> {
        self.arm.read(readings)?;
        let speeds = readings.iter().map(|reading| reading.velocity.abs());
        self.seen.lock().unwrap().speed = speeds.fold(0.0, f64::max);
        Ok(())
    }

    fn write(
        &mut self,
        torques: &[f64],
        power: Power,
        period: Duration,
    ) -> Result<(), DriverError> {
        {
            let mut seen = self.seen.lock().unwrap();
            let now = self.clock.now().since_start().as_secs_f64();
            if power != Power::Released {
                // The brakes hold it.
                seen.speed = 0.0;
            }
            if seen.powers.is_empty() || seen.power != power {
                seen.power = power;
                seen.powers.push((now, power));
            }
            if seen.speed > STANDS {
                let last = seen.now_s;
                match seen.motions.last_mut() {
                    Some((_, end)) if *end >= last - 0.05 => *end = now,
                    _ => seen.motions.push((now, now)),
                }
            }
            // Joints 1 to 3 of a PUMA 560 give some 100 N m, and gravity takes less than 60 of them.
            let pushes = seen.speed < STANDS && torques.iter().any(|torque| torque.abs() > 80.0);
            seen.pushing_since = match (pushes, seen.pushing_since) {
                (true, since) => Some(since.unwrap_or(now)),
                (false, _) => None,
            };
            if let Some(since) = seen.pushing_since {
                seen.pushed_for_s = seen.pushed_for_s.max(now - since);
            }
            seen.now_s = now;
        }
        self.arm.write(torques, power, period)
    }
}

/// A camera that gives no more pictures from a moment on.
struct Failing {
    name: String,
    camera: sim::source::SimCamera,
    from: Instant,
}

impl FrameSource for Failing {
    fn snap<'a>(&'a mut self, cx: &'a Context) -> LocalBoxFuture<'a, Result<Frame, FrameError>> {
        Box::pin(async move {
            if cx.now() >= self.from {
                return Err(FrameError::Fault {
                    camera: self.name.clone(),
                    reason: "no signal".to_owned(),
                });
            }
            self.camera.take(cx).await
        })
    }
}

#[derive(Deserialize)]
struct HandArgs {
    at_s: f64,
    what: String,
    resume_at_s: Option<f64>,
}

/// Somebody beside the robot.
struct Hand(HandArgs);

impl EventHandler for Hand {
    async fn handle(&mut self, cx: &Context, message: ctos::message::Message) -> Handled {
        cx.default_processing(message)
    }

    async fn phase(&mut self, cx: &Context, phase: Phase) -> Handled {
        if phase == Phase::Run {
            let (own, at) = (cx.clone(), self.0.at_s);
            let (what, resume) = (self.0.what.clone(), self.0.resume_at_s);
            cx.spawn(async move {
                if let Err(error) = act(&own, &what, at, resume).await {
                    own.fail(&format!("the hand could not act: {error}"));
                }
            });
        }
        Ok(())
    }
}

async fn until(cx: &Context, at_s: f64) {
    let at = Instant::START + Duration::from_secs_f64(at_s);
    cx.sleep(at.since(cx.now())).await;
}

async fn act(
    cx: &Context,
    what: &str,
    at_s: f64,
    resume_at_s: Option<f64>,
) -> Result<(), HandlerError> {
    until(cx, at_s).await;
    let mcs = cx.task("mcs").await?;
    match what {
        "stop" => cx.call(&mcs, Stop {}).await?,
        _ => cx.call(&mcs, EmergencyStop {}).await?,
    }
    if let Some(at_s) = resume_at_s {
        until(cx, at_s).await;
        cx.call(&mcs, Resume {}).await?;
    }
    Ok(())
}

fn registry(seen: &Arc<Mutex<Seen>>, camera_lost_s: Option<f64>) -> Registry {
    let mut registry = Registry::new();
    let mut drivers = DriverRegistry::new();
    let mut sources = FrameSources::new();
    sim::register(&mut registry, &mut drivers, &mut sources);
    let seen = seen.clone();
    let watched = drivers.driver("test.watched", move |cx, args| {
        Ok(Box::new(Watched {
            arm: sim::handlers::open_arm(cx, args)?,
            clock: cx.chassis().clock().clone(),
            seen: seen.clone(),
        }))
    });
    watched.keys(&["world", "arm"]);
    let from = camera_lost_s.map_or(Duration::MAX, Duration::from_secs_f64);
    let failing = sources.source("test.failing", move |cx, name, args: &Node| {
        let source: Box<dyn FrameSource> = Box::new(Failing {
            name: name.to_owned(),
            camera: sim::source::SimCamera::new(cx, name, args)?,
            from: Instant::START + from,
        });
        Ok(source)
    });
    failing.keys(&["cell"]);
    let (laws, guards) = (LawRegistry::new(), GuardRegistry::new());
    mcs::register(&mut registry, drivers, laws, guards);
    vss::register(&mut registry, sources);
    coordinators::register(&mut registry);
    let hand = registry.handler("test.hand", &[], |cx| Ok(Hand(cx.args()?)));
    hand.args::<HandArgs>();
    registry
}

fn copy(from: &Path, to: &Path) {
    std::fs::create_dir_all(to).unwrap();
    for entry in std::fs::read_dir(from).unwrap() {
        let (path, name) = {
            let entry = entry.unwrap();
            (entry.path(), entry.file_name())
        };
        match path.is_dir() {
            true => copy(&path, &to.join(name)),
            false => drop(std::fs::copy(&path, to.join(name)).unwrap()),
        }
    }
}

/// Runs the job with a disturbance.
pub fn run(job: &Job, disturbance: &Disturbance) -> Ended {
    let folder = tempfile::tempdir().unwrap();
    let configs: PathBuf = folder.path().join("configs");
    copy(
        &Path::new(env!("CARGO_MANIFEST_DIR")).join("../configs"),
        &configs,
    );
    let results = folder.path().join("results");
    std::fs::create_dir(&results).unwrap();
    for name in ["ceiling_west.yaml", "ceiling_east.yaml", "poses.yaml"] {
        std::fs::write(results.join(name), OLD).unwrap();
    }
    let text = std::fs::read_to_string(configs.join("positions.csv")).unwrap();
    let lines = text
        .lines()
        .take(2 + job.positions.unwrap_or(usize::MAX - 2));
    let few: Vec<&str> = lines.collect();
    std::fs::write(configs.join("positions.csv"), few.join("\n") + "\n").unwrap();

    let mut sets = vec![
        "time.mode=\"virtual\"".to_owned(),
        format!(
            "task.dispatcher.args.results={:?}",
            results.display().to_string()
        ),
        format!("task.operator.args.arguments=[\"enough={}\"]", job.enough),
        "task.servo.args.driver=\"test.watched\"".to_owned(),
    ];
    let mut script = Vec::new();
    let mut setup = Setup::default();
    let instant = |s: f64| Instant::START + Duration::from_secs_f64(s);
    let hand = |what: &str, at: f64| {
        let file = configs.join("calibrate.toml");
        let text = std::fs::read_to_string(&file).unwrap();
        let hand = format!(
            "\n[task.hand]\nhandler = \"test.hand\"\non = \"ws1\"\nargs = {{ what = \"{what}\", at_s = {at:?} }}\n"
        );
        std::fs::write(file, text + &hand).unwrap();
    };
    let mut camera_lost_s = None;
    let mut config = "calibrate.toml";
    match disturbance {
        Disturbance::None => {}
        Disturbance::Kill(chassis, at) => script.push(Fault::on(
            (*chassis).to_owned(),
            FaultKind::Kill,
            instant(*at),
        )),
        Disturbance::KillAndStart(chassis, at) => {
            sets.push(format!("chassis.{chassis}.restart=\"on-failure\""));
            script.push(Fault::on(
                (*chassis).to_owned(),
                FaultKind::Kill,
                instant(*at),
            ));
        }
        Disturbance::KillDispatcher(moments) => {
            config = "calibrate-durable.toml";
            let kill = |at: &f64| Fault::on("ws2".to_owned(), FaultKind::Kill, instant(*at));
            script.extend(moments.iter().map(kill));
        }
        Disturbance::Restart(chassis, at) => script.push(Fault::on(
            (*chassis).to_owned(),
            FaultKind::Restart,
            instant(*at),
        )),
        Disturbance::Freeze(chassis, at, lasts) => script.push(
            Fault::on((*chassis).to_owned(), FaultKind::Freeze, instant(*at))
                .until(instant(at + lasts)),
        ),
        Disturbance::Stop(at) => hand("stop", *at),
        Disturbance::StopAndResume(at, resume) => {
            hand("stop", *at);
            sets.push(format!("task.hand.args.resume_at_s={resume:?}"));
        }
        Disturbance::EmergencyStop(at) => hand("estop", *at),
        Disturbance::Interrupt(at) => setup.stop_after = Some(Duration::from_secs_f64(*at)),
        Disturbance::Obstacle([x, y]) => {
            let cell = configs.join("cell.toml");
            let text = std::fs::read_to_string(&cell).unwrap();
            let post = format!(
                "[[furniture]]\ncentre = [{x:?}, {y:?}, 0.6]\nsize = [0.06, 0.06, 1.2]\ngrey = 30.0\n\n"
            );
            let text = text.replacen("[[furniture]]", &format!("{post}[[furniture]]"), 1);
            std::fs::write(cell, text).unwrap();
        }
        Disturbance::CameraLost(at) => {
            camera_lost_s = Some(*at);
            sets.push("vss.cameras.ceiling_west.source=\"test.failing\"".to_owned());
        }
    }
    setup.faults = Faults::of_script("disturbance", script);
    let events = Arc::new(Mutex::new(Vec::new()));
    if matches!(disturbance, Disturbance::Interrupt(_)) {
        let sink = events.clone();
        let sink: EventSink =
            Arc::new(move |line: &str| sink.lock().unwrap().push(line.to_owned()));
        setup.events = Some(sink);
    }
    let seen = Arc::new(Mutex::new(Seen::default()));
    let registry = registry(&seen, camera_lost_s);
    let selection = Selection {
        sets,
        ..Selection::new(configs.join(config))
    };
    let app = selection
        .load(&[("vss", &VssExpander)])
        .unwrap_or_else(|found| panic!("{found}"));
    let findings = registry.check(&app);
    assert!(!findings.has_errors(), "{findings}");
    let observer: Observer = Arc::new(|_| {});
    let ran = simulation::run(app, registry, setup, &observer).unwrap();
    let results = std::fs::read_dir(&results).unwrap().map(|entry| {
        let path = entry.unwrap().path();
        let name = path.file_name().unwrap().to_string_lossy().into_owned();
        (name, std::fs::read_to_string(path).unwrap())
    });
    let results = results.collect();
    let seen = std::mem::take(&mut *seen.lock().unwrap());
    let events = std::mem::take(&mut *events.lock().unwrap());
    Ended {
        end: ran.outcome.end,
        faults: ran.faults.len(),
        motions: seen.motions,
        powers: seen.powers,
        speed: seen.speed,
        pushed_for_s: seen.pushed_for_s,
        results,
        events,
        wanted: few.len() - 2,
    }
}
