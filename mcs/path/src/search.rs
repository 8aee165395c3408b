//! The search: two trees, one from the start and one from the goals, which grow towards random positions and towards one
//! another (J. Kuffner and S. LaValle, RRT-Connect, IEEE ICRA 2000).

use mcs::Joints;
use mcs::model::{JointKind, Limits, Model};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::space::{Space, Touch, between};
use crate::way::{self, Way};

/// The whole way is looked at anew with this resolution, m.
pub const CHECKED_M: f64 = 0.002;
/// How often a free position beside an end that is too near to something is looked for, and how far from it at most, m.
const ESCAPES: u32 = 200;
const ESCAPE_M: f64 = 0.3;
/// The room for a joint without limits beyond the ends of the way, rad or m.
const UNLIMITED: f64 = std::f64::consts::PI;

/// How to search.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Options {
    /// The same seed finds the same way.
    pub seed: u64,
    /// Random positions that are tried before the search is given up.
    pub iterations: u32,
    /// How far a tree grows at a time, m of [`Space::distance`].
    pub step_m: f64,
    /// Short cuts that are tried on the way that was found.
    pub cuts: u32,
    /// Ends that are nearer to something than the space's margin, and not nearer than this, m, are left for a position that
    /// keeps it.
    pub least_m: f64,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            seed: 1,
            iterations: 3000,
            step_m: 0.25,
            cuts: 150,
            least_m: 0.0,
        }
    }
}

/// Which end of a way.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub enum End {
    /// Where it begins.
    Start,
    /// Where it ends.
    Goal,
}

impl std::fmt::Display for End {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::Start => "start",
            Self::Goal => "goal",
        })
    }
}

/// Why there is no way.
#[derive(Debug, Clone, PartialEq, thiserror::Error, serde::Serialize, serde::Deserialize)]
pub enum PathError {
    /// Nothing is said of the arm's form.
    #[error("nothing is said of the form of `{model}`: give its links `shapes`")]
    NoForm {
        /// The model.
        model: String,
    },
    /// The positions are not those of the arm.
    #[error("the {end} has {given} positions, and the arm {needed} joints")]
    Count {
        /// Which end.
        end: End,
        /// Joints of the arm.
        needed: usize,
        /// Positions given.
        given: usize,
    },
    /// A joint's position is outside its limits, or no number.
    #[error("joint {joint} of the {end} is at {value:.4}, and its limits are {lower:.4} to {upper:.4} {unit}", unit = .kind.unit())]
    Limit {
        /// Which end.
        end: End,
        /// Number of the joint, from 1.
        joint: usize,
        /// Whether it turns or slides.
        kind: JointKind,
        /// Position, rad or m.
        value: f64,
        /// The smallest.
        lower: f64,
        /// The largest.
        upper: f64,
    },
    /// Where the arm stands, or shall stand, it touches something or is too near to it.
    #[error("at the {end} {touch}: move that away, or choose another {end}")]
    Touches {
        /// Which end.
        end: End,
        /// What is too near to what.
        touch: Touch,
    },
    /// No goal was given.
    #[error("no goal was given")]
    NoGoal,
    /// The search was given up.
    #[error(
        "no way was found with {iterations} random positions ({start} from the start and {goal} from the goal were reached): there may be none, or only a narrow one, for which more are needed"
    )]
    NoWay {
        /// Random positions that were tried.
        iterations: u32,
        /// Positions that are reached from the start,
        start: usize,
        /// and from the goals.
        goal: usize,
    },
    /// The way that was found is not free when it is looked at anew, which is a mistake of this program.
    #[error("the way that was found is not free: {touch}")]
    NotFree {
        /// What is too near to what.
        touch: Touch,
    },
}

/// Positions that are reached from one end, each from the one before it.
#[derive(Debug, Default)]
struct Tree {
    nodes: Vec<(Joints, Option<usize>)>,
}

/// How far a tree came.
enum Grown {
    /// To the position itself, where it is now.
    Reached(usize),
    /// Nearer to it.
    Nearer(usize),
    /// Nowhere.
    Trapped,
}

impl Tree {
    fn add(&mut self, at: Joints, from: Option<usize>) -> usize {
        self.nodes.push((at, from));
        self.nodes.len() - 1
    }

    /// The node that is nearest to a position, and how far, m.
    fn nearest(&self, space: &Space, to: &Joints) -> Option<(usize, f64)> {
        let nodes = self.nodes.iter().enumerate();
        let all = nodes.map(|(node, (at, _))| (node, space.distance(at, to)));
        all.min_by(|(_, one), (_, other)| one.total_cmp(other))
    }

