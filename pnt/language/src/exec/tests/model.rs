//! Random nets and random events, beside a naive model that follows the definitions and shares no code
//! with the executor. No token is lost or made, and nothing is enabled that should not be.

use std::collections::BTreeMap;

use super::{random_nets::weights, *};
use crate::net::{Net, Transition};

/// Places of a random net.
const PLACES: usize = 5;

#[derive(Debug, Clone)]
struct RandomTransition {
    inputs: Vec<u8>,
    outputs: Vec<u8>,
    reads: u8,
    inhibits: u8,
    resets: u8,
    tape: u8,
    action: bool,
    fail: Option<u8>,
    servers: u8,
    write: u8,
    within: bool,
}

fn random_transition() -> impl Strategy<Value = RandomTransition> {
    (
        (weights(), weights(), 0_u8..12, 0_u8..12, 0_u8..14, 0_u8..8),
        (
            any::<bool>(),
            prop::option::of(0_u8..5),
            0_u8..6,
            0_u8..6,
            any::<bool>(),
        ),
    )
        .prop_map(
            |(
                (inputs, outputs, reads, inhibits, resets, tape),
                (action, fail, servers, write, within),
            )| {
                RandomTransition {
                    inputs,
                    outputs,
                    reads,
                    inhibits,
                    resets,
                    tape,
                    action,
                    fail,
                    servers,
                    write,
                    within,
                }
            },
        )
        .prop_filter("an input", |t| {
            t.tape < 2 || t.inputs.iter().any(|weight| *weight > 0)
        })
}

fn text(capacities: &[u8], transitions: &[RandomTransition]) -> String {
    use std::fmt::Write as _;
    let mut text = String::from("net r\ncommand c0 -> a0, a1\ncommand c1 -> a1\n");
    for (index, capacity) in capacities.iter().enumerate() {
        let tokens = [3, 2, 1, 0, 0][index];
        let _ = write!(text, "place p{index} = {tokens}");
        if (3..8).contains(capacity) {
            let _ = write!(text, " capacity {capacity}");
        }
        text.push('\n');
    }
    let list = |weights: &[u8]| -> String {
        let arcs = weights
            .iter()
            .enumerate()
            .filter(|(_, weight)| **weight > 0);
        let arcs: Vec<String> = arcs.map(|(p, weight)| format!("p{p}*{weight}")).collect();
        arcs.join(", ")
    };
    for (index, t) in transitions.iter().enumerate() {
        let _ = writeln!(text, "transition t{index}");
        for (keyword, arcs) in [("in", list(&t.inputs)), ("out", list(&t.outputs))] {
            if !arcs.is_empty() {
                let _ = writeln!(text, "  {keyword} {arcs}");
            }
        }
        for (keyword, place) in [("read", t.reads), ("inhibit", t.inhibits)] {
            if usize::from(place) < PLACES {
                let _ = writeln!(text, "  {keyword} p{place}*2");
            }
        }
        if usize::from(t.resets) < PLACES {
            let _ = writeln!(text, "  reset p{}", t.resets);
        }
        if t.tape < 2 {
            let _ = writeln!(text, "  tape c{}", t.tape);
        }
        if t.write < 2 {
            let _ = writeln!(text, "  write a{}", t.write);
        }
        if t.action {
            text.push_str("  do something\n");
            if let Some(place) = t.fail {
                let _ = writeln!(text, "  fail p{place}*2");
            }
            if t.servers > 0 && t.servers < 3 {
                let _ = writeln!(text, "  servers {}", t.servers);
            }
            if t.within {
                text.push_str("  within 1 ms\n");
            }
        }
    }
    text
}

#[derive(Debug, Clone, PartialEq)]
struct Going {
    number: u64,
    transition: usize,
    command: Option<u64>,
    limit: Option<u64>,
}

/// A state by the definitions: everything looked up afresh, nothing kept up incrementally.
#[derive(Debug, Clone, PartialEq)]
struct Model {
    tokens: Vec<u64>,
    going: Vec<Going>,
    waiting: Vec<(u64, usize)>,
    current: Option<(u64, usize)>,
    commands: u64,
    firings: u64,
    now: u64,
}

