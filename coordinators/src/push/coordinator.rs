//! The Push Coordinator: the functions of `nets/push/pusher.net`, which feel for a thing and push it.
//!
//! The arm is stiff while it goes to and fro. Before it pushes it goes over to a compliant law, and back before it withdraws.
//! What ends a push is told apart by the guard that ended it.

use std::{rc::Rc, time::Duration};

use ctos::{
    config::{App, TaskConfig},
    diagnostic::{Finding, Findings},
    registry::Registry,
    task::Context,
};
use mcs::client::{MotionError, Move, Outcome as Motion, PathKind, PlanReport, Target};
use mcs_hand::command::MoveFingers;
use nalgebra::{Isometry3, Point3, Translation3, Vector3};
use pnt::library::{Acted, Action, Library};
use serde::{Deserialize, Serialize};

use super::job::{ACCOUNT, Account, JOB, Job};
use crate::{
    arm::{self, Arm, ArmKeys},
    dom::DomStore,
    handler::{self, NetArgs},
    motion::{mcs_task, resume_within_s},
    outcome::{Failure, Outcome},
};

/// The handler's name.
pub const HANDLER: &str = "coordinators.push_arm";

/// How long the fingers may take.
const SHAPED: Duration = Duration::from_secs(60);

/// Arguments.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
struct ArmArgs {
    /// The client interface of MCS.
    #[serde(default = "mcs_task")]
    mcs: String,
    /// The data object manager.
    #[serde(default = "crate::dom_task")]
    dom: String,
    /// Fraction of full speed to and fro.
    #[serde(default = "speed")]
    speed: f64,
    /// The same while it feels for the thing, and while it pushes.
    #[serde(default = "gentle")]
    gentle: f64,
    /// The same of the acceleration in a push.
    #[serde(default = "softly")]
    softly: f64,
    /// Height of what pushes, m.
    height_m: f64,
    /// What pushes, in the tool's frame, m: the tool itself when it is left out.
    #[serde(default)]
    tip_m: [f64; 3],
    /// The hand whose fingers are shaped before; none when it is left out.
    hand: Option<HandArgs>,
    /// How far above that it goes to and fro, m.
    #[serde(default = "clearance_m")]
    clearance_m: f64,
    /// How the tool may be turned about the vertical from the direction of the push, degrees: the first turn with which the
    /// arm reaches all of the way is taken.
    #[serde(default = "turns_deg")]
    turns_deg: Vec<f64>,
    /// The recipe of the guard that ends an approach at a touch.
    #[serde(default = "touch")]
    touch: String,
    /// The recipe of the guard that ends a push which meets too much force.
    #[serde(default = "blocked")]
    blocked: String,
    /// The recipe of the guard that ends a push whose contact is lost.
    #[serde(default = "contact")]
    contact: String,
    /// The control law in a push, and otherwise.
    #[serde(default = "compliant")]
    compliant: String,
    /// See above.
    #[serde(default = "stiff")]
    stiff: String,
    /// A compliant arm lags behind: a push is done when it ends so near to its end, m.
    #[serde(default = "within_m")]
    within_m: f64,
    /// How often a contact that was lost is felt for again.
    #[serde(default = "again")]
    again: u32,
    /// How far it backs off a thing before it goes up, m.
    #[serde(default = "back_m")]
    back_m: f64,
    /// Where the arm waits, degrees of its joints.
    park_deg: Vec<f64>,
    /// How long a protective stop is waited out before the request fails, s.
    #[serde(default = "resume_within_s")]
    resume_within_s: f64,
    /// How long an MCS that is gone, and may be started again, is waited for, s.
    #[serde(default = "crate::service_within_s")]
    service_within_s: f64,
}

/// A hand with fingers.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
struct HandArgs {
    /// Its task.
    task: String,
    /// Its joints while it pushes, degrees: one finger straight, the others out of the way.
    posture_deg: Vec<f64>,
    /// Fraction of full speed of the fingers.
    #[serde(default = "speed")]
    speed: f64,
}

fn speed() -> f64 {
    0.5
}

fn gentle() -> f64 {
    0.08
}

