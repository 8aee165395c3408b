//! Forward and differential kinematics of any frame of a model.

use nalgebra::{DMatrix, Vector3};

use super::data::Data;
use super::features::{FrameId, JointKind, Model};
use super::placement::Placement;

/// The number at `index`; none where a vector is too short, so that the mistake is seen in every result.
pub(super) fn number(values: &[f64], index: usize) -> f64 {
    values.get(index).copied().unwrap_or(f64::NAN)
}

impl Model {
    /// Where every joint's frame stands at positions `q`: see [`Data::placement`]. A number that is missing in `q`
    /// counts as NaN.
    pub fn forward(&self, data: &mut Data, q: &[f64]) {
        for (index, joint) in self.joints.iter().enumerate() {
            let parent = &data.placements[joint.parent.map_or(0, |parent| parent + 1)];
            let mut placement = parent.then(&joint.placement);
            let position = number(q, index);
            match joint.kind {
                JointKind::Revolute => {
                    let (sin, cos) = position.sin_cos();
                    let x = placement.rotation.column(0).into_owned();
                    let y = placement.rotation.column(1).into_owned();
                    placement.rotation.set_column(0, &(x * cos + y * sin));
                    placement.rotation.set_column(1, &(y * cos - x * sin));
                }
                JointKind::Prismatic => {
                    placement.origin += placement.rotation.column(2) * position;
                }
            }
            data.placements[index + 1] = placement;
        }
    }

    /// Where a frame stands in the base frame at positions `q`.
    pub fn placement(&self, data: &mut Data, q: &[f64], frame: FrameId) -> Placement {
        self.forward(data, q);
        data.placement(self, frame)
    }

    /// Geometric Jacobian of a frame's origin at positions `q`. Rows: linear velocity (m/s), then angular velocity
    /// (rad/s), both in the base frame; a column for each joint, per rad/s or m/s of it. Columns of joints that do not
    /// carry the frame are zero.
    pub fn jacobian<'d>(&self, data: &'d mut Data, q: &[f64], frame: FrameId) -> &'d DMatrix<f64> {
        self.forward(data, q);
        let point = data.placement(self, frame).origin;
        self.jacobian_there(data, frame, &point)
    }

    /// The Jacobian of a point (base frame, m) of a frame, for the positions of the last [`Self::forward`].
    pub fn jacobian_there<'d>(
        &self,
        data: &'d mut Data,
        frame: FrameId,
        point: &Vector3<f64>,
    ) -> &'d DMatrix<f64> {
        data.jacobian.fill(0.0);
        for index in self.carriers(self.at(frame).carrier) {
            let placement = &data.placements[index + 1];
            let axis = placement.rotation.column(2).into_owned();
            let (linear, angular) = match self.joints[index].kind {
                JointKind::Revolute => (axis.cross(&(point - placement.origin)), axis),
                JointKind::Prismatic => (axis, Vector3::zeros()),
            };
            let mut column = data.jacobian.column_mut(index);
            column.fixed_rows_mut::<3>(0).copy_from(&linear);
            column.fixed_rows_mut::<3>(3).copy_from(&angular);
        }
        &data.jacobian
    }
}
