//! The task identification service: which task has which symbolic name.
//!
//! One task for the whole app, on the chassis that boots it (the report's figure 4). Chassis remember
//! what they were told until the task ends, moves, or its chassis is gone; they are told of each.
//! A name belongs to one task at a time, and a task id to one name for the whole run.

use std::{
    cell::RefCell,
    collections::{BTreeMap, BTreeSet},
    rc::Rc,
    time::Duration,
};

use futures_util::future::join_all;
use tokio::sync::oneshot;

use crate::{
    context::{Context, TaskRef},
    message::{Command, CommandInfo, Message, Replier, Tid},
    moving::{find_place, place_text, turn_for},
    system::{
        self, AbortMove, AwaitTid, Change, CommitMove, FirstSlots, Monitor, MoveOut, MoveTask,
        MovedTasks, Place, QueryTid, Rebound, RegisterTid, Settle, Settled, TaskChanged, TaskMoved,
        TaskName, WhoWaits,
    },
    task::{EventHandler, Handled},
};

/// What the service takes.
pub(crate) const COMMANDS: [CommandInfo; 11] = [
    RegisterTid::INFO,
    QueryTid::INFO,
    AwaitTid::INFO,
    WhoWaits::INFO,
    Monitor::INFO,
    TaskChanged::INFO,
    FirstSlots::INFO,
    MoveTask::INFO,
    CommitMove::INFO,
    AbortMove::INFO,
    MovedTasks::INFO,
];

/// How long a chassis may take to turn to a task's new place.
const TURN_LIMIT: Duration = Duration::from_secs(180);

/// A task that waits for a name.
struct Waiter {
    name: String,
    reply: Replier<AwaitTid>,
}

/// A move that has begun.
#[derive(Default)]
struct Move {
    /// Set when the name has the new place: ends when every chassis has turned to it.
    turned: Option<oneshot::Receiver<()>>,
}

#[derive(Default)]
struct Names {
    names: BTreeMap<String, Tid>,
    /// Every id that was ever registered, with its name.
    used: BTreeMap<Tid, String>,
    /// The last id of each name that has none now.
    past: BTreeMap<String, Tid>,
    waiting: BTreeMap<String, Vec<Waiter>>,
    monitors: BTreeMap<String, BTreeSet<Tid>>,
    /// Names whose task takes no messages at the moment.
    down: BTreeSet<String>,
    moves: BTreeMap<String, Move>,
    /// Where tasks are that have moved; when their chassis is started again, they begin there.
    homes: BTreeMap<String, Place>,
    /// Places that no task may move to any more.
    forbidden: BTreeSet<Tid>,
    /// Tasks that have moved, with their old id and the chassis that still send by the old place.
    turning: BTreeMap<String, (Tid, BTreeSet<u8>)>,
}

/// The service's state.
#[derive(Default, Clone)]
pub(crate) struct TidServer {
    state: Rc<RefCell<Names>>,
}

impl EventHandler for TidServer {
    async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
        let from = message.from();
        match message.command() {
            RegisterTid::CODE => {
                let (RegisterTid { task }, reply) = message.open::<RegisterTid>()?;
                match self.register(cx, task) {
                    Ok(()) => reply.ok(()),
                    Err(why) => reply.fail(why),
                }
            }
            QueryTid::CODE => {
                let (QueryTid { name }, reply) = message.open::<QueryTid>()?;
                let state = self.state.borrow();
                let found = state.seen_from(from.chassis(), &name);
                reply.ok(found.ok_or_else(|| state.names.keys().cloned().collect()))
            }
            AwaitTid::CODE => {
                let (AwaitTid { name, waiter }, reply) = message.open::<AwaitTid>()?;
                self.state.borrow_mut().wait(from, name, waiter, reply)
            }
            WhoWaits::CODE => {
                let (WhoWaits { name }, reply) = message.open::<WhoWaits>()?;
                reply.ok(self.state.borrow_mut().who_waits(&name))
            }
            Monitor::CODE => {
                let (Monitor { name }, reply) = message.open::<Monitor>()?;
                let mut state = self.state.borrow_mut();
                let up = state.names.contains_key(&name) && !state.down.contains(&name);
                state.monitors.entry(name).or_default().insert(from);
                reply.ok(up)
            }
            TaskChanged::CODE => {
                let (TaskChanged { task, change }, reply) = message.open::<TaskChanged>()?;
                self.changed(cx, task, change);
                reply.ok(())
            }
            FirstSlots::CODE => {
                let (FirstSlots { chassis }, reply) = message.open::<FirstSlots>()?;
                reply.ok(self.state.borrow().first_slots(chassis))
            }
            MoveTask::CODE => {
                let (request, reply) = message.open::<MoveTask>()?;
                let (service, here) = (self.clone(), cx.clone());
                cx.spawn(async move {
                    // A reply cannot fail.
                    let _ = match service.move_task(&here, request).await {
                        Ok(place) => reply.ok(place),
                        Err(why) => reply.fail(why),
                    };
                });
                Ok(())
            }
            CommitMove::CODE => {
                let (commit, reply) = message.open::<CommitMove>()?;
                match self.commit(cx, commit) {
                    Ok(()) => reply.ok(()),
                    Err(why) => reply.fail(why),
                }
            }
            AbortMove::CODE => {
                let (AbortMove { new }, reply) = message.open::<AbortMove>()?;
                let mut state = self.state.borrow_mut();
                let committed = state.used.contains_key(&new);
                if !committed {
                    state.forbidden.insert(new);
                }
                reply.ok(committed)
            }
            MovedTasks::CODE => {
                let (MovedTasks {}, reply) = message.open::<MovedTasks>()?;
                let state = self.state.borrow();
                let homes = state.homes.iter();
                reply.ok(homes.map(|(name, place)| (name.clone(), *place)).collect())
            }
            _ => cx.default_processing(message),
        }
    }

    async fn chassis_down(&mut self, cx: &Context, chassis: &str) -> Handled {
        let here = cx.chassis();
        let gone: Vec<TaskName> = {
            let state = self.state.borrow();
            let all = state.names.iter();
            all.filter(|(_, tid)| here.name_of(tid.chassis()) == chassis)
                .map(|(name, tid)| TaskName {
                    name: name.clone(),
                    tid: *tid,
                })
                .collect()
        };
        for task in gone {
            let reason = format!("its chassis `{chassis}` is gone");
            self.state.borrow_mut().free(&task);
            self.notify(cx, &task, &Change::Ended { reason });
        }
        Ok(())
    }
}

