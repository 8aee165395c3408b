//! From rest to rest through way points, without stopping at them where that is quicker.
//!
//! All joints are at each point at the same time. Between two points every joint goes from state to state, as
//! [`crate::timing`] has it, in the least time that is common to all. What is free are the speeds and accelerations at the
//! way points. They are found by descent: first every joint stops at each of them, then one number is changed at a time,
//! by a step that grows where it helps and is halved where it does not. So a passage is never longer than one that stops,
//! and the same points give the same bits. The least time of all is not promised.

use rsruckig::prelude::{ControlInterface, Trajectory};

use crate::timing::{self, Engine, JointBounds, JointState, Motion, TimingError};

#[cfg(test)]
mod tests;

/// No path has more way points.
pub const MOST_WAY_POINTS: usize = 100;
/// How often each number is changed at most.
const SWEEPS: usize = 32;
/// First step of a speed or an acceleration, as a share of its limit, and the one with which the search ends.
const STEPS: (f64, f64) = (0.25, 5e-4);
/// A joint that needs less than this share of a section's time does not make it shorter.
const SPARE: f64 = 0.75;
/// Of two passages as long as one another that one is better whose joints have more time to spare: so much counts a joint
/// that has none.
const TIE: f64 = 0.02;
/// What joints that go straight ahead leave unused of their accelerations and jerks: else rounding makes a speed too large to
/// be reached from one way point to the next, but for a loop. What is shortest is taken.
const SPARED: [f64; 4] = [1e-7, 1e-6, 1e-5, 1e-4];
/// Speeds and accelerations at a way point keep off their limits by this share, lest rounding put them beyond.
const INSIDE: f64 = 1.0 - 1e-9;

/// The motion of joints through way points.
#[derive(Debug, Clone)]
pub struct Passage {
    sections: Vec<Trajectory<0>>,
    joints: usize,
}

impl Passage {
    /// Through `points`, the first and the last of which are at rest: as many numbers (rad or m) for each as there are
    /// `bounds`, point after point.
    ///
    /// # Errors
    /// [`TimingError`]: limits and positions as for [`timing::between`], too many points, or two that are the same.
    pub fn through(points: &[f64], bounds: &[JointBounds]) -> Result<Self, TimingError> {
        let mut chain = Chain::new(points, bounds)?;
        chain.start_straight();
        chain.descend();
        chain.passage()
    }

    /// The time from rest to rest, s.
    #[must_use]
    pub fn duration(&self) -> f64 {
        self.sections.iter().map(|section| section.duration).sum()
    }

    /// The times at which the points are reached, s; the last is the duration.
    #[must_use]
    pub fn times(&self) -> Vec<f64> {
        let durations = self.sections.iter().map(|section| section.duration);
        let sums = durations.scan(0.0, |sum, duration| {
            *sum += duration;
            Some(*sum)
        });
        sums.collect()
    }

    /// The states of all joints at time `t`, s.
    #[must_use]
    pub fn at(&self, t: f64) -> Vec<JointState> {
        let mut left = t;
        let last = self.sections.len().saturating_sub(1);
        let section = self.sections.iter().enumerate().find(|(index, section)| {
            let here = left <= section.duration || *index == last;
            if !here {
                left -= section.duration;
            }
            here
        });
        section.map_or_else(Vec::new, |(_, section)| state(section, left, self.joints))
    }
}

/// The states of `count` joints at time `t` of a trajectory.
fn state(trajectory: &Trajectory<0>, t: f64, count: usize) -> Vec<JointState> {
    let mut states = vec![JointState::default(); count];
    let mut section = 0;
    trajectory.state_to_integrate_from(t, &mut section, |joint, t, p, v, a, j| {
        if let Some(state) = states.get_mut(joint) {
            *state = JointState {
                position: p + t * (v + t * (0.5 * a + t * j / 6.0)),
                velocity: v + t * (a + 0.5 * t * j),
                acceleration: a + t * j,
            };
        }
    });
    states
}

