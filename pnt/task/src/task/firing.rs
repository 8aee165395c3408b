//! Choosing and firing transitions, and what a firing leaves to be done.

use std::{rc::Rc, sync::Arc};

use ctos::{task::Context, time::Instant};
use futures_util::future::try_join_all;

use super::{
    engine::{Core, Engine},
    journal::Phase,
    messages::Transfer,
    routes::Bundle,
};
use crate::{
    library::{Acted, Action, CommandLine},
    stream::{Changed, EventPhase},
};
use pnt_language::{
    exec::{FireError, FiringId, OnTape, Written},
    net::{TransitionId, When},
};

/// Firings without any action between them after which a net is taken to run in a circle.
const MOST_AT_ONCE: u32 = 100_000;

impl Engine {
    /// Fires until nothing is enabled but what waits for actions, tokens or commands. All of it belongs
    /// to the trace of `cx`, that of the message that made it possible. What a command on the tape
    /// begins belongs to that command's trace.
    pub(super) fn advance(self: &Rc<Self>, cx: &Context) {
        self.fire_enabled(cx.clone());
        self.core.borrow_mut().requests.look_again();
    }

    fn fire_enabled(self: &Rc<Self>, mut cx: Context) {
        let mut at_once = 0;
        loop {
            self.replace_if_safe(&cx);
            let Some(id) = self.choose() else { break };
            let acts = {
                let core = self.core.borrow();
                core.execution.net()[id].action.is_some()
            };
            at_once = if acts { 0 } else { at_once + 1 };
            if let Err(error) = self.begin_firing(id, &mut cx) {
                self.halt(&error.to_string());
            } else if at_once > MOST_AT_ONCE {
                let core = self.core.borrow();
                let name = core.name_of(id).to_owned();
                drop(core);
                self.halt(&format!(
                    "transitions such as `{name}` fire in a circle without any action"
                ));
            }
        }
        self.tell_data(&cx);
        self.store_changes();
    }

    fn choose(self: &Rc<Self>) -> Option<TransitionId> {
        let mut unvalued = None;
        let chosen = {
            let mut core = self.core.borrow_mut();
            self.tell_met(&mut core);
            if !core.begun || core.halted.is_some() || core.manual.is_stopped() {
                return None;
            }
            if self.is_silent(&core) {
                return None;
            }
            let Core {
                execution,
                conflicts,
                race,
                declared,
                journal,
                ..
            } = &mut *core;
            let ended = journal.ended();
            let mut asks = |when: &When| {
                self.says(when, declared, ended).unwrap_or_else(|why| {
                    unvalued = Some(why);
                    // So that the transition does not fire.
                    when.negated
                })
            };
            let chosen = execution.choose(conflicts, &mut asks).or_else(|| {
                // Only when nothing that takes no time is enabled may a timed transition fire.
                if !race.is_needed() {
                    return None;
                }
                execution.advance_to(self.cx.now().as_nanos());
                race.refresh(execution, &mut asks);
                race.pop(execution)
            });
            match chosen {
                Some(chosen) => self.passes(&mut core, chosen).then_some(chosen),
                None => {
                    let alarm = core.next_alarm();
                    drop(core);
                    if let Some(due_ns) = alarm {
                        self.wake_at(due_ns);
                    }
                    None
                }
            }
        };
        if let Some(why) = unvalued {
            self.halt(&why);
            return None;
        }
        chosen
    }

    /// Goes on when the next clock of a timed transition has run out.
    fn wake_at(self: &Rc<Self>, due_ns: u64) {
        let engine = Rc::clone(self);
        self.cx.spawn(async move {
            let cx = &engine.cx;
            cx.sleep(Instant::from_nanos(due_ns).since(cx.now())).await;
            {
                let mut core = engine.core.borrow_mut();
                core.alarm.take_if(|alarm| *alarm == due_ns);
            }
            engine.advance(&cx.new_trace());
        });
    }

    /// Fires a transition that is enabled, or starts it if it has an action.
    pub(super) fn begin_firing(
        self: &Rc<Self>,
        id: TransitionId,
        cx: &mut Context,
    ) -> Result<(), FireError> {
        let has_action = {
            let core = self.core.borrow();
            core.execution.net()[id].action.is_some()
        };
        if has_action {
            self.start(id, cx)
        } else {
            self.fire(id, cx)
        }
    }

    fn fire(self: &Rc<Self>, id: TransitionId, cx: &mut Context) -> Result<(), FireError> {
        let mut core = self.core.borrow_mut();
        let on_tape = core.at_hand(id);
        let read = core.in_progress();
        let effects = core.execution.fire(id)?;
        let written = effects.written;
        let sent = core.routes.of(id, false);
        core.take_up(read, written.as_ref(), cx);
        core.requests.fired(id);
        let phase = Phase {
            transition: id,
            firing: None,
            phase: EventPhase::Fired,
            text: "",
            changed: Changed::new(),
        };
        self.log(&mut core, cx, &phase);
        drop(core);
        self.carry_out(cx, id, sent, written, on_tape);
        Ok(())
    }

    fn start(self: &Rc<Self>, id: TransitionId, cx: &mut Context) -> Result<(), FireError> {
        let mut core = self.core.borrow_mut();
        let read = core.in_progress();
        let firing = core.execution.start(id)?;
        core.take_up(read, None, cx);
        let phase = Phase {
            transition: id,
            firing: Some(firing),
            phase: EventPhase::Started,
            text: "",
            changed: Changed::new(),
        };
        self.log(&mut core, cx, &phase);
        drop(core);
        let cx = cx.clone();
        self.when_stored(move |engine| engine.spawn_action(id, firing, &cx));
        Ok(())
    }