type Tokens = BTreeMap<usize, u64>;

fn sum(arcs: &[crate::net::Arc]) -> Tokens {
    let mut sums = Tokens::new();
    for arc in arcs {
        *sums.entry(arc.place.index()).or_default() += u64::from(arc.weight);
    }
    sums
}

fn of(tokens: &Tokens, place: usize) -> u64 {
    tokens.get(&place).copied().unwrap_or(0)
}

impl Model {
    fn new(net: &Net) -> Self {
        Self {
            tokens: net
                .places()
                .iter()
                .map(|place| u64::from(place.tokens))
                .collect(),
            going: Vec::new(),
            waiting: Vec::new(),
            current: None,
            commands: 0,
            firings: 0,
            now: 0,
        }
    }

    /// The most that an end of a transition's firing may put into a place.
    fn promise(transition: &Transition, place: usize) -> u64 {
        let fail = transition.fail.as_ref();
        let fail = fail.map_or(0, |branch| of(&sum(&branch.local), place));
        let complete = of(&sum(&transition.outputs.local), place);
        complete.max(fail).max(of(&sum(&transition.inputs), place))
    }

    fn promised(&self, net: &Net, place: usize) -> u64 {
        let of = |going: &Going| Self::promise(&net.transitions()[going.transition], place);
        self.going.iter().map(of).sum()
    }

    fn enabled(&self, net: &Net, index: usize) -> bool {
        let t = &net.transitions()[index];
        let takes = sum(&t.inputs);
        let holds = |arc: &crate::net::Arc| self.tokens[arc.place.index()] >= u64::from(arc.weight);
        let fits = |place: usize| {
            let Some(capacity) = net.places()[place].capacity else {
                return true;
            };
            let mut left = self.tokens[place].saturating_sub(of(&takes, place));
            if t.resets.iter().any(|reset| reset.index() == place) {
                left = 0;
            }
            let promise = if t.action.is_some() {
                Self::promise(t, place)
            } else {
                of(&sum(&t.outputs.local), place)
            };
            left + self.promised(net, place) + promise <= u64::from(capacity)
        };
        let servers = match t.servers {
            crate::net::Servers::Limit(limit) if t.action.is_some() => {
                let going = self.going.iter().filter(|going| going.transition == index);
                going.count() < limit.get() as usize
            }
            _ => true,
        };
        t.inputs.iter().all(holds)
            && t.reads.iter().all(holds)
            && !t.inhibitors.iter().any(holds)
            && (0..PLACES).all(fits)
            && servers
            && t.tape.is_none_or(|command| {
                self.current.is_none()
                    && self
                        .waiting
                        .first()
                        .is_some_and(|(_, c)| *c == command.index())
            })
    }

    fn take(&mut self, net: &Net, index: usize) -> Option<u64> {
        let t = &net.transitions()[index];
        for (place, tokens) in sum(&t.inputs) {
            self.tokens[place] -= tokens;
        }
        for place in &t.resets {
            self.tokens[place.index()] = 0;
        }
        t.tape?;
        let (number, command) = self.waiting.remove(0);
        self.current = Some((number, command));
        Some(number)
    }

    fn put(&mut self, arcs: &[crate::net::Arc]) {
        for (place, tokens) in sum(arcs) {
            self.tokens[place] += tokens;
        }
    }

    fn write(&mut self, net: &Net, index: usize) {
        let Some(symbol) = &net.transitions()[index].write else {
            return;
        };
        if let Some((_, command)) = self.current
            && net.commands()[command].answers.contains(symbol)
        {
            self.current = None;
        }
    }

    fn fire(&mut self, net: &Net, index: usize) {
        self.take(net, index);
        self.put(&net.transitions()[index].outputs.local);
        self.write(net, index);
    }

    fn start(&mut self, net: &Net, index: usize) {
        let command = self.take(net, index);
        let within = net.transitions()[index].within;
        self.going.push(Going {
            number: self.firings,
            transition: index,
            command,
            limit: within.map(|within| self.now + u64::try_from(within.as_nanos()).unwrap()),
        });
        self.firings += 1;
    }

