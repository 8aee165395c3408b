//! Pictures as bytes and pixels: reading and writing files, colour classes, boards. Knows no camera, no task and no file
//! system.
//!
//! [`read`] decides by content what the bytes are: PNG, JPEG, PNM (PBM, PGM, PPM) or BMP. It answers with a whole picture
//! or with an error, and never with a part of one: a picture that was cut off looks grey or black where it ends, and would
//! be measured there. Sizes are limited before memory is taken; reading needs less than 256 MB besides the bytes.
//!
//! Pixel centres are at whole numbers, the first pixel is (0, 0), u runs right and v down.

pub mod board;
pub mod colour;

mod bmp;
mod jpeg;
pub mod png;
mod pnm;
mod samples;
pub mod stream;

#[cfg(test)]
mod fuzz;
#[cfg(test)]
mod tests;

/// Pictures have at most so many pixels: files of a few bytes can claim any size.
pub const PIXELS_MOST: usize = 1 << 24;

/// Files of pictures have at most so many bytes.
pub const FILE_MOST: u64 = 64 << 20;

/// What a pixel is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Format {
    /// One byte: how bright it is.
    Grey8,
    /// Three bytes: red, green, blue.
    Rgb8,
}

impl Format {
    /// Bytes of a pixel.
    #[must_use]
    pub fn bytes(self) -> usize {
        match self {
            Self::Grey8 => 1,
            Self::Rgb8 => 3,
        }
    }
}

/// A whole picture.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Picture {
    /// Pixels of a row.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// What a pixel is.
    pub format: Format,
    /// `width * height` pixels, first row first.
    pub pixels: Vec<u8>,
    /// Where the pixels are not those of the file, or not as the file wants them shown.
    pub notes: Vec<Note>,
}

impl Picture {
    /// The brightness of each pixel: the luminance of colours (ITU-R BT.709).
    #[must_use]
    pub fn into_grey(self) -> Vec<u8> {
        match self.format {
            Format::Grey8 => self.pixels,
            Format::Rgb8 => {
                let pixels = self.pixels.chunks_exact(3);
                pixels
                    .map(|rgb| luminance(rgb[0], rgb[1], rgb[2]))
                    .collect()
            }
        }
    }

    /// Red, green and blue of each pixel.
    #[must_use]
    pub fn into_rgb(self) -> Vec<u8> {
        match self.format {
            Format::Grey8 => self.pixels.iter().flat_map(|grey| [*grey; 3]).collect(),
            Format::Rgb8 => self.pixels,
        }
    }

    /// Red, green and blue at column `u` and row `v`, or nothing outside the picture.
    #[must_use]
    pub fn rgb(&self, u: usize, v: usize) -> Option<[u8; 3]> {
        if u >= self.width {
            return None;
        }
        let at = (v.checked_mul(self.width)? + u).checked_mul(self.format.bytes())?;
        match self.pixels.get(at..at + self.format.bytes())? {
            [grey] => Some([*grey; 3]),
            [red, green, blue] => Some([*red, *green, *blue]),
            _ => None,
        }
    }

    /// The mean red, green and blue of the pixels whose centres are within `radius` of a place (px), or of the nearest one.
    /// Nothing where the disc leaves the picture.
    #[must_use]
    pub fn mean_of_disc(&self, u: f64, v: f64, radius: f64) -> Option<[f64; 3]> {
        let inside =
            |at: f64, length: usize| at - radius > -0.5 && at + radius < length as f64 - 0.5;
        if !(inside(u, self.width) && inside(v, self.height)) {
            return None;
        }
        let range = |at: f64| (at - radius).ceil() as usize..=(at + radius).floor() as usize;
        let places = range(v).flat_map(|row| range(u).map(move |column| (column, row)));
        let within =
            |(column, row): &(usize, usize)| (*column as f64 - u).hypot(*row as f64 - v) <= radius;
        let mut places: Vec<(usize, usize)> = places.filter(within).collect();
        if places.is_empty() {
            places.push((u.round() as usize, v.round() as usize));
        }
        let mut sums = [0.0; 3];
        for rgb in places.iter().filter_map(|(u, v)| self.rgb(*u, *v)) {
            for (sum, sample) in sums.iter_mut().zip(rgb) {
                *sum += f64::from(sample);
            }
        }
        Some(sums.map(|sum| sum / places.len() as f64))
    }
}

