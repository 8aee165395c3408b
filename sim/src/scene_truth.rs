//! The simulator's truth for viewers: the arms and the objects where the world has them, what touches the arms, what stands in the
//! room, the lamps and the cameras. Only a display may follow it. It reads what the world shows to channel drivers anyway. Objects
//! and contacts the world shows for as long as somebody looks.

use std::sync::Arc;

use ctos::{
    Context,
    message::{Command, Message},
    registry::Registry,
    task::{EventHandler, Handled, HandlerError, Phase},
};
use nalgebra::{Isometry3, Point3, UnitQuaternion, Vector3};
use scene::{FollowScene, Layer, Number, Part, Pose, Said, Seen, Source, Stage, View};
use serde::Deserialize;

use crate::{
    camera::truth::CameraTruth,
    cell::{Cell, Origin},
    port::Port,
    scene::SceneState,
    shapes::{Shape, Solid},
    world_task::{WORLD, WorldArgs},
};

/// Name of the event handler.
pub const TRUTH: &str = "sim.truth";

/// How far the pyramid of a camera reaches, m.
const DEPTH: f64 = 0.6;
/// How long a newton is drawn, m.
const FORCE_SCALE: f64 = 0.01;

#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
struct TruthArgs {
    /// The task that owns the world, on the same chassis.
    #[serde(default = "crate::source::world_task")]
    world: String,
}

/// Registers the event handler.
pub(crate) fn register(registry: &mut Registry) {
    let handler = registry.handler(TRUTH, &[FollowScene::INFO], |cx| {
        Ok(Truth {
            args: cx.args()?,
            stage: None,
        })
    });
    handler.args::<TruthArgs>();
}

struct Truth {
    args: TruthArgs,
    stage: Option<Stage>,
}

impl EventHandler for Truth {
    async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
        match (message.command(), &self.stage) {
            (FollowScene::CODE, Some(stage)) => {
                cx.reads_unrecorded("the world");
                stage.follow(cx, message)
            }
            _ => cx.default_processing(message),
        }
    }

    async fn phase(&mut self, cx: &Context, phase: Phase) -> Handled {
        if phase == Phase::Create {
            let name = &self.args.world;
            let world = cx.app().task(name);
            let world = world.filter(|world| world.handler == WORLD);
            let own = cx.config().map(|task| &task.chassis);
            let Some(world) = world.filter(|world| Some(&world.chassis) == own) else {
                return Err(HandlerError::new(format!(
                    "`{}` finds no world `{name}` on its chassis; place both on the same chassis",
                    cx.name()
                )));
            };
            let WorldArgs { cell, .. } = world.args.parse()?;
            let cell = Cell::read(&cx.app().file_at(&cell))?;
            let port = Port::of(cx, &world.name, &cell);
            self.stage = Some(Stage::new(World::new(cell, port)));
        }
        Ok(())
    }
}

struct World {
    cell: Cell,
    port: Arc<Port>,
    view: Option<View>,
}

impl World {
    fn new(cell: Cell, port: Arc<Port>) -> Self {
        let view = Some(view(&cell));
        Self { cell, port, view }
    }

    /// The scene with the arms where they are.
    fn scene(&self) -> SceneState {
        let joints: Vec<Vec<f64>> = (0..self.cell.arms.len())
            .map(|arm| {
                let mut state = vec![0.0; self.port.state_length(arm)];
                self.port.read(arm, &mut state);
                let joints = self.port.joints(arm);
                // The world's tick, then positions.
                state.into_iter().skip(1).take(joints).collect()
            })
            .collect();
        let joints: Vec<&[f64]> = joints.iter().map(Vec::as_slice).collect();
        self.cell.scene(&joints)
    }
}

impl Source for World {
    fn view(&mut self) -> Option<View> {
        self.view.take()
    }

    fn look(&mut self) -> Seen {
        self.port.watched.look();
        let scene = self.scene();
        let bodies = self.cell.bodies.iter().zip(&scene.bodies);
        let bodies = bodies.map(|(spec, body)| match spec.origin {
            Origin::Link(_) => pose(&body.pose),
            Origin::Object(index) => pose(&self.port.watched.object(index)),
        });
        let lamps = scene.lamps.iter();
        let lamps = lamps.map(|lamp| pose(&Isometry3::from(lamp.centre.coords)));
        let cameras = self.cell.cameras.iter();
        let cameras = cameras.map(|camera| pose(&camera.at(&scene).camera_t_world.inverse()));
        let room = std::iter::once(Pose::default());
        let all = room.chain(bodies).chain(lamps).chain(cameras);
        let contacts = self.port.watched.contacts().map(|contact| {
            let (at, force) = contact.unwrap_or_default();
            (pose(&Isometry3::from(at.coords)), force.as_slice().to_vec())
        });
        Seen {
            states: all.map(|pose| (pose, Vec::new())).chain(contacts).collect(),
            said: Said {
                words: "what the simulator says; no robot knows it".to_owned(),
                ..Said::default()
            },
            pictures: Vec::new(),
        }
    }
}

