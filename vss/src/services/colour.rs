//! The class `colour`: pixels of trained colour classes, and how far known colours have drifted.

use std::sync::LazyLock;

use ctos::diagnostic::{Finding, Findings, Source};
use sorma::{Context, Form, OptionTable, Outcome, Report, ServiceObject, Transport};
use vss_image::{
    Picture,
    colour::{Class, Classes, Training},
};

use super::{
    code, ended, opened, picture,
    table::{self, Columns},
    told,
};

/// A class whose samples are taken for it less often is told.
const AGREEMENT: f64 = 0.9;

const TRAINING: &str =
    "class,r,g,b: the name of a class, and red, green and blue of 0 to 255 of one of its pixels";

const WATCHED: Columns = Columns {
    names: &["u", "v", "radius", "r", "g", "b"],
    count: None,
    may_be_empty: &[],
    help: "u,v,radius,r,g,b: a disc in the picture (px), and red, green and blue (0 to 255) that its mean should be",
};

const FORMS: &[Form] = &[
    Form {
        text: "names",
        floats: 0,
        takes: "",
        gives: "the names of the classes in their order, as text",
        results: "",
        help: "which classes are known",
    },
    Form {
        text: "pixel",
        floats: 3,
        takes: "red, green, blue, 0 to 255",
        gives: "1 int: the class from 0, in the order of their names, or -1 (unknown); 1 float: confidence, 0 to 1; the \
                class's name as text",
        results: "confidence; ints class",
        help: "of which class a colour is",
    },
    Form {
        text: "watch FILE",
        floats: 0,
        takes: "",
        gives: "4 floats of each watched place: mean red, green and blue now, and how far they are from what they should be; 1 \
                int: how many are farther than -drift",
        results: "* r g b moved; ints drifted",
        help: "how far known colours have moved",
    },
    Form {
        text: "FILE",
        floats: 0,
        takes: "",
        gives: "ints: the pixels of each class in the order of the first samples of each, and of none of them (unknown); as \
                many floats: mean confidences of these pixels, 0 to 1; the classes' names as text",
        results: "",
        help: "counts the pixels of each class in a picture (PNG, JPEG, PNM, BMP)",
    },
];

#[derive(Debug, Clone, PartialEq)]
pub(super) struct Options {
    train: String,
    centres: i64,
    ridge: f64,
    unknown: f64,
    seed: i64,
    watch: String,
    drift: f64,
}

impl Default for Options {
    fn default() -> Self {
        let training = Training::default();
        Self {
            train: String::new(),
            centres: i64::try_from(training.centres).unwrap_or_default(),
            ridge: training.ridge,
            unknown: training.unknown,
            seed: i64::try_from(training.seed).unwrap_or_default(),
            watch: String::new(),
            drift: 20.0,
        }
    }
}

impl Options {
    fn training(&self) -> Training {
        Training {
            centres: usize::try_from(self.centres).unwrap_or(1),
            ridge: self.ridge,
            unknown: self.unknown,
            seed: self.seed.unsigned_abs(),
        }
    }
}

pub(super) static TABLE: LazyLock<OptionTable<Options>> = LazyLock::new(|| {
    OptionTable::new("tells colour classes apart, by a look-up table trained from labelled pixels")
        .exec(FORMS)
        .word(
            "train",
            "FILE",
            "the labelled pixels (CSV class,r,g,b), of two classes or more",
            |options: &mut Options| &mut options.train,
        )
        .int(
            "centres",
            1..=32,
            "",
            "Gaussian units of each class, at most",
            |options| &mut options.centres,
        )
        .float(
            "ridge",
            1e-9..=10.0,
            "",
            "how strongly the weights are held small",
            |options| &mut options.ridge,
        )
        .float(
            "unknown",
            0.0..=1.0,
            "",
            "colours whose units are all less active are of no class; 0: there are no unknown colours",
            |options| &mut options.unknown,
        )
        .int(
            "seed",
            0..=1_000_000_000,
            "",
            "of the first centres",
            |options| &mut options.seed,
        )
        .word(
            "watch",
            "FILE",
            "known colours at known places (CSV u,v,radius,r,g,b), looked at in every picture; more than -drift warns",
            |options| &mut options.watch,
        )
        .float(
            "drift",
            0.0..=441.0,
            "grey values",
            "how far a watched colour may move (root of the sum of squares of red, green and blue)",
            |options| &mut options.drift,
        )
});

/// An object of class `colour`.
#[derive(Default)]
pub(super) struct Colour {
    options: Options,
    classes: Option<Classes>,
    /// u, v, radius, r, g, b of each watched place.
    watched: Vec<f64>,
}

