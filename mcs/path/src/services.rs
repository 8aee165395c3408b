//! What this crate can do, as a class of service objects (SORMA technical report, chapter 1): `path` plans ways of an arm
//! among boxes and capsules that are named by text. It needs no running app, and moves nothing.

use std::{
    path::Path,
    sync::{Arc, LazyLock},
};

use ctos::{
    config::Node,
    diagnostic::{Findings, Source},
};
use mcs::{
    Joints,
    model::{Model, Placement, Solid, file::Inertias, origin::Origin},
};
use mcs_collision::guard::Surroundings;
use sorma::{
    Class, ClassInfo, Context, Form, OptionTable, Outcome, Report, ServiceObject, Sorm, Transport,
};

use crate::{
    search::{Options as Searching, PathError, Search},
    space::Space,
};

/// Version of the class.
const VERSION: &str = env!("CARGO_PKG_VERSION");

/// No object has more solids in its room.
const MOST_SOLIDS: usize = 1000;

sorma::prototypes! {
    /// The codes of the reports of this class.
    pub mod code {
        NO_WAY = 195, Error, "no way was found",
            "there may be none, or only a narrow one: set -iterations and -seed, or look at EXEC free";
        TOUCHES = 196, Error, "the arm touches something, or is nearer to it than the margin",
            "the text says what: choose another position, or set -margin";
        NO_SPACE = 197, Error, "the arm, or what stands around it, makes no sense",
            "the text says what, and where";
    }
}

/// The recipes that are shipped with the class.
pub const DICTIONARY: &str = "\
path.puma560 -arm puma560
path.testbed9 -arm testbed9
";

const FORMS: &[Form] = &[
    Form {
        text: "plan",
        floats: Form::ANY,
        takes: "2 n joint positions, rad or m: where it begins, and where it ends",
        gives: "m n floats: the points of the way, the start first; 2 ints: m and n; the text says how long it is and what is nearest",
        results: "points; ints points, joints",
        help: "plans a way on which the arm touches nothing, straight in the space of its joints from point to point; the same \
               -seed finds the same way",
    },
    Form {
        text: "free",
        floats: Form::ANY,
        takes: "n joint positions, rad or m",
        gives: "1 float: the least distance of two solids there, m; the text names them; or report 196",
        results: "distance: m",
        help: "tells whether the arm keeps its distance from everything at a position",
    },
    Form {
        text: "box",
        floats: 6,
        takes: "its centre and its edges along x, y and z of the arm's base frame, m",
        gives: "1 int: how many solids there are",
        results: "ints solids",
        help: "puts a box into the room",
    },
    Form {
        text: "capsule",
        floats: 7,
        takes: "both ends of its axis and its radius, m",
        gives: "1 int: how many solids there are",
        results: "ints solids",
        help: "puts a capsule into the room: a post, say",
    },
    Form {
        text: "clear",
        floats: 0,
        takes: "",
        gives: "1 int: how many solids there are, those of -room",
        results: "ints solids",
        help: "takes away every solid that was put into the room",
    },
];

#[derive(Debug, Clone, PartialEq)]
struct Options {
    arm: String,
    room: String,
    margin: f64,
    seed: i64,
    iterations: i64,
}

impl Default for Options {
    fn default() -> Self {
        let Searching {
            seed, iterations, ..
        } = Searching::default();
        Self {
            arm: "puma560".to_owned(),
            room: String::new(),
            margin: 0.02,
            seed: i64::try_from(seed).unwrap_or_default(),
            iterations: i64::from(iterations),
        }
    }
}