impl Names {
    /// The id under which `chassis` is to send to a task: the old one until it has turned to the new
    /// place, so that what it sends takes one way.
    fn seen_from(&self, chassis: u8, name: &str) -> Option<Tid> {
        match self.turning.get(name) {
            Some((old, slow)) if slow.contains(&chassis) => Some(*old),
            _ => self.names.get(name).copied(),
        }
    }

    /// The name has no task any more.
    fn free(&mut self, task: &TaskName) -> bool {
        if self.names.get(&task.name) != Some(&task.tid) {
            return false;
        }
        self.names.remove(&task.name);
        self.past.insert(task.name.clone(), task.tid);
        true
    }

    fn first_slots(&self, chassis: u8) -> Vec<u16> {
        let mut first = Vec::new();
        for tid in self.used.keys().filter(|tid| tid.chassis() == chassis) {
            let processor = usize::from(tid.processor());
            if first.len() <= processor {
                first.resize(processor + 1, 0);
            }
            if let Some(slot) = first.get_mut(processor) {
                *slot = tid.slot().saturating_add(1).max(*slot);
            }
        }
        first
    }

    // -- waiting for names ------------------------------------------------------------------

    fn wait(
        &mut self,
        from: Tid,
        name: String,
        waiter: String,
        reply: Replier<AwaitTid>,
    ) -> Handled {
        if let Some(tid) = self.seen_from(from.chassis(), &name) {
            return reply.ok(Ok(tid));
        }
        self.forget_waiters();
        if let Some(circle) = self.circle(&waiter, &name) {
            return reply.ok(Err(circle));
        }
        let waiter = Waiter {
            name: waiter,
            reply,
        };
        self.waiting.entry(name).or_default().push(waiter);
        Ok(())
    }

    /// Drops those who gave up.
    fn forget_waiters(&mut self) {
        for waiters in self.waiting.values_mut() {
            waiters.retain(|waiter| !waiter.reply.is_abandoned());
        }
        self.waiting.retain(|_, waiters| !waiters.is_empty());
    }

