//! The markings in which time passes (tangible) and how one leads to the next. Markings in which a
//! transition without time is enabled (vanishing) are left at once, and eliminated as they are met.
//! What counts is to which tangible markings they lead, how probably, and what fires on the way. The
//! rule of enabling here is written from the definition and shares nothing with the executor.

use hashbrown::{HashMap, HashTable};

use super::{
    error::{NotExact, PerfError},
    model::Model,
};
use pnt_language::net::{Servers, Timing, Transition};

/// Vanishing markings between two tangible ones.
const MOST_VANISHING: usize = 100_000;

/// Vanishing circles are followed until what is left of a probability is this.
const LEFT_OVER: f64 = 1e-16;

/// Times that a vanishing circle is followed.
const MOST_SWEEPS: usize = 100_000;

/// Markings, each numbered once.
#[derive(Debug)]
pub(super) struct Store {
    places: usize,
    tokens: Vec<u32>,
    index: HashTable<u32>,
    count: u32,
}

fn hash(marking: &[u32]) -> u64 {
    // Fibonacci hashing word by word, the upper bits folded down.
    marking
        .iter()
        .fold(0x9E37_79B9_7F4A_7C15, |hash: u64, tokens| {
            let mixed = (hash ^ u64::from(*tokens)).wrapping_mul(0x9E37_79B9_7F4A_7C15);
            mixed ^ (mixed >> 29)
        })
}

impl Store {
    fn new(places: usize) -> Self {
        Self {
            places,
            tokens: Vec::new(),
            index: HashTable::new(),
            count: 0,
        }
    }

    pub(super) fn len(&self) -> usize {
        self.count as usize
    }

    pub(super) fn get(&self, number: u32) -> &[u32] {
        let begin = number as usize * self.places;
        self.tokens.get(begin..begin + self.places).unwrap_or(&[])
    }

    fn intern(&mut self, marking: &[u32]) -> u32 {
        let (tokens, places) = (&self.tokens, self.places);
        let of = |number: u32| {
            let begin = number as usize * places;
            tokens.get(begin..begin + places).unwrap_or(&[])
        };
        let entry = self.index.entry(
            hash(marking),
            |number| of(*number) == marking,
            |number| hash(of(*number)),
        );
        match entry {
            hashbrown::hash_table::Entry::Occupied(found) => *found.get(),
            hashbrown::hash_table::Entry::Vacant(vacant) => {
                let number = self.count;
                vacant.insert(number);
                self.tokens.extend_from_slice(marking);
                self.count += 1;
                number
            }
        }
    }
}

/// A transition of the model, its arcs added up per place.
#[derive(Debug)]
pub(super) struct Rule {
    needs: Vec<(usize, u32)>,
    takes: Vec<(usize, u32)>,
    forbids: Vec<(usize, u32)>,
    resets: Vec<usize>,
    puts: Vec<(usize, u32)>,
    /// Capacities of places that it puts tokens into.
    capacities: Vec<(usize, u32)>,
    priority: u32,
    weight: f64,
    servers: Servers,
    /// None when it takes no time.
    mean_s: Option<f64>,
}

impl Rule {
    fn new(model: &Model, transition: &Transition) -> Result<Self, NotExact> {
        let sum = |arcs: &[pnt_language::net::Arc]| {
            let mut sums: Vec<(usize, u32)> = Vec::new();
            for arc in arcs {
                match sums
                    .iter_mut()
                    .find(|(place, _)| *place == arc.place.index())
                {
                    Some((_, weight)) => *weight = weight.saturating_add(arc.weight),
                    None => sums.push((arc.place.index(), arc.weight)),
                }
            }
            sums
        };
        let (takes, puts) = (sum(&transition.inputs), sum(&transition.outputs.local));
        let mut needs = takes.clone();
        needs.extend(sum(&transition.reads));
        let capacity = |(place, _): &(usize, u32)| {
            let capacity = model.net.places().get(*place)?.capacity?;
            Some((*place, capacity))
        };
        Ok(Self {
            capacities: puts.iter().filter_map(capacity).collect(),
            needs,
            takes,
            forbids: sum(&transition.inhibitors),
            resets: transition
                .resets
                .iter()
                .map(|place| place.index())
                .collect(),
            puts,
            priority: transition.priority,
            weight: transition.weight,
            servers: transition.servers,
            mean_s: match transition.timing {
                Timing::Immediate => None,
                Timing::Exponential { mean } => Some(mean.as_secs_f64()),
                _ => return Err(NotExact::NotExponential(transition.name.clone())),
            },
        })
    }

