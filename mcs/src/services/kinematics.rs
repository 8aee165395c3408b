//! The class `kin`: forward, differential and inverse kinematics of an arm.

use std::{f64::consts::TAU, sync::LazyLock};

use nalgebra::{Isometry3, Matrix3, Matrix6, Rotation3, Translation3, UnitQuaternion, Vector3};
use sorma::{Context, Form, OptionTable, Outcome, Report, ServiceObject, Transport};

use super::arm::{NamesArm, Which, described, pedestal};
use super::{code, ended, six};
use crate::model::inverse::{ClosedForm, IkError, IkSolution, Preferences, Search, Singular};
use crate::model::{Data, FrameId, Limits, Model, Placement, built_in, file::Inertias};

/// How many joints an arm with a closed form has.
const DOF: usize = 6;

type Joints = [f64; DOF];

/// A joint this little (rad) beyond its limit is rounding.
const LIMIT_ROUNDING: f64 = 1e-9;
/// Joint vectors this near each other (rad) in every joint are one solution.
const SAME: f64 = 1e-9;
/// Likewise where postures coincide, at a straight arm or over the shoulder: half of the digits are lost there.
const SAME_AT_SINGULARITY: f64 = 1e-5;
/// Sine of joint 5 below which the wrist is singular.
const WRIST_SINGULAR: f64 = 1e-9;
/// Smallest singular value of the tip's Jacobian, m and rad together per rad or m, below which the tip cannot move some way. A
/// search comes to a singular pose within the root of what it takes for reached.
const TIP_SINGULAR: f64 = 1e-4;
/// Departure of a rotation from an orthonormal matrix that is taken for a slip and not for rounding.
const NO_ROTATION: f64 = 1e-3;
/// Departure above which the rounding is worth a warning.
const ROUNDED: f64 = 1e-6;
/// Farther than this (m) nothing is that an arm could reach.
const FARTHEST: f64 = 1e6;

const FORMS: &[Form] = &[
    Form {
        text: "fkine",
        floats: 6,
        takes: "joint positions q1 to q6, rad",
        gives: "16 floats: base_T_6, row by row, m",
        results: "base_T_6 4x4: m",
        help: "forward kinematics. An arm of n joints takes n positions in the order of its model, rad, or m of one that slides; \
               for 6 stands the frame that -tip names, and the base frame of a testbed is the world",
    },
    Form {
        text: "jacobian",
        floats: 6,
        takes: "joint positions q1 to q6, rad",
        gives: "36 floats, row by row: vx vy vz wx wy wz of frame 6's origin in the base frame per rad/s of each joint",
        results: "jacobian 6x6: rows vx vy vz, m/s, and wx wy wz, rad/s, per rad/s of q1 to q6",
        help: "geometric Jacobian; of n joints 6 n floats, with zeros for those that do not carry the tip",
    },
    Form {
        text: "ikine",
        floats: 16,
        takes: "base_T_6, row by row, m",
        gives: "6 n floats: all n solutions, rad; 1 int: n",
        results: "* q1 q2 q3 q4 q5 q6: rad; ints solutions",
        help: "inverse kinematics of an arm with a PUMA's geometry: every solution, or the reason why there is none. With joint \
               positions to start from after the pose, 16+n floats, of every arm: n floats, the solution nearest to them; without a \
               PUMA's geometry it is found by damped least squares within the limits, or refused with 120",
    },
];

/// Inverse kinematics from a start. Its text is that of another form, so it stands in no table.
const FROM_START: Form = Form {
    text: "ikine",
    floats: 16 + DOF,
    takes: "base_T_6, row by row, m, and then 6 joint positions to start from, rad",
    gives: "6 floats, rad",
    results: "q1 q2 q3 q4 q5 q6: rad",
    help: "inverse kinematics: the solution nearest to the start",
};

