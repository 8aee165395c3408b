//! The arm as viewers draw it: the solids of its model where the measured joints put them, and what is measured at each joint;
//! with what its guards forbid, the distances that they keep and what is nearest, the forces that sensors read, and the way of its
//! tool that is planned.
//!
//! The state manager shows it, from what every servo tick leaves for readers anyway. So the servo neither knows nor does
//! anything of it, and nobody computes anything while nobody follows.

use std::sync::Arc;

use ctos::task::Context;
use nalgebra::Isometry3;
use scene::{Number, Part, Pose, Said, Seen, Solid, Source, Stage, View};

use super::{Link, stands, ways};
use crate::driver::{Power, Sensor, SensorKind};
use crate::guard::{GuardReport, Line, Nearest, Reaction, Sight};
use crate::model::{self, Data, FrameId, Model};
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
const FORCE: [u8; 3] = [219, 39, 119];
const MARGIN: [u8; 3] = [202, 138, 4];
/// Radius of what is drawn as a line, m.
const LINE: f64 = 0.003;
/// What is nearer than this is told in words, m.
const NEAR: f64 = 0.1;
/// How long a newton is drawn, and a newton metre, m.
const FORCE_SCALE: f64 = 0.01;
const MOMENT_SCALE: f64 = 0.1;
/// The numbers of a force-torque sensor: a force, then a moment.
const WRENCH: usize = 6;

/// What the state manager of the servo task `name` shows.
pub(super) fn stage(cx: &Context, name: &str, link: &Arc<Link>) -> Stage {
    Stage::new(Arm::new(cx, name, link))
}

struct Arm {
    cx: Context,
    link: Arc<Link>,
    planner: Planner,
    model: Arc<Model>,
    data: Data,
    /// Base, links and tool, and the force-torque sensors.
    arm: Vec<(Part, Where)>,
    /// What was shown last beside the arm: the outlines of guards, those that see something, and the motions under way.
    beside: Option<Beside>,
    sights: Vec<Arc<dyn Sight>>,
    /// Where all parts of the view are.
    places: Vec<Where>,
}

type Beside = (Vec<(String, Vec<Line>)>, Vec<(String, u64)>, Vec<u64>);

/// What carries a part of the view, and what is measured at it.
#[derive(Debug, Clone)]
enum Where {
    /// The base, without numbers.
    Base,
    /// A joint, with its numbers.
    Joint(usize),
    /// A joint or the base, without numbers.
    With(Option<usize>),
    /// The tool, with what is read at it.
    Tool,
    /// A frame of the arm, or its last link, with the numbers of a force-torque sensor from this one on.
    Sensor(Option<FrameId>, usize),
    /// Where something is nearest, by the index of the guard that sees it.
    Nearest(usize),
}

impl Arm {
    fn new(cx: &Context, name: &str, link: &Arc<Link>) -> Self {
        let planner = link.planner.clone();
        let model = planner.model().clone();
        Self {
            cx: cx.clone(),
            arm: parts(name, &model, link),
            beside: None,
            sights: Vec::new(),
            places: Vec::new(),
            data: model.data(),
            link: Arc::clone(link),
            planner,
            model,
        }
    }

    /// The margins that guards keep: the solids of each link, grown by it, and what is nearest to any.
    fn margins(&self, sights: &[(String, Arc<dyn Sight>)]) -> Vec<(Part, Where)> {
        let mut parts = Vec::new();
        for (index, (name, sight)) in sights.iter().enumerate() {
            let margin = sight.margin();
            let carried = self.arm.iter().filter_map(|(part, place)| match place {
                Where::Base => Some((part, None)),
                Where::Joint(joint) => Some((part, Some(*joint))),
                _ => None,
            });
            for (part, joint) in carried {
                let own = self.model.shapes().iter();
                let own = own.filter(|shape| shape.carrier == joint);
                let solids: Vec<Solid> = own.map(|shape| grown(&shape.solid, margin)).collect();
                if !solids.is_empty() {
                    let part = Part {
                        name: format!("{name} margin of {}", part.name),
                        parent: Some(part.name.clone()),
                        kind: "margin".to_owned(),
                        solids,
                        colour: MARGIN,
                        numbers: Vec::new(),
                    };
                    parts.push((part, Where::With(joint)));
                }
            }
            let number = |name: &str| number(name, "m", 1e-4);
            let part = Part {
                name: format!("{name} nearest"),
                parent: self.arm.first().map(|(base, _)| base.name.clone()),
                kind: "nearest".to_owned(),
                // After the distance: the way from one to the other.
                solids: vec![Solid::Vector {
                    first: 1,
                    scale: 1.0,
                    turns: false,
                }],
                colour: MARGIN,
                numbers: ["distance", "x", "y", "z"].map(number).into(),
            };
            parts.push((part, Where::Nearest(index)));
        }
        parts
    }

