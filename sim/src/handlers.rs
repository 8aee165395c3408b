//! The simulator inside an app: the world's task, the channel driver and the frame source by name, and what a
//! configuration can get wrong about them.
//!
//! Drivers and their world share a chassis, for they exchange values through its memory. Cameras ask by message, and may
//! render on any chassis.

use std::path::Path;

use ctos::{
    Context,
    config::{App, Node, TaskConfig},
    diagnostic::{Finding, Findings},
    registry::Registry,
    task::HandlerError,
};
use mcs::driver::{ChannelDriver, DriverRegistry, NamedDriver};
use serde::Deserialize;
use vss::source::{FrameSource, FrameSources};

use crate::{
    cell::Cell,
    driver::SimArm,
    guide, hand,
    port::Port,
    scene_truth,
    source::{CameraArgs, SimCamera, world_task},
    world_task::{self, PERIODS_MS, WORLD, WorldArgs},
};

/// Name of the channel driver.
pub const ARM: &str = "sim.arm";

/// Name of the frame source.
pub const CAMERA: &str = "sim.camera";

/// Arguments of the channel driver.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
struct ArmArgs {
    /// The task that owns the world.
    #[serde(default = "world_task")]
    world: String,
    /// The arm; the only one, when none is named.
    arm: Option<String>,
    /// Names of joints of its model, in the order of the slots; all of them, when none is named.
    joints: Option<Vec<String>>,
    /// Names of sensors that the arm carries, or of furniture that feels, in the order of their numbers; none, when none is named.
    #[serde(default)]
    sensors: Vec<String>,
    /// Names of lasers that the arm carries: outputs after the sensors; none, when none is named.
    #[serde(default)]
    lasers: Vec<String>,
}

/// The joints of a driver: an arm of a cell, and joints of it by index.
struct Joints {
    arm: usize,
    joints: Vec<usize>,
}

/// Registers everything that the simulator offers: the event handler [`WORLD`], the channel driver
/// [`ARM`] and the frame source [`CAMERA`].
pub fn register(registry: &mut Registry, drivers: &mut DriverRegistry, sources: &mut FrameSources) {
    register_world(registry);
    scene_truth::register(registry);
    hand::register(registry);
    guide::register(registry);
    let arm = drivers.driver(ARM, open_arm);
    arm.slots(count_slots).check(check_arm);
    let camera = sources.source(CAMERA, |cx, name, args| {
        let source: Box<dyn FrameSource> = Box::new(SimCamera::new(cx, name, args)?);
        Ok(source)
    });
    // A frame source's own check does not know the configuration's folder, where cell files are; the app's check does.
    camera.check(|_, _, _| {});
    registry.app_check("sim::cameras", |app, _, findings| {
        check_cameras(app, findings)
    });
}

fn register_world(registry: &mut Registry) {
    world_task::register(registry).checked_args::<WorldArgs>(check_world);
}

/// The joints that `args` mean, in the world's cell.
fn joints(args: &ArmArgs, cell: &Cell) -> Result<Joints, Finding> {
    let arm = cell.arm(args.arm.as_deref())?;
    let all = cell.arms.get(arm).map_or(&[][..], |arm| arm.model.joints());
    let Some(names) = &args.joints else {
        let joints = (0..all.len()).collect();
        return Ok(Joints { arm, joints });
    };
    let refuse = |message: String| Finding::error("sim::arm::joints", message);
    let mut joints = Vec::new();
    for name in names {
        let Some(joint) = all.iter().position(|joint| joint.name == *name) else {
            let known = all.iter().map(|joint| joint.name.as_str());
            return Err(refuse(format!("the arm has no joint `{name}`")).suggest(name, known));
        };
        if joints.contains(&joint) {
            return Err(
                refuse(format!("joint `{name}` is named twice")).help("a joint has one slot")
            );
        }
        joints.push(joint);
    }
    if joints.is_empty() {
        return Err(refuse("no joint is named".to_owned())
            .help("leave `joints` out to drive all joints of the arm"));
    }
    Ok(Joints { arm, joints })
}

