//! Arms and the room as solids, what of them can touch what, and whether anything will before all have come to rest.
//!
//! Of the way of all joints to rest some places are known, and between two of them the joints go in proportion. The way is
//! cut in halves, again and again, where that is needed: two solids whose distances at both ends of a piece of it are together
//! more than what they can move meanwhile do not touch in it. The travel of the joints that carry a solid, and its greatest
//! distance from their axes, bound what it can move. So the answer is on the safe side, however the joints turn.
//!
//! Most pairs are far apart: the balls around their solids say so at once.

use std::sync::Arc;

use mcs::Joints;
use mcs::guard::{Shown, Stopping};
use mcs::model::{Data, JointKind, Model, Placement, Solid};
use mcs::trajectory::REST_PARTS;
use nalgebra::Vector3;

use crate::distance::between;

/// A way is cut into so many pieces at most: a power of two.
pub const PIECES: usize = 64;
/// The places of a way that are known: now, and those of a way to rest.
const NODES: usize = REST_PARTS + 2;
/// Positions at which pairs are looked at when a scene is made.
const SAMPLES: u32 = 256;
/// The room for a joint without limits on either side, rad or m.
const UNLIMITED: f64 = std::f64::consts::PI;
/// Nearer than before by less than this, m, is rounding.
const ROUNDING: f64 = 1e-7;

/// A solid with what moves it.
#[derive(Debug, Clone)]
struct Part {
    name: String,
    carrier: Option<usize>,
    solid: Solid,
    /// The radius of the ball around it, m.
    radius: f64,
    /// The joints that carry it, each with the solid's greatest distance from its axis, m (1 of a joint that slides).
    levers: Vec<(usize, f64)>,
}

/// An arm that can be placed.
#[derive(Debug, Clone)]
struct Arm {
    model: Arc<Model>,
    data: Data,
    base: Placement,
    parts: Vec<Part>,
    way: Way,
    /// For each place on the way, by index: the solids when they are placed,
    placed: Vec<Vec<Solid>>,
    ready: [bool; PIECES + 1],
    /// and the middles of the balls around them now, m.
    middles: Vec<Vector3<f64>>,
}

/// How joints go from where they are to rest.
#[derive(Debug, Clone, Copy)]
struct Way {
    nodes: [Joints; NODES],
    /// How far each joint has gone when it is at a node, rad or m.
    gone: [Joints; NODES],
    /// The time from now until the braking begins, and from then until rest, s.
    late: f64,
    time: f64,
    /// For each place: the node behind it, and how far from that to the next it is, 0 to 1.
    at: [(usize, f64); PIECES + 1],
}

/// Which solid: of an arm, or of the room.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Owner {
    Arm(usize),
    Room,
}

type Which = (Owner, usize);

/// Two solids that can touch.
#[derive(Debug, Clone)]
struct Pair {
    one: Which,
    other: Which,
    /// The joints that move one against the other: arm, joint, lever.
    levers: Vec<(usize, usize, f64)>,
    /// The distance that is kept, m.
    margin: f64,
}

/// Two solids and how far they are from one another.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Near {
    /// The pair, by index in [`Scene::names`].
    pub pair: usize,
    /// Their distance now, m.
    pub now: f64,
    /// The least one that was found on their way to rest, m.
    pub least: f64,
    /// The one that is kept, m.
    pub margin: f64,
}

/// What a look at the scene came to.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Looked {
    /// The pair that is nearest now.
    pub nearest: Option<Near>,
    /// A pair that would come nearer than the margin before all rest.
    pub touches: Option<Near>,
}

/// Arms and the room. The first arm is the one whose base frame all is in.
#[derive(Debug, Clone)]
pub struct Scene {
    arms: Vec<Arm>,
    room: Vec<(String, Solid)>,
    /// The balls around the solids of the room.
    balls: Vec<(Vector3<f64>, f64)>,
    pairs: Vec<Pair>,
    /// The pair that was nearest at the last look: it probably is again.
    nearest: usize,
    margin: f64,
}

