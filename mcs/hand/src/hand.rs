//! The event handler `mcs.hand`: moves the fingers of a hand, grasps with three of them, and tells what they feel.
//!
//! It moves them through the client interface of their servo, whose law is [`crate::grip`]. A tripod grasp sends three
//! fingertips towards one point, each with the torques that press there with the force asked for. It holds when every one
//! of them feels that something presses back. What fingertips feel comes from the task that has their sensors.
//!
//! What a gripper is asked for it does as well, with the same three fingertips around one point: whoever carries things need
//! not know which of both it has.

use std::{sync::Arc, time::Duration};

use ctos::{
    Context,
    config::TaskConfig,
    diagnostic::{Finding, Findings},
    message::{Command, Message},
    registry::Registry,
    task::{EventHandler, Handled, HandlerError, Phase, StopReason, TaskRef},
};
use mcs::{
    Joints,
    client::{Manipulator, MotionError, Move, Outcome, PathKind, Plan, Target},
    state::State,
};
use nalgebra::{Point3, Vector3};
use serde::Deserialize;

use crate::{
    command::{
        Grasp, HandState, Held, LetGo, MoveFingers, Open, ReadHand, ReadHeld, ReadTouch,
        SetStiffness, SwitchOff, Tripod,
    },
    fingers::{FingerError, Fingers},
    grip::{Grip, Grips},
    gripper::{check_parts, refused},
};

/// The handler's name.
pub const HAND: &str = "mcs.hand";

/// Fingers of a tripod grasp.
const THREE: usize = 3;
/// Fingertips of a grasp go so near to the point in the middle, m; whatever is thicker stops them before.
const MIDDLE: f64 = 4e-3;
/// A fingertip that feels this part of what it should press with has found the object.
const FOUND: f64 = 0.5;
/// A joint that can give no more than this part of the force, as a lever in m, keeps its place with its usual torque.
const SHORT: f64 = 0.01;
/// Spring of a joint in a grasp, when nobody asked for one, N m/rad.
const SPRING: f64 = 3.0;
/// How long what fingertips feel takes to settle when they stand still.
const SETTLE: Duration = Duration::from_millis(200);
/// A motion of the fingers takes no longer.
const LONGEST: Duration = Duration::from_secs(120);
/// The slowest motion, as a fraction of full speed.
const SLOWEST: f64 = 1e-3;

/// Arguments.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
struct HandArgs {
    /// The task with the client interface of the fingers.
    client: String,
    /// `law_args.name` of the fingers' servo, on the same chassis.
    grip: String,
    /// The task that tells what presses on fingertips.
    touch: String,
    /// The arm that the hand is on, by its name there; the only one when it is left out.
    arm: Option<String>,
    /// Where the fingertips meet in the grasp of a gripper, in the base frame of the hand's model, m.
    #[serde(default = "centre_m")]
    centre_m: [f64; 3],
    /// How hard each fingertip presses then, when nobody says, N.
    #[serde(default = "force_n")]
    force_n: f64,
    /// How far the skin of a fingertip is from its middle, m.
    #[serde(default = "tip_m")]
    tip_m: f64,
}

fn centre_m() -> [f64; 3] {
    [0.0, 0.0, 0.145]
}

fn force_n() -> f64 {
    2.0
}

fn tip_m() -> f64 {
    9e-3
}

impl HandArgs {
    /// Findings where a number makes no sense.
    fn check(&self, task: &TaskConfig, findings: &mut Findings) {
        let mut wrong = |key: &str, text: String, help: &str| {
            let place = task.args.locate(key).unwrap_or_else(|| task.place.clone());
            let finding = Finding::error("mcs::hand::grasp", text).at(place);
            findings.push(finding.help(help));
        };
        if !self.centre_m.iter().all(|at| at.abs() <= 0.5) {
            let text = format!("`centre_m` is {:?}", self.centre_m);
            wrong(
                "centre_m",
                text,
                "give a place nearer to the palm than 0.5 m",
            );
        }
        if !(0.1..=20.0).contains(&self.force_n) {
            let text = format!("`force_n` is {}", self.force_n);
            wrong("force_n", text, "give from 0.1 to 20 N");
        }
        if !(0.0..=0.05).contains(&self.tip_m) {
            let text = format!("`tip_m` is {}", self.tip_m);
            wrong("tip_m", text, "give from 0 to 0.05 m");
        }
    }
}

