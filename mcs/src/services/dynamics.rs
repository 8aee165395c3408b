//! The class `dyn`: gravity, inverse dynamics and the mass matrix of an arm.

use std::sync::LazyLock;

use nalgebra::Vector3;
use sorma::{Context, Form, OptionTable, Outcome, Report, ServiceObject, Transport};

use super::arm::{NamesArm, Which, described};
use super::{code, ended};
use crate::model::{Data, DynamicsOptions, Model, built_in, file::Inertias, urdf};

const FORMS: &[Form] = &[
    Form {
        text: "gravity",
        floats: 6,
        takes: "joint positions q1 to q6, rad",
        gives: "6 floats, N m",
        results: "t1 t2 t3 t4 t5 t6: N m",
        help: "joint torques that hold the arm at rest. An arm of n joints takes n positions in the order of its model, rad, or m of \
               one that slides, whose force is in N",
    },
    Form {
        text: "rne",
        floats: 18,
        takes: "6 positions in rad, 6 speeds in rad/s, 6 accelerations in rad/s^2",
        gives: "6 floats, N m",
        results: "t1 t2 t3 t4 t5 t6: N m",
        help: "inverse dynamics: joint torques that give the accelerations; of n joints 3 n floats",
    },
    Form {
        text: "inertia",
        floats: 6,
        takes: "joint positions q1 to q6, rad",
        gives: "36 floats, row by row, kg m^2",
        results: "inertia 6x6: kg m^2",
        help: "joint-space mass matrix; of n joints n n floats",
    },
    Form {
        text: "fdyn",
        floats: 18,
        takes: "6 positions in rad, 6 speeds in rad/s, 6 torques in N m",
        gives: "6 floats, rad/s^2",
        results: "a1 a2 a3 a4 a5 a6: rad/s^2",
        help: "forward dynamics: joint accelerations under the torques; of n joints 3 n floats",
    },
    Form {
        text: "urdf",
        floats: 0,
        takes: "",
        gives: "text: the arm as a URDF, with its rotors and friction",
        results: "",
        help: "the description of the arm for programs of others; physics engines take it with -inertias engine",
    },
];

/// The same of an arm with so many joints that is not the PUMA of the table.
fn forms(n: usize) -> Vec<Form> {
    let all = [
        (n, "joint positions in the model's order, rad or m"),
        (
            3 * n,
            "all positions in the model's order, rad or m, then all speeds, then all accelerations",
        ),
        (n, "joint positions in the model's order, rad or m"),
        (
            3 * n,
            "all positions in the model's order, rad or m, then all speeds, then all torques",
        ),
        (0, ""),
    ];
    FORMS
        .iter()
        .zip(all)
        .map(|(form, (floats, takes))| Form {
            floats,
            takes,
            ..*form
        })
        .collect()
}

#[derive(Debug, Clone, PartialEq)]
pub(super) struct Options {
    which: Which,
    inertias: String,
    rotor: bool,
    friction: bool,
    gravity: f64,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            which: Which::default(),
            inertias: "identified".to_owned(),
            rotor: false,
            friction: false,
            gravity: 9.81,
        }
    }
}

impl Options {
    fn counted(&self) -> DynamicsOptions {
        DynamicsOptions {
            rotor_inertia: self.rotor,
            friction: self.friction,
        }
    }
}

impl NamesArm for Options {
    fn which(&mut self) -> &mut Which {
        &mut self.which
    }
}

pub(super) static TABLE: LazyLock<OptionTable<Options>> = LazyLock::new(|| {
    let table = OptionTable::new("rigid-body dynamics of an arm")
        .exec(FORMS)
        .choice(
            "arm",
            &built_in::NAMES,
            "whose dynamics",
            |options: &mut Options| &mut options.which.arm,
        )
        .choice(
            "inertias",
            &["identified", "engine"],
            "the published set, or the one changed so that physics engines accept it",
            |options| &mut options.inertias,
        )
        .flag(
            "rotor",
            "adds the inertia of the rotors to rne, inertia and fdyn",
            |options| &mut options.rotor,
        )
        .flag(
            "friction",
            "adds viscous and Coulomb friction to rne and fdyn",
            |options| &mut options.friction,
        )
        .float(
            "gravity",
            0.0..=100.0,
            "m/s^2",
            "acceleration of gravity, along -z of the base frame",
            |options| &mut options.gravity,
        );
    described(
        table,
        "where the way through a URDF ends; of other arms a frame of the model, and without meaning here",
    )
});

