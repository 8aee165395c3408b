//! The supervisor of one chassis: brings its tasks through the phases, sees it fail, makes sure that its
//! process is dead, and starts the next one as the policy allows. Steps through
//! [`ChassisState`](super::ChassisState); what may follow what stands there.

use std::{future::pending, rc::Rc, time::Duration};

use futures_util::future::{Either, join_all, select};

use crate::bootstrap::{
    BootEvent, End,
    board::{Board, Event},
    explain::explained,
    intensity::{Ended, Verdict},
    states::ChassisStep,
};
use ctos_core::{
    context::{Context, TaskRef},
    phase::{Phase, StopReason},
    system::{self, AnnounceUp, CreateTasks, EnterPhase, FirstSlots, News},
};
use ctos_message::fault::Fault;

/// How long the links of a dead process may take to close.
const LINK_TIMEOUT: Duration = Duration::from_secs(1);

/// Why an incarnation of a chassis is over.
enum Over {
    /// Its process is dead.
    Dead { how: String, code: Option<i32> },
    /// Nobody is connected to it any more.
    Lost,
    /// It must go, for a reason that completes "the chassis ...".
    Failed { reason: String },
    /// A person wants it anew.
    Asked,
    /// The app is being stopped.
    Stopped,
}

/// The app is being stopped: there is nothing more to supervise.
struct Stopped;

/// How a dead process ended, and whether a person wanted it to.
struct Death {
    /// Completes "the chassis ...".
    reason: String,
    ended: Ended,
    asked: bool,
}

/// Supervises chassis `index` until the app is stopped.
pub(super) async fn supervise(board: Rc<Board>, index: u8) {
    let supervisor = Supervisor { board, index };
    // Its end is that of the app, which the sequence sees to.
    let _ = supervisor.run().await;
}

struct Supervisor {
    board: Rc<Board>,
    index: u8,
}

impl Supervisor {
    async fn run(&self) -> Result<(), Stopped> {
        loop {
            let over = self.live().await;
            let failed_at = self.board.cx.now();
            self.step(ChassisStep::Fails);
            if matches!(over, Over::Asked) || self.may_return() {
                self.board.tell_names(News::Away(self.index));
            }
            self.board.with(self.index, |member| {
                member.reached = None;
                member.failed_at = Some(failed_at);
            });
            let Some(death) = self.bury(over).await? else {
                return Ok(());
            };
            let Some((incarnation, pause)) = self.judge(&death) else {
                return Ok(());
            };
            self.step(ChassisStep::DeadMayRestart);
            self.board.event(&BootEvent::Restarting {
                chassis: self.name(),
                incarnation,
                pause,
            });
            self.pause(pause).await?;
            self.step(ChassisStep::Paused);
            self.board.with(self.index, |member| {
                member.incarnation = incarnation;
                member.tasks.clear();
            });
            self.board.start_process(self.index, incarnation);
        }
    }

    fn name(&self) -> String {
        self.board.cx.chassis().name_of(self.index).to_owned()
    }

    fn step(&self, step: ChassisStep) {
        self.board.step_chassis(self.index, step);
    }

    /// One incarnation, from the start of its process until it is over.
    async fn live(&self) -> Over {
        let timeout = self.board.cx.app().phase_timeout;
        let joined = self.board.cx.timeout(timeout, self.joined()).await;
        match joined {
            Ok(Ok(())) => self.step(ChassisStep::Joined),
            Ok(Err(over)) => return over,
            Err(elapsed) => {
                let reason = format!("did not connect: {elapsed}");
                return Over::Failed { reason };
            }
        }
        let up = std::pin::pin!(self.up());
        let trouble = std::pin::pin!(self.trouble());
        match select(up, trouble).await {
            Either::Left((reason, _)) => Over::Failed { reason },
            Either::Right((over, _)) => over,
        }
    }

