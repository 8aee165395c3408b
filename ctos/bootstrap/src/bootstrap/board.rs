//! What the bootstrap service knows of the app and of each chassis. Its handler writes it; the
//! sequence that boots the app and the supervisor of each chassis read it.

use std::{
    cell::{Cell, RefCell},
    collections::VecDeque,
    rc::Rc,
};

use crate::bootstrap::{
    AppReport, BootEvent, BootState, ChassisState, End, MemberReport, ProcessOrder, Seat,
    states::{BootStep, ChassisStep, Table},
};
use ctos_config::{ChassisConfig, ChassisSupervision, OnTaskFailure, Start};
use ctos_core::{
    context::{Context, TaskRef},
    envelope::Replier,
    handled::Handled,
    phase::Phase,
    supervise::Restarts,
    sync::Signal,
    system::{self, ChassisNews, ChassisWanted, News, ProcessEnded, RestartChassis},
};
use ctos_message::{ChassisNumber, Tid};
use ctos_time::{Instant, seed::mix};

/// An event for the supervisor of a chassis.
pub(super) enum Event {
    /// Its process is connected to all the others.
    Joined,
    /// Nobody is connected to it any more.
    Lost,
    /// Its process is dead.
    Dead(ProcessEnded),
    /// It must go, for a reason that completes "the chassis ...".
    Failed(String),
    /// A person wants it anew.
    Restart,
    /// Somebody looks for a task of it.
    Wanted(ChassisWanted),
    /// The app is being stopped.
    Stop,
}

/// An error unless there are no failures.
pub(super) fn none<T>(failures: Vec<T>) -> Result<(), Vec<T>> {
    match failures.is_empty() {
        true => Ok(()),
        false => Err(failures),
    }
}

/// A queue of news for one reader, who takes them one by one.
struct Inbox<T> {
    waiting: RefCell<VecDeque<T>>,
    told: Signal,
}

impl<T> Default for Inbox<T> {
    fn default() -> Self {
        Self {
            waiting: RefCell::default(),
            told: Signal::new(),
        }
    }
}

impl<T> Inbox<T> {
    fn put(&self, item: T) {
        self.waiting.borrow_mut().push_back(item);
        self.told.raise();
    }

    /// The next one. One future may wait at a time.
    async fn next(&self) -> T {
        loop {
            let item = self.waiting.borrow_mut().pop_front();
            match item {
                Some(item) => return item,
                None => self.told.wait().await,
            }
        }
    }
}

/// A chassis, seen by its supervisor.
pub(super) struct Member {
    pub(super) index: ChassisNumber,
    /// What the boot reports of it.
    pub(super) report: RefCell<MemberReport>,
    pub(super) policy: ChassisSupervision,
    /// How often its process was started again.
    pub(super) intensity: RefCell<Restarts>,
    /// The phase that all its tasks have acknowledged.
    pub(super) reached: Cell<Option<Phase>>,
    /// What kept its tasks from a phase while the app was booted: task and reason.
    pub(super) failures: RefCell<Vec<(String, String)>>,
    /// Whether this incarnation is the first of a chassis that starts on demand.
    pub(super) first: Cell<bool>,
    /// When the incarnation before this one failed, or the first one was wanted.
    pub(super) failed_at: Cell<Option<Instant>>,
    /// It starts on demand, and nobody has asked for it yet.
    pub(super) asleep: Cell<bool>,
    /// Who waits for it to come up again.
    restarts: RefCell<Vec<Replier<RestartChassis>>>,
    events: Inbox<Event>,
    phase_wanted: Signal,
}

