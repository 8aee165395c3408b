//! The first step of a layered arrangement. It breaks circles, gives every node a layer, and gives
//! arcs over several layers a point in each of them.

/// A node of the arrangement: one of the graph, or a point of a long arc.
#[derive(Debug, Clone)]
pub(super) struct Vertex {
    pub(super) layer: usize,
    pub(super) width: f64,
    pub(super) height: f64,
    /// Of the graph; the rest are points of arcs.
    pub(super) real: bool,
    /// Neighbours in the layer before and in the layer after.
    pub(super) before: Vec<usize>,
    pub(super) after: Vec<usize>,
}

/// Points of long arcs, for each node and for a net as a whole. A net of many arcs over many layers would
/// have more points than a person can follow, and they would take most of the time.
const POINTS_PER_NODE: usize = 6;
const POINTS: usize = 500;

/// A graph in layers.
#[derive(Debug)]
pub(super) struct Layers {
    pub(super) vertices: Vec<Vertex>,
    /// The vertices of each layer, in order.
    pub(super) layers: Vec<Vec<usize>>,
    /// How many vertices are of the graph; they come first.
    pub(super) count: usize,
    /// The points of each arc, in its direction.
    pub(super) points: Vec<Vec<usize>>,
}

impl Layers {
    pub(super) fn new(sizes: &[(f64, f64)], arcs: &[(usize, usize)]) -> Self {
        let count = sizes.len();
        let arcs: Vec<Option<(usize, usize)>> = arcs
            .iter()
            .map(|&(from, to)| (from < count && to < count && from != to).then_some((from, to)))
            .collect();
        let reversed = circles(count, &arcs);
        let forward = |index: usize| {
            let (from, to) = arcs.get(index).copied().flatten()?;
            let back = reversed.get(index).copied().unwrap_or(false);
            Some(if back { (to, from) } else { (from, to) })
        };
        let layer_of = depths(count, (0..arcs.len()).filter_map(forward));
        let mut this = Self {
            vertices: sizes
                .iter()
                .zip(&layer_of)
                .map(|(&(width, height), &layer)| Vertex {
                    layer,
                    width,
                    height,
                    real: true,
                    before: Vec::new(),
                    after: Vec::new(),
                })
                .collect(),
            layers: Vec::new(),
            count,
            points: vec![Vec::new(); arcs.len()],
        };
        let spans = (0..arcs.len()).filter_map(forward);
        let spans = spans.map(|(from, to)| layer_of[to] - layer_of[from]);
        let longest = longest(spans.collect(), POINTS_PER_NODE * count + POINTS);
        for index in 0..arcs.len() {
            if let Some((from, to)) = forward(index) {
                if layer_of[to] - layer_of[from] > longest {
                    continue;
                }
                let mut points = this.thread(from, to);
                if reversed.get(index) == Some(&true) {
                    points.reverse();
                }
                this.points[index] = points;
            }
        }
        this.first_order();
        this
    }

    /// Leads an arc through the layers between its ends.
    fn thread(&mut self, from: usize, to: usize) -> Vec<usize> {
        let (first, last) = (self.vertices[from].layer, self.vertices[to].layer);
        let mut points = Vec::new();
        let mut at = from;
        for layer in first + 1..last {
            let point = self.vertices.len();
            self.vertices.push(Vertex {
                layer,
                width: 0.0,
                height: 6.0,
                real: false,
                before: Vec::new(),
                after: Vec::new(),
            });
            self.join(at, point);
            points.push(point);
            at = point;
        }
        self.join(at, to);
        points
    }

    fn join(&mut self, from: usize, to: usize) {
        self.vertices[from].after.push(to);
        self.vertices[to].before.push(from);
    }

    /// Depth first from the nodes of the first layer: neighbours stand beside each other.
    fn first_order(&mut self) {
        let depth = self.vertices.iter().map(|one| one.layer + 1).max();
        self.layers = vec![Vec::new(); depth.unwrap_or(0)];
        let mut seen = vec![false; self.vertices.len()];
        let mut roots: Vec<usize> = (0..self.vertices.len()).collect();
        roots.sort_by_key(|&one| self.vertices[one].layer);
        for root in roots {
            let mut stack = vec![root];
            while let Some(one) = stack.pop() {
                if std::mem::replace(&mut seen[one], true) {
                    continue;
                }
                let vertex = &self.vertices[one];
                self.layers[vertex.layer].push(one);
                stack.extend(vertex.after.iter().rev().filter(|next| !seen[**next]));
            }
        }
    }
}

/// The longest arcs that are led through the layers; longer ones go straight.
fn longest(mut spans: Vec<usize>, most_points: usize) -> usize {
    spans.sort_unstable();
    let mut points = 0;
    let all = spans.last().copied().unwrap_or(0);
    for span in spans {
        points += span.saturating_sub(1);
        if points > most_points {
            return span.saturating_sub(1);
        }
    }
    all
}

/// Which arcs must be turned round so that no circle is left. They are those that lead back to a
/// node that a depth-first walk has not left yet.
fn circles(count: usize, arcs: &[Option<(usize, usize)>]) -> Vec<bool> {
    let mut out: Vec<Vec<(usize, usize)>> = vec![Vec::new(); count];
    let mut comes_in = vec![false; count];
    for (index, arc) in arcs.iter().enumerate() {
        if let Some((from, to)) = *arc {
            out[from].push((index, to));
            comes_in[to] = true;
        }
    }
    #[derive(Clone, Copy, PartialEq)]
    enum Walk {
        New,
        Open,
        Left,
    }
    let mut walk = vec![Walk::New; count];
    let mut reversed = vec![false; arcs.len()];
    let roots = (0..count).filter(|one| !comes_in[*one]).chain(0..count);
    for root in roots {
        if walk[root] != Walk::New {
            continue;
        }
        walk[root] = Walk::Open;
        let mut stack = vec![(root, 0)];
        while let Some((one, next)) = stack.last_mut() {
            let Some(&(index, to)) = out[*one].get(*next) else {
                walk[*one] = Walk::Left;
                stack.pop();
                continue;
            };
            *next += 1;
            match walk[to] {
                Walk::Open => reversed[index] = true,
                Walk::New => {
                    walk[to] = Walk::Open;
                    stack.push((to, 0));
                }
                Walk::Left => {}
            }
        }
    }
    reversed
}

/// The layer of every node of a graph without circles. It is as far left as its arcs allow, and then
/// as near to its successors as its predecessors allow.
fn depths(count: usize, arcs: impl Iterator<Item = (usize, usize)>) -> Vec<usize> {
    let mut after: Vec<Vec<usize>> = vec![Vec::new(); count];
    let mut left = vec![0_usize; count];
    for (from, to) in arcs {
        after[from].push(to);
        left[to] += 1;
    }
    let lone: Vec<bool> = left.iter().map(|left| *left == 0).collect();
    let mut order: Vec<usize> = (0..count).filter(|one| lone[*one]).collect();
    let mut layer = vec![0_usize; count];
    let mut next = 0;
    while let Some(&one) = order.get(next) {
        next += 1;
        for &to in &after[one] {
            layer[to] = layer[to].max(layer[one] + 1);
            left[to] -= 1;
            if left[to] == 0 {
                order.push(to);
            }
        }
    }
    for &one in order.iter().rev().filter(|one| lone[**one]) {
        let nearest = after[one].iter().map(|to| layer[*to]).min();
        layer[one] = nearest.map_or(0, |nearest| nearest.saturating_sub(1));
    }
    layer
}
