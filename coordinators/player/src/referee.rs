//! The referee of a dry game: replays the game that the player has written, and holds it against what stood on the table. It runs when
//! everything is done; nothing that plays may ask it.

use checkers::{Game, Position, Status, Variant, pdn};
use coordinators::{dom::DomStore, referee::Judge};
use ctos::{
    message::{Command, Message},
    registry::Registry,
    system::AppResult,
    task::{Context, EventHandler, Handled, HandlerError},
};
use serde::{Deserialize, Serialize};

use crate::wire::{self, Looks, PLAYED, Played, TrueTable, Truth};

/// The handler's name.
pub const HANDLER: &str = "checkers.referee";

/// What is said of each loss.
pub(crate) const LOST: &str = "I have lost";
pub(crate) const A_DISC: &str = "a disc";
pub(crate) const TWO_DISCS: &str = "two discs";

/// Discs of each colour in the room.
pub(crate) const DISCS: u32 = 24;

/// One look in so many may be read wrongly.
const WRONG_ONE_IN: u32 = 1000;

/// Arguments.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
struct RefereeArgs {
    /// The room.
    #[serde(default = "crate::coordinator::room")]
    room: String,
    /// The data object manager.
    #[serde(default = "crate::coordinator::dom")]
    dom: String,
}

/// The verdict.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Verdict {
    /// Whether all of it is true.
    pub ok: bool,
    /// The result in words.
    pub result: String,
    /// What is not true.
    pub wrong: Vec<String>,
    /// Half-moves.
    pub plies: usize,
    /// The game.
    pub pdn: String,
    /// Of the app's time.
    pub seconds: f64,
    /// The person's errors.
    pub errors: Vec<String>,
    /// Discs that slipped out of the hand.
    pub slipped: u32,
    /// How often the board was moved.
    pub moved: u32,
    /// Looks of cameras: read right, in part unsure, and wrong.
    pub looks: Looks,
    /// How often somebody dimmed the lamp, and turned it up.
    pub lit: [u32; 2],
    /// How long a carry of a real arm took in the middle of all, and how many there were, s.
    pub carry: Option<(f64, usize)>,
    /// What was said.
    pub said: Vec<String>,
}

struct Referee {
    args: RefereeArgs,
}

/// Registers the handler.
pub(crate) fn register(registry: &mut Registry) {
    registry
        .handler(HANDLER, &[Judge::INFO], |cx| {
            Ok(Referee { args: cx.args()? })
        })
        .checked_args::<RefereeArgs>(|args, task, app, findings| {
            coordinators::need_task(task, app, "room", &args.room, findings);
            coordinators::need_task(task, app, "dom", &args.dom, findings);
        });
}

impl EventHandler for Referee {
    async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
        match message.command() {
            Judge::CODE => {
                let (request, reply) = message.open::<Judge>()?;
                reply.ok(self.judge(cx, &request).await?)
            }
            _ => cx.default_processing(message),
        }
    }
}

impl Referee {
    async fn judge(&self, cx: &Context, judge: &Judge) -> Result<AppResult, HandlerError> {
        let store = DomStore::new(&self.args.dom);
        let played: Played = wire::fetch(cx, &store, PLAYED).await?;
        let truth = wire::ask(cx, &self.args.room, Truth {}).await?;
        let verdict = verdict(&played, &truth, judge.seconds);
        let mut text = verdict.result.clone();
        text += &format!(
            ", after {} half-moves and {:.0} s",
            verdict.plies, verdict.seconds
        );
        text += &format!(
            "\n{} errors of the person, {} discs lost and told, the board moved {} times",
            verdict.errors.len(),
            verdict.slipped,
            verdict.moved
        );
        let Looks {
            right,
            unsure,
            wrong,
        } = verdict.looks;
        if right + unsure + wrong > 0 {
            text += &format!(
                "\nof looks at a board at rest {right} were right, {unsure} unsure in part, {wrong} wrong"
            );
        }
        if let Some((median_s, carries)) = verdict.carry {
            text += &format!("\na carry took {median_s:.1} s, the median of {carries}");
        }
        for wrong in &verdict.wrong {
            text += &format!("\nnot true: {wrong}");
        }
        text += &format!("\n\n{}", verdict.pdn.trim_end());
        Ok(AppResult {
            ok: verdict.ok,
            text,
            json: serde_json::to_string(&verdict)?,
        })
    }
}

