//! The composed nets beside the executor, which is the reference. Random nets in pairs, with messages
//! of any delay, are played in all ways. The markings where no message is under way are those of the
//! composed system.

use std::{
    cell::RefCell,
    collections::{BTreeMap, BTreeSet},
    fmt::Write as _,
};

use proptest::{prelude::*, strategy::ValueTree as _, test_runner::TestRunner};

use super::*;
use crate::analysis::{
    explicit::{Limits, explore},
    model::Model,
    samples::net,
};
use pnt_language::exec::{Execution, FireError, FiringId};

const PLACES: usize = 3;

#[derive(Debug, Clone)]
struct RandomTransition {
    ins: Vec<u8>,
    outs: Vec<u8>,
    read: u8,
    inhibit: u8,
    reset: u8,
    remote: Option<u8>,
    action: bool,
    fail: u8,
    servers: u8,
    priority: u8,
    timed: bool,
    when: u8,
    tape: bool,
    write: bool,
}

fn weights() -> impl Strategy<Value = Vec<u8>> {
    prop::collection::vec(
        prop_oneof![4 => Just(0_u8), 2 => Just(1), 1 => Just(2)],
        PLACES,
    )
}

fn transition() -> impl Strategy<Value = RandomTransition> {
    let arcs = (weights(), weights(), 0_u8..12, 0_u8..10, 0_u8..12);
    let remote = prop::option::weighted(0.4, 0_u8..3);
    let rest = (remote, any::<bool>(), 0_u8..8, 0_u8..4, 0_u8..6);
    let more = (
        prop::bool::weighted(0.15),
        0_u8..16,
        prop::bool::weighted(0.15),
        prop::bool::weighted(0.2),
    );
    (arcs, rest, more).prop_map(
        |(
            (ins, outs, read, inhibit, reset),
            (remote, action, fail, servers, priority),
            (timed, when, tape, write),
        )| {
            RandomTransition {
                ins,
                outs,
                read,
                inhibit,
                reset,
                remote,
                action,
                fail,
                servers,
                priority,
                timed,
                when,
                tape,
                write,
            }
        },
    )
}

#[derive(Debug, Clone)]
struct RandomNet {
    places: Vec<(u8, u8)>,
    transitions: Vec<RandomTransition>,
}

fn random_net() -> impl Strategy<Value = RandomNet> {
    let places = prop::collection::vec((0_u8..3, 0_u8..8), PLACES);
    let transitions = prop::collection::vec(transition(), 1..5);
    (places, transitions).prop_map(|(places, transitions)| RandomNet {
        places,
        transitions,
    })
}

impl RandomNet {
    /// The net's text; `other` is the net that its remote arcs lead to.
    fn text(&self, name: &str, other: Option<&str>) -> String {
        let mut text = format!("net {name}\n");
        let tape = self.transitions.iter().any(|t| t.tape);
        if tape {
            text.push_str("command c -> a\n");
        }
        for (index, (tokens, capacity)) in self.places.iter().enumerate() {
            let _ = write!(text, "place p{index} = {tokens}");
            if *capacity < 5 {
                let _ = write!(text, " capacity {}", (*capacity).max(*tokens).max(1));
            }
            text.push('\n');
        }
        for (index, t) in self.transitions.iter().enumerate() {
            let _ = writeln!(text, "transition t{index}");
            let arcs = |weights: &[u8]| -> Vec<String> {
                let arcs = weights
                    .iter()
                    .enumerate()
                    .filter(|(_, weight)| **weight > 0);
                arcs.map(|(place, weight)| format!("p{place}*{weight}"))
                    .collect()
            };
            let mut ins = arcs(&t.ins);
            if ins.is_empty() && !t.tape {
                ins.push("p0".to_owned());
            }
            let mut outs = arcs(&t.outs);
            outs.extend(
                t.remote
                    .zip(other)
                    .map(|(place, other)| format!("p{place}@{other}")),
            );
            for (keyword, list) in [("in", ins), ("out", outs)] {
                if !list.is_empty() {
                    let _ = writeln!(text, "  {keyword} {}", list.join(", "));
                }
            }
            for (keyword, place, weight) in [
                ("read", t.read, "*2"),
                ("inhibit", t.inhibit, "*2"),
                ("reset", t.reset, ""),
            ] {
                if usize::from(place) < PLACES {
                    let _ = writeln!(text, "  {keyword} p{place}{weight}");
                }
            }
            match t.when {
                0 => text.push_str("  when f\n"),
                1 => text.push_str("  when not f\n"),
                2 => text.push_str("  when g\n"),
                _ => {}
            }
            if t.tape {
                text.push_str("  tape c\n");
            }
            if t.write && tape {
                text.push_str("  write a\n");
            }
            if t.priority == 1 {
                text.push_str("  priority 1\n");
            }
            if t.action {
                text.push_str("  do something\n");
                if usize::from(t.fail) < PLACES {
                    let _ = writeln!(text, "  fail p{}*2", t.fail);
                }
                if (1..3).contains(&t.servers) {
                    let _ = writeln!(text, "  servers {}", t.servers);
                }
            } else if t.timed {
                text.push_str("  time 1 s\n");
            }
        }
        text
    }
}

