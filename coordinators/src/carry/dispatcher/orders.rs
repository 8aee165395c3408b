//! Commands of the tape: what they ask for, or why they are refused.

use ctos::task::{Context, HandlerError};
use pnt::library::Acted;

use super::{
    state::{Act, CarryArgs, Ends, parts},
    wishes::Wishes,
};
use crate::{
    carry::{
        board::{Board, Field},
        errand::{ERRAND, Errand},
        thing::Thing,
    },
    dispatching::{self, tagged},
    outcome::{Failure, Outcome},
};

/// Reads `FROM TO`, two fields of the board, and makes the errand of them.
pub(super) async fn begin(action: Act) -> Acted {
    let (cx, args, store) = parts(&action);
    let command = action.with_state(|state| state.command.wrapping_add(1));
    let (tag, words) = tagged(action.arguments());
    let mut wishes = Wishes::default();
    let began = match begun(command, &words, &cx, &args) {
        Ok((errand, wanted)) => {
            wishes = wanted;
            store.store(&cx, ERRAND, &errand).await
        }
        Err(error) => Err(error),
    };
    begin_anew(&action, command, tag, &began);
    action.with_state(|state| state.wishes = wishes);
    began
}

/// What is known of the command before is over. What an action changes, it changes at its end: a process that dies before that
/// begins it again.
fn begin_anew(action: &Act, command: u32, tag: String, began: &Acted) {
    let refused = |error: &HandlerError| Failure::new(Outcome::Refused, error);
    let hindrances = began.as_ref().err().map(refused).into_iter().collect();
    action.with_state(|state| {
        state.command = command;
        state.ends = Ends::default();
        (state.tried, state.again, state.fetches, state.asks) = (0, false, false, false);
        (state.tag, state.hindrances) = (tag, hindrances);
        state.aside.begin_anew();
    });
}

fn begun(
    command: u32,
    arguments: &[String],
    cx: &Context,
    args: &CarryArgs,
) -> Result<(Errand, Wishes), HandlerError> {
    let ([from, to], wishes) = order(arguments, &args.board)?;
    let source = cx.app().read(&args.thing);
    let source = source.map_err(|finding| HandlerError::new(finding.to_string()))?;
    let thing = Thing::parse(&source).map_err(|found| HandlerError::new(found.to_string()))?;
    let errand = Errand {
        command,
        from,
        to,
        board: args.board,
        points: [from, to].map(|field| args.board.point(&field, thing.height_m)),
        yaw: args.board.yaw(),
        clearance_m: args.clearance_m,
        open_m: thing.grasp.open_m,
        speed: wishes.speed,
        thing,
    };
    Ok((errand, wishes))
}

/// The two fields that a command names, and what it wants besides.
fn order(arguments: &[String], board: &Board) -> Result<([Field; 2], Wishes), HandlerError> {
    let mut wishes = Wishes::default();
    let mut ends = Vec::new();
    for word in arguments {
        let Some((key, value)) = word.split_once('=') else {
            ends.push(word);
            continue;
        };
        let taken = wishes.take(key, value);
        taken.map_err(|help| HandlerError::new(format!("`{word}`: {help}")))?;
    }
    let [from, to] = ends.as_slice() else {
        return Err(HandlerError::new(format!(
            "`carry` takes FROM and TO, such as 3,4,0 4,5,0, and was given {} fields",
            ends.len()
        )));
    };
    let field = |text: &str| -> Result<Field, HandlerError> {
        let field: Field = text.parse()?;
        if board.has(&field) {
            return Ok(field);
        }
        Err(HandlerError::new(format!(
            "`{text}` is not on the board: columns and rows are from 1 to {}, heights from 0",
            board.fields
        )))
    };
    Ok(([field(from)?, field(to)?], wishes))
}

/// Reads `FIELD`, which shall be pointed at. As an errand its ends are the same.
pub(super) async fn begin_point(action: Act) -> Acted {
    let (cx, args, store) = parts(&action);
    let command = action.with_state(|state| state.command.wrapping_add(1));
    let (tag, words) = tagged(action.arguments());
    let began = match words.as_slice() {
        [field] => {
            let ends = [field.clone(), field.clone()];
            match begun(command, &ends, &cx, &args) {
                Ok((errand, _)) => store.store(&cx, ERRAND, &errand).await,
                Err(error) => Err(error),
            }
        }
        other => Err(HandlerError::new(format!(
            "`point` takes a field, such as 3,4,0, and was given {}",
            other.len()
        ))),
    };
    begin_anew(&action, command, tag, &began);
    began
}

/// Says why a hand that is full takes nothing.
pub(super) async fn refuse(action: Act) -> Acted {
    let text =
        "the hand still holds what it could not put down: `put_back` puts it where it was taken";
    action.note(text);
    let (tag, _) = tagged(action.arguments());
    let (cx, _, store) = parts(&action);
    let refused = Failure::new(Outcome::Refused, text);
    dispatching::tell(&cx, &store, tag, vec![refused]).await;
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::carry::dispatcher::wishes::Lost;

    const BOARD: Board = Board {
        at: [0.5, 0.0, 0.42],
        yaw_deg: 0.0,
        field_m: 0.06,
        fields: 8,
        thick_m: 0.02,
        dot: None,
    };

    #[test]
    fn a_command_names_two_fields_of_the_board_or_is_refused_in_words() {
        let ends = |words: &[&str]| {
            let words: Vec<String> = words.iter().map(ToString::to_string).collect();
            super::order(&words, &BOARD).map_err(|error| error.to_string())
        };
        let words = [
            "3,4,0",
            "4,5",
            "speed=0.2",
            "lost=fetch",
            "speaker=fork.sound@speaker",
        ];
        let ([from, to], wishes) = ends(&words).unwrap();
        assert_eq!((wishes.speed, wishes.lost), (Some(0.2), Some(Lost::Fetch)));
        assert_eq!((from.column, from.row, to.row), (3.0, 4.0, 5.0));
        for (words, text) in [
            (&["3,4"][..], "FROM and TO"),
            (&["3,4", "4,5", "5,6"], "3 fields"),
            (&["3,4", "4,5", "speed=2"], "fraction of full speed"),
            (&["3,4", "4,5", "lost=find"], "`tell`, `fetch` or `ask`"),
            (&["3,4", "4,5", "tries=0"], "from 1 to"),
            (&["3,4", "4,5", "show=yes"], "`on` or `off`"),
            (&["3,4", "4,5", "speaker=sound"], "at which daemon"),
            (&["3,4", "4,5", "sped=0.2"], "nobody knows this"),
            (&["3,4", "x"], "is no field"),
            (&["3,4", "9,5"], "not on the board"),
        ] {
            let error = ends(words).unwrap_err();
            assert!(error.contains(text), "{words:?}: {error}");
        }
    }
}
