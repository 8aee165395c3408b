//! Arms and the room as solids, what of them can touch what, and whether anything will before all have come to rest.
//!
//! The way of all joints to rest is known in closed form. It is cut in halves, again and again, where that is needed:
//! two solids whose distances at both ends of a piece of the way are together more than what they can move meanwhile do
//! not touch in it. What one can move at most is bounded by the travel of the joints that carry it and its greatest
//! distance from their axes, so the answer is on the safe side however the joints turn.

use std::sync::Arc;

use mcs::Joints;
use mcs::guard::{Shown, Stopping};
use mcs::model::{Data, JointKind, Model, Placement, Solid};

use crate::distance::between;

/// A way is cut into so many pieces at most: a power of two.
pub const PIECES: usize = 32;
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
    /// The joints that carry it, each with the solid's greatest distance from its axis, m (1 of a joint that slides).
    levers: Vec<(usize, f64)>,
}

/// An arm that can be placed.
#[derive(Debug)]
struct Arm {
    model: Arc<Model>,
    data: Data,
    base: Placement,
    parts: Vec<Part>,
    position: Joints,
    /// How far each joint goes until rest, rad or m.
    travel: Joints,
    stopping: Stopping,
    late: f64,
    /// For each place on the way to rest, by index: the share of the travel behind, and the solids when they are placed.
    share: [f64; PIECES + 1],
    placed: Vec<Vec<Solid>>,
    ready: [bool; PIECES + 1],
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
#[derive(Debug)]
pub struct Scene {
    arms: Vec<Arm>,
    room: Vec<(String, Solid)>,
    pairs: Vec<Pair>,
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
                    solid: shape.solid,
                    levers,
                }
            })
            .collect()
    }
}

impl Arm {
    fn new(model: Arc<Model>, base: Placement) -> Self {
        let parts = Part::all(&model);
        let nowhere: Vec<Solid> = parts.iter().map(|part| part.solid).collect();
        let still = Joints::zeros(model.dof());
        Self {
            data: model.data(),
            placed: vec![nowhere; PIECES + 1],
            model,
            base,
            parts,
            position: still,
            travel: still,
            stopping: Stopping::default(),
            late: 0.0,
            share: [0.0; PIECES + 1],
            ready: [false; PIECES + 1],
        }
    }

    /// Takes what an arm does, whose braking begins `late` (s) from now.
    fn see(
        &mut self,
        position: &Joints,
        speed: impl Fn(usize) -> f64,
        stopping: Stopping,
        late: f64,
    ) {
        let whole = late + stopping.lead;
        self.position = *position;
        self.travel = Joints::from_fn(position.len(), |index| speed(index) * whole);
        self.stopping = stopping;
        self.late = late;
        self.ready = [false; PIECES + 1];
    }

    fn duration(&self) -> f64 {
        self.late + self.stopping.time
    }

    /// All are at rest after `horizon` (s).
    fn until(&mut self, horizon: f64) {
        for (index, share) in self.share.iter_mut().enumerate() {
            let t = horizon * index as f64 / PIECES as f64;
            *share = self.stopping.share(t, self.late);
        }
        // A way of no time at all is behind at its end, and not at its beginning.
        self.share[0] = 0.0;
    }