    fn is_enabled(&self, marking: &[u32]) -> bool {
        self.needs
            .iter()
            .all(|(place, weight)| marking[*place] >= *weight)
            && self
                .forbids
                .iter()
                .all(|(place, weight)| marking[*place] < *weight)
            && self.capacities.iter().all(|(place, capacity)| {
                u64::from(self.after(marking, *place)) <= u64::from(*capacity)
            })
    }

    /// Tokens of a place after firing.
    fn after(&self, marking: &[u32], place: usize) -> u32 {
        let of = |arcs: &[(usize, u32)]| {
            let arc = arcs.iter().find(|(p, _)| *p == place);
            arc.map_or(0, |(_, weight)| *weight)
        };
        let left = marking[place].saturating_sub(of(&self.takes));
        let left = if self.resets.contains(&place) {
            0
        } else {
            left
        };
        left.saturating_add(of(&self.puts))
    }

    /// The marking after firing; `None` when a place overflows.
    fn fire(&self, marking: &[u32], after: &mut Vec<u32>) -> Option<()> {
        after.clear();
        after.extend_from_slice(marking);
        for (place, weight) in &self.takes {
            after[*place] -= weight;
        }
        for place in &self.resets {
            after[*place] = 0;
        }
        for (place, weight) in &self.puts {
            after[*place] = after[*place].checked_add(*weight)?;
        }
        Some(())
    }

    /// How many of its firings go on at once at a marking.
    pub(super) fn busy(&self, marking: &[u32]) -> f64 {
        if !self.is_enabled(marking) {
            return 0.0;
        }
        let times = self
            .takes
            .iter()
            .map(|(place, weight)| marking[*place] / weight);
        let degree = times.min().unwrap_or(1);
        f64::from(match self.servers {
            Servers::Many => degree,
            Servers::Limit(limit) => degree.min(limit.get()),
        })
    }

    /// Firings per second at a marking, of a transition that takes time.
    pub(super) fn rate(&self, marking: &[u32]) -> f64 {
        self.mean_s
            .map_or(0.0, |mean_s| self.busy(marking) / mean_s)
    }

    pub(super) fn is_timed(&self) -> bool {
        self.mean_s.is_some()
    }
}

/// What a marking becomes without time passing.
#[derive(Debug, Clone, Default)]
struct Outcome {
    /// Tangible markings and their probabilities.
    to: Vec<(u32, f64)>,
    /// Transitions without time and how often they fire on the way, on average.
    fired: Vec<(u32, f64)>,
}

/// The tangible markings and the rates between them.
#[derive(Debug)]
pub(super) struct Markings {
    pub(super) rules: Vec<Rule>,
    pub(super) store: Store,
    /// Per marking: where it leads, and how often per second; also back to itself.
    pub(super) rows: Vec<Vec<(u32, f64)>>,
    /// Per marking: firings per second of transitions without time.
    pub(super) fired: Vec<Vec<(u32, f64)>>,
    /// Where the initial marking leads.
    pub(super) first: Vec<(u32, f64)>,
}

pub(super) fn explore(model: &Model, most: usize) -> Result<Markings, NotExact> {
    let transitions = model.net.transitions().iter();
    let rules = transitions
        .map(|transition| Rule::new(model, transition))
        .collect::<Result<Vec<_>, _>>()?;
    let mut explorer = Explorer {
        model,
        most,
        outcomes: HashMap::new(),
        vanishing: Store::new(model.net.places().len()),
        found: Markings {
            rules,
            store: Store::new(model.net.places().len()),
            rows: Vec::new(),
            fired: Vec::new(),
            first: Vec::new(),
        },
    };
    let initial: Vec<u32> = model
        .net
        .places()
        .iter()
        .map(|place| place.tokens)
        .collect();
    explorer.found.first = explorer.settle(&initial)?.to;
    let mut after = Vec::new();
    while explorer.found.rows.len() < explorer.found.store.len() {
        explorer.row(&mut after)?;
    }
    Ok(explorer.found)
}