    fn end(&mut self, net: &Net, which: usize, end: End) {
        let going = self.going.remove(which);
        let t = &net.transitions()[going.transition];
        match (end, &t.fail) {
            (End::Completed, _) => {
                self.put(&t.outputs.local);
                self.write(net, going.transition);
            }
            (End::Failed | End::TimedOut, Some(branch)) => self.put(&branch.local),
            _ => {
                self.put(&t.inputs);
                if let (Some(number), Some((current, command))) = (going.command, self.current)
                    && number == current
                {
                    self.current = None;
                    self.waiting.insert(0, (number, command));
                }
            }
        }
    }
}

#[derive(Debug, Clone)]
enum Step {
    Fire(prop::sample::Index),
    FireAnything(u8),
    End(prop::sample::Index, u8),
    Put(u8, u8),
    Take(u8, u8),
    Symbol(u8),
    Time(u32),
    Restore,
}

fn step() -> impl Strategy<Value = Step> {
    prop_oneof![
        8 => any::<prop::sample::Index>().prop_map(Step::Fire),
        1 => (0_u8..8).prop_map(Step::FireAnything),
        6 => (any::<prop::sample::Index>(), 0_u8..4).prop_map(|(which, end)| Step::End(which, end)),
        2 => (0_u8..5, 0_u8..4).prop_map(|(place, count)| Step::Put(place, count)),
        1 => (0_u8..5, 0_u8..3).prop_map(|(place, count)| Step::Take(place, count)),
        2 => (0_u8..2).prop_map(Step::Symbol),
        1 => (0_u32..900_000).prop_map(Step::Time),
        1 => Just(Step::Restore),
    ]
}

/// Does a step in both; the executor must accept just what the model says.
fn both(execution: &mut Execution, model: &mut Model, step: &Step) {
    let net = Arc::clone(execution.net());
    let go = |execution: &mut Execution, model: &mut Model, index: usize| {
        let id = TransitionId(u32::try_from(index).unwrap());
        let enabled = model.enabled(&net, index);
        if net[id].action.is_some() {
            assert_eq!(execution.start(id).is_ok(), enabled);
            if enabled {
                model.start(&net, index);
            }
        } else {
            assert_eq!(execution.fire(id).is_ok(), enabled);
            if enabled {
                model.fire(&net, index);
            }
        }
    };
    match step {
        Step::Fire(pick) => {
            let enabled: Vec<usize> = execution.enabled().map(TransitionId::index).collect();
            if !enabled.is_empty() {
                go(execution, model, *pick.get(&enabled));
            }
        }
        Step::FireAnything(index) => {
            let index = usize::from(*index);
            if index < net.transitions().len() {
                go(execution, model, index);
            }
        }
        Step::End(pick, how) => {
            if model.going.is_empty() {
                return;
            }
            let which = pick.index(model.going.len());
            let (firing, _) = execution.running().nth(which).unwrap();
            let end = match how {
                0 | 1 => execution.complete(firing).map(|_| End::Completed),
                2 => execution.fail(firing).map(|_| End::Failed),
                _ => execution.cancel(firing).map(|()| End::Cancelled),
            };
            model.end(&net, which, end.unwrap());
        }
        Step::Put(place, count) => {
            let (index, count) = (usize::from(*place), u64::from(*count));
            let filled = model.tokens[index] + model.promised(&net, index) + count;
            let capacity = net.places()[index].capacity;
            let fits = capacity.is_none_or(|capacity| filled <= u64::from(capacity));
            let put = execution.put_tokens(&format!("p{place}"), u32::try_from(count).unwrap());
            assert_eq!(put.is_ok(), fits);
            if fits {
                model.tokens[index] += count;
            }
        }
        Step::Take(place, count) => {
            let (index, count) = (usize::from(*place), u64::from(*count));
            let taken = execution.take_tokens(&format!("p{place}"), u32::try_from(count).unwrap());
            assert_eq!(taken.is_ok(), model.tokens[index] >= count);
            if taken.is_ok() {
                model.tokens[index] -= count;
            }
        }
        Step::Symbol(command) => {
            let number = execution
                .put_symbol(&format!("c{command}"), Vec::new())
                .unwrap();
            assert_eq!(number, model.commands);
            model.waiting.push((number, usize::from(*command)));
            model.commands += 1;
        }
        Step::Time(by) => {
            model.now += u64::from(*by);
            execution.advance_to(model.now);
            while let Some((firing, _, _)) = execution.expire().unwrap() {
                let over = model
                    .going
                    .iter()
                    .filter(|g| g.limit.is_some_and(|l| l <= model.now));
                let first = over
                    .min_by_key(|going| (going.limit, going.number))
                    .unwrap();
                assert_eq!(FiringId(first.number), firing);
                let which = model.going.iter().position(|going| going == first).unwrap();
                model.end(&net, which, End::TimedOut);
            }
            assert!(
                !model
                    .going
                    .iter()
                    .any(|going| going.limit.is_some_and(|l| l <= model.now))
            );
        }
        Step::Restore => {
            let text = serde_json::to_string(&execution.state()).unwrap();
            let state: State = serde_json::from_str(&text).unwrap();
            let events = execution.next_event();
            *execution = Execution::restore(Arc::clone(&net), state).unwrap();
            assert_eq!(execution.next_event(), events);
            execution.record_events(16);
        }
    }
}

