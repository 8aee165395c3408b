//! Soft forms around links, and furniture that feels what the arms press on it.
//!
//! A pad is no solid of the engine: it goes into what it touches, and pushes back as a spring and a damper at the deepest point.

use rapier3d_f64::{geometry::SharedShape, math::Pose, parry::query};

use super::{Blow, World, link_pose};
use crate::{
    arm::Touch,
    cell::{Mount, PadSpec},
    engine::{self, ours, pose, vector},
    shapes::Shape,
};
use nalgebra::{Point3, Vector3};

/// What never moves, as pads meet it.
pub(super) struct Still {
    shape: SharedShape,
    pose: Pose,
    /// Which piece of furniture it is.
    piece: Option<usize>,
}

impl Still {
    /// The floor, then all furniture.
    pub(super) fn all(room: &[Shape]) -> Vec<Self> {
        let floor = (None, &engine::FLOOR);
        let pieces = room.iter().enumerate();
        let pieces = pieces.map(|(piece, Shape { solid, .. })| (Some(piece), solid));
        let still = std::iter::once(floor).chain(pieces);
        let place = |(piece, solid)| {
            let (shape, within) = engine::shape(solid);
            Self {
                shape,
                pose: pose(&within),
                piece,
            }
        };
        still.map(place).collect()
    }
}

/// Where a pad is pressed: the point, the force on the pad, N, and the furniture that it presses, if any.
struct Pressed {
    at: Point3<f64>,
    force: Vector3<f64>,
    piece: Option<usize>,
}

impl World {
    /// What presses on the pads in a step of `h` seconds, for each arm. The objects among it are pushed away.
    pub(super) fn press_pads(&mut self, h: f64, blows: &mut Vec<Blow>) -> Vec<Option<Touch>> {
        let mut all = vec![None; self.arms.len()];
        for (arm, number) in self.pads() {
            let Some(pad) = self.cell.arms.get(arm).and_then(|arm| arm.pads.get(number)) else {
                continue;
            };
            let pad = *pad;
            let mount = Mount {
                arm,
                frame: pad.frame,
            };
            for Pressed { at, force, piece } in self.pressed(mount, &pad, h) {
                let impulse = [force * h, Vector3::zeros()];
                let (Some(arm), Some(touch)) = (self.arms.get_mut(arm), all.get_mut(arm)) else {
                    continue;
                };
                let touch = touch.get_or_insert_with(|| Touch::none(arm.model().dof()));
                let shift = [force * (h * h / 2.0), Vector3::zeros()];
                arm.at_joints(pad.frame, &at, impulse, &mut touch.impulse);
                arm.at_joints(pad.frame, &at, shift, &mut touch.shift);
                touch.by_still = false;
                if let Some(link) = self.links.iter_mut().find(|link| link.mount == mount) {
                    link.pressed += force * h;
                }
                if let Some(felt) = piece.and_then(|piece| self.pieces.get_mut(piece)) {
                    *felt -= force * h;
                }
                blows.push(Blow { mount, at, impulse });
            }
        }
        all
    }

    /// Arm and number of every pad of an arm that moves.
    fn pads(&self) -> Vec<(usize, usize)> {
        let arms = self.cell.arms.iter().zip(&self.arms).enumerate();
        let moved = arms.filter(|(_, (_, arm))| !arm.is_held());
        moved
            .flat_map(|(index, (spec, _))| (0..spec.pads.len()).map(move |pad| (index, pad)))
            .collect()
    }

    /// Where a pad is pressed.
    fn pressed(&mut self, mount: Mount, pad: &PadSpec, h: f64) -> Vec<Pressed> {
        let (own, within) = engine::shape(&pad.solid);
        let placed = pose(&(link_pose(&self.cell, &mut self.arms, mount) * within));
        let mut found = Vec::new();
        let meet = |shape: &SharedShape, there: &Pose| {
            let contact = query::contact(&placed, &*own, there, &**shape, 0.0);
            let contact = contact.ok().flatten()?;
            let (at, outward) = (ours(contact.point2), ours(contact.normal1));
            (contact.dist < 0.0).then(|| (Point3::from(at), outward, -contact.dist))
        };
        let mut touched = Vec::new();
        for still in &self.still {
            if let Some((at, outward, depth)) = meet(&still.shape, &still.pose) {
                touched.push((at, outward, depth, still.piece, None));
            }
        }
        for (handle, spec) in self.objects.iter().zip(&self.cell.objects) {
            let (shape, within) = engine::shape(&spec.shape.solid);
            let Some(body) = self.physics.bodies.get(*handle) else {
                continue;
            };
            let there = pose(&(engine::isometry(body.position()) * within));
            if let Some((at, outward, depth)) = meet(&shape, &there) {
                touched.push((at, outward, depth, None, Some(*handle)));
            }
        }
        for (at, outward, depth, piece, object) in touched {
            let Some(arm) = self.arms.get_mut(mount.arm) else {
                continue;
            };
            let [mut closing, _] = arm.velocity(mount.frame, &at);
            let body = object.and_then(|object| self.physics.bodies.get_mut(object));
            if let Some(body) = &body {
                closing -= ours(body.velocity_at_point(vector(&at.coords)));
            }
            let most = pad.stiffness * depth + pad.damping * closing.dot(&outward);
            let force = -outward * most.max(0.0);
            if let Some(body) = body {
                body.apply_impulse_at_point(vector(&(force * -h)), vector(&at.coords), true);
            }
            found.push(Pressed { at, force, piece });
        }
        found
    }

    /// The mean force with which links pressed a piece of furniture in the last period, N, world.
    #[must_use]
    pub fn piece(&self, piece: usize) -> Vector3<f64> {
        let seconds = self.lasted.as_secs_f64().max(f64::MIN_POSITIVE);
        let felt = self.pieces.get(piece);
        felt.map_or_else(Vector3::zeros, |felt| felt / seconds)
    }
}