impl Part {
    /// The parts of a model, their levers included.
    fn all(model: &Model) -> Vec<Self> {
        let joints = model.joints();
        model
            .shapes()
            .iter()
            .map(|shape| {
                let mut levers = Vec::new();
                // From the joint that carries it down to the ground the bound grows by the ways between the joints.
                let mut reach = shape.solid.reach();
                let mut at = shape.carrier;
                while let Some(joint) = at.and_then(|index| joints.get(index)) {
                    let slides = joint.kind == JointKind::Prismatic;
                    levers.extend(at.map(|index| (index, if slides { 1.0 } else { reach })));
                    if slides {
                        let limits = joint.limits;
                        let room = limits.lower.abs().max(limits.upper.abs());
                        reach += if room.is_finite() { room } else { UNLIMITED };
                    }
                    reach += joint.placement.origin.norm();
                    at = joint.parent;
                }
                Self {
                    name: model.at(shape.frame).name.clone(),
                    carrier: shape.carrier,
                    solid: shape.solid.clone(),
                    radius: shape.solid.ball().1,
                    levers,
                }
            })
            .collect()
    }
}

impl Default for Way {
    fn default() -> Self {
        Self {
            nodes: Default::default(),
            gone: Default::default(),
            late: 0.0,
            time: 0.0,
            at: [(0, 0.0); PIECES + 1],
        }
    }
}

impl Way {
    /// Of joints that are at `position` now. After `late` (s) of their speeds in the next period they begin to brake.
    fn new(position: &Joints, speed: &Joints, stopping: &Stopping, late: f64, period: f64) -> Self {
        let mut way = Self {
            late,
            time: stopping.time,
            ..Self::default()
        };
        let [now, then @ ..] = &mut way.nodes;
        *now = *position;
        for (node, place) in then.iter_mut().zip(&stopping.way) {
            // Who brakes later is farther by then.
            *node = Joints::from_fn(position.len(), |index| {
                place[index] + speed[index] * (late - period)
            });
        }
        way.sum_up()
    }

    /// Straight from one position to another, evenly, in a time of 1.
    fn straight(from: &Joints, to: &Joints) -> Self {
        let mut way = Self {
            late: 1.0,
            nodes: [*to; NODES],
            ..Self::default()
        };
        way.nodes[0] = *from;
        way.sum_up()
    }

    fn sum_up(mut self) -> Self {
        self.gone[0] = Joints::zeros(self.nodes[0].len());
        for node in 1..NODES {
            let [from, to] = [&self.nodes[node - 1], &self.nodes[node]];
            let gone = &self.gone[node - 1];
            self.gone[node] = Joints::from_fn(to.len(), |index| {
                gone[index] + (to[index] - from[index]).abs()
            });
        }
        self
    }

    fn duration(&self) -> f64 {
        self.late + self.time
    }

    /// All are at rest after `horizon` (s), which is cut into equal pieces.
    fn until(&mut self, horizon: f64) {
        for (place, at) in self.at.iter_mut().enumerate() {
            let t = horizon * place as f64 / PIECES as f64;
            *at = match place {
                // A way of no time at all is behind at its end, and not at its beginning.
                0 => (0, 0.0),
                _ if t < self.late => (0, t / self.late),
                _ if t >= self.late + self.time => (NODES - 2, 1.0),
                _ => braked((t - self.late) / self.time),
            };
        }
    }

    fn position(&self, place: usize) -> Joints {
        let (node, share) = self.at[place];
        let [from, to] = [&self.nodes[node], &self.nodes[node + 1]];
        Joints::from_fn(from.len(), |index| {
            from[index] + (to[index] - from[index]) * share
        })
    }

    /// How far a joint has gone at a place, rad or m.
    fn gone(&self, place: usize, joint: usize) -> f64 {
        let (node, share) = self.at[place];
        let [from, to] = [self.gone[node][joint], self.gone[node + 1][joint]];
        from + (to - from) * share
    }

    /// How far a joint goes in all, rad or m.
    fn travel(&self, joint: usize) -> f64 {
        let [.., all] = &self.gone;
        all[joint]
    }
}

/// The node behind a share of the time of braking, and how far to the next one a joint is that brakes evenly until rest.
fn braked(share: f64) -> (usize, f64) {
    let behind = |share: f64| share * (2.0 - share);
    let parts = REST_PARTS as f64;
    // The share is at least 0, and less than 1.
    let part = ((share * parts) as usize).min(REST_PARTS - 1);
    let [from, to] = [part, part + 1].map(|part| behind(part as f64 / parts));
    (
        1 + part,
        ((behind(share) - from) / (to - from)).clamp(0.0, 1.0),
    )
}

