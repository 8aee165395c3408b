//! The motions that a manipulator was ordered to make, as viewers draw them: the way of its tool.

use std::collections::VecDeque;
use std::sync::{Mutex, PoisonError};

use crate::servo::Ended;
use crate::trajectory::{Path, Planner, Segment};

/// So many straight pieces stand for the way of one motion.
const PIECES: usize = 24;

/// The motions that were ordered and have not ended, in their order; with the numbers that the servo knows them by.
#[derive(Debug, Default)]
pub(super) struct Ways(Mutex<VecDeque<(u64, Segment)>>);

impl Ways {
    /// Motion `id` was ordered; those that have `ended` are forgotten.
    pub fn add(&self, id: u64, segment: Segment, ended: &Ended) {
        let mut ways = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        ways.retain(|(id, _)| *id > ended.newest());
        ways.push_back((id, segment));
    }

    /// Those that have not ended.
    pub fn under_way(&self, ended: &Ended) -> Vec<(u64, Segment)> {
        let ways = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        // Motions end in their order.
        let under_way = ways.iter().filter(|(id, _)| *id > ended.newest());
        under_way.copied().collect()
    }
}

/// Where a segment takes the tool: points in the base frame, m.
pub(super) fn points(segment: &Segment, planner: &mut Planner) -> Vec<[f64; 3]> {
    let mut place = |piece: usize| {
        let t = segment.duration() * piece as f64 / PIECES as f64;
        let tool = match segment.path() {
            Path::Tool(path) => path.pose(path.along.at(t).position),
            Path::Joint(courses) => {
                let courses = courses.each().iter();
                let q: Vec<f64> = courses.map(|course| course.at(t).position).collect();
                planner.tool_pose(&q)
            }
        };
        tool.translation.vector.into()
    };
    (0..=PIECES).map(&mut place).collect()
}
