//! The class `game`: checkers by text. The engine is the crate `checkers`; here are only its words, its numbers and its clock.

use std::{fmt::Write as _, fs::File, io::Read, path::Path, sync::LazyLock, time::Duration};

use checkers::{
    DEEPEST, Leaves, Limits, MOST_LEAVES, MOST_PIECES, Numbering, Position, Tables, TextError,
    Variant, Written, pdn, perft, search,
};
use sorma::{
    Class, ClassInfo, Context, Form, OptionTable, Outcome, Report, ServiceObject, Sorm, Transport,
};

use crate::services::ended;

/// Version of the class.
const VERSION: &str = env!("CARGO_PKG_VERSION");

/// Nobody waits longer for a move, s.
const LONGEST: f64 = 600.0;

/// So many positions a second of search are looked at and no more: with them a search ends in virtual time too.
const POSITIONS_PER_SECOND: f64 = 4e6;

sorma::prototypes! {
    /// The codes of the reports of this class.
    pub mod code {
        TEXT = 210, Error, "a position, a move or a number cannot be read",
            "the text says where, as line:column: `W:W21-32:B1-12` is a position, `start` the first one; `22x15` is a move";
        ILLEGAL = 211, Error, "the move is not legal",
            "the text says which rule it breaks; EXEC moves lists what is legal";
        FILE = 212, Error, "a file cannot be read or written, or is refused",
            "the text says which and why; a path is taken from where the process was started";
        TOO_MANY = 213, Error, "there is too much to count",
            "choose a smaller depth";
    }
}

const FORMS: &[Form] = &[
    Form {
        text: "moves FEN",
        floats: 0,
        takes: "",
        gives: "the legal moves, sorted; a capture with every square where it lands, and a circle in two orders once; 1 int: how many",
        results: "",
        help: "lists the legal moves of a position",
    },
    Form {
        text: "perft DEPTH FEN",
        floats: 0,
        takes: "",
        gives: "1 int: how many sequences of so many moves there are; a move is from, to and the set of captured squares",
        results: "",
        help: "counts games, to compare generators of moves",
    },
    Form {
        text: "perft_paths DEPTH FEN",
        floats: 0,
        takes: "",
        gives: "1 int: the same when two orders of the same captures are two moves",
        results: "",
        help: "counts games and orders of captures",
    },
    Form {
        text: "best SECONDS FEN",
        floats: 0,
        takes: "",
        gives: "the best move, and with it as its first word the line that is expected; 1 float: the value in men for the side \
                that moves, beyond 290 when the end is seen; 2 ints: depth in half-moves, and positions looked at",
        results: "",
        help: "searches for the best move",
    },
    Form {
        text: "play FEN MOVE",
        floats: 0,
        takes: "",
        gives: "the position after the move",
        results: "",
        help: "plays a move, with all its squares or with the first and the last",
    },
    Form {
        text: "pdn FILE",
        floats: 0,
        takes: "",
        gives: "a line for each game: how many half-moves and the last position, or line:column and what is wrong",
        results: "",
        help: "reads a file of games; the tag GameType chooses the variant",
    },
    Form {
        text: "tables DIR",
        floats: 0,
        takes: "",
        gives: "the file; 1 int: its size in bytes",
        results: "",
        help: "makes the endgame tables of the variant, up to 4 pieces, and writes them into a folder; takes some seconds",
    },
];

#[derive(Debug, Clone, PartialEq)]
struct Options {
    variant: String,
    board: String,
    nodes: i64,
    depth: i64,
    tables: String,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            variant: Variant::Brazilian.name().to_owned(),
            board: "auto".to_owned(),
            nodes: 0,
            depth: 99,
            tables: String::new(),
        }
    }
}

impl Options {
    fn variant(&self) -> Variant {
        Variant::named(&self.variant).unwrap_or(Variant::Brazilian)
    }
}

static TABLE: LazyLock<OptionTable<Options>> = LazyLock::new(|| {
    OptionTable::new("checkers on 8x8 boards: legal moves, the best move, games in files")
        .exec(FORMS)
        .choice(
            "variant",
            Variant::NAMES,
            "the rules; brazilian are the international rules on 8x8",
            |options: &mut Options| &mut options.variant,
        )
        .choice(
            "board",
            &["auto", "plain", "mirrored"],
            "where square 1 is: b8 on a plain board, a8 on a mirrored one; auto: as PDN has it, mirrored for italian and spanish",
            |options| &mut options.board,
        )
        .int(
            "nodes",
            0..=1_000_000_000_000,
            "positions",
            "ends a search after so many positions, and not after a time: it repeats exactly; 0: after its time",
            |options| &mut options.nodes,
        )
        .int(
            "depth",
            1..=99,
            "half-moves",
            "how deep a search looks at most",
            |options| &mut options.depth,
        )
        .word(
            "tables",
            "DIR",
            "a folder of endgame tables, as EXEC tables makes them; read when it is set and when the variant changes",
            |options| &mut options.tables,
        )
});

