//! A net in its task: between the pure execution and the runtime's messages and children. Handler
//! and children are on one processor and share it; nobody holds a borrow across a wait.
//!
//! Here is what comes in and how a net ends. Firing is in `firing.rs`, the second phase in `action.rs`,
//! what must be stored before others see it in `durable.rs`, transfers to other nets in `carry.rs`.

use std::{
    cell::{Cell, RefCell},
    collections::{BTreeMap, BTreeSet, VecDeque},
    rc::Rc,
    sync::Arc,
};

use ctos::{
    message::Replier,
    mix,
    task::{Context, Handled, HandlerError},
};

use super::{
    acting::Acting,
    carrying::Carrying,
    held::Durable,
    journal::Journal,
    manual::Manual,
    messages::{Output, PutOnce, PutTape, RequestId, Snapshot, TapeAnswer, Tokens, Transfer},
    once::{Known, Once},
    replacing::Replacing,
    requests::{BEING_STOPPED, Requests},
    routes::Routes,
    settings::Settings,
    transfers::Transfers,
    written::{Data, Drawn},
};
use crate::{
    library::{DataStore, Functions},
    store::Store,
    stream::{EventPhase, Happened, NetView, Source},
};
use pnt_language::{
    exec::{self, Conflicts, Execution, FireError, FiringId, OnTape, Race},
    net::{Net, PlaceId, TransitionId},
};

pub(super) struct Engine {
    pub(super) cx: Context,
    /// The net's name, which is its task's.
    pub(super) name: Arc<str>,
    pub(super) library: Functions,
    pub(super) data: Option<Rc<dyn DataStore>>,
    pub(super) settings: Settings,
    /// What displays and records get of the net once.
    pub(super) view: RefCell<NetView>,
    pub(super) core: RefCell<Core>,
    /// What waits until the changes that led to it are stored.
    pub(super) durable: Durable<Self>,
    /// Whether the app is about to be stopped.
    pub(super) stopping: Cell<bool>,
    /// What chance says, if actions and functions are stood in for.
    pub(super) stand_in: Option<RefCell<Drawn>>,
}

/// Who waits for the answer to a command.
pub(super) enum Asker {
    /// It asked with [`PutTape`].
    Plain(Replier<PutTape>),
    /// It asked with [`PutOnce`].
    Once(Replier<PutOnce>, RequestId),
}

impl Asker {
    pub(super) fn ok(self, answer: TapeAnswer) -> Handled {
        match self {
            Self::Plain(reply) => reply.ok(answer),
            Self::Once(reply, _) => reply.ok(answer),
        }
    }

    pub(super) fn fail(self, why: &str) -> Handled {
        match self {
            Self::Plain(reply) => reply.fail(why),
            Self::Once(reply, _) => reply.fail(why),
        }
    }

    fn is_abandoned(&self) -> bool {
        match self {
            Self::Plain(reply) => reply.is_abandoned(),
            Self::Once(reply, _) => reply.is_abandoned(),
        }
    }
}

pub(super) struct Core {
    pub(super) execution: Execution,
    /// Data that the net declares.
    pub(super) declared: Data,
    /// The clocks of timed transitions.
    pub(super) race: Race,
    /// When a child wakes up for the next of them, ns.
    pub(super) alarm: Option<u64>,
    pub(super) conflicts: Conflicts,
    pub(super) journal: Journal,
    pub(super) begun: bool,
    /// What the task says that it is at.
    pub(super) at: Option<String>,
    pub(super) halted: Option<String>,
    /// Who waits for which command's answer.
    pub(super) waiting: BTreeMap<u64, Asker>,
    /// Commands that may be asked for again.
    pub(super) once: Once,
    /// The contexts in which those commands came: what is fired for one belongs to its trace.
    pub(super) commands: BTreeMap<u64, Context>,
    /// What goes into the text of the next answer.
    pub(super) notes: Rc<RefCell<Vec<String>>>,
    /// What other nets get and got.
    pub(super) transfers: Transfers,
    pub(super) carrying: Carrying,
    pub(super) routes: Routes,
    /// The output tape: answers that nobody was there to take.
    pub(super) output: VecDeque<Output>,
    pub(super) outputs: u64,
    /// Data objects, their places, and the last news that their store got, if any.
    pub(super) objects: BTreeMap<String, (Vec<PlaceId>, Option<bool>)>,
    /// News that their store must get, with the change that it came with.
    pub(super) untold: Vec<(u64, String, bool)>,
    /// Failures in a row, per transition.
    pub(super) failures: Vec<u32>,
    /// Actions that are going on, to be ended by hand.
    pub(super) acting: BTreeMap<FiringId, Acting>,
    pub(super) manual: Manual,
    pub(super) replacing: Option<Replacing>,
    /// Requests of other nets (`serves`), and who waits for the net to be quiet.
    pub(super) requests: Requests,
    /// Counts the changes of all that is stored.
    pub(super) changes: u64,
}

