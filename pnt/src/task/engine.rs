//! A net in its task: between the pure execution and the runtime's messages and children. Handler
//! and children are on one processor and share it; nobody holds a borrow across a wait.

use std::{
    cell::RefCell,
    collections::{BTreeMap, VecDeque},
    rc::Rc,
    sync::Arc,
};

use ctos::{
    message::Replier,
    task::{Context, Handled, HandlerError},
};
use futures_util::future::try_join_all;

use super::{
    journal::{Journal, Phase},
    messages::{PutTape, Snapshot, TapeAnswer, Tokens},
};
use crate::{
    exec::{Conflicts, Execution, FireError, Written},
    library::{Acted, Action, CommandLine, DataStore, Library},
    net::{Net, PlaceId, RemoteArc, TransitionId},
    stream::{EventPhase, Happened, NetView, Source},
};

/// Firings without any action between them after which a net is taken to run in a circle.
const MOST_AT_ONCE: u32 = 100_000;

pub(super) struct Engine<S> {
    pub(super) cx: Context,
    pub(super) net: Arc<Net>,
    pub(super) library: Library<S>,
    data: Option<Rc<dyn DataStore>>,
    /// What displays and records are told of the net once.
    pub(super) view: NetView,
    pub(super) core: RefCell<Core>,
}

pub(super) struct Core {
    pub(super) execution: Execution,
    conflicts: Conflicts,
    pub(super) journal: Journal,
    begun: bool,
    halted: Option<String>,
    /// Who waits for which command's answer.
    waiting: BTreeMap<u64, Replier<PutTape>>,
    /// The contexts in which those commands came: what is fired for one belongs to its trace.
    commands: BTreeMap<u64, Context>,
    /// What goes into the text of the next answer.
    notes: Rc<RefCell<Vec<String>>>,
    /// Tokens on their way, per net; present while a child carries them.
    outboxes: BTreeMap<String, VecDeque<(Context, Tokens)>>,
    /// Data objects, their places, and what their store was told last.
    objects: BTreeMap<String, (Vec<PlaceId>, bool)>,
    /// What their store must be told.
    untold: Vec<(String, bool)>,
    /// Failures in a row, per transition.
    pub(super) failures: Vec<u32>,
}

