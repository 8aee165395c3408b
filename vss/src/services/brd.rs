//! The classes `findBrdMarker` and `getDisk` (SORMA technical report, section 2.1.3): where a board lies by four markers, and
//! where one disc is. `board` reads what stands on a board.

use std::sync::LazyLock;

use futures_util::future::LocalBoxFuture;
use nalgebra::{Point3, Vector2};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use sorma::{Context, Form, OptionTable, Outcome, Report, ServiceObject, Transport, Waiting};
use vss_image::{
    Picture,
    board::{Board, BoardError, Disc, Side, disc_near},
    colour::{Classes, Training},
};

use super::{code, colour, ended, picture, pose};
use crate::{
    components::Expectation,
    marker::{Marker, Markers, markers},
    perspective::{Match, ModelPose, model_pose},
};

/// More markers than these are not tried: the choices of four grow with their fourth power.
const MOST_MARKERS: usize = 12;

/// So many components that are no markers are told.
const MOST_TOLD: usize = 6;

const MARKER_FORMS: &[Form] = &[Form {
    text: "FILE",
    floats: 0,
    takes: "",
    gives: "30 floats: the homography from files and ranks (squares from the corner of a1) to u, v (px), 9 numbers row by row with \
            the last one 1; u, v of the board's corners at a1, h1, h8, a8 (px); rms distance of the inner corners from it (px); u, \
            v and their mean standard deviation (px) of the markers near a1, h1, h8, a8; with a lens 12 more: rotation vector \
            (rad) and translation (m) of camera_T_board and 6 standard deviations of these. The board's frame has its origin in \
            the corner of a1, x along rank 1, y along file a, z up, and its lens is undone in that only; 1 int: how many of 49 \
            inner corners were seen",
    results: "",
    help: "finds a board by four round markers in a picture (PNG, JPEG, PNM, BMP), which the chequer pattern between them confirms. \
           FILE may be `camera NAME`, which has a camera of the app take it, and answers two ints more: the picture's number, and the \
           middle of its exposure, ns of the app's time",
}];

const DISK_FORMS: &[Form] = &[
    Form {
        text: "near FILE",
        floats: 3,
        takes: "u, v and radius about which a disc is expected, px",
        gives: "5 floats: u, v, mean radius (px), standard deviations of u and v (px); 1 int: 1 lighter than what is around it, 2 \
                darker",
        results: "u v radius sd_u sd_v: px; ints piece",
        help: "the disc near a place of a picture in which no board need be seen, from above",
    },
    Form {
        text: "FILE",
        floats: 2,
        takes: "file and rank, squares from the corner of a1, as 2.5 0.5 for the middle of c1",
        gives: "9 floats: u, v, mean radius (px), file and rank of the disc's middle (squares), standard deviations of u, v (px), of \
                file and rank (squares); 1 int: 1 white, 2 black",
        results: "u v radius: px; file rank; sd_u sd_v: px; sd_file sd_rank; ints piece",
        help: "the disc near a place of the board in a picture (PNG, JPEG, PNM, BMP)",
    },
];

/// What both classes are asked with, and `findBrdMarker` alone.
#[derive(Debug, Clone)]
pub(super) struct Options {
    white: String,
    threshold: i64,
    dark: bool,
    area: Vec<i64>,
    eccentricity: f64,
    train: String,
    class: String,
    at: Vec<f64>,
    square: f64,
    lens: Vec<f64>,
    camera: String,
    tool: String,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            white: "bottom".to_owned(),
            threshold: 127,
            dark: false,
            area: vec![20, 1_000_000],
            eccentricity: 0.85,
            train: String::new(),
            class: "marker".to_owned(),
            at: vec![0.0, 0.0, 8.0, 0.0, 8.0, 8.0, 0.0, 8.0],
            square: 0.05,
            lens: Vec::new(),
            camera: String::new(),
            tool: "toolSnap".to_owned(),
        }
    }
}

fn with_white(table: OptionTable<Options>) -> OptionTable<Options> {
    table.choice(
        "white",
        &["bottom", "top", "left", "right"],
        "the side of the picture on which White sits: the pattern alone allows two",
        |options: &mut Options| &mut options.white,
    )
}

