//! The class `blobs`: the connected components of a picture, with exact moments, their holes, and whether they are what they
//! should be.

use std::sync::LazyLock;

use sorma::{Context, Form, OptionTable, Outcome, Report, ServiceObject, Transport};

use super::{code, ended, picture};
use crate::{
    components::{Component, Connectivity, Expectation, Region, connected_within, regions},
    frame::Frame,
};

/// Deeper regions are not moved further to the right in a text.
const DEEPEST_SHOWN: usize = 20;

/// Parts of components that a picture may have, so that they fit into 256 MiB; a tree has those of its holes, too.
const PARTS_MOST: usize = 1 << 20;
const PARTS_OF_TREE_MOST: usize = 1 << 18;

/// So many components are answered if nothing else is said: with 12 numbers each they fit into a line of text.
const MOST: i64 = 20_000;

/// So many components that are not as expected are told one by one.
const MOST_TOLD: usize = 20;

const FORMS: &[Form] = &[
    Form {
        text: "tree FILE",
        floats: 0,
        takes: "",
        gives: "12 floats of each component and then 12 of each hole, as without `tree`; the Euler number of a hole is 1 less the \
                components in it; ints: number of components k, number of holes h, for each component the hole it lies in (from 0) \
                or -1, for each hole its component (from 0); the tree as text: a line for each, moved to the right by what it lies in",
        results: "",
        help: "finds components, their holes, what lies in these, and so on",
    },
    Form {
        text: "expect FILE",
        floats: 0,
        takes: "",
        gives: "12 floats of each component, as without `expect`; ints: number of components k, and for each component flags: 1 \
                touches the border, 2 smaller and 4 larger than -area, 8 longer than -eccentricity, 16 no full ellipse, 32 another \
                number of holes than -holes; report 153 tells those with flags",
        results: "",
        help: "whether components are what they should be: round, as large, and not clipped",
    },
    Form {
        text: "FILE",
        floats: 0,
        takes: "",
        gives: "12 floats of each component, in the order of their first pixels, row by row: area (px), centroid u, v (px, pixel \
                centres at whole numbers), second central moments mu20, mu11, mu02 (means, px^2), umin, vmin, umax, vmax \
                (inclusive, px), eccentricity sqrt(1 - l2/l1) of the moments' eigenvalues, Euler number (1 less the holes); 1 \
                int: their number",
        results: "* area u v mu20 mu11 mu02 umin vmin umax vmax eccentricity euler; ints components",
        help: "finds the connected components of a picture (PNG, JPEG, PNM, BMP)",
    },
];

#[derive(Debug, Clone)]
pub(super) struct Options {
    threshold: i64,
    dark: bool,
    connectivity: String,
    min: i64,
    most: i64,
    area: Vec<i64>,
    eccentricity: f64,
    holes: String,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            threshold: 127,
            dark: false,
            connectivity: "8".to_owned(),
            min: 1,
            most: MOST,
            area: vec![1, 1_000_000_000],
            eccentricity: 0.6,
            holes: "0".to_owned(),
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
        .ints(
            "area",
            &["LEAST", "MOST"],
            1..=1_000_000_000,
            "px",
            "how large a component should be, for EXEC expect",
            |options| &mut options.area,
        )
        .float(
            "eccentricity",
            0.0..=1.0,
            "",
            "largest eccentricity that is expected; 0.6 is an ellipse with axes as 4 to 5",
            |options| &mut options.eccentricity,
        )
        .int_or(
            "holes",
            "any",
            0..=1_000_000,
            "",
            "how many holes are expected",
            |options| &mut options.holes,
        )
});

/// An object of class `blobs`.
#[derive(Default)]
pub(super) struct Blobs(Options);