impl Member {
    fn new(cx: &Context, index: ChassisNumber, config: &ChassisConfig) -> Self {
        let seed = mix(cx.app().seed, &["restarts of", &config.name]);
        Self {
            index,
            report: RefCell::new(MemberReport {
                name: config.name.clone(),
                state: ChassisState::Starting,
                since: cx.now(),
                incarnation: 1,
                last_end: None,
                tasks: Vec::new(),
            }),
            policy: config.supervision,
            intensity: RefCell::new(Restarts::new(config.supervision.restart, seed)),
            reached: Cell::default(),
            failures: RefCell::default(),
            failed_at: Cell::default(),
            first: Cell::new(false),
            asleep: Cell::new(config.start == Start::OnDemand),
            restarts: RefCell::default(),
            events: Inbox::default(),
            phase_wanted: Signal::new(),
        }
    }

    /// Tells its supervisor.
    pub(super) fn tell(&self, event: Event) {
        self.events.put(event);
    }

    /// The next event for its supervisor.
    pub(super) async fn next_event(&self) -> Event {
        self.events.next().await
    }

    /// The tasks of this incarnation.
    pub(super) fn tasks(&self) -> Vec<TaskRef> {
        self.report.borrow().tasks.clone()
    }

    /// Answers those who wait for it to come up.
    pub(super) fn answer_restarts(&self, answer: Result<(), &str>) {
        for reply in self.restarts.take() {
            // The caller may be gone; nobody else wants the answer.
            let _ = match answer {
                Ok(()) => reply.ok(()),
                Err(reason) => reply.fail(reason),
            };
        }
    }
}

pub(super) struct Board {
    pub(super) cx: Context,
    seat: Seat,
    state: Cell<BootState>,
    /// The phase that every chassis shall reach.
    target: Cell<Option<Phase>>,
    /// The chassis, in declared order.
    pub(super) members: Vec<Rc<Member>>,
    ends: Inbox<End>,
    changed: Signal,
}

