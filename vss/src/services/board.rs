//! The class `board`: a draughts board in a picture, what stands on it, and where one disc is.

mod drawn;

use std::{sync::LazyLock, time::Duration};

use futures_util::future::LocalBoxFuture;
use sorma::{Context, Form, OptionTable, Outcome, Report, ServiceObject, Transport, Waiting};
use vss_image::{
    Picture,
    board::{Board as Found, BoardError, Roles, Side},
    colour::{Classes, Training},
};

use drawn::{NUMBERS, Reading};

use super::{code, colour, ended, picture};
use crate::{command::ShowImage, frame::Frame};

const FORMS: &[Form] = &[
    Form {
        text: "marker FILE",
        floats: 0,
        takes: "",
        gives: "18 floats: the homography from files and ranks (squares from the corner of a1: the right edge of h and the upper \
                edge of 8 are 8) to u, v (px), 9 numbers row by row with the last one 1; u, v of the board's corners at a1, h1, \
                h8, a8 (px); rms distance of the inner corners from it (px); 1 int: how many of 49 inner corners were seen",
        results: "",
        help: "where the board is",
    },
    Form {
        text: "disk FILE",
        floats: 2,
        takes: "file and rank, squares from the corner of a1, as 2.5 0.5 for the middle of c1",
        gives: "5 floats: u, v, mean radius (px), file and rank of the disc's middle (squares); 1 int: 1 white, 2 black",
        results: "u v radius: px file rank; ints piece",
        help: "the disc near a place of the board",
    },
    Form {
        text: "rest FILE",
        floats: 0,
        takes: "",
        gives: "1 + 2 n floats: which part of the light squares something covers that is neither disc nor square, 0 to 1; file and \
                rank of each disc that stands on a light square, or partly on one; n ints: 1 white, 2 black. Needs -train with a \
                class `light`",
        results: "",
        help: "what is on the squares where nothing should be: discs that were lost, hands",
    },
    Form {
        text: "show FILE",
        floats: Form::ANY,
        takes: "nothing, to show what is read here; or 73 numbers that say what was made of it: 1 if a hand is seen, else 0; piece and \
                confidence of 32 squares in the order of PDN (a confidence below 0: that square has no mark); u, v of four markers \
                (px)",
        gives: "1 int: on how many squares something is unsure (below 0.8)",
        results: "",
        help: "shows the picture on the app's monitor, with what was read in it drawn over it",
    },
    Form {
        text: "FILE",
        floats: 0,
        takes: "",
        gives: "32 ints in the order of PDN (1 is b8, 4 is h8, 29 is a1): 0 empty, 1 and 2 white and black man, 3 and 4 white and \
                black king, -1 unknown; 32 floats: confidences, 0 to 1",
        results: "",
        help: "reads the playing squares of a draughts board in a picture (PNG, JPEG, PNM, BMP). In all forms FILE may be \
               `camera NAME`, which has a camera of the app take the picture, and answers two ints more: its number, and the \
               middle of its exposure, ns of the app's time; or `last`, the picture that was read last",
    },
];

#[derive(Debug, Clone, PartialEq)]
pub(super) struct Options {
    white: String,
    train: String,
    tool: String,
    show: String,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            white: "bottom".to_owned(),
            train: String::new(),
            tool: "toolSnap".to_owned(),
            show: "toolImageDisp".to_owned(),
        }
    }
}

pub(super) static TABLE: LazyLock<OptionTable<Options>> = LazyLock::new(|| {
    OptionTable::new("reads draughts boards")
        .exec(FORMS)
        .choice(
            "white",
            &["bottom", "top", "left", "right"],
            "the side of the picture on which White sits: the pattern alone allows two",
            |options: &mut Options| &mut options.white,
        )
        .word(
            "train",
            "FILE",
            "labelled pixels (CSV class,r,g,b, as `colour` takes them) with the classes white, black (discs) and dark (squares); \
             without it white discs are lighter than dark squares, and black ones darker",
            |options| &mut options.train,
        )
        .word(
            "tool",
            "TASK",
            "the app's task that takes pictures",
            |options| &mut options.tool,
        )
        .word(
            "show",
            "TASK",
            "the app's task that shows pictures",
            |options| &mut options.show,
        )
});

