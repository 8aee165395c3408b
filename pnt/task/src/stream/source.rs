//! The end of the stream in the net's task: the latest events in a short form, and the followers that
//! wait for the next ones. It keeps their [`Replier`]s and answers them, but reads no clock and sets no
//! timer. The task says what time it is and when to answer.

use std::{collections::BTreeMap, sync::Arc, time::Duration};

use ctos::{message::Replier, record::Number, time::Instant};
use thiserror::Error;

use super::{
    Batch, Event, EventPhase, Follow, MOST_EVENTS, MOST_FOLLOWERS, MOST_PATIENCE_MS, Mark, Running,
    Sent, State, view,
};
use pnt_language::{
    data::Value,
    exec::{Execution, FiringId, OnTape, Tokens},
    net::{self, Net, PlaceId, TransitionId},
};

/// Events that are kept, for followers that are a little behind.
const KEPT: usize = 4 * MOST_EVENTS;

/// The least time between two answers to those who follow: for one display, and more for each further
/// one. So what many displays cost together is bounded too.
const INTERVAL: Duration = Duration::from_millis(4);
const INTERVAL_EACH: Duration = Duration::from_millis(1);

/// Where the event of a number is kept, in the place of the one that is too old by then.
fn place(seq: u64) -> usize {
    let place = seq.wrapping_sub(1) % KEPT as u64;
    usize::try_from(place).unwrap_or(usize::MAX)
}

/// What is kept of an event: the net says the rest.
#[derive(Debug, Clone)]
struct Kept {
    at_ns: u64,
    trace: u64,
    what: Happened,
    /// Whether a symbol that was read went back to the front of the tape.
    unread: bool,
    /// What reset arcs took.
    emptied: Tokens,
}

/// Values of declared data that have changed, by number.
pub(crate) type Changed = Vec<(usize, Value)>;

/// What happened.
#[derive(Debug, Clone)]
pub(crate) enum Happened {
    /// To a transition, in one of its firings, why, and what declared data has become.
    Transition(TransitionId, EventPhase, Option<FiringId>, String, Changed),
    /// To the tokens of places alone, and who did it.
    Tokens(EventPhase, Tokens, Arc<str>),
    /// A symbol came, with arguments.
    Asked(String, String),
    /// To the net, and why.
    Net(EventPhase, String),
}

/// How far a stream had come when a commit began: what followers may see when it has ended.
pub(crate) struct Reached {
    mark: Mark,
    whole: Option<Box<State>>,
}

/// As many follow a net as may.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
#[error("net `{0}` is followed by {MOST_FOLLOWERS} displays already")]
pub(crate) struct TooManyFollowers(String);

struct Follower {
    after: Option<Mark>,
    until: Instant,
    reply: Replier<Follow>,
}

/// The stream of one net's task.
pub(crate) struct Source {
    net: Arc<Net>,
    run: u64,
    seq: u64,
    /// The latest events, each at its [`place`].
    kept: Vec<Kept>,
    since: BTreeMap<FiringId, u64>,
    ended: Vec<u64>,
    failed: Vec<u64>,
    busy_ns: Vec<u64>,
    paused: Option<String>,
    stopped: Option<String>,
    /// The command in progress after the latest event.
    current: Option<u64>,
    /// The marking after the latest event; kept where there are reset arcs only.
    marking: Vec<u32>,
    /// Declared data after the latest event.
    values: Vec<Value>,
    resets: bool,
    /// Number of the latest event that followers may see: of those after it a crash could still undo
    /// what they tell.
    shown: u64,
    /// The net as it was after that event, where it was asked for.
    whole: Option<Box<State>>,
    followers: Vec<Follower>,
    /// When followers were answered last.
    answered: Option<Instant>,
    /// Whether somebody is on the way to answer.
    called: bool,
    /// Whether somebody watches over the patience of followers.
    watched: bool,
}

