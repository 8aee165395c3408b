//! What follows from what was seen and felt: where the ends of an errand are, whether another try may do, and what became of the thing.

use ctos::task::HandlerError;
use nalgebra::Vector3;
use pnt::library::Acted;

use super::{
    aside,
    state::{Act, Ends, parts},
    telling::{hinder, note_ways, problems, say, say_lost, tell_why},
    wishes::Lost,
};
use crate::{
    carry::{
        board::Field,
        errand::{ERRAND, Errand, Problem},
        laser::{SHOWN, Shown},
        people::{ANSWERED, Answer, Answered},
        sight::{self, FOUND, Found, Hindrance, SIGHT, Sight},
        speaker,
    },
    outcome::Outcome,
};

/// Puts the errand's ends where they were seen, or finds what is in its way.
pub(super) async fn aim(action: Act) -> Acted {
    let (cx, _, store) = parts(&action);
    action.with_state(|state| state.ends = Ends::default());
    let errand: Errand = store.fetch(&cx, ERRAND).await?;
    let sight: Sight = store.fetch(&cx, SIGHT).await?;
    if sight.command != errand.command {
        return Err(HandlerError::new("nobody looked for this errand"));
    }
    for note in &sight.notes {
        action.note(note);
    }
    let mut ends = Ends::default();
    let may_push = aside::may_push(&action, &errand, &sight).await;
    match sight::aimed(&errand, &sight) {
        Ok(aimed) => {
            if aimed.open_m < errand.open_m {
                let open_mm = aimed.open_m * 1e3;
                action.note(format!(
                    "fingers open {open_mm:.0} mm, for what stands beside"
                ));
            }
            return store.store(&cx, ERRAND, &aimed).await;
        }
        Err(Hindrance::NothingAtFrom(text)) => {
            if action.with_state(|state| state.tried > 0 || state.aside.has_pushed()) {
                // It was there before it was touched.
                hinder(&action, Outcome::Absent, &text);
                return Err(HandlerError::new(text));
            }
            ends.from_is_empty = true;
            ends.said = true;
            hinder(&action, Outcome::Absent, &text);
            action.note(text);
            tell_why(&action).await;
            let field = speaker::field(&errand.from);
            say(&action, &format!("nothing at {field}"));
        }
        Err(Hindrance::Occupied(text)) => {
            ends.to_is_taken = true;
            ends.said = true;
            hinder(&action, Outcome::Occupied, &text);
            action.note(text);
            tell_why(&action).await;
            say(
                &action,
                &format!("no room at {}", speaker::field(&errand.to)),
            );
        }
        Err(Hindrance::Stuck(text)) if may_push => {
            action.note(format!("{text}; it is pushed aside"));
            ends.is_crowded = true;
        }
        Err(Hindrance::Stuck(text)) => {
            let field = speaker::field(&errand.from);
            say(&action, &format!("stuck together at {field}"));
            action.with_state(|state| state.ends.said = true);
            hinder(&action, Outcome::Stuck, &text);
            return Err(HandlerError::new(text));
        }
        Err(Hindrance::Other(text)) => {
            hinder(&action, Outcome::Refused, &text);
            return Err(HandlerError::new(text));
        }
    }
    action.with_state(|state| state.ends = ends);
    Ok(())
}

/// Whether something was in the hand before the errand, or nobody can tell.
pub(super) async fn weigh_hand(action: Act) -> Acted {
    let problems = problems(&action).await;
    let is_full = |problem: &Problem| {
        problem.request == "feel" && problem.failure.outcome == Outcome::Occupied
    };
    action.with_state(|state| state.ends.hand_is_full = problems.iter().any(is_full));
    Ok(())
}

/// Whether another turn of the gripper may grasp the thing: something was in the way down, or the jaws found no width that fits.
pub(super) async fn weigh_trouble(action: Act) -> Acted {
    let latest = problems(&action).await.pop();
    let may_do = latest.is_some_and(|problem| {
        let outcome = problem.failure.outcome;
        match problem.request.as_str() {
            "descend" => outcome == Outcome::Guard,
            "grasp" => outcome == Outcome::Absent,
            _ => false,
        }
    });
    action.with_state(|state| {
        state.tried += 1;
        let tries = state.wishes.tries.unwrap_or(state.args.tries);
        state.again = may_do && state.tried < tries;
    });
    Ok(())
}

/// What was found out about the thing after the errand.
async fn found(action: &Act) -> Result<Found, HandlerError> {
    let (cx, _, store) = parts(action);
    let command = action.with_state(|state| state.command);
    let found: Found = store.fetch(&cx, FOUND).await?;
    if found.command == command {
        return Ok(found);
    }
    Err(HandlerError::new("nobody looked after this errand"))
}

