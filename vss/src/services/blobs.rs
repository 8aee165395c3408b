//! The class `blobs`: the connected components of a picture, with exact moments.

use std::sync::LazyLock;

use sorma::{Context, Form, OptionTable, Outcome, Report, ServiceObject, Transport};

use super::{code, ended, picture};
use crate::components::{Connectivity, connected};

const FORMS: &[Form] = &[Form {
    text: "FILE",
    floats: 0,
    takes: "",
    gives: "12 floats of each component, in the order of their first pixels, row by row: area (px), centroid u, v (px, pixel \
            centres at whole numbers), second central moments mu20, mu11, mu02 (means, px^2), umin, vmin, umax, vmax \
            (inclusive, px), eccentricity sqrt(1 - l2/l1) of the moments' eigenvalues, Euler number (1 less the holes); 1 int: \
            their number",
    results: "* area u v mu20 mu11 mu02 umin vmin umax vmax eccentricity euler; ints components",
    help: "finds the connected components of a picture (PNG, JPEG, PNM, BMP)",
}];

#[derive(Debug, Clone)]
pub(super) struct Options {
    threshold: i64,
    dark: bool,
    connectivity: String,
    min: i64,
    most: i64,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            threshold: 127,
            dark: false,
            connectivity: "8".to_owned(),
            min: 1,
            most: 100_000,
        }
    }
}

pub(super) static TABLE: LazyLock<OptionTable<Options>> = LazyLock::new(|| {
    OptionTable::new("finds connected components of pictures")
        .exec(FORMS)
        .int(
            "threshold",
            0..=255,
            "grey values",
            "pixels above it are foreground; with -dark on, those below it",
            |options: &mut Options| &mut options.threshold,
        )
        .flag(
            "dark",
            "foreground is darker than the threshold",
            |options| &mut options.dark,
        )
        .choice(
            "connectivity",
            &["4", "8"],
            "whether pixels that share only a corner are connected (8)",
            |options| &mut options.connectivity,
        )
        .int(
            "min",
            1..=1_000_000_000,
            "px",
            "fewest pixels of a component",
            |options| &mut options.min,
        )
        .int(
            "most",
            1..=10_000_000,
            "",
            "most components that are answered; more are an error, for then the options are wrong",
            |options| &mut options.most,
        )
});

/// An object of class `blobs`.
#[derive(Default)]
pub(super) struct Blobs(Options);

impl ServiceObject for Blobs {
    fn exec(&mut self, _cx: &Context<'_>, io: &mut Transport) -> Outcome {
        let outcome = TABLE.form(io).and_then(|_| self.find(io));
        ended(io, outcome)
    }

    fn ctrl(&mut self, _cx: &Context<'_>, io: &mut Transport) -> Outcome {
        TABLE.ctrl(&mut self.0, io);
        Ok(())
    }

    fn dump(&self) -> String {
        TABLE.dump(&self.0)
    }
}

impl Blobs {
    fn find(&self, io: &mut Transport) -> Outcome {
        let path = io.text.trim().to_owned();
        let mut frame = picture::read(&path, io)?;
        // Dark foreground is bright in the negative: grey < T there is 255 - grey > 255 - T.
        let mut above = u8::try_from(self.0.threshold).unwrap_or(u8::MAX);
        if self.0.dark {
            let negative: Vec<u8> = frame.pixels.iter().map(|grey| 255 - grey).collect();
            frame.pixels = negative.into();
            above = 255 - above;
        }
        let connectivity = match self.0.connectivity.as_str() {
            "4" => Connectivity::Four,
            _ => Connectivity::Eight,
        };
        // Nothing is above the largest grey value.
        let mut found = match above.checked_add(1) {
            Some(least) => connected(&frame.pixels, frame.width, least, connectivity),
            None => Vec::new(),
        };
        found.retain(|component| component.area >= self.0.min.unsigned_abs());
        let (count, most) = (found.len(), self.0.most);
        if i64::try_from(count).unwrap_or(i64::MAX) > most {
            let text = format!(
                "`{path}` has {count} components, more than -most {most}; raise -min or change -threshold"
            );
            return Err(Report::error(code::NO_SPOT, text));
        }
        io.floats.clear();
        for one in &found {
            let ((u, v), moments) = (one.centroid(), one.moments());
            let numbers = [one.area as f64, u, v, moments.uu, moments.uv, moments.vv];
            io.floats.extend(numbers);
            let sides = [one.u_min, one.v_min, one.u_max, one.v_max];
            io.floats.extend(sides.map(|side| side as f64));
            io.floats.extend([moments.eccentricity(), one.euler as f64]);
        }
        io.ints.clear();
        io.ints.push(i64::try_from(count).unwrap_or(i64::MAX));
        Ok(())
    }
}
