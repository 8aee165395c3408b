//! The arm as viewers draw it: the solids of its model where the measured joints put them, and what is measured at each joint;
//! with what its guards forbid, and the way of its tool that is planned.
//!
//! The state manager shows it, from what every servo tick leaves for readers anyway. So the servo neither knows nor does
//! anything of it, and nobody computes anything while nobody follows.

use std::sync::Arc;

use nalgebra::Isometry3;
use scene::{Number, Part, Pose, Said, Seen, Solid, Source, Stage, View};

use super::{Link, ways};
use crate::driver::{Power, Sensor, SensorKind};
use crate::guard::{GuardReport, Line, Reaction};
use crate::model::{self, Data, Model};
use crate::servo::{MotionPhase, ServoStatus};
use crate::trajectory::Planner;

/// The length of the drawn axes of the tool, m.
const AXES: f64 = 0.12;
/// The base and the links in turn: red, green, blue.
const BASE: [u8; 3] = [92, 99, 112];
const LINKS: [[u8; 3]; 2] = [[222, 221, 214], [201, 203, 200]];
const TOOL: [u8; 3] = [217, 119, 6];
const GUARD: [u8; 3] = [200, 62, 62];
const WAY: [u8; 3] = [37, 99, 235];
/// Radius of what is drawn as a line, m.
const LINE: f64 = 0.003;

/// What the state manager of the servo task `name` shows.
pub(super) fn stage(name: &str, link: &Arc<Link>) -> Stage {
    Stage::new(Arm::new(name, link))
}

struct Arm {
    link: Arc<Link>,
    planner: Planner,
    model: Arc<Model>,
    data: Data,
    /// Base, links and tool.
    arm: Vec<Part>,
    /// What was shown last beside the arm: the outlines of guards, and the motions under way.
    beside: Option<Beside>,
}

type Beside = (Vec<(String, Vec<Line>)>, Vec<u64>);

impl Arm {
    fn new(name: &str, link: &Arc<Link>) -> Self {
        let planner = link.planner.clone();
        let model = planner.model().clone();
        Self {
            arm: parts(name, &model, &link.sensors),
            beside: None,
            data: model.data(),
            link: Arc::clone(link),
            planner,
            model,
        }
    }

    /// Where the parts are at joint positions `q`, in the order of the view.
    fn poses(&mut self, q: &[f64]) -> Vec<Pose> {
        self.model.forward(&mut self.data, q);
        let joints = (0..self.model.dof()).map(Some);
        let carriers = std::iter::once(None).chain(joints);
        let mut poses: Vec<Pose> = carriers
            .map(|carrier| pose(&self.data.carrier(carrier).isometry()))
            .collect();
        poses.push(pose(&self.planner.tool_pose(q)));
        // What stands beside the arm is in the frame of its base.
        let (guards, ways) = self.beside.as_ref().map_or((0, 0), |(guards, ways)| {
            (guards.len(), usize::from(!ways.is_empty()))
        });
        let base = pose(&self.data.carrier(None).isometry());
        poses.extend(std::iter::repeat_n(base, guards + ways));
        poses
    }
}

impl Source for Arm {
    fn view(&mut self) -> Option<View> {
        let under_way = self.link.ways.under_way(&self.link.port.status().ended);
        let ids = under_way.iter().map(|(id, _)| *id).collect();
        let beside = (self.link.guards.outlines(), ids);
        if self.beside.as_ref() == Some(&beside) {
            return None;
        }
        let mut parts = self.arm.clone();
        let base = parts.first().map(|base| base.name.clone());
        let drawn = |name: String, kind: &str, colour, solids| Part {
            name,
            parent: base.clone(),
            kind: kind.to_owned(),
            solids,
            colour,
            numbers: Vec::new(),
        };
        let guards = beside.0.iter();
        parts.extend(guards.map(|(name, outline)| {
            let lines = outline.iter().map(|[a, b]| line(*a, *b)).collect();
            drawn(format!("guard {name}"), "guard", GUARD, lines)
        }));
        let mut way = Vec::new();
        for (_, segment) in &under_way {
            let points = ways::points(segment, &mut self.planner);
            let ends = points.iter().zip(points.iter().skip(1));
            way.extend(ends.map(|(from, to)| line(*from, *to)));
        }
        if !under_way.is_empty() {
            parts.push(drawn("planned path".to_owned(), "path", WAY, way));
        }
        self.beside = Some(beside);
        Some(View {
            parts,
            ..View::default()
        })
    }

    fn look(&mut self) -> Seen {
        let status = self.link.port.status();
        let numbers = |joint: usize| {
            let number = |of: &[f64]| of.get(joint).copied().unwrap_or(f64::NAN);
            let (position, setpoint) = (number(&status.position), number(&status.setpoint));
            let (velocity, torque) = (number(&status.velocity), number(&status.torque));
            vec![position, setpoint - position, velocity, torque]
        };
        let joints = self.model.dof();
        // What nobody reads any more is no number.
        let sensors = self.link.sensors.iter().zip(0_u32..);
        let stale = sensors.flat_map(|(sensor, bit)| {
            let stale = status.stale.checked_shr(bit).unwrap_or(0) & 1 == 1;
            std::iter::repeat_n(stale, sensor.kind.width())
        });
        let read = status.sensors.iter().zip(stale);
        let sensed: Vec<f64> = read
            .map(|(value, stale)| if stale { f64::NAN } else { *value })
            .collect();
        let poses = self.poses(&status.position);
        let states = poses.into_iter().enumerate().map(|(part, pose)| {
            let numbers = match part.checked_sub(1) {
                Some(joint) if joint < joints => numbers(joint),
                Some(tool) if tool == joints => sensed.clone(),
                _ => Vec::new(),
            };
            (pose, numbers)
        });
        Seen {
            states: states.collect(),
            said: said(&self.link, &status),
            pictures: Vec::new(),
        }
    }
}