/// Nets in motion, and the messages between them.
#[derive(Clone)]
struct Played {
    nets: Vec<Execution>,
    on_the_way: BTreeMap<Message, u32>,
}

/// The receiving net, and what it gets.
type Message = (usize, Vec<(String, u32)>);

/// The firing that has the command in progress, if it still goes on.
fn holding(net: &Execution) -> Option<(TransitionId, FiringId)> {
    let current = net.tape().current()?.number;
    let state = net.state();
    let firing = state
        .running
        .iter()
        .find(|running| running.command == Some(current))?;
    Some((firing.transition, firing.firing))
}

/// What a place of the composed system holds; not those that only count, or tokens on their way.
fn seen(stands: Stands, net: &Execution) -> Option<u32> {
    let tape = net.tape();
    Some(match stands {
        Stands::Place(id) => net.marking()[id.index()],
        Stands::Firing(id) => {
            let firings = net.running().filter(|(_, of)| *of == id).count();
            u32::try_from(firings).unwrap()
        }
        Stands::Idle => u32::from(tape.is_empty() && tape.current().is_none()),
        Stands::OnTape(command) => {
            u32::from(tape.waiting().next().map(|c| c.command) == Some(command))
        }
        Stands::InProgress(command) => {
            u32::from(tape.current().map(|c| c.command) == Some(command))
        }
        Stands::Holds(id) => {
            let holding = holding(net);
            u32::from(holding.is_some_and(|(of, _)| of == id))
        }
        Stands::Filled(_) | Stands::OnTheWay(_) | Stands::Word(_) => return None,
    })
}

impl Played {
    fn marking(&self, system: &System) -> Vec<u32> {
        let places = system.places().iter();
        places
            .filter_map(|place| seen(place.stands, &self.nets[place.net]))
            .collect()
    }

    fn post(&mut self, remote: &[RemoteArc]) {
        let mut messages: BTreeMap<&str, Vec<(String, u32)>> = BTreeMap::new();
        for arc in remote {
            messages
                .entry(&arc.net)
                .or_default()
                .push((arc.place.clone(), arc.weight));
        }
        for (net, tokens) in messages {
            let to = self
                .nets
                .iter()
                .position(|other| other.net().name() == net)
                .unwrap();
            *self.on_the_way.entry((to, tokens)).or_default() += 1;
        }
    }

