//! PNG: reading any kind of it, and writing grey ones.

use std::io::{Cursor, Write};

use png::{
    BitDepth, ColorType, Compression, DecodeOptions, Decoder, DecodingError, Encoder, Limits,
    Transformations,
};

use crate::{
    Format, Note, Picture, ReadError,
    samples::{scaled, unpacked},
    sides,
};

const FORMAT: &str = "PNG";

/// The decoder may take so many bytes besides the pixels: a chunk can grow a thousandfold.
const CHUNKS_MOST: usize = 16 << 20;

/// Why a picture could not be written: the output, or a size that the pixels do not have.
#[derive(Debug, thiserror::Error)]
#[error(transparent)]
pub struct WriteError(#[from] png::EncodingError);

fn broken(what: impl Into<String>) -> ReadError {
    let what = what.into();
    ReadError::Broken {
        format: FORMAT,
        what,
    }
}

fn wrong(error: DecodingError) -> ReadError {
    match error {
        DecodingError::IoError(error) if error.kind() == std::io::ErrorKind::UnexpectedEof => {
            ReadError::Truncated {
                format: FORMAT,
                what: "it ends before its last chunk, IEND".to_owned(),
            }
        }
        error => broken(error.to_string()),
    }
}

/// Reads a PNG whole, with all checksums, to its last chunk.
///
/// # Errors
/// It is broken, truncated, too large or an animation.
pub(crate) fn read(bytes: &[u8]) -> Result<Picture, ReadError> {
    // The size stands at a fixed place: it is looked at before anything is decoded.
    let side = |at: usize| {
        let side = bytes.get(at..at + 4).and_then(|side| side.first_chunk());
        side.map(|side| u64::from(u32::from_be_bytes(*side)))
    };
    if let (Some(width), Some(height)) = (side(16), side(20)) {
        sides(FORMAT, width, height)?;
    }
    let mut options = DecodeOptions::default();
    options.set_ignore_checksums(false);
    options.set_skip_ancillary_crc_failures(false);
    options.set_ignore_text_chunk(true);
    options.set_ignore_iccp_chunk(true);
    let mut decoder = Decoder::new_with_options(Cursor::new(bytes), options);
    decoder.set_limits(Limits { bytes: CHUNKS_MOST });
    // Samples come as they are stored: the decoder would make black of colours that a palette does not have.
    decoder.set_transformations(Transformations::IDENTITY);
    let mut reader = decoder.read_info().map_err(wrong)?;
    let info = reader.info();
    if info.animation_control.is_some() {
        return Err(ReadError::Unsupported {
            format: FORMAT,
            what: "it is an animation".to_owned(),
        });
    }
    let (width, height) = sides(FORMAT, info.width.into(), info.height.into())?;
    let transparent = info.trns.is_some();
    let palette = info.palette.as_deref().map(<[u8]>::to_vec);
    let size = reader.output_buffer_size();
    let mut stored = vec![0; size.ok_or_else(|| broken("its rows have no length"))?];
    let frame = reader.next_frame(&mut stored).map_err(wrong)?;
    reader.finish().map_err(wrong)?;
    let rows = stored.chunks_exact(frame.line_size.max(1));
    let channels = frame.color_type.samples();
    let count = width * channels;
    // Memory for all of them is taken once: growing would take twice as much.
    let mut samples = Vec::with_capacity(count * height);
    for row in rows {
        match frame.bit_depth {
            BitDepth::Sixteen => {
                let wide = row.chunks_exact(2).take(count);
                let numbers = wide.map(|two| u32::from(two[0]) << 8 | u32::from(two[1]));
                samples.extend(numbers.map(|number| scaled(number, 65_535)));
            }
            depth => {
                let bits = depth as usize;
                let narrow = unpacked(row, bits, count);
                if bits == 8 || frame.color_type == ColorType::Indexed {
                    samples.extend(narrow);
                } else {
                    let most = (1 << bits) - 1;
                    samples.extend(narrow.map(|sample| scaled(u32::from(sample), most)));
                }
            }
        }
    }
    drop(stored);
    let (format, pixels) = match frame.color_type {
        ColorType::Grayscale => (Format::Grey8, samples),
        ColorType::Rgb => (Format::Rgb8, samples),
        ColorType::GrayscaleAlpha => {
            let pixels = samples.chunks_exact(2).map(|pixel| pixel[0]);
            (Format::Grey8, pixels.collect())
        }
        ColorType::Rgba => {
            let mut pixels = Vec::with_capacity(width * height * 3);
            for pixel in samples.chunks_exact(4) {
                pixels.extend_from_slice(&pixel[..3]);
            }
            (Format::Rgb8, pixels)
        }
        ColorType::Indexed => {
            let palette = palette.ok_or_else(|| broken("it has no palette"))?;
            indexed(&palette, &samples, width)?
        }
    };
    let alpha = matches!(
        frame.color_type,
        ColorType::GrayscaleAlpha | ColorType::Rgba
    );
    let scaled = (frame.bit_depth == BitDepth::Sixteen).then_some(Note::Scaled(u16::MAX));
    let transparency = (alpha || transparent).then_some(Note::Transparency);
    Ok(Picture {
        width,
        height,
        format,
        pixels,
        notes: scaled.into_iter().chain(transparency).collect(),
    })
}

/// The colours of indices; grey where all colours are.
fn indexed(palette: &[u8], indices: &[u8], width: usize) -> Result<(Format, Vec<u8>), ReadError> {
    let colours: Vec<&[u8]> = palette.chunks_exact(3).collect();
    let grey = colours
        .iter()
        .all(|rgb| rgb.iter().all(|sample| *sample == rgb[0]));
    let format = if grey { Format::Grey8 } else { Format::Rgb8 };
    let mut pixels = Vec::with_capacity(indices.len() * format.bytes());
    for (nth, index) in indices.iter().enumerate() {
        let colour = colours.get(usize::from(*index)).ok_or_else(|| {
            let (u, v, count) = (nth % width, nth / width, colours.len());
            broken(format!(
                "pixel {u}, {v} has colour {index} of a palette of {count} colours"
            ))
        })?;
        pixels.extend_from_slice(&colour[..format.bytes()]);
    }
    Ok((format, pixels))
}

/// Writes `width * height` grey values, first row first.
///
/// # Errors
/// When the output refuses, or when the number of values does not fit.
pub fn write(to: impl Write, width: usize, height: usize, pixels: &[u8]) -> Result<(), WriteError> {
    write_as(to, width, height, Format::Grey8, pixels)
}

/// Writes `width * height` pixels, first row first.
///
/// # Errors
/// When the output refuses, or when the number of values does not fit.
pub fn write_as(
    to: impl Write,
    width: usize,
    height: usize,
    format: Format,
    pixels: &[u8],
) -> Result<(), WriteError> {
    let side = |length: usize| u32::try_from(length).unwrap_or(u32::MAX);
    let mut encoder = Encoder::new(to, side(width), side(height));
    encoder.set_color(match format {
        Format::Grey8 => ColorType::Grayscale,
        Format::Rgb8 => ColorType::Rgb,
    });
    encoder.set_compression(Compression::Fast);
    let mut writer = encoder.write_header()?;
    writer.write_image_data(pixels)?;
    Ok(writer.finish()?)
}