/// What is known of the motion between two points.
#[derive(Debug, Clone)]
struct Section {
    duration: f64,
    /// What the descent makes smaller.
    cost: f64,
    /// The share of the duration that each joint needs.
    shares: Vec<f64>,
}

/// The points with the states of all joints at them, and the sections between.
struct Chain<'b> {
    bounds: &'b [JointBounds],
    states: Vec<Vec<JointState>>,
    sections: Vec<Section>,
    engine: Engine,
    motions: Vec<Motion>,
}

impl<'b> Chain<'b> {
    /// Every joint stops at each point.
    fn new(points: &[f64], bounds: &'b [JointBounds]) -> Result<Self, TimingError> {
        let n = bounds.len();
        if n == 0 {
            return Err(TimingError::NotFound("there are no joints".to_owned()));
        }
        let states: Vec<Vec<JointState>> = points
            .chunks_exact(n)
            .map(|point| point.iter().map(|position| at_rest(*position)).collect())
            .collect();
        let (given, most) = (states.len().saturating_sub(2), MOST_WAY_POINTS);
        if given > most {
            return Err(TimingError::TooManyPoints { given, most });
        }
        for (index, pair) in states.windows(2).enumerate() {
            let [from, to] = pair else { continue };
            for (joint, bounds) in bounds.iter().enumerate() {
                let ends = (&from[joint], &to[joint]);
                timing::check(joint + 1, ends, bounds, ControlInterface::Position)?;
            }
            if given > 0 && from == to {
                return Err(TimingError::Standing { point: index + 1 });
            }
        }
        let mut chain = Self {
            bounds,
            sections: Vec::with_capacity(states.len()),
            states,
            engine: Engine::new(bounds.len(), ControlInterface::Position),
            motions: Vec::with_capacity(bounds.len()),
        };
        for index in 1..chain.states.len() {
            let section = chain.section(index - 1)?;
            chain.sections.push(section);
        }
        Ok(chain)
    }

    fn trajectory(&mut self, index: usize) -> Result<&Trajectory<0>, TimingError> {
        let ends = self.states[index].iter().zip(&self.states[index + 1]);
        let joints = ends.zip(self.bounds);
        self.motions.clear();
        self.motions
            .extend(joints.map(|((from, to), bounds)| (*from, *to, *bounds)));
        self.engine.compute(&self.motions)
    }

    /// The section from a point to the next.
    fn section(&mut self, index: usize) -> Result<Section, TimingError> {
        let trajectory = self.trajectory(index)?;
        let duration = trajectory.duration;
        let least = trajectory.independent_min_durations.iter();
        let shares: Vec<f64> = least.map(|least| least / duration).collect();
        let crowd: f64 = shares.iter().map(|share| share.powi(16)).sum();
        Ok(Section {
            duration,
            cost: duration * (1.0 + TIE * crowd / shares.len() as f64),
            shares,
        })
    }

    fn passage(&mut self) -> Result<Passage, TimingError> {
        let mut sections = Vec::with_capacity(self.sections.len());
        for index in 0..self.sections.len() {
            sections.push(self.trajectory(index)?.clone());
        }
        let joints = self.bounds.len();
        Ok(Passage { sections, joints })
    }

    /// Takes other states at a way point when the two sections that meet there become better by it.
    fn adopt(&mut self, point: usize, states: Vec<JointState>) -> bool {
        let before = std::mem::replace(&mut self.states[point], states);
        // What cannot be computed is no better.
        if let (Ok(into), Ok(out)) = (self.section(point - 1), self.section(point)) {
            let now = [&self.sections[point - 1], &self.sections[point]];
            let cost = now[0].cost + now[1].cost;
            let duration = now[0].duration + now[1].duration;
            let longer = into.duration + out.duration > duration;
            if !longer && into.cost + out.cost < cost * (1.0 - 1e-9) {
                self.sections[point - 1] = into;
                self.sections[point] = out;
                return true;
            }
        }
        self.states[point] = before;
        false
    }