pub(super) static MARKER: LazyLock<OptionTable<Options>> = LazyLock::new(|| {
    with_white(OptionTable::new("finds boards by four markers").exec(MARKER_FORMS))
        .int(
            "threshold",
            0..=255,
            "grey values",
            "markers are lighter; with -dark on they are darker; without meaning after -train",
            |options| &mut options.threshold,
        )
        .flag("dark", "markers are darker than the threshold", |options| {
            &mut options.dark
        })
        .ints(
            "area",
            &["LEAST", "MOST"],
            1..=1_000_000_000,
            "px",
            "how large a marker is",
            |options| &mut options.area,
        )
        .float(
            "eccentricity",
            0.0..=1.0,
            "",
            "largest eccentricity of a marker's image: 0.85 is seen at 58 degrees from above",
            |options| &mut options.eccentricity,
        )
        .word(
            "train",
            "FILE",
            "labelled pixels (CSV class,r,g,b, as `colour` takes them); pixels of -class are markers",
            |options| &mut options.train,
        )
        .word("class", "NAME", "the markers' colour class", |options| {
            &mut options.class
        })
        .floats(
            "at",
            &["F1", "R1", "F2", "R2", "F3", "R3", "F4", "R4"],
            -100.0..=100.0,
            "squares",
            "file and rank of the markers' middles from the corner of a1, in the order near a1, h1, h8, a8",
            |options| &mut options.at,
        )
        .float(
            "square",
            1e-4..=10.0,
            "m",
            "side of a square, for the pose",
            |options| &mut options.square,
        )
        .floats(
            "lens",
            pose::LENS,
            -1e6..=1e6,
            "",
            "the camera's lens, as `resect` answers it: then the board's pose is answered, too",
            |options| &mut options.lens,
        )
        .word(
            "camera",
            "FILE",
            "the camera's lens as a camera_info file, instead of -lens",
            |options| &mut options.camera,
        )
        .word(
            "tool",
            "TASK",
            "the app's task that takes pictures",
            |options| &mut options.tool,
        )
});

pub(super) static DISK: LazyLock<OptionTable<Options>> =
    LazyLock::new(|| with_white(OptionTable::new("finds one disc").exec(DISK_FORMS)));

impl Options {
    fn white(&self) -> Side {
        match self.white.as_str() {
            "top" => Side::Top,
            "left" => Side::Left,
            "right" => Side::Right,
            _ => Side::Bottom,
        }
    }
}

/// An object of class `findBrdMarker`.
#[derive(Default)]
pub(super) struct FindBrdMarker {
    options: Options,
    classes: Option<Classes>,
}

impl ServiceObject for FindBrdMarker {
    fn exec_waiting<'a>(
        &'a mut self,
        cx: &'a Waiting<'a>,
        io: &'a mut Transport,
    ) -> Option<LocalBoxFuture<'a, Outcome>> {
        Some(Box::pin(async move {
            let outcome = self.find(cx, io).await;
            ended(io, outcome)
        }))
    }

    fn ctrl(&mut self, _cx: &Context<'_>, io: &mut Transport) -> Outcome {
        let mut options = self.options.clone();
        let trains = io.text.split_whitespace().any(|word| word == "-train");
        MARKER.ctrl(&mut options, io);
        if trains && !options.train.is_empty() {
            // What was there before stays when the table is no good.
            let classes = colour::train(&options.train, &Training::default(), io);
            self.classes = Some(classes.inspect_err(|_| io.text.clear())?);
        }
        self.options = options;
        Ok(())
    }

    fn dump(&self) -> String {
        MARKER.dump(&self.options)
    }
}

impl FindBrdMarker {
    /// Pixels that may be of a marker: 1, the others 0.
    fn mask(&self, picture: &Picture, grey: &[u8]) -> Result<Vec<u8>, Report> {
        let Some(classes) = &self.classes else {
            let limit = self.options.threshold;
            let (dark, is) = (self.options.dark, |grey: u8| i64::from(grey));
            let marks = grey.iter().map(|grey| match dark {
                true => u8::from(is(*grey) < limit),
                false => u8::from(is(*grey) > limit),
            });
            return Ok(marks.collect());
        };
        let name = &self.options.class;
        let wanted = classes.names().iter().position(|known| known == name);
        let wanted = wanted.ok_or_else(|| {
            let known = classes.names().join(", ");
            let text = format!("no colour class is called `{name}` (-class); there are {known}");
            Report::error(code::COLOURS, text)
        })?;
        let pixels = (0..picture.height).flat_map(|v| (0..picture.width).map(move |u| (u, v)));
        let marks = pixels.map(|(u, v)| {
            let class = picture.rgb(u, v).and_then(|rgb| classes.of(rgb).class);
            u8::from(class == Some(wanted))
        });
        Ok(marks.collect())
    }