impl Source {
    /// The stream of a task that begins now.
    pub(crate) fn new(net: Arc<Net>, now: Instant) -> Self {
        let count = net.transitions().len();
        let resets = net.transitions().iter().any(|one| !one.resets.is_empty());
        let marking = net.places().iter().map(|place| place.tokens).collect();
        let values = net.declared().initial();
        Self {
            net,
            run: now.as_nanos(),
            seq: 0,
            kept: Vec::new(),
            since: BTreeMap::new(),
            ended: vec![0; count],
            failed: vec![0; count],
            busy_ns: vec![0; count],
            paused: None,
            stopped: None,
            current: None,
            marking,
            values,
            resets,
            shown: 0,
            whole: None,
            followers: Vec::new(),
            answered: None,
            called: false,
            watched: false,
        }
    }

    /// Begins a new stream, of a net that is put in place of this one or goes on where it was. Followers
    /// get its whole state.
    pub(crate) fn begin_again(&mut self, now: Instant, execution: &Execution, values: &[Value]) {
        let mut begun = Self::new(Arc::clone(execution.net()), now);
        begun.run = now.as_nanos().max(self.run + 1);
        begun.marking = execution.marking().to_vec();
        begun.values = values.to_vec();
        begun.current = execution.tape().current().map(|on_tape| on_tape.number);
        begun.paused = self.paused.take();
        begun.followers = std::mem::take(&mut self.followers);
        begun.answered = self.answered;
        begun.called = self.called;
        begun.watched = self.watched;
        *self = begun;
    }

    /// Firings that ended, well or not.
    pub(crate) fn firings(&self) -> u64 {
        self.ended.iter().chain(&self.failed).sum()
    }

    /// Notes an event, after which the net is as `execution`.
    pub(crate) fn note(&mut self, now: Instant, trace: u64, what: Happened, execution: &Execution) {
        let at_ns = now.as_nanos();
        let current = execution.tape().current().map(|on_tape| on_tape.number);
        let unread = self.current.is_some()
            && current.is_none()
            && matches!(
                what,
                Happened::Transition(_, EventPhase::Failed | EventPhase::Cancelled, ..)
            );
        self.current = current;
        let emptied = self.emptied(&what, execution);
        match &what {
            Happened::Transition(id, phase, firing, _, changed) => {
                self.count(*id, *phase, *firing, at_ns);
                for (slot, value) in changed {
                    if let Some(there) = self.values.get_mut(*slot) {
                        there.clone_from(value);
                    }
                }
            }
            Happened::Net(EventPhase::Paused, why) => self.paused = Some(why.clone()),
            Happened::Net(EventPhase::Resumed, _) => self.paused = None,
            Happened::Net(EventPhase::Stopped, why) => self.stopped = Some(why.clone()),
            _ => {}
        }
        let event = Kept {
            at_ns,
            trace,
            what,
            unread,
            emptied,
        };
        self.seq += 1;
        match self.kept.get_mut(place(self.seq)) {
            Some(oldest) => *oldest = event,
            None => self.kept.push(event),
        }
    }

    /// What the reset arcs of a transition took.
    #[inline]
    fn emptied(&mut self, what: &Happened, execution: &Execution) -> Tokens {
        if !self.resets {
            return Tokens::new();
        }
        let before = std::mem::replace(&mut self.marking, execution.marking().to_vec());
        let Happened::Transition(id, EventPhase::Fired | EventPhase::Started, ..) = what else {
            return Tokens::new();
        };
        let one = &self.net[*id];
        let taken = |place: PlaceId| -> u32 {
            let of_place = one.inputs.iter().filter(|arc| arc.place == place);
            of_place.map(|arc| arc.weight).sum()
        };
        let left = |place: &PlaceId| {
            let held = before.get(place.index()).copied().unwrap_or(0);
            (*place, held.saturating_sub(taken(*place)))
        };
        let resets = one.resets.iter().map(left);
        resets.filter(|(_, tokens)| *tokens > 0).collect()
    }

