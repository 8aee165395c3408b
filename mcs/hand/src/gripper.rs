//! The event handler `mcs.gripper`: closes a gripper with a force, and tells whether it holds something and how wide that is.
//!
//! It moves the jaws through the client interface of their servo, whose law is [`crate::grip`]: a grasp is a motion to where
//! the jaws would meet. What stops them short of that is held, if they stand still. Nothing else is known of the object.

use std::{sync::Arc, time::Duration};

use ctos::{
    Context,
    config::{App, TaskConfig},
    diagnostic::{Finding, Findings},
    message::{Command, Message},
    registry::Registry,
    task::{EventHandler, Handled, HandlerError, Phase, StopReason},
};
use mcs::{
    Joints,
    client::{Manipulator, MotionError, Move, Outcome, PathKind, Target},
    state::State,
};
use serde::Deserialize;

use crate::{
    command::{Grasp, Held, Open, ReadHeld, SwitchOff},
    grip::{GRIP, Grip, Grips},
};

/// The handler's name.
pub const GRIPPER: &str = "mcs.gripper";

/// The handler that a client interface has.
const CLIENT: &str = "mcs.client";

/// Jaws that move by more than this between two looks do not stand still, m.
const STILL: f64 = 2e-4;
/// Between two looks.
const LOOK: Duration = Duration::from_millis(100);
/// Looks until jaws that still move are given up.
const LOOKS: usize = 20;
/// A motion of the jaws takes no longer.
const LONGEST: Duration = Duration::from_secs(60);

/// Arguments.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
struct GripperArgs {
    /// The task with the client interface of the jaws.
    client: String,
    /// `law_args.name` of the jaws' servo, on the same chassis.
    grip: String,
    /// Jaws that are closer than this (m) hold nothing.
    #[serde(default = "empty_m")]
    empty_m: f64,
}

fn empty_m() -> f64 {
    1e-3
}

/// Registers the handler; laws of the process are found in `grips`.
pub(crate) fn register(registry: &mut Registry, grips: &Grips) {
    let commands = [Grasp::INFO, Open::INFO, ReadHeld::INFO, SwitchOff::INFO];
    let grips = grips.clone();
    registry
        .handler(GRIPPER, &commands, move |cx| {
            Ok(Gripper {
                args: cx.args()?,
                grips: grips.clone(),
                parts: None,
                grasps: false,
            })
        })
        .checked_args::<GripperArgs>(|args, task, app, findings| {
            check_parts(&args.client, &args.grip, (task, app), findings);
            if !(1e-4..=0.1).contains(&args.empty_m) {
                let place = task.args.locate("empty_m");
                let text = format!("`empty_m` is {}", args.empty_m);
                findings.push(
                    Finding::error("mcs::hand::empty", text)
                        .at(place.unwrap_or_else(|| task.place.clone()))
                        .help("give a width from 0.0001 to 0.1 m"),
                );
            }
        });
}

/// Checks that a task has the client interface and the law that it names, the law on its own chassis.
pub(crate) fn check_parts(
    client: &str,
    grip: &str,
    (task, app): (&TaskConfig, &App),
    findings: &mut Findings,
) {
    let place = |key: &str| task.args.locate(key).unwrap_or_else(|| task.place.clone());
    let clients = app.tasks.iter().filter(|other| other.handler == CLIENT);
    let mut names = clients.map(|other| other.name.as_str());
    if !names.clone().any(|name| name == client) {
        let text = format!(
            "task `{}` needs `client`, but no task with the handler `{CLIENT}` is called `{client}`",
            task.name
        );
        let finding = Finding::error("mcs::hand::client", text).at(place("client"));
        findings.push(finding.suggest(client, names.by_ref()));
    }
    let named = app.tasks.iter().filter_map(|other| {
        let law = other.args.get("law").and_then(|law| law.as_str());
        let name = other.args.get("law_args")?.get("name")?.as_str()?;
        (law == Some(GRIP)).then_some((name, other))
    });
    match named.clone().find(|(name, _)| *name == grip) {
        None => {
            let text = format!(
                "task `{}` needs `grip`, but no servo has the law `{GRIP}` with the name `{grip}`",
                task.name
            );
            let finding = Finding::error("mcs::hand::grip", text)
                .at(place("grip"))
                .help(format!(
                    "write `law = \"{GRIP}\"` and `law_args.name = \"{grip}\"` for the servo"
                ));
            findings.push(finding.suggest(grip, named.map(|(name, _)| name)));
        }
        Some((_, servo)) if servo.chassis != task.chassis => {
            let text = format!(
                "task `{}` is on chassis `{}` and its servo `{}` on `{}`",
                task.name, task.chassis, servo.name, servo.chassis
            );
            let help =
                "it sets the force through the memory of their chassis: put both on the same one";
            let finding = Finding::error("mcs::hand::apart", text).at(task.on_place.clone());
            findings.push(finding.help(help));
        }
        Some(_) => {}
    }
}

#[derive(Clone)]
struct Parts {
    jaws: Manipulator,
    grip: Arc<Grip>,
}

