//! The driver inside an app: its arguments, what a configuration can get wrong about them, and how it is made.

use std::time::Duration;

use ctos::{
    config::{App, Node, TaskConfig, TimeMode},
    diagnostic::{Finding, Findings},
    task::{Context, HandlerError},
    time::Clock,
};
use mcs::driver::{ChannelDriver, DriverRegistry, Mode};
use serde::Deserialize;

use crate::{
    driver::RemoteArm,
    session::Session,
    socket::{Address, Line},
};

/// Name of the channel driver.
pub const REMOTE: &str = "mcs.remote";

/// Watchdogs that there can be, ms.
const WATCHDOG_MS: [f64; 2] = [1.0, 4000.0];

/// How long a peer that is there may take to answer for the first time.
const FIRST_ANSWER: Duration = Duration::from_secs(1);

/// Arguments of the channel driver.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
struct RemoteArgs {
    /// Where the peer is: `udp:HOST:PORT` or `unix:PATH`.
    address: String,
    /// After this long without a command the peer brakes, and without an answer the servo takes power away, ms.
    #[serde(default = "watchdog_ms")]
    watchdog_ms: f64,
    /// What the peer's slots are commanded by: one for all, or one for each. By torque, where nothing is said.
    #[serde(default = "modes")]
    modes: Vec<Mode>,
}

fn modes() -> Vec<Mode> {
    vec![Mode::Torque]
}

fn watchdog_ms() -> f64 {
    100.0
}

impl RemoteArgs {
    fn address(&self, app: &App) -> Result<Address, Finding> {
        let address: Result<Address, _> = self.address.parse();
        let address = address.map_err(|error| {
            Finding::error("mcs::remote::address", error.to_string())
                .help("write `udp:HOST:PORT`, as in `udp:127.0.0.1:4560`, or `unix:PATH`")
        })?;
        Ok(address.within(&app.folder))
    }
}

/// Registers the channel driver [`REMOTE`].
pub fn register(drivers: &mut DriverRegistry) {
    drivers.driver(REMOTE, open).check(check);
}

/// Opens the way to a peer and meets it. One that is not there yet is a fault of the servo until it is.
fn open(cx: &Context, args: &Node) -> Result<Box<dyn ChannelDriver>, HandlerError> {
    let args: RemoteArgs = args.parse()?;
    let task = cx
        .config()
        .ok_or("a channel driver needs a task of the configuration")?;
    let address = args.address(cx.app()).map_err(|error| error.to_string())?;
    let model = mcs::arm(task, cx.app()).ok_or("the arm of the servo cannot be read")?;
    let speeds = model.joints().iter().map(|joint| joint.limits.velocity);
    let clock = cx.chassis().clock().clone();
    let watchdog =
        Duration::from_secs_f64(args.watchdog_ms.clamp(WATCHDOG_MS[0], WATCHDOG_MS[1]) / 1e3);
    let modes = Mode::for_slots(&args.modes, model.dof());
    let modes = modes.ok_or("`modes` does not fit the joints of the arm")?;
    let session = Session::new(number(&clock), speeds.collect(), watchdog).commanding(&modes);
    let line =
        Line::open(&address).map_err(|error| format!("cannot reach `{address}`: {error}"))?;
    let mut arm = RemoteArm::new(cx.name(), (address.clone(), line), session, clock);
    if let Err(doubt) = arm.meet(Duration::from_millis(5), FIRST_ANSWER) {
        tracing::warn!(task = cx.name(), "the peer at `{address}` {doubt}");
    }
    Ok(Box::new(arm))
}

/// A number that the next start of this task will not have.
fn number(clock: &Clock) -> u32 {
    let [a, b, c, d, ..] = clock.now().as_nanos().to_le_bytes();
    u32::from_le_bytes([a, b, c, d]) ^ std::process::id().rotate_left(16)
}

fn check(task: &TaskConfig, app: &App, args: &Node, findings: &mut Findings) {
    let Some(parsed) = findings.keep(args.parse::<RemoteArgs>()) else {
        return;
    };
    let at = |finding: Finding, key: &str| {
        let place = args.locate(key).or_else(|| args.place().cloned());
        finding.at(place.unwrap_or_else(|| task.place.clone()))
    };
    let address = match parsed.address(app) {
        Ok(address) => Some(address),
        Err(finding) => {
            findings.push(at(finding, "address"));
            None
        }
    };
    let [least, most] = WATCHDOG_MS;
    if !(least..=most).contains(&parsed.watchdog_ms) {
        let text = format!("`watchdog_ms` is {}", parsed.watchdog_ms);
        let finding = Finding::error("mcs::out_of_range", text);
        let finding = finding.help(format!("give a value from {least} to {most}"));
        findings.push(at(finding, "watchdog_ms"));
    }
    if let Some(model) = mcs::arm(task, app)
        && Mode::for_slots(&parsed.modes, model.dof()).is_none()
    {
        let (given, joints) = (parsed.modes.len(), model.dof());
        let text = format!("`modes` has {given} entries for {joints} slots");
        let finding = Finding::error("mcs::driver::modes", text);
        let help = "give one for all slots, or one for each: modes = [\"csp\"]";
        findings.push(at(finding.help(help), "modes"));
    }
    if app.time == TimeMode::Virtual {
        let text = format!(
            "task `{}` drives slots of another process, which does not know the app's virtual time",
            task.name
        );
        let finding = Finding::error("mcs::remote::virtual_time", text);
        let help = "run the app in real time, or name a driver of this program: `sim.arm`";
        let place = task.args.locate("driver");
        findings.push(
            finding
                .at(place.unwrap_or_else(|| task.place.clone()))
                .help(help),
        );
    }
    let mut before = app.tasks.iter().take_while(|other| other.name != task.name);
    let twin = before.find(|other| {
        let theirs = other.args.get("driver_args").map(Node::parse::<RemoteArgs>);
        let named = other.args.get("driver").and_then(Node::as_str) == Some(REMOTE);
        let theirs = theirs
            .and_then(Result::ok)
            .and_then(|args| args.address(app).ok());
        named && theirs.is_some() && theirs == address
    });
    if let Some(twin) = twin {
        let text = format!(
            "the peer at `{}` is driven by task `{}` already",
            parsed.address, twin.name
        );
        let finding = Finding::error("mcs::remote::taken", text);
        findings.push(at(
            finding.help("give each servo a peer of its own"),
            "address",
        ));
    }
}