    /// Grows by at most a step (m) from its nearest node towards a position.
    fn grow(&mut self, space: &mut Space, to: &Joints, step: f64) -> Grown {
        let Some((near, distance)) = self.nearest(space, to) else {
            return Grown::Trapped;
        };
        if distance == 0.0 {
            return Grown::Reached(near);
        }
        let from = self.nodes[near].0;
        let reaches = distance <= step;
        let share = if reaches { 1.0 } else { step / distance };
        let there = between(&from, to, share);
        if space.goes_free(&from, &there).is_err() {
            return Grown::Trapped;
        }
        let node = self.add(there, Some(near));
        match reaches {
            true => Grown::Reached(node),
            false => Grown::Nearer(node),
        }
    }

    /// From a node to the end from which its tree grows.
    fn way(&self, node: usize) -> impl Iterator<Item = Joints> {
        let all = std::iter::successors(Some(node), |node| self.nodes[*node].1);
        all.map(|node| self.nodes[node].0)
    }
}

/// A search that is under way. It goes on as far as somebody lets it.
#[derive(Debug)]
pub struct Search {
    space: Space,
    options: Options,
    rng: ChaCha8Rng,
    /// Where random positions lie, for each joint.
    room: Vec<(f64, f64)>,
    /// From the start, and from the goals.
    trees: [Tree; 2],
    tried: u32,
}

impl Search {
    /// A search for a way from a position to one of several.
    ///
    /// # Errors
    /// What is wrong with the start, or with all goals: what the first one has.
    pub fn new(
        mut space: Space,
        start: &Joints,
        goals: &[Joints],
        options: Options,
    ) -> Result<Self, PathError> {
        if space.model().shapes().is_empty() {
            let model = space.model().name().to_owned();
            return Err(PathError::NoForm { model });
        }
        let mut rng = ChaCha8Rng::seed_from_u64(options.seed);
        let mut trees = [Tree::default(), Tree::default()];
        root(
            &mut space,
            (&mut trees[0], start, End::Start),
            &options,
            &mut rng,
        )?;
        let mut first = None;
        for goal in goals {
            let rooted = root(
                &mut space,
                (&mut trees[1], goal, End::Goal),
                &options,
                &mut rng,
            );
            if let Err(error) = rooted {
                first.get_or_insert(error);
            }
        }
        if trees[1].nodes.is_empty() {
            return Err(first.unwrap_or(PathError::NoGoal));
        }
        let ends = || trees.iter().flat_map(|tree| &tree.nodes);
        let joints = space.model().joints().iter().enumerate();
        let room = joints.map(|(joint, own)| {
            let Limits { lower, upper, .. } = own.limits;
            let positions = || ends().map(|(at, _)| at[joint]);
            let low = positions().fold(f64::INFINITY, f64::min) - UNLIMITED;
            let high = positions().fold(f64::NEG_INFINITY, f64::max) + UNLIMITED;
            let lower = if lower.is_finite() { lower } else { low };
            (lower, if upper.is_finite() { upper } else { high })
        });
        Ok(Self {
            room: room.collect(),
            space,
            options,
            rng,
            trees,
            tried: 0,
        })
    }

    /// Random positions that were tried so far.
    #[must_use]
    pub fn tried(&self) -> u32 {
        self.tried
    }

    /// Goes on for at most so many random positions; the way, once there is one.
    ///
    /// # Errors
    /// [`PathError::NoWay`] when those of the options are used up; [`PathError::NotFree`].
    pub fn advance(&mut self, iterations: u32) -> Result<Option<Way>, PathError> {
        if self.tried == 0
            && let Some(points) = self.at_once()
        {
            return self.finish(points).map(Some);
        }
        for _ in 0..iterations {
            if self.tried >= self.options.iterations {
                let [start, goal] = [0, 1].map(|tree| self.trees[tree].nodes.len());
                return Err(PathError::NoWay {
                    iterations: self.tried,
                    start,
                    goal,
                });
            }
            self.tried += 1;
            if let Some(points) = self.try_one() {
                return self.finish(points).map(Some);
            }
        }
        Ok(None)
    }

    /// Goes on until there is a way.
    ///
    /// # Errors
    /// As [`Self::advance`].
    pub fn run(&mut self) -> Result<Way, PathError> {
        loop {
            if let Some(way) = self.advance(u32::MAX)? {
                return Ok(way);
            }
        }
    }

    /// A straight way from the start to a goal.
    fn at_once(&mut self) -> Option<Vec<Joints>> {
        let start = self.trees[0].nodes.len() - 1;
        let from = self.trees[0].nodes[start].0;
        // Goals stand where nothing stands beside them, or beside them.
        let ends = self.trees[1].nodes.len();
        let found = (0..ends).find(|goal| {
            let to = self.trees[1].nodes[*goal].0;
            self.space.goes_free(&from, &to).is_ok()
        });
        found.map(|goal| self.joined(start, goal))
    }

