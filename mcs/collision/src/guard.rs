//! The kind of guard `collision`: every tick looks at the arm against itself, the other arms of its chassis and the
//! room, and stops it so early that it comes to rest before it touches anything.
//!
//! It counts with the braking that the servo would do now, which begins with the next tick. A neighbour's begins a tick
//! later still, because what a neighbour shows may be one tick old. A neighbour has to have the same guard:
//! each arm stops itself. Between what is commanded and where the arm is lies the tracking error, for which the margin
//! has room.

use std::collections::BTreeMap;
use std::sync::{Arc, Weak};

use ctos::config::Node;
use ctos::task::{Context, HandlerError};
use mcs::guard::{Guard, GuardSettings, Line, Neighbour, Seen, Shown, Sight, Words, edges};
use mcs::latest::Latest;
use mcs::model::file::{AtText, ShapeText};
use mcs::model::{Placement, Solid};
use mcs::words;
use nalgebra::Vector3;
use serde::Deserialize;

use crate::scene::{Looked, Near, Scene};
use crate::sight;

/// Its name in configurations.
pub const KIND: &str = "collision";

/// Arguments of the guard.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
struct Args {
    /// The distance that is kept, m.
    #[serde(default = "margin")]
    margin: f64,
    /// The other arms.
    #[serde(default)]
    others: Vec<Other>,
    /// What stands in the room.
    #[serde(default)]
    room: Vec<Furniture>,
}

fn margin() -> f64 {
    0.02
}

/// Another arm.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
struct Other {
    /// Its servo's task, on the same chassis.
    servo: String,
    /// Where its base frame stands in that of this arm.
    #[serde(default)]
    at: AtText,
}

/// Something of the room.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
struct Furniture {
    /// Its name, for messages.
    name: String,
    /// Its form in the base frame of this arm.
    shapes: Vec<ShapeText>,
    /// The distance that a solid of this arm keeps from it instead of the margin, m, by the solid's name. Below zero it may reach
    /// into it so far.
    #[serde(default)]
    near: BTreeMap<String, f64>,
}

/// What a recipe of this guard says there is around an arm, in its base frame.
#[derive(Debug, Clone)]
pub struct Surroundings {
    /// The distance that is kept, m.
    pub margin: f64,
    /// The other arms: the servo's task of each, and where its base frame stands.
    pub others: Vec<(String, Placement)>,
    /// The solids of the room, by name.
    pub room: Vec<(String, Solid)>,
    /// Other distances than the margin, m: that of a solid of the arm from a piece of the room, each by name. Who watches or
    /// looks ahead goes by them; who plans a way keeps the margin.
    pub near: Vec<(String, String, f64)>,
}

impl Surroundings {
    /// Reads them from the arguments of a recipe.
    ///
    /// # Errors
    /// What is wrong with them.
    pub fn read(args: &Node) -> Result<Self, HandlerError> {
        let args: Args = args.parse()?;
        if !(0.0..=1.0).contains(&args.margin) {
            return Err(format!("`margin` is 0 to 1 m, not {}", args.margin).into());
        }
        let others = args.others.into_iter();
        let (mut room, mut near) = (Vec::new(), Vec::new());
        for piece in args.room {
            for (solid, distance) in piece.near {
                if !(-1.0..=args.margin).contains(&distance) {
                    let text = format!(
                        "`near.{solid}` of `{}` is {distance}: give -1 m to the margin",
                        piece.name
                    );
                    return Err(text.into());
                }
                near.push((solid, piece.name.clone(), distance));
            }
            for shape in &piece.shapes {
                let solid = shape
                    .solid()
                    .map_err(|what| format!("`{}`: {what}", piece.name))?;
                room.push((piece.name.clone(), solid));
            }
        }
        Ok(Self {
            margin: args.margin,
            others: others
                .map(|other| (other.servo, other.at.placement()))
                .collect(),
            room,
            near,
        })
    }
}

/// What the guard of a servo found, for tasks of its chassis.
#[derive(Debug)]
pub struct Findings {
    /// The names of both solids of each pair.
    pub names: Vec<[String; 2]>,
    latest: Latest,
}

/// What a servo's task shares: each is gone with its guard.
type All = Vec<Weak<Findings>>;

