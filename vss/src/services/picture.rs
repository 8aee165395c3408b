//! Pictures in files, as the classes read them.

use std::{fs::File, io::BufReader};

use sorma::Report;

use super::{check_file, code};
use crate::frame::Frame;

/// The picture in a file, as grey values.
pub(super) fn read(path: &str) -> Result<Frame, Report> {
    check_file(path)?;
    let wrong = |why: &dyn std::fmt::Display| {
        let text = format!("`{path}` is no picture that can be read (PNG): {why}");
        Report::error(code::FILE, text)
    };
    let file = File::open(path).map_err(|error| wrong(&error))?;
    let grey = crate::png::read(BufReader::new(file)).map_err(|error| wrong(&error))?;
    Ok(Frame::grey8(grey.width, grey.height, grey.pixels))
}