    async fn find(&self, waiting: &Waiting<'_>, io: &mut Transport) -> Outcome {
        MARKER.form(io)?;
        let path = io.text.trim().to_owned();
        let lens = pose::lens(&self.options.lens, &self.options.camera)?;
        let at = self.options.at.as_slice();
        let &[ax, ay, bx, by, cx, cy, dx, dy] = at else {
            let text = "-at has 8 numbers: file and rank of four markers";
            return Err(Report::error(sorma::report::code::VALUE, text));
        };
        let places = [[ax, ay], [bx, by], [cx, cy], [dx, dy]];
        let (picture, taken) = picture::of(waiting, &path, &self.options.tool, io).await?;
        let grey = picture.clone().into_grey();
        let mask = self.mask(&picture, &grey)?;
        let (least, most) = match self.options.area.as_slice() {
            [least, most] => (least.unsigned_abs(), most.unsigned_abs()),
            _ => (1, u64::MAX),
        };
        let expected = Expectation {
            area: (least, most),
            eccentricity: self.options.eccentricity,
            holes: Some(0),
        };
        let all = markers(&grey, &mask, picture.width, &expected);
        if !(4..=MOST_MARKERS).contains(&all.found.len()) {
            return Err(no_markers(&path, &all));
        }
        let seen: Vec<[f64; 2]> = all.found.iter().map(|one| one.place.into()).collect();
        let white = self.options.white();
        let board = Board::at_some_markers(&picture, &seen, &places, white);
        let board = board.and_then(|(board, four)| Ok((board.facing(white)?, four)));
        let (board, four) = board.map_err(|why| none(&path, &why))?;
        let four = four.map(|nth| &all.found[nth]);
        let four = ordered(&board, &places, four);
        io.floats = board.homography().to_vec();
        for [file, rank] in [[0.0, 0.0], [8.0, 0.0], [8.0, 8.0], [0.0, 8.0]] {
            io.floats.extend(board.pixel(file, rank));
        }
        io.floats.push(board.rms);
        for one in four {
            let sd = one.sd[0].hypot(one.sd[1]) * std::f64::consts::FRAC_1_SQRT_2;
            io.floats.extend([one.place.x, one.place.y, sd]);
        }
        if let Some((intrinsics, distortion)) = lens {
            let matches = matches(&board, &places, four, self.options.square);
            let mut rng = ChaCha8Rng::seed_from_u64(1);
            let found = model_pose(&matches, &intrinsics, &distortion, &mut rng)
                .map_err(|why| Report::error(code::NO_POSE, format!("`{path}`: {why}")))?;
            io.floats.extend(numbers(&found));
        }
        io.ints = vec![i64::try_from(board.corners).unwrap_or(i64::MAX)];
        io.ints.extend(taken.into_iter().flatten());
        Ok(())
    }
}

/// The markers in the order of their places.
fn ordered<'a>(board: &Board, places: &[[f64; 2]; 4], four: [&'a Marker; 4]) -> [&'a Marker; 4] {
    places.map(|[file, rank]| {
        let expected = Vector2::from(board.pixel(file, rank));
        let far = |one: &&Marker| (one.place - expected).norm();
        let nearest = four.iter().min_by(|a, b| far(a).total_cmp(&far(b)));
        nearest.copied().unwrap_or(four[0])
    })
}

/// Markers and inner corners as points of the board.
fn matches(board: &Board, places: &[[f64; 2]; 4], four: [&Marker; 4], square: f64) -> Vec<Match> {
    let one = |[file, rank]: [f64; 2], pixel: Vector2<f64>| Match {
        point: Point3::new(file * square, rank * square, 0.0),
        pixel,
    };
    let markers = places
        .iter()
        .zip(four)
        .map(|(place, marker)| one(*place, marker.place));
    let corners = board.inner_corners().into_iter();
    let corners = corners.map(|(place, pixel)| one(place, Vector2::from(pixel)));
    markers.chain(corners).collect()
}

