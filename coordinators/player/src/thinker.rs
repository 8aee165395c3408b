//! Where moves are sought: a task on a processor of its own, so that the player answers meanwhile.

use std::time::Duration;

use checkers::{Game, Limits, Move, Numbering, Position, Variant, search};
use ctos::{
    message::{Command, Message},
    registry::Registry,
    task::{Context, EventHandler, Handled, HandlerError},
};

use crate::state::{Step, replayed, step_of};

/// The handler's name.
pub const HANDLER: &str = "checkers.thinker";

/// As the class `game` has it: in virtual time a search ends after so many positions a second.
const POSITIONS_PER_SECOND: f64 = 4e6;

/// No processor looks at fewer positions a second.
const SLOWEST: f64 = 1e4;

/// How much longer than expected an answer may take.
const MARGIN: Duration = Duration::from_secs(60);

ctos::command! {
    /// Seeks the best move of a game: after so many positions, or so many seconds.
    #[derive(Debug, Clone, PartialEq)]
    pub struct Seek {
        /// The rules.
        pub variant: String,
        /// The first position, FEN.
        pub start: String,
        /// The game so far.
        pub moves: Vec<Step>,
        /// How many positions are looked at, in place of a time.
        pub nodes: Option<u64>,
        /// How long it takes, s.
        pub seconds: f64,
        /// So many half-moves are looked ahead at most.
        pub depth: u32,
    } => Option<Step>, 0x0709, "seek"
}

impl Seek {
    /// Asks the task that seeks. `None` when there is no move.
    ///
    /// # Errors
    /// It does not answer.
    pub async fn ask(self, cx: &Context, thinker: &str) -> Result<Option<Move>, HandlerError> {
        let nodes = self.nodes.map_or(0.0, |nodes| nodes as f64 / SLOWEST);
        let takes = Duration::try_from_secs_f64(nodes.max(self.seconds)).unwrap_or(Duration::MAX);
        let task = cx.task(thinker).await?;
        let asked = cx.call(&task, self).deadline(takes.saturating_add(MARGIN));
        let found = asked
            .await
            .map_err(|error| HandlerError::new(error.reason()))?;
        Ok(found.map(step_of))
    }
}

/// The event handler.
struct Thinker;

/// Registers the handler.
pub(crate) fn register(registry: &mut Registry) {
    registry.handler(HANDLER, &[Seek::INFO], |_| Ok(Thinker));
}

impl EventHandler for Thinker {
    async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
        if message.command() != Seek::CODE {
            return cx.default_processing(message);
        }
        let (seek, reply) = message.open::<Seek>()?;
        let Some(variant) = Variant::named(&seek.variant) else {
            return reply.fail(format!("there are no rules `{}`", seek.variant));
        };
        let start = Position::read(&seek.start, variant, Numbering::of(variant));
        let start = match start {
            Ok(start) => start,
            Err(error) => return reply.fail(format!("the first position is none: {error}")),
        };
        match replayed(Game::from(variant, start), &seek.moves) {
            Ok(game) => {
                let step = best(cx, &game, &seek);
                reply.ok(step.map(|step| (step.from, step.to, step.crowned, step.captured)))
            }
            Err(refusal) => reply.fail(format!("a move of the game is not legal: {refusal}")),
        }
    }
}

fn best(cx: &Context, game: &Game, seek: &Seek) -> Option<Move> {
    let begin = cx.now();
    let time = Duration::try_from_secs_f64(seek.seconds).unwrap_or(Duration::MAX);
    let mut stop = || seek.nodes.is_none() && cx.now().since(begin) >= time;
    let most = (seek.seconds * POSITIONS_PER_SECOND) as u64;
    let limits = Limits {
        nodes: Some(seek.nodes.unwrap_or(most).max(1)),
        depth: seek.depth,
        stop: &mut stop,
    };
    let found = search(game.position(), game.variant(), game.before(), None, limits);
    let moves = game.position().moves(game.variant());
    found.line.first().or(moves.first()).copied()
}
