//! The class `spot`: the spots of a picture, from a file or, in an app, from one of its cameras.

use std::sync::LazyLock;

use futures_util::future::LocalBoxFuture;
use sorma::{Context, Form, OptionTable, Outcome, Report, ServiceObject, Transport, Waiting};

use super::{code, ended, picture};
use crate::{
    frame::Frame,
    spot::{NoSpot, SpotsOptions, find_spots},
};

const FORMS: &[Form] = &[
    Form {
        text: "camera NAME",
        floats: 0,
        takes: "",
        gives: "as FILE; two ints more: the picture's number, and the middle of its exposure, ns of the app's time",
        results: "",
        help: "has a camera of the app take a picture and finds its spots",
    },
    Form {
        text: "FILE",
        floats: 0,
        takes: "",
        gives: "3 n floats: u, v (px, pixel centres at whole numbers) and area (px) of each spot, \
                in the order of their first pixels, row by row; 1 int: n. With -fit on 6 n floats: u, v (px), sigma of the \
                Gaussian (px), its amplitude (grey values), standard deviations of u and v (px); 1 + n ints: n, and the sum of \
                the flags of each spot: 1 cut by the border, 2 saturated pixels (left out), 4 elongated, 8 a second spot near, \
                16 an edge of something behind it, 32 no Gaussian (then centre and sd are those of a centroid)",
        results: "",
        help: "finds the spots of a picture (PNG, JPEG, PNM, BMP)",
    },
];

#[derive(Debug, Clone)]
pub(super) struct Options {
    threshold: String,
    polarity: String,
    min_area: i64,
    max_area: i64,
    max_ratio: f64,
    border: bool,
    most: i64,
    fit: bool,
    tool: String,
}

impl Default for Options {
    fn default() -> Self {
        let spots = SpotsOptions::default();
        Self {
            threshold: AUTO.to_owned(),
            polarity: "bright".to_owned(),
            min_area: i64::try_from(spots.min_area).unwrap_or(i64::MAX),
            max_area: i64::try_from(spots.max_area).unwrap_or(i64::MAX),
            max_ratio: spots.max_ratio,
            border: spots.border,
            most: 10_000,
            fit: false,
            tool: "toolSnap".to_owned(),
        }
    }
}

/// The word that stands for a threshold found from the picture.
const AUTO: &str = "auto";

/// Flag of a spot that is no Gaussian.
const NO_GAUSSIAN: i64 = 32;

impl Options {
    fn spots(&self) -> SpotsOptions {
        SpotsOptions {
            threshold: self.threshold.parse().ok(),
            dark: self.polarity == "dark",
            min_area: self.min_area.unsigned_abs(),
            max_area: self.max_area.unsigned_abs(),
            max_ratio: self.max_ratio,
            border: self.border,
            most: usize::try_from(self.most).unwrap_or(usize::MAX),
        }
    }
}

pub(super) static TABLE: LazyLock<OptionTable<Options>> = LazyLock::new(|| {
    OptionTable::new("finds spots in pictures")
        .exec(FORMS)
        .int_or(
            "threshold",
            AUTO,
            0..=255,
            "grey values",
            "pixels at or above it (dark: at or below it) belong to spots; auto: what stands out of the \
             noise, each spot down to half of its own height",
            |options: &mut Options| &mut options.threshold,
        )
        .choice(
            "polarity",
            &["bright", "dark"],
            "whether spots are brighter or darker than what is around them",
            |options| &mut options.polarity,
        )
        .int(
            "min-area",
            1..=1_000_000_000,
            "px",
            "fewest pixels of a spot",
            |options| &mut options.min_area,
        )
        .int(
            "max-area",
            1..=1_000_000_000,
            "px",
            "most pixels of a spot",
            |options| &mut options.max_area,
        )
        .float(
            "max-ratio",
            1.0..=1e6,
            "",
            "largest ratio of a spot's axes",
            |options| &mut options.max_ratio,
        )
        .flag(
            "border",
            "spots that the picture's border cuts count",
            |options| &mut options.border,
        )
        .int(
            "most",
            1..=1_000_000,
            "",
            "most spots that are answered; more are an error, for then the options are wrong",
            |options| &mut options.most,
        )
        .flag(
            "fit",
            "width, height, standard deviations and flags of each spot are answered, too",
            |options| &mut options.fit,
        )
        .word(
            "tool",
            "TASK",
            "the app's task that takes pictures",
            |options| &mut options.tool,
        )
});

/// An object of class `spot`.
#[derive(Default)]
pub(super) struct Spot(Options);

impl ServiceObject for Spot {
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

impl Spot {
    async fn job(&self, cx: &Waiting<'_>, io: &mut Transport) -> Outcome {
        TABLE.form(io)?;
        let text = io.text.trim().to_owned();
        match text.split_once(char::is_whitespace) {
            Some((picture::CAMERA, name)) => {
                let name = name.trim();
                let frame = picture::taken(cx, name, &self.0.tool).await?;
                self.find(&format!("the picture of camera `{name}`"), &frame, io)?;
                let stamp_ns = i64::try_from(frame.stamp.as_nanos()).unwrap_or(i64::MAX);
                let number = i64::try_from(frame.number).unwrap_or(i64::MAX);
                io.ints.extend([number, stamp_ns]);
                Ok(())
            }
            _ => self.find(&format!("`{text}`"), &picture::read(&text, io)?, io),
        }
    }

    /// Answers with the spots of a picture that is called `what`.
    fn find(&self, what: &str, frame: &Frame, io: &mut Transport) -> Outcome {
        let found = find_spots(frame, &self.0.spots()).map_err(|why| match why {
            NoSpot::TooMany(count, most) => {
                let text = format!(
                    "{what} has {count} spots, more than -most {most}; raise -min-area or -threshold"
                );
                Report::error(code::NO_SPOT, text)
            }
            why => Report::error(code::FILE, format!("{what}: {why}")),
        })?;
        let count = found.spots.len();
        if let Some(why) = &found.nothing {
            let text = format!("{what} has no spot: {why}");
            io.report(Report::warning(code::NO_SPOT, text));
        } else if count == 0 {
            let text = format!(
                "{what} has no spot: {} things reach the threshold, and none has the area, the ratio and the place asked for",
                found.refused
            );
            io.report(Report::warning(code::NO_SPOT, text));
        }
        io.floats.clear();
        io.ints.clear();
        io.ints.push(i64::try_from(count).unwrap_or(i64::MAX));
        for spot in &found.spots {
            io.floats.extend([spot.u, spot.v]);
            if self.0.fit {
                let sd = [spot.sd_u, spot.sd_v];
                io.floats.extend([spot.sigma, spot.amplitude]);
                io.floats.extend(sd);
                io.ints
                    .push(spot.flags.sum() + if spot.gaussian { 0 } else { NO_GAUSSIAN });
            } else {
                io.floats.push(spot.area as f64);
            }
        }
        Ok(())
    }
}