    /// The task that would start the task `name`: children are named after their parent.
    fn starter<'n>(&self, name: &'n str) -> Option<&'n str> {
        let mut rest = name;
        while let Some((parent, _)) = rest.rsplit_once('.') {
            if self.names.contains_key(parent) {
                return Some(parent);
            }
            rest = parent;
        }
        None
    }

    /// Whether `waiter`, waiting for `name`, would close a circle: in words.
    fn circle(&self, waiter: &str, name: &str) -> Option<String> {
        let mut seen = BTreeSet::new();
        let mut ways = vec![(name.to_owned(), format!("`{waiter}` waits for `{name}`"))];
        while let Some((wanted, so_far)) = ways.pop() {
            let Some(starter) = self.starter(&wanted) else {
                continue;
            };
            let so_far = format!("{so_far}, which `{starter}` would start");
            if starter == waiter {
                return Some(so_far);
            }
            if !seen.insert(starter.to_owned()) {
                continue;
            }
            for (next, waiters) in &self.waiting {
                if waiters.iter().any(|other| other.name == starter) {
                    let way = format!("{so_far}, but `{starter}` waits for `{next}`");
                    ways.push((next.clone(), way));
                }
            }
        }
        None
    }

    fn who_waits(&mut self, name: &str) -> String {
        self.forget_waiters();
        let mut text = match (self.past.get(name), self.starter(name)) {
            (Some(_), _) => "it was there and has ended".to_owned(),
            (None, Some(starter)) => format!("`{starter}`, which would start it, has not"),
            (None, None) => "nobody ever had this name".to_owned(),
        };
        if let Some(starter) = self.starter(name) {
            for (wanted, waiters) in &self.waiting {
                if waiters.iter().any(|waiter| waiter.name == starter) {
                    text.push_str(&format!("; `{starter}` waits for `{wanted}`"));
                }
            }
        }
        let others = self.waiting.get(name).into_iter().flatten();
        let others: Vec<String> = others.map(|waiter| format!("`{}`", waiter.name)).collect();
        if !others.is_empty() {
            text.push_str(&format!("; {} waits for it too", others.join(", ")));
        }
        text
    }
}

impl TidServer {
    fn register(&self, cx: &Context, task: TaskName) -> Result<(), String> {
        let mut state = self.state.borrow_mut();
        let place = |tid: Tid| {
            let chassis = cx.chassis().name_of(tid.chassis());
            format!("task {tid} on chassis `{chassis}`")
        };
        match state.names.get(&task.name) {
            Some(tid) if *tid == task.tid => return Ok(()),
            Some(tid) => {
                return Err(format!(
                    "the name `{}` belongs to {} already, so {} cannot have it",
                    task.name,
                    place(*tid),
                    place(task.tid)
                ));
            }
            None => {}
        }
        if let Some(other) = state.used.get(&task.tid) {
            return Err(format!(
                "the id {} was that of `{other}`; no other task of this run can have it",
                task.tid
            ));
        }
        state.used.insert(task.tid, task.name.clone());
        state.names.insert(task.name.clone(), task.tid);
        let before = state.past.remove(&task.name);
        let waiters = state.waiting.remove(&task.name).unwrap_or_default();
        drop(state);
        if let Some(old) = before {
            broadcast(cx, &task.name, old, Some(task.tid));
        }
        for waiter in waiters {
            // A reply cannot fail.
            let _ = waiter.reply.ok(Ok(task.tid));
        }
        self.notify(cx, &task, &Change::Up);
        Ok(())
    }

    fn changed(&self, cx: &Context, task: TaskName, change: Change) {
        if let Change::Ended { .. } = change {
            if !self.state.borrow_mut().free(&task) {
                return;
            }
            broadcast(cx, &task.name, task.tid, None);
        }
        self.notify(cx, &task, &change);
    }

    /// Tells those who monitor a task, if the change is one.
    fn notify(&self, cx: &Context, task: &TaskName, change: &Change) {
        let mut state = self.state.borrow_mut();
        let news = match change {
            Change::Up => state.down.remove(&task.name),
            Change::Down { .. } => state.down.insert(task.name.clone()),
            // Also when it was being restarted: it will not come up by itself.
            Change::Ended { .. } => {
                state.down.insert(task.name.clone());
                true
            }
        };
        if !news {
            return;
        }
        for watcher in state.monitors.get(&task.name).into_iter().flatten() {
            let changed = TaskChanged {
                task: task.clone(),
                change: change.clone(),
            };
            cx.chassis().post_system(*watcher, changed);
        }
    }

    // -- moving -----------------------------------------------------------------------------

    async fn move_task(&self, cx: &Context, request: MoveTask) -> Result<String, String> {
        let MoveTask { task, to } = request;
        let place = find_place(cx.chassis(), &to).map_err(|wrong| wrong.to_string())?;
        let old = {
            let mut state = self.state.borrow_mut();
            let Some(old) = state.names.get(&task).copied() else {
                let names: Vec<&str> = state.names.keys().map(String::as_str).collect();
                return Err(format!(
                    "no task is called `{task}`; there are: {}",
                    names.join(", ")
                ));
            };
            if (old.chassis(), old.processor()) == (place.chassis, place.processor) {
                return Ok(place_text(cx.chassis(), place));
            }
            if state.moves.contains_key(&task) {
                return Err(format!("`{task}` is being moved already"));
            }
            if !cx.chassis().is_linked(place.chassis) {
                let chassis = cx.chassis().name_of(place.chassis);
                return Err(format!("chassis `{chassis}` is gone"));
            }
            state.moves.insert(task.clone(), Move::default());
            old
        };
        let moved = self.carry_out(cx, &task, old, place).await;
        self.state.borrow_mut().moves.remove(&task);
        moved.map(|()| place_text(cx.chassis(), place))
    }