/// The room, links and objects, the lamps, the cameras, and what touches links, in this order.
fn view(cell: &Cell) -> View {
    let part = |name: &str, kind: &str, solids: Vec<scene::Solid>| Part {
        name: name.to_owned(),
        kind: kind.to_owned(),
        solids,
        colour: [128; 3],
        ..Part::default()
    };
    let room = cell.room.iter().map(solid).collect();
    let mut parts = vec![part("room", "furniture", room)];
    for body in &cell.bodies {
        let solids = body.shapes.iter().map(solid).collect();
        let kind = match body.origin {
            Origin::Link(_) => "link",
            Origin::Object(_) => "object",
        };
        parts.push(part(&body.name, kind, solids));
    }
    for lamp in &cell.lamps {
        let ball = scene::Solid::Capsule {
            a: [0.0; 3],
            b: [0.0; 3],
            radius: lamp.radius,
        };
        parts.push(part(&lamp.name, "lamp", vec![ball]));
    }
    for camera in &cell.cameras {
        let pyramid = scene::Solid::Frustum {
            corners: corners(&camera.truth),
            camera: camera.truth.name.clone(),
        };
        parts.push(part(&camera.truth.name, "camera", vec![pyramid]));
    }
    for body in cell.touchable() {
        let force = scene::Solid::Vector {
            first: 0,
            scale: FORCE_SCALE,
            turns: false,
        };
        let number = |axis: &str| Number {
            name: format!("force {axis}"),
            unit: "N".to_owned(),
            resolution: 0.1,
        };
        parts.push(Part {
            numbers: ["x", "y", "z"].map(number).into(),
            ..part(&format!("contact of {}", body.name), "contact", vec![force])
        });
    }
    View {
        layer: Layer::Truth,
        parts,
    }
}

fn pose(placed: &Isometry3<f64>) -> Pose {
    Pose {
        at: placed.translation.vector.into(),
        turn: placed.rotation.coords.into(),
    }
}

fn solid(shape: &Shape) -> scene::Solid {
    let at = |centre: &Point3<f64>, turn: UnitQuaternion<f64>| {
        pose(&Isometry3::from_parts(centre.coords.into(), turn))
    };
    match &shape.solid {
        Solid::Capsule { a, b, radius } => scene::Solid::Capsule {
            a: a.coords.into(),
            b: b.coords.into(),
            radius: *radius,
        },
        Solid::Block { centre, half } => scene::Solid::Block {
            pose: at(centre, UnitQuaternion::identity()),
            half: (*half).into(),
        },
        Solid::Cylinder { half, radius } => scene::Solid::Cylinder {
            pose: Pose::default(),
            half: *half,
            radius: *radius,
        },
        Solid::Disc {
            centre,
            normal,
            radius,
        } => {
            let turn = UnitQuaternion::rotation_between(&Vector3::z(), normal);
            scene::Solid::Cylinder {
                pose: at(centre, turn.unwrap_or_default()),
                half: 0.0,
                radius: *radius,
            }
        }
    }
}

/// The corners of what a camera sees, without its distortion.
fn corners(camera: &CameraTruth) -> [[f64; 3]; 4] {
    let corner = |u: f64, v: f64| {
        let [fx, fy] = camera.focal;
        let [cx, cy] = camera.principal;
        let (x, y) = ((u - cx) / fx, (v - cy) / fy);
        [DEPTH * x, DEPTH * y, DEPTH]
    };
    let (left, top) = (-0.5, -0.5);
    let (right, bottom) = (left + camera.width as f64, top + camera.height as f64);
    [
        corner(left, top),
        corner(right, top),
        corner(right, bottom),
        corner(left, bottom),
    ]
}

#[cfg(test)]
mod tests {
    use ctos::diagnostic;

    use super::*;

    #[test]
    fn viewers_are_told_the_arm_where_the_world_shows_it_to_drivers_and_every_camera() {
        let text = include_str!("../../configs/cell.toml");
        let cell = Cell::parse(&diagnostic::Source::new("cell.toml", text)).unwrap();
        let port = Arc::new(Port::new(&cell));
        let q = [0.3, 0.2, -1.1, 0.4, 0.5, 0.6];
        port.show(0, 7, &q, &[0.0; 6]);
        let mut world = World::new(cell.clone(), port);
        let view = world.view().unwrap();
        assert_eq!(view.layer, Layer::Truth);
        assert!(world.view().is_none());
        let seen = world.look();
        assert_eq!(seen.states.len(), view.parts.len());
        let scene = cell.scene(&[&q]);
        for body in &scene.bodies {
            let at = view.parts.iter().position(|part| part.name == body.name);
            let (told, _) = &seen.states[at.unwrap()];
            assert_eq!(*told, pose(&body.pose), "{}", body.name);
        }
        let cameras = view.parts.iter().filter(|part| part.kind == "camera");
        assert_eq!(cameras.count(), cell.cameras.len());
    }
}
