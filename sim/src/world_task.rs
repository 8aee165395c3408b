//! The task that owns the world: goes on by itself, and shows what there is to see by message.

use std::{cell::RefCell, rc::Rc, time::Duration};

use ctos::{
    Context,
    message::{Command, Message},
    registry::Registry,
    sync::{CyclicHandle, Tick},
    task::{EventHandler, Handled, HandlerError, Phase},
};
use mcs_hand::command::{Body, ReadBodies, ReadTouch, Touch};
pub use mcs_hand::command::{LightRoom, PlaceBody};
use nalgebra::{Point3, Vector3};
use serde::{Deserialize, Serialize};
use vss::command::{NamedCamera, OrderLaser, TrueCameras};

use crate::{
    camera::truth::CameraTruth,
    cell::{Cell, Mount},
    hold::{Grip, Hold},
    port::Port,
    scene::{CameraFault, SceneState},
    scenes::SceneWriter,
    simulation::Simulation,
};

/// Name of the world's event handler.
pub const WORLD: &str = "sim.world";

ctos::command! {
    /// Asks what there is to see.
    #[derive(Debug, Clone, PartialEq)]
    pub struct GetScene => SceneState, 0x0501, "get_scene"
}
ctos::command! {
    /// Switches every lamp of the world.
    #[derive(Debug, Clone, PartialEq)]
    pub struct SetLamp {
        /// Whether they shall shine.
        pub on: bool,
    } => (), 0x0502, "set_lamp"
}
ctos::command! {
    /// Switches one lamp.
    #[derive(Debug, Clone, PartialEq)]
    pub struct SwitchLamp {
        /// Its name in the cell.
        pub lamp: String,
        /// Whether it shall shine.
        pub on: bool,
    } => (), 0x0503, "switch_lamp"
}

ctos::command! {
    /// Has a camera fail from now on, or be well again.
    #[derive(Debug, Clone, PartialEq)]
    pub struct FailCamera {
        /// Its name in the cell.
        pub camera: String,
        /// What it does; nothing wrong when there is none.
        pub fault: Option<CameraFault>,
    } => (), 0x0504, "fail_camera"
}

/// A hand that holds a link of an arm by a spring.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct HandThere {
    /// Where it is, m in the world.
    pub at: [f64; 3],
    /// N/m.
    pub stiffness: f64,
    /// N s/m.
    pub damping: f64,
    /// It pulls no harder, N.
    pub most_n: f64,
}
ctos::command! {
    /// A person takes hold of a link of an arm, moves the hand that holds it, or lets go. Answers where the link is, m in the world.
    #[derive(Debug, Clone, PartialEq)]
    pub struct HoldLink {
        /// The arm; the only one, when none is named.
        pub arm: Option<String>,
        /// Name of a frame of its model.
        pub link: String,
        /// Where the hand is now; without one it lets go.
        pub hand: Option<HandThere>,
    } => [f64; 3], 0x0505, "hold_link"
}

ctos::command! {
    /// A person takes hold of an arm at its tip, pushes with this force, N in the world, for so long, s, and lets go.
    #[derive(Debug, Clone, PartialEq)]
    pub struct PushArm {
        /// Along x,
        pub x: f64,
        /// y,
        pub y: f64,
        /// and z.
        pub z: f64,
        /// For how long, s.
        pub seconds: f64,
    } => (), 0x0396, "push_arm"
}

/// Nobody makes it lighter in the room than so many times what it is.
const LIGHTEST: f64 = 10.0;

/// No person pushes harder, N, or longer, s.
const HARDEST: f64 = 200.0;
const LONGEST: f64 = 60.0;

/// Arguments of the world's task.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct WorldArgs {
    /// Path of the cell file, relative to the configuration's folder.
    pub cell: String,
    /// Period of the world, ms. A servo's period should be a multiple of it.
    #[serde(default = "period_ms")]
    pub period_ms: f64,
    /// The snapshot buffer in which it leaves a scene after every tick; none, when none is named.
    pub scenes: Option<String>,
    /// Whether nothing moves by itself: objects stay where they are put.
    #[serde(default)]
    pub still: bool,
}

