//! The frames that another process of this host leaves in a snapshot buffer.

use std::time::Duration;

use ctos::Context;
use futures_util::future::LocalBoxFuture;
use serde::Deserialize;

use super::{Args, Camera, seconds};
use crate::{
    frame::{Frame, FrameError, buffer::FrameReader},
    source::FrameSource,
};

/// How often it is looked for a new frame.
const LOOK: Duration = Duration::from_millis(2);

/// Arguments of `vss.buffer`.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct BufferArgs {
    /// The buffer's name.
    buffer: String,
    /// The app that leaves frames there; this one when none is named.
    app: Option<String>,
    /// How long it is waited for a frame that was not taken yet, s.
    #[serde(default = "one_second")]
    within_s: f64,
}

fn one_second() -> f64 {
    1.0
}

impl Args for BufferArgs {
    fn wrong(&self) -> Option<String> {
        seconds("within_s", self.within_s).err()
    }
}

/// The latest frame of a buffer. Frames keep their numbers, stamps, exposures and what carried the camera.
pub(super) struct Buffer {
    camera: Camera,
    reader: FrameReader,
    within: Duration,
    /// The number of the frame that was taken last.
    last: Option<u64>,
}

impl Buffer {
    pub(super) fn new(cx: &Context, camera: &str, args: BufferArgs) -> Self {
        let own = cx.app().name.as_str();
        Self {
            camera: Camera::new(camera),
            reader: FrameReader::new(args.app.as_deref().unwrap_or(own), &args.buffer),
            within: seconds("within_s", args.within_s).unwrap_or_default(),
            last: None,
        }
    }

    async fn take(&mut self, cx: &Context) -> Result<Frame, FrameError> {
        let begun = cx.now();
        loop {
            let read = cx.outside("the latest frame of a buffer", || {
                self.reader.latest().map_err(|error| error.to_string())
            });
            let late = cx.now().since_start().saturating_sub(begun.since_start()) >= self.within;
            match read {
                Ok(frame) if self.last != Some(frame.number) => {
                    self.last = Some(frame.number);
                    return Ok(Frame {
                        camera: self.camera.name.clone(),
                        ..frame
                    });
                }
                Ok(frame) if late => {
                    let (number, within) = (frame.number, self.within);
                    let why = format!("no frame came within {within:?} after frame {number}");
                    return Err(self.camera.fault(why));
                }
                Err(why) if late => return Err(self.camera.fault(why)),
                _ => cx.sleep(LOOK).await,
            }
        }
    }
}

impl FrameSource for Buffer {
    fn snap<'a>(&'a mut self, cx: &'a Context) -> LocalBoxFuture<'a, Result<Frame, FrameError>> {
        Box::pin(self.take(cx))
    }
}