    /// Where all points lie on one straight line and follow one another on it, the joints can go in proportion: the
    /// states of that motion are where the descent begins.
    fn start_straight(&mut self) {
        for spared in SPARED {
            let Some(states) = self.straight(1.0 - spared) else {
                return;
            };
            let before = std::mem::replace(&mut self.states, states);
            let sections: Result<Vec<Section>, TimingError> = (1..self.states.len())
                .map(|index| self.section(index - 1))
                .collect();
            let length =
                |sections: &[Section]| sections.iter().map(|section| section.duration).sum();
            let now: f64 = length(&self.sections);
            match sections {
                Ok(sections) if length(&sections) < now => self.sections = sections,
                _ => self.states = before,
            }
        }
    }

    /// The states of the motion in proportion, with a share of the accelerations and jerks.
    fn straight(&self, share_used: f64) -> Option<Vec<Vec<JointState>>> {
        let (first, last) = (self.states.first()?, self.states.last()?);
        let way: Vec<f64> = last
            .iter()
            .zip(first)
            .map(|(to, from)| to.position - from.position)
            .collect();
        let square: f64 = way.iter().map(|way| way * way).sum();
        if self.states.len() < 3 || square == 0.0 {
            return None;
        }
        // Limits of the motion along the line, over a parameter from 0 to 1.
        let least = |limit: fn(&JointBounds) -> f64| {
            let pairs = self.bounds.iter().zip(&way);
            let used = pairs.filter(|(bounds, way)| **way != 0.0 && limit(bounds) > 0.0);
            used.map(|(bounds, way)| limit(bounds) / way.abs())
                .fold(f64::INFINITY, f64::min)
        };
        let jerk = least(|bounds| bounds.jerk);
        let bounds = JointBounds {
            velocity: least(|bounds| bounds.velocity),
            acceleration: share_used * least(|bounds| bounds.acceleration),
            jerk: if jerk.is_finite() {
                share_used * jerk
            } else {
                0.0
            },
        };
        let mut engine = Engine::new(1, ControlInterface::Position);
        let along = engine.compute(&[(at_rest(0.0), at_rest(1.0), bounds)]);
        let along = along.ok()?;
        let mut before = 0.0;
        let mut states = self.states.clone();
        for point in states.iter_mut().skip(1).take(self.states.len() - 2) {
            let offsets = point
                .iter()
                .zip(first)
                .map(|(at, from)| at.position - from.position);
            let dot: f64 = offsets
                .clone()
                .zip(&way)
                .map(|(offset, way)| offset * way)
                .sum();
            let share = dot / square;
            let off: f64 = offsets
                .zip(&way)
                .map(|(offset, way)| (offset - share * way).powi(2))
                .sum();
            if share <= before || share >= 1.0 || off > 1e-18 * square {
                return None;
            }
            before = share;
            // The time at which the motion is there, by halving.
            let (mut low, mut high) = (0.0, along.duration);
            for _ in 0..60 {
                let middle = 0.5 * (low + high);
                let here = state(along, middle, 1);
                match here.first()?.position < share {
                    true => low = middle,
                    false => high = middle,
                }
            }
            let here = *state(along, low, 1).first()?;
            for ((at, way), bounds) in point.iter_mut().zip(&way).zip(self.bounds) {
                at.velocity = way * here.velocity;
                at.acceleration = way * here.acceleration;
                *at = within(*at, bounds);
            }
        }
        Some(states)
    }

    fn descend(&mut self) {
        let (points, joints) = (self.states.len(), self.bounds.len());
        // Steps of speed and acceleration of each joint at each point, and of all speeds of a point at once.
        let mut steps = vec![vec![[STEPS.0; 2]; joints]; points];
        let mut together = vec![STEPS.0; points];
        for sweep in 0..SWEEPS {
            let mut goes_on = false;
            for point in 1..points.saturating_sub(1) {
                if sweep == 0 {
                    self.pass_on(point);
                }
                goes_on |= self.scale(point, &mut together[point]);
                for (joint, steps) in steps[point].iter_mut().enumerate() {
                    goes_on |= self.refine(point, joint, steps);
                }
            }
            if !goes_on {
                break;
            }
        }
    }