/// Registers the handler; laws of the process are found in `grips`.
pub(crate) fn register(registry: &mut Registry, grips: &Grips) {
    let commands = [
        MoveFingers::INFO,
        Tripod::INFO,
        LetGo::INFO,
        ReadHand::INFO,
        SetStiffness::INFO,
        SwitchOff::INFO,
        Grasp::INFO,
        Open::INFO,
        ReadHeld::INFO,
    ];
    let grips = grips.clone();
    registry
        .handler(HAND, &commands, move |cx| {
            Ok(Hand {
                args: cx.args()?,
                grips: grips.clone(),
                parts: None,
                grasp: None,
            })
        })
        .checked_args::<HandArgs>(|args, task, app, findings| {
            check_parts(&args.client, &args.grip, (task, app), findings);
            args.check(task, findings);
            if app.task(&args.touch).is_none() {
                let place = task.args.locate("touch");
                let text = format!("there is no task `{}`", args.touch);
                let names = app.tasks.iter().map(|other| other.name.as_str());
                findings.push(
                    Finding::error("mcs::hand::touch", text)
                        .at(place.unwrap_or_else(|| task.place.clone()))
                        .suggest(&args.touch, names),
                );
            }
        });
}

#[derive(Clone)]
struct Parts {
    hand: Manipulator,
    grip: Arc<Grip>,
    fingers: Fingers,
    touch: TaskRef,
}

/// A grasp that nobody has let go of.
#[derive(Debug, Clone, Copy)]
struct Grasped {
    /// With which force, N.
    force: f64,
    /// Where the joints were before it, rad.
    before: Joints,
}

struct Hand {
    args: HandArgs,
    grips: Grips,
    parts: Option<Parts>,
    grasp: Option<Grasped>,
}

fn cannot(error: FingerError) -> MotionError {
    MotionError::new(Outcome::Unreachable, error)
}

/// From the middle of a grasp to a fingertip, across the direction of approach.
fn outwards(
    tip: &Point3<f64>,
    middle: &Point3<f64>,
    finger: usize,
) -> Result<Vector3<f64>, MotionError> {
    let way = tip - middle;
    let out = Vector3::new(way.x, way.y, 0.0).try_normalize(1e-6);
    out.ok_or_else(|| refused(format!("finger {finger} is in the middle already")))
}

/// The radius of the circle through three places, across the direction of approach, m; 0 where there is none.
fn radius(one: &Point3<f64>, two: &Point3<f64>, three: &Point3<f64>) -> f64 {
    let [a, b, c] = [two - three, three - one, one - two].map(|side| side.xy());
    let twice_area = a.perp(&b).abs();
    if twice_area < 1e-9 {
        return 0.0;
    }
    a.norm() * b.norm() * c.norm() / (2.0 * twice_area)
}

/// The springs of a grasp, N m/rad: those that were asked for, where there are some.
fn sprung(grip: &Grip) -> Vec<f64> {
    let given = grip.stiffness().into_iter();
    given
        .map(|spring| if spring > 0.0 { spring } else { SPRING })
        .collect()
}

impl Hand {
    fn parts(&self) -> Result<Parts, MotionError> {
        let parts = self.parts.clone();
        parts.ok_or_else(|| refused("the hand is not connected yet"))
    }

    /// Moves all joints, at a fraction of full speed, or in just so many seconds.
    async fn move_to(&self, order: &MoveFingers) -> Result<(), MotionError> {
        let Parts { hand, .. } = self.parts()?;
        let target = Target::Joints(order.joints);
        let (speed, acceleration) = match order.time_s {
            None => (order.speed, 1.0),
            Some(time) => {
                let plan = Plan {
                    target,
                    path: PathKind::Joint,
                    speed: 1.0,
                    acceleration: Some(1.0),
                    elbow: None,
                };
                let least = hand.plan(plan).await?.duration_s;
                let share = least / time;
                if share > 1.0 || share.is_nan() || time <= 0.0 {
                    let text = format!("it takes {least:.2} s at least, not {time} s");
                    return Err(refused(text));
                }
                // In twice the time goes half the speed and a quarter of the acceleration.
                (share.max(SLOWEST), (share * share).max(SLOWEST))
            }
        };
        let go = Move {
            target,
            path: PathKind::Joint,
            speed,
            acceleration: Some(acceleration),
            elbow: None,
            blend: 0.0.into(),
            guards: Vec::new(),
        };
        hand.go(go, LONGEST).await.map(|_| ())
    }

    async fn fingers(
        &mut self,
        cx: &Context,
        order: &MoveFingers,
    ) -> Result<HandState, MotionError> {
        let Parts { hand, grip, .. } = self.parts()?;
        hand.acquire().await?;
        grip.set_force(grip.usual_force()).map_err(refused)?;
        self.grasp = None;
        self.move_to(order).await?;
        self.state(cx).await
    }

