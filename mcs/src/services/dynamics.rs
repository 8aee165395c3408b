//! The class `dyn`: gravity, inverse dynamics and the mass matrix of an arm.

use std::sync::LazyLock;

use sorma::{Context, Form, OptionTable, Outcome, Report, ServiceObject, Transport};

use super::{PEDESTAL, arm, code, ended, joints};
use crate::arm::{ArmModel, DOF, DynamicsOptions};

const FORMS: &[Form] = &[
    Form {
        text: "gravity",
        floats: 6,
        takes: "joint positions q1 to q6, rad",
        gives: "6 floats, N m",
        results: "t1 t2 t3 t4 t5 t6: N m",
        help: "joint torques that hold the arm at rest",
    },
    Form {
        text: "rne",
        floats: 18,
        takes: "6 positions in rad, 6 speeds in rad/s, 6 accelerations in rad/s^2",
        gives: "6 floats, N m",
        results: "t1 t2 t3 t4 t5 t6: N m",
        help: "inverse dynamics: joint torques that give the accelerations",
    },
    Form {
        text: "inertia",
        floats: 6,
        takes: "joint positions q1 to q6, rad",
        gives: "36 floats, row by row, kg m^2",
        results: "inertia 6x6: kg m^2",
        help: "joint-space mass matrix",
    },
];

#[derive(Debug, Clone)]
pub(super) struct Options {
    arm: String,
    inertias: String,
    rotor: bool,
    friction: bool,
    gravity: f64,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            arm: "puma560".to_owned(),
            inertias: "identified".to_owned(),
            rotor: false,
            friction: false,
            gravity: 9.81,
        }
    }
}

impl Options {
    fn model(&self) -> ArmModel {
        let mut model = arm(&self.inertias, PEDESTAL);
        model.gravity.z = -self.gravity;
        model
    }

    fn counted(&self) -> DynamicsOptions {
        DynamicsOptions {
            rotor_inertia: self.rotor,
            friction: self.friction,
        }
    }
}

pub(super) static TABLE: LazyLock<OptionTable<Options>> = LazyLock::new(|| {
    OptionTable::new("rigid-body dynamics of an arm")
        .exec(FORMS)
        .choice(
            "arm",
            &["puma560"],
            "whose dynamics",
            |options: &mut Options| &mut options.arm,
        )
        .choice(
            "inertias",
            &["identified", "engine"],
            "the published set, or the one changed so that physics engines accept it",
            |options| &mut options.inertias,
        )
        .flag(
            "rotor",
            "adds the inertia of the rotors to rne and inertia",
            |options| &mut options.rotor,
        )
        .flag(
            "friction",
            "adds viscous and Coulomb friction to rne",
            |options| &mut options.friction,
        )
        .float(
            "gravity",
            0.0..=100.0,
            "m/s^2",
            "acceleration of gravity, along -z of the base frame",
            |options| &mut options.gravity,
        )
});

/// An object of class `dyn`.
pub(super) struct Dynamics {
    options: Options,
    model: ArmModel,
}

impl Default for Dynamics {
    fn default() -> Self {
        let options = Options::default();
        let model = options.model();
        Self { options, model }
    }
}

impl ServiceObject for Dynamics {
    fn exec(&mut self, _cx: &Context<'_>, io: &mut Transport) -> Outcome {
        let outcome = TABLE
            .form(io)
            .and_then(|form| self.compute(form.text, &mut io.floats));
        ended(io, outcome)
    }

    fn ctrl(&mut self, _cx: &Context<'_>, io: &mut Transport) -> Outcome {
        TABLE.ctrl(&mut self.options, io);
        self.model = self.options.model();
        Ok(())
    }

    fn dump(&self) -> String {
        TABLE.dump(&self.options)
    }
}

impl Dynamics {
    /// From the numbers of a request to those of its answer, in place.
    fn compute(&self, what: &str, floats: &mut Vec<f64>) -> Outcome {
        let counted = self.options.counted();
        let q = joints(floats, 0);
        match what {
            "gravity" => {
                let torques = self.model.gravity_torques(&q);
                floats.clear();
                floats.extend(torques);
            }
            "rne" => {
                let (qd, qdd) = (joints(floats, DOF), joints(floats, 2 * DOF));
                let torques = self.model.inverse_dynamics(&q, &qd, &qdd, counted);
                floats.clear();
                floats.extend(torques);
            }
            _ => {
                let matrix = self.model.mass_matrix(&q, counted);
                floats.clear();
                floats.extend(matrix.transpose().iter());
            }
        }
        if floats.iter().all(|float| float.is_finite()) {
            return Ok(());
        }
        let text = format!("EXEC {what}: speeds or accelerations are too large to compute with");
        Err(Report::error(code::TOO_LARGE, text))
    }
}