    async fn joined(&self) -> Result<(), Over> {
        loop {
            match self.board.next_event(self.index).await {
                Event::Joined => return Ok(()),
                // Of the process before this one, or of a person who has what he wants.
                Event::Lost | Event::TaskFailed { .. } | Event::Restart => {}
                Event::Dead { how, code } => return Err(Over::Dead { how, code }),
                Event::Stop => return Err(Over::Stopped),
            }
        }
    }

    /// Ends with the first thing that ends the incarnation.
    async fn trouble(&self) -> Over {
        loop {
            match self.board.next_event(self.index).await {
                Event::Joined => {}
                Event::Lost => return Over::Lost,
                Event::Dead { how, code } => return Over::Dead { how, code },
                Event::TaskFailed { task, reason } => {
                    let reason = format!("has a task that failed: `{task}`: {reason}");
                    return Over::Failed { reason };
                }
                Event::Restart => return Over::Asked,
                Event::Stop => return Over::Stopped,
            }
        }
    }

    /// Brings the tasks through the phases that the app has reached, and on with it. Ends, with the
    /// reason, only when that fails.
    async fn up(&self) -> String {
        for phase in Phase::ALL {
            self.board.wanted(self.index, phase).await;
            let failures = match phase {
                Phase::Create => match self.create().await {
                    Ok(()) => self.enter(phase).await,
                    Err(failures) => failures,
                },
                Phase::Connect | Phase::Run => self.enter(phase).await,
            };
            if !failures.is_empty() {
                return self.not_passed(phase, failures).await;
            }
            self.board
                .with(self.index, |member| member.reached = Some(phase));
            self.board.changed();
        }
        self.step(ChassisStep::Passed);
        self.welcome().await
    }

    /// The tasks have passed all phases: whoever waits for them is told.
    async fn welcome(&self) -> String {
        let board = &self.board;
        let known = board.with(self.index, |member| (member.failed_at, member.tasks.len()));
        if let Some((Some(failed_at), tasks)) = known {
            let chassis = self.name();
            // Before anybody is told and may look for its tasks.
            board.tell_names(News::Back(self.index));
            for other in board.cx.chassis().others().chain([0]) {
                if other != self.index && (other == 0 || board.cx.chassis().is_linked(other)) {
                    let announce = AnnounceUp {
                        chassis: chassis.clone(),
                    };
                    let agent = system::agent_tid(other);
                    board.cx.chassis().post_system(agent, announce);
                }
            }
            board.event(&BootEvent::Restarted {
                chassis,
                tasks,
                took: board.cx.now().since(failed_at),
            });
            board.answer_restarts(self.index, &Ok(()));
        }
        pending().await
    }

    /// Tasks did not pass `phase`. In the first boot of the app that undoes the boot; later it is a
    /// failure of the chassis.
    async fn not_passed(&self, phase: Phase, failures: Vec<(String, String)>) -> String {
        if !self.board.is_up() {
            self.board
                .with(self.index, |member| member.failures = failures);
            self.board.changed();
            return pending().await;
        }
        let failures: Vec<String> = failures
            .iter()
            .map(|(task, reason)| format!("`{task}`: {reason}"))
            .collect();
        format!(
            "did not pass startup phase `{phase}`: {}",
            failures.join("; ")
        )
    }

    /// Lets the agent create the tasks.
    async fn create(&self) -> Result<(), Vec<(String, String)>> {
        let cx = &self.board.cx;
        let timeout = cx.app().phase_timeout;
        let name = format!("agent of {}", self.name());
        let agent = TaskRef::new(name.as_str(), system::agent_tid(self.index));
        let asked = FirstSlots {
            chassis: self.index,
        };
        let first_slots = match cx.call(&Context::server(), asked).deadline(timeout).await {
            Ok(first_slots) => first_slots,
            Err(error) => return Err(vec![(name, error.to_string())]),
        };
        let call = cx.call(&agent, CreateTasks { first_slots });
        match call.deadline(timeout).await {
            Ok(created) => {
                self.board
                    .with(self.index, |member| member.tasks = created.tasks);
                if created.failed.is_empty() {
                    Ok(())
                } else {
                    Err(created.failed)
                }
            }
            // The process is gone, which is told in another way.
            Err(error) if matches!(error.fault, Fault::PeerDown { .. }) => pending().await,
            Err(error) => Err(vec![(name, error.to_string())]),
        }
    }