fn period_ms() -> f64 {
    1.5
}

/// Periods that a world may have, ms.
pub const PERIODS_MS: [f64; 2] = [0.1, 20.0];

/// Registers the event handler; its arguments are checked with the rest of the app.
pub fn register(registry: &mut Registry) -> &mut ctos::registry::HandlerKind {
    let commands = [
        GetScene::INFO,
        SetLamp::INFO,
        SwitchLamp::INFO,
        FailCamera::INFO,
        OrderLaser::INFO,
        PlaceBody::INFO,
        LightRoom::INFO,
        PushArm::INFO,
        TrueCameras::INFO,
        ReadTouch::INFO,
        ReadBodies::INFO,
        HoldLink::INFO,
    ];
    registry.handler(WORLD, &commands, WorldTask::new)
}

/// The event handler `sim.world`.
struct WorldTask {
    cell: Cell,
    period: Duration,
    /// Shared with the synchronous function, which runs on the same thread and never within a message.
    simulation: Rc<RefCell<Simulation>>,
    /// The name of the buffer, and what writes it.
    buffer: Option<String>,
    scenes: Rc<RefCell<Option<SceneWriter>>>,
    cyclic: Option<CyclicHandle>,
}

impl WorldTask {
    fn new(cx: &Context) -> Result<Self, HandlerError> {
        let task = cx.config().ok_or("a world needs a configuration")?;
        let args: WorldArgs = task.args.parse()?;
        let cell = Cell::read(&cx.app().file_at(&args.cell))?;
        let port = Port::of(cx, cx.name(), &cell);
        Ok(Self {
            period: Duration::from_secs_f64(
                args.period_ms.clamp(PERIODS_MS[0], PERIODS_MS[1]) / 1e3,
            ),
            simulation: Rc::new(RefCell::new(Simulation::new(&cell, port).still(args.still))),
            scenes: Rc::default(),
            buffer: args.scenes,
            cell,
            cyclic: None,
        })
    }