impl Arm {
    fn new(model: Arc<Model>, base: Placement) -> Self {
        let parts = Part::all(&model);
        let nowhere: Vec<Solid> = parts.iter().map(|part| part.solid.clone()).collect();
        let still = Joints::zeros(model.dof());
        Self {
            data: model.data(),
            placed: vec![nowhere; PIECES + 1],
            middles: vec![Vector3::zeros(); parts.len()],
            model,
            base,
            parts,
            way: Way::straight(&still, &still),
            ready: [false; PIECES + 1],
        }
    }

    /// Takes how the joints go.
    fn goes(&mut self, way: Way) {
        self.way = way;
        self.ready = [false; PIECES + 1];
    }

    /// Takes that the joints stand there.
    fn stands(&mut self, position: &Joints) {
        self.goes(Way::straight(position, position));
        self.way.until(0.0);
    }

    /// Where the arm's solids are at a place of the way.
    fn at(&mut self, place: usize) -> &[Solid] {
        if !std::mem::replace(&mut self.ready[place], true) {
            let q = self.way.position(place);
            self.model.forward(&mut self.data, &q);
            for (placed, part) in self.placed[place].iter_mut().zip(&self.parts) {
                let carrier = self.base.then(&self.data.carrier(part.carrier));
                *placed = part.solid.seen_from(&carrier);
            }
        }
        &self.placed[place]
    }

    /// Finds the middles of the balls around the solids.
    fn see_middles(&mut self) {
        self.at(0);
        for (middle, solid) in self.middles.iter_mut().zip(&self.placed[0]) {
            *middle = middle_of(solid);
        }
    }
}

/// The middle of the ball around a solid, m.
fn middle_of(solid: &Solid) -> Vector3<f64> {
    match solid {
        Solid::Capsule { a, b, .. } => 0.5 * (a + b),
        Solid::Block { at, .. } | Solid::Hull { at, .. } => at.origin,
    }
}

/// Positions spread evenly over the room of a model's joints: the additive recurrence of M. Roberts, which fills any
/// number of dimensions and needs no seed.
fn spread(model: &Model, sample: u32) -> Joints {
    let n = model.dof();
    // The one root above 1 of x^(n+1) = x + 1.
    let mut root = 1.5_f64;
    for _ in 0..32 {
        root = (1.0 + root).powf(1.0 / (n as f64 + 1.0));
    }
    Joints::from_fn(n, |index| {
        let step = root.powi(-(index as i32 + 1));
        let share = (0.5 + f64::from(sample) * step).fract();
        let limits = &model.joints()[index].limits;
        let low = limits.lower.max(-UNLIMITED);
        let high = limits.upper.min(UNLIMITED);
        low + (high - low) * share
    })
}

impl Scene {
    /// The arms, each with its base in the base frame of the first, and the solids of the room there, by name.
    /// `margin` is the distance that is kept, m.
    ///
    /// Links that follow one another are no pair, nor are solids that are never farther apart than the margin, nor
    /// those between which nothing moves, nor two of other arms than the first.
    #[must_use]
    pub fn new(
        arms: impl IntoIterator<Item = (Arc<Model>, Placement)>,
        room: Vec<(String, Solid)>,
        margin: f64,
    ) -> Self {
        let arms = arms.into_iter().map(|(model, base)| Arm::new(model, base));
        let mut scene = Self {
            arms: arms.collect(),
            balls: room.iter().map(|(_, solid)| solid.ball()).collect(),
            room,
            pairs: Vec::new(),
            nearest: 0,
            margin,
        };
        scene.pairs = scene.candidates();
        scene.leave_out_what_always_touches();
        scene
    }