    async fn carry_out(&self, cx: &Context, name: &str, old: Tid, to: Place) -> Result<(), String> {
        let limit = cx.app().phase_timeout.saturating_mul(4) + TURN_LIMIT;
        let task = TaskRef::new(name, old);
        let left = cx.call(&task, MoveOut { to }).deadline(limit).await;
        // What counts is whether the name has its new place, also when its old one died just then.
        let turned = {
            let mut state = self.state.borrow_mut();
            state.moves.get_mut(name).and_then(|one| one.turned.take())
        };
        match (turned, left) {
            (Some(turned), _) => {
                // Ends one way or the other when everybody has turned.
                let _ = turned.await;
                Ok(())
            }
            (None, Err(error)) => Err(format!("`{name}` stays where it is: {}", error.reason())),
            (None, Ok(_)) => Err(format!("`{name}` stays where it is")),
        }
    }

    /// Gives a name to its new place, if nothing speaks against it.
    fn commit(&self, cx: &Context, commit: CommitMove) -> Result<(), String> {
        let CommitMove { name, old, new } = commit;
        let here = cx.chassis();
        let mut state = self.state.borrow_mut();
        if state.names.get(&name) != Some(&old) || !state.moves.contains_key(&name) {
            return Err("nobody moves it".to_owned());
        }
        let linked = |chassis: u8| chassis == here.index() || here.is_linked(chassis);
        if state.forbidden.contains(&new) || !linked(new.chassis()) {
            return Err("the new place was given up".to_owned());
        }
        let everybody = here.others().chain([here.index()]);
        let (slow, gone): (Vec<u8>, Vec<u8>) = everybody.partition(|chassis| linked(*chassis));
        state.names.insert(name.clone(), new);
        state.used.insert(new, name.clone());
        let home = Place {
            chassis: new.chassis(),
            processor: new.processor(),
        };
        state.homes.insert(name.clone(), home);
        let turning = (old, slow.iter().copied().collect());
        state.turning.insert(name.clone(), turning);
        let (tell, turned) = oneshot::channel();
        if let Some(one) = state.moves.get_mut(&name) {
            one.turned = Some(turned);
        }
        drop(state);
        // Before anybody can send to the new place: whoever stops a chassis stops the tasks it has.
        let moved = TaskMoved {
            task: TaskName {
                name: name.clone(),
                tid: new,
            },
            old,
        };
        here.post_system(system::BOOTSTRAP, moved);
        let settle = Settle {
            place: new,
            how: Settled::Go { gone },
        };
        here.post_system(system::agent_tid(new.chassis()), settle);
        let (service, home) = (self.clone(), cx.clone());
        cx.spawn(async move {
            let rebound = Rebound {
                name,
                old,
                new: Some(new),
                moved: true,
            };
            service.turn_all(&home, &rebound, new, &slow).await;
            // Nobody listens when the one who asked is gone.
            let _ = tell.send(());
        });
        Ok(())
    }

    /// Turns every chassis to the new place of a task, and then gives up the old one.
    async fn turn_all(&self, cx: &Context, rebound: &Rebound, new: Tid, chassis: &[u8]) {
        let turning = chassis.iter().map(|index| async move {
            let agent = TaskRef::new("agent", system::agent_tid(*index));
            let turned = cx.call(&agent, rebound.clone()).deadline(TURN_LIMIT).await;
            let through = match turned {
                Ok(()) => true,
                Err(error) if error.is_gone() => true,
                Err(error) => {
                    tracing::debug!(task = %rebound.name, error = %error, "turned by others");
                    turn_for(cx, rebound, new, *index).await
                }
            };
            if !through {
                let chassis = cx.chassis().name_of(*index);
                tracing::error!(task = %rebound.name, chassis, "did not turn to the task's new place");
            }
            if let Some((_, slow)) = self.state.borrow_mut().turning.get_mut(&rebound.name) {
                slow.remove(index);
            }
            through
        });
        let all = join_all(turning).await;
        self.state.borrow_mut().turning.remove(&rebound.name);
        if all.into_iter().all(|through| through) {
            let settle = Settle {
                place: rebound.old,
                how: Settled::Retire,
            };
            let agent = system::agent_tid(rebound.old.chassis());
            cx.chassis().post_system(agent, settle);
        }
    }
}

/// Tells every chassis that a name has another id, or none.
fn broadcast(cx: &Context, name: &str, old: Tid, new: Option<Tid>) {
    let chassis = cx.chassis();
    let everybody = chassis.others().filter(|index| chassis.is_linked(*index));
    for index in everybody.chain([chassis.index()]) {
        let rebound = Rebound {
            name: name.to_owned(),
            old,
            new,
            moved: false,
        };
        chassis.post_system(system::agent_tid(index), rebound);
    }
}