    /// One more step in all ways; and whether tokens were refused.
    fn nexts(&self) -> (Vec<Self>, bool) {
        let mut nexts = Vec::new();
        for number in 0..self.nets.len() {
            for id in self.may_fire(number) {
                let mut next = self.clone();
                if next.nets[number].net()[id].action.is_some() {
                    next.nets[number].start(id).unwrap();
                } else {
                    let remote = next.nets[number].fire(id).unwrap().remote.to_vec();
                    next.post(&remote);
                }
                nexts.push(next);
            }
            // One of each transition, and of those one that has the command in progress.
            let holds = holding(&self.nets[number]).map(|(_, firing)| firing);
            let running: BTreeMap<(TransitionId, bool), FiringId> = self.nets[number]
                .running()
                .map(|(firing, id)| ((id, Some(firing) == holds), firing))
                .collect();
            for firing in running.values() {
                for fails in [false, true] {
                    let mut next = self.clone();
                    let net = &mut next.nets[number];
                    let effects = if fails {
                        net.fail(*firing)
                    } else {
                        net.complete(*firing)
                    };
                    let remote = effects.unwrap().remote.to_vec();
                    next.post(&remote);
                    nexts.push(next);
                }
            }
            let tape = self.nets[number].tape();
            if tape.is_empty() && tape.current().is_none() {
                for command in self.nets[number].net().commands() {
                    let mut next = self.clone();
                    next.nets[number]
                        .put_symbol(&command.symbol, Vec::new())
                        .unwrap();
                    nexts.push(next);
                }
            }
        }
        let mut refused = false;
        for (to, tokens) in self.on_the_way.keys() {
            let mut next = self.clone();
            let key = (*to, tokens.clone());
            match next.on_the_way.get_mut(&key) {
                Some(count) if *count > 1 => *count -= 1,
                _ => drop(next.on_the_way.remove(&key)),
            }
            match next.nets[*to].put_all(tokens) {
                Ok(_) => {}
                Err(FireError::Full { .. }) => refused = true,
                Err(other) => panic!("{other}"),
            }
            nexts.push(next);
        }
        (nexts, refused)
    }

    /// The transitions that a net may choose next, whatever its two enabling functions say.
    fn may_fire(&self, number: usize) -> BTreeSet<TransitionId> {
        let execution = &self.nets[number];
        let net = execution.net();
        let urgency = |id: &TransitionId| {
            let t = &net[*id];
            (t.timing.is_immediate() || t.action.is_some(), t.priority)
        };
        let mut may = BTreeSet::new();
        for values in [[false; 2], [false, true], [true, false], [true; 2]] {
            let passes = |id: &TransitionId| {
                net[*id]
                    .when
                    .as_ref()
                    .is_none_or(|when| values[usize::from(when.function == "g")] != when.negated)
            };
            let enabled: Vec<TransitionId> = execution.enabled().filter(passes).collect();
            let most = enabled.iter().map(urgency).max();
            may.extend(enabled.into_iter().filter(|id| Some(urgency(id)) == most));
        }
        may
    }

    /// Everything by which two states differ.
    fn key(&self, system: &System) -> (Vec<u32>, BTreeMap<Message, u32>) {
        (self.marking(system), self.on_the_way.clone())
    }
}

/// States at most; nets with more are passed over.
const MOST: usize = 1_500;