struct Explorer<'a> {
    model: &'a Model,
    most: usize,
    vanishing: Store,
    outcomes: HashMap<u32, Outcome>,
    found: Markings,
}

impl Explorer<'_> {
    /// Where the next marking without a row leads.
    fn row(&mut self, after: &mut Vec<u32>) -> Result<(), NotExact> {
        let number = self.found.rows.len();
        let marking = self
            .found
            .store
            .get(u32::try_from(number).unwrap_or(u32::MAX))
            .to_vec();
        let mut row: Vec<(u32, f64)> = Vec::new();
        let mut fired: Vec<(u32, f64)> = Vec::new();
        for index in 0..self.found.rules.len() {
            let rate = self.found.rules[index].rate(&marking);
            if rate <= 0.0 {
                continue;
            }
            self.fire(index, &marking, after)?;
            let outcome = self.settle(after)?;
            row.extend(outcome.to.iter().map(|(to, part)| (*to, rate * part)));
            fired.extend(outcome.fired.iter().map(|(t, times)| (*t, rate * times)));
        }
        self.found.rows.push(summed(row));
        self.found.fired.push(summed(fired));
        if self.found.store.len() > self.most {
            return Err(NotExact::TooMany(self.most));
        }
        Ok(())
    }

    fn fire(&self, index: usize, marking: &[u32], after: &mut Vec<u32>) -> Result<(), PerfError> {
        let overflow = || PerfError::Overflow(format!("after {}", self.model.words(marking)));
        self.found.rules[index]
            .fire(marking, after)
            .ok_or_else(overflow)
    }

    /// The transitions without time that may fire at a marking, those of the highest priority only.
    fn immediate(&self, marking: &[u32]) -> Vec<usize> {
        let rules = self.found.rules.iter().enumerate();
        let mut best: Vec<usize> = Vec::new();
        let mut priority = 0;
        for (index, rule) in rules.filter(|(_, rule)| !rule.is_timed()) {
            if (best.is_empty() || rule.priority >= priority) && rule.is_enabled(marking) {
                if rule.priority > priority {
                    best.clear();
                }
                priority = rule.priority;
                best.push(index);
            }
        }
        best
    }

    fn settle(&mut self, marking: &[u32]) -> Result<Outcome, NotExact> {
        if self.immediate(marking).is_empty() {
            let number = self.found.store.intern(marking);
            return Ok(Outcome {
                to: vec![(number, 1.0)],
                fired: Vec::new(),
            });
        }
        let number = self.vanishing.intern(marking);
        if let Some(known) = self.outcomes.get(&number) {
            return Ok(known.clone());
        }
        let outcome = self.eliminate(number)?;
        self.outcomes.insert(number, outcome.clone());
        Ok(outcome)
    }

    /// Follows a vanishing marking through all others until time passes.
    fn eliminate(&mut self, begin: u32) -> Result<Outcome, NotExact> {
        let passage = Passage::find(self, begin)?;
        if let Some(stuck) = passage.stuck() {
            let marking = self.model.words(self.vanishing.get(stuck));
            return Err(PerfError::Timeless { marking }.into());
        }
        let visits = passage.visits()?;
        let mut outcome = Outcome::default();
        for (local, visits) in passage.nodes.iter().zip(visits) {
            for (transition, part, to) in &local.steps {
                outcome.fired.push((*transition, visits * part));
                if let To::Tangible(number) = to {
                    outcome.to.push((*number, visits * part));
                }
            }
        }
        outcome.to = summed(outcome.to);
        outcome.fired = summed(outcome.fired);
        Ok(outcome)
    }
}

/// Adds up what belongs together.
fn summed(mut values: Vec<(u32, f64)>) -> Vec<(u32, f64)> {
    values.sort_by_key(|(number, _)| *number);
    values.dedup_by(|next, kept| {
        let same = next.0 == kept.0;
        if same {
            kept.1 += next.1;
        }
        same
    });
    values
}

#[derive(Debug, Clone, Copy)]
enum To {
    /// A node of the passage.
    Node(usize),
    Tangible(u32),
}

struct Node {
    vanishing: u32,
    /// Transition, probability, where to.
    steps: Vec<(u32, f64, To)>,
}

