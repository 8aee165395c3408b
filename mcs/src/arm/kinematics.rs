//! Forward kinematics and differential kinematics, in closed form from the DH rows. No allocation.

use nalgebra::{
    Isometry3, Matrix3, Matrix6, Rotation3, Translation3, UnitQuaternion, Vector3, Vector6,
};

use super::model::{ArmModel, DOF, DhRow, Joints};

/// Rotation and origin of one frame in the base frame; cheaper to chain than a quaternion.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Frame {
    /// Columns are the frame's axes in the base frame.
    pub rotation: Matrix3<f64>,
    /// Origin in the base frame, m.
    pub origin: Vector3<f64>,
}

impl Frame {
    /// The base frame itself.
    #[must_use]
    pub fn base() -> Self {
        Self {
            rotation: Matrix3::identity(),
            origin: Vector3::zeros(),
        }
    }

    /// The pose as an isometry.
    #[must_use]
    pub fn isometry(&self) -> Isometry3<f64> {
        let rotation = Rotation3::from_matrix_unchecked(self.rotation);
        Isometry3::from_parts(
            Translation3::from(self.origin),
            UnitQuaternion::from_rotation_matrix(&rotation),
        )
    }

    /// The frame that follows through one DH row with the joint at `angle` (rad).
    fn through(&self, row: &DhRow, angle: f64) -> Self {
        let (sin, cos) = angle.sin_cos();
        let [x, y, z] = [0, 1, 2].map(|axis| self.rotation.column(axis).into_owned());
        let x_new = x * cos + y * sin;
        let y_turned = y * cos - x * sin;
        let y_new = y_turned * row.cos_alpha + z * row.sin_alpha;
        let z_new = z * row.cos_alpha - y_turned * row.sin_alpha;
        Self {
            rotation: Matrix3::from_columns(&[x_new, y_new, z_new]),
            origin: self.origin + z * row.d + x_new * row.a,
        }
    }
}

impl ArmModel {
    /// The frames 1 to 6 in the base frame (index 0 holds frame 1).
    #[must_use]
    pub fn frames(&self, q: &Joints) -> [Frame; DOF] {
        let mut frame = Frame::base();
        let mut frames = [frame; DOF];
        for ((row, angle), slot) in self.dh.iter().zip(q).zip(&mut frames) {
            frame = frame.through(row, *angle);
            *slot = frame;
        }
        frames
    }

    /// Forward kinematics as a frame: frame 6 in the base frame.
    #[must_use]
    pub fn frame_6(&self, q: &Joints) -> Frame {
        self.dh
            .iter()
            .zip(q)
            .fold(Frame::base(), |frame, (row, angle)| {
                frame.through(row, *angle)
            })
    }

    /// Forward kinematics: `base_t_6`, the wrist centre frame in the base frame.
    #[must_use]
    pub fn forward(&self, q: &Joints) -> Isometry3<f64> {
        self.frame_6(q).isometry()
    }

    /// Geometric Jacobian of a point fixed to frame 6, `point_6` in m in that frame. Rows: linear
    /// velocity (m/s) then angular velocity (rad/s), both in the base frame, per rad/s of each joint.
    #[must_use]
    pub fn jacobian(&self, q: &Joints, point_6: &Vector3<f64>) -> Matrix6<f64> {
        jacobian_of(&self.frames(q), point_6)
    }

    /// Velocity-product acceleration of a point fixed to frame 6: what the linear (m/s^2) and angular
    /// (rad/s^2) acceleration in the base frame would be with all joint accelerations zero,
    /// the term `dJ/dt qd`.
    #[must_use]
    pub fn bias_acceleration(
        &self,
        q: &Joints,
        qd: &Joints,
        point_6: &Vector3<f64>,
    ) -> Vector6<f64> {
        let mut previous = Frame::base();
        let mut turning = Vector3::zeros();
        let mut turning_rate = Vector3::zeros();
        let mut acceleration = Vector3::zeros();
        for (index, frame) in self.frames(q).iter().enumerate() {
            let spin = previous.rotation.column(2) * qd[index];
            turning_rate += turning.cross(&spin);
            turning += spin;
            let end = if index + 1 == DOF {
                frame.origin + frame.rotation * point_6
            } else {
                frame.origin
            };
            let arm = end - previous.origin;
            acceleration += turning_rate.cross(&arm) + turning.cross(&turning.cross(&arm));
            previous = *frame;
        }
        let mut bias = Vector6::zeros();
        bias.fixed_rows_mut::<3>(0).copy_from(&acceleration);
        bias.fixed_rows_mut::<3>(3).copy_from(&turning_rate);
        bias
    }
}

