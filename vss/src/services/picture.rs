//! Pictures in files, as the classes read them.

use std::fs;

use sorma::{Report, Transport};
use vss_image::{FILE_MOST, Format, Picture};

use super::{check_file, code};
use crate::frame::Frame;

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

/// A picture that no camera took.
fn frame(picture: Picture) -> Frame {
    match picture.format {
        Format::Grey8 => Frame::grey8(picture.width, picture.height, picture.pixels),
        Format::Rgb8 => Frame::rgb8(picture.width, picture.height, picture.pixels),
    }
}
