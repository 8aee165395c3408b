//! What a person's hand does to a link that it holds.

use mcs_model::FrameId;
use nalgebra::{Point3, Vector3};

/// A hand at the origin of a frame of an arm. It turns nothing.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Hold {
    /// Where it has hold.
    pub frame: FrameId,
    /// What it does there.
    pub grip: Grip,
}

/// What a hand does to what it has hold of.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Grip {
    /// It stands somewhere, and is a spring and a damper between there and the frame's origin.
    Spring {
        /// Where the hand is, m in the world.
        hand: Point3<f64>,
        /// N/m.
        stiffness: f64,
        /// N s/m.
        damping: f64,
        /// It pulls no harder, N.
        most: f64,
    },
    /// It pushes, wherever the frame goes, and then lets go.
    Push {
        /// N in the world.
        force: Vector3<f64>,
        /// For how long still, s.
        seconds: f64,
    },
}

impl Hold {
    /// The force (N, world) on a frame that is there (m) and so fast (m/s).
    #[must_use]
    pub fn force(&self, there: &Point3<f64>, speed: &Vector3<f64>) -> Vector3<f64> {
        match self.grip {
            Grip::Spring {
                hand,
                stiffness,
                damping,
                most,
            } => ((hand - there) * stiffness - speed * damping).cap_magnitude(most),
            Grip::Push { force, .. } => force,
        }
    }

    /// `h` seconds have passed.
    pub fn pass(&mut self, h: f64) {
        if let Grip::Push { seconds, .. } = &mut self.grip {
            *seconds -= h;
        }
    }

    /// Whether it has let go.
    #[must_use]
    pub fn is_over(&self) -> bool {
        // What is left of many steps that were subtracted is no step.
        matches!(self.grip, Grip::Push { seconds, .. } if seconds < 1e-9)
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
                grip: Grip::Spring {
                    hand: Point3::from(there + pull),
                    stiffness: 200.0,
                    damping: 10.0,
                    most,
                },
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

    #[test]
    fn a_push_goes_on_as_long_as_it_shall_and_then_is_felt_no_more() {
        let cell = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../configs/push-cell.toml");
        let cell = Cell::read(&cell).unwrap();
        let frame = cell.arms[0].model.tip();
        let mut world = World::new(&cell);
        let force = Vector3::new(3.0, -2.0, 4.0);
        let grip = Grip::Push {
            force,
            seconds: 2.0 * PERIOD.as_secs_f64(),
        };
        world.hold(0, Some(Hold { frame, grip }));
        for felt in [force, force, Vector3::zeros()] {
            world.advance(PERIOD).unwrap();
            let (wrench, turn, known) = world.wrench(0);
            let weight = known.weight(&(turn.inverse() * Vector3::new(0.0, 0.0, -9.81)));
            let own = Vector3::from_fn(|axis, _| wrench[axis] - weight[axis]);
            assert!((turn * own - felt).norm() < 1e-6, "{own} {felt}");
        }
    }
}
