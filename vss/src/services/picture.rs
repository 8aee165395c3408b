//! Pictures in files, as the classes read them.

use std::{fs, future::poll_fn, task::Poll, time::Duration};

use sorma::{Report, Transport, Waiting};
use vss_image::{FILE_MOST, Format, Picture};

use super::{check_file, code};
use crate::{
    command::Snap,
    frame::{Frame, PixelFormat},
};

/// What a class says of the files it reads.
pub(super) const FORMATS: &str = "PNG, JPEG, PNM, BMP";

/// The picture in a file. What a reader of numbers should know of it is reported as warnings.
pub(super) fn opened(path: &str, io: &mut Transport) -> Result<Picture, Report> {
    check_file(path, FILE_MOST)?;
    let wrong = |why: &dyn std::fmt::Display| {
        let text = format!("`{path}` is no picture that can be read ({FORMATS}): {why}");
        Report::error(code::FILE, text)
    };
    let bytes = fs::read(path).map_err(|error| wrong(&error))?;
    let picture = vss_image::read(&bytes).map_err(|error| wrong(&error))?;
    for note in &picture.notes {
        let text = format!("`{path}`: {note}");
        io.report(Report::warning(code::PICTURE, text));
    }
    Ok(picture)
}

/// The picture in a file, as a grey frame.
pub(super) fn read(path: &str, io: &mut Transport) -> Result<Frame, Report> {
    let picture = opened(path, io)?;
    Ok(frame(picture).into_grey())
}

/// The first word of a request for a camera's picture.
pub(super) const CAMERA: &str = "camera";

/// A picture is taken when the camera is free.
const DEADLINE: Duration = Duration::from_secs(60);

/// A picture that a camera of the app takes now, through the task `tool`, in grey.
pub(super) async fn taken(cx: &Waiting<'_>, camera: &str, tool: &str) -> Result<Frame, Report> {
    Ok(shot(cx, camera, tool).await?.into_grey())
}

/// The same with its colours.
pub(super) async fn shot(cx: &Waiting<'_>, camera: &str, tool: &str) -> Result<Frame, Report> {
    let wrong = |text: String| Report::error(code::CAMERA, text);
    if !cx.is_in_app() {
        return Err(wrong(format!(
            "there is no camera `{camera}` here, for no app runs here: attach to one, or give the name of a file"
        )));
    }
    begun().await;
    let request = Snap {
        camera: camera.to_owned(),
    };
    let nothing = |why: &str| wrong(format!("camera `{camera}` gives no picture: {why}"));
    let taken = cx.call_task(tool, request, DEADLINE).await;
    let taken = taken.map_err(|report| nothing(&report.text))?;
    let frame = taken.map_err(|error| nothing(&error.reason))?;
    frame.fetched().map_err(|error| nothing(&error.to_string()))
}

/// The beginning of a request belongs to the task that serves it, and what waits to a part of its own: a record of the task says
/// which part asked.
pub(super) async fn begun() {
    let mut begun = false;
    poll_fn(|cx| {
        cx.waker().wake_by_ref();
        if std::mem::replace(&mut begun, true) {
            Poll::Ready(())
        } else {
            Poll::Pending
        }
    })
    .await;
}

/// A picture of a file or, where the text is `camera NAME`, of a camera of the app; then also its number and stamp.
pub(super) async fn of(
    cx: &Waiting<'_>,
    text: &str,
    tool: &str,
    io: &mut Transport,
) -> Result<(Picture, Option<[i64; 2]>), Report> {
    match text.split_once(char::is_whitespace) {
        Some((CAMERA, name)) => {
            let frame = shot(cx, name.trim(), tool).await?;
            let stamp = i64::try_from(frame.stamp.as_nanos()).unwrap_or(i64::MAX);
            let number = i64::try_from(frame.number).unwrap_or(i64::MAX);
            Ok((whole(frame), Some([number, stamp])))
        }
        _ => Ok((opened(text, io)?, None)),
    }
}

/// A frame as a picture of a file.
fn whole(frame: Frame) -> Picture {
    Picture {
        width: frame.width,
        height: frame.height,
        format: match frame.format {
            PixelFormat::Grey8 => Format::Grey8,
            PixelFormat::Rgb8 => Format::Rgb8,
        },
        pixels: frame.pixels.to_vec(),
        notes: Vec::new(),
    }
}

/// A picture that no camera took.
fn frame(picture: Picture) -> Frame {
    match picture.format {
        Format::Grey8 => Frame::grey8(picture.width, picture.height, picture.pixels),
        Format::Rgb8 => Frame::rgb8(picture.width, picture.height, picture.pixels),
    }
}