/// An object of class `dyn`.
pub(super) struct Dynamics {
    options: Options,
    model: Model,
    data: Data,
    forms: Vec<Form>,
    /// What is odd about the arm's description and was not yet told.
    warnings: Vec<Report>,
}

impl Dynamics {
    /// An object with the usual options, or why there is none.
    pub(super) fn new() -> Result<Self, Report> {
        Self::with(Options::default())
    }

    fn with(options: Options) -> Result<Self, Report> {
        let inertias = match options.inertias.as_str() {
            "engine" => Inertias::Engine,
            _ => Inertias::Identified,
        };
        let loaded = options.which.load(inertias, None)?;
        let model = loaded
            .model
            .with_gravity(Vector3::new(0.0, 0.0, -options.gravity));
        let forms = if options.which == Which::default() {
            FORMS.to_vec()
        } else {
            forms(model.dof())
        };
        Ok(Self {
            data: model.data(),
            options,
            model,
            forms,
            warnings: loaded.warnings,
        })
    }
}

impl ServiceObject for Dynamics {
    fn exec(&mut self, _cx: &Context<'_>, io: &mut Transport) -> Outcome {
        let outcome = sorma::options::form(&self.forms, io).map(|form| form.text);
        if outcome == Ok("urdf") {
            io.text = urdf::write(&self.model);
            return Ok(());
        }
        let outcome = outcome.and_then(|what| self.compute(what, &mut io.floats));
        ended(io, outcome)
    }

    fn ctrl(&mut self, _cx: &Context<'_>, io: &mut Transport) -> Outcome {
        let mut options = self.options.clone();
        TABLE.ctrl(&mut options, io);
        if options == self.options {
            return Ok(());
        }
        *self = Self::with(options).inspect_err(|_| io.text.clear())?;
        for warning in std::mem::take(&mut self.warnings) {
            io.report(warning);
        }
        Ok(())
    }

    fn dump(&self) -> String {
        TABLE.dump(&self.options)
    }
}

impl Dynamics {
    /// From the numbers of a request to those of its answer, in place.
    fn compute(&mut self, what: &str, floats: &mut Vec<f64>) -> Outcome {
        let counted = self.options.counted();
        let (model, data) = (&self.model, &mut self.data);
        let n = model.dof();
        // The table has counted them.
        let (q, rest) = floats.split_at(n.min(floats.len()));
        let (qd, third) = rest.split_at(n.min(rest.len()));
        match what {
            "gravity" => {
                let torques = model.gravity_torques(data, q);
                torques.clone_into(floats);
            }
            "rne" => {
                let torques = model.inverse_dynamics(data, q, qd, third, counted);
                torques.clone_into(floats);
            }
            "fdyn" => {
                let found = model.forward_dynamics(data, q, qd, third, counted);
                let found = found.map_err(|error| {
                    let name = model
                        .joints()
                        .get(error.joint)
                        .map_or("", |joint| joint.name.as_str());
                    Report::error(code::NO_INERTIA, format!("EXEC fdyn: {error} (`{name}`)"))
                })?;
                found.clone_into(floats);
            }
            _ => {
                let matrix = model.mass_matrix(data, q, counted);
                floats.clear();
                // It is symmetric: its columns are its rows.
                floats.extend(matrix.iter());
            }
        }
        if floats.iter().all(|float| float.is_finite()) {
            return Ok(());
        }
        let text = format!("EXEC {what}: speeds or accelerations are too large to compute with");
        Err(Report::error(code::TOO_LARGE, text))
    }
}