    fn count(&mut self, id: TransitionId, phase: EventPhase, firing: Option<FiringId>, now: u64) {
        if let Some(firing) = firing {
            if phase == EventPhase::Started {
                self.since.insert(firing, now);
            } else if let Some(since) = self.since.remove(&firing)
                && let Some(busy) = self.busy_ns.get_mut(id.index())
            {
                *busy += now.saturating_sub(since);
            }
        }
        let counted = match phase {
            EventPhase::Fired | EventPhase::Completed => self.ended.get_mut(id.index()),
            EventPhase::Failed => self.failed.get_mut(id.index()),
            _ => None,
        };
        if let Some(counted) = counted {
            *counted += 1;
        }
    }

    /// The latest events, at most `most`, oldest first.
    pub(crate) fn latest(&self, most: usize) -> impl Iterator<Item = Event> {
        self.from(self.kept.len().saturating_sub(most))
    }

    pub(crate) fn last(&self) -> Option<Event> {
        self.latest(1).last()
    }

    /// The kept events from the `index`th on.
    fn from(&self, index: usize) -> impl Iterator<Item = Event> {
        let first = self.seq + 1 - self.kept.len() as u64;
        let seqs = first + index as u64..=self.seq;
        seqs.filter_map(|seq| Some(self.event(seq, self.kept.get(place(seq))?)))
    }

    pub(crate) fn state(&self, now: Instant, execution: &Execution) -> State {
        let symbol = |on_tape: &OnTape| self.net[on_tape.command].symbol.clone();
        State {
            net: self.net.name().to_owned(),
            seq: self.seq,
            at_ns: now.as_nanos(),
            places: execution.marking().to_vec(),
            running: execution
                .running()
                .map(|(firing, id)| Running {
                    transition: self.net[id].name.clone(),
                    firing: firing.number(),
                    since_ns: self.since.get(&firing).copied().unwrap_or(now.as_nanos()),
                })
                .collect(),
            tape: execution.tape().waiting().map(symbol).collect(),
            in_progress: execution.tape().current().map(symbol),
            ended: self.ended.clone(),
            failed: self.failed.clone(),
            busy_ns: self.busy_ns.clone(),
            paused: self.paused.clone(),
            stopped: self.stopped.clone(),
            data: self.values.iter().map(Value::to_string).collect(),
        }
    }

    // -- what followers may see ---------------------------------------------------------------

    /// All events so far may be seen.
    #[inline]
    pub(crate) fn show_all(&mut self) {
        self.shown = self.seq;
        self.whole = None;
    }

    /// How far it has come, for [`Self::show`]. The net as a whole goes along if somebody waits for it.
    pub(crate) fn reached(&self, now: Instant, execution: &Execution) -> Reached {
        let mark = Mark {
            run: self.run,
            seq: self.seq,
        };
        let mut followers = self.followers.iter();
        let wanted = followers.any(|one| self.behind(one, self.seq).is_err());
        let whole = wanted.then(|| Box::new(self.state(now, execution)));
        Reached { mark, whole }
    }

    /// The events up to `reached` may be seen.
    pub(crate) fn show(&mut self, reached: Reached) {
        // Those of a stream that has begun again since are gone.
        if reached.mark.run == self.run {
            self.shown = reached.mark.seq;
            self.whole = reached.whole;
        }
    }

    /// How many events a follower is behind one of them; or, when it needs the net as a whole, how many
    /// it has missed.
    fn behind(&self, one: &Follower, seq: u64) -> Result<usize, u64> {
        let behind = one
            .after
            .filter(|mark| mark.run == self.run)
            .and_then(|mark| seq.checked_sub(mark.seq));
        let behind = behind.ok_or(0_u64)?;
        let kept = (self.kept.len() as u64).saturating_sub(self.seq.saturating_sub(seq));
        if behind <= (MOST_EVENTS as u64).min(kept) {
            return usize::try_from(behind).map_err(|_| behind);
        }
        Err(behind)
    }

    // -- those who follow -------------------------------------------------------------------