/// The sensors that `args` name, by index in the cell.
fn sensors(args: &ArmArgs, arm: usize, cell: &Cell) -> Result<Vec<usize>, Finding> {
    let carried = |name: &str| {
        let mut all = cell.sensors.iter();
        let wrist = all.position(|sensor| sensor.name == name && sensor.mount.arm == arm);
        let mut all = cell.plates.iter();
        let mut plate = || all.position(|plate| plate.name == name);
        wrist.or_else(|| Some(cell.sensors.len() + plate()?))
    };
    let names = args.sensors.iter();
    let found = names.map(|name| {
        carried(name).ok_or_else(|| {
            let text = format!("the arm carries no sensor `{name}`");
            let known = (0..).map_while(|index| cell.sensor(index));
            Finding::error("sim::arm::sensors", text).suggest(name, known)
        })
    });
    found.collect()
}

/// The lasers that `args` name, by index in the cell.
fn lasers(args: &ArmArgs, arm: usize, cell: &Cell) -> Result<Vec<usize>, Finding> {
    let carried = |name: &str| {
        let mut all = cell.lasers.iter();
        all.position(|laser| {
            laser.name == name && laser.mount.is_some_and(|mount| mount.arm == arm)
        })
    };
    let names = args.lasers.iter();
    let found = names.map(|name| {
        carried(name).ok_or_else(|| {
            let text = format!("the arm carries no laser `{name}`");
            let known = cell.lasers.iter().map(|laser| laser.name.as_str());
            Finding::error("sim::arm::sensors", text).suggest(name, known)
        })
    });
    found.collect()
}

/// The task called `world`, if it owns a world on the chassis of `task`.
fn world_of<'a>(world: &str, task: &TaskConfig, app: &'a App) -> Result<&'a TaskConfig, Finding> {
    let found = app.task(world).filter(|found| found.handler == WORLD);
    let Some(found) = found else {
        let worlds = app.tasks.iter().filter(|task| task.handler == WORLD);
        return Err(Finding::error(
            "sim::arm::no_world",
            format!("the driver of `{}` needs world `{world}`, which is no task with handler `{WORLD}`", task.name),
        )
        .help(format!(
            "add `[task.{world}]` with handler `{WORLD}` on chassis `{}`, or say `world = \"NAME\"` in `driver_args`",
            task.chassis
        ))
        .suggest(world, worlds.map(|task| task.name.as_str())));
    };
    if found.chassis != task.chassis {
        return Err(Finding::error(
            "sim::arm::other_chassis",
            format!(
                "`{}` is on chassis `{}` and its world `{world}` on chassis `{}`",
                task.name, task.chassis, found.chassis
            ),
        )
        .help("a driver reaches its world through the memory of their chassis: put both on the same one, on any processors"));
    }
    Ok(found)
}

/// Opens joints of an arm, as the driver's arguments say.
///
/// # Errors
/// Bad arguments, no such world on this chassis, a bad cell file, or joints that another task drives.
pub fn open_arm(cx: &Context, args: &Node) -> Result<Box<dyn ChannelDriver>, HandlerError> {
    let args: ArmArgs = args.parse()?;
    let task = cx
        .config()
        .ok_or("a channel driver needs a task of the configuration")?;
    let world = world_of(&args.world, task, cx.app())?;
    let WorldArgs { cell, .. } = world.args.parse()?;
    let cell = Cell::read(&cx.app().file_at(&cell))?;
    let Joints { arm, joints } = joints(&args, &cell)?;
    let sensing = sensors(&args, arm, &cell)?;
    let lighting = lasers(&args, arm, &cell)?;
    let port = Port::of(cx, &world.name, &cell);
    let driver = SimArm::new(cx.name(), (&world.name, &port, &cell), arm, &joints)?;
    let driver = driver.sensing(&cell, &sensing);
    Ok(Box::new(driver.lighting(&cell, &lighting)))
}

/// How many slots the driver will have, if its arguments and the world's are sound.
fn count_slots(app: &App, args: &Node) -> Option<usize> {
    let args: ArmArgs = args.parse().ok()?;
    let world = app.task(&args.world);
    let world = world.filter(|world| world.handler == WORLD)?;
    let own = joints(&args, &cell_of(world, app)?).ok()?;
    Some(own.joints.len())
}

