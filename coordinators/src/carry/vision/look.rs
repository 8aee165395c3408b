//! A look over the table: what is asked of the Service that looks, and what its answer means for the errand.

use std::time::Duration;

use ctos::task::Context;
use serde::{Deserialize, Serialize};
use vss::{
    command::{Outcome as Vss, VisionError},
    frame::Frame,
};
use vss_board::{discs::DiscForm, pose::BoardForm};

use super::{Act, VisionArgs, Where};
use crate::{
    carry::{
        board::Board,
        drawing,
        errand::{ERRAND, Errand},
        eyes::LookOver,
        sight::{self, FOUND, Found, Overview, SIGHT, Sight},
    },
    dom::DomStore,
    outcome::{Failure, Outcome},
};

/// What the Dispatcher asks for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub(super) enum Look {
    /// Where the board is, and what lies on it.
    Find,
    /// Where the thing is that was set down.
    Verify,
    /// Where the thing is that was not.
    Search,
}

impl Look {
    pub(super) fn name(self) -> &'static str {
        match self {
            Self::Find => "find",
            Self::Verify => "verify",
            Self::Search => "search",
        }
    }
}

/// What a look told: where the board is, and why that is in doubt, if it is.
pub(super) type Told = (Board, Option<String>);

/// Looks, and stores what that means for the errand. What was told, if anybody looked.
/// With pictures of the camera on the hand, those of the room are not asked. `notes` are for people.
pub(super) async fn see(
    action: &Act,
    pictures: Vec<Frame>,
    mut notes: Vec<String>,
) -> Result<Option<Told>, Failure> {
    let (args, store, last) =
        action.with_state(|state| (state.args.clone(), state.store.clone(), state.last));
    let look = action.with_state(|state| state.look);
    let cx = action.cx();
    let errand: Errand = store.fetch(cx, ERRAND).await?;
    if args.board == Where::Known {
        known(cx, &store, look, &errand, notes).await?;
        return Ok(None);
    }
    let seen = ask(cx, &args, &errand, pictures).await?;
    let board = seen.board(&errand.board);
    let doubt = args
        .another
        .as_ref()
        .and_then(|another| another.doubt(&seen));
    drawing::show(cx, &store, (&board, &errand.thing), &seen).await;
    let before = store.fetch::<Sight>(cx, SIGHT).await.ok();
    let before = before.filter(|before| before.command == errand.command);
    let before = before.and_then(|before| before.seen);
    match look {
        Look::Find => {
            notes.extend(last.iter().flat_map(|last| sight::moved(last, &board)));
            notes.extend(seen.doubts.iter().cloned());
            let command = errand.command;
            tracing::info!(
                command,
                corners = seen.board.corners,
                things = seen.discs.len(),
                "the board is at x {:.4} m, y {:.4} m, turned by {:.2} degrees; standard deviations {:.1} mm and {:.3} degrees",
                board.at[0],
                board.at[1],
                board.yaw_deg,
                seen.board.sd[3].hypot(seen.board.sd[4]) * 1e3,
                seen.board.sd[2].to_degrees()
            );
            let sight = Sight {
                command,
                board,
                seen: Some(seen),
                notes,
            };
            store.store(cx, SIGHT, &sight).await?;
        }
        Look::Verify | Look::Search => {
            let mut found = match look {
                Look::Search => sight::whereabouts(&errand, before.as_ref(), &seen),
                _ => sight::arrival(&errand, before.as_ref(), &seen),
            };
            found.notes.append(&mut notes);
            found.notes.extend(seen.doubts.iter().cloned());
            store.store(cx, FOUND, &found).await?;
        }
    }
    Ok(Some((board, doubt)))
}

/// Asks for a look over the table, again while nobody is there who may be started again.
async fn ask(
    cx: &Context,
    args: &VisionArgs,
    errand: &Errand,
    pictures: Vec<Frame>,
) -> Result<Overview, Failure> {
    let request = LookOver {
        pictures,
        ..request(errand)?
    };
    let within = Duration::try_from_secs_f64(args.service_within_s).unwrap_or(Duration::MAX);
    let is_lost = |error: &VisionError| error.outcome == Vss::Lost;
    let looked = crate::patiently(cx, within, is_lost, || async {
        let eyes = cx.task(&args.eyes).await?;
        cx.call(&eyes, request.clone()).await?
    });
    Ok(looked.await?)
}

/// What there is to look for.
fn request(errand: &Errand) -> Result<LookOver, Failure> {
    let (board, thing) = (&errand.board, &errand.thing);
    let refused = |text: String| Failure::new(Outcome::Refused, text);
    let dot = board.dot.ok_or_else(|| {
        refused("no camera can tell which way a board without a `dot` lies: give its place".into())
    })?;
    if board.fields != SEEN_FIELDS {
        return Err(refused(format!(
            "cameras know boards of {SEEN_FIELDS} fields a side, and this one has {}",
            board.fields
        )));
    }
    if thing.colour.is_empty() {
        let text = format!(
            "the file of the {} names no [[colour]] to look for",
            thing.name
        );
        return Err(refused(text));
    }
    let colours = thing.colour.iter().map(|colour| colour.rgb);
    let to = board.on_board(&errand.to, thing.height_m);
    Ok(LookOver {
        board: BoardForm {
            field_m: board.field_m,
            dot,
            about_z: board.at[2],
        },
        discs: DiscForm {
            radius_m: 0.5 * thing.width_m,
            height_m: thing.height_m,
            colours: colours.collect(),
        },
        floors: sight::floors(board, thing),
        places: vec![to.xy()],
        pictures: Vec::new(),
    })
}

/// Fields a side of a board that cameras know.
const SEEN_FIELDS: u32 = 8;

/// What is stored when nobody looks.
pub(super) async fn known(
    cx: &Context,
    store: &DomStore,
    look: Look,
    errand: &Errand,
    notes: Vec<String>,
) -> Result<(), Failure> {
    let command = errand.command;
    match look {
        Look::Find => {
            let sight = Sight {
                command,
                board: errand.board,
                seen: None,
                notes,
            };
            store.store(cx, SIGHT, &sight).await?;
        }
        Look::Verify | Look::Search => {
            let found = Found {
                command,
                looked: false,
                arrived: None,
                off_m: None,
                board: errand.board,
                taken: errand.points[0],
                lies: Vec::new(),
                notes,
            };
            store.store(cx, FOUND, &found).await?;
        }
    }
    Ok(())
}