/// A finding as [`Findings::read`] hands it out.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Found {
    /// The pair that is nearest, by index in [`Findings::names`], and its distance, m.
    pub nearest: Option<(usize, f64)>,
    /// How often a motion was found to end in a collision.
    pub stops: u64,
    /// The pair of the latest such motion.
    pub last: Option<usize>,
}

impl Findings {
    /// Where the guards of a servo's task share them.
    fn key(servo: &str) -> String {
        format!("mcs.collision/{servo}")
    }

    /// Those of all guards of this kind that a servo's task has.
    #[must_use]
    pub fn of(cx: &Context, servo: &str) -> Vec<Arc<Self>> {
        let all = cx.shared::<All>(&Self::key(servo));
        all.map_or_else(Vec::new, |all| {
            all.iter().filter_map(Weak::upgrade).collect()
        })
    }

    /// Shares those of one more guard of the servo's task.
    fn share(findings: &Arc<Self>, cx: &Context, servo: &str) {
        let mut all: All = Self::of(cx, servo).iter().map(Arc::downgrade).collect();
        all.push(Arc::downgrade(findings));
        cx.share(&Self::key(servo), Arc::new(all));
    }

    fn write(&self, found: &Found) {
        let index = |pair: Option<usize>| pair.map_or(-1.0, |pair| pair as f64);
        let (pair, distance) = found.nearest.unzip();
        let distance = distance.unwrap_or(f64::INFINITY);
        let stops = found.stops as f64;
        self.latest
            .write([index(pair), distance, stops, index(found.last)]);
    }

    /// What the latest tick found.
    #[must_use]
    pub fn read(&self) -> Found {
        let mut row = [-1.0; 4];
        self.latest.read(&mut row);
        let [pair, distance, stops, last] = row;
        // All are small whole numbers.
        let index = |number: f64| (number >= 0.0).then_some(number as usize);
        Found {
            nearest: index(pair).map(|pair| (pair, distance)),
            stops: stops as u64,
            last: index(last),
        }
    }
}

/// A neighbour whose servo shows nothing new for longer than this is not counted with any more: as the servo's own
/// `following_timeout_s`, s.
const SILENCE: f64 = 0.1;

/// Another arm, and whether its servo still goes on.
struct Watched {
    arm: Neighbour,
    servo: Words,
    /// The ticks of its servo as they were seen last, and for how many of one's own they have been so.
    ticks: u64,
    unchanged: u32,
}

impl Watched {
    /// What it shows, or whose silence keeps that from being known.
    fn look(&mut self, period: f64) -> Result<Shown, Words> {
        let shown = self.arm.read();
        self.unchanged = match shown.ticks == self.ticks {
            true => self.unchanged.saturating_add(1),
            false => 0,
        };
        self.ticks = shown.ticks;
        let (servo, silent) = (&self.servo, f64::from(self.unchanged) * period);
        if shown.ticks == 0 {
            return Err(words!(
                "where the arm of `{servo}` is is not known: it has not begun"
            ));
        }
        if silent > SILENCE {
            return Err(words!(
                "where the arm of `{servo}` is is not known: it has shown nothing for {silent:.3} s"
            ));
        }
        Ok(shown)
    }
}

/// The guard.
pub struct Collision {
    scene: Scene,
    others: Vec<Watched>,
    findings: Arc<Findings>,
    found: Found,
    /// Of the room, as viewers draw it.
    outline: Vec<Line>,
    sight: Arc<sight::Seen>,
}

/// How far from the arm's base the outline of something large, a floor or a wall, is drawn, along each axis, m.
const DRAWN: f64 = 1.5;

/// A solid as viewers draw what a guard forbids: the edges of a box, or of that around a hull; the axis of a capsule.
fn outline(solid: &Solid) -> Vec<Line> {
    let near = |point: Vector3<f64>| point.map(|along| along.clamp(-DRAWN, DRAWN)).into();
    let (at, half) = match solid {
        Solid::Capsule { a, b, .. } => return vec![[near(*a), near(*b)]],
        Solid::Block { at, half } => (at, *half),
        Solid::Hull { at, hull } => (at, *hull.half()),
    };
    let placed = |corner: [f64; 3]| near(at.rotation * Vector3::from(corner) + at.origin);
    let edges = edges((-half).into(), half.into()).into_iter();
    edges.map(|edge| edge.map(placed)).collect()
}