/// Whether they were compared; nets with many markings are not.
fn compare(nets: &[Arc<Net>]) -> Result<bool, TestCaseError> {
    let (system, findings) = System::compose(nets);
    prop_assert!(!findings.has_errors(), "{}", findings);
    let start = Played {
        nets: nets
            .iter()
            .map(|net| Execution::new(Arc::clone(net)))
            .collect(),
        on_the_way: BTreeMap::new(),
    };
    let mut states = BTreeSet::from([start.key(&system)]);
    let (mut open, mut refused) = (vec![start], false);
    while let Some(state) = open.pop() {
        let (nexts, refuses) = state.nexts();
        refused |= refuses;
        for next in nexts {
            if next
                .nets
                .iter()
                .any(|net| net.marking().iter().any(|tokens| *tokens > 12))
            {
                return Ok(false);
            }
            if states.insert(next.key(&system)) {
                open.push(next);
            }
        }
        if states.len() > MOST {
            return Ok(false);
        }
    }
    let played: BTreeSet<Vec<u32>> = states
        .into_iter()
        .filter(|(_, way)| way.is_empty())
        .map(|(marking, _)| marking)
        .collect();
    let model = Model::of_system(&system);
    let explored = explore(
        &model,
        &Limits {
            markings: 50_000,
            ..Limits::default()
        },
    );
    prop_assert!(explored.complete(), "{:?}", explored.stopped);
    let found = RefCell::new((BTreeSet::new(), 0));
    let _ = explored.nearest(|marking| {
        let places = || system.places().iter().zip(marking);
        if places()
            .all(|(place, tokens)| !matches!(place.stands, Stands::OnTheWay(_)) || *tokens == 0)
        {
            let told = |place: &SystemPlace| {
                !matches!(place.stands, Stands::Filled(_) | Stands::OnTheWay(_))
            };
            let marking = places()
                .filter(|(place, _)| told(place))
                .map(|(_, tokens)| *tokens);
            let (found, count) = &mut *found.borrow_mut();
            found.insert(marking.collect::<Vec<u32>>());
            *count += 1;
        }
        false
    });
    let (found, count) = found.into_inner();
    // What a place is filled with follows from all else.
    prop_assert_eq!(found.len(), count);
    let more: Vec<_> = found.difference(&played).take(3).collect();
    let fewer: Vec<_> = played.difference(&found).take(3).collect();
    let names: Vec<_> = system.places().iter().map(|place| &place.name).collect();
    prop_assert!(
        more.is_empty() && fewer.is_empty(),
        "only analysed {:?}, only played {:?} of {:?}",
        more,
        fewer,
        names
    );
    let overfills = system.steps().iter().zip(&explored.seen);
    prop_assert_eq!(
        overfills
            .filter(|(step, seen)| step.overfills.is_some() && **seen)
            .count()
            > 0,
        refused
    );
    Ok(true)
}

/// The nets, if all compile; that random ones do is not to be taken for granted.
fn compiled(texts: &[String]) -> Option<Vec<Arc<Net>>> {
    // Some are refused, such as a transition that puts more than a capacity.
    let fits = |text: &String| {
        let source = ctos::diagnostic::Source::new("test.net", text.as_str());
        pnt_language::compile::net(&source).is_ok()
    };
    texts
        .iter()
        .all(fits)
        .then(|| texts.iter().map(|text| net(text)).collect())
}

#[test]
fn most_random_nets_can_be_compared() {
    let mut runner = TestRunner::deterministic();
    let mut draw = || random_net().new_tree(&mut runner).unwrap().current();
    let mut compared = 0;
    for _ in 0..200 {
        let texts = [draw().text("m", Some("n")), draw().text("n", Some("m"))];
        let nets = compiled(&texts);
        compared += u32::from(nets.is_some_and(|nets| compare(&nets).unwrap()));
    }
    assert!(compared > 60, "{compared} of 200");
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(400))]

    #[test]
    fn what_is_analysed_of_a_net_is_what_it_can_do(random in random_net()) {
        let text = random.text("m", None);
        let Some(nets) = compiled(std::slice::from_ref(&text)) else { return Ok(()) };
        compare(&nets).map_err(|error| TestCaseError::fail(format!("{error}\n{text}")))?;
    }

    #[test]
    fn what_is_analysed_of_two_nets_is_what_they_can_do(one in random_net(), other in random_net()) {
        let texts = [one.text("m", Some("n")), other.text("n", Some("m"))];
        let Some(nets) = compiled(&texts) else { return Ok(()) };
        compare(&nets).map_err(|error| TestCaseError::fail(format!("{error}\n{}{}", texts[0], texts[1])))?;
    }
}

#[test]
fn of_very_many_findings_of_a_kind_the_first_are_told_and_the_others_counted() {
    let mut text = String::from("net n\nplace a = 1\ntransition t\n  in a\n  out a\n");
    for place in 0..100_000 {
        let _ = writeln!(text, "place p{place}");
    }
    let found = System::fit(&[net(&text)]);
    let messages: Vec<&str> = found.iter().map(|f| f.message.as_str()).collect();
    assert_eq!(messages.len(), 201);
    assert_eq!(
        messages[200],
        "no transition uses the place `p200`, and so for 99799 more"
    );
}