/// Checks the arguments of [`open_arm`], and that no task before this one drives the same joints.
fn check_arm(task: &TaskConfig, app: &App, args: &Node, findings: &mut Findings) {
    let Some(parsed) = findings.keep(args.parse::<ArmArgs>()) else {
        return;
    };
    let at = |finding: Finding, key: &str| {
        let place = args.locate(key).or_else(|| args.place().cloned());
        match finding.place {
            Some(_) => finding,
            None => finding.at(place.unwrap_or_else(|| task.place.clone())),
        }
    };
    let world = match world_of(&parsed.world, task, app) {
        Ok(world) => world,
        Err(finding) => return findings.push(at(finding, "world")),
    };
    // What is wrong with the cell is said of the world.
    let Some(cell) = cell_of(world, app) else {
        return;
    };
    let own = match joints(&parsed, &cell) {
        Ok(own) => own,
        Err(finding) => {
            let key = if finding.code == "sim::arm::joints" {
                "joints"
            } else {
                "arm"
            };
            return findings.push(at(finding, key));
        }
    };
    if let Err(finding) = sensors(&parsed, own.arm, &cell) {
        findings.push(at(finding, "sensors"));
    }
    if let Err(finding) = lasers(&parsed, own.arm, &cell) {
        findings.push(at(finding, "lasers"));
    }
    let drivers = app.tasks.iter().flat_map(|other| {
        let drivers = NamedDriver::all_of(&other.args).into_iter();
        drivers.map(move |driver| (other, driver))
    });
    let before = drivers.take_while(|(other, driver)| {
        other.name != task.name || driver.args.place() != args.place()
    });
    for (other, theirs) in
        before.filter_map(|(other, driver)| Some((other, driven(&driver, world, &cell)?)))
    {
        let shared = own
            .joints
            .iter()
            .find(|joint| theirs.joints.contains(joint));
        let (true, Some(joint)) = (theirs.arm == own.arm, shared) else {
            continue;
        };
        let (arm, joint) = cell.arms.get(own.arm).map_or(("", ""), |arm| {
            let joint = arm.model.joints().get(*joint);
            (
                arm.name.as_str(),
                joint.map_or("", |joint| joint.name.as_str()),
            )
        });
        let finding = Finding::error(
            "sim::arm::taken",
            format!("joint `{joint}` of arm `{arm}` is driven by task `{}` already", other.name),
        )
        .help("name the joints of each with `joints = [...]` so that no two share one, or another `arm`");
        findings.push(at(finding, "joints"));
    }
}

/// The joints that a driver has in `world`, if it does and says so soundly.
fn driven(driver: &NamedDriver, world: &TaskConfig, cell: &Cell) -> Option<Joints> {
    let args: ArmArgs = (driver.name == ARM)
        .then(|| driver.args.parse().ok())
        .flatten()?;
    (args.world == world.name)
        .then(|| joints(&args, cell).ok())
        .flatten()
}

/// The cell of a world, if it is sound.
fn cell_of(world: &TaskConfig, app: &App) -> Option<Cell> {
    let args: WorldArgs = world.args.parse().ok()?;
    read_cell(&args.cell, app).ok()
}

fn read_cell(cell: &str, app: &App) -> Result<Cell, Findings> {
    let folder = Path::new(cell).parent().unwrap_or(Path::new(""));
    let model = |name: &str| app.read(folder.join(name));
    Cell::parse_with(&app.read(cell)?, &model)
}

fn check_world(args: &WorldArgs, task: &TaskConfig, app: &App, findings: &mut Findings) {
    let [least, most] = PERIODS_MS;
    if !(least..=most).contains(&args.period_ms) {
        let place = task.args.locate("period_ms");
        findings.push(
            Finding::error(
                "sim::world::period",
                format!(
                    "the period of world `{}` is {} ms",
                    task.name, args.period_ms
                ),
            )
            .at(place.unwrap_or_else(|| task.place.clone()))
            .help(format!("give a number from {least} to {most} ms")),
        );
    }
    check_cell(&args.cell, app, &task.args, findings);
    let mut before = app.tasks.iter().take_while(|other| other.name != task.name);
    let twin = before.find(|other| {
        let cell = other.args.get("cell").and_then(Node::as_str);
        other.handler == WORLD && cell == Some(&args.cell)
    });
    if let Some(twin) = twin {
        let place = task.args.locate("cell");
        findings.push(
            Finding::error(
                "sim::world::twin",
                format!("`{}` owns the arms of `{}` already", twin.name, args.cell),
            )
            .at(place.unwrap_or_else(|| task.place.clone()))
            .help(format!(
                "a cell has one world: let drivers and cameras name `{}`",
                twin.name
            )),
        );
    }
}