    /// What is nearest, if it is near enough to be told in words.
    fn near(&self, q: &[f64]) -> Option<String> {
        let all = self.sights.iter().filter_map(|sight| sight.nearest(q));
        let near = all.min_by(|one, other| one.distance.total_cmp(&other.distance))?;
        let [one, other] = near.names;
        (near.distance < NEAR).then(|| format!("{one} is near {other}"))
    }
}

impl Source for Arm {
    fn view(&mut self) -> Option<View> {
        let under_way = self.link.ways.under_way(&self.link.port.status().ended);
        let ids = under_way.iter().map(|(id, _)| *id).collect();
        let sights = self.link.guards.sights();
        let seeing = sights.iter();
        let seeing = seeing.map(|(name, sight)| (name.clone(), sight.margin().to_bits()));
        let beside = (self.link.guards.outlines(), seeing.collect(), ids);
        let same = self
            .sights
            .iter()
            .zip(&sights)
            .all(|(one, (_, other))| Arc::ptr_eq(one, other));
        if same && self.beside.as_ref() == Some(&beside) {
            return None;
        }
        let mut parts = self.arm.clone();
        let base = parts.first().map(|(base, _)| base.name.clone());
        let drawn = |name: String, kind: &str, colour, solids| {
            let part = Part {
                name,
                parent: base.clone(),
                kind: kind.to_owned(),
                solids,
                colour,
                numbers: Vec::new(),
            };
            (part, Where::Base)
        };
        let guards = beside.0.iter();
        parts.extend(guards.map(|(name, outline)| {
            let lines = outline.iter().map(|[a, b]| line(*a, *b)).collect();
            drawn(format!("guard {name}"), "guard", GUARD, lines)
        }));
        parts.extend(self.margins(&sights));
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
        self.sights = sights.into_iter().map(|(_, sight)| sight).collect();
        let (parts, places) = parts.into_iter().unzip();
        self.places = places;
        Some(View {
            parts,
            ..View::default()
        })
    }

    fn look(&mut self) -> Seen {
        let status = self.link.port.status();
        let q = &status.position[..];
        let joint = |joint: usize| {
            let number = |of: &[f64]| of.get(joint).copied().unwrap_or(f64::NAN);
            let (position, setpoint) = (number(&status.position), number(&status.setpoint));
            let (velocity, torque) = (number(&status.velocity), number(&status.torque));
            vec![position, setpoint - position, velocity, torque]
        };
        // What nobody reads any more is no number.
        let sensors = self.link.sensors.iter().zip(0_u32..);
        let stale = sensors.flat_map(|(sensor, bit)| {
            let stale = status.stale.checked_shr(bit).unwrap_or(0) & 1 == 1;
            std::iter::repeat_n((stale, is_wrench(sensor)), sensor.kind.width())
        });
        let read = status.sensors.iter().zip(stale);
        let read =
            read.map(|(value, (stale, wrench))| (if stale { f64::NAN } else { *value }, wrench));
        let sensed: Vec<(f64, bool)> = read.collect();
        self.model.forward(&mut self.data, q);
        let tool = self.planner.tool_pose(q);
        let base = stands::base(&self.cx, self.link.stands.as_ref()).isometry();
        let state = |place: &Where| {
            let (placed, numbers) = match place {
                Where::Base => (self.data.carrier(None).isometry(), Vec::new()),
                Where::With(carrier) => (self.data.carrier(*carrier).isometry(), Vec::new()),
                Where::Joint(index) => (self.data.carrier(Some(*index)).isometry(), joint(*index)),
                Where::Tool => {
                    let own = sensed.iter().filter(|(_, wrench)| !wrench);
                    (tool, own.map(|(value, _)| *value).collect())
                }
                Where::Sensor(frame, first) => {
                    let own = sensed.iter().skip(*first).take(WRENCH);
                    let last = || self.data.carrier(self.model.at(self.model.tip()).carrier);
                    let named = frame.map(|frame| self.data.placement(&self.model, frame));
                    let placed = named.unwrap_or_else(last).isometry();
                    (placed, own.map(|(value, _)| *value).collect())
                }
                Where::Nearest(index) => nearest(self.sights.get(*index), q),
            };
            (pose(&(base * placed)), numbers)
        };
        Seen {
            states: self.places.iter().map(state).collect(),
            said: said(&self.link, &status, self.near(q)),
            pictures: Vec::new(),
        }
    }
}

/// Where two solids are nearest: a point of one, their distance, and the way to the point of the other, in the base frame.
fn nearest(sight: Option<&Arc<dyn Sight>>, q: &[f64]) -> (Isometry3<f64>, Vec<f64>) {
    let Some(Nearest { distance, ends, .. }) = sight.and_then(|sight| sight.nearest(q)) else {
        return (Isometry3::identity(), vec![f64::NAN, 0.0, 0.0, 0.0]);
    };
    let [from, to] = ends.unwrap_or_default();
    let way = [0, 1, 2].map(|axis| to[axis] - from[axis]);
    let numbers = std::iter::once(distance).chain(way).collect();
    (Isometry3::translation(from[0], from[1], from[2]), numbers)
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
    grown(solid, 0.0)
}

