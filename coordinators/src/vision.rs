//! The Vision Coordinator: the functions of `vision.net` (CIRSSE report 108, section 7, figure 11).

use std::{rc::Rc, time::Duration};

use ctos::{
    config::{App, TaskConfig},
    diagnostic::{Finding, Findings},
    registry::Registry,
    task::{Context, HandlerError},
};
use futures_util::future::join_all;
use pnt::library::{Acted, Action, Library};
use serde::Deserialize;
use vss::command::{Outcome as Vss, SpotFind, SpotReport, VisionError};

use crate::{
    dom::DomStore,
    handler::{self, NetArgs},
    objects::{DESTINATION, Destination, SPOTS, Spots},
    outcome::Failure,
};

/// The handler's name.
pub const HANDLER: &str = "coordinators.vision";

/// Arguments.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
struct VisionArgs {
    /// The cameras that look for the spot.
    cameras: Vec<String>,
    /// The Vision Services Manager.
    #[serde(default = "vsm_task")]
    vsm: String,
    /// The data object manager.
    #[serde(default = "crate::dom_task")]
    dom: String,
    /// How often a camera that missed the spot looks again.
    #[serde(default = "retries")]
    retries: u32,
    /// How long a vision system that is gone, and may be started again, is waited for, s.
    #[serde(default = "crate::service_within_s")]
    service_within_s: f64,
}

pub(crate) fn vsm_task() -> String {
    "vsm".to_owned()
}

fn retries() -> u32 {
    2
}

/// What the functions share.
struct Vision {
    args: Rc<VisionArgs>,
    store: DomStore,
    spots: Spots,
    tries_left: u32,
}

/// Registers the handler.
pub(crate) fn register(registry: &mut Registry) {
    handler::register::<VisionArgs>(registry);
}

impl NetArgs for VisionArgs {
    const HANDLER: &'static str = HANDLER;
    type State = Vision;

    fn dom(&self) -> &str {
        &self.dom
    }

    fn library(self, store: DomStore) -> Library<Vision> {
        library(self, store)
    }

    fn check(&self, task: &TaskConfig, app: &App, findings: &mut Findings) {
        if self.cameras.is_empty() {
            let place = task.args.locate("cameras");
            findings.push(
                Finding::error("coordinators::vision::cameras", "no camera is named")
                    .at(place.unwrap_or_else(|| task.place.clone()))
                    .help("name at least one camera of [vss.cameras]"),
            );
        }
        check_cameras(task, app, &self.cameras, findings);
        crate::check_seconds(task, "service_within_s", self.service_within_s, findings);
        crate::need_task(task, app, "vsm", &self.vsm, findings);
    }
}

/// Where the app has a vision system, each camera named must be one of its own.
fn check_cameras(task: &TaskConfig, app: &App, cameras: &[String], findings: &mut Findings) {
    let Some(known) = app.root().get("vss.cameras") else {
        return;
    };
    for (index, camera) in cameras.iter().enumerate() {
        if known.entry(camera).is_none() {
            let place = task.args.locate(&format!("cameras.{index}"));
            let names = known.entries().iter().map(|entry| entry.key.as_str());
            findings.push(
                Finding::error(
                    "coordinators::vision::unknown_camera",
                    format!("the vision system has no camera `{camera}`"),
                )
                .at(place.unwrap_or_else(|| task.place.clone()))
                .suggest(camera, names),
            );
        }
    }
}

fn library(args: VisionArgs, store: DomStore) -> Library<Vision> {
    let state = Vision {
        args: Rc::new(args),
        store,
        spots: Spots::default(),
        tries_left: 0,
    };
    let save = |state: &Vision| (state.spots.clone(), state.tries_left);
    Library::new(state)
        .kept(save, |state, (spots, tries_left)| {
            (state.spots, state.tries_left) = (spots, tries_left);
        })
        .enabling("tries_left", |vision: &Vision| vision.tries_left > 0)
        .action("find_spot", find_spot)
        .action("retry_find_spot", retry_find_spot)
}

