//! The class `board`: a draughts board in a picture, what stands on it, and where one disc is.

use std::sync::LazyLock;

use sorma::{Context, Form, OptionTable, Outcome, Report, ServiceObject, Transport};
use vss_image::{
    Picture,
    board::{Board as Found, BoardError, Roles, Side},
    colour::{Classes, Training},
};

use super::{code, colour, ended, picture};

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
        text: "FILE",
        floats: 0,
        takes: "",
        gives: "32 ints in the order of PDN (1 is b8, 4 is h8, 29 is a1): 0 empty, 1 and 2 white and black man, 3 and 4 white and \
                black king, -1 unknown; 32 floats: confidences, 0 to 1",
        results: "",
        help: "reads the playing squares of a draughts board in a picture (PNG, JPEG, PNM, BMP)",
    },
];

#[derive(Debug, Clone, PartialEq)]
pub(super) struct Options {
    white: String,
    train: String,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            white: "bottom".to_owned(),
            train: String::new(),
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
});

/// An object of class `board`.
#[derive(Default)]
pub(super) struct Board {
    options: Options,
    colours: Option<(Classes, Roles)>,
}

impl ServiceObject for Board {
    fn exec(&mut self, _cx: &Context<'_>, io: &mut Transport) -> Outcome {
        let outcome = TABLE.form(io).and_then(|form| {
            let text = io.text.trim().to_owned();
            let after = |word: &str| {
                text.strip_prefix(word)
                    .unwrap_or_default()
                    .trim()
                    .to_owned()
            };
            match form.text {
                "marker FILE" => self.marker(&after("marker"), io),
                "disk FILE" => self.disk(&after("disk"), io),
                _ => self.situation(&text, io),
            }
        });
        ended(io, outcome)
    }

    fn ctrl(&mut self, _cx: &Context<'_>, io: &mut Transport) -> Outcome {
        let mut options = self.options.clone();
        let trains = io.text.split_whitespace().any(|word| word == "-train");
        TABLE.ctrl(&mut options, io);
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

impl Board {
    fn found(&self, path: &str, io: &mut Transport) -> Result<(Picture, Found), Report> {
        let picture = picture::opened(path, io)?;
        let white = match self.options.white.as_str() {
            "top" => Side::Top,
            "left" => Side::Left,
            "right" => Side::Right,
            _ => Side::Bottom,
        };
        let found = Found::find(&picture, white).and_then(|board| board.facing(white));
        let found = found.map_err(|why| none(path, &why))?;
        Ok((picture, found))
    }

    fn marker(&self, path: &str, io: &mut Transport) -> Outcome {
        let (_, board) = self.found(path, io)?;
        io.floats = board.homography().to_vec();
        for [file, rank] in [[0.0, 0.0], [8.0, 0.0], [8.0, 8.0], [0.0, 8.0]] {
            io.floats.extend(board.pixel(file, rank));
        }
        io.floats.push(board.rms);
        io.ints = vec![i64::try_from(board.corners).unwrap_or(i64::MAX)];
        Ok(())
    }

    fn disk(&self, path: &str, io: &mut Transport) -> Outcome {
        let (file, rank) = match io.floats.as_slice() {
            [file, rank] => (*file, *rank),
            _ => (f64::NAN, f64::NAN),
        };
        let (_, board) = self.found(path, io)?;
        let disc = board.disc(file, rank).map_err(|why| none(path, &why))?;
        io.floats = vec![disc.u, disc.v, disc.radius, disc.file, disc.rank];
        io.ints = vec![disc.piece.code()];
        Ok(())
    }

    fn situation(&self, path: &str, io: &mut Transport) -> Outcome {
        let (picture, board) = self.found(path, io)?;
        let colours = self
            .colours
            .as_ref()
            .map(|(classes, roles)| (classes, roles));
        let fields = board.situation(&picture, colours);
        io.ints = fields.iter().map(|field| field.piece.code()).collect();
        io.floats = fields.iter().map(|field| field.confidence).collect();
        Ok(())
    }
}

fn none(path: &str, why: &BoardError) -> Report {
    Report::error(code::BOARD, format!("`{path}`: {why}"))
}