fn pose(placed: &Isometry3<f64>) -> Pose {
    let turn = placed.rotation.coords;
    Pose {
        at: placed.translation.vector.into(),
        turn: turn.into(),
    }
}

fn line(a: [f64; 3], b: [f64; 3]) -> Solid {
    Solid::Capsule { a, b, radius: LINE }
}

fn solid(solid: &model::Solid) -> Solid {
    match solid {
        model::Solid::Capsule { a, b, radius } => Solid::Capsule {
            a: (*a).into(),
            b: (*b).into(),
            radius: *radius,
        },
        model::Solid::Block { at, half } => Solid::Block {
            pose: pose(&at.isometry()),
            half: (*half).into(),
        },
        // Viewers know no meshes: the box around it.
        model::Solid::Hull { at, hull } => Solid::Block {
            pose: pose(&at.isometry()),
            half: (*hull.half()).into(),
        },
    }
}

/// What a sensor reads, number by number.
fn numbers(sensor: &Sensor) -> Vec<Number> {
    let number = |name: String, unit: &str, resolution| Number {
        name,
        unit: unit.to_owned(),
        resolution,
    };
    let name = &sensor.name;
    match sensor.kind {
        SensorKind::ForceTorque => {
            let of = |what: &'static str, unit: &'static str, resolution| {
                let axes = ["x", "y", "z"].into_iter();
                axes.map(move |axis| number(format!("{name} {what} {axis}"), unit, resolution))
            };
            of("force", "N", 0.1)
                .chain(of("moment", "N m", 0.01))
                .collect()
        }
        SensorKind::SpaceMouse => {
            let axes = ["x", "y", "z", "about x", "about y", "about z"].into_iter();
            axes.map(|axis| number(format!("{name} {axis}"), "", 0.01))
                .collect()
        }
        kind => vec![number(name.clone(), kind.unit(), 1e-3)],
    }
}

/// The base, a part for each joint with what its frame carries, and the tool with what the sensors read.
fn parts(name: &str, model: &Model, sensors: &[Sensor]) -> Vec<Part> {
    let solids = |carrier: Option<usize>| {
        let own = model.shapes().iter();
        let own = own.filter(|shape| shape.carrier == carrier);
        own.map(|shape| solid(&shape.solid)).collect()
    };
    // The frame of a joint is its link's; the first of all is the base.
    let link = |carrier: Option<usize>| {
        let mut frames = model.frames().iter();
        let frame = frames.find(|frame| frame.carrier == carrier);
        frame.map_or_else(|| name.to_owned(), |frame| frame.name.clone())
    };
    let mut parts = vec![Part {
        name: link(None),
        kind: "base".to_owned(),
        solids: solids(None),
        colour: BASE,
        ..Part::default()
    }];
    for (index, joint) in model.joints().iter().enumerate() {
        let (unit, effort) = (joint.kind.unit(), joint.kind.effort_unit());
        let speed = format!("{unit}/s");
        let numbers = [
            (joint.name.as_str(), unit, 1e-5),
            ("error", unit, 1e-5),
            ("velocity", &speed, 1e-3),
            ("effort", effort, 0.05),
        ];
        let number = |(name, unit, resolution): (&str, &str, f64)| Number {
            name: name.to_owned(),
            unit: unit.to_owned(),
            resolution,
        };
        parts.push(Part {
            name: link(Some(index)),
            parent: Some(link(joint.parent)),
            kind: "link".to_owned(),
            solids: solids(Some(index)),
            colour: LINKS[index % LINKS.len()],
            numbers: numbers.map(number).into(),
        });
    }
    parts.push(Part {
        name: "tool".to_owned(),
        parent: Some(link(model.at(model.tip()).carrier)),
        kind: "tool".to_owned(),
        solids: vec![Solid::Axes(AXES)],
        colour: TOOL,
        numbers: sensors.iter().flat_map(numbers).collect(),
    });
    parts
}

fn said(link: &Link, status: &ServoStatus) -> Said {
    let fault = link.fault();
    let words = match (&fault, status.power) {
        (Some(fault), _) => format!("power was taken away: {fault}"),
        (None, _) if status.stopped => "stopped; it holds until somebody resumes".to_owned(),
        (None, Power::Off) => "power is off, brakes hold".to_owned(),
        (None, Power::Braked) => "power is on, brakes hold".to_owned(),
        (None, Power::Released) => match status.motion.phase {
            MotionPhase::Moving => "moves".to_owned(),
            MotionPhase::Stopping => "comes to rest".to_owned(),
            MotionPhase::Settling => "settles".to_owned(),
            _ => "holds its position".to_owned(),
        },
    };
    let words = match guarded(status) {
        Some(guard) if fault.is_none() => format!("{words}; {guard}"),
        _ => words,
    };
    Said {
        words,
        fault: fault.is_some() || status.stopped,
        job: None,
    }
}

/// What a guard did to the latest motion, and why.
fn guarded(status: &ServoStatus) -> Option<String> {
    let found = status.guard?;
    if found.motion != status.motion.id {
        return None;
    }
    let does = match found.reaction {
        Reaction::Stop => "ends its motion",
        Reaction::Retreat => "ends its motion and leads it back",
        Reaction::Report => "reports",
    };
    let GuardReport {
        guard, measured, ..
    } = found;
    Some(format!("guard `{guard}` {does}: {measured}"))
}
