//! The supervisor of one chassis. It brings the tasks through the phases and notices a failure. Then it
//! makes sure that the process is dead, and starts the next one as the policy allows. Steps through
//! [`ChassisState`](super::ChassisState); what may follow what stands there.

use std::{convert::Infallible, future::pending, rc::Rc, time::Duration};

use futures_util::future::{Either, join_all, select};

use crate::bootstrap::{
    BootEvent, End, ProcessOrder,
    board::{Board, Event, Member, none},
    explain::explained,
    states::{ChassisState, ChassisStep},
};
use ctos_config::ChassisRestart;
use ctos_core::{
    context::{Context, TaskRef},
    phase::{Phase, StopReason},
    supervise::{Ending, Verdict},
    system::{self, AnnounceUp, CreateTasks, EnterPhase, FirstSlots, News, ProcessEnded},
};
use ctos_message::fault::Fault;

/// How long the links of a dead process may take to close.
const LINK_TIMEOUT: Duration = Duration::from_secs(1);

/// There is nothing more to supervise: the app ends, or is being stopped.
pub(super) struct Done;

/// How a dead process ended, and whether a person wanted it to.
struct Death {
    /// Completes "the chassis ...".
    reason: String,
    ended: Ending,
    asked: bool,
}

/// Supervises a chassis.
pub(super) struct Supervisor {
    pub(super) board: Rc<Board>,
    pub(super) member: Rc<Member>,
}

impl Supervisor {
    /// Supervises it until the app is stopped. That it ends is the end of the app, which the sequence sees to.
    pub(super) async fn run(&self) -> Result<Infallible, Done> {
        if self.member.asleep.get() {
            self.sleep().await?;
        }
        loop {
            let over = self.live().await?;
            let failed_at = self.board.cx.now();
            self.step(ChassisStep::Fails);
            if matches!(over, Event::Restart) || self.may_return() {
                self.board.tell_names(News::Away(self.member.index));
            }
            self.member.reached.set(None);
            self.member.first.set(false);
            self.member.failed_at.set(Some(failed_at));
            let death = self.bury(over).await?;
            let pause = self.judge(death)?;
            self.step(ChassisStep::DeadMayRestart);
            self.board.event(&BootEvent::Restarting {
                chassis: self.name(),
                incarnation: self.member.report.borrow().incarnation + 1,
                pause,
            });
            // A person need not wait for the pause.
            let asked = self.until(|event| matches!(event, Event::Restart).then_some(()));
            let paused = self.board.cx.timeout(pause, asked).await;
            paused.unwrap_or(Ok(()))?;
            self.start();
        }
    }

    /// Has the next process started.
    fn start(&self) {
        self.step(ChassisStep::Paused);
        let mut report = self.member.report.borrow_mut();
        report.incarnation += 1;
        report.tasks.clear();
        let order = ProcessOrder::Start(self.member.index, report.incarnation);
        self.board.order(order);
    }

    /// Until somebody looks for one of its tasks there is no process; then one starts, as after a restart.
    async fn sleep(&self) -> Result<(), Done> {
        self.board.tell_names(News::Away(self.member.index));
        self.member.report.borrow_mut().state = ChassisState::Waiting;
        let wanted = self.until(|event| match event {
            Event::Wanted(wanted) => Some(Some(wanted)),
            Event::Restart => Some(None),
            _ => None,
        });
        let (task, by) = match wanted.await? {
            Some(wanted) => (Some(wanted.task), wanted.by),
            None => (None, None),
        };
        self.board.event(&BootEvent::Wanted {
            chassis: self.name(),
            task,
            by,
        });
        self.member.asleep.set(false);
        self.member.first.set(true);
        self.member.failed_at.set(Some(self.board.cx.now()));
        self.start();
        Ok(())
    }

    fn name(&self) -> String {
        self.member.report.borrow().name.clone()
    }

    fn step(&self, step: ChassisStep) {
        self.board.step_chassis(&self.member, step);
    }

    /// Waits for an event that `means` something here. [`Done`] when the app is being stopped.
    async fn until<T>(&self, means: impl Fn(Event) -> Option<T>) -> Result<T, Done> {
        loop {
            let event = self.member.next_event().await;
            if matches!(event, Event::Stop) {
                return Err(Done);
            }
            if let Some(meant) = means(event) {
                return Ok(meant);
            }
        }
    }