/// A picture, and the board in it.
struct Read {
    /// What it is called.
    name: String,
    picture: Picture,
    board: Found,
    /// Number and stamp (ns) of a picture that a camera took.
    taken: Option<[i64; 2]>,
}

/// An object of class `board`.
#[derive(Default)]
pub(super) struct Board {
    options: Options,
    colours: Option<(Classes, Roles)>,
    last: Option<Read>,
}

impl ServiceObject for Board {
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
        let mut options = self.options.clone();
        let trains = io.text.split_whitespace().any(|word| word == "-train");
        TABLE.ctrl(&mut options, io);
        if options.white != self.options.white {
            // Its squares would be those of another side.
            self.last = None;
        }
        if trains && !options.train.is_empty() {
            // What was there before stays when the table is no good.
            self.colours = Some(learned(&options.train, io).inspect_err(|_| io.text.clear())?);
        }
        self.options = options;
        Ok(())
    }

    fn dump(&self) -> String {
        TABLE.dump(&self.options)
    }
}

fn learned(path: &str, io: &mut Transport) -> Result<(Classes, Roles), Report> {
    let classes = colour::train(path, &Training::default(), io)?;
    match Roles::of(&classes) {
        Ok(roles) => Ok((classes, roles)),
        Err(missing) => {
            let text = format!(
                "{path}: no class is called `{missing}`: a board needs white, black and dark"
            );
            Err(Report::error(code::COLOURS, text))
        }
    }
}

/// A monitor that is dark must not cost the next picture.
const SHOWN_WITHIN: Duration = Duration::from_secs(1);

/// A disc that is farther from the middle of a square stands on none, squares.
const OFF: f64 = 0.35;

/// The word for the picture that was read last.
const LAST: &str = "last";

impl Board {
    async fn job(&mut self, cx: &Waiting<'_>, io: &mut Transport) -> Outcome {
        let form = TABLE.form(io)?;
        let verb = form.text.strip_suffix("FILE").unwrap_or_default().trim();
        let name = io.text.trim();
        let name = name.strip_prefix(verb).unwrap_or(name).trim().to_owned();
        let mut taken = None;
        if name != LAST {
            // What was there before is not the last one any more, even if there is no board in this one.
            self.last = None;
            let (picture, numbers) = picture::of(cx, &name, &self.options.tool, io).await?;
            taken = numbers;
            let board = self.found(&picture).map_err(|why| none(&name, &why))?;
            self.last = Some(Read {
                name,
                picture,
                board,
                taken,
            });
        }
        let read = self.last.as_ref().ok_or_else(|| {
            let text = "no board was read yet: give a file, or `camera NAME`";
            Report::error(code::BOARD, text)
        })?;
        match verb {
            "marker" => marker(&read.board, io),
            "disk" => self.disk(read, io)?,
            "rest" => self.rest(read, io)?,
            "show" => self.show(cx, read, io).await?,
            _ => self.situation(read, io),
        }
        io.ints.extend(taken.into_iter().flatten());
        Ok(())
    }

    fn found(&self, picture: &Picture) -> Result<Found, BoardError> {
        let white = match self.options.white.as_str() {
            "top" => Side::Top,
            "left" => Side::Left,
            "right" => Side::Right,
            _ => Side::Bottom,
        };
        Found::find(picture, white).and_then(|board| board.facing(white))
    }

    fn colours(&self) -> Option<(&Classes, &Roles)> {
        let colours = self.colours.as_ref();
        colours.map(|(classes, roles)| (classes, roles))
    }

    fn disk(&self, read: &Read, io: &mut Transport) -> Outcome {
        let (file, rank) = match io.floats.as_slice() {
            [file, rank] => (*file, *rank),
            _ => (f64::NAN, f64::NAN),
        };
        let disc = read.board.disc(file, rank);
        let disc = disc.map_err(|why| none(&read.name, &why))?;
        let mut piece = Some(disc.piece);
        if let Some(colours) = self.colours() {
            piece = read.board.coloured(&read.picture, colours, &disc);
        }
        let piece = piece.ok_or_else(|| none(&read.name, &BoardError::NoDisc { file, rank }))?;
        io.floats = vec![disc.u, disc.v, disc.radius, disc.file, disc.rank];
        io.ints = vec![piece.code()];
        Ok(())
    }