impl Engine {
    pub(super) fn new(
        cx: Context,
        net: Arc<Net>,
        library: Functions,
        conflicts: Conflicts,
        data: Option<Rc<dyn DataStore>>,
        (settings, store): (Settings, Option<Arc<Store>>),
    ) -> Self {
        let name = Arc::from(net.name());
        let view = RefCell::new(NetView::new(&net));
        let execution = Execution::new(Arc::clone(&net));
        let race = Race::new(&execution, cx.rng("race"));
        let stand_in = settings.stand_in.is_some();
        let stand_in = stand_in.then(|| RefCell::new(Drawn::new(&cx)));
        Self {
            view,
            stand_in,
            stopping: Cell::new(false),
            core: RefCell::new(Core {
                conflicts,
                journal: Journal::new(Source::new(Arc::clone(&net), cx.now())),
                begun: false,
                at: None,
                halted: None,
                waiting: BTreeMap::new(),
                once: Once::default(),
                commands: BTreeMap::new(),
                notes: Rc::default(),
                transfers: Transfers::new(new_stream(&cx)),
                carrying: Carrying::default(),
                routes: Routes::new(&net),
                output: VecDeque::new(),
                outputs: 0,
                objects: objects_of(&net, Some(false)),
                untold: Vec::new(),
                failures: vec![0; net.transitions().len()],
                acting: BTreeMap::new(),
                manual: Manual::default(),
                replacing: None,
                requests: Requests::of(&net),
                changes: 0,
                race,
                alarm: None,
                declared: Data::new(&net),
                execution,
            }),
            cx,
            name,
            library,
            data,
            settings,
            durable: Durable::new(store),
        }
    }

    /// The net as it is now.
    pub(super) fn net(&self) -> Arc<Net> {
        Arc::clone(self.core.borrow().execution.net())
    }

    /// Nets that this one exchanges tokens with.
    pub(super) fn partners(&self) -> BTreeSet<String> {
        let net = self.net();
        let served = net.serves().iter().map(|side| side.net.as_str());
        let forwarded = self.settings.forward.values().map(String::as_str);
        let nets = net.remote_nets().into_iter().chain(served).chain(forwarded);
        nets.map(str::to_owned).collect()
    }

    // -- what comes in ----------------------------------------------------------------------

    /// Everybody is connected: fire.
    pub(super) fn begin(self: &Rc<Self>, cx: &Context) {
        // Who is linked hears of a death, also of a partner with whom no token was exchanged yet.
        for task in self.partners().iter().filter_map(|net| cx.app().task(net)) {
            let number = cx.chassis().number_of(&task.chassis);
            number.inspect(|number| _ = cx.chassis().reach(*number));
        }
        self.core.borrow_mut().begun = true;
        self.published(&mut self.core.borrow_mut(), cx);
        self.take_up_firings(cx);
        self.advance(cx);
    }

    pub(super) fn put_tape(
        self: &Rc<Self>,
        cx: &Context,
        (symbol, arguments): (String, Vec<String>),
        reply: Asker,
    ) -> Handled {
        {
            let mut core = self.core.borrow_mut();
            if let Some(why) = &core.halted {
                let name = core.execution.net().name();
                return reply.fail(&format!("net `{name}` takes no commands: {why}"));
            }
            if self.leaves_unanswered(&reply) {
                return Ok(());
            }
            if self.refuses(&reply) {
                let name = core.execution.net().name();
                return reply.fail(&format!("net `{name}` takes no commands: {BEING_STOPPED}"));
            }
            let number = core.put_command(&symbol, &arguments, self.settings.tape)?;
            if let Asker::Once(_, request) = &reply {
                core.once.put(number, request.clone(), symbol.clone());
            }
            let asked = Happened::Asked(symbol, arguments.join(" "));
            core.waiting.insert(number, reply);
            core.commands.insert(number, cx.clone());
            core.changed();
            self.note(&mut core, cx, asked);
        }
        self.advance(cx);
        Ok(())
    }

