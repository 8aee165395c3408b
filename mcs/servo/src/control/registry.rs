//! Control laws by the name that the configuration uses for them.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;

use ctos::config::Node;
use ctos::task::{Context, HandlerError};

use super::split_torque::{Exchange, SPLIT_TORQUE};
use super::{
    CartesianImpedance, ComputedTorque, ControlLaw, JointImpedance, JointImpedanceArgs, PidGravity,
    SplitTorque,
};
use crate::model::{DynamicsOptions, Model};

type Build =
    Arc<dyn Fn(&LawSettings<'_>) -> Result<Box<dyn ControlLaw>, HandlerError> + Send + Sync>;

/// What a law is made from.
#[derive(Clone, Copy)]
pub struct LawSettings<'a> {
    /// The arm.
    pub model: &'a Arc<Model>,
    /// Natural frequency of the position loop, Hz.
    pub bandwidth_hz: f64,
    /// Damping ratio of the position loop.
    pub damping: f64,
    /// The servo's.
    pub period: Duration,
    /// The servo's task, through which a law may share with tasks of its chassis; `None` while the app is checked.
    pub cx: Option<&'a Context>,
    /// The law's own arguments: `law_args` of the servo task, or an empty table.
    pub args: &'a Node,
}

/// The control laws that a program offers; given to `mcs::register`.
#[derive(Clone)]
pub struct LawRegistry {
    laws: BTreeMap<String, Build>,
}

impl Default for LawRegistry {
    fn default() -> Self {
        Self::new()
    }
}

impl LawRegistry {
    /// The laws that come with this crate: `pid`, which compensates gravity, `computed_torque`, `joint_impedance`,
    /// `cartesian_impedance`, and `split_torque` on two processors.
    #[must_use]
    pub fn new() -> Self {
        let mut registry = Self {
            laws: BTreeMap::new(),
        };
        registry.law("pid", |settings| {
            no_arguments(settings)?;
            let LawSettings {
                model,
                bandwidth_hz,
                damping,
                ..
            } = *settings;
            let law = PidGravity::new(Arc::clone(model), bandwidth_hz, damping);
            Ok(Box::new(law))
        });
        registry.law("computed_torque", |settings| {
            no_arguments(settings)?;
            let law = ComputedTorque::new(
                Arc::clone(settings.model),
                settings.bandwidth_hz,
                settings.damping,
                DynamicsOptions::WITH_ROTORS,
            );
            Ok(Box::new(law.with_integral()))
        });
        registry.law("joint_impedance", |settings| {
            let JointImpedanceArgs { stiffness } = settings.args.parse()?;
            let LawSettings {
                model,
                bandwidth_hz,
                damping,
                period,
                ..
            } = *settings;
            let usual = || JointImpedance::of_bandwidth(model, bandwidth_hz);
            let stiffness = stiffness.unwrap_or_else(usual);
            let law = JointImpedance::new(Arc::clone(model), stiffness, damping, period)?;
            Ok(Box::new(law))
        });
        registry.law("cartesian_impedance", |settings| {
            let (model, args) = (Arc::clone(settings.model), settings.args.parse()?);
            let law = CartesianImpedance::new(model, args, settings.damping)?;
            Ok(Box::new(law))
        });
        registry.law(SPLIT_TORQUE, |settings| {
            no_arguments(settings)?;
            let n = settings.model.dof();
            let shared = settings.cx.map(|cx| Exchange::of(cx, cx.name(), n));
            let exchange = shared.unwrap_or_else(|| Exchange::new(n));
            let model = Arc::clone(settings.model);
            let (bandwidth, damping) = (settings.bandwidth_hz, settings.damping);
            let law = SplitTorque::new(model, bandwidth, damping, exchange);
            Ok(Box::new(law))
        });
        registry
    }

    /// Registers a law under `name`, in place of one that has it already. It is built when the app is checked, and
    /// again on the servo task's processor; what it refuses is a finding.
    pub fn law(
        &mut self,
        name: &str,
        build: impl Fn(&LawSettings<'_>) -> Result<Box<dyn ControlLaw>, HandlerError>
        + Send
        + Sync
        + 'static,
    ) {
        self.laws.insert(name.to_owned(), Arc::new(build));
    }

    /// Makes the law called `name`; `None` when none is.
    ///
    /// # Errors
    /// What the law does not like about its settings.
    pub fn build(
        &self,
        name: &str,
        settings: &LawSettings<'_>,
    ) -> Option<Result<Box<dyn ControlLaw>, HandlerError>> {
        self.laws.get(name).map(|build| build(settings))
    }

    /// All names, in order.
    pub fn names(&self) -> impl Iterator<Item = &str> {
        self.laws.keys().map(String::as_str)
    }
}

fn no_arguments(settings: &LawSettings<'_>) -> Result<(), HandlerError> {
    #[derive(serde::Deserialize)]
    #[serde(deny_unknown_fields)]
    struct None {}
    let None {} = settings.args.parse()?;
    Ok(())
}
