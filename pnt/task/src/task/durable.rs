//! What must be stored before others see it.
//!
//! A net changes in memory and counts its changes. What others would see of a change is an answer, a
//! transfer or the beginning of an action. It is held until a commit has stored the changed state. One
//! commit stores all changes that came while the one before it was written (group commit). A net that is
//! not durable holds nothing.
//!
//! What is stored is the state itself, not a log. A net's state is small, and reading it back is all there
//! is to a restart.

use std::{collections::VecDeque, rc::Rc, sync::Arc};

use ctos::{
    diagnostic::Source,
    message::Replier,
    task::{Context, HandlerError},
};
use serde::{Deserialize, Serialize};

use super::{
    action::is_asked_once,
    engine::{Core, Engine, objects_of},
    messages::{Marking, Output},
    once::Once,
    transfers::Transfers,
};
use crate::store::Contents;
use pnt_language::{
    compile,
    data::Value,
    exec::{Execution, FiringId, State},
    net::{Action, Net, TransitionId},
};

/// Under which names a store has the state of a net, and the text of a net that was put in its place.
const STATE: &str = "state";
pub(super) const NET: &str = "net";

/// The same for the data that a net declares, by name.
const DATA: &str = "data";

/// The state of a net as it is stored.
#[derive(Deserialize)]
struct Saved {
    /// Of the net that it belongs to.
    digest: u64,
    execution: State,
    transfers: Transfers,
    notes: Vec<String>,
    output: VecDeque<Output>,
    outputs: u64,
    failures: Vec<u32>,
    paused: Option<String>,
    once: Once,
    /// That of the library, if it can be kept.
    library: Option<Vec<u8>>,
}

/// The same, to be written.
#[derive(Serialize)]
struct Saving<'c> {
    digest: u64,
    execution: State,
    transfers: &'c Transfers,
    notes: &'c [String],
    output: &'c VecDeque<Output>,
    outputs: u64,
    failures: &'c [u32],
    paused: Option<&'c str>,
    once: &'c Once,
    library: Option<Vec<u8>>,
}

/// A net that was put in place of the configured one.
#[derive(Serialize, Deserialize)]
struct NewNet {
    file: String,
    text: String,
}

impl Engine {
    /// Does something that others see, once everything up to now is stored. The caller holds no borrow.
    pub(super) fn when_stored(self: &Rc<Self>, effect: impl FnOnce(&Rc<Self>) + 'static) {
        let change = self.core.borrow().changes;
        self.when_change_stored(change, effect);
    }

    /// The same, once this change is stored. A change that nobody will store any more is never seen:
    /// who waits for it learns that no answer comes.
    pub(super) fn when_change_stored(
        self: &Rc<Self>,
        change: u64,
        effect: impl FnOnce(&Rc<Self>) + 'static,
    ) {
        let durable = &self.durable;
        if change <= durable.stored() && durable.held.borrow().is_empty() {
            return effect(self);
        }
        if durable.broken.get() {
            return;
        }
        let mut held = durable.held.borrow_mut();
        held.push_back((change, Box::new(effect)));
    }

    /// Whether all changes are stored, or none will be any more. In the second case the net has stopped,
    /// and is shown as it was left, to say why.
    pub(super) fn is_settled(&self, core: &Core) -> bool {
        core.changes <= self.durable.stored() || self.durable.broken.get()
    }

    /// Answers with how the net is now, once that is stored.
    pub(super) fn show(self: &Rc<Self>, reply: Replier<Marking>) {
        let snapshot = self.snapshot();
        if self.durable.broken.get() {
            // Answering never fails; a caller that is gone needs no answer.
            let _ = reply.ok(snapshot);
            return;
        }
        self.when_stored(move |_| {
            // As above.
            let _ = reply.ok(snapshot);
        });
    }

    /// Sees to it that a child stores what is not stored yet.
    pub(super) fn store_changes(self: &Rc<Self>) {
        let durable = &self.durable;
        if self.core.borrow().changes > durable.stored() && !durable.committing.replace(true) {
            let engine = Rc::clone(self);
            self.cx.spawn(async move { engine.commit().await });
        }
    }