    /// Three fingertips go to one point until something is between them.
    async fn tripod(&mut self, cx: &Context, order: &Tripod) -> Result<HandState, MotionError> {
        let Parts {
            hand,
            grip,
            mut fingers,
            ..
        } = self.parts()?;
        if fingers.count() < THREE {
            return Err(refused("a tripod grasp takes three fingers"));
        }
        if !(order.force_n > 0.0 && order.force_n.is_finite()) {
            return Err(refused(format!(
                "a force is more than 0 N, not {}",
                order.force_n
            )));
        }
        hand.acquire().await?;
        let before = hand.position().await?.joints;
        let tips = fingers.tips(&before);
        let middle = Point3::from(order.centre_m);
        let (mut to, mut forces) = (before, grip.usual_force().to_vec());
        for finger in 1..=THREE {
            let out = outwards(&tips[finger - 1], &middle, finger)?;
            to = fingers
                .reach(finger, &(middle + out * MIDDLE), &to)
                .map_err(cannot)?;
            // What presses back pushes it outwards.
            let torques = fingers
                .torques(finger, &(out * order.force_n), &to)
                .map_err(cannot)?;
            let joints = fingers.joints(finger).map_err(cannot)?;
            for (joint, torque) in joints.iter().zip(torques) {
                if torque.abs() > SHORT * order.force_n {
                    forces[*joint] = torque.abs();
                }
            }
        }
        grip.set_force(&forces).map_err(refused)?;
        self.grasp = Some(Grasped {
            force: order.force_n,
            before,
        });
        let go = MoveFingers {
            joints: to,
            speed: order.speed,
            time_s: None,
        };
        self.move_to(&go).await?;
        cx.sleep(SETTLE).await;
        let found = self.state(cx).await?;
        if !found.holds {
            return Ok(found);
        }
        // Joints at their most give way to a load from the side; springs that press as hard do not.
        let springs = sprung(&grip);
        grip.set_stiffness(&springs).map_err(refused)?;
        let (tips, mut to) = (fingers.tips(&found.joints), found.joints);
        for finger in 1..=THREE {
            let force = outwards(&tips[finger - 1], &middle, finger)? * order.force_n;
            let torques = fingers
                .torques(finger, &force, &found.joints)
                .map_err(cannot)?;
            let joints = fingers.joints(finger).map_err(cannot)?;
            for (joint, torque) in joints.iter().zip(torques) {
                let limits = &grip.model().joints()[*joint].limits;
                to[*joint] =
                    (to[*joint] + torque / springs[*joint]).clamp(limits.lower, limits.upper);
            }
        }
        let hold = MoveFingers { joints: to, ..go };
        self.move_to(&hold).await?;
        grip.set_force(grip.usual_force()).map_err(refused)?;
        cx.sleep(SETTLE).await;
        self.state(cx).await
    }

    async fn let_go(&mut self, cx: &Context, order: &LetGo) -> Result<HandState, MotionError> {
        let joints = match self.grasp {
            Some(grasp) => grasp.before,
            None => self.parts()?.hand.position().await?.joints,
        };
        let back = MoveFingers {
            joints,
            speed: order.speed,
            time_s: None,
        };
        self.fingers(cx, &back).await
    }

    /// Opens the fingertips around the middle of a grasp, so far that something of that width fits between them (m); straight
    /// fingers when no width is given. What they hold, they let go.
    async fn open(&mut self, cx: &Context, order: &Open) -> Result<Held, MotionError> {
        let joints = self.around(order.width_m)?;
        let open = MoveFingers {
            joints,
            speed: order.speed,
            time_s: None,
        };
        let state = self.fingers(cx, &open).await?;
        self.held(&state)
    }

    fn around(&self, width_m: Option<f64>) -> Result<Joints, MotionError> {
        let mut fingers = self.parts()?.fingers;
        let mut to = Joints::zeros(fingers.model().dof());
        let Some(width_m) = width_m else {
            return Ok(to);
        };
        let (straight, middle) = (fingers.tips(&to), Point3::from(self.args.centre_m));
        for (finger, tip) in (1..=THREE).zip(&straight) {
            let out = outwards(tip, &middle, finger)?;
            let at = middle + out * (0.5 * width_m + self.args.tip_m);
            to = fingers.reach(finger, &at, &to).map_err(cannot)?;
        }
        Ok(to)
    }

