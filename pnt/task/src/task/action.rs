//! The second phase of a firing: its action, and the end of the action within its deadline. Also
//! the tries of an action that has no failure branch.

use std::{rc::Rc, time::Duration};

use ctos::{
    DEFAULT_DEADLINE,
    message::DataType,
    task::{Context, HandlerError},
};
use futures_util::future::{AbortRegistration, Abortable, Aborted};

use super::{
    acting::Ended,
    ask::put_once,
    engine::Engine,
    journal::Phase,
    messages::{PutOnce, RequestId, TapeAnswer},
    other::is_durable,
    requests::BEING_STOPPED,
};
use crate::{
    library::{Acted, Action, Local},
    stream::{Changed, EventPhase},
};
use pnt_analysis::check::objects::Objects;
use pnt_language::{
    exec::{FireError, FiringId},
    net::{self, TransitionId},
};

/// How often an action without failure branch is tried before the net gives up.
const MOST_TRIES: u32 = 4;

/// The wait before the second try; it doubles for each further one.
const FIRST_RETRY: Duration = Duration::from_millis(100);

impl Engine {
    pub(super) async fn act(
        self: Rc<Self>,
        id: TransitionId,
        firing: FiringId,
        action: Action<()>,
        cancel: AbortRegistration,
    ) {
        let (notes, cx) = (Rc::clone(&action.notes), action.cx.clone());
        let acting = async {
            self.told(&cx).await?;
            self.action(id, firing, action).await
        };
        let (acted, by_hand) = match Abortable::new(acting, cancel).await {
            Ok(acted) => (acted, false),
            Err(Aborted) => {
                let (acted, by_hand) = self.ended_from_outside(firing);
                (acted.map(|()| Changed::new()), by_hand)
            }
        };
        let net = self.net();
        let transition = &net[id];
        let tries = {
            let mut core = self.core.borrow_mut();
            core.acting.remove(&firing);
            let failures = core.failures.get_mut(id.index());
            failures.map_or(0, |failures| {
                *failures = if acted.is_ok() { 0 } else { *failures + 1 };
                *failures
            })
        };
        if let Err(error) = &acted {
            notes
                .borrow_mut()
                .push(format!("{}: {error}", transition.name));
            if transition.fail.is_none() && !by_hand {
                if self.cx.is_stopping() {
                    self.tries_no_more(&transition.name, error);
                } else if tries >= MOST_TRIES {
                    self.halt(&format!(
                        "transition `{}` failed {tries} times: {error}",
                        transition.name
                    ));
                } else {
                    let doublings = tries.saturating_sub(1);
                    self.cx.sleep(FIRST_RETRY * (1 << doublings)).await;
                    if self.cx.is_stopping() {
                        self.tries_no_more(&transition.name, error);
                    }
                }
            }
        }
        if let Err(error) = self.end(&cx, id, firing, acted) {
            self.halt(&error.to_string());
        }
        self.advance(&cx);
    }

    /// What an action came to that was ended from outside, and whether a person did that.
    fn ended_from_outside(&self, firing: FiringId) -> (Acted, bool) {
        let core = self.core.borrow();
        let acting = core.acting.get(&firing);
        match acting.map_or(Ended::Cancelled, |acting| acting.ended) {
            Ended::Completed => (Ok(()), true),
            Ended::Cancelled => (Err(HandlerError::new("cancelled by hand")), true),
            Ended::TooLate => {
                let why = format!("cancelled, because {BEING_STOPPED} and it did not end");
                (Err(HandlerError::new(why)), false)
            }
        }
    }

    /// The third phase of a firing. An action that was done tells what data it has changed.
    pub(super) fn end(
        self: &Rc<Self>,
        cx: &Context,
        id: TransitionId,
        firing: FiringId,
        acted: Result<Changed, HandlerError>,
    ) -> Result<(), FireError> {
        let mut core = self.core.borrow_mut();
        let failed = acted.is_err();
        let (phase, text) = match &acted {
            Ok(changed) => (EventPhase::Completed, core.declared.told(changed)),
            Err(error) => (EventPhase::Failed, error.to_string()),
        };
        let on_tape = core.at_hand(id);
        let effects = match &acted {
            Ok(_) => core.execution.complete(firing)?,
            Err(_) => core.execution.fail(firing)?,
        };
        let written = effects.written;
        let sent = core.routes.of(id, failed);
        let phase = Phase {
            transition: id,
            firing: Some(firing),
            phase,
            text: &text,
            changed: acted.unwrap_or_default(),
        };
        self.log(&mut core, cx, &phase);
        drop(core);
        self.carry_out(cx, id, sent, written, on_tape);
        Ok(())
    }