/// Makes the class known to a manager.
pub(crate) fn register(sorm: &Sorm) {
    let class = Class::new("game", VERSION, |_, _| Ok(Box::new(Game::default())));
    let class = class.any_flavor().codes(code::PROTOTYPES);
    sorm.register(class.described(TABLE.class("game", VERSION)));
}

/// What a program may know about the class.
pub(crate) fn class() -> ClassInfo {
    TABLE.class("game", VERSION)
}

/// An object of the class.
#[derive(Default)]
struct Game {
    options: Options,
    tables: Option<Tables>,
}

impl ServiceObject for Game {
    fn exec(&mut self, cx: &Context<'_>, io: &mut Transport) -> Outcome {
        let outcome = TABLE.form(io).and_then(|form| {
            let text = std::mem::take(&mut io.text);
            let (_, rest) = split(&text);
            match form.text {
                "moves FEN" => self.moves(rest, io),
                "perft DEPTH FEN" => self.perft(rest, Leaves::Moves, io),
                "perft_paths DEPTH FEN" => self.perft(rest, Leaves::Orders, io),
                "best SECONDS FEN" => self.best(rest, cx, io),
                "play FEN MOVE" => self.play(rest, io),
                "pdn FILE" => self.pdn(rest, io),
                _ => self.make_tables(rest, io),
            }
        });
        // What came in must not stay there as if it were an answer.
        if outcome.is_err() {
            io.ints.clear();
            return ended(io, outcome);
        }
        outcome
    }

    fn ctrl(&mut self, _cx: &Context<'_>, io: &mut Transport) -> Outcome {
        let mut options = self.options.clone();
        let sets = io.text.split_whitespace().any(|word| word == "-tables");
        TABLE.ctrl(&mut options, io);
        if options.tables.is_empty() {
            self.tables = None;
        } else if sets || options.variant != self.options.variant {
            // What was there before stays when a file is refused.
            let tables = Tables::read(Path::new(&options.tables), options.variant());
            let tables = tables.map_err(|error| Report::error(code::FILE, error.to_string()));
            self.tables = Some(tables.inspect_err(|_| io.text.clear())?);
        }
        self.options = options;
        Ok(())
    }

    fn dump(&self) -> String {
        TABLE.dump(&self.options)
    }
}

/// The first word of a text, and the rest.
fn split(text: &str) -> (&str, &str) {
    let text = text.trim();
    text.split_once(char::is_whitespace)
        .map_or((text, ""), |(word, rest)| (word, rest.trim()))
}

impl Game {
    fn numbering(&self) -> Numbering {
        match self.options.board.as_str() {
            "plain" => Numbering::Plain,
            "mirrored" => Numbering::Mirrored,
            _ => Numbering::of(self.options.variant()),
        }
    }

    fn position(&self, text: &str) -> Result<Position, Report> {
        Position::read(text, self.options.variant(), self.numbering())
            .map_err(|error| Report::error(code::TEXT, error.to_string()))
    }

    fn moves(&self, fen: &str, io: &mut Transport) -> Outcome {
        let position = self.position(fen)?;
        let words = position.words(self.options.variant(), self.numbering());
        io.ints = vec![i64::try_from(words.len()).unwrap_or(i64::MAX)];
        let words: Vec<String> = words.into_iter().map(|(word, _)| word).collect();
        io.text = words.join(" ");
        Ok(())
    }

    fn perft(&self, rest: &str, leaves: Leaves, io: &mut Transport) -> Outcome {
        let (depth, fen) = split(rest);
        let depth = depth.parse().ok().filter(|depth| *depth <= DEEPEST);
        let depth = depth.ok_or_else(|| {
            let text =
                format!("1:1 depth: a whole number from 0 to {DEEPEST} stands before the position");
            Report::error(code::TEXT, text)
        })?;
        let position = self.position(fen)?;
        let count = perft(&position, self.options.variant(), depth, leaves);
        let count = count.and_then(|count| i64::try_from(count).ok());
        let count = count.ok_or_else(|| {
            let text = format!(
                "to depth {depth} there are more than {MOST_LEAVES} games: they are not counted"
            );
            Report::error(code::TOO_MANY, text)
        })?;
        io.ints = vec![count];
        Ok(())
    }

