//! The class `psom`: a parameterized self-organizing map from a table of examples.

use std::{fmt::Write as _, fs, path::Path, sync::LazyLock};

use sorma::{Context, Form, OptionTable, Outcome, Report, ServiceObject, Transport};

use super::{
    code, ended, opened,
    table::{self, Columns},
    told,
};
use crate::psom::{Psom, Scratch, Search};

const COLUMNS: Columns = Columns {
    names: &[],
    count: None,
    may_be_empty: &[],
    help: "the first line names the columns: the parameters of a node, then the components of its vector; a row is a node",
};

const FORMS: &[Form] = &[
    Form {
        text: "complete",
        floats: Form::ANY,
        takes: "D values and then D weights; a weight of 0 means that the value is unknown",
        gives: "D + P + 1 floats: the completed values, the parameters of the nearest point of the map, and E = half the sum \
                of weight times squared difference over the known components",
        results: "",
        help: "the point of the map that is nearest to the known components of a vector",
    },
    Form {
        text: "jacobian",
        floats: Form::ANY,
        takes: "P parameters",
        gives: "D P floats: derivatives of the vector by the parameters, row by row",
        results: "",
        help: "derivatives of the map",
    },
    Form {
        text: "value",
        floats: Form::ANY,
        takes: "P parameters",
        gives: "D floats",
        results: "",
        help: "the vector at parameters",
    },
    Form {
        text: "save FILE",
        floats: 0,
        takes: "",
        gives: "nothing; the file can be given to -train",
        results: "",
        help: "writes the map as the table that it can be trained from",
    },
];

#[derive(Debug, Clone, PartialEq)]
pub(super) struct Options {
    train: String,
    params: i64,
    local: i64,
    restarts: i64,
    good: f64,
    reach: f64,
}

impl Default for Options {
    fn default() -> Self {
        let search = Search::default();
        Self {
            train: String::new(),
            params: 0,
            local: 0,
            restarts: i64::try_from(search.restarts).unwrap_or_default(),
            good: search.good,
            reach: search.reach,
        }
    }
}

pub(super) static TABLE: LazyLock<OptionTable<Options>> = LazyLock::new(|| {
    OptionTable::new("maps between all quantities that a few examples relate (PSOM)")
        .exec(FORMS)
        .word(
            "train",
            "FILE",
            "the table of the examples (CSV with a header): a row for each node of a full grid with any spacing, first its \
             -params parameters, then the components of its vector",
            |options: &mut Options| &mut options.train,
        )
        .int(
            "params",
            0..=6,
            "",
            "how many parameters the map has; must be set with -train",
            |options| &mut options.params,
        )
        .int(
            "local",
            0..=100,
            "nodes",
            "uses only so many nodes a side, about the answer; 0: all",
            |options| &mut options.local,
        )
        .int(
            "restarts",
            0..=16,
            "",
            "from how many more nodes a search begins anew while its error is not good",
            |options| &mut options.restarts,
        )
        .float(
            "good",
            0.0..=1.0,
            "",
            "an error is good below this share of the spans of the known components",
            |options| &mut options.good,
        )
        .float(
            "reach",
            0.0..=10.0,
            "",
            "how far outside the grid an answer may lie, as a share of each axis",
            |options| &mut options.reach,
        )
});

/// A map with the names of its columns.
struct Trained {
    map: Psom,
    scratch: Scratch,
    names: Vec<String>,
}

/// An object of class `psom`.
#[derive(Default)]
pub(super) struct Map {
    options: Options,
    trained: Option<Trained>,
}

impl ServiceObject for Map {
    fn exec(&mut self, _cx: &Context<'_>, io: &mut Transport) -> Outcome {
        let outcome = TABLE.form(io).and_then(|form| match form.text {
            "complete" => self.complete(io),
            "jacobian" => self.jacobian(io),
            "value" => self.value(io),
            _ => self.save(io),
        });
        ended(io, outcome)
    }

    fn ctrl(&mut self, _cx: &Context<'_>, io: &mut Transport) -> Outcome {
        let mut options = self.options.clone();
        // The table of options reads CTRL's text, and leaves it empty or an answer.
        let trains = io.text.split_whitespace().any(|word| word == "-train");
        TABLE.ctrl(&mut options, io);
        let changed = trains || options.params != self.options.params;
        if changed && !options.train.is_empty() {
            // What was there before stays when the table is no good.
            self.trained = Some(train(&options).inspect_err(|_| io.text.clear())?);
        }
        self.options = options;
        Ok(())
    }

