//! The frames in a record of an app (MCAP): what its Vision Modules answered.

use std::{
    collections::VecDeque,
    path::{Path, PathBuf},
};

use base64::{Engine as _, engine::general_purpose::STANDARD};
use ctos::{
    Context,
    message::Command as _,
    record::{Filter, scan_only},
    task::HandlerError,
};
use futures_util::future::LocalBoxFuture;
use serde::Deserialize;

use super::{Args, Camera};
use crate::{
    command::SnapNow,
    frame::{Frame, FrameError},
    source::FrameSource,
};

/// The frames of one camera are held in memory: no more bytes of them.
const BYTES_MOST: usize = 256 << 20;

/// Arguments of `vss.recording`.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct RecordingArgs {
    /// The record, relative to the configuration's folder.
    file: String,
    /// The camera of the recorded app; the same name when none is given.
    camera: Option<String>,
}

impl Args for RecordingArgs {
    fn wrong(&self) -> Option<String> {
        None
    }
}

/// A camera of a recorded app. Its frames keep their stamps, their exposures and what carried the camera.
pub(super) struct Recording {
    camera: Camera,
    recorded: String,
    path: PathBuf,
    /// Not read yet, in a replay.
    frames: Option<VecDeque<Frame>>,
}

impl Recording {
    pub(super) fn new(
        cx: &Context,
        camera: &str,
        args: RecordingArgs,
    ) -> Result<Self, HandlerError> {
        let mut own = Self {
            camera: Camera::new(camera),
            recorded: args.camera.unwrap_or_else(|| camera.to_owned()),
            path: cx.path(&args.file),
            frames: None,
        };
        if !cx.is_replay() {
            own.frames = Some(frames(&own.path, &own.recorded).map_err(HandlerError::new)?);
        }
        Ok(own)
    }

    fn next(&mut self) -> Result<Frame, String> {
        let frames = match self.frames.take() {
            Some(frames) => frames,
            None => frames(&self.path, &self.recorded)?,
        };
        let recorded =
            self.frames.insert(frames).pop_front().ok_or_else(|| {
                format!("all recorded frames of `{}` are taken", self.path.display())
            })?;
        self.camera.taken += 1;
        Ok(Frame {
            camera: self.camera.name.clone(),
            number: self.camera.taken - 1,
            ..recorded
        })
    }

    async fn take(&mut self, cx: &Context) -> Result<Frame, FrameError> {
        let read = cx.outside("the next frame of a record", || self.next());
        read.map_err(|why| self.camera.fault(why))
    }
}

/// All frames of a camera in a record.
pub(super) fn frames(path: &Path, camera: &str) -> Result<VecDeque<Frame>, String> {
    let filter = Filter {
        topics: vec!["/reply/*".to_owned()],
        ..Filter::default()
    };
    let (mut frames, mut bytes, mut others) = (VecDeque::new(), 0_usize, Vec::new());
    let shown = path.display();
    let run = scan_only(path, &filter, |entry| {
        let Some(frame) = frame_of(&entry.json) else {
            return;
        };
        if frame.camera == camera {
            bytes += frame.pixels.len();
            if bytes <= BYTES_MOST {
                frames.push_back(frame);
            }
        } else if !others.contains(&frame.camera) {
            others.push(frame.camera);
        }
    });
    run.map_err(|error| error.to_string())?;
    if bytes > BYTES_MOST {
        return Err(format!(
            "the frames of camera `{camera}` in `{shown}` take {bytes} bytes, more than {BYTES_MOST}: cut a part out with `ctos log \
             filter --from --to`"
        ));
    }
    if frames.is_empty() {
        let others = match others.as_slice() {
            [] => "of no camera".to_owned(),
            others => format!("of {}", others.join(", ")),
        };
        return Err(format!(
            "`{shown}` has no frames of camera `{camera}`, but {others}"
        ));
    }
    Ok(frames)
}

/// The frame that a line of a reply holds, if it is one.
pub(super) fn frame_of(json: &[u8]) -> Option<Frame> {
    #[derive(Deserialize)]
    struct Reply {
        code: u32,
        result: String,
        bytes: String,
    }
    let reply: Reply = serde_json::from_slice(json).ok()?;
    let Reply {
        code,
        result,
        bytes,
    } = reply;
    if code != u32::from(SnapNow::CODE) || result != "ok" {
        return None;
    }
    let frame: Frame = postcard::from_bytes(&STANDARD.decode(bytes).ok()?).ok()?;
    frame.is_whole().then_some(frame)
}

impl FrameSource for Recording {
    fn snap<'a>(&'a mut self, cx: &'a Context) -> LocalBoxFuture<'a, Result<Frame, FrameError>> {
        Box::pin(self.take(cx))
    }
}