/// The same of an arm with so many joints that is not the PUMA of the table.
fn forms(n: usize, closed: bool) -> Vec<Form> {
    let all = [
        (n, "joint positions in the model's order, rad or m"),
        (n, "joint positions in the model's order, rad or m"),
        (16, "base_T_tip, row by row, m"),
        (
            16 + n,
            "base_T_tip, row by row, m, and then joint positions to start from, rad or m",
        ),
    ];
    let forms = FORMS
        .iter()
        .chain([&FROM_START])
        .zip(all)
        .map(|(form, (floats, takes))| Form {
            floats,
            takes,
            ..*form
        });
    forms
        .filter(|form| closed || form.floats != 16 || form.text != "ikine")
        .collect()
}

#[derive(Debug, Clone, PartialEq)]
pub(super) struct Options {
    which: Which,
    pedestal: f64,
    limits: bool,
    turns: String,
    singular: String,
    near: Vec<f64>,
}

impl Default for Options {
    fn default() -> Self {
        let which = Which::default();
        Self {
            pedestal: pedestal(&which.arm).unwrap_or_default(),
            which,
            limits: true,
            turns: "all".to_owned(),
            singular: "refuse".to_owned(),
            near: vec![0.0; DOF],
        }
    }
}

impl NamesArm for Options {
    fn which(&mut self) -> &mut Which {
        &mut self.which
    }
}

pub(super) static TABLE: LazyLock<OptionTable<Options>> = LazyLock::new(|| {
    let table = OptionTable::new("kinematics of an arm")
        .exec(FORMS)
        .choice(
            "arm",
            &built_in::NAMES,
            "whose kinematics",
            |options: &mut Options| &mut options.which.arm,
        )
        .float(
            "d1",
            0.0..=5.0,
            "m",
            "height of a PUMA's shoulder above the base frame; 0 puts the base frame there",
            |options| &mut options.pedestal,
        )
        .flag(
            "limits",
            "ikine answers only what keeps every joint within its limits",
            |options| &mut options.limits,
        )
        .choice(
            "turns",
            &["all", "near"],
            "whether ikine answers all whole turns of a joint within its limits, or the one next to -near",
            |options| &mut options.turns,
        )
        .choice(
            "singular",
            &["refuse", "near"],
            "what ikine does at a singular wrist, where the solutions are infinitely many: refuse, \
             or answer those that keep joint 4 at -near",
            |options| &mut options.singular,
        )
        .floats(
            "near",
            &["Q1", "Q2", "Q3", "Q4", "Q5", "Q6"],
            -10.0..=10.0,
            "rad",
            "joint positions that -turns near and -singular near go by",
            |options| &mut options.near,
        );
    described(
        table,
        "whose pose: left or right of testbed18, a link of a URDF; any frame of the model. Empty: the model's own",
    )
});

/// An object of class `kin`.
pub(super) struct Kinematics {
    options: Options,
    model: Model,
    tip: FrameId,
    data: Data,
    closed: Option<ClosedForm>,
    search: Search,
    forms: Vec<Form>,
    /// What is odd about the arm's description and was not yet told.
    warnings: Vec<Report>,
}

impl Kinematics {
    /// An object with the usual options, or why there is none.
    pub(super) fn new() -> Result<Self, Report> {
        Self::with(Options::default())
    }

    fn with(options: Options) -> Result<Self, Report> {
        let loaded = options
            .which
            .load(Inertias::Identified, Some(options.pedestal))?;
        let (model, tip) = (loaded.model, loaded.tip);
        let closed = ClosedForm::of(&model, tip);
        let forms = match &closed {
            Some(_) if options.which == Which::default() => [FORMS, &[FROM_START]].concat(),
            closed => forms(model.dof(), closed.is_some()),
        };
        Ok(Self {
            data: model.data(),
            search: Search::new(&model, tip, options.limits, Preferences::default()),
            options,
            model,
            tip,
            closed,
            forms,
            warnings: loaded.warnings,
        })
    }
}