fn numbers(found: &ModelPose) -> Vec<f64> {
    let pose = &found.camera_t_model;
    let (turn, shift) = (pose.rotation.scaled_axis(), pose.translation.vector);
    let pose = turn.iter().chain(shift.iter()).copied();
    pose.chain(found.sd()).collect()
}

fn no_markers(path: &str, all: &Markers) -> Report {
    let found = all.found.len();
    let others = all
        .others
        .iter()
        .take(MOST_TOLD)
        .map(|(component, doubts)| {
            let (u, v) = component.centroid();
            let why: Vec<String> = doubts.iter().map(ToString::to_string).collect();
            format!("what is at {u:.0}, {v:.0} {}", why.join(", "))
        });
    let others: Vec<String> = others.collect();
    let others = if others.is_empty() {
        String::new()
    } else {
        format!(" ({})", others.join("; "))
    };
    let text = format!(
        "`{path}`: {found} things look like markers; 4 to {MOST_MARKERS} are needed{others}; set -threshold, -dark and -area, or \
         -train and -class"
    );
    Report::error(code::MARKERS, text)
}

fn none(path: &str, why: &BoardError) -> Report {
    Report::error(code::BOARD, format!("`{path}`: {why}"))
}

/// An object of class `getDisk`.
#[derive(Default)]
pub(super) struct GetDisk(Options);

impl ServiceObject for GetDisk {
    fn exec(&mut self, _cx: &Context<'_>, io: &mut Transport) -> Outcome {
        let outcome = DISK.form(io).and_then(|form| match form.text {
            "near FILE" => near(io),
            _ => self.on_board(io),
        });
        ended(io, outcome)
    }

    fn ctrl(&mut self, _cx: &Context<'_>, io: &mut Transport) -> Outcome {
        DISK.ctrl(&mut self.0, io);
        Ok(())
    }

    fn dump(&self) -> String {
        DISK.dump(&self.0)
    }
}

fn near(io: &mut Transport) -> Outcome {
    let text = io.text.trim();
    let path = text.strip_prefix("near").unwrap_or(text).trim().to_owned();
    let &[u, v, radius] = io.floats.as_slice() else {
        return Ok(());
    };
    if !(radius.is_finite() && radius >= 3.0) {
        let text = format!("the radius is {radius} px; discs of 3 px and more are found");
        return Err(Report::error(sorma::report::code::VALUE, text));
    }
    let picture = picture::opened(&path, io)?;
    let inside = |at: f64, size: usize| (-0.5..=size as f64 - 0.5).contains(&at);
    if !inside(u, picture.width) || !inside(v, picture.height) {
        let (width, height) = (picture.width, picture.height);
        let text = format!("`{path}` is {width} x {height} px, and {u:?}, {v:?} is outside of it");
        return Err(Report::error(sorma::report::code::VALUE, text));
    }
    let disc = disc_near(&picture, [u, v], radius).map_err(|why| none(&path, &why))?;
    io.floats = vec![disc.u, disc.v, disc.radius, disc.sd_px[0], disc.sd_px[1]];
    io.ints = vec![disc.piece.code()];
    Ok(())
}

impl GetDisk {
    fn on_board(&self, io: &mut Transport) -> Outcome {
        let path = io.text.trim().to_owned();
        let &[file, rank] = io.floats.as_slice() else {
            return Ok(());
        };
        let picture = picture::opened(&path, io)?;
        let white = self.0.white();
        let board = Board::find(&picture, white).and_then(|board| board.facing(white));
        let board = board.map_err(|why| none(&path, &why))?;
        let disc: Disc = board.disc(file, rank).map_err(|why| none(&path, &why))?;
        io.floats = vec![disc.u, disc.v, disc.radius, disc.file, disc.rank];
        io.floats.extend(disc.sd_px);
        io.floats.extend(disc.sd);
        io.ints = vec![disc.piece.code()];
        Ok(())
    }
}