/// How bright a colour is (ITU-R BT.709, item 3.2), rounded.
#[must_use]
pub fn luminance(red: u8, green: u8, blue: u8) -> u8 {
    let [red, green, blue] = [red, green, blue].map(u32::from);
    u8::try_from((2126 * red + 7152 * green + 722 * blue + 5000) / 10_000).unwrap_or(u8::MAX)
}

/// What a reader of measurements should know of a picture.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum Note {
    /// Samples were scaled. 65535 means 16 bits, which are divided by 257.
    #[error("its samples of 0 to {0} became 0 to 255 (multiplied by 255/{0} and rounded)")]
    Scaled(u16),
    /// The camera that took it lay on its side (Exif, tag 0x0112).
    #[error(
        "its Exif orientation is {0}: viewers rotate or mirror it, here its pixels stay as the camera stored them"
    )]
    Orientation(u16),
    /// How much of a pixel covers what is behind.
    #[error("its transparency is ignored")]
    Transparency,
}

/// Why bytes are no picture that can be read.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum ReadError {
    /// Nothing at all.
    #[error("it is empty")]
    Empty,
    /// No format that is read.
    #[error(
        "it begins with {0}, as none of the formats that are read does (PNG, JPEG, PBM, PGM, PPM, BMP): convert it to PNG"
    )]
    Unknown(String),
    /// The end is missing.
    #[error("this {format} is cut off: {what}; write or copy it again")]
    Truncated {
        /// The format.
        format: &'static str,
        /// Where it ends, and where it should.
        what: String,
    },
    /// It contradicts itself or its format.
    #[error("this {format} is broken: {what}")]
    Broken {
        /// The format.
        format: &'static str,
        /// What is wrong.
        what: String,
    },
    /// A kind that is not read.
    #[error("this {format} is of a kind that is not read: {what}; convert it to PNG, grey or RGB")]
    Unsupported {
        /// The format.
        format: &'static str,
        /// Of which kind it is.
        what: String,
    },
    /// The picture would fill the memory.
    #[error(
        "this {format} claims {width} x {height} pixels, and pictures of up to {PIXELS_MOST} are read: make it smaller"
    )]
    Large {
        /// The format.
        format: &'static str,
        /// Pixels of a row.
        width: u64,
        /// Rows.
        height: u64,
    },
}

/// Reads the picture that `bytes` are.
///
/// Samples of other depths are scaled to 8 bits. Transparency is ignored and orientation tags are not obeyed; the notes
/// say both.
///
/// # Errors
/// They are none, a broken or truncated one, of a kind that is not read, or too large.
pub fn read(bytes: &[u8]) -> Result<Picture, ReadError> {
    match bytes {
        [] => Err(ReadError::Empty),
        [0x89, b'P', b'N', b'G', ..] => png::read(bytes),
        [0xff, 0xd8, ..] => jpeg::read(bytes),
        [b'P', b'1'..=b'7', ..] => pnm::read(bytes),
        [b'B', b'M', ..] => bmp::read(bytes),
        _ => {
            let first = bytes.get(..bytes.len().min(8)).unwrap_or_default();
            Err(ReadError::Unknown(format!("`{}`", first.escape_ascii())))
        }
    }
}

/// The sides of a picture, if it has some and is not too large.
fn sides(format: &'static str, width: u64, height: u64) -> Result<(usize, usize), ReadError> {
    let large = ReadError::Large {
        format,
        width,
        height,
    };
    let pixels = width.checked_mul(height);
    match (usize::try_from(width), usize::try_from(height), pixels) {
        (_, _, Some(0)) => Err(ReadError::Broken {
            format,
            what: format!("it has {width} x {height} pixels"),
        }),
        (Ok(width), Ok(height), Some(pixels)) if pixels <= PIXELS_MOST as u64 => {
            Ok((width, height))
        }
        _ => Err(large),
    }
}
