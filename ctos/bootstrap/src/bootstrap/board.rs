//! What the bootstrap service knows of the app and of each chassis: written by its handler, read by
//! the sequence that boots the app and by the supervisor of each chassis.

use std::{
    cell::{Cell, RefCell},
    collections::{BTreeMap, VecDeque},
};

use crate::bootstrap::{AppReport, BootState, ChassisState, MemberReport};
use crate::bootstrap::{
    BootEvent, End, ProcessOrder, Seat,
    intensity::Intensity,
    states::{BootStep, ChassisStep, Table},
};
use ctos_config::{ChassisSupervision, OnTaskFailure};
use ctos_core::{
    context::Context,
    envelope::Replier,
    handled::Handled,
    phase::Phase,
    sync::Signal,
    system::{self, ChassisNews, News, RestartChassis, TaskName},
};
use ctos_message::Tid;
use ctos_time::Instant;

/// What a supervisor is told about its chassis.
#[derive(Debug)]
pub(super) enum Event {
    /// Its process is connected to all the others.
    Joined,
    /// Nobody is connected to it any more.
    Lost,
    /// Its process is dead.
    Dead(Ending),
    /// A task of it failed for good.
    TaskFailed { task: String, reason: String },
    /// A person wants it anew.
    Restart,
    /// The app is being stopped.
    Stop,
}

/// How a process ended.
#[derive(Debug)]
pub(super) struct Ending {
    /// Completes "the chassis ...".
    pub(super) how: String,
    /// Its exit code, if it ended by itself.
    pub(super) code: Option<i32>,
}

/// A chassis, seen by its supervisor.
pub(super) struct Member {
    /// What is told of it.
    pub(super) report: MemberReport,
    pub(super) policy: ChassisSupervision,
    pub(super) intensity: Intensity,
    /// The phase that all its tasks have acknowledged.
    pub(super) reached: Option<Phase>,
    /// What kept its tasks from a phase while the app was booted: task and reason.
    pub(super) failures: Vec<(String, String)>,
    /// When the incarnation before this one failed.
    pub(super) failed_at: Option<Instant>,
    /// Who waits for it to come up again.
    restarts: Vec<Replier<RestartChassis>>,
    events: VecDeque<Event>,
    told: Signal,
    phase_wanted: Signal,
}

pub(super) struct Board {
    pub(super) cx: Context,
    seat: Seat,
    state: Cell<BootState>,
    /// The phase that every chassis shall reach.
    target: Cell<Option<Phase>>,
    members: RefCell<BTreeMap<u8, Member>>,
    ends: RefCell<VecDeque<End>>,
    ended: Signal,
    changed: Signal,
}

impl Board {
    pub(super) fn new(cx: Context, seat: Seat) -> Self {
        let members = cx
            .app()
            .chassis
            .iter()
            .zip(1..)
            .map(|(config, index)| {
                let report = MemberReport {
                    name: config.name.clone(),
                    state: ChassisState::Starting,
                    since: cx.now(),
                    incarnation: 1,
                    last_end: None,
                    tasks: Vec::new(),
                };
                let member = Member {
                    report,
                    policy: config.supervision,
                    intensity: Intensity::new(
                        config.supervision,
                        cx.rng(&format!("restarts of {}", config.name)),
                    ),
                    reached: None,
                    failures: Vec::new(),
                    failed_at: None,
                    restarts: Vec::new(),
                    events: VecDeque::new(),
                    told: Signal::new(),
                    phase_wanted: Signal::new(),
                };
                (index, member)
            })
            .collect();
        Self {
            cx,
            seat,
            state: Cell::default(),
            target: Cell::default(),
            members: RefCell::new(members),
            ends: RefCell::default(),
            ended: Signal::new(),
            changed: Signal::new(),
        }
    }

    // -- the app ------------------------------------------------------------------------------

    pub(super) fn event(&self, event: &BootEvent) {
        (self.seat.observer)(event);
    }

