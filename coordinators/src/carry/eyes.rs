//! The vision Service of `carry`: looks over the table with several calibrated cameras, and tells where the board is and what lies
//! on it and beside it.
//!
//! It is a Service as those of VSS (CIRSSE report 108, section 5): a series of calls to Tools, of which it needs `toolSnap`. All
//! cameras take their pictures at once. A camera that is not to be believed is left out, and said. Pictures of a camera on the hand
//! are taken by who moves the hand, and come with the request.

use std::{collections::BTreeMap, rc::Rc};

use ctos::{
    config::{App, TaskConfig},
    diagnostic::{Finding, Findings},
    message::{Command, Message},
    registry::Registry,
    task::{Context, EventHandler, Handled, HandlerError},
};
use futures_util::future::join_all;
use nalgebra::Point2;
use serde::Deserialize;
use vss::{
    camera_info::{CameraInfo, CameraPose, poses_from_yaml},
    command::{Outcome, Snap, VisionError},
    frame::Frame,
    tool::fetched,
};
use vss_board::discs::{DiscForm, bare, find_discs};
use vss_board::pose::{BoardForm, View, find_board};

use super::sight::Overview;

/// The handler's name.
pub const HANDLER: &str = "coordinators.carry_eyes";

ctos::command! {
    /// Takes a picture with every camera, and finds the board and the things on it and beside it.
    #[derive(Debug, Clone, PartialEq)]
    pub struct LookOver {
        /// The board.
        pub board: BoardForm,
        /// The things.
        pub discs: DiscForm,
        /// How high their lower sides may lie in the board's frame, m.
        pub floors: Vec<f64>,
        /// Places of the board's frame (m) that are looked at whether they are bare, as far around as a thing is.
        pub places: Vec<Point2<f64>>,
        /// Pictures that the camera on the hand took, from several places. The other cameras are asked when there are none.
        pub pictures: Vec<Frame>,
    } => Result<Overview, VisionError>, 0x0393, "look_over"
}

/// Arguments.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
struct EyesArgs {
    /// The Tool that takes pictures.
    #[serde(default = "snap_task")]
    snap: String,
    /// The cameras, and the `camera_info` file of the lens of each, relative to the configuration's folder.
    cameras: BTreeMap<String, String>,
    /// The file with their places in the arm's base frame, as a calibration writes it.
    poses: String,
    /// The camera on the hand; there is none when it is left out.
    hand: Option<HandArgs>,
}

/// A camera on the hand.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
struct HandArgs {
    /// The `camera_info` file of its lens.
    lens: String,
    /// The file with its place on the link that carries it, as a calibration of hand and eye finds it.
    pose: String,
}

fn snap_task() -> String {
    "toolSnap".to_owned()
}

/// Registers the handler.
pub(super) fn register(registry: &mut Registry) {
    registry
        .handler(HANDLER, &[LookOver::INFO], Eyes::new)
        .checked_args::<EyesArgs>(check);
}

fn check(args: &EyesArgs, task: &TaskConfig, app: &App, findings: &mut Findings) {
    crate::need_task(task, app, "snap", &args.snap, findings);
    let read = lenses(args, app).and_then(|_| hand_lens(args, app));
    if let Err((key, text)) = read {
        let place = task.args.locate(&key).unwrap_or_else(|| task.place.clone());
        let finding = Finding::error("coordinators::carry::eyes", text).at(place);
        findings.push(finding.help("calibrate the cameras, and name the files that it wrote"));
    }
}

/// A camera's name, its lens and its place.
type Calibrated = (String, CameraInfo, CameraPose);

/// The calibrated cameras.
fn lenses(args: &EyesArgs, app: &App) -> Result<Vec<Calibrated>, (String, String)> {
    if args.cameras.is_empty() {
        return Err(("cameras".to_owned(), "no camera is named".to_owned()));
    }
    let poses = poses(app, ("poses", &args.poses))?;
    let cameras = args.cameras.iter().map(|(name, file)| {
        let key = format!("cameras.{name}");
        let lens = lens(app, (&key, file))?;
        let mut poses = poses.iter();
        let pose = poses.find(|pose| pose.name == *name).cloned();
        let text = format!("`{}` has no camera `{name}`", args.poses);
        Ok((name.clone(), lens, pose.ok_or((key, text))?))
    });
    cameras.collect()
}

/// The camera on the hand, on the link that carries it.
fn hand_lens(args: &EyesArgs, app: &App) -> Result<Option<Calibrated>, (String, String)> {
    let Some(hand) = &args.hand else {
        return Ok(None);
    };
    let lens = lens(app, ("hand.lens", &hand.lens))?;
    let pose = poses(app, ("hand.pose", &hand.pose))?.into_iter().next();
    let text = format!("`{}` has no camera", hand.pose);
    let pose = pose.ok_or(("hand.pose".to_owned(), text))?;
    Ok(Some((pose.name.clone(), lens, pose)))
}

fn read(app: &App, (key, file): (&str, &str)) -> Result<String, (String, String)> {
    let source = app.read(file);
    let source = source.map_err(|finding| (key.to_owned(), finding.to_string()))?;
    Ok(source.text().to_owned())
}

