//! The task identification service: which task has which symbolic name.
//!
//! One task for the whole app, on the chassis that boots it (the report's figure 4). Chassis remember
//! what they were told until the task ends, moves, or its chassis is gone; they are told of each.
//! A name belongs to one task at a time, and a task id to one name for the whole run.

mod away;
mod lines;
mod moves;
mod waiting;

use std::{
    cell::RefCell,
    collections::{BTreeMap, BTreeSet},
    rc::Rc,
};

use tokio::sync::oneshot;

use away::Presence;
use lines::Lines;

use crate::{
    context::{Context, TaskRef},
    envelope::Replier,
    handled::Handled,
    system::{
        self, AbortMove, AwaitTid, Change, ChassisNews, CommitMove, FindTid, FirstSlots, Monitor,
        MoveTask, MovedTasks, NamesOf, Place, Rebound, RegisterTid, TaskChanged, WhoWaits,
    },
};
use ctos_message::{ChassisNumber, CommandInfo, Tid};

/// What the service takes.
pub const COMMANDS: [CommandInfo; 13] = TidServer::COMMANDS;

/// A task that waits for a name.
struct Waiter {
    name: String,
    reply: Replier<AwaitTid>,
}

#[derive(Default)]
pub struct Names {
    names: BTreeMap<String, Tid>,
    /// Every id that was ever registered, with its name.
    used: BTreeMap<Tid, String>,
    /// The last id of each name that has none now.
    past: BTreeMap<String, Tid>,
    /// Those whose task came to its end by itself.
    ended: BTreeSet<String>,
    waiting: Lines<Waiter>,
    monitors: BTreeMap<String, BTreeSet<Tid>>,
    /// Names whose task takes no messages at the moment.
    down: BTreeSet<String>,
    /// Moves that have begun; with what ends when every chassis has turned to the new place, once the name has it.
    moves: BTreeMap<String, Option<oneshot::Receiver<()>>>,
    /// Where tasks are that have moved; when their chassis is started again, they begin there.
    homes: BTreeMap<String, Place>,
    /// Places that no task may move to any more.
    forbidden: BTreeSet<Tid>,
    /// Chassis that are not there, and who waits for them.
    presence: Presence,
    /// Tasks that have moved, with their old id and the chassis that still send by the old place.
    turning: BTreeMap<String, (Tid, BTreeSet<ChassisNumber>)>,
}

/// The service's state.
#[derive(Default, Clone)]
pub struct TidServer {
    state: Rc<RefCell<Names>>,
}

