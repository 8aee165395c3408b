//! The Push Coordinator: the functions of `nets/push/pusher.net`, which feel for a thing and push it.
//!
//! The arm is stiff while it goes to and fro. Before it pushes it goes over to a compliant law, and back before it withdraws.
//! What ends a push is told apart by the guard that ended it.

use std::{rc::Rc, time::Duration};

use ctos::{
    config::{App, TaskConfig},
    diagnostic::Findings,
    registry::Registry,
    task::Context,
};
use mcs::client::{MotionError, Move, Outcome as Motion, PathKind, PlanReport, Target};
use mcs_hand::command::MoveFingers;
use nalgebra::{Isometry3, Point3, Translation3, Vector3};
use pnt::library::{Acted, Action, Library};
use serde::{Deserialize, Serialize};

use super::{
    args::ArmArgs,
    job::{ACCOUNT, Account, JOB, Job},
};
use crate::{
    arm::{self, Arm},
    dom::DomStore,
    handler::{self, NetArgs},
    outcome::{Failure, Outcome},
};

/// The handler's name.
pub const HANDLER: &str = "coordinators.push_arm";

/// How long the fingers may take.
const SHAPED: Duration = Duration::from_secs(60);

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
pub(super) struct Coordinator {
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
        ArmArgs::check(self, task, app, findings);
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
        if self.args.light {
            return Ok(());
        }
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
        if self.args.light {
            return self
                .line(end, self.args.gentle, &[&self.args.blocked])
                .await;
        }
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
