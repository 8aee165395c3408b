//! Vision Modules: each drives one piece of hardware, for one caller at a time. Here: a camera (any frame source) and
//! the stand-in for a monitor, which keeps what it shows and can write it as a PNG file.

mod laser;
mod shown;

use std::{
    collections::BTreeMap,
    fs::File,
    io::BufWriter,
    path::{Path, PathBuf},
    sync::{Arc, Mutex, MutexGuard, PoisonError},
};

use ctos::{
    config::Node,
    message::{Command, CommandInfo, Message},
    task::{Context, EventHandler, Handled, HandlerError},
};
use scene::{FollowScene, Stage};
use serde::Deserialize;

use crate::{
    command::{DisplayImage, DisplayMark, InitializeVm, Mark, Shown, SnapNow, WhatIsShown},
    frame::{Doubt, Frame, FrameError, buffer::FrameWriter},
    source::{FrameSource, FrameSources},
    tool::fetched,
};

pub use laser::{LASER_COMMANDS, LaserModule};
pub(crate) use laser::{LaserArgs, driver_of};

use vss_tools::watch::{Watch, WatchArgs};

/// The commands of `vss.vm_snap`.
pub const SNAP_COMMANDS: &[CommandInfo] = &[InitializeVm::INFO, SnapNow::INFO];
/// The commands of `vss.vm_image_disp`.
pub const IMAGE_DISP_COMMANDS: &[CommandInfo] = &[
    InitializeVm::INFO,
    DisplayImage::INFO,
    WhatIsShown::INFO,
    FollowScene::INFO,
];
/// The commands of `vss.vm_spot_disp`.
pub const SPOT_DISP_COMMANDS: &[CommandInfo] = &[InitializeVm::INFO, DisplayMark::INFO];

/// Under which name the two display modules of a chassis share their monitor.
const MONITOR: &str = "vss.monitor";
/// Half the length of a marker's arms, px.
const ARM: i64 = 7;

/// The arguments of a camera's Vision Module.
pub(crate) struct SnapArgs {
    /// The camera's name.
    pub(crate) camera: String,
    /// What its frame source is called.
    pub(crate) source: Node,
    /// The source's own.
    pub(crate) own: Node,
    watch: WatchArgs,
    /// The snapshot buffer in which it leaves its frames for other programs, too.
    buffer: Option<String>,
    /// Whether messages bring the pixels, because a Tool in place of the catalog's own cannot fetch them.
    whole: bool,
}

/// Reads the arguments of a camera's Vision Module: `camera`, `source`, the source's own `args`, `watch` and `buffer`.
pub(crate) fn snap_args(args: &Node) -> Result<SnapArgs, HandlerError> {
    let text = |key: &str| -> Result<&Node, HandlerError> {
        let node = args.get(key).filter(|node| node.as_str().is_some());
        node.ok_or_else(|| HandlerError::new(format!("`{key}` is missing or not a string")))
    };
    let word = |key: &str| -> Result<String, HandlerError> {
        Ok(text(key)?.as_str().unwrap_or_default().to_owned())
    };
    let watch = args.get("watch").map(Node::parse::<WatchArgs>);
    Ok(SnapArgs {
        camera: word("camera")?,
        source: text("source")?.clone(),
        own: args.get("args").cloned().unwrap_or_else(Node::table),
        watch: watch.transpose()?.unwrap_or_default(),
        buffer: args.get("buffer").map(|_| word("buffer")).transpose()?,
        whole: args.get("whole").is_some(),
    })
}

/// vmSnap: one camera.
pub struct SnapModule {
    camera: String,
    source: Box<dyn FrameSource>,
    watch: Watch,
    /// What was wrong with the last frame.
    doubt: Option<Doubt>,
    frames: Option<FrameWriter>,
    /// Whether frames are left there only for the app's own chassis.
    inner: bool,
    /// Whether messages bring the pixels all the same.
    whole: bool,
}

