//! A person's hand that carries an object of the world: moves it, hides it for a while, and leaves where it is in a snapshot buffer,
//! for a judge.

mod motion;

use std::{cell::Cell, rc::Rc, time::Duration};

use ctos::{
    Context,
    diagnostic::Finding,
    message::{Command as _, Message},
    registry::Registry,
    sync::{CyclicHandle, Tick},
    task::{EventHandler, Handled, HandlerError, Phase},
    time::Clock,
};
use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion, Vector3};
use serde::Deserialize;
use sorma_snapshot::{Layout, Place, Writer};

pub use motion::Kind;
use motion::{Motion, Sizes};

use mcs_hand::command::{ReadTouch, Touch};

use crate::world_task::PlaceBody;

/// Name of the event handler.
pub const HAND: &str = "sim.hand";

/// Places that the buffer keeps: 9 s at 4.5 ms.
const SLOTS: usize = 2000;

/// Where what is hidden is, m under its place.
const UNDER: f64 = 20.0;

ctos::command! {
    /// A person leads the hand: its motion goes on so much further from home, m in the world. It goes there with the hand's speed.
    #[derive(Debug, Clone, PartialEq)]
    pub struct LeadHand {
        /// Along x,
        pub x: f64,
        /// y,
        pub y: f64,
        /// and z.
        pub z: f64,
    } => (), 0x0395, "lead_hand"
}

/// How often it is felt whether fingers have what is held, and how often in a row they must.
const FEEL: Duration = Duration::from_millis(50);
const FELT: u32 = 4;

/// No hand is led further than this, m.
const FURTHEST: f64 = 1.0;

/// Arguments of a hand.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct HandArgs {
    /// The task that owns the world, on the same chassis.
    #[serde(default = "crate::source::world_task")]
    pub world: String,
    /// The object that it holds.
    pub body: String,
    /// What else it moves along: an object, and its middle seen from that of the first, m.
    #[serde(default)]
    pub with: Vec<Companion>,
    /// Where the motion begins, m in the world.
    pub home: [f64; 3],
    /// Which way it goes.
    pub motion: Kind,
    /// Speed of a circle, the largest of a sweep and of the ways of a person, m/s.
    #[serde(default = "speed")]
    pub speed: f64,
    /// Acceleration of jumps, m/s^2.
    #[serde(default = "acceleration")]
    pub acceleration: f64,
    /// How far it goes from home along the axes of the world, m.
    #[serde(default = "reach")]
    pub reach: [f64; 3],
    /// When it begins, s.
    #[serde(default = "begins_s")]
    pub begins_s: f64,
    /// From when until when nobody sees what it holds, s.
    #[serde(default)]
    pub hidden_s: Vec<[f64; 2]>,
    /// How often it moves what it holds, ms.
    #[serde(default = "period_ms")]
    pub period_ms: f64,
    /// It lets go of what it holds when three fingertips press on it with so much each, N; never when that is left out.
    pub gives_n: Option<f64>,
    /// The snapshot buffer in which it leaves the place, m.
    pub buffer: Option<String>,
}

/// What a hand moves along.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Companion {
    /// The object.
    pub body: String,
    /// Its middle from that of the first, m.
    pub offset: [f64; 3],
}

fn speed() -> f64 {
    0.2
}

fn acceleration() -> f64 {
    2.0
}

fn reach() -> [f64; 3] {
    [0.1, 0.15, 0.05]
}

fn begins_s() -> f64 {
    2.0
}

fn period_ms() -> f64 {
    4.5
}

/// Registers the event handler.
pub(crate) fn register(registry: &mut Registry) {
    let handler = registry.handler(HAND, &[LeadHand::INFO], |cx| Ok(Hand::new(cx.args()?)));
    handler.checked_args::<HandArgs>(|args, task, app, findings| {
        let mut refuse = |key: &str, text: String, help: String| {
            let place = task.args.locate(key).unwrap_or_else(|| task.place.clone());
            findings.push(
                Finding::error("sim::hand::motion", text)
                    .at(place)
                    .help(help),
            );
        };
        let world = app.task(&args.world);
        if world.is_none_or(|world| world.chassis != task.chassis) {
            let text = format!(
                "no task `{}` is on the chassis of `{}`",
                args.world, task.name
            );
            let help = "name the world's task, and put both on one chassis".to_owned();
            refuse("world", text, help);
        }
        let above = [
            ("speed", args.speed),
            ("acceleration", args.acceleration),
            ("period_ms", args.period_ms),
        ];
        for (key, value) in above {
            if !(value > 0.0 && value < 1e3) {
                let text = format!("`{key}` is {value}");
                refuse(key, text, "give a number above 0, below 1000".to_owned());
            }
        }
    });
}

