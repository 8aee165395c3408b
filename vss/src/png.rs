//! Grey pictures as PNG files. Knows bytes and pixels only.

use std::io::{BufRead, Seek, Write};

use png::{BitDepth, ColorType, Compression, Decoder, Encoder, Transformations};

/// A file of a few bytes can claim any size: more decoded bytes than this are refused.
const DECODED_MAX: usize = 512 << 20;

/// Why bytes are no picture.
#[derive(Debug, thiserror::Error)]
pub enum ReadError {
    /// They are no PNG, or a broken one.
    #[error(transparent)]
    Png(#[from] png::DecodingError),
    /// The picture would fill the memory.
    #[error("it is larger than {DECODED_MAX} bytes")]
    Large,
}

/// Why a picture could not be written: the output, or a size that the pixels do not have.
#[derive(Debug, thiserror::Error)]
#[error(transparent)]
pub struct WriteError(#[from] png::EncodingError);

/// Grey values, first row first.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Grey {
    /// Pixels of a row.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// `width * height` values.
    pub pixels: Vec<u8>,
}

/// Reads a PNG of any kind. Colours become their luminance (ITU-R BT.709), 16 bits become 8, and
/// transparency is ignored.
///
/// # Errors
/// When it is no PNG, a broken one, or too large.
pub fn read(from: impl BufRead + Seek) -> Result<Grey, ReadError> {
    let mut decoder = Decoder::new(from);
    decoder.set_transformations(Transformations::EXPAND);
    let mut reader = decoder.read_info()?;
    let size = reader.output_buffer_size();
    let size = size.filter(|size| *size <= DECODED_MAX);
    let mut bytes = vec![0; size.ok_or(ReadError::Large)?];
    let frame = reader.next_frame(&mut bytes)?;
    bytes.truncate(frame.buffer_size());
    let wide = frame.bit_depth == BitDepth::Sixteen;
    let sample = |bytes: &[u8]| {
        bytes
            .iter()
            .fold(0, |sum, byte| sum << 8 | u32::from(*byte))
    };
    let byte = |sample: u32| {
        let byte = if wide { (sample + 128) / 257 } else { sample };
        u8::try_from(byte).unwrap_or(u8::MAX)
    };
    let width = if wide { 2 } else { 1 };
    let grey = |pixel: &[u8]| {
        let mut samples = pixel.chunks(width).map(sample);
        match [samples.next(), samples.next(), samples.next()] {
            [Some(red), Some(green), Some(blue)] => {
                byte((2126 * red + 7152 * green + 722 * blue) / 10_000)
            }
            [grey, ..] => byte(grey.unwrap_or(0)),
        }
    };
    let side = |length: u32| usize::try_from(length).unwrap_or(usize::MAX);
    Ok(Grey {
        width: side(frame.width),
        height: side(frame.height),
        pixels: bytes
            .chunks(width * frame.color_type.samples())
            .map(grey)
            .collect(),
    })
}

/// Writes `width * height` grey values, first row first.
///
/// # Errors
/// When the output refuses, or when the number of values does not fit.
pub fn write(to: impl Write, width: usize, height: usize, pixels: &[u8]) -> Result<(), WriteError> {
    let side = |length: usize| u32::try_from(length).unwrap_or(u32::MAX);
    let mut encoder = Encoder::new(to, side(width), side(height));
    encoder.set_color(ColorType::Grayscale);
    encoder.set_compression(Compression::Fast);
    let mut writer = encoder.write_header()?;
    writer.write_image_data(pixels)?;
    Ok(writer.finish()?)
}

#[cfg(test)]
mod tests {
    use std::io::Cursor;

    use super::*;

    fn encoded(color: ColorType, depth: BitDepth, data: &[u8]) -> Vec<u8> {
        let mut bytes = Vec::new();
        let mut encoder = Encoder::new(&mut bytes, 2, 1);
        encoder.set_color(color);
        encoder.set_depth(depth);
        if color == ColorType::Indexed {
            encoder.set_palette(&[0, 0, 0, 250, 250, 250][..]);
        }
        let mut writer = encoder.write_header().unwrap();
        writer.write_image_data(data).unwrap();
        writer.finish().unwrap();
        bytes
    }

    #[test]
    fn a_picture_reads_back_as_written_and_a_wrong_size_is_an_error() {
        let pixels = [0, 50, 100, 150, 200, 255];
        let mut bytes = Vec::new();
        write(&mut bytes, 3, 2, &pixels).unwrap();
        let found = read(Cursor::new(bytes)).unwrap();
        assert_eq!((found.width, found.height), (3, 2));
        assert_eq!(found.pixels, pixels);
        for (width, height) in [(3, 3), (0, 0), (usize::MAX, 1)] {
            assert!(write(Vec::new(), width, height, &pixels).is_err());
        }
    }

    #[test]
    fn every_kind_of_png_becomes_grey() {
        use BitDepth::{Eight, One, Sixteen};
        use ColorType::{Grayscale, GrayscaleAlpha, Indexed, Rgb, Rgba};
        let cases: [(ColorType, BitDepth, &[u8], [u8; 2]); 7] = [
            (Grayscale, One, &[0b0100_0000], [0, 255]),
            (Grayscale, Sixteen, &[255, 255, 0, 129], [255, 1]),
            (GrayscaleAlpha, Eight, &[10, 0, 20, 255], [10, 20]),
            (Rgb, Eight, &[255, 0, 0, 0, 255, 0], [54, 182]),
            (Rgb, Sixteen, &[255; 12], [255, 255]),
            (Rgba, Eight, &[0, 0, 255, 9, 77, 77, 77, 0], [18, 77]),
            (Indexed, One, &[0b0100_0000], [0, 250]),
        ];
        for (color, depth, data, expected) in cases {
            let found = read(Cursor::new(encoded(color, depth, data))).unwrap();
            assert_eq!(found.pixels, expected, "{color:?} {depth:?}");
        }
    }

    #[test]
    fn what_is_broken_or_claims_to_be_huge_is_an_error() {
        let whole = encoded(ColorType::Rgb, BitDepth::Eight, &[1; 6]);
        for end in 0..whole.len() - 12 {
            assert!(read(Cursor::new(&whole[..end])).is_err(), "{end}");
        }
        let mut bytes = Vec::new();
        let header = Encoder::new(&mut bytes, 1 << 30, 1 << 30).write_header();
        header.unwrap().write_chunk(png::chunk::IDAT, &[]).unwrap();
        assert!(read(Cursor::new(bytes)).is_err());
    }
}