    fn dump(&self) -> String {
        TABLE.dump(&self.options)
    }
}

fn train(options: &Options) -> Result<Trained, Report> {
    let parameters = usize::try_from(options.params).unwrap_or_default();
    if parameters == 0 {
        let text = "how many of the columns are parameters is not known: set it with -params P";
        return Err(Report::error(sorma::report::code::VALUE, text));
    }
    let source = opened(&options.train)?;
    let table = table::read(&source, &COLUMNS).map_err(told)?;
    let width = table.names.len();
    let map = Psom::train(&table.numbers, width, parameters)
        .map_err(|why| Report::error(code::NO_MAP, format!("{}: {why}", source.name())))?;
    Ok(Trained {
        scratch: map.scratch(),
        map,
        names: table.names,
    })
}

/// Refuses another number of floats than the map has.
fn counted(io: &Transport, count: usize, what: &str) -> Outcome {
    let given = io.floats.len();
    if given == count {
        return Ok(());
    }
    let text = format!("the map takes {count} floats here ({what}), not {given}");
    Err(Report::error(sorma::report::code::VALUE, text))
}

impl Map {
    fn trained(&mut self) -> Result<&mut Trained, Report> {
        self.trained.as_mut().ok_or_else(|| {
            let text = "there is no map yet: train one with CTRL -train FILE -params P";
            Report::error(code::NO_MAP, text)
        })
    }

    fn complete(&mut self, io: &mut Transport) -> Outcome {
        let search = Search {
            restarts: usize::try_from(self.options.restarts).unwrap_or_default(),
            good: self.options.good,
            reach: self.options.reach,
            ..Search::default()
        };
        let local = usize::try_from(self.options.local).unwrap_or_default();
        let Trained { map, scratch, .. } = self.trained()?;
        let (d, p) = (map.components(), map.parameters());
        counted(io, 2 * d, "values, and then weights")?;
        let (known, weights) = io.floats.split_at(d);
        let wrong = |why: crate::psom::Unknown| Report::error(code::NO_MAP, why.to_string());
        let (answer, good) = if local > 1 {
            let found = map.complete_locally(local, known, weights, &search);
            let (mut answer, parameters, error, good) = found.map_err(wrong)?;
            answer.extend(parameters);
            answer.push(error);
            (answer, good)
        } else {
            let found = map
                .complete(scratch, known, weights, &search)
                .map_err(wrong)?;
            let mut answer = found.values.to_vec();
            answer.extend_from_slice(&found.parameters[..p]);
            answer.push(found.error);
            (answer, found.good)
        };
        if !good {
            let error = answer.last().copied().unwrap_or_default();
            let text = format!(
                "no point of the map is near what is known: E is {error:?}, more than -good {:?} of the spans",
                search.good
            );
            io.report(Report::warning(code::NO_MAP, text));
        }
        io.floats = answer;
        Ok(())
    }

    fn jacobian(&mut self, io: &mut Transport) -> Outcome {
        let Trained { map, scratch, .. } = self.trained()?;
        counted(io, map.parameters(), "parameters")?;
        let mut jacobian = vec![0.0; map.components() * map.parameters()];
        map.jacobian(scratch, &io.floats, &mut jacobian);
        io.floats = jacobian;
        Ok(())
    }

    fn value(&mut self, io: &mut Transport) -> Outcome {
        let Trained { map, scratch, .. } = self.trained()?;
        counted(io, map.parameters(), "parameters")?;
        io.floats = map.at(scratch, &io.floats).to_vec();
        Ok(())
    }

    fn save(&mut self, io: &mut Transport) -> Outcome {
        let path = io.text.trim().strip_prefix("save").unwrap_or_default();
        let path = path.trim().to_owned();
        let Trained { map, names, .. } = self.trained()?;
        let mut text = names.join(",");
        text.push('\n');
        for (at, vector) in map.nodes() {
            let row: Vec<String> = at.iter().chain(vector).map(|x| format!("{x:?}")).collect();
            let _ = writeln!(text, "{}", row.join(","));
        }
        // A table that was there stays whole when the disk is full.
        let beside = format!("{path}.new");
        let written = fs::write(&beside, text).and_then(|()| fs::rename(&beside, Path::new(&path)));
        written
            .map_err(|error| Report::error(code::FILE, format!("cannot write `{path}`: {error}")))
    }
}
