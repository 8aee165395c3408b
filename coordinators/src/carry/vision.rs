//! The Vision Coordinator of `carry`: the functions of `nets/carry/vision.net`, which find the board and what lies on it before
//! anything moves, and the thing after it.
//!
//! The board's place may also be that of the configuration, always or when no camera sees it. Nothing is verified then.

use std::{rc::Rc, time::Duration};

use ctos::{
    config::{App, TaskConfig},
    diagnostic::{Finding, Findings},
    registry::Registry,
    task::Context,
};
use pnt::library::{Acted, Action, Library};
use serde::{Deserialize, Serialize};
use vss::command::{Outcome as Vss, VisionError};
use vss_board::discs::DiscForm;
use vss_board::pose::BoardForm;

use super::{
    board::Board,
    drawing,
    errand::{ERRAND, Errand, VISION_PROBLEMS},
    eyes::LookOver,
    sight::{self, FOUND, Found, Overview, SIGHT, Sight},
};
use crate::{
    dom::DomStore,
    handler::{self, NetArgs},
    outcome::{Failure, Outcome},
};

/// The handler's name.
pub const HANDLER: &str = "coordinators.carry_vision";

/// Where the board is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
enum Where {
    /// Where cameras see it.
    Seen,
    /// The same; where the configuration has it when none sees it.
    SeenElseKnown,
    /// Where the configuration has it. No camera is asked.
    Known,
}

/// Arguments.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
struct VisionArgs {
    /// How it is known where the board is.
    #[serde(default = "seen")]
    board: Where,
    /// The task that looks.
    #[serde(default = "eyes_task")]
    eyes: String,
    /// The data object manager.
    #[serde(default = "crate::dom_task")]
    dom: String,
    /// How often it looks again when it did not see the board.
    #[serde(default = "retries")]
    retries: u32,
    /// How long a vision system that is gone, and may be started again, is waited for, s.
    #[serde(default = "crate::service_within_s")]
    service_within_s: f64,
}

fn seen() -> Where {
    Where::Seen
}

fn eyes_task() -> String {
    "eyes".to_owned()
}

fn retries() -> u32 {
    2
}

/// What the Dispatcher asks for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
enum Look {
    /// Where the board is, and what lies on it.
    Find,
    /// Where the thing is that was set down.
    Verify,
    /// Where the thing is that was not.
    Search,
}

impl Look {
    fn name(self) -> &'static str {
        match self {
            Self::Find => "find",
            Self::Verify => "verify",
            Self::Search => "search",
        }
    }
}

/// What the functions share.
struct Coordinator {
    args: Rc<VisionArgs>,
    store: DomStore,
    /// What is asked for.
    look: Look,
    tries_left: u32,
    /// Why it was not seen.
    missed: Option<Failure>,
    /// Where the board was seen last.
    last: Option<Board>,
}

/// Registers the handler.
pub(super) fn register(registry: &mut Registry) {
    handler::register::<VisionArgs>(registry);
}

impl NetArgs for VisionArgs {
    const HANDLER: &'static str = HANDLER;
    type State = Coordinator;

    fn dom(&self) -> &str {
        &self.dom
    }

    fn library(self, store: DomStore) -> Library<Coordinator> {
        library(self, store)
    }

    fn check(&self, task: &TaskConfig, app: &App, findings: &mut Findings) {
        crate::check_seconds(task, "service_within_s", self.service_within_s, findings);
        if self.board != Where::Known {
            crate::need_task(task, app, "eyes", &self.eyes, findings);
        }
        if self.retries > MOST_RETRIES {
            let place = task.args.locate("retries");
            let text = format!("`retries` is {}", self.retries);
            findings.push(
                Finding::error("coordinators::carry::eyes", text)
                    .at(place.unwrap_or_else(|| task.place.clone()))
                    .help(format!("give up to {MOST_RETRIES}")),
            );
        }
    }
}

/// Nobody looks more often.
const MOST_RETRIES: u32 = 100;