    fn rest(&self, read: &Read, io: &mut Transport) -> Outcome {
        let colours = self.colours();
        let rest = colours.and_then(|colours| read.board.rest(&read.picture, colours));
        let rest = rest.ok_or_else(|| {
            let text = "colours say what is on light squares: -train FILE with a class `light`";
            Report::error(code::COLOURS, text)
        })?;
        io.floats = vec![rest.covered];
        let places = rest.discs.iter().flat_map(|disc| [disc.file, disc.rank]);
        io.floats.extend(places);
        io.ints = rest.discs.iter().map(|disc| disc.piece.code()).collect();
        Ok(())
    }

    /// Shows the picture with what was read in it.
    async fn show(&self, cx: &Waiting<'_>, read: &Read, io: &mut Transport) -> Outcome {
        let colours = self.colours();
        let rest = colours.and_then(|colours| read.board.rest(&read.picture, colours));
        let strays = rest.into_iter().flat_map(|rest| rest.discs);
        let strays = strays
            .map(|disc| (disc.piece.code(), [disc.file, disc.rank]))
            .filter(|(_, at)| is_stray(*at))
            .collect();
        let reading = if io.floats.is_empty() {
            let fields = read.board.situation(&read.picture, colours);
            let squares = fields.iter();
            let squares = squares.map(|field| (field.piece.code(), field.confidence));
            Reading::of(squares.collect(), strays)
        } else {
            Reading::told(&io.floats, strays).ok_or_else(|| {
                let given = io.floats.len();
                let text = format!("`show` takes no number or {NUMBERS}, and {given} are given");
                Report::error(sorma::report::code::VALUE, text)
            })?
        };
        let [number, stamp] = read.taken.unwrap_or_default();
        let camera = read.name.strip_prefix(picture::CAMERA);
        let camera = camera.unwrap_or(&read.name).trim().to_owned();
        let (width, height) = (read.picture.width, read.picture.height);
        let frame = Frame {
            camera: camera.clone(),
            number: number.unsigned_abs(),
            stamp: Duration::from_nanos(stamp.unsigned_abs()),
            ..Frame::grey8(width, height, read.picture.clone().into_grey())
        };
        let request = ShowImage {
            camera,
            frame,
            drawing: reading.drawn(&read.board),
        };
        picture::begun().await;
        cx.call_task(&self.options.show, request, SHOWN_WITHIN)
            .await?;
        io.floats.clear();
        io.ints = vec![i64::try_from(reading.unsure()).unwrap_or(i64::MAX)];
        Ok(())
    }

    fn situation(&self, read: &Read, io: &mut Transport) {
        let fields = read.board.situation(&read.picture, self.colours());
        io.ints = fields.iter().map(|field| field.piece.code()).collect();
        io.floats = fields.iter().map(|field| field.confidence).collect();
    }
}

/// Whether a disc stands so far from the middle of the nearest dark square that it is on none.
fn is_stray([file, rank]: [f64; 2]) -> bool {
    let (x, y) = (file.floor(), rank.floor());
    let is_light = (x + y).rem_euclid(2.0) != 0.0;
    is_light || (file - x - 0.5).hypot(rank - y - 0.5) >= OFF
}

fn marker(board: &Found, io: &mut Transport) {
    io.floats = board.homography().to_vec();
    for [file, rank] in [[0.0, 0.0], [8.0, 0.0], [8.0, 8.0], [0.0, 8.0]] {
        io.floats.extend(board.pixel(file, rank));
    }
    io.floats.push(board.rms);
    io.ints = vec![i64::try_from(board.corners).unwrap_or(i64::MAX)];
}

fn none(name: &str, why: &BoardError) -> Report {
    Report::error(code::BOARD, format!("`{name}`: {why}"))
}