impl ServiceObject for Colour {
    fn exec(&mut self, _cx: &Context<'_>, io: &mut Transport) -> Outcome {
        let mut text = String::new();
        let outcome = TABLE.form(io).and_then(|form| {
            let path = io.text.trim().to_owned();
            match form.text {
                "names" => {
                    text = self.classes()?.names().join(" ");
                    Ok(())
                }
                "pixel" => self.pixel(io, &mut text),
                "watch FILE" => {
                    let path = path.strip_prefix("watch").unwrap_or_default().trim();
                    self.watch(path, io)
                }
                _ => self.count(&path, io, &mut text),
            }
        });
        let outcome = ended(io, outcome);
        if outcome.is_ok() {
            io.text = text;
        }
        outcome
    }

    fn ctrl(&mut self, _cx: &Context<'_>, io: &mut Transport) -> Outcome {
        let mut options = self.options.clone();
        let names =
            |io: &Transport, option: &str| io.text.split_whitespace().any(|word| word == option);
        let (trains, watches) = (names(io, "-train"), names(io, "-watch"));
        TABLE.ctrl(&mut options, io);
        // What was there before stays when a table is no good.
        let changed = trains || options.training() != self.options.training();
        let learned = if changed && !options.train.is_empty() {
            Some(train(&options.train, &options.training(), io).inspect_err(|_| io.text.clear())?)
        } else {
            None
        };
        if watches {
            self.watched = watched(&options.watch).inspect_err(|_| io.text.clear())?;
        }
        self.classes = learned.or(self.classes.take());
        self.options = options;
        Ok(())
    }

    fn dump(&self) -> String {
        TABLE.dump(&self.options)
    }
}

/// A labelled colour.
type Sample = (usize, [f64; 3]);

/// Reads the labelled pixels and learns from them. Classes that are hard to tell apart are reported as warnings.
pub(super) fn train(
    path: &str,
    training: &Training,
    io: &mut Transport,
) -> Result<Classes, Report> {
    let source = opened(path)?;
    let (names, samples) = labelled(&source).map_err(told)?;
    let classes = Classes::train(&names, &samples, training);
    let classes =
        classes.map_err(|why| Report::error(code::COLOURS, format!("{}: {why}", source.name())))?;
    for (name, (share, other)) in names.iter().zip(classes.agreement(&samples)) {
        if share >= AGREEMENT {
            continue;
        }
        let other = other.and_then(|other| names.get(other));
        let taken = other.map_or_else(
            || "the others are unknown".to_owned(),
            |other| format!("most others are taken for `{other}`"),
        );
        let text = format!(
            "only {:.0} % of the samples of class `{name}` are taken for it; {taken}",
            share * 100.0
        );
        io.report(Report::warning(code::DRIFT, text));
    }
    Ok(classes)
}

/// The names of the classes in the order of their first samples, and the samples.
fn labelled(source: &Source) -> Result<(Vec<String>, Vec<Sample>), Findings> {
    let mut findings = Findings::new();
    let mut rows = table::rows(source.text());
    let header = rows.next().unwrap_or_default();
    let column = |name: &str| {
        header
            .iter()
            .position(|(_, text)| text.eq_ignore_ascii_case(name))
    };
    let columns = ["class", "r", "g", "b"].map(column);
    let [Some(class), Some(red), Some(green), Some(blue)] = columns else {
        let given: Vec<&str> = header.iter().map(|(_, text)| *text).collect();
        let given: String = given.join(",").chars().take(80).collect();
        let text = format!("the first line must name the columns class,r,g,b, and is `{given}`");
        let finding = Finding::error("vss::table::header", text);
        findings.push(finding.at(table::whole(source, &header)).help(TRAINING));
        return Err(findings);
    };
    let (mut names, mut samples): (Vec<String>, Vec<Sample>) = Default::default();
    for fields in rows {
        if fields.len() != header.len() {
            let text = format!(
                "{} values stand here, and {} in the first line",
                fields.len(),
                header.len()
            );
            let finding = Finding::error("vss::table::row", text);
            findings.push(finding.at(table::whole(source, &fields)).help(TRAINING));
            continue;
        }
        let cell = |index: usize| fields.get(index).copied().unwrap_or_default();
        let (at, name) = cell(class);
        if name.is_empty()
            || name.contains(char::is_whitespace)
            || name.parse::<f64>().is_ok_and(f64::is_nan)
        {
            let text = format!("class must be one word, not `{name}`");
            let finding = Finding::error("vss::table::row", text);
            findings.push(finding.at(source.at(at..at + name.len())).help(TRAINING));
            continue;
        }
        let mut sample = |(at, text): (usize, &str), name: &str| {
            let number = text.parse::<f64>().ok();
            let number = number.filter(|number| (0.0..=255.0).contains(number));
            if number.is_none() {
                let shown: String = text.chars().take(40).collect();
                let text_of = format!("{name} must be a number from 0 to 255, not `{shown}`");
                let finding = Finding::error("vss::table::row", text_of);
                findings.push(finding.at(source.at(at..at + text.len())).help(TRAINING));
            }
            number.unwrap_or_default()
        };
        let rgb = [
            sample(cell(red), "r"),
            sample(cell(green), "g"),
            sample(cell(blue), "b"),
        ];
        let known = names.iter().position(|known| known == name);
        let place = known.unwrap_or_else(|| {
            names.push(name.to_owned());
            names.len() - 1
        });
        samples.push((place, rgb));
    }
    if findings.has_errors() {
        Err(findings)
    } else {
        Ok((names, samples))
    }
}