    /// The synchronous function. A world that cannot go on stands still, and the app is told.
    fn ticker(&self, cx: &Context) -> impl FnMut(&Tick) + 'static {
        let (cx, period) = (cx.clone(), self.period);
        let (simulation, scenes) = (Rc::clone(&self.simulation), Rc::clone(&self.scenes));
        let mut failed = false;
        move |tick: &Tick| {
            if failed {
                return;
            }
            let now = tick.now.since_start();
            let ticked = simulation.borrow_mut().tick(period, tick.missed, now);
            if let Err(error) = ticked {
                failed = true;
                cx.fail(&error.to_string());
            }
            leave_scene(&mut simulation.borrow_mut(), &mut scenes.borrow_mut());
        }
    }

    /// Switches a lamp, or all; what has switched is seen at once.
    fn switch(&self, lamp: Option<&str>, on: bool) -> bool {
        let mut simulation = self.simulation.borrow_mut();
        let any = simulation.switch(lamp, on, &self.cell);
        leave_scene(&mut simulation, &mut self.scenes.borrow_mut());
        any
    }

    /// What touches the links of an arm, by index.
    fn touches(&self, arm: usize) -> Vec<Touch> {
        let touches = self.simulation.borrow_mut().touches(arm);
        let touches = touches.into_iter().map(|(link, force)| Touch {
            link,
            force_n: force.into(),
        });
        touches.collect()
    }

    /// Has a hand hold a link, or let go of it; where the link is, m.
    fn hold(&self, request: HoldLink) -> Result<[f64; 3], String> {
        let arm = self.cell.arm(request.arm.as_deref());
        let arm = arm.map_err(|finding| finding.message)?;
        let spec = self.cell.arms.get(arm).ok_or("the cell has no arm")?;
        let frame = spec
            .model
            .frame(&request.link)
            .ok_or_else(|| format!("arm `{}` has no frame `{}`", spec.name, request.link))?;
        let mut simulation = self.simulation.borrow_mut();
        let at = simulation.place_of(Mount { arm, frame });
        match request.hand {
            Some(hand) => {
                let numbers = [hand.stiffness, hand.damping, hand.most_n];
                if !hand
                    .at
                    .iter()
                    .chain(&numbers)
                    .all(|number| number.is_finite())
                {
                    return Err(format!(
                        "a number of the hand on `{}` is none",
                        request.link
                    ));
                }
                simulation.hold(
                    arm,
                    Hold {
                        frame,
                        grip: Grip::Spring {
                            hand: Point3::from(hand.at),
                            stiffness: hand.stiffness,
                            damping: hand.damping,
                            most: hand.most_n,
                        },
                    },
                );
            }
            None => simulation.let_go(arm),
        }
        Ok(at.coords.into())
    }

    /// Has a hand push the only arm at its tip, N, for so long, s.
    fn push(&self, force: Vector3<f64>, seconds: f64) -> Result<(), String> {
        let arm = self.cell.arm(None).map_err(|finding| finding.message)?;
        let spec = self.cell.arms.get(arm).ok_or("the cell has no arm")?;
        let hold = Hold {
            frame: spec.model.tip(),
            grip: Grip::Push { force, seconds },
        };
        self.simulation.borrow_mut().hold(arm, hold);
        Ok(())
    }

    /// Where everything is.
    fn bodies(&self) -> Vec<Body> {
        let scene = self.simulation.borrow_mut().scene();
        let bodies = scene.bodies.into_iter().map(|body| {
            let matrix = body.pose.to_homogeneous().transpose();
            let mut world_t_body = [0.0; 16];
            world_t_body.copy_from_slice(matrix.as_slice());
            Body {
                name: body.name,
                world_t_body,
            }
        });
        bodies.collect()
    }

    /// The cameras as they truly are, those that are carried where they are now.
    fn cameras(&self) -> Vec<NamedCamera> {
        let scene = self.simulation.borrow_mut().scene();
        let cameras = self.cell.cameras.iter();
        let named = |truth: CameraTruth| NamedCamera {
            camera: truth.camera(),
            name: truth.name,
        };
        cameras.map(|camera| named(camera.at(&scene))).collect()
    }
}

/// Leaves a scene for whoever reads the buffer. Without it the world goes on all the same.
fn leave_scene(simulation: &mut Simulation, scenes: &mut Option<SceneWriter>) {
    let Some(writer) = scenes else { return };
    if let Err(error) = writer.write(&simulation.scene()) {
        tracing::warn!("no more scenes are left: {error}");
        *scenes = None;
    }
}

