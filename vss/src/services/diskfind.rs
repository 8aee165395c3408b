//! The class `diskFind`: the correction of a gripper from the disc that the camera on the hand sees, by the visual Jacobian.

use std::sync::LazyLock;

use sorma::{Context, Form, OptionTable, Outcome, Report, ServiceObject, Transport};

use super::{
    code, ended, opened, picture,
    table::{self, Columns},
    told,
};
use crate::{
    tool::disk_about,
    visual_jacobian::{EXAMPLES, Example, Seen, VisualJacobian},
};

const COLUMNS: Columns = Columns {
    names: &["x", "y", "u", "v", "radius"],
    count: None,
    may_be_empty: &[],
    help: "the first line is `x,y,u,v,radius`: four rows, the offsets of the gripper from where it grips the disc (m) at the corners of a square, and the disc that is seen from each (px)",
};

/// What is answered about a disc.
const CORRECTION: &str = "5 floats: the move that takes the gripper to where it grips the disc, along the axes of the examples, and \
                          its standard deviations (m), and the error E of the map";

const FORMS: &[Form] = &[
    Form {
        text: "seen",
        floats: 3,
        takes: "the disc: u v of its middle and its radius, px",
        gives: CORRECTION,
        results: "x y: m; sd_x sd_y: m; E",
        help: "the correction for a disc that is seen so",
    },
    Form {
        text: "expected",
        floats: 2,
        takes: "an offset x y of the gripper, m",
        gives: "3 floats: the disc as it is to be seen from there, px",
        results: "u v radius: px",
        help: "where the disc is to be seen from an offset",
    },
    Form {
        text: "FILE",
        floats: 0,
        takes: "",
        gives: "10 floats: the 5 of `seen`; then the disc that was found: u v of its middle, its radius, and the standard \
                deviations of the middle, px",
        results: "x y: m; sd_x sd_y: m; E; u v radius: px; sd_u sd_v: px",
        help: "finds the disc in a picture of about -radius about -at, and answers the correction",
    },
];

#[derive(Debug, Clone)]
pub(super) struct Options {
    train: String,
    radius: f64,
    at: Vec<f64>,
    sd_px: f64,
    sd_radius_px: f64,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            train: String::new(),
            radius: 0.0,
            at: Vec::new(),
            sd_px: 0.3,
            sd_radius_px: 0.3,
        }
    }
}

pub(super) static TABLE: LazyLock<OptionTable<Options>> = LazyLock::new(|| {
    OptionTable::new("corrects a gripper by the disc that a camera on it sees")
        .exec(FORMS)
        .word(
            "train",
            "FILE",
            "the examples: a table x,y,u,v,radius (m and px) with four rows",
            |options: &mut Options| &mut options.train,
        )
        .float(
            "radius",
            3.0..=1e5,
            "px",
            "about how large the disc is in a picture; must be set before a picture is given",
            |options| &mut options.radius,
        )
        .floats(
            "at",
            &["U", "V"],
            -1e6..=1e6,
            "px",
            "about where it is; the middle of the picture when nothing is said",
            |options| &mut options.at,
        )
        .float(
            "sd",
            1e-6..=1e3,
            "px",
            "standard deviation of a disc's middle in a picture; taken with -train",
            |options| &mut options.sd_px,
        )
        .float(
            "sd-radius",
            1e-6..=1e3,
            "px",
            "standard deviation of its radius; taken with -train",
            |options| &mut options.sd_radius_px,
        )
});

/// An object of class `diskFind`.
#[derive(Default)]
pub(super) struct DiskFind {
    options: Options,
    map: Option<VisualJacobian>,
}

impl ServiceObject for DiskFind {
    fn exec(&mut self, _cx: &Context<'_>, io: &mut Transport) -> Outcome {
        let outcome = TABLE.form(io).and_then(|form| match form.text {
            "seen" => self.seen(io),
            "expected" => self.expected(io),
            _ => self.find(io),
        });
        ended(io, outcome)
    }