fn jacobian_of(frames: &[Frame; DOF], point_6: &Vector3<f64>) -> Matrix6<f64> {
    let last = &frames[DOF - 1];
    let point = last.origin + last.rotation * point_6;
    let mut jacobian = Matrix6::zeros();
    let mut previous = Frame::base();
    for (index, frame) in frames.iter().enumerate() {
        let axis = previous.rotation.column(2).into_owned();
        let linear = axis.cross(&(point - previous.origin));
        jacobian.fixed_view_mut::<3, 1>(0, index).copy_from(&linear);
        jacobian.fixed_view_mut::<3, 1>(3, index).copy_from(&axis);
        previous = *frame;
    }
    jacobian
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    pub(crate) const POSE: Joints = [0.5, -0.5, 0.5, -0.5, 0.5, -0.5];

    #[test]
    fn zero_pose_is_the_published_one() {
        let frame = ArmModel::puma560().frame_6(&[0.0; 6]);
        assert!((frame.rotation - Matrix3::identity()).norm() < 1e-12);
        let expected = Vector3::new(0.4521, -0.15005, 1.10363);
        assert!((frame.origin - expected).norm() < 1e-12);
    }

    #[test]
    fn a_general_pose_is_the_published_one() {
        let frame = ArmModel::puma560().frame_6(&POSE);
        let expected = Vector3::new(0.422_303_996, 0.059_724_661, 0.896_614_052);
        assert!((frame.origin - expected).amax() < 1e-9);
        let row = Vector3::new(0.770_151_153, 0.420_735_492, -0.479_425_539);
        assert!((frame.rotation.row(0).transpose() - row).amax() < 1e-9);
    }

    fn joints() -> impl Strategy<Value = Joints> {
        prop::array::uniform6(-3.0..3.0_f64)
    }

    proptest! {
        #[test]
        fn jacobian_is_the_derivative_of_the_forward_kinematics(q in joints(), qd in joints()) {
            let model = ArmModel::puma560();
            let point = Vector3::new(0.01, -0.02, 0.1);
            let step = 1e-6;
            let at = |h: f64| {
                let moved: Joints = std::array::from_fn(|i| q[i] + h * qd[i]);
                let frame = model.frame_6(&moved);
                (frame.origin + frame.rotation * point, frame.rotation)
            };
            let (after, rotation_after) = at(step);
            let (before, rotation_before) = at(-step);
            let linear = (after - before) / (2.0 * step);
            let (_, rotation) = at(0.0);
            let skew = (rotation_after - rotation_before) / (2.0 * step) * rotation.transpose();
            let angular = Vector3::new(skew[(2, 1)], skew[(0, 2)], skew[(1, 0)]);
            let twist = model.jacobian(&q, &point) * Vector6::from(qd);
            prop_assert!((twist.fixed_rows::<3>(0) - linear).norm() < 1e-7);
            prop_assert!((twist.fixed_rows::<3>(3) - angular).norm() < 1e-7);
        }

        #[test]
        fn bias_acceleration_is_the_jacobians_rate_times_the_joint_speeds(q in joints(), qd in joints()) {
            let model = ArmModel::puma560();
            let point = Vector3::new(0.01, -0.02, 0.1);
            let step = 1e-6;
            let twist = |h: f64| {
                let moved: Joints = std::array::from_fn(|i| q[i] + h * qd[i]);
                model.jacobian(&moved, &point) * Vector6::from(qd)
            };
            let rate = (twist(step) - twist(-step)) / (2.0 * step);
            let bias = model.bias_acceleration(&q, &qd, &point);
            prop_assert!((bias - rate).norm() < 1e-6 * (1.0 + bias.norm()));
        }
    }
}