    /// One incarnation, from the start of its process until it is over: what ends it.
    async fn live(&self) -> Result<Event, Done> {
        let timeout = self.board.cx.app().phase_timeout;
        let joined = self.until(|event| match event {
            Event::Joined => Some(Ok(())),
            Event::Dead(_) => Some(Err(event)),
            // Of the process before this one, or of a person who has what he wants.
            _ => None,
        });
        match self.board.cx.timeout(timeout, joined).await {
            Ok(joined) => {
                if let Err(over) = joined? {
                    return Ok(over);
                }
            }
            Err(elapsed) => return Ok(Event::Failed(format!("did not connect: {elapsed}"))),
        }
        self.step(ChassisStep::Joined);
        let up = std::pin::pin!(self.up());
        let trouble = std::pin::pin!(self.until(|event| match event {
            Event::Joined | Event::Wanted(_) | Event::Stop => None,
            trouble => Some(trouble),
        }));
        match select(up, trouble).await {
            Either::Left((reason, _)) => Ok(Event::Failed(reason)),
            Either::Right((trouble, _)) => trouble,
        }
    }

    /// Brings the tasks through the phases that the app has reached, and on with it. Ends, with the
    /// reason, only when that fails.
    async fn up(&self) -> String {
        for phase in Phase::ALL {
            self.board.wanted(&self.member, phase).await;
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
            self.member.reached.set(Some(phase));
            self.board.changed();
        }
        self.step(ChassisStep::Passed);
        self.welcome().await
    }

    /// The tasks have passed all phases: waiting callers are told.
    async fn welcome(&self) -> String {
        let board = &self.board;
        if let Some(failed_at) = self.member.failed_at.get() {
            let chassis = self.name();
            // Before anybody is told and may look for its tasks.
            board.tell_names(News::Back(self.member.index));
            for other in board.cx.chassis().others().chain([0]) {
                let is_there = other == 0 || board.cx.chassis().is_linked(other);
                if other != self.member.index && is_there {
                    let (agent, chassis) = (system::agent_tid(other), chassis.clone());
                    let announce = AnnounceUp { chassis };
                    board.cx.chassis().post_system(agent, announce);
                }
            }
            let tasks = self.member.tasks().len();
            let took = board.cx.now().since(failed_at);
            board.event(&match self.member.first.get() {
                true => BootEvent::Awake {
                    chassis,
                    tasks,
                    took,
                },
                false => BootEvent::Restarted {
                    chassis,
                    tasks,
                    took,
                },
            });
            self.member.answer_restarts(Ok(()));
        }
        pending().await
    }

    /// Tasks did not pass `phase`. In the first boot of the app that undoes the boot; later it is a
    /// failure of the chassis.
    async fn not_passed(&self, phase: Phase, failures: Vec<(String, String)>) -> String {
        if !self.board.is_up() {
            *self.member.failures.borrow_mut() = failures;
            self.board.changed();
            return pending().await;
        }
        let failures = failures.iter();
        let failures = failures.map(|(task, reason)| format!("`{task}`: {reason}"));
        let failures = failures.collect::<Vec<_>>().join("; ");
        format!("did not pass startup phase `{phase}`: {failures}")
    }

    /// Lets the agent create the tasks.
    async fn create(&self) -> Result<(), Vec<(String, String)>> {
        let cx = &self.board.cx;
        let timeout = cx.app().phase_timeout;
        let name = format!("agent of {}", self.name());
        let agent = TaskRef::new(name.as_str(), system::agent_tid(self.member.index));
        let asked = FirstSlots {
            chassis: self.member.index,
        };
        let first_slots = match cx.call(&Context::server(), asked).deadline(timeout).await {
            Ok(first_slots) => first_slots,
            Err(error) => return Err(vec![(name, error.to_string())]),
        };
        let call = cx.call(&agent, CreateTasks { first_slots });
        match call.deadline(timeout).await {
            Ok(created) => {
                self.member.report.borrow_mut().tasks = created.tasks;
                none(created.failed)
            }
            // The process is gone; another event says so.
            Err(error) if matches!(error.fault, Fault::PeerDown { .. }) => pending().await,
            Err(error) => Err(vec![(name, error.to_string())]),
        }
    }

    /// Tells every task to enter `phase` and waits for all of them: the failures.
    async fn enter(&self, phase: Phase) -> Vec<(String, String)> {
        let cx = &self.board.cx;
        let timeout = cx.app().phase_timeout;
        let tasks = self.member.tasks();
        let calls = tasks.iter().map(|task| {
            let call = cx.call(task, EnterPhase { phase }).deadline(timeout);
            async move {
                match call.await {
                    Ok(()) => None,
                    // The process is gone; another event says so.
                    Err(error) if matches!(error.fault, Fault::PeerDown { .. }) => pending().await,
                    Err(error) => {
                        let asked = format!("acknowledge phase {phase}");
                        let why = explained(cx, task, &asked, error).await;
                        Some((task.name().to_owned(), why))
                    }
                }
            }
        });
        join_all(calls).await.into_iter().flatten().collect()
    }

