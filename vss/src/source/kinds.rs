//! Frame sources that need no hardware: pictures in a folder, a stream of pictures, the record of an app, and the snapshot
//! buffer in which another process leaves its frames. The simulator, and drivers of real cameras, are others.

mod buffer;
mod directory;
#[cfg(test)]
mod fuzz;
mod recording;
mod stream;

use std::time::Duration;

use ctos::{
    Context,
    config::Node,
    diagnostic::{Finding, Findings},
    task::HandlerError,
};
use serde::de::DeserializeOwned;
use vss_image::{Format, Picture};

use super::FrameSources;
use crate::frame::{Frame, FrameError};

/// Registers the frame sources `vss.directory`, `vss.stream`, `vss.recording` and `vss.buffer`.
pub fn register(sources: &mut FrameSources) {
    let made = sources.source("vss.directory", |cx, camera, args| {
        Ok(Box::new(directory::Directory::new(
            cx,
            camera,
            read(args)?,
        )?))
    });
    made.check(check::<directory::DirectoryArgs>);
    let made = sources.source("vss.stream", |cx, camera, args| {
        Ok(Box::new(stream::PictureStream::new(
            cx,
            camera,
            read(args)?,
        )?))
    });
    made.check(check::<stream::StreamArgs>);
    let made = sources.source("vss.recording", |cx, camera, args| {
        Ok(Box::new(recording::Recording::new(
            cx,
            camera,
            read(args)?,
        )?))
    });
    made.check(check::<recording::RecordingArgs>);
    let made = sources.source("vss.buffer", |cx, camera, args| {
        Ok(Box::new(buffer::Buffer::new(cx, camera, read(args)?)))
    });
    made.check(check::<buffer::BufferArgs>);
}

/// Arguments of a source, which say what is wrong with them.
trait Args: DeserializeOwned {
    /// What is impossible about them.
    fn wrong(&self) -> Option<String>;
}

fn read<A: Args>(args: &Node) -> Result<A, HandlerError> {
    let read: A = args.parse()?;
    match read.wrong() {
        Some(why) => Err(HandlerError::new(why)),
        None => Ok(read),
    }
}

fn check<A: Args>(camera: &str, args: &Node, findings: &mut Findings) {
    let wrong = match args.parse::<A>() {
        Err(finding) => finding,
        Ok(read) => match read.wrong() {
            Some(why) => Finding::error("vss::source::args", format!("camera `{camera}`: {why}")),
            None => return,
        },
    };
    findings.push(match (&wrong.place, args.place()) {
        (None, Some(place)) => wrong.at(place.clone()),
        _ => wrong,
    });
}

/// A time of the configuration, if it is one.
fn seconds(what: &str, value: f64) -> Result<Duration, String> {
    let time = Duration::try_from_secs_f64(value);
    time.map_err(|_| format!("`{what}` must be a time of 0 s or more, not {value:?}"))
}

/// The stamp of a picture that brings none: by its number and a period, or the present.
fn stamp(cx: &Context, period_s: Option<f64>, number: u64) -> Duration {
    match period_s.and_then(|period| seconds("period_s", period).ok()) {
        Some(period) => period.saturating_mul(u32::try_from(number).unwrap_or(u32::MAX)),
        None => cx.now().since_start(),
    }
}

/// Numbers the pictures of a camera.
#[derive(Debug)]
struct Camera {
    name: String,
    taken: u64,
}

impl Camera {
    fn new(name: &str) -> Self {
        Self {
            name: name.to_owned(),
            taken: 0,
        }
    }

    fn frame(&mut self, picture: Picture, stamp: Duration, exposure: Duration) -> Frame {
        let number = self.taken;
        self.taken += 1;
        for note in &picture.notes {
            tracing::debug!(camera = self.name, frame = number, "{note}");
        }
        let (width, height) = (picture.width, picture.height);
        let frame = match picture.format {
            Format::Grey8 => Frame::grey8(width, height, picture.pixels),
            Format::Rgb8 => Frame::rgb8(width, height, picture.pixels),
        };
        Frame {
            camera: self.name.clone(),
            number,
            stamp,
            exposure,
            ..frame
        }
    }

    fn fault(&self, reason: String) -> FrameError {
        FrameError::Fault {
            camera: self.name.clone(),
            reason,
        }
    }
}