fn softly() -> f64 {
    0.2
}

fn clearance_m() -> f64 {
    0.1
}

fn turns_deg() -> Vec<f64> {
    vec![0.0, 180.0]
}

fn touch() -> String {
    "touch".to_owned()
}

fn blocked() -> String {
    "blocked".to_owned()
}

fn contact() -> String {
    "contact".to_owned()
}

fn compliant() -> String {
    "cartesian_impedance".to_owned()
}

fn stiff() -> String {
    "pid".to_owned()
}

fn within_m() -> f64 {
    0.01
}

fn again() -> u32 {
    2
}

fn back_m() -> f64 {
    0.02
}

impl ArmArgs {
    fn arm<'a>(&'a self, cx: &'a Context) -> Arm<'a> {
        Arm {
            cx,
            mcs: &self.mcs,
            within_s: self.service_within_s,
        }
    }
}

/// A part of a push, as the Dispatcher asks for it.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
enum Part {
    /// Down beside the thing.
    #[default]
    Approach,
    /// Ahead until it is felt.
    Touch,
    /// Ahead with it.
    Push,
    /// Back off it, and up.
    Withdraw,
    /// To where the arm waits; there it is given back.
    Park,
}

impl Part {
    const ALL: [Self; 5] = [
        Self::Approach,
        Self::Touch,
        Self::Push,
        Self::Withdraw,
        Self::Park,
    ];

    fn name(self) -> &'static str {
        match self {
            Self::Approach => "approach",
            Self::Touch => "touch",
            Self::Push => "push",
            Self::Withdraw => "withdraw",
            Self::Park => "park",
        }
    }
}

/// What the functions share.
struct Coordinator {
    args: Rc<ArmArgs>,
    store: DomStore,
    /// The part that was asked for last.
    part: Part,
    /// What ended it before its end.
    ended: Option<Failure>,
    /// Whether that was a contact that was lost, which may be felt for again.
    lost_contact: bool,
    account: Account,
}

/// Registers the handler.
pub(super) fn register(registry: &mut Registry) {
    handler::register::<ArmArgs>(registry);
}

impl NetArgs for ArmArgs {
    const HANDLER: &'static str = HANDLER;
    type State = Coordinator;

    fn dom(&self) -> &str {
        &self.dom
    }

    fn library(self, store: DomStore) -> Library<Coordinator> {
        library(self, store)
    }

    fn check(&self, task: &TaskConfig, app: &App, findings: &mut Findings) {
        check(self, task, app, findings);
    }
}

fn check(args: &ArmArgs, task: &TaskConfig, app: &App, findings: &mut Findings) {
    let keys = ArmKeys {
        mcs: &args.mcs,
        resume_within_s: args.resume_within_s,
        service_within_s: args.service_within_s,
        speeds: &[
            ("speed", args.speed),
            ("gentle", args.gentle),
            ("softly", args.softly),
        ],
        park_deg: Some(&args.park_deg),
    };
    keys.check(task, app, "coordinators::push::range", findings);
    if let Some(hand) = &args.hand {
        crate::need_task(task, app, "hand.task", &hand.task, findings);
        crate::check_speed(task, "hand.speed", hand.speed, findings);
    }
    let mut wrong = |key: &str, text: String| {
        let place = task.args.locate(key).unwrap_or_else(|| task.place.clone());
        findings.push(Finding::error("coordinators::push::range", text).at(place));
    };
    for (key, value, most) in [
        ("clearance_m", args.clearance_m, 2.0),
        ("back_m", args.back_m, 0.5),
        ("within_m", args.within_m, 0.2),
    ] {
        if !(0.0..=most).contains(&value) {
            wrong(key, format!("`{key}` is {value}; give from 0 to {most} m"));
        }
    }
    if !(-5.0..=5.0).contains(&args.height_m) {
        let text = format!("`height_m` is {}; give from -5 to 5 m", args.height_m);
        wrong("height_m", text);
    }
    if args.tip_m.iter().any(|part| !(-1.0..=1.0).contains(part)) {
        let text = format!("`tip_m` is {:?}; give from -1 to 1 m", args.tip_m);
        wrong("tip_m", text);
    }
    if args.turns_deg.is_empty() {
        wrong(
            "turns_deg",
            "`turns_deg` needs at least one turn".to_owned(),
        );
    }
}