impl ServiceObject for Blobs {
    fn exec(&mut self, _cx: &Context<'_>, io: &mut Transport) -> Outcome {
        let outcome = TABLE.form(io).and_then(|form| match form.text {
            "tree FILE" => self.tree(io),
            "expect FILE" => self.expect(io),
            _ => self.find(io),
        });
        // A tree is a text.
        if outcome.is_ok() {
            return outcome;
        }
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

/// A picture whose foreground is `least` and brighter; nothing is when it is none.
struct Seen {
    path: String,
    frame: Frame,
    least: Option<u8>,
    connectivity: Connectivity,
}

impl Blobs {
    /// The picture that the rest of the text after `word` names.
    fn seen(&self, word: &str, io: &mut Transport) -> Result<Seen, Report> {
        let text = io.text.trim();
        let path = text.strip_prefix(word).unwrap_or(text).trim().to_owned();
        let mut frame = picture::read(&path, io)?;
        // Dark foreground is bright in the negative: grey < T there is 255 - grey > 255 - T.
        let mut above = u8::try_from(self.0.threshold).unwrap_or(u8::MAX);
        if self.0.dark {
            let negative: Vec<u8> = frame.pixels.iter().map(|grey| 255 - grey).collect();
            frame.pixels = negative.into();
            above = 255 - above;
        }
        Ok(Seen {
            path,
            frame,
            least: above.checked_add(1),
            connectivity: match self.0.connectivity.as_str() {
                "4" => Connectivity::Four,
                _ => Connectivity::Eight,
            },
        })
    }

    /// The components that are large enough.
    fn components(&self, seen: &Seen) -> Result<Vec<Component>, Report> {
        let (pixels, width) = (&seen.frame.pixels, seen.frame.width);
        let mut found = match seen.least {
            Some(least) => connected_within(pixels, width, least, seen.connectivity, PARTS_MOST)
                .ok_or_else(|| noisy(&seen.path))?,
            None => Vec::new(),
        };
        found.retain(|component| component.area >= self.0.min.unsigned_abs());
        self.few_enough(seen, found.len())?;
        Ok(found)
    }

    fn few_enough(&self, seen: &Seen, count: usize) -> Outcome {
        let (path, most) = (&seen.path, self.0.most);
        if i64::try_from(count).unwrap_or(i64::MAX) > most {
            let text = format!(
                "`{path}` has {count} components, more than -most {most}: raise -min (fewest pixels, now {}) or change -threshold; noise has many",
                self.0.min
            );
            return Err(Report::error(code::NO_SPOT, text));
        }
        Ok(())
    }

    fn find(&self, io: &mut Transport) -> Outcome {
        let seen = self.seen("", io)?;
        let found = self.components(&seen)?;
        io.text.clear();
        io.floats = found.iter().flat_map(numbers).collect();
        io.ints = vec![whole(found.len())];
        Ok(())
    }

    fn expect(&self, io: &mut Transport) -> Outcome {
        let (least, most) = match self.0.area.as_slice() {
            [least, most] => (least.unsigned_abs(), most.unsigned_abs()),
            _ => (1, u64::MAX),
        };
        let expected = Expectation {
            area: (least, most),
            eccentricity: self.0.eccentricity,
            holes: self.0.holes.parse().ok(),
        };
        let seen = self.seen("expect", io)?;
        let found = self.components(&seen)?;
        let (width, height) = (seen.frame.width, seen.frame.height);
        io.text.clear();
        io.floats = found.iter().flat_map(numbers).collect();
        io.ints = vec![whole(found.len())];
        let mut told = Vec::new();
        for (index, component) in found.iter().enumerate() {
            let doubts = expected.doubts(component, width, height);
            io.ints.push(doubts.iter().map(|doubt| doubt.flag()).sum());
            if !doubts.is_empty() {
                let why: Vec<String> = doubts.iter().map(ToString::to_string).collect();
                let (u, v) = component.centroid();
                let why = why.join(", ");
                told.push(format!("component {index} at {u:.1}, {v:.1} {why}"));
            }
        }
        if !told.is_empty() {
            let (others, all) = (told.len(), found.len());
            told.truncate(MOST_TOLD);
            let path = &seen.path;
            let text = format!(
                "`{path}`: {others} of {all} components are not as expected: {}{}",
                told.join("; "),
                if others > MOST_TOLD {
                    "; and others"
                } else {
                    ""
                }
            );
            io.report(Report::warning(code::UNEXPECTED, text));
        }
        Ok(())
    }

    fn tree(&self, io: &mut Transport) -> Outcome {
        let seen = self.seen("tree", io)?;
        let (pixels, width) = (&seen.frame.pixels, seen.frame.width);
        let all = match seen.least {
            Some(least) => regions(pixels, width, least, seen.connectivity, PARTS_OF_TREE_MOST)
                .ok_or_else(|| noisy(&seen.path))?,
            None => Vec::new(),
        };
        let kept = kept(&all, self.0.min.unsigned_abs());
        self.few_enough(&seen, kept.len())?;
        let (holes, components): (Vec<_>, Vec<_>) = kept.iter().partition(|one| one.region.hole);
        io.floats.clear();
        io.ints = vec![whole(components.len()), whole(holes.len())];
        for one in components.into_iter().chain(holes) {
            io.floats.extend(numbers(&one.region.component));
            let around = one.parent.and_then(|parent| kept.get(parent));
            io.ints
                .push(around.map_or(-1, |around| whole(around.number)));
        }
        io.text = drawn(&kept);
        Ok(())
    }
}

fn noisy(path: &str) -> Report {
    let text = format!(
        "`{path}` has more parts of components than fit into memory, as noise has: change -threshold, or take a smaller picture"
    );
    Report::error(code::NO_SPOT, text)
}

/// A region of a tree from which small components were taken.
struct Kept<'a> {
    region: &'a Region,
    /// Among the components, or among the holes.
    number: usize,
    /// Among those that are kept.
    parent: Option<usize>,
}

/// The components of `least` pixels or more and their holes. What lay in a smaller one is in the hole around that.
fn kept(all: &[Region], least: u64) -> Vec<Kept<'_>> {
    let mut places: Vec<Option<usize>> = Vec::with_capacity(all.len());
    let mut kept: Vec<Kept<'_>> = Vec::new();
    let mut numbers = [0_usize; 2];
    for region in all {
        // Parents come first. Two steps up from a hole is the next hole.
        let mut around = region.parent;
        while let Some(hole) = around.filter(|one| !region.hole && places[*one].is_none()) {
            around = all[hole].parent.and_then(|component| all[component].parent);
        }
        let parent = around.and_then(|around| places[around]);
        let small = !region.hole && region.component.area < least;
        if small || (region.hole && parent.is_none()) {
            places.push(None);
            continue;
        }
        let number = &mut numbers[usize::from(region.hole)];
        places.push(Some(kept.len()));
        kept.push(Kept {
            region,
            number: *number,
            parent,
        });
        *number += 1;
    }
    kept
}