    /// Puts a command that may have been put before: then the asker waits for its answer, or gets it again.
    pub(super) fn put_once(
        self: &Rc<Self>,
        cx: &Context,
        request: PutOnce,
        reply: Replier<PutOnce>,
    ) -> Handled {
        let PutOnce {
            request,
            symbol,
            arguments,
        } = request;
        let known = self.core.borrow().once.known(&request, &symbol)?;
        match known {
            Known::New => self.put_tape(cx, (symbol, arguments), Asker::Once(reply, request)),
            Known::Open(number) => {
                let mut core = self.core.borrow_mut();
                let reply = Asker::Once(reply, request);
                if self.leaves_unanswered(&reply) {
                    return Ok(());
                }
                if let Some(why) = &core.halted {
                    return reply.fail(&format!("the net has stopped: {why}"));
                }
                core.waiting.insert(number, reply);
                core.commands.insert(number, cx.clone());
                Ok(())
            }
            Known::Answered(answer) => {
                self.when_stored(move |_| {
                    // Answering never fails; a caller that is gone asks again.
                    let _ = reply.ok(answer);
                });
                Ok(())
            }
        }
    }

    pub(super) fn put_tokens(
        self: &Rc<Self>,
        cx: &Context,
        message: Tokens,
        reply: Replier<Tokens>,
    ) -> Handled {
        let taken = {
            let mut core = self.core.borrow_mut();
            if let Some(why) = &core.halted {
                let name = core.execution.net().name();
                let text = format!("net `{name}` takes no tokens: {why}");
                return Err(HandlerError::new(text));
            }
            let note = |core: &mut Core, what| self.note(core, cx, what);
            core.receive(message, self.settings.tape, note)?
        };
        self.when_stored(move |_| {
            // Answering never fails; a sender that is gone asks again.
            let _ = reply.ok(taken);
        });
        self.advance(cx);
        Ok(())
    }

    /// Removes what its reader has from the output tape, and tells what is left.
    pub(super) fn read_tape(self: &Rc<Self>, taken: u64) -> Vec<Output> {
        let left = {
            let mut core = self.core.borrow_mut();
            let before = core.output.len();
            core.output.retain(|output| output.number > taken);
            if core.output.len() < before {
                core.changed();
            }
            core.output.iter().cloned().collect()
        };
        self.store_changes();
        left
    }

    pub(super) fn snapshot(&self) -> Snapshot {
        let core = self.core.borrow();
        let execution = &core.execution;
        let net = execution.net();
        let names = net.places().iter().map(|place| place.name.clone());
        let symbol = |on_tape: &OnTape| net[on_tape.command].symbol.clone();
        let sending = core.transfers.waiting();
        Snapshot {
            net: net.name().to_owned(),
            places: names.zip(execution.marking().iter().copied()).collect(),
            in_action: execution
                .running()
                .map(|(_, id)| net[id].name.clone())
                .collect(),
            tape: execution.tape().waiting().map(symbol).collect(),
            in_progress: execution.tape().current().map(symbol),
            halted: core.halted.clone(),
            firings: core.journal.ended(),
            events: core.journal.events(),
            paused: core.manual.paused().map(str::to_owned),
            output: core.output.iter().cloned().collect(),
            sending: sending
                .map(|(net, count)| {
                    (
                        net.as_ref().to_owned(),
                        u32::try_from(count).unwrap_or(u32::MAX),
                    )
                })
                .collect(),
            breakpoints: core.manual.breakpoints(),
            data: core.declared.shown(),
        }
    }

    /// Something went wrong: the net stops for good and tells everybody who waits for an answer.
    pub(super) fn halt(self: &Rc<Self>, why: &str) {
        if self.core.borrow().halted.is_none() {
            tracing::error!(target: "pnt::net", net = self.net().name(), why, "net halted");
            self.stop(why);
        }
    }