    fn candidates(&self) -> Vec<Pair> {
        let mut pairs = Vec::new();
        let Some(own) = self.arms.first() else {
            return pairs;
        };
        let mut put = |one: Which, other: Which, levers: Vec<(usize, usize, f64)>| {
            if !levers.is_empty() {
                pairs.push(Pair {
                    one,
                    other,
                    levers,
                    margin: self.margin,
                });
            }
        };
        let parent = |part: &Part| part.carrier.and_then(|at| own.model.joints()[at].parent);
        for (index, part) in own.parts.iter().enumerate() {
            let one = (Owner::Arm(0), index);
            for (later, other) in own.parts.iter().enumerate().skip(index + 1) {
                let follows = |one: &Part, other: &Part| {
                    one.carrier.is_some() && parent(one) == other.carrier
                };
                let together = part.carrier == other.carrier;
                if together || follows(part, other) || follows(other, part) {
                    continue;
                }
                // A joint that carries both moves neither against the other.
                let only = |one: &Part, other: &Part| {
                    let both = |joint| other.levers.iter().any(|(same, _)| *same == joint);
                    let own = one.levers.iter().filter(|(joint, _)| !both(*joint));
                    own.map(|(joint, lever)| (0, *joint, *lever))
                        .collect::<Vec<_>>()
                };
                let levers = [only(part, other), only(other, part)].concat();
                put(one, (Owner::Arm(0), later), levers);
            }
            let moved = |arm: usize, part: &Part| {
                let all = part.levers.iter();
                all.map(move |(joint, lever)| (arm, *joint, *lever))
                    .collect::<Vec<_>>()
            };
            for (number, arm) in self.arms.iter().enumerate().skip(1) {
                for (later, other) in arm.parts.iter().enumerate() {
                    let levers = [moved(0, part), moved(number, other)].concat();
                    put(one, (Owner::Arm(number), later), levers);
                }
            }
            for later in 0..self.room.len() {
                put(one, (Owner::Room, later), moved(0, part));
            }
        }
        pairs
    }

    fn leave_out_what_always_touches(&mut self) {
        let mut apart = vec![false; self.pairs.len()];
        for sample in 0..SAMPLES {
            // Other arms at other places than this one at the same time.
            for (arm, step) in self.arms.iter_mut().zip(1..) {
                let q = spread(&arm.model, sample * step + step);
                arm.stands(&q);
            }
            for (index, apart) in apart.iter_mut().enumerate() {
                *apart = *apart || self.distance(index, 0) > self.margin;
            }
        }
        let mut kept = apart.into_iter();
        self.pairs.retain(|_| kept.next().unwrap_or(true));
    }

    /// Has a solid of the first arm keep another distance (m) from a piece of the room, each by its name. Whether there is such a
    /// solid.
    pub fn keep(&mut self, solid: &str, piece: &str, margin: f64) -> bool {
        let own = |part: &Part| part.name == solid;
        let is_known = self
            .arms
            .first()
            .is_some_and(|arm| arm.parts.iter().any(own));
        for (pair, [one, other]) in self.names().iter().enumerate() {
            if one == solid && other == piece && self.pairs[pair].other.0 == Owner::Room {
                self.pairs[pair].margin = margin;
            }
        }
        is_known
    }

    /// The distance that each pair keeps, m; by pair as in [`Self::names`].
    #[must_use]
    pub fn margins(&self) -> Vec<f64> {
        self.pairs.iter().map(|pair| pair.margin).collect()
    }

    /// The names of both solids of each pair.
    #[must_use]
    pub fn names(&self) -> Vec<[String; 2]> {
        let name = |(owner, index): Which| match owner {
            Owner::Arm(0) => self.arms[0].parts[index].name.clone(),
            Owner::Arm(arm) => {
                let arm = &self.arms[arm];
                format!(
                    "{} of the other {}",
                    arm.parts[index].name,
                    arm.model.name()
                )
            }
            Owner::Room => self.room[index].0.clone(),
        };
        let pairs = self.pairs.iter();
        pairs
            .map(|pair| [name(pair.one), name(pair.other)])
            .collect()
    }

    /// Both solids of a pair with the arms at these positions, rad or m, in the order of the arms.
    #[must_use]
    pub fn solids(&self, pair: usize, positions: &[&[f64]]) -> Option<[Solid; 2]> {
        let Pair { one, other, .. } = self.pairs.get(pair)?;
        let place = |(owner, index): Which| match owner {
            Owner::Arm(number) => {
                let (arm, q) = (self.arms.get(number)?, positions.get(number)?);
                let part = arm.parts.get(index)?;
                let mut data = arm.model.data();
                arm.model.forward(&mut data, q);
                let carrier = arm.base.then(&data.carrier(part.carrier));
                Some(part.solid.seen_from(&carrier))
            }
            Owner::Room => Some(self.room.get(index)?.1.clone()),
        };
        Some([place(*one)?, place(*other)?])
    }

    /// Takes what an arm is to do: `late` (s) from now it begins to brake, `period` (s) is that of its servo.
    pub fn see(&mut self, arm: usize, shown: &Shown, late: f64, period: f64) {
        if let Some(arm) = self.arms.get_mut(arm) {
            let Shown {
                position, velocity, ..
            } = shown;
            arm.goes(Way::new(position, velocity, &shown.stopping, late, period));
        }
    }