/// Makes the guard from the recipe's arguments.
///
/// # Errors
/// What is wrong with them.
pub fn build(settings: &GuardSettings<'_>) -> Result<Box<dyn Guard>, HandlerError> {
    let Surroundings {
        margin,
        others: named,
        room,
        near,
    } = Surroundings::read(settings.args)?;
    if settings.model.shapes().is_empty() {
        let name = settings.model.name();
        return Err(
            format!("nothing is said of the form of `{name}`: its model has no shapes").into(),
        );
    }
    let mut others = Vec::new();
    for (servo, at) in named {
        if servo == settings.servo {
            return Err(format!("`{servo}` is this arm itself").into());
        }
        let watched = Watched {
            arm: settings.around.neighbour(&servo)?,
            servo: servo.as_str().into(),
            ticks: 0,
            unchanged: 0,
        };
        others.push((watched, at));
    }
    let own = (Arc::clone(settings.model), Placement::identity());
    let arms = others
        .iter()
        .map(|(other, at)| (Arc::clone(&other.arm.model), *at));
    let outline = room.iter().flat_map(|(_, solid)| outline(solid)).collect();
    let mut scene = Scene::new(std::iter::once(own).chain(arms), room, margin);
    for (solid, piece, distance) in near {
        if !scene.keep(&solid, &piece, distance) {
            let name = settings.model.name();
            return Err(
                format!("`{name}` has no solid `{solid}`, which may be near `{piece}`").into(),
            );
        }
    }
    let findings = Arc::new(Findings {
        names: scene.names(),
        latest: Latest::new(&[-1.0, f64::INFINITY, 0.0, -1.0]),
    });
    if let Some(cx) = settings.cx {
        Findings::share(&findings, cx, settings.servo);
    }
    let sight = Arc::new(sight::Seen {
        scene: scene.clone(),
        others: others.iter().map(|(other, _)| other.arm.clone()).collect(),
        findings: Arc::clone(&findings),
        margin,
    });
    Ok(Box::new(Collision {
        sight,
        scene,
        others: others.into_iter().map(|(other, _)| other).collect(),
        findings,
        found: Found {
            nearest: None,
            stops: 0,
            last: None,
        },
        outline,
    }))
}

impl Collision {
    fn told(&self, near: &Near) -> Words {
        let [one, other] = match self.findings.names.get(near.pair) {
            Some([one, other]) => [one.as_str(), other.as_str()],
            None => ["?"; 2],
        };
        let Near { now, margin, .. } = *near;
        words!("{one} and {other} are {now:.3} m apart and would come nearer than {margin:.3} m")
    }
}

impl Guard for Collision {
    fn outline(&self) -> Vec<Line> {
        self.outline.clone()
    }

    fn sight(&self) -> Option<Arc<dyn Sight>> {
        Some(Arc::clone(&self.sight) as _)
    }

    fn begin(&mut self, _: &Seen<'_>) {
        self.others.iter_mut().for_each(|other| other.unchanged = 0);
    }

    fn check(&mut self, seen: &Seen<'_>) -> Option<Words> {
        let pace = |joint: usize| seen.setpoint.pace(joint, seen.period);
        let own = Shown {
            ticks: 0,
            position: seen.setpoint.position,
            velocity: mcs::Joints::from_fn(seen.setpoint.position.len(), pace),
            stopping: *seen.stopping,
        };
        self.scene.see(0, &own, seen.period, seen.period);
        for (other, arm) in self.others.iter_mut().zip(1..) {
            let shown = match other.look(seen.period) {
                Ok(shown) => shown,
                Err(silence) => return Some(silence),
            };
            self.scene.see(arm, &shown, 2.0 * seen.period, seen.period);
        }
        let Looked { nearest, touches } = self.scene.look();
        self.found.nearest = nearest.map(|near| (near.pair, near.now));
        if let Some(near) = touches {
            self.found.stops += 1;
            self.found.last = Some(near.pair);
        }
        self.findings.write(&self.found);
        touches.map(|near| self.told(&near))
    }
}
