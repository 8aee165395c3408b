//! The functions of `nets/checkers/player.net`: the plot of a game (SORMA technical report, section 2.1.2).

use std::{cell::OnceCell, rc::Rc, time::Duration};

use checkers::{Colour, Limits, Move, Numbering, Position, Status, Variant, pdn, search};
use coordinators::{dom::DomStore, handler::NetArgs};
use ctos::{
    config::{App, TaskConfig},
    diagnostic::{Finding, Findings},
    task::{Context, HandlerError},
};
use pnt::library::{Acted, Action, Library};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::Deserialize;

use crate::{
    play::{Play, VERBOSITY},
    state::{Phase, State},
    thinker::Seek,
    wire::{self, Believe, Hue, InForce, Played, SETTINGS, Settings, Situation, WISH, Wish, Words},
};

/// A draw is agreed to when the position is worth no more than this, hundredths of a man.
const FAIR: i32 = 50;

/// Nobody looks farther ahead, half-moves.
pub const DEEPEST: u32 = 99;

/// A disc is pushed so often in a row at most.
const MOST_PUSHES: u32 = 20;

/// The opponent who moves discs from a display.
pub const PERSON: &str = "person";

/// Arguments.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PlayerArgs {
    /// The data object manager.
    #[serde(default = "crate::coordinator::dom")]
    dom: String,
    /// Who plays against the robot: `self`, `program`, `person` (who drags discs on a display), or a file of PDN whose first game is
    /// played.
    #[serde(default = "own")]
    pub opponent: String,
    /// The robot's side against an opponent.
    #[serde(default = "white")]
    pub colour: String,
    /// The first position, FEN; that of the rules when it is left out.
    start: Option<String>,
    /// The rules.
    #[serde(default = "brazilian")]
    pub variant: String,
    /// The task that seeks moves.
    #[serde(default = "thinker")]
    thinker: String,
    /// How long a move is thought about, s.
    seconds: Option<f64>,
    /// How many positions are looked at for a move, in place of a time.
    nodes: Option<u64>,
    /// So many half-moves are looked ahead at most.
    #[serde(default = "deepest")]
    depth: u32,
    /// How much is said: 1 what people must know, 2 what the robot does too, 3 its moves too.
    #[serde(default = "verbosity")]
    verbosity: u32,
    /// Whether the arm stays where it is, and people carry for the robot.
    #[serde(default)]
    dry: bool,
    /// The task that shows what is believed, if there is one.
    symbols: Option<String>,
    /// The task of the room, whose light people set.
    #[serde(default = "crate::coordinator::room")]
    room: String,
    /// The seed of the opening; that of the app when it is left out.
    seed: Option<u64>,
    /// So often in a row a disc that stands crooked is pushed before people are asked to put it right.
    #[serde(default)]
    pushes: u32,
    /// So many half-moves at the beginning are drawn.
    #[serde(default = "opening")]
    opening: usize,
    /// Where the game is written as PDN, relative to the configuration's folder.
    pdn: Option<String>,
}

fn thinker() -> String {
    "thinker".to_owned()
}

fn own() -> String {
    "self".to_owned()
}

fn white() -> String {
    "white".to_owned()
}

fn brazilian() -> String {
    "brazilian".to_owned()
}

const fn deepest() -> u32 {
    DEEPEST
}

const fn verbosity() -> u32 {
    VERBOSITY
}

const fn opening() -> usize {
    4
}

impl PlayerArgs {
    /// The rules.
    #[must_use]
    pub fn rules(&self) -> Variant {
        Variant::named(&self.variant).unwrap_or(Variant::Brazilian)
    }

    /// The robot's side; `None` for both.
    #[must_use]
    pub fn ours(&self) -> Option<Colour> {
        match (self.opponent.as_str(), self.colour.as_str()) {
            ("self", _) => None,
            (_, "black") => Some(Colour::Black),
            _ => Some(Colour::White),
        }
    }

    /// The first position.
    ///
    /// # Errors
    /// It is none, or needs more discs than there are.
    pub fn first(&self, app: &App) -> Result<Position, String> {
        let rules = self.rules();
        let first = match (&self.start, self.record(app)?) {
            (_, Some(record)) => record.start,
            (Some(fen), None) => self.position(fen)?,
            (None, None) => Position::start(rules.starts()),
        };
        let discs = |side: Colour| {
            let own = first.side(side);
            own.count_ones() + (own & first.kings).count_ones()
        };
        match [Colour::White, Colour::Black]
            .into_iter()
            .find(|side| discs(*side) > 12)
        {
            Some(side) => Err(format!("{} has more than 12 discs", side.name())),
            None => Ok(first),
        }
    }