fn library(args: ArmArgs, store: DomStore) -> Library<Coordinator> {
    let state = Coordinator {
        args: Rc::new(args),
        store,
        part: Part::default(),
        ended: None,
        lost_contact: false,
        account: Account::default(),
    };
    let save = |state: &Coordinator| {
        let ended = state.ended.clone();
        (state.part, ended, state.lost_contact, state.account.clone())
    };
    let mut library = Library::new(state)
        .kept(save, |state, (part, ended, lost_contact, account)| {
            (state.part, state.ended) = (part, ended);
            (state.lost_contact, state.account) = (lost_contact, account);
        })
        .enabling("stopped", |state: &Coordinator| {
            let ended = state.ended.as_ref();
            ended.is_some_and(|failure| failure.outcome == Outcome::Stopped)
        })
        .enabling("lost_contact", |state: &Coordinator| {
            state.lost_contact && state.account.again < state.args.again
        })
        .action("once_more", |action: Act| async move {
            let part = action.with_state(|state| state.part);
            act(action, part).await
        })
        .action("feel_again", feel_again)
        .action("await_resume", await_resume)
        .action("give_up", give_up);
    for part in Part::ALL {
        library = library.action(part.name(), move |action: Act| act(action, part));
    }
    library
}

type Act = Action<Coordinator>;

/// Does a part. Why that ended is kept, and passed up when it is given up.
async fn act(action: Act, part: Part) -> Acted {
    let done = match Pushing::of(&action, part).await {
        Ok(mut pushing) => {
            let done = pushing.act(part).await;
            let (account, lost) = (pushing.account, pushing.lost_contact);
            action.with_state(|state| (state.account, state.lost_contact) = (account, lost));
            done
        }
        Err(failure) => Err(failure),
    };
    action.with_state(|state| {
        state.part = part;
        state.ended = done.as_ref().err().cloned();
        if part != Part::Push {
            state.lost_contact = false;
        }
    });
    publish(&action).await;
    Ok(done?)
}

/// Feels for the thing again, after a contact that was lost.
async fn feel_again(action: Act) -> Acted {
    action.with_state(|state| state.account.again += 1);
    let again = act(action.clone(), Part::Touch).await;
    // What is asked for is still the push.
    action.with_state(|state| state.part = Part::Push);
    again
}

/// Waits until somebody ends the protective stop that ended the motion; the part is then done from where the arm stands.
async fn await_resume(action: Act) -> Acted {
    let (args, ended) = action.with_state(|state| (state.args.clone(), state.ended.clone()));
    let reason = ended.map_or_else(String::new, |ended| ended.reason);
    let arm = args.arm(action.cx());
    let resumed = arm.resumed(args.resume_within_s, &reason).await;
    if let Err(failure) = resumed {
        action.with_state(|state| state.ended = Some(failure.clone()));
        return give_up(action).await.and(Err(failure.into()));
    }
    Ok(())
}

/// Passes up why a part was not done.
async fn give_up(action: Act) -> Acted {
    action.with_state(|state| {
        if let Some(failure) = state.ended.take() {
            let request = state.part.name().to_owned();
            state.account.problems.push((request, failure));
        }
    });
    publish(&action).await;
    Ok(())
}

/// Tells the Dispatcher how it stands.
async fn publish(action: &Act) {
    let (store, account) = action.with_state(|state| (state.store.clone(), state.account.clone()));
    if let Err(untold) = store.store(action.cx(), ACCOUNT, &account).await {
        tracing::warn!(%untold, "how a push went could not be passed up");
    }
}

/// A job, and the arm that does it.
struct Pushing<'a> {
    cx: &'a Context,
    args: Rc<ArmArgs>,
    job: Job,
    account: Account,
    lost_contact: bool,
}

