//! What an arm may do: which positions, and which straight ways of its joints, are free. Knows no search.

use std::fmt;
use std::sync::Arc;

use mcs::Joints;
use mcs::model::{Model, Placement, Solid};
use mcs_collision::scene::{PIECES, Scene};

/// A straight way is looked at every so often: so far anything of the arm moves at most between two places, m.
pub const RESOLUTION_M: f64 = 0.005;
/// A joint that carries nothing, or next to nothing, counts as if it moved something by this, m per rad or m.
const LEAST_LEVER: f64 = 0.05;

/// Two solids that are too near one another.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Touch {
    /// The names of both.
    pub pair: [String; 2],
    /// How far they are from one another, m; below zero where one is in the other.
    pub distance_m: f64,
}

impl fmt::Display for Touch {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [one, other] = &self.pair;
        match self.distance_m {
            inside if inside <= 0.0 => write!(f, "{one} is in {other}"),
            apart => write!(f, "{one} is {:.1} mm from {other}", apart * 1e3),
        }
    }
}

/// An arm among other arms, which stand still, and the solids of the room.
#[derive(Debug)]
pub struct Space {
    model: Arc<Model>,
    scene: Scene,
    names: Vec<[String; 2]>,
    levers: Joints,
    margins: Vec<f64>,
    distances: Vec<f64>,
}

impl Space {
    /// The space of an arm. Other arms stand with their base frames where the placements say, in that of the first, and
    /// their joints at the positions given. `margin` is the distance that is kept, m.
    #[must_use]
    pub fn new(
        model: Arc<Model>,
        others: Vec<(Arc<Model>, Placement, Joints)>,
        room: Vec<(String, Solid)>,
        margin: f64,
    ) -> Self {
        let own = (Arc::clone(&model), Placement::identity());
        let arms = others.iter().map(|(model, at, _)| (Arc::clone(model), *at));
        let mut scene = Scene::new(std::iter::once(own).chain(arms), room, margin);
        for ((.., position), arm) in others.iter().zip(1..) {
            scene.stands(arm, position);
        }
        let names = scene.names();
        let mut levers = scene.levers();
        for lever in levers.iter_mut() {
            *lever = lever.max(LEAST_LEVER);
        }
        Self {
            model,
            levers,
            margins: vec![margin; names.len()],
            distances: Vec::with_capacity(names.len()),
            names,
            scene,
        }
    }

    /// The same where solids of the arm keep other distances (m) from pieces of the room, each by its name: what a guard goes by.
    #[must_use]
    pub fn with_near(mut self, near: &[(String, String, f64)]) -> Self {
        for (solid, piece, distance) in near {
            self.scene.keep(solid, piece, *distance);
        }
        self.margins = self.scene.margins();
        self
    }

    /// The arm.
    #[must_use]
    pub fn model(&self) -> &Arc<Model> {
        &self.model
    }

    /// How far (m) something of the arm moves at most when one joint alone moves by one rad, or one m, for each joint.
    #[must_use]
    pub fn levers(&self) -> &Joints {
        &self.levers
    }

    /// How far from one another positions are: the root of the sum of squares of what each joint's way moves at most, m.
    #[must_use]
    pub fn distance(&self, from: &Joints, to: &Joints) -> f64 {
        let ways = self.ways(from, to);
        ways.map(|way| way * way).sum::<f64>().sqrt()
    }