    /// A position as its text has it.
    fn position(&self, fen: &str) -> Result<Position, String> {
        let rules = self.rules();
        let read = Position::read(fen, rules, Numbering::of(rules));
        read.map_err(|error| error.to_string())
    }

    /// The game that is played, when it is one of a file.
    ///
    /// # Errors
    /// The file cannot be read, or its first game is wrong, or has other rules.
    pub fn record(&self, app: &App) -> Result<Option<pdn::Record>, String> {
        if ["self", "program", PERSON].contains(&self.opponent.as_str()) {
            return Ok(None);
        }
        let source = app
            .read(&self.opponent)
            .map_err(|error| error.to_string())?;
        let mut games = pdn::read(source.text(), self.rules()).into_iter();
        let game = games.next().ok_or("there is no game in it")?;
        let game = game.map_err(|error| error.to_string())?;
        if game.variant != self.rules() {
            return Err(format!("its game has {} rules", game.variant.name()));
        }
        Ok(Some(game))
    }
}

/// Whether the rules of a player want a board with its dark corner at White's right.
pub fn is_mirrored(cx: &Context, player: &str) -> bool {
    let player = cx.app().task(player);
    let args = player.and_then(|task| pnt::task::args::<PlayerArgs>(task).ok());
    args.is_some_and(|args| args.rules().mirrored())
}

/// What the functions share.
pub struct Player {
    args: Rc<PlayerArgs>,
    store: DomStore,
    play: Play,
    record: Rc<OnceCell<Option<pdn::Record>>>,
    /// How people want it to be.
    settings: Settings,
    /// How surely each square was seen as it is believed.
    seen: Vec<f64>,
    /// What those who look at a display were told last.
    believed: Option<Believe>,
}

impl Player {
    /// What people want, where they want something, and else what is configured.
    fn in_force(&self) -> InForce {
        let (args, wanted) = (&self.args, &self.settings);
        let configured = match (args.nodes, args.seconds) {
            (Some(_), _) => None,
            (None, seconds) => Some(seconds.unwrap_or(1.0)),
        };
        InForce {
            depth: wanted.depth.unwrap_or(args.depth),
            seconds: wanted.seconds.or(configured),
            verbosity: wanted.verbosity.unwrap_or(args.verbosity),
            dry: wanted.dry.unwrap_or(args.dry),
            light: wanted.light.unwrap_or(1.0),
        }
    }

    /// What is believed now.
    fn believes(&self) -> Believe {
        let play = &self.play;
        let position = play.game.position();
        let numbering = Numbering::of(play.game.variant());
        let last = play.game.moves().last();
        let mut words = match play.game.status() {
            Status::Playing => format!("{} to move", position.turn.name()),
            _ => play.result(),
        };
        if let Some(last) = last {
            words += &format!("; last move {}", numbering.short(*last, 'x'));
        }
        let carries = play.state.tasks.len();
        if play.state.phase == Phase::Setting {
            words += "; the board is being set up";
        } else if carries > 0 {
            words += &format!("; {carries} to carry");
        }
        if play.dry {
            words += "; a dry run: the arm stays where it is";
        }
        Believe {
            board: [position.white, position.black, position.kings],
            mirrored: play.game.variant().mirrored(),
            seen: self.seen.clone(),
            last: last.map(|step| [step.from, step.to]),
            words,
            settings: self.in_force(),
        }
    }
}

type Act = Action<Player>;

impl NetArgs for PlayerArgs {
    const HANDLER: &'static str = "checkers.player";
    type State = Player;

    fn dom(&self) -> &str {
        &self.dom
    }