impl<'a> Pushing<'a> {
    async fn of(action: &'a Act, part: Part) -> Result<Self, Failure> {
        let (args, store, account) = action.with_state(|state| {
            (
                state.args.clone(),
                state.store.clone(),
                state.account.clone(),
            )
        });
        let cx = action.cx();
        let job: Job = store.fetch(cx, JOB).await?;
        let begins = part == Part::Approach && account.command != job.command;
        let account = match begins {
            false => account,
            true => Account {
                command: job.command,
                ..Account::default()
            },
        };
        if begins {
            // Whatever comes of it counts for this command.
            action.with_state(|state| state.account = account.clone());
        }
        Ok(Self {
            cx,
            args,
            job,
            account,
            lost_contact: false,
        })
    }

    async fn act(&mut self, part: Part) -> Result<(), Failure> {
        self.arm().acquire().await?;
        match part {
            Part::Approach => self.approach().await,
            Part::Touch => self.touch().await,
            Part::Push => {
                let pushed = self.push().await;
                // Where a push ended is true whatever ended it.
                if let Ok(along) = self.along().await {
                    self.account.ended_m = Some(along);
                }
                pushed
            }
            Part::Withdraw => self.withdraw().await,
            Part::Park => self.park().await,
        }
    }

    /// Above the beginning of the way and down, with the first turn that reaches all of it.
    async fn approach(&mut self) -> Result<(), Failure> {
        self.law(&self.args.stiff).await?;
        self.shape().await?;
        let (height, length) = (self.args.height_m, self.job.length());
        let up = height + self.args.clearance_m;
        let mut first = None;
        for turn in self.args.turns_deg.clone() {
            let turn = turn.to_radians();
            let ends = [(length, height), (0.0, height), (0.0, up)];
            let mut planned = Err(Failure::new(Outcome::Fault, "a way has ends"));
            for (along, height) in ends {
                let pose = self.tool_at(along, height, turn);
                let target = arm::pose(&pose);
                let arm = self.arm();
                planned = arm.plan(target, PathKind::Joint, self.args.speed).await;
                if planned.is_err() {
                    break;
                }
            }
            match planned {
                Ok(PlanReport {
                    joints, duration_s, ..
                }) => {
                    self.account.turn = Some(turn);
                    let target = Target::Joints(joints);
                    let order = arm::order(target, PathKind::Joint, self.args.speed);
                    self.arm().go(order, duration_s).await?;
                    let down = self.tool_at(0.0, height, turn);
                    return self.line(down, self.args.speed, &[&self.args.touch]).await;
                }
                Err(failure) if failure.outcome == Outcome::Unreachable => {
                    first.get_or_insert(failure);
                }
                Err(failure) => return Err(failure),
            }
        }
        Err(first.unwrap_or_else(|| Failure::new(Outcome::Fault, "no turn is named")))
    }

    /// Ahead along the way until something is felt.
    async fn touch(&mut self) -> Result<(), Failure> {
        self.law(&self.args.stiff).await?;
        let end = self.pose(self.job.length())?;
        match self.line(end, self.args.gentle, &[&self.args.touch]).await {
            Err(failure) if failure.outcome == Outcome::Guard => {
                self.was(&self.args.touch, failure).await?;
                let along = self.along().await?;
                self.account.touched_m.get_or_insert(along);
                Ok(())
            }
            Err(failure) => Err(failure),
            Ok(()) => Err(Failure::new(
                Outcome::Absent,
                "nothing was felt on all of the way",
            )),
        }
    }

    /// Ahead to the end of the way with what is felt.
    async fn push(&mut self) -> Result<(), Failure> {
        let end = self.pose(self.job.length())?;
        let compliant = self.args.compliant.clone();
        self.law(&compliant).await?;
        let guards = [self.args.blocked.as_str(), self.args.contact.as_str()];
        let pushed = self.line(end, self.args.gentle, &guards).await;
        match pushed {
            Ok(()) => {
                let short = self.job.length() - self.along().await?;
                if short <= self.args.within_m {
                    return Ok(());
                }
                Err(Failure::new(
                    Outcome::Guard,
                    format!(
                        "the compliant arm stands {:.0} mm short of the end",
                        short * 1e3
                    ),
                ))
            }
            Err(failure) if failure.outcome == Outcome::Guard => {
                let contact = self.args.contact.clone();
                match self.was(&contact, failure).await {
                    Ok(failure) => {
                        self.lost_contact = true;
                        Err(failure)
                    }
                    Err(failure) => Err(failure),
                }
            }
            Err(failure) => Err(failure),
        }
    }