impl SnapModule {
    pub(crate) fn new(cx: &Context, sources: &FrameSources) -> Result<Self, HandlerError> {
        let args = cx
            .config()
            .map_or_else(Node::table, |config| config.args.clone());
        let args = snap_args(&args)?;
        let name = args.source.as_str().unwrap_or_default();
        let source = sources.build(name, cx, &args.camera, &args.own)?;
        let inner = args.buffer.is_none();
        let usual = || format!("frames.{}", args.camera);
        let buffer = args.buffer.unwrap_or_else(usual);
        let frames = || {
            let place = (cx.app().name.as_str(), buffer.as_str());
            FrameWriter::new(place, cx.chassis().clock())
        };
        Ok(Self {
            watch: Watch::new(args.watch, source.is_live()),
            doubt: None,
            frames: (!inner || (walls_share_memory(cx) && !args.whole)).then(frames),
            inner,
            whole: args.whole,
            camera: args.camera,
            source,
        })
    }

    /// A picture that is to be believed; it is left in the buffer, too.
    async fn snap(&mut self, cx: &Context) -> Result<Frame, FrameError> {
        let mut frame = self.source.snap(cx).await?;
        let now = cx.now().since_start();
        frame.received = Some(now);
        let seen = self.watch.look(&frame, now);
        let (camera, number) = (&self.camera, frame.number);
        let doubt = seen.as_ref().map(|(doubt, _)| *doubt);
        if doubt != self.doubt {
            match &seen {
                Some((doubt, text)) => {
                    tracing::warn!(camera, doubt = doubt.name(), frame = number, "{text}");
                }
                None => tracing::info!(camera, frame = number, "to be believed again"),
            }
            self.doubt = doubt;
        }
        if let Some((doubt, reason)) = seen {
            let camera = camera.clone();
            return Err(FrameError::Doubtful {
                camera,
                doubt,
                reason,
            });
        }
        let frame = self.left(cx, frame);
        let camera = &self.camera;
        tracing::debug!(camera, frame = number, "snapped");
        Ok(frame)
    }

    /// The frame, left in the buffer. Where messages are recorded they bring the pixels, for no record holds the buffer.
    fn left(&mut self, cx: &Context, mut frame: Frame) -> Frame {
        let crosses =
            walls_share_memory(cx) && !self.whole && !cx.is_recording() && !cx.is_replay();
        let Some(frames) = self.frames.as_mut().filter(|_| crosses || !self.inner) else {
            return frame;
        };
        // A replay writes nothing. A buffer that cannot be written must not cost a measurement.
        let write = || frames.write(&frame).map_err(|error| error.to_string());
        match cx.outside("the buffer of frames", write) {
            Ok(left) => frame.left = crosses.then_some(left),
            Err(error) => {
                let camera = &self.camera;
                // Nobody asked for a buffer that has no name.
                if self.inner {
                    tracing::info!(camera, "frames go by message: {error}");
                } else {
                    tracing::warn!(camera, "no more frames are left: {error}");
                }
                self.frames = None;
            }
        }
        frame
    }
}

/// Whether chassis of the app are several processes of one host. In virtual time all are one process, and apps of one
/// name must not meet in the memory of a host.
fn walls_share_memory(cx: &Context) -> bool {
    let mut hosts = cx.app().chassis.iter().map(|chassis| &chassis.host);
    let real = cx.chassis().clock().origin_ns().is_some();
    let first = hosts.next();
    real && hosts.len() > 0 && hosts.all(|host| Some(host) == first)
}

impl EventHandler for SnapModule {
    async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
        match message.command() {
            InitializeVm::CODE => message.open::<InitializeVm>()?.1.ok(()),
            SnapNow::CODE => {
                let (SnapNow {}, reply) = message.open::<SnapNow>()?;
                match self.snap(cx).await {
                    Ok(frame) => reply.ok(frame),
                    Err(error) => reply.fail(error),
                }
            }
            _ => cx.default_processing(message),
        }
    }
}

/// What the monitor of a chassis shows.
#[derive(Debug, Default)]
struct Monitor {
    shown: Mutex<BTreeMap<String, Shown>>,
}

impl Monitor {
    /// The monitor of this chassis, made by whoever asks first.
    fn of(cx: &Context) -> Arc<Self> {
        cx.shared::<Self>(MONITOR).unwrap_or_else(|| {
            let monitor = Arc::new(Self::default());
            cx.share(MONITOR, monitor.clone());
            monitor
        })
    }