    /// Whether one more may follow.
    ///
    /// # Errors
    /// [`TooManyFollowers`].
    pub(crate) fn may_be_followed(&self) -> Result<(), TooManyFollowers> {
        if self.followers.len() < MOST_FOLLOWERS {
            return Ok(());
        }
        Err(TooManyFollowers(self.net.name().to_owned()))
    }

    /// Takes in one who follows; it is answered by [`Self::answer`].
    pub(crate) fn follow(&mut self, now: Instant, request: &Follow, reply: Replier<Follow>) {
        let patience = request.patience_ms.min(MOST_PATIENCE_MS);
        self.followers.push(Follower {
            after: request.after,
            until: now + Duration::from_millis(patience.into()),
            reply,
        });
    }

    /// When the followers are to be answered, if there is something to answer and no answer is under
    /// way. Then the caller has to answer them.
    pub(crate) fn call(&mut self, now: impl FnOnce() -> Instant) -> Option<Instant> {
        if self.called || self.followers.is_empty() {
            return None;
        }
        let here = self.mark();
        let news = |one: &Follower| one.after != Some(here);
        if !self.followers.iter().any(news) {
            return None;
        }
        self.called = true;
        let now = now();
        let further = u32::try_from(self.followers.len() - 1).unwrap_or(u32::MAX);
        let interval = INTERVAL + INTERVAL_EACH.saturating_mul(further);
        let at = self.answered.map_or(now, |last| last + interval);
        Some(if at < now { now } else { at })
    }

    /// Whether somebody must begin to watch over the patience of those who follow.
    pub(crate) fn watch(&mut self) -> bool {
        !std::mem::replace(&mut self.watched, true)
    }

    /// Answers those whose patience is over; whether there are others left to watch over.
    pub(crate) fn expire(&mut self, now: Instant) -> bool {
        let (over, left) = std::mem::take(&mut self.followers)
            .into_iter()
            .partition(|one: &Follower| one.until <= now);
        self.followers = left;
        for one in over {
            let batch = Batch {
                mark: one.after.unwrap_or(self.mark()),
                state: None,
                skipped: 0,
                events: Arc::default(),
            };
            // Answering never fails; a display that is gone needs no answer.
            let _ = one.reply.ok(batch);
        }
        self.watched = !self.followers.is_empty();
        self.watched
    }

    /// Answers the followers for which there is something new. A follower that needs the net as a whole
    /// waits for a state that may be seen. That is the present one, if it is `settled`, or that of the
    /// latest commit.
    pub(crate) fn answer(&mut self, now: Instant, execution: &Execution, settled: bool) {
        if settled {
            self.show_all();
        }
        self.called = false;
        self.answered = Some(now);
        let here = self.mark();
        let mut shared: BTreeMap<usize, Batch> = BTreeMap::new();
        let present = || Box::new(self.state(now, execution));
        let whole = self.whole.clone().or_else(|| settled.then(present));
        let hidden = self.seq - self.shown;
        for one in std::mem::take(&mut self.followers) {
            if one.after == Some(here) {
                self.followers.push(one);
                continue;
            }
            let batch = match (self.behind(&one, self.shown), &whole) {
                (Ok(behind), _) => shared
                    .entry(behind)
                    .or_insert_with(|| Batch {
                        mark: here,
                        state: None,
                        skipped: 0,
                        events: Arc::new(self.until(hidden, behind).collect()),
                    })
                    .clone(),
                (Err(skipped), Some(state)) => Batch {
                    mark: here,
                    state: Some(State::clone(state)),
                    skipped,
                    events: Arc::default(),
                },
                (Err(_), None) => {
                    self.followers.push(one);
                    continue;
                }
            };
            // Answering never fails; a display that is gone needs no answer.
            let _ = one.reply.ok(batch);
        }
    }

    /// The latest `count` events but for the last `hidden` ones.
    fn until(&self, hidden: u64, count: usize) -> impl Iterator<Item = Event> {
        let hidden = usize::try_from(hidden).unwrap_or(usize::MAX);
        let first = self.kept.len().saturating_sub(hidden.saturating_add(count));
        self.from(first).take(count)
    }

