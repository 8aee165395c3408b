//! The second phase of a firing: its action, the end of the action within its limit, and the tries
//! of an action that has no failure branch.

use std::{rc::Rc, time::Duration};

use ctos::{
    DEFAULT_DEADLINE,
    task::{Context, HandlerError},
};

use super::{engine::Engine, journal::Phase};
use crate::{
    exec::{FireError, FiringId},
    library::{Acted, Action},
    net::{self, TransitionId},
    stream::EventPhase,
};

/// How often an action without failure branch is tried before the net gives up.
const MOST_TRIES: u32 = 4;

/// The wait before the second try; it doubles for each further one.
const FIRST_RETRY: Duration = Duration::from_millis(100);

impl<S: 'static> Engine<S> {
    pub(super) async fn act(self: Rc<Self>, id: TransitionId, firing: FiringId, action: Action<S>) {
        let (notes, cx) = (Rc::clone(&action.notes), action.cx.clone());
        let acted = match self.told(&cx).await {
            Ok(()) => self.action(id, action).await,
            Err(error) => Err(error),
        };
        let transition = &self.net[id];
        let tries = {
            let mut core = self.core.borrow_mut();
            let failures = &mut core.failures[id.index()];
            *failures = if acted.is_ok() { 0 } else { *failures + 1 };
            *failures
        };
        if let Err(error) = &acted {
            notes
                .borrow_mut()
                .push(format!("{}: {error}", transition.name));
            if transition.fail.is_none() {
                if tries >= MOST_TRIES {
                    self.halt(&format!(
                        "transition `{}` failed {tries} times: {error}",
                        transition.name
                    ));
                } else {
                    self.cx.sleep(FIRST_RETRY * (1 << (tries - 1))).await;
                }
            }
        }
        if let Err(error) = self.end(&cx, id, firing, acted) {
            self.halt(&error.to_string());
        }
        self.advance(&cx);
    }

    fn end(
        self: &Rc<Self>,
        cx: &Context,
        id: TransitionId,
        firing: FiringId,
        acted: Acted,
    ) -> Result<(), FireError> {
        let mut core = self.core.borrow_mut();
        let (phase, text) = match &acted {
            Ok(()) => (EventPhase::Completed, String::new()),
            Err(error) => (EventPhase::Failed, error.to_string()),
        };
        let effects = match acted {
            Ok(()) => core.execution.complete(firing)?,
            Err(_) => core.execution.fail(firing)?,
        };
        let (remote, written) = (effects.remote.to_vec(), effects.written);
        let phase = Phase {
            transition: id,
            firing: Some(firing),
            phase,
            text: &text,
        };
        self.log(&mut core, cx, &phase);
        drop(core);
        self.carry_out(cx, id, &remote, written);
        Ok(())
    }

    /// Runs a transition's action within its limit.
    async fn action(&self, id: TransitionId, action: Action<S>) -> Acted {
        let transition = &self.net[id];
        let acting = async {
            match &transition.action {
                Some(net::Action::Local { function, .. }) => match self.library.act(function) {
                    Some(act) => act(action).await,
                    None => Err(HandlerError::new(format!(
                        "its library has no local function `{function}`"
                    ))),
                },
                Some(net::Action::Message {
                    task,
                    command,
                    inputs,
                    outputs,
                    ..
                }) => {
                    let limit = transition.within.unwrap_or(DEFAULT_DEADLINE);
                    let objects = (inputs.as_slice(), outputs.as_slice());
                    self.message(&action, (task, command), objects, limit).await
                }
                None => Ok(()),
            }
        };
        match transition.within {
            Some(limit) => self.cx.timeout(limit, acting).await?,
            None => acting.await,
        }
    }

    async fn message(
        &self,
        action: &Action<S>,
        (task, command): (&str, &str),
        (inputs, outputs): (&[String], &[String]),
        limit: Duration,
    ) -> Acted {
        let cx = &action.cx;
        let info = cx.registry().command_of(cx.app(), task, command)?;
        let to = cx.task(task).await?;
        // Fields that stand one after the other are how postcard encodes a structure.
        let mut request = Vec::new();
        for object in inputs {
            request.extend(action.get_data(object).await?);
        }
        let reply = cx.call_raw(&to, info, request, limit).await?;
        match outputs {
            [] => Ok(()),
            [object] => action.put_data(object, reply).await,
            _ => Err(HandlerError::new(format!(
                "the reply to `{command}` cannot be stored as several objects"
            ))),
        }
    }
}