    /// No code that holds the lock can leave its data half changed, so a panic elsewhere does no harm.
    fn lock(&self) -> MutexGuard<'_, BTreeMap<String, Shown>> {
        self.shown.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// vmImageDisp: the pictures on the monitor.
#[derive(Default)]
pub struct ImageDispModule {
    /// What viewers elsewhere see of it.
    stage: Option<Stage>,
}

impl EventHandler for ImageDispModule {
    async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
        match message.command() {
            InitializeVm::CODE => message.open::<InitializeVm>()?.1.ok(()),
            DisplayImage::CODE => {
                let (request, reply) = message.open::<DisplayImage>()?;
                let frame = match fetched(cx, request.frame) {
                    Ok(frame) => frame,
                    Err(error) => return reply.fail(error),
                };
                Monitor::of(cx).lock().insert(
                    request.camera,
                    Shown {
                        frame,
                        marks: Vec::new(),
                        drawing: request.drawing,
                    },
                );
                reply.ok(())
            }
            WhatIsShown::CODE => {
                let (WhatIsShown { camera }, reply) = message.open::<WhatIsShown>()?;
                let shown = Monitor::of(cx).lock().get(&camera).cloned();
                reply.ok(shown)
            }
            FollowScene::CODE => {
                let stage = self.stage.get_or_insert_with(|| shown::stage(cx));
                stage.follow(cx, message)
            }
            _ => cx.default_processing(message),
        }
    }
}

/// Arguments of `vss.vm_spot_disp`.
#[derive(Debug, Clone, PartialEq, Default, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub(crate) struct SpotDispArgs {
    /// Where to write each marked picture, relative to the configuration's folder; `{camera}` stands for the camera's
    /// name. Nothing is written without it.
    file: Option<String>,
}

/// vmSpotDisp: the markers on top of the pictures.
#[derive(Debug)]
pub struct SpotDispModule {
    args: SpotDispArgs,
}

impl SpotDispModule {
    pub(crate) fn new(cx: &Context) -> Result<Self, HandlerError> {
        Ok(Self { args: cx.args()? })
    }

    fn file_for(&self, cx: &Context, camera: &str) -> Option<PathBuf> {
        let pattern = self.args.file.as_ref()?;
        Some(cx.path(&pattern.replace("{camera}", camera)))
    }
}

impl EventHandler for SpotDispModule {
    async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
        match message.command() {
            InitializeVm::CODE => message.open::<InitializeVm>()?.1.ok(()),
            DisplayMark::CODE => {
                let (DisplayMark { camera, mark }, reply) = message.open::<DisplayMark>()?;
                let monitor = Monitor::of(cx);
                let shown = match monitor.lock().get_mut(&camera) {
                    Some(shown) => {
                        shown.marks.push(mark);
                        shown.clone()
                    }
                    None => {
                        return reply
                            .fail(format!("the monitor shows no picture of camera `{camera}`"));
                    }
                };
                if let Some(file) = self.file_for(cx, &camera) {
                    // A replay writes nothing.
                    cx.outside("the picture's file", || {
                        write_png(&shown, &file).map_err(|error| error.to_string())
                    })?;
                }
                reply.ok(())
            }
            _ => cx.default_processing(message),
        }
    }
}

/// Writes a picture with its markers.
fn write_png(shown: &Shown, file: &Path) -> Result<(), HandlerError> {
    let at = |error: &dyn std::fmt::Display| {
        HandlerError::new(format!("cannot write `{}`: {error}", file.display()))
    };
    if let Some(folder) = file.parent() {
        std::fs::create_dir_all(folder).map_err(|error| at(&error))?;
    }
    let Frame { width, height, .. } = shown.frame;
    let to = File::create(file).map_err(|error| at(&error))?;
    crate::png::write(BufWriter::new(to), width, height, &marked(shown)).map_err(|error| at(&error))
}

/// The pixels with a cross around each marked place; the middle stays visible.
fn marked(shown: &Shown) -> Vec<u8> {
    let Frame { width, height, .. } = &shown.frame;
    let mut pixels = shown.frame.grey().into_owned();
    let mut paint = |u: i64, v: i64| {
        let (Ok(u), Ok(v)) = (usize::try_from(u), usize::try_from(v)) else {
            return;
        };
        if u < *width
            && v < *height
            && let Some(pixel) = pixels.get_mut(v * width + u)
        {
            *pixel = u8::MAX;
        }
    };
    for Mark { u, v, .. } in &shown.marks {
        let (u, v) = (u.round() as i64, v.round() as i64);
        for step in 3..=ARM {
            paint(u.saturating_add(step), v);
            paint(u.saturating_sub(step), v);
            paint(u, v.saturating_add(step));
            paint(u, v.saturating_sub(step));
        }
    }
    pixels
}