impl<S: 'static> Engine<S> {
    pub(super) fn new(
        cx: Context,
        net: Net,
        library: Library<S>,
        conflicts: Conflicts,
        data: Option<Rc<dyn DataStore>>,
    ) -> Self {
        let net = Arc::new(net);
        let mut objects: BTreeMap<String, (Vec<PlaceId>, bool)> = BTreeMap::new();
        for place in net.places() {
            if let (Some(object), Some(id)) = (&place.data, net.place(&place.name)) {
                objects.entry(object.clone()).or_default().0.push(id);
            }
        }
        Self {
            core: RefCell::new(Core {
                execution: Execution::new(Arc::clone(&net)),
                conflicts,
                journal: Journal::new(Source::new(Arc::clone(&net), cx.now())),
                begun: false,
                halted: None,
                waiting: BTreeMap::new(),
                commands: BTreeMap::new(),
                notes: Rc::default(),
                outboxes: BTreeMap::new(),
                objects,
                untold: Vec::new(),
                failures: vec![0; net.transitions().len()],
            }),
            cx,
            view: NetView::new(&net),
            net,
            library,
            data,
        }
    }

    /// Nets that this one exchanges tokens with.
    pub(super) fn partners(&self) -> Vec<String> {
        let served = self.net.serves().iter().map(|side| side.net.as_str());
        let nets = self.net.remote_nets().into_iter().chain(served);
        nets.map(str::to_owned).collect()
    }

    // -- what comes in ----------------------------------------------------------------------

    /// Everybody is connected: fire.
    pub(super) fn begin(self: &Rc<Self>, cx: &Context) {
        self.core.borrow_mut().begun = true;
        self.published(&mut self.core.borrow_mut(), cx);
        self.advance(cx);
    }

    pub(super) fn put_tape(
        self: &Rc<Self>,
        cx: &Context,
        request: PutTape,
        reply: Replier<PutTape>,
    ) -> Handled {
        {
            let mut core = self.core.borrow_mut();
            if let Some(why) = &core.halted {
                return reply.fail(format!(
                    "net `{}` takes no commands: {why}",
                    self.net.name()
                ));
            }
            let arguments = request.arguments.join(" ");
            let number = core
                .execution
                .put_symbol(&request.symbol, request.arguments)?;
            let asked = Happened::Asked(request.symbol, arguments);
            self.note(&mut core, cx, asked);
            core.waiting.insert(number, reply);
            core.commands.insert(number, cx.clone());
        }
        self.advance(cx);
        Ok(())
    }

    pub(super) fn put_tokens(self: &Rc<Self>, cx: &Context, tokens: &Tokens) -> Handled {
        {
            let mut core = self.core.borrow_mut();
            if let Some(why) = &core.halted {
                let text = format!("net `{}` takes no tokens: {why}", self.net.name());
                return Err(HandlerError::new(text));
            }
            core.execution.put_all(&tokens.tokens)?;
            let put = tokens.tokens.iter();
            let put = put.filter_map(|(place, count)| Some((self.net.place(place)?, *count)));
            let put = Happened::Tokens(EventPhase::Received, put.collect(), tokens.from.clone());
            self.note(&mut core, cx, put);
        }
        self.advance(cx);
        Ok(())
    }

    pub(super) fn snapshot(&self) -> Snapshot {
        let core = self.core.borrow();
        let execution = &core.execution;
        let names = self.net.places().iter().map(|place| place.name.clone());
        let symbol = |on_tape: &crate::exec::OnTape| self.net[on_tape.command].symbol.clone();
        Snapshot {
            net: self.net.name().to_owned(),
            places: names.zip(execution.marking().iter().copied()).collect(),
            in_action: execution
                .running()
                .map(|(_, id)| self.net[id].name.clone())
                .collect(),
            tape: execution.tape().waiting().map(symbol).collect(),
            in_progress: execution.tape().current().map(symbol),
            halted: core.halted.clone(),
            firings: core.journal.ended(),
            events: core.journal.events(),
        }
    }

    /// Something went wrong: the net stops for good and tells everybody who waits for an answer.
    pub(super) fn halt(self: &Rc<Self>, why: &str) {
        if self.core.borrow().halted.is_none() {
            tracing::error!(target: "pnt::net", net = self.net.name(), why, "net halted");
            self.stop(why);
        }
    }

    /// The net fires no more; everybody who waits for an answer is told why.
    pub(super) fn stop(self: &Rc<Self>, why: &str) {
        let waiting = {
            let mut core = self.core.borrow_mut();
            if core.halted.is_some() {
                return;
            }
            core.halted = Some(why.to_owned());
            let stopped = Happened::Net(EventPhase::Stopped, why.to_owned());
            self.note(&mut core, &self.cx, stopped);
            core.commands.clear();
            std::mem::take(&mut core.waiting)
        };
        for reply in waiting.into_values() {
            // Answering never fails; a caller that is gone needs no answer.
            let _ = reply.fail(format!("net `{}` has stopped: {why}", self.net.name()));
        }
    }

    // -- firing -----------------------------------------------------------------------------

    /// Fires until nothing is enabled but what waits for actions, tokens or commands. All of it belongs
    /// to the trace of `cx`: of the message that made it possible; what a command on the tape begins, to
    /// that command's.
    pub(super) fn advance(self: &Rc<Self>, cx: &Context) {
        let mut cx = cx.clone();
        let mut at_once = 0;
        while let Some(id) = self.choose() {
            let fired = if self.net[id].action.is_some() {
                at_once = 0;
                self.start(id, &mut cx)
            } else {
                at_once += 1;
                self.fire(id, &mut cx)
            };
            if let Err(error) = fired {
                self.halt(&error.to_string());
            } else if at_once > MOST_AT_ONCE {
                let name = &self.net[id].name;
                self.halt(&format!(
                    "transitions such as `{name}` fire in a circle without any action"
                ));
            }
        }
        self.tell_data(&cx);
    }

    fn choose(self: &Rc<Self>) -> Option<TransitionId> {
        let mut unknown = None;
        let chosen = {
            let mut core = self.core.borrow_mut();
            let Core {
                execution,
                conflicts,
                begun,
                halted,
                ..
            } = &mut *core;
            if !*begun || halted.is_some() {
                return None;
            }
            execution.choose(conflicts, |when| {
                self.library.ask(&when.function).unwrap_or_else(|| {
                    unknown = Some(when.function.clone());
                    false
                })
            })
        };
        if let Some(function) = unknown {
            self.halt(&format!(
                "its library has no enabling function `{function}`"
            ));
            return None;
        }
        chosen
    }

    fn fire(self: &Rc<Self>, id: TransitionId, cx: &mut Context) -> Result<(), FireError> {
        let mut core = self.core.borrow_mut();
        let read = core
            .execution
            .tape()
            .current()
            .map(|on_tape| on_tape.number);
        let effects = core.execution.fire(id)?;
        let (remote, written) = (effects.remote.to_vec(), effects.written);
        core.take_up(read, written.as_ref(), cx);
        let phase = Phase {
            transition: id,
            firing: None,
            phase: EventPhase::Fired,
            text: "",
        };
        self.log(&mut core, cx, &phase);
        drop(core);
        self.carry_out(cx, id, &remote, written);
        Ok(())
    }

    fn start(self: &Rc<Self>, id: TransitionId, cx: &mut Context) -> Result<(), FireError> {
        let mut core = self.core.borrow_mut();
        let read = core
            .execution
            .tape()
            .current()
            .map(|on_tape| on_tape.number);
        let firing = core.execution.start(id)?;
        core.take_up(read, None, cx);
        let phase = Phase {
            transition: id,
            firing: Some(firing),
            phase: EventPhase::Started,
            text: "",
        };
        self.log(&mut core, cx, &phase);
        let command = core.execution.tape().current().map(|on_tape| CommandLine {
            symbol: self.net[on_tape.command].symbol.clone(),
            arguments: on_tape.arguments.clone(),
        });
        let action = Action {
            cx: cx.clone(),
            state: Rc::clone(&self.library.state),
            transition: self.net[id].name.as_str().into(),
            data: self.data.clone(),
            // Without a command there will be no answer that takes the notes away.
            notes: match &command {
                Some(_) => Rc::clone(&core.notes),
                None => Rc::default(),
            },
            command,
        };
        drop(core);
        let engine = Rc::clone(self);
        self.cx
            .spawn(async move { engine.act(id, firing, action).await });
        Ok(())
    }

    pub(super) fn log(self: &Rc<Self>, core: &mut Core, cx: &Context, phase: &Phase) {
        let Core {
            journal, execution, ..
        } = core;
        journal.firing(cx.now(), cx.trace(), execution, phase);
        self.published(core, cx);
        core.note_validity(&self.net);
    }

    /// Hands out what a firing leaves to be done.
    pub(super) fn carry_out(
        self: &Rc<Self>,
        cx: &Context,
        id: TransitionId,
        remote: &[RemoteArc],
        written: Option<Written>,
    ) {
        self.post(cx, remote);
        match written {
            None => {}
            Some(Written::Answer { command, symbol }) => {
                let mut core = self.core.borrow_mut();
                let text = core.notes.take().join("\n");
                let reply = core.waiting.remove(&command);
                core.commands.remove(&command);
                drop(core);
                if let Some(reply) = reply {
                    // Answering never fails; a caller that is gone needs no answer.
                    let _ = reply.ok(TapeAnswer { symbol, text });
                }
            }
            Some(Written::Unasked { symbol }) => {
                let name = &self.net[id].name;
                self.halt(&format!(
                    "transition `{name}` wrote `{symbol}`, and no command waits for it"
                ));
            }
        }
    }

    // -- tokens for other nets --------------------------------------------------------------

    /// Puts tokens into the outboxes of their nets: one message for each net, so that tokens of one
    /// firing arrive together. One child per net carries them, in order.
    fn post(self: &Rc<Self>, cx: &Context, remote: &[RemoteArc]) {
        let mut per_net: BTreeMap<&str, Vec<(String, u32)>> = BTreeMap::new();
        for arc in remote {
            let tokens = per_net.entry(&arc.net).or_default();
            tokens.push((arc.place.clone(), arc.weight));
        }
        let mut core = self.core.borrow_mut();
        for (net, tokens) in per_net {
            let message = Tokens {
                from: self.net.name().to_owned(),
                tokens,
            };
            if let Some(outbox) = core.outboxes.get_mut(net) {
                outbox.push_back((cx.clone(), message));
                continue;
            }
            core.outboxes
                .insert(net.to_owned(), VecDeque::from([(cx.clone(), message)]));
            let engine = Rc::clone(self);
            let net = net.to_owned();
            self.cx.spawn(async move { engine.carry(net).await });
        }
    }

    /// Carries tokens to one net until its outbox is empty.
    async fn carry(self: Rc<Self>, net: String) {
        loop {
            let next = {
                let mut core = self.core.borrow_mut();
                let next = core.outboxes.get_mut(&net).and_then(VecDeque::pop_front);
                if next.is_none() {
                    core.outboxes.remove(&net);
                }
                next
            };
            let Some((cx, tokens)) = next else { return };
            if let Err(error) = deliver(&cx, &net, tokens).await {
                self.halt(&format!(
                    "a token could not be carried to net `{net}`: {error}"
                ));
                return;
            }
        }
    }

    // -- data objects -----------------------------------------------------------------------

    /// Tells the store of data objects what became valid and invalid, beside whatever goes on.
    fn tell_data(self: &Rc<Self>, cx: &Context) {
        if self.data.is_some() && !self.core.borrow().untold.is_empty() {
            let (engine, cx) = (Rc::clone(self), cx.clone());
            self.cx.spawn(async move {
                if let Err(error) = engine.told(&cx).await {
                    engine.halt(&format!(
                        "the store of data objects could not be told: {error}"
                    ));
                }
            });
        }
    }

    /// Ends when the store knows all that was untold. All of it is sent at once, before anything that
    /// the caller sends after this.
    pub(super) async fn told(&self, cx: &Context) -> Acted {
        let untold = std::mem::take(&mut self.core.borrow_mut().untold);
        let Some(store) = &self.data else {
            return Ok(());
        };
        let tell = untold
            .iter()
            .map(|(object, valid)| store.validity(cx, object, *valid));
        try_join_all(tell).await?;
        Ok(())
    }
}

async fn deliver(cx: &Context, net: &str, tokens: Tokens) -> Acted {
    let to = cx.task(net).await?;
    Ok(cx.call(&to, tokens).await?)
}

impl Core {
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

    /// Notes data objects whose validity has changed. An object is valid while its place is marked,
    /// and while an action goes on that took the token.
    fn note_validity(&mut self, net: &Net) {
        if self.objects.is_empty() {
            return;
        }
        let mut valid: Vec<bool> = self
            .execution
            .marking()
            .iter()
            .map(|tokens| *tokens > 0)
            .collect();
        for (_, id) in self.execution.running() {
            for arc in &net[id].inputs {
                valid[arc.place.index()] = true;
            }
        }
        for (object, (places, told)) in &mut self.objects {
            let now = places.iter().any(|place| valid[place.index()]);
            if now != *told {
                *told = now;
                self.untold.push((object.clone(), now));
            }
        }
    }
}
