//! What is told of an errand: to who sent the command, in words and by types, and to people in the room.

use pnt::library::Acted;

use super::state::{Act, parts};
use crate::{
    carry::{
        board::Field,
        errand::{
            ERRAND, Errand, HAND_PROBLEMS, LASER_PROBLEMS, PEOPLE_PROBLEMS, Problem, Problems,
            ROBOT_PROBLEMS, VISION_PROBLEMS, WAY, WAYS, Way, Ways,
        },
        sight::Found,
        speaker,
    },
    dispatching,
    outcome::{Failure, Outcome},
};

/// Keeps what was in the way, for whoever sent the command. An action that is begun again keeps it once.
pub(super) fn hinder(action: &Act, outcome: Outcome, reason: &str) {
    let failure = Failure::new(outcome, reason);
    action.with_state(|state| {
        if !state.hindrances.contains(&failure) {
            state.hindrances.push(failure);
        }
    });
}

/// Tells whoever sent the command why it was not done, by types: what was in the way, and what the Coordinators could not do.
pub(super) async fn tell_why(action: &Act) {
    let (tag, mut failures) =
        action.with_state(|state| (state.tag.clone(), state.hindrances.clone()));
    let problems = problems(action).await.into_iter();
    failures.extend(problems.map(|problem| problem.failure));
    let (cx, _, store) = parts(action);
    dispatching::tell(&cx, &store, tag, failures).await;
}

/// Notes that people were shown where it lies.
pub(super) async fn tell_shown(action: Act) -> Acted {
    action.note("the pointer in the hand has shown where it lies");
    Ok(())
}

/// Notes why nobody saw where the thing stands.
pub(super) async fn tell_unverified(action: Act) -> Acted {
    let (cx, _, store) = parts(&action);
    let command = action.with_state(|state| state.command);
    let problems: Problems = store.fetch(&cx, VISION_PROBLEMS).await?;
    if let Some(problem) = problems.problems.last()
        && problems.command == command
    {
        let reason = &problem.failure.reason;
        action.note(format!("it was set down, and nobody sees it: {reason}"));
    }
    note_ways(&action).await;
    Ok(())
}

/// Notes, for the answer, what was not done and why, in the order of time.
pub(super) async fn report(action: Act) -> Acted {
    note_problems(&action).await;
    tell_why(&action).await;
    say_failed(&action, "not carried").await;
    Ok(())
}

/// The same of an errand that ended with the thing in the hand.
pub(super) async fn report_held(action: Act) -> Acted {
    note_problems(&action).await;
    tell_why(&action).await;
    say_failed(&action, "still in the hand").await;
    Ok(())
}

/// Notes why a field was not pointed at.
pub(super) async fn report_point(action: Act) -> Acted {
    note_problems(&action).await;
    tell_why(&action).await;
    Ok(())
}

async fn note_problems(action: &Act) {
    for Problem {
        request, failure, ..
    } in problems(action).await
    {
        // A stop that somebody ended is no reason.
        let Failure { outcome, reason } = failure;
        match outcome {
            Outcome::Stopped => action.note(format!("{request} was stopped: {reason}")),
            _ => action.note(format!("{request}: {reason}")),
        }
    }
    note_ways(action).await;
}

/// What the Coordinators could not do, in the order of time.
pub(super) async fn problems(action: &Act) -> Vec<Problem> {
    let (cx, _, store) = parts(action);
    let command = action.with_state(|state| state.command);
    let mut all = Vec::new();
    for object in [
        ROBOT_PROBLEMS,
        HAND_PROBLEMS,
        VISION_PROBLEMS,
        LASER_PROBLEMS,
        PEOPLE_PROBLEMS,
    ] {
        if let Ok(found) = store.fetch::<Problems>(&cx, object).await
            && found.command == command
        {
            all.extend(found.problems);
        }
    }
    all.sort_by_key(|problem| problem.at);
    all
}

/// Notes which ways the arm has gone, and what is believed of them by now.
pub(super) async fn note_ways(action: &Act) {
    let (cx, _, store) = parts(action);
    let command = action.with_state(|state| state.command);
    if let Ok(way) = store.fetch::<Way>(&cx, WAY).await
        && way.command == command
        && let Some([x, y]) = way.shift
    {
        let off_mm = 1e3 * x.hypot(y);
        action.note(format!(
            "the camera on the hand saw it {off_mm:.1} mm beside"
        ));
    }
    if let Ok(ways) = store.fetch::<Ways>(&cx, WAYS).await
        && ways.command == command
    {
        for line in ways.lines {
            action.note(line);
        }
    }
}

pub(super) fn say(action: &Act, words: &str) {
    let speaker = action.with_state(|state| state.speaker());
    speaker::say(action.cx(), speaker.as_ref(), words);
}

/// Tells people in the room where the thing lies that is not where it should be.
pub(super) async fn say_lost(action: &Act, found: &Found) {
    let (cx, _, store) = parts(action);
    let Ok(errand) = store.fetch::<Errand>(&cx, ERRAND).await else {
        return;
    };
    if !found.looked {
        return;
    }
    let problems = problems(action).await;
    let is_stuck = problems
        .iter()
        .any(|problem| problem.failure.outcome == Outcome::Stuck);
    let words = match is_stuck {
        true => format!("stuck together at {}", speaker::field(&errand.from)),
        false => lost(&errand, found),
    };
    say(action, &words);
    action.with_state(|state| state.ends.said = true);
}

fn lost(errand: &Errand, found: &Found) -> String {
    let (thing, board) = (&errand.thing, &found.board);
    let Some(at) = found.lies.first() else {
        return format!("{} lost", thing.name);
    };
    let lies = board.field(at, thing.height_m);
    let name = speaker::field(&lies);
    if !board.has(&Field {
        height: 0.0,
        ..lies
    }) || at.z < -1e-3
    {
        format!("{} lost beside the board", thing.name)
    } else if name == speaker::field(&errand.from) {
        format!("{} still at {name}", thing.name)
    } else {
        format!("{} lost at {name}", thing.name)
    }
}

/// Tells people in the room, unless they know already.
async fn say_failed(action: &Act, words: &str) {
    let (cx, _, store) = parts(action);
    let (command, said) = action.with_state(|state| (state.command, state.ends.said));
    if let Ok(errand) = store.fetch::<Errand>(&cx, ERRAND).await
        && errand.command == command
        && !said
    {
        say(action, &format!("{} {words}", errand.thing.name));
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::{Point3, Vector3};

    use super::*;
    use crate::carry::tests::errand;

    #[test]
    fn people_are_told_where_a_thing_lies_by_the_nearest_field_or_that_it_is_beside_the_board() {
        let errand = errand();
        let found = |lies: &[Point3<f64>]| Found {
            command: 1,
            looked: true,
            arrived: None,
            off_m: None,
            board: errand.board,
            taken: errand.points[0],
            lies: lies.to_vec(),
            notes: Vec::new(),
        };
        let on = |field: &str| errand.board.on_board(&field.parse().unwrap(), 0.01);
        for (lies, said) in [
            (vec![], "disc lost"),
            (vec![on("4.3,4.6,0")], "disc lost at D 5"),
            (vec![on("3.1,4,0")], "disc still at C 4"),
            (vec![on("9,4,0")], "disc lost beside the board"),
            (
                vec![on("4,5,0") - Vector3::z() * 0.02],
                "disc lost beside the board",
            ),
        ] {
            assert_eq!(lost(&errand, &found(&lies)), said);
        }
    }
}