impl EventHandler for WorldTask {
    async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
        // What drivers said came through memory that no recorder sees.
        cx.reads_unrecorded("the world");
        match message.command() {
            GetScene::CODE => {
                let (GetScene {}, reply) = message.open::<GetScene>()?;
                reply.ok(self.simulation.borrow_mut().scene())
            }
            SetLamp::CODE => {
                let (SetLamp { on }, reply) = message.open::<SetLamp>()?;
                self.switch(None, on);
                reply.ok(())
            }
            SwitchLamp::CODE => {
                let (SwitchLamp { lamp, on }, reply) = message.open::<SwitchLamp>()?;
                if self.switch(Some(&lamp), on) {
                    reply.ok(())
                } else {
                    reply.fail(format!("the cell has no lamp `{lamp}`"))
                }
            }
            FailCamera::CODE => {
                let (FailCamera { camera, fault }, reply) = message.open::<FailCamera>()?;
                let mut simulation = self.simulation.borrow_mut();
                let any = simulation.fail_camera(&camera, fault, &self.cell);
                leave_scene(&mut simulation, &mut self.scenes.borrow_mut());
                if any {
                    reply.ok(())
                } else {
                    reply.fail(format!("the cell has no camera `{camera}`"))
                }
            }
            OrderLaser::CODE => {
                let (OrderLaser { laser, order }, reply) = message.open::<OrderLaser>()?;
                let mut simulation = self.simulation.borrow_mut();
                let any = simulation.order_laser(&laser, order);
                leave_scene(&mut simulation, &mut self.scenes.borrow_mut());
                if any {
                    reply.ok(())
                } else {
                    reply.fail(format!("the cell has no laser `{laser}`"))
                }
            }
            LightRoom::CODE => {
                let (LightRoom { share }, reply) = message.open::<LightRoom>()?;
                if !(0.0..=LIGHTEST).contains(&share) {
                    return reply.fail(format!("the light is {share}: give 0 to {LIGHTEST}"));
                }
                let mut simulation = self.simulation.borrow_mut();
                simulation.lighten(share);
                leave_scene(&mut simulation, &mut self.scenes.borrow_mut());
                reply.ok(())
            }
            PlaceBody::CODE => {
                let (PlaceBody { body, pose }, reply) = message.open::<PlaceBody>()?;
                let mut simulation = self.simulation.borrow_mut();
                if !pose
                    .to_homogeneous()
                    .iter()
                    .all(|number| number.is_finite())
                {
                    return reply.fail(format!("the pose for `{body}` is none"));
                }
                let any = simulation.place(&body, &pose);
                leave_scene(&mut simulation, &mut self.scenes.borrow_mut());
                if any {
                    reply.ok(())
                } else {
                    reply.fail(format!("the cell has no object `{body}`"))
                }
            }
            PushArm::CODE => {
                let (PushArm { x, y, z, seconds }, reply) = message.open::<PushArm>()?;
                let force = Vector3::new(x, y, z);
                if !((0.0..=HARDEST).contains(&force.norm()) && (0.0..=LONGEST).contains(&seconds))
                {
                    let text = format!(
                        "a push has {HARDEST} N and lasts {LONGEST} s at most, not {x}, {y}, {z} N for {seconds} s"
                    );
                    return reply.fail(text);
                }
                match self.push(force, seconds) {
                    Ok(()) => reply.ok(()),
                    Err(why) => reply.fail(why),
                }
            }
            TrueCameras::CODE => {
                let (TrueCameras {}, reply) = message.open::<TrueCameras>()?;
                reply.ok(self.cameras())
            }
            ReadTouch::CODE => {
                let (ReadTouch { arm }, reply) = message.open::<ReadTouch>()?;
                match self.cell.arm(arm.as_deref()) {
                    Ok(arm) => reply.ok(self.touches(arm)),
                    Err(finding) => reply.fail(finding.message),
                }
            }
            HoldLink::CODE => {
                let (request, reply) = message.open::<HoldLink>()?;
                match self.hold(request) {
                    Ok(at) => reply.ok(at),
                    Err(text) => reply.fail(text),
                }
            }
            ReadBodies::CODE => {
                let (ReadBodies {}, reply) = message.open::<ReadBodies>()?;
                reply.ok(self.bodies())
            }
            _ => cx.default_processing(message),
        }
    }

    async fn phase(&mut self, cx: &Context, phase: Phase) -> Handled {
        if phase == Phase::Create {
            // Not before: until now a world before this one may have written it.
            if let Some(buffer) = &self.buffer {
                let place = (cx.app().name.as_str(), buffer.as_str());
                let scene = self.simulation.borrow_mut().scene();
                let (lasers, clock) = (self.cell.lasers.len(), cx.chassis().clock());
                let writer = SceneWriter::create(place, &scene, lasers, clock)?;
                *self.scenes.borrow_mut() = Some(writer);
            }
            self.cyclic = Some(cx.cyclic(self.period, self.ticker(cx)));
        }
        Ok(())
    }
}