fn poses(app: &App, (key, file): (&str, &str)) -> Result<Vec<CameraPose>, (String, String)> {
    let poses = poses_from_yaml(&read(app, (key, file))?);
    poses.map_err(|error| (key.to_owned(), format!("`{file}`: {error}")))
}

fn lens(app: &App, (key, file): (&str, &str)) -> Result<CameraInfo, (String, String)> {
    let lens = CameraInfo::from_yaml(&read(app, (key, file))?);
    lens.map_err(|error| (key.to_owned(), format!("`{file}`: {error}")))
}

/// The Service.
struct Eyes {
    snap: String,
    cameras: Rc<Vec<Calibrated>>,
    hand: Rc<Option<Calibrated>>,
}

impl Eyes {
    fn new(cx: &Context) -> Result<Self, HandlerError> {
        let args: EyesArgs = cx.args()?;
        let wrong = |(_, text): (String, String)| HandlerError::new(text);
        let cameras = lenses(&args, cx.app()).map_err(wrong)?;
        let hand = hand_lens(&args, cx.app()).map_err(wrong)?;
        Ok(Self {
            hand: Rc::new(hand),
            snap: args.snap,
            cameras: Rc::new(cameras),
        })
    }
}

impl EventHandler for Eyes {
    async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
        if message.command() != LookOver::CODE {
            return cx.default_processing(message);
        }
        let (request, reply) = message.open::<LookOver>()?;
        if !request.pictures.is_empty() {
            return reply.ok(seen_by_hand(&self.hand, &request));
        }
        let (child, snap, cameras) = (cx.clone(), self.snap.clone(), self.cameras.clone());
        cx.spawn(async move {
            // Answering never fails; its result exists to end a handler with.
            let _ = reply.ok(look_over(&child, &snap, &cameras, &request).await);
        });
        Ok(())
    }
}

async fn look_over(
    cx: &Context,
    snap: &str,
    cameras: &[Calibrated],
    request: &LookOver,
) -> Result<Overview, VisionError> {
    let pictures = cameras.iter().map(|(camera, lens, pose)| async move {
        let frame = picture(cx, snap, camera).await?;
        fits(&frame, lens)?;
        Ok(View::new(frame, lens, pose))
    });
    let (mut views, mut errors) = (Vec::new(), Vec::<VisionError>::new());
    for picture in join_all(pictures).await {
        match picture {
            Ok(view) => views.push(view),
            Err(error) => errors.push(error),
        }
    }
    let doubts: Vec<String> = errors.iter().map(|error| error.reason.clone()).collect();
    if let ([], Some(first)) = (views.as_slice(), errors.first()) {
        return Err(VisionError::new(first.outcome, doubts.join("; ")));
    }
    seen(&views, request, doubts)
}

fn fits(frame: &Frame, lens: &CameraInfo) -> Result<(), VisionError> {
    if (frame.width, frame.height) == (lens.width, lens.height) {
        return Ok(());
    }
    let camera = &frame.camera;
    let text = format!("camera `{camera}`: its pictures have another size than its lens");
    Err(VisionError::new(Outcome::Fault, text))
}

/// What pictures of the camera on the hand show, each from where the hand was then.
fn seen_by_hand(hand: &Option<Calibrated>, request: &LookOver) -> Result<Overview, VisionError> {
    let refused = |text: String| VisionError::new(Outcome::Refused, text);
    let (_, lens, pose) = hand
        .as_ref()
        .ok_or_else(|| refused("no camera on the hand is configured".to_owned()))?;
    let views = request.pictures.iter().map(|frame| {
        fits(frame, lens)?;
        let text = || refused(format!("nobody knows where camera `{}` was", frame.camera));
        let base_t_link = frame.carrier.as_ref().ok_or_else(text)?.world_t_link;
        let pose = CameraPose {
            rotation: pose.rotation * base_t_link.rotation.inverse(),
            centre: base_t_link * pose.centre,
            ..pose.clone()
        };
        Ok(View::new(frame.clone(), lens, &pose))
    });
    let views: Result<Vec<View>, VisionError> = views.collect();
    seen(&views?, request, Vec::new())
}

async fn picture(cx: &Context, snap: &str, camera: &str) -> Result<Frame, VisionError> {
    let tool = cx.task(snap).await?;
    let camera = camera.to_owned();
    let taken = cx.call(&tool, Snap { camera }).await?;
    taken.and_then(|frame| fetched(cx, frame))
}

/// What pictures show.
fn seen(
    views: &[View],
    request: &LookOver,
    mut doubts: Vec<String>,
) -> Result<Overview, VisionError> {
    let board = find_board(views, &request.board).map_err(|error| {
        let all: Vec<String> = std::iter::once(error.to_string())
            .chain(doubts.iter().cloned())
            .collect();
        VisionError::new(Outcome::Unseen, all.join("; "))
    })?;
    for view in views {
        let camera = &view.frame.camera;
        if !board.cameras.contains(camera) {
            doubts.push(format!("camera `{camera}` does not see the board"));
        }
    }
    let pose = &board.base_t_board;
    let places = request.places.iter().map(|place| {
        let side = request.board.field_m;
        bare(views, pose, side, *place, request.discs.radius_m)
    });
    Ok(Overview {
        bare: places.collect(),
        discs: find_discs(views, pose, &request.floors, &request.discs),
        board,
        doubts,
    })
}