impl ServiceObject for Kinematics {
    fn exec(&mut self, _cx: &Context<'_>, io: &mut Transport) -> Outcome {
        let outcome = sorma::options::form(&self.forms, io).map(|form| (form.text, form.floats));
        let outcome = outcome.and_then(|form| match form {
            ("fkine", _) => self.forward(io),
            ("jacobian", _) => self.jacobian(io),
            (_, 16) => self.inverse(io),
            _ => self.inverse_from(io),
        });
        ended(io, outcome)
    }

    fn ctrl(&mut self, _cx: &Context<'_>, io: &mut Transport) -> Outcome {
        let mut options = self.options.clone();
        TABLE.ctrl(&mut options, io);
        if options == self.options {
            return Ok(());
        }
        if options.which.arm != self.options.which.arm && options.pedestal == self.options.pedestal
        {
            options.pedestal = pedestal(&options.which.arm).unwrap_or_default();
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

impl Kinematics {
    fn forward(&mut self, io: &mut Transport) -> Outcome {
        let frame = self.model.placement(&mut self.data, &io.floats, self.tip);
        io.floats.clear();
        for row in 0..3 {
            io.floats.extend(frame.rotation.row(row).iter());
            io.floats.push(frame.origin[row]);
        }
        io.floats.extend([0.0, 0.0, 0.0, 1.0]);
        far_from_nothing(io)
    }

    fn jacobian(&mut self, io: &mut Transport) -> Outcome {
        let jacobian = self.model.jacobian(&mut self.data, &io.floats, self.tip);
        io.floats.clear();
        for row in jacobian.row_iter() {
            io.floats.extend(row.iter());
        }
        far_from_nothing(io)
    }

    /// The solution nearest to where the request says to start.
    fn inverse_from(&mut self, io: &mut Transport) -> Outcome {
        let goal = Placement::from(&pose(io)?);
        let start = io.floats.split_off(16);
        let solution = match &self.closed {
            Some(closed) => {
                let near = six(&start);
                let found = closed
                    .inverse(&goal, &near)
                    .map_err(|error| unreachable(&error))?;
                let unlimited = [Limits::NONE; DOF];
                let limits = if self.options.limits {
                    closed.limits()
                } else {
                    &unlimited
                };
                let solution = found
                    .nearest_within(limits, &near, None)
                    .map_err(|why| outside(&why))?;
                meeting(found.singular, io);
                if let Some(what) = wrist(closed, &solution) {
                    let text = format!("{what}; joint 4 stays where it starts");
                    io.report(Report::warning(code::SINGULAR, text));
                }
                solution.joints.to_vec()
            }
            None => {
                let found = self.search.solve(&self.model, &goal, &start);
                let found = found.map_err(|error| unreachable(&error))?.to_vec();
                self.stuck(&found, io);
                found
            }
        };
        io.floats = solution;
        Ok(())
    }

    fn inverse(&self, io: &mut Transport) -> Outcome {
        let Some(closed) = &self.closed else {
            // Without a closed form no request comes here.
            return Err(Report::error(
                code::UNREACHABLE,
                "this arm has no closed form",
            ));
        };
        let goal = Placement::from(&pose(io)?);
        let near = six(&self.options.near);
        let found = closed
            .inverse(&goal, &near)
            .map_err(|error| unreachable(&error))?;
        let usable = |found: &&IkSolution| found.outside.is_none() || !self.options.limits;
        let postures: Vec<&IkSolution> = found.all.iter().filter(usable).collect();
        if postures.is_empty() {
            let why = match found.nearest_within(closed.limits(), &near, None) {
                Err(error) => error,
                // Not reached: without a posture within limits there is no nearest one.
                Ok(_) => IkError::NotFinite,
            };
            return Err(outside(&why));
        }
        let coincide = found.singular.elbow || found.singular.shoulder;
        meeting(found.singular, io);
        let mut wrists = postures.iter().filter_map(|posture| wrist(closed, posture));
        if let Some(what) = wrists.next() {
            self.singular(&what, io)?;
        }
        let same = if coincide { SAME_AT_SINGULARITY } else { SAME };
        let mut solutions: Vec<Joints> = Vec::new();
        for turned in postures
            .iter()
            .flat_map(|posture| self.turned(closed, posture))
        {
            let known = |other: &Joints| {
                let mut pairs = other.iter().zip(&turned);
                pairs.all(|(a, b)| (a - b).abs() <= same)
            };
            if !solutions.iter().any(known) {
                solutions.push(turned);
            }
        }
        io.floats.clear();
        io.floats.extend(solutions.iter().flatten());
        io.ints.clear();
        io.ints
            .push(i64::try_from(solutions.len()).unwrap_or(i64::MAX));
        Ok(())
    }

    /// Warns where the tip cannot move some way, of an arm whose postures no closed form knows.
    fn stuck(&mut self, q: &[f64], io: &mut Transport) {
        let chain = self.model.chain(self.tip);
        let jacobian = self.model.jacobian(&mut self.data, q, self.tip);
        let mut square = Matrix6::zeros();
        for &index in &chain {
            let column = jacobian.fixed_view::<6, 1>(0, index).into_owned();
            square += column * column.transpose();
        }
        let found = square.symmetric_eigen();
        let least = found.eigenvalues.imin();
        let value = found.eigenvalues[least].max(0.0).sqrt();
        // Fewer than six joints never move a tip every way.
        if chain.len() < 6 || value > TIP_SINGULAR {
            return;
        }
        let way = found.eigenvectors.column(least);
        let (along, about) = (way.fixed_rows::<3>(0), way.fixed_rows::<3>(3));
        let (what, [x, y, z]) = match along.norm() > about.norm() {
            true => ("move along", [along[0], along[1], along[2]]),
            false => ("turn about", [about[0], about[1], about[2]]),
        };
        io.report(Report::warning(
            code::MEET,
            format!(
                "singular: with these joint positions the tip cannot {what} {x:.3} {y:.3} {z:.3} of the base frame; the smallest \
                 singular value of its Jacobian is {value:.1e}"
            ),
        ));
    }

    /// At a singular wrist: refused, or with a warning answered.
    fn singular(&self, what: &str, io: &mut Transport) -> Outcome {
        if self.options.singular == "near" {
            io.report(Report::warning(
                code::SINGULAR,
                format!("{what}; joint 4 stays at -near"),
            ));
            return Ok(());
        }
        let text = format!(
            "{what}, so the solutions are infinitely many; `-singular near` answers those that keep joint 4 at -near"
        );
        Err(Report::error(code::SINGULAR, text))
    }

    /// The posture with every whole turn that keeps each joint within its limits; the posture alone
    /// when turns are not asked for.
    fn turned(&self, closed: &ClosedForm, posture: &IkSolution) -> Vec<Joints> {
        let mut all = vec![posture.joints];
        if self.options.turns == "near" || !self.options.limits {
            return all;
        }
        for (index, limit) in closed.limits().iter().enumerate() {
            let turned: Vec<Joints> = all
                .iter()
                .flat_map(|joints| {
                    [0.0, -TAU, TAU].into_iter().filter_map(move |turn| {
                        let mut joints = *joints;
                        let joint = joints.get_mut(index)?;
                        *joint = within(*joint + turn, limit)?;
                        Some(joints)
                    })
                })
                .collect();
            all = turned;
        }
        all
    }
}

/// What a singular wrist leaves undetermined; nothing where the wrist is not singular.
fn wrist(closed: &ClosedForm, posture: &IkSolution) -> Option<String> {
    let [.., q4, q5, q6] = posture.joints;
    let (sine, cosine) = closed.wrist(&posture.joints);
    if sine.abs() >= WRIST_SINGULAR {
        return None;
    }
    let (sign, only) = if (cosine > 0.0) == closed.wrist_turns_alike() {
        ("+", q4 + q6)
    } else {
        ("-", q4 - q6)
    };
    Some(format!(
        "singular: the wrist, where with joint 5 at {q5:?} rad the axes of joints 4 and 6 are one, and only q4 {sign} q6 = {only:?} rad is \
         determined"
    ))
}

/// Warns of a pose in which the arm cannot move one way although each of its postures there is determined.
fn meeting(singular: Singular, io: &mut Transport) {
    let mut warn = |text: &str| io.report(Report::warning(code::MEET, text.to_owned()));
    if singular.shoulder {
        warn(
            "singular shoulder: the wrist centre is as near to joint 1's axis as it can be; both shoulder postures \
             coincide, and the wrist cannot move straight towards that axis or away from it",
        );
    }
    if singular.elbow {
        warn(
            "singular elbow: the arm is stretched out or folded; both elbow postures coincide, and the wrist cannot \
             move straight towards the shoulder or away from it",
        );
    }
}

/// The position, when it is within the limits; rounding beyond them is taken off.
fn within(position: f64, limit: &Limits) -> Option<f64> {
    let clamped = position.clamp(limit.lower, limit.upper);
    ((position - clamped).abs() <= LIMIT_ROUNDING).then_some(clamped)
}

/// Finite positions that are too large leave no finite pose.
fn far_from_nothing(io: &Transport) -> Outcome {
    if io.floats.iter().all(|float| float.is_finite()) {
        return Ok(());
    }
    Err(Report::error(
        code::TOO_LARGE,
        "the joint positions are too large to compute with",
    ))
}

/// The pose's numbers are finite, so every error of inverse kinematics is one of reach.
fn unreachable(error: &IkError) -> Report {
    Report::error(code::UNREACHABLE, format!("unreachable: {error}"))
}

fn outside(why: &IkError) -> Report {
    let text = format!("outside joint limits in every posture: in the best of them {why}");
    Report::error(code::LIMITS, text)
}

/// The pose of 16 numbers, with a warning when its rotation had to be rounded.
pub(super) fn pose(io: &mut Transport) -> Result<Isometry3<f64>, Report> {
    let wrong = |text: String| Report::error(code::NO_POSE, text);
    let at = |row: usize, column: usize| io.floats.get(4 * row + column).copied().unwrap_or(0.0);
    let last = [at(3, 0), at(3, 1), at(3, 2), at(3, 3)];
    if last != [0.0, 0.0, 0.0, 1.0] {
        let text = format!(
            "the last row of base_T_6 is 0 0 0 1, not {last:?}; the 16 numbers go row by row"
        );
        return Err(wrong(text));
    }
    let origin = Vector3::new(at(0, 3), at(1, 3), at(2, 3));
    if origin.amax() > FARTHEST {
        let text = format!(
            "unreachable: frame 6 would be {:e} m away; lengths are in m",
            origin.amax()
        );
        return Err(Report::error(code::UNREACHABLE, text));
    }
    let given = Matrix3::from_fn(at);
    let off = (given.transpose() * given - Matrix3::identity()).amax();
    if off.is_nan() || off > NO_ROTATION {
        return Err(wrong(format!(
            "the rotation in base_T_6 is none: its columns are not of length 1 and at right angles, they are off by {off:.1e}"
        )));
    }
    if given.determinant() < 0.0 {
        let text = "the rotation in base_T_6 is mirrored: its determinant is -1, not 1";
        return Err(wrong(text.to_owned()));
    }
    let rotation = nearest_rotation(given)
        .ok_or_else(|| wrong("the rotation in base_T_6 is none".to_owned()))?;
    if off > ROUNDED {
        let text = format!(
            "the rotation in base_T_6 is off by {off:.1e}; the rotation nearest to it was taken"
        );
        io.report(Report::warning(code::NO_POSE, text));
    }
    Ok(Isometry3::from_parts(Translation3::from(origin), rotation))
}

/// The rotation nearest to a matrix that almost is one.
fn nearest_rotation(given: Matrix3<f64>) -> Option<UnitQuaternion<f64>> {
    let parts = given.try_svd(true, true, 1e-15, 200)?;
    let rotation = Rotation3::from_matrix_unchecked(parts.u? * parts.v_t?);
    Some(UnitQuaternion::from_rotation_matrix(&rotation))
}