    /// A solid at a place of the way for which those of its arm are found.
    fn placed(&self, (owner, index): Which, place: usize) -> &Solid {
        match owner {
            Owner::Arm(arm) => &self.arms[arm].placed[place][index],
            Owner::Room => &self.room[index].1,
        }
    }

    fn distance(&mut self, pair: usize, place: usize) -> f64 {
        let Pair { one, other, .. } = self.pairs[pair];
        for (owner, _) in [one, other] {
            if let Owner::Arm(arm) = owner {
                self.arms[arm].at(place);
            }
        }
        between(self.placed(one, place), self.placed(other, place))
    }

    /// What the two solids of a pair can move against one another at most between two places of the way, m.
    fn moves(&self, pair: usize, from: usize, to: usize) -> f64 {
        let levers = self.pairs[pair].levers.iter();
        levers.fold(0.0, |sum, (arm, joint, lever)| {
            let way = &self.arms[*arm].way;
            sum + (way.gone(to, *joint) - way.gone(from, *joint)) * lever
        })
    }

    /// The same on all of the way.
    fn moves_in_all(&self, pair: &Pair) -> f64 {
        let levers = pair.levers.iter();
        levers.fold(0.0, |sum, (arm, joint, lever)| {
            sum + self.arms[*arm].way.travel(*joint) * lever
        })
    }

    /// The ball around a solid now: its middle, and its radius, m.
    fn ball(&self, (owner, index): Which) -> (&Vector3<f64>, f64) {
        match owner {
            Owner::Arm(arm) => {
                let arm = &self.arms[arm];
                (&arm.middles[index], arm.parts[index].radius)
            }
            Owner::Room => {
                let (middle, radius) = &self.balls[index];
                (middle, *radius)
            }
        }
    }

    /// Whether the balls around a pair are farther apart now than this, m.
    fn is_far(&self, pair: &Pair, apart: f64) -> bool {
        let ((centre, radius), (middle, thick)) = (self.ball(pair.one), self.ball(pair.other));
        (centre - middle).norm_squared() > (radius + thick + apart).powi(2)
    }

    /// Looks whether anything comes nearer than the margin before all arms have come to rest, and what is nearest now.
    /// What is nearer already may move away, and no nearer. Allocates nothing.
    pub fn look(&mut self) -> Looked {
        let ways = self.arms.iter().map(|arm| arm.way.duration());
        let longest = ways.fold(0.0, f64::max);
        for arm in &mut self.arms {
            arm.way.until(longest);
            arm.see_middles();
        }
        let mut looked = Looked::default();
        let again = self.nearest.min(self.pairs.len());
        let all = (again..self.pairs.len()).take(1).chain(0..self.pairs.len());
        for (order, index) in all.enumerate() {
            if order > 0 && index == again {
                continue;
            }
            let pair = &self.pairs[index];
            let nearest = looked.nearest.map_or(f64::INFINITY, |near| near.now);
            let margin = pair.margin;
            let keeps = margin + self.moves_in_all(pair);
            if self.is_far(pair, keeps.max(nearest)) {
                continue;
            }
            let now = self.distance(index, 0);
            let mut near = Near {
                pair: index,
                now,
                least: now,
                margin,
            };
            if now < nearest {
                looked.nearest = Some(near);
            }
            if looked.touches.is_none() && now <= keeps {
                near.least = self.least(index, now, margin);
                let touches = match now > margin {
                    true => near.least <= margin,
                    false => near.least < now - ROUNDING,
                };
                if touches {
                    looked.touches = Some(near);
                }
            }
        }
        self.nearest = looked.nearest.map_or(0, |near| near.pair);
        looked
    }

    /// The least distance of a pair on its way, or one at most the margin as soon as it may be no more; of what is
    /// nearer than the margin already, the least one of some places of the way.
    fn least(&mut self, pair: usize, now: f64, margin: f64) -> f64 {
        if now <= margin {
            let places = [PIECES / 8, PIECES / 4, PIECES / 2, PIECES];
            return places
                .into_iter()
                .fold(now, |least, place| least.min(self.distance(pair, place)));
        }
        match self.keeps(pair, now, margin, Smallest::Certain) {
            (true, least) => least,
            (false, least) => least.min(margin),
        }
    }

