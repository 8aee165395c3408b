//! What a person's hand does to a link that it holds.

use mcs_model::FrameId;
use nalgebra::{Point3, Vector3};

/// A hand that holds a frame of an arm, as a spring and a damper between where the hand is and the frame's origin would. It
/// turns nothing.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Hold {
    /// What it holds.
    pub frame: FrameId,
    /// Where the hand is, m in the world.
    pub hand: Point3<f64>,
    /// N/m.
    pub stiffness: f64,
    /// N s/m.
    pub damping: f64,
    /// It pulls no harder, N.
    pub most: f64,
}

impl Hold {
    /// The force (N, world) on a frame that is there (m) and so fast (m/s).
    #[must_use]
    pub fn force(&self, there: &Point3<f64>, speed: &Vector3<f64>) -> Vector3<f64> {
        let wanted = (self.hand - there) * self.stiffness - speed * self.damping;
        let hard = wanted.norm();
        match hard > self.most {
            true => wanted * (self.most / hard),
            false => wanted,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        cell::{Cell, Mount},
        world::World,
    };
    use std::{path::Path, time::Duration};

    const PERIOD: Duration = Duration::from_micros(4500);

    #[test]
    fn a_hand_pulls_as_its_spring_and_no_harder_than_it_can() {
        let cell = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../configs/push-cell.toml");
        let cell = Cell::read(&cell).unwrap();
        let frame = cell.arms[0].model.tip();
        let mut world = World::new(&cell);
        let there = world.link(Mount { arm: 0, frame }).translation.vector;
        let mut felt = |pull: Vector3<f64>, most: f64| {
            let hold = Hold {
                frame,
                hand: Point3::from(there + pull),
                stiffness: 200.0,
                damping: 10.0,
                most,
            };
            world.hold(0, Some(hold));
            world.advance(PERIOD).unwrap();
            // All brakes are on, so it stays; the sensor between feels what the hand does.
            let (wrench, turn, known) = world.wrench(0);
            let weight = known.weight(&(turn.inverse() * Vector3::new(0.0, 0.0, -9.81)));
            let force = Vector3::from_fn(|axis, _| wrench[axis] - weight[axis]);
            turn * force
        };
        let pull = Vector3::new(0.03, -0.02, 0.04);
        assert!((felt(pull, 100.0) - pull * 200.0).norm() < 1e-6);
        let most = felt(pull, 5.0);
        assert!((most.norm() - 5.0).abs() < 1e-6 && most.cross(&pull).norm() < 1e-6);
        world.hold(0, None);
        world.advance(PERIOD).unwrap();
        assert_eq!(world.positions(0), cell.arms[0].start);
    }
}