fn library(args: VisionArgs, store: DomStore) -> Library<Coordinator> {
    let state = Coordinator {
        args: Rc::new(args),
        store,
        look: Look::Find,
        tries_left: 0,
        missed: None,
        last: None,
    };
    let save = |state: &Coordinator| {
        let Coordinator {
            look,
            tries_left,
            missed,
            last,
            ..
        } = state;
        (*look, *tries_left, missed.clone(), *last)
    };
    let mut library = Library::new(state)
        .kept(save, |state, (look, tries_left, missed, last)| {
            state.look = look;
            state.tries_left = tries_left;
            state.missed = missed;
            state.last = last;
        })
        .enabling("tries_left", |state: &Coordinator| state.tries_left > 0)
        .action("look_again", |action: Act| async move {
            let (look, left) = action.with_state(|state| (state.look, state.tries_left));
            looked(action, look, left.saturating_sub(1)).await
        })
        .action("do_without", do_without);
    for look in [Look::Find, Look::Verify, Look::Search] {
        library = library.action(look.name(), move |action: Act| async move {
            let tries = action.with_state(|state| state.args.retries);
            looked(action, look, tries).await
        });
    }
    library
}

type Act = Action<Coordinator>;

/// Looks once, with so many more tries left. What was seen is there for the Dispatcher.
async fn looked(action: Act, look: Look, tries_left: u32) -> Acted {
    let saw = see(&action, look).await;
    action.with_state(|state| {
        state.look = look;
        // Only what was not seen may be seen the next time.
        state.tries_left = match &saw {
            Err(failure) if failure.outcome == Outcome::Unseen => tries_left,
            _ => 0,
        };
        state.missed = saw.as_ref().err().cloned();
        if let Ok(Some(board)) = saw {
            state.last = Some(board);
        }
    });
    saw.map(|_| ()).map_err(Into::into)
}

/// Looks, and stores what that means for the errand. Where the board is seen now, if anybody looked.
async fn see(action: &Act, look: Look) -> Result<Option<Board>, Failure> {
    let (args, store, last) =
        action.with_state(|state| (state.args.clone(), state.store.clone(), state.last));
    let cx = action.cx();
    let errand: Errand = store.fetch(cx, ERRAND).await?;
    if args.board == Where::Known {
        known(cx, &store, look, &errand, Vec::new()).await?;
        return Ok(None);
    }
    let seen = ask(cx, &args, &errand).await?;
    let board = seen.board(&errand.board);
    drawing::show(cx, &store, (&board, &errand.thing), &seen).await;
    let before = store.fetch::<Sight>(cx, SIGHT).await.ok();
    let before = before.filter(|before| before.command == errand.command);
    let before = before.and_then(|before| before.seen);
    match look {
        Look::Find => {
            let mut notes = last.map_or_else(Vec::new, |last| sight::moved(&last, &board));
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
            found.notes.extend(seen.doubts.iter().cloned());
            store.store(cx, FOUND, &found).await?;
        }
    }
    Ok(Some(board))
}

/// Asks for a look over the table, again while nobody is there who may be started again.
async fn ask(cx: &Context, args: &VisionArgs, errand: &Errand) -> Result<Overview, Failure> {
    let request = request(errand)?;
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
    })
}

/// Fields a side of a board that cameras know.
const SEEN_FIELDS: u32 = 8;

/// What is stored when nobody looks.
async fn known(
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

/// Goes on without having seen, where the configuration allows that; else the Dispatcher is told why.
async fn do_without(action: Act) -> Acted {
    let (args, store) = action.with_state(|state| (state.args.clone(), state.store.clone()));
    let (look, missed) = action.with_state(|state| (state.look, state.missed.clone()));
    let missed = missed.unwrap_or_else(|| Failure::new(Outcome::Fault, "nobody looked"));
    let cx = action.cx();
    if args.board == Where::SeenElseKnown && look == Look::Find {
        tracing::warn!(reason = %missed, "the board is not seen: it is where the configuration has it");
        let without = async {
            let errand: Errand = store.fetch(cx, ERRAND).await?;
            let note = format!(
                "nobody saw the board, which is taken to be where it is configured: {}",
                missed.reason
            );
            known(cx, &store, look, &errand, vec![note]).await
        };
        let without: Result<(), Failure> = without.await;
        return without.map_err(Into::into);
    }
    super::errand::note_problem(cx, &store, VISION_PROBLEMS, look.name(), &missed).await;
    Err(missed.into())
}