/// A solid, and what is no farther from it than `margin`, m. Edges of boxes are not rounded.
fn grown(solid: &model::Solid, margin: f64) -> Solid {
    match solid {
        model::Solid::Capsule { a, b, radius } => Solid::Capsule {
            a: (*a).into(),
            b: (*b).into(),
            radius: radius + margin,
        },
        model::Solid::Block { at, half } => Solid::Block {
            pose: pose(&at.isometry()),
            half: half.add_scalar(margin).into(),
        },
        model::Solid::Hull { at, hull } => Solid::Hull {
            pose: pose(&at.isometry()),
            corners: {
                let out = hull.rounding() + margin;
                let corners = hull.corners().iter();
                corners
                    .map(|corner| (corner + corner.cap_magnitude(out)).into())
                    .collect()
            },
            triangles: {
                let all = hull.triangles().into_iter();
                // There are few corners.
                all.map(|one| one.map(|corner| corner as u32)).collect()
            },
        },
    }
}

fn number(name: &str, unit: &str, resolution: f64) -> Number {
    Number {
        name: name.to_owned(),
        unit: unit.to_owned(),
        resolution,
    }
}

fn is_wrench(sensor: &Sensor) -> bool {
    sensor.kind == SensorKind::ForceTorque
}

/// What a sensor reads, number by number.
fn numbers(sensor: &Sensor) -> Vec<Number> {
    let name = &sensor.name;
    match sensor.kind {
        SensorKind::ForceTorque => {
            let of = |what: &'static str, unit: &'static str, resolution| {
                let axes = ["x", "y", "z"].into_iter();
                axes.map(move |axis| number(&format!("{what} {axis}"), unit, resolution))
            };
            of("force", "N", 0.1)
                .chain(of("moment", "N m", 0.01))
                .collect()
        }
        SensorKind::SpaceMouse => {
            let axes = ["x", "y", "z", "about x", "about y", "about z"].into_iter();
            axes.map(|axis| number(&format!("{name} {axis}"), "", 0.01))
                .collect()
        }
        kind => vec![number(name, kind.unit(), 1e-3)],
    }
}

/// A part for each force-torque sensor, with arrows for what acts on it.
fn wrenches(model: &Model, link: &Link, tool: &str) -> Vec<(Part, Where)> {
    let mut parts = Vec::new();
    let mut first = 0;
    for sensor in &link.sensors {
        if is_wrench(sensor) {
            let named = link.sensor_frames.get(&sensor.name);
            let named = named.and_then(|name| model.frame(name));
            let vector = |first, scale, turns| Solid::Vector {
                first,
                scale,
                turns,
            };
            let part = Part {
                name: sensor.name.clone(),
                parent: Some(tool.to_owned()),
                kind: "force".to_owned(),
                solids: vec![vector(0, FORCE_SCALE, false), vector(3, MOMENT_SCALE, true)],
                colour: FORCE,
                numbers: numbers(sensor),
            };
            parts.push((part, Where::Sensor(named, first)));
        }
        first += sensor.kind.width();
    }
    parts
}

/// The base, a part for each joint with what its frame carries, and the tool with what the sensors read.
fn parts(name: &str, model: &Model, described: &Link) -> Vec<(Part, Where)> {
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
    let base = Part {
        name: link(None),
        kind: "base".to_owned(),
        solids: solids(None),
        colour: BASE,
        ..Part::default()
    };
    let mut parts = vec![(base, Where::Base)];
    for (index, joint) in model.joints().iter().enumerate() {
        let (unit, effort) = (joint.kind.unit(), joint.kind.effort_unit());
        let speed = format!("{unit}/s");
        let numbers = [
            (joint.name.as_str(), unit, 1e-5),
            ("error", unit, 1e-5),
            ("velocity", &speed, 1e-3),
            ("effort", effort, 0.05),
        ];
        let number = |(name, unit, resolution): (&str, &str, f64)| number(name, unit, resolution);
        let part = Part {
            name: link(Some(index)),
            parent: Some(link(joint.parent)),
            kind: "link".to_owned(),
            solids: solids(Some(index)),
            colour: LINKS[index % LINKS.len()],
            numbers: numbers.map(number).into(),
        };
        parts.push((part, Where::Joint(index)));
    }
    let carrier = link(model.at(model.tip()).carrier);
    let read = described.sensors.iter().filter(|one| !is_wrench(one));
    let tool = Part {
        name: "tool".to_owned(),
        parent: Some(carrier.clone()),
        kind: "tool".to_owned(),
        solids: vec![Solid::Axes(AXES)],
        colour: TOOL,
        numbers: read.flat_map(numbers).collect(),
    };
    parts.push((tool, Where::Tool));
    parts.extend(wrenches(model, described, &carrier));
    parts
}

fn said(link: &Link, status: &ServoStatus, near: Option<String>) -> Said {
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
    let words = match near {
        Some(near) => format!("{words}; {near}"),
        None => words,
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