    /// Where the arm's solids are at a place of the way.
    fn at(&mut self, place: usize) -> &[Solid] {
        if !std::mem::replace(&mut self.ready[place], true) {
            let share = self.share[place];
            let q = Joints::from_fn(self.position.len(), |index| {
                self.position[index] + self.travel[index] * share
            });
            self.model.forward(&mut self.data, &q);
            for (placed, part) in self.placed[place].iter_mut().zip(&self.parts) {
                let carrier = self.base.then(&self.data.carrier(part.carrier));
                *placed = part.solid.seen_from(&carrier);
            }
        }
        &self.placed[place]
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
            room,
            pairs: Vec::new(),
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
                pairs.push(Pair { one, other, levers });
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
                arm.see(&q, |_| 0.0, Stopping::default(), 0.0);
                arm.until(0.0);
            }
            for (index, apart) in apart.iter_mut().enumerate() {
                *apart = *apart || self.distance(index, 0) > self.margin;
            }
        }
        let mut kept = apart.into_iter();
        self.pairs.retain(|_| kept.next().unwrap_or(true));
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

    /// Takes what an arm is to do: `late` (s) from now it begins to brake, `period` (s) is that of its servo.
    pub fn see(&mut self, arm: usize, shown: &Shown, late: f64) {
        if let Some(arm) = self.arms.get_mut(arm) {
            arm.see(
                &shown.position,
                |joint| shown.velocity[joint],
                shown.stopping,
                late,
            );
        }
    }

    fn placed(&mut self, (owner, index): Which, place: usize) -> Solid {
        match owner {
            Owner::Arm(arm) => self.arms[arm].at(place)[index],
            Owner::Room => self.room[index].1,
        }
    }

    fn distance(&mut self, pair: usize, place: usize) -> f64 {
        let Pair { one, other, .. } = self.pairs[pair];
        between(&self.placed(one, place), &self.placed(other, place))
    }

    /// What the two solids of a pair can move against one another at most between two places of the way, m.
    fn moves(&self, pair: usize, from: usize, to: usize) -> f64 {
        let levers = self.pairs[pair].levers.iter();
        levers.fold(0.0, |sum, (arm, joint, lever)| {
            let arm = &self.arms[*arm];
            sum + arm.travel[*joint].abs() * (arm.share[to] - arm.share[from]) * lever
        })
    }

    /// Looks whether anything comes nearer than the margin before all arms have come to rest, and what is nearest now.
    /// What is nearer already may move away, and no nearer. Allocates nothing.
    pub fn look(&mut self) -> Looked {
        let longest = self.arms.iter().map(Arm::duration).fold(0.0, f64::max);
        for arm in &mut self.arms {
            arm.until(longest);
        }
        let mut looked = Looked::default();
        for pair in 0..self.pairs.len() {
            let Pair { one, other, .. } = self.pairs[pair];
            let (one, other) = (self.placed(one, 0), self.placed(other, 0));
            let ((centre, radius), (middle, thick)) = (one.ball(), other.ball());
            let at_least = (centre - middle).norm() - radius - thick;
            let moves = self.moves(pair, 0, PIECES);
            let nearest = looked.nearest.map_or(f64::INFINITY, |near| near.now);
            if at_least > self.margin + moves && at_least > nearest {
                continue;
            }
            let now = between(&one, &other);
            let mut near = Near {
                pair,
                now,
                least: now,
            };
            if now < nearest {
                looked.nearest = Some(near);
            }
            if looked.touches.is_none() && now <= self.margin + moves {
                near.least = self.least(pair, now, self.margin);
                let touches = match now > self.margin {
                    true => near.least <= self.margin,
                    false => near.least < now - ROUNDING,
                };
                if touches {
                    looked.touches = Some(near);
                }
            }
        }
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
            arm.see(position, |_| 0.0, Stopping::default(), 0.0);
            arm.until(0.0);
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
        let own = self.arms.first_mut()?;
        // Without braking the time it is late is all of the way, at an even speed.
        own.see(
            from,
            |joint| to[joint] - from[joint],
            Stopping::default(),
            1.0,
        );
        for arm in &mut self.arms {
            arm.until(1.0);
        }
        for (pair, margin) in margins.iter().enumerate().take(self.pairs.len()) {
            let Pair { one, other, .. } = self.pairs[pair];
            let (one, other) = (self.placed(one, 0), self.placed(other, 0));
            let ((centre, radius), (middle, thick)) = (one.ball(), other.ball());
            let at_least = (centre - middle).norm() - radius - thick;
            if at_least > margin + self.moves(pair, 0, PIECES) {
                continue;
            }
            let now = between(&one, &other);
            let (keeps, least) = match now > *margin {
                true => self.keeps(pair, now, *margin, Smallest::Seen),
                false => (false, now),
            };
            if !keeps {
                return Some(Near { pair, now, least });
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