#[ctos_derive::handler]
impl TidServer {
    #[command]
    fn register_tid(&self, cx: &Context, RegisterTid { task }: RegisterTid) -> Result<(), String> {
        let mut state = self.state.borrow_mut();
        let place = |tid: Tid| {
            let chassis = cx.chassis().name_of(tid.chassis());
            format!("task {tid} on chassis `{chassis}`")
        };
        match state.names.get(&*task.name) {
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
        state.used.insert(task.tid, task.name.to_string());
        state.names.insert(task.name.to_string(), task.tid);
        let before = state.past.remove(&*task.name);
        state.ended.remove(&*task.name);
        let waiters = state.waiting.take(&task.name);
        drop(state);
        if let Some(old) = before {
            broadcast(cx, &task.name, old, Some(task.tid));
        }
        for waiter in waiters {
            // A reply cannot fail.
            let _ = waiter.reply.ok(Ok(task.tid));
        }
        self.state.borrow_mut().answer_waiting_for(cx, &task.name);
        self.notify(cx, &task, &Change::Up);
        Ok(())
    }

    #[command]
    fn find_tid(&self, cx: &Context, request: FindTid, reply: Replier<FindTid>) -> Handled {
        self.state.borrow_mut().asked(cx, request, reply)
    }

    #[command]
    fn chassis_news(&self, cx: &Context, ChassisNews { news }: ChassisNews) {
        self.heard(cx, news);
    }

    #[command]
    fn await_tid(&self, cx: &Context, request: AwaitTid, reply: Replier<AwaitTid>) -> Handled {
        let by = self.state.borrow().name_of(reply.asker());
        away::want(cx, &request.name, by);
        self.state.borrow_mut().wait(request, reply)
    }

    #[command]
    fn who_waits(&self, WhoWaits { name }: WhoWaits) -> String {
        self.state.borrow_mut().who_waits(&name)
    }

    #[command]
    fn monitor(&self, Monitor { name }: Monitor, reply: Replier<Monitor>) -> Handled {
        let mut state = self.state.borrow_mut();
        let up = state.names.contains_key(&name) && !state.down.contains(&name);
        state
            .monitors
            .entry(name)
            .or_default()
            .insert(reply.asker());
        reply.ok(up)
    }

    #[command]
    fn task_changed(&self, cx: &Context, TaskChanged { task, change }: TaskChanged) {
        if let Change::Ended { .. } = change {
            if !self.state.borrow_mut().free(&task) {
                return;
            }
            self.state.borrow_mut().ended.insert(task.name.to_string());
            broadcast(cx, &task.name, task.tid, None);
        }
        self.notify(cx, &task, &change);
    }

    /// By the number of the processor.
    #[command]
    fn first_slots(&self, FirstSlots { chassis }: FirstSlots) -> BTreeMap<u8, u32> {
        let state = self.state.borrow();
        let used = state.used_on(chassis);
        // In the order of their slots: the last of each processor counts.
        used.map(|(tid, _)| (tid.processor(), tid.slot().saturating_add(1)))
            .collect()
    }

    #[command]
    fn move_task(&self, cx: &Context, request: MoveTask, reply: Replier<MoveTask>) -> Handled {
        let (service, here) = (self.clone(), cx.clone());
        cx.spawn(async move {
            // A reply cannot fail.
            let _ = match service.carry(&here, request).await {
                Ok(place) => reply.ok(place),
                Err(why) => reply.fail(why),
            };
        });
        Ok(())
    }

    #[command]
    fn commit_move(&self, cx: &Context, commit: CommitMove) -> Result<(), String> {
        self.commit(cx, commit)
    }

    #[command]
    fn abort_move(&self, AbortMove { new }: AbortMove) -> bool {
        let mut state = self.state.borrow_mut();
        let committed = state.used.contains_key(&new);
        if !committed {
            state.forbidden.insert(new);
        }
        committed
    }

    #[command]
    fn moved_tasks(&self, _: MovedTasks) -> Vec<(String, Place)> {
        self.state.borrow().homes.clone().into_iter().collect()
    }

    #[command]
    fn names_of(&self, NamesOf { tids }: NamesOf) -> Vec<Option<String>> {
        let state = self.state.borrow();
        let name = |tid: &Tid| state.used.get(tid).cloned();
        tids.iter().map(name).collect()
    }

    #[chassis_down]
    fn lost(&mut self, cx: &Context, chassis: &str) -> Handled {
        let here = cx.chassis();
        let lost = here.number_of(chassis);
        let gone = lost.map(|index| self.state.borrow().tasks_on(index));
        for task in gone.into_iter().flatten() {
            let reason = format!("its chassis `{chassis}` is gone");
            self.state.borrow_mut().free(&task);
            self.notify(cx, &task, &Change::Ended { reason });
        }
        let mut state = self.state.borrow_mut();
        if let Some(index) = lost {
            state.presence.lost(cx, index);
        }
        state.answer_waiting(cx);
        Ok(())
    }
}

impl Names {
    /// The id under which `chassis` is to send to a task. It is the old one until the chassis is
    /// redirected to the new place, so that its messages take one way.
    fn seen_from(&self, chassis: ChassisNumber, name: &str) -> Option<Tid> {
        match self.turning.get(name) {
            Some((old, slow)) if slow.contains(&chassis) => Some(*old),
            _ => self.names.get(name).copied(),
        }
    }

    /// Every id that a task of a chassis ever had, with its name. The others are not looked at.
    fn used_on(&self, chassis: ChassisNumber) -> impl Iterator<Item = (&Tid, &String)> {
        let last = Tid::new(chassis, u8::MAX, Tid::LAST_SLOT);
        self.used.range(Tid::new(chassis, 0, 0)..=last)
    }

    /// The tasks of a chassis, by name.
    fn tasks_on(&self, chassis: ChassisNumber) -> Vec<TaskRef> {
        let used = self.used_on(chassis);
        let there = used.filter(|(tid, name)| self.names.get(*name) == Some(tid));
        let tasks = there.map(|(tid, name)| TaskRef::new(name.as_str(), *tid));
        let mut tasks: Vec<_> = tasks.collect();
        tasks.sort_by(|one, other| one.name().cmp(other.name()));
        tasks
    }

    /// The name has no task any more.
    fn free(&mut self, task: &TaskRef) -> bool {
        if self.names.get(&*task.name) != Some(&task.tid) {
            return false;
        }
        self.names.remove(&*task.name);
        self.past.insert(task.name.to_string(), task.tid);
        true
    }
}

impl TidServer {
    /// Tells those who monitor a task, if the change is one.
    fn notify(&self, cx: &Context, task: &TaskRef, change: &Change) {
        let mut state = self.state.borrow_mut();
        let news = match change {
            Change::Up => state.down.remove(&*task.name),
            Change::Down { .. } => state.down.insert(task.name.to_string()),
            // Also when it was being restarted: it will not come up by itself.
            Change::Ended { .. } => {
                state.down.insert(task.name.to_string());
                true
            }
        };
        if !news {
            return;
        }
        for watcher in state.monitors.get(&*task.name).into_iter().flatten() {
            let changed = TaskChanged {
                task: task.clone(),
                change: change.clone(),
            };
            cx.chassis().post_system(*watcher, changed);
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