/// The vanishing markings between one marking and the next tangible ones.
struct Passage {
    nodes: Vec<Node>,
}

impl Passage {
    fn find(explorer: &mut Explorer<'_>, begin: u32) -> Result<Self, NotExact> {
        let mut nodes = vec![Node {
            vanishing: begin,
            steps: Vec::new(),
        }];
        let mut number_of: HashMap<u32, usize> = HashMap::from([(begin, 0)]);
        let mut after = Vec::new();
        let mut done = 0;
        while done < nodes.len() {
            let marking = explorer.vanishing.get(nodes[done].vanishing).to_vec();
            let chosen = explorer.immediate(&marking);
            let total: f64 = chosen
                .iter()
                .map(|index| explorer.found.rules[*index].weight)
                .sum();
            for index in chosen {
                let part = explorer.found.rules[index].weight / total;
                explorer.fire(index, &marking, &mut after)?;
                let to = if explorer.immediate(&after).is_empty() {
                    To::Tangible(explorer.found.store.intern(&after))
                } else {
                    let vanishing = explorer.vanishing.intern(&after);
                    let next = nodes.len();
                    let node = *number_of.entry(vanishing).or_insert(next);
                    if node == next {
                        nodes.push(Node {
                            vanishing,
                            steps: Vec::new(),
                        });
                    }
                    To::Node(node)
                };
                let transition = u32::try_from(index).unwrap_or(u32::MAX);
                nodes[done].steps.push((transition, part, to));
            }
            done += 1;
            if nodes.len() > MOST_VANISHING {
                let marking = explorer.model.words(explorer.vanishing.get(begin));
                return Err(PerfError::Timeless { marking }.into());
            }
        }
        Ok(Self { nodes })
    }

    /// A vanishing marking from which no time ever passes again.
    fn stuck(&self) -> Option<u32> {
        let mut leads_out = vec![false; self.nodes.len()];
        loop {
            let mut more = false;
            for (index, node) in self.nodes.iter().enumerate().rev() {
                let out = |to: &To| match to {
                    To::Node(node) => leads_out[*node],
                    To::Tangible(_) => true,
                };
                if !leads_out[index] && node.steps.iter().any(|(_, _, to)| out(to)) {
                    leads_out[index] = true;
                    more = true;
                }
            }
            if !more {
                let stuck = leads_out.iter().position(|out| !out)?;
                return Some(self.nodes[stuck].vanishing);
            }
        }
    }

    /// How often each node is visited on average. Without circles every node is passed on once, in an
    /// order in which all before it are done; with circles until nothing is left.
    fn visits(&self) -> Result<Vec<f64>, NotExact> {
        let count = self.nodes.len();
        let mut before = vec![0_usize; count];
        let nexts = |node: &Node| {
            let nodes = node.steps.iter().filter_map(|(_, part, to)| match to {
                To::Node(next) => Some((*next, *part)),
                To::Tangible(_) => None,
            });
            nodes.collect::<Vec<_>>()
        };
        for node in &self.nodes {
            for (next, _) in nexts(node) {
                before[next] += 1;
            }
        }
        let mut waits = vec![0.0; count];
        let mut visits = vec![0.0; count];
        waits[0] = 1.0;
        let mut ready: Vec<usize> = (0..count).filter(|node| before[*node] == 0).collect();
        while let Some(node) = ready.pop() {
            let now = std::mem::take(&mut waits[node]);
            visits[node] += now;
            for (next, part) in nexts(&self.nodes[node]) {
                waits[next] += now * part;
                before[next] -= 1;
                if before[next] == 0 {
                    ready.push(next);
                }
            }
        }
        // Nodes on circles, or after them. Every one leads out, so what is left gets less.
        for sweep in 0.. {
            let left: f64 = waits.iter().sum();
            if left <= LEFT_OVER {
                break;
            }
            if sweep == MOST_SWEEPS {
                return Err(NotExact::NoConvergence {
                    sweeps: sweep,
                    change: left,
                });
            }
            for node in 0..count {
                let now = std::mem::take(&mut waits[node]);
                if now > 0.0 {
                    visits[node] += now;
                    for (next, part) in nexts(&self.nodes[node]) {
                        waits[next] += now * part;
                    }
                }
            }
        }
        Ok(visits)
    }
}