    /// A tripod grasp where a gripper would grasp.
    async fn grasp(&mut self, cx: &Context, order: &Grasp) -> Result<Held, MotionError> {
        let order = Tripod {
            centre_m: self.args.centre_m,
            force_n: order.force_n.unwrap_or(self.args.force_n),
            speed: order.speed,
        };
        let state = self.tripod(cx, &order).await?;
        self.held(&state)
    }

    /// What a gripper would tell: the width is that of the round thing that all fingertips touch.
    fn held(&self, state: &HandState) -> Result<Held, MotionError> {
        let tips = self.parts()?.fingers.tips(&state.joints);
        let [one, two, three] = *tips.as_slice() else {
            return Err(refused("a tripod grasp takes three fingers"));
        };
        Ok(Held {
            holds: state.holds,
            width_m: (2.0 * (radius(&one, &two, &three) - self.args.tip_m)).max(0.0),
            force_n: state.touch_n.into_iter().fold(f64::INFINITY, f64::min),
        })
    }

    async fn state(&self, cx: &Context) -> Result<HandState, MotionError> {
        let Parts { hand, touch, .. } = self.parts()?;
        let joints = hand.position().await?.joints;
        let arm = self.args.arm.clone();
        let touches = cx.call(&touch, ReadTouch { arm }).await?;
        let mut touch_n = [0.0; THREE];
        for touch in touches {
            // A hand that is part of an arm has its name before its frames'.
            let link = touch.link.rsplit('.').next().unwrap_or_default();
            let finger = link
                .strip_prefix("tip")
                .and_then(|number| number.parse::<usize>().ok());
            if let Some(felt) = finger.and_then(|number| touch_n.get_mut(number.wrapping_sub(1))) {
                *felt = Vector3::from(touch.force_n).norm();
            }
        }
        let powered = hand.status().await?.state == State::Motion;
        let holds = powered
            && self
                .grasp
                .is_some_and(|grasp| touch_n.iter().all(|felt| *felt >= FOUND * grasp.force));
        Ok(HandState {
            joints,
            touch_n,
            holds,
        })
    }
}

impl EventHandler for Hand {
    async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
        match message.command() {
            MoveFingers::CODE => {
                let (order, reply) = message.open::<MoveFingers>()?;
                reply.ok(self.fingers(cx, &order).await)
            }
            Tripod::CODE => {
                let (order, reply) = message.open::<Tripod>()?;
                reply.ok(self.tripod(cx, &order).await)
            }
            LetGo::CODE => {
                let (order, reply) = message.open::<LetGo>()?;
                reply.ok(self.let_go(cx, &order).await)
            }
            ReadHand::CODE => {
                let (ReadHand {}, reply) = message.open::<ReadHand>()?;
                reply.ok(self.state(cx).await)
            }
            Open::CODE => {
                let (order, reply) = message.open::<Open>()?;
                reply.ok(self.open(cx, &order).await)
            }
            Grasp::CODE => {
                let (order, reply) = message.open::<Grasp>()?;
                reply.ok(self.grasp(cx, &order).await)
            }
            ReadHeld::CODE => {
                let (ReadHeld {}, reply) = message.open::<ReadHeld>()?;
                let state = self.state(cx).await;
                reply.ok(state.and_then(|state| self.held(&state)))
            }
            SetStiffness::CODE => {
                let (order, reply) = message.open::<SetStiffness>()?;
                let set = self.parts().and_then(|parts| {
                    let all = vec![order.stiffness; parts.grip.model().dof()];
                    parts.grip.set_stiffness(&all).map_err(refused)
                });
                reply.ok(set)
            }
            SwitchOff::CODE => {
                let (SwitchOff {}, reply) = message.open::<SwitchOff>()?;
                self.grasp = None;
                reply.ok(match self.parts() {
                    Ok(parts) => parts.hand.release().await.map(|_| ()),
                    Err(error) => Err(error),
                })
            }
            _ => cx.default_processing(message),
        }
    }

    async fn phase(&mut self, cx: &Context, phase: Phase) -> Handled {
        if phase == Phase::Connect {
            let grip = self.grips.of(cx, &self.args.grip)?;
            let hand = Manipulator::find(cx, &self.args.client).await;
            self.parts = Some(Parts {
                hand: hand.map_err(|error| HandlerError::new(error.reason))?,
                fingers: Fingers::new(Arc::clone(grip.model()))
                    .map_err(|error| HandlerError::new(error.to_string()))?,
                grip,
                touch: cx.task(&self.args.touch).await?,
            });
        }
        Ok(())
    }

    async fn stop(&mut self, _cx: &Context, _reason: &StopReason) -> Handled {
        // The servo brings the fingers to rest by itself.
        self.parts = None;
        Ok(())
    }
}