/// Looks for the spot with every camera.
async fn find_spot(action: Action<Vision>) -> Acted {
    let (cx, store) = (action.cx().clone(), store_of(&action));
    let destination: Destination = store.fetch(&cx, DESTINATION).await?;
    action.with_state(|vision| {
        vision.tries_left = vision.args.retries;
        let none = |camera: &String| (camera.clone(), None);
        vision.spots = Spots {
            stamp: destination.stamp,
            seen: vision.args.cameras.iter().map(none).collect(),
            ..Spots::default()
        };
    });
    look(&action, &cx, &store).await
}

/// Looks again with the cameras that missed it.
async fn retry_find_spot(action: Action<Vision>) -> Acted {
    let (cx, store) = (action.cx().clone(), store_of(&action));
    action.with_state(|vision| vision.tries_left = vision.tries_left.saturating_sub(1));
    look(&action, &cx, &store).await
}

fn store_of(action: &Action<Vision>) -> DomStore {
    action.with_state(|vision| vision.store.clone())
}

/// Asks VSS for the spot in the cameras that have not seen it yet, all at once, and stores what is
/// known then. Fails while a camera has not seen it.
async fn look(action: &Action<Vision>, cx: &Context, store: &DomStore) -> Acted {
    let looks = ask(action, cx).await;
    let spots = action.with_state(|vision| {
        vision.spots.reasons.clear();
        vision.spots.failure = None;
        for (camera, look) in looks {
            vision.take(camera, look);
        }
        vision.spots.clone()
    });
    store.store(cx, SPOTS, &spots).await?;
    if spots.reasons.is_empty() {
        Ok(())
    } else {
        Err(HandlerError::new(spots.why()))
    }
}

async fn ask(action: &Action<Vision>, cx: &Context) -> Vec<(String, Look)> {
    let (args, missing) = action.with_state(|vision| {
        let unseen = vision.spots.seen.iter().filter(|(_, spot)| spot.is_none());
        let missing: Vec<String> = unseen.map(|(camera, _)| camera.clone()).collect();
        (vision.args.clone(), missing)
    });
    let within = Duration::try_from_secs_f64(args.service_within_s).unwrap_or(Duration::MAX);
    let is_lost = |error: &VisionError| error.outcome == Vss::Lost;
    let asked = missing.into_iter().map(|camera| {
        let args = &args;
        async move {
            let looked = crate::patiently(cx, within, is_lost, || async {
                let camera = camera.clone();
                let vsm = cx.task(&args.vsm).await?;
                cx.call(&vsm, SpotFind { camera }).await?
            });
            let look = Look::from(looked.await);
            (camera, look)
        }
    });
    join_all(asked).await
}

impl Vision {
    /// Takes note of what a camera saw.
    fn take(&mut self, camera: String, look: Look) {
        match look {
            Look::Seen(spot) => {
                let mut seen = self.spots.seen.iter_mut();
                if let Some((_, slot)) = seen.find(|(name, _)| *name == camera) {
                    *slot = Some(*spot);
                }
            }
            Look::Missed { reason } => self.spots.reasons.push((camera, reason)),
            Look::Failed(failure) => {
                self.spots.reasons.push((camera, failure.reason.clone()));
                self.spots.failure = Some(failure);
                self.tries_left = 0;
            }
        }
    }
}

/// How one look through a camera ended.
#[derive(Debug, PartialEq)]
enum Look {
    Seen(Box<SpotReport>),
    /// The next picture, or the next position, may be better.
    Missed {
        reason: String,
    },
    /// The vision system did not do its work, and asking again is no use.
    Failed(Failure),
}

impl From<Result<SpotReport, VisionError>> for Look {
    fn from(answer: Result<SpotReport, VisionError>) -> Self {
        match answer {
            Ok(spot) if spot.flags.touches_border => Self::Missed {
                reason: format!(
                    "camera `{}`: the spot at {:.1}, {:.1} touches the border",
                    spot.camera, spot.u, spot.v
                ),
            },
            Ok(spot) => Self::Seen(Box::new(spot)),
            Err(VisionError {
                outcome: Vss::Unseen,
                reason,
            }) => Self::Missed { reason },
            Err(error) => Self::Failed(error.into()),
        }
    }
}

#[cfg(test)]
mod tests;