/// What the events since `number` say that the marking has become.
fn replay(execution: &Execution, number: u64, marking: &[u32]) -> Vec<i64> {
    let mut tokens: Vec<i64> = marking.iter().map(|tokens| i64::from(*tokens)).collect();
    let mut add = |arcs: &[crate::net::Arc], sign: i64| {
        for arc in arcs {
            tokens[arc.place.index()] += sign * i64::from(arc.weight);
        }
    };
    for event in execution.events_since(number) {
        match event.happened {
            Happened::Fired {
                consumed,
                emptied,
                produced,
                ..
            } => {
                add(consumed, -1);
                add(emptied, -1);
                add(produced, 1);
            }
            Happened::Started {
                consumed, emptied, ..
            } => {
                add(consumed, -1);
                add(emptied, -1);
            }
            Happened::Ended { produced, .. } => add(produced, 1),
            Happened::Put { place, tokens } => add(
                &[crate::net::Arc {
                    place,
                    weight: tokens,
                }],
                1,
            ),
            Happened::Taken { place, tokens } => add(
                &[crate::net::Arc {
                    place,
                    weight: tokens,
                }],
                -1,
            ),
            Happened::Symbol { .. } => {}
        }
    }
    tokens
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(1500))]

    #[test]
    fn no_token_is_ever_lost_or_made_and_enabling_is_as_defined(
        capacities in vec(0_u8..16, PLACES),
        transitions in vec(random_transition(), 1..7),
        steps in vec(step(), 0..60),
    ) {
        let mut execution = execution(&text(&capacities, &transitions));
        let net = Arc::clone(execution.net());
        let mut model = Model::new(&net);
        execution.record_events(16);
        for step in &steps {
            let (events, marking) = (execution.next_event(), execution.marking().to_vec());
            both(&mut execution, &mut model, step);
            let tokens: Vec<u64> = execution.marking().iter().map(|t| u64::from(*t)).collect();
            prop_assert_eq!(&tokens, &model.tokens);
            let replayed = replay(&execution, events, &marking);
            prop_assert!(replayed.iter().zip(&tokens).all(|(a, b)| u64::try_from(*a).unwrap() == *b));
            let by_definition: Vec<usize> =
                (0..net.transitions().len()).filter(|index| model.enabled(&net, *index)).collect();
            let enabled: Vec<usize> = execution.enabled().map(TransitionId::index).collect();
            prop_assert_eq!(enabled, by_definition);
            prop_assert!(execution.running().map(|(id, _)| id.0).eq(model.going.iter().map(|g| g.number)));
            let on_tape = execution.tape().waiting().map(|c| (c.number, c.command.index()));
            prop_assert!(on_tape.eq(model.waiting.iter().copied()));
            let current = execution.tape().current().map(|c| (c.number, c.command.index()));
            prop_assert_eq!(current, model.current);
        }
    }
}