    fn best(&self, rest: &str, cx: &Context<'_>, io: &mut Transport) -> Outcome {
        let (seconds, rest) = split(rest);
        let (nodes, fen) = self.nodes(rest)?;
        let seconds = seconds.parse().ok();
        let seconds = seconds.filter(|seconds| (0.0..=LONGEST).contains(seconds));
        let seconds = seconds.ok_or_else(|| {
            let text =
                format!("1:1 seconds: a number from 0 to {LONGEST} stands before the position");
            Report::error(code::TEXT, text)
        })?;
        let position = self.position(fen)?;
        let begin = cx.sorm().now();
        let time = Duration::from_secs_f64(seconds);
        let mut stop = || nodes.is_none() && cx.sorm().now().since(begin) >= time;
        let most = (seconds * POSITIONS_PER_SECOND) as u64;
        let limits = Limits {
            nodes: Some(nodes.unwrap_or(most).max(1)),
            depth: u32::try_from(self.options.depth).unwrap_or(99),
            stop: &mut stop,
        };
        let variant = self.options.variant();
        let found = search(&position, variant, &[], self.tables.as_ref(), limits);
        let numbering = self.numbering();
        let mut at = position;
        for step in &found.line {
            let words = at.words(variant, numbering);
            let word = words.into_iter().find(|(_, other)| other == step);
            let word = word.map_or_else(|| numbering.short(*step, 'x'), |(word, _)| word);
            let space = if io.text.is_empty() { "" } else { " " };
            let _ = write!(io.text, "{space}{word}");
            at = at.after(*step);
        }
        io.floats = vec![f64::from(found.value) / 100.0];
        let nodes = i64::try_from(found.nodes).unwrap_or(i64::MAX);
        io.ints = vec![i64::from(found.depth), nodes];
        Ok(())
    }

    /// Positions to look at, which may stand behind the position as `-nodes N`.
    fn nodes<'t>(&self, rest: &'t str) -> Result<(Option<u64>, &'t str), Report> {
        let own = u64::try_from(self.options.nodes)
            .ok()
            .filter(|nodes| *nodes > 0);
        let Some((fen, number)) = rest.split_once("-nodes") else {
            return Ok((own, rest));
        };
        let nodes = number.trim().parse().ok().filter(|nodes| *nodes > 0);
        let nodes = nodes.ok_or_else(|| {
            let column = fen.chars().count() + 1;
            let text = format!("1:{column} -nodes takes a whole number of positions from 1");
            Report::error(code::TEXT, text)
        })?;
        Ok((Some(nodes), fen.trim()))
    }

    fn play(&self, rest: &str, io: &mut Transport) -> Outcome {
        let (fen, word) = rest.rsplit_once(char::is_whitespace).unwrap_or((rest, ""));
        let position = self.position(fen)?;
        let (variant, numbering) = (self.options.variant(), self.numbering());
        let written = Written::read(word, numbering).map_err(|error| {
            let TextError {
                line,
                column,
                reason,
            } = error;
            Report::error(
                code::TEXT,
                format!("{line}:{column} move `{word}`: {reason}"),
            )
        })?;
        let step = position
            .find(&written, variant, numbering)
            .map_err(|refusal| Report::error(code::ILLEGAL, format!("{word}: {refusal}")))?;
        io.text = position.after(step).fen(numbering);
        Ok(())
    }

    fn pdn(&self, path: &str, io: &mut Transport) -> Outcome {
        let text = contents(path)?;
        let games = pdn::read(&text, self.options.variant());
        let lines = games.into_iter().map(|game| match game {
            Ok(game) => {
                let numbering = Numbering::of(game.variant);
                format!("{} {}", game.moves.len(), game.end().fen(numbering))
            }
            Err(error) => error.to_string(),
        });
        io.text = lines.collect::<Vec<String>>().join("\n");
        Ok(())
    }

    fn make_tables(&self, folder: &str, io: &mut Transport) -> Outcome {
        let tables = Tables::make(self.options.variant(), MOST_PIECES);
        let file = tables
            .write(Path::new(folder))
            .map_err(|error| Report::error(code::FILE, error.to_string()))?;
        let size = std::fs::metadata(&file).map_or(0, |about| about.len());
        io.text = file.display().to_string();
        io.ints = vec![i64::try_from(size).unwrap_or(i64::MAX)];
        Ok(())
    }
}

/// The text of a file of games; letters that are no UTF-8, as old files have them in names, are replaced.
fn contents(path: &str) -> Result<String, Report> {
    let wrong =
        |reason: String| Report::error(code::FILE, format!("cannot read `{path}`: {reason}"));
    let file = File::open(path).map_err(|error| wrong(error.to_string()))?;
    let about = file.metadata().map_err(|error| wrong(error.to_string()))?;
    if !about.is_file() {
        return Err(wrong("it is no file".to_owned()));
    }
    let most = pdn::LONGEST_FILE as u64;
    let mut bytes = Vec::new();
    file.take(most + 1)
        .read_to_end(&mut bytes)
        .map_err(|error| wrong(error.to_string()))?;
    if bytes.len() as u64 > most {
        return Err(wrong(format!("it has more than {most} bytes")));
    }
    Ok(String::from_utf8_lossy(&bytes).into_owned())
}

#[cfg(test)]
mod tests;