    /// Makes sure that the process is dead.
    async fn bury(&self, over: Event) -> Result<Death, Done> {
        let (reason, asked) = match over {
            Event::Dead(ending) => {
                self.told_failed(&ending.how);
                self.links_closed().await?;
                return Ok(Death::of(ending));
            }
            Event::Lost if !self.may_return() => {
                // Nobody waits for its end here: the app ends, and that waits for all processes.
                let chassis = self.name();
                self.board.end(End::ChassisDown { chassis });
                return Err(Done);
            }
            Event::Lost => {
                // Having lost the boot it stops its tasks by itself.
                let ending = self.dead_or_killed().await?;
                self.told_failed(&ending.how);
                return Ok(Death::of(ending));
            }
            Event::Failed(reason) => (reason, false),
            // The others end nothing.
            _ => ("was to be restarted".to_owned(), true),
        };
        self.told_failed(&reason);
        let wound_down = Box::pin(self.wind_down(&reason));
        let dead = std::pin::pin!(self.dead());
        match select(wound_down, dead).await {
            Either::Left(_) => self.dead_or_killed().await?,
            Either::Right((dead, _)) => dead?,
        };
        self.links_closed().await?;
        Ok(Death {
            reason,
            ended: Ending::Failure,
            asked,
        })
    }

    /// Whether the policy can restart the chassis at all.
    fn may_return(&self) -> bool {
        self.member.policy.restart.when != ChassisRestart::Never
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
        for task in self.member.tasks().iter().rev() {
            self.board
                .stop_task_of(self.member.index, task, &reason)
                .await;
        }
        self.board.exit_chassis(self.member.index, 1).await;
    }

    /// Ends when the process is dead, with how.
    async fn dead(&self) -> Result<ProcessEnded, Done> {
        self.until(|event| match event {
            Event::Dead(ending) => Some(ending),
            _ => None,
        })
        .await
    }

    /// Waits for the end of the process, and ends it when that takes too long. When even that does not
    /// help, the app is ended.
    async fn dead_or_killed(&self) -> Result<ProcessEnded, Done> {
        let cx = &self.board.cx;
        let timeout = cx.app().stop_timeout;
        if let Ok(dead) = cx.timeout(timeout, self.dead()).await {
            return dead;
        }
        self.board.event(&BootEvent::Signalled {
            chassis: self.name(),
            signal: "SIGKILL".to_owned(),
        });
        self.board.order(ProcessOrder::Kill(self.member.index));
        let killed = cx.timeout(timeout, self.dead()).await;
        killed.unwrap_or_else(|_| Err(self.give_up("could not be ended".to_owned())))
    }

    /// Waits until the links of the dead process are closed: what it had sent is then received.
    async fn links_closed(&self) -> Result<(), Done> {
        let cx = &self.board.cx;
        let mut closed = Ok(());
        if cx.chassis().is_linked(self.member.index) {
            let lost = self.until(|event| matches!(event, Event::Lost).then_some(()));
            closed = cx.timeout(LINK_TIMEOUT, lost).await.unwrap_or(Ok(()));
        }
        cx.chassis().link_down(self.member.index);
        closed
    }

    /// What the policy says to the death: the pause before the next incarnation. Where there is none the app ends.
    fn judge(&self, death: Death) -> Result<Duration, Done> {
        self.member.report.borrow_mut().last_end = Some(death.reason.clone());
        if death.asked {
            return Ok(Duration::ZERO);
        }
        let now = self.board.cx.now();
        let verdict = self.member.intensity.borrow_mut().judge(death.ended, now);
        match verdict {
            Verdict::RestartAfter(pause) => Ok(pause),
            Verdict::StayDown => {
                let chassis = self.name();
                let why = format!("{} and may not be started again", death.reason);
                Err(self.gone(why, End::ChassisDown { chassis }))
            }
            Verdict::GiveUp { restarts } => {
                let times = if restarts == 1 { "time" } else { "times" };
                Err(self.give_up(format!(
                    "was restarted {restarts} {times} within {} s and failed again: it {}",
                    self.member.policy.restart.window.as_secs_f64(),
                    death.reason
                )))
            }
        }
    }

    fn give_up(&self, reason: String) -> Done {
        let end = End::GivenUp {
            chassis: self.name(),
            reason: reason.clone(),
        };
        self.gone(reason, end)
    }

    /// It is not started again, for a reason that completes "the chassis ...": nobody need wait for its tasks
    /// any more, and the app ends.
    fn gone(&self, why: String, end: End) -> Done {
        self.step(ChassisStep::DeadForGood);
        self.member.answer_restarts(Err(&why));
        self.board.tell_names(News::Gone(self.member.index, why));
        self.board.end(end);
        Done
    }
}

impl Death {
    fn of(ending: ProcessEnded) -> Self {
        Self {
            ended: match ending.code {
                Some(0) => Ending::Order,
                _ => Ending::Failure,
            },
            reason: ending.how,
            asked: false,
        }
    }
}