    /// Tells every task to enter `phase` and waits for all of them: the failures.
    async fn enter(&self, phase: Phase) -> Vec<(String, String)> {
        let cx = &self.board.cx;
        let timeout = cx.app().phase_timeout;
        let tasks = self.board.with(self.index, |member| member.tasks.clone());
        let tasks = tasks.unwrap_or_default();
        let calls = tasks.iter().map(|task| {
            let reference = TaskRef::new(task.name.as_str(), task.tid);
            let call = cx.call(&reference, EnterPhase { phase }).deadline(timeout);
            async move {
                match call.await {
                    Ok(()) => None,
                    // The process is gone, which is told in another way.
                    Err(error) if matches!(error.fault, Fault::PeerDown { .. }) => pending().await,
                    Err(error) => {
                        let asked = format!("acknowledge phase {phase}");
                        let why = explained(cx, task, &asked, error).await;
                        Some((task.name.clone(), why))
                    }
                }
            }
        });
        join_all(calls).await.into_iter().flatten().collect()
    }

    /// Makes sure that the process is dead. `None` when it cannot be ended, which ends the app.
    async fn bury(&self, over: Over) -> Result<Option<Death>, Stopped> {
        let (reason, asked) = match over {
            Over::Stopped => return Err(Stopped),
            Over::Dead { how, code } => {
                self.told_failed(&how);
                self.links_closed().await?;
                return Ok(Some(Death::of(how, code)));
            }
            Over::Lost => {
                if !self.may_return() {
                    // Its end need not be waited for: the app ends, and that waits for all processes.
                    let chassis = self.name();
                    self.board.end(End::ChassisDown { chassis });
                    return Ok(None);
                }
                // Having lost the boot it stops its tasks by itself.
                return match self.dead_or_killed().await? {
                    Some((how, code)) => {
                        self.told_failed(&how);
                        Ok(Some(Death::of(how, code)))
                    }
                    None => Ok(None),
                };
            }
            Over::Failed { reason } => (reason, false),
            Over::Asked => ("was to be restarted".to_owned(), true),
        };
        self.told_failed(&reason);
        let gone = {
            let wound_down = std::pin::pin!(self.wind_down(&reason));
            let gone = std::pin::pin!(self.gone_or_stopped());
            match select(wound_down, gone).await {
                Either::Left(_) => None,
                Either::Right((gone, _)) => gone?,
            }
        };
        let dead = match gone {
            Some(dead) => Some(dead),
            None => self.dead_or_killed().await?,
        };
        if dead.is_none() {
            return Ok(None);
        }
        self.links_closed().await?;
        Ok(Some(Death {
            reason,
            ended: Ended::Badly,
            asked,
        }))
    }

    /// Whether the policy can restart the chassis at all.
    fn may_return(&self) -> bool {
        use ctos_config::ChassisRestart::Never;
        let policy = self
            .board
            .with(self.index, |member| member.policy.restart.when);
        policy.is_some_and(|policy| policy != Never)
    }

    fn told_failed(&self, reason: &str) {
        self.board.event(&BootEvent::ChassisFailed {
            chassis: self.name(),
            reason: reason.to_owned(),
        });
    }

    /// Stops the tasks in order, and tells the process to end.
    async fn wind_down(&self, why: &str) {
        let reason = StopReason::Failed {
            what: format!("chassis `{}` {why}", self.name()),
        };
        let tasks = self.board.with(self.index, |member| member.tasks.clone());
        for task in tasks.unwrap_or_default().iter().rev() {
            self.board.stop_task_of(self.index, task, &reason).await;
        }
        self.board.exit_chassis(self.index, 1).await;
    }

    /// Ends when the process is dead, with how, or when the app is being stopped.
    async fn gone_or_stopped(&self) -> Result<Option<(String, Option<i32>)>, Stopped> {
        loop {
            match self.board.next_event(self.index).await {
                Event::Dead { how, code } => return Ok(Some((how, code))),
                Event::Stop => return Err(Stopped),
                Event::Joined | Event::Lost | Event::TaskFailed { .. } | Event::Restart => {}
            }
        }
    }