/// The tree as text: a line for each region below the one around it.
fn drawn(kept: &[Kept<'_>]) -> String {
    let mut within: Vec<Vec<usize>> = kept.iter().map(|_| Vec::new()).collect();
    let mut open: Vec<(usize, usize)> = Vec::new();
    for (index, one) in kept.iter().enumerate().rev() {
        match one.parent.and_then(|parent| within.get_mut(parent)) {
            Some(others) => others.push(index),
            None => open.push((index, 0)),
        }
    }
    let mut lines = Vec::with_capacity(kept.len());
    while let Some((index, depth)) = open.pop() {
        let Some(Kept { region, number, .. }) = kept.get(index) else {
            continue;
        };
        let what = if region.hole { "hole" } else { "component" };
        let (area, (u, v)) = (region.component.area, region.component.centroid());
        let shift = "  ".repeat(depth.min(DEEPEST_SHOWN));
        lines.push(format!(
            "{shift}{what} {number}: {area} px at {u:.2}, {v:.2}"
        ));
        let inner = within.get(index).into_iter().flatten();
        open.extend(inner.map(|inner| (*inner, depth + 1)));
    }
    lines.join("\n")
}

fn numbers(one: &Component) -> [f64; 12] {
    let ((u, v), moments) = (one.centroid(), one.moments());
    let side = |side: usize| side as f64;
    [
        one.area as f64,
        u,
        v,
        moments.uu,
        moments.uv,
        moments.vv,
        side(one.u_min),
        side(one.v_min),
        side(one.u_max),
        side(one.v_max),
        moments.eccentricity(),
        one.euler as f64,
    ]
}

fn whole(number: usize) -> i64 {
    i64::try_from(number).unwrap_or(i64::MAX)
}