    /// The guess from which the descent begins: the mean speed over both sections, or a share of it.
    fn pass_on(&mut self, point: usize) {
        let time = self.sections[point - 1].duration + self.sections[point].duration;
        for share in [1.5, 1.0, 0.5] {
            let mut states = self.states[point].clone();
            for (joint, state) in states.iter_mut().enumerate() {
                let way =
                    self.states[point + 1][joint].position - self.states[point - 1][joint].position;
                state.velocity = share * way / time;
                *state = within(*state, &self.bounds[joint]);
            }
            self.adopt(point, states);
        }
    }

    /// Tries all speeds of a point larger and smaller; whether there is any use in trying again.
    fn scale(&mut self, point: usize, step: &mut f64) -> bool {
        self.search(step, |chain, by| {
            let mut states = chain.states[point].clone();
            for (state, bounds) in states.iter_mut().zip(chain.bounds) {
                state.velocity *= 1.0 + by;
                *state = within(*state, bounds);
            }
            chain.adopt(point, states)
        })
    }

    /// Tries the speed and the acceleration of one joint larger and smaller; whether there is any use in trying again.
    fn refine(&mut self, point: usize, joint: usize, steps: &mut [f64; 2]) -> bool {
        let matters = |section: &Section| {
            let most = section
                .shares
                .iter()
                .fold(0.0_f64, |most, share| most.max(*share));
            // Where no joint needs all of the time, it is a time between that some joint cannot take.
            section.shares[joint] >= SPARE || most < 1.0 - 1e-9
        };
        if ![point - 1, point]
            .into_iter()
            .any(|index| matters(&self.sections[index]))
        {
            return false;
        }
        let bounds = self.bounds[joint];
        let [speed, acceleration] = steps;
        let mut goes_on = self.search(speed, |chain, by| {
            chain.shifted(point, joint, [by * bounds.velocity, 0.0])
        });
        if bounds.jerk > 0.0 {
            goes_on |= self.search(acceleration, |chain, by| {
                chain.shifted(point, joint, [0.0, by * bounds.acceleration])
            });
        }
        goes_on
    }

    fn shifted(&mut self, point: usize, joint: usize, by: [f64; 2]) -> bool {
        let mut states = self.states[point].clone();
        let state = &mut states[joint];
        state.velocity += by[0];
        state.acceleration += by[1];
        *state = within(*state, &self.bounds[joint]);
        self.adopt(point, states)
    }

    /// Tries a step up and a step down, and makes it larger when one helps and smaller when none does; whether it is
    /// still large enough to be tried.
    fn search(&mut self, step: &mut f64, mut change: impl FnMut(&mut Self, f64) -> bool) -> bool {
        if *step < STEPS.1 {
            return false;
        }
        let helps = change(self, *step) || change(self, -*step);
        *step = if helps {
            (1.5 * *step).min(STEPS.0)
        } else {
            0.5 * *step
        };
        true
    }
}

fn at_rest(position: f64) -> JointState {
    JointState {
        position,
        ..JointState::default()
    }
}

/// The state of a joint at a way point, as near to the wanted one as its limits let it be. With a limit of jerk its speed
/// has changed by a^2 / 2j before the acceleration was there, and will after it.
fn within(wanted: JointState, bounds: &JointBounds) -> JointState {
    let most = INSIDE * bounds.velocity;
    let velocity = wanted.velocity.clamp(-most, most);
    let room = (2.0 * bounds.jerk * (most - velocity.abs())).sqrt();
    let most = INSIDE * bounds.acceleration.min(room);
    JointState {
        velocity,
        acceleration: wanted.acceleration.clamp(-most, most),
        ..wanted
    }
}