    /// Waits for the end of the process, and ends it when that takes too long. `None` when even that
    /// does not help: the app is ended then.
    async fn dead_or_killed(&self) -> Result<Option<(String, Option<i32>)>, Stopped> {
        let cx = &self.board.cx;
        let timeout = cx.app().stop_timeout;
        for kill in [false, true] {
            if kill {
                self.board.event(&BootEvent::Signalled {
                    chassis: self.name(),
                    signal: "SIGKILL".to_owned(),
                });
                self.board.kill_process(self.index);
            }
            if let Ok(gone) = cx.timeout(timeout, self.gone_or_stopped()).await {
                return gone;
            }
        }
        self.give_up("could not be ended".to_owned());
        Ok(None)
    }

    /// Waits until the links of the dead process are closed: what it had sent is then received.
    async fn links_closed(&self) -> Result<(), Stopped> {
        let cx = &self.board.cx;
        let closed = async {
            while cx.chassis().is_linked(self.index) {
                match self.board.next_event(self.index).await {
                    Event::Lost => break,
                    Event::Stop => return Err(Stopped),
                    _ => {}
                }
            }
            Ok(())
        };
        let closed = cx.timeout(LINK_TIMEOUT, closed).await;
        cx.chassis().link_down(self.index);
        closed.unwrap_or(Ok(()))
    }

    /// What the policy says to the death: the number of the next incarnation and the pause before it,
    /// or nothing, and the app ends.
    fn judge(&self, death: &Death) -> Option<(u32, Duration)> {
        let now = self.board.cx.now();
        let verdict = self.board.with(self.index, |member| {
            member.last_end = Some(death.reason.clone());
            let verdict = if death.asked {
                Verdict::Restart {
                    pause: Duration::ZERO,
                }
            } else {
                member.intensity.judge(death.ended, now)
            };
            (verdict, member.incarnation, member.policy.restart.window)
        });
        let (verdict, incarnation, window) = verdict?;
        match verdict {
            Verdict::Restart { pause } => return Some((incarnation.saturating_add(1), pause)),
            Verdict::NotAllowed => {
                let chassis = self.name();
                self.step(ChassisStep::DeadForGood);
                self.gone(format!("{} and may not be started again", death.reason));
                self.board
                    .answer_restarts(self.index, &Err(death.reason.clone()));
                self.board.end(End::ChassisDown { chassis });
            }
            Verdict::TooMany { restarts } => {
                let times = if restarts == 1 { "time" } else { "times" };
                self.give_up(format!(
                    "was restarted {restarts} {times} within {} s and failed again: it {}",
                    window.as_secs_f64(),
                    death.reason
                ));
            }
        }
        None
    }

    /// Nobody need wait for its tasks any more.
    fn gone(&self, why: String) {
        self.board.tell_names(News::Gone(self.index, why));
    }

    fn give_up(&self, reason: String) {
        self.step(ChassisStep::DeadForGood);
        self.gone(reason.clone());
        self.board.answer_restarts(self.index, &Err(reason.clone()));
        self.board.end(End::GivenUp {
            chassis: self.name(),
            reason,
        });
    }

    async fn pause(&self, pause: Duration) -> Result<(), Stopped> {
        let stopped = async {
            loop {
                match self.board.next_event(self.index).await {
                    Event::Stop => return Err(Stopped),
                    // A person need not wait for the pause.
                    Event::Restart => return Ok(()),
                    _ => {}
                }
            }
        };
        let paused = self.board.cx.timeout(pause, stopped).await;
        paused.unwrap_or(Ok(()))
    }
}

impl Death {
    fn of(how: String, code: Option<i32>) -> Self {
        Self {
            reason: how,
            ended: if code == Some(0) {
                Ended::Well
            } else {
                Ended::Badly
            },
            asked: false,
        }
    }
}