    /// Runs a transition's action within its deadline; what data it has changed.
    async fn action(
        &self,
        id: TransitionId,
        firing: FiringId,
        action: Action<()>,
    ) -> Result<Changed, HandlerError> {
        let net = self.net();
        let transition = &net[id];
        let acting = async {
            if let Some(stand_in) = &self.settings.stand_in {
                return self.stand_in(&action, transition, stand_in).await;
            }
            let acted = match &transition.action {
                Some(net::Action::Local {
                    function,
                    inputs,
                    outputs,
                    ..
                }) => self.local(action, function, (inputs, outputs)).await,
                Some(net::Action::Message {
                    task,
                    command,
                    inputs,
                    outputs,
                    ..
                }) => {
                    let limit = transition.within.unwrap_or(DEFAULT_DEADLINE);
                    let objects = (inputs.as_slice(), outputs.as_slice());
                    let request = self.request(firing);
                    let to = (task.as_str(), command.as_str(), request);
                    return self.message(&action, to, objects, limit).await;
                }
                Some(net::Action::Written { does, sets, .. }) => {
                    let limit = transition.within.unwrap_or(DEFAULT_DEADLINE);
                    return self.written(&action, (does.as_ref(), sets), limit).await;
                }
                None => Ok(()),
            };
            acted.map(|()| Changed::new())
        };
        match transition.within {
            Some(limit) => self.cx.timeout(limit, acting).await?,
            None => acting.await,
        }
    }

    async fn local(
        &self,
        action: Action<()>,
        function: &str,
        (inputs, outputs): Objects<'_>,
    ) -> Acted {
        match self.library.local(function) {
            Some(Local::Plain(act)) => act(action).await,
            Some(Local::Typed { call, result, .. }) => {
                let argument = gathered(&action, inputs).await?;
                let given = call(action.clone(), argument).await?;
                store(&action, outputs, given, result).await
            }
            None => Err(HandlerError::new(format!(
                "its library has no local function `{function}`"
            ))),
        }
    }

    async fn message(
        &self,
        action: &Action<()>,
        (task, command, request): (&str, &str, RequestId),
        (inputs, outputs): Objects<'_>,
        limit: Duration,
    ) -> Result<Changed, HandlerError> {
        let cx = &action.cx;
        let info = match cx.registry().command_of(cx.app(), task, command) {
            Ok(info) => info,
            // Of a net that is asked for one of its own commands.
            Err(_) if is_net(cx, task) => {
                let dispatched = self.dispatch(action, task, (command, request), limit);
                return dispatched.await.map(|()| Changed::new());
            }
            Err(finding) => return Err(finding.into()),
        };
        let request = self.sent(action, inputs, info.request).await?;
        let to = cx.task(task).await?;
        let reply = cx.call_raw(&to, info, request, limit).await?;
        self.received(action, outputs, reply, info.reply).await
    }

    /// The number of the request that an action of this firing makes. It is the same when the next life
    /// of a durable net asks again.
    fn request(&self, firing: FiringId) -> RequestId {
        let core = self.core.borrow();
        let name = core.execution.net().name();
        RequestId {
            from: format!("{name} {:016x}", core.transfers.stream()),
            number: firing.number(),
        }
    }

    /// Nested dispatch: puts a symbol on another net's tape, with the arguments of the command in progress.
    /// The first of the answers that the other net declares for it completes the action; any other fails
    /// it. A net that survives its process is asked again when it may have died before it answered: it
    /// takes the command once.
    async fn dispatch(
        &self,
        action: &Action<()>,
        net: &str,
        (symbol, request): (&str, RequestId),
        limit: Duration,
    ) -> Acted {
        let cx = &action.cx;
        let put = PutOnce {
            request,
            symbol: symbol.to_owned(),
            arguments: action.arguments().to_vec(),
        };
        let answer = put_once(cx, net, &put, limit).await?;
        let TapeAnswer {
            symbol: answer,
            text,
            first,
        } = answer;
        for line in text.lines() {
            action.note(line);
        }
        if first {
            return Ok(());
        }
        Err(HandlerError::new(format!(
            "net `{net}` answered `{symbol}` with `{answer}`"
        )))
    }
}

/// One value of several data objects: fields that stand one after the other are how postcard encodes a
/// structure.
async fn gathered(action: &Action<()>, inputs: &[String]) -> Result<Vec<u8>, HandlerError> {
    let mut bytes = Vec::new();
    for object in inputs {
        bytes.extend(action.get_data(object).await?);
    }
    Ok(bytes)
}

/// Stores a result as one data object, or each of its fields as one: all of them or none.
async fn store(action: &Action<()>, outputs: &[String], result: Vec<u8>, kind: DataType) -> Acted {
    match outputs {
        [] => Ok(()),
        [object] => action.put_data(object, result).await,
        objects => {
            let parts = kind.split(&result)?;
            if parts.len() != objects.len() {
                return Err(HandlerError::new(format!(
                    "{} results came for {} data objects",
                    parts.len(),
                    objects.len()
                )));
            }
            let named = objects.iter().cloned().zip(parts);
            action.put_all_data(named.collect()).await
        }
    }
}

/// Whether an action may be asked again whatever became of it. It is then a command to a net that
/// survives its process, and takes a request once.
pub(super) fn is_asked_once(cx: &Context, action: &net::Action) -> bool {
    let net::Action::Message { task, command, .. } = action else {
        return false;
    };
    let unknown = || cx.registry().command_of(cx.app(), task, command).is_err();
    is_net(cx, task) && is_durable(cx, task) && unknown()
}

/// Whether a task takes what nets take.
fn is_net(cx: &Context, task: &str) -> bool {
    let task = cx.app().task(task);
    task.is_some_and(|task| super::load::runs_net(task, &cx.registry()))
}