/// The known colours at known places; none without a file.
fn watched(path: &str) -> Result<Vec<f64>, Report> {
    if path.is_empty() {
        return Ok(Vec::new());
    }
    let source = opened(path)?;
    let table = table::read(&source, &WATCHED).map_err(told)?;
    for (nth, row) in table.rows().enumerate() {
        let colour = row.get(3..).unwrap_or_default();
        let radius = row.get(2).copied().unwrap_or_default();
        if radius < 0.0 || colour.iter().any(|sample| !(0.0..=255.0).contains(sample)) {
            let place = table.place(&source, nth);
            let text = format!("{place}: radius is at least 0, and r, g and b are within 0 to 255");
            return Err(Report::error(code::TABLE, text));
        }
    }
    Ok(table.numbers)
}

impl Colour {
    fn classes(&self) -> Result<&Classes, Report> {
        self.classes.as_ref().ok_or_else(|| {
            let text = "there are no colour classes yet: train them with CTRL -train FILE";
            Report::error(code::COLOURS, text)
        })
    }

    fn pixel(&self, io: &mut Transport, text: &mut String) -> Outcome {
        let classes = self.classes()?;
        if io
            .floats
            .iter()
            .any(|sample| !(0.0..=255.0).contains(sample))
        {
            let text = "red, green and blue are within 0 to 255";
            return Err(Report::error(sorma::report::code::VALUE, text));
        }
        let sample = |nth: usize| io.floats.get(nth).copied().unwrap_or_default().round() as u8;
        let Class { class, confidence } = classes.of([sample(0), sample(1), sample(2)]);
        let name = class.and_then(|class| classes.names().get(class));
        *text = name.cloned().unwrap_or_default();
        io.ints = vec![class.map_or(-1, |class| i64::try_from(class).unwrap_or(-1))];
        io.floats = vec![confidence];
        Ok(())
    }

    fn count(&self, path: &str, io: &mut Transport, text: &mut String) -> Outcome {
        let classes = self.classes()?;
        let picture = picture::opened(path, io)?;
        let drifted = self.drifted(path, &picture)?;
        if drifted.1 > 0 {
            let text = format!(
                "{} watched colours of `{path}` have moved by more than -drift {}: train anew, or mend the white balance",
                drifted.1, self.options.drift
            );
            io.report(Report::warning(code::DRIFT, text));
        }
        let counted = classes.counted(&picture.into_rgb());
        *text = classes.names().join(" ");
        let ints = counted
            .iter()
            .map(|one| i64::try_from(one.0).unwrap_or(i64::MAX));
        io.ints = ints.collect();
        io.floats = counted.iter().map(|one| one.1).collect();
        Ok(())
    }

    fn watch(&self, path: &str, io: &mut Transport) -> Outcome {
        if self.watched.is_empty() {
            let text = "no colours are watched: name some with CTRL -watch FILE";
            return Err(Report::error(code::COLOURS, text));
        }
        let picture = picture::opened(path, io)?;
        let (numbers, drifted) = self.drifted(path, &picture)?;
        if drifted > 0 {
            let text = format!(
                "{drifted} colours have moved by more than -drift {}",
                self.options.drift
            );
            io.report(Report::warning(code::DRIFT, text));
        }
        io.floats = numbers;
        io.ints = vec![i64::try_from(drifted).unwrap_or(i64::MAX)];
        Ok(())
    }

    /// Four numbers of each watched place, and how many have moved too far.
    fn drifted(&self, path: &str, picture: &Picture) -> Result<(Vec<f64>, usize), Report> {
        let (mut numbers, mut drifted) = (Vec::new(), 0);
        for row in self.watched.chunks_exact(6) {
            let [u, v, radius, expected @ ..] = row else {
                continue;
            };
            let Some(mean) = picture.mean_of_disc(*u, *v, *radius) else {
                let text = format!(
                    "the watched place {u}, {v} with radius {radius} is not inside `{path}`"
                );
                return Err(Report::error(code::COLOURS, text));
            };
            let squares = mean
                .iter()
                .zip(expected)
                .map(|(found, known)| (found - known).powi(2));
            let moved = squares.sum::<f64>().sqrt();
            drifted += usize::from(moved > self.options.drift);
            numbers.extend(mean);
            numbers.push(moved);
        }
        Ok((numbers, drifted))
    }
}
