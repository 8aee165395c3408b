//! Balance of large chains by iteration on several levels (G. Horton and S. T. Leutenegger, "A
//! multi-level solution algorithm for steady-state Markov chains", 1994). Sweeps alone even out what
//! is near; parts of a chain that hardly lead to each other they balance only after very long. So
//! states that are strongly coupled are taken together, and the smaller chain is balanced in the
//! same way. What it says of the parts is put back. Knows numbers only.

/// A sweep goes nine tenths of the way. Going all the way may swing for ever in a chain that returns
/// only after multiples of some number of jumps.
const RELAXATION: f64 = 0.9;

/// Sweeps before and after a smaller chain is balanced.
const SWEEPS: usize = 2;

/// Times that a smaller chain is gone through for each time of the larger one.
const VISITS: usize = 2;

/// A chain by where each state is entered from: `rates[begins[to]..begins[to + 1]]` holds states other
/// than `to` and the rate of each of them to `to`.
#[derive(Debug, Default)]
pub(super) struct Chain {
    begins: Vec<usize>,
    rates: Vec<(u32, f64)>,
    /// Sum of the rates at which each state is left.
    out: Vec<f64>,
}

impl Chain {
    /// Of rates to states other than the row's own.
    pub(super) fn new(rows: &[Vec<(usize, f64)>]) -> Self {
        let count = rows.len();
        let mut begins = vec![0_usize; count + 1];
        for (to, _) in rows.iter().flatten() {
            begins[to + 1] += 1;
        }
        for index in 0..count {
            begins[index + 1] += begins[index];
        }
        let mut filled = begins.clone();
        let mut rates = vec![(0_u32, 0.0_f64); begins[count]];
        for (from, row) in (0_u32..).zip(rows) {
            for (to, rate) in row {
                rates[filled[*to]] = (from, *rate);
                filled[*to] += 1;
            }
        }
        let out = rows.iter().map(|row| row.iter().map(|(_, r)| r).sum());
        Self {
            begins,
            rates,
            out: out.collect(),
        }
    }

    fn len(&self) -> usize {
        self.out.len()
    }

    fn into(&self, to: usize) -> &[(u32, f64)] {
        &self.rates[self.begins[to]..self.begins[to + 1]]
    }

    /// One sweep towards the balance of each state, Gauss and Seidel's way.
    pub(super) fn sweep(&self, parts: &mut [f64]) {
        for to in 0..self.len() {
            if self.out[to] > 0.0 {
                let entered = self.into(to).iter();
                let sum: f64 = entered
                    .map(|(from, rate)| parts[*from as usize] * rate)
                    .sum();
                parts[to] += RELAXATION * (sum / self.out[to] - parts[to]);
            }
        }
    }

    /// One cycle over this chain and smaller ones, down to one of `coarsest` states at most, which
    /// `solve` balances exactly.
    pub(super) fn cycle(&self, parts: &mut [f64], coarsest: usize, solve: Solve) {
        if self.len() <= coarsest.max(2) {
            let total: f64 = parts.iter().sum();
            let exact = solve(&self.rows(), &self.out);
            let times = exact.iter().zip(&self.out);
            let times = times.map(|(v, out)| if *out > 0.0 { v / out } else { 1.0 });
            let whole: f64 = times.clone().sum();
            for (part, time) in parts.iter_mut().zip(times) {
                *part = time / whole * total;
            }
            return;
        }
        for _ in 0..SWEEPS {
            self.sweep(parts);
        }
        let (group_of, groups) = self.groups();
        let mut sums = vec![0.0; groups];
        for (group, part) in group_of.iter().zip(&*parts) {
            sums[*group as usize] += part;
        }
        let smaller = self.together(&group_of, &sums, parts);
        let mut balanced = sums.clone();
        for _ in 0..VISITS {
            smaller.cycle(&mut balanced, coarsest, solve);
        }
        for (group, part) in group_of.iter().zip(&mut *parts) {
            let group = *group as usize;
            if sums[group] > 0.0 {
                *part *= balanced[group] / sums[group];
            }
        }
        for _ in 0..SWEEPS {
            self.sweep(parts);
        }
    }

    fn rows(&self) -> Vec<Vec<(usize, f64)>> {
        let mut rows = vec![Vec::new(); self.len()];
        for to in 0..self.len() {
            for (from, rate) in self.into(to) {
                rows[*from as usize].push((to, *rate));
            }
        }
        rows
    }

    /// The group of each state, and the number of groups. It is at most half that of states, since
    /// each state joins the one that it is coupled to most strongly.
    fn groups(&self) -> (Vec<u32>, usize) {
        const NONE: u32 = u32::MAX;
        let count = self.len();
        // The strongest coupling in either direction, as a part of all that leaves. Of equal ones the
        // nearest name counts, so that a ring is cut into pairs.
        let mut best = vec![(0.0_f64, NONE); count];
        let mut group_of = vec![NONE; count];
        let mut groups = 0_u32;
        for (to, name) in (0..count).zip(0_u32..) {
            for (from, rate) in self.into(to) {
                let part = rate / self.out[*from as usize];
                for (one, other) in [(name, *from), (*from, name)] {
                    let (most, held) = &mut best[one as usize];
                    let nearer = other.abs_diff(one) < held.abs_diff(one);
                    if part > *most || (part >= *most && nearer) {
                        (*most, *held) = (part, other);
                    }
                }
            }
        }
        for state in 0..count {
            if group_of[state] != NONE {
                continue;
            }
            let nearest = best[state].1 as usize;
            let group = match group_of.get(nearest).copied() {
                Some(NONE) => {
                    groups += 1;
                    group_of[nearest] = groups - 1;
                    groups - 1
                }
                Some(group) => group,
                None => {
                    groups += 1;
                    groups - 1
                }
            };
            group_of[state] = group;
        }
        (group_of, groups as usize)
    }

    /// The chain of groups, each state counting in its group as much as `parts` says.
    fn together(&self, group_of: &[u32], sums: &[f64], parts: &[f64]) -> Self {
        let groups = sums.len();
        let mut members = vec![Vec::new(); groups];
        for (state, group) in group_of.iter().enumerate() {
            members[*group as usize].push(state);
        }
        let mut smaller = Self {
            begins: vec![0],
            rates: Vec::new(),
            out: vec![0.0; groups],
        };
        let mut into = vec![0.0; groups];
        let mut touched: Vec<u32> = Vec::new();
        for (to, members) in (0_u32..).zip(&members) {
            for state in members {
                for (from, rate) in self.into(*state) {
                    let group = group_of[*from as usize];
                    let flow = rate * parts[*from as usize];
                    if group != to && flow > 0.0 {
                        if into[group as usize] <= 0.0 {
                            touched.push(group);
                        }
                        into[group as usize] += flow;
                    }
                }
            }
            for group in touched.drain(..) {
                let rate = std::mem::take(&mut into[group as usize]) / sums[group as usize];
                smaller.out[group as usize] += rate;
                smaller.rates.push((group, rate));
            }
            smaller.begins.push(smaller.rates.len());
        }
        smaller
    }
}

/// How the smallest chain is balanced: from its rows and what leaves each state, the visits of its
/// embedded chain.
pub(super) type Solve = fn(&[Vec<(usize, f64)>], &[f64]) -> Vec<f64>;