    fn library(self, store: DomStore) -> Library<Player> {
        // Where a game begins the configuration says, which is read when it does.
        let rules = self.rules();
        let mut play = Play::new(rules, Position::start(rules.starts()), self.ours());
        play.pushes = self.pushes;
        (play.verbosity, play.dry) = (self.verbosity, self.dry);
        let note = |note: fn(&mut Play)| {
            move |action: Act| async move {
                action.with_state(|player| note(&mut player.play));
                gaze(&action).await
            }
        };
        Library::new(Player {
            args: Rc::new(self),
            store,
            play,
            record: Rc::default(),
            settings: Settings::default(),
            seen: vec![f64::NAN; 32],
            believed: None,
        })
        .kept(
            |player| player.play.state.clone(),
            |player, state: State| player.play.restore(state),
        )
        .enabling("has_words", |player: &Player| {
            !player.play.state.words.is_empty()
        })
        .enabling("board_moved", |player: &Player| player.play.state.moved)
        .enabling("is_over", |player: &Player| player.play.is_over())
        .enabling("is_ready", |player: &Player| player.play.state.ready)
        .enabling("has_carries", |player: &Player| {
            !player.play.state.tasks.is_empty()
        })
        .action("begin", begin)
        .action("judge", judge)
        .action("put_words", put_words)
        .action("think", think)
        .action("aim", aim)
        .action("heed", heed)
        .enabling("is_pushed", |player: &Player| player.play.state.errand.push)
        .enabling("holds", |player: &Player| player.play.state.holds)
        .enabling("has_slipped", |player: &Player| player.play.has_slipped())
        .action("note_missed", note(Play::missed))
        .action("note_held", note(Play::held))
        .action("note_lost", note(Play::lost))
        .action("note_carried", note(Play::carried))
        .action("finish", finish)
    }

    fn check(&self, task: &TaskConfig, app: &App, findings: &mut Findings) {
        coordinators::need_task(task, app, "thinker", &self.thinker, findings);
        coordinators::need_task(task, app, "room", &self.room, findings);
        if let Some(symbols) = &self.symbols {
            coordinators::need_task(task, app, "symbols", symbols, findings);
        }
        let mut wrong = |key: &str, text: String, help: String| {
            let place = task.args.locate(key).unwrap_or_else(|| task.place.clone());
            let finding = Finding::error("checkers::player::args", text);
            findings.push(finding.at(place).help(help));
        };
        if Variant::named(&self.variant).is_none() {
            let text = format!("there are no rules `{}`", self.variant);
            wrong(
                "variant",
                text,
                format!("give one of {}", Variant::NAMES.join(", ")),
            );
        } else if let Err(text) = self.record(app) {
            let help = "give \"self\", \"program\", \"person\", or a file of PDN".to_owned();
            wrong("opponent", format!("`opponent`: {text}"), help);
            if let Some(Err(text)) = self.start.as_ref().map(|fen| self.position(fen)) {
                let help = "give a position such as \"W:W22,32:B18\"".to_owned();
                wrong("start", format!("`start`: {text}"), help);
            }
        } else if let Err(text) = self.first(app) {
            let help = "give a position such as \"W:W22,32:B18\"".to_owned();
            wrong("start", format!("`start`: {text}"), help);
        }
        if self.pushes > MOST_PUSHES {
            let text = format!("`pushes` is {}", self.pushes);
            wrong("pushes", text, format!("give from 0 to {MOST_PUSHES}"));
        }
        if !(1..=DEEPEST).contains(&self.depth) {
            let text = format!("`depth` is {}", self.depth);
            wrong("depth", text, format!("give from 1 to {DEEPEST}"));
        }
        if !(1..=3).contains(&self.verbosity) {
            let text = format!("`verbosity` is {}", self.verbosity);
            wrong("verbosity", text, "give 1, 2 or 3".to_owned());
        }
        if !["white", "black"].contains(&self.colour.as_str()) {
            let text = format!("`colour` is `{}`", self.colour);
            wrong("colour", text, "give \"white\" or \"black\"".to_owned());
        }
        if let Some(seconds) = self.seconds
            && !(seconds > 0.0 && seconds <= 3600.0)
        {
            let help = "give more than 0 and up to 3600 s".to_owned();
            wrong("seconds", format!("`seconds` is {seconds}"), help);
        }
    }
}

fn store(action: &Act) -> DomStore {
    action.with_state(|player| player.store.clone())
}

/// A new game.
async fn begin(action: Act) -> Acted {
    if let Some(word) = action.arguments().first() {
        return Err(HandlerError::new(format!("`play` takes no `{word}`")));
    }
    let args = action.with_state(|player| player.args.clone());
    let first = args.first(action.cx().app()).map_err(HandlerError::new)?;
    action.with_state(|player| {
        player.play.start = first;
        player.play.pushes = args.pushes;
        player.play.again();
    });
    gaze(&action).await
}