static TABLE: LazyLock<OptionTable<Options>> = LazyLock::new(|| {
    OptionTable::new("plans ways of an arm around obstacles")
        .exec(FORMS)
        .word(
            "arm",
            "ARM",
            "a model that is built in, or a file (.toml or .urdf)",
            |options: &mut Options| &mut options.arm,
        )
        .word(
            "room",
            "FILE",
            "a file in TOML with `room` as a recipe of the collision guard has it. Empty: none",
            |options| &mut options.room,
        )
        .float(
            "margin",
            0.0..=1.0,
            "m",
            "the distance that is kept",
            |options| &mut options.margin,
        )
        .int(
            "seed",
            0..=i64::MAX,
            "",
            "the same seed finds the same way",
            |options| &mut options.seed,
        )
        .int(
            "iterations",
            1..=100_000,
            "",
            "random positions that are tried before it is given up",
            |options| &mut options.iterations,
        )
});

/// Makes the class known to a manager.
pub fn register(sorm: &Sorm) {
    let class = Class::new("path", VERSION, |_, _| Ok(Box::new(Paths::new()?)));
    for (class, info) in [class.any_flavor()].into_iter().zip(classes()) {
        sorm.register(class.codes(code::PROTOTYPES).described(info));
    }
}

/// What a program may know about the class.
#[must_use]
pub fn classes() -> Vec<ClassInfo> {
    vec![TABLE.class("path", VERSION)]
}

/// An object of class `path`.
struct Paths {
    options: Options,
    model: Arc<Model>,
    /// Of the file, by name.
    room: Vec<(String, Solid)>,
    /// Put there by EXEC.
    put: Vec<(String, Solid)>,
}

impl From<PathError> for Report {
    fn from(error: PathError) -> Self {
        let code = match &error {
            PathError::Touches { .. } => code::TOUCHES,
            PathError::NoWay { .. } | PathError::NotFree { .. } => code::NO_WAY,
            PathError::Count { .. } | PathError::Limit { .. } | PathError::NoGoal => {
                sorma::report::code::VALUE
            }
            PathError::NoForm { .. } => code::NO_SPACE,
        };
        Self::error(code, error.to_string())
    }
}

fn wrong(findings: Findings) -> Report {
    let lines: Vec<String> = findings
        .into_sorted()
        .iter()
        .map(ToString::to_string)
        .collect();
    Report::error(code::NO_SPACE, lines.join("\n"))
}

impl Paths {
    fn new() -> Result<Self, Report> {
        Self::with(Options::default(), Vec::new())
    }

    fn with(options: Options, put: Vec<(String, Solid)>) -> Result<Self, Report> {
        let loaded = Origin::named(&options.arm).load(None, None, Inertias::Identified);
        let room = match options.room.as_str() {
            "" => Vec::new(),
            file => {
                let source = Source::read(Path::new(file));
                let source = source.map_err(|finding| wrong(finding.into()))?;
                let mut findings = Findings::new();
                let node = Node::from_toml(&source, &mut findings);
                if findings.has_errors() {
                    return Err(wrong(findings));
                }
                let around = Surroundings::read(&node);
                let around =
                    around.map_err(|error| Report::error(code::NO_SPACE, error.to_string()))?;
                around.room
            }
        };
        Ok(Self {
            model: Arc::new(loaded.map_err(wrong)?.model),
            options,
            room,
            put,
        })
    }

    fn space(&self) -> Space {
        let room = self.room.iter().chain(&self.put).cloned().collect();
        Space::new(
            Arc::clone(&self.model),
            Vec::new(),
            room,
            self.options.margin,
        )
    }

    /// So many positions of all joints.
    fn positions(&self, what: &str, floats: &[f64], count: usize) -> Result<Vec<Joints>, Report> {
        let joints = self.model.dof();
        if floats.len() != count * joints {
            return Err(Report::error(
                sorma::report::code::VALUE,
                format!(
                    "EXEC {what} of an arm of {joints} joints takes {} floats, not {}: write FMSG {0} and the numbers",
                    count * joints,
                    floats.len()
                ),
            ));
        }
        let rows = floats.chunks_exact(joints).map(Joints::try_from);
        let rows: Result<_, _> = rows.collect();
        rows.map_err(|error| Report::error(code::NO_SPACE, error.to_string()))
    }