    /// Begins the second phase of a firing that has started.
    pub(super) fn spawn_action(self: &Rc<Self>, id: TransitionId, firing: FiringId, cx: &Context) {
        let mut core = self.core.borrow_mut();
        let net = Arc::clone(core.execution.net());
        let command = core.execution.tape().current().map(|on_tape| CommandLine {
            symbol: net[on_tape.command].symbol.clone(),
            arguments: on_tape.arguments.clone(),
        });
        let action = Action {
            cx: cx.clone(),
            state: Rc::default(),
            transition: net[id].name.as_str().into(),
            data: self.data.clone(),
            // Without a command there will be no answer that takes the notes away.
            notes: match &command {
                Some(_) => Rc::clone(&core.notes),
                None => Rc::default(),
            },
            command,
        };
        let (registration, acting) = super::acting::Acting::new();
        core.acting.insert(firing, acting);
        drop(core);
        let engine = Rc::clone(self);
        self.cx
            .spawn(async move { engine.act(id, firing, action, registration).await });
    }

    pub(super) fn log(self: &Rc<Self>, core: &mut Core, cx: &Context, phase: &Phase) {
        let Core {
            journal, execution, ..
        } = core;
        journal.firing(cx.now(), cx.trace(), execution, phase);
        let line = phase.line(execution.net());
        core.changed();
        self.published(core, cx);
        if let Some(line) = line {
            self.when_change_stored(core.changes, |_| line());
        }
    }

    /// Hands out what a firing leaves to be done. `on_tape` is the command that was in progress.
    pub(super) fn carry_out(
        self: &Rc<Self>,
        cx: &Context,
        id: TransitionId,
        sent: Option<Bundle>,
        written: Option<Written>,
        on_tape: Option<OnTape>,
    ) {
        if let Some(sent) = sent {
            self.post(cx, &sent);
        }
        let symbol = match written {
            None => return,
            Some(Written::Answer { symbol, .. }) => symbol,
            Some(Written::Unasked { symbol }) => {
                let name = self.core.borrow().name_of(id).to_owned();
                return self.halt(&format!(
                    "transition `{name}` wrote `{symbol}`, and no command waits for it"
                ));
            }
        };
        let Some(on_tape) = on_tape else { return };
        if let Some(net) = self.settings.forward.get(&symbol) {
            let transfer = Transfer {
                tokens: Vec::new(),
                symbol: Some((symbol.clone(), on_tape.arguments.clone())),
            };
            self.post_to(cx, &net.as_str().into(), &Arc::new(transfer));
        }
        let answer = self.core.borrow_mut().answer(&on_tape, symbol);
        if let Some((reply, answer)) = answer {
            self.when_stored(move |_| {
                // Answering never fails; a caller that is gone needs no answer.
                let _ = reply.ok(answer);
            });
        }
    }

    // -- data objects -----------------------------------------------------------------------

    /// Tells the store of data objects what became valid and invalid, concurrently with whatever goes on.
    fn tell_data(self: &Rc<Self>, cx: &Context) {
        if self.data.is_some() && !self.core.borrow().untold.is_empty() {
            let cx = cx.clone();
            self.when_stored(move |engine| {
                let (engine, own) = (Rc::clone(engine), engine.cx.clone());
                own.spawn(async move {
                    if let Err(error) = engine.told(&cx).await {
                        engine.halt(&format!(
                            "the store of data objects could not be told: {error}"
                        ));
                    }
                });
            });
        }
    }

    /// Ends when the store of data objects knows all that is stored here and was untold. All of it is
    /// sent at once, before anything that the caller sends after this.
    pub(super) async fn told(&self, cx: &Context) -> Acted {
        let stored = self.durable.stored();
        let untold: Vec<(u64, String, bool)> = {
            let mut core = self.core.borrow_mut();
            let ready = core
                .untold
                .partition_point(|(change, ..)| *change <= stored);
            core.untold.drain(..ready).collect()
        };
        let Some(store) = &self.data else {
            return Ok(());
        };
        let tell = untold
            .iter()
            .map(|(_, object, valid)| store.validity(cx, object, *valid));
        try_join_all(tell).await?;
        Ok(())
    }
}

impl Core {
    /// When somebody must wake up for the next clock, if nobody does so by then.
    fn next_alarm(&mut self) -> Option<u64> {
        let due_ns = self.race.next(&self.execution)?.due_ns;
        if self.alarm.is_some_and(|alarm| alarm <= due_ns) {
            return None;
        }
        self.alarm = Some(due_ns);
        Some(due_ns)
    }

    /// Number of the command in progress.
    fn in_progress(&self) -> Option<u64> {
        let current = self.execution.tape().current();
        current.map(|on_tape| on_tape.number)
    }

    /// The command that a firing of this transition answers if it writes: the one in progress, or the one
    /// that it reads itself.
    pub(super) fn at_hand(&self, id: TransitionId) -> Option<OnTape> {
        let transition = &self.execution.net()[id];
        transition.write.as_ref()?;
        let tape = self.execution.tape();
        tape.current().or_else(|| tape.waiting().next()).cloned()
    }

    /// A firing that has read a command from the tape, where `read` was the command before, belongs to
    /// what that command began. One that reads and answers in one step has read what it answers.
    fn take_up(&self, read: Option<u64>, written: Option<&Written>, cx: &mut Context) {
        let now = match (self.execution.tape().current(), written) {
            (Some(on_tape), _) => Some(on_tape.number),
            (None, Some(Written::Answer { command, .. })) => Some(*command),
            _ => None,
        };
        let begun = now.filter(|now| read != Some(*now));
        if let Some(of_command) = begun.and_then(|number| self.commands.get(&number)) {
            *cx = of_command.clone();
        }
    }
}
