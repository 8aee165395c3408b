//! Hand-eye calibration: where a camera sits on a tool, from the robot's poses and what the camera sees of a target that
//! stands still (the equation A X = X B; F. Park and B. Martin, IEEE Transactions on Robotics and Automation, 1994).
//!
//! The start is Park and Martin's, rotation first; then both unknown poses, of the camera on the tool and of the target in
//! the base, are fitted together, angles and lengths each by the noise that their own residuals show.

use nalgebra::{
    DMatrix, DVector, Isometry3, Matrix3, Rotation3, SMatrix, SVector, Translation3,
    UnitQuaternion, Vector3,
};

use crate::calibrate::left_jacobian;

/// The robot's pose and what the camera saw from there.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sample {
    /// The tool in the base frame, m.
    pub base_t_tool: Isometry3<f64>,
    /// The target in the camera's frame, m.
    pub camera_t_target: Isometry3<f64>,
}

/// Where the camera sits.
#[derive(Debug, Clone, PartialEq)]
pub struct HandEye {
    /// The camera in the tool's frame.
    pub tool_t_camera: Isometry3<f64>,
    /// Standard deviations of its rotation vector (3, rad) and its translation (3, m).
    pub sd: [f64; 6],
    /// The target in the base frame.
    pub base_t_target: Isometry3<f64>,
    /// Root of the mean square over the samples used of the angle between the target as seen and as expected, rad.
    pub rms_rad: f64,
    /// The same of the distance between the two, m.
    pub rms_m: f64,
    /// The samples that were left out, for they do not agree with the others.
    pub rejected: Vec<Rejected>,
}

/// A sample that was left out.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Rejected {
    /// Its row, from 0.
    pub row: usize,
    /// The angle between the target as seen and as expected, rad.
    pub off_rad: f64,
    /// The distance between the two, m.
    pub off_m: f64,
}

/// Why there is no answer.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum HandEyeError {
    /// Too few samples.
    #[error("{0} samples; a hand-eye calibration needs 3 or more, and 10 to be good")]
    TooFew(usize),
    /// The tool turned about one axis only.
    #[error(
        "the tool turns about one axis only (second extent of its turns {0:.1e} of the first): the camera's place along that axis cannot be told; turn it about two axes or more"
    )]
    OneAxis(f64),
    /// The tool hardly turned.
    #[error("the tool turns by at most {0:.1e} rad; turn it by 0.3 rad or more between samples")]
    NoTurns(f64),
    /// The positions are spread over more than any laboratory.
    #[error(
        "the tool's positions are {0:.0} m apart (rms): positions are in m; are these millimetres?"
    )]
    TooLarge(f64),
    /// No place of the camera explains the samples.
    #[error(
        "no place of the camera explains the samples: the target is {rad:.2} rad and {m:.2} m (rms) off where it should be; are both poses of a row of the same moment, in the same unit, and base_T_tool and camera_T_target, not their inverses?"
    )]
    Disagree {
        /// Root mean square of the angles, rad.
        rad: f64,
        /// The same of the distances, m.
        m: f64,
    },
    /// The fit broke down.
    #[error("the samples do not determine the camera's place")]
    Undetermined,
}

/// The second extent of the turns must be at least this share of the first.
const LEAST_SPREAD: f64 = 0.02;

/// The tool must turn by this angle, rad.
const LEAST_TURN: f64 = 0.01;

/// Extent (rms) above which positions are not in metres, m.
const LARGEST_M: f64 = 50.0;

/// A sample is left out that is off by so many times the median, of this many samples or more.
const REJECT_MEDIANS: f64 = 5.0;
const FEWEST_TO_REJECT: usize = 6;

/// Rounds after which a set of samples that still changes is taken as it is.
const ROUNDS: usize = 10;

/// Angles and distances may be off (rms) by so much of the turns of the tool and of the distance of the target.
const MOST_OFF: f64 = 0.2;

/// No camera is off by this angle (rms), rad.
const MOST_OFF_RAD: f64 = 0.1;

/// Most samples that are compared each with each for the start.
const MOST_PAIRED: usize = 100;