    /// Leaves the reason of the end for the process that boots.
    pub(super) fn leave(&self, end: End) {
        *ctos_time::lock::lock(&self.seat.end) = Some(end);
    }

    /// Steps to the next state of the boot, if there is one.
    pub(super) fn step(&self, step: BootStep) {
        if let Some(next) = self.state.get().next(step) {
            self.state.set(next);
        }
    }

    pub(super) fn is_stopping(&self) -> bool {
        matches!(self.state.get(), BootState::Stopping | BootState::Ended)
    }

    /// Whether the app has been up, so that a failure is not one of its boot.
    pub(super) fn is_up(&self) -> bool {
        self.state.get() == BootState::Up
    }

    /// Whether a task's failure ends the app, which has not been acted on yet.
    pub(super) fn has_failed(&self) -> bool {
        let ends = self.ends.borrow();
        ends.iter().any(|end| matches!(end, End::TaskFailed { .. }))
    }

    pub(super) fn end(&self, end: End) {
        self.ends.borrow_mut().push_back(end);
        self.ended.raise();
    }

    /// The next thing that ends the app. One future may wait at a time.
    pub(super) async fn next_end(&self) -> End {
        loop {
            let end = self.ends.borrow_mut().pop_front();
            match end {
                Some(end) => return end,
                None => self.ended.wait().await,
            }
        }
    }

    pub(super) fn report(&self) -> AppReport {
        let members = self.members.borrow();
        let chassis = members.values().map(|member| member.report.clone());
        AppReport {
            state: self.state.get(),
            now: self.cx.now(),
            chassis: chassis.collect(),
        }
    }

    /// Tells those who look for tasks by name.
    pub(super) fn tell_names(&self, news: News) {
        let chassis = self.cx.chassis();
        chassis.post_system(system::TID_SERVER, ChassisNews { news });
    }

    // -- all chassis --------------------------------------------------------------------------

    /// The numbers of the chassis, in declared order.
    pub(super) fn indices(&self) -> Vec<u8> {
        self.members.borrow().keys().copied().collect()
    }

    /// Reads or changes a chassis.
    pub(super) fn with<T>(&self, index: u8, change: impl FnOnce(&mut Member) -> T) -> Option<T> {
        self.members.borrow_mut().get_mut(&index).map(change)
    }

    /// All tasks, in the order in which they were created.
    pub(super) fn tasks(&self) -> Vec<TaskName> {
        let members = self.members.borrow();
        let tasks = members.values().flat_map(|member| &member.report.tasks);
        tasks.cloned().collect()
    }

    /// The first process of every chassis is connected.
    pub(super) fn all_linked(&self) {
        self.step(BootStep::Linked);
        for index in self.indices() {
            self.tell(index, Event::Joined);
            if !self.cx.chassis().is_linked(index) {
                self.tell(index, Event::Lost);
            }
        }
    }

    /// Every chassis shall reach `phase`.
    pub(super) fn aim_at(&self, phase: Phase) {
        self.target.set(Some(phase));
        for member in self.members.borrow().values() {
            member.phase_wanted.raise();
        }
    }

    /// Ends when every chassis has reached `phase`, or when tasks have not: these, with the reasons.
    pub(super) async fn all_reach(&self, phase: Phase) -> Result<(), Vec<(String, String)>> {
        loop {
            {
                let members = self.members.borrow();
                let settled = |member: &Member| {
                    !member.failures.is_empty() || member.reached.is_some_and(|at| at >= phase)
                };
                if members.values().all(settled) {
                    let failures = members.values().flat_map(|member| &member.failures);
                    let failures: Vec<_> = failures.cloned().collect();
                    return if failures.is_empty() {
                        Ok(())
                    } else {
                        Err(failures)
                    };
                }
            }
            self.changed.wait().await;
        }
    }

    /// The sequence that boots the app shall look again.
    pub(super) fn changed(&self) {
        self.changed.raise();
    }

