//! JPEG: sequential and progressive, 8 bits, grey or of three colours.
//!
//! Decoders of JPEG fill up with grey what a file lacks. So the codes of all scans are counted first ([`scan`]), and only a
//! file that is whole is decoded.

mod exif;
mod scan;

use zune_core::{bytestream::ZCursor, colorspace::ColorSpace, options::DecoderOptions};
use zune_jpeg::JpegDecoder;

use crate::{Format, Note, Picture, ReadError, sides};

const FORMAT: &str = "JPEG";

fn broken(what: impl Into<String>) -> ReadError {
    let what = what.into();
    ReadError::Broken {
        format: FORMAT,
        what,
    }
}

fn unsupported(what: impl Into<String>) -> ReadError {
    let what = what.into();
    ReadError::Unsupported {
        format: FORMAT,
        what,
    }
}

fn truncated(what: impl Into<String>) -> ReadError {
    let what = what.into();
    ReadError::Truncated {
        format: FORMAT,
        what,
    }
}

/// Reads a JPEG.
///
/// # Errors
/// It is broken, truncated, too large or of another kind: of four colours, with arithmetic codes, lossless.
pub(crate) fn read(bytes: &[u8]) -> Result<Picture, ReadError> {
    let found = scan::walk(bytes)?;
    let (width, height) = (found.width, found.height);
    let (format, space) = match found.components {
        1 => (Format::Grey8, ColorSpace::Luma),
        _ => (Format::Rgb8, ColorSpace::RGB),
    };
    let options = DecoderOptions::default()
        .set_strict_mode(true)
        .set_max_width(width)
        .set_max_height(height)
        .jpeg_set_max_scans(scan::MOST)
        .jpeg_set_out_colorspace(space);
    // What comes after the end belongs to somebody else.
    let whole = bytes.get(..found.end).unwrap_or(bytes);
    let mut decoder = JpegDecoder::new_with_options(ZCursor::new(whole), options);
    let pixels = decoder.decode();
    let pixels = pixels.map_err(|error| broken(error.to_string()))?;
    if decoder.dimensions() != Some((width, height))
        || pixels.len() != width * height * format.bytes()
    {
        return Err(broken("its frames contradict one another"));
    }
    Ok(Picture {
        width,
        height,
        format,
        pixels,
        notes: found
            .orientation
            .map(Note::Orientation)
            .into_iter()
            .collect(),
    })
}