/// Holds a game against what stood on the table.
#[must_use]
pub fn verdict(played: &Played, truth: &TrueTable, seconds: f64) -> Verdict {
    let mut wrong = Vec::new();
    let mut plies = 0;
    // The tag says which rules.
    match pdn::read(&played.pdn, Variant::Brazilian)
        .into_iter()
        .next()
    {
        Some(Ok(record)) => {
            plies = record.moves.len();
            wrong.extend(replay(&record, played));
            wrong.extend(stood(&record, truth));
        }
        Some(Err(error)) => wrong.push(format!("the game cannot be read: {error}")),
        None => wrong.push("there is no game".to_owned()),
    }
    if truth.discs != [DISCS; 2] {
        wrong.push(format!("there are {:?} discs", truth.discs));
    }
    let told = |what: &str| {
        let said = format!("{LOST} {what}");
        let heard = truth.heard.iter();
        heard
            .map(|words| words.matches(&said).count())
            .sum::<usize>()
    };
    let told = told(A_DISC) + 2 * told(TWO_DISCS);
    if told < usize::try_from(truth.slipped).unwrap_or(usize::MAX) {
        wrong.push(format!(
            "{} discs were lost, and people were told of {told}",
            truth.slipped
        ));
    }
    let Looks {
        right,
        unsure,
        wrong: misread,
    } = truth.looks;
    if misread * WRONG_ONE_IN > right + unsure + misread {
        let all = right + unsure + misread;
        wrong.push(format!(
            "of {all} looks {misread} were read surely and wrongly"
        ));
    }
    if truth.met > 0 {
        wrong.push("arm and hand were over the board at the same time".to_owned());
    }
    let pressed = truth.pressed.iter();
    wrong.extend(pressed.map(|(link, times)| {
        format!("something pressed on `{link}` of the arm, seen {times} times")
    }));
    Verdict {
        ok: wrong.is_empty(),
        result: played.result.clone(),
        wrong,
        plies,
        pdn: played.pdn.clone(),
        seconds,
        errors: truth.errors.clone(),
        slipped: truth.slipped,
        moved: truth.moved,
        looks: truth.looks,
        lit: truth.lit,
        carry: median_s(&truth.carried_ms),
        said: truth.heard.clone(),
    }
}

/// The median of times, and how many there are.
fn median_s(times_ms: &[u32]) -> Option<(f64, usize)> {
    let mut times = times_ms.to_vec();
    times.sort_unstable();
    let median = times.get(times.len() / 2)?;
    Some((f64::from(*median) / 1e3, times.len()))
}

/// Plays the game once more.
fn replay(record: &pdn::Record, played: &Played) -> Option<String> {
    let mut game = Game::from(record.variant, record.start);
    for (ply, step) in (1..).zip(&record.moves) {
        if let Err(refusal) = game.make(*step) {
            return Some(format!("half-move {ply}: {refusal}"));
        }
    }
    let agreed = played.result.contains("gave up") || played.result.contains("agreed");
    let status = game.status();
    if (status == Status::Playing) != agreed {
        return Some(format!("`{}`, but it is {status:?}", played.result));
    }
    let expected = match status {
        Status::Won(side, _) => format!("{} has won", side.name()),
        Status::Drawn(_) => "drawn".to_owned(),
        Status::Playing => return None,
    };
    let is_said = played.result.starts_with(&expected) && record.result == game.record().result;
    (!is_said).then(|| format!("`{}`, but {expected}", played.result))
}

/// Every position of the game stood on the table, in its order, and the last one stands there now.
fn stood(record: &pdn::Record, truth: &TrueTable) -> Option<String> {
    let mut history = truth.history.iter();
    let board = |position: &Position| [position.white, position.black, position.kings];
    let mut position = record.start;
    for (ply, step) in (1..).zip(&record.moves) {
        position = position.after(*step);
        let wanted = board(&position);
        if !history.any(|stood| *stood == wanted) {
            return Some(format!(
                "what half-move {ply} led to never stood on the table"
            ));
        }
    }
    let last = truth.history.last() == Some(&board(&position));
    (!last).then(|| "the last position does not stand on the table".to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_game_in_which_something_but_the_jaws_pressed_on_the_arm_is_not_true() {
        let mut game = Game::new(Variant::Brazilian);
        game.resign(checkers::Colour::White);
        let played = Played {
            pdn: game.record().write(),
            result: "Black has won: White gave up".to_owned(),
        };
        let first = game.position();
        let mut truth = TrueTable {
            history: vec![[first.white, first.black, first.kings]],
            discs: [DISCS; 2],
            ..TrueTable::default()
        };
        assert_eq!(verdict(&played, &truth, 1.0).wrong, [""; 0]);
        truth.pressed.insert("forearm".to_owned(), 2);
        let wrong = verdict(&played, &truth, 1.0).wrong;
        assert!(
            wrong.len() == 1 && wrong[0].contains("`forearm`"),
            "{wrong:?}"
        );
    }
}