    /// A task that was at `old` is at another place now.
    pub(super) fn moved(&self, task: TaskName, old: Tid) {
        self.with(old.chassis(), |member| {
            member.report.tasks.retain(|one| one.tid != old);
        });
        self.with(task.tid.chassis(), |member| member.report.tasks.push(task));
    }

    // -- one chassis --------------------------------------------------------------------------

    /// Tells the supervisor of chassis `index`.
    pub(super) fn tell(&self, index: u8, event: Event) {
        self.with(index, |member| {
            member.events.push_back(event);
            member.told.raise();
        });
    }

    /// As [`Self::tell`], if the process that it is about is not an earlier one.
    pub(super) fn tell_incarnation(&self, index: u8, incarnation: u32, event: Event) {
        let is = self.with(index, |member| member.report.incarnation);
        if is == Some(incarnation) {
            self.tell(index, event);
        }
    }

    /// The next event of chassis `index`. One future may wait at a time.
    pub(super) async fn next_event(&self, index: u8) -> Event {
        loop {
            let Some((event, told)) = self.with(index, |member| {
                (member.events.pop_front(), member.told.clone())
            }) else {
                return Event::Stop;
            };
            match event {
                Some(event) => return event,
                None => told.wait().await,
            }
        }
    }

    /// Ends when chassis `index` shall reach `phase`.
    pub(super) async fn wanted(&self, index: u8, phase: Phase) {
        while self.target.get().is_none_or(|target| target < phase) {
            let Some(wanted) = self.with(index, |member| member.phase_wanted.clone()) else {
                return;
            };
            wanted.wait().await;
        }
    }

    /// Steps to the next state of a chassis, if there is one.
    pub(super) fn step_chassis(&self, index: u8, step: ChassisStep) {
        let now = self.cx.now();
        self.with(index, |member| {
            if let Some(next) = member.report.state.next(step) {
                member.report.state = next;
                member.report.since = now;
            }
        });
    }

    /// The chassis called `name` is not connected any more.
    pub(super) fn lost(&self, name: &str) {
        let chassis = self.cx.chassis();
        let index = chassis
            .others()
            .find(|index| chassis.name_of(*index) == name);
        if let Some(index) = index {
            self.tell(index, Event::Lost);
        }
    }

    /// A task of chassis `index` failed for good: the failure of the app or, if the configuration says
    /// so and the app has been up, of that chassis alone.
    pub(super) fn task_failed(&self, index: u8, task: String, reason: String) {
        let policy = self.with(index, |member| member.policy.on_task_failure);
        let contained = self.is_up() && policy == Some(OnTaskFailure::RestartChassis);
        if contained {
            self.tell(index, Event::TaskFailed { task, reason });
        } else {
            self.end(End::TaskFailed { task, reason });
        }
    }

    /// A person wants chassis `index` anew.
    pub(super) fn restart(&self, index: u8, reply: Replier<RestartChassis>) -> Handled {
        if !self.is_up() {
            let state = self.state.get();
            return reply.fail(format!("the app is not up but in state `{state}`"));
        }
        let mut reply = Some(reply);
        self.with(index, |member| member.restarts.extend(reply.take()));
        match reply {
            Some(reply) => reply.fail(format!("there is no chassis number {index}")),
            None => {
                self.tell(index, Event::Restart);
                Ok(())
            }
        }
    }

    /// Answers those who wait for chassis `index` to come up.
    pub(super) fn answer_restarts(&self, index: u8, answer: &Result<(), String>) {
        let waiting = self.with(index, |member| std::mem::take(&mut member.restarts));
        for reply in waiting.into_iter().flatten() {
            // Whoever asked may have gone; nobody else wants the answer.
            let _ = match answer {
                Ok(()) => reply.ok(()),
                Err(reason) => reply.fail(reason),
            };
        }
    }

    /// Orders something for the process of a chassis.
    pub(super) fn order(&self, order: ProcessOrder) {
        // Who carries it out lives until the service has ended.
        let _ = self.seat.orders.send(order);
    }
}