    /// How far followers may see.
    fn mark(&self) -> Mark {
        Mark {
            run: self.run,
            seq: self.shown,
        }
    }

    // -- from the short form to the whole one ------------------------------------------------

    fn event(&self, seq: u64, kept: &Kept) -> Event {
        let net = &*self.net;
        let mut event = Event {
            seq,
            at_ns: kept.at_ns,
            net: net.name().to_owned(),
            transition: String::new(),
            phase: EventPhase::Stopped,
            text: String::new(),
            firing: None,
            consumed: Vec::new(),
            produced: Vec::new(),
            sent: Vec::new(),
            read: None,
            wrote: None,
            target: String::new(),
            trace: trace(kept.trace),
            data: Vec::new(),
        };
        match &kept.what {
            Happened::Transition(id, phase, firing, text, changed) => {
                event.phase = *phase;
                event.text.clone_from(text);
                event.firing = firing.map(FiringId::number);
                let slots = &net.declared().slots;
                let named = |(slot, value): &(usize, Value)| {
                    let name = slots.get(*slot)?.name.clone();
                    Some((name, value.to_string()))
                };
                event.data = changed.iter().filter_map(named).collect();
                fill(net, &net[*id], &mut event);
                let named = |(id, count): &(PlaceId, u32)| (net[*id].name.clone(), *count);
                event.consumed.extend(kept.emptied.iter().map(named));
                if kept.unread {
                    event.read = net[*id].tape.map(|id| net[id].symbol.clone());
                }
            }
            Happened::Tokens(phase, tokens, text) => {
                event.phase = *phase;
                event.text = text.as_ref().to_owned();
                let tokens = tokens
                    .iter()
                    .map(|(id, count)| (net[*id].name.clone(), *count));
                if *phase == EventPhase::Taken {
                    event.consumed = tokens.collect();
                } else {
                    event.produced = tokens.collect();
                }
            }
            Happened::Asked(symbol, arguments) => {
                event.phase = EventPhase::Asked;
                event.read = Some(symbol.clone());
                event.text.clone_from(arguments);
            }
            Happened::Net(phase, text) => {
                event.phase = *phase;
                event.text.clone_from(text);
            }
        }
        event
    }
}

/// What the phase of a transition moves, which the net says.
fn fill(net: &Net, one: &net::Transition, event: &mut Event) {
    let tokens = |arcs: &[net::Arc]| -> Vec<(String, u32)> {
        let named = |arc: &net::Arc| (net[arc.place].name.clone(), arc.weight);
        arcs.iter().map(named).collect()
    };
    let sent = |arcs: &[net::RemoteArc]| -> Vec<Sent> {
        let sent = |arc: &net::RemoteArc| Sent {
            net: arc.net.clone(),
            place: arc.place.clone(),
            tokens: arc.weight,
        };
        arcs.iter().map(sent).collect()
    };
    event.transition.clone_from(&one.name);
    event.target = view::target(one.action.as_ref());
    let (starts, ends) = match event.phase {
        EventPhase::Fired => (true, true),
        EventPhase::Started => (true, false),
        _ => (false, true),
    };
    if starts {
        event.consumed = tokens(&one.inputs);
        event.read = one.tape.map(|id| net[id].symbol.clone());
    }
    if ends {
        let back;
        let outputs = match (event.phase, &one.fail) {
            (EventPhase::Fired | EventPhase::Completed, _) => {
                event.wrote.clone_from(&one.write);
                &one.outputs
            }
            (EventPhase::Failed, Some(branch)) => branch,
            _ => {
                back = net::Outputs {
                    local: one.inputs.clone(),
                    remote: Vec::new(),
                };
                &back
            }
        };
        event.produced = tokens(&outputs.local);
        event.sent = sent(&outputs.remote);
    }
}

fn trace(trace: u64) -> String {
    if trace == 0 {
        String::new()
    } else {
        Number::of_trace(trace).to_string()
    }
}
