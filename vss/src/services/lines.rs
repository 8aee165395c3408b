//! The class `lines`: lines of light and edges of a picture, from a file or, in an app, from one of its cameras.

use std::sync::LazyLock;

use futures_util::future::LocalBoxFuture;
use sorma::{Context, Form, OptionTable, Outcome, Report, ServiceObject, Transport, Waiting};

use super::{code, ended, picture};
use crate::{
    frame::Frame,
    lines::{Kind, LinesOptions, SIGMAS, find_lines},
};

/// The first word of a request for points instead of straight pieces.
const POINTS: &str = "points";

const FORMS: &[Form] = &[
    Form {
        text: "points FILE",
        floats: 0,
        takes: "",
        gives: "5 n floats: u, v (px), direction (rad from u towards v), standard deviation across the line (px) and contrast (grey \
                values) of each point, row by row; 1 int: n. `points camera NAME` takes a picture for that",
        results: "* u v direction sd contrast; ints n",
        help: "finds the points of lines or edges: one for each row that a line crosses steeply, or column",
    },
    Form {
        text: "camera NAME",
        floats: 0,
        takes: "",
        gives: "as FILE; two ints more: the picture's number, and the middle of its exposure, ns of the app's time",
        results: "",
        help: "has a camera of the app take a picture and finds its lines or edges",
    },
    Form {
        text: "FILE",
        floats: 0,
        takes: "",
        gives: "8 k floats, for each straight piece u, v of both ends (px), standard deviation of the middle across the piece (px) \
                and of its direction (rad), rms distance of its points from it (px), contrast (grey values). 1 + k ints: k, and how \
                many points each has. Pieces with most points come first. An edge runs with its bright side on the right",
        results: "* u1 v1 u2 v2 sd sd_direction rms contrast; ints k; ints * points",
        help: "finds the straight pieces of lines of light or of edges of a picture (PNG, JPEG, PNM, BMP)",
    },
];

#[derive(Debug, Clone)]
pub(super) struct Options {
    kind: String,
    sigma: f64,
    contrast: f64,
    straight: f64,
    length: f64,
    less: String,
    tool: String,
}

impl Default for Options {
    fn default() -> Self {
        let lines = LinesOptions::default();
        Self {
            kind: "bright".to_owned(),
            sigma: lines.sigma,
            contrast: lines.contrast,
            straight: lines.straight,
            length: lines.length,
            less: String::new(),
            tool: "toolSnap".to_owned(),
        }
    }
}

impl Options {
    fn lines(&self) -> LinesOptions {
        LinesOptions {
            kind: match self.kind.as_str() {
                "dark" => Kind::Dark,
                "edge" => Kind::Edge,
                _ => Kind::Bright,
            },
            sigma: self.sigma,
            contrast: self.contrast,
            straight: self.straight,
            length: self.length,
            ..LinesOptions::default()
        }
    }
}

pub(super) static TABLE: LazyLock<OptionTable<Options>> = LazyLock::new(|| {
    OptionTable::new("finds lines of light and edges in pictures")
        .exec(FORMS)
        .choice(
            "kind",
            &["bright", "dark", "edge"],
            "lines that are brighter or darker than what is beside them, or steps",
            |options: &mut Options| &mut options.kind,
        )
        .float(
            "sigma",
            SIGMAS,
            "px",
            "width of the Gaussian that smooths the picture; for a line that of its own profile is best",
            |options| &mut options.sigma,
        )
        .float(
            "contrast",
            0.0..=255.0,
            "grey values",
            "lowest height of a line as wide as -sigma, or of a step; what noise makes does not count either",
            |options| &mut options.contrast,
        )
        .float(
            "straight",
            0.1..=1e3,
            "px",
            "how far points may be beside a straight piece",
            |options| &mut options.straight,
        )
        .float(
            "length",
            2.0..=1e6,
            "px",
            "the shortest piece",
            |options| &mut options.length,
        )
        .word(
            "less",
            "FILE",
            "a picture of the same view without the light, which is taken off",
            |options| &mut options.less,
        )
        .word(
            "tool",
            "TASK",
            "the app's task that takes pictures",
            |options| &mut options.tool,
        )
});

/// An object of class `lines`.
#[derive(Default)]
pub(super) struct Lines(Options);

impl ServiceObject for Lines {
    fn exec_waiting<'a>(
        &'a mut self,
        cx: &'a Waiting<'a>,
        io: &'a mut Transport,
    ) -> Option<LocalBoxFuture<'a, Outcome>> {
        Some(Box::pin(async move {
            let outcome = self.job(cx, io).await;
            ended(io, outcome)
        }))
    }

    fn ctrl(&mut self, _cx: &Context<'_>, io: &mut Transport) -> Outcome {
        TABLE.ctrl(&mut self.0, io);
        Ok(())
    }

    fn dump(&self) -> String {
        TABLE.dump(&self.0)
    }
}

impl Lines {
    async fn job(&self, cx: &Waiting<'_>, io: &mut Transport) -> Outcome {
        TABLE.form(io)?;
        let text = io.text.trim().to_owned();
        let (points, text) = match text.split_once(char::is_whitespace) {
            Some((POINTS, rest)) => (true, rest.trim()),
            _ => (false, text.as_str()),
        };
        match text.split_once(char::is_whitespace) {
            Some((picture::CAMERA, name)) => {
                let name = name.trim();
                let frame = picture::taken(cx, name, &self.0.tool).await?;
                let what = format!("the picture of camera `{name}`");
                self.find(&what, &frame, points, io)?;
                let stamp_ns = i64::try_from(frame.stamp.as_nanos()).unwrap_or(i64::MAX);
                let number = i64::try_from(frame.number).unwrap_or(i64::MAX);
                io.ints.extend([number, stamp_ns]);
                Ok(())
            }
            _ => {
                let frame = picture::read(text, io)?;
                self.find(&format!("`{text}`"), &frame, points, io)
            }
        }
    }

    /// Answers with the lines of a picture that is called `what`.
    fn find(&self, what: &str, frame: &Frame, points: bool, io: &mut Transport) -> Outcome {
        let dark = match self.0.less.as_str() {
            "" => None,
            path => Some(picture::read(path, io)?),
        };
        let found = find_lines(frame, dark.as_ref(), &self.0.lines());
        let found = found.map_err(|why| Report::error(code::NO_LINE, format!("{what}: {why}")))?;
        if found.pieces.is_empty() {
            let count = found.points.len();
            let text = format!(
                "{what} has no straight piece of {} px or more; {count} points are parts of lines",
                self.0.length
            );
            io.report(Report::warning(code::NO_LINE, text));
        }
        let count = |count: usize| i64::try_from(count).unwrap_or(i64::MAX);
        io.floats.clear();
        io.ints.clear();
        if points {
            io.ints.push(count(found.points.len()));
            for point in &found.points {
                let about = [point.direction, point.sd, point.contrast];
                io.floats.extend([point.u, point.v]);
                io.floats.extend(about);
            }
            return Ok(());
        }
        io.ints.push(count(found.pieces.len()));
        for piece in &found.pieces {
            io.floats.extend(piece.from);
            io.floats.extend(piece.to);
            let about = [piece.sd, piece.sd_direction, piece.rms, piece.contrast];
            io.floats.extend(about);
            io.ints.push(count(piece.points));
        }
        Ok(())
    }
}