    fn try_one(&mut self) -> Option<Vec<Joints>> {
        let rng = &mut self.rng;
        let room = self.room.iter();
        let random: Vec<f64> = room
            .map(|(low, high)| low + (high - low) * rng.random::<f64>())
            .collect();
        let random = Joints::try_from(&random[..]).ok()?;
        // The smaller tree grows towards it, and the other one to where that came.
        let first = usize::from(self.trees[0].nodes.len() > self.trees[1].nodes.len());
        let step = self.options.step_m;
        let (Grown::Reached(node) | Grown::Nearer(node)) =
            self.trees[first].grow(&mut self.space, &random, step)
        else {
            return None;
        };
        let there = self.trees[first].nodes[node].0;
        loop {
            match self.trees[1 - first].grow(&mut self.space, &there, step) {
                Grown::Trapped => return None,
                Grown::Nearer(_) => {}
                Grown::Reached(other) => {
                    let (start, goal) = match first {
                        0 => (node, other),
                        _ => (other, node),
                    };
                    return Some(self.joined(start, goal));
                }
            }
        }
    }

    /// From the start through a node of each tree to a goal.
    fn joined(&self, start: usize, goal: usize) -> Vec<Joints> {
        let mut points: Vec<Joints> = self.trees[0].way(start).collect();
        points.reverse();
        points.extend(self.trees[1].way(goal));
        points.dedup();
        points
    }

    /// Shortens a way and looks at it anew. What leads away from an end that is too near to something stays as it is.
    fn finish(&mut self, mut points: Vec<Joints>) -> Result<Way, PathError> {
        let space = &mut self.space;
        let escaped = |space: &mut Space, end: Option<&Joints>| {
            end.is_some_and(|end| space.stands_free(end).is_err())
        };
        let first = usize::from(escaped(space, points.first()));
        let last = usize::from(escaped(space, points.last()));
        let tail = points.split_off(points.len() - last);
        let mut middle = points.split_off(first);
        way::shorten(space, &mut middle, (self.options.cuts, &mut self.rng));
        let nearest = way::check(space, &middle, CHECKED_M);
        let nearest = nearest.map_err(|touch| PathError::NotFree { touch })?;
        points.extend(middle);
        points.extend(tail);
        Ok(way::finished(space, points, nearest))
    }
}

/// Whether a position is one of the arm, within its limits.
pub(crate) fn within_limits(model: &Model, at: &Joints, end: End) -> Result<(), PathError> {
    let (needed, given) = (model.dof(), at.len());
    if needed != given {
        return Err(PathError::Count { end, needed, given });
    }
    let Some(joint) = model.joint_outside(at) else {
        return Ok(());
    };
    let own = &model.joints()[joint];
    Err(PathError::Limit {
        end,
        joint: joint + 1,
        kind: own.kind,
        value: at[joint],
        lower: own.limits.lower,
        upper: own.limits.upper,
    })
}

/// Makes an end the root of a tree. From one that is too near to something a free position beside it is looked for.
fn root(
    space: &mut Space,
    (tree, at, end): (&mut Tree, &Joints, End),
    options: &Options,
    rng: &mut ChaCha8Rng,
) -> Result<(), PathError> {
    within_limits(space.model(), at, end)?;
    match space.stands_free(at) {
        Ok(()) => {
            tree.add(*at, None);
            Ok(())
        }
        Err(touch) if touch.distance_m > options.least_m => {
            let beside = escape(space, at, options.least_m, rng);
            let beside = beside.ok_or(PathError::Touches { end, touch })?;
            let node = tree.add(*at, None);
            tree.add(beside, Some(node));
            Ok(())
        }
        Err(touch) => Err(PathError::Touches { end, touch }),
    }
}

/// A free position beside one that is too near to something, to which the arm comes without coming nearer.
fn escape(space: &mut Space, at: &Joints, least: f64, rng: &mut ChaCha8Rng) -> Option<Joints> {
    let relaxed = space.relaxed_at(at, least);
    let levers = *space.levers();
    for count in 1..=ESCAPES {
        let far = ESCAPE_M * f64::from(count) / f64::from(ESCAPES);
        let beside = Joints::from_fn(at.len(), |joint| {
            at[joint] + far / levers[joint] * (2.0 * rng.random::<f64>() - 1.0)
        });
        if space.model().joint_outside(&beside).is_some() || space.stands_free(&beside).is_err() {
            continue;
        }
        let before = space.keep(relaxed.clone());
        let goes = space.goes_free(at, &beside).is_ok();
        space.keep(before);
        if goes {
            return Some(beside);
        }
    }
    None
}