    /// Commits until nothing is left to store.
    async fn commit(self: Rc<Self>) {
        let durable = &self.durable;
        while let Some(store) = &durable.store {
            let (change, reached) = {
                let core = self.core.borrow();
                let stream = &core.journal.stream;
                (core.changes, stream.reached(self.cx.now(), &core.execution))
            };
            if change <= durable.stored() {
                break;
            }
            let written = match self.saved() {
                Ok(state) => {
                    let mut changes = vec![(STATE.to_owned(), Some(state))];
                    changes.extend(self.saved_data().map(|data| (DATA.to_owned(), Some(data))));
                    if let Some(net) = durable.new_net.take() {
                        changes.push((NET.to_owned(), Some(net)));
                    }
                    store
                        .commit(&self.cx, changes)
                        .await
                        .map_err(HandlerError::from)
                }
                Err(error) => Err(error),
            };
            if let Err(error) = written {
                // What is held is never seen; its callers learn that nobody answers.
                durable.held.take();
                durable.committing.set(false);
                durable.broken.set(true);
                return self.halt(&format!("its state cannot be stored: {error}"));
            }
            durable.stored.set(change);
            self.release(change);
            let core = &mut *self.core.borrow_mut();
            core.journal.stream.show(reached);
            if self.is_settled(core) {
                core.journal.stream.show_all();
            }
            self.call_followers(core);
        }
        durable.committing.set(false);
        self.core.borrow_mut().requests.look_again();
    }

    /// Does what waited for changes up to this one.
    fn release(self: &Rc<Self>, stored: u64) {
        loop {
            let next = {
                let mut held = self.durable.held.borrow_mut();
                let ready = held.front().is_some_and(|(change, _)| *change <= stored);
                if ready { held.pop_front() } else { None }
            };
            let Some((_, effect)) = next else { return };
            effect(self);
        }
    }

    fn saved(&self) -> Result<Vec<u8>, HandlerError> {
        let core = self.core.borrow();
        let notes = core.notes.borrow();
        let saving = Saving {
            digest: core.execution.net().digest(),
            execution: core.execution.state(),
            transfers: &core.transfers,
            notes: &notes,
            output: &core.output,
            outputs: core.outputs,
            failures: &core.failures,
            paused: core.manual.paused(),
            once: &core.once,
            library: self.library.saved()?,
        };
        Ok(postcard::to_stdvec(&saving)?)
    }

    /// The data that the net declares, if it does.
    fn saved_data(&self) -> Option<Vec<u8>> {
        let core = self.core.borrow();
        let named = core.declared.named();
        // Values of these types can always be written.
        (!named.is_empty()).then(|| postcard::to_stdvec(&named).ok())?
    }

    /// The text of the net that is put in place: it is stored with the next commit.
    pub(super) fn store_net(&self, file: &str, text: &str) -> Result<(), HandlerError> {
        if self.durable.store.is_some() {
            let (file, text) = (file.to_owned(), text.to_owned());
            let bytes = postcard::to_stdvec(&NewNet { file, text })?;
            self.durable.new_net.replace(Some(bytes));
        }
        Ok(())
    }

