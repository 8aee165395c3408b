//! What there is to see of an app, in the schemas that Foxglove, Lichtblick, Rerun and PlotJuggler read.
//!
//! An event handler that anyone can put into an app, [`HANDLER`], follows what tasks show ([`scene`]) and records it:
//!
//! | channel | schema | one for |
//! |---|---|---|
//! | `/tf/TASK` | `foxglove.FrameTransforms` | each change: where all parts of TASK are in the frame [`WORLD`] |
//! | `/solids/TASK` | `foxglove.SceneUpdate` | the parts of TASK, when there are others: their solids in their frames |
//! | `/joints/TASK` | `foxglove.JointStates` | each change: positions, velocities and efforts of TASK's joints, SI |
//! | `/vectors/TASK` | `foxglove.SceneUpdate` | each change: arrows of what sensors feel, and of the way to what is nearest |
//! | `/numbers/TASK` | JSON | each change: every number of every part, its unit in its name |
//! | `/said/TASK` | `foxglove.Log` | what TASK says about what it shows |
//! | `/camera/CAMERA/image` | `foxglove.CompressedImage` | at most five pictures a second: JPEG, made small |
//! | `/camera/CAMERA/marks` | `foxglove.ImageAnnotations` | what was found in such a picture |
//! | `/camera/CAMERA/calibration` | `foxglove.CameraCalibration` | a camera that was computed: its lens without distortion, for the small picture |
//!
//! With `listen` it also serves them to viewers that connect, over the Foxglove WebSocket protocol.
//! Besides it records `/scene/TASK` and `/picture/CAMERA`, which `ctos display` shows. Lengths are in m, times are those of the app: since its start. [`Translator`] is that translation by itself.

mod front;
mod live;
mod shapes;
mod task;
mod translate;

use std::net::SocketAddr;

use ctos::registry::Registry;

pub use translate::{Sent, TranslateError, Translator, WORLD};

/// Where viewers look for a live stream.
pub const DEFAULT_LISTEN: SocketAddr =
    SocketAddr::new(std::net::IpAddr::V4(std::net::Ipv4Addr::LOCALHOST), 8765);

pub use scene::follow::RECORDER as HANDLER;

/// Registers the handler.
pub fn register(registry: &mut Registry) {
    registry
        .handler(HANDLER, &[], task::Viewers::new)
        .checked_args(task::check);
}
