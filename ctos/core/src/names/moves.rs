//! Who decides when a task moves. The name belongs to the old place until the moment of [`commit`], and to
//! the new one from then on.
//!
//! [`commit`]: TidServer::commit

use std::time::Duration;

use futures_util::future::join_all;
use tokio::sync::oneshot;

use super::TidServer;
use crate::{
    context::{Context, TaskRef},
    moving::{find_place, place_text, redirect_for},
    system::{self, CommitMove, MoveOut, MoveTask, Place, Rebound, Settle, Settled, TaskMoved},
};
use ctos_message::{ChassisNumber, Tid};

/// How long a chassis may take to redirect to a task's new place.
const REDIRECT_DEADLINE: Duration = Duration::from_secs(180);

impl TidServer {
    pub(super) async fn carry(&self, cx: &Context, request: MoveTask) -> Result<String, String> {
        let MoveTask { task, to } = request;
        let place = find_place(cx.chassis(), &to).map_err(|wrong| wrong.to_string())?;
        let old = {
            let mut state = self.state.borrow_mut();
            let Some(old) = state.names.get(&task).copied() else {
                if cx.app().task(&task).is_some() {
                    return Err(format!(
                        "task `{task}` does not run at the moment: its chassis is being started again, or it has ended"
                    ));
                }
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
            state.moves.insert(task.clone(), None);
            old
        };
        let moved = self.carry_out(cx, &task, old, place).await;
        self.state.borrow_mut().moves.remove(&task);
        moved.map(|()| place_text(cx.chassis(), place))
    }

    async fn carry_out(&self, cx: &Context, name: &str, old: Tid, to: Place) -> Result<(), String> {
        let deadline = cx.app().phase_timeout.saturating_mul(4) + REDIRECT_DEADLINE;
        let task = TaskRef::new(name, old);
        let left = cx.call(&task, MoveOut { to }).deadline(deadline).await;
        // What counts is whether the name has its new place, also when its old one died just then.
        let turned = {
            let mut state = self.state.borrow_mut();
            state.moves.get_mut(name).and_then(Option::take)
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
    pub(super) fn commit(&self, cx: &Context, commit: CommitMove) -> Result<(), String> {
        let CommitMove { name, old, new } = commit;
        let here = cx.chassis();
        let mut state = self.state.borrow_mut();
        if state.names.get(&name) != Some(&old) || !state.moves.contains_key(&name) {
            return Err("nobody moves it".to_owned());
        }
        let linked = |chassis: ChassisNumber| chassis == here.index() || here.is_linked(chassis);
        let (there, here_before) = (here.name_of(new.chassis()), here.name_of(old.chassis()));
        if !linked(new.chassis()) {
            return Err(format!("chassis `{there}` is gone"));
        }
        if state.forbidden.contains(&new) {
            return Err(format!(
                "chassis `{there}` gave its new place up: it lost chassis `{here_before}`, or heard nothing from it for too long"
            ));
        }
        let everybody = here.others().chain([here.index()]);
        let (slow, gone): (Vec<ChassisNumber>, Vec<ChassisNumber>) =
            everybody.partition(|chassis| linked(*chassis));
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
            *one = Some(turned);
        }
        drop(state);
        // Before anybody can send to the new place: the stop of a chassis stops the tasks that it
        // has.
        let moved = TaskMoved {
            task: TaskRef::new(name.as_str(), new),
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

    /// Redirects every chassis to the new place of a task, and then gives up the old one.
    async fn turn_all(&self, cx: &Context, rebound: &Rebound, new: Tid, chassis: &[ChassisNumber]) {
        let turning = chassis.iter().map(|index| async move {
            let agent = TaskRef::new("agent", system::agent_tid(*index));
            let turned = cx.call(&agent, rebound.clone()).deadline(REDIRECT_DEADLINE).await;
            let through = match turned {
                Ok(()) => true,
                Err(error) if error.is_gone() => true,
                Err(error) => {
                    tracing::debug!(task = %rebound.name, error = %error, "turned by others");
                    redirect_for(cx, rebound, new, *index).await
                }
            };
            if !through {
                let chassis = cx.chassis().name_of(*index);
                tracing::error!(task = %rebound.name, chassis, "was not redirected to the new place of the task");
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