    /// Goes on from what a store holds, if it holds anything.
    ///
    /// # Errors
    /// When the state is not that of this net, or cannot be read; then nothing of it is used.
    pub(super) fn resume(&mut self, contents: &Contents) -> Result<(), HandlerError> {
        let Some(bytes) = contents.get(STATE) else {
            return Ok(());
        };
        let path = self
            .durable
            .store
            .as_ref()
            .map(|store| store.path().display());
        let path = path.map(|path| path.to_string()).unwrap_or_default();
        let wrong = |what: String| HandlerError::new(format!("{path}: {what}"));
        let saved: Saved = match postcard::take_from_bytes(bytes) {
            Ok((saved, [])) => saved,
            _ => {
                return Err(wrong(
                    "its state cannot be read: move the file away to begin afresh".to_owned(),
                ));
            }
        };
        let core = self.core.get_mut();
        let net = Arc::clone(core.execution.net());
        if saved.digest != net.digest() {
            return Err(wrong(format!(
                "it holds the state of another net called `{}` ({:016x}, and this one is {:016x}): go back to that net and change it with `ctos net replace`, or move the file away to begin afresh",
                net.name(),
                saved.digest,
                net.digest()
            )));
        }
        let restored = Execution::restore(Arc::clone(&net), saved.execution);
        let execution = restored.map_err(|error| wrong(error.to_string()))?;
        if let Some(data) = contents.get(DATA) {
            let named: Vec<(String, Value)> = postcard::from_bytes(data)?;
            core.declared.take_up(named);
        }
        if let Some(library) = saved.library {
            let restored = self.library.restore(&library);
            restored.map_err(|error| wrong(error.to_string()))?;
        }
        core.execution = execution;
        // A clock that was running is drawn anew: with its process its past is forgotten.
        core.race = core.race.begin_again(&core.execution);
        core.transfers = saved.transfers;
        core.notes.replace(saved.notes);
        core.output = saved.output;
        core.outputs = saved.outputs;
        core.once = saved.once;
        core.failures = saved.failures;
        core.failures.resize(net.transitions().len(), 0);
        if let Some(why) = saved.paused {
            core.manual.pause(why);
        }
        // The keeper of the objects may have forgotten what it was told, or was not told of the
        // last change.
        core.objects = objects_of(&net, None);
        core.changed();
        core.journal
            .stream
            .begin_again(self.cx.now(), &core.execution, core.declared.values());
        tracing::warn!(target: "pnt::net", net = net.name(), "net goes on where it was");
        Ok(())
    }

    /// Goes on with what was under way when the process died: transfers, and actions if they may be asked
    /// again.
    pub(super) fn take_up_firings(self: &Rc<Self>, cx: &Context) {
        let (nets, running): (Vec<Arc<str>>, Vec<(FiringId, TransitionId)>) = {
            let core = self.core.borrow();
            let nets = core.transfers.waiting().map(|(net, _)| Arc::clone(net));
            (nets.collect(), core.execution.running().collect())
        };
        for net in nets {
            self.carry_to(&net);
        }
        for (firing, id) in running {
            let (idempotent, failure_branch, name) = {
                let core = self.core.borrow();
                let transition = &core.execution.net()[id];
                let name = transition.name.clone();
                let again = |action: &Action| action.is_idempotent() || is_asked_once(cx, action);
                let idempotent = transition.action.as_ref().is_some_and(again);
                (idempotent, transition.fail.is_some(), name)
            };
            if idempotent {
                let of = cx.clone();
                self.when_stored(move |engine| engine.spawn_action(id, firing, &of));
                continue;
            }
            let doubt = "it was in action when its process died: in doubt";
            tracing::warn!(target: "pnt::net", transition = %name, "an action is in doubt");
            self.core
                .borrow()
                .notes
                .borrow_mut()
                .push(format!("{name}: {doubt}"));
            if !failure_branch {
                return self.halt(&format!(
                    "transition `{name}` is in doubt: {doubt}, it has no failure branch, and it is not declared idempotent"
                ));
            }
            let ended = self.end(cx, id, firing, Err(HandlerError::new(doubt)));
            if let Err(error) = ended {
                return self.halt(&error.to_string());
            }
        }
    }
}

/// The net that a store says is to run: the one that was put in place of the configured one.
///
/// # Errors
/// When its text cannot be used any more.
pub(super) fn replaced_net(contents: &Contents) -> Result<Option<Net>, HandlerError> {
    let Some(bytes) = contents.get(NET) else {
        return Ok(None);
    };
    let NewNet { file, text } = postcard::from_bytes(bytes)?;
    Ok(Some(compile::net(&Source::new(file, text))?))
}