/// Notes where the thing stands that was set down.
pub(super) async fn judge(action: Act) -> Acted {
    let found = found(&action).await?;
    for note in &found.notes {
        action.note(note);
    }
    let is_elsewhere = found.arrived == Some(false);
    if !is_elsewhere {
        note_ways(&action).await;
    }
    let mut is_shown = false;
    if is_elsewhere {
        say_lost(&action, &found).await;
        is_shown = prepare_to_show(&action, &found).await?;
        hinder(&action, Outcome::Unseen, &found.notes.join("; "));
    }
    action.with_state(|state| {
        state.ends.is_elsewhere = is_elsewhere;
        state.ends.is_shown = is_shown;
    });
    Ok(())
}

/// Says where the pointer in the hand shall point: at the middle of the upper side of a thing that was lost, when it may be only
/// one. Whether there is something to point at.
async fn prepare_to_show(action: &Act, found: &Found) -> Result<bool, HandlerError> {
    let (cx, _, store) = parts(action);
    let errand: Errand = store.fetch(&cx, ERRAND).await?;
    let there = sight::at_found(&errand, found);
    let is_shown = action.with_state(|state| state.wishes.show.unwrap_or(state.args.show));
    let Some(there) = there.filter(|_| is_shown) else {
        return Ok(false);
    };
    let [at, _] = there.points;
    let shown = Shown {
        command: errand.command,
        at: at + Vector3::z() * errand.thing.height_m,
    };
    store.store(&cx, SHOWN, &shown).await?;
    Ok(true)
}

/// Puts the field where the board was seen.
pub(super) async fn aim_point(action: Act) -> Acted {
    let (cx, _, store) = parts(&action);
    let errand: Errand = store.fetch(&cx, ERRAND).await?;
    let sight: Sight = store.fetch(&cx, SIGHT).await?;
    if sight.command != errand.command {
        return Err(HandlerError::new("nobody looked for this command"));
    }
    for note in &sight.notes {
        action.note(note);
    }
    let shown = Shown {
        command: errand.command,
        at: sight.board.point(&errand.to, errand.thing.height_m),
    };
    store.store(&cx, SHOWN, &shown).await
}

/// Notes where the thing is that was not carried. One that was lost is fetched from there, where the configuration says so, or a
/// person.
pub(super) async fn tell_found(action: Act) -> Acted {
    action.with_state(|state| {
        (state.again, state.asks) = (false, false);
        state.ends.is_shown = false;
    });
    let found = found(&action).await?;
    for note in &found.notes {
        action.note(note);
    }
    say_lost(&action, &found).await;
    let (has_fetched, lost) = action.with_state(|state| {
        let lost = state.wishes.lost.unwrap_or(state.args.lost);
        (state.fetches, lost)
    });
    if lost == Lost::Fetch && !has_fetched && fetch(&action, &found).await? {
        return Ok(());
    }
    let is_shown = prepare_to_show(&action, &found).await?;
    let (cx, _, store) = parts(&action);
    let errand: Errand = store.fetch(&cx, ERRAND).await?;
    let may_be_fetched = !has_fetched && sight::at_found(&errand, &found).is_some();
    action.with_state(|state| {
        state.ends.is_shown = is_shown;
        state.asks = lost == Lost::Ask && may_be_fetched;
    });
    Ok(())
}

/// Makes an errand of fetching what was lost from where it was found. Whether it may be only one thing.
async fn fetch(action: &Act, found: &Found) -> Result<bool, HandlerError> {
    let (cx, _, store) = parts(action);
    let errand: Errand = store.fetch(&cx, ERRAND).await?;
    let Some(there) = sight::at_found(&errand, found) else {
        return Ok(false);
    };
    let field = speaker::field(&there.from);
    store.store(&cx, ERRAND, &there).await?;
    let Field { column, row, .. } = there.from;
    action.note(format!("it is fetched from {column:.2},{row:.2}"));
    say(action, &format!("fetching from {field}"));
    action.with_state(|state| (state.again, state.fetches) = (true, true));
    Ok(true)
}

/// What people answered: what is lost is fetched, or left.
pub(super) async fn hear(action: Act) -> Acted {
    let (cx, _, store) = parts(&action);
    let command = action.with_state(|state| state.command);
    let answered: Answered = store.fetch(&cx, ANSWERED).await?;
    if answered.command != command {
        return Err(HandlerError::new("nobody answered for this errand"));
    }
    match answered.answer {
        Answer::Fetch => {
            action.note("people said that it is fetched");
            let found = found(&action).await?;
            fetch(&action, &found).await?;
        }
        Answer::Leave => action.note("people said that it is left"),
    }
    Ok(())
}