/// Checks every task that is a camera of this simulator, and that the task it asks is there.
fn check_cameras(app: &App, findings: &mut Findings) {
    for task in &app.tasks {
        let text = |key: &str| task.args.get(key).and_then(Node::as_str);
        let (Some(CAMERA), Some(camera)) = (text("source"), text("camera")) else {
            continue;
        };
        let args = task.args.get("args").cloned().unwrap_or_else(Node::table);
        check_camera(camera, app, &args, findings);
        let Ok(CameraArgs { world, scenes, .. }) = args.parse() else {
            continue;
        };
        let owner = app.task(&world).filter(|task| task.handler == WORLD);
        if let (Some(buffer), Some(owner)) = (&scenes, owner) {
            check_scenes((camera, buffer), (task, &args), owner, app, findings);
        }
        if owner.is_none() {
            let finding = Finding::error(
                "sim::camera::no_world",
                format!(
                    "camera `{camera}` asks `{world}`, which is no task with handler `{WORLD}`"
                ),
            )
            .help(format!(
                "add `[task.{world}]` with handler `{WORLD}`, or say `world = \"NAME\"` in the camera's arguments"
            ));
            findings.push(finding.at(task.place.clone()));
        }
    }
}

/// Checks that the world `owner` leaves scenes in `buffer`, on the host of the camera's task.
fn check_scenes(
    (camera, buffer): (&str, &str),
    (task, args): (&TaskConfig, &Node),
    owner: &TaskConfig,
    app: &App,
    findings: &mut Findings,
) {
    let place = args.locate("scenes").unwrap_or_else(|| task.place.clone());
    let left = owner.args.get("scenes").and_then(Node::as_str);
    if left != Some(buffer) {
        let text = format!(
            "camera `{camera}` reads snapshot buffer `{buffer}`, in which world `{}` leaves nothing",
            owner.name
        );
        let help = format!(
            "say `scenes = \"{buffer}\"` in the arguments of `{}`, too",
            owner.name
        );
        findings.push(
            Finding::error("sim::camera::no_scenes", text)
                .at(place)
                .help(help),
        );
        return;
    }
    let host = |task: &TaskConfig| {
        let mut chassis = app.chassis.iter();
        let own = chassis.find(|chassis| chassis.name == task.chassis);
        own.and_then(|chassis| chassis.host.clone())
    };
    if host(task) != host(owner) {
        let text = format!(
            "camera `{camera}` and world `{}` are on different hosts, which share no memory",
            owner.name
        );
        let help = "leave `scenes` out there: the camera then asks the world by message";
        findings.push(
            Finding::error("sim::camera::other_host", text)
                .at(place)
                .help(help),
        );
    }
}

/// Checks the arguments of a camera called `camera`, its cell file, and that the cell has it.
fn check_camera(camera: &str, app: &App, args: &Node, findings: &mut Findings) {
    if let Some(CameraArgs { cell, .. }) = findings.keep(args.parse())
        && let Some(cell) = check_cell(&cell, app, args, findings)
        && let Err(finding) = cell.camera(camera)
    {
        findings.push(placed(finding, args));
    }
}

fn check_cell(cell: &str, app: &App, args: &Node, findings: &mut Findings) -> Option<Cell> {
    match read_cell(cell, app) {
        Ok(cell) => Some(cell),
        Err(found) => {
            // A file that cannot be read has no place of its own: the key that names it has.
            for finding in found.into_sorted() {
                findings.push(placed(finding, args));
            }
            None
        }
    }
}

fn placed(finding: Finding, args: &Node) -> Finding {
    match (
        &finding.place,
        args.locate("cell").or_else(|| args.place().cloned()),
    ) {
        (None, Some(place)) => finding.at(place),
        _ => finding,
    }
}

#[cfg(test)]
mod tests;