struct Gripper {
    args: GripperArgs,
    grips: Grips,
    parts: Option<Parts>,
    /// The last that was asked for is a grasp.
    grasps: bool,
}

pub(crate) fn refused(reason: impl ToString) -> MotionError {
    MotionError::new(Outcome::Refused, reason)
}

impl Gripper {
    fn parts(&self) -> Result<Parts, MotionError> {
        let parts = self.parts.clone();
        parts.ok_or_else(|| refused("the gripper is not connected yet"))
    }

    async fn grasp(&mut self, cx: &Context, order: &Grasp) -> Result<Held, MotionError> {
        let Parts { jaws, grip } = self.parts()?;
        let count = grip.model().dof();
        let closed = Joints::from_fn(count, |joint| limits(&grip, joint)[0]);
        let force = order.force_n.map(|force| vec![force; count]);
        let force = force.unwrap_or_else(|| grip.usual_force().to_vec());
        jaws.acquire().await?;
        grip.set_force(&force).map_err(refused)?;
        self.grasps = true;
        self.move_to(&jaws, closed, order.speed).await?;
        self.held(cx).await
    }

    async fn open(&mut self, cx: &Context, order: &Open) -> Result<Held, MotionError> {
        let Parts { jaws, grip } = self.parts()?;
        let count = grip.model().dof();
        let ends: Vec<[f64; 2]> = (0..count).map(|joint| limits(&grip, joint)).collect();
        let widest = ends.iter().map(|[_, upper]| upper).sum();
        let width = order.width_m.unwrap_or(widest);
        if !(0.0..=widest).contains(&width) {
            let text = format!("the gripper opens from 0 to {widest} m, not to {width}");
            return Err(refused(text));
        }
        let share = width / count.max(1) as f64;
        let to = Joints::from_fn(count, |joint| share.min(ends[joint][1]));
        jaws.acquire().await?;
        grip.set_force(grip.usual_force()).map_err(refused)?;
        self.grasps = false;
        self.move_to(&jaws, to, order.speed).await?;
        self.held(cx).await
    }

    async fn move_to(&self, jaws: &Manipulator, to: Joints, speed: f64) -> Result<(), MotionError> {
        let order = Move {
            target: Target::Joints(to),
            path: PathKind::Joint,
            speed,
            acceleration: Some(1.0),
            elbow: None,
            blend: 0.0.into(),
            guards: Vec::new(),
        };
        jaws.go(order, LONGEST).await.map(|_| ())
    }

    /// Looks until the jaws stand still.
    async fn held(&self, cx: &Context) -> Result<Held, MotionError> {
        let Parts { jaws, grip } = self.parts()?;
        let status = jaws.status().await?;
        let presses = self.grasps && status.state == State::Motion;
        let width = |joints: Joints| joints.iter().sum::<f64>();
        let mut before = width(jaws.position().await?.joints);
        for _ in 0..LOOKS {
            cx.sleep(LOOK).await;
            let now = width(jaws.position().await?.joints);
            let still = (now - before).abs() <= STILL;
            before = now;
            if still {
                return Ok(Held {
                    holds: presses && now > self.args.empty_m,
                    width_m: now,
                    force_n: grip.force().into_iter().fold(f64::INFINITY, f64::min),
                });
            }
        }
        let text = format!(
            "the jaws do not come to a stand, {:.1} mm apart: what they hold slips",
            before * 1e3
        );
        Err(MotionError::new(Outcome::Fault, text))
    }
}

/// Where a jaw can be, m.
fn limits(grip: &Grip, joint: usize) -> [f64; 2] {
    let joint = grip.model().joints().get(joint);
    joint.map_or([0.0; 2], |joint| [joint.limits.lower, joint.limits.upper])
}

impl EventHandler for Gripper {
    async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
        match message.command() {
            Grasp::CODE => {
                let (order, reply) = message.open::<Grasp>()?;
                reply.ok(self.grasp(cx, &order).await)
            }
            Open::CODE => {
                let (order, reply) = message.open::<Open>()?;
                reply.ok(self.open(cx, &order).await)
            }
            ReadHeld::CODE => {
                let (ReadHeld {}, reply) = message.open::<ReadHeld>()?;
                reply.ok(self.held(cx).await)
            }
            SwitchOff::CODE => {
                let (SwitchOff {}, reply) = message.open::<SwitchOff>()?;
                self.grasps = false;
                reply.ok(match self.parts() {
                    Ok(parts) => parts.jaws.release().await.map(|_| ()),
                    Err(error) => Err(error),
                })
            }
            _ => cx.default_processing(message),
        }
    }

    async fn phase(&mut self, cx: &Context, phase: Phase) -> Handled {
        if phase == Phase::Connect {
            let grip = self.grips.of(cx, &self.args.grip)?;
            let jaws = Manipulator::find(cx, &self.args.client).await;
            let jaws = jaws.map_err(|error| HandlerError::new(error.reason))?;
            self.parts = Some(Parts { jaws, grip });
        }
        Ok(())
    }

    async fn stop(&mut self, _cx: &Context, _reason: &StopReason) -> Handled {
        // The servo brings the jaws to rest by itself.
        self.parts = None;
        Ok(())
    }
}