    fn ctrl(&mut self, _cx: &Context<'_>, io: &mut Transport) -> Outcome {
        let mut options = self.options.clone();
        // The table of options reads CTRL's text, and leaves it empty or an answer.
        let trains = io.text.split_whitespace().any(|word| word == "-train");
        TABLE.ctrl(&mut options, io);
        if trains && !options.train.is_empty() {
            // What was there before stays when the table is no good.
            self.map = Some(train(&options).inspect_err(|_| io.text.clear())?);
        }
        self.options = options;
        Ok(())
    }

    fn dump(&self) -> String {
        TABLE.dump(&self.options)
    }
}

fn train(options: &Options) -> Result<VisualJacobian, Report> {
    let source = opened(&options.train)?;
    let table = table::read(&source, &COLUMNS).map_err(told)?;
    let wrong = |why: String| Report::error(code::NO_MAP, format!("{}: {why}", source.name()));
    let examples = table.rows().filter_map(|row| match *row {
        [x, y, u, v, radius] => Some(Example {
            offset: [x, y],
            seen: Seen { u, v, radius },
        }),
        _ => None,
    });
    let examples: Vec<Example> = examples.collect();
    let four: &[Example; EXAMPLES] = examples.as_slice().try_into().map_err(|_| {
        let rows = examples.len();
        wrong(format!("{rows} examples; the map has {EXAMPLES}"))
    })?;
    VisualJacobian::train(four, options.sd_px, options.sd_radius_px)
        .map_err(|why| wrong(why.to_string()))
}

impl DiskFind {
    fn map(&mut self) -> Result<&mut VisualJacobian, Report> {
        self.map.as_mut().ok_or_else(|| {
            let text = "there is no map yet: train one with CTRL -train FILE";
            Report::error(code::NO_MAP, text)
        })
    }

    fn correction(&mut self, seen: &Seen) -> Result<[f64; 5], Report> {
        let found = self.map()?.correction(seen);
        let found = found.filter(|found| found.good).ok_or_else(|| {
            let text = format!(
                "the disc at ({:.0}, {:.0}) with a radius of {:.1} px is not the one that was taught, or not from there",
                seen.u, seen.v, seen.radius
            );
            Report::error(code::NO_MAP, text)
        })?;
        let ([x, y], [sx, sy]) = (found.by, found.sd);
        Ok([x, y, sx, sy, found.error])
    }

    fn seen(&mut self, io: &mut Transport) -> Outcome {
        if let &[u, v, radius] = io.floats.as_slice() {
            io.floats = self.correction(&Seen { u, v, radius })?.to_vec();
        }
        Ok(())
    }

    fn expected(&mut self, io: &mut Transport) -> Outcome {
        let &[x, y] = io.floats.as_slice() else {
            return Ok(());
        };
        let seen = self.map()?.expected([x, y]);
        let Seen { u, v, radius } = seen.ok_or_else(|| {
            let text = format!("no disc is expected from ({x}, {y}) m: it is outside the square");
            Report::error(code::NO_MAP, text)
        })?;
        io.floats = vec![u, v, radius];
        Ok(())
    }

    fn find(&mut self, io: &mut Transport) -> Outcome {
        let path = io.text.trim().to_owned();
        let radius = self.options.radius;
        if radius == 0.0 {
            let text = "how large the disc is in the picture is not known: set -radius";
            return Err(Report::error(sorma::report::code::VALUE, text));
        }
        self.map()?;
        let picture = picture::opened(&path, io)?;
        let at = match *self.options.at.as_slice() {
            [u, v] => [u, v],
            _ => [0.5 * picture.width as f64, 0.5 * picture.height as f64],
        };
        let disc = disk_about(&picture, at, radius)
            .map_err(|why| Report::error(code::BOARD, format!("`{path}`: {why}")))?;
        let seen = Seen {
            u: disc.u,
            v: disc.v,
            radius: disc.radius,
        };
        io.floats = self.correction(&seen)?.to_vec();
        io.floats.extend([disc.u, disc.v, disc.radius]);
        io.floats.extend(disc.sd_px);
        Ok(())
    }
}
