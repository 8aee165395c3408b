//! Another thing that is stuck to the one to be carried, and what pushes do.

use mcs::client::{MotionError, Outcome as Motion};
use nalgebra::{Isometry3, Point3};

use super::{Place, World, disc, on};

impl World {
    /// Sticks another thing to the one that is to be carried.
    pub(super) fn stick(&mut self) {
        if let Place::At(at) = self.thing {
            let ends = [on("3,4"), on("4,5")];
            let far = ends.into_iter().max_by(|one, other| {
                let far = |end: &Point3<f64>| (end - at).norm();
                far(one).total_cmp(&far(other))
            });
            let away = (at - far.unwrap()).normalize();
            self.others = vec![at + away * 0.037];
        }
    }

    /// A world in which another thing is stuck to the one to be carried.
    pub fn crowded() -> Self {
        let mut world = Self {
            sticks: true,
            ..Self::default()
        };
        world.stick();
        world
    }

    /// Pushes whatever is in the way of the jaws.
    pub(super) fn pushes(&mut self, to: &Isometry3<f64>) -> Result<(), MotionError> {
        let (from, to) = (
            self.tool.translation.vector.xy(),
            to.translation.vector.xy(),
        );
        let Some(along) = (to - from).try_normalize(1e-9) else {
            return Ok(());
        };
        let radius = 0.5 * disc().width_m;
        if let (Place::At(thing), Some(other)) = (self.thing, self.others.first()) {
            let away = (other - thing).xy();
            if (away.x * along.y - away.y * along.x) * self.vain_side > 0.0 {
                self.last = Some("blocked");
                return Err(MotionError::new(Motion::Guard, "force 12 N"));
            }
        }
        let mut moved = 0;
        let mut push = |at: &mut Point3<f64>| {
            let off = at.coords.xy() - from;
            let (far, beside) = (off.dot(&along), (off - along * off.dot(&along)).norm());
            let ends = (to - from).norm() + radius;
            if beside < radius - 1e-3 && far > 0.0 && far < ends {
                let moved_to = at.coords.xy() + along * (ends - far);
                (at.x, at.y) = (moved_to.x, moved_to.y);
                moved += 1;
            }
        };
        self.others.iter_mut().for_each(&mut push);
        if let Place::At(thing) = &mut self.thing {
            push(thing);
        }
        self.pushed += moved;
        Ok(())
    }
}