/// Tells vision from where to look, and at what, when that is not what it was told.
async fn gaze(action: &Act) -> Acted {
    let (gaze, told) = action.with_state(|player| (player.play.gaze(), player.play.state.told));
    if told == Some(gaze) {
        return Ok(());
    }
    wire::keep(action.cx(), &store(action), wire::GAZE, &gaze).await?;
    action.with_state(|player| player.play.state.told = Some(gaze));
    Ok(())
}

/// What people want counts from now on. After a kill it is read again before the arm does anything.
async fn heed_settings(action: &Act) {
    let wanted: Option<Settings> = store(action).fetch(action.cx(), SETTINGS).await.ok();
    action.with_state(|player| {
        if let Some(wanted) = wanted {
            player.settings = wanted;
        }
        let InForce { verbosity, dry, .. } = player.in_force();
        (player.play.verbosity, player.play.dry) = (verbosity, dry);
    });
    shine(action).await;
}

/// Tells the room how light people want it. A room that began anew does not know.
async fn shine(action: &Act) {
    let (room, share) =
        action.with_state(|player| (player.args.room.clone(), player.settings.light));
    if let Some(share) = share
        && let Err(error) = wire::ask(action.cx(), &room, wire::Shine { share }).await
    {
        tracing::warn!(%error, "the light is told with the next look");
    }
}

async fn judge(action: Act) -> Acted {
    let (cx, store) = (action.cx().clone(), store(&action));
    let seen: Situation = wire::fetch(&cx, &store, wire::SITUATION).await?;
    let record = record(&action)?;
    let wish: Option<Wish> = store.fetch(&cx, WISH).await.ok();
    heed_settings(&action).await;
    action.with_state(|player| {
        let play = &mut player.play;
        play.judge(&seen);
        player.seen = play.agreement(&seen);
        if let Some(wish) = wish
            && wish.number > play.state.wish
            && play.listens()
        {
            take_up(play, &wish);
        }
        if let Some(record) = &*record
            && play.state.phase != Phase::Setting
            && play.state.tasks.is_empty()
        {
            end_as(play, record);
        }
    });
    believe(&action).await;
    gaze(&action).await
}

/// Tells what is believed, where that is shown and has changed. Nobody waits for a display.
async fn believe(action: &Act) {
    let told = action.with_state(|player| {
        let symbols = player.args.symbols.clone()?;
        let now = Some(player.believes());
        let news = player.believed != now;
        player.believed.clone_from(&now);
        now.filter(|_| news).map(|believed| (symbols, believed))
    });
    let Some((symbols, believed)) = told else {
        return;
    };
    let found = action.cx().task(&symbols).deadline(Duration::ZERO);
    let sent = match found.await {
        Ok(task) => action.cx().send(&task, believed).await.is_ok(),
        Err(_) => false,
    };
    if !sent {
        // It is told with the next look.
        action.with_state(|player| player.believed = None);
    }
}

/// The game of the file, which is read once.
fn record(action: &Act) -> Result<Rc<Option<pdn::Record>>, HandlerError> {
    let (args, cell) = action.with_state(|player| (player.args.clone(), player.record.clone()));
    if cell.get().is_none() {
        let read = args.record(action.cx().app()).map_err(HandlerError::new)?;
        let _ = cell.set(read);
    }
    Ok(Rc::new(cell.get().cloned().flatten()))
}

/// A game that has gone as the file has it ends as it does there.
fn end_as(play: &mut Play, record: &pdn::Record) {
    if play.game.moves() != record.moves.as_slice() || play.game.status() != Status::Playing {
        return;
    }
    let turn = Hue::of(play.game.position().turn);
    play.end(match record.result.as_str() {
        "1-0" | "2-0" => Some(Hue::Dark),
        "0-1" | "0-2" => Some(Hue::Light),
        "1/2-1/2" | "1-1" => None,
        // Unfinished: whoever should move does not.
        _ => Some(turn),
    });
}

/// Takes up what people want.
fn take_up(play: &mut Play, wish: &Wish) {
    play.state.wish = wish.number;
    let turn = play.game.position().turn;
    match wish.what.as_str() {
        "resign" => play.end(Some(Hue::of(play.ours.map_or(turn, Colour::other)))),
        "draw" if value(play) <= FAIR => play.end(None),
        "draw" => play.state.words.push("I play on".to_owned()),
        _ => {
            play.again();
            let words = "a new game: please set up the board".to_owned();
            play.state.words.push(words);
        }
    }
}