/// Residuals below these are rounding errors, rad and m.
const LEAST_NOISE: f64 = 1e-12;

/// Tables are rounded: what is off by less is no reason to leave a sample out, rad and m.
const ROUNDED: f64 = 1e-5;

/// Parameters of a fit: two poses.
const UNKNOWN: usize = 12;

/// Fits the camera's place on the tool. Samples that do not agree with the others are left out.
///
/// # Errors
/// When the samples do not determine it.
pub fn hand_eye(samples: &[Sample]) -> Result<HandEye, HandEyeError> {
    let spread = extent(samples.iter().map(|one| one.base_t_tool.translation.vector));
    if spread > LARGEST_M {
        return Err(HandEyeError::TooLarge(spread));
    }
    let mut used: Vec<usize> = (0..samples.len()).collect();
    for _ in 0..ROUNDS {
        let kept: Vec<Sample> = used
            .iter()
            .filter_map(|row| samples.get(*row))
            .copied()
            .collect();
        let fit = Fit::of(&kept)?;
        let agreeing = fit.agreeing(samples);
        if agreeing == used || agreeing.len() < FEWEST_TO_REJECT {
            break;
        }
        used = agreeing;
    }
    let kept: Vec<Sample> = used
        .iter()
        .filter_map(|row| samples.get(*row))
        .copied()
        .collect();
    let mut found = Fit::of(&kept)?.answer(&kept)?;
    found.rejected = (0..samples.len())
        .filter(|row| used.binary_search(row).is_err())
        .filter_map(|row| {
            let fit = Fit {
                tool_t_camera: found.tool_t_camera,
                base_t_target: found.base_t_target,
            };
            let (off_rad, off_m) = fit.off(samples.get(row)?);
            Some(Rejected {
                row,
                off_rad,
                off_m,
            })
        })
        .collect();
    Ok(found)
}

/// Root mean square of the distances from the mean.
fn extent(places: impl Iterator<Item = Vector3<f64>> + Clone) -> f64 {
    let n = places.clone().count().max(1) as f64;
    let mean = places.clone().sum::<Vector3<f64>>() / n;
    (places
        .map(|place| (place - mean).norm_squared())
        .sum::<f64>()
        / n)
        .sqrt()
}

#[derive(Debug, Clone, Copy)]
struct Fit {
    tool_t_camera: Isometry3<f64>,
    base_t_target: Isometry3<f64>,
}

impl Fit {
    /// The fit of least squares. The noises follow from the residuals, and the residuals from the weights that the noises
    /// mean.
    fn of(samples: &[Sample]) -> Result<Self, HandEyeError> {
        if samples.len() < 3 {
            return Err(HandEyeError::TooFew(samples.len()));
        }
        let mut fit = Self::start(samples)?;
        for _ in 0..5 {
            fit = fit.refined(samples, fit.noise(samples))?;
        }
        Ok(fit)
    }

    fn answer(&self, samples: &[Sample]) -> Result<HandEye, HandEyeError> {
        let (normal, _) = self.equations(samples, self.noise(samples));
        let covariance = normal.try_inverse().ok_or(HandEyeError::Undetermined)?;
        let unturn = left_jacobian(self.tool_t_camera.rotation.scaled_axis());
        let unturn = unturn.try_inverse().ok_or(HandEyeError::Undetermined)?;
        let mut change = SMatrix::<f64, 6, 6>::identity();
        change.fixed_view_mut::<3, 3>(0, 0).copy_from(&unturn);
        let found = change * covariance.fixed_view::<6, 6>(0, 0) * change.transpose();
        let rms = |of: &dyn Fn(&Sample) -> f64| {
            let squares: f64 = samples.iter().map(|sample| of(sample).powi(2)).sum();
            (squares / samples.len() as f64).sqrt()
        };
        let (rad, m) = (
            rms(&|sample| self.off(sample).0),
            rms(&|sample| self.off(sample).1),
        );
        let first = samples
            .first()
            .ok_or(HandEyeError::Undetermined)?
            .base_t_tool;
        let turns = rms(&|sample| first.rotation.angle_to(&sample.base_t_tool.rotation));
        let away = rms(&|sample| sample.camera_t_target.translation.vector.norm());
        if rad > MOST_OFF_RAD.min(MOST_OFF * turns) || m > MOST_OFF * away {
            return Err(HandEyeError::Disagree { rad, m });
        }
        Ok(HandEye {
            tool_t_camera: self.tool_t_camera,
            sd: std::array::from_fn(|k| found[(k, k)].sqrt()),
            base_t_target: self.base_t_target,
            rms_rad: rad,
            rms_m: m,
            rejected: Vec::new(),
        })
    }

