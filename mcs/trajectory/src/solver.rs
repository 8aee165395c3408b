//! Where the tip of an arm is, and which joint positions put it where: in closed form where the arm has one, else by
//! search. Owns the scratch that this needs, so whoever computes has one of its own; no evaluation allocates.

use std::sync::Arc;

use nalgebra::{Isometry3, Matrix6, Vector6};

use mcs_model::inverse::{Branch, ClosedForm, Elbow, IkError, Preferences, Search};
use mcs_model::{Data, Model, Placement};
use mcs_model::{Joints, TooManyJoints};

/// Finds joint positions for poses of a model's tip. One that is built allocates nothing: the servo asks it in its ticks.
pub trait Inverse: std::fmt::Debug + Send + Sync {
    /// See [`Solver::nearest`].
    ///
    /// # Errors
    /// [`IkError`].
    fn nearest(
        &mut self,
        model: &Model,
        base_t_tip: &Isometry3<f64>,
        near: &[f64],
        elbow: Option<Elbow>,
    ) -> Result<Joints, IkError>;

    /// See [`Solver::follow`].
    ///
    /// # Errors
    /// [`IkError`].
    fn follow(
        &mut self,
        model: &Model,
        base_t_tip: &Isometry3<f64>,
        branch: Option<Branch>,
        near: &[f64],
    ) -> Result<Joints, IkError>;

    /// The posture that joint positions are in, where there are some to be told apart.
    fn branch_of(&self, q: &[f64]) -> Option<Branch> {
        let _ = q;
        None
    }

    /// Another one with scratch of its own.
    fn another(&self) -> Box<dyn Inverse>;
}

impl Clone for Box<dyn Inverse> {
    fn clone(&self) -> Self {
        self.another()
    }
}

/// The closed form of an arm with a spherical wrist and a PUMA's geometry.
#[derive(Debug, Clone)]
pub struct ByClosedForm(ClosedForm);

impl ByClosedForm {
    /// That of a model, if it has one.
    #[must_use]
    pub fn of(model: &Model) -> Option<Self> {
        ClosedForm::of(model, model.tip()).map(Self)
    }
}

impl Inverse for ByClosedForm {
    fn nearest(
        &mut self,
        _: &Model,
        base_t_tip: &Isometry3<f64>,
        near: &[f64],
        elbow: Option<Elbow>,
    ) -> Result<Joints, IkError> {
        let near = six(near);
        let found = self.0.inverse(&Placement::from(base_t_tip), &near)?;
        let best = found.nearest_within(self.0.limits(), &near, elbow)?;
        Ok(best.joints.into())
    }

    fn follow(
        &mut self,
        _: &Model,
        base_t_tip: &Isometry3<f64>,
        branch: Option<Branch>,
        near: &[f64],
    ) -> Result<Joints, IkError> {
        let (goal, near) = (Placement::from(base_t_tip), six(near));
        let branch = branch.unwrap_or_else(|| self.0.branch_of(&near));
        Ok(self.0.inverse_branch(&goal, branch, &near)?.into())
    }

    fn branch_of(&self, q: &[f64]) -> Option<Branch> {
        Some(self.0.branch_of(&six(q)))
    }

    fn another(&self) -> Box<dyn Inverse> {
        Box::new(self.clone())
    }
}

/// A search, for any arm.
#[derive(Debug, Clone)]
pub struct BySearch(Search);

impl BySearch {
    /// One for a model's tip.
    #[must_use]
    pub fn of(model: &Model) -> Self {
        Self(Search::new(
            model,
            model.tip(),
            true,
            Preferences::default(),
        ))
    }
}

impl Inverse for BySearch {
    fn nearest(
        &mut self,
        model: &Model,
        base_t_tip: &Isometry3<f64>,
        near: &[f64],
        elbow: Option<Elbow>,
    ) -> Result<Joints, IkError> {
        if elbow.is_some() {
            return Err(IkError::NoElbow);
        }
        let found = self.0.solve(model, &Placement::from(base_t_tip), near)?;
        Ok(Joints::from_fn(found.len(), |index| found[index]))
    }

    fn follow(
        &mut self,
        model: &Model,
        base_t_tip: &Isometry3<f64>,
        _: Option<Branch>,
        near: &[f64],
    ) -> Result<Joints, IkError> {
        let found = self.0.follow(model, &Placement::from(base_t_tip), near)?;
        Ok(Joints::from_fn(found.len(), |index| found[index]))
    }

    fn another(&self) -> Box<dyn Inverse> {
        Box::new(self.clone())
    }
}