/// Whether three fingertips feel at least so much, N.
fn three_press(touches: &[Touch], force: f64) -> bool {
    let presses = |touch: &&Touch| {
        let link = touch.link.rsplit('.').next().unwrap_or_default();
        link.starts_with("tip") && Vector3::from(touch.force_n).norm() >= force
    };
    touches.iter().filter(presses).count() >= 3
}

/// The event handler.
struct Hand {
    args: HandArgs,
    /// How far it is led from home, m.
    led: Rc<Cell<Vector3<f64>>>,
    cyclic: Option<CyclicHandle>,
}

impl Hand {
    fn new(args: HandArgs) -> Self {
        Self {
            args,
            led: Rc::default(),
            cyclic: None,
        }
    }

    fn writer(&self, cx: &Context, clock: &Clock) -> Result<Option<Writer>, HandlerError> {
        let Some(buffer) = &self.args.buffer else {
            return Ok(None);
        };
        let place = Place::of_app(&cx.app().name)?;
        let layout = Layout::new(SLOTS, 3).described("x m\ny m\nz m");
        Ok(Some(Writer::create(&place, buffer, layout, clock)?))
    }
}

impl EventHandler for Hand {
    async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
        if message.command() != LeadHand::CODE {
            return cx.default_processing(message);
        }
        let (LeadHand { x, y, z }, reply) = message.open::<LeadHand>()?;
        let led = self.led.get() + Vector3::new(x, y, z);
        // A length that is no number is in no range.
        if !(0.0..=FURTHEST).contains(&led.norm()) {
            return reply.fail(format!(
                "a hand is led {FURTHEST} m at most from where it goes by itself, not by {x}, {y}, {z} more"
            ));
        }
        self.led.set(led);
        reply.ok(())
    }

    async fn phase(&mut self, cx: &Context, phase: Phase) -> Handled {
        if phase != Phase::Run {
            return Ok(());
        }
        let mut writer = self.writer(cx, cx.chassis().clock())?;
        let world = cx.task(&self.args.world).await?;
        let args = self.args.clone();
        let sizes = Sizes {
            speed: args.speed,
            acceleration: args.acceleration,
            reach: Vector3::from(args.reach),
        };
        let rng = cx.rng("the hand's ways");
        let mut motion = Motion::new(args.motion, Point3::from(args.home), sizes, rng);
        let begin = cx.now();
        let period = Duration::from_secs_f64(args.period_ms * 1e-3);
        let given = Rc::new(Cell::new(false));
        if let Some(force) = args.gives_n {
            let (own, world, given) = (cx.clone(), world.clone(), Rc::clone(&given));
            cx.spawn(async move {
                let mut felt = 0;
                while felt < FELT && !own.is_stopping() {
                    own.sleep(FEEL).await;
                    // A world that does not answer says nothing of fingers.
                    let touches = own.call(&world, ReadTouch { arm: None }).await;
                    felt = match touches.is_ok_and(|touches| three_press(&touches, force)) {
                        true => felt + 1,
                        false => 0,
                    };
                }
                given.set(true);
            });
        }
        let (own, led, mut off) = (cx.clone(), Rc::clone(&self.led), Vector3::zeros());
        let tick = move |tick: &Tick| {
            let time = tick.now.since(begin).as_secs_f64();
            let step = args.speed * args.period_ms * 1e-3;
            off += (led.get() - off).cap_magnitude(step);
            let place = motion.at(time - args.begins_s) + off;
            let hidden = |[from, to]: &[f64; 2]| time >= *from && time < *to;
            let under = if args.hidden_s.iter().any(hidden) {
                UNDER
            } else {
                0.0
            };
            let put = |body: &str, offset: [f64; 3]| {
                let at = place + Vector3::from(offset) - Vector3::z() * under;
                let pose = Isometry3::from_parts(
                    Translation3::from(at.coords),
                    UnitQuaternion::identity(),
                );
                let body = body.to_owned();
                // A world with a full queue gets the next place.
                let _ = own.try_send(&world, PlaceBody { body, pose });
            };
            if !given.get() {
                put(&args.body, [0.0; 3]);
            }
            for companion in &args.with {
                put(&companion.body, companion.offset);
            }
            if let Some(writer) = &mut writer {
                let _ = writer.write(place.coords.as_slice(), &[]);
            }
        };
        self.cyclic = Some(cx.cyclic(period, tick));
        Ok(())
    }
}