    /// Whether a pair that is `now` (m) apart keeps a distance on its way, and the least distance of the places that were
    /// looked at: from one end to the other, by the largest pieces that are surely free.
    fn keeps(&mut self, pair: usize, now: f64, margin: f64, smallest: Smallest) -> (bool, f64) {
        let (mut from, mut there, mut size) = (0, now, PIECES);
        let mut least = now;
        while from < PIECES {
            let to = from + size;
            let then = self.distance(pair, to);
            least = least.min(then);
            if then <= margin {
                return (false, least);
            }
            let surely = there + then - 2.0 * margin > self.moves(pair, from, to);
            let seen = size == 1 && smallest == Smallest::Seen;
            if surely || seen {
                from = to;
                there = then;
                // The largest piece that begins here.
                size = match from {
                    PIECES => 1,
                    _ => 1 << from.trailing_zeros(),
                };
            } else if size == 1 {
                return (false, least);
            } else {
                size /= 2;
            }
        }
        (true, least)
    }

    /// How far anything of the first arm moves at most when a joint moves, for each joint: m per rad, or per m of one that
    /// slides.
    #[must_use]
    pub fn levers(&self) -> Joints {
        let Some(own) = self.arms.first() else {
            return Joints::default();
        };
        let mut most = Joints::zeros(own.model.dof());
        for (joint, lever) in own.parts.iter().flat_map(|part| &part.levers) {
            most[*joint] = most[*joint].max(*lever);
        }
        most
    }

    /// Places an arm, which stands still.
    pub fn stands(&mut self, arm: usize, position: &Joints) {
        if let Some(arm) = self.arms.get_mut(arm) {
            arm.stands(position);
        }
    }

    /// How far the solids of each pair are from one another with the first arm at a position, m; by pair as in
    /// [`Self::names`].
    pub fn distances(&mut self, position: &Joints, out: &mut Vec<f64>) {
        self.stands(0, position);
        out.clear();
        for pair in 0..self.pairs.len() {
            let distance = self.distance(pair, 0);
            out.push(distance);
        }
    }

    /// How far the joints of the first arm may be from a position, rad or m, all at once and each by its part of this. Beyond
    /// that a pair may be nearer than its distance of `margins` (m). Below zero where one is nearer at the position itself.
    pub fn leeway(&mut self, position: &Joints, parts: &Joints, margins: &[f64]) -> f64 {
        self.stands(0, position);
        let mut least = f64::INFINITY;
        for (pair, margin) in margins.iter().enumerate().take(self.pairs.len()) {
            let levers = &self.pairs[pair].levers;
            let own = levers.iter().filter(|(arm, ..)| *arm == 0);
            let moves: f64 = own.map(|(_, joint, lever)| lever * parts[*joint]).sum();
            let room = self.distance(pair, 0) - margin;
            // What does not move against one another may stay as near as it is.
            if moves > 0.0 || room < 0.0 {
                least = least.min(room / moves.max(f64::MIN_POSITIVE));
            }
        }
        least
    }

    /// A pair that comes nearer than its distance of `margins` (m) while the first arm goes from a position to another one,
    /// its joints in proportion, and the others stand still. The way is cut into [`PIECES`] places at most: between two of
    /// them a pair may be nearer by half of what it can move meanwhile. Allocates nothing.
    pub fn straight(&mut self, [from, to]: [&Joints; 2], margins: &[f64]) -> Option<Near> {
        self.arms.first_mut()?.goes(Way::straight(from, to));
        for arm in &mut self.arms {
            arm.way.until(1.0);
            arm.see_middles();
        }
        for (index, margin) in margins.iter().enumerate().take(self.pairs.len()) {
            let pair = &self.pairs[index];
            if self.is_far(pair, margin + self.moves_in_all(pair)) {
                continue;
            }
            let now = self.distance(index, 0);
            let (keeps, least) = match now > *margin {
                true => self.keeps(index, now, *margin, Smallest::Seen),
                false => (false, now),
            };
            if !keeps {
                return Some(Near {
                    pair: index,
                    now,
                    least,
                    margin: *margin,
                });
            }
        }
        None
    }
}

/// What counts in a piece of the way that is cut no more.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Smallest {
    /// It must be certain that nothing is nearer in it.
    Certain,
    /// Nothing is nearer at its ends.
    Seen,
}

#[cfg(test)]
mod tests;