    /// The net fires no more; everybody who waits for an answer learns why.
    pub(super) fn stop(self: &Rc<Self>, why: &str) {
        let (name, waiting, replacing) = {
            let mut core = self.core.borrow_mut();
            if core.halted.is_some() {
                return;
            }
            core.halted = Some(why.to_owned());
            core.requests.look_again();
            let stopped = Happened::Net(EventPhase::Stopped, why.to_owned());
            self.note(&mut core, &self.cx, stopped);
            core.commands.clear();
            let name = core.execution.net().name().to_owned();
            let waiting = std::mem::take(&mut core.waiting);
            (name, waiting, core.replacing.take())
        };
        let text = format!("net `{name}` has stopped: {why}");
        // Answering never fails; a caller that is gone needs no answer.
        let waiting = waiting.into_values();
        for reply in waiting.filter(|reply| !self.leaves_unanswered(reply)) {
            let _ = reply.fail(&text);
        }
        if let Some(replacing) = replacing {
            let _ = replacing.reply.fail(&text);
        }
    }
}

/// A number that no other life of a net has used: of this task, in this process, at this moment.
pub(super) fn new_stream(cx: &Context) -> u64 {
    let started = cx.started_ns();
    let (tid, now) = (cx.tid().to_string(), cx.now().as_nanos().to_string());
    mix(started, &[cx.name(), &tid, &now])
}

/// The data objects of a net with their places.
pub(super) fn objects_of(
    net: &Net,
    told: Option<bool>,
) -> BTreeMap<String, (Vec<PlaceId>, Option<bool>)> {
    let mut objects: BTreeMap<String, (Vec<PlaceId>, Option<bool>)> = BTreeMap::new();
    for (place, id) in net.places().iter().zip((0..).map(PlaceId)) {
        let own = |object: &&String| net.declared().named(object).is_some();
        if let Some(object) = place.data.as_ref().filter(|object| !own(object)) {
            let entry = objects.entry(object.clone());
            entry.or_insert_with(|| (Vec::new(), told)).0.push(id);
        }
    }
    objects
}

impl Core {
    /// Something has changed that must be stored before others see what follows from it.
    #[inline]
    pub(super) fn changed(&mut self) {
        self.changes += 1;
        if !self.objects.is_empty() {
            self.note_validity();
        }
        if self.manual.has_breakpoints() {
            self.manual.watch_places(&self.execution);
        }
    }

    /// Whether the tapes have space for a command that some transition may read one day.
    pub(super) fn require_room(&self, symbol: &str, room: usize) -> Handled {
        let net = self.execution.net();
        let read = |command| net.transitions().iter().any(|t| t.tape == Some(command));
        if let Some(command) = net.command(symbol)
            && !read(command)
        {
            let readable = net.transitions().iter().filter_map(|t| t.tape);
            let readable: BTreeSet<&str> = readable.map(|id| net[id].symbol.as_str()).collect();
            let readable: Vec<&str> = readable.into_iter().collect();
            return Err(HandlerError::new(format!(
                "no transition of net `{}` ever reads `{symbol}`; it reads: {}",
                net.name(),
                readable.join(", ")
            )));
        }
        let waiting = self.execution.tape().waiting().count();
        if waiting >= room {
            return Err(HandlerError::new(format!(
                "the input tape of net `{}` is full: {waiting} commands wait on it; put `{symbol}` when some are done, or give the task a longer `tape`",
                net.name()
            )));
        }
        if self.output.len() >= room {
            return Err(HandlerError::new(format!(
                "the output tape of net `{}` is full: {} answers wait on it to be read (`read_tape`)",
                net.name(),
                self.output.len()
            )));
        }
        Ok(())
    }

    /// Puts a command on the tape if there is room; its number.
    fn put_command(
        &mut self,
        symbol: &str,
        arguments: &[String],
        room: usize,
    ) -> Result<u64, HandlerError> {
        self.require_room(symbol, room)?;
        Ok(self.execution.put_symbol(symbol, arguments.to_vec())?)
    }