impl Board {
    pub(super) fn new(cx: Context, seat: Seat) -> Self {
        let members = (1..).zip(&cx.app().chassis);
        let members = members.map(|(index, config)| Rc::new(Member::new(&cx, index, config)));
        Self {
            members: members.collect(),
            cx,
            seat,
            state: Cell::default(),
            target: Cell::default(),
            ends: Inbox::default(),
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
        let ends = self.ends.waiting.borrow();
        ends.iter().any(|end| matches!(end, End::TaskFailed { .. }))
    }

    pub(super) fn end(&self, end: End) {
        self.ends.put(end);
    }

    /// The next thing that ends the app. One future may wait at a time.
    pub(super) async fn next_end(&self) -> End {
        self.ends.next().await
    }

    pub(super) fn report(&self) -> AppReport {
        let members = self.members.iter();
        AppReport {
            state: self.state.get(),
            now: self.cx.now(),
            chassis: members.map(|one| one.report.borrow().clone()).collect(),
        }
    }

    /// Tells those who look for tasks by name.
    pub(super) fn tell_names(&self, news: News) {
        let chassis = self.cx.chassis();
        chassis.post_system(system::TID_SERVER, ChassisNews { news });
    }

    // -- all chassis --------------------------------------------------------------------------

    fn member(&self, index: ChassisNumber) -> Option<&Rc<Member>> {
        // They are numbered from 1.
        self.members.get(usize::from(index).checked_sub(1)?)
    }

    /// All tasks, in the order in which they were created.
    pub(super) fn tasks(&self) -> Vec<TaskRef> {
        self.members.iter().flat_map(|one| one.tasks()).collect()
    }

    /// The first process of every chassis is connected.
    pub(super) fn all_linked(&self) {
        self.step(BootStep::Linked);
        for member in &self.members {
            member.tell(Event::Joined);
            if !self.cx.chassis().is_linked(member.index) {
                member.tell(Event::Lost);
            }
        }
    }

    /// Every chassis shall reach `phase`.
    pub(super) fn aim_at(&self, phase: Phase) {
        self.target.set(Some(phase));
        for member in &self.members {
            member.phase_wanted.raise();
        }
    }

    /// Ends when every chassis has reached `phase`, or when tasks have not: these, with the reasons.
    pub(super) async fn all_reach(&self, phase: Phase) -> Result<(), Vec<(String, String)>> {
        let settled = |member: &Rc<Member>| {
            let reached = member.reached.get() >= Some(phase) || member.asleep.get();
            reached || !member.failures.borrow().is_empty()
        };
        while !self.members.iter().all(settled) {
            self.changed.wait().await;
        }
        let failures = self.members.iter().map(|one| one.failures.borrow().clone());
        let failures = failures.collect::<Vec<_>>().concat();
        none(failures)
    }

    /// The sequence that boots the app shall look again.
    pub(super) fn changed(&self) {
        self.changed.raise();
    }

    /// A task that was at `old` is at another place now.
    pub(super) fn moved(&self, task: TaskRef, old: Tid) {
        if let Some(member) = self.member(old.chassis()) {
            let tasks = &mut member.report.borrow_mut().tasks;
            tasks.retain(|one| one.tid() != old);
        }
        if let Some(member) = self.member(task.tid().chassis()) {
            member.report.borrow_mut().tasks.push(task);
        }
    }

    // -- one chassis --------------------------------------------------------------------------

    /// Tells the supervisor of chassis `index`, if the process that it is about is not an earlier one.
    pub(super) fn tell_incarnation(&self, index: ChassisNumber, incarnation: u32, event: Event) {
        let member = self.member(index);
        if let Some(member) = member.filter(|one| one.report.borrow().incarnation == incarnation) {
            member.tell(event);
        }
    }

    /// Ends when a chassis shall reach `phase`.
    pub(super) async fn wanted(&self, member: &Member, phase: Phase) {
        while self.target.get() < Some(phase) {
            member.phase_wanted.wait().await;
        }
    }

    /// Steps to the next state of a chassis, if there is one.
    pub(super) fn step_chassis(&self, member: &Member, step: ChassisStep) {
        let mut report = member.report.borrow_mut();
        if let Some(next) = report.state.next(step) {
            report.state = next;
            report.since = self.cx.now();
        }
    }

    /// The chassis called `name` is not connected any more.
    pub(super) fn lost(&self, name: &str) {
        let index = self.cx.chassis().number_of(name);
        if let Some(member) = index.and_then(|index| self.member(index)) {
            member.tell(Event::Lost);
        }
    }

    /// A task of chassis `index` failed for good. That is a failure of the app or, if the
    /// configuration says so and the app has been up, of that chassis alone.
    pub(super) fn task_failed(&self, index: ChassisNumber, task: String, reason: String) {
        let contains = |one: &&Rc<Member>| {
            self.is_up() && one.policy.on_task_failure == OnTaskFailure::RestartChassis
        };
        match self.member(index).filter(contains) {
            Some(member) => {
                let reason = format!("has a task that failed: `{task}`: {reason}");
                member.tell(Event::Failed(reason));
            }
            None => self.end(End::TaskFailed { task, reason }),
        }
    }

    /// A person wants chassis `index` anew.
    pub(super) fn restart(&self, index: ChassisNumber, reply: Replier<RestartChassis>) -> Handled {
        if !self.is_up() {
            let state = self.state.get();
            return reply.fail(format!("the app is not up but in state `{state}`"));
        }
        let Some(member) = self.member(index) else {
            return reply.fail(format!("there is no chassis number {index}"));
        };
        member.restarts.borrow_mut().push(reply);
        member.tell(Event::Restart);
        Ok(())
    }

    /// Somebody looks for a task of a chassis.
    pub(super) fn is_wanted(&self, wanted: ChassisWanted) {
        if let Some(member) = self.member(wanted.chassis) {
            member.tell(Event::Wanted(wanted));
        }
    }

    /// Orders something for the process of a chassis.
    pub(super) fn order(&self, order: ProcessOrder) {
        // Who carries it out lives until the service has ended.
        let _ = self.seat.orders.send(order);
    }
}