/// Kinematics of one model's tip.
#[derive(Debug, Clone)]
pub struct Solver {
    model: Arc<Model>,
    data: Data,
    inverse: Box<dyn Inverse>,
    /// Gives speeds and accelerations.
    search: Search,
    /// How many joints carry the tip.
    carriers: usize,
}

/// Six positions for the closed form; what is missing counts as NaN.
fn six(q: &[f64]) -> [f64; 6] {
    std::array::from_fn(|index| q.get(index).copied().unwrap_or(f64::NAN))
}

impl Solver {
    /// A solver for the tip of `model`: by the closed form where it has one, else by search.
    ///
    /// # Errors
    /// [`TooManyJoints`].
    pub fn new(model: Arc<Model>) -> Result<Self, TooManyJoints> {
        let inverse: Box<dyn Inverse> = match ByClosedForm::of(&model) {
            Some(closed) => Box::new(closed),
            None => Box::new(BySearch::of(&model)),
        };
        Self::by(model, inverse)
    }

    /// A solver that finds joint positions in a given way.
    ///
    /// # Errors
    /// [`TooManyJoints`].
    pub fn by(model: Arc<Model>, inverse: Box<dyn Inverse>) -> Result<Self, TooManyJoints> {
        TooManyJoints::check(model.dof())?;
        let tip = model.tip();
        Ok(Self {
            data: model.data(),
            carriers: model.chain(tip).len(),
            inverse,
            search: Search::new(&model, tip, true, Preferences::default()),
            model,
        })
    }

    /// The arm.
    #[must_use]
    pub fn model(&self) -> &Arc<Model> {
        &self.model
    }

    /// `base_t_tip` at joint positions `q` (rad or m).
    pub fn pose(&mut self, q: &[f64]) -> Isometry3<f64> {
        let tip = self.model.tip();
        self.model.placement(&mut self.data, q, tip).isometry()
    }

    /// Joint positions (rad or m) that put the tip at `base_t_tip`. Of an arm with a closed form the posture that takes
    /// the shortest time from `near`, perhaps among those with one elbow posture; of another the one that a search from
    /// `near` finds. Joints that do not carry the tip stay at `near`.
    ///
    /// # Errors
    /// [`IkError`]; an elbow posture of an arm without a closed form is [`IkError::NoElbow`].
    pub fn nearest(
        &mut self,
        base_t_tip: &Isometry3<f64>,
        near: &[f64],
        elbow: Option<Elbow>,
    ) -> Result<Joints, IkError> {
        self.inverse.nearest(&self.model, base_t_tip, near, elbow)
    }

    /// The posture that joint positions `q` (rad) are in, of an arm with a closed form.
    #[must_use]
    pub fn branch_of(&self, q: &[f64]) -> Option<Branch> {
        self.inverse.branch_of(q)
    }

    /// Joint positions (rad or m) that put the tip at `base_t_tip`, next to `near`: for following a path. An arm with a
    /// closed form stays in the posture `branch`.
    ///
    /// # Errors
    /// [`IkError`].
    pub fn follow(
        &mut self,
        base_t_tip: &Isometry3<f64>,
        branch: Option<Branch>,
        near: &[f64],
    ) -> Result<Joints, IkError> {
        self.inverse.follow(&self.model, base_t_tip, branch, near)
    }

    /// Joint speeds and accelerations at positions `q` that move the tip with `velocity` (m/s, then rad/s) and
    /// `acceleration` (m/s^2, rad/s^2), in the base frame: the smallest ones. `None` at a singular pose.
    pub fn rates(
        &mut self,
        q: &[f64],
        velocity: &Vector6<f64>,
        acceleration: &Vector6<f64>,
    ) -> Option<(Joints, Joints)> {
        let mut speeds = Joints::zeros(self.model.dof());
        let mut rates = speeds;
        let wanted = (velocity, acceleration);
        self.search
            .rates(&self.model, q, wanted, (&mut speeds, &mut rates))?;
        Some((speeds, rates))
    }

    /// The smallest singular value of the tip's Jacobian at positions `q`: how little the joint that moves the tip least
    /// moves it, m and rad together, per rad or m. Zero where the arm is singular.
    pub fn smallest_singular_value(&mut self, q: &[f64]) -> f64 {
        let tip = self.model.tip();
        let jacobian = self.model.jacobian(&mut self.data, q, tip);
        let mut square = Matrix6::zeros();
        for column in jacobian.column_iter() {
            let column = column.fixed_rows::<6>(0).into_owned();
            square += column * column.transpose();
        }
        // Fewer joints than six leave directions in which the tip cannot move anyway.
        let mut values = square.symmetric_eigenvalues();
        values.as_mut_slice().sort_by(|a, b| b.total_cmp(a));
        let last = self.carriers.clamp(1, 6) - 1;
        values[last].max(0.0).sqrt()
    }
}