    fn plan(&self, io: &mut Transport) -> Outcome {
        let ends = self.positions("plan", &io.floats, 2)?;
        let options = Searching {
            seed: self.options.seed.unsigned_abs(),
            iterations: u32::try_from(self.options.iterations).unwrap_or(u32::MAX),
            ..Searching::default()
        };
        let mut search = Search::new(self.space(), &ends[0], &ends[1..], options)?;
        let way = search.run()?;
        let nearest = way.nearest.as_ref();
        io.text = format!(
            "{} points, {:.3} m, {} random positions{}",
            way.points.len(),
            way.length_m,
            search.tried(),
            nearest.map_or_else(String::new, |near| format!("; {near}")),
        );
        let count = |count: usize| i64::try_from(count).unwrap_or(i64::MAX);
        io.ints = vec![count(way.points.len()), count(self.model.dof())];
        io.floats = way
            .points
            .iter()
            .flat_map(|point| point.iter().copied())
            .collect();
        Ok(())
    }

    fn free(&self, io: &mut Transport) -> Outcome {
        let at = self.positions("free", &io.floats, 1)?;
        let mut space = self.space();
        let free = space.stands_free(&at[0]);
        free.map_err(|touch| Report::error(code::TOUCHES, touch.to_string()))?;
        let nearest = space.nearest(&at[0]);
        io.floats = nearest.iter().map(|near| near.distance_m).collect();
        io.text = nearest.map_or_else(|| "nothing is near".to_owned(), |near| near.to_string());
        Ok(())
    }

    fn put(&mut self, what: &'static str, solid: (Solid, f64), io: &mut Transport) -> Outcome {
        let (solid, size) = solid;
        if size <= 0.0 {
            let text = format!("the sizes of a {what} are above 0 m");
            return Err(Report::error(sorma::report::code::VALUE, text));
        }
        if self.room.len() + self.put.len() >= MOST_SOLIDS {
            let text =
                format!("there are {MOST_SOLIDS} solids already: EXEC clear takes them away");
            return Err(Report::error(code::NO_SPACE, text));
        }
        let number = self.put.len() + 1;
        self.put.push((format!("{what} {number}"), solid));
        self.count(io);
        Ok(())
    }

    fn count(&self, io: &mut Transport) {
        io.floats.clear();
        io.text.clear();
        io.ints = vec![i64::try_from(self.room.len() + self.put.len()).unwrap_or(i64::MAX)];
    }
}

impl ServiceObject for Paths {
    fn exec(&mut self, _cx: &Context<'_>, io: &mut Transport) -> Outcome {
        let outcome = TABLE.form(io).map(|form| form.text);
        let outcome = outcome.and_then(|form| match (form, io.floats.as_slice()) {
            ("plan", _) => self.plan(io),
            ("free", _) => self.free(io),
            ("box", &[x, y, z, along, across, up]) => {
                let at = Placement::shifted(x, y, z);
                let half = [along / 2.0, across / 2.0, up / 2.0].into();
                let size = along.min(across).min(up);
                self.put("box", (Solid::Block { at, half }, size), io)
            }
            ("capsule", &[ax, ay, az, bx, by, bz, radius]) => {
                let (a, b) = ([ax, ay, az].into(), [bx, by, bz].into());
                self.put("capsule", (Solid::Capsule { a, b, radius }, radius), io)
            }
            _ => {
                self.put.clear();
                self.count(io);
                Ok(())
            }
        });
        if outcome.is_err() {
            io.text.clear();
            io.floats.clear();
            io.ints.clear();
        }
        outcome
    }

    fn ctrl(&mut self, _cx: &Context<'_>, io: &mut Transport) -> Outcome {
        let mut options = self.options.clone();
        TABLE.ctrl(&mut options, io);
        if options.arm != self.options.arm || options.room != self.options.room {
            let put = self.put.clone();
            *self = Self::with(options, put).inspect_err(|_| io.text.clear())?;
        } else {
            self.options = options;
        }
        Ok(())
    }

    fn dump(&self) -> String {
        TABLE.dump(&self.options)
    }
}