    /// The failure, when the guard of that name ended the motion; else as an error.
    async fn was(&self, guard: &str, failure: Failure) -> Result<Failure, Failure> {
        match self.arm().was_ended_by(&[guard]).await? {
            true => Ok(failure),
            false => Err(failure),
        }
    }

    /// Back off the thing and straight up.
    async fn withdraw(&mut self) -> Result<(), Failure> {
        let Some(turn) = self.account.turn else {
            // It never went down.
            return Ok(());
        };
        let up = self.args.height_m + self.args.clearance_m;
        let tip = self.tip().await?;
        if tip.z < up - 1e-3 {
            let back = self.job.along(&tip.xy()) - self.args.back_m;
            let off = self.tool_at(back, tip.z, turn);
            // A stiff arm would press harder before it goes back.
            self.line(off, self.args.gentle, &[]).await?;
            self.law(&self.args.stiff).await?;
            self.line(self.tool_at(back, up, turn), self.args.speed, &[])
                .await?;
        }
        Ok(())
    }

    /// To where the arm waits; there it is given back.
    async fn park(&self) -> Result<(), Failure> {
        self.law(&self.args.stiff).await?;
        let park = &self.args.park_deg;
        self.arm().park(park, self.args.speed).await
    }

    async fn law(&self, law: &str) -> Result<(), Failure> {
        let arm = self.arm();
        arm.ask(|arm| async move { arm.law(law).await }).await?;
        Ok(())
    }

    /// The tool so far along the way, with the turn that was chosen.
    fn pose(&self, along: f64) -> Result<Isometry3<f64>, Failure> {
        let none = || Failure::new(Outcome::Fault, "no turn was chosen for this job");
        let turn = self.account.turn.ok_or_else(none)?;
        Ok(self.tool_at(along, self.args.height_m, turn))
    }

    /// `base_t_tool` with what pushes so far along the way and so high, m.
    fn tool_at(&self, along: f64, height: f64, turn: f64) -> Isometry3<f64> {
        let tip = Translation3::from(Vector3::from(self.args.tip_m));
        self.job.pose(along, height, turn) * tip.inverse()
    }

    /// Where what pushes is, base frame, m.
    async fn tip(&self) -> Result<Point3<f64>, Failure> {
        Ok(self.arm().tool().await? * Point3::from(self.args.tip_m))
    }

    /// How far along the way that is, m.
    async fn along(&self) -> Result<f64, Failure> {
        Ok(self.job.along(&self.tip().await?.xy()))
    }

    /// Straightens the finger that pushes, where there is a hand.
    async fn shape(&self) -> Result<(), Failure> {
        let Some(hand) = &self.args.hand else {
            return Ok(());
        };
        let order = MoveFingers {
            joints: arm::radians(&hand.posture_deg),
            speed: hand.speed,
            time_s: None,
        };
        let within = Duration::try_from_secs_f64(self.args.service_within_s);
        let within = within.unwrap_or(Duration::MAX);
        let is_lost = |error: &MotionError| error.outcome == Motion::Lost;
        let shaped = crate::patiently(self.cx, within, is_lost, || async {
            let task = self.cx.task(&hand.task).await?;
            let call = self.cx.call(&task, order.clone());
            call.deadline(SHAPED).await?
        });
        shaped.await?;
        Ok(())
    }

    /// Straight to a pose.
    async fn line(&self, pose: Isometry3<f64>, speed: f64, guards: &[&str]) -> Result<(), Failure> {
        let order = Move {
            acceleration: Some(speed.max(self.args.softly)),
            guards: guards.iter().map(ToString::to_string).collect(),
            ..arm::order(arm::pose(&pose), PathKind::StraightLine, speed)
        };
        self.arm().travel(order).await.map(|_| ())
    }

    fn arm(&self) -> Arm<'_> {
        self.args.arm(self.cx)
    }
}