/// What the position is worth to the robot, hundredths of a man.
fn value(play: &Play) -> i32 {
    let game = &play.game;
    let limits = Limits {
        nodes: Some(1000),
        depth: 99,
        stop: &mut || false,
    };
    let found = search(game.position(), game.variant(), game.before(), None, limits);
    let own = play.ours.is_none_or(|ours| ours == game.position().turn);
    if own { found.value } else { -found.value }
}

async fn put_words(action: Act) -> Acted {
    let words = action.with_state(|player| Words {
        number: player.play.state.said + 1,
        words: player.play.state.words.join("; "),
        shown: player.play.state.shown.clone(),
        board: player.play.asked_board(),
    });
    wire::keep(action.cx(), &store(&action), wire::WORDS, &words).await?;
    action.with_state(|player| {
        player.play.state.said = words.number;
        player.play.state.words.clear();
        player.play.state.shown.clear();
    });
    Ok(())
}

async fn think(action: Act) -> Acted {
    let record = record(&action)?;
    let cx = action.cx().clone();
    heed_settings(&action).await;
    let (mut step, args, seek) = action.with_state(|player| {
        let in_force = player.in_force();
        let game = &player.play.game;
        let step = recorded(game.moves(), record.as_ref().as_ref());
        let step = step.or_else(|| drawn(&cx, player));
        let seek = Seek {
            variant: game.variant().name().to_owned(),
            start: player.play.start.fen(Numbering::of(game.variant())),
            moves: player.play.state.moves.clone(),
            nodes: player.args.nodes.filter(|_| in_force.seconds.is_none()),
            seconds: in_force.seconds.unwrap_or(1.0),
            depth: in_force.depth,
        };
        (step, player.args.clone(), seek)
    });
    if step.is_none() {
        step = seek.ask(&cx, &args.thinker).await?;
    }
    let step = step.ok_or("there is no move")?;
    action.with_state(|player| player.play.think(step));
    gaze(&action).await
}

/// The next move of the record, as long as the game goes as it says.
pub(crate) fn recorded(moves: &[Move], record: Option<&pdn::Record>) -> Option<Move> {
    record?.moves.strip_prefix(moves)?.first().copied()
}

/// A move of the opening.
fn drawn(cx: &Context, player: &Player) -> Option<Move> {
    let (args, game) = (&player.args, &player.play.game);
    let ply = game.moves().len();
    if ply >= args.opening {
        return None;
    }
    let stream = format!("half-move {ply}");
    let mut rng = match args.seed {
        Some(seed) => {
            let mut rng = ChaCha8Rng::seed_from_u64(seed);
            rng.set_stream(ply as u64);
            rng
        }
        None => cx.rng(&stream),
    };
    let moves = game.position().moves(game.variant());
    moves.get(rng.random_range(0..moves.len().max(1))).copied()
}

/// What keeps the arm from its way.
async fn heed(action: Act) -> Acted {
    let hindrance = wire::fetch(action.cx(), &store(&action), wire::HINDRANCE).await?;
    action.with_state(|player| player.play.hindered(&hindrance));
    Ok(())
}

async fn aim(action: Act) -> Acted {
    let errand = action.with_state(|player| player.play.aim());
    let errand = errand.ok_or("there is nothing to carry")?;
    wire::keep(action.cx(), &store(&action), wire::ERRAND, &errand).await
}

/// Tells the result, and writes the game.
async fn finish(action: Act) -> Acted {
    let (cx, store) = (action.cx().clone(), store(&action));
    let (played, args, number) = action.with_state(|player| {
        let play = &player.play;
        let played = Played {
            pdn: play.game.record().write(),
            result: play.result(),
        };
        (played, player.args.clone(), play.state.said + 1)
    });
    let words = Words {
        number,
        words: format!("game over, {}", played.result),
        shown: Vec::new(),
        board: None,
    };
    wire::keep(&cx, &store, wire::PLAYED, &played).await?;
    wire::keep(&cx, &store, wire::WORDS, &words).await?;
    if let Some(file) = &args.pdn {
        let path = cx.path(file);
        if let Err(error) = std::fs::write(&path, &played.pdn) {
            action.note(format!(
                "{}: the game cannot be written: {error}",
                path.display()
            ));
        }
    }
    action.note(played.result);
    action.with_state(|player| player.play.state.said = number);
    Ok(())
}