    /// Takes what of a message is new, and notes each transfer; the number of the last one that is taken. A
    /// transfer for which there is no free capacity now is left, with those after it, for the sender to send again.
    fn receive(
        &mut self,
        message: Tokens,
        room: usize,
        mut note: impl FnMut(&mut Self, Happened),
    ) -> Result<u64, HandlerError> {
        let Tokens {
            from,
            stream,
            first,
            transfers,
        } = message;
        let known = self.transfers.known(&from, stream, first)?;
        let mut last = (first + known).saturating_sub(1);
        let skipped = usize::try_from(known).unwrap_or(usize::MAX);
        for transfer in transfers.into_iter().skip(skipped) {
            let put = match self.take_in(&transfer, room) {
                Ok(Some(put)) => put,
                Ok(None) => break,
                // The transfers before this one are taken. This one comes again, first in its message,
                // and is refused then.
                Err(_) if last >= first => break,
                Err(error) => return Err(error.into()),
            };
            last += 1;
            self.has_taken((&from, stream, last), (&transfer, put), &mut note);
        }
        Ok(last)
    }

    /// Counts and notes a transfer that was taken in, with where its tokens were put.
    fn has_taken(
        &mut self,
        (from, stream, number): (&Arc<str>, u64, u64),
        (transfer, put): (&Transfer, exec::Tokens),
        mut note: impl FnMut(&mut Self, Happened),
    ) {
        self.transfers.take(from, stream, number);
        self.requests.came(&put);
        self.changed();
        if let Some((symbol, with)) = &transfer.symbol {
            note(self, Happened::Asked(symbol.clone(), with.join(" ")));
        }
        if !put.is_empty() {
            let text = Arc::clone(from);
            note(self, Happened::Tokens(EventPhase::Received, put, text));
        }
    }

    /// Puts one transfer, all or nothing; the tokens, or nothing when a tape has no room for it.
    fn take_in(
        &mut self,
        transfer: &Transfer,
        room: usize,
    ) -> Result<Option<exec::Tokens>, FireError> {
        if let Some((symbol, arguments)) = &transfer.symbol {
            let accepted = self.execution.net().command(symbol).is_some();
            if accepted && self.require_room(symbol, room).is_err() {
                return Ok(None);
            }
            self.execution.put_symbol(symbol, arguments.clone())?;
        }
        self.execution.put_each(&transfer.tokens).map(Some)
    }

    /// A command has its answer: it goes to the waiting caller, or else to the output tape.
    pub(super) fn answer(
        &mut self,
        on_tape: &OnTape,
        symbol: String,
    ) -> Option<(Asker, TapeAnswer)> {
        let text = self.notes.take().join("\n");
        let declared = &self.execution.net()[on_tape.command].answers;
        let first = declared.first() == Some(&symbol);
        let answer = TapeAnswer {
            symbol,
            text,
            first,
        };
        self.commands.remove(&on_tape.number);
        let kept = self.once.answered(on_tape.number, &answer);
        let waiting = self.waiting.remove(&on_tape.number);
        if let Some(reply) = waiting.filter(|reply| !reply.is_abandoned()) {
            return Some((reply, answer));
        }
        if kept {
            return None;
        }
        self.outputs += 1;
        self.output.push_back(Output {
            number: self.outputs,
            command: self.execution.net()[on_tape.command].symbol.clone(),
            arguments: on_tape.arguments.clone(),
            answer,
        });
        None
    }

    /// Notes data objects whose validity has changed. An object is valid while its place is marked,
    /// and while an action goes on that took the token.
    fn note_validity(&mut self) {
        let net = self.execution.net();
        let marking = self.execution.marking().iter();
        let mut valid: Vec<bool> = marking.map(|tokens| *tokens > 0).collect();
        for (_, id) in self.execution.running() {
            for arc in &net[id].inputs {
                valid[arc.place.index()] = true;
            }
        }
        for (object, (places, told)) in &mut self.objects {
            let now = places.iter().any(|place| valid[place.index()]);
            if *told != Some(now) {
                *told = Some(now);
                self.untold.push((self.changes, object.clone(), now));
            }
        }
    }

    pub(super) fn name_of(&self, id: TransitionId) -> &str {
        self.execution.net()[id].written()
    }
}