    /// The angle and the distance of the target as seen from where it is expected, rad and m.
    fn off(&self, sample: &Sample) -> (f64, f64) {
        let (turn, way) = self.residual(sample);
        (turn.norm(), way.norm())
    }

    /// The samples that are off by no more than usual, both ways.
    fn agreeing(&self, samples: &[Sample]) -> Vec<usize> {
        let (turns, ways): (Vec<f64>, Vec<f64>) =
            samples.iter().map(|sample| self.off(sample)).unzip();
        let limit = |all: &[f64]| {
            let mut sorted = all.to_vec();
            sorted.sort_by(f64::total_cmp);
            let median = sorted.get(sorted.len() / 2).copied().unwrap_or_default();
            REJECT_MEDIANS * median.max(ROUNDED)
        };
        let (turn_limit, way_limit) = (limit(&turns), limit(&ways));
        let both = turns.iter().zip(&ways).enumerate();
        both.filter(|(_, (turn, way))| **turn <= turn_limit && **way <= way_limit)
            .map(|(row, _)| row)
            .collect()
    }

    /// Park and Martin's closed form over pairs of samples.
    fn start(samples: &[Sample]) -> Result<Self, HandEyeError> {
        let paired = samples.get(..MOST_PAIRED).unwrap_or(samples);
        let pairs = || {
            paired.iter().enumerate().flat_map(|(index, one)| {
                let later = paired.iter().skip(index + 1);
                later.map(|other| {
                    let a = one.base_t_tool.inverse() * other.base_t_tool;
                    let b = one.camera_t_target * other.camera_t_target.inverse();
                    (a, b)
                })
            })
        };
        let (mut spread, mut both) = (Matrix3::zeros(), Matrix3::zeros());
        let mut longest = 0.0_f64;
        for (a, b) in pairs() {
            let (a, b) = (a.rotation.scaled_axis(), b.rotation.scaled_axis());
            spread += a * a.transpose();
            both += a * b.transpose();
            longest = longest.max(a.norm());
        }
        if longest < LEAST_TURN {
            return Err(HandEyeError::NoTurns(longest));
        }
        let mut extents: [f64; 3] = spread.symmetric_eigenvalues().into();
        extents.sort_by(|a, b| b.total_cmp(a));
        let second = (extents[1].max(0.0) / extents[0]).sqrt();
        if second < LEAST_SPREAD {
            return Err(HandEyeError::OneAxis(second));
        }
        // The turn that carries the axes seen by the camera best onto those of the tool.
        let svd = both.svd(true, true);
        let (Some(u), Some(v)) = (svd.u, svd.v_t) else {
            return Err(HandEyeError::Undetermined);
        };
        let sign = (u * v).determinant().signum();
        let turn = u * Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, sign)) * v;
        let (mut normal, mut right) = (Matrix3::zeros(), Vector3::zeros());
        for (a, b) in pairs() {
            let rows = a.rotation.to_rotation_matrix().into_inner() - Matrix3::identity();
            normal += rows.transpose() * rows;
            let shift = turn * b.translation.vector - a.translation.vector;
            right += rows.transpose() * shift;
        }
        let shift = normal.try_inverse().ok_or(HandEyeError::Undetermined)? * right;
        let turn = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(turn));
        let tool_t_camera = Isometry3::from_parts(Translation3::from(shift), turn);
        let first = samples.first().ok_or(HandEyeError::Undetermined)?;
        Ok(Self {
            tool_t_camera,
            base_t_target: first.base_t_tool * tool_t_camera * first.camera_t_target,
        })
    }

    /// The turn and the way from the target as expected to the target as seen, in the camera's frame, rad and m.
    fn residual(&self, sample: &Sample) -> (Vector3<f64>, Vector3<f64>) {
        let base_t_camera = sample.base_t_tool * self.tool_t_camera;
        let expected = base_t_camera.inverse() * self.base_t_target;
        let seen = sample.camera_t_target;
        let turn = (seen.rotation * expected.rotation.inverse()).scaled_axis();
        (turn, seen.translation.vector - expected.translation.vector)
    }

    /// Standard deviations of a coordinate of the turns and of the ways.
    fn noise(&self, samples: &[Sample]) -> (f64, f64) {
        let spare = (3 * samples.len()).saturating_sub(UNKNOWN / 2).max(1) as f64;
        let residuals = samples.iter().map(|sample| self.residual(sample));
        let (turns, ways) = residuals.fold((0.0, 0.0), |(turns, ways), (turn, way)| {
            (turns + turn.norm_squared(), ways + way.norm_squared())
        });
        let sd = |squares: f64| (squares / spare).sqrt().max(LEAST_NOISE);
        (sd(turns), sd(ways))
    }

    /// Moved by turns on the left and shifts of both poses.
    fn moved(&self, by: &SVector<f64, UNKNOWN>) -> Self {
        let moved = |pose: &Isometry3<f64>, at: usize| {
            let turn = UnitQuaternion::new(by.fixed_rows::<3>(at).into_owned());
            let shift = pose.translation.vector + by.fixed_rows::<3>(at + 3);
            Isometry3::from_parts(Translation3::from(shift), turn * pose.rotation)
        };
        Self {
            tool_t_camera: moved(&self.tool_t_camera, 0),
            base_t_target: moved(&self.base_t_target, 6),
        }
    }

    fn residuals(&self, samples: &[Sample], noise: (f64, f64)) -> DVector<f64> {
        let all = samples.iter().flat_map(|sample| {
            let (turn, way) = self.residual(sample);
            let (turn, way) = (turn / noise.0, way / noise.1);
            [turn.x, turn.y, turn.z, way.x, way.y, way.z]
        });
        DVector::from_iterator(6 * samples.len(), all)
    }

    /// The normal equations of a step, by differences: JᵀJ and Jᵀr.
    fn equations(
        &self,
        samples: &[Sample],
        noise: (f64, f64),
    ) -> (SMatrix<f64, UNKNOWN, UNKNOWN>, SVector<f64, UNKNOWN>) {
        const STEP: f64 = 1e-6;
        let mut jacobian = DMatrix::zeros(6 * samples.len(), UNKNOWN);
        for column in 0..UNKNOWN {
            let at = |sign: f64| {
                let mut by = SVector::zeros();
                by[column] = sign * STEP;
                self.moved(&by).residuals(samples, noise)
            };
            jacobian.set_column(column, &((at(1.0) - at(-1.0)) / (2.0 * STEP)));
        }
        let residuals = self.residuals(samples, noise);
        let normal = jacobian.transpose() * &jacobian;
        let right = jacobian.transpose() * residuals;
        (
            SMatrix::from_iterator(normal.iter().copied()),
            SVector::from_iterator(right.iter().copied()),
        )
    }

    /// Least squares by Gauss and Newton's method; the start is near.
    fn refined(mut self, samples: &[Sample], noise: (f64, f64)) -> Result<Self, HandEyeError> {
        for _ in 0..20 {
            let (normal, right) = self.equations(samples, noise);
            let step = normal.cholesky().ok_or(HandEyeError::Undetermined)?;
            let step = -step.solve(&right);
            if !step.iter().all(|x| x.is_finite()) {
                return Err(HandEyeError::Undetermined);
            }
            self = self.moved(&step);
            // Far below what any noise leaves open; derivatives by differences do not let it come to rest.
            if step.amax() < 1e-11 {
                break;
            }
        }
        Ok(self)
    }
}

#[cfg(test)]
mod tests;