    /// What each joint's way moves at most, m.
    fn ways<'a>(&'a self, from: &'a Joints, to: &'a Joints) -> impl Iterator<Item = f64> + 'a {
        let ends = from.iter().zip(to);
        let levers = self.levers.iter();
        levers
            .zip(ends)
            .map(|(lever, (from, to))| lever * (to - from).abs())
    }

    /// The pair that is nearest at a position; none where nothing can touch anything.
    pub fn nearest(&mut self, at: &Joints) -> Option<Touch> {
        self.scene.distances(at, &mut self.distances);
        let (pair, distance) = self.least()?;
        Some(self.touch(pair, distance))
    }

    /// Whether the arm keeps its distances at a position.
    ///
    /// # Errors
    /// A pair that is too near.
    pub fn stands_free(&mut self, at: &Joints) -> Result<(), Touch> {
        self.look(at).map(|_| ())
    }

    /// The same; the pair that is nearest, by number, and its distance, m.
    pub(crate) fn look(&mut self, at: &Joints) -> Result<Option<(usize, f64)>, Touch> {
        self.scene.distances(at, &mut self.distances);
        let all = self.distances.iter().zip(&self.margins);
        let near = all
            .enumerate()
            .filter(|(_, (distance, margin))| distance <= margin);
        let worst = near.min_by(|(_, (one, _)), (_, (other, _))| one.total_cmp(other));
        match worst {
            None => Ok(self.least()),
            Some((pair, (distance, _))) => Err(self.touch(pair, *distance)),
        }
    }

    fn least(&self) -> Option<(usize, f64)> {
        let all = self.distances.iter().copied().enumerate();
        all.min_by(|(_, one), (_, other)| one.total_cmp(other))
    }

    /// Whether the arm keeps its distances while its joints go in proportion from one position to another. Every
    /// [`RESOLUTION_M`] they are kept for certain, and between them missed by no more than half of that.
    ///
    /// # Errors
    /// A pair that comes too near.
    pub fn goes_free(&mut self, from: &Joints, to: &Joints) -> Result<(), Touch> {
        let all: f64 = self.ways(from, to).sum();
        let parts = (all / (PIECES as f64 * RESOLUTION_M)).ceil().max(1.0);
        let at = |part: f64| between(from, to, part / parts);
        let mut here = *from;
        // The count is that of a way within the limits, or of one that a caller made up.
        for part in 1..=parts as u64 {
            let there = at(part as f64);
            if let Some(near) = self.scene.straight([&here, &there], &self.margins) {
                return Err(self.touch(near.pair, near.least));
            }
            here = there;
        }
        Ok(())
    }

    /// How far the joints may be from a position, all at once and each by its part of this (at most 1), with all distances
    /// still kept, rad or m; 0 where they are not kept there.
    pub fn leeway(&mut self, at: &Joints, parts: &Joints) -> f64 {
        self.scene.leeway(at, parts, &self.margins).max(0.0)
    }

    /// Keeps so much more (m) of every distance; returns those that were kept before.
    pub(crate) fn widen(&mut self, more: f64) -> Vec<f64> {
        let wider = self.margins.iter().map(|margin| margin + more).collect();
        self.keep(wider)
    }

    /// The same space with the distances that solids have at a position where those are less than the margin, and still
    /// more than `least` (m): who stands too near may go away from there.
    pub(crate) fn relaxed_at(&mut self, at: &Joints, least: f64) -> Vec<f64> {
        self.scene.distances(at, &mut self.distances);
        let all = self.distances.iter().zip(&self.margins);
        let relaxed = all.map(|(distance, margin)| margin.min((distance - 1e-9).max(least)));
        relaxed.collect()
    }

    /// Keeps other distances, m, by pair; returns those that were kept before.
    pub(crate) fn keep(&mut self, margins: Vec<f64>) -> Vec<f64> {
        std::mem::replace(&mut self.margins, margins)
    }

    /// A pair by its number, so far apart (m).
    pub(crate) fn touch(&self, pair: usize, distance_m: f64) -> Touch {
        Touch {
            pair: self.names.get(pair).cloned().unwrap_or_default(),
            distance_m,
        }
    }
}

/// The position a share of the straight way from one to another.
#[must_use]
pub fn between(from: &Joints, to: &Joints, share: f64) -> Joints {
    if share >= 1.0 {
        return *to;
    }
    Joints::from_fn(from.len(), |joint| {
        from[joint] + share * (to[joint] - from[joint])
    })
}
